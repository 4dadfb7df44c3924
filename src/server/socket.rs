//! What stands between hyper and a socket: deadlines for clients that are silent, slow or do not read, and problem
//! details for what hyper refuses by itself, before there is a request.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody};
use axum::http::StatusCode;
use axum::response::Response;
use hyper::body::{Frame, SizeHint};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep};

use crate::server::App;
use crate::server::front::Entered;
use crate::server::problem::{Code, Problem};

/// A socket with deadlines, whose bare refusals are told as problems.
pub(crate) struct Socket<S, P> {
    inner: S,
    /// What it holds while it is open.
    _places: P,
    app: Arc<App>,
    activity: Arc<Activity>,
    /// How many requests had begun when this was last looked at.
    begun: usize,
    waits_for: Waiting,
    /// Until then something has to arrive.
    read_by: Deadline,
    /// Until then the first of the answers has to be taken.
    write_by: Deadline,
    /// Once the first bytes are here.
    is_http2: Option<bool>,
    /// What is written instead of what hyper wrote, and how much of it is out.
    instead: Option<(Vec<u8>, usize)>,
}

/// What a connection without a request in flight waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Waiting {
    Nothing,
    /// The first byte of a request.
    Request,
    /// The rest of its headers.
    Headers,
}

/// What a connection is busy with: requests in flight, and answers on their way.
#[derive(Debug, Default)]
pub(crate) struct Activity {
    begun: AtomicUsize,
    in_flight: AtomicUsize,
    /// It speaks another protocol now, which has deadlines of its own.
    is_upgraded: AtomicBool,
    /// The moments until which answers have to be taken.
    answers: Mutex<Vec<(usize, Instant)>>,
}

/// One request of a connection while it lives.
pub(crate) struct Active(Arc<Activity>);

impl Activity {
    pub(crate) fn begin(self: &Arc<Self>) -> Active {
        self.begun.fetch_add(1, Ordering::Relaxed);
        self.in_flight.fetch_add(1, Ordering::Relaxed);
        Active(Arc::clone(self))
    }

    fn answers(&self) -> MutexGuard<'_, Vec<(usize, Instant)>> {
        self.answers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_busy(&self) -> bool {
        self.in_flight.load(Ordering::Relaxed) > 0
            || self.is_upgraded.load(Ordering::Relaxed)
            || !self.answers().is_empty()
    }

    /// The first moment until which one of the answers has to be taken.
    fn write_by(&self) -> Option<Instant> {
        self.answers().iter().map(|(_, moment)| *moment).min()
    }
}

impl Active {
    /// Ends the request; its answer has to be taken within the patience, and as long as it takes at the least rate. One that
    /// is made on the way goes on with the request, and each piece of it has to be taken so.
    pub(crate) fn deliver(self, response: Response, app: &Arc<App>) -> Response {
        if response.status() == StatusCode::SWITCHING_PROTOCOLS {
            self.0.is_upgraded.store(true, Ordering::Relaxed);
        }
        match response.body().size_hint().exact() {
            Some(0) => response,
            Some(bytes) => {
                let whole = Some(Arc::new(Delivery::of(bytes, &self.0, app)));
                response.map(|body| Body::new(Delivered { body, whole, active: None }))
            }
            None => {
                let active = Some((self, Arc::clone(app), app.underway.enter()));
                response.map(|body| Body::new(Delivered { body, whole: None, active }))
            }
        }
    }
}

impl Drop for Active {
    fn drop(&mut self) {
        self.0.in_flight.fetch_sub(1, Ordering::Relaxed);
    }
}

/// An answer on its way: until the last of its bytes is with the system, or the connection is gone.
struct Delivery {
    activity: Arc<Activity>,
    ticket: usize,
    _underway: Entered,
}

