//! The router against a real store: every route that the description names, and what happens to
//! requests that cannot be served.

use super::openapi::document as openapi_document;
use super::{router, router::paths};
use crate::{Gateway, Limits, metrics};
use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::{Method, Request, StatusCode, header};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::sync::OnceLock;
use sutura_proto::media;
use sutura_store::{Store, StoreConfig};
use tower::ServiceExt;

/// The process-wide recorder, installed by whichever test comes first.
pub(crate) fn recorder() -> metrics_exporter_prometheus::PrometheusHandle {
    static RECORDER: OnceLock<metrics_exporter_prometheus::PrometheusHandle> = OnceLock::new();
    RECORDER.get_or_init(|| metrics::install_recorder().unwrap()).clone()
}

pub(crate) fn gateway(limits: Limits) -> Gateway {
    Gateway::new(Store::new(StoreConfig::default()).unwrap(), limits, recorder())
}

fn app() -> Router {
    router(gateway(Limits::default()))
}

struct Reply {
    status: u16,
    headers: axum::http::HeaderMap,
    body: Vec<u8>,
}

impl Reply {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap()
    }

    /// The problem document, after checking what holds for all of them.
    fn problem(&self) -> Value {
        assert_eq!(self.headers[header::CONTENT_TYPE], media::PROBLEM_JSON);
        let problem = self.json();
        assert_eq!(problem["status"], self.status);
        assert!(problem["type"].as_str().unwrap().starts_with("urn:sutura:problem:"));
        problem
    }
}

async fn send(app: &Router, request: Request<Body>) -> Reply {
    let response = app.clone().oneshot(request).await.unwrap();
    let (parts, body) = response.into_parts();
    assert!(parts.headers.contains_key("x-request-id"), "{parts:?}");
    let body = to_bytes(body, 1 << 26).await.unwrap().to_vec();
    Reply { status: parts.status.as_u16(), headers: parts.headers, body }
}

async fn call(app: &Router, method: Method, path: &str, document: Value) -> Reply {
    let request = Request::builder()
        .method(method)
        .uri(path)
        .header(header::CONTENT_TYPE, media::JSON)
        .body(Body::from(document.to_string()))
        .unwrap();
    send(app, request).await
}

async fn get(app: &Router, path: &str) -> Reply {
    send(app, Request::get(path).body(Body::empty()).unwrap()).await
}

/// A path of the router as a request has it.
fn concrete(path: &str) -> String {
    path.replace("{id}", UNKNOWN).replace("{generation}", "current")
}

const UNKNOWN: &str = "0192f0c1aaaa7bbb8ccc0123456789ab";

#[tokio::test]
async fn the_description_lists_exactly_the_routes_there_are() {
    let document = serde_json::to_value(openapi_document()).unwrap();
    let described = document["paths"].as_object().unwrap();
    let described_paths: BTreeSet<&str> = described.keys().map(String::as_str).collect();
    assert_eq!(described_paths, paths().into_iter().collect());

    let app = app();
    for (path, operations) in described {
        let request = Request::options(concrete(path)).body(Body::empty()).unwrap();
        let reply = send(&app, request).await;
        assert_eq!(reply.status, 405, "{path}");
        reply.problem();
        let allowed: BTreeSet<String> = reply.headers[header::ALLOW]
            .to_str()
            .unwrap()
            .split(',')
            .filter(|method| *method != "HEAD")
            .map(str::to_lowercase)
            .collect();
        let described: BTreeSet<String> = operations.as_object().unwrap().keys().cloned().collect();
        assert_eq!(allowed, described, "{path}");
    }
}

#[tokio::test]
async fn the_description_is_served_whole() {
    let document = get(&app(), "/openapi.json").await.json();
    let text = document.to_string();
    for reference in text.split("\"#/components/schemas/").skip(1) {
        let name = reference.split('"').next().unwrap();
        assert!(document["components"]["schemas"][name].is_object(), "{name} is not described");
    }
    for (path, operations) in document["paths"].as_object().unwrap() {
        for (method, operation) in operations.as_object().unwrap() {
            let responses = operation["responses"].as_object().unwrap();
            assert!(responses.len() > usize::from(path.starts_with("/v1")), "{method} {path}");
        }
    }
}

