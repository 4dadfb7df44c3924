//! Where a particle reaches a plane.

use super::*;
use crate::physics::Random;

const GRAVITY: f64 = -10.0;

fn falling<R: Real>(integrator: Integrator) -> Settings<R> {
    Settings { gravity: vector::<R>([0.0, GRAVITY, 0.0]), ..with(integrator) }
}

fn ball<R: Real>(height: f64, velocity: [f64; 3]) -> Particle<R> {
    Particle { position: vector::<R>([0.0, height, 0.0]), velocity: vector::<R>(velocity), ..Particle::default() }
}

fn to_height(height: f64) -> Until {
    Until { particle: ParticleId(0), plane: Plane { normal: [0.0, 1.0, 0.0], offset: height } }
}

/// Until a height is reached, in steps of about this length where the integrator has any.
fn until(height: f64, duration: f64, step: f64, integrator: Integrator) -> Advance {
    let max_step = (integrator != Integrator::Exact).then_some(step);
    Advance { until: Some(to_height(height)), max_step, ..Advance::by(duration) }
}

/// Every integrator for which a fall without drag is a parabola.
const PARABOLIC: [Integrator; 4] = [Integrator::Exact, Integrator::VelocityVerlet, Integrator::Rk4, Integrator::Dop853];

#[test]
fn until_closed_form() {
    // Thrown from a height h at u to a height below: t = (u + √(u² + 2 g h)) / g.
    let (mut exact, mut stepped, mut book): (f64, f64, f64) = (0.0, 0.0, f64::INFINITY);
    for seed in 1..=100 {
        let mut random = Random(seed);
        let (height, speed) = (1.0 + 50.0 * random.unit(), 40.0 * random.unit() - 20.0);
        let time = (speed + (speed * speed + 20.0 * height).sqrt()) / 10.0;
        for integrator in PARABOLIC.into_iter().chain([Integrator::NewtonEuler]) {
            let mut world = world(falling::<f64>(integrator), &[ball(height, [3.0, speed, 1.0])]);
            let report = world.advance(until(0.0, 60.0, 1.0 / 60.0, integrator)).expect("it falls");
            assert_eq!((report.crossed, report.time), (Some(true), report.duration), "{integrator}, seed {seed}");
            assert_eq!(world.time(), report.time, "{integrator}, seed {seed}");
            // What a last place of the height is in time, and of the time itself.
            let rate = (speed * speed + 20.0 * height).sqrt();
            let place = ulp::<f64>(height.max(speed.abs() * time)) / rate + ulp::<f64>(time);
            let off = (report.duration - time).abs() / place;
            if integrator == Integrator::Exact {
                exact = exact.max(off);
            } else if integrator.is_euler() {
                book = book.min(off);
            } else {
                stepped = stepped.max(off);
            }
            assert!(position(&world, 0)[1].abs() < 1e-12, "{integrator}");
        }
    }
    check_claim("until_closed_form", "exact", book, exact);
    check_claim("until_closed_form", "in steps", book, stepped);
    check_every_row("until_closed_form");
}

/// Through the plane and back within one step: the first of both crossings.
#[test]
fn until_twice_within_a_step() {
    fn each<R: Real>() {
        for (seed, integrator) in (1..=20).flat_map(|seed| PARABOLIC.map(|integrator| (seed, integrator))) {
            let mut random = Random(seed);
            let (below, speed) = (1.0 + random.unit(), 15.0 + 10.0 * random.unit());
            let (below, speed): (f64, f64) = (number::<R>(below).into(), number::<R>(speed).into());
            let first = (speed - (speed * speed - 20.0 * below).sqrt()) / 10.0;
            let name = format!("{integrator} {}, seed {seed}", R::PRECISION);
            // One step of 6 s, after which it is below the plane again.
            let mut through = world(falling::<R>(integrator), &[ball(-below, [0.0, speed, 0.0])]);
            let by = if matches!(integrator, Integrator::Exact | Integrator::Dop853) { None } else { Some(1) };
            let advance = Advance { until: Some(to_height(0.0)), steps: by, ..Advance::by(6.0) };
            let report = through.advance(advance).expect("it goes up and down");
            assert_eq!(report.crossed, Some(true), "{name}");
            let off = (report.duration - first).abs();
            assert!(off < 30.0 * ulp::<R>(1.0), "{name}: {} s, not {first} s", report.duration);
            // Without the plane it is found on the same side as before.
            let mut without = world(falling::<R>(integrator), &[ball(-below, [0.0, speed, 0.0])]);
            without.advance(6.0).expect("finite");
            assert!(position(&without, 0)[1] < -below, "{name}: ends below");
        }
    }
    each::<f32>();
    each::<f64>();
}

