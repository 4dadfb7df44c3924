//! `/v1/worlds`: create, describe, configure, delete.

use std::sync::Arc;

use axum::extract::State;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa::openapi::Ref;
use utoipa::openapi::schema::{ObjectBuilder, OneOfBuilder, Schema, Type};
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::command::{Command, Configure, Settings, gravity};
use crate::error::Error;
use crate::forces::Forces;
use crate::integrator::{DampingLaw, Integrator};
use crate::real::Precision;
use crate::registry::Refused;
use crate::server::App;
use crate::server::body::{Body, Raw};
use crate::server::config::WORLDS_MAX;
use crate::server::content::Content;
use crate::server::encoding::Encoding;
use crate::server::extract::{Change, NoParameters, Read, page_limit};
use crate::server::front::random;
use crate::server::idempotency::{Attempt, Key};
use crate::server::json::{Element, Named, Object, Vector, WireReal, choices, present};
use crate::server::problem::{Code, Problem, Shape};
use crate::server::reply::Reply;
use crate::server::settings::{ForcesBody, Parts, ToleranceBody};
use crate::server::slot::{AnySlot, Cost, Slot, with_slot};
use crate::server::wire::Description;
use crate::world::World;

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new()
        .routes(routes!(list_worlds, create_named_by_service))
        .routes(routes!(describe_world, create_world, configure_world, delete_world))
        .routes(routes!(digest_world))
}

/// Settings of a world; every field is optional.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewWorld, example = json!({"gravity": "standard", "integrator": "rk4", "max_step": 0.01, "forces": {"drag": {"k2": 0.02}}}))]
struct CreateWorld<'a> {
    /// `double` (default) or `single`; cannot be changed later.
    #[serde(default, deserialize_with = "present")]
    #[schema(schema_with = choices::<Precision>, required = false)]
    precision: Option<Named<Precision>>,
    /// How to move particles; default `exact`.
    #[serde(default, deserialize_with = "present")]
    #[schema(schema_with = choices::<Integrator>, required = false)]
    integrator: Option<Named<Integrator>>,
    /// In m/s², or one of the presets `standard`, `textbook`, `shooter`, `driving`. Default 0.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(schema_with = gravity_schema, required = false)]
    gravity: Option<Raw<'a>>,
    /// `per_second` (default) or `per_step`.
    #[serde(default, deserialize_with = "present")]
    #[schema(schema_with = choices::<DampingLaw>, required = false)]
    damping_law: Option<Named<DampingLaw>>,
    /// The longest step, in seconds, of an advance that names no steps. Default null: one step.
    #[serde(default)]
    max_step: Option<f64>,
    /// Drag and gravitation; default null: none. Not with `exact`.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<ForcesBody<f64>>)]
    forces: Option<Raw<'a>>,
    /// What `dop853` chooses its steps for.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<ToleranceBody>, nullable = false)]
    tolerance: Option<Object<ToleranceBody>>,
    /// true: steps of `velocity_verlet`, `rk4` and `dop853` keep what rounding takes from position and velocity, and add
    /// it later. Default false.
    #[serde(default)]
    compensated: bool,
}

/// New settings; an absent field stays.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ConfigureWorld, example = json!({"gravity": [0.0, -1.62, 0.0], "max_step": null, "tolerance": {"relative": 1e-12}}))]
struct ConfigureWorld<'a> {
    #[serde(default, deserialize_with = "present")]
    #[schema(schema_with = choices::<Integrator>, required = false)]
    integrator: Option<Named<Integrator>>,
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(schema_with = gravity_schema, required = false)]
    gravity: Option<Raw<'a>>,
    #[serde(default, deserialize_with = "present")]
    #[schema(schema_with = choices::<DampingLaw>, required = false)]
    damping_law: Option<Named<DampingLaw>>,
    /// null: none.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>)]
    #[expect(clippy::option_option, reason = "absent, null and a number are three things")]
    max_step: Option<Option<f64>>,
    /// null switches both off, a member that is null that one; what is absent, in a member too, stays.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<ForcesBody<f64>>)]
    forces: Option<Raw<'a>>,
    /// What is absent in it stays.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<ToleranceBody>, nullable = false)]
    tolerance: Option<Object<ToleranceBody>>,
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false)]
    compensated: Option<bool>,
}

