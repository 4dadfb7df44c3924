//! Drag and gravitation, and what came with them, over HTTP: settings, properties of particles, `report_error`, `until`
//! and trajectories. What the numbers have to be is the business of physics.rs.

use pointmass::{
    Advance, Drag, Forces, Gravitation, Integrator, Mass, Particle, ParticleId, Plane, Precision, Settings, Tolerance,
    Until, World,
};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::lockstep::Number;
use crate::service::{Client, Service, shared};

/// A new world in a shared service.
fn world(name: &str, settings: &str) -> (Client, String) {
    let mut client = shared().client();
    let path = format!("/v1/worlds/forces-{name}");
    client.put(&path, settings).expect(201);
    (client, path)
}

#[test]
fn settings_are_shown_where_they_are_not_the_default() {
    let plain = "{\"world\":\"forces-plain\",\"precision\":\"double\",\"integrator\":\"rk4\",\"gravity\":[0.0,0.0,0.0],\
        \"damping_law\":\"per_second\",\"max_step\":null,\"time\":0.0,\"step_count\":0,\"particle_count\":0,\"revision\":0}\n";
    let same =
        "{\"integrator\":\"rk4\",\"forces\":{\"drag\":null},\"tolerance\":{\"absolute\":1e-9},\"compensated\":false}";
    let (mut client, path) = world("plain", "{\"integrator\":\"rk4\"}");
    assert_eq!(client.get(&path).text(), plain);
    for settings in [same, "{\"integrator\":\"rk4\",\"forces\":null}", "{\"integrator\":\"rk4\",\"forces\":{}}"] {
        client.delete(&path).expect(204);
        assert_eq!(client.put(&path, settings).expect(201).text(), plain, "{settings}");
    }
    let settings = json!({
        "integrator": "dop853", "forces": {"drag": {"k1": 0.1, "k2": 0.02}, "gravitation": {"softening": 0.5}},
        "tolerance": {"absolute": 1e-12, "relative": 1e-11}, "compensated": true
    });
    let (mut client, path) = world("every", &settings.to_string());
    let text = client.get(&path).text().to_owned();
    let shown = "\"max_step\":null,\"forces\":{\"drag\":{\"k1\":0.1,\"k2\":0.02},\"gravitation\":{\"constant\":6.6743e-11,\
        \"softening\":0.5}},\"tolerance\":{\"absolute\":1e-12,\"relative\":1e-11},\"compensated\":true,\"time\":0.0,";
    assert!(text.contains(shown), "{text}");
    assert!(client.get("/v1/worlds?limit=1&after=forces-ever").text().contains(shown), "a list shows the same");
    // A single is read and written with the digits of a single.
    let (mut client, path) = world(
        "single",
        "{\"precision\":\"single\",\"integrator\":\"rk4\",\"forces\":{\"drag\":{\"k2\":0.1},\"gravitation\":{}}}",
    );
    let text = client.get(&path).text().to_owned();
    let shown =
        "\"forces\":{\"drag\":{\"k1\":0.0,\"k2\":0.1},\"gravitation\":{\"constant\":6.6743e-11,\"softening\":0.0}}";
    assert!(text.contains(shown), "{text}");
}

#[test]
fn a_patch_changes_what_it_names() {
    let settings = "{\"integrator\":\"rk4\",\"forces\":{\"drag\":{\"k1\":0.5,\"k2\":0.25}}}";
    let (mut client, path) = world("merge", settings);
    let mut patch = |change: Value| client.patch(&path, &change.to_string()).expect(200).json();
    let drag = json!({"k1": 0.5, "k2": 0.25});
    let gravitation = json!({"constant": 1.0, "softening": 0.0});
    for (change, forces) in [
        (json!({}), json!({"drag": drag, "gravitation": null})),
        (json!({"forces": {}}), json!({"drag": drag, "gravitation": null})),
        (json!({"forces": {"gravitation": {"constant": 1}}}), json!({"drag": drag, "gravitation": gravitation})),
        (json!({"forces": {"drag": {"k2": 2}}}), json!({"drag": {"k1": 0.5, "k2": 2.0}, "gravitation": gravitation})),
        (json!({"forces": {"drag": null}}), json!({"drag": null, "gravitation": gravitation})),
        (json!({"forces": {"drag": {"k2": 3}}}), json!({"drag": {"k1": 0.0, "k2": 3.0}, "gravitation": gravitation})),
        (json!({"gravity": "textbook"}), json!({"drag": {"k1": 0.0, "k2": 3.0}, "gravitation": gravitation})),
        (json!({"forces": null}), Value::Null),
        (json!({"integrator": "exact"}), Value::Null),
    ] {
        let configured = patch(change.clone());
        assert_eq!(configured.get("forces").unwrap_or(&Value::Null), &forces, "{change}: {configured}");
    }
    assert_eq!(patch(json!({"tolerance": {"relative": 0}}))["tolerance"], json!({"absolute": 1e-9, "relative": 0.0}));
    assert_eq!(patch(json!({"tolerance": {"absolute": 2}}))["tolerance"], json!({"absolute": 2.0, "relative": 0.0}));
    let default = patch(json!({"tolerance": {"absolute": 1e-9, "relative": 1e-9}, "compensated": true}));
    assert_eq!((default.get("tolerance"), &default["compensated"]), (None, &json!(true)));
    assert_eq!(patch(json!({"compensated": false})).get("compensated"), None);
}

