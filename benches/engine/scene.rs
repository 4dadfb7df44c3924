//! Worlds to measure, the same in every run, and how all of a world is read.

use pointmass::{Column, Command, Integrator, Mass, NewParticles, ParticleId, Selection, Settings, States, World};

use crate::machine::Number;

/// A step of a game, in seconds.
pub(crate) const STEP: f64 = 1.0 / 60.0;

/// Numbers that look random (`SplitMix64`), the same in every run.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * ((self.bits() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// Each component up to `size` in magnitude.
    pub(crate) fn vector<R: Number>(&mut self, size: f64) -> R::Vec3 {
        std::array::from_fn(|_| R::nearest(self.between(-size, size))).into()
    }

    pub(crate) fn below(&mut self, n: usize) -> usize {
        usize::try_from(self.bits() % n as u64).expect("below a usize")
    }

    pub(crate) fn shuffle<T>(&mut self, list: &mut [T]) {
        for i in (1..list.len()).rev() {
            list.swap(i, self.below(i + 1));
        }
    }
}

/// Which properties particles share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Shape {
    /// All but position and velocity.
    Uniform,
    /// None: each has an acceleration, a damping and a mass of its own.
    Each,
    /// None, and a force is added to each before every advance, outside of the timing.
    EachForced,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene {
    pub(crate) shape: Shape,
    /// Otherwise every damping is 1.
    pub(crate) damped: bool,
    pub(crate) n: usize,
}

impl Scene {
    pub(crate) fn name(self) -> String {
        let shape = match self.shape {
            Shape::Uniform => "uniform",
            Shape::Each => "per-particle",
            Shape::EachForced => "per-particle and force",
        };
        format!("{shape}, {}", if self.damped { "damped" } else { "undamped" })
    }

    pub(crate) fn particles<R: Number>(self) -> NewParticles<R> {
        let mut random = Random(1);
        let mut vectors = |size| Column::PerParticle((0..self.n).map(|_| random.vector::<R>(size)).collect());
        let (position, velocity) = (vectors(100.0), vectors(10.0));
        let damping = Column::Uniform(R::nearest(if self.damped { 0.99 } else { 1.0 }));
        let mut new = NewParticles { count: self.n, position, velocity, damping, ..NewParticles::default() };
        if self.shape != Shape::Uniform {
            let mut each = |low, high| (0..self.n).map(|_| R::nearest(random.between(low, high))).collect::<Vec<R>>();
            new.mass = Column::PerParticle(each(0.5, 5.0).into_iter().map(Mass::Mass).collect());
            if self.damped {
                new.damping = Column::PerParticle(each(0.9, 0.999));
            }
            new.acceleration = Column::PerParticle((0..self.n).map(|_| Some(random.vector::<R>(10.0))).collect());
        }
        new
    }

    pub(crate) fn world<R: Number>(self, integrator: Integrator) -> World<R> {
        // Not straight down: a damped velocity that nothing drives decays into denormals when a fast case takes a million
        // steps, and the book would be measured with those.
        let gravity = [R::ONE, R::nearest(-9.80665), R::ONE].into();
        let mut world = World::new(Settings { integrator, gravity, ..Settings::default() }).expect("valid settings");
        world.apply(&Command::Create(self.particles())).expect("valid particles");
        world
    }

    pub(crate) fn forces<R: Number>(self) -> Vec<R::Vec3> {
        let mut random = Random(2);
        (0..self.n).map(|_| random.vector::<R>(20.0)).collect()
    }
}

/// The command that adds a force to each particle.
pub(crate) fn add_forces<R: Number>(forces: Vec<R::Vec3>) -> Command<R> {
    Command::AddForce { ids: Selection::All, force: Column::PerParticle(forces) }
}

/// What a program that draws or sends a world needs of it. Buffers are kept from one read to the next.
pub(crate) fn read_all<R: Number>(world: &World<R>, into: &mut States<R>) {
    world.read(ParticleId(0), usize::MAX, into);
}
