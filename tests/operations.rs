//! What the people who run the daemon rely on.

use crate::bodies::{ready_bar, seam, stitch};
use crate::daemon::{Daemon, PATIENCE};
use crate::plain_http::plain_http;
use serde_json::Value;
use std::collections::BTreeSet;

const ROUTES: [(&str, &[&str]); 29] = [
    ("/", &["get"]),
    ("/healthz", &["get"]),
    ("/readyz", &["get"]),
    ("/metrics", &["get"]),
    ("/openapi.json", &["get"]),
    ("/v1/sessions", &["get", "post"]),
    ("/v1/sessions/{id}", &["delete", "get"]),
    ("/v1/sessions/{id}/fork", &["post"]),
    ("/v1/sessions/{id}/seams", &["post"]),
    ("/v1/sessions/{id}/events", &["get"]),
    ("/v1/sessions/{id}/edits", &["post"]),
    ("/v1/sessions/{id}/generations/{generation}/modes", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/basis", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/transfer", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/delta", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/combination", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/dictionary", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/evaluator", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/mass", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/frequencies_hz", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/positions", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/tets", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/stitches", &["get"]),
    ("/v1/sessions/{id}/generations/{generation}/evaluate", &["post"]),
    ("/v1/sessions/{id}/evaluate", &["post"]),
    ("/v1/sessions/{id}/simulation", &["delete", "get", "put"]),
    ("/v1/sessions/{id}/simulation/forces", &["post"]),
    ("/v1/sessions/{id}/simulation/grabs", &["post"]),
    ("/v1/sessions/{id}/stream", &["get"]),
];

async fn get(daemon: &Daemon, path: &str) -> reqwest::Response {
    plain_http().get(daemon.url(path)).send().await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_description_lists_every_route_and_every_reference_resolves() {
    let daemon = Daemon::start();
    let document: Value = get(&daemon, "/openapi.json").await.json().await.unwrap();
    assert!(document["openapi"].as_str().unwrap().starts_with("3."), "{}", document["openapi"]);
    let listed: Vec<(&str, Vec<&str>)> = document["paths"]
        .as_object()
        .unwrap()
        .iter()
        .map(|(path, methods)| {
            let mut methods: Vec<&str> =
                methods.as_object().unwrap().keys().map(String::as_str).collect();
            methods.sort_unstable();
            (path.as_str(), methods)
        })
        .collect();
    let listed: BTreeSet<_> = listed.into_iter().collect();
    let expected = ROUTES.iter().map(|(path, methods)| (*path, methods.to_vec()));
    assert_eq!(listed, expected.collect());

    let mut values = vec![&document];
    while let Some(value) = values.pop() {
        match value {
            Value::Array(items) => values.extend(items),
            Value::Object(members) => {
                if let Some(Value::String(reference)) = members.get("$ref") {
                    let pointer = reference.strip_prefix('#').unwrap();
                    assert!(document.pointer(pointer).is_some(), "{reference} leads nowhere");
                }
                values.extend(members.values());
            }
            _ => {}
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn health_readiness_metrics_and_request_ids_are_there() {
    let daemon = Daemon::start();
    for path in ["/healthz", "/readyz", "/"] {
        let reply = get(&daemon, path).await;
        assert_eq!(reply.status(), 200, "{path}");
        assert!(!reply.headers()["x-request-id"].is_empty(), "{path}");
    }
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    let reply = get(&daemon, "/metrics").await;
    assert_eq!(reply.status(), 200);
    let text = reply.text().await.unwrap();
    let sample = |line: &&str| !line.starts_with('#') && line.starts_with("sutura_");
    assert!(text.lines().filter(sample).count() > 3, "{text}");
    assert!(text.contains("/v1/sessions/{id}/edits"), "requests are counted by route: {text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_request_does_is_logged_under_its_name() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("log");
    let log = std::fs::File::create(&path).unwrap();
    let daemon = Daemon::start_logging(&scratch.path().join("data"), "info", log.into());
    let session = ready_bar(&daemon).await;
    let [first, second] = [&seam()[..1], &seam()[1..2]].map(stitch);
    let url = daemon.url(&format!("/v1/sessions/{}/edits", session.id()));
    let request = plain_http().post(url).header("x-request-id", "over-http");
    let reply = request.json(&first).send().await.unwrap();
    assert_eq!(
        (reply.status().as_u16(), &reply.headers()["x-request-id"]),
        (200, &"over-http".parse().unwrap())
    );
    let zenoh = daemon.zenoh_client().await;
    let of_zenoh = zenoh.session(session.id()).unwrap().with_request_id("over-zenoh");
    of_zenoh.edit(&second).await.unwrap();
    let log = std::fs::read_to_string(&path).unwrap();
    for name in ["over-http", "over-zenoh"] {
        let said = |line: &str| line.contains(name) && line.contains("generation ready");
        assert!(log.lines().any(said), "nothing was logged of {name}: {log}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_asked_to_go_down_ends_its_streams_and_exits_with_0() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    session.edit(&stitch(&seam())).await.unwrap();
    session.simulate(&Default::default()).await.unwrap();
    let mut states = session.states().await.unwrap();
    let mut events = session.events().await.unwrap();
    states.next().await.unwrap().unwrap();
    let down = tokio::task::spawn_blocking(|| daemon.terminate());
    let ends = async {
        while states.next().await.unwrap().is_some() {}
        while events.next().await.unwrap().is_some() {}
    };
    tokio::time::timeout(PATIENCE, ends).await.expect("both streams end");
    assert_eq!(down.await.unwrap().code(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edit_under_way_is_finished_before_the_daemon_goes_down() {
    let daemon = Daemon::start();
    let session = ready_bar(&daemon).await;
    let mut events = session.events().await.unwrap();
    events.next().await.unwrap();
    let edit = tokio::spawn(async move { session.edit(&stitch(&seam())).await });
    // Its first event tells that it has begun.
    events.next().await.unwrap().unwrap();
    let down = tokio::task::spawn_blocking(|| daemon.terminate());
    assert_eq!(edit.await.unwrap().unwrap().generation, 1);
    assert_eq!(down.await.unwrap().code(), Some(0));
}
