//! The clock at which position and velocity of each particle hold.

use crate::column::{self, Column};
use crate::double_double::DoubleDouble;

/// One base time for each particle. Many particles share one: those that were created, changed or forced between the
/// same two advances. So each names its base time by four bytes, and what follows from a base time is computed once.
#[derive(Debug, Clone)]
pub(crate) struct BaseTimes {
    /// Never empty.
    distinct: Vec<Distinct>,
    /// Which of them belongs to each particle.
    of: Column<u32>,
    /// Those that belong to no particle any more.
    free: Vec<u32>,
    /// The one that was last given to a particle.
    last: u32,
}

#[derive(Debug, Clone, Copy)]
struct Distinct {
    time: DoubleDouble,
    /// How many particles have it. Not kept while there is only one.
    count: usize,
}

impl Default for BaseTimes {
    fn default() -> Self {
        Self::all_at(DoubleDouble::default())
    }
}

impl BaseTimes {
    pub(crate) fn all_at(time: DoubleDouble) -> Self {
        Self { distinct: vec![Distinct { time, count: 0 }], of: Column::Uniform(0), free: Vec::new(), last: 0 }
    }

    /// These times, each of which belongs to a particle; `None` when that is not so, or they are not in the order in which
    /// the particles name them first.
    #[cfg(feature = "snapshot")]
    pub(crate) fn restored(times: &[DoubleDouble], of: Vec<u32>) -> Option<Self> {
        let mut distinct: Vec<Distinct> = times.iter().map(|time| Distinct { time: *time, count: 0 }).collect();
        let mut named = 0;
        for index in of.iter().map(|index| *index as usize) {
            if index > named || index >= distinct.len() {
                return None;
            }
            named += usize::from(index == named);
            distinct[index].count += 1;
        }
        let newest = (0..).zip(times).reduce(|a, b| if (*b.1 - *a.1).hi > 0.0 { b } else { a });
        let (last, _) = newest?;
        (named == times.len()).then_some(Self { distinct, of: Column::PerParticle(of), free: Vec::new(), last })
    }

    /// The times of `len` particles, in the order in which these name them first; and which of those each of
    /// [`Self::distinct`] is.
    #[cfg(feature = "snapshot")]
    pub(crate) fn in_order(&self, len: usize) -> (Vec<DoubleDouble>, Vec<u32>) {
        let mut places = vec![u32::MAX; self.distinct.len()];
        let mut times = Vec::new();
        let rows = if matches!(self.of, Column::Uniform(_)) { len.min(1) } else { len };
        for index in (0..rows).map(|row| self.index(row)) {
            if places[index] == u32::MAX {
                places[index] = u32::try_from(times.len()).expect("as many as particles, which are counted in 32 bits");
                times.push(self.distinct[index].time);
            }
        }
        (times, places)
    }

    pub(crate) fn get(&self, row: usize) -> DoubleDouble {
        self.distinct[self.index(row)].time
    }

    /// Which of [`Self::distinct`] each has; `None` when all have the first.
    pub(crate) fn indices(&self) -> Option<&[u32]> {
        match &self.of {
            Column::Uniform(_) => None,
            Column::PerParticle(of) => Some(of),
        }
    }

    /// Which of them one has.
    pub(crate) fn index(&self, row: usize) -> usize {
        self.of.get(row) as usize
    }

    /// Which base times there are, in the order of [`Self::index`]; some that no particle has any more among them.
    pub(crate) fn distinct(&self) -> impl ExactSizeIterator<Item = DoubleDouble> {
        self.distinct.iter().map(|distinct| distinct.time)
    }

    /// The first of those that particles have.
    pub(crate) fn oldest(&self) -> DoubleDouble {
        let is_uniform = matches!(self.of, Column::Uniform(_));
        let live =
            self.distinct.iter().filter(|distinct| is_uniform || distinct.count > 0).map(|distinct| distinct.time);
        live.reduce(|a, b| if (b - a).hi < 0.0 { b } else { a }).unwrap_or_default()
    }

    /// What they take.
    #[cfg(feature = "server")]
    pub(crate) fn bytes(&self) -> u64 {
        self.of.bytes() + (self.distinct.len() * size_of::<Distinct>()) as u64
    }

    pub(crate) fn set_all(&mut self, time: DoubleDouble) {
        if matches!(self.of, Column::Uniform(_)) {
            self.distinct[0].time = time;
        } else {
            *self = Self::all_at(time);
        }
    }

