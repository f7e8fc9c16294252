//! The stitched stiffness K̂ = K + AAᵀ: its product, and its inverse by Woodbury's formula from the
//! factorization of the unstitched one.
//!
//! For a stitch (a, b, k), A has the three columns √k·(e_a − e_b) (\[M16\] eq. 5). With G = K_σ⁻¹A and
//! C = AᵀG,  K̂_σ⁻¹ = K_σ⁻¹ − G (I + C)⁻¹ Gᵀ.

use crate::assembly::FullModel;
use crate::assembly::sparse::BlockMatrix;
use crate::edit::{Stitch, sorted};
use crate::factorization::SparseCholesky;
use crate::linalg::{self, DenseError, SmallCholesky};
use faer::{Mat, MatRef};
use std::collections::BTreeMap;
use std::sync::Arc;

/// K_σ⁻¹(e_a − e_b) for pairs of vertices (named in ascending order): n × 3 each. They depend on
/// neither the stitches in force nor their stiffness, so every generation shares them.
pub type FlexibilityColumns = BTreeMap<[u32; 2], Arc<Mat<f64>>>;

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
    pub fn add_times(&self, y: &mut Mat<f64>, z: MatRef<'_, f64>) {
        for column in 0..z.ncols() {
            let y = y.col_as_slice_mut(column);
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
        self.add_times(&mut a, Mat::<f64>::identity(self.n_columns(), self.n_columns()).as_ref());
        a
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

/// Pairs whose columns are solved together: enough for the solver's best rate.
const PAIRS_AT_A_TIME: usize = 16;

/// Computes the flexibility columns of the pairs that `have` lacks, in blocked solves.
pub fn flexibility_columns(
    model: &FullModel,
    factor: &SparseCholesky,
    have: &FlexibilityColumns,
    pairs: impl Iterator<Item = [u32; 2]>,
) -> FlexibilityColumns {
    let mut all = have.clone();
    let missing: Vec<[u32; 2]> = pairs
        .map(sorted)
        .filter(|pair| !have.contains_key(pair))
        .collect::<std::collections::BTreeSet<_>>()
        .into_iter()
        .collect();
    for pairs in missing.chunks(PAIRS_AT_A_TIME) {
        let unit: Vec<Stitch> =
            pairs.iter().map(|&pair| Stitch { id: 0, pair, stiffness_n_m: 1.0 }).collect();
        let mut columns = StitchMatrix::new(model, &unit).dense(model.n());
        factor.solve_in_place(columns.as_mut());
        for (i, &pair) in pairs.iter().enumerate() {
            all.insert(pair, Arc::new(columns.subcols(3 * i, 3).to_owned()));
        }
    }
    all
}

/// K̂ and K̂_σ⁻¹ of a stitched body.
pub struct StitchedStiffness<'a> {
    stiffness: &'a BlockMatrix,
    factor: &'a SparseCholesky,
    a: StitchMatrix,
    /// G = K_σ⁻¹A.
    g: Mat<f64>,
    /// I + C, factorized.
    capacitance: SmallCholesky,
}

impl<'a> StitchedStiffness<'a> {
    /// `columns` holds the flexibility columns of every stitch.
    pub fn new(
        model: &FullModel,
        stiffness: &'a BlockMatrix,
        factor: &'a SparseCholesky,
        stitches: &[Stitch],
        columns: &FlexibilityColumns,
    ) -> Result<StitchedStiffness<'a>, DenseError> {
        let a = StitchMatrix::new(model, stitches);
        let of_stitch: Vec<&Arc<Mat<f64>>> = stitches
            .iter()
            .map(|stitch| columns.get(&sorted(stitch.pair)))
            .collect::<Option<_>>()
            .ok_or(DenseError("look-up of a flexibility column"))?;
        let mut g = Mat::zeros(model.n(), a.n_columns());
        linalg::for_each_column(&mut g, |j, g| {
            let column = of_stitch[j / 3].col_as_slice(j % 3);
            for (to, from) in g.iter_mut().zip(column) {
                *to = a.root_stiffness[j / 3] * from;
            }
        });
        let c = a.transpose_times(g.as_ref());
        let k = c.nrows();
        let sum = Mat::from_fn(k, k, |i, j| 0.5 * (c[(i, j)] + c[(j, i)]) + f64::from(i == j));
        let capacitance = SmallCholesky::new(sum.as_ref())?;
        Ok(StitchedStiffness { stiffness, factor, a, g, capacitance })
    }

    /// A.
    pub fn stitch_matrix(&self) -> &StitchMatrix {
        &self.a
    }

    /// G = K_σ⁻¹A (n×3s).
    pub fn g(&self) -> MatRef<'_, f64> {
        self.g.as_ref()
    }

    /// `(I + C)⁻¹Z`.
    pub fn capacitance_solve(&self, z: MatRef<'_, f64>) -> Mat<f64> {
        self.capacitance.solve(z)
    }

    /// `K̂X`.
    pub fn multiply(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        let mut y = self.stiffness.multiply(x);
        self.a.add_times(&mut y, self.a.transpose_times(x).as_ref());
        y
    }

    /// `K̂_σ⁻¹B`.
    pub fn solve(&self, b: MatRef<'_, f64>) -> Mat<f64> {
        let mut x = b.to_owned();
        self.factor.solve_in_place(x.as_mut());
        self.correct(x)
    }

    /// K̂_σ⁻¹B from `x` = K_σ⁻¹B, which costs no sparse solve: GᵀB = AᵀK_σ⁻¹B = Aᵀx.
    pub fn correct(&self, mut x: Mat<f64>) -> Mat<f64> {
        let z = self.capacitance.solve(self.a.transpose_times(x.as_ref()).as_ref());
        linalg::add_product(x.as_mut(), -1.0, self.g.as_ref(), z.as_ref());
        x
    }
}
