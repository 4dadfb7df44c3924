//! Positions and velocities after a time, from those at its start.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use std::slice;

use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, dispatch, f64x4};

use super::lanes::LANES_MAX;
use super::{Among, ClosedForm};
use crate::prefetch::fetch_ahead;
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

    /// Takes positions and velocities along the closed form, and writes where they are then.
    /// `fetches`: with [`fetch_ahead`].
    pub(crate) fn carry<R: Real>(
        &self,
        level: Level,
        fetches: bool,
        from: Motion<'_, R>,
        (to_p, to_v): MotionMut<'_, R>,
    ) {
        assert!(from.0.len() == to_p.len() && from.1.len() == to_v.len() && to_p.len() == to_v.len());
        if self.form.is_still() {
            to_p.copy_from_slice(from.0);
            to_v.copy_from_slice(from.1);
            return;
        }
        let from = (from.0.as_flattened(), from.1.as_flattened());
        let to = (to_p.as_flattened_mut(), to_v.as_flattened_mut());
        dispatch!(level, simd => {
            let held = Held::new(simd, self);
            if self.form.rest > 0.0 {
                carry::<_, _, true>(simd, &held, fetches, from, to);
            } else {
                carry::<_, _, false>(simd, &held, fetches, from, to);
            }
        });
    }
}

/// The registers of `Same`.
struct Held<S: Simd> {
    kept: S::f64s,
    phi: S::f64s,
    rest: S::f64s,
    /// A φ and A ψ: x, y and z fill three registers before they begin anew.
    kick: [S::f64s; 3],
    drift: [S::f64s; 3],
}

impl<S: Simd> Held<S> {
    #[inline(always)]
    fn new(simd: S, same: &Same) -> Self {
        let ClosedForm { kept, phi, psi, rest } = same.form;
        let splat = |value| S::f64s::splat(simd, value);
        let lanes = S::f64s::LEN;
        let register = |k| S::f64s::from_fn(simd, |lane| same.acceleration[(k * lanes + lane) % 3]);
        let a = [register(0), register(1), register(2)];
        let (phi, psi) = (splat(phi), splat(psi));
        Self {
            kept: splat(kept),
            phi,
            rest: splat(rest),
            kick: [a[0] * phi, a[1] * phi, a[2] * phi],
            drift: [a[0] * psi, a[1] * psi, a[2] * psi],
        }
    }
}

/// Positions and velocities of some particles.
pub(crate) type Motion<'a, R> = (&'a [[R; 3]], &'a [[R; 3]]);

/// Room for as many.
pub(crate) type MotionMut<'a, R> = (&'a mut [[R; 3]], &'a mut [[R; 3]]);

/// Takes each of some particles along the one of the forms that it names, and writes where it is then.
pub(crate) fn carry_each<R: Real>(
    level: Level,
    fetches: bool,
    forms: (&[ClosedForm], &[u32]),
    accelerations: Among<'_, [f64; 3]>,
    from: Motion<'_, R>,
    (to_p, to_v): MotionMut<'_, R>,
) {
    let from = (from.0.as_flattened(), from.1.as_flattened());
    let to = (to_p.as_flattened_mut(), to_v.as_flattened_mut());
    dispatch!(level, simd => match accelerations {
        Among::Uniform(a) => each(simd, fetches, forms, std::iter::repeat(&a), from, to),
        Among::Each(a) => each(simd, fetches, forms, a, from, to),
    });
}

/// A register holds the three components of a particle, so that its form is loaded into all lanes at once. In the fourth
/// lane is what comes behind the particle, and is written anew when its turn comes.
#[inline(always)]
fn each<'a, S: Simd, R: Real>(
    simd: S,
    fetches: bool,
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
        if fetches {
            for list in [from_p, from_v, to_p, to_v] {
                fetch_ahead(&list[here.clone()]);
            }
        }
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

