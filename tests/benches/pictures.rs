//! The results as SVG pictures.

use crate::accuracy::Accuracies;
use crate::bodies::Failure;
use crate::chart::{Curve, chart};
use crate::edits::Comparison;
use crate::results::{BodyResults, Results};
use crate::scaling::{Point, Scaling};
use plotters::coord::combinators::BindKeyPoints;
use plotters::prelude::*;
use std::ops::Range;
use std::path::Path;

/// Draws every picture into `directory` and returns their names.
pub(crate) fn draw(results: &Results, directory: &Path) -> Result<Vec<String>, Failure> {
    let mut names = Vec::new();
    for body in &results.bodies {
        let name = format!("coverage_{}.svg", body.name);
        coverage(body, &directory.join(&name))?;
        names.push(name);
        let name = format!("speedup_{}.svg", body.name);
        speedup(body, &directory.join(&name))?;
        names.push(name);
    }
    if let Some(scaling) = results.scaling.as_ref().filter(|scaling| scaling.points.len() > 1) {
        costs(scaling, &directory.join("scaling.svg"))?;
        names.push("scaling.svg".into());
    }
    Ok(names)
}

/// Draws the eigenvalue errors of each body into `directory` and returns the pictures' names.
pub(crate) fn draw_accuracy(
    results: &Accuracies,
    directory: &Path,
) -> Result<Vec<String>, Failure> {
    let mut names = Vec::new();
    for body in &results.bodies {
        let mut curves: Vec<Curve> = Vec::new();
        for quality in &body.qualities[1..] {
            // Below rounding there is nothing to show, and zero has no logarithm.
            let errors = quality.eigenvalue_errors.iter().map(|error| error.max(1e-12));
            let points = errors.enumerate().map(|(i, error)| ((i + 1) as f64, error));
            curves.push(Curve::new(quality.way.name().replace('`', ""), points.collect()));
        }
        let n = curves.iter().map(|curve| curve.points.len()).max().unwrap_or(1) as f64;
        let name = format!("accuracy_{}.svg", body.name);
        let title = format!("{}: relative eigenvalue error after the stitches", body.name);
        let ticks: Vec<f64> = (-6..=0).map(|e| 100f64.powi(e)).collect();
        let range = (1.0..n.max(2.0), (1e-12..3.0).log_scale().with_key_points(ticks));
        chart(&directory.join(&name), &title, ["mode", "error"], range, &curves)?;
        names.push(name);
    }
    Ok(names)
}

fn coverage(body: &BodyResults, path: &Path) -> Result<(), Failure> {
    let most = |by: &str| {
        let same = body.edits.coverage.iter().filter(|curve| curve.by == by);
        same.map(|curve| curve.n_vectors).max()
    };
    let curves: Vec<Curve> = body
        .edits
        .coverage
        .iter()
        .filter(|curve| Some(curve.n_vectors) == most(&curve.by))
        .map(|curve| {
            let points = curve.share.iter().enumerate().map(|(i, share)| ((i + 1) as f64, *share));
            Curve::new(format!("{} ({})", curve.by, curve.n_vectors), points.collect())
        })
        .collect();
    let title = format!("{}: share of each exact mode that is covered", body.name);
    let n = curves.iter().map(|curve| curve.points.len()).max().unwrap_or(1) as f64;
    chart(path, &title, ["exact mode", "share"], (1.0..n.max(2.0), 0.0..1.02), &curves)
}

fn speedup(body: &BodyResults, path: &Path) -> Result<(), Failure> {
    type Stage = fn(&Comparison) -> f64;
    let kinds: [(&str, Stage); 5] = [
        ("linear modes", |c| c.from_scratch.modes.median_s / c.unprepared.modes.median_s),
        ("linear modes, prepared", |c| c.from_scratch.modes.median_s / c.prepared.modes.median_s),
        ("whole edit", |c| c.from_scratch.total.median_s / c.unprepared.total.median_s),
        ("whole edit, prepared", |c| c.from_scratch.total.median_s / c.prepared.total.median_s),
        ("its first answer", |c| c.from_scratch.total.median_s / c.first_answer.total.median_s),
    ];
    let curves: Vec<Curve> = kinds
        .iter()
        .map(|(name, stage)| {
            let points = body.edits.speedup.iter().map(|c| (c.n_stitches as f64, stage(c)));
            Curve::new(*name, points.collect())
        })
        .collect();
    let top = curves.iter().flat_map(|c| &c.points).map(|p| p.1).fold(1.0, f64::max);
    let right = curves.iter().flat_map(|c| &c.points).map(|p| p.0).fold(2.0, f64::max);
    let title = format!("{}: speed-up over building from scratch", body.name);
    let range = (0.0..right * 1.02, 0.0..top * 1.1);
    chart(path, &title, ["stitches", "times faster"], range, &curves)
}

fn costs(scaling: &Scaling, path: &Path) -> Result<(), Failure> {
    type Cost = fn(&Point) -> f64;
    let kinds: [(&str, f64, Cost); 3] = [
        ("factorization", 2.0, |p| p.numeric.median_s),
        ("solve of 1 column", 4.0 / 3.0, |p| p.solve_1.median_s),
        ("solve of 32 columns", 4.0 / 3.0, |p| p.solve_32.median_s),
    ];
    let last = &scaling.points[scaling.points.len() - 1];
    let mut curves = Vec::new();
    for (name, theory, cost) in kinds {
        let at = |p: &Point| (p.n_vertices as f64, cost(p));
        curves.push(Curve::new(name, scaling.points.iter().map(at).collect()));
        // Theory's slope through the largest size.
        let guide = |p: &Point| {
            let n = p.n_vertices as f64;
            (n, cost(last) * (n / last.n_vertices as f64).powf(theory))
        };
        let name = format!("slope {theory:.2}");
        let points = scaling.points.iter().map(guide).collect();
        curves.push(Curve { name, points, is_guide: true });
    }
    let all = || curves.iter().flat_map(|curve| &curve.points);
    let low = all().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let high = all().map(|p| p.1).fold(0.0, f64::max);
    let n = |p: &Point| p.n_vertices as f64;
    let (x, y) = (0.9 * n(&scaling.points[0])..1.1 * n(last), 0.7 * low..1.4 * high);
    // Powers of ten alone would leave an axis of one decade with one number.
    let ticks = |range: &Range<f64>, steps: &[f64]| -> Vec<f64> {
        let all = (-6..6).flat_map(|e| steps.iter().map(move |step| step * 10f64.powi(e)));
        all.filter(|tick| range.contains(tick)).collect()
    };
    let (x_ticks, y_ticks) = (ticks(&x, &[1.0, 2.0, 5.0]), ticks(&y, &[1.0]));
    let range = (x.log_scale().with_key_points(x_ticks), y.log_scale().with_key_points(y_ticks));
    chart(path, "Cubes: seconds against vertices", ["vertices", "s"], range, &curves)
}
