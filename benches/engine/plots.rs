//! Which plots there are, and what each shows.

use crate::colours::{BLACK, BLUE, GREEN, GREY, RED};
use crate::exact::{EAGER, TICK};
use crate::plot::{Line, Plot};
use crate::stepping::{BOOK, EXACT, EXACT_ONE, GROWTH, MANY, ONE, PEAK, SIXTY, STEPPING, STEPS, UPDATE};
use crate::threads::{ONE as ONE_THREAD, THREADS, TWO as TWO_THREADS};

const UNIFORM: &str = "uniform, damped";
const EACH: &str = "per-particle, damped";
const UNDAMPED: &str = "uniform, undamped";
const ONE_STEP: &str = "uniform, damped, 1 step";
const SIXTY_STEPS: &str = "uniform, damped, 60 steps";

/// The first one is for the front page.
pub(crate) const PLOTS: [Plot; 7] = [
    Plot {
        file: "stepping-double.svg",
        title: "Time per particle and step, double",
        caption: "Double precision, uniform, damped, one thread; lower is better. The book takes one pow for each \
                  particle and step; the engine takes one for each distinct damping. Dashed is what the machine can \
                  do: reading and writing position and velocity, and the adds and multiplies of a step in registers.",
        x: "particles",
        group: STEPPING.name,
        lines: &stepping("double", UNIFORM),
    },
    Plot {
        file: "stepping-single.svg",
        title: "Time per particle and step, single",
        caption: "The same in single precision: half the memory, and twice the numbers in a register.",
        x: "particles",
        group: STEPPING.name,
        lines: &stepping("single", UNIFORM),
    },
    Plot {
        file: "stepping-per-particle.svg",
        title: "Time per particle and step, nothing shared",
        caption: "Double precision, damped, every particle with an acceleration, a damping and a mass of its own. One \
                  step reads them all; sixty steps read them once.",
        x: "particles",
        group: STEPPING.name,
        lines: &stepping("double", EACH),
    },
    Plot {
        file: "growth.svg",
        title: "Time of one advance of 1/60 s, double",
        caption: "Uniform, damped, one thread. Under `exact` an advance moves the clock, however many particles there \
                  are; a read of one particle evaluates that one.",
        x: "particles",
        group: GROWTH.name,
        lines: &[
            Line { name: "the book", colour: BLACK, limit: false, of: ["double", UNIFORM, BOOK] },
            Line { name: "newton_euler", colour: BLUE, limit: false, of: ["double", UNIFORM, ONE] },
            Line { name: "exact", colour: GREEN, limit: false, of: ["double", UNIFORM, EXACT] },
            Line { name: "exact, then one read", colour: RED, limit: false, of: ["double", UNIFORM, EXACT_ONE] },
        ],
    },
    Plot {
        file: "steps.svg",
        title: "Time per particle and step, 10⁴ particles",
        caption: "Damped, one thread. More steps in one advance cost less each, until only arithmetic is left.",
        x: "steps of one advance",
        group: STEPS.name,
        lines: &[
            Line { name: "double, per-particle", colour: RED, limit: false, of: ["double", EACH, MANY] },
            Line { name: "double, uniform", colour: BLUE, limit: false, of: ["double", UNIFORM, MANY] },
            Line { name: "single, per-particle", colour: GREEN, limit: false, of: ["single", EACH, MANY] },
            Line { name: "single, uniform", colour: BLACK, limit: false, of: ["single", UNIFORM, MANY] },
        ],
    },
    Plot {
        file: "threads.svg",
        title: "One thread and two, double",
        caption: "Uniform, damped. Below 131,072 particle-steps a second thread is not woken.",
        x: "particles",
        group: THREADS.name,
        lines: &[
            Line { name: "1 step, 1 thread", colour: BLUE, limit: false, of: ["double", ONE_STEP, ONE_THREAD] },
            Line { name: "1 step, 2 threads", colour: GREEN, limit: false, of: ["double", ONE_STEP, TWO_THREADS] },
            Line { name: "60 steps, 1 thread", colour: RED, limit: false, of: ["double", SIXTY_STEPS, ONE_THREAD] },
            Line { name: "60 steps, 2 threads", colour: BLACK, limit: false, of: ["double", SIXTY_STEPS, TWO_THREADS] },
        ],
    },
    Plot {
        file: "tick.svg",
        title: "A tick of a game server, double",
        caption: "1 % of the particles get a force, the world advances by 1/60 s, and all particles are read. `exact` \
                  evaluates each particle from its last change; the eager loop moves and stores all at every tick.",
        x: "particles",
        group: TICK.name,
        lines: &[
            Line { name: "exact, damped", colour: GREEN, limit: false, of: ["double", UNIFORM, EXACT] },
            Line { name: "eager, damped", colour: BLACK, limit: false, of: ["double", UNIFORM, EAGER] },
            Line { name: "exact, undamped", colour: BLUE, limit: false, of: ["double", UNDAMPED, EXACT] },
            Line { name: "eager, undamped", colour: GREY, limit: false, of: ["double", UNDAMPED, EAGER] },
        ],
    },
];

const fn stepping(precision: &'static str, scene: &'static str) -> [Line; 5] {
    [
        Line { name: "1 step per advance", colour: BLUE, limit: false, of: [precision, scene, ONE] },
        Line { name: "limit: memory", colour: BLUE, limit: true, of: [precision, scene, UPDATE] },
        Line { name: "60 steps per advance", colour: RED, limit: false, of: [precision, scene, SIXTY] },
        Line { name: "limit: arithmetic", colour: RED, limit: true, of: [precision, scene, PEAK] },
        Line { name: "the book", colour: BLACK, limit: false, of: [precision, scene, BOOK] },
    ]
}
