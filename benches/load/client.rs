//! A client that costs little: one blocking connection, requests that are bytes already, and no more parsing than needed.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::Duration;

/// Where a service listens.
#[derive(Debug, Clone)]
pub(crate) enum Address {
    Tcp(SocketAddr),
    Unix(PathBuf),
}

/// A request as it goes over the wire.
pub(crate) fn request(method: &str, path: &str, body: &str) -> Vec<u8> {
    let length = body.len();
    format!("{method} {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: {length}\r\n\r\n{body}")
        .into_bytes()
}

/// A connection that is made when it is needed, and made anew when the service has closed it.
#[derive(Debug)]
pub(crate) struct Client {
    address: Address,
    stream: Option<Stream>,
    buffer: Vec<u8>,
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
    pub(crate) body: &'a str,
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
        serde_json::from_str(self.body).unwrap_or_else(|error| panic!("{error} in {:?}", self.body))
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
        Self { address: address.clone(), stream: None, buffer: Vec::new() }
    }

    /// Sends a request and waits for its answer.
    ///
    /// # Errors
    /// When the service does not listen, or closes the connection before the answer is there.
    pub(crate) fn ask(&mut self, request: &[u8]) -> io::Result<Answer<'_>> {
        let sent = self.connected().and_then(|stream| stream.write_all(request));
        let end = sent.and_then(|()| self.receive());
        if end.is_err() {
            self.stream = None;
        }
        let (head, end) = end?;
        let invalid = |_| io::ErrorKind::InvalidData;
        let text = std::str::from_utf8(&self.buffer[..end]).map_err(invalid)?;
        let (head, body) = text.split_at(head);
        if header(head, "connection").is_some_and(|connection| connection == "close") {
            self.stream = None;
        }
        let status = head.get(9..12).and_then(|status| status.parse().ok()).ok_or(io::ErrorKind::InvalidData)?;
        Ok(Answer { status, head, body })
    }

    /// The same where anything but this status is a failure of the case.
    #[track_caller]
    pub(crate) fn expect(&mut self, request: &[u8], status: u16) -> Answer<'_> {
        let answer = self.ask(request).unwrap_or_else(|error| panic!("no answer: {error}"));
        assert_eq!(answer.status, status, "{}", answer.body);
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

    /// Reads one answer into the buffer; where its body begins, and where it ends.
    fn receive(&mut self) -> io::Result<(usize, usize)> {
        let stream = self.stream.as_mut().ok_or(io::ErrorKind::NotConnected)?;
        let mut filled = 0;
        let mut ends = None;
        loop {
            if ends.is_none()
                && let Some(at) = self.buffer[..filled].windows(4).position(|window| window == b"\r\n\r\n")
            {
                let head = str::from_utf8(&self.buffer[..at]).map_err(|_| io::ErrorKind::InvalidData)?;
                let length = header(head, "content-length").map_or(Ok(0), str::parse::<usize>);
                ends = Some((at + 4, at + 4 + length.map_err(|_| io::ErrorKind::InvalidData)?));
            }
            match ends {
                Some((_, end)) if filled == end => break,
                Some((_, end)) if filled > end => return Err(io::ErrorKind::InvalidData.into()),
                Some((_, end)) => self.buffer.resize(end.max(self.buffer.len()), 0),
                None => self.buffer.resize((filled + 1024).max(self.buffer.len()), 0),
            }
            match stream.read(&mut self.buffer[filled..])? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                read => filled += read,
            }
        }
        ends.ok_or_else(|| io::ErrorKind::InvalidData.into())
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
