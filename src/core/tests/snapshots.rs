//! Bodies of which little was kept: the same bits, found without a solve.

use crate::bodies::{STITCH_N_M, bar, by, params, stitch};
use crate::closings::{close, gaping};
use crate::recipes::{assert_same, bits, line, through_parts, trained_bar};
use std::collections::BTreeSet;
use std::sync::Mutex;
use std::time::Duration;
use sutura_core::build::{
    self, Artifacts, BaseBody, BaseSnapshot, BuildError, BuildParams, GenerationSnapshot, MassKind,
    Method,
};
use sutura_core::control::{Control, Stage, Uncontrolled};
use sutura_core::testing::Cut;

/// Remembers which stages there were.
#[derive(Default)]
struct Stages(Mutex<BTreeSet<Stage>>);

impl Control for Stages {
    fn is_cancelled(&self) -> bool {
        false
    }
    fn progress(&self, stage: Stage, _fraction: f64) {
        self.0.lock().unwrap().insert(stage);
    }
    fn now(&self) -> Duration {
        Duration::ZERO
    }
}

fn revived(params: &BuildParams, made: &Artifacts, kin: &[BaseBody]) -> (BaseBody, Artifacts) {
    let recipe = through_parts(made.recipe());
    let kept = made.base_body().snapshot();
    let base = build::revive_base(params, recipe.state.base(), &kept, &Uncontrolled).unwrap();
    let body = build::revive(&recipe, &base, &made.snapshot(), kin, &Uncontrolled).unwrap();
    (base, body)
}

/// Whatever a client can ask for.
fn assert_alike(made: &Artifacts, again: &Artifacts, name: &str) {
    assert_same(made, again, name);
    let columns = |body: &Artifacts| {
        let modes = (0..body.n_modes()).flat_map(|i| body.mode(i));
        let rows = (0..20).flat_map(|v| body.basis_rows(v)).flatten();
        bits(modes.chain(rows))
    };
    assert!(columns(made) == columns(again), "{name}: modes and rows");
    assert_eq!(made.evaluator_tables(), again.evaluator_tables(), "{name}");
    assert_eq!(made.residuals(), again.residuals(), "{name}");
    assert_eq!(made.error_estimates(), again.error_estimates(), "{name}");
    assert_eq!(made.timings(), again.timings(), "{name}");
    let q: Vec<f64> = (0..made.basis_size()).map(|i| 1e-3 / (1.0 + i as f64)).collect();
    let exact = |body: &Artifacts| {
        let at = body.evaluate_exact(&q);
        bits([at.energy_j].into_iter().chain(at.force).chain(at.stiffness))
    };
    assert!(exact(made) == exact(again), "{name}: the sum over every tet");
    assert!(bits(again.transfer_from(made)) == bits(made.transfer_from(made)), "{name}");
    let free = |body: &Artifacts| format!("{:?}", body.model().free_body());
    assert_eq!(free(made), free(again), "{name}");
}

#[test]
fn every_generation_is_revived_to_the_bit() {
    let (bar, params) = trained_bar();
    let line = line(&bar, &params);
    for (name, made) in &line {
        assert_alike(made, &revived(&params, made, &[]).1, name);
    }
}

#[test]
fn bodies_of_every_kind_are_revived_to_the_bit() {
    let bar = bar(Cut::HalfDepth);
    let edit = |body: &Artifacts, edits: &[_], method| {
        build::rebuild(body, edits, &by(method), &Uncontrolled).unwrap().0
    };
    for mass in [MassKind::Lumped, MassKind::Consistent] {
        for fixed_vertices in [bar.root.clone(), Vec::new()] {
            let name = format!("{mass:?}, {} held", fixed_vertices.len());
            let params = BuildParams { mass, fixed_vertices, basis_size: 14, ..params(&bar, 8) };
            let built = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
            assert_alike(&built, &revived(&params, &built, &[]).1, &name);
            build::prepare_seams(&built, &bar.pairs, &Uncontrolled).unwrap();
            let stitched = edit(&built, &stitch(&bar.pairs, STITCH_N_M), Method::Flexibility);
            assert_alike(&stitched, &revived(&params, &stitched, &[]).1, &name);
        }
    }
    let bar = gaping(2e-4);
    let params = params(&bar, 8);
    let built = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let closed = edit(&built, &[close(&bar.pairs)], Method::Flexibility);
    assert_alike(&closed, &revived(&params, &closed, &[]).1, "closed");
}

#[test]
fn reviving_takes_a_factorization_and_no_solve() {
    let (bar, params) = trained_bar();
    let built = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let recipe = built.recipe();
    let stages = Stages::default();
    let kept = built.base_body().snapshot();
    let base = build::revive_base(&params, recipe.state.base(), &kept, &stages).unwrap();
    build::revive(&recipe, &base, &built.snapshot(), &[], &stages).unwrap();
    let took = stages.0.into_inner().unwrap();
    assert_eq!(took, [Stage::Assembly, Stage::Factorization, Stage::Reduction].into());

    // A generation that is made again on a base body that is there finds no modes of the base body.
    let stages = Stages::default();
    let again = build::remake(&params, &recipe, &[base], &stages).unwrap();
    assert_same(&built, &again, "made on a revived base body");
    assert!(!stages.0.into_inner().unwrap().contains(&Stage::Modes));
}

