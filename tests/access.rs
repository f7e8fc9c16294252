//! Keys: who is let in, and what they see.

use crate::bodies::{bar, config, ready_bar, seam, soften, stitch};
use crate::daemon::{Daemon, PATIENCE};
use crate::plain_http::plain_http;
use serde_json::json;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};
use sutura_client::proto::evaluate::{Coordinates, EvaluateRequest};
use sutura_client::proto::keys::{self, Resource};
use sutura_client::proto::login::Login;
use sutura_client::proto::session::SessionConfig;
use sutura_client::proto::simulation::{Force, SimulationConfig};
use sutura_client::{BusSession, Client, Credentials, Error, Generation, Session, ZenohClient};

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
    Client::connect_as(&daemon.http, &Credentials::of_key(key)).await.unwrap()
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
    let of = async |key: &str| over_zenoh(&daemon, key).await.session(session.id()).unwrap();
    let (zenoh_editor, zenoh_other) = (of(&editor).await, of(&other).await);
    assert_eq!(zenoh_editor.info().await.unwrap().generation, 1);
    assert_eq!(status(zenoh_other.info().await), Some(404));
    assert_eq!(status(of(&reader).await.edit(&stitch(&seam()[..1])).await), Some(403));
    only_its_tenant_hears_of_a_session(&daemon, &session, &zenoh_editor, &reader, &other).await;

    // Without a key, or with a wrong one, nobody gets beyond the door.
    let http = plain_http();
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
    while ZenohClient::open_as(&daemon.zenoh, &Credentials::of_key(&*other)).await.is_ok() {
        assert!(begun.elapsed() < PATIENCE, "the key still joins Zenoh");
    }
    // The others connect again by themselves.
    while zenoh_editor.info().await.is_err() {
        assert!(begun.elapsed() < PATIENCE, "a client of Zenoh did not come back");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }

    // Whose a session is outlives the daemon.
    drop(daemon);
    let daemon = Daemon::start_on(folder);
    let mine = client(&daemon, &editor).await;
    let found = mine.list(None, 10).await.unwrap().sessions;
    assert_eq!(found.iter().map(|info| &*info.id).collect::<Vec<_>>(), [session.id()]);
}

async fn over_zenoh(daemon: &Daemon, key: &str) -> ZenohClient {
    ZenohClient::open_as(&daemon.zenoh, &Credentials::of_key(key)).await.unwrap()
}

/// A plain client of Zenoh with the credentials of a key, which does what clients of ours would not.
async fn zenoh_session(daemon: &Daemon, key: &str) -> zenoh::Session {
    let Login { user, password } = Login::of_key(key);
    let mut config = zenoh::Config::default();
    for (name, value) in [
        ("mode", json!("client")),
        ("connect/endpoints", json!([daemon.zenoh])),
        ("scouting/multicast/enabled", json!(false)),
        ("transport/auth/usrpwd", json!({"user": user, "password": password})),
    ] {
        config.insert_json5(name, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

async fn only_its_tenant_hears_of_a_session(
    daemon: &Daemon,
    session: &Session,
    editor: &BusSession,
    reader: &str,
    other: &str,
) {
    let mut generations = editor.generations().await.unwrap();
    let reading = over_zenoh(daemon, reader).await.session(session.id()).unwrap();
    let mut states = reading.states().await.unwrap();
    // The other tenant listens wherever something could be said, and would answer others' questions.
    let spy = zenoh_session(daemon, other).await;
    let heard = [
        "**".to_owned(),
        format!("sutura/v1/sessions/{}/*", session.id()),
        format!("sutura/v1/tenants/*/sessions/{}/state", session.id()),
        "sutura/v1/tenants/a/**".to_owned(),
    ];
    let mut ears = Vec::new();
    for key in heard {
        ears.push(spy.declare_subscriber(key).await.unwrap());
    }
    let asked = spy.declare_queryable("sutura/v1/sessions/*/edits").await.unwrap();

    session.simulate(&SimulationConfig::default()).await.unwrap();
    editor.edit(&soften(0)).await.unwrap();
    // The first edit was answered before it was published, and may be heard of now.
    let heard = async { while generations.next().await.unwrap().generation != 2 {} };
    tokio::time::timeout(PATIENCE, heard).await.unwrap();
    // By the time the third state has come, the spy would have heard of something.
    for _ in 0..3 {
        tokio::time::timeout(PATIENCE, states.next()).await.unwrap().unwrap();
    }
    editor.push_forces(&[Force { vertex: 0, force_n: [0.0; 3], duration_s: 0.1 }]).await.unwrap();
    tokio::time::timeout(PATIENCE, states.next()).await.unwrap().unwrap();
    for ear in &ears {
        assert!(ear.try_recv().unwrap().is_none(), "{} was heard", ear.key_expr());
    }
    assert!(asked.try_recv().unwrap().is_none(), "a question with its key came by");
    // Nor does it say anything in the daemon's name.
    let state = keys::tenant_session("a", session.id(), Resource::State).unwrap();
    spy.put(&state, vec![0; 8]).await.unwrap();
    for _ in 0..3 {
        // Whatever is no state would be an error here.
        tokio::time::timeout(PATIENCE, states.next()).await.unwrap().unwrap();
    }
    session.stop_simulation().await.unwrap();
    // Without a key, or with a wrong one, nobody joins.
    for credentials in [Credentials::default(), Credentials::of_key("sutura_00")] {
        assert!(ZenohClient::open_as(&daemon.zenoh, &credentials).await.is_err());
    }
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

#[tokio::test(flavor = "multi_thread")]
async fn damaged_keys_are_told_and_let_nobody_else_in() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("data");
    let known = key(&folder, "a", "edit");
    let path = scratch.path().join("log");
    let log = std::fs::File::create(&path).unwrap();
    let daemon = Daemon::start_logging(&folder, "warn", log.into());
    client(&daemon, &known).await;

    // While the daemon runs, the keys that it knows go on, and nothing else opens it.
    let keys = folder.join("keys.toml");
    let whole = std::fs::read_to_string(&keys).unwrap();
    std::fs::write(&keys, format!("{whole}\nthis is no key\n")).unwrap();
    let begun = Instant::now();
    while !std::fs::read_to_string(&path).unwrap().contains("those known go on") {
        assert!(begun.elapsed() < PATIENCE, "the damage went unnoticed");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    client(&daemon, &known).await.list(None, 10).await.unwrap();
    let wrong = client(&daemon, "sutura_wrong").await;
    assert_eq!(status(wrong.list(None, 10).await), Some(401));
    drop(daemon);

    // A start is refused, and names the place.
    let addresses = ["serve", "--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0"];
    let refused = sutura(&addresses, &folder);
    let told = String::from_utf8_lossy(&refused.stderr);
    let line = whole.lines().count() + 2;
    assert!(!refused.status.success(), "{told}");
    assert!(told.contains("keys.toml") && told.contains(&format!("line {line}")), "{told}");
    assert!(!told.contains(&known), "{told}");
    assert_eq!(std::fs::read_to_string(&keys).unwrap(), format!("{whole}\nthis is no key\n"));
}
