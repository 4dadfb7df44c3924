//! Gravitation of a few bodies: orbits, encounters and collisions.

use super::*;
use crate::physics::Random;

const TURN: f64 = 2.0 * std::f64::consts::PI;

fn attracted<R: Real>(integrator: Integrator, softening: f64) -> Settings<R> {
    let gravitation = Some(Gravitation { constant: R::ONE, softening: number(softening) });
    Settings { forces: Forces { gravitation, ..Forces::default() }, ..with(integrator) }
}

fn body<R: Real>(mass: f64, position: [f64; 3], velocity: [f64; 3]) -> Particle<R> {
    Particle {
        position: vector::<R>(position),
        velocity: vector::<R>(velocity),
        mass: Mass::Mass(number(mass)),
        ..Particle::default()
    }
}

/// Two bodies of masses 1 − m and m about their centre, a = 1 and G = 1, in the plane that a seed turns them into, at
/// their largest distance. A period is 2π.
fn pair<R: Real>(eccentricity: f64, m: f64, seed: u64) -> [Particle<R>; 2] {
    let mut random = Random(seed);
    let mut direction = || {
        let x: [f64; 3] = random.vector(1.0);
        x.map(|y| y / norm(x))
    };
    let out = direction();
    let other = direction();
    let across = minus(other, out.map(|x| x * dot(out, other)));
    let across = across.map(|x| x / norm(across));
    let (distance, speed) = (1.0 + eccentricity, ((1.0 - eccentricity) / (1.0 + eccentricity)).sqrt());
    let at = |share: f64, mass| body(mass, out.map(|x| x * distance * share), across.map(|x| x * speed * share));
    [at(-m, 1.0 - m), at(1.0 - m, m)]
}

/// The energy of bodies of these masses: ½ Σ m v² − Σ m m / √(r² + ε²).
fn energy<R: Real>(world: &World<R>, masses: &[f64], softening: f64) -> f64 {
    let mut sum = 0.0;
    for (i, m) in masses.iter().enumerate() {
        let v = velocity(world, i as u64);
        sum += 0.5 * m * dot(v, v);
        for (j, other) in masses.iter().enumerate().skip(i + 1) {
            let apart = minus(position(world, i as u64), position(world, j as u64));
            sum -= m * other / (dot(apart, apart) + softening * softening).sqrt();
        }
    }
    sum
}

/// |E/E₀ − 1|.
fn energy_error<R: Real>(world: &World<R>, masses: &[f64], softening: f64, before: f64) -> f64 {
    (energy(world, masses, softening) / before - 1.0).abs()
}

/// How far the second body is, as seen from the first, from where a seed's orbit of this eccentricity has it after a
/// time.
fn off_orbit<R: Real>(world: &World<R>, eccentricity: f64, m: f64, seed: u64, time: f64) -> f64 {
    let [first, second] = pair::<f64>(eccentricity, m, seed);
    let (out, speed) = (wide::<f64>(second.position), wide::<f64>(second.velocity));
    let (out, speed) = (minus(out, wide::<f64>(first.position)), minus(speed, wide::<f64>(first.velocity)));
    let (out, across) = (out.map(|x| x / norm(out)), speed.map(|x| x / norm(speed)));
    // Kepler's equation M = E − e sin E, from the nearest point, which is half a period later.
    let mean = time % TURN + std::f64::consts::PI;
    let mut anomaly = mean;
    for _ in 0..100 {
        anomaly -= (anomaly - eccentricity * anomaly.sin() - mean) / (1.0 - eccentricity * anomaly.cos());
    }
    let (along, beside) = (eccentricity - anomaly.cos(), -(1.0 - eccentricity * eccentricity).sqrt() * anomaly.sin());
    let expected: [f64; 3] = std::array::from_fn(|k| along * out[k] + beside * across[k]);
    norm(minus(minus(position(world, 1), position(world, 0)), expected))
}

/// The error after 0.7 periods in so many steps. (After a whole one errors of first order cancel for symplectic
/// methods.)
fn after_a_while(settings: Settings<f64>, eccentricity: f64, steps: u64) -> f64 {
    let (m, time) = (0.25, 0.7 * TURN);
    let mut world = world(settings, &pair(eccentricity, m, 5));
    world.advance(in_equal_steps(settings.integrator, time, steps)).expect("an orbit");
    off_orbit(&world, eccentricity, m, 5, time)
}

