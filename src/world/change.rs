//! The commands other than an advance: each is validated as a whole before the first value changes.

use std::collections::{HashMap, HashSet};

use crate::column::Column;
use crate::command::{Configure, Mass, NewParticles, Outcome, Properties, Selection, Settings, Tolerance};
use crate::error::{Error, Field, Limit, Place, Quantity};
use crate::forces::{Drag, Gravitation};
use crate::ids::ParticleId;
use crate::particles::{New, Residuals, zero};
use crate::real::Real;
use crate::world::bounds::{Bounds, magnitude};
use crate::world::motion::Rows;
use crate::world::{World, add};

impl<R: Real> World<R> {
    fn rows(&self, ids: &Selection) -> Result<Vec<usize>, Error> {
        match ids {
            Selection::All => Ok(self.ids.from(0).map(|(_, row)| row).collect()),
            Selection::Ids(ids) => ids
                .iter()
                .enumerate()
                .map(|(index, &id)| self.ids.row(id).ok_or(Error::UnknownParticle { id, index }))
                .collect(),
        }
    }

    pub(super) fn create_columns(&mut self, new: &NewParticles<R>) -> Result<Outcome, Error> {
        let count = new.count;
        check_vectors(&new.position, Field::Position, count)?;
        check_vectors(&new.velocity, Field::Velocity, count)?;
        let acceleration = accelerations(&new.acceleration, count)?;
        let damping = dampings(&new.damping, count)?;
        let inverse_mass = inverse_masses(&new.mass, count)?;
        let drag = drags(&new.drag, count)?;
        let gravitational_mass = gravitational_masses(&new.gravitational_mass, count)?;
        self.serve_dampings(&damping, count)?;
        let len = self.particles.len();
        let asked = (len as u64).saturating_add(count as u64);
        if asked > self.limits.particles {
            return Err(Error::LimitReached { limit: Limit::Particles, allowed: self.limits.particles, asked });
        }
        let (position, velocity) = (&new.position, &new.velocity);
        let new = New { position, velocity, acceleration, damping, inverse_mass, drag, gravitational_mass };
        self.particles.extend(&new, count, self.clock, self.settings.compensated);
        self.factors.forget();
        for row in len..len + count {
            self.bounds.include(&self.particles, row);
        }
        Ok(Outcome::Created { first: self.ids.create(count), count })
    }

    pub(super) fn place_all(
        &mut self,
        ids: &Selection,
        position: Option<&Column<R::Vec3>>,
        velocity: Option<&Column<R::Vec3>>,
    ) -> Result<Outcome, Error> {
        if position.is_none() && velocity.is_none() {
            return Err(Error::NothingToPlace);
        }
        let rows = self.rows(ids)?;
        for (column, field) in [(position, Field::Position), (velocity, Field::Velocity)] {
            column.map_or(Ok(()), |column| check_vectors(column, field, rows.len()))?;
        }
        self.rebase_many(&Rows::List(&rows));
        let particles = &mut *self.particles;
        for (i, &row) in rows.iter().enumerate() {
            if let Some(position) = position {
                particles.position[row] = position.get(i).into();
                particles.residual.position.get_mut(row).into_iter().for_each(|residual| *residual = zero());
            }
            if let Some(velocity) = velocity {
                particles.velocity[row] = velocity.get(i).into();
                particles.residual.velocity.get_mut(row).into_iter().for_each(|residual| *residual = zero());
            }
            particles.note_rest(row);
            self.bounds.include(particles, row);
        }
        Ok(Outcome::Changed { count: rows.len() })
    }

