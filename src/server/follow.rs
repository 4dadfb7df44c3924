//! Followers of a world: what changed since they were told last, at most so often.
//!
//! A follower is told the newest state when it is ready for it; what it missed meanwhile is part of that, so that nothing
//! queues up for one that is slow.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use crate::ids::ParticleId;
use crate::server::App;
use crate::server::columns::Columns;
use crate::server::content::{Composer, Content, is_few};
use crate::server::encoding::Encoding;
use crate::server::extract::Target;
use crate::server::json::WireReal;
use crate::server::memory::{Charge, NUMBER_BYTES};
use crate::server::problem::{Code, Problem};
use crate::server::slot::{Slot, in_pool};
use crate::server::wire::Property;
use crate::world::World;

/// What a follower wants to know.
#[derive(Debug, Clone)]
pub(crate) struct Interest {
    pub(crate) properties: Vec<Property>,
    /// In ascending order; `None`: all.
    pub(crate) ids: Option<Arc<[u64]>>,
    /// The least time between two events.
    pub(crate) period: Duration,
    /// What it knows already.
    pub(crate) since: Option<u64>,
}

/// One that follows a world.
#[derive(Debug)]
pub(crate) struct Follower<R: WireReal> {
    app: Arc<App>,
    slot: Arc<Slot<R>>,
    target: Target,
    interest: Interest,
    /// Not before.
    due: Instant,
}

/// How long a follower waits for memory that others have.
const BREATH: Duration = Duration::from_millis(100);

impl<R: WireReal> Follower<R> {
    /// # Errors
    /// When the world is gone, or one of the ids is not there.
    pub(crate) async fn new(
        app: &Arc<App>,
        slot: Arc<Slot<R>>,
        target: Target,
        interest: Interest,
    ) -> Result<Self, Problem> {
        let world = slot.view(&target).await?;
        let unknown = |id: &&u64| !world.contains(ParticleId(**id));
        // Who has seen a part of the history is told what was removed.
        if let (Some(ids), None) = (&interest.ids, interest.since)
            && let Some(id) = ids.iter().find(unknown)
        {
            return Err(Problem::new(Code::UnknownParticle, format!("there is no particle {id} in this world")));
        }
        Ok(Self { app: Arc::clone(app), slot, target, interest, due: Instant::now() })
    }

    /// Waits for a change, and until it is time to tell it: the event, after a beginning that follows from its revision.
    /// Nothing is lost when this is given up.
    ///
    /// # Errors
    /// When the world is gone.
    pub(crate) async fn next(&mut self, encoding: Encoding, begin: fn(u64) -> String) -> Result<Content, Problem> {
        tokio::time::sleep_until(self.due).await;
        loop {
            let mut changed = std::pin::pin!(self.slot.changed.notified());
            changed.as_mut().enable();
            let world = self.slot.view(&self.target).await?;
            let revision = world.revision();
            if self.interest.since == Some(revision) {
                // Or the next change would have to copy what nobody reads.
                drop(world);
                changed.await;
                continue;
            }
            let interest = self.interest.clone();
            let app = Arc::clone(&self.app);
            let count = world.particle_count() as u64;
            let tell = move || interest.event(&world, encoding, begin, &app);
            match if is_few(count) { tell() } else { in_pool(tell).await } {
                Ok(event) => {
                    self.interest.since = Some(revision);
                    // By the clock, so that what comes at the same rate is told each time.
                    self.due = (self.due + self.interest.period).max(Instant::now());
                    return Ok(event);
                }
                Err(problem) if problem.code == Code::Overloaded => tokio::time::sleep(BREATH).await,
                Err(problem) => return Err(problem),
            }
        }
    }
}

impl Interest {
    fn event<R: WireReal>(
        &self,
        world: &World<R>,
        encoding: Encoding,
        begin: fn(u64) -> String,
        app: &App,
    ) -> Result<Content, Problem> {
        let columns = Columns::since(world, self.since, self.ids.as_deref(), &self.properties);
        let mut charge = Charge::none(&app.shared.in_flight);
        charge.grow(if is_few(columns.numbers()) { columns.numbers() * NUMBER_BYTES } else { world.bytes() })?;
        let mut composer = Composer::new(encoding);
        composer.writer.bytes.extend_from_slice(begin(world.revision()).as_bytes());
        composer.columns(world, columns, &app.shared);
        Ok(composer.content().charged(charge))
    }
}
