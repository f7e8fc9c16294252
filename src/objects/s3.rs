//! Where the objects are.

use crate::Objects;
use object_store::aws::AmazonS3Builder;
use object_store::{BackoffConfig, ClientOptions, RetryConfig};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;
use sutura_store::StorageError;

/// Longest time that one request may take.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest time in which a connection has to come about.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Times a request is sent again where that does no harm.
const MAX_RETRIES: usize = 2;
/// Longest time from the first sending to the last.
const RETRY_TIMEOUT: Duration = Duration::from_secs(10);

/// What nobody is to read: neither shown nor logged.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Secret(String);

impl From<String> for Secret {
    fn from(text: String) -> Secret {
        Secret(text)
    }
}

impl Secret {
    /// The text, for whom it is meant.
    pub fn reveal(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("…")
    }
}

/// A bucket of an S3-compatible store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct S3Config {
    /// Such as `https://minio.example:9000`; `None` for Amazon's of the region.
    pub endpoint: Option<String>,
    /// The bucket, which exists.
    pub bucket: String,
    /// What every object's name begins with; may be empty.
    pub prefix: String,
    /// The region.
    pub region: String,
    /// Whether the bucket is part of the host's name rather than of the path.
    pub virtual_hosted: bool,
    /// Who asks.
    pub access_key_id: String,
    /// Proves it.
    pub secret_access_key: Secret,
    /// Comes with keys that expire.
    pub session_token: Option<Secret>,
}

impl Objects {
    /// Takes a bucket for a daemon of this name. Blocks until the store has shown that it keeps to the conditions of
    /// a put; fails if it does not, or cannot be reached.
    pub fn s3(config: &S3Config, daemon: &str) -> Result<Objects, StorageError> {
        // The only provider in this program; installed already where another client came first.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let is_plain = config.endpoint.as_ref().is_some_and(|url| url.starts_with("http://"));
        let client = ClientOptions::new()
            .with_timeout(REQUEST_TIMEOUT)
            .with_connect_timeout(CONNECT_TIMEOUT)
            .with_allow_http(is_plain);
        let retry = RetryConfig {
            backoff: BackoffConfig::default(),
            max_retries: MAX_RETRIES,
            retry_timeout: RETRY_TIMEOUT,
        };
        let mut builder = AmazonS3Builder::new()
            .with_bucket_name(&config.bucket)
            .with_region(&config.region)
            .with_virtual_hosted_style_request(config.virtual_hosted)
            .with_access_key_id(&config.access_key_id)
            .with_secret_access_key(&config.secret_access_key.0)
            .with_client_options(client)
            .with_retry(retry);
        if let Some(endpoint) = &config.endpoint {
            builder = builder.with_endpoint(endpoint);
        }
        if let Some(Secret(token)) = &config.session_token {
            builder = builder.with_token(token);
        }
        let place = match &config.endpoint {
            Some(endpoint) => format!("{endpoint}/{}", config.bucket),
            None => format!("the bucket {} in {}", config.bucket, config.region),
        };
        let store = builder.build().map_err(|error| StorageError {
            action: "opening",
            name: place.clone(),
            source: std::io::Error::other(error),
        })?;
        Objects::open(Arc::new(store), &config.prefix, daemon)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_are_not_shown() {
        let config = S3Config {
            endpoint: None,
            bucket: "b".into(),
            prefix: String::new(),
            region: "r".into(),
            virtual_hosted: false,
            access_key_id: "id".into(),
            secret_access_key: "hidden".to_owned().into(),
            session_token: Some("hidden too".to_owned().into()),
        };
        assert!(!format!("{config:?}").contains("hidden"));
    }
}
