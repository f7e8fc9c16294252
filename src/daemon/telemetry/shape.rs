//! How a collector sees our spans: under the names that OpenTelemetry's conventions have for them.

use opentelemetry::trace::{SpanKind, Status};
use opentelemetry::{Key, KeyValue, Value};
use opentelemetry_sdk::trace::SpanData;

/// Attributes of a request over HTTP, here and there.
const OF_REQUEST: [(&str, &str); 4] = [
    ("method", "http.request.method"),
    ("path", "url.path"),
    ("route", "http.route"),
    ("status", "http.response.status_code"),
];

/// Lowest status of an answer that is the daemon's fault.
const SERVER_ERROR: i64 = 500;

/// The span with a name that tells it from others of its sort.
pub(super) fn shaped(mut span: SpanData) -> SpanData {
    let found = |key: &str| span.attributes.iter().find(|pair| pair.key.as_str() == key);
    let text = |key: &str| found(key).map(|pair| pair.value.as_str().into_owned());
    let name = match &*span.name {
        "request" => {
            let [method, route] = ["method", "route"].map(|key| text(key).unwrap_or_default());
            format!("{method} {route}").trim_end().to_owned()
        }
        "query" => format!("query {}", text("resource").unwrap_or_default()),
        "task" => format!("{} task", text("kind").unwrap_or_default()),
        "stage" => text("stage").unwrap_or_default(),
        _ => return span,
    };
    if matches!(&*span.name, "request" | "query") {
        span.span_kind = SpanKind::Server;
        if let Some(KeyValue { value: Value::I64(SERVER_ERROR..), .. }) = found("status") {
            span.status = Status::error("");
        }
    }
    if span.name == "request" {
        for pair in &mut span.attributes {
            if let Some((_, there)) = OF_REQUEST.iter().find(|(here, _)| pair.key.as_str() == *here)
            {
                pair.key = Key::from_static_str(there);
            }
        }
    }
    span.name = name.into();
    span
}

#[cfg(test)]
mod tests {
    use super::*;
    use opentelemetry::trace::{SpanContext, SpanId};
    use std::time::SystemTime;

    fn told(name: &'static str, attributes: &[(&'static str, Value)]) -> SpanData {
        let pair = |(key, value): &(&'static str, Value)| KeyValue::new(*key, value.clone());
        shaped(SpanData {
            span_context: SpanContext::NONE,
            parent_span_id: SpanId::INVALID,
            parent_span_is_remote: false,
            span_kind: SpanKind::Internal,
            name: name.into(),
            start_time: SystemTime::UNIX_EPOCH,
            end_time: SystemTime::UNIX_EPOCH,
            attributes: attributes.iter().map(pair).collect(),
            dropped_attributes_count: 0,
            events: Default::default(),
            links: Default::default(),
            status: Status::Unset,
            instrumentation_scope: Default::default(),
        })
    }

    #[test]
    fn a_span_is_called_by_what_it_is_about() {
        let [get, route] = [("method", "GET".into()), ("route", "/v1/sessions".into())];
        assert_eq!(told("request", &[get.clone(), route]).name, "GET /v1/sessions");
        // Of a client that went away no route is known.
        assert_eq!(told("request", &[get]).name, "GET");
        assert_eq!(told("query", &[("resource", "edits".into())]).name, "query edits");
        assert_eq!(told("task", &[("kind", "edit".into())]).name, "edit task");
        assert_eq!(told("stage", &[("stage", "modes".into())]).name, "modes");
        assert_eq!(told("restore", &[]).name, "restore");
    }

    #[test]
    fn what_the_daemon_is_to_blame_for_is_an_error() {
        for name in ["request", "query"] {
            let of = |status: i64| told(name, &[("status", Value::I64(status))]);
            assert_eq!([200, 499].map(|status| of(status).status), [Status::Unset, Status::Unset]);
            assert_eq!(
                [500, 503].map(|status| of(status).status),
                [Status::error(""), Status::error("")]
            );
            assert_eq!(of(200).span_kind, SpanKind::Server);
        }
    }
}
