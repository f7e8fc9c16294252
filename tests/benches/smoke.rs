//! `paper_table` on the smallest body, once and in this process: every part runs, every check holds,
//! and a wrong answer is noticed.

mod accuracy;
mod accuracy_report;
mod bodies;
mod chart;
mod clock;
mod cubature;
mod edits;
mod figures;
mod kernels;
mod loads;
mod measure;
mod paper;
mod peers;
mod pictures;
mod references;
mod report;
mod results;
mod scaling;
mod session;

use figures::{Figure, Scene};
use peers::{Eigsh, PeerBody, PeerSession, Peers, Solver, Target};
use results::{Plan, Results};
use std::collections::BTreeMap;
use std::path::Path;

fn plan() -> Plan {
    let own = bodies::default_directory();
    Plan {
        references: Some(own.join("reference")),
        meshes: own,
        bodies: vec!["fork_small".into()],
        repeat: 1,
        most_stitches: 5,
        most_cube_vertices: 5000,
        compares_cubature: false,
        is_apart: false,
    }
}

/// A peer that does exactly as we did.
fn mirror(results: &Results) -> Peers {
    let mirrored = |body: &results::BodyResults| {
        let kernels = &body.kernels;
        let solve = |columns: usize| kernels.solves.iter().find(|s| s.columns == columns).unwrap();
        PeerBody {
            n_free_dofs: kernels.n_free_dofs,
            assembly_s: vec![kernels.assembly.median_s],
            pardiso: Solver {
                settings: String::new(),
                analysis_s: vec![kernels.factorization.median_s - kernels.numeric.median_s],
                numeric_s: vec![kernels.numeric.median_s],
                solve_1_s: vec![solve(1).times.median_s],
                solve_32_s: vec![solve(32).times.median_s],
                factor_nonzeros: kernels.factor_bytes as f64 / 8.0,
                backward_error: 0.0,
            },
            cholmod: None,
            eigsh: Eigsh {
                n_modes: kernels.n_modes,
                seconds: vec![kernels.modes.median_s],
                frequencies_hz: kernels.frequencies_hz.clone(),
                inverse_residual: 0.0,
                residual: kernels.residual,
            },
            session: Some(PeerSession {
                seconds: vec![body.sessions_of_tets.total.median_s],
                stages_s: BTreeMap::new(),
                cubature_error: 0.0,
                n_cubature_points: 120,
            }),
        }
    };
    let bodies = results.bodies.iter().map(|body| (body.name.clone(), mirrored(body))).collect();
    Peers { description: "a mirror".into(), bodies }
}

#[test]
fn every_part_runs_and_a_wrong_answer_is_noticed() {
    let mut results = plan().run(None, Path::new("")).unwrap();
    let wrong = results.wrong();
    assert!(wrong.is_empty(), "{wrong:?}");
    let n_checks = results.checks.len();
    assert!(n_checks > 20, "{n_checks} checks");

    results.judge(Some(mirror(&results)));
    assert!(results.wrong().is_empty());
    let against_peers = results.ratios.iter().filter(|ratio| {
        ratio.body == "fork_small"
            && !["peak memory", "residual", "session build, smoothed"]
                .iter()
                .any(|start| ratio.work.starts_with(start))
    });
    let mut n_ratios = 0;
    for ratio in against_peers {
        assert!((ratio.value - 1.0).abs() < 1e-12, "{}: {}", ratio.work, ratio.value);
        let met = match ratio.target {
            Target::AtMost(limit) => Some(limit >= 1.0),
            Target::AtLeast(limit) => Some(limit <= 1.0),
            Target::Within(_) | Target::None => None,
        };
        assert_eq!(ratio.is_met(), met, "{}", ratio.work);
        n_ratios += 1;
    }
    assert_eq!(n_ratios, 6);

    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("paper_table");
    std::fs::create_dir_all(&directory).unwrap();
    let pictures = pictures::draw(&results, &directory).unwrap();
    assert_eq!(pictures.len(), 3);
    let text = report::markdown(&results, &pictures);
    assert!(text.contains("Table 1 (a)") && !text.contains("NaN"), "{text}");

    let mut peers = mirror(&results);
    peers.bodies.get_mut("fork_small").unwrap().eigsh.frequencies_hz[3] *= 1.0 + 1e-5;
    let path = directory.join("peers.json");
    std::fs::write(&path, serde_json::to_vec(&peers).unwrap()).unwrap();
    results.judge(Some(Peers::load(&path).unwrap()));
    assert_eq!(results.wrong().len(), 1);
}

