//! A client that follows a world, and reads no more of an event than it needs to know which it is.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use crate::cbor::Value;
use crate::client::{Address, request_with};
use crate::scene::Columns;

/// How events are told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    ServerSent,
    /// Over a WebSocket, as text.
    Json,
    /// Over a WebSocket, as binary.
    Cbor,
}

#[derive(Debug)]
pub(crate) struct Follower {
    way: Way,
    stream: BufReader<TcpStream>,
    event: Vec<u8>,
}

/// What comes next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Next {
    /// An event, of this revision.
    Event(u64),
    /// Only a sign that the connection is in use.
    Nothing,
    /// The service says that there is nothing more to come.
    End,
}

/// More than there ever is on the way.
const PATIENCE: Duration = Duration::from_secs(30);

impl Follower {
    /// Follows the positions of a world, at most so many events a second.
    ///
    /// # Errors
    /// When the service does not listen, or does not want to.
    pub(crate) fn connect(address: &Address, way: Way, world: &str, rate: u32) -> io::Result<Self> {
        let Address::Tcp(address) = address else { return Err(io::ErrorKind::Unsupported.into()) };
        let mut stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        // The key and its answer are those of RFC 6455, section 1.3.
        let (status, encoding, headers): (_, _, &[&str]) = match way {
            Way::ServerSent => ("200", "json", &["accept: text/event-stream"]),
            Way::Json => ("101", "json", &HANDSHAKE),
            Way::Cbor => ("101", "cbor", &HANDSHAKE),
        };
        let path = format!("/v1/worlds/{world}/stream?fields=position&rate={rate}&encoding={encoding}");
        stream.write_all(&request_with("GET", &path, headers, b""))?;
        let mut follower = Self { way, stream: BufReader::with_capacity(64 << 10, stream), event: Vec::new() };
        let head = follower.head()?;
        let is_accepted =
            way == Way::ServerSent || head.contains("\r\nsec-websocket-accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n");
        if head.get(9..12) != Some(status) || !is_accepted {
            return Err(io::Error::other(head));
        }
        Ok(follower)
    }

    /// The other end of the connection, for whoever wants to read it another way.
    pub(crate) fn into_stream(self) -> TcpStream {
        self.stream.into_inner()
    }

    fn head(&mut self) -> io::Result<String> {
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            if self.stream.read_line(&mut head)? == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
        }
        Ok(head)
    }

    /// Waits for the next event, which can be looked at until the one after it.
    ///
    /// # Errors
    /// When the connection is closed without a word, or something else comes than events.
    pub(crate) fn next(&mut self) -> io::Result<Next> {
        self.event.clear();
        let next = if self.way == Way::ServerSent { self.next_of_text()? } else { self.next_frame()? };
        next.ok_or_else(|| io::ErrorKind::InvalidData.into())
    }

    /// The state in the event, which says all of it.
    pub(crate) fn columns(way: Way, event: &[u8]) -> Option<Columns<f64>> {
        match way {
            Way::ServerSent => {
                let text = event.strip_suffix(b"\n\n")?;
                let data = text.windows(6).position(|window| window == b"data: ")?;
                Columns::from_json(&text[data + 6..])
            }
            Way::Json => Columns::from_json(event),
            Way::Cbor => Columns::from_cbor(event),
        }
    }

    pub(crate) fn event(&self) -> &[u8] {
        &self.event
    }

    /// Chunks up to an empty line.
    fn next_of_text(&mut self) -> io::Result<Option<Next>> {
        let mut line = String::new();
        while !self.event.ends_with(b"\n\n") {
            line.clear();
            self.stream.read_line(&mut line)?;
            let Ok(size) = usize::from_str_radix(line.trim_end(), 16) else { return Ok(None) };
            self.append(size)?;
            self.stream.read_exact(&mut [0; 2])?;
            if size == 0 {
                return Ok(None);
            }
        }
        Ok(match &self.event[..] {
            b":\n\n" => Some(Next::Nothing),
            event if event.starts_with(b"event: end\n") => Some(Next::End),
            event => number_behind(event, b"id: ").map(Next::Event),
        })
    }

    /// A frame, which the service does not mask.
    fn next_frame(&mut self) -> io::Result<Option<Next>> {
        let [mut first, mut long, mut longest] = [[0; 2].to_vec(), [0; 2].to_vec(), [0; 8].to_vec()];
        self.stream.read_exact(&mut first)?;
        let length = match first[1] {
            126 => {
                self.stream.read_exact(&mut long)?;
                big_endian(&long)
            }
            127 => {
                self.stream.read_exact(&mut longest)?;
                big_endian(&longest)
            }
            short => short.into(),
        };
        self.append(usize::try_from(length).map_err(|_| io::ErrorKind::InvalidData)?)?;
        // All of a message in one frame, and which kind it is.
        Ok(match (first[0], self.way) {
            (0x81, Way::Json) => number_behind(&self.event, br#""revision":"#).map(Next::Event),
            (0x82, Way::Cbor) => {
                let revision = Value::of(&self.event).and_then(|event| event.member("revision")?.whole());
                revision.map(Next::Event)
            }
            (0x89, _) => Some(Next::Nothing),
            (0x88, _) if self.event.starts_with(&1000_u16.to_be_bytes()) => Some(Next::End),
            _ => None,
        })
    }

    fn append(&mut self, bytes: usize) -> io::Result<()> {
        let old = self.event.len();
        self.event.resize(old + bytes, 0);
        self.stream.read_exact(&mut self.event[old..])
    }
}

const HANDSHAKE: [&str; 4] = [
    "connection: upgrade",
    "upgrade: websocket",
    "sec-websocket-version: 13",
    "sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==",
];

fn big_endian(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |number, byte| number << 8 | u64::from(*byte))
}

/// The number behind a word.
fn number_behind(text: &[u8], word: &[u8]) -> Option<u64> {
    let at = text.windows(word.len()).position(|window| window == word)? + word.len();
    let digits = text[at..].iter().take_while(|byte| byte.is_ascii_digit());
    str::from_utf8(&text[at..at + digits.count()]).ok()?.parse().ok()
}
