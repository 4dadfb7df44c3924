//! A service on a real socket, and a client that is nobody's library: what it sends and reads is plain HTTP/1.1 text.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use pointmass::server::{App, Config, Listener, serve};
use serde::de::DeserializeOwned;
use serde_json::Value;
use tokio::sync::oneshot;

/// A running service. It ends, and its threads with it, when this is dropped.
pub(crate) struct Service {
    pub(crate) address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Service {
    pub(crate) fn start() -> Self {
        Self::with(|_| {})
    }

    /// With some settings changed.
    pub(crate) fn with(change: impl FnOnce(&mut Config)) -> Self {
        let mut config = Config { listen: vec!["127.0.0.1:0".to_owned()], ..Config::default() };
        change(&mut config);
        let (stop, stopped) = oneshot::channel();
        let (tell, told) = std::sync::mpsc::channel();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_multi_thread()
                .worker_threads(config.workers)
                .max_blocking_threads(config.blocking_threads())
                .enable_all()
                .build()
                .expect("a runtime");
            runtime.block_on(async {
                let listener = Listener::bind(&config.listen[0], &config).await.expect("a free port");
                let Listener::Tcp(socket) = &listener else { panic!("the tests bind TCP") };
                tell.send(socket.local_addr().expect("bound")).expect("the test waits");
                let app = App::new(config).expect("a valid configuration");
                serve(vec![listener], app, async {
                    let _dropped = stopped.await;
                })
                .await;
            });
        });
        Self { address: told.recv().expect("the address"), stop: Some(stop), thread: Some(thread) }
    }

    pub(crate) fn client(&self) -> Client {
        Client::connect(self.address)
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
            && !std::thread::panicking()
        {
            panic!("the service panicked");
        }
    }
}

/// One connection. Checks every answer against what the `OpenAPI` description promises of its route.
pub(crate) struct Client {
    stream: BufReader<TcpStream>,
    address: SocketAddr,
}

#[derive(Debug, Clone)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) headers: HashMap<String, String>,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn text(&self) -> &str {
        std::str::from_utf8(&self.body).expect("text")
    }

    #[track_caller]
    pub(crate) fn json(&self) -> Value {
        self.typed()
    }

    #[track_caller]
    pub(crate) fn typed<T: DeserializeOwned>(&self) -> T {
        serde_json::from_slice(&self.body).unwrap_or_else(|error| panic!("{error} in {:?}", self.text()))
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.headers.get(name).map(String::as_str)
    }

    #[track_caller]
    pub(crate) fn expect(self, status: u16) -> Self {
        assert_eq!(self.status, status, "{}", self.text());
        self
    }
}

