//! Who may do what: keys, the tenants they belong to, and roles.
//!
//! A key is 256 random bits. What is kept of it is its SHA-256: with that many bits there is nothing to
//! guess, so a slow hash would add nothing, and looking up a hash tells nobody who measures the time
//! anything about a key.

use crate::gateway::Gateway;
use crate::problem::{Kind, Problem};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::sync::Arc;
use sutura_store::{Account, SessionId, StoreError};

/// What the keys of a daemon begin with, so that a key is known for one wherever it turns up.
const PREFIX: &str = "sutura_";

/// Longest text that is tried as a key.
const MAX_KEY_BYTES: usize = 128;

/// What a key's holder may do with the sessions of its tenant; each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Look, evaluate and listen.
    Read,
    /// Open, edit, simulate and delete sessions.
    Edit,
    /// See the daemon's metrics too.
    Admin,
}

impl Role {
    /// Every role.
    pub const ALL: [Role; 3] = [Role::Read, Role::Edit, Role::Admin];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Role::Read => "read",
            Role::Edit => "edit",
            Role::Admin => "admin",
        }
    }
}

impl std::fmt::Display for Role {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// The SHA-256 of a key.
pub type KeyHash = [u8; 32];

/// What is kept of a key.
pub fn hash(key: &str) -> KeyHash {
    Sha256::digest(key).into()
}

/// A key of these bits, as its holder writes it.
pub fn key(bits: &[u8; 32]) -> String {
    bits.iter().fold(PREFIX.to_owned(), |key, byte| key + &format!("{byte:02x}"))
}

/// What a key opens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Grant {
    /// Whose sessions.
    pub tenant: Arc<str>,
    /// What with them.
    pub role: Role,
}

/// The keys of a daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Keyring {
    grants: BTreeMap<KeyHash, Grant>,
    is_open: bool,
}

impl Default for Keyring {
    /// Nobody is asked for a key, and everybody may do everything.
    fn default() -> Keyring {
        Keyring { grants: BTreeMap::new(), is_open: true }
    }
}

impl FromIterator<(KeyHash, Grant)> for Keyring {
    /// These keys open the daemon, and nothing else does.
    fn from_iter<I: IntoIterator<Item = (KeyHash, Grant)>>(grants: I) -> Keyring {
        Keyring { grants: grants.into_iter().collect(), is_open: false }
    }
}

impl Keyring {
    /// Number of keys.
    pub fn len(&self) -> usize {
        self.grants.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.grants.is_empty()
    }

    /// What each opens.
    pub(crate) fn grants(&self) -> impl Iterator<Item = (&KeyHash, &Grant)> {
        self.grants.iter()
    }

    /// Whether nobody is asked for one.
    pub fn is_open(&self) -> bool {
        self.is_open
    }

    /// Whoever shows `key`.
    pub(crate) fn identify(&self, key: Option<&str>) -> Result<Caller, Problem> {
        if self.is_open {
            return Ok(Caller { grant: None });
        }
        let refused = |detail| Err(Problem::new(Kind::Unauthorized, detail));
        let Some(key) = key else {
            return refused(
                "this daemon asks for a key: send it as \"Authorization: Bearer …\", over Zenoh as the attachment",
            );
        };
        match self.grants.get(&hash(key)).filter(|_| key.len() <= MAX_KEY_BYTES) {
            Some(grant) => Ok(Caller { grant: Some(grant.clone()) }),
            None => refused("the key is not one of this daemon's, or no longer"),
        }
    }
}

/// Somebody who has been let in.
#[derive(Clone, Debug)]
pub(crate) struct Caller {
    /// `None`: nobody is asked.
    grant: Option<Grant>,
}

impl Caller {
    /// Whose sessions they see and open; `None`: everybody's, and nobody's.
    pub(crate) fn tenant(&self) -> Option<&Arc<str>> {
        self.grant.as_ref().map(|grant| &grant.tenant)
    }

    /// Whose turns their requests take, as long as they are for no session.
    pub(crate) fn account(&self) -> Account {
        Account::of(self.tenant().map(|tenant| &**tenant))
    }

    /// Refuses those whose role is not enough.
    pub(crate) fn check_role(&self, needed: Role) -> Result<(), Problem> {
        match &self.grant {
            Some(grant) if grant.role < needed => {
                let detail = format!("this takes a key of role {needed}, not {}", grant.role);
                Err(Problem::new(Kind::Forbidden, detail))
            }
            _ => Ok(()),
        }
    }

    /// Brings a session of theirs here if another daemon of the fleet had it last.
    pub(crate) async fn find_session(
        &self,
        gateway: &Gateway,
        id: SessionId,
    ) -> Result<(), Problem> {
        Ok(gateway.store().take_over(id, self.tenant().map(|tenant| &**tenant)).await?)
    }

    /// Refuses sessions of others, in the words for sessions that do not exist.
    pub(crate) fn check_session(&self, gateway: &Gateway, id: SessionId) -> Result<(), Problem> {
        let Some(tenant) = self.tenant() else { return Ok(()) };
        match gateway.store().tenant(id)?.as_deref() {
            Some(owner) if owner == &**tenant => Ok(()),
            _ => Err(StoreError::NoSession(id).into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_keys_everybody_is_let_in() {
        let caller = Keyring::default().identify(None).unwrap();
        assert!(caller.tenant().is_none());
        caller.check_role(Role::Admin).unwrap();
        // But not where the last key has been revoked.
        let nobody = Keyring::from_iter([]);
        assert_eq!(nobody.identify(None).unwrap_err().status(), 401);
    }

    #[test]
    fn a_key_opens_what_it_was_granted_and_nothing_else() {
        let mine = key(&[7; 32]);
        let grant = Grant { tenant: "a".into(), role: Role::Edit };
        let keyring: Keyring = [(hash(&mine), grant)].into_iter().collect();
        let caller = keyring.identify(Some(&mine)).unwrap();
        assert_eq!(caller.tenant().map(|tenant| &**tenant), Some("a"));
        caller.check_role(Role::Read).unwrap();
        caller.check_role(Role::Edit).unwrap();
        assert_eq!(caller.check_role(Role::Admin).unwrap_err().status(), 403);
        for wrong in
            [None, Some(""), Some("sutura_"), Some(&*key(&[8; 32])), Some(&*mine.repeat(2))]
        {
            let problem = keyring.identify(wrong).unwrap_err();
            assert_eq!(problem.status(), 401);
            assert!(wrong.is_none_or(|w| w.len() < 8 || !problem.detail.contains(w)));
        }
    }
}
