//! Time: the plan of an advance, and how it is carried out.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::accumulators::Acting;
use crate::column::Column;
use crate::command::{Advance, Advanced, Settings, StepError, Until, Values};
use crate::double_double::DoubleDouble;
use crate::error::{Error, Field, Limit, Quantity};
use crate::ids::ParticleId;
use crate::integrator::{DampingLaw, Integrator};
use crate::kernel::{self, Step};
use crate::particles::zero;
use crate::prefetch;
use crate::real::Real;
use crate::system::norm;
use crate::world::bounds::Bounds;
use crate::world::change::valid_max_step;
use crate::world::drive::{Driver, Scratch};
use crate::world::motion::{self, Carrier, Rows, Span};
use crate::world::{NEVER_CANCELLED, World};

/// The steps of an advance, decided before it begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepPlan {
    /// Seconds.
    pub duration: f64,
    /// How many steps; 1 under [`Integrator::Exact`], and under [`Integrator::Dop853`], which finds out on the way.
    pub steps: u64,
    /// The length of one in seconds.
    pub step: f64,
}

/// Clocks stay below 2⁴⁰⁰ s, so that the square of a time is finite.
pub(super) const CLOCK_MAX: f64 = f64::from_bits((1023 + 400) << 52);

/// Particle-steps between two looks at whether an advance is cancelled: some milliseconds. Whoever shares the threads has
/// its turn as often.
const ROUND_WORK: u64 = 1 << 24;

/// Particle-steps of an advance that is done in place, without a copy to go back to, where bounds prove that it ends well:
/// up to half a second on one core with AVX-512. The copy took longer than sixty steps.
const WORK_IN_PLACE: u64 = 1 << 30;

/// The most steps of a round: a whole number of times the steps between two rests, so that an advance in rounds rests
/// where the whole does.
const ROUND_STEPS: u64 = 16 * kernel::STEPS_BETWEEN_RESTS;

/// What an advance did, before the clock has moved.
#[derive(Debug, Clone, Copy)]
pub(super) struct Done {
    pub(super) duration: f64,
    pub(super) steps: u64,
    pub(super) step: f64,
    pub(super) rejected_steps: u64,
    pub(super) evaluations: u64,
    pub(super) integrated: usize,
    pub(super) inspected: usize,
    pub(super) crossed: Option<bool>,
}

impl Done {
    /// All steps of the plan.
    pub(super) fn planned(plan: StepPlan) -> Self {
        let StepPlan { duration, steps, step } = plan;
        Self { duration, steps, step, rejected_steps: 0, evaluations: 0, integrated: 0, inspected: 0, crossed: None }
    }
}

impl<R: Real> World<R> {
    /// The steps that an advance would take.
    ///
    /// # Errors
    /// As [`World::advance`], for what can be told from the duration and the steps alone.
    pub fn plan(&self, advance: &Advance) -> Result<StepPlan, Error> {
        let Advance { duration, steps, max_step, .. } = *advance;
        let Settings { integrator, .. } = self.settings;
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
            Some(_) if integrator == Integrator::Dop853 => return Err(Error::IntegratorTakesNoSteps { integrator }),
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
        let steps = if matches!(integrator, Integrator::Exact | Integrator::Dop853) { 1 } else { asked };
        let particle_steps = steps.saturating_mul(self.particles.len() as u64);
        within(Limit::ParticleSteps, self.limits.particle_steps, particle_steps)?;
        within(Limit::Interactions, self.limits.interactions, self.interactions(steps))?;
        #[expect(clippy::cast_precision_loss, reason = "a step count is a small number")]
        let step = duration / steps as f64;
        if integrator != Integrator::Exact && !R::nearest(step).is_finite() {
            return Err(Error::NotFinite(Field::Duration.whole()));
        }
        if let Some(until) = &advance.until {
            self.check_until(until)?;
        }
        Ok(StepPlan { duration, steps, step })
    }

    /// About what an advance costs, in particles to move or to look at, times steps; 0 when it only moves the clock, or
    /// is refused at once.
    #[must_use]
    pub fn work(&self, advance: &Advance) -> u64 {
        self.work_with(advance, 0)
    }

    /// The same with so many more particles, all of which attract.
    pub(crate) fn work_with(&self, advance: &Advance, more: u64) -> u64 {
        let particles = (self.particles.len() as u64).saturating_add(more);
        match self.plan(advance) {
            Err(_) => 0,
            Ok(plan) if self.settings.integrator != Integrator::Exact => {
                let evaluations = self.settings.integrator.evaluations() * plan.steps;
                let pairs = match self.settings.forces.gravitation {
                    Some(_) if more > 0 => particles.saturating_mul(particles),
                    Some(_) | None => self.pairs(),
                };
                particles.saturating_add(pairs).saturating_mul(evaluations)
            }
            Ok(plan) => {
                let clock = self.clock + DoubleDouble::from(plan.duration);
                if more == 0 && self.bounds.hold_until::<R>(clock) {
                    match self.particles.force.acting() {
                        Acting::Few(few) => few.len() as u64,
                        Acting::Many(_) => particles,
                    }
                } else {
                    particles
                }
            }
        }
    }

