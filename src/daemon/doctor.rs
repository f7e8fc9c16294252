//! `sutura doctor`: whether this machine can run a daemon as configured, and what it has.

use crate::config::{Config, ConfigError};
use crate::telemetry::Collector;
use clap::Args;
use serde::Serialize;
use std::io::{IsTerminal, Write};
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use sutura_client::Client;
use sutura_objects::Objects;
use sutura_transport::Tls;

/// Options of `sutura doctor`.
#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    /// The daemon's configuration file; without one, the defaults are checked.
    #[arg(long, env = "SUTURA_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Memory below which large bodies cannot be prepared, in bytes.
const LITTLE_MEMORY: u64 = 4 << 30;

/// How long a daemon may take to say that it is there.
const DAEMON_PATIENCE: Duration = Duration::from_secs(2);

/// Days of a certificate that call for a new one.
const FEW_DAYS: i64 = 14;

/// Seconds of a day.
const DAY_S: i64 = 24 * 60 * 60;

/// How a check went.
#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Outcome {
    Ok,
    Warning,
    Failed,
}

/// One thing that was checked.
#[derive(Serialize)]
struct Check {
    name: &'static str,
    outcome: Outcome,
    /// What was found.
    found: String,
    /// What to do about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    advice: Option<String>,
}

impl Check {
    fn ok(name: &'static str, found: impl Into<String>) -> Check {
        Check { name, outcome: Outcome::Ok, found: found.into(), advice: None }
    }

    fn not_ok(
        name: &'static str,
        outcome: Outcome,
        found: impl Into<String>,
        advice: impl Into<String>,
    ) -> Check {
        Check { name, outcome, found: found.into(), advice: Some(advice.into()) }
    }
}

/// Why the checks did not pass.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DoctorError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("standard output: {0}")]
    Output(#[from] std::io::Error),
    #[error("{0} of the checks failed")]
    Failed(usize),
}

/// Checks and prints.
pub(crate) async fn run(args: &DoctorArgs) -> Result<(), DoctorError> {
    let config = match &args.config {
        Some(path) => Config::read(path)?,
        None => Config::default(),
    };
    let mut checks = vec![
        Check::ok(
            "version",
            format!(
                "sutura {} on {} {}",
                env!("CARGO_PKG_VERSION"),
                std::env::consts::OS,
                std::env::consts::ARCH
            ),
        ),
        cores(&config),
        memory(),
        files(&config),
        data(&config),
    ];
    checks.extend(object_store(&config).await);
    checks.extend(collector(&config).await);
    checks.extend(tls(&config));
    let is_served = daemon(&config, &mut checks).await;
    checks.push(port("http", config.http.listen, is_served));
    checks.push(port("zenoh", config.zenoh.listen.0, is_served));
    print(&checks, args.json)?;
    match checks.iter().filter(|check| check.outcome == Outcome::Failed).count() {
        0 => Ok(()),
        n => Err(DoctorError::Failed(n)),
    }
}

fn cores(config: &Config) -> Check {
    let n = std::thread::available_parallelism().map_or(1, usize::from);
    let work = &config.work;
    let found = format!(
        "{n} cores for {} build, {} query and {} stepping threads",
        work.n_build_threads, work.n_query_threads, work.n_stepping_threads
    );
    match n {
        0..=1 => Check::not_ok(
            "cores",
            Outcome::Warning,
            found,
            "a build and a simulation share one core: motion will stutter while bodies are prepared",
        ),
        _ => Check::ok("cores", found),
    }
}

/// What the kernel says is available; only Linux says it.
fn memory() -> Check {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let available = text.lines().find_map(|line| {
        let kib: u64 =
            line.strip_prefix("MemAvailable:")?.split_whitespace().next()?.parse().ok()?;
        Some(kib << 10)
    });
    match available {
        None => Check::ok("memory", "unknown: the system does not say"),
        Some(bytes) => {
            let found = format!("{:.1} GiB available", bytes as f64 / f64::from(1 << 30));
            if bytes < LITTLE_MEMORY {
                let advice = "bodies of more than some 50 000 vertices may not fit";
                Check::not_ok("memory", Outcome::Warning, found, advice)
            } else {
                Check::ok("memory", found)
            }
        }
    }
}

