//! What a world and its copies hold together until one of them writes it.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// A value whose copies cost nothing until one of them is written: then that one is copied.
#[derive(Debug, Clone, Default)]
pub(crate) struct Shared<T>(Arc<T>);

impl<T> Shared<T> {
    pub(crate) fn new(value: T) -> Self {
        Self(Arc::new(value))
    }
}

impl<T> Deref for Shared<T> {
    type Target = T;
    fn deref(&self) -> &T {
        &self.0
    }
}

impl<T: Clone> DerefMut for Shared<T> {
    /// Not for free, also where there is no copy: in a loop it is taken once.
    fn deref_mut(&mut self) -> &mut T {
        Arc::make_mut(&mut self.0)
    }
}
