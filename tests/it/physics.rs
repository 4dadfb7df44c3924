//! The laws of motion, the clock, the plan of an advance and the promise of all or nothing, seen through `World`.

use std::sync::atomic::AtomicBool;

use pointmass::{
    Advance, Advanced, Column, Command, Configure, DampingLaw, Error, Field, Integrator, Limit, Limits, Mass,
    NewParticles, Outcome, Particle, ParticleId, ParticleState, Place, Precision, Properties, Quantity, Real,
    Selection, Settings, World,
};
use proptest::prelude::*;

/// Powers and motions from 80 digits; tests/reference/motion.py says how the table was made.
pub(crate) const REFERENCE: &str = include_str!("../reference/motion.txt");

/// The generator `SplitMix64` of G. L. Steele, D. Lea and C. H. Flood: any seed will do.
#[derive(Debug)]
pub(crate) struct Random(pub(crate) u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let x = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    pub(crate) fn below(&mut self, n: usize) -> usize {
        usize::try_from(self.next() % n as u64).expect("less than n")
    }

    /// At least 0 and below 1, in steps of 2⁻⁵².
    pub(crate) fn unit(&mut self) -> f64 {
        f64::from_bits((self.next() >> 12) | 1f64.to_bits()) - 1.0
    }

    pub(crate) fn one_of<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.below(list.len())]
    }

    pub(crate) fn vector<R: Real>(&mut self, scale: f64) -> [R; 3] {
        std::array::from_fn(|_| R::nearest((self.unit() * 2.0 - 1.0) * scale))
    }

    fn shuffled<T: Copy>(&mut self, list: &[T]) -> Vec<T> {
        let mut list = list.to_vec();
        (1..list.len()).rev().for_each(|i| list.swap(i, self.below(i + 1)));
        list
    }

    pub(crate) fn particle<R: Real>(&mut self) -> Particle<R> {
        Particle {
            position: self.vector(100.0).into(),
            velocity: self.vector(30.0).into(),
            acceleration: if self.below(3) == 0 { Some(self.vector(20.0).into()) } else { None },
            damping: R::nearest(self.one_of(&[1.0, 1.0, 0.999, 0.9, 0.5, 1e-3, 0.0])),
            mass: Mass::Inverse(R::nearest(self.one_of(&[0.0, 1.0, 0.25, 1.0 / 3.0, 12.0]))),
            ..Particle::default()
        }
    }

    /// One value for all of `n`, or one for each.
    fn column<T: Copy + PartialEq>(&mut self, n: usize, mut value: impl FnMut(&mut Self) -> T) -> Column<T> {
        if self.below(2) == 0 {
            Column::Uniform(value(self))
        } else {
            Column::PerParticle((0..n).map(|_| value(self)).collect())
        }
    }

    /// Any command that changes particles, about those of `ids`; a removal takes the id out of the list.
    pub(crate) fn command<R: Real>(&mut self, ids: &mut Vec<ParticleId>) -> Command<R> {
        let some: Vec<ParticleId> = ids.iter().copied().filter(|_| self.below(3) == 0).collect();
        let (n, ids_of) = (some.len(), Selection::Ids(some));
        match self.below(6) {
            0 => Command::Create((0..3).map(|_| self.particle()).collect()),
            1 => Command::Place {
                ids: ids_of,
                position: Some(self.column(n, |r| r.vector(50.0).into())),
                velocity: (self.below(2) == 0).then(|| self.column(n, |r| r.vector(50.0).into())),
            },
            2 => {
                let acceleration = (self.below(2) == 0).then(|| self.column(n, |r| r.particle::<R>().acceleration));
                let damping = (self.below(2) == 0).then(|| self.column(n, |r| r.particle::<R>().damping));
                let mass = Some(self.column(n, |r| r.particle::<R>().mass));
                set(ids_of, acceleration, damping, mass)
            }
            3 => Command::AddForce { ids: ids_of, force: self.column(n, |r| r.vector(50.0).into()) },
            4 => Command::Impulse { ids: ids_of, impulse: self.column(n, |r| r.vector(50.0).into()) },
            _ if ids.is_empty() => Command::Remove { ids: ids_of },
            _ => Command::Remove { ids: ids.swap_remove(self.below(ids.len())).into() },
        }
    }
}

/// An advance in so many steps; without them under an integrator that chooses its own.
pub(crate) fn in_steps(integrator: Integrator, steps: u64, duration: f64) -> Advance {
    let steps = Some(steps).filter(|_| integrator != Integrator::Dop853);
    Advance { steps, ..Advance::by(duration) }
}

/// A damping of 0 as one that every integrator can compute with, where it is asked to.
pub(crate) fn served_damping<R: Real>(integrator: Integrator, damping: R) -> R {
    if damping == R::ZERO && !integrator.serves_zero_damping() { R::HALF } else { damping }
}

/// Those in which every particle moves as if it were alone: not with steps that are common to all.
fn alone() -> impl Iterator<Item = Integrator> {
    Integrator::ALL.into_iter().filter(|integrator| *integrator != Integrator::Dop853)
}

/// What a random command may meet: the rest is a fault of the test.
fn is_refusal_of_integrator(error: &Error) -> bool {
    matches!(error, Error::IntegratorCannotServeZeroDamping { .. } | Error::IntegratorTakesNoSteps { .. })
}

/// Sets these properties, and no others.
pub(crate) fn set<R: Real>(
    ids: Selection,
    acceleration: Option<Column<Option<R::Vec3>>>,
    damping: Option<Column<R>>,
    mass: Option<Column<Mass<R>>>,
) -> Command<R> {
    Command::Set { ids, properties: Properties { acceleration, damping, mass, ..Properties::default() } }
}

/// What failure messages begin with.
pub(crate) fn scene<R: Real>(name: &str, integrator: Integrator) -> String {
    format!("{name}, {integrator}, {}", R::PRECISION)
}

fn show<R: Real>(x: R) -> String {
    let double: f64 = x.into();
    match R::PRECISION {
        Precision::Single => format!("{x:?} (0x{:08x})", f32::nearest(double).to_bits()),
        Precision::Double => format!("{x:?} (0x{:016x})", double.to_bits()),
    }
}

/// Equal to the bit, hence also in the sign of a zero.
#[track_caller]
pub(crate) fn check_bits<R: Real>(
    scene: &str,
    id: ParticleId,
    property: &str,
    expected: impl Into<[R; 3]>,
    actual: impl Into<[R; 3]>,
) {
    for (axis, (expected, actual)) in ["x", "y", "z"].iter().zip(expected.into().into_iter().zip(actual.into())) {
        let (e, a): (f64, f64) = (expected.into(), actual.into());
        let (expected, actual) = (|| show(expected), || show(actual));
        assert!(e.to_bits() == a.to_bits(), "{scene}: {property}.{axis} of {id} is {}, not {}", actual(), expected());
    }
}

#[track_caller]
fn check_state<R: Real>(scene: &str, expected: &ParticleState<R>, actual: &ParticleState<R>) {
    let id = actual.id;
    check_bits(scene, id, "position", expected.position, actual.position);
    check_bits(scene, id, "velocity", expected.velocity, actual.velocity);
    check_bits(scene, id, "acceleration", expected.acceleration, actual.acceleration);
    check_bits(scene, id, "force", expected.force, actual.force);
    let others = |state: &ParticleState<R>| [state.damping, state.inverse_mass, R::ZERO];
    check_bits(scene, id, "(damping, inverse_mass)", others(expected), others(actual));
    assert_eq!(expected.own_acceleration, actual.own_acceleration, "{scene}: own acceleration of {id}");
}

/// The same clock, and the same particles under the same ids.
#[track_caller]
fn check_same<R: Real>(scene: &str, expected: &World<R>, actual: &World<R>) {
    assert_eq!(expected.time().to_bits(), actual.time().to_bits(), "{scene}: {} {}", expected.time(), actual.time());
    assert_eq!(expected.particle_count(), actual.particle_count(), "{scene}");
    for (expected, actual) in expected.particles().zip(actual.particles()) {
        assert_eq!(expected.id, actual.id, "{scene}");
        check_state(scene, &expected, &actual);
    }
}

/// Nothing is different, neither what can be read nor what is still to come.
#[track_caller]
fn check_unchanged<R: Real>(scene: &str, before: &World<R>, after: &World<R>) {
    check_same(scene, before, after);
    assert_eq!(before.settings(), after.settings(), "{scene}");
    assert_eq!((before.step_count(), before.revision()), (after.step_count(), after.revision()), "{scene}");
    let [mut before, mut after] = [before.clone(), after.clone()];
    for duration in [1.0 / 7.0, 0.7] {
        assert_eq!(before.advance(duration), after.advance(duration), "{scene}");
    }
    assert_eq!(before.create(Particle::default()), after.create(Particle::default()), "{scene}");
    check_same(&format!("{scene}, later"), &before, &after);
}

#[track_caller]
fn world<R: Real>(integrator: Integrator, particles: &[Particle<R>]) -> World<R> {
    let gravity = [R::nearest(0.25), R::nearest(-9.75), R::ZERO].into();
    let mut world = World::new(Settings { integrator, gravity, ..Settings::default() }).expect("valid settings");
    let served =
        |particle: &Particle<R>| Particle { damping: served_damping(integrator, particle.damping), ..*particle };
    world.apply(&Command::Create(particles.iter().map(served).collect())).expect("valid particles");
    world
}