/// Where a thrown particle with damping and drag is after 2 s, in so many steps.
fn after_drag(settings: Settings<f64>, steps: u64) -> [f64; 3] {
    let drag = Some(Drag { k1: 0.2, k2: 0.1 });
    let settings = Settings { forces: Forces { drag, ..Forces::default() }, ..settings };
    let mut world = world(settings, &[Particle { damping: 0.9, ..thrown() }]);
    world.advance(in_equal_steps(settings.integrator, 2.0, steps)).expect("slowed down");
    position(&world, 0)
}

/// Halving the step divides the error by 2ⁿ.
#[test]
fn order() {
    // So coarse a tolerance accepts every step: what is left is the method at a fixed step.
    let any = Tolerance { absolute: 1e9, relative: 0.0 };
    let best = Tolerance { absolute: 1e-16, relative: 3e-17 };
    let best = Settings { tolerance: best, compensated: true, ..with(Integrator::Dop853) };
    let truth = after_drag(best, 200);
    let mut measured: Vec<(&str, Integrator, f64, f64)> = Vec::new();
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_forces()) {
        // Steps that are short enough for the order to show, and long enough for rounding not to.
        let (kepler, drag) = match integrator.order().expect("it has steps") {
            8 => (32, 64),
            4 => (500, 800),
            2 => (2000, 400),
            _ => (1 << 21, 16_384),
        };
        let order = f64::from(integrator.order().expect("it has steps"));
        let compensated = !integrator.is_euler();
        let orbit = Settings { tolerance: any, compensated, ..attracted(integrator, 0.0) };
        let [coarse, fine] = [kepler, 2 * kepler].map(|steps| after_a_while(orbit, 0.1, steps));
        measured.push(("Kepler, e = 0.1", integrator, order, (coarse / fine).log2()));
        let fall = Settings { tolerance: any, compensated, ..with(integrator) };
        let [coarse, fine] = [drag, 2 * drag].map(|steps| norm(minus(after_drag(fall, steps), truth)));
        // The error of `dop853` changes its sign where its steps are still long enough for rounding not to show.
        if integrator != Integrator::Dop853 {
            measured.push(("drag", integrator, order, (coarse / fine).log2()));
        }
    }
    for scene in ["Kepler, e = 0.1", "drag"] {
        let rows = || measured.iter().filter(|(of, ..)| *of == scene);
        let ours = rows().map(|(_, _, order, seen)| (seen - order).abs()).fold(0.0, f64::max);
        // The orders of the others are all outside.
        let others =
            rows().flat_map(|(_, _, order, _)| rows().filter(move |of| of.2 != *order).map(move |of| of.3 - order));
        check_claim("order", scene, others.map(f64::abs).fold(f64::INFINITY, f64::min), ours);
    }
    check_every_row("order");
}

/// The largest energy error of a circular orbit, sampled all along, and by how much its mean over the last tenth
/// differs from that over the first.
fn circular(settings: Settings<f64>, orbits: u64) -> (f64, f64) {
    let masses = [0.75, 0.25];
    let mut world = world(settings, &pair(0.0, 0.25, 3));
    let before = energy(&world, &masses, 0.0);
    let count = orbits * 10;
    let mut errors = Vec::new();
    for _ in 0..count {
        world.advance(in_steps(TURN / 10.0, 10)).expect("an orbit");
        errors.push(energy(&world, &masses, 0.0) / before - 1.0);
    }
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    let tenth = errors.len() / 10;
    let trend = mean(&errors[errors.len() - tenth..]) - mean(&errors[..tenth]);
    (errors.iter().fold(0.0, |worst, error| f64::max(worst, error.abs())), trend.abs())
}

#[test]
fn orbit_energy() {
    let (verlet, trend) = circular(attracted(Integrator::VelocityVerlet, 0.0), 10_000);
    let (book, book_trend) = circular(attracted(Integrator::NewtonEuler, 0.0), 100);
    let (symplectic, _) = circular(attracted(Integrator::SemiImplicitEuler, 0.0), 100);
    let (_, rk4_trend) = circular(attracted(Integrator::Rk4, 0.0), 100);
    check_claim("orbit_energy", "against newton_euler", book, verlet);
    check_claim("orbit_energy", "against semi_implicit_euler", symplectic, verlet);
    check_claim("orbit_energy", "trend against newton_euler", book_trend, trend);
    check_claim("orbit_energy", "trend against rk4", rk4_trend, trend);
    check_every_row("orbit_energy");
}

