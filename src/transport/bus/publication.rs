//! What the daemon says unasked (states, generations) and the forces it hears.

use super::query::{Form, attachment, json};
use crate::access::Role;
use crate::command;
use crate::conversion::{event, simulation};
use crate::gateway::Gateway;
use crate::metrics;
use crate::problem::{Kind, Problem};
use std::collections::HashMap;
use std::sync::Arc;
use sutura_proto::bus::Attachment;
use sutura_proto::keys::{self, Resource};
use sutura_proto::media;
use sutura_store::{Account, EventKind, Frame, GenerationRef, SessionId};
use tokio::sync::broadcast::{self, error::RecvError};
use tokio::task::{AbortHandle, JoinSet};
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// Force messages that may wait; beyond, the oldest are lost.
const MAX_WAITING_FORCES: usize = 256;

/// Publishes the states of every simulation and every new generation, until the store ends.
pub(super) async fn publish(gateway: Gateway, zenoh_session: Session) {
    let mut events = gateway.store().subscribe_all();
    let mut states = States::default();
    states.follow_all(&gateway, &zenoh_session);
    loop {
        match events.recv().await {
            Ok(event) => match event.kind {
                EventKind::Created => states.follow(&gateway, &zenoh_session, event.session),
                EventKind::Generation(number) => {
                    publish_generation(&gateway, &zenoh_session, event.session, number).await;
                }
                EventKind::Deleted => states.forget(event.session),
                _ => {}
            },
            Err(RecvError::Lagged(count)) => {
                tracing::warn!(count, "events went by too fast to be published");
                states.follow_all(&gateway, &zenoh_session);
            }
            Err(RecvError::Closed) => return,
        }
    }
}

/// One task for each session, which publishes its states. All end with this value.
#[derive(Default)]
struct States {
    tasks: JoinSet<()>,
    followed: HashMap<SessionId, AbortHandle>,
}

impl States {
    /// Follows every session there is.
    fn follow_all(&mut self, gateway: &Gateway, zenoh_session: &Session) {
        let limit = gateway.store().config().limits.max_sessions;
        for session in gateway.store().list(None, limit) {
            self.follow(gateway, zenoh_session, session.id);
        }
    }

    fn follow(&mut self, gateway: &Gateway, zenoh_session: &Session, id: SessionId) {
        // Those that ended by themselves make room.
        while self.tasks.try_join_next().is_some() {}
        self.followed.retain(|_, task| !task.is_finished());
        if self.followed.contains_key(&id) {
            return;
        }
        if let Ok(frames) = gateway.store().subscribe_frames(id) {
            let task = self.tasks.spawn(publish_states(
                gateway.clone(),
                zenoh_session.clone(),
                id,
                frames,
            ));
            self.followed.insert(id, task);
        }
    }

    fn forget(&mut self, id: SessionId) {
        if let Some(task) = self.followed.remove(&id) {
            task.abort();
        }
    }
}

/// The key under which something is published of a session: where keys are asked for, below its tenant's,
/// which nobody else may listen to. `None` if it is nobody's then.
fn published(gateway: &Gateway, id: SessionId, resource: Resource) -> Option<String> {
    let id_text = id.to_string();
    if gateway.keys().is_open() {
        return keys::session(&id_text, resource);
    }
    let tenant = gateway.store().tenant(id).ok()??;
    keys::tenant_session(&tenant, &id_text, resource)
}

