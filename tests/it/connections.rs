//! Clients that are slow, cut short or silent, on plain sockets.

use std::time::Duration;

use crate::service::Service;

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
    let service = Service::with(|config| config.header_timeout_ms = 200);
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
