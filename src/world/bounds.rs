//! Bounds on the magnitudes of all particles.

use crate::closed_form::{ClosedForm, Decay};
use crate::double_double::DoubleDouble;
use crate::particles::Particles;
use crate::real::Real;
use crate::world::{StepPlan, World};

/// Bounds on the magnitudes of all bases, so that most advances under the closed form need not look at any particle.
/// They only say whether to look: what is looked at is decided by the numbers themselves.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    position: f64,
    velocity: f64,
    acceleration: f64,
    inverse_mass: f64,
    pub(super) force: f64,
    damping: f64,
    /// At or before every base time.
    oldest: DoubleDouble,
    /// Until this clock every particle was looked at and found to stay finite, while none is written and no force acts.
    pub(super) horizon: Option<DoubleDouble>,
}

impl Default for Bounds {
    fn default() -> Self {
        let oldest = DoubleDouble::default();
        Self {
            position: 0.0,
            velocity: 0.0,
            acceleration: 0.0,
            inverse_mass: 0.0,
            force: 0.0,
            damping: 0.0,
            oldest,
            horizon: None,
        }
    }
}

impl Bounds {
    /// Of anything: they have to be found out when they are needed.
    pub(super) fn unknown() -> Self {
        Self { position: f64::INFINITY, velocity: f64::INFINITY, ..Self::default() }
    }

    pub(super) fn of<R: Real>(particles: &Particles<R>, gravity: [R; 3]) -> Self {
        let mut bounds = Self {
            acceleration: magnitude(gravity),
            force: particles.force.sums().map(magnitude).fold(0.0, f64::max),
            oldest: particles.base_time.oldest(),
            ..Self::default()
        };
        for row in 0..particles.len() {
            bounds.include(particles, row);
        }
        bounds
    }

    /// Takes in a row that was written.
    pub(super) fn include<R: Real>(&mut self, particles: &Particles<R>, row: usize) {
        self.position = self.position.max(magnitude(particles.position[row]));
        self.velocity = self.velocity.max(magnitude(particles.velocity[row]));
        self.acceleration = self.acceleration.max(particles.own(row).map_or(0.0, magnitude));
        self.inverse_mass = self.inverse_mass.max(particles.inverse_mass.get(row).into());
        self.damping = self.damping.max(particles.damping.get(row).into());
        self.horizon = None;
    }

    /// |A|, with the share of the force.
    fn driving(&self) -> f64 {
        self.acceleration + self.inverse_mass * self.force
    }

    /// The bounds after an advance under any stepped integrator, when they prove that every number stays finite on the
    /// way: |v| grows by at most |A| T, |p| by at most (|v| + |A| T) T. Rounding adds less than 2⁻²⁰ of it a step.
    pub(super) fn after_steps<R: Real>(&self, plan: StepPlan) -> Option<Self> {
        let t = plan.duration;
        let acceleration = self.driving();
        #[expect(clippy::cast_precision_loss, reason = "an estimate")]
        let slack = 1.0 + (plan.steps + 1) as f64 / f64::from(1 << 20);
        let velocity = (self.velocity + acceleration * t) * slack;
        let position = (self.position + velocity * t) * slack;
        let finite = 0.25 * R::LARGEST;
        // The longer position update takes the square of a step, whatever it is multiplied with.
        let square = plan.step * plan.step;
        let holds = [velocity, position, acceleration, square].into_iter().all(|bound| bound < finite);
        (slack < 2.0 && holds).then_some(Self { position, velocity, horizon: None, ..*self })
    }

    /// Whether an advance to this clock under the closed form surely ends with finite numbers: at most half the largest,
    /// with φ <= t and ψ <= t²/2, else with φ and ψ of the largest damping; or all were looked at up to a later clock.
    pub(super) fn hold_until<R: Real>(&self, clock: DoubleDouble) -> bool {
        let holds = |phi: f64, psi: f64| {
            let a = self.driving();
            let position = self.position + self.velocity.max(1.0) * phi + a.max(1.0) * psi;
            let velocity = self.velocity + a * phi;
            position < 0.5 * R::LARGEST && velocity < 0.5 * R::LARGEST
        };
        let t = (clock - self.oldest).hi;
        if self.horizon.is_some_and(|horizon| (horizon - clock).hi >= 0.0) && self.force == 0.0 {
            return true;
        }
        holds(t, 0.5 * t * t) || {
            let form = Decay::of(self.damping).over(t);
            holds(form.phi, form.psi)
        }
    }
}

impl<R: Real> World<R> {
    /// The clock after a hundred advances like the one that ends at `clock`, if every particle without a force stays finite
    /// until then.
    pub(super) fn horizon(&self, clock: DoubleDouble, duration: f64) -> Option<DoubleDouble> {
        let horizon = clock + DoubleDouble::from(100.0 * duration);
        let particles = &self.particles;
        let mut last: Option<(R, f64, ClosedForm)> = None;
        let stays = |row: usize| {
            let (damping, time) = (particles.damping.get(row), (horizon - particles.base_time.get(row)).hi);
            let form = match last {
                Some((d, t, form)) if d == damping && t == time => form,
                Some(_) | None => Decay::of(damping).over(time),
            };
            last = Some((damping, time, form));
            let (v, a) = (magnitude(particles.velocity[row]), magnitude(particles.acceleration(row, self.gravity())));
            let position = magnitude(particles.position[row]) + v * form.phi + a * form.psi;
            position < 0.99 * R::LARGEST && v + a * form.phi < 0.99 * R::LARGEST
        };
        (0..particles.len()).all(stays).then_some(horizon)
    }
}

/// The largest magnitude of a component.
pub(super) fn magnitude<R: Real>(x: [R; 3]) -> f64 {
    x.map(|x| x.abs().into()).into_iter().fold(0.0, f64::max)
}
