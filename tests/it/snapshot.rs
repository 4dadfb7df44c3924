//! Snapshots: what is restored has the same future to the bit, and what is not as it was written is refused.

use std::fmt::Debug;
use std::sync::LazyLock;

use pointmass::{
    Advance, Column, Command, Configure, Drag, Error, Field, Forces, Gravitation, Integrator, Limit, Limits, Mass,
    NewParticles, Outcome, Particle, ParticleId, Place, Plane, Precision, Properties, Real, Selection, Settings,
    Snapshot, SnapshotError, Until, World,
};
use proptest::prelude::*;
use serde_json::Value;

use crate::physics::{Random, in_steps, set};
use crate::service::{Answer, Client, Service};

const LIMITS: Limits = Limits { particles: 300, steps: 2000, particle_steps: 100_000, interactions: 1_000_000 };

fn snapshot<R: Real>(world: &World<R>) -> Vec<u8> {
    let mut bytes = Vec::new();
    world.snapshot(&mut bytes).expect("a vector takes all");
    bytes
}

#[track_caller]
fn restored<R: Real>(bytes: &[u8]) -> World<R> {
    World::restore(bytes, LIMITS).expect("it is a snapshot")
}

/// The CRC-32 of ISO 3309, bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    let byte = |sum: u32, byte: &u8| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| if sum & 1 == 1 { (sum >> 1) ^ 0xedb8_8320 } else { sum >> 1 })
    };
    !bytes.iter().fold(!0, byte)
}

/// The same bytes with the checksum that they should have.
fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len() - 4;
    let sum = crc32(&bytes[..end]);
    bytes[end..].copy_from_slice(&sum.to_le_bytes());
    bytes
}

/// Everything that can be read, to the bit.
fn read<R: Real>(world: &World<R>) -> impl PartialEq + Debug + use<R> {
    let particles: Vec<String> = world.particles().map(|state| format!("{state:?}")).collect();
    (world.digest(), world.time(), world.step_count(), *world.settings(), particles)
}

/// Bounds decide what is looked at, and they are found out anew.
fn without_looks(outcome: Result<Outcome, Error>) -> Result<Outcome, Error> {
    outcome.map(|outcome| match outcome {
        Outcome::Advanced(mut advanced) => {
            advanced.inspected = 0;
            Outcome::Advanced(advanced)
        }
        other @ (Outcome::Created { .. } | Outcome::Changed { .. } | Outcome::Configured) => other,
    })
}

/// Any command at all; about some particles, all of them, or none.
fn any_command<R: Real>(world: &World<R>, random: &mut Random) -> Command<R> {
    let mut ids: Vec<ParticleId> = world.particles().map(|state| state.id).collect();
    let one = random.particle::<R>();
    let some = |random: &mut Random| match ids.len() {
        0 => Selection::All,
        n if random.below(2) == 0 => Selection::Ids(vec![ids[random.below(n)]]),
        _ => Selection::All,
    };
    let amount = |random: &mut Random| R::nearest(random.unit());
    match random.below(14) {
        0 => Command::Create(NewParticles { count: random.below(9), ..one.into() }),
        1 => {
            let acceleration = (random.below(2) == 0).then_some(Column::Uniform(one.acceleration));
            let mass = (random.below(2) == 0).then_some(Column::Uniform(one.mass));
            set(some(random), acceleration, Some(Column::Uniform(one.damping)), mass)
        }
        2 => {
            let drag = (random.below(3) > 0).then(|| Drag { k1: amount(random), k2: amount(random) });
            let gravitational_mass = (random.below(3) > 0).then(|| amount(random));
            let properties = Properties {
                drag: Some(Column::Uniform(drag)),
                gravitational_mass: Some(Column::Uniform(gravitational_mass)),
                ..Properties::default()
            };
            Command::Set { ids: some(random), properties }
        }
        3 => {
            let force = random.one_of(&[[0.0; 3], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.1, 0.2, 0.3]]);
            Command::AddForce { ids: some(random), force: Column::Uniform(force.map(R::nearest).into()) }
        }
        4 if random.below(3) == 0 => Command::Configure(Configure {
            gravity: random.one_of(&[None, Some(one.velocity)]),
            max_step: random.one_of(&[None, Some(None), Some(Some(0.125))]),
            integrator: random.one_of(&[None, None, Some(Integrator::Exact), Some(world.settings().integrator)]),
            ..Configure::default()
        }),
        5..8 => {
            let plane = Plane { normal: [0.0, 1.0, 0.0], offset: 0.0 };
            let until = ids.first().filter(|_| random.below(3) == 0).map(|id| Until { particle: *id, plane });
            let steps = 1 + random.below(40) as u64;
            let report_error = random.below(3) == 0;
            let advance = in_steps(world.settings().integrator, steps, random.unit());
            Command::Advance(Advance { until, report_error, ..advance })
        }
        _ => random.command(&mut ids),
    }
}

