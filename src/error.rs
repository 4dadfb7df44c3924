//! Everything that the engine refuses.

use std::fmt;

use crate::ids::ParticleId;
use crate::integrator::{DampingLaw, Integrator};

/// Why a command was refused. A refused command changes nothing.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Infinite or not a number.
    #[error("{0} must be finite in the precision of the world")]
    NotFinite(Place),
    /// A mass of zero or less. An infinite one is said as inverse mass 0.
    #[error("{0} must be above 0; an immovable particle has inverse_mass 0")]
    MassNotPositive(Place),
    /// The inverse of the mass is not finite.
    #[error("{0} is so small that its inverse is not finite in the precision of the world")]
    MassTooSmall(Place),
    /// An inverse mass below zero.
    #[error("{0} must be at least 0; 0 is an immovable particle")]
    InverseMassNegative(Place),
    /// A damping outside 0 to 1.
    #[error("{0} must be between 0 and 1: the share of the velocity that is kept each second")]
    DampingOutOfRange(Place),
    /// A column with another number of values than there are particles.
    #[error("{field} has {len} values for {expected} particles; give one for each, or a single value for all")]
    LengthMismatch {
        /// Which column.
        field: Field,
        /// Its length.
        len: usize,
        /// The length it should have.
        expected: usize,
    },
    /// A duration of zero or less.
    #[error("duration must be above 0 seconds")]
    DurationNotPositive,
    /// A longest step of zero or less.
    #[error("max_step must be above 0 seconds")]
    MaxStepNotPositive,
    /// Zero steps.
    #[error("steps must be at least 1")]
    StepsNotPositive,
    /// Both ways to choose the steps.
    #[error("give steps or max_step, not both")]
    StepsAndMaxStep,
    /// A teleport without a place or a velocity.
    #[error("a place needs a position, a velocity or both")]
    NothingToPlace,
    /// The clock would pass 2⁴⁰⁰ seconds.
    #[error("the clock of the world would pass 2^400 seconds; advance by less")]
    ClockOutOfRange,
    /// The integrator cannot compute with the damping law.
    #[error(
        "the integrator {integrator} cannot serve the damping law {damping_law}; take an Euler integrator or per_second"
    )]
    IntegratorCannotServeDamping {
        /// The integrator.
        integrator: Integrator,
        /// The damping law.
        damping_law: DampingLaw,
    },
    /// The integrator cannot compute with a damping of 0.
    #[error(
        "the integrator {integrator} cannot serve a damping of 0, which stops a particle at once; take exact, velocity_verlet or an Euler integrator"
    )]
    IntegratorCannotServeZeroDamping {
        /// The integrator.
        integrator: Integrator,
        /// The value that asked for it; `None`: a particle has it already.
        place: Option<Place>,
    },
    /// The integrator cannot compute with forces that depend on position or velocity.
    #[error(
        "the integrator {integrator} cannot serve drag or gravitation; take velocity_verlet, rk4, dop853 or an Euler integrator"
    )]
    IntegratorCannotServeForces {
        /// The integrator.
        integrator: Integrator,
    },
    /// An adaptive integrator chooses its steps itself.
    #[error(
        "the integrator {integrator} chooses its steps by the tolerance of the world; leave steps out, or give max_step"
    )]
    IntegratorTakesNoSteps {
        /// The integrator.
        integrator: Integrator,
    },
    /// An adaptive integrator did not arrive with as many steps as are allowed.
    #[error(
        "{integrator} came {reached} s of {duration} s far with {steps} steps, the most allowed; advance by less, or give a larger tolerance or softening"
    )]
    TooManySteps {
        /// The integrator.
        integrator: Integrator,
        /// Steps that it took, and took back.
        steps: u64,
        /// How far it came, in seconds.
        reached: f64,
        /// How far it should, in seconds.
        duration: f64,
    },
    /// A constant, a coefficient or a mass below zero.
    #[error("{0} must be at least 0")]
    Negative(Place),
    /// A tolerance that no step can meet.
    #[error("the tolerance must have an absolute or a relative part above 0")]
    ToleranceZero,
    /// A plane without a direction.
    #[error("the normal of the plane must not be 0")]
    PlaneWithoutNormal,
    /// A trajectory that has no way.
    #[error("samples must be at least 2: the first and the last moment")]
    TooFewSamples,
    /// No such particle.
    #[error("there is no particle {id} in this world")]
    UnknownParticle {
        /// The id asked for.
        id: ParticleId,
        /// Its place in the list of ids.
        index: usize,
    },
    /// A particle that should be removed twice.
    #[error("particle {id} is named twice; a particle can be removed once")]
    RemovedTwice {
        /// The id.
        id: ParticleId,
        /// The place of the second one in the list of ids.
        index: usize,
    },
    /// The sum of forces, or the velocity after an impulse, would not be finite.
    #[error("the {quantity} of particle {particle} would not be finite; {place} is too large for it")]
    Overflow {
        /// Which particle.
        particle: ParticleId,
        /// What of it.
        quantity: Quantity,
        /// The value that was too much.
        place: Place,
    },
    /// An advance would make a number non-finite.
    #[error(
        "the {quantity} of particle {particle} would not be finite at step {step}; advance by less, or place it anew"
    )]
    Diverged {
        /// The smallest id of such a particle.
        particle: ParticleId,
        /// The first of its numbers that is not finite, position before velocity.
        quantity: Quantity,
        /// The first step, from 1, after which it is not.
        step: u64,
    },
    /// More than one of the [`Limits`] allows.
    #[error("{asked} {limit} are more than the limit of {allowed}")]
    LimitReached {
        /// Which limit.
        limit: Limit,
        /// The most that is allowed.
        allowed: u64,
        /// What the command asked for; at most `u64::MAX`.
        asked: u64,
    },
    /// The caller cancelled the advance.
    #[error("the advance was cancelled; the world is as it was")]
    Cancelled,
}

