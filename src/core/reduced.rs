//! The reduced model of a body: what `sutura-reduced` evaluates and simulates, from basis, cubature rule and
//! full-order model.

use crate::assembly::FullModel;
use crate::assembly::mass::Mass;
use crate::cubature::Rule;
use crate::dictionary::Combination;
use crate::linalg;
use faer::{Mat, MatRef};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::sync::Arc;
use sutura_reduced::contact::SurfaceVertex;
pub use sutura_reduced::*;

/// Points whose rows are gathered at a time.
const POINTS_PER_TASK: usize = 16;

/// What of a reduced model is not summed over points.
pub(crate) struct Whole {
    /// UᵀAAᵀU (r×r).
    pub(crate) stitch_stiffness: Mat<f64>,
    /// Loads of unit gravity along each axis (r×3): [`gravity_loads`].
    pub(crate) gravity: Mat<f64>,
    /// The inertia of a body that nothing holds.
    pub(crate) free: Option<Arc<FreeBody>>,
}

/// Tables for `rule` in `basis`.
pub(crate) fn reduced_model(
    model: &FullModel,
    rule: &Rule,
    basis: &Combination,
    whole: Whole,
    damping: RayleighDamping,
    n_rigid_modes: usize,
) -> ReducedModel {
    let Whole { stitch_stiffness, gravity, free } = whole;
    let mut gradients = ReducedModel::gradient_table(rule.tets.len(), basis.n_columns());
    gradients.fill(POINTS_PER_TASK, |first, count| {
        let points = first..first + count;
        let tets = &rule.tets[points.clone()];
        let shapes = tets.iter().map(|&tet| model.gradients()[tet as usize]).collect();
        (shapes, rule.corner_rows(model, basis, points))
    });
    let point = |(&tet, weight): (&u32, &f64)| Point {
        elasticity: model.elasticities()[tet as usize],
        weight_m3: weight * model.volumes_m3()[tet as usize],
    };
    let points = rule.tets.iter().zip(&rule.weights).map(point).collect();
    ReducedModel::new(points, gradients, stitch_stiffness, damping, gravity, n_rigid_modes, free)
}

/// Reduced loads of unit gravity along each axis (r×3).
pub(crate) fn gravity_loads(model: &FullModel, basis: &Combination) -> Mat<f64> {
    basis.under_loads(|columns| model.under_acceleration(columns))
}

/// The inertia of a body that nothing holds, from its basis (n×r).
pub(crate) fn free_body(model: &FullModel, mass: &Mass, basis: MatRef<'_, f64>) -> FreeBody {
    let (n, r) = (basis.nrows(), basis.ncols());
    // One axis of a field, moved to the first: the mass matrix couples equal axes only.
    let along = |field: MatRef<'_, f64>, axis: usize| {
        let mut first = Mat::<f64>::zeros(n, field.ncols());
        linalg::for_each_column(first.as_mut(), |j, column| {
            for (to, from) in column.chunks_exact_mut(3).zip(0..) {
                to[0] = field[(3 * from + axis, j)];
            }
        });
        first
    };
    let vertices = model.mesh().vertices();
    let place = |i: usize| vertices[model.free_vertices()[i / 3] as usize][i % 3];
    let ones = Mat::from_fn(n, 1, |i, _| if i % 3 == 0 { 1.0 } else { 0.0 });
    let of_ones = mass.multiply(ones.as_ref());
    let mass_kg: f64 = ones.col(0).transpose() * of_ones.col(0);
    let center: [f64; 3] = std::array::from_fn(|axis| {
        let x = Mat::from_fn(n, 1, |i, _| place(3 * (i / 3) + axis));
        (0..n).step_by(3).map(|i| of_ones[(i, 0)] * x[(i, 0)]).sum::<f64>() / mass_kg
    });
    let rest = Mat::from_fn(n, 1, |i, _| place(i) - center[i % 3]);
    let axes = |field: MatRef<'_, f64>| [0, 1, 2].map(|axis| along(field, axis));
    let (u, x) = (axes(basis), axes(rest.as_ref()));
    let weighted = u.each_ref().map(|u| mass.multiply(u.as_ref()));
    let second = Matrix3::from_fn(|a, b| mass.inner(x[a].as_ref(), x[b].as_ref())[(0, 0)]);
    let mut mixed = Mat::zeros(r, 9);
    let sandwich = std::array::from_fn(|k| {
        let [a, b] = [k / 3, k % 3];
        let column = linalg::gram(weighted[a].as_ref(), x[b].as_ref());
        mixed.as_mut().subcols_mut(k, 1).copy_from(&column);
        linalg::gram(u[a].as_ref(), weighted[b].as_ref())
    });
    FreeBody::new(mass_kg, center, second, mixed, sandwich)
}

