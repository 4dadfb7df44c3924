//! A world as plainly as it can be said: one list of particles with plain numbers, and what each command does to them.
//! Motion that the formulas do not have, such as the closed form, is taken from the engine; everything else is not.

use std::collections::{BTreeMap, BTreeSet};

use pointmass::{
    Advance, Column, Command, Configure, Drag, Error, Integrator, Limit, Mass, NewParticles, Outcome, ParticleId,
    Properties, Quantity, Real, Selection, Settings, World,
};

use crate::formulas::{self, Naive};
use crate::{LIMITS, STEPS_MAX};

#[derive(Debug, Clone)]
pub(crate) struct Model<R: Real> {
    settings: Settings<R>,
    particles: BTreeMap<u64, Known<R>>,
    pub(crate) next_id: u64,
    /// Unknown once an advance has stopped in a plane: then its sum is not exact any more.
    time: Option<f64>,
    step_count: u64,
    revision: u64,
}

#[derive(Debug, Clone, Copy)]
struct Known<R: Real> {
    naive: Naive<R>,
    drag: Option<Drag<R>>,
    gravitational_mass: Option<R>,
}

/// What a command makes of the model; `None` where it is refused.
type Next<R> = Option<Model<R>>;

impl<R: Real> Model<R> {
    pub(crate) fn new(settings: Settings<R>) -> Self {
        Self { settings, particles: BTreeMap::new(), next_id: 0, time: Some(0.0), step_count: 0, revision: 0 }
    }

    /// Does the same as the world has done, or finds that it should have done something else.
    pub(crate) fn follow(&mut self, command: &Command<R>, outcome: &Result<Outcome, Error>, world: &World<R>) {
        let next = match command {
            Command::Create(new) => self.create(new),
            Command::Place { ids, position, velocity } => self.place(ids, position.as_ref(), velocity.as_ref()),
            Command::Set { ids, properties } => self.set(ids, properties),
            Command::AddForce { ids, force } => self.add_force(ids, force),
            Command::Impulse { ids, impulse } => self.impulse(ids, impulse),
            Command::Remove { ids } => self.remove(ids),
            Command::Advance(advance) => self.advance(advance, outcome, world),
            Command::Configure(configure) => self.configure(configure),
        };
        assert_eq!(next.is_some(), outcome.is_ok(), "{command:?}: {outcome:?}");
        if let Some(next) = next {
            *self = Self { revision: self.revision + 1, ..next };
        }
        self.compare(command, world);
    }

    fn compare(&self, command: &Command<R>, world: &World<R>) {
        assert_eq!(*world.settings(), self.settings, "{command:?}");
        assert_eq!(world.revision(), self.revision, "{command:?}");
        assert_eq!(world.step_count(), self.step_count, "{command:?}");
        assert!(self.time.is_none_or(|time| time == world.time()), "{command:?}: {:?} s", world.time());
        assert_eq!(world.particle_count(), self.particles.len(), "{command:?}");
        for (state, (id, known)) in world.particles().zip(&self.particles) {
            let Known { naive: Naive { p, v, own, d, w, f }, drag, gravitational_mass } = *known;
            assert_eq!(state.id.0, *id, "{command:?}");
            let at = || format!("{command:?}: {state:?} is not {known:?}");
            assert_eq!(bits(state.position.into()), bits(p), "{}", at());
            assert_eq!(bits(state.velocity.into()), bits(v), "{}", at());
            assert_eq!(state.force.into(), f, "{}", at());
            assert_eq!((state.damping, state.inverse_mass), (d, w), "{}", at());
            assert_eq!(state.own_acceleration.map(Into::into), own, "{}", at());
            assert_eq!(state.acceleration.into(), self.acceleration(&known.naive), "{}", at());
            assert_eq!((state.drag, state.gravitational_mass), (drag, gravitational_mass), "{}", at());
        }
    }

    fn acceleration(&self, naive: &Naive<R>) -> [R; 3] {
        naive.own.unwrap_or(if naive.w == R::ZERO { [R::ZERO; 3] } else { self.settings.gravity.into() })
    }

    fn ids(&self, selection: &Selection) -> Option<Vec<u64>> {
        match selection {
            Selection::All => Some(self.particles.keys().copied().collect()),
            Selection::Ids(ids) => ids.iter().map(|id| self.particles.contains_key(&id.0).then_some(id.0)).collect(),
        }
    }

