//! The stepped integrators: the one loop over particles and steps.
//!
//! Positions and velocities are flat lists of components, so that a vector register holds components of several
//! particles. A group of registers stays loaded for all steps of an advance. The arithmetic is written once and compiled
//! for every instruction set; which one runs is found out once, when the world is made.
//!
//! Every multiplication and every addition rounds on its own, in the precision of the world, so that all instruction
//! sets give the same bits. A fused multiply-add would be faster, and would give other bits where there is none.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]
#![expect(clippy::too_many_arguments, reason = "a hot loop gets plain arguments")]

#[cfg(test)]
pub(crate) mod tests;

use std::ops::{Add, Mul};

use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, SimdMask, dispatch};

use crate::error::Quantity;
use crate::filled::filled;
use crate::integrator::Integrator;
use crate::prefetch::fetch_ahead;
use crate::real::Real;

/// The step of one advance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step<R> {
    pub(crate) integrator: Integrator,
    /// The length h of a step in seconds.
    pub(crate) h: R,
    /// Whether memory is fetched ahead.
    pub(crate) fetches: bool,
}

/// What moves the particles of a block, constant through the advance.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Drive<'a, R> {
    pub(crate) acceleration: Acceleration<'a, R>,
    pub(crate) damping: Damping<'a, R>,
}

/// A, with the share of the force.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Acceleration<'a, R> {
    /// The same for all.
    Uniform([R; 3]),
    /// One for each component of each particle.
    Each(&'a [R]),
}

/// D, the damping over one step.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Damping<'a, R> {
    /// 1 for all: nothing is damped, and nothing comes to rest.
    None,
    /// The same for all, of a damping below 1.
    Uniform(R),
    /// One for each component of each particle, all of dampings below 1.
    Each(&'a [R]),
    /// The same where some dampings are 1: also below which magnitude a velocity comes to rest, 0 for those.
    Mixed { factor: &'a [R], rest: &'a [R] },
}

