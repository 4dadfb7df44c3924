//! Ends: SIGTERM and SIGKILL while requests come in.

use std::time::{Duration, Instant};

use pointmass::Advance;

use crate::Case;
use crate::client::{Address, request};
use crate::load::{Load, Outcome, Samples, sleep_until};
use crate::report::{Bench, Unit};
use crate::server::Server;
use crate::throughput::median;
use crate::worlds::{TICK, Worlds};

pub(crate) const ENDING: Case = Case {
    name: "ending",
    title: "SIGTERM and SIGKILL under load",
    note: "1,000 advances a second on 16 connections, and two advances of some tenths of a second. After SIGTERM what is in \
           flight is finished, what comes is refused, and the exit code is 0. After SIGKILL the service is started again \
           on the same port, without worlds: its state is in memory. Clients connect anew. Medians of the rounds.",
    run,
};

const CONNECTIONS: usize = 16;
const RATE: f64 = 1000.0;

fn run(bench: &mut Bench) {
    let rounds = bench.size(5, 1);
    let ends: Vec<[f64; 2]> = (0..rounds).map(|_| terminate(bench)).collect();
    bench.record("from SIGTERM to the exit", median(ends.iter().map(|end| end[0])), Unit::Seconds);
    bench.record("of that, after the last long answer", median(ends.iter().map(|end| end[1])), Unit::Seconds);
    let starts: Vec<f64> = (0..rounds).map(|_| kill(bench)).collect();
    bench.record("from SIGKILL to the first answer of the next one", median(starts.into_iter()), Unit::Seconds);
}

fn load<'a>(address: &'a Address, worlds: &'a Worlds, start: Instant, seconds: f64) -> Load<'a> {
    Load { address, connections: CONNECTIONS, rate: Some(RATE), start, seconds, requests: &worlds.advances }
}

/// How long it took to end, and how much of that was after the answer to the last long advance.
fn terminate(bench: &mut Bench) -> [f64; 2] {
    let mut server = Server::start(&[]);
    let address = server.address().clone();
    let worlds = Worlds::create(&server, "light", CONNECTIONS, 100, Advance::by(TICK));
    let long = Advance { steps: Some(bench.size(100_000, 20_000)), ..Advance::by(1.0) };
    let long = Worlds::create(&server, "long", 2, 20_000, long);
    let start = Instant::now() + Duration::from_millis(20);
    let moment = bench.size(0.5, 0.2);
    let long_start = start + Duration::from_secs_f64(moment - 0.1);
    let (light, finished, signalled, end, code) = std::thread::scope(|scope| {
        let light = scope.spawn(|| load(&address, &worlds, start, 2.0 * moment).run());
        let long = scope.spawn(|| {
            Load { connections: 2, rate: Some(1e3), seconds: 0.002, ..load(&address, &long, long_start, 0.0) }.run()
        });
        sleep_until(start + Duration::from_secs_f64(moment));
        server.terminate();
        let signalled = Instant::now();
        let code = server.wait();
        let end = signalled.elapsed().as_secs_f64();
        (light.join().expect("no panic"), long.join().expect("no panic"), signalled, end, code)
    });
    bench.check(code == Some(0), || format!("the exit code after SIGTERM is {code:?}"));
    let accepted = finished.accepted();
    bench.check(accepted == 2, || format!("{accepted} of 2 long advances in flight were finished: {finished:?}"));
    // What was sent before the signal is answered, and every answer is one that the contract has.
    let moment = (signalled - start).as_secs_f64() - 0.01;
    let is_fault = |outcome| matches!(outcome, Outcome::Closed | Outcome::Unsent);
    let lost = light.0.iter().filter(|sample| sample.sent < moment && is_fault(sample.outcome)).count();
    bench.check(lost == 0, || format!("{lost} requests from before SIGTERM had no answer"));
    let wrong = light.count(|outcome| matches!(outcome, Outcome::Answered(_)));
    bench.check(wrong == 0, || format!("{wrong} answers were neither 200 nor 503"));
    check_some_accepted(bench, &worlds, &light);
    let last = finished.0.iter().map(|sample| sample.intended + sample.latency).fold(0.0, f64::max);
    let last = long_start + Duration::from_secs_f64(last);
    [end, end - last.saturating_duration_since(signalled).as_secs_f64()]
}

/// How long nobody was answered.
fn kill(bench: &mut Bench) -> f64 {
    let mut server = Server::start(&[]);
    let Address::Tcp(socket) = server.address().clone() else { panic!("a TCP listener") };
    let address = Address::Tcp(socket);
    let worlds = Worlds::create(&server, "light", CONNECTIONS, 100, Advance::by(TICK));
    let start = Instant::now() + Duration::from_millis(20);
    let moment = bench.size(0.5, 0.2);
    let (samples, next, seconds) = std::thread::scope(|scope| {
        let running = scope.spawn(|| load(&address, &worlds, start, 3.0 * moment).run());
        sleep_until(start + Duration::from_secs_f64(moment));
        let killed = Instant::now();
        server.kill();
        let next = Server::listening_on(&[&socket.to_string()], &[]);
        let worlds = next.client().expect(&request("GET", "/v1/worlds", ""), 200).json();
        let seconds = killed.elapsed().as_secs_f64();
        let is_empty = worlds["worlds"].as_array().is_some_and(Vec::is_empty);
        bench.check(is_empty, || format!("after SIGKILL there are {worlds}"));
        (running.join().expect("no panic"), next, seconds)
    });
    // The same connections ask the next one, which has no worlds until they are made again.
    let reconnected = samples.count(|outcome| outcome == Outcome::Answered(404));
    bench.check(reconnected > 0, || "no client has reached the next service".to_owned());
    let wrong = samples.count(|outcome| matches!(outcome, Outcome::Answered(status) if status != 404));
    bench.check(wrong == 0, || format!("{wrong} answers were neither 200, 404 nor 503"));
    check_some_accepted(bench, &worlds, &samples);
    let again = Worlds::create(&next, "light", CONNECTIONS, 100, Advance::by(TICK));
    let samples = load(next.address(), &again, Instant::now(), 0.1).run();
    again.check(bench, &next, &[&samples]);
    seconds
}

fn check_some_accepted(bench: &mut Bench, worlds: &Worlds, samples: &Samples) {
    let accepted: usize = worlds.check_answers(bench, &[samples]).iter().sum();
    bench.check(accepted > 0, || "no advance was accepted".to_owned());
}
