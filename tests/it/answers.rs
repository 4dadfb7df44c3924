use std::io::Read;

use serde_json::{Value, json};

use crate::service::{Answer, Client, Service, shared};

const FIELDS: &str =
    "position,velocity,acceleration,own_acceleration,damping,mass,inverse_mass,force,drag,gravitational_mass";
const CBOR: (&str, &str) = ("accept", "application/cbor");

/// CBOR as this service writes it, read by the letter of RFC 8949 and RFC 8746. A typed array becomes its numbers.
struct Cbor<'a>(&'a [u8]);

impl Cbor<'_> {
    #[track_caller]
    fn of(answer: &Answer) -> Value {
        assert_eq!(answer.header("content-type"), Some("application/cbor"));
        let mut cbor = Cbor(&answer.body);
        let value = cbor.value();
        assert!(cbor.0.is_empty(), "{} bytes behind the end", cbor.0.len());
        value
    }

    fn bytes(&mut self, count: usize) -> &[u8] {
        let (taken, rest) = self.0.split_at(count);
        self.0 = rest;
        taken
    }

    fn head(&mut self) -> (u8, u64) {
        let first = self.bytes(1)[0];
        let argument = match first & 31 {
            small @ 0..24 => u64::from(small),
            size @ 24..=27 => {
                self.bytes(1 << (size - 24)).iter().fold(0, |number, byte| number << 8 | u64::from(*byte))
            }
            other => panic!("{other} is no definite length"),
        };
        (first >> 5, argument)
    }

    fn value(&mut self) -> Value {
        let first = self.0[0];
        let (major, argument) = self.head();
        let count = usize::try_from(argument).expect("in memory");
        match major {
            0 => json!(argument),
            3 => json!(std::str::from_utf8(self.bytes(count)).expect("text")),
            4 => (0..argument).map(|_| self.value()).collect(),
            5 => {
                let member = |_| (self.value().as_str().expect("a name").to_owned(), self.value());
                Value::Object((0..argument).map(member).collect())
            }
            6 => {
                let (major, bytes) = self.head();
                assert_eq!(major, 2, "a typed array is bytes");
                let bytes = self.bytes(usize::try_from(bytes).expect("in memory"));
                let numbers = |size, number: fn(&[u8]) -> Value| bytes.chunks_exact(size).map(number).collect();
                match argument {
                    71 => numbers(8, |b| json!(u64::from_le_bytes(b.try_into().expect("eight")))),
                    85 => numbers(4, |b| json!(f32::from_le_bytes(b.try_into().expect("four")))),
                    86 => numbers(8, |b| json!(f64::from_le_bytes(b.try_into().expect("eight")))),
                    tag => panic!("an unknown tag {tag}"),
                }
            }
            7 => match first {
                0xf4 => json!(false),
                0xf5 => json!(true),
                0xf6 => Value::Null,
                0xfa => json!(f32::from_bits(u32::try_from(argument).expect("four bytes"))),
                0xfb => json!(f64::from_bits(argument)),
                other => panic!("unexpected {other:x}"),
            },
            _ => panic!("unexpected major type {major}"),
        }
    }
}

/// The numbers of a column one after the other, in the precision of the world.
fn flat(column: &Value, single: bool) -> Vec<Option<u64>> {
    match column {
        Value::Array(values) => values.iter().flat_map(|value| flat(value, single)).collect(),
        Value::Null => vec![None],
        #[expect(clippy::cast_possible_truncation, reason = "the digits of a single")]
        Value::Number(number) if single => {
            vec![Some(u64::from((number.as_f64().expect("a number") as f32).to_bits()))]
        }
        Value::Number(number) => vec![Some(number.as_f64().expect("a number").to_bits())],
        Value::Bool(_) | Value::String(_) | Value::Object(_) => panic!("{column} in a column"),
    }
}

