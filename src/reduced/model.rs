//! The reduced model: cubature-summed energy, force and stiffness in the subspace
//! (\[M16\] eq. 14, \[B12\] §3.1), independent of the mesh's size.

use crate::dense;
use crate::frame::FreeBody;
use crate::material::{Elasticity, Hyperelastic, Law, Mat3, Mat9};
use crate::products::{self, Table};
use faer::{Mat, MatRef};
use rayon::prelude::*;
use std::sync::Arc;

/// Points that one task works on where a rule has many: with every tet in it, the stiffness of all
/// points at once would take hundreds of megabytes.
const POINTS_PER_TASK: usize = 256;

/// Points whose response ∂P/∂F·G is held at a time: it stays in the processor's cache.
const POINTS_PER_BLOCK: usize = 8;

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
    /// Number of each point's [`Law`], `p`.
    pub laws: Vec<u32>,
    /// Lamé's λ and μ of each point in Pa, `p × 2`.
    pub lame_pa: Vec<f64>,
    /// C₀₁/(C₁₀ + C₀₁) of each point (0 but for Mooney–Rivlin), `p`.
    pub mooney_ratios: Vec<f64>,
    /// Gradients of the four shape functions, `p × 4 × 3`, in 1/m.
    pub shape_gradients: Vec<f64>,
    /// Basis rows at the four corners, or those of an affine displacement that has the point's gradient, `p × 4 × 3 × r`.
    pub basis_rows: Vec<f64>,
    /// Reduced stitch stiffness ŪᵀAAᵀŪ, `r × r`.
    pub stitch_stiffness: Vec<f64>,
    /// Reduced load of unit gravity along each axis, `r × 3`.
    pub gravity_loads: Vec<f64>,
    /// Rayleigh damping of the body.
    pub damping: RayleighDamping,
    /// Rigid motions that supports and stitches leave.
    pub n_rigid_modes: usize,
    /// Columns of the basis.
    pub r: usize,
}

