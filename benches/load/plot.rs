//! The plot: how long light worlds wait beside what.

use std::error::Error;
use std::path::Path;

use plotters::element::DashedPathElement;
use plotters::prelude::*;

use crate::colours::{BLACK, BLUE, GREEN, GREY, RED};
use crate::load::Latencies;
use crate::table::unit;

pub(crate) const TITLE: &str = "How long light worlds wait";
pub(crate) const CAPTION: &str = "Light worlds at 60 Hz, alone and beside what the cases do to the service: the share of \
                                  requests that took longer. Further left and lower is better; dashed is a tick.";

/// What light worlds waited beside what a case does.
pub(crate) type Data = Vec<(&'static str, Latencies)>;

const LETTERS: u32 = 24;
const COLOURS: [RGBColor; 7] = [BLACK, BLUE, RED, GREY, GREEN, RGBColor(204, 121, 167), RGBColor(230, 159, 0)];

pub(crate) fn draw(path: &Path, lines: &[(&str, Latencies)]) -> Result<(), Box<dyn Error>> {
    let root = SVGBackend::new(path, (800, 720)).into_drawing_area();
    root.fill(&WHITE)?;
    let letters = || ("sans-serif", LETTERS).into_font().color(&BLACK);
    for (i, ((name, _), colour)) in lines.iter().zip(COLOURS).enumerate() {
        let i = i32::try_from(i)?;
        let (x, y) = (20 + i % 2 * 392, 24 + i / 2 * 32);
        root.draw(&PathElement::new([(x, y), (x + 36, y)], colour.stroke_width(4)))?;
        root.draw_text(name, &letters(), (x + 46, y - 10))?;
    }
    let (_, area) = root.split_vertically(140);
    let slowest = lines.iter().filter_map(|(_, latencies)| latencies.0.last()).fold(0.1, |a: f64, b| a.max(*b));
    let (x, y) = ((1e-5..1.2 * slowest).log_scale(), (1e-4..1.0).log_scale());
    let mut chart = ChartBuilder::on(&area)
        .margin_right(40)
        .x_label_area_size(84)
        .y_label_area_size(110)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(RGBColor(244, 244, 244))
        .x_labels(6)
        .y_labels(5)
        .x_label_formatter(&|seconds: &f64| {
            let (value, unit) = unit(1e9 * seconds);
            format!("{value:.0} {unit}")
        })
        .y_label_formatter(&|share: &f64| format!("{} %", (1e4 * share).round() / 1e2))
        .x_desc("time until the answer")
        .y_desc("took longer")
        .label_style(letters())
        .draw()?;
    for ((_, latencies), colour) in lines.iter().zip(COLOURS) {
        #[expect(clippy::disallowed_methods, reason = "the last bit of a place in a plot does not matter")]
        let shares = (0..=120).map(|i| 10_f64.powf(-f64::from(i) / 30.0));
        let n = latencies.0.len() as f64;
        let points = shares.filter(|share| share * n >= 1.0).map(|share| (latencies.within(1.0 - share), share));
        chart.draw_series(LineSeries::new(points, colour.stroke_width(4)))?;
    }
    let tick = [(crate::worlds::TICK, 1e-4), (crate::worlds::TICK, 1.0)];
    chart.draw_series([DashedPathElement::new(tick, 8, 8, GREY.stroke_width(3))])?;
    root.present()?;
    Ok(())
}
