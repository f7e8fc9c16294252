//! The arrays of a generation, checked against each other and against the evaluator.

use crate::bodies::{STIFFNESS_N_M, TIP, bar, config, prepared, ready_bar, seam, stitch};
use crate::daemon::Daemon;
use crate::plain_http::plain_http;
use reqwest::header;
use std::sync::atomic::{AtomicUsize, Ordering};
use sutura_client::proto::edit::{CubatureSource, Edit, EditMethod, EditRequest, Verdict};
use sutura_client::proto::evaluate::{Coordinates, EvaluateReply, EvaluateRequest, Evaluation};
use sutura_client::proto::{media, npy};
use sutura_client::{
    Array, Arrays, Basis, Combination, Delta, Evaluator, Generation, Query, Session, Tracker,
    Transfer,
};

/// uᵀ M v for displacements over all vertices.
fn product(mass: &[f64], u: &[f64], v: &[f64]) -> f64 {
    u.iter().zip(v).zip(mass.iter().flat_map(|m| [m; 3])).map(|((u, v), m)| u * v * m).sum()
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().map(f64::abs).fold(0.0, f64::max)
}

fn identity_error(mass: &[f64], columns: &[&[f64]]) -> f64 {
    let pairs = (0..columns.len()).flat_map(|i| (0..columns.len()).map(move |j| (i, j)));
    largest(
        pairs.map(|(i, j)| product(mass, columns[i], columns[j]) - if i == j { 1.0 } else { 0.0 }),
    )
}

#[tokio::test(flavor = "multi_thread")]
async fn modes_and_basis_are_orthonormal_in_the_lumped_mass() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    for generation in [0, 1] {
        let mass: Array<f64> = session.mass(generation.into()).await.unwrap();
        // Two halves of 0.1 × 0.05 × 0.05 m at 1000 kg/m³.
        assert!((mass.data.iter().sum::<f64>() - 0.5).abs() < 1e-12);
        let basis: Basis<f64> = session.basis(generation.into()).await.unwrap();
        let columns: Vec<_> = (0..basis.size()).map(|i| basis.column(i)).collect();
        assert!(identity_error(&mass.data, &columns) < 1e-8, "generation {generation}");
        let modes: Array<f64> = session.modes(generation.into()).await.unwrap();
        let columns: Vec<_> = modes.data.chunks_exact(3 * mass.data.len()).collect();
        assert_eq!(columns.len(), 8);
        assert!(identity_error(&mass.data, &columns) < 1e-8, "generation {generation}");
        for vertex in config().fixed_vertices {
            let at = 3 * vertex as usize;
            assert_eq!(
                largest((0..basis.size()).flat_map(|i| basis.column(i)[at..at + 3].to_vec())),
                0.0
            );
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn tets_and_stitches_are_those_that_were_sent() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let bus = daemon.zenoh_client().await.session(session.id()).unwrap();
    assert_eq!(session.tets(0.into()).await.unwrap(), bar().tets);
    assert_eq!(bus.tets(0.into()).await.unwrap(), bar().tets);
    assert_eq!(session.stitches(0.into()).await.unwrap(), []);
    let pairs = seam();
    let reply = session.edit(&stitch(&pairs[..3])).await.unwrap();
    let stitches = session.stitches(Generation::Current).await.unwrap();
    assert_eq!(stitches.iter().map(|stitch| stitch.pair).collect::<Vec<_>>(), pairs[..3]);
    assert_eq!(stitches.iter().map(|stitch| stitch.id).collect::<Vec<_>>(), reply.stitch_ids);
    assert!(stitches.iter().all(|stitch| stitch.stiffness_n_m == STIFFNESS_N_M));
    assert_eq!(bus.stitches(1.into()).await.unwrap(), stitches);
}

#[tokio::test(flavor = "multi_thread")]
async fn transfer_and_delta_lead_from_one_basis_to_the_next() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let pairs = seam();
    session.edit(&stitch(&pairs[..5])).await.unwrap();
    session.edit(&stitch(&pairs[5..])).await.unwrap();
    let bus = daemon.zenoh_client().await.session(session.id()).unwrap();
    let mass: Array<f64> = session.mass(Generation::Current).await.unwrap();
    for (from, to) in [(0, 1), (1, 2), (0, 2), (2, 1)] {
        let old: Basis<f64> = session.basis(from.into()).await.unwrap();
        let new: Basis<f64> = bus.basis(to.into()).await.unwrap();
        let transfer: Transfer<f64> = session.transfer(to.into(), from).await.unwrap();
        for i in 0..new.size() {
            for j in 0..old.size() {
                let expected = product(&mass.data, new.column(i), old.column(j));
                let entry = transfer.matrix.data[i * old.size() + j];
                assert!((entry - expected).abs() < 1e-8, "{from} to {to}: {entry} {expected}");
            }
        }
        let delta: Delta<f64> = bus.delta(to.into(), from).await.unwrap();
        let updated = old.updated(&delta).unwrap();
        assert_eq!((updated.generation(), updated.size()), (to, new.size()));
        for i in 0..new.size() {
            let error: Vec<f64> =
                new.column(i).iter().zip(updated.column(i)).map(|(a, b)| a - b).collect();
            let error = product(&mass.data, &error, &error).sqrt();
            assert!(error < 1e-8, "{from} to {to}, column {i}: {error:e}");
        }
    }
}

