//! How a chart is drawn: panels one above the other, both axes in powers of ten, a white ground (for light and dark
//! pages), one legend for all panels, and letters that are still read on a phone.

#![expect(clippy::disallowed_methods, reason = "logarithms that place marks; no state of a world comes of them")]

use std::error::Error;

use plotters::coord::Shift;
use plotters::element::{DashedPathElement, DynElement, IntoDynElement, Polygon};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::host;
use crate::method::Method;

#[derive(Debug, Clone)]
pub(crate) struct Chart {
    pub(crate) title: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) panels: Vec<Panel>,
}

#[derive(Debug, Clone)]
pub(crate) struct Axis {
    pub(crate) name: String,
    pub(crate) label: fn(i32) -> String,
}

/// The top of the vertical axis is given, the rest follows from the points.
#[derive(Debug, Clone)]
pub(crate) struct Panel {
    pub(crate) title: String,
    pub(crate) lines: Vec<Line>,
    /// Larger values are told by a mark at the top edge.
    pub(crate) top: f64,
    /// Smaller ones are drawn at the bottom edge.
    pub(crate) bottom: f64,
}

#[derive(Debug, Clone)]
pub(crate) struct Line {
    pub(crate) style: Style,
    /// Along the line.
    pub(crate) points: Vec<(f64, f64)>,
    /// At the top edge.
    pub(crate) marks: Vec<(f64, Mark)>,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Style {
    pub(crate) name: String,
    pub(crate) colour: RGBColor,
    pub(crate) look: Look,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Look {
    /// A line with full marks.
    Full,
    /// Dashes with hollow marks: compensated sums.
    Hollow,
    /// Fine dashes without marks: no measurement, but something to hold them against.
    Guide,
}

/// What has no place on the vertical axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mark {
    Beyond,
    Refused,
    NotRun,
}

impl Style {
    pub(crate) fn of(method: Method) -> Self {
        let look = if method.compensated { Look::Hollow } else { Look::Full };
        Self { name: method.to_string(), colour: method.colour(), look }
    }

    pub(crate) fn guide(name: &str) -> Self {
        Self { name: name.to_owned(), colour: crate::colours::GREY, look: Look::Guide }
    }
}

const WIDTH: u32 = 800;
/// On a phone half of the width is left.
const LETTERS: u32 = 28;
const SMALL: u32 = 22;
const INK: RGBColor = RGBColor(60, 60, 60);
const GRID: RGBColor = RGBColor(222, 222, 222);
const LEGEND_LINE: i32 = 38;
const LEFT: i32 = 122;
const RIGHT: i32 = 774;
const PANEL: i32 = 430;

type Area<'a, 'b> = &'a DrawingArea<SVGBackend<'b>, Shift>;

impl Chart {
    pub(crate) fn svg(&self) -> Result<String, Box<dyn Error>> {
        let legend = self.legend();
        let marks = self.marks();
        let rows = i32::try_from(legend.len().div_ceil(2))?;
        let compensated = self.tells_compensated();
        let keys = if marks.is_empty() && !compensated { 0 } else { LEGEND_LINE };
        let head = 72 + rows * LEGEND_LINE + keys;
        let step = PANEL + 84;
        let feet = head + step * i32::try_from(self.panels.len())? + 44;
        let mut text = String::new();
        {
            let root = SVGBackend::with_string(&mut text, (WIDTH, u32::try_from(feet + 62)?)).into_drawing_area();
            root.fill(&WHITE)?;
            let title = ("sans-serif", LETTERS + 6).into_font().style(FontStyle::Bold).color(&INK);
            root.draw_text(&self.title, &title, (20, 16))?;
            draw_legend(&root, &legend)?;
            draw_keys(&root, 78 + rows * LEGEND_LINE, compensated, &marks)?;
            let x = Range::around(self.panels.iter().flat_map(Panel::xs));
            for (i, panel) in self.panels.iter().enumerate() {
                let top = head + step * i32::try_from(i)? + 40;
                self.draw_panel(&root, panel, &x, top)?;
            }
            let letters = ("sans-serif", LETTERS).into_font().color(&INK).pos(Pos::new(HPos::Center, VPos::Top));
            root.draw_text(&self.x.name, &letters, (i32::midpoint(LEFT, RIGHT), feet - 40))?;
            draw_origin(&root, feet + 4)?;
            root.present()?;
        }
        Ok(text)
    }