#[tokio::test]
async fn whoever_comes_too_often_is_told_when_to_come_again() {
    let limits = Limits { max_requests_per_s: 0.01, max_request_burst: 2, ..Limits::default() };
    let app = router(gateway(limits));
    for _ in 0..2 {
        assert_eq!(get(&app, "/v1/sessions").await.status, 200);
    }
    let refused = get(&app, "/v1/sessions").await;
    assert_eq!(refused.problem()["type"], "urn:sutura:problem:too-often");
    assert_eq!(refused.status, 429);
    let retry_after: u64 = refused.headers[header::RETRY_AFTER].to_str().unwrap().parse().unwrap();
    assert!((1..=100).contains(&retry_after), "{retry_after}");
    // Whether the daemon is well can always be asked.
    assert_eq!(get(&app, "/healthz").await.status, 200);
}

#[tokio::test]
async fn unknown_paths_and_sessions_are_problems() {
    let app = app();
    assert_eq!(get(&app, "/v2/nothing").await.problem()["title"], "No such path");
    for path in paths().into_iter().filter(|path| path.contains("{id}")) {
        for id in ["nonsense", "%00", "..%2f..", UNKNOWN] {
            let path = path.replace("{id}", id).replace("{generation}", "current");
            let reply = get(&app, &path).await;
            // Paths without GET answer 405; the stream wants an upgrade before it looks.
            assert!([404, 405, 400, 426].contains(&reply.status), "{path}: {}", reply.status);
            reply.problem();
        }
    }
}

#[tokio::test]
async fn operations_answer() {
    let gateway = gateway(Limits::default());
    let app = router(gateway.clone());
    assert_eq!(get(&app, "/healthz").await.status, 200);
    assert_eq!(get(&app, "/readyz").await.status, 200);
    assert!(String::from_utf8(get(&app, "/").await.body).unwrap().contains("/openapi.json"));
    let metrics = String::from_utf8(get(&app, "/metrics").await.body).unwrap();
    assert!(metrics.contains("sutura_http_request_seconds_bucket"), "{metrics}");
    gateway.wind_down();
    let reply = get(&app, "/readyz").await;
    assert_eq!(reply.problem()["status"], 503);
    assert!(reply.headers.contains_key(header::RETRY_AFTER));
}

#[tokio::test]
async fn request_ids_are_kept_if_usable_and_made_otherwise() {
    let app = app();
    for (given, kept) in [("my-id_7.x", true), ("with space", false), ("", false), ("a;b", false)] {
        let request = Request::get("/healthz").header("x-request-id", given);
        let reply = send(&app, request.body(Body::empty()).unwrap()).await;
        let found = reply.headers["x-request-id"].to_str().unwrap();
        assert_eq!(found == given, kept, "{given:?} became {found:?}");
        assert!(!found.is_empty());
    }
}

#[tokio::test]
async fn pages_of_other_sites_may_not_change_anything() {
    let request = Request::post("/v1/sessions")
        .header("sec-fetch-site", "cross-site")
        .header(header::CONTENT_TYPE, media::JSON)
        .body(Body::from("{}"))
        .unwrap();
    assert_eq!(send(&app(), request).await.problem()["status"], 403);
}

fn tetrahedron() -> Value {
    json!({
        "material": {"law": "stvk", "young_modulus_pa": 5e5, "poisson_ratio": 0.4,
                     "density_kg_m3": 1000},
        "mesh": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "tets": [[0, 1, 2, 3]]},
    })
}

#[tokio::test]
async fn sessions_that_cannot_be_are_refused_in_their_place() {
    let app = app();
    let cases: [(&str, Value, u16); 6] = [
        ("/mesh/tets/0/3", json!(9), 422),
        ("/mesh/tets/0", json!([1, 0, 2, 3]), 422),
        ("/mesh/vertices/2/1", json!("nan"), 400),
        ("/mesh/vertices/2/1", json!(null), 400),
        ("/material/young_modulus_pa", json!(-1), 422),
        ("/material/law", json!("rubber"), 400),
    ];
    for (place, value, status) in cases {
        let mut document = tetrahedron();
        *document.pointer_mut(place).unwrap() = value;
        let reply = call(&app, Method::POST, "/v1/sessions", document).await;
        assert_eq!(reply.status, status, "{place}");
        let pointer = reply.problem()["instance_pointer"].clone();
        assert!(pointer.as_str().is_some_and(|p| place.starts_with(p)), "{place}: {pointer}");
    }
    assert_eq!(get(&app, "/v1/sessions").await.json(), json!({"sessions": [], "next": null}));
}

