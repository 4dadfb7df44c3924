//! A world: particles, settings and a clock; and the one place where commands change it.

mod advance;
mod batch;
mod bounds;
mod change;
#[cfg(feature = "server")]
mod columns;
mod compiled;
#[cfg(feature = "digest")]
mod digest;
mod drive;
mod history;
mod motion;
#[cfg(feature = "snapshot")]
mod restore;
#[cfg(feature = "snapshot")]
mod snapshot;
mod system;
mod trajectory;
mod until;
mod walk;

use std::sync::atomic::AtomicBool;

use fearless_simd::Level;

use crate::column::Column;
use crate::command::{Advance, Advanced, Command, Configure, Mass, Outcome, Particle, Properties, Settings};
use crate::double_double::DoubleDouble;
use crate::error::{Error, Limits};
use crate::forces::Drag;
use crate::ids::{Ids, ParticleId};
use crate::particles::Particles;
use crate::real::Real;
use crate::shared::Shared;
use crate::threads::Threads;
use bounds::Bounds;
use drive::Factors;
use history::History;
use motion::{Carrier, Rows, Span};

pub use advance::StepPlan;
#[cfg(feature = "server")]
pub(crate) use batch::{Keep, Part};
#[cfg(feature = "server")]
pub(crate) use columns::Block;
#[cfg(feature = "digest")]
pub use digest::Digest;
pub use history::Changes;
#[cfg(feature = "snapshot")]
pub use restore::Snapshot;
#[cfg(feature = "snapshot")]
pub use snapshot::SnapshotError;
pub use trajectory::Trajectory;

pub(crate) use compiled::Compiled;

/// Particles that move together, in one precision, under one clock.
///
/// ```
/// use pointmass::{DVec3, Particle, Settings, World};
/// let mut world = World::new(Settings { gravity: DVec3::new(0.0, -10.0, 0.0), ..Settings::default() })?;
/// let ball = world.create(Particle { velocity: DVec3::new(3.0, 20.0, 0.0), ..Particle::default() })?;
/// world.set_mass(ball, 2.0)?;
/// world.advance(1.5)?;
/// let state = world.particle(ball)?;
/// assert_eq!(state.position, DVec3::new(4.5, 18.75, 0.0));
/// assert_eq!(state.velocity, DVec3::new(3.0, 5.0, 0.0));
/// # Ok::<(), pointmass::Error>(())
/// ```
///
/// A clone takes no time and no memory until it, or the world, is written: then that one takes a copy of the particles.
#[derive(Debug, Clone)]
pub struct World<R: Real = f64> {
    settings: Settings<R>,
    limits: Limits,
    particles: Shared<Particles<R>>,
    ids: Shared<Ids>,
    clock: DoubleDouble,
    step_count: u64,
    revision: u64,
    bounds: Bounds,
    factors: Shared<Factors<R>>,
    threads: Threads,
    level: Level,
    /// What changed since when, if somebody asks.
    history: Option<Shared<History>>,
    /// Whether a batch has changed something, while one is going on.
    batch: Option<bool>,
}

/// The state of a particle at the clock of its world.
///
/// ```
/// use pointmass::{Mass, Particle, World};
/// let mut world = World::<f32>::default();
/// let id = world.create(Particle { mass: Mass::Mass(4.0), ..Particle::default() })?;
/// let state = world.particle(id)?;
/// assert_eq!((state.inverse_mass, state.mass()), (0.25, Some(4.0)));
/// # Ok::<(), pointmass::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParticleState<R: Real = f64> {
    /// Its name in the world.
    pub id: ParticleId,
    /// Metres.
    pub position: R::Vec3,
    /// Metres per second.
    pub velocity: R::Vec3,
    /// The effective acceleration in m/s², without the share of the force: its own, else the gravity of the world, and
    /// zero for an immovable particle without its own.
    pub acceleration: R::Vec3,
    /// Its own acceleration in m/s², if it has one.
    pub own_acceleration: Option<R::Vec3>,
    /// The share of the velocity that is kept each second, 0 to 1.
    pub damping: R,
    /// 1/m in 1/kg; 0 is immovable.
    pub inverse_mass: R,
    /// The sum of the forces, in newtons, added since the last advance.
    pub force: R::Vec3,
    /// Its own drag, if it has one.
    pub drag: Option<Drag<R>>,
    /// The mass in kilograms with which it attracts others, if it has one of its own.
    pub gravitational_mass: Option<R>,
}

