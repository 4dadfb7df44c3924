//! Each skip is told by the report of the advance, and a scene that is the same but for the skip ends with the same bits.

use pointmass::{
    Advance, Advanced, Column, Command, Digest, Integrator, Mass, NewParticles, Particle, ParticleId, ParticleState,
    Precision, Real, Selection, Settings, Values, World,
};

use crate::physics::{Random, in_steps, set};

const COUNT: usize = 1000;
const EVERY: Selection = Selection::All;

fn number<R: Real>(x: f64) -> R {
    R::nearest(x)
}

/// Particles that share everything but position and velocity.
fn uniform<R: Real>(damping: f64) -> NewParticles<R> {
    let mut random = Random(7);
    let mut vectors = |scale| Column::PerParticle((0..COUNT).map(|_| random.vector(scale).into()).collect());
    NewParticles {
        count: COUNT,
        position: vectors(100.0),
        velocity: vectors(10.0),
        damping: Column::Uniform(number(damping)),
        ..NewParticles::default()
    }
}

/// The same with one value for each.
fn each<R: Real>(new: NewParticles<R>) -> NewParticles<R> {
    fn spread<T: Copy + PartialEq>(column: &Column<T>) -> Column<T> {
        Column::PerParticle((0..COUNT).map(|i| column.get(i)).collect())
    }
    NewParticles {
        damping: spread(&new.damping),
        mass: spread(&new.mass),
        acceleration: spread(&new.acceleration),
        ..new
    }
}

fn world<R: Real>(integrator: Integrator, new: NewParticles<R>) -> World<R> {
    let gravity = [number(0.5), number(-9.75), R::ZERO].into();
    let mut world = World::new(Settings { integrator, gravity, ..Settings::default() }).expect("valid");
    world.apply(&Command::Create(new)).expect("valid");
    world
}

/// Advances, makes what was deferred happen, and says what was done and what came of it.
fn advance<R: Real>(world: &mut World<R>) -> (Advanced, Digest) {
    let report = world.advance(in_steps(world.settings().integrator, 70, 1.5)).expect("finite");
    let mut now = world.clone();
    let mass = Some(Column::Uniform(Mass::Inverse(R::ONE)));
    now.apply(&set(EVERY, None, None, mass)).expect("valid");
    (report, now.digest())
}

fn stepped() -> impl Iterator<Item = Integrator> {
    Integrator::ALL.into_iter().filter(|integrator| *integrator != Integrator::Exact)
}

fn set_damping<R: Real>(damping: Column<R>) -> Command<R> {
    set(EVERY, None, Some(damping), None)
}

fn check_uniform<R: Real>(integrator: Integrator) {
    let (shared, own) = (uniform::<R>(0.75), each(uniform::<R>(0.75)));
    let (one, one_digest) = advance(&mut world(integrator, shared));
    let mut owning = world(integrator, own);
    let (many, many_digest) = advance(&mut owning);
    assert_eq!(one_digest, many_digest, "{integrator} {}", R::PRECISION);
    if integrator != Integrator::Exact {
        assert_eq!((one.dampings, many.dampings), (Values::One, Values::Each));
        assert_eq!(one.accelerations, Values::One);
    }
    // A bulk set makes the column uniform again.
    owning.apply(&set_damping(Column::Uniform(number(0.75)))).expect("valid");
    let (again, _) = advance(&mut owning);
    let expected = if integrator == Integrator::Exact { Values::None } else { Values::One };
    assert_eq!(again.dampings, expected, "{integrator}");
}

#[test]
fn uniform_columns() {
    for integrator in Integrator::ALL {
        check_uniform::<f32>(integrator);
        check_uniform::<f64>(integrator);
    }
}

