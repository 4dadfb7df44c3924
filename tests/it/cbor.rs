//! Bodies in CBOR, written by the encoder below and by hand from the RFCs, never by the library that reads them.

use pointmass::Precision;
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::lockstep::{run_encoded, steps};
use crate::service::{Answer, Client, Service, shared};

/// How a value is written: there are several ways.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Style {
    /// Every number in its own type, every length declared.
    Plain,
    /// Whole numbers as integers, floats as short as they are exact, no length declared.
    Streamed,
    /// Lists of numbers as typed arrays of 64 bits, and lists of vectors as one.
    Typed,
    /// The same in the other byte order, and in 32 bits where they are enough.
    TypedShort,
}

impl Style {
    const ALL: [Self; 4] = [Self::Plain, Self::Streamed, Self::Typed, Self::TypedShort];
}

fn head(major: u8, argument: u64) -> Vec<u8> {
    let major = major << 5;
    if argument < 24 {
        return vec![major | argument as u8];
    }
    let (code, bytes) = match argument {
        0..=0xff => (24, 1),
        0x100..=0xffff => (25, 2),
        0x1_0000..=0xffff_ffff => (26, 4),
        _ => (27, 8),
    };
    [&[major | code], &argument.to_be_bytes()[8 - bytes..]].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&head(3, text.len() as u64), text.as_bytes()].concat()
}

fn float(x: f64, style: Style) -> Vec<u8> {
    let single = x as f32;
    if style == Style::Streamed {
        if x == x.trunc() && x.abs() < 1e15 && (x != 0.0 || x.is_sign_positive()) {
            let whole = x.abs().to_string().parse::<u64>().expect("a whole number");
            return if x < 0.0 { head(1, whole - 1) } else { head(0, whole) };
        }
        if f64::from(single).to_bits() == x.to_bits() {
            return [&[0xfa], &single.to_be_bytes()[..]].concat();
        }
    }
    [&[0xfb], &x.to_be_bytes()[..]].concat()
}

fn tagged(tag: u64, bytes: &[u8]) -> Vec<u8> {
    [head(6, tag), head(2, bytes.len() as u64), bytes.to_vec()].concat()
}

/// A typed array, where a list has numbers of one kind only, or vectors of them.
fn typed(list: &[Value], style: Style) -> Option<Vec<u8>> {
    if list.is_empty() {
        return None;
    }
    if let Some(ids) = list.iter().map(Value::as_u64).collect::<Option<Vec<u64>>>() {
        return Some(if style == Style::Typed {
            tagged(71, &ids.iter().flat_map(|id| id.to_le_bytes()).collect::<Vec<u8>>())
        } else {
            let short = ids.iter().map(|id| u16::try_from(*id)).collect::<Result<Vec<u16>, _>>().ok()?;
            tagged(65, &short.iter().flat_map(|id| id.to_be_bytes()).collect::<Vec<u8>>())
        });
    }
    let rows = list.iter().map(|row| row.as_array().cloned().or_else(|| row.is_f64().then(|| vec![row.clone()])));
    let numbers = rows.collect::<Option<Vec<_>>>()?.concat();
    let numbers = numbers.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>()?;
    let singles: Vec<f32> = numbers.iter().map(|x| *x as f32).collect();
    let is_exact = singles.iter().zip(&numbers).all(|(single, x)| f64::from(*single).to_bits() == x.to_bits());
    Some(match (style, is_exact) {
        (Style::Typed, _) => tagged(86, &numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>()),
        (_, true) if numbers.len() % 2 == 0 => {
            tagged(85, &singles.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())
        }
        (_, true) => tagged(81, &singles.iter().flat_map(|x| x.to_be_bytes()).collect::<Vec<u8>>()),
        (_, false) => tagged(82, &numbers.iter().flat_map(|x| x.to_be_bytes()).collect::<Vec<u8>>()),
    })
}

