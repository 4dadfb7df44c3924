//! The force accumulators, and on which particles a force acts.

use std::ops::Range;
use std::sync::OnceLock;

use rustc_hash::FxHashMap;

use crate::column::Column;
use crate::real::Real;

/// The sum of the forces added to each particle since the last advance.
#[derive(Debug, Clone)]
pub(crate) struct Accumulators<R: Real> {
    acting: Acting<R>,
    /// Room for a sum for each, of a game that pushes many particles at every tick.
    spare: Vec<[R; 3]>,
    /// Advances since the last one with a force.
    idle: u8,
}

/// On which particles a force acts, and the sums.
#[derive(Debug, Clone)]
pub(crate) enum Acting<R: Real> {
    Few(Few<R>),
    /// Perhaps on all.
    Many(Column<[R; 3]>),
}

/// Sums of some rows. They are together, where a column would be read here and there.
#[derive(Debug, Clone, Default)]
pub(crate) struct Few<R: Real> {
    sums: FxHashMap<u32, [R; 3]>,
    /// The rows in ascending order, since somebody asked.
    rows: OnceLock<Vec<u32>>,
}

/// A game that pushes every few ticks keeps its room.
const IDLE_MAX: u8 = 16;

impl<R: Real> Few<R> {
    pub(crate) fn len(&self) -> usize {
        self.sums.len()
    }

    /// Those of some rows, in ascending order.
    pub(crate) fn within(&self, rows: Range<usize>) -> impl Iterator<Item = (usize, [R; 3])> {
        let all = self.rows.get_or_init(|| {
            let mut all: Vec<u32> = self.sums.keys().copied().collect();
            all.sort_unstable();
            all
        });
        let [start, end] = [rows.start, rows.end].map(|bound| all.partition_point(|row| (*row as usize) < bound));
        all[start..end].iter().map(|row| (*row as usize, self.sums[row]))
    }

    fn get(&self, row: usize) -> Option<[R; 3]> {
        self.sums.get(&key(row)).copied()
    }

    /// The sum of a row, to be written.
    fn entry(&mut self, row: usize) -> &mut [R; 3] {
        self.sums.entry(key(row)).or_insert_with(|| {
            self.rows.take();
            [R::ZERO; 3]
        })
    }

    fn swap_remove(&mut self, row: usize, last: usize) {
        self.rows.take();
        self.sums.remove(&key(row));
        if let Some(sum) = self.sums.remove(&key(last)) {
            self.sums.insert(key(row), sum);
        }
    }
}

fn key(row: usize) -> u32 {
    u32::try_from(row).expect("rows are counted in 32 bits")
}

impl<R: Real> Default for Accumulators<R> {
    fn default() -> Self {
        Self { acting: Acting::Few(Few::default()), spare: Vec::new(), idle: 0 }
    }
}

impl<R: Real> Accumulators<R> {
    /// These sums on particles any of which a force may act on.
    #[cfg(feature = "snapshot")]
    pub(crate) fn many(sums: Column<[R; 3]>) -> Self {
        Self { acting: Acting::Many(sums), ..Self::default() }
    }

    /// These sums of some rows.
    #[cfg(feature = "snapshot")]
    pub(crate) fn few(few: impl Iterator<Item = (usize, [R; 3])>) -> Self {
        let sums = few.map(|(row, sum)| (key(row), sum)).collect();
        Self { acting: Acting::Few(Few { sums, rows: OnceLock::new() }), ..Self::default() }
    }

    pub(crate) fn get(&self, row: usize) -> [R; 3] {
        match &self.acting {
            Acting::Few(few) => few.get(row).unwrap_or([R::ZERO; 3]),
            Acting::Many(column) => column.get(row),
        }
    }

    pub(crate) fn acting(&self) -> &Acting<R> {
        &self.acting
    }

    /// The same sum for all, where one value stands for them.
    pub(crate) fn uniform(&self) -> Option<[R; 3]> {
        match &self.acting {
            Acting::Few(few) => few.sums.is_empty().then_some([R::ZERO; 3]),
            Acting::Many(Column::Uniform(sum)) => Some(*sum),
            Acting::Many(Column::PerParticle(_)) => None,
        }
    }

    /// Whether it can be told at once that no force acts on any particle.
    pub(crate) fn none(&self) -> bool {
        matches!(&self.acting, Acting::Few(few) if few.sums.is_empty())
    }

    /// Whether there is nothing to clear, and no room to give back.
    pub(crate) fn is_clear(&self) -> bool {
        matches!(&self.acting, Acting::Few(few) if few.sums.capacity() == 0) && self.spare.capacity() == 0
    }

