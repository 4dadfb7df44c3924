//! Several commands in one request: as one change of a world, and for many worlds side by side.

use std::collections::{HashMap, HashSet};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use axum::extract::State;
use axum::response::{IntoResponse, Response};
use serde::de::{Deserializer, Error as _, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use tokio::task::JoinSet;
use utoipa::ToSchema;
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::command::{Advance, Advanced, Command, Outcome, Selection};
use crate::error::{Error, Limit};
use crate::ids::ParticleId;
use crate::server::App;
use crate::server::body::{Body, Raw};
use crate::server::columns::{self, Columns};
use crate::server::config::{COMMANDS_MAX, Config, WORLDS_MAX};
use crate::server::content::Composer;
use crate::server::encoding::Encoding;
use crate::server::extract::{Bulk, Change, NoParameters};
use crate::server::json::{self, Named, Object, Vector, WireReal, column, present};
use crate::server::memory::PARTICLE_BYTES;
use crate::server::problem::{Code, Problem, ProblemBody, Shape};
use crate::server::reply::Reply;
use crate::server::routes::advance::{self, AdvanceBody, AdvancedBody, bytes_of_copies, check_duration};
use crate::server::routes::forces::ForcesBody;
use crate::server::routes::particles::{CreateBody, New, read_new};
use crate::server::slot::{Cost, Shared, with_slot};
use crate::server::wire::{self, Created, Property, SetManyBody, VectorColumn, optional_column, selection};
use crate::world::{Keep, Part, World};

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new().routes(routes!(run_commands)).routes(routes!(run_commands_in_worlds))
}

/// Commands that are one change.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Commands, example = json!({"commands": [
    {"create": {"position": [0.0, 1.0, 0.0]}}, {"add_force": {"ids": [0], "force": [1.0, 0.0, 0.0]}},
    {"advance": {"duration": 0.016}}, {"read": {"fields": ["position"], "ids": [0]}}
]}))]
struct CommandsBody<'a> {
    /// Carried out in this order.
    #[serde(borrow)]
    #[schema(value_type = Vec<CommandSchema<'a>>)]
    commands: Vec<CommandBody<'a>>,
}

/// A command: exactly one of these.
#[derive(ToSchema)]
#[schema(as = Command, min_properties = 1, max_properties = 1, example = json!({"advance": {"duration": 0.016}}))]
#[expect(dead_code, reason = "stands for a command in the description")]
struct CommandSchema<'a> {
    #[schema(nullable = false)]
    create: Option<CreateBody<'a>>,
    #[schema(nullable = false)]
    place: Option<PlacesBody<'a>>,
    #[schema(nullable = false)]
    set: Option<SetManyBody<'a>>,
    #[schema(nullable = false)]
    add_force: Option<ForcesBody<'a>>,
    #[schema(nullable = false)]
    impulse: Option<ImpulsesBody<'a>>,
    #[schema(nullable = false)]
    remove: Option<RemovalBody>,
    /// Without `dry_run`.
    #[schema(nullable = false)]
    advance: Option<AdvanceBody>,
    #[schema(nullable = false)]
    read: Option<ReadBody>,
}

/// A command as it stands in the body.
#[derive(Debug)]
struct CommandBody<'a> {
    /// `None`: it has no member, or several.
    only: Option<(Kind, Raw<'a>)>,
}

/// What a command does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(field_identifier, rename_all = "snake_case")]
enum Kind {
    Create,
    Place,
    Set,
    AddForce,
    Impulse,
    Remove,
    Advance,
    Read,
}

impl Kind {
    const ALL: [Self; 8] =
        [Self::Create, Self::Place, Self::Set, Self::AddForce, Self::Impulse, Self::Remove, Self::Advance, Self::Read];

    /// As the request calls it.
    fn name(self) -> &'static str {
        match self {
            Self::Create => "create",
            Self::Place => "place",
            Self::Set => "set",
            Self::AddForce => "add_force",
            Self::Impulse => "impulse",
            Self::Remove => "remove",
            Self::Advance => "advance",
            Self::Read => "read",
        }
    }
}

