//! A bounded pool of worker threads.
//!
//! Tasks wait in one queue for each class. A free worker takes from the first class that has a
//! task it may run, fairly between accounts ([`queue`]). Tasks of one *lane* (a session) never run at
//! the same time, so they run in the order in which they came. A class that has no room, or where a task
//! would wait for longer than it may, refuses at once, with an estimate of when to come again from what
//! tasks have taken so far; one that waits for too long all the same is answered so then. A cancelled
//! task that still waits is dropped; one that runs is told through its [`CancelFlag`].

mod queue;
#[cfg(test)]
mod tests;

pub use queue::Account;

use crate::error::StoreError;
use crate::metrics;
use crate::priority;
use crate::session::SessionId;
use crate::work::TaskLoad;
use queue::FairQueue;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Longest time a refused caller is told to wait, in s.
const MAX_RETRY_AFTER_S: f64 = 600.0;

/// Weight of the newest task in the running mean of a class's durations.
const MEAN_WEIGHT: f64 = 0.2;

/// Set once, by whoever no longer wants the result.
#[derive(Clone, Debug, Default)]
pub(crate) struct CancelFlag(Arc<AtomicBool>);

impl CancelFlag {
    pub(crate) fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
    pub(crate) fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// What a class of tasks may take up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ClassLimits {
    /// What its tasks are called where they are measured.
    pub(crate) name: &'static str,
    /// Tasks that may wait.
    pub(crate) n_waiting: usize,
    /// Tasks that may run at once, those of the classes behind it included.
    pub(crate) n_running: usize,
    /// How long a task may wait; `None` for as long as it takes.
    pub(crate) max_wait: Option<Duration>,
    /// Whether its tasks leave the processor to whatever else wants it.
    pub(crate) is_patient: bool,
}

/// The position of a class in the list given to [`Pool::start`]; lower ones go first.
pub(crate) type Class = usize;

/// Where a task stands among the others.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    class: Class,
    lane: Option<SessionId>,
    account: Account,
    /// What the task is, where its class does not tell.
    what: Option<&'static str>,
    /// Whose part the task is.
    cause: tracing::Span,
}

impl Place {
    /// In the class, in no lane, on the common account, within the caller's span.
    pub(crate) fn new(class: Class) -> Place {
        let cause = tracing::Span::current();
        Place { class, lane: None, account: Account::Common, what: None, cause }
    }

    /// One of a session's tasks, which run one after another.
    pub(crate) fn in_lane(self, lane: SessionId) -> Place {
        Place { lane: Some(lane), ..self }
    }

    /// Takes a turn of `account`.
    pub(crate) fn charged_to(self, account: Account) -> Place {
        Place { account, ..self }
    }

    /// Called so, where its class does not tell.
    pub(crate) fn called(self, what: &'static str) -> Place {
        Place { what: Some(what), ..self }
    }

    /// No part of what the caller does.
    pub(crate) fn apart(self) -> Place {
        Place { cause: tracing::Span::none(), ..self }
    }
}

struct Task {
    lane: Option<SessionId>,
    /// Begins as the task is queued; whatever it logs is said within it.
    span: tracing::Span,
    queued: Instant,
    cancel: CancelFlag,
    run: Box<dyn FnOnce(&CancelFlag) + Send>,
}

struct Running {
    class: Class,
    lane: Option<SessionId>,
    account: Account,
    /// Charged until it has ended.
    estimate_s: f64,
    cancel: CancelFlag,
}

struct State {
    open: bool,
    waiting: Vec<FairQueue<Task>>,
    running: Vec<Running>,
    /// Running mean of each class's durations in s, once there is one.
    mean_s: Vec<Option<f64>>,
}

impl State {
    fn mean_s(&self, class: Class) -> f64 {
        self.mean_s[class].unwrap_or(0.0)
    }
}

struct Shared {
    limits: Vec<ClassLimits>,
    n_threads: usize,
    state: Mutex<State>,
    /// A task came, a task ended, or the pool closed.
    changed: Condvar,
}

