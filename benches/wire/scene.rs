//! Particles with digits to write: the same world here and in the service.

use std::fmt::Debug;

use pointmass::{Advance, Column, Command, Integrator, NewParticles, ParticleId, Settings, States, World};
use serde::Deserialize;

use crate::cbor::{self, Number, Value};
use crate::client::{Client, request, request_with};

/// The headers of a request in CBOR that is to be answered in CBOR.
pub(crate) const CBOR: [&str; 2] = ["content-type: application/cbor", "accept: application/cbor"];

/// What all particles of a world keep that have no damping of their own.
const DAMPING: f64 = 0.99;

#[derive(Debug)]
pub(crate) struct Scene<R> {
    integrator: Integrator,
    pub(crate) position: Vec<[R; 3]>,
    pub(crate) velocity: Vec<[R; 3]>,
    /// Empty: the same for all.
    damping: Vec<R>,
}

/// The state of all particles, however it came.
#[derive(Debug, Deserialize)]
pub(crate) struct Columns<R> {
    pub(crate) time: f64,
    pub(crate) id: Vec<u64>,
    pub(crate) position: Vec<[R; 3]>,
    /// Empty where it was not asked for.
    #[serde(default = "Vec::new")]
    pub(crate) velocity: Vec<[R; 3]>,
}

/// The same, a particle after the other.
#[derive(Debug, Deserialize)]
struct Rows<R> {
    time: f64,
    particles: Vec<Row<R>>,
}

#[derive(Debug, Deserialize)]
struct Row<R> {
    id: u64,
    position: [R; 3],
    velocity: Option<[R; 3]>,
}

