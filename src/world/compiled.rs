//! The engine, compiled once for each precision, and in this crate.
//!
//! A generic function is compiled by the crate that calls it: a program of seven lines took a minute to build after each
//! edit, since it compiled every kernel for every instruction set. So the public methods of [`World`] whose work is long to
//! compile hand it to these functions, which belong to a type and have no parameter.

#[cfg(feature = "snapshot")]
use std::io::{self, Read, Write};
use std::sync::atomic::AtomicBool;

use crate::command::{Command, Outcome, Settings};
use crate::error::{BatchError, Error, Limits};
use crate::ids::ParticleId;
use crate::real::Real;
#[cfg(feature = "digest")]
use crate::world::Digest;
use crate::world::batch::{Before, Keep};
use crate::world::walk::Walk;
use crate::world::{Changes, ParticleState, States, Trajectory, World};
#[cfg(feature = "snapshot")]
use crate::world::{Snapshot, SnapshotError};

/// Declares each function, and implements it for both precisions by what stands behind the equal sign.
macro_rules! compiled {
    ($($(#[$attribute:meta])* $name:ident$(<$life:lifetime>)?($($argument:ident: $kind:ty),*) -> $result:ty = $of:expr;)*) => {
        pub trait Compiled: Sized {
            $($(#[$attribute])* fn $name$(<$life>)?($($argument: $kind),*) -> $result where Self: Real;)*
        }
        compiled!(f32: $($(#[$attribute])* $name$(<$life>)?($($argument: $kind),*) -> $result = $of;)*);
        compiled!(f64: $($(#[$attribute])* $name$(<$life>)?($($argument: $kind),*) -> $result = $of;)*);
    };
    ($real:ty: $($(#[$attribute:meta])* $name:ident$(<$life:lifetime>)?($($argument:ident: $kind:ty),*) -> $result:ty = $of:expr;)*) => {
        impl Compiled for $real {
            $($(#[$attribute])* fn $name$(<$life>)?($($argument: $kind),*) -> $result { $of($($argument),*) })*
        }
    };
}

compiled! {
    world_with_limits(settings: Settings<Self>, limits: Limits) -> Result<World<Self>, Error> = World::empty;
    world_apply(world: &mut World<Self>, command: &Command<Self>, cancelled: &AtomicBool) -> Result<Outcome, Error>
        = World::apply_command;
    world_apply_all(world: &mut World<Self>, commands: &[Command<Self>]) -> Result<Vec<Outcome>, BatchError>
        = World::apply_commands;
    world_begin(world: &mut World<Self>, keep: Keep) -> Before<Self> = World::begin_batch;
    world_end(world: &mut World<Self>, before: Before<Self>, is_refused: bool) -> () = World::end_batch;
    world_particle(world: &World<Self>, id: ParticleId) -> Result<ParticleState<Self>, Error> = World::state_of;
    world_walk<'a>(world: &'a World<Self>, first: ParticleId) -> Walk<'a, Self> = Walk::begin;
    world_go_on(walk: &mut Walk<'_, Self>) -> () = Walk::go_on;
    world_read(world: &World<Self>, first: ParticleId, limit: usize, into: &mut States<Self>) -> () = World::read_states;
    world_show(world: &World<Self>, visit: &mut dyn FnMut(&States<Self>)) -> () = World::show_blocks;
    world_trajectory(world: &World<Self>, id: ParticleId, duration: f64, samples: usize, cancelled: &AtomicBool)
        -> Result<Trajectory<Self>, Error> = World::way_of;
    world_keep_history(world: &mut World<Self>) -> () = World::keep_marks;
    world_has_changed(changes: &Changes<'_, Self>, row: usize) -> bool = Changes::differs;
    #[cfg(feature = "digest")]
    world_digest(world: &World<Self>) -> Digest = World::hash;
    #[cfg(feature = "snapshot")]
    world_snapshot(world: &World<Self>, sink: &mut dyn Write) -> io::Result<()> = World::write_snapshot;
    #[cfg(feature = "snapshot")]
    world_restore(snapshot: Snapshot<&mut dyn Read>, limits: Limits) -> Result<World<Self>, SnapshotError> = Snapshot::read;
}
