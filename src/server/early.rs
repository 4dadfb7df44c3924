//! What hyper refuses by itself, before there is a request: it answers with a status and nothing else. Here such an
//! answer is replaced, on its way to the socket, by problem details like every other.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};

use crate::server::App;
use crate::server::problem::{Code, Problem};

/// A socket whose bare refusals are told as problems.
pub(crate) struct Early<S> {
    socket: S,
    app: Arc<App>,
    /// What is written instead of what hyper wrote, and how much of it is out.
    instead: Option<(Vec<u8>, usize)>,
}

impl<S> Early<S> {
    pub(crate) fn new(socket: S, app: Arc<App>) -> Self {
        Self { socket, app, instead: None }
    }

    /// Whether this is an answer of hyper's own: every answer of the service has a request id.
    fn is_bare(bytes: &[u8]) -> bool {
        bytes.starts_with(b"HTTP/1.1 4") && !bytes.windows(12).any(|window| window == b"x-request-id")
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

impl<S: AsyncWrite + Unpin> Early<S> {
    /// Writes what is written instead, to its end.
    fn poll_instead(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        if let Some((bytes, written)) = &mut self.instead {
            while *written < bytes.len() {
                *written += ready!(Pin::new(&mut self.socket).poll_write(context, &bytes[*written..]))?;
            }
        }
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Early<S> {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if self.instead.is_none() {
            if !Self::is_bare(bytes) {
                return Pin::new(&mut self.socket).poll_write(context, bytes);
            }
            self.replace(bytes);
        }
        ready!(self.poll_instead(context))?;
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let bare = slices.iter().find(|slice| !slice.is_empty()).filter(|slice| Self::is_bare(slice));
        match bare {
            None if self.instead.is_none() => Pin::new(&mut self.socket).poll_write_vectored(context, slices),
            Some(first) => self.poll_write(context, first),
            None => Poll::Ready(Ok(slices.iter().map(|slice| slice.len()).sum())),
        }
    }

    fn is_write_vectored(&self) -> bool {
        self.socket.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_shutdown(context)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Early<S> {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, into: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.socket).poll_read(context, into)
    }
}