/// Why tables make no model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)] // the messages say what the fields are
pub enum TableError {
    #[error("{name} has {given} entries, not {expected}")]
    Length { name: &'static str, given: usize, expected: usize },
    #[error("point {point} follows law {law}, which is none")]
    Law { point: usize, law: u32 },
    #[error("{name} holds a number that is not finite")]
    NonFinite { name: &'static str },
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
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// The material.
    pub elasticity: Elasticity,
    /// Cubature weight times rest volume.
    pub weight_m3: f64,
}

/// A body in its subspace: small, self-contained, independent of the mesh's size.
#[derive(Debug)]
pub struct ReducedModel {
    /// Of each point, its weight in m³ times as stiff: what it adds is then in J.
    points: Vec<Elasticity>,
    /// ∂(∇u)/∂q at each point: column 9·point + 3·i + j holds ∂(∂u_i/∂X_j)/∂q.
    gradients: Table,
    r: usize,
    stitch_stiffness: Mat<f64>,
    /// Reduced stiffness at rest, stitches included: damping uses it.
    rest_stiffness: Mat<f64>,
    damping: RayleighDamping,
    /// Reduced load of unit gravity along each axis (r×3).
    gravity: Mat<f64>,
    n_rigid_modes: usize,
    free: Option<Arc<FreeBody>>,
}

/// [`ReducedModel::gradient_table`] filled point by point.
#[derive(Debug)]
pub struct GradientTable {
    table: Table,
    n_points: usize,
}

impl ReducedModel {
    /// An empty table for `n_points` points and `r` columns.
    pub fn gradient_table(n_points: usize, r: usize) -> GradientTable {
        GradientTable { table: Table::zeros(r, 9 * n_points), n_points }
    }

    /// `stitch_stiffness` is ŪᵀAAᵀŪ (r×r); `gravity` the load of unit gravity along each axis (r×3);
    /// `free` what moves a body that nothing holds.
    pub fn new(
        points: Vec<Point>,
        gradients: GradientTable,
        stitch_stiffness: Mat<f64>,
        damping: RayleighDamping,
        gravity: Mat<f64>,
        n_rigid_modes: usize,
        free: Option<Arc<FreeBody>>,
    ) -> ReducedModel {
        let r = stitch_stiffness.nrows();
        let GradientTable { table: gradients, n_points } = gradients;
        assert_eq!(n_points, points.len(), "one table entry a point");
        let weighted = |point: &Point| point.elasticity.scaled(point.weight_m3);
        let mut model = ReducedModel {
            points: points.iter().map(weighted).collect(),
            gradients,
            r,
            stitch_stiffness,
            rest_stiffness: Mat::zeros(r, r),
            damping,
            gravity,
            n_rigid_modes,
            free,
        };
        model.rest_stiffness = model.sums(&vec![0.0; r], true).stiffness;
        model
    }

    /// The model of a body whose evaluator's tables are known.
    pub fn from_tables(tables: &EvaluatorTables) -> Result<ReducedModel, TableError> {
        let EvaluatorTables { r, .. } = *tables;
        let p = tables.tets.len();
        let lengths = [
            ("weights", tables.weights.len(), p),
            ("volumes_m3", tables.volumes_m3.len(), p),
            ("laws", tables.laws.len(), p),
            ("lame_pa", tables.lame_pa.len(), 2 * p),
            ("mooney_ratios", tables.mooney_ratios.len(), p),
            ("shape_gradients", tables.shape_gradients.len(), 12 * p),
            ("basis_rows", tables.basis_rows.len(), 12 * p * r),
            ("stitch_stiffness", tables.stitch_stiffness.len(), r * r),
            ("gravity_loads", tables.gravity_loads.len(), 3 * r),
        ];
        for (name, given, expected) in lengths {
            if given != expected {
                return Err(TableError::Length { name, given, expected });
            }
        }
        for (name, values) in [
            ("weights", &tables.weights),
            ("volumes_m3", &tables.volumes_m3),
            ("lame_pa", &tables.lame_pa),
            ("mooney_ratios", &tables.mooney_ratios),
            ("shape_gradients", &tables.shape_gradients),
            ("basis_rows", &tables.basis_rows),
            ("stitch_stiffness", &tables.stitch_stiffness),
            ("gravity_loads", &tables.gravity_loads),
        ] {
            if values.iter().any(|x| !x.is_finite()) {
                return Err(TableError::NonFinite { name });
            }
        }
        let mut points = Vec::with_capacity(p);
        let mut gradients = ReducedModel::gradient_table(p, r);
        for point in 0..p {
            let law = Law::ALL.get(tables.laws[point] as usize).copied();
            let law = law.ok_or(TableError::Law { point, law: tables.laws[point] })?;
            points.push(Point {
                elasticity: Elasticity {
                    law,
                    lame: [tables.lame_pa[2 * point], tables.lame_pa[2 * point + 1]],
                    mooney_ratio: tables.mooney_ratios[point],
                },
                weight_m3: tables.weights[point] * tables.volumes_m3[point],
            });
            let shape = &tables.shape_gradients[12 * point..][..12];
            let shape = std::array::from_fn(|a| std::array::from_fn(|j| shape[3 * a + j]));
            let rows = &tables.basis_rows[12 * point * r..][..12 * r];
            let rows = MatRef::from_row_major_slice(rows, 12, r);
            gradients.set(point, &shape, rows);
        }
        let square = MatRef::from_row_major_slice(&tables.stitch_stiffness, r, r);
        let gravity = MatRef::from_row_major_slice(&tables.gravity_loads, r, 3);
        Ok(ReducedModel::new(
            points,
            gradients,
            square.to_owned(),
            tables.damping,
            gravity.to_owned(),
            tables.n_rigid_modes,
            None,
        ))
    }

    /// Number of reduced coordinates.
    pub fn r(&self) -> usize {
        self.r
    }
    /// Rigid motions that supports and stitches leave.
    pub fn n_rigid_modes(&self) -> usize {
        self.n_rigid_modes
    }
    /// Inertia of a body that nothing holds.
    pub fn free_body(&self) -> Option<&Arc<FreeBody>> {
        self.free.as_ref()
    }
    /// Reduced stiffness at rest, stitches included (r×r).
    pub fn rest_stiffness(&self) -> MatRef<'_, f64> {
        self.rest_stiffness.as_ref()
    }
    /// Reduced stiffness of the stitches (r×r).
    pub fn stitch_stiffness(&self) -> MatRef<'_, f64> {
        self.stitch_stiffness.as_ref()
    }
    /// Reduced load of unit gravity along each axis (r×3).
    pub fn gravity_loads(&self) -> MatRef<'_, f64> {
        self.gravity.as_ref()
    }
    /// The body's damping.
    pub fn damping(&self) -> RayleighDamping {
        self.damping
    }

    /// αI + βK̃(0).
    pub(crate) fn damping_matrix(&self) -> Mat<f64> {
        Mat::from_fn(self.r, self.r, |i, j| {
            self.damping.stiffness_s * self.rest_stiffness[(i, j)]
                + if i == j { self.damping.mass_per_s } else { 0.0 }
        })
    }

    /// Energy, force and stiffness at `q` (r numbers) by cubature.
    pub fn evaluate(&self, q: &[f64]) -> Evaluation {
        let sums = self.sums(q, true);
        // Symmetric: its columns are its rows.
        let mut rows = Vec::with_capacity(self.r * self.r);
        (0..self.r).for_each(|j| rows.extend_from_slice(sums.stiffness.col_as_slice(j)));
        Evaluation { energy_j: sums.energy_j, force: sums.force, stiffness: rows }
    }

    /// Reduced load of gravity, r numbers.
    pub(crate) fn gravity_load(&self, gravity_m_s2: [f64; 3]) -> Vec<f64> {
        (0..self.r)
            .map(|i| (0..3).map(|axis| self.gravity[(i, axis)] * gravity_m_s2[axis]).sum())
            .collect()
    }

    /// Energy and force, and the stiffness if asked for (otherwise 0×0).
    pub(crate) fn sums(&self, q: &[f64], with_stiffness: bool) -> Sums {
        let r = self.r;
        let mut padded = vec![0.0; self.gradients.rows()];
        padded[..r].copy_from_slice(q);
        let task = |(task, points): (usize, &[Elasticity])| {
            let first = POINTS_PER_TASK * task;
            let gradients = self.gradients.columns(9 * first, 9 * points.len());
            self.partial_sums(points, gradients, &padded, with_stiffness)
        };
        // A simulation's thread need not wait for a pool that may be busy with builds.
        let parts: Vec<PartialSums> = if self.points.len() <= POINTS_PER_TASK {
            vec![task((0, &self.points))]
        } else {
            self.points.par_chunks(POINTS_PER_TASK).enumerate().map(task).collect()
        };
        let column = MatRef::from_column_major_slice(q, r, 1);
        let stitch_force = dense::small_product(self.stitch_stiffness.as_ref(), column);
        let mut sums = Sums {
            energy_j: 0.5 * (column.col(0).transpose() * stitch_force.col(0)),
            force: stitch_force.col_as_slice(0).to_vec(),
            stiffness: match with_stiffness {
                true => self.stitch_stiffness.clone(),
                false => Mat::zeros(0, 0),
            },
        };
        for part in &parts {
            sums.energy_j += part.energy_j;
            sums.force.iter_mut().zip(&part.force).for_each(|(sum, f)| *sum += f);
            for j in 0..sums.stiffness.ncols() {
                let to = &mut sums.stiffness.col_as_slice_mut(j)[j..];
                let from = &part.stiffness.columns(j, 1)[j..];
                to.iter_mut().zip(from).for_each(|(sum, k)| *sum += k);
            }
        }
        for j in 0..sums.stiffness.ncols() {
            for i in 0..j {
                sums.stiffness[(i, j)] = sums.stiffness[(j, i)];
            }
        }
        sums
    }

    /// Σ w V Ψ, Σ w V GᵀP and (the lower triangle of) Σ w V Gᵀ(∂P/∂F)G over `points`, whose columns G `gradients`
    /// are; padded as these are.
    fn partial_sums(
        &self,
        points: &[Elasticity],
        gradients: &[f64],
        q: &[f64],
        with_stiffness: bool,
    ) -> PartialSums {
        let rows = q.len();
        let mut sums = PartialSums {
            energy_j: 0.0,
            force: vec![0.0; rows],
            stiffness: Table::zeros(rows, if with_stiffness { rows } else { 0 }),
        };
        let n_response = if with_stiffness { 9 * POINTS_PER_BLOCK } else { 0 };
        let mut response = Table::zeros(rows, n_response);
        let mut strains = [[0.0; 9]; POINTS_PER_BLOCK];
        let mut stresses = [[0.0; 9]; POINTS_PER_BLOCK];
        let mut derivatives: [Mat9; POINTS_PER_BLOCK] = [[[0.0; 9]; 9]; POINTS_PER_BLOCK];
        let blocks = gradients.chunks(9 * rows * POINTS_PER_BLOCK);
        for (points, gradients) in points.chunks(POINTS_PER_BLOCK).zip(blocks) {
            let count = points.len();
            products::transposed_products(gradients, q, &mut strains[..count]);
            for (p, point) in points.iter().enumerate() {
                let d = Mat3::from_row_slice(&strains[p]);
                let derivative = with_stiffness.then_some(&mut derivatives[p]);
                let (energy, stress) = point.at(&d, derivative);
                sums.energy_j += energy;
                stresses[p] = std::array::from_fn(|k| stress[(k / 3, k % 3)]);
            }
            products::add_products(&mut sums.force, gradients, &stresses[..count]);
            if with_stiffness {
                let response = response.columns_mut(0, 9 * count);
                products::responses(response, rows, gradients, &derivatives[..count]);
                let stiffness = sums.stiffness.columns_mut(0, rows);
                products::add_lower_product(stiffness, rows, gradients, response);
            }
        }
        sums
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let of = |m: &Mat<f64>| m.nrows() * m.ncols() * size_of::<f64>();
        self.gradients.bytes()
            + 2 * of(&self.rest_stiffness)
            + self.free.as_ref().map_or(0, |free| free.bytes())
    }
}

