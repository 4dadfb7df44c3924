//! `docs/benchmarks.csv`: times of the engine over the number of particles or steps.

use crate::chart::{Axis, Chart, Curve, power_of_ten, time};
use crate::csv::Recorded;
use crate::svg::Colour::{self, Blue, Green, Ink, Orange, Pink};

struct Plot {
    file: &'static str,
    title: &'static str,
    note: &'static str,
    x: &'static str,
    y: &'static str,
    group: &'static str,
    /// Whether times are of all particles, and told for each.
    each: bool,
    lines: &'static [Line],
}

struct Line {
    name: &'static str,
    colour: Colour,
    /// A limit of the machine.
    is_guide: bool,
    /// Precision, scene and contender.
    of: [&'static str; 3],
}

const UNIFORM: &str = "uniform, damped";
const EACH: &str = "per-particle, damped";
const UNDAMPED: &str = "uniform, undamped";
const ONE_STEP: &str = "uniform, damped, 1 step";
const SIXTY_STEPS: &str = "uniform, damped, 60 steps";
const EACH_STEP: &str = "time of a particle and step";

const PLOTS: [Plot; 7] = [
    Plot {
        file: "stepping-double.svg",
        title: "One step is bound by memory, sixty by arithmetic",
        note: "Double, one thread. The book is its engine in Rust. Dashed is what the machine can do; lower is better.",
        x: "particles",
        y: EACH_STEP,
        group: "stepping",
        each: false,
        lines: &stepping("double", UNIFORM),
    },
    Plot {
        file: "stepping-single.svg",
        title: "In single: half the memory, twice the numbers at once",
        note: "Single, one thread. Dashed is what the machine can do; lower is better.",
        x: "particles",
        y: EACH_STEP,
        group: "stepping",
        each: false,
        lines: &stepping("single", UNIFORM),
    },
    Plot {
        file: "stepping-per-particle.svg",
        title: "Nothing shared: sixty steps keep up with arithmetic",
        note: "Double, one thread; each particle has its own acceleration, damping and mass. Dashed is what the machine can do; lower is better.",
        x: "particles",
        y: EACH_STEP,
        group: "stepping",
        each: false,
        lines: &stepping("double", EACH),
    },
    Plot {
        file: "growth.svg",
        title: "Under exact an advance takes the same for any number",
        note: "Double, one thread, damped: one advance of 1/60 s.",
        x: "particles",
        y: "time of an advance",
        group: "growth",
        each: false,
        lines: &[
            Line { name: "the book", colour: Ink, is_guide: false, of: ["double", UNIFORM, "the book"] },
            Line {
                name: "newton_euler",
                colour: Blue,
                is_guide: false,
                of: ["double", UNIFORM, "newton_euler, 1 step"],
            },
            Line {
                name: "exact, one read",
                colour: Pink,
                is_guide: false,
                of: ["double", UNIFORM, "exact, one particle read"],
            },
            Line { name: "exact", colour: Green, is_guide: false, of: ["double", UNIFORM, "exact"] },
        ],
    },
    Plot {
        file: "steps.svg",
        title: "More steps in one advance cost less each",
        note: "10,000 damped particles, newton_euler, one thread. Per-particle: each has an acceleration, a damping and a mass of its own.",
        x: "steps of one advance",
        y: EACH_STEP,
        group: "steps",
        each: false,
        lines: &[
            Line { name: "double, per-particle", colour: Pink, is_guide: false, of: ["double", EACH, "newton_euler"] },
            Line { name: "double, uniform", colour: Blue, is_guide: false, of: ["double", UNIFORM, "newton_euler"] },
            Line { name: "single, per-particle", colour: Green, is_guide: false, of: ["single", EACH, "newton_euler"] },
            Line { name: "single, uniform", colour: Ink, is_guide: false, of: ["single", UNIFORM, "newton_euler"] },
        ],
    },
    Plot {
        file: "threads.svg",
        title: "Large advances: a second thread nearly halves them",
        note: "Double, damped, newton_euler. Below 131,072 particle-steps one thread works alone.",
        x: "particles",
        y: EACH_STEP,
        group: "threads",
        each: false,
        lines: &[
            Line { name: "1 step, 1 thread", colour: Blue, is_guide: false, of: ["double", ONE_STEP, "1 thread"] },
            Line { name: "1 step, 2 threads", colour: Green, is_guide: false, of: ["double", ONE_STEP, "2 threads"] },
            Line { name: "60 steps, 1 thread", colour: Pink, is_guide: false, of: ["double", SIXTY_STEPS, "1 thread"] },
            Line {
                name: "60 steps, 2 threads",
                colour: Ink,
                is_guide: false,
                of: ["double", SIXTY_STEPS, "2 threads"],
            },
        ],
    },
    Plot {
        file: "tick.svg",
        title: "A tick that reads all: exact is ahead at 100,000",
        note: "Double. 1 % of the particles get a force, the world advances by 1/60 s, all are read. The loop moves and stores every particle.",
        x: "particles",
        y: "time of a tick, for each particle",
        group: "tick",
        each: true,
        lines: &[
            Line { name: "loop, damped", colour: Ink, is_guide: false, of: ["double", UNIFORM, "eager"] },
            Line { name: "loop, undamped", colour: Orange, is_guide: false, of: ["double", UNDAMPED, "eager"] },
            Line { name: "exact, damped", colour: Green, is_guide: false, of: ["double", UNIFORM, "exact"] },
            Line { name: "exact, undamped", colour: Blue, is_guide: false, of: ["double", UNDAMPED, "exact"] },
        ],
    },
];

const fn stepping(precision: &'static str, scene: &'static str) -> [Line; 5] {
    [
        Line { name: "the book", colour: Ink, is_guide: false, of: [precision, scene, "the book"] },
        Line { name: "1 step", colour: Blue, is_guide: false, of: [precision, scene, "newton_euler, 1 step"] },
        Line { name: "limit: memory", colour: Blue, is_guide: true, of: [precision, scene, "in-place update"] },
        Line { name: "60 steps", colour: Pink, is_guide: false, of: [precision, scene, "newton_euler, 60 steps"] },
        Line { name: "limit: arithmetic", colour: Pink, is_guide: true, of: [precision, scene, "add/mul peak"] },
    ]
}

pub(crate) fn draw(benchmarks: &Recorded) -> Vec<(String, String)> {
    let picture = |plot: &Plot| {
        let curve = |line: &Line| {
            let [precision, scene, contender] = line.of;
            let wanted = [("group", plot.group), ("precision", precision), ("scene", scene), ("contender", contender)];
            let rows = benchmarks.rows(&wanted);
            let points = rows.iter().map(|row| {
                let (size, ns) = (row.number("size"), row.number("median"));
                (size, if plot.each { ns / size } else { ns })
            });
            Curve { name: line.name.to_owned(), colour: line.colour, is_guide: line.is_guide, points: points.collect() }
        };
        let chart = Chart {
            title: plot.title,
            note: plot.note,
            x: Axis { name: plot.x, label: power_of_ten },
            y: Axis { name: plot.y, label: time },
            curves: plot.lines.iter().map(curve).collect(),
            origin: &benchmarks.origin,
        };
        (plot.file.to_owned(), chart.svg())
    };
    PLOTS.iter().map(picture).collect()
}
