//! Scenes under a constant acceleration: clocks, steps and sums.

use super::*;
use crate::physics::Random;

/// λ of a damping, in a precision.
fn rate<R: Real>(damping: f64) -> f64 {
    let damping: f64 = number::<R>(damping).into();
    -damping.ln()
}

/// |v / (a/λ) − 1| of a particle that has fallen until nothing changes any more.
fn terminal<R: Real>(integrator: Integrator, damping: f64, h: f64) -> f64 {
    let rate = rate::<R>(damping);
    let steps = steps_of(40.0 / rate, h);
    let falling = Particle { damping: number(damping), ..thrown::<R>() };
    let mut world = world(with(integrator), &[falling]);
    if integrator == Integrator::Exact {
        for _ in 0..steps {
            world.advance(h).expect("far from overflow");
        }
    } else {
        world.advance(in_steps(h * steps as f64, steps)).expect("far from overflow");
    }
    let a: f64 = number::<R>(-9.81).into();
    velocity(&world, 0)[1] / (a / rate) - 1.0
}

#[test]
fn terminal_bias() {
    let grid = [0.99, 0.5, 0.1, 0.001, 1e-9].into_iter().flat_map(|d| [1.0 / 60.0, 0.1, 1.0].map(|h| (d, h)));
    let mut book = f64::INFINITY;
    let (mut double, mut single, mut verlet, mut formula, mut other): (f64, f64, f64, f64, f64) = Default::default();
    for (damping, h) in grid {
        let bias = terminal::<f64>(Integrator::NewtonEuler, damping, h);
        book = book.min(bias.abs());
        double = double.max(terminal::<f64>(Integrator::Exact, damping, h).abs());
        single = single.max(terminal::<f32>(Integrator::Exact, damping, h).abs());
        verlet = verlet.max(terminal::<f64>(Integrator::VelocityVerlet, damping, h).abs());
        let x = rate::<f64>(damping) * h;
        formula = formula.max((bias - (x / x.exp_m1() - 1.0)).abs());
        other = other.max((bias - (x / -(-x).exp_m1() - 1.0)).abs());
    }
    check_claim("terminal_bias", "double", book, double);
    check_claim("terminal_bias", "single", book, single);
    check_claim("terminal_bias", "double, in steps", book, verlet);
    check_claim("terminal_bias", "the book's bias is x/(eˣ − 1) − 1", other, formula);
    check_every_row("terminal_bias");
}

/// The base scene after durations that add up to 10 s.
fn cut<R: Real>(settings: Settings<R>, cuts: &[f64]) -> [f64; 3] {
    let mut world = world(settings, &[thrown()]);
    for duration in cuts {
        world.advance(*duration).expect("far from overflow");
    }
    position(&world, 0)
}

/// Frames of 1/240 to 1/15 s that add up to 10 s without rounding: multiples of 2⁻³⁰ s.
fn frames(seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    let (mut frames, mut left) = (Vec::new(), 10.0);
    while left > 0.0 {
        let frame = 1.0 / 240.0 + random.unit() * (1.0 / 15.0 - 1.0 / 240.0);
        let frame = f64::min(left, (frame * 2f64.powi(30)).round() * 2f64.powi(-30));
        frames.push(frame);
        left -= frame;
    }
    frames
}

/// The largest distance between the ends of a scene under these cuts and its end without any.
fn spread<R: Real>(settings: Settings<R>, cuts: &[Vec<f64>]) -> f64 {
    let whole = cut(settings, &cuts[0]);
    cuts.iter().map(|cuts| norm(minus(cut(settings, cuts), whole))).fold(0.0, f64::max)
}

