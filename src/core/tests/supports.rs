//! Vertices fixed and released: a body edited so is the body built so.

use crate::bodies::{STITCH_N_M, bar, by, by_rows, column, params, spectrum_error, stitch, vector};
use faer::Mat;
use sutura_core::build::{self, Artifacts, BuildError, BuildParams, MassKind, Method};
use sutura_core::build::{CubatureParams, RebuildParams, Selection};
use sutura_core::control::{Stage, Uncontrolled};
use sutura_core::edit::{Edit, EditError, EditKind};
use sutura_core::linalg;
use sutura_core::mesh::TetMesh;
use sutura_core::testing::{BarMesh, Cut};

const METHODS: [Method; 2] = [Method::Flexibility, Method::FromScratch];

fn start(bar: &BarMesh, params: &BuildParams) -> Artifacts {
    build::build(bar.mesh.clone(), params, &Uncontrolled).unwrap()
}

fn next(previous: &Artifacts, edits: &[Edit], method: Method) -> Artifacts {
    let params = RebuildParams { tolerance: 1e-11, ..by(method) };
    build::rebuild(previous, edits, &params, &Uncontrolled).unwrap().0
}

fn fix(vertices: &[u32]) -> Edit {
    Edit::Fix { vertices: vertices.to_vec() }
}

fn release(vertices: &[u32]) -> Edit {
    Edit::Release { vertices: vertices.to_vec() }
}

/// Neither a factor nor an ordering was made for it.
fn was_prepared(body: &Artifacts) -> bool {
    !body.timings().iter().any(|(stage, _)| *stage == Stage::Factorization)
}

#[test]
fn a_body_with_vertices_fixed_is_as_one_built_so() {
    for cut in [Cut::HalfDepth, Cut::Through] {
        let bar = bar(cut);
        let before = start(&bar, &params(&bar, 12));
        let fixed_vertices = [&bar.root[..], &bar.tip].concat();
        let built = start(&bar, &BuildParams { fixed_vertices, ..params(&bar, 12) });
        assert_eq!(built.n_rigid_modes(), 0);
        for method in METHODS {
            let fixed = next(&before, &[fix(&bar.tip)], method);
            assert_eq!(fixed.fixed_vertices(), built.fixed_vertices());
            assert_eq!(fixed.n_free_dofs(), built.n_free_dofs());
            assert_eq!(fixed.n_rigid_modes(), 0);
            let error = spectrum_error(fixed.eigenvalues_per_s2(), built.eigenvalues_per_s2());
            assert!(error < 1e-9, "{cut:?} {method:?}: {error:e}");
            for &vertex in &bar.tip {
                assert!(fixed.basis_rows(vertex).iter().flatten().all(|x| *x == 0.0));
            }

            // Stitched as well, in either order and at once.
            let closing = stitch(&bar.pairs, STITCH_N_M);
            let truth = next(&built, &closing, Method::FromScratch);
            let at_once = [&closing[..], &[fix(&bar.tip)]].concat();
            for (order, body) in [
                ("fixed, then stitched", next(&fixed, &closing, method)),
                ("stitched, then fixed", {
                    next(&next(&before, &closing, method), &[fix(&bar.tip)], method)
                }),
                ("at once", next(&before, &at_once, method)),
            ] {
                assert_eq!(body.stitches(), truth.stitches());
                let error = spectrum_error(
                    &body.eigenvalues_per_s2()[..6],
                    &truth.eigenvalues_per_s2()[..6],
                );
                assert!(error < 1e-9, "{cut:?} {method:?} {order}: {error:e}");
            }
        }
    }
}

