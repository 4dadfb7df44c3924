//! The tables for people, the same numbers as CSV, and the page that shows them.

use std::fmt::Write;
use std::path::Path;

use crate::compare::{Case, Cell, Group, Measured};
use crate::host;
use crate::plots;
use crate::table::{aligned, digits, grouped, time};

pub(crate) fn print(groups: &[Group], measured: &[Measured]) {
    for group in groups {
        if let Some(table) = table(group, measured) {
            println!("\n{}\n\n{table}", group.title);
        }
    }
}

/// Writes `docs/benchmarks.md`, `docs/benchmarks.csv` and the plots.
pub(crate) fn write(groups: &[Group], measured: &[Measured]) -> Result<(), Box<dyn std::error::Error>> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    std::fs::create_dir_all(&docs)?;
    let mut page = String::from("# Benchmarks\n\nWritten by `cargo bench`; `benchmarks.csv` has every number.\n\n");
    for (what, value) in host::description() {
        writeln!(page, "* {what}: {value}")?;
    }
    page.push_str(METHOD);
    page.push_str("\n## Plots\n");
    for plot in &plots::PLOTS {
        plot.draw(&docs.join(plot.file), measured)?;
        write!(page, "\n![{}]({})\n\n{}\n", plot.title, plot.file, plot.caption)?;
    }
    for group in groups {
        if let Some(table) = table(group, measured) {
            write!(page, "\n## {}\n\n{}\n\n{table}", group.title, group.note)?;
        }
    }
    std::fs::write(docs.join("benchmarks.md"), page)?;
    std::fs::write(docs.join("benchmarks.csv"), csv(measured))?;
    println!("\nwritten: docs/benchmarks.md, docs/benchmarks.csv and the plots");
    Ok(())
}

const METHOD: &str = "
Everything that is compared ran side by side: round by round, each contender for some milliseconds, one right after the
other. A time is the median of the rounds, a ratio the median of the ratios within each round. The machine may have been
shared, so ratios hold better than times.
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
