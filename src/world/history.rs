//! Which particles changed since when, for worlds that are asked.
//!
//! Each row has a mark: the revision at which its state was last written, or moved. Advances under the closed form move
//! nothing, so what they moved is marked when the world is asked.

use std::collections::VecDeque;

use crate::closed_form::Decay;
use crate::column::Column;
use crate::command::{Command, Properties, Selection};
use crate::ids::ParticleId;
use crate::integrator::Integrator;
use crate::particles::zero;
use crate::real::Real;
use crate::shared::Shared;
use crate::world::motion::{Carrier, Rows, Span};
use crate::world::{States, World};

/// Changes after which a history that nobody asked about is given up: minutes of a game's ticks, and still seconds of a
/// world that thousands of requests change each second.
const FORGOTTEN_AFTER: u64 = 1 << 14;

/// Creations, and removed particles beside an eighth of those there are, that a history knows: 64 kB of each. Who missed
/// more reads everything, which is not much longer.
const LOG_MIN: usize = 1 << 12;

/// λ t from which a velocity that reads 0 is at rest for good: E is below 2⁻⁹², which changes no bit of φ any more.
const SPENT: f64 = 64.0;

/// A row that nothing but a command changes. In the bits below it, the components of the velocity that are -0: each
/// becomes 0 where E is so small that the product with it is.
const AT_REST: u8 = 8;

/// What is remembered from when it was first asked for. For each particle four bytes (none where all changed at once), one
/// more where some came to rest under the closed form, two of removed ones, and what their log has to spare.
#[derive(Debug, Clone)]
pub(super) struct History {
    /// Marks count from here.
    start: u64,
    /// The oldest revision that can be asked about.
    reach: u64,
    /// The revision at which it was last asked for.
    asked: u64,
    /// When each row was last written or moved; 0: not since the start.
    marks: Column<u32>,
    /// Whether rows are at rest although their bases are not: 0, or [`AT_REST`] with the signs that zeros may yet lose.
    rests: Column<u8>,
    /// The last advance that moved rows without marking them; 0: none.
    deferred: u32,
    /// Revisions that created, with the next id afterwards. Never empty, and the first is not after the reach.
    created: VecDeque<(u64, u64)>,
    /// Revisions that removed, with what they removed.
    removed: VecDeque<(u64, u64)>,
    /// The marks before a batch of forces, while there is one.
    undo: Option<Vec<(usize, u32)>>,
}

/// Rows that an advance moves.
#[derive(Debug)]
pub(super) enum Moved {
    All,
    These(Vec<bool>),
}

/// What changed since a revision; see [`World::changed_since`].
#[derive(Debug)]
pub struct Changes<'a, R: Real = f64> {
    world: &'a World<R>,
    history: &'a History,
    revision: u64,
}

impl<'a, R: Real> Changes<'a, R> {
    /// The particles that are there and changed, or are new, in ascending order of id.
    pub fn ids(&self) -> impl Iterator<Item = ParticleId> + use<'a, R> {
        self.ids_from(ParticleId(0))
    }

    /// The same, from the first id that is at least `first`.
    pub fn ids_from(&self, first: ParticleId) -> impl Iterator<Item = ParticleId> + use<'a, R> {
        let Self { world, history, revision } = *self;
        let since = history.mark_of(revision);
        let none = matches!(history.marks, Column::Uniform(mark) if mark.max(history.deferred) <= since);
        let every = (!none).then(|| world.ids.from(first.0)).into_iter().flatten();
        let (all, changes) = (self.are_all(), Self { world, history, revision });
        every.filter(move |(_, row)| all || R::world_has_changed(&changes, *row)).map(|(id, _)| id)
    }

    /// Whether it can be told at once that every particle changed.
    #[must_use]
    pub fn are_all(&self) -> bool {
        let Self { world, history, revision } = *self;
        let since = history.mark_of(revision);
        matches!(history.marks, Column::Uniform(mark) if mark > since) || (history.deferred > since && world.all_move())
    }

    /// Whether a particle is there and changed, or is new.
    #[must_use]
    pub fn contains(&self, id: ParticleId) -> bool {
        self.world.ids.row(id).is_some_and(|row| R::world_has_changed(self, row))
    }

    pub(super) fn differs(&self, row: usize) -> bool {
        self.world.differs(self.history, row, self.history.mark_of(self.revision))
    }

    /// The particles that were there and are removed, in ascending order of id.
    #[must_use]
    pub fn removed(&self) -> Vec<ParticleId> {
        let History { created, removed, .. } = self.history;
        let (_, next) = created[created.partition_point(|(revision, _)| *revision <= self.revision) - 1];
        let later = removed.partition_point(|(revision, _)| *revision <= self.revision);
        let mut ids: Vec<_> =
            removed.range(later..).filter(|(_, id)| *id < next).map(|(_, id)| ParticleId(*id)).collect();
        ids.sort_unstable();
        ids
    }
}