/// Energy and position errors of e = 0.9 after some orbits, the largest of several moments.
fn eccentric(settings: Settings<f64>, seed: u64, orbits: u32, steps: u64) -> (f64, f64) {
    let (m, masses) = (1e-3, [1.0 - 1e-3, 1e-3]);
    let mut world = world(settings, &pair(0.9, m, seed));
    let before = energy(&world, &masses, 0.0);
    let (mut energy, mut place): (f64, f64) = (0.0, 0.0);
    let parts = 8;
    for part in 1..=parts {
        // Half a period before the end bodies are nearest, where the energy shows what the step is too long for; at the
        // end they are where they began, where positions show what happened before.
        let halves = u64::from(2 * orbits / parts);
        for some in [halves - 1, 1] {
            let (by, steps) = (TURN / 2.0 * some as f64, steps / 2 * some);
            let adaptive = settings.integrator == Integrator::Dop853;
            world.advance(if adaptive { Advance::by(by) } else { in_steps(by, steps) }).expect("an orbit");
            energy = energy.max(energy_error(&world, &masses, 0.0, before));
        }
        place = place.max(off_orbit(&world, 0.9, m, seed, TURN / 2.0 * f64::from(part) * halves as f64));
    }
    (energy, place)
}

/// The energy goes up and down with the roundings of the accelerations, as a random walk: 2e-13 after a thousand
/// orbits. The weights of the method, which are up to 5.8 and of both signs, enlarge them eight times.
#[test]
fn kepler_e_09() {
    let at = |tolerance: f64| {
        let tolerance = Tolerance { absolute: 0.0, relative: tolerance };
        Settings { tolerance, compensated: true, ..attracted::<f64>(Integrator::Dop853, 0.0) }
    };
    let (mut energy, mut place): (f64, f64) = (0.0, 0.0);
    for seed in 1..=3 {
        let (e, p) = eccentric(at(3e-17), seed, 1000, 0);
        (energy, place) = (energy.max(e), place.max(p));
    }
    let case = "kepler_e_09";
    let (book_energy, book_place) = eccentric(attracted(Integrator::VelocityVerlet, 0.0), 1, 24, 1000);
    check_claim(case, "energy, velocity_verlet, 24 orbits", book_energy, energy);
    check_claim(case, "position, velocity_verlet, 24 orbits", book_place, place);
    let (coarse_energy, coarse_place) = eccentric(at(1e-15), 1, 1000, 0);
    check_claim(case, "energy, tolerance 1e-15", coarse_energy, energy);
    check_claim(case, "position, tolerance 1e-15", coarse_place, place);
    check_every_row("kepler_e_09");
}

/// Two bodies that fall into each other from rest, ten times; the energy error at a hundred moments. None where the
/// advance is refused.
fn head_on<R: Real>(settings: Settings<R>, softening: f64, steps: u64) -> Result<f64, Error> {
    let masses = [0.5, 0.5];
    let softening: f64 = number::<R>(softening).into();
    let bodies = [body(0.5, [-0.5, 0.25, 0.0], [0.0; 3]), body(0.5, [0.5, -0.25, 0.0], [0.0; 3])];
    let mut world = world(settings, &bodies);
    let before = energy(&world, &masses, softening);
    let mut worst: f64 = 0.0;
    for _ in 0..100 {
        let by = if steps == 0 { Advance::by(0.1) } else { in_steps(0.1, steps) };
        let unchanged = world.digest();
        if let Err(error) = world.advance(by) {
            assert_eq!(world.digest(), unchanged, "a refused advance changes nothing");
            return Err(error);
        }
        worst = worst.max(energy_error(&world, &masses, softening, before));
    }
    Ok(worst)
}

