//! The stepped integrator against the book, against the limits of the machine, and against size.

use std::cell::RefCell;
use std::rc::Rc;

use pointmass::{Advance, Integrator, ParticleId, World};

use crate::book;
use crate::compare::{Bench, Case, Cell, Column, Contender, Group};
use crate::machine::{self, Number, PEAK_OPERATIONS};
use crate::scene::{STEP, Scene, Shape, add_forces};

pub(crate) const BOOK: &str = "the book";
pub(crate) const ONE: &str = "newton_euler, 1 step";
pub(crate) const SIXTY: &str = "newton_euler, 60 steps";
pub(crate) const UPDATE: &str = "in-place update";
pub(crate) const PEAK: &str = "add/mul peak";
pub(crate) const MANY: &str = "newton_euler";
pub(crate) const EXACT: &str = "exact";
pub(crate) const EXACT_ONE: &str = "exact, one particle read";

pub(crate) const STEPPING: Group = Group {
    name: "stepping",
    title: "Stepping: time of one particle and step, one thread",
    note: "The book: its integrator on an array of structs (vectors without its padding), one pow for each particle and step, the same compiler and \
           flags; one pass over all particles, of which 60 steps are sixty. 1 step and 60 steps: of one advance under \
           `newton_euler`. Damped: 0.99, or different values up to 0.999; undamped: 1. Uniform: position and velocity \
           are per particle, the rest is shared. Per-particle: each has an acceleration, a damping and a mass of its \
           own. Force: one is added to each particle before every advance, outside of the timing, for the book too. \
           In-place update: reading and writing position and velocity without computing, in memory or in a cache. \
           Peak: the 12 adds and multiplies of a damped particle and step (9 undamped) in registers.",
    size: "particles",
    columns: &[
        Column("book", Cell::Time(BOOK)),
        Column("1 step", Cell::Time(ONE)),
        Column("book / 1 step", Cell::Ratio(BOOK, ONE)),
        Column("1 step, of update", Cell::Percent(UPDATE, ONE)),
        Column("60 steps", Cell::Time(SIXTY)),
        Column("book / 60 steps", Cell::Ratio(BOOK, SIXTY)),
        Column("60 steps, of peak", Cell::Percent(PEAK, SIXTY)),
    ],
    run: |bench| {
        for shape in [Shape::Uniform, Shape::Each, Shape::EachForced] {
            for damped in [true, false] {
                // Ten million forces take longer to add than to use.
                for n in bench.powers_of_ten(3, if shape == Shape::EachForced { 6 } else { 7 }) {
                    step::<f32>(bench, Scene { shape, damped, n });
                    step::<f64>(bench, Scene { shape, damped, n });
                }
            }
        }
    },
};

pub(crate) const GROWTH: Group = Group {
    name: "growth",
    title: "Growth with particles: time of one advance of 1/60 s",
    note: "Uniform, damped, one thread. Under `exact` an advance moves the clock, and particles are evaluated when they \
           are read; the last column is an advance and the read of one particle.",
    size: "particles",
    columns: &[
        Column("book", Cell::Time(BOOK)),
        Column("newton_euler", Cell::Time(ONE)),
        Column("exact", Cell::Time(EXACT)),
        Column("exact, one read", Cell::Time(EXACT_ONE)),
    ],
    run: |bench| {
        for n in bench.powers_of_ten(0, 7) {
            grow::<f64>(bench, n);
        }
    },
};

pub(crate) const STEPS: Group = Group {
    name: "steps",
    title: "Growth with steps: time of one particle and step, 10,000 particles",
    note: "One advance under `newton_euler` of so many steps of 1/60 s, damped, one thread.",
    size: "steps",
    columns: &[Column("newton_euler", Cell::Time(MANY))],
    run: |bench| {
        for shape in [Shape::Uniform, Shape::Each] {
            for steps in bench.powers_of_ten(0, 4) {
                many_steps::<f32>(bench, shape, steps);
                many_steps::<f64>(bench, shape, steps);
            }
        }
    },
};

