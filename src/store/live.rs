//! A session's mutable side: one lock, held only to read or swap pointers.
//!
//! Events are sent under the lock, so subscribers hear of changes in the order in which they
//! happened. Generations are inserted whole and never changed.

use crate::archive::{Found, Journal};
use crate::chores::Chores;
use crate::error::StoreError;
use crate::event::{Event, EventKind};
use crate::pool::{Account, CancelOnDrop, catching};
use crate::session::{
    Generation, GenerationRef, MeshSize, Progress, SessionId, SessionInfo, SessionState,
};
use crate::simulation::{Frame, FrameSource, SimulationConfig};
use crate::stepping::SimulationHandle;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{broadcast, watch};

/// Where a new session's events go, and what it may keep.
#[derive(Clone)]
pub(crate) struct Surroundings {
    /// Hears the events of every session.
    pub(crate) events_of_all: broadcast::Sender<Event>,
    /// See [`crate::WorkConfig`].
    pub(crate) event_backlog: usize,
    /// See [`crate::WorkConfig`].
    pub(crate) frame_backlog: usize,
    /// See [`crate::WorkConfig`].
    pub(crate) n_kept_generations: usize,
    /// Gives the order in which sessions were used.
    pub(crate) n_uses: Arc<AtomicU64>,
}

/// A session as the store keeps it.
pub(crate) struct LiveSession {
    pub(crate) id: SessionId,
    owner: Owner,
    surroundings: Surroundings,
    /// What outlives the process, if anything does.
    pub(crate) journal: Option<Journal>,
    size: MeshSize,
    /// When it was used last, in uses of any session.
    last_use: AtomicU64,
    /// What waits to be done for it when nobody else wants the threads.
    pub(crate) chores: Chores,
    inner: Mutex<Inner>,
    /// Becomes true when the build has ended, well or badly, or the session is gone.
    settled: watch::Sender<bool>,
}

struct Inner {
    state: SessionState,
    progress: Option<Progress>,
    /// The current generation's number, in memory or not.
    number: u64,
    generations: BTreeMap<u64, Arc<Generation>>,
    error: Option<Arc<StoreError>>,
    /// Candidate pairs named since the session was opened, ends ascending.
    seams: BTreeSet<[u32; 2]>,
    /// The task that finishes the current generation.
    improvement: Option<CancelOnDrop>,
    /// A base body that holds the stitches is being prepared.
    is_rebasing: bool,
    simulation: Option<Arc<SimulationHandle>>,
    /// Since when there are generations whose bodies are perhaps not kept.
    unkept: Option<Instant>,
    /// How an earlier process simulated the session: until it is restored.
    simulation_config: Option<SimulationConfig>,
    /// `None` once the session is deleted.
    channels: Option<Channels>,
}

struct Channels {
    events: broadcast::Sender<Event>,
    frames: Arc<FrameSource>,
}

/// What a change left over: to be dropped where freeing large memory holds up nobody.
pub(crate) type Leftovers = BTreeMap<u64, Arc<Generation>>;

/// What a session is called, and whose it is.
pub(crate) struct Owner {
    pub(crate) name: String,
    pub(crate) tenant: Option<String>,
}

/// Generations in the order of their numbers, and candidate pairs.
pub(crate) type Kept = (Vec<Arc<Generation>>, Vec<[u32; 2]>);

impl LiveSession {
    /// A session whose build is about to be queued.
    pub(crate) fn new(
        id: SessionId,
        owner: Owner,
        size: MeshSize,
        journal: Option<Journal>,
        surroundings: Surroundings,
    ) -> Self {
        Self::with(id, owner, size, journal, SessionState::Building, surroundings)
    }

    /// A session of an earlier process.
    pub(crate) fn found(found: Found, surroundings: Surroundings) -> Self {
        let Found { journal, contents, .. } = found;
        let id = journal.id();
        match contents {
            Ok(contents) => {
                let size = contents.size();
                let owner = Owner {
                    name: contents.session.name.clone(),
                    tenant: contents.session.tenant.clone(),
                };
                let number = contents.generation();
                let state = SessionState::Stored;
                let session = Self::with(id, owner, size, Some(journal), state, surroundings);
                {
                    let mut inner = session.lock();
                    inner.number = number;
                    inner.seams.extend(contents.seams);
                    inner.simulation_config = contents.simulation;
                }
                session
            }
            Err(error) => {
                tracing::error!(session = %id, %error, "the session cannot be restored");
                let owner = Owner { name: "unreadable".to_owned(), tenant: None };
                let size = MeshSize { n_vertices: 0, n_tets: 0, n_domains: 0, n_components: 0 };
                let state = SessionState::Failed;
                let session = Self::with(id, owner, size, Some(journal), state, surroundings);
                session.lock().error = Some(Arc::new(error));
                session
            }
        }
    }

