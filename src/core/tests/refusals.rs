//! What a build and a rebuild refuse, and that they can be stopped.

use crate::bodies::{STITCH_N_M, bar, by, params, soft, stitch};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use sutura_core::build::{
    self, Artifacts, BuildError, BuildParams, CubatureParams, MassKind, Method, RayleighDamping,
    RebuildParams, Selection,
};
use sutura_core::control::{Control, Stage, Uncontrolled};
use sutura_core::edit::{Edit, EditError, EditKind};
use sutura_core::material::Material;
use sutura_core::mesh::TetMesh;
use sutura_core::testing::{Bar, BarMesh, Cell, Cut};

fn refused(bar: &BarMesh, change: impl Fn(&mut BuildParams)) -> BuildError {
    let mut params = params(bar, 4);
    change(&mut params);
    build::build(bar.mesh.clone(), &params, &Uncontrolled).expect_err("refused")
}

const CUBATURE: CubatureParams = CubatureParams {
    n_points: 20,
    n_training_poses: 10,
    tolerance: 0.05,
    seed: 1,
    selection: Selection::GreedyNnls,
    smoothing: true,
};

#[test]
fn parameters_of_a_build_are_checked() {
    let bar = bar(Cut::HalfDepth);
    let n = bar.mesh.vertices().len();
    assert!(matches!(
        refused(&bar, |p| p.fixed_vertices.insert(1, 9999)),
        BuildError::FixedVertexOutOfRange { position: 1, vertex: 9999, n_vertices } if n_vertices == n
    ));
    assert!(matches!(
        refused(&bar, |p| p.fixed_vertices = (0..n as u32).collect()),
        BuildError::NothingFree
    ));
    for materials in [vec![], vec![soft(), soft()]] {
        let given = materials.len();
        assert!(matches!(
            refused(&bar, |p| p.materials = materials.clone()),
            BuildError::MaterialCount { given: g, n_domains: 1 } if g == given
        ));
    }
    type Change = fn(&mut BuildParams);
    let out_of_range: [(&str, Change); 5] = [
        ("n_modes", |p| p.n_modes = 0),
        ("basis.size", |p| p.basis_size = 0),
        ("basis.n_derivative_modes", |p| p.n_derivative_modes = 5),
        ("cubature.n_points", |p| p.cubature = Some(CubatureParams { n_points: 0, ..CUBATURE })),
        ("cubature.n_training_poses", |p| {
            p.cubature = Some(CubatureParams { n_training_poses: 0, ..CUBATURE });
        }),
    ];
    for (expected, change) in out_of_range {
        let error = refused(&bar, change);
        assert!(
            matches!(error, BuildError::OutOfRange { name, .. } if name == expected),
            "{error}"
        );
    }
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let error = refused(&bar, |p| p.damping.mass_per_s = bad);
        assert!(matches!(error, BuildError::BadParameter { name, .. } if name.contains("mass")));
        let error = refused(&bar, |p| p.damping.stiffness_s = bad);
        assert!(
            matches!(error, BuildError::BadParameter { name, .. } if name.contains("stiffness"))
        );
    }
    for bad in [0.0, 1.0, f64::NAN] {
        let cubature = CubatureParams { tolerance: bad, ..CUBATURE };
        let error = refused(&bar, |p| p.cubature = Some(cubature));
        assert!(matches!(error, BuildError::BadParameter { name: "cubature.tolerance", .. }));
    }
    let error = refused(&bar, |p| p.seams = vec![bar.pairs[0], [0, 1]]);
    assert!(matches!(error, BuildError::Seam(EditError::Apart { pair: 1, a: 0, b: 1, .. })));
}

