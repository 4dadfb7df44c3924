//! The columns of one world.

use std::ops::Range;

use fearless_simd::{Level, Simd, dispatch};

use crate::accumulators::{Accumulators, Acting};
use crate::base_times::BaseTimes;
use crate::column::{self, Column};
use crate::double_double::DoubleDouble;
use crate::forces::Drag;
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
    /// How many inverse masses are 0: where there is none, all follow the gravity that have no acceleration of their own.
    pub(crate) immovable_count: usize,
    pub(crate) force: Accumulators<R>,
    /// Own drag, where there is one; otherwise that of the world.
    pub(crate) drag: Column<Option<Drag<R>>>,
    /// The mass that attracts, where it is not the inverse of the inverse mass.
    pub(crate) gravitational_mass: Column<Option<R>>,
    /// What rounding took from position and velocity, in a world of compensated sums; empty otherwise.
    pub(crate) residual: Residuals<R>,
    /// The clock at which position and velocity hold. Under a stepped integrator it is always the clock of the world.
    pub(crate) base_time: BaseTimes,
    /// Immovable, without velocity and acceleration: nothing can change such a particle but a command that names it.
    resting: Column<bool>,
    resting_count: usize,
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

/// Particles to add; every column is uniform or has one value for each.
pub(crate) struct New<'a, R: Real> {
    pub(crate) position: &'a Column<R::Vec3>,
    pub(crate) velocity: &'a Column<R::Vec3>,
    pub(crate) acceleration: Column<Option<[R; 3]>>,
    pub(crate) damping: Column<R>,
    pub(crate) inverse_mass: Column<R>,
    pub(crate) drag: Column<Option<Drag<R>>>,
    pub(crate) gravitational_mass: Column<Option<R>>,
}

/// What rounding took from the positions and velocities of all particles; or nothing.
#[derive(Debug, Clone)]
pub(crate) struct Residuals<R> {
    pub(crate) position: Vec<[R; 3]>,
    pub(crate) velocity: Vec<[R; 3]>,
}

