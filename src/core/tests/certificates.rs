//! What generations claim of themselves, against what is true.

use crate::bodies::{bar, by, params, spectrum_error, vector};
use faer::Mat;
use std::time::Duration;
use sutura_core::build::{self, Artifacts, BuildParams, Method, RebuildParams, Verdict};
use sutura_core::control::Uncontrolled;
use sutura_core::edit::{Edit, EditError};
use sutura_core::linalg;
use sutura_core::testing::Cut;

/// A number below `count`, the `i`-th of the stream `seed`.
fn choice(i: usize, seed: f64, count: usize) -> usize {
    let x = vector(i + 1, 1.0, seed)[i];
    (((0.5 * (x + 1.0)) * count as f64) as usize).min(count - 1)
}

/// The next random edit of a body whose stitches are in force.
fn random_edit(i: usize, body: &Artifacts, pairs: &[[u32; 2]]) -> Vec<Edit> {
    let stitches = body.stitches();
    let open: Vec<[u32; 2]> = pairs
        .iter()
        .copied()
        .filter(|pair| stitches.iter().all(|stitch| stitch.pair != *pair))
        .collect();
    let some_of = |count: usize| -> Vec<u64> {
        (0..count.min(stitches.len()))
            .map(|k| (choice(i, 2.0, stitches.len()) + k) % stitches.len())
            .map(|at| stitches[at].id)
            .collect()
    };
    let stiffness_n_m = 10f64.powi(2 + choice(i, 3.0, 7) as i32);
    match choice(i, 1.0, 5) {
        0 | 1 if !open.is_empty() => {
            let first = choice(i, 4.0, open.len());
            let count = 1 + choice(i, 5.0, 6);
            let pairs = open[first..].iter().copied().take(count).collect();
            vec![Edit::Stitch { pairs, stiffness_n_m }]
        }
        2 if !stitches.is_empty() => {
            vec![Edit::SetStiffness { stitch_ids: some_of(4), stiffness_n_m }]
        }
        3 if !stitches.is_empty() => vec![Edit::Unstitch { stitch_ids: some_of(3) }],
        _ if choice(i, 6.0, 8) == 0 => vec![Edit::UnstitchAll],
        _ => {
            let pairs = open.first().copied().into_iter().collect::<Vec<_>>();
            if pairs.is_empty() {
                vec![Edit::UnstitchAll]
            } else {
                vec![Edit::Stitch { pairs, stiffness_n_m }]
            }
        }
    }
}

/// Sine of the largest angle, in the mass norm, between the lower half of the exact modes and the
/// span of those found.
fn sine(found: &Artifacts, exact: &Artifacts) -> f64 {
    let masses = found.lumped_mass_kg();
    let half = exact.n_modes().div_ceil(2);
    let of = |body: &Artifacts, count: usize| {
        let modes: Vec<Vec<f64>> = (0..count).map(|i| body.mode(i)).collect();
        Mat::from_fn(3 * masses.len(), count, |row, j| modes[j][row] * masses[row / 3].sqrt())
    };
    let (u, v) = (of(found, found.n_modes()), of(exact, half));
    let inside = linalg::gram(u.as_ref(), v.as_ref());
    let mut outside = v;
    linalg::add_product(outside.as_mut(), -1.0, u.as_ref(), inside.as_ref());
    let gram = linalg::gram(outside.as_ref(), outside.as_ref());
    linalg::symmetric_eigen(gram.as_ref()).unwrap().0.last().copied().unwrap().max(0.0).sqrt()
}

#[test]
fn none_of_a_hundred_random_edits_violates_its_certificate() {
    let mut verdicts = [0; 3];
    for (cut, n_edits) in [(Cut::HalfDepth, 60), (Cut::Through, 60)] {
        let bar = bar(cut);
        let params = BuildParams { basis_size: 20, ..params(&bar, 16) };
        let mut body = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
        // Half of the pairs are prepared: some edits stay inside the seam, some leave it.
        let prepared = &bar.pairs[..bar.pairs.len() / 2];
        build::prepare_seams(&body, prepared, &Uncontrolled).unwrap();
        for i in 0..n_edits {
            let edits = random_edit(i, &body, &bar.pairs);
            // Every third time more is asked for than a seam can give, every other there is no time.
            let tolerance = if i % 3 == 0 { 1e-8 } else { 1e-4 };
            let asked = RebuildParams {
                deadline: (i % 3 == 1).then_some(Duration::ZERO),
                ..RebuildParams::new(Method::Flexibility, tolerance)
            };
            let (next, _) = build::rebuild(&body, &edits, &asked, &Uncontrolled).unwrap();
            let (exact, _) =
                build::rebuild(&body, &edits, &by(Method::FromScratch), &Uncontrolled).unwrap();
            assert_eq!(next.stitches(), exact.stitches());
            assert_eq!(next.n_rigid_modes(), exact.n_rigid_modes());
            let certificate = next.certificate();
            verdicts[certificate.verdict as usize] += 1;
            let hurried = asked.deadline.is_some();
            assert!(certificate.is_met || hurried, "{cut:?} {i} {edits:?}: {certificate:?}");
            let (found, truth) = (next.eigenvalues_per_s2(), exact.eigenvalues_per_s2());
            let half = truth.len().div_ceil(2);
            let lower = spectrum_error(&found[..half], &truth[..half]);
            let upper = spectrum_error(&found[half..], &truth[half..]);
            // The reference itself is good to 1e-9.
            let (allowed, rounding) = (certificate.lower_eigenvalue_error, 1e-9);
            assert!(lower <= allowed + rounding, "{cut:?} {i} {edits:?}: {lower:e} {allowed:e}");
            let allowed = certificate.upper_eigenvalue_error;
            assert!(upper <= allowed + rounding, "{cut:?} {i} {edits:?}: {upper:e} {allowed:e}");
            let (sine, allowed) = (sine(&next, &exact), certificate.basis_angle);
            assert!(sine <= allowed + 1e-5, "{cut:?} {i} {edits:?}: {sine:e} {allowed:e}");
            body = next;
        }
    }
    let [patched, refined, rebuilt] = verdicts;
    assert!(patched >= 20 && refined >= 20 && rebuilt == 0, "not a test: {verdicts:?}");
}