    /// The model after something was done to each of these, in their order.
    fn with_each(&self, ids: &[u64], change: impl Fn(usize, &mut Known<R>) -> Option<()>) -> Next<R> {
        let mut next = self.clone();
        for (i, id) in ids.iter().enumerate() {
            change(i, next.particles.get_mut(id)?)?;
        }
        Some(next)
    }

    fn create(&self, new: &NewParticles<R>) -> Next<R> {
        let count = new.count;
        let position = each(&new.position, count, finite)?;
        let velocity = each(&new.velocity, count, finite)?;
        let own = each(&new.acceleration, count, optional(|own| finite(own).map(|own| own.map(positive))))?;
        let damping = each(&new.damping, count, share)?;
        let inverse_mass = each(&new.mass, count, inverse)?;
        let drag = each(&new.drag, count, optional(valid_drag))?;
        let gravitational_mass = each(&new.gravitational_mass, count, optional(magnitude))?;
        if !self.serves(&damping) || (self.particles.len() + count) as u64 > LIMITS.particles {
            return None;
        }
        let mut next = self.clone();
        for i in 0..count {
            let naive = Naive {
                p: position[i],
                v: velocity[i],
                own: own[i],
                d: damping[i],
                w: inverse_mass[i],
                f: [R::ZERO; 3],
            };
            let known = Known { naive, drag: drag[i], gravitational_mass: gravitational_mass[i] };
            next.particles.insert(next.next_id, known);
            next.next_id += 1;
        }
        Some(next)
    }

    fn place(
        &self,
        ids: &Selection,
        position: Option<&Column<R::Vec3>>,
        velocity: Option<&Column<R::Vec3>>,
    ) -> Next<R> {
        let ids = self.ids(ids)?;
        let position = asked(position, |column| each(column, ids.len(), finite))?;
        let velocity = asked(velocity, |column| each(column, ids.len(), finite))?;
        if position.is_none() && velocity.is_none() {
            return None;
        }
        self.with_each(&ids, |i, Known { naive, .. }| {
            naive.p = position.as_ref().map_or(naive.p, |position| position[i]);
            naive.v = velocity.as_ref().map_or(naive.v, |velocity| velocity[i]);
            Some(())
        })
    }

    fn set(&self, ids: &Selection, new: &Properties<R>) -> Next<R> {
        let ids = self.ids(ids)?;
        let count = ids.len();
        let own = optional(|own| finite(own).map(|own: [R; 3]| own.map(positive)));
        let own = asked(new.acceleration.as_ref(), |column| each(column, count, own))?;
        let damping = asked(new.damping.as_ref(), |column| each(column, count, share))?;
        let inverse_mass = asked(new.mass.as_ref(), |column| each(column, count, inverse))?;
        let drag = asked(new.drag.as_ref(), |column| each(column, count, optional(valid_drag)))?;
        let attracting = asked(new.gravitational_mass.as_ref(), |column| each(column, count, optional(magnitude)))?;
        if damping.as_ref().is_some_and(|damping| !self.serves(damping)) {
            return None;
        }
        self.with_each(&ids, |i, known| {
            let naive = &mut known.naive;
            naive.own = own.as_ref().map_or(naive.own, |own| own[i]);
            naive.d = damping.as_ref().map_or(naive.d, |damping| damping[i]);
            naive.w = inverse_mass.as_ref().map_or(naive.w, |inverse_mass| inverse_mass[i]);
            known.drag = drag.as_ref().map_or(known.drag, |drag| drag[i]);
            known.gravitational_mass = attracting.as_ref().map_or(known.gravitational_mass, |mass| mass[i]);
            Some(())
        })
    }

    fn add_force(&self, ids: &Selection, force: &Column<R::Vec3>) -> Next<R> {
        let ids = self.ids(ids)?;
        let force = each(force, ids.len(), finite)?;
        self.with_each(&ids, |i, Known { naive, .. }| {
            naive.f = finite(sum(naive.f, force[i].map(positive)))?;
            Some(())
        })
    }

    fn impulse(&self, ids: &Selection, impulse: &Column<R::Vec3>) -> Next<R> {
        let ids = self.ids(ids)?;
        let impulse = each(impulse, ids.len(), finite)?;
        self.with_each(&ids, |i, Known { naive, .. }| {
            naive.v = finite(sum(naive.v, impulse[i].map(|j| j * naive.w)))?;
            Some(())
        })
    }

