//! Stresses of eight poses at a time: the poses of a body share its tets, so eight of them are stored
//! side by side, one lane a pose.

use crate::assembly::stresses;
use crate::assembly::{FullModel, NOT_FREE};
use crate::linalg;
use crate::material::{Elasticity, Law};
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};

/// Poses in a block.
pub(super) const LANES: usize = 8;

/// One number for each pose of a block.
pub(super) type Lanes = [f64; LANES];

/// A 3×3 matrix for each pose of a block, by rows.
pub(super) type LaneMatrix = [Lanes; 9];

/// Displacements of up to eight poses: one entry for each degree of freedom.
pub(super) struct PoseBlock(Vec<Lanes>);

impl PoseBlock {
    /// U·q for at most [`LANES`] columns q (r×t).
    pub(super) fn new(basis: MatRef<'_, f64>, q: MatRef<'_, f64>) -> PoseBlock {
        let mut u = vec![[0.0; LANES]; basis.nrows()];
        let to = MatMut::from_row_major_slice_mut(u.as_flattened_mut(), basis.nrows(), LANES);
        let to = to.subcols_mut(0, q.ncols());
        matmul(to, Accum::Replace, basis, q, 1.0, Par::Seq);
        PoseBlock(u)
    }

    /// The work of every tet's stress on the displacements `other`, Σ_poses V P:∇v, is added to
    /// `work` (one entry a tet).
    pub(super) fn add_stress_work(&self, model: &FullModel, other: &PoseBlock, work: &mut [f64]) {
        linalg::vectorized(
            #[inline(always)]
            || {
                for (tet, corners) in model.corners().iter().enumerate() {
                    let gradients = &model.gradients()[tet];
                    let d = self.displacement_gradient(corners, gradients);
                    let p = stress(&d, &model.elasticities()[tet], model.volumes_m3()[tet]);
                    let v = other.displacement_gradient(corners, gradients);
                    let mut sum: Lanes = [0.0; LANES];
                    for (p, v) in p.iter().zip(&v) {
                        for lane in 0..LANES {
                            sum[lane] += p[lane] * v[lane];
                        }
                    }
                    work[tet] += sum.iter().sum::<f64>();
                }
            },
        );
    }

    /// Σ_a u_a ⊗ ∇N_a.
    #[inline(always)]
    fn displacement_gradient(&self, corners: &[u32; 4], gradients: &[[f64; 3]; 4]) -> LaneMatrix {
        let mut d = [[0.0; LANES]; 9];
        for (&vertex, g) in corners.iter().zip(gradients) {
            if vertex == NOT_FREE {
                continue;
            }
            for axis in 0..3 {
                let u = &self.0[3 * vertex as usize + axis];
                for k in 0..3 {
                    for lane in 0..LANES {
                        d[3 * axis + k][lane] += u[lane] * g[k];
                    }
                }
            }
        }
        d
    }
}

/// Volume times the first Piola–Kirchhoff stress: [`crate::material::stvk`] by lanes, other laws one lane
/// after the other.
#[inline(always)]
pub(super) fn stress(d: &LaneMatrix, elasticity: &Elasticity, volume_m3: f64) -> LaneMatrix {
    if elasticity.law != Law::StVenantKirchhoff {
        let mut p = *d;
        stresses(elasticity, volume_m3, &mut p);
        return p;
    }
    let [lambda, mu] = elasticity.lame;
    const UPPER: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]];
    let mut s = [[0.0; LANES]; 9];
    let mut trace: Lanes = [0.0; LANES];
    for [i, j] in UPPER {
        let mut strain: Lanes = [0.0; LANES];
        for lane in 0..LANES {
            let quadratic = d[i][lane] * d[j][lane]
                + d[3 + i][lane] * d[3 + j][lane]
                + d[6 + i][lane] * d[6 + j][lane];
            strain[lane] = 0.5 * (d[3 * i + j][lane] + d[3 * j + i][lane] + quadratic);
            if i == j {
                trace[lane] += strain[lane];
            }
        }
        for lane in 0..LANES {
            let value = 2.0 * mu * volume_m3 * strain[lane];
            s[3 * i + j][lane] = value;
            s[3 * j + i][lane] = value;
        }
    }
    for diagonal in [0, 4, 8] {
        for lane in 0..LANES {
            s[diagonal][lane] += lambda * volume_m3 * trace[lane];
        }
    }
    let mut p = s;
    for i in 0..3 {
        for j in 0..3 {
            for k in 0..3 {
                for lane in 0..LANES {
                    p[3 * i + j][lane] += d[3 * i + k][lane] * s[3 * k + j][lane];
                }
            }
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::{Hyperelastic, Law, Material};
    use crate::testing::{Bar, Cell, Cut};
    use faer::Mat;
    use nalgebra::Matrix3;

    #[test]
    fn stress_is_that_of_the_material() {
        for law in Law::ALL {
            let elasticity = Material::new(law, 5e5, 0.3, 1.0).unwrap().elasticity(1.5);
            let d: LaneMatrix =
                std::array::from_fn(|k| std::array::from_fn(|l| 0.3 * ((7 * k + l) as f64).sin()));
            let p = stress(&d, &elasticity, 0.2);
            for lane in 0..LANES {
                let gradient = Matrix3::from_fn(|i, j| d[3 * i + j][lane]);
                let exact = elasticity.stress(&gradient) * 0.2;
                let found = Matrix3::from_fn(|i, j| p[3 * i + j][lane]);
                assert!((found - exact).norm() < 1e-13 * exact.norm());
            }
        }
    }

    #[test]
    fn stress_work_is_that_of_the_internal_forces() {
        let bar =
            Bar { size_m: [0.2, 0.05, 0.05], n_cells: [4, 2, 2], cell: Cell::Six, cut: Cut::Whole }
                .mesh();
        let material = Material::stvk(5e5, 0.4, 1000.0).unwrap();
        let model = FullModel::new(bar.mesh, &[material], &bar.root);
        let basis = Mat::from_fn(model.n(), 5, |i, j| ((3 * i + 7 * j * i) as f64).sin());
        let q = Mat::from_fn(5, 6, |i, j| 2e-3 * ((i + 5 * j) as f64).cos());
        let block = PoseBlock::new(basis.as_ref(), q.as_ref());
        let full = model.internal_forces((&basis * &q).as_ref());
        let exact = basis.transpose() * &full;
        let other = Mat::from_fn(5, 6, |i, j| ((2 * i + 3 * j) as f64).sin());
        let other_block = PoseBlock::new(basis.as_ref(), other.as_ref());
        let mut work = vec![0.0; model.corners().len()];
        block.add_stress_work(&model, &other_block, &mut work);
        let total: f64 = (0..6).map(|t| other.col(t).transpose() * exact.col(t)).sum();
        assert!((work.iter().sum::<f64>() - total).abs() < 1e-11 * exact.norm_l2());
    }
}