#[track_caller]
fn state<R: Real>(world: &World<R>, id: u64) -> ParticleState<R> {
    world.particle(ParticleId(id)).expect("it was created and not removed")
}

/// A particle after a time under `exact`, from a base time that is not 0.
#[track_caller]
fn fly<R: Real>([position, velocity, a]: [[f64; 3]; 3], damping: f64, time: f64) -> ParticleState<R> {
    let [position, velocity, a] = [position, velocity, a].map(|x| x.map(R::nearest).into());
    let damping = R::nearest(damping);
    let mut world = World::default();
    world.advance(1234.567).expect("an empty world");
    world
        .create(Particle { position, velocity, acceleration: Some(a), damping, ..Particle::default() })
        .expect("values of the table are in range");
    world.advance(time).expect("far from overflow");
    state(&world, 0)
}

/// A motion of the table, from its line: true values are a double and what it lacks.
///
/// E, φ and ψ are within 0.55 ulp, at most 1.1 u of their value (u = 2⁻⁵³), and every operation of
/// v = v₀E + Aφ and p = p₀ + (v₀φ + Aψ) rounds once, by at most u of its result. So each product is within 2.1 u of
/// itself, the inner sum adds u of its own value and the outer one u of p. Terms in u² are below 1e-9 of that. A single
/// world computes the same double and rounds it once: half a last place more, and the bits of the double world rounded.
#[track_caller]
fn check_motion<R: Real>(line: usize, numbers: &[f64]) {
    const U: f64 = f64::EPSILON / 2.0;
    let &[damping, time, kept, phi, psi, ref axes @ ..] = numbers else { panic!("line {line} is too short") };
    let [p0, v0, a, p, p_lacks, v, v_lacks]: [[f64; 3]; 7] =
        std::array::from_fn(|k| std::array::from_fn(|axis| axes[7 * axis + k]));
    let at = scene::<R>(&format!("motion {line}, d = {damping:e}, t = {time:e}"), Integrator::Exact);
    let (state, double) = (fly::<R>([p0, v0, a], damping, time), fly::<f64>([p0, v0, a], damping, time));
    for k in 0..3 {
        let flow = 2.1 * U * ((v0[k] * phi).abs() + (a[k] * psi).abs()) + U * (p[k] - p0[k]).abs();
        let kick = 2.1 * U * ((v0[k] * kept).abs() + (a[k] * phi).abs());
        let rows = [
            ("position", state.position.into()[k], p[k], p_lacks[k], flow),
            ("velocity", state.velocity.into()[k], v[k], v_lacks[k], kick),
        ];
        for (property, actual, nearest, lacks, bound) in rows {
            let magnitude = f32::nearest(nearest).abs();
            let half_ulp = 0.5 * (f64::from(magnitude.next_up()) - f64::from(magnitude));
            let rounding = if R::PRECISION == Precision::Single { half_ulp } else { 0.0 };
            let bound = (bound + U * nearest.abs()) * (1.0 + 1e-9) + rounding;
            let error = (actual.into() - nearest) - lacks;
            let actual = || show(actual);
            assert!(error.abs() <= bound, "{at}: {property}[{k}] is {}, not {nearest:?}: off by {error:e}", actual());
        }
    }
    check_bits(&at, state.id, "position", double.position.to_array().map(R::nearest), state.position);
    check_bits(&at, state.id, "velocity", double.velocity.to_array().map(R::nearest), state.velocity);
}

#[test]
fn exact_meets_its_error_bound() {
    let lines = REFERENCE.lines().enumerate().filter_map(|(n, line)| Some((n, line.strip_prefix("motion ")?)));
    for (n, line) in lines {
        let word = |word| f64::from_bits(u64::from_str_radix(word, 16).expect("the table is hexadecimal"));
        let numbers: Vec<f64> = line.split(' ').map(word).collect();
        check_motion::<f32>(n + 1, &numbers);
        check_motion::<f64>(n + 1, &numbers);
    }
}

/// Advances by the durations in turn, asking for 1, 2, 3, … steps, which are nothing to `exact`; particles exist from
/// 77.7 s on.
#[track_caller]
fn flown<R: Real>(particles: &[Particle<R>], durations: &[f64]) -> World<R> {
    let mut world = world(Integrator::Exact, &[]);
    world.advance(77.7).expect("an empty world");
    world.apply(&Command::Create(particles.iter().copied().collect())).expect("valid particles");
    for (steps, &duration) in (1..).zip(durations) {
        world.advance(Advance { steps: Some(steps), ..Advance::by(duration) }).expect("far from overflow");
    }
    world
}

fn check_splits<R: Real>(seed: u64) {
    let random = &mut Random(seed);
    let particles: Vec<Particle<R>> = (0..40).map(|_| random.particle()).collect();
    let at = scene::<R>(&format!("seed {seed}"), Integrator::Exact);
    // Multiples of 2⁻³⁰ whose sum is a double: one advance is the same as all of them.
    let cuts: Vec<f64> = (0..12).map(|_| (random.unit() * 1e10).ceil() / 1_073_741_824.0).collect();
    let whole = flown(&particles, &[cuts.iter().sum()]);
    check_same(&format!("{at}, one advance or twelve"), &whole, &flown(&particles, &cuts));
    // Doubles of all bits whose sum is none: the order does not matter.
    let cuts: Vec<f64> = (0..12).map(|_| random.unit() * 10.0).collect();
    let forth = flown(&particles, &cuts);
    check_same(&format!("{at}, in another order"), &forth, &flown(&particles, &random.shuffled(&cuts)));
}

#[test]
fn exact_reads_the_same_however_a_duration_is_cut() {
    for seed in 1..=20 {
        check_splits::<f32>(seed);
        check_splits::<f64>(seed);
    }
}

/// Reads everything, and asks for things that are refused.
fn disturb<R: Real>(world: &mut World<R>, random: &mut Random) {
    let ids: Vec<ParticleId> = world.particles().map(|state| state.id).collect();
    for &id in &ids {
        assert_eq!(world.particle(id), Ok(world.particles_from(id).next().expect("it is there")));
        let damping = R::nearest(1.0 + random.unit()) + R::ONE;
        assert!(world.set_damping(id, damping).is_err());
        assert!(world.set_inverse_mass(id, R::nearest(-1.0)).is_err());
    }
    let far = [R::nearest(R::LARGEST); 3];
    let all = Selection::All;
    let impulse = Column::PerParticle(vec![far.into(); ids.len() + 1]);
    assert!(world.apply(&Command::Impulse { ids: all, impulse }).is_err());
    assert!(world.advance(f64::MAX).is_err());
    world.plan(&Advance::by(random.unit() + 0.1)).expect("a valid duration");
}

/// Two worlds get the same commands; one is read and bothered all the time.
#[track_caller]
fn check_reads<R: Real>(integrator: Integrator, seeds: &[u64]) {
    let first: Vec<Particle<R>> = (0..4).map(|seed| Random(seed).particle()).collect();
    let [mut silent, mut disturbed] = [world(integrator, &first), world(integrator, &first)];
    let mut ids: Vec<ParticleId> = (0..4).map(ParticleId).collect();
    for &seed in seeds {
        let random = &mut Random(seed);
        let command = match random.below(4) {
            0 | 1 => Command::Advance(Advance { steps: Some(1 + seed % 3), ..Advance::by(random.unit() + 0.01) }),
            2 if random.below(4) == 0 => Command::Configure(Configure {
                gravity: Some(random.vector(10.0).into()),
                integrator: (random.below(2) == 0).then(|| random.one_of(&Integrator::ALL)),
                ..Configure::default()
            }),
            _ => random.command(&mut ids),
        };
        disturb(&mut disturbed, random);
        let outcome = silent.apply(&command);
        assert_eq!(disturbed.apply(&command), outcome);
        assert!(outcome.is_ok() || outcome.is_err_and(|error| is_refusal_of_integrator(&error)), "{outcome:?}");
        if let Ok(Outcome::Created { first, count }) = outcome {
            ids.extend((first.0..first.0 + count as u64).map(ParticleId));
        }
    }
    check_unchanged(&scene::<R>(&format!("seeds {seeds:?}"), integrator), &silent, &disturbed);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn reads_and_refusals_change_no_bit(seeds in prop::collection::vec(any::<u64>(), 1..40)) {
        for integrator in Integrator::ALL {
            check_reads::<f32>(integrator, &seeds);
            check_reads::<f64>(integrator, &seeds);
        }
    }
}

