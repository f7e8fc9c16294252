//! The command line. Flags override environment variables, which override the file.

use crate::client::export::ExportArgs;
use crate::client::open::OpenArgs;
use crate::client::{InfoArgs, StitchArgs, WatchArgs};
use crate::config::{Config, ConfigError, DataPath, LogFormat, ZenohEndpoint};
use crate::demo::{DemoArgs, SUBSCRIBER_COMMAND, SubscriberArgs};
use crate::doctor::DoctorArgs;
use crate::keys::KeyArgs;
use crate::prepare::PrepareArgs;
use clap::builder::FalseyValueParser;
use clap::{Args, CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;

/// What stands below the list of commands.
const AFTER_HELP: &str = "\
Examples:
  sutura demo                                            the main job, on a bundled stomach
  sutura serve                                           a daemon on this machine alone
  sutura prepare liver.msh --config liver.json --out liver
  sutura open liver.msh --config liver.json              a session of it, ready
  sutura info                                            its sessions
  sutura stitch SESSION --pair 17,4021 --stiffness 1e5
  sutura export SESSION --out film --record 2            two seconds of its motion

Exit codes: 0 done, 2 bad input (the message names the file and the line, vertex or tet at fault), 1
anything else. SUTURA_SERVER names the daemon that open, info, stitch, watch and export ask.";

/// Keeps deformable bodies ready for interactive editing.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true, after_help = AFTER_HELP)]
pub(crate) struct CommandLine {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// What the program can do.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Serve bodies over HTTP and Zenoh until SIGTERM or SIGINT.
    Serve(ServeArgs),
    /// Make, list and revoke the keys that open a daemon.
    Key(KeyArgs),
    /// Open a session of a running daemon on a mesh file, and wait until it is ready.
    Open(OpenArgs),
    /// Show the sessions of a running daemon, or one of them.
    Info(InfoArgs),
    /// Stitch a body of a running daemon.
    Stitch(StitchArgs),
    /// Follow what happens to a session of a running daemon.
    Watch(WatchArgs),
    /// Write a session of a running daemon, and its motion, for other tools.
    Export(ExportArgs),
    /// Build a body without a daemon, and write it for other tools.
    ///
    /// The mesh and the configuration are those that `POST /v1/sessions` takes; modes and basis are
    /// written as .npy for NumPy, .vtu for ParaView, .glb for viewers of glTF, .U and .Ulin for Vega, and as
    /// pictures.
    Prepare(PrepareArgs),
    /// Show the main job on a bundled stomach, or on your own mesh, and leave a report and pictures.
    Demo(DemoArgs),
    /// Check whether this machine can run a daemon as configured: cores, memory, data folder, ports.
    Doctor(DoctorArgs),
    /// Print completions for a shell: `source <(sutura completions bash)`.
    Completions {
        /// The shell.
        shell: Shell,
    },
    /// Watch a simulation for `demo`.
    #[command(name = SUBSCRIBER_COMMAND, hide = true)]
    DemoSubscriber(SubscriberArgs),
}

/// Options of `sutura serve`.
#[derive(Debug, Default, Args)]
pub(crate) struct ServeArgs {
    /// Configuration file; every option stands in deploy/sutura.toml. Without one, and without
    /// other flags, the daemon listens on loopback only.
    #[arg(long, env = "SUTURA_CONFIG", value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// Address to serve HTTP on; port 0 takes a free one.
    #[arg(long, env = "SUTURA_HTTP", value_name = "ADDR:PORT")]
    pub(crate) http: Option<SocketAddr>,
    /// Endpoint to serve Zenoh on, such as tcp/127.0.0.1:7447; port 0 takes a free one.
    #[arg(long, env = "SUTURA_ZENOH", value_name = "ENDPOINT")]
    pub(crate) zenoh: Option<ZenohEndpoint>,
    /// Folder to keep sessions in; `none` keeps them in memory alone. Default: sutura-data.
    #[arg(long, env = "SUTURA_DATA", value_name = "DIR")]
    pub(crate) data: Option<DataPath>,
    /// What to log, such as `info,sutura_store=debug`.
    #[arg(long, env = "SUTURA_LOG", value_name = "FILTER")]
    pub(crate) log: Option<String>,
    /// Log one JSON object a line.
    #[arg(long, env = "SUTURA_JSON", value_parser = FalseyValueParser::new())]
    pub(crate) json: bool,
}

impl ServeArgs {
    /// The file's configuration, or the default one, with these options laid over it.
    pub(crate) fn resolve(self) -> Result<Config, ConfigError> {
        let mut config = match &self.config {
            Some(path) => Config::read(path)?,
            None => Config::default(),
        };
        if let Some(listen) = self.http {
            config.http.listen = listen;
        }
        if let Some(listen) = self.zenoh {
            config.zenoh.listen = listen;
        }
        if let Some(path) = self.data {
            config.data.path = path;
        }
        if let Some(filter) = self.log {
            config.log.filter = filter;
        }
        if self.json {
            config.log.format = LogFormat::Json;
        }
        Ok(config)
    }
}

/// Prints the completions of every command for `shell`.
pub(crate) fn print_completions(shell: Shell) -> std::io::Result<()> {
    let mut command = CommandLine::command();
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut command, "sutura", &mut text);
    std::io::stdout().write_all(&text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        CommandLine::command().debug_assert();
    }

    #[test]
    fn flags_override_the_file_and_leave_the_rest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sutura.toml");
        std::fs::write(&path, "[http]\nlisten = \"127.0.0.1:1\"\n[work]\nn_build_threads = 5")
            .unwrap();
        let http = "127.0.0.1:2".parse().unwrap();
        let args = ServeArgs { config: Some(path), http: Some(http), ..ServeArgs::default() };
        let config = args.resolve().unwrap();
        assert_eq!(config.http.listen, http);
        assert_eq!(config.work.n_build_threads, 5);
        assert_eq!(config.zenoh, Config::default().zenoh);
    }

    #[test]
    fn without_options_only_loopback_is_served() {
        let config = ServeArgs::default().resolve().unwrap();
        assert!(config.http.listen.ip().is_loopback());
        assert!(config.zenoh.listen.0.ip().is_loopback());
    }
}
