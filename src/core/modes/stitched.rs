//! The stitched stiffness K̂ = K + AAᵀ: its product, and its inverse by Woodbury's formula from the
//! factorization of the unstitched one.
//!
//! For a stitch (a, b, k), A has the three columns √k·(e_a − e_b) (\[M16\] eq. 5). With K_σ = LLᵀ and
//! Y = L⁻¹A,  K̂_σ⁻¹ = L⁻ᵀ (1 − Y (I + C)⁻¹ Yᵀ) L⁻¹  and  C = AᵀK_σ⁻¹A = YᵀY.

use crate::assembly::FullModel;
use crate::assembly::sparse::BlockMatrix;
use crate::dictionary::Combination;
use crate::edit::{Stitch, sorted};
use crate::factorization::{ReachedRows, SparseCholesky};
use crate::lanes::kernels::Real;
use crate::linalg::{self, DenseError, SmallCholesky};
use faer::{Mat, MatMut, MatRef};
use rayon::prelude::*;

/// The matrix A of a set of stitches, as free indices: `None` for an end that is fixed.
#[derive(Clone, Debug)]
pub struct StitchMatrix {
    ends: Vec<[Option<usize>; 2]>,
    root_stiffness: Vec<f64>,
}

impl StitchMatrix {
    /// A for `stitches`, in their order.
    pub fn new(model: &FullModel, stitches: &[Stitch]) -> StitchMatrix {
        StitchMatrix {
            ends: stitches
                .iter()
                .map(|s| sorted(s.pair).map(|vertex| model.free_index(vertex)))
                .collect(),
            root_stiffness: stitches.iter().map(|s| s.stiffness_n_m.sqrt()).collect(),
        }
    }

    /// Columns of A: three for each stitch.
    pub fn n_columns(&self) -> usize {
        3 * self.ends.len()
    }

    /// `AᵀX` (n×k → 3s×k).
    pub fn transpose_times(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        self.stretch(x, |s| self.root_stiffness[s])
    }

    /// AᵀU (3s×r) of a combination U of r columns, of which only the rows of the stitches' ends are made.
    pub fn transpose_times_combination(&self, u: &Combination) -> Mat<f64> {
        let row = |end: Option<usize>, axis| end.map(|v| 3 * v + axis);
        let ends_of = |side: usize| -> Vec<Option<usize>> {
            self.ends.iter().flat_map(|ends| [0, 1, 2].map(|axis| row(ends[side], axis))).collect()
        };
        let [a, b] = [0, 1].map(|side| u.rows(&ends_of(side)));
        Mat::from_fn(self.n_columns(), u.n_columns(), |i, j| {
            self.root_stiffness[i / 3] * (a[(i, j)] - b[(i, j)])
        })
    }

    /// How far X pulls the ends of each stitch apart: AᵀX for unit stiffness.
    pub fn gaps(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        self.stretch(x, |_| 1.0)
    }

    fn stretch(&self, x: MatRef<'_, f64>, scale: impl Fn(usize) -> f64) -> Mat<f64> {
        Mat::from_fn(self.n_columns(), x.ncols(), |row, column| {
            let [a, b] =
                self.ends[row / 3].map(|end| end.map_or(0.0, |v| x[(3 * v + row % 3, column)]));
            scale(row / 3) * (a - b)
        })
    }

    /// `Y += A·Z` (Z is 3s×k).
    pub fn add_times(&self, mut y: MatMut<'_, f64>, z: MatRef<'_, f64>) {
        for column in 0..z.ncols() {
            let mut y = y.as_mut().col_mut(column);
            for (s, ends) in self.ends.iter().enumerate() {
                for (end, sign) in ends.iter().zip([1.0, -1.0]) {
                    let Some(v) = end else { continue };
                    for axis in 0..3 {
                        y[3 * v + axis] +=
                            sign * self.root_stiffness[s] * z[(3 * s + axis, column)];
                    }
                }
            }
        }
    }

    /// A as a dense matrix (n×3s).
    pub fn dense(&self, n: usize) -> Mat<f64> {
        let mut a = Mat::zeros(n, self.n_columns());
        self.add_times(
            a.as_mut(),
            Mat::<f64>::identity(self.n_columns(), self.n_columns()).as_ref(),
        );
        a
    }

    /// A by columns: its entries' rows and values.
    pub fn columns(&self) -> Vec<Vec<(usize, f64)>> {
        let of_stitch = |(ends, root): (&[Option<usize>; 2], &f64)| {
            [0, 1, 2].map(|axis| {
                let entries = ends.iter().zip([*root, -root]);
                entries.filter_map(|(end, value)| end.map(|v| (3 * v + axis, value))).collect()
            })
        };
        self.ends.iter().zip(&self.root_stiffness).flat_map(of_stitch).collect()
    }

    /// Adds AAᵀ to a matrix whose pattern couples the stitched pairs.
    pub fn add_to(&self, stiffness: &mut BlockMatrix) {
        let pattern = stiffness.pattern().clone();
        for (ends, root) in self.ends.iter().zip(&self.root_stiffness) {
            for (i, row) in ends.iter().enumerate() {
                for (j, column) in ends.iter().enumerate() {
                    let (Some(row), Some(column)) = (row, column) else { continue };
                    let Some(entry) = pattern.find(*row, *column as u32) else { continue };
                    let k = root * root * if i == j { 1.0 } else { -1.0 };
                    for axis in 0..3 {
                        stiffness.blocks_mut()[entry][4 * axis] += k;
                    }
                }
            }
        }
    }
}

