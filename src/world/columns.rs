//! Particles as they are now, a block at a time, for who writes them somewhere.

use std::ops::Range;

use crate::closed_form::Motion;
use crate::ids::ParticleId;
use crate::particles::zero;
use crate::real::Real;
use crate::world::motion::{Carrier, Rows, Span};
use crate::world::{ParticleState, States, World};

/// Base times up to which their coefficients are kept for the blocks to come: half a megabyte.
const FORMS_MAX: usize = 16_384;

/// Some particles of a world, and room for where they are.
#[derive(Debug, Clone)]
pub(crate) struct Block<R: Real> {
    listed: Listed,
    /// What carries this block and the next ones.
    carrier: Option<Carrier<R>>,
    room: States<R>,
    /// Whether the room has where these particles are.
    is_carried: bool,
}

#[derive(Debug, Clone)]
enum Listed {
    /// Where ids are rows.
    Range(Range<usize>),
    List(Vec<ParticleId>, Vec<usize>),
}

impl<R: Real> World<R> {
    /// Positions and velocities in ascending order of id, where the columns have them so.
    pub(crate) fn motion_as_it_is(&self) -> Option<Motion<'_, R>> {
        let particles = &self.particles;
        let is_now = particles.base_time.indices().is_none() && particles.base_time.get(0) == self.clock;
        let is_in_order = self.ids.rows_from(ParticleId(0), 0).is_some();
        (is_now && is_in_order).then_some((&particles.position, &particles.velocity))
    }
}

impl<R: Real> Block<R> {
    /// Up to `limit` particles in ascending order of id, from the first id that is at least `first`.
    pub(crate) fn from(world: &World<R>, first: ParticleId, limit: usize) -> Self {
        let listed = world.ids.rows_from(first, limit).map_or_else(
            || {
                let (ids, rows) = world.ids.from(first.0).take(limit).unzip();
                Listed::List(ids, rows)
            },
            Listed::Range,
        );
        Self::new(listed)
    }

    /// These particles; `None` when one of them is not there.
    pub(crate) fn of(world: &World<R>, ids: &[ParticleId]) -> Option<Self> {
        let rows = ids.iter().map(|id| world.ids.row(*id)).collect::<Option<_>>()?;
        Some(Self::new(Listed::List(ids.to_vec(), rows)))
    }

    fn new(listed: Listed) -> Self {
        Self { listed, carrier: None, room: States::default(), is_carried: false }
    }

    /// With what another one of the same world was carried by and the room for it.
    pub(crate) fn after(self, other: Self) -> Self {
        Self { carrier: other.carrier, room: other.room, ..self }
    }

    pub(crate) fn len(&self) -> usize {
        self.rows().len()
    }

    pub(crate) fn ids(&self) -> impl ExactSizeIterator<Item = ParticleId> + DoubleEndedIterator {
        (0..self.len()).map(|index| match &self.listed {
            Listed::Range(range) => ParticleId((range.start + index) as u64),
            Listed::List(ids, _) => ids[index],
        })
    }

    /// Positions and velocities at the clock of the world: those of its columns, where they hold now. `count` particles are
    /// read in all.
    pub(crate) fn motion<'a>(&'a mut self, world: &'a World<R>, count: usize) -> Motion<'a, R> {
        if let (Listed::Range(range), Some((positions, velocities))) = (&self.listed, world.motion_as_it_is()) {
            return (&positions[range.clone()], &velocities[range.clone()]);
        }
        if !self.is_carried {
            let new = || Carrier::new(world, Span::To(world.clock), false, count.min(FORMS_MAX));
            let mut carrier = self.carrier.take().unwrap_or_else(new);
            let mut room = std::mem::take(&mut self.room);
            carrier.read(world, &self.rows(), &mut room.position, &mut room.velocity);
            (self.carrier, self.room, self.is_carried) = (Some(carrier), room, true);
        }
        (&self.room.position, &self.room.velocity)
    }

    /// Everything but where they are and how fast.
    pub(crate) fn properties<'a>(&'a self, world: &'a World<R>) -> impl ExactSizeIterator<Item = ParticleState<R>> {
        (0..self.len()).map(|index| {
            let row = self.rows().row(index);
            world.state(world.ids.id(row), row, zero(), zero())
        })
    }

    fn rows(&self) -> Rows<'_> {
        match &self.listed {
            Listed::Range(range) => Rows::Range(range.clone()),
            Listed::List(_, rows) => Rows::List(rows),
        }
    }
}
