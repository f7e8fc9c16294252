//! Bad input: each gets a problem document that names the offender; the daemon goes on serving and
//! the session is what it was.

use crate::bodies::{TIP, bar, config, free_vertices, msh, prepared, ready_bar, seam, stitch};
use crate::daemon::Daemon;
use crate::plain_http::plain_http;
use reqwest::multipart::{Form, Part};
use reqwest::{Method, RequestBuilder, Response, header};
use serde_json::{Value, json};
use sutura_client::proto::session::SessionInfo;
use sutura_client::proto::{Problem, media};
use sutura_client::{Error, Session};

/// The answer is a problem document of this status that mentions `offender`, in words or as the
/// pointer to it.
async fn assert_refused(what: &str, reply: Response, status: u16, offender: &str) -> Problem {
    let (found, kind) =
        (reply.status().as_u16(), reply.headers().get(header::CONTENT_TYPE).cloned());
    assert!(reply.headers().contains_key("x-request-id"), "{what}: no request id");
    let text = reply.text().await.unwrap();
    assert_eq!(found, status, "{what}: {text}");
    assert_eq!(kind.unwrap(), media::PROBLEM_JSON, "{what}: {text}");
    let problem: Problem = serde_json::from_str(&text).unwrap();
    assert_eq!(problem.status, status, "{what}: {text}");
    let pointer = problem.instance_pointer.as_deref().unwrap_or_default();
    let named = problem.detail.contains(offender) || pointer == offender;
    assert!(named, "{what}: {offender:?} is not named by {text}");
    problem
}

/// A daemon with one session that has been edited once, and what its info was then.
struct Scene {
    daemon: Daemon,
    session: Session,
    before: SessionInfo,
}

impl Scene {
    async fn new() -> Scene {
        let daemon = Daemon::start();
        let session = ready_bar(&daemon).await;
        session.edit(&stitch(&seam()[..5])).await.unwrap();
        // What goes on behind the edit shows in the session's description.
        prepared(&session, 5).await;
        let before = session.info().await.unwrap();
        Scene { daemon, session, before }
    }

    fn request(&self, method: Method, path: &str) -> RequestBuilder {
        plain_http().request(method, self.daemon.url(path))
    }

    fn path(&self, rest: &str) -> String {
        format!("/v1/sessions/{}/{rest}", self.session.id())
    }

    async fn refuse(&self, what: &str, request: RequestBuilder, status: u16, offender: &str) {
        let reply = request.send().await.unwrap();
        assert_refused(what, reply, status, offender).await;
        assert_eq!(self.session.info().await.unwrap(), self.before, "after {what}");
    }

