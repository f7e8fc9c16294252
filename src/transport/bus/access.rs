//! Who may join Zenoh, and what passes to and from them: the embedded router's users and access control,
//! made of the daemon's keys.
//!
//! A connection shows a name and a password, both of its key ([`Login`]). Beyond that it may ask, pull and
//! listen where its tenant's role allows, and declare nothing that would make others' messages come its way.
//! Queries and forces carry the key itself, too, and are judged by it ([`super::query::identify`]): the router
//! does not say who sent them.

use super::config::BusError;
use crate::access::{Keyring, Role};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use sutura_proto::keys::{self, Resource};
use sutura_proto::login::Login;

/// Passwords on their way to Zenoh, which takes them from a file: there only while it starts, and cleared
/// away with other half-written files of the data directory where the daemon was killed meanwhile.
const USERS_FILE: &str = "zenoh-users.tmp";

/// Zenoh's users in a file that nobody else reads; gone with this value.
pub(super) struct UsersFile {
    path: PathBuf,
}

impl UsersFile {
    pub(super) fn write(folder: &Path, keys: &Keyring) -> Result<UsersFile, BusError> {
        let path = folder.join(USERS_FILE);
        let failed = |source| BusError::Users { path: path.clone(), source };
        match fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(failed(error)),
            _ => Ok(()),
        }?;
        let text: String = keys
            .grants()
            .map(|(hash, _)| Login::of_hash(hash))
            .map(|Login { user, password }| format!("{user}:{password}\n"))
            .collect();
        let mut options = OpenOptions::new();
        let file = options.write(true).create_new(true).mode(0o600).open(&path);
        // From here on it is cleared away.
        let users = UsersFile { path: path.clone() };
        file.and_then(|mut file| file.write_all(text.as_bytes())).map_err(failed)?;
        Ok(users)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for UsersFile {
    fn drop(&mut self) {
        if let Err(error) = fs::remove_file(&self.path) {
            tracing::warn!(%error, path = %self.path.display(), "left behind until the next start");
        }
    }
}

/// `access_control` of Zenoh's configuration: what is not allowed is denied.
pub(super) fn access_control(keys: &Keyring) -> Value {
    let mut users: BTreeMap<(&str, bool), Vec<String>> = BTreeMap::new();
    for (hash, grant) in keys.grants() {
        let holders = users.entry((&grant.tenant, grant.role >= Role::Edit)).or_default();
        holders.push(Login::of_hash(hash).user);
    }
    let sessions = format!("{}/sessions/**", keys::PREFIX);
    let pulls = [Resource::Forces, Resource::Grabs].map(keys::every_session);
    let mut rules = vec![
        // Discovery, questions and their answers; what an answer says the key in the question decides.
        rule("ask", "ingress", &["query"], &[&sessions]),
        rule("answer", "egress", &["reply", "declare_queryable"], &[&sessions]),
        rule(
            "look",
            "ingress",
            &["liveliness_query", "declare_liveliness_subscriber"],
            &[&keys::every_daemon()],
        ),
        rule("alive", "egress", &["liveliness_token", "reply"], &[&keys::every_daemon()]),
        rule("pull", "ingress", &["put"], &pulls),
        rule("pulled", "egress", &["declare_subscriber"], &pulls),
    ];
    let (mut subjects, mut policies) = (Vec::new(), Vec::new());
    for (i, ((tenant, edits), names)) in users.iter().enumerate() {
        // A name that is none was refused where the keys were read.
        let Some(own) = keys::of_tenant(tenant) else { continue };
        let own = format!("{own}/**");
        let (listen, heard, subject) =
            (format!("listen-{i}"), format!("heard-{i}"), format!("holders-{i}"));
        rules.push(rule(&listen, "ingress", &["declare_subscriber"], &[&own]));
        rules.push(rule(&heard, "egress", &["put"], &[&own]));
        subjects.push(json!({"id": subject, "usernames": names}));
        let mut allowed = vec!["ask", "answer", "look", "alive", &listen, &heard];
        if *edits {
            allowed.extend(["pull", "pulled"]);
        }
        policies.push(json!({"rules": allowed, "subjects": [subject]}));
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    })
}

fn rule(id: &str, flow: &str, messages: &[&str], key_exprs: &[impl AsRef<str>]) -> Value {
    let key_exprs: Vec<&str> = key_exprs.iter().map(AsRef::as_ref).collect();
    json!({"id": id, "flows": [flow], "messages": messages, "permission": "allow", "key_exprs": key_exprs})
}
