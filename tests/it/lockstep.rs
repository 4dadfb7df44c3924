//! The service against the library: the same commands, through JSON and sockets on one side and by method calls on the
//! other, in both precisions and with every integrator. Everything that can be read is equal to the bit.

use std::fmt::Debug;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};

use pointmass::{
    Advance, Column, Command, Configure, DampingLaw, Drag, Error, Gravitation, Integrator, Limits, Mass, NewParticles,
    Outcome, Particle, ParticleId, Plane, Precision, Properties, Real, Selection, Settings, Until, World,
};
use proptest::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::physics::set;
use crate::service::{Client, Service};

/// A number that JSON carries in its own precision.
pub(crate) trait Number: Real + Serialize + DeserializeOwned {
    fn bits(self) -> u64;
    fn from_bits(bits: u64) -> Self;
}

impl Number for f32 {
    fn bits(self) -> u64 {
        self.to_bits().into()
    }
    fn from_bits(bits: u64) -> Self {
        f32::from_bits((bits >> 32) as u32)
    }
}

impl Number for f64 {
    fn bits(self) -> u64 {
        self.to_bits()
    }
    fn from_bits(bits: u64) -> Self {
        f64::from_bits(bits)
    }
}

#[derive(Debug, Deserialize)]
struct ReadParticle<R> {
    id: u64,
    position: [R; 3],
    velocity: [R; 3],
    acceleration: [R; 3],
    own_acceleration: Option<[R; 3]>,
    damping: R,
    mass: Option<R>,
    inverse_mass: R,
    force: [R; 3],
    drag: Option<[R; 2]>,
    gravitational_mass: Option<R>,
}

#[derive(Debug, Deserialize)]
struct ReadParticles<R> {
    time: f64,
    particles: Vec<ReadParticle<R>>,
}

/// A number from 64 random bits: mostly such as scenes have, sometimes any bits at all.
fn number<R: Number>(seed: u64) -> R {
    let any = R::from_bits(seed.rotate_left(17));
    match seed % 16 {
        0 if any.is_finite() => any,
        1 => R::ZERO,
        2 => R::nearest(-0.0),
        _ => R::nearest((seed >> 8) as f64 / (1u64 << 52) as f64 - 8.0),
    }
}

pub(crate) fn vector<R: Number>(seed: u64) -> [R; 3] {
    std::array::from_fn(|k| number(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(21 * k as u32 + 5)))
}

fn share<R: Number>(seed: u64) -> R {
    match seed % 5 {
        0 => R::ONE,
        1 => R::ZERO,
        _ => R::nearest((seed >> 11) as f64 / (1u64 << 53) as f64),
    }
}

fn mass<R: Number>(seed: u64) -> (Mass<R>, Value) {
    let magnitude: R = Real::abs(number::<R>(seed));
    if seed.is_multiple_of(3) {
        (Mass::Inverse(magnitude), json!({ "inverse_mass": magnitude }))
    } else {
        (Mass::Mass(magnitude), json!({ "mass": magnitude }))
    }
}

/// Coefficients of drag, or none.
fn drag<R: Number>(seed: u64) -> Option<[R; 2]> {
    (!seed.is_multiple_of(3)).then(|| [seed, seed.rotate_left(23)].map(|seed| share(seed.rotate_left(3))))
}

fn own_drag<R: Number>(seed: u64) -> Option<Drag<R>> {
    drag(seed).map(|[k1, k2]| Drag { k1, k2 })
}

/// A mass that attracts, or none.
fn attracting<R: Number>(seed: u64) -> Option<R> {
    (!seed.is_multiple_of(3)).then(|| share(seed.rotate_left(5)))
}

/// A command, as random numbers; what they mean depends on the precision and on the particles there are.
#[derive(Debug, Clone)]
pub(crate) struct Step {
    kind: u32,
    seeds: [u64; 6],
}

pub(crate) fn steps(most: usize) -> impl Strategy<Value = Vec<Step>> {
    let step = (0u32..14, any::<[u64; 6]>()).prop_map(|(kind, seeds)| Step { kind, seeds });
    prop::collection::vec(step, 1..=most)
}