#[test]
fn ten_rounds_of_one_stitch_are_one_round_of_ten() {
    let bar = bar(Cut::HalfDepth);
    let open = build::build(bar.mesh.clone(), &params(&bar, 12), &Uncontrolled).unwrap();
    build::prepare_seams(&open, &bar.pairs, &Uncontrolled).unwrap();
    let ten = &bar.pairs[..10];
    let stitch = |pairs: &[[u32; 2]]| Edit::Stitch { pairs: pairs.to_vec(), stiffness_n_m: 1e5 };
    let next = |body: &Artifacts, edits: &[Edit]| {
        build::rebuild(body, edits, &by(Method::Flexibility), &Uncontrolled).unwrap().0
    };
    let together = next(&open, &[stitch(ten)]);
    let mut body = next(&open, &[stitch(&ten[..1])]);
    for pair in &ten[1..] {
        body = next(&body, &[stitch(std::slice::from_ref(pair))]);
    }
    assert_eq!(body.eigenvalues_per_s2(), together.eigenvalues_per_s2());
}

#[test]
fn odd_requests_are_refused_or_answered_rightly() {
    let bar = bar(Cut::HalfDepth);
    let open = build::build(bar.mesh.clone(), &params(&bar, 8), &Uncontrolled).unwrap();
    build::prepare_seams(&open, &bar.pairs[..4], &Uncontrolled).unwrap();
    let by = by(Method::Flexibility);
    let tried = |edits: &[Edit]| build::rebuild(&open, edits, &by, &Uncontrolled);
    let refused = |edits: &[Edit]| match tried(edits) {
        Err(build::BuildError::Edit(error)) => error,
        Err(other) => panic!("{edits:?}: {other}"),
        Ok(_) => panic!("{edits:?} was accepted"),
    };
    let stitch = |pairs: &[[u32; 2]], stiffness_n_m: f64| Edit::Stitch {
        pairs: pairs.to_vec(),
        stiffness_n_m,
    };
    let [first, second] = [bar.pairs[0], bar.pairs[1]];
    let turned = [first[1], first[0]];
    // A pair twice, whichever way round, in one edit or in two of a request.
    for edits in [
        vec![stitch(&[first, second, first], 1e5)],
        vec![stitch(&[first, turned], 1e5)],
        vec![stitch(&[first], 1e5), stitch(&[turned], 1e3)],
    ] {
        assert!(matches!(refused(&edits), EditError::AlreadyStitched { .. }));
    }
    for id in [0, 7, u64::MAX] {
        let error = refused(&[Edit::Unstitch { stitch_ids: vec![id] }]);
        assert!(matches!(error, EditError::UnknownStitch { .. }));
    }
    let domain = bar.mesh.domains()[0];
    for factor in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e30] {
        let error = refused(&[Edit::ScaleStiffness { domain, factor }]);
        assert!(matches!(error, EditError::StiffnessFactor { .. }), "{factor}");
    }
    for stiffness in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-12, 1e15] {
        let error = refused(&[stitch(&[first], stiffness)]);
        assert!(matches!(error, EditError::Stiffness { .. }), "{stiffness:e}");
    }
    // The softest and the stiffest springs that are taken, inside the seam and outside.
    for pairs in [&bar.pairs[..4], &bar.pairs[..]] {
        for stiffness in [1e-9, 1e12] {
            let edits = [stitch(pairs, stiffness)];
            let (body, _) = tried(&edits).unwrap();
            // Stitches ten thousand times stiffer than the body are as good as these, and an exact
            // factorization of them keeps its digits.
            let like = [stitch(pairs, stiffness.min(1e9))];
            let scratch = RebuildParams::new(Method::FromScratch, 1e-4);
            let (exact, _) = build::rebuild(&open, &like, &scratch, &Uncontrolled).unwrap();
            let error =
                spectrum_error(&body.eigenvalues_per_s2()[..4], &exact.eigenvalues_per_s2()[..4]);
            assert!(error < 1e-4, "{stiffness:e}: {error:e}");
            assert_ne!(body.certificate().verdict, Verdict::Rebuilt);
        }
    }
}