/// Four particles alone, and the same four in a crowd that is created, moved, pushed and removed. They begin in its
/// last rows, which take the places of those that are removed.
#[track_caller]
fn check_crowd<R: Real>(integrator: Integrator, seed: u64) {
    let random = &mut Random(seed);
    let particles: Vec<Particle<R>> = (0..9).map(|_| random.particle()).collect();
    let mut alone = world(integrator, &particles[5..]);
    let mut crowded = world(integrator, &particles);
    let mut others: Vec<ParticleId> = (0..5).map(ParticleId).collect();
    let at = scene::<R>(&format!("crowd {seed}"), integrator);
    for round in 0..30 {
        let outcome = crowded.apply(&random.command(&mut others));
        assert!(outcome.is_ok() || outcome.is_err_and(|error| is_refusal_of_integrator(&error)), "{outcome:?}");
        if let Ok(Outcome::Created { first, count }) = outcome {
            others.extend((first.0..first.0 + count as u64).map(ParticleId));
        }
        let (duration, force, id) = (random.unit() + 0.01, random.vector::<R>(40.0).into(), round % 4);
        for (world, first) in [(&mut alone, 0), (&mut crowded, 5)] {
            if round % 3 == 0 {
                world.add_force(ParticleId(first + id), force).expect("small numbers");
            }
            world.advance(in_steps(integrator, 1 + round % 3, duration)).expect("small numbers");
        }
    }
    // One is read on its own and one after others, with which it shares what the closed form has computed.
    for alone in alone.particles() {
        check_state(&at, &state(&crowded, alone.id.0 + 5), &alone);
    }
}

#[test]
fn what_happens_to_other_particles_changes_no_bit() {
    for integrator in alone() {
        for seed in 1..=10 {
            check_crowd::<f32>(integrator, seed);
            check_crowd::<f64>(integrator, seed);
        }
    }
}

const EVERY: Selection = Selection::All;

/// After a rebase a particle is the one that would be created there and then: at `later` the bits agree. Where the
/// command does not rebase, the bits are those of a world that never got it.
#[track_caller]
fn check_rebase<R: Real>(name: &str, rebases: bool, command: &Command<R>, own: bool) {
    let random = &mut Random(7);
    let acceleration = own.then(|| random.vector(9.0).into());
    let damping = R::nearest(0.9);
    let particles: Vec<Particle<R>> =
        (0..50).map(|_| Particle { acceleration, damping, mass: Mass::Inverse(R::ONE), ..random.particle() }).collect();
    let at = scene::<R>(name, Integrator::Exact);
    let mut untouched = world(Integrator::Exact, &particles);
    untouched.advance(0.7).expect("small numbers");
    let mut touched = untouched.clone();
    touched.apply(command).expect("a valid command");
    let mut anew = world(Integrator::Exact, &[]);
    anew.advance(0.7).expect("an empty world");
    let state = |s: ParticleState<R>| Particle {
        position: s.position,
        velocity: s.velocity,
        acceleration,
        damping,
        ..Particle::default()
    };
    anew.apply(&Command::Create(untouched.particles().map(state).collect())).expect("valid particles");
    check_same(&format!("{at}, at once"), &untouched, &touched);
    for world in [&mut untouched, &mut touched, &mut anew] {
        world.advance(1.1).expect("small numbers");
    }
    let (expected, other) = if rebases { (&anew, &untouched) } else { (&untouched, &anew) };
    check_same(&at, expected, &touched);
    assert!(touched.particles().ne(other.particles()), "{at}: the two cannot be told apart, so this shows nothing");
}

#[test]
fn exact_rebases_when_it_must_and_only_then() {
    fn each_precision<R: Real>() {
        let gravity = *world::<R>(Integrator::Exact, &[]).settings();
        let set = |acceleration, damping, mass| set(EVERY, acceleration, damping, mass);
        let uniform = |x: f64| Some(Column::Uniform(R::nearest(x)));
        let none = Some(Column::Uniform(None));
        let zero = Column::Uniform(R::Vec3::default());
        let configure = |change: Configure<R>| Command::Configure(change);
        let gravity = configure(Configure { gravity: Some(gravity.gravity), ..Default::default() });
        let integrator = configure(Configure { integrator: Some(Integrator::Exact), ..Default::default() });
        let max_step = configure(Configure { max_step: Some(Some(0.1)), ..Default::default() });
        let law = configure(Configure { damping_law: Some(DampingLaw::PerSecond), ..Default::default() });
        let rows = [
            ("an equal acceleration", true, set(none, None, None), false),
            ("an equal damping", true, set(None, uniform(0.9), None), false),
            ("an equal mass", true, set(None, None, Some(Column::Uniform(Mass::Mass(R::ONE)))), false),
            ("an impulse of nothing", true, Command::Impulse { ids: EVERY, impulse: zero.clone() }, false),
            ("equal gravity", true, gravity.clone(), false),
            ("equal gravity, not followed", false, gravity, true),
            ("an equal integrator", true, integrator, true),
            ("a longest step", false, max_step, false),
            ("an equal damping law", false, law, false),
            ("a force of nothing", false, Command::AddForce { ids: EVERY, force: zero }, false),
            ("a creation", false, Command::Create(NewParticles::default()), false),
            ("no property at all", false, set(None, None, None), false),
        ];
        for (name, rebases, command, own) in rows {
            check_rebase(name, rebases, &command, own);
        }
    }
    each_precision::<f32>();
    each_precision::<f64>();
}

/// A force is an acceleration by w F for one advance, between two rebases. All of a + w F are exact here.
#[track_caller]
fn check_force_is_a_flow<R: Real>(damping: f64, own: Option<[f64; 3]>) {
    let at = scene::<R>(&format!("force, d = {damping}, own acceleration {own:?}"), Integrator::Exact);
    let vector = |x: [f64; 3]| -> R::Vec3 { x.map(R::nearest).into() };
    let particle = Particle {
        position: vector([0.1, -7.3, 1e4]),
        velocity: vector([3.3, 0.7, -11.1]),
        acceleration: own.map(vector),
        damping: R::nearest(damping),
        mass: Mass::Mass(R::nearest(8.0)),
        ..Particle::default()
    };
    let (mut forced, mut driven) = (world(Integrator::Exact, &[particle]), world(Integrator::Exact, &[particle]));
    let id = ParticleId(0);
    let base = own.unwrap_or([0.25, -9.75, 0.0]);
    let total = [base[0] + 20.0 / 8.0, base[1], base[2] - 3.0 / 8.0];
    forced.advance(0.3).expect("small numbers");
    driven.advance(0.3).expect("small numbers");
    forced.add_force(id, vector([20.0, 0.0, -3.0])).expect("a finite force");
    driven.set_acceleration(id, Some(vector(total))).expect("a finite acceleration");
    forced.advance(0.9).expect("small numbers");
    driven.advance(0.9).expect("small numbers");
    driven.set_acceleration(id, own.map(vector)).expect("a finite acceleration");
    check_same(&at, &driven, &forced);
    forced.advance(0.1).expect("small numbers");
    driven.advance(0.1).expect("small numbers");
    check_same(&format!("{at}, later"), &driven, &forced);
}

#[test]
fn a_force_is_the_flow_from_the_rebased_state() {
    for damping in [1.0, 0.9375, 0.5, 0.0] {
        for own in [None, Some([1.0, 2.0, -0.5]), Some([0.0; 3])] {
            check_force_is_a_flow::<f32>(damping, own);
            check_force_is_a_flow::<f64>(damping, own);
        }
    }
}

/// d = 1 is the parabola, every operation rounded once in double; d = 0 stops at once; at t = 0 the base is read.
#[track_caller]
fn check_extremes<R: Real>(seed: u64) {
    let random = &mut Random(seed);
    let particle =
        Particle { acceleration: Some(random.vector(9.0).into()), mass: Mass::Mass(R::ONE), ..random.particle() };
    let time = random.unit() * 100.0;
    let [p, v, a] = [particle.position, particle.velocity, particle.acceleration.expect("set above")]
        .map(|x| -> [f64; 3] { x.into().map(Into::into) });
    let parabola: [R; 3] = std::array::from_fn(|k| R::nearest(p[k] + (v[k] * time + a[k] * (time * time / 2.0))));
    let line: [R; 3] = std::array::from_fn(|k| R::nearest(v[k] + a[k] * time));
    let nothing: [R; 3] = std::array::from_fn(|k| R::nearest(v[k] * 0.0 + a[k] * 0.0));
    let rows = [(1.0, parabola, line), (0.0, particle.position.into(), nothing)];
    for (damping, position, velocity) in rows {
        let at = scene::<R>(&format!("d = {damping}, {time} s"), Integrator::Exact);
        let mut world = flown(&[Particle { damping: R::nearest(damping), ..particle }], &[]);
        check_bits(&at, ParticleId(0), "position at once", particle.position, state(&world, 0).position);
        check_bits(&at, ParticleId(0), "velocity at once", particle.velocity, state(&world, 0).velocity);
        world.advance(time).expect("small numbers");
        check_bits(&at, ParticleId(0), "position", position, state(&world, 0).position);
        check_bits(&at, ParticleId(0), "velocity", velocity, state(&world, 0).velocity);
    }
}

#[test]
fn exact_at_the_ends_of_damping_and_at_its_base() {
    for seed in 1..=50 {
        check_extremes::<f32>(seed);
        check_extremes::<f64>(seed);
    }
}

/// The double nearest to `units` · 2⁻⁵⁸, for whole numbers below 2⁸⁵: everything but the last sum is exact.
fn nearest_double(units: u128) -> f64 {
    let word = |x: u128| f64::from(u32::try_from(x).expect("32 bits"));
    let low = units % (1 << 53);
    let low = word(low >> 32) * 2f64.powi(32) + word(low % (1 << 32));
    (word(units >> 53) * 2f64.powi(53) + low) * 2f64.powi(-58)
}