/// Files that a daemon has open beside its connections, generously.
const FILES_APART: usize = 128;

/// Whether there may be as many connections as configured; only Linux says it.
fn files(config: &Config) -> Check {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let open = limits.lines().find_map(|line| {
        line.strip_prefix("Max open files")?.split_whitespace().next()?.parse::<usize>().ok()
    });
    let Some(most) = open else { return Check::ok("files", "unknown: the system does not say") };
    let connections = config.traffic.max_connections + config.zenoh.max_zenoh_sessions;
    let found = format!("{most} may be open, {connections} of them connections");
    if most < connections + FILES_APART {
        let advice =
            "raise the limit (ulimit -n, LimitNOFILE=) or lower max_connections in [traffic]";
        Check::not_ok("files", Outcome::Warning, found, advice)
    } else {
        Check::ok("files", found)
    }
}

/// Whether sessions can be kept: the folder, or the nearest one above it that is there, is tried.
fn data(config: &Config) -> Check {
    let Some(path) = &config.data.path.0 else {
        return Check::ok("data", "sessions are kept in memory alone, as configured");
    };
    let existing =
        path.ancestors().map(|p| if p.as_os_str().is_empty() { Path::new(".") } else { p });
    let Some(folder) = existing.into_iter().find(|folder| folder.exists()) else {
        let advice = "name a folder that can be made: sutura serve --data DIR";
        let found = format!("{}: no folder above it exists", path.display());
        return Check::not_ok("data", Outcome::Failed, found, advice);
    };
    // Its name tells whose it is, should it be left behind.
    let probe = folder.join(format!(".sutura-doctor-{}", std::process::id()));
    match std::fs::create_dir(&probe).and_then(|()| std::fs::remove_dir(&probe)) {
        Ok(()) => Check::ok("data", format!("{} can be written to", path.display())),
        Err(error) => Check::not_ok(
            "data",
            Outcome::Failed,
            format!("{}: {error}", folder.display()),
            "sessions would not outlast the daemon: serve --data a folder that can be written to, or none",
        ),
    }
}

/// Whether the bucket of a fleet can be reached and keeps to what the sessions need.
async fn object_store(config: &Config) -> Option<Check> {
    const NAME: &str = "objects";
    let failed =
        |found: String, advice: &str| Some(Check::not_ok(NAME, Outcome::Failed, found, advice));
    let s3 = match config.object_store.s3(|name| std::env::var(name).ok()) {
        Ok(None) => return None,
        Ok(Some(s3)) => s3,
        Err(error) => return failed(error.to_string(), "name somebody who may use the bucket"),
    };
    let place = format!("{}/{}", s3.bucket, s3.prefix);
    let open = move || Objects::s3(&s3, "doctor").map(drop).map_err(|error| error.to_string());
    match tokio::task::spawn_blocking(open).await.unwrap_or_else(|error| Err(error.to_string())) {
        Ok(()) => Some(Check::ok(NAME, format!("{place} keeps to the conditions of a put"))),
        Err(error) => failed(
            format!("{place}: {error}"),
            "look at [object_store], at the credentials, and at the store",
        ),
    }
}

/// Whether the collector of traces can be reached and takes what it is sent. A daemon does without.
async fn collector(config: &Config) -> Option<Check> {
    const NAME: &str = "collector";
    let traces = config.telemetry.otlp_endpoint.as_ref()?.traces();
    let opened = Collector::of(&config.telemetry).map_err(|error| error.to_string());
    let answer = match opened.transpose()? {
        Ok(collector) => collector.probe().await.map_err(|error| error.to_string()),
        Err(error) => {
            let advice = "a daemon would not start: correct it";
            return Some(Check::not_ok(NAME, Outcome::Failed, error, advice));
        }
    };
    Some(match answer {
        Ok(()) => Check::ok(NAME, format!("{traces} takes traces")),
        Err(error) => Check::not_ok(
            NAME,
            Outcome::Warning,
            format!("{traces}: {error}"),
            "traces would be lost, nothing else: look at [telemetry], and at the collector",
        ),
    })
}

