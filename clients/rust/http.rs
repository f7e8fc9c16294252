//! The daemon over HTTP.

use crate::credentials::Credentials;
use crate::error::{Error, Result};
use crate::reply;
use crate::session::Session;
use bytes::Bytes;
use reqwest::header::{self, HeaderValue};
use reqwest::multipart::{Form, Part};
use reqwest::{Method, RequestBuilder, Url};
use std::sync::Arc;
use std::time::Duration;
use sutura_proto::media;
use sutura_proto::session::{SessionConfig, SessionInfo, SessionList};

/// How long a connection may take to be made. Answers may take as long as they need: an edit of a
/// large body takes seconds.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);

/// A daemon, reached over HTTP. Cheap to clone; clones share connections.
#[derive(Clone, Debug)]
pub struct Client {
    http: reqwest::Client,
    base: Url,
    tls: Arc<rustls::ClientConfig>,
}

impl Client {
    /// The daemon at `base_url`, such as `http://127.0.0.1:8080`; asks whether it is there.
    pub async fn connect(base_url: &str) -> Result<Client> {
        Client::connect_as(base_url, &Credentials::default()).await
    }

    /// The same, showing a key with every request, or trusting a certificate authority of one's own.
    pub async fn connect_as(base_url: &str, credentials: &Credentials) -> Result<Client> {
        let address = || Error::Address(base_url.to_owned());
        let base = Url::parse(base_url).map_err(|_| address())?;
        if !matches!(base.scheme(), "http" | "https") || base.cannot_be_a_base() {
            return Err(address());
        }
        let tls = credentials.tls()?;
        let mut builder = reqwest::Client::builder()
            .connect_timeout(CONNECT_TIMEOUT)
            .tls_backend_preconfigured(tls.clone());
        if matches!(base.host_str(), Some("localhost" | "127.0.0.1" | "[::1]")) {
            builder = builder.no_proxy();
        }
        if let Some(key) = &credentials.key {
            let bearer = HeaderValue::from_str(&format!("Bearer {key}"));
            let mut bearer = bearer.map_err(|_| Error::Key)?;
            bearer.set_sensitive(true);
            builder =
                builder.default_headers([(header::AUTHORIZATION, bearer)].into_iter().collect());
        }
        let client = Client { http: builder.build()?, base, tls: Arc::new(tls) };
        let response = client.request(Method::GET, &["healthz"])?.send().await?;
        reply::accepted(response).await?;
        Ok(client)
    }

    /// Opens a session on the mesh inside `config`. Returns as soon as the daemon has accepted it;
    /// [`Session::wait_ready`] waits for the build.
    pub async fn create(&self, config: &SessionConfig) -> Result<Session> {
        let request = self.request(Method::POST, &["v1", "sessions"])?.json(config);
        let info: SessionInfo = reply::document(request.send().await?).await?;
        self.session(&info.id)
    }

    /// Opens a session on a mesh file; the extension of `file_name` tells its format.
    pub async fn create_from_file(
        &self,
        file_name: &str,
        mesh: impl Into<Bytes>,
        config: &SessionConfig,
    ) -> Result<Session> {
        let config = Part::bytes(serde_json::to_vec(config)?).mime_str(media::JSON)?;
        let mesh = mesh.into();
        let length = mesh.len() as u64;
        let mesh = Part::stream_with_length(mesh, length)
            .file_name(file_name.to_owned())
            .mime_str("application/octet-stream")?;
        let form = Form::new().part("config", config).part("mesh", mesh);
        let request = self.request(Method::POST, &["v1", "sessions"])?.multipart(form);
        let info: SessionInfo = reply::document(request.send().await?).await?;
        self.session(&info.id)
    }

    /// The session named `id`, whether or not it exists.
    pub fn session(&self, id: &str) -> Result<Session> {
        Session::new(self.clone(), id)
    }

    /// One page of at most `limit` sessions, beginning behind the session `after`.
    pub async fn list(&self, after: Option<&str>, limit: usize) -> Result<SessionList> {
        let mut url = self.url(&["v1", "sessions"])?;
        url.query_pairs_mut().append_pair("limit", &limit.to_string());
        if let Some(after) = after {
            url.query_pairs_mut().append_pair("after", after);
        }
        reply::document(self.http.get(url).send().await?).await
    }

    /// A request to the path made of `segments`.
    pub(crate) fn request(&self, method: Method, segments: &[&str]) -> Result<RequestBuilder> {
        Ok(self.http.request(method, self.url(segments)?))
    }

    /// A `GET` of `url`.
    pub(crate) fn get(&self, url: Url) -> RequestBuilder {
        self.http.get(url)
    }

    /// Whom an `https` address is to be trusted by.
    pub(crate) fn tls(&self) -> Arc<rustls::ClientConfig> {
        self.tls.clone()
    }

    /// The address of the path made of `segments`.
    pub(crate) fn url(&self, segments: &[&str]) -> Result<Url> {
        let mut url = self.base.clone();
        let address = || Error::Address(self.base.to_string());
        url.path_segments_mut().map_err(|()| address())?.pop_if_empty().extend(segments);
        Ok(url)
    }
}