/// The pool. Dropping it cancels everything and lets its threads end by themselves.
pub(crate) struct Pool {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

impl Pool {
    /// Starts `n_threads` threads (at least one) called `name`.
    pub(crate) fn start(
        name: &str,
        n_threads: usize,
        limits: Vec<ClassLimits>,
    ) -> std::io::Result<Pool> {
        let n_threads = n_threads.max(1);
        let state = State {
            open: true,
            waiting: limits.iter().map(|_| FairQueue::new()).collect(),
            running: Vec::new(),
            mean_s: vec![None; limits.len()],
        };
        let shared = Arc::new(Shared {
            limits,
            n_threads,
            state: Mutex::new(state),
            changed: Condvar::new(),
        });
        let pool = Pool { shared: shared.clone(), threads: Mutex::new(Vec::new()) };
        for index in 0..n_threads {
            let shared = shared.clone();
            let thread = std::thread::Builder::new()
                .name(format!("{name}-{index}"))
                .spawn(move || shared.work())?;
            pool.threads.lock().unwrap_or_else(PoisonError::into_inner).push(thread);
        }
        Ok(pool)
    }

    /// Queues `run`. Dropping the [`Ticket`] has no effect on the task.
    pub(crate) fn submit(
        &self,
        place: Place,
        run: impl FnOnce(&CancelFlag) + Send + 'static,
    ) -> Result<Ticket, StoreError> {
        let Place { class, lane, account, what, cause } = place;
        let cancel = CancelFlag::default();
        let limits = &self.shared.limits[class];
        let mut state = self.shared.lock();
        if !state.open {
            return Err(StoreError::ShuttingDown);
        }
        let expected_s = self.shared.expected_wait_s(&state, class, &account);
        let is_too_long = limits.max_wait.is_some_and(|most| expected_s > most.as_secs_f64());
        if is_too_long || !state.waiting[class].has_room(&account, limits.n_waiting) {
            metrics::shed(limits.name);
            return Err(busy(expected_s));
        }
        let (queued, run) = (Instant::now(), Box::new(run));
        let span = tracing::info_span!(parent: &cause, "task", kind = limits.name, what);
        let task = Task { lane, span, queued, cancel: cancel.clone(), run };
        state.waiting[class].push(account.clone(), task);
        drop(state);
        self.shared.changed.notify_all();
        Ok(Ticket { shared: self.shared.clone(), class, account, cancel })
    }

    /// Runs `job` and returns its answer. Dropping the future cancels the job; a panic inside it
    /// is [`StoreError::Failed`].
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        place: Place,
        what: &'static str,
        job: impl FnOnce(&CancelFlag) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let (reply, answer) = oneshot::channel();
        let ticket = self.submit(place.called(what), move |cancel| {
            // The caller may have gone meanwhile; then the answer is dropped.
            let _ = reply.send(catching(what, || job(cancel)));
        })?;
        let ticket = ticket.cancel_on_drop();
        ticket.answer(answer).await
    }

    /// Cancels every task of `lane`.
    pub(crate) fn cancel_lane(&self, lane: SessionId) {
        let state = self.shared.lock();
        state.running.iter().filter(|r| r.lane == Some(lane)).for_each(|r| r.cancel.set());
        let waiting = state.waiting.iter().flat_map(FairQueue::iter);
        waiting.filter(|t| t.lane == Some(lane)).for_each(|t| t.cancel.set());
        self.shared.drop_cancelled(state);
    }

    /// Tasks that wait and tasks that run, by class.
    pub(crate) fn load(&self) -> Vec<TaskLoad> {
        let state = self.shared.lock();
        let of = |(class, limits): (Class, &ClassLimits)| TaskLoad {
            kind: limits.name,
            n_waiting: state.waiting[class].len(),
            n_running: state.running.iter().filter(|r| r.class == class).count(),
        };
        self.shared.limits.iter().enumerate().map(of).collect()
    }

