//! The service under load and under faults, over loopback, as the process that its users run.
//!
//! `cargo bench --bench load` takes about three minutes, prints a table and writes `docs/load.md` and `docs/load.csv`.
//! `cargo bench --bench load -- fairness` runs one case and writes nothing. Without `--bench`, as in `cargo test`,
//! everything runs once at small size. Every case checks what it was answered, in both ways; a case that fails is named,
//! and the process ends with an error. A figure that misses its target is told, and is no failure.

#![expect(clippy::print_stdout, reason = "the tables are what it is for")]
#![expect(clippy::print_stderr, reason = "failed checks are for whoever runs it")]
#![expect(clippy::cast_precision_loss, reason = "counts of requests and bytes are far below 2⁵³")]

#[path = "../shared/case.rs"]
mod case;
#[path = "../shared/client.rs"]
mod client;
#[path = "../shared/echo.rs"]
mod echo;
mod ending;
mod fairness;
#[path = "../shared/host.rs"]
mod host;
#[path = "../shared/load.rs"]
mod load;
mod malformed;
mod many;
mod overload;
#[path = "../shared/report.rs"]
mod report;
#[path = "../shared/server.rs"]
#[expect(dead_code, reason = "what only the other benchmark of the service asks for")]
mod server;
mod slow;
#[path = "../shared/table.rs"]
mod table;
mod throughput;
mod tick;
#[path = "../shared/worlds.rs"]
mod worlds;

use std::process::ExitCode;

use case::Case;
use report::Page;

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

/// Where a whole run is written.
const PAGE: Page = Page {
    name: "load",
    title: "Load and faults",
    method: "
The service is the program that users run, in a process of its own; its clients are on the same machine and take their
share of its cores. A load goes by the clock: a latency counts from the moment when the schedule has a request, not from
when a connection was free to send it, and includes the time until the client is awake. What is compared ran in turns. The
machine may have been shared, so ratios hold better than times.

Every case also checks what it was answered, and writes nothing when a check fails: each accepted advance was applied
once, each world told its revisions without a gap, and at the end it is, to the bit, the world that the library makes of as
many advances.
",
    picture: "How long light worlds wait",
};

fn main() -> ExitCode {
    case::run(&CASES, &[(echo::CHILD, echo::serve)])
}
