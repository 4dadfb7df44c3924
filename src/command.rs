//! What can be asked of a world: every change is one [`Command`].

use crate::column::Column;
use crate::forces::{Drag, Forces, Gravitation};
use crate::ids::ParticleId;
use crate::integrator::{DampingLaw, Integrator};
use crate::real::Real;

/// One change to a world, applied by [`World::apply`](crate::World::apply) as a whole or not at all.
///
/// Every kind speaks of many particles; the methods of [`World`](crate::World) are the same commands for one.
/// A [`Column`] gives one value for all of them or one for each, in the order of the ids.
///
/// ```
/// use pointmass::{Column, Command, DVec3, NewParticles, ParticleId, Selection, World};
/// let mut world = World::<f64>::default();
/// world.apply(&Command::Create(NewParticles { count: 3, ..Default::default() }))?;
/// world.apply(&Command::AddForce {
///     ids: Selection::Ids(vec![ParticleId(0), ParticleId(2)]),
///     force: Column::Uniform(DVec3::X),
/// })?;
/// assert_eq!(world.particle(ParticleId(2))?.force, DVec3::X);
/// # Ok::<(), pointmass::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum Command<R: Real> {
    /// Adds particles; their ids count up.
    Create(NewParticles<R>),
    /// Teleports: sets position (m), velocity (m/s) or both.
    Place {
        /// Which particles.
        ids: Selection,
        /// Where to, in metres; absent: the position of now.
        position: Option<Column<R::Vec3>>,
        /// The velocity from now on, in m/s; absent: the velocity of now.
        velocity: Option<Column<R::Vec3>>,
    },
    /// Sets properties; an absent one stays.
    Set {
        /// Which particles.
        ids: Selection,
        /// Their new properties.
        properties: Properties<R>,
    },
    /// Adds to the force accumulators, in newtons. The sum acts through the next advance and is then cleared.
    AddForce {
        /// Which particles; one named twice gets both.
        ids: Selection,
        /// The force in newtons.
        force: Column<R::Vec3>,
    },
    /// Changes velocities at once: v += J w, with the impulse J in newton seconds and the inverse mass w.
    Impulse {
        /// Which particles; one named twice gets both.
        ids: Selection,
        /// The impulse in newton seconds.
        impulse: Column<R::Vec3>,
    },
    /// Removes particles; their ids are never used again.
    Remove {
        /// Which particles.
        ids: Selection,
    },
    /// Moves the world forward in time.
    Advance(Advance),
    /// Changes settings of the world.
    Configure(Configure<R>),
}

/// New properties of particles; an absent one stays as it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Properties<R: Real = f64> {
    /// Own acceleration in m/s²; `None`: the gravity of the world.
    pub acceleration: Option<Column<Option<R::Vec3>>>,
    /// Damping, 0 to 1.
    pub damping: Option<Column<R>>,
    /// Mass or inverse mass.
    pub mass: Option<Column<Mass<R>>>,
    /// Its own drag; `None`: that of the world.
    pub drag: Option<Column<Option<Drag<R>>>>,
    /// The mass in kilograms with which it attracts others; `None`: its mass, and 0 if it is immovable.
    pub gravitational_mass: Option<Column<Option<R>>>,
}

impl<R: Real> Default for Properties<R> {
    fn default() -> Self {
        Self { acceleration: None, damping: None, mass: None, drag: None, gravitational_mass: None }
    }
}

/// The particles a command speaks of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Selection {
    /// Every particle, in ascending order of id.
    All,
    /// These, in this order.
    Ids(Vec<ParticleId>),
}

impl From<ParticleId> for Selection {
    fn from(id: ParticleId) -> Self {
        Self::Ids(vec![id])
    }
}

/// A particle to create.
///
/// ```
/// use pointmass::{DVec3, Mass, Particle};
/// let anvil = Particle { position: DVec3::new(0.0, 10.0, 0.0), mass: Mass::Mass(50.0), ..Particle::default() };
/// assert_eq!(anvil.damping, 1.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Particle<R: Real = f64> {
    /// Metres. Default 0.
    pub position: R::Vec3,
    /// Metres per second. Default 0.
    pub velocity: R::Vec3,
    /// Own acceleration in m/s². Default `None`: the gravity of the world, and zero for an immovable particle.
    pub acceleration: Option<R::Vec3>,
    /// The share of the velocity kept each second, 0 to 1. Default 1: all of it.
    pub damping: R,
    /// Default: 1 kg.
    pub mass: Mass<R>,
    /// Its own drag, where the world has drag at all. Default `None`: that of the world.
    pub drag: Option<Drag<R>>,
    /// The mass in kilograms with which it attracts others, where the world has gravitation; at least 0. Default `None`: its
    /// mass, and 0 for an immovable particle.
    pub gravitational_mass: Option<R>,
}

