//! What an answer says: text that is there already, and columns that are written as they are sent.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use hyper::body::{Frame, SizeHint};
use serde::Serialize;
use tokio::sync::mpsc;

use crate::server::columns::{Columns, PIECE_BYTES};
use crate::server::encoding::{Encoding, Writer};
use crate::server::json::WireReal;
use crate::server::memory::Charge;
use crate::server::slot::{INLINE_WORK, Shared};
use crate::world::World;

/// The body of an answer.
#[derive(Debug, Clone)]
pub(crate) struct Content {
    pub(crate) encoding: Encoding,
    parts: VecDeque<Part>,
}

#[derive(Debug, Clone)]
enum Part {
    Text(Bytes),
    Columns(Box<Later>),
}

/// Columns of a world as it was: whoever changes it meanwhile takes a copy.
#[derive(Debug, Clone)]
struct Later {
    columns: AnyColumns,
    writer: Writer,
    shared: Arc<Shared>,
    /// Lives as long as the world as it was.
    charge: Option<Arc<Charge>>,
}

#[derive(Debug, Clone)]
pub(crate) enum AnyColumns {
    Single(World<f32>, Columns<f32>),
    Double(World<f64>, Columns<f64>),
}

impl Content {
    pub(crate) fn empty() -> Self {
        Self { encoding: Encoding::Json, parts: VecDeque::new() }
    }

    /// One value.
    pub(crate) fn of<T: Serialize>(encoding: Encoding, value: &T) -> Self {
        let mut writer = Writer::new(encoding);
        writer.value(value);
        Composer::from(writer).content()
    }

    /// Bytes, as far as they are known.
    pub(crate) fn len(&self) -> usize {
        self.parts.iter().map(|part| if let Part::Text(text) = part { text.len() } else { 0 }).sum()
    }

    /// The same with all columns written.
    pub(crate) fn whole(self) -> Self {
        let mut whole = Vec::with_capacity(self.len());
        for part in self.parts {
            match part {
                Part::Text(text) => whole.extend_from_slice(&text),
                Part::Columns(mut later) => _ = later.write_on(usize::MAX, &mut whole),
            }
        }
        Self { parts: [Part::Text(whole.into())].into(), ..self }
    }

    /// Gives the charge back when the last byte is on its way.
    pub(crate) fn charged(mut self, charge: Charge) -> Self {
        struct Charged(Bytes, #[expect(dead_code, reason = "lives as long as the bytes")] Arc<Charge>);
        impl AsRef<[u8]> for Charged {
            fn as_ref(&self) -> &[u8] {
                &self.0
            }
        }
        let charge = Arc::new(charge);
        for part in &mut self.parts {
            match part {
                Part::Text(text) => *text = Bytes::from_owner(Charged(std::mem::take(text), Arc::clone(&charge))),
                Part::Columns(later) => later.charge = Some(Arc::clone(&charge)),
            }
        }
        self
    }

    pub(crate) fn into_body(mut self) -> Body {
        match self.parts.make_contiguous() {
            [] => Body::empty(),
            [Part::Text(text)] => Body::from(std::mem::take(text)),
            parts if parts.iter().all(|part| matches!(part, Part::Text(_))) => Body::new(Texts(self.parts)),
            _ => {
                // One piece is sent while the next is written.
                let (sender, receiver) = mpsc::channel(1);
                tokio::spawn(send(self.parts, sender));
                Body::new(Pieces(receiver))
            }
        }
    }
}

/// Makes a [`Content`]: what is written to its writer, and columns.
#[derive(Debug)]
pub(crate) struct Composer {
    pub(crate) writer: Writer,
    parts: VecDeque<Part>,
}

impl From<Writer> for Composer {
    fn from(writer: Writer) -> Self {
        Self { writer, parts: VecDeque::new() }
    }
}

impl Composer {
    pub(crate) fn new(encoding: Encoding) -> Self {
        Writer::new(encoding).into()
    }