/// The most steps of an advance, in the service and in the library: numbers from random bits make `dop853` take many.
const STEPS_MAX: u64 = 10_000;

fn service() -> &'static Service {
    static SERVICE: OnceLock<Service> = OnceLock::new();
    SERVICE.get_or_init(|| Service::with(|config| config.steps_max = STEPS_MAX))
}

pub(crate) struct Lockstep<R: Number> {
    pub(crate) world: World<R>,
    pub(crate) client: Client,
    pub(crate) path: String,
    /// The particles there are.
    pub(crate) ids: Vec<u64>,
    /// How bodies are sent: what they are, and their bytes.
    encode: Encode,
}

pub(crate) type Encode = fn(&Value) -> (&'static str, Vec<u8>);

fn merged(a: Value, b: Value) -> Value {
    let mut a = a;
    if let (Value::Object(a), Value::Object(b)) = (&mut a, b) {
        a.extend(b);
    }
    a
}

impl<R: Number> Lockstep<R> {
    pub(crate) fn new(settings: Settings<R>) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let path = format!("/v1/worlds/lockstep-{}", NEXT.fetch_add(1, Ordering::Relaxed));
        let mut client = service().client();
        let gravity: [R; 3] = settings.gravity.into();
        let body = json!({
            "precision": R::PRECISION.name(), "integrator": settings.integrator.name(), "gravity": gravity,
            "damping_law": settings.damping_law.name(), "max_step": settings.max_step
        });
        client.put(&path, &body.to_string()).expect(201);
        let limits = Limits { steps: STEPS_MAX, ..Limits::default() };
        let world = World::with_limits(settings, limits).expect("valid settings");
        Self {
            world,
            client,
            path,
            ids: Vec::new(),
            encode: |body| ("application/json", body.to_string().into_bytes()),
        }
    }

    fn id(&self, seed: u64) -> u64 {
        if self.ids.is_empty() || seed.is_multiple_of(23) {
            seed % 40
        } else {
            self.ids[(seed >> 5) as usize % self.ids.len()]
        }
    }

    fn particle(seeds: &[u64; 6]) -> (Particle<R>, Value) {
        let (mass, mass_json) = mass(seeds[3]);
        let own = (!seeds[2].is_multiple_of(3)).then(|| vector::<R>(seeds[2]));
        let particle = Particle {
            position: vector::<R>(seeds[0]).into(),
            velocity: vector::<R>(seeds[1]).into(),
            acceleration: own.map(Into::into),
            damping: share(seeds[4]),
            mass,
            drag: own_drag(seeds[5]),
            gravitational_mass: attracting(seeds[2]),
        };
        let json = json!({
            "position": vector::<R>(seeds[0]), "velocity": vector::<R>(seeds[1]), "acceleration": own,
            "damping": particle.damping, "drag": drag::<R>(seeds[5]), "gravitational_mass": attracting::<R>(seeds[2])
        });
        (particle, merged(json, mass_json))
    }

    /// The command, and the request that says the same.
    #[expect(clippy::too_many_lines, reason = "one row for each kind")]
    fn translate(&self, step: &Step) -> (Command<R>, &'static str, String, Value) {
        let s = &step.seeds;
        let id = self.id(s[0]);
        let of = |id: u64, rest: &str| format!("{}/particles/{id}{rest}", self.path);
        let ids: Vec<u64> = (0..s[1] % 4).map(|k| self.id(s[2].rotate_left(9 * k as u32))).collect();
        let selected = Selection::Ids(ids.iter().copied().map(ParticleId).collect());
        let each = |seed: u64, count: usize| -> Vec<[R; 3]> {
            (0..count).map(|k| vector(seed.rotate_left(7 * k as u32))).collect()
        };
        let own = (!s[2].is_multiple_of(3)).then(|| vector::<R>(s[2]));
        let particles = format!("{}/particles", self.path);
        match step.kind {
            0 => {
                let (particle, json) = Self::particle(s);
                (Command::Create(particle.into()), "POST", particles, json)
            }
            1 => {
                let many: Vec<(Particle<R>, Value)> =
                    (0..s[5] % 5).map(|k| Self::particle(&s.map(|seed| seed.rotate_left(11 * k as u32 + 1)))).collect();
                let new = many.iter().map(|(particle, _)| *particle).collect();
                let list = Value::Array(many.into_iter().map(|(_, json)| json).collect());
                (Command::Create(new), "POST", particles, list)
            }
            2 => {
                let count = (s[5] % 5) as usize;
                let positions: Vec<[R; 3]> = (0..count).map(|k| vector(s[0].rotate_left(7 * k as u32))).collect();
                let (mass, mass_json) = mass(s[3]);
                let new = NewParticles {
                    count,
                    position: Column::PerParticle(positions.iter().map(|p| (*p).into()).collect()),
                    velocity: Column::Uniform(vector::<R>(s[1]).into()),
                    damping: Column::Uniform(share(s[4])),
                    mass: Column::Uniform(mass),
                    drag: Column::Uniform(own_drag(s[2])),
                    gravitational_mass: Column::PerParticle((0..count).map(|k| attracting(s[5] + k as u64)).collect()),
                    ..NewParticles::default()
                };
                let attracting: Vec<Option<R>> = (0..count).map(|k| attracting(s[5] + k as u64)).collect();
                let json = json!({
                    "count": count, "position": positions, "velocity": vector::<R>(s[1]), "damping": share::<R>(s[4]),
                    "drag": drag::<R>(s[2]), "gravitational_mass": attracting
                });
                (Command::Create(new), "POST", particles, merged(json, mass_json))
            }
            3 => {
                let (mass, json) = mass(s[3]);
                let command = set(ParticleId(id).into(), None, None, Some(Column::Uniform(mass)));
                (command, "PUT", of(id, "/mass"), json)
            }
            4 => {
                let properties = Properties {
                    acceleration: Some(Column::Uniform(own.map(Into::into))),
                    damping: Some(Column::Uniform(share(s[4]))),
                    drag: Some(Column::Uniform(own_drag(s[3]))),
                    gravitational_mass: Some(Column::Uniform(attracting(s[1]))),
                    ..Properties::default()
                };
                let json = json!({
                    "acceleration": own, "damping": share::<R>(s[4]), "drag": drag::<R>(s[3]),
                    "gravitational_mass": attracting::<R>(s[1])
                });
                (Command::Set { ids: ParticleId(id).into(), properties }, "PATCH", of(id, ""), json)
            }
            5 => {
                let dampings: Vec<R> = (0..ids.len()).map(|k| share(s[4].rotate_left(k as u32))).collect();
                let json = json!({"ids": ids, "damping": dampings, "acceleration": own});
                let command = set(
                    selected,
                    Some(Column::Uniform(own.map(Into::into))),
                    Some(Column::PerParticle(dampings)),
                    None,
                );
                (command, "PATCH", particles, json)
            }
            6 => {
                let properties = Properties {
                    damping: Some(Column::Uniform(share(s[4]))),
                    drag: Some(Column::Uniform(own_drag(s[3]))),
                    ..Properties::default()
                };
                let json = json!({"damping": share::<R>(s[4]), "drag": drag::<R>(s[3])});
                (Command::Set { ids: Selection::All, properties }, "PATCH", particles, json)
            }
            7 => {
                let command =
                    Command::AddForce { ids: ParticleId(id).into(), force: Column::Uniform(vector::<R>(s[1]).into()) };
                (command, "POST", of(id, "/force"), json!({"force": vector::<R>(s[1])}))
            }
            8 => {
                // Who names no particles means all of them.
                let all = s[0].is_multiple_of(3);
                let (ids, selected) = if all { (&self.ids, Selection::All) } else { (&ids, selected) };
                let (force, json) = if s[4].is_multiple_of(3) {
                    (Column::Uniform(vector::<R>(s[3]).into()), json!({ "force": vector::<R>(s[3]) }))
                } else {
                    let forces = each(s[3], ids.len());
                    (Column::PerParticle(forces.iter().map(|f| (*f).into()).collect()), json!({ "force": forces }))
                };
                let json = if all { json } else { merged(json, json!({ "ids": ids })) };
                (Command::AddForce { ids: selected, force }, "POST", format!("{}/forces", self.path), json)
            }
            9 => {
                let command =
                    Command::Impulse { ids: ParticleId(id).into(), impulse: Column::Uniform(vector::<R>(s[1]).into()) };
                (command, "POST", of(id, "/impulse"), json!({"impulse": vector::<R>(s[1])}))
            }
            10 => {
                let position = vector::<R>(s[1]);
                let command = Command::Place {
                    ids: ParticleId(id).into(),
                    position: Some(Column::Uniform(position.into())),
                    velocity: None,
                };
                (command, "POST", of(id, "/place"), json!({"position": position}))
            }
            11 => (Command::Remove { ids: ParticleId(id).into() }, "DELETE", of(id, ""), Value::Null),
            12 => {
                let gravity = vector::<R>(s[1]);
                let integrator = s[2].is_multiple_of(2).then(|| Integrator::ALL[(s[3] % 7) as usize]);
                let mut json = json!({"gravity": gravity});
                if let Some(integrator) = integrator {
                    json = merged(json, json!({"integrator": integrator.name()}));
                }
                let mut configure = Configure { gravity: Some(gravity.into()), integrator, ..Configure::default() };
                if s[4].is_multiple_of(2) {
                    let own = drag::<R>(s[5]);
                    let constant = attracting::<R>(s[3]);
                    configure.drag = Some(own_drag(s[5]));
                    configure.gravitation =
                        Some(constant.map(|constant| Gravitation { constant, softening: R::nearest(0.5) }));
                    json = merged(
                        json,
                        json!({"forces": {
                            "drag": own.map(|[k1, k2]| json!({"k1": k1, "k2": k2})),
                            "gravitation": constant.map(|constant| json!({"constant": constant, "softening": 0.5}))
                        }}),
                    );
                }
                (Command::Configure(configure), "PATCH", self.path.clone(), json)
            }
            _ => {
                let duration = (s[0] % 1000) as f64 / 128.0;
                let (steps, max_step) = match s[1] % 4 {
                    0 => (Some(s[2] % 150), None),
                    1 => (None, Some((s[2] % 64) as f64 / 256.0)),
                    _ => (None, None),
                };
                let mut json = json!({"duration": duration});
                if let Some(steps) = steps {
                    json = merged(json, json!({"steps": steps}));
                }
                if let Some(max_step) = max_step {
                    json = merged(json, json!({"max_step": max_step}));
                }
                let report_error = s[3].is_multiple_of(3);
                if report_error {
                    json = merged(json, json!({"report_error": true}));
                }
                let plane = Plane { normal: vector::<f64>(s[4]), offset: number(s[5]) };
                let until = s[5].is_multiple_of(4).then_some(Until { particle: ParticleId(id), plane });
                if let Some(Until { particle, plane }) = until {
                    let plane = json!({"normal": plane.normal, "offset": plane.offset});
                    json = merged(json, json!({"until": {"particle": particle.0, "plane": plane}}));
                }
                (
                    Command::Advance(Advance { duration, steps, max_step, report_error, until }),
                    "POST",
                    format!("{}/advance", self.path),
                    json,
                )
            }
        }
    }

    /// The command, and the member of a batch that says the same; a batch does not configure.
    pub(crate) fn member(&self, step: &Step) -> Option<(Command<R>, Value)> {
        let (mut command, _, _, json) = self.translate(step);
        if step.seeds[3].is_multiple_of(3)
            && let Command::Impulse { ids, .. } | Command::Place { ids, .. } = &mut command
        {
            *ids = Selection::All;
        }
        let (name, ids) = match &command {
            Command::Create(_) => ("create", None),
            Command::Place { ids, .. } => ("place", Some(ids)),
            Command::Set { ids, .. } => ("set", Some(ids)),
            Command::AddForce { ids, .. } => ("add_force", Some(ids)),
            Command::Impulse { ids, .. } => ("impulse", Some(ids)),
            Command::Remove { ids } => ("remove", Some(ids)),
            Command::Advance(_) => ("advance", None),
            Command::Configure(_) => return None,
        };
        let ids = match ids {
            Some(Selection::Ids(ids)) => json!({"ids": ids.iter().map(|id| id.0).collect::<Vec<_>>()}),
            Some(Selection::All) | None => Value::Null,
        };
        let json = if json.is_null() { ids } else { merged(json, ids) };
        Some((command, json!({ name: json })))
    }

    fn step(&mut self, step: &Step) -> Result<(), TestCaseError> {
        let (command, method, path, json) = self.translate(step);
        let context = format!("{method} {path} {json}");
        let outcome = self.world.apply(&command);
        let body = (json != Value::Null).then(|| (self.encode)(&json));
        let content_type = body.as_ref().map(|(content_type, _)| ("content-type", *content_type));
        let bytes = body.as_ref().map(|(_, bytes)| bytes.as_slice());
        let answer = self.client.send(method, &path, content_type.as_slice(), bytes);
        prop_assert_eq!(outcome.is_ok(), answer.status < 300, "{}: {:?} against {}", context, outcome, answer.text());
        match outcome {
            Ok(Outcome::Created { first, count }) => self.ids.extend(first.0..first.0 + count as u64),
            Ok(Outcome::Advanced(advanced)) => {
                let body = answer.json();
                let counts = [
                    ("integrated", advanced.integrated),
                    ("deferred", advanced.deferred),
                    ("skipped", advanced.skipped),
                ];
                for (name, count) in counts {
                    prop_assert_eq!(&body[name], &json!(count), "{}: {}", name, context);
                }
                let number = |value: &Value| value.as_f64().map(f64::to_bits);
                let error = advanced.error.map(|error| [error.position, error.velocity].map(|x| x.min(f64::MAX)));
                prop_assert_eq!(number(&body["error"]["position"]), error.map(|[p, _]| p.to_bits()), "{}", context);
                prop_assert_eq!(number(&body["error"]["velocity"]), error.map(|[_, v]| v.to_bits()), "{}", context);
                prop_assert_eq!(body["crossed"].as_bool(), advanced.crossed, "{}", context);
                prop_assert_eq!(number(&body["time"]), Some(advanced.time.to_bits()), "{}", context);
                prop_assert_eq!(&body["steps"], &json!(advanced.steps), "{}", context);
                prop_assert_eq!(body["step"].as_f64().map(f64::to_bits), Some(advanced.step.to_bits()), "{}", context);
            }
            Err(Error::Diverged { particle, quantity, step }) => {
                let problem = answer.json();
                prop_assert_eq!(&problem["particle"], &json!(particle.0), "{}", context);
                prop_assert_eq!(&problem["quantity"], &json!(quantity.name()), "{}", context);
                prop_assert_eq!(&problem["step"], &json!(step), "{}", context);
            }
            Ok(Outcome::Changed { .. } | Outcome::Configured) | Err(_) => {}
        }
        if answer.status == 204 {
            self.ids.retain(|id| self.world.contains(ParticleId(*id)));
        }
        if answer.status < 300 {
            let etag = format!("\"{}\"", self.world.revision());
            prop_assert_eq!(answer.header("etag"), Some(etag.as_str()), "{}", context);
        }
        // Reads are as random as the rest: they must not change a bit.
        if step.seeds[5].is_multiple_of(3) { self.compare(&context) } else { Ok(()) }
    }

    pub(crate) fn compare(&mut self, context: &str) -> Result<(), TestCaseError> {
        let read: ReadParticles<R> = self.client.get(&format!("{}/particles", self.path)).expect(200).typed();
        prop_assert_eq!(read.time.to_bits(), self.world.time().to_bits(), "time after {}", context);
        prop_assert_eq!(read.particles.len(), self.world.particle_count(), "count after {}", context);
        let digest = self.client.get(&format!("{}/digest", self.path)).expect(200).json();
        prop_assert_eq!(&digest["digest"], &json!(self.world.digest().to_string()), "digest after {}", context);
        let bits = |v: [R; 3]| v.map(Number::bits);
        for (served, state) in read.particles.iter().zip(self.world.particles()) {
            prop_assert_eq!(served.id, state.id.0, "id after {}", context);
            let pairs = [
                ("position", served.position, state.position.into()),
                ("velocity", served.velocity, state.velocity.into()),
                ("acceleration", served.acceleration, state.acceleration.into()),
                ("force", served.force, state.force.into()),
            ];
            for (name, served, own) in pairs {
                prop_assert_eq!(
                    bits(served),
                    bits(own),
                    "{} of {:?}: {:?} served, {:?} own, after {}",
                    name,
                    state.id,
                    served,
                    own,
                    context
                );
            }
            prop_assert_eq!(
                served.own_acceleration.map(bits),
                state.own_acceleration.map(|a| bits(a.into())),
                "after {}",
                context
            );
            prop_assert_eq!(served.damping.bits(), state.damping.bits(), "damping after {}", context);
            prop_assert_eq!(served.inverse_mass.bits(), state.inverse_mass.bits(), "inverse mass after {}", context);
            prop_assert_eq!(served.mass.map(Number::bits), state.mass().map(Number::bits), "mass after {}", context);
            let drag = state.drag.map(|drag| [drag.k1, drag.k2].map(Number::bits));
            prop_assert_eq!(served.drag.map(|drag| drag.map(Number::bits)), drag, "drag after {}", context);
            let attracting = state.gravitational_mass.map(Number::bits);
            prop_assert_eq!(served.gravitational_mass.map(Number::bits), attracting, "after {}", context);
        }
        Ok(())
    }
}