    fn remove(&self, ids: &Selection) -> Next<R> {
        let ids = self.ids(ids)?;
        let different: BTreeSet<u64> = ids.iter().copied().collect();
        if different.len() < ids.len() {
            return None;
        }
        let mut next = self.clone();
        next.particles.retain(|id, _| !different.contains(id));
        Some(next)
    }

    fn configure(&self, change: &Configure<R>) -> Next<R> {
        let mut next = self.clone();
        let settings = &mut next.settings;
        if let Some(gravity) = change.gravity {
            settings.gravity = finite(gravity)?.map(positive).into();
        }
        if let Some(max_step) = change.max_step {
            settings.max_step = asked(max_step, above_zero)?;
        }
        if let Some(drag) = change.drag {
            settings.forces.drag = asked(drag, valid_drag)?;
        }
        if let Some(gravitation) = change.gravitation {
            settings.forces.gravitation = asked(gravitation, |mut gravitation| {
                gravitation.constant = magnitude(gravitation.constant)?;
                gravitation.softening = magnitude(gravitation.softening)?;
                Some(gravitation)
            })?;
        }
        if let Some(mut tolerance) = change.tolerance {
            tolerance.absolute = magnitude(tolerance.absolute)?;
            tolerance.relative = magnitude(tolerance.relative)?;
            if tolerance.absolute == 0.0 && tolerance.relative == 0.0 {
                return None;
            }
            settings.tolerance = tolerance;
        }
        settings.integrator = change.integrator.unwrap_or(settings.integrator);
        settings.damping_law = change.damping_law.unwrap_or(settings.damping_law);
        settings.compensated = change.compensated.unwrap_or(settings.compensated);
        let Settings { integrator, damping_law, forces, .. } = *settings;
        let dampings: Vec<R> = self.particles.values().map(|known| known.naive.d).collect();
        let serves =
            integrator.serves(damping_law) && (integrator.serves_forces() || !forces.any()) && next.serves(&dampings);
        serves.then_some(next)
    }

    /// Whether the integrator can compute with these dampings.
    fn serves(&self, dampings: &[R]) -> bool {
        self.settings.integrator.serves_zero_damping() || !dampings.contains(&R::ZERO)
    }

    fn advance(&self, advance: &Advance, outcome: &Result<Outcome, Error>, world: &World<R>) -> Next<R> {
        let Settings { integrator, forces, .. } = self.settings;
        let duration = advance.duration;
        let steps = self.steps(advance)?;
        let steps = if matches!(integrator, Integrator::Exact | Integrator::Dop853) { 1 } else { steps };
        if let Some(until) = &advance.until {
            let valid = finite(until.plane.normal)? != [0.0; 3] && until.plane.offset.is_finite();
            if !valid || !self.particles.contains_key(&until.particle.0) {
                return None;
            }
        }
        let h = R::nearest(duration / f64::from(steps));
        let is_too_long = duration > 1e100 || (integrator != Integrator::Exact && !finite_number(h));
        if is_too_long || u64::from(steps) * self.particles.len() as u64 > LIMITS.particle_steps {
            return None;
        }
        let mut next = self.clone();
        next.step_count += u64::from(steps);
        next.time = self.time.map(|time| time + duration);
        if integrator.is_euler() && !forces.any() && advance.until.is_none() {
            return self.step(next, h, steps, outcome);
        }
        match outcome {
            Ok(Outcome::Advanced(advanced)) => {
                if advance.until.is_some() {
                    assert!(advanced.duration <= duration, "{advance:?}: {outcome:?}");
                    next.time = next.time.filter(|_| advanced.crossed == Some(false));
                }
                next.step_count = self.step_count + advanced.steps;
                for (known, state) in next.particles.values_mut().zip(world.particles()) {
                    let Naive { p, v, f, .. } = &mut known.naive;
                    *p = finite(state.position).expect("a world holds nothing else");
                    *v = finite(state.velocity).expect("a world holds nothing else");
                    *f = [R::ZERO; 3];
                }
                Some(next)
            }
            Err(Error::Diverged { .. } | Error::TooManySteps { .. }) => None,
            Err(Error::LimitReached { limit: Limit::Interactions, .. }) if forces.gravitation.is_some() => None,
            Ok(_) | Err(_) => panic!("{advance:?}: {outcome:?}"),
        }
    }

