//! `POST /v1/worlds/{world}/advance`.

use std::sync::Arc;

use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::command::{Advance, Advanced, Command, Outcome, Plane, Settings, StepError, Until};
use crate::error::Error;
use crate::ids::ParticleId;
use crate::integrator::Integrator;
use crate::server::App;
use crate::server::columns::Columns;
use crate::server::config::{Config, DURATION_MAX};
use crate::server::content::Composer;
use crate::server::extract::Change;
use crate::server::json::{Named, Object, Vector, WireReal, present};
use crate::server::memory::{ADAPTIVE_BYTES, COMPARED_BYTES, PARTICLE_BYTES, SYSTEM_BYTES};
use crate::server::problem::{Code, Problem, Shape};
use crate::server::reply::Reply;
use crate::server::slot::{Cost, Shared, with_slot};
use crate::server::wire::{self, Property, VectorSchema};
use crate::world::World;

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new().routes(routes!(advance))
}

/// How far to advance, and in which steps.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Advance, example = json!({"duration": 0.5, "steps": 30, "return": ["position"]}))]
pub(crate) struct AdvanceBody {
    /// In seconds, above 0.
    #[schema(exclusive_minimum = 0)]
    duration: f64,
    /// How many steps; `exact` validates it and takes 1, `dop853` chooses its own. Not together with `max_step`.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false, minimum = 1)]
    steps: Option<u64>,
    /// The longest step in seconds; default: that of the world.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false, exclusive_minimum = 0)]
    max_step: Option<f64>,
    /// Properties that the answer has as columns in `state`.
    #[serde(default, deserialize_with = "present", rename = "return")]
    #[schema(schema_with = wire::properties_schema, required = false)]
    properties: Option<Vec<Named<Property>>>,
    /// true: answer what would be, and change nothing.
    #[serde(default)]
    dry_run: bool,
    /// true: the answer has `error`.
    #[serde(default)]
    report_error: bool,
    /// Stop at the moment when a particle reaches a plane: the answer has `crossed`, and `time` is that moment.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<UntilBody>, nullable = false)]
    until: Option<Object<UntilBody>>,
}

/// When to stop earlier.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Until, example = json!({"particle": 0, "plane": {"normal": [0.0, 1.0, 0.0], "offset": 0.0}}))]
struct UntilBody {
    /// Its id.
    particle: u64,
    #[schema(value_type = PlaneBody)]
    plane: Object<PlaneBody>,
}

/// The points x with normal · x = offset.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Plane, example = json!({"normal": [0.0, 1.0, 0.0], "offset": 0.0}))]
struct PlaneBody {
    /// Not 0; of any length.
    #[schema(value_type = VectorSchema)]
    normal: Vector<f64>,
    /// The distance from the origin in metres, times the length of the normal; default 0.
    #[serde(default)]
    offset: f64,
}

/// The largest distances, of any particle, from the closed form from the same start.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = StepError, example = json!({"position": 0.0025, "velocity": 0.0}))]
struct StepErrorBody {
    /// In metres.
    position: f64,
    /// In m/s.
    velocity: f64,
}

/// What the advance did.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Advanced, example = json!({
    "time": 0.5, "duration": 0.5, "steps": 1, "step": 0.5, "step_count": 1,
    "integrated": 0, "deferred": 3, "skipped": 1, "revision": 7
}))]
pub(crate) struct AdvancedBody {
    /// The clock of the world, in seconds.
    time: f64,
    /// In seconds: as asked, and with `until`, where the particle reached the plane, up to that moment.
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
    /// Under `dop853`: steps taken back because their error was above the tolerance.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    rejected_steps: Option<u64>,
    /// Under `dop853`: how often the accelerations of all particles were computed.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    evaluations: Option<u64>,
    /// With `report_error`: how far the steps ended from the closed form; null where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<StepErrorBody>)]
    #[expect(clippy::option_option, reason = "not asked for, null and an object are three things")]
    error: Option<Option<StepErrorBody>>,
    /// With `until`: whether the particle reached the plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    crossed: Option<bool>,
    /// Absent in a batch, which has one for all.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    revision: Option<u64>,
    /// The columns that `return` names.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<wire::State>, nullable = false)]
    state: Option<()>,
}

/// Advances a world
///
/// Answers when the work is done. Forces act through all steps and are then cleared. Advances of one world happen in
/// the order in which they were accepted.
#[utoipa::path(post, path = "/v1/worlds/{world}/advance", tag = "advance", request_body = AdvanceBody,
    responses((status = 200, body = AdvancedBody, headers(("etag" = String)))))]
async fn advance(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    let any = app.slot(&change.target)?;
    let parsed = change.body.read::<Object<AdvanceBody>>().and_then(|Object(body)| {
        check_duration(body.duration, &app.config, "/duration")?;
        Ok(body)
    });
    let encoding = change.encoding;
    with_slot!(any, slot => {
        change.apply(&slot, parsed, cost, move |world, body, cancelled| {
            let advance = body.advance();
            let command = Command::Advance(advance);
            let properties = body.properties.map(wire::named);
            let revision = Some(world.revision() + u64::from(!body.dry_run));
            let apply = |world: &mut World<_>| {
                let outcome = world.apply_unless(&command, cancelled).map_err(|error| refused(error, &advance))?;
                let Outcome::Advanced(advanced) = outcome else { unreachable!("an advance answers with what it advanced") };
                let mut composer = Composer::new(encoding);
                let answer = AdvancedBody { revision, ..AdvancedBody::new(&advanced, world, body.report_error) };
                answer.write(world, properties.as_deref(), &app.shared, &mut composer);
                Ok((advanced, composer.content()))
            };
            let (advanced, content) = if body.dry_run {
                apply(&mut world.clone())?
            } else {
                apply(world)?
            };
            if !body.dry_run {
                app.metrics.advanced(&advanced);
            }
            Ok(Reply::of(content))
        }).await
    })
}

