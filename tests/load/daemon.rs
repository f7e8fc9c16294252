//! The daemon under load: its process, and what its metrics say second by second.

use crate::plain_http::plain_http;
use crate::{Failure, Options};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// How long the daemon may take to go down.
const PATIENCE: Duration = Duration::from_secs(60);

/// Metrics that are kept second by second, summed over their labels.
const KEPT: [&str; 10] = [
    "process_resident_memory_bytes",
    "sutura_body_bytes",
    "sutura_steps_total",
    "sutura_steps_late_total",
    "sutura_step_seconds_sum",
    "sutura_step_delay_seconds_sum",
    "sutura_frames_dropped_total",
    "sutura_shed_total",
    "sutura_edits_waiting",
    "sutura_streams",
];

/// The metrics at one moment.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Sample {
    /// After the first edit, in s.
    pub(crate) time_s: f64,
    pub(crate) values: BTreeMap<String, f64>,
}

/// A running daemon; killed when dropped.
pub(crate) struct Daemon {
    process: Child,
    http: String,
    zenoh: String,
    samples: Arc<Mutex<Vec<Sample>>>,
    /// Its data and configuration.
    _scratch: tempfile::TempDir,
}

impl Daemon {
    /// Starts one on free ports and waits until it has said which.
    pub(crate) fn start(options: &Options) -> Result<Daemon, Failure> {
        let scratch = tempfile::tempdir()?;
        let config = match &options.config {
            Some(path) => path.clone(),
            None => {
                let path = scratch.path().join("sutura.toml");
                let n = options.sessions.max(64);
                let text = format!(
                    "[limits]\nmax_sessions = {n}\nmax_simulations = {n}\n[traffic]\nmax_queries = {n}\n"
                );
                std::fs::write(&path, text)?;
                path
            }
        };
        let mut process = Command::new(env!("CARGO_BIN_EXE_sutura"))
            .args(["serve", "--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0"])
            .args(["--log", &options.log])
            .arg("--config")
            .arg(config)
            .arg("--data")
            .arg(scratch.path().join("data"))
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()?;
        let output = process.stdout.take().ok_or("the daemon has no output")?;
        let mut lines = BufReader::new(output).lines();
        let mut addresses = Vec::new();
        while addresses.len() < 2 {
            let line = lines.next().ok_or("the daemon went down")??;
            addresses.extend(line.split_whitespace().nth(1).map(str::to_owned));
        }
        // What it goes on to print must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        let zenoh = addresses.pop().unwrap_or_default();
        let http = addresses.pop().unwrap_or_default();
        Ok(Daemon { process, http, zenoh, samples: Arc::default(), _scratch: scratch })
    }

    pub(crate) fn http(&self) -> &str {
        &self.http
    }

    pub(crate) fn zenoh(&self) -> &str {
        &self.zenoh
    }

    /// Reads the metrics once a second, until it is aborted.
    pub(crate) fn watcher(&self, start: Instant) -> impl Future<Output = ()> + Send + use<> {
        let (url, samples) = (format!("{}/metrics", self.http), self.samples.clone());
        let http = plain_http();
        async move {
            let mut ticks = tokio::time::interval_at(start, Duration::from_secs(1));
            loop {
                let time_s = (ticks.tick().await - start).as_secs_f64();
                let Ok(reply) = http.get(&url).send().await else { continue };
                let Ok(text) = reply.text().await else { continue };
                let sample = Sample { time_s, values: values(&text) };
                samples.lock().unwrap_or_else(PoisonError::into_inner).push(sample);
            }
        }
    }

    /// The metrics that are kept, now.
    pub(crate) async fn metrics(&self) -> Result<BTreeMap<String, f64>, Failure> {
        let reply = plain_http().get(format!("{}/metrics", self.http)).send().await?;
        Ok(values(&reply.text().await?))
    }

    pub(crate) fn samples(&self) -> Vec<Sample> {
        self.samples.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Asks it to go down, and waits for its end.
    pub(crate) fn stop(mut self) -> Result<(), Failure> {
        let pid = self.process.id().to_string();
        Command::new("kill").args(["-TERM", &pid]).status()?;
        let begun = std::time::Instant::now();
        while begun.elapsed() < PATIENCE {
            if let Some(status) = self.process.try_wait()? {
                return if status.success() {
                    Ok(())
                } else {
                    Err(format!("the daemon ended with {status}").into())
                };
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Err("the daemon did not go down".into())
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// The metrics that are kept, out of Prometheus's text.
fn values(text: &str) -> BTreeMap<String, f64> {
    let mut values: BTreeMap<String, f64> = KEPT.iter().map(|name| ((*name).into(), 0.0)).collect();
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let Some((metric, value)) = line.rsplit_once(' ') else { continue };
        let Ok(value) = value.parse::<f64>() else { continue };
        let (name, labels) = metric.split_once('{').unwrap_or((metric, ""));
        let is_waiting = labels.contains("kind=\"edit\"") && labels.contains("state=\"waiting\"");
        let name = if name == "sutura_tasks" && is_waiting { "sutura_edits_waiting" } else { name };
        if let Some(sum) = values.get_mut(name) {
            *sum += value;
        }
    }
    values
}
