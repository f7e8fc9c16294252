//! The main job: from a mesh to stitched generations, over both transports.

use crate::bodies::{
    CUBATURE_TOLERANCE, N_HALF, STIFFNESS_N_M, TIP, bar, config, msh, prepared, ready_bar, seam,
    stitch,
};
use crate::daemon::Daemon;
use std::collections::BTreeSet;
use std::time::Duration;
use sutura_client::proto::edit::{
    Edit, EditDerivatives, EditMethod, EditReply, EditRequest, Verdict,
};
use sutura_client::proto::event::Event;
use sutura_client::proto::session::{SessionConfig, SessionInfo, SessionState};
use sutura_client::{Arrays, Basis, Error, EventStream, Generation, Tracker};

/// Largest relative difference of corresponding numbers.
fn difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / b.abs()).fold(0.0, f64::max)
}

#[tokio::test(flavor = "multi_thread")]
async fn an_incision_is_closed_over_http_and_over_zenoh() {
    let daemon = Daemon::start();
    let client = daemon.client().await;
    let zenoh = daemon.zenoh_client().await;

    let session = client.create_from_file("bar.msh", msh(&bar()), &config()).await.unwrap();
    let info = session.wait_ready(|_| {}).await.unwrap();
    assert_eq!((info.state, info.generation), (SessionState::Ready, 0));
    assert_eq!((info.n_vertices, info.n_tets), (2 * N_HALF as usize, 2 * 96));
    assert_eq!((info.n_domains, info.n_components), (2, 2));
    assert_eq!((info.n_free_dofs, info.n_rigid_modes), (3 * (2 * 45 - 9), 6));
    assert_eq!((info.n_modes, info.n_stitches), (8, 0));
    assert!(info.frequencies_hz.is_sorted() && info.frequencies_hz[0] > 0.0);
    assert_eq!(info.name.as_deref(), Some("bar"));
    assert!(info.memory_bytes > 0);
    assert_eq!(info.parameters.as_ref().unwrap().domain_materials[&2].young_modulus_pa, 5e5);

    let pairs = seam();
    let (first, second) = pairs.split_at(5);
    let reply = session.edit(&stitch(first)).await.unwrap();
    assert_eq!((reply.generation, reply.n_stitches), (1, 5));
    assert_eq!((reply.stitch_ids.len(), reply.n_rigid_modes), (5, 0));
    assert_eq!(reply.method, EditMethod::Flexibility);
    assert_eq!(reply.residuals.len(), reply.frequencies_hz.len());
    assert!(reply.timings_ms.total > 0.0);
    let cubature = reply.cubature.unwrap();
    let says_so = reply.warnings.iter().any(|warning| warning.contains("cubature"));
    assert_eq!(says_so, cubature.validation_error > CUBATURE_TOLERANCE, "{:?}", reply.warnings);

    let bus = zenoh.session(session.id()).unwrap();
    let mut generations = bus.generations().await.unwrap();
    let request = EditRequest { base_generation: Some(1), ..stitch(second) };
    let closed = bus.edit(&request).await.unwrap();
    assert_eq!((closed.generation, closed.n_stitches), (2, 9));
    assert!(closed.frequencies_hz[0] > reply.frequencies_hz[0]);
    let mut published = generations.next().await.unwrap();
    if published.generation == 1 {
        // The first edit's, which was answered before it was published.
        published = generations.next().await.unwrap();
    }
    assert_eq!((published.generation, published.n_stitches), (2, 9));

    // Both transports describe the same session, once nothing goes on in it any more.
    prepared(&session, 9).await;
    let over_http = serde_json::to_value(session.info().await.unwrap()).unwrap();
    let over_zenoh = serde_json::to_value(bus.info().await.unwrap()).unwrap();
    assert_eq!(over_http, over_zenoh);
    assert_eq!(over_http["generation"], 2);

    // Two rounds of edits come to what one round from scratch comes to.
    let all = SessionConfig { mesh: Some(bar()), ..config() };
    let other = client.create(&all).await.unwrap();
    other.wait_ready(|_| {}).await.unwrap();
    let request = EditRequest { method: EditMethod::FromScratch, ..stitch(&pairs) };
    let truth = other.edit(&request).await.unwrap();
    let half = truth.frequencies_hz.len() / 2;
    let error = difference(&closed.frequencies_hz[..half], &truth.frequencies_hz[..half]);
    assert!(error < 1e-4, "{error:e}: {:?} and {:?}", closed.frequencies_hz, truth.frequencies_hz);

    assert_eq!(zenoh.daemons().await.unwrap().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn unstitching_returns_the_original_spectrum() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let before = session.info().await.unwrap();
    let reply = session.edit(&stitch(&seam())).await.unwrap();
    assert!(difference(&reply.frequencies_hz[..1], &before.frequencies_hz[..1]) > 1e-2);
    let unstitch = Edit::Unstitch { stitch_ids: reply.stitch_ids };
    let undone = session.edit(&EditRequest::new(vec![unstitch])).await.unwrap();
    assert_eq!((undone.generation, undone.n_stitches, undone.n_rigid_modes), (2, 0, 6));
    let half = before.frequencies_hz.len() / 2;
    let error = difference(&undone.frequencies_hz[..half], &before.frequencies_hz[..half]);
    assert!(error < 1e-4, "{error:e}");
}

#[tokio::test(flavor = "multi_thread")]
async fn undone_redone_and_changed_in_stiffness() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let stitched = session.edit(&stitch(&seam())).await.unwrap();
    let undone = session.edit(&EditRequest::restore(0)).await.unwrap();
    assert_eq!((undone.generation, undone.n_stitches), (2, 0));
    let redone = session.edit(&EditRequest::restore(1)).await.unwrap();
    assert_eq!((redone.generation, redone.n_stitches), (3, stitched.n_stitches));
    assert_eq!(redone.frequencies_hz, stitched.frequencies_hz);

    let soften = Edit::SetStiffness { stitch_ids: stitched.stitch_ids, stiffness_n_m: 1.0 };
    let soft = session.edit(&EditRequest::new(vec![soften])).await.unwrap();
    assert_eq!(soft.n_stitches, stitched.n_stitches);
    assert!(soft.frequencies_hz[0] < 0.9 * stitched.frequencies_hz[0]);
    let open = session.edit(&EditRequest::new(vec![Edit::UnstitchAll {}])).await.unwrap();
    assert_eq!((open.n_stitches, open.n_rigid_modes), (0, undone.n_rigid_modes));

    let lost = session.edit(&EditRequest::restore(99)).await.unwrap_err();
    assert_eq!(lost.status(), Some(404), "{lost}");
}

