//! Published states over a WebSocket.

use super::extract::InSession;
use crate::conversion::simulation;
use crate::gateway::Gateway;
use crate::metrics::{self, OpenStream};
use crate::problem::{Kind, Problem};
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::response::Response;
use std::sync::Arc;
use std::time::Duration;
use sutura_store::Frame;
use tokio::sync::broadcast::{self, error::RecvError};

/// Clients have nothing to say here but control frames.
const MAX_MESSAGE_BYTES: usize = 4 << 10;
/// Bytes gathered before they are written: none, a state is sent as soon as it is there.
const WRITE_BUFFER_BYTES: usize = 0;
/// Bytes that may wait for a slow client: a few states of the largest basis.
const MAX_WRITE_BUFFER_BYTES: usize = 64 << 10;
/// How often an idle connection is tried.
const PING_INTERVAL: Duration = Duration::from_secs(20);

/// GET /v1/sessions/{id}/stream: one binary message for each published state, of this and of later
/// simulations, until the session ends. A client that reads too slowly loses the oldest states.
pub(super) async fn stream(
    State(gateway): State<Gateway>,
    InSession(id): InSession,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Result<Response, Problem> {
    let upgrade = upgrade.map_err(|error| {
        let detail = format!("this is a WebSocket: {}", error.body_text());
        Problem::new(Kind::UpgradeRequired, detail)
    })?;
    let frames = gateway.store().subscribe_frames(id)?;
    let place = gateway.admit_stream()?;
    let upgrade = upgrade
        .max_message_size(MAX_MESSAGE_BYTES)
        .max_frame_size(MAX_MESSAGE_BYTES)
        .write_buffer_size(WRITE_BUFFER_BYTES)
        .max_write_buffer_size(MAX_WRITE_BUFFER_BYTES);
    Ok(upgrade.on_upgrade(async move |socket| {
        let _counted = (place, OpenStream::new("states"));
        forward(&gateway, socket, frames).await;
    }))
}

async fn forward(
    gateway: &Gateway,
    mut socket: WebSocket,
    mut frames: broadcast::Receiver<Arc<Frame>>,
) {
    let mut ping = tokio::time::interval(PING_INTERVAL);
    let mut answered = true;
    let (code, reason) = loop {
        let message = tokio::select! {
            frame = frames.recv() => match frame {
                Ok(frame) => match simulation::state(&frame) {
                    Ok(bytes) => Message::Binary(bytes.into()),
                    Err(problem) => {
                        tracing::error!(problem.detail, "a state could not be encoded");
                        continue;
                    }
                },
                Err(RecvError::Lagged(count)) => {
                    metrics::frames_dropped("http", count);
                    continue;
                }
                Err(RecvError::Closed) => break (close_code::NORMAL, "the session has ended"),
            },
            heard = socket.recv() => match heard {
                Some(Ok(_)) => {
                    answered = true;
                    continue;
                }
                Some(Err(_)) | None => return,
            },
            _ = ping.tick() => {
                if !answered {
                    return;
                }
                answered = false;
                Message::Ping(bytes::Bytes::new())
            }
            () = gateway.wound_down() => break (close_code::AWAY, "the daemon is going down"),
        };
        let is_state = matches!(message, Message::Binary(_));
        match tokio::time::timeout(gateway.limits().max_send_wait, socket.send(message)).await {
            Ok(Ok(())) if is_state => metrics::frame_sent("http"),
            Ok(Ok(())) => {}
            _ => return,
        }
    };
    let close = Message::Close(Some(CloseFrame { code, reason: reason.into() }));
    let _ = tokio::time::timeout(gateway.limits().max_send_wait, socket.send(close)).await;
}