impl<'a, R: Real> Drive<'a, R> {
    /// The same with other lists in place of its own.
    fn map_lists(self, mut to: impl FnMut(&'a [R]) -> &'a [R]) -> Self {
        let acceleration = match self.acceleration {
            Acceleration::Each(a) => Acceleration::Each(to(a)),
            uniform @ Acceleration::Uniform(_) => uniform,
        };
        let damping = match self.damping {
            Damping::Each(factor) => Damping::Each(to(factor)),
            Damping::Mixed { factor, rest } => Damping::Mixed { factor: to(factor), rest: to(rest) },
            uniform @ (Damping::None | Damping::Uniform(_)) => uniform,
        };
        Self { acceleration, damping }
    }
}

/// A velocity that decays into denormals would cost sixty times a normal step, and comparing it at every step would
/// halve the speed: every so many steps and at the end is enough.
pub(crate) const STEPS_BETWEEN_RESTS: u64 = 64;

/// Components that fill three registers of any instruction set, or a multiple of that: x, y and z then begin anew.
const GROUP: usize = 48;

/// Takes `steps` steps with all components of a block.
pub(crate) fn advance<R: Real>(level: Level, step: Step<R>, drive: Drive<'_, R>, steps: u64, p: &mut [R], v: &mut [R]) {
    assert!(p.len() == v.len());
    if p.len() < GROUP {
        advance_few(level, step, drive, steps, p, v);
    } else {
        advance_groups(level, step, drive, steps, p, v);
    }
}

/// The same with less than a group, beside zeros.
fn advance_few<R: Real>(level: Level, step: Step<R>, drive: Drive<'_, R>, steps: u64, p: &mut [R], v: &mut [R]) {
    let len = p.len();
    let (mut own_p, mut own_v) = ([R::ZERO; GROUP], [R::ZERO; GROUP]);
    own_p[..len].copy_from_slice(p);
    own_v[..len].copy_from_slice(v);
    let mut rooms = [None; 3];
    let mut rooms = rooms.iter_mut();
    let drive = drive.map_lists(|list| {
        let room = rooms.next().expect("one for each list").insert([R::ZERO; GROUP]);
        room[..len].copy_from_slice(list);
        room
    });
    advance_groups(level, step, drive, steps, &mut own_p, &mut own_v);
    p.copy_from_slice(&own_p[..len]);
    v.copy_from_slice(&own_v[..len]);
}

/// The same with at least a group.
fn advance_groups<R: Real>(level: Level, step: Step<R>, drive: Drive<'_, R>, steps: u64, p: &mut [R], v: &mut [R]) {
    match step.integrator {
        Integrator::NewtonEuler => with_acceleration::<R, NewtonEuler>(level, step, drive, steps, p, v),
        Integrator::NewtonEulerQuadratic => with_acceleration::<R, Quadratic>(level, step, drive, steps, p, v),
        Integrator::SemiImplicitEuler => with_acceleration::<R, SemiImplicit>(level, step, drive, steps, p, v),
        Integrator::Exact | Integrator::VelocityVerlet | Integrator::Rk4 | Integrator::Dop853 => {
            unreachable!("only integrators of Euler's kind run here")
        }
    }
}

/// Repeats each number three times: from one for each particle to one for each component.
pub(crate) fn to_components<R: Real>(level: Level, each: &[R], components: &mut [R]) {
    dispatch!(level, simd => repeat_thrice(simd, each, components));
}

#[inline(always)]
fn repeat_thrice<S: Simd, R: Real>(_: S, each: &[R], components: &mut [R]) {
    for (three, value) in components.as_chunks_mut::<3>().0.iter_mut().zip(each) {
        *three = [*value; 3];
    }
}

/// Which of the two is not finite, position before velocity.
pub(crate) fn non_finite<R: Real>(p: &[R], v: &[R]) -> Option<Quantity> {
    if !p.iter().all(|x| x.is_finite()) {
        Some(Quantity::Position)
    } else if !v.iter().all(|x| x.is_finite()) {
        Some(Quantity::Velocity)
    } else {
        None
    }
}

/// The position update of an integrator, on one number or on a register of them.
trait Scheme {
    /// From the start of the step: p, v, and h h ½ A; `kicked` is the velocity at its end.
    fn drift<V: Copy + Add<Output = V> + Mul<Output = V>>(p: V, v: V, kicked: V, h: V, burst: V) -> V;
}

struct NewtonEuler;
struct Quadratic;
struct SemiImplicit;

impl Scheme for NewtonEuler {
    #[inline(always)]
    fn drift<V: Copy + Add<Output = V> + Mul<Output = V>>(p: V, v: V, _: V, h: V, _: V) -> V {
        p + v * h
    }
}

impl Scheme for Quadratic {
    #[inline(always)]
    fn drift<V: Copy + Add<Output = V> + Mul<Output = V>>(p: V, v: V, _: V, h: V, burst: V) -> V {
        (p + v * h) + burst
    }
}

impl Scheme for SemiImplicit {
    #[inline(always)]
    fn drift<V: Copy + Add<Output = V> + Mul<Output = V>>(p: V, _: V, kicked: V, h: V, _: V) -> V {
        p + kicked * h
    }
}

/// One value for each component of a block, as a number or as a register of them.
trait Source<R: Real>: Copy {
    /// What stays in registers through the whole block.
    type Held<S: Simd>: Copy;
    fn hold<S: Simd>(&self, simd: S) -> Self::Held<S>;
    /// The registers of the group that begins at the component `at`, the x of a particle.
    fn registers<S: Simd, const N: usize>(&self, simd: S, held: &Self::Held<S>, at: usize) -> [R::Lanes<S>; N];
}

/// What stays in registers of acceleration, D and rest.
type Held<R, S, A, F, T> = (<A as Source<R>>::Held<S>, <F as Source<R>>::Held<S>, <T as Source<R>>::Held<S>);

/// D of a block, and below which magnitude velocities come to rest; without `DAMPS` neither is looked at.
#[derive(Clone, Copy)]
struct Damper<F, T, const DAMPS: bool> {
    factor: F,
    rest: T,
}

/// The same for all components.
#[derive(Clone, Copy)]
struct Same<R>(R);
/// The same for all particles.
#[derive(Clone, Copy)]
struct Vector<R>([R; 3]);
/// One value for each component.
#[derive(Clone, Copy)]
struct Each<'a, R>(&'a [R]);

impl<R: Real> Source<R> for Same<R> {
    type Held<S: Simd> = R::Lanes<S>;
    #[inline(always)]
    fn hold<S: Simd>(&self, simd: S) -> Self::Held<S> {
        R::Lanes::<S>::splat(simd, self.0)
    }
    #[inline(always)]
    fn registers<S: Simd, const N: usize>(&self, _: S, held: &Self::Held<S>, _: usize) -> [R::Lanes<S>; N] {
        [*held; N]
    }
}