    /// Columns of a world as it is now: written at once where they are few.
    pub(crate) fn columns<R: WireReal>(&mut self, world: &World<R>, mut columns: Columns<R>, shared: &Arc<Shared>) {
        if is_few(columns.numbers()) {
            columns.write(world, usize::MAX, &mut self.writer);
            return;
        }
        self.flush();
        let later = Later {
            columns: R::any_columns(world.clone(), columns),
            writer: self.writer.clone(),
            shared: Arc::clone(shared),
            charge: None,
        };
        self.parts.push_back(Part::Columns(Box::new(later)));
    }

    /// The parts of another content.
    pub(crate) fn append(&mut self, content: Content) {
        self.flush();
        self.parts.extend(content.parts);
        if let (Encoding::Json, Some(Part::Text(text))) = (self.writer.encoding, self.parts.back_mut())
            && text.ends_with(b"\n")
        {
            text.truncate(text.len() - 1);
        }
    }

    /// Text ends with a newline: it is read in terminals too.
    pub(crate) fn content(mut self) -> Content {
        if self.writer.encoding == Encoding::Json {
            self.writer.bytes.push(b'\n');
        }
        self.flush();
        Content { encoding: self.writer.encoding, parts: self.parts }
    }

    fn flush(&mut self) {
        if !self.writer.bytes.is_empty() {
            self.parts.push_back(Part::Text(std::mem::take(&mut self.writer.bytes).into()));
        }
    }
}

/// Whether so many numbers are written on the spot, in one piece.
pub(crate) fn is_few(numbers: u64) -> bool {
    numbers <= INLINE_WORK
}

impl Later {
    /// Appends about so many bytes; whether there is more.
    fn write_on(&mut self, bytes: usize, into: &mut Vec<u8>) -> bool {
        let Self { columns, writer, .. } = self;
        let more = match columns {
            AnyColumns::Single(world, columns) => columns.write(world, bytes, writer),
            AnyColumns::Double(world, columns) => columns.write(world, bytes, writer),
        };
        into.append(&mut writer.bytes);
        more
    }

    /// The next piece, written in the compute pool.
    async fn piece(mut self: Box<Self>) -> Option<(Box<Self>, Bytes, bool)> {
        let place = self.shared.short_places.wait().await;
        let written = tokio::task::spawn_blocking(move || {
            let mut piece = Vec::with_capacity(PIECE_BYTES + (64 << 10));
            let more = self.write_on(PIECE_BYTES, &mut piece);
            drop(place);
            (self, piece.into(), more)
        });
        written.await.ok()
    }
}

/// Sends one part after the other, for as long as somebody takes them.
async fn send(parts: VecDeque<Part>, sender: mpsc::Sender<Option<Bytes>>) {
    for part in parts {
        match part {
            Part::Text(text) => {
                if sender.send(Some(text)).await.is_err() {
                    return;
                }
            }
            Part::Columns(mut later) => loop {
                let Some((again, piece, more)) = later.piece().await else {
                    // A defect: what was sent so far must not look like the whole.
                    let _gone = sender.send(None).await;
                    return;
                };
                if sender.send(Some(piece)).await.is_err() {
                    return;
                }
                if !more {
                    break;
                }
                later = again;
            },
        }
    }
}

/// Parts that are all there; each keeps its own charge.
#[derive(Debug)]
struct Texts(VecDeque<Part>);

impl hyper::body::Body for Texts {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let part = self.get_mut().0.pop_front();
        Poll::Ready(part.map(|part| match part {
            Part::Text(text) => Ok(Frame::data(text)),
            Part::Columns(_) => unreachable!("all parts are texts"),
        }))
    }

    fn is_end_stream(&self) -> bool {
        self.0.is_empty()
    }

    fn size_hint(&self) -> SizeHint {
        let len = |part: &Part| if let Part::Text(text) = part { text.len() as u64 } else { 0 };
        SizeHint::with_exact(self.0.iter().map(len).sum())
    }
}

/// Parts that are made while others are sent; `None` is a defect.
#[derive(Debug)]
struct Pieces(mpsc::Receiver<Option<Bytes>>);

impl hyper::body::Body for Pieces {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.0.poll_recv(context).map(|piece| {
            piece.map(|piece| piece.map(Frame::data).ok_or_else(|| axum::Error::new("the answer was interrupted")))
        })
    }
}
