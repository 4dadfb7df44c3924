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

#[test]
fn nonsense_is_answered_or_closed_and_the_service_lives() {
    let service = Service::start();
    for bytes in [
        &b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"[..],
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"\r\n\r\n\r\n\r\nx",
        &vec![b'A'; 100_000],
    ] {
        let mut client = service.client();
        client.impatient(Duration::from_millis(500));
        client.raw_unless_closed(bytes);
        assert!(client.try_answer(false).is_none_or(|answer| matches!(answer.status, 400 | 414 | 431 | 505)));
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