#[test]
fn close_encounter() {
    let tolerance = Tolerance { absolute: 0.0, relative: 1e-15 };
    for (softening, steps) in [(1e-3, 100), (1e-2, 100), (0.1, 100)] {
        let adaptive = Settings { tolerance, compensated: true, ..attracted::<f64>(Integrator::Dop853, softening) };
        let ours = head_on(adaptive, softening, 0).expect("softened, the encounter is smooth");
        let verlet = attracted::<f64>(Integrator::VelocityVerlet, softening);
        let book = head_on(verlet, softening, steps).expect("finite");
        check_claim("close_encounter", &format!("ε = {softening}"), book, ours);
    }
    // dt = 0.03 √(ε³/GM) is short enough for velocity_verlet; thirty times that is not.
    let short = |factor: f64| steps_of(0.1, factor * f64::sqrt(1e-3));
    let verlet =
        |factor| head_on(attracted::<f64>(Integrator::VelocityVerlet, 0.1), 0.1, short(factor)).expect("finite");
    check_claim("close_encounter", "ε = 0.1, velocity_verlet, dt = 0.03 √(ε³/GM)", verlet(0.9), verlet(0.03));
    // Without softening they meet in a point, where no step is short enough.
    let error = head_on(attracted::<f64>(Integrator::Dop853, 0.0), 0.0, 0).expect_err("a collision");
    assert!(matches!(error, Error::TooManySteps { steps, .. } if steps < 100_000), "{error}");
    let error = head_on(attracted::<f32>(Integrator::Dop853, 0.0), 0.0, 0).expect_err("a collision");
    assert!(matches!(error, Error::TooManySteps { steps, .. } if steps < 100_000), "{error}");
    check_every_row("close_encounter");
}

/// v(t), then t with −v: how far from the start it ends.
#[test]
fn time_reversal() {
    let there_and_back = |integrator, seed| {
        let start = pair::<f64>(0.5, 0.25, seed);
        let mut world = world(attracted(integrator, 0.0), &start);
        for _ in 0..2 {
            world.advance(in_steps(3.0 * TURN, 600)).expect("an orbit");
            for id in [0, 1] {
                let back = velocity(&world, id).map(|v| -v);
                world.place(ParticleId(id), None, Some(back.into())).expect("finite");
            }
        }
        norm(minus(position(&world, 0), wide::<f64>(start[0].position)))
    };
    let worst = (1..=5).map(|seed| there_and_back(Integrator::VelocityVerlet, seed)).fold(0.0, f64::max);
    check_claim("time_reversal", "rk4", there_and_back(Integrator::Rk4, 1), worst);
    check_claim("time_reversal", "newton_euler", there_and_back(Integrator::NewtonEuler, 1), worst);
    check_every_row("time_reversal");
}

/// The error after an orbit follows the tolerance, and an advance ends however small that is.
#[test]
fn tolerance() {
    fn after<R: Real>(tolerance: f64) -> (f64, u64) {
        let tolerance = Tolerance { absolute: 0.0, relative: tolerance };
        let settings = Settings { tolerance, ..attracted::<R>(Integrator::Dop853, 0.0) };
        let mut world = world(settings, &pair::<R>(0.5, 0.25, 9));
        let report = world.advance(TURN).expect("an orbit");
        (off_orbit(&world, 0.5, 0.25, 9, TURN), report.steps + report.rejected_steps)
    }
    let [coarse, middle, fine] = [1e-5, 1e-8, 1e-11].map(|tolerance| after::<f64>(tolerance).0);
    check_claim("tolerance", "1e-8 against 1e-5", coarse, middle);
    check_claim("tolerance", "1e-11 against 1e-8", middle, fine);
    let (coarse, _) = after::<f32>(1e-3);
    for below in [1e-9, 1e-16, 1e-300] {
        let (fine, steps) = after::<f32>(below);
        check_claim("tolerance", "single, below its round-off", coarse, fine);
        assert!(steps < 1000, "{steps} steps for {below:e} in singles");
        let (_, steps) = after::<f64>(below);
        assert!(steps < 2000, "{steps} steps for {below:e} in doubles");
    }
    check_every_row("tolerance");
}

/// More steps than are allowed: told as such, and nothing is changed.
#[test]
fn too_many_steps() {
    fn each<R: Real>() {
        let limits = Limits { steps: 10, ..Limits::default() };
        let settings = attracted::<R>(Integrator::Dop853, 0.0);
        let mut limited = World::with_limits(settings, limits).expect("valid settings");
        let mut free = World::new(settings).expect("valid settings");
        for world in [&mut limited, &mut free] {
            world.apply(&Command::Create(pair::<R>(0.5, 0.25, 2).into_iter().collect())).expect("valid bodies");
        }
        let before = limited.digest();
        let error = limited.advance(TURN).expect_err("it takes more than ten");
        let told = matches!(error, Error::TooManySteps { steps: 10, reached, duration: TURN, .. } if reached < TURN);
        assert!(told, "{error}");
        assert_eq!((limited.digest(), limited.step_count()), (before, 0));
        assert!(free.advance(TURN).expect("without a limit").steps > 10);
        limited.advance(0.01).expect("a short way takes fewer");
    }
    each::<f32>();
    each::<f64>();
}
