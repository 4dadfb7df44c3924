//! What changed since a revision, against every state that there was.

use std::collections::{BTreeMap, BTreeSet};

use pointmass::{
    Advance, Column, Command, Configure, Drag, Gravitation, Integrator, Limits, Mass, Particle, ParticleId,
    ParticleState, Precision, Properties, Selection, Settings, World,
};
use proptest::prelude::*;

use crate::lockstep::Number;
use crate::physics::{Random, in_steps, scene};

/// A particle as it was read.
#[derive(Debug, Clone, PartialEq)]
struct Seen {
    bits: Vec<u64>,
    /// Whether an advance has something to do: a velocity, an acceleration, a force, or a zero that loses its sign.
    is_driven: bool,
    /// λ in 1/s.
    rate: f64,
}

/// A revision.
#[derive(Debug, Default, Clone)]
struct Past {
    time: f64,
    states: BTreeMap<ParticleId, Seen>,
    /// Particles that a command named, or whose gravity it changed.
    named: BTreeSet<ParticleId>,
    /// The integrators of its advances.
    advanced: Vec<Integrator>,
}

/// A world that is asked, one that never is, and all there ever was in it.
struct Model<R: Number> {
    random: Random,
    world: World<R>,
    twin: World<R>,
    past: Vec<Past>,
    /// The revisions at which it was asked.
    asked: Vec<u64>,
}

fn seen<R: Number>(state: &ParticleState<R>) -> Seen {
    let vector = |v: R::Vec3| Into::<[R; 3]>::into(v).map(R::bits);
    let [p, v, a, f] = [state.position, state.velocity, state.acceleration, state.force].map(vector);
    let own = state.own_acceleration.map(vector);
    let drag = state.drag.map(|Drag { k1, k2 }| [k1.bits(), k2.bits()]);
    let mut bits = [p, v, a, f, own.unwrap_or_default()].concat();
    bits.extend([u64::from(own.is_some()), state.damping.bits(), state.inverse_mass.bits(), u64::from(drag.is_some())]);
    bits.extend(drag.unwrap_or_default());
    bits.extend(state.gravitational_mass.map_or([0, 0], |mass| [1, mass.bits()]));
    let minus = R::nearest(-0.0).bits();
    let is_driven = [v, a, f].concat().iter().any(|x| *x != 0) || p.contains(&minus);
    let rate = -Into::<f64>::into(state.damping).ln();
    // What came to rest by its damping may still lose the sign of its zeros.
    let speed = v.map(|x| if x == minus && rate == 0.0 { 0 } else { x });
    let rests = state.inverse_mass == R::ZERO && [a, f, speed] == [[0; 3]; 3];
    Seen { bits, is_driven: is_driven && !rests, rate }
}

impl<R: Number> Model<R> {
    fn new(integrator: Integrator, seed: u64) -> Self {
        let limits = Limits { steps: 2000, ..Limits::default() };
        let world = World::<R>::with_limits(Settings { integrator, ..Settings::default() }, limits).expect("valid");
        let past = vec![Past::default()];
        Self { random: Random(seed), twin: world.clone(), world, past, asked: Vec::new() }
    }

    fn id(&mut self) -> ParticleId {
        let ids: Vec<ParticleId> = self.world.particles().map(|state| state.id).collect();
        if ids.is_empty() || self.random.below(30) == 0 {
            ParticleId(self.random.below(40) as u64)
        } else {
            self.random.one_of(&ids)
        }
    }

    fn ids(&mut self) -> Selection {
        match self.random.below(6) {
            0 => Selection::All,
            1 => Selection::Ids((0..self.random.below(4)).map(|_| self.id()).collect()),
            _ => self.id().into(),
        }
    }

    /// Mostly nothing.
    fn vector(&mut self) -> R::Vec3 {
        match self.random.below(6) {
            0 => [R::nearest(-0.0), R::ZERO, R::ZERO].into(),
            1 | 2 => self.random.vector(10.0).into(),
            _ => R::Vec3::default(),
        }
    }

