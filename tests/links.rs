//! Links that break, and clients that are slow or go away without a word.

use crate::bodies::{ready_bar, seam, soften, stitch};
use crate::daemon::{Daemon, PATIENCE};
use std::io::Write;
use std::net::TcpStream;
use std::sync::Arc;
use std::time::Instant;
use sutura_client::ZenohClient;
use sutura_client::proto::simulation::SimulationConfig;
use tokio::net::{TcpListener, TcpStream as AsyncStream};
use tokio::sync::watch;

/// A port that leads to another one, for as long as it is not cut.
struct Link {
    endpoint: String,
    is_cut: Arc<watch::Sender<bool>>,
}

impl Link {
    async fn to(address: &str) -> Link {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let (is_cut, address) = (Arc::new(watch::Sender::new(false)), address.to_owned());
        let cuts = is_cut.clone();
        tokio::spawn(async move {
            while let Ok((mut near, _)) = listener.accept().await {
                let (mut cut, address) = (cuts.subscribe(), address.clone());
                tokio::spawn(async move {
                    if *cut.borrow() {
                        return;
                    }
                    let Ok(mut far) = AsyncStream::connect(address).await else { return };
                    // Both ends are closed when either of these is over.
                    tokio::select! {
                        _ = tokio::io::copy_bidirectional(&mut near, &mut far) => {}
                        _ = cut.wait_for(|is_cut| *is_cut) => {}
                    }
                });
            }
        });
        Link { endpoint, is_cut }
    }

    fn cut(&self, is_cut: bool) {
        self.is_cut.send_replace(is_cut);
    }
}

fn motion() -> SimulationConfig {
    SimulationConfig { dt_s: 0.005, publish_hz: 100.0, ..SimulationConfig::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_over_zenoh_goes_on_when_its_link_is_back() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    session.simulate(&motion()).await.unwrap();
    let link = Link::to(daemon.zenoh.strip_prefix("tcp/").unwrap()).await;
    let zenoh = ZenohClient::open(&link.endpoint).await.unwrap();
    let remote = zenoh.session(session.id()).unwrap();
    let mut states = remote.states().await.unwrap();
    let next = async |states: &mut sutura_client::StateStream| {
        let state = tokio::time::timeout(PATIENCE, states.next()).await;
        state.expect("no state came").unwrap().unwrap()
    };
    next(&mut states).await;

    link.cut(true);
    // Meanwhile the body is edited and moves on.
    session.edit(&soften(0)).await.unwrap();
    assert!(remote.info().await.is_err());
    let at_the_cut = session.simulation().await.unwrap().sequence;
    link.cut(false);
    // Without a new subscription: states from after the cut come.
    let begun = Instant::now();
    loop {
        let state = next(&mut states).await;
        if state.sequence > at_the_cut && state.generation == 2 {
            break;
        }
        assert!(begun.elapsed() < PATIENCE);
    }
    assert_eq!(remote.info().await.unwrap().generation, 2);
}

/// Speaks HTTP by hand, to stop wherever it likes.
fn begin(daemon: &Daemon, head: &str) -> TcpStream {
    let address = daemon.http.strip_prefix("http://").unwrap();
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(head.replace('\n', "\r\n").as_bytes()).unwrap();
    stream
}

#[tokio::test(flavor = "multi_thread")]
async fn slow_and_vanishing_clients_hold_up_nobody() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    session.simulate(&motion()).await.unwrap();
    let path = format!("/v1/sessions/{}", session.id());

    // Listeners that read nothing, senders that stop in the midst, and some that go away at once.
    let stream = format!(
        "GET {path}/stream HTTP/1.1\nhost: a\nconnection: upgrade\nupgrade: websocket\n\
         sec-websocket-version: 13\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\n\n"
    );
    let events = format!("GET {path}/events HTTP/1.1\nhost: a\n\n");
    let edit = format!(
        "POST {path}/edits HTTP/1.1\nhost: a\ncontent-type: application/json\ncontent-length: 1000\n\n{{"
    );
    let head = "GET /v1/sessions HTTP/1.1\nhost".to_owned();
    let mut held = Vec::new();
    for request in [&stream, &events, &edit, &head] {
        for _ in 0..8 {
            held.push(begin(&daemon, request));
            drop(begin(&daemon, request));
        }
    }
    // Others are answered, and see the body move.
    let mut states = session.states().await.unwrap();
    let mut last = 0;
    for _ in 0..20 {
        let state = tokio::time::timeout(PATIENCE, states.next()).await.unwrap().unwrap().unwrap();
        assert!(state.sequence > last);
        last = state.sequence;
    }
    session.edit(&soften(0)).await.unwrap();
    // An edit whose client goes away is done or not done; the session goes on in any case.
    for stitch_id in 1..4 {
        let one = serde_json::to_string(&soften(stitch_id)).unwrap();
        let request = format!(
            "POST {path}/edits HTTP/1.1\nhost: a\ncontent-type: application/json\ncontent-length: {}\n\n{one}",
            one.len()
        );
        drop(begin(&daemon, &request));
    }
    let reply = session.edit(&soften(5)).await.unwrap();
    assert!((3..=6).contains(&reply.generation), "{}", reply.generation);
    // With those who take nothing and those who stopped in the midst still there it goes down in order.
    assert!(daemon.terminate().success());
    drop(held);
}
