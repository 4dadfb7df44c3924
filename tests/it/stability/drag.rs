//! Drag, and damping as strong as drag can be.

use super::*;
use crate::physics::Random;

fn slowed<R: Real>(integrator: Integrator, k1: f64, k2: f64) -> Settings<R> {
    let drag = Some(Drag { k1: number(k1), k2: number(k2) });
    Settings { forces: Forces { drag, ..Forces::default() }, ..with(integrator) }
}

fn moving<R: Real>(velocity: [f64; 3]) -> Particle<R> {
    Particle { velocity: vector::<R>(velocity), ..Particle::default() }
}

/// |v| after 200 steps of 1/16 s in units of that before, with λ h = z; infinite where the advance is refused. And
/// whether each component kept its sign and never grew.
fn decayed<R: Real>(settings: Settings<R>, damping: f64) -> (f64, bool) {
    let start = [3.0, -4.0, 0.5];
    let particle = Particle { damping: number(damping), ..moving::<R>(start) };
    let mut world = world(settings, &[particle]);
    let (mut monotone, mut before) = (true, start);
    for _ in 0..200 {
        if world.advance(1.0 / 16.0).is_err() {
            return (f64::INFINITY, false);
        }
        let now = velocity(&world, 0);
        monotone &= (0..3).all(|k| now[k] * start[k] >= 0.0 && now[k].abs() <= before[k].abs());
        before = now;
    }
    (norm(before) / norm(start), monotone)
}

#[test]
fn stiff_linear_drag() {
    fn each<R: Real>() {
        let mut worst: f64 = 0.0;
        for z in [1e-6, 1e-3, 0.1, 0.9, 1.0, 1.1, 2.0, 2.1, 2.785, 3.0, 10.0, 1e3, 1e6] {
            let name = format!("z = {z}, {}", R::PRECISION);
            let drag = slowed::<R>(Integrator::VelocityVerlet, z * 16.0, 0.0);
            let (left, monotone) = decayed(drag, 1.0);
            assert!(monotone, "{name}: drag under velocity_verlet");
            // 200 products, each rounded once, with an E that is off by half a last place of a double.
            let rate: f64 = number::<R>(z * 16.0).into();
            let closed = (-rate * 12.5).exp();
            if closed > 1e-20 {
                worst = worst.max((left / closed - 1.0).abs());
            } else {
                assert!(left <= 1e-20, "{name}: {left:e}");
            }
            // The same as damping, as far as a damping can say it.
            if rate < 700.0 && (-rate).exp() > 0.0 {
                for integrator in [Integrator::Exact, Integrator::VelocityVerlet, Integrator::NewtonEuler] {
                    let (_, monotone) = decayed(with::<R>(integrator), (-rate).exp());
                    assert!(monotone, "{name}: damping under {integrator}");
                }
            }
        }
        let growth = |integrator, z: f64| decayed(slowed::<R>(integrator, z * 16.0, 0.0), 1.0).0;
        let case = "stiff_linear_drag";
        let precision = R::PRECISION;
        let ours = |z| growth(Integrator::VelocityVerlet, z);
        check_claim(
            case,
            &format!("{precision}, newton_euler, λh = 2.1"),
            growth(Integrator::NewtonEuler, 2.1),
            ours(2.1),
        );
        check_claim(case, &format!("{precision}, rk4, λh = 3"), growth(Integrator::Rk4, 3.0), ours(3.0));
        let coarse = decayed(slowed::<R>(Integrator::Rk4, 16.0, 0.0), 1.0).0 / (-200f64).exp() - 1.0;
        check_claim(case, &format!("{precision}, against e⁻ᶻ"), coarse.abs(), worst);
    }
    each::<f32>();
    each::<f64>();
    check_every_row("stiff_linear_drag");
}

