//! The page with the pictures and tables, the same numbers as CSV, and the table of the guide to the integrators.

use std::fmt::Write;
use std::path::Path;

use pointmass::{Integrator, Precision};

use crate::growth::{Curve, ENERGY, LONG, ORBITS};
use crate::host;
use crate::measure::Outcome;
use crate::method::{Method, Setting};
use crate::stability::{Behaviour, Brake, Row, threshold};
use crate::table::{aligned, grouped, time};
use crate::work::{Point, SPECS, Spec, best, cheapest, value};

/// All that was measured.
#[derive(Debug, Default)]
pub(crate) struct Results {
    pub(crate) points: Vec<Point>,
    pub(crate) curves: Vec<Curve>,
    pub(crate) rows: Vec<Row>,
}

/// Files by name, below `docs/`.
type Files = Vec<(String, String)>;

const HEAD: &str = "# Accuracy

Run time against error, for every integrator. Written by `cargo bench --bench accuracy`, which takes some minutes;
[accuracy.csv](accuracy.csv) has every number. [integrators.md](integrators.md) tells which integrator is for which
scene.

";

const METHOD: &str = "
**Error** is the largest distance of a particle, at the end, from where it should be: in the unit of length of the
scene, and in the tables also relative to its size. The reference solutions, of 36 digits, are in
`tests/reference/scenes.txt`, with their recipe beside them. A single-precision world is held against the solution
of its own, rounded, numbers, so that errors are those of the integrator.

**Time** is that of the advance and of one read of all particles, on one thread, for a simulated unit of time and a
particle. Scenes without gravitation hold 64 particles that start alike. It is the best of seven runs, taken round
by round over all methods; of three above 50 ms, and of one above half a second. The CSV has the median and the
worst too. The machine may have been shared, so that times are good for a factor of two, errors to the bit.

**Sweeps**: fixed steps; `dop853` over relative tolerances from 1e-3 to 1e-17 (1e-9 in single), with an absolute
tolerance of 0; the closed form in one advance and in 600. What the engine refused, and what was not run because a
pilot run told that it would take more than nine seconds (three with fixed steps), is in the tables. The pictures show at
most five methods; the tables have them all.

";

/// Writes the page and the CSV into a folder.
pub(crate) fn write(results: &Results, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(folder)?;
    for (name, text) in files(results)? {
        std::fs::write(folder.join(name), text)?;
    }
    Ok(())
}

/// Puts the measured table into the guide to the integrators.
pub(crate) fn write_guide(results: &Results, docs: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let guide = docs.join("integrators.md");
    std::fs::write(&guide, with_table(&std::fs::read_to_string(&guide)?, &guide_table(results))?)?;
    Ok(())
}

/// The page and the CSV.
pub(crate) fn files(results: &Results) -> Result<Files, Box<dyn std::error::Error>> {
    let mut page = String::from(HEAD);
    for (what, value) in host::description() {
        writeln!(page, "* {what}: {value}")?;
    }
    page.push_str(METHOD);
    write!(page, "## At a glance\n\n{}\n", summaries(results))?;
    page.push_str("## Run time against error\n");
    for spec in &SPECS {
        let points: Vec<&Point> = results.points.iter().filter(|point| point.spec.name == spec.name).collect();
        if points.is_empty() {
            continue;
        }
        let pictures = pictures(spec.title, spec.name);
        write!(page, "\n### {}\n\n{}\n\n{pictures}\n{}\n", spec.title, spec.about, reading(spec, &points))?;
    }
    page.push_str("\n## Error over simulated time\n");
    for (name, title) in
        [(LONG, "Rounding over a million steps of 1/60 s"), (ORBITS, "Kepler's orbit, eccentricity 0.9")]
    {
        write!(page, "\n### {title}\n\n{}\n{}\n", pictures(title, name), about(name, results))?;
    }
    let title = "Energy of the outer Solar System, double";
    write!(page, "\n### {title}\n\n![{title}](accuracy-energy.svg)\n\n{}\n", about(ENERGY, results))?;
    page.push_str("\n## Stability\n\n![Which steps are stable](accuracy-stability.svg)\n");
    write!(page, "\n{}\n", stability_note(results))?;
    page.push_str("\n## Tables\n\nError, and the time for a simulated unit of time and a particle.\n");
    for spec in &SPECS {
        for precision in [Precision::Double, Precision::Single] {
            let of = |point: &&Point| point.spec.name == spec.name && point.precision == precision;
            let points: Vec<&Point> = results.points.iter().filter(of).collect();
            if !points.is_empty() {
                write!(page, "\n### {}, {precision}\n\n{}", spec.title, table(spec, &points))?;
            }
        }
    }
    Ok(vec![("accuracy.md".to_owned(), page), ("accuracy.csv".to_owned(), csv(results)?)])
}