impl Client {
    pub(crate) fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).expect("the service listens");
        stream.set_nodelay(true).expect("a socket");
        stream.set_read_timeout(Some(Duration::from_mins(1))).expect("a socket");
        Self { stream: BufReader::new(stream), address }
    }

    #[track_caller]
    pub(crate) fn get(&mut self, path: &str) -> Answer {
        self.send("GET", path, &[], None)
    }

    #[track_caller]
    pub(crate) fn put(&mut self, path: &str, body: &str) -> Answer {
        self.send("PUT", path, &[], Some(body.as_bytes()))
    }

    #[track_caller]
    pub(crate) fn post(&mut self, path: &str, body: &str) -> Answer {
        self.send("POST", path, &[], Some(body.as_bytes()))
    }

    #[track_caller]
    pub(crate) fn patch(&mut self, path: &str, body: &str) -> Answer {
        self.send("PATCH", path, &[], Some(body.as_bytes()))
    }

    #[track_caller]
    pub(crate) fn delete(&mut self, path: &str) -> Answer {
        self.send("DELETE", path, &[], None)
    }

    /// Sends a request with a Host of its own unless the headers have one, and reads the answer.
    #[track_caller]
    pub(crate) fn send(&mut self, method: &str, path: &str, headers: &[(&str, &str)], body: Option<&[u8]>) -> Answer {
        let mut lines = vec![format!("{method} {path} HTTP/1.1")];
        if !headers.iter().any(|(name, _)| name.eq_ignore_ascii_case("host")) {
            lines.push(format!("host: {}", self.address));
        }
        lines.extend(headers.iter().map(|(name, value)| format!("{name}: {value}")));
        lines.extend(body.map(|body| format!("content-length: {}", body.len())));
        let request = lines.join("\r\n") + "\r\n\r\n";
        let mut bytes = request.into_bytes();
        bytes.extend_from_slice(body.unwrap_or_default());
        self.raw(&bytes);
        let answer = self.answer(method == "HEAD");
        check_documented(method, path, body, &answer);
        answer
    }

    pub(crate) fn raw(&mut self, bytes: &[u8]) {
        self.stream.get_mut().write_all(bytes).expect("the service reads");
    }

    /// The same to a service that may have closed the connection in the middle.
    pub(crate) fn raw_unless_closed(&mut self, bytes: &[u8]) {
        let _closed = self.stream.get_mut().write_all(bytes);
    }

    /// Waits for answers no longer than this.
    pub(crate) fn impatient(&mut self, patience: Duration) {
        self.stream.get_mut().set_read_timeout(Some(patience)).expect("a socket");
    }

    /// Reads so many bytes.
    #[track_caller]
    pub(crate) fn bytes(&mut self, count: usize) -> Vec<u8> {
        let mut bytes = vec![0; count];
        self.stream.read_exact(&mut bytes).expect("as many");
        bytes
    }

    /// Reads the head of an answer.
    #[track_caller]
    pub(crate) fn head(&mut self) -> String {
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            let read = self.stream.read_line(&mut head).expect("a head");
            assert!(read > 0, "closed after {head:?}");
        }
        head
    }

    /// Reads a chunk of a body; `None` after the last one.
    #[track_caller]
    pub(crate) fn chunk(&mut self) -> Option<Vec<u8>> {
        let mut size = String::new();
        self.stream.read_line(&mut size).expect("a size");
        let size = usize::from_str_radix(size.trim_end(), 16).expect("a size");
        let mut chunk = vec![0; size + 2];
        self.stream.read_exact(&mut chunk).expect("a chunk");
        chunk.truncate(size);
        (size > 0).then_some(chunk)
    }

    /// The body of a chunked answer of which the beginning was read, with headers.
    #[track_caller]
    pub(crate) fn rest_of_answer(&mut self, beginning: &[u8]) -> Vec<u8> {
        let head = beginning.windows(4).position(|window| window == b"\r\n\r\n").expect("headers") + 4;
        let mut chunks = std::io::Cursor::new(&beginning[head..]).chain(&mut self.stream);
        let (mut body, mut size) = (Vec::new(), String::new());
        loop {
            size.clear();
            chunks.read_line(&mut size).expect("a size");
            let length = usize::from_str_radix(size.trim_end(), 16).expect("a size");
            let mut chunk = vec![0; length + 2];
            chunks.read_exact(&mut chunk).expect("a chunk");
            if length == 0 {
                return body;
            }
            body.extend_from_slice(&chunk[..length]);
        }
    }

    /// Reads what there is, and whether that was the end.
    pub(crate) fn is_gone(&mut self) -> bool {
        match self.stream.read(&mut [0; 4096]) {
            Ok(read) => read == 0,
            Err(error) => !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
        }
    }

    /// Reads to the end, and whether there was one before patience ended.
    pub(crate) fn is_closed(&mut self) -> bool {
        self.stream.read_to_end(&mut Vec::new()).is_ok()
    }

    /// Reads one answer.
    #[track_caller]
    pub(crate) fn answer(&mut self, is_head: bool) -> Answer {
        self.try_answer(is_head).expect("an answer")
    }

    /// `None` when the connection was closed instead.
    pub(crate) fn try_answer(&mut self, is_head: bool) -> Option<Answer> {
        let mut line = String::new();
        self.stream.read_line(&mut line).ok().filter(|read| *read > 0)?;
        let status = line.split(' ').nth(1)?.parse().ok()?;
        let mut headers = HashMap::new();
        loop {
            let mut line = String::new();
            self.stream.read_line(&mut line).ok()?;
            let Some((name, value)) = line.trim_end().split_once(": ") else { break };
            headers.insert(name.to_ascii_lowercase(), value.to_owned());
        }
        let mut body = Vec::new();
        if !is_head && headers.get("transfer-encoding").is_some_and(|encoding| encoding == "chunked") {
            loop {
                let mut size = String::new();
                self.stream.read_line(&mut size).ok()?;
                let size = usize::from_str_radix(size.trim_end(), 16).ok()?;
                let mut chunk = vec![0; size + 2];
                self.stream.read_exact(&mut chunk).ok()?;
                if size == 0 {
                    break;
                }
                body.extend_from_slice(&chunk[..size]);
            }
        } else if !is_head {
            body = vec![0; headers.get("content-length").map_or(0, |length| length.parse().expect("a length"))];
            self.stream.read_exact(&mut body).ok()?;
        }
        Some(Answer { status, headers, body })
    }
}