/// Which of several commands was refused, and why.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("command {index}, from 0: {error}")]
pub struct BatchError {
    /// Its place among them.
    pub index: usize,
    /// Why.
    pub error: Error,
}

/// A value in a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Which property.
    pub field: Field,
    /// Which entry of its list; `None` when one value stands for all.
    pub index: Option<usize>,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.index {
            None => write!(f, "{}", self.field),
            Some(index) => write!(f, "{} (entry {index}, from 0)", self.field),
        }
    }
}

/// The name of a value in a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is the field of that name in Command, Advance or Settings")]
pub enum Field {
    Position,
    Velocity,
    Acceleration,
    Damping,
    Mass,
    InverseMass,
    Force,
    Impulse,
    Gravity,
    MaxStep,
    Duration,
    Drag,
    K1,
    K2,
    GravitationalMass,
    Constant,
    Softening,
    Absolute,
    Relative,
    Normal,
    Offset,
}

impl Field {
    /// The name in JSON, for example `inverse_mass`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::Damping => "damping",
            Self::Mass => "mass",
            Self::InverseMass => "inverse_mass",
            Self::Force => "force",
            Self::Impulse => "impulse",
            Self::Gravity => "gravity",
            Self::MaxStep => "max_step",
            Self::Duration => "duration",
            Self::Drag => "drag",
            Self::K1 => "k1",
            Self::K2 => "k2",
            Self::GravitationalMass => "gravitational_mass",
            Self::Constant => "constant",
            Self::Softening => "softening",
            Self::Absolute => "absolute",
            Self::Relative => "relative",
            Self::Normal => "normal",
            Self::Offset => "offset",
        }
    }

    pub(crate) const fn whole(self) -> Place {
        Place { field: self, index: None }
    }
}

impl fmt::Display for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A number of a particle that an operation could make infinite.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// In metres.
    Position,
    /// In metres per second.
    Velocity,
    /// The force accumulator, in newtons.
    Force,
}

impl Quantity {
    /// `position`, `velocity` or `force`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Force => "force",
        }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What a world may hold and what one advance of it may cost. No limits by default.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// The most particles; at most 2³² - 1.
    pub particles: u64,
    /// The most steps of one advance; at most 2⁵³, beyond which their length would not be what it says.
    pub steps: u64,
    /// The most steps × particles of one advance.
    pub particle_steps: u64,
    /// The most interactions of one advance: pairs of an attracting and an attracted particle × evaluations.
    pub interactions: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { particles: crate::ids::Ids::LEN_MAX, steps: 1 << 53, particle_steps: u64::MAX, interactions: u64::MAX }
    }
}

/// One of the [`Limits`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limit {
    /// [`Limits::particles`].
    Particles,
    /// [`Limits::steps`].
    Steps,
    /// [`Limits::particle_steps`].
    ParticleSteps,
    /// [`Limits::interactions`].
    Interactions,
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Particles => "particles in a world",
            Self::Steps => "steps in one advance",
            Self::ParticleSteps => "steps x particles in one advance",
            Self::Interactions => "interactions of particles in one advance",
        })
    }
}
