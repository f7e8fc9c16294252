//! Updates by known Gram matrices and bounds, against modes of the stitched body itself.

use crate::bodies::{bar, soft};
use faer::{Mat, MatRef};
use std::sync::Arc;
use sutura_core::assembly::FullModel;
use sutura_core::assembly::mass::{Mass, MassKind};
use sutura_core::assembly::sparse::BlockMatrix;
use sutura_core::control::Uncontrolled;
use sutura_core::edit::Stitch;
use sutura_core::factorization::{SparseCholesky, shifted};
use sutura_core::modes::flexibility::{Update, Updated};
use sutura_core::modes::lanczos::{AuditedModes, ShiftInvert, lowest_modes};
use sutura_core::modes::rigid::rigid_modes;
use sutura_core::modes::stitched::StitchedStiffness;
use sutura_core::modes::{
    LinearModes, orthonormality_error, relative_residuals, residual_vectors, series,
};
use sutura_core::testing::{BarMesh, Cut};

const N_MODES: usize = 12;
const N_GUARDS: usize = 8;

/// What solves of these bodies leave in double precision.
const ROUNDING: f64 = 1e-8;

/// Arguments of [`series::rounding`] behind the factor.
type Probed<'a> = ((&'a BlockMatrix, &'a Mass, f64), [MatRef<'a, f64>; 2], &'a [f64]);

/// A cut bar and its modes as it is.
struct Body {
    bar: BarMesh,
    model: FullModel,
    mass: Mass,
    stiffness: BlockMatrix,
    sigma: f64,
    rigid: Mat<f64>,
    factor: SparseCholesky,
    modes: LinearModes,
    residuals: Vec<f64>,
}

impl Body {
    fn new(cut: Cut, kind: MassKind) -> Body {
        let bar = bar(cut);
        let model = FullModel::new(bar.mesh.clone(), &[soft()], &bar.root);
        let pattern = Arc::new(model.pattern(&[]));
        let stiffness = model.rest_stiffness(&pattern);
        let mass = model.mass(kind, &pattern);
        let rigid = rigid_modes(&model, &mass).unwrap();
        let sigma = if rigid.ncols() > 0 { 1e3 } else { 0.0 };
        let factor = SparseCholesky::of_blocks(&shifted(&stiffness, sigma, &mass)).unwrap();
        let problem = ShiftInvert { factor: &factor, sigma, mass: &mass, rigid: rigid.as_ref() };
        let AuditedModes { modes, residuals } =
            lowest_modes(&problem, N_MODES, N_GUARDS, &Uncontrolled).unwrap();
        Body { bar, model, mass, stiffness, sigma, rigid, factor, modes, residuals }
    }

    fn stitches(&self, stiffness_n_m: f64) -> Vec<Stitch> {
        let stitch = |(i, &pair): (usize, &[u32; 2])| Stitch { id: i as u64, pair, stiffness_n_m };
        self.bar.pairs.iter().enumerate().map(stitch).collect()
    }

    /// Those eigenvalues of the stitched body that no rigid motion is left to.
    fn exact(&self, stitched: &StitchedStiffness<'_>, stitches: &[Stitch]) -> Vec<f64> {
        let pairs: Vec<[u32; 2]> = stitches.iter().map(|s| s.pair).collect();
        let mut stiffness = self.model.rest_stiffness(&Arc::new(self.model.pattern(&pairs)));
        stitched.stitch_matrix().add_to(&mut stiffness);
        let factor = SparseCholesky::of_blocks(&stiffness).unwrap();
        let none = Mat::zeros(self.model.n(), 0);
        let problem =
            ShiftInvert { factor: &factor, sigma: 0.0, mass: &self.mass, rigid: none.as_ref() };
        lowest_modes(&problem, N_MODES, 0, &Uncontrolled).unwrap().modes.eigenvalues
    }

    /// What the rounding of a factor is told by.
    fn probed(&self) -> Probed<'_> {
        let modes = [self.rigid.as_ref(), self.modes.shapes.as_ref()];
        ((&self.stiffness, &self.mass, self.sigma), modes, &self.modes.eigenvalues)
    }

    fn update<'a, T>(
        &'a self,
        stitched: &'a StitchedStiffness<'a, T>,
        tolerance: f64,
    ) -> Update<'a, T> {
        Update {
            stitched,
            mass: &self.mass,
            sigma: self.sigma,
            rigid: self.rigid.as_ref(),
            n_rigid_left: 0,
            base: self.modes.shapes.as_ref(),
            eigenvalues: &self.modes.eigenvalues,
            residuals: &self.residuals,
            n_modes: N_MODES,
            tolerance,
        }
    }

    /// What is claimed of the update holds.
    fn check(
        &self,
        stitched: &StitchedStiffness<'_>,
        exact: &[f64],
        updated: &Updated,
        what: &str,
    ) {
        let Updated { shapes, spectrum, .. } = updated;
        assert_eq!(shapes.ncols(), N_MODES, "{what}");
        assert!(orthonormality_error(&self.mass, shapes.as_ref()) < 1e-12, "{what}");
        let product = stitched.multiply(shapes.as_ref());
        let residual =
            residual_vectors(product, &self.mass, shapes.as_ref(), &spectrum.eigenvalues);
        let energies = stitched.forward(residual.as_ref()).energies();
        let residuals = relative_residuals(&energies, &spectrum.eigenvalues, self.sigma);
        for i in 0..N_MODES {
            let claimed = [spectrum.residuals[i], spectrum.error_estimates[i]];
            let error = spectrum.eigenvalues[i] / exact[i] - 1.0;
            assert!(residuals[i] <= claimed[0], "{what} {i}: {:e} {claimed:?}", residuals[i]);
            assert!(
                error <= claimed[1] + 1e-12 && error > -1e-9,
                "{what} {i}: {error:e} {claimed:?}"
            );
        }
    }
}

