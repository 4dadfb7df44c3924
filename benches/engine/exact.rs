//! The closed form: reading every particle of a world, and a game server that pushes a few and reads all.

use std::hint::black_box;

use pointmass::{Command, Integrator, ParticleId, Selection, States, World};

use crate::compare::{Bench, Case, Cell, Column, Contender, Group};
use crate::machine::Number;
use crate::scene::{Random, STEP, Scene, Shape, read_all};
use crate::stepping::EXACT;

pub(crate) const READING: Group = Group {
    name: "reading",
    title: "Advancing by 1/60 s and reading all particles: time of one particle",
    note: "Uniform, one thread. `exact` evaluates each particle when it is read; `newton_euler` takes one step and \
           copies. A read is id, position and velocity of every particle, into buffers that are kept.",
    size: "particles",
    columns: &[
        Column("newton_euler", Cell::Time(STEPPED)),
        Column("exact", Cell::Time(EXACT)),
        Column("exact / newton_euler", Cell::Ratio(EXACT, STEPPED)),
    ],
    run: |bench| {
        for damped in [true, false] {
            for n in bench.powers_of_ten(3, 6) {
                advance_and_read::<f32>(bench, Scene { shape: Shape::Uniform, damped, n });
                advance_and_read::<f64>(bench, Scene { shape: Shape::Uniform, damped, n });
            }
        }
    },
};

pub(crate) const TICK: Group = Group {
    name: "tick",
    title: "A tick of a game server: time of one tick",
    note: "A force on 1 % of the particles, drawn anew each tick; an advance of 1/60 s; a read of all. After 300 ticks, \
           when most particles have been pushed. Eager: a plain loop that computes the coefficients of the closed form \
           once per tick, moves and stores every particle, and copies all for the reader.",
    size: "particles",
    columns: &[
        Column("eager", Cell::Time(EAGER)),
        Column("exact", Cell::Time(EXACT)),
        Column("exact / eager", Cell::Ratio(EXACT, EAGER)),
    ],
    run: |bench| {
        for damped in [true, false] {
            for n in bench.powers_of_ten(3, 5) {
                tick::<f32>(bench, Scene { shape: Shape::Uniform, damped, n });
                tick::<f64>(bench, Scene { shape: Shape::Uniform, damped, n });
            }
        }
    },
};

pub(crate) const EAGER: &str = "eager";
const STEPPED: &str = "newton_euler";

fn advance_and_read<R: Number>(bench: &mut Bench, scene: Scene) {
    bench.compare(&Case { precision: R::PRECISION, scene: scene.name(), size: scene.n }, || {
        let contender = |name, integrator| {
            let (mut world, mut states) = (scene.world::<R>(integrator), States::default());
            Contender::new(name, scene.n, move || {
                world.advance(STEP).expect("valid");
                read_all(&world, &mut states);
                black_box(&states);
            })
        };
        vec![contender(STEPPED, Integrator::NewtonEuler), contender(EXACT, Integrator::Exact)]
    });
}

/// The forces of one tick.
struct Push<R: Number> {
    command: Command<R>,
    ids: Vec<ParticleId>,
    forces: Vec<R::Vec3>,
}

/// Drawn beforehand, for as many ticks as it takes to forget the first one.
fn pushes<R: Number>(n: usize) -> Vec<Push<R>> {
    let mut random = Random(3);
    let push = |_| {
        let ids: Vec<ParticleId> = (0..n.div_ceil(100)).map(|_| ParticleId(random.below(n) as u64)).collect();
        let forces: Vec<R::Vec3> = ids.iter().map(|_| random.vector::<R>(20.0)).collect();
        let force = pointmass::Column::PerParticle(forces.clone());
        Push { command: Command::AddForce { ids: Selection::Ids(ids.clone()), force }, ids, forces }
    };
    (0..500).map(push).collect()
}

