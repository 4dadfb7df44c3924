//! What each route answers when all is well: shapes, headers, pages, conditions.

use serde_json::{Value, json};

use crate::service::{Client, Service, shared};

/// A new world in a shared service.
fn world(name: &str, settings: &str) -> (Client, String) {
    let mut client = shared().client();
    let path = format!("/v1/worlds/{name}");
    client.put(&path, settings).expect(201);
    (client, path)
}

#[test]
fn a_world_is_created_described_configured_and_deleted() {
    let mut client = shared().client();
    let path = "/v1/worlds/life";
    let created = client.put(path, "").expect(201);
    assert_eq!((created.header("location"), created.header("etag")), (Some(path), Some("\"0\"")));
    let description = json!({
        "world": "life", "precision": "double", "integrator": "exact", "gravity": [0.0, 0.0, 0.0],
        "damping_law": "per_second", "max_step": null, "time": 0.0, "step_count": 0, "particle_count": 0, "revision": 0
    });
    assert_eq!(created.json(), description);
    assert_eq!(client.get(path).expect(200).json(), description);
    let change = "{\"gravity\":\"shooter\",\"integrator\":\"semi_implicit_euler\",\"damping_law\":\"per_step\",\"max_step\":0.25}";
    let configured = client.patch(path, change).expect(200);
    assert_eq!(configured.header("etag"), Some("\"1\""));
    let configured = configured.json();
    assert_eq!(configured["gravity"], json!([0.0, -15.0, 0.0]));
    assert_eq!((&configured["damping_law"], &configured["max_step"]), (&json!("per_step"), &json!(0.25)));
    assert_eq!(client.post(&format!("{path}/advance"), "{\"duration\":1}").expect(200).json()["steps"], 4);
    assert_eq!(client.patch(path, "{\"max_step\":null}").expect(200).json()["max_step"], Value::Null);
    assert_eq!(client.post(&format!("{path}/advance"), "{\"duration\":1}").expect(200).json()["steps"], 1);
    assert_eq!(client.patch(path, "{}").expect(200).json()["revision"], 5);
    client.delete(path).expect(204);
    client.get(path).expect(404);
    assert_eq!(client.put(path, "{}").expect(201).json()["revision"], 0);
}

#[test]
fn gravities_have_names() {
    for (name, y) in [("standard", -9.80665), ("textbook", -10.0), ("shooter", -15.0), ("driving", -20.0)] {
        for precision in ["single", "double"] {
            let settings = format!("{{\"gravity\":\"{name}\",\"precision\":\"{precision}\"}}");
            let (mut client, path) = world(&format!("gravity-{name}-{precision}"), &settings);
            // A single is written with the digits of a single.
            assert_eq!(client.get(&path).json()["gravity"], json!([0.0, y, 0.0]), "{name} {precision}");
        }
    }
}

#[test]
fn the_service_names_worlds_that_have_no_name() {
    let mut client = shared().client();
    let created = client.post("/v1/worlds", "{\"precision\":\"single\"}").expect(201);
    let path = created.header("location").expect("a place").to_owned();
    assert_eq!(path, format!("/v1/worlds/{}", created.json()["world"].as_str().expect("a name")));
    assert_eq!(client.get(&path).expect(200).json()["precision"], "single");
    client.delete(&path).expect(204);
}

#[test]
fn worlds_are_listed_in_pages() {
    let service = Service::start();
    let mut client = service.client();
    assert_eq!(client.get("/v1/worlds").expect(200).json(), json!({"worlds": [], "next_after": null}));
    for name in ["c", "a", "b", "B"] {
        client.put(&format!("/v1/worlds/{name}"), "").expect(201);
    }
    client.post("/v1/worlds/b/particles", "{}").expect(201);
    let mut names = |query: &str| {
        let page = client.get(&format!("/v1/worlds{query}")).expect(200).json();
        let names: Vec<String> = page["worlds"]
            .as_array()
            .expect("a list")
            .iter()
            .map(|world| format!("{}{}", world["world"].as_str().expect("a name"), world["particle_count"]))
            .collect();
        (names.join(" "), page["next_after"].clone())
    };
    assert_eq!(names(""), ("B0 a0 b1 c0".to_owned(), Value::Null));
    assert_eq!(names("?limit=3"), ("B0 a0 b1".to_owned(), json!("b")));
    assert_eq!(names("?limit=3&after=b"), ("c0".to_owned(), Value::Null));
    assert_eq!(names("?limit=4"), ("B0 a0 b1 c0".to_owned(), Value::Null));
}

