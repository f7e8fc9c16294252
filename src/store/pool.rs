//! A bounded pool of worker threads.
//!
//! Tasks wait in one queue for each class. A free worker takes from the first class that has a
//! task it may run, oldest first. Tasks of one *lane* (a session) never run at the same time, so
//! they run in the order in which they came. A class that has no room refuses at once, with an
//! estimate of when to come again. A cancelled task that still waits is dropped; one that runs is
//! told through its [`CancelFlag`].

use crate::error::StoreError;
use crate::session::SessionId;
use std::collections::VecDeque;
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
    /// Tasks that may wait.
    pub(crate) n_waiting: usize,
    /// Tasks that may run at once.
    pub(crate) n_running: usize,
}

/// The position of a class in the list given to [`Pool::start`]; lower ones go first.
pub(crate) type Class = usize;

struct Task {
    lane: Option<SessionId>,
    cancel: CancelFlag,
    run: Box<dyn FnOnce(&CancelFlag) + Send>,
}

struct Running {
    class: Class,
    lane: Option<SessionId>,
    cancel: CancelFlag,
}

struct State {
    open: bool,
    waiting: Vec<VecDeque<Task>>,
    running: Vec<Running>,
    /// Running mean of each class's durations in s.
    mean_s: Vec<f64>,
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
            waiting: limits.iter().map(|_| VecDeque::new()).collect(),
            running: Vec::new(),
            mean_s: vec![1.0; limits.len()],
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
        class: Class,
        lane: Option<SessionId>,
        run: impl FnOnce(&CancelFlag) + Send + 'static,
    ) -> Result<Ticket, StoreError> {
        let cancel = CancelFlag::default();
        let mut state = self.shared.lock();
        if !state.open {
            return Err(StoreError::ShuttingDown);
        }
        if state.waiting[class].len() >= self.shared.limits[class].n_waiting {
            return Err(StoreError::Busy {
                retry_after_s: self.shared.retry_after_s(&state, class),
            });
        }
        state.waiting[class].push_back(Task { lane, cancel: cancel.clone(), run: Box::new(run) });
        drop(state);
        self.shared.changed.notify_all();
        Ok(Ticket { shared: self.shared.clone(), cancel })
    }

    /// Runs `job` and returns its answer. Dropping the future cancels the job; a panic inside it
    /// is [`StoreError::Failed`].
    pub(crate) async fn run<T: Send + 'static>(
        &self,
        class: Class,
        lane: Option<SessionId>,
        what: &'static str,
        job: impl FnOnce(&CancelFlag) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let (reply, answer) = oneshot::channel();
        let ticket = self.submit(class, lane, move |cancel| {
            // The caller may have gone meanwhile; then the answer is dropped.
            let _ = reply.send(catching(what, || job(cancel)));
        })?;
        let _guard = ticket.cancel_on_drop();
        self.answer(answer).await
    }

    /// Awaits what a task sends; a task dropped before it ran sends nothing.
    pub(crate) async fn answer<T>(
        &self,
        answer: oneshot::Receiver<Result<T, StoreError>>,
    ) -> Result<T, StoreError> {
        match answer.await {
            Ok(result) => result,
            Err(_) if self.shared.lock().open => Err(StoreError::Cancelled),
            Err(_) => Err(StoreError::ShuttingDown),
        }
    }

    /// Cancels every task of `lane`.
    pub(crate) fn cancel_lane(&self, lane: SessionId) {
        let state = self.shared.lock();
        state.running.iter().filter(|r| r.lane == Some(lane)).for_each(|r| r.cancel.set());
        state
            .waiting
            .iter()
            .flatten()
            .filter(|t| t.lane == Some(lane))
            .for_each(|t| t.cancel.set());
        self.shared.drop_cancelled(state);
    }

    /// Tasks that wait and tasks that run, by class.
    pub(crate) fn load(&self) -> Vec<(usize, usize)> {
        let state = self.shared.lock();
        let n_running = |class| state.running.iter().filter(|r| r.class == class).count();
        state.waiting.iter().enumerate().map(|(c, w)| (w.len(), n_running(c))).collect()
    }

    /// Takes no new tasks, drops the waiting ones, and cancels the running ones of `classes`.
    pub(crate) fn close(&self, classes: &[Class]) {
        let mut state = self.shared.lock();
        state.open = false;
        state.waiting.iter().flatten().for_each(|t| t.cancel.set());
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
        while let Some((task, class)) = self.take() {
            let begin = Instant::now();
            // The last line of defence: a task is expected to catch its own panics, because only
            // it knows whom to tell.
            let outcome = catch_unwind(AssertUnwindSafe(|| (task.run)(&task.cancel)));
            if outcome.is_err() {
                tracing::error!("a task panicked outside its computation");
            }
            let mut state = self.lock();
            if let Some(at) =
                state.running.iter().position(|r| Arc::ptr_eq(&r.cancel.0, &task.cancel.0))
            {
                state.running.swap_remove(at);
            }
            if !task.cancel.is_set() {
                let mean_s = &mut state.mean_s[class];
                *mean_s += MEAN_WEIGHT * (begin.elapsed().as_secs_f64() - *mean_s);
            }
            drop(state);
            self.changed.notify_all();
        }
    }

    /// The next task this worker may run; `None` once the pool is closed and nothing waits.
    fn take(&self) -> Option<(Task, Class)> {
        let mut state = self.lock();
        loop {
            if let Some((class, at)) = self.next(&state)
                && let Some(task) = state.waiting[class].remove(at)
            {
                let (lane, cancel) = (task.lane, task.cancel.clone());
                state.running.push(Running { class, lane, cancel });
                return Some((task, class));
            }
            if !state.open {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn next(&self, state: &State) -> Option<(Class, usize)> {
        let is_busy = |lane: Option<SessionId>| {
            lane.is_some() && state.running.iter().any(|r| r.lane == lane)
        };
        (0..state.waiting.len()).find_map(|class| {
            let n_running = state.running.iter().filter(|r| r.class == class).count();
            if n_running >= self.limits[class].n_running {
                return None;
            }
            let at = state.waiting[class].iter().position(|task| !is_busy(task.lane))?;
            Some((class, at))
        })
    }

    /// Drops cancelled tasks that wait, outside the lock: whoever awaits them is woken by that.
    fn drop_cancelled(&self, mut state: MutexGuard<'_, State>) {
        let mut dropped = Vec::new();
        for queue in &mut state.waiting {
            let (cancelled, kept): (VecDeque<Task>, VecDeque<Task>) =
                std::mem::take(queue).into_iter().partition(|task| task.cancel.is_set());
            dropped.push(cancelled);
            *queue = kept;
        }
        drop(state);
    }

    fn retry_after_s(&self, state: &State, class: Class) -> u64 {
        let n_servers = self.limits[class].n_running.min(self.n_threads).max(1) as f64;
        let until_room_s = state.mean_s[class] / n_servers;
        until_room_s.ceil().clamp(1.0, MAX_RETRY_AFTER_S) as u64
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

/// A queued task, seen by the one who queued it.
pub(crate) struct Ticket {
    shared: Arc<Shared>,
    cancel: CancelFlag,
}

impl Ticket {
    /// Cancels the task when the guard is dropped; does nothing to a task that has ended.
    pub(crate) fn cancel_on_drop(self) -> CancelOnDrop {
        CancelOnDrop(self)
    }
}

/// See [`Ticket::cancel_on_drop`].
pub(crate) struct CancelOnDrop(Ticket);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.cancel.set();
        self.0.shared.drop_cancelled(self.0.shared.lock());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    const FIRST: Class = 0;
    const SECOND: Class = 1;

    fn pool(n_threads: usize, n_waiting: usize) -> Pool {
        let limits = ClassLimits { n_waiting, n_running: n_threads };
        Pool::start("test", n_threads, vec![limits, limits]).unwrap()
    }

    /// Occupies one worker until the returned sender is dropped or used.
    fn occupy(pool: &Pool, class: Class, lane: Option<SessionId>) -> mpsc::Sender<()> {
        let (release, released) = mpsc::channel();
        let (began, begin) = mpsc::channel();
        pool.submit(class, lane, move |_| {
            began.send(()).unwrap();
            let _ = released.recv();
        })
        .unwrap();
        begin.recv().unwrap();
        release
    }

    /// Queues a task that sends `name` when it runs.
    fn note(pool: &Pool, class: Class, name: u32, log: &mpsc::Sender<u32>) {
        let log = log.clone();
        pool.submit(class, None, move |_| log.send(name).unwrap()).unwrap();
    }

    #[test]
    fn the_first_class_goes_first_and_each_class_in_order() {
        let pool = pool(1, 8);
        let release = occupy(&pool, SECOND, None);
        let (log, order) = mpsc::channel();
        for (class, name) in [(SECOND, 3), (SECOND, 4), (FIRST, 1), (FIRST, 2)] {
            note(&pool, class, name, &log);
        }
        drop(release);
        assert_eq!(order.iter().take(4).collect::<Vec<_>>(), [1, 2, 3, 4]);
    }

    #[test]
    fn a_full_class_sheds_and_leaves_the_other_open() {
        let pool = pool(1, 1);
        let _release = occupy(&pool, SECOND, None);
        pool.submit(SECOND, None, |_| {}).unwrap();
        let refused = pool.submit(SECOND, None, |_| {}).err().unwrap();
        assert!(matches!(refused, StoreError::Busy { retry_after_s: 1.. }), "{refused:?}");
        pool.submit(FIRST, None, |_| {}).unwrap();
        assert_eq!(pool.load(), [(1, 0), (1, 1)]);
    }

    #[test]
    fn a_class_leaves_threads_to_the_others() {
        let all = ClassLimits { n_waiting: 8, n_running: 2 };
        let pool = Pool::start("test", 2, vec![all, ClassLimits { n_running: 1, ..all }]).unwrap();
        let _release = occupy(&pool, SECOND, None);
        pool.submit(SECOND, None, |_| {}).unwrap();
        let (log, order) = mpsc::channel();
        note(&pool, FIRST, 1, &log);
        assert_eq!(order.recv(), Ok(1));
        assert_eq!(pool.load()[SECOND], (1, 1));
    }

    #[test]
    fn one_lane_runs_one_task_at_a_time_and_does_not_hold_up_the_others() {
        let pool = pool(2, 8);
        let lane = SessionId::behind(None);
        let release = occupy(&pool, FIRST, Some(lane));
        let (log, order) = mpsc::channel();
        let later = log.clone();
        pool.submit(FIRST, Some(lane), move |_| later.send(2).unwrap()).unwrap();
        note(&pool, FIRST, 1, &log);
        assert_eq!(order.recv(), Ok(1));
        assert_eq!(pool.load()[FIRST].0, 1);
        drop(release);
        assert_eq!(order.recv(), Ok(2));
    }

    #[test]
    fn dropping_the_guard_takes_a_waiting_task_out_of_the_queue() {
        let pool = pool(1, 1);
        let _release = occupy(&pool, FIRST, None);
        let guard = pool.submit(FIRST, None, |_| unreachable!()).unwrap().cancel_on_drop();
        assert_eq!(pool.load()[FIRST].0, 1);
        drop(guard);
        assert_eq!(pool.load()[FIRST].0, 0);
    }

    #[test]
    fn dropping_the_guard_tells_a_running_task() {
        let pool = pool(1, 1);
        let (began, begin) = mpsc::channel();
        let (ended, end) = mpsc::channel();
        let task = move |cancel: &CancelFlag| {
            began.send(()).unwrap();
            while !cancel.is_set() {
                std::thread::yield_now();
            }
            ended.send(()).unwrap();
        };
        let guard = pool.submit(FIRST, None, task).unwrap().cancel_on_drop();
        begin.recv().unwrap();
        drop(guard);
        assert_eq!(end.recv(), Ok(()));
    }

    #[test]
    fn cancelling_a_lane_leaves_the_others_alone() {
        let pool = pool(1, 8);
        let release = occupy(&pool, FIRST, None);
        let lane = SessionId::behind(None);
        pool.submit(FIRST, Some(lane), |_| unreachable!()).unwrap();
        let (log, order) = mpsc::channel();
        note(&pool, FIRST, 1, &log);
        pool.cancel_lane(lane);
        drop(release);
        assert_eq!(order.recv(), Ok(1));
    }

    #[test]
    fn a_panic_leaves_the_worker_alive() {
        let pool = pool(1, 8);
        pool.submit(FIRST, None, |_| panic!("on purpose")).unwrap();
        let (log, order) = mpsc::channel();
        note(&pool, FIRST, 1, &log);
        assert_eq!(order.recv(), Ok(1));
    }

    #[test]
    fn closing_drops_what_waits_cancels_the_named_classes_and_lets_the_rest_finish() {
        let pool = pool(2, 8);
        let release = occupy(&pool, FIRST, None);
        let (began, begin) = mpsc::channel();
        let build = move |cancel: &CancelFlag| {
            began.send(()).unwrap();
            while !cancel.is_set() {
                std::thread::yield_now();
            }
        };
        pool.submit(SECOND, None, build).unwrap();
        begin.recv().unwrap();
        pool.submit(FIRST, None, |_| unreachable!()).unwrap();
        pool.close(&[SECOND]);
        assert!(matches!(pool.submit(FIRST, None, |_| {}), Err(StoreError::ShuttingDown)));
        drop(release);
        assert!(pool.join(Instant::now() + Duration::from_secs(60), Duration::from_secs(60)));
    }
}
