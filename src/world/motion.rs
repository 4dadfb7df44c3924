//! Where particles are at a clock: their bases, carried along the closed form.

use std::ops::Range;

use crate::closed_form::{Among, ClosedForm, Decay, Motion, MotionMut, Same, carry_each, closed_forms, decays};
use crate::column::Column;
use crate::double_double::DoubleDouble;
use crate::particles::zero;
use crate::prefetch;
use crate::real::Real;
use crate::world::World;

/// Particles that are carried together: with all that carries them, they fit into the first cache.
pub(super) const BLOCK: usize = 128;

/// Some rows of the columns.
#[derive(Debug, Clone)]
pub(super) enum Rows<'a> {
    Range(Range<usize>),
    List(&'a [usize]),
}

impl<'a> Rows<'a> {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Range(range) => range.len(),
            Self::List(list) => list.len(),
        }
    }

    pub(super) fn row(&self, index: usize) -> usize {
        match self {
            Self::Range(range) => range.start + index,
            Self::List(list) => list[index],
        }
    }

    pub(super) fn iter(&self) -> impl ExactSizeIterator<Item = usize> + use<'_, 'a> {
        (0..self.len()).map(|index| self.row(index))
    }

    /// The same in pieces of at most a block.
    pub(super) fn blocks(self) -> impl Iterator<Item = Rows<'a>> {
        (0..self.len().div_ceil(BLOCK)).map(move |block| {
            let (from, to) = (block * BLOCK, self.len().min((block + 1) * BLOCK));
            match &self {
                Rows::Range(range) => Rows::Range(range.start + from..range.start + to),
                Rows::List(list) => Rows::List(&list[from..to]),
            }
        })
    }
}

/// The values of some rows.
fn copy_rows<T: Copy>(column: &[T], rows: &Rows<'_>, to: &mut [T]) {
    match rows {
        Rows::Range(range) => to.copy_from_slice(&column[range.clone()]),
        Rows::List(list) => to.iter_mut().zip(*list).for_each(|(to, &row)| *to = column[row]),
    }
}

/// How long each particle is carried.
#[derive(Debug, Clone, Copy)]
pub(super) enum Span {
    /// From its base time to this clock.
    To(DoubleDouble),
    /// All of them by this many seconds.
    By(f64),
}

/// Carries particles along the closed form. E, φ and ψ are computed once where many particles share damping and time.
#[derive(Debug, Clone)]
pub(super) struct Carrier<R: Real> {
    span: Span,
    /// Whether the force acts as well.
    forced: bool,
    /// Nobody is carried at all.
    still: bool,
    /// E, φ and ψ of each distinct base time, when all have the same damping and there are no more of them than particles
    /// to carry; empty otherwise.
    forms: Vec<ClosedForm>,
    /// What carries all of them, if it is the same.
    same: Option<Same>,
    /// The acceleration, if that is.
    uniform_acceleration: Option<[f64; 3]>,
    /// Which of the forms carries each particle of a block.
    named: Vec<u32>,
    /// What carries it otherwise.
    own_forms: Vec<ClosedForm>,
    own_accelerations: Vec<[f64; 3]>,
    /// Where a block starts that is carried in place.
    start: (Vec<[R; 3]>, Vec<[R; 3]>),
}

impl<R: Real> Carrier<R> {
    /// For `count` particles in all.
    pub(super) fn new(world: &World<R>, span: Span, forced: bool, count: usize) -> Self {
        let particles = &world.particles;
        let mut times = Vec::new();
        match span {
            Span::To(clock) if particles.base_time.distinct().len() <= count => {
                times.extend(particles.base_time.distinct().map(|base| (clock - base).hi));
            }
            Span::To(_) => {}
            Span::By(time) => times.push(time),
        }
        let still = times == [0.0];
        let mut forms = Vec::new();
        if let Column::Uniform(damping) = particles.damping
            && !still
        {
            closed_forms(world.level, Among::Uniform(Decay::of(damping)), &times, &mut forms);
        }
        let uniform_acceleration =
            particles.uniform_acceleration(world.gravity()).filter(|_| !forced).map(|a| a.map(Into::into));
        let same = match (forms.as_slice(), uniform_acceleration) {
            ([form], Some(a)) if particles.resting_count() == 0 => Some(Same::new(*form, a)),
            _ => None,
        };
        Self {
            span,
            forced,
            still,
            forms,
            same,
            uniform_acceleration,
            named: Vec::new(),
            own_forms: Vec::new(),
            own_accelerations: Vec::new(),
            start: (Vec::new(), Vec::new()),
        }
    }