/// A world with a past.
fn after<R: Real>(settings: Settings<R>, random: &mut Random, commands: usize) -> World<R> {
    let mut world = World::with_limits(settings, LIMITS).expect("valid");
    for _ in 0..commands {
        let _may_be_refused = world.apply(&any_command(&world, random));
    }
    world
}

fn settings<R: Real>(integrator: Integrator, compensated: bool, random: &mut Random) -> Settings<R> {
    let amount = |random: &mut Random| R::nearest(random.unit());
    let some = |random: &mut Random| integrator.serves_forces() && random.below(2) == 0;
    Settings {
        integrator,
        gravity: random.one_of(&[[0.0; 3], [0.1, -9.8, 0.0]]).map(R::nearest).into(),
        forces: Forces {
            drag: some(random).then(|| Drag { k1: amount(random), k2: amount(random) }),
            gravitation: some(random).then(|| Gravitation { constant: amount(random), softening: R::HALF }),
        },
        compensated,
        ..Settings::default()
    }
}

/// A, snapshot, B; restore, B again.
fn check_future<R: Real>(integrator: Integrator, compensated: bool, seed: u64) {
    let random = &mut Random(seed);
    let mut world = after(settings::<R>(integrator, compensated, random), random, 25);
    let written = snapshot(&world);
    let mut again = restored::<R>(&written);
    let context = format!("{integrator}, {}, compensated: {compensated}, seed {seed}", R::PRECISION);
    assert!(snapshot(&again) == written, "{context}");
    assert_eq!(read(&again), read(&world), "{context}");
    assert_eq!(again.revision(), 0, "{context}");
    for n in 0..25 {
        let command = any_command(&world, random);
        let outcome = without_looks(world.apply(&command));
        assert_eq!(without_looks(again.apply(&command)), outcome, "{context}: {n}, {command:?}");
        assert_eq!(read(&again), read(&world), "{context}: {n}, {command:?}");
        if n % 4 == 0 {
            let written = snapshot(&again);
            again = restored(&written);
            assert!(snapshot(&again) == written, "{context}: {n}, {command:?}");
        }
    }
}

#[test]
fn a_restored_world_has_the_same_future_to_the_bit() {
    for seed in 0..15 {
        for integrator in Integrator::ALL {
            for compensated in [false, true] {
                check_future::<f32>(integrator, compensated, seed);
                check_future::<f64>(integrator, compensated, seed);
            }
        }
    }
}

