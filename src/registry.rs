//! Names to worlds. It knows nothing of what it holds, nor of how that is locked.

use std::collections::BTreeMap;
use std::ops::Bound;
use std::sync::{PoisonError, RwLock};

/// Names in order, each with a handle to one world.
///
/// A plain lock: it is held for one look-up or one insertion, never while a world is locked.
#[derive(Debug)]
pub(crate) struct Registry<T> {
    worlds: RwLock<BTreeMap<String, T>>,
    limit: usize,
}

/// Why a name was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Refused {
    /// There is a world of that name.
    Exists,
    /// There are as many worlds as allowed.
    Full,
}

impl<T: Clone> Registry<T> {
    pub(crate) fn new(limit: usize) -> Self {
        Self { worlds: RwLock::default(), limit }
    }

    pub(crate) fn get(&self, name: &str) -> Option<T> {
        self.worlds.read().unwrap_or_else(PoisonError::into_inner).get(name).cloned()
    }

    pub(crate) fn insert(&self, name: &str, world: T) -> Result<(), Refused> {
        let mut worlds = self.worlds.write().unwrap_or_else(PoisonError::into_inner);
        if worlds.contains_key(name) {
            return Err(Refused::Exists);
        }
        if worlds.len() >= self.limit {
            return Err(Refused::Full);
        }
        worlds.insert(name.to_owned(), world);
        Ok(())
    }

    pub(crate) fn remove(&self, name: &str) {
        self.worlds.write().unwrap_or_else(PoisonError::into_inner).remove(name);
    }

    /// At most `limit` of them in order of name, from the first after `after`.
    pub(crate) fn list(&self, after: Option<&str>, limit: usize) -> Vec<(String, T)> {
        let from = after.map_or(Bound::Unbounded, Bound::Excluded);
        let worlds = self.worlds.read().unwrap_or_else(PoisonError::into_inner);
        worlds.range::<str, _>((from, Bound::Unbounded)).take(limit).map(|(k, v)| (k.clone(), v.clone())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::{Refused, Registry};

    #[test]
    fn lists_in_order_and_refuses_what_it_must() {
        let registry = Registry::new(3);
        for name in ["b", "a", "c"] {
            assert_eq!(registry.insert(name, ()), Ok(()));
        }
        assert_eq!(registry.insert("b", ()), Err(Refused::Exists));
        assert_eq!(registry.insert("d", ()), Err(Refused::Full));
        let names = |after, limit| registry.list(after, limit).into_iter().map(|(name, ())| name).collect::<Vec<_>>();
        assert_eq!(names(None, 9), ["a", "b", "c"]);
        assert_eq!(names(Some("a"), 1), ["b"]);
        registry.remove("b");
        assert_eq!((registry.get("b"), names(None, 9)), (None, vec!["a".to_owned(), "c".to_owned()]));
    }
}
