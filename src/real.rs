//! The two precisions a world can have.

use std::fmt::{Debug, Display};
use std::ops::{Add, Mul, Sub};

use glam::{DVec3, Vec3};

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
    use fearless_simd::{Simd, SimdFloat, SimdFloatElement};

    pub trait Sealed: Sized + SimdFloatElement {
        /// A vector register of these.
        type Lanes<S: Simd>: SimdFloat<S, Element = Self>;
    }
    impl Sealed for f32 {
        type Lanes<S: Simd> = S::f32s;
    }
    impl Sealed for f64 {
        type Lanes<S: Simd> = S::f64s;
    }
}

/// The number type of a world: `f32` with [`glam::Vec3`], or `f64` with [`glam::DVec3`]. Sealed.
pub trait Real:
    sealed::Sealed
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

    /// The nearest number of this type; beyond the largest, infinity.
    fn nearest(x: f64) -> Self;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;
    /// The magnitude.
    #[must_use]
    fn abs(self) -> Self;
    /// A zero with the sign of `self`.
    #[must_use]
    fn signed_zero(self) -> Self;
}

impl Real for f32 {
    type Vec3 = Vec3;
    const PRECISION: Precision = Precision::Single;
    const ZERO: Self = 0.0;
    const HALF: Self = 0.5;
    const ONE: Self = 1.0;
    const LARGEST: f64 = f32::MAX as f64;
    const REST: Self = f32::from_bits((127 - 100) << 23);

    #[expect(clippy::cast_possible_truncation, reason = "rounding to single is what it is for")]
    fn nearest(x: f64) -> Self {
        x as f32
    }
    fn is_finite(self) -> bool {
        self.is_finite()
    }
    fn abs(self) -> Self {
        self.abs()
    }
    fn signed_zero(self) -> Self {
        Self::copysign(0.0, self)
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

    fn nearest(x: f64) -> Self {
        x
    }
    fn is_finite(self) -> bool {
        self.is_finite()
    }
    fn abs(self) -> Self {
        self.abs()
    }
    fn signed_zero(self) -> Self {
        Self::copysign(0.0, self)
    }
}