#[test]
fn split_invariance() {
    let even = [1u32, 10, 600, 10_000].map(|n| vec![10.0 / f64::from(n); n as usize]);
    let random: Vec<Vec<f64>> = (1..=40).map(frames).collect();
    let every: Vec<Vec<f64>> = even.into_iter().chain(random.iter().cloned()).collect();
    let book = spread(with::<f64>(Integrator::NewtonEuler), &random);
    check_claim("split_invariance", "double", book, spread(with::<f64>(Integrator::Exact), &every));
    check_claim("split_invariance", "single", book, spread(with::<f32>(Integrator::Exact), &every));
    let stepped = Settings { compensated: true, ..with::<f64>(Integrator::VelocityVerlet) };
    check_claim("split_invariance", "double, in steps", book, spread(stepped, &every));
    check_every_row("split_invariance");
}

/// How far a world drifts from what one at the origin makes of the same scene, in units of the last place of its
/// distance.
fn lost_far_away<R: Real>(settings: Settings<R>, particle: Particle<R>, offset: f64, seconds: f64) -> f64 {
    let offset: f64 = number::<R>(offset).into();
    let widened = |x: R::Vec3| wide::<R>(x).into();
    let near = Particle {
        velocity: widened(particle.velocity),
        acceleration: particle.acceleration.map(widened),
        damping: particle.damping.into(),
        ..Particle::default()
    };
    let mut truth = self::world(Settings::default(), &[near]);
    let mut world = self::world(settings, &[Particle { position: vector::<R>([offset; 3]), ..particle }]);
    truth.advance(seconds).expect("small numbers");
    let frames = steps_of(seconds, 1.0 / 60.0);
    if settings.integrator == Integrator::Exact {
        for _ in 0..frames {
            world.advance(seconds / frames as f64).expect("small numbers");
        }
    } else {
        world.advance(in_steps(seconds, frames)).expect("small numbers");
    }
    let way = minus(position(&world, 0), [offset; 3]);
    let error = minus(way, position(&truth, 0));
    error.into_iter().map(f64::abs).fold(0.0, f64::max) / ulp::<R>(offset)
}

#[test]
fn far_origin() {
    fn worst<R: Real>(settings: Settings<R>, offsets: &[f64]) -> f64 {
        offsets.iter().map(|offset| lost_far_away(settings, thrown(), *offset, 10.0)).fold(0.0, f64::max)
    }
    fn compensated<R: Real>() -> Settings<R> {
        Settings { compensated: true, ..with(Integrator::VelocityVerlet) }
    }
    let offsets = [1e3, 1e6, 1e9];
    let plain = worst(with::<f64>(Integrator::VelocityVerlet), &offsets);
    check_claim("far_origin", "double", plain, worst(with::<f64>(Integrator::Exact), &offsets));
    check_claim("far_origin", "double, in steps", plain, worst(compensated::<f64>(), &offsets));
    // A single cannot say how far 77 m are at 1e9 m: 64 m are its last place.
    let plain = worst(with::<f32>(Integrator::VelocityVerlet), &offsets[..2]);
    check_claim("far_origin", "single", plain, worst(with::<f32>(Integrator::Exact), &offsets));
    check_claim("far_origin", "single, in steps", plain, worst(compensated::<f32>(), &offsets));
    // 0.1 m/s at 10⁶ m: a step is less than half a last place.
    let slow: Particle<f32> = Particle { velocity: vector::<f32>([0.1, -0.1, 0.05]), ..Particle::default() };
    let after = |settings| lost_far_away(settings, slow, 1e6, 5000.0);
    let frozen = after(with(Integrator::NewtonEuler));
    check_claim("far_origin", "single, 0.1 m/s", frozen, after(with(Integrator::Exact)));
    check_claim("far_origin", "single, 0.1 m/s, in steps", frozen, after(compensated()));
    check_every_row("far_origin");
}

