//! `[telemetry]`

use super::bounds::{fraction, queue, seconds};
use reqwest::Url;
use reqwest::header::{HeaderMap, HeaderName, HeaderValue};
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;
use std::time::Duration;
use sutura_objects::Secret;

/// Where the traces of what the daemon does go.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct TelemetryConfig {
    /// The collector; without one, nothing is exported.
    pub(crate) otlp_endpoint: Option<CollectorUrl>,
    /// Sent along with every batch.
    #[serde(deserialize_with = "secrets")]
    pub(crate) otlp_headers: BTreeMap<String, Secret>,
    /// What the daemon is called there.
    pub(crate) service_name: String,
    /// Which of those it is; `None` for its name in `[zenoh]`.
    pub(crate) service_instance: Option<String>,
    /// Share of traces that are exported, 0 to 1. Where a caller's trace goes on, the caller has decided.
    #[serde(deserialize_with = "fraction")]
    pub(crate) sampling_ratio: f64,
    /// Spans that may wait to be sent; beyond, they are lost.
    #[serde(deserialize_with = "queue")]
    pub(crate) span_queue_limit: usize,
    /// Longest time that a span waits for others to be sent with.
    #[serde(rename = "export_interval_s", deserialize_with = "seconds")]
    pub(crate) export_interval: Duration,
    /// How long the collector may take to accept a batch.
    #[serde(rename = "export_timeout_s", deserialize_with = "seconds")]
    pub(crate) export_timeout: Duration,
}

fn secrets<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<BTreeMap<String, Secret>, D::Error> {
    let texts = BTreeMap::<String, String>::deserialize(deserializer)?;
    Ok(texts.into_iter().map(|(name, text)| (name, text.into())).collect())
}

impl Default for TelemetryConfig {
    fn default() -> Self {
        Self {
            otlp_endpoint: None,
            otlp_headers: BTreeMap::new(),
            service_name: "sutura".into(),
            service_instance: None,
            sampling_ratio: 1.0,
            span_queue_limit: 4096,
            export_interval: Duration::from_secs(5),
            export_timeout: Duration::from_secs(5),
        }
    }
}

/// A header that cannot be sent. Its value is nobody's to read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("[telemetry] otlp_headers: {0:?} is no header that can be sent, by its name or its value")]
pub(crate) struct BadHeader(String);

impl TelemetryConfig {
    /// The headers, which no `Debug` shows. Not checked as the file is read: its errors quote the line.
    pub(crate) fn headers(&self) -> Result<HeaderMap, BadHeader> {
        let header = |(name, value): (&String, &Secret)| {
            let bad = || BadHeader(name.clone());
            let known = HeaderName::try_from(name).map_err(|_| bad())?;
            let mut value = HeaderValue::try_from(value.reveal()).map_err(|_| bad())?;
            value.set_sensitive(true);
            Ok((known, value))
        };
        self.otlp_headers.iter().map(header).collect()
    }
}

/// The base of a collector's addresses, as OTLP over HTTP has them: plain or TLS, without credentials.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub(crate) struct CollectorUrl(Url);

/// The text is no such address. It is not repeated: it may hold a password.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a collector's address is http://HOST[:PORT][/PATH] or https://…: {0}")]
pub(crate) struct NotACollector(&'static str);

impl TryFrom<String> for CollectorUrl {
    type Error = NotACollector;
    fn try_from(text: String) -> Result<Self, Self::Error> {
        let url = Url::parse(&text).map_err(|_| NotACollector("this is none"))?;
        if !matches!(url.scheme(), "http" | "https") {
            return Err(NotACollector("this has another scheme"));
        }
        if !url.username().is_empty() || url.password().is_some() {
            return Err(NotACollector("credentials go into otlp_headers"));
        }
        if url.query().is_some() || url.fragment().is_some() {
            return Err(NotACollector("nothing may follow the path"));
        }
        Ok(Self(url))
    }
}

impl CollectorUrl {
    /// Where it takes traces.
    pub(crate) fn traces(&self) -> Url {
        let mut url = self.0.clone();
        // Only addresses without a host have no segments.
        if let Ok(mut segments) = url.path_segments_mut() {
            segments.pop_if_empty().extend(["v1", "traces"]);
        }
        url
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    fn read(text: &str) -> Result<TelemetryConfig, String> {
        let config = Config::parse(&format!("[telemetry]\n{text}"));
        config.map(|config| config.telemetry).map_err(|error| error.to_string())
    }

    #[test]
    fn a_collector_is_asked_where_otlp_says() {
        for (base, traces) in [
            ("http://127.0.0.1:4318", "http://127.0.0.1:4318/v1/traces"),
            ("http://[::1]:4318/", "http://[::1]:4318/v1/traces"),
            ("https://otlp.example/of/us", "https://otlp.example/of/us/v1/traces"),
            ("https://otlp.example/of/us/", "https://otlp.example/of/us/v1/traces"),
        ] {
            let config = read(&format!("otlp_endpoint = {base:?}")).unwrap();
            assert_eq!(config.otlp_endpoint.unwrap().traces().as_str(), traces);
        }
    }

    #[test]
    fn what_is_no_collector_is_refused_with_its_line() {
        for (text, told) in [
            ("otlp_endpoint = \"127.0.0.1:4318\"", "this is none"),
            ("otlp_endpoint = \"\"", "this is none"),
            ("otlp_endpoint = \"http://\"", "this is none"),
            ("otlp_endpoint = \"grpc://localhost:4317\"", "another scheme"),
            ("otlp_endpoint = \"https://me:hidden@otlp.example\"", "otlp_headers"),
            ("otlp_endpoint = \"https://otlp.example/?key=hidden\"", "follow the path"),
            ("sampling_ratio = 1.5", "between 0 and 1"),
            ("sampling_ratio = nan", "between 0 and 1"),
            ("span_queue_limit = 0", "between 1 and"),
            ("export_timeout_s = 0.0", "not positive"),
            ("endpoint = \"http://127.0.0.1:4318\"", "unknown field"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains("line 2") && error.contains(told), "{text}: {error}");
        }
    }

    #[test]
    fn headers_are_sent_and_never_shown() {
        let config = read("otlp_headers = { authorization = \"Bearer hidden\" }").unwrap();
        let headers = config.headers().unwrap();
        assert_eq!(headers["authorization"], "Bearer hidden");
        assert!(!format!("{config:?}{headers:?}").contains("hidden"));
        for text in ["\"not a name\" = \"hidden\"", "authorization = \"hidden\\nhidden\""] {
            let config = read(&format!("otlp_headers = {{ {text} }}")).unwrap();
            let error = config.headers().unwrap_err().to_string();
            assert!(error.contains("otlp_headers") && !error.contains("hidden"), "{error}");
        }
    }
}