#[test]
fn later_edits_are_those_of_the_body_that_was_made() {
    let (bar, params) = trained_bar();
    let line = line(&bar, &params);
    for (name, made) in &line {
        let recipe = made.recipe();
        let again = build::remake(&params, &recipe, &[], &Uncontrolled).unwrap();
        let (_, revived) = revived(&params, made, &[]);
        // What an edit takes from seams: as they were, and what was prepared on the way.
        let stitched = made.stitches().iter().map(|stitch| stitch.pair);
        let mut pairs: Vec<[u32; 2]> = recipe.seams.groups.concat();
        pairs.extend(stitched);
        for body in [&again, &revived] {
            build::prepare_seams(body, &pairs, &Uncontrolled).unwrap();
        }
        for (edits, method) in [
            (vec![], Method::Flexibility),
            (vec![sutura_core::edit::Edit::UnstitchAll], Method::Flexibility),
            (vec![sutura_core::edit::Edit::UnstitchAll], Method::LowRank),
        ] {
            let [a, b] = [&again, &revived]
                .map(|body| build::rebuild(body, &edits, &by(method), &Uncontrolled).unwrap().0);
            assert_same(&a, &b, name);
        }
    }
}

#[test]
fn what_belongs_to_another_body_is_refused() {
    let (bar, params) = trained_bar();
    let built = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let edits = stitch(&bar.pairs[..3], STITCH_N_M);
    let made = build::rebuild(&built, &edits, &by(Method::Flexibility), &Uncontrolled).unwrap().0;
    let recipe = made.recipe();
    let base = made.base_body();

    let refused = |change: &dyn Fn(&mut BaseSnapshot)| {
        let mut kept = base.snapshot();
        change(&mut kept);
        let revived = build::revive_base(&params, recipe.state.base(), &kept, &Uncontrolled);
        assert!(matches!(revived.err().unwrap(), BuildError::Misfit { .. }));
    };
    refused(&|kept| kept.sigma_per_s2 = 1.0);
    refused(&|kept| kept.sigma_per_s2 = f64::NAN);
    refused(&|kept| kept.sigma_per_s2 = -1.0);
    refused(&|kept| kept.modes.n_columns = usize::MAX);
    refused(&|kept| kept.modes.n_columns -= 1);
    refused(&|kept| kept.modes.values[7] = f64::INFINITY);
    refused(&|kept| kept.modes.values.truncate(1));
    refused(&|kept| kept.eigenvalues_per_s2.truncate(1));
    refused(&|kept| kept.eigenvalues_per_s2[0] = f64::NAN);
    refused(&|kept| kept.residuals.push(0.0));
    refused(&|kept| *kept = BaseSnapshot { modes: made.snapshot().basis, ..kept.clone() });

    let refused = |change: &dyn Fn(&mut GenerationSnapshot)| {
        let mut kept = made.snapshot();
        change(&mut kept);
        let revived = build::revive(&recipe, &base, &kept, &[], &Uncontrolled);
        let error = revived.err().unwrap();
        let is_meant = matches!(error, BuildError::Misfit { .. } | BuildError::BadParameter { .. });
        assert!(is_meant, "{error}");
    };
    refused(&|kept| kept.n_rigid_modes = 6);
    refused(&|kept| kept.spectrum.eigenvalues.truncate(2));
    refused(&|kept| kept.spectrum.eigenvalues[1] = f64::INFINITY);
    refused(&|kept| kept.spectrum.residuals[1] = f64::NAN);
    refused(&|kept| kept.tolerance = Some(f64::NAN));
    refused(&|kept| kept.modes.as_mut().unwrap().n_columns = usize::MAX / 2);
    refused(&|kept| kept.modes = Some(kept.basis.clone()));
    refused(&|kept| kept.basis.values[0] = f64::NAN);
    refused(&|kept| kept.basis = Default::default());
    refused(&|kept| kept.cubature = None);
    refused(&|kept| kept.cubature.as_mut().unwrap().rule.tets[0] = u32::MAX);
    refused(&|kept| kept.cubature.as_mut().unwrap().rule.weights.truncate(1));
    refused(&|kept| kept.cubature.as_mut().unwrap().report.n_points += 1);
    refused(&|kept| kept.cubature.as_mut().unwrap().report.validation_error = f64::NAN);
    refused(&|kept| kept.stitch_stiffness.n_columns = 1);
    refused(&|kept| kept.gravity_loads.values.truncate(1));

    // The base body of another one.
    let mut other = params.clone();
    other.fixed_vertices.pop();
    let other = build::build(bar.mesh.clone(), &other, &Uncontrolled).unwrap().base_body();
    let revived = build::revive(&recipe, &other, &made.snapshot(), &[], &Uncontrolled);
    assert!(matches!(revived.err().unwrap(), BuildError::Misfit { .. }));
    let revived =
        build::revive_base(&params, recipe.state.base(), &other.snapshot(), &Uncontrolled);
    assert!(matches!(revived.err().unwrap(), BuildError::Misfit { .. }));
}
