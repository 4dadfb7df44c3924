//! What the machine can do: memory bandwidth and the add/mul peak.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use std::hint::black_box;
use std::time::Instant;

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, SimdFloatElement, dispatch};
use pointmass::Real;

use crate::compare::{Bench, Case, Cell, Column, Contender, Group};

pub(crate) const MACHINE: Group = Group {
    name: "machine",
    title: "The machine itself",
    note: "Arrays as large as position and velocity of that many particles. Bytes read and bytes written both count. \
           The in-place update reads and writes both arrays, as a step does. The peak is of adds and multiplies that \
           round on their own, in independent registers, on one thread.",
    size: "particles",
    columns: &[
        Column("copy, GB/s", Cell::Rate("copy")),
        Column("copy, 2 threads", Cell::Rate("copy, 2 threads")),
        Column("in-place update, GB/s", Cell::Rate("in-place update")),
        Column("in-place update, 2 threads", Cell::Rate("in-place update, 2 threads")),
        Column("peak, Gop/s", Cell::Rate("add/mul peak")),
    ],
    run: |bench| {
        for n in bench.powers_of_ten(6, 7) {
            compare::<f32>(bench, n);
            compare::<f64>(bench, n);
        }
    },
};

fn compare<R: Number>(bench: &mut Bench, n: usize) {
    let case = Case { precision: R::PRECISION, scene: "arrays".to_owned(), size: n };
    bench.compare(&case, || {
        let moved = 12 * n * size_of::<R>();
        vec![
            copy::<R>("copy", moved, n, 1),
            copy::<R>("copy, 2 threads", moved, n, 2),
            update::<R>("in-place update", moved, n, 1),
            update::<R>("in-place update, 2 threads", moved, n, 2),
            peak::<R>(PEAK_OPERATIONS, PEAK_OPERATIONS),
        ]
    });
}

/// A number with its vector registers and the pow of the platform.
pub(crate) trait Number: Real + SimdFloatElement {
    type Register<S: Simd>: SimdFloat<S, Element = Self>;
    fn powf(self, exponent: Self) -> Self;
}

impl Number for f32 {
    type Register<S: Simd> = S::f32s;
    #[expect(clippy::disallowed_methods, reason = "the book calls the pow of the platform; no state comes of it")]
    fn powf(self, exponent: Self) -> Self {
        self.powf(exponent)
    }
}

impl Number for f64 {
    type Register<S: Simd> = S::f64s;
    #[expect(clippy::disallowed_methods, reason = "the book calls the pow of the platform; no state comes of it")]
    fn powf(self, exponent: Self) -> Self {
        self.powf(exponent)
    }
}

/// Copies two arrays of `n` vectors.
fn copy<R: Number>(name: &'static str, operations: usize, n: usize, threads: usize) -> Contender {
    in_halves(name, operations, vec![R::ONE; 6 * n], vec![R::ZERO; 6 * n], threads, |from: &mut [R], to| {
        to.copy_from_slice(from);
    })
}

/// Reads and writes two arrays of `n` vectors, with as little arithmetic as there can be.
pub(crate) fn update<R: Number>(name: &'static str, operations: usize, n: usize, threads: usize) -> Contender {
    let level = Level::new();
    in_halves(name, operations, vec![R::ONE; 3 * n], vec![R::ONE; 3 * n], threads, move |p: &mut [R], v| {
        dispatch!(level, simd => update_registers(simd, p, v));
    })
}

#[inline(always)]
fn update_registers<S: Simd, R: Number>(simd: S, p: &mut [R], v: &mut [R]) {
    let lanes = R::Register::<S>::LEN;
    let small = R::Register::<S>::splat(simd, R::nearest(0.001));
    for (p, v) in p.chunks_exact_mut(lanes).zip(v.chunks_exact_mut(lanes)) {
        let (x, u) = (R::Register::<S>::from_slice(simd, p), R::Register::<S>::from_slice(simd, v));
        (x + u).store_slice(p);
        (u + small).store_slice(v);
    }
}

/// Each thread has its part of two arrays, through all iterations, and starts once.
fn in_halves<R: Number>(
    name: &'static str,
    operations: usize,
    mut a: Vec<R>,
    mut b: Vec<R>,
    threads: usize,
    work: impl Fn(&mut [R], &mut [R]) + Sync + 'static,
) -> Contender {
    Contender::timing_itself(name, operations, move |iterations| {
        let part = a.len().div_ceil(threads);
        let start = Instant::now();
        let run = |a: &mut [R], b: &mut [R]| (0..iterations).for_each(|_| work(black_box(a), black_box(b)));
        if threads == 1 {
            run(&mut a, &mut b);
        } else {
            std::thread::scope(|scope| {
                for (a, b) in a.chunks_mut(part).zip(b.chunks_mut(part)) {
                    scope.spawn(|| run(a, b));
                }
            });
        }
        start.elapsed()
    })
}

/// Enough that the call does not count.
pub(crate) const PEAK_OPERATIONS: usize = 1 << 20;

/// The time of so many adds and multiplies, half of each, in registers; `operations` is what they are counted as.
pub(crate) fn peak<R: Number>(arithmetic: usize, operations: usize) -> Contender {
    let level = Level::new();
    Contender::new("add/mul peak", operations, move || {
        let mut out = [R::ZERO; 64];
        dispatch!(level, simd => all_chains(simd, arithmetic, &mut out));
        black_box(out);
    })
}

/// As many as hide the latency of an add and a multiply, and as there are registers for.
#[inline(always)]
fn all_chains<S: Simd, R: Number>(simd: S, arithmetic: usize, out: &mut [R]) {
    if size_of::<R>() * R::Register::<S>::LEN == 64 {
        chains::<S, R, 24>(simd, arithmetic, out);
    } else {
        chains::<S, R, 16>(simd, arithmetic, out);
    }
}

/// Chains that do not wait for each other; none overflows, and none decays.
#[inline(always)]
fn chains<S: Simd, R: Number, const CHAINS: usize>(simd: S, arithmetic: usize, out: &mut [R]) {
    let lanes = R::Register::<S>::LEN;
    let [one, half]: [R::Register<S>; 2] = black_box([R::ONE, R::HALF]).map(|x| R::Register::<S>::splat(simd, x));
    let mut x = [one; CHAINS];
    for _ in 0..arithmetic.div_ceil(2 * CHAINS * lanes) {
        for x in &mut x {
            *x = (*x + one) * half;
        }
    }
    let sum = x.into_iter().reduce(|a, b| a + b).expect("there are chains");
    sum.store_slice(&mut out[..lanes]);
}
