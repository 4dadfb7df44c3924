//! A world: particles, settings and a clock; and the one place where commands change it.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

use fearless_simd::Level;

use crate::closed_form::ClosedForm;
use crate::column::Column;
use crate::command::{
    Advance, Advanced, Command, Configure, Mass, NewParticles, Outcome, Particle, Selection, Settings,
};
use crate::double_double::DoubleDouble;
use crate::error::{Error, Field, Limit, Limits, Place, Quantity};
use crate::ids::{Ids, ParticleId};
use crate::integrator::{DampingLaw, Integrator};
use crate::kernel::{self, Drive, Step};
use crate::particles::{Driving, Particles, zero};
use crate::real::Real;

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
#[derive(Debug, Clone)]
pub struct World<R: Real = f64> {
    settings: Settings<R>,
    limits: Limits,
    particles: Particles<R>,
    ids: Ids,
    clock: DoubleDouble,
    step_count: u64,
    revision: u64,
    bounds: Bounds,
    factors: Factors<R>,
    level: Level,
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
}

impl<R: Real> ParticleState<R> {
    /// 1/inverse mass in kilograms; `None` when the particle is immovable, or so heavy that the number is not finite (an
    /// inverse mass below about 2⁻¹⁰²⁴, 2⁻¹²⁸ in single).
    #[must_use]
    pub fn mass(&self) -> Option<R> {
        Some(R::ONE / self.inverse_mass).filter(|mass| mass.is_finite())
    }
}

/// A row of a block with the position and velocity that it keeps.
type Resting<R> = (usize, [R; 3], [R; 3]);

/// The steps of an advance, decided before it begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepPlan {
    /// Seconds.
    pub duration: f64,
    /// How many steps; always 1 under [`Integrator::Exact`].
    pub steps: u64,
    /// The length of one in seconds.
    pub step: f64,
}

/// Clocks stay below 2⁴⁰⁰ s, so that the square of a time is finite.
const CLOCK_MAX: f64 = f64::from_bits((1023 + 400) << 52);

/// Particles x steps between two looks at whether an advance is cancelled: about a tenth of a millisecond.
const WORK_BETWEEN_LOOKS: u64 = 1 << 18;

