//! `GET /v1/worlds/{world}/stream`: a world followed live, as server-sent events, lines of JSON, or over a WebSocket.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade};
use axum::extract::{FromRequestParts, Request, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use serde::Deserialize;
use tokio::sync::mpsc;
use tokio::time::{Instant, timeout};
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::server::App;
use crate::server::body::Body;
use crate::server::config::SMALL_BODY_BYTES_MAX;
use crate::server::content::{Content, Pieces};
use crate::server::encoding::Encoding;
use crate::server::extract::{Change, Target, query, target};
use crate::server::follow::{Follower, Interest};
use crate::server::json::{Choice, Named, WireReal};
use crate::server::problem::{Code, Problem};
use crate::server::routes::commands;
use crate::server::routes::particles::listed_ids;
use crate::server::slot::with_slot;
use crate::server::wire::{Property, properties};

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new().routes(routes!(follow_world))
}

/// Events a second when `rate` is absent: as fast as a display shows them.
const RATE_DEFAULT: f64 = 60.0;
const RATE_MAX: f64 = 1000.0;

/// When nothing happens for so long, something without a meaning is sent: so that what stands between knows that the
/// connection is in use, and both ends find out when it is gone.
const HEARTBEAT: Duration = Duration::from_secs(15);

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct StreamQuery {
    fields: Option<String>,
    ids: Option<String>,
    rate: Option<f64>,
    since: Option<u64>,
    encoding: Option<Named<Encoding>>,
}

impl Choice for Encoding {
    const ALL: &'static [Self] = &Self::ALL;
    fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Cbor => "cbor",
        }
    }
}

/// How events are told apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Framing {
    /// `text/event-stream`, as browsers and `curl -N` read it.
    Events,
    /// One JSON value a line.
    Lines,
}

/// Follows a world
///
/// The first event is the state, the next ones what changed since the one before: `time`, `revision`, `count`, the columns
/// of the particles that changed, and the ids that were `removed`; `full` is true in one that says everything. At most `rate`
/// a second: who reads slowly gets the newest state, with all that changed meanwhile. As server-sent events (default, or
/// `Accept: text/event-stream`; the id of an event is its revision, and `Last-Event-ID` resumes), as lines
/// (`Accept: application/jsonl`), or over a WebSocket, where what is sent up is the body of `POST …/commands` (JSON as
/// text, CBOR as binary) and is answered in its turn. Ends when the world is removed and when the service shuts down; the
/// last event, `end`, is a problem that says which. A page that shows an answer when it ends has nothing to show: take
/// `curl -N`.
#[utoipa::path(get, path = "/v1/worlds/{world}/stream", tag = "particles",
    params(
        ("fields" = Option<String>, Query, description = "which columns besides the id; default position,velocity", example = "position"),
        ("ids" = Option<String>, Query, description = "only these, separated by commas: `0,2`"),
        ("rate" = Option<f64>, Query, description = "at most so many events a second; above 0, at most 1000; default 60", exclusive_minimum = 0, maximum = 1000),
        ("since" = Option<u64>, Query, description = "a revision that is known: the first event has what changed since then, if that is still known"),
        ("encoding" = Option<String>, Query, description = "`json` (default) or, over a WebSocket, `cbor`", example = "json"),
    ),
    responses(
        (status = 200, description = "Events, for as long as the client listens", body = String, content_type = "text/event-stream"),
        (status = 101, description = "A WebSocket"),
    ))]
