//! Which steps are stable: a particle that damping or drag slows down, over 200 steps of one length.
//!
//! Only the product of rate and step matters, so that one number stands for both.

#![expect(clippy::disallowed_methods, reason = "steps to try; no state of a world comes of them")]

use pointmass::{Advance, Drag, Forces, Integrator, Particle, Settings, World};

/// What slows the particle down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Brake {
    Damping,
    Linear,
    Quadratic,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Behaviour {
    Decays,
    /// It changes its sign, or grows for a while, but ends smaller.
    Oscillates,
    /// It ends larger, or is refused.
    Grows,
}

/// Rate times step, from the least on, in equal ratios.
#[derive(Debug, Clone)]
pub(crate) struct Row {
    pub(crate) brake: Brake,
    pub(crate) integrator: Integrator,
    /// Where a behaviour begins.
    pub(crate) changes: Vec<(f64, Behaviour)>,
}

const LEAST: f64 = 0.1;
const MOST: f64 = 1000.0;
const STEPS: u64 = 200;
/// The share of the velocity at which the particle has come to rest.
const STOPPED: f64 = 1e-6;

impl Brake {
    pub(crate) const ALL: [Self; 3] = [Self::Damping, Self::Linear, Self::Quadratic];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Damping => "damping",
            Self::Linear => "linear drag",
            Self::Quadratic => "quadratic drag",
        }
    }
}

impl Behaviour {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Decays => "decays",
            Self::Oscillates => "decays, but changes sign or overshoots",
            Self::Grows => "grows or is refused",
        }
    }
}

/// `small` tries few steps.
pub(crate) fn measure(small: bool) -> Vec<Row> {
    let count = if small { 8 } else { 100 };
    let products = |i: u32| LEAST * (MOST / LEAST).powf(f64::from(i) / f64::from(count));
    let between = |low: f64, high: f64| (low * high).sqrt();
    let mut rows = Vec::new();
    for brake in Brake::ALL {
        let serves = |integrator: &Integrator| brake == Brake::Damping || integrator.serves_forces();
        for integrator in Integrator::ALL.into_iter().filter(serves) {
            let of = |product| behaviour(brake, integrator, product);
            let mut last = of(LEAST);
            let mut changes = vec![(LEAST, last)];
            for (mut low, mut high) in (1..=count).map(|i| (products(i - 1), products(i))) {
                let new = of(high);
                if new == last {
                    continue;
                }
                // To a thousandth.
                while high > 1.001 * low {
                    let middle = between(low, high);
                    if of(middle) == last { low = middle } else { high = middle }
                }
                changes.push((high, new));
                last = new;
            }
            rows.push(Row { brake, integrator, changes });
        }
    }
    rows
}

fn behaviour(brake: Brake, integrator: Integrator, step: f64) -> Behaviour {
    let drag = match brake {
        Brake::Damping => None,
        Brake::Linear => Some(Drag { k1: 1.0, k2: 0.0 }),
        Brake::Quadratic => Some(Drag { k1: 0.0, k2: 1.0 }),
    };
    let damping = if brake == Brake::Damping { (-1.0_f64).exp() } else { 1.0 };
    let forces = Forces { drag, gravitation: None };
    let mut world = World::<f64>::new(Settings { integrator, forces, ..Settings::default() }).expect("it serves them");
    let id = world
        .create(Particle { velocity: [1.0, 0.0, 0.0].into(), damping, ..Particle::default() })
        .expect("a valid particle");
    let (mut speed, mut smooth) = (1.0_f64, true);
    for _ in 0..STEPS {
        if world.advance(Advance::by(step)).is_err() {
            return Behaviour::Grows;
        }
        let after = world.particle(id).expect("it is there").velocity.x;
        // What is left, and its sign, is within the tolerance of an adaptive integrator.
        if after.abs() < STOPPED {
            return if smooth { Behaviour::Decays } else { Behaviour::Oscillates };
        }
        smooth &= after.abs() <= speed.abs() && after * speed >= 0.0;
        speed = after;
    }
    match (smooth, speed.abs() < 1.0) {
        (true, _) => Behaviour::Decays,
        (false, true) => Behaviour::Oscillates,
        (false, false) => Behaviour::Grows,
    }
}

pub(crate) fn threshold(product: f64) -> String {
    crate::table::digits(product)
}
