//! Where a particle will be, without moving it.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::closed_form::Decay;
use crate::command::Advance;
use crate::double_double::DoubleDouble;
use crate::error::Error;
use crate::ids::ParticleId;
use crate::integrator::Integrator;
use crate::kernel;
use crate::real::Real;
use crate::shared::Shared;
use crate::world::World;
use crate::world::advance::CLOCK_MAX;
use crate::world::bounds::Bounds;

/// The way of a particle.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory<R: Real = f64> {
    /// Clocks in seconds, from now on.
    pub time: Vec<f64>,
    /// Where it is then, in metres.
    pub position: Vec<[R; 3]>,
    /// How fast, in m/s.
    pub velocity: Vec<[R; 3]>,
}

impl<R: Real> World<R> {
    /// Where a particle will be at `samples` moments, from now until `duration` seconds later, when nothing more is done to
    /// the world. The forces added so far act all the time. Under a stepped integrator the time from one sample to the next
    /// is an advance, in the steps that the world prescribes.
    ///
    /// ```
    /// use pointmass::{DVec3, Particle, Settings, World};
    /// let mut world = World::<f64>::new(Settings { gravity: DVec3::new(0.0, -10.0, 0.0), ..Settings::default() })?;
    /// let ball = world.create(Particle { velocity: DVec3::new(3.0, 20.0, 0.0), ..Particle::default() })?;
    /// let way = world.trajectory(ball, 4.0, 5)?;
    /// assert_eq!(way.time, [0.0, 1.0, 2.0, 3.0, 4.0]);
    /// assert_eq!(way.position[2], [6.0, 20.0, 0.0]);
    /// # Ok::<(), pointmass::Error>(())
    /// ```
    ///
    /// # Errors
    /// Unknown particle; fewer than 2 samples; as [`World::advance`].
    pub fn trajectory(&self, id: ParticleId, duration: f64, samples: usize) -> Result<Trajectory<R>, Error> {
        self.trajectory_unless(id, duration, samples, &super::NEVER_CANCELLED)
    }

    /// The same, given up as soon as `cancelled` is seen to be true.
    ///
    /// # Errors
    /// As [`World::trajectory`], and [`Error::Cancelled`].
    pub fn trajectory_unless(
        &self,
        id: ParticleId,
        duration: f64,
        samples: usize,
        cancelled: &AtomicBool,
    ) -> Result<Trajectory<R>, Error> {
        R::world_trajectory(self, id, duration, samples, cancelled)
    }

    pub(super) fn way_of(
        &self,
        id: ParticleId,
        duration: f64,
        samples: usize,
        cancelled: &AtomicBool,
    ) -> Result<Trajectory<R>, Error> {
        let row = self.ids.row(id).ok_or(Error::UnknownParticle { id, index: 0 })?;
        if samples < 2 {
            return Err(Error::TooFewSamples);
        }
        self.plan(&Advance::by(duration))?;
        if (self.clock + DoubleDouble::from(duration)).hi > CLOCK_MAX {
            return Err(Error::ClockOutOfRange);
        }
        #[expect(clippy::cast_precision_loss, reason = "a count of samples is a small number")]
        let moment = |sample: usize| duration * (sample as f64 / (samples - 1) as f64);
        let (position, velocity) = self.now(row);
        let mut way = Trajectory { time: vec![self.time()], position: vec![position], velocity: vec![velocity] };
        let mut push = |time: DoubleDouble, (p, v): ([R; 3], [R; 3])| {
            way.time.push(time.hi);
            way.position.push(p);
            way.velocity.push(v);
        };
        if self.settings.integrator == Integrator::Exact {
            for sample in 1..samples {
                let clock = self.clock + DoubleDouble::from(moment(sample));
                let (p, v) = self.state_at(row, moment(sample));
                if let Some(quantity) = kernel::non_finite(&p, &v) {
                    return Err(Error::Diverged { particle: id, quantity, step: 1 });
                }
                push(clock, (p, v));
            }
            return Ok(way);
        }
        // Under `dop853` all take the same steps.
        let alone = self.moves_alone();
        let mut future = if alone { self.alone(row) } else { self.clone() };
        let row = if alone { 0 } else { row };
        let forces = future.particles.force.clone();
        for sample in 1..samples {
            if cancelled.load(Ordering::Relaxed) {
                return Err(Error::Cancelled);
            }
            future.particles.force = forces.clone();
            future.bounds.force = self.bounds.force;
            let advance = Advance::by(moment(sample) - moment(sample - 1));
            let done = future.advance_all(&advance, cancelled).map_err(|error| {
                // A particle by itself has another id.
                if let (Error::Diverged { quantity, step, .. }, true) = (error, alone) {
                    Error::Diverged { particle: id, quantity, step }
                } else {
                    error
                }
            })?;
            // What one advance may cost, all of them may.
            future.spend(done.steps + done.rejected_steps, done.evaluations);
            push(future.clock, (future.particles.position[row], future.particles.velocity[row]));
        }
        Ok(way)
    }

    /// What a trajectory costs, in the units of [`World::work`].
    #[must_use]
    pub fn trajectory_work(&self, duration: f64, samples: usize) -> u64 {
        let samples = samples as u64;
        if self.settings.integrator == Integrator::Exact {
            return 16 * samples;
        }
        #[expect(clippy::cast_precision_loss, reason = "an estimate")]
        let each = self.work(&Advance::by(duration / samples as f64));
        let particles = self.particles.len() as u64;
        let share = if self.moves_alone() { particles.max(1) } else { 1 };
        samples.saturating_mul(64 + each / share)
    }

    /// Whether others change nothing about the steps of a particle.
    fn moves_alone(&self) -> bool {
        self.settings.forces.gravitation.is_none() && self.settings.integrator != Integrator::Dop853
    }

    /// Position and velocity of one row, a time after the clock, with the force that acts on it.
    fn state_at(&self, row: usize, time: f64) -> ([R; 3], [R; 3]) {
        let particles = &self.particles;
        let decay = Decay::of(particles.damping.get(row));
        if particles.is_resting(row) && !particles.is_forced(row) {
            return (particles.position[row], particles.velocity[row]);
        }
        let forced = particles.is_forced(row);
        let (mut p, mut v) = if forced { self.now(row) } else { (particles.position[row], particles.velocity[row]) };
        let clock = self.clock + DoubleDouble::from(time);
        let elapsed = if forced { time } else { (clock - particles.base_time.get(row)).hi };
        let acceleration = if forced { self.driving(row) } else { self.acceleration(row) };
        decay.over(elapsed).carry(self.level, acceleration, &mut p, &mut v);
        (p, v)
    }

    /// The same world with one of its particles.
    fn alone(&self, row: usize) -> Self {
        let mut alone = Self { limits: self.limits, ..Self::new(self.settings).expect("they are in force here") };
        alone.clock = self.clock;
        alone.particles = Shared::new(self.particles.alone(row, self.clock, self.settings.compensated));
        alone.ids.create(1);
        alone.bounds = Bounds::of(&alone.particles, alone.gravity());
        alone
    }
}
