//! `docs/accuracy.csv`: error over run time, error over simulated time, and which steps are stable.

#![expect(clippy::disallowed_methods, reason = "powers that place marks; no state of a world comes of them")]

use crate::chart::{Axis, Chart, Curve, power_of_ten, time};
use crate::csv::{Recorded, Row};
use crate::svg::{Anchor, Colour, Picture};

/// A scene, the unit of its error, what its time is counted in, and what there is to see in double and in single.
const SCENES: [(&str, &str, &str, [&str; 2]); 7] = [
    (
        "base",
        " in m",
        "second",
        ["A damped throw: exact makes no step error", "A damped throw in single: many steps, much rounding"],
    ),
    (
        "weak",
        " in m",
        "second",
        [
            "4.6 hours of flight: only newton_euler needs short steps",
            "4.6 hours of flight in single: many steps lose digits",
        ],
    ),
    (
        "drag",
        " in m",
        "second",
        ["Drag: dop853 gets the most digits for its time", "Drag in single: short steps lose what dop853 keeps"],
    ),
    (
        "kepler",
        "",
        "unit of time",
        ["1000 eccentric orbits: dop853 alone finds the planet", "1000 eccentric orbits in single: nothing finds it"],
    ),
    (
        "outer",
        " in AU",
        "day",
        ["Planets for 100,000 years: dop853 within 10⁻⁶ AU", "Planets for 100,000 years: single is not enough"],
    ),
    (
        "pleiades",
        "",
        "unit of time",
        [
            "Close encounters: dop853 shortens its steps and wins",
            "Close encounters in single: three digits are left at best",
        ],
    ),
    (
        "arenstorf",
        "",
        "unit of time",
        [
            "Earth and Moon: dop853 shortens its steps and wins",
            "Earth and Moon in single: less than four digits are left",
        ],
    ),
];

/// At most five of them serve a scene: what is left out behaves like `newton_euler`, or costs what its plain form does.
const METHODS: [(&str, Colour); 6] = [
    ("newton_euler", Colour::Ink),
    ("semi_implicit_euler", Colour::Orange),
    ("velocity_verlet", Colour::Blue),
    ("rk4", Colour::Pink),
    ("dop853", Colour::Purple),
    ("exact", Colour::Green),
];

pub(crate) fn draw(accuracy: &Recorded) -> Vec<(String, String)> {
    let mut pictures = Vec::new();
    for (scene, unit, of_time, titles) in SCENES {
        for (precision, title) in ["double", "single"].into_iter().zip(titles) {
            let file = format!("accuracy-{scene}-{precision}.svg");
            pictures.push((file, work(accuracy, scene, precision, title, [unit, of_time])));
        }
    }
    for precision in ["double", "single"] {
        pictures.push((format!("accuracy-long-{precision}.svg"), long(accuracy, precision)));
        pictures.push((format!("accuracy-orbits-{precision}.svg"), orbits(accuracy, precision)));
    }
    pictures.push(("accuracy-energy.svg".to_owned(), energy(accuracy)));
    pictures.push(("accuracy-stability.svg".to_owned(), stability(accuracy)));
    pictures
}

fn work(accuracy: &Recorded, scene: &str, precision: &str, title: &str, [unit, of_time]: [&str; 2]) -> String {
    let done = |method: &str| {
        let wanted = [("group", "work"), ("scene", scene), ("precision", precision), ("method", method)];
        let rows = accuracy.rows(&wanted).into_iter().filter(|row| row.text("outcome") == "done");
        rows.map(|row| (row.number("ns_best"), row.number("error"))).collect::<Vec<_>>()
    };
    let has_exact = !done("exact").is_empty();
    let methods = METHODS.into_iter().filter(|(method, _)| match *method {
        "semi_implicit_euler" => !has_exact,
        "exact" => has_exact,
        _ => true,
    });
    let curve = |(method, colour): (&str, Colour)| Curve {
        name: method.to_owned(),
        colour,
        is_guide: false,
        points: done(method),
    };
    Chart {
        title,
        note: &format!("In {precision}. Each dot is a run: further left is faster, further down is more accurate."),
        x: Axis { name: &format!("run time of a simulated {of_time} and particle"), label: time },
        y: Axis { name: &format!("error at the end{unit}"), label: power_of_ten },
        curves: methods.map(curve).collect(),
        origin: &accuracy.origin,
    }
    .svg()
}