#[test]
fn particles_are_created_in_three_shapes() {
    let (mut client, path) = world("shapes", "{\"gravity\":[0,-2,0]}");
    let particles = format!("{path}/particles");
    let one = client.post(&particles, "{\"position\":[1,2,3],\"mass\":4}").expect(201);
    assert_eq!((one.header("location"), one.header("etag")), (Some(&*format!("{particles}/0")), Some("\"1\"")));
    let expected = json!({
        "id": 0, "position": [1.0, 2.0, 3.0], "velocity": [0.0, 0.0, 0.0], "acceleration": [0.0, -2.0, 0.0],
        "own_acceleration": null, "damping": 1.0, "mass": 4.0, "inverse_mass": 0.25, "force": [0.0, 0.0, 0.0]
    });
    assert_eq!(one.json(), expected);
    assert_eq!(client.get(&format!("{particles}/0")).expect(200).json(), expected);
    let list =
        client.post(&particles, " [{\"acceleration\":[0,1,0]},{\"inverse_mass\":0,\"acceleration\":null}]").expect(201);
    assert_eq!(list.json(), json!({"first_id": 1, "count": 2}));
    let columns = "{\"count\":3,\"position\":[[1,0,0],[2,0,0],[3,0,0]],\"velocity\":[0,5,0],\
        \"acceleration\":[null,[7,7,7],null],\"damping\":0.99,\"inverse_mass\":[1,0,3]}";
    let columns = client.post(&particles, columns).expect(201);
    assert_eq!(columns.json(), json!({"first_id": 3, "count": 3}));
    assert_eq!(client.post(&particles, "[]").expect(201).json(), json!({"first_id": 6, "count": 0}));
    assert_eq!(client.post(&particles, "{\"count\":0}").expect(201).json(), json!({"first_id": 6, "count": 0}));
    let read =
        client.get(&format!("{path}/state?fields=own_acceleration,acceleration,mass,damping")).expect(200).json();
    assert_eq!(read["id"], json!([0, 1, 2, 3, 4, 5]));
    assert_eq!(read["own_acceleration"], json!([null, [0.0, 1.0, 0.0], null, null, [7.0, 7.0, 7.0], null]));
    assert_eq!(read["acceleration"][2], json!([0.0, 0.0, 0.0]), "an immovable particle does not fall");
    assert_eq!(read["mass"], json!([4.0, 1.0, null, 1.0, null, 1.0 / 3.0]));
    assert_eq!(read["damping"], json!([1.0, 1.0, 1.0, 0.99, 0.99, 0.99]));
    assert!(read.get("position").is_none());
}

#[test]
fn particles_are_read_in_pages_and_parts() {
    let (mut client, path) = world("pages", "");
    let particles = format!("{path}/particles");
    client.post(&particles, "{\"count\":1500}").expect(201);
    for id in [1, 3] {
        client.delete(&format!("{particles}/{id}")).expect(204);
    }
    let mut ids = |query: &str| {
        let page = client.get(&format!("{particles}{query}")).expect(200).json();
        let ids: Vec<u64> =
            page["particles"].as_array().expect("a list").iter().map(|p| p["id"].as_u64().expect("an id")).collect();
        (ids, page["next_after"].as_u64())
    };
    assert_eq!(ids("?limit=4"), (vec![0, 2, 4, 5], Some(5)));
    assert_eq!(ids("?limit=2&after=2"), (vec![4, 5], Some(5)));
    assert_eq!(ids("?after=1497"), (vec![1498, 1499], None));
    assert_eq!(ids("?after=18446744073709551615"), (vec![], None));
    assert_eq!(ids("?ids=7,2,7"), (vec![2, 7], None));
    assert_eq!(ids("?ids=7,2,5&limit=2"), (vec![2, 5], Some(5)));
    assert_eq!(ids("?ids=7,2,5&after=2"), (vec![5, 7], None));
    let (first, next) = ids("");
    assert_eq!((first.len(), next), (1000, Some(1001)));
    let page = client.get(&format!("{particles}?ids=0&fields=mass,position")).json();
    assert_eq!(page["particles"], json!([{"id": 0, "position": [0.0, 0.0, 0.0], "mass": 1.0}]));
    assert_eq!(client.get(&format!("{path}/state")).json()["count"], 1498);
}

