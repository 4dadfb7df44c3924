//! Bytes to commands, and commands to two worlds: one is compared with a model after each of them, by all its reads; the
//! other is never read until the end, when both have one digest.

#![no_main]

#[path = "../../tests/it/formulas.rs"]
mod formulas;
mod model;

use arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use model::Model;
use pointmass::{
    Advance, Column, Command, Configure, DampingLaw, Drag, Gravitation, Integrator, Limits, Mass, NewParticles,
    ParticleId, Plane, Precision, Properties, Real, Selection, Settings, States, Tolerance, Until, World,
};

/// Few enough that each is reached, and that nothing takes long.
pub(crate) const LIMITS: Limits =
    Limits { particles: 40, steps: STEPS_MAX as u64, particle_steps: 4000, interactions: 20_000 };
pub(crate) const STEPS_MAX: u32 = 300;

/// Commands out of bytes. Most of them are such as a world accepts: after one that it refuses there is nothing new to see.
struct Source<'a> {
    bytes: Unstructured<'a>,
    /// The particles there are.
    ids: Vec<ParticleId>,
    next_id: u64,
}

impl Source<'_> {
    fn choose<T: Copy>(&mut self, choices: &[T]) -> Result<T> {
        self.bytes.choose(choices).copied()
    }

    fn rarely(&mut self) -> Result<bool> {
        self.bytes.ratio(1, 16)
    }

    fn maybe<T>(&mut self, some: impl FnOnce(&mut Self) -> Result<T>) -> Result<Option<T>> {
        if self.bytes.arbitrary()? { some(self).map(Some) } else { Ok(None) }
    }

    /// Mostly a number such as scenes have, sometimes an extreme one, sometimes any bits.
    fn number<R: Real>(&mut self) -> Result<R> {
        let largest = R::LARGEST;
        Ok(match self.bytes.int_in_range(0..=19)? {
            0 => R::nearest(self.choose(&[0.0, -0.0, f64::INFINITY, f64::NAN, largest, -largest, 1e-30, 1e30])?),
            1 => match R::PRECISION {
                Precision::Single => R::nearest(f32::from_bits(self.bytes.arbitrary()?).into()),
                Precision::Double => R::nearest(f64::from_bits(self.bytes.arbitrary()?)),
            },
            _ => R::nearest(f64::from(self.bytes.arbitrary::<i16>()?) / 64.0),
        })
    }

    /// Mostly not below 0.
    fn amount<R: Real>(&mut self) -> Result<R> {
        let number = self.number::<R>()?;
        Ok(if self.rarely()? { number } else { R::abs(number) })
    }

    fn vector<R: Real>(&mut self) -> Result<R::Vec3> {
        if self.bytes.ratio(1, 4)? {
            return Ok(R::Vec3::default());
        }
        Ok([self.number::<R>()?, self.number()?, self.number()?].into())
    }

    fn damping<R: Real>(&mut self) -> Result<R> {
        Ok(match self.bytes.int_in_range(0..=15)? {
            0 => R::nearest(self.choose(&[-0.5, 1.5, f64::NAN])?),
            1..4 => R::nearest(self.choose(&[0.0, -0.0, 1e-30, 0.5, 0.999])?),
            4..8 => R::nearest(f64::from(self.bytes.arbitrary::<u16>()?) / 65536.0),
            _ => R::ONE,
        })
    }

    fn mass<R: Real>(&mut self) -> Result<Mass<R>> {
        Ok(match self.bytes.int_in_range(0..=2)? {
            0 => Mass::IMMOVABLE,
            1 => Mass::Inverse(self.amount()?),
            _ => Mass::Mass(self.amount()?),
        })
    }

    fn drag<R: Real>(&mut self) -> Result<Drag<R>> {
        Ok(Drag { k1: self.amount()?, k2: self.amount()? })
    }

    /// One value for all, or one for each of them, sometimes one too many.
    fn column<T>(&mut self, count: usize, mut value: impl FnMut(&mut Self) -> Result<T>) -> Result<Column<T>> {
        Ok(match self.bytes.int_in_range(0..=63)? {
            0 => Column::PerParticle((0..=count).map(|_| value(self)).collect::<Result<_>>()?),
            1..16 => Column::PerParticle((0..count).map(|_| value(self)).collect::<Result<_>>()?),
            _ => Column::Uniform(value(self)?),
        })
    }

    fn id(&mut self) -> Result<ParticleId> {
        if self.ids.is_empty() || self.rarely()? {
            return self.bytes.int_in_range(0..=self.next_id).map(ParticleId);
        }
        self.bytes.choose(&self.ids).copied()
    }

    /// Some particles, and how many they are.
    fn selection(&mut self) -> Result<(Selection, usize)> {
        if self.bytes.ratio(1, 4)? {
            return Ok((Selection::All, self.ids.len()));
        }
        let count = self.bytes.int_in_range(0..=3)?;
        Ok((Selection::Ids((0..count).map(|_| self.id()).collect::<Result<_>>()?), count))
    }

    fn properties<R: Real>(&mut self, count: usize) -> Result<Properties<R>> {
        Ok(Properties {
            acceleration: self.maybe(|s| s.column(count, |s| s.maybe(Self::vector::<R>)))?,
            damping: self.maybe(|s| s.column(count, Self::damping))?,
            mass: self.maybe(|s| s.column(count, Self::mass))?,
            drag: self.maybe(|s| s.column(count, |s| s.maybe(Self::drag)))?,
            gravitational_mass: self.maybe(|s| s.column(count, |s| s.maybe(Self::amount)))?,
        })
    }

    fn new_particles<R: Real>(&mut self) -> Result<NewParticles<R>> {
        let count = self.bytes.int_in_range(0..=6)?;
        let Properties { acceleration, damping, mass, drag, gravitational_mass } = self.properties(count)?;
        let default = NewParticles::default();
        Ok(NewParticles {
            count,
            position: self.column(count, Self::vector::<R>)?,
            velocity: self.column(count, Self::vector::<R>)?,
            acceleration: acceleration.unwrap_or(default.acceleration),
            damping: damping.unwrap_or(default.damping),
            mass: mass.unwrap_or(default.mass),
            drag: drag.unwrap_or(default.drag),
            gravitational_mass: gravitational_mass.unwrap_or(default.gravitational_mass),
        })
    }

    /// Multiples of 2⁻¹⁰ s, so that a sum of them is exact, or what no duration can be.
    fn seconds(&mut self) -> Result<f64> {
        if self.rarely()? {
            return self.choose(&[0.0, -1.0, f64::INFINITY, f64::NAN, 1e300]);
        }
        Ok(f64::from(self.bytes.int_in_range(1..=8192)?) / 1024.0)
    }

    fn advance(&mut self) -> Result<Advance> {
        let steps = self.maybe(|s| s.bytes.int_in_range(0..=150))?;
        Ok(Advance {
            duration: self.seconds()?,
            steps,
            max_step: if steps.is_none() || self.rarely()? { self.maybe(Self::seconds)? } else { None },
            report_error: self.bytes.ratio(1, 4)?,
            until: if self.bytes.ratio(1, 8)? { Some(self.until()?) } else { None },
        })
    }

    fn until(&mut self) -> Result<Until> {
        let normal = [self.number::<f64>()?, self.number()?, self.number()?];
        Ok(Until { particle: self.id()?, plane: Plane { normal, offset: self.number()? } })
    }

    fn configure<R: Real>(&mut self) -> Result<Configure<R>> {
        Ok(Configure {
            integrator: self.maybe(|s| s.choose(&Integrator::ALL))?,
            gravity: self.maybe(Self::vector::<R>)?,
            damping_law: self.maybe(|s| s.choose(&DampingLaw::ALL))?,
            max_step: self.maybe(|s| s.maybe(Self::seconds))?,
            drag: self.maybe(|s| s.maybe(Self::drag))?,
            gravitation: self
                .maybe(|s| s.maybe(|s| Ok(Gravitation { constant: s.amount()?, softening: s.amount()? })))?,
            tolerance: self.maybe(|s| Ok(Tolerance { absolute: s.amount()?, relative: s.amount()? }))?,
            compensated: self.maybe(|s| s.bytes.arbitrary())?,
        })
    }

    fn settings<R: Real>(&mut self) -> Result<Settings<R>> {
        let gravity = [self.bytes.arbitrary::<i8>()?, self.bytes.arbitrary()?, self.bytes.arbitrary()?];
        let integrator = self.choose(&Integrator::ALL)?;
        let damping_law = self.choose(&DampingLaw::ALL)?;
        Ok(Settings {
            integrator,
            gravity: gravity.map(|g| R::nearest(f64::from(g))).into(),
            damping_law: if integrator.serves(damping_law) { damping_law } else { DampingLaw::default() },
            ..Settings::default()
        })
    }

    fn command<R: Real>(&mut self) -> Result<Command<R>> {
        Ok(match self.bytes.int_in_range(0..=11)? {
            0..2 => Command::Create(self.new_particles()?),
            2 => {
                let (ids, count) = self.selection()?;
                let position = self.maybe(|s| s.column(count, Self::vector::<R>))?;
                Command::Place { ids, position, velocity: self.maybe(|s| s.column(count, Self::vector::<R>))? }
            }
            3 => {
                let (ids, count) = self.selection()?;
                Command::Set { ids, properties: self.properties(count)? }
            }
            4..6 => {
                let (ids, count) = self.selection()?;
                Command::AddForce { ids, force: self.column(count, Self::vector::<R>)? }
            }
            6 => {
                let (ids, count) = self.selection()?;
                Command::Impulse { ids, impulse: self.column(count, Self::vector::<R>)? }
            }
            7 => Command::Remove { ids: if self.rarely()? { Selection::All } else { self.id()?.into() } },
            8 => Command::Configure(self.configure()?),
            _ => Command::Advance(self.advance()?),
        })
    }
}

