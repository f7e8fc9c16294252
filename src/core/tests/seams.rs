//! Edits inside seams: no solve, and the same body.

use crate::bodies::{STITCH_N_M, bar, by, params, spectrum_error, stitch};
use crate::recipes::trained_bar;
use faer::Mat;
use std::time::{Duration, Instant};
use sutura_core::build::{
    self, Artifacts, BuildParams, CubatureSource, Derivatives, Method, RebuildParams, Verdict,
};
use sutura_core::control::{Control, Stage, Uncontrolled};
use sutura_core::edit::Edit;
use sutura_core::linalg;
use sutura_core::testing::statics::StitchedBody;
use sutura_core::testing::{BarMesh, Cut};

/// A bar with its cut prepared.
fn prepared(bar: &BarMesh, params: &BuildParams) -> Artifacts {
    let body = build::build(bar.mesh.clone(), params, &Uncontrolled).unwrap();
    build::prepare_seams(&body, &bar.pairs, &Uncontrolled).unwrap();
    body
}

fn next(previous: &Artifacts, edits: &[Edit], method: Method) -> Artifacts {
    build::rebuild(previous, edits, &by(method), &Uncontrolled).unwrap().0
}

/// By flexibility, with what fits into no time at all: derivatives as the load cases know them.
fn at_once(previous: &Artifacts, edits: &[Edit]) -> Artifacts {
    let mut params = by(Method::Flexibility);
    params.deadline = Some(Duration::ZERO);
    build::rebuild(previous, edits, &params, &Uncontrolled).unwrap().0
}

/// Whether a generation is made of prepared columns alone: the only way is from a seam.
fn took_no_solve(body: &Artifacts) -> bool {
    let prepared = body.prepared_blocks();
    body.basis_combination().blocks.iter().all(|block| prepared.contains(block))
}

fn errors(found: &Artifacts, exact: &Artifacts) -> [f64; 2] {
    let (found, exact) = (found.eigenvalues_per_s2(), exact.eigenvalues_per_s2());
    assert_eq!(found.len(), exact.len());
    let half = found.len() / 2;
    [spectrum_error(&found[..half], &exact[..half]), spectrum_error(&found[half..], &exact[half..])]
}

#[test]
fn an_edit_inside_a_seam_agrees_with_from_scratch() {
    for cut in [Cut::HalfDepth, Cut::Through] {
        let bar = bar(cut);
        let open = prepared(&bar, &params(&bar, 20));
        // Springs from hardly there to rigid, all pairs and some.
        for (pairs, stiffness) in [
            (&bar.pairs[..], STITCH_N_M),
            (&bar.pairs[..], 1e2),
            (&bar.pairs[..], 1e10),
            (&bar.pairs[3..7], 1e5),
        ] {
            let edit = stitch(pairs, stiffness);
            let exact = next(&open, &edit, Method::FromScratch);
            let updated = at_once(&open, &edit);
            assert!(took_no_solve(&updated), "{cut:?} {stiffness:e}");
            assert_eq!(updated.n_rigid_modes(), exact.n_rigid_modes());
            let [lower, upper] = errors(&updated, &exact);
            assert!(lower < 1e-4 && upper < 1e-2, "{cut:?} {stiffness:e}: {lower:e} {upper:e}");
            // Not below the truth, by more than rounding: they are Rayleigh quotients.
            let (found, exact) = (updated.eigenvalues_per_s2(), exact.eigenvalues_per_s2());
            for (found, exact) in found.iter().zip(exact) {
                assert!(found / exact > 1.0 - 1e-7, "{cut:?} {stiffness:e}: {found} {exact}");
            }
        }
    }
}

