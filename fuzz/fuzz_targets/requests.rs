//! Bytes to requests, and requests to the service in memory, whose worlds are those of `worlds.http`. An input is a text
//! like that file: requests as HTTP writes them, with a line `---` between them. In a body of CBOR `\xa1` is that byte.

#![no_main]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

use axum::body::{Body, Bytes, to_bytes};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Request, StatusCode, Uri, header};
use libfuzzer_sys::{Corpus, fuzz_target};
use pointmass::server::{App, Config, Front, service};
use serde_json::Value;
use tokio::runtime::{Builder, Runtime};
use tower::ServiceExt;

const WORLDS: &[u8] = include_bytes!("worlds.http");

/// What the service writes as null where it means it. A number that is not finite would be written so as well.
const NULLABLE: [&str; 10] = [
    "drag",
    "duration_max",
    "error",
    "forces",
    "gravitation",
    "gravitational_mass",
    "mass",
    "max_step",
    "next_after",
    "own_acceleration",
];

struct Service {
    runtime: Runtime,
    service: Front,
    /// The worlds as every input finds them.
    fresh: BTreeMap<String, World>,
}

/// What can be read of a world without its particles: its description and its digest.
#[derive(Debug, PartialEq)]
struct World {
    description: Value,
    digest: Value,
}

struct Answer {
    status: StatusCode,
    headers: HeaderMap,
    body: Bytes,
}

static SERVICE: LazyLock<Service> = LazyLock::new(Service::new);

impl Service {
    fn new() -> Self {
        // Every limit can be reached, and nothing takes long.
        let config = Config {
            threads: 1,
            worlds_max: 8,
            particles_max: 300,
            memory_bytes_max: 256 * 400,
            steps_max: 300,
            particle_steps_max: 3000,
            interactions_max: 3000,
            body_bytes_max: 2000,
            ..Config::default()
        };
        let app = App::new(config).expect("no token file");
        let runtime = Builder::new_current_thread().enable_time().build().expect("a runtime");
        let mut service = Self { service: service(&app), runtime, fresh: BTreeMap::new() };
        for request in requests(WORLDS) {
            let answer = service.send(request);
            assert!(answer.status.is_success(), "{answer:?}");
        }
        service.fresh = service.worlds();
        service
    }

    fn send(&self, request: Request<Bytes>) -> Answer {
        let request = request.map(Body::from);
        let (parts, body) = self.runtime.block_on(async {
            let (parts, body) = self.service.clone().oneshot(request).await.expect("infallible").into_parts();
            // A stream does not end: whoever asked goes away.
            let is_stream = parts
                .headers
                .get(header::CONTENT_TYPE)
                .is_some_and(|kind| matches!(kind.as_bytes(), b"text/event-stream" | b"application/jsonl"));
            let body = if is_stream { Body::empty() } else { body };
            (parts, to_bytes(body, usize::MAX).await.expect("in memory"))
        });
        Answer { status: parts.status, headers: parts.headers, body }
    }

    fn call(&self, method: Method, path: &str) -> Answer {
        let request = Request::builder().method(method).uri(path).header(header::HOST, "localhost");
        self.send(request.body(Bytes::new()).expect("a request"))
    }

    fn read(&self, path: &str) -> Value {
        self.call(Method::GET, path).json()
    }

    fn worlds(&self) -> BTreeMap<String, World> {
        let Value::Array(descriptions) = self.read("/v1/worlds")["worlds"].take() else { panic!("a list of worlds") };
        let worlds = descriptions.into_iter().map(|description| {
            let name = description["world"].as_str().expect("a name").to_owned();
            let digest = self.read(&format!("/v1/worlds/{name}/digest"));
            (name, World { description, digest })
        });
        worlds.collect()
    }

