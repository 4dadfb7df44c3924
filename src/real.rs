//! The two precisions a world can have.

#![expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]

use std::fmt::{Debug, Display};
use std::ops::{Add, Mul, Sub};

use glam::{DVec3, Vec3};

use crate::double_double::DoubleDouble;
use crate::world::Compiled;

/// The precision of a world: how its numbers are stored and how the stepped integrators compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Precision {
    /// `f32`, 24 bits.
    Single,
    /// `f64`, 53 bits. The default.
    #[default]
    Double,
}

impl Precision {
    /// Every precision, for loops over all of them.
    pub const ALL: [Self; 2] = [Self::Single, Self::Double];

    /// `single` or `double`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Double => "double",
        }
    }
}

impl Display for Precision {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

mod sealed {
    use fearless_simd::{
        ExtractToken, Simd, SimdBase, SimdFloat, SimdFloatElement, SimdNarrow, SimdWiden, f32x4, f64x4,
    };

    pub trait Sealed: Sized + SimdFloatElement {
        /// A vector register of these.
        type Lanes<S: Simd>: SimdFloat<S, Element = Self>;
        /// Two registers of doubles, from as many of these.
        fn load<S: Simd>(simd: S, from: &[Self]) -> (S::f64s, S::f64s);
        /// The same back, each rounded to the nearest.
        fn store<S: Simd>(values: (S::f64s, S::f64s), to: &mut [Self]);
        /// A register of four doubles, from as many of these.
        fn load_four<S: Simd>(simd: S, from: &[Self]) -> f64x4<S>;
        /// The same back, each rounded to the nearest.
        fn store_four<S: Simd>(values: f64x4<S>, to: &mut [Self]);
        /// The bytes of one.
        #[cfg(feature = "snapshot")]
        const BYTES: usize;
        /// Their bytes, little-endian, where that is how they are held.
        #[cfg(feature = "snapshot")]
        fn as_bytes(values: &[Self]) -> Option<&[u8]>;
        /// Appends their bytes, little-endian.
        #[cfg(feature = "snapshot")]
        fn to_bytes(values: &[Self], to: &mut Vec<u8>);
        /// Appends those that the bytes hold.
        #[cfg(feature = "snapshot")]
        fn from_bytes(bytes: &[u8], to: &mut Vec<Self>);
    }
    /// The bytes of numbers.
    #[cfg(feature = "snapshot")]
    macro_rules! bytes {
        () => {
            const BYTES: usize = size_of::<Self>();
            fn as_bytes(values: &[Self]) -> Option<&[u8]> {
                cfg!(target_endian = "little").then(|| bytemuck::cast_slice(values))
            }
            fn to_bytes(values: &[Self], to: &mut Vec<u8>) {
                match Self::as_bytes(values) {
                    Some(bytes) => to.extend_from_slice(bytes),
                    None => to.extend(values.iter().flat_map(|value| value.to_le_bytes())),
                }
            }
            fn from_bytes(bytes: &[u8], to: &mut Vec<Self>) {
                let (numbers, _) = bytes.as_chunks();
                to.extend(numbers.iter().map(|bytes| Self::from_le_bytes(*bytes)));
            }
        };
    }
    impl Sealed for f32 {
        #[cfg(feature = "snapshot")]
        bytes!();
        type Lanes<S: Simd> = S::f32s;
        #[inline(always)]
        fn load<S: Simd>(simd: S, from: &[Self]) -> (S::f64s, S::f64s) {
            S::f32s::from_slice(simd, from).widen()
        }
        #[inline(always)]
        fn store<S: Simd>((low, high): (S::f64s, S::f64s), to: &mut [Self]) {
            low.narrow(high).store_slice(to);
        }
        #[inline(always)]
        fn load_four<S: Simd>(simd: S, from: &[Self]) -> f64x4<S> {
            let (low, high) = simd.widen_f32x4(f32x4::from_slice(simd, from));
            simd.combine_f64x2(low, high)
        }
        #[inline(always)]
        fn store_four<S: Simd>(values: f64x4<S>, to: &mut [Self]) {
            let simd = values.token();
            let (low, high) = simd.split_f64x4(values);
            simd.narrow_f64x2(low, high).store_slice(to);
        }
    }
    impl Sealed for f64 {
        #[cfg(feature = "snapshot")]
        bytes!();
        type Lanes<S: Simd> = S::f64s;
        #[inline(always)]
        fn load<S: Simd>(simd: S, from: &[Self]) -> (S::f64s, S::f64s) {
            let (low, high) = from.split_at(S::f64s::LEN);
            (S::f64s::from_slice(simd, low), S::f64s::from_slice(simd, high))
        }
        #[inline(always)]
        fn store<S: Simd>((low, high): (S::f64s, S::f64s), to: &mut [Self]) {
            let (to_low, to_high) = to.split_at_mut(S::f64s::LEN);
            low.store_slice(to_low);
            high.store_slice(to_high);
        }
        #[inline(always)]
        fn load_four<S: Simd>(simd: S, from: &[Self]) -> f64x4<S> {
            f64x4::from_slice(simd, from)
        }
        #[inline(always)]
        fn store_four<S: Simd>(values: f64x4<S>, to: &mut [Self]) {
            values.store_slice(to);
        }
    }
}

/// The number type of a world: `f32` with [`glam::Vec3`], or `f64` with [`glam::DVec3`]. Sealed.
pub trait Real:
    sealed::Sealed
    + Compiled
    + Copy
    + Default
    + Debug
    + Display
    + PartialEq
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + std::ops::Div<Output = Self>
    + Into<f64>
    + Send
    + Sync
    + 'static
{
    /// A vector of three of these.
    type Vec3: Copy + Default + Debug + PartialEq + From<[Self; 3]> + Into<[Self; 3]> + Send + Sync + 'static;
    /// The name of this number type.
    const PRECISION: Precision;
    /// 0.
    const ZERO: Self;
    /// ½.
    const HALF: Self;
    /// 1.
    const ONE: Self;
    /// The largest finite number, as a double.
    const LARGEST: f64;
    /// A damped velocity component of a smaller magnitude comes to rest: 2⁻¹⁰⁰ (single) or 2⁻⁹⁶⁰ (double) m/s.
    const REST: Self;
    /// Doubles of a smaller magnitude, and no others, are below that when rounded to this type.
    const REST_UNROUNDED: f64;

    /// The most lanes that a register of any instruction set has.
    const LANES_MAX: usize;
    /// Half the distance from 1 to the next number: what rounding changes at most, relatively.
    const ROUND_OFF: f64;
    /// Lengths below this have squares whose sum is finite, with room for a power.
    const FAR: Self;
    /// Squares of at least this keep all their digits, and so does their inverse.
    const NEAR: Self;

    /// The nearest number of this type; beyond the largest, infinity.
    fn nearest(x: f64) -> Self;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;
    /// The magnitude.
    #[must_use]
    fn abs(self) -> Self;
    /// What rounding takes from a product.
    #[must_use]
    fn lost_in_product(a: Self, b: Self) -> Self;
    /// The square root.
    #[must_use]
    fn square_root(self) -> Self;
    /// `self`, or a zero of its sign where it is smaller than a magnitude.
    #[must_use]
    fn at_rest_below(self, magnitude: Self) -> Self;
}

impl Real for f32 {
    type Vec3 = Vec3;
    const PRECISION: Precision = Precision::Single;
    const ZERO: Self = 0.0;
    const HALF: Self = 0.5;
    const ONE: Self = 1.0;
    const LARGEST: f64 = f32::MAX as f64;
    const REST: Self = f32::from_bits((127 - 100) << 23);
    // 2⁻¹⁰⁰ less half the distance to the single before it.
    const REST_UNROUNDED: f64 = f64::from_bits((1023 - 100) << 52) - f64::from_bits((1023 - 125) << 52);
    const LANES_MAX: usize = 16;
    const ROUND_OFF: f64 = f64::from_bits((1023 - 24) << 52);
    const FAR: Self = f32::from_bits((127 + 58) << 23);
    const NEAR: Self = f32::from_bits((127 - 100) << 23);

