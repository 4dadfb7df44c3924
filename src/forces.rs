//! The forces that depend on where a particle is and how fast it moves. Each is off unless the world asks for it.

use crate::real::Real;

/// The forces of a world beside those that are added to its particles. None by default.
///
/// ```
/// use pointmass::{Drag, Forces, Gravitation, Integrator, Settings, World};
/// let forces = Forces { gravitation: Some(Gravitation::default()), ..Forces::default() };
/// let world = World::<f64>::new(Settings { forces, integrator: Integrator::VelocityVerlet, ..Settings::default() })?;
/// # Ok::<(), pointmass::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forces<R: Real = f64> {
    /// Slows every movable particle down; `None`: no particle has drag.
    pub drag: Option<Drag<R>>,
    /// Every particle attracts every movable one; `None`: none does.
    pub gravitation: Option<Gravitation<R>>,
}

impl<R: Real> Default for Forces<R> {
    fn default() -> Self {
        Self { drag: None, gravitation: None }
    }
}

impl<R: Real> Forces<R> {
    /// Whether there is one.
    #[must_use]
    pub fn any(&self) -> bool {
        self.drag.is_some() || self.gravitation.is_some()
    }
}

/// Drag: a force of k₁ |v| + k₂ |v|² newtons against the velocity v.
///
/// It is a force, so that a heavy particle feels it less, unlike damping. Source: Millington, chapter 5.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drag<R: Real = f64> {
    /// In kg/s, at least 0. Default 0.
    pub k1: R,
    /// In kg/m, at least 0. Default 0.
    pub k2: R,
}

impl<R: Real> Default for Drag<R> {
    fn default() -> Self {
        Self { k1: R::ZERO, k2: R::ZERO }
    }
}

/// Newton's law between every pair of particles: a force of G m₁ m₂ r / (r² + ε²)^(3/2) newtons at a distance r.
///
/// m is the mass of the particle, 0 for an immovable one, or its gravitational mass where it is given one. Particles at the
/// same place do not attract each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gravitation<R: Real = f64> {
    /// G in m³/(kg s²), at least 0. Default 6.6743e-11 (CODATA 2018).
    pub constant: R,
    /// ε in metres, at least 0. Default 0.
    pub softening: R,
}

impl<R: Real> Default for Gravitation<R> {
    fn default() -> Self {
        Self { constant: R::nearest(6.6743e-11), softening: R::ZERO }
    }
}