/// Error over simulated time.
fn curve(accuracy: &Recorded, of: [&str; 4], name: &str, colour: Colour) -> Curve {
    let [group, scene, precision, method] = of;
    let wanted =
        [("group", group), ("scene", scene), ("precision", precision), ("method", method), ("outcome", "done")];
    let rows = accuracy.rows(&wanted);
    // Less than that is of the comparison, not of the run.
    let points = rows.iter().map(|row| (row.number("value"), row.number("relative_error").max(1e-16)));
    Curve { name: name.to_owned(), colour, is_guide: false, points: points.collect() }
}

/// A power of x over the range of a curve, at twice its first point.
fn guide(name: &str, of: &Curve, exponent: f64) -> Curve {
    let [first, .., last] = of.points[..] else { panic!("{} has too few points", of.name) };
    let at = |x: f64| (x, 2.0 * first.1 * (x / first.0).powf(exponent));
    Curve { name: name.to_owned(), colour: Colour::Ink, is_guide: true, points: vec![at(first.0), at(last.0)] }
}

fn long(accuracy: &Recorded, precision: &str) -> String {
    let compensated = format!("{precision}, compensated");
    let of = |scene, method, name, colour| curve(accuracy, ["long", scene, precision, method], name, colour);
    let mut curves = vec![
        of("base", precision, "damping 0.5", Colour::Blue),
        of("weak", precision, "damping 0.999", Colour::Pink),
        of("base", &compensated, "0.5, compensated", Colour::Green),
        of("weak", &compensated, "0.999, compensated", Colour::Orange),
    ];
    curves.push(guide("unbiased rounding", &curves[1], 0.5));
    Chart {
        title: if precision == "double" {
            "A million steps: compensated sums stay at the last bit"
        } else {
            "A million steps in single: compensated sums lose nothing"
        },
        note: "velocity_verlet, steps of 1/60 s, a damped throw: all that is seen is rounding.",
        x: Axis { name: "steps", label: power_of_ten },
        y: Axis { name: "error ÷ distance", label: power_of_ten },
        curves,
        origin: &accuracy.origin,
    }
    .svg()
}

fn orbits(accuracy: &Recorded, precision: &str) -> String {
    let of = |method, name, colour| curve(accuracy, ["orbits", "kepler", precision, method], name, colour);
    let mut curves = vec![
        of("velocity_verlet, 1/6400 orbit", "velocity_verlet", Colour::Blue),
        of("rk4, 1/6400 orbit", "rk4", Colour::Pink),
        of("dop853 1e-7", "dop853, 1e-7", Colour::Purple),
        of("dop853 1e-17, comp.", "dop853, 1e-17, c.", Colour::Green),
    ];
    curves.push(guide("unbiased rounding", &curves[3], 1.5));
    Chart {
        title: if precision == "double" {
            "Eccentric orbits: dop853 is left with rounding alone"
        } else {
            "Eccentric orbits in single: none lasts a thousand"
        },
        note: "Kepler, eccentricity 0.9; 6400 steps an orbit; dop853: its tolerance, c.: compensated.",
        x: Axis { name: "orbits", label: power_of_ten },
        y: Axis { name: "error, in semi-major axes", label: power_of_ten },
        curves,
        origin: &accuracy.origin,
    }
    .svg()
}

fn energy(accuracy: &Recorded) -> String {
    let of = |method, name, colour| curve(accuracy, ["energy", "outer", "double", method], name, colour);
    let mut curves = vec![
        of("semi_implicit_euler, 40 d", "semi_implicit_euler", Colour::Orange),
        of("velocity_verlet, 40 d", "velocity_verlet", Colour::Blue),
        of("rk4, 40 d", "rk4", Colour::Pink),
        of("dop853 1e-17, comp.", "dop853, 1e-17, c.", Colour::Purple),
    ];
    curves.push(guide("unbiased rounding", &curves[3], 0.5));
    Chart {
        title: "Energy of planets: rk4 drifts, symplectic methods do not",
        note: "The outer Solar System, steps of 40 days; dop853: its tolerance, c.: compensated.",
        x: Axis { name: "years", label: power_of_ten },
        y: Axis { name: "largest relative error of the energy so far", label: power_of_ten },
        curves,
        origin: &accuracy.origin,
    }
    .svg()
}

