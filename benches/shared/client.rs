//! A client that costs little: one blocking connection, requests that are bytes already, and no more parsing than needed.

use std::borrow::Cow;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::ops::Range;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::Duration;

/// Where a service listens.
#[derive(Debug, Clone)]
pub(crate) enum Address {
    Tcp(SocketAddr),
    Unix(PathBuf),
}

/// A request in JSON as it goes over the wire.
pub(crate) fn request(method: &str, path: &str, body: &str) -> Vec<u8> {
    request_with(method, path, &["content-type: application/json"], body.as_bytes())
}

/// A request as it goes over the wire, with headers of its own.
pub(crate) fn request_with(method: &str, path: &str, headers: &[&str], body: &[u8]) -> Vec<u8> {
    let headers = headers.iter().map(|header| [header, "\r\n"].concat()).collect::<String>();
    let head =
        format!("{method} {path} HTTP/1.1\r\nhost: localhost\r\n{headers}content-length: {}\r\n\r\n", body.len());
    [head.as_bytes(), body].concat()
}

/// A connection that is made when it is needed, and made anew when the service has closed it.
#[derive(Debug)]
pub(crate) struct Client {
    address: Address,
    stream: Option<Stream>,
    buffer: Vec<u8>,
    /// Of the last answer: where its head ends, and where the pieces of its body lie in the buffer.
    head: usize,
    pieces: Vec<Range<usize>>,
}

#[derive(Debug)]
enum Stream {
    Tcp(TcpStream),
    Unix(UnixStream),
}

/// An answer, as long as the next request is not sent.
#[derive(Debug)]
pub(crate) struct Answer<'a> {
    pub(crate) status: u16,
    head: &'a str,
    pub(crate) body: &'a [u8],
}

/// What an answer still lacks.
#[derive(Debug, Clone, Copy)]
enum Rest {
    Head,
    /// A chunk whose size stands here.
    Chunk(usize),
    /// Nothing, once all up to here is there.
    Until(usize),
}

impl Answer<'_> {
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        header(self.head, name)
    }

    /// Of the world that it speaks of.
    pub(crate) fn revision(&self) -> Option<u64> {
        self.header("etag")?.trim_matches('"').parse().ok()
    }

    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_slice(self.body).unwrap_or_else(|error| panic!("{error} in {:?}", self.text()))
    }

    /// The body for people.
    pub(crate) fn text(&self) -> Cow<'_, str> {
        String::from_utf8_lossy(self.body)
    }
}

/// Our services write names in small letters.
fn header<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    head.split("\r\n").find_map(|line| line.strip_prefix(name)?.strip_prefix(": "))
}

impl Client {
    /// How long an answer may take.
    const PATIENCE: Duration = Duration::from_secs(30);

    pub(crate) fn new(address: &Address) -> Self {
        Self { address: address.clone(), stream: None, buffer: Vec::new(), head: 0, pieces: Vec::new() }
    }

