//! What bytes cost without a service: a process that sends as many as it is asked for, or takes as many as it is sent.

use std::io::{self, Read, Write};
use std::net::{TcpListener, TcpStream};

use crate::client::{request, request_with};
use crate::server::Server;

/// The first argument of that process.
pub(crate) const CHILD: &str = "--raw";

/// At once into and out of a socket.
const PIECE: usize = 256 << 10;

pub(crate) fn start() -> Server {
    Server::this_program(&[CHILD])
}

/// Asks it to send so many bytes.
pub(crate) fn send(bytes: usize) -> Vec<u8> {
    request("GET", &format!("/{bytes}"), "")
}

/// Gives it a body to take.
pub(crate) fn take(body: &[u8]) -> Vec<u8> {
    request_with("POST", "/0", &[], body)
}

pub(crate) fn serve(_: &[String]) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    println!("raw listening on http://{}", listener.local_addr().expect("bound"));
    for stream in listener.incoming() {
        let stream = stream.expect("a connection");
        std::thread::spawn(move || talk(stream));
    }
}

/// As much HTTP as our client needs to know where an answer ends.
fn talk(mut stream: TcpStream) -> io::Result<()> {
    let invalid = || io::Error::from(io::ErrorKind::InvalidData);
    stream.set_nodelay(true)?;
    let (mut buffer, mut memory) = (vec![0; PIECE], Vec::new());
    loop {
        let mut filled = 0;
        let end = loop {
            if let Some(at) = buffer[..filled].windows(4).position(|window| window == b"\r\n\r\n") {
                break at;
            }
            match stream.read(&mut buffer[filled..])? {
                0 => return Ok(()),
                read => filled += read,
            }
        };
        let head = str::from_utf8(&buffer[..end]).map_err(|_| invalid())?;
        let number = |begin: &str, end: char| head.split_once(begin)?.1.split(end).next()?.parse::<usize>().ok();
        let (bytes, length) = (number(" /", ' '), number("content-length: ", '\r'));
        let (bytes, length) = (bytes.ok_or_else(invalid)?, length.ok_or_else(invalid)?);
        let mut taken = filled - end - 4;
        while taken < length {
            match stream.read(&mut buffer)? {
                0 => return Ok(()),
                read => taken += read,
            }
        }
        if memory.len() < bytes {
            memory.resize(bytes, b'0');
        }
        stream.write_all(format!("HTTP/1.1 200 OK\r\ncontent-length: {bytes}\r\n\r\n").as_bytes())?;
        memory[..bytes].chunks(PIECE).try_for_each(|piece| stream.write_all(piece))?;
    }
}
