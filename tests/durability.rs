//! Daemons that are killed at any instant, and what the next one finds.

use crate::bodies::{bar, config, seam, stitch};
use crate::daemon::Daemon;
use crate::plain_http::plain_http;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use sutura_client::proto::session::SessionConfig;

/// How often daemons are killed, unless `SUTURA_KILLS` says otherwise.
const KILLS: usize = 12;

/// Longest life of a daemon before it is killed, its start not counted.
const LONGEST_LIFE_MS: u64 = 700;

/// Generations that a session keeps: so few that journals are compacted every few edits.
const N_KEPT: u64 = 2;

/// Sessions beyond which one is deleted for another.
const MOST_SESSIONS: usize = 4;

/// What has been acknowledged of a session.
#[derive(Clone, Debug, Default)]
struct Known {
    /// The current generation, once the session was ready.
    generation: Option<u64>,
    /// Answers about generations, by number, each with the size of the basis.
    evaluations: BTreeMap<u64, (u64, String)>,
    is_simulated: bool,
}

/// What has been acknowledged, and what was asked for last.
#[derive(Debug, Default)]
struct Acknowledged {
    sessions: BTreeMap<String, Known>,
    /// Asked for, not answered: it may have happened or not.
    pending: Option<Pending>,
    n_edits: usize,
    /// Kills that cut something off, by what it was.
    n_cut_off: BTreeMap<&'static str, usize>,
}

#[derive(Clone, Debug)]
enum Pending {
    Create,
    Fork,
    Edit(String),
    Delete(String),
    Simulate,
}

impl Pending {
    fn name(&self) -> &'static str {
        match self {
            Pending::Create => "create",
            Pending::Fork => "fork",
            Pending::Edit(_) => "edit",
            Pending::Delete(_) => "delete",
            Pending::Simulate => "simulate",
        }
    }
}

type Shared = Arc<Mutex<Acknowledged>>;

/// A client that knows its daemon may be gone any moment.
#[derive(Clone)]
struct Asker {
    http: reqwest::Client,
    base: String,
}

impl Asker {
    fn new(daemon: &Daemon) -> Asker {
        Asker { http: plain_http(), base: daemon.url("/v1/sessions") }
    }

    /// The answer's text; `None` if the daemon is gone. Anything but success is a failure of the test.
    async fn ask(
        &self,
        method: reqwest::Method,
        path: &str,
        body: Option<Value>,
    ) -> Option<String> {
        let request = self.http.request(method, format!("{}{path}", self.base));
        let request = match body {
            Some(body) => request.json(&body),
            None => request,
        };
        let response = request.send().await.ok()?;
        let status = response.status();
        let text = response.text().await.ok()?;
        assert!(status.is_success(), "{path}: {status} {text}");
        Some(text)
    }

    async fn document(
        &self,
        method: reqwest::Method,
        path: &str,
        body: Option<Value>,
    ) -> Option<Value> {
        Some(serde_json::from_str(&self.ask(method, path, body).await?).unwrap())
    }

    async fn info(&self, id: &str) -> Option<Value> {
        let info = self.document(reqwest::Method::GET, &format!("/{id}?wait_s=60"), None).await?;
        assert_eq!(info["state"], "ready", "{info}");
        Some(info)
    }

    /// Force and stiffness of a generation as they are written: every bit of them.
    async fn evaluate(&self, id: &str, generation: u64, size: u64) -> Option<String> {
        let q: Vec<f64> = (0..size).map(|i| 1e-3 / (1.0 + i as f64)).collect();
        let path = format!("/{id}/generations/{generation}/evaluate");
        self.ask(reqwest::Method::POST, &path, Some(json!({ "q": q }))).await
    }
}

fn session(random: &mut ChaCha8Rng) -> Value {
    let name = format!("bar {}", random.random_range(0..1000));
    let mut config = SessionConfig { mesh: Some(bar()), name: Some(name), ..config() };
    // Some bodies are alike and shared, some are not.
    config.n_modes = random.random_range(6..9);
    serde_json::to_value(&config).unwrap()
}