#[test]
fn particles_have_their_own_drag_and_gravitational_mass() {
    let (mut client, path) = world("particles", "");
    let particles = format!("{path}/particles");
    let one = client.post(&particles, "{\"drag\":[0.1,0.2],\"gravitational_mass\":5}").expect(201);
    let end = "\"force\":[0.0,0.0,0.0],\"drag\":[0.1,0.2],\"gravitational_mass\":5.0}\n";
    assert!(one.text().ends_with(end), "{}", one.text());
    assert_eq!(client.get(&format!("{particles}/0")).expect(200).text(), one.text());
    let plain = client.post(&particles, "{\"drag\":null,\"gravitational_mass\":null}").expect(201);
    assert!(plain.text().ends_with("\"force\":[0.0,0.0,0.0]}\n"), "{}", plain.text());
    client.post(&particles, "[{\"drag\":[1,2]},{\"gravitational_mass\":0}]").expect(201);
    client.post(&particles, "{\"count\":2,\"drag\":[0.5,0.25],\"gravitational_mass\":7}").expect(201);
    let each = "{\"count\":3,\"drag\":[null,[3,4],null],\"gravitational_mass\":[1,null,2]}";
    client.post(&particles, each).expect(201);
    let columns = |client: &mut Client| {
        let state = client.get(&format!("{path}/state?fields=drag,gravitational_mass")).expect(200).json();
        assert_eq!(state.as_object().map(serde_json::Map::len), Some(5), "{state}");
        (state["drag"].clone(), state["gravitational_mass"].clone())
    };
    let drag = json!([[0.1, 0.2], null, [1.0, 2.0], null, [0.5, 0.25], [0.5, 0.25], null, [3.0, 4.0], null]);
    assert_eq!(columns(&mut client), (drag, json!([5.0, null, null, 0.0, 7.0, 7.0, 1.0, null, 2.0])));
    // Of pages: everything that there is, or what is asked for.
    let page = client.get(&format!("{particles}?ids=1,7")).expect(200).json();
    assert_eq!((page["particles"][0].get("drag"), &page["particles"][1]["drag"]), (None, &json!([3.0, 4.0])));
    assert_eq!(page["particles"][1].get("gravitational_mass"), None);
    let asked = client.get(&format!("{particles}?ids=1,3&fields=gravitational_mass,drag")).expect(200).json();
    let expected = json!([
        {"id": 1, "drag": null, "gravitational_mass": null}, {"id": 3, "drag": null, "gravitational_mass": 0.0}
    ]);
    assert_eq!(asked["particles"], expected);
    let one = client.patch(&format!("{particles}/0"), "{\"drag\":null,\"gravitational_mass\":6}").expect(200).json();
    assert_eq!((one.get("drag"), &one["gravitational_mass"]), (None, &json!(6.0)));
    let one =
        client.patch(&format!("{particles}/0"), "{\"drag\":[0,1],\"gravitational_mass\":null}").expect(200).json();
    assert_eq!((&one["drag"], one.get("gravitational_mass")), (&json!([0.0, 1.0]), None));
    let many = "{\"ids\":[1,2],\"drag\":[[9,8],null],\"gravitational_mass\":[null,4]}";
    client.patch(&particles, many).expect(200);
    client.patch(&particles, "{\"ids\":[7,8],\"drag\":[6,5],\"gravitational_mass\":null}").expect(200);
    let drag = json!([[0.0, 1.0], [9.0, 8.0], null, null, [0.5, 0.25], [0.5, 0.25], null, [6.0, 5.0], [6.0, 5.0]]);
    assert_eq!(columns(&mut client), (drag, json!([null, null, 4.0, 0.0, 7.0, 7.0, 1.0, null, null])));
    client.patch(&particles, "{\"drag\":null,\"gravitational_mass\":3}").expect(200);
    let nine = |value: Value| Value::Array(vec![value; 9]);
    assert_eq!(columns(&mut client), (nine(Value::Null), nine(json!(3.0))));
    let returned = client.post(&format!("{path}/advance"), "{\"duration\":1,\"return\":[\"drag\"]}").expect(200).json();
    assert_eq!(returned["state"]["drag"], nine(Value::Null));
}

