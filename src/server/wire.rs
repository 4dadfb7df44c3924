//! The shapes that routes share, in JSON and in CBOR.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserializer, IgnoredAny, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ArrayBuilder, Schema};

use crate::column::Column;
use crate::command::{Command, Mass, NewParticles, Particle, Properties, Selection};
use crate::forces::Drag;
use crate::ids::ParticleId;
use crate::integrator::{DampingLaw, Integrator};
use crate::real::Precision;
use crate::server::body::Raw;
use crate::server::json::{Choice, DragPair, Element, Named, Object, Vector, WireReal, choices, column, present};
use crate::server::problem::{Code, Problem};
use crate::server::settings::{ForcesBody, ToleranceBody};
use crate::world::{ParticleState, World};

impl Choice for Precision {
    const ALL: &'static [Self] = &Self::ALL;
    fn name(self) -> &'static str {
        self.name()
    }
}

impl Choice for Integrator {
    const ALL: &'static [Self] = &Self::ALL;
    fn name(self) -> &'static str {
        self.name()
    }
}

impl Choice for DampingLaw {
    const ALL: &'static [Self] = &Self::ALL;
    fn name(self) -> &'static str {
        self.name()
    }
}

/// A vector: its components x, y and z.
#[derive(ToSchema)]
#[schema(as = Vector, value_type = [f64; 3], min_items = 3, max_items = 3, example = json!([0.0, 9.5, 0.0]))]
#[expect(dead_code, reason = "stands for Vector in the description")]
pub(crate) struct VectorSchema([f64; 3]);

/// The coefficients k1 (kg/s) and k2 (kg/m) of drag, both at least 0.
#[derive(ToSchema)]
#[schema(as = DragPair, value_type = [f64; 2], min_items = 2, max_items = 2, example = json!([0.1, 0.02]))]
#[expect(dead_code, reason = "stands for DragPair in the description")]
pub(crate) struct DragPairSchema([f64; 2]);

/// One vector for all particles, or a list with one for each.
#[derive(ToSchema)]
#[schema(as = VectorColumn)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for a column in the description")]
pub(crate) enum VectorColumn {
    One(VectorSchema),
    Each(Vec<VectorSchema>),
}

/// One acceleration for all particles, or a list with one for each; null follows the gravity of the world.
#[derive(ToSchema)]
#[schema(as = AccelerationColumn)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for a column in the description")]
pub(crate) enum AccelerationColumn {
    One(Option<VectorSchema>),
    Each(Vec<Option<VectorSchema>>),
}

/// One drag for all particles, or a list with one for each; null follows the drag of the world.
#[derive(ToSchema)]
#[schema(as = DragColumn)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for a column in the description")]
pub(crate) enum DragColumn {
    One(Option<DragPairSchema>),
    Each(Vec<Option<DragPairSchema>>),
}

/// One number or null for all particles, or a list with one for each.
#[derive(ToSchema)]
#[schema(as = OptionalNumberColumn)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for a column in the description")]
pub(crate) enum OptionalNumberColumn {
    One(Option<f64>),
    Each(Vec<Option<f64>>),
}

/// One number for all particles, or a list with one for each.
#[derive(ToSchema)]
#[schema(as = NumberColumn)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for a column in the description")]
pub(crate) enum NumberColumn {
    One(f64),
    Each(Vec<f64>),
}

/// A world and its settings.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = World, bound = "", example = json!({
    "world": "demo", "precision": "double", "integrator": "exact", "gravity": [0.0, -9.80665, 0.0],
    "damping_law": "per_second", "max_step": null, "time": 0.5, "step_count": 1, "particle_count": 2, "revision": 5
}))]
pub(crate) struct Description<R: WireReal> {
    world: String,
    /// `double` or `single`, fixed at creation.
    #[schema(schema_with = choices::<Precision>)]
    precision: Named<Precision>,
    /// How particles are moved.
    #[schema(schema_with = choices::<Integrator>)]
    integrator: Named<Integrator>,
    /// In m/s².
    #[schema(value_type = VectorSchema)]
    gravity: [R; 3],
    /// `per_second` or `per_step`.
    #[schema(schema_with = choices::<DampingLaw>)]
    damping_law: Named<DampingLaw>,
    /// The longest step, in seconds, of an advance that names no steps.
    #[schema(required)]
    max_step: Option<f64>,
    /// Absent where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<ForcesBody<f64>>, nullable = false)]
    forces: Option<ForcesBody<R>>,
    /// Absent where it is the default.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    tolerance: Option<ToleranceBody>,
    /// true where steps keep what rounding takes from position and velocity, otherwise absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    compensated: Option<bool>,
    /// The clock in seconds.
    time: f64,
    /// Steps of all advances so far.
    step_count: u64,
    particle_count: usize,
    /// Grows by one with every accepted change; also the `ETag`.
    revision: u64,
}

