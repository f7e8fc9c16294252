//! The interface of the store.

use crate::archive::{Archive, Beginning, Journal};
use crate::check;
use crate::config::StoreConfig;
use crate::error::StoreError;
use crate::event::Event;
use crate::fleet::Fleet;
use crate::keeping::Keeper;
use crate::live::{LiveSession, Owner, Surroundings};
use crate::pool::{Account, CancelFlag, Place, Pool};
use crate::prepared::PreparedBodies;
use crate::session::{
    CreateSession, EditRequest, Generation, GenerationRef, MeshSize, SessionId, SessionInfo,
    SessionState,
};
use crate::simulation::{Frame, GrabConfig, SimulationConfig, SimulationInfo, VertexForce};
use crate::stepping::{SimulationHandle, SteppingThreads};
use crate::storage::{Storage, StorageError};
use crate::tasks::{run_build, run_edit};
use crate::work::{self, BUILD, EDIT, QUERY, RESTORE};
use std::collections::BTreeMap;
use std::ops::Bound;
use std::sync::{Arc, Mutex, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::{Duration, Instant};
use sutura_core::build::check_seams;
use sutura_core::reduced::Evaluation;
use tokio::sync::{broadcast, oneshot};

/// How long cancelled work may take to notice before [`Store::shutdown`] goes without it.
const CANCEL_GRACE: Duration = Duration::from_secs(2);

/// Every session of this daemon. Cheap to clone; all clones are the same store.
///
/// Methods that are not `async` return at once. An `async` method computes on the store's own
/// threads; dropping its future cancels the work.
#[derive(Clone)]
pub struct Store {
    pub(crate) shared: Arc<Shared>,
}

pub(crate) struct Shared {
    pub(crate) config: StoreConfig,
    pub(crate) sessions: RwLock<BTreeMap<SessionId, Arc<LiveSession>>>,
    pub(crate) surroundings: Surroundings,
    pub(crate) prepared: Arc<PreparedBodies>,
    pub(crate) builds: Pool,
    pub(crate) queries: Pool,
    pub(crate) stepping: SteppingThreads,
    /// What outlives the process, if anything does.
    pub(crate) archive: Option<Arc<Archive>>,
    /// The last name that a session was given.
    pub(crate) newest: Mutex<Option<SessionId>>,
    /// What other daemons have to do with it.
    pub(crate) fleet: Fleet,
    /// Looks which sessions' bodies are to be kept.
    pub(crate) keeper: Keeper,
}

/// Why a store could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The storage cannot be read.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The threads could not be started.
    #[error("cannot start the worker threads: {0}")]
    Threads(#[from] std::io::Error),
}

impl Store {
    /// Starts the store's threads. Sessions are kept in memory alone.
    pub fn new(config: StoreConfig) -> std::io::Result<Store> {
        Self::with(config, None)
    }

    /// Starts the store's threads and finds the sessions that `storage` keeps. All are there at once; their
    /// bodies are restored one by one, the last used first, and whenever one is asked for. Blocks.
    pub fn open(config: StoreConfig, storage: Arc<dyn Storage>) -> Result<Store, OpenError> {
        let (archive, found) = Archive::open(storage, config.keeping.max_body_bytes)?;
        let store = Self::with(config, Some(archive))?;
        store.shared.adopt(found);
        store.shared.start_keeping()?;
        store.shared.watch_fleet()?;
        Ok(store)
    }

    fn with(config: StoreConfig, archive: Option<Arc<Archive>>) -> std::io::Result<Store> {
        let work = &config.work;
        let surroundings = Surroundings {
            events_of_all: broadcast::Sender::new(work.event_backlog.max(1)),
            event_backlog: work.event_backlog.max(1),
            frame_backlog: work.frame_backlog.max(1),
            n_kept_generations: work.n_kept_generations.max(1),
            n_uses: Arc::default(),
        };
        let shared = Shared {
            sessions: RwLock::default(),
            surroundings,
            prepared: Arc::new(PreparedBodies::new(archive.clone())),
            builds: work::builds(work)?,
            queries: work::queries(work)?,
            stepping: SteppingThreads::start(work.n_stepping_threads, work.stepping_queue_limit)?,
            archive,
            newest: Mutex::default(),
            fleet: Fleet::default(),
            keeper: Keeper::default(),
            config,
        };
        Ok(Store { shared: Arc::new(shared) })
    }

    /// The configuration in force.
    pub fn config(&self) -> &StoreConfig {
        &self.shared.config
    }

    /// Opens a session and queues its build.
    pub async fn create(&self, request: CreateSession) -> Result<SessionId, StoreError> {
        check::create(&request, &self.shared.config.limits)?;
        let account = Account::of(request.tenant.as_deref());
        self.keep(account, "opening a session", move |store| store.create_now(request)).await
    }

    fn create_now(&self, request: CreateSession) -> Result<SessionId, StoreError> {
        let shared = &self.shared;
        let CreateSession { name, tenant, mesh, params } = request;
        let id = shared.new_id();
        let beginning = Beginning {
            name: &name,
            tenant: tenant.as_deref(),
            mesh: &mesh,
            params: &params,
            generations: Vec::new(),
            seams: Vec::new(),
        };
        let journal = self.begin_journal(id, &beginning)?;
        let size = MeshSize::of(&mesh);
        let surroundings = shared.surroundings.clone();
        let session =
            Arc::new(LiveSession::new(id, Owner { name, tenant }, size, journal, surroundings));
        let task = {
            let (session, prepared) = (session.clone(), shared.prepared.clone());
            let interval = shared.config.work.progress_interval;
            let store = Arc::downgrade(shared);
            move |cancel: &CancelFlag| {
                let Some(store) = store.upgrade() else { return };
                let admits = |n_bytes: usize| store.make_room(n_bytes, id);
                run_build(&session, mesh, &params, &prepared, interval, cancel, &admits);
                store.follow_up(&session);
            }
        };
        let place = Place::new(BUILD).in_lane(id).charged_to(session.account());
        self.insert_whole(session, || shared.builds.submit(place, task).map(drop))?;
        Ok(id)
    }

    /// A session's journal, if there is an archive and room for another session.
    fn begin_journal(
        &self,
        id: SessionId,
        beginning: &Beginning<'_>,
    ) -> Result<Option<Journal>, StoreError> {
        let Some(archive) = &self.shared.archive else { return Ok(None) };
        // Before anything is written; whoever comes in between is refused behind it.
        let limit = self.shared.config.limits.max_sessions;
        if self.n_sessions() >= limit {
            return Err(StoreError::Full { what: "sessions", limit });
        }
        archive.begin(id, beginning).map(Some)
    }

    /// What is known of a session now.
    pub fn info(&self, id: SessionId) -> Result<SessionInfo, StoreError> {
        Ok(self.session(id)?.info())
    }

    /// Whose the session is; `None` if it was opened where nobody was asked.
    pub fn tenant(&self, id: SessionId) -> Result<Option<String>, StoreError> {
        Ok(self.session(id)?.tenant().map(str::to_owned))
    }

    /// Whose turns the session's work takes.
    pub fn account(&self, id: SessionId) -> Result<Account, StoreError> {
        Ok(self.session(id)?.account())
    }

    /// At most `limit` sessions in the order of creation, beginning behind `after`.
    pub fn list(&self, after: Option<SessionId>, limit: usize) -> Vec<SessionInfo> {
        self.list_if(after, limit, |_| true)
    }

    /// The same of one tenant.
    pub fn list_of(
        &self,
        tenant: &str,
        after: Option<SessionId>,
        limit: usize,
    ) -> Vec<SessionInfo> {
        self.list_if(after, limit, |session| session.tenant() == Some(tenant))
    }

    fn list_if(
        &self,
        after: Option<SessionId>,
        limit: usize,
        is_listed: impl Fn(&LiveSession) -> bool,
    ) -> Vec<SessionInfo> {
        let begin = after.map_or(Bound::Unbounded, Bound::Excluded);
        let page: Vec<Arc<LiveSession>> = self
            .sessions()
            .range((begin, Bound::Unbounded))
            .filter(|(_, session)| is_listed(session))
            .take(limit)
            .map(|(_, session)| session.clone())
            .collect();
        page.iter().map(|session| session.info()).collect()
    }

    /// Number of sessions.
    pub fn n_sessions(&self) -> usize {
        self.sessions().len()
    }

    /// Returns once the session's build has ended, well or badly, or after `timeout`; the state in
    /// the answer tells which.
    pub async fn wait_ready(
        &self,
        id: SessionId,
        timeout: Duration,
    ) -> Result<SessionInfo, StoreError> {
        let session = self.session(id)?;
        // Whether it can be restored, and whether it settled in time shows in the state.
        let _ = tokio::time::timeout(timeout, async {
            let _ = self.wake(id).await;
            session.settled().await;
        })
        .await;
        self.info(id)
    }

    /// Ends a session with everything that runs for it, for good.
    pub async fn delete(&self, id: SessionId) -> Result<(), StoreError> {
        let account = self.account(id)?;
        self.keep(account, "deleting a session", move |store| store.delete_now(id)).await
    }

    fn delete_now(&self, id: SessionId) -> Result<(), StoreError> {
        let session = self.session(id)?;
        let journal = session.journal.as_ref();
        self.shared.heed(&session, journal.map_or(Ok(()), Journal::delete))?;
        self.sessions_mut().remove(&id).ok_or(StoreError::NoSession(id))?;
        let leftovers = session.delete();
        self.shared.builds.cancel_lane(id);
        tracing::info!(session = %id, "session deleted");
        self.drop_later(leftovers);
        Ok(())
    }

    /// A new session with the same generations, sharing every artifact; not simulated. It takes
    /// the name of the old one unless it is given its own.
    pub async fn fork(&self, id: SessionId, name: Option<String>) -> Result<SessionId, StoreError> {
        if let Some(name) = &name {
            check::name(name, &self.shared.config.limits)?;
        }
        self.wake(id).await?;
        self.keep(self.account(id)?, "forking a session", move |store| store.fork_now(id, name))
            .await
    }

    fn fork_now(&self, id: SessionId, name: Option<String>) -> Result<SessionId, StoreError> {
        let session = self.session(id)?;
        let name = name.unwrap_or_else(|| session.name().to_owned());
        let (generations, seams) = session.kept()?;
        let fork_id = self.shared.new_id();
        let journal = match generations.first() {
            None => None,
            Some(generation) => {
                let body = &generation.artifacts;
                let beginning = Beginning {
                    name: &name,
                    tenant: session.tenant(),
                    mesh: body.mesh(),
                    params: body.params(),
                    generations: generations.clone(),
                    seams: seams.clone(),
                };
                self.begin_journal(fork_id, &beginning)?
            }
        };
        let owner = Owner { name, tenant: session.tenant().map(str::to_owned) };
        let fork = session.fork(fork_id, owner, journal, generations, seams);
        self.insert_whole(Arc::new(fork), || Ok(()))?;
        tracing::info!(session = %fork_id, origin = %id, "session forked");
        Ok(fork_id)
    }

    /// Makes the next generation. Edits of one session run one after another.
    pub async fn edit(
        &self,
        id: SessionId,
        request: EditRequest,
    ) -> Result<Arc<Generation>, StoreError> {
        let shared = &self.shared;
        let arrived = Instant::now();
        let session = self.session(id)?;
        check::edit(&request, &shared.config.limits)?;
        self.wake(id).await?;
        session.check_editable(request.base_generation)?;
        let (reply, answer) = oneshot::channel();
        let store = Arc::downgrade(shared);
        let (config, edited) = (shared.config.clone(), session.clone());
        // What is being improved is about to change.
        session.cancel_improvement();
        let place = Place::new(EDIT).in_lane(id).charged_to(session.account());
        let ticket = shared.builds.submit(place, move |cancel| {
            let Some(store) = store.upgrade() else { return };
            // The caller's time began when the request came.
            let deadline = request.deadline.map(|time| time.saturating_sub(arrived.elapsed()));
            let request = EditRequest { deadline, ..request };
            let bring_back = || store.restore(&edited, cancel);
            let admits = |n_bytes: usize| store.make_room(n_bytes, id);
            run_edit(&edited, &request, &config, cancel, reply, bring_back, &admits);
            store.follow_up(&edited);
        })?;
        let ticket = ticket.cancel_on_drop();
        shared.heed(&session, ticket.answer(answer).await)
    }

    /// Names candidate pairs: they are prepared in the background, for this base body and those that
    /// edits replace it by, until which edits of them cost solves. Returns how many the session has
    /// named so far.
    pub async fn add_seams(
        &self,
        id: SessionId,
        pairs: Vec<[u32; 2]>,
    ) -> Result<usize, StoreError> {
        self.wake(id).await?;
        self.keep(self.account(id)?, "naming seams", move |store| store.add_seams_now(id, &pairs))
            .await
    }

    fn add_seams_now(&self, id: SessionId, pairs: &[[u32; 2]]) -> Result<usize, StoreError> {
        let shared = &self.shared;
        let session = self.session(id)?;
        let generation = session.generation(GenerationRef::Current)?;
        let named = session.seams().len() + generation.artifacts.params().seams.len();
        check::seams(named + pairs.len(), &shared.config.limits)?;
        check_seams(&generation.artifacts, pairs)?;
        let journal = session.journal.as_ref();
        shared.heed(&session, journal.map_or(Ok(()), |journal| journal.add_seams(pairs)))?;
        let n_named = session.add_seams(pairs) + generation.artifacts.params().seams.len();
        shared.prepare_seams_later(&session);
        Ok(n_named)
    }

    /// Returns once the session's body is in memory, restored if need be. A session that is being built, or
    /// could not be, is left as it is.
    pub async fn wake(&self, id: SessionId) -> Result<(), StoreError> {
        let session = self.session(id)?;
        session.touch();
        if !matches!(session.state(), SessionState::Stored | SessionState::Restoring) {
            return Ok(());
        }
        let (reply, answer) = oneshot::channel();
        let store = Arc::downgrade(&self.shared);
        // Not cancelled when the caller goes: others wait for it too.
        let place = Place::new(RESTORE).in_lane(id).charged_to(session.account());
        let ticket = self.shared.builds.submit(place, move |cancel| {
            if let Some(store) = store.upgrade() {
                let _ = reply.send(store.restore(&session, cancel));
                store.follow_up(&session);
            }
        })?;
        ticket.answer(answer).await
    }

    /// A generation of a session whose body may have to be restored for it.
    pub async fn fetch(
        &self,
        id: SessionId,
        which: GenerationRef,
    ) -> Result<Arc<Generation>, StoreError> {
        self.wake(id).await?;
        self.generation(id, which)
    }

    /// A generation of a session whose body is in memory.
    pub fn generation(
        &self,
        id: SessionId,
        which: GenerationRef,
    ) -> Result<Arc<Generation>, StoreError> {
        self.session(id)?.generation(which)
    }

    /// Energy, force and stiffness at each of `poses` (r numbers each), by cubature or, if `exact`,
    /// summed over every tet.
    pub async fn evaluate(
        &self,
        id: SessionId,
        which: GenerationRef,
        poses: Vec<Vec<f64>>,
        exact: bool,
    ) -> Result<Vec<Evaluation>, StoreError> {
        let generation = self.fetch(id, which).await?;
        check::poses(&poses, generation.artifacts.basis_size(), &self.shared.config.limits)?;
        let evaluate_all = move |cancel: &CancelFlag| {
            let mut evaluations = Vec::with_capacity(poses.len());
            for (pose, q) in poses.iter().enumerate() {
                if cancel.is_set() {
                    return Err(StoreError::Cancelled);
                }
                let evaluation = if exact {
                    generation.artifacts.evaluate_exact(q)
                } else {
                    generation.artifacts.model().evaluate(q)
                };
                check::evaluation(pose, &evaluation)?;
                evaluations.push(evaluation);
            }
            Ok(evaluations)
        };
        let place = Place::new(QUERY).charged_to(self.account(id)?);
        self.shared.queries.run(place, "the evaluation", evaluate_all).await
    }

    /// Starts the session's simulation at rest, or changes how the running one goes on. Obstacles are there
    /// when the answer is.
    pub async fn put_simulation(
        &self,
        id: SessionId,
        config: SimulationConfig,
    ) -> Result<SimulationInfo, StoreError> {
        check::simulation(&config, &self.shared.config.limits)?;
        self.wake(id).await?;
        let has_obstacles = !config.obstacles.is_empty();
        let account = self.account(id)?;
        let keep = self.keep(account.clone(), "starting a simulation", move |store| {
            let session = store.session(id)?;
            let before = session.simulation().ok().map(|simulation| simulation.info().config);
            let keep = |config: Option<&SimulationConfig>| {
                let journal = session.journal.as_ref();
                let kept = journal.map_or(Ok(()), |journal| journal.set_simulation(config));
                store.shared.heed(&session, kept)
            };
            keep(Some(&config))?;
            let simulated = store.shared.simulate(&session, &config);
            if simulated.is_err() {
                keep(before.as_ref())?;
            }
            simulated
        });
        let handle = keep.await?;
        if has_obstacles {
            let handle = handle.clone();
            self.compute(account, "the surface", move |_| handle.update_surface()).await?;
        }
        Ok(handle.info())
    }

    /// What is known of the session's simulation now.
    pub async fn simulation(&self, id: SessionId) -> Result<SimulationInfo, StoreError> {
        self.wake(id).await?;
        Ok(self.session(id)?.simulation()?.info())
    }

    /// Ends the session's simulation.
    pub async fn stop_simulation(&self, id: SessionId) -> Result<(), StoreError> {
        self.wake(id).await?;
        self.keep(self.account(id)?, "ending a simulation", move |store| {
            let session = store.session(id)?;
            session.simulation()?;
            let journal = session.journal.as_ref();
            let kept = journal.map_or(Ok(()), |journal| journal.set_simulation(None));
            store.shared.heed(&session, kept)?;
            session.stop_simulation()
        })
        .await
    }

    /// Lets forces act on the running simulation from its next step on.
    pub fn push_forces(&self, id: SessionId, forces: Vec<VertexForce>) -> Result<(), StoreError> {
        let limits = &self.shared.config.limits;
        let session = self.session(id)?;
        let n_vertices = session.info().size.n_vertices;
        check::forces(&forces, n_vertices, limits)?;
        let simulation = session.simulation()?;
        if !simulation.is_running() {
            return Err(StoreError::NoSimulation);
        }
        simulation.push_forces(forces, limits.max_active_forces)
    }

    /// Lets grabs take hold of vertices of the running simulation, moves those of the same names, and lets those
    /// named in `release` go.
    pub fn grab(
        &self,
        id: SessionId,
        grabs: Vec<GrabConfig>,
        release: Vec<u64>,
    ) -> Result<(), StoreError> {
        let limits = &self.shared.config.limits;
        let session = self.session(id)?;
        let n_vertices = session.info().size.n_vertices;
        check::grabs(&grabs, release.len(), n_vertices, limits)?;
        let simulation = session.simulation()?;
        if !simulation.is_running() {
            return Err(StoreError::NoSimulation);
        }
        simulation.grab(grabs, release, limits.max_grabs)
    }

    /// The frames of the session's present and future simulations. Ends when the session does.
    pub fn subscribe_frames(
        &self,
        id: SessionId,
    ) -> Result<broadcast::Receiver<Arc<Frame>>, StoreError> {
        self.session(id)?.subscribe_frames()
    }

    /// What happens to the session. Ends when the session does.
    pub fn subscribe(&self, id: SessionId) -> Result<broadcast::Receiver<Event>, StoreError> {
        self.session(id)?.subscribe()
    }

    /// What happens to any session. A subscriber that fell behind can start again from
    /// [`Store::list`].
    pub fn subscribe_all(&self) -> broadcast::Receiver<Event> {
        self.shared.surroundings.events_of_all.subscribe()
    }

    /// Takes no new work, cancels builds and what waits, lets running edits and queries finish
    /// until `deadline` has passed and then cancels them too. Then simulations and subscriptions
    /// end. Tells whether all work has ended.
    pub async fn shutdown(&self, deadline: Duration) -> bool {
        let shared = self.shared.clone();
        let deadline = Instant::now() + deadline;
        let join = tokio::task::spawn_blocking(move || {
            shared.builds.close(&[BUILD]);
            shared.queries.close(&[]);
            let edits_ended = shared.builds.join(deadline, CANCEL_GRACE);
            let queries_ended = shared.queries.join(deadline, CANCEL_GRACE);
            shared.keep_the_rest(deadline);
            queries_ended && edits_ended
        });
        let ended = join.await.unwrap_or(false);
        self.sessions().values().for_each(|session| session.close());
        ended
    }

    #[cfg(test)]
    pub(crate) fn builds(&self) -> &Pool {
        &self.shared.builds
    }

    pub(crate) fn sessions(&self) -> RwLockReadGuard<'_, BTreeMap<SessionId, Arc<LiveSession>>> {
        self.shared.sessions.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn sessions_mut(&self) -> RwLockWriteGuard<'_, BTreeMap<SessionId, Arc<LiveSession>>> {
        self.shared.sessions.write().unwrap_or_else(PoisonError::into_inner)
    }

    fn session(&self, id: SessionId) -> Result<Arc<LiveSession>, StoreError> {
        self.sessions().get(&id).cloned().ok_or(StoreError::NoSession(id))
    }

    /// Adds a session if there is room and `admit` lets it in.
    pub(crate) fn insert(
        &self,
        session: Arc<LiveSession>,
        admit: impl FnOnce() -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let limit = self.shared.config.limits.max_sessions;
        let mut sessions = self.sessions_mut();
        if sessions.len() >= limit {
            return Err(StoreError::Full { what: "sessions", limit });
        }
        session.announce(admit)?;
        sessions.insert(session.id, session);
        Ok(())
    }

    /// Adds a session, or leaves nothing of it behind.
    fn insert_whole(
        &self,
        session: Arc<LiveSession>,
        admit: impl FnOnce() -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let inserted = self.insert(session.clone(), admit);
        if let (Err(_), Some(journal)) = (&inserted, &session.journal) {
            journal.delete()?;
        }
        inserted
    }
}

impl Shared {
    /// Starts a session's simulation, or changes how it goes on.
    pub(crate) fn simulate(
        &self,
        session: &Arc<LiveSession>,
        config: &SimulationConfig,
    ) -> Result<Arc<SimulationHandle>, StoreError> {
        let limit = self.config.limits.max_simulations;
        session.put_simulation(
            |running| running.configure(config.clone()),
            |generation, frames| {
                let session = Arc::downgrade(session);
                let on_failure = move || {
                    if let Some(session) = session.upgrade() {
                        session.simulation_failed();
                    }
                };
                self.stepping.add(generation, config.clone(), frames, limit, on_failure)
            },
        )
    }
}