const LEAST: f64 = 0.1;
const MOST: f64 = 1000.0;
const LEFT: f64 = 276.0;
const RIGHT: f64 = 776.0;

fn stability(accuracy: &Recorded) -> String {
    let mut picture = Picture::new(
        "Long steps: drag overturns Euler's methods and rk4, damping only rk4",
        "A particle that is slowed down, 200 steps of one length. Rate × step: 1 means that a step is as long as the time in which the velocity falls to 1/e.",
    );
    let place = |product: f64| LEFT + (product / LEAST).log10() / (MOST / LEAST).log10() * (RIGHT - LEFT);
    let look = |behaviour: &str| match behaviour {
        "decays" => (Colour::Green, 0.55),
        "grows or is refused" => (Colour::Pink, 0.85),
        _ => (Colour::Orange, 0.75),
    };
    let mut y = picture.head() + 4.0;
    for (x, behaviour) in [(16.0, "decays"), (140.0, "changes sign or overshoots"), (466.0, "grows or is refused")] {
        let (colour, opacity) = look(behaviour);
        picture.bar((x, y), (30.0, 20.0), colour, opacity);
        picture.text((x + 38.0, y + 17.0), Anchor::Start, behaviour);
    }
    y += 58.0;
    for (brake, product) in [
        ("damping", "damping, λ h with λ = −ln d"),
        ("linear drag", "linear drag, k₁ h / m"),
        ("quadratic drag", "quadratic drag, k₂ |v₀| h / m"),
    ] {
        picture.text((16.0, y), Anchor::Start, product);
        y += 14.0;
        let top = y;
        let rows = accuracy.rows(&[("group", "stability"), ("scene", brake)]);
        for alike in alike(&rows) {
            let mut height = 4.0;
            for integrator in &alike {
                picture.text((LEFT - 10.0, y + 17.0 + height), Anchor::End, integrator);
                height += 25.0;
            }
            let changes: Vec<&Row> = rows.iter().filter(|row| row.text("method") == alike[0]).collect();
            for (i, change) in changes.iter().enumerate() {
                let from = change.number("value");
                let end = changes.get(i + 1).map_or(MOST, |next| next.number("value"));
                let (colour, opacity) = look(change.text("outcome"));
                picture.bar((place(from), y), (place(end) - place(from), height), colour, opacity);
                if i > 0 && i + 1 == changes.len() {
                    picture.on_bar((place(from) + 8.0, y + height / 2.0 + 7.0), &format!("from {from:.2}"));
                }
            }
            y += height + 6.0;
        }
        for power in -1..=3 {
            let x = place(10_f64.powi(power));
            picture.grid((x, top), (x, y));
            let label = if power == -1 { "0.1".to_owned() } else { power_of_ten(10_f64.powi(power)) };
            picture.text((x, y + 20.0), Anchor::Middle, &label);
        }
        y += 62.0;
    }
    picture.origin(y - 14.0, &accuracy.origin);
    picture.finish(y)
}

/// Integrators whose behaviour changes at the same steps, in the order of the CSV.
fn alike<'a>(rows: &[Row<'a>]) -> Vec<Vec<&'a str>> {
    let changes = |method: &str| {
        let of = rows.iter().filter(|row| row.text("method") == method);
        of.map(|row| [row.text("value"), row.text("outcome")]).collect::<Vec<_>>()
    };
    let mut groups: Vec<Vec<&str>> = Vec::new();
    for row in rows {
        let method = row.text("method");
        if groups.iter().any(|group| group.contains(&method)) {
            continue;
        }
        match groups.iter_mut().find(|group| changes(group[0]) == changes(method)) {
            Some(group) => group.push(method),
            None => groups.push(vec![method]),
        }
    }
    groups
}
