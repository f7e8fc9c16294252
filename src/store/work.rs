//! The classes of work, what each may take up, and how much of each there is.

use crate::config::WorkConfig;
use crate::control::TaskControl;
use crate::error::StoreError;
use crate::live::Leftovers;
use crate::pool::{Account, CancelFlag, Class, ClassLimits, Place, Pool};
use crate::store::Store;
use sutura_core::control::Control;

/// Classes of the build pool. Edits go first.
pub(crate) const EDIT: Class = 0;
/// Bodies that somebody asks for and that are not in memory.
pub(crate) const RESTORE: Class = 1;
/// First builds.
pub(crate) const BUILD: Class = 2;
/// Behind them all: what nobody waits for.
pub(crate) const PREPARATION: Class = 3;
/// The one class of the query pool.
pub(crate) const QUERY: Class = 0;

/// Starts the pool of edits and builds.
pub(crate) fn builds(work: &WorkConfig) -> std::io::Result<Pool> {
    let n_threads = work.n_build_threads.max(1);
    let left_over = |n: usize| n_threads.saturating_sub(n).max(1);
    let edits = ClassLimits {
        name: "edit",
        n_waiting: work.edit_queue_limit,
        n_running: n_threads,
        max_wait: Some(work.max_edit_wait),
        is_patient: false,
    };
    let builds = ClassLimits {
        name: "build",
        n_waiting: work.build_queue_limit,
        n_running: left_over(2),
        // A session that is there already is built, however long that takes.
        max_wait: None,
        is_patient: true,
    };
    let restores = ClassLimits { name: "restore", n_running: left_over(1), ..builds };
    // Nobody would ask again for what is refused; sessions bound how many wait (see `chores`).
    let n_waiting = usize::MAX;
    let preparations = ClassLimits { name: "preparation", n_waiting, n_running: 1, ..builds };
    Pool::start("build", n_threads, vec![edits, restores, builds, preparations])
}

/// Starts the pool of everything short.
pub(crate) fn queries(work: &WorkConfig) -> std::io::Result<Pool> {
    let n_threads = work.n_query_threads.max(1);
    let queries = ClassLimits {
        name: "query",
        n_waiting: work.query_queue_limit,
        n_running: n_threads,
        max_wait: Some(work.max_query_wait),
        is_patient: false,
    };
    Pool::start("query", n_threads, vec![queries])
}

/// How busy the store is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Load {
    /// Sessions.
    pub n_sessions: usize,
    /// Simulations, failed ones included.
    pub n_simulations: usize,
    /// Tasks of every kind.
    pub tasks: Vec<TaskLoad>,
}

/// Tasks of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskLoad {
    /// `edit`, `restore`, `build`, `preparation` or `query`.
    pub kind: &'static str,
    /// Those that wait for a thread.
    pub n_waiting: usize,
    /// Those that run.
    pub n_running: usize,
}

impl Store {
    /// How busy the store is now.
    pub fn load(&self) -> Load {
        let mut tasks = self.shared.builds.load();
        tasks.extend(self.shared.queries.load());
        Load {
            n_sessions: self.n_sessions(),
            n_simulations: self.shared.stepping.n_simulations(),
            tasks,
        }
    }

    /// Runs `job` on the query pool: for anything longer than half a millisecond that belongs to a
    /// request of `account` (parsing a mesh, assembling an array). `what` names it in the log if it panics.
    pub async fn compute<T: Send + 'static>(
        &self,
        account: Account,
        what: &'static str,
        job: impl FnOnce(&dyn Control) -> T + Send + 'static,
    ) -> Result<T, StoreError> {
        let run = move |cancel: &CancelFlag| Ok(job(&TaskControl::silent(cancel)));
        self.shared.queries.run(Place::new(QUERY).charged_to(account), what, run).await
    }

    /// Runs what writes to the storage where blocking holds up nobody. Once begun it runs to its end, even
    /// if the caller goes away.
    pub(crate) async fn keep<T: Send + 'static>(
        &self,
        account: Account,
        what: &'static str,
        job: impl FnOnce(&Store) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        if self.shared.archive.is_none() {
            return job(self);
        }
        let store = self.clone();
        let place = Place::new(QUERY).charged_to(account);
        self.shared.queries.run(place, what, move |_| job(&store)).await
    }

    /// Frees large memory on a worker; here and now if none has time.
    pub(crate) fn drop_later(&self, leftovers: Leftovers) {
        let place = Place::new(QUERY).apart();
        drop(self.shared.queries.submit(place, move |_| drop(leftovers)));
    }
}