/// Positions after a million steps of 1/64 s with a damping of ½, 0.999 and 1, and what they lack: from 120 digits of
/// p = v₀ φ + a ψ, for the damping and acceleration that the precision can say.
fn after_a_million_steps<R: Real>() -> [[(f64, f64); 3]; 3] {
    match R::PRECISION {
        Precision::Double => [
            [
                (43.280_851_226_668_9, 1.498_836_631_928_056_3e-15),
                (-221_059.973_204_922_22, 1.212_011_616_655_188_6e-11),
                (7.213_475_204_444_817, -3.423_128_411_454_074_6e-16),
            ],
            [
                (29_984.992_627_307_05, 4.464_911_618_225_149e-13),
                (-143_364_427.379_666_9, 1.092_943_493_397_653_9e-8),
                (4_997.498_771_217_842, -2.287_497_069_538_902_5e-13),
            ],
            [(468_750.0, 0.0), (-1_196_884_765.625, -6.071_532_165_918_825e-8), (78_125.0, 0.0)],
        ],
        Precision::Single => [
            [(43.280_851_226_668_9, 0.0), (-221_059.982_663_094_62, 0.0), (7.213_475_204_444_817, 0.0)],
            [(29_985.378_869_366_356, 0.0), (-143_366_153.981_709_8, 0.0), (4_997.563_144_894_392, 0.0)],
            [(468_750.0, 0.0), (-1_196_884_816.847_741_6, 0.0), (78_125.0, 0.0)],
        ],
    }
}

/// The largest error of a million steps, in units of the last place of the coordinate, for some of the dampings.
fn lost_in_a_million<R: Real>(settings: Settings<R>, rows: std::ops::Range<usize>) -> f64 {
    let dampings = [0.5, 0.999, 1.0].map(|damping| Particle { damping: number(damping), ..thrown::<R>() });
    let mut world = world(settings, &dampings[rows.clone()]);
    world.advance(in_steps(15_625.0, 1_000_000)).expect("far from overflow");
    let mut worst: f64 = 0.0;
    for (id, expected) in after_a_million_steps::<R>()[rows].iter().enumerate() {
        for (actual, (nearest, lacks)) in position(&world, id as u64).into_iter().zip(expected) {
            worst = worst.max(((actual - nearest) - lacks).abs() / ulp::<R>(*nearest));
        }
    }
    worst
}

#[test]
fn million_steps() {
    fn each<R: Real>(what: &str, integrator: Integrator, rows: std::ops::Range<usize>) {
        let plain = with::<R>(integrator);
        let compensated = Settings { compensated: true, ..plain };
        let what = format!("{}, {what}", R::PRECISION);
        let plain = lost_in_a_million(plain, rows.clone());
        check_claim("million_steps", &what, plain, lost_in_a_million(compensated, rows));
    }
    each::<f64>("velocity_verlet", Integrator::VelocityVerlet, 0..3);
    each::<f32>("velocity_verlet", Integrator::VelocityVerlet, 0..3);
    // Its step error is below the last place of a single; its weights, rounded to single, would not be.
    each::<f32>("rk4", Integrator::Rk4, 0..3);
    // Without damping it has no step error either.
    each::<f64>("rk4 without damping", Integrator::Rk4, 2..3);
    each::<f32>("rk4 without damping", Integrator::Rk4, 2..3);
    let book = lost_in_a_million(with::<f64>(Integrator::NewtonEuler), 0..3);
    let exact = [with::<f64>(Integrator::Exact)].map(|settings| lost_in_a_million(settings, 0..3))[0];
    check_claim("million_steps", "double, exact", book, exact);
    let book = lost_in_a_million(with::<f32>(Integrator::NewtonEuler), 0..3);
    check_claim("million_steps", "single, exact", book, lost_in_a_million(with::<f32>(Integrator::Exact), 0..3));
    check_every_row("million_steps");
}

