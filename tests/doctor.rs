//! What `sutura doctor` says of a certificate and of a collector.

use crate::telemetry::{Collector, TOKEN};
use rcgen::{CertificateParams, KeyPair, date_time_ymd};
use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::process::Command;

/// What the check of this name found: its outcome and its words; `None` if nothing was checked.
fn checked(folder: &Path, name: &str, settings: &str) -> Option<(String, String)> {
    let config = folder.join("sutura.toml");
    fs::write(&config, settings).unwrap();
    let mut sutura = Command::new(env!("CARGO_BIN_EXE_sutura"));
    let output = sutura.current_dir(folder).args(["doctor", "--json", "--config"]).arg(&config);
    let checks: Vec<serde_json::Value> =
        serde_json::from_slice(&output.output().unwrap().stdout).unwrap();
    let check = checks.into_iter().find(|check| check["name"] == name)?;
    let text = |member: &str| check[member].as_str().unwrap().to_owned();
    Some((text("outcome"), text("found")))
}

/// Writes a certificate that is good from one year to another, and its key.
fn certify(folder: &Path, name: &str, from: i32, until: i32) {
    let key = KeyPair::generate().unwrap();
    let mut params = CertificateParams::new(["localhost".to_owned()]).unwrap();
    params.not_before = date_time_ymd(from, 1, 1);
    params.not_after = date_time_ymd(until, 1, 1);
    fs::write(folder.join(format!("{name}.pem")), params.self_signed(&key).unwrap().pem()).unwrap();
    fs::write(folder.join(format!("{name}.key")), key.serialize_pem()).unwrap();
}

#[test]
fn a_certificate_is_checked_before_clients_refuse_it() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    certify(folder, "good", 2000, 4000);
    certify(folder, "old", 2000, 2001);
    certify(folder, "new", 3990, 4000);
    let doctor = |certificate: &str, key: &str| {
        let settings = format!("[tls]\ncertificate = {certificate:?}\nprivate_key = {key:?}\n");
        checked(folder, "tls", &settings).unwrap()
    };
    assert_eq!(checked(folder, "tls", ""), None);
    let (outcome, found) = doctor("good.pem", "good.key");
    assert!(outcome == "ok" && found.contains("fits its key"), "{found}");
    for (certificate, key, told) in [
        ("old.pem", "old.key", "expired"),
        ("new.pem", "new.key", "not good yet"),
        ("good.pem", "old.key", "good.pem with old.key"),
        ("none.pem", "good.key", "none.pem"),
        ("good.pem", "none.key", "none.key"),
        ("good.key", "good.pem", "good.key"),
    ] {
        let (outcome, found) = doctor(certificate, key);
        assert!(outcome == "failed" && found.contains(told), "{certificate}, {key}: {found}");
    }
    let half = "[tls]\ncertificate = \"good.pem\"\n";
    let (outcome, found) = checked(folder, "tls", half).unwrap();
    assert!(outcome == "failed" && found.contains("[tls]"), "{found}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_collector_is_asked_whether_it_takes_traces() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let doctor = |settings: &str| checked(folder, "collector", settings);
    assert_eq!(doctor(""), None);
    let collector = Collector::start().await;
    let known = collector.settings();
    let (outcome, found) = doctor(&known).unwrap();
    assert!(outcome == "ok" && found.contains("/v1/traces takes traces"), "{found}");
    assert!(collector.spans().is_empty());
    let (outcome, found) = doctor(&known.replace(TOKEN, "another")).unwrap();
    assert!(outcome == "warning" && found.contains("401"), "{found}");
    let (outcome, found) = doctor(&known.replace(TOKEN, "split\\nin two")).unwrap();
    assert!(outcome == "failed" && found.contains("otlp_headers"), "{found}");
    // An address that was free a moment ago.
    let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let (outcome, found) =
        doctor(&format!("[telemetry]\notlp_endpoint = \"http://{address}\"\n")).unwrap();
    assert!(outcome == "warning" && found.to_lowercase().contains("refused"), "{found}");
}
