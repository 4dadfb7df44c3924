//! Explicit Runge-Kutta methods on p' = v, v' = A(p, v).
//!
//! A stage needs p + h Σ aᵢⱼ vⱼ, and the velocities vⱼ of the stages before are v + h Σ aⱼₗ kₗ. Put together, positions need
//! the accelerations k alone: pᵢ = p + h (cᵢ v + h Σ āᵢₗ kₗ) with ā = a a. So half as much is kept as in a system of
//! first order.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use fearless_simd::{Simd, SimdBase, dispatch};

use crate::double_double::DoubleDouble;
use crate::real::Real;
use crate::system::{Field, LANES_MAX, State, add_compensated};

/// Of a sum over stages: which stage, its weight for the velocity, and its weight for the position.
pub(super) type Terms = &'static [(usize, f64, f64)];

/// A stage after the first.
#[derive(Debug)]
pub(super) struct Stage {
    /// When it is, in steps.
    pub(super) c: f64,
    pub(super) terms: Terms,
}

/// The coefficients of a method.
#[derive(Debug)]
pub(super) struct Tableau {
    pub(super) stages: &'static [Stage],
    /// Those of the end of the step.
    pub(super) end: Terms,
}

/// The classic method of Runge and Kutta.
pub(super) const RK4: Tableau = Tableau {
    stages: &[
        Stage { c: 0.5, terms: &[(0, 0.5, 0.0)] },
        Stage { c: 0.5, terms: &[(0, 0.0, 0.25), (1, 0.5, 0.0)] },
        Stage { c: 1.0, terms: &[(1, 0.0, 0.5), (2, 1.0, 0.0)] },
    ],
    end: &[(0, 1.0 / 6.0, 1.0 / 6.0), (1, 1.0 / 3.0, 1.0 / 6.0), (2, 1.0 / 3.0, 1.0 / 6.0), (3, 1.0 / 6.0, 0.0)],
};

/// A method at work.
#[derive(Debug)]
pub(super) struct RungeKutta<R> {
    stages: Vec<(R, Weights<R>)>,
    end: Weights<R>,
    /// The accelerations of all stages, one after the other.
    pub(super) k: Vec<R>,
    /// Position and velocity of a stage.
    p: Vec<R>,
    v: Vec<R>,
}

/// Terms in the precision of the world.
pub(super) type Weights<R> = Vec<(usize, R, R)>;

pub(super) fn weights<R: Real>(terms: Terms) -> Weights<R> {
    terms.iter().map(|(j, v, p)| (*j, R::nearest(*v), R::nearest(*p))).collect()
}

impl<R: Real> RungeKutta<R> {
    pub(super) fn new(tableau: &Tableau) -> Self {
        Self {
            stages: tableau.stages.iter().map(|stage| (R::nearest(stage.c), weights(stage.terms))).collect(),
            end: weights(tableau.end),
            k: Vec::new(),
            p: Vec::new(),
            v: Vec::new(),
        }
    }

    /// One step from the start, with the accelerations there computed anew.
    pub(super) fn step(&mut self, field: &mut Field<'_, R>, h: R, state: &mut State<R>) {
        self.start(field, state);
        self.attempt(field, h, state);
        self.arrive(field, h, state);
        self.finish(field, h, state);
    }

    /// The accelerations at the start of a step.
    pub(super) fn start(&mut self, field: &mut Field<'_, R>, state: &State<R>) {
        let len = state.p.len();
        self.k.resize((self.stages.len() + 1) * len, R::ZERO);
        self.p.resize(len, R::ZERO);
        self.v.resize(len, R::ZERO);
        field.accelerate(&state.p, &state.v, &mut self.k[..len]);
    }

    /// The accelerations of all other stages.
    pub(super) fn attempt(&mut self, field: &mut Field<'_, R>, h: R, state: &State<R>) {
        let len = state.p.len();
        for (index, (c, weights)) in self.stages.iter().enumerate() {
            let (done, next) = self.k.split_at_mut((index + 1) * len);
            let into = (&mut self.p[..], &mut self.v[..]);
            dispatch!(field.level, simd => stage(simd, h, *c, weights, done, state, into));
            field.accelerate(&self.p, &self.v, &mut next[..len]);
        }
    }

    /// Where and how fast all are at the end of the step, in plain sums.
    pub(super) fn arrive(&mut self, field: &Field<'_, R>, h: R, state: &State<R>) {
        let into = (&mut self.p[..], &mut self.v[..]);
        dispatch!(field.level, simd => stage(simd, h, R::ONE, &self.end, &self.k, state, into));
    }