/// A gravity: a vector in m/s², or the name of a preset.
fn gravity_schema() -> Schema {
    let presets =
        ObjectBuilder::new().schema_type(Type::String).enum_values(Some(gravity::PRESETS.map(|(name, _)| name)));
    OneOfBuilder::new().item(Ref::from_schema_name("Vector")).item(presets).build().into()
}

/// Worlds in order of name.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Worlds)]
struct Worlds {
    #[schema(value_type = Vec<Description<f64>>)]
    worlds: Vec<AnyDescription>,
    /// The `after` of the next page; null on the last one.
    #[schema(required)]
    next_after: Option<String>,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum AnyDescription {
    Single(Description<f32>),
    Double(Description<f64>),
}

/// A digest of everything that determines the future of a world, and when it was taken.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Digest, example = json!({
    "digest": "8b6ba0a0dc4d2e77a0f0f1a5a2a2ed6f5d3c6ab2cf0c8cbe6ed7a37b14ebf8a8",
    "time": 0.5, "step_count": 1, "revision": 7
}))]
struct DigestBody {
    /// 64 hexadecimal digits.
    digest: String,
    /// The clock in seconds.
    time: f64,
    /// Steps of all advances so far.
    step_count: u64,
    revision: u64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ListQuery {
    limit: Option<usize>,
    after: Option<String>,
}

/// Lists worlds
///
/// In order of name.
#[utoipa::path(get, path = "/v1/worlds", tag = "worlds",
    params(
        ("limit" = Option<usize>, Query, description = "at most so many; default 1000, at most 100000", minimum = 1, maximum = 100_000),
        ("after" = Option<String>, Query, description = "from the first name after this one"),
    ),
    responses((status = 200, body = Worlds)))]
async fn list_worlds(State(app): State<Arc<App>>, read: Read) -> Result<Response, Problem> {
    let ListQuery { limit, after } = read.query()?;
    let limit = page_limit(limit)?;
    let mut found = app.worlds.list(after.as_deref(), limit + 1);
    let more = found.len() > limit;
    found.truncate(limit);
    let next_after = found.last().filter(|_| more).map(|(name, _)| name.clone());
    let worlds = found.into_iter().map(|(_, slot)| match slot {
        AnySlot::Single(slot) => AnyDescription::Single(slot.description()),
        AnySlot::Double(slot) => AnyDescription::Double(slot.description()),
    });
    let reply = Reply::ok(read.encoding, &Worlds { worlds: worlds.collect(), next_after });
    Ok(reply.coded(read.coding, &app.shared).into_response())
}

/// Creates a world with a name that the service makes
#[utoipa::path(post, path = "/v1/worlds", tag = "worlds", request_body = CreateWorld,
    responses((status = 201, body = Description<f64>, headers(("location" = String), ("etag" = String)))))]
async fn create_named_by_service(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    // A random name: after a restart it does not lead to a world of somebody else. With a key the same one each time.
    let name = match &change.key {
        Some(Ok(key)) => key.world_name(app.secret),
        Some(Err(_)) | None => format!("w{:016x}", random()),
    };
    create(&app, &name, &change)
}

/// Creates a world
///
/// The name is a letter or digit and up to 63 letters, digits, `_` or `-`. An empty body takes all defaults.
#[utoipa::path(put, path = "/v1/worlds/{world}", tag = "worlds", request_body = CreateWorld,
    responses((status = 201, body = Description<f64>, headers(("location" = String), ("etag" = String)))))]
async fn create_world(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    create(&app, &change.target.world, &change)
}

fn create(app: &App, name: &str, change: &Change) -> Result<Response, Problem> {
    let existing = app.worlds.get(name);
    let key = change.key.as_ref().map(|key| key.as_ref().map_err(Clone::clone)).transpose()?;
    if let (Some(any), Some(key)) = (&existing, key)
        && let Attempt::Again(reply) = with_slot!(any, slot => slot.answers.attempt(key))?
    {
        return Ok(reply.into_response());
    }
    let body = if change.body.bytes.is_empty() { Ok(Raw::Json("{}")) } else { change.body.raw() };
    let parsed = body.and_then(|body| body.read::<Object<CreateWorld<'_>>>("")).map_err(|problem| {
        match problem.pointer.as_deref() {
            Some(pointer @ ("/name" | "/world")) if problem.code == Code::UnknownField => {
                let detail = "the name of a world stands in the path: create it with PUT /v1/worlds/{world}";
                Problem::at(Code::UnknownField, pointer, detail)
            }
            _ => problem,
        }
    });
    if let Err(problem) = &parsed
        && problem.is_malformed()
    {
        return Err(problem.clone());
    }
    if existing.is_some() {
        return Err(world_exists(name));
    }
    change.preconditions.check_absent()?;
    let Object(body) = parsed?;
    change.query::<NoParameters>()?;
    check_name(name)?;
    match body.precision.map_or(Precision::default(), |Named(precision)| precision) {
        Precision::Single => insert(app, name, key, change.encoding, &body, AnySlot::Single),
        Precision::Double => insert(app, name, key, change.encoding, &body, AnySlot::Double),
    }
}