/// A world in which no two particles are alike.
fn colourful(client: &mut Client, world: &str, precision: &str, count: usize) {
    let settings = format!(r#"{{"precision":"{precision}","gravity":"standard"}}"#);
    client.put(&format!("/v1/worlds/{world}"), &settings).expect(201);
    let number = |index: usize, k: u32| (f64::from(k) + 0.1) / (1.0 + index as f64);
    let each = |value: &dyn Fn(usize) -> Value| (0..count).map(value).collect::<Vec<_>>();
    let vector = |index, k| json!([number(index, k), -number(index, k + 1), number(index, k + 2)]);
    let columns = json!({
        "count": count,
        "position": each(&|index| vector(index, 1)),
        "velocity": each(&|index| vector(index, 5)),
        "acceleration": each(&|index| if index % 3 == 0 { Value::Null } else { vector(index, 9) }),
        "damping": each(&|index| json!(1.0 - number(index, 0))),
        "inverse_mass": each(&|index| json!(if index % 5 == 0 { 0.0 } else { number(index, 2) })),
        "drag": each(&|index| if index % 2 == 0 { Value::Null } else { json!([number(index, 1), 0.25]) }),
        "gravitational_mass": each(&|index| if index % 7 == 0 { json!(3.5) } else { Value::Null }),
    });
    client.post(&format!("/v1/worlds/{world}/particles"), &columns.to_string()).expect(201);
    if count > 10 {
        let commands = r#"{"commands":[{"remove":{"ids":[0,7]}},{"add_force":{"ids":[3,5],"force":[1,2,3]}},
            {"advance":{"duration":0.37}},{"add_force":{"ids":[4,9],"force":[1,2,3]}}]}"#;
        client.post(&format!("/v1/worlds/{world}/commands"), commands).expect(200);
    }
}

/// However many there are, in pieces or at once: columns are what the list of particles says, in JSON and in CBOR.
#[test]
fn columns_are_the_particles_in_either_encoding() {
    let service = shared();
    let mut client = service.client();
    for precision in ["double", "single"] {
        for count in [0, 1, 12, 1023, 1026, 1027, 5000] {
            let world = format!("columns-{precision}-{count}");
            colourful(&mut client, &world, precision, count);
            let path = format!("/v1/worlds/{world}");
            let rows = client.get(&format!("{path}/particles?limit=100000")).expect(200).json();
            let rows = rows["particles"].as_array().expect("a list");
            let state = format!("{path}/state?fields={FIELDS}");
            let json = client.get(&state).expect(200);
            let is_large = 31 * rows.len() > 20_000;
            assert_eq!(json.header("transfer-encoding").is_some(), is_large, "in pieces");
            let json = json.json();
            let cbor = Cbor::of(&client.send("GET", &state, &[CBOR], None).expect(200));
            for name in FIELDS.split(',').chain(["id"]) {
                let single = precision == "single" && name != "id";
                let of_rows = rows.iter().map(|row| row[name].clone()).collect::<Value>();
                assert_eq!(flat(&json[name], single), flat(&of_rows, single), "{world}: {name}");
                assert_eq!(flat(&cbor[name], single), flat(&json[name], single), "{world}: {name} in CBOR");
            }
            assert_eq!((&json["count"], &cbor["count"]), (&json!(rows.len()), &json!(rows.len())));
            assert_eq!(json["time"], cbor["time"]);
            // Members come in the order of the contract, whatever the order and number of the question.
            let few = client.get(&format!("{path}/state?fields=velocity,position,velocity")).expect(200);
            let names: Vec<usize> = ["time", "count", "id", "position", "velocity"]
                .map(|name| few.text().find(&format!("\"{name}\":")).expect("a member"))
                .to_vec();
            assert!(names.is_sorted());
            client.delete(&path).expect(204);
        }
    }
}

