//! The engine measured, always against something measured beside it in the same run.
//!
//! `cargo bench` takes some minutes, prints every table and writes `docs/benchmarks.md` and
//! `docs/benchmarks.csv`. `cargo bench -- stepping` measures one group and writes nothing. Without `--bench`, as in `cargo test`,
//! everything runs once at small size and is checked.

#![expect(clippy::print_stdout, reason = "the tables are what it is for")]
#![expect(clippy::cast_precision_loss, reason = "counts of particles and nanoseconds are far below 2⁵³")]

mod book;
mod compare;
mod exact;
#[path = "../shared/host.rs"]
mod host;
mod machine;
mod memory;
mod population;
mod report;
mod rest;
mod scene;
mod stepping;
#[path = "../shared/table.rs"]
mod table;
mod threads;

use compare::{Bench, Group};

/// In the order of the report.
const GROUPS: [Group; 10] = [
    stepping::STEPPING,
    stepping::GROWTH,
    stepping::STEPS,
    threads::THREADS,
    exact::READING,
    exact::TICK,
    rest::REST,
    population::POPULATION,
    memory::MEMORY,
    machine::MACHINE,
];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |wanted: &str| arguments.iter().any(|argument| argument == wanted);
    if let [first, way] = &arguments[..]
        && first == memory::CHILD
    {
        return memory::measure_here(way);
    }
    let measuring = has("--bench") && !has("--test");
    if !measuring && has("--list") {
        return; // For test runners: it is one check without a name.
    }
    let mut bench = if measuring { Bench::measuring() } else { Bench::checking() };
    if !measuring {
        book::check();
        exact::check();
    }
    for group in &GROUPS {
        bench.run(group);
    }
    if measuring {
        // Only a whole run is worth recording.
        report::print(&GROUPS, &bench.measured);
        if arguments == ["--bench"] {
            report::write(&GROUPS, &bench.measured).expect("docs/ can be written");
        }
    }
}
