//! The file of keys: one table for each, with its SHA-256 and what it opens.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer};
use sutura_transport::{KeyHash, Role};

/// Longest name of a tenant.
const MAX_TENANT_BYTES: usize = 64;

/// Digits of a key's hash that it is named by.
const NAME_DIGITS: usize = 12;

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyFile {
    #[serde(default, rename = "key")]
    keys: Vec<Entry>,
}

/// One key.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Entry {
    /// Whose sessions it opens.
    pub(crate) tenant: String,
    /// What it allows.
    #[serde(deserialize_with = "role")]
    pub(crate) role: Role,
    /// In hexadecimal digits.
    pub(crate) sha256: String,
}

fn role<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Role, D::Error> {
    let name = String::deserialize(deserializer)?;
    let role = Role::ALL.into_iter().find(|role| role.name() == name);
    role.ok_or_else(|| D::Error::custom(format_args!("there is no role {name:?}")))
}

/// Refuses what cannot be a tenant's name.
pub(crate) fn tenant(text: &str) -> Result<String, String> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    match (1..=MAX_TENANT_BYTES).contains(&text.len()) && text.chars().all(allowed) {
        true => Ok(text.to_owned()),
        false => Err(format!("1 to {MAX_TENANT_BYTES} letters, digits, '-', '_' and '.'")),
    }
}

impl Entry {
    /// What people call the key.
    pub(crate) fn name(&self) -> &str {
        self.sha256.get(..NAME_DIGITS).unwrap_or(&self.sha256)
    }

    /// Its hash, if it has one.
    pub(crate) fn hash(&self) -> Option<KeyHash> {
        let digits = self.sha256.as_bytes();
        let mut hash = KeyHash::default();
        // A sign would be taken for a digit.
        if digits.len() != 2 * hash.len() || !digits.iter().all(u8::is_ascii_hexdigit) {
            return None;
        }
        for (byte, pair) in hash.iter_mut().zip(digits.chunks_exact(2)) {
            *byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
        }
        Some(hash)
    }
}

/// The keys that a file's text names, each of them whole.
pub(crate) fn parse(text: &str) -> Result<Vec<Entry>, String> {
    let file: KeyFile = toml::from_str(text).map_err(|error| error.to_string())?;
    for entry in &file.keys {
        if entry.hash().is_none() || tenant(&entry.tenant).is_err() {
            return Err(format!("the key {:?} is malformed", entry.name()));
        }
    }
    Ok(file.keys)
}

/// The file's text.
pub(crate) fn text(entries: &[Entry]) -> String {
    let mut text =
        "# Hashes of keys (sutura key --help). Whoever can write here can open everything.\n"
            .to_owned();
    for Entry { tenant, role, sha256 } in entries {
        text += &format!(
            "\n[[key]]\ntenant = \"{tenant}\"\nrole = \"{role}\"\nsha256 = \"{sha256}\"\n"
        );
    }
    text
}