async fn follow_world(State(app): State<Arc<App>>, request: Request) -> Result<Response, Problem> {
    let may_change = app.may_change(request.headers());
    let (mut parts, _) = request.into_parts();
    let is_socket =
        parts.headers.get(header::UPGRADE).is_some_and(|to| to.as_bytes().eq_ignore_ascii_case(b"websocket"));
    let framing = if is_socket { Framing::Events } else { framing(&parts.headers)? };
    let target = target(&mut parts, &app).await?;
    let any = app.slot(&target)?;
    let asked = query::<StreamQuery>(&parts.uri)?;
    let encoding = asked.encoding.map_or(Encoding::Json, |Named(encoding)| encoding);
    let last_seen = parts.headers.get("last-event-id").and_then(|id| id.to_str().ok()?.parse().ok());
    let interest = asked.interest(last_seen)?;
    if is_socket {
        let upgrade = WebSocketUpgrade::from_request_parts(&mut parts, &app).await.map_err(|rejection| {
            Problem::new(Code::MalformedRequest, format!("this is no handshake of a WebSocket: {rejection}"))
        })?;
        let most = app.config.body_bytes_max.min(SMALL_BODY_BYTES_MAX);
        let upgrade = upgrade.max_message_size(most).max_frame_size(most);
        return with_slot!(any, slot => {
            let follower = Follower::new(&app, slot, target.clone(), interest).await?;
            let talk = Talk { app, target, may_change, encoding };
            Ok(upgrade.on_upgrade(move |socket| talk.until_it_ends(socket, follower)))
        });
    }
    if encoding == Encoding::Cbor {
        return Err(Problem::new(Code::InvalidParameter, "events in CBOR are told over a WebSocket only"));
    }
    let (sender, receiver) = mpsc::channel(1);
    with_slot!(any, slot => {
        let follower = Follower::new(&app, slot, target, interest).await?;
        tokio::spawn(tell(app, follower, framing, sender));
    });
    let mut response = Response::new(axum::body::Body::new(Pieces(receiver)));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(framing.content_type()));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

impl StreamQuery {
    fn interest(&self, last_seen: Option<u64>) -> Result<Interest, Problem> {
        let rate = self.rate.unwrap_or(RATE_DEFAULT);
        if !(rate > 0.0 && rate <= RATE_MAX) {
            let detail = format!("rate is a number of events a second, above 0 and at most {RATE_MAX}");
            return Err(Problem::new(Code::InvalidParameter, detail));
        }
        Ok(Interest {
            properties: match &self.fields {
                None => vec![Property::Position, Property::Velocity],
                Some(fields) => properties(fields)?,
            },
            ids: self.ids.as_deref().map(listed_ids).transpose()?.map(Into::into),
            period: Duration::try_from_secs_f64(1.0 / rate).unwrap_or(Duration::MAX).min(Duration::from_hours(24)),
            since: self.since.or(last_seen),
        })
    }
}

/// How the client wants its events; the first of several that it likes the same.
fn framing(headers: &HeaderMap) -> Result<Framing, Problem> {
    let ranges = crate::server::encoding::ranges(headers);
    if ranges.is_empty() {
        return Ok(Framing::Events);
    }
    let known = |range: &(String, f32)| match range.0.as_str() {
        "text/event-stream" | "text/*" | "*/*" => Some((Framing::Events, range.1)),
        "application/jsonl" | "application/x-ndjson" | "application/ndjson" => Some((Framing::Lines, range.1)),
        _ => None,
    };
    let wanted = ranges.iter().filter_map(known).filter(|(_, weight)| *weight > 0.0);
    let best = wanted.reduce(|a, b| if b.1 > a.1 { b } else { a });
    best.map(|(framing, _)| framing).ok_or_else(|| {
        let detail = "a stream is text/event-stream or application/jsonl, which the Accept header excludes";
        Problem::new(Code::NotAcceptable, detail)
    })
}

impl Framing {
    fn content_type(self) -> &'static str {
        match self {
            Self::Events => "text/event-stream",
            Self::Lines => "application/jsonl",
        }
    }

    fn begin(self) -> fn(u64) -> String {
        match self {
            Self::Events => |revision| format!("id: {revision}\ndata: "),
            Self::Lines => |_| String::new(),
        }
    }

    /// Behind the newline of an event.
    fn end(self) -> &'static str {
        match self {
            Self::Events => "\n",
            Self::Lines => "",
        }
    }

    fn last(self, problem: &Problem) -> String {
        let problem = String::from_utf8_lossy(&problem.body()).into_owned();
        match self {
            Self::Events => format!("event: end\ndata: {problem}\n"),
            Self::Lines => format!("{{\"end\":{}}}\n", problem.trim_end()),
        }
    }
}

