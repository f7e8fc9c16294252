//! Figure 7: a free domain stitched to a held one moves in a basis with its six rigid motions and in one without.

use super::{Mover, Scene, Shot, basis, stitched};
use crate::bodies::Failure;
use faer::Mat;
use std::sync::Arc;
use sutura_core::build::{Artifacts, Method};
use sutura_core::reduced::{EvaluatorTables, ReducedModel};

pub(crate) fn show(scene: &Scene<'_>) -> Result<String, Failure> {
    let pairs = &scene.body.stitches;
    let before = scene.build(|params| params)?;
    if before.n_rigid_modes() == 0 {
        return Err("every domain of this body is held: nothing moves rigidly".into());
    }
    let after = scene.stitch(&before, pairs, Method::Flexibility)?;
    let scratch = scene.stitch(&before, pairs, Method::FromScratch)?;
    let rows: Vec<_> = pairs.iter().map(|pair| pair.map(|v| before.vertex_rows(v))).collect();
    let tables = stitched(before.evaluator_tables(), &rows, scene.body.stiffness_n_m);
    let elastic = without_rigid_motions(&before);
    let columns = basis(&before);
    let kept: Vec<Vec<f64>> = (0..elastic.ncols())
        .map(|j| {
            let mut column = vec![0.0; columns[0].len()];
            for (i, from) in columns.iter().enumerate() {
                column.iter_mut().zip(from).for_each(|(to, x)| *to += elastic[(i, j)] * x);
            }
            column
        })
        .collect();
    let stuck = Mover {
        name: "without rigid motions",
        model: Arc::new(ReducedModel::from_tables(&combined(&tables, &elastic))?),
        basis: kept,
    };
    let movers =
        [stuck, Mover::new("rebuilt, with them", &after), Mover::new("from scratch", &scratch)];
    let course = scene.course(&scratch)?;
    let compared = scene.compare(&movers, course)?;
    let titles = [
        ("a_without", "without the six rigid motions of the free domain"),
        ("b_with", "rebuilt, with them"),
    ];
    let pictures: Vec<Shot<'_>> = titles
        .iter()
        .zip(&compared.frames)
        .map(|((name, title), displacement)| Shot {
            name,
            title,
            caption: "",
            displacement,
            stitches: pairs,
        })
        .collect();
    scene.pictures(&before, &pictures)?;
    Ok(compared.text)
}

/// Orthonormal combinations (r × (r − n_rigid)) of the basis's columns in which no rigid motion has a part.
fn without_rigid_motions(built: &Artifacts) -> Mat<f64> {
    let masses = built.lumped_mass_kg();
    let columns = basis(built);
    let (r, n_rigid) = (columns.len(), built.n_rigid_modes());
    // The parts of the rigid motions, orthonormal; then unit vectors made orthogonal to all before.
    let rigid = (0..n_rigid).map(|k| {
        let mode = built.mode(k);
        let inner = |column: &Vec<f64>| -> f64 {
            let products = column.iter().zip(&mode).enumerate();
            products.map(|(i, (a, b))| masses[i / 3] * a * b).sum()
        };
        columns.iter().map(inner).collect::<Vec<f64>>()
    });
    let unit = |i: usize| (0..r).map(|j| f64::from(u8::from(i == j))).collect::<Vec<f64>>();
    let mut found: Vec<Vec<f64>> = Vec::new();
    for mut x in rigid.chain((0..r).map(unit)) {
        let before = x.iter().map(|x| x * x).sum::<f64>().sqrt();
        for _ in 0..2 {
            for y in &found {
                let part: f64 = x.iter().zip(y).map(|(x, y)| x * y).sum();
                x.iter_mut().zip(y).for_each(|(x, y)| *x -= part * y);
            }
        }
        let left = x.iter().map(|x| x * x).sum::<f64>().sqrt();
        if found.len() < r && left > 1e-3 * before {
            found.push(x.iter().map(|x| x / left).collect());
        }
    }
    Mat::from_fn(r, found.len() - n_rigid, |i, j| found[n_rigid + j][i])
}

/// The tables of the basis times `c` (r × s).
fn combined(tables: &EvaluatorTables, c: &Mat<f64>) -> EvaluatorTables {
    let (r, s) = (c.nrows(), c.ncols());
    let by_rows = |x: &[f64]| -> Vec<f64> {
        x.chunks_exact(r)
            .flat_map(|row| {
                (0..s).map(move |j| row.iter().enumerate().map(|(i, x)| x * c[(i, j)]).sum())
            })
            .collect()
    };
    let half = by_rows(&tables.stitch_stiffness);
    let columns = |x: &[f64], n: usize| -> Vec<f64> {
        (0..s * n).map(|k| (0..r).map(|i| c[(i, k / n)] * x[i * n + k % n]).sum()).collect()
    };
    EvaluatorTables {
        basis_rows: by_rows(&tables.basis_rows),
        stitch_stiffness: columns(&half, s),
        gravity_loads: columns(&tables.gravity_loads, 3),
        r: s,
        ..tables.clone()
    }
}