    /// Some are so slow that they come to rest at once, and so near to the origin that they are still seen to move.
    fn particle(&mut self) -> Particle<R> {
        let (own, slow) = (self.random.below(3), self.random.below(6) == 0);
        let rest = if R::PRECISION == Precision::Single { 2f64.powi(-100) } else { 2f64.powi(-960) };
        Particle {
            position: self.random.vector(if slow { rest } else { 100.0 }).into(),
            velocity: if slow { self.random.vector(2.0 * rest).into() } else { self.vector() },
            acceleration: (own == 0).then(|| self.vector()),
            damping: self.damping(),
            mass: self.mass(),
            drag: (self.random.below(4) == 0).then_some(Drag { k1: R::HALF, k2: R::ZERO }),
            gravitational_mass: (self.random.below(4) == 0).then_some(R::ONE),
        }
    }

    /// With 10⁻³⁰ a velocity comes to rest within seconds.
    fn damping(&mut self) -> R {
        R::nearest(self.random.one_of(&[1.0, 1.0, 0.5, 1e-30, 0.0]))
    }

    fn mass(&mut self) -> Mass<R> {
        Mass::Inverse(R::nearest(self.random.one_of(&[0.0, 0.0, 1.0, 0.5])))
    }

    fn command(&mut self) -> Command<R> {
        match self.random.below(12) {
            0 | 1 => Command::Create((0..self.random.below(4)).map(|_| self.particle()).collect()),
            2 => {
                let (ids, what) = (self.ids(), self.random.below(3));
                // Also to where it is.
                let there = match &ids {
                    Selection::Ids(ids) if ids.len() == 1 => self.world.particle(ids[0]).ok(),
                    Selection::Ids(_) | Selection::All => None,
                };
                let position = there.map_or_else(|| self.vector(), |state| state.position);
                let velocity = self.vector();
                Command::Place {
                    ids,
                    position: (what < 2).then_some(Column::Uniform(position)),
                    velocity: (what > 0).then_some(Column::Uniform(velocity)),
                }
            }
            3 => {
                let none = Properties::default();
                let properties = match self.random.below(5) {
                    0 => Properties { damping: Some(Column::Uniform(self.damping())), ..none },
                    1 => Properties { mass: Some(Column::Uniform(self.mass())), ..none },
                    2 => Properties { drag: Some(Column::Uniform(None)), ..none },
                    3 => Properties { acceleration: Some(Column::Uniform(None)), ..none },
                    _ => Properties { acceleration: Some(Column::Uniform(Some(self.vector()))), ..none },
                };
                Command::Set { ids: self.ids(), properties }
            }
            4 => Command::AddForce { ids: self.ids(), force: Column::Uniform(self.vector()) },
            5 => Command::Impulse { ids: self.ids(), impulse: Column::Uniform(self.vector()) },
            6 if self.random.below(10) == 0 => Command::Remove { ids: Selection::All },
            6 => Command::Remove { ids: self.id().into() },
            7 => Command::Configure(self.configure()),
            8 if self.random.below(2) == 0 => Command::Advance(Advance::by(-1.0)),
            _ => {
                let duration = self.random.one_of(&[1.0 / 64.0, 0.5, 30.0]);
                Command::Advance(in_steps(self.world.settings().integrator, 1 + self.random.below(70) as u64, duration))
            }
        }
    }

    fn configure(&mut self) -> Configure<R> {
        let gravitation = Gravitation { constant: R::ONE, softening: R::ONE };
        let none = Configure::default();
        match self.random.below(6) {
            0 | 1 => Configure { integrator: Some(self.random.one_of(&Integrator::ALL)), ..none },
            2 => Configure { gravity: Some(self.world.settings().gravity), ..none },
            3 => Configure { gravity: Some(self.vector()), ..none },
            4 => Configure { gravitation: Some((self.random.below(2) == 0).then_some(gravitation)), ..none },
            _ => Configure {
                drag: Some((self.random.below(2) == 0).then_some(Drag { k1: R::ONE, k2: R::ZERO })),
                ..none
            },
        }
    }

