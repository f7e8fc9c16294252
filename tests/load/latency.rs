//! From a force message to the first state that shows it.
//!
//! A force waits for the next step whose state is published; so even without a transport, messages at random
//! phases of a publishing period T would wait 0 to T: T/2 in the median, 0.99 T for 99 %. What is measured
//! beyond that is the step itself, both ways through the transport, and the daemon.
//!
//! The body is stiff and critically damped, so that it is at rest again when the next force comes: the first
//! state that differs from rest shows the force.

use crate::arrivals::{histogram, record};
use crate::daemon::Daemon;
use crate::report::Times;
use crate::states::{self, States};
use crate::{Door, Failure, Options, body};
use hdrhistogram::Histogram;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use std::fmt;
use std::time::Duration;
use sutura_client::proto::session::{BasisConfig, CubatureConfig, DampingConfig, SessionConfig};
use sutura_client::proto::simulation::{Force, IntegratorConfig, SimulationConfig};
use sutura_client::{Client, Session, StateStream, ZenohClient};
use tokio::sync::mpsc::{Receiver, channel};
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{Instant, timeout_at};

/// Columns of the basis, and cubature points.
const BASIS_SIZE: usize = 60;
const N_POINTS: usize = 120;

/// The stomach's lowest frequency is about 1.4 Hz; that of a body so many times as stiff 56 Hz.
const STIFFENING: f64 = 1600.0;

/// Twice the lowest angular frequency: its critical damping, in 1/s.
const DAMPING_PER_S: f64 = 700.0;

/// Where forces act, which, and for how long (at least a step).
const VERTEX: u32 = 864;
const FORCE_N: [f64; 3] = [0.0, 1.0, 0.0];
const FORCE_S: f64 = 0.02;

/// A state shows the force beyond this part of the largest displacement, and rest below that one.
const SHOWN: f64 = 1e-3;
const AT_REST: f64 = 1e-4;

/// States without an answer to a force after which it counts as lost, and within which a body comes to rest.
const PATIENCE: Duration = Duration::from_secs(5);

/// Forces by which it is learned how far they move the body.
const WARM_UP: usize = 3;

/// Between two forces on each body that only has to be in motion.
const PUSH_INTERVAL: Duration = Duration::from_millis(500);

/// States between the socket and whoever judges them.
const BACKLOG: usize = 4096;

/// What is measured.
struct Case {
    name: &'static str,
    n_bodies: usize,
    /// Bodies by which latency is measured, at once: as many by each door.
    n_watched: usize,
    dt_s: f64,
    publish_hz: f64,
}

const CASES: [Case; 3] = [
    Case { name: "haptics", n_bodies: 1, n_watched: 1, dt_s: 1e-3, publish_hz: 1000.0 },
    Case { name: "display", n_bodies: 1, n_watched: 1, dt_s: 1e-3, publish_hz: 60.0 },
    Case { name: "many", n_bodies: 64, n_watched: 8, dt_s: 1.0 / 30.0, publish_hz: 30.0 },
];

/// The latencies of one case by one door.
#[derive(Debug, Serialize)]
pub(crate) struct Latency {
    case: &'static str,
    n_bodies: usize,
    dt_s: f64,
    publish_hz: f64,
    door: &'static str,
    latency: Times,
    /// What the publishing period alone makes of it.
    bound_p50_ms: f64,
    bound_p99_ms: f64,
    /// Forces that no state showed.
    n_unanswered: u64,
}

/// What the bodies of a case published meanwhile.
#[derive(Debug, Serialize)]
pub(crate) struct Published {
    case: &'static str,
    n_bodies: usize,
    n_steps: f64,
    /// Left out because their time had passed.
    n_late_steps: f64,
    /// What a step took in the mean, and how long after it was due it began.
    step_ms: f64,
    delay_ms: f64,
    n_states: u64,
    n_lost_states: u64,
    /// That came more than a period after they should have.
    n_late_states: u64,
    /// Between two states of a body.
    gaps: Times,
}

/// Everything that is written down.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub(crate) latencies: Vec<Latency>,
    pub(crate) published: Vec<Published>,
}

impl Report {
    /// Forces that no state showed.
    pub(crate) fn n_unanswered(&self) -> u64 {
        self.latencies.iter().map(|latency| latency.n_unanswered).sum()
    }
}