/// Publishes the states of one session until it ends. Sending never waits for a slow reader: a
/// state that does not fit into its link's queue is dropped there.
async fn publish_states(
    gateway: Gateway,
    zenoh_session: Session,
    id: SessionId,
    mut frames: broadcast::Receiver<Arc<Frame>>,
) {
    let Some(key) = published(&gateway, id, Resource::State) else { return };
    let declared = zenoh_session
        .declare_publisher(key)
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::RealTime)
        .express(true)
        .encoding(media::STATE)
        .await;
    let publisher = match declared {
        Ok(publisher) => publisher,
        Err(error) => return tracing::error!(%error, "a publication could not be declared"),
    };
    loop {
        let frame = match frames.recv().await {
            Ok(frame) => frame,
            Err(RecvError::Lagged(count)) => {
                metrics::frames_dropped("zenoh", count);
                continue;
            }
            Err(RecvError::Closed) => return,
        };
        let sent = simulation::state(&frame).and_then(|bytes| {
            publisher
                .put(bytes)
                .wait()
                .map_err(|error| Problem::new(Kind::Internal, error.to_string()))
        });
        match sent {
            Ok(()) => metrics::frame_sent("zenoh"),
            Err(problem) => tracing::error!(problem.detail, "a state could not be published"),
        }
    }
}

/// Publishes a new generation. This may wait on a congested link, hence the blocking thread.
async fn publish_generation(
    gateway: &Gateway,
    zenoh_session: &Session,
    id: SessionId,
    number: u64,
) {
    // It may have been overtaken by many others and be gone.
    let Ok(generation) = gateway.store().generation(id, GenerationRef::Number(number)) else {
        return;
    };
    let Some(key) = published(gateway, id, Resource::Generation) else { return };
    let Ok(payload) = json(&event::generation_info(&generation)) else {
        return tracing::error!(%id, number, "a generation could not be announced");
    };
    let zenoh_session = zenoh_session.clone();
    let put = move || {
        zenoh_session
            .put(key, payload)
            .congestion_control(CongestionControl::Block)
            .encoding(media::JSON)
            .wait()
    };
    if let Ok(Err(error)) = tokio::task::spawn_blocking(put).await {
        tracing::error!(%error, "a generation could not be announced");
    }
}

/// Hears forces or grabs for every session until the subscriber is undeclared. Nobody waits for an answer:
/// what cannot be used is logged.
pub(super) async fn hear(gateway: Gateway, subscriber: PullSubscriber) {
    while let Ok(sample) = subscriber.recv_async().await {
        if let Err(problem) = pull(&gateway, &sample).await {
            match problem.kind {
                // Counted already, and there may be very many.
                Kind::TooOften => {}
                _ => {
                    tracing::warn!(key = %sample.key_expr(), problem.detail, "forces were refused");
                }
            }
        }
    }
}

/// Hears messages that pull at bodies; a slow reader loses the oldest.
pub(super) type PullSubscriber = Subscriber<RingChannelHandler<Sample>>;

/// Subscribes to the forces or the grabs for every session.
pub(super) async fn subscribe(
    zenoh_session: &Session,
    resource: Resource,
) -> zenoh::Result<PullSubscriber> {
    zenoh_session
        .declare_subscriber(keys::every_session(resource))
        .with(RingChannel::new(MAX_WAITING_FORCES))
        .await
}

/// Hands the forces or grabs of one message to their session.
async fn pull(gateway: &Gateway, sample: &Sample) -> Result<(), Problem> {
    let (id, resource) = keys::parse_session(sample.key_expr())
        .ok_or_else(|| Problem::new(Kind::MalformedParameter, "forces are for one session"))?;
    let id = command::session_id(id)?;
    let form = Form::of(Some(sample.encoding()))?;
    let Attachment { key, .. } = attachment(sample.attachment());
    let caller = gateway.let_in(key.as_deref())?;
    caller.check_role(Role::Edit)?;
    caller.check_session(gateway, id)?;
    let account = gateway.store().account(id).unwrap_or(Account::Common);
    match resource {
        Resource::Grabs => {
            let request = form.parse(gateway, account, Some(sample.payload())).await?;
            command::grab(gateway, id, request)
        }
        _ => {
            let request = form.parse(gateway, account, Some(sample.payload())).await?;
            command::push_forces(gateway, id, request)
        }
    }
}
