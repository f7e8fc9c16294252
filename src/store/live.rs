//! A session's mutable side: one lock, held only to read or swap pointers.
//!
//! Events are sent under the lock, so subscribers hear of changes in the order in which they
//! happened. Generations are inserted whole and never changed.

use crate::error::StoreError;
use crate::event::{Event, EventKind};
use crate::pool::{CancelOnDrop, catching};
use crate::session::{Generation, GenerationRef, Progress, SessionId, SessionInfo, SessionState};
use crate::simulation::{Frame, FrameSource};
use crate::stepping::SimulationHandle;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use sutura_core::mesh::TetMesh;
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
}

/// A session as the store keeps it.
pub(crate) struct LiveSession {
    pub(crate) id: SessionId,
    name: String,
    surroundings: Surroundings,
    inner: Mutex<Inner>,
    /// Becomes true when the build has ended, well or badly, or the session is gone.
    settled: watch::Sender<bool>,
}

struct Inner {
    state: SessionState,
    progress: Option<Progress>,
    mesh: Arc<TetMesh>,
    generations: BTreeMap<u64, Arc<Generation>>,
    error: Option<Arc<StoreError>>,
    /// Candidate pairs named since the session was opened, ends ascending.
    seams: BTreeSet<[u32; 2]>,
    /// The task that improves the current generation.
    improvement: Option<CancelOnDrop>,
    simulation: Option<Arc<SimulationHandle>>,
    /// `None` once the session is deleted.
    channels: Option<Channels>,
}

struct Channels {
    events: broadcast::Sender<Event>,
    frames: Arc<FrameSource>,
}

/// What a change left over: to be dropped where freeing large memory holds up nobody.
pub(crate) type Leftovers = BTreeMap<u64, Arc<Generation>>;

impl LiveSession {
    /// A session whose build is about to be queued.
    pub(crate) fn new(name: String, mesh: Arc<TetMesh>, surroundings: Surroundings) -> Self {
        Self::with(name, mesh, SessionState::Building, BTreeMap::new(), surroundings)
    }

    /// A session that starts with the generations of this one.
    pub(crate) fn fork(&self, name: Option<String>) -> Result<Self, StoreError> {
        let inner = self.lock();
        inner.current()?;
        let fork = Self::with(
            name.unwrap_or_else(|| self.name.clone()),
            inner.mesh.clone(),
            SessionState::Ready,
            inner.generations.clone(),
            self.surroundings.clone(),
        );
        fork.lock().seams.clone_from(&inner.seams);
        Ok(fork)
    }

    fn with(
        name: String,
        mesh: Arc<TetMesh>,
        state: SessionState,
        generations: BTreeMap<u64, Arc<Generation>>,
        surroundings: Surroundings,
    ) -> Self {
        let channels = Channels {
            events: broadcast::Sender::new(surroundings.event_backlog),
            frames: Arc::new(FrameSource::new(surroundings.frame_backlog)),
        };
        Self {
            id: SessionId::new(),
            name,
            surroundings,
            inner: Mutex::new(Inner {
                state,
                progress: None,
                mesh,
                generations,
                error: None,
                seams: BTreeSet::new(),
                improvement: None,
                simulation: None,
                channels: Some(channels),
            }),
            settled: watch::Sender::new(state != SessionState::Building),
        }
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
            name: self.name.clone(),
            state: inner.state,
            progress: inner.progress,
            mesh: inner.mesh.clone(),
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

    /// Whether this generation is the current one.
    pub(crate) fn is_current(&self, number: u64) -> bool {
        self.lock().current().is_ok_and(|current| current.number == number)
    }

    /// Whether the session is gone.
    pub(crate) fn is_closed(&self) -> bool {
        self.lock().channels.is_none()
    }

    /// The task that improves the current generation.
    pub(crate) fn set_improvement(&self, task: CancelOnDrop) {
        let previous = self.lock().improvement.replace(task);
        drop(previous);
    }

    /// Stops improving the current generation.
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
                // A body shared with another session brings its own, equal mesh.
                inner.mesh = generation.artifacts.mesh().clone();
                let number = generation.number;
                inner.generations.insert(number, generation);
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
        let current = inner.current()?;
        match base_generation {
            // A larger one may become current while the edit waits.
            Some(given) if given < current.number && current.improves != Some(given) => {
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
            && given != current.number
            && current.improves != Some(given)
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
        // A closing moves vertices; so does an undone one.
        inner.mesh = generation.artifacts.mesh().clone();
        inner.generations.insert(number, generation);
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

impl Inner {
    fn current(&self) -> Result<&Arc<Generation>, StoreError> {
        self.generations.values().next_back().ok_or(StoreError::NotReady { state: self.state })
    }
}