/// A million advances by 1/60 s, against whole numbers. A particle that starts halfway and moves at 1 m/s shows the
/// second word of the clock: its position is the elapsed time.
#[track_caller]
fn check_clock<R: Real>(integrator: Integrator) {
    let at = scene::<R>("a million advances of 1/60 s", integrator);
    // 1/60 lies between 2⁻⁶ and 2⁻⁵: its last bit is 2⁻⁵⁸.
    let units = u128::from((1f64 / 60.0).to_bits() & ((1 << 52) - 1) | (1 << 52));
    let mut world = world::<R>(integrator, &[]);
    let particle = Particle {
        velocity: [R::ONE, R::ZERO, R::ZERO].into(),
        acceleration: Some(R::Vec3::default()),
        ..Particle::default()
    };
    for n in 1..=1_000_000 {
        let report = world.advance(1.0 / 60.0).expect("far from the end of time");
        let exact = nearest_double(units * n);
        assert!(report.time.to_bits() == exact.to_bits(), "{at}: the clock shows {}, not {exact}", report.time);
        if n == 499_999 && integrator == Integrator::Exact {
            world.create(particle).expect("a valid particle");
        }
    }
    assert_eq!(world.step_count(), 1_000_000, "{at}");
    if integrator == Integrator::Exact {
        let elapsed = R::nearest(nearest_double(units * 500_001));
        check_bits(&at, ParticleId(0), "position", [elapsed, R::ZERO, R::ZERO], state(&world, 0).position);
    }
}

#[test]
fn the_clock_is_the_exact_sum() {
    for integrator in [Integrator::Exact, Integrator::SemiImplicitEuler] {
        check_clock::<f32>(integrator);
        check_clock::<f64>(integrator);
    }
}

/// Without force, acceleration and damping no bit of a velocity changes, however small it is.
#[track_caller]
fn check_first_law<R: Real>(integrator: Integrator) {
    let random = &mut Random(3);
    let smallest = R::nearest(if R::PRECISION == Precision::Single { 2f64.powi(-149) } else { 5e-324 });
    let mut velocities: Vec<[R; 3]> = (0..50).map(|_| random.vector(1e3)).collect();
    velocities.push([smallest, R::ZERO - smallest, R::ZERO]);
    let particles: Vec<Particle<R>> = velocities
        .iter()
        .zip([R::ZERO, R::HALF].into_iter().cycle())
        .map(|(&v, w)| Particle {
            velocity: v.into(),
            acceleration: Some(R::Vec3::default()),
            mass: Mass::Inverse(w),
            ..random.particle()
        })
        .map(|particle| Particle { damping: R::ONE, ..particle })
        .collect();
    let mut world = world(integrator, &particles);
    for steps in [1, 1000] {
        world.advance(in_steps(integrator, steps, 33.3)).expect("small numbers");
    }
    let at = scene::<R>("first law", integrator);
    for (velocity, state) in velocities.into_iter().zip(world.particles()) {
        check_bits(&at, state.id, "velocity", velocity, state.velocity);
    }
}

#[test]
fn first_law() {
    for integrator in Integrator::ALL {
        check_first_law::<f32>(integrator);
        check_first_law::<f64>(integrator);
    }
}

/// A mass changes nothing about a fall. An immovable particle does not fall and no force moves it, but its own velocity
/// and acceleration act as they do on a movable one where there is no gravity and no force.
#[track_caller]
fn check_mass<R: Real>(integrator: Integrator, seed: u64) {
    let at = |what: &str| scene::<R>(&format!("{what}, seed {seed}"), integrator);
    let particle = Random(seed).particle::<R>();
    let heavy = [1.0, 1e-3, 7.0].map(|w| Particle { mass: Mass::Inverse(R::nearest(w)), ..particle });
    let mut falling = world(integrator, &heavy);
    let own = Some(particle.acceleration.unwrap_or_default());
    let mut carried = world(integrator, &[Particle { mass: Mass::Inverse(R::ONE), acceleration: own, ..particle }]);
    let still = Particle { velocity: R::Vec3::default(), acceleration: None, ..particle };
    let mut immovable = world(integrator, &[particle, still].map(|p| Particle { mass: Mass::IMMOVABLE, ..p }));
    for steps in [1, 5, 70] {
        immovable.apply(&Command::AddForce { ids: EVERY, force: Column::Uniform([R::ONE; 3].into()) }).expect("finite");
        immovable
            .apply(&Command::Impulse { ids: EVERY, impulse: Column::Uniform([R::ONE; 3].into()) })
            .expect("finite");
        // The impulse of nothing rebases the movable one as well.
        carried.apply(&Command::Impulse { ids: EVERY, impulse: Column::Uniform(R::Vec3::default()) }).expect("finite");
        check_bits(&at("force"), ParticleId(1), "force", [R::ONE; 3], state(&immovable, 1).force);
        for world in [&mut falling, &mut carried, &mut immovable] {
            world.advance(in_steps(integrator, steps, 0.8)).expect("small numbers");
        }
        for heavy in falling.particles() {
            check_bits(&at("fall"), heavy.id, "position", state(&falling, 0).position, heavy.position);
            check_bits(&at("fall"), heavy.id, "velocity", state(&falling, 0).velocity, heavy.velocity);
        }
        let (carried, platform) = (state(&carried, 0), state(&immovable, 0));
        check_bits(&at("platform"), platform.id, "position", carried.position, platform.position);
        check_bits(&at("platform"), platform.id, "velocity", carried.velocity, platform.velocity);
        check_bits(&at("immovable"), ParticleId(1), "position", still.position, state(&immovable, 1).position);
        check_bits(&at("immovable"), ParticleId(1), "velocity", still.velocity, state(&immovable, 1).velocity);
        for id in [0, 1] {
            check_bits(&at("force afterwards"), ParticleId(id), "force", [R::ZERO; 3], state(&immovable, id).force);
        }
    }
}

#[test]
fn gravity_forgets_the_mass_and_nothing_moves_the_immovable() {
    for integrator in alone() {
        for seed in 1..=20 {
            check_mass::<f32>(integrator, seed);
            check_mass::<f64>(integrator, seed);
        }
    }
}

/// m Δv = F T with d = 1 and no gravity, from rest, in one advance of n steps. Four numbers round once, by at most u of
/// their value (half an ulp of 1): w = 1/m, w F, h and A h. Of the n sums the first is exact: (n + 3) u together. The
/// two products of the check itself, in double, add at most 2 u.
#[track_caller]
fn check_momentum<R: Real>(integrator: Integrator, steps: u32) {
    let (mass, duration, force) = (3.0, 2.7, [12.5, -0.1, 1e-3].map(|x: f64| R::nearest(x)));
    let unit = if R::PRECISION == Precision::Single { 2f64.powi(-24) } else { 2f64.powi(-53) };
    let mut world = World::<R>::new(Settings { integrator, ..Settings::default() }).expect("valid settings");
    let id = world.create(Particle { mass: Mass::Mass(R::nearest(mass)), ..Particle::default() }).expect("valid");
    world.add_force(id, force.into()).expect("a finite force");
    world.advance(in_steps(integrator, steps.into(), duration)).expect("small numbers");
    // Weights of the stages, the largest of which cancel, round as well.
    let weights = if matches!(integrator, Integrator::Rk4 | Integrator::Dop853) { 24.0 } else { 0.0 };
    let velocity = state(&world, 0).velocity.into();
    for k in 0..3 {
        let given = force[k].into() * duration;
        let error = (velocity[k].into() * mass - given) / given;
        let bound = (f64::from(steps) + 5.0 + weights) * unit;
        let at = scene::<R>(&format!("momentum in {steps} steps"), integrator);
        assert!(error.abs() <= bound, "{at}: off by {error:e} of F T, not {bound:e}; velocity {}", show(velocity[k]));
    }
    check_bits("momentum", id, "force", [R::ZERO; 3], state(&world, 0).force);
}

#[test]
fn a_force_gives_the_same_momentum_in_any_number_of_steps() {
    for integrator in Integrator::ALL {
        for steps in [1, 2, 3, 10, 64, 100] {
            check_momentum::<f32>(integrator, steps);
            check_momentum::<f64>(integrator, steps);
        }
    }
}

/// v ← v + J w, each operation rounded once in the precision of the world.
#[track_caller]
fn check_impulse<R: Real>(integrator: Integrator, seed: u64) {
    let random = &mut Random(seed);
    let particle = random.particle::<R>();
    let mut world = world(integrator, &[particle]);
    world.advance(0.3).expect("small numbers");
    let before = state(&world, 0);
    let impulses: [[R; 3]; 2] = std::array::from_fn(|_| random.vector(9.0));
    let force = Column::PerParticle(impulses.map(Into::into).to_vec());
    // A particle that is named twice gets both, one after the other.
    let ids = Selection::Ids(vec![before.id; 2]);
    world.apply(&Command::Impulse { ids, impulse: force }).expect("small numbers");
    let w = before.inverse_mass;
    let [first, second] = impulses;
    let v = before.velocity.into();
    let expected: [R; 3] = std::array::from_fn(|k| (v[k] + first[k] * w) + second[k] * w);
    let at = scene::<R>(&format!("impulse, seed {seed}"), integrator);
    check_bits(&at, before.id, "velocity", expected, state(&world, 0).velocity);
    check_bits(&at, before.id, "position", before.position, state(&world, 0).position);
}