    /// The generations and seams that a fork begins with.
    pub(crate) fn kept(&self) -> Result<Kept, StoreError> {
        let inner = self.lock();
        inner.current()?;
        let generations = inner.generations.values().cloned().collect();
        Ok((generations, inner.seams.iter().copied().collect()))
    }

    /// A session that starts with these generations of this one.
    pub(crate) fn fork(
        &self,
        id: SessionId,
        owner: Owner,
        journal: Option<Journal>,
        generations: Vec<Arc<Generation>>,
        seams: Vec<[u32; 2]>,
    ) -> Self {
        let (state, surroundings) = (SessionState::Ready, self.surroundings.clone());
        let fork = Self::with(id, owner, self.size, journal, state, surroundings);
        {
            let mut inner = fork.lock();
            inner.seams.extend(seams);
            inner.keep(generations);
        }
        fork
    }

    fn with(
        id: SessionId,
        owner: Owner,
        size: MeshSize,
        journal: Option<Journal>,
        state: SessionState,
        surroundings: Surroundings,
    ) -> Self {
        let channels = Channels {
            events: broadcast::Sender::new(surroundings.event_backlog),
            frames: Arc::new(FrameSource::new(surroundings.frame_backlog)),
        };
        Self {
            id,
            owner,
            journal,
            size,
            last_use: AtomicU64::new(surroundings.n_uses.fetch_add(1, Ordering::Relaxed)),
            surroundings,
            chores: Chores::default(),
            inner: Mutex::new(Inner {
                state,
                progress: None,
                number: 0,
                generations: BTreeMap::new(),
                error: None,
                seams: BTreeSet::new(),
                improvement: None,
                is_rebasing: false,
                simulation: None,
                unkept: None,
                simulation_config: None,
                channels: Some(channels),
            }),
            settled: watch::Sender::new(state != SessionState::Building),
        }
    }

    /// Somebody uses the body.
    pub(crate) fn touch(&self) {
        let now = self.surroundings.n_uses.fetch_add(1, Ordering::Relaxed);
        self.last_use.store(now, Ordering::Relaxed);
    }

    /// When somebody did so last: larger is later.
    pub(crate) fn last_use(&self) -> u64 {
        self.last_use.load(Ordering::Relaxed)
    }

    /// The generations in memory.
    pub(crate) fn in_memory(&self) -> Vec<Arc<Generation>> {
        self.lock().generations.values().cloned().collect()
    }

    /// Whether the session has been as it is for so long, and its bodies are perhaps not kept.
    pub(crate) fn is_unkept_for(&self, rest: Duration) -> bool {
        let inner = self.lock();
        inner.state == SessionState::Ready
            && inner.unkept.is_some_and(|since| since.elapsed() >= rest)
    }

    /// The generations in memory, whose bodies the caller keeps now.
    pub(crate) fn begin_keeping(&self) -> Vec<Arc<Generation>> {
        let mut inner = self.lock();
        inner.unkept = None;
        inner.generations.values().cloned().collect()
    }

    /// Whether nothing is done with the body now.
    pub(crate) fn is_idle(&self) -> bool {
        self.lock().is_idle()
    }

    /// Takes the body out of memory, if it can be made again and nothing is done with it now.
    pub(crate) fn evict(&self) -> Option<Leftovers> {
        let mut inner = self.lock();
        if self.journal.is_none() || !inner.is_idle() {
            return None;
        }
        self.set_state(&mut inner, SessionState::Stored);
        Some(std::mem::take(&mut inner.generations))
    }

    /// Its name for people.
    pub(crate) fn name(&self) -> &str {
        &self.owner.name
    }

    /// Whose it is.
    pub(crate) fn tenant(&self) -> Option<&str> {
        self.owner.tenant.as_deref()
    }