/// Positions and velocities of some particles, as columns of one length.
#[derive(Debug, Clone, PartialEq)]
pub struct States<R: Real = f64> {
    /// Their names.
    pub id: Vec<ParticleId>,
    /// Metres.
    pub position: Vec<[R; 3]>,
    /// Metres per second.
    pub velocity: Vec<[R; 3]>,
}

impl<R: Real> Default for States<R> {
    fn default() -> Self {
        Self { id: Vec::new(), position: Vec::new(), velocity: Vec::new() }
    }
}

impl<R: Real> ParticleState<R> {
    /// 1/inverse mass in kilograms; `None` when the particle is immovable, or so heavy that the number is not finite (an
    /// inverse mass below about 2⁻¹⁰²⁴, 2⁻¹²⁸ in single).
    #[must_use]
    pub fn mass(&self) -> Option<R> {
        Some(R::ONE / self.inverse_mass).filter(|mass| mass.is_finite())
    }
}

static NEVER_CANCELLED: AtomicBool = AtomicBool::new(false);

impl<R: Real> Default for World<R> {
    fn default() -> Self {
        Self::new(Settings::default()).expect("the default settings are valid")
    }
}

impl<R: Real> World<R> {
    /// An empty world at time 0.
    ///
    /// # Errors
    /// A value that is not valid, or an integrator that cannot serve the damping law or the forces.
    pub fn new(settings: Settings<R>) -> Result<Self, Error> {
        Self::with_limits(settings, Limits::default())
    }

