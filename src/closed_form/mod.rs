//! The motion of a particle under a constant acceleration and damping, in closed form.
//!
//! With damping `d` the velocity obeys `v' = A - λ v`, `λ = -ln d`. Over a time `t`, with `z = λ t` and `E = dᵗ`:
//!
//! ```text
//! v(t) = v₀ E + A φ           φ = t  (1 - e⁻ᶻ) / z
//! p(t) = p₀ + (v₀ φ + A ψ)    ψ = t² (z - 1 + e⁻ᶻ) / z²
//! ```
//!
//! It is the limit of the book's integrator (Millington, chapter 3, equations 3.4 to 3.6) for steps of length zero.
//! E, φ and ψ are within 0.55 ulp for every d in [0, 1] and t up to 10¹² s: λ, z and e⁻ᶻ carry about 100, 100 and 65
//! bits, so that neither the cancellation in 1 - E nor the one in t - φ is seen. Only additions, multiplications and
//! divisions are used, each rounded on its own, hence the same bits on every CPU.
//!
//! The arithmetic is written once, for one double and for several registers of them: a scene where many dampings or
//! times differ needs many.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

mod flow;
mod lanes;

use std::cell::Cell;

use fearless_simd::{Level, Simd, dispatch};

use crate::double_double::DoubleDouble;
use crate::real::Real;
pub(crate) use flow::{Motion, MotionMut, Same, carry_each};
use lanes::{LEN_MAX, Lanes, Registers};

/// A value for each of some particles: the same one, or one for each.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Among<'a, T> {
    Uniform(T),
    Each(&'a [T]),
}

/// E, φ and ψ of one damping and one time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct ClosedForm {
    /// E, the share of the velocity that is kept; no unit.
    pub(crate) kept: f64,
    /// φ in seconds.
    pub(crate) phi: f64,
    /// ψ in seconds squared.
    pub(crate) psi: f64,
    /// Velocities of a smaller magnitude come to rest: 0 where there is no damping, -1 where nothing changes at all.
    pub(crate) rest: f64,
}

impl ClosedForm {
    /// Keeps every bit, also the sign of a zero.
    pub(crate) const STILL: Self = Self { kept: 1.0, phi: 0.0, psi: 0.0, rest: -1.0 };

    #[inline(always)]
    fn is_still(&self) -> bool {
        self.rest.is_sign_negative()
    }
}

/// λ of one damping, 1/λ, and the magnitude below which velocities come to rest in m/s.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Decay {
    lambda: DoubleDouble,
    inverse: DoubleDouble,
    rest: f64,
}

impl Decay {
    /// For `0 <= damping <= 1`. A thread remembers the last one: it takes as long as to carry a hundred particles, and most
    /// scenes have one damping.
    pub(crate) fn of<R: Real>(damping: R) -> Self {
        let (damping, rest): (f64, f64) = (damping.into(), R::REST_UNROUNDED);
        thread_local! {
            static LAST: Cell<(f64, Decay)> = Cell::new((f64::NAN, Decay::default()));
        }
        let (last, decay) = LAST.get();
        if last == damping {
            return Self { rest, ..decay };
        }
        let lambda = lambda(damping);
        let decay = Self { lambda, inverse: one(damping) / lambda, rest };
        LAST.set((damping, decay));
        decay
    }

    /// The same with a resistance of `rate` in 1/s, at least 0, beside the damping.
    pub(crate) fn faster_by(self, rate: f64) -> Self {
        if rate == 0.0 || self.lambda.hi == f64::INFINITY {
            return self;
        }
        let lambda = self.lambda + DoubleDouble::from(rate);
        Self { lambda, inverse: DoubleDouble::new(1.0, 0.0) / lambda, ..self }
    }

    /// λ in 1/s, rounded.
    pub(crate) fn rate(&self) -> f64 {
        self.lambda.hi
    }

    /// E, φ and ψ over a time up to 2⁴⁰⁰.
    pub(crate) fn over(&self, time: f64) -> ClosedForm {
        if self.lambda.hi == 0.0 {
            return undamped(time);
        }
        if time == 0.0 {
            return ClosedForm::STILL;
        }
        if !is_ordinary(self.lambda.hi, time) {
            return self.over_extreme(time);
        }
        let [kept, phi, psi] = ordinary(self.lambda, self.inverse, time);
        ClosedForm { kept, phi, psi, rest: self.rest }
    }