    pub(super) fn arrived(&self) -> (&[R], &[R]) {
        (&self.p, &self.v)
    }

    /// Makes the end of the step the state.
    pub(super) fn finish(&mut self, field: &Field<'_, R>, h: R, state: &mut State<R>) {
        if state.compensated() {
            dispatch!(field.level, simd => end_compensated(simd, h, &self.end, &self.k, state));
        } else {
            std::mem::swap(&mut state.p, &mut self.p);
            std::mem::swap(&mut state.v, &mut self.v);
        }
    }
}

/// p + h (c v + h Σ ā k) and v + h Σ a k.
#[inline(always)]
fn stage<S: Simd, R: Real>(
    simd: S,
    h: R,
    c: R,
    weights: &[(usize, R, R)],
    k: &[R],
    state: &State<R>,
    (to_p, to_v): (&mut [R], &mut [R]),
) {
    let lanes = R::Lanes::<S>::LEN;
    let len = state.p.len();
    let zero = R::Lanes::<S>::splat(simd, R::ZERO);
    let (h, c) = (R::Lanes::<S>::splat(simd, h), R::Lanes::<S>::splat(simd, c));
    let mut at = 0;
    while at + lanes <= len {
        let (for_p, for_v) = sums::<S, R>(simd, weights, k, len, at, zero);
        let p = R::Lanes::<S>::from_slice(simd, &state.p[at..at + lanes]);
        let v = R::Lanes::<S>::from_slice(simd, &state.v[at..at + lanes]);
        (p + h * (c * v + h * for_p)).store_slice(&mut to_p[at..at + lanes]);
        (v + h * for_v).store_slice(&mut to_v[at..at + lanes]);
        at += lanes;
    }
}

/// Σ ā (k − from) and Σ a (k − from) of one register.
#[inline(always)]
pub(super) fn sums<S: Simd, R: Real>(
    simd: S,
    weights: &[(usize, R, R)],
    k: &[R],
    len: usize,
    at: usize,
    from: R::Lanes<S>,
) -> (R::Lanes<S>, R::Lanes<S>) {
    let zero = R::Lanes::<S>::splat(simd, R::ZERO);
    let (mut for_p, mut for_v) = (zero, zero);
    for (j, weight_v, weight_p) in weights {
        let place = j * len + at;
        let k = R::Lanes::<S>::from_slice(simd, &k[place..place + R::Lanes::<S>::LEN]) - from;
        for_v = for_v + k * R::Lanes::<S>::splat(simd, *weight_v);
        for_p = for_p + k * R::Lanes::<S>::splat(simd, *weight_p);
    }
    (for_p, for_v)
}

/// The same end of a step, in compensated sums. So that more than the last addition profits, weights act on differences
/// of accelerations (they add up to 1 for the velocity and ½ for the position), and products keep what they lose.
#[inline(always)]
fn end_compensated<S: Simd, R: Real>(simd: S, h: R, weights: &[(usize, R, R)], k: &[R], state: &mut State<R>) {
    let lanes = R::Lanes::<S>::LEN;
    let len = state.p.len();
    let half = R::Lanes::<S>::splat(simd, R::HALF);
    let mut at = 0;
    let (mut for_p, mut for_v) = ([R::ZERO; LANES_MAX], [R::ZERO; LANES_MAX]);
    while at + lanes <= len {
        let first = R::Lanes::<S>::from_slice(simd, &k[at..at + lanes]);
        let differences = sums::<S, R>(simd, weights, k, len, at, first);
        (half * first + differences.0).store_slice(&mut for_p[..lanes]);
        (first + differences.1).store_slice(&mut for_v[..lanes]);
        for lane in 0..lanes {
            let i = at + lane;
            let bend = h * for_p[lane];
            let DoubleDouble { hi: mean, lo: lost } = DoubleDouble::sum(state.v[i], bend);
            let drift = h * mean;
            state.lost_p[i] = state.lost_p[i] + (R::lost_in_product(h, mean) + h * (lost + state.lost_v[i]));
            add_compensated(&mut state.p[i], &mut state.lost_p[i], drift);
            let gain = h * for_v[lane];
            state.lost_v[i] = state.lost_v[i] + R::lost_in_product(h, for_v[lane]);
            add_compensated(&mut state.v[i], &mut state.lost_v[i], gain);
        }
        at += lanes;
    }
}
