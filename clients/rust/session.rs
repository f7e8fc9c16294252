//! One session over HTTP.

use crate::arrays::{Arrays, Generation, Query};
use crate::error::{Error, Result};
use crate::events::EventStream;
use crate::http::Client;
use crate::reply;
use crate::states::StateStream;
use reqwest::{Method, RequestBuilder, header};
use sutura_proto::edit::{EditReply, EditRequest};
use sutura_proto::evaluate::{EvaluateReply, EvaluateRequest};
use sutura_proto::event::Event;
use sutura_proto::session::{ForkRequest, SeamReply, SeamRequest, SessionInfo, SessionState};
use sutura_proto::simulation::{
    Force, ForceRequest, GrabRequest, SimulationConfig, SimulationInfo,
};
use sutura_proto::{Problem, keys, media};

/// Longest time that one request may wait for a body to be restored, in s.
const RESTORE_WAIT_S: &str = "60";

/// A session, reached over HTTP. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Session {
    client: Client,
    id: String,
}

impl Session {
    pub(crate) fn new(client: Client, id: &str) -> Result<Session> {
        if !keys::is_id(id) {
            return Err(Error::SessionId(id.to_owned()));
        }
        Ok(Session { client, id: id.to_owned() })
    }

    /// Its identifier.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// What is known of it now.
    pub async fn info(&self) -> Result<SessionInfo> {
        reply::document(self.request(Method::GET, &[])?.send().await?).await
    }

    /// Waits until its build has ended, telling `on_event` how it goes. A body that is kept on disk is
    /// restored.
    pub async fn wait_ready(&self, mut on_event: impl FnMut(&Event)) -> Result<SessionInfo> {
        loop {
            let mut events = self.events().await?;
            // The first event is the state: an end of the build cannot slip through between.
            while let Some(event) = events.next().await? {
                on_event(&event);
                if !matches!(
                    event,
                    Event::State { state: SessionState::Building | SessionState::Restoring, .. }
                        | Event::Stage { .. }
                ) {
                    break;
                }
            }
            let info = self.info().await?;
            match info.state {
                SessionState::Building | SessionState::Restoring => {}
                SessionState::Stored => {
                    let mut url = self.client.url(&self.path(&[]))?;
                    url.query_pairs_mut().append_pair("wait_s", RESTORE_WAIT_S);
                    reply::accepted(self.client.get(url).send().await?).await?;
                }
                SessionState::Ready | SessionState::Rebuilding => return Ok(info),
                SessionState::Failed => {
                    let unexplained = || Problem {
                        kind: "about:blank".to_owned(),
                        title: "The build failed".to_owned(),
                        status: 422,
                        detail: "the daemon gives no reason".to_owned(),
                        instance_pointer: None,
                    };
                    return Err(Error::BuildFailed(Box::new(
                        info.error.unwrap_or_else(unexplained),
                    )));
                }
            }
        }
    }

    /// What happens to it from now on, its present state first.
    pub async fn events(&self) -> Result<EventStream> {
        let request = self.request(Method::GET, &["events"])?;
        let request = request.header(header::ACCEPT, media::EVENT_STREAM);
        Ok(EventStream::new(reply::accepted(request.send().await?).await?))
    }

    /// Ends it.
    pub async fn delete(&self) -> Result<()> {
        self.send(self.request(Method::DELETE, &[])?).await
    }

    /// A new session that shares everything prepared; named `name`, or like this one.
    pub async fn fork(&self, name: Option<&str>) -> Result<Session> {
        let body = ForkRequest { name: name.map(str::to_owned) };
        let request = self.request(Method::POST, &["fork"])?.json(&body);
        let info: SessionInfo = reply::document(request.send().await?).await?;
        self.client.session(&info.id)
    }

    /// Names candidate pairs, which the daemon prepares in the background.
    pub async fn add_seams(&self, pairs: &[[u32; 2]]) -> Result<SeamReply> {
        let body = SeamRequest { pairs: pairs.to_vec() };
        let request = self.request(Method::POST, &["seams"])?.json(&body);
        reply::document(request.send().await?).await
    }

    /// Applies edits and waits for the new generation.
    pub async fn edit(&self, request: &EditRequest) -> Result<EditReply> {
        let request = self.request(Method::POST, &["edits"])?.json(request);
        reply::document(request.send().await?).await
    }

    /// Energy, force and stiffness of a generation at given coordinates.
    pub async fn evaluate(
        &self,
        generation: Generation,
        request: &EvaluateRequest,
    ) -> Result<EvaluateReply> {
        let path = ["generations", &generation.to_string(), "evaluate"];
        let request = self.request(Method::POST, &path)?.json(request);
        reply::document(request.send().await?).await
    }

    /// Starts the simulation, or changes how it goes on.
    pub async fn simulate(&self, config: &SimulationConfig) -> Result<SimulationInfo> {
        let request = self.request(Method::PUT, &["simulation"])?.json(config);
        reply::document(request.send().await?).await
    }

    /// What is known of the simulation now.
    pub async fn simulation(&self) -> Result<SimulationInfo> {
        reply::document(self.request(Method::GET, &["simulation"])?.send().await?).await
    }

    /// Ends the simulation.
    pub async fn stop_simulation(&self) -> Result<()> {
        self.send(self.request(Method::DELETE, &["simulation"])?).await
    }

    /// Adds forces to the running simulation.
    pub async fn push_forces(&self, forces: &[Force]) -> Result<()> {
        let body = ForceRequest { forces: forces.to_vec() };
        self.send(self.request(Method::POST, &["simulation", "forces"])?.json(&body)).await
    }

    /// Takes hold of vertices of the running simulation, moves what holds on, and lets go.
    pub async fn grab(&self, request: &GrabRequest) -> Result<()> {
        self.send(self.request(Method::POST, &["simulation", "grabs"])?.json(request)).await
    }

    /// The states that the simulation publishes, over a WebSocket.
    pub async fn states(&self) -> Result<StateStream> {
        let url = self.client.url(&self.path(&["stream"]))?;
        StateStream::web_socket(url, self.client.tls()).await
    }

    async fn send(&self, request: RequestBuilder) -> Result<()> {
        reply::accepted(request.send().await?).await.map(|_| ())
    }

    fn request(&self, method: Method, path: &[&str]) -> Result<RequestBuilder> {
        self.client.request(method, &self.path(path))
    }

    fn path<'a>(&'a self, path: &[&'a str]) -> Vec<&'a str> {
        ["v1", "sessions", &self.id].into_iter().chain(path.iter().copied()).collect()
    }
}

impl Arrays for Session {
    async fn frame(&self, query: Query) -> Result<Vec<u8>> {
        let generation = query.generation.to_string();
        let path = self.path(&["generations", &generation, query.resource.name()]);
        let mut url = self.client.url(&path)?;
        for (name, value) in query.parameters() {
            url.query_pairs_mut().append_pair(name, &value);
        }
        reply::frame(self.client.get(url).header(header::ACCEPT, media::FRAME).send().await?).await
    }
}
