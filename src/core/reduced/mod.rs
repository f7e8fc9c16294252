//! The reduced model: cubature-summed energy, force and stiffness in the subspace
//! (\[M16\] eq. 14, \[B12\] §3.1), independent of the mesh's size.

mod newmark;
mod statics;

pub use newmark::{Integrator, Simulation, SimulationError, SimulationParams, StepReport};
pub use statics::StaticError;

use crate::assembly::FullModel;
use crate::cubature::Rule;
use crate::dictionary::Combination;
use crate::linalg;
use crate::material::stvk;
use faer::{Mat, MatRef};
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Points that one task works on where a rule has many: with every tet in it, the stiffness of all
/// points at once would take hundreds of megabytes.
const POINTS_PER_TASK: usize = 256;

/// Energy, force and tangent stiffness in reduced coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// Strain energy, stitches included, in J.
    pub energy_j: f64,
    /// Reduced internal force +∂Ψ/∂q, r numbers.
    pub force: Vec<f64>,
    /// Reduced tangent stiffness, r × r, row-major (symmetric).
    pub stiffness: Vec<f64>,
}

/// The evaluator as plain arrays (`p` points, `r` columns), row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct EvaluatorTables {
    /// Tet of each point, `p`.
    pub tets: Vec<u32>,
    /// Cubature weight of each point, `p`.
    pub weights: Vec<f64>,
    /// Rest volume of each point's tet in m³, `p`.
    pub volumes_m3: Vec<f64>,
    /// Lamé's λ and μ of each point in Pa, `p × 2`.
    pub lame_pa: Vec<f64>,
    /// Gradients of the four shape functions, `p × 4 × 3`, in 1/m.
    pub shape_gradients: Vec<f64>,
    /// Basis rows at the four corners, `p × 4 × 3 × r`.
    pub basis_rows: Vec<f64>,
    /// Reduced stitch stiffness ŪᵀAAᵀŪ, `r × r`.
    pub stitch_stiffness: Vec<f64>,
    /// Columns of the basis.
    pub r: usize,
}

/// Rayleigh damping D = α M + β K.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayleighDamping {
    /// α in 1/s.
    pub mass_per_s: f64,
    /// β in s.
    pub stiffness_s: f64,
}

/// One cubature point.
#[derive(Clone, Copy, Debug)]
struct Point {
    lame: [f64; 2],
    /// Cubature weight times rest volume.
    weight_m3: f64,
}

/// A body in its subspace: small, self-contained, independent of the mesh's size.
#[derive(Debug)]
pub struct ReducedModel {
    points: Vec<Point>,
    /// ∂(∇u)/∂q at each point: rows 9·point + 3·i + j hold ∂u_i/∂X_j (9p×r).
    gradients: Mat<f64>,
    stitch_stiffness: Mat<f64>,
    /// Reduced stiffness at rest, stitches included: damping uses it.
    rest_stiffness: Mat<f64>,
    damping: RayleighDamping,
    /// Reduced load of unit gravity along each axis (r×3).
    gravity: Mat<f64>,
    n_rigid_modes: usize,
}

impl ReducedModel {
    /// Tables for `rule` in `basis`; `stretch` is AᵀU (3s×r).
    pub(crate) fn new(
        model: &FullModel,
        rule: &Rule,
        basis: &Combination,
        stretch: MatRef<'_, f64>,
        damping: RayleighDamping,
        n_rigid_modes: usize,
    ) -> ReducedModel {
        let r = basis.n_columns();
        let mut gradients = Mat::zeros(9 * rule.tets.len(), r);
        gradients
            .as_mut()
            .par_row_chunks_mut(9 * POINTS_PER_TASK)
            .zip(rule.tets.par_chunks(POINTS_PER_TASK))
            .for_each(|(mut gradients, tets)| {
                let rows = basis.rows(&corner_dofs(model, tets));
                for (point, &tet) in tets.iter().enumerate() {
                    let shape = &model.gradients()[tet as usize];
                    for column in 0..r {
                        for (corner, shape) in shape.iter().enumerate() {
                            for i in 0..3 {
                                let x = rows[(12 * point + 3 * corner + i, column)];
                                for j in 0..3 {
                                    gradients[(9 * point + 3 * i + j, column)] += x * shape[j];
                                }
                            }
                        }
                    }
                }
            });
        let points = rule
            .tets
            .iter()
            .zip(&rule.weights)
            .map(|(&tet, weight)| Point {
                lame: model.lame()[tet as usize],
                weight_m3: weight * model.volumes_m3()[tet as usize],
            })
            .collect();
        let gravity = basis.under_loads(|| model.translation_loads());
        let mut reduced = ReducedModel {
            points,
            gradients,
            stitch_stiffness: linalg::gram(stretch, stretch),
            rest_stiffness: Mat::zeros(r, r),
            damping,
            gravity,
            n_rigid_modes,
        };
        reduced.rest_stiffness = reduced.sums(&vec![0.0; r], true).stiffness;
        reduced
    }

