//! The life of a session through both doors, on a small real body.

use crate::bus::{self, BusConfig};
use crate::http::{self, tests::gateway};
use crate::{Gateway, Limits};
use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::{HeaderMap, Request, header};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::time::Duration;
use sutura_proto::array::Data;
use sutura_proto::edit::{Edit, EditMethod, EditReply, EditRequest};
use sutura_proto::event::GenerationInfo;
use sutura_proto::frame::Frame;
use sutura_proto::session::{SessionInfo, SessionList, SessionState};
use sutura_proto::simulation::{Force, ForceRequest, SimulationInfo};
use sutura_proto::state::StateFrame;
use sutura_proto::{media, npy};
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tower::ServiceExt;

/// Cells along each of the two bars, of 1 cm.
const LENGTH: u32 = 3;
/// Vertices of one bar.
const N_BAR: u32 = 4 * (LENGTH + 1);
/// Long enough for any machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// Two bars of 3 × 1 × 1 cells, end to end. Their ends coincide but are not joined.
fn bars() -> Value {
    let vertex = |bar, [x, y, z]: [u32; 3]| bar * N_BAR + 4 * x + 2 * y + z;
    let (mut vertices, mut tets) = (Vec::new(), Vec::new());
    for bar in 0..2 {
        for x in 0..=LENGTH {
            for (y, z) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                vertices.push([x + bar * LENGTH, y, z].map(|n| f64::from(n) * 0.01));
            }
        }
        for x in 0..LENGTH {
            // Kuhn's subdivision: one tet for each order in which the three axes can be walked.
            for (axes, is_odd) in [
                ([0, 1, 2], false),
                ([1, 2, 0], false),
                ([2, 0, 1], false),
                ([0, 2, 1], true),
                ([2, 1, 0], true),
                ([1, 0, 2], true),
            ] {
                let mut at = [x, 0, 0];
                let mut tet = [vertex(bar, at); 4];
                for (step, axis) in axes.into_iter().enumerate() {
                    at[axis] += 1;
                    tet[step + 1] = vertex(bar, at);
                }
                if is_odd {
                    tet.swap(2, 3);
                }
                tets.push(tet);
            }
        }
    }
    json!({
        "name": "bars",
        "mesh": {"vertices": vertices, "tets": tets},
        "material": {"law": "stvk", "young_modulus_pa": 1e5, "poisson_ratio": 0.3,
                     "density_kg_m3": 1000},
        "fixed_vertices": [0, 1, 2, 3],
        "n_modes": 6,
        "basis": {"size": 16, "n_derivative_modes": 3},
        "cubature": {"n_points": 24, "n_training_poses": 20, "tolerance": 0.05, "seed": 1},
    })
}

/// The pairs where the bars meet.
fn seam() -> Vec<[u32; 2]> {
    (0..4).map(|i| [N_BAR - 4 + i, N_BAR + i]).collect()
}

fn stitch(pairs: &[[u32; 2]]) -> EditRequest {
    EditRequest::new(vec![Edit::Stitch { pairs: pairs.to_vec(), stiffness_n_m: 1e4 }])
}

/// An array of u32.
fn numbers(frame: &mut Frame<'_>, name: &str) -> Vec<u32> {
    let Data::U32(numbers) = frame.take(name).unwrap().data else { panic!("{name} is not u32") };
    numbers.into_owned()
}

/// Names of blocks, in decimal, from the halves that travel.
fn block_names(frame: &mut Frame<'_>, name: &str) -> Vec<String> {
    let halves = numbers(frame, name);
    let halves = halves.chunks(2).map(|half| u64::from(half[0]) + (u64::from(half[1]) << 32));
    halves.map(|id| id.to_string()).collect()
}

fn f64s<'a>(data: &'a Data<'_>) -> &'a [f64] {
    let Data::F64(elements) = data else { panic!("not f64") };
    elements
}

struct Door {
    router: Router,
    gateway: Gateway,
}

impl Door {
    fn new() -> Door {
        let gateway = gateway(Limits::default());
        Door { router: http::router(gateway.clone()), gateway }
    }

    async fn bytes(&self, request: Request<Body>, status: u16) -> (HeaderMap, Vec<u8>) {
        let response = self.router.clone().oneshot(request).await.unwrap();
        let (parts, body) = response.into_parts();
        let body = to_bytes(body, 1 << 26).await.unwrap().to_vec();
        assert_eq!(parts.status.as_u16(), status, "{}", String::from_utf8_lossy(&body));
        (parts.headers, body)
    }