/// The form that the head of `src/world/snapshot.rs` tells, written down by hand.
#[test]
fn the_form_is_the_one_that_is_described() {
    let mut world =
        World::<f32>::new(Settings { gravity: [0.0, -2.0, 0.5].into(), ..Settings::default() }).expect("valid");
    world.advance(3.0).expect("an empty world");
    let plain = Particle { position: [1.0, -0.0, 0.0].into(), ..Particle::default() };
    world.create(plain).expect("valid");
    world.create(plain).expect("valid");
    world.advance(0.25).expect("finite");
    let own = Some([7.0, 8.0, 9.0].into());
    let id =
        world.create(Particle { acceleration: own, damping: 0.5, mass: Mass::Inverse(4.0), ..plain }).expect("valid");
    world.set_drag(id, Some(Drag { k1: 5.0, k2: 6.0 })).expect("valid");
    world.set_gravitational_mass(id, Some(3.0)).expect("valid");
    world.add_force(id, [10.0, 11.0, 12.0].into()).expect("finite");
    world.remove(ParticleId(0)).expect("it is there");

    let words = |words: &[u64]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    let reals = |reals: &[f32]| reals.iter().flat_map(|real| real.to_le_bytes()).collect::<Vec<u8>>();
    let f = f64::to_bits;
    let (uniform, each) = (words(&[0]), words(&[1]));
    let expected = [
        b"pmsnap\r\n".to_vec(),
        words(&[1, 1, 2, 3, 2, f(3.25), 0, 1, 1, 0, 0, 0, f(-2.0), f(0.5), 0, 0, 0, 0, 0, 0, f(1e-9), f(1e-9)]),
        words(&[2, 1]),
        reals(&[1.0, -0.0, 0.0, 1.0, -0.0, 0.0]),
        reals(&[0.0; 6]),
        words(&[2, f(3.25), 0, f(3.0), 0]),
        [0u32, 1].map(u32::to_le_bytes).concat(),
        [each.clone(), vec![1, 0]].concat(),
        [each.clone(), reals(&[7.0, 8.0, 9.0, 0.0, 0.0, 0.0])].concat(),
        [each.clone(), reals(&[0.5, 1.0])].concat(),
        [each.clone(), reals(&[4.0, 1.0])].concat(),
        [each.clone(), vec![1], reals(&[5.0, 6.0]), vec![0], reals(&[0.0, 0.0])].concat(),
        [each, vec![1], reals(&[3.0]), vec![0], reals(&[0.0])].concat(),
        [uniform, words(&[1, 2]), reals(&[10.0, 11.0, 12.0])].concat(),
        vec![0; 4],
    ];
    assert_eq!(snapshot(&world), signed(expected.concat()));
}

/// Small, and with something of everything.
static SMALL: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let forces = Forces { drag: Some(Drag::default()), gravitation: Some(Gravitation::default()) };
    let integrator = Integrator::VelocityVerlet;
    let settings = Settings { forces, compensated: true, integrator, max_step: Some(0.5), ..Settings::default() };
    let mut world = World::<f64>::new(settings).expect("valid");
    for x in 0..3 {
        let position = [x.into(), 0.0, 0.1].into();
        let id = world.create(Particle { position, ..Particle::default() }).expect("valid");
        world.set_drag(id, Some(Drag { k1: x.into(), k2: 0.0 })).expect("valid");
    }
    world.advance(1.0).expect("finite");
    world.remove(ParticleId(1)).expect("it is there");
    world.add_force(ParticleId(0), [1.0, 2.0, 3.0].into()).expect("finite");
    snapshot(&world)
});

/// And one with lazy bases.
static LAZY: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let mut world = World::<f32>::default();
    for _ in 0..3 {
        world.create(Particle { velocity: [1.0, 0.0, 0.0].into(), ..Particle::default() }).expect("valid");
        world.advance(0.1).expect("finite");
    }
    snapshot(&world)
});

#[test]
fn a_snapshot_with_another_byte_is_refused() {
    for good in [&*SMALL, &*LAZY] {
        let mut bytes = good.clone();
        for at in 0..bytes.len() {
            for change in 1..=u8::MAX {
                bytes[at] ^= change;
                let single = World::<f32>::restore(bytes.as_slice(), LIMITS);
                let double = World::<f64>::restore(bytes.as_slice(), LIMITS);
                assert!(single.is_err() && double.is_err(), "byte {at} changed by {change:#x}");
                bytes[at] ^= change;
            }
        }
    }
}

#[test]
fn a_snapshot_that_is_cut_or_goes_on_is_refused() {
    for len in 0..SMALL.len() {
        let cut = World::<f64>::restore(&SMALL[..len], LIMITS);
        assert!(matches!(cut, Err(SnapshotError::CutShort)), "{len}: {cut:?}");
    }
    let longer = [&SMALL[..], &[0]].concat();
    assert!(matches!(World::<f64>::restore(longer.as_slice(), LIMITS), Err(SnapshotError::TrailingBytes)));
}

