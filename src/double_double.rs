//! Numbers of about 106 bits as an unevaluated sum of two doubles.
//!
//! Source: T. J. Dekker, "A floating-point technique for extending the available precision", Numerische Mathematik 18
//! (1971). What a product loses is itself a double: splitting the factors finds it, and so does a fused multiply-add where
//! the CPU has one. The bits are the same.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A double, or a register of them.
pub(crate) trait Lane:
    Copy
    + Add<Output = Self>
    + Add<f64, Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Mul<f64, Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// What rounding took from a product of this and another, for factors below 2⁹⁹⁶ and a product that is not subnormal.
    #[inline(always)]
    fn lost_in_product(self, other: Self, product: Self) -> Self {
        lost_in_product(self, other, product)
    }
}

impl Lane for f64 {}

/// `hi + lo` with `hi` the double nearest to the sum.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct DoubleDouble<T = f64> {
    pub(crate) hi: T,
    pub(crate) lo: T,
}

impl DoubleDouble {
    pub(crate) const fn new(hi: f64, lo: f64) -> Self {
        Self { hi, lo }
    }
}

impl<T: Copy + Add<Output = T> + Sub<Output = T>> DoubleDouble<T> {
    /// `a + b` without error.
    #[inline(always)]
    pub(crate) fn sum(a: T, b: T) -> Self {
        let hi = a + b;
        let b_rounded = hi - a;
        let lo = (a - (hi - b_rounded)) + (b - b_rounded);
        Self { hi, lo }
    }
}

impl<T: Lane> DoubleDouble<T> {
    /// `a + b` without error, for `|a| >= |b|` or `a == 0`.
    #[inline(always)]
    fn ordered_sum(a: T, b: T) -> Self {
        let hi = a + b;
        Self { hi, lo: b - (hi - a) }
    }

    /// `a * b` without error, for factors below 2⁹⁹⁶ and a product that is not subnormal.
    #[inline(always)]
    pub(crate) fn product(a: T, b: T) -> Self {
        let hi = a * b;
        Self { hi, lo: a.lost_in_product(b, hi) }
    }

    /// Both words times a power of two.
    #[inline(always)]
    pub(crate) fn scaled(self, power: T) -> Self {
        Self { hi: self.hi * power, lo: self.lo * power }
    }
}

#[inline(always)]
pub(crate) fn lost_in_product<T: Lane>(a: T, b: T, product: T) -> T {
    let (a_hi, a_lo) = split(a);
    let (b_hi, b_lo) = split(b);
    ((a_hi * b_hi - product) + a_hi * b_lo + a_lo * b_hi) + a_lo * b_lo
}

/// The upper 26 and the lower 26 bits of `a` (Veltkamp).
#[inline(always)]
fn split<T: Lane>(a: T) -> (T, T) {
    const SPLITTER: f64 = 134_217_729.0;
    let scaled = a * SPLITTER;
    let hi = scaled - (scaled - a);
    (hi, a - hi)
}

impl From<f64> for DoubleDouble {
    fn from(hi: f64) -> Self {
        Self { hi, lo: 0.0 }
    }
}

impl<T: Lane> Neg for DoubleDouble<T> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { hi: -self.hi, lo: -self.lo }
    }
}

impl<T: Lane> Add for DoubleDouble<T> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        let high = Self::sum(self.hi, other.hi);
        let low = Self::sum(self.lo, other.lo);
        let sum = Self::ordered_sum(high.hi, high.lo + low.hi);
        Self::ordered_sum(sum.hi, sum.lo + low.lo)
    }
}

impl<T: Lane> Sub for DoubleDouble<T> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl<T: Lane> Mul for DoubleDouble<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        let product = Self::product(self.hi, other.hi);
        Self::ordered_sum(product.hi, product.lo + (self.hi * other.lo + self.lo * other.hi))
    }
}

impl<T: Lane> Div for DoubleDouble<T> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let first = self.hi / other.hi;
        let remainder = self - other * first;
        let second = remainder.hi / other.hi;
        let remainder = remainder - other * second;
        let quotient = Self::ordered_sum(first, second);
        Self::ordered_sum(quotient.hi, quotient.lo + remainder.hi / other.hi)
    }
}

impl<T: Lane> Mul<T> for DoubleDouble<T> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: T) -> Self {
        let product = Self::product(self.hi, other);
        Self::ordered_sum(product.hi, product.lo + self.lo * other)
    }
}

#[cfg(test)]
#[expect(clippy::disallowed_methods, reason = "powers of two are exact everywhere")]
mod tests {
    use super::DoubleDouble;

    #[test]
    fn sums_and_products_lose_nothing() {
        let sum = DoubleDouble::sum(1.0, 2f64.powi(-80));
        assert_eq!((sum.hi, sum.lo), (1.0, 2f64.powi(-80)));
        let a = 1.0 + 2f64.powi(-30);
        let square = DoubleDouble::product(a, a);
        assert_eq!((square.hi, square.lo), (1.0 + 2f64.powi(-29), 2f64.powi(-60)));
    }

    #[test]
    fn division_undoes_multiplication_to_a_hundred_bits() {
        let a = DoubleDouble::new(std::f64::consts::PI, 1.224_646_799_147_353_2e-16);
        let b = DoubleDouble::new(std::f64::consts::E, 1.445_646_891_729_250_2e-16);
        let error = (a * b) / b - a;
        assert!(error.hi.abs() < 2f64.powi(-99), "{error:?}");
    }
}
