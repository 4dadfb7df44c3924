//! The force accumulators, and on which particles a force acts.

use crate::column::Column;
use crate::ids::{Ids, ParticleId};
use crate::real::Real;

/// The sum of the forces added to each particle since the last advance. A scene without forces holds one zero.
#[derive(Debug, Clone)]
pub(crate) struct Accumulators<R: Real> {
    sum: Column<[R; 3]>,
    acting: Acting,
    /// Advances since the last one with a force.
    idle: u8,
}

/// On which particles a force acts.
#[derive(Debug, Clone)]
pub(crate) enum Acting {
    /// At most these, perhaps some of them named twice or gone.
    Few(Vec<ParticleId>),
    /// Perhaps on all.
    Many,
}

/// Sums to come back to: where they are few, without a copy of the column.
#[derive(Debug)]
pub(crate) enum Before<R: Real> {
    Few(Vec<(ParticleId, [R; 3])>),
    Many(Accumulators<R>),
}

/// A game that pushes every few ticks keeps its column.
const IDLE_MAX: u8 = 16;

impl<R: Real> Accumulators<R> {
    pub(crate) fn new() -> Self {
        Self { sum: Column::Uniform([R::ZERO; 3]), acting: Acting::Few(Vec::new()), idle: 0 }
    }

    /// These sums on particles any of which a force may act on.
    #[cfg(feature = "snapshot")]
    pub(crate) fn many(sum: Column<[R; 3]>) -> Self {
        Self { sum, acting: Acting::Many, idle: 0 }
    }

    /// These sums on `len` particles, and on some that are gone.
    #[cfg(feature = "snapshot")]
    pub(crate) fn few(few: &[(ParticleId, [R; 3])], ids: &Ids, len: usize) -> Self {
        let mut sum = Column::Uniform([R::ZERO; 3]);
        for (row, force) in few.iter().filter_map(|(id, force)| Some((ids.row(*id)?, *force))) {
            sum.set(row, force, len);
        }
        Self { sum, acting: Acting::Few(few.iter().map(|(id, _)| *id).collect()), idle: 0 }
    }

    pub(crate) fn get(&self, row: usize) -> [R; 3] {
        self.sum.get(row)
    }

    pub(crate) fn column(&self) -> &Column<[R; 3]> {
        &self.sum
    }

    pub(crate) fn acting(&self) -> &Acting {
        &self.acting
    }

    /// Whether it can be told at once that no force acts on any particle.
    pub(crate) fn none(&self) -> bool {
        match &self.acting {
            Acting::Few(ids) => ids.is_empty(),
            Acting::Many => false,
        }
    }

    /// Whether there is nothing to clear, and no column to give back.
    pub(crate) fn is_clear(&self) -> bool {
        self.none() && matches!(self.sum, Column::Uniform(_))
    }

    /// The same sum for every particle, where one value stands for all.
    pub(crate) fn set_all(&mut self, sum: [R; 3]) {
        self.idle = 0;
        self.sum = Column::Uniform(sum);
        self.acting = if sum == [R::ZERO; 3] { Acting::Few(Vec::new()) } else { Acting::Many };
    }

    pub(crate) fn set(&mut self, row: usize, id: ParticleId, sum: [R; 3], len: usize) {
        if let Acting::Few(ids) = &mut self.acting
            && self.sum.get(row) == [R::ZERO; 3]
        {
            // Above an eighth, looking at all of them is no slower than looking each of them up.
            if ids.len() > len / 8 {
                self.acting = Acting::Many;
            } else {
                ids.push(id);
            }
        }
        self.sum.set(row, sum, len);
    }

    /// The sums of now.
    pub(crate) fn before(&self, ids: &Ids) -> Before<R> {
        match &self.acting {
            Acting::Few(few) => Before::Few(few.iter().filter_map(|id| Some((*id, self.get(ids.row(*id)?)))).collect()),
            Acting::Many => Before::Many(self.clone()),
        }
    }

    /// These sums again, for the same particles.
    pub(crate) fn go_back(&mut self, before: Before<R>, ids: &Ids, len: usize) {
        match before {
            Before::Many(before) => *self = before,
            Before::Few(few) => {
                self.clear(ids);
                for (id, sum) in few {
                    self.set(ids.row(id).expect("the same particles"), id, sum, len);
                }
            }
        }
    }

    /// Appends `count` particles without a force to `len` others.
    pub(crate) fn extend(&mut self, len: usize, count: usize) {
        self.sum.extend(len, &Column::Uniform([R::ZERO; 3]), count);
    }

    pub(crate) fn swap_remove(&mut self, row: usize) {
        self.sum.swap_remove(row);
    }

    /// All zero again. The column is kept for the next forces, and given back after some advances without one.
    pub(crate) fn clear(&mut self, ids: &Ids) {
        self.idle = if self.none() { self.idle + 1 } else { 0 };
        match (&mut self.sum, &mut self.acting) {
            (Column::PerParticle(_), Acting::Few(few)) if few.is_empty() && self.idle < IDLE_MAX => {}
            (Column::PerParticle(sum), Acting::Few(few)) if !few.is_empty() => {
                for row in few.drain(..).filter_map(|id| ids.row(id)) {
                    sum[row] = [R::ZERO; 3];
                }
            }
            (Column::PerParticle(sum), Acting::Many) => {
                sum.fill([R::ZERO; 3]);
                self.acting = Acting::Few(Vec::new());
            }
            (Column::PerParticle(_) | Column::Uniform(_), _) => self.set_all([R::ZERO; 3]),
        }
    }
}
