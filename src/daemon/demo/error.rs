//! Why the demonstration stopped.

use std::path::Path;

/// What went wrong, and whose fault it was.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DemoError {
    /// What the user gave cannot be used.
    #[error("{0}")]
    Input(String),
    /// The daemon refused, or could not be reached.
    #[error("{doing}: {error}")]
    Client { doing: &'static str, error: sutura_client::Error },
    /// A file could not be written, or a process could not be started.
    #[error("{doing}: {error}")]
    System { doing: String, error: std::io::Error },
    /// The daemon did not do what it should.
    #[error("{0}")]
    Unexpected(String),
}

impl DemoError {
    /// A JSON file that cannot be used, with the line at fault.
    pub(crate) fn json(path: &Path, error: &serde_json::Error) -> DemoError {
        let message = error.to_string();
        // serde_json appends the place; it belongs in front.
        let place = format!(" at line {} column {}", error.line(), error.column());
        let message = message.strip_suffix(&place).unwrap_or(&message);
        DemoError::Input(format!("{}: line {}: {message}", path.display(), error.line()))
    }

    pub(crate) fn system(doing: impl Into<String>) -> impl FnOnce(std::io::Error) -> DemoError {
        let doing = doing.into();
        move |error| DemoError::System { doing, error }
    }

    /// Whether the user's input is at fault: the daemon's refusals are, unless it was busy.
    pub(crate) fn is_bad_input(&self) -> bool {
        match self {
            DemoError::Input(_) => true,
            DemoError::Client { error, .. } => {
                error.status().is_some_and(|status| (400..500).contains(&status) && status != 429)
            }
            DemoError::System { .. } | DemoError::Unexpected(_) => false,
        }
    }

    /// What the user can do about it.
    pub(crate) fn advice(&self) -> &'static str {
        match self {
            DemoError::Input(_) => "Correct the file named above and run the same command again.",
            DemoError::Client { .. } if self.is_bad_input() => {
                "The daemon names the value at fault: correct the mesh, the configuration or the \
                 stitches, and run the same command again."
            }
            DemoError::Client { .. } => {
                "The embedded daemon did not answer as it should: run again with \
                 --log debug to see why."
            }
            DemoError::System { .. } => {
                "Check that the folder given by --out can be written to and that processes can be \
                 started, then run again."
            }
            DemoError::Unexpected(_) => {
                "This is a fault of the daemon: please report it with the report written so far."
            }
        }
    }
}

/// Names what was being done when a call to the daemon failed.
pub(crate) trait Doing<T> {
    fn doing(self, doing: &'static str) -> Result<T, DemoError>;
}

impl<T> Doing<T> for Result<T, sutura_client::Error> {
    fn doing(self, doing: &'static str) -> Result<T, DemoError> {
        self.map_err(|error| DemoError::Client { doing, error })
    }
}