/// Waits until so many requests besides the one that asks are in flight.
#[track_caller]
pub(crate) fn wait_for_in_flight(address: SocketAddr, count: usize) {
    let mut client = Client::connect(address);
    let line = format!("\npointmass_in_flight {}\n", count + 1);
    for _ in 0..100_000 {
        if client.get("/metrics").text().contains(&line) {
            return;
        }
    }
    panic!("there were never {count} requests in flight");
}

/// The description of the service, and a validator for each shape that has a name in it.
struct Described {
    document: Value,
    shapes: boon::Schemas,
    places: HashMap<String, boon::SchemaIndex>,
}

impl Described {
    fn get() -> &'static Self {
        static DESCRIBED: OnceLock<Described> = OnceLock::new();
        DESCRIBED.get_or_init(|| {
            let service = Service::start();
            let mut client = Client::connect(service.address);
            client.raw(b"GET /openapi.json HTTP/1.1\r\nhost: localhost\r\n\r\n");
            let document = client.answer(false).json();
            let (mut compiler, mut shapes) = (boon::Compiler::new(), boon::Schemas::new());
            compiler.set_default_draft(boon::Draft::V2020_12);
            compiler.add_resource("http://description", document.clone()).expect("JSON");
            let names = document["components"]["schemas"].as_object().expect("shapes").keys();
            let places = names.map(|name| {
                let place = compiler.compile(&format!("http://description#/components/schemas/{name}"), &mut shapes);
                (name.clone(), place.unwrap_or_else(|error| panic!("{name} is no schema: {error:#}")))
            });
            let places = places.collect();
            Self { document, shapes, places }
        })
    }

    /// The description of the route that a path belongs to, under this method.
    fn operation(&self, method: &str, path: &str) -> Option<&Value> {
        let path = path.split('?').next().expect("split has a first part");
        let segments: Vec<&str> = path.split('/').collect();
        let paths = self.document["paths"].as_object().expect("paths");
        let matches = |template: &str| {
            let template: Vec<&str> = template.split('/').collect();
            template.len() == segments.len()
                && template.iter().zip(&segments).all(|(t, s)| t == s || (t.starts_with('{') && !s.is_empty()))
        };
        let (_, item) = paths.iter().find(|(template, _)| matches(template))?;
        item.get(method.to_ascii_lowercase())
    }

    /// Holds a value against a shape: by JSON Schema 2020-12, of whose alternatives exactly one may match.
    #[track_caller]
    fn check(&self, name: &str, value: &Value, context: &str) {
        if let Err(error) = self.shapes.validate(value, self.places[name]) {
            panic!("{context} is not what is described as {name}: {error}");
        }
    }
}