impl<'de: 'a, 'a> Deserialize<'de> for CommandBody<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Members;
        impl<'de> Visitor<'de> for Members {
            type Value = CommandBody<'de>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<CommandBody<'de>, A::Error> {
                let (mut given, mut only) = ([false; Kind::ALL.len()], None);
                while let Some(kind) = map.next_key::<Kind>()? {
                    if std::mem::replace(&mut given[kind as usize], true) {
                        return Err(A::Error::duplicate_field(kind.name()));
                    }
                    only = Some((kind, map.next_value()?));
                }
                let is_one = given.iter().filter(|given| **given).count() == 1;
                Ok(CommandBody { only: only.filter(|_| is_one) })
            }
        }
        deserializer.deserialize_map(Members)
    }
}

/// Teleports: positions, velocities or both; one vector for all of the particles, or a list with one for each.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Places, example = json!({"ids": [0], "position": [[0.0, 1.0, 0.0]]}))]
struct PlacesBody<'a> {
    /// Which particles, in the order of the lists; absent: all, in ascending order of id.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false)]
    ids: Option<Vec<u64>>,
    /// In metres; absent: they stay.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorColumn>, nullable = false)]
    position: Option<Raw<'a>>,
    /// In m/s; absent: they stay.
    #[serde(borrow, default, deserialize_with = "present")]
    #[schema(value_type = Option<VectorColumn>, nullable = false)]
    velocity: Option<Raw<'a>>,
}

/// Impulses for many particles: one vector for all of them, or a list with one for each.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Impulses, example = json!({"ids": [0], "impulse": [1.0, 0.0, 0.0]}))]
struct ImpulsesBody<'a> {
    /// Which particles, in the order of the list; absent: all, in ascending order of id.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false)]
    ids: Option<Vec<u64>>,
    /// In newton seconds.
    #[serde(borrow)]
    #[schema(value_type = VectorColumn)]
    impulse: Raw<'a>,
}

/// Particles to remove.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = Removal, example = json!({"ids": [0]}))]
struct RemovalBody {
    /// Each once. They cannot be left out, as they can elsewhere: a slip would empty the world.
    ids: Vec<u64>,
}

/// What to read in the middle of a batch.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ReadColumns, example = json!({"fields": ["position"], "ids": [0]}))]
struct ReadBody {
    /// Which columns besides the id; default position and velocity.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<Vec<String>>, schema_with = wire::properties_schema, required = false)]
    fields: Option<Vec<Named<Property>>>,
    /// Which particles, in this order; absent: all, in ascending order of id.
    #[serde(default, deserialize_with = "present")]
    #[schema(nullable = false)]
    ids: Option<Vec<u64>>,
}

/// What the commands did, in their order.
#[derive(ToSchema)]
#[schema(as = CommandResults, example = json!({
    "results": [{"first_id": 0, "count": 1}, {"count": 1}, {"time": 0.016, "count": 1, "id": [0], "position": [[0.0, 1.0, 0.0]]}],
    "revision": 1
}))]
#[expect(dead_code, reason = "stands for the answer in the description")]
struct Results {
    results: Vec<CommandResult>,
    /// One further, if anything was changed.
    revision: u64,
}

/// What a command did: ids of created particles, the report of an advance, the columns of a read, or a count.
#[derive(ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for the result in the description")]
enum CommandResult {
    Created(Created),
    Advanced(AdvancedBody),
    Read(wire::State),
    // Last: who tries one shape after the other, and ignores members that it does not know, finds a count in others too.
    Changed(Counted),
}

/// How many particles a command spoke of.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"count": 3}))]
struct Counted {
    count: usize,
}

/// Commands for many worlds.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = CommandsOfWorlds, example = json!({"worlds": {
    "demo": {"commands": [{"advance": {"duration": 0.016}}, {"read": {"fields": ["position"]}}]}
}}))]
struct WorldsBody<'a> {
    /// By name.
    #[serde(borrow)]
    #[schema(value_type = HashMap<String, CommandsBody<'a>>)]
    worlds: ByName<'a>,
}

/// What the commands did in each world, in the order of the request: results, or a problem.
#[derive(ToSchema)]
#[schema(as = ResultsOfWorlds, example = json!({"worlds": {
    "a": {"results": [{"count": 1}], "revision": 4},
    "b": {"type": "/problems/unknown_world", "title": "Unknown world", "status": 404, "code": "unknown_world",
        "detail": "there is no world \"b\"; create it with PUT /v1/worlds/{world}", "pointer": "/worlds/b"}
}}))]
#[expect(dead_code, reason = "stands for the answer in the description")]
struct WorldsAnswer {
    worlds: HashMap<String, WorldAnswer>,
}