impl History {
    fn new(revision: u64, next: u64) -> Self {
        Self {
            start: revision,
            reach: revision,
            asked: revision,
            marks: Column::Uniform(0),
            rests: Column::Uniform(0),
            deferred: 0,
            created: VecDeque::from([(revision, next)]),
            removed: VecDeque::new(),
            undo: None,
        }
    }

    fn mark_of(&self, revision: u64) -> u32 {
        u32::try_from(revision - self.start).expect("it is given up before")
    }

    fn mark(&mut self, row: usize, mark: u32, len: usize) {
        if let Some(undo) = &mut self.undo {
            undo.push((row, self.marks.get(row)));
        }
        self.marks.set(row, mark, len);
    }

    fn mark_all(&mut self, mark: u32, len: usize) {
        if let Some(undo) = &mut self.undo {
            undo.extend((0..len).map(|row| (row, self.marks.get(row))));
        }
        self.marks = Column::Uniform(mark);
    }

    /// The row moved at this mark, if it was not marked later.
    fn moved(&mut self, row: usize, mark: u32, len: usize) {
        if self.marks.get(row) < mark {
            self.marks.set(row, mark, len);
        }
    }

    fn log_removal(&mut self, revision: u64, id: ParticleId, len: usize) {
        while self.removed.len() >= LOG_MIN + len / 8 {
            let (lost, _) = self.removed.pop_front().expect("it is not empty");
            self.reach = self.reach.max(lost);
        }
        self.removed.push_back((revision, id.0));
    }

    fn log_creation(&mut self, revision: u64, next: u64) {
        match self.created.back_mut() {
            Some(last) if last.0 == revision => last.1 = next,
            Some(_) | None => {
                if self.created.len() == LOG_MIN {
                    self.created.pop_front();
                    self.reach = self.reach.max(self.created[0].0);
                }
                self.created.push_back((revision, next));
            }
        }
    }

    /// From here on it remembers how to go back. No batch of forces is within another.
    pub(super) fn begin_forces(&mut self) {
        self.undo = Some(Vec::new());
    }

    pub(super) fn keep_forces(&mut self) {
        self.undo = None;
    }

    pub(super) fn take_forces_back(&mut self, len: usize) {
        for (row, mark) in self.undo.take().into_iter().flatten().rev() {
            self.marks.set(row, mark, len);
        }
    }
}

impl<R: Real> World<R> {
    /// Begins to remember what changes from now on, for [`World::changed_since`]; or goes on, if that has begun. Call it
    /// before each question: what nobody asked about for 16,384 revisions is given up. It changes nothing else, not the
    /// revision either.
    ///
    /// A history takes four bytes a particle, none where all change at once, at most nine; and 128 kB at most. A world
    /// that is never asked has none. Each advance in steps looks at every particle for it, once.
    pub fn keep_history(&mut self) {
        R::world_keep_history(self);
    }

    pub(super) fn keep_marks(&mut self) {
        if self.history.is_none() {
            // What a batch has done so far is in no mark.
            let revision = self.revision + u64::from(self.batch == Some(true));
            self.history = Some(Shared::new(History::new(revision, self.ids.next())));
            self.mark_deferred(0);
        }
        if let Some(history) = &mut self.history {
            history.asked = self.revision;
            let deferred = std::mem::take(&mut history.deferred);
            if deferred > 0 {
                self.mark_deferred(deferred);
            }
        }
    }

