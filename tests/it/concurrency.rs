//! Many clients at once: order within a world, independence between worlds, and clients that go away.

use std::sync::Barrier;
use std::thread;

use serde_json::json;

use crate::service::{Client, Service, wait_for_in_flight};

/// With two thousand particles two billion particle-steps: much longer than any other request of these tests.
const LONG_ADVANCE: &str = "{\"duration\":1,\"steps\":1000000}";

fn long_world(client: &mut Client, path: &str) {
    client.put(path, "{\"integrator\":\"newton_euler\"}").expect(201);
    client.post(&format!("{path}/particles"), "{\"count\":2000,\"velocity\":[1,0,0]}").expect(201);
}

#[test]
fn of_two_writers_with_one_etag_one_wins() {
    let service = Service::start();
    service.client().put("/v1/worlds/a", "").expect(201);
    for round in 0..50 {
        let tag = format!("\"{round}\"");
        let start = Barrier::new(4);
        let statuses: Vec<u16> = thread::scope(|scope| {
            let writers: Vec<_> = (0..4)
                .map(|_| {
                    scope.spawn(|| {
                        let mut client = service.client();
                        start.wait();
                        client.send("POST", "/v1/worlds/a/particles", &[("if-match", &tag)], Some(b"{}")).status
                    })
                })
                .collect();
            writers.into_iter().map(|writer| writer.join().expect("a status")).collect()
        });
        assert_eq!(statuses.iter().filter(|status| **status == 201).count(), 1, "{statuses:?}");
        assert_eq!(statuses.iter().filter(|status| **status == 412).count(), 3, "{statuses:?}");
    }
    assert_eq!(service.client().get("/v1/worlds/a").json()["particle_count"], 50);
}

#[test]
fn many_clients_in_many_worlds_lose_nothing() {
    let service = Service::start();
    for world in 0..4 {
        service.client().put(&format!("/v1/worlds/w{world}"), "{\"integrator\":\"newton_euler\"}").expect(201);
        service.client().post(&format!("/v1/worlds/w{world}/particles"), "{}").expect(201);
    }
    let revisions: Vec<u64> = thread::scope(|scope| {
        let clients: Vec<_> = (0..8)
            .map(|n| {
                let service = &service;
                scope.spawn(move || {
                    let mut client = service.client();
                    let path = format!("/v1/worlds/w{}", n % 4);
                    let mut last = 0;
                    for _ in 0..100 {
                        client.post(&format!("{path}/particles/0/impulse"), "{\"impulse\":[1,0,0]}").expect(200);
                        let advanced =
                            client.post(&format!("{path}/advance"), "{\"duration\":0.25}").expect(200).json();
                        let revision = advanced["revision"].as_u64().expect("a number");
                        assert!(revision > last, "a client sees its own changes in order");
                        last = revision;
                    }
                    last
                })
            })
            .collect();
        clients.into_iter().map(|client| client.join().expect("a revision")).collect()
    });
    assert!(revisions.iter().all(|revision| *revision <= 401));
    for world in 0..4 {
        let mut client = service.client();
        let path = format!("/v1/worlds/w{world}");
        let description = client.get(&path).json();
        assert_eq!((&description["time"], &description["revision"]), (&json!(50.0), &json!(401)));
        assert_eq!(client.get(&format!("{path}/particles/0")).json()["velocity"][0], 200.0);
    }
}

#[test]
fn a_long_advance_holds_up_nobody_else() {
    let service = Service::with(|config| config.workers = 1);
    let mut client = service.client();
    long_world(&mut client, "/v1/worlds/long");
    client.put("/v1/worlds/other", "").expect(201);
    thread::scope(|scope| {
        let long = scope.spawn(|| service.client().post("/v1/worlds/long/advance", LONG_ADVANCE).expect(200));
        let mut answered = 0;
        while !long.is_finished() {
            client.get("/healthz").expect(200);
            client.post("/v1/worlds/other/advance", "{\"duration\":1}").expect(200);
            let listed = client.get("/v1/worlds").expect(200).json();
            assert_eq!(listed["worlds"][0]["world"], "long", "a list does not wait either");
            answered += 1;
        }
        long.join().expect("the long advance");
        assert!(answered > 20, "{answered} rounds while one world advanced");
    });
}

