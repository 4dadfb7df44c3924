//! `POST /v1/worlds/{world}/advance`.

use std::sync::Arc;

use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ArrayBuilder, Schema};
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::command::{Advance, Advanced, Command, Outcome};
use crate::server::App;
use crate::server::extract::Change;
use crate::server::json::{self, Named, Object, WireReal, choices, present};
use crate::server::memory::PARTICLE_BYTES;
use crate::server::problem::{Problem, Shape};
use crate::server::slot::{Cost, Reply, with_slot};
use crate::server::wire::{self, Property};
use crate::world::World;

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new().routes(routes!(advance))
}

/// How far to advance, and in which steps.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Advance, example = json!({"duration": 0.5, "steps": 30, "return": ["position"]}))]
struct AdvanceBody {
    /// In seconds, above 0.
    #[schema(exclusive_minimum = 0)]
    duration: f64,
    /// How many steps; `exact` validates it and takes 1. Not together with `max_step`.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false, minimum = 1)]
    steps: Option<u64>,
    /// The longest step in seconds; default: that of the world.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false, exclusive_minimum = 0)]
    max_step: Option<f64>,
    /// Properties that the answer has as columns in `state`.
    #[serde(default, deserialize_with = "present", rename = "return")]
    #[schema(schema_with = properties_schema, required = false)]
    properties: Option<Vec<Named<Property>>>,
    /// true: answer what would be, and change nothing.
    #[serde(default)]
    dry_run: bool,
}

fn properties_schema() -> Schema {
    ArrayBuilder::new().items(RefOr::T(choices::<Property>())).build().into()
}

/// What the advance did.
#[derive(Debug, Serialize, ToSchema)]
#[serde(bound = "")]
#[schema(as = Advanced, bound = "", example = json!({
    "time": 0.5, "duration": 0.5, "steps": 1, "step": 0.5, "step_count": 1,
    "integrated": 0, "deferred": 3, "skipped": 1, "revision": 7
}))]
struct AdvancedBody<R: WireReal> {
    /// The clock of the world, in seconds.
    time: f64,
    /// In seconds, as asked.
    duration: f64,
    steps: u64,
    /// The length of one step in seconds.
    step: f64,
    /// Steps of all advances of this world.
    step_count: u64,
    /// Particles moved now.
    integrated: usize,
    /// Particles whose motion is evaluated when they are read.
    deferred: usize,
    /// Particles that nothing can move.
    skipped: usize,
    revision: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<wire::State<f64>>, nullable = false)]
    state: Option<wire::State<R>>,
}

/// Advances a world
///
/// Answers when the work is done. Forces act through all steps and are then cleared. Advances of one world happen in
/// the order in which they were accepted.
#[utoipa::path(post, path = "/v1/worlds/{world}/advance", tag = "advance", request_body = AdvanceBody,
    responses((status = 200, body = AdvancedBody<f64>, headers(("etag" = String)))))]
async fn advance(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    let any = app.slot(&change.target)?;
    let parsed = json::parse::<Object<AdvanceBody>>(&change.body).map(|Object(body)| body);
    let metrics = app.metrics.clone();
    with_slot!(any, slot => {
        change.apply(&slot, parsed, cost, move |world, body, cancelled| {
            let command = Command::Advance(body.advance());
            let properties: Option<Vec<Property>> =
                body.properties.map(|names| names.into_iter().map(|Named(property)| property).collect());
            let apply = |world: &mut World<_>| {
                let outcome = world.apply_unless(&command, cancelled).map_err(|error| Problem::from_engine(error, Shape::Columns))?;
                let Outcome::Advanced(advanced) = outcome else { unreachable!("an advance answers with what it advanced") };
                Ok((advanced, properties.as_ref().map(|properties| wire::State::of(world, properties))))
            };
            let (advanced, state) = if body.dry_run {
                apply(&mut world.clone())?
            } else {
                apply(world)?
            };
            if !body.dry_run {
                metrics.advanced(&advanced);
            }
            Ok(Reply::ok(json::write(&AdvancedBody::new(&advanced, world.revision(), state))))
        }).await
    })
}

/// Particle-steps, and numbers to write; a dry run works on a copy.
fn cost<R: WireReal>(world: &World<R>, body: &AdvanceBody) -> Cost {
    let written = 3 * body.properties.as_ref().map_or(0, Vec::len) as u64;
    let particles = world.particle_count() as u64;
    let copied = if body.dry_run { particles } else { 0 };
    let work = world.work(&body.advance()).saturating_add(particles * written + copied);
    Cost { work, bytes: copied * PARTICLE_BYTES }
}

impl AdvanceBody {
    fn advance(&self) -> Advance {
        Advance { steps: self.steps, max_step: self.max_step, ..Advance::by(self.duration) }
    }
}

impl<R: WireReal> AdvancedBody<R> {
    fn new(advanced: &Advanced, revision: u64, state: Option<wire::State<R>>) -> Self {
        let Advanced { time, duration, steps, step, step_count, integrated, deferred, skipped, .. } = *advanced;
        Self { time, duration, steps, step, step_count, integrated, deferred, skipped, revision, state }
    }
}
