//! Several commands in one request: one change of a world, or none.

use std::sync::OnceLock;
use std::time::{Duration, Instant};

use pointmass::{Command, Error, Integrator, Outcome, ParticleId, Precision, Settings, World};
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::lockstep::{Lockstep, Number, Step, steps, vector};
use crate::service::{Answer, Client, Service, wait_for_in_flight};

fn service() -> &'static Service {
    static SERVICE: OnceLock<Service> = OnceLock::new();
    SERVICE.get_or_init(Service::start)
}

fn commands(list: &[Value]) -> String {
    json!({ "commands": list }).to_string()
}

/// All that can be read of a world.
fn everything(client: &mut Client, path: &str) -> Vec<String> {
    ["", "/digest", "/particles", "/state?fields=force,mass,damping,own_acceleration"]
        .map(|end| client.get(&format!("{path}{end}")).expect(200).text().to_owned())
        .to_vec()
}

/// A batch, as one request, as one call, and as one command after the other.
fn step<R: Number>(lockstep: &mut Lockstep<R>, batch: &[Step]) -> Result<(), TestCaseError> {
    let (list, texts): (Vec<Command<R>>, Vec<Value>) = batch.iter().filter_map(|step| lockstep.member(step)).unzip();
    let body = commands(&texts);
    let before = lockstep.world.clone();
    let mut each = before.clone();
    let singly: Result<Vec<Outcome>, (usize, Error)> =
        list.iter().enumerate().map(|(index, command)| each.apply(command).map_err(|error| (index, error))).collect();
    let together = lockstep.world.apply_all(&list);
    let answer = lockstep.client.post(&format!("{}/commands", lockstep.path), &body);
    match (together, singly) {
        (Ok(outcomes), singly) => {
            prop_assert_eq!(Ok(&outcomes), singly.as_ref(), "{}", body);
            prop_assert_eq!(lockstep.world.digest(), each.digest(), "{}", body);
            let changes = u64::from(!list.is_empty());
            prop_assert_eq!(lockstep.world.revision(), before.revision() + changes, "{}", body);
            let answer = answer.expect(200).json();
            prop_assert_eq!(&answer["revision"], lockstep.world.revision(), "{}", body);
            for (outcome, result) in outcomes.iter().zip(answer["results"].as_array().expect("results")) {
                match *outcome {
                    Outcome::Created { first, count } => {
                        prop_assert_eq!(result, &json!({"first_id": first.0, "count": count}));
                        lockstep.ids.extend(first.0..first.0 + count as u64);
                    }
                    Outcome::Changed { count } => prop_assert_eq!(result, &json!({ "count": count })),
                    Outcome::Advanced(advanced) => {
                        prop_assert_eq!(result["time"].as_f64().map(f64::to_bits), Some(advanced.time.to_bits()));
                        prop_assert_eq!(&result["step_count"], advanced.step_count);
                        prop_assert_eq!(&result["revision"], &Value::Null);
                    }
                    Outcome::Configured => unreachable!("no batch has one"),
                }
            }
        }
        (Err(refused), singly) => {
            // The limits of one advance are those of all of them.
            let shared = matches!(refused.error, Error::LimitReached { .. } | Error::TooManySteps { .. });
            prop_assert!(
                shared || singly.is_err_and(|(index, error)| (index, error) == (refused.index, refused.error))
            );
            prop_assert!(answer.status >= 400, "{}: {:?}", body, answer.text());
            let place = format!("/commands/{}/", refused.index);
            let problem = answer.json();
            prop_assert!(problem["pointer"].as_str().is_some_and(|at| at.starts_with(&place)), "{}: {}", body, problem);
            prop_assert_eq!(lockstep.world.digest(), before.digest(), "{}", body);
            prop_assert_eq!(lockstep.world.revision(), before.revision(), "{}", body);
        }
    }
    lockstep.ids.retain(|id| lockstep.world.contains(ParticleId(*id)));
    lockstep.compare(&body)
}

