//! Advances whose accelerations have to be computed on the way.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::command::Advance;
use crate::error::Error;
use crate::integrator::Integrator;
use crate::kernel;
use crate::real::Real;
use crate::system::{Adaptive, Laws, Masses, State, Stop, System, Turn};
use crate::world::World;
use crate::world::advance::{Done, StepPlan};
use crate::world::bounds::Bounds;
use crate::world::drive::{BLOCK, Factors};
use crate::world::until::Watch;

/// The most steps of an adaptive integrator in one advance: some seconds for a few particles.
const STEPS_MAX: u64 = 10_000_000;

/// Positions, velocities, and what rounding took from both, of all particles.
type Columns<R> = [Vec<[R; 3]>; 4];

impl<R: Real> World<R> {
    /// Interactions of an advance of so many steps: each attracting particle with each other, at each evaluation.
    pub(super) fn interactions(&self, steps: u64) -> u64 {
        let each = self.settings.integrator.evaluations();
        self.pairs().saturating_mul(steps).saturating_mul(each)
    }

    /// Pairs of an attracting and an attracted particle.
    pub(super) fn pairs(&self) -> u64 {
        if self.settings.forces.gravitation.is_none() {
            return 0;
        }
        let attracting = (0..self.particles.len()).filter(|&row| self.particles.attracting_mass(row) > 0.0).count();
        (attracting as u64).saturating_mul(self.particles.len() as u64)
    }

    /// An advance in a system: what comes of it replaces the state only when all of it went well.
    pub(super) fn step_system(
        &mut self,
        plan: StepPlan,
        advance: &Advance,
        cancelled: &AtomicBool,
    ) -> Result<Done, Error> {
        let particles = &self.particles;
        let residual = &particles.residual;
        let mut columns: Columns<R> = [
            particles.position.clone(),
            particles.velocity.clone(),
            residual.position.clone(),
            residual.velocity.clone(),
        ];
        if self.settings.integrator.is_euler() {
            self.prepare_factors(R::nearest(plan.step));
        }
        let done = if self.settings.integrator == Integrator::Dop853 {
            self.run_adaptive(plan, advance, cancelled, &mut columns)?
        } else if let Some(until) = &advance.until {
            self.run_until(plan, &Watch::new(self, until), cancelled, &mut columns)?
        } else {
            let evaluations = self.run_blocks(plan, cancelled, &mut columns)?;
            Done { evaluations, ..Done::planned(plan) }
        };
        if self.settings.integrator != Integrator::Dop853 {
            self.check_finite(plan.step, done.steps, &columns, cancelled)?;
        }
        self.keep_resting(&mut columns);
        self.note_moved(self.moved_to(&columns[0], &columns[1]));
        let particles = &mut *self.particles;
        [particles.position, particles.velocity, particles.residual.position, particles.residual.velocity] = columns;
        self.bounds = Bounds::unknown();
        Ok(Done { inspected: self.particles.len(), ..done })
    }

    /// What moves some rows.
    fn laws(&self, rows: Range<usize>) -> Laws<R> {
        let particles = &self.particles;
        let mut acceleration = vec![[R::ZERO; 3]; rows.len()];
        particles.fill_acceleration(self.level, self.gravity(), rows.clone(), &mut acceleration);
        let forces = self.settings.forces;
        let drag = |row: usize| {
            let (drag, w) =
                (particles.drag.get(row).or(forces.drag).unwrap_or_default(), particles.inverse_mass.get(row));
            [drag.k1 * w, drag.k2 * w]
        };
        let exact = self.settings.integrator == Integrator::VelocityVerlet;
        Laws {
            acceleration,
            driving: rows.clone().filter(|_| exact).map(|row| self.driving(row)).collect(),
            damping: rows.clone().map(|row| particles.damping.get(row)).collect(),
            factor: if self.settings.integrator.is_euler() { self.factors.of_rows(rows.clone()) } else { Vec::new() },
            drag: forces.drag.map_or_else(Vec::new, |_| rows.clone().map(drag).collect()),
            gravitation: forces.gravitation.map(|gravitation| Masses {
                softening: gravitation.softening,
                strength: rows
                    .clone()
                    .map(|row| R::nearest(gravitation.constant.into() * particles.attracting_mass(row)))
                    .collect(),
                immovable: rows.filter(|row| particles.inverse_mass.get(*row) == R::ZERO).collect(),
            }),
        }
    }

