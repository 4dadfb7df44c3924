//! The columns of one world.

use std::ops::Range;

use crate::column::Column;
use crate::double_double::DoubleDouble;
use crate::real::Real;

/// The properties of all particles. Invariant: position, velocity and every per-particle column have `len` values.
#[derive(Debug, Clone)]
pub(crate) struct Particles<R: Real> {
    pub(crate) position: Vec<[R; 3]>,
    pub(crate) velocity: Vec<[R; 3]>,
    /// Own acceleration, where there is one, else 0.
    pub(crate) own_acceleration: Column<[R; 3]>,
    /// Whether there is one; otherwise the particle follows the gravity of the world.
    pub(crate) has_own_acceleration: Column<bool>,
    pub(crate) damping: Column<R>,
    pub(crate) inverse_mass: Column<R>,
    /// How many inverse masses are 0: where there is none, nobody looks for particles at rest.
    pub(crate) immovable_count: usize,
    pub(crate) force: Column<[R; 3]>,
    /// The clock at which position and velocity hold. Under a stepped integrator it is always the clock of the world.
    pub(crate) base_time: Column<DoubleDouble>,
}

/// What drives some rows.
pub(crate) enum Driving<'a, R> {
    /// The same for all.
    Uniform([R; 3]),
    /// What a column has.
    Column(&'a [[R; 3]]),
    /// It has to be computed for each.
    Each,
}

pub(crate) const fn zero<R: Real>() -> [R; 3] {
    [R::ZERO; 3]
}

impl<R: Real> Particles<R> {
    pub(crate) fn new() -> Self {
        Self {
            position: Vec::new(),
            velocity: Vec::new(),
            own_acceleration: Column::Uniform(zero()),
            has_own_acceleration: Column::Uniform(false),
            damping: Column::Uniform(R::ONE),
            inverse_mass: Column::Uniform(R::ONE),
            immovable_count: 0,
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
        self.own(row).unwrap_or(following)
    }

    /// Its own acceleration, if it has one.
    pub(crate) fn own(&self, row: usize) -> Option<[R; 3]> {
        self.has_own_acceleration.get(row).then(|| self.own_acceleration.get(row))
    }

    /// Immovable, without velocity and acceleration: nothing can change it.
    pub(crate) fn is_resting(&self, row: usize) -> bool {
        self.nothing_moves(row) && self.velocity[row] == zero()
    }

    /// Immovable and without acceleration: only its own velocity moves it.
    pub(crate) fn nothing_moves(&self, row: usize) -> bool {
        self.inverse_mass.get(row) == R::ZERO && self.own_acceleration.get(row) == zero()
    }

    /// The acceleration of some rows, with the share of the force, as far as it can be told without computing it.
    pub(crate) fn driving_acceleration(&self, gravity: [R; 3], rows: Range<usize>) -> Driving<'_, R> {
        if self.force != Column::Uniform(zero()) {
            return Driving::Each;
        }
        match (&self.has_own_acceleration, &self.own_acceleration) {
            (Column::Uniform(true), Column::Uniform(own)) => Driving::Uniform(*own),
            (Column::Uniform(true), Column::PerParticle(own)) => Driving::Column(&own[rows]),
            (Column::Uniform(false), _) if gravity == zero() => Driving::Uniform(gravity),
            (Column::Uniform(false), _) => match &self.inverse_mass {
                _ if self.immovable_count == 0 => Driving::Uniform(gravity),
                Column::Uniform(_) => Driving::Uniform(zero()),
                Column::PerParticle(_) => Driving::Each,
            },
            (Column::PerParticle(_), _) => Driving::Each,
        }
    }

    /// Computes the acceleration of some rows, with the share of the force.
    pub(crate) fn fill_acceleration(&self, gravity: [R; 3], rows: Range<usize>, into: &mut [[R; 3]]) {
        for (row, a) in rows.zip(into) {
            let own = self.acceleration(row, gravity);
            let (w, f) = (self.inverse_mass.get(row), self.force.get(row));
            *a = std::array::from_fn(|k| own[k] + f[k] * w);
        }
    }

    /// Whether a force acts on it.
    pub(crate) fn is_forced(&self, row: usize) -> bool {
        self.force.get(row) != zero() && self.inverse_mass.get(row) != R::ZERO
    }

    /// Sets `immovable_count` to what the inverse masses say.
    pub(crate) fn count_immovable(&mut self) {
        self.immovable_count = match &self.inverse_mass {
            Column::Uniform(w) if *w == R::ZERO => self.len(),
            Column::Uniform(_) => 0,
            Column::PerParticle(w) => w.iter().filter(|w| **w == R::ZERO).count(),
        };
    }

    pub(crate) fn swap_remove(&mut self, row: usize) {
        self.immovable_count -= usize::from(self.inverse_mass.get(row) == R::ZERO);
        self.position.swap_remove(row);
        self.velocity.swap_remove(row);
        self.own_acceleration.swap_remove(row);
        self.has_own_acceleration.swap_remove(row);
        self.damping.swap_remove(row);
        self.inverse_mass.swap_remove(row);
        self.force.swap_remove(row);
        self.base_time.swap_remove(row);
    }
}