    /// Sends a request and waits for its answer.
    ///
    /// # Errors
    /// When the service does not listen, or closes the connection before the answer is there.
    pub(crate) fn ask(&mut self, request: &[u8]) -> io::Result<Answer<'_>> {
        self.fetch(request)?;
        self.answer()
    }

    /// What was answered last.
    ///
    /// # Errors
    /// When it is not HTTP.
    pub(crate) fn answer(&mut self) -> io::Result<Answer<'_>> {
        self.join();
        let head = str::from_utf8(&self.buffer[..self.head]).map_err(|_| io::ErrorKind::InvalidData)?;
        let status = head.get(9..12).and_then(|status| status.parse().ok()).ok_or(io::ErrorKind::InvalidData)?;
        let body = self.pieces.first().map_or(0..0, Clone::clone);
        Ok(Answer { status, head, body: &self.buffer[body] })
    }

    /// The same without looking at what the answer says: how many bytes its body has.
    ///
    /// # Errors
    /// The same.
    pub(crate) fn fetch(&mut self, request: &[u8]) -> io::Result<usize> {
        let sent = self.connected().and_then(|stream| stream.write_all(request));
        let closes = sent.and_then(|()| self.receive());
        if !matches!(closes, Ok(false)) {
            self.stream = None;
        }
        closes.map(|_| self.pieces.iter().map(Range::len).sum())
    }

    /// The same where anything but this status is a failure of the case.
    #[track_caller]
    pub(crate) fn expect(&mut self, request: &[u8], status: u16) -> Answer<'_> {
        let answer = self.ask(request).unwrap_or_else(|error| panic!("no answer: {error}"));
        assert_eq!(answer.status, status, "{}", answer.text());
        answer
    }

    /// Something that closes the connection under whoever waits on it.
    pub(crate) fn closer(&mut self) -> io::Result<TcpStream> {
        match self.connected()? {
            Stream::Tcp(stream) => stream.try_clone(),
            Stream::Unix(_) => Err(io::ErrorKind::Unsupported.into()),
        }
    }

    fn connected(&mut self) -> io::Result<&mut Stream> {
        if self.stream.is_none() {
            self.stream = Some(Stream::connect(&self.address)?);
        }
        Ok(self.stream.as_mut().expect("it was put there above"))
    }

    /// Reads one answer into the buffer; whether it is the last of the connection.
    fn receive(&mut self) -> io::Result<bool> {
        let mut filled = 0;
        let mut rest = Rest::Head;
        self.pieces.clear();
        while !self.parse(&mut rest, filled)? {
            let wanted = match rest {
                Rest::Head => filled + 1024,
                // Nobody said how long it is.
                Rest::Chunk(_) => filled + (filled / 2).max(1024),
                Rest::Until(end) => end,
            };
            if self.buffer.len() < wanted && (filled == self.buffer.len() || matches!(rest, Rest::Until(_))) {
                self.buffer.resize(wanted, 0);
            }
            let stream = self.stream.as_mut().ok_or(io::ErrorKind::NotConnected)?;
            match stream.read(&mut self.buffer[filled..])? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                read => filled += read,
            }
        }
        let head = str::from_utf8(&self.buffer[..self.head]).map_err(|_| io::ErrorKind::InvalidData)?;
        Ok(header(head, "connection").is_some_and(|connection| connection == "close"))
    }

    /// Whether an answer is complete that is there up to `filled`.
    fn parse(&mut self, rest: &mut Rest, filled: usize) -> io::Result<bool> {
        let invalid = || io::Error::from(io::ErrorKind::InvalidData);
        loop {
            match *rest {
                Rest::Head => {
                    let Some(at) = self.buffer[..filled].windows(4).position(|window| window == b"\r\n\r\n") else {
                        return Ok(false);
                    };
                    self.head = at;
                    let head = str::from_utf8(&self.buffer[..at]).map_err(|_| invalid())?;
                    *rest = if header(head, "transfer-encoding") == Some("chunked") {
                        Rest::Chunk(at + 4)
                    } else {
                        let length = header(head, "content-length").map_or(Ok(0), str::parse::<usize>);
                        let end = at + 4 + length.map_err(|_| invalid())?;
                        self.pieces.push(at + 4..end);
                        Rest::Until(end)
                    };
                }
                Rest::Chunk(begin) => {
                    let line = self.buffer.get(begin..filled).unwrap_or_default();
                    let Some(at) = line.windows(2).position(|window| window == b"\r\n") else { return Ok(false) };
                    let size = str::from_utf8(&line[..at]).ok().and_then(|size| usize::from_str_radix(size, 16).ok());
                    let (from, size) = (begin + at + 2, size.ok_or_else(invalid)?);
                    self.pieces.push(from..from + size);
                    *rest = if size == 0 { Rest::Until(from + 2) } else { Rest::Chunk(from + size + 2) };
                }
                Rest::Until(end) if filled > end => return Err(invalid()),
                Rest::Until(end) => return Ok(filled == end),
            }
        }
    }

    /// Makes one of the pieces of the body.
    fn join(&mut self) {
        let Some(begin) = self.pieces.first().map(|first| first.start) else { return };
        let mut end = begin;
        for piece in self.pieces.drain(..) {
            let len = piece.len();
            self.buffer.copy_within(piece, end);
            end += len;
        }
        self.pieces.push(begin..end);
    }
}

impl Stream {
    fn connect(address: &Address) -> io::Result<Self> {
        Ok(match address {
            Address::Tcp(address) => {
                let stream = TcpStream::connect(address)?;
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(Client::PATIENCE))?;
                Self::Tcp(stream)
            }
            Address::Unix(path) => {
                let stream = UnixStream::connect(path)?;
                stream.set_read_timeout(Some(Client::PATIENCE))?;
                Self::Unix(stream)
            }
        })
    }

    fn write_all(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => stream.write_all(bytes),
            Self::Unix(stream) => stream.write_all(bytes),
        }
    }

    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.read(into),
            Self::Unix(stream) => stream.read(into),
        }
    }
}