/// Every way to read a world.
fn read<R: Real>(world: &World<R>) {
    let mut states = States::default();
    world.read(ParticleId(1), 3, &mut states);
    world.for_each_block(|_| {});
    if let Some(particle) = world.particles().last() {
        assert_eq!(world.particle(particle.id).expect("it is listed"), particle);
        let _may_diverge = world.trajectory(particle.id, 0.5, 3);
    }
}

fn run<R: Real>(bytes: Unstructured<'_>) -> Result<()> {
    let mut source = Source { bytes, ids: Vec::new(), next_id: 0 };
    let settings = source.settings::<R>()?;
    let mut model = Model::new(settings);
    let mut world = World::with_limits(settings, LIMITS).expect("valid settings");
    let mut unread = world.clone();
    let mut digest = world.digest();
    while !source.bytes.is_empty() {
        let command = source.command::<R>()?;
        let outcome = world.apply(&command);
        model.follow(&command, &outcome, &world);
        read(&world);
        let after = world.digest();
        assert!(outcome.is_ok() || after == digest, "{command:?} was refused and changed something: {outcome:?}");
        assert_eq!(unread.apply(&command), outcome, "{command:?} in a world that nobody reads");
        digest = after;
        source.ids = world.particles().map(|particle| particle.id).collect();
        source.next_id = model.next_id;
    }
    assert_eq!(unread.digest(), digest, "reads changed bits");
    Ok(())
}

fuzz_target!(|input: &[u8]| {
    let mut bytes = Unstructured::new(input);
    // An input that ends in the middle of a command ends before it.
    let _end = match bytes.arbitrary() {
        Ok(true) => run::<f32>(bytes),
        Ok(false) | Err(_) => run::<f64>(bytes),
    };
});
