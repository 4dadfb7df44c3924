//! `/v1/worlds/{world}/snapshot`: a world as bytes, and back.

use std::borrow::Cow;
use std::io;
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::{FromRequest, FromRequestParts, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use mediatype::MediaType;
use tokio::sync::mpsc;
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::error::{Error, Limits};
use crate::real::Precision;
use crate::registry::Refused;
use crate::server::App;
use crate::server::config::SNAPSHOT_BYTES_MAX;
use crate::server::content::{self, Content};
use crate::server::encoding::{self, Encoding};
use crate::server::extract::{self, Change, NoParameters, Preconditions, Read, Reading, Unread};
use crate::server::idempotency::{IDEMPOTENCY_KEY, Key};
use crate::server::json::WireReal;
use crate::server::memory::{Charge, PARTICLE_BYTES, PIECE_BYTES, RESTORED_BYTES};
use crate::server::openapi::binary;
use crate::server::problem::{Code, Problem, Shape};
use crate::server::reply::Reply;
use crate::server::routes::worlds::{check_name, too_many_worlds};
use crate::server::slot::{AnySlot, Cost, Slot, with_slot};
use crate::server::wire::Description;
use crate::world::{Snapshot, SnapshotError, World};

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new().routes(routes!(snapshot_world, restore_world))
}

const SNAPSHOT: HeaderValue = HeaderValue::from_static("application/octet-stream");

/// A snapshot in the description.
struct SnapshotBody;

impl PartialSchema for SnapshotBody {
    fn schema() -> RefOr<Schema> {
        RefOr::T(binary("A snapshot of a world, as GET gives it."))
    }
}

impl ToSchema for SnapshotBody {
    fn name() -> Cow<'static, str> {
        Cow::Borrowed("Snapshot")
    }
}

/// A request for a snapshot.
struct Ask(Read);

impl FromRequestParts<Arc<App>> for Ask {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<App>) -> Result<Self, Problem> {
        if !encoding::is_accepted(&parts.headers, "application/octet-stream") {
            return Err(Problem::plain(Code::NotAcceptable));
        }
        Read::of(parts, Encoding::default(), state).await.map(Self)
    }
}

/// A request that brings one, in the pieces in which it arrived.
struct Upload {
    /// Without a body.
    change: Change,
    pieces: Vec<Bytes>,
}

impl FromRequest<Arc<App>> for Upload {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &Arc<App>) -> Result<Self, Problem> {
        let (mut parts, body) = request.into_parts();
        let encoding = Encoding::accepted(&parts.headers)?;
        check_content(&parts.headers)?;
        let target = extract::target(&mut parts, state).await?;
        let mut charge = Charge::none(&state.shared.in_flight);
        let limit = state.config.snapshot_bytes_max;
        let reading = Reading { limit, byte_bytes: RESTORED_BYTES, piece_bytes: PIECE_BYTES };
        let refused = |unread| match unread {
            Unread::TooLarge => {
                let detail = format!("the snapshot is larger than {limit} bytes (--{SNAPSHOT_BYTES_MAX})");
                Problem::new(Code::BodyTooLarge, detail)
            }
            Unread::CutShort => Problem::new(Code::MalformedSnapshot, "the body was cut short"),
        };
        let mut pieces = Vec::new();
        reading.each_piece(state, &parts.headers, body, &mut charge, refused, |piece, _| pieces.push(piece)).await?;
        let preconditions = Preconditions::new(&parts.headers);
        let (uri, bytes) = (parts.uri.clone(), pieces.iter().map(Bytes::len).sum());
        let (key, pieces) = if parts.headers.contains_key(IDEMPOTENCY_KEY) {
            let key = move || {
                let key = Key::of(&parts.method, &parts.uri, &parts.headers, encoding, &pieces);
                Ok((key.transpose(), pieces))
            };
            state.shared.run_on_bytes(bytes, key).await?
        } else {
            (None, pieces)
        };
        let change = Change { target, preconditions, key, encoding, uri, charge: Some(charge), ..Change::default() };
        Ok(Self { change, pieces })
    }
}

/// Takes a snapshot of a world
///
/// Everything that determines its future, as bytes with a checksum: whatever it is restored into goes on with the same
/// bits. Settings, clock and step count are in it, the name and the revision are not. The form is that of this version
/// of the service; a later one may know it no more, and then says so.
#[utoipa::path(get, path = "/v1/worlds/{world}/snapshot", tag = "worlds",
    responses((status = 200, body = SnapshotBody, content_type = "application/octet-stream", headers(("etag" = String)))))]