    /// Makes the worlds those that every input finds.
    fn refresh(&self, found: &BTreeMap<String, World>) {
        let is_fresh = |name: &str| found.get(name) == self.fresh.get(name);
        for name in found.keys().filter(|name| !is_fresh(name)) {
            self.call(Method::DELETE, &format!("/v1/worlds/{name}"));
        }
        for request in requests(WORLDS) {
            let name = request.uri().path().split('/').nth(3).expect("the path of a world");
            if !is_fresh(name) {
                self.send(request);
            }
        }
    }
}

/// The requests of an input, without what no client could send.
fn requests(text: &[u8]) -> impl Iterator<Item = Request<Bytes>> {
    let mut rest = Some(text);
    let texts = std::iter::from_fn(move || {
        let (one, others) = split(rest?, b"\n---\n");
        rest = others;
        Some(one)
    });
    texts.filter_map(request)
}

fn request(text: &[u8]) -> Option<Request<Bytes>> {
    let (head, body) = split(text, b"\n\n");
    let mut lines = head.split(|byte| *byte == b'\n');
    let (method, uri) = split(lines.next()?, b" ");
    let mut request = Request::new(Bytes::copy_from_slice(body.unwrap_or_default()));
    *request.method_mut() = Method::from_bytes(method).ok()?;
    *request.uri_mut() = Uri::try_from(uri?).ok()?;
    for line in lines.filter(|line| !line.is_empty()) {
        let (name, value) = split(line, b": ");
        request.headers_mut().append(HeaderName::from_bytes(name).ok()?, HeaderValue::from_bytes(value?).ok()?);
    }
    if is_cbor(&request) {
        *request.body_mut() = unescaped(request.body()).into();
    }
    request.headers_mut().entry(header::HOST).or_insert(HeaderValue::from_static("localhost"));
    Some(request)
}

fn is_cbor(request: &Request<Bytes>) -> bool {
    request.headers().get(header::CONTENT_TYPE).is_some_and(|value| value == "application/cbor")
}

/// Bytes that are no text, out of text; the newline at its end is none of them.
fn unescaped(text: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.strip_suffix(b"\n").unwrap_or(text);
    while let Some((first, behind)) = rest.split_first() {
        let digits = behind.strip_prefix(b"x").and_then(|digits| std::str::from_utf8(digits.get(..2)?).ok());
        match digits.map(|digits| u8::from_str_radix(digits, 16)) {
            Some(Ok(byte)) if *first == b'\\' => {
                bytes.push(byte);
                rest = &behind[3..];
            }
            Some(_) | None => {
                bytes.push(*first);
                rest = behind;
            }
        }
    }
    bytes
}

/// Whether the service is asked to change something.
fn asks_for_change(request: &Request<Bytes>) -> bool {
    let reads = [Method::GET, Method::HEAD, Method::OPTIONS, Method::TRACE].contains(request.method());
    !reads && !asks_for_dry_run(request)
}

fn asks_for_dry_run(request: &Request<Bytes>) -> bool {
    if !is_cbor(request) {
        let body: Value = serde_json::from_slice(request.body()).unwrap_or_default();
        return body["dry_run"] == true;
    }
    let body = ciborium::from_reader::<ciborium::Value, _>(&request.body()[..]);
    let Ok(ciborium::Value::Map(members)) = body else { return false };
    members.iter().any(|(name, value)| name.as_text() == Some("dry_run") && value.as_bool() == Some(true))
}

/// What stands before the separator, and what behind it if it is there.
fn split<'a>(text: &'a [u8], separator: &[u8]) -> (&'a [u8], Option<&'a [u8]>) {
    match text.windows(separator.len()).position(|window| window == separator) {
        Some(at) => (&text[..at], Some(&text[at + separator.len()..])),
        None => (text, None),
    }
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error} in {self:?}"))
    }

    /// What holds for every answer.
    fn check(&self, method: &Method, uri: &Uri) {
        assert!(!self.status.is_server_error(), "{self:?}");
        let content_type = self.headers.get(header::CONTENT_TYPE).map_or(&b""[..], HeaderValue::as_bytes);
        let refused = self.status.is_client_error();
        assert_eq!(content_type == b"application/problem+json", refused, "{self:?}");
        if method == Method::HEAD || !(refused || content_type == b"application/json") {
            return;
        }
        assert!(self.body.ends_with(b"\n"), "{self:?}");
        let json = self.json();
        // The examples of the description have nulls of their own.
        if uri.path() != "/openapi.json" {
            check_numbers("", &json);
        }
        if refused {
            assert!(json["code"].is_string(), "{self:?}");
            assert_eq!(json["status"], self.status.as_u16(), "{self:?}");
        }
    }
}

