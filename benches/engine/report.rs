//! The tables for people, the same numbers as CSV, and the page that shows them.

use std::fmt::Write;
use std::path::Path;

use crate::compare::{Case, Cell, Group, Measured};
use crate::host;
use crate::table::{aligned, digits, grouped, time};

pub(crate) fn print(groups: &[Group], measured: &[Measured]) {
    for group in groups {
        if let Some(table) = table(group, measured) {
            println!("\n{}\n\n{table}", group.title);
        }
    }
}

/// Writes `docs/benchmarks.md` and `docs/benchmarks.csv`.
pub(crate) fn write(groups: &[Group], measured: &[Measured]) -> Result<(), Box<dyn std::error::Error>> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    std::fs::create_dir_all(&docs)?;
    let mut page = String::from("# Benchmarks\n\nWritten by `cargo bench`; `benchmarks.csv` has every number.\n\n");
    for (what, value) in host::description() {
        writeln!(page, "* {what}: {value}")?;
    }
    page.push_str(METHOD);
    page.push_str(PICTURES);
    for group in groups {
        if let Some(table) = table(group, measured) {
            write!(page, "\n## {}\n\n{}\n\n{table}", group.title, group.note)?;
        }
    }
    std::fs::write(docs.join("benchmarks.md"), page)?;
    std::fs::write(docs.join("benchmarks.csv"), csv(measured))?;
    println!("\nwritten: docs/benchmarks.md and docs/benchmarks.csv; cargo run --example pictures draws them");
    Ok(())
}

const METHOD: &str = "
Everything that is compared ran side by side: round by round, each contender for some milliseconds, one right after the
other. A time is the median of the rounds, a ratio the median of the ratios within each round. The machine may have been
shared, so ratios hold better than times.
";

/// What `examples/pictures` draws.
const PICTURES: &str = "
## Pictures

![Time of a particle and step, double](stepping-double.svg)

The book takes one pow for each particle and step; the engine takes one for each distinct damping. Dashed is what the machine
can do: reading and writing position and velocity, and the adds and multiplies of a step in registers.

![Time of a particle and step, single](stepping-single.svg)

![Time of a particle and step, nothing shared](stepping-per-particle.svg)

One step reads acceleration, damping and mass of every particle; sixty steps read them once.

![Time of one advance, double](growth.svg)

Under `exact` an advance moves the clock, however many particles there are; a read of one particle evaluates that one.

![Time of a particle and step, over the steps of an advance](steps.svg)

More steps in one advance cost less each, until only arithmetic is left.

![One thread and two, double](threads.svg)

![A tick of a game server, double](tick.svg)

`exact` evaluates each particle from its last change; the plain loop moves and stores all of them at every tick.
";

/// `None` when nothing of the group was measured.
fn table(group: &Group, measured: &[Measured]) -> Option<String> {
    let measured: Vec<&Measured> = measured.iter().filter(|measured| measured.group == group.name).collect();
    let mut cases: Vec<&Case> = measured.iter().map(|measured| &measured.case).collect();
    cases.dedup();
    cases.sort_by_key(|case| case.precision.name());
    let mut rows = vec![["precision", "scene", group.size].map(str::to_owned).to_vec()];
    rows[0].extend(group.columns.iter().map(|column| column.0.to_owned()));
    for case in &cases {
        let find = |contender: &str| measured.iter().find(|m| m.case == **case && m.contender == contender).copied();
        let mut row = vec![case.precision.name().to_owned(), case.scene.clone(), grouped(case.size)];
        row.extend(group.columns.iter().map(|column| cell(&column.1, find).unwrap_or_else(|| "–".to_owned())));
        rows.push(row);
    }
    (!cases.is_empty()).then(|| aligned(&rows))
}

fn cell<'a>(cell: &Cell, find: impl Fn(&str) -> Option<&'a Measured>) -> Option<String> {
    Some(match *cell {
        Cell::Time(contender) => time(find(contender)?.median()),
        Cell::Rate(contender) => digits(1.0 / find(contender)?.median()),
        Cell::Bytes(contender) => format!("{:.1}", find(contender)?.median()),
        Cell::Ratio(slow, fast) => format!("{}×", digits(find(slow)?.ratio(find(fast)?))),
        Cell::Percent(least, ours) => format!("{:.0} %", 100.0 * find(least)?.ratio(find(ours)?)),
    })
}

fn csv(measured: &[Measured]) -> String {
    let mut text = String::from("group,precision,scene,size,contender,unit,median,best,rounds\n");
    for m in measured {
        let unit = if m.group == crate::memory::MEMORY.name { "B" } else { "ns" };
        let Case { precision, scene, size } = &m.case;
        let (best, median, rounds) = (m.best(), m.median(), m.values.len());
        writeln!(
            text,
            "{},{precision},\"{scene}\",{size},\"{}\",{unit},{median:.5},{best:.5},{rounds}",
            m.group, m.contender
        )
        .expect("a string takes it");
    }
    text
}
