//! Columns of particles, written a piece at a time: of a million as much is in memory as of a thousand.

use std::ops::Range;
use std::sync::Arc;

use crate::ids::ParticleId;
use crate::server::content::is_few;
use crate::server::encoding::{Encoding, Writer};
use crate::server::json::WireReal;
use crate::server::wire::{Property, pair};
use crate::world::{Block, ParticleState, World};

/// Particles that are evaluated together.
const BLOCK: usize = 1024;

/// Bytes from which on a piece is sent: sockets take as much at once, and it stays in the cache.
pub(crate) const PIECE_BYTES: usize = 256 << 10;

/// The state of some particles as columns: a map with `time`, `count`, `id`, and those that were asked for.
#[derive(Debug, Clone)]
pub(crate) struct Columns<R: WireReal> {
    /// `None`: all, in ascending order.
    ids: Option<Arc<[ParticleId]>>,
    count: usize,
    properties: Vec<Property>,
    /// Said besides, where only what changed was asked for.
    changed: Option<Changed>,
    /// Which column comes next; the ids before all others. `None`: the head of the map.
    column: Option<usize>,
    /// Whether its beginning is written.
    is_begun: bool,
    /// How many of its values are written.
    done: usize,
    next: ParticleId,
    /// The particles from which on it is, and they.
    block: Option<(usize, Block<R>)>,
}

/// Positions or velocities of a world as it was, which are sent from where they are.
pub(crate) struct Lent<R: WireReal> {
    world: World<R>,
    property: Property,
    rows: Range<usize>,
}

impl<R: WireReal> AsRef<[u8]> for Lent<R> {
    fn as_ref(&self) -> &[u8] {
        let (positions, velocities) = self.world.motion_as_it_is().expect("looked at when it was lent");
        let column = if self.property == Property::Position { positions } else { velocities };
        R::as_bytes(column[self.rows.clone()].as_flattened()).expect("the same")
    }
}

/// What columns of changes say besides.
#[derive(Debug, Clone)]
struct Changed {
    /// Of the world that is told.
    revision: u64,
    /// Whether everything is told, since what changed is not known.
    is_full: bool,
    /// In ascending order.
    removed: Vec<ParticleId>,
}

impl<R: WireReal> Columns<R> {
    /// Of all particles.
    pub(crate) fn of(world: &World<R>, properties: &[Property]) -> Self {
        Self::new(None, world.particle_count(), properties, None)
    }

    /// Of these, in this order; all of them are there.
    pub(crate) fn of_ids(ids: &[u64], properties: &[Property]) -> Self {
        Self::new(Some(ids.iter().copied().map(ParticleId).collect()), ids.len(), properties, None)
    }

    /// Of those that changed since a revision, or of all where that is not known; of some of them, named in ascending
    /// order, if there are names.
    pub(crate) fn since(world: &World<R>, since: Option<u64>, ids: Option<&[u64]>, properties: &[Property]) -> Self {
        let changes = since.and_then(|since| world.changed_since(since));
        let some = |is_told: &dyn Fn(ParticleId) -> bool| {
            ids.map(|ids| ids.iter().copied().map(ParticleId).filter(|id| is_told(*id)).collect::<Arc<[_]>>())
        };
        let told = match &changes {
            None => some(&|id| world.contains(id)),
            Some(changes) if ids.is_none() && changes.are_all() => None,
            Some(changes) => some(&|id| changes.contains(id)).or_else(|| Some(changes.ids().collect())),
        };
        let is_meant = |id: &ParticleId| ids.is_none_or(|ids| ids.binary_search(&id.0).is_ok());
        let changed = Changed {
            revision: world.revision(),
            is_full: changes.is_none(),
            removed: changes.map_or_else(Vec::new, |changes| changes.removed().into_iter().filter(is_meant).collect()),
        };
        let count = told.as_ref().map_or(world.particle_count(), |ids| ids.len());
        Self::new(told, count, properties, Some(changed))
    }