impl<R: WireReal> Description<R> {
    pub(crate) fn new(name: &str, world: &World<R>) -> Self {
        let settings = world.settings();
        Self {
            world: name.to_owned(),
            precision: Named(R::PRECISION),
            integrator: Named(settings.integrator),
            gravity: settings.gravity.into(),
            damping_law: Named(settings.damping_law),
            max_step: settings.max_step,
            forces: ForcesBody::of(&settings.forces),
            tolerance: ToleranceBody::of(settings.tolerance),
            compensated: settings.compensated.then_some(true),
            time: world.time(),
            step_count: world.step_count(),
            particle_count: world.particle_count(),
            revision: world.revision(),
        }
    }

    pub(crate) fn particle_count(&self) -> usize {
        self.particle_count
    }

    /// The same world, later.
    pub(crate) fn update(&mut self, world: &World<R>) {
        let name = std::mem::take(&mut self.world);
        *self = Self { world: name, ..Self::new("", world) };
    }
}

/// A property of a particle that can be asked for, in the order in which answers have them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Property {
    Position,
    Velocity,
    Acceleration,
    OwnAcceleration,
    Damping,
    Mass,
    InverseMass,
    Force,
    Drag,
    GravitationalMass,
}

impl Choice for Property {
    const ALL: &'static [Self] = &[
        Self::Position,
        Self::Velocity,
        Self::Acceleration,
        Self::OwnAcceleration,
        Self::Damping,
        Self::Mass,
        Self::InverseMass,
        Self::Force,
        Self::Drag,
        Self::GravitationalMass,
    ];
    fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::OwnAcceleration => "own_acceleration",
            Self::Damping => "damping",
            Self::Mass => "mass",
            Self::InverseMass => "inverse_mass",
            Self::Force => "force",
            Self::Drag => "drag",
            Self::GravitationalMass => "gravitational_mass",
        }
    }
}

/// A list of properties, for the description of the service.
pub(crate) fn properties_schema() -> Schema {
    ArrayBuilder::new().items(RefOr::T(choices::<Property>())).build().into()
}

/// What a list of names says.
pub(crate) fn named<T>(names: Vec<Named<T>>) -> Vec<T> {
    names.into_iter().map(|Named(choice)| choice).collect()
}

/// Reads `fields=position,velocity`.
pub(crate) fn properties(fields: &str) -> Result<Vec<Property>, Problem> {
    fields
        .split(',')
        .map(|name| {
            Property::ALL.iter().copied().find(|property| property.name() == name).ok_or_else(|| {
                let names: Vec<&str> = Property::ALL.iter().map(|property| property.name()).collect();
                let detail = format!("fields has {name:?}; it takes {}, separated by commas", names.join(", "));
                Problem::new(Code::InvalidParameter, detail)
            })
        })
        .collect()
}

/// A particle to create; every field is optional.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = NewParticle, bound = "", example = json!({
    "position": [0.0, 10.0, 0.0], "velocity": [3.0, 0.0, 0.0], "acceleration": null, "damping": 0.99, "mass": 2.0
}))]
pub(crate) struct ParticleBody<R: WireReal> {
    /// In metres; default 0.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorSchema>, nullable = false)]
    position: Option<Vector<R>>,
    /// In m/s; default 0.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorSchema>, nullable = false)]
    velocity: Option<Vector<R>>,
    /// Own acceleration in m/s²; default null: the gravity of the world.
    #[serde(default)]
    #[schema(value_type = Option<VectorSchema>)]
    acceleration: Option<Vector<R>>,
    /// The share of the velocity kept each second, 0 to 1; default 1.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0, maximum = 1)]
    damping: Option<R>,
    /// In kg, above 0; default 1. Not together with `inverse_mass`.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, exclusive_minimum = 0)]
    mass: Option<R>,
    /// In 1/kg, at least 0; 0 is an immovable particle.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0)]
    inverse_mass: Option<R>,
    /// Its own drag, where the world has drag; default null: that of the world.
    #[serde(default)]
    #[schema(value_type = Option<DragPairSchema>)]
    drag: Option<DragPair<R>>,
    /// The mass in kg, at least 0, with which it attracts others; default null: its mass, and 0 when it is immovable.
    #[serde(default)]
    #[schema(value_type = Option<f64>, minimum = 0)]
    gravitational_mass: Option<R>,
}