/// Each refusal says what is wrong.
#[test]
fn every_refusal_of_a_snapshot_has_its_own_words() {
    fn forged(at: usize, bytes: &[u8]) -> String {
        let mut forged = SMALL.clone();
        forged[at..at + bytes.len()].copy_from_slice(bytes);
        World::<f64>::restore(signed(forged).as_slice(), LIMITS).expect_err("refused").to_string()
    }
    let word = |at: usize, word: u64| forged(8 * at, &word.to_le_bytes());
    let number = |at: usize, number: f64| word(at, number.to_bits());
    let mut damaged = SMALL.clone();
    damaged[300] ^= 1;
    let damaged = World::<f64>::restore(damaged.as_slice(), LIMITS).expect_err("damaged").to_string();
    let other = World::<f64>::restore(LAZY.as_slice(), LIMITS).expect_err("single").to_string();
    // Words from the start: 23 of the head, 2 ids, 6 numbers of positions.
    for (said, of) in [
        (forged(0, b"PK\x03\x04"), "no snapshot"),
        (word(1, 2), "version 2"),
        (word(2, 3), "precision is none"),
        (other, "in single precision"),
        (damaged, "checksum"),
        (word(3, 1 << 31), "2147483648 particles in a world are more than the limit of 300"),
        (word(3, 200), "next id"),
        (word(4, 1), "next id"),
        (word(4, u64::MAX), "next id"),
        (number(6, -1.0), "clock"),
        (number(6, f64::NAN), "clock"),
        (number(6, 1e300), "clock"),
        (number(7, 1.0), "clock"),
        (word(8, 8), "integrator is none"),
        (word(8, 1), "exact cannot serve drag or gravitation"),
        (word(9, 3), "damping law is none"),
        (word(9, 2), "cannot serve the damping law"),
        (word(10, 2), "only 0 and 1"),
        (number(11, -0.5), "max_step must be above 0"),
        (number(12, f64::INFINITY), "gravity must be finite"),
        (number(16, -1.0), "k1 must be at least 0"),
        (number(20, f64::NAN), "softening must be finite"),
        (number(21, -1.0), "absolute must be at least 0"),
        (word(23, 2), "there twice"),
        (word(23, 3), "never given"),
        (number(25, f64::NAN), "position (entry 0, from 0) must be finite"),
        (number(33, f64::INFINITY), "velocity (entry 0, from 0) must be finite"),
        (word(49, 3), "base times"),
        (number(50, 0.5), "base times"),
    ] {
        assert!(said.contains(of), "{said:?} does not say {of:?}");
    }
    let asked = Error::LimitReached { limit: Limit::Particles, allowed: 1, asked: 2 };
    let narrow = World::<f64>::restore(SMALL.as_slice(), Limits { particles: 1, ..LIMITS });
    assert!(matches!(narrow, Err(SnapshotError::Refused(error)) if error == asked), "{narrow:?}");
}

/// The closed form takes a base to the clock, where it may be anything.
#[test]
fn a_base_that_is_not_finite_at_the_clock_is_refused() {
    let mut world = World::<f64>::default();
    world.create(Particle { velocity: [1.0, 0.0, 0.0].into(), ..Particle::default() }).expect("valid");
    world.advance(1e10).expect("finite");
    let mut bytes = snapshot(&world);
    let velocity = 8 * (1 + 22 + 3);
    assert_eq!(bytes[velocity..velocity + 8], 1f64.to_le_bytes());
    bytes[velocity..velocity + 8].copy_from_slice(&1e300f64.to_le_bytes());
    let refused = World::<f64>::restore(signed(bytes).as_slice(), LIMITS);
    let place = Place { field: Field::Position, index: None };
    assert!(matches!(refused, Err(SnapshotError::Refused(error)) if error == Error::NotFinite(place)), "{refused:?}");
}

