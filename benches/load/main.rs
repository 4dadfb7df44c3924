//! The service under load and under faults, over loopback, as the process that its users run.
//!
//! `cargo bench --bench load` takes about three minutes, prints a table and writes `docs/load.md`, `docs/load.csv` and the
//! plot. `cargo bench --bench load -- fairness` runs one case and writes nothing. Without `--bench`, as in `cargo test`,
//! everything runs once at small size. Every case checks what it was answered, in both ways; a case that fails is named,
//! and the process ends with an error. A figure that misses its target is told, and is no failure.

#![expect(clippy::print_stdout, reason = "the tables are what it is for")]
#![expect(clippy::print_stderr, reason = "failed checks are for whoever runs it")]
#![expect(clippy::cast_precision_loss, reason = "counts of requests and bytes are far below 2⁵³")]

mod client;
#[path = "../shared/colours.rs"]
mod colours;
mod echo;
mod ending;
mod fairness;
#[path = "../shared/host.rs"]
mod host;
mod load;
mod malformed;
mod many;
mod overload;
mod plot;
mod report;
mod server;
mod slow;
#[path = "../shared/table.rs"]
mod table;
mod throughput;
mod tick;
mod worlds;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

use report::Bench;

/// A question, and how it is answered.
pub(crate) struct Case {
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    /// What is done and how it is measured, for the reader of the table.
    pub(crate) note: &'static str,
    pub(crate) run: fn(&mut Bench),
}

/// In the order of the report.
const CASES: [Case; 8] = [
    throughput::THROUGHPUT,
    tick::TICK,
    many::MANY,
    fairness::FAIRNESS,
    overload::OVERLOAD,
    slow::SLOW,
    malformed::MALFORMED,
    ending::ENDING,
];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |wanted: &str| arguments.iter().any(|argument| argument == wanted);
    if let [first, workers] = &arguments[..]
        && first == echo::CHILD
    {
        echo::serve(workers);
        return ExitCode::SUCCESS;
    }
    let measuring = has("--bench") && !has("--test");
    if !measuring && has("--list") {
        return ExitCode::SUCCESS; // For test runners: it is one check without a name.
    }
    let filter: Vec<&String> = arguments.iter().filter(|argument| !argument.starts_with("--")).collect();
    let mut bench = Bench::new(measuring);
    for case in &CASES {
        if !filter.is_empty() && !filter.iter().any(|filter| case.name.contains(filter.as_str())) {
            continue;
        }
        bench.case = case.name;
        if catch_unwind(AssertUnwindSafe(|| (case.run)(&mut bench))).is_err() {
            bench.check(false, || "it panicked, see above".to_owned());
        }
        if measuring {
            println!("\n{}\n\n{}", case.title, report::table(case, &bench.figures));
        }
    }
    for failure in &bench.failures {
        eprintln!("failed: {failure}");
    }
    if !bench.failures.is_empty() {
        return ExitCode::FAILURE;
    }
    // Only a whole run is worth recording.
    if arguments == ["--bench"] {
        report::write(&CASES, &bench).expect("docs/ can be written");
    }
    ExitCode::SUCCESS
}
