//! The colours of Okabe and Ito, which people tell apart who see fewer of them.

use plotters::style::RGBColor;

pub(crate) const BLACK: RGBColor = RGBColor(60, 60, 60);
pub(crate) const BLUE: RGBColor = RGBColor(0, 114, 178);
pub(crate) const RED: RGBColor = RGBColor(213, 94, 0);
pub(crate) const GREEN: RGBColor = RGBColor(0, 158, 115);
pub(crate) const GREY: RGBColor = RGBColor(140, 140, 140);