    /// The same with limits, which [`World::apply`] enforces from then on.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn with_limits(settings: Settings<R>, limits: Limits) -> Result<Self, Error> {
        R::world_with_limits(settings, limits)
    }

    fn empty(settings: Settings<R>, mut limits: Limits) -> Result<Self, Error> {
        limits.particles = limits.particles.min(Limits::default().particles);
        limits.steps = limits.steps.min(Limits::default().steps);
        let mut world = Self {
            settings: Settings::default(),
            limits,
            particles: Shared::new(Particles::new()),
            ids: Shared::default(),
            clock: DoubleDouble::default(),
            step_count: 0,
            revision: 0,
            bounds: Bounds::default(),
            factors: Shared::default(),
            threads: Threads::default(),
            level: Level::new(),
            history: None,
            batch: None,
        };
        world.configure(&Configure {
            integrator: Some(settings.integrator),
            gravity: Some(settings.gravity),
            damping_law: Some(settings.damping_law),
            max_step: Some(settings.max_step),
            drag: Some(settings.forces.drag),
            gravitation: Some(settings.forces.gravitation),
            tolerance: Some(settings.tolerance),
            compensated: Some(settings.compensated),
        })?;
        Ok(world)
    }

    /// Applies a command: all of it, or nothing and an error.
    ///
    /// # Errors
    /// What the command says that is not valid, or what it would make of the world.
    pub fn apply(&mut self, command: &Command<R>) -> Result<Outcome, Error> {
        self.apply_unless(command, &NEVER_CANCELLED)
    }

    /// The same, given up as soon as `cancelled` is seen to be true: an advance looks about every millisecond.
    ///
    /// # Errors
    /// As [`World::apply`], and [`Error::Cancelled`].
    pub fn apply_unless(&mut self, command: &Command<R>, cancelled: &AtomicBool) -> Result<Outcome, Error> {
        R::world_apply(self, command, cancelled)
    }

    fn apply_command(&mut self, command: &Command<R>, cancelled: &AtomicBool) -> Result<Outcome, Error> {
        let outcome = match command {
            Command::Create(new) => self.create_columns(new)?,
            Command::Place { ids, position, velocity } => self.place_all(ids, position.as_ref(), velocity.as_ref())?,
            Command::Set { ids, properties } => self.set_all(ids, properties)?,
            Command::AddForce { ids, force } => self.add_forces(ids, force)?,
            Command::Impulse { ids, impulse } => self.apply_impulses(ids, impulse)?,
            Command::Remove { ids } => self.remove_all(ids)?,
            Command::Advance(advance) => Outcome::Advanced(self.advance_all(advance, cancelled)?),
            Command::Configure(change) => {
                self.configure(change)?;
                Outcome::Configured
            }
        };
        self.note(command);
        self.end_change();
        Ok(outcome)
    }

    /// Creates one particle.
    ///
    /// # Errors
    /// A value out of its range, see [`Particle`]; [`Error::LimitReached`].
    pub fn create(&mut self, particle: Particle<R>) -> Result<ParticleId, Error> {
        let first = ParticleId(self.ids.next());
        self.apply(&Command::Create(particle.into())).map(|_| first)
    }

    /// Teleports a particle; `None` leaves the position or the velocity as it is.
    ///
    /// # Errors
    /// Unknown particle; a value that is not finite; both `None`.
    pub fn place(&mut self, id: ParticleId, position: Option<R::Vec3>, velocity: Option<R::Vec3>) -> Result<(), Error> {
        let (position, velocity) = (position.map(Column::Uniform), velocity.map(Column::Uniform));
        self.apply(&Command::Place { ids: id.into(), position, velocity }).map(drop)
    }

    /// Gives a particle an acceleration of its own, in m/s²; `None`: it follows the gravity of the world again.
    ///
    /// # Errors
    /// Unknown particle; a value that is not finite.
    pub fn set_acceleration(&mut self, id: ParticleId, acceleration: Option<R::Vec3>) -> Result<(), Error> {
        self.set(id, Properties { acceleration: Some(Column::Uniform(acceleration)), ..Properties::default() })
    }

    /// Sets the share of the velocity that is kept each second.
    ///
    /// # Errors
    /// Unknown particle; not between 0 and 1.
    pub fn set_damping(&mut self, id: ParticleId, damping: R) -> Result<(), Error> {
        self.set(id, Properties { damping: Some(Column::Uniform(damping)), ..Properties::default() })
    }

    /// Sets the mass in kilograms.
    ///
    /// # Errors
    /// Unknown particle; not above 0, or its inverse not finite.
    pub fn set_mass(&mut self, id: ParticleId, mass: R) -> Result<(), Error> {
        self.set(id, Properties { mass: Some(Column::Uniform(Mass::Mass(mass))), ..Properties::default() })
    }

    /// Sets the inverse mass in 1/kg; 0 makes the particle immovable.
    ///
    /// # Errors
    /// Unknown particle; below 0 or not finite.
    pub fn set_inverse_mass(&mut self, id: ParticleId, inverse_mass: R) -> Result<(), Error> {
        let mass = Some(Column::Uniform(Mass::Inverse(inverse_mass)));
        self.set(id, Properties { mass, ..Properties::default() })
    }

    /// Gives a particle a drag of its own; `None`: that of the world again. It acts where the world has drag at all.
    ///
    /// # Errors
    /// Unknown particle; a coefficient below 0 or not finite.
    pub fn set_drag(&mut self, id: ParticleId, drag: Option<Drag<R>>) -> Result<(), Error> {
        self.set(id, Properties { drag: Some(Column::Uniform(drag)), ..Properties::default() })
    }

    /// Sets the mass, in kilograms, with which a particle attracts others; `None`: its mass, and 0 if it is immovable.
    ///
    /// # Errors
    /// Unknown particle; below 0 or not finite.
    pub fn set_gravitational_mass(&mut self, id: ParticleId, mass: Option<R>) -> Result<(), Error> {
        self.set(id, Properties { gravitational_mass: Some(Column::Uniform(mass)), ..Properties::default() })
    }

    fn set(&mut self, id: ParticleId, properties: Properties<R>) -> Result<(), Error> {
        self.apply(&Command::Set { ids: id.into(), properties }).map(drop)
    }

    /// Adds a force in newtons; the sum acts through the whole next advance and is then cleared
    /// (Millington, chapter 3: the force accumulator and d'Alembert's principle).
    ///
    /// # Errors
    /// Unknown particle; a force or a sum that is not finite.
    pub fn add_force(&mut self, id: ParticleId, force: R::Vec3) -> Result<(), Error> {
        self.apply(&Command::AddForce { ids: id.into(), force: Column::Uniform(force) }).map(drop)
    }

    /// Changes the velocity at once by an impulse in newton seconds: v += J w.
    ///
    /// # Errors
    /// Unknown particle; an impulse or a velocity that is not finite.
    pub fn apply_impulse(&mut self, id: ParticleId, impulse: R::Vec3) -> Result<(), Error> {
        self.apply(&Command::Impulse { ids: id.into(), impulse: Column::Uniform(impulse) }).map(drop)
    }

    /// Removes a particle.
    ///
    /// # Errors
    /// Unknown particle.
    pub fn remove(&mut self, id: ParticleId) -> Result<(), Error> {
        self.apply(&Command::Remove { ids: id.into() }).map(drop)
    }

    /// Moves the world forward by a duration in seconds, or as an [`Advance`] says.
    ///
    /// # Errors
    /// A duration or steps that are not valid; [`Error::Diverged`]; [`Error::ClockOutOfRange`];
    /// [`Error::LimitReached`].
    pub fn advance(&mut self, advance: impl Into<Advance>) -> Result<Advanced, Error> {
        match self.apply(&Command::Advance(advance.into()))? {
            Outcome::Advanced(advanced) => Ok(advanced),
            Outcome::Created { .. } | Outcome::Changed { .. } | Outcome::Configured => {
                unreachable!("an advance answers with what it advanced")
            }
        }
    }

    /// Lets these threads share large advances. How many they are decides nothing about the result.
    pub fn set_threads(&mut self, threads: &Threads) {
        self.threads = threads.clone();
    }

    /// The settings in force.
    #[must_use]
    pub fn settings(&self) -> &Settings<R> {
        &self.settings
    }

    /// The clock in seconds: the double nearest to the exact sum of all durations.
    #[must_use]
    pub fn time(&self) -> f64 {
        self.clock.hi
    }

    /// The steps of all advances so far.
    #[must_use]
    pub fn step_count(&self) -> u64 {
        self.step_count
    }

    /// The number of commands applied so far; a batch is one, when it is over.
    #[must_use]
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// How many particles there are.
    #[must_use]
    pub fn particle_count(&self) -> usize {
        self.particles.len()
    }

    /// Whether there is such a particle.
    #[must_use]
    pub fn contains(&self, id: ParticleId) -> bool {
        self.ids.row(id).is_some()
    }

    /// The state of one particle. Reading never changes a bit of anything.
    ///
    /// # Errors
    /// Unknown particle.
    pub fn particle(&self, id: ParticleId) -> Result<ParticleState<R>, Error> {
        R::world_particle(self, id)
    }

    fn state_of(&self, id: ParticleId) -> Result<ParticleState<R>, Error> {
        let row = self.ids.row(id).ok_or(Error::UnknownParticle { id, index: 0 })?;
        let (position, velocity) = self.now(row);
        Ok(self.state(id, row, position, velocity))
    }

    /// The states of all particles, in ascending order of id.
    pub fn particles(&self) -> impl Iterator<Item = ParticleState<R>> {
        self.particles_from(ParticleId(0))
    }

    /// The same, from the first id that is at least `first`.
    pub fn particles_from(&self, first: ParticleId) -> impl Iterator<Item = ParticleState<R>> {
        R::world_walk(self, first)
    }

    /// Writes ids, positions and velocities of up to `limit` particles, in ascending order of id, from the first id that
    /// is at least `first`, over what is in `into`. The fastest way to read many: under
    /// [`exact`](crate::Integrator::Exact) they are evaluated in vector registers, under the others copied, and the memory
    /// of the last read is used again.
    ///
    /// ```
    /// use pointmass::{NewParticles, ParticleId, States, World};
    /// let mut world = World::<f64>::default();
    /// world.apply(&pointmass::Command::Create(NewParticles { count: 3, ..Default::default() }))?;
    /// let mut states = States::default();
    /// world.read(ParticleId(1), 100, &mut states);
    /// assert_eq!(states.id, [ParticleId(1), ParticleId(2)]);
    /// assert_eq!(states.position, [[0.0, 0.0, 0.0]; 2]);
    /// world.read(ParticleId(0), 1, &mut states);
    /// assert_eq!((states.id.as_slice(), states.velocity.len()), ([ParticleId(0)].as_slice(), 1));
    /// # Ok::<(), pointmass::Error>(())
    /// ```
    pub fn read(&self, first: ParticleId, limit: usize, into: &mut States<R>) {
        R::world_read(self, first, limit, into);
    }

    fn read_states(&self, first: ParticleId, limit: usize, into: &mut States<R>) {
        if let Some(range) = self.ids.rows_from(first, limit) {
            into.id.clear();
            into.id.extend(range.clone().map(|row| ParticleId(row as u64)));
            self.read_rows(&Rows::Range(range), into);
        } else {
            let found = self.ids.from(first.0).take(limit);
            let (ids, rows): (Vec<ParticleId>, Vec<usize>) = found.unzip();
            into.id = ids;
            self.read_rows(&Rows::List(&rows), into);
        }
    }

    fn read_rows(&self, rows: &Rows<'_>, into: &mut States<R>) {
        let mut carrier = Carrier::new(self, Span::To(self.clock), false, rows.len());
        carrier.read(self, rows, &mut into.position, &mut into.velocity);
    }

    /// Shows all particles, in ascending order of id, in blocks that stay in the cache: the fastest way to look at every
    /// particle once.
    ///
    /// ```
    /// use pointmass::{Command, NewParticles, World};
    /// let mut world = World::<f64>::default();
    /// world.apply(&Command::Create(NewParticles { count: 3, ..Default::default() }))?;
    /// let mut highest = f64::MIN;
    /// world.for_each_block(|block| {
    ///     highest = block.position.iter().fold(highest, |highest, position| highest.max(position[1]));
    /// });
    /// assert_eq!(highest, 0.0);
    /// # Ok::<(), pointmass::Error>(())
    /// ```
    pub fn for_each_block(&self, mut visit: impl FnMut(&States<R>)) {
        R::world_show(self, &mut visit);
    }

    fn show_blocks(&self, visit: &mut dyn FnMut(&States<R>)) {
        let count = self.particles.len();
        let mut carrier = Carrier::new(self, Span::To(self.clock), false, count);
        let mut block = States::default();
        let mut show = |ids: &mut dyn Iterator<Item = ParticleId>, rows: &Rows<'_>| {
            block.id.clear();
            block.id.extend(ids);
            carrier.read(self, rows, &mut block.position, &mut block.velocity);
            visit(&block);
        };
        if let Some(range) = self.ids.rows_from(ParticleId(0), count) {
            for rows in Rows::Range(range).blocks() {
                show(&mut rows.iter().map(|row| ParticleId(row as u64)), &rows);
            }
        } else {
            let mut every = self.ids.from(0);
            loop {
                let (ids, rows): (Vec<_>, Vec<_>) = every.by_ref().take(motion::BLOCK).unzip();
                if ids.is_empty() {
                    return;
                }
                show(&mut ids.into_iter(), &Rows::List(&rows));
            }
        }
    }

    /// The memory of a copy that something else than the world holds, once the world was written.
    #[cfg(feature = "server")]
    pub(crate) fn bytes(&self) -> u64 {
        self.particles.bytes() + self.ids.bytes()
    }

    fn gravity(&self) -> [R; 3] {
        self.settings.gravity.into()
    }

    fn state(&self, id: ParticleId, row: usize, position: [R; 3], velocity: [R; 3]) -> ParticleState<R> {
        let particles = &self.particles;
        ParticleState {
            id,
            position: position.into(),
            velocity: velocity.into(),
            acceleration: particles.acceleration(row, self.gravity()).into(),
            own_acceleration: particles.own(row).map(Into::into),
            damping: particles.damping.get(row),
            inverse_mass: particles.inverse_mass.get(row),
            force: particles.force.get(row).into(),
            drag: particles.drag.get(row),
            gravitational_mass: particles.gravitational_mass.get(row),
        }
    }
}

fn add<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    std::array::from_fn(|k| a[k] + b[k])
}
