//! One world in the service: who may touch it, when, and on which thread.
//!
//! A world is behind an asynchronous lock that serves in the order of asking. Whoever gets it does one whole operation:
//! at once when it is short, on a thread of the compute pool when it takes a while, to which the lock moves along. A long
//! one first takes one of a few places, before it takes the world: so a long advance takes no thread that answers
//! requests, and however many there are, the pool has threads left for everything else.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::response::{IntoResponse, Response};
use tokio::sync::{Notify, OwnedMutexGuard, OwnedSemaphorePermit};

use crate::real::Real;
use crate::server::body::Body;
use crate::server::coding::Coding;
use crate::server::columns;
use crate::server::config::{ANSWER_BYTES_MAX, Config};
use crate::server::content::{self, Content};
use crate::server::extract::{Change, Read, Target};
use crate::server::idempotency::{Answers, Attempt, Claim, ENTRY_BYTES, KEPT_ANSWER_BYTES_MAX, Key, KeyLimits};
use crate::server::json::WireReal;
use crate::server::memory::{Charge, Memory, NUMBER_BYTES, PARTICLE_BYTES};
use crate::server::problem::{Code, Problem};
use crate::server::queue::{Bounds, Places, Queue};
use crate::server::reply::Reply;
use crate::server::wire::{Description, Property};
use crate::threads::Threads;
use crate::world::World;

/// Work, in particle-steps or numbers to write, that is done on the spot: about a tenth of a millisecond. Moving it to
/// another thread and back costs a fifth of that.
pub(crate) const INLINE_WORK: u64 = 20_000;

/// Work that takes one of the places for long advances: some tens of milliseconds.
const LONG_WORK: u64 = 1 << 25;

/// The share of a budget from which the service says that it is not ready.
const NEARLY_FULL: f64 = 0.95;

/// How often a request that got a place finds its world taken by another, and gives the place back, before it gives up.
const TURNS_MAX: usize = 8;

/// Snapshots that are sent at once, each by a thread that waits for its client.
const SNAPSHOTS_MAX: usize = 8;

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
    /// Those who wait for the lock.
    pub(crate) queue: Queue,
    pub(crate) answers: Answers,
    /// Told of every change, and of the end.
    pub(crate) changed: Notify,
    shared: Arc<Shared>,
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
struct Turn<R: WireReal> {
    held: OwnedMutexGuard<Held<R>>,
    /// In the compute pool, when the work is not done on the spot.
    place: Option<OwnedSemaphorePermit>,
    work: u64,
    asks_history: bool,
    /// For the answer.
    charge: Charge,
}

/// What all worlds of a service share.
#[derive(Debug)]
pub(crate) struct Shared {
    /// What all worlds hold.
    pub(crate) memory: Arc<Memory>,
    /// What requests and answers in flight take.
    pub(crate) in_flight: Arc<Memory>,
    /// What large advances of all worlds share: `--threads` of them.
    pub(crate) threads: Threads,
    /// For work in the compute pool.
    pub(crate) short_places: Places,
    /// For long work there.
    pub(crate) long_places: Places,
    /// For snapshots on their way.
    pub(crate) snapshot_places: Places,
    /// Answers to removals of worlds.
    pub(crate) removals: Answers,
    answer_bytes_max: u64,
    /// Of those who wait for one world.
    world_queue: Bounds,
    key_limits: KeyLimits,
}

impl Shared {
    /// # Errors
    /// When the threads cannot be started.
    pub(crate) fn new(config: &Config) -> std::io::Result<Self> {
        let patience = Duration::from_millis(config.queue_timeout_ms);
        let key_limits = KeyLimits { count: config.keys_max, lifetime: Duration::from_millis(config.key_lifetime_ms) };
        let places = Bounds { length: config.queue_max, patience, what: "a place for a long advance" };
        Ok(Self {
            memory: Memory::of_worlds(config.memory_bytes_max),
            in_flight: Memory::of_requests(config.in_flight_bytes_max),
            threads: Threads::new(config.threads)?,
            short_places: Places::new(
                Config::short_places(),
                Bounds { patience: Duration::from_millis(config.shed_after_ms), what: "a processor", ..places },
            ),
            long_places: Places::new(config.long_places(), places),
            snapshot_places: Places::new(SNAPSHOTS_MAX, Bounds { what: "a place for a snapshot", ..places }),
            answer_bytes_max: config.answer_bytes_max,
            world_queue: Bounds { length: config.world_queue_max, patience, what: "the world" },
            removals: Answers::new(key_limits),
            key_limits,
        })
    }

