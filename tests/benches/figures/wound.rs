//! Figure 11: a wound stitched in part, then in full, each from the generation before; gravity opens what is not closed.

use super::{Mover, Scene, Shot, farthest, largest, over_time};
use crate::bodies::Failure;
use serde_json::json;
use sutura_core::build::{Artifacts, Method};

pub(crate) fn show(scene: &Scene<'_>) -> Result<String, Failure> {
    // In part: the stitches of Table 1; in full: every pair along the wound.
    let all = &scene.body.pairs(usize::MAX);
    let (first, second) = all.split_at(scene.body.stitches.len());
    let open = scene.build(|params| params)?;
    let partial = scene.stitch(&open, first, Method::Flexibility)?;
    let full = scene.stitch(&partial, second, Method::Flexibility)?;
    let exact = [
        scene.stitch(&open, first, Method::FromScratch)?,
        scene.stitch(&open, all, Method::FromScratch)?,
    ];

    let course = scene.course(&open)?;
    let states =
        [("open", &open, 0), ("partial", &partial, first.len()), ("full", &full, all.len())];
    let mut motions = Vec::new();
    for (name, built, _) in &states {
        motions.push(Mover::new(name, built).run(course, scene.n_frames)?);
    }
    let gaps: Vec<Vec<f64>> =
        motions.iter().map(|frames| frames.iter().map(|u| gap(all, u)).collect()).collect();
    let curves: Vec<_> = states
        .iter()
        .zip(&gaps)
        .map(|((name, ..), gaps)| over_time(course, name, gaps.iter().map(|gap| 1e3 * gap)))
        .collect();
    scene.chart("gap", "mean distance of the wound's pairs", "mm", &curves)?;
    let at = farthest(&motions[0]);
    let titles: Vec<String> =
        states.iter().map(|(name, _, n)| format!("{name}: {n} stitches")).collect();
    let shots: Vec<Shot<'_>> = states
        .iter()
        .zip(&titles)
        .zip(&motions)
        .map(|(((name, _, n), title), frames)| Shot {
            name,
            title,
            caption: "",
            displacement: &frames[at],
            stitches: &all[..*n],
        })
        .collect();
    scene.pictures(&open, &shots)?;

    let error = |found: &Artifacts, exact: &Artifacts| {
        let (found, exact) = (found.eigenvalues_per_s2(), exact.eigenvalues_per_s2());
        let half = exact.len() / 2;
        largest(found.iter().zip(exact).take(half).map(|(a, b)| (a / b - 1.0).abs()))
    };
    let errors = [error(&partial, &exact[0]), error(&full, &exact[1])];
    let mut text = String::from(
        "| wound | stitches | lowest frequency | lower half of the eigenvalues, error against from scratch | largest mean \
         distance of its pairs |\n|---|---|---|---|---|\n",
    );
    for (k, (name, built, n)) in states.iter().enumerate() {
        let error = match k {
            0 => "–".to_owned(),
            _ => format!("{:.1e}", errors[k - 1]),
        };
        text += &format!(
            "| {name} | {n} | {:.3} Hz | {error} | {:.3} mm |\n",
            built.frequencies_hz()[built.n_rigid_modes()],
            1e3 * largest(gaps[k].iter().copied())
        );
    }
    scene.data(&json!({
        "body": scene.body.name, "dt_s": course.dt_s, "gravity_m_s2": course.gravity_m_s2,
        "states": states.iter().map(|(name, ..)| name).collect::<Vec<_>>(),
        "n_stitches": states.iter().map(|(.., n)| n).collect::<Vec<_>>(),
        "frequencies_hz": states.iter().map(|(_, built, _)| built.frequencies_hz()).collect::<Vec<_>>(),
        "eigenvalue_errors": errors, "gap_m": gaps,
    }))?;
    Ok(text)
}

/// Mean distance of pairs that rest in one place, in m.
fn gap(pairs: &[[u32; 2]], u: &[f32]) -> f64 {
    let apart = |[a, b]: &[u32; 2]| {
        let at = |v: u32, axis: usize| f64::from(u[3 * v as usize + axis]);
        (0..3).map(|axis| (at(*a, axis) - at(*b, axis)).powi(2)).sum::<f64>().sqrt()
    };
    pairs.iter().map(apart).sum::<f64>() / pairs.len().max(1) as f64
}