/// The surface of the body in `basis`: vertices of faces that belong to one tet alone, with a third of
/// their areas. Vertices that cannot move are left out.
pub(crate) fn contact_surface(model: &FullModel, basis: &Combination) -> contact::ContactSurface {
    let (mesh, r) = (model.mesh(), basis.n_columns());
    let mut area_m2 = vec![0.0; mesh.vertices().len()];
    let place = |v: u32| Vector3::from(mesh.vertices()[v as usize]);
    for [a, b, c] in mesh.surface() {
        let area = 0.5 * (place(b) - place(a)).cross(&(place(c) - place(a))).norm();
        for v in [a, b, c] {
            area_m2[v as usize] += area / 3.0;
        }
    }
    let moving: Vec<u32> =
        model.free_vertices().iter().copied().filter(|&v| area_m2[v as usize] > 0.0).collect();
    let vertices: Vec<SurfaceVertex> = moving
        .iter()
        .map(|&v| SurfaceVertex {
            rest_m: mesh.vertices()[v as usize],
            area_m2: area_m2[v as usize],
        })
        .collect();
    let rows: Vec<Vec<f32>> = moving
        .par_chunks(POINTS_PER_TASK)
        .flat_map_iter(|some| {
            let dofs: Vec<Option<usize>> = some
                .iter()
                .flat_map(|&v| {
                    (0..3).map(move |axis| model.free_index(v).map(|index| 3 * index + axis))
                })
                .collect();
            let rows = basis.rows(&dofs);
            (0..some.len())
                .map(|v| (0..3 * r).map(|k| rows[(3 * v + k / r, k % r)] as f32).collect())
                .collect::<Vec<Vec<f32>>>()
        })
        .collect();
    contact::ContactSurface::new(r, &vertices, |v| rows[v].clone())
}

/// The evaluator's tables as a client downloads them.
pub(crate) fn tables(
    model: &FullModel,
    rule: &Rule,
    basis: &Combination,
    reduced: &ReducedModel,
) -> EvaluatorTables {
    let r = basis.n_columns();
    let of = |tet: &u32| *tet as usize;
    let flat = |m: MatRef<'_, f64>| -> Vec<f64> {
        let columns = m.ncols();
        (0..m.nrows() * columns).map(|i| m[(i / columns, i % columns)]).collect()
    };
    let elasticities = || rule.tets.iter().map(|t| model.elasticities()[of(t)]);
    EvaluatorTables {
        tets: rule.tets.clone(),
        weights: rule.weights.clone(),
        volumes_m3: rule.tets.iter().map(|t| model.volumes_m3()[of(t)]).collect(),
        laws: elasticities().map(|elasticity| elasticity.law as u32).collect(),
        lame_pa: elasticities().flat_map(|elasticity| elasticity.lame).collect(),
        mooney_ratios: elasticities().map(|elasticity| elasticity.mooney_ratio).collect(),
        shape_gradients: rule
            .tets
            .iter()
            .flat_map(|t| model.gradients()[of(t)].into_iter().flatten())
            .collect(),
        basis_rows: flat(rule.corner_rows(model, basis, 0..rule.tets.len()).as_ref()),
        stitch_stiffness: flat(reduced.stitch_stiffness()),
        gravity_loads: flat(reduced.gravity_loads()),
        damping: reduced.damping(),
        n_rigid_modes: reduced.n_rigid_modes(),
        r,
    }
}
