//! Who may come in: hosts, origins, tokens. Decided by the head of a request, before its body is read.

use std::net::{IpAddr, Ipv6Addr};
use std::path::Path;
use std::sync::atomic::Ordering;

use axum::extract::{MatchedPath, Request};
use axum::http::{HeaderMap, HeaderValue, Method, Version, header};
use sha2::{Digest, Sha256};
use subtle::ConstantTimeEq;
use tower_http::cors::{AllowHeaders, Any, CorsLayer};

use crate::server::App;
use crate::server::config::Config;
use crate::server::front::REQUEST_ID;
use crate::server::problem::{Code, Problem};

pub(crate) fn admit(app: &App, request: &Request, route: Option<&MatchedPath>) -> Result<(), Problem> {
    let headers = request.headers();
    let host = host(request)?;
    if let Some(host) = host
        && !is_host_allowed(host, &app.config.allow_host)
    {
        let detail =
            format!("the host {host:?} is not allowed; use an address or localhost, or start with --allow-host");
        return Err(Problem::new(Code::HostNotAllowed, detail));
    }
    check_origin(headers, host, &app.config.allow_origin)?;
    // What a browser asks first, for the page of an allowed origin, carries no token.
    if request.method() == Method::OPTIONS && headers.contains_key(header::ACCESS_CONTROL_REQUEST_METHOD) {
        return Ok(());
    }
    // Health checks come from machinery that has no secret, and tell none; they are answered to the end.
    let health = route.is_some_and(|route| matches!(route.as_str(), "/healthz" | "/readyz"));
    if !health && app.draining.load(Ordering::SeqCst) {
        return Err(Problem::plain(Code::ShuttingDown));
    }
    // What explains a refusal is no secret either.
    let open = health || route.is_some_and(|route| route.as_str() == "/problems/{code}");
    match &app.tokens {
        Some(tokens) if !open && !tokens.admit(headers) => Err(Problem::plain(Code::Unauthorized)),
        Some(_) | None => Ok(()),
    }
}

fn host(request: &Request) -> Result<Option<&str>, Problem> {
    let mut hosts = request.headers().get_all(header::HOST).iter();
    let refused = || Problem::new(Code::HostNotAllowed, "a request has one Host header");
    match (hosts.next(), hosts.next()) {
        (Some(host), None) => host.to_str().map(Some).map_err(|_| refused()),
        (Some(_), Some(_)) => Err(refused()),
        (None, _) => match request.uri().authority() {
            Some(authority) => Ok(Some(authority.as_str())),
            None if request.version() == Version::HTTP_10 => Ok(None),
            None => Err(refused()),
        },
    }
}

/// A loopback name, an address, or an allowed name; the port does not matter. A page that reached this service through
/// a name of its own (DNS rebinding) has that name here.
fn is_host_allowed(host: &str, allowed: &[String]) -> bool {
    let is_port = |port: &str| port.bytes().all(|byte| byte.is_ascii_digit());
    if let Some(rest) = host.strip_prefix('[') {
        let Some((address, port)) = rest.split_once(']') else { return false };
        return address.parse::<Ipv6Addr>().is_ok() && port.strip_prefix(':').map_or(port.is_empty(), is_port);
    }
    let name = match host.rsplit_once(':') {
        Some((name, port)) if is_port(port) => name,
        Some(_) => return false,
        None => host,
    };
    let name = name.strip_suffix('.').unwrap_or(name).to_ascii_lowercase();
    name == "localhost"
        || name.ends_with(".localhost")
        || name.parse::<IpAddr>().is_ok()
        || allowed.iter().any(|allowed| allowed.eq_ignore_ascii_case(&name))
}

/// Bodies are read as JSON whatever a plain form calls them, so what a browser sends from another site is refused.
fn check_origin(headers: &HeaderMap, host: Option<&str>, allowed: &[String]) -> Result<(), Problem> {
    let refused = |what: &str| {
        let detail = format!("a browser sent this from {what}; allow that origin with --allow-origin");
        Err(Problem::new(Code::CrossOrigin, detail))
    };
    if let Some(origin) = headers.get(header::ORIGIN) {
        let origin = origin.to_str().unwrap_or("an unreadable origin");
        if allowed.iter().any(|allowed| allowed == origin) {
            return Ok(());
        }
        if host.is_none() || origin.strip_prefix("http://") != host {
            return refused(origin);
        }
    }
    if headers.get("sec-fetch-site").is_some_and(|site| site == "cross-site") {
        return refused("another site");
    }
    Ok(())
}

/// For the pages of allowed origins: what a browser must be told.
pub(crate) fn cors(config: &Config) -> Option<CorsLayer> {
    let origins: Vec<HeaderValue> = config.allow_origin.iter().filter_map(|origin| origin.parse().ok()).collect();
    if origins.is_empty() {
        return None;
    }
    let exposed = [header::ETAG, header::LOCATION, header::RETRY_AFTER, REQUEST_ID];
    Some(
        CorsLayer::new()
            .allow_origin(origins)
            .allow_methods(Any)
            .allow_headers(AllowHeaders::mirror_request())
            .expose_headers(exposed),
    )
}

/// The tokens that open the service; only their hashes are kept.
#[derive(Clone)]
pub struct Tokens(Vec<[u8; 32]>);

impl std::fmt::Debug for Tokens {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} tokens", self.0.len())
    }
}

/// Why tokens could not be read.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// The file.
    #[error("cannot read the token file {path}: {source}")]
    Unreadable {
        /// Its path.
        path: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// No line with a token.
    #[error("the token file {path} has no token; write one a line, for example from `openssl rand -hex 32`")]
    Empty {
        /// Its path.
        path: String,
    },
}

impl Tokens {
    /// Reads a file with one token a line; blank lines and lines that begin with `#` do not count.
    ///
    /// # Errors
    /// When the file cannot be read, or has no token.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        let shown = path.display().to_string();
        let text =
            std::fs::read_to_string(path).map_err(|source| AccessError::Unreadable { path: shown.clone(), source })?;
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
        let tokens: Vec<[u8; 32]> = lines.map(hash).collect();
        if tokens.is_empty() { Err(AccessError::Empty { path: shown }) } else { Ok(Self(tokens)) }
    }

    /// Whether the request carries one of them. Takes the same time for every wrong token.
    fn admit(&self, headers: &HeaderMap) -> bool {
        let given = headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
        let Some((scheme, token)) = given.and_then(|value| value.split_once(' ')) else { return false };
        let given = hash(token.trim());
        let known = self.0.iter().fold(subtle::Choice::from(0), |known, token| known | token.ct_eq(&given));
        scheme.eq_ignore_ascii_case("bearer") && bool::from(known)
    }
}

fn hash(token: &str) -> [u8; 32] {
    Sha256::digest(token.as_bytes()).into()
}

#[cfg(test)]
mod tests {
    use super::is_host_allowed;

    #[test]
    fn hosts() {
        let allowed = ["physics.example".to_owned()];
        for host in [
            "localhost",
            "LOCALHOST:8080",
            "a.localhost",
            "127.0.0.1:1",
            "10.0.0.7",
            "[::1]:80",
            "[::1]",
            "Physics.example:9",
        ] {
            assert!(is_host_allowed(host, &allowed), "{host}");
        }
        for host in [
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "[evil]",
            "",
            "[::1].evil.example",
            "[::1]:80x",
            "127.0.0.1:80@evil.example",
            "physics.example.evil",
        ] {
            assert!(!is_host_allowed(host, &allowed), "{host}");
        }
    }
}
