//! What nobody waits for is done in the end, however much of it comes at once.

use super::{PATIENCE, create_bars, current, n_waiting, occupy, ready, seam, stitch, store_with};
use crate::work::EDIT;
use crate::{Limits, SessionId, Store, WorkConfig};
use std::time::Instant;
use sutura_core::material::Material;

/// Sessions, more than places for builds.
const N_SESSIONS: usize = 4;

async fn until(what: &str, is_so: impl Fn() -> bool) {
    let deadline = Instant::now() + PATIENCE;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}");
        tokio::task::yield_now().await;
    }
}

fn n_prepared(store: &Store, id: SessionId) -> usize {
    current(store, id).artifacts.n_prepared_pairs()
}

#[tokio::test]
async fn every_seam_is_prepared_however_many_are_named_at_once() {
    let work = WorkConfig { build_queue_limit: 1, ..WorkConfig::default() };
    let store = store_with(work, Limits::default());
    let mut ids = Vec::new();
    for session in 0..N_SESSIONS {
        // Equal bodies would share their seams.
        let mut request = create_bars();
        request.params.materials = vec![Material::stvk(1e5 + session as f64, 0.4, 1000.0).unwrap()];
        ids.push(store.create(request).await.unwrap());
        store.wait_ready(ids[session], PATIENCE).await.unwrap();
    }
    let busy = occupy(&store, EDIT, store.config().work.n_build_threads);
    let pairs = seam();
    // Each session names one half, then the other: one task does both.
    for half in [&pairs[..4], &pairs[4..]] {
        for &id in &ids {
            store.add_seams(id, half.to_vec()).await.unwrap();
        }
    }
    assert_eq!(n_waiting(&store, "preparation"), N_SESSIONS);
    drop(busy);
    let are_all = || ids.iter().all(|&id| n_prepared(&store, id) == pairs.len());
    until("a seam is never prepared", are_all).await;
}

#[tokio::test]
async fn a_seam_named_while_another_is_prepared_is_prepared_too() {
    let store = store_with(WorkConfig::default(), Limits::default());
    let id = ready(&store).await;
    // One pair after the other, each perhaps while that before it is prepared.
    for pair in seam() {
        store.add_seams(id, vec![pair]).await.unwrap();
    }
    until("a seam is never prepared", || n_prepared(&store, id) == seam().len()).await;
}

#[tokio::test]
async fn chores_of_a_deleted_session_are_left() {
    let store = store_with(WorkConfig::default(), Limits::default());
    let (gone, stays) = (ready(&store).await, ready(&store).await);
    let busy = occupy(&store, EDIT, store.config().work.n_build_threads);
    let (body, pairs) = (current(&store, gone), seam());
    store.add_seams(gone, pairs.clone()).await.unwrap();
    store.add_seams(stays, pairs[..1].to_vec()).await.unwrap();
    store.delete(gone).await.unwrap();
    drop(busy);
    until("the other seam is never prepared", || n_prepared(&store, stays) == 1).await;
    let is_idle = || store.load().tasks.iter().all(|task| task.n_waiting + task.n_running == 0);
    until("the pool is never idle", is_idle).await;
    // Both sessions have the same base body.
    assert_eq!(body.artifacts.n_prepared_pairs(), 1);
    store.edit(stays, stitch(&pairs[..2])).await.unwrap();
}
