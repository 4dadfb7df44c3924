//! `pointmass healthcheck`: one request, without the machinery of a client.

use std::io::{Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use axum::http::Uri;

const TIMEOUT: Duration = Duration::from_secs(3);

/// Whether a service answers at this `http://host:port/path`.
///
/// # Errors
/// A sentence that says why not.
pub fn healthcheck(url: &str) -> Result<(), String> {
    let uri: Uri = url.parse().map_err(|error| format!("{url:?} is not a URL: {error}"))?;
    let host = uri
        .host()
        .filter(|_| uri.scheme_str() == Some("http"))
        .ok_or_else(|| format!("{url:?} is not an http:// URL"))?;
    let port = uri.port_u16().unwrap_or(80);
    let failed = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::WouldBlock => format!("{url} does not answer within {} s", TIMEOUT.as_secs()),
        _ => format!("{url} does not answer: {error}"),
    };
    let mut addresses = (host.trim_matches(['[', ']']), port).to_socket_addrs().map_err(failed)?;
    let address = addresses.next().ok_or_else(|| format!("{host} has no address"))?;
    let mut stream = TcpStream::connect_timeout(&address, TIMEOUT).map_err(failed)?;
    stream.set_read_timeout(Some(TIMEOUT)).map_err(failed)?;
    stream.set_write_timeout(Some(TIMEOUT)).map_err(failed)?;
    let path = uri.path_and_query().map_or("/", |path| path.as_str());
    write!(stream, "GET {path} HTTP/1.1\r\nhost: {host}:{port}\r\nconnection: close\r\n\r\n").map_err(failed)?;
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).map_err(failed)?;
    match &answer {
        b"HTTP/1.1 200" => Ok(()),
        other => Err(format!("{url} answers {:?}", String::from_utf8_lossy(other))),
    }
}
