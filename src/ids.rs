//! Which row of the columns each particle lives in.

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

#[derive(Debug, Clone, Default)]
struct Table {
    id_of: Vec<u64>,
    /// Up to `PAGE` ids each, in order.
    pages: Vec<Page>,
    /// The rows of all pages, one after the other.
    rows: Vec<u32>,
    /// How many of those are `GONE`.
    gone: usize,
}

/// The ids from `number * PAGE` on.
#[derive(Debug, Clone, Copy)]
struct Page {
    number: u64,
    /// A bit for each that has a place among the rows.
    placed: u128,
    /// Where its rows begin.
    first: usize,
}

const PAGE: u64 = 128;

/// In the place of the row of an id that is gone.
const GONE: u32 = u32::MAX;

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
        let mut table = Table { id_of, ..Table::default() };
        for (id, row) in sorted {
            table.place(id, row);
        }
        is_strict.then_some(Self { next, table: Some(table) })
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
        self.table.as_ref().map_or(0, |table| {
            let lists = (size_of_val(&*table.id_of), size_of_val(&*table.rows), size_of_val(&*table.pages));
            (lists.0 + lists.1 + lists.2) as u64
        })
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
        let entries = self.table.iter().flat_map(move |table| {
            let first = table.pages.partition_point(|page| page.number < from / PAGE);
            table.pages[first..].iter().flat_map(|page| page.entries(&table.rows))
        });
        identity
            .map(|id| (id, u32::try_from(id).expect("rows are counted in 32 bits")))
            .chain(entries.filter(move |(id, _)| *id >= from))
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
            let mut table = Table { id_of: Vec::with_capacity(len), rows: Vec::with_capacity(len), ..Table::default() };
            (0..len as u64).for_each(|id| table.push(id));
            table
        });
        column::swap_remove(&mut table.id_of, row);
        if let Some(&moved) = table.id_of.get(row) {
            let place = table.place_of(moved).expect("a row has an id that is there");
            table.rows[place] = u32::try_from(row).expect("rows are counted in 32 bits");
        }
        table.forget(id.0);
        Some(row)
    }
}

impl Table {
    fn row(&self, id: u64) -> Option<usize> {
        self.place_of(id).map(|place| self.rows[place] as usize)
    }

    /// Where its row stands.
    fn place_of(&self, id: u64) -> Option<usize> {
        let page = &self.pages[self.page(id / PAGE)?];
        let place = page.first + (page.placed & (bit(id) - 1)).count_ones() as usize;
        (page.placed & bit(id) != 0 && self.rows[place] != GONE).then_some(place)
    }

    /// Which of the pages has a number. While none before it is gone, it is as far from the first as the numbers are.
    fn page(&self, number: u64) -> Option<usize> {
        let ahead = usize::try_from(number.checked_sub(self.pages.first()?.number)?).unwrap_or(usize::MAX);
        let last = ahead.min(self.pages.len() - 1);
        if self.pages[last].number == number {
            return Some(last);
        }
        self.pages[..last].binary_search_by_key(&number, |page| page.number).ok()
    }

    fn push(&mut self, id: u64) {
        let row = u32::try_from(self.id_of.len()).expect("the world checked the number of rows");
        column::make_room(&mut self.id_of, 1);
        self.id_of.push(id);
        self.place(id, row);
    }

    /// Gives an id that is greater than all others a row.
    fn place(&mut self, id: u64, row: u32) {
        let number = id / PAGE;
        if self.pages.last().is_none_or(|last| last.number != number) {
            column::make_room(&mut self.pages, 1);
            self.pages.push(Page { number, placed: 0, first: self.rows.len() });
        }
        let page = self.pages.last_mut().expect("pushed if there was none");
        page.placed |= bit(id);
        column::make_room(&mut self.rows, 1);
        self.rows.push(row);
    }

    fn forget(&mut self, id: u64) {
        let place = self.place_of(id).expect("the id was found");
        self.rows[place] = GONE;
        self.gone += 1;
        if self.gone > self.id_of.len() / 16 + 64 {
            self.close_gaps();
        }
    }

    /// Takes out what is gone.
    fn close_gaps(&mut self) {
        let mut len = 0;
        for page in &mut self.pages {
            let (mut placed, first) = (0, len);
            for (id, place) in page.places() {
                if self.rows[place] != GONE {
                    placed |= bit(id);
                    self.rows[len] = self.rows[place];
                    len += 1;
                }
            }
            (page.placed, page.first) = (placed, first);
        }
        self.rows.truncate(len);
        self.pages.retain(|page| page.placed != 0);
        self.gone = 0;
        column::give_back(&mut self.rows);
        column::give_back(&mut self.pages);
    }
}

impl Page {
    /// Its ids, and where their rows stand.
    fn places(&self) -> impl Iterator<Item = (u64, usize)> + use<> {
        let (placed, first) = (self.placed, self.number * PAGE);
        (first..first + PAGE).filter(move |id| placed & bit(*id) != 0).zip(self.first..)
    }

    fn entries(&self, rows: &[u32]) -> impl Iterator<Item = (u64, u32)> {
        self.places().map(|(id, place)| (id, rows[place])).filter(|(_, row)| *row != GONE)
    }
}

fn bit(id: u64) -> u128 {
    1 << (id % PAGE)
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
        let table = ids.table.expect("something was removed");
        assert!(table.pages.len() + table.rows.len() <= 130, "{table:?}");
    }
}