/// The most particles x steps of an advance that is done in place and cannot be cancelled: some milliseconds, and not
/// more than a tenth of a second where each step waits for memory.
const WORK_IN_PLACE: u64 = 1 << 24;

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
    /// A gravity or `max_step` that is not valid, or an integrator that cannot serve the damping law.
    pub fn new(settings: Settings<R>) -> Result<Self, Error> {
        Self::with_limits(settings, Limits::default())
    }

    /// The same with limits, which [`World::apply`] enforces from then on.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn with_limits(settings: Settings<R>, mut limits: Limits) -> Result<Self, Error> {
        limits.particles = limits.particles.min(Limits::default().particles);
        limits.steps = limits.steps.min(Limits::default().steps);
        let mut world = Self {
            settings: Settings::default(),
            limits,
            particles: Particles::new(),
            ids: Ids::default(),
            clock: DoubleDouble::default(),
            step_count: 0,
            revision: 0,
            bounds: Bounds::default(),
            factors: Factors::default(),
            level: Level::new(),
        };
        world.configure(&Configure {
            integrator: Some(settings.integrator),
            gravity: Some(settings.gravity),
            damping_law: Some(settings.damping_law),
            max_step: Some(settings.max_step),
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
        let outcome = match command {
            Command::Create(new) => self.create_columns(new)?,
            Command::Place { ids, position, velocity } => self.place_all(ids, position.as_ref(), velocity.as_ref())?,
            Command::Set { ids, acceleration, damping, mass } => {
                self.set_all(ids, acceleration.as_ref(), damping.as_ref(), mass.as_ref())?
            }
            Command::AddForce { ids, force } => self.add_forces(ids, force)?,
            Command::Impulse { ids, impulse } => self.apply_impulses(ids, impulse)?,
            Command::Remove { ids } => self.remove_all(ids)?,
            Command::Advance(advance) => Outcome::Advanced(self.advance_all(advance, cancelled)?),
            Command::Configure(change) => {
                self.configure(change)?;
                Outcome::Configured
            }
        };
        self.revision += 1;
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
        let acceleration = Some(Column::Uniform(acceleration));
        self.apply(&Command::Set { ids: id.into(), acceleration, damping: None, mass: None }).map(drop)
    }

    /// Sets the share of the velocity that is kept each second.
    ///
    /// # Errors
    /// Unknown particle; not between 0 and 1.
    pub fn set_damping(&mut self, id: ParticleId, damping: R) -> Result<(), Error> {
        let damping = Some(Column::Uniform(damping));
        self.apply(&Command::Set { ids: id.into(), acceleration: None, damping, mass: None }).map(drop)
    }

    /// Sets the mass in kilograms.
    ///
    /// # Errors
    /// Unknown particle; not above 0, or its inverse not finite.
    pub fn set_mass(&mut self, id: ParticleId, mass: R) -> Result<(), Error> {
        self.set_inertia(id, Mass::Mass(mass))
    }

    /// Sets the inverse mass in 1/kg; 0 makes the particle immovable.
    ///
    /// # Errors
    /// Unknown particle; below 0 or not finite.
    pub fn set_inverse_mass(&mut self, id: ParticleId, inverse_mass: R) -> Result<(), Error> {
        self.set_inertia(id, Mass::Inverse(inverse_mass))
    }

    fn set_inertia(&mut self, id: ParticleId, mass: Mass<R>) -> Result<(), Error> {
        let mass = Some(Column::Uniform(mass));
        self.apply(&Command::Set { ids: id.into(), acceleration: None, damping: None, mass }).map(drop)
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

    /// The number of commands applied so far.
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
        let row = self.ids.row(id).ok_or(Error::UnknownParticle { id, index: 0 })?;
        Ok(self.state(id, row, &mut LastForm::default()))
    }

    /// The states of all particles, in ascending order of id.
    pub fn particles(&self) -> impl Iterator<Item = ParticleState<R>> {
        self.particles_from(ParticleId(0))
    }

    /// The same, from the first id that is at least `first`.
    pub fn particles_from(&self, first: ParticleId) -> impl Iterator<Item = ParticleState<R>> {
        let mut form = LastForm::default();
        self.ids.from(first.0).map(move |(id, row)| self.state(id, row, &mut form))
    }

    /// The steps that an advance would take.
    ///
    /// # Errors
    /// As [`World::advance`], for what can be told from the duration and the steps alone.
    pub fn plan(&self, advance: &Advance) -> Result<StepPlan, Error> {
        let Advance { duration, steps, max_step } = *advance;
        if !duration.is_finite() {
            return Err(Error::NotFinite(Field::Duration.whole()));
        }
        if duration <= 0.0 {
            return Err(Error::DurationNotPositive);
        }
        if steps.is_some() && max_step.is_some() {
            return Err(Error::StepsAndMaxStep);
        }
        let asked = match steps {
            Some(0) => return Err(Error::StepsNotPositive),
            Some(steps) => steps,
            None => match max_step.or(self.settings.max_step) {
                Some(max_step) => steps_of_at_most(duration, valid_max_step(max_step)?),
                None => 1,
            },
        };
        let within = |limit, allowed, asked| {
            if asked > allowed { Err(Error::LimitReached { limit, allowed, asked }) } else { Ok(()) }
        };
        within(Limit::Steps, self.limits.steps.min(u64::MAX - self.step_count), asked)?;
        let steps = if self.settings.integrator == Integrator::Exact { 1 } else { asked };
        let particle_steps = steps.saturating_mul(self.particles.len() as u64);
        within(Limit::ParticleSteps, self.limits.particle_steps, particle_steps)?;
        #[expect(clippy::cast_precision_loss, reason = "a step count is a small number")]
        let step = duration / steps as f64;
        if self.settings.integrator != Integrator::Exact && !R::nearest(step).is_finite() {
            return Err(Error::NotFinite(Field::Duration.whole()));
        }
        Ok(StepPlan { duration, steps, step })
    }

    /// About what an advance costs, in particles to move or to look at, times steps; 0 when it only moves the clock, or
    /// is refused at once.
    #[must_use]
    pub fn work(&self, advance: &Advance) -> u64 {
        let particles = self.particles.len() as u64;
        match self.plan(advance) {
            Err(_) => 0,
            Ok(plan) if self.settings.integrator != Integrator::Exact => particles.saturating_mul(plan.steps),
            Ok(plan) => {
                let clock = self.clock + DoubleDouble::from(plan.duration);
                let looks = self.particles.force != Column::Uniform(zero())
                    || self.particles.immovable_count > 0
                    || !self.bounds.hold_until::<R>(clock);
                if looks { particles } else { 0 }
            }
        }
    }

    fn gravity(&self) -> [R; 3] {
        self.settings.gravity.into()
    }

    fn rows(&self, ids: &Selection) -> Result<Vec<usize>, Error> {
        match ids {
            Selection::All => Ok(self.ids.from(0).map(|(_, row)| row).collect()),
            Selection::Ids(ids) => ids
                .iter()
                .enumerate()
                .map(|(index, &id)| self.ids.row(id).ok_or(Error::UnknownParticle { id, index }))
                .collect(),
        }
    }

    fn create_columns(&mut self, new: &NewParticles<R>) -> Result<Outcome, Error> {
        let count = new.count;
        let position = vectors(&new.position, Field::Position, count)?;
        let velocity = vectors(&new.velocity, Field::Velocity, count)?;
        let acceleration = accelerations(&new.acceleration, count)?;
        let damping = dampings(&new.damping, count)?;
        let inverse_mass = inverse_masses(&new.mass, count)?;
        let len = self.particles.len();
        let asked = (len as u64).saturating_add(count as u64);
        if asked > self.limits.particles {
            return Err(Error::LimitReached { limit: Limit::Particles, allowed: self.limits.particles, asked });
        }
        let particles = &mut self.particles;
        particles.position.extend((0..count).map(|i| position.get(i)));
        particles.velocity.extend((0..count).map(|i| velocity.get(i)));
        particles.own_acceleration.extend(len, &acceleration.map(Option::unwrap_or_default), count);
        particles.has_own_acceleration.extend(len, &acceleration.map(|own| own.is_some()), count);
        particles.damping.extend(len, &damping, count);
        self.factors.forget();
        particles.inverse_mass.extend(len, &inverse_mass, count);
        particles.immovable_count += (0..count).filter(|&i| inverse_mass.get(i) == R::ZERO).count();
        particles.force.extend(len, &Column::Uniform(zero()), count);
        particles.base_time.extend(len, &Column::Uniform(self.clock), count);
        for row in len..len + count {
            self.bounds.include(&self.particles, row);
        }
        Ok(Outcome::Created { first: self.ids.create(count), count })
    }

    fn place_all(
        &mut self,
        ids: &Selection,
        position: Option<&Column<R::Vec3>>,
        velocity: Option<&Column<R::Vec3>>,
    ) -> Result<Outcome, Error> {
        if position.is_none() && velocity.is_none() {
            return Err(Error::NothingToPlace);
        }
        let rows = self.rows(ids)?;
        let position = position.map(|column| vectors(column, Field::Position, rows.len())).transpose()?;
        let velocity = velocity.map(|column| vectors(column, Field::Velocity, rows.len())).transpose()?;
        let mut form = LastForm::default();
        for (i, &row) in rows.iter().enumerate() {
            self.rebase(row, &mut form);
            if let Some(position) = &position {
                self.particles.position[row] = position.get(i);
            }
            if let Some(velocity) = &velocity {
                self.particles.velocity[row] = velocity.get(i);
            }
            self.bounds.include(&self.particles, row);
        }
        Ok(Outcome::Changed { count: rows.len() })
    }

    fn set_all(
        &mut self,
        ids: &Selection,
        acceleration: Option<&Column<Option<R::Vec3>>>,
        damping: Option<&Column<R>>,
        mass: Option<&Column<Mass<R>>>,
    ) -> Result<Outcome, Error> {
        let rows = self.rows(ids)?;
        let acceleration = acceleration.map(|column| accelerations(column, rows.len())).transpose()?;
        let damping = damping.map(|column| dampings(column, rows.len())).transpose()?;
        let inverse_mass = mass.map(|column| inverse_masses(column, rows.len())).transpose()?;
        if acceleration.is_some() || damping.is_some() || inverse_mass.is_some() {
            self.rebase_all(&rows);
        }
        if damping.is_some() {
            self.factors.forget();
        }
        let every = *ids == Selection::All;
        let particles = &mut self.particles;
        let len = particles.len();
        let has_own = acceleration.as_ref().map(|column| column.map(|own| own.is_some()));
        let own = acceleration.map(|column| column.map(Option::unwrap_or_default));
        assign(&mut particles.has_own_acceleration, has_own, &rows, every, len);
        assign(&mut particles.own_acceleration, own, &rows, every, len);
        assign(&mut particles.damping, damping, &rows, every, len);
        if let Some(inverse_mass) = inverse_mass {
            assign(&mut particles.inverse_mass, Some(inverse_mass), &rows, every, len);
            particles.count_immovable();
        }
        for &row in &rows {
            self.bounds.include(&self.particles, row);
        }
        Ok(Outcome::Changed { count: rows.len() })
    }

    fn add_forces(&mut self, ids: &Selection, force: &Column<R::Vec3>) -> Result<Outcome, Error> {
        let rows = self.rows(ids)?;
        let force = vectors(force, Field::Force, rows.len())?.map(|f| f.map(positive_zero));
        let len = self.particles.len();
        let mut before = Vec::with_capacity(rows.len());
        for (i, &row) in rows.iter().enumerate() {
            let old = self.particles.force.get(row);
            let sum = add(old, force.get(i));
            if !sum.iter().all(|x| x.is_finite()) {
                let error = self.overflow(row, Quantity::Force, Field::Force, &force, i);
                for (&row, old) in rows.iter().zip(before).rev() {
                    self.particles.force.set(row, old, len);
                }
                return Err(error);
            }
            before.push(old);
            self.particles.force.set(row, sum, len);
            self.bounds.force = self.bounds.force.max(magnitude(sum));
        }
        Ok(Outcome::Changed { count: rows.len() })
    }

    fn apply_impulses(&mut self, ids: &Selection, impulse: &Column<R::Vec3>) -> Result<Outcome, Error> {
        let rows = self.rows(ids)?;
        let impulse = vectors(impulse, Field::Impulse, rows.len())?;
        // The new velocities are computed aside: a particle that is named twice starts from its first one.
        let mut velocities: HashMap<usize, [R; 3]> = HashMap::with_capacity(rows.len());
        let mut form = LastForm::default();
        for (i, &row) in rows.iter().enumerate() {
            let velocity = velocities.entry(row).or_insert_with(|| self.now(row, &mut form).1);
            let w = self.particles.inverse_mass.get(row);
            *velocity = add(*velocity, impulse.get(i).map(|j| j * w));
            if !velocity.iter().all(|x| x.is_finite()) {
                return Err(self.overflow(row, Quantity::Velocity, Field::Impulse, &impulse, i));
            }
        }
        for (row, velocity) in velocities {
            self.rebase(row, &mut form);
            self.particles.velocity[row] = velocity;
            self.bounds.include(&self.particles, row);
        }
        Ok(Outcome::Changed { count: rows.len() })
    }

    fn overflow<T: Copy + PartialEq>(
        &self,
        row: usize,
        quantity: Quantity,
        field: Field,
        column: &Column<T>,
        index: usize,
    ) -> Error {
        let index = column.len_if_per_particle().map(|_| index);
        Error::Overflow { particle: self.ids.id(row), quantity, place: Place { field, index } }
    }

    fn remove_all(&mut self, selection: &Selection) -> Result<Outcome, Error> {
        let listed: Vec<ParticleId> = match selection {
            Selection::All => self.ids.from(0).map(|(id, _)| id).collect(),
            Selection::Ids(ids) => {
                self.rows(selection)?;
                let mut seen = std::collections::HashSet::with_capacity(ids.len());
                if let Some((index, &id)) = ids.iter().enumerate().find(|(_, id)| !seen.insert(**id)) {
                    return Err(Error::RemovedTwice { id, index });
                }
                ids.clone()
            }
        };
        for &id in &listed {
            let row = self.ids.remove(id).expect("every id was looked up above");
            self.particles.swap_remove(row);
        }
        self.factors.forget();
        Ok(Outcome::Changed { count: listed.len() })
    }

    fn configure(&mut self, change: &Configure<R>) -> Result<(), Error> {
        let mut settings = self.settings;
        if let Some(gravity) = change.gravity {
            let gravity = vectors(&Column::Uniform(gravity), Field::Gravity, 0)?.map(|g| g.map(positive_zero));
            settings.gravity = gravity.get(0).into();
        }
        if let Some(max_step) = change.max_step {
            settings.max_step = max_step.map(valid_max_step).transpose()?;
        }
        settings.integrator = change.integrator.unwrap_or(settings.integrator);
        settings.damping_law = change.damping_law.unwrap_or(settings.damping_law);
        let Settings { integrator, damping_law, .. } = settings;
        if !integrator.serves(damping_law) {
            return Err(Error::IntegratorCannotServeDamping { integrator, damping_law });
        }
        let motion_changes = change.integrator.is_some() || change.gravity.is_some();
        if motion_changes {
            let rows: Vec<usize> = (0..self.particles.len())
                .filter(|&row| change.integrator.is_some() || self.follows_gravity(row))
                .collect();
            self.rebase_all(&rows);
        }
        self.settings = settings;
        if motion_changes {
            self.bounds = Bounds::of(&self.particles, settings.gravity.into());
        }
        Ok(())
    }

    fn follows_gravity(&self, row: usize) -> bool {
        !self.particles.has_own_acceleration.get(row) && self.particles.inverse_mass.get(row) != R::ZERO
    }

    fn advance_all(&mut self, advance: &Advance, cancelled: &AtomicBool) -> Result<Advanced, Error> {
        let plan = self.plan(advance)?;
        let clock = self.clock + DoubleDouble::from(plan.duration);
        if clock.hi > CLOCK_MAX {
            return Err(Error::ClockOutOfRange);
        }
        let resting = if self.particles.immovable_count > 0 {
            (0..self.particles.len()).filter(|&row| self.particles.is_resting(row)).count()
        } else {
            0
        };
        let integrated = match self.settings.integrator {
            Integrator::Exact => self.flow(plan, clock, cancelled)?,
            Integrator::NewtonEuler | Integrator::NewtonEulerQuadratic | Integrator::SemiImplicitEuler => {
                self.step(plan, cancelled)?;
                self.particles.base_time = Column::Uniform(clock);
                self.particles.len() - resting
            }
        };
        self.particles.force = Column::Uniform(zero());
        self.bounds.force = 0.0;
        self.clock = clock;
        self.step_count += plan.steps;
        Ok(Advanced {
            time: self.time(),
            duration: plan.duration,
            steps: plan.steps,
            step: plan.step,
            step_count: self.step_count,
            integrated,
            deferred: self.particles.len() - resting - integrated,
            skipped: resting,
        })
    }

    /// An advance under a stepped integrator. In place when bounds prove that it ends well and it is over at once;
    /// otherwise the state before is kept, and put back when the advance is cancelled or diverges.
    fn step(&mut self, plan: StepPlan, cancelled: &AtomicBool) -> Result<(), Error> {
        let step = Step { integrator: self.settings.integrator, h: R::nearest(plan.step) };
        self.factors.prepare(&self.particles.damping, self.settings.damping_law, step.h);
        let bounds = self.bounds.after_steps::<R>(plan).or_else(|| {
            self.bounds = Bounds::of(&self.particles, self.gravity());
            self.bounds.after_steps::<R>(plan)
        });
        let work = plan.steps.saturating_mul(self.particles.len() as u64);
        if let Some(bounds) = bounds
            && work <= WORK_IN_PLACE
        {
            self.bounds = bounds;
            return self.run_steps(step, plan.steps, &NEVER_CANCELLED);
        }
        let before = (self.particles.position.clone(), self.particles.velocity.clone());
        let result = self.run_steps(step, plan.steps, cancelled);
        let ended = result.and_then(|()| match bounds {
            Some(_) => Ok(()),
            None => self.first_divergence(step, plan.steps, &before, cancelled),
        });
        if ended.is_err() {
            (self.particles.position, self.particles.velocity) = before;
            return ended;
        }
        self.bounds = bounds.unwrap_or_else(|| Bounds::of(&self.particles, self.gravity()));
        Ok(())
    }

    /// Moves position and velocity block by block; all steps of a block while it is in the cache.
    fn run_steps(&mut self, step: Step<R>, steps: u64, cancelled: &AtomicBool) -> Result<(), Error> {
        let mut position = std::mem::take(&mut self.particles.position);
        let mut velocity = std::mem::take(&mut self.particles.velocity);
        let mut scratch = Scratch::new();
        let mut work = 0;
        let mut run = || {
            for (block, (p, v)) in position.chunks_mut(BLOCK).zip(velocity.chunks_mut(BLOCK)).enumerate() {
                let first = block * BLOCK;
                let Some(resting) = self.resting_of(first, p, v) else { continue };
                let drive = scratch.drive(self, first..first + p.len());
                let mut left = steps;
                while left > 0 {
                    let slice = left.min(STEPS_BETWEEN_LOOKS);
                    look(&mut work, slice * BLOCK as u64, cancelled)?;
                    kernel::advance(self.level, step, drive, slice, p.as_flattened_mut(), v.as_flattened_mut());
                    left -= slice;
                }
                for (row, place, speed) in resting {
                    (p[row], v[row]) = (place, speed);
                }
            }
            Ok(())
        };
        let result = run();
        (self.particles.position, self.particles.velocity) = (position, velocity);
        result
    }

    /// The resting particles of a block, which are put back as they were; `None` when all of them rest.
    fn resting_of(&self, first: usize, p: &[[R; 3]], v: &[[R; 3]]) -> Option<Vec<Resting<R>>> {
        let mut resting = Vec::new();
        if self.particles.immovable_count > 0 {
            for (row, (place, speed)) in p.iter().zip(v).enumerate() {
                if self.particles.nothing_moves(first + row) && *speed == zero() {
                    resting.push((row, *place, *speed));
                }
            }
        }
        (resting.len() < p.len()).then_some(resting)
    }

    /// The smallest id of a particle that did not stay finite, with its first step, found by stepping it again.
    fn first_divergence(
        &self,
        step: Step<R>,
        steps: u64,
        before: &(Vec<[R; 3]>, Vec<[R; 3]>),
        cancelled: &AtomicBool,
    ) -> Result<(), Error> {
        let ended = self.particles.position.iter().zip(&self.particles.velocity).enumerate();
        let diverged = ended.filter(|(_, (p, v))| kernel::non_finite(*p, *v).is_some());
        let Some((particle, row)) = diverged.map(|(row, _)| (self.ids.id(row), row)).min() else { return Ok(()) };
        let (mut p, mut v) = (before.0[row], before.1[row]);
        let mut scratch = Scratch::new();
        let drive = scratch.drive(self, row..row + 1);
        let (mut work, mut done) = (0, 0);
        while done < steps {
            // From rest to rest, so that each step is the one of the advance.
            let some = (steps - done).min(kernel::STEPS_BETWEEN_RESTS);
            let after = |steps| {
                let (mut p, mut v) = (p, v);
                kernel::advance(self.level, step, drive, steps, &mut p, &mut v);
                (p, v)
            };
            let non_finite_after = |steps| {
                let (p, v) = after(steps);
                kernel::non_finite(&p, &v)
            };
            if non_finite_after(some).is_some()
                && let Some((n, quantity)) = (1..=some).find_map(|n| Some((n, non_finite_after(n)?)))
            {
                return Err(Error::Diverged { particle, quantity, step: done + n });
            }
            look(&mut work, some, cancelled)?;
            (p, v) = after(some);
            done += some;
        }
        unreachable!("the same steps end the same way, and what is not finite once stays so")
    }

    /// An advance under the closed form: particles with a force move now, the others when they are read. How many moved.
    fn flow(&mut self, plan: StepPlan, clock: DoubleDouble, cancelled: &AtomicBool) -> Result<usize, Error> {
        let particles = &self.particles;
        let forces = particles.force != Column::Uniform(zero());
        let safe = self.bounds.hold_until::<R>(clock);
        if !forces && safe {
            return Ok(0);
        }
        let (mut start, mut end) = (LastForm::default(), LastForm::default());
        let mut moved = Vec::new();
        let mut diverged: Option<(ParticleId, Quantity)> = None;
        let mut work = 0;
        for row in 0..particles.len() {
            look(&mut work, 1, cancelled)?;
            let (p, v) = if forces && particles.is_forced(row) {
                let (p, v) = self.now(row, &mut start);
                let own = particles.acceleration(row, self.gravity());
                let (w, f) = (particles.inverse_mass.get(row).into(), particles.force.get(row));
                let acceleration = std::array::from_fn(|k| own[k].into() + w * f[k].into());
                let state = flowed(p, v, acceleration, particles.damping.get(row), plan.duration, &mut end);
                moved.push((row, state));
                state
            } else if safe {
                continue;
            } else {
                self.at(row, clock, &mut end)
            };
            if let Some(quantity) = kernel::non_finite(&p, &v) {
                let id = self.ids.id(row);
                diverged = Some(diverged.filter(|(smallest, _)| *smallest < id).unwrap_or((id, quantity)));
            }
        }
        if let Some((particle, quantity)) = diverged {
            return Err(Error::Diverged { particle, quantity, step: 1 });
        }
        let len = particles.len();
        if !safe {
            // All of them were looked at; the bounds may have been of one that is gone.
            self.bounds = Bounds::of(&self.particles, self.gravity());
        }
        if moved.len() == len {
            self.particles.base_time = Column::Uniform(clock);
        }
        for &(row, (p, v)) in &moved {
            self.particles.position[row] = p;
            self.particles.velocity[row] = v;
            self.particles.base_time.set(row, clock, len);
            self.bounds.include(&self.particles, row);
        }
        Ok(moved.len())
    }

    /// Position and velocity at the clock.
    fn now(&self, row: usize, form: &mut LastForm) -> ([R; 3], [R; 3]) {
        self.at(row, self.clock, form)
    }

    /// Position and velocity at a clock that is not before the base time.
    fn at(&self, row: usize, clock: DoubleDouble, form: &mut LastForm) -> ([R; 3], [R; 3]) {
        let particles = &self.particles;
        let (p, v) = (particles.position[row], particles.velocity[row]);
        let elapsed = (clock - particles.base_time.get(row)).hi;
        if elapsed == 0.0 || particles.is_resting(row) {
            return (p, v);
        }
        let acceleration = particles.acceleration(row, self.gravity()).map(Into::into);
        flowed(p, v, acceleration, particles.damping.get(row), elapsed, form)
    }

    /// Stores what a read of now returns, with the clock as base time. Does nothing under a stepped integrator, whose
    /// states always hold at the clock.
    fn rebase(&mut self, row: usize, form: &mut LastForm) {
        let len = self.particles.len();
        (self.particles.position[row], self.particles.velocity[row]) = self.now(row, form);
        self.particles.base_time.set(row, self.clock, len);
    }

    fn rebase_all(&mut self, rows: &[usize]) {
        let mut form = LastForm::default();
        for &row in rows {
            self.rebase(row, &mut form);
        }
        if rows.len() >= self.particles.len()
            && (0..self.particles.len()).all(|row| self.particles.base_time.get(row) == self.clock)
        {
            self.particles.base_time = Column::Uniform(self.clock);
        }
    }

    fn state(&self, id: ParticleId, row: usize, form: &mut LastForm) -> ParticleState<R> {
        let (position, velocity) = self.now(row, form);
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
        }
    }
}