#[test]
fn fixing_and_releasing_returns_the_spectrum_and_the_factorization() {
    for cut in [Cut::HalfDepth, Cut::Through] {
        let bar = bar(cut);
        let params = BuildParams { seams: bar.pairs.clone(), ..params(&bar, 12) };
        let before = start(&bar, &params);
        let stitched = next(&before, &stitch(&bar.pairs, STITCH_N_M), Method::Flexibility);
        for method in METHODS {
            let fixed = next(&stitched, &[fix(&bar.tip)], method);
            assert!(!was_prepared(&fixed));
            let back = next(&fixed, &[release(&bar.tip), Edit::UnstitchAll], method);
            assert_eq!(back.fixed_vertices(), before.fixed_vertices());
            assert_eq!(back.n_rigid_modes(), before.n_rigid_modes());
            let error = spectrum_error(back.eigenvalues_per_s2(), before.eigenvalues_per_s2());
            assert!(error < 1e-10, "{cut:?} {method:?}: {error:e}");
            assert_eq!(was_prepared(&back), method == Method::Flexibility);
            // And there again.
            let again = next(&back, &[fix(&bar.tip)], Method::Flexibility);
            assert!(was_prepared(&again));
        }
        // Once no generation keeps the first base body, there is nothing to find.
        let fixed = next(&stitched, &[fix(&bar.tip)], Method::Flexibility);
        let expected = before.eigenvalues_per_s2().to_vec();
        drop((before, stitched));
        let back = next(&fixed, &[release(&bar.tip), Edit::UnstitchAll], Method::Flexibility);
        assert!(!was_prepared(&back));
        let error = spectrum_error(back.eigenvalues_per_s2(), &expected);
        assert!(error < 1e-10, "{cut:?}: {error:e}");
    }
}

#[test]
fn a_body_released_everywhere_floats() {
    for (cut, n_components) in [(Cut::HalfDepth, 1), (Cut::Through, 2)] {
        let bar = bar(cut);
        let before = start(&bar, &params(&bar, 12));
        let free = start(&bar, &BuildParams { fixed_vertices: Vec::new(), ..params(&bar, 12) });
        for method in METHODS {
            let released = next(&before, &[release(&bar.root)], method);
            assert_eq!(released.n_rigid_modes(), 6 * n_components);
            let error = spectrum_error(released.eigenvalues_per_s2(), free.eigenvalues_per_s2());
            assert!(error < 1e-9, "{cut:?} {method:?}: {error:e}");
            let closed = next(&released, &stitch(&bar.pairs, STITCH_N_M), method);
            assert_eq!(closed.n_rigid_modes(), 6);
        }
    }
}

#[test]
fn a_stitch_between_fixed_vertices_waits_for_one_of_them_to_be_released() {
    let bar = bar(Cut::HalfDepth);
    // The seam's pairs become impossible, and possible again.
    let before = start(&bar, &BuildParams { seams: bar.pairs.clone(), ..params(&bar, 12) });
    let closing = stitch(&bar.pairs, STITCH_N_M);
    let both: Vec<u32> = bar.pairs.iter().flatten().copied().collect();
    let fixed_vertices = [&bar.root[..], &both].concat();
    let held = start(&bar, &BuildParams { fixed_vertices, ..params(&bar, 12) });
    for method in [Method::Flexibility, Method::FromScratch, Method::LowRank] {
        let stitched = next(&before, &closing, method);
        let fixed = next(&stitched, &[fix(&both)], method);
        assert_eq!(fixed.stitches(), stitched.stitches());
        let error = spectrum_error(fixed.eigenvalues_per_s2(), held.eigenvalues_per_s2());
        assert!(error < 1e-9, "{method:?}: {error:e}");
        let released = next(&fixed, &[release(&both)], method);
        let error = spectrum_error(released.eigenvalues_per_s2(), stitched.eigenvalues_per_s2());
        assert!(error < 1e-9, "{method:?}: {error:e}");
    }
}

