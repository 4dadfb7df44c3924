//! The integrators of Euler's kind, where the acceleration has to be computed at every step.

use crate::integrator::Integrator;
use crate::real::Real;
use crate::system::{Field, State, padded};

/// The same arithmetic as in `kernel`, with the acceleration at the start of the step.
#[derive(Debug)]
pub(super) struct Euler<R> {
    integrator: Integrator,
    /// D of each particle.
    factor: Vec<R>,
    acceleration: Vec<R>,
}

impl<R: Real> Euler<R> {
    pub(super) fn new(integrator: Integrator, factor: &[R]) -> Self {
        Self { integrator, factor: padded(factor, R::ONE), acceleration: Vec::new() }
    }

    /// D of each particle, for steps of another length.
    pub(super) fn set_factor(&mut self, factor: &[R]) {
        self.factor = padded(factor, R::ONE);
    }

    pub(super) fn step(&mut self, field: &mut Field<'_, R>, h: R, state: &mut State<R>) {
        self.acceleration.resize(state.p.len(), R::ZERO);
        field.accelerate(&state.p, &state.v, &mut self.acceleration);
        let burst = h * h * R::HALF;
        let stride = field.stride.max(1);
        let columns = state.p.chunks_exact_mut(stride).zip(state.v.chunks_exact_mut(stride));
        for ((p, v), a) in columns.zip(self.acceleration.chunks_exact(stride)) {
            for (((p, v), a), factor) in p.iter_mut().zip(v).zip(a).zip(&self.factor) {
                let kicked = (*v + *a * h) * *factor;
                *p = if self.integrator == Integrator::SemiImplicitEuler {
                    *p + kicked * h
                } else if self.integrator == Integrator::NewtonEulerQuadratic {
                    (*p + *v * h) + *a * burst
                } else {
                    *p + *v * h
                };
                *v = kicked;
            }
        }
    }
}
