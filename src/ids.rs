//! Which row of the columns each particle lives in.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::column;

/// The name of a particle in its world: 0, 1, 2, … in the order of creation, never used again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ParticleId(pub u64);

impl std::fmt::Display for ParticleId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// Ids to rows and back. Removal moves the last row into the gap, so that columns stay dense.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ids {
    next: u64,
    /// `None` until the first removal: particle `i` is row `i`, and nothing is stored.
    table: Option<Table>,
}

#[derive(Debug, Clone)]
struct Table {
    id_of: Vec<u64>,
    /// Rows by `id / PAGE`: five bytes for an id, also where many of a page are gone, and ids in order.
    pages: BTreeMap<u64, Page>,
}

/// The rows of the ids of a page that are there, in order of id.
#[derive(Debug, Clone, Default)]
struct Page {
    /// A bit for each id.
    present: u64,
    rows: Vec<u32>,
}

const PAGE: u64 = 64;

impl Ids {
    /// The most rows that a world can have.
    pub(crate) const LEN_MAX: u64 = u32::MAX as u64;

    /// The first `next` ids, none of which is gone.
    #[cfg(feature = "snapshot")]
    pub(crate) fn first(next: u64) -> Self {
        Self { next, table: None }
    }

    /// These in the order of their rows, of which some are gone; `None` when one is there twice, or is none of the first
    /// `next`.
    #[cfg(feature = "snapshot")]
    pub(crate) fn some(next: u64, id_of: Vec<u64>) -> Option<Self> {
        let mut sorted: Vec<(u64, u32)> = id_of.iter().copied().zip(0..).collect();
        sorted.sort_unstable();
        let is_strict = sorted.is_sorted_by(|a, b| a.0 < b.0) && sorted.last().is_none_or(|(last, _)| *last < next);
        let pages = sorted.chunk_by(|a, b| a.0 / PAGE == b.0 / PAGE).map(|page| {
            let present = page.iter().fold(0, |present, (id, _)| present | Page::bit(*id));
            (page[0].0 / PAGE, Page { present, rows: page.iter().map(|(_, row)| *row).collect() })
        });
        is_strict.then(|| Self { next, table: Some(Table { pages: pages.collect(), id_of }) })
    }

    pub(crate) fn len(&self) -> usize {
        match &self.table {
            None => usize::try_from(self.next).expect("every id is a row that is held in memory"),
            Some(table) => table.id_of.len(),
        }
    }

    /// What they take, about.
    #[cfg(feature = "server")]
    pub(crate) fn bytes(&self) -> u64 {
        self.table.as_ref().map_or(0, |table| (table.id_of.len() * (size_of::<u64>() + 5)) as u64)
    }

    pub(crate) fn next(&self) -> u64 {
        self.next
    }

    pub(crate) fn row(&self, id: ParticleId) -> Option<usize> {
        match &self.table {
            None => (id.0 < self.next).then(|| usize::try_from(id.0).expect("every id is a row")),
            Some(table) => table.row(id.0),
        }
    }

    pub(crate) fn id(&self, row: usize) -> ParticleId {
        ParticleId(self.table.as_ref().map_or(row as u64, |table| table.id_of[row]))
    }

    /// The rows of up to `limit` ids from the first one on, where ids are rows; `None` once that is over.
    pub(crate) fn rows_from(&self, first: ParticleId, limit: usize) -> Option<Range<usize>> {
        let clamped = |id: u64| usize::try_from(id.min(self.next)).expect("every id is a row that is held in memory");
        let first = clamped(first.0);
        self.table.is_none().then(|| first..clamped((first as u64).saturating_add(limit as u64)))
    }

    /// Ids and rows in ascending order of id, from the first id that is at least `from`.
    pub(crate) fn from(&self, from: u64) -> impl Iterator<Item = (ParticleId, usize)> {
        let identity = if self.table.is_none() { from..self.next } else { 0..0 };
        let pages = self.table.iter().flat_map(move |table| table.pages.range(from / PAGE..));
        identity
            .map(|id| (id, u32::try_from(id).expect("rows are counted in 32 bits")))
            .chain(pages.flat_map(|(page, rows)| rows.entries(page * PAGE)).filter(move |(id, _)| *id >= from))
            .map(|(id, row)| (ParticleId(id), row as usize))
    }

    /// Names `count` new rows at the end; the first of their ids.
    pub(crate) fn create(&mut self, count: usize) -> ParticleId {
        let first = self.next;
        if let Some(table) = &mut self.table {
            for id in first..first + count as u64 {
                table.push(id);
            }
        }
        self.next += count as u64;
        ParticleId(first)
    }

