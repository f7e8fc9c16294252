//! The daemon over Zenoh.

use crate::arrays::{Arrays, Query};
use crate::credentials::Credentials;
use crate::error::{Error, Result};
use crate::states::StateStream;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;
use std::time::Duration;
use sutura_proto::bus::Attachment;
use sutura_proto::edit::{EditReply, EditRequest};
use sutura_proto::event::GenerationInfo;
use sutura_proto::generation::PARAMETER_GENERATION;
use sutura_proto::keys::{self, Resource};
use sutura_proto::login::Login;
use sutura_proto::session::{SeamReply, SeamRequest, SessionInfo};
use sutura_proto::simulation::{Force, ForceRequest, GrabRequest};
use sutura_proto::{bus, media};
use tokio::runtime::{Handle, RuntimeFlavor};
use zenoh::bytes::Encoding;
use zenoh::handlers::{FifoChannelHandler, RingChannel};
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;

/// How long an answer may take: an edit of a large body takes seconds, from scratch minutes.
const QUERY_TIMEOUT: Duration = Duration::from_secs(600);
/// Largest message accepted, in bytes, as Zenoh's configuration wants it.
const MAX_MESSAGE_BYTES: &str = "1073741824";
/// States that wait for a slow consumer; older ones are dropped.
const STATE_BACKLOG: usize = 4;

/// The daemons of a Zenoh network. Cheap to clone; clones share the connection.
#[derive(Clone, Debug)]
pub struct ZenohClient {
    zenoh_session: zenoh::Session,
    shown: Option<Arc<str>>,
}

impl ZenohClient {
    /// Connects as a client to `endpoint`, such as `tcp/127.0.0.1:7447`; scouting is off. Needs
    /// Tokio's multi-threaded runtime.
    pub async fn open(endpoint: &str) -> Result<ZenohClient> {
        ZenohClient::open_as(endpoint, &Credentials::default()).await
    }

    /// The same with a key, which is shown when joining and with every query, or trusting a certificate
    /// authority of one's own (`tls/localhost:7447`).
    pub async fn open_as(endpoint: &str, credentials: &Credentials) -> Result<ZenohClient> {
        let endpoints = serde_json::to_string(&[endpoint])?;
        let mut config = zenoh::Config::default();
        for (key, value) in [
            ("mode", r#""client""#),
            ("connect/endpoints", endpoints.as_str()),
            ("scouting/multicast/enabled", "false"),
            ("scouting/gossip/enabled", "false"),
            ("transport/link/rx/max_message_size", MAX_MESSAGE_BYTES),
        ] {
            config.insert_json5(key, value).map_err(Error::Zenoh)?;
        }
        if let Some(key) = &credentials.key {
            let Login { user, password } = Login::of_key(key);
            let login = serde_json::json!({"user": user, "password": password});
            config
                .insert_json5("transport/auth/usrpwd", &login.to_string())
                .map_err(Error::Zenoh)?;
        }
        if let Some(path) = &credentials.ca_file {
            // Refused here with a reason, which Zenoh would keep to itself.
            credentials.tls()?;
            let tls = serde_json::json!({"root_ca_certificate": path});
            config.insert_json5("transport/link/tls", &tls.to_string()).map_err(Error::Zenoh)?;
        }
        let client = ZenohClient::open_with(config).await?;
        Ok(ZenohClient { shown: credentials.key.as_deref().map(Arc::from), ..client })
    }

    /// Connects as `config` says, without a key.
    pub async fn open_with(config: zenoh::Config) -> Result<ZenohClient> {
        // Zenoh would panic.
        if Handle::try_current().is_ok_and(|h| h.runtime_flavor() == RuntimeFlavor::CurrentThread) {
            return Err(Error::Runtime);
        }
        let zenoh_session = zenoh::open(config).await.map_err(Error::Zenoh)?;
        Ok(ZenohClient { zenoh_session, shown: None })
    }

    /// The session named `id`, whether or not it exists.
    pub fn session(&self, id: &str) -> Result<BusSession> {
        if !keys::is_id(id) {
            return Err(Error::SessionId(id.to_owned()));
        }
        let (zenoh_session, shown) = (self.zenoh_session.clone(), self.shown.clone());
        Ok(BusSession { zenoh_session, id: id.to_owned(), shown, request_id: None })
    }

    /// The daemons that are up.
    pub async fn daemons(&self) -> Result<Vec<String>> {
        let liveliness = self.zenoh_session.liveliness();
        let replies = liveliness.get(keys::every_daemon()).await.map_err(Error::Zenoh)?;
        let mut daemons = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            if let Ok(sample) = reply.result() {
                daemons.extend(keys::parse_daemon(sample.key_expr().as_str()).map(str::to_owned));
            }
        }
        daemons.sort_unstable();
        Ok(daemons)
    }

