//! The reduced model: cubature-summed energy, force and stiffness in the subspace
//! (\[M16\] eq. 14, \[B12\] §3.1), independent of the mesh's size.

use crate::dense::{self, vectorized};
use crate::frame::FreeBody;
use crate::material::{Elasticity, Hyperelastic, Law, Mat3, Mat9};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;
use std::sync::Arc;

/// Points that one task works on where a rule has many: with every tet in it, the stiffness of all
/// points at once would take hundreds of megabytes.
const POINTS_PER_TASK: usize = 256;

/// Points whose response ∂P/∂F·G is held at a time: it stays in the processor's cache.
const POINTS_PER_BLOCK: usize = 64;

/// Columns of the reduced stiffness that one product makes.
const STRIP: usize = 16;

/// Columns of the basis are worked on so many at a time; tables are padded to a multiple of it.
const LANES: usize = 8;

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
    /// Basis rows at the four corners, `p × 4 × 3 × r`.
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
    points: Vec<Point>,
    /// ∂(∇u)/∂q at each point: column 9·point + 3·i + j holds ∂(∂u_i/∂X_j)/∂q, padded by zeros to a
    /// multiple of [`LANES`] rows.
    gradients: Mat<f64>,
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
pub struct GradientTable(Mat<f64>);

impl ReducedModel {
    /// An empty table for `n_points` points and `r` columns.
    pub fn gradient_table(n_points: usize, r: usize) -> GradientTable {
        GradientTable(Mat::zeros(r.next_multiple_of(LANES), 9 * n_points))
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
        let GradientTable(gradients) = gradients;
        assert_eq!(gradients.ncols(), 9 * points.len(), "one table entry a point");
        let mut model = ReducedModel {
            points,
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
        let r = self.r;
        Evaluation {
            energy_j: sums.energy_j,
            force: sums.force,
            // Symmetric: its columns are its rows.
            stiffness: (0..r).flat_map(|j| sums.stiffness.col_as_slice(j)).copied().collect(),
        }
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
        let mut padded = vec![0.0; self.gradients.nrows()];
        padded[..r].copy_from_slice(q);
        let task = |(task, points): (usize, &[Point])| {
            let first = POINTS_PER_TASK * task;
            let gradients = self.gradients.subcols(9 * first, 9 * points.len());
            self.partial_sums(points, gradients, &padded, with_stiffness)
        };
        // A simulation's thread need not wait for a pool that may be busy with builds.
        let parts: Vec<Sums> = if self.points.len() <= POINTS_PER_TASK {
            vec![task((0, &self.points))]
        } else {
            self.points.par_chunks(POINTS_PER_TASK).enumerate().map(task).collect()
        };
        let column = MatRef::from_column_major_slice(q, r, 1);
        let stitch_force = dense::small_product(self.stitch_stiffness.as_ref(), column);
        let mut sums = Sums {
            energy_j: 0.5 * (column.col(0).transpose() * stitch_force.col(0)),
            force: (0..r).map(|i| stitch_force[(i, 0)]).collect(),
            stiffness: Mat::zeros(0, 0),
        };
        if with_stiffness {
            sums.stiffness = self.stitch_stiffness.clone();
        }
        for part in parts {
            sums.energy_j += part.energy_j;
            sums.force.iter_mut().zip(&part.force).for_each(|(sum, f)| *sum += f);
            if with_stiffness {
                sums.stiffness += part.stiffness;
            }
        }
        if with_stiffness {
            for j in 0..r {
                for i in 0..j {
                    sums.stiffness[(i, j)] = sums.stiffness[(j, i)];
                }
            }
        }
        sums
    }

    /// Σ w V Ψ, Σ w V GᵀP and (the lower triangle of) Σ w V Gᵀ(∂P/∂F)G over `points`, whose G are in `gradients`.
    fn partial_sums(
        &self,
        points: &[Point],
        gradients: MatRef<'_, f64>,
        q: &[f64],
        with_stiffness: bool,
    ) -> Sums {
        let r = self.r;
        let mut sums = Sums {
            energy_j: 0.0,
            force: vec![0.0; q.len()],
            stiffness: if with_stiffness { Mat::zeros(r, r) } else { Mat::zeros(0, 0) },
        };
        let n_block = POINTS_PER_BLOCK.min(points.len());
        let n_response = if with_stiffness { 9 * n_block } else { 0 };
        let mut response = Mat::<f64>::zeros(q.len(), n_response);
        for (block, points) in points.chunks(POINTS_PER_BLOCK).enumerate() {
            let gradients = gradients.subcols(9 * POINTS_PER_BLOCK * block, 9 * points.len());
            for (p, point) in points.iter().enumerate() {
                let g: [&[f64]; 9] = std::array::from_fn(|k| column_of(gradients, 9 * p + k));
                let d = vectorized(
                    #[inline(always)]
                    || g.map(|g| inner(g, q)),
                );
                let d = Mat3::from_fn(|i, j| d[3 * i + j]);
                let (energy, stress, derivative) = point.elasticity.at(&d, with_stiffness);
                sums.energy_j += point.weight_m3 * energy;
                let stress = stress * point.weight_m3;
                let stress: [f64; 9] = std::array::from_fn(|k| stress[(k / 3, k % 3)]);
                vectorized(
                    #[inline(always)]
                    || combine(&mut sums.force, &g, &stress),
                );
                if let Some(mut c) = derivative {
                    c.iter_mut().flatten().for_each(|c| *c *= point.weight_m3);
                    respond(&mut response, 9 * p, &g, &c);
                }
            }
            if with_stiffness {
                let response = response.subcols(0, 9 * points.len());
                add_symmetric_product(
                    sums.stiffness.as_mut(),
                    gradients.subrows(0, r),
                    response.subrows(0, r),
                );
            }
        }
        sums.force.truncate(r);
        sums
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let of = |m: &Mat<f64>| m.nrows() * m.ncols() * size_of::<f64>();
        of(&self.gradients)
            + 2 * of(&self.rest_stiffness)
            + self.free.as_ref().map_or(0, |free| free.bytes())
    }
}

impl GradientTable {
    /// Sets `point` from the gradients of its four shape functions (1/m) and the basis rows at its corners
    /// (12×r, corner-major).
    pub fn set(&mut self, point: usize, shape: &[[f64; 3]; 4], rows: MatRef<'_, f64>) {
        set_gradients(self.0.as_mut().subcols_mut(9 * point, 9), shape, rows);
    }

