//! `/v1/worlds/{world}/particles` and the state of all of them in columns.

use std::sync::Arc;

use axum::extract::State;
use axum::response::Response;
use serde::de::IgnoredAny;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::column::Column;
use crate::command::{Command, NewParticles, Outcome, Properties};
use crate::error::{Error, Limit};
use crate::ids::ParticleId;
use crate::server::App;
use crate::server::body::{Body, Raw};
use crate::server::columns::Columns;
use crate::server::content::{Composer, Content};
use crate::server::encoding::Encoding;
use crate::server::extract::{Bulk, Change, NoParameters, Read, page_limit};
use crate::server::json::{Element, Object, Vector, WireReal, present};
use crate::server::memory::PARTICLE_BYTES;
use crate::server::problem::{Code, Problem, Shape};
use crate::server::reply::Reply;
use crate::server::routes::{apply_to_many, many, whole};
use crate::server::slot::{Cost, with_slot};
use crate::server::wire::{
    self, Changed, ColumnsBody, Created, ParticleBody, ParticleView, Property, Rows, SetManyBody, SetOneBody,
    VectorSchema, properties,
};
use crate::world::World;

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new()
        .routes(routes!(create_particles, list_particles, set_particles))
        .routes(routes!(read_particle, set_particle, remove_particle))
        .routes(routes!(set_mass))
        .routes(routes!(place_particle))
        .routes(routes!(read_state))
}

/// One particle, a list of them, or columns with a `count`.
#[derive(ToSchema)]
#[schema(as = NewParticles)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for the body in the description")]
pub(crate) enum CreateBody<'a> {
    One(ParticleBody<f64>),
    List(Vec<ParticleBody<f64>>),
    Columns(ColumnsBody<'a>),
}

/// The particle, or the ids of several.
#[derive(ToSchema)]
#[schema(as = CreatedParticles)]
#[serde(untagged)]
#[expect(dead_code, clippy::large_enum_variant, reason = "stands for the answer in the description")]
enum CreateAnswer {
    One(ParticleView<f64>),
    Many(Created),
}

/// Exactly one of the two.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = Mass, bound = "", example = json!({"mass": 2.0}))]
struct MassBody<R: WireReal> {
    /// In kg, above 0.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, exclusive_minimum = 0)]
    mass: Option<R>,
    /// In 1/kg, at least 0; 0 is immovable.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = 0)]
    inverse_mass: Option<R>,
}

/// A teleport: position, velocity or both.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, bound = "")]
#[schema(as = Place, bound = "", example = json!({"position": [0.0, 10.0, 0.0], "velocity": [0.0, 0.0, 0.0]}))]
struct PlaceBody<R: WireReal> {
    /// In metres; absent: it stays.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorSchema>, nullable = false)]
    position: Option<Vector<R>>,
    /// In m/s; absent: it stays.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorSchema>, nullable = false)]
    velocity: Option<Vector<R>>,
}

/// Particles in ascending order of id.
#[derive(Debug, Serialize, ToSchema)]
#[serde(bound = "")]
#[schema(as = Particles, bound = "")]
struct Particles<R: WireReal> {
    /// The clock in seconds.
    time: f64,
    /// With `changed_since`: what to ask from the next time.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    revision: Option<u64>,
    /// Whether everything is listed, since what changed is not known; otherwise absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    full: Option<bool>,
    /// With `changed_since`, on each page: ids that were removed, in ascending order.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    removed: Option<Vec<u64>>,
    #[schema(value_type = Vec<ParticleView<f64>>)]
    #[expect(clippy::struct_field_names, reason = "the name in JSON")]
    particles: Vec<ParticleView<R>>,
    /// The `after` of the next page; null on the last one.
    #[schema(required)]
    next_after: Option<u64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ListQuery {
    ids: Option<String>,
    fields: Option<String>,
    limit: Option<usize>,
    after: Option<u64>,
    changed_since: Option<u64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct StateQuery {
    fields: Option<String>,
    ids: Option<String>,
    changed_since: Option<u64>,
}

/// Creates particles
///
/// One particle: the answer is the particle, with its path in `Location`. A list of particles, or columns (an object
/// with `count`): the answer has the first id and the count. All or none.
#[utoipa::path(post, path = "/v1/worlds/{world}/particles", tag = "particles", request_body = CreateBody,
    responses((status = 201, body = CreateAnswer, headers(("location" = String), ("etag" = String)))))]
