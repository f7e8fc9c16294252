//! The stepping threads: they advance simulations in real time, apart from the build pool.
//!
//! Each simulation belongs to one thread, which owns its state; everybody else sends messages and
//! reads a small snapshot. A step is due every `dt_s`. A thread that comes a whole period or more
//! too late leaves those steps out and counts them, so that it neither bursts nor drifts.

use crate::error::StoreError;
use crate::pacing::{Pace, PublishRate};
use crate::pool::catching;
use crate::session::Generation;
use crate::simulation::{FrameSource, SimulationConfig, SimulationInfo, VertexForce};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use sutura_core::reduced::Simulation;

/// Messages handled between two rounds of steps, at most: a flood of them must not stop the steps.
const MESSAGES_A_ROUND: usize = 256;

/// What a caller who finds the mailbox full is told to wait, in s.
const MAILBOX_RETRY_AFTER_S: u64 = 1;

/// Names a simulation among all that this store ever ran.
type Key = u64;

enum Message {
    Start(Box<Running>),
    Configure(Key, SimulationConfig),
    Forces(Key, Vec<VertexForce>),
    /// The next generation, and the matrix that carries reduced coordinates over to it.
    Switch(Key, Arc<Generation>, Vec<f64>),
    /// Look at the `stopped` flags.
    Stop,
}

/// The threads.
pub(crate) struct SteppingThreads {
    threads: Vec<SteppingThread>,
    n_simulations: Arc<AtomicUsize>,
    next_key: AtomicU64,
}

struct SteppingThread {
    mailbox: SyncSender<Message>,
    n_simulations: Arc<AtomicUsize>,
}

impl SteppingThreads {
    /// Starts `n_threads` threads (at least one), each with room for `queue_limit` messages. They
    /// end when this value and every handle are gone.
    pub(crate) fn start(n_threads: usize, queue_limit: usize) -> std::io::Result<Self> {
        let mut threads = Vec::new();
        for index in 0..n_threads.max(1) {
            let (mailbox, messages) = sync_channel(queue_limit.max(1));
            std::thread::Builder::new()
                .name(format!("stepping-{index}"))
                .spawn(move || run(&messages))?;
            threads.push(SteppingThread { mailbox, n_simulations: Arc::default() });
        }
        Ok(Self { threads, n_simulations: Arc::default(), next_key: AtomicU64::new(0) })
    }

    /// Number of simulations, failed ones included.
    pub(crate) fn n_simulations(&self) -> usize {
        self.n_simulations.load(Ordering::Relaxed)
    }

    /// Begins to simulate `generation` at rest, unless there are `limit` simulations already.
    /// `on_failure` is called if it has to end by itself.
    pub(crate) fn add(
        &self,
        generation: Arc<Generation>,
        config: SimulationConfig,
        frames: Arc<FrameSource>,
        limit: usize,
        on_failure: impl FnOnce() + Send + 'static,
    ) -> Result<Arc<SimulationHandle>, StoreError> {
        let simulation = Simulation::new(generation.artifacts.model().clone(), config.params)?;
        let place = self.place(limit)?;
        let shared = Arc::new(Shared {
            stopped: AtomicBool::new(false),
            n_active_forces: AtomicUsize::new(0),
            info: Mutex::new(SimulationInfo {
                config,
                time_s: simulation.time_s(),
                generation: generation.number,
                n_steps: 0,
                n_late_steps: 0,
                n_recovered_steps: 0,
                n_frames: 0,
                n_active_forces: 0,
                error: None,
            }),
        });
        let key = self.next_key.fetch_add(1, Ordering::Relaxed);
        let handle = SimulationHandle {
            key,
            mailbox: self.threads[place.thread].mailbox.clone(),
            shared: shared.clone(),
            target: Mutex::new(generation.clone()),
            _place: place,
        };
        handle.post(Message::Start(Box::new(Running {
            key,
            simulation,
            generation,
            config,
            pace: None,
            publish_rate: PublishRate::default(),
            forces: Vec::new(),
            reduced_force: Vec::new(),
            frames,
            shared,
            on_failure: Some(Box::new(on_failure)),
        })))?;
        Ok(Arc::new(handle))
    }

    /// A place on the thread that has the fewest simulations.
    fn place(&self, limit: usize) -> Result<Place, StoreError> {
        self.n_simulations
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| (n < limit).then_some(n + 1))
            .map_err(|_| StoreError::Full { what: "simulations", limit })?;
        let load = |index: &usize| self.threads[*index].n_simulations.load(Ordering::Relaxed);
        let thread = (0..self.threads.len()).min_by_key(load).unwrap_or(0);
        let of_thread = self.threads[thread].n_simulations.clone();
        of_thread.fetch_add(1, Ordering::Relaxed);
        Ok(Place { thread, counters: [self.n_simulations.clone(), of_thread] })
    }
}

