//! Who waits, for how long, and when it is better to say no: every queue of the service has an end.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::Instant;

use crate::server::problem::{Code, Problem};

/// Requests that wait for the same thing.
#[derive(Debug)]
pub(crate) struct Queue {
    /// Since when, in the order of arrival.
    waiting: Mutex<BTreeMap<u64, Instant>>,
    arrived: AtomicU64,
    bounds: Bounds,
}

/// How many may wait, for how long, and for what.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Bounds {
    pub(crate) length: usize,
    pub(crate) patience: Duration,
    /// For the sentence of the refusal.
    pub(crate) what: &'static str,
}

/// One that waits.
struct Waiting<'a> {
    queue: &'a Queue,
    ticket: u64,
}

impl Queue {
    pub(crate) fn new(bounds: Bounds) -> Self {
        Self { waiting: Mutex::default(), arrived: AtomicU64::new(0), bounds }
    }

    /// Waits for something to come, unless too many do so already, or it does not come in time.
    pub(crate) async fn wait<T>(&self, coming: impl Future<Output = T>) -> Result<T, Problem> {
        let _waiting = self.enter()?;
        tokio::time::timeout(self.bounds.patience, coming).await.map_err(|_| {
            let Bounds { patience, what, .. } = self.bounds;
            Problem::new(
                Code::Overloaded,
                format!("{what} was not free within {} ms; try again later", patience.as_millis()),
            )
        })
    }

    /// How many wait, and how long the first of them has waited.
    pub(crate) fn depth_and_age(&self) -> (usize, Duration) {
        let waiting = self.lock();
        (waiting.len(), waiting.first_key_value().map_or(Duration::ZERO, |(_, since)| since.elapsed()))
    }

    pub(crate) fn is_full(&self) -> bool {
        self.lock().len() >= self.bounds.length
    }

    fn enter(&self) -> Result<Waiting<'_>, Problem> {
        let mut waiting = self.lock();
        let Bounds { length, what, .. } = self.bounds;
        if waiting.len() >= length {
            let detail = format!("{length} requests wait for {what} already; try again later");
            return Err(Problem::new(Code::Overloaded, detail));
        }
        let ticket = self.arrived.fetch_add(1, Ordering::Relaxed);
        waiting.insert(ticket, Instant::now());
        Ok(Waiting { queue: self, ticket })
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<u64, Instant>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.queue.lock().remove(&self.ticket);
    }
}

/// Places for work of which only so much may run at once.
#[derive(Debug)]
pub(crate) struct Places {
    free: Arc<Semaphore>,
    pub(crate) queue: Queue,
}

impl Places {
    pub(crate) fn new(count: usize, bounds: Bounds) -> Self {
        Self { free: Arc::new(Semaphore::new(count)), queue: Queue::new(bounds) }
    }

    /// A place that is free now.
    pub(crate) fn try_take(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.free).try_acquire_owned().ok()
    }

    /// A place for the next part of what is under way already, however long that takes.
    pub(crate) async fn wait(&self) -> OwnedSemaphorePermit {
        Arc::clone(&self.free).acquire_owned().await.expect("the semaphore is never closed")
    }

    /// A place, in the order of asking.
    pub(crate) async fn take(&self) -> Result<OwnedSemaphorePermit, Problem> {
        if let Some(place) = self.try_take() {
            return Ok(place);
        }
        let place = self.queue.wait(Arc::clone(&self.free).acquire_owned()).await?;
        Ok(place.expect("the semaphore is never closed"))
    }
}

#[cfg(test)]
mod tests {
    use super::{Bounds, Code, Duration, Places};

    fn places(length: usize, patience: Duration) -> Places {
        Places::new(1, Bounds { length, patience, what: "a place" })
    }

    #[tokio::test]
    async fn who_waits_too_long_is_told_and_who_comes_later_may_be_served() {
        let places = places(2, Duration::from_millis(10));
        let first = places.take().await.expect("free");
        assert_eq!(places.take().await.expect_err("it waited in vain").code, Code::Overloaded);
        assert_eq!(places.queue.depth_and_age(), (0, Duration::ZERO), "nobody waits any more");
        let (second, ()) = tokio::join!(places.take(), async { drop(first) });
        drop(second.expect("its turn"));
    }

    #[tokio::test]
    async fn a_full_queue_refuses_at_once() {
        let places = places(1, Duration::from_mins(1));
        let first = places.take().await.expect("free");
        let (second, third) = tokio::join!(places.take(), async {
            assert!(places.queue.is_full() && places.queue.depth_and_age().0 == 1);
            let refused = places.take().await;
            drop(first);
            refused
        });
        let third = third.expect_err("full");
        assert!(third.code == Code::Overloaded && third.detail.contains("already"), "{}", third.detail);
        drop(second.expect("its turn"));
    }
}
