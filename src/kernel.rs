//! The stepped integrators: the one loop over particles and steps.
//!
//! Every multiplication and every addition rounds on its own, in the precision of the world. A fused multiply-add would
//! be faster and would give other bits on CPUs that have none.

use crate::error::Quantity;
use crate::integrator::Integrator;
use crate::real::Real;

/// The step of one advance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step<R> {
    pub(crate) integrator: Integrator,
    /// The length h of a step in seconds.
    pub(crate) h: R,
}

/// What moves one particle, constant through the advance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drive<R> {
    /// A, with the share of the force.
    pub(crate) acceleration: [R; 3],
    /// D, the damping over one step.
    pub(crate) damping_factor: R,
    /// Whether the damping is below 1, so that small velocities come to rest.
    pub(crate) damped: bool,
}

/// A velocity that decays into denormals would cost sixty times a normal step, and comparing it at every step would
/// halve the speed: every so many steps and at the end is enough.
pub(crate) const STEPS_BETWEEN_RESTS: u64 = 64;

/// Takes `steps` steps.
pub(crate) fn advance<R: Real>(step: Step<R>, drive: &Drive<R>, steps: u64, p: &mut [R; 3], v: &mut [R; 3]) {
    let mut left = steps;
    while left > 0 {
        let block = left.min(STEPS_BETWEEN_RESTS);
        for _ in 0..block {
            one_step(step, drive, p, v);
        }
        if drive.damped {
            *v = v.map(at_rest_below_threshold);
        }
        left -= block;
    }
}

/// Which of the two is not finite, position before velocity.
pub(crate) fn non_finite<R: Real>(p: &[R; 3], v: &[R; 3]) -> Option<Quantity> {
    if !p.iter().all(|x| x.is_finite()) {
        Some(Quantity::Position)
    } else if !v.iter().all(|x| x.is_finite()) {
        Some(Quantity::Velocity)
    } else {
        None
    }
}

/// A velocity component too small to matter is a zero of its own sign.
pub(crate) fn at_rest_below_threshold<R: Real>(v: R) -> R {
    if v.abs() < R::REST { v.signed_zero() } else { v }
}

/// Takes the `n`-th step, from 1, of an advance that is watched step by step.
pub(crate) fn advance_one<R: Real>(step: Step<R>, drive: &Drive<R>, n: u64, p: &mut [R; 3], v: &mut [R; 3]) {
    one_step(step, drive, p, v);
    if drive.damped && n.is_multiple_of(STEPS_BETWEEN_RESTS) {
        *v = v.map(at_rest_below_threshold);
    }
}

#[inline]
fn one_step<R: Real>(step: Step<R>, drive: &Drive<R>, p: &mut [R; 3], v: &mut [R; 3]) {
    let Step { integrator, h } = step;
    let d = drive.damping_factor;
    let a = drive.acceleration;
    for k in 0..3 {
        let kicked = (v[k] + a[k] * h) * d;
        p[k] = match integrator {
            Integrator::NewtonEuler => p[k] + v[k] * h,
            Integrator::NewtonEulerQuadratic => (p[k] + v[k] * h) + a[k] * (h * h * R::HALF),
            Integrator::SemiImplicitEuler => p[k] + kicked * h,
            Integrator::Exact => unreachable!("the closed form has no steps"),
        };
        v[k] = kicked;
    }
}