impl Delivery {
    fn of(bytes: u64, activity: &Arc<Activity>, app: &App) -> Self {
        let patience =
            app.config.write_timeout() + Duration::from_millis(bytes.saturating_mul(1000) / app.config.write_rate_min);
        let ticket = activity.begun.fetch_add(1, Ordering::Relaxed);
        activity.answers().push((ticket, Instant::now() + patience));
        Self { activity: Arc::clone(activity), ticket, _underway: app.underway.enter() }
    }
}

impl Drop for Delivery {
    fn drop(&mut self) {
        self.activity.answers().retain(|(ticket, _)| *ticket != self.ticket);
    }
}

/// A body whose bytes hold on to its delivery, or each piece to its own.
struct Delivered {
    body: Body,
    whole: Option<Arc<Delivery>>,
    /// The request, for which pieces are made.
    active: Option<(Active, Arc<App>, Entered)>,
}

struct Underway(Bytes, #[expect(dead_code, reason = "lives as long as the bytes")] Option<Arc<Delivery>>);

impl AsRef<[u8]> for Underway {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

impl HttpBody for Delivered {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let frame = ready!(Pin::new(&mut self.body).poll_frame(context));
        let delivery = |bytes| match (&self.whole, &self.active) {
            (None, Some((active, app, _))) => Some(Arc::new(Delivery::of(bytes, &active.0, app))),
            (whole, _) => whole.clone(),
        };
        let held = |data: Bytes| {
            let delivery = delivery(data.len() as u64);
            Bytes::from_owner(Underway(data, delivery))
        };
        Poll::Ready(frame.map(|frame| frame.map(|frame| frame.map_data(held))))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// A moment until which something has to happen. To move it to later is free: the timer finds out when it fires.
#[derive(Default)]
struct Deadline {
    at: Option<Instant>,
    timer: Option<Pin<Box<Sleep>>>,
}

impl Deadline {
    fn set(&mut self, patience: Duration) {
        self.at = Some(Instant::now() + patience);
    }

    fn clear(&mut self) {
        self.at = None;
    }

    /// Ready with an error once it has passed.
    fn poll<T>(&mut self, context: &mut Context<'_>, what: &'static str) -> Poll<io::Result<T>> {
        let Some(at) = self.at else { return Poll::Pending };
        let timer = self.timer.get_or_insert_with(|| Box::pin(tokio::time::sleep_until(at)));
        loop {
            if timer.deadline() > at {
                timer.as_mut().reset(at);
            }
            ready!(timer.as_mut().poll(context));
            if timer.deadline() >= at {
                return Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, what)));
            }
            timer.as_mut().reset(at);
        }
    }
}

impl<S, P> Socket<S, P> {
    pub(crate) fn new(inner: S, places: P, app: Arc<App>, activity: Arc<Activity>) -> Self {
        Self {
            inner,
            _places: places,
            app,
            activity,
            begun: 0,
            waits_for: Waiting::Nothing,
            read_by: Deadline::default(),
            write_by: Deadline::default(),
            is_http2: None,
            instead: None,
        }
    }

    /// Whether this is an answer of hyper's own: every answer of the service has a request id.
    fn is_bare(&self, bytes: &[u8]) -> bool {
        self.is_http2 != Some(true)
            && bytes.starts_with(b"HTTP/1.1 4")
            && !bytes.windows(12).any(|window| window == b"x-request-id")
    }

    /// Whether a request is in flight or an answer on its way. What was waited for before the last one began is over.
    fn is_busy(&mut self) -> bool {
        let begun = self.activity.begun.load(Ordering::Relaxed);
        let is_busy = self.activity.is_busy();
        if is_busy || begun != self.begun {
            self.begun = begun;
            self.waits_for = Waiting::Nothing;
            self.read_by.clear();
        }
        is_busy
    }