    fn new(ids: Option<Arc<[ParticleId]>>, count: usize, properties: &[Property], changed: Option<Changed>) -> Self {
        let mut properties = properties.to_vec();
        properties.sort_unstable();
        properties.dedup();
        Self {
            ids,
            count,
            properties,
            changed,
            column: None,
            is_begun: false,
            done: 0,
            next: ParticleId(0),
            block: None,
        }
    }

    /// Numbers to write.
    pub(crate) fn numbers(&self) -> u64 {
        numbers(self.count as u64, &self.properties)
    }

    /// Which property comes next, if it is not written but lent: bytes that a large world holds just as they are sent.
    fn lent(&self, world: &World<R>, encoding: Encoding) -> Option<Property> {
        let property = self.properties[self.column.filter(|_| self.is_begun)?.checked_sub(1)?];
        let is_lent = matches!(property, Property::Position | Property::Velocity)
            && encoding == Encoding::Cbor
            && self.ids.is_none()
            && !is_few(self.numbers())
            && world.motion_as_it_is().is_some()
            && R::as_bytes(&[]).is_some();
        is_lent.then_some(property)
    }

    /// The next bytes of the same world as before, if they are not written.
    pub(crate) fn lend(&mut self, world: &World<R>, encoding: Encoding) -> Option<Lent<R>> {
        let property = self.lent(world, encoding)?;
        let rows = self.done..self.count.min(self.done + PIECE_BYTES / size_of::<[R; 3]>());
        self.done = rows.end;
        if self.done == self.count {
            (self.is_begun, self.done, self.column) = (false, 0, self.column.map(|column| column + 1));
        }
        Some(Lent { world: world.clone(), property, rows })
    }

    /// Writes on, from the same world as before, until there are so many bytes, or some to lend; whether there is more.
    pub(crate) fn write(&mut self, world: &World<R>, bytes: usize, writer: &mut Writer) -> bool {
        let mut column = self.column.unwrap_or_else(|| {
            self.write_head(world, writer);
            0
        });
        while column <= self.properties.len() {
            let property = column.checked_sub(1).map(|index| self.properties[index]);
            if !self.is_begun {
                begin::<R>(property, self.count, writer);
            }
            (self.is_begun, self.column) = (true, Some(column));
            if self.lent(world, writer.encoding).is_some() {
                return true;
            }
            while self.done < self.count {
                let mut block = self.block(world);
                write_values(property, &mut block, world, self.count, writer);
                self.next = block.ids().next_back().map_or(self.next, |last| ParticleId(last.0 + 1));
                let from = self.done;
                self.done += block.len();
                self.block = Some((from, block));
                if writer.bytes.len() >= bytes && self.done < self.count {
                    return true;
                }
            }
            if is_list(property, writer.encoding) {
                writer.end_list();
            }
            (self.is_begun, self.done, self.next) = (false, 0, ParticleId(0));
            column += 1;
        }
        writer.end_map();
        false
    }

    fn write_head(&self, world: &World<R>, writer: &mut Writer) {
        let more = self.changed.as_ref().map_or(0, |changed| 2 + usize::from(changed.is_full));
        writer.begin_map(3 + self.properties.len() + more);
        writer.key("time");
        writer.value(&world.time());
        if let Some(Changed { revision, is_full, removed }) = &self.changed {
            writer.key("revision");
            writer.value(revision);
            if *is_full {
                writer.key("full");
                writer.value(&true);
            }
            writer.key("removed");
            writer.value(&removed.iter().map(|id| id.0).collect::<Vec<_>>());
        }
        writer.key("count");
        writer.value(&self.count);
    }

    /// The particles whose values come next: those of the column before, where all of them are one block.
    fn block(&mut self, world: &World<R>) -> Block<R> {
        let last = match self.block.take() {
            Some((from, block)) if from == self.done => return block,
            last => last.map(|(_, block)| block),
        };
        let block = match &self.ids {
            None => Block::from(world, self.next, BLOCK),
            Some(ids) => {
                let some = &ids[self.done..ids.len().min(self.done + BLOCK)];
                Block::of(world, some).expect("they were there when the columns were made, of the same world")
            }
        };
        match last {
            Some(last) => block.after(last),
            None => block,
        }
    }
}