/// Without a skip: a damping of 1 for each particle, as numbers that are multiplied.
fn check_undamped<R: Real>(integrator: Integrator) {
    let (one, one_digest) = advance(&mut world(integrator, uniform::<R>(1.0)));
    let (many, many_digest) = advance(&mut world(integrator, each(uniform::<R>(1.0))));
    assert_eq!(one_digest, many_digest, "{integrator} {}", R::PRECISION);
    assert_eq!((one.dampings, many.dampings), (Values::None, Values::Each));
}

#[test]
fn no_damping() {
    for integrator in stepped() {
        check_undamped::<f32>(integrator);
        check_undamped::<f64>(integrator);
    }
}

/// A force and its opposite are a force of zero, which is looked at like any.
fn check_forceless<R: Real>(integrator: Integrator) {
    let (without, without_digest) = advance(&mut world(integrator, uniform::<R>(0.75)));
    let mut pushed = world(integrator, uniform::<R>(0.75));
    for force in [[R::ONE; 3], [number(-1.0); 3]] {
        for id in 0..COUNT as u64 {
            pushed.add_force(ParticleId(id), force.into()).expect("finite");
        }
    }
    let (with, with_digest) = advance(&mut pushed);
    assert_eq!(without_digest, with_digest, "{integrator} {}", R::PRECISION);
    if integrator == Integrator::Exact {
        assert_eq!((without.integrated, with.integrated), (0, 0));
    } else {
        assert_eq!((without.accelerations, with.accelerations), (Values::One, Values::Each));
    }
}

#[test]
fn no_force() {
    for integrator in Integrator::ALL {
        check_forceless::<f32>(integrator);
        check_forceless::<f64>(integrator);
    }
}

/// Immovable particles at rest keep every bit, also the sign of a zero, and their neighbours move as if they were alone.
fn check_resting<R: Real>(integrator: Integrator) {
    let minus_zero = number::<R>(-0.0);
    let resting = Particle {
        position: [minus_zero, R::ONE, minus_zero].into(),
        velocity: [minus_zero; 3].into(),
        mass: Mass::IMMOVABLE,
        damping: number(0.5),
        ..Particle::default()
    };
    let mut mixed = world(integrator, uniform::<R>(0.75));
    mixed.apply(&Command::Create(NewParticles { count: 10, ..resting.into() })).expect("valid");
    let mut alone = world(integrator, uniform::<R>(0.75));
    for _ in 0..3 {
        let report = mixed.advance(in_steps(integrator, 70, 1.5)).expect("finite");
        alone.advance(in_steps(integrator, 70, 1.5)).expect("finite");
        assert_eq!(report.skipped, 10, "{integrator}");
    }
    let bits = |state: &ParticleState<R>| {
        let (p, v): ([R; 3], [R; 3]) = (state.position.into(), state.velocity.into());
        [p, v]
            .concat()
            .into_iter()
            .map(|x| {
                let x: f64 = x.into();
                x.to_bits()
            })
            .collect::<Vec<u64>>()
    };
    for (state, single) in mixed.particles().zip(alone.particles()) {
        assert_eq!(bits(&state), bits(&single), "{integrator} {}", state.id);
    }
    let zero = 0f64.to_bits();
    let sign = (-0f64).to_bits();
    for state in mixed.particles_from(ParticleId(COUNT as u64)) {
        assert_eq!(bits(&state), [sign, 1f64.to_bits(), sign, sign, sign, sign], "{integrator} {}", state.id);
    }
    // One that is given a velocity is visited, and one that is stopped is not.
    let first = ParticleId(COUNT as u64);
    mixed.place(first, None, Some([R::ONE; 3].into())).expect("valid");
    assert_eq!(mixed.advance(1.0).expect("finite").skipped, 9);
    mixed.place(first, None, Some(R::Vec3::default())).expect("valid");
    mixed.set_inverse_mass(ParticleId(COUNT as u64 + 1), R::ONE).expect("valid");
    assert_eq!(mixed.advance(1.0).expect("finite").skipped, 9);
    mixed.remove(first).expect("it is there");
    assert_eq!(mixed.advance(1.0).expect("finite").skipped, 8);
    assert_ne!(bits(&mixed.particle(ParticleId(COUNT as u64 + 1)).expect("it is there"))[1], zero);
}