impl<R: Real> Default for Particle<R> {
    fn default() -> Self {
        Self {
            position: R::Vec3::default(),
            velocity: R::Vec3::default(),
            acceleration: None,
            damping: R::ONE,
            mass: Mass::Inverse(R::ONE),
            drag: None,
            gravitational_mass: None,
        }
    }
}

/// A mass, said in one of two ways. The engine keeps 1/m.
///
/// ```
/// use pointmass::{Mass, Particle};
/// let platform = Particle { mass: Mass::IMMOVABLE, ..Particle::<f64>::default() };
/// assert_eq!(platform.mass, Mass::Inverse(0.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mass<R> {
    /// m in kilograms: finite, above 0, with a finite inverse.
    Mass(R),
    /// 1/m in 1/kg: finite, at least 0; 0 is an immovable particle (Millington, chapter 3, "Mass").
    Inverse(R),
}

impl<R: Real> Mass<R> {
    /// Infinite mass: no force and no gravity moves such a particle.
    pub const IMMOVABLE: Self = Self::Inverse(R::ZERO);
}

/// Particles to create, as columns.
#[derive(Debug, Clone, PartialEq)]
pub struct NewParticles<R: Real = f64> {
    /// How many; per-particle columns have this length.
    pub count: usize,
    /// See [`Particle`], which has the same defaults.
    pub position: Column<R::Vec3>,
    /// See [`Particle`].
    pub velocity: Column<R::Vec3>,
    /// See [`Particle`].
    pub acceleration: Column<Option<R::Vec3>>,
    /// See [`Particle`].
    pub damping: Column<R>,
    /// See [`Particle`].
    pub mass: Column<Mass<R>>,
    /// See [`Particle`].
    pub drag: Column<Option<Drag<R>>>,
    /// See [`Particle`].
    pub gravitational_mass: Column<Option<R>>,
}

impl<R: Real> Default for NewParticles<R> {
    fn default() -> Self {
        Self { count: 0, ..Particle::default().into() }
    }
}

impl<R: Real> From<Particle<R>> for NewParticles<R> {
    fn from(particle: Particle<R>) -> Self {
        Self {
            count: 1,
            position: Column::Uniform(particle.position),
            velocity: Column::Uniform(particle.velocity),
            acceleration: Column::Uniform(particle.acceleration),
            damping: Column::Uniform(particle.damping),
            mass: Column::Uniform(particle.mass),
            drag: Column::Uniform(particle.drag),
            gravitational_mass: Column::Uniform(particle.gravitational_mass),
        }
    }
}

impl<R: Real> NewParticles<R> {
    /// One more.
    pub(crate) fn push(&mut self, particle: Particle<R>) {
        // A zero keeps its sign in position and velocity, and nowhere else.
        let same = |a: &R::Vec3, b: &R::Vec3| {
            let (a, b): ([R; 3], [R; 3]) = ((*a).into(), (*b).into());
            a.iter().zip(b).all(|(a, b)| *a == b && R::ONE / *a == R::ONE / b)
        };
        let len = self.count;
        self.position.push(len, particle.position, same);
        self.velocity.push(len, particle.velocity, same);
        self.acceleration.push(len, particle.acceleration, PartialEq::eq);
        self.damping.push(len, particle.damping, PartialEq::eq);
        self.mass.push(len, particle.mass, PartialEq::eq);
        self.drag.push(len, particle.drag, PartialEq::eq);
        self.gravitational_mass.push(len, particle.gravitational_mass, PartialEq::eq);
        self.count += 1;
    }
}

impl<R: Real> FromIterator<Particle<R>> for NewParticles<R> {
    fn from_iter<I: IntoIterator<Item = Particle<R>>>(particles: I) -> Self {
        let mut new = Self::default();
        particles.into_iter().for_each(|particle| new.push(particle));
        new
    }
}