    async fn get<T: DeserializeOwned>(&self, path: &str) -> T {
        let (_, body) = self.bytes(Request::get(path).body(Body::empty()).unwrap(), 200).await;
        serde_json::from_slice(&body).unwrap()
    }

    async fn call(&self, method: &str, path: &str, document: Value, status: u16) -> Vec<u8> {
        let body = match &document {
            Value::Null => Body::empty(),
            document => Body::from(document.to_string()),
        };
        let request = Request::builder().method(method).uri(path);
        let request = request.header(header::CONTENT_TYPE, media::JSON).body(body).unwrap();
        self.bytes(request, status).await.1
    }

    async fn ready(&self) -> String {
        let reply = self.call("POST", "/v1/sessions?wait_s=120", bars(), 202).await;
        let info: SessionInfo = serde_json::from_slice(&reply).unwrap();
        assert_eq!((info.state, info.error), (SessionState::Ready, None));
        format!("/v1/sessions/{}", info.id)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_is_opened_listed_edited_forked_and_ended() {
    let door = Door::new();
    let session = door.ready().await;
    let info: SessionInfo = door.get(&session).await;
    assert_eq!((info.n_vertices, info.n_tets), (2 * N_BAR as usize, 2 * 6 * LENGTH as usize));
    assert_eq!((info.n_components, info.n_rigid_modes, info.n_modes), (2, 6, 6));
    assert_eq!(info.frequencies_hz.len(), 6);
    assert_eq!(info.parameters.as_ref().unwrap().basis.size, 16);
    let list: SessionList = door.get("/v1/sessions").await;
    assert_eq!((list.sessions, list.next), (vec![info], None));

    let edits = format!("{session}/edits");
    let reply = door.call("POST", &edits, json!(stitch(&seam())), 200).await;
    let reply: EditReply = serde_json::from_slice(&reply).unwrap();
    assert_eq!((reply.generation, reply.n_stitches, reply.n_rigid_modes), (1, 4, 0));
    assert_eq!((reply.stitch_ids.len(), reply.residuals.len()), (4, 6));
    assert!(reply.timings_ms.total > 0.0);
    let problem = door.call("POST", &edits, json!(stitch(&seam()[..1])), 422).await;
    let problem: Value = serde_json::from_slice(&problem).unwrap();
    assert_eq!(problem["instance_pointer"], "/edits/0/stitch/pairs/0");
    let stale = EditRequest { base_generation: Some(0), ..stitch(&seam()) };
    door.call("POST", &edits, json!(stale), 409).await;

    let fork = door.call("POST", &format!("{session}/fork"), json!({"name": "fork"}), 201).await;
    let fork: SessionInfo = serde_json::from_slice(&fork).unwrap();
    assert_eq!((fork.name.as_deref(), fork.generation, fork.n_stitches), (Some("fork"), 1, 4));
    door.call("POST", &format!("{session}/fork"), Value::Null, 201).await;
    let page: SessionList = door.get("/v1/sessions?limit=2").await;
    let next = page.next.unwrap();
    let rest: SessionList = door.get(&format!("/v1/sessions?limit=2&after={next}")).await;
    assert_eq!((page.sessions.len(), rest.sessions.len(), rest.next), (2, 1, None));

    door.call("DELETE", &session, Value::Null, 204).await;
    door.call("DELETE", &session, Value::Null, 404).await;
    door.call("POST", &edits, json!(stitch(&seam())), 404).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_edit_whose_client_hangs_up_is_cancelled() {
    let door = Door::new();
    // Training takes long enough for the client to leave in the middle of it.
    let mut document = bars();
    document["cubature"]["n_training_poses"] = json!(2000);
    let reply = door.call("POST", "/v1/sessions?wait_s=120", document, 202).await;
    let id = serde_json::from_slice::<SessionInfo>(&reply).unwrap().id.parse().unwrap();
    let store = door.gateway.store().clone();
    let reaches = async |state| {
        let reached = async {
            while store.info(id).unwrap().state != state {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        tokio::time::timeout(PATIENCE, reached).await.unwrap();
    };
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let stopping = async move { drop(stopped.await) };
    let served = tokio::spawn(http::serve(door.gateway.clone(), listener, None, stopping));

    let edit =
        json!(EditRequest { method: EditMethod::FromScratch, ..stitch(&seam()) }).to_string();
    let mut client = TcpStream::connect(address).await.unwrap();
    let head = format!(
        "POST /v1/sessions/{id}/edits HTTP/1.1\r\nhost: {address}\r\n\
         content-type: application/json\r\ncontent-length: {}\r\n\r\n{edit}",
        edit.len()
    );
    client.write_all(head.as_bytes()).await.unwrap();
    reaches(sutura_store::SessionState::Rebuilding).await;
    drop(client);
    reaches(sutura_store::SessionState::Ready).await;
    let info = store.info(id).unwrap();
    assert_eq!(info.generation.unwrap().number, 0);

    stop.send(()).unwrap();
    tokio::time::timeout(PATIENCE, served).await.unwrap().unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn arrays_and_evaluations_agree_in_every_form() {
    let door = Door::new();
    let session = door.ready().await;
    let r_old = door.get::<SessionInfo>(&session).await.basis_size;
    door.call("POST", &format!("{session}/edits"), json!(stitch(&seam())), 200).await;
    let fetch = async |rest: &str, accept: &str| {
        let path = format!("{session}/generations/{rest}");
        let request = Request::get(path).header(header::ACCEPT, accept);
        let (headers, bytes) = door.bytes(request.body(Body::empty()).unwrap(), 200).await;
        assert_eq!(headers[header::CONTENT_TYPE], accept);
        bytes
    };
    let bytes = fetch("current/basis?dtype=f64", media::NPY).await;
    let basis = npy::decode("basis", &bytes).unwrap();
    let [r, n_vertices, 3] = basis.shape[..] else { panic!("{:?}", basis.shape) };
    assert_eq!(n_vertices, 2 * N_BAR as usize);
    let bytes = fetch("1/basis?dtype=f64", media::FRAME).await;
    let mut frame = Frame::decode(&bytes).unwrap();
    assert_eq!((frame.generation, frame.take("basis").unwrap().data), (1, basis.data.clone()));
    for (rest, shape) in [
        ("1/modes", vec![6, n_vertices, 3]),
        ("1/mass", vec![n_vertices]),
        ("1/positions", vec![n_vertices, 3]),
        ("1/transfer", vec![r, r_old]),
        ("0/transfer?from=1", vec![r_old, r]),
    ] {
        let bytes = fetch(rest, media::NPY).await;
        assert_eq!(npy::decode("", &bytes).unwrap().shape, shape, "{rest}");
    }
    let bytes = fetch("1/delta?have=0", media::FRAME).await;
    let mut delta = Frame::decode(&bytes).unwrap();
    let n_columns = delta.take("columns").unwrap().shape[0];
    assert_eq!(delta.take("w").unwrap().shape, [r_old + n_columns, r]);
    let bytes = fetch("1/combination?dtype=f64", media::FRAME).await;
    let mut combination = Frame::decode(&bytes).unwrap();
    assert_eq!(numbers(&mut combination, "n_vertices"), [n_vertices as u32]);
    let sizes = numbers(&mut combination, "block_sizes");
    let blocks: Vec<String> = block_names(&mut combination, "blocks");
    assert_eq!(blocks.len(), sizes.len());
    let path = format!("1/dictionary?dtype=f64&blocks={}", blocks.join(","));
    let bytes = fetch(&path, media::FRAME).await;
    let mut dictionary = Frame::decode(&bytes).unwrap();
    let dictionary = dictionary.take("dictionary").unwrap();
    let n_columns = sizes.iter().sum::<u32>() as usize;
    assert_eq!(dictionary.shape, [n_columns, n_vertices, 3]);
    let bytes = fetch(&path, media::NPY).await;
    assert_eq!(npy::decode("", &bytes).unwrap().data, dictionary.data);
    // D·W is the basis.
    let used = numbers(&mut combination, "columns");
    let w = combination.take("w").unwrap();
    assert_eq!(w.shape, [used.len(), r]);
    let [columns, w, basis] = [&dictionary.data, &w.data, &basis.data].map(f64s);
    for (at, expected) in basis.iter().enumerate() {
        let (j, at) = (at / (3 * n_vertices), at % (3 * n_vertices));
        let terms = used.iter().enumerate();
        let sum: f64 =
            terms.map(|(row, &i)| columns[3 * n_vertices * i as usize + at] * w[row * r + j]).sum();
        assert!((sum - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{sum} {expected}");
    }
    // The same block by itself; what nobody has; what is no list of names.
    let bytes = fetch(&format!("1/dictionary?blocks={}", blocks[0]), media::NPY).await;
    assert_eq!(npy::decode("", &bytes).unwrap().shape, [sizes[0] as usize, n_vertices, 3]);
    let beyond = format!("{},{}", blocks[0], u64::MAX);
    for (query, status) in [
        (format!("dictionary?blocks={beyond}"), 404),
        ("dictionary".to_owned(), 400),
        ("dictionary?blocks=x".to_owned(), 400),
        ("basis?blocks=1".to_owned(), 400),
        ("dictionary?blocks=1&have=0".to_owned(), 400),
    ] {
        let path = format!("{session}/generations/1/{query}");
        let problem = door.call("GET", &path, Value::Null, status).await;
        let problem: Value = serde_json::from_slice(&problem).unwrap();
        if status == 404 {
            assert!(problem["detail"].as_str().unwrap().contains(&u64::MAX.to_string()));
        }
    }
    // Blocks of another session are not there, its body being another.
    let mut other = bars();
    other["n_modes"] = json!(5);
    let reply = door.call("POST", "/v1/sessions?wait_s=120", other, 202).await;
    let other = serde_json::from_slice::<SessionInfo>(&reply).unwrap().id;
    let path = format!("/v1/sessions/{other}/generations/0/dictionary?blocks={}", blocks[0]);
    door.call("GET", &path, Value::Null, 404).await;
    let bytes = fetch("1/evaluator", media::FRAME).await;
    assert_eq!(Frame::decode(&bytes).unwrap().take("stitch_stiffness").unwrap().shape, [r, r]);
    let path = format!("{session}/generations/0/transfer");
    door.call("GET", &path, Value::Null, 404).await;

    let evaluate = format!("{session}/evaluate");
    let zero = json!({"q": vec![0.0; r]});
    let at_rest: Value =
        serde_json::from_slice(&door.call("POST", &evaluate, zero, 200).await).unwrap();
    assert_eq!(at_rest["energy_j"], 0.0);
    assert_eq!(at_rest["stiffness"].as_array().unwrap().len(), r);
    let batch = json!({"q": [vec![0.0; r], vec![1e-4; r]], "exact": true});
    let batch: Value =
        serde_json::from_slice(&door.call("POST", &evaluate, batch, 200).await).unwrap();
    assert!(batch["evaluations"][1]["energy_j"].as_f64().unwrap() > 0.0);
    for (q, pointer) in [(json!([1.0]), "/q"), (json!([vec![0.0; r], [1.0]]), "/q/1")] {
        let problem = door.call("POST", &evaluate, json!({"q": q}), 422).await;
        let problem: Value = serde_json::from_slice(&problem).unwrap();
        assert_eq!(problem["instance_pointer"], pointer);
    }
    let problem = door.call("POST", &evaluate, json!({"q": vec![1e200; r]}), 422).await;
    assert!(String::from_utf8(problem).unwrap().contains("overflow"));
}

#[tokio::test(flavor = "multi_thread")]
async fn zenoh_edits_follows_and_moves_what_http_opened() {
    let door = Door::new();
    let session = door.ready().await;
    let id = session.rsplit('/').next().unwrap();
    let bus = bus::open(&door.gateway, BusConfig::loopback(0, "d0")).await.unwrap();
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", r#""client""#.to_owned()),
        ("connect/endpoints", format!("[{:?}]", bus.endpoint())),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    let client = zenoh::open(config).await.unwrap();
    let key = |resource: &str| format!("sutura/v1/sessions/{id}/{resource}");
    let ask = async |selector: String, payload: Vec<u8>| {
        let get = client.get(selector).payload(payload).encoding(media::BINCODE);
        let reply = get.timeout(PATIENCE).await.unwrap().recv_async().await.unwrap();
        let sample = reply.into_result().unwrap();
        (sample.encoding().to_string(), sample.payload().to_bytes().into_owned())
    };

    let generations = client.declare_subscriber(key("generation")).await.unwrap();
    let states = client.declare_subscriber(key("state")).await.unwrap();
    let request = sutura_proto::bus::encode(&stitch(&seam())).unwrap();
    let (encoding, reply) = ask(key("edits"), request).await;
    let reply: EditReply = sutura_proto::bus::decode(&reply).unwrap();
    assert_eq!((encoding.as_str(), reply.generation), (media::BINCODE, 1));
    let announced = generations.recv_async().await.unwrap();
    let announced: GenerationInfo =
        serde_json::from_slice(&announced.payload().to_bytes()).unwrap();
    assert_eq!((announced.generation, announced.n_stitches), (1, 4));

    let (_, found) = ask("sutura/v1/sessions/*/info".to_owned(), Vec::new()).await;
    let found: SessionInfo = serde_json::from_slice(&found).unwrap();
    assert_eq!((found.id.as_str(), found.generation), (id, 1));
    let (encoding, basis) = ask(key("basis?generation=0;dtype=f64"), Vec::new()).await;
    assert_eq!(encoding, media::FRAME);
    assert_eq!(Frame::decode(&basis).unwrap().generation, 0);
    let (encoding, combination) = ask(key("combination?generation=0"), Vec::new()).await;
    let mut combination = Frame::decode(&combination).unwrap();
    assert_eq!((encoding.as_str(), combination.generation), (media::FRAME, 0));
    let blocks = block_names(&mut combination, "blocks").join(",");
    let selector = format!("dictionary?generation=0;dtype=f64;blocks={blocks}");
    let (_, dictionary) = ask(key(&selector), Vec::new()).await;
    // A basis that shares nothing is its own block.
    let basis = Frame::decode(&basis).unwrap().take("basis").unwrap().data;
    let mut dictionary = Frame::decode(&dictionary).unwrap();
    assert_eq!(dictionary.take("dictionary").unwrap().data.bytes(), basis.bytes());

    // States flow although no HTTP stream is open.
    let simulation = format!("{session}/simulation");
    let config = json!({"dt_s": 0.005, "gravity_m_s2": [0, 0, 0], "publish_hz": 200});
    door.call("PUT", &simulation, config, 200).await;
    let state = states.recv_async().await.unwrap();
    assert_eq!(state.encoding().to_string(), media::STATE);
    let state = StateFrame::decode(&state.payload().to_bytes()).unwrap();
    assert_eq!((state.generation, state.q.len()), (1, reply.basis_size));

    let pull = Force { vertex: 2 * N_BAR - 1, force_n: [0.0, 0.0, 1e-3], duration_s: 60.0 };
    let forces = sutura_proto::bus::encode(&ForceRequest { forces: vec![pull] }).unwrap();
    client.put(key("forces"), forces).encoding(media::BINCODE).await.unwrap();
    let moved = async {
        loop {
            let state = states.recv_async().await.unwrap();
            let state = StateFrame::decode(&state.payload().to_bytes()).unwrap();
            if state.q.iter().any(|q| *q != 0.0) {
                return;
            }
        }
    };
    tokio::time::timeout(PATIENCE, moved).await.unwrap();
    let info: SimulationInfo = door.get(&simulation).await;
    assert_eq!((info.n_forces, info.generation), (1, 1));
    door.call("DELETE", &simulation, Value::Null, 204).await;
    door.call("GET", &simulation, Value::Null, 404).await;

    client.close().await.unwrap();
    bus.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn events_begin_with_the_state_and_end_with_the_session() {
    let door = Door::new();
    let session = door.ready().await;
    let request = Request::get(format!("{session}/events")).body(Body::empty()).unwrap();
    let response = door.router.clone().oneshot(request).await.unwrap();
    assert_eq!(response.headers()[header::CONTENT_TYPE], media::EVENT_STREAM);
    door.call("POST", &format!("{session}/edits"), json!(stitch(&seam())), 200).await;
    door.call("DELETE", &session, Value::Null, 204).await;
    let text = tokio::time::timeout(PATIENCE, to_bytes(response.into_body(), 1 << 20)).await;
    let text = String::from_utf8(text.unwrap().unwrap().to_vec()).unwrap();
    let names: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("event: ")).collect();
    assert_eq!((names[0], names[names.len() - 1]), ("state", "deleted"), "{text}");
    assert!(names.contains(&"generation") || names.contains(&"stage"), "{text}");
}
