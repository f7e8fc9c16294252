//! Pairs of vertices pulled together: against bodies built closed, and against the balance of forces.

use crate::bodies::{STITCH_N_M, bar, by, norm, params, spectrum_error, stitch};
use nalgebra::{Rotation3, Vector3};
use std::collections::BTreeSet;
use std::sync::Arc;
use sutura_core::assembly::FullModel;
use sutura_core::build::{self, Artifacts, BuildError, BuildParams, Method, RebuildParams};
use sutura_core::closing::{self, Closing};
use sutura_core::control::{Stage, Uncontrolled};
use sutura_core::edit::{COINCIDENCE_RATIO, Edit, EditError, EditKind};
use sutura_core::mesh::TetMesh;
use sutura_core::testing::{BarMesh, Cut};

/// The bar with its vertices elsewhere.
fn moved(bar: &BarMesh, place: impl Fn(u32, Vector3<f64>) -> Vector3<f64>) -> BarMesh {
    let vertices =
        (0..).zip(bar.mesh.vertices()).map(|(v, x)| place(v, Vector3::from(*x)).into()).collect();
    let mesh = TetMesh::new(vertices, bar.mesh.tets().to_vec(), Vec::new()).unwrap();
    BarMesh { mesh: Arc::new(mesh), ..bar.clone() }
}

/// Two halves, the second one carried off and turned by some degrees.
fn apart() -> BarMesh {
    let bar = bar(Cut::Through);
    let first = bar.mesh.component_of_vertex()[bar.root[0] as usize];
    let turn = Rotation3::new(Vector3::new(0.1, -0.2, 0.15));
    let centre = Vector3::new(0.15, 0.025, 0.025);
    moved(&bar, |v, x| match bar.mesh.component_of_vertex()[v as usize] == first {
        true => x,
        false => centre + turn * (x - centre) + Vector3::new(0.02, 0.005, -0.008),
    })
}

/// The incised bar with its incision gaping like a wedge, `width_m` wide at the surface.
pub(crate) fn gaping(width_m: f64) -> BarMesh {
    let bar = bar(Cut::HalfDepth);
    let sides = [0, 1].map(|side| bar.pairs.iter().map(|p| p[side]).collect::<BTreeSet<u32>>());
    moved(&bar, |v, x| {
        let side = [-1.0, 1.0].into_iter().zip(&sides).find(|(_, side)| side.contains(&v));
        let depth = (x[2] - 0.025) / 0.025;
        x + Vector3::x() * side.map_or(0.0, |(sign, _)| 0.5 * sign * width_m * depth)
    })
}

fn start(bar: &BarMesh, params: &BuildParams) -> Artifacts {
    build::build(bar.mesh.clone(), params, &Uncontrolled).unwrap()
}

fn next(previous: &Artifacts, edits: &[Edit], method: Method) -> Artifacts {
    let params = RebuildParams { tolerance: 1e-11, ..by(method) };
    build::rebuild(previous, edits, &params, &Uncontrolled).unwrap().0
}

pub(crate) fn close(pairs: &[[u32; 2]]) -> Edit {
    Edit::Close { pairs: pairs.to_vec(), stiffness_n_m: STITCH_N_M, max_gap_m: None }
}

fn refused(body: &Artifacts, edits: &[Edit]) -> EditError {
    match build::rebuild(body, edits, &by(Method::Flexibility), &Uncontrolled) {
        Err(BuildError::Edit(error)) => error,
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("accepted"),
    }
}

fn positions_apart(a: &TetMesh, b: &TetMesh) -> f64 {
    let gap = |(a, b): (&[f64; 3], &[f64; 3])| (Vector3::from(*a) - Vector3::from(*b)).norm();
    a.vertices().iter().zip(b.vertices()).map(gap).fold(0.0, f64::max)
}

/// Pairs that have come together are in one place exactly, and stitched.
fn assert_stitched(body: &Artifacts, pairs: &[[u32; 2]]) {
    for &[a, b] in pairs {
        let x = body.mesh().vertices();
        assert_eq!(x[a as usize], x[b as usize]);
        assert!(body.stitches().iter().any(|s| s.pair == [a, b] && s.stiffness_n_m == STITCH_N_M));
    }
}