impl std::fmt::Debug for Answer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {:?} {:?}", self.status, self.headers, String::from_utf8_lossy(&self.body))
    }
}

fn check_numbers(name: &str, json: &Value) {
    match json {
        Value::Null => assert!(NULLABLE.contains(&name), "{name} is null"),
        Value::Array(items) => items.iter().for_each(|item| check_numbers(name, item)),
        Value::Object(members) => members.iter().for_each(|(name, member)| check_numbers(name, member)),
        Value::Bool(_) | Value::Number(_) | Value::String(_) => {}
    }
}

/// What a request may have done to the worlds: nothing when it was refused or reads; else one world is new, gone, or one
/// revision further, and the answer says so. Commands take any number of worlds one revision further.
fn check_change(
    request: &str,
    is_change: bool,
    answer: &Answer,
    before: &BTreeMap<String, World>,
    after: &BTreeMap<String, World>,
) {
    let names: BTreeSet<&String> = before.keys().chain(after.keys()).collect();
    let changed: Vec<&String> = names.into_iter().filter(|name| before.get(*name) != after.get(*name)).collect();
    if !is_change {
        assert!(changed.is_empty(), "{request} changed {changed:?}: {answer:?}");
        return;
    }
    if request.ends_with("/commands") {
        for name in changed {
            let revision = |worlds: &BTreeMap<String, World>| worlds.get(name)?.digest["revision"].as_u64();
            assert_eq!(revision(after), revision(before).map(|revision| revision + 1), "{request}: {name}, {answer:?}");
        }
        return;
    }
    let [changed] = changed[..] else { panic!("{request} changed {changed:?}: {answer:?}") };
    let revision = match (before.get(changed), after.get(changed)) {
        (Some(before), Some(after)) => {
            let [before, after] = [before, after].map(|world| world.digest["revision"].as_u64().expect("a number"));
            assert_eq!(after, before + 1, "{request}: {answer:?}");
            after
        }
        (None, Some(world)) => {
            assert_eq!((answer.status, &world.digest["revision"]), (StatusCode::CREATED, &Value::from(0)));
            0
        }
        (Some(_), None) | (None, None) => {
            assert_eq!(answer.status, StatusCode::NO_CONTENT, "{request}: {answer:?}");
            return;
        }
    };
    let tag = answer.headers.get(header::ETAG).map(HeaderValue::as_bytes);
    assert_eq!(tag, Some(format!("\"{revision}\"").as_bytes()), "{request}: {answer:?}");
    if let Some(world) = after.get(changed) {
        for number in ["revision", "time", "step_count"] {
            assert_eq!(world.description[number], world.digest[number], "{request}: {answer:?}");
        }
    }
}

fuzz_target!(|input: &[u8]| -> Corpus {
    let service = &*SERVICE;
    let mut found: Option<BTreeMap<String, World>> = None;
    for request in requests(input).take(8) {
        let (method, uri) = (request.method().clone(), request.uri().clone());
        let asks_for_change = asks_for_change(&request);
        let answer = service.send(request);
        answer.check(&method, &uri);
        let after = service.worlds();
        let is_change = asks_for_change && answer.status.is_success();
        check_change(&format!("{method} {uri}"), is_change, &answer, found.as_ref().unwrap_or(&service.fresh), &after);
        found = Some(after);
    }
    let Some(found) = found else { return Corpus::Reject };
    service.refresh(&found);
    Corpus::Keep
});
