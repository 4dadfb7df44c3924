//! Particles whose acceleration depends on where they are or how fast: steps of the integrators that can compute with it.
//!
//! A system holds some particles as columns of x, y and z, each filled up to whole vector registers. What does not change
//! during an advance is prepared once. Every operation rounds on its own, in the precision of the world (the exact flow of
//! `velocity_verlet` in double, rounded once), and in the same order on every instruction set.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

mod adaptive;
mod dop853;
mod euler;
mod gravitation;
mod runge_kutta;
#[cfg(test)]
mod tests;
mod verlet;

use std::sync::atomic::{AtomicBool, Ordering};

use fearless_simd::{Level, Simd, dispatch};

use crate::closed_form::Decay;
use crate::double_double::DoubleDouble;
use crate::integrator::Integrator;
use crate::kernel::STEPS_BETWEEN_RESTS;
use crate::real::Real;
use crate::threads::Threads;
pub(crate) use adaptive::{Adaptive, Stop};
use euler::Euler;
use gravitation::Attraction;
use runge_kutta::RungeKutta;
use verlet::Verlet;

/// What moves some particles: one value for each, in the order of their positions and velocities.
#[derive(Debug)]
pub(crate) struct Laws<R> {
    /// a + w F in m/s².
    pub(crate) acceleration: Vec<[R; 3]>,
    /// The same in double, for `velocity_verlet`, whose flow is computed in double.
    pub(crate) driving: Vec<[f64; 3]>,
    /// The share of the velocity that is kept each second.
    pub(crate) damping: Vec<R>,
    /// D over one step, for the integrators of Euler's kind.
    pub(crate) factor: Vec<R>,
    /// k₁ w in 1/s and k₂ w in 1/m; empty without drag.
    pub(crate) drag: Vec<[R; 2]>,
    pub(crate) gravitation: Option<Masses<R>>,
}

/// What attracts.
#[derive(Debug)]
pub(crate) struct Masses<R> {
    /// ε in metres.
    pub(crate) softening: R,
    /// G m of each in m³/s², 0 for one that does not attract.
    pub(crate) strength: Vec<R>,
    /// Those that nothing moves.
    pub(crate) immovable: Vec<usize>,
}

/// Positions and velocities, and what rounding took from them where sums are compensated.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct State<R> {
    pub(crate) p: Vec<R>,
    pub(crate) v: Vec<R>,
    /// Both empty where sums are not compensated.
    pub(crate) lost_p: Vec<R>,
    pub(crate) lost_v: Vec<R>,
}

/// The most lanes that a register of either precision has.
const LANES_MAX: usize = f32::LANES_MAX;

/// The length of a column for so many particles: whole registers of any instruction set.
fn stride<R: Real>(len: usize) -> usize {
    len.next_multiple_of(R::LANES_MAX)
}

/// From rows of x, y and z to a column of each.
fn to_columns<R: Real>(rows: &[[R; 3]]) -> Vec<R> {
    let stride = stride::<R>(rows.len());
    let mut columns = vec![R::ZERO; 3 * stride];
    for (axis, column) in columns.chunks_exact_mut(stride.max(1)).enumerate() {
        column.iter_mut().zip(rows).for_each(|(x, row)| *x = row[axis]);
    }
    columns
}

/// And back.
fn to_rows<R: Real>(columns: &[R], rows: &mut [[R; 3]]) {
    let stride = stride::<R>(rows.len());
    for (i, row) in rows.iter_mut().enumerate() {
        *row = std::array::from_fn(|axis| columns[axis * stride + i]);
    }
}

/// One value for each particle as a column.
fn padded<R: Real>(values: &[R], filling: R) -> Vec<R> {
    let mut column = values.to_vec();
    column.resize(stride::<R>(values.len()), filling);
    column
}

impl<R: Real> State<R> {
    /// `lost_p` and `lost_v` are empty where sums are not compensated.
    pub(crate) fn new(p: &[[R; 3]], v: &[[R; 3]], lost_p: &[[R; 3]], lost_v: &[[R; 3]]) -> Self {
        Self { p: to_columns(p), v: to_columns(v), lost_p: to_columns(lost_p), lost_v: to_columns(lost_v) }
    }

    pub(crate) fn store(&self, p: &mut [[R; 3]], v: &mut [[R; 3]], lost_p: &mut [[R; 3]], lost_v: &mut [[R; 3]]) {
        to_rows(&self.p, p);
        to_rows(&self.v, v);
        to_rows(&self.lost_p, lost_p);
        to_rows(&self.lost_v, lost_v);
    }

    fn compensated(&self) -> bool {
        !self.lost_p.is_empty()
    }

