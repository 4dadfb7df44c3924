//! What an answer says: text that is there already, and columns that are written as they are sent.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes};
use hyper::body::{Frame, SizeHint};
use serde::Serialize;
use tokio::sync::mpsc;
use tokio::sync::mpsc::OwnedPermit;
use tokio::sync::mpsc::error::TrySendError;

use crate::server::coding::{Coding, Packer};
use crate::server::columns::{self, Columns, PIECE_BYTES};
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
    /// Packed so.
    pub(crate) coding: Option<Coding>,
    /// Whose compute pool writes what is written as it is sent.
    shared: Option<Arc<Shared>>,
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
        Self { encoding: Encoding::Json, parts: VecDeque::new(), coding: None, shared: None }
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
                Part::Columns(mut later) => {
                    while later.write_on(usize::MAX, &mut whole) {
                        std::iter::from_fn(|| later.lend()).for_each(|lent| whole.extend_from_slice(&lent));
                    }
                }
            }
        }
        Self { parts: [Part::Text(whole.into())].into(), shared: None, ..self }
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

    /// Packed, if it is text of a size that is worth it.
    pub(crate) fn coded(mut self, coding: Option<Coding>, shared: &Arc<Shared>) -> Self {
        let is_large = self.len() >= PACKED_BYTES_MIN || self.shared.is_some();
        if self.encoding == Encoding::Json && is_large && coding.is_some() {
            self.coding = coding;
            self.shared = Some(Arc::clone(shared));
        }
        self
    }

    /// With a text behind it.
    pub(crate) fn followed_by(mut self, text: &'static str) -> Self {
        self.parts.push_back(Part::Text(Bytes::from_static(text.as_bytes())));
        self
    }

    /// All of it, written in the compute pool where that takes a while.
    pub(crate) async fn into_bytes(mut self) -> Option<Bytes> {
        if let (None, [Part::Text(text)]) = (&self.shared, self.parts.make_contiguous()) {
            return Some(std::mem::take(text));
        }
        let (sender, mut receiver) = mpsc::channel(1);
        let (is_sent, whole) = tokio::join!(async move { self.send(&sender).await }, async {
            let mut whole = Vec::new();
            while let Some(piece) = receiver.recv().await {
                whole.extend_from_slice(&piece.ok()?);
            }
            Some(whole.into())
        });
        whole.filter(|_| is_sent)
    }

    /// Sends it, a piece being written while the one before is taken; whether somebody took all of it.
    pub(crate) async fn send(self, sender: &mpsc::Sender<io::Result<Bytes>>) -> bool {
        let Some(shared) = self.shared else {
            for part in self.parts {
                if let Part::Text(text) = part
                    && sender.send(Ok(text)).await.is_err()
                {
                    return false;
                }
            }
            return true;
        };
        Making::new(self.parts, self.coding).send(&shared, sender).await
    }

    pub(crate) fn into_body(mut self) -> Body {
        if self.shared.is_some() {
            let (sender, receiver) = mpsc::channel(2);
            tokio::spawn(async move { self.send(&sender).await });
            return Body::new(Pieces(receiver));
        }
        match self.parts.make_contiguous() {
            [] => Body::empty(),
            [Part::Text(text)] => Body::from(std::mem::take(text)),
            _ => Body::new(Texts(self.parts)),
        }
    }
}

/// Smaller answers are sent as fast as they are packed.
const PACKED_BYTES_MIN: usize = 16 << 10;

/// Makes a [`Content`]: what is written to its writer, and columns.
#[derive(Debug)]
pub(crate) struct Composer {
    pub(crate) writer: Writer,
    parts: VecDeque<Part>,
    shared: Option<Arc<Shared>>,
}

impl From<Writer> for Composer {
    fn from(writer: Writer) -> Self {
        Self { writer, parts: VecDeque::new(), shared: None }
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
        let later =
            Later { columns: R::any_columns(world.clone(), columns), writer: self.writer.clone(), charge: None };
        self.shared = Some(Arc::clone(shared));
        self.parts.push_back(Part::Columns(Box::new(later)));
    }

