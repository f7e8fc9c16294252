//! Zenoh key expressions: building them and taking them apart.

use std::fmt;

/// Everything sutura says on Zenoh lies below this prefix.
pub const PREFIX: &str = "sutura/v1";

/// What only one tenant hears lies below `sutura/v1/tenants/{tenant}`.
const TENANTS: &str = "tenants";

/// Longest session or daemon identifier, in bytes.
pub const MAX_ID_BYTES: usize = 64;

/// What one key of a session stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Resource {
    /// Queryable: an [`crate::edit::EditRequest`], answered by an [`crate::edit::EditReply`].
    Edits,
    /// Queryable: the [`crate::session::SessionInfo`].
    Info,
    /// Queryable: a [`crate::session::SeamRequest`], answered by a [`crate::session::SeamReply`].
    Seams,
    /// Queryable: linear modes.
    Modes,
    /// Queryable: the basis.
    Basis,
    /// Queryable: from an older generation's coordinates to this one's.
    Transfer,
    /// Queryable: from an older generation's basis to this one's.
    Delta,
    /// Queryable: the basis as a combination of named columns.
    Combination,
    /// Queryable: named columns.
    Dictionary,
    /// Queryable: the evaluator's tables.
    Evaluator,
    /// Queryable: lumped masses.
    Mass,
    /// Queryable: frequencies of the elastic modes.
    FrequenciesHz,
    /// Queryable: rest positions.
    Positions,
    /// Queryable: corners of the tets.
    Tets,
    /// Queryable: the stitches in force.
    Stitches,
    /// Publication: [`crate::state::StateFrame`].
    State,
    /// Publication: [`crate::event::GenerationInfo`].
    Generation,
    /// Subscription: a [`crate::simulation::ForceRequest`].
    Forces,
    /// Subscription: a [`crate::simulation::GrabRequest`].
    Grabs,
}

impl Resource {
    /// Every resource.
    pub const ALL: [Resource; 19] = [
        Resource::Edits,
        Resource::Info,
        Resource::Seams,
        Resource::Modes,
        Resource::Basis,
        Resource::Transfer,
        Resource::Delta,
        Resource::Combination,
        Resource::Dictionary,
        Resource::Evaluator,
        Resource::Mass,
        Resource::FrequenciesHz,
        Resource::Positions,
        Resource::Tets,
        Resource::Stitches,
        Resource::State,
        Resource::Generation,
        Resource::Forces,
        Resource::Grabs,
    ];

    /// The key's last chunk.
    pub fn name(self) -> &'static str {
        match self {
            Resource::Edits => "edits",
            Resource::Info => "info",
            Resource::Seams => "seams",
            Resource::Modes => "modes",
            Resource::Basis => "basis",
            Resource::Transfer => "transfer",
            Resource::Delta => "delta",
            Resource::Combination => "combination",
            Resource::Dictionary => "dictionary",
            Resource::Evaluator => "evaluator",
            Resource::Mass => "mass",
            Resource::FrequenciesHz => "frequencies_hz",
            Resource::Positions => "positions",
            Resource::Tets => "tets",
            Resource::Stitches => "stitches",
            Resource::State => "state",
            Resource::Generation => "generation",
            Resource::Forces => "forces",
            Resource::Grabs => "grabs",
        }
    }
}

impl fmt::Display for Resource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Whether `id` may name a session or a daemon: 1 to [`MAX_ID_BYTES`] ASCII letters, digits, `-`
/// and `_`, so that it needs no escaping in a path, a key expression or a file name.
pub fn is_id(id: &str) -> bool {
    (1..=MAX_ID_BYTES).contains(&id.len())
        && id.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_')
}

/// `sutura/v1/sessions/{id}/{resource}`; `None` if `id` is not an identifier.
pub fn session(id: &str, resource: Resource) -> Option<String> {
    is_id(id).then(|| format!("{PREFIX}/sessions/{id}/{resource}"))
}

/// `sutura/v1/tenants/{tenant}/sessions/{id}/{resource}`: what is published of a tenant's session where
/// keys are asked for. `None` if one of the two is no name.
pub fn tenant_session(tenant: &str, id: &str, resource: Resource) -> Option<String> {
    let of_tenant = of_tenant(tenant)?;
    is_id(id).then(|| format!("{of_tenant}/sessions/{id}/{resource}"))
}

/// `sutura/v1/tenants/{tenant}`; `None` if `tenant` is no name: 1 to [`MAX_ID_BYTES`] ASCII letters, digits,
/// `-`, `_` and `.`.
pub fn of_tenant(tenant: &str) -> Option<String> {
    is_id(&tenant.replace('.', "-")).then(|| format!("{PREFIX}/{TENANTS}/{tenant}"))
}

/// `sutura/v1/sessions/*/{resource}`: that resource of every session.
pub fn every_session(resource: Resource) -> String {
    format!("{PREFIX}/sessions/*/{resource}")
}

/// The session and the resource that `key` names, if it names one.
pub fn parse_session(key: &str) -> Option<(&str, Resource)> {
    let (id, name) = key.strip_prefix(PREFIX)?.strip_prefix("/sessions/")?.split_once('/')?;
    let resource = Resource::ALL.into_iter().find(|resource| resource.name() == name)?;
    is_id(id).then_some((id, resource))
}

/// `sutura/v1/daemons/{daemon}`: the liveliness token; `None` if `daemon` is not an identifier.
pub fn daemon(daemon: &str) -> Option<String> {
    is_id(daemon).then(|| format!("{PREFIX}/daemons/{daemon}"))
}

/// `sutura/v1/daemons/*`.
pub fn every_daemon() -> String {
    format!("{PREFIX}/daemons/*")
}

/// The daemon that `key` names, if it names one.
pub fn parse_daemon(key: &str) -> Option<&str> {
    key.strip_prefix(PREFIX)?.strip_prefix("/daemons/").filter(|id| is_id(id))
}