    /// What changed since a revision. `None` when that is not known: no history is kept, it does not reach back so far (it
    /// knows 4,096 creations, and as many removed particles beside an eighth of those there are), or there was no such
    /// revision yet.
    ///
    /// ```
    /// use pointmass::{DVec3, Particle, World};
    /// let mut world = World::<f64>::default();
    /// let [ball, wall, shot] = [(); 3].map(|()| world.create(Particle::default()).expect("valid"));
    /// world.keep_history();
    /// let seen = world.revision();
    /// world.apply_impulse(ball, DVec3::X)?;
    /// world.remove(shot)?;
    /// world.advance(1.0)?;
    /// world.keep_history();
    /// let changes = world.changed_since(seen).expect("kept since then");
    /// assert_eq!((changes.ids().collect(), changes.removed()), (vec![ball], vec![shot]));
    /// assert!(!changes.contains(wall) && world.changed_since(seen - 1).is_none());
    /// # Ok::<(), pointmass::Error>(())
    /// ```
    ///
    /// All are told whose [`ParticleState`](crate::ParticleState) differs from what it was. Some are told though it is the
    /// same: those that a command named, whatever it gave them; those that a velocity or an acceleration drove, where
    /// rounding or a damping of 0 left every number as it was; and under [`exact`](Integrator::Exact) those that came to rest
    /// before `revision` but after the last call of [`World::keep_history`] up to it, or too slow to be sure of it.
    #[must_use]
    pub fn changed_since(&self, revision: u64) -> Option<Changes<'_, R>> {
        let history = self.history.as_deref()?;
        (history.reach..=self.revision).contains(&revision).then_some(Changes { world: self, history, revision })
    }

    /// The mark of what is being done.
    fn next_mark(&self, history: &History) -> u32 {
        history.mark_of(self.revision + 1)
    }

    /// Whether a row is another one than it was at a mark.
    fn differs(&self, history: &History, row: usize, since: u32) -> bool {
        history.marks.get(row) > since
            || (history.deferred > since && history.rests.get(row) != AT_REST && !self.is_still(row))
    }

    /// Whether an advance without a force changes no bit of a row, as its base tells: a zero may lose its sign.
    fn is_still(&self, row: usize) -> bool {
        let particles = &self.particles;
        particles.is_resting(row)
            || (particles.velocity[row].into_iter().all(is_bare_zero)
                && particles.position[row].into_iter().all(|x| x != R::ZERO || is_bare_zero(x))
                && particles.acceleration(row, self.gravity()) == zero())
    }

    /// Whether it can be told at once that an advance moves every row.
    fn all_move(&self) -> bool {
        let Self { particles, .. } = self;
        particles.resting_count() == 0
            && matches!(particles.damping, Column::Uniform(damping) if damping != R::ZERO)
            && particles.uniform_acceleration(self.gravity()).is_some_and(|a| a != zero())
    }

    /// Whether a row that is not still, as its base tells, may be at rest for good by now.
    fn may_rest(&self, row: usize) -> bool {
        let particles = &self.particles;
        let time = (self.clock - particles.base_time.get(row)).hi;
        let damping: f64 = particles.damping.get(row).into();
        let spent = || (1.0 - damping) * time >= SPENT * damping && Decay::of(damping).rate() * time >= SPENT;
        let coasts = || particles.acceleration(row, self.gravity()) == zero();
        time > 0.0 && (damping == 0.0 || (coasts() && (particles.velocity[row] == zero() || spent())))
    }

    /// Marks what advances under the closed form moved, the last of them at this mark, and finds what came to rest.
    fn mark_deferred(&mut self, mark: u32) {
        let Some(mut kept) = self.history.take() else { return };
        let history = &mut *kept;
        let len = self.particles.len();
        if self.settings.integrator == Integrator::Exact {
            if self.all_move() && history.marks.entries().all(|(_, other)| other <= mark) {
                history.marks = Column::Uniform(mark);
            } else {
                let mut perhaps = Vec::new();
                for row in (0..len).filter(|row| !self.is_still(*row)) {
                    let rest = history.rests.get(row);
                    if rest == AT_REST {
                        continue;
                    }
                    if rest == 0 {
                        history.moved(row, mark, len);
                    }
                    perhaps.extend(self.may_rest(row).then_some(row));
                }
                let mut carrier = Carrier::new(self, Span::To(self.clock), false, perhaps.len());
                let mut block = States::default();
                for rows in Rows::List(&perhaps).blocks() {
                    carrier.read(self, &rows, &mut block.position, &mut block.velocity);
                    for (row, velocity) in rows.iter().zip(&block.velocity).filter(|(_, v)| **v == zero()) {
                        let keeps_signs = self.particles.damping.get(row) == R::ZERO;
                        let sign = |(k, x): (u8, &R)| u8::from(!keeps_signs && !is_bare_zero(*x)) << k;
                        let (old, new) =
                            (history.rests.get(row), (0..).zip(velocity).map(sign).fold(AT_REST, |a, b| a | b));
                        if old != 0 && old != new {
                            history.moved(row, mark, len);
                        }
                        history.rests.set(row, new, len);
                    }
                }
            }
        }
        self.history = Some(kept);
    }

    /// Notes what a command wrote. Advances, removals and settings are noted where they are carried out.
    pub(super) fn note(&mut self, command: &Command<R>) {
        let Some(mut kept) = self.history.take() else { return };
        let history = &mut *kept;
        let (mark, len) = (self.next_mark(history), self.particles.len());
        match command {
            Command::Create(new) => {
                history.marks.extend(len - new.count, &Column::Uniform(mark), new.count);
                history.rests.extend(len - new.count, &Column::Uniform(0), new.count);
                history.log_creation(self.revision + 1, self.ids.next());
            }
            Command::AddForce { ids, .. } => self.note_write(history, ids, false),
            Command::Set { ids, properties } => {
                let Properties { acceleration, damping, mass, .. } = properties;
                let rebases = acceleration.is_some() || damping.is_some() || mass.is_some();
                self.note_write(history, ids, rebases);
            }
            Command::Place { ids, .. } | Command::Impulse { ids, .. } => self.note_write(history, ids, true),
            Command::Remove { .. } | Command::Advance(_) | Command::Configure(_) => {}
        }
        self.history = Some(kept);
    }

    /// Notes that rows were written, and whether their bases were.
    fn note_write(&self, history: &mut History, ids: &Selection, rebases: bool) {
        let (mark, len) = (self.next_mark(history), self.particles.len());
        match ids {
            Selection::All => {
                history.mark_all(mark, len);
                if rebases {
                    history.rests = Column::Uniform(0);
                }
            }
            Selection::Ids(ids) => {
                for row in ids.iter().filter_map(|id| self.ids.row(*id)) {
                    history.mark(row, mark, len);
                    if rebases {
                        history.rests.set(row, 0, len);
                    }
                }
            }
        }
    }

    /// Notes that a particle is gone, whose row the last one took.
    pub(super) fn note_removal(&mut self, id: ParticleId, row: usize) {
        let (revision, len) = (self.revision + 1, self.particles.len());
        if let Some(history) = &mut self.history {
            history.marks.swap_remove(row);
            history.rests.swap_remove(row);
            history.log_removal(revision, id, len);
        }
    }

    /// Notes that bases are about to be replaced by what a read of now returns.
    pub(super) fn note_rebase(&mut self, rows: &[usize]) {
        let len = self.particles.len();
        let Some(history) = &mut self.history else { return };
        let deferred = std::mem::take(&mut history.deferred);
        if deferred > 0 {
            self.mark_deferred(deferred);
        }
        if let Some(history) = &mut self.history {
            if rows.len() == len {
                history.rests = Column::Uniform(0);
            }
            for &row in rows {
                history.rests.set(row, 0, len);
            }
        }
    }

    /// Notes that the gravity is another one.
    pub(super) fn note_gravity(&mut self) {
        let Some(mut kept) = self.history.take() else { return };
        let history = &mut *kept;
        let (mark, len) = (self.next_mark(history), self.particles.len());
        (0..len).filter(|row| self.follows_gravity(*row)).for_each(|row| history.marks.set(row, mark, len));
        self.history = Some(kept);
    }

    /// Rows that an advance in steps of constant accelerations is about to move, but for the forces.
    pub(super) fn about_to_move(&self) -> Option<Moved> {
        self.history.as_ref()?;
        if self.all_move() {
            return Some(Moved::All);
        }
        Some(Moved::These((0..self.particles.len()).map(|row| !self.is_still(row)).collect()))
    }

    /// Rows that end elsewhere than they are.
    pub(super) fn moved_to(&self, position: &[[R; 3]], velocity: &[[R; 3]]) -> Option<Moved> {
        self.history.as_ref()?;
        let bits = |x: &[R; 3]| x.map(|x| x.into().to_bits());
        let differs = |(a, b): (&[R; 3], &[R; 3])| bits(a) != bits(b);
        let position = self.particles.position.iter().zip(position).map(differs);
        let velocity = self.particles.velocity.iter().zip(velocity).map(differs);
        Some(Moved::These(position.zip(velocity).map(|(position, velocity)| position || velocity).collect()))
    }

    /// Notes that they are moved.
    pub(super) fn note_moved(&mut self, moved: Option<Moved>) {
        let Some(moved) = moved else { return };
        let Some(mut kept) = self.history.take() else { return };
        let history = &mut *kept;
        let (mark, len) = (self.next_mark(history), self.particles.len());
        match moved {
            Moved::These(rows) if !rows.iter().all(|moved| *moved) => {
                let moved = rows.iter().enumerate().filter(|(_, moved)| **moved);
                moved.for_each(|(row, _)| history.marks.set(row, mark, len));
            }
            Moved::All | Moved::These(_) => history.marks = Column::Uniform(mark),
        }
        self.history = Some(kept);
    }

    /// Notes an advance, before the forces are cleared.
    pub(super) fn note_advance(&mut self) {
        let Some(mut kept) = self.history.take() else { return };
        let history = &mut *kept;
        let (mark, len) = (self.next_mark(history), self.particles.len());
        for row in self.particles.force.rows(len) {
            history.marks.set(row, mark, len);
            if self.particles.is_forced(row) {
                history.rests.set(row, 0, len);
            }
        }
        if self.settings.integrator == Integrator::Exact {
            history.deferred = mark;
        }
        self.history = Some(kept);
    }

    /// The world is one revision further; or will be, when the batch that it is in is over.
    pub(super) fn end_change(&mut self) {
        if let Some(changed) = &mut self.batch {
            *changed = true;
            return;
        }
        self.revision += 1;
        self.history.take_if(|history| {
            let too_many = u64::from(u32::MAX);
            self.revision - history.asked > FORGOTTEN_AFTER || self.revision - history.start >= too_many
        });
    }
}