    /// Steps by the formulas; refused with the particle of the smallest id that does not stay finite, and its first step.
    fn step(&self, mut next: Self, h: R, steps: u32, outcome: &Result<Outcome, Error>) -> Next<R> {
        let after = |known: &Known<R>, steps| {
            let mut naive = known.naive;
            formulas::advance(&mut naive, &self.settings, pxfm::f_pow, h, steps);
            naive
        };
        let non_finite = |Naive { p, v, .. }: &Naive<R>| {
            let quantity = [(p, Quantity::Position), (v, Quantity::Velocity)];
            quantity.into_iter().find(|(x, _)| !x.iter().copied().all(finite_number)).map(|(_, quantity)| quantity)
        };
        for (id, known) in &mut next.particles {
            let before = *known;
            known.naive = after(&before, steps);
            if non_finite(&known.naive).is_some() {
                let mut ways = (1..=steps).map(|step| (step, non_finite(&after(&before, step))));
                let (step, quantity) = ways.find(|(_, quantity)| quantity.is_some()).expect("the last one is not");
                let quantity = quantity.expect("found above");
                let diverged = Error::Diverged { particle: ParticleId(*id), quantity, step: step.into() };
                assert_eq!(*outcome, Err(diverged));
                return None;
            }
        }
        Some(next)
    }

    /// How many steps an advance asks for: as few as none of them is too long, but for rounding.
    fn steps(&self, advance: &Advance) -> Option<u32> {
        let Advance { duration, steps, max_step, .. } = *advance;
        above_zero(duration)?;
        match (steps, max_step) {
            (Some(_), Some(_)) => None,
            (Some(_), None) if self.settings.integrator == Integrator::Dop853 => None,
            (Some(steps), None) => u32::try_from(steps).ok().filter(|steps| (1..=STEPS_MAX).contains(steps)),
            (None, max_step) => match max_step.or(self.settings.max_step) {
                None => Some(1),
                Some(max_step) => {
                    let longest = above_zero(max_step)? * (1.0 + 1e-9);
                    (1..=STEPS_MAX).find(|steps| duration / f64::from(*steps) <= longest)
                }
            },
        }
    }
}

/// The values of a column, one for each; `None` when there are others than that, or one of them is not valid.
fn each<T: Copy, U: Copy>(column: &Column<T>, count: usize, valid: impl Fn(T) -> Option<U>) -> Option<Vec<U>> {
    match column {
        Column::Uniform(value) => Some(vec![valid(*value)?; count]),
        Column::PerParticle(values) if values.len() == count => values.iter().map(|value| valid(*value)).collect(),
        Column::PerParticle(_) => None,
    }
}

/// What may be absent, and is valid where it is not.
fn asked<T, U>(value: Option<T>, valid: impl FnOnce(T) -> Option<U>) -> Option<Option<U>> {
    value.map_or(Some(None), |value| valid(value).map(Some))
}

fn optional<T, U>(valid: impl Fn(T) -> Option<U>) -> impl Fn(Option<T>) -> Option<Option<U>> {
    move |value| asked(value, &valid)
}

fn finite_number<R: Real>(x: R) -> bool {
    let x: f64 = x.into();
    x.is_finite()
}

fn finite<R: Real>(vector: impl Into<[R; 3]>) -> Option<[R; 3]> {
    Some(vector.into()).filter(|vector| vector.iter().copied().all(finite_number))
}

/// -0 as 0.
fn positive<R: Real>(x: R) -> R {
    x + R::ZERO
}

/// A number that is finite and at least 0.
fn magnitude<R: Real>(x: R) -> Option<R> {
    (finite_number(x) && x >= R::ZERO).then_some(positive(x))
}

fn share<R: Real>(d: R) -> Option<R> {
    magnitude(d).filter(|d| *d <= R::ONE)
}

fn above_zero(x: f64) -> Option<f64> {
    (x.is_finite() && x > 0.0).then_some(x)
}

fn inverse<R: Real>(mass: Mass<R>) -> Option<R> {
    match mass {
        Mass::Mass(m) => magnitude(m).filter(|m| *m > R::ZERO).map(|m| R::ONE / m).filter(|w| finite_number(*w)),
        Mass::Inverse(w) => magnitude(w),
    }
}

fn valid_drag<R: Real>(Drag { k1, k2 }: Drag<R>) -> Option<Drag<R>> {
    Some(Drag { k1: magnitude(k1)?, k2: magnitude(k2)? })
}

fn sum<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    std::array::from_fn(|k| a[k] + b[k])
}

/// -0 is not 0 here.
fn bits<R: Real>(vector: [R; 3]) -> [u64; 3] {
    vector.map(|x| {
        let x: f64 = x.into();
        x.to_bits()
    })
}