/// Counts work; looks at the flag once in a while.
fn look(work: &mut u64, more: u64, cancelled: &AtomicBool) -> Result<(), Error> {
    *work += more;
    if *work >= WORK_BETWEEN_LOOKS {
        *work = 0;
        if cancelled.load(Ordering::Relaxed) {
            return Err(Error::Cancelled);
        }
    }
    Ok(())
}

fn add<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    std::array::from_fn(|k| a[k] + b[k])
}

/// -0 as 0, so that adding it changes no bit.
fn positive_zero<R: Real>(x: R) -> R {
    x + R::ZERO
}

/// The closed form over a time, computed in double and rounded once.
fn flowed<R: Real>(
    p: [R; 3],
    v: [R; 3],
    acceleration: [f64; 3],
    damping: R,
    time: f64,
    form: &mut LastForm,
) -> ([R; 3], [R; 3]) {
    let form = form.of(damping.into(), time);
    let (p, v) = form.apply(p.map(Into::into), v.map(Into::into), acceleration);
    let v = v.map(R::nearest);
    (p.map(R::nearest), if damping < R::ONE { v.map(|v| kernel::at_rest_below(v, R::REST)) } else { v })
}

/// The closed form that was last used: particles with the same damping and base time share it.
#[derive(Debug, Default)]
struct LastForm(Option<(f64, f64, ClosedForm)>);

