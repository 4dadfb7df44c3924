//! Clients that are slow, cut short or silent, on plain sockets.

use std::time::Duration;

use crate::service::{Client, Service};

#[test]
fn a_slow_body_is_given_up() {
    let service = Service::with(|config| config.body_timeout_ms = 200);
    service.client().put("/v1/worlds/a", "").expect(201);
    let mut slow = service.client();
    slow.raw(b"POST /v1/worlds/a/advance HTTP/1.1\r\nhost: localhost\r\ncontent-length: 16\r\n\r\n{\"dura");
    let answer = slow.answer(false);
    assert_eq!((answer.status, answer.json()["code"].as_str()), (408, Some("body_timeout")));
    assert_eq!(service.client().get("/v1/worlds/a").json()["revision"], 0);
}

#[test]
fn half_a_header_and_silence_are_given_up() {
    let service = Service::with(|config| {
        config.header_timeout_ms = 200;
        config.idle_timeout_ms = 200;
    });
    for start in ["", "GET / HT", "GET /v1 HTTP/1.1\r\nhost: loc"] {
        let mut half = service.client();
        half.raw(start.as_bytes());
        half.impatient(Duration::from_secs(20));
        assert!(half.is_closed(), "{start:?}");
    }
}

#[test]
fn a_body_that_is_cut_short_changes_nothing() {
    let service = Service::start();
    service.client().put("/v1/worlds/a", "").expect(201);
    let mut cut = service.client();
    cut.raw(b"POST /v1/worlds/a/advance HTTP/1.1\r\nhost: localhost\r\ncontent-length: 16\r\n\r\n{\"duration\":1");
    drop(cut);
    let mut cut = service.client();
    cut.raw(b"POST /v1/worlds/a/advance HTTP/1.1\r\nhost: localhost\r\ntransfer-encoding: chunked\r\n\r\n5\r\n{\"dur\r\nnonsense\r\n");
    assert!(cut.try_answer(false).is_none_or(|answer| answer.status == 400));
    assert_eq!(service.client().get("/v1/worlds/a").json()["revision"], 0);
}

/// What is refused before there is a request is told like everything else, and costs one connection.
#[test]
fn what_is_not_http_is_a_problem_too() {
    let service = Service::start();
    let headers = "h: x\r\n".repeat(150);
    for (request, status, code) in [
        ("GET\r\n\r\n".to_owned(), 400, "malformed_request"),
        ("GET /v1 HTTP/9.9\r\n\r\n".to_owned(), 400, "malformed_request"),
        ("GET /v1 HTTP/1.1\r\nhost: localhost\r\nbad header\r\n\r\n".to_owned(), 400, "malformed_request"),
        (
            "POST /v1/worlds HTTP/1.1\r\nhost: localhost\r\ncontent-length: -1\r\n\r\n".to_owned(),
            400,
            "malformed_request",
        ),
        ("\u{16}\u{3}\u{1}\u{2}\r\n\r\n".to_owned(), 400, "malformed_request"),
        (format!("GET /{} HTTP/1.1\r\nhost: localhost\r\n\r\n", "a".repeat(70_000)), 414, "uri_too_long"),
        (format!("GET /v1 HTTP/1.1\r\nhost: localhost\r\n{headers}\r\n"), 431, "headers_too_large"),
        (
            format!("GET /v1 HTTP/1.1\r\nhost: localhost\r\na: {}\r\n\r\n", "a".repeat(600_000)),
            431,
            "headers_too_large",
        ),
    ] {
        let mut client = service.client();
        client.raw_unless_closed(request.as_bytes());
        let shown = &request[..request.len().min(60)];
        let Some(answer) = client.try_answer(false) else {
            // What did not read the request to its end may lose the answer to a reset.
            assert!(request.len() > 100_000, "{shown:?} is answered");
            continue;
        };
        assert_eq!(answer.status, status, "{shown:?}: {}", answer.text());
        assert_eq!(answer.header("content-type"), Some("application/problem+json"), "{shown:?}");
        assert!(answer.header("x-request-id").is_some_and(|id| !id.is_empty()), "{shown:?}");
        assert_eq!(answer.json()["code"], code, "{shown:?}");
        assert_eq!(answer.body.last(), Some(&b'\n'), "{shown:?}");
        assert!(client.is_closed(), "{shown:?}");
    }
    service.client().get("/healthz").expect(200);
}