/// What `examples/pictures` draws, for each precision.
fn pictures(title: &str, name: &str) -> String {
    [Precision::Double, Precision::Single]
        .map(|precision| format!("![{title}, {precision}](accuracy-{name}-{precision}.svg)\n"))
        .join("\n")
}

/// An error with two digits.
fn number(error: f64) -> String {
    if (0.01..1000.0).contains(&error) { crate::table::digits(error) } else { format!("{error:.1e}") }
}

fn with_unit(spec: &Spec, error: f64) -> String {
    let unit = if spec.length.is_empty() { String::new() } else { format!(" {}", spec.length) };
    format!("{}{unit}", number(error))
}

/// Integrators that serve a scene, from the fastest that gets within a relative error, and the others with their best.
fn reading(spec: &Spec, points: &[&Point]) -> String {
    const ERROR: f64 = 1e-6;
    let mut text = String::new();
    let double: Vec<&Point> = points.iter().copied().filter(|point| point.precision == Precision::Double).collect();
    let Some(size) = double.first().map(|point| point.size) else { return text };
    let mut good: Vec<&Point> = Vec::new();
    let mut others = Vec::new();
    for integrator in Integrator::ALL {
        let ways = [Method::plain(integrator), Method::compensated(integrator)];
        let fastest = ways.iter().filter_map(|method| cheapest(&double, *method, ERROR));
        if let Some(point) = fastest.min_by(|a, b| a.outcome.seconds().total_cmp(&b.outcome.seconds())) {
            good.push(point);
        } else if let Some(point) = best(&double, Method::plain(integrator)) {
            let error = point.outcome.run().map_or(f64::NAN, |run| run.error);
            others.push(format!("`{integrator}` {}", with_unit(spec, error)));
        }
    }
    good.sort_by(|a, b| a.outcome.seconds().total_cmp(&b.outcome.seconds()));
    let told = good
        .iter()
        .map(|point| format!("`{}` in {} ({})", point.method, time(point.outcome.seconds() * 1e9), setting(point)));
    let told: Vec<String> = told.collect();
    let within = with_unit(spec, ERROR * size);
    if told.is_empty() {
        write!(text, "Nothing ends within {within} in double.").expect("a string takes it");
    } else {
        write!(text, "Within {within} in double, the whole run: {}.", told.join(", ")).expect("a string takes it");
    }
    if !others.is_empty() {
        write!(text, " Not within it, at best: {}.", others.join(", ")).expect("a string takes it");
    }
    for precision in [Precision::Double, Precision::Single] {
        let of: Vec<&Point> = points.iter().copied().filter(|point| point.precision == precision).collect();
        if let Some(point) = Method::ALL
            .into_iter()
            .filter_map(|method| best(&of, method))
            .min_by(|a, b| a.relative_error().partial_cmp(&b.relative_error()).expect("errors are numbers"))
        {
            let error = point.outcome.run().map_or(f64::NAN, |run| run.error);
            let seconds = time(point.outcome.seconds() * 1e9);
            write!(
                text,
                " The least error in {precision} is {}, of `{}` in {seconds} ({}).",
                with_unit(spec, error),
                point.method,
                setting(point)
            )
            .expect("a string takes it");
        }
    }
    text
}

