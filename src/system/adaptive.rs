//! Steps of the length that a tolerance allows.
//!
//! Source: Hairer, Nørsett and Wanner, *Solving Ordinary Differential Equations I*, sections II.4 and II.10. The error is
//! measured for each particle, as a vector, and the largest decides: so the result does not depend on how many others there are.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use fearless_simd::{Simd, SimdBase, dispatch};

use crate::command::Tolerance;
use crate::double_double::DoubleDouble;
use crate::real::Real;
use crate::system::runge_kutta::{RungeKutta, Weights, sums, weights};
use crate::system::{Field, Scheme, State, System, Turn, come_to_rest, dop853, norm};

/// The steps of one advance.
#[derive(Debug)]
pub(crate) struct Adaptive<R> {
    tolerance: Tolerance,
    duration: f64,
    max_step: f64,
    steps_max: u64,
    /// How far it is, in seconds.
    reached: DoubleDouble,
    /// The length of the next attempt.
    next: Option<f64>,
    steps: u64,
    rejected: u64,
    estimate: Estimate<R>,
}

/// Why no step could be taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Stop {
    Cancelled,
    /// It would need more steps than are allowed, or shorter ones than the clock can tell.
    TooManySteps {
        steps: u64,
        reached: f64,
    },
}

/// Two estimates of the error, of order 5 and 3.
#[derive(Debug)]
struct Estimate<R> {
    fifth: Weights<R>,
    third: Weights<R>,
    /// Of position and velocity, for both.
    errors: [Vec<R>; 4],
}

impl<R: Real> Adaptive<R> {
    pub(crate) fn new(tolerance: Tolerance, duration: f64, max_step: Option<f64>, steps_max: u64) -> Self {
        let relative = tolerance.relative.max(0.25 * R::ROUND_OFF);
        Self {
            tolerance: Tolerance { relative, ..tolerance },
            duration,
            max_step: max_step.map_or(duration, |max_step| max_step.min(duration)),
            steps_max,
            reached: DoubleDouble::default(),
            next: None,
            steps: 0,
            rejected: 0,
            estimate: Estimate {
                fifth: weights(dop853::ERROR_5),
                third: weights(dop853::ERROR_3),
                errors: [const { Vec::new() }; 4],
            },
        }
    }

    pub(crate) fn is_done(&self) -> bool {
        self.reached.hi >= self.duration
    }

    /// How far it is, in seconds.
    pub(crate) fn reached(&self) -> f64 {
        self.reached.hi
    }

    /// Steps taken.
    pub(crate) fn steps(&self) -> u64 {
        self.steps
    }

    /// Steps taken back.
    pub(crate) fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Takes one step, and tells how long it was.
    pub(crate) fn step(&mut self, system: &mut System<'_, R>, state: &mut State<R>) -> Result<f64, Stop> {
        let Scheme::RungeKutta(method) = &mut system.scheme else { unreachable!("only such methods estimate errors") };
        let field = &mut system.field;
        method.start(field, state);
        let mut h = match self.next {
            Some(h) => h,
            None => self.first_step(method, field, state),
        };
        let mut growth = 6.0;
        loop {
            if field.is_cancelled() {
                return Err(Stop::Cancelled);
            }
            let left = (DoubleDouble::from(self.duration) - self.reached).hi;
            let is_last = 1.01 * h >= left;
            if is_last {
                h = left;
            }
            let too_short = self.reached.hi + h <= self.reached.hi || R::nearest(h) == R::ZERO;
            if too_short || self.steps + self.rejected >= self.steps_max {
                return Err(Stop::TooManySteps { steps: self.steps + self.rejected, reached: self.reached.hi });
            }
            let rounded = R::nearest(h);
            method.attempt(field, rounded, state);
            method.arrive(field, rounded, state);
            let error = self.estimate.error(method, field, self.tolerance, rounded, state);
            let factor = (0.9 / eighth_root(error)).clamp(0.333, growth);
            if error <= 1.0 {
                method.finish(field, rounded, state);
                self.steps += 1;
                // The step is as long as the precision of the world can say.
                let on = DoubleDouble::from(rounded.into());
                self.reached = if is_last { DoubleDouble::from(self.duration) } else { self.reached + on };
                self.next = Some((h * factor).min(self.max_step));
                let turn = Turn { step: self.steps, last: is_last };
                if system.rests && turn.is_due() {
                    come_to_rest(&system.rest, state);
                }
                return Ok(h);
            }
            self.rejected += 1;
            growth = 1.0;
            // Not a number: the step left the range of numbers.
            h *= if factor.is_nan() { 0.333 } else { factor };
        }
    }

