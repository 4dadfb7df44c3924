//! Several changes that become one.

use std::sync::atomic::AtomicBool;

use crate::accumulators::Acting;
use crate::command::{Command, Outcome};
use crate::error::{BatchError, Error, Limits};
use crate::real::Real;
use crate::world::bounds::Bounds;
use crate::world::{NEVER_CANCELLED, World};

/// What a batch keeps to be able to go back. A command that is refused has changed nothing, so only those count that
/// something follows which can fail; and a copy of a world takes as long as many steps of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Keep {
    Nothing,
    /// The force accumulators: so a tick (forces, then an advance) costs no copy.
    Forces,
    Everything,
}

/// A part of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    Change {
        adds_forces: bool,
    },
    #[cfg(feature = "server")]
    Read {
        can_fail: bool,
    },
}

impl Part {
    pub(crate) fn of<R: Real>(command: &Command<R>) -> Self {
        Self::Change { adds_forces: matches!(command, Command::AddForce { .. }) }
    }
}

/// What a world was before a batch.
#[derive(Debug)]
pub struct Before<R: Real> {
    kept: Kept<R>,
    limits: Limits,
    /// Of the batch that this one is in.
    outer: Option<bool>,
}

#[derive(Debug)]
enum Kept<R: Real> {
    Nothing,
    Forces(Acting<R>, Bounds),
    Everything(Box<World<R>>),
}

impl Keep {
    /// What these need, one after the other.
    pub(crate) fn of(parts: impl DoubleEndedIterator<Item = Part>) -> Self {
        let (mut keep, mut is_followed) = (Self::Nothing, false);
        for part in parts.rev() {
            match part {
                Part::Change { adds_forces } => {
                    if is_followed {
                        keep = keep.max(if adds_forces { Self::Forces } else { Self::Everything });
                    }
                    is_followed = true;
                }
                #[cfg(feature = "server")]
                Part::Read { can_fail } => is_followed |= can_fail,
            }
        }
        keep
    }
}

impl<R: Real> World<R> {
    /// Applies commands one after the other as one change: all of them, or none and the first error. The revision grows
    /// by one. Their advances together may cost what [`Limits`] allow one.
    ///
    /// ```
    /// use pointmass::{Advance, Column, Command, DVec3, Particle, ParticleId, World};
    /// let mut world = World::<f64>::default();
    /// let push = Command::AddForce { ids: ParticleId(0).into(), force: Column::Uniform(DVec3::X) };
    /// let tick = [Command::Create(Particle::default().into()), push, Command::Advance(Advance::by(1.0))];
    /// world.apply_all(&tick)?;
    /// assert_eq!((world.revision(), world.particle(ParticleId(0))?.velocity), (1, DVec3::X));
    /// let refused = world.apply_all(&[tick[0].clone(), Command::Advance(Advance::by(-1.0))]);
    /// assert_eq!(refused.map_err(|refused| refused.index), Err(1));
    /// assert_eq!((world.revision(), world.particle_count()), (1, 1));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`World::apply`], with the place of the command.
    pub fn apply_all(&mut self, commands: &[Command<R>]) -> Result<Vec<Outcome>, BatchError> {
        R::world_apply_all(self, commands)
    }

    pub(super) fn apply_commands(&mut self, commands: &[Command<R>]) -> Result<Vec<Outcome>, BatchError> {
        self.keeping(Keep::of(commands.iter().map(Part::of)), |world| {
            let apply = |(index, command)| {
                world.apply_in_batch(command, &NEVER_CANCELLED).map_err(|error| BatchError { index, error })
            };
            commands.iter().enumerate().map(apply).collect()
        })
    }

    /// Makes changes one: when they fail, the world is as it was, to the bit; otherwise the revision has grown by one,
    /// if anything was applied. Takes a copy of the world; [`World::apply_all`] does where it needs one.
    ///
    /// ```
    /// use pointmass::{Error, Particle, World};
    /// let mut world = World::<f64>::default();
    /// let two = world.atomically(|world| Ok::<_, Error>([world.create(Particle::default())?, world.create(Particle::default())?]));
    /// assert_eq!((two.is_ok(), world.revision()), (true, 1));
    /// let none = world.atomically(|world| world.create(Particle::default()).and(world.advance(-1.0)));
    /// assert_eq!((none.is_err(), world.revision(), world.particle_count()), (true, 1, 2));
    /// ```
    ///
    /// # Errors
    /// Those of `changes`.
    pub fn atomically<T, E>(&mut self, changes: impl FnOnce(&mut Self) -> Result<T, E>) -> Result<T, E> {
        self.keeping(Keep::Everything, changes)
    }