#[test]
fn clock() {
    const COUNT: u32 = 10_000_000;
    let frame: f64 = 1.0 / 60.0;
    let mut world = World::<f32>::default();
    let (mut double, mut single) = (0f64, 0f32);
    for _ in 0..COUNT {
        world.advance(frame).expect("an empty world");
        double += frame;
        single += 1.0 / 60.0;
    }
    // 1/60 has 53 bits of which the last is 2⁻⁵⁸; the product with a number below 2²⁴ is one of 128 bits.
    let units = u128::from(frame.to_bits() & ((1 << 52) - 1) | (1 << 52)) * u128::from(COUNT);
    let halves = (units >> 32) as f64 * 2f64.powi(32 - 58);
    let rest = (units & 0xffff_ffff) as f64 * 2f64.powi(-58);
    let exact = halves + rest;
    check_claim("clock", "a sum of doubles", (double - exact).abs(), (world.time() - exact).abs());
    check_claim("clock", "a sum of singles", (f64::from(single) - exact).abs(), (world.time() - exact).abs());
    check_every_row("clock");
}

/// 20 s of frames, with one of 5 s among them.
fn hitched() -> Vec<f64> {
    (0..960).map(|frame| if frame == 200 { 5.0 } else { 1.0 / 64.0 }).collect()
}

#[test]
fn burst_of_frames() {
    fn each<R: Real>() {
        let at = |settings: Settings<R>, cuts: &[f64]| cut(settings, cuts);
        let smooth = vec![1.0 / 64.0; 959 + 320];
        let whole: f64 = smooth.iter().sum();
        let off = |settings| norm(minus(at(settings, &hitched()), at(settings, &[whole])));
        let truth = at(with(Integrator::Exact), &[whole]);
        let book = norm(minus(at(with(Integrator::NewtonEuler), &hitched()), truth));
        check_claim("burst_of_frames", R::PRECISION.name(), book, off(with(Integrator::Exact)));
        // With a longest step the hitch is taken in the steps it stands for: the bits are those of a smooth run.
        for integrator in Integrator::ALL.into_iter().filter(|i| *i != Integrator::Dop853) {
            let short = Settings { max_step: Some(1.0 / 64.0), ..with(integrator) };
            assert_eq!(at(short, &hitched()), at(short, &smooth), "{integrator} {}", R::PRECISION);
            let long = with(integrator);
            let same = at(long, &hitched()) == at(long, &smooth);
            assert!(
                !same || integrator == Integrator::Exact,
                "{integrator}: a hitch that cannot be told shows nothing"
            );
        }
    }
    each::<f32>();
    each::<f64>();
    check_every_row("burst_of_frames");
}

/// Steps that come to rest, and ones that never do: what is left of 1 m/s after 1e5 steps of 1/60 s without a force.
#[test]
fn denormal_sleep() {
    fn each<R: Real>() {
        let still = Some(vector::<R>([0.0; 3]));
        let coasting = Particle { velocity: vector::<R>([1.0, -0.5, 0.25]), acceleration: still, ..thrown::<R>() };
        let steps = 100_000;
        // The book's update for a velocity, in plain numbers: it ends where v D rounds to v.
        let d: f64 = R::HALF.into();
        let factor: R = number(d.powf(1.0 / 60.0));
        let stuck = (0..steps).fold(R::ONE, |v, _| v * factor);
        let rate = rate::<R>(0.5);
        for integrator in Integrator::ALL.into_iter().filter(|i| *i != Integrator::Dop853) {
            let mut world = self::world(with(integrator), &[coasting]);
            world.advance(in_steps(steps as f64 / 60.0, steps)).expect("far from overflow");
            let left = velocity(&world, 0);
            let smallest = ulp::<R>(0.0);
            check_claim("denormal_sleep", R::PRECISION.name(), stuck.into() / smallest, norm(left) / smallest);
            let way = position(&world, 0)[0] * rate - 1.0;
            assert!(way.abs() < 0.01, "{integrator}: it came {way:e} too far");
        }
        // It is exact to its tolerance, 1e-9, and not beyond: what is left is below that.
        let mut world = world(with(Integrator::Dop853), &[coasting]);
        world.advance(2000.0).expect("far from overflow");
        assert!(norm(velocity(&world, 0)) < 1e-9, "{:?}", velocity(&world, 0));
    }
    each::<f32>();
    each::<f64>();
    check_every_row("denormal_sleep");
}

