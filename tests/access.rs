//! Keys: who is let in, and what they see.

use crate::bodies::{bar, config, ready_bar, seam, stitch};
use crate::daemon::{Daemon, PATIENCE};
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};
use sutura_client::proto::edit::{Edit, EditRequest};
use sutura_client::proto::evaluate::{Coordinates, EvaluateRequest};
use sutura_client::proto::session::SessionConfig;
use sutura_client::{Client, Error, Generation};

fn sutura(arguments: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sutura"));
    command.args(arguments).arg("--data").arg(folder).output().unwrap()
}

/// A new key, as the command prints it.
fn key(folder: &Path, tenant: &str, role: &str) -> String {
    let made = sutura(&["key", "new", "--tenant", tenant, "--role", role], folder);
    assert!(made.status.success(), "{made:?}");
    String::from_utf8(made.stdout).unwrap().trim().to_owned()
}

async fn client(daemon: &Daemon, key: &str) -> Client {
    Client::connect_with_key(&daemon.http, Some(key)).await.unwrap()
}

fn status<T>(result: Result<T, Error>) -> Option<u16> {
    result.err().unwrap().status()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_opens_its_tenant_s_sessions_by_its_role_and_no_others() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (editor, reader) = (key(folder, "a", "edit"), key(folder, "a", "read"));
    let (admin, other) = (key(folder, "a", "admin"), key(folder, "b", "edit"));
    let daemon = Daemon::start_on(folder);

    let mine = client(&daemon, &editor).await;
    let config = SessionConfig { mesh: Some(bar()), ..config() };
    let session = mine.create(&config).await.unwrap();
    session.wait_ready(|_| {}).await.unwrap();
    session.edit(&stitch(&seam())).await.unwrap();

    // A reader looks, and changes nothing.
    let reading = client(&daemon, &reader).await;
    assert_eq!(reading.list(None, 10).await.unwrap().sessions.len(), 1);
    let read = reading.session(session.id()).unwrap();
    let info = read.info().await.unwrap();
    assert_eq!(info.generation, 1);
    let pose = EvaluateRequest { q: Coordinates::Single(vec![0.0; info.basis_size]), exact: false };
    read.evaluate(Generation::Current, &pose).await.unwrap();
    assert_eq!(status(read.edit(&stitch(&seam()[..1])).await), Some(403));
    assert_eq!(status(read.delete().await), Some(403));
    assert_eq!(status(reading.create(&config).await), Some(403));

    // Another tenant finds nothing there.
    let others = client(&daemon, &other).await;
    assert!(others.list(None, 10).await.unwrap().sessions.is_empty());
    let theirs = others.session(session.id()).unwrap();
    assert_eq!(status(theirs.info().await), Some(404));
    assert_eq!(status(theirs.edit(&stitch(&seam()[..1])).await), Some(404));
    assert_eq!(status(theirs.fork(None).await), Some(404));
    assert_eq!(status(theirs.delete().await), Some(404));
    let own = others.create(&config).await.unwrap();
    own.wait_ready(|_| {}).await.unwrap();
    assert_eq!(others.list(None, 10).await.unwrap().sessions.len(), 1);
    assert_eq!(mine.list(None, 10).await.unwrap().sessions.len(), 1);

    // So over Zenoh, where the key travels as the attachment.
    let zenoh = daemon.zenoh_client().await;
    assert_eq!(status(zenoh.session(session.id()).unwrap().info().await), Some(401));
    let of = |key: &str| zenoh.clone().with_key(key).session(session.id()).unwrap();
    assert_eq!(of(&editor).info().await.unwrap().generation, 1);
    assert_eq!(status(of(&other).info().await), Some(404));
    assert_eq!(status(of(&reader).edit(&stitch(&seam()[..1])).await), Some(403));
    let mut heard = of(&other).generations().await.unwrap();
    of(&editor).edit(&unstitched()).await.unwrap();
    let nothing = tokio::time::timeout(Duration::from_millis(200), heard.next()).await;
    assert!(nothing.is_err(), "a generation was published to whoever listens");

    // Without a key, or with a wrong one, nobody gets beyond the door.
    let http = reqwest::Client::new();
    let get = |path: &str, key: Option<&str>| {
        let request = http.get(daemon.url(path));
        let request = key.map_or(request.try_clone().unwrap(), |key| request.bearer_auth(key));
        async move { request.send().await.unwrap() }
    };
    for path in ["/v1/sessions", "/metrics"] {
        let refused = get(path, None).await;
        assert_eq!(refused.status(), 401, "{path}");
        assert!(refused.headers()["www-authenticate"].to_str().unwrap().starts_with("Bearer"));
        assert_eq!(get(path, Some("sutura_00")).await.status(), 401, "{path}");
    }
    assert_eq!(get("/metrics", Some(&editor)).await.status(), 403);
    assert_eq!(get("/metrics", Some(&admin)).await.status(), 200);
    for path in ["/healthz", "/readyz", "/openapi.json"] {
        assert_eq!(get(path, None).await.status(), 200, "{path}");
    }
    // Only streams take it from the query.
    let in_query = |path: &str| get(&format!("{path}?access_token={reader}"), None);
    assert_eq!(in_query("/v1/sessions").await.status(), 401);
    let events = in_query(&format!("/v1/sessions/{}/events", session.id())).await;
    assert_eq!(events.status(), 200);
    drop(events);

    // Keys are made and revoked while the daemon runs.
    let list = String::from_utf8(sutura(&["key", "list"], folder).stdout).unwrap();
    assert_eq!(list.lines().count(), 4, "{list}");
    let line = list.lines().find(|line| line.ends_with("b")).unwrap();
    let name = line.split_whitespace().next().unwrap();
    assert!(sutura(&["key", "revoke", name], folder).status.success());
    let begun = Instant::now();
    while others.list(None, 10).await.is_ok() {
        assert!(begun.elapsed() < PATIENCE, "the key still opens the daemon");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }

    // Whose a session is outlives the daemon.
    drop(daemon);
    let daemon = Daemon::start_on(folder);
    let mine = client(&daemon, &editor).await;
    let found = mine.list(None, 10).await.unwrap().sessions;
    assert_eq!(found.iter().map(|info| &*info.id).collect::<Vec<_>>(), [session.id()]);
}

fn unstitched() -> EditRequest {
    EditRequest::new(vec![Edit::UnstitchAll {}])
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_without_keys_is_open_on_this_machine_only() {
    let daemon = Daemon::start();
    ready_bar(&daemon).await;
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["serve", "--http", "0.0.0.0:0", "--zenoh", "tcp/127.0.0.1:0"];
    let refused = sutura(&arguments, folder.path());
    assert_eq!(refused.status.code(), Some(2));
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(said.contains("not loopback") && said.contains("sutura key new"), "{said}");
}

#[test]
fn a_data_directory_that_cannot_be_used_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let arguments = ["serve", "--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0"];
    let refused = sutura(&arguments, &file);
    assert!(!refused.status.success());
    let said = String::from_utf8(refused.stderr).unwrap();
    assert!(said.contains(file.to_str().unwrap()), "{said}");

    let _daemon = Daemon::start_on(folder.path());
    let second = sutura(&arguments, folder.path());
    assert!(!second.status.success());
    let said = String::from_utf8(second.stderr).unwrap();
    assert!(said.contains("another daemon"), "{said}");
}