/// Numbers in so many rows of some columns.
pub(crate) fn numbers(count: u64, properties: &[Property]) -> u64 {
    count.saturating_mul(1 + 3 * properties.len() as u64)
}

/// Whether a column is a list of values, and not the bytes of all of them.
fn is_list(property: Option<Property>, encoding: Encoding) -> bool {
    let has_null = matches!(
        property,
        Some(Property::OwnAcceleration | Property::Mass | Property::Drag | Property::GravitationalMass)
    );
    encoding == Encoding::Json || has_null
}

fn begin<R: WireReal>(property: Option<Property>, count: usize, writer: &mut Writer) {
    writer.key(property.map_or("id", crate::server::json::Choice::name));
    if is_list(property, writer.encoding) {
        return writer.begin_list(count);
    }
    match property {
        None => writer.begin_typed(UINT64_LE, size_of::<u64>() * count),
        Some(Property::Damping | Property::InverseMass) => writer.begin_typed(R::TYPED_ARRAY, size_of::<R>() * count),
        Some(_) => writer.begin_typed(R::TYPED_ARRAY, size_of::<[R; 3]>() * count),
    }
}

/// The tag of an array of unsigned integers of 64 bits, little-endian (RFC 8746).
const UINT64_LE: u64 = 71;

fn write_values<R: WireReal>(
    property: Option<Property>,
    block: &mut Block<R>,
    world: &World<R>,
    count: usize,
    writer: &mut Writer,
) {
    let each = |value: fn(ParticleState<R>) -> R| block.properties(world).map(value);
    match property {
        None if writer.encoding == Encoding::Json => writer.members(block.ids().map(|id| id.0)),
        None => {
            let old = writer.bytes.len();
            writer.bytes.resize(old + size_of::<u64>() * block.len(), 0);
            let (places, _) = writer.bytes[old..].as_chunks_mut();
            places.iter_mut().zip(block.ids()).for_each(|(place, id)| *place = id.0.to_le_bytes());
        }
        Some(Property::Position) => write_vectors(block.motion(world, count).0, writer),
        Some(Property::Velocity) => write_vectors(block.motion(world, count).1, writer),
        Some(Property::Acceleration) => {
            let vectors: Vec<[R; 3]> = block.properties(world).map(|state| state.acceleration.into()).collect();
            write_vectors(&vectors, writer);
        }
        Some(Property::Force) => {
            let vectors: Vec<[R; 3]> = block.properties(world).map(|state| state.force.into()).collect();
            write_vectors(&vectors, writer);
        }
        Some(Property::Damping) => write_numbers(each(|state| state.damping), writer),
        Some(Property::InverseMass) => write_numbers(each(|state| state.inverse_mass), writer),
        Some(Property::OwnAcceleration) => {
            let own = |state: ParticleState<R>| state.own_acceleration.map(Into::<[R; 3]>::into);
            writer.members(block.properties(world).map(own));
        }
        Some(Property::Mass) => writer.members(block.properties(world).map(|state| state.mass())),
        Some(Property::Drag) => writer.members(block.properties(world).map(|state| state.drag.map(pair))),
        Some(Property::GravitationalMass) => {
            writer.members(block.properties(world).map(|state| state.gravitational_mass));
        }
    }
}

fn write_vectors<R: WireReal>(vectors: &[[R; 3]], writer: &mut Writer) {
    match writer.encoding {
        Encoding::Json => writer.members(vectors.iter()),
        Encoding::Cbor => R::to_bytes(vectors.as_flattened(), &mut writer.bytes),
    }
}

fn write_numbers<R: WireReal>(numbers: impl ExactSizeIterator<Item = R>, writer: &mut Writer) {
    match writer.encoding {
        Encoding::Json => writer.members(numbers),
        Encoding::Cbor => R::to_bytes(&numbers.collect::<Vec<R>>(), &mut writer.bytes),
    }
}