/// The name of a shape that others refer to.
#[track_caller]
pub(crate) fn shape_name(schema: &Value) -> &str {
    let reference = schema["$ref"].as_str().and_then(|reference| reference.strip_prefix("#/components/schemas/"));
    reference.unwrap_or_else(|| panic!("{schema} is no shape with a name"))
}

/// Holds a value against a shape of the description.
#[track_caller]
pub(crate) fn check_shape(name: &str, value: &Value, context: &str) {
    Described::get().check(name, value, context);
}

/// Whatever a route answers stands in its description: the status, the media type, the shape, and the code of a problem.
/// So does a body that it took.
#[track_caller]
fn check_documented(method: &str, path: &str, sent: Option<&[u8]>, answer: &Answer) {
    assert!(answer.header("x-request-id").is_some(), "{method} {path} without a request id");
    // A preflight is answered for browsers only.
    if method == "OPTIONS" && answer.status == 200 {
        return;
    }
    let described = Described::get();
    let context = format!("the answer {} of {method} {path}", answer.status);
    let media = answer.header("content-type").map(|media| media.split(';').next().expect("split has a first part"));
    let is_packed = answer.header("content-encoding").is_some();
    let is_binary = matches!(media, Some("application/cbor" | "application/octet-stream"));
    if !answer.body.is_empty() && !is_packed && !is_binary && !path.starts_with("/docs") {
        assert_eq!(answer.body.last(), Some(&b'\n'), "{context} has no newline at its end");
    }
    let is_problem = media == Some("application/problem+json");
    let body = (!answer.body.is_empty() && !is_packed && (is_problem || media == Some("application/json")))
        .then(|| answer.json());
    let Some(operation) = described.operation(if method == "HEAD" { "GET" } else { method }, path) else {
        assert!(matches!(answer.status, 401 | 403 | 404 | 405), "{method} {path} is not described");
        if let Some(body) = &body {
            described.check("Problem", body, &context);
        }
        return;
    };
    let response = &operation["responses"][answer.status.to_string()];
    assert!(response.is_object(), "{context} is not described: {}", String::from_utf8_lossy(&answer.body));
    let Some(media) = media else {
        assert!(answer.body.is_empty(), "{context} has no type");
        return;
    };
    let content = &response["content"][media];
    assert!(content.is_object(), "{context} is {media}, which is not described");
    // The description itself is described elsewhere.
    if let Some(body) = body.as_ref().filter(|_| path != "/openapi.json" || is_problem) {
        described.check(shape_name(&content["schema"]), body, &context);
    }
    if let (Some(problem), true) = (&body, is_problem) {
        let code = problem["code"].as_str().expect("its shape was checked");
        assert!(content["examples"][code].is_object(), "{context}: {code} is not described");
        assert_eq!(problem["status"], answer.status, "{problem}");
        assert_eq!(problem["type"], format!("/problems/{code}"), "{problem}");
        assert!(problem["detail"].as_str().is_some_and(|detail| detail.len() > 10), "{problem}");
    }
    // Where many worlds are spoken to, each may have been sent something else, and answers for itself.
    let sent = sent.filter(|sent| answer.status < 300 && !sent.is_empty() && path != "/v1/commands");
    let schema = operation.pointer("/requestBody/content/application~1json/schema");
    if let (Some(schema), Some(Ok(sent))) = (schema, sent.map(serde_json::from_slice::<Value>)) {
        described.check(shape_name(schema), &sent, &format!("the body that {method} {path} took"));
    }
}

/// A service for tests that do not change its configuration and use worlds of their own.
pub(crate) fn shared() -> Arc<Service> {
    static SHARED: OnceLock<Arc<Service>> = OnceLock::new();
    Arc::clone(SHARED.get_or_init(|| Arc::new(Service::start())))
}
