//! Newton's law between every pair of particles, summed directly.
//!
//! The attracted particles are lanes of a register, those that attract follow one after the other: so each sum has one order,
//! whatever the registers and threads. Square root and quotient are rounded correctly on every CPU, unlike the
//! approximations of 1/√x that some have. Sums run over blocks of sources, and what the sum of blocks loses is kept, so
//! that a sum of 10⁴ singles is as good as one of a hundred.
//!
//! A tree for worlds where n² is too much belongs beside this file, behind `Attraction`.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use std::sync::atomic::{AtomicBool, Ordering};

use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, SimdMask, dispatch};

use crate::double_double::DoubleDouble;
use crate::real::Real;
use crate::system::{LANES_MAX, Masses, stride};
use crate::threads::Threads;

/// Sources whose attraction is summed before it is added to the sum of others.
pub(super) const BLOCK: usize = 256;

/// The positions and strengths of what attracts.
#[derive(Debug)]
pub(super) struct Attraction<R> {
    softening: R,
    /// Of those that attract, G m.
    strength: Vec<R>,
    /// Which attract; none when all do.
    attracting: Option<Vec<usize>>,
    /// Where those are.
    places: [Vec<R>; 3],
    immovable: Vec<usize>,
    len: usize,
}

/// What attracts, at one moment.
#[derive(Debug, Clone, Copy)]
struct Sources<'a, R> {
    places: [&'a [R]; 3],
    strength: &'a [R],
    softening: R,
    /// Pairs nearer than this, in metres squared, are computed one by one; not a number where all of them are.
    near: R,
}

impl<R: Real> Attraction<R> {
    pub(super) fn new(masses: &Masses<R>) -> Self {
        let len = masses.strength.len();
        let attracting: Vec<usize> = (0..len).filter(|&i| masses.strength[i] > R::ZERO).collect();
        let strength = attracting.iter().map(|&i| masses.strength[i]).collect();
        let attracting = (attracting.len() < len).then_some(attracting);
        let places = [Vec::new(), Vec::new(), Vec::new()];
        Self { softening: masses.softening, strength, attracting, places, immovable: masses.immovable.clone(), len }
    }

    /// The accelerations of all particles at these positions.
    pub(super) fn evaluate(
        &mut self,
        level: Level,
        threads: &Threads,
        cancelled: &AtomicBool,
        p: &[R],
        into: &mut [R],
    ) {
        let stride = stride::<R>(self.len);
        let axis = |k: usize| &p[k * stride..(k + 1) * stride];
        if let Some(attracting) = &self.attracting {
            for (k, places) in self.places.iter_mut().enumerate() {
                places.clear();
                places.extend(attracting.iter().map(|&i| axis(k)[i]));
            }
        }
        let every = [axis(0), axis(1), axis(2)].map(|axis| &axis[..self.len]);
        let places = if self.attracting.is_some() { self.places.each_ref().map(Vec::as_slice) } else { every };
        // Where squares could overflow, every pair is computed on its own.
        let far = dispatch!(level, simd => any_far(simd, p)) || self.softening >= R::FAR;
        let near = if far { R::nearest(f64::NAN) } else { R::NEAR };
        let sources = Sources { places, strength: &self.strength, softening: self.softening, near };
        let (x, rest) = into.split_at_mut(stride);
        let (y, z) = rest.split_at_mut(stride);
        threads.share_columns(self.strength.len() as u64, [x, y, z], |first, to| {
            if cancelled.load(Ordering::Relaxed) {
                return;
            }
            let range = first..first + to[0].len();
            let targets = [0, 1, 2].map(|k| &axis(k)[range.clone()]);
            dispatch!(level, simd => attract(simd, sources, targets, to));
        });
        for &row in &self.immovable {
            (0..3).for_each(|k| into[k * stride + row] = R::ZERO);
        }
    }
}

/// Whether a coordinate is so large that its square may overflow, or is not a number.
#[inline(always)]
fn any_far<S: Simd, R: Real>(simd: S, p: &[R]) -> bool {
    let far = R::Lanes::<S>::splat(simd, R::FAR);
    let mut any = far.simd_lt(far);
    for x in p.chunks_exact(R::Lanes::<S>::LEN) {
        any = any | !R::Lanes::<S>::from_slice(simd, x).abs().simd_lt(far);
    }
    any.any_true()
}

/// Whole registers of targets, two at a time, which hides the latency of the quotients.
#[inline(always)]
fn attract<S: Simd, R: Real>(simd: S, sources: Sources<'_, R>, targets: [&[R]; 3], to: [&mut [R]; 3]) {
    let lanes = R::Lanes::<S>::LEN;
    let [to_x, to_y, to_z] = to;
    let mut at = 0;
    while at + 2 * lanes <= targets[0].len() {
        group::<S, R, 2>(simd, sources, targets, at, [&mut *to_x, &mut *to_y, &mut *to_z]);
        at += 2 * lanes;
    }
    while at + lanes <= targets[0].len() {
        group::<S, R, 1>(simd, sources, targets, at, [&mut *to_x, &mut *to_y, &mut *to_z]);
        at += lanes;
    }
}

