//! From one generation to the next: determinism, the transfer of a state, the delta of a basis.

use crate::bodies::{STITCH_N_M, bar, by, by_rows, column, params, stitch, vector};
use faer::Mat;
use std::sync::Arc;
use sutura_core::build::{self, Artifacts, BuildParams, CubatureParams, Method, Selection};
use sutura_core::control::Uncontrolled;
use sutura_core::linalg;
use sutura_core::testing::Cut;

fn two_generations(cut: Cut, basis_size: usize, method: Method) -> [Artifacts; 2] {
    let bar = bar(cut);
    let cubature = Some(CubatureParams {
        n_points: 60,
        n_training_poses: 20,
        tolerance: 0.05,
        seed: 3,
        selection: Selection::GreedyNnls,
        smoothing: true,
    });
    let params = BuildParams { basis_size, cubature, ..params(&bar, 10) };
    let before = build::build(bar.mesh.clone(), &params, &Uncontrolled).unwrap();
    let edit = stitch(&bar.pairs, STITCH_N_M);
    let after = build::rebuild(&before, &edit, &by(method), &Uncontrolled).unwrap().0;
    [before, after]
}

fn bits(body: &Artifacts) -> Vec<u64> {
    let tables = body.evaluator_tables();
    let columns = (0..body.basis_size()).flat_map(|i| body.basis_column(i));
    let modes = (0..body.n_modes()).flat_map(|i| body.mode(i));
    body.eigenvalues_per_s2()
        .iter()
        .chain(body.residuals())
        .copied()
        .chain(columns)
        .chain(modes)
        .chain(tables.weights)
        .chain(tables.basis_rows)
        .chain(tables.stitch_stiffness)
        .map(f64::to_bits)
        .chain(tables.tets.iter().map(|&t| u64::from(t)))
        .collect()
}

#[test]
fn the_same_requests_give_the_same_bits() {
    for method in [Method::Flexibility, Method::LowRank, Method::FromScratch] {
        let [a, b] = [(); 2].map(|()| two_generations(Cut::HalfDepth, 14, method));
        for (a, b) in a.iter().zip(&b) {
            assert!(bits(a) == bits(b), "{method:?}");
        }
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let with = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| two_generations(Cut::HalfDepth, 14, Method::Flexibility))
    };
    for (a, b) in with(1).iter().zip(&with(3)) {
        assert!(bits(a) == bits(b));
    }
}

#[test]
fn transfer_is_the_mass_projection_and_the_identity_on_itself() {
    let [old, new] = two_generations(Cut::HalfDepth, 14, Method::Flexibility);
    let r = old.basis_size();
    let identity = by_rows(&old.transfer_from(&old), r);
    assert!(linalg::distance_from_identity(identity.as_ref()) < 1e-10);

    let transfer = by_rows(&new.transfer_from(&old), r);
    let q_old = vector(r, 1.0, 1.0);
    let q_new = linalg::product(transfer.as_ref(), column(&q_old));
    let jump =
        linalg::product(new.basis(), q_new.as_ref()) - linalg::product(old.basis(), column(&q_old));
    let model = new.full_model();
    let mass = model.mass(new.params().mass, &Arc::new(model.pattern(&[])));
    // What is lost is orthogonal to all that the new basis can represent: nothing could be nearer.
    let left = mass.inner(new.basis(), jump.as_ref());
    assert!(left.norm_max() < 1e-10);
}

#[test]
fn a_state_that_the_new_basis_can_represent_is_carried_over_exactly() {
    let [old, new] = two_generations(Cut::HalfDepth, 14, Method::Flexibility);
    // What the new basis holds of a state comes back unchanged from a round trip.
    let to_new = by_rows(&new.transfer_from(&old), old.basis_size());
    let to_old = by_rows(&old.transfer_from(&new), new.basis_size());
    assert!((&to_new - to_old.transpose()).norm_max() < 1e-12);
    let round = linalg::small_product(to_new.transpose(), to_new.as_ref());
    let (cosines_squared, vectors) = linalg::symmetric_eigen(round.as_ref()).unwrap();
    // Principal directions common to both spans, if the smallest angle is nearly zero.
    let last = cosines_squared.len() - 1;
    assert!(cosines_squared[last] > 0.999, "{cosines_squared:?}");
    assert!(cosines_squared.iter().all(|c| *c < 1.0 + 1e-10));
    let q = vectors.subcols(last, 1);
    let carried = linalg::small_product(to_new.as_ref(), q);
    let jump = linalg::product(new.basis(), carried.as_ref()) - linalg::product(old.basis(), q);
    let model = new.full_model();
    let mass = model.mass(new.params().mass, &Arc::new(model.pattern(&[])));
    let squared = mass.gram(jump.as_ref())[(0, 0)];
    assert!((squared - (1.0 - cosines_squared[last])).abs() < 1e-10);
}

#[test]
fn delta_and_the_old_basis_make_the_new_one() {
    for cut in [Cut::HalfDepth, Cut::Through] {
        for method in [Method::Flexibility, Method::FromScratch] {
            let [old, new] = two_generations(cut, 14, method);
            let delta = new.delta_from(&old).unwrap();
            let model = new.full_model();
            let free = |column: &[f64], i: usize| {
                column[3 * model.free_vertices()[i / 3] as usize + i % 3]
            };
            let columns =
                Mat::from_fn(model.n(), delta.columns.len(), |i, j| free(&delta.columns[j], i));
            let dictionary = linalg::concatenate(&[old.basis(), columns.as_ref()]);
            assert_eq!(delta.w.len(), dictionary.ncols() * new.basis_size());
            let w = by_rows(&delta.w, new.basis_size());
            let gap = linalg::product(dictionary.as_ref(), w.as_ref()) - new.basis();
            let error = gap.norm_max() / new.basis().norm_max();
            assert!(error < 1e-6, "{cut:?} {method:?}: {error:e}");
            assert!(delta.columns.len() <= new.basis_size());
        }
    }
    let [old, _] = two_generations(Cut::HalfDepth, 14, Method::Flexibility);
    assert!(old.delta_from(&old).unwrap().columns.is_empty());
}
