//! What a client shows, and whom it trusts.

use crate::error::{Error, Result};
use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::{self, PemObject};
use rustls::{ClientConfig, RootCertStore};
use rustls_platform_verifier::BuilderVerifierExt;
use std::path::PathBuf;
use std::sync::Arc;

/// What a client shows, and whom it trusts; by default nothing, and those whom the system trusts.
#[derive(Clone, Default)]
pub struct Credentials {
    /// The key that the daemon asks for.
    pub key: Option<String>,
    /// A file with the certificates (PEM) of the only authorities to trust, instead of those of the system.
    pub ca_file: Option<PathBuf>,
}

/// Without the key.
impl std::fmt::Debug for Credentials {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Credentials")
            .field("has_key", &self.key.is_some())
            .field("ca_file", &self.ca_file)
            .finish()
    }
}

impl Credentials {
    /// A key alone.
    pub fn of_key(key: impl Into<String>) -> Credentials {
        Credentials { key: Some(key.into()), ca_file: None }
    }

    /// How to speak TLS.
    pub(crate) fn tls(&self) -> Result<ClientConfig> {
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let builder = ClientConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(Error::Tls)?;
        let Some(path) = &self.ca_file else {
            let verified = builder.with_platform_verifier().map_err(Error::Tls)?;
            return Ok(verified.with_no_client_auth());
        };
        let mut roots = RootCertStore::empty();
        let unusable = |error: pem::Error| Error::Ca { path: path.clone(), source: error };
        for certificate in CertificateDer::pem_file_iter(path).map_err(unusable)? {
            roots.add(certificate.map_err(unusable)?).map_err(Error::Tls)?;
        }
        if roots.is_empty() {
            return Err(unusable(pem::Error::NoItemsFound));
        }
        Ok(builder.with_root_certificates(roots).with_no_client_auth())
    }
}