    /// The same with what these changes need to be taken back.
    pub(crate) fn keeping<T, E>(
        &mut self,
        keep: Keep,
        changes: impl FnOnce(&mut Self) -> Result<T, E>,
    ) -> Result<T, E> {
        let before = R::world_begin(self, keep);
        let result = changes(self);
        R::world_end(self, before, result.is_err());
        result
    }

    pub(super) fn begin_batch(&mut self, keep: Keep) -> Before<R> {
        let kept = match keep {
            Keep::Nothing => Kept::Nothing,
            Keep::Forces => {
                self.history.iter_mut().for_each(|history| history.begin_forces());
                Kept::Forces(self.particles.force.acting().clone(), self.bounds)
            }
            Keep::Everything => Kept::Everything(Box::new(self.clone())),
        };
        Before { kept, limits: self.limits, outer: self.batch.replace(false) }
    }

    pub(super) fn end_batch(&mut self, before: Before<R>, is_refused: bool) {
        let Before { kept, limits, outer } = before;
        let has_changed = std::mem::replace(&mut self.batch, outer) == Some(true);
        self.limits = limits;
        match kept {
            Kept::Forces(..) if !is_refused => self.history.iter_mut().for_each(|history| history.keep_forces()),
            Kept::Forces(force, bounds) => {
                let len = self.particles.len();
                self.particles.force.go_back(force);
                self.bounds = bounds;
                self.history.iter_mut().for_each(|history| history.take_forces_back(len));
            }
            Kept::Everything(before) if is_refused => *self = *before,
            Kept::Nothing | Kept::Everything(_) => {}
        }
        if has_changed && !is_refused {
            self.end_change();
        }
    }

    /// As [`World::apply_unless`]; an advance takes what it cost from the limits, which [`World::keeping`] gives back.
    pub(crate) fn apply_in_batch(&mut self, command: &Command<R>, cancelled: &AtomicBool) -> Result<Outcome, Error> {
        let outcome = self.apply_unless(command, cancelled)?;
        if let Outcome::Advanced(done) = outcome {
            self.spend(done.steps + done.rejected_steps, done.evaluations);
        }
        Ok(outcome)
    }

    /// Takes steps from the limits: what one advance may cost, several may together.
    pub(super) fn spend(&mut self, steps: u64, evaluations: u64) {
        let (len, pairs) = (self.particles.len() as u64, self.pairs());
        let Limits { steps: left, particle_steps, interactions, .. } = &mut self.limits;
        *left = left.saturating_sub(steps);
        *particle_steps = particle_steps.saturating_sub(steps.saturating_mul(len));
        *interactions = interactions.saturating_sub(evaluations.saturating_mul(pairs));
    }
}

#[cfg(all(test, feature = "server"))]
mod tests {
    use super::{Keep, Part};

    #[test]
    fn only_what_may_have_to_be_taken_back_is_kept() {
        const FORCE: Part = Part::Change { adds_forces: true };
        const OTHER: Part = Part::Change { adds_forces: false };
        const SURE: Part = Part::Read { can_fail: false };
        const UNSURE: Part = Part::Read { can_fail: true };
        for (parts, keep) in [
            (&[][..], Keep::Nothing),
            (&[SURE, UNSURE, OTHER, SURE], Keep::Nothing),
            (&[FORCE], Keep::Nothing),
            (&[FORCE, FORCE, OTHER, SURE], Keep::Forces),
            (&[FORCE, UNSURE], Keep::Forces),
            (&[OTHER, UNSURE], Keep::Everything),
            (&[OTHER, FORCE], Keep::Everything),
            (&[FORCE, OTHER, OTHER], Keep::Everything),
        ] {
            assert_eq!(Keep::of(parts.iter().copied()), keep, "{parts:?}");
        }
    }
}
