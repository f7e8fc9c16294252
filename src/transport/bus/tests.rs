//! An embedded router on a free port and a client of it, over a store without sessions.

use super::{Bus, BusConfig, BusError, open};
use crate::Limits;
use crate::http::tests::gateway;
use serde_json::{Value, json};
use sutura_proto::edit::{Edit, EditRequest};
use sutura_proto::{bus, media};
use zenoh::bytes::Encoding;

const UNKNOWN: &str = "sutura/v1/sessions/0192f0c1aaaa7bbb8ccc0123456789ab";

async fn scene(limits: Limits) -> (Bus, zenoh::Session) {
    let bus = open(&gateway(limits), BusConfig::loopback(0, "d0")).await.unwrap();
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", r#""client""#.to_owned()),
        ("connect/endpoints", format!("[{:?}]", bus.endpoint())),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    (bus, zenoh::open(config).await.unwrap())
}

/// The problem that the daemon answers with.
async fn refusal(
    client: &zenoh::Session,
    selector: &str,
    payload: Vec<u8>,
    encoding: Encoding,
) -> Value {
    let replies = client.get(selector).payload(payload).encoding(encoding).await.unwrap();
    let error = replies.recv_async().await.unwrap().into_result().unwrap_err();
    assert_eq!(error.encoding().to_string(), media::PROBLEM_JSON);
    serde_json::from_slice(&error.payload().to_bytes()).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn queries_are_refused_with_the_problems_of_http() {
    let (bus, client) = scene(Limits { max_document_bytes: 4096, ..Limits::default() }).await;
    let edits = format!("{UNKNOWN}/edits");
    let request = EditRequest::new(vec![Edit::Unstitch { stitch_ids: vec![1] }]);
    let bincode = bus::encode(&request).unwrap();
    let as_json = json!(request).to_string().into_bytes();
    let cases = [
        (edits.as_str(), bincode.clone(), Encoding::from(media::BINCODE), 404),
        (&edits, as_json.clone(), Encoding::APPLICATION_JSON, 404),
        (&edits, as_json.clone(), Encoding::default(), 404),
        (&edits, as_json.clone(), Encoding::from(media::BINCODE), 400),
        (&edits, bincode.clone(), Encoding::APPLICATION_JSON, 400),
        (&edits, vec![0xff; 64], Encoding::from(media::BINCODE), 400),
        (&edits, vec![b'['; 4000], Encoding::APPLICATION_JSON, 400),
        (&edits, vec![b' '; 5000], Encoding::APPLICATION_JSON, 413),
        (&edits, as_json.clone(), Encoding::TEXT_PLAIN, 415),
        ("sutura/v1/sessions/*/edits", as_json.clone(), Encoding::APPLICATION_JSON, 400),
        ("sutura/v1/sessions/no-such/info", Vec::new(), Encoding::default(), 404),
        (&format!("{UNKNOWN}/info"), Vec::new(), Encoding::default(), 404),
        (&format!("{UNKNOWN}/basis?dtype=f16"), Vec::new(), Encoding::default(), 400),
        (&format!("{UNKNOWN}/basis?generation=last"), Vec::new(), Encoding::default(), 400),
        (&format!("{UNKNOWN}/delta?have=0"), Vec::new(), Encoding::default(), 404),
        (&format!("{UNKNOWN}/combination"), Vec::new(), Encoding::default(), 404),
        (&format!("{UNKNOWN}/dictionary?blocks=1,2"), Vec::new(), Encoding::default(), 404),
        (&format!("{UNKNOWN}/dictionary?blocks=1,,2"), Vec::new(), Encoding::default(), 400),
    ];
    for (selector, payload, encoding, status) in cases {
        let shown = format!("{selector} as {encoding}");
        let problem = refusal(&client, selector, payload, encoding).await;
        assert_eq!(problem["status"], status, "{shown}: {problem}");
    }
    client.close().await.unwrap();
    bus.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_rate_holds_over_zenoh_too() {
    let limits = Limits { max_requests_per_s: 0.01, max_request_burst: 1, ..Limits::default() };
    let (bus, client) = scene(limits).await;
    let info = format!("{UNKNOWN}/info");
    for status in [404, 429] {
        let problem = refusal(&client, &info, Vec::new(), Encoding::default()).await;
        assert_eq!(problem["status"], status, "{problem}");
    }
    client.close().await.unwrap();
    bus.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_daemon_says_that_it_is_there_and_then_that_it_is_not() {
    let (bus, client) = scene(Limits::default()).await;
    let token = client.liveliness().declare_subscriber("sutura/v1/daemons/*").history(true);
    let token = token.await.unwrap();
    let alive = token.recv_async().await.unwrap();
    assert_eq!(alive.key_expr().as_str(), "sutura/v1/daemons/d0");
    assert_eq!(alive.kind(), zenoh::sample::SampleKind::Put);

    // No session, no answer: whoever looks for sessions asks all daemons.
    let replies = client.get("sutura/v1/sessions/*/info").await.unwrap();
    assert!(replies.recv_async().await.is_err());

    bus.close().await.unwrap();
    let gone = token.recv_async().await.unwrap();
    assert_eq!(gone.kind(), zenoh::sample::SampleKind::Delete);
    client.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn queries_beyond_the_limit_are_shed() {
    let (bus, client) = scene(Limits { max_queries: 0, ..Limits::default() }).await;
    let replies = client.get(format!("{UNKNOWN}/info")).await.unwrap();
    assert!(replies.recv_async().await.is_err());
    client.close().await.unwrap();
    bus.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn unusable_forces_are_heard_and_dropped() {
    let (bus, client) = scene(Limits::default()).await;
    for key in ["sutura/v1/sessions/*/forces", &format!("{UNKNOWN}/forces")] {
        client.put(key, vec![0xff; 64]).encoding(media::BINCODE).await.unwrap();
    }
    let info = format!("{UNKNOWN}/info");
    let problem = refusal(&client, &info, Vec::new(), Encoding::default()).await;
    assert_eq!(problem["status"], 404, "the daemon goes on answering");
    client.close().await.unwrap();
    bus.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_taken_address_is_an_error() {
    let (bus, client) = scene(Limits::default()).await;
    let config = BusConfig { listen: bus.address(), ..BusConfig::loopback(0, "d1") };
    let error = open(&gateway(Limits::default()), config).await.err().unwrap();
    assert!(matches!(error, BusError::Address { .. }), "{error}");
    client.close().await.unwrap();
    bus.close().await.unwrap();
}

#[tokio::test]
async fn a_single_threaded_runtime_is_an_error() {
    let config = BusConfig::loopback(0, "d0");
    let error = open(&gateway(Limits::default()), config).await.err().unwrap();
    assert!(matches!(error, BusError::Runtime), "{error}");
}