#[derive(ToSchema)]
#[schema(as = ResultsOrProblem)]
#[serde(untagged)]
#[expect(dead_code, reason = "stands for the answer in the description")]
enum WorldAnswer {
    Results(Results),
    Problem(ProblemBody<'static>),
}

/// The members of an object as they stand in the body, in their order; none twice.
#[derive(Debug)]
struct ByName<'a>(Vec<(String, Raw<'a>)>);

impl<'de: 'a, 'a> Deserialize<'de> for ByName<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Members;
        impl<'de> Visitor<'de> for Members {
            type Value = ByName<'de>;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object with a world in each member")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ByName<'de>, A::Error> {
                let (mut members, mut names) = (Vec::new(), HashSet::new());
                while let Some((name, value)) = map.next_entry::<String, Raw<'de>>()? {
                    if !names.insert(name.clone()) {
                        return Err(A::Error::custom(format_args!("duplicate field `{name}`")));
                    }
                    members.push((name, value));
                }
                Ok(ByName(members))
            }
        }
        deserializer.deserialize_map(Members)
    }
}

/// Runs several commands as one change
///
/// In their order, all or none: when one is refused the world is as it was, and the pointer leads to that command. The
/// revision grows by one, and by none when the commands only read. Their advances together may cost what one may.
#[utoipa::path(post, path = "/v1/worlds/{world}/commands", tag = "commands", request_body = CommandsBody,
    responses((status = 200, body = Results, headers(("etag" = String)))))]
async fn run_commands(State(app): State<Arc<App>>, Bulk(change): Bulk) -> Result<Response, Problem> {
    run(&app, &change).await.map(IntoResponse::into_response)
}

/// Runs commands in many worlds
///
/// As one change in each, with results or a problem for each; what is refused in one world changes nothing in the others.
/// Worlds run side by side. With an `Idempotency-Key`, sent again, the worlds that were changed answer as before and only
/// the others run.
#[utoipa::path(post, path = "/v1/commands", tag = "commands", request_body = WorldsBody,
    responses((status = 200, body = WorldsAnswer)))]
async fn run_commands_in_worlds(State(app): State<Arc<App>>, Bulk(change): Bulk) -> Result<Response, Problem> {
    if let Some(Err(problem)) = &change.key {
        return Err(problem.clone());
    }
    let held = Arc::clone(&app);
    let parsed = app.shared.parse(change.body.clone(), move |body| worlds(body, &held.config)).await;
    if let Err(problem) = &parsed
        && problem.is_malformed()
    {
        return Err(problem.clone());
    }
    change.preconditions.check_many()?;
    let worlds = parsed?;
    change.query::<NoParameters>()?;
    let mut names = Vec::with_capacity(worlds.len());
    // Dropped with the request of a client that goes away, and all of them with it.
    let mut running = JoinSet::new();
    for (index, (name, body)) in worlds.into_iter().enumerate() {
        let (app, part) = (Arc::clone(&app), change.of_world(&name, body));
        running.spawn(async move { (index, run(&app, &part).await) });
        names.push(name);
    }
    let mut answers: Vec<_> = names.iter().map(|_| Err(Problem::plain(Code::InternalError))).collect();
    while let Some(ended) = running.join_next().await {
        match ended {
            Ok((index, answer)) => answers[index] = answer,
            // That of a world which is quarantined now; the others do not pay for it.
            Err(error) => tracing::error!(%error, "panic"),
        }
    }
    Ok(of_worlds(&names, answers, change.encoding).coded(change.coding, &app.shared).into_response())
}

/// The commands of each world, without a copy.
fn worlds(body: &Body, config: &Config) -> Result<Vec<(String, Body)>, Problem> {
    let Object(WorldsBody { worlds: ByName(worlds) }) = body.read()?;
    check_objects(body, config)?;
    if worlds.len() > config.worlds_max {
        let detail =
            format!("{} worlds are more than there may be, {} (--{WORLDS_MAX})", worlds.len(), config.worlds_max);
        return Err(Problem::at(Code::LimitReached, "/worlds", detail));
    }
    Ok(worlds.into_iter().map(|(name, raw)| (name, body.part(raw))).collect())
}

