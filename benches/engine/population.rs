//! Creating, finding and removing particles.

use std::hint::black_box;

use pointmass::{Command, Integrator, Particle, ParticleId, Selection, World};

use crate::compare::{Bench, Case, Cell, Column, Contender, Group};
use crate::machine::Number;
use crate::scene::{Random, STEP, Scene, Shape};

pub(crate) const POPULATION: Group = Group {
    name: "population",
    title: "Creating, finding and removing: time of one particle",
    note: "Uniform, under `newton_euler`. In bulk: one command for all; otherwise one command for each. Lookups read \
           each particle once by its id, in random order, before and after a random half was removed. Removals take all \
           particles in random order.",
    size: "particles",
    columns: &[
        Column("create in bulk", Cell::Time("create in bulk")),
        Column("one by one", Cell::Time("create one by one")),
        Column("look up", Cell::Time("look up")),
        Column("after removals", Cell::Time("look up after removals")),
        Column("remove in bulk", Cell::Time("remove in bulk")),
        Column("one by one", Cell::Time("remove one by one")),
    ],
    run: |bench| {
        for n in bench.powers_of_ten(3, 6) {
            compare::<f32>(bench, n);
            compare::<f64>(bench, n);
        }
    },
};

fn compare<R: Number>(bench: &mut Bench, n: usize) {
    let scene = Scene { shape: Shape::Uniform, damped: true, n };
    bench.compare(&Case { precision: R::PRECISION, scene: scene.name(), size: n }, || {
        let empty = move || Scene { n: 0, ..scene }.world::<R>(Integrator::NewtonEuler);
        let full = scene.world::<R>(Integrator::NewtonEuler);
        let all = Command::Create(scene.particles::<R>());
        let particles: Vec<Particle<R>> = full.particles().map(|particle| particle_of(&particle)).collect();
        let mut order: Vec<ParticleId> = (0..n as u64).map(ParticleId).collect();
        Random(5).shuffle(&mut order);
        let remove_all = Command::Remove { ids: Selection::Ids(order.clone()) };
        let (gone, kept) = order.split_at(n / 2);
        let mut half = full.clone();
        half.apply(&Command::Remove { ids: Selection::Ids(gone.to_vec()) }).expect("they exist");
        let (bulk, single) = (full.clone(), full.clone());
        let one_by_one = order.clone();
        vec![
            Contender::prepared("create in bulk", n, empty, move |mut world| {
                world.apply(&all).expect("valid");
                world
            }),
            Contender::prepared("create one by one", n, empty, move |mut world| {
                for particle in &particles {
                    world.create(*particle).expect("valid");
                }
                world
            }),
            look_up("look up", full, order.clone()),
            look_up("look up after removals", half, kept.to_vec()),
            Contender::prepared(
                "remove in bulk",
                n,
                move || bulk.clone(),
                move |mut world| {
                    world.apply(&remove_all).expect("they exist");
                    world
                },
            ),
            Contender::prepared(
                "remove one by one",
                n,
                move || single.clone(),
                move |mut world| {
                    for id in &one_by_one {
                        world.remove(*id).expect("it exists");
                    }
                    world
                },
            ),
        ]
    });
}

fn particle_of<R: Number>(state: &pointmass::ParticleState<R>) -> Particle<R> {
    let (position, velocity, damping) = (state.position, state.velocity, state.damping);
    Particle { position, velocity, damping, ..Particle::default() }
}

fn look_up<R: Number>(name: &'static str, mut world: World<R>, order: Vec<ParticleId>) -> Contender {
    world.advance(STEP).expect("valid");
    Contender::new(name, order.len(), move || {
        for id in &order {
            black_box(world.particle(*id).expect("it exists"));
        }
    })
}