/// Every integrator, with the forces it can serve.
fn forced<R: Real>() -> impl Iterator<Item = Settings<R>> {
    Integrator::ALL.into_iter().flat_map(|integrator| {
        let drag = Some(Drag { k1: number(0.2), k2: number(0.1) });
        let gravitation = Some(Gravitation { constant: R::ONE, softening: number(0.1) });
        let all = Forces { drag, gravitation };
        let forces = if integrator.serves_forces() { vec![Forces::default(), all] } else { vec![Forces::default()] };
        forces.into_iter().map(move |forces| Settings { forces, compensated: true, ..with(integrator) })
    })
}

/// Durations of every size: a world is advanced to a finite state, or refuses and keeps its digest.
#[test]
fn dt_extremes() {
    fn each<R: Real>() {
        let other = Particle { position: vector::<R>([3.0, 1.0, 2.0]), ..thrown() };
        for settings in forced::<R>() {
            let name = settings.integrator;
            // `dop853` gives up where it is told to.
            let limits = Limits { steps: 2000, ..Limits::default() };
            let mut untouched = World::<R>::with_limits(settings, limits).expect("valid settings");
            for particle in [thrown(), other] {
                untouched.create(particle).expect("valid");
            }
            for duration in [0.0, -0.0, -1.0, -1e-300, f64::NAN, f64::INFINITY, -f64::INFINITY] {
                let mut world = untouched.clone();
                let field = Error::NotFinite(Place { field: Field::Duration, index: None });
                let error = if duration.is_finite() { Error::DurationNotPositive } else { field };
                assert_eq!(world.advance(duration), Err(error), "{name}, {duration}");
                assert_eq!(world.digest(), untouched.digest(), "{name}, {duration}");
            }
            for duration in [5e-324, 1e-300, 1e-40, 1e-9, 1e9, 1e30, 1e39, 1e100, 1e121, 1e300, f64::MAX] {
                let mut world = untouched.clone();
                match world.advance(duration) {
                    Ok(_) => {
                        let ends = [0, 1].map(|id| [position(&world, id), velocity(&world, id)]);
                        assert!(ends.as_flattened().as_flattened().iter().all(|x| x.is_finite()), "{name}, {duration}");
                        assert_ne!(world.digest(), untouched.digest(), "{name}, {duration}: time went by");
                    }
                    Err(_) => assert_eq!(world.digest(), untouched.digest(), "{name}, {duration}"),
                }
            }
            // What is short enough is done, and changes next to nothing.
            let mut short = untouched.clone();
            if name != Integrator::Dop853 {
                short.advance(1e-300).expect("a step of next to no length");
                assert!(norm(position(&short, 0)) < 1e-298, "{name}");
            }
        }
    }
    each::<f32>();
    each::<f64>();
}

/// Dampings that are none are refused where they come in, and −0 is 0.
#[test]
fn d_extremes() {
    fn each<R: Real>() {
        for settings in forced::<R>() {
            let name = settings.integrator;
            let mut world = world(settings, &[thrown()]);
            let before = world.digest();
            let one_more: R = number(if R::PRECISION == Precision::Single { 1.0 + 2e-7 } else { 1.0 + 3e-16 });
            for damping in
                [number(-1e-30), number(-1.0), one_more, number(1e30), number(f64::NAN), number(f64::INFINITY)]
            {
                let new = Particle { damping, ..thrown() };
                assert!(world.create(new).is_err(), "{name}: created with {damping}");
                assert!(world.set_damping(ParticleId(0), damping).is_err(), "{name}: set to {damping}");
                assert_eq!(world.digest(), before, "{name}, {damping}");
            }
            let zero = world.set_damping(ParticleId(0), number(-0.0));
            assert_eq!(zero.is_ok(), name.serves_zero_damping(), "{name}: {zero:?}");
            if zero.is_ok() {
                let damping: f64 = state(&world, 0).damping.into();
                assert!(damping == 0.0 && damping.is_sign_positive(), "{name}");
                world.advance(1.0).expect("finite");
                assert!(norm(velocity(&world, 0)) < 12.0, "{name}: nothing is kept but the last kick");
            }
            for damping in [1.0, 1.0 - f64::from(f32::EPSILON), 1e-30, 1e-45] {
                world.set_damping(ParticleId(0), number(damping)).expect("between 0 and 1");
            }
        }
    }
    each::<f32>();
    each::<f64>();
}

