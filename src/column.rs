//! One property of many particles, held once when they all share it.

/// A property of many particles.
///
/// ```
/// use pointmass::Column;
/// let damping = Column::Uniform(0.99);
/// assert_eq!(damping.get(7), 0.99);
/// let masses = Column::PerParticle(vec![1.0, 2.0]);
/// assert_eq!(masses.get(1), 2.0);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum Column<T> {
    /// Every particle has this value.
    Uniform(T),
    /// `values[i]` belongs to particle `i`.
    PerParticle(Vec<T>),
}

impl<T: Copy + PartialEq> Column<T> {
    /// The value of particle `index`.
    ///
    /// # Panics
    /// When the column is per-particle and shorter than `index + 1`.
    #[must_use]
    pub fn get(&self, index: usize) -> T {
        match self {
            Self::Uniform(value) => *value,
            Self::PerParticle(values) => values[index],
        }
    }

    /// The number of particles it speaks of, when it has one value for each.
    #[must_use]
    pub fn len_if_per_particle(&self) -> Option<usize> {
        match self {
            Self::Uniform(_) => None,
            Self::PerParticle(values) => Some(values.len()),
        }
    }

    /// What its values take.
    #[cfg(feature = "server")]
    pub(crate) fn bytes(&self) -> u64 {
        (self.len_if_per_particle().unwrap_or(0) * size_of::<T>()) as u64
    }

    /// The same column, uniform when all of its values are equal.
    pub(crate) fn collapsed(self) -> Self {
        match &self {
            Self::PerParticle(values) => match values.split_first() {
                Some((first, rest)) if rest.iter().all(|value| value == first) => Self::Uniform(*first),
                Some(_) | None => self,
            },
            Self::Uniform(_) => self,
        }
    }

    /// The values it stores, each with the index of its particle, or with none when it stands for all.
    pub(crate) fn entries(&self) -> impl Iterator<Item = (Option<usize>, T)> {
        let (uniform, values) = match self {
            Self::Uniform(value) => (Some((None, *value)), [].as_slice()),
            Self::PerParticle(values) => (None, values.as_slice()),
        };
        uniform.into_iter().chain(values.iter().enumerate().map(|(i, value)| (Some(i), *value)))
    }

    /// The same shape with other values.
    pub(crate) fn map<U>(&self, f: impl Fn(T) -> U) -> Column<U> {
        match self {
            Self::Uniform(value) => Column::Uniform(f(*value)),
            Self::PerParticle(values) => Column::PerParticle(values.iter().map(|value| f(*value)).collect()),
        }
    }

    /// Sets one of `len` values; promotes a uniform column when the value differs.
    pub(crate) fn set(&mut self, index: usize, value: T, len: usize) {
        match self {
            Self::Uniform(uniform) if *uniform == value => {}
            Self::Uniform(uniform) => {
                let mut values = vec![*uniform; len];
                values[index] = value;
                *self = Self::PerParticle(values);
            }
            Self::PerParticle(values) => values[index] = value,
        }
    }

    /// Appends one to `len` values; stays uniform while all are the same.
    pub(crate) fn push(&mut self, len: usize, value: T, is_same: impl Fn(&T, &T) -> bool) {
        match self {
            Self::Uniform(uniform) if len == 0 => *uniform = value,
            Self::Uniform(uniform) if is_same(uniform, &value) => {}
            Self::Uniform(uniform) => {
                let mut values = vec![*uniform; len];
                values.push(value);
                *self = Self::PerParticle(values);
            }
            Self::PerParticle(values) => values.push(value),
        }
    }

    /// Appends the first `count` values of `other` to a column of `len` values.
    pub(crate) fn extend(&mut self, len: usize, other: &Self, count: usize) {
        if count == 0 {
            return;
        }
        if let (Self::Uniform(value), Self::Uniform(new)) = (&mut *self, other)
            && (len == 0 || value == new)
        {
            *value = *new;
            return;
        }
        if let Self::Uniform(value) = self {
            *self = Self::PerParticle(vec![*value; len]);
        }
        let Self::PerParticle(values) = self else { unreachable!("promoted above") };
        match other {
            Self::Uniform(new) => {
                make_room(values, count);
                values.resize(len + count, *new);
            }
            Self::PerParticle(new) => {
                make_room(values, count);
                values.extend_from_slice(&new[..count]);
            }
        }
    }

    /// Removes one value; the last one takes its place.
    pub(crate) fn swap_remove(&mut self, index: usize) {
        if let Self::PerParticle(values) = self {
            swap_remove(values, index);
        }
    }
}

/// Room for `more` values, growing by a sixteenth and not by doubling: a world is as large as its particles, and moving
/// a value sixteen times costs less than what creates it.
pub(crate) fn make_room<T>(values: &mut Vec<T>, more: usize) {
    if values.capacity() - values.len() < more {
        values.reserve_exact(more.max(values.len() / 16).max(4));
    }
}

/// Removes one value, whose place the last one takes; gives back room that is not used.
pub(crate) fn swap_remove<T>(values: &mut Vec<T>, index: usize) -> T {
    let removed = values.swap_remove(index);
    give_back(values);
    removed
}

/// Gives room back when more than a sixteenth of it is not used.
pub(crate) fn give_back<T>(values: &mut Vec<T>) {
    let len = values.len();
    if len + len / 16 + 64 < values.capacity() {
        values.shrink_to(len + len / 32);
    }
}

#[cfg(test)]
mod tests {
    use super::Column;

    #[test]
    fn stays_uniform_while_the_values_are_equal() {
        let mut column = Column::Uniform(1.0);
        column.extend(0, &Column::Uniform(2.0), 3);
        column.set(1, 2.0, 3);
        column.extend(3, &Column::Uniform(2.0), 2);
        assert_eq!(column, Column::Uniform(2.0));
    }

    #[test]
    fn is_promoted_by_a_value_that_differs() {
        let mut column = Column::Uniform(2.0);
        column.set(1, 5.0, 3);
        assert_eq!(column, Column::PerParticle(vec![2.0, 5.0, 2.0]));
        column.extend(3, &Column::Uniform(7.0), 1);
        column.swap_remove(0);
        assert_eq!(column, Column::PerParticle(vec![7.0, 5.0, 2.0]));
        let mut column = Column::Uniform(1.0);
        for (len, value) in [0.0, -0.0, 0.0].into_iter().enumerate() {
            column.push(len, value, PartialEq::eq);
        }
        assert_eq!(column, Column::Uniform(0.0));
        column.push(3, 2.0, PartialEq::eq);
        column.push(4, 0.0, PartialEq::eq);
        assert_eq!(column, Column::PerParticle(vec![0.0, 0.0, 0.0, 2.0, 0.0]));
        let mut column = Column::Uniform(2.0);
        column.extend(1, &Column::PerParticle(vec![3.0, 4.0]), 2);
        assert_eq!(Column::PerParticle(vec![3.0, 4.0]).collapsed(), Column::PerParticle(vec![3.0, 4.0]));
        assert_eq!(Column::PerParticle(vec![3.0, 3.0]).collapsed(), Column::Uniform(3.0));
        assert_eq!(column, Column::PerParticle(vec![2.0, 3.0, 4.0]));
    }
}