    /// Near those ends results are rounded to subnormal ones.
    #[cold]
    fn over_extreme(&self, time: f64) -> ClosedForm {
        if self.lambda.hi == f64::INFINITY {
            return ClosedForm { rest: self.rest, ..ClosedForm::default() };
        }
        let (mantissa, exponent) = mantissa_and_exponent(time);
        let parts = parts(self.lambda, self.inverse, time, mantissa, power_of_two(exponent.max(-1000)));
        #[expect(clippy::cast_possible_truncation, reason = "a whole number of at most 1155")]
        let kept = round_scaled(parts.kept, -(parts.halvings as i32));
        if parts.is_small {
            let (phi, psi) = (round_scaled(parts.phi, exponent), round_scaled(parts.psi, 2 * exponent));
            ClosedForm { kept, phi, psi, rest: self.rest }
        } else {
            ClosedForm { kept, phi: parts.phi.hi, psi: parts.psi.hi, rest: self.rest }
        }
    }
}

/// Neither the time nor any result is near the ends of the range of doubles.
#[inline(always)]
fn is_ordinary(lambda: f64, time: f64) -> bool {
    const TWO_MINUS_500: f64 = f64::from_bits((1023 - 500) << 52);
    time >= TWO_MINUS_500 && lambda * time <= 700.0
}

#[inline(always)]
fn undamped(time: f64) -> ClosedForm {
    let moving = ClosedForm { kept: 1.0, phi: time, psi: time * (0.5 * time), rest: 0.0 };
    if time == 0.0 { ClosedForm::STILL } else { moving }
}

/// λ of each damping.
pub(crate) fn decays<R: Real>(level: Level, dampings: &[R], decays: &mut [Decay]) {
    assert!(dampings.len() == decays.len());
    dispatch!(level, simd => each_decay(simd, dampings, decays));
}

/// E, φ and ψ of each damping over each time up to 2⁴⁰⁰.
pub(crate) fn closed_forms(level: Level, decays: Among<'_, Decay>, times: &[f64], forms: &mut Vec<ClosedForm>) {
    if let Among::Uniform(decay) = decays
        && decay.lambda.hi == 0.0
    {
        forms.clear();
        forms.reserve_exact(times.len());
        return forms.extend(times.iter().map(|time| undamped(*time)));
    }
    forms.resize(times.len(), ClosedForm::default());
    dispatch!(level, simd => each_form(simd, decays, times, forms));
}

#[inline(always)]
fn each_decay<S: Simd, R: Real>(simd: S, dampings: &[R], decays: &mut [Decay]) {
    let len = Registers::<S>::LEN;
    for (dampings, decays) in dampings.chunks(len).zip(decays.chunks_mut(len)) {
        let mut damping = [1.0; LEN_MAX];
        damping.iter_mut().zip(dampings).for_each(|(lane, damping)| *lane = (*damping).into());
        let damping = Registers::load(simd, &damping);
        let lambda = lambda(damping);
        let inverse = one(damping) / lambda;
        let lambda = DoubleDouble { hi: lambda.hi.store(), lo: lambda.lo.store() };
        let inverse = DoubleDouble { hi: inverse.hi.store(), lo: inverse.lo.store() };
        for (lane, decay) in decays.iter_mut().enumerate() {
            let lambda = DoubleDouble::new(lambda.hi[lane], lambda.lo[lane]);
            let inverse = DoubleDouble::new(inverse.hi[lane], inverse.lo[lane]);
            *decay = Decay { lambda, inverse, rest: R::REST_UNROUNDED };
        }
    }
}