impl<R: Real> Source<R> for Vector<R> {
    /// x, y and z fill three registers before they begin anew.
    type Held<S: Simd> = [R::Lanes<S>; 3];
    #[inline(always)]
    fn hold<S: Simd>(&self, simd: S) -> Self::Held<S> {
        let (lanes, list) = (R::Lanes::<S>::LEN, [self.0; GROUP / 3]);
        load(simd, &list.as_flattened()[..3 * lanes])
    }
    #[inline(always)]
    fn registers<S: Simd, const N: usize>(&self, _: S, held: &Self::Held<S>, _: usize) -> [R::Lanes<S>; N] {
        filled!(k in N => held[k % 3])
    }
}

impl<R: Real> Source<R> for Each<'_, R> {
    type Held<S: Simd> = ();
    #[inline(always)]
    fn hold<S: Simd>(&self, _: S) -> Self::Held<S> {}
    #[inline(always)]
    fn registers<S: Simd, const N: usize>(&self, simd: S, (): &Self::Held<S>, at: usize) -> [R::Lanes<S>; N] {
        load(simd, &self.0[at..at + N * R::Lanes::<S>::LEN])
    }
}

/// `N` registers.
#[inline(always)]
fn load<S: Simd, R: Real, const N: usize>(simd: S, from: &[R]) -> [R::Lanes<S>; N] {
    let lanes = R::Lanes::<S>::LEN;
    filled!(k in N => R::Lanes::<S>::from_slice(simd, &from[k * lanes..(k + 1) * lanes]))
}

/// Writes them where `to` begins.
#[inline(always)]
fn store<S: Simd, L: SimdBase<S>, const N: usize>(registers: [L; N], to: &mut [L::Element]) {
    for k in 0..N {
        registers[k].store_slice(&mut to[k * L::LEN..(k + 1) * L::LEN]);
    }
}

fn with_acceleration<R: Real, K: Scheme>(
    level: Level,
    step: Step<R>,
    drive: Drive<'_, R>,
    steps: u64,
    p: &mut [R],
    v: &mut [R],
) {
    match drive.acceleration {
        Acceleration::Uniform(a) => with_damping::<R, K, _>(level, step, Vector(a), drive.damping, steps, p, v),
        Acceleration::Each(a) => {
            assert!(a.len() == p.len());
            with_damping::<R, K, _>(level, step, Each(a), drive.damping, steps, p, v);
        }
    }
}

fn with_damping<R: Real, K: Scheme, A: Source<R>>(
    level: Level,
    step: Step<R>,
    a: A,
    damping: Damping<'_, R>,
    steps: u64,
    p: &mut [R],
    v: &mut [R],
) {
    match damping {
        Damping::None => {
            let d = Damper::<_, _, false> { factor: Same(R::ONE), rest: Same(R::ZERO) };
            compiled::<R, K, _, _, _, _>(level, step, a, d, steps, p, v);
        }
        Damping::Uniform(factor) => {
            let d = Damper::<_, _, true> { factor: Same(factor), rest: Same(R::REST) };
            compiled::<R, K, _, _, _, _>(level, step, a, d, steps, p, v);
        }
        Damping::Each(factor) => {
            let d = Damper::<_, _, true> { factor: Each(factor), rest: Same(R::REST) };
            compiled::<R, K, _, _, _, _>(level, step, a, d, steps, p, v);
        }
        Damping::Mixed { factor, rest } => {
            let d = Damper::<_, _, true> { factor: Each(factor), rest: Each(rest) };
            compiled::<R, K, _, _, _, _>(level, step, a, d, steps, p, v);
        }
    }
}

fn compiled<R: Real, K: Scheme, A: Source<R>, F: Source<R>, T: Source<R>, const DAMPS: bool>(
    level: Level,
    step: Step<R>,
    a: A,
    d: Damper<F, T, DAMPS>,
    steps: u64,
    p: &mut [R],
    v: &mut [R],
) {
    dispatch!(level, simd => block::<_, R, K, _, _, _, _>(simd, step, a, d, steps, p, v));
}