#[test]
fn reads_wait_for_the_advance_before_them() {
    let service = Service::start();
    let mut client = service.client();
    long_world(&mut client, "/v1/worlds/long");
    client.raw(
        format!(
            "POST /v1/worlds/long/advance HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n{LONG_ADVANCE}",
            LONG_ADVANCE.len()
        )
        .as_bytes(),
    );
    wait_for_in_flight(service.address, 1);
    // This one was accepted after the advance, so it sees its result.
    assert_eq!(service.client().get("/v1/worlds/long").expect(200).json()["time"], 1.0);
    client.answer(false).expect(200);
}

#[test]
fn a_client_that_goes_away_leaves_the_world_as_it_was() {
    let service = Service::start();
    let mut client = service.client();
    let path = "/v1/worlds/long";
    client.put(path, "{\"integrator\":\"newton_euler\"}").expect(201);
    // A minute of work, if nobody stopped it.
    client.post(&format!("{path}/particles"), "{\"count\":20000,\"velocity\":[1,0,0]}").expect(201);
    let mut leaving = service.client();
    leaving.raw(
        format!(
            "POST {path}/advance HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n{LONG_ADVANCE}",
            LONG_ADVANCE.len()
        )
        .as_bytes(),
    );
    wait_for_in_flight(service.address, 1);
    drop(leaving);
    let description = client.get(path).expect(200).json();
    assert_eq!((&description["time"], &description["revision"]), (&json!(0.0), &json!(1)));
    assert_eq!(client.get(&format!("{path}/particles/19999")).json()["position"], json!([0.0, 0.0, 0.0]));
}

#[test]
fn a_client_that_goes_away_ends_its_trajectory() {
    let service = Service::with(|config| config.interactions_max = u64::MAX);
    let mut client = service.client();
    let path = "/v1/worlds/long";
    client.put(path, "{\"integrator\":\"rk4\",\"max_step\":0.01,\"forces\":{\"gravitation\":{}}}").expect(201);
    // Hours of work, if nobody stopped it.
    client.post(&format!("{path}/particles"), "{\"count\":2000}").expect(201);
    let mut leaving = service.client();
    leaving
        .raw(format!("GET {path}/particles/0/trajectory?duration=9999 HTTP/1.1\r\nhost: localhost\r\n\r\n").as_bytes());
    wait_for_in_flight(service.address, 1);
    drop(leaving);
    client.get(path).expect(200);
}

#[test]
fn a_deleted_world_is_gone_for_those_who_waited() {
    let service = Service::start();
    let mut client = service.client();
    long_world(&mut client, "/v1/worlds/long");
    let request = format!(
        "POST /v1/worlds/long/advance HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n{LONG_ADVANCE}",
        LONG_ADVANCE.len()
    );
    client.raw(request.as_bytes());
    wait_for_in_flight(service.address, 1);
    thread::scope(|scope| {
        let delete = scope.spawn(|| service.client().delete("/v1/worlds/long").status);
        wait_for_in_flight(service.address, 2);
        // This one knows the world, and waits behind the one that deletes it.
        let waiting = scope.spawn(|| service.client().post("/v1/worlds/long/particles", "{}").status);
        wait_for_in_flight(service.address, 3);
        assert_eq!((delete.join().expect("a status"), waiting.join().expect("a status")), (204, 404));
    });
    client.answer(false).expect(200);
}

/// However many long advances there are, short ones and reads of other worlds go on.
#[test]
fn long_advances_leave_room_for_everything_else() {
    let service = Service::with(|config| config.threads = 1);
    let mut client = service.client();
    client.put("/v1/worlds/other", "").expect(201);
    client.post("/v1/worlds/other/particles", "{\"count\":30000}").expect(201);
    let mut long: Vec<Client> = (0..6)
        .map(|n| {
            let path = format!("/v1/worlds/long{n}");
            long_world(&mut client, &path);
            let mut advancing = service.client();
            advancing.raw(
                format!(
                    "POST {path}/advance HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n{LONG_ADVANCE}",
                    LONG_ADVANCE.len()
                )
                .as_bytes(),
            );
            advancing
        })
        .collect();
    wait_for_in_flight(service.address, 6);
    for _ in 0..5 {
        let state = client.get("/v1/worlds/other/state").expect(200).json();
        assert_eq!(state["count"], 30_000);
        client.post("/v1/worlds/other/advance", "{\"duration\":1}").expect(200);
        // A world whose advance waits for its place is free.
        client.get("/v1/worlds/long5").expect(200);
    }
    let still = client.get("/metrics").text().contains("\npointmass_in_flight 1\n");
    assert!(!still, "the long ones are still at work");
    drop(long.split_off(1));
    long.remove(0).answer(false).expect(200);
}