    /// Notes whom a command is about to name, in a world as it is just before.
    fn note(past: &mut Past, world: &World<R>, command: &Command<R>) {
        let all = || world.particles();
        match command {
            Command::Place { ids, .. }
            | Command::Set { ids, .. }
            | Command::AddForce { ids, .. }
            | Command::Impulse { ids, .. } => match ids {
                Selection::All => past.named.extend(all().map(|state| state.id)),
                Selection::Ids(ids) => past.named.extend(ids),
            },
            Command::Configure(change) if change.gravity.is_some_and(|gravity| gravity != world.settings().gravity) => {
                let follow = |s: &ParticleState<R>| s.own_acceleration.is_none() && s.inverse_mass != R::ZERO;
                past.named.extend(all().filter(follow).map(|state| state.id));
            }
            Command::Advance(_) => past.advanced.push(world.settings().integrator),
            Command::Create(_) | Command::Remove { .. } | Command::Configure(_) => {}
        }
    }

    /// One command, or several as one change in either way, of which the second passes over what is refused.
    fn change(&mut self) {
        let (kind, revision) = (self.random.below(4), self.world.revision());
        let count = if kind > 1 { 1 } else { self.random.below(6) };
        let mut list: Vec<Command<R>> = (0..count).map(|_| self.command()).collect();
        if kind == 0 && self.random.below(2) == 0 {
            // A tick: forces, and then what may be refused.
            let force =
                |model: &mut Self| Command::AddForce { ids: model.ids(), force: Column::Uniform(model.vector()) };
            list.splice(0..0, [force(self), force(self)]);
        }
        let (fails, asks) = (self.random.below(3) == 0, self.random.below(3) == 0);
        let mut now = Past::default();
        let mut each = self.twin.clone();
        for command in &list {
            let mut noted = now.clone();
            Self::note(&mut noted, &each, command);
            if each.apply(command).is_ok() {
                now = noted;
            }
        }
        let apply = |world: &mut World<R>, asks: bool| match (kind, list.as_slice()) {
            (0, list) => world.apply_all(list).is_ok(),
            (1, list) => {
                let result = world.atomically(|world| {
                    for command in list {
                        let _refused = world.apply(command);
                        if asks {
                            world.keep_history();
                        }
                    }
                    if fails { Err(()) } else { Ok(()) }
                });
                result.is_ok()
            }
            (_, list) => list.iter().all(|command| world.apply(command).is_ok()),
        };
        // What is asked for the first time within a change is known from its end on.
        let asks = asks && !self.asked.is_empty();
        assert_eq!(apply(&mut self.world, asks), apply(&mut self.twin, false), "{list:?}");
        assert_eq!(self.world.revision(), self.twin.revision());
        if self.world.revision() > revision {
            assert_eq!(self.world.revision(), revision + 1);
            now.time = self.twin.time();
            now.states = self.twin.particles().map(|state| (state.id, seen(&state))).collect();
            self.past.push(now);
        }
    }

    fn ask(&mut self) {
        self.world.keep_history();
        self.asked.push(self.world.revision());
    }

    /// Holds the answer for every revision there was against what was read then.
    fn check(&self, at: &str) {
        let present = self.world.revision();
        let now = &self.past[self.past.len() - 1].states;
        for (revision, then) in (0..=present + 1).zip(self.past.iter().map(Some).chain([None])) {
            let at = format!("{at}, since {revision} of {present}");
            let changes = self.world.changed_since(revision);
            let is_known = revision <= present && self.asked.first().is_some_and(|first| revision >= *first);
            assert_eq!(changes.is_some(), is_known, "{at}");
            let (Some(changes), Some(then)) = (changes, then) else { continue };
            let removed: Vec<ParticleId> = then.states.keys().filter(|id| !now.contains_key(id)).copied().collect();
            assert_eq!(changes.removed(), removed, "{at}");
            let listed: BTreeSet<ParticleId> = changes.ids().collect();
            assert!(changes.ids().is_sorted() && (!changes.are_all() || listed.len() == now.len()), "{at}");
            for (id, seen) in now {
                let is_listed = listed.contains(id);
                assert_eq!(changes.contains(*id), is_listed, "{at}: {id}");
                assert_eq!(changes.ids_from(*id).next() == Some(*id), is_listed, "{at}: {id}");
                if then.states.get(id) != Some(seen) {
                    assert!(is_listed, "{at}: {id} differs\n{:?}\n{seen:?}", then.states.get(id));
                } else if is_listed {
                    assert!(self.may_be_told(*id, revision), "{at}: {id} is as it was: {seen:?}");
                }
            }
        }
    }