    /// Refuses when new work would be: what stands full, and which flag says how much it may hold.
    pub(crate) fn check_capacity(&self) -> Result<(), Problem> {
        let full = |what: &str| Err(Problem::new(Code::Overloaded, format!("{what}; new work is refused")));
        if self.in_flight.load() > NEARLY_FULL {
            return full("requests in flight take nearly all of --in-flight-bytes-max");
        }
        if self.short_places.queue.is_full() || self.long_places.queue.is_full() {
            return full("as many requests wait for a processor as --queue-max allows");
        }
        Ok(())
    }

    /// The places of work that does not run on the spot.
    fn places(&self, work: u64) -> Option<&Places> {
        if work <= INLINE_WORK {
            None
        } else if work <= LONG_WORK {
            Some(&self.short_places)
        } else {
            Some(&self.long_places)
        }
    }

    /// Parses a body here, or in the compute pool when it is long.
    pub(crate) async fn parse<T: Send + 'static>(
        &self,
        body: Body,
        parse: impl FnOnce(&Body) -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        self.run_on_bytes(body.bytes.len(), move || parse(&body)).await
    }

    /// The same with what takes as long as parsing so many bytes.
    pub(crate) async fn run_on_bytes<T: Send + 'static>(
        &self,
        bytes: usize,
        job: impl FnOnce() -> Result<T, Problem> + Send + 'static,
    ) -> Result<T, Problem> {
        if bytes <= INLINE_BYTES {
            return job();
        }
        let place = self.short_places.take().await?;
        in_pool(move || {
            let done = job();
            drop(place);
            done
        })
        .await
    }
}

/// What a request costs.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Cost {
    /// Particle-steps, or numbers to read or write.
    pub(crate) work: u64,
    /// Bytes that it takes from the budget of worlds, until it is done or for what it creates.
    pub(crate) bytes: u64,
    /// Bytes of its answer.
    pub(crate) answer: u64,
    /// Bytes that are held for it while it is sent.
    pub(crate) held: u64,
    /// Whether it asks what changed, so that a history is kept from then on.
    pub(crate) asks_history: bool,
}

impl Cost {
    pub(crate) fn of(work: u64) -> Self {
        Self { work, ..Self::default() }
    }

    /// Of reading so many numbers: never so long that it waits for one of the places of long work.
    pub(crate) fn of_reading(numbers: u64) -> Self {
        Self::of(numbers.min(LONG_WORK)).answering(numbers)
    }

    /// Of reading columns: what is more than a few is written while it is sent, from the world as it was.
    pub(crate) fn of_columns<R: WireReal>(world: &World<R>, count: usize, properties: &[Property]) -> Self {
        let numbers = columns::numbers(count as u64, properties);
        if content::is_few(numbers) {
            return Self::of_reading(numbers);
        }
        Self { held: world.bytes() + 4 * columns::PIECE_BYTES as u64, ..Self::default() }
    }

    /// With an answer that is kept.
    fn with_key(self) -> Result<Self, Problem> {
        if self.answer > KEPT_ANSWER_BYTES_MAX {
            return Err(too_large(self.answer, KEPT_ANSWER_BYTES_MAX, "with an Idempotency-Key"));
        }
        Ok(Self { bytes: self.bytes.saturating_add(self.answer + 2 * ENTRY_BYTES as u64), ..self })
    }

    /// By who wants to know what changed.
    pub(crate) fn asking_history(self) -> Self {
        Self { asks_history: true, ..self }
    }

    /// With so much more work.
    pub(crate) fn doing(self, work: u64) -> Self {
        Self { work: self.work.saturating_add(work), ..self }
    }