#[test]
fn an_impulse_changes_the_velocity_at_once() {
    for integrator in Integrator::ALL {
        for seed in 1..=20 {
            check_impulse::<f32>(integrator, seed);
            check_impulse::<f64>(integrator, seed);
        }
    }
}

/// Errors against `exact` after 1 s, with damping and a force. Order n divides them by 2ⁿ when the step is halved; 0.1
/// around n leaves no room for n ± 1. Single precision is measured where its rounding is below a hundredth of the
/// error. `exact` has no order: the steps that are asked for change no bit of it, as the cut durations above show.
#[track_caller]
fn check_order<R: Real>(integrator: Integrator) {
    let Some(order) = integrator.order() else { return };
    let first = match (R::PRECISION, order) {
        (Precision::Single, 1) => 8,
        (Precision::Double, 1) => 64,
        (Precision::Double, 4) => 4,
        // Nothing here depends on position: `velocity_verlet` has no error, and `dop853` chooses its steps.
        (Precision::Single | Precision::Double, _) => return,
    };
    let vector = |x: [f64; 3]| -> R::Vec3 { x.map(R::nearest).into() };
    let particle = Particle { velocity: vector([30.0, 40.0, 5.0]), damping: R::nearest(0.9), ..Particle::default() };
    let after = |integrator, steps| -> [[f64; 3]; 2] {
        let mut world = world(integrator, &[particle]);
        world.add_force(ParticleId(0), vector([1.0, 4.0, -3.0])).expect("a finite force");
        world.advance(Advance { steps: Some(steps), ..Advance::by(1.0) }).expect("small numbers");
        [state(&world, 0).position, state(&world, 0).velocity].map(|x| x.into().map(Into::into))
    };
    let exact = after(Integrator::Exact, 1);
    let [coarse, fine] = [first, 2 * first].map(|steps| after(integrator, steps));
    for (quantity, k) in [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)] {
        let [coarse, fine] = [coarse, fine].map(|at| (at[quantity][k] - exact[quantity][k]).abs());
        let measured = (coarse / fine).log2();
        let at = scene::<R>(&format!("{}[{k}], errors {coarse:e}, {fine:e}", ["p", "v"][quantity]), integrator);
        assert!((measured - f64::from(order)).abs() < 0.1, "{at}: order {measured}, not {order}");
    }
}

#[test]
fn orders_of_convergence() {
    for integrator in Integrator::ALL {
        check_order::<f32>(integrator);
        check_order::<f64>(integrator);
    }
}

/// The book's code ends at a terminal velocity that is off by x/(eˣ - 1) - 1 of a/k, x = k h, k = -ln d: -0.58 % here.
/// Its equation v d + a h would end at x/(1 - e⁻ˣ) - 1, as much too fast. D is off by half an ulp, which D/(1 - D) = 86
/// enlarges; the roundings of the steps, which fade with the ratio D, gather as much again.
#[test]
fn the_bias_of_the_book_at_terminal_velocity() {
    let particle = Particle { damping: 0.5, ..Particle::default() };
    let mut world = world::<f64>(Integrator::NewtonEuler, &[particle]);
    world.advance(Advance { steps: Some(6000), ..Advance::by(100.0) }).expect("small numbers");
    let (k, x) = (std::f64::consts::LN_2, std::f64::consts::LN_2 / 60.0);
    let bias = state(&world, 0).velocity.y / (-9.75 / k) - 1.0;
    let formula = x / x.exp_m1() - 1.0;
    assert!((bias - formula).abs() < 4.0 * 86.0 * f64::EPSILON, "{bias:e}, not {formula:e}");
    assert!((bias + 0.0058).abs() < 5e-5, "{bias:e} is not -0.58 %");
}

/// The steps of an advance; `exact` checks what was asked and takes one step.
#[track_caller]
fn check_steps(of_world: Option<f64>, advance: Advance, steps: u64) {
    for integrator in Integrator::ALL.into_iter().filter(|integrator| *integrator != Integrator::Dop853) {
        let settings = Settings { integrator, max_step: of_world, ..Settings::default() };
        let mut world = World::<f64>::new(settings).expect("valid settings");
        let plan = world.plan(&advance).expect("a valid advance");
        let steps = if integrator == Integrator::Exact { 1 } else { steps };
        let lengths = f64::from(u32::try_from(steps).expect("few steps"));
        let expected = (advance.duration, steps, advance.duration / lengths);
        assert_eq!((plan.duration, plan.steps, plan.step), expected, "{advance:?}, {of_world:?}, {integrator}");
        let report = world.advance(advance).expect("an empty world");
        assert_eq!((report.duration, report.steps, report.step), expected, "{advance:?}, {of_world:?}, {integrator}");
    }
}

#[test]
fn steps_of_an_advance() {
    let max_step = |duration, max_step| Advance { max_step: Some(max_step), ..Advance::by(duration) };
    let rows = [
        (None, Advance::by(7.0), 1),
        (None, Advance { steps: Some(3), ..Advance::by(7.0) }, 3),
        (Some(0.5), Advance::by(7.0), 14),
        (Some(0.5), Advance { steps: Some(3), ..Advance::by(7.0) }, 3),
        (Some(0.5), max_step(7.0, 2.0), 4),
        (None, max_step(1.0, 0.3), 4),
        (None, max_step(1e-3, 1.0), 1),
        (None, max_step(0.5, 1.0), 1),
        (None, max_step(1.0, 0.1), 10),
        // 0.3 / 0.1 is 2.9999999999999996 and 0.7 / 0.1 is 6.999999999999999 in doubles.
        (None, max_step(0.3, 0.1), 3),
        (None, max_step(0.7, 0.1), 7),
        // A billionth of the whole number, on either side of the limit.
        (None, max_step(1.0 + 0.9e-9, 1.0), 1),
        (None, max_step(1.0 + 1.1e-9, 1.0), 2),
        (None, max_step(3.0 + 2.9e-9, 1.0), 3),
        (None, max_step(3.0 + 3.1e-9, 1.0), 4),
        (None, max_step(1000.0 + 0.9e-6, 1.0), 1000),
        (None, max_step(1000.0 + 1.1e-6, 1.0), 1001),
        (None, max_step(2.5, 1.0), 3),
    ];
    for (of_world, advance, steps) in rows {
        check_steps(of_world, advance, steps);
    }
}

/// What an advance of five particles reports: two that rest, one that is carried along, two that fall, one of them with
/// a force.
#[track_caller]
fn check_report<R: Real>(integrator: Integrator) {
    let rest: Particle<R> =
        Particle { mass: Mass::IMMOVABLE, acceleration: Some(R::Vec3::default()), ..Particle::default() };
    let carried = Particle { velocity: [R::ONE; 3].into(), acceleration: None, ..rest };
    let falls = Particle::default();
    let mut world = world(integrator, &[rest, carried, falls, falls, Particle { acceleration: None, ..rest }]);
    let exact = integrator == Integrator::Exact;
    for (round, (time, forced)) in [(0.5, true), (1.0, false)].into_iter().enumerate() {
        for id in if forced { 0..4 } else { 0..0 } {
            // A force on an immovable particle or one that is zero moves nothing.
            let force = if id == 2 { R::Vec3::default() } else { [R::ONE; 3].into() };
            world.add_force(ParticleId(id), force).expect("a finite force");
        }
        let report = world.advance(Advance { steps: Some(4), ..Advance::by(0.5) }).expect("small numbers");
        let steps = if exact { 1 } else { 4 };
        let integrated = if exact { usize::from(forced) } else { 3 };
        let expected = Advanced {
            time,
            duration: 0.5,
            steps,
            step: if exact { 0.5 } else { 0.125 },
            step_count: steps * (round as u64 + 1),
            integrated,
            deferred: 3 - integrated,
            skipped: 2,
            inspected: report.inspected,
            rejected_steps: 0,
            evaluations: report.evaluations,
            error: None,
            crossed: None,
            // tests/it/skips.rs has these.
            accelerations: report.accelerations,
            dampings: report.dampings,
        };
        assert_eq!(report, expected, "{}", scene::<R>("report", integrator));
        assert_eq!((world.time(), world.step_count()), (report.time, report.step_count));
    }
    assert_eq!(world.revision(), 7, "{}: a creation, four forces, two advances", scene::<R>("report", integrator));
}

#[test]
fn report_of_an_advance() {
    for integrator in alone() {
        check_report::<f32>(integrator);
        check_report::<f64>(integrator);
    }
}

