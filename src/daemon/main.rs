//! The sutura daemon and command line.

mod client;
mod command_line;
mod config;
mod daemon;
mod demo;
mod doctor;
mod export;
mod keys;
mod logging;
mod prepare;
mod signals;
mod telemetry;

use clap::Parser;
use client::export::ExportCommandError;
use command_line::{Command, CommandLine, ServeArgs};
use daemon::Daemon;
use demo::{DemoArgs, DemoError, SubscriberArgs};
use doctor::DoctorError;
use prepare::PrepareError;
use signals::{Signals, Wanted};
use std::io::Write;
use std::process::ExitCode;
use std::time::Instant;
use telemetry::{Telemetry, TelemetryError};

/// Builds and edits take and return hundreds of megabytes at a time: from the system's allocator
/// each comes as fresh 4 KiB pages, and the faults cost as much as the factorization itself
/// (stomach, 105 000 unknowns: 0.58 s of processor time against 0.36 s with this one, which keeps
/// pages for a while and takes huge ones).
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// What the user gave cannot be used.
const BAD_INPUT: u8 = 2;
/// Anything else that went wrong.
const FAILED: u8 = 1;

fn main() -> ExitCode {
    let result = match CommandLine::parse().command {
        Command::Serve(args) => block_on(serve(args)),
        Command::Key(args) => keys::run(args),
        Command::Open(args) => block_on(async { Ok(client::open::run(args).await?) }),
        Command::Info(args) => block_on(async { Ok(client::info(args).await?) }),
        Command::Stitch(args) => block_on(async { Ok(client::stitch(args).await?) }),
        Command::Watch(args) => block_on(async { Ok(client::watch(args).await?) }),
        Command::Export(args) => block_on(async { Ok(client::export::run(args).await?) }),
        Command::Prepare(args) => prepare::run(&args).map_err(Failure::from),
        Command::Demo(args) => block_on(demonstrate(args)),
        Command::Doctor(args) => block_on(async { Ok(doctor::run(&args).await?) }),
        Command::Completions { shell } => {
            command_line::print_completions(shell).map_err(Failure::from)
        }
        Command::DemoSubscriber(args) => block_on(watch(args)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) if failure.is_closed_pipe() => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("sutura: {}", failure.to_string().trim_end());
            if let Failure::Demo(error) = &failure {
                eprintln!("{}", error.advice());
            }
            ExitCode::from(failure.exit_code())
        }
    }
}

/// Runs `future` on a runtime of its own. Work that still blocks when it ends is left behind.
fn block_on(future: impl Future<Output = Result<(), Failure>>) -> Result<(), Failure> {
    let runtime = tokio::runtime::Runtime::new()?;
    let result = runtime.block_on(future);
    runtime.shutdown_background();
    result
}

/// Runs a daemon until it is told to stop. Each address it serves stands on one line of the
/// standard output, as soon as it can be used.
async fn serve(args: ServeArgs) -> Result<(), Failure> {
    let mut config = args.resolve()?;
    let telemetry = Telemetry::start(&config.telemetry, config.zenoh.name())?;
    logging::install(&config.log, telemetry.as_ref())?;
    let recorder = sutura_transport::install_recorder()?;
    let mut signals = Signals::listen()?;
    let daemon = Daemon::start(&config, recorder).await?;
    tracing::info!(http = daemon.http_url(), zenoh = daemon.zenoh_endpoint(), "serving");
    writeln!(std::io::stdout(), "http {}", daemon.http_url())?;
    writeln!(std::io::stdout(), "zenoh {}", daemon.zenoh_endpoint())?;

    let signal = loop {
        match signals.next().await {
            Wanted::Reload => daemon.reload(),
            Wanted::End(signal) => break signal,
        }
    };
    let deadline = config.shutdown.deadline;
    tracing::info!(signal, deadline_s = deadline.as_secs_f64(), "stopping");
    let stop = async {
        let begun = Instant::now();
        daemon.stop().await;
        if let Some(telemetry) = telemetry {
            telemetry.stop(deadline.saturating_sub(begun.elapsed())).await;
        }
    };
    tokio::select! {
        () = stop => Ok(()),
        signal = signals.end() => Err(Failure::Impatient(signal)),
    }
}

/// Runs a daemon on free loopback ports and demonstrates it.
async fn demonstrate(args: DemoArgs) -> Result<(), Failure> {
    let config = args.daemon_config();
    logging::install(&config.log, None)?;
    let daemon = Daemon::start(&config, sutura_transport::install_recorder()?).await?;
    let result = demo::run(&args, &daemon).await;
    daemon.stop().await;
    Ok(result?)
}

/// The watching process of the demonstration.
async fn watch(args: SubscriberArgs) -> Result<(), Failure> {
    Ok(demo::watch(&args).await?)
}

/// Why the program ends without having done what it was asked for.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Config(#[from] config::ConfigError),
    #[error(transparent)]
    LogFilter(#[from] logging::LogFilterError),
    #[error(transparent)]
    Telemetry(#[from] TelemetryError),
    #[error(transparent)]
    Key(#[from] keys::KeyError),
    #[error(transparent)]
    Start(#[from] daemon::StartError),
    #[error("cannot record metrics: {0}")]
    Metrics(#[from] metrics_exporter_prometheus::BuildError),
    #[error(transparent)]
    System(#[from] std::io::Error),
    #[error(transparent)]
    Client(#[from] client::ClientError),
    #[error(transparent)]
    Export(#[from] ExportCommandError),
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    #[error(transparent)]
    Doctor(#[from] DoctorError),
    #[error(transparent)]
    Demo(#[from] DemoError),
    #[error("{0} again: stopped without waiting for work under way")]
    Impatient(&'static str),
}

impl Failure {
    /// Whether whoever read the output has seen enough of it.
    fn is_closed_pipe(&self) -> bool {
        let error = match self {
            Failure::Client(error) => return error.is_closed_pipe(),
            Failure::Export(ExportCommandError::Client(error)) => return error.is_closed_pipe(),
            Failure::Prepare(PrepareError::Output(error))
            | Failure::Doctor(DoctorError::Output(error))
            | Failure::System(error) => error,
            _ => return false,
        };
        error.kind() == std::io::ErrorKind::BrokenPipe
    }

    fn exit_code(&self) -> u8 {
        match self {
            Failure::Config(_)
            | Failure::LogFilter(_)
            | Failure::Telemetry(TelemetryError::Header(_)) => BAD_INPUT,
            Failure::Key(keys::KeyError::Unknown(_) | keys::KeyError::Invalid { .. }) => BAD_INPUT,
            Failure::Start(
                daemon::StartError::Open { .. }
                | daemon::StartError::NoCredentials(_)
                | daemon::StartError::HalfTls(_)
                | daemon::StartError::Tls(_),
            ) => BAD_INPUT,
            Failure::Client(error) if error.is_bad_input() => BAD_INPUT,
            Failure::Export(error) if error.is_bad_input() => BAD_INPUT,
            Failure::Prepare(error) if error.is_bad_input() => BAD_INPUT,
            Failure::Doctor(DoctorError::Config(_)) => BAD_INPUT,
            Failure::Demo(error) if error.is_bad_input() => BAD_INPUT,
            Failure::Start(_)
            | Failure::Telemetry(_)
            | Failure::Key(_)
            | Failure::Metrics(_)
            | Failure::System(_)
            | Failure::Client(_)
            | Failure::Export(_)
            | Failure::Prepare(_)
            | Failure::Doctor(_)
            | Failure::Demo(_)
            | Failure::Impatient(_) => FAILED,
        }
    }
}
