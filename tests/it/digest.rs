//! The digest of a world: equal if and only if everything that determines its future is.

use pointmass::{
    Advance, Advanced, Column, Command, Configure, DampingLaw, Digest, Error, Integrator, Limits, Mass, NewParticles,
    Outcome, Particle, ParticleId, Properties, Real, Selection, Settings, Values, World,
};
use proptest::prelude::*;
use serde_json::json;

use crate::physics::{Random, set};
use crate::service::shared;

type Change<T> = (&'static str, fn(&mut T));

/// What is done to an empty world with default settings.
#[track_caller]
fn done<R: Real>(commands: &[Command<R>]) -> World<R> {
    let mut world = World::default();
    for command in commands {
        world.apply(command).expect("valid");
    }
    world
}

fn create<R: Real>(particle: Particle<R>) -> Command<R> {
    Command::Create(particle.into())
}

fn advance<R: Real>(duration: f64) -> Command<R> {
    Command::Advance(duration.into())
}

fn remove<R: Real>(id: u64) -> Command<R> {
    Command::Remove { ids: ParticleId(id).into() }
}

fn push<R: Real>(force: [f64; 3]) -> Command<R> {
    Command::AddForce { ids: ParticleId(0).into(), force: Column::Uniform(vector::<R>(force)) }
}

fn vector<R: Real>(v: [f64; 3]) -> R::Vec3 {
    v.map(R::nearest).into()
}

/// Every two differ in one thing that determines the future, or in several.
fn different<R: Real>() -> Vec<(&'static str, World<R>)> {
    let particles: [Change<Particle<R>>; 19] = [
        ("a particle", |_| {}),
        ("position x", |p| p.position = vector::<R>([9.0, 2.0, 0.0])),
        ("position y", |p| p.position = vector::<R>([1.0, 9.0, 0.0])),
        ("position z", |p| p.position = vector::<R>([1.0, 2.0, 9.0])),
        ("position -0", |p| p.position = vector::<R>([1.0, 2.0, -0.0])),
        ("velocity x", |p| p.velocity = vector::<R>([9.0, 5.0, 0.0])),
        ("velocity y", |p| p.velocity = vector::<R>([4.0, 9.0, 0.0])),
        ("velocity z", |p| p.velocity = vector::<R>([4.0, 5.0, 9.0])),
        ("velocity -0", |p| p.velocity = vector::<R>([4.0, 5.0, -0.0])),
        ("position and velocity exchanged", |p| (p.position, p.velocity) = (p.velocity, p.position)),
        ("own acceleration 0", |p| p.acceleration = Some(vector::<R>([0.0; 3]))),
        ("own acceleration x", |p| p.acceleration = Some(vector::<R>([7.0, 0.0, 0.0]))),
        ("own acceleration y", |p| p.acceleration = Some(vector::<R>([0.0, 7.0, 0.0]))),
        ("own acceleration z", |p| p.acceleration = Some(vector::<R>([0.0, 0.0, 7.0]))),
        ("damping", |p| p.damping = R::HALF),
        ("damping 0", |p| p.damping = R::ZERO),
        ("inverse mass", |p| p.mass = Mass::Inverse(R::HALF)),
        ("inverse mass 0", |p| p.mass = Mass::IMMOVABLE),
        ("mass", |p| p.mass = Mass::Mass(R::HALF)),
    ];
    let settings: [Change<Configure<R>>; 8] = [
        ("gravity x", |c| c.gravity = Some(vector::<R>([1.0, 0.0, 0.0]))),
        ("gravity y", |c| c.gravity = Some(vector::<R>([0.0, 1.0, 0.0]))),
        ("gravity z", |c| c.gravity = Some(vector::<R>([0.0, 0.0, 1.0]))),
        ("max_step", |c| c.max_step = Some(Some(0.5))),
        ("another max_step", |c| c.max_step = Some(Some(0.25))),
        ("newton_euler", |c| c.integrator = Some(Integrator::NewtonEuler)),
        ("newton_euler_quadratic", |c| c.integrator = Some(Integrator::NewtonEulerQuadratic)),
        ("semi_implicit_euler", |c| c.integrator = Some(Integrator::SemiImplicitEuler)),
    ];
    let plain = Particle {
        position: vector::<R>([1.0, 2.0, 0.0]),
        velocity: vector::<R>([4.0, 5.0, 0.0]),
        ..Particle::default()
    };
    let changed = particles.map(|(name, change)| {
        let mut particle = plain;
        change(&mut particle);
        (name, vec![create(particle)])
    });
    let configured = settings.map(|(name, change)| {
        let mut configure = Configure::default();
        change(&mut configure);
        (name, vec![create(plain), Command::Configure(configure)])
    });
    let stepped = |damping_law| {
        let integrator = Some(Integrator::NewtonEuler);
        Command::Configure(Configure { integrator, damping_law: Some(damping_law), ..Configure::default() })
    };
    let four = || Command::Create(NewParticles { count: 4, ..plain.into() });
    let tiny = 1e-30; // Lost in the upper word of a clock.
    let others = [
        ("nothing", vec![]),
        ("an id used", vec![create(plain), remove(0)]),
        ("an id used later", vec![create(plain), create(plain), remove(1)]),
        ("another of two left", vec![create(plain), create(plain), remove(0)]),
        ("two", vec![create(plain), create(plain)]),
        ("rows 3 2", vec![four(), remove(0), remove(1)]),
        ("rows 2 3", vec![four(), remove(1), remove(0)]),
        ("force x", vec![create(plain), push([1.0, 0.0, 0.0])]),
        ("force y", vec![create(plain), push([0.0, 1.0, 0.0])]),
        ("force z", vec![create(plain), push([0.0, 0.0, 1.0])]),
        ("per_step", vec![create(plain), stepped(DampingLaw::PerStep)]),
        ("base 0, clock 1", vec![create(plain), advance(1.0)]),
        ("base 0, clock 2", vec![create(plain), advance(2.0)]),
        ("base 1, clock 2", vec![advance(1.0), create(plain), advance(1.0)]),
        ("base 2, clock 2", vec![advance(2.0), create(plain)]),
        ("base 2, clock a little after 2", vec![advance(2.0), create(plain), advance(tiny)]),
        ("base and clock a little after 2", vec![advance(2.0), advance(tiny), create(plain)]),
        ("base 0, clock a little after 2", vec![create(plain), advance(2.0), advance(tiny)]),
    ];
    let scenes = changed.into_iter().chain(configured).chain(others);
    scenes.map(|(name, commands)| (name, done(&commands))).collect()
}

#[test]
fn differs_wherever_the_future_may() {
    let single = different::<f32>().into_iter().map(|(name, world)| (name, "single", world.digest()));
    let double = different::<f64>().into_iter().map(|(name, world)| (name, "double", world.digest()));
    let all: Vec<(&str, &str, Digest)> = single.chain(double).collect();
    for (n, one) in all.iter().enumerate() {
        for other in &all[..n] {
            assert_ne!(one.2, other.2, "{}, {} has the digest of {}, {}", one.0, one.1, other.0, other.1);
        }
    }
}

#[test]
fn does_not_tell_what_the_future_does_not_depend_on() {
    let particles: [Particle<f64>; 2] = [Particle::default(), Particle { damping: 0.5, ..Particle::default() }];
    let settings = Settings { max_step: Some(0.5), ..Settings::default() };
    let mut world = World::new(settings).expect("valid");
    world.apply(&Command::Create(particles.into_iter().collect())).expect("valid");
    world.advance(1.0).expect("finite");
    let limits = Limits { particles: 7, steps: 7, ..Limits::default() };
    let mut other = World::with_limits(settings, limits).expect("valid");
    for particle in particles {
        other.create(particle).expect("valid");
    }
    // The same clock after other steps; commands that change nothing; zeros of the other sign; refusals.
    other.advance(0.25).expect("finite");
    other.advance(Advance { steps: Some(3), ..Advance::by(0.75) }).expect("finite");
    let zero = Column::Uniform([-0.0; 3].into());
    other.apply(&Command::AddForce { ids: Selection::All, force: zero }).expect("finite");
    other.apply(&Command::Configure(Configure { max_step: Some(Some(0.5)), ..Configure::default() })).expect("valid");
    other.add_force(ParticleId(1), [1.0, 0.0, 0.0].into()).expect("finite");
    other.add_force(ParticleId(1), [-1.0, 0.0, 0.0].into()).expect("finite");
    assert!(other.advance(-1.0).is_err() && other.create(Particle { damping: 2.0, ..Particle::default() }).is_err());
    assert_ne!(world.revision(), other.revision());
    assert_eq!(world.digest(), other.digest());
}

/// The same command with one value for each particle wherever it has one for all.
fn per_particle<R: Real>(command: &Command<R>, world: &World<R>) -> Command<R> {
    fn each<T: Copy + PartialEq>(column: &Column<T>, n: usize) -> Column<T> {
        Column::PerParticle((0..n).map(|i| column.get(i)).collect())
    }
    let n = |ids: &Selection| match ids {
        Selection::All => world.particle_count(),
        Selection::Ids(ids) => ids.len(),
    };
    match command.clone() {
        Command::Create(new) => Command::Create(NewParticles {
            count: new.count,
            position: each(&new.position, new.count),
            velocity: each(&new.velocity, new.count),
            acceleration: each(&new.acceleration, new.count),
            damping: each(&new.damping, new.count),
            mass: each(&new.mass, new.count),
            drag: each(&new.drag, new.count),
            gravitational_mass: each(&new.gravitational_mass, new.count),
        }),
        Command::Place { ids, position, velocity } => Command::Place {
            position: position.map(|column| each(&column, n(&ids))),
            velocity: velocity.map(|column| each(&column, n(&ids))),
            ids,
        },
        Command::Set { ids, properties } => Command::Set {
            properties: Properties {
                acceleration: properties.acceleration.map(|column| each(&column, n(&ids))),
                damping: properties.damping.map(|column| each(&column, n(&ids))),
                mass: properties.mass.map(|column| each(&column, n(&ids))),
                drag: properties.drag.map(|column| each(&column, n(&ids))),
                gravitational_mass: properties.gravitational_mass.map(|column| each(&column, n(&ids))),
            },
            ids,
        },
        Command::AddForce { ids, force } => Command::AddForce { force: each(&force, n(&ids)), ids },
        Command::Impulse { ids, impulse } => Command::Impulse { impulse: each(&impulse, n(&ids)), ids },
        other @ (Command::Remove { .. } | Command::Advance(_) | Command::Configure(_)) => other,
    }
}

/// Any command at all; about some particles, all of them, or none.
fn any_command<R: Real>(random: &mut Random, ids: &mut Vec<ParticleId>) -> Command<R> {
    let one = random.particle::<R>();
    match random.below(8) {
        0 => Command::Create(NewParticles { count: random.below(4), ..one.into() }),
        1 => {
            let acceleration = (random.below(2) == 0).then_some(Column::Uniform(one.acceleration));
            let mass = (random.below(2) == 0).then_some(Column::Uniform(one.mass));
            set(Selection::All, acceleration, Some(Column::Uniform(one.damping)), mass)
        }
        2 => Command::Configure(Configure {
            gravity: random.one_of(&[None, Some(one.velocity)]),
            integrator: random.one_of(&Integrator::ALL.map(Some)),
            damping_law: random.one_of(&[None, Some(DampingLaw::PerSecond), Some(DampingLaw::PerStep)]),
            max_step: random.one_of(&[None, Some(None), Some(Some(0.125))]),
            ..Configure::default()
        }),
        3 | 4 => Command::Advance(Advance { steps: random.one_of(&[None, Some(70)]), ..Advance::by(random.unit()) }),
        _ => random.command(ids),
    }
}

/// How many values were held is all in which a report may tell one form from the other.
fn without_shape(outcome: Outcome) -> Outcome {
    match outcome {
        Outcome::Advanced(advanced) => {
            Outcome::Advanced(Advanced { accelerations: Values::None, dampings: Values::None, ..advanced })
        }
        Outcome::Created { .. } | Outcome::Changed { .. } | Outcome::Configured => outcome,
    }
}

/// And which entry of a list it is where there is none.
fn without_place(error: Error) -> Error {
    if let Error::IntegratorCannotServeZeroDamping { integrator, .. } = error {
        Error::IntegratorCannotServeZeroDamping { integrator, place: None }
    } else {
        error
    }
}

/// Three worlds with the same commands: one that is never read, one that is read all the time, and one in which every
/// value is given for each particle.
fn check_same_commands<R: Real>(seeds: &[u64]) -> Result<(), TestCaseError> {
    let [mut silent, mut read, mut each] = [(); 3].map(|()| World::<R>::default());
    for &seed in seeds {
        let random = &mut Random(seed);
        let mut ids: Vec<ParticleId> = read.particles().map(|state| state.id).collect();
        let command = any_command(random, &mut ids);
        let outcome = read.apply(&command);
        prop_assert_eq!(silent.apply(&command), outcome, "{:?}", command);
        let seen = each.apply(&per_particle(&command, &each)).map(without_shape).map_err(without_place);
        prop_assert_eq!(seen, outcome.map(without_shape).map_err(without_place), "{:?}", command);
        let states = read.particles().filter(|_| random.below(2) == 0).filter(|state| read.particle(state.id).is_ok());
        prop_assert!(states.count() <= read.particle_count());
        prop_assert_eq!(read.digest(), each.digest(), "for each particle, {:?}", command);
    }
    prop_assert_eq!(silent.digest(), read.digest(), "with reads");
    Ok(())
}

proptest! {
    #[test]
    fn the_same_commands_give_the_same_digest(seeds in prop::collection::vec(any::<u64>(), 1..40)) {
        check_same_commands::<f32>(&seeds)?;
        check_same_commands::<f64>(&seeds)?;
    }
}

#[test]
fn the_service_answers_with_the_digest_of_the_library() {
    let mut client = shared().client();
    // Answered at once, and in the compute pool.
    for count in [3, 5000] {
        let mut world = World::<f32>::default();
        let velocity = [1.0, -0.0, 0.1].into();
        let new = NewParticles { count, velocity: Column::Uniform(velocity), ..NewParticles::default() };
        world.apply(&Command::Create(new)).expect("valid");
        world.advance(0.1).expect("finite");
        let path = format!("/v1/worlds/digest-{count}");
        client.put(&path, "{\"precision\":\"single\"}").expect(201);
        let body = format!("{{\"count\":{count},\"velocity\":[1,-0.0,0.1]}}");
        client.post(&format!("{path}/particles"), &body).expect(201);
        client.post(&format!("{path}/advance"), "{\"duration\":0.1}").expect(200);
        let answer = client.get(&format!("{path}/digest")).expect(200);
        let expected = json!({"digest": world.digest().to_string(), "time": 0.1, "step_count": 1, "revision": 2});
        assert_eq!((answer.json(), answer.header("etag")), (expected, Some("\"2\"")));
    }
    client.get("/v1/worlds/digest-4/digest").expect(404);
}

/// However many particles there are, the answer is as short.
#[test]
fn a_large_world_has_a_digest_over_http() {
    let service = crate::service::shared();
    let mut client = service.client();
    client.put("/v1/worlds/large-digest", "").expect(201);
    client.post("/v1/worlds/large-digest/particles", r#"{"count":200000}"#).expect(201);
    client.get("/v1/worlds/large-digest/digest").expect(200);
    client.delete("/v1/worlds/large-digest").expect(204);
}