#[tokio::test(flavor = "multi_thread")]
async fn vertices_are_fixed_and_released_over_http_and_over_zenoh() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let before = session.info().await.unwrap();
    let fixed_before = before.parameters.as_ref().unwrap().n_fixed_vertices;
    let mut tracker = Tracker::new(session.clone()).await.unwrap();

    let tip = || vec![TIP - 1, TIP];
    let fix = Edit::Fix { vertices: tip() };
    let fixed = session.edit(&EditRequest::new(vec![fix])).await.unwrap();
    // Held at two vertices, the free half can still turn about the line through them.
    assert_eq!(fixed.n_rigid_modes, 1);
    let info = session.info().await.unwrap();
    assert_eq!(info.n_free_dofs, before.n_free_dofs - 6);
    assert_eq!(info.parameters.unwrap().n_fixed_vertices, fixed_before + 2);
    // The new basis, in which the held vertices rest.
    tracker.follow(fixed.generation).await.unwrap();
    let whole = session.basis::<f32>(fixed.generation.into()).await.unwrap();
    let (followed, fetched) = (tracker.basis().unwrap(), &whole);
    for i in 0..whole.size() {
        let largest = fetched.column(i).iter().fold(0.0f32, |m, x| m.max(x.abs()));
        for (a, b) in followed.column(i).iter().zip(fetched.column(i)) {
            assert!((a - b).abs() < 1e-4 * largest, "column {i}: {a} and {b}");
        }
        assert!(fetched.column(i)[3 * (TIP as usize - 1)..].iter().all(|x| *x == 0.0));
    }

    let bus = daemon.zenoh_client().await.session(session.id()).unwrap();
    let release = EditRequest::new(vec![Edit::Release { vertices: tip() }]);
    let released = bus.edit(&release).await.unwrap();
    assert_eq!(released.n_rigid_modes, before.n_rigid_modes);
    let half = before.frequencies_hz.len() / 2;
    let error = difference(&released.frequencies_hz[..half], &before.frequencies_hz[..half]);
    assert!(error < 1e-4, "{error:e}");
    // Undone across the change of supports, and everything let go.
    let undone = session.edit(&EditRequest::restore(fixed.generation)).await.unwrap();
    assert_eq!(undone.frequencies_hz, fixed.frequencies_hz);
    let mut all = tip();
    all.extend(config().fixed_vertices);
    let floating = EditRequest::new(vec![Edit::Release { vertices: all }]);
    assert_eq!(session.edit(&floating).await.unwrap().n_rigid_modes, 12);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gap_is_closed_and_the_body_is_as_one_built_closed() {
    let daemon = Daemon::start();
    let closed = ready_bar(&daemon).await;
    let truth = closed.edit(&stitch(&seam())).await.unwrap();

    let mut open = bar();
    for [x, y, _] in &mut open.vertices[N_HALF as usize..] {
        *x += 0.01;
        *y += 0.002;
    }
    let config = SessionConfig { mesh: Some(open.clone()), ..config() };
    let session = daemon.client().await.create(&config).await.unwrap();
    session.wait_ready(|_| {}).await.unwrap();
    let close = |pairs: Vec<[u32; 2]>| {
        let edit = Edit::Close { pairs, stiffness_n_m: STIFFNESS_N_M, max_gap_m: None };
        EditRequest::new(vec![edit])
    };
    // The held end cannot be closed upon itself: nothing changes, and the gap is named.
    let held = session.edit(&close(vec![[0, 5]])).await.unwrap_err();
    assert_eq!(held.status(), Some(422), "{held}");
    assert!(held.to_string().contains("2.5e-2 m"), "{held}");

    let bus = daemon.zenoh_client().await.session(session.id()).unwrap();
    let reply = bus.edit(&close(seam())).await.unwrap();
    assert_eq!((reply.generation, reply.n_stitches, reply.n_rigid_modes), (1, 9, 0));
    let [closing] = &reply.closings[..] else { panic!("{:?}", reply.closings) };
    assert_eq!((closing.edit, closing.gaps_m.len()), (0, 9));
    assert!(closing.gaps_m.iter().all(|gap| *gap < 1e-9), "{closing:?}");
    assert!(closing.dropped_energy_j < 1e-9, "{closing:?}");
    assert!((closing.largest_displacement_m - 0.01f64.hypot(0.002)).abs() < 1e-6, "{closing:?}");
    assert!(reply.warnings.iter().any(|warning| warning.contains("stress")), "{reply:?}");
    let half = truth.frequencies_hz.len() / 2;
    let error = difference(&reply.frequencies_hz[..half], &truth.frequencies_hz[..half]);
    assert!(error < 1e-4, "{error:e}");

    // Where the vertices rest now, and where they rested.
    let expected = bar().vertices;
    let over_http = session.positions::<f64>(1.into()).await.unwrap();
    assert_eq!(over_http, bus.positions::<f64>(1.into()).await.unwrap());
    assert_eq!(over_http.shape, [expected.len(), 3]);
    for (found, expected) in over_http.data.iter().zip(expected.as_flattened()) {
        assert!((found - expected).abs() < 1e-7, "{found} and {expected}");
    }
    session.edit(&EditRequest::restore(0)).await.unwrap();
    let restored = session.positions::<f64>(Generation::Current).await.unwrap();
    // To the last digit but one: decimal numbers in between.
    for (found, expected) in restored.data.iter().zip(open.vertices.as_flattened()) {
        assert!((found - expected).abs() < 1e-15, "{found} and {expected}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_paper_s_method_does_not_raise_the_frequencies() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let pairs = seam();
    let held = session.edit(&stitch(&pairs[..5])).await.unwrap();
    let low_rank = EditRequest { method: EditMethod::LowRank, ..stitch(&pairs[5..]) };
    let reply = session.edit(&low_rank).await.unwrap();
    assert_eq!(reply.method, EditMethod::LowRank);
    let request = EditRequest::new(vec![
        Edit::Unstitch { stitch_ids: reply.stitch_ids },
        Edit::Stitch { pairs: pairs[5..].to_vec(), stiffness_n_m: STIFFNESS_N_M },
    ]);
    let flexibility = session.fork(None).await.unwrap().edit(&request).await.unwrap();
    assert!(reply.frequencies_hz[0] < 1.001 * held.frequencies_hz[0]);
    assert!(flexibility.frequencies_hz[0] > 1.001 * held.frequencies_hz[0]);
}

#[tokio::test(flavor = "multi_thread")]
async fn edits_of_one_request_take_effect_together_or_not_at_all() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let pairs = seam();
    let before = session.info().await.unwrap();
    let half_wrong = EditRequest::new(vec![
        Edit::Stitch { pairs: pairs[..2].to_vec(), stiffness_n_m: 1e5 },
        Edit::Unstitch { stitch_ids: vec![77] },
    ]);
    let error = session.edit(&half_wrong).await.unwrap_err();
    assert_eq!(error.status(), Some(422), "{error}");
    assert_eq!(session.info().await.unwrap(), before);
    let reply = session.edit(&stitch(&pairs[..2])).await.unwrap();
    assert_eq!((reply.generation, reply.n_stitches), (1, 2));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fork_goes_its_own_way_and_outlives_its_origin() {
    let daemon = Daemon::start();
    let client = daemon.client().await;
    let origin = ready_bar(&daemon).await;
    let fork = origin.fork(Some("the other bar")).await.unwrap();
    assert_ne!(fork.id(), origin.id());
    let before = origin.info().await.unwrap();
    let info = fork.info().await.unwrap();
    assert_eq!(info.name.as_deref(), Some("the other bar"));
    assert_eq!(info.frequencies_hz, before.frequencies_hz);
    fork.edit(&stitch(&seam())).await.unwrap();
    // The base body is both's, and with it what is prepared for the fork's stitches; nothing else changes.
    prepared(&origin, seam().len()).await;
    let info = origin.info().await.unwrap();
    assert_eq!(info.n_prepared_pairs, seam().len());
    assert!(info.memory_bytes > before.memory_bytes);
    let SessionInfo { memory_bytes, n_prepared_pairs, .. } = before;
    assert_eq!(SessionInfo { memory_bytes, n_prepared_pairs, ..info }, before);

    let page = client.list(None, 1).await.unwrap();
    assert_eq!(page.sessions[0].id, origin.id());
    let page = client.list(page.next.as_deref(), 1).await.unwrap();
    assert_eq!((page.sessions[0].id.as_str(), page.next), (fork.id(), None));

    let mut events = origin.events().await.unwrap();
    assert!(matches!(events.next().await.unwrap(), Some(Event::State { .. })));
    origin.delete().await.unwrap();
    assert_eq!(events.next().await.unwrap(), Some(Event::Deleted));
    assert_eq!(events.next().await.unwrap(), None);
    let error = origin.info().await.unwrap_err();
    assert_eq!(error.status(), Some(404), "{error}");
    let error = origin.edit(&stitch(&seam())).await.unwrap_err();
    assert_eq!(error.status(), Some(404), "{error}");
    assert_eq!(client.list(None, 50).await.unwrap().sessions.len(), 1);
    assert_eq!(fork.info().await.unwrap().generation, 1);

    let gone = daemon.zenoh_client().await.session(origin.id()).unwrap();
    let error = gone.info().await.unwrap_err();
    assert!(matches!(error, Error::Absent(_)) || error.status() == Some(404), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_tells_of_its_edits() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let mut events = session.events().await.unwrap();
    let first = events.next().await.unwrap();
    assert_eq!(first, Some(Event::State { state: SessionState::Ready, generation: 0 }));
    session.edit(&stitch(&seam())).await.unwrap();
    let mut stages = BTreeSet::new();
    loop {
        match events.next().await.unwrap().unwrap() {
            Event::Generation(info) => {
                assert_eq!((info.generation, info.n_stitches), (1, 9));
                break;
            }
            Event::Stage { stage, progress } => {
                assert!((0.0..=1.0).contains(&progress), "{stage}: {progress}");
                stages.insert(stage);
            }
            Event::State { .. } => {}
            event => panic!("{event:?}"),
        }
    }
    let timed: BTreeSet<String> = session.info().await.unwrap().timings_ms.into_keys().collect();
    assert!(stages.contains("modes") && stages.is_subset(&timed), "{stages:?} of {timed:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn seams_are_prepared_in_the_background_and_can_be_added_to_an_open_session() {
    let daemon = Daemon::start();
    let client = daemon.client().await;
    let pairs = seam();
    let (named, added) = pairs.split_at(2);
    let config = SessionConfig { mesh: Some(bar()), seams: named.to_vec(), ..config() };
    let session = client.create(&config).await.unwrap();
    session.wait_ready(|_| {}).await.unwrap();
    prepared(&session, 2).await;
    let reply = session.edit(&stitch(named)).await.unwrap();
    assert_eq!(reply.certificate.verdict, Verdict::Patched, "{:?}", reply.certificate);

    let zenoh = daemon.zenoh_client().await;
    let bus = zenoh.session(session.id()).unwrap();
    let half = added.len() / 2;
    assert_eq!(session.add_seams(&added[..half]).await.unwrap().n_pairs, 2 + half);
    assert_eq!(bus.add_seams(&added[half..]).await.unwrap().n_pairs, pairs.len());
    prepared(&session, pairs.len()).await;
    let reply = bus.edit(&stitch(added)).await.unwrap();
    assert_eq!(reply.certificate.verdict, Verdict::Patched, "{:?}", reply.certificate);
    assert!(reply.certificate.lower_eigenvalue_error <= 1e-4, "{:?}", reply.certificate);
    assert!(!reply.timings_ms.stages.contains_key("seams"));

    let apart = [pairs[0], [pairs[0][0], pairs[1][1]]];
    let error = session.add_seams(&apart).await.unwrap_err();
    let problem = error.problem().expect("the daemon says why");
    assert_eq!((problem.status, problem.instance_pointer.as_deref()), (422, Some("/pairs/1")));
}

/// Waits until `events` tell of the generation `number`.
async fn until_made(events: &mut EventStream, number: u64) {
    let made = async {
        while let Some(event) = events.next().await.unwrap() {
            if matches!(&event, Event::Generation(made) if made.generation == number) {
                return;
            }
        }
        panic!("the session ended");
    };
    tokio::time::timeout(Duration::from_secs(60), made).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn part_of_a_seam_gets_derivatives_of_its_own_when_asked_for() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.add_seams(&seam()).await.unwrap();
    prepared(&session, seam().len()).await;
    let part = stitch(&seam()[..4]);
    let tells =
        |reply: &EditReply| reply.warnings.iter().any(|w| w.contains("derivatives of the open"));
    let verdict = |reply: &EditReply| reply.certificate.verdict;
    let combined = session.edit(&part).await.unwrap();
    assert_eq!(verdict(&combined), Verdict::Patched);
    assert!(tells(&combined) && !combined.certificate.is_unfinished, "{:?}", combined.warnings);

    let again = EditRequest { restore: Some(0), derivatives: EditDerivatives::Own, ..part };
    let own = session.edit(&again).await.unwrap();
    assert_eq!(verdict(&own), Verdict::Refined);
    assert!(!tells(&own), "{:?}", own.warnings);
    assert_eq!(own.eigenvalues_per_s2, combined.eigenvalues_per_s2);

    // At once what is prepared, then its own.
    let mut events = session.events().await.unwrap();
    let first = session.edit(&EditRequest { deadline_ms: Some(0.0), ..again }).await.unwrap();
    assert_eq!(verdict(&first), Verdict::Patched);
    assert!(tells(&first) && first.certificate.is_unfinished);
    until_made(&mut events, first.generation + 1).await;
    let own: Basis<f64> = session.basis(own.generation.into()).await.unwrap();
    let improved: Basis<f64> = session.basis(Generation::Current).await.unwrap();
    assert_eq!(own.size(), improved.size());
    assert!((0..own.size()).all(|i| own.column(i).eq(improved.column(i))));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_is_kept_and_the_rest_follows() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.add_seams(&seam()).await.unwrap();
    prepared(&session, seam().len()).await;
    let mut events = session.events().await.unwrap();
    // What was prepared does not reach this; refining takes longer than no time at all.
    let request = EditRequest { deadline_ms: Some(0.0), tolerance: 1e-11, ..stitch(&seam()) };
    let first = session.edit(&request).await.unwrap();
    assert_eq!(first.certificate.verdict, Verdict::Patched);
    assert!(first.certificate.is_unfinished && !first.certificate.is_met);
    until_made(&mut events, first.generation + 1).await;
    let info = session.info().await.unwrap();
    assert_eq!((info.generation, info.n_stitches), (first.generation + 1, first.n_stitches));
    assert!(difference(&info.frequencies_hz, &first.frequencies_hz) < 1e-2);
    // To whoever edits, the improved generation is the one it was made of.
    let unstitch = Edit::Unstitch { stitch_ids: first.stitch_ids.clone() };
    let request =
        EditRequest { base_generation: Some(first.generation), ..EditRequest::new(vec![unstitch]) };
    assert_eq!(session.edit(&request).await.unwrap().n_stitches, 0);
}