/// Groups of six registers, which hide the latency of the arithmetic; what is left is moved in groups of three, of which the
/// last has components of those before it as well: one number at a time takes as long as a register of them.
#[inline(always)]
fn block<S: Simd, R: Real, K: Scheme, A: Source<R>, F: Source<R>, T: Source<R>, const DAMPS: bool>(
    simd: S,
    step: Step<R>,
    a: A,
    d: Damper<F, T, DAMPS>,
    steps: u64,
    p: &mut [R],
    v: &mut [R],
) {
    let lanes = R::Lanes::<S>::LEN;
    let held = (a.hold(simd), d.factor.hold(simd), d.rest.hold(simd));
    let len = p.len();
    let sixes = len - len % (6 * lanes);
    let (begins, left) = ([sixes, len - 3 * lanes], len - sixes);
    let threes = if left > 3 * lanes { 0..2 } else { 2 - usize::from(left > 0)..2 };
    // Moved from where they are before any are written: those in two groups end with the same bits both times. A loop, so
    // that the group is compiled once.
    let mut ends = [[[R::Lanes::<S>::splat(simd, R::ZERO); 3]; 2]; 2];
    for k in threes.clone() {
        ends[k] = group::<S, R, K, _, _, _, _, 3>(simd, step, a, d, &held, steps, begins[k], p, v);
    }
    let mut at = 0;
    while at < sixes {
        if step.fetches {
            fetch_ahead(&p[at..at + 6 * lanes]);
            fetch_ahead(&v[at..at + 6 * lanes]);
        }
        let [ps, vs] = group::<S, R, K, _, _, _, _, 6>(simd, step, a, d, &held, steps, at, p, v);
        store(ps, &mut p[at..]);
        store(vs, &mut v[at..]);
        at += 6 * lanes;
    }
    for k in threes {
        store(ends[k][0], &mut p[begins[k]..]);
        store(ends[k][1], &mut v[begins[k]..]);
    }
}

/// Where the group that begins at the component `at` ends.
#[inline(always)]
fn group<S: Simd, R: Real, K: Scheme, A: Source<R>, F: Source<R>, T: Source<R>, const DAMPS: bool, const N: usize>(
    simd: S,
    step: Step<R>,
    a: A,
    d: Damper<F, T, DAMPS>,
    held: &Held<R, S, A, F, T>,
    steps: u64,
    at: usize,
    p: &[R],
    v: &[R],
) -> [[R::Lanes<S>; N]; 2] {
    let end = at + N * R::Lanes::<S>::LEN;
    let mut ps: [R::Lanes<S>; N] = load(simd, &p[at..end]);
    let mut vs: [R::Lanes<S>; N] = load(simd, &v[at..end]);
    let accelerations: [R::Lanes<S>; N] = a.registers(simd, &held.0, at);
    let dampings: [R::Lanes<S>; N] = d.factor.registers(simd, &held.1, at);
    let half_square = R::Lanes::<S>::splat(simd, step.h * step.h * R::HALF);
    let h = R::Lanes::<S>::splat(simd, step.h);
    let kicks: [R::Lanes<S>; N] = filled!(k in N => accelerations[k] * h);
    let bursts: [R::Lanes<S>; N] = filled!(k in N => accelerations[k] * half_square);
    let zero = R::Lanes::<S>::splat(simd, R::ZERO);
    let mut left = steps;
    while left > 0 {
        let some = left.min(STEPS_BETWEEN_RESTS);
        for _ in 0..some {
            for k in 0..N {
                let kicked = if DAMPS { (vs[k] + kicks[k]) * dampings[k] } else { vs[k] + kicks[k] };
                ps[k] = K::drift(ps[k], vs[k], kicked, h, bursts[k]);
                vs[k] = kicked;
            }
        }
        if DAMPS {
            // Hardly ever does anything come to rest; one branch for the group is cheaper than as many selections.
            let rests: [R::Lanes<S>; N] = d.rest.registers(simd, &held.2, at);
            let slow = filled!(k in N => vs[k].abs().simd_lt(rests[k]));
            let mut any = slow[0];
            for slow in &slow[1..] {
                any = any | *slow;
            }
            if any.any_true() {
                for k in 0..N {
                    vs[k] = slow[k].select(zero.copysign(vs[k]), vs[k]);
                }
            }
        }
        left -= some;
    }
    [ps, vs]
}
