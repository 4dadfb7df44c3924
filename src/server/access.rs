//! Who may come in: hosts, origins, tokens. Decided by the head of a request, before its body is read.

use std::fs::File;
use std::io::Read;
use std::net::{IpAddr, Ipv6Addr};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::PoisonError;
use std::sync::atomic::Ordering;

use axum::extract::Request;
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Method, Version, header};
use sha2::{Digest, Sha256};
use subtle::{Choice, ConstantTimeEq};
use tower_http::cors::{AllowHeaders, Any, CorsLayer};

use crate::server::App;
use crate::server::config::{Config, READ_ONLY_TOKEN, TOKEN};
use crate::server::front::REQUEST_ID;
use crate::server::idempotency::IDEMPOTENCY_REPLAYED;
use crate::server::problem::{Code, Problem};

/// Routes that need no token: they tell no secret of a world. What explains a refusal and leads to the rest is among them.
pub(crate) const OPEN: [&str; 8] =
    ["/", "/docs", "/docs/", "/docs/{asset}", "/openapi.json", "/healthz", "/readyz", "/problems/{code}"];

pub(crate) fn admit(app: &App, request: &Request, route: Option<&str>) -> Result<(), Problem> {
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
    let health = matches!(route, Some("/healthz" | "/readyz"));
    if !health && app.draining.load(Ordering::SeqCst) {
        return Err(Problem::plain(Code::ShuttingDown));
    }
    let open = route.is_some_and(|route| OPEN.contains(&route));
    match &app.tokens {
        Some(tokens) if !open => {
            tokens.read().unwrap_or_else(PoisonError::into_inner).admit(headers, !request.method().is_safe())
        }
        Some(_) | None => Ok(()),
    }
}

fn host(request: &Request) -> Result<Option<&str>, Problem> {
    let mut hosts = request.headers().get_all(header::HOST).iter();
    let refused = || Problem::new(Code::HostNotAllowed, "a request has one Host header, which is that of its target");
    let authority = request.uri().authority().map(Authority::as_str);
    match (hosts.next(), hosts.next()) {
        // Where the target names a host too, it is the same.
        (Some(host), None) if authority.is_none_or(|authority| host == authority) => {
            host.to_str().map(Some).map_err(|_| refused())
        }
        (Some(_), _) => Err(refused()),
        (None, _) => match authority {
            Some(authority) => Ok(Some(authority)),
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
    let exposed = [header::ETAG, header::LOCATION, header::RETRY_AFTER, IDEMPOTENCY_REPLAYED, REQUEST_ID];
    Some(
        CorsLayer::new()
            .allow_origin(origins)
            .allow_methods(Any)
            .allow_headers(AllowHeaders::mirror_request())
            .expose_headers(exposed),
    )
}

/// The tokens that open the service; only their hashes are kept.
#[derive(Clone, Default)]
pub struct Tokens {
    full: Vec<Hash>,
    read_only: Vec<Hash>,
}

type Hash = [u8; 32];

impl std::fmt::Debug for Tokens {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} full and {} read-only", self.full.len(), self.read_only.len())
    }
}

/// Why tokens could not be read. Never has the text in question: most of it may be a token.
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
    /// What stands in place of a token can be none.
    #[error(
        "{place} is not a token: printable ASCII characters without spaces, before which a token file may have \
         `read-only`"
    )]
    Malformed {
        /// Where it stands.
        place: String,
    },
}

/// Characters of a token that is hard to find by trying. Shorter ones are warned of, not refused: a service that only
/// its own machine reaches may do with less.
const LONG_ENOUGH: usize = 16;

impl Tokens {
    /// Tokens of the environment: `POINTMASS_TOKEN` and `POINTMASS_READ_ONLY_TOKEN`, each a list with commas.
    ///
    /// # Errors
    /// When a variable is set and part of it is not a token: an empty one does not open the service to everyone.
    pub fn from_environment() -> Result<Self, AccessError> {
        let list = |name: &str| -> Result<Vec<Hash>, AccessError> {
            let Some(text) = std::env::var_os(name) else { return Ok(Vec::new()) };
            let place = format!("what {name} has");
            text.to_string_lossy().split(',').map(|token| accept(token.trim(), &place)).collect()
        };
        Ok(Self { full: list(TOKEN)?, read_only: list(READ_ONLY_TOKEN)? })
    }

