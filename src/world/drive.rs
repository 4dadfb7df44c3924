//! What drives the particles of a block under a stepped integrator.

use std::collections::HashMap;
use std::ops::Range;

use fearless_simd::Level;

use crate::column::Column;
use crate::integrator::DampingLaw;
use crate::kernel::{self, Acceleration, Drive, Step};
use crate::particles::{Driving, Particles};
use crate::real::Real;
use crate::world::World;

/// D of every particle, kept while dampings and step length stay: a pow for each distinct damping, once.
#[derive(Debug, Clone, Default)]
pub(super) struct Factors<R> {
    /// The law and the step length that the values are for.
    of: Option<(DampingLaw, R)>,
    /// D of the uniform damping, or of each particle.
    values: Vec<R>,
    /// Whether every damping is below 1.
    all_damped: bool,
}

impl<R: Real> Factors<R> {
    /// What is kept is not for these dampings any more.
    pub(super) fn forget(&mut self) {
        self.of = None;
    }

    pub(super) fn prepare(&mut self, damping: &Column<R>, law: DampingLaw, h: R) {
        let mut seen = HashMap::new();
        let mut last = (R::ONE, R::ONE);
        self.values.clear();
        self.values.extend(damping.entries().map(|(_, damping)| {
            if damping != last.0 {
                let exact: f64 = damping.into();
                last = (damping, *seen.entry(exact.to_bits()).or_insert_with(|| damping_factor(law, damping, h)));
            }
            last.1
        }));
        self.all_damped = damping.entries().all(|(_, damping)| damping < R::ONE);
        self.of = Some((law, h));
    }

    /// D of each of some rows.
    pub(super) fn of_rows(&self, rows: Range<usize>) -> Vec<R> {
        rows.map(|row| if self.values.len() == 1 { self.values[0] } else { self.values[row] }).collect()
    }
}

/// D: `damping` to the power of h, correctly rounded in double, then rounded to the precision of the world.
fn damping_factor<R: Real>(law: DampingLaw, damping: R, h: R) -> R {
    match law {
        DampingLaw::PerStep => damping,
        DampingLaw::PerSecond => R::nearest(pxfm::f_pow(damping.into(), h.into())),
    }
}

/// Particles that are moved together where something has to be computed for each: with all that drives them, they fit
/// into the first cache.
pub(super) const BLOCK: usize = 256;

/// Room for what drives the components of one block, where no column has it as it is.
#[derive(Debug, Default)]
pub(super) struct Scratch<R> {
    acceleration: Option<Room<R>>,
    factor: Option<Room<R>>,
    rest: Option<Room<R>>,
}

type Room<R> = [[R; 3]; BLOCK];

/// The room for `len` particles, made when it is first needed: making it takes as long as ten particles.
fn room<R: Real>(room: &mut Option<Room<R>>, len: usize) -> &mut [[R; 3]] {
    &mut room.get_or_insert_with(|| [[R::ZERO; 3]; BLOCK])[..len]
}

impl<R: Real> World<R> {
    /// Computes D for steps of this length, unless it is there.
    pub(super) fn prepare_factors(&mut self, h: R) {
        let law = self.settings.damping_law;
        if self.factors.of != Some((law, h)) {
            self.factors.prepare(&self.particles.damping, law, h);
        }
    }

    /// The driver of this world, while nothing of it is written.
    pub(super) fn driver(&self) -> Driver<'_, R> {
        Driver { level: self.level, gravity: self.gravity(), particles: &self.particles, factors: &self.factors }
    }
}

/// What drives the particles of a world, wherever their positions and velocities are.
#[derive(Debug)]
pub(super) struct Driver<'a, R: Real> {
    pub(super) level: Level,
    pub(super) gravity: [R; 3],
    pub(super) particles: &'a Particles<R>,
    /// For steps of the length that is asked for.
    pub(super) factors: &'a Factors<R>,
}

impl<R: Real> Driver<'_, R> {
    /// Takes some steps with the rows from `first` on, except those at rest: all steps of a block while it is in the
    /// cache.
    pub(super) fn advance(&self, step: Step<R>, steps: u64, first: usize, p: &mut [[R; 3]], v: &mut [[R; 3]]) {
        let particles = self.particles;
        let rests = particles.resting_count() > 0;
        if !rests && let Some(drive) = self.drive_as_it_is(first..first + p.len()) {
            return kernel::advance(self.level, step, drive, steps, p.as_flattened_mut(), v.as_flattened_mut());
        }
        let mut scratch = Scratch::default();
        for (block, (p, v)) in p.chunks_mut(BLOCK).zip(v.chunks_mut(BLOCK)).enumerate() {
            let rows = first + block * BLOCK..first + block * BLOCK + p.len();
            let resting = |row: &usize| rests && particles.is_resting(*row);
            if rows.clone().all(|row| resting(&row)) {
                continue;
            }
            // Those at rest are moved along and put back.
            let kept: Vec<_> = rows.clone().zip(p.iter().zip(&*v)).filter(|(row, _)| resting(row)).collect();
            let kept: Vec<_> = kept.into_iter().map(|(row, (p, v))| (row - rows.start, *p, *v)).collect();
            let drive = self.drive(rows, &mut scratch);
            kernel::advance(self.level, step, drive, steps, p.as_flattened_mut(), v.as_flattened_mut());
            for (row, place, speed) in kept {
                (p[row], v[row]) = (place, speed);
            }
        }
    }

    /// What drives some rows, if nothing has to be computed for each of them.
    fn drive_as_it_is(&self, rows: Range<usize>) -> Option<Drive<'_, R>> {
        Some(Drive { acceleration: self.acceleration_as_it_is(rows)?, damping: self.damping_as_it_is()? })
    }

    /// What drives the rows of a block.
    pub(super) fn drive<'a>(&'a self, rows: Range<usize>, scratch: &'a mut Scratch<R>) -> Drive<'a, R> {
        let len = rows.len();
        let acceleration = self.acceleration_as_it_is(rows.clone()).unwrap_or_else(|| {
            let filled = room(&mut scratch.acceleration, len);
            self.particles.fill_acceleration(self.level, self.gravity, rows.clone(), filled);
            Acceleration::Each(filled.as_flattened())
        });
        let damping = self.damping_as_it_is().unwrap_or_else(|| {
            let factor = room(&mut scratch.factor, len).as_flattened_mut();
            kernel::to_components(self.level, &self.factors.values[rows.clone()], factor);
            if self.factors.all_damped {
                return kernel::Damping::Each(factor);
            }
            let rests = room(&mut scratch.rest, len);
            for (rest, row) in rests.iter_mut().zip(rows) {
                *rest = [if self.particles.damping.get(row) < R::ONE { R::REST } else { R::ZERO }; 3];
            }
            kernel::Damping::Mixed { factor, rest: rests.as_flattened() }
        });
        Drive { acceleration, damping }
    }

    fn acceleration_as_it_is(&self, rows: Range<usize>) -> Option<Acceleration<'_, R>> {
        match self.particles.driving_acceleration(self.gravity, rows) {
            Driving::Uniform(uniform) => Some(Acceleration::Uniform(uniform)),
            Driving::Column(column) => Some(Acceleration::Each(column.as_flattened())),
            Driving::Each => None,
        }
    }

    fn damping_as_it_is(&self) -> Option<kernel::Damping<'_, R>> {
        match self.particles.damping {
            Column::Uniform(damping) if damping == R::ONE => Some(kernel::Damping::None),
            Column::Uniform(_) => Some(kernel::Damping::Uniform(self.factors.values[0])),
            Column::PerParticle(_) => None,
        }
    }
}