    /// Whether it can be told at once that none acts on these rows.
    pub(crate) fn none_within(&self, rows: Range<usize>) -> bool {
        match &self.acting {
            Acting::Few(few) => few.sums.is_empty() || few.within(rows).next().is_none(),
            Acting::Many(_) => false,
        }
    }

    /// Which of `len` rows a force acts on, in any order.
    pub(crate) fn rows(&self, len: usize) -> Vec<usize> {
        match &self.acting {
            Acting::Few(few) => {
                let acts = few.sums.iter().filter(|(_, sum)| **sum != [R::ZERO; 3]);
                acts.map(|(row, _)| *row as usize).collect()
            }
            Acting::Many(column) => (0..len).filter(|row| column.get(*row) != [R::ZERO; 3]).collect(),
        }
    }

    /// Every sum that is kept, once or more.
    pub(crate) fn sums(&self) -> impl Iterator<Item = [R; 3]> {
        let (few, many) = match &self.acting {
            Acting::Few(few) => (Some(few.sums.values().copied()), None),
            Acting::Many(column) => (None, Some(column.entries().map(|(_, sum)| sum))),
        };
        few.into_iter().flatten().chain(many.into_iter().flatten())
    }

    /// What they take.
    #[cfg(feature = "server")]
    pub(crate) fn bytes(&self) -> u64 {
        let acting = match &self.acting {
            Acting::Few(few) => (few.sums.capacity() * size_of::<(u32, [R; 3])>()) as u64,
            Acting::Many(column) => column.bytes(),
        };
        acting + (self.spare.capacity() * size_of::<[R; 3]>()) as u64
    }

    /// The same sum for every particle.
    pub(crate) fn set_all(&mut self, sum: [R; 3]) {
        let many = || Acting::Many(Column::Uniform(sum));
        self.acting = if sum == [R::ZERO; 3] { Acting::Few(Few::default()) } else { many() };
    }

    /// Adds to one of `len` sums, of which `more` are about to be added to. What it is then.
    pub(crate) fn add(&mut self, row: usize, force: [R; 3], more: usize, len: usize) -> [R; 3] {
        if let Acting::Few(few) = &self.acting
            && few.len() + more > len.div_ceil(8)
        {
            self.spread(len);
        }
        let add = |sum: [R; 3]| std::array::from_fn(|k| sum[k] + force[k]);
        match &mut self.acting {
            Acting::Few(few) => {
                let sum = few.entry(row);
                *sum = add(*sum);
                *sum
            }
            Acting::Many(column) => {
                let sum = add(column.get(row));
                column.set(row, sum, len);
                sum
            }
        }
    }

    /// From a few rows to a sum for each: above an eighth, looking at all of them is no slower than looking each of them up.
    fn spread(&mut self, len: usize) {
        let Acting::Few(few) = &self.acting else { return };
        let mut column = std::mem::take(&mut self.spare);
        column.resize(len, [R::ZERO; 3]);
        few.sums.iter().for_each(|(row, sum)| column[*row as usize] = *sum);
        self.acting = Acting::Many(Column::PerParticle(column));
    }

    /// These sums again, for the same particles.
    pub(crate) fn go_back(&mut self, before: Acting<R>) {
        self.acting = before;
    }

    /// Appends `count` particles without a force to `len` others.
    pub(crate) fn extend(&mut self, len: usize, count: usize) {
        if let Acting::Many(column) = &mut self.acting {
            column.extend(len, &Column::Uniform([R::ZERO; 3]), count);
        }
    }

    /// Forgets a row, which the last one takes over.
    pub(crate) fn swap_remove(&mut self, row: usize, last: usize) {
        match &mut self.acting {
            Acting::Few(few) if few.sums.is_empty() => {}
            Acting::Few(few) => few.swap_remove(row, last),
            Acting::Many(column) => column.swap_remove(row),
        }
    }

    /// All zero again. The room is kept for the next forces, and given back after some advances without one.
    pub(crate) fn clear(&mut self) {
        if self.none() {
            self.idle += 1;
            if self.idle == IDLE_MAX {
                *self = Self::default();
            }
            return;
        }
        self.idle = 0;
        match &mut self.acting {
            Acting::Few(few) => {
                few.sums.clear();
                few.rows.take();
            }
            Acting::Many(column) => {
                if let Column::PerParticle(sums) = column {
                    sums.clear();
                    self.spare = std::mem::take(sums);
                }
                self.acting = Acting::Few(Few::default());
            }
        }
    }
}
