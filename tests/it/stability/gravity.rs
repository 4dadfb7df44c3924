//! Gravitation of many bodies, of any size and at any distance: what one evaluation of it is worth.

use super::*;
use crate::physics::Random;

/// A number of about 106 bits: the sum of two doubles.
#[derive(Debug, Clone, Copy)]
struct Long {
    hi: f64,
    lo: f64,
}

impl Long {
    fn sum(a: f64, b: f64) -> Self {
        let hi = a + b;
        let part = hi - a;
        Self { hi, lo: (a - (hi - part)) + (b - part) }
    }

    fn product(a: f64, b: f64) -> Self {
        let split = |x: f64| {
            let high = x * 134_217_729.0 - (x * 134_217_729.0 - x);
            (high, x - high)
        };
        let (hi, (a_high, a_low), (b_high, b_low)) = (a * b, split(a), split(b));
        Self { hi, lo: ((a_high * b_high - hi) + a_high * b_low + a_low * b_high) + a_low * b_low }
    }

    fn plus(self, other: Self) -> Self {
        let sum = Self::sum(self.hi, other.hi);
        Self::sum(sum.hi, sum.lo + (self.lo + other.lo))
    }

    fn times(self, other: Self) -> Self {
        let product = Self::product(self.hi, other.hi);
        Self::sum(product.hi, product.lo + (self.hi * other.lo + self.lo * other.hi))
    }

    fn inverse(self) -> Self {
        let first = 1.0 / self.hi;
        // One step of Newton: y (2 − x y).
        let left = Self::sum(2.0, 0.0).plus(self.times(Self::sum(-first, 0.0)));
        left.times(Self::sum(first, 0.0))
    }

    fn root(self) -> Self {
        let first = self.hi.sqrt();
        // (y + x / y) / 2.
        let twice = Self::sum(first, 0.0).plus(self.times(Self::sum(first, 0.0).inverse()));
        Self { hi: 0.5 * twice.hi, lo: 0.5 * twice.lo }
    }
}

/// Σ m r / (r² + ε²)^(3/2) at a place, in long numbers.
fn long_sum(places: &[[f64; 3]], masses: &[f64], softening: f64, at: [f64; 3]) -> [f64; 3] {
    let mut sum = [Long { hi: 0.0, lo: 0.0 }; 3];
    for (place, mass) in places.iter().zip(masses) {
        if *place == at {
            continue;
        }
        let d: [Long; 3] = std::array::from_fn(|k| Long::sum(place[k], -at[k]));
        let square = d.iter().fold(Long::product(softening, softening), |sum, d| sum.plus(d.times(*d)));
        let share = square.root().times(square).inverse().times(Long { hi: *mass, lo: 0.0 });
        for (sum, d) in sum.iter_mut().zip(d) {
            *sum = sum.plus(d.times(share));
        }
    }
    sum.map(|sum| sum.hi)
}

/// The same in plain numbers of a precision, one after the other: the textbook's loop.
fn plain_sum<R: Real>(places: &[[f64; 3]], masses: &[f64], softening: f64, at: [f64; 3]) -> [f64; 3] {
    let (at, softening) = (at.map(number::<R>), number::<R>(softening));
    let mut sum = [R::ZERO; 3];
    for (place, mass) in places.iter().zip(masses) {
        let d: [R; 3] = std::array::from_fn(|k| number::<R>(place[k]) - at[k]);
        if d == [R::ZERO; 3] {
            continue;
        }
        let square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + softening * softening;
        let root: f64 = square.into();
        let cube = square * number::<R>(root.sqrt());
        for k in 0..3 {
            sum[k] = sum[k] + number::<R>(*mass) * d[k] / cube;
        }
    }
    sum.map(Into::into)
}

/// A world of bodies at rest, G = 1.
fn at_rest<R: Real>(integrator: Integrator, places: &[[f64; 3]], masses: &[f64], softening: f64) -> World<R> {
    let gravitation = Some(Gravitation { constant: R::ONE, softening: number(softening) });
    let settings = Settings { forces: Forces { gravitation, ..Forces::default() }, ..with(integrator) };
    let bodies = places.iter().zip(masses).map(|(place, mass)| Particle::<R> {
        position: vector::<R>(*place),
        gravitational_mass: Some(number(*mass)),
        ..Particle::default()
    });
    let mut world = World::new(settings).expect("valid settings");
    world.apply(&Command::Create(bodies.collect())).expect("valid bodies");
    world
}

