//! Positions and velocities after a time, from those at its start.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, dispatch, f64x4};

use super::lanes::LANES_MAX;
use super::{Among, ClosedForm};
use crate::real::Real;

/// Registers of doubles that are computed together: whole particles, also of registers of singles.
const TOGETHER: usize = 6;

/// The same form and acceleration for all particles.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Same {
    form: ClosedForm,
    acceleration: [f64; 3],
}

impl Same {
    pub(crate) fn new(form: ClosedForm, acceleration: [f64; 3]) -> Self {
        Self { form, acceleration }
    }

    /// Takes positions and velocities along the closed form.
    pub(crate) fn carry<R: Real>(&self, level: Level, p: &mut [[R; 3]], v: &mut [[R; 3]]) {
        dispatch!(level, simd => carry(simd, &Held::new(simd, self), p.as_flattened_mut(), v.as_flattened_mut()));
    }
}

/// The registers of `Same`.
struct Held<S: Simd> {
    form: [S::f64s; 4],
    /// x, y and z fill three registers before they begin anew.
    acceleration: [S::f64s; 3],
}

impl<S: Simd> Held<S> {
    #[inline(always)]
    fn new(simd: S, same: &Same) -> Self {
        let ClosedForm { kept, phi, psi, rest } = same.form;
        let splat = |value| S::f64s::splat(simd, value);
        let lanes = S::f64s::LEN;
        let register = |k| S::f64s::from_fn(simd, |lane| same.acceleration[(k * lanes + lane) % 3]);
        Self {
            form: [splat(kept), splat(phi), splat(psi), splat(rest)],
            acceleration: [register(0), register(1), register(2)],
        }
    }

    /// E, φ, ψ, `rest` and A of the `k`th register.
    #[inline(always)]
    fn terms(&self, k: usize) -> [S::f64s; 5] {
        let [kept, phi, psi, rest] = self.form;
        [kept, phi, psi, rest, self.acceleration[k % 3]]
    }
}

/// Positions and velocities of some particles.
pub(crate) type Motion<'a, R> = (&'a [[R; 3]], &'a [[R; 3]]);

/// Takes each of some particles along the one of the forms that it names, and writes where it is then.
pub(crate) fn carry_each<R: Real>(
    level: Level,
    forms: (&[ClosedForm], &[u32]),
    accelerations: Among<'_, [f64; 3]>,
    from: Motion<'_, R>,
    (to_p, to_v): (&mut [[R; 3]], &mut [[R; 3]]),
) {
    let from = (from.0.as_flattened(), from.1.as_flattened());
    let to = (to_p.as_flattened_mut(), to_v.as_flattened_mut());
    dispatch!(level, simd => match accelerations {
        Among::Uniform(a) => each(simd, forms, std::iter::repeat(&a), from, to),
        Among::Each(a) => each(simd, forms, a, from, to),
    });
}

/// A register holds the three components of a particle, so that its form is loaded into all lanes at once. In the fourth
/// lane is what comes behind the particle, and is written anew when its turn comes.
#[inline(always)]
fn each<'a, S: Simd, R: Real>(
    simd: S,
    (forms, named): (&[ClosedForm], &[u32]),
    accelerations: impl IntoIterator<Item = &'a [f64; 3]>,
    (from_p, from_v): (&[R], &[R]),
    (to_p, to_v): (&mut [R], &mut [R]),
) {
    let len = 3 * named.len();
    let (from_p, from_v, to_p, to_v) = (&from_p[..len], &from_v[..len], &mut to_p[..len], &mut to_v[..len]);
    let Some((last, named)) = named.split_last() else { return };
    let mut accelerations = accelerations.into_iter();
    let mut next = || *accelerations.next().expect("as many as particles");
    let mut at = 0;
    for name in named {
        // It never does; but so the bound is looked at once, and not in each of the four slices.
        if at + 4 > len {
            break;
        }
        let here = at..at + 4;
        let (p, v) = carry_four(simd, forms[*name as usize], next(), &from_p[here.clone()], &from_v[here.clone()]);
        R::store_four(p, &mut to_p[here.clone()]);
        R::store_four(v, &mut to_v[here]);
        at += 3;
    }
    let alone = |numbers: &[R]| -> [R; 4] { std::array::from_fn(|k| *numbers.get(at + k).unwrap_or(&R::ZERO)) };
    let (p, v) = carry_four(simd, forms[*last as usize], next(), &alone(from_p), &alone(from_v));
    for (end, to) in [(p, to_p), (v, to_v)] {
        let mut four = [R::ZERO; 4];
        R::store_four(end, &mut four);
        to[at..].copy_from_slice(&four[..3]);
    }
}