    fn lines(&self) -> impl Iterator<Item = &Line> {
        self.panels.iter().flat_map(|panel| &panel.lines)
    }

    /// Every name once, guides last.
    fn legend(&self) -> Vec<Style> {
        let mut styles: Vec<Style> = Vec::new();
        for line in self.lines() {
            if !styles.iter().any(|style| style.name == line.style.name) {
                styles.push(line.style.clone());
            }
        }
        styles.sort_by_key(|style| style.look == Look::Guide);
        styles
    }

    /// Whether a name has both looks.
    fn tells_compensated(&self) -> bool {
        let hollow = self.lines().filter(|line| line.style.look == Look::Hollow);
        let full = |name: &str| self.lines().any(|line| line.style.name == name && line.style.look == Look::Full);
        hollow.into_iter().any(|line| full(&line.style.name))
    }

    fn marks(&self) -> Vec<Mark> {
        let used = |mark: &Mark| {
            let lines = self.panels.iter().flat_map(|panel| panel.lines.iter().map(move |line| (panel, line)));
            lines.into_iter().any(|(panel, line)| {
                let beyond = *mark == Mark::Beyond && line.points.iter().any(|(_, y)| *y > panel.top);
                beyond || line.marks.iter().any(|(_, other)| other == mark)
            })
        };
        [Mark::Beyond, Mark::Refused, Mark::NotRun].into_iter().filter(used).collect()
    }

    fn draw_panel(&self, root: Area<'_, '_>, panel: &Panel, x: &Range, top: i32) -> Result<(), Box<dyn Error>> {
        let bottom = top + PANEL;
        let y = Range { low: panel.bottom.log10(), high: panel.top.log10() };
        let letters = || ("sans-serif", LETTERS).into_font().color(&INK);
        let place = |(px, py): (f64, f64)| {
            let clamped = py.clamp(panel.bottom, panel.top);
            (LEFT + x.along(px.log10(), RIGHT - LEFT), bottom - y.along(clamped.log10(), PANEL))
        };
        let name =
            if panel.title.is_empty() { self.y.name.clone() } else { format!("{}: {}", panel.title, self.y.name) };
        root.draw_text(&name, &letters(), (20, top - 40))?;
        for (power, is_labelled) in y.powers(9) {
            let (_, at) = place((1.0, 10_f64.powi(power)));
            let colour = if is_labelled { GRID } else { RGBColor(240, 240, 240) };
            root.draw(&PathElement::new([(LEFT, at), (RIGHT, at)], colour.stroke_width(1)))?;
            if is_labelled {
                let style = letters().pos(Pos::new(HPos::Right, VPos::Center));
                root.draw_text(&(self.y.label)(power), &style, (LEFT - 12, at))?;
            }
        }
        for (power, is_labelled) in x.powers(6) {
            let (at, _) = place((10_f64.powi(power), panel.top));
            let colour = if is_labelled { GRID } else { RGBColor(240, 240, 240) };
            root.draw(&PathElement::new([(at, top), (at, bottom)], colour.stroke_width(1)))?;
            if is_labelled {
                let style = letters().pos(Pos::new(HPos::Center, VPos::Top));
                root.draw_text(&(self.x.label)(power), &style, (at, bottom + 8))?;
            }
        }
        let frame = [(LEFT, top), (LEFT, bottom), (RIGHT, bottom), (RIGHT, top), (LEFT, top)];
        root.draw(&PathElement::new(frame, RGBColor(150, 150, 150).stroke_width(1)))?;
        for line in &panel.lines {
            let Style { colour, look, .. } = line.style;
            // Between points that are in the panel; a line to one beyond would tell a slope that is not there.
            let inside = |(_, y): &(f64, f64)| *y <= panel.top;
            for run in line.points.split(|point| !inside(point)) {
                let ends: Vec<(i32, i32)> = run.iter().copied().map(place).collect();
                match look {
                    Look::Full => root.draw(&PathElement::new(ends, colour.stroke_width(4)))?,
                    Look::Hollow => root.draw(&DashedPathElement::new(ends, 10, 6, colour.stroke_width(3)))?,
                    Look::Guide => root.draw(&DashedPathElement::new(ends, 3, 6, colour.stroke_width(3)))?,
                }
            }
        }
        // Marks over all lines.
        for line in &panel.lines {
            let Style { colour, look, .. } = line.style;
            for point in line.points.iter().filter(|_| look != Look::Guide) {
                let at = place(*point);
                if point.1 > panel.top {
                    root.draw(&symbol(at, Mark::Beyond, colour))?;
                } else {
                    dot(root, at, colour, look)?;
                }
            }
            for (cost, mark) in &line.marks {
                root.draw(&symbol(place((*cost, panel.top)), *mark, colour))?;
            }
        }
        Ok(())
    }
}

impl Panel {
    fn xs(&self) -> impl Iterator<Item = f64> {
        self.lines.iter().flat_map(|line| line.points.iter().map(|p| p.0).chain(line.marks.iter().map(|m| m.0)))
    }