/// A value as CBOR.
pub(crate) fn encode(value: &Value, style: Style) -> Vec<u8> {
    let framed = |major: u8, len: usize, items: Vec<Vec<u8>>| {
        if style == Style::Streamed {
            [vec![major << 5 | 31], items.concat(), vec![0xff]].concat()
        } else {
            [head(major, len as u64), items.concat()].concat()
        }
    };
    match value {
        Value::Null => vec![0xf6],
        Value::Bool(is_true) => vec![0xf4 + u8::from(*is_true)],
        Value::Number(number) => match number.as_u64() {
            Some(whole) => head(0, whole),
            None => float(number.as_f64().expect("a float"), style),
        },
        Value::String(string) if style == Style::Streamed && string.len() > 1 => {
            let (begin, end) = string.split_at(1);
            [vec![0x7f], text(begin), text(end), vec![0xff]].concat()
        }
        Value::String(string) => text(string),
        Value::Array(list) => {
            let typed = matches!(style, Style::Typed | Style::TypedShort).then(|| typed(list, style)).flatten();
            typed.unwrap_or_else(|| framed(4, list.len(), list.iter().map(|item| encode(item, style)).collect()))
        }
        Value::Object(members) => {
            let pairs = members.iter().map(|(name, member)| [text(name), encode(member, style)].concat());
            framed(5, members.len(), pairs.collect())
        }
    }
}

fn send(client: &mut Client, method: &str, path: &str, body: &[u8]) -> Answer {
    client.send(method, path, &[("content-type", "application/cbor")], Some(body))
}

fn hex(digits: &str) -> Vec<u8> {
    let digits: Vec<u8> = digits.bytes().filter(|digit| !digit.is_ascii_whitespace()).collect();
    let pair = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).expect("ASCII"), 16).expect("hexadecimal");
    digits.chunks(2).map(pair).collect()
}

fn world(client: &mut Client, name: &str, settings: &Value) -> String {
    let path = format!("/v1/worlds/{name}");
    send(client, "PUT", &path, &encode(settings, Style::Plain)).expect(201);
    path
}