/// How far to advance, and in which steps.
///
/// ```
/// use pointmass::{Advance, World};
/// let mut world = World::<f64>::default();
/// let report = world.advance(Advance { max_step: Some(0.01), ..Advance::by(0.1) })?;
/// assert_eq!(report.time, 0.1);
/// # Ok::<(), pointmass::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Advance {
    /// Seconds, finite and above 0.
    pub duration: f64,
    /// The number of steps, at least 1. Not together with `max_step`.
    pub steps: Option<u64>,
    /// The longest step in seconds, finite and above 0. Absent, and no `steps`: that of the world; without one, the
    /// whole duration is one step.
    pub max_step: Option<f64>,
    /// Whether to report how far the steps are from the closed form. Default: no.
    pub report_error: bool,
    /// Where to stop earlier. Default: nowhere.
    pub until: Option<Until>,
}

impl Advance {
    /// By this many seconds, in the steps that the world prescribes.
    #[must_use]
    pub const fn by(duration: f64) -> Self {
        Self { duration, steps: None, max_step: None, report_error: false, until: None }
    }
}

/// An advance stops at the moment when a particle reaches a plane.
///
/// ```
/// use pointmass::{Advance, DVec3, Particle, Plane, Settings, Until, World};
/// let mut world = World::<f64>::new(Settings { gravity: DVec3::new(0.0, -10.0, 0.0), ..Settings::default() })?;
/// let ball = world.create(Particle { position: DVec3::new(0.0, 20.0, 0.0), ..Particle::default() })?;
/// let ground = Plane { normal: [0.0, 1.0, 0.0], offset: 0.0 };
/// let until = Some(Until { particle: ball, plane: ground });
/// let report = world.advance(Advance { until, ..Advance::by(60.0) })?;
/// assert_eq!((report.crossed, report.time), (Some(true), 2.0));
/// # Ok::<(), pointmass::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Until {
    /// Which particle.
    pub particle: ParticleId,
    /// Which plane.
    pub plane: Plane,
}

/// The points x with n · x = c.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// n, finite and not 0; of any length.
    pub normal: [f64; 3],
    /// c, finite: the distance from the origin in metres, times the length of n.
    pub offset: f64,
}

impl From<f64> for Advance {
    fn from(duration: f64) -> Self {
        Self::by(duration)
    }
}

/// The settings of a world.
///
/// ```
/// use pointmass::{DVec3, Integrator, Settings, World};
/// let settings = Settings { gravity: DVec3::NEG_Y * 9.80665, integrator: Integrator::NewtonEuler, ..Settings::default() };
/// let world = World::<f64>::new(settings)?;
/// # Ok::<(), pointmass::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings<R: Real = f64> {
    /// Default [`Integrator::Exact`].
    pub integrator: Integrator,
    /// The acceleration, in m/s², of every movable particle that has none of its own. Default 0.
    pub gravity: R::Vec3,
    /// Default [`DampingLaw::PerSecond`].
    pub damping_law: DampingLaw,
    /// The longest step in seconds of an advance that names neither `steps` nor `max_step`; finite, above 0.
    /// Default `None`: such an advance is one step.
    pub max_step: Option<f64>,
    /// Default: none.
    pub forces: Forces<R>,
    /// What [`Integrator::Dop853`] chooses its steps for.
    pub tolerance: Tolerance,
    /// Whether steps keep what rounding takes from position and velocity, and add it later: under
    /// [`Integrator::VelocityVerlet`], [`Integrator::Rk4`] and [`Integrator::Dop853`]. Default: no.
    pub compensated: bool,
}

/// The error that an adaptive integrator may make in one step, for each particle: for the position absolute + relative × its
/// distance from the origin, and the same for the velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// In metres, and in m/s; finite, at least 0. Default 1e-9.
    pub absolute: f64,
    /// Finite, at least 0; not both 0. Default 1e-9.
    pub relative: f64,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self { absolute: 1e-9, relative: 1e-9 }
    }
}

impl<R: Real> Default for Settings<R> {
    fn default() -> Self {
        Self {
            integrator: Integrator::default(),
            gravity: R::Vec3::default(),
            damping_law: DampingLaw::default(),
            max_step: None,
            forces: Forces::default(),
            tolerance: Tolerance::default(),
            compensated: false,
        }
    }
}