fn insert<R: WireReal>(
    app: &App,
    name: &str,
    key: Option<&Key>,
    encoding: Encoding,
    body: &CreateWorld<'_>,
    any: impl FnOnce(Arc<Slot<R>>) -> AnySlot,
) -> Result<Response, Problem> {
    let default = Settings::<R>::default();
    let parts = Parts::read(body.forces, body.tolerance)?;
    let (force, law) = (parts.pointer_to_force(), body.damping_law.is_some());
    let (forces, tolerance) = parts.over(&default);
    let settings = Settings {
        integrator: body.integrator.map_or(default.integrator, |Named(integrator)| integrator),
        gravity: body.gravity.map(read_gravity::<R>).transpose()?.unwrap_or(default.gravity),
        damping_law: body.damping_law.map_or(default.damping_law, |Named(law)| law),
        max_step: body.max_step,
        forces,
        tolerance,
        compensated: body.compensated,
    };
    let mut world = World::with_limits(settings, app.config.limits()).map_err(|error| refused(error, force, law))?;
    world.set_threads(&app.shared.threads);
    let reply = Reply::ok(encoding, &Description::new(name, &world)).created(Some(format!("/v1/worlds/{name}"))).at(0);
    let slot = Slot::new(name, world, &app.shared);
    if let Some(key) = key {
        slot.keep_first(key, &reply)?;
    }
    app.worlds.insert(name, any(Arc::new(slot))).map_err(|refused| match refused {
        Refused::Exists => world_exists(name),
        Refused::Full => too_many_worlds(app),
    })?;
    Ok(reply.into_response())
}

/// What the engine refuses of settings. What does not go with the integrator points to what the request says of it.
fn refused(error: Error, force: Option<&str>, names_damping_law: bool) -> Problem {
    let problem = Problem::from_engine(error, Shape::World);
    if problem.code == Code::IntegratorCannotServeForces {
        problem.pointing_to(force.unwrap_or("/integrator"))
    } else if names_damping_law && matches!(error, Error::IntegratorCannotServeDamping { .. }) {
        problem.pointing_to("/damping_law")
    } else if problem.code == Code::IntegratorCannotServeDamping {
        problem.pointing_to("/integrator")
    } else {
        problem
    }
}

pub(crate) fn too_many_worlds(app: &App) -> Problem {
    let detail = format!("there are {} worlds, the most allowed (--{WORLDS_MAX}); delete one", app.config.worlds_max);
    Problem::new(Code::LimitReached, detail)
}

fn world_exists(name: &str) -> Problem {
    let detail = format!("there is a world {name:?} already; change its settings with PATCH, or DELETE it first");
    Problem::new(Code::WorldExists, detail)
}

/// Refuses what is no name.
pub(crate) fn check_name(name: &str) -> Result<(), Problem> {
    if is_world_name(name) {
        return Ok(());
    }
    let detail = format!("{name:?} is not a name: a letter or digit and then up to 63 letters, digits, _ or -");
    Err(Problem::new(Code::InvalidWorldName, detail))
}

fn is_world_name(name: &str) -> bool {
    let mut bytes = name.bytes();
    name.len() <= 64
        && bytes.next().is_some_and(|first| first.is_ascii_alphanumeric())
        && bytes.all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-')
}

fn read_gravity<R: WireReal>(raw: Raw<'_>) -> Result<R::Vec3, Problem> {
    if !raw.is_text() {
        return raw.read::<Vector<R>>("/gravity").map(Element::value);
    }
    let name: String = raw.read("/gravity")?;
    gravity::preset::<R>(&name).ok_or_else(|| {
        let names: Vec<&str> = gravity::PRESETS.iter().map(|(name, _)| *name).collect();
        let detail = format!("there is no gravity {name:?}; take a vector or one of {}", names.join(", "));
        Problem::at(Code::InvalidField, "/gravity", detail)
    })
}