#[test]
fn an_advance_tells_its_error_and_where_it_stopped() {
    let (mut client, path) = world("until", "{\"gravity\":\"textbook\"}");
    let ball = "{\"position\":[0,20,0],\"velocity\":[3,0,0]}";
    client.post(&format!("{path}/particles"), ball).expect(201);
    let until = json!({"particle": 0, "plane": {"normal": [0, 1, 0]}});
    let advance = |client: &mut Client, body: Value| client.post(&format!("{path}/advance"), &body.to_string());
    let plain = advance(&mut client, json!({"duration": 1, "dry_run": true})).expect(200).json();
    for absent in ["error", "crossed", "rejected_steps", "evaluations"] {
        assert_eq!(plain.get(absent), None, "{plain}");
    }
    let body = json!({"duration": 60, "until": until, "report_error": true, "return": ["position"], "dry_run": true});
    let dry = advance(&mut client, body.clone()).expect(200).json();
    assert_eq!((&dry["crossed"], &dry["time"], &dry["duration"]), (&json!(true), &json!(2.0), &json!(2.0)));
    assert_eq!(dry["error"], json!({"position": 0.0, "velocity": 0.0}));
    assert_eq!(dry["state"]["position"], json!([[6.0, 0.0, 0.0]]));
    assert_eq!(client.get(&path).json()["time"], 0.0, "a dry run moves nothing");
    let short = json!({"duration": 1, "until": {"particle": 0, "plane": {"normal": [0, 1, 0], "offset": -5}}});
    let short = advance(&mut client, short).expect(200).json();
    assert_eq!((&short["crossed"], &short["time"], short.get("error")), (&json!(false), &json!(1.0), None));
    // The steps of Euler have an error, a force with no closed form has none to tell.
    client.patch(&path, "{\"integrator\":\"newton_euler\"}").expect(200);
    let stepped = advance(&mut client, json!({"duration": 0.5, "steps": 4, "report_error": true})).expect(200).json();
    assert_eq!(stepped["error"], json!({"position": 0.3125, "velocity": 0.0}));
    client.patch(&path, "{\"forces\":{\"drag\":{\"k1\":1}}}").expect(200);
    let dragged = advance(&mut client, json!({"duration": 0.5, "report_error": true})).expect(200);
    assert!(dragged.text().contains(",\"error\":null,\"revision\""), "{}", dragged.text());
    client.patch(&path, "{\"integrator\":\"dop853\"}").expect(200);
    let chosen = advance(&mut client, json!({"duration": 0.5})).expect(200).json();
    assert_eq!((chosen["rejected_steps"].is_u64(), chosen["evaluations"].is_u64()), (true, true), "{chosen}");
    assert!(chosen["evaluations"].as_u64() >= Some(12), "{chosen}");
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ReadTrajectory<R> {
    particle: u64,
    time: Vec<f64>,
    position: Vec<[R; 3]>,
    velocity: Vec<[R; 3]>,
}

#[test]
fn a_trajectory_is_where_a_particle_will_be() {
    let (mut client, path) = world("way", "{\"gravity\":\"textbook\"}");
    client.post(&format!("{path}/particles"), "[{},{\"velocity\":[3,20,0]}]").expect(201);
    let before = client.get(&path).text().to_owned();
    let way = client.get(&format!("{path}/particles/1/trajectory?duration=4&samples=5")).expect(200);
    let expected = json!({
        "particle": 1, "time": [0.0, 1.0, 2.0, 3.0, 4.0],
        "position": [[0.0, 0.0, 0.0], [3.0, 15.0, 0.0], [6.0, 20.0, 0.0], [9.0, 15.0, 0.0], [12.0, 0.0, 0.0]],
        "velocity": [[3.0, 20.0, 0.0], [3.0, 10.0, 0.0], [3.0, 0.0, 0.0], [3.0, -10.0, 0.0], [3.0, -20.0, 0.0]]
    });
    assert_eq!((way.json(), way.header("etag")), (expected, Some("\"1\"")));
    let many: ReadTrajectory<f64> =
        client.get(&format!("{path}/particles/0/trajectory?duration=10")).expect(200).typed();
    assert_eq!((many.time.len(), many.position.len(), many.velocity.len()), (101, 101, 101));
    client.get(&format!("{path}/particles/0/trajectory?duration=1e-3&samples=100000")).expect(200);
    assert_eq!(client.get(&path).text(), before, "it changes nothing");
}

/// Nothing that is not finite is ever written.
#[test]
fn a_trajectory_that_diverges_is_refused() {
    for integrator in Integrator::ALL {
        let settings = format!("{{\"integrator\":\"{integrator}\"}}");
        let (mut client, path) = world(&format!("diverging-{integrator}"), &settings);
        client.post(&format!("{path}/particles"), "[{},{\"velocity\":[0,1e308,0]}]").expect(201);
        for (duration, code) in [("100", "diverged"), ("1e200", "clock_out_of_range")] {
            let answer = client.get(&format!("{path}/particles/1/trajectory?duration={duration}&samples=2"));
            let problem = answer.json();
            assert_eq!((answer.status, &problem["code"]), (422, &json!(code)), "{integrator}: {}", answer.text());
            assert_eq!(problem["particle"].as_u64(), (code == "diverged").then_some(1), "{integrator}: {problem}");
        }
        // Under `dop853` all take the same steps, so that it cannot be told without the other.
        let other = if integrator == Integrator::Dop853 { 422 } else { 200 };
        client.get(&format!("{path}/particles/0/trajectory?duration=100&samples=2")).expect(other);
    }
}

/// A world of every force, the same by library and by HTTP.
fn both<R: Number>(integrator: Integrator, compensated: bool) -> (World<R>, Client, String) {
    let n = R::nearest;
    let forces = Forces {
        drag: Some(Drag { k1: n(0.01), k2: n(0.002) }),
        gravitation: Some(Gravitation { constant: n(0.7), softening: n(0.1) }),
    };
    let tolerance = Tolerance { absolute: 1e-6, relative: 1e-6 };
    let gravity: [R; 3] = [0.0, -0.1, 0.0].map(n);
    let settings = Settings {
        integrator,
        gravity: gravity.into(),
        max_step: Some(0.125),
        forces,
        tolerance,
        compensated,
        ..Settings::default()
    };
    let mut own = World::<R>::new(settings).expect("valid settings");
    let name = format!("both-{}-{}-{compensated}", R::PRECISION.name(), integrator.name());
    let body = json!({
        "precision": R::PRECISION.name(), "integrator": integrator.name(), "gravity": gravity, "max_step": 0.125,
        "forces": {"drag": {"k1": n(0.01), "k2": n(0.002)}, "gravitation": {"constant": n(0.7), "softening": n(0.1)}},
        "tolerance": {"absolute": 1e-6, "relative": 1e-6}, "compensated": compensated
    });
    let (mut client, path) = world(&name, &body.to_string());
    for k in 0..5 {
        let x = f64::from(k);
        let position: [R; 3] = [x, 0.3 * x * x, 0.1 - x].map(n);
        let velocity: [R; 3] = [0.2, 0.1 * x, -0.1].map(n);
        let drag = (k == 2).then_some([n(0.3), n(0.1)]);
        let (inverse_mass, gravitational_mass) = (n(if k == 0 { 0.0 } else { 0.8 }), (k == 0).then_some(n(3.0)));
        let body = json!({
            "position": position, "velocity": velocity, "drag": drag, "inverse_mass": inverse_mass, "damping": n(0.9),
            "gravitational_mass": gravitational_mass
        });
        client.post(&format!("{path}/particles"), &body.to_string()).expect(201);
        let particle = Particle {
            position: position.into(),
            velocity: velocity.into(),
            drag: drag.map(|[k1, k2]| Drag { k1, k2 }),
            mass: Mass::Inverse(inverse_mass),
            damping: n(0.9),
            gravitational_mass,
            ..Particle::default()
        };
        own.create(particle).expect("a valid particle");
    }
    (own, client, path)
}

fn check_both<R: Number>(integrator: Integrator, compensated: bool) {
    let (mut own, mut client, path) = both::<R>(integrator, compensated);
    let context = format!("{integrator} in {}, compensated: {compensated}", R::PRECISION.name());
    let until = Until { particle: ParticleId(3), plane: Plane { normal: [1.0, 0.5, 0.0], offset: 4.5 } };
    let until_json = json!({"particle": 3, "plane": {"normal": [1, 0.5, 0], "offset": 4.5}});
    for (advance, body) in [
        (Advance::by(1.5), json!({"duration": 1.5})),
        (Advance { report_error: true, ..Advance::by(0.7) }, json!({"duration": 0.7, "report_error": true})),
        (Advance { until: Some(until), ..Advance::by(2.0) }, json!({"duration": 2, "until": until_json})),
    ] {
        let advanced = own.advance(advance).expect("it stays finite");
        let answer = client.post(&format!("{path}/advance"), &body.to_string()).expect(200).json();
        assert_eq!(answer["time"].as_f64().map(f64::to_bits), Some(advanced.time.to_bits()), "{context}: {answer}");
        assert_eq!(answer["steps"], json!(advanced.steps), "{context}: {answer}");
        assert_eq!(answer.get("error").is_some(), advance.report_error, "{context}: {answer}");
        assert_eq!(answer["crossed"].as_bool(), advanced.crossed, "{context}: {answer}");
        if integrator == Integrator::Dop853 {
            assert_eq!(answer["evaluations"], json!(advanced.evaluations), "{context}: {answer}");
            assert_eq!(answer["rejected_steps"], json!(advanced.rejected_steps), "{context}: {answer}");
        }
        let digest = client.get(&format!("{path}/digest")).expect(200).json();
        assert_eq!(digest["digest"], json!(own.digest().to_string()), "{context} after {body}");
        let way: ReadTrajectory<R> =
            client.get(&format!("{path}/particles/2/trajectory?duration=0.9&samples=4")).expect(200).typed();
        let own_way = own.trajectory(ParticleId(2), 0.9, 4).expect("it stays finite");
        let bits = |vectors: &[[R; 3]]| vectors.iter().flatten().map(|x| x.bits()).collect::<Vec<u64>>();
        assert_eq!((way.particle, &way.time), (2, &own_way.time), "{context} after {body}");
        assert_eq!(bits(&way.position), bits(&own_way.position), "{context} after {body}");
        assert_eq!(bits(&way.velocity), bits(&own_way.velocity), "{context} after {body}");
    }
}

#[test]
fn library_and_service_agree_to_the_bit_under_every_force() {
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_forces()) {
        for precision in Precision::ALL {
            for compensated in [false, true] {
                match precision {
                    Precision::Single => check_both::<f32>(integrator, compensated),
                    Precision::Double => check_both::<f64>(integrator, compensated),
                }
            }
        }
    }
}