    /// Positions and velocities of some rows, carried from the columns. What was in the room for them is overwritten, and
    /// not filled with zeros first: in a room that has been used before, each is written once.
    pub(super) fn read(&mut self, world: &World<R>, rows: &Rows<'_>, p: &mut Vec<[R; 3]>, v: &mut Vec<[R; 3]>) {
        let (positions, velocities) = (&world.particles.position, &world.particles.velocity);
        let fetches = prefetch::is_large(positions);
        p.resize(rows.len(), zero());
        v.resize(rows.len(), zero());
        for (rows, (p, v)) in rows.clone().blocks().zip(p.chunks_mut(BLOCK).zip(v.chunks_mut(BLOCK))) {
            match &rows {
                Rows::Range(range) if !self.still => {
                    let from = (&positions[range.clone()], &velocities[range.clone()]);
                    self.carry_from(world, fetches, &rows, from, (p, v));
                }
                Rows::Range(_) | Rows::List(_) => {
                    copy_rows(positions, &rows, p);
                    copy_rows(velocities, &rows, v);
                    self.carry(world, &rows, p, v);
                }
            }
        }
    }

    /// Carries at most a block of rows, from the given positions and velocities.
    pub(super) fn carry(&mut self, world: &World<R>, rows: &Rows<'_>, p: &mut [[R; 3]], v: &mut [[R; 3]]) {
        if self.still {
            return;
        }
        let mut start = std::mem::take(&mut self.start);
        start.0.clear();
        start.0.extend_from_slice(p);
        start.1.clear();
        start.1.extend_from_slice(v);
        self.carry_from(world, false, rows, (&start.0, &start.1), (p, v));
        self.start = start;
    }

    /// The same from elsewhere; not for those that nothing carries.
    fn carry_from(
        &mut self,
        world: &World<R>,
        fetches: bool,
        rows: &Rows<'_>,
        from: Motion<'_, R>,
        to: MotionMut<'_, R>,
    ) {
        if let Some(same) = &self.same {
            return same.carry(world.level, fetches, from, to);
        }
        let indices = world.particles.base_time.indices().filter(|_| matches!(self.span, Span::To(_)));
        let forms = match (rows, indices) {
            _ if self.forms.is_empty() || world.particles.resting_count() > 0 => {
                self.set_own_forms(world, rows, indices);
                self.named.clear();
                self.named.extend((0..).take(rows.len()));
                (self.own_forms.as_slice(), self.named.as_slice())
            }
            (Rows::Range(range), Some(indices)) => (self.forms.as_slice(), &indices[range.clone()]),
            (_, _) => {
                self.named.clear();
                self.named.extend(rows.iter().map(|row| indices.map_or(0, |indices| indices[row])));
                (self.forms.as_slice(), self.named.as_slice())
            }
        };
        let accelerations = self.uniform_acceleration.map_or_else(
            || {
                let acceleration = |row| if self.forced { world.driving(row) } else { world.acceleration(row) };
                self.own_accelerations.clear();
                self.own_accelerations.extend(rows.iter().map(acceleration));
                Among::Each(&self.own_accelerations)
            },
            Among::Uniform,
        );
        carry_each(world.level, fetches, forms, accelerations, from, to);
    }