#[inline(always)]
fn group<S: Simd, R: Real, const N: usize>(
    simd: S,
    sources: Sources<'_, R>,
    targets: [&[R]; 3],
    at: usize,
    to: [&mut [R]; 3],
) {
    let lanes = R::Lanes::<S>::LEN;
    let splat = |x| R::Lanes::<S>::splat(simd, x);
    let (zero, one, near) = (splat(R::ZERO), splat(R::ONE), splat(sources.near));
    let softening = splat(sources.softening * sources.softening);
    let mut target = [[zero; N]; 3];
    for k in 0..3 {
        for n in 0..N {
            target[k][n] = R::Lanes::<S>::from_slice(simd, &targets[k][at + n * lanes..at + (n + 1) * lanes]);
        }
    }
    let (mut total, mut lost) = ([[zero; N]; 3], [[zero; N]; 3]);
    let [x, y, z] = sources.places.map(|places| places.chunks(BLOCK));
    for (((x, y), z), strength) in x.zip(y).zip(z).zip(sources.strength.chunks(BLOCK)) {
        let mut sum = [[zero; N]; 3];
        for (((x, y), z), strength) in x.iter().zip(y).zip(z).zip(strength) {
            let source = [splat(*x), splat(*y), splat(*z)];
            let gm = splat(*strength);
            for n in 0..N {
                let mut d = [source[0] - target[0][n], source[1] - target[1][n], source[2] - target[2][n]];
                let square = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) + softening;
                let is_ordinary = square.simd_ge(near);
                let mut inverse = one / square.sqrt();
                if !is_ordinary.all_true() {
                    let apart = d[0].abs() + d[1].abs() + d[2].abs();
                    inverse = is_ordinary.select(inverse, zero);
                    for d in &mut d {
                        *d = is_ordinary.select(*d, zero);
                    }
                    let place = [target[0][n], target[1][n], target[2][n]];
                    // Mostly it is a particle and itself.
                    if !(is_ordinary | apart.simd_eq(zero)).all_true() {
                        let alone = one_by_one::<S, R>(simd, sources, [*x, *y, *z], *strength, place, square);
                        for k in 0..3 {
                            sum[k][n] = sum[k][n] + alone[k];
                        }
                    }
                }
                // The magnitude, and then its share: nothing on the way is larger or smaller than the result.
                let magnitude = gm * (inverse * inverse);
                for k in 0..3 {
                    sum[k][n] = sum[k][n] + magnitude * (d[k] * inverse);
                }
            }
        }
        for k in 0..3 {
            for n in 0..N {
                let DoubleDouble { hi, lo } = DoubleDouble::sum(total[k][n], sum[k][n]);
                total[k][n] = hi;
                lost[k][n] = lost[k][n] + lo;
            }
        }
    }
    for (k, to) in to.into_iter().enumerate() {
        for n in 0..N {
            (total[k][n] + lost[k][n]).store_slice(&mut to[at + n * lanes..at + (n + 1) * lanes]);
        }
    }
}

/// The attraction of lanes that are near a source; 0 in the others. Hardly ever more than that of a particle by itself.
#[cold]
#[inline(never)]
fn one_by_one<S: Simd, R: Real>(
    simd: S,
    sources: Sources<'_, R>,
    source: [R; 3],
    strength: R,
    target: [R::Lanes<S>; 3],
    square: R::Lanes<S>,
) -> [R::Lanes<S>; 3] {
    let lanes = R::Lanes::<S>::LEN;
    let store = |register: R::Lanes<S>| {
        let mut values = [R::ZERO; LANES_MAX];
        register.store_slice(&mut values[..lanes]);
        values
    };
    let (target, square) = (target.map(store), store(square));
    let mut alone = [[R::ZERO; LANES_MAX]; 3];
    for lane in 0..lanes {
        let is_ordinary = square[lane] >= sources.near;
        if !is_ordinary {
            let place = [target[0][lane], target[1][lane], target[2][lane]];
            let pull = pull(source, strength, place, sources.softening);
            (0..3).for_each(|k| alone[k][lane] = pull[k]);
        }
    }
    alone.map(|values| R::Lanes::<S>::from_slice(simd, &values[..lanes]))
}

/// The attraction of one particle by another at any distance; 0 where both are at the same place. Lengths are in units of the
/// largest, so that squares neither overflow nor vanish.
pub(super) fn pull<R: Real>(source: [R; 3], strength: R, target: [R; 3], softening: R) -> [R; 3] {
    if source == target {
        return [R::ZERO; 3];
    }
    // Halves, whose difference is finite.
    let d: [f64; 3] = std::array::from_fn(|k| 0.5 * source[k].into() - 0.5 * target[k].into());
    let softening = 0.5 * softening.into();
    let largest = d.into_iter().fold(softening, |largest, d| largest.max(d.abs()));
    let [x, y, z] = d.map(|d| d / largest);
    let soft = softening / largest;
    let inverse = 1.0 / (x * x + y * y + z * z + soft * soft).sqrt();
    let magnitude = 0.25 * (strength.into() * (inverse * inverse)) / largest / largest;
    [x, y, z].map(|x| R::nearest(magnitude * (x * inverse)))
}
