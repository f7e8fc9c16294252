//! A simulation, watched over both transports while the body is edited.

use crate::bodies::{TIP, bar, config, ready_bar, seam, stitch};
use crate::daemon::{Daemon, PATIENCE};
use std::sync::Arc;
use sutura_client::proto::edit::{Edit, EditRequest};
use sutura_client::proto::evaluate::{Coordinates, EvaluateReply, EvaluateRequest};
use sutura_client::proto::session::{MaterialConfig, MaterialLaw, SessionConfig};
use sutura_client::proto::simulation::{
    Force, Grab, GrabRequest, IntegratorConfig, Obstacle, SimulationConfig,
};
use sutura_client::proto::state::StateFrame;
use sutura_client::reduced::{Integrator, Simulation, SimulationParams};
use sutura_client::{Arrays, Evaluator, Generation, StateStream, Tracker};

fn motion() -> SimulationConfig {
    SimulationConfig { dt_s: 0.002, publish_hz: 500.0, ..SimulationConfig::default() }
}

async fn next(states: &mut StateStream) -> StateFrame {
    let next = tokio::time::timeout(PATIENCE, states.next()).await;
    next.expect("a state arrives").unwrap().expect("the stream goes on")
}

/// The first state that is as told; within [`PATIENCE`] of simulated time.
async fn until(
    states: &mut StateStream,
    what: &str,
    is_so: impl Fn(&StateFrame) -> bool,
) -> StateFrame {
    let mut state = next(states).await;
    let end_s = state.time_s + PATIENCE.as_secs_f64();
    while !is_so(&state) {
        assert!(state.time_s < end_s, "not so yet: {what}; {state:?}");
        state = next(states).await;
    }
    state
}