    /// Forgets an id; its row, which the last row takes over.
    pub(crate) fn remove(&mut self, id: ParticleId) -> Option<usize> {
        let row = self.row(id)?;
        let len = self.len();
        let table = self.table.get_or_insert_with(|| {
            let mut table = Table { id_of: Vec::with_capacity(len), pages: BTreeMap::new() };
            (0..len as u64).for_each(|id| table.push(id));
            table
        });
        column::swap_remove(&mut table.id_of, row);
        if let Some(&moved) = table.id_of.get(row) {
            table.set_row(moved, u32::try_from(row).expect("rows are counted in 32 bits"));
        }
        table.forget(id.0);
        Some(row)
    }
}

impl Table {
    fn row(&self, id: u64) -> Option<usize> {
        let page = self.pages.get(&(id / PAGE))?;
        page.contains(id).then(|| page.rows[page.rank(id)] as usize)
    }

    fn push(&mut self, id: u64) {
        let row = u32::try_from(self.id_of.len()).expect("the world checked the number of rows");
        column::make_room(&mut self.id_of, 1);
        self.id_of.push(id);
        self.set_row(id, row);
    }

    fn set_row(&mut self, id: u64, row: u32) {
        let page = self.pages.entry(id / PAGE).or_default();
        let rank = page.rank(id);
        if page.contains(id) {
            page.rows[rank] = row;
        } else {
            page.present |= Page::bit(id);
            page.rows.insert(rank, row);
        }
    }

    fn forget(&mut self, id: u64) {
        let page = self.pages.get_mut(&(id / PAGE)).expect("the id was found");
        page.rows.remove(page.rank(id));
        page.present &= !Page::bit(id);
        if page.present == 0 {
            self.pages.remove(&(id / PAGE));
        } else if page.rows.len() + 8 <= page.rows.capacity() {
            page.rows.shrink_to_fit();
        }
    }
}

impl Page {
    fn bit(id: u64) -> u64 {
        1 << (id % PAGE)
    }

    fn contains(&self, id: u64) -> bool {
        self.present & Self::bit(id) != 0
    }

    /// How many ids of the page are there before this one.
    fn rank(&self, id: u64) -> usize {
        (self.present & (Self::bit(id) - 1)).count_ones() as usize
    }

    fn entries(&self, first: u64) -> impl Iterator<Item = (u64, u32)> {
        (first..first + PAGE).filter(|id| self.contains(*id)).zip(self.rows.iter().copied())
    }
}

#[cfg(test)]
mod tests {
    use super::{Ids, PAGE, ParticleId};
    use proptest::prelude::*;

    proptest! {
        /// Against the plainest model: a list of ids in the order of their rows.
        #[test]
        fn agrees_with_a_list(commands in prop::collection::vec((any::<bool>(), 0usize..2000), 1..60)) {
            let (mut ids, mut model, mut next) = (Ids::default(), Vec::new(), 0u64);
            for (create, n) in commands {
                if create {
                    prop_assert_eq!(ids.create(n), ParticleId(next));
                    model.extend(next..next + n as u64);
                    next += n as u64;
                } else if !model.is_empty() {
                    let row = n % model.len();
                    let id = model.swap_remove(row);
                    prop_assert_eq!(ids.remove(ParticleId(id)), Some(row));
                    prop_assert_eq!(ids.remove(ParticleId(id)), None);
                }
            }
            prop_assert_eq!(ids.len(), model.len());
            prop_assert_eq!(ids.next(), next);
            for (row, &id) in model.iter().enumerate() {
                prop_assert_eq!(ids.id(row), ParticleId(id));
                prop_assert_eq!(ids.row(ParticleId(id)), Some(row));
            }
            prop_assert_eq!(ids.row(ParticleId(next)), None);
            for from in [0, 1, PAGE, next / 2, next] {
                let mut expected: Vec<u64> = model.iter().copied().filter(|&id| id >= from).collect();
                expected.sort_unstable();
                let listed: Vec<u64> = ids.from(from).map(|(id, _)| id.0).collect();
                prop_assert_eq!(listed, expected);
            }
        }
    }

    #[test]
    fn pages_without_particles_are_given_back() {
        let mut ids = Ids::default();
        for _ in 0..100 {
            let first = ids.create(1000).0;
            (first..first + 1000).for_each(|id| assert!(ids.remove(ParticleId(id)).is_some()));
        }
        assert_eq!(ids.table.expect("something was removed").pages.len(), 0);
    }
}
