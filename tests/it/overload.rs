//! More work than there is room for: some of it is refused, cheaply and in time, and none of it is lost.

use std::time::Duration;

use crate::service::{Answer, Client, Service, wait_for_in_flight};

/// A world, and the body of an advance that takes seconds.
fn long_world(client: &mut Client, name: &str) -> &'static str {
    client.put(&format!("/v1/worlds/{name}"), r#"{"integrator":"newton_euler"}"#).expect(201);
    client.post(&format!("/v1/worlds/{name}/particles"), r#"{"count":20000,"velocity":[1,0,0]}"#).expect(201);
    r#"{"duration":1,"steps":900000}"#
}

/// Sends a request and does not wait for its answer.
fn begin(service: &Service, path: &str, body: &str) -> Client {
    let mut client = service.client();
    client.raw(
        format!("POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n{body}", body.len()).as_bytes(),
    );
    client
}

#[track_caller]
fn check_overloaded(answer: &Answer, what: &str) {
    assert_eq!((answer.status, answer.json()["code"].as_str()), (503, Some("overloaded")), "{}", answer.text());
    assert_eq!(answer.header("retry-after"), Some("1"));
    assert!(answer.text().contains(what), "{}", answer.text());
}

#[test]
fn a_world_has_a_queue_with_an_end() {
    let service = Service::with(|config| {
        config.world_queue_max = 1;
        config.queue_timeout_ms = 300;
    });
    let mut client = service.client();
    let body = long_world(&mut client, "a");
    let advancing = begin(&service, "/v1/worlds/a/advance", body);
    wait_for_in_flight(service.address, 1);
    let mut waiting = begin(&service, "/v1/worlds/a/advance", r#"{"duration":1}"#);
    wait_for_in_flight(service.address, 2);
    check_overloaded(&client.get("/v1/worlds/a/state"), "wait for the world already");
    check_overloaded(&waiting.answer(false), "the world was not free within 300 ms");
    let metrics = client.get("/metrics").text().to_owned();
    assert!(metrics.contains("\npointmass_queue_depth{queue=\"world\"} 0\n"), "{metrics}");
    // The list of worlds, and other worlds, do not wait.
    client.get("/v1/worlds").expect(200);
    client.put("/v1/worlds/b", "").expect(201);
    drop(advancing);
    let free = std::iter::repeat_with(|| client.get("/v1/worlds/a")).take(100_000).find(|answer| answer.status == 200);
    assert_eq!(free.expect("in the end").json()["revision"], 1);
}

#[test]
fn long_advances_wait_for_a_place_and_not_for_ever() {
    let service = Service::with(|config| {
        config.threads = 1;
        config.queue_max = 1;
        config.queue_timeout_ms = 300;
    });
    let mut client = service.client();
    let worlds = ["a", "b", "c", "d"];
    let body = worlds.map(|world| long_world(&mut client, world))[0];
    let path = |world: &str| format!("/v1/worlds/{world}/advance");
    // Twice as many places as threads.
    let advancing = [begin(&service, &path("a"), body), begin(&service, &path("b"), body)];
    wait_for_in_flight(service.address, 2);
    while client.get("/v1/worlds/a/digest").status == 200 || client.get("/v1/worlds/b/digest").status == 200 {}
    let mut waiting = begin(&service, &path("c"), body);
    wait_for_in_flight(service.address, 3);
    let not_ready = std::iter::repeat_with(|| client.get("/readyz")).take(100_000).find(|answer| answer.status == 503);
    check_overloaded(&not_ready.expect("the queue is full"), "--queue-max");
    check_overloaded(&client.post(&path("d"), body), "wait for a place for a long advance already");
    check_overloaded(&waiting.answer(false), "a place for a long advance was not free within 300 ms");
    client.get("/readyz").expect(200);
    client.post(&path("c"), r#"{"duration":1}"#).expect(200);
    drop(advancing);
    for world in ["a", "b"] {
        let read = || client.get(&format!("/v1/worlds/{world}"));
        let free = std::iter::repeat_with(read).take(100_000).find(|answer| answer.status == 200);
        assert_eq!(free.expect("in the end").json()["revision"], 1, "cancelled");
    }
}

/// What bodies and answers take together has an end too, and comes back when they are through.
#[test]
fn requests_in_flight_share_a_budget() {
    let service = Service::with(|config| config.in_flight_bytes_max = 3 << 19);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    client.post("/v1/worlds/a/particles", r#"{"count":5000,"velocity":[0.1,0.2,0.3]}"#).expect(201);
    let body = format!("[{}{{}}]", "{},".repeat(200));
    client.post("/v1/worlds/a/particles", &body).expect(201);
    // A body that is announced and does not come holds its part.
    let mut slow = service.client();
    slow.raw(b"POST /v1/worlds/a/particles HTTP/1.1\r\nhost: localhost\r\ncontent-length: 95000\r\n\r\n[");
    wait_for_in_flight(service.address, 1);
    check_overloaded(&client.post("/v1/worlds/a/particles", &body), "--in-flight-bytes-max");
    check_overloaded(&client.get("/v1/worlds/a/state"), "--in-flight-bytes-max");
    client.post("/v1/worlds/a/advance", r#"{"duration":1}"#).expect(200);
    drop(slow);
    let through = || client.get("/v1/worlds/a/state?fields=velocity");
    let free = std::iter::repeat_with(through).take(100_000).find(|answer| answer.status == 200);
    free.expect("in the end");
    // An answer that nobody reads, too: the system holds some of it, the service the rest.
    client.impatient(Duration::from_secs(20));
    for _ in 0..100 {
        client.get("/v1/worlds/a/state?fields=velocity").expect(200);
    }
    assert!(client.get("/metrics").text().contains("\npointmass_in_flight_charged_bytes 0\n"));
}

/// A list of more particles than may be is refused before it takes the memory of that many.
#[test]
fn what_a_list_becomes_is_known_before_it_is_parsed() {
    let service = Service::with(|config| config.particles_max = 10);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    let list = |count: usize, end: &str| format!("[{}{{}}{end}", "{},".repeat(count - 1));
    let refused = client.post("/v1/worlds/a/particles", &list(1_000_000, "]")).expect(422);
    assert_eq!(refused.json()["code"], "limit_reached");
    assert!(refused.text().contains("--particles-max"));
    client.post("/v1/worlds/a/particles", &list(11, "")).expect(400);
    client.post("/v1/worlds/a/particles", &list(10, "]")).expect(201);
}