/// Already in the plane: it has to leave it and come back.
#[test]
fn until_from_the_plane() {
    fn each<R: Real>() {
        for integrator in PARABOLIC {
            let name = format!("{integrator} {}", R::PRECISION);
            // In many steps, and up and down in one.
            for (duration, step) in [(60.0, 0.3), (6.0, 6.0)] {
                let mut thrown = world(falling::<R>(integrator), &[ball(2.5, [1.0, 20.0, 0.0])]);
                let report = thrown.advance(until(2.5, duration, step, integrator)).expect("up and down");
                let off = (report.duration - 4.0).abs();
                assert!(report.crossed == Some(true) && off < 30.0 * ulp::<R>(4.0), "{name}: {report:?}");
            }
            let mut dropped = world(falling::<R>(integrator), &[ball(2.5, [1.0, 0.0, 0.0])]);
            let report = dropped.advance(until(2.5, 3.0, 0.3, integrator)).expect("down");
            assert_eq!((report.crossed, report.duration), (Some(false), 3.0), "{name}: it never comes back");
            let mut gliding = world(with::<R>(integrator), &[ball(2.5, [1.0, 0.0, 0.0])]);
            let report = gliding.advance(until(2.5, 3.0, 0.3, integrator)).expect("level");
            assert_eq!(report.duration, 3.0, "{name}: it never leaves the plane");
        }
    }
    each::<f32>();
    each::<f64>();
}

/// A plane that is not reached does not change a bit of the advance.
#[test]
fn until_never() {
    fn each<R: Real>() {
        for integrator in Integrator::ALL {
            let name = format!("{integrator} {}", R::PRECISION);
            let start =
                || world(falling::<R>(integrator), &[Particle { damping: R::HALF, ..ball(0.0, [3.0, 20.0, 1.0]) }]);
            let (mut told, mut free) = (start(), start());
            let report = told.advance(until(20.1, 3.0, 0.1, integrator)).expect("finite");
            let max_step = (integrator != Integrator::Exact).then_some(0.1);
            free.advance(Advance { max_step, ..Advance::by(3.0) }).expect("finite");
            assert_eq!((report.crossed, report.duration), (Some(false), 3.0), "{name}");
            assert_eq!(told.digest(), free.digest(), "{name}");
            // A little lower it is reached.
            let top = start().trajectory(ParticleId(0), 3.0, 301).expect("finite");
            let top = top.position.iter().map(|p| wide::<R>(*p)[1]).fold(0.0, f64::max);
            let report = start().advance(until(0.9 * top, 3.0, 0.1, integrator)).expect("finite");
            assert_eq!(report.crossed, Some(true), "{name}");
        }
    }
    each::<f32>();
    each::<f64>();
}