/// Measures `n` messages by each door in every case.
pub(crate) async fn measure(options: &Options, n: usize) -> Result<Report, Failure> {
    let daemon = Daemon::start(options)?;
    let client = Client::connect(daemon.http()).await?;
    let zenoh = ZenohClient::open(daemon.zenoh()).await?;
    let mut report = Report { latencies: Vec::new(), published: Vec::new() };
    let mut sessions: Vec<Session> = Vec::new();
    for case in CASES {
        while sessions.len() < case.n_bodies {
            sessions.push(open(&client, sessions.len()).await?);
        }
        for session in &sessions {
            let simulation = SimulationConfig {
                dt_s: case.dt_s,
                publish_hz: case.publish_hz,
                integrator: IntegratorConfig::BackwardEuler,
                gravity_m_s2: [0.0; 3],
                ..SimulationConfig::default()
            };
            session.simulate(&simulation).await?;
        }
        let (running, ended) = tokio::sync::watch::channel(());
        let mut followed = JoinSet::new();
        for (i, session) in sessions.iter().enumerate() {
            let door = match i % 2 {
                0 => Door::Http(session.clone()),
                _ => Door::Zenoh(zenoh.session(session.id())?),
            };
            let mut ended = ended.clone();
            followed.spawn(states::follow(door, case.publish_hz, async move {
                let _ = ended.changed().await;
            }));
        }
        let before = daemon.metrics().await?;
        let (watched, others) = sessions.split_at(case.n_watched.min(sessions.len()));
        let pushed = tokio::spawn(push(others.to_vec()));
        for name in ["websocket", "zenoh"] {
            let mut bodies = JoinSet::new();
            for (i, session) in watched.iter().enumerate() {
                let door = match name {
                    "zenoh" => Door::Zenoh(zenoh.session(session.id())?),
                    _ => Door::Http(session.clone()),
                };
                let n = n.div_ceil(watched.len());
                bodies.spawn(one(door, n, case.dt_s, case.publish_hz, i as u64));
            }
            let (mut times, mut n_unanswered) = (histogram()?, 0);
            while let Some(body) = bodies.join_next().await {
                let (more, unanswered) = body??;
                times.add(&more)?;
                n_unanswered += unanswered;
            }
            let period_ms = 1e3 * case.dt_s.max(1.0 / case.publish_hz);
            report.latencies.push(Latency {
                case: case.name,
                n_bodies: sessions.len(),
                dt_s: case.dt_s,
                publish_hz: case.publish_hz,
                door: name,
                latency: Times::of(&times),
                bound_p50_ms: 0.5 * period_ms,
                bound_p99_ms: 0.99 * period_ms,
                n_unanswered,
            });
        }
        let after = daemon.metrics().await?;
        pushed.abort();
        drop(running);
        let mut states = States::new()?;
        while let Some(some) = followed.join_next().await {
            states.add(&some??)?;
        }
        let grown = |name: &str| after[name] - before[name];
        let n_steps = grown("sutura_steps_total");
        report.published.push(Published {
            case: case.name,
            n_bodies: sessions.len(),
            n_steps,
            n_late_steps: grown("sutura_steps_late_total"),
            step_ms: 1e3 * grown("sutura_step_seconds_sum") / n_steps,
            delay_ms: 1e3 * grown("sutura_step_delay_seconds_sum") / n_steps,
            n_states: states.n_received,
            n_lost_states: states.n_lost,
            n_late_states: states.n_late,
            gaps: Times::of(&states.gap),
        });
    }
    for session in &sessions {
        session.delete().await?;
    }
    drop(zenoh);
    daemon.stop()?;
    Ok(report)
}

/// Opens the `index`-th body, another one than all before.
async fn open(client: &Client, index: usize) -> Result<Session, Failure> {
    let (mut material, fixed_vertices) = body::held()?;
    material.young_modulus_pa *= STIFFENING * (1.0 + 1e-3 * index as f64);
    let config = SessionConfig {
        name: Some(format!("latency-{index}")),
        fixed_vertices,
        cubature: Some(CubatureConfig { n_points: N_POINTS, ..CubatureConfig::default() }),
        basis: BasisConfig { size: BASIS_SIZE, ..BasisConfig::default() },
        damping: DampingConfig { rayleigh_mass_per_s: DAMPING_PER_S, ..DampingConfig::default() },
        ..SessionConfig::new(material)
    };
    let session = client.create_from_file("stomach_small.msh", body::mesh()?, &config).await?;
    session.wait_ready(|_| {}).await?;
    Ok(session)
}

