//! The signals that end the daemon, and the one that has it read its certificate again.

use tokio::signal::unix::{Signal, SignalKind, signal};

/// SIGTERM, SIGINT and SIGHUP.
pub(crate) struct Signals {
    terminate: Signal,
    interrupt: Signal,
    hangup: Signal,
}

/// What a signal asks for.
pub(crate) enum Wanted {
    /// To read again what may have changed.
    Reload,
    /// To end, by the signal of this name.
    End(&'static str),
}

impl Signals {
    /// From now on the signals no longer end the process by themselves.
    pub(crate) fn listen() -> std::io::Result<Signals> {
        Ok(Signals {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            hangup: signal(SignalKind::hangup())?,
        })
    }

    /// Returns what the next signal asks for.
    pub(crate) async fn next(&mut self) -> Wanted {
        tokio::select! {
            _ = self.terminate.recv() => Wanted::End("SIGTERM"),
            _ = self.interrupt.recv() => Wanted::End("SIGINT"),
            _ = self.hangup.recv() => Wanted::Reload,
        }
    }

    /// Returns the name of the next signal that asks for the end.
    pub(crate) async fn end(&mut self) -> &'static str {
        loop {
            if let Wanted::End(signal) = self.next().await {
                return signal;
            }
        }
    }
}