fn step<R: Number>(bench: &mut Bench, scene: Scene) {
    let n = scene.n;
    bench.compare(&Case { precision: R::PRECISION, scene: scene.name(), size: n }, || {
        let world = scene.world::<R>(Integrator::NewtonEuler);
        let particles = book::of(&world);
        let mut contenders = if scene.shape == Shape::EachForced {
            forced(scene, world, particles)
        } else {
            unforced(scene, world, particles)
        };
        let arithmetic = if scene.damped { 12 } else { 9 };
        contenders.push(machine::peak::<R>(PEAK_OPERATIONS * arithmetic, PEAK_OPERATIONS));
        contenders.push(machine::update::<R>(UPDATE, n, n, 1));
        contenders
    });
}

fn sixty_steps() -> Advance {
    Advance { steps: Some(60), ..Advance::by(60.0 * STEP) }
}

fn unforced<R: Number>(scene: Scene, world: World<R>, mut particles: Vec<book::Particle<R>>) -> Vec<Contender> {
    // The same world for both: at ten million particles memory is short.
    let world = Rc::new(RefCell::new(world));
    let again = Rc::clone(&world);
    vec![
        Contender::new(BOOK, scene.n, move || book::step(&mut particles, R::nearest(STEP))),
        Contender::new(ONE, scene.n, move || world.borrow_mut().advance(STEP).expect("valid")),
        Contender::new(SIXTY, 60 * scene.n, move || again.borrow_mut().advance(sixty_steps()).expect("valid")),
    ]
}

fn forced<R: Number>(scene: Scene, world: World<R>, particles: Vec<book::Particle<R>>) -> Vec<Contender> {
    let forces = scene.forces::<R>();
    let command = Rc::new(add_forces(forces.clone()));
    let (world, particles) = (Rc::new(RefCell::new(world)), Rc::new(RefCell::new(particles)));
    let contender = |name, operations, advance: Advance| {
        let (world, again, command) = (Rc::clone(&world), Rc::clone(&world), Rc::clone(&command));
        Contender::prepared(
            name,
            operations,
            move || again.borrow_mut().apply(&command).expect("valid"),
            move |_| world.borrow_mut().advance(advance).expect("valid"),
        )
    };
    let again = Rc::clone(&particles);
    let push = move || {
        for (particle, force) in again.borrow_mut().iter_mut().zip(&forces) {
            particle.force = (*force).into();
        }
    };
    vec![
        Contender::prepared(BOOK, scene.n, push, move |()| {
            book::step(&mut particles.borrow_mut(), R::nearest(STEP));
        }),
        contender(ONE, scene.n, Advance::by(STEP)),
        contender(SIXTY, 60 * scene.n, sixty_steps()),
    ]
}

fn grow<R: Number>(bench: &mut Bench, n: usize) {
    let scene = Scene { shape: Shape::Uniform, damped: true, n };
    bench.compare(&Case { precision: R::PRECISION, scene: scene.name(), size: n }, || {
        let mut stepped = scene.world::<R>(Integrator::NewtonEuler);
        let mut particles = book::of(&stepped);
        let mut exact = scene.world::<R>(Integrator::Exact);
        let mut read = exact.clone();
        let last = ParticleId(n as u64 - 1);
        vec![
            Contender::new(BOOK, 1, move || book::step(&mut particles, R::nearest(STEP))),
            Contender::new(ONE, 1, move || stepped.advance(STEP).expect("valid")),
            Contender::new(EXACT, 1, move || exact.advance(STEP).expect("valid")),
            Contender::new(EXACT_ONE, 1, move || {
                read.advance(STEP).expect("valid");
                std::hint::black_box(read.particle(last).expect("it exists"));
            }),
        ]
    });
}

fn many_steps<R: Number>(bench: &mut Bench, shape: Shape, steps: usize) {
    let n = if bench.is_measuring() { 10_000 } else { 10 };
    let scene = Scene { shape, damped: true, n };
    bench.compare(&Case { precision: R::PRECISION, scene: scene.name(), size: steps }, || {
        let mut world = scene.world::<R>(Integrator::NewtonEuler);
        let advance = Advance { steps: Some(steps as u64), ..Advance::by(steps as f64 * STEP) };
        vec![Contender::new(MANY, n * steps, move || world.advance(advance).expect("valid"))]
    });
}