    /// With so many numbers in the answer.
    pub(crate) fn answering(self, numbers: u64) -> Self {
        Self { answer: numbers.saturating_mul(NUMBER_BYTES), ..self }
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

/// What a change does to its world.
type Apply<R> = dyn FnOnce(&mut World<R>, &AtomicBool) -> Result<Reply, Problem> + Send;

impl<R: WireReal> Slot<R> {
    pub(crate) fn new(name: &str, world: World<R>, shared: &Arc<Shared>) -> Self {
        let description = Mutex::new(Description::new(name, &world));
        let held = Held { world: Some(world), interrupted: false, charge: Charge::none(&shared.memory) };
        Self {
            world: Arc::new(tokio::sync::Mutex::new(held)),
            description,
            queue: Queue::new(shared.world_queue),
            answers: Answers::new(shared.key_limits),
            changed: Notify::new(),
            shared: Arc::clone(shared),
        }
    }

    /// Keeps the answer of the request that creates the world, which nobody else has yet.
    pub(crate) fn keep_first(&self, key: &Key, reply: &Reply) -> Result<(), Problem> {
        if let Ok(mut held) = self.world.try_lock() {
            held.charge.grow(2 * ENTRY_BYTES as u64)?;
        }
        if let Attempt::First(claim) = self.answers.attempt(key)? {
            claim.answered(reply);
        }
        Ok(())
    }

    /// Charges the particles of a world that nobody else has yet.
    pub(crate) fn charge_first(&self) -> Result<(), Problem> {
        match self.world.try_lock() {
            Ok(mut held) => held.charge.grow(self.particle_count() as u64 * PARTICLE_BYTES),
            Err(_) => Ok(()),
        }
    }

    pub(crate) fn description(&self) -> Description<R> {
        self.description.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Forgets kept answers that are too old, unless the world is at work and does so itself.
    pub(crate) fn forget(&self) {
        if let Ok(mut held) = self.world.try_lock() {
            held.settle(&self.answers);
        }
    }

    /// After the last change.
    pub(crate) fn particle_count(&self) -> usize {
        self.description.lock().unwrap_or_else(PoisonError::into_inner).particle_count()
    }

    /// Changes the world: waits for its turn, checks in the order of the contract, applies, publishes.
    ///
    /// `cost` estimates what `apply` costs.
    pub(crate) async fn change<T: Send + Sync + 'static>(
        self: &Arc<Self>,
        change: &Change,
        parsed: Result<T, Problem>,
        cost: impl Fn(&World<R>, &T) -> Cost + Sync,
        apply: impl FnOnce(&mut World<R>, T, &AtomicBool) -> Result<Reply, Problem> + Send + 'static,
    ) -> Result<Reply, Problem> {
        let claim = match change.key.as_ref().map(|key| self.answers.attempt(key.as_ref().map_err(Clone::clone)?)) {
            Some(Ok(Attempt::First(claim))) => Some(claim),
            None => None,
            Some(Err(problem)) if problem.code == Code::IdempotencyKeyInFlight => return Err(problem),
            Some(told) => {
                // An unknown particle is told first.
                if change.target.names_particle() {
                    self.lock().await?.world(&change.target)?;
                }
                return told.map(Attempt::reply);
            }
        };
        let check = |world: &World<R>| {
            if let Err(problem) = &parsed
                && problem.is_malformed()
            {
                return Err(problem.clone());
            }
            change.preconditions.check(world.revision())?;
            let cost = parsed.as_ref().map(|parsed| cost(world, parsed)).map_err(Clone::clone)?;
            if claim.is_some() { cost.with_key() } else { Ok(cost) }
        };
        let turn = self.turn(&change.target, &check).await?;
        let parsed = parsed?;
        let apply = Box::new(move |world: &mut World<R>, cancelled: &AtomicBool| apply(world, parsed, cancelled));
        self.finish(turn, claim, change.coding, apply).await
    }

    /// Applies a change whose turn it is, and publishes it.
    async fn finish(
        self: &Arc<Self>,
        mut turn: Turn<R>,
        claim: Option<Claim>,
        coding: Option<Coding>,
        apply: Box<Apply<R>>,
    ) -> Result<Reply, Problem> {
        let slot = Arc::clone(self);
        run(turn.work, move |cancelled| {
            let held = &mut *turn.held;
            held.interrupted = true;
            let world = held.world.as_mut().expect("it was there above, under the same lock");
            let reply = apply(world, cancelled).map(|reply| reply.at(world.revision()));
            let reply = if claim.is_some() { reply.map(Reply::whole) } else { reply };
            slot.description.lock().unwrap_or_else(PoisonError::into_inner).update(world);
            if let (Ok(reply), Some(claim)) = (&reply, claim) {
                claim.answered(reply);
            }
            held.interrupted = false;
            slot.changed.notify_waiters();
            let charge = turn.end(&slot.answers);
            Ok(reply?.charged(charge).coded(coding, &slot.shared))
        })
        .await
    }

    /// Reads the world in its turn.
    pub(crate) async fn read<Q: Send + Sync + 'static>(
        self: &Arc<Self>,
        read: &Read,
        query: Result<Q, Problem>,
        cost: impl Fn(&World<R>, &Q) -> Cost + Sync,
        answer: impl FnOnce(&World<R>, Q, &AtomicBool) -> Result<Content, Problem> + Send + 'static,
    ) -> Result<Response, Problem> {
        let (revision, seen) = self.look(read, query, cost, answer).await?;
        let reply = seen.map_or_else(Reply::not_modified, |(content, charge)| {
            Reply::of(content).charged(charge).coded(read.coding, &self.shared)
        });
        Ok(reply.at(revision).into_response())
    }

    /// Looks at the world in its turn: its revision, and unless the client has that already, what it saw, and the charge
    /// for it.
    pub(crate) async fn look<Q: Send + Sync + 'static, T: Send + 'static>(
        self: &Arc<Self>,
        read: &Read,
        query: Result<Q, Problem>,
        cost: impl Fn(&World<R>, &Q) -> Cost + Sync,
        look: impl FnOnce(&World<R>, Q, &AtomicBool) -> Result<T, Problem> + Send + 'static,
    ) -> Result<(u64, Option<(T, Charge)>), Problem> {
        let Read { target, preconditions, .. } = read;
        let check = |world: &World<R>| {
            let query = query.as_ref().map_err(Clone::clone)?;
            Ok(if preconditions.has(world.revision()) { Cost::default() } else { cost(world, query) })
        };
        let mut turn = self.turn(target, &check).await?;
        let query = query?;
        let revision = turn.held.world(target)?.revision();
        if preconditions.has(revision) {
            return Ok((revision, None));
        }
        let slot = Arc::clone(self);
        run(turn.work, move |cancelled| {
            let world = turn.held.world.as_mut().expect("it was there above, under the same lock");
            if turn.asks_history {
                world.keep_history();
            }
            let seen = look(world, query, cancelled);
            let charge = turn.end(&slot.answers);
            Ok((revision, Some((seen?, charge))))
        })
        .await
    }

    /// Waits for the world, and for a place where the work needs one; `check` refuses, or tells the cost, which is
    /// charged.
    async fn turn(
        &self,
        target: &Target,
        check: &(dyn Fn(&World<R>) -> Result<Cost, Problem> + Sync),
    ) -> Result<Turn<R>, Problem> {
        let mut held = self.lock().await?;
        let mut place = None;
        for _ in 0..TURNS_MAX {
            let Cost { work, bytes, answer, held: as_it_was, asks_history } = check(held.world(target)?)?;
            if let Some(places) = self.shared.places(work)
                && place.is_none()
            {
                place = places.try_take();
                if place.is_none() {
                    // Others may use the world meanwhile. Whoever then has it is waited for without the place.
                    drop(held);
                    let free = places.take().await?;
                    if let Ok(again) = Arc::clone(&self.world).try_lock_owned() {
                        (held, place) = (again, Some(free));
                    } else {
                        drop(free);
                        held = self.lock().await?;
                    }
                    continue;
                }
            }
            if answer > self.shared.answer_bytes_max {
                return Err(too_large(answer, self.shared.answer_bytes_max, ANSWER_BYTES_MAX));
            }
            let mut charge = Charge::none(&self.shared.in_flight);
            charge.grow(answer.saturating_add(as_it_was))?;
            held.charge.grow(bytes)?;
            return Ok(Turn { held, place, work, asks_history, charge });
        }
        Err(Problem::new(Code::Overloaded, "the world and a processor were never free together; try again later"))
    }

    /// The world as it is in its turn, however long that takes, with a history from then on.
    pub(crate) async fn view(&self, target: &Target) -> Result<World<R>, Problem> {
        let mut held = Arc::clone(&self.world).lock_owned().await;
        let rows = held.world(target)?.particle_count() as u64;
        let target = target.clone();
        // It may have to look at every particle.
        run(rows, move |_| {
            let world = held.world(&target)?;
            world.keep_history();
            Ok(world.clone())
        })
        .await
    }

    /// Takes the world out, in its turn; `forget` runs while nobody else can see it.
    pub(crate) async fn remove(
        self: &Arc<Self>,
        change: &Change,
        query: Result<(), Problem>,
        forget: impl FnOnce(),
    ) -> Result<Response, Problem> {
        let mut held = self.lock().await?;
        // A quarantined world can be deleted as well.
        let world = held.world.as_ref().ok_or_else(|| unknown_world(&change.target.world))?;
        change.preconditions.check(world.revision())?;
        query?;
        held.world = None;
        held.charge.shrink_to(0);
        forget();
        self.changed.notify_waiters();
        Ok(Reply::no_content().into_response())
    }

    async fn lock(&self) -> Result<OwnedMutexGuard<Held<R>>, Problem> {
        match Arc::clone(&self.world).try_lock_owned() {
            Ok(held) => Ok(held),
            Err(_) => self.queue.wait(Arc::clone(&self.world).lock_owned()).await,
        }
    }
}

impl<R: WireReal> Turn<R> {
    /// Gives back the world, the place, and the bytes that neither particles nor kept answers take; what is left is the
    /// charge for the answer.
    fn end(self, answers: &Answers) -> Charge {
        let Self { mut held, place, charge, .. } = self;
        held.settle(answers);
        drop((held, place));
        charge
    }
}

impl<R: Real> Held<R> {
    /// Gives back the bytes that neither particles nor kept answers take.
    fn settle(&mut self, answers: &Answers) {
        let particles = self.world.as_ref().map_or(0, World::particle_count) as u64;
        self.charge.shrink_to(particles * PARTICLE_BYTES + answers.bytes());
    }