impl LastForm {
    fn of(&mut self, damping: f64, time: f64) -> ClosedForm {
        match self.0 {
            Some((d, t, form)) if d == damping && t == time => form,
            Some(_) | None => {
                let form = ClosedForm::new(damping, time);
                self.0 = Some((damping, time, form));
                form
            }
        }
    }
}

/// D of every particle, kept while dampings and step length stay: a pow for each distinct damping, once.
#[derive(Debug, Clone, Default)]
struct Factors<R> {
    /// The law and the step length that the values are for.
    of: Option<(DampingLaw, R)>,
    /// D of the uniform damping, or of each particle.
    values: Vec<R>,
    /// Whether every damping is below 1.
    all_damped: bool,
}

impl<R: Real> Factors<R> {
    /// What is kept is not for these dampings any more.
    fn forget(&mut self) {
        self.of = None;
    }

    fn prepare(&mut self, damping: &Column<R>, law: DampingLaw, h: R) {
        if self.of == Some((law, h)) {
            return;
        }
        let mut seen = HashMap::new();
        let mut last = (R::ONE, R::ONE);
        self.values.clear();
        self.values.extend(damping.entries().map(|(_, damping)| {
            if damping != last.0 {
                let exact: f64 = damping.into();
                last = (damping, *seen.entry(exact.to_bits()).or_insert_with(|| damping_factor(law, damping, h)));
            }
            last.1
        }));
        self.all_damped = damping.entries().all(|(_, damping)| damping < R::ONE);
        self.of = Some((law, h));
    }
}

