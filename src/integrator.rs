//! How a world moves its particles: the integrator and the damping law.

use std::fmt::{self, Display};

/// The rule that takes position p and velocity v over one step of h seconds.
///
/// D is the damping over the step ([`DampingLaw`]), A = a + w F the acceleration with the force F and the inverse mass w.
/// Source: Ian Millington, *Game Physics Engine Development*, chapter 3.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Integrator {
    /// The closed form of constant acceleration and damping: no step, no step error, and an advance only moves the
    /// clock. The default. It is the limit of `NewtonEuler` for h → 0.
    ///
    /// Damping in continuous time is v' = A − λ v with λ = −ln d. Its solution after a time t, with E = d^t:
    /// v = v₀ E + A φ and p = p₀ + (v₀ φ + A ψ), where φ = (1 − E)/λ and ψ = (t − φ)/λ; for d = 1, E = 1, φ = t and
    /// ψ = t²/2. E, φ and ψ are within 0.55 units of the last place of a double.
    #[default]
    Exact,
    /// The book's integrator: p ← p + v h, then v ← (v + A h) D. Order 1.
    NewtonEuler,
    /// The book's longer position update: p ← (p + v h) + A (h h ½), then v ← (v + A h) D. Order 1 with damping; the
    /// position is exact without.
    NewtonEulerQuadratic,
    /// v ← (v + A h) D, then p ← p + v h. Order 1; symplectic without damping.
    SemiImplicitEuler,
    /// Half a kick with gravitation, the exact flow of everything else, half a kick. Order 2; symplectic without damping
    /// and drag; equal to `Exact` when nothing depends on position. Drag is split: half its exact flow, the kick of the constant
    /// acceleration, half its flow.
    ///
    /// Source: L. Verlet, Phys. Rev. 159 (1967); the composition: G. Strang, SIAM J. Numer. Anal. 5 (1968).
    VelocityVerlet,
    /// The classic method of Runge and Kutta on p' = v, v' = A(p, v) − λ v. Order 4; stable while λ h < 2.78. Source: W. Kutta,
    /// Z. Math. Phys. 46 (1901).
    Rk4,
    /// Order 8, with steps of the length that the tolerance of the world allows. Source: Hairer, Nørsett and Wanner, *Solving
    /// Ordinary Differential Equations I*, second edition, section II.10.
    Dop853,
}

impl Integrator {
    /// Every integrator, for loops over all of them.
    pub const ALL: [Self; 7] = [
        Self::Exact,
        Self::NewtonEuler,
        Self::NewtonEulerQuadratic,
        Self::SemiImplicitEuler,
        Self::VelocityVerlet,
        Self::Rk4,
        Self::Dop853,
    ];

    /// The name in JSON and logs, for example `newton_euler`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::NewtonEuler => "newton_euler",
            Self::NewtonEulerQuadratic => "newton_euler_quadratic",
            Self::SemiImplicitEuler => "semi_implicit_euler",
            Self::VelocityVerlet => "velocity_verlet",
            Self::Rk4 => "rk4",
            Self::Dop853 => "dop853",
        }
    }

    /// The power of h with which the error at a fixed time goes down; `None` when there is no step error.
    #[must_use]
    pub const fn order(self) -> Option<u32> {
        match self {
            Self::Exact => None,
            Self::NewtonEuler | Self::NewtonEulerQuadratic | Self::SemiImplicitEuler => Some(1),
            Self::VelocityVerlet => Some(2),
            Self::Rk4 => Some(4),
            Self::Dop853 => Some(8),
        }
    }

    /// How often a step computes the accelerations, where they are not constant.
    #[must_use]
    pub const fn evaluations(self) -> u64 {
        match self {
            Self::Exact => 0,
            Self::NewtonEuler | Self::NewtonEulerQuadratic | Self::SemiImplicitEuler | Self::VelocityVerlet => 1,
            Self::Rk4 => 4,
            Self::Dop853 => 12,
        }
    }

    /// Whether it is one of the three of the book's kind, which add an acceleration once for each step.
    #[must_use]
    pub const fn is_euler(self) -> bool {
        matches!(self, Self::NewtonEuler | Self::NewtonEulerQuadratic | Self::SemiImplicitEuler)
    }

    /// Whether it can compute with this damping law: only Euler's kind knows [`DampingLaw::PerStep`].
    #[must_use]
    pub const fn serves(self, law: DampingLaw) -> bool {
        match law {
            DampingLaw::PerSecond => true,
            DampingLaw::PerStep => self.is_euler(),
        }
    }

    /// Whether it can compute with a damping of 0, which stops everything at once: not as the differential equation
    /// that Runge-Kutta methods solve.
    #[must_use]
    pub const fn serves_zero_damping(self) -> bool {
        !matches!(self, Self::Rk4 | Self::Dop853)
    }

    /// Whether it can compute with forces that depend on position or velocity: the closed form cannot.
    #[must_use]
    pub const fn serves_forces(self) -> bool {
        !matches!(self, Self::Exact)
    }
}

impl Display for Integrator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What a particle's damping d, 0 to 1, does to its velocity in a step of h seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum DampingLaw {
    /// D = d^h: the share d is kept each second, however long the steps are (Millington, equation 3.6). The default.
    #[default]
    PerSecond,
    /// D = d: the share d is kept each step (Millington, equation 3.5).
    PerStep,
}

impl DampingLaw {
    /// Both laws.
    pub const ALL: [Self; 2] = [Self::PerSecond, Self::PerStep];

    /// `per_second` or `per_step`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::PerSecond => "per_second",
            Self::PerStep => "per_step",
        }
    }
}

impl Display for DampingLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