fn setting(point: &Point) -> String {
    match point.setting {
        Setting::Advances(_) => point.label.clone(),
        Setting::Steps(_) => format!("steps of {}", point.label),
        Setting::Tolerance(_) => format!("tolerance {}", point.label),
    }
}

/// One line for each scene and precision: how long each integrator takes for an error, and its least error.
fn summaries(results: &Results) -> String {
    let mut text = String::new();
    for error in [1e-3, 1e-6, 1e-9] {
        writeln!(text, "The time of the whole run to end within {error:.0e} of the size of the scene, in double:\n")
            .expect("a string takes it");
        text.push_str(&summary(results, Precision::Double, |points, integrator| {
            let ways = [Method::plain(integrator), Method::compensated(integrator)];
            let fastest = ways.iter().filter_map(|method| cheapest(points, *method, error));
            let fastest = fastest.min_by(|a, b| a.outcome.seconds().total_cmp(&b.outcome.seconds()))?;
            Some(time(fastest.outcome.seconds() * 1e9))
        }));
        text.push('\n');
    }
    for precision in [Precision::Double, Precision::Single] {
        writeln!(text, "The least error of the sweep, relative to the size of the scene, in {precision}:\n")
            .expect("a string takes it");
        text.push_str(&summary(results, precision, least_error));
        text.push('\n');
    }
    text
}

fn least_error(points: &[&Point], integrator: Integrator) -> Option<String> {
    let ways = [Method::plain(integrator), Method::compensated(integrator)];
    let least = ways.iter().filter_map(|method| best(points, *method)?.relative_error()).reduce(f64::min)?;
    Some(if least > 1.0 { "> 1".to_owned() } else { format!("{least:.1e}") })
}

fn summary(results: &Results, precision: Precision, cell: impl Fn(&[&Point], Integrator) -> Option<String>) -> String {
    let mut rows = vec![vec!["scene".to_owned(), "size".to_owned()]];
    rows[0].extend(Integrator::ALL.iter().map(|integrator| format!("`{integrator}`")));
    for spec in &SPECS {
        let of = |point: &&Point| point.spec.name == spec.name && point.precision == precision;
        let points: Vec<&Point> = results.points.iter().filter(of).collect();
        let Some(first) = points.first() else { continue };
        let mut row = vec![spec.name.to_owned(), size(spec, first.size)];
        row.extend(Integrator::ALL.map(|integrator| cell(&points, integrator).unwrap_or_else(|| "–".to_owned())));
        rows.push(row);
    }
    aligned(&rows)
}

fn size(spec: &Spec, size: f64) -> String {
    let number = if size < 1000.0 { format!("{size:.0}") } else { format!("{size:.1e}") };
    if spec.length.is_empty() { number } else { format!("{number} {}", spec.length) }
}

/// Rows are settings, columns methods: a table for steps, one for tolerances and one for advances.
fn table(spec: &Spec, points: &[&Point]) -> String {
    let kind = |point: &Point| match point.setting {
        Setting::Steps(_) => "step",
        Setting::Tolerance(_) => "tolerance",
        Setting::Advances(_) => "advances",
    };
    let mut tables = Vec::new();
    for what in ["step", "tolerance", "advances"] {
        let of: Vec<&Point> = points.iter().copied().filter(|point| kind(point) == what).collect();
        let methods: Vec<Method> = Method::ALL.into_iter().filter(|m| of.iter().any(|p| p.method == *m)).collect();
        let mut labels: Vec<&str> = Vec::new();
        for point in &of {
            if !labels.contains(&point.label.as_str()) {
                labels.push(&point.label);
            }
        }
        let mut rows = vec![vec![what.to_owned(), String::new()]];
        rows[0].extend(methods.iter().map(|method| format!("`{method}`")));
        for label in labels {
            let find = |method: &Method| of.iter().find(|p| p.method == *method && p.label == label);
            let mut row = vec![label.to_owned(), spec.length.to_owned()];
            row.extend(methods.iter().map(|method| find(method).map_or_else(|| "–".to_owned(), |point| cell(point))));
            rows.push(row);
        }
        if !of.is_empty() {
            tables.push(aligned(&rows));
        }
    }
    tables.join("\n")
}

