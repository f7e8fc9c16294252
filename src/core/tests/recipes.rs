//! Generations made again from what they are a function of: the same bits.

use crate::bodies::{STITCH_N_M, bar, by, params, stitch};
use std::sync::Arc;
use std::time::Duration;
use sutura_core::build::{self, Artifacts, BuildError, BuildParams, CubatureParams, Method};
use sutura_core::build::{Derivatives, RebuildParams, Recipe};
use sutura_core::control::Uncontrolled;
use sutura_core::edit::{Edit, EditState};
use sutura_core::testing::{BarMesh, Cut};

fn rebuilt(previous: &Artifacts, edits: &[Edit], params: &RebuildParams) -> Artifacts {
    build::rebuild(previous, edits, params, &Uncontrolled).unwrap().0
}

pub(crate) fn bits(numbers: impl IntoIterator<Item = f64>) -> Vec<u64> {
    numbers.into_iter().map(f64::to_bits).collect()
}

pub(crate) fn assert_same(made: &Artifacts, again: &Artifacts, name: &str) {
    let spectrum = |body: &Artifacts| bits(body.eigenvalues_per_s2().iter().copied());
    assert_eq!(spectrum(made), spectrum(again), "{name}");
    let basis = |body: &Artifacts| {
        (0..body.basis_size()).map(|i| bits(body.basis_column(i))).collect::<Vec<_>>()
    };
    assert!(basis(made) == basis(again), "{name}: the basis");
    let q: Vec<f64> = (0..made.basis_size()).map(|i| 1e-3 / (1.0 + i as f64)).collect();
    let evaluated = |body: &Artifacts| {
        let at = body.model().evaluate(&q);
        bits([at.energy_j].into_iter().chain(at.force).chain(at.stiffness))
    };
    assert!(evaluated(made) == evaluated(again), "{name}: the reduced model");
    assert_eq!(made.certificate(), again.certificate(), "{name}");
    assert_eq!(made.cubature(), again.cubature(), "{name}");
    assert_eq!(made.warnings(), again.warnings(), "{name}");
    assert_eq!(made.closings(), again.closings(), "{name}");
    assert!(made.recipe() == again.recipe(), "{name}: the recipe");
}

/// A recipe whose mesh and state have been taken apart and put together again.
pub(crate) fn through_parts(recipe: Recipe) -> Recipe {
    let state = &recipe.state;
    let mesh = state.base().mesh();
    let (vertices, tets) = (mesh.vertices().to_vec(), mesh.tets().to_vec());
    let mesh = sutura_core::mesh::TetMesh::new(vertices, tets, mesh.labels().to_vec()).unwrap();
    let state = EditState::from_parts(
        Arc::new(mesh),
        state.base().fixed_vertices().clone(),
        state.base().stiffness_factors().clone(),
        state.stitches().to_vec(),
        state.base().folded().clone(),
        state.next_id(),
    );
    Recipe { state: state.unwrap(), ..recipe }
}

/// The bar of the tests, and a build of it with a cubature rule.
pub(crate) fn trained_bar() -> (BarMesh, BuildParams) {
    let bar = bar(Cut::HalfDepth);
    let cubature = Some(CubatureParams {
        n_points: 30,
        n_training_poses: 15,
        tolerance: 0.05,
        seed: 1,
        selection: Default::default(),
        smoothing: true,
    });
    let params = BuildParams { basis_size: 16, cubature, ..params(&bar, 10) };
    (bar, params)
}

/// A line of generations of it, of every kind that there is.
pub(crate) fn line(bar: &BarMesh, params: &BuildParams) -> Vec<(&'static str, Artifacts)> {
    let body = build::build(bar.mesh.clone(), params, &Uncontrolled).unwrap();
    let (some, rest) = bar.pairs.split_at(6);
    let plain = by(Method::Flexibility);
    let hurried = RebuildParams { deadline: Some(Duration::ZERO), ..plain };

    let mut line = vec![("built", body)];
    let mut add = |name, edits: &[Edit], params: &RebuildParams, seam: &[[u32; 2]]| {
        let made = rebuilt(&line.last().unwrap().1, edits, params);
        build::prepare_seams(&made, seam, &Uncontrolled).unwrap();
        line.push((name, made));
    };
    add("outside a seam", &stitch(some, STITCH_N_M), &plain, some);
    add("inside a seam, in no time", &[], &hurried, &[]);
    add("partly prepared on the way", &stitch(&rest[..2], 1e3), &plain, rest);
    add("inside a larger seam", &stitch(&rest[2..], 1e4), &plain, &[]);
    let last = &line.last().unwrap().1;
    let base = build::prepare_base(last, &Uncontrolled).unwrap();
    let rebased = build::rebase(last, &base, &Uncontrolled).unwrap().unwrap();
    line.push(("rebased", rebased));
    let mut add = |name, edits: &[Edit], params: &RebuildParams, seam: &[[u32; 2]]| {
        let made = rebuilt(&line.last().unwrap().1, edits, params);
        build::prepare_seams(&made, seam, &Uncontrolled).unwrap();
        line.push((name, made));
    };
    add("published update", &[Edit::UnstitchAll], &by(Method::LowRank), &[]);
    let scale = Edit::ScaleStiffness { domain: bar.mesh.domains()[0], factor: 3.0 };
    add("another base body", &[scale], &plain, &bar.pairs);
    add("a part of its seam", &stitch(some, STITCH_N_M), &plain, &[]);
    let own = RebuildParams { derivatives: Derivatives::Own, ..plain };
    add("with derivatives of its own", &[], &own, &[]);
    let hurried = RebuildParams { derivatives: Derivatives::Own, ..hurried };
    add("without them in no time", &[], &hurried, &[]);
    add("from scratch", &stitch(rest, STITCH_N_M), &by(Method::FromScratch), &[]);
    line
}

