//! What it costs when damped particles come to rest, and what it would cost if they never did.

use std::cell::RefCell;
use std::rc::Rc;

use pointmass::{Advance, Command, Integrator, NewParticles, Selection, Settings, World};

use crate::book;
use crate::compare::{Bench, Case, Cell, Column, Contender, Group};
use crate::machine::Number;
use crate::scene::{Random, STEP};

pub(crate) const REST: Group = Group {
    name: "rest",
    title: "Coming to rest: time of one particle and step",
    note: "Uniform without gravity, one thread. Coming to rest: before every advance, outside of the timing, all \
           velocities are set to just above the threshold (2⁻¹⁰⁰ m/s in single, 2⁻⁹⁶⁰ in double), and fall below it in \
           the first step; moving: to some m/s, in the same way. Damping 1e-27 keeps 0.35 of a velocity at each \
           step, so that velocities decay into denormals before they are next compared with the threshold: the worst \
           case. The book has no threshold: its denormal velocities are set in the same way.",
    size: "particles",
    columns: &[
        Column("1 step, moving", Cell::Time(ONE_MOVING)),
        Column("coming to rest", Cell::Time(ONE_RESTING)),
        Column("ratio", Cell::Ratio(ONE_RESTING, ONE_MOVING)),
        Column("60 steps, moving", Cell::Time(SIXTY_MOVING)),
        Column("coming to rest", Cell::Time(SIXTY_RESTING)),
        Column("ratio", Cell::Ratio(SIXTY_RESTING, SIXTY_MOVING)),
        Column("book, moving", Cell::Time(BOOK_MOVING)),
        Column("denormal", Cell::Time(BOOK_DENORMAL)),
        Column("ratio", Cell::Ratio(BOOK_DENORMAL, BOOK_MOVING)),
    ],
    run: |bench| {
        for damping in [0.99, 1e-27] {
            for n in bench.powers_of_ten(3, 5) {
                compare::<f32>(bench, damping, n);
                compare::<f64>(bench, damping, n);
            }
        }
    },
};

const ONE_MOVING: &str = "1 step, moving";
const ONE_RESTING: &str = "1 step, coming to rest";
const SIXTY_MOVING: &str = "60 steps, moving";
const SIXTY_RESTING: &str = "60 steps, coming to rest";
const BOOK_MOVING: &str = "the book, moving";
const BOOK_DENORMAL: &str = "the book, denormal";

fn compare<R: Number>(bench: &mut Bench, damping: f64, n: usize) {
    bench.compare(&Case { precision: R::PRECISION, scene: format!("damping {damping:?}"), size: n }, || {
        let step = pxfm::f_pow(damping, STEP);
        let threshold: f64 = R::REST.into();
        let mut random = Random(4);
        let mut velocities = |from: f64, to: f64| -> Vec<R::Vec3> {
            (0..n).map(|_| std::array::from_fn(|_| R::nearest(random.between(from, to))).into()).collect()
        };
        let moving = velocities(1.0, 10.0);
        let resting = velocities(threshold, threshold / step);
        // Halfway down the denormals of the precision.
        let smallest = if size_of::<R>() == 4 { f64::from(f32::MIN_POSITIVE) } else { f64::MIN_POSITIVE };
        let denormal = velocities(0.25 * smallest, 0.5 * smallest);
        let book = |name, velocities: &[R::Vec3]| {
            let particle = |velocity: &R::Vec3| book::Particle {
                position: [R::ONE; 3],
                velocity: (*velocity).into(),
                acceleration: [R::ZERO; 3],
                force: [R::ZERO; 3],
                damping: R::nearest(damping),
                inverse_mass: R::ONE,
            };
            let start: Vec<book::Particle<R>> = velocities.iter().map(particle).collect();
            let particles = Rc::new(RefCell::new(start.clone()));
            let again = Rc::clone(&particles);
            Contender::prepared(
                name,
                n,
                move || again.borrow_mut().copy_from_slice(&start),
                move |()| book::step(&mut particles.borrow_mut(), R::nearest(STEP)),
            )
        };
        vec![
            engine::<R>(ONE_MOVING, damping, moving.clone(), 1),
            engine::<R>(ONE_RESTING, damping, resting.clone(), 1),
            engine::<R>(SIXTY_MOVING, damping, moving.clone(), 60),
            engine::<R>(SIXTY_RESTING, damping, resting, 60),
            book(BOOK_MOVING, &moving),
            book(BOOK_DENORMAL, &denormal),
        ]
    });
}

/// Velocities are set before every advance, outside of the timing.
fn engine<R: Number>(name: &'static str, damping: f64, velocities: Vec<R::Vec3>, steps: usize) -> Contender {
    let n = velocities.len();
    let settings = Settings { integrator: Integrator::NewtonEuler, ..Settings::default() };
    let mut world = World::<R>::new(settings).expect("valid settings");
    let damping = pointmass::Column::Uniform(R::nearest(damping));
    world.apply(&Command::Create(NewParticles { count: n, damping, ..NewParticles::default() })).expect("valid");
    let velocity = Some(pointmass::Column::PerParticle(velocities));
    let place = Command::Place { ids: Selection::All, position: None, velocity };
    let advance = Advance { steps: Some(steps as u64), ..Advance::by(steps as f64 * STEP) };
    let world = Rc::new(RefCell::new(world));
    let again = Rc::clone(&world);
    Contender::prepared(
        name,
        n * steps,
        move || again.borrow_mut().apply(&place).expect("valid"),
        move |_| world.borrow_mut().advance(advance).expect("valid"),
    )
}