fn cell(point: &Point) -> String {
    match &point.outcome {
        Outcome::Done(run) => format!("{}, {}", number(run.error), time(point.cost(run.best()))),
        Outcome::Refused { reason, .. } => (*reason).to_owned(),
        Outcome::NotRun { seconds, at_least } => {
            format!("not run: {} {}", if *at_least { "more than" } else { "about" }, time(seconds * 1e9))
        }
    }
}

fn about(chart: &str, results: &Results) -> String {
    let last = |curve: &Curve| curve.points.last().map_or(f64::NAN, |point| point.1);
    let ends = |keep: &dyn Fn(&Curve) -> bool| {
        let of = results.curves.iter().filter(|curve| curve.chart == chart && keep(curve));
        of.map(|curve| format!("{} {}", curve.name, number(last(curve)))).collect::<Vec<_>>().join("; ")
    };
    match chart {
        LONG => format!(
            "`velocity_verlet` takes exact steps where nothing depends on position, so all that is seen is rounding. \
             Plain sums drift; compensated sums stay at the rounding of the result. The guide is what unbiased \
             rounding would do. Held against `exact` in double, so that 10⁻¹⁶ is the least that can be told. After \
             a million steps: with damping 0.5 {}; with damping 0.999 {}.",
            ends(&|curve| curve.scene == "base"),
            ends(&|curve| curve.scene == "weak")
        ),
        ORBITS => format!(
            "The error of the position at the end of whole periods; the guide is what unbiased rounding does to a \
             phase. After the last: in double {}; in single {}.",
            ends(&|curve| curve.precision == Precision::Double),
            ends(&|curve| curve.precision == Precision::Single)
        ),
        ENERGY => format!(
            "A symplectic integrator keeps the energy within a band, the others drift: by the tolerance, and where that \
             is the least by rounding. The guide is what unbiased rounding would do. At the end: {}.",
            ends(&|_| true)
        ),
        _ => String::new(),
    }
}

fn stability_note(results: &Results) -> String {
    let mut text = String::from(
        "A particle with only its velocity, 200 steps of one length. Rate and step matter as a product, so one number \
         stands for both: damping 0.5 has λ = ln 2 per second. The integrators of Euler's kind apply damping as a \
         factor, which no step is too long for, but drag as a force; `velocity_verlet` takes the flow of both; \
         `dop853` shortens its steps. Where the velocity begins to grow: ",
    );
    let mut limits = Vec::new();
    for brake in Brake::ALL {
        for row in results.rows.iter().filter(|row| row.brake == brake) {
            if let Some((product, _)) = row.changes.iter().find(|(_, behaviour)| *behaviour == Behaviour::Grows) {
                limits.push(format!("`{}` {} with {}", row.integrator, threshold(*product), brake.name()));
            }
        }
    }
    text.push_str(&limits.join(", "));
    text.push('.');
    text
}

const BEGIN: &str = "<!-- measured: cargo bench --bench accuracy writes this -->\n";
const END: &str = "<!-- end -->";

/// The guide with a new table between its two marks.
fn with_table(guide: &str, table: &str) -> Result<String, Box<dyn std::error::Error>> {
    let (before, rest) = guide.split_once(BEGIN).ok_or("integrators.md has lost its first mark")?;
    let (_, after) = rest.split_once(END).ok_or("integrators.md has lost its second mark")?;
    Ok(format!("{before}{BEGIN}\n{table}\n{END}{after}"))
}