fn run<R: Number>(integrator: Integrator, gravity: u64, batches: &[Vec<Step>]) -> Result<(), TestCaseError> {
    let settings = Settings { integrator, gravity: vector::<R>(gravity).into(), ..Settings::default() };
    let mut lockstep = Lockstep::<R>::new(settings);
    for batch in batches {
        step(&mut lockstep, batch)?;
    }
    let path = lockstep.path.clone();
    lockstep.client.delete(&path).expect(204);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 30, ..ProptestConfig::default() })]
    #[test]
    fn batches_are_their_commands_to_the_bit(steps in prop::collection::vec(steps(6), 1..6), gravity in any::<u64>()) {
        for integrator in Integrator::ALL {
            for precision in Precision::ALL {
                match precision {
                    Precision::Single => run::<f32>(integrator, gravity, &steps)?,
                    Precision::Double => run::<f64>(integrator, gravity, &steps)?,
                }
            }
        }
    }
}

#[test]
fn a_tick_is_one_request() {
    let mut client = service().client();
    client.put("/v1/worlds/tick", "").expect(201);
    let tick = commands(&[
        json!({"create": {"position": [0, 1, 0]}}),
        json!({"add_force": {"ids": [0], "force": [1, 0, 0]}}),
        json!({"advance": {"duration": 0.5, "return": ["velocity"]}}),
        json!({"read": {"fields": ["position"], "ids": [0]}}),
        json!({"create": {"count": 2, "mass": [1, 2]}}),
        json!({"set": {"damping": 0.5}}),
        json!({"impulse": {"ids": [2, 1], "impulse": [[2, 0, 0], [1, 0, 0]]}}),
        json!({"place": {"ids": [0], "velocity": [0, 0, 1]}}),
        json!({"remove": {"ids": [1]}}),
        json!({"read": {"ids": [2, 0, 2]}}),
        json!({"read": {"fields": ["damping"]}}),
    ]);
    let answer = client.post("/v1/worlds/tick/commands", &tick).expect(200);
    assert_eq!(answer.header("etag"), Some("\"1\""));
    let expected = json!({"revision": 1, "results": [
        {"first_id": 0, "count": 1},
        {"count": 1},
        {"time": 0.5, "duration": 0.5, "steps": 1, "step": 0.5, "step_count": 1, "integrated": 1, "deferred": 0,
            "skipped": 0, "state": {"time": 0.5, "count": 1, "id": [0], "velocity": [[0.5, 0.0, 0.0]]}},
        {"time": 0.5, "count": 1, "id": [0], "position": [[0.125, 1.0, 0.0]]},
        {"first_id": 1, "count": 2},
        {"count": 3},
        {"count": 2},
        {"count": 1},
        {"count": 1},
        {"time": 0.5, "count": 3, "id": [2, 0, 2],
            "position": [[0.0, 0.0, 0.0], [0.125, 1.0, 0.0], [0.0, 0.0, 0.0]],
            "velocity": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]},
        {"time": 0.5, "count": 2, "id": [0, 2], "damping": [0.5, 0.5]},
    ]});
    assert_eq!(answer.json(), expected);
    // What only reads changes nothing, and so does nothing at all.
    for body in [commands(&[json!({"read": {}}), json!({"read": {"ids": []}})]), commands(&[])] {
        let read = client.post("/v1/worlds/tick/commands", &body).expect(200);
        assert_eq!((read.header("etag"), &read.json()["revision"]), (Some("\"1\""), &json!(1)));
    }
    // If-Match guards a batch as it does a command.
    let body = commands(&[json!({"advance": {"duration": 1}})]);
    let path = "/v1/worlds/tick/commands";
    client.send("POST", path, &[("if-match", "\"0\"")], Some(body.as_bytes())).expect(412);
    client.send("POST", path, &[("if-match", "\"1\"")], Some(body.as_bytes())).expect(200);
    assert_eq!(client.get("/v1/worlds/tick").json()["revision"], 2);
}