fn force(dt_s: f64) -> [Force; 1] {
    [Force { vertex: VERTEX, force_n: FORCE_N, duration_s: FORCE_S.max(dt_s) }]
}

/// Keeps `sessions` in motion, until it is aborted.
async fn push(sessions: Vec<Session>) -> Result<(), Failure> {
    let mut ticks = tokio::time::interval(PUSH_INTERVAL);
    loop {
        ticks.tick().await;
        for session in &sessions {
            session.push_forces(&force(0.0)).await?;
        }
    }
}

/// A state by the time that it came.
struct Arrival {
    at: Instant,
    /// ‖q‖.
    size: f64,
}

/// Notes when states come, beside whoever sends forces.
fn arrivals(mut stream: StateStream) -> (JoinHandle<()>, Receiver<Arrival>) {
    let (sender, arrivals) = channel(BACKLOG);
    let reading = tokio::spawn(async move {
        while let Ok(Some(state)) = stream.next().await {
            let at = Instant::now();
            let size = state.q.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
            if sender.send(Arrival { at, size }).await.is_err() {
                return;
            }
        }
    });
    (reading, arrivals)
}

/// Waits until a state is smaller than `size`.
async fn rest(arrivals: &mut Receiver<Arrival>, size: f64) -> Result<(), Failure> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        let arrival = timeout_at(deadline, arrivals.recv()).await?.ok_or("states ended")?;
        if arrival.size < size {
            return Ok(());
        }
    }
}

/// Times of `n` forces at random phases, and how many no state showed.
async fn one(
    door: Door,
    n: usize,
    dt_s: f64,
    publish_hz: f64,
    seed: u64,
) -> Result<(Histogram<u64>, u64), Failure> {
    let stream = match &door {
        Door::Http(session) => session.states().await?,
        Door::Zenoh(session) => session.states().await?,
    };
    let (reading, mut arrivals) = arrivals(stream);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut times, mut n_unanswered) = (histogram()?, 0);
    // The first forces only show how far the body moves.
    let mut largest = 0.0;
    for number in 0..WARM_UP + n {
        if number > 0 {
            rest(&mut arrivals, AT_REST * largest).await?;
        }
        let wait = Duration::from_secs_f64(random.random_range(0.0..1.0 / publish_hz));
        // Finer than the runtime's timer, whose milliseconds would favour some phases.
        tokio::task::block_in_place(|| std::thread::sleep(wait));
        let sent = Instant::now();
        match &door {
            Door::Http(session) => session.push_forces(&force(dt_s)).await?,
            Door::Zenoh(session) => session.push_forces(&force(dt_s)).await?,
        }
        let end = if number < WARM_UP { sent + PATIENCE / 10 } else { sent + PATIENCE };
        loop {
            let Ok(arrival) = timeout_at(end, arrivals.recv()).await else {
                n_unanswered += u64::from(number >= WARM_UP);
                break;
            };
            let Arrival { at, size } = arrival.ok_or("states ended")?;
            if number < WARM_UP {
                largest = f64::max(largest, size);
            } else if at >= sent && size > SHOWN * largest {
                record(&mut times, at - sent);
                break;
            }
        }
    }
    reading.abort();
    Ok((times, n_unanswered))
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "| bodies | step | states | over | p50 | of it the period's | p99 | of it the period's |\n\
             |---|---|---|---|---|---|---|---|"
        )?;
        for of in &self.latencies {
            let Latency { n_bodies, dt_s, publish_hz, door, latency, .. } = of;
            let [p50, p99] = [latency.p50_ms, latency.p99_ms];
            let [bound_p50, bound_p99] = [of.bound_p50_ms, of.bound_p99_ms];
            let step_ms = 1e3 * dt_s;
            writeln!(
                f,
                "| {n_bodies} | {step_ms:.1} ms | {publish_hz:.0} Hz | {door} | {p50:.2} ms | \
                 {bound_p50:.2} ms | {p99:.2} ms | {bound_p99:.2} ms |"
            )?;
        }
        for of in &self.published {
            let Published { case, n_bodies, n_steps, n_late_steps, n_states, .. } = of;
            writeln!(
                f,
                "{case}, {n_bodies} bodies: {n_steps} steps of {:.2} ms begun {:.2} ms after they were due, \
                 {n_late_steps} left out; {n_states} states received, {} lost, {} late\n  gaps {}",
                of.step_ms, of.delay_ms, of.n_lost_states, of.n_late_states, of.gaps
            )?;
        }
        Ok(())
    }
}