/// The accelerations: the velocities after a step of 1 s from rest, to the bit.
fn accelerations<R: Real>(places: &[[f64; 3]], masses: &[f64], softening: f64) -> Result<Vec<[f64; 3]>, Error> {
    let mut world = at_rest::<R>(Integrator::SemiImplicitEuler, places, masses, softening);
    world.advance(1.0)?;
    Ok(world.particles().map(|state| wide::<R>(state.velocity)).collect())
}

/// A sphere after H. C. Plummer: dense in the middle, with a few far out.
fn plummer(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random(seed);
    let mut place = || {
        let share = 0.001 + 0.998 * random.unit();
        let radius = 1.0 / (share.powf(-2.0 / 3.0) - 1.0).sqrt();
        let out: [f64; 3] = random.vector::<f64>(1.0);
        out.map(|x| x / norm(out) * radius)
    };
    (0..count).map(|_| place()).collect()
}

/// √ of the mean of |a − b|² / |b|².
fn rms(actual: impl Iterator<Item = [f64; 3]>, expected: &[[f64; 3]]) -> f64 {
    let sum: f64 = actual.zip(expected).map(|(a, b)| (norm(minus(a, *b)) / norm(*b)).powi(2)).sum();
    (sum / expected.len() as f64).sqrt()
}

#[test]
fn direct_sum() {
    const COUNT: usize = 10_000;
    for seed in 1..=2 {
        // Places and masses that singles can say.
        let places: Vec<[f64; 3]> =
            plummer(COUNT, seed).into_iter().map(|x| x.map(|x| f32::nearest(x).into())).collect();
        let mut random = Random(seed + 77);
        let masses: Vec<f64> = (0..COUNT).map(|_| f32::nearest(1e-4 * (0.5 + random.unit())).into()).collect();
        let softening: f64 = f32::nearest(0.01).into();
        let sample = || (0..COUNT).step_by(50);
        let truth: Vec<[f64; 3]> = sample().map(|i| long_sum(&places, &masses, softening, places[i])).collect();
        let check = |what, ours: Vec<[f64; 3]>, plain: &dyn Fn(usize) -> [f64; 3]| {
            let worse = rms(sample().map(plain), &truth);
            check_claim("direct_sum", what, worse, rms(sample().map(|i| ours[i]), &truth));
        };
        let singles = accelerations::<f32>(&places, &masses, softening).expect("finite");
        check("single", singles, &|i| plain_sum::<f32>(&places, &masses, softening, places[i]));
        let doubles = accelerations::<f64>(&places, &masses, softening).expect("finite");
        check("double", doubles, &|i| plain_sum::<f64>(&places, &masses, softening, places[i]));
    }
    check_every_row("direct_sum");
}

/// Two bodies so far apart that squares overflow, or so near that they vanish; softened by more or by less than that.
#[test]
fn extreme_distances() {
    fn each<R: Real>(scales: &[f64]) {
        let (mut worst, mut book): (f64, f64) = (0.0, f64::INFINITY);
        for (seed, &scale) in (1..).zip(scales) {
            for softening in [0.0, 1e-3 * scale, scale, 1e3 * scale] {
                let softening: f64 = number::<R>(softening).into();
                let place: [f64; 3] = wide::<R>(Random(seed).vector::<R>(scale));
                // So that the acceleration is far from the ends of the range.
                let ends = if R::PRECISION == Precision::Single { 1e37 } else { 1e300 };
                let mass: f64 = number::<R>((scale * scale).clamp(1.0 / ends, ends)).into();
                let seen = accelerations::<R>(&[[0.0; 3], place], &[0.0, mass], softening).expect("finite")[0];
                let far = norm(place).max(softening);
                let ratio = |x: f64| x / far;
                let length = place.map(ratio).iter().map(|x| x * x).sum::<f64>() + ratio(softening).powi(2);
                let magnitude = mass / far / far / length.sqrt() / length;
                let truth = place.map(|x| magnitude * ratio(x));
                worst = worst.max(norm(minus(seen, truth)) / norm(truth));
                // r / r³ in the precision of the world, as the formula stands.
                let plain = plain_sum::<R>(&[place], &[mass], softening, [0.0; 3]);
                let error = norm(minus(plain, truth)) / norm(truth);
                book = book.min(if error.is_nan() { f64::INFINITY } else { error });
            }
        }
        check_claim("extreme_distances", R::PRECISION.name(), book, worst);
    }
    each::<f32>(&[1e20, 1e18, 1e-20, 1e-25]);
    each::<f64>(&[1e160, 1e-170, 1e120, 1e-150]);
    check_every_row("extreme_distances");
}