#[test]
fn states_and_bases_cross_a_change_of_supports() {
    let bar = bar(Cut::HalfDepth);
    for mass in [MassKind::Lumped, MassKind::Consistent] {
        let cubature = Some(CubatureParams {
            n_points: 60,
            n_training_poses: 20,
            tolerance: 0.05,
            seed: 3,
            selection: Selection::GreedyNnls,
            smoothing: true,
        });
        let params = BuildParams { mass, basis_size: 14, cubature, ..params(&bar, 10) };
        let before = start(&bar, &params);
        let moved = [fix(&bar.tip), release(&bar.root[..3])];
        let after = next(&before, &moved, Method::Flexibility);
        assert!(after.cubature().is_some());
        let everywhere = after.full_model().mass_everywhere(mass);
        let all = |body: &Artifacts| {
            let columns: Vec<f64> =
                (0..body.basis_size()).flat_map(|j| body.basis_column(j)).collect();
            let n = columns.len() / body.basis_size();
            Mat::from_fn(n, body.basis_size(), |i, j| columns[j * n + i])
        };
        for (old, new) in [(&before, &after), (&after, &before)] {
            let (u_old, u_new) = (all(old), all(new));
            let gram = everywhere.gram(u_new.as_ref());
            assert!(linalg::distance_from_identity(gram.as_ref()) < 1e-10, "{mass:?}");

            let transfer = by_rows(&new.transfer_from(old), old.basis_size());
            let q_old = vector(old.basis_size(), 1.0, 1.0);
            let q_new = linalg::product(transfer.as_ref(), column(&q_old));
            let jump = linalg::product(u_new.as_ref(), q_new.as_ref())
                - linalg::product(u_old.as_ref(), column(&q_old));
            // Nothing that the new basis can represent comes nearer.
            let left = everywhere.inner(u_new.as_ref(), jump.as_ref());
            assert!(left.norm_max() < 1e-10, "{mass:?}");

            let delta = new.delta_from(old).unwrap();
            let n = u_old.nrows();
            let columns = Mat::from_fn(n, delta.columns.len(), |i, j| delta.columns[j][i]);
            let dictionary = linalg::concatenate(&[u_old.as_ref(), columns.as_ref()]);
            let w = by_rows(&delta.w, new.basis_size());
            let gap = linalg::product(dictionary.as_ref(), w.as_ref()) - &u_new;
            let error = gap.norm_max() / u_new.norm_max();
            assert!(error < 1e-6, "{mass:?}: {error:e}");
        }
        // The reduced model has the new supports too.
        let q = vector(after.basis_size(), 1e-4, 2.0);
        let load = after.vertex_load(bar.tip[0], [1.0; 3]);
        assert!(load.iter().all(|f| *f == 0.0));
        assert!(after.evaluate_exact(&q).energy_j > 0.0);
    }
}

#[test]
fn impossible_supports_are_refused_where_they_stand() {
    let bar = bar(Cut::HalfDepth);
    let mut vertices = bar.mesh.vertices().to_vec();
    let unused = vertices.len() as u32;
    vertices.push([1.0; 3]);
    let mesh = TetMesh::new(vertices, bar.mesh.tets().to_vec(), Vec::new()).unwrap();
    let body = build::build(mesh.into(), &params(&bar, 4), &Uncontrolled).unwrap();
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
    let (held, tip) = (bar.root[0], bar.tip[0]);
    let n_vertices = unused as usize + 1;
    for (make, kind) in [(fix as fn(&[u32]) -> Edit, EditKind::Fix), (release, EditKind::Release)] {
        let good = if kind == EditKind::Fix { tip } else { held };
        let vertex = 99_999;
        assert_eq!(
            attempt(&[Edit::UnstitchAll, make(&[good, vertex])]),
            EditError::VertexOutOfRange { edit: 1, kind, position: 1, vertex, n_vertices }
        );
        assert_eq!(
            attempt(&[make(&[unused])]),
            EditError::UnusedVertex { edit: 0, kind, position: 0, vertex: unused }
        );
    }
    let already = |position, vertex| EditError::AlreadyFixed { edit: 0, position, vertex };
    assert_eq!(attempt(&[fix(&[tip, held])]), already(1, held));
    assert_eq!(attempt(&[fix(&[tip, tip])]), already(1, tip));
    let not_fixed = |position, vertex| EditError::NotFixed { edit: 0, position, vertex };
    assert_eq!(attempt(&[release(&[tip])]), not_fixed(0, tip));
    assert_eq!(attempt(&[release(&[held, held])]), not_fixed(1, held));
    let free: Vec<u32> = (0..unused).filter(|v| !bar.root.contains(v)).collect();
    assert_eq!(attempt(&[Edit::UnstitchAll, fix(&free)]), EditError::NothingFree { edit: 1 });
    // What one edit fixes another of the same request may release.
    let params = by(Method::Flexibility);
    let edits = [fix(&free), release(&bar.tip)];
    let (tip_alone, _) = build::rebuild(&body, &edits, &params, &Uncontrolled).unwrap();
    assert_eq!(tip_alone.n_free_dofs(), 3 * bar.tip.len());
}
