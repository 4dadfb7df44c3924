//! Positions and velocities after a time, from those at its start.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, dispatch};

use super::{ClosedForm, LANES_MAX};
use crate::real::Real;

/// Registers of doubles that are computed together: whole particles, also of registers of singles.
const TOGETHER: usize = 6;

/// E, φ, ψ, `rest` and A.
type Five<T> = [T; 5];

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
}

/// Forms and accelerations of some particles, for each of their components.
#[derive(Debug, Default)]
pub(crate) struct Terms {
    spread: Five<Vec<f64>>,
    /// One for each particle, before they are spread: numbers that were just stored one by one are slow to load as a
    /// register.
    each: [Vec<f64>; 4],
}

impl Terms {
    pub(crate) fn set_forms(&mut self, level: Level, forms: impl ExactSizeIterator<Item = ClosedForm>) {
        let count = forms.len();
        self.each.iter_mut().for_each(|column| column.resize(count, 0.0));
        let [kept, phi, psi, rest] = &mut self.each;
        let places = kept.iter_mut().zip(phi).zip(psi.iter_mut().zip(rest));
        for (((kept, phi), (psi, rest)), form) in places.zip(forms) {
            (*kept, *phi, *psi, *rest) = (form.kept, form.phi, form.psi, form.rest);
        }
        for (column, each) in self.spread.iter_mut().zip(&self.each) {
            column.resize(padded(count), 0.0);
            dispatch!(level, simd => spread(simd, each, column));
        }
    }

    /// Lets one of the particles keep every bit.
    pub(crate) fn keep_still(&mut self, index: usize) {
        self.spread[3][3 * index..3 * index + 3].fill(ClosedForm::STILL.rest);
    }

    pub(crate) fn set_accelerations(&mut self, accelerations: impl ExactSizeIterator<Item = [f64; 3]>) {
        let column = &mut self.spread[4];
        column.resize(padded(accelerations.len()), 0.0);
        for (place, acceleration) in column.as_chunks_mut::<3>().0.iter_mut().zip(accelerations) {
            *place = acceleration;
        }
    }

    /// Takes positions and velocities along the closed form.
    pub(crate) fn carry<R: Real>(&self, level: Level, p: &mut [[R; 3]], v: &mut [[R; 3]]) {
        dispatch!(level, simd => carry(simd, self, p.as_flattened_mut(), v.as_flattened_mut()));
    }
}

/// Where registers of terms come from. A trait and not a closure, which is not always inlined.
trait Source<S: Simd> {
    /// Those of the `k`th register from a component on.
    fn terms(&self, simd: S, at: usize, k: usize) -> Five<S::f64s>;
}

impl<S: Simd> Source<S> for Held<S> {
    #[inline(always)]
    fn terms(&self, _: S, _: usize, k: usize) -> Five<S::f64s> {
        let [kept, phi, psi, rest] = self.form;
        [kept, phi, psi, rest, self.acceleration[k % 3]]
    }
}

impl<S: Simd> Source<S> for Terms {
    #[inline(always)]
    fn terms(&self, simd: S, at: usize, k: usize) -> Five<S::f64s> {
        let [kept, phi, psi, rest, a] = &self.spread;
        let (from, to) = (at + k * S::f64s::LEN, at + (k + 1) * S::f64s::LEN);
        [
            S::f64s::from_slice(simd, &kept[from..to]),
            S::f64s::from_slice(simd, &phi[from..to]),
            S::f64s::from_slice(simd, &psi[from..to]),
            S::f64s::from_slice(simd, &rest[from..to]),
            S::f64s::from_slice(simd, &a[from..to]),
        ]
    }
}

/// Components of some particles, filled up to whole registers.
fn padded(count: usize) -> usize {
    (3 * count).next_multiple_of(TOGETHER * LANES_MAX)
}

#[inline(always)]
fn spread<S: Simd>(_: S, each: &[f64], components: &mut [f64]) {
    for (three, value) in components.as_chunks_mut::<3>().0.iter_mut().zip(each) {
        *three = [*value; 3];
    }
}

#[inline(always)]
fn carry<S: Simd, R: Real>(simd: S, source: &impl Source<S>, p: &mut [R], v: &mut [R]) {
    let len = TOGETHER * S::f64s::LEN;
    let (mut p, mut v) = (p.chunks_exact_mut(len), v.chunks_exact_mut(len));
    let mut at = 0;
    for (p, v) in p.by_ref().zip(v.by_ref()) {
        carry_together(simd, source, at, p, v);
        at += len;
    }
    let (p, v) = (p.into_remainder(), v.into_remainder());
    if !p.is_empty() {
        let (mut own_p, mut own_v) = ([R::ZERO; TOGETHER * LANES_MAX], [R::ZERO; TOGETHER * LANES_MAX]);
        own_p[..p.len()].copy_from_slice(p);
        own_v[..v.len()].copy_from_slice(v);
        carry_together(simd, source, at, &mut own_p[..len], &mut own_v[..len]);
        p.copy_from_slice(&own_p[..p.len()]);
        v.copy_from_slice(&own_v[..v.len()]);
    }
}

#[inline(always)]
fn carry_together<S: Simd, R: Real>(simd: S, source: &impl Source<S>, at: usize, p: &mut [R], v: &mut [R]) {
    let pair = 2 * S::f64s::LEN;
    for (k, (p, v)) in p.chunks_exact_mut(pair).zip(v.chunks_exact_mut(pair)).enumerate() {
        let (places, speeds) = (R::load(simd, p), R::load(simd, v));
        let first = carry_register::<S, R>(simd, source.terms(simd, at, 2 * k), places.0, speeds.0);
        let second = carry_register::<S, R>(simd, source.terms(simd, at, 2 * k + 1), places.1, speeds.1);
        R::store::<S>((first.0, second.0), p);
        R::store::<S>((first.1, second.1), v);
    }
}

/// Computed in double, before it is rounded once. A damped velocity that has become too small to matter is a zero of its
/// own sign.
#[inline(always)]
fn carry_register<S: Simd, R: Real>(simd: S, terms: Five<S::f64s>, p: S::f64s, v: S::f64s) -> (S::f64s, S::f64s) {
    let [kept, phi, psi, rest, a] = terms;
    let zero = S::f64s::splat(simd, 0.0);
    let speed = v * kept + a * phi;
    let is_slow = speed.abs().simd_lt(rest * R::REST_UNROUNDED);
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