/// The update by a factor in double precision, and in single.
fn both(body: &Body, stitches: &[Stitch], tolerance: f64) -> [Option<Updated>; 2] {
    let Body { model, stiffness, factor, .. } = body;
    let rounded = factor.rounded();
    let double = StitchedStiffness::new(model, stiffness, factor, stitches).unwrap();
    let single = StitchedStiffness::new(model, stiffness, &rounded, stitches).unwrap();
    let update = body.update(&double, tolerance);
    let double = series::update(&update, ROUNDING, &mut |_| false, &Uncontrolled).unwrap();
    let update = body.update(&single, tolerance);
    let (of_body, modes, eigenvalues) = body.probed();
    let rounding = series::rounding(&rounded, of_body, modes, eigenvalues);
    let single = series::update(&update, rounding, &mut |_| false, &Uncontrolled).unwrap();
    [double, single]
}

#[test]
fn bounds_hold_in_either_precision() {
    for (cut, kind) in [
        (Cut::HalfDepth, MassKind::Lumped),
        (Cut::HalfDepth, MassKind::Consistent),
        (Cut::Through, MassKind::Lumped),
    ] {
        let body = Body::new(cut, kind);
        for stiffness_n_m in [1e-3, 1e3, 1e5] {
            let stitches = body.stitches(stiffness_n_m);
            // Soft ones leave the free half of the bar to itself: no rigid motion is left, but nearly.
            if cut == Cut::Through && stiffness_n_m < 1.0 {
                continue;
            }
            let Body { model, stiffness, factor, .. } = &body;
            let stitched = StitchedStiffness::new(model, stiffness, factor, &stitches).unwrap();
            let exact = body.exact(&stitched, &stitches);
            let mut n_rounds = 0;
            for tolerance in [1e-1, 1e-3, 1e-4, 1e-5, 1e-6] {
                let [double, single] = both(&body, &stitches, tolerance);
                let what = format!("{cut:?} {kind:?} {stiffness_n_m:e} {tolerance:e}");
                let double = double.expect(&what);
                body.check(&stitched, &exact, &double, &what);
                assert!(double.spectrum.beyond(tolerance).is_empty(), "{what}");
                n_rounds = n_rounds.max(double.n_rounds);
                // What single precision does not reach, it does not claim.
                if tolerance >= 1e-4 && cut == Cut::HalfDepth {
                    assert!(single.is_some(), "{what}");
                }
                if let Some(single) = single {
                    body.check(&stitched, &exact, &single, &format!("single, {what}"));
                    assert!(single.spectrum.beyond(tolerance).is_empty(), "{what}");
                }
            }
            assert!(n_rounds > 1 || stiffness_n_m < 1.0, "not a test: {cut:?} {stiffness_n_m:e}");
        }
    }
}

#[test]
fn an_answer_before_the_tolerance_is_met_has_bounds_that_hold() {
    let body = Body::new(Cut::HalfDepth, MassKind::Lumped);
    let stitches = body.stitches(1e5);
    let Body { model, stiffness, factor, .. } = &body;
    let stitched = StitchedStiffness::new(model, stiffness, factor, &stitches).unwrap();
    let exact = body.exact(&stitched, &stitches);
    let update = body.update(&stitched, 1e-5);
    let mut asked = Vec::new();
    let mut stops = |n_refined| {
        asked.push(n_refined);
        true
    };
    let updated = series::update(&update, ROUNDING, &mut stops, &Uncontrolled).unwrap().unwrap();
    body.check(&stitched, &exact, &updated, "first answer");
    assert_eq!(asked, [updated.spectrum.beyond(1e-5).len()]);
    assert!(asked[0] > 0);
}

#[test]
fn rounding_is_that_of_the_factor() {
    for cut in [Cut::HalfDepth, Cut::Through] {
        let body = Body::new(cut, MassKind::Lumped);
        let (of_body, modes, eigenvalues) = body.probed();
        let double = series::rounding(&body.factor, of_body, modes, eigenvalues);
        let single = series::rounding(&body.factor.rounded(), of_body, modes, eigenvalues);
        // Of double precision it is also what the modes are wrong by.
        assert!(double < ROUNDING, "{double:e}");
        assert!((1e-7..1e-4).contains(&single), "{single:e}");
    }
}

#[test]
fn what_rounding_spoils_is_left_to_others() {
    let body = Body::new(Cut::HalfDepth, MassKind::Lumped);
    let [double, single] = both(&body, &body.stitches(1e5), 1e-4);
    assert!(double.is_some() && single.is_some());
    // So stiff stitches feel the rounding of what they hold together.
    let [_, single] = both(&body, &body.stitches(1e13), 1e-4);
    assert!(single.is_none());
    let stitches = body.stitches(1e5);
    let Body { model, stiffness, factor, .. } = &body;
    let stitched = StitchedStiffness::new(model, stiffness, factor, &stitches).unwrap();
    for (tolerance, rounding) in [(1e-4, 1e-2), (1e-4, f64::NAN), (1e-7, ROUNDING)] {
        let update = body.update(&stitched, tolerance);
        let updated = series::update(&update, rounding, &mut |_| false, &Uncontrolled).unwrap();
        assert!(updated.is_none(), "{tolerance:e} {rounding:e}");
    }
}