    /// Position and velocity of one of `len`.
    pub(crate) fn row(&self, index: usize, len: usize) -> ([R; 3], [R; 3]) {
        let stride = stride::<R>(len);
        let of = |columns: &[R]| std::array::from_fn(|axis| columns[axis * stride + index]);
        (of(&self.p), of(&self.v))
    }
}

/// Some particles under their laws and one integrator.
#[derive(Debug)]
pub(crate) struct System<'a, R: Real> {
    field: Field<'a, R>,
    scheme: Scheme<R>,
    /// The magnitude below which a velocity comes to rest, 0 where it is not damped.
    rest: Vec<R>,
    /// Whether some velocity is damped.
    rests: bool,
}

#[derive(Debug)]
enum Scheme<R> {
    Euler(Euler<R>),
    Verlet(Verlet<R>),
    RungeKutta(RungeKutta<R>),
}

/// Which steps of an advance have gone before.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Turn {
    /// From 1.
    pub(crate) step: u64,
    /// Whether it is the last one.
    pub(crate) last: bool,
}

impl Turn {
    /// Whether velocities come to rest after this step.
    fn is_due(self) -> bool {
        self.last || self.step.is_multiple_of(STEPS_BETWEEN_RESTS)
    }
}

impl<'a, R: Real> System<'a, R> {
    pub(crate) fn new(
        level: Level,
        threads: &'a Threads,
        cancelled: &'a AtomicBool,
        integrator: Integrator,
        laws: &Laws<R>,
    ) -> Self {
        let rest: Vec<R> = laws.damping.iter().map(|d| if *d < R::ONE { R::REST } else { R::ZERO }).collect();
        let scheme = match integrator {
            Integrator::NewtonEuler | Integrator::NewtonEulerQuadratic | Integrator::SemiImplicitEuler => {
                Scheme::Euler(Euler::new(integrator, &laws.factor))
            }
            Integrator::VelocityVerlet => Scheme::Verlet(Verlet::new(laws)),
            Integrator::Rk4 => Scheme::RungeKutta(RungeKutta::new(&runge_kutta::RK4)),
            Integrator::Dop853 => Scheme::RungeKutta(RungeKutta::new(&dop853::TABLEAU)),
            Integrator::Exact => unreachable!("the closed form has no steps"),
        };
        let continuous = matches!(scheme, Scheme::RungeKutta(_));
        Self {
            field: Field::new(level, threads, cancelled, laws, continuous),
            scheme,
            rests: rest.iter().any(|rest| *rest > R::ZERO),
            rest: padded(&rest, R::ZERO),
        }
    }

    /// How many particles.
    pub(crate) fn len(&self) -> usize {
        self.field.len
    }

    /// How often the accelerations were computed.
    pub(crate) fn evaluations(&self) -> u64 {
        self.field.evaluations
    }

    /// Sets D of each particle, for steps of another length.
    pub(crate) fn set_factor(&mut self, factor: &[R]) {
        if let Scheme::Euler(euler) = &mut self.scheme {
            euler.set_factor(factor);
        }
    }

    /// Forgets what it knows of the state it saw last: the next one is another.
    pub(crate) fn forget(&mut self) {
        if let Scheme::Verlet(verlet) = &mut self.scheme {
            verlet.forget();
        }
    }

    /// Takes one step of h seconds.
    pub(crate) fn step(&mut self, h: f64, turn: Turn, state: &mut State<R>) {
        match &mut self.scheme {
            Scheme::Euler(euler) => euler.step(&mut self.field, R::nearest(h), state),
            Scheme::Verlet(verlet) => verlet.step(&mut self.field, h, state),
            Scheme::RungeKutta(method) => method.step(&mut self.field, R::nearest(h), state),
        }
        if self.rests && turn.is_due() {
            come_to_rest(&self.rest, state);
        }
    }
}

fn come_to_rest<R: Real>(rest: &[R], state: &mut State<R>) {
    for column in state.v.chunks_exact_mut(rest.len().max(1)) {
        column.iter_mut().zip(rest).for_each(|(v, rest)| *v = v.at_rest_below(*rest));
    }
    for (v, lost) in state.v.iter().zip(&mut state.lost_v) {
        *lost = if *v == R::ZERO { R::ZERO } else { *lost };
    }
}

/// What accelerates the particles of a system.
#[derive(Debug)]
struct Field<'a, R> {
    level: Level,
    threads: &'a Threads,
    cancelled: &'a AtomicBool,
    len: usize,
    stride: usize,
    /// a + w F.
    acceleration: Vec<R>,
    /// Whether it is not 0 for all.
    falls: bool,
    /// k₁ w, and with it λ where damping is part of the differential equation; empty when it is 0 for all.
    linear: Vec<R>,
    /// k₂ w; empty when it is 0 for all.
    quadratic: Vec<R>,
    attraction: Option<Attraction<R>>,
    evaluations: u64,
}