/// New values for some settings; an absent one stays. Under `exact` naming gravity or the integrator rebases, even
/// with an equal value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configure<R: Real = f64> {
    /// See [`Settings`].
    pub integrator: Option<Integrator>,
    /// See [`Settings`].
    pub gravity: Option<R::Vec3>,
    /// See [`Settings`].
    pub damping_law: Option<DampingLaw>,
    /// See [`Settings`]; `Some(None)` takes the longest step away.
    pub max_step: Option<Option<f64>>,
    /// See [`Forces`]; `Some(None)` switches it off.
    pub drag: Option<Option<Drag<R>>>,
    /// See [`Forces`]; `Some(None)` switches it off.
    pub gravitation: Option<Option<Gravitation<R>>>,
    /// See [`Settings`].
    pub tolerance: Option<Tolerance>,
    /// See [`Settings`].
    pub compensated: Option<bool>,
}

impl<R: Real> Default for Configure<R> {
    fn default() -> Self {
        Self {
            integrator: None,
            gravity: None,
            damping_law: None,
            max_step: None,
            drag: None,
            gravitation: None,
            tolerance: None,
            compensated: None,
        }
    }
}

/// Gravities by name, all along -y: presets of the book (chapter 3, "Gravity") and the standard one.
pub mod gravity {
    use crate::real::Real;

    /// Names and magnitudes in m/s².
    pub const PRESETS: [(&str, f64); 4] =
        [("standard", 9.80665), ("textbook", 10.0), ("shooter", 15.0), ("driving", 20.0)];

    /// The gravity of that name.
    ///
    /// ```
    /// assert_eq!(pointmass::gravity::preset::<f64>("textbook"), Some(pointmass::DVec3::new(0.0, -10.0, 0.0)));
    /// ```
    #[must_use]
    pub fn preset<R: Real>(name: &str) -> Option<R::Vec3> {
        let (_, magnitude) = PRESETS.into_iter().find(|(preset, _)| *preset == name)?;
        Some([R::ZERO, R::nearest(-magnitude), R::ZERO].into())
    }
}

/// What a command did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// `count` particles with ids from `first` up.
    Created {
        /// The id of the first one (the next one, when the count is 0).
        first: ParticleId,
        /// How many.
        count: usize,
    },
    /// The command spoke of this many particles.
    Changed {
        /// How many.
        count: usize,
    },
    /// What an advance did.
    Advanced(Advanced),
    /// The settings are changed.
    Configured,
}

/// What an advance did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Advanced {
    /// The clock of the world afterwards, in seconds.
    pub time: f64,
    /// The duration in seconds, as asked, or until the plane was reached.
    pub duration: f64,
    /// The number of steps.
    pub steps: u64,
    /// The length of one step in seconds; of an adaptive integrator the mean.
    pub step: f64,
    /// Steps that an adaptive integrator took back because their error was above the tolerance.
    pub rejected_steps: u64,
    /// How often the accelerations of all particles were computed; 0 where they are constant.
    pub evaluations: u64,
    /// All steps of this world so far.
    pub step_count: u64,
    /// Particles moved now.
    pub integrated: usize,
    /// Particles whose motion is evaluated when they are read.
    pub deferred: usize,
    /// Particles that nothing can move: immovable, without velocity or acceleration.
    pub skipped: usize,
    /// Accelerations, with the share of the forces, that moved the particles that are integrated.
    pub accelerations: Values,
    /// Damping factors that they took.
    pub dampings: Values,
    /// Particles that were looked at to be sure that every number stays finite; 0 when bounds on all of them told.
    pub inspected: usize,
    /// How far the steps ended from the closed form, where that was asked for and there is one.
    pub error: Option<StepError>,
    /// Whether the particle reached the plane, where one was given.
    pub crossed: Option<bool>,
}

/// The largest distance, of any particle, between where the steps of an advance ended and the closed form from the same start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepError {
    /// In metres.
    pub position: f64,
    /// In m/s.
    pub velocity: f64,
}

/// How many values of a property an advance used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Values {
    /// None: it has no effect.
    None,
    /// The same for all.
    One,
    /// One for each particle.
    Each,
}
