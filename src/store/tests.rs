//! The store from the outside, on small real bodies.

mod chores;
mod interaction;
pub(crate) mod storages;

use crate::pool::{Account, Place};
use crate::work::{BUILD, EDIT};
use crate::{
    ContactConfig, CreateSession, EditRequest, Event, EventKind, Frame, Generation, GenerationRef,
    InputError, Limits, SessionId, SessionState, SimulationConfig, Store, StoreConfig, StoreError,
    VertexForce, WorkConfig,
};
use std::future::Future;
use std::pin::pin;
use std::sync::Arc;
use std::sync::mpsc;
use std::task::{Context, Waker};
use std::time::Duration;
use sutura_core::build::{
    BuildParams, CubatureParams, Derivatives, MassKind, Method, RayleighDamping, Selection,
};
use sutura_core::edit::{Edit, EditError};
use sutura_core::material::Material;
use sutura_core::mesh::TetMesh;
use sutura_core::reduced::{Integrator, SimulationError, SimulationParams};
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

/// Long enough for any machine; no test waits so long when all is well.
pub(crate) const PATIENCE: Duration = Duration::from_secs(300);

/// Cells along a bar, and across it in either direction.
const LENGTH: u32 = 4;
const WIDTH: u32 = 2;
/// Vertices of one bar.
const N_VERTICES: u32 = (LENGTH + 1) * (WIDTH + 1) * (WIDTH + 1);

fn index(x: u32, y: u32, z: u32) -> u32 {
    (x * (WIDTH + 1) + y) * (WIDTH + 1) + z
}

