//! Cost against size: factorization and solves of structured cubes, 3 000 to 60 000 vertices, their
//! vertices in random order.
//!
//! Nested dissection of a cube of n vertices costs O(n²) operations and O(n^4/3) non-zeros, which
//! are what a solve reads (George 1973; Lipton, Rose, Tarjan 1979).

use crate::bodies::Failure;
use crate::kernels::{backward_error, random};
use crate::measure::{Check, Times, timed};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use sutura_core::assembly::FullModel;
use sutura_core::factorization::{SparseCholesky, SymbolicCholesky};
use sutura_core::material::Material;
use sutura_core::mesh::TetMesh;
use sutura_core::testing::{Bar, Cell, Cut};

/// Cells along an edge.
const CELLS: [usize; 7] = [13, 16, 19, 23, 28, 33, 38];

/// Sizes that exponents are fitted to: the largest ones, whose costs their leading terms rule.
const FITTED: usize = 4;

/// One cube.
#[derive(Serialize, Deserialize)]
pub(crate) struct Point {
    pub(crate) n_vertices: usize,
    pub(crate) n_free_dofs: usize,
    pub(crate) factor_bytes: usize,
    pub(crate) factor_flops: f64,
    /// Ordering and analysis; linear but for a logarithm.
    pub(crate) analysis: Times,
    pub(crate) numeric: Times,
    pub(crate) solve_1: Times,
    pub(crate) solve_32: Times,
}

/// The exponent of a cost in the number of vertices.
#[derive(Serialize, Deserialize)]
pub(crate) struct Exponent {
    pub(crate) what: String,
    pub(crate) fitted: f64,
    pub(crate) theory: f64,
}

/// Every cube, and the exponents of the larger ones.
#[derive(Serialize, Deserialize)]
pub(crate) struct Scaling {
    pub(crate) points: Vec<Point>,
    pub(crate) exponents: Vec<Exponent>,
    pub(crate) checks: Vec<Check>,
}

/// Measures cubes of up to `most_vertices`.
pub(crate) fn measure(most_vertices: usize, repeat: usize) -> Result<Scaling, Failure> {
    let mut points = Vec::new();
    let mut checks = Vec::new();
    for cells in CELLS.into_iter().filter(|cells| (cells + 1).pow(3) <= most_vertices) {
        let (point, check) = cube(cells, repeat)?;
        points.push(point);
        checks.push(check);
    }
    let upper = &points[points.len().saturating_sub(FITTED)..];
    let exponent = |what: &str, theory: f64, cost: &dyn Fn(&Point) -> f64| Exponent {
        what: what.into(),
        fitted: slope(upper, cost),
        theory,
    };
    let exponents = vec![
        exponent("factorization, seconds", 2.0, &|p| p.numeric.median_s),
        exponent("factorization, operations", 2.0, &|p| p.factor_flops),
        exponent("solve of 1 column, seconds", 4.0 / 3.0, &|p| p.solve_1.median_s),
        exponent("solve of 32 columns, seconds", 4.0 / 3.0, &|p| p.solve_32.median_s),
        exponent("bytes of the factor", 4.0 / 3.0, &|p| p.factor_bytes as f64),
    ];
    Ok(Scaling { points, exponents, checks })
}

fn cube(cells: usize, repeat: usize) -> Result<(Point, Check), Failure> {
    let bar =
        Bar { size_m: [0.1; 3], n_cells: [cells; 3], cell: Cell::Six, cut: Cut::Whole }.mesh();
    let n_vertices = bar.mesh.vertices().len();
    let mut new_of: Vec<u32> = (0..n_vertices as u32).collect();
    new_of.shuffle(&mut ChaCha8Rng::seed_from_u64(cells as u64));
    let mut vertices = vec![[0.0; 3]; n_vertices];
    for (v, &new) in new_of.iter().enumerate() {
        vertices[new as usize] = bar.mesh.vertices()[v];
    }
    let tets = bar.mesh.tets().iter().map(|tet| tet.map(|v| new_of[v as usize])).collect();
    let mesh = Arc::new(TetMesh::new(vertices, tets, Vec::new())?);
    let fixed: Vec<u32> = bar.root.iter().map(|&v| new_of[v as usize]).collect();
    let model = FullModel::new(mesh, &[Material::stvk(5e5, 0.4, 1000.0)?], &fixed);
    let stiffness = model.rest_stiffness(&Arc::new(model.pattern(&[])));

    let (analysis, symbolic) =
        timed(repeat, || SymbolicCholesky::new(stiffness.pattern().clone(), 3))?;
    let symbolic = Arc::new(symbolic);
    let (numeric, factor) =
        timed(repeat, || SparseCholesky::with_symbolic(symbolic.clone(), &stiffness))?;
    let b = random(model.n(), 32);
    let solve = |columns: usize| {
        timed(repeat, || {
            let mut x = b.subcols(0, columns).to_owned();
            factor.solve_in_place(x.as_mut());
            Ok::<_, Failure>(x)
        })
    };
    let ((solve_1, _), (solve_32, x)) = (solve(1)?, solve(32)?);
    let check = Check::at_most(
        format!("backward error, cube of {n_vertices} vertices"),
        backward_error(&stiffness, x.as_ref(), b.as_ref()),
        1e-13,
    );
    let point = Point {
        n_vertices,
        n_free_dofs: model.n(),
        factor_bytes: factor.bytes(),
        factor_flops: symbolic.n_flops(),
        analysis,
        numeric,
        solve_1,
        solve_32,
    };
    Ok((point, check))
}

/// Least-squares slope of log cost over log vertices.
fn slope(points: &[Point], cost: &dyn Fn(&Point) -> f64) -> f64 {
    let xy: Vec<[f64; 2]> =
        points.iter().map(|p| [(p.n_vertices as f64).ln(), cost(p).ln()]).collect();
    let mean = |axis: usize| xy.iter().map(|p| p[axis]).sum::<f64>() / xy.len() as f64;
    let (x, y) = (mean(0), mean(1));
    let covariance: f64 = xy.iter().map(|p| (p[0] - x) * (p[1] - y)).sum();
    covariance / xy.iter().map(|p| (p[0] - x).powi(2)).sum::<f64>()
}