    pub(super) fn set_all(&mut self, ids: &Selection, new: &Properties<R>) -> Result<Outcome, Error> {
        let rows = self.rows(ids)?;
        let count = rows.len();
        let acceleration = new.acceleration.as_ref().map(|column| accelerations(column, count)).transpose()?;
        let damping = new.damping.as_ref().map(|column| dampings(column, count)).transpose()?;
        let inverse_mass = new.mass.as_ref().map(|column| inverse_masses(column, count)).transpose()?;
        let drag = new.drag.as_ref().map(|column| drags(column, count)).transpose()?;
        let gravitational_mass =
            new.gravitational_mass.as_ref().map(|column| gravitational_masses(column, count)).transpose()?;
        damping.as_ref().map_or(Ok(()), |damping| self.serve_dampings(damping, count))?;
        if acceleration.is_some() || damping.is_some() || inverse_mass.is_some() {
            self.rebase_many(&Rows::List(&rows));
        }
        if damping.is_some() {
            self.factors.forget();
        }
        let every = *ids == Selection::All;
        let particles = &mut *self.particles;
        let len = particles.len();
        let has_own = acceleration.as_ref().map(|column| column.map(|own| own.is_some()).collapsed());
        let own = acceleration.map(|column| column.map(Option::unwrap_or_default));
        assign(&mut particles.has_own_acceleration, has_own, &rows, every, len);
        assign(&mut particles.own_acceleration, own, &rows, every, len);
        assign(&mut particles.damping, damping, &rows, every, len);
        assign(&mut particles.drag, drag, &rows, every, len);
        assign(&mut particles.gravitational_mass, gravitational_mass, &rows, every, len);
        match inverse_mass {
            None => {}
            Some(Column::Uniform(w)) if every => particles.set_inverse_masses(w),
            Some(column) => {
                rows.iter().enumerate().for_each(|(i, &row)| particles.set_inverse_mass(row, column.get(i)));
            }
        }
        for &row in &rows {
            particles.note_rest(row);
            self.bounds.include(particles, row);
        }
        Ok(Outcome::Changed { count: rows.len() })
    }

    pub(super) fn add_forces(&mut self, ids: &Selection, force: &Column<R::Vec3>) -> Result<Outcome, Error> {
        let rows = self.rows(ids)?;
        check_vectors(force, Field::Force, rows.len())?;
        let newtons = |force: R::Vec3| force.into().map(positive_zero);
        let len = self.particles.len();
        if let (Selection::All, Column::Uniform(uniform), Some(old)) = (ids, force, self.particles.force.uniform())
            && len > 0
        {
            let sum = add(old, newtons(*uniform));
            if !sum.iter().all(|x| x.is_finite()) {
                return Err(self.overflow(rows[0], Quantity::Force, Field::Force, force, 0));
            }
            self.particles.force.set_all(sum);
            self.bounds.force = self.bounds.force.max(magnitude(sum));
            return Ok(Outcome::Changed { count: len });
        }
        let largest = force.entries().map(|(_, force)| magnitude(newtons(force))).fold(0.0, f64::max);
        // A particle may be named by all of them.
        #[expect(clippy::cast_precision_loss, reason = "an estimate")]
        let most = self.bounds.force + largest * rows.len() as f64;
        let may_overflow = most >= 0.5 * R::LARGEST;
        let before = may_overflow.then(|| self.particles.force.clone());
        let particles = &mut *self.particles;
        for (i, &row) in rows.iter().enumerate() {
            let sum = particles.force.add(row, newtons(force.get(i)), rows.len() - i, len);
            if let Some(before) = &before
                && !sum.iter().all(|x| x.is_finite())
            {
                particles.force = before.clone();
                return Err(self.overflow(row, Quantity::Force, Field::Force, force, i));
            }
        }
        self.bounds.force = most;
        Ok(Outcome::Changed { count: rows.len() })
    }