/// Whether the certificate and its key fit together, and how long they are good.
fn tls(config: &Config) -> Option<Check> {
    const NAME: &str = "tls";
    let failed =
        |found: String, advice: &str| Some(Check::not_ok(NAME, Outcome::Failed, found, advice));
    let files = match config.tls.files() {
        Ok(None) => return None,
        Ok(Some(files)) => files,
        Err(error) => return failed(error.to_string(), "name the other file, too"),
    };
    let certificate = files.certificate.display().to_string();
    let validity = Tls::load(files).and_then(|tls| tls.validity_s());
    let validity = match validity {
        Ok(validity) => validity,
        Err(error) => {
            return failed(error.to_string(), "both files are PEM, and of the same pair of keys");
        }
    };
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let now = i64::try_from(since_1970.as_secs()).unwrap_or(i64::MAX);
    let days = (validity.end() - now).div_euclid(DAY_S);
    if now < *validity.start() {
        let found = format!("{certificate} is not good yet");
        return failed(found, "look at the clock, or wait: no client accepts it before");
    }
    if days < 0 {
        let found = format!("{certificate} expired {} days ago", -days);
        return failed(found, "renew it, then send SIGHUP to the daemon");
    }
    let found = format!("{certificate} fits its key and is good for {days} days");
    if days < FEW_DAYS {
        let advice = "renew it, then send SIGHUP to the daemon";
        return Some(Check::not_ok(NAME, Outcome::Warning, found, advice));
    }
    Some(Check::ok(NAME, found))
}

/// Whether a daemon answers where this one would serve.
async fn daemon(config: &Config, checks: &mut Vec<Check>) -> bool {
    let url = format!("http://{}", config.http.listen);
    let answer = tokio::time::timeout(DAEMON_PATIENCE, Client::connect(&url)).await;
    let is_served = matches!(answer, Ok(Ok(_)));
    let found = if is_served { format!("one answers at {url}") } else { "none is running".into() };
    checks.push(Check::ok("daemon", found));
    is_served
}

fn port(name: &'static str, address: SocketAddr, is_served: bool) -> Check {
    match TcpListener::bind(address) {
        Ok(_) => Check::ok(name, format!("{address} is free")),
        Err(_) if is_served => {
            Check::ok(name, format!("{address} is in use, by the daemon that runs"))
        }
        Err(error) => Check::not_ok(
            name,
            Outcome::Failed,
            format!("{address}: {error}"),
            format!("stop what uses it, or serve elsewhere: sutura serve --{name} …"),
        ),
    }
}

fn print(checks: &[Check], json: bool) -> Result<(), DoctorError> {
    let stdout = std::io::stdout();
    let is_coloured = stdout.is_terminal() && std::env::var_os("NO_COLOR").is_none();
    let mut out = stdout.lock();
    if json {
        let text = serde_json::to_string_pretty(checks).map_err(std::io::Error::from)?;
        return Ok(writeln!(out, "{text}")?);
    }
    for check in checks {
        let (word, colour) = match check.outcome {
            Outcome::Ok => ("ok", 32),
            Outcome::Warning => ("warning", 33),
            Outcome::Failed => ("failed", 31),
        };
        let word = if is_coloured {
            format!("\x1b[{colour}m{word:8}\x1b[0m")
        } else {
            format!("{word:8}")
        };
        writeln!(out, "{word} {:10} {}", check.name, check.found)?;
        if let Some(advice) = &check.advice {
            writeln!(out, "{:19} {advice}", "")?;
        }
    }
    Ok(())
}