fn edit(random: &mut ChaCha8Rng) -> Value {
    let pairs: Vec<[u32; 2]> =
        seam().into_iter().filter(|_| random.random_range(0..3) > 0).collect();
    let mut request = serde_json::to_value(stitch(&pairs)).unwrap();
    let edits = request["edits"].as_array_mut().unwrap();
    edits.insert(0, json!({"unstitch_all": {}}));
    if random.random_range(0..4) == 0 {
        let factor = if random.random() { 2.0 } else { 0.5 };
        edits.push(json!({"scale_stiffness": {"domain": 2, "factor": factor}}));
    }
    request
}

/// Does one thing after another until the daemon is gone.
async fn work(asker: Asker, acknowledged: Shared, mut random: ChaCha8Rng) {
    while work_once(&asker, &acknowledged, &mut random).await.is_some() {}
}

async fn work_once(asker: &Asker, acknowledged: &Shared, random: &mut ChaCha8Rng) -> Option<()> {
    use reqwest::Method;
    let ids: Vec<String> = acknowledged.lock().unwrap().sessions.keys().cloned().collect();
    let begin = |pending: Pending| acknowledged.lock().unwrap().pending = Some(pending);
    let end = |change: &dyn Fn(&mut Acknowledged)| {
        let mut acknowledged = acknowledged.lock().unwrap();
        change(&mut acknowledged);
        acknowledged.pending = None;
    };
    let choice = random.random_range(0..10);
    if ids.is_empty() || (choice == 0 && ids.len() < MOST_SESSIONS) {
        begin(Pending::Create);
        let info = asker.document(Method::POST, "", Some(session(random))).await?;
        let id = info["id"].as_str()?.to_owned();
        end(&|a| drop(a.sessions.insert(id.clone(), Known::default())));
        return Some(());
    }
    let id = ids[random.random_range(0..ids.len())].clone();
    if choice == 1 && ids.len() > 1 {
        begin(Pending::Delete(id.clone()));
        asker.ask(Method::DELETE, &format!("/{id}"), None).await?;
        end(&|a| drop(a.sessions.remove(&id)));
        return Some(());
    }
    let info = asker.info(&id).await?;
    let number = info["generation"].as_u64()?;
    end(&|a| a.sessions.get_mut(&id).unwrap().generation = Some(number));
    let size = info["basis_size"].as_u64()?;
    let evaluation = asker.evaluate(&id, number, size).await?;
    end(&|a| {
        let known = a.sessions.get_mut(&id).unwrap();
        known.evaluations.insert(number, (size, evaluation.clone()));
    });
    match choice {
        2 if ids.len() < MOST_SESSIONS => {
            begin(Pending::Fork);
            let info = asker.document(Method::POST, &format!("/{id}/fork"), None).await?;
            let fork = info["id"].as_str()?.to_owned();
            end(&|a| {
                let known = Known { is_simulated: false, ..a.sessions[&id].clone() };
                a.sessions.insert(fork.clone(), known);
            });
        }
        3 => {
            begin(Pending::Simulate);
            let path = format!("/{id}/simulation");
            // Held at one end alone the bar has rigid motions once it is unstitched.
            if info["n_rigid_modes"] == 0 {
                asker.ask(Method::PUT, &path, Some(json!({"dt_s": 0.005}))).await?;
                end(&|a| a.sessions.get_mut(&id).unwrap().is_simulated = true);
            }
        }
        _ => {
            begin(Pending::Edit(id.clone()));
            let path = format!("/{id}/edits");
            let reply = asker.document(Method::POST, &path, Some(edit(random))).await?;
            let made = reply["generation"].as_u64()?;
            let is_held = reply["n_rigid_modes"] == 0;
            end(&|a| {
                a.n_edits += 1;
                let known = a.sessions.get_mut(&id).unwrap();
                known.generation = Some(made);
                // A body that is not held ends its simulation.
                known.is_simulated &= is_held;
            });
            let size = reply["basis_size"].as_u64()?;
            let evaluation = asker.evaluate(&id, made, size).await?;
            end(&|a| {
                let known = a.sessions.get_mut(&id).unwrap();
                known.evaluations.insert(made, (size, evaluation.clone()));
            });
        }
    }
    Some(())
}