/// K̂ and K̂_σ⁻¹ of a stitched body, the latter by a factor in numbers `T`.
pub struct StitchedStiffness<'a, T = f64> {
    stiffness: &'a BlockMatrix,
    factor: &'a SparseCholesky<T>,
    a: StitchMatrix,
    /// L⁻¹A.
    half: ReachedRows,
    /// I + C, factorized.
    capacitance: SmallCholesky,
}

impl<'a, T: Real> StitchedStiffness<'a, T> {
    /// Takes half a solve for each column of A, of which most of the factor is skipped.
    pub fn new(
        model: &FullModel,
        stiffness: &'a BlockMatrix,
        factor: &'a SparseCholesky<T>,
        stitches: &[Stitch],
    ) -> Result<StitchedStiffness<'a, T>, DenseError> {
        let a = StitchMatrix::new(model, stitches);
        let half = factor.forward_sparse(&a.columns());
        let mut sum = half.gram();
        (0..sum.nrows()).for_each(|i| sum[(i, i)] += 1.0);
        let capacitance = SmallCholesky::new(sum.as_ref())?;
        Ok(StitchedStiffness { stiffness, factor, a, half, capacitance })
    }

    /// A.
    pub fn stitch_matrix(&self) -> &StitchMatrix {
        &self.a
    }

    /// `(I + C)⁻¹Z`.
    pub fn relaxed(&self, z: MatRef<'_, f64>) -> Mat<f64> {
        self.capacitance.solve(z)
    }

    /// `X ← K_σ⁻¹A Z` (Z is 3s×k, X n×k).
    pub fn flexed_into(&self, x: MatMut<'_, f64>, z: MatRef<'_, f64>) {
        let half = linalg::tall_product(self.half.values(), z);
        self.factor.spread(x, self.half.rows(), half.as_ref());
    }

    /// `K̂X`.
    pub fn multiply(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        let mut y = Mat::zeros(x.nrows(), x.ncols());
        self.multiply_into(y.as_mut(), x);
        y
    }

    /// `Y ← K̂X`.
    pub fn multiply_into(&self, mut y: MatMut<'_, f64>, x: MatRef<'_, f64>) {
        self.stiffness.multiply_into(y.as_mut(), x);
        self.a.add_times(y, self.a.transpose_times(x).as_ref());
    }

    /// `XᵀK̂X`.
    pub fn gram(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        let stretch = self.a.transpose_times(x);
        self.stiffness.gram(x) + linalg::small_product(stretch.transpose(), stretch.as_ref())
    }

    /// Overwrites B by `K̂_σ⁻¹B`: the stitches take their part between the two halves of the solve.
    pub fn solve_in_place(&self, b: MatMut<'_, f64>) {
        let correction = |x: MatRef<'_, f64>| {
            let z = self.capacitance.solve(linalg::gram(self.half.values(), x).as_ref());
            linalg::tall_product(self.half.values(), (-z).as_ref())
        };
        self.factor.solve_corrected(b, self.half.rows(), &correction);
    }

    /// The first half of a solve for B (n×k), which tells the energies BᵀK̂_σ⁻¹B.
    pub fn forward(&self, b: MatRef<'_, f64>) -> HalfSolution {
        let mut x = b.to_owned();
        let z = self.forward_in_place(x.as_mut());
        HalfSolution { x, z }
    }

    /// Overwrites B by the x of a [`HalfSolution`]; returns its z.
    fn forward_in_place(&self, mut b: MatMut<'_, f64>) -> Mat<f64> {
        self.factor.forward_in_place(b.as_mut());
        if self.a.n_columns() == 0 {
            return Mat::zeros(0, b.ncols());
        }
        let z = self.capacitance.solve(self.half.transpose_times(b.as_ref()).as_ref());
        self.half.add_times(b, -1.0, z.as_ref());
        z
    }

    /// The second half.
    pub fn backward(&self, half: HalfSolution) -> Mat<f64> {
        let mut x = half.x;
        self.factor.backward_in_place(x.as_mut());
        x
    }
}

/// A solve half way: x = (1 − P) L⁻¹B and z = (I + C)⁻¹Yᵀ L⁻¹B with P = Y (I + C)⁻¹ Yᵀ.
pub struct HalfSolution {
    x: Mat<f64>,
    z: Mat<f64>,
}

impl HalfSolution {
    /// bᵀK̂_σ⁻¹b of every column: ‖x‖² + ‖z‖², for 1 − P = (1 − P)² + Y (I + C)⁻² Yᵀ. A sum of squares
    /// loses no digits, however stiff the stitches are.
    pub fn energies(&self) -> Vec<f64> {
        let squared = |of: &Mat<f64>, j: usize| -> f64 { of.col(j).transpose() * of.col(j) };
        let columns = (0..self.x.ncols()).into_par_iter();
        columns.map(|j| squared(&self.x, j) + squared(&self.z, j)).collect()
    }

    /// Those of some columns.
    pub fn columns(&self, columns: &[usize]) -> HalfSolution {
        let [x, z] = [&self.x, &self.z].map(|of| linalg::columns(of.as_ref(), columns));
        HalfSolution { x, z }
    }
}