    /// Sets and holds the deadlines of reading. A request in flight has others: that of its body, and of its work.
    fn check_reading(
        &mut self,
        context: &mut Context<'_>,
        poll: Poll<io::Result<()>>,
        arrived: &[u8],
    ) -> Poll<io::Result<()>> {
        if !arrived.is_empty() && self.is_http2.is_none() {
            self.is_http2 = Some(arrived.starts_with(b"PRI"));
        }
        if self.is_busy() {
            return if poll.is_ready() { poll } else { self.check_deadlines(context) };
        }
        // Under HTTP/2 bytes need not be a request: what counts there is that one begins.
        if poll.is_ready() && self.is_http2 == Some(false) && self.waits_for != Waiting::Headers {
            self.waits_for = Waiting::Headers;
            self.read_by.set(self.app.config.header_timeout());
        }
        if poll.is_ready() { poll } else { self.check_deadlines(context) }
    }

    /// The same after writing: hyper, which asked for bytes before, need not ask again, so that the timers are started
    /// here, and have it ask.
    fn check_writing<T>(&mut self, context: &mut Context<'_>, poll: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        match self.check_deadlines(context) {
            Poll::Ready(Err(error)) => Poll::Ready(Err(error)),
            Poll::Ready(Ok(())) | Poll::Pending => poll,
        }
    }

    /// Ready with an error once a client was silent for too long, or took too long over an answer.
    fn check_deadlines(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        if !self.is_busy() && self.waits_for == Waiting::Nothing {
            self.waits_for = Waiting::Request;
            self.read_by.set(self.app.config.idle_timeout());
        }
        self.write_by.at = self.activity.write_by();
        if let Poll::Ready(error) = self.write_by.poll(context, "the client does not read its answer") {
            return Poll::Ready(error);
        }
        self.read_by.poll(context, "no request came in time")
    }

    fn replace(&mut self, bytes: &[u8]) {
        let code = match bytes.get(9..12) {
            Some(b"414") => Code::UriTooLong,
            Some(b"431") => Code::HeadersTooLarge,
            _ => Code::MalformedRequest,
        };
        let body = Problem::plain(code).body();
        let id = self.app.request_ids.next();
        let head = format!(
            "HTTP/1.1 {}\r\ncontent-type: application/problem+json\r\nx-request-id: {}\r\ncontent-length: {}\r\nconnection: close\r\n\r\n",
            code.status(),
            id.to_str().unwrap_or_default(),
            body.len()
        );
        self.instead = Some(([head.as_bytes(), &body].concat(), 0));
    }
}

impl<S: AsyncWrite + Unpin, P> Socket<S, P> {
    /// Writes what is written instead, to its end.
    fn poll_instead(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        if let Some((bytes, written)) = &mut self.instead {
            while *written < bytes.len() {
                *written += ready!(Pin::new(&mut self.inner).poll_write(context, &bytes[*written..]))?;
            }
        }
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin, P: Unpin> AsyncWrite for Socket<S, P> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if self.instead.is_none() && self.is_bare(bytes) {
            self.replace(bytes);
        }
        let poll = if self.instead.is_none() {
            Pin::new(&mut self.inner).poll_write(context, bytes)
        } else {
            self.poll_instead(context).map_ok(|()| bytes.len())
        };
        self.check_writing(context, poll)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let first = slices.iter().find(|slice| !slice.is_empty()).map_or(&[][..], |slice| slice);
        if self.instead.is_some() || self.is_bare(first) {
            return self.poll_write(context, first);
        }
        let poll = Pin::new(&mut self.inner).poll_write_vectored(context, slices);
        self.check_writing(context, poll)
    }

    fn is_write_vectored(&self) -> bool {
        self.inner.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let poll = Pin::new(&mut self.inner).poll_flush(context);
        self.check_writing(context, poll)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(context)
    }
}

impl<S: AsyncRead + Unpin, P: Unpin> AsyncRead for Socket<S, P> {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = into.filled().len();
        let poll = Pin::new(&mut self.inner).poll_read(context, into);
        self.check_reading(context, poll, &into.filled()[before..])
    }
}