/// The six tets of a cell share its long diagonal; each walks along the axes in one order.
fn cell_tets([x, y, z]: [u32; 3]) -> [[u32; 4]; 6] {
    const ORDERS: [[usize; 3]; 6] =
        [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    const ODD: [bool; 6] = [false, true, true, false, false, true];
    std::array::from_fn(|tet| {
        let mut at = [x, y, z];
        let mut corners = [index(x, y, z); 4];
        for (step, &axis) in ORDERS[tet].iter().enumerate() {
            at[axis] += 1;
            corners[step + 1] = index(at[0], at[1], at[2]);
        }
        if ODD[tet] {
            corners.swap(2, 3);
        }
        corners
    })
}

/// Two bars of 4 × 2 × 2 cells of 1 cm, end to end. Their ends coincide but are not joined.
pub(crate) fn two_bars() -> Arc<TetMesh> {
    let mut vertices = Vec::new();
    let mut tets = Vec::new();
    for bar in 0..2 {
        for x in 0..=LENGTH {
            for y in 0..=WIDTH {
                for z in 0..=WIDTH {
                    vertices.push([bar * LENGTH + x, y, z].map(|c| f64::from(c) * 0.01));
                }
            }
        }
        for x in 0..LENGTH {
            for (y, z) in (0..WIDTH).flat_map(|y| (0..WIDTH).map(move |z| (y, z))) {
                let of_bar = |tet: [u32; 4]| tet.map(|v| v + bar * N_VERTICES);
                tets.extend(cell_tets([x, y, z]).map(of_bar));
            }
        }
    }
    Arc::new(TetMesh::new(vertices, tets, Vec::new()).unwrap())
}

/// Vertices of the cross-section at `x` of a bar.
pub(crate) fn section(bar: u32, x: u32) -> impl Iterator<Item = u32> {
    (0..=WIDTH)
        .flat_map(move |y| (0..=WIDTH).map(move |z| index(x, y, z)))
        .map(move |v| v + bar * N_VERTICES)
}

/// The pairs of coinciding vertices where the bars meet.
pub(crate) fn seam() -> Vec<[u32; 2]> {
    section(0, LENGTH).zip(section(1, 0)).map(|(a, b)| [a, b]).collect()
}

/// Both outer ends are held, so that nothing is free even before the stitches.
pub(crate) fn params() -> BuildParams {
    BuildParams {
        materials: vec![Material::stvk(1e5, 0.4, 1000.0).unwrap()],
        tet_stiffness: [].into(),
        fixed_vertices: section(0, 0).chain(section(1, LENGTH)).collect(),
        mass: MassKind::Lumped,
        n_modes: 6,
        basis_size: 12,
        pca: Default::default(),
        n_derivative_modes: 3,
        cubature: Some(CubatureParams {
            n_points: 40,
            n_training_poses: 10,
            tolerance: 0.05,
            seed: 1,
            selection: Selection::default(),
            smoothing: true,
        }),
        damping: RayleighDamping { mass_per_s: 0.5, stiffness_s: 1e-3 },
        seams: Vec::new(),
    }
}

pub(crate) fn create_bars() -> CreateSession {
    CreateSession { name: "bars".into(), tenant: None, mesh: two_bars(), params: params() }
}

fn store_with(work: WorkConfig, limits: Limits) -> Store {
    Store::new(StoreConfig { work, limits, ..StoreConfig::default() }).unwrap()
}

fn store() -> Store {
    store_with(WorkConfig::default(), Limits::default())
}

pub(crate) async fn ready(store: &Store) -> SessionId {
    let id = store.create(create_bars()).await.unwrap();
    let info = store.wait_ready(id, PATIENCE).await.unwrap();
    assert_eq!(info.state, SessionState::Ready, "{:?}", info.error);
    id
}

pub(crate) fn stitch(pairs: &[[u32; 2]]) -> EditRequest {
    EditRequest {
        deadline: None,
        base_generation: None,
        restore: None,
        method: Method::Flexibility,
        derivatives: Derivatives::default(),
        tolerance: 1e-4,
        edits: vec![Edit::Stitch { pairs: pairs.to_vec(), stiffness_n_m: 1e5 }],
    }
}

pub(crate) fn current(store: &Store, id: SessionId) -> Arc<Generation> {
    store.generation(id, GenerationRef::Current).unwrap()
}

/// Keeps `n` threads of the build pool busy with tasks of `class` until the answer is dropped.
fn occupy(store: &Store, class: usize, n: usize) -> Vec<mpsc::Sender<()>> {
    let (began, begin) = mpsc::channel();
    let occupied = (0..n).map(|_| {
        let (release, released) = mpsc::channel::<()>();
        let began = began.clone();
        let wait = move |_: &_| {
            began.send(()).unwrap();
            let _ = released.recv();
        };
        store.builds().submit(Place::new(class), wait).map(drop).unwrap();
        begin.recv().unwrap();
        release
    });
    occupied.collect()
}

/// Tasks of a kind that wait for a thread.
fn n_waiting(store: &Store, kind: &str) -> usize {
    let tasks = store.load().tasks;
    tasks.iter().filter(|tasks| tasks.kind == kind).map(|tasks| tasks.n_waiting).sum()
}

/// Polls once, as a runtime would before something else happens.
fn poll_once<F: Future>(future: std::pin::Pin<&mut F>) {
    assert!(future.poll(&mut Context::from_waker(Waker::noop())).is_pending());
}

/// The next event that is not about progress.
pub(crate) async fn next_event(events: &mut broadcast::Receiver<Event>) -> EventKind {
    loop {
        match tokio::time::timeout(PATIENCE, events.recv()).await.unwrap().unwrap().kind {
            EventKind::Progress(_) => {}
            kind => return kind,
        }
    }
}

async fn next_frame(frames: &mut broadcast::Receiver<Arc<Frame>>) -> Arc<Frame> {
    loop {
        match tokio::time::timeout(PATIENCE, frames.recv()).await.unwrap() {
            Ok(frame) => return frame,
            Err(RecvError::Lagged(_)) => {}
            Err(RecvError::Closed) => panic!("the frames ended"),
        }
    }
}

#[tokio::test]
async fn a_session_is_built_and_tells_how_far_it_is() {
    let store = store();
    let mut events = store.subscribe_all();
    let id = store.create(create_bars()).await.unwrap();
    let info = store.wait_ready(id, PATIENCE).await.unwrap();
    assert_eq!(info.state, SessionState::Ready, "{:?}", info.error);
    assert_eq!(info.generation.unwrap().number, 0);
    let mut n_progress = 0;
    let mut others = Vec::new();
    while let Ok(event) = events.try_recv() {
        assert_eq!(event.session, id);
        match event.kind {
            EventKind::Progress(progress) => {
                n_progress += 1;
                assert!((0.0..=1.0).contains(&progress.fraction));
            }
            kind => others.push(kind),
        }
    }
    assert!(n_progress > 0);
    let ready = EventKind::State(SessionState::Ready);
    assert_eq!(others, [EventKind::Created, EventKind::Generation(0), ready]);
}

#[tokio::test]
async fn equal_bodies_are_prepared_once() {
    let store = store();
    let (a, b) = (ready(&store).await, ready(&store).await);
    assert!(Arc::ptr_eq(&current(&store, a).artifacts, &current(&store, b).artifacts));
    let mut other = create_bars();
    other.params.n_modes -= 1;
    let c = store.create(other).await.unwrap();
    store.wait_ready(c, PATIENCE).await.unwrap();
    assert!(!Arc::ptr_eq(&current(&store, a).artifacts, &current(&store, c).artifacts));
}

#[tokio::test]
async fn a_body_that_cannot_be_built_is_reported() {
    let store = store();
    let mut request = create_bars();
    request.params.fixed_vertices.push(2 * N_VERTICES);
    let id = store.create(request).await.unwrap();
    let info = store.wait_ready(id, PATIENCE).await.unwrap();
    assert_eq!(info.state, SessionState::Failed);
    assert!(info.error.unwrap().to_string().contains("fixed_vertices"));
    let refused = store.edit(id, stitch(&seam()[..1])).await;
    assert!(matches!(refused, Err(StoreError::NotReady { state: SessionState::Failed })));
}

#[tokio::test]
async fn an_edit_makes_the_next_generation_and_leaves_the_old_one() {
    let store = store();
    let id = ready(&store).await;
    let before = current(&store, id);
    let made = store.edit(id, stitch(&seam())).await.unwrap();
    assert_eq!((made.number, made.made_by), (1, Some(Method::Flexibility)));
    assert_eq!(made.stitch_ids.len(), seam().len());
    assert_eq!(made.artifacts.stitches().len(), seam().len());
    assert!(made.artifacts.frequencies_hz()[0] > before.artifacts.frequencies_hz()[0]);
    let kept = store.generation(id, GenerationRef::Number(0)).unwrap();
    assert!(Arc::ptr_eq(&kept, &before));
    let missing = store.generation(id, GenerationRef::Number(2));
    assert!(matches!(missing, Err(StoreError::NoGeneration { number: 2, oldest: 0, current: 1 })));
}

#[tokio::test]
async fn only_the_newest_generations_are_kept() {
    let work = WorkConfig { n_kept_generations: 2, ..WorkConfig::default() };
    let store = store_with(work, Limits::default());
    let id = ready(&store).await;
    for pair in &seam()[..3] {
        store.edit(id, stitch(&[*pair])).await.unwrap();
    }
    let kept = |number| store.generation(id, GenerationRef::Number(number));
    assert!(matches!(kept(1), Err(StoreError::NoGeneration { oldest: 2, current: 3, .. })));
    assert_eq!(kept(2).unwrap().number, 2);
}

#[tokio::test]
async fn an_edit_of_another_generation_conflicts() {
    let store = store();
    let id = ready(&store).await;
    for given in [1, u64::MAX] {
        let request = EditRequest { base_generation: Some(given), ..stitch(&seam()[..1]) };
        let refused = store.edit(id, request).await;
        let Err(StoreError::WrongGeneration { given: named, current: 0 }) = refused else {
            panic!("{refused:?}");
        };
        assert_eq!(named, given);
    }
    let right = EditRequest { base_generation: Some(0), ..stitch(&seam()[..1]) };
    store.edit(id, right.clone()).await.unwrap();
    let late = store.edit(id, right).await;
    assert!(matches!(late, Err(StoreError::WrongGeneration { given: 0, current: 1 })));
}

#[tokio::test]
async fn edits_of_one_request_take_effect_together_or_not_at_all() {
    let store = store();
    let id = ready(&store).await;
    let mut request = stitch(&seam()[..1]);
    request.edits.push(Edit::Stitch { pairs: vec![[0, 1]], stiffness_n_m: 1e5 });
    let refused = store.edit(id, request).await;
    assert!(matches!(refused, Err(StoreError::Edit(EditError::Apart { edit: 1, .. }))));
    let info = store.info(id).unwrap();
    assert_eq!((info.state, info.progress), (SessionState::Ready, None));
    let generation = info.generation.unwrap();
    assert_eq!((generation.number, generation.artifacts.stitches().len()), (0, 0));
}

#[tokio::test]
async fn concurrent_edits_queue_up() {
    let store = store();
    let id = ready(&store).await;
    let seam = seam();
    let [a, b] = [stitch(&seam[..1]), stitch(&seam[1..2])];
    let (a, b) = tokio::join!(store.edit(id, a), store.edit(id, b));
    assert_eq!((a.unwrap().number, b.unwrap().number), (1, 2));
    assert_eq!(current(&store, id).artifacts.stitches().len(), 2);
}

#[tokio::test]
async fn a_fork_shares_the_past_and_goes_its_own_way() {
    let store = store();
    let id = ready(&store).await;
    store.edit(id, stitch(&seam()[..1])).await.unwrap();
    let fork = store.fork(id, Some("fork".into())).await.unwrap();
    assert!(Arc::ptr_eq(&current(&store, id), &current(&store, fork)));
    assert_eq!(store.info(fork).unwrap().name, "fork");
    store.edit(fork, stitch(&seam()[1..])).await.unwrap();
    assert_eq!((current(&store, id).number, current(&store, fork).number), (1, 2));
    store.delete(id).await.unwrap();
    assert_eq!(current(&store, fork).artifacts.stitches().len(), seam().len());
}

#[tokio::test]
async fn a_session_that_is_still_being_built_refuses_what_needs_a_body() {
    let store = store();
    let _busy = occupy(&store, BUILD, 1);
    let id = store.create(create_bars()).await.unwrap();
    let building = |result: Result<(), StoreError>| {
        assert!(matches!(result, Err(StoreError::NotReady { state: SessionState::Building })));
    };
    building(store.edit(id, stitch(&seam())).await.map(drop));
    building(store.fork(id, None).await.map(drop));
    building(store.generation(id, GenerationRef::Current).map(drop));
    building(store.put_simulation(id, simulation()).await.map(drop));
    let waited = store.wait_ready(id, Duration::from_millis(1)).await.unwrap();
    assert_eq!(waited.state, SessionState::Building);
}

#[tokio::test]
async fn a_full_queue_sheds_and_adds_no_session() {
    let work = WorkConfig { build_queue_limit: 1, ..WorkConfig::default() };
    let store = store_with(work, Limits::default());
    let _busy = occupy(&store, BUILD, 1);
    store.create(create_bars()).await.unwrap();
    let refused = store.create(create_bars()).await;
    assert!(matches!(refused, Err(StoreError::Busy { retry_after_s: 1.. })));
    assert_eq!((store.n_sessions(), n_waiting(&store, "build")), (1, 1));
}

#[tokio::test]
async fn too_many_sessions_and_too_large_ones_are_refused() {
    let limits = Limits { max_sessions: 1, max_modes: 6, ..Limits::default() };
    let store = store_with(WorkConfig::default(), limits);
    let mut request = create_bars();
    request.params.n_modes = 7;
    let refused = store.create(request).await;
    assert!(matches!(refused, Err(StoreError::TooLarge { what: "modes", limit: 6, given: 7 })));
    store.create(create_bars()).await.unwrap();
    let refused = store.create(create_bars()).await;
    assert!(matches!(refused, Err(StoreError::Full { what: "sessions", limit: 1 })));
}

#[tokio::test]
async fn an_edit_nobody_waits_for_is_cancelled() {
    let store = store();
    let id = ready(&store).await;
    let busy = occupy(&store, EDIT, store.config().work.n_build_threads);
    {
        let mut edit = pin!(store.edit(id, stitch(&seam())));
        poll_once(edit.as_mut());
        assert_eq!(n_waiting(&store, "edit"), 1);
    }
    assert_eq!(n_waiting(&store, "edit"), 0);
    drop(busy);
    // The next edit finds the session as it was.
    assert_eq!(store.edit(id, stitch(&seam()[..1])).await.unwrap().number, 1);
}

#[tokio::test]
async fn deleting_a_session_cancels_its_build_and_ends_its_subscriptions() {
    let store = store();
    let _busy = occupy(&store, BUILD, 1);
    let id = store.create(create_bars()).await.unwrap();
    let mut events = store.subscribe(id).unwrap();
    let mut frames = store.subscribe_frames(id).unwrap();
    let waiting = tokio::spawn({
        let store = store.clone();
        async move { store.wait_ready(id, PATIENCE).await }
    });
    tokio::task::yield_now().await;
    store.delete(id).await.unwrap();
    assert_eq!(n_waiting(&store, "build"), 0);
    assert_eq!(next_event(&mut events).await, EventKind::Deleted);
    assert_eq!(events.recv().await, Err(RecvError::Closed));
    assert_eq!(frames.recv().await, Err(RecvError::Closed));
    assert!(matches!(waiting.await.unwrap(), Err(StoreError::NoSession(_))));
    assert!(matches!(store.delete(id).await, Err(StoreError::NoSession(_))));
}

#[tokio::test]
async fn deleting_a_session_stops_the_build_that_runs() {
    let store = store();
    let id = store.create(create_bars()).await.unwrap();
    store.delete(id).await.unwrap();
    let is_busy = || store.load().tasks.iter().any(|t| t.n_waiting + t.n_running > 0);
    while is_busy() {
        tokio::task::yield_now().await;
    }
    assert_eq!(store.n_sessions(), 0);
}

#[tokio::test]
async fn a_panic_is_reported_and_does_no_harm() {
    let store = store();
    let failed: Result<(), StoreError> =
        store.compute(Account::Common, "the test", |_| panic!("on purpose")).await;
    assert!(matches!(failed, Err(StoreError::Failed { what: "the test" })));
    assert_eq!(store.compute(Account::Common, "the test", |_| 7).await.unwrap(), 7);
}

#[tokio::test]
async fn sessions_are_listed_in_pages() {
    let store = store();
    let _busy = occupy(&store, BUILD, 1);
    let mut ids: Vec<SessionId> = Vec::new();
    for _ in 0..5 {
        ids.push(store.create(create_bars()).await.unwrap());
    }
    let page = |after, limit| -> Vec<SessionId> {
        store.list(after, limit).iter().map(|info| info.id).collect()
    };
    assert_eq!(page(None, 2), ids[..2]);
    assert_eq!(page(Some(ids[1]), 10), ids[2..]);
    assert_eq!(page(Some(ids[4]), 10), []);
    assert_eq!(ids[0].to_string().parse(), Ok(ids[0]));
}

#[tokio::test]
async fn evaluation_checks_its_poses() {
    let store = store();
    let id = ready(&store).await;
    let r = current(&store, id).artifacts.basis_size();
    let evaluate = |poses: Vec<Vec<f64>>| store.evaluate(id, GenerationRef::Current, poses, false);
    let rest = evaluate(vec![vec![0.0; r]; 2]).await.unwrap();
    assert_eq!((rest.len(), rest[1].energy_j), (2, 0.0));
    let refused = evaluate(vec![vec![0.0; r], vec![0.0; r + 1]]).await;
    assert!(matches!(
        refused,
        Err(StoreError::Input(InputError::PoseLength { pose: 1, given, r: named }))
            if given == r + 1 && named == r
    ));
    let mut pose = vec![0.0; r];
    pose[1] = f64::NAN;
    let refused = evaluate(vec![pose]).await;
    let not_finite = InputError::PoseNotFinite { pose: 0, index: 1 };
    assert!(matches!(refused, Err(StoreError::Input(error)) if error == not_finite));
    let refused = evaluate(vec![vec![1e200; r]]).await;
    let overflows = InputError::PoseOverflows { pose: 0 };
    assert!(matches!(refused, Err(StoreError::Input(error)) if error == overflows));
}

pub(crate) fn simulation() -> SimulationConfig {
    SimulationConfig {
        params: SimulationParams {
            dt_s: 0.002,
            integrator: Integrator::ImplicitNewmark,
            gravity_m_s2: [0.0; 3],
            substep_tolerance: None,
        },
        obstacles: Vec::new(),
        contact: ContactConfig {
            stiffness_pa_m: None,
            damping_s_m: 1.0,
            friction: 0.3,
            creep_m_s: None,
        },
        publish_hz: 1000.0,
    }
}

fn pull(duration_s: f64) -> VertexForce {
    VertexForce { vertex: index(LENGTH, 1, 1), force_n: [0.0, 0.05, 0.0], duration_s }
}

/// Displacement of the vertex that `pull` pulls.
fn displacement(generation: &Generation, frame: &Frame) -> [f64; 3] {
    assert_eq!(generation.number, frame.generation);
    let rows = generation.artifacts.basis_rows(pull(1.0).vertex);
    std::array::from_fn(|axis| {
        rows.iter().zip(&frame.q).map(|(row, &q)| row[axis] * f64::from(q)).sum()
    })
}

#[tokio::test]
async fn a_simulation_moves_under_a_force_and_carries_its_state_over_an_edit() {
    let store = store();
    let id = ready(&store).await;
    let before = current(&store, id);
    let mut events = store.subscribe(id).unwrap();
    let mut frames = store.subscribe_frames(id).unwrap();
    store.put_simulation(id, simulation()).await.unwrap();
    assert_eq!(next_event(&mut events).await, EventKind::SimulationStarted);
    store.push_forces(id, vec![pull(1000.0)]).unwrap();
    while displacement(&before, &*next_frame(&mut frames).await)[1] < 1e-4 {}

    let edit = tokio::spawn({
        let store = store.clone();
        async move { store.edit(id, stitch(&seam())).await }
    });
    let mut last = next_frame(&mut frames).await;
    let first = loop {
        let frame = next_frame(&mut frames).await;
        assert!(frame.sequence > last.sequence && frame.time_s >= last.time_s);
        if frame.generation == 1 {
            break frame;
        }
        last = frame;
    };
    let after = edit.await.unwrap().unwrap();
    assert_eq!(first.time_s, last.time_s);
    // The two frames are one state in two bases.
    let transfer = after.artifacts.transfer_from(&before.artifacts);
    let size = last.q.iter().map(|q| q.abs()).fold(0.0, f32::max);
    for (row, q) in transfer.chunks_exact(last.q.len()).zip(&first.q) {
        let expected: f64 = row.iter().zip(&last.q).map(|(t, &q)| t * f64::from(q)).sum();
        assert!((expected - f64::from(*q)).abs() < 1e-5 * f64::from(size), "{expected} {q}");
    }
    assert_eq!(first.q.len(), after.artifacts.basis_size());

    let info = store.simulation(id).await.unwrap();
    assert_eq!((info.generation, info.n_recovered_steps, info.n_active_forces), (1, 0, 1));
    assert!(info.error.is_none() && info.n_frames > 0 && info.n_steps > 0);
    store.stop_simulation(id).await.unwrap();
    assert!(matches!(store.simulation(id).await, Err(StoreError::NoSimulation)));
}

#[tokio::test]
async fn a_force_ends_by_itself() {
    let store = store();
    let id = ready(&store).await;
    store.put_simulation(id, simulation()).await.unwrap();
    store.push_forces(id, vec![pull(0.003), pull(0.02)]).unwrap();
    assert_eq!(store.simulation(id).await.unwrap().n_active_forces, 2);
    while store.simulation(id).await.unwrap().n_active_forces > 0 {
        tokio::task::yield_now().await;
    }
    assert!(store.simulation(id).await.unwrap().n_steps >= 10);
}

#[tokio::test]
async fn a_running_simulation_can_be_changed() {
    let store = store();
    let id = ready(&store).await;
    store.put_simulation(id, simulation()).await.unwrap();
    let mut config = simulation();
    config.params.dt_s = 0.004;
    let info = store.put_simulation(id, config.clone()).await.unwrap();
    assert_eq!((info.config, store.load().n_simulations), (config, 1));
    let mut frames = store.subscribe_frames(id).unwrap();
    let mut last = next_frame(&mut frames).await;
    // From some frame on, one step lies between two that follow each other.
    loop {
        let frame = next_frame(&mut frames).await;
        let one_step = frame.sequence == last.sequence + 1;
        if one_step && (frame.time_s - last.time_s - 0.004).abs() < 1e-9 {
            break;
        }
        last = frame;
    }
}

#[tokio::test]
async fn a_simulation_that_loses_its_support_ends_and_says_why() {
    let store = store();
    let mut request = create_bars();
    request.params.fixed_vertices = section(0, 0).collect();
    let id = store.create(request).await.unwrap();
    store.wait_ready(id, PATIENCE).await.unwrap();
    let refused = store.put_simulation(id, simulation()).await;
    assert!(matches!(
        refused,
        Err(StoreError::Simulation(SimulationError::PartlyFree { n_rigid_modes: 6 }))
    ));
    let stitched = store.edit(id, stitch(&seam())).await.unwrap();
    store.put_simulation(id, simulation()).await.unwrap();
    let mut events = store.subscribe(id).unwrap();
    let unstitch = EditRequest {
        edits: vec![Edit::Unstitch { stitch_ids: stitched.stitch_ids.clone() }],
        ..stitch(&[])
    };
    store.edit(id, unstitch).await.unwrap();
    while next_event(&mut events).await != EventKind::SimulationStopped {}
    let info = store.simulation(id).await.unwrap();
    assert!(info.error.unwrap().to_string().contains("rigid motions"));
    let refused = store.push_forces(id, vec![pull(1.0)]);
    assert!(matches!(refused, Err(StoreError::NoSimulation)));
}

#[tokio::test]
async fn generations_are_undone_redone_and_edited_again() {
    let store = store();
    let id = ready(&store).await;
    let pairs = seam();
    let first = store.edit(id, stitch(&pairs[..2])).await.unwrap();
    let second = store.edit(id, stitch(&pairs[2..4])).await.unwrap();
    let restore = |generation| EditRequest { restore: Some(generation), ..stitch(&[]) };
    let bare = |generation| EditRequest { edits: Vec::new(), ..restore(generation) };

    let undone = store.edit(id, bare(1)).await.unwrap();
    assert_eq!(undone.number, 3);
    assert!(Arc::ptr_eq(&undone.artifacts, &first.artifacts));
    let redone = store.edit(id, bare(2)).await.unwrap();
    assert!(Arc::ptr_eq(&redone.artifacts, &second.artifacts));

    let other = EditRequest { restore: Some(0), ..stitch(&pairs[..1]) };
    let other = store.edit(id, other).await.unwrap();
    assert_eq!((other.number, other.artifacts.stitches().len()), (5, 1));

    let missing = store.edit(id, bare(77)).await;
    assert!(matches!(missing, Err(StoreError::NoGeneration { number: 77, .. })));
    assert_eq!(store.generation(id, GenerationRef::Current).unwrap().number, 5);
}

#[tokio::test]
async fn simulations_and_forces_are_limited() {
    let limits = Limits { max_simulations: 1, max_active_forces: 1, ..Limits::default() };
    let store = store_with(WorkConfig::default(), limits);
    let (a, b) = (ready(&store).await, ready(&store).await);
    store.put_simulation(a, simulation()).await.unwrap();
    let full = store.put_simulation(b, simulation()).await;
    assert!(matches!(full, Err(StoreError::Full { what: "simulations", limit: 1 })));
    store.push_forces(a, vec![pull(1000.0)]).unwrap();
    let full = store.push_forces(a, vec![pull(1000.0)]);
    assert!(matches!(full, Err(StoreError::Full { what: "active forces", limit: 1 })));
    store.stop_simulation(a).await.unwrap();
    store.put_simulation(b, simulation()).await.unwrap();
    let mut bad = simulation();
    bad.params.dt_s = f64::NAN;
    let refused = store.put_simulation(b, bad).await;
    assert!(matches!(refused, Err(StoreError::Input(InputError::TimeStep { .. }))));
    let mut bad = simulation();
    bad.params.substep_tolerance = Some(1.0);
    let refused = store.put_simulation(b, bad).await;
    let expected = SimulationError::SubstepTolerance(1.0);
    assert!(matches!(refused, Err(StoreError::Simulation(error)) if error == expected));
    let force = VertexForce { vertex: u32::MAX, ..pull(1.0) };
    let refused = store.push_forces(b, vec![pull(1.0), force]);
    assert!(matches!(
        refused,
        Err(StoreError::Input(InputError::ForceVertex { force: 1, vertex: u32::MAX, .. }))
    ));
}

#[tokio::test]
async fn shutting_down_refuses_new_work_and_releases_whoever_waits() {
    let store = store();
    let busy = occupy(&store, BUILD, 1);
    let id = store.create(create_bars()).await.unwrap();
    let mut events = store.subscribe(id).unwrap();
    drop(busy);
    assert!(store.shutdown(PATIENCE).await);
    assert!(matches!(store.create(create_bars()).await, Err(StoreError::ShuttingDown)));
    assert!(matches!(
        store.compute(Account::Common, "nothing", |_| ()).await,
        Err(StoreError::ShuttingDown)
    ));
    store.wait_ready(id, PATIENCE).await.unwrap();
    while events.recv().await.is_ok() {}
}
