//! All particles, one after the other.

use crate::ids::ParticleId;
use crate::real::Real;
use crate::world::motion::{BLOCK, Carrier, Rows, Span};
use crate::world::{ParticleState, States, World};

/// Particles that a walk begins with: a short one is not made to pay for a whole block.
const SHORT: usize = 8;

/// A walk over the particles of a world in ascending order of id, a block at a time.
#[derive(Debug)]
pub struct Walk<'a, R: Real> {
    world: &'a World<R>,
    /// The first id to look for.
    next: u64,
    /// That of the first block, then that of all others.
    carrier: Carrier<R>,
    motion: States<R>,
    /// The states of a block, and how many of them were given.
    block: Vec<ParticleState<R>>,
    given: usize,
    blocks: usize,
}

impl<'a, R: Real> Walk<'a, R> {
    pub(super) fn begin(world: &'a World<R>, first: ParticleId) -> Self {
        Self {
            world,
            next: first.0,
            carrier: Carrier::new(world, Span::To(world.clock), false, SHORT),
            motion: States::default(),
            block: Vec::new(),
            given: 0,
            blocks: 0,
        }
    }

    /// Finds the next block, which is empty at the end.
    pub(super) fn go_on(&mut self) {
        let Self { world, motion, .. } = self;
        if self.blocks == 1 {
            self.carrier = Carrier::new(world, Span::To(world.clock), false, BLOCK);
        }
        let limit = if self.blocks == 0 { SHORT } else { BLOCK };
        let (ids, rows): (Vec<ParticleId>, Vec<usize>) = world.ids.from(self.next).take(limit).unzip();
        self.carrier.read(world, &Rows::List(&rows), &mut motion.position, &mut motion.velocity);
        self.block.clear();
        let state = |(k, (id, row))| world.state(id, row, motion.position[k], motion.velocity[k]);
        self.block.extend(ids.iter().copied().zip(rows).enumerate().map(state));
        self.next = ids.last().map_or(u64::MAX, |id| id.0 + 1);
        (self.given, self.blocks) = (0, self.blocks + 1);
    }
}

impl<R: Real> Iterator for Walk<'_, R> {
    type Item = ParticleState<R>;

    fn next(&mut self) -> Option<ParticleState<R>> {
        if self.given == self.block.len() {
            R::world_go_on(self);
        }
        let state = *self.block.get(self.given)?;
        self.given += 1;
        Some(state)
    }
}