/// Sends events until the client goes away, the world is gone or the service ends.
async fn tell<R: WireReal>(
    app: Arc<App>,
    mut follower: Follower<R>,
    framing: Framing,
    sender: mpsc::Sender<std::io::Result<Bytes>>,
) {
    let _counted = app.followers.enter();
    loop {
        let next = timeout(HEARTBEAT, follower.next(Encoding::Json, framing.begin()));
        let next = tokio::select! {
            biased;
            () = sender.closed() => return,
            () = app.drained() => Ok(Err(Problem::plain(Code::ShuttingDown))),
            next = next => next,
        };
        let is_heard = match next {
            Ok(Ok(event)) => event.followed_by(framing.end()).send(&sender).await,
            Ok(Err(problem)) => {
                let _gone = sender.send(Ok(framing.last(&problem).into())).await;
                return;
            }
            // What reads lines expects a value in each.
            Err(_) if framing == Framing::Lines => true,
            Err(_) => sender.send(Ok(":\n\n".into())).await.is_ok(),
        };
        if !is_heard {
            return;
        }
    }
}

/// A conversation over a WebSocket.
struct Talk {
    app: Arc<App>,
    target: Target,
    may_change: bool,
    encoding: Encoding,
}

impl Talk {
    async fn until_it_ends<R: WireReal>(self, mut socket: WebSocket, mut follower: Follower<R>) {
        let _counted = self.app.followers.enter();
        let _underway = self.app.underway.enter();
        let patience = self.app.config.write_timeout();
        let mut beats = tokio::time::interval_at(Instant::now() + HEARTBEAT, HEARTBEAT);
        let mut is_alive = true;
        loop {
            let message = tokio::select! {
                biased;
                () = self.app.drained() => return self.close(socket, &Problem::plain(Code::ShuttingDown)).await,
                received = socket.recv() => match received {
                    Some(Ok(Message::Text(text))) => self.answer(text.into(), Encoding::Json).await,
                    Some(Ok(Message::Binary(bytes))) => self.answer(bytes, Encoding::Cbor).await,
                    Some(Ok(Message::Pong(_) | Message::Ping(_))) => {
                        is_alive = true;
                        continue;
                    }
                    Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                },
                _ = beats.tick() => {
                    if !std::mem::take(&mut is_alive) {
                        return;
                    }
                    Message::Ping(Bytes::new())
                }
                next = follower.next(self.encoding, |_| String::new()) => match next {
                    Ok(event) => message(event).await,
                    Err(problem) => return self.close(socket, &problem).await,
                },
            };
            // Who takes nothing for so long is gone.
            if !matches!(timeout(patience, socket.send(message)).await, Ok(Ok(()))) {
                return;
            }
        }
    }

    /// Commands of a frame, and what came of them.
    async fn answer(&self, bytes: Bytes, encoding: Encoding) -> Message {
        let answer = async {
            if !self.may_change {
                return Err(Problem::plain(Code::ReadOnlyToken));
            }
            let body = Body { bytes, encoding };
            let change = Change::of_frame(&self.app, self.target.clone(), body)?;
            commands::run(&self.app, &change).await.map(|reply| reply.content)
        };
        let content = answer.await.unwrap_or_else(|problem| Content::of(encoding, &problem.wire()));
        message(content).await
    }

    async fn close(&self, mut socket: WebSocket, problem: &Problem) {
        // 1001: the service goes away; 1000: there is nothing more to say.
        let code = if problem.code == Code::ShuttingDown { 1001 } else { 1000 };
        let reason = problem.code.name().into();
        let _gone =
            timeout(self.app.config.write_timeout(), socket.send(Message::Close(Some(CloseFrame { code, reason }))))
                .await;
    }
}

/// A content as one frame.
async fn message(content: Content) -> Message {
    let encoding = content.encoding;
    match (content.into_bytes().await, encoding) {
        (Some(bytes), Encoding::Json) => Message::Text(bytes.try_into().expect("JSON is UTF-8")),
        (Some(bytes), Encoding::Cbor) => Message::Binary(bytes),
        // A defect.
        (None, _) => Message::Close(Some(CloseFrame { code: 1011, reason: Code::InternalError.name().into() })),
    }
}
