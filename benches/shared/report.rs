//! What was measured, beside what was asked for: for people, as CSV, and as a page.

use std::fmt::Write;
use std::path::Path;

use crate::case::Case;
use crate::load::Latencies;
use crate::table::{aligned, digits, grouped, time};
use crate::{PAGE, host};

/// The page of a benchmark.
pub(crate) struct Page {
    /// Of its files, and as it is called.
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    pub(crate) method: &'static str,
    /// What `examples/pictures` draws of it.
    pub(crate) picture: &'static str,
}

/// Collects figures and failed checks.
#[derive(Debug)]
pub(crate) struct Bench {
    measuring: bool,
    /// How many threads of the machine wanted to run before there was a load of ours, on average of a minute.
    others: String,
    /// The one that runs.
    pub(crate) case: &'static str,
    pub(crate) figures: Vec<Figure>,
    pub(crate) failures: Vec<String>,
}

#[derive(Debug)]
pub(crate) struct Figure {
    case: &'static str,
    what: String,
    value: f64,
    /// The lower and the upper, where the value is a median.
    quartiles: Option<[f64; 2]>,
    unit: Unit,
    target: Option<Target>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) enum Unit {
    Seconds,
    PerSecond,
    Count,
    Bytes,
    Ratio,
    Percent,
}

#[derive(Debug, Clone, Copy)]
enum Target {
    AtLeast(f64),
    AtMost(f64),
}

impl Bench {
    pub(crate) fn new(measuring: bool) -> Self {
        let average = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
        let others = average.split(' ').next().unwrap_or_default().to_owned();
        Self { measuring, others, case: "", figures: Vec::new(), failures: Vec::new() }
    }

    /// The first when it measures, the second when it only checks.
    pub(crate) fn size<T>(&self, measuring: T, checking: T) -> T {
        if self.measuring { measuring } else { checking }
    }

    /// What has to hold at any speed.
    pub(crate) fn check(&mut self, holds: bool, otherwise: impl FnOnce() -> String) {
        if !holds {
            self.failures.push(format!("{}: {}", self.case, otherwise()));
        }
    }

    pub(crate) fn record(&mut self, what: impl Into<String>, value: f64, unit: Unit) -> &mut Figure {
        self.figures.push(Figure { case: self.case, what: what.into(), value, quartiles: None, unit, target: None });
        self.figures.last_mut().expect("it was put there above")
    }

    /// Median, p99 and p99.9.
    pub(crate) fn record_latencies(&mut self, what: &str, latencies: &Latencies) {
        for (name, share) in [("median", 0.5), ("p99", 0.99), ("p99.9", 0.999)] {
            self.record(format!("{what}, {name}"), latencies.within(share), Unit::Seconds);
        }
    }
}

impl Figure {
    pub(crate) fn between(&mut self, quartiles: [f64; 2]) -> &mut Self {
        self.quartiles = Some(quartiles);
        self
    }

    pub(crate) fn at_least(&mut self, target: f64) {
        self.target = Some(Target::AtLeast(target));
    }

    pub(crate) fn at_most(&mut self, target: f64) {
        self.target = Some(Target::AtMost(target));
    }

    fn row(&self) -> [String; 5] {
        let show = |value| self.unit.show(value);
        let (target, is_met) = match self.target {
            Some(Target::AtLeast(target)) => (format!("≥ {}", show(target)), Some(self.value >= target)),
            Some(Target::AtMost(target)) => (format!("≤ {}", show(target)), Some(self.value <= target)),
            None => (String::new(), None),
        };
        let quartiles =
            self.quartiles.map_or_else(String::new, |[lower, upper]| format!("{} to {}", show(lower), show(upper)));
        let is_met = is_met.map_or("", |is_met| if is_met { "yes" } else { "no" });
        [self.what.clone(), target, show(self.value), quartiles, is_met.to_owned()]
    }
}

impl Unit {
    fn show(self, value: f64) -> String {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
        let count = || grouped(value.round() as usize);
        match self {
            _ if value.is_nan() => "–".to_owned(),
            Self::Seconds => time(1e9 * value),
            Self::PerSecond => format!("{} /s", count()),
            Self::Count => count(),
            // Of one particle, or of a process.
            Self::Bytes if value.abs() < 4096.0 => format!("{} B", digits(value)),
            Self::Bytes => format!("{} MiB", digits(value / f64::from(1 << 20))),
            Self::Ratio => format!("{}×", digits(value)),
            Self::Percent => format!("{:.1} %", 100.0 * value),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Seconds => "s",
            Self::PerSecond => "1/s",
            Self::Count | Self::Ratio | Self::Percent => "1",
            Self::Bytes => "B",
        }
    }
}

pub(crate) fn table(case: &Case, figures: &[Figure]) -> String {
    let mut rows = vec![["figure", "target", "measured", "quartiles", "met"].map(str::to_owned).to_vec()];
    rows.extend(figures.iter().filter(|figure| figure.case == case.name).map(|figure| figure.row().to_vec()));
    if rows[1..].iter().all(|row| row[3].is_empty()) {
        for row in &mut rows {
            row.remove(3);
        }
    }
    aligned(&rows)
}

/// Writes the page, and every number as CSV.
pub(crate) fn write(cases: &[Case], bench: &Bench) -> Result<(), Box<dyn std::error::Error>> {
    let Page { name, title, method, picture } = PAGE;
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let mut page = format!("# {title}\n\nWritten by `cargo bench --bench {name}`; `{name}.csv` has every number.\n\n");
    for (what, value) in host::description() {
        writeln!(page, "* {what}: {value}")?;
    }
    writeln!(page, "* load average before the run: {}", bench.others)?;
    page.push_str(method);
    write!(page, "\n![{picture}]({name}.svg)\n")?;
    let mut csv = String::from("case,figure,unit,measured,at_least,at_most,lower_quartile,upper_quartile\n");
    for case in cases {
        write!(page, "\n## {}\n\n{}\n\n{}", case.title, case.note, table(case, &bench.figures))?;
    }
    for figure in &bench.figures {
        let (least, most) = match figure.target {
            Some(Target::AtLeast(target)) => (target.to_string(), String::new()),
            Some(Target::AtMost(target)) => (String::new(), target.to_string()),
            None => (String::new(), String::new()),
        };
        let quartiles =
            figure.quartiles.map_or_else(|| ",".to_owned(), |[lower, upper]| format!("{lower:.9},{upper:.9}"));
        let Figure { case, what, value, unit, .. } = figure;
        writeln!(csv, "{case},\"{what}\",{},{value:.9},{least},{most},{quartiles}", unit.name())?;
    }
    std::fs::write(docs.join(format!("{name}.md")), page)?;
    std::fs::write(docs.join(format!("{name}.csv")), csv)?;
    println!("\nwritten: docs/{name}.md and docs/{name}.csv; cargo run --example pictures draws them");
    Ok(())
}
