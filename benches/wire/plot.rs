//! The plot: what a particle costs, in and out, beside the raw socket.

use std::error::Error;
use std::path::Path;

use plotters::prelude::*;

use crate::colours::{BLACK, BLUE, GREY};
use crate::table::unit;

pub(crate) const TITLE: &str = "What a particle costs";
pub(crate) const CAPTION: &str = "Time for a particle, from the request to the last byte: blue the service, grey a raw socket \
                                  with the same bytes. Further left is better; the scale is logarithmic.";

pub(crate) type Data = Vec<Row>;

/// A way in or out, in seconds for a particle.
#[derive(Debug)]
pub(crate) struct Row {
    pub(crate) name: String,
    pub(crate) service: f64,
    pub(crate) raw: f64,
}

const LETTERS: u32 = 18;
const HEIGHT: u32 = 26;

pub(crate) fn draw(path: &Path, rows: &[Row]) -> Result<(), Box<dyn Error>> {
    let count = u32::try_from(rows.len())?;
    let root = SVGBackend::new(path, (960, HEIGHT * count + 90)).into_drawing_area();
    root.fill(&WHITE)?;
    let letters = || ("sans-serif", LETTERS).into_font().color(&BLACK);
    let all = || rows.iter().flat_map(|row| [row.service, row.raw]);
    let (least, most) = (all().fold(1e-8, f64::min), all().fold(1e-8, f64::max));
    let (x, y) = ((0.7 * least..1.4 * most).log_scale(), 0.0..f64::from(count));
    let mut chart = ChartBuilder::on(&root)
        .margin_top(10)
        .margin_right(40)
        .x_label_area_size(60)
        .y_label_area_size(380)
        .build_cartesian_2d(x, y)?;
    chart
        .configure_mesh()
        .light_line_style(RGBColor(244, 244, 244))
        .x_labels(6)
        .disable_y_mesh()
        .disable_y_axis()
        .x_label_formatter(&|seconds: &f64| {
            let (value, unit) = unit(1e9 * seconds);
            format!("{value:.0} {unit}")
        })
        .x_desc("time for a particle")
        .label_style(letters())
        .draw()?;
    for (i, row) in (0_u32..).zip(rows) {
        let y = f64::from(count - i) - 0.5;
        chart.draw_series([PathElement::new([(row.raw, y), (row.service, y)], GREY.stroke_width(1))])?;
        chart.draw_series([Circle::new((row.raw, y), 5, GREY.filled())])?;
        chart.draw_series([Circle::new((row.service, y), 6, BLUE.filled())])?;
        root.draw_text(&row.name, &letters(), (16, i32::try_from(10 + HEIGHT * i + HEIGHT / 2 - LETTERS / 2)?))?;
    }
    root.present()?;
    Ok(())
}