    /// Closes the connection, for all clones.
    pub async fn close(self) -> Result<()> {
        self.zenoh_session.close().await.map_err(Error::Zenoh)
    }
}

/// A session, reached over Zenoh. Cheap to clone.
#[derive(Clone, Debug)]
pub struct BusSession {
    zenoh_session: zenoh::Session,
    id: String,
    shown: Option<Arc<str>>,
    request_id: Option<Arc<str>>,
}

impl BusSession {
    /// Calls requests by this name, which the daemon's log then repeats: letters, digits, `-`, `_` and `.`.
    pub fn with_request_id(self, name: &str) -> BusSession {
        BusSession { request_id: Some(name.into()), ..self }
    }

    fn attachment(&self) -> Option<String> {
        let owned = |text: &Option<Arc<str>>| text.as_deref().map(str::to_owned);
        Attachment { key: owned(&self.shown), request_id: owned(&self.request_id) }.encode()
    }

    /// Its identifier.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// What is known of it now.
    pub async fn info(&self) -> Result<SessionInfo> {
        let reply = self.query(Resource::Info, String::new(), None).await?;
        Ok(serde_json::from_slice(&reply.payload().to_bytes())?)
    }

    /// Names candidate pairs, which the daemon prepares in the background.
    pub async fn add_seams(&self, pairs: &[[u32; 2]]) -> Result<SeamReply> {
        self.ask(Resource::Seams, &SeamRequest { pairs: pairs.to_vec() }).await
    }

    /// Applies edits and waits for the new generation.
    pub async fn edit(&self, request: &EditRequest) -> Result<EditReply> {
        self.ask(Resource::Edits, request).await
    }

    /// Sends a document as bincode and reads the one that comes back.
    async fn ask<T: DeserializeOwned>(
        &self,
        resource: Resource,
        request: &impl Serialize,
    ) -> Result<T> {
        let request = bus::encode(request).map_err(|e| Error::Mismatch(e.to_string()))?;
        let reply = self.query(resource, String::new(), Some(request)).await?;
        let payload = reply.payload().to_bytes();
        if *reply.encoding() == Encoding::from(media::BINCODE) {
            bus::decode(&payload).map_err(|e| Error::Decode(e.to_string()))
        } else {
            Ok(serde_json::from_slice(&payload)?)
        }
    }

    /// The states that the simulation publishes.
    pub async fn states(&self) -> Result<StateStream> {
        let subscriber = self
            .zenoh_session
            .declare_subscriber(self.published(Resource::State).await?)
            .with(RingChannel::new(STATE_BACKLOG))
            .await
            .map_err(Error::Zenoh)?;
        Ok(StateStream::zenoh(subscriber))
    }

    /// Every new generation from now on.
    pub async fn generations(&self) -> Result<GenerationStream> {
        let key = self.published(Resource::Generation).await?;
        let subscriber = self.zenoh_session.declare_subscriber(key).await.map_err(Error::Zenoh)?;
        Ok(GenerationStream { subscriber })
    }

    /// Adds forces to the running simulation. Like every publication it is not answered: forces the
    /// daemon refuses are lost.
    pub async fn push_forces(&self, forces: &[Force]) -> Result<()> {
        self.publish(Resource::Forces, &ForceRequest { forces: forces.to_vec() }).await
    }