async fn snapshot_world(State(app): State<Arc<App>>, Ask(read): Ask) -> Result<Response, Problem> {
    let any = app.slot(&read.target)?;
    let query = read.query::<NoParameters>();
    // It is written as it is sent, of the world as it was.
    let cost = |held: u64| Cost { held, ..Cost::default() };
    with_slot!(any, slot => {
        let place = app.shared.snapshot_places.take().await?;
        let seen = slot.look(&read, query, |world, _| cost(world.bytes()), |world, _, _| Ok(world.clone())).await?;
        let (revision, Some((world, charge))) = seen else {
            return Ok(Reply::not_modified().at(seen.0).into_response());
        };
        let (sender, receiver) = mpsc::channel(1);
        std::thread::Builder::new()
            .name("snapshot".to_owned())
            .spawn(move || {
                let sent = world.snapshot(Sink(sender));
                drop((place, charge));
                sent
            })
            .map_err(|_| Problem::new(Code::Overloaded, "there is no thread for the snapshot; try again later"))?;
        let mut response = Reply::of(Content::empty()).at(revision).into_response();
        *response.body_mut() = Body::new(content::Pieces(receiver));
        response.headers_mut().insert(header::CONTENT_TYPE, SNAPSHOT);
        Ok(response)
    })
}

/// Sends what is written to it.
struct Sink(mpsc::Sender<io::Result<Bytes>>);

impl io::Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let piece = Ok(Bytes::copy_from_slice(bytes));
        self.0.blocking_send(piece).map_err(|_| io::Error::from(io::ErrorKind::BrokenPipe))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Sink {
    fn drop(&mut self) {
        // What was sent so far must not look like the whole.
        if std::thread::panicking() {
            let _gone = self.0.blocking_send(Err(io::Error::other("a defect interrupted the snapshot")));
        }
    }
}

/// Restores a world
///
/// From a snapshot, as GET gives it: it has the future of the world that this was taken of, to the bit. Where there is
/// no world of this name it is created (201): a clone. Where there is one it is replaced (200) as one change, in its turn:
/// its revision grows by one, whatever that of the other was. A world keeps its precision: a snapshot of another one is
/// refused.
#[utoipa::path(put, path = "/v1/worlds/{world}/snapshot", tag = "worlds",
    request_body(content = SnapshotBody, content_type = "application/octet-stream"),
    responses(
        (status = 200, body = Description<f64>, description = "Replaced", headers(("etag" = String))),
        (status = 201, body = Description<f64>, description = "Created",
            headers(("location" = String), ("etag" = String))),
    ))]
async fn restore_world(State(app): State<Arc<App>>, upload: Upload) -> Result<Response, Problem> {
    let Upload { change, pieces } = upload;
    match app.worlds.get(&change.target.world) {
        Some(any) => with_slot!(any, slot => {
            let restored = restore(&app, pieces).await;
            replace(&slot, &change, restored).await
        }),
        None => create(&app, &change, pieces).await,
    }
}

/// Restores a world of the precision that is asked for.
async fn restore<R: WireReal>(app: &App, pieces: Vec<Bytes>) -> Result<World<R>, Problem> {
    let bytes = pieces.iter().map(Bytes::len).sum();
    let limits = app.config.limits();
    app.shared.run_on_bytes(bytes, move || restored(Snapshot::open(Pieces::new(pieces)), limits)).await
}

fn restored<R: WireReal>(
    snapshot: Result<Snapshot<Pieces>, SnapshotError>,
    limits: Limits,
) -> Result<World<R>, Problem> {
    snapshot.and_then(|snapshot| snapshot.restore(limits)).map_err(|error| refused(&error))
}

fn refused(error: &SnapshotError) -> Problem {
    match error {
        SnapshotError::Refused(error @ Error::LimitReached { .. }) => Problem::from_engine(*error, Shape::World),
        SnapshotError::UnknownVersion(_) => Problem::new(Code::UnsupportedSnapshotVersion, error.to_string()),
        SnapshotError::OtherPrecision(_) => {
            let detail = format!("{error}, and the world that it would replace is not; restore it under another name");
            Problem::new(Code::PrecisionMismatch, detail)
        }
        SnapshotError::Source(_)
        | SnapshotError::NotASnapshot
        | SnapshotError::CutShort
        | SnapshotError::TrailingBytes
        | SnapshotError::ChecksumMismatch
        | SnapshotError::Inconsistent(_)
        | SnapshotError::Refused(_) => Problem::new(Code::MalformedSnapshot, error.to_string()),
    }
}