    /// Nothing was made in passing, and the session can still be edited.
    async fn end(self) {
        let sessions = self.daemon.client().await.list(None, 50).await.unwrap().sessions;
        assert_eq!(sessions.len(), 1, "{sessions:?}");
        let reply = self.session.edit(&stitch(&seam()[5..])).await.unwrap();
        assert_eq!((reply.generation, reply.n_stitches), (2, 9));
        assert_eq!(self.daemon.terminate().code(), Some(0));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_mesh_files() {
    let scene = Scene::new().await;
    let good = msh(&bar());
    let form = |text: String| {
        let config = Part::text(serde_json::to_string(&config()).unwrap());
        let mesh = Part::bytes(text.into_bytes()).file_name("bar.msh");
        Form::new().part("config", config.mime_str(media::JSON).unwrap()).part("mesh", mesh)
    };
    let post = |form| scene.request(Method::POST, "/v1/sessions").multipart(form);

    let truncated = good[..good.len() / 2].to_owned();
    scene.refuse("a truncated mesh", post(form(truncated)), 400, "line 98: 192 elements").await;
    let elsewhere = good.replacen("1 4 2 1 1 1 ", "1 4 2 1 1 91 ", 1);
    assert_ne!(elsewhere, good);
    scene
        .refuse("a corner out of range", post(form(elsewhere)), 400, "line 99: element 1: node 91")
        .await;
    let mut mesh = bar();
    mesh.tets[37].swap(0, 1);
    scene.refuse("an inverted tet", post(form(msh(&mesh))), 422, "tet 37").await;
    let mut mesh = bar();
    mesh.vertices[11][1] = f64::NAN;
    scene.refuse("a NaN coordinate", post(form(msh(&mesh))), 422, "vertex 11").await;
    let mut mesh = bar();
    let corner = mesh.vertices[mesh.tets[5][0] as usize];
    mesh.vertices[mesh.tets[5][1] as usize] = corner;
    scene.refuse("a flat tet", post(form(msh(&mesh))), 422, "tet").await;
    scene.refuse("an empty file", post(form(String::new())), 400, "").await;
    scene.refuse("a picture", post(form("\u{89}PNG\r\n".to_owned())), 400, "").await;
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_uploads() {
    let scene = Scene::new().await;
    let post = || scene.request(Method::POST, "/v1/sessions");
    let multipart = |body: &'static str| {
        post().header(header::CONTENT_TYPE, "multipart/form-data; boundary=x").body(body)
    };
    scene.refuse("multipart cut short", multipart("--x\r\nContent-Dis"), 400, "").await;
    scene.refuse("no multipart at all", multipart("hello"), 400, "").await;
    let bare = post().header(header::CONTENT_TYPE, "multipart/form-data").body("--x--");
    scene.refuse("no boundary", bare, 400, "boundary").await;
    let lonely = Form::new().text("mesh", msh(&bar()));
    scene.refuse("no config", post().multipart(lonely), 400, "config").await;
    let config = serde_json::to_string(&config()).unwrap();
    let lonely = Form::new().text("config", config.clone());
    scene.refuse("no mesh", post().multipart(lonely), 400, "mesh").await;
    let stranger = Form::new().text("config", config).text("speling", "");
    scene.refuse("an unknown part", post().multipart(stranger), 400, "").await;
    let text = post().header(header::CONTENT_TYPE, "text/plain").body("hello");
    scene.refuse("neither JSON nor multipart", text, 415, media::JSON).await;
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_session_documents() {
    let scene = Scene::new().await;
    let post = |document: &Value| scene.request(Method::POST, "/v1/sessions").json(document);
    let mut good = serde_json::to_value(config()).unwrap();
    good["mesh"] = serde_json::to_value(bar()).unwrap();
    for (pointer, value, status, offender) in [
        ("/mesh/tets/3/1", json!(90), 422, "/mesh/tets/3/1"),
        ("/mesh/tets/3/1", json!(-1), 400, "/mesh/tets/3/1"),
        ("/mesh/tets/3/1", json!(5_000_000_000u64), 400, "/mesh/tets/3/1"),
        (
            "/mesh/tets/3",
            [1, 0, 2, 3]
                .map(|corner| good["mesh"]["tets"][3][corner].clone())
                .into_iter()
                .collect(),
            422,
            "tet 3 is inverted",
        ),
        ("/mesh/vertices/7/2", json!(null), 400, "/mesh/vertices/7/2"),
        ("/mesh/domains", json!([1]), 422, "/mesh/domains"),
        ("/fixed_vertices/0", json!(90), 422, "/fixed_vertices/0"),
        ("/material/poisson_ratio", json!(0.5), 422, "/material/poisson_ratio"),
        ("/material/law", json!("jelly"), 400, "jelly"),
        ("/n_modes", json!(0), 422, "/n_modes"),
        ("/basis/size", json!(-3), 400, "/basis/size"),
        ("/cubature/tolerance", json!(0), 422, "/cubature/tolerance"),
        ("/seams", json!([[0, 200]]), 422, "200"),
        ("/name", json!("a\u{0}b"), 422, "/name"),
    ] {
        let mut document = good.clone();
        *document.pointer_mut(pointer).unwrap_or_else(|| panic!("{pointer}")) = value;
        scene.refuse(&format!("a wrong {pointer}"), post(&document), status, offender).await;
    }
    let mut document = good.clone();
    document["n_mode"] = json!(3);
    scene.refuse("an unknown member", post(&document), 400, "n_mode").await;
    let mut document = good.clone();
    document.as_object_mut().unwrap().remove("mesh");
    scene.refuse("no mesh", post(&document), 400, "mesh").await;
    let mut document = good.clone();
    document.as_object_mut().unwrap().remove("material");
    scene.refuse("no material", post(&document), 422, "/material").await;
    let nan = good.to_string().replacen("0.025", "NaN", 1);
    let json = |body: String| {
        let post = scene.request(Method::POST, "/v1/sessions");
        post.header(header::CONTENT_TYPE, media::JSON).body(body)
    };
    scene.refuse("a NaN literal", json(nan), 400, "").await;
    let huge = good.to_string().replacen("0.025", "1e999", 1);
    scene.refuse("a number beyond f64", json(huge), 400, "").await;
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_edits() {
    let scene = Scene::new().await;
    let post = |document: Value| scene.request(Method::POST, &scene.path("edits")).json(&document);
    let stitch =
        |pairs: Value| json!({"edits": [{"stitch": {"pairs": pairs, "stiffness_n_m": 1e5}}]});
    let [free_a, free_b] = seam()[6];
    let [stitched_a, stitched_b] = seam()[0];
    let at = "/edits/0/stitch/pairs/0";
    for (what, pairs, offender) in [
        ("a vertex that does not exist", json!([[free_a, 90]]), "vertex 90"),
        ("vertices that do not coincide", json!([[free_a, TIP]]), at),
        ("a vertex stitched to itself", json!([[free_a, free_a]]), at),
        ("vertices already stitched", json!([[stitched_a, stitched_b]]), at),
        ("the same, the other way round", json!([[stitched_b, stitched_a]]), at),
        ("a pair twice", json!([[free_a, free_b], [free_a, free_b]]), "/edits/0/stitch/pairs/1"),
        ("no pairs", json!([]), "/edits/0/stitch/pairs"),
    ] {
        scene.refuse(what, post(stitch(pairs)), 422, offender).await;
    }
    let good = stitch(json!([[free_a, free_b]]));
    for (what, pointer, value, status, offender) in [
        (
            "a soft spring",
            "/edits/0/stitch/stiffness_n_m",
            json!(-1),
            422,
            "/edits/0/stitch/stiffness_n_m",
        ),
        (
            "an index of text",
            "/edits/0/stitch/pairs/0/0",
            json!("0"),
            400,
            "/edits/0/stitch/pairs/0/0",
        ),
        ("no edits", "/edits", json!([]), 422, "/edits"),
        ("an unknown edit", "/edits/0", json!({"glue": {}}), 400, "glue"),
        ("an unknown stitch", "/edits/0", json!({"unstitch": {"stitch_ids": [0, 99]}}), 422, "99"),
        (
            "an unknown domain",
            "/edits/0",
            json!({"scale_stiffness": {"domain": 9, "factor": 2}}),
            422,
            "/edits/0/scale_stiffness/domain",
        ),
        (
            "a vertex fixed twice",
            "/edits/0",
            json!({"fix": {"vertices": [TIP, TIP]}}),
            422,
            "/edits/0/fix/vertices/1",
        ),
        (
            "a vertex that is not there",
            "/edits/0",
            json!({"release": {"vertices": [4000000000u32]}}),
            422,
            "/edits/0/release/vertices/0",
        ),
        (
            "a vertex released that is free",
            "/edits/0",
            json!({"release": {"vertices": [0, TIP]}}),
            422,
            "/edits/0/release/vertices/1",
        ),
        (
            "vertices closed that are held apart",
            "/edits/0",
            json!({"close": {"pairs": [[0, 5]], "stiffness_n_m": 1e5}}),
            422,
            "/edits/0/close/pairs/0",
        ),
        (
            "a vertex closed onto itself",
            "/edits/0",
            json!({"close": {"pairs": [[TIP, 0], [TIP, TIP]], "stiffness_n_m": 1e5}}),
            422,
            "/edits/0/close/pairs/1",
        ),
        (
            "everything fixed",
            "/edits/0",
            json!({"fix": {"vertices": free_vertices()}}),
            422,
            "/edits/0/fix/vertices",
        ),
    ] {
        let mut document = good.clone();
        *document.pointer_mut(pointer).unwrap() = value;
        scene.refuse(what, post(document), status, offender).await;
    }
    for (member, value, status, offender) in [
        ("base_generation", json!(0), 409, "base_generation is 0"),
        ("base_generation", json!(7), 409, "base_generation is 7"),
        ("base_generation", json!("now"), 400, "/base_generation"),
        ("method", json!("magic"), 400, "magic"),
        ("tolerance", json!(0), 422, "/tolerance"),
        ("speling", json!(0), 400, "speling"),
    ] {
        let mut document = good.clone();
        document[member] = value;
        scene.refuse(&format!("a wrong {member}"), post(document), status, offender).await;
    }
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bombs_and_floods() {
    let scene = Scene::new().await;
    for path in ["/v1/sessions".to_owned(), scene.path("edits"), scene.path("evaluate")] {
        let post = |body: Vec<u8>| {
            let request = scene.request(Method::POST, &path);
            request.header(header::CONTENT_TYPE, media::JSON).body(body)
        };
        for opening in ["[", "{\"edits\":", "{\"q\":[", "{\"mesh\":{\"vertices\":["] {
            let bomb = opening.repeat(1 << 18).into_bytes();
            scene.refuse("a deeply nested document", post(bomb), 400, "").await;
        }
        scene.refuse("an empty body", post(Vec::new()), 400, "").await;
        scene.refuse("not UTF-8", post(vec![0xff; 64]), 400, "").await;
    }
    let mut flood = b"{\"edits\": [".to_vec();
    flood.resize(9 << 20, b' ');
    let post = scene.request(Method::POST, &scene.path("edits"));
    let post = post.header(header::CONTENT_TYPE, media::JSON).body(flood);
    scene.refuse("an oversized document", post, 413, "8388608").await;
    let mut config = br#"{"material": {"#.to_vec();
    config.resize(9 << 20, b' ');
    let form = Form::new().part("config", Part::bytes(config)).text("mesh", msh(&bar()));
    let post = scene.request(Method::POST, "/v1/sessions").multipart(form);
    scene.refuse("an oversized part", post, 413, "8388608").await;
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn wrong_addresses_and_negotiations() {
    let scene = Scene::new().await;
    let get = |path: &str| scene.request(Method::GET, path);
    let nobody = "0190a6c4e3b27c2e9d1f0123456789ab";
    scene
        .refuse("a session that is not there", get(&format!("/v1/sessions/{nobody}")), 404, nobody)
        .await;
    scene.refuse("no identifier", get("/v1/sessions/liver-7"), 404, "liver-7").await;
    scene.refuse("an escape", get("/v1/sessions/..%2f..%2fetc"), 404, "").await;
    scene.refuse("no path", get("/v2/sessions"), 404, "openapi").await;
    scene.refuse("no method", scene.request(Method::PATCH, "/v1/sessions"), 405, "").await;
    let of = |rest: &str| get(&scene.path(&format!("generations/{rest}")));
    scene.refuse("a generation to come", of("9/basis"), 404, "9").await;
    scene.refuse("no generation", of("latest/basis"), 400, "current").await;
    scene.refuse("an element type", of("0/basis?dtype=f16"), 400, "f16").await;
    scene.refuse("a parameter", of("0/basis?speling=1"), 400, "speling").await;
    scene.refuse("a delta from nothing", of("1/delta"), 400, "have").await;
    scene.refuse("a delta from the future", of("1/delta?have=9"), 404, "9").await;
    let accept = |rest: &str, media: &str| of(rest).header(header::ACCEPT, media);
    scene.refuse("JSON vertices", accept("0/basis", media::JSON), 406, media::NPY).await;
    scene.refuse("a delta as npy", accept("1/delta?have=0", media::NPY), 406, media::FRAME).await;
    scene.refuse("a page of none", get("/v1/sessions?limit=0"), 400, "limit").await;
    scene.refuse("no upgrade", get(&scene.path("stream")), 426, "WebSocket").await;
    scene.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_evaluations_and_simulations() {
    let scene = Scene::new().await;
    let r = scene.before.basis_size;
    let call =
        |method, path: &str, body: Value| scene.request(method, &scene.path(path)).json(&body);
    let evaluate = |body| call(Method::POST, "generations/current/evaluate", body);
    scene.refuse("too few coordinates", evaluate(json!({"q": [1.0]})), 422, &r.to_string()).await;
    let ragged = json!({"q": [vec![0.0; r], vec![0.0; r + 1]]});
    scene.refuse("a ragged batch", evaluate(ragged), 422, "1").await;
    scene.refuse("text", evaluate(json!({"q": "rest"})), 400, "list of numbers").await;
    let simulate = |body| call(Method::PUT, "simulation", body);
    scene.refuse("a step of no time", simulate(json!({"dt_s": 0})), 422, "/dt_s").await;
    scene.refuse("a flood", simulate(json!({"publish_hz": 1e9})), 422, "/publish_hz").await;
    scene.refuse("magic", simulate(json!({"integrator": "magic"})), 400, "magic").await;
    let forces = |vertex: u32| {
        let force = json!({"vertex": vertex, "force_n": [0, 1, 0], "duration_s": 0.2});
        call(Method::POST, "simulation/forces", json!({"forces": [force]}))
    };
    scene.refuse("a force on a body at rest", forces(0), 404, "simulation").await;
    scene.session.simulate(&Default::default()).await.unwrap();
    scene.refuse("a force on no vertex", forces(90), 422, "90").await;
    scene.session.stop_simulation().await.unwrap();
    scene.end().await;
}

/// What the daemon says on Zenoh to `payload`.
async fn answer(scene: &Scene, resource: &str, payload: &[u8], encoding: &str) -> Problem {
    let mut zenoh_config = zenoh::Config::default();
    for (key, value) in [
        ("mode", r#""client""#.to_owned()),
        ("connect/endpoints", json!([scene.daemon.zenoh]).to_string()),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        zenoh_config.insert_json5(key, &value).unwrap();
    }
    let zenoh_session = zenoh::open(zenoh_config).await.unwrap();
    let key = format!("sutura/v1/sessions/{}/{resource}", scene.session.id());
    let get = zenoh_session.get(key.as_str()).payload(payload.to_vec()).encoding(encoding);
    let reply = get.await.unwrap().recv_async().await.unwrap();
    let error = reply.into_result().unwrap_err();
    assert_eq!(error.encoding().to_string(), media::PROBLEM_JSON);
    serde_json::from_slice(&error.payload().to_bytes()).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn zenoh_refuses_what_http_refuses() {
    let scene = Scene::new().await;
    let bus = scene.daemon.zenoh_client().await.session(scene.session.id()).unwrap();
    let [a, _] = seam()[6];
    let error = bus.edit(&stitch(&[[a, 90]])).await.unwrap_err();
    let problem = error.problem().unwrap_or_else(|| panic!("{error}"));
    assert_eq!(problem.status, 422);
    assert_eq!(problem.instance_pointer.as_deref(), Some("/edits/0/stitch/pairs/0"));
    let wrong = sutura_client::proto::edit::EditRequest {
        base_generation: Some(7),
        ..stitch(&seam()[6..])
    };
    assert_eq!(bus.edit(&wrong).await.unwrap_err().status(), Some(409));
    for (payload, encoding, status) in [
        (&b"\xff\xff\xff\xff\xff\xff\xff\xff"[..], media::BINCODE, 400),
        (b"{}", media::JSON, 400),
        (&[b'['; 4096], media::JSON, 400),
        (b"", media::JSON, 400),
        (b"{\"edits\": []}", media::JSON, 422),
        (b"hello", "text/plain", 415),
    ] {
        let problem = answer(&scene, "edits", payload, encoding).await;
        assert_eq!(problem.status, status, "{encoding}: {problem}");
    }
    let problem = answer(&scene, "delta", b"", media::JSON).await;
    assert_eq!(problem.status, 400, "{problem}");
    assert_eq!(scene.session.info().await.unwrap(), scene.before);
    let nobody = scene.daemon.zenoh_client().await;
    let nobody = nobody.session("0190a6c4e3b27c2e9d1f0123456789ab").unwrap();
    let error = nobody.info().await.unwrap_err();
    assert!(matches!(error, Error::Absent(_)) || error.status() == Some(404), "{error}");
    scene.end().await;
}
