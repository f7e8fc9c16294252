//! `[tls]`

use serde::Deserialize;
use std::path::PathBuf;
use sutura_transport::TlsFiles;

/// The certificate that both doors show.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct TlsConfig {
    /// PEM file of the certificate, and of those between it and its authority's.
    pub(crate) certificate: Option<PathBuf>,
    /// PEM file of its private key.
    pub(crate) private_key: Option<PathBuf>,
}

/// One of the two is missing.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("[tls] needs both certificate and private_key, or neither")]
pub(crate) struct HalfTls;

impl TlsConfig {
    /// Both files; none if the doors are plain.
    pub(crate) fn files(&self) -> Result<Option<TlsFiles>, HalfTls> {
        match (&self.certificate, &self.private_key) {
            (None, None) => Ok(None),
            (Some(certificate), Some(private_key)) => Ok(Some(TlsFiles {
                certificate: certificate.clone(),
                private_key: private_key.clone(),
            })),
            _ => Err(HalfTls),
        }
    }
}
