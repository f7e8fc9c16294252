//! Figure 1: a stitched body moves in the basis from before the stitches, in the rebuilt one, and in one from scratch.

use super::{Mover, Scene, Shot, basis, difference, farthest, largest, over_time, reach, stitched};
use crate::bodies::Failure;
use serde_json::json;
use std::sync::Arc;
use sutura_core::build::Method;
use sutura_core::reduced::ReducedModel;

pub(crate) fn show(scene: &Scene<'_>) -> Result<String, Failure> {
    let pairs = &scene.body.stitches;
    let before = scene.build(|params| params)?;
    let after = scene.stitch(&before, pairs, Method::Flexibility)?;
    let scratch = scene.stitch(&before, pairs, Method::FromScratch)?;
    let rows: Vec<_> = pairs.iter().map(|pair| pair.map(|v| before.vertex_rows(v))).collect();
    let tables = stitched(before.evaluator_tables(), &rows, scene.body.stiffness_n_m);
    let kept = Mover {
        name: "original basis",
        model: Arc::new(ReducedModel::from_tables(&tables)?),
        basis: basis(&before),
    };
    let movers = [kept, Mover::new("rebuilt", &after), Mover::new("from scratch", &scratch)];
    let course = scene.course(&scratch)?;
    let motions = movers
        .iter()
        .map(|mover| mover.run(course, scene.n_frames))
        .collect::<Result<Vec<_>, _>>()?;
    let reaches: Vec<Vec<f64>> =
        motions.iter().map(|frames| frames.iter().map(|frame| reach(frame)).collect()).collect();
    let curves: Vec<_> = movers
        .iter()
        .zip(&reaches)
        .map(|(mover, reaches)| over_time(course, mover.name, reaches.iter().copied()))
        .collect();
    scene.chart("motion", "largest displacement under gravity", "m", &curves)?;

    let at = farthest(&motions[2]);
    let caption = format!(
        "{} stitches, gravity {:.3} m/s2, {:.3} s after it sets in",
        pairs.len(),
        -course.gravity_m_s2[1],
        (at + 1) as f64 * course.dt_s
    );
    let shot = |name, title, frames: &'static str, k: usize| (name, title, frames, k);
    let shots = [
        shot("b_original", "stitched, in the basis from before: it locks", "", 0),
        shot("c_rebuilt", "stitched, in the rebuilt basis", "", 1),
        shot("d_scratch", "stitched, in a basis from scratch", "", 2),
    ];
    let rest = vec![0.0; motions[0][0].len()];
    let mut pictures = vec![Shot {
        name: "a_before",
        title: "before the stitches, at rest",
        caption: "",
        displacement: &rest,
        stitches: &[],
    }];
    pictures.extend(shots.iter().map(|(name, title, _, k)| Shot {
        name,
        title,
        caption: &caption,
        displacement: &motions[*k][at],
        stitches: pairs,
    }));
    scene.pictures(&before, &pictures)?;

    let top = largest(reaches[2].iter().copied());
    let apart =
        |k: usize| largest(motions[k].iter().zip(&motions[2]).map(|(a, b)| difference(a, b))) / top;
    let mut text = String::from(
        "| basis | columns | largest displacement, of that from scratch | largest difference of a frame, root \
         mean square, of the largest displacement |\n|---|---|---|---|\n",
    );
    for (k, mover) in movers.iter().enumerate() {
        let ratio = largest(reaches[k].iter().copied()) / top;
        text +=
            &format!("| {} | {} | {ratio:.3} | {:.4} |\n", mover.name, mover.model.r(), apart(k));
    }
    scene.data(&json!({
        "body": scene.body.name, "n_stitches": pairs.len(), "dt_s": course.dt_s,
        "gravity_m_s2": course.gravity_m_s2,
        "bases": movers.iter().map(|mover| mover.name).collect::<Vec<_>>(),
        "largest_displacement_m": reaches,
    }))?;
    Ok(text)
}