#[test]
fn every_generation_can_be_made_again_alone() {
    let (bar, params) = trained_bar();
    let line = line(&bar, &params);
    // Each alone, then all of them one after another, which share what they can.
    for (name, made) in &line {
        let again = build::remake(&params, &through_parts(made.recipe()), &[], &Uncontrolled);
        assert_same(made, &again.unwrap(), name);
    }
    let mut kin = Vec::new();
    for (name, made) in line.iter().rev() {
        let again = build::remake(&params, &made.recipe(), &kin, &Uncontrolled).unwrap();
        assert_same(made, &again, name);
        kin.push(again.base_body());
    }
}

#[test]
fn recipes_that_nobody_made_are_refused() {
    let bar = bar(Cut::HalfDepth);
    let params = params(&bar, 6);
    let body = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let good = rebuilt(&body, &stitch(&bar.pairs[..2], 1e4), &by(Method::Flexibility)).recipe();
    let refused = |change: &dyn Fn(&mut Recipe)| {
        let mut recipe = good.clone();
        change(&mut recipe);
        build::remake(&params, &recipe, &[], &Uncontrolled).expect_err("made")
    };
    let rule = |tets: Vec<u32>, weights: Vec<f64>| {
        Some((sutura_core::cubature::Rule::of_tets(tets, weights), 0.0))
    };
    let error = refused(&|r| r.reuse = rule(vec![u32::MAX], vec![1.0]));
    assert!(matches!(error, BuildError::BadParameter { name: "cubature point", .. }), "{error}");
    let error = refused(&|r| r.reuse = rule(vec![0, 1], vec![1.0]));
    assert!(matches!(error, BuildError::BadParameter { name: "cubature weights", .. }), "{error}");
    let error = refused(&|r| r.reuse = rule(vec![0], vec![f64::NAN]));
    assert!(matches!(error, BuildError::BadParameter { name: "cubature weight", .. }), "{error}");
    let smoothed = |smoothing| {
        let mut rule = rule(vec![0], vec![1.0]);
        rule.as_mut().unwrap().0.smoothing = smoothing;
        rule
    };
    for smoothing in [vec![[[0.0; 3]; 4]; 2], vec![[[f64::NAN; 3]; 4]]] {
        let error = refused(&|r| r.reuse = smoothed(smoothing.clone()));
        let is_named = matches!(error, BuildError::BadParameter { name: "cubature smoothing", .. });
        assert!(is_named, "{error}");
    }
    let error = refused(&|r| r.tolerance = 2.0);
    assert!(matches!(error, BuildError::BadParameter { name: "tolerance", .. }), "{error}");
    let error = refused(&|r| Arc::make_mut(&mut r.seams).groups = vec![vec![[0, u32::MAX]]]);
    assert!(matches!(error, BuildError::Seam(_)), "{error}");

    let state = |fixed: u32, factor: (i64, f64), stitch| {
        let mesh = bar.mesh.clone();
        EditState::from_parts(mesh, [fixed].into(), [factor].into(), vec![stitch], [].into(), 1)
    };
    let stitch = good.state.stitches()[0];
    let domain = bar.mesh.domains()[0];
    assert!(state(0, (domain, 2.0), stitch).is_ok());
    assert!(state(u32::MAX, (domain, 2.0), stitch).is_err());
    assert!(state(0, (domain + 1, 2.0), stitch).is_err());
    assert!(state(0, (domain, f64::NAN), stitch).is_err());
    let wrong = sutura_core::edit::Stitch { id: 1, ..stitch };
    assert!(state(0, (domain, 2.0), wrong).is_err());
    let wrong = sutura_core::edit::Stitch { pair: [0, u32::MAX], ..stitch };
    assert!(state(0, (domain, 2.0), wrong).is_err());
    let wrong = sutura_core::edit::Stitch { stiffness_n_m: f64::INFINITY, ..stitch };
    assert!(state(0, (domain, 2.0), wrong).is_err());
}
