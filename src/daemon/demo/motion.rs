//! The simulation: the open body in this process over a WebSocket, the closed one in another over
//! Zenoh, both under the same loads.

use super::console::Console;
use super::error::{DemoError, Doing};
use super::response::as_forces;
use super::subscriber::{Furthest, Message, MotionReport};
use nalgebra::Vector3;
use serde::Serialize;
use std::process::Stdio;
use std::time::{Duration, Instant};
use sutura_client::proto::edit::{Edit, EditReply, EditRequest};
use sutura_client::proto::simulation::{SimulationConfig, SimulationInfo};
use sutura_client::{Generation, Session, Tracker};
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};

/// States that the other process receives at least.
const N_FRAMES: usize = 300;
/// Frames after which the body is edited.
const N_FRAMES_BEFORE_EDIT: usize = 150;
/// Time steps in a period of the lowest mode, as far as the bounds allow.
const STEPS_PER_PERIOD: f64 = 100.0;
const DT_RANGE_S: [f64; 2] = [0.001, 0.01];
const MAX_PUBLISH_HZ: f64 = 200.0;
/// A watching process that says nothing for so long has failed.
const MAX_SILENCE: Duration = Duration::from_secs(120);

/// What is done to the body.
pub(crate) struct Load {
    pub(crate) forces: Vec<(u32, Vector3<f64>)>,
    /// For how long, in s of simulated time: half a period, to let go where the swing is widest.
    pub(crate) duration_s: f64,
}

/// How a body of this lowest frequency is simulated. Without gravity: it swings around rest.
pub(crate) fn simulation_config(lowest_hz: f64) -> SimulationConfig {
    let [low, high] = DT_RANGE_S;
    let dt_s = (1.0 / (STEPS_PER_PERIOD * lowest_hz)).clamp(low, high);
    SimulationConfig {
        dt_s,
        gravity_m_s2: [0.0; 3],
        substep_tolerance: None,
        publish_hz: MAX_PUBLISH_HZ.min(1.0 / dt_s),
        ..SimulationConfig::default()
    }
}

/// What the closed body went through.
#[derive(Serialize)]
pub(crate) struct Motion {
    pub(crate) config: SimulationConfig,
    /// The edit in mid-motion.
    pub(crate) edit: EditReply,
    pub(crate) edit_wall_ms: f64,
    /// The simulation's own account at the end.
    pub(crate) simulation: SimulationInfo,
    /// What the other process saw.
    pub(crate) seen: MotionReport,
}

/// Swings the open body for a period and returns where it was furthest from rest, with that
/// displacement.
pub(crate) async fn swing_open(
    session: &Session,
    config: &SimulationConfig,
    load: &Load,
) -> Result<(Furthest, Vec<f32>), DemoError> {
    let mut states = session.states().await.doing("opening the WebSocket of states")?;
    let mut tracker = Tracker::new(session.clone()).await.doing("fetching the basis")?;
    session.simulate(config).await.doing("simulating the open body")?;
    let forces = as_forces(&load.forces, load.duration_s);
    session.push_forces(&forces).await.doing("pulling on the open body")?;
    let mut furthest = Furthest::rest();
    while let Some(state) = states.next().await.doing("receiving a state")? {
        let displacement = tracker.displacement(&state).await.doing("reconstructing u = U q")?;
        furthest.update(&state, &displacement);
        if state.time_s > 2.5 * load.duration_s {
            break;
        }
    }
    session.stop_simulation().await.doing("stopping the simulation")?;
    let displacement = tracker.reconstruct(&furthest.q).doing("reconstructing u = U q")?;
    Ok((furthest, displacement))
}