/// One answer of the answers of all worlds, which are not copied.
fn of_worlds(names: &[String], answers: Vec<Result<Reply, Problem>>, encoding: Encoding) -> Reply {
    let is_replayed =
        !answers.is_empty() && answers.iter().flatten().filter(|reply| reply.is_replayed).count() == answers.len();
    let mut composer = Composer::new(encoding);
    composer.writer.begin_map(1);
    composer.writer.key("worlds");
    composer.writer.begin_map(names.len());
    for (name, answer) in names.iter().zip(answers) {
        composer.writer.key(name);
        match answer {
            Ok(reply) => composer.append(reply.content),
            Err(problem) => composer.writer.value(&problem.under(&format!("/worlds{}", json::member(name))).wire()),
        }
    }
    composer.writer.end_map();
    composer.writer.end_map();
    let reply = Reply::of(composer.content());
    if is_replayed { reply.replayed() } else { reply }
}

/// Changes the world of the path by the commands of the body.
pub(crate) async fn run(app: &Arc<App>, change: &Change) -> Result<Reply, Problem> {
    let any = app.slot(&change.target)?;
    with_slot!(any, slot => {
        let held = Arc::clone(app);
        let parsed = app.shared.parse(change.body.clone(), move |body| Batch::read(body, &held.config)).await;
        let parsed = parsed.and_then(|batch| change.query::<NoParameters>().map(|_| batch));
        let (app, encoding) = (Arc::clone(app), change.encoding);
        slot.change(change, parsed, |world, batch: &Batch<_>| batch.cost(world), move |world, batch, cancelled| {
            batch.run(&app, world, encoding, cancelled)
        }).await
    })
}

/// Commands, read.
struct Batch<R: WireReal> {
    items: Vec<Item<R>>,
}

struct Item<R: WireReal> {
    kind: Kind,
    task: Task<R>,
    shape: Shape,
}

enum Task<R: WireReal> {
    Change(Command<R>),
    Advance(Advance, Option<Vec<Property>>),
    Read(Option<Vec<u64>>, Vec<Property>),
}

impl CommandBody<'_> {
    fn item<R: WireReal>(&self, config: &Config) -> Result<Item<R>, Problem> {
        let Some((kind, raw)) = self.only else {
            let names = Kind::ALL.map(Kind::name).join(", ");
            return Err(Problem::at(Code::InvalidField, "", format!("a command has one member, one of {names}")));
        };
        let (task, shape) = kind.read(raw, config).map_err(|problem| problem.under(&format!("/{}", kind.name())))?;
        Ok(Item { kind, task, shape })
    }
}

impl Kind {
    fn read<R: WireReal>(self, raw: Raw<'_>, config: &Config) -> Result<(Task<R>, Shape), Problem> {
        let command = match self {
            Self::Create => {
                let New { particles, shape } = read_new(raw, config.particles_max)?;
                return Ok((Task::Change(Command::Create(particles)), shape));
            }
            Self::Place => {
                let Object(PlacesBody { ids, position, velocity }) = raw.read("")?;
                Command::Place {
                    ids: selection(ids),
                    position: optional_column::<Vector<R>>(position, "position")?,
                    velocity: optional_column::<Vector<R>>(velocity, "velocity")?,
                }
            }
            Self::Set => raw.read::<Object<SetManyBody<'_>>>("")?.0.command()?,
            Self::AddForce => raw.read::<Object<ForcesBody<'_>>>("")?.0.command()?,
            Self::Impulse => {
                let Object(ImpulsesBody { ids, impulse }) = raw.read("")?;
                Command::Impulse { ids: selection(ids), impulse: column::<Vector<R>>(impulse, "impulse")? }
            }
            Self::Remove => {
                let Object(RemovalBody { ids }) = raw.read("")?;
                Command::Remove { ids: selection(Some(ids)) }
            }
            Self::Advance => {
                let (advance, properties) = raw.read::<Object<AdvanceBody>>("")?.0.in_batch()?;
                return Ok((Task::Advance(advance, properties), Shape::World));
            }
            Self::Read => {
                let Object(ReadBody { fields, ids }) = raw.read("")?;
                let fields = fields.map_or_else(|| vec![Property::Position, Property::Velocity], wire::named);
                return Ok((Task::Read(ids, fields), Shape::Columns));
            }
        };
        Ok((Task::Change(command), Shape::Columns))
    }
}