/// What [`with_table`] puts there.
fn guide_table(results: &Results) -> String {
    let mut text = String::new();
    let of = host::description();
    let find = |what: &str| of.iter().find(|(name, _)| *name == what).map_or("unknown", |(_, value)| value.as_str());
    writeln!(
        text,
        "{}, commit {}, {}. The time of a whole run that ends within 1e-6 of the size of the scene, in double; a dash \
         where no run of the sweep does:\n",
        find("processor"),
        find("commit"),
        find("date")
    )
    .expect("a string takes it");
    text.push_str(&summary(results, Precision::Double, |points, integrator| {
        let ways = [Method::plain(integrator), Method::compensated(integrator)];
        let fastest = ways.iter().filter_map(|method| cheapest(points, *method, 1e-6));
        let fastest = fastest.min_by(|a, b| a.outcome.seconds().total_cmp(&b.outcome.seconds()))?;
        Some(time(fastest.outcome.seconds() * 1e9))
    }));
    text.push_str("\nThe least error that a run of the sweep ends with, relative to the size of the scene:\n\n");
    text.push_str(&summary(results, Precision::Double, least_error));
    text
}

fn csv(results: &Results) -> Result<String, std::fmt::Error> {
    let mut text = String::from(
        "group,scene,precision,method,setting,value,outcome,error,relative_error,\
         ns_median,ns_best,ns_worst,runs,steps,rejected,evaluations\n",
    );
    for point in &results.points {
        let (setting, value) = value(point.setting, point.duration);
        let what = format!("work,{},{},\"{}\",{setting},{value:e}", point.spec.name, point.precision, point.method);
        match &point.outcome {
            Outcome::Done(run) => writeln!(
                text,
                "{what},done,{:e},{:e},{:.5e},{:.5e},{:.5e},{},{},{},{}",
                run.error,
                run.error / point.size,
                point.cost(run.median()),
                point.cost(run.best()),
                point.cost(run.worst()),
                run.seconds.len(),
                run.steps,
                run.rejected,
                run.evaluations
            )?,
            Outcome::Refused { reason, seconds } => {
                writeln!(text, "{what},{reason},,,{:.5e},,,,,,", point.cost(*seconds))?;
            }
            Outcome::NotRun { seconds, at_least } => {
                let outcome = if *at_least { "not run: at least" } else { "not run: about" };
                writeln!(text, "{what},{outcome},,,{:.5e},,,,,,", point.cost(*seconds))?;
            }
        }
    }
    for curve in &results.curves {
        let what = format!("{},{},{},\"{}\"", curve.chart, curve.scene, curve.precision, curve.name);
        for (x, y) in &curve.points {
            writeln!(text, "{what},after,{x:e},done,,{y:e},,,,,,,")?;
        }
        if let Some(x) = curve.refused {
            writeln!(text, "{what},after,{x:e},refused,,,,,,,,,")?;
        }
    }
    for row in &results.rows {
        for (product, behaviour) in &row.changes {
            let (brake, integrator) = (row.brake.name(), row.integrator);
            writeln!(
                text,
                "stability,{brake},double,{integrator},from,{product:.4},\"{}\",,,,,,,,,",
                behaviour.name()
            )?;
        }
    }
    Ok(text)
}

pub(crate) fn print(results: &Results) -> String {
    let count = |keep: fn(&Outcome) -> bool| grouped(results.points.iter().filter(|p| keep(&p.outcome)).count());
    format!(
        "{}{} runs done, {} refused, {} not run",
        summaries(results),
        count(|outcome| matches!(outcome, Outcome::Done(_))),
        count(|outcome| matches!(outcome, Outcome::Refused { .. })),
        count(|outcome| matches!(outcome, Outcome::NotRun { .. }))
    )
}
