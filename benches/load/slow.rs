//! Clients that hold connections and do nothing with them.

use std::io::{ErrorKind, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::Case;
use crate::client::{Address, request};
use crate::fairness::Light;
use crate::report::{Bench, Unit};
use crate::server::Server;

pub(crate) const SLOW: Case = Case {
    name: "slow",
    title: "Slow clients by the hundred",
    note: "300 connections that send a header byte by byte, 300 that say nothing, and 100 that ask for the state of 50,000 \
           particles and never read it, under `--header-timeout-ms 8000` and the same for `--idle-timeout-ms` and \
           `--write-timeout-ms`. The light worlds are measured while they come and their states are written, and then \
           while they are there. After the timeout those that are still open are counted.",
    run,
};

/// Many digits, for answers that do not fit into the buffers of sockets.
const LONG: &str = "[0.12345678901234568,-1234.5678901234567,0.00012345678901234567]";

fn run(bench: &mut Bench) {
    let counts = bench.size([300, 300, 100], [10; 3]);
    let timeout = bench.size(8000, 500);
    let patience = timeout.to_string();
    let [header, idle, write] = ["--header-timeout-ms", "--idle-timeout-ms", "--write-timeout-ms"];
    let rate = ["--write-rate-min", "1000000000"];
    let server = Server::start(&[header, &patience, idle, &patience, write, &patience, rate[0], rate[1]]);
    let mut light = Light::create(&server);
    let mut client = server.client();
    client.expect(&request("PUT", "/v1/worlds/large", ""), 201);
    let particles = bench.size(50_000, 5000);
    let columns = format!(r#"{{"count":{particles},"position":{LONG},"velocity":{LONG}}}"#);
    client.expect(&request("POST", "/v1/worlds/large/particles", &columns), 201);
    let state = request("GET", "/v1/worlds/large/state?fields=position,velocity", "");
    // Once as it should be: how much an answer is.
    let answer = client.expect(&state, 200).body.len() as f64;
    drop(client);

    let alone = light.run(bench, &server, "before slow clients", bench.size(4.0, 0.2));
    let before = server.resident();
    let stop = AtomicBool::new(false);
    let start = Instant::now();
    let (come, beside, (sockets, connecting)) = std::thread::scope(|scope| {
        let slow = scope.spawn(|| be_slow(server.address(), counts, &state, &stop));
        let come = light.run(bench, &server, "while slow clients come", bench.size(4.0, 0.1));
        let beside = light.run(bench, &server, "beside slow clients", bench.size(3.0, 0.1));
        stop.store(true, Ordering::SeqCst);
        (come, beside, slow.join().expect("they do not panic"))
    });
    bench.record("until all were connected", connecting.as_secs_f64(), Unit::Seconds);
    bench.record("p99 while they come / before", come / alone, Unit::Ratio).at_most(3.0);
    bench.record("p99 beside them / before", beside / alone, Unit::Ratio).at_most(3.0);
    // The last of them may have come late.
    let deadline = Instant::now() + connecting + Duration::from_millis(timeout + 5000);
    let [mut headers, mut silent, mut unread] = sockets;
    while Instant::now() < deadline && headers.iter_mut().chain(&mut silent).chain(&mut unread).any(is_open) {
        std::thread::sleep(Duration::from_millis(100));
    }
    bench.record("until none of them was open", start.elapsed().as_secs_f64(), Unit::Seconds);
    let [headers, silent, unread] = [&mut headers, &mut silent, &mut unread]
        .map(|sockets| sockets.iter_mut().map(is_open).filter(|open| *open).count());
    bench.check(headers == 0, || format!("{headers} connections with half a header are still open"));
    bench.check(silent == 0, || format!("{silent} silent connections are still open"));
    bench.check(unread == 0, || format!("{unread} connections that never read their answer are still open"));
    bench.record("half a header, still open", headers as f64, Unit::Count).at_most(0.0);
    bench.record("silent, still open", silent as f64, Unit::Count).at_most(0.0);
    bench.record("answer never read, still open", unread as f64, Unit::Count).at_most(0.0);
    bench.record("size of an answer", answer, Unit::Bytes);
    bench.record("resident before", before, Unit::Bytes);
    bench.record("resident at most", server.peak(), Unit::Bytes);
    bench.record("resident after", server.resident(), Unit::Bytes);
    bench.record("resident after / before", server.resident() / before, Unit::Ratio).at_most(1.5);
    light.check(bench, &server);
}

/// So many of each kind, for as long as they are let; and how long it took until they were connected.
fn be_slow(address: &Address, counts: [usize; 3], state: &[u8], stop: &AtomicBool) -> ([Vec<TcpStream>; 3], Duration) {
    let Address::Tcp(address) = address else { panic!("a TCP listener") };
    let connect = || {
        let stream = TcpStream::connect(address).expect("the service listens");
        stream.set_nonblocking(true).expect("a socket");
        stream
    };
    let start = Instant::now();
    let mut sockets = counts.map(|count| (0..count).map(|_| connect()).collect::<Vec<TcpStream>>());
    let connecting = start.elapsed();
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
            std::thread::sleep(Duration::from_micros(300));
        }
    }
    (sockets, connecting)
}

/// Whether the service has not closed it. Reads nothing.
fn is_open(socket: &mut TcpStream) -> bool {
    match socket.peek(&mut [0; 1]) {
        Ok(0) => false,
        // Something to read hides whether it was closed; then a write fails, the second at the latest.
        Ok(_) => (0..2).all(|_| {
            std::thread::sleep(Duration::from_millis(1));
            socket.write_all(b"x").is_ok()
        }),
        Err(error) => error.kind() == ErrorKind::WouldBlock,
    }
}
