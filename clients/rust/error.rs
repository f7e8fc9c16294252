//! Every way a call can fail.

use sutura_proto::Problem;
use sutura_proto::frame::FrameError;
use sutura_proto::state::StateFrameError;

/// The result of a call.
pub type Result<T> = std::result::Result<T, Error>;

/// Why a call failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The daemon refused, and says why.
    #[error(transparent)]
    Problem(Box<Problem>),
    /// The answer has an error status and no problem document: something else than a daemon spoke.
    #[error("the server answered with status {status}: {body}")]
    Status {
        /// The HTTP status.
        status: u16,
        /// The beginning of the answer.
        body: String,
    },
    /// The address is not one.
    #[error("{0:?} is not an http or https address")]
    Address(String),
    /// The identifier is not one.
    #[error("{0:?} is not a session identifier")]
    SessionId(String),
    /// HTTP could not carry the call.
    #[error("HTTP: {0}")]
    Http(#[from] reqwest::Error),
    /// The authority's certificate cannot be used.
    #[error("{}: {source}", path.display())]
    Ca {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong with it.
        source: rustls::pki_types::pem::Error,
    },
    /// TLS cannot be spoken.
    #[error("TLS: {0}")]
    Tls(#[source] rustls::Error),
    /// The WebSocket failed.
    #[error("WebSocket: {0}")]
    WebSocket(Box<tokio_tungstenite::tungstenite::Error>),
    /// Zenoh could not carry the call.
    #[error("Zenoh: {0}")]
    Zenoh(#[source] zenoh::Error),
    /// Zenoh needs Tokio's multi-threaded runtime.
    #[error("Zenoh runs on Tokio's multi-threaded runtime only")]
    Runtime,
    /// No daemon on this Zenoh network has the session.
    #[error("nobody answers for {0}")]
    Absent(String),
    /// The key cannot be sent in a header.
    #[error("this is no key")]
    Key,
    /// The answer is larger than this client accepts.
    #[error("the answer is larger than {limit} bytes")]
    TooLarge {
        /// Most bytes accepted.
        limit: usize,
    },
    /// The answer is not what the contract says.
    #[error("the server's answer cannot be read: {0}")]
    Decode(String),
    /// Two things do not fit together: coordinates and basis, a delta and its basis.
    #[error("{0}")]
    Mismatch(String),
    /// The session's build failed.
    #[error("the session could not be built: {0}")]
    BuildFailed(Box<Problem>),
}

impl Error {
    /// The status of the daemon's refusal, if it is one.
    pub fn status(&self) -> Option<u16> {
        match self {
            Error::Problem(problem) | Error::BuildFailed(problem) => Some(problem.status),
            Error::Status { status, .. } => Some(*status),
            _ => None,
        }
    }

    /// The daemon's problem document, if it sent one.
    pub fn problem(&self) -> Option<&Problem> {
        match self {
            Error::Problem(problem) | Error::BuildFailed(problem) => Some(problem),
            _ => None,
        }
    }
}

impl From<FrameError> for Error {
    fn from(error: FrameError) -> Self {
        Error::Decode(error.to_string())
    }
}

impl From<StateFrameError> for Error {
    fn from(error: StateFrameError) -> Self {
        Error::Decode(error.to_string())
    }
}

impl From<serde_json::Error> for Error {
    fn from(error: serde_json::Error) -> Self {
        Error::Decode(error.to_string())
    }
}

impl From<tokio_tungstenite::tungstenite::Error> for Error {
    fn from(error: tokio_tungstenite::tungstenite::Error) -> Self {
        Error::WebSocket(Box::new(error))
    }
}
