//! Time: the plan of an advance, and how it is carried out.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::column::Column;
use crate::command::{Advance, Advanced};
use crate::double_double::DoubleDouble;
use crate::error::{Error, Field, Limit, Quantity};
use crate::ids::ParticleId;
use crate::integrator::Integrator;
use crate::kernel::{self, Step};
use crate::particles::zero;
use crate::real::Real;
use crate::world::bounds::Bounds;
use crate::world::change::valid_max_step;
use crate::world::drive::{BLOCK, Scratch};
use crate::world::{LastForm, NEVER_CANCELLED, World, flowed};

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

/// Steps of a block between two looks at whether the advance is cancelled: a tenth of a millisecond. A whole number of
/// times the steps between two rests, so that slices of an advance rest where the whole does.
const STEPS_BETWEEN_LOOKS: u64 = 16 * kernel::STEPS_BETWEEN_RESTS;

/// A row of a block with the position and velocity that it keeps.
type Resting<R> = (usize, [R; 3], [R; 3]);

impl<R: Real> World<R> {
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

    pub(super) fn advance_all(&mut self, advance: &Advance, cancelled: &AtomicBool) -> Result<Advanced, Error> {
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
        let mut scratch = std::mem::take(&mut self.scratch);
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
        self.scratch = scratch;
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
        let mut scratch = Scratch::default();
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

/// The number of steps of at most `max_step`; a quotient within 10⁻⁹ of a whole number counts as that number.
fn steps_of_at_most(duration: f64, max_step: f64) -> u64 {
    let quotient = duration / max_step;
    let whole = quotient.round();
    let steps = if whole >= 1.0 && (quotient - whole).abs() <= 1e-9 * whole { whole } else { quotient.ceil().max(1.0) };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates; the limit is checked next")]
    let steps = steps as u64;
    steps
}
