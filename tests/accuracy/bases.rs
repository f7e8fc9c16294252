//! Bases put together by hand from a body's modes, to tell which ingredient of a rebuild does what.

use faer::Mat;
use sutura_core::assembly::FullModel;
use sutura_core::assembly::mass::Mass;
use sutura_core::basis::{PcaMethod, WeightedDerivatives, mass_pca};
use sutura_core::build::Artifacts;
use sutura_core::control::Uncontrolled;
use sutura_core::derivatives;
use sutura_core::factorization::SparseCholesky;
use sutura_core::modes::LinearModes;
use sutura_core::modes::stitched::StitchMatrix;
use sutura_core::pool::Tall;

/// A body's elastic modes over the free degrees of freedom.
pub(crate) fn modes(body: &Artifacts) -> LinearModes {
    let model = body.full_model();
    let all: Vec<Vec<f64>> = (0..body.n_modes()).map(|j| body.mode(j)).collect();
    let shapes = Mat::from_fn(model.n(), all.len(), |i, j| {
        all[j][3 * model.free_vertices()[i / 3] as usize + i % 3]
    });
    LinearModes { shapes: shapes.into(), eigenvalues: body.eigenvalues_per_s2().to_vec() }
}

/// Modal derivatives of every pair of the lowest `count` of `modes`, or of the first `share` of
/// those pairs, solved with the stitched stiffness of `body`.
pub(crate) struct Derivatives {
    shapes: Mat<f64>,
    eigenvalues: Vec<[f64; 2]>,
}

impl Derivatives {
    pub(crate) fn new(
        body: &Artifacts,
        modes: &LinearModes,
        count: usize,
        share: f64,
    ) -> Derivatives {
        let model = body.full_model();
        let lowest = modes.lowest(count);
        let loads =
            derivatives::right_hand_sides(model, lowest.shapes.as_ref(), &Uncontrolled).unwrap();
        let pairs = derivatives::pairs(count);
        let taken = (share * pairs.len() as f64).ceil() as usize;
        let mut shapes = loads.subcols(0, taken).to_owned();
        stitched_factor(model, body).solve_in_place(shapes.as_mut());
        let eigenvalues = pairs[..taken].iter().map(|p| p.map(|i| lowest.eigenvalues[i])).collect();
        Derivatives { shapes, eigenvalues }
    }
}

/// The mass-PCA basis of `modes` and `derivatives`.
pub(crate) fn basis(
    mass: &Mass,
    modes: &LinearModes,
    derivatives: &[&Derivatives],
    size: usize,
) -> Tall {
    let groups: Vec<WeightedDerivatives<'_>> = derivatives
        .iter()
        .map(|d| WeightedDerivatives {
            shapes: d.shapes.as_ref(),
            eigenvalues: d.eigenvalues.clone(),
        })
        .collect();
    mass_pca(mass, modes, &groups, size, PcaMethod::default()).unwrap().basis
}

fn stitched_factor(model: &FullModel, body: &Artifacts) -> SparseCholesky {
    let pairs: Vec<[u32; 2]> = body.stitches().iter().map(|s| s.pair).collect();
    let mut stiffness = model.rest_stiffness(&std::sync::Arc::new(model.pattern(&pairs)));
    StitchMatrix::new(model, body.stitches()).add_to(&mut stiffness);
    SparseCholesky::of_blocks(&stiffness).unwrap()
}
