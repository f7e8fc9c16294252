//! Connections: how many there may be, how long they may take to ask, and how they end.

use super::router;
use crate::gateway::Gateway;
use crate::metrics;
use crate::tls::Tls;
use axum::Router;
use axum::serve::Listener;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;

/// How long a connection may take to send the head of its next request, idle time included.
const MAX_HEAD_WAIT: Duration = Duration::from_secs(60);

/// Serves the whole API on `listener`, over TLS if there is a certificate, until `stop` is ready, then winds
/// down: streams end, requests under way are answered.
pub async fn serve(
    gateway: Gateway,
    mut listener: TcpListener,
    tls: Option<Arc<Tls>>,
    stop: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let mut beside = JoinSet::new();
    beside.spawn(metrics::upkeep(gateway.recorder().clone()));
    beside.spawn(metrics::observe(gateway.store().clone()));
    let router = router(gateway.clone());
    let places = Arc::new(Semaphore::new(gateway.limits().max_connections));
    let mut connections = JoinSet::new();
    let mut stop = pin!(stop);
    loop {
        let accepted = async {
            let place = Arc::clone(&places).acquire_owned().await;
            // Waits a little and tries again where the system has no room.
            (place, Listener::accept(&mut listener).await.0)
        };
        let (place, stream) = tokio::select! {
            accepted = accepted => accepted,
            () = &mut stop => break,
        };
        let (gateway, router, tls) = (gateway.clone(), router.clone(), tls.clone());
        connections.spawn(async move {
            open(&gateway, router, stream, tls.as_deref()).await;
            drop(place);
        });
        while connections.try_join_next().is_some() {}
    }
    drop(listener);
    gateway.wind_down();
    while connections.join_next().await.is_some() {}
    gateway.streams_ended().await;
    Ok(())
}

/// Serves one connection, over TLS if there is a certificate.
async fn open(gateway: &Gateway, router: Router, stream: TcpStream, tls: Option<&Tls>) {
    // Published states are small and must not wait for more to come.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "a connection keeps gathering small writes");
    }
    let Some(tls) = tls else { return connection(gateway, router, stream).await };
    let agreed = tokio::select! {
        agreed = tls.accept(stream) => agreed,
        () = gateway.wound_down() => None,
    };
    if let Some(stream) = agreed {
        connection(gateway, router, stream).await;
    }
}

/// Serves one connection until its client leaves, or, once the daemon winds down, until the request
/// under way is answered.
async fn connection(
    gateway: &Gateway,
    router: Router,
    stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
) {
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(MAX_HEAD_WAIT)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .with_upgrades();
    let mut connection = pin!(connection);
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = gateway.wound_down() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection broke off");
    }
}