/// Refuses more objects than particles and commands can be, before they take more memory than their text.
fn check_objects(body: &Body, config: &Config) -> Result<(), Problem> {
    let (asked, most) = (body.objects(), config.objects_max());
    if asked > most {
        let detail = format!("the body has {asked} objects, more than {most} (--{COMMANDS_MAX}, --particles-max)");
        return Err(Problem::new(Code::LimitReached, detail));
    }
    Ok(())
}

fn place_of(index: usize) -> String {
    format!("/commands/{index}")
}

impl<R: WireReal> Batch<R> {
    fn read(body: &Body, config: &Config) -> Result<Self, Problem> {
        if let Err(problem) = check_objects(body, config) {
            body.read::<serde::de::IgnoredAny>()?;
            return Err(problem);
        }
        let Object(CommandsBody { commands }) = body.read()?;
        let (asked, most) = (commands.len(), config.commands_max);
        if asked > most {
            let detail = format!("{asked} commands are more than a batch may have, {most} (--{COMMANDS_MAX})");
            return Err(Problem::at(Code::LimitReached, "/commands", detail));
        }
        let mut items = Vec::with_capacity(asked);
        let mut duration = 0.0;
        for (index, command) in commands.iter().enumerate() {
            let item = command.item::<R>(config).and_then(|item| {
                if let Task::Advance(advance, _) = &item.task {
                    duration += advance.duration;
                    check_duration(duration, config, "/advance/duration")?;
                }
                Ok(item)
            });
            items.push(item.map_err(|problem| problem.under(&place_of(index)))?);
        }
        Ok(Self { items })
    }

    /// How much of the world has to be kept until the end. Where the particles stay, a read can be told to succeed.
    fn keep(&self, world: &World<R>) -> Keep {
        let stay = !self
            .items
            .iter()
            .any(|item| matches!(item.task, Task::Change(Command::Create(_) | Command::Remove { .. })));
        let there = |ids: &[u64]| stay && ids.iter().all(|id| world.contains(ParticleId(*id)));
        Keep::of(self.items.iter().map(|item| match &item.task {
            Task::Change(command) => Part::of(command),
            Task::Advance(..) => Part::Change { adds_forces: false },
            Task::Read(ids, _) => Part::Read { can_fail: ids.as_ref().is_some_and(|ids| !there(ids)) },
        }))
    }

    /// Estimated before anything is done: from the particles there are, and those that are created.
    fn cost(&self, world: &World<R>) -> Cost {
        let there = world.particle_count() as u64;
        let (mut created, mut work, mut numbers, mut copied) = (0_u64, 0_u64, 0_u64, 0_u64);
        // Whether an advance may cost more than it would have at first.
        let mut is_settled = true;
        for item in &self.items {
            let count = there.saturating_add(created);
            let all_or = |ids: &Selection| match ids {
                Selection::All => count,
                Selection::Ids(ids) => ids.len() as u64,
            };
            let (done, written) = match &item.task {
                Task::Change(command) => {
                    is_settled &= matches!(command, Command::AddForce { .. });
                    let done = match command {
                        Command::Create(new) => {
                            created = created.saturating_add(new.count as u64);
                            new.count as u64
                        }
                        // A value that differs promotes a column, a removal makes the table of ids.
                        Command::Place { ids, .. }
                        | Command::Set { ids, .. }
                        | Command::AddForce { ids, .. }
                        | Command::Impulse { ids, .. }
                        | Command::Remove { ids } => all_or(ids).saturating_add(count / 8),
                        Command::Advance(_) | Command::Configure(_) => 0,
                    };
                    (done, 4)
                }
                Task::Advance(advance, properties) => {
                    // The particle that it waits for may be one of those created.
                    let advance = Advance { until: None, ..*advance };
                    copied = copied.max(bytes_of_copies(world, &advance, count));
                    let more = created + u64::from(!is_settled);
                    // After a removal it may be within the limits.
                    let is_over = matches!(world.plan(&advance), Err(Error::LimitReached { .. }));
                    let done = if is_over { u64::MAX } else { world.work_with(&advance, more) };
                    is_settled = false;
                    (done, 20 + columns::numbers(count, properties.as_deref().unwrap_or_default()))
                }
                Task::Read(ids, properties) => {
                    let count = ids.as_ref().map_or(count, |ids| ids.len() as u64);
                    (0, 4 + columns::numbers(count, properties))
                }
            };
            work = work.saturating_add(done).saturating_add(written);
            numbers = numbers.saturating_add(written);
        }
        let kept = match self.keep(world) {
            Keep::Nothing => 0,
            Keep::Forces => size_of::<[R; 3]>() as u64,
            Keep::Everything => PARTICLE_BYTES,
        };
        let bytes = there.saturating_mul(kept).saturating_add(created.saturating_mul(PARTICLE_BYTES));
        let work = work.saturating_add(if kept == PARTICLE_BYTES { there } else { 0 });
        Cost { bytes: bytes.saturating_add(copied), ..Cost::of(work).answering(numbers) }
    }