    /// Sets one of `len` base times.
    pub(crate) fn set(&mut self, row: usize, time: DoubleDouble, len: usize) {
        if matches!(self.of, Column::Uniform(_)) {
            if self.distinct[0].time == time {
                return;
            }
            self.promote(len);
        }
        let (old, new) = (self.of.get(row), self.find_or_add(time));
        self.distinct[new as usize].count += 1;
        self.of.set(row, new, len);
        self.leave(old);
        if self.distinct[new as usize].count == len {
            self.set_all(time);
        }
    }

    /// Appends `count` particles of one base time to `len` others.
    pub(crate) fn extend(&mut self, len: usize, time: DoubleDouble, count: usize) {
        if len == 0 {
            return self.set_all(time);
        }
        if matches!(self.of, Column::Uniform(_)) {
            if self.distinct[0].time == time || count == 0 {
                return;
            }
            self.promote(len);
        }
        let new = self.find_or_add(time);
        self.distinct[new as usize].count += count;
        self.of.extend(len, &Column::Uniform(new), count);
    }

    pub(crate) fn swap_remove(&mut self, row: usize) {
        if let Column::PerParticle(of) = &mut self.of {
            let old = column::swap_remove(of, row);
            let len = of.len();
            self.leave(old);
            if self.distinct.len() > 2 * len + 64 {
                self.forget_unused();
            }
        }
    }

    /// Gives back what was left by particles that are gone.
    fn forget_unused(&mut self) {
        let Column::PerParticle(of) = &mut self.of else { return };
        let mut places = vec![None; self.distinct.len()];
        let mut distinct = Vec::new();
        for index in of.iter_mut().chain([&mut self.last]) {
            let place = *places[*index as usize].get_or_insert_with(|| {
                distinct.push(self.distinct[*index as usize]);
                u32::try_from(distinct.len() - 1).expect("fewer than before")
            });
            *index = place;
        }
        self.distinct = distinct;
        self.free = Vec::new();
    }

    fn promote(&mut self, len: usize) {
        self.distinct[0].count = len;
        self.of = Column::PerParticle(vec![0; len]);
    }

    fn find_or_add(&mut self, time: DoubleDouble) -> u32 {
        if self.distinct[self.last as usize].time != time {
            let distinct = Distinct { time, count: 0 };
            let last = &mut self.distinct[self.last as usize];
            self.last = if last.count == 0 {
                *last = distinct;
                self.last
            } else if let Some(free) = self.free.pop() {
                self.distinct[free as usize] = distinct;
                free
            } else {
                self.distinct.push(distinct);
                u32::try_from(self.distinct.len() - 1).expect("as many as particles, which are counted in 32 bits")
            };
        }
        self.last
    }

    fn leave(&mut self, index: u32) {
        let distinct = &mut self.distinct[index as usize];
        distinct.count -= 1;
        if distinct.count == 0 && index != self.last {
            self.free.push(index);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{BaseTimes, DoubleDouble};

    proptest! {
        /// Against the plainest model: a list of times.
        #[test]
        fn agrees_with_a_list(commands in prop::collection::vec((0u8..5, any::<usize>(), 1usize..40), 1..200)) {
            let (mut times, mut model, mut clock) = (BaseTimes::default(), Vec::<f64>::new(), 0.0);
            for (what, at, count) in commands {
                let now = DoubleDouble::from(clock);
                match what {
                    0 => {
                        times.extend(model.len(), now, count);
                        model.extend(std::iter::repeat_n(clock, count));
                    }
                    1 => clock += 1.0,
                    2 if !model.is_empty() => {
                        let row = at % model.len();
                        times.set(row, now, model.len());
                        model[row] = clock;
                    }
                    3 => (0..count).for_each(|k| {
                        if !model.is_empty() {
                            let row = (at >> 1).wrapping_add(k) % model.len();
                            times.swap_remove(row);
                            model.swap_remove(row);
                        }
                    }),
                    _ => {
                        // Each at a time of its own.
                        for row in 0..model.len() {
                            clock += 1.0;
                            times.set(row, DoubleDouble::from(clock), model.len());
                            model[row] = clock;
                        }
                    }
                }
                for (row, time) in model.iter().enumerate() {
                    prop_assert_eq!(times.get(row).hi, *time);
                }
                if let Some(oldest) = model.iter().copied().reduce(f64::min) {
                    prop_assert_eq!(times.oldest().hi, oldest);
                }
                prop_assert!(times.distinct().len() <= 2 * model.len() + 66, "{}", times.distinct().len());
            }
        }
    }
}
