//! Reading HTTP answers: never more than a limit, errors as problem documents.

use crate::error::{Error, Result};
use reqwest::Response;
use serde::de::DeserializeOwned;
use sutura_proto::{Problem, media};

/// Largest document read.
const MAX_DOCUMENT_BYTES: usize = 64 << 20;
/// Largest array or frame of arrays read.
const MAX_ARRAY_BYTES: usize = 2 << 30;
/// How much of an answer that is no problem document an error quotes.
const MAX_QUOTED_CHARS: usize = 300;

/// The answer, or the error it stands for.
pub(crate) async fn accepted(response: Response) -> Result<Response> {
    let status = response.status();
    if status.is_success() || status.is_informational() {
        return Ok(response);
    }
    let is_problem = content_type(&response).starts_with(media::PROBLEM_JSON);
    let body = read(response, MAX_DOCUMENT_BYTES).await?;
    if is_problem && let Ok(problem) = serde_json::from_slice::<Problem>(&body) {
        return Err(Error::Problem(Box::new(problem)));
    }
    let body = String::from_utf8_lossy(&body).chars().take(MAX_QUOTED_CHARS).collect();
    Err(Error::Status { status: status.as_u16(), body })
}

/// The document that an accepted answer carries.
pub(crate) async fn document<T: DeserializeOwned>(response: Response) -> Result<T> {
    let body = read(accepted(response).await?, MAX_DOCUMENT_BYTES).await?;
    Ok(serde_json::from_slice(&body)?)
}

/// The frame of arrays that an accepted answer carries.
pub(crate) async fn frame(response: Response) -> Result<Vec<u8>> {
    let response = accepted(response).await?;
    if content_type(&response) != media::FRAME {
        let found = content_type(&response).to_owned();
        return Err(Error::Decode(format!("{found:?} instead of {}", media::FRAME)));
    }
    read(response, MAX_ARRAY_BYTES).await
}

fn content_type(response: &Response) -> &str {
    let value = response.headers().get(reqwest::header::CONTENT_TYPE);
    value.and_then(|value| value.to_str().ok()).unwrap_or_default()
}

async fn read(mut response: Response, limit: usize) -> Result<Vec<u8>> {
    // The announced length sizes the buffer, but only up to what is plausible before bytes arrive.
    let announced = response.content_length().and_then(|n| usize::try_from(n).ok()).unwrap_or(0);
    if announced > limit {
        return Err(Error::TooLarge { limit });
    }
    let mut body = Vec::with_capacity(announced.min(MAX_DOCUMENT_BYTES));
    while let Some(chunk) = response.chunk().await? {
        if body.len() + chunk.len() > limit {
            return Err(Error::TooLarge { limit });
        }
        body.extend_from_slice(&chunk);
    }
    Ok(body)
}