    /// Whether a particle may count as changed since a revision although it is as it was.
    fn may_be_told(&self, id: ParticleId, revision: u64) -> bool {
        let asked = self.asked.iter().copied().filter(|asked| *asked <= revision).max().unwrap_or_default();
        let time = self.past[usize::try_from(asked).expect("few")].time;
        self.past.windows(2).zip(1..).any(|(pair, at)| {
            let [before, after] = pair else { unreachable!("two of them") };
            let Some(seen) = after.states.get(&id) else { return false };
            let is_named = after.named.contains(&id);
            // A batch may have set it in motion before its advance. Gravitation, of which damping may leave the sign of
            // zeros, may have turned between two of them.
            let is_turned = after.advanced.len() > 1 && seen.rate > 0.0;
            let is_driven = is_named || is_turned || before.states.get(&id).is_none_or(|seen| seen.is_driven);
            // One of next to no velocity is known to be at rest when nothing is left of any.
            let is_spent = seen.rate == f64::INFINITY || (time - after.time) * seen.rate > 65.0;
            let is_known_to_rest = at <= asked && is_spent;
            let moved = |integrator: &Integrator| at > revision || *integrator == Integrator::Exact;
            (at > revision && is_named) || (is_driven && !is_known_to_rest && after.advanced.iter().any(moved))
        })
    }
}

