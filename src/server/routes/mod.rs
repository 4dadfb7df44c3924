//! One resource, one file: its routes first, then its shapes, then its handlers. Here is what they share.

pub(crate) mod advance;
pub(crate) mod commands;
pub(crate) mod docs;
pub(crate) mod forces;
pub(crate) mod particles;
pub(crate) mod service;
pub(crate) mod snapshot;
pub(crate) mod stream;
pub(crate) mod trajectory;
pub(crate) mod worlds;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use axum::response::{IntoResponse, Response};

use crate::command::{Command, Outcome, Selection};
use crate::ids::ParticleId;
use crate::real::Real;
use crate::server::body::Body;
use crate::server::content::Content;
use crate::server::encoding::Encoding;
use crate::server::extract::{Change, NoParameters};
use crate::server::json::WireReal;
use crate::server::problem::{Problem, Shape};
use crate::server::reply::Reply;
use crate::server::slot::{Cost, Slot};
use crate::server::wire::{Changed, ParticleView};
use crate::world::World;

impl Change {
    /// Changes the world of the path by a body without query parameters.
    pub(crate) async fn apply<R: WireReal, T: Send + Sync + 'static>(
        &self,
        slot: &Arc<Slot<R>>,
        parsed: Result<T, Problem>,
        cost: impl Fn(&World<R>, &T) -> Cost + Sync,
        apply: impl FnOnce(&mut World<R>, T, &AtomicBool) -> Result<Reply, Problem> + Send + 'static,
    ) -> Result<Response, Problem> {
        let parsed = parsed.and_then(|parsed| self.query::<NoParameters>().map(|_| parsed));
        slot.change(self, parsed, cost, apply).await.map(IntoResponse::into_response)
    }

    /// Changes the particle of the path by one command; the answer is the particle.
    pub(crate) async fn apply_to_one<R: WireReal>(
        &self,
        slot: &Arc<Slot<R>>,
        read: impl FnOnce(&Body, ParticleId) -> Result<Command<R>, Problem>,
    ) -> Result<Response, Problem> {
        let encoding = self.encoding;
        // An unknown particle is told before anything about the body.
        let id = self.target.particle().unwrap_or(ParticleId(u64::MAX));
        let command = read(&self.body, id);
        // A value that differs promotes a column.
        let cost = |world: &World<R>, _: &Command<R>| Cost::of(world.particle_count() as u64 / 8);
        self.apply(slot, command, cost, move |world, command, _| {
            world.apply(&command).map_err(|error| Problem::from_engine(error, Shape::Particle))?;
            Ok(Reply::of(whole(world, id, encoding)?))
        })
        .await
    }
}

/// The cost of a command that speaks of many particles; one named twice counts twice.
pub(crate) fn many<R: Real>(world: &World<R>, command: &Command<R>) -> Cost {
    let listed = if let Command::Set { ids: Selection::Ids(ids), .. }
    | Command::AddForce { ids: Selection::Ids(ids), .. } = command
    {
        ids.len()
    } else {
        0
    };
    Cost::of(listed.max(world.particle_count()) as u64)
}

/// The answer with one particle.
pub(crate) fn whole<R: WireReal>(world: &World<R>, id: ParticleId, encoding: Encoding) -> Result<Content, Problem> {
    let state = world.particle(id).map_err(|error| Problem::from_engine(error, Shape::Particle))?;
    Ok(Content::of(encoding, &ParticleView::whole(&state)))
}

/// Applies a command to many particles; the answer counts them.
pub(crate) fn apply_to_many<R: WireReal>(
    world: &mut World<R>,
    command: &Command<R>,
    encoding: Encoding,
) -> Result<Reply, Problem> {
    let outcome = world.apply(command).map_err(|error| Problem::from_engine(error, Shape::Columns))?;
    let Outcome::Changed { count } = outcome else { unreachable!("properties and forces answer with a count") };
    Ok(Reply::ok(encoding, &Changed { count, revision: world.revision() }))
}