/// Numbers beyond the largest one: which particle is named, with which number, at which step. Position, velocity and
/// acceleration are shares of the largest number. Ids 0 to 2 are removed: id 5 lies in the first row, id 3 in the last.
#[track_caller]
fn check_divergence<R: Real>(
    integrator: Integrator,
    (name, share, steps): (&str, [f64; 3], u32),
    (quantity, step): (Quantity, u64),
) {
    let at = scene::<R>(name, integrator);
    let along_y = |share: f64| -> R::Vec3 { [R::ZERO, R::nearest(share * R::LARGEST), R::ZERO].into() };
    let [position, velocity, acceleration] = share.map(along_y);
    let calm: Particle<R> = Particle { velocity: [R::ONE; 3].into(), ..Particle::default() };
    let wild = Particle { position, velocity, acceleration: Some(acceleration), ..Particle::default() };
    // Particle 5 is beyond at the first step already; particle 3 has the smaller id.
    let far = along_y(0.9);
    let wilder = Particle { position: far, velocity: far, ..wild };
    let mut world = world(integrator, &[calm, calm, calm, wild, calm, wilder]);
    world.apply(&Command::Remove { ids: Selection::Ids([0, 1, 2].map(ParticleId).to_vec()) }).expect("they exist");
    world.add_force(ParticleId(4), [R::ONE; 3].into()).expect("a finite force");
    let mut before = world.clone();
    let advance = Advance { steps: Some(steps.into()), ..Advance::by(steps.into()) };
    let error = Error::Diverged { particle: ParticleId(3), quantity, step };
    assert_eq!(world.advance(advance), Err(error), "{at}");
    check_unchanged(&at, &before, &world);
    for world in [&mut world, &mut before] {
        world.remove(ParticleId(3)).expect("it exists");
        let other = world.advance(advance).expect_err("particle 5 is still there");
        assert!(matches!(other, Error::Diverged { particle: ParticleId(5), .. }), "{at}: {other}");
        world.remove(ParticleId(5)).expect("it exists");
        world.advance(advance).expect("the calm particle goes on");
    }
}

#[test]
fn divergence_names_the_smallest_id_and_changes_nothing() {
    for integrator in alone() {
        let exact = integrator == Integrator::Exact;
        let kicked_first = integrator == Integrator::SemiImplicitEuler;
        // Under `exact` everything happens in its one step, at the new clock.
        let nth = |n| if exact { 1 } else { n };
        let speed = if kicked_first { Quantity::Position } else { Quantity::Velocity };
        let rows = [
            (("position at step 2", [0.0, 0.6, 0.0], 3), (Quantity::Position, nth(2))),
            (("position at step 70", [0.0, 1.0 / 69.5, 0.0], 100), (Quantity::Position, nth(70))),
            (("velocity before position", [0.0, 0.6, 0.6], 1), (speed, 1)),
            (("both at once", [0.9, 0.6, 0.6], 1), (Quantity::Position, 1)),
        ];
        for (scene, error) in rows {
            check_divergence::<f32>(integrator, scene, error);
            check_divergence::<f64>(integrator, scene, error);
        }
    }
}

/// Bounds on the magnitudes only say whether to look: what stays finite is not refused.
#[test]
fn what_stays_finite_is_not_refused() {
    let still = Particle { position: [0.9 * f64::MAX; 3].into(), ..Particle::default() };
    let damped = Particle { acceleration: Some([1e280; 3].into()), damping: 0.5, ..Particle::default() };
    // Undamped, the position would be a t²/2 = 5e311 after 1e16 s; with damping it is a t / ln 2.
    for (particle, duration) in [(still, 1e9), (damped, 1e16)] {
        let mut world = World::<f64>::default();
        world.create(particle).expect("finite values");
        world.advance(duration).expect("finite at the new clock");
        assert!(state(&world, 0).position.is_finite());
    }
}

/// However a particle came by its large numbers, its third advance of 8 s is the one that is refused.
#[track_caller]
fn check_overflow_is_seen<R: Real>(name: &str, command: &Command<R>) {
    let at = scene::<R>(name, Integrator::Exact);
    let mut world = world(Integrator::Exact, &[Particle::<R>::default()]);
    world.apply(command).expect("finite numbers");
    for _ in 0..2 {
        world.advance(8.0).expect("finite at the new clock");
    }
    let before = world.clone();
    let error = world.advance(8.0).expect_err("beyond the largest number");
    assert!(matches!(error, Error::Diverged { quantity: Quantity::Position, step: 1, .. }), "{at}: {error}");
    check_unchanged(&at, &before, &world);
}

#[test]
fn exact_sees_every_overflow() {
    fn each_precision<R: Real>() {
        let along_x = |share: f64| -> R::Vec3 { [R::nearest(share * R::LARGEST), R::ZERO, R::ZERO].into() };
        let column = |share| Some(Column::Uniform(along_x(share)));
        let place = |position, velocity| Command::Place { ids: EVERY, position, velocity };
        let acceleration = Some(Column::Uniform(Some(along_x(1.0 / 200.0))));
        let gravity = Some(along_x(1.0 / 200.0));
        let rows = [
            ("created", Command::Create(Particle { velocity: along_x(1.0 / 20.0), ..Particle::default() }.into())),
            ("far away", place(column(0.9), column(1.0 / 200.0))),
            ("fast", place(None, column(1.0 / 20.0))),
            ("hit", Command::Impulse { ids: EVERY, impulse: Column::Uniform(along_x(1.0 / 20.0)) }),
            ("pushed", Command::AddForce { ids: EVERY, force: Column::Uniform(along_x(1.0 / 150.0)) }),
            ("accelerated", set(EVERY, acceleration, None, None)),
            ("falling", Command::Configure(Configure { gravity, ..Configure::default() })),
        ];
        for (name, command) in rows {
            check_overflow_is_seen::<R>(name, &command);
        }
    }
    each_precision::<f32>();
    each_precision::<f64>();
}

/// Every refusal leaves the world as it was.
#[track_caller]
fn check_refused<R: Real>(world: &World<R>, command: &Command<R>, error: Error) {
    let at = scene::<R>(&format!("{command:?}"), world.settings().integrator);
    let mut after = world.clone();
    assert_eq!(after.apply(command), Err(error), "{at}");
    check_unchanged(&at, world, &after);
}

#[track_caller]
fn check_refusals<R: Real>(integrator: Integrator) {
    let limits = Limits { particles: 5, steps: 1000, particle_steps: 2000, ..Limits::default() };
    let settings = Settings { integrator, ..Settings::default() };
    let mut world = World::<R>::with_limits(settings, limits).expect("valid settings");
    let random = &mut Random(5);
    world.apply(&Command::Create((0..4).map(|_| random.particle()).collect())).expect("valid particles");
    world.remove(ParticleId(0)).expect("it exists");
    let unit_mass = Some(Column::Uniform(Mass::Inverse(R::ONE)));
    world.apply(&set(EVERY, None, None, unit_mass)).expect("valid masses");
    world.add_force(ParticleId(2), random.vector(9.0).into()).expect("a finite force");
    world.advance(1.25).expect("small numbers");
    world.add_force(ParticleId(2), random.vector(9.0).into()).expect("a finite force");

    let (number, good, infinity) = (R::nearest, R::Vec3::default(), f64::INFINITY);
    let bad: R::Vec3 = [R::ZERO, number(f64::NAN), R::ZERO].into();
    let far: R::Vec3 = [R::ZERO, number(-0.8 * R::LARGEST), R::ZERO].into();
    let ids = |ids: &[u64]| Selection::Ids(ids.iter().copied().map(ParticleId).collect());
    let second = |bad| Column::PerParticle(vec![good, bad, good]);
    let moved = |position, velocity| Command::Place { ids: EVERY, position, velocity };
    let set = |acceleration, damping, mass| set(EVERY, acceleration, damping, mass);
    let damping = |d| set(None, Some(Column::PerParticle(vec![R::HALF, R::HALF, number(d)])), None);
    let mass = |m| set(Some(Column::Uniform(None)), None, Some(Column::Uniform(Mass::Mass(number(m)))));
    let inverse_mass = |w| set(None, None, Some(Column::Uniform(Mass::Inverse(number(w)))));
    let force = |ids, force| Command::AddForce { ids, force };
    let impulse = |ids, impulse| Command::Impulse { ids, impulse };
    let remove = |list| Command::Remove { ids: ids(list) };
    let advance = |duration, steps, max_step| Command::Advance(Advance { steps, max_step, ..Advance::by(duration) });
    let gravity = |gravity, max_step| Command::Configure(Configure { gravity, max_step, ..Default::default() });
    let new = |count| Command::Create(NewParticles { count, ..Default::default() });
    let laws = (Some(Integrator::Exact), Some(DampingLaw::PerStep));
    let per_step = Configure { integrator: laws.0, damping_law: laws.1, gravity: Some(far), ..Configure::default() };
    // The first push is fine, and must be taken back with the second.
    let (twice, pushes) = (ids(&[2, 2, 3]), Column::PerParticle(vec![far, far, good]));

    let at = |field, index| Place { field, index };
    let not_finite = |field, index| Error::NotFinite(at(field, index));
    let overflow = |quantity, field| Error::Overflow { particle: ParticleId(2), quantity, place: at(field, Some(1)) };
    let limit = |limit, allowed, asked| Error::LimitReached { limit, allowed, asked };
    let mut rows = vec![
        (moved(Some(second(bad)), None), not_finite(Field::Position, Some(1))),
        (moved(Some(second(good)), Some(second(bad))), not_finite(Field::Velocity, Some(1))),
        (moved(None, None), Error::NothingToPlace),
        (set(Some(Column::Uniform(Some(bad))), None, None), not_finite(Field::Acceleration, None)),
        (damping(infinity), not_finite(Field::Damping, Some(2))),
        (damping(1.5), Error::DampingOutOfRange(at(Field::Damping, Some(2)))),
        (damping(-0.5), Error::DampingOutOfRange(at(Field::Damping, Some(2)))),
        (mass(infinity), not_finite(Field::Mass, None)),
        (mass(0.0), Error::MassNotPositive(at(Field::Mass, None))),
        (mass(-1.0), Error::MassNotPositive(at(Field::Mass, None))),
        (mass(0.25 / R::LARGEST), Error::MassTooSmall(at(Field::Mass, None))),
        (inverse_mass(infinity), not_finite(Field::InverseMass, None)),
        (inverse_mass(-1.0), Error::InverseMassNegative(at(Field::InverseMass, None))),
        (force(EVERY, second(bad)), not_finite(Field::Force, Some(1))),
        (force(twice.clone(), pushes.clone()), overflow(Quantity::Force, Field::Force)),
        (force(ids(&[2, 0]), second(good)), Error::UnknownParticle { id: ParticleId(0), index: 1 }),
        (force(ids(&[2, 1]), second(good)), Error::LengthMismatch { field: Field::Force, len: 3, expected: 2 }),
        (impulse(EVERY, second(bad)), not_finite(Field::Impulse, Some(1))),
        (impulse(twice, pushes), overflow(Quantity::Velocity, Field::Impulse)),
        (remove(&[3, 1, 9]), Error::UnknownParticle { id: ParticleId(9), index: 2 }),
        (remove(&[3, 1, 3]), Error::RemovedTwice { id: ParticleId(3), index: 2 }),
        (advance(f64::NAN, None, None), not_finite(Field::Duration, None)),
        (advance(0.0, None, None), Error::DurationNotPositive),
        (advance(-1.0, None, None), Error::DurationNotPositive),
        (advance(1.0, Some(0), None), Error::StepsNotPositive),
        (advance(1.0, Some(1), Some(1.0)), Error::StepsAndMaxStep),
        (advance(1.0, None, Some(0.0)), Error::MaxStepNotPositive),
        (advance(1.0, None, Some(infinity)), not_finite(Field::MaxStep, None)),
        (advance(1.0, Some(1001), None), limit(Limit::Steps, 1000, 1001)),
        (gravity(Some(bad), Some(None)), not_finite(Field::Gravity, None)),
        (gravity(Some(far), Some(Some(-1.0))), Error::MaxStepNotPositive),
        (gravity(None, Some(Some(f64::NAN))), not_finite(Field::MaxStep, None)),
        (new(3), limit(Limit::Particles, 5, 6)),
        (new(usize::MAX), limit(Limit::Particles, 5, u64::MAX)),
        (
            Command::Configure(per_step),
            Error::IntegratorCannotServeDamping { integrator: Integrator::Exact, damping_law: DampingLaw::PerStep },
        ),
    ];
    let stepped = integrator != Integrator::Exact;
    if stepped {
        rows.push((advance(1.0, Some(667), None), limit(Limit::ParticleSteps, 2000, 2001)));
    }
    // A single world refuses a step beyond its largest number before it looks at the clock.
    let infinite_step = stepped && R::PRECISION == Precision::Single;
    let end = if infinite_step { not_finite(Field::Duration, None) } else { Error::ClockOutOfRange };
    rows.push((advance(2f64.powi(401), None, None), end));
    for (command, error) in rows {
        check_refused(&world, &command, error);
    }
}

