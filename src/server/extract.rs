//! What every handler takes from a request, in the order in which a request can be refused.

use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Query, RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use http_body_util::{BodyExt, Limited};
use hyper::body::Frame;
use mediatype::{MediaType, names};
use serde::de::DeserializeOwned;

use crate::ids::ParticleId;
use crate::server::App;
use crate::server::body::Body;
use crate::server::coding::Coding;
use crate::server::config::{BODY_BYTES_MAX, PAGE_DEFAULT, PAGE_MAX, SMALL_BODY_BYTES_MAX};
use crate::server::encoding::Encoding;
use crate::server::idempotency::Key;
use crate::server::memory::Charge;
use crate::server::problem::{Code, Problem};

/// The names in the path.
#[derive(Debug, Default, Clone)]
pub(crate) struct Target {
    pub(crate) world: String,
    /// `Some(None)`: something that cannot be an id.
    #[expect(clippy::option_option, reason = "no particle in the path, no id, and an id are three things")]
    particle: Option<Option<ParticleId>>,
}

impl Target {
    pub(crate) fn names_particle(&self) -> bool {
        self.particle.is_some()
    }

    /// The particle in the path.
    pub(crate) fn particle(&self) -> Result<ParticleId, Problem> {
        self.particle
            .flatten()
            .ok_or_else(|| Problem::new(Code::UnknownParticle, "the path names no particle of this world"))
    }
}

/// A request that reads.
#[derive(Debug)]
pub(crate) struct Read {
    pub(crate) target: Target,
    pub(crate) preconditions: Preconditions,
    /// That of the answer.
    pub(crate) encoding: Encoding,
    pub(crate) coding: Option<Coding>,
    uri: Uri,
}

/// A request that changes something.
#[derive(Debug, Default)]
pub(crate) struct Change {
    pub(crate) target: Target,
    pub(crate) preconditions: Preconditions,
    /// That of its Idempotency-Key, told in its turn when it is none.
    pub(crate) key: Option<Result<Key, Problem>>,
    /// That of the answer.
    pub(crate) encoding: Encoding,
    pub(crate) coding: Option<Coding>,
    pub(crate) body: Body,
    pub(crate) uri: Uri,
    /// For the body, and what it is parsed into.
    #[expect(dead_code, reason = "lives as long as the request")]
    pub(crate) charge: Option<Charge>,
}

/// A change of many particles, whose body may be large. How large a body may be is said by what the handler of a route
/// takes, this or a [`Change`], and by nothing in the path: a world may have any name.
#[derive(Debug)]
pub(crate) struct Bulk(pub(crate) Change);

impl Change {
    /// Commands that came over a WebSocket.
    pub(crate) fn of_frame(app: &App, target: Target, body: Body) -> Result<Self, Problem> {
        let mut charge = Charge::none(&app.shared.in_flight);
        charge.grow(body.bytes.len() as u64 * body.encoding.byte_bytes())?;
        charge.grow(body.parsed_bytes(app.config.objects_max()))?;
        Ok(Self { target, encoding: body.encoding, body, charge: Some(charge), ..Self::default() })
    }
}

impl Read {
    pub(crate) fn query<Q: DeserializeOwned>(&self) -> Result<Q, Problem> {
        query(&self.uri)
    }
}

impl Change {
    /// The part of a request for many worlds that one of them gets.
    pub(crate) fn of_world(&self, name: &str, body: Body) -> Self {
        let target = Target { world: name.to_owned(), particle: None };
        Self { target, key: self.key.clone(), encoding: self.encoding, body, ..Self::default() }
    }

    pub(crate) fn query<Q: DeserializeOwned>(&self) -> Result<Q, Problem> {
        query(&self.uri)
    }
}

pub(crate) fn query<Q: DeserializeOwned>(uri: &Uri) -> Result<Q, Problem> {
    Query::try_from_uri(uri).map(|Query(query)| query).map_err(|error| {
        let detail = error.body_text();
        let reason = detail.strip_prefix("Failed to deserialize query string: ").unwrap_or(&detail);
        Problem::new(Code::InvalidParameter, format!("the parameters after ? are not right: {reason}"))
    })
}