    #[expect(clippy::cast_possible_truncation, reason = "rounding to single is what it is for")]
    #[inline]
    fn nearest(x: f64) -> Self {
        x as f32
    }
    fn is_finite(self) -> bool {
        self.is_finite()
    }
    fn abs(self) -> Self {
        self.abs()
    }
    #[inline]
    fn lost_in_product(a: Self, b: Self) -> Self {
        // The product of two singles is a double.
        Self::nearest(f64::from(a) * f64::from(b) - f64::from(a * b))
    }
    #[inline]
    fn square_root(self) -> Self {
        self.sqrt()
    }
    #[inline]
    fn at_rest_below(self, magnitude: Self) -> Self {
        if self.abs() < magnitude { Self::copysign(0.0, self) } else { self }
    }
}

impl Real for f64 {
    type Vec3 = DVec3;
    const PRECISION: Precision = Precision::Double;
    const ZERO: Self = 0.0;
    const HALF: Self = 0.5;
    const ONE: Self = 1.0;
    const LARGEST: f64 = f64::MAX;
    const REST: Self = f64::from_bits((1023 - 960) << 52);
    const REST_UNROUNDED: f64 = Self::REST;
    const LANES_MAX: usize = 8;
    const ROUND_OFF: f64 = f64::from_bits((1023 - 53) << 52);
    const FAR: Self = f64::from_bits((1023 + 500) << 52);
    const NEAR: Self = f64::from_bits((1023 - 900) << 52);

    #[inline]
    fn nearest(x: f64) -> Self {
        x
    }
    fn is_finite(self) -> bool {
        self.is_finite()
    }
    fn abs(self) -> Self {
        self.abs()
    }
    #[inline]
    fn lost_in_product(a: Self, b: Self) -> Self {
        DoubleDouble::product(a, b).lo
    }
    #[inline]
    fn square_root(self) -> Self {
        self.sqrt()
    }
    #[inline]
    fn at_rest_below(self, magnitude: Self) -> Self {
        if self.abs() < magnitude { Self::copysign(0.0, self) } else { self }
    }
}