async fn create_particles(State(app): State<Arc<App>>, Bulk(change): Bulk) -> Result<Response, Problem> {
    let any = app.slot(&change.target)?;
    let (name, encoding) = (change.target.world.clone(), change.encoding);
    with_slot!(any, slot => {
        let most = app.config.particles_max;
        let parsed = app.shared.parse(change.body.clone(), move |body| read_new(body.raw()?, most)).await;
        let cost = |_: &World<_>, new: &New<_>| {
            let count = new.particles.count as u64;
            Cost { bytes: count.saturating_mul(PARTICLE_BYTES), ..Cost::of(count) }
        };
        change.apply(&slot, parsed, cost, move |world, new, _| {
            let created = world.apply(&Command::Create(new.particles));
            let Outcome::Created { first, count } = created.map_err(|error| Problem::from_engine(error, new.shape))? else {
                unreachable!("a creation answers with what it created")
            };
            if new.shape == Shape::Particle {
                let location = format!("/v1/worlds/{name}/particles/{first}");
                Ok(Reply::of(whole(world, first, encoding)?).created(Some(location)))
            } else {
                Ok(Reply::ok(encoding, &Created { first_id: first.0, count }).created(None))
            }
        }).await
    })
}

/// Particles to create, and how the request said it.
pub(crate) struct New<R: WireReal> {
    pub(crate) particles: NewParticles<R>,
    pub(crate) shape: Shape,
}

pub(crate) fn read_new<R: WireReal>(body: Raw<'_>, most: u64) -> Result<New<R>, Problem> {
    if body.is_list() {
        // Before they are looked at one by one.
        let asked = body.objects();
        if asked > most {
            body.read::<IgnoredAny>("")?;
            let refused = Error::LimitReached { limit: Limit::Particles, asked, allowed: most };
            return Err(Problem::from_engine(refused, Shape::List));
        }
        return Ok(New { particles: body.read::<Rows<R>>("")?.particles()?, shape: Shape::List });
    }
    // Without a count the columns are those of one particle, which takes no lists: read again as such.
    let columns = body.read::<Object<ColumnsBody<'_>>>("");
    if let Ok(Object(columns @ ColumnsBody { count: None, .. })) = &columns {
        let Object(one) = body.read::<Object<ParticleBody<R>>>("").map_err(|problem| {
            // It would do for any number of particles, if it had one.
            let needs_count = columns.particles::<R>(0).is_ok();
            let hint = "; columns, with a value for each particle, need a count";
            if needs_count { problem.under("").adding(hint) } else { problem }
        })?;
        return Ok(New { particles: one.one()?, shape: Shape::Particle });
    }
    let Object(columns) = columns?;
    let count = columns.count.unwrap_or_default();
    Ok(New { particles: columns.particles(count)?, shape: Shape::Columns })
}

/// Lists particles
///
/// In ascending order of id.
#[utoipa::path(get, path = "/v1/worlds/{world}/particles", tag = "particles",
    params(
        ("ids" = Option<String>, Query, description = "only these, separated by commas: `0,2`"),
        ("fields" = Option<String>, Query, description = "only these properties besides the id, separated by commas", example = "position,velocity"),
        ("limit" = Option<usize>, Query, description = "at most so many; default 1000, at most 100000", minimum = 1, maximum = 100_000),
        ("after" = Option<u64>, Query, description = "from the first id after this one"),
        ("changed_since" = Option<u64>, Query, description = "only what changed since this revision: see the state in columns"),
    ),
    responses((status = 200, body = Particles<f64>, headers(("etag" = String)))))]
async fn list_particles(State(app): State<Arc<App>>, read: Read) -> Result<Response, Problem> {
    let any = app.slot(&read.target)?;
    let query = read.query::<ListQuery>().and_then(List::try_from);
    let encoding = read.encoding;
    let cost = |list: &List, count: usize| {
        let cost = Cost::of_reading(list.numbers() * list.limit.min(count) as u64);
        if list.changed_since.is_some() { cost.doing(count as u64).asking_history() } else { cost }
    };
    with_slot!(any, slot => slot.read(&read, query,
        |world, list| cost(list, world.particle_count()),
        move |world, list, _| list.of(world, encoding)).await)
}

struct List {
    ids: Option<Vec<u64>>,
    /// `None`: everything.
    properties: Option<Vec<Property>>,
    limit: usize,
    after: Option<u64>,
    changed_since: Option<u64>,
}

/// Reads `ids=2,0`: in ascending order, each once.
pub(crate) fn listed_ids(ids: &str) -> Result<Vec<u64>, Problem> {
    let mut ids = ids
        .split(',')
        .map(str::parse)
        .collect::<Result<Vec<u64>, _>>()
        .map_err(|_| Problem::new(Code::InvalidParameter, "ids is a list of whole numbers, separated by commas"))?;
    ids.sort_unstable();
    ids.dedup();
    Ok(ids)
}

impl TryFrom<ListQuery> for List {
    type Error = Problem;
    fn try_from(query: ListQuery) -> Result<Self, Problem> {
        Ok(Self {
            ids: query.ids.as_deref().map(listed_ids).transpose()?,
            properties: query.fields.map(|fields| properties(&fields)).transpose()?,
            limit: page_limit(query.limit)?,
            after: query.after,
            changed_since: query.changed_since,
        })
    }
}