/// D: `damping` to the power of h, correctly rounded in double, then rounded to the precision of the world.
fn damping_factor<R: Real>(law: DampingLaw, damping: R, h: R) -> R {
    match law {
        DampingLaw::PerStep => damping,
        DampingLaw::PerSecond => R::nearest(pxfm::f_pow(damping.into(), h.into())),
    }
}

/// Particles that are moved together: with all that drives them, they fit into the first cache.
const BLOCK: usize = 256;

/// Steps of a block between two looks at whether the advance is cancelled: a tenth of a millisecond. A whole number of
/// times the steps between two rests, so that slices of an advance rest where the whole does.
const STEPS_BETWEEN_LOOKS: u64 = 16 * kernel::STEPS_BETWEEN_RESTS;

/// Room for what drives the components of one block, where no column has it as it is.
struct Scratch<R> {
    acceleration: [R; 3 * BLOCK],
    /// What the acceleration is filled with, when it is the same for all.
    uniform: Option<[R; 3]>,
    factor: [R; 3 * BLOCK],
    rest: [R; 3 * BLOCK],
}

impl<R: Real> Scratch<R> {
    fn new() -> Self {
        let zeros = [R::ZERO; 3 * BLOCK];
        Self { acceleration: zeros, uniform: Some(zero()), factor: zeros, rest: zeros }
    }