    pub(super) fn advance_all(&mut self, advance: &Advance, cancelled: &AtomicBool) -> Result<Advanced, Error> {
        let plan = self.plan(advance)?;
        if cancelled.load(Ordering::Relaxed) {
            return Err(Error::Cancelled);
        }
        let clock = self.clock + DoubleDouble::from(plan.duration);
        if clock.hi > CLOCK_MAX {
            return Err(Error::ClockOutOfRange);
        }
        let resting = self.particles.resting_count();
        let (accelerations, dampings) = (self.accelerations_used(), self.dampings_used());
        let Settings { integrator, forces, .. } = self.settings;
        let exact = integrator == Integrator::Exact;
        let before = (advance.report_error && self.has_closed_form() && !exact)
            .then(|| (self.particles.position.clone(), self.particles.velocity.clone()));
        let done = if exact {
            self.flow_until(plan, advance.until, cancelled)?
        } else if integrator.is_euler() && !forces.any() && advance.until.is_none() {
            let moved = self.about_to_move();
            let inspected = self.step(plan, cancelled)?;
            self.note_moved(moved);
            Done { inspected, ..Done::planned(plan) }
        } else {
            self.step_system(plan, advance, cancelled)?
        };
        let clock = self.clock + DoubleDouble::from(done.duration);
        let integrated = if exact {
            done.integrated
        } else {
            let particles = &mut *self.particles;
            particles.note_rest_after_steps();
            particles.base_time.set_all(clock);
            particles.len() - resting
        };
        let error = match before {
            Some(before) => Some(self.error_since(before, done.duration)),
            None => (exact && advance.report_error).then_some(StepError { position: 0.0, velocity: 0.0 }),
        };
        let used = |values| if integrated == 0 { Values::None } else { values };
        self.note_advance();
        if !self.particles.force.is_clear() {
            self.particles.force.clear();
        }
        self.bounds.force = 0.0;
        self.clock = clock;
        self.step_count += done.steps;
        Ok(Advanced {
            time: self.time(),
            duration: done.duration,
            steps: done.steps,
            step: done.step,
            rejected_steps: done.rejected_steps,
            evaluations: done.evaluations,
            step_count: self.step_count,
            integrated,
            deferred: self.particles.len() - resting - integrated,
            skipped: resting,
            accelerations: used(accelerations),
            dampings: used(dampings),
            inspected: done.inspected,
            error,
            crossed: done.crossed,
        })
    }

    /// Whether the motion of every particle over an advance has a closed form.
    fn has_closed_form(&self) -> bool {
        !self.settings.forces.any() && self.settings.damping_law == DampingLaw::PerSecond
    }

    /// How far the particles are from the closed form over a duration, from these positions and velocities.
    fn error_since(&self, (mut p, mut v): (Vec<[R; 3]>, Vec<[R; 3]>), duration: f64) -> StepError {
        let len = self.particles.len();
        let mut carrier = Carrier::new(self, Span::By(duration), true, len);
        let ends = p.chunks_mut(motion::BLOCK).zip(v.chunks_mut(motion::BLOCK));
        Rows::Range(0..len).blocks().zip(ends).for_each(|(rows, (p, v))| carrier.carry(self, &rows, p, v));
        let largest = |closed: &[[R; 3]], stepped: &[[R; 3]]| {
            let apart = |(x, y): (&[R; 3], &[R; 3])| norm(std::array::from_fn(|k| x[k].into() - y[k].into()));
            closed.iter().zip(stepped).map(apart).fold(0.0, f64::max)
        };
        StepError { position: largest(&p, &self.particles.position), velocity: largest(&v, &self.particles.velocity) }
    }

    fn accelerations_used(&self) -> Values {
        match self.particles.uniform_acceleration(self.gravity()).filter(|_| self.particles.force.none()) {
            Some(uniform) if uniform == zero() => Values::None,
            Some(_) => Values::One,
            None => Values::Each,
        }
    }

    fn dampings_used(&self) -> Values {
        match self.particles.damping {
            Column::Uniform(damping) if damping == R::ONE => Values::None,
            Column::Uniform(_) => Values::One,
            Column::PerParticle(_) => Values::Each,
        }
    }