/// ε far below, at and far above the distance, where nothing is extreme.
#[test]
fn softening() {
    fn each<R: Real>() {
        let (mut worst, mut without): (f64, f64) = (0.0, 0.0);
        for seed in 1..=100 {
            let place: [f64; 3] = wide::<R>(Random(seed).vector::<R>(1.0));
            for softening in [1e-6, 0.1, 1.0, 30.0, 1e6] {
                let softening: f64 = number::<R>(softening).into();
                let truth = long_sum(&[place], &[1.0], softening, [0.0; 3]);
                let off = |a: [f64; 3]| norm(minus(a, truth)) / norm(truth);
                let seen = accelerations::<R>(&[[0.0; 3], place], &[0.0, 1.0], softening).expect("finite")[0];
                worst = worst.max(off(seen));
                without =
                    without.max(off(accelerations::<R>(&[[0.0; 3], place], &[0.0, 1.0], 0.0).expect("finite")[0]));
            }
        }
        check_claim("softening", R::PRECISION.name(), without, worst);
    }
    each::<f32>();
    each::<f64>();
    check_every_row("softening");
}

/// Bodies at one place do not pull each other, with and without softening, and are pulled alike by a third.
#[test]
fn coincident_bodies() {
    fn each<R: Real>() {
        for (seed, softening) in [(1, 0.0), (2, 1e-3), (3, 0.0), (4, 10.0)] {
            let place: [f64; 3] = wide::<R>(Random(seed).vector::<R>(if seed == 3 { 1e-15 } else { 30.0 }));
            // The formula is 0/0 without softening.
            let d = [0.0; 3];
            let naive = d[0] / (dot(d, d) + softening * softening).powf(1.5);
            for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_forces()) {
                let name = format!("{integrator}, ε = {softening}, {}", R::PRECISION);
                let mut alone = at_rest::<R>(integrator, &[place; 3], &[2.0, 3.0, 1e6], softening);
                alone.advance(0.5).unwrap_or_else(|error| panic!("{name}: {error}"));
                let moved = (0..3).map(|id| norm(velocity(&alone, id))).fold(0.0, f64::max);
                if softening == 0.0 {
                    check_claim("coincident_bodies", R::PRECISION.name(), naive, moved);
                }
                assert_eq!(moved, 0.0, "{name}");
                assert_eq!(position(&alone, 1), place, "{name}");
                let third = place.map(|x| x + 40.0);
                let places = [place, place, third];
                let mut beside = at_rest::<R>(integrator, &places, &[2.0, 3.0, 5.0], softening);
                beside.advance(0.25).unwrap_or_else(|error| panic!("{name}: {error}"));
                let [first, second] = [0, 1].map(|id| [position(&beside, id), velocity(&beside, id)]);
                assert_eq!(first, second, "{name}: pulled alike");
                assert!(norm(first[1]) > 1e-5, "{name}: and pulled");
            }
        }
    }
    each::<f32>();
    each::<f64>();
    check_every_row("coincident_bodies");
}