/// Counts the bytes that come from a source.
struct Counting<S> {
    source: S,
    n_bytes: AtomicUsize,
}

impl<S: Arrays> Counting<S> {
    fn new(source: S) -> Counting<S> {
        Counting { source, n_bytes: AtomicUsize::new(0) }
    }

    /// Bytes since the last call.
    fn n_bytes(&self) -> usize {
        self.n_bytes.swap(0, Ordering::Relaxed)
    }
}

impl<S: Arrays> Arrays for Counting<S> {
    async fn frame(&self, query: Query) -> sutura_client::Result<Vec<u8>> {
        let bytes = self.source.frame(query).await?;
        self.n_bytes.fetch_add(bytes.len(), Ordering::Relaxed);
        Ok(bytes)
    }
}

/// The most that a combination alone can take: its frame's header, padding included, two u32 and a size
/// for each block, an index and a row of W for each column in use.
fn combination_bytes(combination: &Combination) -> usize {
    let n_blocks = combination.blocks().len() + combination.prepared().len();
    512 + 12 * n_blocks + 4 * (1 + combination.size()) * combination.n_used()
}

/// Checks that `tracker` follows `generation` of `session` to single precision.
async fn assert_follows<S: Arrays>(tracker: &Tracker<S>, session: &Session, generation: u64) {
    assert_eq!(tracker.generation(), generation);
    let whole: Basis = session.basis(generation.into()).await.unwrap();
    let followed = tracker.basis().unwrap();
    assert_eq!((followed.size(), followed.n_vertices()), (whole.size(), whole.n_vertices()));
    let columns = || (0..whole.size()).flat_map(|i| whole.column(i));
    let scale = columns().fold(0.0f32, |m, x| m.max(x.abs()));
    let found = (0..whole.size()).flat_map(|i| followed.column(i));
    let error = columns().zip(found).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / scale;
    assert!(error <= 1e-6, "generation {generation}: {error:e}");
    let q: Vec<f32> = (0..whole.size()).map(|i| (1.0 + i as f32).sin()).collect();
    let (found, exact) = (tracker.reconstruct(&q).unwrap(), whole.reconstruct(&q).unwrap());
    let scale = exact.iter().fold(0.0f32, |m, x| m.max(x.abs()));
    let error = exact.iter().zip(&found).fold(0.0f32, |m, (a, b)| m.max((a - b).abs())) / scale;
    assert!(error <= 2e-6, "generation {generation}: {error:e}");
}