    /// The world, with the particle of the path in it.
    fn world(&mut self, target: &Target) -> Result<&mut World<R>, Problem> {
        if self.interrupted {
            let detail = format!("a defect interrupted a change of the world {:?}; delete it", target.world);
            return Err(Problem::new(Code::WorldQuarantined, detail));
        }
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

fn too_large(answer: u64, limit: u64, flag: &str) -> Problem {
    let detail = format!(
        "the answer may have {answer} bytes, more than {limit} ({flag}); ask for fewer properties or particles"
    );
    Problem::new(Code::AnswerTooLarge, detail)
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

/// The compute pool is tokio's pool of blocking threads, which nothing else uses.
pub(crate) async fn in_pool<T: Send + 'static>(
    job: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let (tell, told) = tokio::sync::oneshot::channel();
    // One type of task for all jobs: each would be compiled with all that the runtime does for it.
    let job: Box<dyn FnOnce() + Send> = Box::new(move || {
        let _gone = tell.send(job());
    });
    match tokio::task::spawn_blocking(job).await {
        Ok(()) => told.await.expect("told before the job ends"),
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => Err(Problem::plain(Code::ShuttingDown)),
        },
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;

    use axum::http::{HeaderMap, HeaderValue, header};

    use super::{Code, Config, Cost, Reply, Shared, Slot};
    use crate::server::extract::{Change, Preconditions};
    use crate::world::World;

    fn shared() -> Arc<Shared> {
        let config = Config { threads: 1, ..Config::default() };
        Arc::new(Shared::new(&config).expect("one thread"))
    }

    /// A panic in the middle of a change: nobody sees the half-changed world again, and it can be deleted.
    #[tokio::test]
    async fn a_world_with_an_interrupted_change_is_quarantined() {
        for work in [0, u64::MAX] {
            let slot = Arc::new(Slot::new("a", World::<f64>::default(), &shared()));
            let changing = Arc::clone(&slot);
            let change = async move {
                let change = Change::default();
                changing.change(&change, Ok(()), |_, ()| Cost::of(work), |_, (), _| panic!("a defect")).await
            };
            assert!(tokio::spawn(change).await.expect_err("it panicked").is_panic());
            let again = Change::default();
            let next = slot.change(&again, Ok(()), |_, ()| Cost::default(), |_, (), _| Ok(Reply::no_content()));
            assert_eq!(next.await.expect_err("quarantined").code, Code::WorldQuarantined);
            let removed = slot.remove(&again, Ok(()), || {});
            assert_eq!(removed.await.expect("it can be deleted").status(), 204);
        }
    }

    /// What changed while a request waited for a place counts: it is judged anew.
    #[tokio::test]
    async fn if_match_is_judged_when_the_work_begins() {
        let shared = shared();
        let slot = Arc::new(Slot::new("a", World::<f64>::default(), &shared));
        let taken: Vec<_> = std::iter::from_fn(|| shared.long_places.try_take()).collect();
        let headers = HeaderMap::from_iter([(header::IF_MATCH, HeaderValue::from_static("\"0\""))]);
        let matching = Change { preconditions: Preconditions::new(&headers), ..Change::default() };
        let mut long = std::pin::pin!(slot.change(
            &matching,
            Ok(()),
            |_, ()| Cost::of(u64::MAX),
            |_, (), _| Ok(Reply::no_content())
        ));
        assert!(poll_once(long.as_mut()).await.is_none(), "it waits");
        let other = Change::default();
        let advance = |world: &mut World<f64>, (), _: &AtomicBool| {
            world.advance(1.0).expect("nothing is in it");
            Ok(Reply::no_content())
        };
        slot.change(&other, Ok(()), |_, ()| Cost::default(), advance).await.expect("the world is free");
        drop(taken);
        assert_eq!(long.await.expect_err("the world moved on").code, Code::RevisionMismatch);
    }

    /// A long change that waits for a place leaves its world to others.
    #[tokio::test]
    async fn who_waits_for_a_place_holds_no_world() {
        let shared = shared();
        let slot = Arc::new(Slot::new("a", World::<f64>::default(), &shared));
        let taken: Vec<_> = std::iter::from_fn(|| shared.long_places.try_take()).collect();
        let change = Change::default();
        let long = || slot.change(&change, Ok(()), |_, ()| Cost::of(u64::MAX), |_, (), _| Ok(Reply::no_content()));
        let (mut first, mut second) = (std::pin::pin!(long()), std::pin::pin!(long()));
        assert!(poll_once(first.as_mut()).await.is_none() && poll_once(second.as_mut()).await.is_none(), "they wait");
        assert_eq!(shared.long_places.queue.depth_and_age().0, 2);
        let short = slot.change(&change, Ok(()), |_, ()| Cost::default(), |_, (), _| Ok(Reply::no_content()));
        assert_eq!(short.await.expect("the world is free").status, 204);
        // Got a place, found the world taken: gives the place back.
        let held = slot.lock().await.expect("free");
        drop(taken);
        assert!(poll_once(first.as_mut()).await.is_none(), "it waits for the world");
        assert!(shared.long_places.try_take().is_some(), "and not in a place");
        drop(held);
        assert_eq!(first.await.expect("its turn").status, 204);
        assert_eq!(second.await.expect("its turn").status, 204);
    }

    async fn poll_once<F: Future>(mut future: std::pin::Pin<&mut F>) -> Option<F::Output> {
        std::future::poll_fn(|context| match future.as_mut().poll(context) {
            std::task::Poll::Ready(output) => std::task::Poll::Ready(Some(output)),
            std::task::Poll::Pending => std::task::Poll::Ready(None),
        })
        .await
    }
}
