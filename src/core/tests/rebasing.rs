//! Base bodies that hold stitches: the same bodies as those to which updates add the stitches.

use crate::bodies::{STITCH_N_M, bar, by, params, spectrum_error, stitch};
use sutura_core::build::{self, Artifacts, CubatureParams, Method, Verdict};
use sutura_core::control::Uncontrolled;
use sutura_core::edit::Edit;
use sutura_core::testing::Cut;

fn next(previous: &Artifacts, edits: &[Edit], method: Method) -> Artifacts {
    build::rebuild(previous, edits, &by(method), &Uncontrolled).unwrap().0
}

fn rebased(body: &Artifacts) -> Artifacts {
    let base = build::prepare_base(body, &Uncontrolled).unwrap();
    build::rebase(body, &base, &Uncontrolled).unwrap().unwrap()
}

fn assert_spectra_agree(found: &Artifacts, exact: &Artifacts, allowed: f64) {
    assert_eq!(found.n_rigid_modes(), exact.n_rigid_modes());
    let (found, exact) = (found.eigenvalues_per_s2(), exact.eigenvalues_per_s2());
    assert_eq!(found.len(), exact.len());
    let error = spectrum_error(found, exact);
    assert!(error < allowed, "{error:e}");
}

/// Energies, forces and stiffnesses of two models that may differ in their bases: by their spectra.
fn assert_models_agree(found: &Artifacts, exact: &Artifacts) {
    for body in [found, exact] {
        let q: Vec<f64> = (0..body.basis_size()).map(|i| 1e-3 * (i as f64).sin()).collect();
        let [reduced, whole] = [body.model().evaluate(&q), body.evaluate_exact(&q)];
        let scale = whole.force.iter().map(|f| f.abs()).fold(0.0, f64::max);
        for (a, b) in reduced.force.iter().zip(&whole.force) {
            assert!((a - b).abs() < 1e-9 * scale, "{a:e} {b:e}");
        }
    }
    let energy = |body: &Artifacts| {
        let mut q = vec![0.0; body.basis_size()];
        q[0] = 1e-6;
        body.model().evaluate(&q).energy_j
    };
    let (a, b) = (energy(found), energy(exact));
    assert!((a - b).abs() < 1e-3 * b, "{a:e} {b:e}");
}

#[test]
fn a_base_body_that_holds_the_stitches_is_the_stitched_body() {
    // One bar is held at an end; of the other, cut through, one half is free until it is stitched.
    for cut in [Cut::HalfDepth, Cut::Through] {
        let bar = bar(cut);
        let params = params(&bar, 12);
        assert!(params.cubature.is_none());
        let open = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
        let (some, rest) = bar.pairs.split_at(bar.pairs.len() / 2);
        let first = next(&open, &stitch(some, STITCH_N_M), Method::Flexibility);
        assert_eq!(first.n_open_stitches(), some.len());

        let base = rebased(&first);
        assert_eq!((base.n_open_stitches(), base.stitches().len()), (0, some.len()));
        assert_eq!(base.certificate().verdict, Verdict::Rebuilt);
        let exact = next(&open, &stitch(some, STITCH_N_M), Method::FromScratch);
        assert_spectra_agree(&base, &exact, 1e-8);
        assert_models_agree(&base, &exact);

        // Edits add to it, in a seam and outside.
        let all = next(&open, &stitch(&bar.pairs, STITCH_N_M), Method::FromScratch);
        let outside = next(&base, &stitch(rest, STITCH_N_M), Method::Flexibility);
        assert_eq!(outside.n_open_stitches(), rest.len());
        assert_spectra_agree(&outside, &all, 1e-2);
        build::prepare_seams(&base, &bar.pairs, &Uncontrolled).unwrap();
        assert!(base.unprepared(bar.pairs.iter().copied()).is_empty());
        let inside = next(&base, &stitch(rest, STITCH_N_M), Method::Flexibility);
        assert_spectra_agree(&inside, &all, 1e-2);
        assert_models_agree(&inside, &all);
        let scratch = next(&base, &stitch(rest, STITCH_N_M), Method::FromScratch);
        assert_spectra_agree(&scratch, &all, 1e-8);
        assert_models_agree(&scratch, &all);

        // A stitch with another stiffness, or taken out, goes back to the body without any.
        let ids: Vec<u64> = base.stitches().iter().map(|s| s.id).collect();
        let softer = Edit::SetStiffness { stitch_ids: ids[..1].to_vec(), stiffness_n_m: 1e3 };
        let softer = next(&base, &[softer], Method::Flexibility);
        assert_eq!(softer.n_open_stitches(), some.len());
        let without = next(&base, &[Edit::Unstitch { stitch_ids: ids }], Method::Flexibility);
        assert_spectra_agree(&without, &open, 1e-10);
        // The name of a stitch is not what counts.
        let again = [
            Edit::Unstitch { stitch_ids: vec![base.stitches()[0].id] },
            Edit::Stitch { pairs: vec![base.stitches()[0].pair], stiffness_n_m: STITCH_N_M },
        ];
        assert_eq!(next(&base, &again, Method::Flexibility).n_open_stitches(), 0);
    }
}

#[test]
fn edits_go_on_while_a_base_body_is_prepared() {
    let bar = bar(Cut::HalfDepth);
    let open = build::build(bar.mesh.clone(), &params(&bar, 10), &Uncontrolled).unwrap();
    let (some, rest) = bar.pairs.split_at(6);
    let first = next(&open, &stitch(some, STITCH_N_M), Method::Flexibility);
    let base = build::prepare_base(&first, &Uncontrolled).unwrap();
    let rebased = |body: &Artifacts| build::rebase(body, &base, &Uncontrolled).unwrap();
    // What was added is added to it.
    let more = next(&first, &stitch(rest, STITCH_N_M), Method::Flexibility);
    let exact = next(&first, &stitch(rest, STITCH_N_M), Method::FromScratch);
    let followed = rebased(&more).unwrap();
    assert_eq!(followed.n_open_stitches(), rest.len());
    assert_spectra_agree(&followed, &exact, 1e-2);
    // It does not serve where a stitch of its own is gone, or the body itself is another.
    let without = next(&more, &[Edit::Unstitch { stitch_ids: vec![0] }], Method::Flexibility);
    assert!(rebased(&without).is_none());
    let scale = Edit::ScaleStiffness { domain: bar.mesh.domains()[0], factor: 2.0 };
    assert!(rebased(&next(&more, &[scale], Method::Flexibility)).is_none());
}

#[test]
fn a_base_body_that_holds_stitches_keeps_them_under_other_changes() {
    let bar = bar(Cut::HalfDepth);
    let cubature = CubatureParams {
        n_points: 40,
        n_training_poses: 20,
        tolerance: 0.05,
        seed: 1,
        selection: Default::default(),
        smoothing: true,
    };
    let params = build::BuildParams { cubature: Some(cubature), ..params(&bar, 10) };
    let open = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let first = next(&open, &stitch(&bar.pairs, STITCH_N_M), Method::Flexibility);
    let base = rebased(&first);
    assert!(base.cubature().unwrap().validation_error < 0.2);
    let scale = [Edit::ScaleStiffness { domain: bar.mesh.domains()[0], factor: 2.0 }];
    let scaled = next(&base, &scale, Method::Flexibility);
    assert_eq!(scaled.n_open_stitches(), 0);
    let exact = next(
        &next(&open, &scale, Method::Flexibility),
        &stitch(&bar.pairs, STITCH_N_M),
        Method::FromScratch,
    );
    assert_spectra_agree(&scaled, &exact, 1e-8);
}