#[test]
fn a_removed_id_is_never_used_again() {
    let (mut client, path) = world("removed", "");
    let particles = format!("{path}/particles");
    client.post(&particles, "{\"count\":2}").expect(201);
    client.delete(&format!("{particles}/1")).expect(204);
    client.delete(&format!("{particles}/1")).expect(404);
    assert_eq!(client.post(&particles, "{}").expect(201).json()["id"], 2);
}

#[test]
fn properties_are_set_for_one_and_for_many() {
    let (mut client, path) = world("set", "{\"gravity\":\"textbook\"}");
    let particles = format!("{path}/particles");
    client.post(&particles, "{\"count\":4}").expect(201);
    let one = client
        .patch(&format!("{particles}/1"), "{\"acceleration\":[1,0,0],\"damping\":0.5,\"inverse_mass\":4}")
        .expect(200)
        .json();
    assert_eq!(
        (&one["own_acceleration"], &one["mass"], &one["damping"]),
        (&json!([1.0, 0.0, 0.0]), &json!(0.25), &json!(0.5))
    );
    let one = client.patch(&format!("{particles}/1"), "{\"acceleration\":null}").expect(200).json();
    assert_eq!((&one["own_acceleration"], &one["acceleration"]), (&Value::Null, &json!([0.0, -10.0, 0.0])));
    let mass = client.put(&format!("{particles}/2/mass"), "{\"mass\":3}").expect(200).json();
    assert_eq!((&mass["mass"], &mass["inverse_mass"]), (&json!(1.0 / (1.0 / 3.0)), &json!(1.0 / 3.0)));
    let mass = client.put(&format!("{particles}/2/mass"), "{\"inverse_mass\":-0.0}").expect(200);
    assert!(mass.text().contains("\"mass\":null,\"inverse_mass\":0.0"), "{}", mass.text());
    let many = client.patch(&particles, "{\"ids\":[0,3],\"mass\":[5,6],\"damping\":0.75}").expect(200).json();
    assert_eq!(many, json!({"count": 2, "revision": 6}));
    let many = client
        .patch(&particles, "{\"damping\":[0.1,0.2,0.3,0.4],\"acceleration\":[null,[1,1,1],null,null]}")
        .expect(200)
        .json();
    assert_eq!(many["count"], 4);
    let state = client.get(&format!("{path}/state?fields=damping,mass,own_acceleration")).json();
    assert_eq!(state["damping"], json!([0.1, 0.2, 0.3, 0.4]));
    assert_eq!(state["mass"], json!([5.0, 0.25, null, 6.0]));
    assert_eq!(state["own_acceleration"], json!([null, [1.0, 1.0, 1.0], null, null]));
}

