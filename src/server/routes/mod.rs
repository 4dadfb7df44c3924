//! One resource, one file: its routes first, then its shapes, then its handlers.

pub(crate) mod advance;
pub(crate) mod forces;
pub(crate) mod particles;
pub(crate) mod service;
pub(crate) mod worlds;