/// The longer position update takes the square of a step, which is not finite long before a step is not.
#[test]
fn the_square_of_a_step_is_finite_or_refused() {
    let settings = Settings { integrator: Integrator::NewtonEulerQuadratic, ..Settings::default() };
    let mut world = World::<f32>::new(settings).expect("valid");
    world.create(Particle::default()).expect("valid");
    let error = Error::Diverged { particle: ParticleId(0), quantity: Quantity::Position, step: 1 };
    check_refused(&world, &Command::Advance(Advance::by(1.9e19)), error);
    world.advance(1e18).expect("its square is finite");
}

#[test]
fn refusals_change_nothing() {
    for integrator in alone() {
        check_refusals::<f32>(integrator);
        check_refusals::<f64>(integrator);
    }
}

/// Clocks up to 2⁴⁰⁰ s are reached, and not passed.
#[test]
fn the_end_of_time() {
    let end = 2f64.powi(400);
    let mut world = World::<f64>::default();
    world.advance(end).expect("the last second");
    assert_eq!(world.time().to_bits(), end.to_bits());
    check_refused(&world, &Command::Advance(Advance::by(end * f64::EPSILON)), Error::ClockOutOfRange);
    assert_eq!(World::<f64>::default().advance(end.next_up()), Err(Error::ClockOutOfRange));
}

/// The flag is up from the beginning, and there is enough to do for it to be looked at.
#[track_caller]
fn check_cancelled<R: Real>(integrator: Integrator, count: usize, steps: u64) {
    let at = scene::<R>("cancelled", integrator);
    let mut world = world::<R>(integrator, &[]);
    world.apply(&Command::Create(NewParticles { count, ..Default::default() })).expect("valid particles");
    world.apply(&Command::AddForce { ids: EVERY, force: Column::Uniform([R::ONE; 3].into()) }).expect("finite");
    let before = world.clone();
    let command = Command::Advance(in_steps(integrator, steps, 0.5));
    assert_eq!(world.apply_unless(&command, &AtomicBool::new(true)), Err(Error::Cancelled), "{at}");
    check_unchanged(&at, &before, &world);
}

#[test]
fn a_cancelled_advance_changes_nothing() {
    for integrator in Integrator::ALL {
        // Under `exact` only the number of particles is work.
        let (count, steps) = if integrator == Integrator::Exact { (1 << 18, 1) } else { (3, 1 << 40) };
        check_cancelled::<f32>(integrator, count, steps);
        check_cancelled::<f64>(integrator, count, steps);
    }
}

/// The velocity after some steps without a force, from one that is given in units of the rest threshold.
#[track_caller]
fn check_rest<R: Real>(integrator: Integrator, damping: f64, units: [f64; 3], steps: u32, expected: [f64; 3]) {
    let threshold = if R::PRECISION == Precision::Single { 2f64.powi(-100) } else { 2f64.powi(-960) };
    let vector = |units: [f64; 3]| units.map(|x| R::nearest(x * threshold)).into();
    let particle = Particle {
        position: [R::ONE; 3].into(),
        velocity: vector(units),
        acceleration: Some(R::Vec3::default()),
        damping: R::nearest(damping),
        ..Particle::default()
    };
    let mut world = world::<R>(integrator, &[particle]);
    let at = scene::<R>(&format!("rest of {units:?} with d = {damping} after {steps} s"), integrator);
    check_bits(&at, ParticleId(0), "velocity as given", particle.velocity, state(&world, 0).velocity);
    world.advance(Advance { steps: Some(steps.into()), ..Advance::by(steps.into()) }).expect("small numbers");
    check_bits::<R>(&at, ParticleId(0), "velocity", vector(expected), state(&world, 0).velocity);
    check_bits(&at, ParticleId(0), "position", [R::ONE; 3], state(&world, 0).position);
}

#[test]
fn damped_velocities_come_to_rest() {
    // Halving is exact: what is left is at the threshold, or just below it.
    let below = 1.0 - 1.0 / 16_777_216.0;
    let rows = [
        (0.5, [2.0, -2.0, 3.0], 1, [1.0, -1.0, 1.5]),
        (0.5, [2.0 * below, -2.0 * below, 0.0], 1, [0.0, -0.0, 0.0]),
        (0.5, [-128.0, 128.0 * below, -127.0], 7, [-1.0, 0.0, -0.0]),
        (0.5, [1.0, -1.0, 1e-3], 1, [0.0, -0.0, 0.0]),
        (1.0, [1.0, -1e-3, below], 70, [1.0, -1e-3, below]),
    ];
    // Those of Runge and Kutta do not halve exactly.
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_zero_damping()) {
        for (damping, units, steps, expected) in rows {
            check_rest::<f32>(integrator, damping, units, steps, expected);
            check_rest::<f64>(integrator, damping, units, steps, expected);
        }
    }
}

/// -0 is kept where it was given as a place or a velocity, also through an advance at rest, and is read as 0 elsewhere.
#[track_caller]
fn check_negative_zeros<R: Real>(integrator: Integrator) {
    let at = scene::<R>("negative zeros", integrator);
    let zero: [R; 3] = [R::nearest(-0.0), R::ZERO, R::nearest(-0.0)];
    let (minus, vector) = (zero[0], zero.into());
    let settings = Settings { integrator, gravity: vector, ..Settings::default() };
    let mut world = World::new(settings).expect("valid settings");
    let own = Particle {
        position: vector,
        velocity: vector,
        acceleration: Some(vector),
        damping: minus,
        mass: Mass::Inverse(minus),
        ..Particle::default()
    };
    let particles = [own, Particle { acceleration: None, ..own }, Particle::default()];
    world.apply(&Command::Create(particles.into_iter().collect())).expect("valid particles");
    world.add_force(ParticleId(0), vector).expect("a finite force");
    world.place(ParticleId(2), Some(vector), Some(vector)).expect("a valid place");
    world.set_damping(ParticleId(2), minus).expect("0 is a damping");
    world.set_inverse_mass(ParticleId(2), minus).expect("0 is an inverse mass");
    world.set_acceleration(ParticleId(2), Some(vector)).expect("a finite acceleration");
    check_bits(&at, ParticleId(0), "gravity", [R::ZERO; 3], world.settings().gravity);
    for moved in [false, true] {
        for state in world.particles() {
            check_bits(&at, state.id, "position", zero, state.position);
            check_bits(&at, state.id, "velocity", zero, state.velocity);
            check_bits(&at, state.id, "acceleration", [R::ZERO; 3], state.acceleration);
            check_bits(&at, state.id, "own acceleration", [R::ZERO; 3], state.own_acceleration.unwrap_or_default());
            check_bits(&at, state.id, "force", [R::ZERO; 3], state.force);
            let others = [state.damping, state.inverse_mass, R::ZERO];
            check_bits(&at, state.id, "(damping, inverse_mass)", [R::ZERO; 3], others);
        }
        if !moved {
            world.advance(Advance { steps: Some(65), ..Advance::by(1.5) }).expect("small numbers");
        }
    }
}