/// An own acceleration is 0 where there is none: who rests is told by it.
#[test]
fn an_acceleration_that_is_there_and_is_not_is_refused() {
    let mut world = World::<f64>::default();
    world.create(Particle::default()).expect("valid");
    let mut bytes = snapshot(&world);
    // After the head, the particle, its base time, and that it has none.
    let own = 8 * (23 + 6 + 3) + 9 + 8;
    bytes[own..own + 8].copy_from_slice(&1f64.to_le_bytes());
    let refused = World::<f64>::restore(signed(bytes).as_slice(), LIMITS);
    assert!(matches!(refused, Err(SnapshotError::Inconsistent(_))), "{refused:?}");
}

/// A count that nothing comes after takes no memory.
#[test]
fn what_is_announced_and_does_not_come_takes_no_memory() {
    let mut bytes = SMALL[..300].to_vec();
    for at in [3, 4] {
        bytes[8 * at..8 * at + 8].copy_from_slice(&u64::from(u32::MAX).to_le_bytes());
    }
    let refused = World::<f64>::restore(signed(bytes).as_slice(), Limits::default());
    assert!(matches!(refused, Err(SnapshotError::CutShort)), "{refused:?}");
}

#[test]
fn the_head_tells_what_a_snapshot_is_of() {
    let snapshot = Snapshot::open(LAZY.as_slice()).expect("it is one");
    assert_eq!((snapshot.precision(), snapshot.particle_count()), (Precision::Single, 3));
}

/// What is the same for all is written once, and stays so.
#[test]
fn a_uniform_world_takes_its_positions_and_velocities() {
    let mut world = World::<f64>::default();
    world.apply(&Command::Create(NewParticles { count: 10_000, ..NewParticles::default() })).expect("valid");
    let bytes = snapshot(&world).len();
    assert_eq!(bytes, 10_000 * 48 + 343);
}

/// Values that are nearly right, at any place of a snapshot with the right checksum.
fn check_forged<R: Real>(seed: u64) -> Result<(), TestCaseError> {
    let random = &mut Random(seed);
    let integrator = random.one_of(&Integrator::ALL);
    let commands = random.below(25);
    let compensated = random.below(2) == 0;
    let world = after(settings::<R>(integrator, compensated, random), random, commands);
    let mut bytes = snapshot(&world);
    for _ in 0..=random.below(3) {
        let number =
            random.one_of(&[0.0, -0.0, 1.0, -1.0, 0.5, 3.0, 1e-310, 1e38, 1e300, f64::MAX, f64::INFINITY, f64::NAN]);
        #[expect(clippy::cast_possible_truncation, reason = "as near as it gets")]
        let number_bytes = match R::PRECISION {
            Precision::Single => (number as f32).to_le_bytes().to_vec(),
            Precision::Double => number.to_le_bytes().to_vec(),
        };
        let small = random.below(5) as u64;
        let new = match random.below(5) {
            0 => vec![random.below(256) as u8],
            1 => number.to_le_bytes().to_vec(),
            2 => random.one_of(&[small, u64::MAX, u64::MAX - small, 1 << 61, 1 << 32]).to_le_bytes().to_vec(),
            3 => (small as u32).to_le_bytes().to_vec(),
            _ => number_bytes,
        };
        let end = bytes.len() - 4 - new.len();
        let head = 8 * 23;
        // The head is small beside the rest, and has most of the rules.
        let at = if random.below(3) == 0 { 8 * random.below(head / 8) } else { random.below(end) };
        bytes[at..at + new.len()].copy_from_slice(&new);
    }
    let Ok(mut world) = World::<R>::restore(signed(bytes).as_slice(), LIMITS) else { return Ok(()) };
    let written = snapshot(&world);
    prop_assert_eq!(&snapshot(&restored::<R>(&written)), &written);
    for _ in 0..15 {
        for state in world.particles() {
            let (p, v): ([R; 3], [R; 3]) = (state.position.into(), state.velocity.into());
            prop_assert!(p.into_iter().chain(v).all(Real::is_finite), "{:?}", state);
        }
        let _may_be_refused = world.apply(&any_command(&world, random));
    }
    prop_assert_eq!(restored::<R>(&snapshot(&world)).digest(), world.digest());
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4000, ..ProptestConfig::default() })]
    #[test]
    fn a_forged_snapshot_is_refused_or_harmless(seed in any::<u64>()) {
        check_forged::<f32>(seed)?;
        check_forged::<f64>(seed)?;
    }
}