impl<R: WireReal> ParticleBody<R> {
    fn particle(self) -> Result<Particle<R>, Problem> {
        let default = Particle::<R>::default();
        let vector = |given: Option<Vector<R>>, default| given.map_or(default, Element::value);
        Ok(Particle {
            position: vector(self.position, default.position),
            velocity: vector(self.velocity, default.velocity),
            acceleration: self.acceleration.value(),
            damping: self.damping.unwrap_or(default.damping),
            mass: mass(self.mass, self.inverse_mass)?.unwrap_or(default.mass),
            drag: self.drag.value(),
            gravitational_mass: self.gravitational_mass,
        })
    }

    pub(crate) fn one(self) -> Result<NewParticles<R>, Problem> {
        Ok(self.particle()?.into())
    }
}

/// A list of particles to create, each read straight into the columns.
pub(crate) struct Rows<R: WireReal> {
    particles: NewParticles<R>,
    /// What is wrong with the first one that is well-shaped and cannot be: what follows may be worse.
    refused: Option<Problem>,
}

impl<R: WireReal> Rows<R> {
    pub(crate) fn particles(self) -> Result<NewParticles<R>, Problem> {
        self.refused.map_or(Ok(self.particles), Err)
    }
}

impl<'de, R: WireReal> Deserialize<'de> for Rows<R> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List<R>(PhantomData<R>);
        impl<'de, R: WireReal> Visitor<'de> for List<R> {
            type Value = Rows<R>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of particles")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Rows<R>, A::Error> {
                let mut rows = Rows { particles: NewParticles::default(), refused: None };
                while let Some(Object(body)) = list.next_element::<Object<ParticleBody<R>>>()? {
                    match body.particle() {
                        Ok(particle) => rows.particles.push(particle),
                        Err(problem) => {
                            let place = rows.particles.count;
                            rows.refused.get_or_insert_with(|| problem.under(&format!("/{place}")));
                        }
                    }
                }
                Ok(rows)
            }
        }
        deserializer.deserialize_seq(List(PhantomData))
    }
}

/// A mass said in one of two ways.
pub(crate) fn mass<R: WireReal>(mass: Option<R>, inverse_mass: Option<R>) -> Result<Option<Mass<R>>, Problem> {
    match (mass, inverse_mass) {
        (None, None) => Ok(None),
        (Some(mass), None) => Ok(Some(Mass::Mass(mass))),
        (None, Some(inverse)) => Ok(Some(Mass::Inverse(inverse))),
        (Some(_), Some(_)) => Err(both_masses()),
    }
}

fn both_masses() -> Problem {
    let detail = "mass and inverse_mass say the same thing; give one of them";
    Problem::at(Code::MassAndInverseMass, "/inverse_mass", detail)
}

/// Particles to create, as columns.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewParticleColumns, example = json!({
    "count": 3, "position": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], "velocity": [0.0, 5.0, 0.0],
    "damping": 0.99, "mass": [1.0, 2.0, 3.0]
}))]
pub(crate) struct ColumnsBody<'a> {
    /// How many particles.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = usize, required)]
    pub(crate) count: Option<usize>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorColumn>, nullable = false)]
    position: Option<Raw<'a>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorColumn>, nullable = false)]
    velocity: Option<Raw<'a>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<AccelerationColumn>, nullable = false)]
    acceleration: Option<Raw<'a>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<NumberColumn>, nullable = false)]
    damping: Option<Raw<'a>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<NumberColumn>, nullable = false)]
    mass: Option<Raw<'a>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<NumberColumn>, nullable = false)]
    inverse_mass: Option<Raw<'a>>,
    /// Own drag; null: that of the world.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<DragColumn>, nullable = false)]
    drag: Option<Raw<'a>>,
    /// In kg; null: its mass, and 0 when it is immovable.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<OptionalNumberColumn>, nullable = false)]
    gravitational_mass: Option<Raw<'a>>,
}