impl<R: Number> Scene<R> {
    pub(crate) fn new(count: usize, integrator: Integrator) -> Self {
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        // 53 bits from -100 to 100 (xorshift64).
        let mut number = move || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            R::of(((state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * 200.0)
        };
        let mut vectors = || (0..count).map(|_| [number(), number(), number()]).collect();
        Self { integrator, position: vectors(), velocity: vectors(), damping: Vec::new() }
    }

    pub(crate) fn with_own_damping(mut self) -> Self {
        let count = self.count();
        self.damping = (0..count).map(|i| R::of(0.5 + 0.5 * i as f64 / count as f64)).collect();
        self
    }

    pub(crate) fn count(&self) -> usize {
        self.position.len()
    }

    /// Here.
    pub(crate) fn world(&self) -> World<R> {
        let gravity = [0.0, -10.0, 0.0].map(R::of).into();
        let settings = Settings { integrator: self.integrator, gravity, ..Settings::default() };
        let mut world = World::new(settings).expect("valid settings");
        let vectors = |vectors: &[[R; 3]]| Column::PerParticle(vectors.iter().map(|vector| (*vector).into()).collect());
        let damping = match &self.damping[..] {
            [] => Column::Uniform(R::of(DAMPING)),
            own => Column::PerParticle(own.to_vec()),
        };
        let (position, velocity) = (vectors(&self.position), vectors(&self.velocity));
        let particles = NewParticles { count: self.count(), position, velocity, damping, ..NewParticles::default() };
        world.apply(&Command::Create(particles)).expect("valid particles");
        world
    }

    /// The request that creates the world in the service, without particles.
    pub(crate) fn put(&self, name: &str) -> Vec<u8> {
        let (precision, integrator) = (R::PRECISION.name(), self.integrator.name());
        let settings = format!(r#"{{"precision":"{precision}","integrator":"{integrator}","gravity":[0,-10,0]}}"#);
        request("PUT", &format!("/v1/worlds/{name}"), &settings)
    }

    /// In the service and here, advanced.
    pub(crate) fn advanced(&self, client: &mut Client, name: &str, by: Advance) -> World<R> {
        self.create(client, name);
        client.expect(&advance(name, by), 200);
        let mut world = self.world();
        world.advance(by).expect("the service accepted it");
        world
    }

    /// In the service.
    pub(crate) fn create(&self, client: &mut Client, name: &str) {
        client.expect(&self.put(name), 201);
        let particles = format!("/v1/worlds/{name}/particles");
        client.expect(&request_with("POST", &particles, &CBOR, &self.typed()), 201);
    }

    /// The particles as columns in CBOR, each a typed array.
    pub(crate) fn typed(&self) -> Vec<u8> {
        self.columns_in_cbor(cbor::vectors)
    }

    /// The same without typed arrays.
    pub(crate) fn plain(&self) -> Vec<u8> {
        let number = |number: &R| cbor::float((*number).into());
        let vector = |vector: &[R; 3]| cbor::list(&vector.each_ref().map(number));
        self.columns_in_cbor(|vectors| cbor::list(&vectors.iter().map(vector).collect::<Vec<_>>()))
    }

    fn columns_in_cbor(&self, vectors: impl Fn(&[[R; 3]]) -> Vec<u8>) -> Vec<u8> {
        let damping = if self.damping.is_empty() { cbor::float(DAMPING) } else { cbor::numbers(&self.damping) };
        cbor::map([
            ("count", cbor::whole(self.count() as u64)),
            ("position", vectors(&self.position)),
            ("velocity", vectors(&self.velocity)),
            ("damping", damping),
        ])
    }

    /// In JSON, all with the same damping.
    pub(crate) fn rows(&self) -> String {
        let row = |(position, velocity): (&[R; 3], &[R; 3])| {
            let (position, velocity) = (json(position), json(velocity));
            format!(r#"{{"position":{position},"velocity":{velocity},"damping":{DAMPING}}}"#)
        };
        format!("[{}]", self.position.iter().zip(&self.velocity).map(row).collect::<Vec<_>>().join(","))
    }

    /// The same.
    pub(crate) fn columns(&self) -> String {
        let column = |vectors: &[[R; 3]]| vectors.iter().map(json).collect::<Vec<_>>().join(",");
        let (count, position, velocity) = (self.count(), column(&self.position), column(&self.velocity));
        format!(r#"{{"count":{count},"position":[{position}],"velocity":[{velocity}],"damping":{DAMPING}}}"#)
    }
}

/// With as many digits as it takes.
pub(crate) fn json<R: Debug>([x, y, z]: &[R; 3]) -> String {
    format!("[{x:?},{y:?},{z:?}]")
}

pub(crate) fn advance(name: &str, advance: Advance) -> Vec<u8> {
    let steps = advance.steps.map_or_else(String::new, |steps| format!(r#","steps":{steps}"#));
    let body = format!(r#"{{"duration":{}{steps}}}"#, advance.duration);
    request("POST", &format!("/v1/worlds/{name}/advance"), &body)
}

/// Whether a world of the service has the future of one here.
pub(crate) fn has_future_of<R: Number>(client: &mut Client, name: &str, world: &World<R>) -> bool {
    let told = client.expect(&request("GET", &format!("/v1/worlds/{name}/digest"), ""), 200).json();
    told["digest"] == world.digest().to_string()
}

impl<R: Number> Columns<R> {
    pub(crate) fn of(world: &World<R>) -> Self {
        let mut states = States::default();
        world.read(ParticleId(0), usize::MAX, &mut states);
        let States { id, position, velocity } = states;
        Self { time: world.time(), id: id.into_iter().map(|id| id.0).collect(), position, velocity }
    }

    pub(crate) fn from_json(text: &[u8]) -> Option<Self> {
        serde_json::from_slice(text).ok()
    }

    pub(crate) fn from_rows(text: &[u8]) -> Option<Self> {
        let Rows { time, particles } = serde_json::from_slice::<Rows<R>>(text).ok()?;
        let (id, position) = particles.iter().map(|row| (row.id, row.position)).unzip();
        Some(Self { time, id, position, velocity: particles.iter().filter_map(|row| row.velocity).collect() })
    }

    pub(crate) fn from_cbor(bytes: &[u8]) -> Option<Self> {
        Self::from_value(&Value::of(bytes)?)
    }

    pub(crate) fn from_value(value: &Value<'_>) -> Option<Self> {
        let id = value.member("id")?.ids()?;
        let velocity = value.member("velocity").map_or(Some(Vec::new()), Value::vectors)?;
        let columns =
            Self { time: value.member("time")?.float()?, position: value.member("position")?.vectors()?, id, velocity };
        (value.member("count")?.whole()? == columns.id.len() as u64).then_some(columns)
    }

    /// To the bit.
    pub(crate) fn bits(&self) -> Vec<u8> {
        let mut bits = [&self.time.to_le_bytes()[..], &cbor::ids(&self.id)].concat();
        bits.append(&mut cbor::vectors(&self.position));
        bits.append(&mut cbor::vectors(&self.velocity));
        bits
    }
}