/// A scene over HTTP with forces that pend, gaps in the ids and bases of several times.
fn scene(client: &mut Client, path: &str, settings: &str) {
    client.put(path, settings).expect(201);
    let particles = format!("{path}/particles");
    client.post(&particles, "{\"count\":5,\"velocity\":[1,2,3],\"damping\":0.5}").expect(201);
    client.post(&format!("{path}/advance"), "{\"duration\":0.5}").expect(200);
    client.post(&particles, "[{\"mass\":2},{\"inverse_mass\":0}]").expect(201);
    client.delete(&format!("{particles}/1")).expect(204);
    client.post(&format!("{path}/advance"), "{\"duration\":0.25}").expect(200);
    client.post(&format!("{particles}/5/force"), "{\"force\":[0.1,0,-8]}").expect(200);
}

fn digest(client: &mut Client, path: &str) -> Value {
    client.get(&format!("{path}/digest")).expect(200).json()["digest"].clone()
}

fn upload(client: &mut Client, path: &str, headers: &[(&str, &str)], bytes: &[u8]) -> Answer {
    client.send("PUT", &format!("{path}/snapshot"), headers, Some(bytes))
}

/// What must stay as it is when a request is refused.
fn trace(client: &mut Client) -> Value {
    let mut worlds = client.get("/v1/worlds").expect(200).json()["worlds"].clone();
    for world in worlds.as_array_mut().expect("a list") {
        let path = format!("/v1/worlds/{}", world["world"].as_str().expect("a name"));
        world["digest"] = digest(client, &path);
    }
    worlds
}

#[test]
fn a_clone_over_http_has_the_same_future() {
    let service = Service::start();
    let mut client = service.client();
    for (n, settings) in [
        "{\"gravity\":\"textbook\"}",
        "{\"precision\":\"single\",\"integrator\":\"newton_euler\",\"max_step\":0.01}",
        "{\"integrator\":\"rk4\",\"compensated\":true,\"forces\":{\"gravitation\":{\"softening\":0.1}}}",
    ]
    .into_iter()
    .enumerate()
    {
        let (path, clone) = (format!("/v1/worlds/a{n}"), format!("/v1/worlds/b{n}"));
        scene(&mut client, &path, settings);
        let taken = client.get(&format!("{path}/snapshot")).expect(200);
        assert_eq!(taken.header("content-type"), Some("application/octet-stream"));
        assert_eq!(taken.header("etag"), Some("\"6\""));
        let answer =
            upload(&mut client, &clone, &[("content-type", "application/octet-stream")], &taken.body).expect(201);
        assert_eq!((answer.header("location"), answer.header("etag")), (Some(clone.as_str()), Some("\"0\"")));
        assert_eq!(answer.json(), client.get(&clone).expect(200).json());
        assert_eq!(answer.json()["step_count"], client.get(&path).expect(200).json()["step_count"]);
        assert_eq!(client.get(&format!("{clone}/snapshot")).expect(200).body, taken.body);
        for duration in [0.5, 0.125] {
            let advance = format!("{{\"duration\":{duration}}}");
            let [mut one, mut other] =
                [&path, &clone].map(|path| client.post(&format!("{path}/advance"), &advance).expect(200).json());
            for report in [&mut one, &mut other] {
                report["revision"] = Value::Null;
            }
            assert_eq!(one, other);
            let [one, other] = [&path, &clone].map(|path| client.get(&format!("{path}/state")).expect(200).json());
            assert_eq!(one, other);
            assert_eq!(digest(&mut client, &path), digest(&mut client, &clone));
        }
        let unchanged = [("if-none-match", "\"8\"")];
        client.send("GET", &format!("{path}/snapshot"), &unchanged, None).expect(304);
    }
}