    /// Reads a file with one token a line, or `read-only` and a token; blank lines and lines that begin with `#` do not
    /// count.
    ///
    /// # Errors
    /// When the file cannot be read, has no token, or a line that is none.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        let shown = path.display().to_string();
        let unreadable = |source| AccessError::Unreadable { path: shown.clone(), source };
        let mut file = File::open(path).map_err(unreadable)?;
        // Warned of only: the secrets of a container are often open to everyone in it.
        let mode = file.metadata().map_err(unreadable)?.permissions().mode();
        if mode & 0o077 != 0 {
            tracing::warn!(path = shown, mode = format!("{:o}", mode & 0o777), "others can open the token file");
        }
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(unreadable)?;
        let mut tokens = Self::default();
        for (number, line) in (1..).zip(text.lines()).filter(|(_, line)| !line.trim_start().starts_with('#')) {
            let place = format!("line {number} of the token file {shown}");
            match line.split_whitespace().collect::<Vec<_>>()[..] {
                [] => {}
                ["read-only", token] => tokens.read_only.push(accept(token, &place)?),
                [token] if token != "read-only" => tokens.full.push(accept(token, &place)?),
                _ => return Err(AccessError::Malformed { place }),
            }
        }
        if tokens.is_empty() { Err(AccessError::Empty { path: shown }) } else { Ok(tokens) }
    }

    /// Those that a configuration brings and those of its file.
    pub(crate) fn of(config: &Config) -> Result<Self, AccessError> {
        let mut tokens = config.token_file.as_deref().map(Self::read).transpose()?.unwrap_or_default();
        tokens.full.extend(&config.tokens.full);
        tokens.read_only.extend(&config.tokens.read_only);
        Ok(tokens)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.full.is_empty() && self.read_only.is_empty()
    }

    /// Whether a request carries one of them that is good for it. Takes the same time for every wrong token.
    fn admit(&self, headers: &HeaderMap, changes: bool) -> Result<(), Problem> {
        let given = headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
        let bearer = given.and_then(|value| value.split_once(' '));
        let Some((_, token)) = bearer.filter(|(scheme, _)| scheme.eq_ignore_ascii_case("bearer")) else {
            return Err(Problem::plain(Code::Unauthorized));
        };
        let given = hash(token.trim());
        let is_among = |hashes: &[Hash]| {
            bool::from(hashes.iter().fold(Choice::from(0), |found, known| found | known.ct_eq(&given)))
        };
        match (is_among(&self.full), is_among(&self.read_only)) {
            (false, false) => Err(Problem::plain(Code::Unauthorized)),
            // Also of one that is listed as both.
            (_, true) if changes => Err(Problem::plain(Code::ReadOnlyToken)),
            _ => Ok(()),
        }
    }
}

impl App {
    /// Whether who sent these headers may change worlds, also by what follows a request that only reads.
    pub(crate) fn may_change(&self, headers: &HeaderMap) -> bool {
        self.tokens
            .as_ref()
            .is_none_or(|tokens| tokens.read().unwrap_or_else(PoisonError::into_inner).admit(headers, true).is_ok())
    }

    /// Reads the token file again: its old tokens are good no more, its new ones are. When it cannot be read or has no
    /// token, all stay as they are, and the log says why.
    pub fn reload_tokens(&self) {
        let (Some(tokens), Some(_)) = (&self.tokens, &self.config.token_file) else {
            return tracing::warn!("there is no token file to read again");
        };
        match Tokens::of(&self.config) {
            Ok(new) => {
                let shown = format!("{new:?}");
                *tokens.write().unwrap_or_else(PoisonError::into_inner) = new;
                tracing::info!(tokens = shown, "read the token file again");
            }
            Err(error) => tracing::error!(%error, "the tokens stay as they were"),
        }
    }
}

fn accept(token: &str, place: &str) -> Result<Hash, AccessError> {
    if token.is_empty() || !token.bytes().all(|byte| byte.is_ascii_graphic()) {
        return Err(AccessError::Malformed { place: place.to_owned() });
    }
    if token.len() < LONG_ENOUGH {
        tracing::warn!("{place} is a token of fewer than {LONG_ENOUGH} characters: it may be guessed");
    }
    Ok(hash(token))
}

fn hash(token: &str) -> Hash {
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