fn run<R: Number>(integrator: Integrator, law: DampingLaw, gravity: u64, steps: &[Step]) -> Result<(), TestCaseError> {
    let settings =
        Settings { integrator, gravity: vector::<R>(gravity).into(), damping_law: law, ..Settings::default() };
    run_in(Lockstep::<R>::new(settings), steps)
}

/// The same steps in a world of the default settings, with bodies in another encoding.
pub(crate) fn run_encoded<R: Number>(encode: Encode, steps: &[Step]) -> Result<(), TestCaseError> {
    run_in(Lockstep { encode, ..Lockstep::<R>::new(Settings::default()) }, steps)
}

fn run_in<R: Number>(mut lockstep: Lockstep<R>, steps: &[Step]) -> Result<(), TestCaseError> {
    for step in steps {
        lockstep.step(step)?;
    }
    lockstep.compare("the end")?;
    let path = lockstep.path.clone();
    lockstep.client.delete(&path).expect(204);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, ..ProptestConfig::default() })]
    #[test]
    fn service_and_library_agree_to_the_bit(steps in steps(24), gravity in any::<u64>()) {
        for integrator in Integrator::ALL {
            for law in DampingLaw::ALL {
                if !integrator.serves(law) {
                    continue;
                }
                for precision in Precision::ALL {
                    match precision {
                        Precision::Single => run::<f32>(integrator, law, gravity, &steps)?,
                        Precision::Double => run::<f64>(integrator, law, gravity, &steps)?,
                    }
                }
            }
        }
    }

    /// What is sent comes back with the same bits, in either precision.
    #[test]
    fn numbers_come_back_with_their_bits(bits in prop::collection::vec(any::<u64>(), 30)) {
        round_trip::<f32>(&bits)?;
        round_trip::<f64>(&bits)?;
    }
}

fn round_trip<R: Number>(bits: &[u64]) -> Result<(), TestCaseError> {
    let numbers: Vec<R> = bits.iter().map(|bits| R::from_bits(*bits)).filter(|x| x.is_finite()).collect();
    let vectors: Vec<[R; 3]> = numbers.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect();
    let mut lockstep = Lockstep::<R>::new(Settings::default());
    let body = json!({"count": vectors.len(), "position": vectors, "velocity": vectors});
    lockstep.client.post(&format!("{}/particles", lockstep.path), &body.to_string()).expect(201);
    let read: ReadParticles<R> = lockstep.client.get(&format!("{}/particles", lockstep.path)).expect(200).typed();
    for (sent, read) in vectors.iter().zip(&read.particles) {
        prop_assert_eq!(sent.map(Number::bits), read.position.map(Number::bits));
        prop_assert_eq!(sent.map(Number::bits), read.velocity.map(Number::bits));
    }
    let path = lockstep.path.clone();
    lockstep.client.delete(&path).expect(204);
    Ok(())
}