/// Swings the closed body, watched by another process, and applies `edits` in mid-motion.
pub(crate) async fn swing_closed(
    console: Console,
    session: &Session,
    zenoh_endpoint: &str,
    config: &SimulationConfig,
    load: &Load,
    edits: Vec<Edit>,
) -> Result<Motion, DemoError> {
    let mut watcher = Watcher::spawn(zenoh_endpoint, session.id())?;
    watcher.until(|message| matches!(message, Message::Ready).then_some(())).await?;
    console.line(&format!("  process {} has subscribed to the states", watcher.process_id()));

    session.simulate(config).await.doing("starting the simulation")?;
    let forces = as_forces(&load.forces, load.duration_s);
    session.push_forces(&forces).await.doing("pulling on a vertex")?;
    watcher
        .until(|message| match message {
            Message::Received { n_frames } if n_frames >= N_FRAMES_BEFORE_EDIT => Some(()),
            _ => None,
        })
        .await?;
    let start = Instant::now();
    let request = EditRequest::new(edits);
    let edit = session.edit(&request).await.doing("editing the moving body")?;
    let edit_wall_ms = 1e3 * start.elapsed().as_secs_f64();
    console.line(&format!(
        "  edited in mid-motion: generation {} after {edit_wall_ms:.0} ms",
        edit.generation
    ));
    let report = |message| if let Message::Report(report) = message { Some(report) } else { None };
    let seen = watcher.until(report).await?;
    watcher.wait().await?;
    let simulation = session.simulation().await.doing("asking about the simulation")?;
    session.stop_simulation().await.doing("stopping the simulation")?;
    Ok(Motion { config: config.clone(), edit, edit_wall_ms, simulation, seen })
}

/// The displacement at `furthest`, with the basis of its generation.
pub(crate) async fn displacement(
    session: &Session,
    furthest: &Furthest,
) -> Result<Vec<f32>, DemoError> {
    use sutura_client::Arrays;
    let basis = session.basis::<f32>(Generation::Number(furthest.generation)).await;
    basis.doing("fetching the basis")?.reconstruct(&furthest.q).doing("reconstructing u = U q")
}

/// The same executable again, as the process that watches.
struct Watcher {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Watcher {
    fn spawn(zenoh_endpoint: &str, session: &str) -> Result<Watcher, DemoError> {
        let failed = || DemoError::system("starting the watching process");
        let executable = std::env::current_exe().map_err(failed())?;
        let mut child = Command::new(executable)
            .arg(super::SUBSCRIBER_COMMAND)
            .args(["--zenoh", zenoh_endpoint, "--session", session])
            .args(["--n-frames", &N_FRAMES.to_string()])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .map_err(failed())?;
        let stdout = child.stdout.take();
        let stdout =
            stdout.ok_or_else(|| DemoError::Unexpected("no pipe to read from".to_owned()))?;
        Ok(Watcher { child, lines: BufReader::new(stdout).lines() })
    }

    fn process_id(&self) -> u32 {
        self.child.id().unwrap_or(0)
    }

    /// Reads messages until `wanted` is satisfied by one.
    async fn until<T>(
        &mut self,
        mut wanted: impl FnMut(Message) -> Option<T>,
    ) -> Result<T, DemoError> {
        loop {
            let line = tokio::time::timeout(MAX_SILENCE, self.lines.next_line()).await;
            let line = line.map_err(|_| {
                DemoError::Unexpected("the watching process has fallen silent".to_owned())
            })?;
            let Some(line) =
                line.map_err(DemoError::system("listening to the watching process"))?
            else {
                return Err(DemoError::Unexpected(
                    "the watching process ended early; its message stands above".to_owned(),
                ));
            };
            let message = serde_json::from_str(&line).map_err(|error| {
                DemoError::Unexpected(format!("the watching process said “{line}”: {error}"))
            })?;
            if let Some(value) = wanted(message) {
                return Ok(value);
            }
        }
    }

    async fn wait(mut self) -> Result<(), DemoError> {
        let status = self.child.wait().await;
        let status = status.map_err(DemoError::system("ending the watching process"))?;
        if !status.success() {
            return Err(DemoError::Unexpected(format!("the watching process failed: {status}")));
        }
        Ok(())
    }
}