#[inline(always)]
fn each_form<S: Simd>(simd: S, decays: Among<'_, Decay>, times: &[f64], forms: &mut [ClosedForm]) {
    let len = Registers::<S>::LEN;
    let [mut lambda_hi, mut lambda_lo, mut inverse_hi, mut inverse_lo] = [[1.0; LEN_MAX]; 4];
    let (mut rest, mut time) = ([0.0; LEN_MAX], [1.0; LEN_MAX]);
    for (chunk, (times, forms)) in times.chunks(len).zip(forms.chunks_mut(len)).enumerate() {
        time[..times.len()].copy_from_slice(times);
        let decay = |lane: usize| match decays {
            Among::Uniform(decay) => decay,
            Among::Each(decays) => decays[chunk * len + lane],
        };
        if chunk == 0 || matches!(decays, Among::Each(_)) {
            for lane in 0..times.len() {
                let decay = decay(lane);
                (lambda_hi[lane], lambda_lo[lane]) = (decay.lambda.hi, decay.lambda.lo);
                (inverse_hi[lane], inverse_lo[lane]) = (decay.inverse.hi, decay.inverse.lo);
                rest[lane] = decay.rest;
            }
        }
        let load = |hi, lo| DoubleDouble { hi: Registers::load(simd, hi), lo: Registers::load(simd, lo) };
        let [kept, phi, psi] =
            ordinary(load(&lambda_hi, &lambda_lo), load(&inverse_hi, &inverse_lo), Registers::load(simd, &time));
        let (kept, phi, psi) = (kept.store(), phi.store(), psi.store());
        for (lane, form) in forms.iter_mut().enumerate() {
            *form = ClosedForm { kept: kept[lane], phi: phi[lane], psi: psi[lane], rest: rest[lane] };
        }
        for (lane, (form, time)) in forms.iter_mut().zip(times).enumerate() {
            if lambda_hi[lane] == 0.0 || !is_ordinary(lambda_hi[lane], *time) {
                *form = decay(lane).over(*time);
            }
        }
    }
}

#[inline(always)]
fn one<L: Lanes>(like: L) -> DoubleDouble<L> {
    everywhere(like, DoubleDouble::new(1.0, 0.0))
}

#[inline(always)]
fn everywhere<L: Lanes>(like: L, value: DoubleDouble) -> DoubleDouble<L> {
    DoubleDouble { hi: like.splat(value.hi), lo: like.splat(value.lo) }
}

#[inline(always)]
fn choose<L: Lanes>(mask: L::Mask, then: DoubleDouble<L>, otherwise: DoubleDouble<L>) -> DoubleDouble<L> {
    DoubleDouble { hi: L::choose(mask, then.hi, otherwise.hi), lo: L::choose(mask, then.lo, otherwise.lo) }
}

#[inline(always)]
fn lambda<L: Lanes>(damping: L) -> DoubleDouble<L> {
    const SMALLEST: f64 = f64::from_bits(1);
    let infinite = everywhere(damping, DoubleDouble::new(f64::INFINITY, 0.0));
    choose(damping.is_below(SMALLEST), infinite, -ln(damping))
}

/// E, φ and ψ.
#[inline(always)]
fn ordinary<L: Lanes>(lambda: DoubleDouble<L>, inverse: DoubleDouble<L>, time: L) -> [L; 3] {
    // The time as mantissa and power of two, so that nothing on the way depends on its size.
    let power = time.power();
    let parts = parts(lambda, inverse, time, time.mantissa(), power);
    let (phi, psi) = (parts.phi.hi, parts.psi.hi);
    [
        parts.kept.hi * power_of_minus(parts.halvings),
        L::choose(parts.is_small, phi * power, phi),
        L::choose(parts.is_small, psi * power * power, psi),
    ]
}

/// What E, φ and ψ are put together from.
struct Parts<L: Lanes> {
    /// φ is in units of the power of two of the time, ψ in units of its square.
    is_small: L::Mask,
    /// E in units of 2 to the power of minus `halvings`.
    kept: DoubleDouble<L>,
    halvings: L,
    phi: DoubleDouble<L>,
    psi: DoubleDouble<L>,
}

#[inline(always)]
fn parts<L: Lanes>(lambda: DoubleDouble<L>, inverse: DoubleDouble<L>, time: L, mantissa: L, power: L) -> Parts<L> {
    let z = (lambda * mantissa).scaled(power);
    let (kept, halvings) = exp_minus(z);
    let is_small = z.hi.is_below(0.25);
    // Each is compiled once, and computed only where a lane asks for it.
    let (mut phi, mut psi) = (z, z);
    if L::any(is_small) {
        (phi, psi) = small(z, mantissa);
    }
    if !L::all(is_small) {
        let large = large(kept, halvings, inverse, time);
        (phi, psi) = (choose(is_small, phi, large.0), choose(is_small, psi, large.1));
    }
    Parts { is_small, kept, halvings, phi, psi }
}

