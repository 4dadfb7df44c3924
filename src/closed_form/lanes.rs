//! Doubles, one or many at once.

use std::ops::{Add, Div, Mul, Neg, Sub};

use fearless_simd::{ExtractToken, Select, Simd, SimdBase, SimdFloat, SimdMask};

use crate::double_double::{Lane, lost_in_product};

const FRACTION: u64 = (1 << 52) - 1;

/// What the closed form computes with: a double, or registers of them.
pub(super) trait Lanes: Lane {
    type Mask: Copy;
    /// The same value in every lane; `self` only says how many there are.
    fn splat(self, value: f64) -> Self;
    fn is_below(self, bound: f64) -> Self::Mask;
    fn choose(mask: Self::Mask, then: Self, otherwise: Self) -> Self;
    fn all(mask: Self::Mask) -> bool;
    fn any(mask: Self::Mask) -> bool;
    /// Between 1 and 2, of a normal number.
    fn mantissa(self) -> Self;
    /// The power of two below a normal number.
    fn power(self) -> Self;
    /// The bits of the exponent as the last bits of another number.
    fn exponent_bits_in(self, number: f64) -> Self;
    /// The number whose exponent are the last bits of this one.
    fn last_bits_as_exponent(self) -> Self;
}

impl Lanes for f64 {
    type Mask = bool;
    #[inline(always)]
    fn splat(self, value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn is_below(self, bound: f64) -> bool {
        self < bound
    }
    #[inline(always)]
    fn choose(mask: bool, then: Self, otherwise: Self) -> Self {
        if mask { then } else { otherwise }
    }
    #[inline(always)]
    fn all(mask: bool) -> bool {
        mask
    }
    #[inline(always)]
    fn any(mask: bool) -> bool {
        mask
    }
    #[inline(always)]
    fn mantissa(self) -> Self {
        Self::from_bits((self.to_bits() & FRACTION) | 1.0_f64.to_bits())
    }
    #[inline(always)]
    fn power(self) -> Self {
        Self::from_bits(self.to_bits() & !FRACTION)
    }
    #[inline(always)]
    fn exponent_bits_in(self, number: f64) -> Self {
        Self::from_bits((self.to_bits() >> 52) | number.to_bits())
    }
    #[inline(always)]
    fn last_bits_as_exponent(self) -> Self {
        Self::from_bits(self.to_bits() << 52)
    }
}

/// The most lanes that a register has.
pub(super) const LANES_MAX: usize = 8;

/// A register of doubles.
#[derive(Clone, Copy)]
pub(super) struct Register<S: Simd>(S::f64s);

impl<S: Simd> Register<S> {
    pub(super) const LEN: usize = S::f64s::LEN;

    /// The first values of these.
    #[inline(always)]
    pub(super) fn load(simd: S, values: &[f64; LANES_MAX]) -> Self {
        Self(S::f64s::from_slice(simd, &values[..Self::LEN]))
    }

    /// Its lanes, and zeros behind them.
    #[inline(always)]
    pub(super) fn store(self) -> [f64; LANES_MAX] {
        let mut values = [0.0; LANES_MAX];
        self.0.store_slice(&mut values[..Self::LEN]);
        values
    }
}

impl<S: Simd> Add for Register<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0)
    }
}

impl<S: Simd> Add<f64> for Register<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: f64) -> Self {
        Self(self.0 + other)
    }
}

impl<S: Simd> Sub for Register<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(self.0 - other.0)
    }
}

impl<S: Simd> Mul for Register<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0)
    }
}

impl<S: Simd> Mul<f64> for Register<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: f64) -> Self {
        Self(self.0 * other)
    }
}

impl<S: Simd> Div for Register<S> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self(self.0 / other.0)
    }
}

impl<S: Simd> Neg for Register<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl<S: Simd> Lane for Register<S> {
    #[inline(always)]
    fn lost_in_product(self, other: Self, product: Self) -> Self {
        // Instruction sets with registers of four doubles and more have a fused multiply-add.
        if Self::LEN >= 4 {
            Self(self.0.mul_sub_precise(other.0, product.0))
        } else {
            lost_in_product(self, other, product)
        }
    }
}

impl<S: Simd> Lanes for Register<S> {
    type Mask = S::mask64s;
    #[inline(always)]
    fn splat(self, value: f64) -> Self {
        Self(S::f64s::splat(self.0.token(), value))
    }
    #[inline(always)]
    fn is_below(self, bound: f64) -> Self::Mask {
        self.0.simd_lt(bound)
    }
    #[inline(always)]
    fn choose(mask: Self::Mask, then: Self, otherwise: Self) -> Self {
        Self(mask.select(then.0, otherwise.0))
    }
    #[inline(always)]
    fn all(mask: Self::Mask) -> bool {
        mask.all_true()
    }
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        mask.any_true()
    }
    #[inline(always)]
    fn mantissa(self) -> Self {
        Self(S::f64s::from_bits((self.0.to_bits() & FRACTION) | 1.0_f64.to_bits()))
    }
    #[inline(always)]
    fn power(self) -> Self {
        Self(S::f64s::from_bits(self.0.to_bits() & !FRACTION))
    }
    #[inline(always)]
    fn exponent_bits_in(self, number: f64) -> Self {
        Self(S::f64s::from_bits((self.0.to_bits() >> 52) | number.to_bits()))
    }
    #[inline(always)]
    fn last_bits_as_exponent(self) -> Self {
        Self(S::f64s::from_bits(self.0.to_bits() << 52))
    }
}
