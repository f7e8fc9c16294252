//! The stepping threads: they advance simulations in real time, apart from the build pool.
//!
//! Each simulation belongs to one thread, which owns its state; everybody else sends messages and
//! reads a small snapshot. A step is due every `dt_s`. A thread that comes a whole period or more
//! too late leaves those steps out and counts them, so that it neither bursts nor drifts.

use crate::error::StoreError;
use crate::metrics::Steps;
use crate::pacing::{Pace, PublishRate};
use crate::pool::catching;
use crate::session::Generation;
use crate::simulation::{FrameSource, GrabConfig, SimulationConfig, SimulationInfo, VertexForce};
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use sutura_core::reduced::contact::ContactSurface;
use sutura_core::reduced::{Grab, Simulation, VertexRows};

/// Messages handled between two steps, at most: a flood of them must not stop the steps.
const MESSAGES_AT_ONCE: usize = 256;

/// What a caller who finds the mailbox full is told to wait, in s.
const MAILBOX_RETRY_AFTER_S: u64 = 1;

/// Names a simulation among all that this store ever ran.
type Key = u64;

enum Message {
    Start(Box<Running>),
    Configure(Key, SimulationConfig),
    Forces(Key, Vec<VertexForce>),
    /// Grabs to take hold or be moved, and the names of those to let go.
    Grabs(Key, Vec<GrabConfig>, Vec<u64>),
    /// The surface in the basis of the generation of that number.
    Surface(Key, u64, Arc<ContactSurface>),
    /// The next generation, the matrix that carries reduced coordinates over to it, and its surface, if
    /// there are obstacles.
    Switch(Key, Arc<Generation>, Vec<f64>, Option<Arc<ContactSurface>>),
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
                config: config.clone(),
                time_s: simulation.time_s(),
                generation: generation.number,
                n_steps: 0,
                n_late_steps: 0,
                n_recovered_steps: 0,
                n_frames: 0,
                n_active_forces: 0,
                n_grabs: 0,
                interaction_force_n: [0.0; 3],
                error: None,
            }),
            held: Mutex::default(),
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
            grabs: Vec::new(),
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
    /// Names of the grabs that hold on.
    held: Mutex<BTreeSet<u64>>,
}

impl Shared {
    fn held(&self) -> MutexGuard<'_, BTreeSet<u64>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

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
        let n_grabs = self.shared.held().len();
        SimulationInfo { n_active_forces, n_grabs, ..self.shared.info().clone() }
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
        self.post(Message::Configure(self.key, config.clone()))?;
        self.shared.info().config = config;
        Ok(())
    }

    /// Hands the thread the surface of the body, if there are obstacles. Takes long: for a pool.
    pub(crate) fn update_surface(&self) {
        let generation = self.target.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some(surface) = self.surface_of(&generation) {
            // A full mailbox is emptied within a step.
            let _ = self.mailbox.send(Message::Surface(self.key, generation.number, surface));
        }
    }

    fn surface_of(&self, generation: &Generation) -> Option<Arc<ContactSurface>> {
        let has_obstacles = !self.shared.info().config.obstacles.is_empty();
        has_obstacles.then(|| generation.artifacts.contact_surface().clone())
    }

    /// Takes hold, moves grabs, and lets go, unless more than `limit` would hold on.
    pub(crate) fn grab(
        &self,
        grabs: Vec<GrabConfig>,
        release: Vec<u64>,
        limit: usize,
    ) -> Result<(), StoreError> {
        let mut held = self.shared.held();
        let mut next = held.clone();
        next.retain(|id| !release.contains(id));
        next.extend(grabs.iter().map(|grab| grab.id));
        if next.len() > limit {
            return Err(StoreError::Full { what: "grabs", limit });
        }
        self.post(Message::Grabs(self.key, grabs, release))?;
        *held = next;
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
        let surface = self.surface_of(&generation);
        let switch = Message::Switch(self.key, generation.clone(), transfer, surface);
        let _ = self.mailbox.send(switch);
        *target() = generation;
    }

    fn post(&self, message: Message) -> Result<(), StoreError> {
        self.mailbox.try_send(message).map_err(|error| match error {
            TrySendError::Full(_) => StoreError::Busy { retry_after_s: MAILBOX_RETRY_AFTER_S },
            TrySendError::Disconnected(_) => StoreError::ShuttingDown,
        })
    }
}

/// A force, and its vertex in the basis of the current generation.
struct ActiveForce {
    force: VertexForce,
    remaining_s: f64,
    vertex: VertexRows,
}

/// A grab, and its vertex in the basis of the current generation.
struct ActiveGrab {
    config: GrabConfig,
    vertex: Arc<VertexRows>,
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
    grabs: Vec<ActiveGrab>,
    frames: Arc<FrameSource>,
    shared: Arc<Shared>,
    on_failure: Option<Box<dyn FnOnce() + Send>>,
}

