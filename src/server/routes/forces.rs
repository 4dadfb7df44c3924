//! Forces and impulses.

use std::sync::Arc;

use axum::extract::State;
use axum::response::Response;
use serde::Deserialize;
use utoipa::ToSchema;
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::column::Column;
use crate::command::Command;
use crate::ids::ParticleId;
use crate::server::App;
use crate::server::body::{Body, Raw};
use crate::server::extract::{Bulk, Change};
use crate::server::json::{Element, Object, Vector, WireReal, column, present};
use crate::server::problem::Problem;
use crate::server::routes::{apply_to_many, many};
use crate::server::slot::with_slot;
use crate::server::wire::{Changed, ParticleView, VectorColumn, VectorSchema, selection};

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new().routes(routes!(add_force)).routes(routes!(apply_impulse)).routes(routes!(add_forces))
}

/// A force in newtons.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = Force, bound = "", example = json!({"force": [0.0, 12.0, 0.0]}))]
struct ForceBody<R: WireReal> {
    #[schema(value_type = VectorSchema)]
    force: Vector<R>,
}

/// An impulse in newton seconds.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = Impulse, bound = "", example = json!({"impulse": [1.0, 0.0, 0.0]}))]
struct ImpulseBody<R: WireReal> {
    #[schema(value_type = VectorSchema)]
    impulse: Vector<R>,
}

/// Forces for many particles: one vector for all of them, or a list with one for each.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Forces, example = json!({"ids": [0], "force": [[0.0, 12.0, 0.0]]}))]
pub(crate) struct ForcesBody<'a> {
    /// Which particles, in the order of the list; absent: all, in ascending order of id.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false)]
    ids: Option<Vec<u64>>,
    /// In newtons.
    #[serde(borrow)]
    #[schema(value_type = VectorColumn)]
    force: Raw<'a>,
}

impl ForcesBody<'_> {
    pub(crate) fn command<R: WireReal>(self) -> Result<Command<R>, Problem> {
        let force = column::<Vector<R>>(self.force, "force")?;
        Ok(Command::AddForce { ids: selection(self.ids), force })
    }
}

/// Adds a force
///
/// To the accumulator of the particle: the sum acts through the whole next advance and is then cleared.
#[utoipa::path(post, path = "/v1/worlds/{world}/particles/{id}/force", tag = "forces", request_body = ForceBody<f64>,
    responses((status = 200, body = ParticleView<f64>, headers(("etag" = String)))))]
async fn add_force(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    fn read<R: WireReal>(body: &Body, id: ParticleId) -> Result<Command<R>, Problem> {
        let Object(ForceBody { force }) = body.read::<Object<ForceBody<R>>>()?;
        Ok(Command::AddForce { ids: id.into(), force: Column::Uniform(force.value()) })
    }
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => change.apply_to_one(&slot, read).await)
}

/// Applies an impulse
///
/// Changes the velocity at once, by impulse x `inverse_mass`.
#[utoipa::path(post, path = "/v1/worlds/{world}/particles/{id}/impulse", tag = "forces", request_body = ImpulseBody<f64>,
    responses((status = 200, body = ParticleView<f64>, headers(("etag" = String)))))]
async fn apply_impulse(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    fn read<R: WireReal>(body: &Body, id: ParticleId) -> Result<Command<R>, Problem> {
        let Object(ImpulseBody { impulse }) = body.read::<Object<ImpulseBody<R>>>()?;
        Ok(Command::Impulse { ids: id.into(), impulse: Column::Uniform(impulse.value()) })
    }
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => change.apply_to_one(&slot, read).await)
}

/// Adds forces to many particles
///
/// Without `ids` to every particle of the world. An id that is named twice gets both. All or none.
#[utoipa::path(post, path = "/v1/worlds/{world}/forces", tag = "forces", request_body = ForcesBody,
    responses((status = 200, body = Changed, headers(("etag" = String)))))]
async fn add_forces(State(app): State<Arc<App>>, Bulk(change): Bulk) -> Result<Response, Problem> {
    fn read<R: WireReal>(body: &Body) -> Result<Command<R>, Problem> {
        body.read::<Object<ForcesBody<'_>>>()?.0.command()
    }
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => {
        let parsed = app.shared.parse(change.body.clone(), read).await;
        let encoding = change.encoding;
        change.apply(&slot, parsed, many, move |world, command, _| apply_to_many(world, &command, encoding)).await
    })
}