#[test]
fn edits_are_checked_and_a_refused_one_changes_nothing() {
    // One half is held at both ends of a seam as well, and one vertex belongs to no tet.
    let bar = bar(Cut::Through);
    let mut vertices = bar.mesh.vertices().to_vec();
    let unused = vertices.len() as u32;
    vertices.push(vertices[0]);
    let mesh = TetMesh::new(vertices, bar.mesh.tets().to_vec(), Vec::new()).unwrap();
    let mut params = params(&bar, 4);
    params.fixed_vertices.extend(bar.pairs[0]);
    let built = build::build(Arc::new(mesh), &params, &Uncontrolled).unwrap();
    assert!(built.warnings().iter().any(|w| w.contains(&unused.to_string())));
    let (body, ids) = build::rebuild(
        &built,
        &stitch(&bar.pairs[1..3], STITCH_N_M),
        &by(Method::Flexibility),
        &Uncontrolled,
    )
    .unwrap();

    let good = bar.pairs[4];
    let attempt = |edits: &[Edit]| match build::rebuild(
        &body,
        edits,
        &by(Method::Flexibility),
        &Uncontrolled,
    ) {
        Err(BuildError::Edit(error)) => error,
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("accepted"),
    };
    let pairs = |pair: [u32; 2]| attempt(&stitch(&[good, pair], STITCH_N_M));
    let [a, b] = bar.pairs[5];
    assert!(matches!(
        pairs([a, 99_999]),
        EditError::VertexOutOfRange { edit: 0, position: 1, vertex: 99_999, .. }
    ));
    assert!(
        matches!(pairs([0, unused]), EditError::UnusedVertex { position: 1, vertex, .. } if vertex == unused)
    );
    assert!(matches!(pairs([a, a]), EditError::SameVertex { pair: 1, .. }));
    assert!(matches!(pairs([a, b + 1]), EditError::Apart { pair: 1, .. }));
    assert!(matches!(pairs(bar.pairs[0]), EditError::BothFixed { pair: 1, .. }));
    assert!(matches!(pairs(good), EditError::AlreadyStitched { pair: 1, .. }));
    let [c, d] = bar.pairs[1];
    assert!(matches!(pairs([d, c]), EditError::AlreadyStitched { pair: 1, .. }));
    for stiffness in [0.0, -1.0, 1e13, 1e-10, f64::NAN, f64::INFINITY] {
        let error = attempt(&stitch(&[good], stiffness));
        assert!(matches!(error, EditError::Stiffness { edit: 0, .. }), "{stiffness}");
    }
    let error = attempt(&[
        Edit::Unstitch { stitch_ids: vec![ids[0]] },
        Edit::Unstitch { stitch_ids: vec![ids[1], ids[0]] },
    ]);
    let kind = EditKind::Unstitch;
    assert_eq!(error, EditError::UnknownStitch { edit: 1, kind, position: 1, id: ids[0] });
    let soften = |id, stiffness_n_m| [Edit::SetStiffness { stitch_ids: vec![id], stiffness_n_m }];
    let kind = EditKind::SetStiffness;
    let error = attempt(&soften(99, 1.0));
    assert_eq!(error, EditError::UnknownStitch { edit: 0, kind, position: 0, id: 99 });
    for stiffness in [0.0, -1.0, 1e15, 1e-12, f64::NAN] {
        let error = attempt(&soften(ids[0], stiffness));
        assert!(matches!(error, EditError::Stiffness { edit: 0, .. }), "{stiffness}");
    }
    let error = attempt(&[Edit::UnstitchAll, Edit::Unstitch { stitch_ids: vec![ids[0]] }]);
    assert!(matches!(error, EditError::UnknownStitch { edit: 1, .. }));
    assert_eq!(body.stitches().len(), 2);

    for tolerance in [0.0, 1.0, -1.0, f64::NAN] {
        let params = RebuildParams::new(Method::Flexibility, tolerance);
        let error = build::rebuild(&body, &[], &params, &Uncontrolled).unwrap_err();
        assert!(matches!(error, BuildError::BadParameter { name: "tolerance", .. }));
    }
    // Names are never used twice, whatever became of their stitches.
    let edits = [
        Edit::Unstitch { stitch_ids: ids.clone() },
        stitch(&[c, d].map(|_| [c, d])[..1], 1.0).remove(0),
    ];
    let (_, new) = build::rebuild(&body, &edits, &by(Method::Flexibility), &Uncontrolled).unwrap();
    assert!(new.iter().all(|id| !ids.contains(id)));
}

/// Cancels at the `limit`-th question.
struct Stops {
    asked: AtomicUsize,
    limit: usize,
}

