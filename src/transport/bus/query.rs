//! Queries: parse, command, reply.

use crate::access::{Caller, Role};
use crate::command::{self, ArrayParams, ArrayRequest};
use crate::conversion::array::ArrayKind;
use crate::conversion::document::{parse_bincode, parse_json};
use crate::conversion::session;
use crate::gateway::{Gateway, shed};
use crate::metrics;
use crate::problem::{Kind, Problem};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::sync::Arc;
use std::time::Instant;
use sutura_proto::generation::PARAMETER_GENERATION;
use sutura_proto::keys::{self, Resource};
use sutura_proto::{bus, bus::Attachment, media};
use sutura_store::{Account, GenerationRef, SessionId};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tracing::field::Empty;
use tracing::{Instrument, Span};
use uuid::Uuid;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// The resources that can be asked for.
const RESOURCES: [Resource; 15] = [
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
];

/// The queryables, and the places of the queries under way.
pub(super) struct Queries {
    queryables: Vec<Queryable<()>>,
    places: Arc<Semaphore>,
    n_places: usize,
}

impl Queries {
    /// Takes no new query and answers those under way.
    pub(super) async fn finish(self) -> zenoh::Result<()> {
        for queryable in self.queryables {
            queryable.undeclare().await?;
        }
        let n_places = u32::try_from(self.n_places).unwrap_or(u32::MAX);
        // Fails only when the semaphore is closed, which nobody does.
        let _ = self.places.acquire_many(n_places).await;
        Ok(())
    }
}

/// Declares one queryable for each resource, for all sessions at once. Not `complete`: another
/// daemon on the same network may hold the session that is asked for.
pub(super) async fn declare(gateway: &Gateway, zenoh_session: &Session) -> zenoh::Result<Queries> {
    let runtime = Handle::current();
    let n_places = gateway.limits().max_queries;
    let places = Arc::new(Semaphore::new(n_places));
    let refusals = Arc::new(Semaphore::new(n_places));
    let mut queryables = Vec::new();
    for resource in RESOURCES {
        let (gateway, runtime) = (gateway.clone(), runtime.clone());
        let (turns, refusals) = (Arc::clone(&places), Arc::clone(&refusals));
        let hand_over = move |query: Query| {
            let gateway = gateway.clone();
            if let Ok(place) = Arc::clone(&turns).try_acquire_owned() {
                runtime.spawn(async move {
                    serve(&gateway, resource, query).await;
                    drop(place);
                });
            } else if let Ok(place) = Arc::clone(&refusals).try_acquire_owned() {
                runtime.spawn(async move {
                    reply(query, Err(shed("queries")), None).await;
                    drop(place);
                });
            }
            // Beyond both, the query is dropped: its sender hears that there was no reply.
        };
        let key = keys::every_session(resource);
        queryables.push(zenoh_session.declare_queryable(key).callback(hand_over).await?);
    }
    Ok(Queries { queryables, places, n_places })
}

/// What an attachment says.
pub(super) fn attachment(bytes: Option<&ZBytes>) -> Attachment {
    bytes.map(|bytes| Attachment::decode(&bytes.to_bytes())).unwrap_or_default()
}

/// What goes back under one key.
struct Answer {
    key: String,
    encoding: &'static str,
    payload: Vec<u8>,
}

/// Answers a query, which is called by its sender's name, or by a new one.
async fn serve(gateway: &Gateway, resource: Resource, query: Query) {
    let Attachment { key, request_id } = attachment(query.attachment());
    let request_id = request_id.unwrap_or_else(|| Uuid::now_v7().simple().to_string());
    let span = tracing::info_span!("query", key = %query.key_expr(), request_id, resource = Empty,
        status = Empty);
    answered(gateway, resource, query, key.as_deref(), request_id).instrument(span).await;
}

async fn answered(
    gateway: &Gateway,
    resource: Resource,
    query: Query,
    shown: Option<&str>,
    request_id: String,
) {
    let begun = Instant::now();
    let answers = answer(gateway, resource, &query, shown).await;
    let status = answers.as_ref().map_or_else(Problem::status, |_| 200);
    if let Err(problem) = &answers {
        problem.log();
    }
    reply(query, answers, Some(request_id)).await;
    Span::current().record("resource", resource.name()).record("status", i64::from(status));
    metrics::bus_query(resource.name(), status, begun.elapsed());
}