#[test]
fn a_restored_world_replaces_the_one_there_is_as_one_change() {
    let service = Service::start();
    let mut client = service.client();
    let path = "/v1/worlds/a";
    scene(&mut client, path, "{\"gravity\":\"textbook\"}");
    let (then, taken) = (digest(&mut client, path), client.get(&format!("{path}/snapshot")).expect(200).body);
    client.post(&format!("{path}/advance"), "{\"duration\":1}").expect(200);
    client.post(&format!("{path}/particles"), "{\"count\":9}").expect(201);
    assert_eq!(upload(&mut client, path, &[("if-match", "\"7\"")], &taken).status, 412);
    let answer = upload(&mut client, path, &[("if-match", "\"8\""), ("idempotency-key", "back")], &taken).expect(200);
    assert_eq!((answer.header("etag"), answer.json()["revision"].as_u64()), (Some("\"9\""), Some(9)));
    assert_eq!(answer.json(), client.get(path).expect(200).json());
    assert_eq!(digest(&mut client, path), then);
    assert_eq!(client.get("/v1/worlds").json()["worlds"][0], answer.json(), "the list knows it");
    client.post(&format!("{path}/advance"), "{\"duration\":1}").expect(200);
    let now = digest(&mut client, path);
    let again = upload(&mut client, path, &[("if-match", "\"8\""), ("idempotency-key", "back")], &taken).expect(200);
    assert_eq!((again.header("idempotency-replayed"), &again.body), (Some("true"), &answer.body));
    assert_eq!(digest(&mut client, path), now, "it was done once");
    let mut other = taken.clone();
    other.pop();
    assert_eq!(upload(&mut client, path, &[("idempotency-key", "back")], &other).status, 422);
    // Into a new name with a key, twice.
    let keyed = [("idempotency-key", "clone")];
    let first = upload(&mut client, "/v1/worlds/b", &keyed, &taken).expect(201);
    let second = upload(&mut client, "/v1/worlds/b", &keyed, &taken).expect(201);
    assert_eq!((second.header("idempotency-replayed"), &second.body), (Some("true"), &first.body));
}