/// Counts one simulation, in total and on its thread, for as long as it lives.
struct Place {
    thread: usize,
    counters: [Arc<AtomicUsize>; 2],
}

impl Drop for Place {
    fn drop(&mut self) {
        for counter in &self.counters {
            counter.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

/// What a stepping thread and the callers both see.
struct Shared {
    stopped: AtomicBool,
    n_active_forces: AtomicUsize,
    info: Mutex<SimulationInfo>,
}

impl Shared {
    fn info(&self) -> MutexGuard<'_, SimulationInfo> {
        self.info.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The caller's side of a simulation.
pub(crate) struct SimulationHandle {
    key: Key,
    mailbox: SyncSender<Message>,
    shared: Arc<Shared>,
    /// The newest generation that the simulation was told to step.
    target: Mutex<Arc<Generation>>,
    _place: Place,
}

impl SimulationHandle {
    /// Whether it neither failed nor was stopped.
    pub(crate) fn is_running(&self) -> bool {
        !self.shared.stopped.load(Ordering::Relaxed)
    }

    pub(crate) fn info(&self) -> SimulationInfo {
        let n_active_forces = self.shared.n_active_forces.load(Ordering::Acquire);
        SimulationInfo { n_active_forces, ..self.shared.info().clone() }
    }

    /// Stops it before its next step; tells whether it was running.
    pub(crate) fn stop(&self) -> bool {
        let was_running = !self.shared.stopped.swap(true, Ordering::Relaxed);
        // Only wakes the thread up: a full mailbox means that it is awake.
        let _ = self.mailbox.try_send(Message::Stop);
        was_running
    }

    /// Goes on with another configuration from the next step on.
    pub(crate) fn configure(&self, config: SimulationConfig) -> Result<(), StoreError> {
        self.post(Message::Configure(self.key, config))?;
        self.shared.info().config = config;
        Ok(())
    }

    /// Adds forces, unless more than `limit` would act.
    pub(crate) fn push_forces(
        &self,
        forces: Vec<VertexForce>,
        limit: usize,
    ) -> Result<(), StoreError> {
        let n_forces = forces.len();
        let active = &self.shared.n_active_forces;
        active
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| {
                (n + n_forces <= limit).then_some(n + n_forces)
            })
            .map_err(|_| StoreError::Full { what: "active forces", limit })?;
        self.post(Message::Forces(self.key, forces)).inspect_err(|_| {
            active.fetch_sub(n_forces, Ordering::Relaxed);
        })
    }

    /// Computes how to carry the state over to `generation` and tells the thread. Takes long and
    /// may wait: for the build pool only, which calls it in the order of the generations.
    pub(crate) fn follow(&self, generation: Arc<Generation>) {
        if !self.is_running() {
            return;
        }
        let target = || self.target.lock().unwrap_or_else(PoisonError::into_inner);
        let old = target().clone();
        let transfer = generation.artifacts.transfer_from(&old.artifacts);
        // The thread is gone only at the very end of the process.
        let _ = self.mailbox.send(Message::Switch(self.key, generation.clone(), transfer));
        *target() = generation;
    }

    fn post(&self, message: Message) -> Result<(), StoreError> {
        self.mailbox.try_send(message).map_err(|error| match error {
            TrySendError::Full(_) => StoreError::Busy { retry_after_s: MAILBOX_RETRY_AFTER_S },
            TrySendError::Disconnected(_) => StoreError::ShuttingDown,
        })
    }
}

/// A force with its reduced counterpart Uᵀf in the basis of the current generation.
struct ActiveForce {
    force: VertexForce,
    remaining_s: f64,
    reduced: Vec<f64>,
}

impl ActiveForce {
    fn project(&mut self, generation: &Generation) {
        let VertexForce { vertex, force_n, .. } = self.force;
        self.reduced = generation.artifacts.vertex_load(vertex, force_n);
    }
}

/// A simulation as its thread owns it.
struct Running {
    key: Key,
    simulation: Simulation,
    generation: Arc<Generation>,
    config: SimulationConfig,
    /// Set by the thread, whose clock it is.
    pace: Option<Pace>,
    publish_rate: PublishRate,
    forces: Vec<ActiveForce>,
    reduced_force: Vec<f64>,
    frames: Arc<FrameSource>,
    shared: Arc<Shared>,
    on_failure: Option<Box<dyn FnOnce() + Send>>,
}

/// Body of a stepping thread.
fn run(messages: &Receiver<Message>) {
    let epoch = Instant::now();
    let mut simulations: Vec<Running> = Vec::new();
    loop {
        let next_due = simulations.iter().filter_map(|s| s.pace).map(|pace| pace.due()).min();
        let first = match next_due {
            None => messages.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(due) => messages.recv_timeout(due.saturating_sub(epoch.elapsed())),
        };
        match first {
            Ok(message) => {
                let others = messages.try_iter().take(MESSAGES_A_ROUND - 1);
                for message in std::iter::once(message).chain(others) {
                    handle(message, &mut simulations);
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        simulations.retain(|s| !s.shared.stopped.load(Ordering::Relaxed));
        for simulation in &mut simulations {
            let now = epoch.elapsed();
            let dt_s = simulation.config.params.dt_s;
            let pace = simulation.pace.get_or_insert_with(|| Pace::new(now, dt_s));
            if pace.due() <= now {
                let n_late = pace.begin_step(now);
                simulation.guarded(|simulation| simulation.step(n_late));
            }
        }
    }
}

fn handle(message: Message, simulations: &mut Vec<Running>) {
    let mut with = |key: Key, change: &mut dyn FnMut(&mut Running) -> Result<(), StoreError>| {
        // A message may come after its simulation has ended.
        if let Some(simulation) = simulations.iter_mut().find(|s| s.key == key) {
            simulation.guarded(|simulation| change(simulation));
        }
    };
    match message {
        Message::Start(mut simulation) => {
            simulation.guarded(|simulation| {
                simulation.publish();
                Ok(())
            });
            simulations.push(*simulation);
        }
        Message::Configure(key, config) => with(key, &mut |s| s.configure(config)),
        Message::Forces(key, mut forces) => {
            with(key, &mut |s| {
                s.add_forces(std::mem::take(&mut forces));
                Ok(())
            });
        }
        Message::Switch(key, generation, transfer) => {
            with(key, &mut |s| s.switch(generation.clone(), &transfer));
        }
        Message::Stop => {}
    }
}

impl Running {
    /// Runs `change`; if it fails or panics, the simulation ends and says why.
    fn guarded(&mut self, change: impl FnOnce(&mut Running) -> Result<(), StoreError>) {
        if let Err(error) = catching("a simulation", || change(self)) {
            tracing::warn!(simulation = self.key, %error, "simulation ended");
            self.shared.info().error = Some(Arc::new(error));
            if !self.shared.stopped.swap(true, Ordering::Relaxed)
                && let Some(on_failure) = self.on_failure.take()
            {
                on_failure();
            }
        }
    }

    fn step(&mut self, n_late: u64) -> Result<(), StoreError> {
        let SimulationConfig { params, publish_hz } = self.config;
        self.sum_forces(params.dt_s);
        let report = self.simulation.step(&self.reduced_force, &[]);
        {
            let mut info = self.shared.info();
            info.time_s = self.simulation.time_s();
            info.n_steps += 1;
            info.n_late_steps += n_late;
            info.n_recovered_steps += u64::from(report.recovered);
        }
        self.end_forces(params.dt_s);
        if self.publish_rate.is_due(params.dt_s, publish_hz) {
            self.publish();
        }
        Ok(())
    }

    /// Sums the reduced forces of this step. A force that ends within it counts in part, so that
    /// its impulse is what was asked for.
    fn sum_forces(&mut self, dt_s: f64) {
        self.reduced_force.clear();
        self.reduced_force.resize(self.simulation.q().len(), 0.0);
        for active in &self.forces {
            let share = (active.remaining_s / dt_s).min(1.0);
            for (sum, f) in self.reduced_force.iter_mut().zip(&active.reduced) {
                *sum += share * f;
            }
        }
    }

    /// Drops the forces that ended within the step just taken.
    fn end_forces(&mut self, dt_s: f64) {
        let n_before = self.forces.len();
        self.forces.retain_mut(|active| {
            active.remaining_s -= dt_s;
            // What is left by rounding alone is no force.
            active.remaining_s > 1e-9 * dt_s
        });
        self.shared.n_active_forces.fetch_sub(n_before - self.forces.len(), Ordering::Release);
    }

    fn add_forces(&mut self, forces: Vec<VertexForce>) {
        for force in forces {
            let mut active =
                ActiveForce { force, remaining_s: force.duration_s, reduced: Vec::new() };
            active.project(&self.generation);
            self.forces.push(active);
        }
    }

    fn configure(&mut self, config: SimulationConfig) -> Result<(), StoreError> {
        self.simulation.set_params(config.params)?;
        if let Some(pace) = &mut self.pace {
            pace.set_period(config.params.dt_s);
        }
        self.config = config;
        Ok(())
    }

    /// Goes on with the next generation. The state is published in both bases, so that a client
    /// sees the same moment before and after.
    fn switch(&mut self, generation: Arc<Generation>, transfer: &[f64]) -> Result<(), StoreError> {
        self.publish();
        self.simulation.switch(generation.artifacts.model().clone(), transfer)?;
        self.generation = generation;
        for active in &mut self.forces {
            active.project(&self.generation);
        }
        self.shared.info().generation = self.generation.number;
        self.publish();
        Ok(())
    }

    fn publish(&mut self) {
        let (time_s, q) = (self.simulation.time_s(), self.simulation.q());
        self.frames.publish(time_s, self.generation.number, q);
        self.shared.info().n_frames += 1;
    }
}