    /// Sets all points, `per_task` of them at a time and in parallel: `of(first, count)` gives their
    /// shape gradients and their rows (12·count × r).
    pub fn fill(
        &mut self,
        per_task: usize,
        of: impl Fn(usize, usize) -> (Vec<[[f64; 3]; 4]>, Mat<f64>) + Sync,
    ) {
        let parts = self.0.as_mut().par_col_chunks_mut(9 * per_task).enumerate();
        parts.for_each(|(task, mut part)| {
            let count = part.ncols() / 9;
            let (shapes, rows) = of(task * per_task, count);
            for (p, shape) in shapes.iter().enumerate().take(count) {
                let rows = rows.subrows(12 * p, 12);
                set_gradients(part.as_mut().subcols_mut(9 * p, 9), shape, rows);
            }
        });
    }
}

fn set_gradients(mut to: faer::MatMut<'_, f64>, shape: &[[f64; 3]; 4], rows: MatRef<'_, f64>) {
    for column in 0..rows.ncols() {
        for i in 0..3 {
            for j in 0..3 {
                to[(column, 3 * i + j)] =
                    (0..4).map(|corner| rows[(3 * corner + i, column)] * shape[corner][j]).sum();
            }
        }
    }
}

/// The lower triangle of A += XYᵀ (r×k each), strip by strip of columns. An evaluation at 60 columns and 120
/// points took 117 µs, against 137 µs with a recursive product of triangular structure.
fn add_symmetric_product(mut a: MatMut<'_, f64>, x: MatRef<'_, f64>, y: MatRef<'_, f64>) {
    let r = a.nrows();
    for first in (0..r).step_by(STRIP) {
        let columns = STRIP.min(r - first);
        let to = a.as_mut().submatrix_mut(first, first, r - first, columns);
        let (x, y) = (x.subrows(first, r - first), y.subrows(first, columns));
        matmul(to, Accum::Add, x, y.transpose(), 1.0, Par::Seq);
    }
}

/// C·G of one point, into nine columns from `first` on.
fn respond(response: &mut Mat<f64>, first: usize, g: &[&[f64]; 9], c: &Mat9) {
    let rows = response.nrows();
    let mut out = response.as_mut().subcols_mut(first, 9);
    let mut columns: [&mut [f64]; 9] = std::array::from_fn(|_| &mut [][..]);
    for (to, column) in columns.iter_mut().zip(out.as_mut().col_iter_mut()) {
        if let Some(column) = column.try_as_col_major_mut() {
            *to = column.as_slice_mut();
        }
    }
    pulp::Arch::new().dispatch(Response { rows, g, c, columns: &mut columns });
}

struct Response<'a, 'b> {
    rows: usize,
    g: &'a [&'a [f64]; 9],
    c: &'a Mat9,
    columns: &'a mut [&'b mut [f64]; 9],
}