    /// What drives the particles of some rows. Decided by values: a column of equal values is no different from a
    /// uniform one.
    fn drive<'a>(&'a mut self, world: &'a World<R>, rows: std::ops::Range<usize>) -> Drive<'a, R> {
        let particles = &world.particles;
        let len = 3 * rows.len();
        let acceleration = match particles.driving_acceleration(world.gravity(), rows.clone()) {
            Driving::Column(column) => column.as_flattened(),
            Driving::Uniform(uniform) => {
                if self.uniform != Some(uniform) {
                    self.acceleration.as_chunks_mut::<3>().0.fill(uniform);
                    self.uniform = Some(uniform);
                }
                &self.acceleration[..len]
            }
            Driving::Each => {
                self.uniform = None;
                particles.fill_acceleration(world.gravity(), rows.clone(), self.acceleration.as_chunks_mut::<3>().0);
                &self.acceleration[..len]
            }
        };
        let damping = match &particles.damping {
            Column::Uniform(d) if *d == R::ONE => kernel::Damping::None,
            Column::Uniform(_) => kernel::Damping::Uniform(world.factors.values[0]),
            Column::PerParticle(dampings) => {
                let factor = &mut self.factor[..len];
                kernel::to_components(world.level, &world.factors.values[rows.clone()], factor);
                if world.factors.all_damped {
                    kernel::Damping::Each(factor)
                } else {
                    for (rest, damping) in self.rest.as_chunks_mut::<3>().0.iter_mut().zip(&dampings[rows]) {
                        *rest = [if *damping < R::ONE { R::REST } else { R::ZERO }; 3];
                    }
                    kernel::Damping::Mixed { factor, rest: &self.rest[..len] }
                }
            }
        };
        Drive { acceleration, damping }
    }
}