    /// A first guess, from the magnitudes of the state, of its derivative, and of how that changes over a small step.
    fn first_step(&self, method: &RungeKutta<R>, field: &mut Field<'_, R>, state: &State<R>) -> f64 {
        let k = &method.k[..state.p.len()];
        let (size, slope) = (self.norm(field, state, &state.p, &state.v), self.norm(field, state, &state.v, k));
        let is_usable = |x: f64| x > 1e-10 && x.is_finite();
        let guess = if is_usable(size) && is_usable(slope) { 0.01 * size / slope } else { 1e-6 * self.duration };
        let guess = guess.min(self.max_step);
        let h = R::nearest(guess);
        let after = |x: &[R], slope: &[R]| -> Vec<R> { x.iter().zip(slope).map(|(x, y)| *x + h * *y).collect() };
        let (p, v) = (after(&state.p, &state.v), after(&state.v, k));
        let mut bend = vec![R::ZERO; k.len()];
        field.accelerate(&p, &v, &mut bend);
        bend.iter_mut().zip(k).for_each(|(bend, k)| *bend = *bend - *k);
        let turn: Vec<R> = v.iter().zip(&state.v).map(|(after, before)| *after - *before).collect();
        let most = slope.max(self.norm(field, state, &turn, &bend) / guess);
        let second = if is_usable(most) { eighth_root(0.01 / most) } else { (1e-3 * guess).max(1e-6 * self.duration) };
        (100.0 * guess).min(second).min(self.max_step)
    }

    /// The magnitude of a change of position and velocity in units of the tolerance, of the particle where it is largest.
    fn norm(&self, field: &Field<'_, R>, state: &State<R>, change_p: &[R], change_v: &[R]) -> f64 {
        let part =
            |i: usize, change: &[R], of: &[R]| self.tolerance.part(length(field, change, i), length(field, of, i));
        let norm = |i: usize| 0.5 * (part(i, change_p, &state.p) + part(i, change_v, &state.v));
        (0..field.len).map(norm).fold(0.0, f64::max).sqrt()
    }
}

impl Tolerance {
    /// The square of an error in units of the tolerance, for a vector of a magnitude.
    fn part(&self, error: f64, magnitude: f64) -> f64 {
        if error == 0.0 {
            return 0.0;
        }
        let part = error / (self.absolute + self.relative * magnitude);
        part * part
    }
}

/// |x| of one particle.
fn length<R: Real>(field: &Field<'_, R>, columns: &[R], i: usize) -> f64 {
    let [x, y, z]: [f64; 3] = [0, 1, 2].map(|axis| columns[axis * field.stride + i].into());
    let square = x * x + y * y + z * z;
    if (1e-280..1e280).contains(&square) { square.sqrt() } else { norm([x, y, z]) }
}

/// By square roots, which are rounded correctly everywhere.
fn eighth_root(x: f64) -> f64 {
    x.sqrt().sqrt().sqrt()
}

impl<R: Real> Estimate<R> {
    /// The error of an attempted step in units of the tolerance, of the particle where it is largest.
    fn error(
        &mut self,
        method: &RungeKutta<R>,
        field: &Field<'_, R>,
        tolerance: Tolerance,
        h: R,
        before: &State<R>,
    ) -> f64 {
        self.errors.iter_mut().for_each(|errors| errors.resize(before.p.len(), R::ZERO));
        dispatch!(field.level, simd => self.sum(simd, h, &method.k));
        let (after_p, after_v) = method.arrived();
        let [fifth_p, fifth_v, third_p, third_v] = &self.errors;
        let mut most: f64 = 0.0;
        for i in 0..field.len {
            let of = |column| length(field, column, i);
            let (size_p, size_v) = (of(&before.p).max(of(after_p)), of(&before.v).max(of(after_v)));
            let fifth = 0.5 * (tolerance.part(of(fifth_p), size_p) + tolerance.part(of(fifth_v), size_v));
            let third = 0.5 * (tolerance.part(of(third_p), size_p) + tolerance.part(of(third_v), size_v));
            let error = if fifth == 0.0 { 0.0 } else { fifth / (fifth + 0.01 * third).sqrt() };
            // A maximum that keeps what is not a number.
            most = if error > most || error.is_nan() { error } else { most };
        }
        most
    }

    #[inline(always)]
    fn sum<S: Simd>(&mut self, simd: S, h: R, k: &[R]) {
        let lanes = R::Lanes::<S>::LEN;
        let h = R::Lanes::<S>::splat(simd, h);
        let zero = R::Lanes::<S>::splat(simd, R::ZERO);
        let [fifth_p, fifth_v, third_p, third_v] = &mut self.errors;
        let len = fifth_p.len();
        let mut at = 0;
        while at + lanes <= len {
            for (weights, to_p, to_v) in
                [(&self.fifth, &mut *fifth_p, &mut *fifth_v), (&self.third, &mut *third_p, &mut *third_v)]
            {
                let (for_p, for_v) = sums::<S, R>(simd, weights, k, len, at, zero);
                (h * (h * for_p)).store_slice(&mut to_p[at..at + lanes]);
                (h * for_v).store_slice(&mut to_v[at..at + lanes]);
            }
            at += lanes;
        }
    }
}