fn digest(client: &mut Client, path: &str) -> Value {
    client.get(&format!("{path}/digest")).expect(200).json()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    /// Whatever is asked for in JSON, however it is written in CBOR: outcomes, revisions and digests are those of the
    /// library, to which the same is asked of JSON.
    #[test]
    fn bodies_in_cbor_do_what_they_do_in_json(steps in steps(24)) {
        type Encode = fn(&Value) -> (&'static str, Vec<u8>);
        let styles: [Encode; 4] = [
            |value| ("application/cbor", encode(value, Style::Plain)),
            |value| ("application/cbor", encode(value, Style::Streamed)),
            |value| ("application/cbor", encode(value, Style::Typed)),
            |value| ("application/cbor", encode(value, Style::TypedShort)),
        ];
        for encode in styles {
            for precision in Precision::ALL {
                match precision {
                    Precision::Single => run_encoded::<f32>(encode, &steps)?,
                    Precision::Double => run_encoded::<f64>(encode, &steps)?,
                }
            }
        }
    }

    /// Bytes that are changed on the way: an answer always, a 5xx never, and what is refused changes nothing.
    #[test]
    fn what_is_refused_of_broken_bytes_changes_nothing(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        style in prop::sample::select(&Style::ALL[..]),
        precision in prop::sample::select(&["single", "double"][..]),
    ) {
        let service = shared();
        let mut client = service.client();
        let path = "/v1/worlds/cbor-broken";
        client.delete(path);
        world(&mut client, "cbor-broken", &json!({"precision": precision}));
        client.post(&format!("{path}/particles"), "{\"count\":5}").expect(201);
        let before = digest(&mut client, path);
        for (method, route, body) in requests() {
            let mut bytes = encode(&body, style);
            for (index, byte) in &changes {
                *index.get_mut(&mut bytes) ^= *byte;
            }
            let answer = send(&mut client, method, &format!("{path}{route}"), &bytes);
            prop_assert!(answer.status < 500, "{bytes:02x?}: {}", answer.text());
            let after = digest(&mut client, path);
            if answer.status >= 400 {
                prop_assert_eq!(&after, &before, "{:02x?}: {}", bytes, answer.text());
            } else {
                break;
            }
        }
    }
}

/// Requests to a world of five particles, with every shape of column in them.
fn requests() -> Vec<(&'static str, &'static str, Value)> {
    let columns = json!({
        "count": 2, "position": [[0.5, 1.0, -2.0], [3.25, 4.0, 5.5]], "velocity": [0.0, 1.5, 0.0],
        "acceleration": [null, [1.0, 2.0, 3.0]], "damping": [0.5, 0.75], "mass": 2.0,
        "drag": [[0.5, 0.25], [1.5, 2.5]], "gravitational_mass": [null, 3.5]
    });
    vec![
        ("POST", "/particles", columns.clone()),
        ("POST", "/particles", json!([{"position": [0.5, 1.5, 2.5], "damping": 0.5}, {"mass": 2.5}])),
        ("PATCH", "", json!({"gravity": "standard", "max_step": 0.5, "integrator": "rk4"})),
        ("PATCH", "/particles", json!({"ids": [0, 2], "damping": [0.5, 0.25]})),
        ("POST", "/forces", json!({"ids": [0, 4], "force": [[0.5, 1.5, 2.5], [3.5, 4.5, 5.5]]})),
        ("PUT", "/particles/0/mass", json!({"inverse_mass": 0.0})),
        ("POST", "/advance", json!({"duration": 0.5, "return": ["position"]})),
        (
            "POST",
            "/commands",
            json!({"commands": [
                {"create": columns}, {"add_force": {"ids": [0], "force": [1.5, 0.5, 0.5]}},
                {"advance": {"duration": 0.5}}, {"read": {"ids": [0, 1]}}, {"remove": {"ids": [1]}}
            ]}),
        ),
    ]
}

#[test]
fn a_body_that_is_cut_short_is_not_cbor() {
    let service = shared();
    let mut client = service.client();
    let path = world(&mut client, "cbor-cut", &json!({}));
    client.post(&format!("{path}/particles"), "{\"count\":5}").expect(201);
    let before = digest(&mut client, &path);
    for style in Style::ALL {
        for (method, route, body) in requests() {
            let bytes = encode(&body, style);
            for end in 0..bytes.len() {
                let answer = send(&mut client, method, &format!("{path}{route}"), &bytes[..end]).expect(400);
                assert_eq!(answer.json()["code"], "malformed_cbor", "{:02x?}", &bytes[..end]);
            }
            let behind = [bytes, vec![0xf6]].concat();
            send(&mut client, method, &format!("{path}{route}"), &behind).expect(400);
        }
    }
    assert_eq!(digest(&mut client, &path), before);
}

/// RFC 8949, appendix A, and RFC 8746: where each can stand, and what it is there.
#[test]
fn the_examples_of_the_rfcs_are_read() {
    let service = shared();
    let mut client = service.client();
    world(&mut client, "cbor-rfc", &json!({}));
    let mut damping = |number: &str| -> Result<f64, Value> {
        let body = [hex("a1 67 64616d70696e67"), hex(number)].concat();
        let answer = send(&mut client, "POST", "/v1/worlds/cbor-rfc/particles", &body);
        let json = answer.json();
        if answer.status == 201 { Ok(json["damping"].as_f64().expect("a number")) } else { Err(json) }
    };
    // As a damping, which takes 0 to 1 only: what else a number is stands in the refusal.
    for (number, value) in [
        ("00", 0.0_f64),
        ("01", 1.0),
        ("f90000", 0.0),
        ("f98000", 0.0),
        ("f93c00", 1.0),
        ("f90001", 5.960_464_477_539_063e-8),
        ("f90400", 0.000_061_035_156_25),
        ("fa3f800000", 1.0),
        ("fb3fb999999999999a", 0.1),
    ] {
        assert_eq!(damping(number).expect(number).to_bits(), value.to_bits(), "{number}");
    }
    for (number, code) in [
        ("0a", "damping_out_of_range"),
        ("1817", "damping_out_of_range"),
        ("1903e8", "damping_out_of_range"),
        ("1a000f4240", "damping_out_of_range"),
        ("1b000000e8d4a51000", "damping_out_of_range"),
        ("1bffffffffffffffff", "damping_out_of_range"),
        ("20", "damping_out_of_range"),
        ("3863", "damping_out_of_range"),
        ("3bffffffffffffffff", "damping_out_of_range"),
        ("f97bff", "damping_out_of_range"),
        ("fa47c35000", "damping_out_of_range"),
        ("fb7e37e43c8800759c", "damping_out_of_range"),
        ("f9c400", "damping_out_of_range"),
        ("f97c00", "not_finite"),
        ("f97e00", "not_finite"),
        ("f9fc00", "not_finite"),
        ("fa7f800000", "not_finite"),
        ("fa7fc00000", "not_finite"),
        ("fb7ff0000000000000", "not_finite"),
        ("fbfff0000000000000", "not_finite"),
        ("fb7ff8000000000000", "not_finite"),
        ("c249010000000000000000", "invalid_field"),
        ("c1 1a514b67b0", "invalid_field"),
        ("f4", "invalid_field"),
        ("f6", "invalid_field"),
        ("f7", "invalid_field"),
        ("f0", "invalid_field"),
        ("f8ff", "invalid_field"),
        ("4401020304", "invalid_field"),
        ("60", "invalid_field"),
        ("a0", "invalid_field"),
        ("f818", "malformed_cbor"),
        ("f814", "malformed_cbor"),
        ("1c", "malformed_cbor"),
        ("ff", "malformed_cbor"),
        ("61ff", "malformed_cbor"),
        ("5f 61 61 ff", "malformed_cbor"),
    ] {
        let problem = damping(number).expect_err(number);
        assert_eq!(problem["code"], code, "{number}: {problem}");
        assert_eq!(problem["pointer"].as_str(), (code != "malformed_cbor").then_some("/damping"), "{number}");
    }
    // As a position: lists, and typed arrays in the order of bytes that their tag says.
    let mut position = |list: &str| -> Value {
        let body = [hex("a1 68 706f736974696f6e"), hex(list)].concat();
        send(&mut client, "POST", "/v1/worlds/cbor-rfc/particles", &body).expect(201).json()["position"].clone()
    };
    for list in [
        "83 01 02 03",
        "9f 01 02 03 ff",
        "83 f93c00 fa40000000 fb4008000000000000",
        "d851 4c 3f800000 40000000 40400000",
        "d855 4c 0000803f 00000040 00004040",
        "d852 5818 3ff0000000000000 4000000000000000 4008000000000000",
        "d856 5818 000000000000f03f 0000000000000040 0000000000000840",
        "d855 5f 46 0000803f0000 46 004000004040 ff",
        "d840 43 01 02 03",
        "d841 46 0001 0002 0003",
        "d845 46 0100 0200 0300",
    ] {
        assert_eq!(position(list), json!([1.0, 2.0, 3.0]), "{list}");
    }
}

/// A typed array of one vector is for all, of several it has one for each; what is wrong with it is told with its place.
#[test]
fn typed_arrays_are_columns() {
    let service = shared();
    let mut client = service.client();
    for precision in ["single", "double"] {
        let path = world(&mut client, &format!("cbor-typed-{precision}"), &json!({"precision": precision}));
        let le64 = |numbers: &[f64]| tagged(86, &numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>());
        let mut create = |members: &[(&str, Vec<u8>)]| {
            let members: Vec<Vec<u8>> =
                members.iter().map(|(name, bytes)| [text(name), bytes.clone()].concat()).collect();
            let body = [head(5, members.len() as u64), members.concat()].concat();
            send(&mut client, "POST", &format!("{path}/particles"), &body)
        };
        let count = |count| ("count", head(0, count));
        create(&[count(3), ("velocity", le64(&[1.0, 2.0, 3.0]))]).expect(201);
        create(&[count(2), ("velocity", le64(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))]).expect(201);
        create(&[count(2), ("mass", le64(&[1.0, 2.0])), ("drag", le64(&[0.5, 0.25]))]).expect(201);
        create(&[count(0), ("position", le64(&[]))]).expect(201);
        let (nan, infinite) = (f64::NAN, f64::INFINITY);
        for (name, bytes, code, pointer) in [
            ("position", le64(&[1.0, 2.0]), "invalid_field", "/position"),
            ("position", le64(&[1.0; 9]), "length_mismatch", "/position"),
            ("position", le64(&[0.0, 0.0, 0.0, 0.0, nan, 0.0]), "not_finite", "/position/1"),
            ("velocity", le64(&[0.0, infinite, 0.0]), "not_finite", "/velocity"),
            ("acceleration", le64(&[0.0, 0.0, 0.0, -infinite, 0.0, 0.0]), "not_finite", "/acceleration/1"),
            ("damping", le64(&[0.5, nan]), "not_finite", "/damping/1"),
            ("damping", le64(&[0.5, 1.5]), "damping_out_of_range", "/damping/1"),
            ("mass", le64(&[infinite, 1.0]), "not_finite", "/mass/0"),
            ("inverse_mass", le64(&[1.0, nan]), "not_finite", "/inverse_mass/1"),
            ("drag", le64(&[0.5, 0.5, infinite, 0.5]), "not_finite", "/drag/1"),
            ("drag", le64(&[0.5, 0.5, 0.5]), "invalid_field", "/drag"),
            ("gravitational_mass", le64(&[nan, 0.5]), "not_finite", "/gravitational_mass/0"),
            ("position", tagged(85, &[0; 13]), "invalid_field", "/position"),
            ("position", tagged(64, &[0; 6]), "invalid_field", "/position"),
            ("position", tagged(84, &[0; 12]), "invalid_field", "/position"),
            ("position", [head(6, 86), text("no bytes")].concat(), "invalid_field", "/position"),
            ("count", le64(&[2.0]), "invalid_field", "/count"),
        ] {
            let answer =
                if name == "count" { create(&[(name, bytes)]) } else { create(&[count(2), (name, bytes)]) }.expect(422);
            let problem = answer.json();
            assert_eq!((&problem["code"], &problem["pointer"]), (&json!(code), &json!(pointer)), "{name}: {problem}");
        }
        // Finite as a double, not as a single.
        let large = create(&[count(2), ("position", le64(&[0.0, 0.0, 0.0, 0.0, 0.0, 1e39]))]);
        if precision == "single" {
            let problem = large.expect(422).json();
            assert_eq!((&problem["code"], &problem["pointer"]), (&json!("not_finite"), &json!("/position/1")));
        } else {
            large.expect(201);
        }
        let first = client.get(&format!("{path}/particles/0")).expect(200).json();
        assert_eq!(first["velocity"], json!([1.0, 2.0, 3.0]));
        let fifth = client.get(&format!("{path}/particles/4")).expect(200).json();
        assert_eq!(fifth["velocity"], json!([4.0, 5.0, 6.0]));
    }
}

/// What is no number is no number in a duration, a gravity or a longest step either.
#[test]
fn numbers_that_are_not_finite_are_refused_everywhere() {
    let service = shared();
    let mut client = service.client();
    let path = world(&mut client, "cbor-finite", &json!({"precision": "single"}));
    let particles = format!("{path}/particles");
    client.post(&particles, "{}").expect(201);
    for bits in ["f97c00", "fa7fc00000", "fbfff0000000000000"].map(hex) {
        let vector = [hex("83 01"), bits.clone(), hex("01")].concat();
        let typed = tagged(86, &[1.0_f64, f64::NAN, 1.0].map(f64::to_le_bytes).concat());
        for (method, route, name, value, pointer) in [
            ("POST", "/advance", "duration", &bits, "/duration"),
            ("PATCH", "", "gravity", &vector, "/gravity/1"),
            ("PATCH", "", "gravity", &typed, "/gravity/1"),
            ("PATCH", "", "max_step", &bits, "/max_step"),
            ("POST", "/particles", "position", &vector, "/position/1"),
            ("POST", "/particles/0/impulse", "impulse", &typed, "/impulse/1"),
            ("PUT", "/particles/0/mass", "mass", &bits, "/mass"),
        ] {
            let body = [head(5, 1), text(name), value.clone()].concat();
            let problem = send(&mut client, method, &format!("{path}{route}"), &body).expect(422).json();
            assert_eq!((&problem["code"], &problem["pointer"]), (&json!("not_finite"), &json!(pointer)), "{problem}");
        }
    }
    let too_large = [head(5, 1), text("damping"), hex("fb47efffffffffffff")].concat();
    let problem = send(&mut client, "POST", &particles, &too_large).expect(422).json();
    assert_eq!(problem["code"], "not_finite", "beyond the largest single");
}

/// As deep as a body can be, and as long as a length can claim: refused, at no cost.
#[test]
fn depths_and_lengths_are_refused_at_no_cost() {
    let service = Service::with(|config| config.in_flight_bytes_max = 64 << 20);
    let mut client = service.client();
    let path = world(&mut client, "a", &json!({}));
    client.post(&format!("{path}/particles"), "{\"count\":2}").expect(201);
    let before = digest(&mut client, &path);
    let deep = 100_000;
    let bombs = [
        [vec![0x81; deep], vec![0]].concat(),
        [vec![0x9f; deep], vec![0xff; deep]].concat(),
        [vec![0x9f; deep], vec![0x82; deep]].concat(),
        [[0xa1, 0x61, b'a'].repeat(deep), vec![0]].concat(),
        [[0xbf, 0x61, b'a'].repeat(deep), vec![0]].concat(),
        [vec![0xc1; deep], vec![0]].concat(),
        [[0xd8, 0x56].repeat(deep), vec![0x40]].concat(),
        vec![0x81; deep],
        hex("9b1000000000000000"),
        hex("9bffffffffffffffff 00"),
        hex("bb1000000000000000"),
        hex("bbffffffffffffffff 6161 00"),
        hex("5b1000000000000000"),
        hex("7b1000000000000000 61"),
        hex("d856 5b7ffffffffffffff8"),
        hex("d856 5bffffffffffffffff"),
    ];
    for (index, bomb) in bombs.iter().enumerate() {
        let member = |name: &str| [head(5, 1), text(name), bomb.clone()].concat();
        let among = |name: &str| [head(5, 2), text("count"), head(0, 2), text(name), bomb.clone()].concat();
        for (method, route, body) in [
            ("POST", "/particles", bomb.clone()),
            ("POST", "/particles", [vec![0x81], bomb.clone()].concat()),
            ("POST", "/particles", member("position")),
            ("POST", "/particles", among("position")),
            ("POST", "/particles", among("damping")),
            ("PATCH", "/particles", member("ids")),
            ("PATCH", "/particles", member("position")),
            ("PATCH", "", member("gravity")),
            ("PATCH", "", member("forces")),
            ("POST", "/advance", member("until")),
            ("POST", "/commands", member("commands")),
            ("POST", "/commands", [head(5, 1), text("commands"), vec![0x81], member("create")].concat()),
        ] {
            let answer = send(&mut client, method, &format!("{path}{route}"), &body);
            assert!(matches!(answer.status, 400 | 422), "{index} to {route}: {}", answer.text());
        }
        let many = [head(5, 1), text("worlds"), bomb.clone()].concat();
        let answer = send(&mut client, "POST", "/v1/commands", &many);
        assert!(matches!(answer.status, 400 | 422), "{index}: {}", answer.text());
    }
    assert_eq!(digest(&mut client, &path), before);
    assert!(client.get("/metrics").text().contains("\npointmass_in_flight_charged_bytes 0\n"));
}

/// One byte of CBOR can be an object or a number of a column: both are charged for as what they become.
#[test]
fn what_a_body_becomes_is_charged_before_it_is_parsed() {
    let service = Service::with(|config| config.in_flight_bytes_max = 8 << 20);
    let mut client = service.client();
    let path = world(&mut client, "a", &json!({}));
    let list = |byte: u8, count: usize| [head(4, count as u64), vec![byte; count]].concat();
    let columns =
        |column: Vec<u8>, count: u64| [head(5, 2), text("count"), head(0, count), text("damping"), column].concat();
    let particles = format!("{path}/particles");
    let objects = list(0xa0, 50_000);
    assert_eq!(send(&mut client, "POST", &particles, &objects).expect(503).json()["code"], "overloaded");
    send(&mut client, "POST", &particles, &columns(list(0x01, 500_000), 500_000)).expect(503);
    // The same as a typed array takes what it says.
    let typed = tagged(85, &1.0_f32.to_le_bytes().repeat(200_000));
    send(&mut client, "POST", &particles, &columns(typed, 200_000)).expect(201);
    send(&mut client, "POST", &particles, &list(0xa0, 10_000)).expect(201);
    assert_eq!(client.get(&path).expect(200).json()["particle_count"], 210_000);
}

/// Commands for many worlds, each in its own part of the body.
#[test]
fn commands_for_many_worlds_come_in_cbor() {
    let service = shared();
    let mut client = service.client();
    for style in Style::ALL {
        let worlds = [format!("cbor-a-{style:?}"), format!("cbor-b-{style:?}")];
        for name in &worlds {
            world(&mut client, name, &json!({"gravity": "standard"}));
        }
        let commands = json!({"worlds": {
            &worlds[0]: {"commands": [
                {"create": [{"position": [0.5, 1.5, 2.5]}, {"position": [1.5, 1.5, 2.5]}]},
                {"add_force": {"ids": [0, 1], "force": [[0.5, 1.5, 2.5], [3.5, 4.5, 5.5]]}},
                {"advance": {"duration": 0.5}}
            ]},
            &worlds[1]: {"commands": [{"create": {}}, {"impulse": {"ids": [0], "impulse": [0.5, "x", 0.5]}}]},
            "nobody": {"commands": []}
        }});
        let answer = send(&mut client, "POST", "/v1/commands", &encode(&commands, style)).expect(200).json();
        assert_eq!(answer["worlds"][&worlds[0]]["revision"], 1, "{answer}");
        let refused = format!("/worlds/{}/commands/1/impulse/impulse/1", worlds[1]);
        assert_eq!(answer["worlds"][&worlds[1]]["pointer"], refused, "{answer}");
        assert_eq!(answer["worlds"]["nobody"]["code"], "unknown_world", "{answer}");
    }
}

/// 404 before 400 before 412 before 422, as in JSON.
#[test]
fn refusals_come_in_their_order() {
    let service = shared();
    let mut client = service.client();
    let path = world(&mut client, "cbor-order", &json!({}));
    let stale = [("content-type", "application/cbor"), ("if-match", "\"9\"")];
    let unknown = encode(&json!({"damp": 1}), Style::Plain);
    for (target, body, status) in [
        ("/v1/worlds/cbor-nobody/particles", &b"\xff"[..], 404),
        (&format!("{path}/particles"), b"\xff", 400),
        (&format!("{path}/particles"), &unknown, 412),
    ] {
        client.send("POST", target, &stale, Some(body)).expect(status);
    }
    let problem = send(&mut client, "POST", &format!("{path}/particles"), &unknown).expect(422).json();
    assert_eq!((&problem["code"], &problem["pointer"]), (&json!("unknown_field"), &json!("/damp")));
    client.send("PUT", &path, &stale, Some(b"\xff")).expect(400);
    client.send("PUT", "/v1/worlds/cbor-empty", &[("content-type", "application/cbor")], Some(b"")).expect(201);
}