/// Bounds on the magnitudes of all bases, so that most advances under the closed form need not look at any particle.
/// They only say whether to look: what is looked at is decided by the numbers themselves.
#[derive(Debug, Clone, Copy)]
struct Bounds {
    position: f64,
    velocity: f64,
    acceleration: f64,
    inverse_mass: f64,
    force: f64,
    /// At or before every base time.
    oldest: DoubleDouble,
}

impl Default for Bounds {
    fn default() -> Self {
        let oldest = DoubleDouble::default();
        Self { position: 0.0, velocity: 0.0, acceleration: 0.0, inverse_mass: 0.0, force: 0.0, oldest }
    }
}

impl Bounds {
    fn of<R: Real>(particles: &Particles<R>, gravity: [R; 3]) -> Self {
        let oldest = particles.base_time.entries().map(|(_, time)| time);
        let mut bounds = Self {
            acceleration: magnitude(gravity),
            force: particles.force.entries().map(|(_, force)| magnitude(force)).fold(0.0, f64::max),
            oldest: oldest.reduce(|a, b| if (b - a).hi < 0.0 { b } else { a }).unwrap_or_default(),
            ..Self::default()
        };
        for row in 0..particles.len() {
            bounds.include(particles, row);
        }
        bounds
    }

    /// Takes in a row that was written.
    fn include<R: Real>(&mut self, particles: &Particles<R>, row: usize) {
        self.position = self.position.max(magnitude(particles.position[row]));
        self.velocity = self.velocity.max(magnitude(particles.velocity[row]));
        self.acceleration = self.acceleration.max(particles.own(row).map_or(0.0, magnitude));
        self.inverse_mass = self.inverse_mass.max(particles.inverse_mass.get(row).into());
    }

    /// The bounds after an advance under any stepped integrator, when they prove that every number stays finite on the
    /// way: |v| grows by at most |A| T, |p| by at most (|v| + |A| T) T. Rounding adds less than 2⁻²⁰ of it a step.
    fn after_steps<R: Real>(&self, plan: StepPlan) -> Option<Self> {
        let t = plan.duration;
        let acceleration = self.acceleration + self.inverse_mass * self.force;
        #[expect(clippy::cast_precision_loss, reason = "an estimate")]
        let slack = 1.0 + (plan.steps + 1) as f64 / f64::from(1 << 20);
        let velocity = (self.velocity + acceleration * t) * slack;
        let position = (self.position + velocity * t) * slack;
        let finite = 0.25 * R::LARGEST;
        (slack < 2.0 && velocity < finite && position < finite && acceleration < finite).then_some(Self {
            position,
            velocity,
            ..*self
        })
    }

