//! The daemon's configuration: one struct for each concern, read from one TOML file.
//!
//! Every value has a default; a key that is not known, or a value out of range, is an error that
//! names the file and the line. The store's and the transports' own configuration is read in place,
//! so each default stands once, with its owner. `deploy/sutura.toml` lists everything.

mod access;
mod bounds;
mod data;
mod http;
mod limits;
mod log;
mod memory;
mod object_store;
mod shutdown;
mod telemetry;
mod tls;
mod traffic;
mod work;
mod zenoh;

pub(crate) use access::AccessConfig;
pub(crate) use data::{DataConfig, DataPath};
pub(crate) use http::HttpConfig;
pub(crate) use log::{LogConfig, LogFormat};
pub(crate) use memory::MemoryConfig;
pub(crate) use object_store::{NoCredentials, ObjectStoreConfig};
pub(crate) use shutdown::ShutdownConfig;
pub(crate) use telemetry::{BadHeader, TelemetryConfig};
pub(crate) use tls::{HalfTls, TlsConfig};
pub(crate) use zenoh::{ZenohConfig, ZenohEndpoint};

use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Everything the daemon can be told.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Config {
    /// Where sessions are kept.
    pub(crate) data: DataConfig,
    /// Where a fleet keeps them.
    pub(crate) object_store: ObjectStoreConfig,
    /// Who is let in.
    pub(crate) access: AccessConfig,
    /// The certificate that both doors show.
    pub(crate) tls: TlsConfig,
    /// Where HTTP is served.
    pub(crate) http: HttpConfig,
    /// Where Zenoh is served, and as whom.
    pub(crate) zenoh: ZenohConfig,
    /// What clients may ask of the transports.
    #[serde(with = "traffic::Traffic")]
    pub(crate) traffic: sutura_transport::Limits,
    /// Largest sizes accepted from a client.
    #[serde(with = "limits::Limits")]
    pub(crate) limits: sutura_store::Limits,
    /// Threads, queues and pacing.
    #[serde(with = "work::Work")]
    pub(crate) work: sutura_store::WorkConfig,
    /// What bodies may take up.
    pub(crate) memory: MemoryConfig,
    /// What is logged, and how.
    pub(crate) log: LogConfig,
    /// Where traces go.
    pub(crate) telemetry: TelemetryConfig,
    /// How the daemon ends.
    pub(crate) shutdown: ShutdownConfig,
}

/// Why a configuration file cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file says something it cannot.
    #[error("{}: {source}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What, and in which line.
        source: toml::de::Error,
    },
}

impl Config {
    /// Reads a file; what it does not say has its default.
    pub(crate) fn read(path: &Path) -> Result<Config, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| ConfigError::Unreadable { path: path.into(), source })?;
        Self::parse(&text).map_err(|source| ConfigError::Invalid { path: path.into(), source })
    }

    /// Reads a file's text.
    pub(crate) fn parse(text: &str) -> Result<Config, toml::de::Error> {
        toml::from_str(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    const SAMPLE: &str = include_str!("../../../deploy/sutura.toml");

    #[test]
    fn the_sample_file_states_the_defaults() {
        assert_eq!(toml::from_str::<Config>(SAMPLE).unwrap(), Config::default());
        assert_eq!(toml::from_str::<Config>("").unwrap(), Config::default());
    }

    /// The keys of a section (or the sections themselves), out of the error about a wrong one.
    fn known_keys(section: &str) -> BTreeSet<String> {
        let header = if section.is_empty() { String::new() } else { format!("[{section}]\n") };
        let error = toml::from_str::<Config>(&format!("{header}no_such_key = 1")).unwrap_err();
        let message = error.message().to_owned();
        let (_, expected) = message.split_once("expected").unwrap_or_else(|| panic!("{message}"));
        expected.split('`').skip(1).step_by(2).map(str::to_owned).collect()
    }

    /// The keys of a section of the sample file, those that are commented out included.
    fn sample_keys(section: &str) -> BTreeSet<String> {
        let header = format!("[{section}]");
        SAMPLE
            .lines()
            .skip_while(|line| *line != header)
            .skip(1)
            .take_while(|line| !line.starts_with('['))
            .filter_map(|line| line.trim_start_matches("# ").split_once(" = "))
            .map(|(key, _)| key.to_owned())
            .collect()
    }

    #[test]
    fn the_sample_file_names_every_option() {
        let sections = known_keys("");
        assert!(sections.len() > 5, "{sections:?}");
        for section in sections {
            let known = known_keys(&section);
            assert!(!known.is_empty(), "[{section}]");
            assert_eq!(sample_keys(&section), known, "[{section}]");
        }
    }

    #[test]
    fn errors_name_the_line() {
        for (text, line) in [
            ("[http]\nlisten = \"nowhere\"", 2),
            ("[work]\n\nn_build_threads = 0", 3),
            ("[limits]\nmin_dt_s = -1.0", 2),
            ("[limits]\nmax_tets = \"many\"", 2),
            ("[zenoh]\nlisten = \"udp/127.0.0.1:7447\"", 2),
            ("[log]\n\n\nformat = \"xml\"", 4),
            ("\n[logs]", 2),
        ] {
            let error = toml::from_str::<Config>(text).unwrap_err().to_string();
            assert!(error.contains(&format!("line {line}")), "{text}: {error}");
        }
    }

    #[test]
    fn an_error_names_the_file() {
        let missing = Config::read(Path::new("no/such/sutura.toml")).unwrap_err().to_string();
        assert!(missing.contains("no/such/sutura.toml"), "{missing}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bad.toml");
        std::fs::write(&path, "[http]\nport = 1").unwrap();
        let invalid = Config::read(&path).unwrap_err().to_string();
        assert!(invalid.contains("bad.toml") && invalid.contains("line 2"), "{invalid}");
    }
}
