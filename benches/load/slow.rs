//! Clients that hold connections and do nothing with them.

use std::io::{ErrorKind, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::Case;
use crate::client::{Address, request};
use crate::fairness::Light;
use crate::report::{Bench, Unit};
use crate::server::Server;

pub(crate) const SLOW: Case = Case {
    name: "slow",
    title: "Slow clients by the hundred",
    note: "300 connections that send a header byte by byte, 300 that say nothing, and 300 that ask for the state of 50,000 \
           particles and never read it, under `--header-timeout-ms 2000`. Meanwhile the light worlds go on. Then they are \
           left alone for four seconds, and those that are still open are counted.",
    run,
};

fn run(bench: &mut Bench) {
    let count = bench.size(300, 10);
    let timeout = bench.size(2000, 300);
    let server = Server::start(&["--header-timeout-ms", &timeout.to_string()]);
    let mut client = server.client();
    let mut light = Light::create(&mut client);
    client.expect(&request("PUT", "/v1/worlds/large", ""), 201);
    let particles = bench.size(50_000, 10_000);
    let columns = format!(r#"{{"count":{particles},"position":[0.1,1e-7,12345.678],"velocity":[3,20,0.1]}}"#);
    client.expect(&request("POST", "/v1/worlds/large/particles", &columns), 201);
    let state = request("GET", "/v1/worlds/large/state?fields=position,velocity", "");
    // Once as it should be: how much an answer is.
    let answer = client.expect(&state, 200).body.len() as f64;
    drop(client);

    let seconds = bench.size(6.0, 0.3);
    let alone = light.run(bench, &server, "before slow clients", bench.size(4.0, 0.2));
    let before = server.resident();
    let stop = AtomicBool::new(false);
    let beside = std::thread::scope(|scope| {
        let slow = scope.spawn(|| be_slow(server.address(), count, &state, &stop));
        // Until all have come, and the service has noticed.
        std::thread::sleep(Duration::from_millis(bench.size(500, 50)));
        let p99 = light.run(bench, &server, "beside slow clients", seconds);
        stop.store(true, Ordering::SeqCst);
        (p99, slow.join().expect("they do not panic"))
    });
    let (p99, [mut headers, mut silent, mut unread]) = beside;
    bench.record("p99 beside slow clients / before", p99 / alone, Unit::Ratio).at_most(3.0);
    std::thread::sleep(Duration::from_millis(2 * timeout));
    let [headers, silent, unread] = [&mut headers, &mut silent, &mut unread].map(|sockets| open(sockets));
    bench.check(headers == 0, || format!("{headers} connections with half a header are still open"));
    bench.check(silent == 0, || format!("{silent} silent connections are still open"));
    bench.record("half a header, still open", headers as f64, Unit::Count).at_most(0.0);
    bench.record("silent, still open", silent as f64, Unit::Count).at_most(0.0);
    bench.record("answer never read, still open", unread as f64, Unit::Count).at_most(0.0);
    bench.record("bytes of an answer that is not read", answer, Unit::Bytes);
    bench.record("resident before", before, Unit::Bytes);
    bench.record("resident at most", server.peak(), Unit::Bytes);
    bench.record("resident after / before", server.resident() / before, Unit::Ratio).at_most(1.5);
    light.check(bench, &mut server.client());
}

/// So many of each kind, for as long as they are let.
fn be_slow(address: &Address, count: usize, state: &[u8], stop: &AtomicBool) -> [Vec<TcpStream>; 3] {
    let Address::Tcp(address) = address else { panic!("a TCP listener") };
    let connect = || {
        let stream = TcpStream::connect(address).expect("the service listens");
        stream.set_nonblocking(true).expect("a socket");
        stream
    };
    let mut sockets: [Vec<TcpStream>; 3] = std::array::from_fn(|_| (0..count).map(|_| connect()).collect());
    for socket in &mut sockets[2] {
        let _sent = socket.write_all(state);
    }
    let header =
        b"GET /v1/worlds HTTP/1.1\r\nhost: localhost\r\nx-slow: ".iter().chain(b"x".iter().cycle().take(10_000));
    for byte in header {
        if stop.load(Ordering::SeqCst) {
            break;
        }
        for socket in &mut sockets[0] {
            let _closed = socket.write_all(&[*byte]);
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    sockets
}

/// How many of them the service has not closed. Reads nothing of those that have something to read.
fn open(sockets: &mut [TcpStream]) -> usize {
    let is_open = |socket: &mut TcpStream| match socket.peek(&mut [0; 1]) {
        Ok(0) => false,
        // There is an answer: to write to a connection that is closed fails, at the second time at the latest.
        Ok(_) => (0..2).all(|_| {
            std::thread::sleep(Duration::from_millis(1));
            socket.write_all(b"x").is_ok()
        }),
        Err(error) => error.kind() == ErrorKind::WouldBlock,
    };
    sockets.iter_mut().map(is_open).filter(|is_open| *is_open).count()
}