    /// An advance under a stepped integrator. In place when bounds prove that it ends well and it is over at once;
    /// otherwise the state before is kept, and put back when the advance is cancelled or diverges. How many were looked at.
    fn step(&mut self, plan: StepPlan, cancelled: &AtomicBool) -> Result<usize, Error> {
        let fetches = prefetch::is_large(&self.particles.position);
        let step = Step { integrator: self.settings.integrator, h: R::nearest(plan.step), fetches };
        self.prepare_factors(step.h);
        let bounds = self.bounds.after_steps::<R>(plan).or_else(|| {
            self.bounds = Bounds::of(&self.particles, self.gravity());
            self.bounds.after_steps::<R>(plan)
        });
        let work = plan.steps.saturating_mul(self.particles.len() as u64);
        if let Some(bounds) = bounds
            && work <= WORK_IN_PLACE
        {
            self.bounds = bounds;
            self.run_steps(step, plan.steps, &NEVER_CANCELLED)?;
            return Ok(0);
        }
        let before = (self.particles.position.clone(), self.particles.velocity.clone());
        let result = self.run_steps(step, plan.steps, cancelled);
        let ended = result.and_then(|()| match bounds {
            Some(_) => Ok(()),
            None => self.first_divergence(step, plan.steps, &before, cancelled),
        });
        if let Err(error) = ended {
            (self.particles.position, self.particles.velocity) = before;
            return Err(error);
        }
        let inspected = if bounds.is_some() { 0 } else { self.particles.len() };
        self.bounds = bounds.unwrap_or_else(|| Bounds::of(&self.particles, self.gravity()));
        Ok(inspected)
    }

    /// Moves position and velocity in rounds, between which the advance can be cancelled.
    fn run_steps(&mut self, step: Step<R>, steps: u64, cancelled: &AtomicBool) -> Result<(), Error> {
        let (level, gravity) = (self.level, self.gravity());
        let particles = &mut *self.particles;
        let (mut position, mut velocity) =
            (std::mem::take(&mut particles.position), std::mem::take(&mut particles.velocity));
        // Not of `self`, which is written: to take the columns for writing once more costs some ten nanoseconds.
        let driver = Driver { level, gravity, particles, factors: &self.factors };
        let rows = usize::try_from(ROUND_WORK / steps.clamp(1, ROUND_STEPS)).unwrap_or(usize::MAX);
        let mut run = || {
            for (round, (p, v)) in position.chunks_mut(rows).zip(velocity.chunks_mut(rows)).enumerate() {
                let mut left = steps;
                while left > 0 {
                    if cancelled.load(Ordering::Relaxed) {
                        return Err(Error::Cancelled);
                    }
                    let some = left.min(ROUND_STEPS);
                    let first = round * rows;
                    self.threads.advance(some, p, v, |row, p, v| driver.advance(step, some, first + row, p, v));
                    left -= some;
                }
            }
            Ok(())
        };
        let result = run();
        (particles.position, particles.velocity) = (position, velocity);
        result
    }

    /// The smallest id of a particle that did not stay finite, its row and what of it, among all rows as they ended.
    pub(super) fn diverged(
        &self,
        ended: impl Iterator<Item = ([R; 3], [R; 3])>,
    ) -> Option<(ParticleId, usize, Quantity)> {
        let diverged =
            ended.enumerate().filter_map(|(row, (p, v))| Some((self.ids.id(row), row, kernel::non_finite(&p, &v)?)));
        diverged.min_by_key(|(id, _, _)| *id)
    }

