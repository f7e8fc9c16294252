//! TLS: the certificate that both doors show.

use rustls::ServerConfig;
use rustls::pki_types::pem::{self, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;

/// How long a client may take to agree on keys.
const MAX_HANDSHAKE: Duration = Duration::from_secs(10);

/// The first byte of every TLS connection: a handshake record.
const HANDSHAKE: u8 = 0x16;

/// What somebody hears who speaks plainly to a port that does not.
const PLAIN_REFUSAL: &[u8] = b"HTTP/1.1 400 Bad Request\r\ncontent-type: text/plain\r\n\
    connection: close\r\n\r\nthis port speaks TLS: use https\n";

/// Bytes of a plain request that are read before it is refused, so that its sender reads the refusal.
const MAX_PLAIN_BYTES: usize = 16 << 10;

/// Where the certificate and its key lie, both in PEM.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// The certificate, and those between it and its authority's.
    pub certificate: PathBuf,
    /// Its private key.
    pub private_key: PathBuf,
}

/// Why a certificate cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// A file cannot be read, or holds no such thing.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: pem::Error,
    },
    /// The certificate is written in no form that is known.
    #[error("{}: {why}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The two do not belong together, or are of a kind that is not spoken.
    #[error("{} with {}: {source}", files.certificate.display(), files.private_key.display())]
    Unusable {
        /// The two.
        files: TlsFiles,
        /// Why.
        source: rustls::Error,
    },
}

/// A certificate in use. What its files hold later counts from [`Tls::reload`] on.
#[derive(Debug)]
pub struct Tls {
    files: TlsFiles,
    config: RwLock<Arc<ServerConfig>>,
}

impl Tls {
    /// Reads the files and checks that they belong together.
    pub fn load(files: TlsFiles) -> Result<Tls, TlsError> {
        let config = RwLock::new(Arc::new(server_config(&files)?));
        Ok(Tls { files, config })
    }

    /// Reads the files again, for connections from now on; if that fails, those known go on.
    pub fn reload(&self) -> Result<(), TlsError> {
        let config = Arc::new(server_config(&self.files)?);
        *self.config.write().unwrap_or_else(PoisonError::into_inner) = config;
        Ok(())
    }

    /// From when until when the certificate in the files is good, in s since 1970.
    pub fn validity_s(&self) -> Result<RangeInclusive<i64>, TlsError> {
        let path = &self.files.certificate;
        let certificate = CertificateDer::from_pem_file(path)
            .map_err(|source| TlsError::File { path: path.clone(), source })?;
        let unreadable = |why: String| TlsError::Unreadable { path: path.clone(), why };
        let (_, parsed) = x509_parser::parse_x509_certificate(&certificate)
            .map_err(|error| unreadable(error.to_string()))?;
        let validity = parsed.validity();
        Ok(validity.not_before.timestamp()..=validity.not_after.timestamp())
    }

    /// The files.
    pub fn files(&self) -> &TlsFiles {
        &self.files
    }

    /// Agrees with a client; `None` once it has been refused.
    pub(crate) async fn accept(&self, stream: TcpStream) -> Option<TlsStream<TcpStream>> {
        let config = self.config.read().unwrap_or_else(PoisonError::into_inner).clone();
        match tokio::time::timeout(MAX_HANDSHAKE, accept(config, stream)).await {
            Ok(Ok(stream)) => stream,
            Ok(Err(error)) => {
                tracing::debug!(%error, "a client did not agree on TLS");
                None
            }
            Err(_) => {
                tracing::debug!("a client took too long to agree on TLS");
                None
            }
        }
    }
}

async fn accept(
    config: Arc<ServerConfig>,
    mut stream: TcpStream,
) -> std::io::Result<Option<TlsStream<TcpStream>>> {
    let mut first = [0];
    if stream.peek(&mut first).await? == 0 {
        return Ok(None);
    }
    if first == [HANDSHAKE] {
        return TlsAcceptor::from(config).accept(stream).await.map(Some);
    }
    tracing::debug!("a client spoke plainly to a port of TLS");
    let mut request = vec![0; MAX_PLAIN_BYTES];
    let _ = stream.read(&mut request).await?;
    stream.write_all(PLAIN_REFUSAL).await?;
    stream.shutdown().await?;
    Ok(None)
}

fn server_config(files: &TlsFiles) -> Result<ServerConfig, TlsError> {
    let of = |path: &Path| {
        let path = path.to_owned();
        move |source| TlsError::File { path, source }
    };
    let TlsFiles { certificate, private_key } = files;
    let chain = CertificateDer::pem_file_iter(certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .and_then(|chain| if chain.is_empty() { Err(pem::Error::NoItemsFound) } else { Ok(chain) })
        .map_err(of(certificate))?;
    let key = PrivateKeyDer::from_pem_file(private_key).map_err(of(private_key))?;
    let unusable = |source| TlsError::Unusable { files: files.clone(), source };
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(unusable)?
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(unusable)?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(config)
}
