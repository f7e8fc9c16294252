//! TLS at both doors, with certificates made here.

use crate::bodies::{ready_bar_of, seam, stitch};
use crate::daemon::{Daemon, PATIENCE};
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;
use sutura_client::proto::simulation::SimulationConfig;
use sutura_client::{Arrays, Client, Credentials, ZenohClient};

/// An authority, with its certificate in a file.
struct Authority {
    issuer: CertifiedIssuer<'static, KeyPair>,
    file: PathBuf,
}

impl Authority {
    fn new(folder: &Path, name: &str) -> Authority {
        let mut params = CertificateParams::new([]).unwrap();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let issuer = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
        let file = folder.join(format!("{name}.pem"));
        fs::write(&file, issuer.pem()).unwrap();
        Authority { issuer, file }
    }

    /// Writes a certificate for this machine and its key.
    fn certify(&self, certificate: &Path, private_key: &Path) {
        let names = ["localhost".to_owned(), "127.0.0.1".to_owned()];
        let key = KeyPair::generate().unwrap();
        let signed = CertificateParams::new(names).unwrap().signed_by(&key, &self.issuer).unwrap();
        fs::write(certificate, signed.pem()).unwrap();
        fs::write(private_key, key.serialize_pem()).unwrap();
    }

    fn credentials(&self) -> Credentials {
        Credentials { key: None, ca_file: Some(self.file.clone()) }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn both_doors_speak_tls_and_take_over_a_new_certificate() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let (ours, other) = (Authority::new(folder, "ours"), Authority::new(folder, "other"));
    let (certificate, private_key) = (folder.join("chain.pem"), folder.join("key.pem"));
    ours.certify(&certificate, &private_key);
    let settings = folder.join("sutura.toml");
    let text = format!("[tls]\ncertificate = {certificate:?}\nprivate_key = {private_key:?}\n");
    fs::write(&settings, text).unwrap();
    let data = folder.join("data");
    let daemon = Daemon::start_with(&data, &["--config".as_ref(), settings.as_ref()]);
    assert!(daemon.http.starts_with("https://") && daemon.zenoh.starts_with("tls/"));

    let client = Client::connect_as(&daemon.http, &ours.credentials()).await.unwrap();
    let session = ready_bar_of(&client).await;
    let zenoh = ZenohClient::open_as(&daemon.zenoh, &ours.credentials()).await.unwrap();
    let over_zenoh = zenoh.session(session.id()).unwrap();
    over_zenoh.edit(&stitch(&seam())).await.unwrap();
    let tets = session.tets(1.into()).await.unwrap();
    assert_eq!(over_zenoh.tets(1.into()).await.unwrap(), tets);
    session.simulate(&SimulationConfig::default()).await.unwrap();
    let mut states = [session.states().await.unwrap(), over_zenoh.states().await.unwrap()];
    for stream in &mut states {
        tokio::time::timeout(PATIENCE, stream.next()).await.unwrap().unwrap();
    }

    // Whoever trusts others is not fooled, and whoever speaks plainly is told so.
    assert!(Client::connect_as(&daemon.http, &other.credentials()).await.is_err());
    assert!(Client::connect(&daemon.http).await.is_err());
    assert!(ZenohClient::open_as(&daemon.zenoh, &other.credentials()).await.is_err());
    assert!(ZenohClient::open(&daemon.zenoh.replace("tls/", "tcp/")).await.is_err());
    let mut plain = TcpStream::connect(daemon.http.strip_prefix("https://").unwrap()).unwrap();
    plain.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
    let mut answer = String::new();
    plain.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 400") && answer.contains("TLS"), "{answer}");

    // The other authority's certificate counts once the daemon is told.
    other.certify(&certificate, &private_key);
    daemon.hang_up();
    let begun = Instant::now();
    while Client::connect_as(&daemon.http, &other.credentials()).await.is_err()
        || ZenohClient::open_as(&daemon.zenoh, &other.credentials()).await.is_err()
    {
        assert!(begun.elapsed() < PATIENCE, "the new certificate is not shown");
    }
    // A key that does not belong to it does not: the daemon goes on as it was.
    ours.certify(&certificate, &folder.join("elsewhere.pem"));
    daemon.hang_up();
    session.info().await.unwrap();
    Client::connect_as(&daemon.http, &other.credentials()).await.unwrap();
}

#[test]
fn certificates_that_cannot_be_used_are_refused_at_the_start() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let file = |name: &str| folder.join(name);
    let authority = Authority::new(folder, "authority");
    authority.certify(&file("chain.pem"), &file("key.pem"));
    authority.certify(&file("other.pem"), &file("other_key.pem"));
    fs::write(file("empty.pem"), "").unwrap();
    for (certificate, private_key, said) in [
        ("chain.pem", "no_such.pem", "no_such.pem"),
        ("empty.pem", "key.pem", "empty.pem"),
        ("chain.pem", "chain.pem", "chain.pem"),
        ("chain.pem", "other_key.pem", "other_key.pem"),
    ] {
        let text = format!(
            "[tls]\ncertificate = {:?}\nprivate_key = {:?}\n",
            file(certificate),
            file(private_key)
        );
        refused(folder, &text, said);
    }
    refused(folder, "[tls]\ncertificate = \"chain.pem\"\n", "private_key");
}

/// Starts a daemon that is to end at once, with bad input, and to say why.
fn refused(folder: &Path, settings: &str, said: &str) {
    let path = folder.join("sutura.toml");
    fs::write(&path, settings).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_sutura"))
        .args(["serve", "--http", "127.0.0.1:0", "--zenoh", "tcp/127.0.0.1:0", "--data", "none"])
        .arg("--config")
        .arg(path)
        .output()
        .unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert!(error.contains(said), "{said}: {error}");
}
