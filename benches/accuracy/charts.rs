//! Which charts there are, and what each shows.

use pointmass::Precision;

use crate::chart::{Axis, Chart, Line, Mark, Panel, Style, nanoseconds, power_of_ten};
use crate::growth::{Curve, ENERGY, LONG, ORBITS, guide};
use crate::measure::Outcome;
use crate::method::Method;
use crate::work::{Point, Spec};

/// Errors below this are of the comparison, not of the run.
const FLOOR: f64 = 1e-16;

/// Error over run time, a panel for each precision.
pub(crate) fn work(spec: &Spec, points: &[&Point]) -> Chart {
    let panel = |precision: Precision| {
        let points: Vec<&Point> = points.iter().copied().filter(|point| point.precision == precision).collect();
        let lines: Vec<Line> = Method::ALL.into_iter().filter_map(|method| line(method, &points)).collect();
        let size = points.first().map_or(1.0, |point| point.size);
        let bottom = Panel::floor(&lines, FLOOR * size, size);
        Panel { title: precision.name().to_owned(), lines, top: top(size), bottom }
    };
    let unit = if spec.length.is_empty() { String::new() } else { format!(" in {}", spec.length) };
    Chart {
        title: spec.title.to_owned(),
        x: Axis { name: format!("run time per simulated {} and particle", spec.time), label: nanoseconds },
        y: Axis { name: format!("error at the end{unit}"), label: power_of_ten },
        panels: vec![panel(Precision::Double), panel(Precision::Single)],
    }
}

/// The panel for the front page: double precision alone.
pub(crate) fn front(spec: &Spec, points: &[&Point]) -> Chart {
    let mut chart = work(spec, points);
    chart.panels.truncate(1);
    chart
}

fn line(method: Method, points: &[&Point]) -> Option<Line> {
    let of: Vec<&Point> = points.iter().copied().filter(|point| point.method == method).collect();
    let mut line = Line {
        style: Style { name: method.integrator.to_string(), ..Style::of(method) },
        points: Vec::new(),
        marks: Vec::new(),
    };
    for point in &of {
        let cost = point.cost(point.outcome.seconds());
        match &point.outcome {
            Outcome::Done(run) => line.points.push((cost, run.error)),
            Outcome::Refused { .. } => line.marks.push((cost, Mark::Refused)),
            Outcome::NotRun { .. } => line.marks.push((cost, Mark::NotRun)),
        }
    }
    (!of.is_empty()).then_some(line)
}

/// The power of ten above.
fn top(size: f64) -> f64 {
    std::iter::successors(Some(1e-3), |power| Some(power * 10.0)).find(|power| *power >= 1.5 * size).unwrap_or(size)
}

/// Error over simulated time.
pub(crate) fn growth(curves: &[Curve]) -> Vec<(&'static str, Chart)> {
    let lines = |chart: &str, keep: &dyn Fn(&Curve) -> bool| -> Vec<Line> {
        curves.iter().filter(|curve| curve.chart == chart && keep(curve)).map(|curve| curve.line.clone()).collect()
    };
    let with_guide = |mut lines: Vec<Line>, name: &str, of: usize, exponent: f64| {
        let guide = lines.get(of).and_then(|line| guide(name, line, exponent));
        lines.extend(guide);
        lines
    };
    let plain = |power: i32| power_of_ten(power);
    let long = |scene: &'static str, title: &str| {
        let lines = with_guide(lines(LONG, &|curve| curve.scene == scene), "∝ √steps", 0, 0.5);
        let bottom = Panel::floor(&lines, FLOOR, 1.0);
        Panel { title: title.to_owned(), lines, top: 1.0, bottom }
    };
    let orbits = |precision: Precision, of: usize| {
        let lines = lines(ORBITS, &|curve| curve.precision == precision);
        let lines = with_guide(lines, "∝ orbits to the 3/2", of, 1.5);
        let bottom = Panel::floor(&lines, FLOOR, 1.0);
        Panel { title: precision.name().to_owned(), lines, top: 10.0, bottom }
    };
    let energy = with_guide(lines(ENERGY, &|_| true), "∝ √years", 5, 0.5);
    let bottom = Panel::floor(&energy, FLOOR, 1.0);
    vec![
        (
            LONG,
            Chart {
                title: "Rounding over a million steps of 1/60 s".to_owned(),
                x: Axis { name: "steps".to_owned(), label: plain },
                y: Axis { name: "error ÷ distance".to_owned(), label: power_of_ten },
                panels: vec![long("base", "damping 0.5"), long("weak", "damping 0.999")],
            },
        ),
        (
            ORBITS,
            Chart {
                title: "Kepler's orbit, eccentricity 0.9".to_owned(),
                x: Axis { name: "orbits".to_owned(), label: plain },
                y: Axis { name: "error".to_owned(), label: power_of_ten },
                panels: vec![orbits(Precision::Double, 4), orbits(Precision::Single, 4)],
            },
        ),
        (
            ENERGY,
            Chart {
                title: "Energy of the outer Solar System, double".to_owned(),
                x: Axis { name: "years".to_owned(), label: plain },
                y: Axis { name: "largest relative error of the energy so far".to_owned(), label: power_of_ten },
                panels: vec![Panel { title: String::new(), lines: energy, top: 10.0, bottom }],
            },
        ),
    ]
}