/// φ = t (1 - z φ₂) and ψ = t² φ₂ with φ₂ = (z - 1 + e⁻ᶻ) / z² by its series.
#[inline(always)]
fn small<L: Lanes>(z: DoubleDouble<L>, mantissa: L) -> (DoubleDouble<L>, DoubleDouble<L>) {
    let phi2 = phi2_series(z);
    ((one(mantissa) - z * phi2) * mantissa, DoubleDouble::product(mantissa, mantissa) * phi2)
}

/// φ = (1 - E) / λ and ψ = (t - φ) / λ.
#[inline(always)]
fn large<L: Lanes>(
    kept: DoubleDouble<L>,
    halvings: L,
    inverse: DoubleDouble<L>,
    time: L,
) -> (DoubleDouble<L>, DoubleDouble<L>) {
    let few = L::choose(halvings.is_below(1000.0), halvings, halvings.splat(1000.0));
    let phi = (one(time) - kept.scaled(power_of_minus(few))) * inverse;
    (phi, (DoubleDouble { hi: time, lo: time.splat(0.0) } - phi) * inverse)
}

/// 1.5 · 2⁵²: adding it rounds to a whole number, and puts that number into the last bits.
const ROUND: f64 = 6_755_399_441_055_744.0;
const LN_2: DoubleDouble = DoubleDouble::new(std::f64::consts::LN_2, 2.319_046_813_846_299_6e-17);
/// 1, 1/3, 1/5, …
const ODD_INVERSES: [DoubleDouble; 12] = [
    DoubleDouble::new(1.0, 0.0),
    DoubleDouble::new(1.0 / 3.0, 1.850_371_707_708_594e-17),
    DoubleDouble::new(1.0 / 5.0, -1.110_223_024_625_156_6e-17),
    DoubleDouble::new(1.0 / 7.0, 7.930_164_461_608_26e-18),
    DoubleDouble::new(1.0 / 9.0, 6.167_905_692_361_98e-18),
    DoubleDouble::new(1.0 / 11.0, -2.523_234_146_875_356e-18),
    DoubleDouble::new(1.0 / 13.0, -4.270_088_556_250_602e-18),
    DoubleDouble::new(1.0 / 15.0, 9.251_858_538_542_971e-19),
    DoubleDouble::new(1.0 / 17.0, 8.163_404_592_832_033e-19),
    DoubleDouble::new(1.0 / 19.0, 2.921_639_538_487_254e-18),
    DoubleDouble::new(1.0 / 21.0, 2.643_388_153_869_42e-18),
    DoubleDouble::new(1.0 / 23.0, 1.206_764_157_201_257e-18),
];

/// 1/25, 1/27, …
const LATER_ODD_INVERSES: [f64; 11] = [
    1.0 / 25.0,
    1.0 / 27.0,
    1.0 / 29.0,
    1.0 / 31.0,
    1.0 / 33.0,
    1.0 / 35.0,
    1.0 / 37.0,
    1.0 / 39.0,
    1.0 / 41.0,
    1.0 / 43.0,
    1.0 / 45.0,
];

/// A polynomial, from its constant term on. A loop and not a fold, which would not be inlined.
#[inline(always)]
fn horner<L: Lanes, const N: usize>(x: L, coefficients: &[f64; N]) -> L {
    let mut sum = x.splat(0.0);
    for coefficient in coefficients.iter().rev() {
        sum = sum * x + *coefficient;
    }
    sum
}

