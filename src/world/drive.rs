//! What drives the particles of a block under a stepped integrator.

use std::collections::HashMap;
use std::ops::Range;

use crate::column::Column;
use crate::integrator::DampingLaw;
use crate::kernel::{self, Drive};
use crate::particles::Driving;
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
        if self.of == Some((law, h)) {
            return;
        }
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
}

/// D: `damping` to the power of h, correctly rounded in double, then rounded to the precision of the world.
fn damping_factor<R: Real>(law: DampingLaw, damping: R, h: R) -> R {
    match law {
        DampingLaw::PerStep => damping,
        DampingLaw::PerSecond => R::nearest(pxfm::f_pow(damping.into(), h.into())),
    }
}

/// Particles that are moved together: with all that drives them, they fit into the first cache.
pub(super) const BLOCK: usize = 256;

/// Room for what drives the components of one block, where no column has it as it is. The world keeps it, so that an
/// advance allocates nothing; it is as large as the scene needs, and at most one block.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch<R> {
    acceleration: Vec<R>,
    /// What the acceleration is filled with, when it is the same for all.
    uniform: Option<[R; 3]>,
    factor: Vec<R>,
    rest: Vec<R>,
}

impl<R: Real> Scratch<R> {
    /// What drives the particles of some rows. Decided by values: a column of equal values is no different from a
    /// uniform one.
    pub(super) fn drive<'a>(&'a mut self, world: &'a World<R>, rows: Range<usize>) -> Drive<'a, R> {
        let particles = &world.particles;
        let len = 3 * rows.len();
        let at_least = |buffer: &mut Vec<R>| buffer.resize(buffer.len().max(len), R::ZERO);
        let acceleration = match particles.driving_acceleration(world.gravity(), rows.clone()) {
            Driving::Column(column) => column.as_flattened(),
            Driving::Uniform(uniform) => {
                if self.uniform != Some(uniform) || self.acceleration.len() < len {
                    at_least(&mut self.acceleration);
                    self.acceleration.as_chunks_mut::<3>().0.fill(uniform);
                    self.uniform = Some(uniform);
                }
                &self.acceleration[..len]
            }
            Driving::Each => {
                self.uniform = None;
                at_least(&mut self.acceleration);
                particles.fill_acceleration(world.gravity(), rows.clone(), self.acceleration.as_chunks_mut::<3>().0);
                &self.acceleration[..len]
            }
        };
        let damping = match &particles.damping {
            Column::Uniform(d) if *d == R::ONE => kernel::Damping::None,
            Column::Uniform(_) => kernel::Damping::Uniform(world.factors.values[0]),
            Column::PerParticle(dampings) => {
                at_least(&mut self.factor);
                let factor = &mut self.factor[..len];
                kernel::to_components(world.level, &world.factors.values[rows.clone()], factor);
                if world.factors.all_damped {
                    kernel::Damping::Each(factor)
                } else {
                    at_least(&mut self.rest);
                    for (rest, damping) in self.rest.as_chunks_mut::<3>().0.iter_mut().zip(&dampings[rows]) {
                        *rest = [if *damping < R::ONE { R::REST } else { R::ZERO }; 3];
                    }
                    kernel::Damping::Mixed { factor, rest: &self.rest[..len] }
                }
            }
        };
        Drive { acceleration, damping }
    }
}