#[test]
fn its_audit_bounds_the_errors() {
    for cut in [Cut::HalfDepth, Cut::Through] {
        let bar = bar(cut);
        let open = prepared(&bar, &params(&bar, 20));
        let edit = stitch(&bar.pairs, STITCH_N_M);
        let exact = next(&open, &edit, Method::FromScratch);
        let updated = next(&open, &edit, Method::Flexibility);
        let truth = exact.eigenvalues_per_s2();
        for (i, (lambda, residual)) in
            updated.eigenvalues_per_s2().iter().zip(updated.residuals()).enumerate()
        {
            let sigma = open.shift_per_s2();
            let nearest = truth.iter().map(|e| ((lambda + sigma) / (e + sigma) - 1.0).abs());
            let nearest = nearest.fold(f64::INFINITY, f64::min);
            assert!(nearest <= 1.01 * residual + 1e-9, "{cut:?} {i}: {nearest:e} {residual:e}");
        }
        for (i, estimate) in updated.error_estimates().iter().enumerate() {
            let error = (updated.eigenvalues_per_s2()[i] / truth[i] - 1.0).abs();
            assert!(error <= estimate + 1e-9, "{cut:?} {i}: {error:e} {estimate:e}");
        }
    }
}

#[test]
fn its_modes_and_basis_are_mass_orthonormal_and_its_reduced_model_exact() {
    for cut in [Cut::HalfDepth, Cut::Through] {
        let bar = bar(cut);
        let params = BuildParams { basis_size: 24, ..params(&bar, 12) };
        let open = prepared(&bar, &params);
        let updated = next(&open, &stitch(&bar.pairs, STITCH_N_M), Method::Flexibility);
        assert!(took_no_solve(&updated));
        let masses = open.lumped_mass_kg();
        let gram = |columns: &[Vec<f64>]| {
            Mat::from_fn(columns.len(), columns.len(), |i, j| {
                let pairs = columns[i].iter().zip(&columns[j]).enumerate();
                pairs.map(|(at, (x, y))| masses[at / 3] * x * y).sum::<f64>()
            })
        };
        let modes: Vec<_> = (0..updated.n_modes()).map(|i| updated.mode(i)).collect();
        let basis: Vec<_> = (0..updated.basis_size()).map(|i| updated.basis_column(i)).collect();
        for columns in [modes, basis] {
            let error = linalg::distance_from_identity(gram(&columns).as_ref());
            assert!(error < 1e-8, "{cut:?}: {error:e}");
        }
        // Every tet is summed: the model by rows and by dense columns are the same.
        let q: Vec<f64> = (0..updated.basis_size()).map(|i| 1e-4 / (1.0 + i as f64)).collect();
        let (model, exact) = (updated.model().evaluate(&q), updated.evaluate_exact(&q));
        assert!((model.energy_j / exact.energy_j - 1.0).abs() < 1e-9);
        let scale = exact.stiffness.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        for (a, b) in model.stiffness.iter().zip(&exact.stiffness) {
            assert!((a - b).abs() < 1e-9 * scale);
        }
    }
}

#[test]
fn a_basis_from_a_seam_serves_as_well_as_one_from_scratch() {
    // The static displacement of the tip under loads that bend the stitched bar by a fifth of its
    // length, in either basis.
    for cut in [Cut::HalfDepth, Cut::Through] {
        let bar = bar(cut);
        let params = BuildParams { basis_size: 40, n_derivative_modes: 8, ..params(&bar, 20) };
        let open = prepared(&bar, &params);
        let edit = stitch(&bar.pairs, STITCH_N_M);
        let exact = next(&open, &edit, Method::FromScratch);
        let updated = next(&open, &edit, Method::Flexibility);
        assert!(took_no_solve(&updated));
        let vertices = open.mesh().vertices();
        let tip = (0..vertices.len() as u32)
            .max_by(|&a, &b| vertices[a as usize][0].total_cmp(&vertices[b as usize][0]))
            .unwrap();
        let moved = |body: &Artifacts, force: [f64; 3]| {
            let load = body.vertex_load(tip, force);
            let q = body.model().solve_static(&load, &vec![0.0; load.len()]).unwrap();
            let rows = body.basis_rows(tip);
            std::array::from_fn::<f64, 3, _>(|axis| {
                rows.iter().zip(&q).map(|(row, q)| row[axis] * q).sum()
            })
        };
        for force in [[0.0, 0.0, -1.2], [0.0, 1.0, 0.0], [0.4, 0.8, 0.6]] {
            let (a, b) = (moved(&updated, force), moved(&exact, force));
            let gap = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
            let size = b.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!(size > 0.005, "not a test: {size}");
            assert!(gap < 0.02 * size, "{cut:?}: {gap:e} of {size:e}");
        }
    }
}