    /// Whose turns its work takes.
    pub(crate) fn account(&self) -> Account {
        self.tenant().map_or(Account::Session(self.id), |tenant| Account::of(Some(tenant)))
    }

    pub(crate) fn state(&self) -> SessionState {
        self.lock().state
    }

    /// Begins to restore the body, if it is not in memory. Its end is [`LiveSession::restored`].
    pub(crate) fn begin_restore(&self) -> bool {
        let mut inner = self.lock();
        let begins = inner.state == SessionState::Stored && inner.channels.is_some();
        if begins {
            self.set_state(&mut inner, SessionState::Restoring);
        }
        begins
    }

    /// Ends what [`LiveSession::begin_restore`] began. The body is in memory again; or it never will be;
    /// or another try may do better (`Err(None)`).
    pub(crate) fn restored(&self, outcome: Result<Vec<Arc<Generation>>, Option<StoreError>>) {
        let mut inner = self.lock();
        let state = match outcome {
            Ok(generations) => {
                inner.keep(generations);
                SessionState::Ready
            }
            Err(Some(error)) => {
                inner.error = Some(Arc::new(error));
                SessionState::Failed
            }
            Err(None) => SessionState::Stored,
        };
        self.set_state(&mut inner, state);
    }

    /// How the session was simulated in an earlier process.
    pub(crate) fn take_simulation_config(&self) -> Option<SimulationConfig> {
        self.lock().simulation_config.take()
    }