    /// Takes hold of vertices, moves what holds on, and lets go. Not answered either.
    pub async fn grab(&self, request: &GrabRequest) -> Result<()> {
        self.publish(Resource::Grabs, request).await
    }

    async fn publish(&self, resource: Resource, document: &impl Serialize) -> Result<()> {
        let body = bus::encode(document).map_err(|e| Error::Mismatch(e.to_string()))?;
        self.zenoh_session
            .put(self.key(resource)?, body)
            .attachment(self.attachment())
            .encoding(media::BINCODE)
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::RealTime)
            .express(true)
            .await
            .map_err(Error::Zenoh)
    }

    /// Where the daemon publishes: where it asks for keys, apart from other tenants.
    async fn published(&self, resource: Resource) -> Result<String> {
        let tenant = match &self.shown {
            Some(_) => self.info().await?.tenant,
            None => None,
        };
        let key = match tenant {
            Some(tenant) => keys::tenant_session(&tenant, &self.id, resource),
            None => keys::session(&self.id, resource),
        };
        key.ok_or_else(|| Error::SessionId(self.id.clone()))
    }

    fn key(&self, resource: Resource) -> Result<String> {
        keys::session(&self.id, resource).ok_or_else(|| Error::SessionId(self.id.clone()))
    }

    async fn query(
        &self,
        resource: Resource,
        parameters: String,
        payload: Option<Vec<u8>>,
    ) -> Result<Sample> {
        let key = self.key(resource)?;
        let selector = format!("{key}?{parameters}");
        // A reply has its query's priority: arrays of many megabytes let states and edits pass.
        let priority = match resource {
            Resource::Edits | Resource::Info => Priority::default(),
            _ => Priority::DataLow,
        };
        let get = self.zenoh_session.get(&selector).timeout(QUERY_TIMEOUT);
        let mut get = get.priority(priority).attachment(self.attachment());
        if let Some(payload) = payload {
            get = get.payload(payload).encoding(media::BINCODE);
        }
        let replies = get.await.map_err(Error::Zenoh)?;
        // Every daemon is asked; those that do not have the session say so (404). No daemon at all
        // ends the replies at once.
        let mut refusal = Error::Absent(key);
        while let Ok(reply) = replies.recv_async().await {
            match reply.into_result() {
                Ok(sample) => return Ok(sample),
                Err(error) => {
                    if matches!(refusal, Error::Absent(_)) || refusal.status() == Some(404) {
                        refusal = problem(&error.payload().to_bytes());
                    }
                }
            }
        }
        Err(refusal)
    }
}

fn problem(payload: &[u8]) -> Error {
    match serde_json::from_slice(payload) {
        Ok(problem) => Error::Problem(Box::new(problem)),
        Err(_) => Error::Decode("the error is not a problem document".to_owned()),
    }
}

impl Arrays for BusSession {
    async fn frame(&self, query: Query) -> Result<Vec<u8>> {
        let mut parameters = format!("{PARAMETER_GENERATION}={}", query.generation);
        for (name, value) in query.parameters() {
            parameters.push_str(&format!(";{name}={value}"));
        }
        let reply = self.query(query.resource, parameters, None).await?;
        Ok(reply.payload().to_bytes().into_owned())
    }
}

/// New generations of a session.
pub struct GenerationStream {
    subscriber: Subscriber<FifoChannelHandler<Sample>>,
}

impl GenerationStream {
    /// The next generation.
    pub async fn next(&mut self) -> Result<GenerationInfo> {
        let sample = self.subscriber.recv_async().await.map_err(Error::Zenoh)?;
        Ok(serde_json::from_slice(&sample.payload().to_bytes())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_single_threaded_runtime_is_an_error() {
        let error = ZenohClient::open("tcp/127.0.0.1:1").await.unwrap_err();
        assert!(matches!(error, Error::Runtime), "{error}");
    }
}