/// The relative error of |v| = v₀ / (1 + k₂ v₀ t) after some steps in a direction of chance.
fn quadratic<R: Real>(integrator: Integrator, z: f64, steps: u64, seed: u64) -> f64 {
    let mut random = Random(seed);
    let start: [f64; 3] = wide::<R>(random.vector::<R>(50.0));
    let h = 1.0 / 16.0;
    let k2: f64 = number::<R>(z / (norm(start) * h)).into();
    let mut world = world(slowed::<R>(integrator, 0.0, k2), &[moving(start)]);
    if world.advance(in_steps(h * steps as f64, steps)).is_err() {
        return f64::INFINITY;
    }
    let end = velocity(&world, 0);
    if (0..3).any(|k| end[k] * start[k] < 0.0) {
        return f64::INFINITY;
    }
    let expected = start.map(|v| v / (1.0 + k2 * norm(start) * (h * steps as f64)));
    norm(minus(end, expected)) / norm(expected)
}

#[test]
fn stiff_quadratic_drag() {
    fn each<R: Real>() {
        let mut worst: f64 = 0.0;
        let mut book = f64::INFINITY;
        for seed in 1..=20 {
            for z in [0.01, 0.1, 1.0, 2.0, 3.33, 10.0, 1e3, 1e6] {
                for steps in [1, 10, 100] {
                    worst = worst.max(quadratic::<R>(Integrator::VelocityVerlet, z, steps, seed));
                }
            }
            for integrator in [Integrator::NewtonEuler, Integrator::SemiImplicitEuler, Integrator::Rk4] {
                book = book.min(quadratic::<R>(integrator, 3.33, 10, seed));
            }
        }
        check_claim("stiff_quadratic_drag", R::PRECISION.name(), book, worst);
    }
    each::<f32>();
    each::<f64>();
    check_every_row("stiff_quadratic_drag");
}

/// The speed at which drag with k₁ = 0.2 and k₂ = 0.1 holds a kilogram against 9.81 m/s²: (√(k₁² + 4 k₂ g) − k₁) / 2
/// k₂.
const TERMINAL: f64 = 8.954_898_291_795_853;

/// By which share the speed after 20 s differs; infinite where the advance is refused.
fn terminal(integrator: Integrator, h: f64) -> f64 {
    let mut world = world(slowed::<f64>(integrator, 0.2, 0.1), &[Particle { damping: 1.0, ..thrown() }]);
    let advance = if integrator == Integrator::Dop853 { Advance::by(20.0) } else { in_steps(20.0, steps_of(20.0, h)) };
    world.advance(advance).map_or(f64::INFINITY, |_| (-velocity(&world, 0)[1] / TERMINAL - 1.0).abs())
}

#[test]
fn drag_terminal() {
    let verlet = |h| terminal(Integrator::VelocityVerlet, h);
    check_claim("drag_terminal", "velocity_verlet, 1/60 s, against 1/30 s", verlet(1.0 / 30.0), verlet(1.0 / 60.0));
    check_claim("drag_terminal", "newton_euler, 1 s", terminal(Integrator::NewtonEuler, 1.0), verlet(1.0));
    check_claim("drag_terminal", "rk4, 1 s", terminal(Integrator::Rk4, 1.0), verlet(1.0));
    check_claim("drag_terminal", "dop853", verlet(1.0 / 60.0), terminal(Integrator::Dop853, 0.0));
    check_claim("drag_terminal", "rk4, 1/60 s", verlet(1.0 / 60.0), terminal(Integrator::Rk4, 1.0 / 60.0));
    let order = (verlet(1.0 / 60.0) / verlet(1.0 / 120.0)).log2();
    assert!((order - 2.0).abs() < 0.1, "order {order}");
    check_every_row("drag_terminal");
}