#[test]
fn connections_beyond_the_limit_wait_for_their_turn() {
    let service = Service::with(|config| config.connections_max = 1);
    let mut first = service.client();
    first.get("/healthz").expect(200);
    let mut second = service.client();
    second.raw(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n");
    second.impatient(Duration::from_millis(100));
    assert!(second.try_answer(false).is_none(), "the first connection is still open");
    drop(first);
    second.impatient(Duration::from_secs(10));
    second.answer(false).expect(200);
}

/// An idle connection ends, one that works does not: neither while a request takes long, nor while requests keep coming.
#[test]
fn only_what_is_silent_is_idle() {
    let service = Service::with(|config| {
        config.idle_timeout_ms = 150;
        config.header_timeout_ms = 150;
    });
    let mut client = service.client();
    client.put("/v1/worlds/a", r#"{"integrator":"newton_euler"}"#).expect(201);
    client.post("/v1/worlds/a/particles", r#"{"count":1000,"velocity":[1,0,0]}"#).expect(201);
    for _ in 0..10 {
        client.get("/healthz").expect(200);
        std::thread::sleep(Duration::from_millis(30));
    }
    client.post("/v1/worlds/a/advance", r#"{"duration":1,"steps":1000000}"#).expect(200);
    client.get("/healthz").expect(200);
    client.impatient(Duration::from_secs(20));
    assert!(client.is_closed(), "it is idle now");
}

/// A client that asks for much and takes nothing of it loses its connection, and nothing else happens.
#[test]
fn who_does_not_read_is_given_up() {
    let service = Service::with(|config| {
        config.write_timeout_ms = 300;
        config.write_rate_min = 1 << 30;
    });
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    client.post("/v1/worlds/a/particles", r#"{"count":300000,"velocity":[0.1,0.2,0.3]}"#).expect(201);
    let mut silent = service.client();
    silent.raw(b"GET /v1/worlds/a/state HTTP/1.1\r\nhost: localhost\r\n\r\n");
    std::thread::sleep(Duration::from_millis(1500));
    silent.impatient(Duration::from_secs(20));
    assert!(silent.try_answer(false).is_none(), "the answer was cut off");
    client.get("/v1/worlds/a").expect(200);
}

#[test]
fn heads_that_are_too_long_are_refused() {
    let service = Service::with(|config| {
        config.uri_bytes_max = 100;
        config.header_bytes_max = 200;
    });
    let mut client = service.client();
    client.get(&format!("/v1?a={}", "a".repeat(94))).expect(422);
    let answer = client.get(&format!("/v1?a={}", "a".repeat(95)));
    assert_eq!((answer.status, answer.json()["code"].as_str()), (414, Some("uri_too_long")));
    assert!(answer.text().contains("--uri-bytes-max"));
    let answer = client.send("GET", "/v1", &[("x", &"a".repeat(200))], None);
    assert_eq!((answer.status, answer.json()["code"].as_str()), (431, Some("headers_too_large")));
    assert!(answer.text().contains("--header-bytes-max"));
    client.get("/v1").expect(200);
}

fn http2_frame(kind: u8, flags: u8, stream: u8, payload: &[u8]) -> Vec<u8> {
    let length = u8::try_from(payload.len()).expect("a short one");
    [&[0, 0, length, kind, flags, 0, 0, 0, stream], payload].concat()
}

/// Pings are no requests, and an answer that waits for a window is not taken: both end.
#[test]
fn http2_connections_that_only_ping_are_given_up() {
    let service = Service::with(|config| {
        config.idle_timeout_ms = 300;
        config.write_timeout_ms = 300;
    });
    service.client().put("/v1/worlds/a", "").expect(201);
    let no_window = http2_frame(4, 0, 0, &[0, 4, 0, 0, 0, 0]);
    // A literal GET /v1/worlds on http://localhost.
    let mut headers = vec![0x82, 0x86, 0x04, 10];
    headers.extend_from_slice(b"/v1/worlds\x41\x09localhost");
    let asks = http2_frame(1, 5, 1, &headers);
    for first in [Vec::new(), [no_window, asks].concat()] {
        let mut client = service.client();
        http2_settings(&mut client);
        client.raw(&first);
        client.impatient(Duration::from_millis(1));
        let pinged = (0..2000).take_while(|_| {
            client.raw_unless_closed(&http2_frame(6, 0, 0, &[0; 8]));
            std::thread::sleep(Duration::from_millis(5));
            !client.is_gone()
        });
        let pinged = pinged.count();
        assert!((10..2000).contains(&pinged), "{pinged}");
    }
    let charged = "\npointmass_in_flight_charged_bytes 0\n";
    assert!(service.client().get("/metrics").text().contains(charged), "what the answer took is given back");
}

/// Bytes of the frame of settings that an HTTP/2 service sends first: pairs of a number and a value.
fn http2_settings(client: &mut Client) -> Vec<(u16, u32)> {
    client.raw(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0");
    let head = client.bytes(9);
    assert_eq!(head[3], 4, "a frame of settings");
    let pairs = client.bytes(usize::from(head[2]));
    pairs
        .chunks_exact(6)
        .map(|pair| (u16::from_be_bytes([pair[0], pair[1]]), u32::from_be_bytes([pair[2], pair[3], pair[4], pair[5]])))
        .collect()
}

#[test]
fn http2_is_spoken_to_those_who_know_beforehand() {
    let service = Service::with(|config| {
        config.streams_max = 7;
        config.header_bytes_max = 5000;
        config.idle_timeout_ms = 500;
    });
    let url = format!("http://{}/v1/worlds/a", service.address);
    let curl = |arguments: &[&str]| {
        let output = std::process::Command::new("curl")
            .args(["-s", "--http2-prior-knowledge", "-w", "%{http_version} %{http_code}"])
            .args(arguments)
            .output()
            .expect("curl is installed");
        String::from_utf8(output.stdout).expect("text")
    };
    assert!(curl(&["-X", "PUT", &url]).ends_with("2 201"));
    assert!(
        curl(&[&format!("{url}/particles"), "-d", r#"{"count":20000,"velocity":[0.1,0.2,0.3]}"#]).ends_with("2 201")
    );
    assert!(curl(&[&format!("{url}/advance"), "-d", r#"{"duration":0.5}"#]).ends_with("2 200"));
    assert!(curl(&[&format!("{url}/advance"), "-d", "{"]).ends_with("2 400"));
    let state = curl(&[&format!("{url}/state")]);
    assert_eq!(state.strip_suffix("2 200"), Some(service.client().get("/v1/worlds/a/state").text()));
    let mut idle = service.client();
    let settings = http2_settings(&mut idle);
    assert!(settings.contains(&(3, 7)) && settings.contains(&(6, 5000)), "{settings:?}");
    idle.impatient(Duration::from_secs(20));
    assert!(idle.is_closed(), "no request came");
}
