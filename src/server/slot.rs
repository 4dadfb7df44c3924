//! One world in the service: who may touch it, when, and on which thread.
//!
//! A world is behind an asynchronous lock that serves in the order of asking. Whoever gets it does one whole operation:
//! at once when it is short, on a thread of the compute pool when it takes a while, to which the lock moves along. A long
//! one first takes one of a few places, before it takes the world: so a long advance takes no thread that answers
//! requests, and however many there are, the pool has threads left for everything else.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Body;
use axum::http::{StatusCode, header};
use axum::response::Response;
use tokio::sync::{OwnedMutexGuard, OwnedSemaphorePermit, Semaphore};

use crate::real::Real;
use crate::server::extract::{Preconditions, Target, etag};
use crate::server::json::WireReal;
use crate::server::memory::{Charge, Memory, PARTICLE_BYTES};
use crate::server::problem::{Code, Problem};
use crate::server::wire::Description;
use crate::threads::Threads;
use crate::world::World;

/// Work, in particle-steps or numbers to write, that is done on the spot: about a tenth of a millisecond. Moving it to
/// another thread and back costs a fifth of that.
const INLINE_WORK: u64 = 20_000;

/// Work that takes one of the places for long advances: some tens of milliseconds.
const LONG_WORK: u64 = 1 << 25;

/// Bytes of a body that are parsed on the spot: about as long.
const INLINE_BYTES: usize = 32 << 10;

/// A world of either precision. The precision of a request is matched here, once.
#[derive(Debug, Clone)]
pub(crate) enum AnySlot {
    Single(Arc<Slot<f32>>),
    Double(Arc<Slot<f64>>),
}

/// Runs an expression with the slot of either precision.
macro_rules! with_slot {
    ($any:expr, $slot:ident => $body:expr) => {
        match $any {
            $crate::server::slot::AnySlot::Single($slot) => $body,
            $crate::server::slot::AnySlot::Double($slot) => $body,
        }
    };
}
pub(crate) use with_slot;

/// One world with its lock.
#[derive(Debug)]
pub(crate) struct Slot<R: WireReal> {
    world: Arc<tokio::sync::Mutex<Held<R>>>,
    /// The description after the last change, for lists that must not wait for a long advance.
    description: Mutex<Description<R>>,
    shared: Shared,
}

#[derive(Debug)]
pub(crate) struct Held<R: Real> {
    /// `None` once it is deleted: requests that waited for the lock find nothing.
    world: Option<World<R>>,
    /// A change began and did not come to its end: a defect interrupted it.
    interrupted: bool,
    charge: Charge,
}

/// The right to work on a world.
#[derive(Debug)]
struct Turn<R: Real> {
    held: OwnedMutexGuard<Held<R>>,
    /// Among those for long work, when this is.
    place: Option<OwnedSemaphorePermit>,
    work: u64,
}

/// What all worlds of a service share.
#[derive(Debug, Clone)]
pub(crate) struct Shared {
    pub(crate) memory: Arc<Memory>,
    /// What large advances of all worlds share: `--threads` of them.
    pub(crate) threads: Threads,
    /// Places for long advances.
    pub(crate) long_places: Arc<Semaphore>,
}

/// What a request costs.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Cost {
    /// Particle-steps, or numbers to read or write.
    pub(crate) work: u64,
    /// Bytes that it takes from the budget, until it is done or for what it creates.
    pub(crate) bytes: u64,
}

impl Cost {
    pub(crate) fn of(work: u64) -> Self {
        Self { work, bytes: 0 }
    }

    /// Of reading so many numbers: never so long that it waits for one of the places.
    pub(crate) fn of_reading(numbers: u64) -> Self {
        Self::of(numbers.min(LONG_WORK))
    }
}

/// What a change answers.
#[derive(Debug)]
pub(crate) struct Reply {
    pub(crate) status: StatusCode,
    pub(crate) location: Option<String>,
    pub(crate) body: Vec<u8>,
}

impl Reply {
    pub(crate) fn ok(body: Vec<u8>) -> Self {
        Self { status: StatusCode::OK, location: None, body }
    }

    pub(crate) fn no_content() -> Self {
        Self { status: StatusCode::NO_CONTENT, location: None, body: Vec::new() }
    }

    pub(crate) fn created(location: Option<String>, body: Vec<u8>) -> Self {
        Self { status: StatusCode::CREATED, location, body }
    }

    pub(crate) fn into_response(self, revision: Option<u64>) -> Response {
        let mut response = Response::builder().status(self.status);
        if self.status != StatusCode::NO_CONTENT {
            response = response.header(header::CONTENT_TYPE, "application/json");
        }
        if let Some(location) = self.location {
            response = response.header(header::LOCATION, location);
        }
        if let Some(revision) = revision {
            response = response.header(header::ETAG, etag(revision));
        }
        response.body(Body::from(self.body)).expect("names of worlds are valid in headers")
    }
}

