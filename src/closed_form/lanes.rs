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

/// Registers that are computed side by side: most of the time one of them alone would wait for its last result.
const ABREAST: usize = 2;

/// `[value of 0, value of 1]`. There are thousands of them in one function, where as many loops, let alone closures, took
/// the compiler a minute.
macro_rules! abreast {
    ($k:ident => $value:expr) => {
        [
            {
                const $k: usize = 0;
                $value
            },
            {
                const $k: usize = 1;
                $value
            },
        ]
    };
}

/// The most doubles of `Registers`.
pub(super) const LEN_MAX: usize = ABREAST * LANES_MAX;

/// Registers of doubles.
#[derive(Clone, Copy)]
pub(super) struct Registers<S: Simd>([S::f64s; ABREAST]);

impl<S: Simd> Registers<S> {
    pub(super) const LEN: usize = ABREAST * S::f64s::LEN;

    /// The first values of these.
    #[inline(always)]
    pub(super) fn load(simd: S, values: &[f64; LEN_MAX]) -> Self {
        Self(abreast!(K => S::f64s::from_slice(simd, &values[K * S::f64s::LEN..(K + 1) * S::f64s::LEN])))
    }

    /// Their lanes, and zeros behind them.
    #[inline(always)]
    pub(super) fn store(self) -> [f64; LEN_MAX] {
        let mut values = [0.0; LEN_MAX];
        let (first, second) = values[..Self::LEN].split_at_mut(S::f64s::LEN);
        self.0[0].store_slice(first);
        self.0[1].store_slice(second);
        values
    }
}

impl<S: Simd> Add for Registers<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(abreast!(K => self.0[K] + other.0[K]))
    }
}

impl<S: Simd> Add<f64> for Registers<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: f64) -> Self {
        Self(abreast!(K => self.0[K] + other))
    }
}

impl<S: Simd> Sub for Registers<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(abreast!(K => self.0[K] - other.0[K]))
    }
}

impl<S: Simd> Mul for Registers<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self(abreast!(K => self.0[K] * other.0[K]))
    }
}

impl<S: Simd> Mul<f64> for Registers<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: f64) -> Self {
        Self(abreast!(K => self.0[K] * other))
    }
}

impl<S: Simd> Div for Registers<S> {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self(abreast!(K => self.0[K] / other.0[K]))
    }
}

impl<S: Simd> Neg for Registers<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(abreast!(K => -self.0[K]))
    }
}

impl<S: Simd> Lane for Registers<S> {
    #[inline(always)]
    fn lost_in_product(self, other: Self, product: Self) -> Self {
        // Instruction sets with registers of four doubles and more have a fused multiply-add.
        if S::f64s::LEN >= 4 {
            Self(abreast!(K => self.0[K].mul_sub_precise(other.0[K], product.0[K])))
        } else {
            lost_in_product(self, other, product)
        }
    }
}

impl<S: Simd> Lanes for Registers<S> {
    type Mask = [S::mask64s; ABREAST];
    #[inline(always)]
    fn splat(self, value: f64) -> Self {
        Self(abreast!(K => S::f64s::splat(self.0[K].token(), value)))
    }
    #[inline(always)]
    fn is_below(self, bound: f64) -> Self::Mask {
        abreast!(K => self.0[K].simd_lt(bound))
    }
    #[inline(always)]
    fn choose(mask: Self::Mask, then: Self, otherwise: Self) -> Self {
        Self(abreast!(K => mask[K].select(then.0[K], otherwise.0[K])))
    }
    #[inline(always)]
    fn all(mask: Self::Mask) -> bool {
        mask[0].all_true() && mask[1].all_true()
    }
    #[inline(always)]
    fn any(mask: Self::Mask) -> bool {
        mask[0].any_true() || mask[1].any_true()
    }
    #[inline(always)]
    fn mantissa(self) -> Self {
        Self(abreast!(K => S::f64s::from_bits((self.0[K].to_bits() & FRACTION) | 1.0_f64.to_bits())))
    }
    #[inline(always)]
    fn power(self) -> Self {
        Self(abreast!(K => S::f64s::from_bits(self.0[K].to_bits() & !FRACTION)))
    }
    #[inline(always)]
    fn exponent_bits_in(self, number: f64) -> Self {
        Self(abreast!(K => S::f64s::from_bits((self.0[K].to_bits() >> 52) | number.to_bits())))
    }
    #[inline(always)]
    fn last_bits_as_exponent(self) -> Self {
        Self(abreast!(K => S::f64s::from_bits(self.0[K].to_bits() << 52)))
    }
}
