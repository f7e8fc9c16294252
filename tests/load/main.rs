//! A daemon under load: sessions over HTTP and Zenoh are opened, edited, streamed and closed.
//!
//! `cargo test --release --test load -- --sessions 64 --seconds 600` starts a daemon, loads it and writes
//! `report.json` and `load.svg`. Edits arrive by the clock (an open loop): whether or not the last one is
//! answered, the next one is sent when it is due, and its latency counts from then. Without options this is
//! a test of a few seconds that no edit is lost.
//!
//! `--latency 1000` measures, instead, from a force message to the first state that shows it.

mod arrivals;
mod body;
mod daemon;
mod latency;
mod picture;
#[path = "../plain_http.rs"]
mod plain_http;
mod report;
mod states;

use arrivals::Counts;
use clap::Parser;
use daemon::Daemon;
use report::{Report, Summary};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use sutura_client::{BusSession, Client, Session, ZenohClient};
use tokio::time::Instant;

/// Whatever goes wrong before there is anything to report.
type Failure = Box<dyn std::error::Error + Send + Sync>;

/// How many bodies are asked for at once: more would only wait in the daemon's queue.
const OPENED_AT_ONCE: usize = 4;

/// How long answers that are due may take once no more edits are sent.
const PATIENCE: Duration = Duration::from_secs(120);

/// What `cargo test` passes on to every test.
#[derive(Clone, Debug, clap::Args)]
struct Harness {
    /// Names of tests: unless one of them is part of "load", this one is skipped.
    #[arg(hide = true)]
    filters: Vec<String>,
    #[arg(long, hide = true)]
    list: bool,
    #[arg(long, hide = true)]
    exact: bool,
    #[arg(long, hide = true)]
    nocapture: bool,
    #[arg(long, hide = true)]
    test_threads: Option<usize>,
}

impl Harness {
    fn skips(&self) -> bool {
        let is_wanted = |filter: &String| "load".contains(filter.as_str());
        self.list || !(self.filters.is_empty() || self.filters.iter().any(is_wanted))
    }
}

/// What to load the daemon with.
#[derive(Clone, Debug, Parser, serde::Serialize)]
struct Options {
    #[command(flatten)]
    #[serde(skip)]
    harness: Harness,
    /// Sessions at the same time.
    #[arg(long, default_value_t = 4)]
    sessions: usize,
    /// How long to edit, in s.
    #[arg(long, default_value_t = 4.0)]
    seconds: f64,
    /// Edits a second of each session.
    #[arg(long, default_value_t = 1.0)]
    edit_hz: f64,
    /// States a second of each session.
    #[arg(long, default_value_t = 30.0)]
    publish_hz: f64,
    /// Time step of the simulations, in s.
    #[arg(long, default_value_t = 1.0 / 30.0)]
    dt_s: f64,
    /// Every how many-th session is edited and streamed over HTTP; the others are over Zenoh.
    #[arg(long, default_value_t = 2)]
    http_every: usize,
    /// Modes of each body.
    #[arg(long, default_value_t = 10)]
    modes: usize,
    /// Columns of each basis.
    #[arg(long, default_value_t = 20)]
    basis: usize,
    /// Cubature points of each body.
    #[arg(long, default_value_t = 40)]
    points: usize,
    /// Pairs that each edit stitches.
    #[arg(long, default_value_t = 4)]
    pairs: usize,
    /// Deadline of each edit, in ms.
    #[arg(long)]
    deadline_ms: Option<f64>,
    /// Sessions on one and the same body; otherwise each has a body of its own.
    #[arg(long)]
    same_body: bool,
    /// The daemon's configuration; otherwise its defaults, with room for the sessions.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Measures the latency of so many forces over WebSocket and Zenoh each, and nothing else.
    #[arg(long)]
    latency: Option<usize>,
    /// Where to write the report and the picture.
    #[arg(long)]
    out: Option<PathBuf>,
    /// What the daemon logs.
    #[arg(long, default_value = "warn")]
    log: String,
}

/// A session by the way it is edited and streamed.
#[derive(Clone)]
enum Door {
    Http(Session),
    Zenoh(BusSession),
}

impl Door {
    fn name(&self) -> &'static str {
        match self {
            Door::Http(_) => "http",
            Door::Zenoh(_) => "zenoh",
        }
    }
}