    /// The form of each row of a block; those that rest keep every bit.
    fn set_own_forms(&mut self, world: &World<R>, rows: &Rows<'_>, indices: Option<&[u32]>) {
        if self.forms.is_empty() {
            self.compute_forms(world, rows);
        } else {
            let index = |row| indices.map_or(0, |indices| indices[row] as usize);
            self.own_forms.clear();
            self.own_forms.extend(rows.iter().map(|row| self.forms[index(row)]));
        }
        if world.particles.resting_count() > 0 {
            let resting = rows.iter().zip(&mut self.own_forms).filter(|(row, _)| world.particles.is_resting(*row));
            resting.for_each(|(_, form)| *form = ClosedForm::STILL);
        }
    }

    /// E, φ and ψ of each row of a block.
    fn compute_forms(&mut self, world: &World<R>, rows: &Rows<'_>) {
        let times: Vec<f64> = match self.span {
            Span::To(clock) => rows.iter().map(|row| (clock - world.particles.base_time.get(row)).hi).collect(),
            Span::By(time) => vec![time; rows.len()],
        };
        match &world.particles.damping {
            Column::Uniform(damping) => {
                let decay = Decay::of(*damping);
                closed_forms(world.level, Among::Uniform(decay), &times, &mut self.own_forms);
            }
            Column::PerParticle(damping) => {
                let dampings: Vec<R> = rows.iter().map(|row| damping[row]).collect();
                let mut rates = vec![Decay::default(); rows.len()];
                decays(world.level, &dampings, &mut rates);
                closed_forms(world.level, Among::Each(&rates), &times, &mut self.own_forms);
            }
        }
    }
}

impl<R: Real> World<R> {
    /// The acceleration of a row without the share of the force.
    pub(super) fn acceleration(&self, row: usize) -> [f64; 3] {
        self.particles.acceleration(row, self.gravity()).map(Into::into)
    }

    /// The same with the share of the force: a + w F.
    pub(super) fn driving(&self, row: usize) -> [f64; 3] {
        let own = self.acceleration(row);
        let (w, f): (f64, _) = (self.particles.inverse_mass.get(row).into(), self.particles.force.get(row));
        std::array::from_fn(|k| own[k] + w * f[k].into())
    }

    /// Position and velocity of one row at the clock.
    pub(super) fn now(&self, row: usize) -> ([R; 3], [R; 3]) {
        let particles = &self.particles;
        let (mut p, mut v) = ([particles.position[row]], [particles.velocity[row]]);
        let time = (self.clock - particles.base_time.get(row)).hi;
        if time != 0.0 && !particles.is_resting(row) {
            let form = Decay::of(particles.damping.get(row)).over(time);
            form.carry(self.level, self.acceleration(row), &mut p[0], &mut v[0]);
        }
        (p[0], v[0])
    }

    /// Stores what a read of now returns, with the clock as base time. Does nothing under a stepped integrator, whose
    /// states always hold at the clock.
    pub(super) fn rebase(&mut self, row: usize) {
        let (position, velocity) = self.now(row);
        self.particles.set_base(row, position, velocity, self.clock);
    }

    /// The same for many rows.
    pub(super) fn rebase_many(&mut self, rows: &Rows<'_>) {
        let count = rows.len();
        if count < 16 {
            return rows.iter().for_each(|row| self.rebase(row));
        }
        let (mut p, mut v) = (Vec::new(), Vec::new());
        Carrier::new(self, Span::To(self.clock), false, count).read(self, rows, &mut p, &mut v);
        let particles = &mut *self.particles;
        for (row, (p, v)) in rows.iter().zip(p.into_iter().zip(v)) {
            particles.set_base(row, p, v, self.clock);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Carrier, Span};
    use crate::command::Particle;
    use crate::world::World;

    /// A read of a few does not pay for the base times of all the others.
    #[test]
    fn a_short_read_computes_nothing_for_particles_it_does_not_read() {
        let mut world = World::<f64>::default();
        for _ in 0..100 {
            world.create(Particle { damping: 0.5, ..Particle::default() }).expect("valid");
            world.advance(1.0).expect("finite");
        }
        let forms = |count| Carrier::new(&world, Span::To(world.clock), false, count).forms.len();
        assert_eq!((forms(4), forms(99), forms(100)), (0, 0, 100));
    }
}
