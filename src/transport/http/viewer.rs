//! The viewer: files that were embedded when the daemon was built (`build.rs`).

use crate::gateway::Gateway;
use crate::problem::{Kind, Problem};
use axum::Router;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

/// A file of the viewer.
struct File {
    /// Its path below `/`.
    path: &'static str,
    /// Its entity tag, quotes included.
    tag: &'static str,
    plain: &'static [u8],
    /// The same, compressed, where that pays.
    gzip: Option<&'static [u8]>,
}

/// The viewer; empty if it was not there when the daemon was built.
const FILES: &[File] = include!(concat!(env!("OUT_DIR"), "/viewer.rs"));

/// What `/` shows without a viewer.
const WITHOUT_VIEWER: File = File {
    path: "index.html",
    tag: concat!("\"without-viewer-", env!("CARGO_PKG_VERSION"), "\""),
    plain: include_bytes!("without_viewer.html"),
    gzip: None,
};

/// The viewer talks to this daemon and to nobody else, and runs nothing but its own files.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// The viewer's own files; its page is [`page`].
pub(super) fn assets() -> Router<Gateway> {
    Router::new().route("/assets/{name}", get(asset))
}

/// GET /
pub(super) async fn page(headers: HeaderMap) -> Response {
    let page = FILES.iter().find(|file| file.path == WITHOUT_VIEWER.path);
    reply(page.unwrap_or(&WITHOUT_VIEWER), "no-cache", &headers)
}

/// GET /assets/{name}: names carry a hash of the content, which therefore never changes.
async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Response {
    match FILES.iter().find(|file| file.path.strip_prefix("assets/") == Some(&name)) {
        Some(file) => reply(file, "public, max-age=31536000, immutable", &headers),
        None => Problem::new(Kind::NoRoute, "the viewer has no such file").into_response(),
    }
}

fn reply(file: &'static File, caching: &'static str, request: &HeaderMap) -> Response {
    let fixed: [(HeaderName, &'static str); 6] = [
        (header::CACHE_CONTROL, caching),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::ETAG, file.tag),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::VARY, "accept-encoding"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    let is_held = |value: &HeaderValue| {
        value.to_str().is_ok_and(|tags| tags.split(',').any(|tag| tag.trim() == file.tag))
    };
    if request.get(header::IF_NONE_MATCH).is_some_and(is_held) {
        return (StatusCode::NOT_MODIFIED, fixed).into_response();
    }
    let content_type = [(header::CONTENT_TYPE, media_type(file.path))];
    match file.gzip.filter(|_| takes_gzip(request)) {
        Some(bytes) => {
            (fixed, content_type, [(header::CONTENT_ENCODING, "gzip")], bytes).into_response()
        }
        None => (fixed, content_type, file.plain).into_response(),
    }
}

fn takes_gzip(request: &HeaderMap) -> bool {
    let accepted = request.get_all(header::ACCEPT_ENCODING).iter();
    accepted.filter_map(|value| value.to_str().ok()).flat_map(|value| value.split(',')).any(
        |coding| {
            let (name, quality) = coding.split_once(';').unwrap_or((coding, ""));
            let quality = quality.trim().strip_prefix("q=").unwrap_or("1");
            name.trim().eq_ignore_ascii_case("gzip") && quality.parse().is_ok_and(|q: f32| q > 0.0)
        },
    )
}

fn media_type(path: &str) -> &'static str {
    match path.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("woff2") => "font/woff2",
        _ => "application/octet-stream",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(name: HeaderName, value: &'static str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_static(value))])
    }

    const FILE: File =
        File { path: "assets/a.js", tag: "\"1\"", plain: b"plain", gzip: Some(b"small") };

    #[test]
    fn compressed_files_go_to_those_who_take_them() {
        for (accepted, is_compressed) in [
            ("gzip", true),
            ("br, GZIP;q=0.5", true),
            ("gzip;q=0", false),
            ("br", false),
            ("", false),
        ] {
            let reply = reply(&FILE, "no-cache", &request(header::ACCEPT_ENCODING, accepted));
            let encoded = reply.headers().contains_key(header::CONTENT_ENCODING);
            assert_eq!(encoded, is_compressed, "{accepted}");
            assert_eq!(reply.headers()[header::VARY], "accept-encoding");
        }
    }

    #[test]
    fn what_a_client_holds_is_not_sent_again() {
        let held = reply(&FILE, "no-cache", &request(header::IF_NONE_MATCH, "\"0\", \"1\""));
        assert_eq!(held.status(), StatusCode::NOT_MODIFIED);
        let other = reply(&FILE, "no-cache", &request(header::IF_NONE_MATCH, "\"2\""));
        assert_eq!(other.status(), StatusCode::OK);
    }

    #[test]
    fn the_page_names_only_files_that_are_there() {
        let page = FILES.iter().find(|file| file.path == "index.html").unwrap_or(&WITHOUT_VIEWER);
        let text = std::str::from_utf8(page.plain).unwrap();
        for link in text.split("\"/assets/").skip(1) {
            let name = format!("assets/{}", link.split('"').next().unwrap());
            assert!(FILES.iter().any(|file| file.path == name), "{name}");
        }
        assert!(!text.contains("<script>") && !text.contains("<style>"), "the policy forbids it");
    }
}