impl Stops {
    fn at(limit: usize) -> Stops {
        Stops { asked: AtomicUsize::new(0), limit }
    }
}

impl Control for Stops {
    fn is_cancelled(&self) -> bool {
        self.asked.fetch_add(1, Ordering::Relaxed) >= self.limit
    }
    fn progress(&self, _stage: Stage, fraction: f64) {
        assert!((0.0..=1.0).contains(&fraction), "{fraction}");
    }
    fn now(&self) -> Duration {
        Duration::ZERO
    }
}

/// Runs `job` with a control that stops it at its first question, its second, its fourth and so on:
/// each time it must end as cancelled, until it is through before it is asked to stop.
fn stops_wherever_it_is_asked(job: impl Fn(&Stops) -> Result<(), BuildError>) {
    let mut limit = 0;
    loop {
        let control = Stops::at(limit);
        match job(&control) {
            Err(BuildError::Cancelled(_)) => assert!(control.asked.into_inner() > limit),
            Err(other) => panic!("{other}"),
            Ok(()) => {
                assert!(control.asked.into_inner() <= limit, "went on after question {limit}");
                assert!(limit > 8, "it asks seldom: {limit}");
                return;
            }
        }
        limit = (limit + 1).max(limit * 3 / 2);
    }
}

#[test]
fn a_build_and_a_rebuild_stop_wherever_they_are_asked_to() {
    let bar =
        Bar { size_m: [0.2, 0.05, 0.05], n_cells: [6, 2, 2], cell: Cell::Six, cut: Cut::HalfDepth }
            .mesh();
    let params = BuildParams { cubature: Some(CUBATURE), ..params(&bar, 6) };
    let start = |control: &dyn Control| build::build(bar.mesh.clone(), &params, control);
    stops_wherever_it_is_asked(|control| start(control).map(drop));
    let built = start(&Uncontrolled).unwrap();
    let edit = stitch(&bar.pairs, STITCH_N_M);
    // The same incision, gaping.
    let edit_closing =
        [Edit::Close { pairs: vec![bar.pairs[1]], stiffness_n_m: STITCH_N_M, max_gap_m: None }];
    let vertices = bar.mesh.vertices().iter().enumerate().map(|(v, x)| {
        let is_moved = bar.pairs.iter().any(|pair| pair[1] as usize == v);
        if is_moved { [x[0] + 0.004, x[1], x[2]] } else { *x }
    });
    let open = TetMesh::new(vertices.collect(), bar.mesh.tets().to_vec(), Vec::new()).unwrap();
    let open = build::build(Arc::new(open), &params, &Uncontrolled).unwrap();
    stops_wherever_it_is_asked(|control| {
        build::rebuild(&open, &edit_closing, &by(Method::Flexibility), control).map(drop)
    });
    for method in [Method::Flexibility, Method::LowRank, Method::FromScratch] {
        stops_wherever_it_is_asked(|control| {
            build::rebuild(&built, &edit, &by(method), control).map(drop)
        });
    }
}

fn is_finite(body: &Artifacts) -> bool {
    let q = vec![1e-3; body.basis_size()];
    let at = body.model().evaluate(&q);
    body.eigenvalues_per_s2().iter().all(|x| x.is_finite() && *x > 0.0)
        && (0..body.basis_size()).all(|i| body.basis_column(i).iter().all(|x| x.is_finite()))
        && at.energy_j.is_finite()
        && at.force.iter().chain(&at.stiffness).all(|x| x.is_finite())
}

/// A build that succeeds is finite; one that cannot says so. Neither may panic.
fn finite_or_refused(mesh: Arc<TetMesh>, params: &BuildParams) -> Result<(), String> {
    match build::build(mesh, params, &Uncontrolled) {
        Ok(body) => {
            assert!(is_finite(&body), "{params:?}");
            Ok(())
        }
        Err(error) => Err(error.to_string()),
    }
}

