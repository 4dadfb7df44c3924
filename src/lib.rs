//! Worlds of point-mass particles, stepped to the bit.
//!
//! A particle is a point with a position, a velocity, an acceleration (its own, or the gravity of the world), a damping
//! and an inverse mass. Add forces, advance the world by a duration, read where everything is:
//!
//! ```
//! use pointmass::{DVec3, Particle, Settings, World};
//!
//! let mut world = World::<f64>::new(Settings { gravity: DVec3::new(0.0, -9.80665, 0.0), ..Settings::default() })?;
//! let ball = world.create(Particle { position: DVec3::new(0.0, 100.0, 0.0), damping: 0.9, ..Particle::default() })?;
//! world.set_mass(ball, 0.5)?;
//! world.add_force(ball, DVec3::new(2.0, 0.0, 0.0))?;
//! world.advance(1.0 / 60.0)?;
//! assert!(world.particle(ball)?.position.y < 100.0);
//! # Ok::<(), pointmass::Error>(())
//! ```
//!
//! The same commands in the same order give the same bits: on every CPU, and through the HTTP service of this crate
//! (feature `server`, on by default), whose worlds are these worlds. Units are SI by convention (metres, seconds,
//! kilograms, newtons), y points up, and nothing depends on either. The method is the particle engine of Ian
//! Millington, *Game Physics Engine Development*, chapter 3.
//!
//! # Code map
//!
//! [`World`] applies [`Command`]s; the methods of `World` are commands for one particle. `world` has a file for changes,
//! one for time, one for what changed since when, one for the digest (feature `digest`) and two for snapshots (feature
//! `snapshot`); `closed_form` has the exact integrator, `kernel` the stepped ones under constant accelerations, and
//! `system` those under forces that depend on the state. Columns, ids and the double-double clock have a file each, and
//! what copies of a world share. Everything under `server` speaks HTTP; nothing else does. ARCHITECTURE.md says why.

mod accumulators;
mod base_times;
mod closed_form;
mod column;
mod command;
mod double_double;
mod error;
mod filled;
mod forces;
mod ids;
mod integrator;
mod kernel;
mod particles;
mod prefetch;
mod real;
#[cfg(feature = "server")]
mod registry;
#[cfg(feature = "server")]
pub mod server;
mod shared;
mod system;
mod threads;
mod world;

pub use column::Column;
pub use command::{
    Advance, Advanced, Command, Configure, Mass, NewParticles, Outcome, Particle, Plane, Properties, Selection,
    Settings, StepError, Tolerance, Until, Values, gravity,
};
pub use error::{BatchError, Error, Field, Limit, Limits, Place, Quantity};
pub use forces::{Drag, Forces, Gravitation};
pub use glam::{DVec3, Vec3};
pub use ids::ParticleId;
pub use integrator::{DampingLaw, Integrator};
pub use real::{Precision, Real};
pub use threads::Threads;
#[cfg(feature = "digest")]
pub use world::Digest;
pub use world::{Changes, ParticleState, States, StepPlan, Trajectory, World};
#[cfg(feature = "snapshot")]
pub use world::{Snapshot, SnapshotError};

/// The Rust of README.md, run as a documentation test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeExamples;
