//! How a plot is drawn: both axes in powers of ten, a white ground (for light and dark pages), the legend above the lines, and
//! letters that are still read on a phone.

use std::error::Error;
use std::ops::Range;
use std::path::Path;

use plotters::coord::Shift;
use plotters::element::DashedPathElement;
use plotters::prelude::*;

use crate::compare::Measured;
use crate::table::unit;

pub(crate) struct Plot {
    pub(crate) file: &'static str,
    pub(crate) title: &'static str,
    /// What the plot shows.
    pub(crate) caption: &'static str,
    /// What the horizontal axis counts; the vertical one is always a time.
    pub(crate) x: &'static str,
    pub(crate) group: &'static str,
    pub(crate) lines: &'static [Line],
}

pub(crate) struct Line {
    pub(crate) name: &'static str,
    pub(crate) colour: RGBColor,
    /// A limit of the machine, drawn as dashes.
    pub(crate) limit: bool,
    /// Precision, scene and contender.
    pub(crate) of: [&'static str; 3],
}

const SIZE: (u32, u32) = (800, 600);
/// On a phone half of the width is left.
const LETTERS: u32 = 30;
const LETTER_COLOUR: RGBColor = RGBColor(60, 60, 60);
const LEGEND_LINE: i32 = 38;

impl Plot {
    pub(crate) fn draw(&self, path: &Path, measured: &[Measured]) -> Result<(), Box<dyn Error>> {
        let root = SVGBackend::new(path, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let title = ("sans-serif", LETTERS + 4).into_font().style(FontStyle::Bold).color(&LETTER_COLOUR);
        root.draw_text(self.title, &title, (20, 16))?;
        let rows = i32::try_from(self.lines.len().div_ceil(2))?;
        let (head, chart) = root.split_vertically(74 + rows * LEGEND_LINE);
        self.draw_legend(&head)?;
        self.draw_lines(&chart, measured)?;
        root.present()?;
        Ok(())
    }

    fn draw_legend(&self, area: &DrawingArea<SVGBackend<'_>, Shift>) -> Result<(), Box<dyn Error>> {
        let letters = ("sans-serif", LETTERS).into_font().color(&LETTER_COLOUR);
        for (i, line) in self.lines.iter().enumerate() {
            let i = i32::try_from(i)?;
            let (x, y) = (20 + i % 2 * 390, 72 + i / 2 * LEGEND_LINE);
            let ends = [(x, y), (x + 44, y)];
            if line.limit {
                area.draw(&DashedPathElement::new(ends, 8, 6, line.colour.stroke_width(3)))?;
            } else {
                area.draw(&PathElement::new(ends, line.colour.stroke_width(4)))?;
                area.draw(&Circle::new((x + 22, y), 6, line.colour.filled()))?;
            }
            area.draw_text(line.name, &letters, (x + 56, y - 12))?;
        }
        Ok(())
    }

    /// Sizes and times of a line.
    fn points(&self, line: &Line, measured: &[Measured]) -> Vec<(f64, f64)> {
        let of =
            |m: &&Measured| m.group == self.group && [m.case.precision.name(), &m.case.scene, m.contender] == line.of;
        let mut points: Vec<(f64, f64)> =
            measured.iter().filter(of).map(|m| (m.case.size as f64, m.median())).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points
    }

    fn draw_lines(
        &self,
        area: &DrawingArea<SVGBackend<'_>, Shift>,
        measured: &[Measured],
    ) -> Result<(), Box<dyn Error>> {
        let lines: Vec<_> = self.lines.iter().map(|line| (line, self.points(line, measured))).collect();
        let range = |of: fn(&(f64, f64)) -> f64| {
            let values = lines.iter().flat_map(|(_, points)| points).map(of);
            values.fold((f64::MAX, f64::MIN), |(low, high), x| (low.min(x), high.max(x)))
        };
        let ((left, right), (low, high)) = (range(|point| point.0), range(|point| point.1));
        // A little room on both sides, so that no mark is cut.
        let mut chart = ChartBuilder::on(area)
            .margin_right(36)
            .margin_left(10)
            .margin_bottom(8)
            .x_label_area_size(78)
            .y_label_area_size(116)
            .build_cartesian_2d((left / 1.2..right * 1.2).log_scale(), decades(low, high).log_scale())?;
        let letters = ("sans-serif", LETTERS).into_font().color(&LETTER_COLOUR);
        chart
            .configure_mesh()
            .x_desc(self.x)
            .axis_desc_style(letters.clone())
            .label_style(letters)
            .bold_line_style(RGBColor(215, 215, 215))
            .light_line_style(TRANSPARENT)
            .x_label_formatter(&|x| power_of_ten(*x))
            .y_label_formatter(&|ns| whole(*ns))
            .draw()?;
        for (line, points) in lines {
            if line.limit {
                chart.draw_series(DashedLineSeries::new(points, 8, 6, line.colour.stroke_width(3)))?;
            } else {
                chart.draw_series(LineSeries::new(points.clone(), line.colour.stroke_width(4)))?;
                chart.draw_series(PointSeries::<_, _, Circle<_, _>, _>::new(points, 6, line.colour.filled()))?;
            }
        }
        Ok(())
    }
}

/// 1000 as 10³, and nothing between powers of ten.
fn power_of_ten(x: f64) -> String {
    const POWERS: [(f64, &str); 8] =
        [(1.0, "1"), (1e1, "10"), (1e2, "10²"), (1e3, "10³"), (1e4, "10⁴"), (1e5, "10⁵"), (1e6, "10⁶"), (1e7, "10⁷")];
    let power = POWERS.into_iter().find(|(power, _)| (x / power - 1.0).abs() < 1e-6);
    power.map_or_else(String::new, |(_, text)| text.to_owned())
}

/// 0.1 ns, 1 ns, 10 ns, 100 ns, 1 µs and so on.
fn whole(ns: f64) -> String {
    let (value, unit) = unit(ns);
    format!("{} {unit}", (value * 1000.0).round() / 1000.0)
}

/// The powers of ten around a range, between a picosecond and an hour.
fn decades(low: f64, high: f64) -> Range<f64> {
    let powers = || std::iter::successors(Some(1e-3), |power| Some(power * 10.0)).take(16);
    let below = powers().take_while(|power| *power <= low).last().unwrap_or(low);
    below..powers().find(|power| *power >= high).unwrap_or(high)
}
