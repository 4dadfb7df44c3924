//! `/` and `/docs`: the way in for a person.

use std::io::Read;
use std::sync::{Arc, LazyLock};

use axum::body::Bytes;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use flate2::read::GzDecoder;
use sha2::{Digest, Sha256};
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::server::App;
use crate::server::coding::Coding;
use crate::server::encoding::ranges;
use crate::server::extract::no_parameters;
use crate::server::problem::{Code, Problem};

pub(crate) fn routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new()
        .routes(routes!(welcome))
        .routes(routes!(docs))
        .routes(routes!(docs_in_folder))
        .routes(routes!(docs_asset))
}

/// A file of the page.
struct Asset {
    name: &'static str,
    content_type: &'static str,
    /// Nothing where packing does not pay.
    packed: Option<&'static [u8]>,
    plain: Bytes,
    /// Hexadecimal digits of the bytes as they are stored.
    hash: String,
}

/// Unpacked when the page is first asked for.
static ASSETS: LazyLock<[Asset; 4]> = LazyLock::new(|| {
    let (html, css, script) = ("text/html; charset=utf-8", "text/css; charset=utf-8", "text/javascript; charset=utf-8");
    [
        Asset::plain("index.html", html, include_bytes!("../docs/index.html")),
        Asset::plain("start.js", script, include_bytes!("../docs/start.js")),
        Asset::packed("swagger-ui.css", css, include_bytes!("../docs/swagger-ui.css.gz")),
        Asset::packed("swagger-ui-bundle.js", script, include_bytes!("../docs/swagger-ui-bundle.js.gz")),
    ]
});

/// Scripts and requests of this origin alone. Swagger UI sets styles on elements, and its icons are data in its styles.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; \
     connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

impl Asset {
    fn plain(name: &'static str, content_type: &'static str, stored: &'static [u8]) -> Self {
        Self { name, content_type, packed: None, plain: Bytes::from_static(stored), hash: hash(stored) }
    }

    fn packed(name: &'static str, content_type: &'static str, stored: &'static [u8]) -> Self {
        let mut plain = Vec::new();
        GzDecoder::new(stored).read_to_end(&mut plain).expect("a test unpacks what is built in");
        Self { name, content_type, packed: Some(stored), plain: plain.into(), hash: hash(stored) }
    }

    fn named(name: &str) -> Result<&'static Self, Problem> {
        ASSETS.iter().find(|asset| asset.name == name).ok_or_else(|| Problem::plain(Code::UnknownRoute))
    }

    /// As the client takes it, or the news that it has it.
    fn answer(&self, headers: &HeaderMap) -> Response {
        let packed = self.packed.filter(|_| Coding::Gzip.is_accepted(headers));
        let etag = format!("\"{}{}\"", self.hash, if packed.is_some() { "-gzip" } else { "" });
        let is_known = headers.get_all(header::IF_NONE_MATCH).iter().any(|tags| {
            let mut tags = tags.to_str().unwrap_or_default().split(',').map(|tag| tag.trim().trim_start_matches("W/"));
            tags.any(|tag| tag == "*" || tag == etag)
        });
        let mut response = if is_known {
            StatusCode::NOT_MODIFIED.into_response()
        } else {
            packed.map_or_else(|| self.plain.clone(), Bytes::from_static).into_response()
        };
        let answered = response.headers_mut();
        if !is_known {
            answered.insert(header::CONTENT_TYPE, HeaderValue::from_static(self.content_type));
            answered.insert(header::CONTENT_SECURITY_POLICY, POLICY);
            if packed.is_some() {
                answered.insert(header::CONTENT_ENCODING, HeaderValue::from_static(Coding::Gzip.name()));
            }
        }
        answered.insert(header::ETAG, etag.try_into().expect("hexadecimal digits"));
        // Kept by browsers, and asked for anew: another version of the service may stand here tomorrow.
        answered.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
        answered.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
        answered.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
        response
    }
}

fn hash(bytes: &[u8]) -> String {
    let digest: [u8; 32] = Sha256::digest(bytes).into();
    let beginning = digest.first_chunk().expect("32 bytes are more than 16");
    format!("{:032x}", u128::from_be_bytes(*beginning))
}

/// Leads to the page, the description and the API
///
/// A browser (`Accept: text/html`) is sent to `/docs`; others get the addresses as text.
#[utoipa::path(get, path = "/", tag = "service", responses(
    (status = 200, body = String, content_type = "text/plain"),
    (status = 303, description = "To the page, for a browser", headers(("location" = String))),
))]
async fn welcome(uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    no_parameters(&uri)?;
    let is_browser = ranges(&headers).iter().any(|(range, weight)| range == "text/html" && *weight > 0.0);
    let mut response = if is_browser {
        (StatusCode::SEE_OTHER, [(header::LOCATION, "/docs")]).into_response()
    } else {
        let version = env!("CARGO_PKG_VERSION");
        format!(
            "pointmass {version}: worlds of point-mass particles over HTTP\n\n\
             /docs          a page over every route, to try them in a browser\n\
             /openapi.json  the OpenAPI description, for programs\n\
             /v1            the API: what it can do, and its limits\n"
        )
        .into_response()
    };
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
    Ok(response)
}

/// A page over every route
///
/// It tries them out, and needs no other origin.
#[utoipa::path(get, path = "/docs", tag = "service", responses(
    (status = 200, body = String, content_type = "text/html"),
    (status = 304, description = "Not modified"),
))]
async fn docs(uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    no_parameters(&uri)?;
    Asset::named("index.html").map(|page| page.answer(&headers))
}

/// The same page
///
/// Where its links lead when they are followed or loaded again.
#[utoipa::path(get, path = "/docs/", tag = "service", responses(
    (status = 200, body = String, content_type = "text/html"),
    (status = 304, description = "Not modified"),
))]
async fn docs_in_folder(uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    docs(uri, headers).await
}

/// A part of that page
#[utoipa::path(get, path = "/docs/{asset}", tag = "service",
    params(("asset" = String, Path, example = "start.js")),
    responses(
        (status = 200, content((String = "text/javascript"), (String = "text/css"))),
        (status = 304, description = "Not modified"),
    ))]
async fn docs_asset(Path(asset): Path<String>, uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    no_parameters(&uri)?;
    Asset::named(&asset).map(|asset| asset.answer(&headers))
}
