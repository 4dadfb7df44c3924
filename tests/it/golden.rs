//! Pinned digests of seeded scenes: the same bits on every machine, and from one version to the next.

use std::collections::BTreeMap;
use std::fmt::Write;

use pointmass::{
    Advance, Column, Command, Configure, DampingLaw, Digest, Drag, Error, Gravitation, Integrator, Mass, NewParticles,
    Particle, ParticleId, Precision, Real, Selection, Settings, Threads, Tolerance, World,
};

use crate::physics::{Random, in_steps, served_damping, set};

/// Lines of scene, integrator, precision and digest.
const PINNED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden.txt");

/// When set, the digests that are seen are written to the file.
const RENEW: &str = "POINTMASS_GOLDEN_RENEW";

/// The instruction set that the machine must have: how CI makes sure that the one it emulates has no more.
const LEVEL: &str = "POINTMASS_EXPECTED_LEVEL";

/// A name, a damping law, and what happens in a world without particles under a gravity.
type Scene<R> = (&'static str, DampingLaw, fn(&mut Play<R>));

struct Play<R: Real> {
    world: World<R>,
    random: Random,
}

#[expect(clippy::too_many_lines, reason = "one row for each scene")]
fn scenes<R: Real>() -> [Scene<R>; 20] {
    use DampingLaw::{PerSecond, PerStep};
    [
        ("drop", PerSecond, |play| {
            play.world.create(Particle::default()).expect("valid");
            play.frames(&[(1.0 / 60.0, 1), (1.0 / 60.0, 3), (0.1, 7)]);
        }),
        ("uniform_damping", PerSecond, |play| {
            play.create(7, &[0.99], &[1.0], Own::None);
            play.frames(&[(1.0 / 60.0, 1), (0.7, 42), (1e-3, 1)]);
        }),
        ("no_damping", PerSecond, |play| {
            play.create(257, &[1.0], &[1.0, 0.25], Own::None);
            play.frames(&[(0.1, 2), (1.0 / 7.0, 65)]);
        }),
        ("nothing_kept", PerSecond, |play| {
            play.create(7, &[0.0], &[1.0], Own::None);
            play.push(50.0);
            play.frames(&[(0.25, 3), (0.1, 1)]);
        }),
        ("tiny_dampings", PerSecond, |play| {
            play.create(257, &[5e-324, 1e-310, 1e-300, 1e-44, 1e-30, 1e-7], &[1.0], Own::None);
            play.frames(&[(1e-3, 3), (1.0 / 60.0, 1), (1e-9, 2), (2.0, 70)]);
        }),
        ("almost_undamped", PerSecond, |play| {
            play.create(255, &[1.0 - f64::EPSILON / 2.0, 1.0 - f64::EPSILON, 1.0 - 1e-7, 0.999], &[1.0], Own::Some);
            play.frames(&[(1.0 / 128.0, 1), (30.0, 90), (1e4, 2)]);
        }),
        ("mixed", PerSecond, |play| {
            play.create(1000, &DAMPINGS, &[1.0, 1.0 / 3.0, 12.0, 0.0], Own::Some);
            play.frames(&[(1.0 / 60.0, 1), (1.0 / 3.0, 20), (0.1, 1)]);
        }),
        // So many powers that a library which rounds one in a hundred otherwise is found.
        ("many_dampings", PerSecond, |play| {
            let dampings: Vec<f64> = (0..2000).map(|_| play.random.unit()).collect();
            play.create(2000, &dampings, &[1.0], Own::None);
            play.frames(&[(1.0 / 60.0, 1), (0.1, 3)]);
        }),
        ("own_accelerations", PerSecond, |play| {
            play.create(256, &[0.9, 0.5, 1e-3], &[1.0], Own::All);
            play.frames(&[(1.0 / 60.0, 2), (2.5, 64)]);
            let acceleration = Some(Column::Uniform(Some(play.random.vector(5.0).into())));
            play.apply(&set(Selection::All, acceleration, None, None));
            play.frames(&[(0.3, 5)]);
        }),
        ("immovable", PerSecond, |play| {
            play.create(300, &DAMPINGS, &[0.0], Own::Some);
            let resting = Particle { mass: Mass::IMMOVABLE, ..Particle::default() };
            play.apply(&Command::Create(NewParticles { count: 300, ..resting.into() }));
            play.push(20.0);
            play.frames(&[(1.0 / 60.0, 1), (0.5, 33)]);
        }),
        ("forces", PerSecond, |play| {
            play.create(257, &DAMPINGS, &[1.0, 0.1, 7.0, 0.0], Own::Some);
            for _ in 0..5 {
                play.push(100.0);
                play.push(1.0);
                play.frames(&[(1.0 / 60.0, 2)]);
            }
            play.push(3.0);
        }),
        ("impulses", PerSecond, |play| {
            play.create(255, &DAMPINGS, &[1.0, 0.1, 7.0, 0.0], Own::None);
            for _ in 0..5 {
                let (ids, impulse) = play.some(40.0);
                play.apply(&Command::Impulse { ids, impulse });
                let (ids, place) = play.some(10.0);
                play.apply(&Command::Place { ids, position: Some(place), velocity: None });
                play.frames(&[(0.05, 3)]);
            }
        }),
        ("coming_and_going", PerSecond, |play| {
            play.create(1000, &DAMPINGS, &[1.0, 0.0], Own::Some);
            for round in 0..6 {
                for _ in 0..60 {
                    let ids: Vec<ParticleId> = play.world.particles().map(|state| state.id).collect();
                    let ids = play.random.one_of(&ids).into();
                    play.apply(&Command::Remove { ids });
                }
                play.create(20 * round, &DAMPINGS, &[2.0], Own::None);
                play.frames(&[(0.1, 4)]);
            }
        }),
        ("everything", PerSecond, |play| {
            play.create(100, &DAMPINGS, &[1.0, 0.5, 0.0], Own::Some);
            for _ in 0..60 {
                let mut ids = play.world.particles().map(|state| state.id).collect();
                let command = play.random.command(&mut ids);
                play.apply(&command);
                let duration = play.random.unit();
                play.frames(&[(duration, 3)]);
            }
        }),
        ("long_flights", PerSecond, |play| {
            for round in 0..5 {
                play.create(40, &DAMPINGS, &[1.0, 0.0], Own::Some);
                play.frames(&[(1e-6, 1), (12_345.678, 3), (f64::from(round) * 1e5 + 0.1, 2)]);
                play.push(1.0);
            }
        }),
        ("gravity_changes", PerSecond, |play| {
            play.create(255, &DAMPINGS, &[1.0, 0.0], Own::Some);
            for _ in 0..5 {
                play.frames(&[(0.3, 3), (1.0 / 60.0, 1)]);
                let gravity = Some(play.random.vector(20.0).into());
                play.apply(&Command::Configure(Configure { gravity, ..Configure::default() }));
            }
        }),
        ("coming_to_rest", PerSecond, |play| {
            play.create(257, &[1e-3, 0.5, 0.9, 1.0, 0.0], &[0.0], Own::None);
            let tiny: f64 = if R::PRECISION == Precision::Single { 1e-29 } else { 1e-288 };
            let velocity = (0..257).map(|_| play.random.vector(tiny).into()).collect();
            let (position, velocity) =
                (Some(Column::Uniform([R::ZERO; 3].into())), Some(Column::PerParticle(velocity)));
            play.apply(&Command::Place { ids: Selection::All, position, velocity });
            play.frames(&[(1.0, 60), (2.0, 130), (0.5, 1)]);
        }),
        ("many_steps", PerStep, |play| {
            play.create(7, &[0.999, 0.5, 1.0], &[1.0], Own::Some);
            play.frames(&[(10.0, 3000), (1.0, 64), (1.0, 1024), (1.0, 1025)]);
        }),
        ("near_overflow", PerSecond, |play| {
            play.create(1000, &DAMPINGS, &[1.0], Own::Some);
            let most = R::LARGEST / 4.0;
            let (ids, place) = play.some(most);
            play.apply(&Command::Place { ids, position: Some(place), velocity: None });
            let (ids, velocity) = play.some(most);
            play.apply(&Command::Place { ids, position: None, velocity: Some(velocity) });
            play.push(most / 1e3);
            play.frames(&[(0.1, 3), (0.5, 70)]);
            let refused = play.world.advance(Advance { steps: Some(100), ..Advance::by(1e6) });
            assert!(matches!(refused, Err(Error::Diverged { .. })), "{refused:?}");
        }),
        ("crowd", PerSecond, |play| {
            play.create(100_001, &[1.0, 0.9, 0.5], &[1.0, 0.5], Own::None);
            let max_step = Some(Some(1.0 / 240.0));
            play.apply(&Command::Configure(Configure { max_step, ..Configure::default() }));
            play.world.advance(1.0 / 60.0).expect("finite");
            play.push(9.0);
            play.frames(&[(1.0 / 60.0, 1)]);
        }),
    ]
}

/// Those with forces, under every integrator that computes with them.
fn scenes_with_forces<R: Real>() -> [Scene<R>; 4] {
    use DampingLaw::PerSecond;
    [
        ("drag", PerSecond, |play| {
            play.forces(Some(Drag { k1: R::nearest(0.1), k2: R::nearest(0.02) }), None);
            play.create(257, &[1.0, 0.9], &[1.0, 0.25, 0.0], Own::Some);
            for id in (0..257).step_by(5) {
                let drag = Drag { k1: R::nearest(play.random.unit()), k2: R::ZERO };
                play.world.set_drag(ParticleId(id), Some(drag)).expect("valid");
            }
            play.frames(&[(1.0 / 60.0, 1), (0.5, 30)]);
            play.push(50.0);
            play.frames(&[(0.1, 3)]);
        }),
        ("gravitation", PerSecond, |play| {
            play.forces(None, Some(Gravitation { constant: R::nearest(50.0), softening: R::HALF }));
            play.create(300, &[1.0], &[1.0, 0.3, 0.0], Own::None);
            for id in (0..300).step_by(7) {
                let mass = [None, Some(R::ZERO), Some(R::nearest(3.0))][play.random.below(3)];
                play.world.set_gravitational_mass(ParticleId(id), mass).expect("valid");
            }
            play.frames(&[(1.0 / 60.0, 1), (0.3, 9)]);
        }),
        ("all_forces", PerSecond, |play| {
            play.apply(&Command::Configure(Configure { compensated: Some(true), ..Configure::default() }));
            let drag = Drag { k1: R::nearest(0.01), k2: R::nearest(0.05) };
            play.forces(Some(drag), Some(Gravitation { constant: R::nearest(1e-3), softening: R::ZERO }));
            play.create(40, &[1.0, 0.9, 0.5], &[1.0, 0.5, 0.0], Own::Some);
            play.push(20.0);
            play.frames(&[(0.1, 3), (1.0, 70)]);
        }),
        // So near and so far that every pair is computed by itself.
        ("near_and_far", PerSecond, |play| {
            let is_single = R::PRECISION == Precision::Single;
            let (near, far, constant) = if is_single { (1e-18, 1e25, 1e-36) } else { (1e-140, 1e200, 1e-280) };
            play.forces(None, Some(Gravitation { constant: R::nearest(constant), softening: R::ZERO }));
            for scale in [1.0, near, far] {
                let particle = || Particle { position: play.random.vector(scale).into(), ..Particle::default() };
                let particles = std::iter::repeat_with(particle).take(3).collect();
                play.apply(&Command::Create(particles));
            }
            play.frames(&[(1e-12, 3)]);
        }),
    ]
}

const DAMPINGS: [f64; 8] = [1.0, 1.0, 0.999, 0.9, 0.5, 1e-3, 1e-30, 0.0];

/// Which particles have an acceleration of their own.
#[derive(Clone, Copy)]
enum Own {
    None,
    Some,
    All,
}

impl<R: Real> Play<R> {
    fn forces(&mut self, drag: Option<Drag<R>>, gravitation: Option<Gravitation<R>>) {
        let (drag, gravitation) = (Some(drag), Some(gravitation));
        let tolerance = Some(Tolerance { absolute: 1e-5, relative: 1e-5 });
        self.apply(&Command::Configure(Configure { drag, gravitation, tolerance, ..Configure::default() }));
    }

    #[track_caller]
    fn apply(&mut self, command: &Command<R>) {
        self.world.apply(command).expect("valid");
    }

    fn create(&mut self, count: usize, dampings: &[f64], inverse_masses: &[f64], own: Own) {
        let (random, integrator) = (&mut self.random, self.world.settings().integrator);
        let particles = (0..count).map(|_| Particle {
            position: random.vector(100.0).into(),
            velocity: random.vector(30.0).into(),
            acceleration: match own {
                Own::None => None,
                Own::Some => [None, Some([R::ZERO; 3].into()), Some(random.vector(20.0).into())][random.below(3)],
                Own::All => Some(random.vector(20.0).into()),
            },
            damping: served_damping(integrator, R::nearest(random.one_of(dampings))),
            mass: Mass::Inverse(R::nearest(random.one_of(inverse_masses))),
            ..Particle::default()
        });
        let command = Command::Create(particles.collect());
        self.apply(&command);
    }

    /// About a third of the particles, with a vector for each.
    fn some(&mut self, scale: f64) -> (Selection, Column<R::Vec3>) {
        let random = &mut self.random;
        let ids: Vec<ParticleId> =
            self.world.particles().map(|state| state.id).filter(|_| random.below(3) == 0).collect();
        let vectors = ids.iter().map(|_| random.vector(scale).into()).collect();
        (Selection::Ids(ids), Column::PerParticle(vectors))
    }

    /// Adds forces to about a third of the particles.
    fn push(&mut self, scale: f64) {
        let (ids, force) = self.some(scale);
        self.apply(&Command::AddForce { ids, force });
    }

    /// Advances by durations in steps.
    #[track_caller]
    fn frames(&mut self, frames: &[(f64, u64)]) {
        for &(duration, steps) in frames {
            self.world.advance(in_steps(self.world.settings().integrator, steps, duration)).expect("finite");
        }
    }
}

/// The digest at the end of a scene.
fn play<R: Real>(scene: &Scene<R>, integrator: Integrator, threads: &Threads) -> Digest {
    let &(_, damping_law, scene) = scene;
    let gravity = [R::nearest(0.25), R::nearest(-9.75), R::ZERO].into();
    let settings = Settings { integrator, damping_law, gravity, ..Settings::default() };
    let mut world = World::new(settings).expect("it serves the law");
    world.set_threads(threads);
    let mut play = Play { world, random: Random(1) };
    scene(&mut play);
    // Under `exact` the digest holds where particles were at their base times: this makes it now, so that it also holds
    // the arithmetic of the way here.
    play.apply(&Command::Configure(Configure { integrator: Some(integrator), ..Configure::default() }));
    play.world.digest()
}

/// A line for each scene and integrator.
fn seen<R: Real>() -> Vec<String> {
    let threads = [1, 2, 3].map(|count| Threads::new(count).expect("they start"));
    let mut lines = Vec::new();
    for scene in &scenes::<R>() {
        // Damping is too strong for the steps of some.
        let serves = |integrator: &Integrator| integrator.serves(scene.1) && integrator.serves_zero_damping();
        lines.extend(Integrator::ALL.into_iter().filter(serves).map(|integrator| line(scene, integrator, &threads)));
    }
    for scene in &scenes_with_forces::<R>() {
        let serves = |integrator: &Integrator| integrator.serves_forces();
        lines.extend(Integrator::ALL.into_iter().filter(serves).map(|integrator| line(scene, integrator, &threads)));
    }
    lines
}

/// The digest at the end of a scene, with any number of threads.
fn line<R: Real>(scene: &Scene<R>, integrator: Integrator, threads: &[Threads; 3]) -> String {
    let place = format!("{} {integrator} {}", scene.0, R::PRECISION);
    let [one, several @ ..] = threads.each_ref().map(|threads| play(scene, integrator, threads));
    assert!(several.iter().all(|digest| *digest == one), "{place} with one thread, with two and with three");
    format!("{place} {one}")
}

#[test]
fn scenes_end_with_their_pinned_digests() {
    let seen = [seen::<f32>(), seen::<f64>()].concat();
    if std::env::var_os(RENEW).is_some() {
        std::fs::write(PINNED, seen.join("\n") + "\n").expect("a file of the project");
        return;
    }
    let pinned = std::fs::read_to_string(PINNED).unwrap_or_default();
    let pinned: BTreeMap<&str, &str> = pinned.lines().filter_map(|line| line.rsplit_once(' ')).collect();
    let seen: BTreeMap<&str, &str> = seen.iter().filter_map(|line| line.rsplit_once(' ')).collect();
    let mut differences = String::new();
    for place in seen.keys().chain(pinned.keys().filter(|place| !seen.contains_key(*place))) {
        let of = |digests: &BTreeMap<&str, &str>| digests.get(place).map_or("nothing", |digest| digest).to_owned();
        let (seen, pinned) = (of(&seen), of(&pinned));
        if seen != pinned {
            writeln!(differences, "{place}: {seen} is seen, {pinned} is pinned").expect("a string takes all");
        }
    }
    assert!(
        differences.is_empty(),
        "{differences}These scenes end with other bits than before. When that is meant, {RENEW}=1 writes the new digests \
         to tests/golden.txt, and the commit says the reason."
    );
}

/// Without the variable every machine will do.
#[test]
fn the_machine_has_the_instruction_set_that_is_expected() {
    let level = format!("{:?}", fearless_simd::Level::new());
    let level = level.split('(').next().expect("split has a first part");
    if let Ok(expected) = std::env::var(LEVEL) {
        assert_eq!(level, expected, "{LEVEL} says what is expected");
        #[cfg(target_arch = "x86_64")]
        if expected == "Sse4_2" {
            let more = is_x86_feature_detected!("avx") || is_x86_feature_detected!("fma");
            assert!(!more, "the machine has AVX or FMA");
        }
    }
}
