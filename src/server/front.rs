//! What stands in front of every route: request ids, the sizes of heads, panics, counting, one line in the log.

use std::collections::hash_map::RandomState;
use std::convert::Infallible;
use std::hash::{BuildHasher, Hasher};
use std::panic::AssertUnwindSafe;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::Instant;

use axum::Router;
use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, Method, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use tower::Service;

use crate::server::App;
use crate::server::access::admit;
use crate::server::config::{Config, HEADER_BYTES_MAX, URI_BYTES_MAX};
use crate::server::metrics::Template;
use crate::server::problem::{Code, Problem};

pub(crate) const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
const TRACEPARENT: HeaderName = HeaderName::from_static("traceparent");
/// The target of the log lines of requests, one for each.
pub(crate) const ACCESS: &str = "pointmass::access";
/// What is counted and logged of a request whose client did not wait for the answer.
const CLIENT_WENT_AWAY: u16 = 499;
/// Longer ids of clients are replaced: they are copied into answers and logs.
const REQUEST_ID_BYTES_MAX: usize = 128;

/// The whole service, as a function of requests.
///
/// What stands in front of the routes is called directly: as layers of the router, each would cost every request about
/// half a microsecond.
#[derive(Debug, Clone)]
pub struct Front {
    app: Arc<App>,
    routes: Router,
}

impl Front {
    pub(crate) fn new(app: &Arc<App>, routes: Router) -> Self {
        Self { app: Arc::clone(app), routes }
    }

    /// Answers a request, whatever happens.
    pub(crate) async fn answer(mut self, request: Request) -> Response {
        let app = Arc::clone(&self.app);
        let id = match request.headers().get(REQUEST_ID) {
            Some(id) if (1..=REQUEST_ID_BYTES_MAX).contains(&id.len()) => id.clone(),
            Some(_) | None => app.request_ids.next(),
        };
        let route = app.metrics.template(request.uri().path());
        let mut seen = Seen {
            app: &app,
            began: Instant::now(),
            method: request.method().clone(),
            uri: request.uri().clone(),
            route,
            id: id.clone(),
            trace: request.headers().get(TRACEPARENT).cloned(),
            status: None,
        };
        let _in_flight = app.in_flight.enter();
        let admitted = check_head(&app.config, &request);
        let mut response = match admitted.and_then(|()| admit(&app, &request, route.map(Template::text))) {
            Ok(()) => unless_it_panics(self.routes.call(request)).await,
            Err(problem) => problem.into_response(),
        };
        seen.status = Some(response.status());
        response.headers_mut().insert(REQUEST_ID, id);
        response
    }
}

/// A request that is counted, timed and logged when it ends, also where its client goes away.
struct Seen<'a> {
    app: &'a App,
    began: Instant,
    method: Method,
    uri: Uri,
    route: Option<&'a Template>,
    id: HeaderValue,
    trace: Option<HeaderValue>,
    status: Option<StatusCode>,
}

impl Drop for Seen<'_> {
    fn drop(&mut self) {
        let Self { app, method, route, .. } = self;
        let status = self.status.map_or(CLIENT_WENT_AWAY, |status| status.as_u16());
        let duration = self.began.elapsed();
        app.metrics.answered(method, *route, status, duration);
        let id = self.id.to_str().unwrap_or("not ASCII");
        let (trace_id, parent_id) = self.trace.as_ref().and_then(trace_and_parent).unzip();
        let route = route.map(Template::text);
        // No query, which may hold anything, no header and no body.
        tracing::info!(
            target: ACCESS,
            request_id = id,
            trace_id,
            parent_id,
            %method,
            path = self.uri.path(),
            route,
            status,
            duration_us = u64::try_from(duration.as_micros()).unwrap_or(u64::MAX),
        );
        if self.status.is_some_and(|status| status.is_server_error() && status != StatusCode::SERVICE_UNAVAILABLE) {
            tracing::error!(request_id = id, trace_id, %method, route, status, "defect");
        }
    }
}

impl tower::Service<Request> for Front {
    type Response = Response;
    type Error = Infallible;
    type Future = Pin<Box<dyn Future<Output = Result<Response, Infallible>> + Send>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, request: Request) -> Self::Future {
        let front = self.clone();
        Box::pin(async move { Ok(front.answer(request).await) })
    }
}