async fn answer(
    gateway: &Gateway,
    resource: Resource,
    query: &Query,
    shown: Option<&str>,
) -> Result<Vec<Answer>, Problem> {
    let caller = gateway.let_in(shown)?;
    caller.check_role(match resource {
        Resource::Edits | Resource::Seams => Role::Edit,
        _ => Role::Read,
    })?;
    let Some((id, _)) = keys::parse_session(query.key_expr()) else {
        return match resource {
            Resource::Info => infos(gateway, &caller, query),
            _ => Err(Problem::new(Kind::MalformedParameter, "ask for one session")),
        };
    };
    let id = command::session_id(id)?;
    caller.check_session(gateway, id)?;
    let key = query.key_expr().to_string();
    let (encoding, payload) = match resource {
        Resource::Edits => edit(gateway, id, query).await?,
        Resource::Info => (media::JSON, json(&command::info(gateway, id)?)?),
        Resource::Seams => seams(gateway, id, query).await?,
        Resource::Modes => array(gateway, id, ArrayKind::Modes, query).await?,
        Resource::Basis => array(gateway, id, ArrayKind::Basis, query).await?,
        Resource::Transfer => array(gateway, id, ArrayKind::Transfer, query).await?,
        Resource::Delta => array(gateway, id, ArrayKind::Delta, query).await?,
        Resource::Combination => array(gateway, id, ArrayKind::Combination, query).await?,
        Resource::Dictionary => array(gateway, id, ArrayKind::Dictionary, query).await?,
        Resource::Evaluator => array(gateway, id, ArrayKind::Evaluator, query).await?,
        Resource::Mass => array(gateway, id, ArrayKind::Mass, query).await?,
        Resource::FrequenciesHz => array(gateway, id, ArrayKind::FrequenciesHz, query).await?,
        Resource::Positions => array(gateway, id, ArrayKind::Positions, query).await?,
        Resource::Tets => array(gateway, id, ArrayKind::Tets, query).await?,
        Resource::Stitches => array(gateway, id, ArrayKind::Stitches, query).await?,
        Resource::State | Resource::Generation | Resource::Forces | Resource::Grabs => {
            return Err(Problem::new(Kind::NoRoute, "this key is no queryable"));
        }
    };
    Ok(vec![Answer { key, encoding, payload }])
}

/// `info` of every session that the query's key expression matches: how clients find sessions.
fn infos(gateway: &Gateway, caller: &Caller, query: &Query) -> Result<Vec<Answer>, Problem> {
    let most = gateway.store().config().limits.max_sessions;
    let sessions = command::list(gateway, caller, None, most);
    let mut answers = Vec::new();
    for session in &sessions {
        let key = keys::session(&session.id.to_string(), Resource::Info).unwrap_or_default();
        let asked =
            zenoh::key_expr::keyexpr::new(&key).is_ok_and(|key| query.key_expr().intersects(key));
        if asked {
            let payload = json(&session::info(session))?;
            answers.push(Answer { key, encoding: media::JSON, payload });
        }
    }
    Ok(answers)
}

async fn edit(
    gateway: &Gateway,
    id: SessionId,
    query: &Query,
) -> Result<(&'static str, Vec<u8>), Problem> {
    exchange(gateway, id, query, async |request| command::edit(gateway, id, request).await).await
}

async fn seams(
    gateway: &Gateway,
    id: SessionId,
    query: &Query,
) -> Result<(&'static str, Vec<u8>), Problem> {
    exchange(gateway, id, query, async |request| command::add_seams(gateway, id, request).await)
        .await
}

/// Runs `command` on the document that the query carries and answers in the same form.
async fn exchange<Request: DeserializeOwned + Send + 'static, Reply: Serialize>(
    gateway: &Gateway,
    id: SessionId,
    query: &Query,
    command: impl AsyncFnOnce(Request) -> Result<Reply, Problem>,
) -> Result<(&'static str, Vec<u8>), Problem> {
    let form = Form::of(query.encoding())?;
    // Of a session that does not exist the command says so, once it could read the request.
    let account = gateway.store().account(id).unwrap_or(Account::Common);
    let request = form.parse(gateway, account, query.payload()).await?;
    Ok((form.media(), form.write(&command(request).await?)?))
}