/// Who names no particles means all of them, in ascending order of id: in a request of its own, in a batch, and where
/// there are none.
#[test]
fn without_ids_all_are_meant() {
    let mut client = service().client();
    let [named, all] = &["named", "all"].map(|name| format!("/v1/worlds/each-{name}"));
    for path in [named, all] {
        client.put(path, "").expect(201);
    }
    let each = json!([[1, 0, 0], [0, 2, 0], [0, 0, 3]]);
    let list = |ids: &Value| {
        let with_ids = |mut command: Value, name: &str| {
            if !ids.is_null() {
                command["ids"] = ids.clone();
            }
            json!({ name: command })
        };
        commands(&[
            with_ids(json!({ "force": each }), "add_force"),
            with_ids(json!({"force": [4, 5, 6]}), "add_force"),
            with_ids(json!({ "impulse": each }), "impulse"),
            with_ids(json!({"position": [7, 8, 9], "velocity": each}), "place"),
            with_ids(json!({"damping": [1, 0.5, 0.25]}), "set"),
            json!({"advance": {"duration": 0.5}}),
            with_ids(json!({ "impulse": each }), "impulse"),
            with_ids(json!({}), "read"),
        ])
    };
    // Where there is no particle, all of them are none.
    client.post(&format!("{all}/forces"), r#"{"force":[1,2,3]}"#).expect(200);
    let none = client.post(&format!("{all}/forces"), r#"{"force":[]}"#).expect(200).json();
    assert_eq!(none, json!({"count": 0, "revision": 2}));
    for path in [named, all] {
        client.post(&format!("{path}/particles"), r#"{"count":4}"#).expect(201);
        client.delete(&format!("{path}/particles/1")).expect(204);
    }
    let ids = json!([0, 2, 3]);
    let forces = json!({ "force": each });
    assert_eq!(client.post(&format!("{all}/forces"), &forces.to_string()).expect(200).json()["count"], 3);
    let mut forces = forces;
    forces["ids"] = ids.clone();
    client.post(&format!("{named}/forces"), &forces.to_string()).expect(200);
    let answers = [(named, list(&ids)), (all, list(&Value::Null))]
        .map(|(path, list)| client.post(&format!("{path}/commands"), &list).expect(200).json()["results"].clone());
    assert_eq!(answers[0], answers[1]);
    assert_eq!(answers[1][6], json!({"count": 3}));
    let digests = [named, all].map(|path| client.get(&format!("{path}/digest")).json()["digest"].clone());
    assert_eq!(digests[0], digests[1]);
}

/// Whatever is refused, and wherever in the batch: the world is as it was, to the bit.
#[test]
fn a_refused_command_undoes_those_before_it() {
    let good = [
        json!({"add_force": {"ids": [0, 1], "force": [1, 2, 3]}}),
        json!({"add_force": {"force": [1, 2, 3]}}),
        json!({"advance": {"duration": 0.25}}),
        json!({"read": {}}),
        json!({"create": {"count": 3, "damping": [1, 0.5, 0.25]}}),
        json!({"set": {"ids": [1, 5], "mass": 3, "acceleration": [1, 1, 1]}}),
        json!({"impulse": {"ids": [2], "impulse": [1, 0, 0]}}),
        json!({"place": {"ids": [0], "position": [7, 7, 7]}}),
        json!({"remove": {"ids": [1, 4]}}),
        json!({"advance": {"duration": 0.5}}),
    ];
    let bad = [
        (json!({"add_force": {"ids": [0, 99], "force": [1, 0, 0]}}), "unknown_particle", "/add_force/ids/1"),
        (json!({"read": {"ids": [0, 99]}}), "unknown_particle", "/read/ids/1"),
        (json!({"set": {"damping": 2}}), "damping_out_of_range", "/set/damping"),
        (json!({"advance": {"duration": 1e200}}), "clock_out_of_range", "/advance/duration"),
        (json!({"advance": {"duration": 1e20}}), "diverged", "/advance"),
        (json!({"remove": {"ids": [0, 0]}}), "removed_twice", "/remove/ids/1"),
        (json!({"add_force": {"force": [[1, 0, 0]]}}), "length_mismatch", "/add_force/force"),
        (json!({"place": {"ids": [0]}}), "missing_field", "/place"),
        (json!({"create": [{}, {"mass": 0}]}), "mass_not_positive", "/create/1/mass"),
    ];
    let mut client = service().client();
    for (precision, integrator) in [("double", "exact"), ("single", "newton_euler"), ("double", "dop853")] {
        let path = format!("/v1/worlds/undo-{integrator}");
        let settings = json!({"precision": precision, "integrator": integrator, "gravity": "textbook"});
        client.put(&path, &settings.to_string()).expect(201);
        let huge = if precision == "single" { 1e30 } else { 1e300 };
        let scene = json!([{"damping": 0.5}, {"mass": 2}, {"velocity": [huge, 0, 0]}, {"inverse_mass": 0}]);
        client.post(&format!("{path}/particles"), &scene.to_string()).expect(201);
        client.post(&format!("{path}/advance"), "{\"duration\":0.125}").expect(200);
        client.post(&format!("{path}/forces"), "{\"ids\":[1],\"force\":[0,1,0]}").expect(200);
        let before = everything(&mut client, &path);
        for position in 0..=good.len() {
            for (command, code, place) in &bad {
                // A duration that is not finite there; and one to which there are too many steps.
                if (precision, *code) == ("single", "clock_out_of_range")
                    || (integrator, *code) == ("dop853", "diverged")
                {
                    continue;
                }
                // With nothing behind it, less of the world is kept.
                for rest in [&good[position..], &[]] {
                    let list = [&good[..position], std::slice::from_ref(command), rest].concat();
                    let problem = client.post(&format!("{path}/commands"), &commands(&list)).json();
                    let pointer = format!("/commands/{position}{place}");
                    let told = (problem["code"].as_str(), problem["pointer"].as_str());
                    assert_eq!(told, (Some(*code), Some(pointer.as_str())), "{integrator}: {problem}");
                    assert_eq!(everything(&mut client, &path), before, "{integrator}, {command} at {position}");
                }
            }
        }
        let answer = client.post(&format!("{path}/commands"), &commands(&good)).expect(200);
        assert_eq!(answer.header("etag"), Some("\"4\""));
    }
}

#[test]
fn a_batch_has_the_budget_of_one_request() {
    let service = Service::with(|config| {
        config.commands_max = 5;
        config.steps_max = 100;
        config.particle_steps_max = 500;
        config.interactions_max = 1000;
        config.duration_max = Some(10.0);
        config.particles_max = 20;
    });
    let mut client = service.client();
    client.put("/v1/worlds/a", r#"{"integrator":"newton_euler"}"#).expect(201);
    client.put("/v1/worlds/b", r#"{"integrator":"velocity_verlet","forces":{"gravitation":{}}}"#).expect(201);
    let mut code = |path: &str, list: &[Value]| {
        let problem = client.post(path, &commands(list)).expect(422).json();
        [&problem["code"], &problem["pointer"], &problem["detail"]]
            .map(|text| text.as_str().unwrap_or_default().to_owned())
    };
    let advance = |steps: u64| json!({"advance": {"duration": 1, "steps": steps}});
    let create = |count: u64| json!({"create": {"count": count, "velocity": [1, 0, 0]}});
    let a = "/v1/worlds/a/commands";
    let [many, place, detail] = code(a, &vec![json!({"read": {}}); 6]);
    assert_eq!((many.as_str(), place.as_str()), ("limit_reached", "/commands"));
    assert!(detail.contains("--commands-max"), "{detail}");
    assert_eq!(code(a, &[advance(60), advance(41)])[..2], ["compute_budget", "/commands/1/advance/steps"]);
    assert_eq!(code(a, &[create(10), advance(30), advance(21)])[..2], ["compute_budget", "/commands/2/advance/steps"]);
    let gravitation = [create(10), json!({"set": {"gravitational_mass": 1}}), advance(5), advance(6)];
    assert_eq!(code("/v1/worlds/b/commands", &gravitation)[..2], ["compute_budget", "/commands/3/advance/steps"]);
    let long = json!({"advance": {"duration": 6}});
    assert_eq!(code(a, &[long.clone(), long])[..2], ["compute_budget", "/commands/1/advance/duration"]);
    assert_eq!(code(a, &[create(21)])[..2], ["limit_reached", "/commands/0/create/count"]);
    assert_eq!(code(a, &[json!({"create": vec![json!({}); 60]})])[0], "limit_reached", "before it is read");
    for world in ["a", "b"] {
        assert_eq!(client.get(&format!("/v1/worlds/{world}")).json()["revision"], 0);
    }
    // What was refused costs nothing: the next one has all of it, and as much as there is.
    for _ in 0..2 {
        client.post(a, &commands(&[advance(60), advance(40)])).expect(200);
    }
    // A copy to go back to is charged where one is taken, and a tick takes none.
    let service = Service::with(|config| config.memory_bytes_max = 256 * 150);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    client.post("/v1/worlds/a/particles", r#"{"count":100}"#).expect(201);
    let tick = [
        json!({"add_force": {"ids": [0], "force": [1, 0, 0]}}),
        json!({"advance": {"duration": 1}}),
        json!({"read": {"ids": [0]}}),
    ];
    client.post(a, &commands(&tick)).expect(200);
    let copied = client.post(a, &commands(&[tick[1].clone(), tick[1].clone()])).expect(422).json();
    assert_eq!(copied["code"], "limit_reached");
    assert_eq!(client.get("/v1/worlds/a").json()["revision"], 2);
    // So is the answer.
    let service = Service::with(|config| config.answer_bytes_max = 10_000);
    let mut client = service.client();
    client.put("/v1/worlds/a", "").expect(201);
    let read = vec![json!({"read": {}}); 3];
    let large = client.post(a, &commands(&[&[create(50)], &read[..]].concat())).expect(422).json();
    assert_eq!(large["code"], "answer_too_large");
    assert_eq!(client.get("/v1/worlds/a").json()["particle_count"], 0);
}

fn both(client: &mut Client, headers: &[(&str, &str)], body: &Value) -> Answer {
    client.send("POST", "/v1/commands", headers, Some(body.to_string().as_bytes()))
}

#[test]
fn a_world_that_fails_leaves_the_others_alone() {
    let service = Service::start();
    let mut client = service.client();
    client.put("/v1/worlds/good", "").expect(201);
    client.put("/v1/worlds/bad", r#"{"precision":"single"}"#).expect(201);
    client.put("/v1/worlds/direct", "").expect(201);
    let list = [json!({"create": {"velocity": [1, 0, 0]}}), json!({"advance": {"duration": 0.5}})];
    let refused = [list[0].clone(), json!({"advance": {"duration": 0}})];
    let body = json!({"worlds": {
        "missing": {"commands": []}, "bad": {"commands": refused}, "good": {"commands": list},
        "a/b": {"commands": [1]}
    }});
    let text = both(&mut client, &[], &body).expect(200).text().to_owned();
    let answer: Value = serde_json::from_str(&text).expect("JSON");
    let places: Vec<usize> = body["worlds"]
        .as_object()
        .expect("worlds")
        .keys()
        .map(|name| text.find(&format!("\"{name}\":")).expect("its answer"))
        .collect();
    assert!(places.is_sorted(), "in the order of the request: {text}");
    let direct = client.post("/v1/worlds/direct/commands", &commands(&list)).expect(200).json();
    assert_eq!(answer["worlds"]["good"], direct);
    for (name, status, code, pointer) in [
        ("missing", 404, "unknown_world", "/worlds/missing"),
        ("bad", 422, "duration_not_positive", "/worlds/bad/commands/1/advance/duration"),
        ("a/b", 404, "unknown_world", "/worlds/a~1b"),
    ] {
        let problem = &answer["worlds"][name];
        assert_eq!(
            [&problem["status"], &problem["code"], &problem["pointer"]],
            [&json!(status), &json!(code), &json!(pointer)],
        );
    }
    assert_eq!(client.get("/v1/worlds/bad").json()["revision"], 0);
    assert_eq!(both(&mut client, &[], &json!({"worlds": {}})).expect(200).json(), json!({"worlds": {}}));
}

/// Two long advances and a short one: side by side in the time of one, and the short one waits for none but its answer.
#[test]
fn worlds_run_side_by_side() {
    let service = Service::with(|config| config.threads = 1);
    let mut client = service.client();
    let names: Vec<String> = (0..300).map(|k| format!("w{k}")).collect();
    for name in &names {
        client.put(&format!("/v1/worlds/{name}"), r#"{"integrator":"newton_euler"}"#).expect(201);
    }
    let parts = names.iter().enumerate().map(|(k, name)| {
        let steps = if k % 100 == 0 { 500_000 } else { 1 };
        let list =
            json!([{"create": {"count": 20, "velocity": [k, 0, 0]}}, {"advance": {"duration": 1, "steps": steps}}]);
        (name.clone(), json!({ "commands": list }))
    });
    let body = json!({"worlds": parts.collect::<serde_json::Map<String, Value>>()});
    let answer = both(&mut client, &[], &body).expect(200).json();
    for (k, name) in names.iter().enumerate() {
        assert_eq!(answer["worlds"][name]["revision"], 1, "{name}: {}", answer["worlds"][name]);
        let state = client.get(&format!("/v1/worlds/{name}/state")).json();
        assert_eq!(state["velocity"][19][0], json!(k as f64), "{name}");
    }
}

#[test]
fn a_batch_that_is_sent_again_is_done_once() {
    let service = Service::start();
    let mut client = service.client();
    for world in ["a", "b"] {
        client.put(&format!("/v1/worlds/{world}"), "").expect(201);
    }
    let key = [("idempotency-key", "k")];
    let list = commands(&[json!({"create": {}}), json!({"advance": {"duration": 1}})]);
    let send =
        |client: &mut Client| client.send("POST", "/v1/worlds/a/commands", &key, Some(list.as_bytes())).expect(200);
    let (first, again) = (send(&mut client), send(&mut client));
    assert_eq!((first.text(), again.header("idempotency-replayed")), (again.text(), Some("true")));
    assert_eq!(client.get("/v1/worlds/a").json()["revision"], 1);
    // Those that were changed replay, the one that was refused runs.
    let key = [("idempotency-key", "many")];
    let push = json!({"commands": [{"impulse": {"ids": [0], "impulse": [1, 0, 0]}}]});
    let body = json!({"worlds": {"a": push, "b": push}});
    let first = both(&mut client, &key, &body).expect(200);
    assert_eq!(first.json()["worlds"]["b"]["code"], "unknown_particle");
    client.post("/v1/worlds/b/particles", "{}").expect(201);
    let second = both(&mut client, &key, &body).expect(200);
    assert_eq!((second.header("idempotency-replayed"), first.header("idempotency-replayed")), (None, None));
    assert_eq!(second.json()["worlds"]["a"], first.json()["worlds"]["a"]);
    assert_eq!(second.json()["worlds"]["b"], json!({"results": [{"count": 1}], "revision": 2}));
    let third = both(&mut client, &key, &body).expect(200);
    assert_eq!((third.header("idempotency-replayed"), third.text()), (Some("true"), second.text()));
    assert_eq!(client.get("/v1/worlds/a/particles/0").json()["velocity"][0], 1.0);
    assert_eq!(client.get("/v1/worlds/b/particles/0").json()["velocity"][0], 1.0);
    let other = both(&mut client, &key, &json!({"worlds": {"a": push}})).expect(200).json();
    assert_eq!(other["worlds"]["a"]["code"], "idempotency_key_reused");
    both(&mut client, &[("idempotency-key", "")], &body).expect(422);
    both(&mut client, &[("if-match", "\"1\"")], &body).expect(412);
}

/// What has been done of a batch is undone when its client goes away, in one world and in many.
#[test]
fn a_client_that_goes_away_takes_its_batch_along() {
    let service = Service::start();
    let mut client = service.client();
    for world in ["a", "b"] {
        client.put(&format!("/v1/worlds/{world}"), r#"{"integrator":"newton_euler"}"#).expect(201);
        client.post(&format!("/v1/worlds/{world}/particles"), r#"{"count":2000,"velocity":[1,0,0]}"#).expect(201);
    }
    let before = ["a", "b"].map(|world| everything(&mut client, &format!("/v1/worlds/{world}")));
    let list = json!({"commands": [
        {"place": {"ids": [0], "position": [9, 9, 9]}}, {"advance": {"duration": 1, "steps": 999_000}}, {"remove": {"ids": [1]}}
    ]});
    let started = Instant::now();
    for (path, body) in [
        ("/v1/worlds/a/commands", list.to_string()),
        ("/v1/commands", json!({"worlds": {"a": list, "b": list}}).to_string()),
    ] {
        let mut leaving = service.client();
        let length = body.len();
        leaving.raw(
            format!("POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-length: {length}\r\n\r\n{body}").as_bytes(),
        );
        wait_for_in_flight(service.address, 1);
        drop(leaving);
        let after = ["a", "b"].map(|world| everything(&mut client, &format!("/v1/worlds/{world}")));
        assert_eq!(after, before, "{path}");
    }
    assert!(started.elapsed() < Duration::from_secs(30));
}

#[test]
fn a_world_of_the_library_is_changed_at_once_or_not_at_all() {
    let mut world = World::<f64>::default();
    assert_eq!(world.apply_all(&[]).map(|outcomes| outcomes.len()), Ok(0));
    assert_eq!(world.revision(), 0, "nothing was applied");
    let created = world.atomically(|world| {
        world.create(pointmass::Particle::default())?;
        world.apply_all(&[Command::Advance(1.0.into()), Command::Advance(1.0.into())]).map_err(|refused| refused.error)
    });
    assert!(created.is_ok_and(|outcomes| outcomes.len() == 2));
    assert_eq!((world.revision(), world.time()), (1, 2.0));
}
