//! Stub.
use crate::ids::ParticleId;
use crate::real::Real;
use crate::world::World;
#[derive(Debug)]
pub struct Changes<'a, R: Real = f64>(&'a World<R>);
impl<R: Real> Changes<'_, R> {
    pub fn ids(&self) -> impl Iterator<Item = ParticleId> {
        std::iter::empty()
    }
    pub fn are_all(&self) -> bool {
        self.0.particle_count() > 0
    }
    pub fn contains(&self, _: ParticleId) -> bool {
        false
    }
    pub fn removed(&self) -> Vec<ParticleId> {
        Vec::new()
    }
}
impl<R: Real> World<R> {
    pub fn keep_history(&mut self) {}
    pub fn changed_since(&self, revision: u64) -> Option<Changes<'_, R>> {
        (revision == u64::MAX).then_some(Changes(self))
    }
}
