//! Server-sent events of a session.

use super::extract::InSession;
use crate::conversion::event;
use crate::gateway::Gateway;
use crate::metrics::OpenStream;
use crate::problem::Problem;
use axum::extract::State;
use axum::response::IntoResponse;
use axum::response::sse::{self, KeepAlive, Sse};
use futures_util::{Stream, StreamExt, stream};
use std::convert::Infallible;
use sutura_proto::event::Event;
use sutura_store::{EventKind, SessionId};
use tokio::sync::broadcast::{self, error::RecvError};

/// GET /v1/sessions/{id}/events. The first event is the session's state; the stream ends with the
/// session, or when the daemon winds down.
pub(super) async fn events(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
) -> Result<impl IntoResponse, Problem> {
    let place = gateway.admit_stream()?;
    // Subscribed before the first look, so that no change falls between the two.
    let events = gateway.store().subscribe(id)?;
    let state = event::state(&gateway.store().info(id)?);
    let counted = (place, OpenStream::new("events"));
    let winding_down = gateway.clone();
    let events = stream::iter([state])
        .chain(follow(gateway, id, events))
        .map(move |event| {
            let _held_while_streaming = &counted;
            Ok::<_, Infallible>(encode(&event))
        })
        .take_until(async move { winding_down.wound_down().await });
    Ok(Sse::new(events).keep_alive(KeepAlive::default()))
}

fn follow(
    gateway: Gateway,
    id: SessionId,
    events: broadcast::Receiver<sutura_store::Event>,
) -> impl Stream<Item = Event> {
    stream::unfold((gateway, events, false), move |(gateway, mut events, ended)| async move {
        if ended {
            return None;
        }
        loop {
            let heard = match events.recv().await {
                Ok(heard) => {
                    let ended = matches!(heard.kind, EventKind::Deleted);
                    event::event(gateway.store(), id, heard.kind).map(|event| (event, ended))
                }
                // This listener was too slow and lost some: show where things stand.
                Err(RecvError::Lagged(_)) => {
                    gateway.store().info(id).ok().map(|info| (event::state(&info), false))
                }
                Err(RecvError::Closed) => return None,
            };
            if let Some((event, ended)) = heard {
                return Some((event, (gateway, events, ended)));
            }
        }
    })
}

fn encode(event: &Event) -> sse::Event {
    let named = sse::Event::default().event(event.name());
    named.json_data(event).unwrap_or_else(|error| {
        tracing::error!(%error, "an event could not be encoded");
        sse::Event::default().comment("an event could not be encoded")
    })
}
