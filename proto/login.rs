//! How somebody who has a key joins Zenoh: by a name and a password that follow from the key.
//!
//! The key itself does not travel when a connection is made. The password is the key's SHA-256, which is all
//! that a daemon keeps of it.

use sha2::{Digest as _, Sha256};

/// Digits of the hash that a key is named by.
const NAME_DIGITS: usize = 12;

/// What Zenoh's user and password are.
#[derive(Clone, PartialEq, Eq)]
pub struct Login {
    /// The first 12 hexadecimal digits of the key's SHA-256, by which `sutura key list` names it, too.
    pub user: String,
    /// All 64 of them, in lower case.
    pub password: String,
}

impl Login {
    /// Of a key.
    pub fn of_key(key: &str) -> Login {
        Login::of_hash(&Sha256::digest(key).into())
    }

    /// Of a key's SHA-256.
    pub fn of_hash(hash: &[u8; 32]) -> Login {
        let password: String = hash.iter().map(|byte| format!("{byte:02x}")).collect();
        Login { user: password[..NAME_DIGITS].to_owned(), password }
    }
}

/// Without the password.
impl std::fmt::Debug for Login {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Login").field("user", &self.user).finish_non_exhaustive()
    }
}