/// ln x of a positive double, to about 100 bits: x = m 2ᵉ with m within √½ and √2, ln m = 2 artanh((m - 1) / (m + 1)).
#[inline(always)]
fn ln<L: Lanes>(x: L) -> DoubleDouble<L> {
    let is_subnormal = x.is_below(f64::MIN_POSITIVE);
    let normal = L::choose(is_subnormal, x * TWO_64, x);
    let e = normal.exponent_bits_in(TWO_52) + -TWO_52 - L::choose(is_subnormal, x.splat(1087.0), x.splat(1023.0));
    let m = normal.mantissa();
    let is_less = m.is_below(std::f64::consts::SQRT_2);
    let (m, e) = (L::choose(is_less, m, m * 0.5), L::choose(is_less, e, e + 1.0));
    let s = DoubleDouble { hi: m + -1.0, lo: x.splat(0.0) } / DoubleDouble::sum(m, x.splat(1.0));
    let square = s * s;
    // s² is at most 0.0295; 23 terms leave less than 2⁻¹¹⁰. The last ones add too little to need more than a double.
    let mut series = DoubleDouble { hi: horner(square.hi, &LATER_ODD_INVERSES), lo: x.splat(0.0) };
    for inverse in ODD_INVERSES.into_iter().rev() {
        series = series * square + everywhere(x, inverse);
    }
    (s * series).scaled(x.splat(2.0)) + everywhere(x, LN_2) * e
}

/// e⁻ᶻ for z >= 0 as a factor between 0.7 and 1.5, to about 64 bits, and how often it is halved.
#[inline(always)]
fn exp_minus<L: Lanes>(z: DoubleDouble<L>) -> (DoubleDouble<L>, L) {
    const FACTORIALS: [f64; 8] = [
        1.0 / 6.0,
        1.0 / 24.0,
        1.0 / 120.0,
        1.0 / 720.0,
        1.0 / 5_040.0,
        1.0 / 40_320.0,
        1.0 / 362_880.0,
        1.0 / 3_628_800.0,
    ];
    let splat = |value| z.hi.splat(value);
    // e⁻⁸⁰⁰ is below half the smallest double.
    let z = choose(z.hi.is_below(800.0), z, everywhere(z.hi, DoubleDouble::new(800.0, 0.0)));
    let halvings = (z.hi * std::f64::consts::LOG2_E + ROUND) + -ROUND;
    // e⁻ᶻ = 2⁻ʰ e⁻ʳ with |r| <= 0.35; then (e^(-r/8))⁸, so that a double holds the series from the cube on.
    let s = (everywhere(z.hi, LN_2) * halvings - z).scaled(splat(0.125));
    let square = s * s;
    let cubic = horner(s.hi, &FACTORIALS) * s.hi * square.hi;
    let mut m = s + square.scaled(splat(0.5)) + DoubleDouble { hi: cubic, lo: splat(0.0) };
    for _ in 0..3 {
        m = m.scaled(splat(2.0)) + m * m;
    }
    (one(z.hi) + m, halvings)
}

/// 2 to the power of minus a whole number, for a normal result.
#[inline(always)]
fn power_of_minus<L: Lanes>(halvings: L) -> L {
    (-halvings + 1023.0 + ROUND).last_bits_as_exponent()
}

/// (z - 1 + e⁻ᶻ) / z² = 1/2 - z/6 + z²/24 - … for 0 <= z < 1/4.
#[inline(always)]
fn phi2_series<L: Lanes>(z: DoubleDouble<L>) -> DoubleDouble<L> {
    const SIXTH: DoubleDouble = DoubleDouble::new(1.0 / 6.0, 9.251_858_538_542_97e-18);
    // (-1)ᵏ / (k + 2)! from k = 2 on; the twelfth term is below 2⁻⁶⁴.
    const COEFFICIENTS: [f64; 10] = [
        1.0 / 24.0,
        -1.0 / 120.0,
        1.0 / 720.0,
        -1.0 / 5_040.0,
        1.0 / 40_320.0,
        -1.0 / 362_880.0,
        1.0 / 3_628_800.0,
        -1.0 / 39_916_800.0,
        1.0 / 479_001_600.0,
        -1.0 / 6_227_020_800.0,
    ];
    let zero = z.hi.splat(0.0);
    let tail = horner(z.hi, &COEFFICIENTS) * z.hi * z.hi;
    everywhere(z.hi, DoubleDouble::new(0.5, 0.0)) - z * everywhere(z.hi, SIXTH) + DoubleDouble { hi: tail, lo: zero }
}

const TWO_52: f64 = 4_503_599_627_370_496.0;
const TWO_64: f64 = 18_446_744_073_709_552_000.0;

