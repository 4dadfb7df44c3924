//! What a second thread brings.

use pointmass::{Advance, Integrator, Threads};

use crate::compare::{Bench, Case, Cell, Column, Contender, Group};
use crate::machine::{self, Number};
use crate::scene::{STEP, Scene, Shape};

pub(crate) const ONE: &str = "1 thread";
pub(crate) const TWO: &str = "2 threads";
const UPDATE_ONE: &str = "in-place update, 1 thread";
const UPDATE_TWO: &str = "in-place update, 2 threads";

pub(crate) const THREADS: Group = Group {
    name: "threads",
    title: "Threads: time of one particle and step",
    note: "One advance under `newton_euler`, damped, with one thread and with two. In-place update: reading and writing \
           position and velocity without computing, by as many threads.",
    size: "particles",
    columns: &[
        Column("1 thread", Cell::Time(ONE)),
        Column("2 threads", Cell::Time(TWO)),
        Column("1 / 2 threads", Cell::Ratio(ONE, TWO)),
        Column("1 thread, of update", Cell::Percent(UPDATE_ONE, ONE)),
        Column("2 threads, of update", Cell::Percent(UPDATE_TWO, TWO)),
    ],
    run: |bench| {
        for (shape, steps) in [(Shape::Uniform, 1), (Shape::Each, 1), (Shape::Uniform, 60)] {
            for n in bench.powers_of_ten(3, 7) {
                share::<f32>(bench, Scene { shape, damped: true, n }, steps);
                share::<f64>(bench, Scene { shape, damped: true, n }, steps);
            }
        }
    },
};

fn share<R: Number>(bench: &mut Bench, scene: Scene, steps: usize) {
    let n = scene.n;
    let name = format!("{}, {steps} {}", scene.name(), if steps == 1 { "step" } else { "steps" });
    bench.compare(&Case { precision: R::PRECISION, scene: name, size: n }, || {
        let advance = Advance { steps: Some(steps as u64), ..Advance::by(steps as f64 * STEP) };
        let contender = |name, count| {
            let mut world = scene.world::<R>(Integrator::NewtonEuler);
            world.set_threads(&Threads::new(count).expect("threads start"));
            Contender::new(name, n * steps, move || world.advance(advance).expect("valid"))
        };
        let mut contenders = vec![contender(ONE, 1), contender(TWO, 2)];
        // Starting threads takes longer than updating less.
        if steps == 1 && n >= 1_000_000 {
            contenders.push(machine::update::<R>(UPDATE_ONE, n, n, 1));
            contenders.push(machine::update::<R>(UPDATE_TWO, n, n, 2));
        }
        contenders
    });
}