#[test]
fn a_free_block_comes_to_where_it_fits_without_strain() {
    let (open, fitting) = (apart(), bar(Cut::Through));
    for held in [true, false] {
        let fixed_vertices = if held { open.root.clone() } else { Vec::new() };
        let params = BuildParams { fixed_vertices, ..params(&open, 12) };
        let before = start(&open, &params);
        let closed = next(&before, &[close(&open.pairs)], Method::Flexibility);
        let [report] = closed.closings() else { panic!("one closing") };
        assert!(report.pairs.iter().all(|pair| pair.gap_before_m > 0.01));
        let diagonal = open.mesh.diagonal();
        let widest = report.pairs.iter().map(|pair| pair.gap_m).fold(0.0, f64::max);
        assert!(widest <= COINCIDENCE_RATIO * diagonal, "{widest:e}");
        // As against E V (gap/length)²/2 if it had to be stretched.
        let strained = 0.5 * 5e5 * 5e-4 * 0.01;
        assert!(report.dropped_energy_j < 1e-9 * strained, "{:e}", report.dropped_energy_j);
        assert!(report.residual() < 1e-8);
        assert!(closed.warnings().iter().any(|w| w.contains("stress")), "{:?}", closed.warnings());
        assert_stitched(&closed, &open.pairs);
        if held {
            assert!(positions_apart(closed.mesh(), &fitting.mesh) < 1e-7 * diagonal);
        }

        let built = start(&fitting, &params);
        let truth = next(&built, &stitch(&fitting.pairs, STITCH_N_M), Method::FromScratch);
        assert_eq!(closed.n_rigid_modes(), if held { 0 } else { 6 });
        let error = spectrum_error(closed.eigenvalues_per_s2(), truth.eigenvalues_per_s2());
        assert!(error < 1e-6, "{error:e}");

        // A single pair is a joint: it closes too, and leaves what it does not determine.
        let hinged = next(&before, &[close(&open.pairs[..1])], Method::Flexibility);
        assert_eq!(hinged.n_rigid_modes(), if held { 3 } else { 9 });
        assert!(hinged.closings()[0].dropped_energy_j < 1e-9 * strained);
        // The seam is closed in two rounds: the first joint stays closed.
        let both = next(&hinged, &[close(&open.pairs[1..])], Method::Flexibility);
        assert_stitched(&both, &open.pairs);
        let error = spectrum_error(both.eigenvalues_per_s2(), truth.eigenvalues_per_s2());
        assert!(error < 1e-6, "{error:e}");
    }
}

#[test]
fn forces_balance_where_a_gaping_incision_is_closed() {
    let bar = gaping(0.012);
    let pairs: Vec<[u32; 2]> = bar.pairs.clone();
    let fixed = [&bar.root[..], &bar.tip].concat();
    for fixed in [&bar.root, &fixed, &Vec::new()] {
        let params = BuildParams { fixed_vertices: fixed.clone(), ..params(&bar, 12) };
        let model = FullModel::new(bar.mesh.clone(), &params.materials, fixed);
        let problem = Closing {
            model: &model,
            pairs: &pairs,
            closed_m: COINCIDENCE_RATIO * bar.mesh.diagonal(),
            eigenvalue_per_s2: 600.0,
        };
        let closed = closing::close(&problem, &Uncontrolled).unwrap();
        assert_eq!(closed.obstacle, None);
        assert!(closed.levels.len() > 2);
        for levels in closed.levels.windows(2) {
            assert!(levels[1].stiffness_n_m >= levels[0].stiffness_n_m, "{:?}", closed.levels);
            assert!(levels[1].gap_m < levels[0].gap_m, "{:?}", closed.levels);
        }
        assert!(closed.levels.iter().all(|level| level.residual < 1e-8), "{:?}", closed.levels);
        assert!(closed.gaps_m.iter().all(|gap| *gap <= problem.closed_m));

        // Nothing pulls but the pairs, and those with opposite forces at their two ends.
        let force = model.internal_force(&closed.displacement_m);
        let at = |v: u32| match model.free_index(v) {
            Some(v) => Vector3::new(force[3 * v], force[3 * v + 1], force[3 * v + 2]),
            None => Vector3::zeros(),
        };
        let ends: BTreeSet<u32> = pairs.iter().flatten().copied().collect();
        let pull = pairs.iter().map(|p| at(p[0]).norm_squared()).sum::<f64>().sqrt();
        assert!(pull > 0.1, "{pull:e} N");
        for &v in model.free_vertices().iter().filter(|v| !ends.contains(v)) {
            assert!(at(v).norm() < 1e-8 * pull, "{v}: {:e} of {pull:e} N", at(v).norm());
        }
        for &[a, b] in &pairs {
            assert!((at(a) + at(b)).norm() < 1e-8 * pull);
        }

        let before = start(&bar, &params);
        let body = next(&before, &[close(&pairs)], Method::Flexibility);
        assert_stitched(&body, &pairs);
        let report = &body.closings()[0];
        let energy = model.energy(&closed.displacement_m);
        assert!((report.dropped_energy_j / energy - 1.0).abs() < 1e-6);
        assert!(energy > 1e-5, "{energy:e}");
        let largest = closed.displacement_m.chunks_exact(3).map(norm).fold(0.0, f64::max);
        assert!((report.largest_displacement_m / largest - 1.0).abs() < 1e-6);
        assert!(body.timings().iter().any(|(stage, _)| *stage == Stage::Closing));
        // It is a body like any other: as one built so.
        let shape = BarMesh { mesh: body.mesh().clone(), ..bar.clone() };
        let truth = next(&start(&shape, &params), &stitch(&pairs, STITCH_N_M), Method::FromScratch);
        let half = ..6;
        let error =
            spectrum_error(&body.eigenvalues_per_s2()[half], &truth.eigenvalues_per_s2()[half]);
        assert!(error < 1e-9, "{error:e}");
        let opened = next(&body, &[Edit::UnstitchAll], Method::Flexibility);
        assert_eq!(opened.mesh().vertices(), body.mesh().vertices());
        // The generation before has kept its shape.
        assert_eq!(before.mesh().vertices(), bar.mesh.vertices());
        let transfer = body.transfer_from(&before);
        assert!(transfer.iter().all(|x| x.is_finite()));
    }
}

