//! What is answered when all is well.

use std::sync::Arc;

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use crate::server::coding::Coding;
use crate::server::content::Content;
use crate::server::encoding::Encoding;
use crate::server::extract::etag;
use crate::server::idempotency::IDEMPOTENCY_REPLAYED;
use crate::server::memory::Charge;
use crate::server::slot::Shared;

/// An answer that is not a refusal.
#[derive(Debug, Clone)]
pub(crate) struct Reply {
    pub(crate) status: StatusCode,
    pub(crate) content: Content,
    location: Option<String>,
    revision: Option<u64>,
    pub(crate) is_replayed: bool,
}

impl Reply {
    fn new(status: StatusCode, content: Content) -> Self {
        Self { status, content, location: None, revision: None, is_replayed: false }
    }

    pub(crate) fn of(content: Content) -> Self {
        Self::new(StatusCode::OK, content)
    }

    /// One value.
    pub(crate) fn ok<T: Serialize>(encoding: Encoding, value: &T) -> Self {
        Self::of(Content::of(encoding, value))
    }

    pub(crate) fn no_content() -> Self {
        Self::new(StatusCode::NO_CONTENT, Content::empty())
    }

    pub(crate) fn not_modified() -> Self {
        Self::new(StatusCode::NOT_MODIFIED, Content::empty())
    }

    pub(crate) fn created(self, location: Option<String>) -> Self {
        Self { status: StatusCode::CREATED, location, ..self }
    }

    /// Of a world at this revision.
    pub(crate) fn at(self, revision: u64) -> Self {
        Self { revision: Some(revision), ..self }
    }

    /// Once more, to a request that was sent again.
    pub(crate) fn replayed(self) -> Self {
        Self { is_replayed: true, ..self }
    }

    /// With nothing left to be written.
    pub(crate) fn whole(self) -> Self {
        Self { content: self.content.whole(), ..self }
    }

    /// Packed, where the client asks for it and it pays.
    pub(crate) fn coded(self, coding: Option<Coding>, shared: &Arc<Shared>) -> Self {
        Self { content: self.content.coded(coding, shared), ..self }
    }

    /// Gives the charge back when the content is on its way.
    pub(crate) fn charged(self, charge: Charge) -> Self {
        Self { content: self.content.charged(charge), ..self }
    }
}

impl IntoResponse for Reply {
    fn into_response(self) -> Response {
        let (content_type, coding) = (self.content.encoding.content_type(), self.content.coding);
        let mut response = Response::new(self.content.into_body());
        *response.status_mut() = self.status;
        let headers = response.headers_mut();
        if matches!(self.status, StatusCode::OK | StatusCode::CREATED) {
            headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(content_type));
        }
        if let Some(coding) = coding {
            headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(coding.name()));
            headers.insert(header::VARY, HeaderValue::from_static("accept, accept-encoding"));
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