/// Planes in all directions, with drag and gravitation: where the advance ends is in the plane, to rounding.
#[test]
fn until_in_the_plane() {
    fn each<R: Real>() {
        let (mut worst, mut without): (f64, f64) = (0.0, f64::INFINITY);
        for (seed, integrator) in (1..=20).flat_map(|seed| Integrator::ALL.map(|integrator| (seed, integrator))) {
            let mut random = Random(seed);
            let drag = Some(Drag { k1: number(0.1), k2: number(0.02) });
            let gravitation = Some(Gravitation { constant: R::ONE, softening: number(0.5) });
            let forces = if integrator.serves_forces() { Forces { drag, gravitation } } else { Forces::default() };
            let settings = Settings { forces, ..falling::<R>(integrator) };
            let start: [f64; 3] = wide::<R>(random.vector::<R>(10.0));
            let toward: [f64; 3] = wide::<R>(random.vector::<R>(20.0));
            let other = Particle { position: vector::<R>([30.0, -20.0, 5.0]), ..Particle::default() };
            let particle =
                Particle { position: vector::<R>(start), velocity: vector::<R>(toward), ..Particle::default() };
            let mut world = world(settings, &[particle, other]);
            // Through a point that the first tenth of a second leads past.
            let plane = Plane { normal: toward, offset: dot(toward, start) + 0.1 * dot(toward, toward) };
            let until = Some(Until { particle: ParticleId(0), plane });
            let max_step = (integrator != Integrator::Exact).then_some(1.0 / 30.0);
            let mut free = world.clone();
            let report = world.advance(Advance { until, max_step, ..Advance::by(1.0) }).expect("finite");
            assert_eq!(report.crossed, Some(true), "{integrator} {}, seed {seed}", R::PRECISION);
            let distance = |world: &World<R>| (dot(toward, position(world, 0)) - plane.offset).abs() / norm(toward);
            worst = worst.max(distance(&world) / ulp::<R>(norm(position(&world, 0))));
            let whole = (report.duration * 30.0).ceil() / 30.0;
            free.advance(Advance { max_step, ..Advance::by(whole) }).expect("finite");
            without = without.min(distance(&free) / ulp::<R>(norm(position(&free, 0))));
        }
        check_claim("until_in_the_plane", R::PRECISION.name(), without, worst);
    }
    each::<f32>();
    each::<f64>();
    check_every_row("until_in_the_plane");
}

/// The last step, up to the plane, is one like any other: the world ends where one does that takes it on its own.
#[test]
fn until_is_a_step() {
    let (mut worst, mut straight): (f64, f64) = (0.0, f64::INFINITY);
    let stepped = Integrator::ALL.into_iter().filter(|i| i.serves_forces() && *i != Integrator::Dop853);
    for (integrator, seed) in stepped.flat_map(|integrator| (1..=10).map(move |seed| (integrator, seed))) {
        let mut random = Random(seed);
        let drag = Some(Drag { k1: 0.1, k2: 0.02 });
        let forces = Forces { drag, gravitation: Some(Gravitation { constant: 300.0, softening: 0.5 }) };
        let (start, toward): ([f64; 3], [f64; 3]) = (random.vector::<f64>(5.0), random.vector::<f64>(20.0));
        let particle =
            Particle { position: start.into(), velocity: toward.into(), damping: 0.5, ..Particle::default() };
        let other = Particle { position: [4.0, -3.0, 2.0].into(), ..Particle::default() };
        let mut told = world(Settings { forces, ..falling(integrator) }, &[particle, other]);
        let mut alone = told.clone();
        let h = 1.0 / 16.0;
        let plane = Plane { normal: toward, offset: dot(toward, start) + 0.15 * dot(toward, toward) };
        let until = Some(Until { particle: ParticleId(0), plane });
        let report = told.advance(Advance { until, max_step: Some(h), ..Advance::by(2.0) }).expect("finite");
        if report.crossed == Some(false) || report.steps < 2 {
            continue;
        }
        let whole = report.steps - 1;
        alone.advance(in_steps(h * whole as f64, whole)).expect("finite");
        let before = position(&alone, 0);
        let rest = report.duration - h * whole as f64;
        let mut further = alone.clone();
        alone.advance(in_steps(rest, 1)).expect("finite");
        further.advance(in_steps(h, 1)).expect("finite");
        worst = worst.max(norm(minus(position(&told, 0), position(&alone, 0))));
        worst = worst.max(norm(minus(velocity(&told, 0), velocity(&alone, 0))));
        // A straight line between the ends of the step, cut by the plane.
        let after = position(&further, 0);
        let [from, to] = [before, after].map(|x| dot(toward, x) - plane.offset);
        let line: [f64; 3] = std::array::from_fn(|k| before[k] + (after[k] - before[k]) * from / (from - to));
        // A step of Euler's kind is one.
        if !integrator.is_euler() {
            straight = straight.min(norm(minus(line, position(&told, 0))));
        }
    }
    check_claim("until_is_a_step", "double", straight, worst);
    check_every_row("until_is_a_step");
}