fn run<R: Number>(integrator: Integrator, seed: u64) {
    let mut model = Model::<R>::new(integrator, seed);
    let begin = model.random.below(12);
    for change in 0..40 {
        model.change();
        let at = format!("{}, change {change}", scene::<R>(&format!("seed {seed}"), integrator));
        if change >= begin && model.random.below(3) == 0 {
            model.ask();
        }
        model.check(&at);
        assert_eq!(model.world.digest(), model.twin.digest(), "{at}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]
    #[test]
    fn what_differs_is_told_and_nothing_else(seed in any::<u64>()) {
        for integrator in Integrator::ALL {
            for precision in Precision::ALL {
                match precision {
                    Precision::Single => run::<f32>(integrator, seed),
                    Precision::Double => run::<f64>(integrator, seed),
                }
            }
        }
    }
}

fn ids(list: &[u64]) -> Vec<ParticleId> {
    list.iter().copied().map(ParticleId).collect()
}

/// What is told of a world that is asked now.
#[track_caller]
fn check_told<R: Number>(at: &str, world: &mut World<R>, since: u64, changed: &[u64], removed: &[u64]) {
    world.keep_history();
    let changes = world.changed_since(since).expect("the history reaches back to it");
    assert_eq!(changes.ids().collect::<Vec<_>>(), ids(changed), "{at}");
    assert_eq!(changes.removed(), ids(removed), "{at}");
}

/// A wall, a stone that lies, a ball that flies, and one that is pushed.
fn check_stillness<R: Number>(integrator: Integrator) {
    let at = |what: &str| scene::<R>(what, integrator);
    let mut world = World::<R>::new(Settings { integrator, ..Settings::default() }).expect("valid");
    let still = Particle { position: [R::ONE; 3].into(), ..Particle::default() };
    let velocity = [R::ONE, R::nearest(-2.0), R::ZERO].into();
    let (damping, moment) = (R::nearest(1e-30), in_steps(integrator, 50, 0.25));
    let (wall, ball) = (Particle { mass: Mass::IMMOVABLE, ..still }, Particle { velocity, damping, ..still });
    world.apply(&Command::Create([wall, still, ball, still].into_iter().collect())).expect("valid");
    world.keep_history();
    let begin = world.revision();
    world.add_force(ParticleId(3), velocity).expect("finite");
    check_told(&at("pushed"), &mut world, begin, &[3], &[]);
    world.advance(moment).expect("finite");
    check_told(&at("moved"), &mut world, begin, &[2, 3], &[]);
    world.advance(moment).expect("finite");
    check_told(&at("moved on"), &mut world, begin + 2, &[2, 3], &[]);
    // Within ten seconds the ball comes to rest, and within ten more loses the sign of what is left of its velocity.
    let (before, ten_seconds) = (world.revision(), in_steps(integrator, 500, 10.0));
    for told in [&[2, 3][..], &[2, 3], &[3]] {
        world.advance(ten_seconds).expect("finite");
        world.keep_history();
        if integrator == Integrator::Exact {
            let last = world.revision() - 1;
            check_told(&at("came to rest"), &mut world, last, told, &[]);
        }
    }
    let rested = world.revision();
    world.advance(ten_seconds).expect("finite");
    check_told(&at("came to rest"), &mut world, before, &[2, 3], &[]);
    check_told(&at("rested"), &mut world, rested, &[3], &[]);
    world.remove(ParticleId(1)).expect("it is there");
    let new = world.create(still).expect("valid");
    world.remove(new).expect("it is there");
    check_told(&at("removed"), &mut world, rested, &[3], &[1]);
    check_told(&at("new"), &mut world, rested + 3, &[], &[4]);
}

#[test]
fn what_is_still_is_not_told() {
    // Under the other one a velocity stays about as small as its tolerance.
    for integrator in Integrator::ALL.into_iter().filter(|integrator| *integrator != Integrator::Dop853) {
        check_stillness::<f32>(integrator);
        check_stillness::<f64>(integrator);
    }
}

#[test]
fn who_missed_too_much_is_told_so() {
    let mut world = World::<f64>::default();
    world.keep_history();
    for _ in 0..5000 {
        world.create(Particle::default()).expect("valid");
    }
    world.keep_history();
    assert!(world.changed_since(0).is_none(), "it would have to know too many creations");
    let few = world.changed_since(4000).expect("a thousand creations are known");
    assert_eq!((few.ids().count(), few.removed().len()), (1000, 0));
    world.apply(&Command::Remove { ids: Selection::All }).expect("they are there");
    assert!(world.changed_since(5000).is_none(), "it would have to know too many removed particles");
    assert_eq!(world.changed_since(5001).expect("that is now").ids().count(), 0);
    world.create(Particle::default()).expect("valid");
    check_told("goes on", &mut world, 5001, &[5000], &[]);
}

/// A velocity that is too small to be read still moves a particle that is as near to the origin.
fn check_creeping<R: Number>() {
    let rest = if R::PRECISION == Precision::Single { 2f64.powi(-100) } else { 2f64.powi(-960) };
    let velocity = [R::nearest(1.5 * rest); 3].into();
    let mut world = World::<R>::default();
    world.create(Particle { velocity, damping: R::HALF, ..Particle::default() }).expect("valid");
    for (first, told) in [(15.0, &[0][..]), (100.0, &[])] {
        world.advance(first).expect("finite");
        world.keep_history();
        let seen = world.revision();
        world.advance(15.0).expect("finite");
        let state = world.particle(ParticleId(0)).expect("created above");
        assert_eq!(state.velocity, R::Vec3::default());
        check_told(&scene::<R>("creeping", Integrator::Exact), &mut world, seen, told, &[]);
    }
}

#[test]
fn what_creeps_is_told_until_it_surely_rests() {
    check_creeping::<f32>();
    check_creeping::<f64>();
}