fn tick<R: Number>(bench: &mut Bench, scene: Scene) {
    bench.compare(&Case { precision: R::PRECISION, scene: scene.name(), size: scene.n }, || {
        let mut world = scene.world::<R>(Integrator::Exact);
        let mut eager = Eager::of(&world, scene.damped);
        for push in pushes(scene.n).iter().take(300) {
            advance(&mut world, push);
            eager.advance(push);
        }
        let mut ticks = (0..500).cycle();
        let mut again = ticks.clone();
        let (ours, theirs) = (pushes(scene.n), pushes(scene.n));
        let (mut states, mut copies) = (States::default(), States::default());
        let mut next = move || ticks.next().expect("a cycle does not end");
        vec![
            Contender::new(EAGER, 1, move || {
                eager.advance(&theirs[again.next().expect("a cycle does not end")]);
                eager.read_all(&mut copies);
                black_box(&copies);
            }),
            Contender::new(EXACT, 1, move || {
                advance(&mut world, &ours[next()]);
                read_all(&world, &mut states);
                black_box(&states);
            }),
        ]
    });
}

fn advance<R: Number>(world: &mut World<R>, push: &Push<R>) {
    world.apply(&push.command).expect("valid");
    world.advance(STEP).expect("valid");
}

/// All particles moved and stored at each tick. Their mass is 1 kg, and they share damping and gravity.
struct Eager<R> {
    id: Vec<ParticleId>,
    position: Vec<[R; 3]>,
    velocity: Vec<[R; 3]>,
    gravity: [f64; 3],
    damped: bool,
}

impl<R: Number> Eager<R> {
    fn of(world: &World<R>, damped: bool) -> Self {
        let mut states = States::default();
        read_all(world, &mut states);
        let gravity: [R; 3] = world.settings().gravity.into();
        let States { id, position, velocity } = states;
        Self { id, position, velocity, gravity: gravity.map(Into::into), damped }
    }

    fn advance(&mut self, push: &Push<R>) {
        let damping = R::nearest(if self.damped { 0.99 } else { 1.0 });
        let [kept, phi, psi] = coefficients(damping.into(), STEP);
        let gravity = self.gravity;
        for (p, v) in self.position.iter_mut().zip(&mut self.velocity) {
            for k in 0..3 {
                let (x, u): (f64, f64) = (p[k].into(), v[k].into());
                p[k] = R::nearest(x + (u * phi + gravity[k] * psi));
                v[k] = R::nearest(u * kept + gravity[k] * phi);
            }
        }
        // The motion is linear in the force: its share is added to the few that have one.
        for (id, force) in push.ids.iter().zip(&push.forces) {
            let row = usize::try_from(id.0).expect("a row");
            let force: [R; 3] = (*force).into();
            let share = |of: [R; 3], of_force: f64| {
                std::array::from_fn(|k| R::nearest(of[k].into() + of_force * force[k].into()))
            };
            self.position[row] = share(self.position[row], psi);
            self.velocity[row] = share(self.velocity[row], phi);
        }
    }

    fn read_all(&self, into: &mut States<R>) {
        into.id.clone_from(&self.id);
        into.position.clone_from(&self.position);
        into.velocity.clone_from(&self.velocity);
    }
}

/// E, φ and ψ, as plainly as a game would compute them.
#[expect(clippy::disallowed_methods, reason = "no state of a world comes of it")]
fn coefficients(damping: f64, time: f64) -> [f64; 3] {
    if damping == 1.0 {
        return [1.0, time, 0.5 * time * time];
    }
    let lambda = -damping.ln();
    let phi = -(-lambda * time).exp_m1() / lambda;
    [damping.powf(time), phi, (time - phi) / lambda]
}

/// Both ways of a tick move particles to the same places.
pub(crate) fn check() {
    for damped in [true, false] {
        let scene = Scene { shape: Shape::Uniform, damped, n: 500 };
        let mut world = scene.world::<f64>(Integrator::Exact);
        let mut eager = Eager::of(&world, damped);
        for push in &pushes(scene.n) {
            advance(&mut world, push);
            eager.advance(push);
        }
        let (mut ours, mut theirs) = (States::default(), States::default());
        read_all(&world, &mut ours);
        eager.read_all(&mut theirs);
        assert_eq!(ours.id, theirs.id);
        let ours = ours.position.iter().chain(&ours.velocity).flatten();
        for (a, b) in ours.zip(theirs.position.iter().chain(&theirs.velocity).flatten()) {
            assert!((a - b).abs() <= 1e-9 * (1.0 + a.abs()), "exact is at {a}, eager at {b}");
        }
    }
}
