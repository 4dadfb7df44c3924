//! What must not change a bit: threads, what a scene does not use, looking ahead.

use super::*;
use crate::physics::Random;

/// The bits of all positions and velocities.
fn bits<R: Real>(world: &World<R>) -> Vec<[u64; 6]> {
    let row = |state: ParticleState<R>| {
        let (p, v) = (wide::<R>(state.position), wide::<R>(state.velocity));
        [p[0], p[1], p[2], v[0], v[1], v[2]].map(f64::to_bits)
    };
    world.particles().map(row).collect()
}

/// A world of particles of chance, with velocities up to a number and a damping.
fn crowd<R: Real>(settings: Settings<R>, count: usize, seed: u64, [speed, damping]: [f64; 2]) -> World<R> {
    let mut random = Random(seed);
    let particles = (0..count).map(|_| Particle::<R> {
        position: random.vector(10.0).into(),
        velocity: random.vector(speed).into(),
        damping: number(damping),
        mass: Mass::Mass(number(0.5 + random.unit())),
        ..Particle::default()
    });
    let mut world = World::new(settings).expect("valid settings");
    world.apply(&Command::Create(particles.collect())).expect("valid particles");
    world
}

fn all_forces<R: Real>() -> Forces<R> {
    let drag = Some(Drag { k1: number(0.2), k2: number(0.1) });
    Forces { drag, gravitation: Some(Gravitation { constant: number(1e-3), softening: number(0.1) }) }
}

/// One, two and three threads, also in a world where all pull each other. They begin at rest, so that every bit of a
/// pull is one of a velocity.
#[test]
fn determinism() {
    fn each<R: Real>(integrator: Integrator) {
        let tolerance = Tolerance { absolute: 1e-3, relative: 1e-3 };
        let forces = if integrator.serves_forces() { all_forces() } else { Forces::default() };
        let settings = Settings { forces, tolerance, ..with::<R>(integrator) };
        let start = crowd(settings, 3000, 11, [0.0, 0.9]);
        let after = |threads: usize| {
            let mut world = start.clone();
            world.set_threads(&Threads::new(threads).expect("threads"));
            let by = if integrator == Integrator::Dop853 { Advance::by(0.02) } else { in_steps(0.02, 2) };
            world.advance(by).expect("finite");
            bits(&world)
        };
        let one = after(1);
        for threads in [2, 3] {
            assert!(one == after(threads), "{threads} threads, {integrator} {}", R::PRECISION);
        }
    }
    for integrator in Integrator::ALL {
        each::<f32>(integrator);
        each::<f64>(integrator);
    }
    // Bits can tell: the same sums in another order end elsewhere.
    let settings = Settings { forces: all_forces(), ..with::<f64>(Integrator::VelocityVerlet) };
    let forward = crowd(settings, 1000, 11, [0.0, 0.9]);
    let mut reversed = World::new(settings).expect("valid settings");
    let states: Vec<ParticleState> = forward.particles().collect();
    let copy = |state: &ParticleState| Particle {
        position: state.position,
        velocity: state.velocity,
        damping: state.damping,
        mass: Mass::Inverse(state.inverse_mass),
        ..Particle::default()
    };
    reversed.apply(&Command::Create(states.iter().rev().map(copy).collect())).expect("valid particles");
    let ends = [forward, reversed].map(|mut world| {
        world.advance(in_steps(0.02, 2)).expect("finite");
        bits(&world)
    });
    assert!(ends[0].iter().ne(ends[1].iter().rev()), "an order of summation that does not show");
}