impl GradientTable {
    /// Sets `point` from the gradients of its four shape functions (1/m) and the basis rows at its corners
    /// (12×r, corner-major).
    pub fn set(&mut self, point: usize, shape: &[[f64; 3]; 4], rows: MatRef<'_, f64>) {
        set_gradients(self.table.columns_mut(9 * point, 9), shape, rows);
    }

    /// Sets all points, `per_task` of them at a time and in parallel: `of(first, count)` gives their
    /// shape gradients and their rows (12·count × r).
    pub fn fill(
        &mut self,
        per_task: usize,
        of: impl Fn(usize, usize) -> (Vec<[[f64; 3]; 4]>, Mat<f64>) + Sync,
    ) {
        let (n_rows, n_columns) = (self.table.rows(), 9 * self.n_points);
        let parts = self.table.columns_mut(0, n_columns).par_chunks_mut(9 * n_rows * per_task);
        parts.enumerate().for_each(|(task, part)| {
            let count = part.len() / (9 * n_rows);
            let (shapes, rows) = of(task * per_task, count);
            for (p, (part, shape)) in part.chunks_exact_mut(9 * n_rows).zip(&shapes).enumerate() {
                set_gradients(part, shape, rows.subrows(12 * p, 12));
            }
        });
    }
}

/// Fills the nine columns of a point.
fn set_gradients(to: &mut [f64], shape: &[[f64; 3]; 4], rows: MatRef<'_, f64>) {
    let n_rows = to.len() / 9;
    for (k, to) in to.chunks_exact_mut(n_rows).enumerate() {
        let (i, j) = (k / 3, k % 3);
        for (column, to) in to.iter_mut().enumerate().take(rows.ncols()) {
            *to = (0..4).map(|corner| rows[(3 * corner + i, column)] * shape[corner][j]).sum();
        }
    }
}

/// What some of the points add, padded.
struct PartialSums {
    energy_j: f64,
    force: Vec<f64>,
    stiffness: Table,
}

pub(crate) struct Sums {
    pub(crate) energy_j: f64,
    pub(crate) force: Vec<f64>,
    pub(crate) stiffness: Mat<f64>,
}
