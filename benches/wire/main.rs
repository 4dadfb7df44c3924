//! State in and out over loopback: what a particle costs in each encoding, ticks and batches in one request, streams, and
//! snapshots.
//!
//! `cargo bench --bench wire` takes about three minutes, prints tables and writes `docs/wire.md` and `docs/wire.csv`.
//! `cargo bench --bench wire -- tick` runs one case and writes nothing. Without `--bench`, as in `cargo test`,
//! everything runs once at small size. Every case checks what it was answered against the library; a case that fails is
//! named, and the process ends with an error. A figure that misses its target is told, and is no failure.

#![expect(clippy::print_stdout, reason = "the tables are what it is for")]
#![expect(clippy::print_stderr, reason = "failed checks are for whoever runs it")]
#![expect(clippy::cast_precision_loss, reason = "counts of particles and bytes are far below 2⁵³")]

mod batch;
#[path = "../shared/case.rs"]
mod case;
mod cbor;
#[path = "../shared/client.rs"]
#[expect(dead_code, reason = "what only the other benchmark of the service asks for")]
mod client;
mod create;
#[path = "../shared/echo.rs"]
mod echo;
mod follower;
#[path = "../shared/host.rs"]
mod host;
mod large;
#[path = "../shared/load.rs"]
#[expect(dead_code, reason = "what only the other benchmark of the service asks for")]
mod load;
mod out;
mod raw;
#[path = "../shared/report.rs"]
mod report;
mod rounds;
mod scene;
#[path = "../shared/server.rs"]
#[expect(dead_code, reason = "what only the other benchmark of the service asks for")]
mod server;
mod snapshot;
mod stream;
#[path = "../shared/table.rs"]
mod table;
mod tick;
#[path = "../shared/worlds.rs"]
mod worlds;

use std::process::ExitCode;

use case::Case;
use report::Page;

/// In the order of the report.
const CASES: [Case; 7] =
    [out::OUT, large::LARGE, create::CREATE, tick::TICK, batch::BATCH, stream::STREAM, snapshot::SNAPSHOT];

/// Where a whole run is written.
const PAGE: Page = Page {
    name: "wire",
    title: "State in and out",
    method: "
The service is the program that users run, in a process of its own, over loopback; its clients are on the same machine and
take their share of its cores. What is compared ran in rounds, in each of which every contender runs once, another one first
each time; a figure is the median of the rounds, a ratio the median of the ratios within the rounds. The raw socket is a
process that sends as many bytes from memory, in pieces of 256 KiB, or takes as many; the same client reads and writes on
both, into memory that it has already. The machine may have been shared, so ratios hold better than times.

Every case also checks what it was answered, and writes nothing when a check fails: each encoding, each event and each world
in the end is, to the bit, what the library says.
",
    picture: "What a particle costs",
};

fn main() -> ExitCode {
    case::run(&CASES, &[(echo::CHILD, echo::serve), (raw::CHILD, raw::serve)])
}