/// Every other answer says the same in both encodings too.
#[test]
fn answers_are_the_same_in_either_encoding() {
    let service = shared();
    let mut client = service.client();
    colourful(&mut client, "either", "double", 20);
    let world = "/v1/worlds/either";
    for path in ["", "/particles?limit=3", "/particles/3", "/digest", "/particles/3/trajectory?duration=1&samples=3"] {
        let path = format!("{world}{path}");
        let json = client.get(&path).expect(200);
        let cbor = client.send("GET", &path, &[CBOR], None).expect(200);
        assert_eq!(Cbor::of(&cbor), json.json(), "{path}");
        assert_eq!(cbor.header("etag"), json.header("etag"));
    }
    let commands = r#"{"commands":[{"read":{"fields":["mass"],"ids":[5,3,5]}},{"create":[{},{}]},{"impulse":{"ids":[1],"impulse":[1,0,0]}},
        {"advance":{"duration":1,"return":["position"],"report_error":true}},{"read":{}}]}"#;
    let run = |client: &mut Client, world: &str, accept: &[(&str, &str)]| {
        client.send("POST", &format!("/v1/worlds/{world}/commands"), accept, Some(commands.as_bytes())).expect(200)
    };
    colourful(&mut client, "either-2", "double", 20);
    let json = run(&mut client, "either", &[]).json();
    let cbor = Cbor::of(&run(&mut client, "either-2", &[CBOR]));
    assert_eq!(json["revision"], cbor["revision"]);
    for (json, cbor) in json["results"].as_array().expect("five").iter().zip(cbor["results"].as_array().expect("five"))
    {
        for (name, value) in json.as_object().expect("a map") {
            match name.as_str() {
                "state" => assert_eq!(flat(&value["position"], false), flat(&cbor[name]["position"], false)),
                _ if value.is_array() => assert_eq!(flat(value, false), flat(&cbor[name], false), "{name}"),
                _ => assert_eq!(*value, cbor[name], "{name}"),
            }
        }
        assert_eq!(json.as_object().map(serde_json::Map::len), cbor.as_object().map(serde_json::Map::len));
    }
    let many = r#"{"worlds":{"either":{"commands":[{"read":{"fields":["damping"]}}]},"nowhere":{"commands":[]}}}"#;
    let json = client.post("/v1/commands", many).expect(200).json();
    let cbor = Cbor::of(&client.send("POST", "/v1/commands", &[CBOR], Some(many.as_bytes())).expect(200));
    assert_eq!(json, cbor);
    assert_eq!(json["worlds"]["nowhere"]["code"], "unknown_world");
    // A refusal is JSON, whoever asks.
    let refused = client.send("GET", "/v1/worlds/nowhere", &[CBOR], None).expect(404);
    assert_eq!(refused.header("content-type"), Some("application/problem+json"));
    client.send("GET", world, &[("accept", "text/html")], None).expect(406);
}