    /// The parts of another content.
    pub(crate) fn append(&mut self, content: Content) {
        self.flush();
        self.parts.extend(content.parts);
        self.shared = self.shared.take().or(content.shared);
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
        Content { encoding: self.writer.encoding, parts: self.parts, coding: None, shared: self.shared }
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

/// Bytes of a world as it was.
struct Lent<R: WireReal> {
    bytes: columns::Lent<R>,
    #[expect(dead_code, reason = "lives as long as the bytes")]
    charge: Option<Arc<Charge>>,
}

impl<R: WireReal> AsRef<[u8]> for Lent<R> {
    fn as_ref(&self) -> &[u8] {
        self.bytes.as_ref()
    }
}

impl Later {
    /// The next bytes, if they are there already.
    fn lend(&mut self) -> Option<Bytes> {
        let (encoding, charge) = (self.writer.encoding, self.charge.clone());
        match &mut self.columns {
            AnyColumns::Single(world, columns) => {
                columns.lend(world, encoding).map(|bytes| Bytes::from_owner(Lent { bytes, charge }))
            }
            AnyColumns::Double(world, columns) => {
                columns.lend(world, encoding).map(|bytes| Bytes::from_owner(Lent { bytes, charge }))
            }
        }
    }

    /// Appends about so many bytes, up to some that are lent; whether there is more.
    fn write_on(&mut self, bytes: usize, into: &mut Vec<u8>) -> bool {
        let Self { columns, writer, .. } = self;
        std::mem::swap(into, &mut writer.bytes);
        let more = match columns {
            AnyColumns::Single(world, columns) => columns.write(world, bytes, writer),
            AnyColumns::Double(world, columns) => columns.write(world, bytes, writer),
        };
        std::mem::swap(into, &mut writer.bytes);
        more
    }
}

/// An answer that is made as it is sent.
struct Making {
    parts: VecDeque<Part>,
    packer: Option<Packer>,
    /// Room of pieces that were sent: memory that is fresh from the system takes longer than what is written to it.
    rooms: std::sync::mpsc::Receiver<Vec<u8>>,
    leaving: std::sync::mpsc::Sender<Vec<u8>>,
}

/// A piece that gives its room back when it was sent.
struct Piece {
    bytes: Vec<u8>,
    leaving: std::sync::mpsc::Sender<Vec<u8>>,
}

impl AsRef<[u8]> for Piece {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for Piece {
    fn drop(&mut self) {
        // After the last one nobody needs it.
        let _freed = self.leaving.send(std::mem::take(&mut self.bytes));
    }
}

/// How sending some pieces ended.
enum Sent {
    /// There are more, once somebody took those.
    Some,
    All,
    /// There is nobody to take them, or they cannot be made.
    Broken,
}

/// Pieces that are made one after the other where they are taken as fast, before others get their turn.
const PIECES_TOGETHER: usize = 8;

impl Making {
    fn new(parts: VecDeque<Part>, coding: Option<Coding>) -> Self {
        let (leaving, rooms) = std::sync::mpsc::channel();
        Self { parts, packer: coding.map(Packer::new), rooms, leaving }
    }

    /// The next piece; empty after the last one.
    fn piece(&mut self) -> io::Result<Bytes> {
        loop {
            if let Some(Part::Columns(later)) = self.parts.front_mut()
                && let Some(lent) = later.lend()
            {
                return Ok(lent);
            }
            let plain = self.plain();
            let packed = match self.packer.take() {
                None => return Ok(Bytes::from_owner(plain)),
                Some(packer) if plain.bytes.is_empty() => return Ok(packer.finish()?.into()),
                Some(packer) => self.packer.insert(packer).pack(&plain.bytes)?,
            };
            if !packed.is_empty() {
                return Ok(packed.into());
            }
        }
    }

    /// Makes all pieces in the compute pool, for as long as somebody takes them.
    async fn send(mut self, shared: &Arc<Shared>, sender: &mpsc::Sender<io::Result<Bytes>>) -> bool {
        loop {
            let Ok(permit) = sender.clone().reserve_owned().await else { return false };
            let place = shared.short_places.wait().await;
            let made = tokio::task::spawn_blocking(move || {
                let sent = self.send_some(permit);
                drop(place);
                (self, sent)
            });
            self = match made.await {
                Ok((making, Sent::Some)) => making,
                Ok((_, sent)) => return matches!(sent, Sent::All),
                Err(_) => {
                    // What was sent so far must not look like the whole.
                    let _gone = sender.send(Err(io::Error::other("a defect interrupted the answer"))).await;
                    return false;
                }
            };
        }
    }

    fn send_some(&mut self, mut permit: OwnedPermit<io::Result<Bytes>>) -> Sent {
        for _ in 0..PIECES_TOGETHER {
            let piece = self.piece();
            if piece.as_ref().is_ok_and(Bytes::is_empty) {
                return Sent::All;
            }
            let is_broken = piece.is_err();
            permit = match permit.send(piece).try_reserve_owned() {
                _ if is_broken => return Sent::Broken,
                Ok(permit) => permit,
                Err(TrySendError::Full(_)) => return Sent::Some,
                Err(TrySendError::Closed(_)) => return Sent::Broken,
            };
        }
        Sent::Some
    }

    /// The next piece of what is not packed yet.
    fn plain(&mut self) -> Piece {
        let mut bytes = self.rooms.try_recv().unwrap_or_default();
        bytes.clear();
        // What is written last goes beyond by a block.
        bytes.reserve(PIECE_BYTES + PIECE_BYTES / 4);
        let mut is_lent = false;
        while bytes.len() < PIECE_BYTES
            && !is_lent
            && let Some(part) = self.parts.front_mut()
        {
            let more = match part {
                Part::Text(text) => {
                    let some = text.split_to(text.len().min(PIECE_BYTES));
                    bytes.extend_from_slice(&some);
                    !text.is_empty()
                }
                Part::Columns(later) => {
                    let more = later.write_on(PIECE_BYTES, &mut bytes);
                    is_lent = more && bytes.len() < PIECE_BYTES;
                    more
                }
            };
            if !more {
                self.parts.pop_front();
            }
        }
        Piece { bytes, leaving: self.leaving.clone() }
    }
}

/// Parts that are all there; each keeps its own charge.
#[derive(Debug)]
struct Texts(VecDeque<Part>);

impl hyper::body::Body for Texts {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let part = self.get_mut().0.pop_front();
        Poll::Ready(part.map(|part| match part {
            Part::Text(text) => Ok(Frame::data(text)),
            Part::Columns(_) => unreachable!("columns are sent as pieces"),
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

/// Pieces that are made while others are sent.
#[derive(Debug)]
pub(crate) struct Pieces(pub(crate) mpsc::Receiver<io::Result<Bytes>>);

impl hyper::body::Body for Pieces {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        self.0.poll_recv(context).map(|piece| piece.map(|piece| piece.map(Frame::data)))
    }
}