/// Drag of nothing, gravitation of nothing and a damping of 1 for each take the long way, and end with the same bits.
#[test]
fn skip_what_is_unused() {
    fn each<R: Real>(integrator: Integrator, damping: f64, seed: u64) {
        let name = format!("{integrator} {}, d = {damping}", R::PRECISION);
        let none = Drag { k1: R::ZERO, k2: R::ZERO };
        let massless = Gravitation { constant: R::ZERO, softening: R::ZERO };
        let drag = Forces { drag: Some(none), ..Forces::default() };
        let gravitation = Forces { gravitation: Some(massless), ..Forces::default() };
        let both = Forces { drag: Some(none), gravitation: Some(massless) };
        let after = |forces| {
            let settings = Settings { forces, gravity: vector::<R>([0.5, -9.75, 0.1]), ..with(integrator) };
            let mut world = crowd(settings, 70, seed, [3.0, damping]);
            let by = if integrator == Integrator::Dop853 { Advance::by(1.5) } else { in_steps(1.5, 90) };
            world.advance(by).expect("finite");
            bits(&world)
        };
        let plain = after(Forces::default());
        for forces in [drag, gravitation, both] {
            assert!(after(forces) == plain, "{name}: {forces:?}");
        }
        let some = Forces { drag: Some(Drag { k1: number(1e-3), k2: R::ZERO }), ..Forces::default() };
        assert!(after(some) != plain, "{name}: a little drag shows");
    }
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_forces()) {
        for (seed, damping) in [(1, 1.0), (2, 0.75)] {
            each::<f32>(integrator, damping, seed);
            each::<f64>(integrator, damping, seed);
        }
    }
}

/// One step of `velocity_verlet` is the closed form to the bit where nothing depends on position: any duration, damping
/// and acceleration, and in double any force.
#[test]
fn verlet_is_exact() {
    fn each<R: Real>() {
        let (mut differ, mut book) = (0, 0);
        for seed in 1..=200 {
            let mut random = Random(seed);
            let damping = random.unit();
            let particle: Particle<R> = Particle {
                position: random.vector(100.0).into(),
                velocity: random.vector(30.0).into(),
                acceleration: Some(random.vector(20.0).into()),
                damping: number(random.one_of(&[1.0, 0.999, 0.9, 0.5, 1e-3, 1e-30, 0.0, damping])),
                mass: Mass::Inverse(number(random.unit())),
                ..Particle::default()
            };
            let time = random.one_of(&[1.0 / 60.0, 0.1, 1.0, 7.3, 1e3, 1e-6]);
            let force = vector::<R>(random.vector(40.0));
            let after = |integrator, pushed: bool| {
                let mut world = world(with::<R>(integrator), &[particle]);
                if pushed {
                    world.add_force(ParticleId(0), force).expect("finite");
                }
                world.advance(time).expect("small numbers");
                (bits(&world), position(&world, 0))
            };
            let (exact, exact_pushed) = (after(Integrator::Exact, false), after(Integrator::Exact, true));
            differ += usize::from(after(Integrator::VelocityVerlet, false) != exact);
            book += usize::from(after(Integrator::SemiImplicitEuler, false) != exact);
            let pushed = after(Integrator::VelocityVerlet, true);
            differ += usize::from(pushed != exact_pushed);
        }
        check_claim("verlet_is_exact", R::PRECISION.name(), book as f64, differ as f64);
    }
    each::<f32>();
    each::<f64>();
    check_every_row("verlet_is_exact");
}

/// Under gravity, in steps of at most 0.07 s, with drag and gravitation or without.
fn settings<R: Real>(integrator: Integrator, compensated: bool, some: bool) -> Settings<R> {
    let forces = if some { all_forces() } else { Forces::default() };
    let gravity = vector::<R>([0.5, -9.75, 0.1]);
    Settings { forces, compensated, gravity, max_step: Some(0.07), ..with(integrator) }
}