#[test]
fn a_refused_snapshot_leaves_no_trace() {
    let service = Service::with(|config| {
        config.worlds_max = 3;
        config.particles_max = 20;
        config.memory_bytes_max = 256 * 25;
        config.snapshot_bytes_max = 4000;
    });
    let mut client = service.client();
    scene(&mut client, "/v1/worlds/a", "{}");
    scene(&mut client, "/v1/worlds/single", "{\"precision\":\"single\"}");
    let taken = client.get("/v1/worlds/a/snapshot").expect(200).body;
    let many = |count| {
        let mut world = World::<f64>::default();
        world.apply(&Command::Create(NewParticles { count, ..NewParticles::default() })).expect("valid");
        snapshot(&world)
    };
    let mut damaged = taken.clone();
    damaged[200] ^= 1;
    let mut later = taken.clone();
    later[8] = 2;
    let (cut, longer) = (taken[..taken.len() - 1].to_vec(), [&taken[..], &[0]].concat());
    let before = trace(&mut client);
    for (n, (body, status, code)) in [
        (Vec::new(), 400, "malformed_snapshot"),
        (b"{\"gravity\":\"textbook\"}".to_vec(), 400, "malformed_snapshot"),
        (cut, 400, "malformed_snapshot"),
        (longer, 400, "malformed_snapshot"),
        (damaged, 400, "malformed_snapshot"),
        (signed(later), 422, "unsupported_snapshot_version"),
        (many(21), 422, "limit_reached"),
        (many(18), 422, "limit_reached"),
        (vec![7; 4001], 413, "body_too_large"),
    ]
    .into_iter()
    .enumerate()
    {
        for path in ["/v1/worlds/a", "/v1/worlds/new"] {
            let answer = upload(&mut service.client(), path, &[], &body);
            assert_eq!((answer.status, &answer.json()["code"]), (status, &Value::from(code)), "{n}: {}", answer.text());
            assert_eq!(trace(&mut client), before, "{n}: {path}");
        }
    }
    for (path, headers, status, code) in [
        ("/v1/worlds/single", &[][..], 422, "precision_mismatch"),
        ("/v1/worlds/a", &[("content-type", "application/json")], 415, "unsupported_media_type"),
        ("/v1/worlds/new", &[("content-type", "text/plain")], 415, "unsupported_media_type"),
        ("/v1/worlds/new", &[("content-encoding", "gzip")], 415, "unsupported_media_type"),
        ("/v1/worlds/a", &[("accept", "application/octet-stream")], 406, "not_acceptable"),
        ("/v1/worlds/a", &[("if-match", "\"0\"")], 412, "revision_mismatch"),
        ("/v1/worlds/new", &[("if-match", "*")], 412, "revision_mismatch"),
        ("/v1/worlds/-", &[], 422, "invalid_world_name"),
        ("/v1/worlds/new", &[("idempotency-key", "")], 422, "invalid_idempotency_key"),
    ] {
        let answer = upload(&mut service.client(), path, headers, &taken);
        assert_eq!((answer.status, &answer.json()["code"]), (status, &Value::from(code)), "{path} {headers:?}");
        assert_eq!(trace(&mut client), before, "{path} {headers:?}");
    }
    let asked = client.send("PUT", "/v1/worlds/new/snapshot?x=1", &[], Some(&taken));
    assert_eq!(asked.status, 422, "{}", asked.text());
    for (path, accept, status) in
        [("nowhere", "*/*", 404), ("a", "application/json", 406), ("a", "application/octet-stream", 200)]
    {
        let answer = client.send("GET", &format!("/v1/worlds/{path}/snapshot"), &[("accept", accept)], None);
        assert_eq!(answer.status, status, "{path} {accept}");
    }
    // Cut short by the client.
    let head =
        format!("PUT /v1/worlds/new/snapshot HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n", taken.len());
    let mut leaving = service.client();
    leaving.raw(&[head.as_bytes(), &taken[..100]].concat());
    drop(leaving);
    assert_eq!(trace(&mut client), before);
    upload(&mut client, "/v1/worlds/b", &[], &taken).expect(201);
    let full = upload(&mut client, "/v1/worlds/c", &[], &taken);
    assert_eq!((full.status, &full.json()["code"]), (422, &Value::from("limit_reached")));
}

/// In pieces of a few bytes, and large enough for the compute pool.
#[test]
fn a_snapshot_that_comes_in_pieces_is_restored() {
    let service = Service::start();
    let mut client = service.client();
    let mut world = World::<f64>::default();
    let random = &mut Random(5);
    let position = Column::PerParticle((0..3000).map(|_| random.vector(9.0).into()).collect());
    world.apply(&Command::Create(NewParticles { count: 3000, position, ..NewParticles::default() })).expect("valid");
    let bytes = snapshot(&world);
    let mut request =
        b"PUT /v1/worlds/a/snapshot HTTP/1.1\r\nhost: localhost\r\nidempotency-key: k\r\ntransfer-encoding: chunked\r\n\r\n"
            .to_vec();
    for piece in bytes.chunks(777) {
        request.extend(format!("{:x}\r\n", piece.len()).bytes());
        request.extend(piece.iter().chain(b"\r\n"));
    }
    request.extend(b"0\r\n\r\n");
    client.raw(&request);
    assert_eq!(client.answer(false).status, 201);
    assert_eq!(digest(&mut client, "/v1/worlds/a"), world.digest().to_string());
    assert_eq!(client.get("/v1/worlds/a/snapshot").expect(200).body, bytes);
    // The same to the byte, in one piece.
    let again = upload(&mut client, "/v1/worlds/a", &[("idempotency-key", "k")], &bytes).expect(201);
    assert_eq!(again.header("idempotency-replayed"), Some("true"));
    let plain = [("content-type", "application/x-www-form-urlencoded")];
    upload(&mut client, "/v1/worlds/a", &plain, &bytes).expect(200);
}