impl ColumnsBody<'_> {
    pub(crate) fn particles<R: WireReal>(&self, count: usize) -> Result<NewParticles<R>, Problem> {
        let default = NewParticles::<R>::default();
        Ok(NewParticles {
            count,
            position: optional_column::<Vector<R>>(self.position, "position")?.unwrap_or(default.position),
            velocity: optional_column::<Vector<R>>(self.velocity, "velocity")?.unwrap_or(default.velocity),
            acceleration: optional_column::<Option<Vector<R>>>(self.acceleration, "acceleration")?
                .unwrap_or(default.acceleration),
            damping: optional_column::<R>(self.damping, "damping")?.unwrap_or(default.damping),
            mass: mass_column(self.mass, self.inverse_mass)?.unwrap_or(default.mass),
            drag: optional_column::<Option<DragPair<R>>>(self.drag, "drag")?.unwrap_or(default.drag),
            gravitational_mass: optional_column::<Option<R>>(self.gravitational_mass, "gravitational_mass")?
                .unwrap_or(default.gravitational_mass),
        })
    }
}

/// New properties for many particles.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = SetParticles, example = json!({"ids": [0], "damping": 0.9, "mass": [1.5]}))]
pub(crate) struct SetManyBody<'a> {
    /// Which particles, in the order of the lists; absent: all, in ascending order of id.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false)]
    ids: Option<Vec<u64>>,
    /// In m/s²; null: follow the gravity of the world again.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<AccelerationColumn>, nullable = false)]
    acceleration: Option<Raw<'a>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<NumberColumn>, nullable = false)]
    damping: Option<Raw<'a>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<NumberColumn>, nullable = false)]
    mass: Option<Raw<'a>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<NumberColumn>, nullable = false)]
    inverse_mass: Option<Raw<'a>>,
    /// Own drag; null: that of the world.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<DragColumn>, nullable = false)]
    drag: Option<Raw<'a>>,
    /// In kg; null: its mass, and 0 when it is immovable.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<OptionalNumberColumn>, nullable = false)]
    gravitational_mass: Option<Raw<'a>>,
    #[serde(default, deserialize_with = "present")]
    #[schema(ignore)]
    position: Option<IgnoredAny>,
    #[serde(default, deserialize_with = "present")]
    #[schema(ignore)]
    velocity: Option<IgnoredAny>,
}

impl SetManyBody<'_> {
    pub(crate) fn command<R: WireReal>(self) -> Result<Command<R>, Problem> {
        refuse_state(self.position.is_some(), self.velocity.is_some())?;
        let properties = Properties {
            acceleration: optional_column::<Option<Vector<R>>>(self.acceleration, "acceleration")?,
            damping: optional_column::<R>(self.damping, "damping")?,
            mass: mass_column(self.mass, self.inverse_mass)?,
            drag: optional_column::<Option<DragPair<R>>>(self.drag, "drag")?,
            gravitational_mass: optional_column::<Option<R>>(self.gravitational_mass, "gravitational_mass")?,
        };
        Ok(Command::Set { ids: selection(self.ids), properties })
    }
}

/// New properties for one particle.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = SetParticle, bound = "", example = json!({"damping": 0.9, "acceleration": null}))]
pub(crate) struct SetOneBody<R: WireReal> {
    /// In m/s²; null: follow the gravity of the world again.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorSchema>)]
    #[expect(clippy::option_option, reason = "absent, null and a vector are three things")]
    acceleration: Option<Option<Vector<R>>>,
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0, maximum = 1)]
    damping: Option<R>,
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, exclusive_minimum = 0)]
    mass: Option<R>,
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0)]
    inverse_mass: Option<R>,
    /// null: the drag of the world again.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<DragPairSchema>)]
    #[expect(clippy::option_option, reason = "absent, null and a pair are three things")]
    drag: Option<Option<DragPair<R>>>,
    /// In kg; null: its mass again, and 0 when it is immovable.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, minimum = 0)]
    #[expect(clippy::option_option, reason = "absent, null and a number are three things")]
    gravitational_mass: Option<Option<R>>,
    #[serde(default, deserialize_with = "present")]
    #[schema(ignore)]
    position: Option<IgnoredAny>,
    #[serde(default, deserialize_with = "present")]
    #[schema(ignore)]
    velocity: Option<IgnoredAny>,
}

