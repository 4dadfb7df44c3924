//! A chart: both axes in powers of ten, the names of curves beside them.

#![expect(clippy::disallowed_methods, reason = "logarithms that place marks; no state of a world comes of them")]

use crate::svg::{Anchor, Colour, Picture, Stroke};

#[derive(Debug)]
pub(crate) struct Chart<'a> {
    /// What there is to see.
    pub(crate) title: &'a str,
    /// What is shown.
    pub(crate) note: &'a str,
    pub(crate) x: Axis<'a>,
    pub(crate) y: Axis<'a>,
    pub(crate) curves: Vec<Curve>,
    pub(crate) origin: &'a str,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Axis<'a> {
    pub(crate) name: &'a str,
    pub(crate) label: fn(f64) -> String,
}

#[derive(Debug, Clone)]
pub(crate) struct Curve {
    pub(crate) name: String,
    pub(crate) colour: Colour,
    /// No contender, but something to hold the others against.
    pub(crate) is_guide: bool,
    pub(crate) points: Vec<(f64, f64)>,
}

const LEFT: f64 = 96.0;
/// Names stand to the right of it.
const RIGHT: f64 = 576.0;
const HEIGHT: f64 = 380.0;
/// Between two names.
const LINE: f64 = 27.0;

impl Chart<'_> {
    pub(crate) fn svg(&self) -> String {
        assert!(self.curves.len() <= 5, "{}: more curves than a glance takes in", self.title);
        let mut picture = Picture::new(self.title, self.note);
        let top = picture.head() + 42.0;
        let bottom = top + HEIGHT;
        let of = |coordinate: fn(&(f64, f64)) -> f64| self.curves.iter().flat_map(|c| &c.points).map(coordinate);
        let (x, y) = (Range::around(of(|point| point.0)), Range::around(of(|point| point.1).filter(|y| *y > 0.0)));
        let place = |(px, py): (f64, f64)| {
            let along = y.along(py.log10()).max(0.0);
            (LEFT + x.along(px.log10()) * (RIGHT - LEFT), bottom - along * HEIGHT)
        };
        picture.text((16.0, top - 16.0), Anchor::Start, self.y.name);
        for value in y.ticks(9) {
            let at = bottom - y.along(value.log10()) * HEIGHT;
            picture.grid((LEFT, at), (RIGHT, at));
            picture.text((LEFT - 10.0, at + 7.0), Anchor::End, &(self.y.label)(value));
        }
        for value in x.ticks(6) {
            let at = LEFT + x.along(value.log10()) * (RIGHT - LEFT);
            picture.grid((at, top), (at, bottom));
            picture.text((at, bottom + 26.0), Anchor::Middle, &(self.x.label)(value));
        }
        picture.text((f64::midpoint(LEFT, RIGHT), bottom + 58.0), Anchor::Middle, self.x.name);
        let mut ends = Vec::new();
        for curve in &self.curves {
            let points: Vec<(f64, f64)> = curve.points.iter().copied().map(place).collect();
            picture.path(&points, curve.colour, if curve.is_guide { Stroke::Dashed } else { Stroke::Full });
            for point in points.iter().filter(|_| !curve.is_guide) {
                picture.dot(*point, 4.0, curve.colour);
            }
            let rightmost = points.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
            ends.extend(rightmost.map(|end| (curve, end)));
        }
        ends.sort_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let wanted: Vec<f64> = ends.iter().map(|(_, end)| end.1).collect();
        for ((curve, end), y) in ends.into_iter().zip(apart(wanted, top + 4.0, bottom - 4.0)) {
            picture.path(&[(end.0 + 6.0, end.1), (RIGHT + 10.0, y)], curve.colour, Stroke::Dotted);
            picture.label((RIGHT + 16.0, y + 7.0), curve.colour, &curve.name);
        }
        picture.origin(bottom + 92.0, self.origin);
        picture.finish(bottom + 104.0)
    }
}

/// As near as names may stand to where they want to, in ascending order, between two bounds.
fn apart(mut places: Vec<f64>, top: f64, bottom: f64) -> Vec<f64> {
    for i in 0..places.len() {
        let least = if i == 0 { top } else { places[i - 1] + LINE };
        places[i] = places[i].max(least);
    }
    for i in (0..places.len()).rev() {
        let most = if i + 1 == places.len() { bottom } else { places[i + 1] - LINE };
        places[i] = places[i].min(most);
    }
    places
}

/// Of logarithms.
#[derive(Debug)]
struct Range {
    low: f64,
    high: f64,
}

impl Range {
    /// A little room on both sides, so that no mark is cut.
    fn around(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = values.map(f64::log10).fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
        let room = 0.04 * (high - low) + 0.04;
        Self { low: low - room, high: high + room }
    }

    /// From 0 to 1.
    fn along(&self, logarithm: f64) -> f64 {
        (logarithm - self.low) / (self.high - self.low)
    }

    /// Powers of ten, at most so many; where only two fit in, 2 and 5 times as much too.
    fn ticks(&self, most: i32) -> Vec<f64> {
        #[expect(clippy::cast_possible_truncation, reason = "exponents of doubles")]
        let (first, last) = (self.low.floor() as i32, self.high.floor() as i32);
        let every = (1..100).find(|every| (last - first) / every < most).unwrap_or(100);
        let multiples: &[f64] = if self.high - self.low < 2.0 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let powers = (first..=last).filter(|power| power.rem_euclid(every) == 0);
        let all = powers.flat_map(|power| multiples.iter().map(move |multiple| multiple * 10_f64.powi(power)));
        all.filter(|value| (self.low..=self.high).contains(&value.log10())).collect()
    }
}

/// A power of ten: 10⁻³, 1, 10.
pub(crate) fn power_of_ten(value: f64) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let raised = |c: char| c.to_digit(10).map_or('⁻', |digit| DIGITS[digit as usize]);
    let power = value.log10().round();
    match power {
        0.0 => "1".to_owned(),
        1.0 => "10".to_owned(),
        _ => format!("10{}", format!("{power}").chars().map(raised).collect::<String>()),
    }
}

/// Nanoseconds with three digits that count, in the unit that fits.
pub(crate) fn time(ns: f64) -> String {
    let (value, unit) = match ns {
        _ if ns < 999.5 => (ns, "ns"),
        _ if ns < 999.5e3 => (ns / 1e3, "µs"),
        _ if ns < 999.5e6 => (ns / 1e6, "ms"),
        _ => (ns / 1e9, "s"),
    };
    let decimals = if value < 9.995 { 2 } else { usize::from(value < 99.95) };
    let digits = format!("{value:.decimals$}");
    let digits = if decimals > 0 { digits.trim_end_matches('0').trim_end_matches('.') } else { &digits };
    format!("{digits} {unit}")
}
