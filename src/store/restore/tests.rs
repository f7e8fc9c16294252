//! Stores that go down and come back: on real files, and on a storage that fails when it is told to.

use crate::storage::LocalFiles;
use crate::tests::storages::Ruled;
use crate::tests::{PATIENCE, create_bars, current, ready, seam, simulation, stitch};
use crate::{
    EditRequest, Generation, GenerationRef, SessionId, SessionState, Store, StoreConfig,
    StoreError, WorkConfig,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use sutura_core::build::Derivatives;
use sutura_core::edit::Edit;

pub(crate) fn open(folder: &Path) -> Store {
    let files = Arc::new(LocalFiles::open(folder).unwrap());
    Store::open(StoreConfig::default(), files).unwrap()
}

/// The store goes down: its folder can be opened again.
pub(crate) async fn close(store: Store) {
    assert!(store.shutdown(PATIENCE).await);
}

/// A generation as its numbers tell it: the same bits or not the same.
pub(crate) fn print(generation: &Generation) -> Vec<u64> {
    let body = &generation.artifacts;
    let q: Vec<f64> = (0..body.basis_size()).map(|i| 1e-4 / (1.0 + i as f64)).collect();
    let at = body.model().evaluate(&q);
    let exact = body.evaluate_exact(&q);
    [at.energy_j, exact.energy_j, generation.tolerance]
        .into_iter()
        .chain(at.force)
        .chain(exact.stiffness)
        .chain(body.eigenvalues_per_s2().iter().copied())
        .map(f64::to_bits)
        .chain(generation.stitch_ids.iter().copied())
        .chain([generation.number, generation.improves.unwrap_or(u64::MAX)])
        .collect()
}

/// Every kept generation of a session.
pub(crate) fn prints(store: &Store, id: SessionId) -> Vec<Vec<u64>> {
    let newest = current(store, id).number;
    (0..=newest)
        .filter_map(|number| store.generation(id, GenerationRef::Number(number)).ok())
        .map(|generation| print(&generation))
        .collect()
}

pub(crate) fn edits(edits: Vec<Edit>) -> EditRequest {
    EditRequest { edits, ..stitch(&[]) }
}

async fn settled(store: &Store, id: SessionId) {
    // What a deadline leaves undone is done behind it, as a further generation.
    while current(store, id).artifacts.certificate().is_unfinished {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn everything_acknowledged_is_there_again_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = ready(&store).await;
    let seam = seam();
    store.edit(id, stitch(&seam[..2])).await.unwrap();
    assert_eq!(store.add_seams(id, seam.clone()).await.unwrap(), seam.len());
    let hurried = EditRequest {
        derivatives: Derivatives::Own,
        deadline: Some(Duration::ZERO),
        ..stitch(&seam[2..5])
    };
    store.edit(id, hurried).await.unwrap();
    settled(&store, id).await;
    store.edit(id, edits(vec![Edit::ScaleStiffness { domain: 0, factor: 2.0 }])).await.unwrap();
    let undone = EditRequest { restore: Some(1), ..edits(Vec::new()) };
    store.edit(id, undone).await.unwrap();
    let refused = store.edit(id, stitch(&seam[..2])).await;
    assert!(matches!(refused, Err(StoreError::Edit(_))));
    let fork = store.fork(id, Some("fork".into())).await.unwrap();
    store.edit(fork, edits(vec![Edit::Unstitch { stitch_ids: vec![0] }])).await.unwrap();
    store.put_simulation(fork, simulation()).await.unwrap();
    let deleted = ready(&store).await;
    store.delete(deleted).await.unwrap();
    let (before, of_fork) = (prints(&store, id), prints(&store, fork));
    assert!(before.len() >= 5);
    close(store).await;

    let store = open(folder.path());
    assert_eq!(store.list(None, 10).len(), 2);
    let info = store.info(id).unwrap();
    assert_eq!((info.generation_number, &*info.name), (current_of(&before), "bars"));
    let info = store.wait_ready(id, PATIENCE).await.unwrap();
    assert_eq!(info.state, SessionState::Ready, "{:?}", info.error);
    store.wake(fork).await.unwrap();
    assert!(prints(&store, id) == before);
    assert!(prints(&store, fork) == of_fork);
    assert_eq!(store.info(fork).unwrap().name, "fork");
    // It is simulated again, from rest, and the other one is not.
    assert_eq!(store.simulation(fork).await.unwrap().config, simulation());
    assert!(matches!(store.simulation(id).await, Err(StoreError::NoSimulation)));
    assert!(matches!(store.info(deleted), Err(StoreError::NoSession(_))));

    // Names of stitches go on where they were.
    let next = store.edit(id, stitch(&seam[6..7])).await.unwrap();
    assert_eq!(next.stitch_ids, [2]);
    store.stop_simulation(fork).await.unwrap();
    let after = prints(&store, id);
    close(store).await;
    let store = open(folder.path());
    store.wake(id).await.unwrap();
    assert!(prints(&store, id) == after);
    assert!(matches!(store.simulation(fork).await, Err(StoreError::NoSimulation)));
    close(store).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_base_body_that_serves_no_longer_is_replaced_behind_the_edits() {
    let folder = tempfile::tempdir().unwrap();
    let open = || {
        let work = WorkConfig { max_open_stitches: 3, ..WorkConfig::default() };
        let files = Arc::new(LocalFiles::open(folder.path()).unwrap());
        Store::open(StoreConfig { work, ..StoreConfig::default() }, files).unwrap()
    };
    let store = open();
    let id = ready(&store).await;
    let seam = seam();
    store.add_seams(id, seam.clone()).await.unwrap();
    let few = store.edit(id, stitch(&seam[..3])).await.unwrap();
    let many = store.edit(id, stitch(&seam[3..5])).await.unwrap();
    assert_eq!([&few, &many].map(|g| g.artifacts.n_open_stitches()), [3, 5]);
    let rebased = async |store: &Store, number: u64| {
        let deadline = Instant::now() + PATIENCE;
        while current(store, id).number < number {
            assert!(Instant::now() < deadline, "the base body stays");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        current(store, id)
    };
    let next = rebased(&store, many.number + 1).await;
    assert_eq!((next.number, next.improves), (many.number + 1, Some(many.number)));
    assert_eq!((next.artifacts.n_open_stitches(), next.artifacts.stitches().len()), (0, 5));
    let pairs = many.artifacts.eigenvalues_per_s2().iter().zip(next.artifacts.eigenvalues_per_s2());
    for (a, b) in pairs {
        assert!((a / b - 1.0).abs() < 1e-2, "{a} {b}");
    }
    // What had been prepared for the old base body is prepared for this one.
    let deadline = Instant::now() + PATIENCE;
    while current(&store, id).artifacts.n_prepared_pairs() < seam.len() - 5 {
        assert!(Instant::now() < deadline, "seams of the new base body are not prepared");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    // To the caller it is the generation of its last edit.
    let further = EditRequest { base_generation: Some(many.number), ..stitch(&seam[5..7]) };
    let further = store.edit(id, further).await.unwrap();
    assert_eq!(further.artifacts.n_open_stitches(), 2);
    // Taking out what the base body holds leaves all the others to be added to the first one.
    let unstitch = vec![Edit::Unstitch { stitch_ids: vec![0] }];
    let taken = store.edit(id, edits(unstitch)).await.unwrap();
    assert_eq!(taken.artifacts.n_open_stitches(), 6);
    let last = rebased(&store, taken.number + 1).await;
    assert_eq!(last.artifacts.n_open_stitches(), 0);
    let before = prints(&store, id);
    close(store).await;
    let store = open();
    store.wake(id).await.unwrap();
    assert!(prints(&store, id) == before);
    close(store).await;
}

fn current_of(prints: &[Vec<u64>]) -> u64 {
    let last = prints.last().unwrap();
    last[last.len() - 2]
}

#[tokio::test(flavor = "multi_thread")]
async fn closed_bodies_and_long_lines_of_generations_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut request = create_bars();
    // The second bar stands off.
    let mesh = &request.mesh;
    let moved: Vec<[f64; 3]> = (0..)
        .zip(mesh.vertices())
        .map(
            |(v, x)| {
                if mesh.component_of_vertex()[v] == 0 { *x } else { [x[0] + 1e-3, x[1], x[2]] }
            },
        )
        .collect();
    let moved = sutura_core::mesh::TetMesh::new(moved, mesh.tets().to_vec(), Vec::new());
    request.mesh = Arc::new(moved.unwrap());
    let store = open(folder.path());
    let id = store.create(request).await.unwrap();
    store.wait_ready(id, PATIENCE).await.unwrap();
    let close_gap = Edit::Close { pairs: seam(), stiffness_n_m: 1e5, max_gap_m: None };
    store.edit(id, edits(vec![close_gap])).await.unwrap();
    let n_kept = store.config().work.n_kept_generations;
    // Far more generations than are kept: the journal is shortened behind them.
    for _ in 0..5 * n_kept {
        let again =
            |stiffness_n_m| edits(vec![Edit::SetStiffness { stitch_ids: vec![0], stiffness_n_m }]);
        let number = current(&store, id).number as f64;
        store.edit(id, again(1e4 + number)).await.unwrap();
    }
    let before = prints(&store, id);
    assert_eq!(before.len(), n_kept);
    close(store).await;
    let journal = std::fs::metadata(folder.path().join(format!("sessions/{id}"))).unwrap();
    let store = open(folder.path());
    store.wake(id).await.unwrap();
    assert!(prints(&store, id) == before);
    let per_generation = journal.len() as usize / (5 * n_kept + 1);
    assert!(per_generation < 4096, "{per_generation}");
    // Both meshes, the open and the closed one, go with the session.
    store.delete(id).await.unwrap();
    close(store).await;
    assert_eq!(files(folder.path()).len(), 2, "{:?}", files(folder.path()));
}

/// The files of a folder: `format` and `lock` are always there.
pub(crate) fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(files(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_whose_build_was_cut_off_is_built() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = store.create(create_bars()).await.unwrap();
    close(store).await;
    let store = open(folder.path());
    let info = store.wait_ready(id, PATIENCE).await.unwrap();
    assert_eq!((info.state, info.generation_number), (SessionState::Ready, 0));
    close(store).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_kept_is_refused_and_nothing_else_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let is_full = Arc::new(AtomicBool::new(false));
    let storage = Ruled::new(folder.path(), {
        let is_full = is_full.clone();
        move |_, _| match is_full.load(Ordering::SeqCst) {
            true => Err(ErrorKind::StorageFull),
            false => Ok(()),
        }
    });
    let store = Store::open(StoreConfig::default(), Arc::new(storage)).unwrap();
    let id = ready(&store).await;
    store.edit(id, stitch(&seam()[..1])).await.unwrap();
    is_full.store(true, Ordering::SeqCst);
    let full = |error: StoreError| {
        assert!(matches!(&error, StoreError::Storage(error) if error.is_full()), "{error}");
    };
    full(store.edit(id, stitch(&seam()[1..2])).await.unwrap_err());
    full(store.create(create_bars()).await.unwrap_err());
    full(store.fork(id, None).await.unwrap_err());
    full(store.add_seams(id, seam()).await.unwrap_err());
    full(store.put_simulation(id, simulation()).await.unwrap_err());
    full(store.delete(id).await.unwrap_err());
    // It serves what it has, unchanged.
    assert_eq!((store.n_sessions(), current(&store, id).number), (1, 1));
    assert!(matches!(store.simulation(id).await, Err(StoreError::NoSimulation)));
    is_full.store(false, Ordering::SeqCst);
    store.edit(id, stitch(&seam()[2..3])).await.unwrap();
    let before = prints(&store, id);
    close(store).await;

    let store = open(folder.path());
    store.wake(id).await.unwrap();
    assert_eq!(store.n_sessions(), 1);
    assert!(prints(&store, id) == before);
    close(store).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_torn_journal_ends_at_its_last_whole_record() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = ready(&store).await;
    let journal = folder.path().join(format!("sessions/{id}"));
    let length = || std::fs::metadata(&journal).unwrap().len();
    let mut ends = vec![length()];
    for pair in &seam()[..3] {
        store.edit(id, stitch(&[*pair])).await.unwrap();
        ends.push(length());
    }
    let before = prints(&store, id);
    close(store).await;
    let whole = std::fs::read(&journal).unwrap();

    let mut random = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..12 {
        let cut = random.random_range(ends[0]..ends[3]);
        std::fs::write(&journal, &whole[..cut as usize]).unwrap();
        let store = open(folder.path());
        store.wake(id).await.unwrap();
        let n_whole = ends.iter().filter(|end| **end <= cut).count();
        assert!(prints(&store, id) == before[..n_whole], "{cut}");
        // It goes on from there, over what was torn.
        store.edit(id, stitch(&seam()[5..6])).await.unwrap();
        let after = prints(&store, id);
        close(store).await;
        let store = open(folder.path());
        store.wake(id).await.unwrap();
        assert!(prints(&store, id) == after, "{cut}");
        close(store).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn damage_anywhere_is_noticed_and_harms_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = ready(&store).await;
    for pair in &seam()[..3] {
        store.edit(id, stitch(&[*pair])).await.unwrap();
    }
    let mut other = create_bars();
    other.params.n_modes -= 1;
    let other = store.create(other).await.unwrap();
    store.wait_ready(other, PATIENCE).await.unwrap();
    let (before, of_other) = (prints(&store, id), prints(&store, other));
    close(store).await;

    let mut random = ChaCha8Rng::seed_from_u64(2);
    let paths = files(folder.path());
    let is_needed = |path: &&PathBuf| {
        path.starts_with(folder.path().join("sessions"))
            || path.starts_with(folder.path().join("meshes"))
    };
    let blobs: Vec<&PathBuf> = paths.iter().filter(is_needed).collect();
    assert_eq!(blobs.len(), 3);
    for path in blobs {
        let whole = std::fs::read(path).unwrap();
        for round in 0..8 {
            let mut damaged = whole.clone();
            let at = random.random_range(0..damaged.len());
            match round % 2 {
                0 => damaged[at] ^= 1 << random.random_range(0..8),
                _ => damaged.truncate(at),
            }
            std::fs::write(path, &damaged).unwrap();
            let store = open(folder.path());
            assert_eq!(store.list(None, 10).len(), 2);
            for (id, before) in [(id, &before), (other, &of_other)] {
                let is_hit =
                    path.ends_with(id.to_string()) || path.to_string_lossy().contains("meshes");
                let info = store.wait_ready(id, PATIENCE).await.unwrap();
                match info.state {
                    SessionState::Ready => {
                        // Every generation that is there is the one it was.
                        let found = prints(&store, id);
                        assert!(found.iter().all(|print| before.contains(print)), "{path:?} {at}");
                        assert!(is_hit || found == *before);
                    }
                    SessionState::Failed => {
                        assert!(is_hit, "{path:?} {at}: {:?}", info.error);
                        let error = info.error.unwrap();
                        assert!(matches!(*error, StoreError::Damaged { .. }), "{error}");
                        let refused = store.edit(id, stitch(&seam()[4..5])).await;
                        assert!(matches!(refused, Err(StoreError::NotReady { .. })));
                    }
                    state => panic!("{state}"),
                }
            }
            close(store).await;
            std::fs::write(path, &whole).unwrap();
        }
    }
    let store = open(folder.path());
    store.wake(id).await.unwrap();
    assert!(prints(&store, id) == before);
    close(store).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_mesh_is_healed_by_whoever_brings_it_again() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = ready(&store).await;
    let before = prints(&store, id);
    close(store).await;
    let paths = files(&folder.path().join("meshes"));
    std::fs::write(&paths[0], b"nothing").unwrap();
    let store = open(folder.path());
    let info = store.wait_ready(id, PATIENCE).await.unwrap();
    assert_eq!(info.state, SessionState::Failed);
    ready(&store).await;
    close(store).await;
    let store = open(folder.path());
    store.wake(id).await.unwrap();
    assert!(prints(&store, id) == before);
    close(store).await;
}

/// A budget for so many bodies like that of `bars`, builds included, and a half.
async fn store_for(folder: &Path, n_bodies: usize) -> Store {
    let measured = Store::new(StoreConfig::default()).unwrap();
    let id = ready(&measured).await;
    let n_bytes = current(&measured, id).artifacts.memory_bytes();
    let budget_bytes = Some(n_bytes * n_bodies + n_bytes / 2);
    let config = StoreConfig { memory: crate::MemoryConfig { budget_bytes }, ..Default::default() };
    Store::open(config, Arc::new(LocalFiles::open(folder).unwrap())).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_beyond_the_budget_leave_memory_and_come_back() {
    let folder = tempfile::tempdir().unwrap();
    // Building takes some factors of the matrix beside the body.
    let store = store_for(folder.path(), 3).await;
    let mut ids = Vec::new();
    let mut before = Vec::new();
    for number in 0..6 {
        let mut request = create_bars();
        request.params.damping.mass_per_s = f64::from(number);
        let id = store.create(request).await.unwrap();
        assert_eq!(store.wait_ready(id, PATIENCE).await.unwrap().state, SessionState::Ready);
        store.edit(id, stitch(&seam()[..1])).await.unwrap();
        before.push(print(&store.fetch(id, GenerationRef::Current).await.unwrap()));
        ids.push(id);
    }
    let state = |id: SessionId| store.info(id).unwrap().state;
    assert_eq!(state(ids[0]), SessionState::Stored);
    assert_eq!(state(ids[5]), SessionState::Ready);
    for (id, before) in ids.iter().zip(&before) {
        let generation = store.fetch(*id, GenerationRef::Current).await.unwrap();
        assert!(print(&generation) == *before);
    }
    // An edit of a body that is not in memory, with the generation that the client knows.
    assert_eq!(state(ids[0]), SessionState::Stored);
    let request = EditRequest { base_generation: Some(1), ..stitch(&seam()[1..2]) };
    assert_eq!(store.edit(ids[0], request).await.unwrap().number, 2);
    assert_eq!(state(ids[0]), SessionState::Ready);
    let stale = EditRequest { base_generation: Some(0), ..stitch(&seam()[2..3]) };
    let refused = store.edit(ids[1], stale).await;
    assert!(matches!(refused, Err(StoreError::WrongGeneration { given: 0, current: 1 })));
    // One that is simulated stays.
    store.put_simulation(ids[1], simulation()).await.unwrap();
    for id in &ids[2..] {
        store.wake(*id).await.unwrap();
    }
    assert_eq!(state(ids[1]), SessionState::Ready);
    close(store).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_that_would_not_fit_is_refused_with_its_estimate() {
    let folder = tempfile::tempdir().unwrap();
    let store = store_for(folder.path(), 0).await;
    let id = store.create(create_bars()).await.unwrap();
    let info = store.wait_ready(id, PATIENCE).await.unwrap();
    assert_eq!(info.state, SessionState::Failed);
    let error = info.error.unwrap().to_string();
    assert!(error.contains("budget") && error.contains("bytes"), "{error}");
    close(store).await;
}