#[test]
fn forces_add_up_and_are_cleared_by_an_advance() {
    let (mut client, path) = world("forces", "{\"integrator\":\"newton_euler\"}");
    let particles = format!("{path}/particles");
    client.post(&particles, "[{\"mass\":2},{\"mass\":4},{\"inverse_mass\":0}]").expect(201);
    client.post(&format!("{particles}/0/force"), "{\"force\":[4,0,0]}").expect(200);
    let added = client.post(&format!("{particles}/0/force"), "{\"force\":[0,8,0]}").expect(200).json();
    assert_eq!(added["force"], json!([4.0, 8.0, 0.0]));
    let many = client
        .post(&format!("{path}/forces"), "{\"ids\":[1,2,1],\"force\":[[4,0,0],[9,9,9],[4,0,0]]}")
        .expect(200)
        .json();
    assert_eq!(many, json!({"count": 3, "revision": 4}));
    let all = client.post(&format!("{path}/forces"), "{\"ids\":[0,1],\"force\":[0,0,-8]}").expect(200).json();
    assert_eq!(all["count"], 2);
    let advanced = client
        .post(&format!("{path}/advance"), "{\"duration\":0.5,\"steps\":2,\"return\":[\"velocity\",\"force\"]}")
        .expect(200)
        .json();
    // The momentum of a force is F T, however finely the advance is cut.
    assert_eq!(advanced["state"]["velocity"], json!([[1.0, 2.0, -2.0], [1.0, 0.0, -1.0], [0.0, 0.0, 0.0]]));
    assert_eq!(advanced["state"]["force"], json!([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]));
    assert_eq!((&advanced["integrated"], &advanced["skipped"]), (&json!(2), &json!(1)));
    let kicked = client.post(&format!("{particles}/0/impulse"), "{\"impulse\":[2,0,0]}").expect(200).json();
    assert_eq!(kicked["velocity"], json!([2.0, 2.0, -2.0]));
    let placed = client.post(&format!("{particles}/0/place"), "{\"position\":[9,9,9]}").expect(200).json();
    assert_eq!((&placed["position"], &placed["velocity"]), (&json!([9.0, 9.0, 9.0]), &json!([2.0, 2.0, -2.0])));
    let placed = client.post(&format!("{particles}/0/place"), "{\"velocity\":[0,0,0]}").expect(200).json();
    assert_eq!((&placed["position"], &placed["velocity"]), (&json!([9.0, 9.0, 9.0]), &json!([0.0, 0.0, 0.0])));
}

#[test]
fn an_advance_reports_what_it_did() {
    let (mut client, path) = world("report", "{\"gravity\":\"textbook\"}");
    client
        .post(&format!("{path}/particles"), "[{},{},{\"inverse_mass\":0},{\"inverse_mass\":0,\"velocity\":[1,0,0]}]")
        .expect(201);
    client.post(&format!("{path}/particles/1/force"), "{\"force\":[1,0,0]}").expect(200);
    let advance = format!("{path}/advance");
    let exact = client.post(&advance, "{\"duration\":0.5,\"steps\":7}").expect(200);
    assert_eq!(exact.header("etag"), Some("\"3\""));
    let expected = json!({
        "time": 0.5, "duration": 0.5, "steps": 1, "step": 0.5, "step_count": 1,
        "integrated": 1, "deferred": 2, "skipped": 1, "revision": 3
    });
    assert_eq!(exact.json(), expected);
    client.patch(&path, "{\"integrator\":\"newton_euler\"}").expect(200);
    let stepped = client.post(&advance, "{\"duration\":1,\"max_step\":0.3}").expect(200).json();
    let expected = json!({
        "time": 1.5, "duration": 1.0, "steps": 4, "step": 0.25, "step_count": 5,
        "integrated": 3, "deferred": 0, "skipped": 1, "revision": 5
    });
    assert_eq!(stepped, expected);
}

#[test]
fn a_dry_run_answers_what_would_be_and_changes_nothing() {
    let (mut client, path) = world("dry", "{\"gravity\":\"textbook\"}");
    client.post(&format!("{path}/particles"), "{}").expect(201);
    client.post(&format!("{path}/particles/0/force"), "{\"force\":[1,0,0]}").expect(200);
    let before = client.get(&format!("{path}/particles")).expect(200);
    let body = "{\"duration\":1,\"return\":[\"position\"],\"dry_run\":true}";
    let advance = format!("{path}/advance");
    client.send("POST", &advance, &[("if-match", "\"1\"")], Some(body.as_bytes())).expect(412);
    let dry = client.send("POST", &advance, &[("if-match", "\"2\"")], Some(body.as_bytes())).expect(200);
    assert_eq!(dry.header("etag"), Some("\"2\""));
    assert_eq!(client.get(&format!("{path}/particles")).text(), before.text());
    let wet = client.post(&advance, "{\"duration\":1,\"return\":[\"position\"]}").expect(200).json();
    let mut dry = dry.json();
    assert_eq!((&dry["revision"], &wet["revision"]), (&json!(2), &json!(3)));
    dry["revision"] = json!(3);
    assert_eq!(dry, wet);
}