/// A world in the place of another, in its turn.
async fn replace<R: WireReal>(
    slot: &Arc<Slot<R>>,
    change: &Change,
    restored: Result<World<R>, Problem>,
) -> Result<Response, Problem> {
    let (name, encoding) = (change.target.world.clone(), change.encoding);
    let cost = |world: &World<R>, new: &World<R>| {
        let bytes = new.particle_count() as u64 * PARTICLE_BYTES;
        Cost { bytes, ..Cost::of(world.particle_count() as u64) }
    };
    change
        .apply(slot, restored, cost, move |world, new, _| {
            world.replace_by(new);
            Ok(Reply::ok(encoding, &Description::new(&name, world)))
        })
        .await
}

async fn create(app: &App, change: &Change, pieces: Vec<Bytes>) -> Result<Response, Problem> {
    let key = change.key.as_ref().map(|key| key.as_ref().map_err(Clone::clone)).transpose()?;
    let precision = Snapshot::open(Pieces::new(pieces.clone())).map(|snapshot| snapshot.precision());
    match precision {
        Ok(Precision::Single) => insert(app, change, key, restore(app, pieces).await, AnySlot::Single),
        Ok(Precision::Double) => insert(app, change, key, restore(app, pieces).await, AnySlot::Double),
        Err(error) => insert::<f64>(app, change, key, Err(refused(&error)), AnySlot::Double),
    }
}

fn insert<R: WireReal>(
    app: &App,
    change: &Change,
    key: Option<&Key>,
    restored: Result<World<R>, Problem>,
    any: impl FnOnce(Arc<Slot<R>>) -> AnySlot,
) -> Result<Response, Problem> {
    let name = &change.target.world;
    if let Err(problem) = &restored
        && problem.code == Code::MalformedSnapshot
    {
        return Err(problem.clone());
    }
    change.preconditions.check_absent()?;
    let mut world = restored?;
    change.query::<NoParameters>()?;
    check_name(name)?;
    world.set_threads(&app.shared.threads);
    let answer = Reply::ok(change.encoding, &Description::new(name, &world));
    let reply = answer.created(Some(format!("/v1/worlds/{name}"))).at(0);
    let slot = Arc::new(Slot::new(name, world, &app.shared));
    slot.charge_first()?;
    if let Some(key) = key {
        slot.keep_first(key, &reply)?;
    }
    app.worlds.insert(name, any(slot)).map_err(|refused| match refused {
        Refused::Exists => {
            let detail = format!("a world {name:?} was created meanwhile; send the snapshot again to replace it");
            Problem::new(Code::WorldExists, detail)
        }
        Refused::Full => too_many_worlds(app),
    })?;
    Ok(reply.into_response())
}

/// A snapshot says so, or says nothing, or comes from a plain `curl --data-binary`.
fn check_content(headers: &HeaderMap) -> Result<(), Problem> {
    extract::check_coding(headers)?;
    let Some(content_type) = headers.get(header::CONTENT_TYPE) else { return Ok(()) };
    let is_read = |media: MediaType<'_>| {
        media.ty == "application" && (media.subty == "octet-stream" || media.subty == "x-www-form-urlencoded")
    };
    if content_type.is_empty() || content_type.to_str().is_ok_and(|text| MediaType::parse(text).is_ok_and(is_read)) {
        return Ok(());
    }
    let detail = format!("a snapshot of type {content_type:?} is not read; send application/octet-stream");
    Err(Problem::new(Code::UnsupportedMediaType, detail))
}

/// Pieces one after the other; each is given back when it is read.
struct Pieces {
    rest: std::vec::IntoIter<Bytes>,
    first: Bytes,
}

impl Pieces {
    fn new(pieces: Vec<Bytes>) -> Self {
        Self { rest: pieces.into_iter(), first: Bytes::new() }
    }
}

impl io::Read for Pieces {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        while self.first.is_empty() {
            let Some(next) = self.rest.next() else { return Ok(0) };
            self.first = next;
        }
        let len = into.len().min(self.first.len());
        into[..len].copy_from_slice(&self.first.split_to(len));
        Ok(len)
    }
}