impl List {
    /// As many as a particle in the answer is long, names included.
    fn numbers(&self) -> u64 {
        self.properties.as_ref().map_or(30, |properties| 2 + 4 * properties.len() as u64)
    }

    fn of<R: WireReal>(self, world: &World<R>, encoding: Encoding) -> Result<Content, Problem> {
        let first = match self.after {
            None => Some(0),
            Some(after) => after.checked_add(1),
        };
        let mut particles = Vec::new();
        let mut more = false;
        let mut push = |state| {
            more = particles.len() == self.limit;
            if !more {
                let view = match &self.properties {
                    None => ParticleView::whole(&state),
                    Some(properties) => ParticleView::new(&state, properties),
                };
                particles.push((view, state.id.0));
            }
            more
        };
        let changes = self.changed_since.and_then(|since| world.changed_since(since));
        let is_meant = |id: &ParticleId| self.ids.as_ref().is_none_or(|ids| ids.binary_search(&id.0).is_ok());
        if let (Some(ids), None) = (&self.ids, self.changed_since) {
            check_there(world, ids)?;
        }
        if let Some(first) = first.map(ParticleId) {
            let read = |id| world.particle(id).ok();
            let _full = match (&changes, &self.ids) {
                (Some(changes), _) => changes.ids_from(first).filter(is_meant).filter_map(read).any(&mut push),
                (None, Some(ids)) => {
                    ids.iter().copied().map(ParticleId).filter(|id| *id >= first).filter_map(read).any(&mut push)
                }
                (None, None) => world.particles_from(first).any(&mut push),
            };
        }
        let next_after = particles.last().filter(|_| more).map(|(_, id)| *id);
        let removed = changes
            .as_ref()
            .map_or_else(Vec::new, |changes| changes.removed().into_iter().filter(is_meant).map(|id| id.0).collect());
        let asked = self.changed_since.is_some();
        Ok(Content::of(
            encoding,
            &Particles {
                time: world.time(),
                revision: asked.then(|| world.revision()),
                full: (asked && changes.is_none()).then_some(true),
                removed: asked.then_some(removed),
                particles: particles.into_iter().map(|(view, _)| view).collect(),
                next_after,
            },
        ))
    }
}

/// Sets properties of many particles
///
/// One value for all, or a list with one for each; without `ids` of every particle of the world. All or none.
#[utoipa::path(patch, path = "/v1/worlds/{world}/particles", tag = "particles", request_body = SetManyBody,
    responses((status = 200, body = Changed, headers(("etag" = String)))))]
async fn set_particles(State(app): State<Arc<App>>, Bulk(change): Bulk) -> Result<Response, Problem> {
    fn read<R: WireReal>(body: &Body) -> Result<Command<R>, Problem> {
        body.read::<Object<SetManyBody<'_>>>()?.0.command()
    }
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => {
        let parsed = app.shared.parse(change.body.clone(), read).await;
        let encoding = change.encoding;
        change.apply(&slot, parsed, many, move |world, command, _| apply_to_many(world, &command, encoding)).await
    })
}

/// Reads a particle
#[utoipa::path(get, path = "/v1/worlds/{world}/particles/{id}", tag = "particles",
    responses((status = 200, body = ParticleView<f64>, headers(("etag" = String)))))]
async fn read_particle(State(app): State<Arc<App>>, read: Read) -> Result<Response, Problem> {
    let any = app.slot(&read.target)?;
    let query = read.query::<NoParameters>().and_then(|_| read.target.particle());
    let encoding = read.encoding;
    with_slot!(any, slot => slot.read(&read, query, |_, _| Cost::default(), move |world, id, _| {
        whole(world, id, encoding)
    }).await)
}

/// Sets properties of a particle
///
/// Position and velocity belong to the integrator: see `impulse` and `place`.
#[utoipa::path(patch, path = "/v1/worlds/{world}/particles/{id}", tag = "particles", request_body = SetOneBody<f64>,
    responses((status = 200, body = ParticleView<f64>, headers(("etag" = String)))))]
async fn set_particle(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    fn read<R: WireReal>(body: &Body, id: ParticleId) -> Result<Command<R>, Problem> {
        body.read::<Object<SetOneBody<R>>>()?.0.command(id)
    }
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => change.apply_to_one(&slot, read).await)
}

/// Removes a particle
///
/// Its id is never used again.
#[utoipa::path(delete, path = "/v1/worlds/{world}/particles/{id}", tag = "particles",
    responses((status = 204, headers(("etag" = String)))))]