#[test]
fn revisions_guard_changes_and_spare_reads() {
    let (mut client, path) = world("tags", "");
    let particles = format!("{path}/particles");
    client.post(&particles, "{}").expect(201);
    let etag = client.get(&path).header("etag").expect("a tag").to_owned();
    assert_eq!(etag, "\"1\"");
    for read in [
        path.clone(),
        particles.clone(),
        format!("{particles}/0"),
        format!("{path}/state"),
        format!("{path}/digest"),
        format!("{particles}/0/trajectory?duration=1"),
    ] {
        assert_eq!(client.get(&read).header("etag"), Some("\"1\""), "{read}");
        for tags in ["\"1\"", "W/\"1\"", "*", "\"7\", \"1\""] {
            let unchanged = client.send("GET", &read, &[("if-none-match", tags)], None).expect(304);
            assert_eq!((unchanged.body.len(), unchanged.header("etag")), (0, Some("\"1\"")));
        }
        client.send("GET", &read, &[("if-none-match", "\"2\"")], None).expect(200);
    }
    let body = Some("{\"damping\":1}".as_bytes());
    // A change counts although no value changed; so the same tag does not serve twice.
    assert_eq!(
        client.send("PATCH", &particles, &[("if-match", &etag)], body).expect(200).header("etag"),
        Some("\"2\"")
    );
    client.send("PATCH", &particles, &[("if-match", &etag)], body).expect(412);
    client.send("PATCH", &particles, &[("if-match", "*")], body).expect(200);
    client.send("DELETE", &format!("{particles}/0"), &[("if-match", &etag)], None).expect(412);
    client.send("DELETE", &path, &[("if-match", &etag)], None).expect(412);
    client.send("DELETE", &path, &[("if-match", "\"3\"")], None).expect(204);
}

#[test]
fn bodies_are_json_whatever_a_plain_client_calls_them() {
    let (mut client, path) = world("types", "");
    client.post(&format!("{path}/particles"), "{}").expect(201);
    let mass = format!("{path}/particles/0/mass");
    let types = [
        "application/json",
        "application/json; charset=utf-8",
        "text/plain",
        "application/x-www-form-urlencoded",
        "Text/Json",
    ];
    for content_type in types {
        client.send("PUT", &mass, &[("content-type", content_type)], Some(b"{\"mass\":2}")).expect(200);
    }
    for accept in ["*/*", "application/json", "text/html, application/*;q=0.1"] {
        client.send("GET", &path, &[("accept", accept)], None).expect(200);
    }
}

#[test]
fn requests_keep_their_ids_and_get_one_otherwise() {
    let mut client = shared().client();
    let own = client.send("GET", "/v1", &[("x-request-id", "abc-123")], None).expect(200);
    assert_eq!(own.header("x-request-id"), Some("abc-123"));
    let refused = client.send("GET", "/nowhere", &[("x-request-id", "abc-124")], None).expect(404);
    assert_eq!(refused.header("x-request-id"), Some("abc-124"));
    let made: Vec<String> =
        (0..2).map(|_| client.get("/v1").header("x-request-id").expect("made").to_owned()).collect();
    assert_ne!(made[0], made[1]);
    assert_ne!(client.send("GET", "/v1", &[("x-request-id", "")], None).header("x-request-id"), Some(""));
    let long = "x".repeat(500);
    assert_ne!(client.send("GET", "/v1", &[("x-request-id", &long)], None).header("x-request-id"), Some(&*long));
}

