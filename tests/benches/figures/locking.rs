//! Figure 1: a stitched body moves in the basis from before the stitches, in the rebuilt one, and in one from scratch.

use super::{Mover, Scene, Shot, basis, stitched};
use crate::bodies::Failure;
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
    let compared = scene.compare(&movers, course)?;
    let caption = format!(
        "{} stitches, gravity {:.3} m/s2, {:.3} s after it sets in",
        pairs.len(),
        -course.gravity_m_s2[1],
        (compared.at + 1) as f64 * course.dt_s
    );
    let rest = vec![0.0; compared.frames[0].len()];
    let shown = [
        ("a_before", "before the stitches, at rest", "", &rest, &[][..]),
        (
            "b_original",
            "stitched, in the basis from before: it locks",
            &caption,
            &compared.frames[0],
            pairs,
        ),
        ("c_rebuilt", "stitched, in the rebuilt basis", &caption, &compared.frames[1], pairs),
        ("d_scratch", "stitched, in a basis from scratch", &caption, &compared.frames[2], pairs),
    ];
    let pictures = shown.map(|(name, title, caption, displacement, stitches)| Shot {
        name,
        title,
        caption,
        displacement,
        stitches,
    });
    scene.pictures(&before, &pictures)?;
    Ok(compared.text)
}