/// Body of a stepping thread.
fn run(messages: &Receiver<Message>) {
    let epoch = Instant::now();
    let steps = Steps::new();
    let mut simulations: Vec<Running> = Vec::new();
    loop {
        let next_due = simulations.iter().filter_map(|s| s.pace).map(|pace| pace.due()).min();
        let first = match next_due {
            None => messages.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(due) => messages.recv_timeout(due.saturating_sub(epoch.elapsed())),
        };
        match first {
            Ok(message) => {
                let others = messages.try_iter().take(MESSAGES_AT_ONCE - 1);
                for message in std::iter::once(message).chain(others) {
                    handle(message, &mut simulations);
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        simulations.retain(|s| !s.shared.stopped.load(Ordering::Relaxed));
        for index in 0..simulations.len() {
            // What came during the step before may be for this one: not a step later.
            for message in messages.try_iter().take(MESSAGES_AT_ONCE) {
                handle(message, &mut simulations);
            }
            let simulation = &mut simulations[index];
            if simulation.shared.stopped.load(Ordering::Relaxed) {
                continue;
            }
            let now = epoch.elapsed();
            let dt_s = simulation.config.params.dt_s;
            let pace = simulation.pace.get_or_insert_with(|| Pace::new(now, dt_s));
            if pace.due() <= now {
                let delay = now.saturating_sub(pace.due());
                let n_late = pace.begin_step(now);
                simulation.guarded(|simulation| simulation.step(n_late));
                steps.record(n_late, delay, epoch.elapsed().saturating_sub(now));
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
        Message::Configure(key, config) => with(key, &mut |s| s.configure(config.clone())),
        Message::Forces(key, mut forces) => {
            with(key, &mut |s| {
                s.add_forces(std::mem::take(&mut forces));
                Ok(())
            });
        }
        Message::Grabs(key, grabs, release) => {
            with(key, &mut |s| {
                s.grab(&grabs, &release);
                Ok(())
            });
        }
        Message::Surface(key, number, surface) => {
            with(key, &mut |s| {
                if s.generation.number == number {
                    s.surround(Some(surface.clone()));
                }
                Ok(())
            });
        }
        Message::Switch(key, generation, transfer, surface) => {
            with(key, &mut |s| s.switch(generation.clone(), &transfer, surface.clone()));
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
        let SimulationConfig { params, publish_hz, .. } = self.config;
        // A force that ends within the step counts in part, so that its impulse is what was asked for.
        let share = |active: &ActiveForce| (active.remaining_s / params.dt_s).min(1.0);
        let force = |active: &ActiveForce| active.force.force_n.map(|f| share(active) * f);
        let loads: Vec<(&VertexRows, [f64; 3])> =
            self.forces.iter().map(|active| (&active.vertex, force(active))).collect();
        let report = self.simulation.step(&[], &loads);
        {
            let mut info = self.shared.info();
            info.time_s = self.simulation.time_s();
            info.n_steps += 1;
            info.n_late_steps += n_late;
            info.n_recovered_steps += u64::from(report.recovered);
            info.interaction_force_n = self.simulation.interaction_force_n();
        }
        self.end_forces(params.dt_s);
        if self.publish_rate.is_due(params.dt_s, publish_hz) {
            self.publish();
        }
        Ok(())
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
            let vertex = self.generation.artifacts.vertex_rows(force.vertex);
            self.forces.push(ActiveForce { force, remaining_s: force.duration_s, vertex });
        }
    }

    fn grab(&mut self, grabs: &[GrabConfig], release: &[u64]) {
        self.grabs.retain(|active| !release.contains(&active.config.id));
        for &config in grabs {
            let known = self.grabs.iter_mut().find(|active| active.config.id == config.id);
            match known {
                Some(active) if active.config.vertex == config.vertex => active.config = config,
                known => {
                    let vertex = Arc::new(self.generation.artifacts.vertex_rows(config.vertex));
                    let active = ActiveGrab { config, vertex };
                    match known {
                        Some(known) => *known = active,
                        None => self.grabs.push(active),
                    }
                }
            }
        }
        self.hold();
    }

    /// Hands the grabs to the simulation.
    fn hold(&mut self) {
        let grab = |ActiveGrab { config, vertex }: &ActiveGrab| Grab {
            vertex: vertex.clone(),
            target_m: config.target_m,
            stiffness_n_m: config.stiffness_n_m,
            damping_n_s_m: config.damping_n_s_m,
        };
        self.simulation.set_grabs(self.grabs.iter().map(grab).collect());
    }

    /// Puts the configured obstacles around the body, whose surface this is.
    fn surround(&mut self, surface: Option<Arc<ContactSurface>>) {
        let environment = self.config.environment(&self.generation.artifacts);
        self.simulation.set_environment(environment, surface);
    }

    fn configure(&mut self, config: SimulationConfig) -> Result<(), StoreError> {
        self.simulation.set_params(config.params)?;
        if let Some(pace) = &mut self.pace {
            pace.set_period(config.params.dt_s);
        }
        self.config = config;
        // Obstacles may have moved; a surface that is not there yet follows.
        let surface = self.simulation.surface().cloned();
        self.surround(surface);
        Ok(())
    }

    /// Goes on with the next generation. The state is published in both bases, so that a client
    /// sees the same moment before and after.
    fn switch(
        &mut self,
        generation: Arc<Generation>,
        transfer: &[f64],
        surface: Option<Arc<ContactSurface>>,
    ) -> Result<(), StoreError> {
        self.publish();
        self.simulation.switch(generation.artifacts.model().clone(), transfer)?;
        self.generation = generation;
        let body = &self.generation.artifacts;
        for active in &mut self.forces {
            active.vertex = body.vertex_rows(active.force.vertex);
        }
        for active in &mut self.grabs {
            active.vertex = Arc::new(body.vertex_rows(active.config.vertex));
        }
        self.hold();
        self.surround(surface);
        self.shared.info().generation = self.generation.number;
        self.publish();
        Ok(())
    }

    fn publish(&mut self) {
        let Running { simulation, generation, .. } = self;
        let (time_s, q) = (simulation.time_s(), simulation.q());
        self.frames.publish(time_s, generation.number, simulation.rigid(), q);
        self.shared.info().n_frames += 1;
    }
}