impl<'a, R: Real> Field<'a, R> {
    fn new(
        level: Level,
        threads: &'a Threads,
        cancelled: &'a AtomicBool,
        laws: &Laws<R>,
        continuous_damping: bool,
    ) -> Self {
        let len = laws.acceleration.len();
        let k = |which: usize, i: usize| laws.drag.get(i).map_or(R::ZERO, |k| k[which]);
        let rate = |damping: R| R::nearest(Decay::of(damping).rate());
        let damped = |i: usize| if continuous_damping { rate(laws.damping[i]) } else { R::ZERO };
        let column = |value: &dyn Fn(usize) -> R| {
            let values: Vec<R> = (0..len).map(value).collect();
            if values.iter().all(|x| *x == R::ZERO) { Vec::new() } else { padded(&values, R::ZERO) }
        };
        Self {
            level,
            threads,
            cancelled,
            len,
            stride: stride::<R>(len),
            acceleration: to_columns(&laws.acceleration),
            falls: laws.acceleration.iter().any(|a| *a != [R::ZERO; 3]),
            linear: column(&|i| k(0, i) + damped(i)),
            quadratic: column(&|i| k(1, i)),
            attraction: laws.gravitation.as_ref().map(Attraction::new),
            evaluations: 0,
        }
    }

    /// Whether nobody waits for the result any more.
    fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }

    /// The acceleration by gravitation alone.
    fn attract(&mut self, p: &[R], into: &mut [R]) {
        let attraction = self.attraction.as_mut().expect("asked for only where there is gravitation");
        self.evaluations += 1;
        attraction.evaluate(self.level, self.threads, self.cancelled, p, into);
    }

    /// The whole acceleration: ((a + w F) + gravitation) − (k₁ w + k₂ w |v|) v.
    fn accelerate(&mut self, p: &[R], v: &[R], into: &mut [R]) {
        if self.attraction.is_some() {
            self.attract(p, into);
            if self.falls {
                dispatch!(self.level, simd => add(simd, into, &self.acceleration));
            }
        } else {
            self.evaluations += 1;
            into.copy_from_slice(&self.acceleration);
        }
        if !self.linear.is_empty() || !self.quadratic.is_empty() {
            let (linear, quadratic) = (self.linear.as_slice(), self.quadratic.as_slice());
            dispatch!(self.level, simd => resist(simd, self.stride, linear, quadratic, v, into));
        }
    }
}

#[inline(always)]
fn add<S: Simd, R: Real>(_: S, to: &mut [R], other: &[R]) {
    to.iter_mut().zip(other).for_each(|(x, y)| *x = *y + *x);
}

/// Takes the acceleration by drag away: a ← a − (k₁ + k₂ |v|) v.
#[inline(always)]
fn resist<S: Simd, R: Real>(_: S, stride: usize, linear: &[R], quadratic: &[R], v: &[R], a: &mut [R]) {
    let (vx, rest) = v.split_at(stride);
    let (vy, vz) = rest.split_at(stride);
    let (ax, rest) = a.split_at_mut(stride);
    let (ay, az) = rest.split_at_mut(stride);
    let vz = &vz[..stride];
    let az = &mut az[..stride];
    for i in 0..stride {
        let mut rate = if linear.is_empty() { R::ZERO } else { linear[i] };
        if !quadratic.is_empty() {
            rate = rate + quadratic[i] * (vx[i] * vx[i] + vy[i] * vy[i] + vz[i] * vz[i]).square_root();
        }
        ax[i] = ax[i] - rate * vx[i];
        ay[i] = ay[i] - rate * vy[i];
        az[i] = az[i] - rate * vz[i];
    }
}

/// Adds to a sum that keeps what rounding takes from it (Kahan and Babuška).
#[inline(always)]
fn add_compensated<R: Real>(sum: &mut R, lost: &mut R, more: R) {
    DoubleDouble { hi: *sum, lo: *lost } = DoubleDouble::sum(*sum, more + *lost);
}

/// |x|, also where its square overflows.
pub(crate) fn norm(x: [f64; 3]) -> f64 {
    let largest = x.into_iter().fold(0.0, |largest: f64, x| largest.max(x.abs()));
    if largest == 0.0 {
        return 0.0;
    }
    let [x, y, z] = x.map(|x| x / largest);
    largest * (x * x + y * y + z * z).sqrt()
}