/// Computed in double, before it is rounded once. A damped velocity that has become too small to matter is a zero of its
/// own sign.
#[inline(always)]
fn carry_four<S: Simd, R: Real>(
    simd: S,
    form: ClosedForm,
    [x, y, z]: [f64; 3],
    p: &[R],
    v: &[R],
) -> (f64x4<S>, f64x4<S>) {
    let (p, v) = (R::load_four(simd, p), R::load_four(simd, v));
    // Few are, and a branch is cheaper than a selection for each.
    if form.is_still() {
        return (p, v);
    }
    let [kept, phi, psi, rest] = [form.kept, form.phi, form.psi, form.rest].map(|of| f64x4::splat(simd, of));
    let a = f64x4::from_slice(simd, &[x, y, z, 0.0]);
    let speed = v * kept + a * phi;
    let is_slow = speed.abs().simd_lt(rest);
    let speed = is_slow.select(f64x4::splat(simd, 0.0).copysign(speed), speed);
    (p + (v * phi + a * psi), speed)
}

/// `RESTS`: some velocities may come to rest.
#[inline(always)]
fn carry<S: Simd, R: Real, const RESTS: bool>(
    simd: S,
    held: &Held<S>,
    fetches: bool,
    (from_p, from_v): (&[R], &[R]),
    (to_p, to_v): (&mut [R], &mut [R]),
) {
    let len = TOGETHER * S::f64s::LEN;
    let from = from_p.chunks(len).zip(from_v.chunks(len));
    for ((p, v), (to_p, to_v)) in from.zip(to_p.chunks_mut(len).zip(to_v.chunks_mut(len))) {
        if fetches {
            for part in [p, v, to_p, to_v] {
                fetch_ahead(part);
            }
        }
        if p.len() == len {
            carry_together::<_, _, RESTS>(simd, held, (p, v), (to_p, to_v));
        } else {
            let [mut own_p, mut own_v, mut end_p, mut end_v] = [[R::ZERO; TOGETHER * LANES_MAX]; 4];
            own_p[..p.len()].copy_from_slice(p);
            own_v[..v.len()].copy_from_slice(v);
            let (own, end) = ((&own_p[..len], &own_v[..len]), (&mut end_p[..len], &mut end_v[..len]));
            carry_together::<_, _, RESTS>(simd, held, own, end);
            to_p.copy_from_slice(&end_p[..p.len()]);
            to_v.copy_from_slice(&end_v[..v.len()]);
        }
    }
}

#[inline(always)]
fn carry_together<S: Simd, R: Real, const RESTS: bool>(
    simd: S,
    held: &Held<S>,
    (from_p, from_v): (&[R], &[R]),
    (to_p, to_v): (&mut [R], &mut [R]),
) {
    let pair = 2 * S::f64s::LEN;
    let zero = S::f64s::splat(simd, 0.0);
    let (mut p, mut v) = ([zero; TOGETHER], [zero; TOGETHER]);
    for k in 0..TOGETHER / 2 {
        (p[2 * k], p[2 * k + 1]) = R::load(simd, &from_p[k * pair..(k + 1) * pair]);
        (v[2 * k], v[2 * k + 1]) = R::load(simd, &from_v[k * pair..(k + 1) * pair]);
    }
    for k in 0..TOGETHER {
        p[k] = p[k] + (v[k] * held.phi + held.drift[k % 3]);
        v[k] = v[k] * held.kept + held.kick[k % 3];
        if RESTS {
            let is_slow = v[k].abs().simd_lt(held.rest);
            v[k] = is_slow.select(zero.copysign(v[k]), v[k]);
        }
    }
    for k in 0..TOGETHER / 2 {
        R::store::<S>((p[2 * k], p[2 * k + 1]), &mut to_p[k * pair..(k + 1) * pair]);
        R::store::<S>((v[2 * k], v[2 * k + 1]), &mut to_v[k * pair..(k + 1) * pair]);
    }
}

impl ClosedForm {
    /// Takes one particle along.
    pub(crate) fn carry<R: Real>(&self, level: Level, acceleration: [f64; 3], p: &mut [R; 3], v: &mut [R; 3]) {
        let (from_p, from_v) = ([*p], [*v]);
        let to = (slice::from_mut(p), slice::from_mut(v));
        Same::new(*self, acceleration).carry(level, false, (&from_p, &from_v), to);
    }
}