impl<R: Real> Residuals<R> {
    /// For `len` particles, or for none.
    pub(crate) fn zero(len: usize) -> Self {
        Self { position: vec![zero(); len], velocity: vec![zero(); len] }
    }
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
            force: Accumulators::default(),
            drag: Column::Uniform(None),
            gravitational_mass: Column::Uniform(None),
            residual: Residuals::zero(0),
            base_time: BaseTimes::default(),
            resting: Column::Uniform(false),
            resting_count: 0,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.position.len()
    }

    /// What the columns take.
    #[cfg(feature = "server")]
    pub(crate) fn bytes(&self) -> u64 {
        let vector = size_of::<[R; 3]>();
        let residual = self.residual.position.len();
        let vectors = 2 * self.len() + 2 * residual;
        (vectors * vector) as u64
            + self.own_acceleration.bytes()
            + self.has_own_acceleration.bytes()
            + self.damping.bytes()
            + self.inverse_mass.bytes()
            + self.force.bytes()
            + self.drag.bytes()
            + self.gravitational_mass.bytes()
            + self.base_time.bytes()
            + self.resting.bytes()
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

    /// Whether nothing can change it.
    pub(crate) fn is_resting(&self, row: usize) -> bool {
        self.resting.get(row)
    }

    pub(crate) fn resting_count(&self) -> usize {
        self.resting_count
    }

    /// Finds out anew whether a row rests, after its velocity, acceleration or mass was written.
    pub(crate) fn note_rest(&mut self, row: usize) {
        let rests = self.inverse_mass.get(row) == R::ZERO
            && self.velocity[row] == zero()
            && self.own_acceleration.get(row) == zero();
        self.resting_count = self.resting_count - usize::from(self.resting.get(row)) + usize::from(rests);
        self.resting.set(row, rests, self.position.len());
        if self.resting_count == 0 {
            self.resting = Column::Uniform(false);
        }
    }

    /// Puts a row where it is at a clock, from then on its base time.
    pub(crate) fn set_base(&mut self, row: usize, position: [R; 3], velocity: [R; 3], clock: DoubleDouble) {
        let len = self.len();
        (self.position[row], self.velocity[row]) = (position, velocity);
        self.base_time.set(row, clock, len);
        self.note_rest(row);
    }

    /// Finds out anew after steps, in which immovable particles may have come to rest.
    pub(crate) fn note_rest_after_steps(&mut self) {
        if self.resting_count < self.immovable_count {
            for row in 0..self.len() {
                if self.inverse_mass.get(row) == R::ZERO {
                    self.note_rest(row);
                }
            }
        }
    }

    /// Finds out who is immovable and who rests, after all columns were written.
    #[cfg(feature = "snapshot")]
    pub(crate) fn note_all(&mut self) {
        for row in 0..self.len() {
            if self.inverse_mass.get(row) == R::ZERO {
                self.immovable_count += 1;
                self.note_rest(row);
            }
        }
    }

    /// Appends `count` particles.
    pub(crate) fn extend(&mut self, new: &New<'_, R>, count: usize, clock: DoubleDouble, compensated: bool) {
        let len = self.len();
        if compensated {
            self.residual.position.resize(len + count, zero());
            self.residual.velocity.resize(len + count, zero());
        }
        extend_vectors(&mut self.position, new.position, count);
        extend_vectors(&mut self.velocity, new.velocity, count);
        self.own_acceleration.extend(len, &new.acceleration.map(Option::unwrap_or_default), count);
        self.has_own_acceleration.extend(len, &new.acceleration.map(|own| own.is_some()).collapsed(), count);
        self.damping.extend(len, &new.damping, count);
        self.inverse_mass.extend(len, &new.inverse_mass, count);
        self.force.extend(len, count);
        self.drag.extend(len, &new.drag, count);
        self.gravitational_mass.extend(len, &new.gravitational_mass, count);
        self.base_time.extend(len, clock, count);
        self.resting.extend(len, &Column::Uniform(false), count);
        let immovable = |i: &usize| new.inverse_mass.get(*i) == R::ZERO;
        for i in (0..count).filter(immovable) {
            self.immovable_count += 1;
            self.note_rest(len + i);
        }
    }

    /// One of them by itself, with its force.
    pub(crate) fn alone(&self, row: usize, clock: DoubleDouble, compensated: bool) -> Self {
        let mut alone = Self::new();
        let new = New {
            position: &Column::Uniform(self.position[row].into()),
            velocity: &Column::Uniform(self.velocity[row].into()),
            acceleration: Column::Uniform(self.own(row)),
            damping: Column::Uniform(self.damping.get(row)),
            inverse_mass: Column::Uniform(self.inverse_mass.get(row)),
            drag: Column::Uniform(self.drag.get(row)),
            gravitational_mass: Column::Uniform(self.gravitational_mass.get(row)),
        };
        alone.extend(&new, 1, clock, compensated);
        if compensated {
            alone.residual.position[0] = self.residual.position[row];
            alone.residual.velocity[0] = self.residual.velocity[row];
        }
        alone.force.set_all(self.force.get(row));
        alone
    }

    /// The acceleration without the share of the force, where it is the same for all.
    pub(crate) fn uniform_acceleration(&self, gravity: [R; 3]) -> Option<[R; 3]> {
        match (&self.has_own_acceleration, &self.own_acceleration) {
            (Column::Uniform(true), Column::Uniform(own)) => Some(*own),
            (Column::Uniform(false), _) if gravity == zero() || self.immovable_count == 0 => Some(gravity),
            (Column::Uniform(false), _) if self.immovable_count == self.len() => Some(zero()),
            (Column::Uniform(_) | Column::PerParticle(_), _) => None,
        }
    }

    /// The acceleration of some rows, with the share of the force, as far as it can be told without computing it.
    pub(crate) fn driving_acceleration(&self, gravity: [R; 3], rows: Range<usize>) -> Driving<'_, R> {
        if !self.force.none_within(rows.clone()) {
            return Driving::Each;
        }
        match (self.uniform_acceleration(gravity), &self.has_own_acceleration, &self.own_acceleration) {
            (Some(uniform), _, _) => Driving::Uniform(uniform),
            (None, Column::Uniform(true), Column::PerParticle(own)) => Driving::Column(&own[rows]),
            (None, Column::Uniform(_) | Column::PerParticle(_), _) => Driving::Each,
        }
    }

    /// Computes the acceleration of some rows, with the share of the force.
    pub(crate) fn fill_acceleration(&self, level: Level, gravity: [R; 3], rows: Range<usize>, into: &mut [[R; 3]]) {
        match (&self.has_own_acceleration, &self.own_acceleration) {
            (Column::Uniform(true), Column::PerParticle(own)) => into.copy_from_slice(&own[rows.clone()]),
            (Column::Uniform(true), Column::Uniform(own)) => into.fill(*own),
            (Column::Uniform(false), _) if self.immovable_count == 0 => into.fill(gravity),
            (Column::Uniform(false) | Column::PerParticle(_), _) => {
                rows.clone().zip(&mut *into).for_each(|(row, a)| *a = self.acceleration(row, gravity));
            }
        }
        let add = |a: &mut [R; 3], f: [R; 3], w: R| *a = std::array::from_fn(|k| a[k] + f[k] * w);
        match (self.force.acting(), &self.inverse_mass) {
            (Acting::Few(few), w) => {
                few.within(rows.clone()).for_each(|(row, f)| add(&mut into[row - rows.start], f, w.get(row)));
            }
            (Acting::Many(Column::PerParticle(f)), Column::PerParticle(w)) => {
                dispatch!(level, simd => add_each(simd, into, &f[rows.clone()], &w[rows]));
            }
            (Acting::Many(f), w) => into.iter_mut().zip(rows).for_each(|(a, row)| add(a, f.get(row), w.get(row))),
        }
    }

    /// Whether a force acts on it.
    pub(crate) fn is_forced(&self, row: usize) -> bool {
        self.force.get(row) != zero() && self.inverse_mass.get(row) != R::ZERO
    }

    /// The mass in kilograms with which it attracts others.
    pub(crate) fn attracting_mass(&self, row: usize) -> f64 {
        let w: f64 = self.inverse_mass.get(row).into();
        let mass = if w == 0.0 { 0.0 } else { 1.0 / w };
        self.gravitational_mass.get(row).map_or(mass, Into::into)
    }

    /// Sets the inverse mass of all.
    pub(crate) fn set_inverse_masses(&mut self, w: R) {
        self.inverse_mass = Column::Uniform(w);
        self.immovable_count = if w == R::ZERO { self.len() } else { 0 };
    }

    /// Sets the inverse mass of one row.
    pub(crate) fn set_inverse_mass(&mut self, row: usize, w: R) {
        let was = usize::from(self.inverse_mass.get(row) == R::ZERO);
        self.immovable_count = self.immovable_count - was + usize::from(w == R::ZERO);
        self.inverse_mass.set(row, w, self.position.len());
    }

    pub(crate) fn swap_remove(&mut self, row: usize) {
        self.immovable_count -= usize::from(self.inverse_mass.get(row) == R::ZERO);
        self.resting_count -= usize::from(self.resting.get(row));
        column::swap_remove(&mut self.position, row);
        column::swap_remove(&mut self.velocity, row);
        self.own_acceleration.swap_remove(row);
        self.has_own_acceleration.swap_remove(row);
        self.damping.swap_remove(row);
        self.inverse_mass.swap_remove(row);
        self.force.swap_remove(row, self.position.len());
        self.drag.swap_remove(row);
        self.gravitational_mass.swap_remove(row);
        if !self.residual.position.is_empty() {
            column::swap_remove(&mut self.residual.position, row);
            column::swap_remove(&mut self.residual.velocity, row);
        }
        self.base_time.swap_remove(row);
        self.resting.swap_remove(row);
    }
}

/// a + w F, the share of the force of each.
#[expect(clippy::inline_always, reason = "a call that is not inlined leaves the instruction set of its caller")]
#[inline(always)]
fn add_each<S: Simd, R: Real>(_: S, a: &mut [[R; 3]], f: &[[R; 3]], w: &[R]) {
    for ((a, f), w) in a.iter_mut().zip(f).zip(w) {
        for k in 0..3 {
            a[k] = a[k] + f[k] * *w;
        }
    }
}

fn extend_vectors<R: Real>(vectors: &mut Vec<[R; 3]>, new: &Column<R::Vec3>, count: usize) {
    column::make_room(vectors, count);
    match new {
        Column::Uniform(vector) => vectors.resize(vectors.len() + count, (*vector).into()),
        Column::PerParticle(new) => vectors.extend(new[..count].iter().map(|vector| (*vector).into())),
    }
}