/// The `limit` of a list.
pub(crate) fn page_limit(limit: Option<usize>) -> Result<usize, Problem> {
    match limit {
        None => Ok(PAGE_DEFAULT),
        Some(limit) if (1..=PAGE_MAX).contains(&limit) => Ok(limit),
        Some(_) => Err(Problem::new(Code::InvalidParameter, format!("limit is a number from 1 to {PAGE_MAX}"))),
    }
}

/// Refuses query parameters on routes that take none.
pub(crate) fn no_parameters(uri: &Uri) -> Result<(), Problem> {
    query::<NoParameters>(uri).map(|NoParameters {}| ())
}

/// For routes without query parameters.
#[derive(Debug, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct NoParameters {}

impl FromRequestParts<Arc<App>> for Read {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &Arc<App>) -> Result<Self, Problem> {
        let encoding = Encoding::accepted(&parts.headers)?;
        Self::of(parts, encoding, state).await
    }
}

impl Read {
    /// Of a request whose Accept header was looked at.
    pub(crate) async fn of(parts: &mut Parts, encoding: Encoding, state: &Arc<App>) -> Result<Self, Problem> {
        Ok(Self {
            encoding,
            coding: Coding::accepted(&parts.headers),
            target: target(parts, state).await?,
            preconditions: Preconditions::new(&parts.headers),
            uri: parts.uri.clone(),
        })
    }
}

impl FromRequest<Arc<App>> for Change {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &Arc<App>) -> Result<Self, Problem> {
        Self::read(request, state, false).await
    }
}

impl FromRequest<Arc<App>> for Bulk {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &Arc<App>) -> Result<Self, Problem> {
        Change::read(request, state, true).await.map(Self)
    }
}

impl Change {
    async fn read(request: Request, state: &Arc<App>, is_bulk: bool) -> Result<Self, Problem> {
        let (mut parts, body) = request.into_parts();
        let answer = Encoding::accepted(&parts.headers)?;
        let encoding = check_content(&parts.headers)?;
        let target = target(&mut parts, state).await?;
        let most = state.config.body_bytes_max;
        let limit = if is_bulk { most } else { most.min(SMALL_BODY_BYTES_MAX) };
        let mut charge = Charge::none(&state.shared.in_flight);
        let reading = Reading { limit, byte_bytes: encoding.byte_bytes(), piece_bytes: 0 };
        let refused = |unread| match unread {
            Unread::TooLarge => {
                let why = if limit == most {
                    format!(" (--{BODY_BYTES_MAX})")
                } else {
                    ", the most of a request that does not speak of many particles".to_owned()
                };
                Problem::new(Code::BodyTooLarge, format!("the body is larger than {limit} bytes{why}"))
            }
            Unread::CutShort => Problem::new(encoding.malformed(), "the body was cut short"),
        };
        let (mut first, mut whole) = (Bytes::new(), Vec::new());
        let take = |piece: Bytes, declared: usize| {
            if first.is_empty() && whole.is_empty() {
                first = piece;
                return;
            }
            if whole.is_empty() {
                whole.reserve(declared);
                // Pieces that are gone give their room to the next ones.
                whole.extend_from_slice(&std::mem::take(&mut first));
            }
            whole.extend_from_slice(&piece);
        };
        reading.each_piece(state, &parts.headers, body, &mut charge, refused, take).await?;
        let body = Body { bytes: if whole.is_empty() { first } else { whole.into() }, encoding };
        // A small one in JSON is charged for already.
        if is_bulk || encoding == Encoding::Cbor {
            let objects_max = state.config.objects_max();
            let parsed = state.shared.parse(body.clone(), move |body| Ok(body.parsed_bytes(objects_max)));
            charge.grow(parsed.await?)?;
        }
        Ok(Self {
            target,
            preconditions: Preconditions::new(&parts.headers),
            key: Key::of(&parts.method, &parts.uri, &parts.headers, answer, std::slice::from_ref(&body.bytes))
                .transpose(),
            encoding: answer,
            coding: Coding::accepted(&parts.headers),
            body,
            uri: parts.uri,
            charge: Some(charge),
        })
    }
}