/// Drag with k₁ alone is damping with d = e^(−k₁/m): the same closed form.
#[test]
fn drag_is_damping() {
    fn each<R: Real>() {
        let (mut worst, mut book): (f64, f64) = (0.0, f64::INFINITY);
        for seed in 1..=20 {
            let mut random = Random(seed);
            // A damping whose rate is that of k₁ w to the last place of a double, or of a single.
            let mass: f64 = number::<R>(1.0 + 10.0 * random.unit()).into();
            let k1: f64 = number::<R>(0.5 + random.unit()).into();
            let inverse: f64 = number::<R>(1.0 / mass).into();
            let rate: f64 = (number::<R>(k1) * number::<R>(inverse)).into();
            let start = Particle::<R> {
                position: random.vector(10.0).into(),
                velocity: random.vector(30.0).into(),
                acceleration: Some(random.vector(9.0).into()),
                mass: Mass::Inverse(number(inverse)),
                ..Particle::default()
            };
            let truth = |time: f64| -> [f64; 3] {
                let (phi, z) = (-(-rate * time).exp_m1() / rate, rate * time);
                // ψ by its series where t − φ cancels.
                let series = (3..30).rev().fold(1.0, |sum, n| 1.0 - z / f64::from(n) * sum) * time * time / 2.0;
                let psi = if z < 1.0 { series } else { (time - phi) / rate };
                let [p, v, a] = [start.position, start.velocity, start.acceleration.expect("set above")].map(wide::<R>);
                std::array::from_fn(|k| p[k] + (v[k] * phi + a[k] * psi))
            };
            let after = |integrator| {
                let mut world = world(slowed::<R>(integrator, k1, 0.0), &[start]);
                world.advance(in_steps(2.5, 40)).expect("small numbers");
                norm(minus(position(&world, 0), truth(2.5)))
            };
            worst = worst.max(after(Integrator::VelocityVerlet));
            book = book.min(after(Integrator::NewtonEuler));
        }
        check_claim("drag_is_damping", R::PRECISION.name(), book, worst);
    }
    each::<f32>();
    each::<f64>();
    check_every_row("drag_is_damping");
}

/// Drag of any size at any speed only ever slows down.
#[test]
fn huge_drag() {
    fn each<R: Real>() {
        let mut flipped = 0;
        let largest = R::LARGEST.sqrt();
        let sizes = [1e-30, 1e-3, 1.0, 1e6, largest, R::LARGEST / 4.0];
        for (n, (k2, speed)) in sizes.iter().flat_map(|k2| sizes.map(|speed| (*k2, speed))).enumerate() {
            for compensated in [false, true] {
                let start = [speed, -speed / 3.0, speed * 1e-3];
                let settings = Settings { compensated, ..slowed::<R>(Integrator::VelocityVerlet, 0.0, k2) };
                let mut world = world(settings, &[moving(start)]);
                let name = format!("{n}: k₂ = {k2:e}, {speed:e} m/s, {}, {compensated}", R::PRECISION);
                let before = world.digest();
                let advanced = world.advance(in_steps(0.25, 8));
                // A product of this size is infinite in doubles; then the advance is refused, although the way is
                // finite.
                if (k2 / 32.0 * norm(start)).is_infinite() {
                    assert!(matches!(advanced, Err(Error::Diverged { step: 1, .. })), "{name}: {advanced:?}");
                    assert_eq!(world.digest(), before, "{name}");
                    continue;
                }
                advanced.unwrap_or_else(|error| panic!("{name}: {error}"));
                let (p, v) = (position(&world, 0), velocity(&world, 0));
                for k in 0..3 {
                    assert!(v[k] * start[k] >= 0.0 && v[k].abs() <= start[k].abs() * (1.0 + 1e-6), "{name}: {v:?}");
                    assert!(p[k] * start[k] >= 0.0 && p[k].is_finite(), "{name}: {p:?}");
                }
            }
            let mut book = world(slowed::<R>(Integrator::NewtonEuler, 0.0, k2), &[moving([speed, 0.0, 0.0])]);
            flipped += usize::from(book.advance(in_steps(0.25, 8)).is_err() || velocity(&book, 0)[0] < 0.0);
        }
        check_claim("huge_drag", R::PRECISION.name(), flipped as f64, 0.0);
    }
    each::<f32>();
    each::<f64>();
    check_every_row("huge_drag");
}