/// 0, and not -0.
fn is_bare_zero<R: Real>(x: R) -> bool {
    x.into().to_bits() == 0
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::{Column, FORGOTTEN_AFTER};
    use crate::command::{Advance, Command, NewParticles, Settings};
    use crate::ids::ParticleId;
    use crate::integrator::Integrator;
    use crate::world::World;

    fn falling(integrator: Integrator) -> World<f64> {
        let settings = Settings { gravity: DVec3::NEG_Y, integrator, ..Settings::default() };
        let mut world = World::new(settings).expect("valid");
        world.apply(&Command::Create(NewParticles { count: 100, ..NewParticles::default() })).expect("valid");
        world
    }

    #[test]
    fn who_is_never_asked_remembers_nothing() {
        let mut world = falling(Integrator::Exact);
        world.add_force(ParticleId(1), DVec3::X).expect("finite");
        world.advance(1.0).expect("finite");
        world.remove(ParticleId(2)).expect("it is there");
        world.apply_all(&[Command::Advance(Advance::by(1.0))]).expect("finite");
        assert!(world.history.is_none() && world.changed_since(world.revision()).is_none());
    }

    #[test]
    fn what_nobody_asks_about_any_more_is_given_up() {
        let mut world = falling(Integrator::Exact);
        for _ in 0..2 {
            world.keep_history();
            for _ in 0..FORGOTTEN_AFTER {
                world.advance(1.0).expect("finite");
            }
            assert!(world.history.is_some());
        }
        world.advance(1.0).expect("finite");
        assert!(world.history.is_none() && world.changed_since(world.revision()).is_none());
    }

    #[test]
    fn what_all_do_takes_no_column() {
        for integrator in Integrator::ALL {
            let mut world = falling(integrator);
            world.keep_history();
            let begin = world.revision();
            for _ in 0..3 {
                world.advance(0.5).expect("finite");
                world.keep_history();
            }
            let history = world.history.as_ref().expect("kept");
            assert_eq!(history.marks, Column::Uniform(3), "{integrator}");
            assert_eq!(history.rests, Column::Uniform(0), "{integrator}");
            assert!(world.changed_since(begin).is_some_and(|changes| changes.are_all()), "{integrator}");
        }
    }
}