/// Describes a world
#[utoipa::path(get, path = "/v1/worlds/{world}", tag = "worlds",
    responses((status = 200, body = Description<f64>, headers(("etag" = String)))))]
async fn describe_world(State(app): State<Arc<App>>, read: Read) -> Result<Response, Problem> {
    let any = app.slot(&read.target)?;
    let query = read.query::<NoParameters>();
    let (name, encoding) = (read.target.world.clone(), read.encoding);
    with_slot!(any, slot => slot.read(&read, query, |_, _| Cost::default(), move |world, _, _| {
        Ok(Content::of(encoding, &Description::new(&name, world)))
    }).await)
}

/// Digests a world
///
/// Two worlds have the same digest if and only if everything that determines their future is equal: the same commands
/// then give the same bits in both. Revision and step count are not part of it.
#[utoipa::path(get, path = "/v1/worlds/{world}/digest", tag = "worlds",
    responses((status = 200, body = DigestBody, headers(("etag" = String)))))]
async fn digest_world(State(app): State<Arc<App>>, read: Read) -> Result<Response, Problem> {
    let any = app.slot(&read.target)?;
    let query = read.query::<NoParameters>();
    let encoding = read.encoding;
    // A particle takes 0.15 µs, and 0.8 where the CPU has no instructions for SHA.
    with_slot!(any, slot => slot.read(&read, query,
        |world, _| Cost { answer: 0, ..Cost::of_reading(64 * world.particle_count() as u64) },
        move |world, _, _| Ok(Content::of(encoding, &DigestBody {
            digest: world.digest().to_string(),
            time: world.time(),
            step_count: world.step_count(),
            revision: world.revision(),
        }))).await)
}

/// Changes settings of a world
#[utoipa::path(patch, path = "/v1/worlds/{world}", tag = "worlds", request_body = ConfigureWorld,
    responses((status = 200, body = Description<f64>, headers(("etag" = String)))))]
async fn configure_world(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    fn read<R: WireReal>(body: &Body) -> Result<(Configure<R>, Parts<R>), Problem> {
        let Object(body) = body.read::<Object<ConfigureWorld<'_>>>()?;
        let parts = Parts::read(body.forces, body.tolerance)?;
        let configure = Configure {
            integrator: body.integrator.map(|Named(integrator)| integrator),
            gravity: body.gravity.map(read_gravity::<R>).transpose()?,
            damping_law: body.damping_law.map(|Named(law)| law),
            max_step: body.max_step,
            compensated: body.compensated,
            ..Configure::default()
        };
        Ok((configure, parts))
    }
    let any = app.slot(&change.target)?;
    let (name, encoding) = (change.target.world.clone(), change.encoding);
    with_slot!(any, slot => {
        let parsed = read(&change.body);
        let cost = |world: &World<_>, _: &_| Cost::of(world.particle_count() as u64);
        change.apply(&slot, parsed, cost, move |world, (configure, parts), _| {
            let (force, law) = (parts.pointer_to_force(), configure.damping_law.is_some());
            let (Forces { drag, gravitation }, tolerance) = parts.over(world.settings());
            let command = Command::Configure(Configure {
                drag: Some(drag),
                gravitation: Some(gravitation),
                tolerance: Some(tolerance),
                ..configure
            });
            world.apply(&command).map_err(|error| refused(error, force, law))?;
            Ok(Reply::ok(encoding, &Description::new(&name, world)))
        }).await
    })
}

/// Deletes a world
#[utoipa::path(delete, path = "/v1/worlds/{world}", tag = "worlds", responses((status = 204)))]
async fn delete_world(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    let any = app.slot(&change.target)?;
    let query = change.query::<NoParameters>().map(|_| ());
    // Sent again, it does not remove another world that has the name by now.
    let claim = match &change.key {
        None => None,
        Some(key) => match app.shared.removals.attempt(&key.clone()?.of_removal())? {
            Attempt::Again(reply) => return Ok(reply.into_response()),
            Attempt::First(claim) => Some(claim),
        },
    };
    let forget = || app.worlds.remove(&change.target.world);
    let response = with_slot!(any, slot => slot.remove(&change, query, forget).await)?;
    if let Some(claim) = claim {
        claim.answered(&Reply::no_content());
    }
    Ok(response)
}