pub(crate) async fn target(parts: &mut Parts, state: &Arc<App>) -> Result<Target, Problem> {
    let names = RawPathParams::from_request_parts(parts, state)
        .await
        .map_err(|_| Problem::new(Code::UnknownRoute, "the path is not UTF-8"))?;
    let mut target = Target::default();
    for (name, value) in &names {
        match name {
            "world" => value.clone_into(&mut target.world),
            _ => target.particle = Some(canonical_id(value)),
        }
    }
    Ok(target)
}

/// Digits as this service writes them: without a sign or leading zeros, so that each particle has one path.
fn canonical_id(text: &str) -> Option<ParticleId> {
    text.parse().ok().filter(|id: &u64| id.to_string() == text).map(ParticleId)
}

/// How a body is read.
pub(crate) struct Reading {
    /// Bytes.
    pub(crate) limit: usize,
    /// What each of its bytes is charged.
    pub(crate) byte_bytes: u64,
    /// What each piece of it is charged.
    pub(crate) piece_bytes: u64,
}

/// Why a body is not read.
pub(crate) enum Unread {
    TooLarge,
    CutShort,
}

impl Reading {
    /// Reads a body in the pieces in which it comes; `take` also gets the length that is declared, or 0. It is charged before
    /// it is there where that is.
    pub(crate) async fn each_piece(
        &self,
        state: &App,
        headers: &HeaderMap,
        body: axum::body::Body,
        charge: &mut Charge,
        refused: impl Fn(Unread) -> Problem,
        mut take: impl FnMut(Bytes, usize),
    ) -> Result<(), Problem> {
        let declared =
            headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse::<usize>().ok());
        if declared.is_some_and(|length| length > self.limit) {
            return Err(refused(Unread::TooLarge));
        }
        charge.grow(declared.unwrap_or(0) as u64 * self.byte_bytes)?;
        let mut body = Limited::new(body, self.limit);
        let read = async {
            while let Some(frame) = body.frame().await {
                match frame.map(Frame::into_data) {
                    Ok(Ok(data)) => {
                        let bytes = if declared.is_none() { data.len() as u64 * self.byte_bytes } else { 0 };
                        charge.grow(bytes + self.piece_bytes)?;
                        take(data, declared.unwrap_or(0));
                    }
                    // Trailers say nothing here.
                    Ok(Err(_)) => {}
                    Err(error) if error.is::<http_body_util::LengthLimitError>() => {
                        return Err(refused(Unread::TooLarge));
                    }
                    Err(_) => return Err(refused(Unread::CutShort)),
                }
            }
            Ok(())
        };
        tokio::time::timeout(state.config.body_timeout(), read).await.map_err(|_| {
            let timeout = state.config.body_timeout_ms;
            Problem::new(Code::BodyTimeout, format!("the body did not arrive within {timeout} ms"))
        })?
    }
}

/// Refuses a body that is packed.
pub(crate) fn check_coding(headers: &HeaderMap) -> Result<(), Problem> {
    match headers.get(header::CONTENT_ENCODING) {
        Some(coding) if !coding.as_bytes().eq_ignore_ascii_case(b"identity") => {
            let detail = format!("a body with Content-Encoding {coding:?} is not read; send it as it is");
            Err(Problem::new(Code::UnsupportedMediaType, detail))
        }
        Some(_) | None => Ok(()),
    }
}

/// A body in CBOR says so; one in JSON may say so, say nothing, or come from a plain `curl -d`.
fn check_content(headers: &HeaderMap) -> Result<Encoding, Problem> {
    let unsupported = |detail: String| Err(Problem::new(Code::UnsupportedMediaType, detail));
    check_coding(headers)?;
    let Some(content_type) = headers.get(header::CONTENT_TYPE) else { return Ok(Encoding::Json) };
    // What nearly all of them are needs no parsing.
    if content_type.is_empty() || content_type == "application/json" {
        return Ok(Encoding::Json);
    }
    let text = content_type.to_str().unwrap_or_default();
    match MediaType::parse(text) {
        Ok(media) if media.ty == names::TEXT => Ok(Encoding::Json),
        Ok(media) if media.ty == names::APPLICATION => {
            let is = |name| media.subty == name || media.suffix == Some(name);
            if is(names::CBOR) {
                Ok(Encoding::Cbor)
            } else if is(names::JSON) || media.subty == "x-www-form-urlencoded" {
                Ok(Encoding::Json)
            } else {
                unsupported(unread(content_type))
            }
        }
        Ok(_) | Err(_) => unsupported(unread(content_type)),
    }
}