#[test]
fn unstitching_gives_the_first_spectrum_back() {
    let bar = bar(Cut::Through);
    let open = prepared(&bar, &params(&bar, 15));
    let stitched = next(&open, &stitch(&bar.pairs, STITCH_N_M), Method::Flexibility);
    let undone = next(&stitched, &[Edit::UnstitchAll], Method::Flexibility);
    assert_eq!(undone.n_rigid_modes(), open.n_rigid_modes());
    let error = spectrum_error(undone.eigenvalues_per_s2(), open.eigenvalues_per_s2());
    assert!(error < 1e-10, "{error:e}");
}

#[test]
fn pairs_added_to_a_seam_are_as_those_prepared_together() {
    let bar = bar(Cut::HalfDepth);
    let together = prepared(&bar, &params(&bar, 12));
    let apart = build::build(bar.mesh.clone(), &params(&bar, 12), &Uncontrolled).unwrap();
    for pairs in bar.pairs.chunks(5) {
        build::prepare_seams(&apart, pairs, &Uncontrolled).unwrap();
    }
    let edit = stitch(&bar.pairs, STITCH_N_M);
    let [a, b] = [&together, &apart].map(|open| next(open, &edit, Method::Flexibility));
    assert!(took_no_solve(&a) && took_no_solve(&b));
    let error = spectrum_error(a.eigenvalues_per_s2(), b.eigenvalues_per_s2());
    // Rounding, magnified where Y₁ and Y₂ lean on each other; far below the tolerance.
    assert!(error < 1e-6, "{error:e}");
}

#[test]
fn a_tolerance_that_a_seam_cannot_meet_is_met_by_solving() {
    let bar = bar(Cut::HalfDepth);
    let open = prepared(&bar, &params(&bar, 20));
    let edit = stitch(&bar.pairs, STITCH_N_M);
    let exact = next(&open, &edit, Method::FromScratch);
    let tight = RebuildParams::new(Method::Flexibility, 1e-11);
    let (updated, _) = build::rebuild(&open, &edit, &tight, &Uncontrolled).unwrap();
    assert!(!took_no_solve(&updated));
    assert!(errors(&updated, &exact)[0] < 1e-9);
}

#[test]
fn a_few_stitches_outside_a_seam_join_it() {
    let bar = bar(Cut::HalfDepth);
    let open = build::build(bar.mesh.clone(), &params(&bar, 12), &Uncontrolled).unwrap();
    build::prepare_seams(&open, &bar.pairs[..6], &Uncontrolled).unwrap();
    let updated = at_once(&open, &stitch(&bar.pairs[..8], STITCH_N_M));
    assert!(took_no_solve(&updated));
    let stages: Vec<Stage> = updated.timings().iter().map(|(stage, _)| *stage).collect();
    assert!(stages.contains(&Stage::Seams));
    // Once: the next edit finds them.
    let again = at_once(&open, &stitch(&bar.pairs[..8], STITCH_N_M));
    assert!(again.timings().iter().all(|(stage, _)| *stage != Stage::Seams));
    assert_eq!(again.eigenvalues_per_s2(), updated.eigenvalues_per_s2());
}

#[test]
fn preparing_can_be_cancelled_and_refuses_what_a_stitch_would() {
    let bar = bar(Cut::HalfDepth);
    let open = build::build(bar.mesh.clone(), &params(&bar, 6), &Uncontrolled).unwrap();
    let apart = [[bar.pairs[0][0], bar.pairs[5][1]]];
    assert!(matches!(
        build::prepare_seams(&open, &apart, &Uncontrolled),
        Err(build::BuildError::Seam(_))
    ));
    struct Stopped;
    impl Control for Stopped {
        fn is_cancelled(&self) -> bool {
            true
        }
        fn progress(&self, _: Stage, _: f64) {}
        fn now(&self) -> Duration {
            Duration::ZERO
        }
    }
    assert!(matches!(
        build::prepare_seams(&open, &bar.pairs, &Stopped),
        Err(build::BuildError::Cancelled(_))
    ));
}