/// Cancels the work of a request when its client goes away.
#[derive(Debug, Default)]
struct CancelOnDrop(Arc<AtomicBool>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl<R: WireReal> Slot<R> {
    pub(crate) fn new(name: &str, world: World<R>, shared: &Shared) -> Self {
        let description = Mutex::new(Description::new(name, &world));
        let held = Held { world: Some(world), interrupted: false, charge: Charge::none(&shared.memory) };
        Self { world: Arc::new(tokio::sync::Mutex::new(held)), description, shared: shared.clone() }
    }

    pub(crate) fn description(&self) -> Description<R> {
        self.description.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Changes the world: waits for its turn, checks in the order of the contract, applies, publishes.
    ///
    /// `cost` estimates what `apply` costs.
    pub(crate) async fn change<T: Send + 'static>(
        self: &Arc<Self>,
        target: &Target,
        preconditions: &Preconditions,
        parsed: Result<T, Problem>,
        cost: impl Fn(&World<R>, &T) -> Cost,
        apply: impl FnOnce(&mut World<R>, T, &AtomicBool) -> Result<Reply, Problem> + Send + 'static,
    ) -> Result<Response, Problem> {
        let check = |world: &World<R>| {
            if let Err(problem) = &parsed
                && problem.code == Code::MalformedJson
            {
                return Err(problem.clone());
            }
            preconditions.check(world.revision())?;
            parsed.as_ref().map(|parsed| cost(world, parsed)).map_err(Clone::clone)
        };
        let mut turn = self.turn(target, check).await?;
        let parsed = parsed?;
        let slot = Arc::clone(self);
        run(turn.work, move |cancelled| {
            let held = &mut *turn.held;
            held.interrupted = true;
            let world = held.world.as_mut().expect("it was there above, under the same lock");
            let reply = apply(world, parsed, cancelled);
            let revision = world.revision();
            slot.description.lock().unwrap_or_else(PoisonError::into_inner).update(world);
            held.interrupted = false;
            turn.end();
            Ok(reply?.into_response(Some(revision)))
        })
        .await
    }

    /// Reads the world in its turn.
    pub(crate) async fn read<Q: Send + 'static>(
        self: &Arc<Self>,
        target: &Target,
        preconditions: &Preconditions,
        query: Result<Q, Problem>,
        cost: impl Fn(&World<R>, &Q) -> Cost,
        answer: impl FnOnce(&World<R>, Q, &AtomicBool) -> Result<Vec<u8>, Problem> + Send + 'static,
    ) -> Result<Response, Problem> {
        let check = |world: &World<R>| {
            let query = query.as_ref().map_err(Clone::clone)?;
            Ok(if preconditions.has(world.revision()) { Cost::default() } else { cost(world, query) })
        };
        let mut turn = self.turn(target, check).await?;
        let query = query?;
        let revision = turn.held.world(target)?.revision();
        if preconditions.has(revision) {
            let reply = Reply { status: StatusCode::NOT_MODIFIED, location: None, body: Vec::new() };
            let mut response = reply.into_response(Some(revision));
            response.headers_mut().remove(header::CONTENT_TYPE);
            return Ok(response);
        }
        run(turn.work, move |cancelled| {
            let world = turn.held.world.as_ref().expect("it was there above, under the same lock");
            let body = answer(world, query, cancelled);
            turn.end();
            Ok(Reply::ok(body?).into_response(Some(revision)))
        })
        .await
    }

    /// Waits for the world, and for a place when the work is long; `check` refuses, or tells the cost, which is charged.
    async fn turn(
        &self,
        target: &Target,
        check: impl Fn(&World<R>) -> Result<Cost, Problem>,
    ) -> Result<Turn<R>, Problem> {
        let mut place = None;
        loop {
            let mut held = self.lock(target).await?;
            let Cost { work, bytes } = check(held.world(target)?)?;
            if work > LONG_WORK && place.is_none() {
                place = Arc::clone(&self.shared.long_places).try_acquire_owned().ok();
                if place.is_none() {
                    // Others may use the world meanwhile.
                    drop(held);
                    let free = Arc::clone(&self.shared.long_places).acquire_owned().await;
                    place = Some(free.expect("the semaphore is never closed"));
                    continue;
                }
            }
            held.charge.grow(bytes)?;
            return Ok(Turn { held, place, work });
        }
    }

    /// Takes the world out, in its turn; `forget` runs while nobody else can see it.
    pub(crate) async fn remove(
        self: &Arc<Self>,
        target: &Target,
        preconditions: &Preconditions,
        query: Result<(), Problem>,
        forget: impl FnOnce(),
    ) -> Result<Response, Problem> {
        let mut held = Arc::clone(&self.world).lock_owned().await;
        // A quarantined world can be deleted as well.
        let world = held.world.as_ref().ok_or_else(|| unknown_world(&target.world))?;
        preconditions.check(world.revision())?;
        query?;
        held.world = None;
        held.charge.shrink_to(0);
        forget();
        Ok(Reply::no_content().into_response(None))
    }

    async fn lock(&self, target: &Target) -> Result<OwnedMutexGuard<Held<R>>, Problem> {
        let held = Arc::clone(&self.world).lock_owned().await;
        if held.interrupted {
            let detail = format!("a defect interrupted a change of the world {:?}; delete it", target.world);
            return Err(Problem::new(Code::WorldQuarantined, detail));
        }
        Ok(held)
    }
}