/// What an advance or a trajectory copies is charged before, and given back.
#[test]
fn copies_are_charged() {
    let service = Service::with(|config| config.memory_bytes_max = 256 * 100);
    let mut client = service.client();
    let path = "/v1/worlds/a";
    client.put(path, "{\"integrator\":\"rk4\"}").expect(201);
    client.post(&format!("{path}/particles"), "{\"count\":20}").expect(201);
    let advance = |client: &mut Client, body: &str| client.post("/v1/worlds/a/advance", body).status;
    let trajectory = |client: &mut Client| client.get("/v1/worlds/a/particles/0/trajectory?duration=1").status;
    for _ in 0..3 {
        assert_eq!(advance(&mut client, "{\"duration\":1}"), 200);
    }
    client.post(&format!("{path}/particles"), "{\"count\":10}").expect(201);
    assert_eq!(advance(&mut client, "{\"duration\":1}"), 422);
    assert_eq!(advance(&mut client, "{\"duration\":1,\"dry_run\":true}"), 422);
    assert_eq!(trajectory(&mut client), 200, "one particle alone");
    client.patch(path, "{\"forces\":{\"gravitation\":{}}}").expect(200);
    assert_eq!(trajectory(&mut client), 422, "the whole world goes along");
    client.patch(path, "{\"integrator\":\"newton_euler\",\"forces\":null}").expect(200);
    assert_eq!(advance(&mut client, "{\"duration\":1}"), 200, "in place");
    let until = "{\"duration\":1,\"until\":{\"particle\":0,\"plane\":{\"normal\":[1,0,0],\"offset\":1}}}";
    assert_eq!(advance(&mut client, until), 422);
    client.patch(path, "{\"integrator\":\"exact\"}").expect(200);
    assert_eq!(advance(&mut client, until), 200);
}