/// x = m 2ᵉ with 1 <= m < 2, of a positive double.
fn mantissa_and_exponent(x: f64) -> (f64, i32) {
    let (normal, offset) = if x < f64::MIN_POSITIVE { (x * TWO_64, 64) } else { (x, 0) };
    (normal.mantissa(), (normal.to_bits() >> 52) as i32 - 1023 - offset)
}

/// 2ᵉ for a normal result.
fn power_of_two(exponent: i32) -> f64 {
    debug_assert!((-1022..=1023).contains(&exponent), "2^{exponent} is not a normal double");
    f64::from_bits(u64::from((exponent + 1023).cast_unsigned()) << 52)
}

/// x · 2ᵉ rounded once, also where the result is subnormal, for x between 1/4 and 4.
fn round_scaled(x: DoubleDouble, exponent: i32) -> f64 {
    if exponent > -1018 {
        return x.hi * power_of_two(exponent);
    }
    if exponent < -1080 {
        return 0.0;
    }
    // Count in units of the smallest double, 2⁻¹⁰⁷⁴, where rounding is to a whole number.
    let scale = power_of_two((exponent + 1074).min(900));
    let (hi, lo) = (x.hi * scale, x.lo * scale);
    if hi >= TWO_52 {
        // Normal after all, and rounded already.
        return hi * power_of_two(-1000) * power_of_two(-74);
    }
    let mut units = (hi + ROUND) - ROUND;
    let rest = (hi - units) + lo;
    if rest > 0.5 {
        units += 1.0;
    } else if rest < -0.5 {
        units -= 1.0;
    }
    units * power_of_two(-1000) * power_of_two(-74)
}

#[cfg(test)]
mod tests {
    use fearless_simd::Level;

    use super::{Among, Decay, closed_forms, decays};

    /// In lanes or alone, on every instruction set of this machine, for ordinary and for extreme dampings and times.
    #[test]
    fn many_at_once_have_the_bits_of_each_alone() {
        let bits = |word: &str| f64::from_bits(u64::from_str_radix(word, 16).expect("hexadecimal"));
        let table = include_str!("../../tests/reference/closed_form.txt").lines();
        let pairs = table.map(|line| line.split(' ').map(bits).take(2).collect::<Vec<f64>>());
        let (dampings, times): (Vec<f64>, Vec<f64>) = pairs.map(|pair| (pair[0], pair[1])).unzip();
        for level in [Level::baseline(), Level::new()] {
            let mut rates = vec![Decay::default(); dampings.len()];
            decays(level, &dampings, &mut rates);
            let mut forms = Vec::new();
            closed_forms(level, Among::Each(&rates), &times, &mut forms);
            for (i, form) in forms.iter().enumerate() {
                let alone = Decay::of(dampings[i]).over(times[i]);
                assert_eq!(*form, alone, "damping {:e}, time {:e}, {level:?}", dampings[i], times[i]);
            }
        }
    }

    /// Against 700 digits: `tests/reference/closed_form.py` says how the table was made.
    #[test]
    fn within_0_55_ulp_of_the_reference() {
        let mut worst = [(0.0, 0.0, 0.0); 3];
        for line in include_str!("../../tests/reference/closed_form.txt").lines() {
            let words: Vec<&str> = line.split(' ').collect();
            let bits = |k: usize| u64::from_str_radix(words[k], 16).expect("hexadecimal");
            let (damping, time) = (f64::from_bits(bits(0)), f64::from_bits(bits(1)));
            let form = Decay::of(damping).over(time);
            for (k, value) in [form.kept, form.phi, form.psi].into_iter().enumerate() {
                let lacks: f64 = words[3 + 2 * k].parse().expect("a number");
                #[expect(clippy::cast_precision_loss, reason = "a handful of last places")]
                let off = (value.to_bits().cast_signed() - bits(2 + 2 * k).cast_signed()) as f64;
                let error = (off - lacks).abs();
                if error > worst[k].0 {
                    worst[k] = (error, damping, time);
                }
            }
        }
        for (error, damping, time) in worst {
            assert!(error <= 0.55, "{error} ulp at damping {damping:e}, time {time:e}; all: {worst:?}");
        }
    }
}