    /// Number of reduced coordinates.
    pub fn r(&self) -> usize {
        self.gradients.ncols()
    }

    /// Energy, force and stiffness at `q` (r numbers) by cubature.
    pub fn evaluate(&self, q: &[f64]) -> Evaluation {
        let sums = self.sums(q, true);
        let r = self.r();
        Evaluation {
            energy_j: sums.energy_j,
            force: sums.force,
            stiffness: (0..r * r).map(|i| sums.stiffness[(i / r, i % r)]).collect(),
        }
    }

    /// Reduced load of gravity, r numbers.
    pub(crate) fn gravity_load(&self, gravity_m_s2: [f64; 3]) -> Vec<f64> {
        (0..self.r())
            .map(|i| (0..3).map(|axis| self.gravity[(i, axis)] * gravity_m_s2[axis]).sum())
            .collect()
    }

    /// Energy and force, and the stiffness if asked for (otherwise 0×0).
    fn sums(&self, q: &[f64], with_stiffness: bool) -> Sums {
        let r = self.r();
        let q = Mat::from_fn(r, 1, |i, _| q[i]);
        let d = linalg::product(self.gradients.as_ref(), q.as_ref());
        let mut stress = Mat::zeros(d.nrows(), 1);
        let mut energy_j = 0.0;
        for (p, point) in self.points.iter().enumerate() {
            let gradient = Matrix3::from_fn(|i, j| d[(9 * p + 3 * i + j, 0)]);
            energy_j += point.weight_m3 * stvk::energy_density(&gradient, point.lame);
            let piola = stvk::stress(&gradient, point.lame) * point.weight_m3;
            (0..9).for_each(|k| stress[(9 * p + k, 0)] = piola[(k / 3, k % 3)]);
        }
        let stitch_force = linalg::small_product(self.stitch_stiffness.as_ref(), q.as_ref());
        energy_j += 0.5 * (q.col(0).transpose() * stitch_force.col(0));
        let mut force = linalg::gram(self.gradients.as_ref(), stress.as_ref());
        force += &stitch_force;
        let stiffness = if with_stiffness { self.stiffness_at(&d) } else { Mat::zeros(0, 0) };
        Sums { energy_j, force: (0..r).map(|i| force[(i, 0)]).collect(), stiffness }
    }

    /// Σ w V G_pᵀ (∂P/∂F) G_p + stitches, from the displacement gradients `d` of all points.
    fn stiffness_at(&self, d: &Mat<f64>) -> Mat<f64> {
        let r = self.r();
        let part = |(task, points): (usize, &[Point])| {
            let gradients = self.gradients.subrows(9 * POINTS_PER_TASK * task, 9 * points.len());
            let mut response = Mat::<f64>::zeros(9 * points.len(), r);
            for (p, point) in points.iter().enumerate() {
                let first = 9 * (POINTS_PER_TASK * task + p);
                let gradient = Matrix3::from_fn(|i, j| d[(first + 3 * i + j, 0)]);
                let c = stvk::stress_derivative(&gradient, point.lame);
                let c = Mat::from_fn(9, 9, |i, j| point.weight_m3 * c[i][j]);
                let product = linalg::small_product(c.as_ref(), gradients.subrows(9 * p, 9));
                response.as_mut().subrows_mut(9 * p, 9).copy_from(&product);
            }
            linalg::small_product(gradients.transpose(), response.as_ref())
        };
        let parts: Vec<Mat<f64>> =
            self.points.par_chunks(POINTS_PER_TASK).enumerate().map(part).collect();
        let mut stiffness = self.stitch_stiffness.clone();
        for part in parts {
            stiffness += part;
        }
        Mat::from_fn(r, r, |i, j| 0.5 * (stiffness[(i, j)] + stiffness[(j, i)]))
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        linalg::bytes(&self.gradients) + 2 * linalg::bytes(&self.rest_stiffness)
    }
}

/// Degrees of freedom at the corners of `tets`, twelve a tet.
fn corner_dofs(model: &FullModel, tets: &[u32]) -> Vec<Option<usize>> {
    tets.iter().flat_map(|&tet| model.corner_dofs(tet as usize)).collect()
}

struct Sums {
    energy_j: f64,
    force: Vec<f64>,
    stiffness: Mat<f64>,
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
    let flat =
        |m: &Mat<f64>| -> Vec<f64> { (0..m.nrows() * r).map(|i| m[(i / r, i % r)]).collect() };
    EvaluatorTables {
        tets: rule.tets.clone(),
        weights: rule.weights.clone(),
        volumes_m3: rule.tets.iter().map(|t| model.volumes_m3()[of(t)]).collect(),
        lame_pa: rule.tets.iter().flat_map(|t| model.lame()[of(t)]).collect(),
        shape_gradients: rule
            .tets
            .iter()
            .flat_map(|t| model.gradients()[of(t)].into_iter().flatten())
            .collect(),
        basis_rows: flat(&basis.rows(&corner_dofs(model, &rule.tets))),
        stitch_stiffness: flat(&reduced.stitch_stiffness),
        r,
    }
}
