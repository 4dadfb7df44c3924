//! The columns of one world.

use crate::column::Column;
use crate::double_double::DoubleDouble;
use crate::real::Real;

/// The properties of all particles. Invariant: position, velocity and every per-particle column have `len` values.
#[derive(Debug, Clone)]
pub(crate) struct Particles<R: Real> {
    pub(crate) position: Vec<[R; 3]>,
    pub(crate) velocity: Vec<[R; 3]>,
    /// Own acceleration; `None` follows the gravity of the world.
    pub(crate) acceleration: Column<Option<[R; 3]>>,
    pub(crate) damping: Column<R>,
    pub(crate) inverse_mass: Column<R>,
    pub(crate) force: Column<[R; 3]>,
    /// The clock at which position and velocity hold. Under a stepped integrator it is always the clock of the world.
    pub(crate) base_time: Column<DoubleDouble>,
}

pub(crate) const fn zero<R: Real>() -> [R; 3] {
    [R::ZERO; 3]
}

impl<R: Real> Particles<R> {
    pub(crate) fn new() -> Self {
        Self {
            position: Vec::new(),
            velocity: Vec::new(),
            acceleration: Column::Uniform(None),
            damping: Column::Uniform(R::ONE),
            inverse_mass: Column::Uniform(R::ONE),
            force: Column::Uniform(zero()),
            base_time: Column::Uniform(DoubleDouble::default()),
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.position.len()
    }

    /// The acceleration without the share of the force: its own, else the gravity unless it is immovable.
    pub(crate) fn acceleration(&self, row: usize, gravity: [R; 3]) -> [R; 3] {
        let following = if self.inverse_mass.get(row) == R::ZERO { zero() } else { gravity };
        self.acceleration.get(row).unwrap_or(following)
    }

    /// Immovable, without velocity and acceleration: nothing can change it.
    pub(crate) fn is_resting(&self, row: usize) -> bool {
        self.inverse_mass.get(row) == R::ZERO
            && self.velocity[row] == zero()
            && self.acceleration.get(row).is_none_or(|own| own == zero())
    }

    /// Whether a force acts on it.
    pub(crate) fn is_forced(&self, row: usize) -> bool {
        self.force.get(row) != zero() && self.inverse_mass.get(row) != R::ZERO
    }

    /// Whether any particle could be resting; decided without a look at each.
    pub(crate) fn may_rest(&self) -> bool {
        !matches!(self.inverse_mass, Column::Uniform(w) if w != R::ZERO)
    }

    pub(crate) fn swap_remove(&mut self, row: usize) {
        self.position.swap_remove(row);
        self.velocity.swap_remove(row);
        self.acceleration.swap_remove(row);
        self.damping.swap_remove(row);
        self.inverse_mass.swap_remove(row);
        self.force.swap_remove(row);
        self.base_time.swap_remove(row);
    }
}
