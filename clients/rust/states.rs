//! The states of a running simulation, from a WebSocket or a Zenoh subscription.

use crate::error::{Error, Result};
use futures_util::StreamExt;
use reqwest::Url;
use std::sync::Arc;
use sutura_proto::session::MAX_BASIS_SIZE;
use sutura_proto::state::{HEADER_BYTES, StateFrame};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::{
    Connector, MaybeTlsStream, WebSocketStream, connect_async_tls_with_config,
};
use zenoh::handlers::RingChannelHandler;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

const MAX_FRAME_BYTES: usize = HEADER_BYTES + 4 * MAX_BASIS_SIZE;

/// Published states, the oldest first. A consumer that is too slow misses some (gaps in
/// [`StateFrame::sequence`]) but is never behind by more than a few.
pub struct StateStream {
    source: Source,
}

enum Source {
    WebSocket(Box<WebSocketStream<MaybeTlsStream<TcpStream>>>),
    Zenoh(Subscriber<RingChannelHandler<Sample>>),
}

impl StateStream {
    pub(crate) async fn web_socket(
        mut url: Url,
        tls: Arc<rustls::ClientConfig>,
    ) -> Result<StateStream> {
        let address = url.to_string();
        let scheme = if url.scheme() == "https" { "wss" } else { "ws" };
        url.set_scheme(scheme).map_err(|()| Error::Address(address))?;
        let config = WebSocketConfig::default()
            .max_message_size(Some(MAX_FRAME_BYTES))
            .max_frame_size(Some(MAX_FRAME_BYTES));
        let (socket, _) = connect_async_tls_with_config(
            url.as_str(),
            Some(config),
            true,
            Some(Connector::Rustls(tls)),
        )
        .await
        .map_err(refusal)?;
        Ok(StateStream { source: Source::WebSocket(Box::new(socket)) })
    }

    pub(crate) fn zenoh(subscriber: Subscriber<RingChannelHandler<Sample>>) -> StateStream {
        StateStream { source: Source::Zenoh(subscriber) }
    }

    /// The next state; `None` once the daemon has closed the stream (Zenoh has no such end).
    pub async fn next(&mut self) -> Result<Option<StateFrame>> {
        match &mut self.source {
            Source::Zenoh(subscriber) => {
                let sample = subscriber.recv_async().await.map_err(Error::Zenoh)?;
                Ok(Some(StateFrame::decode(&sample.payload().to_bytes())?))
            }
            Source::WebSocket(socket) => {
                while let Some(message) = socket.next().await {
                    match message? {
                        Message::Binary(bytes) => return Ok(Some(StateFrame::decode(&bytes)?)),
                        Message::Close(_) => return Ok(None),
                        Message::Text(_) => {
                            return Err(Error::Decode("text on the state stream".to_owned()));
                        }
                        Message::Ping(_) | Message::Pong(_) | Message::Frame(_) => {}
                    }
                }
                Ok(None)
            }
        }
    }
}

/// The problem document of a refused handshake.
fn refusal(error: tokio_tungstenite::tungstenite::Error) -> Error {
    if let tokio_tungstenite::tungstenite::Error::Http(response) = &error
        && let Some(Ok(problem)) = response.body().as_deref().map(serde_json::from_slice)
    {
        return Error::Problem(Box::new(problem));
    }
    error.into()
}