/// What the engine refuses of an advance. What would take too long points to what the request says of its length.
pub(crate) fn refused(error: Error, advance: &Advance) -> Problem {
    let problem = Problem::from_engine(error, Shape::World);
    if problem.code != Code::ComputeBudget {
        return problem;
    }
    problem.pointing_to(match advance {
        Advance { steps: Some(_), .. } => "/steps",
        Advance { max_step: Some(_), .. } => "/max_step",
        Advance { .. } => "/duration",
    })
}

/// Refuses more simulated seconds than one request may take.
pub(crate) fn check_duration(duration: f64, config: &Config, pointer: &str) -> Result<(), Problem> {
    match config.duration_max {
        Some(max) if duration > max => {
            let detail = format!("the duration is above {max} s (--{DURATION_MAX})");
            Err(Problem::at(Code::ComputeBudget, pointer, detail))
        }
        Some(_) | None => Ok(()),
    }
}

/// Particle-steps, and numbers to write; a dry run works on a copy.
fn cost<R: WireReal>(world: &World<R>, body: &AdvanceBody) -> Cost {
    let particles = world.particle_count() as u64;
    let written = body.properties.as_ref().map_or(0, |properties| (1 + 3 * properties.len() as u64) * particles);
    let copied = if body.dry_run { particles } else { 0 };
    let advance = body.advance();
    let work = world.work(&advance).saturating_add(written + copied);
    Cost {
        bytes: copied * PARTICLE_BYTES + bytes_of_copies(world, &advance, particles),
        ..Cost::of(work).answering(written)
    }
}

/// What an advance of so many particles takes besides the world, until it is done.
pub(crate) fn bytes_of_copies<R: WireReal>(world: &World<R>, advance: &Advance, particles: u64) -> u64 {
    let Settings { integrator, forces, .. } = *world.settings();
    if integrator == Integrator::Exact {
        return 0;
    }
    let in_place = integrator.is_euler() && !forces.any() && advance.until.is_none();
    let system = if in_place { 0 } else { SYSTEM_BYTES };
    let system = if integrator == Integrator::Dop853 { ADAPTIVE_BYTES } else { system };
    let compared = if advance.report_error { COMPARED_BYTES } else { 0 };
    particles.saturating_mul(system + compared)
}

impl AdvanceBody {
    /// As one command of several, and the columns to return.
    pub(crate) fn in_batch(self) -> Result<(Advance, Option<Vec<Property>>), Problem> {
        if self.dry_run {
            let detail = "a batch has no dry run of an advance; send it as a request of its own";
            return Err(Problem::at(Code::InvalidField, "/dry_run", detail));
        }
        let advance = self.advance();
        Ok((advance, self.properties.map(wire::named)))
    }

    fn advance(&self) -> Advance {
        let until = self.until.as_ref().map(|Object(UntilBody { particle, plane: Object(plane) })| Until {
            particle: ParticleId(*particle),
            plane: Plane { normal: plane.normal.0, offset: plane.offset },
        });
        let Self { duration, steps, max_step, report_error, .. } = *self;
        Advance { duration, steps, max_step, report_error, until }
    }
}

impl AdvancedBody {
    /// Writes it, with columns of the world where they were asked for.
    pub(crate) fn write<R: WireReal>(
        self,
        world: &World<R>,
        properties: Option<&[Property]>,
        shared: &Arc<Shared>,
        composer: &mut Composer,
    ) {
        let Some(properties) = properties else { return composer.writer.value(&self) };
        composer.writer.value_without_end(&Self { state: Some(()), ..self });
        composer.columns(world, Columns::of(world, properties), shared);
        composer.writer.end_map();
    }

    /// Of one command of several, which have one revision.
    pub(crate) fn new<R: WireReal>(advanced: &Advanced, world: &World<R>, report_error: bool) -> Self {
        let Advanced { time, duration, steps, step, step_count, integrated, deferred, skipped, crossed, .. } =
            *advanced;
        let chooses = world.settings().integrator == Integrator::Dop853;
        Self {
            time,
            duration,
            steps,
            step,
            step_count,
            integrated,
            deferred,
            skipped,
            rejected_steps: chooses.then_some(advanced.rejected_steps),
            evaluations: chooses.then_some(advanced.evaluations),
            error: report_error.then(|| advanced.error.map(StepErrorBody::new)),
            crossed,
            revision: None,
            state: None,
        }
    }
}

impl StepErrorBody {
    /// Two numbers can be further apart than the largest one; nothing that is not finite is written.
    fn new(StepError { position, velocity }: StepError) -> Self {
        Self { position: position.min(f64::MAX), velocity: velocity.min(f64::MAX) }
    }
}
