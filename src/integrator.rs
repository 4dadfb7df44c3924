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
}

impl Integrator {
    /// Every integrator, for loops over all of them.
    pub const ALL: [Self; 4] = [Self::Exact, Self::NewtonEuler, Self::NewtonEulerQuadratic, Self::SemiImplicitEuler];

    /// The name in JSON and logs, for example `newton_euler`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::NewtonEuler => "newton_euler",
            Self::NewtonEulerQuadratic => "newton_euler_quadratic",
            Self::SemiImplicitEuler => "semi_implicit_euler",
        }
    }

    /// The power of h with which the error at a fixed time goes down; `None` when there is no step error.
    #[must_use]
    pub const fn order(self) -> Option<u32> {
        match self {
            Self::Exact => None,
            Self::NewtonEuler | Self::NewtonEulerQuadratic | Self::SemiImplicitEuler => Some(1),
        }
    }

    /// Whether it can compute with this damping law: the closed form knows only [`DampingLaw::PerSecond`].
    #[must_use]
    pub const fn serves(self, law: DampingLaw) -> bool {
        match law {
            DampingLaw::PerSecond => true,
            DampingLaw::PerStep => !matches!(self, Self::Exact),
        }
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
