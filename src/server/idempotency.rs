//! `Idempotency-Key`: a change that is sent again is done once, and answered twice.
//!
//! Each world keeps the answers of its last accepted changes that had a key. A refused change leaves nothing, since it
//! changed nothing.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, Uri, header};
use sha2::{Digest, Sha256};

use crate::server::encoding::Encoding;
use crate::server::problem::{Code, Problem};
use crate::server::reply::Reply;

pub(crate) const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
/// Says that an answer is that of an earlier request.
pub(crate) const IDEMPOTENCY_REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");

/// The longest key: names of any kind fit.
const KEY_BYTES_MAX: usize = 255;
/// The most bytes of answers that a world keeps: a thousand ticks of a few particles each.
const KEPT_BYTES_MAX: usize = 4 << 20;
/// The largest answer to a change with a key: four of them are kept at least.
pub(crate) const KEPT_ANSWER_BYTES_MAX: u64 = 1 << 20;
/// What keeping an answer takes besides its body; answers without particles in them are smaller.
pub(crate) const ENTRY_BYTES: usize = 512;

type Hash = [u8; 32];

/// The key of a request, and what the request is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Key {
    name: Hash,
    request: Hash,
}

impl Key {
    /// `None` without the header. The body may come in pieces.
    pub(crate) fn of(
        method: &Method,
        uri: &Uri,
        headers: &HeaderMap,
        answer: Encoding,
        body: &[Bytes],
    ) -> Result<Option<Self>, Problem> {
        let mut names = headers.get_all(IDEMPOTENCY_KEY).iter();
        let Some(name) = names.next() else { return Ok(None) };
        if name.is_empty() || name.len() > KEY_BYTES_MAX || names.next().is_some() {
            let detail = format!("a request has one Idempotency-Key, of 1 to {KEY_BYTES_MAX} bytes");
            return Err(Problem::new(Code::InvalidIdempotencyKey, detail));
        }
        let mut request = Sha256::new();
        let target = uri.path_and_query().map_or("", |target| target.as_str());
        for part in [method.as_str().as_bytes(), target.as_bytes(), answer.content_type().as_bytes()]
            .into_iter()
            .chain(headers.get_all(header::IF_MATCH).iter().map(HeaderValue::as_bytes))
        {
            request.update((part.len() as u64).to_le_bytes());
            request.update(part);
        }
        request.update(body.iter().map(|piece| piece.len() as u64).sum::<u64>().to_le_bytes());
        for piece in body {
            request.update(piece);
        }
        Ok(Some(Self { name: Sha256::digest(name.as_bytes()).into(), request: request.finalize().into() }))
    }

    /// For a removal, whose answer outlives the world: a key of that world alone.
    pub(crate) fn of_removal(&self) -> Self {
        let name = Sha256::new().chain_update(self.name).chain_update(self.request).finalize();
        Self { name: name.into(), request: self.request }
    }

    /// A name for the world that a request with this key creates: the same each time, and not to be guessed.
    pub(crate) fn world_name(&self, secret: u64) -> String {
        let name = Sha256::new().chain_update(secret.to_le_bytes()).chain_update(self.name).finalize();
        let half: [u8; 16] = std::array::from_fn(|k| name[k]);
        format!("w{:032x}", u128::from_be_bytes(half))
    }
}

/// The kept answers of one world. Takes no memory before the first key.
#[derive(Debug, Clone)]
pub(crate) struct Answers {
    kept: Arc<Mutex<Option<Box<Kept>>>>,
    limits: KeyLimits,
}

/// How many answers a world keeps, and how long.
#[derive(Debug, Clone, Copy)]
pub(crate) struct KeyLimits {
    pub(crate) count: usize,
    pub(crate) lifetime: Duration,
}

#[derive(Debug, Default)]
struct Kept {
    by_name: HashMap<Hash, Entry>,
    /// Those with an answer, in the order of answering.
    answered: VecDeque<(Hash, Instant)>,
    bytes: usize,
}

#[derive(Debug)]
struct Entry {
    request: Hash,
    /// `None`: it is in flight.
    reply: Option<Reply>,
}

/// What becomes of a request with a key.
#[derive(Debug)]
pub(crate) enum Attempt {
    /// It is the first one.
    First(Claim),
    /// It was answered before.
    Again(Reply),
}

impl Attempt {
    /// The answer of one that was answered before.
    pub(crate) fn reply(self) -> Reply {
        match self {
            Self::Again(reply) => reply,
            Self::First(_) => unreachable!("the first attempt has no answer yet"),
        }
    }
}

/// The right to be the one request with a key; given up when it is dropped without an answer.
#[derive(Debug)]
pub(crate) struct Claim {
    answers: Answers,
    name: Hash,
    is_answered: bool,
}

impl Answers {
    pub(crate) fn new(limits: KeyLimits) -> Self {
        Self { kept: Arc::default(), limits }
    }

    /// What becomes of a request with this key.
    pub(crate) fn attempt(&self, key: &Key) -> Result<Attempt, Problem> {
        let mut kept = self.lock();
        let kept = kept.get_or_insert_default();
        kept.forget(self.limits);
        match kept.by_name.get(&key.name) {
            Some(Entry { request, .. }) if *request != key.request => {
                let detail = "this Idempotency-Key came with another request before: each intent has a key of its own";
                Err(Problem::new(Code::IdempotencyKeyReused, detail))
            }
            Some(Entry { reply: Some(reply), .. }) => Ok(Attempt::Again(reply.clone().replayed())),
            Some(Entry { reply: None, .. }) => {
                let detail = "the request with this Idempotency-Key is in flight; ask again when it has ended";
                Err(Problem::new(Code::IdempotencyKeyInFlight, detail))
            }
            None => {
                kept.by_name.insert(key.name, Entry { request: key.request, reply: None });
                Ok(Attempt::First(Claim { answers: self.clone(), name: key.name, is_answered: false }))
            }
        }
    }

    /// Bytes of those that are not too old, for the accounting of the world.
    pub(crate) fn bytes(&self) -> u64 {
        self.lock().as_mut().map_or(0, |kept| {
            kept.forget(self.limits);
            kept.bytes as u64
        })
    }

    fn lock(&self) -> MutexGuard<'_, Option<Box<Kept>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Claim {
    /// Keeps the answer of the change that was made.
    pub(crate) fn answered(mut self, reply: &Reply) {
        self.is_answered = true;
        let mut kept = self.answers.lock();
        let kept = kept.get_or_insert_default();
        if let Some(entry) = kept.by_name.get_mut(&self.name) {
            entry.reply = Some(reply.clone());
            kept.bytes += reply.content.len() + ENTRY_BYTES;
            kept.answered.push_back((self.name, Instant::now()));
            kept.forget(self.answers.limits);
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        if !self.is_answered
            && let Some(kept) = self.answers.lock().as_mut()
        {
            kept.by_name.remove(&self.name);
        }
    }
}

impl Kept {
    /// Forgets what is too old, and what is too much.
    fn forget(&mut self, limits: KeyLimits) {
        while let Some((name, since)) = self.answered.front()
            && (since.elapsed() > limits.lifetime || self.answered.len() > limits.count || self.bytes > KEPT_BYTES_MAX)
        {
            let entry = self.by_name.remove(name);
            self.bytes -= entry.and_then(|entry| entry.reply).map_or(0, |reply| reply.content.len() + ENTRY_BYTES);
            self.answered.pop_front();
        }
    }
}
