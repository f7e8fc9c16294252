//! A real daemon for one test: its own process, free ports, a scratch directory.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use sutura_client::{Client, ZenohClient};

/// How long a daemon may take to go down, or to publish a state: far longer than it ever does.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// A running daemon; killed when dropped.
pub(crate) struct Daemon {
    process: Child,
    scratch: Option<tempfile::TempDir>,
    /// Such as `http://127.0.0.1:8080`.
    pub(crate) http: String,
    /// Such as `tcp/127.0.0.1:7447`.
    pub(crate) zenoh: String,
}

impl Daemon {
    /// Starts one and waits until it has said where it listens.
    pub(crate) fn start() -> Daemon {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("data");
        let mut daemon = Daemon::start_on(&folder);
        daemon.scratch = Some(scratch);
        daemon
    }

    /// Starts one on a data directory.
    pub(crate) fn start_on(folder: &Path) -> Daemon {
        Daemon::start_with(folder, &[])
    }

    /// Starts one on a data directory, with further arguments.
    pub(crate) fn start_with(folder: &Path, arguments: &[&OsStr]) -> Daemon {
        Daemon::start_as(Command::new(env!("CARGO_BIN_EXE_sutura")), folder, arguments)
    }

    /// Starts one by a command of one's own.
    pub(crate) fn start_as(sutura: Command, folder: &Path, arguments: &[&OsStr]) -> Daemon {
        Daemon::launch(sutura, folder, arguments, "warn", Stdio::inherit())
    }

    /// Starts one on a data directory, with its log of this level and above in a place of its own.
    pub(crate) fn start_logging(folder: &Path, level: &str, log: Stdio) -> Daemon {
        let sutura = Command::new(env!("CARGO_BIN_EXE_sutura"));
        Daemon::launch(sutura, folder, &[], level, log)
    }

    /// Starts one by a command of one's own, on a data directory, with further arguments and a log.
    pub(crate) fn launch(
        mut sutura: Command,
        folder: &Path,
        arguments: &[&OsStr],
        level: &str,
        log: Stdio,
    ) -> Daemon {
        let mut process = sutura
            .args(["serve", "--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0", "--log", level])
            .arg("--data")
            .arg(folder)
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let mut address = |door: &str| {
            let mut lines = lines.by_ref().map(Result::unwrap);
            let found = lines.find_map(|line| line.strip_prefix(door).map(str::to_owned));
            found.unwrap_or_else(|| panic!("the daemon named no address of {door}"))
        };
        let (http, zenoh) = (address("http "), address("zenoh "));
        // What it goes on to print must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        Daemon { process, scratch: None, http, zenoh }
    }

    /// Ends it as no program can prevent, in the midst of whatever it does.
    pub(crate) fn kill(mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }

    /// A client of it over HTTP.
    pub(crate) async fn client(&self) -> Client {
        Client::connect(&self.http).await.unwrap()
    }

    /// A client of it over Zenoh.
    pub(crate) async fn zenoh_client(&self) -> ZenohClient {
        ZenohClient::open(&self.zenoh).await.unwrap()
    }

    /// The address of `path` on it.
    pub(crate) fn url(&self, path: &str) -> String {
        format!("{}{path}", self.http.trim_end_matches('/'))
    }

    /// Asks it to read again what may have changed.
    pub(crate) fn hang_up(&self) {
        self.signal("-HUP");
    }

    fn signal(&self, name: &str) {
        let pid = self.process.id().to_string();
        assert!(Command::new("kill").args([name, &pid]).status().unwrap().success());
    }

    /// Asks it to go down, and waits for its end.
    pub(crate) fn terminate(mut self) -> ExitStatus {
        self.signal("-TERM");
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE {
            if let Some(status) = self.process.try_wait().unwrap() {
                return status;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        panic!("the daemon did not go down");
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
