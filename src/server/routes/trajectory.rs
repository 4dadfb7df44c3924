//! `GET /v1/worlds/{world}/particles/{id}/trajectory`.

use std::sync::Arc;

use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::command::Advance;
use crate::ids::ParticleId;
use crate::server::App;
use crate::server::content::Content;
use crate::server::extract::Read;
use crate::server::json::WireReal;
use crate::server::memory::PARTICLE_BYTES;
use crate::server::problem::{Code, Problem, Shape};
use crate::server::routes::advance::{bytes_of_copies, check_duration};
use crate::server::slot::{Cost, with_slot};
use crate::server::wire::VectorSchema;
use crate::world::{Trajectory, World};

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new().routes(routes!(read_trajectory))
}

const SAMPLES_DEFAULT: usize = 101;
const SAMPLES_MAX: usize = 100_000;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TrajectoryQuery {
    duration: f64,
    samples: Option<usize>,
}

/// What is asked for, valid but for the duration, which the engine judges.
struct Way {
    particle: ParticleId,
    duration: f64,
    samples: usize,
}

/// Where a particle will be, as columns.
#[derive(Debug, Serialize, ToSchema)]
#[serde(bound = "")]
#[schema(as = Trajectory, bound = "", example = json!({
    "particle": 0, "time": [0.0, 1.0], "position": [[0.0, 20.0, 0.0], [3.0, 15.0, 0.0]],
    "velocity": [[3.0, 0.0, 0.0], [3.0, -10.0, 0.0]]
}))]
struct TrajectoryBody<R: WireReal> {
    particle: u64,
    /// Clocks in seconds, from now on.
    time: Vec<f64>,
    /// In metres.
    #[schema(value_type = Vec<VectorSchema>)]
    position: Vec<[R; 3]>,
    /// In m/s.
    #[schema(value_type = Vec<VectorSchema>)]
    velocity: Vec<[R; 3]>,
}

/// Reads where a particle will be
///
/// From now until `duration` seconds later, when nothing more is done to the world; nothing is changed. The forces added
/// so far act all the time. Under a stepped integrator the time from one sample to the next is an advance, in the steps
/// that the world prescribes.
#[utoipa::path(get, path = "/v1/worlds/{world}/particles/{id}/trajectory", tag = "advance",
    params(
        ("duration" = f64, Query, description = "in seconds, above 0", exclusive_minimum = 0, example = 10),
        ("samples" = Option<usize>, Query, description = "how many moments, the first and the last among them; default 101, at most 100000", minimum = 2, maximum = 100_000),
    ),
    responses((status = 200, body = TrajectoryBody<f64>, headers(("etag" = String)))))]
async fn read_trajectory(State(app): State<Arc<App>>, read: Read) -> Result<Response, Problem> {
    let any = app.slot(&read.target)?;
    let query = read.target.particle().and_then(|particle| {
        let query = read.query::<TrajectoryQuery>()?;
        check_duration(query.duration, &app.config, "").map_err(Problem::without_pointer)?;
        query.of(particle)
    });
    let encoding = read.encoding;
    with_slot!(any, slot => slot.read(&read, query, cost, move |world, way, cancelled| {
        let Way { particle, duration, samples } = way;
        let Trajectory { time, position, velocity } = world
            .trajectory_unless(particle, duration, samples, cancelled)
            .map_err(|error| Problem::from_engine(error, Shape::Particle).without_pointer())?;
        Ok(Content::of(encoding, &TrajectoryBody { particle: particle.0, time, position, velocity }))
    }).await)
}

impl TrajectoryQuery {
    fn of(self, particle: ParticleId) -> Result<Way, Problem> {
        let samples = self.samples.unwrap_or(SAMPLES_DEFAULT);
        if !(2..=SAMPLES_MAX).contains(&samples) {
            let detail = format!("samples is a number from 2, the first and the last moment, to {SAMPLES_MAX}");
            return Err(Problem::new(Code::InvalidParameter, detail));
        }
        Ok(Way { particle, duration: self.duration, samples })
    }
}

/// Particle-steps, and numbers to write; under gravitation the whole world goes along, as a copy.
fn cost<R: WireReal>(world: &World<R>, way: &Way) -> Cost {
    let written = 7 * way.samples as u64;
    let bytes = if world.settings().forces.gravitation.is_some() {
        let particles = world.particle_count() as u64;
        PARTICLE_BYTES * particles + bytes_of_copies(world, &Advance::by(way.duration), particles)
    } else {
        0
    };
    let work = world.trajectory_work(way.duration, way.samples).saturating_add(written);
    Cost { bytes, ..Cost::of(work).answering(written) }
}
