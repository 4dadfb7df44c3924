//! What is answered when all is well.

use axum::body::{Body, Bytes};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use crate::server::extract::etag;
use crate::server::idempotency::IDEMPOTENCY_REPLAYED;
use crate::server::memory::Charge;

/// An answer that is not a refusal.
#[derive(Debug, Clone)]
pub(crate) struct Reply {
    pub(crate) status: StatusCode,
    pub(crate) body: Bytes,
    location: Option<String>,
    revision: Option<u64>,
    pub(crate) is_replayed: bool,
}

impl Reply {
    fn new(status: StatusCode, body: impl Into<Bytes>) -> Self {
        Self { status, body: body.into(), location: None, revision: None, is_replayed: false }
    }

    pub(crate) fn ok(body: Vec<u8>) -> Self {
        Self::new(StatusCode::OK, body)
    }

    pub(crate) fn no_content() -> Self {
        Self::new(StatusCode::NO_CONTENT, Bytes::new())
    }

    pub(crate) fn not_modified() -> Self {
        Self::new(StatusCode::NOT_MODIFIED, Bytes::new())
    }

    pub(crate) fn created(location: Option<String>, body: Vec<u8>) -> Self {
        Self { location, ..Self::new(StatusCode::CREATED, body) }
    }

    /// Of a world at this revision.
    pub(crate) fn at(self, revision: u64) -> Self {
        Self { revision: Some(revision), ..self }
    }

    /// Once more, to a request that was sent again.
    pub(crate) fn replayed(self) -> Self {
        Self { is_replayed: true, ..self }
    }

    /// Gives the charge back when the body is on its way.
    pub(crate) fn charged(self, charge: Charge) -> Self {
        struct Charged(Bytes, #[expect(dead_code, reason = "lives as long as the body")] Charge);
        impl AsRef<[u8]> for Charged {
            fn as_ref(&self) -> &[u8] {
                &self.0
            }
        }
        Self { body: Bytes::from_owner(Charged(self.body, charge)), ..self }
    }
}

impl IntoResponse for Reply {
    fn into_response(self) -> Response {
        let mut response = Response::new(Body::from(self.body));
        *response.status_mut() = self.status;
        let headers = response.headers_mut();
        if matches!(self.status, StatusCode::OK | StatusCode::CREATED) {
            headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
        }
        if let Some(location) = self.location {
            headers.insert(header::LOCATION, location.try_into().expect("names of worlds are valid in headers"));
        }
        if let Some(revision) = self.revision {
            headers.insert(header::ETAG, etag(revision).try_into().expect("digits in quotes"));
        }
        if self.is_replayed {
            headers.insert(IDEMPOTENCY_REPLAYED, HeaderValue::from_static("true"));
        }
        response
    }
}
