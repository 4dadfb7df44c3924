//! What stands between hyper and a socket: deadlines for clients that are silent, slow or do not read, and problem
//! details for what hyper refuses by itself, before there is a request.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep};

use crate::server::App;
use crate::server::problem::{Code, Problem};

/// A socket with deadlines, whose bare refusals are told as problems.
pub(crate) struct Socket<S> {
    inner: S,
    app: Arc<App>,
    activity: Arc<Activity>,
    /// How many requests had begun when this was last looked at.
    begun: usize,
    waits_for: Waiting,
    /// Until then something has to arrive.
    read_by: Deadline,
    /// Until then some of an answer has to be taken.
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

/// How many requests of a connection began, and how many of them are in flight.
#[derive(Debug, Default)]
pub(crate) struct Activity {
    begun: AtomicUsize,
    in_flight: AtomicUsize,
}

/// One request of a connection while it lives.
pub(crate) struct Active(Arc<Activity>);

impl Activity {
    pub(crate) fn begin(self: &Arc<Self>) -> Active {
        self.begun.fetch_add(1, Ordering::Relaxed);
        self.in_flight.fetch_add(1, Ordering::Relaxed);
        Active(Arc::clone(self))
    }
}

impl Drop for Active {
    fn drop(&mut self) {
        self.0.in_flight.fetch_sub(1, Ordering::Relaxed);
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

impl<S> Socket<S> {
    pub(crate) fn new(inner: S, app: Arc<App>, activity: Arc<Activity>) -> Self {
        Self {
            inner,
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

    /// Whether a request is in flight. What was waited for before the last one began is over.
    fn is_busy(&mut self) -> bool {
        let begun = self.activity.begun.load(Ordering::Relaxed);
        let is_busy = self.activity.in_flight.load(Ordering::Relaxed) > 0;
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
            return poll;
        }
        if poll.is_ready() {
            // Under HTTP/2 bytes need not be a request: what counts there is that one begins.
            if self.is_http2 == Some(false) && self.waits_for != Waiting::Headers {
                self.waits_for = Waiting::Headers;
                self.read_by.set(self.app.config.header_timeout());
            }
            return poll;
        }
        if self.waits_for == Waiting::Nothing {
            self.waits_for = Waiting::Request;
            self.read_by.set(self.app.config.idle_timeout());
        }
        self.read_by.poll(context, "no request came in time")
    }

    /// Sets and holds the deadline of writing: some of it has to be taken.
    fn check_writing<T>(&mut self, context: &mut Context<'_>, poll: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if poll.is_ready() {
            self.write_by.clear();
            if !self.is_busy() && self.waits_for != Waiting::Headers {
                // The end of an answer, maybe. hyper, which asked for bytes before, need not ask again: so the timer is
                // started here, and has it ask.
                self.waits_for = Waiting::Request;
                self.read_by.set(self.app.config.idle_timeout());
                let _asks_later = self.read_by.poll::<()>(context, "");
            }
            return poll;
        }
        if self.write_by.at.is_none() {
            self.write_by.set(self.app.config.write_timeout());
        }
        self.write_by.poll(context, "the client does not read its answer")
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

impl<S: AsyncWrite + Unpin> Socket<S> {
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

impl<S: AsyncWrite + Unpin> AsyncWrite for Socket<S> {
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
        Pin::new(&mut self.inner).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(context)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Socket<S> {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let before = into.filled().len();
        let poll = Pin::new(&mut self.inner).poll_read(context, into);
        self.check_reading(context, poll, &into.filled()[before..])
    }
}