#[test]
fn the_certificate_tells_where_the_modes_come_from_and_what_a_deadline_left_undone() {
    let bar = bar(Cut::HalfDepth);
    let open = prepared(&bar, &params(&bar, 20));
    let edit = stitch(&bar.pairs, STITCH_N_M);
    let verdict = |body: &Artifacts| body.certificate().verdict;
    assert_eq!(verdict(&open), Verdict::Rebuilt);
    assert_eq!(verdict(&next(&open, &edit, Method::FromScratch)), Verdict::Rebuilt);
    let patched = next(&open, &edit, Method::Flexibility);
    assert_eq!(verdict(&patched), Verdict::Patched);
    assert!(patched.certificate().is_met && !patched.certificate().is_unfinished);

    // No seam meets this; there is no time for more; then there is.
    let mut hurried = RebuildParams::new(Method::Flexibility, 1e-11);
    hurried.deadline = Some(Duration::ZERO);
    let clock = Clock(Instant::now());
    let (first, _) = build::rebuild(&open, &edit, &hurried, &clock).unwrap();
    assert_eq!(verdict(&first), Verdict::Patched);
    assert!(!first.certificate().is_met && first.certificate().is_unfinished);
    let leisurely = RebuildParams { deadline: Some(Duration::from_secs(3600)), ..hurried };
    let (second, _) = build::rebuild(&first, &[], &leisurely, &clock).unwrap();
    assert_eq!(verdict(&second), Verdict::Refined);
    assert!(second.certificate().is_met && !second.certificate().is_unfinished);
    assert_eq!(second.stitches(), first.stitches());
}

struct Clock(Instant);

impl Control for Clock {
    fn is_cancelled(&self) -> bool {
        false
    }
    fn progress(&self, _: Stage, _: f64) {}
    fn now(&self) -> Duration {
        self.0.elapsed()
    }
}

#[test]
fn derivatives_that_the_load_cases_do_not_know_are_solved_for_or_told_of() {
    let bar = bar(Cut::Through);
    let open = prepared(&bar, &params(&bar, 20));
    let tells =
        |body: &Artifacts| body.warnings().iter().any(|w| w.contains("derivatives of the open"));
    let verdict = |body: &Artifacts| body.certificate().verdict;
    // All pairs by the stiffness that they were prepared for: nothing is left to know.
    let all = next(&open, &stitch(&bar.pairs, STITCH_N_M), Method::Flexibility);
    assert!(took_no_solve(&all) && !tells(&all), "{:?}", all.warnings());
    assert_eq!(verdict(&all), Verdict::Patched);

    let edit = stitch(&bar.pairs[..3], STITCH_N_M);
    let prepared = RebuildParams::new(Method::Flexibility, 1e-4);
    let own = RebuildParams { derivatives: Derivatives::Own, ..prepared };
    let hurried = RebuildParams { deadline: Some(Duration::ZERO), ..own };
    let clock = Clock(Instant::now());
    let [own_made, combined, first] = [own, prepared, hurried]
        .map(|params| build::rebuild(&open, &edit, &params, &clock).unwrap().0);
    assert!(!tells(&own_made) && verdict(&own_made) == Verdict::Refined);
    assert!(tells(&combined) && verdict(&combined) == Verdict::Patched);
    assert!(!combined.certificate().is_unfinished);
    assert!(tells(&first) && first.certificate().is_unfinished);
    // The modes are the same: of what is prepared, all three.
    for body in [&own_made, &first] {
        assert_eq!(body.eigenvalues_per_s2(), combined.eigenvalues_per_s2());
    }
    // What a deadline left undone is done by the next.
    let (second, _) = build::rebuild(&first, &[], &own, &clock).unwrap();
    assert!(!tells(&second) && !second.certificate().is_unfinished);
    assert_eq!(verdict(&second), Verdict::Refined);
}

