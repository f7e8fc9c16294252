//! From the basis of one generation to that of another.
//!
//! Both are taken over all vertices, a fixed vertex's rows being zero, so it does not matter whether
//! the two generations hold the same ones.

use super::artifacts::{Artifacts, rows};
use crate::assembly::mass::Mass;
use crate::linalg::{self, DenseError};
use faer::{Mat, MatRef};

/// Difference between two bases of one body: `new = [old | columns] · w`.
#[derive(Clone, Debug, PartialEq)]
pub struct BasisDelta {
    /// Columns that the old basis lacks, each over all vertices, vertex-major (3·n_vertices).
    pub columns: Vec<Vec<f64>>,
    /// (r_old + columns.len()) × r_new, row-major.
    pub w: Vec<f64>,
}

/// Two bases over all vertices, with the mass matrix there.
struct Everywhere {
    new: Mat<f64>,
    old: Mat<f64>,
    mass: Mass,
}

impl Everywhere {
    /// `None` where both have the same free degrees of freedom: then those are enough.
    fn of(new: &Artifacts, old: &Artifacts) -> Option<Everywhere> {
        let [model, before] = [new, old].map(Artifacts::full_model);
        if model.free_vertices() == before.free_vertices() {
            return None;
        }
        let basis = |artifacts: &Artifacts| {
            let mut all = Mat::zeros(3 * model.mesh().vertices().len(), artifacts.basis_size());
            linalg::for_each_column(all.as_mut(), |j, column| {
                column.copy_from_slice(&artifacts.basis_column(j));
            });
            all
        };
        let mass = model.mass_everywhere(new.params().mass);
        Some(Everywhere { new: basis(new), old: basis(old), mass })
    }
}

impl Artifacts {
    /// `transfer` with q_new = transfer · q_old: ŪᵀMU_old, r_new × r_old, row-major. Both must be
    /// generations of one build.
    pub fn transfer_from(&self, old: &Artifacts) -> Vec<f64> {
        rows(&match Everywhere::of(self, old) {
            None => self.prepared.mass.inner(self.basis(), old.basis()),
            Some(all) => all.mass.inner(all.new.as_ref(), all.old.as_ref()),
        })
    }

    /// What a client that holds the basis of `old` needs to make this one. Both must be generations of
    /// one build.
    ///
    /// The columns are an M-orthonormal basis of what the old span lacks; directions of which less
    /// than 1e-7 lies outside are within single precision and left out.
    pub fn delta_from(&self, old: &Artifacts) -> Result<BasisDelta, DenseError> {
        match Everywhere::of(self, old) {
            None => {
                let (columns, w) = difference(self.basis(), old.basis(), &self.prepared.mass)?;
                let model = self.full_model();
                let columns = (0..columns.ncols()).map(|j| model.expand(columns.col_as_slice(j)));
                Ok(BasisDelta { columns: columns.collect(), w })
            }
            Some(all) => {
                let (columns, w) = difference(all.new.as_ref(), all.old.as_ref(), &all.mass)?;
                let columns = (0..columns.ncols()).map(|j| columns.col_as_slice(j).to_vec());
                Ok(BasisDelta { columns: columns.collect(), w })
            }
        }
    }
}

/// M-orthonormal columns (n×c) of what `new` has beyond the span of `old`, and w by rows.
fn difference(
    new: MatRef<'_, f64>,
    old: MatRef<'_, f64>,
    mass: &Mass,
) -> Result<(Mat<f64>, Vec<f64>), DenseError> {
    let inside = mass.inner(old, new);
    let mut outside = new.to_owned();
    linalg::add_product(outside.as_mut(), -1.0, old, inside.as_ref());
    let gram = mass.gram(outside.as_ref());
    let (values, vectors) = linalg::symmetric_eigen(gram.as_ref())?;
    let first = values.partition_point(|&v| v <= 1e-14);
    let directions = vectors.subcols(first, values.len() - first);
    let mut columns = linalg::product(outside.as_ref(), directions);
    for (j, value) in values[first..].iter().enumerate() {
        columns.col_as_slice_mut(j).iter_mut().for_each(|x| *x /= value.sqrt());
    }
    let rest = mass.inner(columns.as_ref(), outside.as_ref());
    let mut w = rows(&inside);
    w.extend(rows(&rest));
    Ok((columns, w))
}