/// 64 bodies of 10⁻¹² to 10¹² kg: every action has its reaction.
#[test]
fn mass_ratio() {
    fn each<R: Real>(seed: u64) -> f64 {
        let mut random = Random(seed);
        let gravitation = Some(Gravitation { constant: R::ONE, softening: R::ZERO });
        let forces = Forces { gravitation, ..Forces::default() };
        let bodies: Vec<Particle<R>> = (0..64)
            .map(|_| Particle {
                position: random.vector(1.0).into(),
                mass: Mass::Mass(number(10f64.powf(24.0 * random.unit() - 12.0))),
                ..Particle::default()
            })
            .collect();
        let mut world = world(Settings { forces, ..with(Integrator::SemiImplicitEuler) }, &bodies);
        world.advance(1.0).expect("finite");
        let (mut sum, mut of_magnitudes) = ([0.0; 3], 0.0);
        for state in world.particles() {
            let (w, a): (f64, _) = (state.inverse_mass.into(), wide::<R>(state.velocity));
            sum = std::array::from_fn(|k| sum[k] + a[k] / w);
            of_magnitudes += norm(a) / w;
        }
        norm(sum) / of_magnitudes
    }
    let doubles = (1..=20).map(each::<f64>).fold(0.0, f64::max);
    let singles: Vec<f64> = (1..=20).map(each::<f32>).collect();
    let best = singles.iter().copied().fold(f64::INFINITY, f64::min);
    check_claim("mass_ratio", "double", best, doubles);
    // Without reaction: each body is pulled by those that are heavier, but does not pull them.
    let heaviest = {
        let places = plummer(64, 5);
        let one_sided: Vec<f64> = (0..64).map(|i| if i < 32 { 1.0 } else { 0.0 }).collect();
        let a = accelerations::<f64>(&places, &one_sided, 0.01).expect("finite");
        let sum: [f64; 3] = std::array::from_fn(|k| a.iter().map(|a| a[k]).sum::<f64>());
        norm(sum) / a.iter().map(|a| norm(*a)).sum::<f64>()
    };
    check_claim("mass_ratio", "single", heaviest, singles.iter().copied().fold(0.0, f64::max));
    check_every_row("mass_ratio");
}

/// What is immovable attracts with the mass that it is given for that, and nothing moves it; without one it does not
/// attract.
#[test]
fn immovable_attractor() {
    fn each<R: Real>() {
        let gravitation = Some(Gravitation { constant: R::ONE, softening: R::ZERO });
        for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_forces()) {
            let name = format!("{integrator} {}", R::PRECISION);
            let settings = Settings { forces: Forces { gravitation, ..Forces::default() }, ..with::<R>(integrator) };
            let sun = |mass: Option<f64>| Particle::<R> {
                position: vector::<R>([0.5, -2.0, 1.0]),
                mass: Mass::IMMOVABLE,
                gravitational_mass: mass.map(number),
                ..Particle::default()
            };
            let planet = Particle { position: vector::<R>([10.5, -2.0, 1.0]), ..Particle::default() };
            let mut bound = world(settings, &[sun(Some(1e12)), planet]);
            let mut free = world(settings, &[sun(None), planet]);
            let by = if integrator == Integrator::Dop853 { Advance::by(1e-6) } else { in_steps(1e-6, 10) };
            for world in [&mut bound, &mut free] {
                world.advance(by).expect("finite");
                assert_eq!((position(world, 0), velocity(world, 0)), ([0.5, -2.0, 1.0], [0.0; 3]), "{name}");
            }
            // 1e12 / 10² m/s² for a microsecond.
            let speed = velocity(&bound, 1);
            assert!((speed[0] / -1e4 - 1.0).abs() < 1e-3 && speed[1].abs() < 1.0, "{name}: {speed:?}");
            assert_eq!(velocity(&free, 1), [0.0; 3], "{name}: nothing attracts it");
        }
    }
    each::<f32>();
    each::<f64>();
}

/// Bodies that do not attract change no bit of those that do, nor of each other.
#[test]
fn test_particles() {
    fn each<R: Real>(seed: u64) {
        let mut random = Random(seed);
        let heavy: Vec<[f64; 3]> = (0..20).map(|_| wide::<R>(random.vector::<R>(10.0))).collect();
        let light: Vec<[f64; 3]> = (0..300).map(|_| wide::<R>(random.vector::<R>(10.0))).collect();
        for integrator in Integrator::ALL.into_iter().filter(|i| i.serves_forces() && *i != Integrator::Dop853) {
            let after = |light: &[[f64; 3]], mass: f64| {
                let places = [&heavy[..], light].concat();
                let masses: Vec<f64> = (0..places.len()).map(|i| if i < 20 { 1.0 } else { mass }).collect();
                let mut world = at_rest::<R>(integrator, &places, &masses, 0.1);
                world.advance(in_steps(0.5, 10)).expect("finite");
                (0..places.len() as u64).map(|id| position(&world, id)).collect::<Vec<_>>()
            };
            let name = format!("{integrator} {}", R::PRECISION);
            let (all, few, none) = (after(&light, 0.0), after(&light[..1], 0.0), after(&[], 0.0));
            assert_eq!(all[..21], few[..21], "{name}: of each other");
            assert_eq!(all[..20], none[..], "{name}: of those that attract");
            assert_ne!(after(&light, 1e-3)[..20], none[..], "{name}: had they attracted, it would show");
        }
    }
    for seed in 1..=3 {
        each::<f32>(seed);
        each::<f64>(seed);
    }
}