impl<R: WireReal> SetOneBody<R> {
    pub(crate) fn command(self, id: ParticleId) -> Result<Command<R>, Problem> {
        refuse_state(self.position.is_some(), self.velocity.is_some())?;
        let properties = Properties {
            acceleration: self.acceleration.map(|own| Column::Uniform(own.value())),
            damping: self.damping.map(Column::Uniform),
            mass: mass(self.mass, self.inverse_mass)?.map(Column::Uniform),
            drag: self.drag.map(|own| Column::Uniform(own.value())),
            gravitational_mass: self.gravitational_mass.map(Column::Uniform),
        };
        Ok(Command::Set { ids: id.into(), properties })
    }
}

/// Position and velocity belong to the integrator.
fn refuse_state(position: bool, velocity: bool) -> Result<(), Problem> {
    for (given, field) in [(position, "position"), (velocity, "velocity")] {
        if given {
            let detail = format!(
                "the integrator owns {field}: change the velocity with POST …/impulse, or teleport with POST …/place"
            );
            return Err(Problem::at(Code::IntegratorOwnsField, format!("/{field}"), detail));
        }
    }
    Ok(())
}

/// The particles with these ids; absent: all.
pub(crate) fn selection(ids: Option<Vec<u64>>) -> Selection {
    ids.map_or(Selection::All, |ids| Selection::Ids(ids.into_iter().map(ParticleId).collect()))
}

pub(crate) fn optional_column<E: Element>(
    raw: Option<Raw<'_>>,
    field: &str,
) -> Result<Option<Column<E::Value>>, Problem> {
    raw.map(|raw| column::<E>(raw, field)).transpose()
}

/// A mass in a column of masses.
#[derive(Deserialize)]
#[serde(transparent, bound = "")]
struct DirectMass<R: WireReal>(R);

/// A mass in a column of inverse masses.
#[derive(Deserialize)]
#[serde(transparent, bound = "")]
struct InverseMass<R: WireReal>(R);

impl<R: WireReal> Element for DirectMass<R> {
    type Value = Mass<R>;
    type Number = R;
    const NUMBERS: usize = 1;
    fn value(self) -> Mass<R> {
        Mass::Mass(self.0)
    }
    fn of(number: impl Fn(usize) -> R) -> Mass<R> {
        Mass::Mass(number(0))
    }
}

impl<R: WireReal> Element for InverseMass<R> {
    type Value = Mass<R>;
    type Number = R;
    const NUMBERS: usize = 1;
    fn value(self) -> Mass<R> {
        Mass::Inverse(self.0)
    }
    fn of(number: impl Fn(usize) -> R) -> Mass<R> {
        Mass::Inverse(number(0))
    }
}

fn mass_column<R: WireReal>(
    mass: Option<Raw<'_>>,
    inverse_mass: Option<Raw<'_>>,
) -> Result<Option<Column<Mass<R>>>, Problem> {
    if mass.is_some() && inverse_mass.is_some() {
        return Err(both_masses());
    }
    let mass = optional_column::<DirectMass<R>>(mass, "mass")?;
    Ok(mass.or(optional_column::<InverseMass<R>>(inverse_mass, "inverse_mass")?))
}

/// A particle at the clock of its world.
#[derive(Debug, Serialize, ToSchema)]
#[serde(bound = "")]
#[schema(as = Particle, bound = "", example = json!({
    "id": 0, "position": [0.0, 10.0, 0.0], "velocity": [3.0, 0.0, 0.0], "acceleration": [0.0, -9.80665, 0.0],
    "own_acceleration": null, "damping": 0.99, "mass": 2.0, "inverse_mass": 0.5, "force": [0.0, 0.0, 0.0]
}))]
pub(crate) struct ParticleView<R: WireReal> {
    id: u64,
    /// In metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = VectorSchema)]
    position: Option<[R; 3]>,
    /// In m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = VectorSchema)]
    velocity: Option<[R; 3]>,
    /// The effective acceleration in m/s², without the share of the force.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = VectorSchema)]
    acceleration: Option<[R; 3]>,
    /// Its own acceleration in m/s²; null when it follows the gravity of the world.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<VectorSchema>)]
    #[expect(clippy::option_option, reason = "not asked for, null and a vector are three things")]
    own_acceleration: Option<Option<[R; 3]>>,
    /// The share of the velocity kept each second.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = f64)]
    damping: Option<R>,
    /// In kg: `1/inverse_mass`; null when immovable.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<f64>)]
    #[expect(clippy::option_option, reason = "not asked for, null and a number are three things")]
    mass: Option<Option<R>>,
    /// In 1/kg.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = f64)]
    inverse_mass: Option<R>,
    /// The force accumulator in newtons: what was added since the last advance.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = VectorSchema)]
    force: Option<[R; 3]>,
    /// Its own drag, where it has one; null only when asked for in `fields`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<DragPairSchema>)]
    #[expect(clippy::option_option, reason = "not asked for, null and a pair are three things")]
    drag: Option<Option<[R; 2]>>,
    /// In kg, where it has one of its own; null only when asked for in `fields`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<f64>)]
    #[expect(clippy::option_option, reason = "not asked for, null and a number are three things")]
    gravitational_mass: Option<Option<R>>,
}