    /// The smallest id of a particle that did not stay finite, with its first step, found by stepping it again.
    fn first_divergence(
        &self,
        step: Step<R>,
        steps: u64,
        before: &(Vec<[R; 3]>, Vec<[R; 3]>),
        cancelled: &AtomicBool,
    ) -> Result<(), Error> {
        let ended = self.particles.position.iter().copied().zip(self.particles.velocity.iter().copied());
        let Some((particle, row, _)) = self.diverged(ended) else { return Ok(()) };
        let (mut p, mut v) = (before.0[row], before.1[row]);
        let (driver, mut scratch) = (self.driver(), Scratch::default());
        let drive = driver.drive(row..row + 1, &mut scratch);
        let mut done = 0;
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
            if cancelled.load(Ordering::Relaxed) {
                return Err(Error::Cancelled);
            }
            (p, v) = after(some);
            done += some;
        }
        unreachable!("the same steps end the same way, and what is not finite once stays so")
    }

    /// An advance under the closed form, which stops where a particle reaches a plane.
    fn flow_until(&mut self, plan: StepPlan, until: Option<Until>, cancelled: &AtomicBool) -> Result<Done, Error> {
        let reached = until.map(|until| self.time_to_plane(&until, plan.duration));
        let duration = reached.flatten().unwrap_or(plan.duration);
        let plan = StepPlan { duration, step: duration, ..plan };
        let (integrated, inspected) = self.flow(plan, self.clock + DoubleDouble::from(duration), cancelled)?;
        let crossed = reached.map(|reached| reached.is_some());
        Ok(Done { integrated, inspected, crossed, ..Done::planned(plan) })
    }

    /// An advance under the closed form: particles with a force move now, the others when they are read. How many moved, and
    /// how many were looked at.
    ///
    /// In place when bounds prove that it ends well; otherwise everything is looked at before anything is written.
    fn flow(&mut self, plan: StepPlan, clock: DoubleDouble, cancelled: &AtomicBool) -> Result<(usize, usize), Error> {
        let forced = self.forced_rows();
        let holds = self.bounds.hold_until::<R>(clock);
        if !holds {
            self.look_ahead(&forced, plan, clock, cancelled)?;
            self.bounds = Bounds::of(&self.particles, self.gravity());
            self.bounds.horizon = self.horizon(clock, plan.duration);
        }
        let len = self.particles.len();
        let inspected = if holds { 0 } else { len };
        if forced.is_empty() {
            return Ok((0, inspected));
        }
        let mut forces = Forced::new(self, forced.len(), plan.duration);
        let (mut p, mut v) = (Vec::new(), Vec::new());
        for rows in Rows::List(&forced).blocks() {
            forces.flow(self, &rows, &mut p, &mut v);
            let particles = &mut *self.particles;
            for (row, (p, v)) in rows.iter().zip(p.iter().zip(&v)) {
                (particles.position[row], particles.velocity[row]) = (*p, *v);
                if forced.len() < len {
                    particles.base_time.set(row, clock, len);
                }
                self.bounds.include(particles, row);
            }
        }
        if forced.len() == len {
            self.particles.base_time.set_all(clock);
        }
        Ok((forced.len(), inspected))
    }

    /// Rows on which a force acts that moves them.
    fn forced_rows(&self) -> Vec<usize> {
        let particles = &self.particles;
        let mut rows = particles.force.rows(particles.len());
        rows.retain(|row| particles.inverse_mass.get(*row) != R::ZERO);
        rows
    }

    /// Refuses an advance at whose end something is not finite.
    fn look_ahead(
        &self,
        forced: &[usize],
        plan: StepPlan,
        clock: DoubleDouble,
        cancelled: &AtomicBool,
    ) -> Result<(), Error> {
        let mut diverged: Option<(ParticleId, Quantity)> = None;
        let mut note = |row, p: &[R; 3], v: &[R; 3]| {
            if let Some(quantity) = kernel::non_finite(p, v) {
                let id = self.ids.id(row);
                diverged = Some(diverged.filter(|(smallest, _)| *smallest < id).unwrap_or((id, quantity)));
            }
        };
        let (mut p, mut v) = (Vec::new(), Vec::new());
        let mut deferred = Carrier::new(self, Span::To(clock), false, self.particles.len());
        let mut forces = Forced::new(self, forced.len(), plan.duration);
        let every = Rows::Range(0..self.particles.len()).blocks().map(|rows| (rows, false));
        for (rows, moves) in every.chain(Rows::List(forced).blocks().map(|rows| (rows, true))) {
            if cancelled.load(Ordering::Relaxed) {
                return Err(Error::Cancelled);
            }
            if moves {
                forces.flow(self, &rows, &mut p, &mut v);
            } else {
                deferred.read(self, &rows, &mut p, &mut v);
            }
            for (row, (p, v)) in rows.iter().zip(p.iter().zip(&v)) {
                if moves || !self.particles.is_forced(row) {
                    note(row, p, v);
                }
            }
        }
        match diverged {
            Some((particle, quantity)) => Err(Error::Diverged { particle, quantity, step: 1 }),
            None => Ok(()),
        }
    }
}

/// Takes particles to where they are now, and on under the force.
struct Forced<R: Real> {
    start: Carrier<R>,
    end: Carrier<R>,
}

impl<R: Real> Forced<R> {
    fn new(world: &World<R>, count: usize, duration: f64) -> Self {
        let start = Carrier::new(world, Span::To(world.clock), false, count);
        Self { start, end: Carrier::new(world, Span::By(duration), true, count) }
    }

    fn flow(&mut self, world: &World<R>, rows: &Rows<'_>, p: &mut Vec<[R; 3]>, v: &mut Vec<[R; 3]>) {
        self.start.read(world, rows, p, v);
        self.end.carry(world, rows, p, v);
    }
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