#[test]
fn extreme_bodies_are_finite_or_refused() {
    let small = |size: f64| {
        let size_m = [2.0, 1.0, 1.0].map(|x| x * size);
        Bar { size_m, n_cells: [2, 1, 1], cell: Cell::Five, cut: Cut::Whole }.mesh()
    };
    let mut n_built = 0;
    for (e, rho) in [(1e-6, 1e3), (1e12, 1e-3), (1e-12, 1e12), (1e5, 1e3)] {
        for nu in [-0.9, 0.0, 0.4999] {
            for size in [1e-6, 1.0, 1e6] {
                for held in [true, false] {
                    let bar = small(size);
                    let params = BuildParams {
                        materials: vec![Material::stvk(e, nu, rho).unwrap()],
                        fixed_vertices: if held { bar.root.clone() } else { vec![] },
                        cubature: Some(CUBATURE),
                        ..params(&bar, 4)
                    };
                    n_built += usize::from(finite_or_refused(bar.mesh.clone(), &params).is_ok());
                }
            }
        }
    }
    assert!(n_built > 60, "only {n_built} of 72 bodies could be built");
    // The ends of what materials may be.
    for (e, rho) in [(1e30, 1e-30), (1e-30, 1e30), (1e30, 1e30), (1e-30, 1e-30)] {
        let bar = small(1.0);
        let materials = vec![Material::stvk(e, 0.3, rho).unwrap()];
        let params = BuildParams { materials, cubature: Some(CUBATURE), ..params(&bar, 4) };
        let _ = finite_or_refused(bar.mesh.clone(), &params);
    }
}

#[test]
fn more_modes_than_degrees_of_freedom_give_as_many_as_there_are() {
    let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mesh = Arc::new(TetMesh::new(vertices, vec![[0, 1, 2, 3]], Vec::new()).unwrap());
    for (fixed, n_modes) in [(vec![0, 1, 2], 3), (vec![], 6)] {
        for mass in [MassKind::Lumped, MassKind::Consistent] {
            let params = BuildParams {
                materials: vec![soft()],
                tet_stiffness: [].into(),
                fixed_vertices: fixed.clone(),
                mass,
                n_modes: 50,
                basis_size: 50,
                pca: Default::default(),
                n_derivative_modes: 50,
                cubature: Some(CUBATURE),
                damping: RayleighDamping { mass_per_s: 0.0, stiffness_s: 0.0 },
                seams: Vec::new(),
            };
            let built = build::build(mesh.clone(), &params, &Uncontrolled).unwrap();
            assert_eq!(built.n_modes(), n_modes, "{fixed:?} {mass:?}");
            assert!(built.warnings().iter().any(|w| w.contains("modes")));
            assert!(is_finite(&built));
        }
    }
}

#[test]
fn a_tet_that_ruins_the_stiffness_is_named_or_survived() {
    // A sliver just above the limit of flatness: its stiffness is 1e12 times its neighbours'.
    let bar = bar(Cut::Whole);
    let mut vertices = bar.mesh.vertices().to_vec();
    let mut tets = bar.mesh.tets().to_vec();
    let [a, b, c] = [tets[0][0], tets[0][1], tets[0][2]];
    let [x, y, z] = [a, b, c].map(|v| vertices[v as usize]);
    let centre: [f64; 3] = std::array::from_fn(|i| (x[i] + y[i] + z[i]) / 3.0);
    let normal = (nalgebra::Vector3::from(y) - nalgebra::Vector3::from(x))
        .cross(&(nalgebra::Vector3::from(z) - nalgebra::Vector3::from(x)))
        .normalize();
    let apex = vertices.len() as u32;
    vertices.push(std::array::from_fn(|i| centre[i] + 1e-12 * normal[i]));
    tets.push([a, b, c, apex]);
    let mesh = match TetMesh::new(vertices.clone(), tets.clone(), Vec::new()) {
        Ok(mesh) => mesh,
        Err(_) => {
            let last = tets.len() - 1;
            tets[last].swap(0, 1);
            TetMesh::new(vertices, tets, Vec::new()).unwrap()
        }
    };
    match build::build(Arc::new(mesh), &params(&bar, 4), &Uncontrolled) {
        Ok(built) => assert!(is_finite(&built)),
        Err(error) => assert!(
            matches!(error, BuildError::NonPositivePivot { .. } | BuildError::NotConverged { .. }),
            "{error}"
        ),
    }
}