impl<R: WireReal> ParticleView<R> {
    pub(crate) fn new(state: &ParticleState<R>, properties: &[Property]) -> Self {
        let wants = |property| properties.contains(&property);
        Self {
            id: state.id.0,
            position: wants(Property::Position).then(|| state.position.into()),
            velocity: wants(Property::Velocity).then(|| state.velocity.into()),
            acceleration: wants(Property::Acceleration).then(|| state.acceleration.into()),
            own_acceleration: wants(Property::OwnAcceleration).then(|| state.own_acceleration.map(Into::into)),
            damping: wants(Property::Damping).then_some(state.damping),
            mass: wants(Property::Mass).then(|| state.mass()),
            inverse_mass: wants(Property::InverseMass).then_some(state.inverse_mass),
            force: wants(Property::Force).then(|| state.force.into()),
            drag: wants(Property::Drag).then(|| state.drag.map(pair)),
            gravitational_mass: wants(Property::GravitationalMass).then_some(state.gravitational_mass),
        }
    }

    /// Everything; without drag and gravitational mass where it has none.
    pub(crate) fn whole(state: &ParticleState<R>) -> Self {
        let every = Self::new(state, Property::ALL);
        Self {
            drag: every.drag.filter(Option::is_some),
            gravitational_mass: every.gravitational_mass.filter(Option::is_some),
            ..every
        }
    }
}

pub(crate) fn pair<R: WireReal>(Drag { k1, k2 }: Drag<R>) -> [R; 2] {
    [k1, k2]
}

/// Columns, only those that were asked for; in CBOR each is a typed array (RFC 8746, little-endian, of the precision of the
/// world; three numbers of a vector after each other), but for those that can have null.
#[derive(ToSchema)]
#[schema(as = State, example = json!({
    "time": 0.5, "count": 2, "id": [0, 1], "position": [[0.0, 1.5, 0.0], [2.0, 0.0, 0.0]]
}))]
#[expect(dead_code, reason = "stands for columns in the description")]
pub(crate) struct State {
    /// The clock in seconds.
    time: f64,
    /// With `changed_since`, and in a stream: what to ask from the next time.
    #[schema(nullable = false)]
    revision: Option<u64>,
    /// Whether everything is here, since what changed is not known; otherwise absent.
    #[schema(nullable = false)]
    full: Option<bool>,
    /// Ids that were removed, in ascending order.
    #[schema(nullable = false)]
    removed: Option<Vec<u64>>,
    count: usize,
    id: Vec<u64>,
    #[schema(nullable = false)]
    position: Option<Vec<VectorSchema>>,
    #[schema(nullable = false)]
    velocity: Option<Vec<VectorSchema>>,
    #[schema(nullable = false)]
    acceleration: Option<Vec<VectorSchema>>,
    #[schema(nullable = false)]
    own_acceleration: Option<Vec<Option<VectorSchema>>>,
    #[schema(nullable = false)]
    damping: Option<Vec<f64>>,
    #[schema(nullable = false)]
    mass: Option<Vec<Option<f64>>>,
    #[schema(nullable = false)]
    inverse_mass: Option<Vec<f64>>,
    #[schema(nullable = false)]
    force: Option<Vec<VectorSchema>>,
    #[schema(nullable = false)]
    drag: Option<Vec<Option<DragPairSchema>>>,
    #[schema(nullable = false)]
    gravitational_mass: Option<Vec<Option<f64>>>,
}

/// What was created.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"first_id": 0, "count": 3}))]
pub(crate) struct Created {
    /// The ids count up from here.
    pub(crate) first_id: u64,
    pub(crate) count: usize,
}

/// What was changed.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"count": 3, "revision": 8}))]
pub(crate) struct Changed {
    /// How many particles the request spoke of.
    pub(crate) count: usize,
    /// The revision of the world afterwards.
    pub(crate) revision: u64,
}