/// Large columns of a world whose columns are as they are sent, in pieces of which the last one is full or nearly empty.
#[test]
fn columns_that_are_lent_are_those_that_are_written() {
    let service = shared();
    let mut client = service.client();
    for (precision, piece) in [("double", 10_922), ("single", 21_845)] {
        for count in [9000, piece, piece + 1, 2 * piece + 5] {
            let path = format!("/v1/worlds/lent-{precision}-{count}");
            client.put(&path, &format!(r#"{{"precision":"{precision}","integrator":"newton_euler"}}"#)).expect(201);
            let vectors = |by: f64| (0..count).map(|k| json!([by / f64::from(k + 1), k, -by])).collect::<Value>();
            let columns = json!({"count": count, "position": vectors(0.1), "velocity": vectors(0.7), "damping": 0.5});
            client.post(&format!("{path}/particles"), &columns.to_string()).expect(201);
            client.post(&format!("{path}/advance"), r#"{"duration":0.1}"#).expect(200);
            for fields in ["position", "velocity", "position,velocity", "damping,velocity,mass"] {
                let state = format!("{path}/state?fields={fields}");
                let json = client.get(&state).expect(200).json();
                let cbor = Cbor::of(&client.send("GET", &state, &[CBOR], None).expect(200));
                assert_eq!(json.as_object().map(serde_json::Map::len), cbor.as_object().map(serde_json::Map::len));
                for name in fields.split(',').chain(["id"]) {
                    let single = precision == "single" && name != "id";
                    assert!(flat(&cbor[name], single) == flat(&json[name], single), "{state}: {name}");
                }
            }
            client.delete(&path).expect(204);
        }
    }
}

/// Columns under `exact` of particles that share coefficients with others that were pushed when they were.
#[test]
fn columns_of_particles_pushed_at_different_times_are_the_particles() {
    let service = shared();
    let mut client = service.client();
    client.put("/v1/worlds/pushed", r#"{"gravity":[0,-10,0]}"#).expect(201);
    let create = r#"{"count":5000,"velocity":[1,2,3],"damping":0.5}"#;
    client.post("/v1/worlds/pushed/particles", create).expect(201);
    for tick in 0..40 {
        let ids = (0..50).map(|k| (37 * tick + 101 * k) % 5000).collect::<Vec<u64>>();
        let commands = json!([{"add_force": {"ids": ids, "force": [tick, 1, -1]}}, {"advance": {"duration": 0.125}}]);
        client.post("/v1/worlds/pushed/commands", &json!({"commands": commands}).to_string()).expect(200);
    }
    for removed in [false, true] {
        let rows = client.get("/v1/worlds/pushed/particles?limit=100000").expect(200).json();
        let rows = rows["particles"].as_array().expect("a list");
        let state = "/v1/worlds/pushed/state?fields=position,velocity";
        let json = client.get(state).expect(200).json();
        let cbor = Cbor::of(&client.send("GET", state, &[CBOR], None).expect(200));
        for name in ["id", "position", "velocity"] {
            let of_rows = flat(&rows.iter().map(|row| row[name].clone()).collect(), false);
            assert!(flat(&json[name], false) == of_rows, "{name}, {removed}");
            assert!(flat(&cbor[name], false) == of_rows, "{name} in CBOR, {removed}");
        }
        client.delete("/v1/worlds/pushed/particles/77");
    }
}

/// A large answer is of one moment, whatever happens to the world while it is read; and holds nothing afterwards.
#[test]
fn a_large_answer_is_of_one_moment() {
    let service = Service::start();
    let mut client = service.client();
    for accept in ["application/json", "application/cbor"] {
        client.put("/v1/worlds/a", r#"{"integrator":"newton_euler"}"#).expect(201);
        let create = r#"{"count":300000,"velocity":[0.1,0.2,0.3]}"#;
        client.post("/v1/worlds/a/particles", create).expect(201);
        client.post("/v1/worlds/a/advance", r#"{"duration":1}"#).expect(200);
        for change in ["advance", "remove", "delete"] {
            let before = client.send("GET", "/v1/worlds/a/state", &[("accept", accept)], None).expect(200).body;
            let mut slow = service.client();
            slow.raw(
                format!("GET /v1/worlds/a/state HTTP/1.1\r\nhost: localhost\r\naccept: {accept}\r\n\r\n").as_bytes(),
            );
            let head = slow.bytes(4096);
            match change {
                "advance" => client.post("/v1/worlds/a/advance", r#"{"duration":1,"steps":3}"#),
                "remove" => client.delete("/v1/worlds/a/particles/299999"),
                _ => client.delete("/v1/worlds/a"),
            };
            assert!(head.starts_with(b"HTTP/1.1 200 OK\r\n"));
            let rest = slow.rest_of_answer(&head);
            assert!(rest == before, "{accept}, {change}: {} of {} bytes", rest.len(), before.len());
            if change == "delete" {
                client.get("/v1/worlds/a").expect(404);
            }
        }
    }
    assert!(client.get("/metrics").text().contains("\npointmass_in_flight_charged_bytes 0\n"));
}

/// A batch in which large reads stand between changes: each is of its own moment.
#[test]
fn large_reads_of_a_batch_are_of_their_moments() {
    let service = shared();
    let mut client = service.client();
    client.put("/v1/worlds/moments", "").expect(201);
    client.post("/v1/worlds/moments/particles", r#"{"count":6000,"velocity":[1,2,3]}"#).expect(201);
    let commands = r#"{"commands":[{"read":{}},{"advance":{"duration":1}},{"read":{}},{"remove":{"ids":[5]}},
        {"advance":{"duration":1,"return":["position","velocity"]}}]}"#;
    for (rounds, accept) in [(0_u32, None), (1, Some(CBOR))] {
        let (round, removed) = (f64::from(rounds * 2), u64::from(rounds));
        let accept: Vec<_> = accept.into_iter().collect();
        let commands = commands.replace("[5]", &format!("[{}]", 5 + rounds));
        let path = "/v1/worlds/moments/commands";
        let answer = client.send("POST", path, &accept, Some(commands.as_bytes())).expect(200);
        assert_eq!(answer.header("transfer-encoding"), Some("chunked"));
        let answer = if accept.is_empty() { answer.json() } else { Cbor::of(&answer) };
        for (index, time, count) in [(0, 0.0, 6000), (2, 1.0, 6000), (4, 2.0, 5999)] {
            let result = &answer["results"][index];
            let state = if index == 4 { &result["state"] } else { result };
            let position = flat(&state["position"], false);
            let expected = [1.0_f64, 2.0, 3.0].map(|v| Some((v * (time + round)).to_bits()));
            assert_eq!(
                (state["time"].as_f64(), position.len() as u64),
                (Some(time + round), 3 * (count - removed)),
                "{index}"
            );
            assert!(position.chunks_exact(3).all(|position| position == expected), "{index}");
        }
    }
}

/// Sent again with the same key, also a large answer is the same; in another encoding it is another request.
#[test]
fn a_kept_answer_has_its_columns() {
    let service = shared();
    let mut client = service.client();
    for (world, more) in [("kept", &[][..]), ("kept-lent", &[CBOR][..])] {
        let path = format!("/v1/worlds/{world}");
        client.put(&path, r#"{"integrator":"newton_euler"}"#).expect(201);
        client.post(&format!("{path}/particles"), r#"{"count":7500,"velocity":[1,2,3]}"#).expect(201);
        let advance = |client: &mut Client, more: &[(&str, &str)]| {
            let headers = [&[("idempotency-key", "k")], more].concat();
            let body = br#"{"duration":1,"return":["position"]}"#;
            client.send("POST", &format!("{path}/advance"), &headers, Some(body))
        };
        let first = advance(&mut client, more).expect(200);
        let again = advance(&mut client, more).expect(200);
        assert!(first.body == again.body && again.header("idempotency-replayed") == Some("true"));
        let told = if more.is_empty() { first.json() } else { Cbor::of(&first) };
        assert_eq!(flat(&told["state"]["position"], false)[3 * 7499..], flat(&json!([1.0, 2.0, 3.0]), false));
        let other = if more.is_empty() { &[CBOR][..] } else { &[] };
        assert_eq!(advance(&mut client, other).expect(422).json()["code"], "idempotency_key_reused");
    }
}

/// Text is packed for those who ask for it, where it is long; and says the same.
#[test]
fn long_text_is_packed_when_it_is_asked_for() {
    let service = shared();
    let mut client = service.client();
    for (world, count) in [("packed-small", 50), ("packed", 2000), ("packed-large", 9000)] {
        colourful(&mut client, world, "double", count);
        let path = format!("/v1/worlds/{world}/state");
        let plain = client.get(&path).expect(200);
        for (asked, coding) in [("gzip", "gzip"), ("br, zstd, gzip;q=0.5", "zstd")] {
            let packed = client.send("GET", &path, &[("accept-encoding", asked)], None).expect(200);
            if count == 50 {
                assert_eq!((packed.header("content-encoding"), &packed.body), (None, &plain.body));
                continue;
            }
            assert_eq!(packed.header("content-encoding"), Some(coding));
            let mut text = Vec::new();
            let unpacked = match coding {
                "gzip" => flate2::read::GzDecoder::new(&packed.body[..]).read_to_end(&mut text),
                _ => zstd::stream::read::Decoder::new(&packed.body[..]).expect("a frame").read_to_end(&mut text),
            };
            unpacked.expect("whole");
            assert!(text == plain.body && packed.body.len() * 5 < text.len() * 3, "{}", packed.body.len());
        }
        let cbor = client.send("GET", &path, &[CBOR, ("accept-encoding", "gzip")], None).expect(200);
        assert_eq!(cbor.header("content-encoding"), None, "numbers in binary do not get shorter");
        assert_eq!(client.send("GET", &path, &[("accept-encoding", "*")], None).header("content-encoding"), None);
    }
}

/// What did not change since a revision is left out, of lists and of columns; what is removed is named.
#[test]
fn only_what_changed_is_told_to_who_knows_the_rest() {
    let service = shared();
    let mut client = service.client();
    client.put("/v1/worlds/less", "").expect(201);
    // A mover, two walls, and one that floats.
    let particles = r#"[{"velocity":[1,0,0]},{"inverse_mass":0},{"inverse_mass":0},{}]"#;
    client.post("/v1/worlds/less/particles", particles).expect(201);
    let ask = |client: &mut Client, what: &str| client.get(&format!("/v1/worlds/less/{what}")).expect(200).json();
    let ids = |answer: &Value| -> Vec<u64> {
        let id = |particle: &Value| particle["id"].as_u64().expect("an id");
        match answer["particles"].as_array() {
            Some(particles) => particles.iter().map(id).collect(),
            None => serde_json::from_value(answer["id"].clone()).expect("ids"),
        }
    };
    for what in ["state", "particles"] {
        let first = ask(&mut client, &format!("{what}?changed_since=0"));
        assert_eq!((&first["full"], &first["removed"]), (&json!(true), &json!([])), "nobody asked before");
        let known = first["revision"].as_u64().expect("a revision");
        assert!(ids(&ask(&mut client, &format!("{what}?changed_since={known}"))).is_empty());
        client.post("/v1/worlds/less/advance", r#"{"duration":1}"#).expect(200);
        client.post("/v1/worlds/less/particles/3/force", r#"{"force":[0,0,1]}"#).expect(200);
        client.post("/v1/worlds/less/particles", "{}").expect(201);
        let victim = if what == "state" { 1 } else { 2 };
        client.delete(&format!("/v1/worlds/less/particles/{victim}")).expect(204);
        let new = if what == "state" { 4 } else { 5 };
        let changed = ask(&mut client, &format!("{what}?changed_since={known}&fields=position"));
        assert_eq!((ids(&changed), &changed["removed"]), (vec![0, 3, new], &json!([victim])));
        assert_eq!((&changed["revision"], changed.get("full")), (&json!(known + 4), None));
        let some = ask(&mut client, &format!("{what}?changed_since={known}&ids=0,{victim}"));
        assert_eq!((ids(&some), &some["removed"]), (vec![0], &json!([victim])));
        // From the last change on there is nothing, and before the first question nobody knows.
        assert!(ids(&ask(&mut client, &format!("{what}?changed_since={}", known + 4))).is_empty());
        for unknown in [0, known + 100] {
            let full = ask(&mut client, &format!("{what}?changed_since={unknown}&ids=0,3"));
            assert_eq!((ids(&full), &full["full"], &full["removed"]), (vec![0, 3], &json!(true), &json!([])));
        }
        client
            .post(
                "/v1/worlds/less/commands",
                r#"{"commands":[{"set":{"ids":[3],"mass":2}},{"impulse":{"ids":[3],"impulse":[0,0,1]}},
            {"impulse":{"ids":[3],"impulse":[0,0,-1]}},{"advance":{"duration":1}}]}"#,
            )
            .expect(200);
        let after = ask(&mut client, &format!("{what}?changed_since={}", known + 4));
        assert_eq!((ids(&after), &after["revision"]), (vec![0, 3], &json!(known + 5)), "a batch is one revision");
        // The force left it in motion: at rest again, for the second round.
        client.post("/v1/worlds/less/particles/3/place", r#"{"velocity":[0,0,0]}"#).expect(200);
        client.get(&format!("/v1/worlds/less/{what}?changed_since=x")).expect(422);
    }
    let pages = ask(&mut client, "particles?changed_since=0&limit=2");
    assert_eq!((ids(&pages), &pages["next_after"]), (vec![0, 3], &json!(3)));
}