async fn remove_particle(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => {
        let command = change.target.particle().map(|id| Command::Remove { ids: id.into() });
        // The first removal makes the table of ids.
        let cost = |world: &World<_>, _: &_| Cost::of(world.particle_count() as u64 / 8);
        change.apply(&slot, command, cost, |world, command, _| {
            world.apply(&command).map_err(|error| Problem::from_engine(error, Shape::Particle))?;
            Ok(Reply::no_content())
        }).await
    })
}

/// Sets the mass or the inverse mass
#[utoipa::path(put, path = "/v1/worlds/{world}/particles/{id}/mass", tag = "particles", request_body = MassBody<f64>,
    responses((status = 200, body = ParticleView<f64>, headers(("etag" = String)))))]
async fn set_mass(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    fn read<R: WireReal>(body: &Body, id: ParticleId) -> Result<Command<R>, Problem> {
        let Object(MassBody { mass, inverse_mass }) = body.read()?;
        let mass = wire::mass(mass, inverse_mass)?
            .ok_or_else(|| Problem::new(Code::MissingField, "give mass or inverse_mass"))?;
        let properties = Properties { mass: Some(Column::Uniform(mass)), ..Properties::default() };
        Ok(Command::Set { ids: id.into(), properties })
    }
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => change.apply_to_one(&slot, read).await)
}

/// Teleports a particle
#[utoipa::path(post, path = "/v1/worlds/{world}/particles/{id}/place", tag = "particles", request_body = PlaceBody<f64>,
    responses((status = 200, body = ParticleView<f64>, headers(("etag" = String)))))]
async fn place_particle(State(app): State<Arc<App>>, change: Change) -> Result<Response, Problem> {
    fn read<R: WireReal>(body: &Body, id: ParticleId) -> Result<Command<R>, Problem> {
        let Object(PlaceBody { position, velocity }) = body.read::<Object<PlaceBody<R>>>()?;
        let column = |vector: Option<Vector<R>>| vector.map(|vector| Column::Uniform(vector.value()));
        Ok(Command::Place { ids: id.into(), position: column(position), velocity: column(velocity) })
    }
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => change.apply_to_one(&slot, read).await)
}

/// Reads particles as columns
///
/// With `changed_since` only those that are not as they were at that revision; then the answer has its own `revision`, to
/// ask from the next time, the ids that were `removed`, and `full` (with everything) where what changed is not known: a
/// world remembers for as long as it is asked now and then.
#[utoipa::path(get, path = "/v1/worlds/{world}/state", tag = "particles",
    params(
        ("fields" = Option<String>, Query, description = "which columns besides the id; default position,velocity", example = "position,velocity"),
        ("ids" = Option<String>, Query, description = "only these, separated by commas: `0,2`"),
        ("changed_since" = Option<u64>, Query, description = "only what changed since this revision"),
    ),
    responses((status = 200, body = wire::State, headers(("etag" = String)))))]
async fn read_state(State(app): State<Arc<App>>, read: Read) -> Result<Response, Problem> {
    let any = app.slot(&read.target)?;
    let query = read.query::<StateQuery>().and_then(Asked::try_from);
    let encoding = read.encoding;
    with_slot!(any, slot => slot.read(&read, query,
        |world, asked| {
            let count = asked.ids.as_ref().map_or(world.particle_count(), Vec::len);
            let cost = Cost::of_columns(world, count, &asked.properties);
            match asked.changed_since {
                None => cost,
                Some(_) => cost.doing(world.particle_count() as u64).asking_history(),
            }
        },
        move |world, asked, _| {
            let Asked { properties, ids, changed_since } = asked;
            let columns = match (&ids, changed_since) {
                (None, None) => Columns::of(world, &properties),
                (Some(ids), None) => {
                    check_there(world, ids)?;
                    Columns::of_ids(ids, &properties)
                }
                (ids, Some(since)) => Columns::since(world, Some(since), ids.as_deref(), &properties),
            };
            let mut composer = Composer::new(encoding);
            composer.columns(world, columns, &app.shared);
            Ok(composer.content())
        }).await)
}

/// Which columns are asked for.
struct Asked {
    properties: Vec<Property>,
    ids: Option<Vec<u64>>,
    changed_since: Option<u64>,
}

impl TryFrom<StateQuery> for Asked {
    type Error = Problem;
    fn try_from(query: StateQuery) -> Result<Self, Problem> {
        Ok(Self {
            properties: match &query.fields {
                None => vec![Property::Position, Property::Velocity],
                Some(fields) => properties(fields)?,
            },
            ids: query.ids.as_deref().map(listed_ids).transpose()?,
            changed_since: query.changed_since,
        })
    }
}

fn check_there<R: WireReal>(world: &World<R>, ids: &[u64]) -> Result<(), Problem> {
    match ids.iter().find(|&&id| !world.contains(ParticleId(id))) {
        Some(id) => Err(Problem::new(Code::UnknownParticle, format!("there is no particle {id} in this world"))),
        None => Ok(()),
    }
}