#[test]
fn negative_zeros() {
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves_zero_damping()) {
        check_negative_zeros::<f32>(integrator);
        check_negative_zeros::<f64>(integrator);
    }
}

/// Created in another order, at once or one by one, from columns of either shape, after others that were removed: the
/// same particles move to the same bits.
#[track_caller]
fn check_order_and_shape<R: Real>(integrator: Integrator, seed: u64) {
    let random = &mut Random(seed);
    let count = 20;
    let shared = random.particle::<R>();
    let shared = Particle { damping: served_damping(integrator, shared.damping), ..shared };
    let particles: Vec<Particle<R>> = (0..count)
        .map(|_| Particle { position: random.vector(9.0).into(), velocity: random.vector(9.0).into(), ..shared })
        .collect();
    let force = random.vector(5.0).into();
    let mixed: Vec<Particle<R>> =
        particles.iter().map(|p| Particle { position: p.position, ..random.particle() }).collect();
    let order = random.shuffled(&(0..count).collect::<Vec<usize>>());
    let advance = |world: &mut World<R>| {
        for steps in [3, 66] {
            world.apply(&Command::AddForce { ids: EVERY, force: Column::Uniform(force) }).expect("finite");
            world.advance(in_steps(integrator, steps, 0.9)).expect("small numbers");
        }
    };
    let at = |what: &str| scene::<R>(&format!("{what}, seed {seed}"), integrator);
    for particles in [&particles, &mixed] {
        let mut in_order = world(integrator, particles);
        advance(&mut in_order);
        let permuted: Vec<Particle<R>> = order.iter().map(|&i| particles[i]).collect();
        let mut permuted = world(integrator, &permuted);
        advance(&mut permuted);
        for (state, &i) in permuted.particles().zip(&order) {
            check_state(&at("permuted"), &self::state(&in_order, i as u64), &state);
        }
    }
    let mut uniform = world(integrator, &[]);
    let columns: NewParticles<R> = particles.iter().copied().collect();
    let new = NewParticles { position: columns.position, velocity: columns.velocity, count, ..shared.into() };
    uniform.apply(&Command::Create(new)).expect("valid particles");
    let mut one_by_one = world(integrator, &[]);
    for &particle in &particles {
        one_by_one.create(particle).expect("a valid particle");
    }
    let mut promoted = world(integrator, &particles);
    let set = |d, w| set(EVERY, None, Some(d), Some(w));
    let other =
        Column::PerParticle((0..count).map(|i| if i == 3 { R::HALF * R::HALF } else { shared.damping }).collect());
    promoted.apply(&set(other, Column::Uniform(Mass::Mass(R::HALF)))).expect("valid values");
    promoted
        .apply(&set(Column::Uniform(shared.damping), Column::PerParticle(vec![shared.mass; count])))
        .expect("valid");
    let mut per_particle = world(integrator, &particles);
    for world in [&mut uniform, &mut one_by_one, &mut promoted, &mut per_particle] {
        advance(world);
    }
    check_same(&at("uniform columns"), &per_particle, &uniform);
    check_same(&at("one by one"), &per_particle, &one_by_one);
    check_same(&at("set anew"), &per_particle, &promoted);
    if integrator == Integrator::Dop853 {
        return; // Its steps are common to all, so that one that is gone is missed.
    }

    let gone: Vec<ParticleId> = (0..count as u64).step_by(3).map(ParticleId).collect();
    let mut world = per_particle.clone();
    world.apply(&Command::Remove { ids: Selection::Ids(gone.clone()) }).expect("they exist");
    assert_eq!(world.create(shared), Ok(ParticleId(count as u64)), "{}", at("ids are not used again"));
    assert!(gone.iter().all(|&id| !world.contains(id)), "{}", at("removed"));
    advance(&mut world);
    advance(&mut per_particle);
    for state in world.particles().filter(|state| state.id.0 < count as u64) {
        check_state(&at("after a removal"), &self::state(&per_particle, state.id.0), &state);
    }
}

#[test]
fn order_and_shape_change_no_bit() {
    for integrator in Integrator::ALL {
        for seed in 1..=10 {
            check_order_and_shape::<f32>(integrator, seed);
            check_order_and_shape::<f64>(integrator, seed);
        }
    }
}

/// A number of any magnitude up to the largest, and often near it.
fn extreme<R: Real>(seed: u64) -> R {
    let largest = if R::PRECISION == Precision::Single { 38 } else { 308 };
    let magnitude = (0..seed / 2 % (largest + 1)).fold(1.0 + (seed % 5) as f64 / 8.0, |x, _| x * 10.0);
    R::nearest(if seed.is_multiple_of(2) { magnitude } else { -magnitude })
}

fn check_ends_finite<R: Real>(integrator: Integrator, seeds: &[u64]) {
    let mut random = Random(seeds[0]);
    let mut next = || -> R {
        let x = extreme::<R>(random.next());
        if Real::is_finite(x) { x } else { R::ONE }
    };
    let particles: Vec<Particle<R>> = (0..3)
        .map(|n| Particle {
            position: [next(), next(), next()].into(),
            velocity: [next(), next(), next()].into(),
            acceleration: (n > 0).then(|| [next(), next(), next()].into()),
            damping: if n == 2 { R::HALF } else { R::ONE },
            mass: Mass::Inverse(Real::abs(next())),
            ..Particle::default()
        })
        .collect();
    let gravity: R::Vec3 = [next(), next(), next()].into();
    let settings = Settings { integrator, gravity, ..Settings::default() };
    let limits = Limits { steps: 1000, ..Limits::default() };
    let mut world = World::<R>::with_limits(settings, limits).expect("every setting is finite");
    for particle in particles {
        world.create(particle).expect("finite numbers");
    }
    for &seed in seeds {
        let before = world.clone();
        let _refused = world.add_force(ParticleId(seed % 3), [extreme(seed >> 7), R::ZERO, R::ONE].into());
        let before = if world.revision() == before.revision() { before } else { world.clone() };
        let duration = f64::from_bits(0x3e00_0000_0000_0000 + (seed >> 6 & 0x02ff_ffff_ffff_ffff));
        let advance = in_steps(integrator, 1 + seed % 5, duration);
        let scene = scene::<R>(&format!("extremes {seed}, {duration:e} s"), integrator);
        match world.advance(advance) {
            Ok(_) => {
                for state in world.particles() {
                    let (p, v): ([R; 3], [R; 3]) = (state.position.into(), state.velocity.into());
                    let finite = p.iter().chain(&v).all(|x| Real::is_finite(*x));
                    assert!(finite, "{scene}: {state:?} after {before:?}");
                }
            }
            Err(_) => check_unchanged(&scene, &before, &world),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]
    /// Bounds that let a number overflow unseen would end in a state that is not finite.
    #[test]
    fn what_is_not_refused_ends_finite(seeds in prop::collection::vec(any::<u64>(), 2..6)) {
        for integrator in Integrator::ALL {
            check_ends_finite::<f32>(integrator, &seeds);
            check_ends_finite::<f64>(integrator, &seeds);
        }
    }
}

fn check_long<R: Real>(integrator: Integrator) {
    let mut random = Random(77);
    let mut particles: Vec<Particle<R>> = (0..300).map(|_| random.particle()).collect();
    // These come to rest on the way, from so near that the step at which they do shows in their position.
    let near_rest = if R::PRECISION == Precision::Single { 2f64.powi(-98) } else { 2f64.powi(-958) };
    for particle in particles.iter_mut().step_by(7) {
        let (damping, acceleration) = (R::HALF, Some(R::Vec3::default()));
        let velocity = [R::nearest(near_rest); 3].into();
        *particle = Particle { velocity, damping, acceleration, ..Particle::default() };
    }
    let long = Advance { steps: Some(60_001), ..Advance::by(3.0) };
    let mut together = world::<R>(integrator, &particles);
    together.advance(long).expect("finite");
    for (id, particle) in (0..).zip(&particles) {
        let mut alone = world::<R>(integrator, std::slice::from_ref(particle));
        alone.advance(long).expect("finite");
        let expected = ParticleState { id: ParticleId(id), ..state(&alone, 0) };
        check_state(&scene::<R>("a long advance", integrator), &expected, &state(&together, id));
    }
}

/// A long advance is cut into slices and works on a copy; a short one does neither. Both give the same bits.
#[test]
fn a_long_advance_gives_the_bits_of_short_ones() {
    for integrator in alone() {
        check_long::<f32>(integrator);
        check_long::<f64>(integrator);
    }
}
