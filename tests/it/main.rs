//! All integration tests in one binary: it links once.

#![expect(clippy::disallowed_methods, reason = "powers of two are exact everywhere")]
#![expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "scenes are made of random bits")]

/// Who may come in.
mod access;
/// What answers look like: encodings, packing, large ones on their way.
mod answers;
/// Bodies in CBOR: the same requests, the same refusals.
mod cbor;
/// What changed since when.
mod changes;
/// The binary as its user meets it.
mod command_line;
/// Several commands in one request.
mod commands;
/// Many clients at once.
mod concurrency;
/// Clients that are slow or cut short.
mod connections;
/// What each route answers when all is well.
mod contract;
/// The digest of a world: equal if and only if its future is.
mod digest;
/// The page at `/docs`, and the way to it.
mod docs;
/// Drag and gravitation, and what came with them, over HTTP.
mod forces;
/// The stepped integrators as the book writes them.
mod formulas;
/// Pinned digests of seeded scenes: the same bits on every machine, and from one version to the next.
mod golden;
/// The service against the library, to the bit.
mod lockstep;
/// The book's integrators against a transcription of their equations.
mod naive;
/// The OpenAPI description.
mod openapi;
/// More work than there is room for.
mod overload;
/// Motion against closed forms, and the rules of the engine.
mod physics;
/// README.md and the pages of docs/ keep their word.
mod readme;
/// Every refusal as data.
mod refusals;
/// Changes that are sent again.
mod retries;
/// A service on a real socket, and a plain client.
mod service;
/// What a scene does not need is not done, and leaves no trace in its bits.
mod skips;
/// Worlds written down and read back.
mod snapshot;
/// Scenes that break the methods of the textbook, and the tolerances of docs/stability.md.
mod stability;
/// Worlds followed live.
mod streams;
/// The tree itself.
mod tidy;