#[test]
fn the_service_tells_about_itself() {
    let mut client = shared().client();
    assert_eq!(client.get("/healthz").expect(200).json(), json!({"status": "ok"}));
    assert_eq!(client.get("/readyz").expect(200).json(), json!({"status": "ready"}));
    let service = client.get("/v1").expect(200).json();
    assert_eq!(service["name"], "pointmass");
    assert_eq!(service["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(
        service["integrators"],
        json!([
            "exact",
            "newton_euler",
            "newton_euler_quadratic",
            "semi_implicit_euler",
            "velocity_verlet",
            "rk4",
            "dop853"
        ])
    );
    assert_eq!(service["limits"]["steps_max"], 1_000_000);
    let head = client.send("HEAD", "/v1", &[], None).expect(200);
    assert!(head.body.is_empty());
    let metrics = client.get("/metrics").expect(200);
    assert!(metrics.header("content-type").is_some_and(|text| text.starts_with("application/openmetrics-text")));
    assert!(metrics.text().ends_with("# EOF\n"));
    // The one of the shared service has other worlds too.
    let service = Service::start();
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    client.post("/v1/worlds/a/particles", r#"{"count":3,"inverse_mass":[1,1,0]}"#).expect(201);
    client.post("/v1/worlds/a/advance", r#"{"duration":1}"#).expect(200);
    client.patch("/v1/worlds/a", r#"{"integrator":"newton_euler"}"#).expect(200);
    client.post("/v1/worlds/a/advance", r#"{"duration":1,"steps":5}"#).expect(200);
    let metrics = client.get("/metrics").text().to_owned();
    for line in [
        "pointmass_requests_total{method=\"POST\",route=\"/v1/worlds/{world}/advance\",status=\"200\"} 2",
        "pointmass_request_duration_seconds_count{method=\"PUT\",route=\"/v1/worlds/{world}\"} 1",
        "pointmass_advances_total 2",
        "pointmass_particle_steps_total 10",
        "pointmass_particles_deferred_total 2",
        "pointmass_particles_skipped_total 2",
        "pointmass_connections 1",
        "pointmass_worlds 1",
        "pointmass_particles 3",
        "pointmass_in_flight 1",
        "pointmass_worlds_charged_bytes 768",
        "pointmass_in_flight_charged_bytes 0",
        "pointmass_queue_depth{queue=\"world\"} 0",
        "pointmass_queue_age_seconds{queue=\"processor\"} 0.0",
        concat!("pointmass_build_info{version=\"", env!("CARGO_PKG_VERSION"), "\"} 1"),
    ] {
        assert!(metrics.lines().any(|other| other == line), "{line} is not in\n{metrics}");
    }
    assert!(metrics.contains("pointmass_resident_memory_bytes "));
}

#[test]
fn methods_nobody_heard_of_do_not_grow_the_metrics() {
    let service = Service::start();
    let mut client = service.client();
    for n in 0..50 {
        client.send(&format!("METHOD{n}"), "/v1", &[], None).expect(405);
        client.send("GET", &format!("/nowhere/{n}"), &[], None).expect(404);
    }
    let lines = client.get("/metrics").text().lines().filter(|line| line.starts_with("pointmass_requests_t")).count();
    assert_eq!(lines, 2);
}

#[test]
fn minus_zero_is_kept_where_it_means_something() {
    for precision in ["single", "double"] {
        let (mut client, path) =
            world(&format!("zero-{precision}"), &format!("{{\"precision\":\"{precision}\",\"gravity\":[-0.0,0,0]}}"));
        let body = "{\"position\":[-0.0,0,-0],\"velocity\":[0,-0.0,0],\"acceleration\":[-0.0,0,0],\"damping\":-0.0,\"inverse_mass\":-0.0}";
        let created = client.post(&format!("{path}/particles"), body).expect(201);
        let expected = "{\"id\":0,\"position\":[-0.0,0.0,-0.0],\"velocity\":[0.0,-0.0,0.0],\"acceleration\":[0.0,0.0,0.0],\
            \"own_acceleration\":[0.0,0.0,0.0],\"damping\":0.0,\"mass\":null,\"inverse_mass\":0.0,\"force\":[0.0,0.0,0.0]}\n";
        assert_eq!(created.text(), expected);
        assert!(client.get(&path).text().contains("\"gravity\":[0.0,0.0,0.0]"));
    }
}
