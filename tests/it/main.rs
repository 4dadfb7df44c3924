//! All integration tests in one binary: it links once.

/// Who may come in.
mod access;
/// Many clients at once.
mod concurrency;
/// Clients that are slow or cut short.
mod connections;
/// What each route answers when all is well.
mod contract;
/// The service against the library, to the bit.
mod lockstep;
/// Every refusal as data.
mod refusals;
/// A service on a real socket, and a plain client.
mod service;