fn unread(content_type: &HeaderValue) -> String {
    format!("a body of type {content_type:?} is not read; send application/json or application/cbor")
}

/// If-Match and If-None-Match.
#[derive(Debug, Default)]
pub(crate) struct Preconditions {
    if_match: Option<Vec<String>>,
    if_none_match: Option<Vec<String>>,
}

impl Preconditions {
    pub(crate) fn new(headers: &HeaderMap) -> Self {
        let tags = |name| {
            headers.contains_key(&name).then(|| {
                let values = headers.get_all(&name).iter().filter_map(|value| value.to_str().ok());
                values.flat_map(|value| value.split(',')).map(|tag| tag.trim().to_owned()).collect()
            })
        };
        Self { if_match: tags(header::IF_MATCH), if_none_match: tags(header::IF_NONE_MATCH) }
    }

    /// Refuses a change that was decided on another revision.
    pub(crate) fn check(&self, revision: u64) -> Result<(), Problem> {
        match &self.if_match {
            Some(tags) if !tags.iter().any(|tag| tag == "*" || *tag == etag(revision)) => {
                let detail = format!("the world is at revision {revision}, If-Match asks for {}", tags.join(", "));
                Err(Problem::new(Code::RevisionMismatch, detail))
            }
            Some(_) | None => Ok(()),
        }
    }

    /// The same for a world that does not exist: no revision matches.
    pub(crate) fn check_absent(&self) -> Result<(), Problem> {
        match self.if_match {
            Some(_) => {
                Err(Problem::new(Code::RevisionMismatch, "If-Match asks for a revision of a world that does not exist"))
            }
            None => Ok(()),
        }
    }

    /// The same for many worlds: none of them is meant.
    pub(crate) fn check_many(&self) -> Result<(), Problem> {
        match self.if_match {
            Some(_) => Err(Problem::new(Code::RevisionMismatch, "If-Match speaks of one world, the request of many")),
            None => Ok(()),
        }
    }

    /// Whether the client has this revision already.
    pub(crate) fn has(&self, revision: u64) -> bool {
        let own = etag(revision);
        self.if_none_match
            .as_ref()
            .is_some_and(|tags| tags.iter().any(|tag| tag == "*" || tag.trim_start_matches("W/") == own))
    }
}

/// The entity tag of a revision.
pub(crate) fn etag(revision: u64) -> String {
    ["\"", &revision.to_string(), "\""].concat()
}

#[cfg(test)]
mod tests {
    use super::{Encoding, check_content};
    use axum::http::{HeaderMap, HeaderName, HeaderValue, header};

    fn headers(name: HeaderName, value: &'static str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_static(value))])
    }

    #[test]
    fn content_types_that_are_read() {
        use Encoding::{Cbor, Json};
        for (content_type, encoding) in [
            ("application/json", Some(Json)),
            ("application/json; charset=utf-8", Some(Json)),
            ("application/merge-patch+json", Some(Json)),
            ("text/plain", Some(Json)),
            ("application/x-www-form-urlencoded", Some(Json)),
            ("APPLICATION/JSON", Some(Json)),
            ("application/cbor", Some(Cbor)),
            ("Application/CBOR; q=1", Some(Cbor)),
            ("application/vnd.scene+cbor", Some(Cbor)),
            ("application/cbor-seq", None),
            ("image/cbor", None),
            ("application/octet-stream", None),
            ("multipart/form-data; boundary=x", None),
            ("nonsense", None),
        ] {
            let read = check_content(&headers(header::CONTENT_TYPE, content_type));
            assert_eq!(read.ok(), encoding, "{content_type}");
        }
        assert_eq!(check_content(&HeaderMap::new()).ok(), Some(Json));
        assert!(check_content(&headers(header::CONTENT_ENCODING, "gzip")).is_err());
    }
}
