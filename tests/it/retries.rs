//! Changes that are sent again: with an Idempotency-Key each is done once.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

use crate::service::{Answer, Client, Service, wait_for_in_flight};

const KEY: &str = "idempotency-key";

fn keyed(client: &mut Client, key: &str, method: &str, path: &str, body: &str) -> Answer {
    client.send(method, path, &[(KEY, key)], Some(body.as_bytes()))
}

fn code(answer: &Answer) -> String {
    answer.json()["code"].as_str().unwrap_or_default().to_owned()
}

#[test]
fn every_change_is_done_once_and_answered_twice() {
    let service = Service::start();
    let mut client = service.client();
    for (k, (method, path, body)) in [
        ("PUT", "/v1/worlds/a", r#"{"gravity":"standard"}"#),
        ("POST", "/v1/worlds/a/particles", r#"{"position":[0,1,0]}"#),
        ("POST", "/v1/worlds/a/particles", r#"{"count":3,"velocity":[1,0,0]}"#),
        ("PATCH", "/v1/worlds/a", r#"{"gravity":"textbook"}"#),
        ("PATCH", "/v1/worlds/a/particles", r#"{"damping":0.9}"#),
        ("PATCH", "/v1/worlds/a/particles/0", r#"{"damping":0.8}"#),
        ("PUT", "/v1/worlds/a/particles/0/mass", r#"{"mass":2}"#),
        ("POST", "/v1/worlds/a/particles/0/force", r#"{"force":[1,2,3]}"#),
        ("POST", "/v1/worlds/a/particles/0/impulse", r#"{"impulse":[1,2,3]}"#),
        ("POST", "/v1/worlds/a/particles/0/place", r#"{"position":[1,2,3]}"#),
        ("POST", "/v1/worlds/a/forces", r#"{"ids":[0,1],"force":[1,0,0]}"#),
        ("POST", "/v1/worlds/a/advance", r#"{"duration":0.5,"return":["position"]}"#),
        ("POST", "/v1/worlds/a/commands", r#"{"commands":[{"create":{}},{"advance":{"duration":0.5}},{"read":{}}]}"#),
    ]
    .into_iter()
    .enumerate()
    {
        let key = format!("key {k}");
        let first = keyed(&mut client, &key, method, path, body);
        assert!(matches!(first.status, 200 | 201), "{method} {path}: {}", first.text());
        assert_eq!(first.header("idempotency-replayed"), None);
        let after = client.get("/v1/worlds/a").expect(200);
        let again = keyed(&mut client, &key, method, path, body);
        assert_eq!(again.header("idempotency-replayed"), Some("true"), "{method} {path}");
        assert_eq!((again.status, again.text()), (first.status, first.text()), "{method} {path}");
        for name in ["etag", "location", "content-type"] {
            assert_eq!(again.header(name), first.header(name), "{method} {path}");
        }
        assert_eq!(client.get("/v1/worlds/a").text(), after.text(), "{method} {path} was done once");
        let digests = [(); 2].map(|()| client.get("/v1/worlds/a/digest").text().to_owned());
        assert_eq!(digests[0], digests[1]);
    }
    // A removal that is sent again finds nothing: that comes before kept answers, and is as good an answer.
    keyed(&mut client, "removal", "DELETE", "/v1/worlds/a/particles/0", "").expect(204);
    keyed(&mut client, "removal", "DELETE", "/v1/worlds/a/particles/0", "").expect(404);
    keyed(&mut client, "end", "DELETE", "/v1/worlds/a", "").expect(204);
    keyed(&mut client, "end", "DELETE", "/v1/worlds/a", "").expect(404);
    // Sent once more it spares a new world of that name.
    client.put("/v1/worlds/a", "").expect(201);
    let late = keyed(&mut client, "end", "DELETE", "/v1/worlds/a", "").expect(204);
    assert_eq!(late.header("idempotency-replayed"), Some("true"));
    client.delete("/v1/worlds/a").expect(204);
    // With the world its answers are gone.
    keyed(&mut client, "key 0", "PUT", "/v1/worlds/a", r#"{"gravity":"standard"}"#).expect(201);
    assert_eq!(client.get("/v1/worlds/a").json()["revision"], 0);
}

#[test]
fn a_key_belongs_to_one_request() {
    let service = Service::start();
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    let path = "/v1/worlds/a/advance";
    keyed(&mut client, "k", "POST", path, r#"{"duration":1}"#).expect(200);
    for (method, path, body) in [
        ("POST", path, r#"{"duration":2}"#),
        ("POST", path, r#"{"duration":1} "#),
        ("POST", path, "not JSON"),
        ("PATCH", "/v1/worlds/a", r#"{"duration":1}"#),
    ] {
        let other = keyed(&mut client, "k", method, path, body).expect(422);
        assert_eq!(code(&other), "idempotency_key_reused", "{method} {path} {body}");
    }
    let headers = [(KEY, "k"), ("if-match", "\"1\"")];
    let other = client.send("POST", path, &headers, Some(br#"{"duration":1}"#)).expect(422);
    assert_eq!(code(&other), "idempotency_key_reused");
    // If-Match was judged when the change was made, and is no more.
    let headers = [(KEY, "matched"), ("if-match", "\"1\"")];
    for _ in 0..2 {
        client.send("POST", path, &headers, Some(br#"{"duration":1}"#)).expect(200);
    }
    // Another world has keys of its own.
    client.put("/v1/worlds/b", "").expect(201);
    keyed(&mut client, "k", "POST", "/v1/worlds/b/advance", r#"{"duration":2}"#).expect(200);
    assert_eq!(client.get("/v1/worlds/a").json()["time"], 2.0);
    for wrong in ["", &"k".repeat(256)] {
        let answer = keyed(&mut client, wrong, "POST", path, r#"{"duration":1}"#).expect(422);
        assert_eq!(code(&answer), "invalid_idempotency_key");
    }
    keyed(&mut client, &"k".repeat(255), "POST", path, r#"{"duration":1}"#).expect(200);
    let twice = [(KEY, "one"), (KEY, "two")];
    let answer = client.send("POST", path, &twice, Some(br#"{"duration":1}"#)).expect(422);
    assert_eq!(code(&answer), "invalid_idempotency_key");
}

/// What was refused changed nothing, so there is nothing to keep: sent again it is judged again.
#[test]
fn a_refusal_is_not_kept() {
    let service = Service::start();
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    let force = r#"{"force":[1,0,0]}"#;
    keyed(&mut client, "k", "POST", "/v1/worlds/a/particles/0/force", force).expect(404);
    keyed(&mut client, "m", "PATCH", "/v1/worlds/a", r#"{"max_step":0}"#).expect(422);
    client.post("/v1/worlds/a/particles", "{}").expect(201);
    keyed(&mut client, "k", "POST", "/v1/worlds/a/particles/0/force", force).expect(200);
    keyed(&mut client, "m", "PATCH", "/v1/worlds/a", r#"{"max_step":1}"#).expect(200);
}

#[test]
fn worlds_that_the_service_names_are_made_once() {
    let service = Service::start();
    let mut client = service.client();
    let first = keyed(&mut client, "k", "POST", "/v1/worlds", "{}").expect(201);
    let again = keyed(&mut client, "k", "POST", "/v1/worlds", "{}").expect(201);
    assert_eq!((again.text(), again.header("location")), (first.text(), first.header("location")));
    let other = keyed(&mut client, "other", "POST", "/v1/worlds", "{}").expect(201);
    assert_ne!(other.header("location"), first.header("location"));
    assert_eq!(client.get("/v1/worlds").json()["worlds"].as_array().map(Vec::len), Some(2));
    // A world that exists is told to those who did not make it.
    client.put("/v1/worlds/a", "").expect(201);
    assert_eq!(code(&keyed(&mut client, "mine", "PUT", "/v1/worlds/a", "")), "world_exists");
}

#[test]
fn while_the_first_is_in_flight_the_second_is_told() {
    let service = Service::start();
    let mut client = service.client();
    client.put("/v1/worlds/a", r#"{"integrator":"newton_euler"}"#).expect(201);
    client.post("/v1/worlds/a/particles", r#"{"count":20000,"velocity":[1,0,0]}"#).expect(201);
    let body = r#"{"duration":1,"steps":900000}"#;
    let request = format!(
        "POST /v1/worlds/a/advance HTTP/1.1\r\nhost: localhost\r\n{KEY}: k\r\ncontent-length: {}\r\n\r\n{body}",
        body.len()
    );
    let mut first = service.client();
    first.raw(request.as_bytes());
    wait_for_in_flight(service.address, 1);
    let mut second = service.client();
    second.raw(request.as_bytes());
    let second = second.answer(false).expect(409);
    assert_eq!(code(&second), "idempotency_key_in_flight");
    // The first is cancelled when its client goes away; then the key is free.
    drop(first);
    let mut advance = || keyed(&mut client, "k", "POST", "/v1/worlds/a/advance", r#"{"duration":1}"#);
    let free =
        std::iter::repeat_with(&mut advance).take(100_000).find(|answer| answer.status != 422 && answer.status != 409);
    free.expect("in the end").expect(200);
    assert_eq!(client.get("/v1/worlds/a").json()["revision"], 2, "the particles, and the last advance");
}

#[test]
fn so_many_answers_are_kept_and_so_long() {
    let service = Service::with(|config| config.keys_max = 2);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    let advance = |client: &mut Client, key: &str| {
        let answer = keyed(client, key, "POST", "/v1/worlds/a/advance", r#"{"duration":1}"#).expect(200);
        answer.header("idempotency-replayed").is_some()
    };
    let replayed = ["a", "b", "a", "b", "c", "b", "c", "a", "c"].map(|key| advance(&mut client, key));
    assert_eq!(replayed, [false, false, true, true, false, true, true, false, true]);

    let service = Service::with(|config| config.key_lifetime_ms = 0);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    assert_eq!(["a", "a"].map(|key| advance(&mut client, key)), [false, false], "nothing is kept at all");

    // The bytes of all of them are bounded too, and charged: 100,000 positions are more than 1 MiB.
    client.post("/v1/worlds/a/particles", r#"{"count":100000}"#).expect(201);
    let large = r#"{"duration":1,"return":["position"]}"#;
    let refused = keyed(&mut client, "large", "POST", "/v1/worlds/a/advance", large).expect(422);
    assert_eq!(code(&refused), "answer_too_large");
    let service = Service::with(|config| config.memory_bytes_max = 4096);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    let refusal = (0..100).find_map(|k| {
        let answer = keyed(&mut client, &k.to_string(), "POST", "/v1/worlds/a/advance", r#"{"duration":1}"#);
        (answer.status != 200).then_some((k, answer))
    });
    let (accepted, refused) = refusal.expect("the budget ends");
    assert_eq!(code(&refused), "limit_reached");
    assert_eq!(client.get("/v1/worlds/a").json()["revision"], accepted);
}

/// Forwards one request after the other, and loses some of them on the way in and some of their answers.
fn lossy_proxy(service: SocketAddr) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("bound");
    std::thread::spawn(move || {
        let mut random = 0x9e37_79b9_7f4a_7c15_u64;
        for client in listener.incoming() {
            let Ok(mut client) = client else { return };
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let fate = random >> 62;
            let mut request = vec![0; 4096];
            let Ok(length) = client.read(&mut request) else { continue };
            if fate == 0 {
                continue; // The request is lost.
            }
            let mut upstream = TcpStream::connect(service).expect("the service listens");
            upstream.write_all(&request[..length]).expect("the service reads");
            if fate == 1 {
                let mut answer = [0; 1];
                let _begun = upstream.read(&mut answer);
                continue; // Its answer is.
            }
            upstream.shutdown(Shutdown::Write).expect("open");
            let mut answer = Vec::new();
            let _closed = upstream.read_to_end(&mut answer);
            let _gone = client.write_all(&answer);
        }
    });
    address
}

#[test]
fn a_client_that_retries_moves_its_world_once_for_each_intent() {
    let service = Service::start();
    let proxy = lossy_proxy(service.address);
    let mut client = service.client();
    for world in ["behind", "direct"] {
        client.put(&format!("/v1/worlds/{world}"), r#"{"integrator":"newton_euler","gravity":"standard"}"#).expect(201);
        client.post(&format!("/v1/worlds/{world}/particles"), r#"{"count":10,"velocity":[1,0,0]}"#).expect(201);
    }
    let mut lost = 0;
    for intent in 0..60 {
        let (path, body) = match intent % 3 {
            0 => ("advance", format!(r#"{{"duration":0.{}}}"#, intent + 1)),
            1 => ("forces", format!(r#"{{"ids":[{}],"force":[0,{intent},1]}}"#, intent % 10)),
            _ => ("particles", r#"{"position":[1,2,3]}"#.to_owned()),
        };
        client.post(&format!("/v1/worlds/direct/{path}"), &body);
        let request = format!(
            "POST /v1/worlds/behind/{path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n{KEY}: intent {intent}\r\n\
             content-length: {}\r\n\r\n{body}",
            body.len()
        );
        let answer = std::iter::repeat_with(|| {
            let mut client = Client::connect(proxy);
            client.impatient(Duration::from_secs(20));
            client.raw_unless_closed(request.as_bytes());
            client.try_answer(false)
        });
        let (tries, answer) = answer.take(100).enumerate().find(|(_, answer)| answer.is_some()).expect("in the end");
        assert!(answer.is_some_and(|answer| matches!(answer.status, 200 | 201)));
        lost += tries;
    }
    assert!(lost > 20, "the proxy loses many: {lost}");
    let [behind, direct] = ["behind", "direct"].map(|world| client.get(&format!("/v1/worlds/{world}/digest")).json());
    assert_eq!(behind, direct, "the same digest, clock, steps and revision");
}
