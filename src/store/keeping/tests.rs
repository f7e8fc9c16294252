//! Bodies that are read instead of made, and what becomes of those that are not what they should be.

use crate::restore::tests::{close, edits, files, open, print, prints};
use crate::storage::{LocalFiles, Storage};
use crate::tests::storages::Ruled;
use crate::tests::{PATIENCE, create_bars, current, ready, seam, stitch};
use crate::{
    EditRequest, EventKind, GenerationRef, KeepingConfig, MemoryConfig, SessionId, SessionState,
    Store, StoreConfig,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use sutura_core::build::Method;
use sutura_core::control::Stage;
use sutura_core::edit::Edit;
use tempfile::TempDir;

/// What finds modes, derivatives, bases and rules.
const SOLVING: [Stage; 4] = [Stage::Modes, Stage::Derivatives, Stage::Basis, Stage::Cubature];

fn bodies(folder: &Path) -> Vec<PathBuf> {
    match folder.join("bodies") {
        bodies if bodies.exists() => files(&bodies),
        _ => Vec::new(),
    }
}

fn open_with(folder: &Path, config: StoreConfig) -> Store {
    Store::open(config, Arc::new(LocalFiles::open(folder).unwrap())).unwrap()
}

fn open_with_room(folder: &Path, max_body_bytes: u64) -> Store {
    let keeping = KeepingConfig { max_body_bytes, ..KeepingConfig::default() };
    open_with(folder, StoreConfig { keeping, ..StoreConfig::default() })
}

/// What `work` made the session go through.
async fn stages(store: &Store, id: SessionId, work: impl Future<Output = ()>) -> BTreeSet<Stage> {
    let mut events = store.subscribe(id).unwrap();
    work.await;
    let mut stages = BTreeSet::new();
    while let Ok(event) = events.try_recv() {
        if let EventKind::Progress(progress) = event.kind {
            stages.insert(progress.stage);
        }
    }
    stages
}

/// What every kept generation took: as it was, or as long as making it again took.
fn timings(store: &Store, id: SessionId) -> Vec<Vec<(Stage, Duration)>> {
    (0..=current(store, id).number)
        .filter_map(|number| store.generation(id, GenerationRef::Number(number)).ok())
        .map(|generation| generation.artifacts.timings().to_vec())
        .collect()
}

/// A session with generations of many kinds.
async fn edited(store: &Store) -> SessionId {
    let id = ready(store).await;
    let seam = seam();
    store.edit(id, stitch(&seam[..2])).await.unwrap();
    store.add_seams(id, seam.clone()).await.unwrap();
    store.edit(id, stitch(&seam[2..5])).await.unwrap();
    let by = |method, pairs| EditRequest { method, ..stitch(pairs) };
    store.edit(id, by(Method::LowRank, &seam[5..6])).await.unwrap();
    store.edit(id, by(Method::FromScratch, &seam[6..7])).await.unwrap();
    store.edit(id, edits(vec![Edit::ScaleStiffness { domain: 0, factor: 2.0 }])).await.unwrap();
    id
}

/// A store on what `folder` holds, in which the session is as it was.
async fn restarted(
    folder: &TempDir,
    id: SessionId,
    before: &[Vec<u64>],
    took: &[Vec<(Stage, Duration)>],
) -> Store {
    let store = open(folder.path());
    store.wake(id).await.unwrap();
    assert!(prints(&store, id) == before);
    assert_eq!(timings(&store, id), took);
    store
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_reads_bodies_and_solves_for_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = edited(&store).await;
    let (before, took) = (prints(&store, id), timings(&store, id));
    assert_eq!(before.len(), 6);
    close(store).await;
    // Two base bodies and the generations.
    assert_eq!(bodies(folder.path()).len(), 2 + 6);

    let store = restarted(&folder, id, &before, &took).await;
    // It goes on from there, and what it makes is kept as well.
    store.edit(id, edits(vec![Edit::UnstitchAll])).await.unwrap();
    let (after, took) = (prints(&store, id), timings(&store, id));
    close(store).await;
    assert_eq!(bodies(folder.path()).len(), 2 + 7);
    close(restarted(&folder, id, &after, &took).await).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_are_kept_once_a_session_has_come_to_rest() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = ready(&store).await;
    store.edit(id, stitch(&seam()[..2])).await.unwrap();
    let deadline = Instant::now() + PATIENCE;
    while bodies(folder.path()).len() < 3 {
        assert!(Instant::now() < deadline, "nothing is kept");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    // A session that is opened later uses them, too, and they last as long as one of the two.
    let second = ready(&store).await;
    assert!(Arc::ptr_eq(
        &store.generation(second, GenerationRef::Current).unwrap().artifacts,
        &store.generation(id, GenerationRef::Number(0)).unwrap().artifacts,
    ));
    let fork = store.fork(id, None).await.unwrap();
    store.delete(id).await.unwrap();
    assert_eq!(bodies(folder.path()).len(), 3);
    let before = prints(&store, fork);
    close(store).await;
    assert_eq!(bodies(folder.path()).len(), 3);
    let store = open(folder.path());
    store.wake(fork).await.unwrap();
    assert!(prints(&store, fork) == before);
    store.delete(fork).await.unwrap();
    assert_eq!(bodies(folder.path()).len(), 2);
    store.delete(second).await.unwrap();
    close(store).await;
    assert_eq!(bodies(folder.path()).len(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn damaged_bodies_are_made_again_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = edited(&store).await;
    let before = prints(&store, id);
    close(store).await;
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let blobs = bodies(folder.path());
    for (round, path) in blobs.iter().cycle().take(3 * blobs.len()).enumerate() {
        let whole = std::fs::read(path).unwrap();
        let mut damaged = whole.clone();
        let at = random.random_range(0..damaged.len());
        match round / blobs.len() {
            0 => damaged[at] ^= 1 << random.random_range(0..8),
            1 => damaged.truncate(at),
            // A whole one in the place of another.
            _ => damaged = std::fs::read(&blobs[(round + 1) % blobs.len()]).unwrap(),
        }
        std::fs::write(path, &damaged).unwrap();
        let store = open(folder.path());
        let info = store.wait_ready(id, PATIENCE).await.unwrap();
        assert_eq!(info.state, SessionState::Ready, "{path:?} {at}: {:?}", info.error);
        assert!(prints(&store, id) == before, "{path:?} {at}");
        close(store).await;
        // Healed by the way: the same numbers, though not the same times.
        assert_ne!(std::fs::read(path).unwrap(), damaged, "{path:?} {at}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_take_up_no_more_than_they_may() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path());
    let id = edited(&store).await;
    let before = prints(&store, id);
    close(store).await;
    let size = |folder: &Path| {
        bodies(folder).iter().map(|path| std::fs::metadata(path).unwrap().len()).sum::<u64>()
    };
    let whole = size(folder.path());
    for room in [whole / 2, whole / 8, 0] {
        let store = open_with_room(folder.path(), room);
        assert!(size(folder.path()) <= room);
        store.wake(id).await.unwrap();
        assert!(prints(&store, id) == before);
        let other = ready(&store).await;
        store.edit(other, stitch(&seam()[7..8])).await.unwrap();
        store.delete(other).await.unwrap();
        close(store).await;
        assert!(size(folder.path()) <= room);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_that_left_memory_come_back_without_a_solve() {
    let folder = tempfile::tempdir().unwrap();
    let measured = Store::new(StoreConfig::default()).unwrap();
    let id = ready(&measured).await;
    // Room for one body and the building of another.
    let budget_bytes = Some(4 * current(&measured, id).artifacts.memory_bytes());
    let memory = MemoryConfig { budget_bytes };
    let store = open_with(folder.path(), StoreConfig { memory, ..StoreConfig::default() });
    let mut before = Vec::new();
    for number in 0..6 {
        let mut request = create_bars();
        request.params.damping.mass_per_s = f64::from(number);
        let id = store.create(request).await.unwrap();
        assert_eq!(store.wait_ready(id, PATIENCE).await.unwrap().state, SessionState::Ready);
        store.edit(id, stitch(&seam()[..1])).await.unwrap();
        let last = store.fetch(id, GenerationRef::Current).await.unwrap();
        before.push((id, print(&last)));
    }
    let (first, _) = before[0];
    assert_eq!(store.info(first).unwrap().state, SessionState::Stored);
    // Somebody else brings what it was made of.
    let mut request = create_bars();
    request.params.damping.mass_per_s = 0.0;
    let equal = store.create(request).await.unwrap();
    let waits = async { drop(store.wait_ready(equal, PATIENCE).await.unwrap()) };
    let took = stages(&store, equal, waits).await;
    assert!(SOLVING.iter().all(|stage| !took.contains(stage)), "{took:?}");
    store.delete(equal).await.unwrap();
    for (id, before) in &before {
        let took = stages(&store, *id, async { store.wake(*id).await.unwrap() }).await;
        assert!(took.contains(&Stage::Reduction), "{took:?}");
        assert!(SOLVING.iter().all(|stage| !took.contains(stage)), "{took:?}");
        assert!(print(&store.fetch(*id, GenerationRef::Current).await.unwrap()) == *before);
    }
    close(store).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn on_a_full_disk_bodies_make_room_for_what_is_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let opened = |room: u64| {
        let storage = Ruled::new(folder.path(), move |files, n_more| {
            let folders = ["sessions", "meshes", "bodies"];
            let there = folders.into_iter().flat_map(|folder| files.list(folder).unwrap());
            let n_bytes: u64 = there.map(|entry| entry.n_bytes).sum();
            match n_more == 0 || n_bytes + n_more as u64 <= room {
                true => Ok(()),
                false => Err(ErrorKind::StorageFull),
            }
        });
        Store::open(StoreConfig::default(), Arc::new(storage)).unwrap()
    };
    let store = opened(u64::MAX);
    let id = edited(&store).await;
    close(store).await;
    let n_bodies = bodies(folder.path()).len();
    let all = files(folder.path()).iter().map(|path| std::fs::metadata(path).unwrap().len()).sum();
    let store = opened(all);
    store.wake(id).await.unwrap();
    for _ in 0..3 {
        store.edit(id, edits(vec![Edit::UnstitchAll])).await.unwrap();
        store.edit(id, stitch(&seam()[..2])).await.unwrap();
    }
    assert!(bodies(folder.path()).len() < n_bodies);
    // There is no room to keep what was made since: that harms nothing.
    let before = prints(&store, id);
    close(store).await;
    let store = opened(all);
    store.wake(id).await.unwrap();
    assert!(prints(&store, id) == before);
    close(store).await;
}