    fn run(
        self,
        app: &App,
        world: &mut World<R>,
        encoding: Encoding,
        cancelled: &AtomicBool,
    ) -> Result<Reply, Problem> {
        let mut answer = Answer { composer: Composer::new(encoding), shared: &app.shared, advances: Vec::new() };
        answer.composer.writer.begin_map(2);
        answer.composer.writer.key("results");
        answer.composer.writer.begin_list(self.items.len());
        world.keeping(self.keep(world), |world| {
            self.items.into_iter().enumerate().try_for_each(|(index, item)| {
                let name = item.kind.name();
                answer.composer.writer.item();
                let done = item.run(world, cancelled, &mut answer);
                done.map_err(|problem| problem.under(&format!("{}/{name}", place_of(index))))
            })
        })?;
        let Answer { mut composer, advances, .. } = answer;
        for advanced in &advances {
            app.metrics.advanced(advanced);
        }
        composer.writer.end_list();
        composer.writer.key("revision");
        composer.writer.value(&world.revision());
        composer.writer.end_map();
        Ok(Reply::of(composer.content()))
    }
}

/// What is answered as the commands are done.
struct Answer<'a> {
    composer: Composer,
    shared: &'a Arc<Shared>,
    advances: Vec<Advanced>,
}

impl<R: WireReal> Item<R> {
    fn run(self, world: &mut World<R>, cancelled: &AtomicBool, answer: &mut Answer<'_>) -> Result<(), Problem> {
        let shape = self.shape;
        let apply = |world: &mut World<R>, command: &Command<R>| {
            // Only an advance looks itself.
            if cancelled.load(Ordering::Relaxed) {
                return Err(Problem::from_engine(Error::Cancelled, shape));
            }
            world.apply_in_batch(command, cancelled).map_err(|error| {
                let problem = if let Command::Advance(advance) = command {
                    advance::refused(error, advance)
                } else {
                    Problem::from_engine(error, shape)
                };
                let is_shared = matches!(error, Error::LimitReached { limit, .. } if limit != Limit::Particles);
                if is_shared { problem.adding("; the advances of a batch share the limits of one") } else { problem }
            })
        };
        let Answer { composer, shared, advances } = answer;
        match self.task {
            Task::Change(command) => match apply(world, &command)? {
                Outcome::Created { first, count } => composer.writer.value(&Created { first_id: first.0, count }),
                Outcome::Changed { count } => composer.writer.value(&Counted { count }),
                Outcome::Advanced(_) | Outcome::Configured => unreachable!("it is neither"),
            },
            Task::Advance(advance, properties) => {
                let Outcome::Advanced(advanced) = apply(world, &Command::Advance(advance))? else {
                    unreachable!("an advance answers with what it advanced")
                };
                advances.push(advanced);
                let body = AdvancedBody::new(&advanced, world, advance.report_error);
                body.write(world, properties.as_deref(), shared, composer);
            }
            Task::Read(None, properties) => composer.columns(world, Columns::of(world, &properties), shared),
            Task::Read(Some(ids), properties) => {
                if let Some(index) = ids.iter().position(|id| !world.contains(ParticleId(*id))) {
                    let unknown = Error::UnknownParticle { id: ParticleId(ids[index]), index };
                    return Err(Problem::from_engine(unknown, shape));
                }
                composer.columns(world, Columns::of_ids(&ids, &properties), shared);
            }
        }
        Ok(())
    }
}
