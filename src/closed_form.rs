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

use crate::double_double::DoubleDouble;

/// E, φ and ψ of one damping and one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ClosedForm {
    /// E, the share of the velocity that is kept; no unit.
    pub(crate) kept: f64,
    /// φ in seconds.
    pub(crate) phi: f64,
    /// ψ in seconds squared.
    pub(crate) psi: f64,
}

impl ClosedForm {
    /// For `0 <= damping <= 1` and `0 < time <= 2⁴⁰⁰`.
    pub(crate) fn new(damping: f64, time: f64) -> Self {
        if damping == 1.0 {
            return Self { kept: 1.0, phi: time, psi: time * (0.5 * time) };
        }
        if damping == 0.0 {
            return Self { kept: 0.0, phi: 0.0, psi: 0.0 };
        }
        let lambda = -ln(damping);
        // The time as mantissa and power of two, so that nothing below over- or underflows on the way.
        let (mantissa, exponent) = mantissa_and_exponent(time);
        let mantissa = DoubleDouble::from(mantissa);
        let z = (lambda * mantissa).scaled(power_of_two(exponent.max(-1000)));
        let (e, e_exponent) = exp_minus(z);
        let kept = round_scaled(e, e_exponent);
        if z.hi < 0.25 {
            // φ₂ = (z - 1 + e⁻ᶻ) / z² by its series; φ = t (1 - z φ₂), ψ = t² φ₂.
            let phi2 = phi2_series(z);
            let phi = mantissa * (DoubleDouble::ONE - z * phi2);
            let psi = mantissa * mantissa * phi2;
            Self { kept, phi: round_scaled(phi, exponent), psi: round_scaled(psi, 2 * exponent) }
        } else {
            let e = e.scaled(power_of_two(e_exponent.max(-1000)));
            let phi = (DoubleDouble::ONE - e) / lambda;
            let psi = (DoubleDouble::from(time) - phi) / lambda;
            Self { kept, phi: phi.hi, psi: psi.hi }
        }
    }

    /// Position and velocity after the time, from those at its start and a constant acceleration.
    pub(crate) fn apply(&self, position: [f64; 3], velocity: [f64; 3], acceleration: [f64; 3]) -> ([f64; 3], [f64; 3]) {
        let [p, v, a] = [position, velocity, acceleration];
        (
            std::array::from_fn(|k| p[k] + (v[k] * self.phi + a[k] * self.psi)),
            std::array::from_fn(|k| v[k] * self.kept + a[k] * self.phi),
        )
    }
}

const LN_2: DoubleDouble = DoubleDouble::new(std::f64::consts::LN_2, 2.319_046_813_846_299_6e-17);

/// ln x of a positive double, to about 100 bits: x = m 2ᵉ with m within √½ and √2, ln m = 2 artanh((m - 1) / (m + 1)).
fn ln(x: f64) -> DoubleDouble {
    let (mut m, mut e) = mantissa_and_exponent(x);
    if m > std::f64::consts::SQRT_2 {
        m *= 0.5;
        e += 1;
    }
    let s = DoubleDouble::from(m - 1.0) / DoubleDouble::sum(m, 1.0);
    let square = s * s;
    // s² is at most 0.0295; 23 terms leave less than 2⁻¹¹⁰. The last ones add too little to need more than a double.
    let tail = (12..=22).rev().fold(0.0, |sum, k| sum * square.hi + 1.0 / f64::from(2 * k + 1));
    let series = (0..12).rev().fold(DoubleDouble::from(tail), |sum, k| {
        sum * square + DoubleDouble::ONE / DoubleDouble::from(f64::from(2 * k + 1))
    });
    (s * series).scaled(2.0) + LN_2 * DoubleDouble::from(f64::from(e))
}

/// e⁻ᶻ for z >= 0 as a factor between 0.7 and 1.5, to about 64 bits, and a power of two.
fn exp_minus(z: DoubleDouble) -> (DoubleDouble, i32) {
    const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²: adding it rounds to a whole number.
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
    if z.hi > 800.0 {
        return (DoubleDouble::ONE, -2000); // Below half the smallest double.
    }
    let halvings = (z.hi * std::f64::consts::LOG2_E + ROUND) - ROUND;
    // e⁻ᶻ = 2⁻ʰ e⁻ʳ with |r| <= 0.35; then (e^(-r/8))⁸, so that a double holds the series from the cube on.
    let s = (LN_2 * DoubleDouble::from(halvings) - z).scaled(0.125);
    let square = s * s;
    let cubic = FACTORIALS.iter().rev().fold(0.0, |sum, &c| sum * s.hi + c) * s.hi * square.hi;
    let mut m = s + square.scaled(0.5) + DoubleDouble::from(cubic);
    for _ in 0..3 {
        m = m.scaled(2.0) + m * m;
    }
    // At most 800 / ln 2 halvings.
    #[expect(clippy::cast_possible_truncation, reason = "a whole number of at most 1155")]
    (DoubleDouble::ONE + m, -(halvings as i32))
}

/// (z - 1 + e⁻ᶻ) / z² = 1/2 - z/6 + z²/24 - … for 0 <= z < 1/4.
fn phi2_series(z: DoubleDouble) -> DoubleDouble {
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
    let tail = COEFFICIENTS.iter().rev().fold(0.0, |sum, &c| sum * z.hi + c) * z.hi * z.hi;
    DoubleDouble::from(0.5) - z * SIXTH + DoubleDouble::from(tail)
}

/// x = m 2ᵉ with 1 <= m < 2, of a positive double.
fn mantissa_and_exponent(x: f64) -> (f64, i32) {
    const TWO_64: f64 = 18_446_744_073_709_552_000.0;
    const FRACTION: u64 = (1 << 52) - 1;
    let (bits, offset) = if x < f64::MIN_POSITIVE { ((x * TWO_64).to_bits(), 64) } else { (x.to_bits(), 0) };
    let exponent = (bits >> 52) as i32 - 1023 - offset;
    (f64::from_bits((bits & FRACTION) | 1.0_f64.to_bits()), exponent)
}

/// 2ᵉ for a normal result.
fn power_of_two(exponent: i32) -> f64 {
    debug_assert!((-1022..=1023).contains(&exponent), "2^{exponent} is not a normal double");
    f64::from_bits(u64::from((exponent + 1023).cast_unsigned()) << 52)
}

/// x · 2ᵉ rounded once, also where the result is subnormal, for x between 1/4 and 4.
fn round_scaled(x: DoubleDouble, exponent: i32) -> f64 {
    const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²
    if exponent > -1018 {
        return x.hi * power_of_two(exponent);
    }
    if exponent < -1080 {
        return 0.0;
    }
    // Count in units of the smallest double, 2⁻¹⁰⁷⁴, where rounding is to a whole number.
    let scale = power_of_two((exponent + 1074).min(900));
    let (hi, lo) = (x.hi * scale, x.lo * scale);
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
    use super::ClosedForm;

    /// Against 700 digits: `tests/reference/closed_form.py` says how the table was made.
    #[test]
    fn within_0_55_ulp_of_the_reference() {
        let mut worst = [(0.0, 0.0, 0.0); 3];
        for line in include_str!("../tests/reference/closed_form.txt").lines() {
            let words: Vec<&str> = line.split(' ').collect();
            let bits = |k: usize| u64::from_str_radix(words[k], 16).expect("hexadecimal");
            let (damping, time) = (f64::from_bits(bits(0)), f64::from_bits(bits(1)));
            let form = ClosedForm::new(damping, time);
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