    pub(super) fn apply_impulses(&mut self, ids: &Selection, impulse: &Column<R::Vec3>) -> Result<Outcome, Error> {
        let rows = self.rows(ids)?;
        check_vectors(impulse, Field::Impulse, rows.len())?;
        // The new velocities are computed aside: a particle that is named twice starts from its first one.
        let mut velocities: HashMap<usize, [R; 3]> = HashMap::with_capacity(rows.len());
        for (i, &row) in rows.iter().enumerate() {
            let velocity = velocities.entry(row).or_insert_with(|| self.now(row).1);
            let w = self.particles.inverse_mass.get(row);
            *velocity = add(*velocity, impulse.get(i).into().map(|j| j * w));
            if !velocity.iter().all(|x| x.is_finite()) {
                return Err(self.overflow(row, Quantity::Velocity, Field::Impulse, impulse, i));
            }
        }
        for (row, velocity) in velocities {
            self.rebase(row);
            self.particles.velocity[row] = velocity;
            self.particles.note_rest(row);
            self.bounds.include(&self.particles, row);
        }
        Ok(Outcome::Changed { count: rows.len() })
    }

    fn overflow<T: Copy + PartialEq>(
        &self,
        row: usize,
        quantity: Quantity,
        field: Field,
        column: &Column<T>,
        index: usize,
    ) -> Error {
        let index = column.len_if_per_particle().map(|_| index);
        Error::Overflow { particle: self.ids.id(row), quantity, place: Place { field, index } }
    }

    pub(super) fn remove_all(&mut self, selection: &Selection) -> Result<Outcome, Error> {
        let listed: Vec<ParticleId> = match selection {
            Selection::All => self.ids.from(0).map(|(id, _)| id).collect(),
            Selection::Ids(ids) => {
                self.rows(selection)?;
                let mut seen = HashSet::with_capacity(ids.len());
                if let Some((index, &id)) = ids.iter().enumerate().find(|(_, id)| !seen.insert(**id)) {
                    return Err(Error::RemovedTwice { id, index });
                }
                ids.clone()
            }
        };
        for &id in &listed {
            let row = self.ids.remove(id).expect("every id was looked up above");
            self.particles.swap_remove(row);
            self.note_removal(id, row);
        }
        self.factors.forget();
        Ok(Outcome::Changed { count: listed.len() })
    }

    pub(super) fn configure(&mut self, change: &Configure<R>) -> Result<(), Error> {
        let mut settings = self.settings;
        if let Some(gravity) = change.gravity {
            check_finite(gravity.into(), Field::Gravity.whole())?;
            settings.gravity = gravity.into().map(positive_zero).into();
        }
        if let Some(max_step) = change.max_step {
            settings.max_step = max_step.map(valid_max_step).transpose()?;
        }
        settings.integrator = change.integrator.unwrap_or(settings.integrator);
        settings.damping_law = change.damping_law.unwrap_or(settings.damping_law);
        if let Some(drag) = change.drag {
            settings.forces.drag = drags(&Column::Uniform(drag), 0)?.get(0);
        }
        if let Some(gravitation) = change.gravitation {
            settings.forces.gravitation = gravitation.map(valid_gravitation).transpose()?;
        }
        if let Some(tolerance) = change.tolerance {
            settings.tolerance = valid_tolerance(tolerance)?;
        }
        settings.compensated = change.compensated.unwrap_or(settings.compensated);
        let Settings { integrator, damping_law, forces, .. } = settings;
        if !integrator.serves(damping_law) {
            return Err(Error::IntegratorCannotServeDamping { integrator, damping_law });
        }
        if forces.any() && !integrator.serves_forces() {
            return Err(Error::IntegratorCannotServeForces { integrator });
        }
        let stops_at_once = || self.particles.damping.entries().any(|(_, damping)| damping == R::ZERO);
        if change.integrator.is_some()
            && !integrator.serves_zero_damping()
            && self.particles.len() > 0
            && stops_at_once()
        {
            return Err(Error::IntegratorCannotServeZeroDamping { integrator, place: None });
        }
        let motion_changes = change.integrator.is_some() || change.gravity.is_some();
        if motion_changes {
            let rows: Vec<usize> = (0..self.particles.len())
                .filter(|&row| change.integrator.is_some() || self.follows_gravity(row))
                .collect();
            self.note_rebase(&rows);
            self.rebase_many(&Rows::List(&rows));
        }
        // Another integrator begins with what can be read.
        if settings.compensated != self.settings.compensated || change.integrator.is_some() {
            let len = if settings.compensated { self.particles.len() } else { 0 };
            self.particles.residual = Residuals::zero(len);
        }
        let gravity_differs = settings.gravity != self.settings.gravity;
        self.settings = settings;
        if gravity_differs {
            self.note_gravity();
        }
        if motion_changes {
            self.bounds = Bounds::of(&self.particles, settings.gravity.into());
        }
        Ok(())
    }