/// Reads what is still under way, up to the stream's orderly end.
async fn to_its_end(states: &mut StateStream) {
    let end = async { while states.next().await.unwrap().is_some() {} };
    tokio::time::timeout(PATIENCE, end).await.expect("the stream ends");
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
    let info = session.simulate(&motion()).await.unwrap();
    assert_eq!((info.config, info.generation), (motion(), 1));

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
    let weightless = SimulationConfig { gravity_m_s2: [0.0; 3], ..motion() };
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
    let error = session.simulate(&motion()).await.unwrap_err();
    assert_eq!(error.status(), Some(422), "{error}");
    assert!(error.to_string().contains("6 rigid motions"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_ends_with_its_session() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    session.simulate(&motion()).await.unwrap();
    let mut states = session.states().await.unwrap();
    next(&mut states).await;
    session.delete().await.unwrap();
    // Those under way still arrive; then the stream is closed in an orderly way.
    to_its_end(&mut states).await;
    let error = session.states().await.err().unwrap();
    assert_eq!(error.status(), Some(404), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_tool_moves_over_both_doors_and_a_free_body_falls_onto_a_floor() {
    let daemon = Daemon::start();
    let session = daemon
        .client()
        .await
        .create(&SessionConfig { mesh: Some(bar()), fixed_vertices: Vec::new(), ..config() })
        .await
        .unwrap();
    let info = session.wait_ready(|_| ()).await.unwrap();
    assert_eq!(info.n_rigid_modes, 12);
    // Two halves: no frame. Stitched together, one.
    let refused = session.simulate(&motion()).await.unwrap_err();
    assert_eq!(refused.status(), Some(422));
    session.edit(&stitch(&seam())).await.unwrap();
    let lowest = bar().vertices.iter().map(|x| x[1]).fold(f64::INFINITY, f64::min);
    let floor = Obstacle::Plane { point_m: [0.0, lowest - 0.02, 0.0], normal: [0.0, 1.0, 0.0] };
    let falling = SimulationConfig {
        integrator: IntegratorConfig::BackwardEuler,
        obstacles: vec![floor],
        ..motion()
    };
    session.simulate(&falling).await.unwrap();
    let bus = daemon.zenoh_client().await.session(session.id()).unwrap();
    let mut states = bus.states().await.unwrap();
    // It falls as far as the floor, and stays there.
    let mut state = next(&mut states).await;
    while state.time_s < 0.6 {
        state = next(&mut states).await;
        assert!(state.rigid[1] > -0.03, "{:?}", state.rigid);
    }
    assert!(state.rigid[1] < -0.015, "{:?}", state.rigid);
    let info = session.simulation().await.unwrap();
    assert!(info.interaction_force_n[1] > 0.0 && info.n_recovered == 0);

    // Lifted by a grab over Zenoh, moved by one of the same name over HTTP, let go.
    let rest = bar().vertices[TIP as usize];
    let grab = |height: f64| Grab {
        id: 1,
        vertex: TIP,
        target_m: [rest[0], rest[1] + height, rest[2]],
        stiffness_n_m: 200.0,
        damping_n_s_m: 2.0,
    };
    let hold = |height| GrabRequest { grabs: vec![grab(height)], release: Vec::new() };
    // Hanging from its tip, its centre is at most half its length of 0.2 m below that.
    bus.grab(&hold(0.3)).await.unwrap();
    until(&mut states, "lifted", |state| state.rigid[1] > 0.1).await;
    session.grab(&hold(0.6)).await.unwrap();
    until(&mut states, "lifted higher", |state| state.rigid[1] > 0.4).await;
    assert_eq!(session.simulation().await.unwrap().n_grabs, 1);
    session.grab(&GrabRequest { grabs: Vec::new(), release: vec![1] }).await.unwrap();
    until(&mut states, "fallen", |state| state.rigid[1] < 0.3).await;
    assert_eq!(session.simulation().await.unwrap().n_grabs, 0);
    let bad = GrabRequest { grabs: vec![Grab { vertex: 1 << 30, ..grab(0.0) }], release: vec![] };
    assert_eq!(session.grab(&bad).await.unwrap_err().status(), Some(422));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_evaluates_and_steps_the_model_as_the_daemon_does() {
    let daemon = Daemon::start();
    let session = daemon
        .client()
        .await
        .create(&SessionConfig {
            mesh: Some(bar()),
            material: Some(MaterialConfig {
                law: MaterialLaw::NeoHookean,
                ..MaterialConfig::stvk(5e5, 0.4, 1000.0)
            }),
            ..config()
        })
        .await
        .unwrap();
    session.wait_ready(|_| ()).await.unwrap();
    session.edit(&stitch(&seam())).await.unwrap();
    let evaluator: Evaluator<f64> = session.evaluator(Generation::Current).await.unwrap();
    let model = Arc::new(evaluator.model(0).unwrap());
    let params = SimulationParams {
        dt_s: 0.002,
        integrator: Integrator::ImplicitNewmark,
        gravity_m_s2: [0.0, -9.81, 0.0],
        substep_tolerance: None,
    };
    let mut ours = Simulation::new(model.clone(), params).unwrap();
    let rest = vec![0.0; model.r()];
    (0..50).for_each(|_| assert!(!ours.step(&rest, &[]).recovered));
    // Evaluated: the same to the last digits.
    let request = EvaluateRequest { q: Coordinates::Single(ours.q().to_vec()), exact: false };
    let EvaluateReply::Single(theirs) =
        session.evaluate(Generation::Current, &request).await.unwrap()
    else {
        panic!("one pose, one answer");
    };
    let here = model.evaluate(ours.q());
    assert!((here.energy_j / theirs.energy_j - 1.0).abs() < 1e-12);
    for (a, b) in here.force.iter().zip(&theirs.force) {
        assert!((a - b).abs() < 1e-10 * here.force[0].abs());
    }
    // Stepped: the daemon's state of the same time.
    session.simulate(&motion()).await.unwrap();
    let mut states = session.states().await.unwrap();
    let mut simulated = Simulation::new(model, params).unwrap();
    let mut n_compared = 0;
    while n_compared < 20 {
        let state = next(&mut states).await;
        while simulated.time_s() < state.time_s - 1e-9 {
            simulated.step(&rest, &[]);
        }
        for (a, b) in simulated.q().iter().zip(&state.q) {
            assert!((a - f64::from(*b)).abs() < 1e-5 * (1e-4 + a.abs()), "{a} {b}");
        }
        n_compared += 1;
    }
}
