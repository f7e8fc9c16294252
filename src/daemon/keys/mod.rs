//! `sutura key`, and the keys of a data directory.

pub(crate) mod file;

use clap::{Args, Subcommand, ValueEnum};
use file::{Entry, tenant};
use std::fs;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use sutura_transport::{Grant, Keyring, Role, hash, key};

/// The file's name in the data directory.
const FILE: &str = "keys.toml";

/// Options of `sutura key`.
#[derive(Debug, Args)]
pub(crate) struct KeyArgs {
    #[command(subcommand)]
    command: KeyCommand,
    /// The data directory of the daemon that the keys open.
    #[arg(
        long,
        env = "SUTURA_DATA",
        value_name = "DIR",
        default_value = "sutura-data",
        global = true
    )]
    data: PathBuf,
}

/// What can be done with keys. A running daemon notices within seconds.
#[derive(Debug, Subcommand)]
enum KeyCommand {
    /// Make a key and print it, once: only its hash is kept.
    New {
        /// Whose sessions it opens.
        #[arg(long, value_parser = tenant)]
        tenant: String,
        /// What it allows.
        #[arg(long, value_enum)]
        role: RoleName,
    },
    /// Show the keys there are, by the first digits of their hashes.
    List,
    /// Make a key useless.
    Revoke {
        /// Its name in the list.
        name: String,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RoleName {
    /// Look, evaluate and listen.
    Read,
    /// Open, edit, simulate and delete sessions too.
    Edit,
    /// See the daemon's metrics too.
    Admin,
}

impl RoleName {
    fn role(self) -> Role {
        match self {
            RoleName::Read => Role::Read,
            RoleName::Edit => Role::Edit,
            RoleName::Admin => Role::Admin,
        }
    }
}

/// Why keys could not be read or written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum KeyError {
    /// The file cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// The file says something it cannot.
    #[error("{}: {message}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What, and where.
        message: String,
    },
    /// The system has no random numbers.
    #[error("no random numbers: {0}")]
    Random(getrandom::Error),
    /// No key has this name.
    #[error("there is no key {0}")]
    Unknown(String),
}

/// The keys of a data directory, as they are in its file.
#[derive(Clone, Debug)]
pub(crate) struct KeyStore {
    path: PathBuf,
}

impl KeyStore {
    pub(crate) fn in_folder(folder: &Path) -> KeyStore {
        KeyStore { path: folder.join(FILE) }
    }

    fn entries(&self) -> Result<Vec<Entry>, KeyError> {
        let path = || self.path.clone();
        let text = match fs::read_to_string(&self.path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(source) => return Err(KeyError::File { path: path(), source }),
        };
        file::parse(&text).map_err(|message| KeyError::Invalid { path: path(), message })
    }

    fn write(&self, entries: &[Entry]) -> Result<(), KeyError> {
        let failed = |source| KeyError::File { path: self.path.clone(), source };
        let temporary = self.path.with_extension("tmp");
        let write = || {
            if let Some(folder) = self.path.parent() {
                fs::create_dir_all(folder)?;
            }
            let mut options = fs::OpenOptions::new();
            // Nobody else: what is kept of a key opens Zenoh.
            let mut file =
                options.write(true).create(true).truncate(true).mode(0o600).open(&temporary)?;
            file.write_all(file::text(entries).as_bytes())?;
            file.sync_all()?;
            fs::rename(&temporary, &self.path)
        };
        write().map_err(failed)
    }

    /// What opens the daemon.
    pub(crate) fn keyring(&self) -> Result<Keyring, KeyError> {
        let grant = |entry: &Entry| {
            let grant = Grant { tenant: Arc::from(&*entry.tenant), role: entry.role };
            entry.hash().map(|hash| (hash, grant))
        };
        Ok(self.entries()?.iter().filter_map(grant).collect())
    }

    fn add(&self, tenant: String, role: RoleName) -> Result<String, KeyError> {
        let mut bits = [0; 32];
        getrandom::fill(&mut bits).map_err(KeyError::Random)?;
        let key = key(&bits);
        let sha256 = hash(&key).iter().map(|byte| format!("{byte:02x}")).collect();
        let mut entries = self.entries()?;
        entries.push(Entry { tenant, role: role.role(), sha256 });
        self.write(&entries)?;
        Ok(key)
    }

    fn revoke(&self, name: &str) -> Result<(), KeyError> {
        let mut entries = self.entries()?;
        let n_before = entries.len();
        entries.retain(|entry| entry.name() != name);
        if entries.len() == n_before {
            return Err(KeyError::Unknown(name.to_owned()));
        }
        self.write(&entries)
    }
}

/// Runs `sutura key`.
pub(crate) fn run(args: KeyArgs) -> Result<(), crate::Failure> {
    let store = KeyStore::in_folder(&args.data);
    let mut out = std::io::stdout();
    match args.command {
        KeyCommand::New { tenant, role } => writeln!(out, "{}", store.add(tenant, role)?)?,
        KeyCommand::List => {
            for entry in store.entries()? {
                writeln!(out, "{}  {:5}  {}", entry.name(), entry.role.name(), entry.tenant)?;
            }
        }
        KeyCommand::Revoke { name } => store.revoke(&name)?,
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_made_listed_and_revoked_and_only_their_hashes_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let store = KeyStore::in_folder(folder.path());
        assert!(store.keyring().unwrap().is_empty());
        let first = store.add("a".into(), RoleName::Read).unwrap();
        let second = store.add("b".into(), RoleName::Admin).unwrap();
        assert_ne!(first, second);
        let grant = |tenant: &str, role| Grant { tenant: tenant.into(), role };
        let expected: Keyring =
            [(hash(&first), grant("a", Role::Read)), (hash(&second), grant("b", Role::Admin))]
                .into_iter()
                .collect();
        assert_eq!(store.keyring().unwrap(), expected);
        let text = fs::read_to_string(folder.path().join(FILE)).unwrap();
        assert!(!text.contains(&first) && !text.contains(&first[7..]));

        let name = store.entries().unwrap()[0].name().to_owned();
        store.revoke(&name).unwrap();
        assert_eq!(store.keyring().unwrap().len(), 1);
        assert!(matches!(store.revoke(&name), Err(KeyError::Unknown(_))));
    }

    #[test]
    fn a_file_that_says_something_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let store = KeyStore::in_folder(folder.path());
        for text in [
            "[[key]]\ntenant = \"a\"\nrole = \"read\"\nsha256 = \"00\"",
            "[[key]]\ntenant = \"a b\"\nrole = \"read\"\nsha256 = \"00\"",
            "[[key]]\ntenant = \"a\"\nrole = \"root\"\nsha256 = \"00\"",
            "[[keys]]",
        ] {
            fs::write(folder.path().join(FILE), text).unwrap();
            assert!(store.keyring().is_err(), "{text}");
        }
    }
}