    fn system<'a>(&'a self, rows: Range<usize>, cancelled: &'a AtomicBool) -> System<'a, R> {
        System::new(self.level, &self.threads, cancelled, self.settings.integrator, &self.laws(rows))
    }

    /// All steps of a plan. Particles that do not attract each other are moved some at a time, so that they stay in the
    /// cache; the others together.
    fn run_blocks(&self, plan: StepPlan, cancelled: &AtomicBool, columns: &mut Columns<R>) -> Result<u64, Error> {
        let run = |rows: Range<usize>, p: &mut [[R; 3]], v: &mut [[R; 3]], lost: [&mut [[R; 3]]; 2]| {
            let mut system = self.system(rows, cancelled);
            let [lost_p, lost_v] = lost;
            let mut state = State::new(p, v, lost_p, lost_v);
            for step in 1..=plan.steps {
                if cancelled.load(Ordering::Relaxed) {
                    break;
                }
                system.step(plan.step, Turn { step, last: step == plan.steps }, &mut state);
            }
            state.store(p, v, lost_p, lost_v);
            system.evaluations()
        };
        let [p, v, lost_p, lost_v] = columns;
        let evaluations = if self.settings.forces.gravitation.is_some() {
            run(0..p.len(), p, v, [lost_p, lost_v])
        } else if lost_p.is_empty() {
            self.threads.advance(plan.steps, p, v, |first, p, v| {
                for (block, (p, v)) in p.chunks_mut(BLOCK).zip(v.chunks_mut(BLOCK)).enumerate() {
                    let first = first + block * BLOCK;
                    run(first..first + p.len(), p, v, [&mut [], &mut []]);
                }
            });
            plan.steps * self.settings.integrator.evaluations()
        } else {
            let lost = lost_p.chunks_mut(BLOCK).zip(lost_v.chunks_mut(BLOCK));
            for (block, ((p, v), (lost_p, lost_v))) in
                p.chunks_mut(BLOCK).zip(v.chunks_mut(BLOCK)).zip(lost).enumerate()
            {
                run(block * BLOCK..block * BLOCK + p.len(), p, v, [lost_p, lost_v]);
            }
            plan.steps * self.settings.integrator.evaluations()
        };
        if cancelled.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(evaluations) }
    }

    /// Steps until a particle reaches a plane, or all of them.
    fn run_until(
        &self,
        plan: StepPlan,
        watch: &Watch,
        cancelled: &AtomicBool,
        columns: &mut Columns<R>,
    ) -> Result<Done, Error> {
        let mut system = self.system(0..self.particles.len(), cancelled);
        let [p, v, lost_p, lost_v] = columns;
        let mut state = State::new(p, v, lost_p, lost_v);
        let mut done = Done { crossed: Some(false), ..Done::planned(plan) };
        for step in 1..=plan.steps {
            let before = state.clone();
            system.step(plan.step, Turn { step, last: step == plan.steps }, &mut state);
            if cancelled.load(Ordering::Relaxed) {
                return Err(Error::Cancelled);
            }
            let last = Turn { step, last: true };
            if let Some(h) = watch.crossing(plan.step, &before, &state, |h| self.part(&mut system, h, last, &before)) {
                state = self.part(&mut system, h, last, &before);
                #[expect(clippy::cast_precision_loss, reason = "a step count is a small number")]
                let duration = (step - 1) as f64 * plan.step + h;
                done = Done { steps: step, duration, crossed: Some(true), ..done };
                break;
            }
        }
        state.store(p, v, lost_p, lost_v);
        Ok(Done { evaluations: system.evaluations(), ..done })
    }

    /// A step of another length.
    fn part(&self, system: &mut System<'_, R>, h: f64, turn: Turn, before: &State<R>) -> State<R> {
        if self.settings.integrator.is_euler() {
            let mut factors = Factors::default();
            factors.prepare(&self.particles.damping, self.settings.damping_law, R::nearest(h));
            system.set_factor(&factors.of_rows(0..system.len()));
        }
        system.forget();
        let mut state = before.clone();
        system.step(h, turn, &mut state);
        if self.settings.integrator.is_euler() {
            system.set_factor(&self.factors.of_rows(0..system.len()));
        }
        state
    }

    fn run_adaptive(
        &self,
        plan: StepPlan,
        advance: &Advance,
        cancelled: &AtomicBool,
        columns: &mut Columns<R>,
    ) -> Result<Done, Error> {
        let integrator = self.settings.integrator;
        let mut system = self.system(0..self.particles.len(), cancelled);
        let [p, v, lost_p, lost_v] = columns;
        let mut state = State::new(p, v, lost_p, lost_v);
        let watch = advance.until.as_ref().map(|until| Watch::new(self, until));
        let particle_steps = self.limits.particle_steps / (self.particles.len() as u64).max(1);
        let interactions = self.limits.interactions / self.interactions(1).max(1);
        let left = u64::MAX - self.step_count;
        let steps_max = self.limits.steps.min(particle_steps).min(interactions).min(STEPS_MAX).min(left);
        let max_step = advance.max_step.or(self.settings.max_step);
        let mut steps = Adaptive::new(self.settings.tolerance, plan.duration, max_step, steps_max);
        let mut done = Done { crossed: watch.as_ref().map(|_| false), ..Done::planned(plan) };
        while !steps.is_done() {
            let (before, from) = (watch.as_ref().map(|_| state.clone()), steps.reached());
            let h = steps.step(&mut system, &mut state).map_err(|stop| match stop {
                Stop::Cancelled => Error::Cancelled,
                Stop::TooManySteps { steps, reached } => {
                    Error::TooManySteps { integrator, steps, reached, duration: plan.duration }
                }
            })?;
            let len = self.particles.len();
            if let Some((particle, _, quantity)) = self.diverged((0..len).map(|row| state.row(row, len))) {
                return Err(Error::Diverged { particle, quantity, step: steps.steps() });
            }
            let last = Turn { step: steps.steps(), last: true };
            if let (Some(watch), Some(before)) = (&watch, &before)
                && let Some(h) = watch.crossing(h, before, &state, |h| self.part(&mut system, h, last, before))
            {
                state = self.part(&mut system, h, last, before);
                done = Done { crossed: Some(true), duration: from + h, ..done };
                break;
            }
        }
        state.store(p, v, lost_p, lost_v);
        let (steps, rejected_steps) = (steps.steps(), steps.rejected());
        #[expect(clippy::cast_precision_loss, reason = "a step count is a small number")]
        let step = done.duration / steps as f64;
        Ok(Done { steps, rejected_steps, step, evaluations: system.evaluations(), ..done })
    }

    /// Particles at rest keep every bit, also the sign of a zero.
    fn keep_resting(&self, columns: &mut Columns<R>) {
        if self.particles.resting_count() > 0 {
            for row in (0..self.particles.len()).filter(|row| self.particles.is_resting(*row)) {
                columns[0][row] = self.particles.position[row];
                columns[1][row] = self.particles.velocity[row];
            }
        }
    }

    /// Refuses the end of an advance that did not stay finite: the smallest id of such a particle, and its first step,
    /// found by taking all of them again.
    fn check_finite(&self, h: f64, steps: u64, columns: &Columns<R>, cancelled: &AtomicBool) -> Result<(), Error> {
        let ended = columns[0].iter().copied().zip(columns[1].iter().copied());
        let Some((particle, row, quantity)) = self.diverged(ended) else { return Ok(()) };
        let len = self.particles.len();
        let (rows, index) = if self.settings.forces.gravitation.is_some() { (0..len, row) } else { (row..row + 1, 0) };
        let residual = &self.particles.residual;
        let of = |column: &[[R; 3]]| column.get(rows.clone()).unwrap_or_default().to_vec();
        let (p, v) = (of(&self.particles.position), of(&self.particles.velocity));
        let mut state = State::new(&p, &v, &of(&residual.position), &of(&residual.velocity));
        let mut system = self.system(rows.clone(), cancelled);
        for step in 1..steps {
            system.step(h, Turn { step, last: false }, &mut state);
            if cancelled.load(Ordering::Relaxed) {
                return Err(Error::Cancelled);
            }
            let (p, v) = state.row(index, rows.len());
            if let Some(quantity) = kernel::non_finite(&p, &v) {
                return Err(Error::Diverged { particle, quantity, step });
            }
        }
        // Then it was the last step, which may have been a shorter one.
        Err(Error::Diverged { particle, quantity, step: steps })
    }
}