    /// The power of ten below the least value above 0, between two bounds.
    pub(crate) fn floor(lines: &[Line], least: f64, most: f64) -> f64 {
        let values = lines.iter().flat_map(|line| &line.points).map(|point| point.1).filter(|y| *y > 0.0);
        // Some decades, so that noise does not look like a slope.
        let low = values.fold(1e-2 * most, f64::min).max(least);
        10_f64.powf((low.log10() - 0.1).floor())
    }
}

/// Of logarithms.
#[derive(Debug, Clone)]
struct Range {
    low: f64,
    high: f64,
}

impl Range {
    /// A little room on both sides, so that no mark is cut.
    fn around(values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)));
        let (low, high) = if low > high { (1.0, 10.0) } else { (low.log10(), high.log10()) };
        let room = 0.04 * (high - low) + 0.05;
        Self { low: low - room, high: high + room }
    }

    fn along(&self, value: f64, length: i32) -> i32 {
        let along = (value - self.low) / (self.high - self.low) * f64::from(length);
        #[expect(clippy::cast_possible_truncation, reason = "pixels of a panel")]
        let pixels = along.round() as i32;
        pixels
    }

    /// The powers of ten inside, and whether each has a label: at most so many have one.
    fn powers(&self, labels: i32) -> impl Iterator<Item = (i32, bool)> + use<> {
        #[expect(clippy::cast_possible_truncation, reason = "exponents of doubles")]
        let (first, last) = ((self.low - 1e-9).ceil() as i32, (self.high + 1e-9).floor() as i32);
        let every = (1..100).find(|every| (last - first) / every < labels).unwrap_or(100);
        (first..=last).map(move |power| (power, power.rem_euclid(every) == 0))
    }
}

fn draw_legend(root: Area<'_, '_>, styles: &[Style]) -> Result<(), Box<dyn Error>> {
    let letters = ("sans-serif", LETTERS).into_font().color(&INK);
    for (i, style) in styles.iter().enumerate() {
        let i = i32::try_from(i)?;
        let (x, y) = (20 + i % 2 * 392, 78 + i / 2 * LEGEND_LINE);
        let ends = [(x, y), (x + 44, y)];
        match style.look {
            Look::Full => root.draw(&PathElement::new(ends, style.colour.stroke_width(4)))?,
            Look::Hollow => root.draw(&DashedPathElement::new(ends, 10, 6, style.colour.stroke_width(3)))?,
            Look::Guide => root.draw(&DashedPathElement::new(ends, 3, 6, style.colour.stroke_width(3)))?,
        }
        if style.look != Look::Guide {
            dot(root, (x + 22, y), style.colour, style.look)?;
        }
        root.draw_text(&style.name, &letters, (x + 56, y - 12))?;
    }
    Ok(())
}

