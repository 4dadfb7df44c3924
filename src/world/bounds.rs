//! Bounds on the magnitudes of all particles.

use crate::double_double::DoubleDouble;
use crate::particles::Particles;
use crate::real::Real;
use crate::world::StepPlan;

/// Bounds on the magnitudes of all bases, so that most advances under the closed form need not look at any particle.
/// They only say whether to look: what is looked at is decided by the numbers themselves.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    position: f64,
    velocity: f64,
    acceleration: f64,
    inverse_mass: f64,
    pub(super) force: f64,
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
    pub(super) fn of<R: Real>(particles: &Particles<R>, gravity: [R; 3]) -> Self {
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
    pub(super) fn include<R: Real>(&mut self, particles: &Particles<R>, row: usize) {
        self.position = self.position.max(magnitude(particles.position[row]));
        self.velocity = self.velocity.max(magnitude(particles.velocity[row]));
        self.acceleration = self.acceleration.max(particles.own(row).map_or(0.0, magnitude));
        self.inverse_mass = self.inverse_mass.max(particles.inverse_mass.get(row).into());
    }

    /// The bounds after an advance under any stepped integrator, when they prove that every number stays finite on the
    /// way: |v| grows by at most |A| T, |p| by at most (|v| + |A| T) T. Rounding adds less than 2⁻²⁰ of it a step.
    pub(super) fn after_steps<R: Real>(&self, plan: StepPlan) -> Option<Self> {
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
    pub(super) fn hold_until<R: Real>(&self, clock: DoubleDouble) -> bool {
        let t = (clock - self.oldest).hi;
        let position = self.position + self.velocity.max(1.0) * t + self.acceleration.max(1.0) * t * t * 0.5;
        let velocity = self.velocity + self.acceleration * t;
        position < 0.5 * R::LARGEST && velocity < 0.5 * R::LARGEST
    }
}

/// The largest magnitude of a component.
pub(super) fn magnitude<R: Real>(x: [R; 3]) -> f64 {
    x.map(|x| x.abs().into()).into_iter().fold(0.0, f64::max)
}