impl WithSimd for Response<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Response { rows, g, c, columns } = self;
        for part in 0..rows / S::F64_LANES {
            let mut x = [simd.splat_f64s(0.0); 9];
            for k in 0..9 {
                x[k] = S::as_simd_f64s(g[k]).0[part];
            }
            for i in 0..9 {
                let mut sum = simd.mul_f64s(simd.splat_f64s(c[i][0]), x[0]);
                for k in 1..9 {
                    sum = simd.mul_add_f64s(simd.splat_f64s(c[i][k]), x[k], sum);
                }
                S::as_mut_simd_f64s(columns[i]).0[part] = sum;
            }
        }
    }
}

pub(crate) struct Sums {
    pub(crate) energy_j: f64,
    pub(crate) force: Vec<f64>,
    pub(crate) stiffness: Mat<f64>,
}

#[inline(always)]
fn column_of(m: MatRef<'_, f64>, j: usize) -> &[f64] {
    m.col(j).try_as_col_major().map_or(&[], |column| column.as_slice())
}

#[inline(always)]
fn lanes(x: &[f64]) -> [f64; LANES] {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&x[..LANES]);
    lanes
}

/// xᵀy of slices whose length is a multiple of [`LANES`].
#[inline(always)]
fn inner(x: &[f64], y: &[f64]) -> f64 {
    let mut sum = [0.0; LANES];
    for (x, y) in x.chunks_exact(LANES).zip(y.chunks_exact(LANES)) {
        for lane in 0..LANES {
            sum[lane] += x[lane] * y[lane];
        }
    }
    sum.iter().sum()
}

/// y += Σ s_k x_k.
#[inline(always)]
fn combine(y: &mut [f64], x: &[&[f64]; 9], s: &[f64; 9]) {
    for (block, y) in y.chunks_exact_mut(LANES).enumerate() {
        let sum = combined(lanes(y), block, x, s);
        y.copy_from_slice(&sum);
    }
}

#[inline(always)]
fn combined(mut sum: [f64; LANES], block: usize, x: &[&[f64]; 9], s: &[f64; 9]) -> [f64; LANES] {
    for k in 0..9 {
        let x = lanes(&x[k][LANES * block..]);
        for lane in 0..LANES {
            sum[lane] += s[k] * x[lane];
        }
    }
    sum
}