#[test]
fn the_accuracy_of_a_rebuilt_basis_is_told() {
    let results = Plan { most_stitches: usize::MAX, ..plan() }.run_accuracy().unwrap();
    let wrong = results.wrong();
    assert!(wrong.is_empty(), "{wrong:?}");
    let body = &results.bodies[0];
    assert_eq!((body.qualities.len(), body.loads.len()), (5, 2 * loads::N_LOADS));
    assert!(body.loads.iter().all(|load| load.nonlinearity > 1e-3), "{:?}", body.loads);
    let [exact, flexibility, .., low_rank, original] = &body.qualities[..] else {
        panic!("{} ways", body.qualities.len())
    };
    assert!(exact.worst_eigenvalue_errors() == [0.0, 0.0] && exact.basis_angles[2] < 1e-6);
    for kind in loads::Kind::ALL {
        let errors = [exact, flexibility, low_rank, original].map(|way| way.static_error(kind));
        // What a subspace of this size leaves, and what one that knows nothing of the stitches does.
        assert!(errors[0] > 1e-5 && errors[0] < 0.2, "{kind:?} {errors:?}");
        assert!(errors[1] < errors[2] && errors[1] < errors[3], "{kind:?} {errors:?}");
    }
    assert_eq!(results.targets.len(), 8);

    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("accuracy");
    std::fs::create_dir_all(&directory).unwrap();
    let pictures = pictures::draw_accuracy(&results, &directory).unwrap();
    let text = accuracy_report::markdown(&results, &pictures);
    assert!(text.contains("Static solutions") && !text.contains("NaN"), "{text}");

    // An edit of a part of the seam.
    let most_stitches = results.bodies[0].n_pairs / 2;
    let part = Plan { most_stitches, ..plan() }.run_accuracy().unwrap();
    assert_eq!(part.bodies[0].n_stitches, most_stitches);
    let wrong = part.wrong();
    assert!(wrong.is_empty(), "{wrong:?}");
    let [_, _, prepared, ..] = &part.bodies[0].qualities[..] else { panic!("no edit in a seam") };
    assert!(prepared.worst_eigenvalue_errors()[0] < 1e-4);

    // A spectrum that is not the stitched body's, and a truth that is none, are noticed.
    let mut bodies = results.bodies;
    bodies[0].qualities[1].eigenvalue_errors[0] = 1e-3;
    bodies[0].loads[0].residual = 1e-3;
    let residuals = loads::checks(&bodies[0].loads[0]);
    assert!(!residuals[0].holds() && residuals[1].holds());
    let spoilt = accuracy::Accuracies::of(bodies);
    assert_eq!(spoilt.targets[0].is_met(), Some(false));
}

#[test]
fn figures_show_what_they_are_about() {
    let out = tempfile::tempdir().unwrap();
    let made = |figure: Figure| -> serde_json::Value {
        let body = bodies::Body::load(&bodies::default_directory(), figure.body(true)).unwrap();
        let scene = Scene::new(figure, &body, 40, out.path());
        assert!(figure.show(&scene).unwrap().contains(&body.name));
        let number = figure.number();
        let data = std::fs::read(out.path().join(format!("figure_{number}.json"))).unwrap();
        serde_json::from_slice(&data).unwrap()
    };
    let reaches = |data: &serde_json::Value| -> Vec<f64> {
        let all: Vec<Vec<f64>> =
            serde_json::from_value(data["largest_displacement_m"].clone()).unwrap();
        all.iter().map(|of_basis| of_basis.iter().copied().fold(0.0, f64::max)).collect()
    };
    // Kept, rebuilt, from scratch: the first locks, the second moves as the last does.
    for figure in [Figure::Locking, Figure::RigidMotion] {
        let [kept, rebuilt, scratch] = reaches(&made(figure))[..] else { panic!("three bases") };
        assert!(kept < 0.5 * scratch, "{figure:?}: {kept} of {scratch}");
        assert!((rebuilt / scratch - 1.0).abs() < 0.05, "{figure:?}: {rebuilt} of {scratch}");
    }
    // Obstacles let nothing in that would otherwise be there.
    let collisions = made(Figure::Collisions);
    let deepest = |name: &str| {
        let depths: Vec<f64> = serde_json::from_value(collisions[name].clone()).unwrap();
        depths.into_iter().fold(0.0, f64::max)
    };
    assert!(deepest("depth_m") < 0.3 * deepest("depth_without_m"));
    let pictures = std::fs::read_dir(out.path()).unwrap().filter(|file| {
        file.as_ref().unwrap().path().extension().is_some_and(|extension| extension == "png")
    });
    assert_eq!(pictures.count(), 9);
}
