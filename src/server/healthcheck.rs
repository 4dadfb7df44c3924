//! `pointmass healthcheck`: one request, without the machinery of a client.

use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use axum::http::Uri;
use axum::http::uri::PathAndQuery;

const TIMEOUT: Duration = Duration::from_secs(3);

/// Whether a service answers at a URL as it is printed at the start: `http://host:port`, whose path is `/healthz` when
/// it has none, or `unix:PATH`.
///
/// # Errors
/// A sentence that says why not.
pub fn healthcheck(url: &str) -> Result<(), String> {
    let answer = if let Some(path) = url.strip_prefix("unix:") {
        UnixStream::connect(path).and_then(|stream| {
            stream.set_read_timeout(Some(TIMEOUT))?;
            stream.set_write_timeout(Some(TIMEOUT))?;
            ask(stream, "localhost", "/healthz")
        })
    } else {
        let uri: Uri = url.parse().map_err(|error| format!("{url:?} is not a URL: {error}"))?;
        let http = uri.scheme_str() == Some("http");
        let host = uri.host().filter(|_| http).ok_or_else(|| format!("{url:?} is not an http:// URL"))?;
        ask_host(host, &uri)
    };
    match answer {
        Ok(answer) if &answer == b"HTTP/1.1 200" => Ok(()),
        Ok(answer) => Err(format!("{url} answers {:?}", String::from_utf8_lossy(&answer))),
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
            Err(format!("{url} does not answer within {} s", TIMEOUT.as_secs()))
        }
        Err(error) => Err(format!("{url} does not answer: {error}")),
    }
}

/// Asks the first of the addresses of a host that takes a connection.
fn ask_host(host: &str, uri: &Uri) -> io::Result<[u8; 12]> {
    let port = uri.port_u16().unwrap_or(80);
    let path = uri.path_and_query().map(PathAndQuery::as_str).filter(|path| *path != "/").unwrap_or("/healthz");
    let mut refused = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
    for address in (host.trim_matches(['[', ']']), port).to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, TIMEOUT) {
            Ok(stream) => {
                stream.set_read_timeout(Some(TIMEOUT))?;
                stream.set_write_timeout(Some(TIMEOUT))?;
                return ask(stream, &format!("{host}:{port}"), path);
            }
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

/// The beginning of the answer, which has the status.
fn ask(mut stream: impl Read + Write, host: &str, path: &str) -> io::Result<[u8; 12]> {
    write!(stream, "GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n")?;
    let mut answer = [0; 12];
    stream.read_exact(&mut answer)?;
    Ok(answer)
}
