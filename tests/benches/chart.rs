//! A chart of curves as SVG.

use crate::bodies::Failure;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use std::path::Path;

const SIZE: (u32, u32) = (860, 480);

/// Width of the column of names on the right.
const NAMES: u32 = 190;

const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 86, 86),
];

/// A named curve.
pub(crate) struct Curve {
    /// In the legend.
    pub(crate) name: String,
    /// x and y.
    pub(crate) points: Vec<(f64, f64)>,
    /// Without marks: a line for the eye.
    pub(crate) is_guide: bool,
}

impl Curve {
    /// One with marks.
    pub(crate) fn new(name: impl Into<String>, points: Vec<(f64, f64)>) -> Curve {
        Curve { name: name.into(), points, is_guide: false }
    }
}

/// Draws `curves` over the ranges x and y into the file at `path`.
pub(crate) fn chart<X, Y>(
    path: &Path,
    title: &str,
    [x_label, y_label]: [&str; 2],
    (x, y): (X, Y),
    curves: &[Curve],
) -> Result<(), Failure>
where
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let failed = |error: &dyn std::fmt::Display| Failure::from(format!("{title}: {error}"));
    let area = SVGBackend::new(path, SIZE).into_drawing_area();
    area.fill(&WHITE).map_err(|e| failed(&e))?;
    let (plot, names) = area.split_horizontally(SIZE.0 - NAMES);
    let font = ("sans-serif", 16);
    let mut chart = ChartBuilder::on(&plot)
        .caption(title, ("sans-serif", 20))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(60)
        .build_cartesian_2d(x, y)
        .map_err(|e| failed(&e))?;
    chart
        .configure_mesh()
        .x_desc(x_label)
        .y_desc(y_label)
        .light_line_style(WHITE)
        .label_style(font)
        .draw()
        .map_err(|e| failed(&e))?;
    for (i, curve) in curves.iter().enumerate() {
        let line = match curve.is_guide {
            true => BLACK.mix(0.35).stroke_width(1),
            false => COLOURS[i % COLOURS.len()].stroke_width(2),
        };
        let marks = if curve.is_guide { 0 } else { 3 };
        let points = curve.points.iter().copied();
        chart
            .draw_series(LineSeries::new(points, line).point_size(marks))
            .map_err(|e| failed(&e))?;
        let y = 50 + 22 * i as i32;
        names
            .draw(&PathElement::new([(0, y), (16, y)], line))
            .and_then(|()| names.draw(&Text::new(curve.name.clone(), (22, y - 6), font)))
            .map_err(|e| failed(&e))?;
    }
    area.present().map_err(|e| failed(&e))
}