#[test]
fn immovable_particles_at_rest() {
    for integrator in Integrator::ALL {
        check_resting::<f32>(integrator);
        check_resting::<f64>(integrator);
    }
}

/// A particle so far out that bounds do not tell, beside others that do not notice.
fn check_bounds<R: Real>(integrator: Integrator) {
    let far = Particle {
        position: [number(0.6 * R::LARGEST); 3].into(),
        acceleration: Some(R::Vec3::default()),
        ..Particle::default()
    };
    let mut near = world(integrator, uniform::<R>(0.75));
    let mut looked = world(integrator, uniform::<R>(0.75));
    looked.create(far).expect("valid");
    assert_eq!(near.advance(1.5).expect("finite").inspected, 0, "{integrator}");
    assert_eq!(looked.advance(1.5).expect("finite").inspected, COUNT + 1, "{integrator}");
    for (near, looked) in near.particles().zip(looked.particles()) {
        assert_eq!(near, looked, "{integrator}");
    }
    if integrator == Integrator::Exact {
        // What was found holds for a while, until something is changed.
        assert_eq!(looked.work(&Advance::by(1.5)), 0);
        assert_eq!(looked.advance(1.5).expect("finite").inspected, 0);
        looked.place(ParticleId(0), None, Some([R::ONE; 3].into())).expect("valid");
        assert_eq!(looked.advance(1.5).expect("finite").inspected, COUNT + 1);
        // φ and ψ of the largest damping tell where t and t²/2 do not.
        let mut damped = world(Integrator::Exact, uniform::<R>(0.5));
        let long = if R::PRECISION == Precision::Single { 1e30 } else { 1e120 };
        assert_eq!(damped.advance(long).expect("finite").inspected, 0);
    }
}

#[test]
fn no_look_where_bounds_tell() {
    // The others look at all: what they do on the way has no bounds in closed form.
    let told = |integrator: &Integrator| integrator.is_euler() || *integrator == Integrator::Exact;
    for integrator in Integrator::ALL.into_iter().filter(told) {
        check_bounds::<f32>(integrator);
        check_bounds::<f64>(integrator);
    }
}

/// Under `exact` an advance costs what is forced, however many particles there are and whatever rests among them.
#[test]
fn deferred_particles_cost_nothing() {
    let mut world = world::<f64>(Integrator::Exact, uniform(0.75));
    world.create(Particle { mass: Mass::IMMOVABLE, ..Particle::default() }).expect("valid");
    let second = Advance::by(1.0);
    assert_eq!(world.work(&second), 0);
    for id in [5, 3, 5] {
        world.add_force(ParticleId(id), pointmass::DVec3::X).expect("finite");
    }
    assert!(world.work(&second) <= 3);
    world.remove(ParticleId(4)).expect("it is there");
    let report = world.advance(1.0).expect("finite");
    assert_eq!((report.integrated, report.deferred, report.skipped), (2, COUNT - 3, 1));
    assert_eq!(world.work(&second), 0);
}

/// Where no time has passed since the base time nothing is computed, also beside particles where some has: the sign of a
/// zero is kept.
#[test]
fn no_time_since_the_base_time() {
    let mut world = world::<f64>(Integrator::Exact, uniform(0.75));
    world.advance(1.0).expect("finite");
    let zeros = pointmass::DVec3::splat(-0.0);
    let late = Particle { position: zeros, velocity: zeros, damping: 0.75, ..Particle::default() };
    let id = world.create(late).expect("valid");
    world.for_each_block(|block| {
        for (_, (p, v)) in block.id.iter().zip(block.position.iter().zip(&block.velocity)).filter(|(of, _)| **of == id)
        {
            assert!(p.iter().chain(v).all(|x| *x == 0.0 && x.is_sign_negative()), "{p:?} {v:?}");
        }
    });
}
