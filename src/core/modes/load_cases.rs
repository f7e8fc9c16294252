//! Load cases: solutions of the base body that every stitched body reuses by linearity.

use crate::dictionary::Block;
use crate::linalg;
use crate::modes::LinearModes;
use crate::modes::seams::BaseModes;
use crate::pool::Tall;
use faer::{Mat, MatRef};
use std::sync::Arc;

/// Loads L (n×q) and F = K⁻¹L on the complement of the base body's modes X: KF = L − MXXᵀL and
/// XᵀMF = 0. There K has no rigid motion, so F needs no shift.
///
/// The loads are those of modal derivatives: −(H:ψ_i)ψ_j for every pair of some modes Ψ, the sources.
#[derive(Clone, Debug)]
pub struct LoadCases {
    /// F, in blocks.
    pub blocks: Vec<Arc<Block>>,
    /// The modes that loads are made of, set after set; load after load they appear as pairs of them.
    pub sources: Vec<Source>,
    /// XᵀL (k×q).
    pub on_modes: Mat<f64>,
    /// FᵀMF (q×q).
    pub mass: Mat<f64>,
    /// FᵀKF = FᵀL (q×q).
    pub energy: Mat<f64>,
}

/// Modes Ψ whose pairs i ≤ j, in the order j, i, make loads.
#[derive(Clone, Debug)]
pub struct Source {
    /// Ψ (n×m).
    pub modes: Arc<Block>,
    /// XᵀMΨ (k×m).
    pub on_modes: Mat<f64>,
    /// ψᵀKψ of each, K being the stiffness of the base body.
    pub energies: Vec<f64>,
}

impl LoadCases {
    /// No loads, for `k` modes.
    pub fn none(k: usize) -> LoadCases {
        LoadCases {
            blocks: Vec::new(),
            sources: Vec::new(),
            on_modes: Mat::zeros(k, 0),
            mass: Mat::zeros(0, 0),
            energy: Mat::zeros(0, 0),
        }
    }

    /// q.
    pub fn len(&self) -> usize {
        self.mass.ncols()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// These and the `loads` of every pair of `modes` (with ψᵀKψ for eigenvalues), with `solutions` K⁻¹L, whose share in X does not
    /// matter.
    pub fn with(
        &self,
        base: &BaseModes<'_>,
        modes: LinearModes,
        loads: MatRef<'_, f64>,
        mut solutions: Tall,
    ) -> LoadCases {
        base.remove(solutions.as_mut());
        let weighted = base.mass.multiply(solutions.as_ref());
        let mut blocks = self.blocks.clone();
        blocks.push(Block::dependent(solutions, &self.blocks));
        let against = |y: MatRef<'_, f64>| {
            let parts: Vec<Mat<f64>> =
                blocks.iter().map(|block| linalg::gram(block.columns.as_ref(), y)).collect();
            linalg::stacked(&parts.iter().map(Mat::as_ref).collect::<Vec<_>>())
        };
        let on_modes = base.x.map(|x| linalg::gram(x, loads));
        let on_modes = linalg::stacked(&on_modes.each_ref().map(Mat::as_ref));
        let inner = base.x.map(|x| base.mass.inner(x, modes.shapes.as_ref()));
        let source = Source {
            on_modes: linalg::stacked(&inner.each_ref().map(Mat::as_ref)),
            modes: Block::new(modes.shapes),
            energies: modes.eigenvalues,
        };
        LoadCases {
            sources: self.sources.iter().cloned().chain([source]).collect(),
            on_modes: linalg::concatenate(&[self.on_modes.as_ref(), on_modes.as_ref()]),
            mass: linalg::bordered_symmetric(
                self.mass.as_ref(),
                against(weighted.as_ref()).as_ref(),
            ),
            energy: linalg::bordered_symmetric(self.energy.as_ref(), against(loads).as_ref()),
            blocks,
        }
    }

    /// The loads of the first source alone.
    pub fn first_set(&self) -> LoadCases {
        let q = self.blocks.first().map_or(0, |block| block.columns.ncols());
        LoadCases {
            blocks: self.blocks.iter().take(1).cloned().collect(),
            sources: self.sources.iter().take(1).cloned().collect(),
            on_modes: self.on_modes.subcols(0, q).to_owned(),
            mass: self.mass.submatrix(0, 0, q, q).to_owned(),
            energy: self.energy.submatrix(0, 0, q, q).to_owned(),
        }
    }

    /// Bytes held, shared blocks included.
    pub fn bytes(&self) -> usize {
        let sources = self.sources.iter().map(|source| &source.modes);
        self.blocks.iter().chain(sources).map(|block| block.columns.bytes()).sum()
    }
}
