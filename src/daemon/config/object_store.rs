//! `[object_store]`

use serde::Deserialize;
use sutura_objects::{S3Config, Secret};

/// The bucket in which the daemons of a fleet keep their sessions.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ObjectStoreConfig {
    /// The bucket; without one, sessions are kept in `[data]`.
    pub(crate) bucket: Option<String>,
    /// Where the store is; `None` for Amazon's of the region.
    pub(crate) endpoint: Option<String>,
    /// The region.
    pub(crate) region: String,
    /// What every object's name begins with.
    pub(crate) prefix: String,
    /// Whether the bucket is part of the host's name rather than of the path.
    pub(crate) virtual_hosted: bool,
    /// Who asks; `None` for `AWS_ACCESS_KEY_ID`.
    pub(crate) access_key_id: Option<String>,
    /// Proves it; `None` for `AWS_SECRET_ACCESS_KEY`.
    #[serde(deserialize_with = "secret")]
    pub(crate) secret_access_key: Option<Secret>,
    /// Comes with keys that expire; `None` for `AWS_SESSION_TOKEN`, if it is set.
    #[serde(deserialize_with = "secret")]
    pub(crate) session_token: Option<Secret>,
}

fn secret<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Option<Secret>, D::Error> {
    Ok(Option::<String>::deserialize(deserializer)?.map(Secret::from))
}

impl Default for ObjectStoreConfig {
    fn default() -> Self {
        Self {
            bucket: None,
            endpoint: None,
            region: "us-east-1".into(),
            prefix: "sutura".into(),
            virtual_hosted: false,
            access_key_id: None,
            secret_access_key: None,
            session_token: None,
        }
    }
}

/// Nobody is named who may use the bucket.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("[object_store] needs {0}, in the file or as {1} in the environment")]
pub(crate) struct NoCredentials(&'static str, &'static str);

impl ObjectStoreConfig {
    /// What the object store needs, with the credentials of the environment where the file has none; `None` if there
    /// is no bucket.
    pub(crate) fn s3(
        &self,
        environment: impl Fn(&str) -> Option<String>,
    ) -> Result<Option<S3Config>, NoCredentials> {
        let Some(bucket) = self.bucket.clone() else { return Ok(None) };
        // Keys belong together: none of one place goes with one of another.
        let (id, secret, token) = match (&self.access_key_id, &self.secret_access_key) {
            (None, None) => (
                environment(ACCESS_KEY_ID),
                environment(SECRET_ACCESS_KEY).map(Secret::from),
                environment(SESSION_TOKEN).map(Secret::from),
            ),
            (id, secret) => (id.clone(), secret.clone(), self.session_token.clone()),
        };
        let missing = |option, variable| NoCredentials(option, variable);
        Ok(Some(S3Config {
            endpoint: self.endpoint.clone(),
            bucket,
            prefix: self.prefix.clone(),
            region: self.region.clone(),
            virtual_hosted: self.virtual_hosted,
            access_key_id: id.ok_or(missing("access_key_id", ACCESS_KEY_ID))?,
            secret_access_key: secret.ok_or(missing("secret_access_key", SECRET_ACCESS_KEY))?,
            session_token: token,
        }))
    }
}

const ACCESS_KEY_ID: &str = "AWS_ACCESS_KEY_ID";
const SECRET_ACCESS_KEY: &str = "AWS_SECRET_ACCESS_KEY";
const SESSION_TOKEN: &str = "AWS_SESSION_TOKEN";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_come_from_one_place() {
        let from_environment = |name: &str| Some(format!("of {name}"));
        let mut config = ObjectStoreConfig::default();
        assert_eq!(config.s3(from_environment), Ok(None));
        config.bucket = Some("b".into());
        let found = config.s3(from_environment).unwrap().unwrap();
        assert_eq!(found.access_key_id, "of AWS_ACCESS_KEY_ID");
        assert_eq!(config.s3(|_| None).unwrap_err().0, "access_key_id");
        config.access_key_id = Some("mine".into());
        assert_eq!(config.s3(from_environment).unwrap_err().0, "secret_access_key");
        config.secret_access_key = Some("hidden".to_owned().into());
        let found = config.s3(from_environment).unwrap().unwrap();
        assert_eq!((&*found.access_key_id, found.session_token), ("mine", None));
        assert!(!format!("{config:?}").contains("hidden"));
    }
}