    /// Takes no new tasks, drops the waiting ones, and cancels the running ones of `classes`.
    pub(crate) fn close(&self, classes: &[Class]) {
        let mut state = self.shared.lock();
        state.open = false;
        state.waiting.iter().flat_map(FairQueue::iter).for_each(|t| t.cancel.set());
        state.running.iter().filter(|r| classes.contains(&r.class)).for_each(|r| r.cancel.set());
        self.shared.drop_cancelled(state);
        self.shared.changed.notify_all();
    }

    /// After [`Pool::close`]: waits until `deadline` for the running tasks, cancels what still
    /// runs and gives it until `grace` has passed too. Tells whether every thread has ended.
    pub(crate) fn join(&self, deadline: Instant, grace: Duration) -> bool {
        if !self.shared.wait_until_idle(deadline) {
            self.shared.lock().running.iter().for_each(|r| r.cancel.set());
        }
        if !self.shared.wait_until_idle(deadline.max(Instant::now()) + grace) {
            return false;
        }
        let threads =
            std::mem::take(&mut *self.threads.lock().unwrap_or_else(PoisonError::into_inner));
        threads.into_iter().all(|thread| thread.join().is_ok())
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        let every_class: Vec<Class> = (0..self.shared.limits.len()).collect();
        self.close(&every_class);
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self) {
        // This worker's own, so that no task computes in the midst of another.
        let mut patient = None;
        while let Some((task, class)) = self.take() {
            let Task { span, queued, cancel, run, .. } = task;
            let limits = &self.limits[class];
            let begin = Instant::now();
            metrics::task_waited(limits.name, begin.saturating_duration_since(queued));
            let (flag, name) = (cancel.clone(), limits.name);
            // The last line of defence: a task is expected to catch its own panics, because only
            // it knows whom to tell.
            let job = move || {
                let _span = span.entered();
                if catch_unwind(AssertUnwindSafe(|| run(&flag))).is_err() {
                    tracing::error!(task = name, "a task panicked outside its computation");
                }
            };
            if limits.is_patient {
                match patient.get_or_insert_with(priority::patient_threads) {
                    Some(threads) => threads.install(job),
                    None => job(),
                }
            } else {
                job();
            }
            self.ended(&cancel, class, begin.elapsed());
        }
    }

    fn ended(&self, cancel: &CancelFlag, class: Class, took: Duration) {
        let took_s = took.as_secs_f64();
        metrics::task_ran(self.limits[class].name, took);
        let mut state = self.lock();
        if let Some(at) = state.running.iter().position(|r| Arc::ptr_eq(&r.cancel.0, &cancel.0)) {
            let Running { account, estimate_s, .. } = state.running.swap_remove(at);
            state.waiting[class].settle(&account, estimate_s, took_s);
        }
        if !cancel.is_set() {
            let mean_s = state.mean_s[class].get_or_insert(took_s);
            *mean_s += MEAN_WEIGHT * (took_s - *mean_s);
        }
        drop(state);
        self.changed.notify_all();
    }