async fn array(
    gateway: &Gateway,
    id: SessionId,
    kind: ArrayKind,
    query: &Query,
) -> Result<(&'static str, Vec<u8>), Problem> {
    let parameters = query.parameters();
    let generation = match parameters.get(PARAMETER_GENERATION) {
        Some(text) => command::generation_ref(text)?,
        None => GenerationRef::Current,
    };
    let others = parameters.iter().filter(|(name, _)| !matches!(*name, PARAMETER_GENERATION | ""));
    let params = ArrayParams::parse(others)?;
    let request = ArrayRequest {
        kind,
        generation,
        params,
        media: media::FRAME,
        max_bytes: gateway.limits().max_bus_array_bytes,
    };
    Ok((media::FRAME, command::array(gateway, id, request).await?))
}

/// Sends what there is to say. May wait on a congested link, hence the blocking thread.
/// An answer carries the request's name; an error has no room for it.
async fn reply(query: Query, answers: Result<Vec<Answer>, Problem>, request_id: Option<String>) {
    let named = Attachment { key: None, request_id }.encode();
    let send = move || match answers {
        Ok(answers) => answers.into_iter().try_for_each(|answer| {
            let reply = query.reply(answer.key, answer.payload).encoding(answer.encoding);
            reply.attachment(named.as_deref()).wait()
        }),
        Err(problem) => query.reply_err(problem.to_json()).encoding(media::PROBLEM_JSON).wait(),
    };
    match tokio::task::spawn_blocking(send).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::debug!(%error, "a reply could not be sent"),
        Err(error) => tracing::error!(%error, "sending a reply failed"),
    }
}

/// How control documents are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    Json,
    Bincode,
}

impl Form {
    /// The form that an encoding names; JSON if it names none.
    pub(super) fn of(encoding: Option<&Encoding>) -> Result<Form, Problem> {
        let Some(encoding) = encoding.filter(|&encoding| *encoding != Encoding::default()) else {
            return Ok(Form::Json);
        };
        match encoding.to_string().as_str() {
            media::JSON | "text/json" => Ok(Form::Json),
            media::BINCODE => Ok(Form::Bincode),
            _ => {
                let detail = format!("documents are {} or {}", media::JSON, media::BINCODE);
                Err(Problem::new(Kind::UnsupportedMediaType, detail))
            }
        }
    }

    fn media(self) -> &'static str {
        match self {
            Form::Json => media::JSON,
            Form::Bincode => media::BINCODE,
        }
    }

    /// Reads a payload within the limit for documents.
    pub(super) async fn parse<T: DeserializeOwned + Send + 'static>(
        self,
        gateway: &Gateway,
        account: Account,
        payload: Option<&ZBytes>,
    ) -> Result<T, Problem> {
        let Some(payload) = payload else {
            return Err(Problem::new(Kind::MalformedDocument, "the query carries no document"));
        };
        let limit = gateway.limits().max_document_bytes;
        let n_bytes = payload.len();
        if n_bytes > limit {
            let detail = format!("the document has {n_bytes} bytes, at most {limit}");
            return Err(Problem::new(Kind::TooLarge, detail));
        }
        let payload = payload.clone();
        let parse = move || match self {
            Form::Json => parse_json(&payload.to_bytes()),
            Form::Bincode => parse_bincode(&payload.to_bytes()),
        };
        command::parse(gateway, account, n_bytes, parse).await
    }

    fn write(self, document: &impl Serialize) -> Result<Vec<u8>, Problem> {
        match self {
            Form::Json => json(document),
            Form::Bincode => bus::encode(document)
                .map_err(|error| Problem::new(Kind::Internal, error.to_string())),
        }
    }
}

/// A document as JSON bytes.
pub(super) fn json(document: &impl Serialize) -> Result<Vec<u8>, Problem> {
    serde_json::to_vec(document).map_err(|error| Problem::new(Kind::Internal, error.to_string()))
}
