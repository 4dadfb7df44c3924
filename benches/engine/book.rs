//! The particle of the book (Ian Millington, *Game Physics Engine Development*, chapter 3): one struct for each particle,
//! one pow for each particle and step. Said in Rust as the book says it, and compiled like everything else here.

use pointmass::{Advance, Integrator, World};

use crate::machine::Number;
use crate::scene::{STEP, Scene, Shape, add_forces};

/// The book pads vectors to four numbers; without the padding it moves less memory, in favour of the book.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Particle<R> {
    pub(crate) position: [R; 3],
    pub(crate) velocity: [R; 3],
    pub(crate) acceleration: [R; 3],
    pub(crate) force: [R; 3],
    pub(crate) damping: R,
    pub(crate) inverse_mass: R,
}

impl<R: Number> Particle<R> {
    /// One step of one particle: equations 3.4 to 3.6, in the order of the book.
    #[inline]
    fn integrate(&mut self, dt: R, pow: impl Fn(R, R) -> R) {
        if self.inverse_mass <= R::ZERO {
            return;
        }
        add_scaled(&mut self.position, self.velocity, dt);
        let mut acceleration = self.acceleration;
        add_scaled(&mut acceleration, self.force, self.inverse_mass);
        add_scaled(&mut self.velocity, acceleration, dt);
        let kept = pow(self.damping, dt);
        self.velocity = self.velocity.map(|v| v * kept);
        self.force = [R::ZERO; 3];
    }
}

#[inline]
fn add_scaled<R: Number>(to: &mut [R; 3], vector: [R; 3], scale: R) {
    for (to, component) in to.iter_mut().zip(vector) {
        *to = *to + component * scale;
    }
}

/// The same particles, in ascending order of id.
pub(crate) fn of<R: Number>(world: &World<R>) -> Vec<Particle<R>> {
    let particles = world.particles().map(|particle| Particle {
        position: particle.position.into(),
        velocity: particle.velocity.into(),
        acceleration: particle.acceleration.into(),
        force: particle.force.into(),
        damping: particle.damping,
        inverse_mass: particle.inverse_mass,
    });
    particles.collect()
}

/// One step of all, with the pow of the platform.
#[inline(never)]
pub(crate) fn step<R: Number>(particles: &mut [Particle<R>], dt: R) {
    for particle in particles {
        particle.integrate(dt, R::powf);
    }
}

/// The engine gives the same bits. Its pow is correctly rounded, which a platform's need not be, so here the book's is too.
pub(crate) fn check() {
    check_precision::<f32>();
    check_precision::<f64>();
}

fn check_precision<R: Number>() {
    for shape in [Shape::Uniform, Shape::Each, Shape::EachForced] {
        for damped in [false, true] {
            for n in [1, 7, 1000] {
                check_scene::<R>(Scene { shape, damped, n });
            }
        }
    }
}

fn check_scene<R: Number>(scene: Scene) {
    let mut world = scene.world::<R>(Integrator::NewtonEuler);
    let mut book = of(&world);
    let forces = scene.forces::<R>();
    let pow = |damping: R, dt: R| R::nearest(pxfm::f_pow(damping.into(), dt.into()));
    for steps in [1_u32, 1, 2, 60] {
        if scene.shape == Shape::EachForced {
            world.apply(&add_forces(forces.clone())).expect("forces are valid");
        }
        let duration = STEP * f64::from(steps);
        let plan = Advance { steps: Some(u64::from(steps)), ..Advance::by(duration) };
        let h = R::nearest(world.advance(plan).expect("the advance is valid").step);
        for _ in 0..steps {
            for (particle, force) in book.iter_mut().zip(&forces) {
                if scene.shape == Shape::EachForced {
                    particle.force = (*force).into();
                }
                particle.integrate(h, pow);
            }
        }
    }
    let bits = |v: [R; 3]| v.map(|x| Into::<f64>::into(x).to_bits());
    for (state, particle) in world.particles().zip(&book) {
        let (ours, theirs) = ((state.position.into(), state.velocity.into()), (particle.position, particle.velocity));
        assert_eq!(
            (bits(ours.0), bits(ours.1)),
            (bits(theirs.0), bits(theirs.1)),
            "{} {}: particle {} is {ours:?}, in the book {theirs:?}",
            R::PRECISION,
            scene.name(),
            state.id.0,
        );
    }
}