    /// Refuses dampings that the integrator cannot compute with.
    pub(super) fn serve_dampings(&self, dampings: &Column<R>, count: usize) -> Result<(), Error> {
        let integrator = self.settings.integrator;
        if integrator.serves_zero_damping() || count == 0 {
            return Ok(());
        }
        match dampings.entries().find(|(_, damping)| *damping == R::ZERO) {
            None => Ok(()),
            Some((index, _)) => {
                let place = Some(Place { field: Field::Damping, index });
                Err(Error::IntegratorCannotServeZeroDamping { integrator, place })
            }
        }
    }

    pub(super) fn follows_gravity(&self, row: usize) -> bool {
        !self.particles.has_own_acceleration.get(row) && self.particles.inverse_mass.get(row) != R::ZERO
    }
}

/// -0 as 0, so that adding it changes no bit.
pub(super) fn positive_zero<R: Real>(x: R) -> R {
    x + R::ZERO
}

pub(super) fn valid_max_step(max_step: f64) -> Result<f64, Error> {
    if !max_step.is_finite() {
        Err(Error::NotFinite(Field::MaxStep.whole()))
    } else if max_step <= 0.0 {
        Err(Error::MaxStepNotPositive)
    } else {
        Ok(max_step)
    }
}

fn check_len<T: Copy + PartialEq>(column: &Column<T>, field: Field, expected: usize) -> Result<(), Error> {
    match column.len_if_per_particle() {
        Some(len) if len != expected => Err(Error::LengthMismatch { field, len, expected }),
        Some(_) | None => Ok(()),
    }
}

fn check_each<T: Copy + PartialEq>(
    column: &Column<T>,
    field: Field,
    count: usize,
    check: impl Fn(T, Place) -> Result<(), Error>,
) -> Result<(), Error> {
    check_len(column, field, count)?;
    column.entries().try_for_each(|(index, value)| check(value, Place { field, index }))
}

pub(super) fn check_finite<R: Real>(x: [R; 3], place: Place) -> Result<(), Error> {
    if x.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(Error::NotFinite(place)) }
}

fn check_vectors<R: Real, V: Copy + PartialEq + Into<[R; 3]>>(
    column: &Column<V>,
    field: Field,
    count: usize,
) -> Result<(), Error> {
    check_each(column, field, count, |v, place| check_finite(v.into(), place))
}

fn accelerations<R: Real, V: Copy + PartialEq + Into<[R; 3]>>(
    column: &Column<Option<V>>,
    count: usize,
) -> Result<Column<Option<[R; 3]>>, Error> {
    check_each(column, Field::Acceleration, count, |own, place| {
        own.map_or(Ok(()), |own| check_finite(own.into(), place))
    })?;
    Ok(column.map(|own| own.map(|own| own.into().map(positive_zero))))
}

fn dampings<R: Real>(column: &Column<R>, count: usize) -> Result<Column<R>, Error> {
    check_each(column, Field::Damping, count, check_damping)?;
    Ok(column.map(positive_zero))
}

pub(super) fn check_damping<R: Real>(d: R, place: Place) -> Result<(), Error> {
    if !d.is_finite() {
        Err(Error::NotFinite(place))
    } else if d < R::ZERO || d > R::ONE {
        Err(Error::DampingOutOfRange(place))
    } else {
        Ok(())
    }
}