/// Edits inside a seam, followed over `source`: W is all that travels.
async fn follow_in_a_seam(session: &Session, source: impl Arrays) {
    let pairs = seam();
    let source = Counting::new(source);
    let mut tracker = Tracker::new(&source).await.unwrap();
    assert!(tracker.prefetch().await.unwrap(), "everything prepared fits");
    source.n_bytes();
    for some in [&pairs[..4], &pairs[4..6]] {
        let reply = session.edit(&stitch(some)).await.unwrap();
        assert_eq!(reply.certificate.verdict, Verdict::Patched);
        tracker.follow(reply.generation).await.unwrap();
        let n_bytes = source.n_bytes();
        let combination: Combination = session.combination(Generation::Current).await.unwrap();
        let bound = combination_bytes(&combination);
        assert!(n_bytes <= bound, "{n_bytes} bytes, {bound} for W");
        // Of the seam's columns only those of the stitched pairs.
        assert!(combination.n_used() + 6 * (pairs.len() - 4) <= combination.n_columns() + 12);
        assert_follows(&tracker, session, reply.generation).await;
    }
    // Another base body: its columns take the place of the old ones.
    let before: Vec<u64> = tracker.dictionary().ids().collect();
    assert!(before.len() > 1);
    let reply =
        session.edit(&EditRequest::new(vec![Edit::Fix { vertices: vec![TIP] }])).await.unwrap();
    tracker.follow(reply.generation).await.unwrap();
    assert!(tracker.dictionary().ids().all(|id| !before.contains(&id)));
    assert_follows(&tracker, session, reply.generation).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn w_alone_travels_after_an_edit_in_a_seam() {
    let daemon = Daemon::start();
    for over_zenoh in [false, true] {
        let session = ready_bar(&daemon).await;
        session.add_seams(&seam()).await.unwrap();
        prepared(&session, seam().len()).await;
        if over_zenoh {
            let zenoh = daemon.zenoh_client().await;
            follow_in_a_seam(&session, zenoh.session(session.id()).unwrap()).await;
        } else {
            follow_in_a_seam(&session, session.clone()).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn blocks_are_fetched_once_whole_bases_have_cost_as_much() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.add_seams(&seam()).await.unwrap();
    prepared(&session, seam().len()).await;
    let source = Counting::new(session.clone());
    let mut tracker = Tracker::new(&source).await.unwrap();
    let mut last = 0;
    let mut all = source.n_bytes();
    for pair in seam() {
        let reply = session.edit(&stitch(&[pair])).await.unwrap();
        tracker.follow(reply.generation).await.unwrap();
        assert_follows(&tracker, &session, reply.generation).await;
        last = source.n_bytes();
        all += last;
    }
    let combination: Combination = session.combination(Generation::Current).await.unwrap();
    assert!(last <= combination_bytes(&combination), "{last} bytes for the last edit");
    // Whole bases and blocks cost at most about twice what the blocks alone would have.
    let column = 12 * combination.n_vertices();
    let first = combination.size() * column;
    let bound = first + 2 * combination.n_columns() * column + 10 * combination_bytes(&combination);
    assert!(all <= bound + 4096, "{all} bytes, {bound} expected");
}

#[tokio::test(flavor = "multi_thread")]
async fn npy_and_frame_of_either_width_carry_the_same_numbers() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let basis: Basis<f64> = session.basis(Generation::Current).await.unwrap();
    let narrow: Basis<f32> = session.basis(Generation::Current).await.unwrap();
    let fetch = async |query: &str| {
        let path = format!("/v1/sessions/{}/generations/current/basis{query}", session.id());
        let request = plain_http().get(daemon.url(&path));
        let reply = request.header(header::ACCEPT, media::NPY).send().await.unwrap();
        assert_eq!(reply.headers()[header::CONTENT_TYPE], media::NPY);
        reply.bytes().await.unwrap()
    };
    let bytes = fetch("?dtype=f64").await;
    let array = npy::decode("basis", &bytes).unwrap();
    assert_eq!(array.shape, [basis.size(), basis.n_vertices(), 3]);
    let columns: Vec<f64> = (0..basis.size()).flat_map(|i| basis.column(i).to_vec()).collect();
    assert_eq!(array.data.bytes(), bytes_of(&columns));
    let bytes = fetch("").await;
    let array = npy::decode("basis", &bytes).unwrap();
    let columns: Vec<f32> = columns.iter().map(|&x| x as f32).collect();
    assert_eq!(array.data.bytes(), bytes_of_f32(&columns));
    assert_eq!(narrow.column(0), &columns[..3 * basis.n_vertices()]);
}

fn bytes_of(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn bytes_of_f32(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

async fn evaluate(session: &Session, q: &[f64], exact: bool) -> Evaluation {
    let request = EvaluateRequest { q: Coordinates::Single(q.to_vec()), exact };
    match session.evaluate(Generation::Current, &request).await.unwrap() {
        EvaluateReply::Single(evaluation) => evaluation,
        EvaluateReply::Batch { .. } => panic!("a batch for a single vector"),
    }
}

/// Coordinates with every mode at work, of an amplitude that bends the bar by about `size` m.
async fn pose(session: &Session, size: f64) -> Vec<f64> {
    let basis: Basis<f64> = session.basis(Generation::Current).await.unwrap();
    let q: Vec<f64> =
        (0..basis.size()).map(|i| (1.0 + i as f64).sin() / (1.0 + i as f64)).collect();
    let reach = largest(basis.reconstruct(&q).unwrap());
    q.iter().map(|q| q * size / reach).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn force_is_the_gradient_of_energy_and_stiffness_that_of_force() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    let q = pose(&session, 0.02).await;
    for exact in [false, true] {
        let here = evaluate(&session, &q, exact).await;
        assert!(here.energy_j > 0.0);
        let step = 1e-6 * largest(q.iter().copied());
        for i in [0, q.len() / 2, q.len() - 1] {
            let mut moved = [q.clone(), q.clone()];
            moved[0][i] += step;
            moved[1][i] -= step;
            let plus = evaluate(&session, &moved[0], exact).await;
            let minus = evaluate(&session, &moved[1], exact).await;
            let slope = (plus.energy_j - minus.energy_j) / (2.0 * step);
            let scale = largest(here.force.iter().copied());
            assert!((slope - here.force[i]).abs() < 1e-5 * scale, "{slope} {}", here.force[i]);
            for j in 0..q.len() {
                let slope = (plus.force[j] - minus.force[j]) / (2.0 * step);
                let scale = largest(here.stiffness.iter().flatten().copied());
                assert!((slope - here.stiffness[j][i]).abs() < 1e-5 * scale);
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn cubature_comes_close_to_the_sum_over_every_tet() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let request = EditRequest { method: EditMethod::FromScratch, ..stitch(&seam()) };
    let reply = session.edit(&request).await.unwrap();
    assert_eq!(reply.cubature.unwrap().source, CubatureSource::Retrained);
    let q = pose(&session, 0.01).await;
    let (rule, oracle) = (evaluate(&session, &q, false).await, evaluate(&session, &q, true).await);
    let difference: Vec<f64> = rule.force.iter().zip(&oracle.force).map(|(a, b)| a - b).collect();
    let norm = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let error = norm(&difference) / norm(&oracle.force);
    assert!(error > 0.0, "cubature of fewer points than tets cannot be exact");
    assert!(error < 0.2, "{error}, while validation says {:?}", reply.cubature);

    let batch = EvaluateRequest {
        q: Coordinates::Batch(vec![q.clone(), vec![0.0; q.len()]]),
        exact: false,
    };
    let EvaluateReply::Batch { evaluations } =
        session.evaluate(Generation::Current, &batch).await.unwrap()
    else {
        panic!("a single evaluation for a batch");
    };
    assert_eq!(evaluations[0], rule);
    assert_eq!((evaluations[1].energy_j, largest(evaluations[1].force.clone())), (0.0, 0.0));
}

/// Strain energy of the tables at `q`: Σ w V (μ E:E + λ/2 tr(E)²) + qᵀSq/2, St. Venant–Kirchhoff
/// with the Green strain E.
fn energy_j(tables: &Evaluator<f64>, q: &[f64]) -> f64 {
    let r = q.len();
    let dot = |row: &[f64]| row.iter().zip(q).map(|(a, b)| a * b).sum::<f64>();
    let mut energy = 0.0;
    for point in 0..tables.tets.len() {
        let gradients = &tables.shape_gradients.data[12 * point..];
        let rows = &tables.basis_rows.data[12 * point * r..];
        let mut f = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for corner in 0..4 {
            for (i, row) in f.iter_mut().enumerate() {
                let u = dot(&rows[(3 * corner + i) * r..(3 * corner + i + 1) * r]);
                for (j, entry) in row.iter_mut().enumerate() {
                    *entry += u * gradients[3 * corner + j];
                }
            }
        }
        let (mut squares, mut trace) = (0.0, 0.0);
        for i in 0..3 {
            for j in 0..3 {
                let c: f64 = f.iter().map(|row| row[i] * row[j]).sum();
                let e = 0.5 * (c - if i == j { 1.0 } else { 0.0 });
                squares += e * e;
                trace += if i == j { e } else { 0.0 };
            }
        }
        let [lambda, mu] = [0, 1].map(|i| tables.lame_pa.data[2 * point + i]);
        energy += tables.weights.data[point]
            * tables.volumes_m3.data[point]
            * (mu * squares + 0.5 * lambda * trace * trace);
    }
    let stitched = (0..r).map(|i| q[i] * dot(&tables.stitch_stiffness.data[i * r..(i + 1) * r]));
    energy + 0.5 * stitched.sum::<f64>()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_can_evaluate_on_its_own() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let reply = session.edit(&stitch(&seam())).await.unwrap();
    let tables: Evaluator<f64> = session.evaluator(Generation::Current).await.unwrap();
    assert_eq!(tables.tets.len(), reply.cubature.unwrap().n_points);
    let q = pose(&session, 0.02).await;
    let (ours, theirs) = (energy_j(&tables, &q), evaluate(&session, &q, false).await.energy_j);
    assert!((ours - theirs).abs() < 1e-9 * theirs, "{ours} {theirs}");
}