#[tokio::test]
async fn bombs_large_bodies_and_strange_types_are_refused() {
    let limits = Limits {
        max_inline_mesh_bytes: 4096,
        max_document_bytes: 1024,
        max_mesh_bytes: 2048,
        ..Limits::default()
    };
    let app = router(gateway(limits));
    let edits = format!("/v1/sessions/{UNKNOWN}/edits");
    let body = |path: &str, kind: &str, bytes: String| {
        Request::post(path).header(header::CONTENT_TYPE, kind).body(Body::from(bytes)).unwrap()
    };
    let bomb = "[".repeat(1000);
    let multipart = "multipart/form-data; boundary=x";
    let part = |name: &str, bytes: &str| {
        format!(
            "--x\r\nContent-Disposition: form-data; name=\"{name}\"; filename=\"a.msh\"\r\n\r\n{bytes}\r\n"
        )
    };
    let cases = [
        (body("/v1/sessions", media::JSON, bomb.clone()), 400),
        (body(&edits, media::JSON, format!("{{\"edits\":{bomb}")), 400),
        (body("/v1/sessions", media::JSON, " ".repeat(5000)), 413),
        (body(&edits, media::JSON, " ".repeat(2000)), 413),
        (body("/v1/sessions", "text/plain", "{}".into()), 415),
        (body(&edits, "text/plain", "{}".into()), 415),
        (body("/v1/sessions", "multipart/form-data", "x".into()), 400),
        (body("/v1/sessions", multipart, "nonsense".into()), 400),
        (body("/v1/sessions", multipart, part("mesh", "$MeshFormat") + "--x--"), 400),
        (body("/v1/sessions", multipart, part("extra", "") + "--x--"), 400),
        (body("/v1/sessions", multipart, part("mesh", &"m".repeat(3000)) + "--x--"), 413),
        (body("/v1/sessions", multipart, part("config", &" ".repeat(1500)) + "--x--"), 413),
    ];
    for (request, status) in cases {
        let shown = format!("{request:?}");
        let reply = send(&app, request).await;
        assert_eq!(reply.status, status, "{shown}: {}", String::from_utf8_lossy(&reply.body));
        reply.problem();
    }
}

#[tokio::test]
async fn a_truncated_mesh_file_is_located() {
    let mut config = tetrahedron();
    config.as_object_mut().unwrap().remove("mesh");
    let body = format!(
        "--x\r\nContent-Disposition: form-data; name=\"config\"\r\n\r\n{config}\r\n\
         --x\r\nContent-Disposition: form-data; name=\"mesh\"; filename=\"cut.msh\"\r\n\r\n\
         $MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0\r\n--x--\r\n"
    );
    let request = Request::post("/v1/sessions")
        .header(header::CONTENT_TYPE, "multipart/form-data; boundary=x")
        .body(Body::from(body))
        .unwrap();
    let problem = send(&app(), request).await.problem();
    assert_eq!((&problem["status"], &problem["instance_pointer"]), (&json!(400), &json!("/mesh")));
    assert!(problem["detail"].as_str().unwrap().contains("line"), "{problem}");
}

#[tokio::test]
async fn parameters_are_checked() {
    let app = app();
    for path in [
        "/v1/sessions?limit=0",
        "/v1/sessions?limit=100000",
        "/v1/sessions?limit=x",
        "/v1/sessions?page=2",
    ] {
        assert_eq!(get(&app, path).await.problem()["status"], 400, "{path}");
    }
    for wait in ["-1", "nan", "inf", "1e9", "x"] {
        let path = format!("/v1/sessions?wait_s={wait}");
        let reply = call(&app, Method::POST, &path, tetrahedron()).await;
        assert_eq!(reply.problem()["status"], 400, "{wait}");
    }
    for part in ["latest/basis", "current/basis?dtype=f16", "current/basis?have=1"] {
        let path = format!("/v1/sessions/{UNKNOWN}/generations/{part}");
        let status = get(&app, &path).await.problem()["status"].as_u64().unwrap();
        assert!([400, 404].contains(&status), "{part}");
    }
    let request = Request::get(format!("/v1/sessions/{UNKNOWN}/generations/0/basis"))
        .header(header::ACCEPT, "text/html")
        .body(Body::empty())
        .unwrap();
    assert_eq!(send(&app, request).await.problem()["status"], 406);
}

#[tokio::test]
async fn a_stream_wants_a_websocket() {
    let path = format!("/v1/sessions/{UNKNOWN}/stream");
    assert_eq!(get(&app(), &path).await.problem()["status"], 426);
}

#[tokio::test]
async fn requests_beyond_the_limit_are_shed_and_operations_are_not() {
    let app = router(gateway(Limits { max_requests: 0, ..Limits::default() }));
    let reply = get(&app, "/v1/sessions").await;
    assert_eq!(reply.problem()["status"], 503);
    assert!(reply.headers.contains_key(header::RETRY_AFTER));
    assert_eq!(get(&app, "/healthz").await.status, StatusCode::OK.as_u16());
}