impl<R: WireReal> Turn<R> {
    /// Gives back the world, the place, and the bytes that the particles do not take.
    fn end(self) {
        let Self { mut held, place, .. } = self;
        let particles = held.world.as_ref().map_or(0, World::particle_count) as u64;
        held.charge.shrink_to(particles * PARTICLE_BYTES);
        drop((held, place));
    }
}

impl<R: Real> Held<R> {
    /// The world, with the particle of the path in it.
    fn world(&mut self, target: &Target) -> Result<&mut World<R>, Problem> {
        let world = self.world.as_mut().ok_or_else(|| unknown_world(&target.world))?;
        if target.names_particle() {
            let id = target.particle()?;
            if !world.contains(id) {
                return Err(Problem::new(Code::UnknownParticle, format!("there is no particle {id} in this world")));
            }
        }
        Ok(world)
    }
}

pub(crate) fn unknown_world(name: &str) -> Problem {
    Problem::new(Code::UnknownWorld, format!("there is no world {name:?}; create it with PUT /v1/worlds/{{world}}"))
}

/// Runs a job here, or in the compute pool when it is long.
async fn run<T: Send + 'static>(
    work: u64,
    job: impl FnOnce(&AtomicBool) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let cancel = CancelOnDrop::default();
    let cancelled = Arc::clone(&cancel.0);
    if work <= INLINE_WORK {
        return job(&cancelled);
    }
    in_pool(move || job(&cancelled)).await
}

/// Parses a body here, or in the compute pool when it is long.
pub(crate) async fn parse<T: Send + 'static>(
    body: axum::body::Bytes,
    parse: impl FnOnce(&[u8]) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    if body.len() <= INLINE_BYTES { parse(&body) } else { in_pool(move || parse(&body)).await }
}

/// The compute pool is tokio's pool of blocking threads, which nothing else uses.
async fn in_pool<T: Send + 'static>(job: impl FnOnce() -> Result<T, Problem> + Send + 'static) -> Result<T, Problem> {
    match tokio::task::spawn_blocking(job).await {
        Ok(result) => result,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => Err(Problem::plain(Code::ShuttingDown)),
        },
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tokio::sync::Semaphore;

    use super::{Code, Cost, Reply, Shared, Slot};
    use crate::server::extract::{Preconditions, Target};
    use crate::server::memory::Memory;
    use crate::threads::Threads;
    use crate::world::World;

    fn shared() -> Shared {
        Shared { memory: Memory::new(1 << 20), threads: Threads::default(), long_places: Arc::new(Semaphore::new(1)) }
    }

    /// A panic in the middle of a change: nobody sees the half-changed world again, and it can be deleted.
    #[tokio::test]
    async fn a_world_with_an_interrupted_change_is_quarantined() {
        let none = Preconditions::default();
        for work in [0, u64::MAX] {
            let slot = Arc::new(Slot::new("a", World::<f64>::default(), &shared()));
            let changing = Arc::clone(&slot);
            let change = async move {
                let (target, none) = (Target::default(), Preconditions::default());
                changing.change(&target, &none, Ok(()), |_, ()| Cost::of(work), |_, (), _| panic!("a defect")).await
            };
            assert!(tokio::spawn(change).await.expect_err("it panicked").is_panic());
            let target = Target::default();
            let next = slot.change(&target, &none, Ok(()), |_, ()| Cost::default(), |_, (), _| Ok(Reply::no_content()));
            assert_eq!(next.await.expect_err("quarantined").code, Code::WorldQuarantined);
            let removed = slot.remove(&target, &none, Ok(()), || {});
            assert_eq!(removed.await.expect("it can be deleted").status(), 204);
        }
    }

    /// A long change that waits for a place leaves its world to others.
    #[tokio::test]
    async fn who_waits_for_a_place_holds_no_world() {
        let shared = shared();
        let slot = Arc::new(Slot::new("a", World::<f64>::default(), &shared));
        let taken = Arc::clone(&shared.long_places).acquire_owned().await.expect("open");
        let (target, none) = (Target::default(), Preconditions::default());
        let mut long = std::pin::pin!(slot.change(
            &target,
            &none,
            Ok(()),
            |_, ()| Cost::of(u64::MAX),
            |_, (), _| Ok(Reply::no_content())
        ));
        assert!(poll_once(long.as_mut()).await.is_none(), "it waits");
        let short = slot.change(&target, &none, Ok(()), |_, ()| Cost::default(), |_, (), _| Ok(Reply::no_content()));
        assert_eq!(short.await.expect("the world is free").status(), 204);
        drop(taken);
        assert_eq!(long.await.expect("its turn").status(), 204);
    }

    async fn poll_once<F: Future>(mut future: std::pin::Pin<&mut F>) -> Option<F::Output> {
        std::future::poll_fn(|context| match future.as_mut().poll(context) {
            std::task::Poll::Ready(output) => std::task::Poll::Ready(Some(output)),
            std::task::Poll::Pending => std::task::Poll::Ready(None),
        })
        .await
    }
}