    /// The next task this worker may run; `None` once the pool is closed and nothing waits.
    fn take(&self) -> Option<(Task, Class)> {
        let mut state = self.lock();
        loop {
            if let Some(next) = self.next(&mut state) {
                return Some(next);
            }
            if !state.open {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn next(&self, state: &mut State) -> Option<(Task, Class)> {
        for class in 0..state.waiting.len() {
            // Threads that a class leaves to those before it, those behind it leave too.
            let n_running = state.running.iter().filter(|r| r.class >= class).count();
            if n_running >= self.limits[class].n_running {
                return None;
            }
            let estimate_s = state.mean_s(class);
            let running = &state.running;
            let is_free =
                |task: &Task| task.lane.is_none() || running.iter().all(|r| r.lane != task.lane);
            if let Some((account, task)) = state.waiting[class].pop(estimate_s, is_free) {
                let (lane, cancel) = (task.lane, task.cancel.clone());
                state.running.push(Running { class, lane, account, estimate_s, cancel });
                return Some((task, class));
            }
        }
        None
    }

    /// Drops cancelled tasks that wait, outside the lock: whoever awaits them is woken by that.
    fn drop_cancelled(&self, mut state: MutexGuard<'_, State>) {
        let is_wanted = |task: &Task| !task.cancel.is_set();
        let dropped: Vec<Vec<Task>> =
            state.waiting.iter_mut().map(|queue| queue.retain(is_wanted)).collect();
        drop(state);
        drop(dropped);
    }

    /// How long a task that `account` adds now is going to wait, from what tasks have taken so far, in s.
    fn expected_wait_s(&self, state: &State, class: Class, account: &Account) -> f64 {
        let n_servers = self.limits[class].n_running.min(self.n_threads).max(1);
        let n_running = state.running.iter().filter(|r| r.class == class).count();
        // Those that run are half done; a thread that is free serves at once.
        let until_free = if n_running >= n_servers { 0.5 } else { 0.0 };
        let n_before = state.waiting[class].n_before(account) as f64 + until_free;
        n_before * state.mean_s(class) / n_servers as f64
    }

    fn wait_until_idle(&self, deadline: Instant) -> bool {
        let mut state = self.lock();
        while !state.running.is_empty() {
            let Some(rest) = deadline.checked_duration_since(Instant::now()) else { return false };
            state =
                self.changed.wait_timeout(state, rest).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }
}

/// Runs `job`; a panic inside it becomes [`StoreError::Failed`]. The job must not leave anything
/// shared half-changed: it computes first and publishes whole.
pub(crate) fn catching<T>(
    what: &'static str,
    job: impl FnOnce() -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    catch_unwind(AssertUnwindSafe(job)).unwrap_or_else(|panic| {
        let message = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or("no message");
        tracing::error!(what, message, "a computation panicked");
        Err(StoreError::Failed { what })
    })
}

fn busy(expected_wait_s: f64) -> StoreError {
    let retry_after_s = expected_wait_s.ceil().clamp(1.0, MAX_RETRY_AFTER_S) as u64;
    StoreError::Busy { retry_after_s }
}

/// A queued task, seen by the one who queued it.
pub(crate) struct Ticket {
    shared: Arc<Shared>,
    class: Class,
    account: Account,
    cancel: CancelFlag,
}

impl Ticket {
    /// Cancels the task when the guard is dropped; does nothing to a task that has ended.
    pub(crate) fn cancel_on_drop(self) -> CancelOnDrop {
        CancelOnDrop(self)
    }

    /// Awaits what the task sends. One that has not begun when it has waited for as long as its class may is
    /// taken out of the queue; one dropped before it ran sends nothing.
    pub(crate) async fn answer<T>(
        &self,
        mut answer: oneshot::Receiver<Result<T, StoreError>>,
    ) -> Result<T, StoreError> {
        let limits = &self.shared.limits[self.class];
        let answered = match limits.max_wait {
            None => answer.await,
            Some(most) => match tokio::time::timeout(most, &mut answer).await {
                Ok(answered) => answered,
                Err(_) => match self.withdraw() {
                    Some(expected_s) => {
                        metrics::shed(limits.name);
                        return Err(busy(expected_s));
                    }
                    None => answer.await,
                },
            },
        };
        match answered {
            Ok(result) => result,
            Err(_) if self.shared.lock().open => Err(StoreError::Cancelled),
            Err(_) => Err(StoreError::ShuttingDown),
        }
    }

    /// Takes the task out of the queue if it waits there, and tells how long another would wait, in s.
    fn withdraw(&self) -> Option<f64> {
        let mut state = self.shared.lock();
        let removed =
            state.waiting[self.class].retain(|task| !Arc::ptr_eq(&task.cancel.0, &self.cancel.0));
        let expected_s = self.shared.expected_wait_s(&state, self.class, &self.account);
        drop(state);
        (!removed.is_empty()).then_some(expected_s)
    }
}

/// See [`Ticket::cancel_on_drop`].
pub(crate) struct CancelOnDrop(Ticket);

impl std::ops::Deref for CancelOnDrop {
    type Target = Ticket;
    fn deref(&self) -> &Ticket {
        &self.0
    }
}

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.cancel.set();
        self.0.shared.drop_cancelled(self.0.shared.lock());
    }
}