/// A trajectory is what a copy of the world shows that is advanced in its place, and it changes nothing.
#[test]
fn trajectory() {
    fn each<R: Real>(settings: Settings<R>, pushed: bool, seed: u64) {
        const SAMPLES: usize = 9;
        let name = format!("{} {}, pushed: {pushed}", settings.integrator, R::PRECISION);
        let mut world = crowd(settings, 5, seed, [3.0, 0.75]);
        world.advance(0.3).expect("small numbers");
        let id = ParticleId(Random(seed).below(5) as u64);
        let push = vector::<R>(Random(seed).vector(5.0));
        if pushed {
            world.add_force(id, push).expect("finite");
        }
        let before = world.digest();
        let way = world.trajectory(id, 2.0, SAMPLES).expect("small numbers");
        assert_eq!(world.digest(), before, "{name}");
        assert_eq!((way.time.len(), way.position.len(), way.velocity.len()), (SAMPLES, SAMPLES, SAMPLES), "{name}");
        let mut stepped = world.clone();
        for sample in 0..SAMPLES {
            let moment = 0.25 * sample as f64;
            if settings.integrator == Integrator::Exact {
                stepped = world.clone();
            } else if pushed && sample > 1 {
                stepped.add_force(id, push).expect("finite");
            }
            let by = if settings.integrator == Integrator::Exact { moment } else { 0.25 };
            if sample > 0 {
                stepped.advance(by).expect("small numbers");
            }
            let state = stepped.particle(id).expect("it is there");
            assert_eq!(way.time[sample].to_bits(), stepped.time().to_bits(), "{name}, sample {sample}");
            let seen = [way.position[sample], way.velocity[sample]].map(wide::<R>);
            let expected = [wide::<R>(state.position), wide::<R>(state.velocity)];
            assert_eq!(seen.as_flattened(), expected.as_flattened(), "{name}, sample {sample}");
        }
        assert_ne!(way.position[1], way.position[2], "{name}: it moves");
    }
    for integrator in Integrator::ALL {
        for seed in 1..=3 {
            for (pushed, compensated) in [(false, false), (true, false), (true, true)] {
                let some = integrator.serves_forces() && seed > 1;
                each::<f32>(settings(integrator, compensated, some), pushed, seed);
                each::<f64>(settings(integrator, compensated, some), pushed, seed);
            }
        }
    }
}

/// The error that an advance reports against one computed here, from φ and ψ in plain doubles.
#[test]
fn report_error() {
    fn each(integrator: Integrator, steps: u64, seed: u64) -> (f64, f64, f64) {
        let time = 1.5;
        let gravity = [0.5, -9.75, 0.1];
        let mut world = crowd(Settings { gravity: gravity.into(), ..with::<f64>(integrator) }, 20, seed, [3.0, 0.6]);
        let before: Vec<ParticleState> = world.particles().collect();
        let by = if integrator == Integrator::Dop853 { Advance::by(time) } else { in_steps(time, steps) };
        let told =
            world.advance(Advance { report_error: true, ..by }).expect("small numbers").error.expect("asked for");
        let rate = -f64::ln(0.6);
        let phi = -(-rate * time).exp_m1() / rate;
        let psi = (time - phi) / rate;
        let (mut place, mut speed): (f64, f64) = (0.0, 0.0);
        for (before, after) in before.iter().zip(world.particles()) {
            let (p, v): ([f64; 3], [f64; 3]) = (before.position.into(), before.velocity.into());
            let closed_p = std::array::from_fn(|k| p[k] + v[k] * phi + gravity[k] * psi);
            let closed_v = std::array::from_fn(|k| v[k] * (-rate * time).exp() + gravity[k] * phi);
            place = place.max(norm(minus(after.position.into(), closed_p)));
            speed = speed.max(norm(minus(after.velocity.into(), closed_v)));
        }
        ((told.position - place).abs().max((told.velocity - speed).abs()), told.position, place)
    }
    let mut worst: f64 = 0.0;
    let mut book = f64::INFINITY;
    for integrator in Integrator::ALL {
        for seed in 1..=5 {
            let (off, told, place) = each(integrator, 90, seed);
            worst = worst.max(off);
            if integrator.is_euler() {
                // An error of some millimetres is not reported as another.
                book = book.min(told.min(place));
            }
            if integrator == Integrator::Exact {
                assert_eq!(told, 0.0, "the closed form has no error");
            }
        }
    }
    check_claim("report_error", "double", book, worst);
    check_every_row("report_error");
}