/// What hollow marks are, and those at the top edge.
fn draw_keys(root: Area<'_, '_>, y: i32, compensated: bool, marks: &[Mark]) -> Result<(), Box<dyn Error>> {
    let letters = ("sans-serif", LETTERS).into_font().color(&INK);
    let mut x = 20;
    if compensated {
        root.draw(&DashedPathElement::new([(x, y), (x + 44, y)], 10, 6, INK.stroke_width(3)))?;
        dot(root, (x + 22, y), INK, Look::Hollow)?;
        root.draw_text("compensated", &letters, (x + 56, y - 12))?;
        x += 280;
    }
    for mark in marks {
        root.draw(&symbol((x + 10, y), *mark, INK))?;
        let name = match mark {
            Mark::Beyond => "beyond",
            Mark::Refused => "refused",
            Mark::NotRun => "not run",
        };
        root.draw_text(name, &letters, (x + 30, y - 12))?;
        x += 164;
    }
    Ok(())
}

/// Where the numbers come from.
pub(crate) fn draw_origin(root: Area<'_, '_>, y: i32) -> Result<(), Box<dyn Error>> {
    let letters = ("sans-serif", SMALL).into_font().color(&RGBColor(120, 120, 120));
    let of: Vec<(&str, String)> = host::description();
    let find = |what: &str| of.iter().find(|(name, _)| *name == what).map_or("unknown", |(_, value)| value.as_str());
    let machine = format!("{}, {} cores, {}", find("processor"), find("cores"), find("instruction set"));
    let build = format!("commit {}, {}", find("commit"), find("date"));
    for (i, line) in [machine, build].iter().enumerate() {
        root.draw_text(line, &letters, (20, y + 26 * i32::try_from(i)?))?;
    }
    Ok(())
}

fn dot(root: Area<'_, '_>, at: (i32, i32), colour: RGBColor, look: Look) -> Result<(), Box<dyn Error>> {
    if look == Look::Hollow {
        root.draw(&Circle::new(at, 6, WHITE.filled()))?;
        root.draw(&Circle::new(at, 6, colour.stroke_width(3)))?;
    } else {
        root.draw(&Circle::new(at, 6, colour.filled()))?;
    }
    Ok(())
}

fn symbol<'b>((x, y): (i32, i32), mark: Mark, colour: RGBColor) -> DynElement<'static, SVGBackend<'b>, (i32, i32)> {
    match mark {
        Mark::Beyond => Polygon::new([(x - 9, y + 7), (x, y - 9), (x + 9, y + 7)], colour.filled()).into_dyn(),
        Mark::Refused => Cross::new((x, y), 8, colour.stroke_width(4)).into_dyn(),
        Mark::NotRun => {
            let corners = [(x - 7, y - 7), (x + 7, y - 7), (x + 7, y + 7), (x - 7, y + 7), (x - 7, y - 7)];
            PathElement::new(corners, colour.stroke_width(3)).into_dyn()
        }
    }
}

/// 10⁻³, 1, 10.
pub(crate) fn power_of_ten(power: i32) -> String {
    match power {
        0 => "1".to_owned(),
        1 => "10".to_owned(),
        _ => format!("10{}", raised(power)),
    }
}

/// 0.1 ns, 1 ns, 1 µs and so on.
pub(crate) fn nanoseconds(power: i32) -> String {
    let (value, unit) = crate::table::unit(10_f64.powi(power));
    format!("{} {unit}", (value * 1e6).round() / 1e6)
}

fn raised(power: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let digit = |c: char| c.to_digit(10).map_or('⁻', |digit| DIGITS[digit as usize]);
    power.to_string().chars().map(digit).collect()
}