/// One particle gets an acceleration near the largest number for one step; the others do not notice.
#[test]
fn acceleration_burst() {
    fn each<R: Real>(burst: f64) {
        let calm: Vec<Particle<R>> =
            (1..=20).map(|seed| Particle { position: Random(seed).vector::<R>(10.0).into(), ..thrown() }).collect();
        let h = 1.0 / 64.0;
        let (mut worst, mut book): (f64, f64) = (0.0, f64::INFINITY);
        for integrator in Integrator::ALL {
            let name = format!("{integrator} {}", R::PRECISION);
            let mut alone = world(with(integrator), &calm);
            // `dop853` would go on in ever shorter steps to its limit of ten million.
            let limits = Limits { steps: 2000, ..Limits::default() };
            let mut beside = World::with_limits(with(integrator), limits).expect("valid settings");
            beside.apply(&Command::Create(calm.iter().copied().collect())).expect("valid particles");
            let still = Particle { acceleration: Some(vector::<R>([0.0; 3])), damping: R::ONE, ..Particle::default() };
            let wild = beside.create(still).expect("valid");
            beside.set_acceleration(wild, Some(vector::<R>([burst, 0.0, 0.0]))).expect("a finite acceleration");
            beside.advance(h).expect("finite");
            let [p, v] = [position(&beside, wild.0)[0], velocity(&beside, wild.0)[0]];
            beside.set_acceleration(wild, Some(vector::<R>([0.0; 3]))).expect("a finite acceleration");
            beside.advance(h).expect("finite");
            alone.advance(h).expect("finite");
            alone.advance(h).expect("finite");
            // Too much: the advance is refused, names the particle, and goes on without it.
            beside.set_acceleration(wild, Some(vector::<R>([R::LARGEST, 0.0, 0.0]))).expect("a finite acceleration");
            let before = beside.digest();
            let error = beside.advance(1e3).expect_err("beyond the largest number");
            let named = matches!(error, Error::Diverged { particle, step: 1, .. } if particle == wild);
            assert!(
                named || (integrator == Integrator::Dop853 && matches!(error, Error::TooManySteps { .. })),
                "{name}: {error}"
            );
            assert_eq!(beside.digest(), before, "{name}");
            beside.remove(wild).expect("it is there");
            for world in [&mut alone, &mut beside] {
                world.advance(h).expect("finite");
            }
            if integrator != Integrator::Dop853 {
                assert!(alone.particles().eq(beside.particles()), "{name}: the others noticed");
            }
            let a: f64 = number::<R>(burst).into();
            let (p, v) = ((p / (a * h * h / 2.0) - 1.0).abs(), (v / (a * h) - 1.0).abs());
            assert!(v <= 4.0 * ulp::<R>(1.0), "{name}: {v:e}");
            if [Integrator::NewtonEuler, Integrator::SemiImplicitEuler].contains(&integrator) {
                book = book.min(p);
            } else {
                worst = worst.max(p);
            }
        }
        check_claim("acceleration_burst", R::PRECISION.name(), book, worst);
    }
    each::<f32>(1e30);
    each::<f64>(1e300);
    check_every_row("acceleration_burst");
}