#[test]
fn a_basis_of_part_of_a_seam_is_that_from_scratch() {
    // Relative errors of static displacements, every tet summed; the loads bend by about a tenth of the length.
    let bar = bar(Cut::HalfDepth);
    let params = BuildParams { basis_size: 40, n_derivative_modes: 8, ..params(&bar, 20) };
    let open = prepared(&bar, &params);
    let edit = stitch(&bar.pairs[..4], STITCH_N_M);
    let exact = next(&open, &edit, Method::FromScratch);
    let combined = next(&open, &edit, Method::Flexibility);
    let own = RebuildParams {
        derivatives: Derivatives::Own,
        ..RebuildParams::new(Method::Flexibility, 1e-4)
    };
    let (own, _) = build::rebuild(&open, &edit, &own, &Uncontrolled).unwrap();
    assert_eq!(own.certificate().verdict, Verdict::Refined);

    let body = StitchedBody::new(open.full_model(), exact.stitches()).unwrap();
    let vertices = open.mesh().vertices();
    let tip = (0..vertices.len() as u32)
        .max_by(|&a, &b| vertices[a as usize][0].total_cmp(&vertices[b as usize][0]))
        .unwrap();
    let place = open.full_model().free_vertices().iter().position(|&v| v == tip).unwrap();
    let mut largest = 0.0f64;
    for force in [[0.0, 0.0, -0.8], [0.0, 0.6, 0.0], [0.3, 0.5, 0.4]] {
        let mut load = vec![0.0; open.n_free_dofs()];
        load[3 * place..][..3].copy_from_slice(&force);
        let truth = body.equilibrium_by_steps(&load, 4).unwrap().x;
        let error = |of: &Artifacts| body.error_in(of.basis(), &load, &truth).unwrap().0;
        let [own, exact, combined] = [&own, &exact, &combined].map(error);
        assert!(own < 1.01 * exact, "{own:e} {exact:e}");
        largest = largest.max(combined / exact);
    }
    assert!(largest > 1.05, "not a test: {largest}");
}

#[test]
fn a_body_without_derivatives_has_seams_too() {
    let bar = bar(Cut::Through);
    let open = prepared(&bar, &BuildParams { n_derivative_modes: 0, ..params(&bar, 12) });
    let edit = stitch(&bar.pairs, STITCH_N_M);
    let exact = next(&open, &edit, Method::FromScratch);
    let updated = next(&open, &edit, Method::Flexibility);
    assert!(took_no_solve(&updated));
    let [lower, upper] = errors(&updated, &exact);
    assert!(lower < 1e-4 && upper < 1e-2, "{lower:e} {upper:e}");
    let undone = next(&updated, &[Edit::UnstitchAll], Method::Flexibility);
    let error = spectrum_error(undone.eigenvalues_per_s2(), open.eigenvalues_per_s2());
    assert!(error < 1e-10, "{error:e}");
}

#[test]
fn a_seam_has_the_cubature_rule_of_the_closed_body() {
    let (bar, params) = trained_bar();
    let open = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let seamed = prepared(&bar, &params);
    let edit = stitch(&bar.pairs, STITCH_N_M);
    let report = |body: &Artifacts| *body.cubature().unwrap();
    // The rule of the open body does not serve, nor its points.
    let without = next(&open, &edit, Method::Flexibility);
    assert_ne!(report(&without).source, CubatureSource::Reused);
    let with = next(&seamed, &edit, Method::Flexibility);
    assert_eq!(report(&with).source, CubatureSource::Reused);
    let (rule, trained_error) = with.recipe().reuse.unwrap();
    assert!(report(&with).validation_error <= 1.25 * trained_error);
    // It is part of what the generation is made of.
    let again = build::remake(&params, &with.recipe(), &[], &Uncontrolled).unwrap();
    assert_eq!(again.cubature(), with.cubature());
    assert_eq!(again.recipe(), with.recipe());

    // Nor is the rule of another method's basis taken for it.
    let spiky = next(&open, &edit, Method::LowRank);
    build::prepare_seams(&spiky, &bar.pairs, &Uncontrolled).unwrap();
    let after = next(&open, &edit, Method::Flexibility);
    assert_eq!(report(&after).source, CubatureSource::Reused);
    let largest = 1.25 * trained_error.max(0.05);
    assert!(report(&after).validation_error < largest, "{:?}", report(&after));

    // As it is opened, the body keeps its own.
    let untouched = next(&seamed, &[], Method::Flexibility);
    let (kept, _) = untouched.recipe().reuse.unwrap();
    assert_eq!(report(&untouched).source, CubatureSource::Reused);
    assert_ne!(kept, rule);
}