    /// Whether it was.
    pub(crate) fn has_simulation_config(&self) -> bool {
        self.lock().simulation_config.is_some()
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn emit(&self, inner: &Inner, kind: EventKind) {
        if let Some(channels) = &inner.channels {
            let event = Event { session: self.id, kind };
            // Sending fails only when nobody listens.
            let _ = channels.events.send(event);
            let _ = self.surroundings.events_of_all.send(event);
        }
    }

    fn set_state(&self, inner: &mut Inner, state: SessionState) {
        inner.state = state;
        inner.progress = None;
        self.emit(inner, EventKind::State(state));
    }

    /// Announces the session if `admit` lets it in; no other event can come first.
    pub(crate) fn announce(
        &self,
        admit: impl FnOnce() -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let inner = self.lock();
        admit()?;
        self.emit(&inner, EventKind::Created);
        Ok(())
    }

    pub(crate) fn info(&self) -> SessionInfo {
        let inner = self.lock();
        SessionInfo {
            id: self.id,
            name: self.owner.name.clone(),
            tenant: self.tenant().map(str::to_owned),
            state: inner.state,
            progress: inner.progress,
            size: self.size,
            generation_number: inner.number,
            oldest_generation: inner.generations.keys().next().copied(),
            generation: inner.generations.values().next_back().cloned(),
            error: inner.error.clone(),
        }
    }

    pub(crate) fn generation(&self, which: GenerationRef) -> Result<Arc<Generation>, StoreError> {
        let inner = self.lock();
        let current = inner.current()?;
        let number = match which {
            GenerationRef::Current => return Ok(current.clone()),
            GenerationRef::Number(number) => number,
        };
        let oldest = inner.generations.keys().next().copied().unwrap_or(current.number);
        inner.generations.get(&number).cloned().ok_or(StoreError::NoGeneration {
            number,
            oldest,
            current: current.number,
        })
    }

    /// Candidate pairs named since the session was opened.
    pub(crate) fn seams(&self) -> Vec<[u32; 2]> {
        self.lock().seams.iter().copied().collect()
    }

    /// Adds candidate pairs; returns how many there are.
    pub(crate) fn add_seams(&self, pairs: &[[u32; 2]]) -> usize {
        let mut inner = self.lock();
        inner.seams.extend(pairs.iter().map(|[a, b]| [*a.min(b), *a.max(b)]));
        inner.seams.len()
    }

    /// Whether the session is gone.
    pub(crate) fn is_closed(&self) -> bool {
        self.lock().channels.is_none()
    }

    /// A base body is about to be prepared, until what is returned is dropped; `None` if one is already.
    pub(crate) fn begin_rebasing(self: &Arc<Self>) -> Option<Rebasing> {
        let was = std::mem::replace(&mut self.lock().is_rebasing, true);
        (!was).then(|| Rebasing(self.clone()))
    }

    /// The task that finishes the current generation.
    pub(crate) fn set_improvement(&self, task: CancelOnDrop) {
        let previous = self.lock().improvement.replace(task);
        drop(previous);
    }

    /// Stops finishing the current generation.
    pub(crate) fn cancel_improvement(&self) {
        // Not under the lock: dropping it takes the pool's.
        let task = self.lock().improvement.take();
        drop(task);
    }

    pub(crate) fn subscribe(&self) -> Result<broadcast::Receiver<Event>, StoreError> {
        let inner = self.lock();
        let channels = inner.channels.as_ref().ok_or(StoreError::NoSession(self.id))?;
        Ok(channels.events.subscribe())
    }

    pub(crate) fn subscribe_frames(&self) -> Result<broadcast::Receiver<Arc<Frame>>, StoreError> {
        let inner = self.lock();
        let channels = inner.channels.as_ref().ok_or(StoreError::NoSession(self.id))?;
        Ok(channels.frames.subscribe())
    }

    /// See [`LiveSession::settled`].
    pub(crate) async fn settled(&self) {
        // The sender lives in `self`, so waiting cannot fail.
        let _ = self.settled.subscribe().wait_for(|settled| *settled).await;
    }

    pub(crate) fn report(&self, progress: Progress) {
        let mut inner = self.lock();
        inner.progress = Some(progress);
        self.emit(&inner, EventKind::Progress(progress));
    }

    /// Ends the build: `outcome` is generation 0, or why there is none.
    pub(crate) fn settle(&self, outcome: Result<Arc<Generation>, StoreError>) {
        let mut inner = self.lock();
        match outcome {
            Ok(generation) => {
                let number = generation.number;
                inner.keep([generation]);
                self.emit(&inner, EventKind::Generation(number));
                self.set_state(&mut inner, SessionState::Ready);
            }
            Err(error) => {
                inner.error = Some(Arc::new(error));
                self.set_state(&mut inner, SessionState::Failed);
            }
        }
        self.settled.send_replace(true);
    }

    /// Refuses an edit that cannot succeed, however long it waits for its turn.
    pub(crate) fn check_editable(&self, base_generation: Option<u64>) -> Result<(), StoreError> {
        let inner = self.lock();
        // One that is not in memory is compared once it is.
        if matches!(inner.state, SessionState::Stored | SessionState::Restoring) {
            return Ok(());
        }
        let current = inner.current()?;
        match base_generation {
            // A larger one may become current while the edit waits.
            Some(given) if given < current.number && !current.is_body_of(given) => {
                Err(StoreError::WrongGeneration { given, current: current.number })
            }
            _ => Ok(()),
        }
    }

    /// Begins an edit of the current generation. Its end is [`LiveSession::publish`] or
    /// [`LiveSession::abandon_rebuild`].
    pub(crate) fn begin_rebuild(
        &self,
        base_generation: Option<u64>,
    ) -> Result<Arc<Generation>, StoreError> {
        let mut inner = self.lock();
        let current = inner.current()?.clone();
        // One that only improves the caller's is the same body to it.
        if let Some(given) = base_generation
            && !current.is_body_of(given)
        {
            return Err(StoreError::WrongGeneration { given, current: current.number });
        }
        self.set_state(&mut inner, SessionState::Rebuilding);
        Ok(current)
    }

    /// Makes `generation` current. Returns the simulation that has to follow, and what is no
    /// longer kept.
    fn publish(&self, generation: Arc<Generation>) -> (Option<Arc<SimulationHandle>>, Leftovers) {
        let mut inner = self.lock();
        let number = generation.number;
        if inner.channels.is_none() {
            return (None, Leftovers::from([(number, generation)]));
        }
        inner.keep([generation]);
        let oldest_kept = (number + 1).saturating_sub(self.surroundings.n_kept_generations as u64);
        let kept = inner.generations.split_off(&oldest_kept);
        let leftovers = std::mem::replace(&mut inner.generations, kept);
        self.emit(&inner, EventKind::Generation(number));
        self.set_state(&mut inner, SessionState::Ready);
        (inner.simulation.clone(), leftovers)
    }

    /// Makes `generation` current, says so by `announce`, then tells the simulation, if there is one.
    pub(crate) fn publish_and_follow(&self, generation: Arc<Generation>, announce: impl FnOnce()) {
        let (simulation, leftovers) = self.publish(generation.clone());
        announce();
        drop(leftovers);
        if let Some(simulation) = simulation {
            // A simulation that cannot follow goes on with what it has; the panic is logged.
            let _ = catching("the transfer", || {
                simulation.follow(generation);
                Ok(())
            });
        }
    }

    /// The edit failed: the session is as before.
    pub(crate) fn abandon_rebuild(&self) {
        let mut inner = self.lock();
        self.set_state(&mut inner, SessionState::Ready);
    }

    /// The simulation, running or failed.
    pub(crate) fn simulation(&self) -> Result<Arc<SimulationHandle>, StoreError> {
        self.lock().simulation.clone().ok_or(StoreError::NoSimulation)
    }

    /// Hands the running simulation to `change`, or puts in place what `start` makes of the
    /// current generation. No generation can become current meanwhile, so the simulation misses
    /// none; neither closure may wait.
    pub(crate) fn put_simulation(
        &self,
        change: impl FnOnce(&SimulationHandle) -> Result<(), StoreError>,
        start: impl FnOnce(
            Arc<Generation>,
            Arc<FrameSource>,
        ) -> Result<Arc<SimulationHandle>, StoreError>,
    ) -> Result<Arc<SimulationHandle>, StoreError> {
        let mut inner = self.lock();
        if let Some(handle) = inner.simulation.as_ref().filter(|handle| handle.is_running()) {
            change(handle)?;
            return Ok(handle.clone());
        }
        let generation = inner.current()?.clone();
        let channels = inner.channels.as_ref().ok_or(StoreError::NoSession(self.id))?;
        // A failed simulation gives up its place first.
        let frames = channels.frames.clone();
        inner.simulation = None;
        let handle = start(generation, frames)?;
        inner.simulation = Some(handle.clone());
        self.emit(&inner, EventKind::SimulationStarted);
        Ok(handle)
    }

    /// Ends the simulation by request.
    pub(crate) fn stop_simulation(&self) -> Result<(), StoreError> {
        let mut inner = self.lock();
        let handle = inner.simulation.take().ok_or(StoreError::NoSimulation)?;
        if handle.stop() {
            self.emit(&inner, EventKind::SimulationStopped);
        }
        Ok(())
    }

    /// The simulation has failed; its last words stay until it is replaced or stopped.
    pub(crate) fn simulation_failed(&self) {
        let inner = self.lock();
        self.emit(&inner, EventKind::SimulationStopped);
    }

    /// Ends the session; its tasks are the caller's to cancel.
    pub(crate) fn delete(&self) -> Leftovers {
        let mut inner = self.lock();
        self.emit(&inner, EventKind::Deleted);
        self.end(&mut inner);
        std::mem::take(&mut inner.generations)
    }

    /// Ends the session here: another daemon serves it now.
    pub(crate) fn hand_over(&self) -> Leftovers {
        let mut inner = self.lock();
        self.end(&mut inner);
        std::mem::take(&mut inner.generations)
    }

    /// Ends the simulation, every subscription and every wait: the store is going down.
    pub(crate) fn close(&self) {
        self.end(&mut self.lock());
    }

    fn end(&self, inner: &mut Inner) {
        if let Some(handle) = inner.simulation.take() {
            handle.stop();
        }
        inner.channels = None;
        self.settled.send_replace(true);
    }
}

/// A base body is being prepared for this session.
pub(crate) struct Rebasing(Arc<LiveSession>);

impl Drop for Rebasing {
    fn drop(&mut self) {
        self.0.lock().is_rebasing = false;
    }
}

impl Inner {
    fn is_idle(&self) -> bool {
        self.state == SessionState::Ready && self.simulation.is_none() && self.channels.is_some()
    }

    fn keep(&mut self, generations: impl IntoIterator<Item = Arc<Generation>>) {
        self.unkept = Some(Instant::now());
        for generation in generations {
            self.number = self.number.max(generation.number);
            self.generations.insert(generation.number, generation);
        }
    }

    fn current(&self) -> Result<&Arc<Generation>, StoreError> {
        self.generations.values().next_back().ok_or(StoreError::NotReady { state: self.state })
    }
}
