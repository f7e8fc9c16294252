//! The interface of the store.

use crate::config::StoreConfig;
use crate::error::StoreError;
use crate::event::Event;
use crate::session::{
    CreateSession, EditRequest, Generation, GenerationRef, SessionId, SessionInfo,
};
use crate::simulation::{Frame, SimulationConfig, SimulationInfo, VertexForce};
use std::sync::Arc;
use std::time::Duration;
use sutura_core::control::Control;
use sutura_core::reduced::Evaluation;
use tokio::sync::broadcast;

/// Every session of this daemon. Cheap to clone; all clones are the same store.
///
/// Methods that are not `async` return at once. An `async` method computes on the store's own
/// threads; dropping its future cancels the work.
#[derive(Clone)]
pub struct Store {
    config: Arc<StoreConfig>,
}

impl Store {
    /// Starts the store's threads.
    pub fn new(config: StoreConfig) -> std::io::Result<Store> {
        Ok(Store { config: Arc::new(config) })
    }

    /// The configuration in force.
    pub fn config(&self) -> &StoreConfig {
        &self.config
    }

    /// Opens a session and queues its build.
    pub fn create(&self, request: CreateSession) -> Result<SessionId, StoreError> {
        let _ = request;
        unimplemented!()
    }

    /// What is known of a session now.
    pub fn info(&self, id: SessionId) -> Result<SessionInfo, StoreError> {
        let _ = id;
        unimplemented!()
    }

    /// At most `limit` sessions in the order of creation, beginning behind `after`.
    pub fn list(&self, after: Option<SessionId>, limit: usize) -> Vec<SessionInfo> {
        let _ = (after, limit);
        unimplemented!()
    }

    /// Number of sessions.
    pub fn n_sessions(&self) -> usize {
        unimplemented!()
    }

    /// Returns once the session's build has ended, well or badly, or after `timeout`; the state in
    /// the answer tells which.
    pub async fn wait_ready(
        &self,
        id: SessionId,
        timeout: Duration,
    ) -> Result<SessionInfo, StoreError> {
        let _ = (id, timeout);
        unimplemented!()
    }

    /// Ends a session with everything that runs for it.
    pub fn delete(&self, id: SessionId) -> Result<(), StoreError> {
        let _ = id;
        unimplemented!()
    }

    /// A new session with the same generations, sharing every artifact; not simulated.
    pub fn fork(&self, id: SessionId, name: Option<String>) -> Result<SessionId, StoreError> {
        let _ = (id, name);
        unimplemented!()
    }

    /// Makes the next generation. Edits of one session run one after another.
    pub async fn edit(
        &self,
        id: SessionId,
        request: EditRequest,
    ) -> Result<Arc<Generation>, StoreError> {
        let _ = (id, request);
        unimplemented!()
    }

    /// A generation of a session.
    pub fn generation(
        &self,
        id: SessionId,
        which: GenerationRef,
    ) -> Result<Arc<Generation>, StoreError> {
        let _ = (id, which);
        unimplemented!()
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
        let _ = (id, which, poses, exact);
        unimplemented!()
    }

    /// Runs `job` on the query pool: for anything longer than half a millisecond that belongs to a
    /// request (parsing a mesh, assembling an array).
    pub async fn compute<T: Send + 'static>(
        &self,
        what: &'static str,
        job: impl FnOnce(&dyn Control) -> T + Send + 'static,
    ) -> Result<T, StoreError> {
        let _ = (what, job);
        unimplemented!()
    }

    /// Starts the session's simulation at rest, or changes how the running one goes on.
    pub fn put_simulation(
        &self,
        id: SessionId,
        config: SimulationConfig,
    ) -> Result<SimulationInfo, StoreError> {
        let _ = (id, config);
        unimplemented!()
    }

    /// What is known of the session's simulation now.
    pub fn simulation(&self, id: SessionId) -> Result<SimulationInfo, StoreError> {
        let _ = id;
        unimplemented!()
    }

    /// Ends the session's simulation.
    pub fn stop_simulation(&self, id: SessionId) -> Result<(), StoreError> {
        let _ = id;
        unimplemented!()
    }

    /// Lets forces act on the running simulation from its next step on.
    pub fn push_forces(&self, id: SessionId, forces: Vec<VertexForce>) -> Result<(), StoreError> {
        let _ = (id, forces);
        unimplemented!()
    }

    /// The frames of the session's present and future simulations. Ends when the session does.
    pub fn subscribe_frames(
        &self,
        id: SessionId,
    ) -> Result<broadcast::Receiver<Arc<Frame>>, StoreError> {
        let _ = id;
        unimplemented!()
    }

    /// What happens to the session. Ends when the session does.
    pub fn subscribe(&self, id: SessionId) -> Result<broadcast::Receiver<Event>, StoreError> {
        let _ = id;
        unimplemented!()
    }

    /// What happens to any session. A subscriber that fell behind can start again from
    /// [`Store::list`].
    pub fn subscribe_all(&self) -> broadcast::Receiver<Event> {
        unimplemented!()
    }

    /// Takes no new work, cancels builds, lets edits finish until `deadline` has passed, then ends
    /// every thread.
    pub async fn shutdown(&self, deadline: Duration) {
        let _ = deadline;
        unimplemented!()
    }
}