/// A number that is finite and at least 0.
pub(super) fn check_magnitude<R: Real>(x: R, place: Place) -> Result<(), Error> {
    if !x.is_finite() {
        Err(Error::NotFinite(place))
    } else if x < R::ZERO {
        Err(Error::Negative(place))
    } else {
        Ok(())
    }
}

fn drags<R: Real>(column: &Column<Option<Drag<R>>>, count: usize) -> Result<Column<Option<Drag<R>>>, Error> {
    check_each(column, Field::Drag, count, |drag, place| drag.map_or(Ok(()), |drag| check_drag(drag, place)))?;
    Ok(column.map(|drag| drag.map(|Drag { k1, k2 }| Drag { k1: positive_zero(k1), k2: positive_zero(k2) })))
}

pub(super) fn check_drag<R: Real>(Drag { k1, k2 }: Drag<R>, place: Place) -> Result<(), Error> {
    check_magnitude(k1, Place { field: Field::K1, ..place })?;
    check_magnitude(k2, Place { field: Field::K2, ..place })
}

fn gravitational_masses<R: Real>(column: &Column<Option<R>>, count: usize) -> Result<Column<Option<R>>, Error> {
    check_each(column, Field::GravitationalMass, count, |mass, place| {
        mass.map_or(Ok(()), |m| check_magnitude(m, place))
    })?;
    Ok(column.map(|mass| mass.map(positive_zero)))
}

fn valid_gravitation<R: Real>(gravitation: Gravitation<R>) -> Result<Gravitation<R>, Error> {
    let Gravitation { constant, softening } = gravitation;
    check_magnitude(constant, Field::Constant.whole())?;
    check_magnitude(softening, Field::Softening.whole())?;
    Ok(Gravitation { constant: positive_zero(constant), softening: positive_zero(softening) })
}

fn valid_tolerance(tolerance: Tolerance) -> Result<Tolerance, Error> {
    let Tolerance { absolute, relative } = tolerance;
    check_magnitude(absolute, Field::Absolute.whole())?;
    check_magnitude(relative, Field::Relative.whole())?;
    if absolute == 0.0 && relative == 0.0 {
        return Err(Error::ToleranceZero);
    }
    Ok(Tolerance { absolute: positive_zero(absolute), relative: positive_zero(relative) })
}

fn inverse_masses<R: Real>(column: &Column<Mass<R>>, count: usize) -> Result<Column<R>, Error> {
    check_each(column, Field::Mass, count, |mass, place| {
        let place = match mass {
            Mass::Mass(_) => place,
            Mass::Inverse(_) => Place { field: Field::InverseMass, ..place },
        };
        check_mass(mass, place)
    })?;
    Ok(column.map(|mass| match mass {
        Mass::Mass(m) => R::ONE / m,
        Mass::Inverse(w) => positive_zero(w),
    }))
}

pub(super) fn check_mass<R: Real>(mass: Mass<R>, place: Place) -> Result<(), Error> {
    match mass {
        Mass::Mass(m) | Mass::Inverse(m) if !m.is_finite() => Err(Error::NotFinite(place)),
        Mass::Mass(m) if m <= R::ZERO => Err(Error::MassNotPositive(place)),
        Mass::Mass(m) if !(R::ONE / m).is_finite() => Err(Error::MassTooSmall(place)),
        Mass::Inverse(w) if w < R::ZERO => Err(Error::InverseMassNegative(place)),
        Mass::Mass(_) | Mass::Inverse(_) => Ok(()),
    }
}

/// Writes new values to some rows; one value for every particle makes the column uniform.
fn assign<T: Copy + PartialEq>(
    column: &mut Column<T>,
    values: Option<Column<T>>,
    rows: &[usize],
    every: bool,
    len: usize,
) {
    match values {
        None => {}
        Some(Column::Uniform(value)) if every => *column = Column::Uniform(value),
        Some(values) => rows.iter().enumerate().for_each(|(i, &row)| column.set(row, values.get(i), len)),
    }
}