#[inline(always)]
fn carry_four<S: Simd, R: Real>(
    simd: S,
    form: ClosedForm,
    [x, y, z]: [f64; 3],
    p: &[R],
    v: &[R],
) -> (f64x4<S>, f64x4<S>) {
    let ClosedForm { kept, phi, psi, rest } = form;
    let [kept, phi, psi, rest] = [kept, phi, psi, rest].map(|of| f64x4::splat(simd, of));
    let a = f64x4::from_slice(simd, &[x, y, z, 0.0]);
    carry_register(simd, [kept, phi, psi, rest, a], R::load_four(simd, p), R::load_four(simd, v))
}

#[inline(always)]
fn carry<S: Simd, R: Real>(simd: S, held: &Held<S>, p: &mut [R], v: &mut [R]) {
    let len = TOGETHER * S::f64s::LEN;
    let (mut p, mut v) = (p.chunks_exact_mut(len), v.chunks_exact_mut(len));
    for (p, v) in p.by_ref().zip(v.by_ref()) {
        carry_together(simd, held, p, v);
    }
    let (p, v) = (p.into_remainder(), v.into_remainder());
    if !p.is_empty() {
        let (mut own_p, mut own_v) = ([R::ZERO; TOGETHER * LANES_MAX], [R::ZERO; TOGETHER * LANES_MAX]);
        own_p[..p.len()].copy_from_slice(p);
        own_v[..v.len()].copy_from_slice(v);
        carry_together(simd, held, &mut own_p[..len], &mut own_v[..len]);
        p.copy_from_slice(&own_p[..p.len()]);
        v.copy_from_slice(&own_v[..v.len()]);
    }
}

#[inline(always)]
fn carry_together<S: Simd, R: Real>(simd: S, held: &Held<S>, p: &mut [R], v: &mut [R]) {
    let pair = 2 * S::f64s::LEN;
    for (k, (p, v)) in p.chunks_exact_mut(pair).zip(v.chunks_exact_mut(pair)).enumerate() {
        let (places, speeds) = (R::load(simd, p), R::load(simd, v));
        let first = carry_register(simd, held.terms(2 * k), places.0, speeds.0);
        let second = carry_register(simd, held.terms(2 * k + 1), places.1, speeds.1);
        R::store::<S>((first.0, second.0), p);
        R::store::<S>((first.1, second.1), v);
    }
}

/// Computed in double, before it is rounded once. A damped velocity that has become too small to matter is a zero of its
/// own sign. The terms are E, φ, ψ, `rest` and A.
#[inline(always)]
fn carry_register<S: Simd, V: SimdFloat<S, Element = f64>>(simd: S, terms: [V; 5], p: V, v: V) -> (V, V) {
    let [kept, phi, psi, rest, a] = terms;
    let zero = V::splat(simd, 0.0);
    let speed = v * kept + a * phi;
    let is_slow = speed.abs().simd_lt(rest);
    let is_still = rest.simd_lt(zero);
    let speed = is_slow.select(zero.copysign(speed), speed);
    (is_still.select(p, p + (v * phi + a * psi)), is_still.select(v, speed))
}

impl ClosedForm {
    /// Takes one particle along.
    pub(crate) fn carry<R: Real>(&self, level: Level, acceleration: [f64; 3], p: &mut [R; 3], v: &mut [R; 3]) {
        Same::new(*self, acceleration).carry(level, std::slice::from_mut(p), std::slice::from_mut(v));
    }
}