/// A panic is a defect; it costs one request.
async fn unless_it_panics(answer: impl Future<Output = Result<Response, Infallible>>) -> Response {
    let mut answer = std::pin::pin!(answer);
    std::future::poll_fn(|context| {
        // The answer is not polled again; a world that it had half changed knows, and is quarantined.
        match std::panic::catch_unwind(AssertUnwindSafe(|| answer.as_mut().poll(context))) {
            Ok(poll) => poll.map(|Ok(response)| response),
            Err(panic) => {
                let text = panic.downcast_ref::<&str>().copied();
                let text = text.or_else(|| panic.downcast_ref::<String>().map(String::as_str));
                tracing::error!(message = text.unwrap_or("not a text"), "panic");
                Poll::Ready(Problem::plain(Code::InternalError).into_response())
            }
        }
    })
    .await
}

/// The ids of a trace and of the span that asks (W3C Trace Context).
fn trace_and_parent(header: &HeaderValue) -> Option<(&str, &str)> {
    let mut parts = header.to_str().ok()?.split('-');
    let (version, trace, parent, flags) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
    let is_hex =
        |text: &str, length| text.len() == length && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
    let is_id = |text: &str, length| is_hex(text, length) && text.bytes().any(|b| b != b'0');
    // Later versions may have more behind the flags.
    let is_known = is_hex(version, 2) && version != "ff" && (version != "00" || parts.next().is_none());
    (is_known && is_id(trace, 32) && is_id(parent, 16) && is_hex(flags, 2)).then_some((trace, parent))
}

/// Refuses a path or headers that are larger than any that the service has a use for.
fn check_head(config: &Config, request: &Request) -> Result<(), Problem> {
    let path = request.uri().path_and_query().map_or(0, |path| path.as_str().len());
    if path > config.uri_bytes_max {
        let detail = format!(
            "the path with its parameters has {path} bytes, the most is {} (--{URI_BYTES_MAX})",
            config.uri_bytes_max
        );
        return Err(Problem::new(Code::UriTooLong, detail));
    }
    let headers = request.headers();
    let bytes: usize = headers.iter().map(|(name, value)| name.as_str().len() + value.len()).sum();
    if bytes > config.header_bytes_max {
        let detail =
            format!("the headers have {bytes} bytes, the most is {} (--{HEADER_BYTES_MAX})", config.header_bytes_max);
        return Err(Problem::new(Code::HeadersTooLarge, detail));
    }
    Ok(())
}

/// How many requests, or answers, have begun and not ended.
#[derive(Debug, Clone, Default)]
pub(crate) struct InFlight(Arc<Counted>);

#[derive(Debug, Default)]
struct Counted {
    count: AtomicU64,
    ended: tokio::sync::Notify,
}

/// Counts one while it lives: also one whose client goes away.
#[derive(Debug)]
pub(crate) struct Entered(InFlight);

impl InFlight {
    pub(crate) fn enter(&self) -> Entered {
        self.0.count.fetch_add(1, Ordering::SeqCst);
        Entered(self.clone())
    }

    pub(crate) fn count(&self) -> u64 {
        self.0.count.load(Ordering::SeqCst)
    }

    /// Waits until there is none.
    pub(crate) async fn none(&self) {
        loop {
            let ended = self.0.ended.notified();
            if self.count() == 0 {
                return;
            }
            ended.await;
        }
    }
}

impl Drop for Entered {
    fn drop(&mut self) {
        if self.0.0.count.fetch_sub(1, Ordering::SeqCst) == 1 {
            self.0.0.ended.notify_one();
        }
    }
}

/// Ids for requests that bring none: a random word for the process, and a count.
#[derive(Debug)]
pub(crate) struct RequestIds {
    process: String,
    count: AtomicU64,
}

impl Default for RequestIds {
    fn default() -> Self {
        Self { process: format!("{:016x}-", random()), count: AtomicU64::new(0) }
    }
}

impl RequestIds {
    pub(crate) fn next(&self) -> HeaderValue {
        let count = self.count.fetch_add(1, Ordering::Relaxed);
        // Without the machinery of format!, which takes three times as long.
        let id = [self.process.as_str(), &count.to_string()].concat();
        HeaderValue::try_from(id).expect("hexadecimal digits")
    }
}

/// From the keys that the standard library takes from the system.
pub(crate) fn random() -> u64 {
    RandomState::new().build_hasher().finish()
}