/// Opposite pulls, each near the largest number, are nothing together; beyond it they are refused.
#[test]
fn opposite_pulls() {
    fn each<R: Real>(mass: f64) {
        for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_forces()) {
            let name = format!("{integrator} {}", R::PRECISION);
            let sides = |distance: f64, mass: f64| {
                let place = |x: f64| [distance * x, distance * x / 2.0, -distance * x / 4.0];
                let mut world = at_rest::<R>(integrator, &[[0.0; 3]], &[0.0], 0.0);
                for side in [-1.0, 1.0] {
                    let source = Particle::<R> {
                        position: vector::<R>(place(side)),
                        mass: Mass::IMMOVABLE,
                        gravitational_mass: Some(number(mass)),
                        ..Particle::default()
                    };
                    world.create(source).expect("valid");
                }
                world
            };
            let mut held = sides(1.0, mass);
            held.advance(1.0).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!((position(&held, 0), velocity(&held, 0)), ([0.0; 3], [0.0; 3]), "{name}");
            // Each of them alone is infinite.
            let limits = Limits { steps: 100, ..Limits::default() };
            let mut torn = sides(1e-12, mass);
            if integrator == Integrator::Dop853 {
                let mut limited = World::with_limits(*torn.settings(), limits).expect("valid");
                for state in torn.particles() {
                    let copy = Particle {
                        position: state.position,
                        mass: Mass::Inverse(state.inverse_mass),
                        gravitational_mass: state.gravitational_mass,
                        ..Particle::default()
                    };
                    limited.create(copy).expect("valid");
                }
                torn = limited;
            }
            let before = torn.digest();
            let error = torn.advance(1.0).expect_err("infinite pulls");
            let told = matches!(error, Error::Diverged { particle: ParticleId(0), step: 1, .. });
            assert!(told || matches!(error, Error::TooManySteps { .. }), "{name}: {error}");
            assert_eq!(torn.digest(), before, "{name}");
        }
    }
    each::<f32>(1e37);
    each::<f64>(1e300);
}

/// 1,000 steps of bodies of 10⁻¹² to 10¹² kg: what the momentum changes by, relative to all momenta that were
/// exchanged.
#[test]
fn momentum() {
    fn each<R: Real>(compensated: bool, seed: u64) -> f64 {
        let mut random = Random(seed);
        let gravitation = Some(Gravitation { constant: number(1e-12), softening: number(0.1) });
        let forces = Forces { gravitation, ..Forces::default() };
        let bodies: Vec<Particle<R>> = (0..16)
            .map(|i| Particle {
                position: random.vector(1.0).into(),
                velocity: random.vector(0.1).into(),
                mass: Mass::Mass(number(10f64.powf(24.0 * f64::from(i) / 15.0 - 12.0))),
                ..Particle::default()
            })
            .collect();
        let mut world = world(Settings { forces, compensated, ..with(Integrator::VelocityVerlet) }, &bodies);
        let total = |world: &World<R>| {
            let mut sum = [0.0; 3];
            for state in world.particles() {
                let (w, v): (f64, _) = (state.inverse_mass.into(), wide::<R>(state.velocity));
                sum = std::array::from_fn(|k| sum[k] + v[k] / w);
            }
            sum
        };
        let before = total(&world);
        world.advance(in_steps(1.0, 1000)).expect("finite");
        norm(minus(total(&world), before)) / norm(before)
    }
    let worst = |run: fn(bool, u64) -> f64, compensated| (1..=5).map(|seed| run(compensated, seed)).fold(0.0, f64::max);
    let plain = worst(each::<f64>, false);
    check_claim("momentum", "double, plain sums", plain, worst(each::<f64>, true));
    check_claim("momentum", "single, plain sums", worst(each::<f32>, false), worst(each::<f32>, true));
    check_every_row("momentum");
}
