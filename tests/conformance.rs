//! The cases that every client is held to: `tests/data/conformance`.

use crate::bodies::prepared;
use crate::daemon::Daemon;
use crate::plain_http::plain_http;
use reqwest::header::ACCEPT;
use serde::Deserialize;
use serde_json::Value;
use sutura_client::proto::edit::EditRequest;
use sutura_client::proto::evaluate::{Coordinates, EvaluateReply, EvaluateRequest};
use sutura_client::proto::media;
use sutura_client::proto::session::{MeshConfig, SessionConfig};
use sutura_client::{Array, Arrays, Basis, Error, Generation, Scalar, Session, Transfer};

#[derive(Deserialize)]
struct Case {
    name: String,
    config: SessionConfig,
    steps: Vec<Step>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Step {
    Info { info: Value },
    Prepared { prepared: usize },
    Made { edit: EditRequest, reply: Value },
    Refused { edit: EditRequest, problem: Value },
    Array { array: String, generation: u64, dtype: String, from: Option<u64> },
    Stitches { stitches: u64, ids: Vec<u64>, pairs: Vec<[u32; 2]> },
    Evaluate { evaluate: u64, q: Vec<f64> },
}

/// What was received: its name, and its numbers as little-endian bytes.
fn entry(name: &str, bytes: &[u8]) -> Vec<u8> {
    [name.as_bytes(), b"\n", bytes, b"\n"].concat()
}

fn doubles<'a>(values: impl IntoIterator<Item = &'a f64>) -> Vec<u8> {
    values.into_iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn assert_has(found: &Value, expected: &Value, place: &str) {
    for (name, value) in expected.as_object().unwrap() {
        if value.is_object() {
            assert_has(&found[name], value, place);
        } else {
            assert_eq!(&found[name], value, "{place}: {name}");
        }
    }
}

/// An array as it came: its shape, and its elements in little-endian form.
type Received = (Vec<usize>, Vec<u8>);

async fn array<T: Scalar>(
    session: &Session,
    name: &str,
    generation: Generation,
    from: Option<u64>,
    bytes: fn(&[T]) -> Vec<u8>,
) -> Received {
    let plain = |array: Array<T>| (array.shape, bytes(&array.data));
    match name {
        "modes" => plain(session.modes(generation).await.unwrap()),
        "mass" => plain(session.mass(generation).await.unwrap()),
        "frequencies_hz" => plain(session.frequencies_hz(generation).await.unwrap()),
        "positions" => plain(session.positions(generation).await.unwrap()),
        "transfer" => {
            let transfer: Transfer<T> = session.transfer(generation, from.unwrap()).await.unwrap();
            plain(transfer.matrix)
        }
        "basis" => {
            let basis: Basis<T> = session.basis(generation).await.unwrap();
            let columns: Vec<T> =
                (0..basis.size()).flat_map(|i| basis.column(i).to_vec()).collect();
            (vec![basis.size(), basis.n_vertices(), 3], bytes(&columns))
        }
        _ => panic!("no array {name}"),
    }
}

async fn fetch(
    session: &Session,
    name: &str,
    generation: u64,
    dtype: &str,
    from: Option<u64>,
) -> Received {
    let generation = Generation::from(generation);
    match dtype {
        "f32" => {
            let bytes = |x: &[f32]| x.iter().flat_map(|x| x.to_le_bytes()).collect();
            array::<f32>(session, name, generation, from, bytes).await
        }
        "f64" => array::<f64>(session, name, generation, from, |x| doubles(x)).await,
        _ => {
            let tets = session.tets(generation).await.unwrap();
            let bytes = tets.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
            (vec![tets.len(), 4], bytes)
        }
    }
}

/// The `.npy` file of the same array.
async fn npy(daemon: &Daemon, path: &str, dtype: &str, from: Option<u64>) -> Vec<u8> {
    let from = from.map(|from| format!("&from={from}")).unwrap_or_default();
    let query = if dtype == "u32" { String::new() } else { format!("?dtype={dtype}{from}") };
    let request = plain_http().get(daemon.url(&format!("{path}{query}")));
    let reply = request.header(ACCEPT, media::NPY).send().await.unwrap();
    assert!(reply.status().is_success(), "{path}: {}", reply.status());
    reply.bytes().await.unwrap().to_vec()
}

/// Takes a step; what was received.
async fn take(daemon: &Daemon, session: &Session, step: &Step, place: &str) -> Vec<u8> {
    match step {
        Step::Info { info } => {
            let found = serde_json::to_value(session.info().await.unwrap()).unwrap();
            assert_has(&found, info, place);
            Vec::new()
        }
        Step::Prepared { prepared: count } => {
            prepared(session, *count).await;
            Vec::new()
        }
        Step::Made { edit, reply } => {
            let found = session.edit(edit).await.unwrap();
            assert_has(&serde_json::to_value(&found).unwrap(), reply, place);
            entry("frequencies", &doubles(&found.frequencies_hz))
        }
        Step::Refused { edit, problem } => {
            let Err(Error::Problem(found)) = session.edit(edit).await else {
                panic!("{place}: not refused");
            };
            let found = serde_json::to_value(&*found).unwrap();
            assert_has(&found, problem, place);
            Vec::new()
        }
        Step::Array { array: name, generation, dtype, from } => {
            let (shape, bytes) = fetch(session, name, *generation, dtype, *from).await;
            let path = format!("/v1/sessions/{}/generations/{generation}/{name}", session.id());
            let file = npy(daemon, &path, dtype, *from).await;
            assert!(!bytes.is_empty() && file.ends_with(&bytes), "{place}");
            entry(&format!("{name} {shape:?}"), &bytes)
        }
        Step::Stitches { stitches, ids, pairs } => {
            let found = session.stitches(Generation::from(*stitches)).await.unwrap();
            assert_eq!(&found.iter().map(|stitch| stitch.id).collect::<Vec<_>>(), ids, "{place}");
            assert_eq!(&found.iter().map(|s| s.pair).collect::<Vec<_>>(), pairs, "{place}");
            Vec::new()
        }
        Step::Evaluate { evaluate, q } => {
            let request = EvaluateRequest { q: Coordinates::Single(q.clone()), exact: false };
            let reply = session.evaluate(Generation::from(*evaluate), &request).await.unwrap();
            let EvaluateReply::Single(found) = reply else { panic!("{place}: a batch") };
            let stiffness = found.stiffness.iter().flatten();
            let numbers = [&found.energy_j].into_iter().chain(&found.force).chain(stiffness);
            entry("evaluation", &doubles(numbers))
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_cases_of_every_client() {
    let mesh: MeshConfig = serde_json::from_str(include_str!("data/conformance/bar.json")).unwrap();
    let cases: Vec<Case> =
        serde_json::from_str(include_str!("data/conformance/cases.json")).unwrap();
    let daemon = Daemon::start();
    let mut received = Vec::new();
    for (number, case) in cases.iter().enumerate() {
        let config = SessionConfig { mesh: Some(mesh.clone()), ..case.config.clone() };
        let session = daemon.client().await.create(&config).await.unwrap();
        session.wait_ready(|_| {}).await.unwrap();
        for (at, step) in case.steps.iter().enumerate() {
            let place = format!("{}, step {at}", case.name);
            received.extend(format!("{number}.{at} ").into_bytes());
            received.extend(take(&daemon, &session, step, &place).await);
        }
        session.delete().await.unwrap();
    }
    assert!(received.len() > 1_000_000);
    if let Some(folder) = std::env::var_os("SUTURA_CONFORMANCE") {
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(std::path::Path::new(&folder).join("rust"), received).unwrap();
    }
}