#[tokio::main]
async fn main() -> ExitCode {
    let options = Options::parse();
    if options.harness.skips() {
        return ExitCode::SUCCESS;
    }
    if let Some(n) = options.latency {
        return match latency(&options, n).await {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("{error}");
                ExitCode::FAILURE
            }
        };
    }
    match run(&options).await {
        Ok(summary) if summary.n_lost == 0 && summary.n_acknowledged > 0 => ExitCode::SUCCESS,
        Ok(_) => {
            eprintln!("edits were lost");
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// Measures latencies; an error if a force shows in no state.
async fn latency(options: &Options, n: usize) -> Result<(), Failure> {
    let report = latency::measure(options, n).await?;
    println!("{report}");
    if let Some(folder) = &options.out {
        std::fs::create_dir_all(folder)?;
        std::fs::write(folder.join("latency.json"), serde_json::to_vec_pretty(&report)?)?;
    }
    match report.n_unanswered() {
        0 => Ok(()),
        n => Err(format!("{n} forces showed in no state").into()),
    }
}

async fn run(options: &Options) -> Result<Summary, Failure> {
    let daemon = Daemon::start(options)?;
    let client = Client::connect(daemon.http()).await?;
    let zenoh = ZenohClient::open(daemon.zenoh()).await?;
    let sessions = open(options, &client).await?;
    let doors: Vec<Door> = sessions
        .iter()
        .enumerate()
        .map(|(i, session)| match i % options.http_every.max(1) {
            0 => Ok(Door::Http(session.clone())),
            _ => zenoh.session(session.id()).map(Door::Zenoh),
        })
        .collect::<Result<_, _>>()?;

    let start = Instant::now() + Duration::from_millis(500);
    let end = start + Duration::from_secs_f64(options.seconds);
    let counts = Arc::new(Mutex::new(Counts::new()?));
    let watching = tokio::spawn(daemon.watcher(start));
    let streams: Vec<_> = doors
        .iter()
        .map(|door| {
            tokio::spawn(states::follow(
                door.clone(),
                options.publish_hz,
                tokio::time::sleep_until(end),
            ))
        })
        .collect();
    let arrivals = doors.iter().enumerate().map(|(i, door)| {
        // Spread over the first period.
        let offset_s = i as f64 / (options.sessions as f64 * options.edit_hz);
        let first = start + Duration::from_secs_f64(offset_s);
        tokio::spawn(arrivals::edit(
            door.clone(),
            options.clone(),
            [start, first, end],
            counts.clone(),
        ))
    });
    let answered = PATIENCE + Duration::from_secs_f64(options.seconds);
    let mut edited = Vec::new();
    for arrivals in arrivals.collect::<Vec<_>>() {
        edited.push(tokio::time::timeout(answered, arrivals).await???);
    }
    let mut states = states::States::new()?;
    for stream in streams {
        states.add(&stream.await??)?;
    }
    let mut n_lost = 0;
    for (session, edited) in sessions.iter().zip(&edited) {
        n_lost += edited.lost(&session.info().await?, options);
    }
    watching.abort();
    let samples = daemon.samples();
    if samples.is_empty() {
        return Err("the daemon's metrics could not be read once".into());
    }
    for session in &sessions {
        session.delete().await?;
    }
    let counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
    let report = Report::new(options, &counts, &states, samples, n_lost);
    println!("{report}");
    if let Some(folder) = &options.out {
        std::fs::create_dir_all(folder)?;
        std::fs::write(folder.join("report.json"), serde_json::to_vec_pretty(&report)?)?;
        std::fs::write(folder.join("load.svg"), picture::draw(&report))?;
    }
    drop(zenoh);
    daemon.stop()?;
    Ok(report.summary)
}

/// Opens every session, simulates it, and waits until its seam is prepared.
async fn open(options: &Options, client: &Client) -> Result<Vec<Session>, Failure> {
    let mut sessions = Vec::new();
    let indices: Vec<usize> = (0..options.sessions).collect();
    for some in indices.chunks(OPENED_AT_ONCE) {
        let opening: Vec<_> = some
            .iter()
            .map(|&i| tokio::spawn(body::open(client.clone(), options.clone(), i)))
            .collect();
        for session in opening {
            sessions.push(session.await??);
        }
    }
    Ok(sessions)
}