    /// Whether no position and no velocity can be beyond half the largest number: φ <= t and ψ <= t²/2.
    fn hold_until<R: Real>(&self, clock: DoubleDouble) -> bool {
        let t = (clock - self.oldest).hi;
        let position = self.position + self.velocity.max(1.0) * t + self.acceleration.max(1.0) * t * t * 0.5;
        let velocity = self.velocity + self.acceleration * t;
        position < 0.5 * R::LARGEST && velocity < 0.5 * R::LARGEST
    }
}

/// The largest magnitude of a component.
fn magnitude<R: Real>(x: [R; 3]) -> f64 {
    x.map(|x| x.abs().into()).into_iter().fold(0.0, f64::max)
}

/// The number of steps of at most `max_step`; a quotient within 10⁻⁹ of a whole number counts as that number.
fn steps_of_at_most(duration: f64, max_step: f64) -> u64 {
    let quotient = duration / max_step;
    let whole = quotient.round();
    let steps = if whole >= 1.0 && (quotient - whole).abs() <= 1e-9 * whole { whole } else { quotient.ceil().max(1.0) };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates; the limit is checked next")]
    let steps = steps as u64;
    steps
}

fn valid_max_step(max_step: f64) -> Result<f64, Error> {
    if !max_step.is_finite() {
        Err(Error::NotFinite(Field::MaxStep.whole()))
    } else if max_step <= 0.0 {
        Err(Error::MaxStepNotPositive)
    } else {
        Ok(max_step)
    }
}

fn check_len<T: Copy + PartialEq>(column: &Column<T>, field: Field, expected: usize) -> Result<(), Error> {
    match column.len_if_per_particle() {
        Some(len) if len != expected => Err(Error::LengthMismatch { field, len, expected }),
        Some(_) | None => Ok(()),
    }
}

fn check_each<T: Copy + PartialEq>(
    column: &Column<T>,
    field: Field,
    count: usize,
    check: impl Fn(T, Place) -> Result<(), Error>,
) -> Result<(), Error> {
    check_len(column, field, count)?;
    column.entries().try_for_each(|(index, value)| check(value, Place { field, index }))
}

fn check_finite<R: Real>(x: [R; 3], place: Place) -> Result<(), Error> {
    if x.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(Error::NotFinite(place)) }
}

fn vectors<R: Real, V: Copy + PartialEq + Into<[R; 3]>>(
    column: &Column<V>,
    field: Field,
    count: usize,
) -> Result<Column<[R; 3]>, Error> {
    check_each(column, field, count, |v, place| check_finite(v.into(), place))?;
    Ok(column.map(Into::into))
}

fn accelerations<R: Real, V: Copy + PartialEq + Into<[R; 3]>>(
    column: &Column<Option<V>>,
    count: usize,
) -> Result<Column<Option<[R; 3]>>, Error> {
    check_each(column, Field::Acceleration, count, |own, place| {
        own.map_or(Ok(()), |own| check_finite(own.into(), place))
    })?;
    Ok(column.map(|own| own.map(|own| own.into().map(positive_zero))))
}

fn dampings<R: Real>(column: &Column<R>, count: usize) -> Result<Column<R>, Error> {
    check_each(column, Field::Damping, count, |d, place| {
        if !d.is_finite() {
            Err(Error::NotFinite(place))
        } else if d < R::ZERO || d > R::ONE {
            Err(Error::DampingOutOfRange(place))
        } else {
            Ok(())
        }
    })?;
    Ok(column.map(positive_zero))
}

fn inverse_masses<R: Real>(column: &Column<Mass<R>>, count: usize) -> Result<Column<R>, Error> {
    check_each(column, Field::Mass, count, |mass, place| {
        let place = match mass {
            Mass::Mass(_) => place,
            Mass::Inverse(_) => Place { field: Field::InverseMass, ..place },
        };
        match mass {
            Mass::Mass(m) | Mass::Inverse(m) if !m.is_finite() => Err(Error::NotFinite(place)),
            Mass::Mass(m) if m <= R::ZERO => Err(Error::MassNotPositive(place)),
            Mass::Mass(m) if !(R::ONE / m).is_finite() => Err(Error::MassTooSmall(place)),
            Mass::Inverse(w) if w < R::ZERO => Err(Error::InverseMassNegative(place)),
            Mass::Mass(_) | Mass::Inverse(_) => Ok(()),
        }
    })?;
    Ok(column.map(|mass| match mass {
        Mass::Mass(m) => R::ONE / m,
        Mass::Inverse(w) => positive_zero(w),
    }))
}

/// Writes new values to some rows; one value for every particle makes the column uniform.
fn assign<T: Copy + PartialEq>(
    column: &mut Column<T>,
    values: Option<Column<T>>,
    rows: &[usize],
    every: bool,
    len: usize,
) {
    match values {
        None => {}
        Some(Column::Uniform(value)) if every => *column = Column::Uniform(value),
        Some(values) => rows.iter().enumerate().for_each(|(i, &row)| column.set(row, values.get(i), len)),
    }
}