#[test]
fn a_closing_is_one_edit_among_others() {
    let bar = gaping(0.01);
    let (deep, shallow) = bar.pairs.split_at(5);
    let before = start(&bar, &params(&bar, 12));
    let fix = Edit::Fix { vertices: bar.tip.clone() };
    let method = Method::FromScratch;
    // In one request or in three: the same body.
    let at_once = next(&before, &[fix.clone(), close(deep), close(shallow)], method);
    assert_eq!(at_once.closings().len(), 2);
    let edits: Vec<usize> = at_once.closings().iter().map(|report| report.edit).collect();
    assert_eq!(edits, [1, 2]);
    let first = next(&before, &[fix], method);
    let in_turn = next(&next(&first, &[close(deep)], method), &[close(shallow)], method);
    assert_eq!(in_turn.mesh().vertices(), at_once.mesh().vertices());
    assert_eq!(in_turn.stitches(), at_once.stitches());
    let error = spectrum_error(in_turn.eigenvalues_per_s2(), at_once.eigenvalues_per_s2());
    assert!(error < 1e-10, "{error:e}");
    assert_stitched(&in_turn, &bar.pairs);
    // The fixed vertices are where they were.
    for &v in bar.root.iter().chain(&bar.tip) {
        assert_eq!(in_turn.mesh().vertices()[v as usize], bar.mesh.vertices()[v as usize]);
    }
    // Whatever follows is no closing.
    let after = next(&in_turn, &[Edit::UnstitchAll], method);
    assert!(after.closings().is_empty());
}

#[test]
fn the_number_of_threads_does_not_move_a_vertex() {
    let bar = gaping(0.012);
    let with = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| {
            let body = start(&bar, &params(&bar, 4));
            next(&body, &[close(&bar.pairs)], Method::Flexibility).mesh().vertices().to_vec()
        })
    };
    assert!(with(1) == with(3));
}

#[test]
fn what_cannot_be_closed_is_refused_with_the_gap_that_remains() {
    let bar = bar(Cut::Whole);
    // The two ends are held; vertices beside them can come nearer, but never meet.
    let fixed_vertices = [&bar.root[..], &bar.tip].concat();
    let body = start(&bar, &BuildParams { fixed_vertices, ..params(&bar, 4) });
    let beside = |x: f64| {
        let near = |v: &[f64; 3]| (Vector3::from(*v) - Vector3::new(x, 0.025, 0.025)).norm() < 1e-9;
        bar.mesh.vertices().iter().position(near).unwrap() as u32
    };
    let step = 0.2 / 12.0;
    let far = [beside(step), beside(0.2 - step)];
    match refused(&body, &[Edit::UnstitchAll, close(&[far])]) {
        EditError::NotClosed { edit: 1, pair: 0, a, b, gap_m, allowed_m, reason } => {
            assert_eq!([a, b], far);
            assert!(allowed_m < gap_m && gap_m < 0.2 - 2.0 * step, "{gap_m:e}");
            assert!(!reason.is_empty());
        }
        other => panic!("{other}"),
    }
    // Two fixed vertices.
    let (a, b) = (bar.root[0], bar.tip[0]);
    match refused(&body, &[close(&[[a, b]])]) {
        EditError::NotClosed { gap_m, .. } => assert!((gap_m - 0.2).abs() < 1e-12),
        other => panic!("{other}"),
    }
    let with = |pairs: Vec<[u32; 2]>, stiffness_n_m, max_gap_m| {
        refused(&body, &[Edit::Close { pairs, stiffness_n_m, max_gap_m }])
    };
    for gap in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = with(vec![far], STITCH_N_M, Some(gap));
        assert!(matches!(error, EditError::MaxGap { edit: 0, .. }), "{error}");
    }
    let kind = EditKind::Close;
    let [c, d] = far;
    assert!(matches!(with(vec![far], 0.0, None), EditError::Stiffness { edit: 0, .. }));
    assert_eq!(
        with(vec![[c, c]], STITCH_N_M, None),
        EditError::SameVertex { edit: 0, kind, pair: 0, vertex: c }
    );
    assert_eq!(
        with(vec![far, [d, c]], STITCH_N_M, None),
        EditError::AlreadyStitched { edit: 0, kind, pair: 1, a: d, b: c }
    );
    assert!(matches!(
        with(vec![[c, 99_999]], STITCH_N_M, None),
        EditError::VertexOutOfRange { edit: 0, kind: EditKind::Close, position: 0, .. }
    ));
    assert_eq!(body.mesh().vertices(), bar.mesh.vertices());
}
