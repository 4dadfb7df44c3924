//! The service itself: health, metrics, its description.

use std::sync::Arc;

use std::sync::atomic::Ordering;

use axum::extract::{Path, State};
use axum::http::{Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::command::gravity;
use crate::integrator::{DampingLaw, Integrator};
use crate::real::Precision;
use crate::server::App;
use crate::server::config::PAGE_MAX;
use crate::server::encoding::Encoding;
use crate::server::extract::{NoParameters, Read, no_parameters};
use crate::server::metrics;
use crate::server::problem::{Code, Problem};
use crate::server::reply::Reply;

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new()
        .routes(routes!(describe_service))
        .routes(routes!(healthz))
        .routes(routes!(readyz))
        .routes(routes!(read_metrics))
        .routes(routes!(openapi))
        .routes(routes!(explain_problem))
}

/// What this service is and may.
#[derive(Debug, Serialize, ToSchema)]
struct Service {
    name: &'static str,
    version: &'static str,
    integrators: Vec<&'static str>,
    damping_laws: Vec<&'static str>,
    precisions: Vec<&'static str>,
    gravities: Vec<&'static str>,
    limits: ServiceLimits,
    /// Optional parts that are switched on.
    features: Vec<&'static str>,
}

/// Limits in force; each is a flag of the command line.
#[derive(Debug, Serialize, ToSchema)]
struct ServiceLimits {
    worlds_max: usize,
    particles_max: u64,
    memory_bytes_max: u64,
    /// Of one batch.
    commands_max: usize,
    steps_max: u64,
    particle_steps_max: u64,
    /// Pairs of particles x evaluations of one advance, under gravitation.
    interactions_max: u64,
    /// Simulated seconds of one advance; null: what a clock can hold.
    #[schema(required)]
    duration_max: Option<f64>,
    body_bytes_max: usize,
    snapshot_bytes_max: usize,
    answer_bytes_max: u64,
    in_flight_bytes_max: u64,
    world_queue_max: usize,
    queue_max: usize,
    queue_timeout_ms: u64,
    shed_after_ms: u64,
    keys_max: usize,
    key_lifetime_ms: u64,
    page_max: usize,
    uri_bytes_max: usize,
    header_bytes_max: usize,
    connections_max: usize,
    address_connections_max: usize,
    streams_max: u32,
    header_timeout_ms: u64,
    idle_timeout_ms: u64,
    body_timeout_ms: u64,
    write_timeout_ms: u64,
    write_rate_min: u64,
    drain_timeout_ms: u64,
}

/// Whether it works.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"status": "ok"}))]
struct Health {
    /// `ok`, or `ready`.
    status: &'static str,
}

/// Describes the service
#[utoipa::path(get, path = "/v1", tag = "service", responses((status = 200, body = Service)))]
async fn describe_service(State(app): State<Arc<App>>, read: Read) -> Result<Response, Problem> {
    read.query::<NoParameters>()?;
    let config = &app.config;
    let mut features = Vec::new();
    features.extend(app.tokens.is_some().then_some("tokens"));
    features.extend((!config.allow_origin.is_empty()).then_some("cors"));
    let service = Service {
        name: env!("CARGO_PKG_NAME"),
        version: env!("CARGO_PKG_VERSION"),
        integrators: Integrator::ALL.map(Integrator::name).to_vec(),
        damping_laws: DampingLaw::ALL.map(DampingLaw::name).to_vec(),
        precisions: Precision::ALL.map(Precision::name).to_vec(),
        gravities: gravity::PRESETS.map(|(name, _)| name).to_vec(),
        limits: ServiceLimits {
            worlds_max: config.worlds_max,
            particles_max: config.particles_max,
            memory_bytes_max: config.memory_bytes_max,
            commands_max: config.commands_max,
            steps_max: config.steps_max,
            particle_steps_max: config.particle_steps_max,
            interactions_max: config.interactions_max,
            duration_max: config.duration_max,
            body_bytes_max: config.body_bytes_max,
            snapshot_bytes_max: config.snapshot_bytes_max,
            answer_bytes_max: config.answer_bytes_max,
            in_flight_bytes_max: config.in_flight_bytes_max,
            world_queue_max: config.world_queue_max,
            queue_max: config.queue_max,
            queue_timeout_ms: config.queue_timeout_ms,
            shed_after_ms: config.shed_after_ms,
            keys_max: config.keys_max,
            key_lifetime_ms: config.key_lifetime_ms,
            page_max: PAGE_MAX,
            uri_bytes_max: config.uri_bytes_max,
            header_bytes_max: config.header_bytes_max,
            connections_max: config.connections_max,
            address_connections_max: config.address_connections_max,
            streams_max: config.streams_max,
            header_timeout_ms: config.header_timeout_ms,
            idle_timeout_ms: config.idle_timeout_ms,
            body_timeout_ms: config.body_timeout_ms,
            write_timeout_ms: config.write_timeout_ms,
            write_rate_min: config.write_rate_min,
            drain_timeout_ms: config.drain_timeout_ms,
        },
        features,
    };
    Ok(Reply::ok(read.encoding, &service).into_response())
}

/// Whether the process is alive
#[utoipa::path(get, path = "/healthz", tag = "service", responses((status = 200, body = Health)))]
async fn healthz(uri: Uri) -> Result<Response, Problem> {
    no_parameters(&uri)?;
    Ok(Reply::ok(Encoding::Json, &Health { status: "ok" }).into_response())
}

/// Whether it takes on work
#[utoipa::path(get, path = "/readyz", tag = "service", responses((status = 200, body = Health)))]
async fn readyz(State(app): State<Arc<App>>, uri: Uri) -> Result<Response, Problem> {
    no_parameters(&uri)?;
    if app.draining.load(Ordering::Relaxed) {
        return Err(Problem::plain(Code::ShuttingDown));
    }
    app.shared.check_capacity()?;
    Ok(Reply::ok(Encoding::Json, &Health { status: "ready" }).into_response())
}

/// Counters as `OpenMetrics` text
#[utoipa::path(get, path = "/metrics", tag = "service",
    responses((status = 200, body = String, content_type = "application/openmetrics-text")))]
async fn read_metrics(State(app): State<Arc<App>>, uri: Uri) -> Result<Response, Problem> {
    no_parameters(&uri)?;
    let content_type = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    Ok(([(header::CONTENT_TYPE, content_type)], metrics::text(&app)).into_response())
}

/// Describes every route
#[utoipa::path(get, path = "/openapi.json", tag = "service", responses((status = 200, body = serde_json::Value)))]
async fn openapi(State(app): State<Arc<App>>, uri: Uri) -> Result<Response, Problem> {
    no_parameters(&uri)?;
    Ok(([(header::CONTENT_TYPE, "application/json")], app.openapi.clone()).into_response())
}

/// Explains the code of a problem
#[utoipa::path(get, path = "/problems/{code}", tag = "service", params(("code" = String, Path, example = "diverged")),
    responses((status = 200, body = String, content_type = "text/plain")))]
async fn explain_problem(Path(name): Path<String>, uri: Uri) -> Result<String, Problem> {
    no_parameters(&uri)?;
    let code =
        Code::ALL.into_iter().find(|code| code.name() == name).ok_or_else(|| Problem::plain(Code::UnknownRoute))?;
    Ok(format!("{} ({})\n\n{}\n", code.title(), code.status(), code.explanation()))
}
