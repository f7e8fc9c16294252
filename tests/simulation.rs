//! A simulation, watched over both transports while the body is edited.

use crate::bodies::{TIP, config, ready_bar, seam, stitch};
use crate::daemon::{Daemon, PATIENCE};
use sutura_client::proto::edit::{Edit, EditRequest};
use sutura_client::proto::simulation::{Force, SimulationConfig};
use sutura_client::proto::state::StateFrame;
use sutura_client::{StateStream, Tracker};

const CONFIG: SimulationConfig = SimulationConfig {
    dt_s: 0.002,
    integrator: sutura_client::proto::simulation::IntegratorConfig::ImplicitNewmark,
    gravity_m_s2: [0.0, -9.81, 0.0],
    publish_hz: 500.0,
};

async fn next(states: &mut StateStream) -> StateFrame {
    let next = tokio::time::timeout(PATIENCE, states.next()).await;
    next.expect("a state arrives").unwrap().expect("the stream goes on")
}

fn norm(values: impl IntoIterator<Item = f32>) -> f32 {
    values.into_iter().map(|x| x * x).sum::<f32>().sqrt()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulation_crosses_an_edit_without_a_jump() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let pairs = seam();
    session.edit(&stitch(&pairs[..8])).await.unwrap();
    let info = session.simulate(&CONFIG).await.unwrap();
    assert_eq!((info.config, info.generation), (CONFIG, 1));

    let bus = daemon.zenoh_client().await.session(session.id()).unwrap();
    let mut tracker = Tracker::new(bus.clone()).await.unwrap();
    let mut states = bus.states().await.unwrap();
    let mut state = next(&mut states).await;
    let mut displacement = tracker.displacement(&state).await.unwrap();
    // Let it sag, then edit it while it still swings.
    while state.time_s < 0.3 {
        state = next(&mut states).await;
        displacement = tracker.displacement(&state).await.unwrap();
    }
    for vertex in config().fixed_vertices {
        let at = 3 * vertex as usize;
        assert_eq!(&displacement[at..at + 3], [0.0; 3]);
    }
    assert!(displacement[3 * TIP as usize + 1] < -1e-4, "the tip sags");

    // The state at the switch is published in both generations. Either may be dropped on the way to
    // a slow consumer, so edit again until both have arrived.
    let last = &seam()[8..];
    let mut edit = stitch(last);
    let jump = loop {
        let editing = session.clone();
        let reply = tokio::spawn(async move { editing.edit(&edit).await.unwrap() });
        let generation = state.generation;
        let mut before = state;
        state = next(&mut states).await;
        while state.generation == generation {
            assert!(state.time_s < 60.0, "the edit makes no new generation");
            before = std::mem::replace(&mut state, next(&mut states).await);
        }
        let from = tracker.displacement(&before).await.unwrap();
        let to = tracker.displacement(&state).await.unwrap();
        assert_eq!(tracker.generation(), generation + 1);
        let reply = reply.await.unwrap();
        assert_eq!(reply.generation, generation + 1);
        if before.time_s == state.time_s {
            let difference = to.iter().zip(&from).map(|(a, b)| a - b);
            break norm(difference) / norm(from.iter().copied());
        }
        edit = match reply.stitch_ids[..] {
            [] => stitch(last),
            _ => EditRequest::new(vec![Edit::Unstitch { stitch_ids: reply.stitch_ids }]),
        };
    };
    assert!(jump < 0.01, "{jump}");
    let info = session.simulation().await.unwrap();
    assert_eq!(info.generation, state.generation);
    assert_eq!(info.n_recovered, 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn states_arrive_over_websocket_and_zenoh_and_answer_to_forces() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    let weightless = SimulationConfig { gravity_m_s2: [0.0; 3], ..CONFIG };
    session.simulate(&weightless).await.unwrap();
    let mut states = session.states().await.unwrap();
    let mut tracker = Tracker::new(session.clone()).await.unwrap();
    let first = next(&mut states).await;
    let second = next(&mut states).await;
    assert!(second.sequence > first.sequence && second.time_s > first.time_s);
    assert_eq!(norm(second.q.iter().copied()), 0.0, "nothing acts, nothing moves");

    let bus = daemon.zenoh_client().await.session(session.id()).unwrap();
    let mut zenoh_states = bus.states().await.unwrap();
    let pull = |z| Force { vertex: TIP, force_n: [0.0, 0.0, z], duration_s: 60.0 };
    let tip = 3 * TIP as usize + 2;

    session.push_forces(&[pull(0.5)]).await.unwrap();
    loop {
        let state = next(&mut states).await;
        assert!(state.time_s < 10.0, "the pull over HTTP moves nothing");
        if tracker.displacement(&state).await.unwrap()[tip] > 1e-3 {
            break;
        }
    }
    assert!(session.simulation().await.unwrap().n_forces >= 1);
    bus.push_forces(&[pull(-2.0)]).await.unwrap();
    loop {
        let state = next(&mut zenoh_states).await;
        assert!(state.time_s < 10.0, "the pull over Zenoh moves nothing");
        if tracker.displacement(&state).await.unwrap()[tip] < -1e-3 {
            break;
        }
    }

    let slower = SimulationConfig { publish_hz: 20.0, ..weightless };
    assert_eq!(session.simulate(&slower).await.unwrap().config, slower);
    session.stop_simulation().await.unwrap();
    let error = session.simulation().await.unwrap_err();
    assert_eq!(error.status(), Some(404), "{error}");
    let error = session.push_forces(&[pull(1.0)]).await.unwrap_err();
    assert_eq!(error.status(), Some(404), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_body_that_nothing_holds_is_not_simulated() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let error = session.simulate(&CONFIG).await.unwrap_err();
    assert_eq!(error.status(), Some(422), "{error}");
    assert!(error.to_string().contains("6 rigid modes"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_ends_with_its_session() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    session.simulate(&CONFIG).await.unwrap();
    let mut states = session.states().await.unwrap();
    next(&mut states).await;
    session.delete().await.unwrap();
    // Those under way still arrive; then the stream is closed in an orderly way.
    while states.next().await.unwrap().is_some() {}
    let error = session.states().await.err().unwrap();
    assert_eq!(error.status(), Some(404), "{error}");
}