/// Holds what a daemon has found against what was acknowledged.
async fn check(daemon: &Daemon, acknowledged: &Shared) {
    let asker = Asker::new(daemon);
    let list = asker.document(reqwest::Method::GET, "?limit=100", None).await.unwrap();
    let found: Vec<String> = list["sessions"]
        .as_array()
        .unwrap()
        .iter()
        .map(|info| info["id"].as_str().unwrap().to_owned())
        .collect();
    let (sessions, pending) = {
        let mut acknowledged = acknowledged.lock().unwrap();
        let pending = acknowledged.pending.take();
        if let Some(pending) = &pending {
            *acknowledged.n_cut_off.entry(pending.name()).or_default() += 1;
        }
        (acknowledged.sessions.clone(), pending)
    };
    // Beyond them there may be the one that was asked for.
    let others: Vec<&String> = found.iter().filter(|id| !sessions.contains_key(*id)).collect();
    let may_be_more = matches!(pending, Some(Pending::Create | Pending::Fork));
    assert!(others.len() <= usize::from(may_be_more), "{others:?} {pending:?}");
    for id in others {
        asker.ask(reqwest::Method::DELETE, &format!("/{id}"), None).await.unwrap();
    }
    for (id, known) in sessions {
        if !found.contains(&id) {
            assert!(matches!(&pending, Some(Pending::Delete(of)) if *of == id), "{id} is gone");
            acknowledged.lock().unwrap().sessions.remove(&id);
            continue;
        }
        let info = asker.info(&id).await.unwrap();
        let number = info["generation"].as_u64().unwrap();
        let has_pending_edit = matches!(&pending, Some(Pending::Edit(of)) if *of == id);
        if let Some(expected) = known.generation {
            let most = expected + u64::from(has_pending_edit);
            assert!((expected..=most).contains(&number), "{id}: {number}, not {expected}");
        }
        for (generation, (size, before)) in &known.evaluations {
            // Of the kept ones.
            if generation + N_KEPT > number {
                let now = asker.evaluate(&id, *generation, *size).await.unwrap();
                assert!(now == *before, "{id}, generation {generation} differs");
            }
        }
        if known.is_simulated && !has_pending_edit {
            let path = format!("/{id}/simulation");
            let simulation = asker.document(reqwest::Method::GET, &path, None).await.unwrap();
            assert_eq!(simulation["config"]["dt_s"], 0.005, "{simulation}");
        }
        let mut acknowledged = acknowledged.lock().unwrap();
        let known = acknowledged.sessions.get_mut(&id).unwrap();
        known.generation = Some(number);
        known.is_simulated &= !has_pending_edit;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_acknowledged_outlives_kill_9_at_any_instant() {
    let n_kills = std::env::var("SUTURA_KILLS").map_or(KILLS, |n| n.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("sutura.toml");
    // Bodies are written as soon as they are there, so that some are being written when the end comes.
    let text = format!("[work]\nn_kept_generations = {N_KEPT}\n[data]\nbodies_rest_s = 0.02\n");
    std::fs::write(&settings, text).unwrap();
    let data = folder.path().join("data");
    let start = || Daemon::start_with(&data, &["--config".as_ref(), settings.as_ref()]);
    let acknowledged = Shared::default();
    let mut random = ChaCha8Rng::seed_from_u64(20);
    for round in 0..n_kills as u64 {
        let daemon = start();
        let life = Duration::from_millis(random.random_range(0..LONGEST_LIFE_MS));
        // Every other one is killed while it still restores what it found.
        if round % 2 == 1 {
            tokio::time::sleep(life / 4).await;
            daemon.kill();
            continue;
        }
        check(&daemon, &acknowledged).await;
        let asker = Asker::new(&daemon);
        let random = ChaCha8Rng::seed_from_u64(round);
        let work = tokio::spawn(work(asker, acknowledged.clone(), random));
        tokio::time::sleep(life).await;
        daemon.kill();
        work.await.unwrap();
    }
    let daemon = start();
    check(&daemon, &acknowledged).await;
    assert!(daemon.terminate().success());
    let acknowledged = acknowledged.lock().unwrap();
    println!(
        "{n_kills} kills, {} edits acknowledged; cut off: {:?}",
        acknowledged.n_edits, acknowledged.n_cut_off
    );
    assert!(acknowledged.n_edits > 0);
}
