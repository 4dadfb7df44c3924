//! Three times as much as the service can do.

use std::time::{Duration, Instant};

use pointmass::Advance;

use crate::Case;
use crate::load::{Load, Outcome, Samples};
use crate::report::{Bench, Unit};
use crate::server::Server;
use crate::worlds::Worlds;

pub(crate) const OVERLOAD: Case = Case {
    name: "overload",
    title: "Three times the capacity offered",
    note: "64 worlds of 10,000 particles, 2,000 steps in each advance, some milliseconds in the compute pool. Capacity: \
           16 connections that ask again when they are answered, before and after; the larger counts. Between, three \
           times the first by the clock, on as many as 384 connections; a request that finds none free for a second is \
           given up. Goodput is accepted requests of \
           a second. The budget of memory is what the particles are charged with. Normal again: ten requests in a row, \
           50 a second, that each take at most twice the p99 from before.",
    run,
};

const WORLDS: usize = 64;

fn run(bench: &mut Bench) {
    let (particles, steps) = bench.size((10_000, 2000), (1000, 500));
    let budget = 256 * WORLDS * particles;
    let server = Server::start(&["--memory-bytes-max", &budget.to_string()]);
    let advance = Advance { steps: Some(steps), ..Advance::by(1.0) };
    let worlds = Worlds::create(&server, "busy", WORLDS, particles, advance);
    let load = |connections, rate, start, seconds| {
        let (address, requests) = (server.address(), &worlds.advances[..]);
        Load { address, connections, rate, start, seconds, requests }.run()
    };
    let now = Instant::now;

    let closed = |bench: &Bench| load(16, None, now(), bench.size(4.0, 0.2));
    let first = closed(bench);
    let capacity = first.throughput();
    let probes = |start, seconds| load(1, Some(50.0), start, seconds);
    let calm = probes(now(), bench.size(3.0, 0.4));
    let normal = calm.latencies().within(0.99);
    bench.record("p99 without load", normal, Unit::Seconds);
    let before = server.resident();

    let seconds = bench.size(10.0, 0.3);
    let start = now() + Duration::from_millis(50);
    let end = start + Duration::from_secs_f64(seconds);
    let (offered, after) = std::thread::scope(|scope| {
        let after = scope.spawn(|| probes(end, bench.size(8.0, 0.6)));
        let offered = load(bench.size(384, 32), Some(3.0 * capacity), start, seconds);
        (offered, after.join().expect("it does not panic"))
    });
    let second = closed(bench);
    let offered_rate = 3.0 * capacity;
    let capacity = capacity.max(second.throughput());
    bench.record("capacity", capacity, Unit::PerSecond);
    bench.record("offered / capacity", offered_rate / capacity, Unit::Ratio);
    bench.record("offered", offered.0.len() as f64 / seconds, Unit::PerSecond);
    bench.record("goodput / capacity", offered.throughput() / capacity, Unit::Percent).at_least(0.9);
    let share = |count| count as f64 / offered.0.len() as f64;
    let is_refused = |outcome| outcome == Outcome::Refused;
    bench.record("accepted", share(offered.accepted()), Unit::Percent);
    bench.record("refused with 503", share(offered.count(is_refused)), Unit::Percent);
    bench.record("given up by the client", share(offered.count(|outcome| outcome == Outcome::Unsent)), Unit::Percent);
    let accepted = offered.latencies();
    bench.record("accepted, median", accepted.within(0.5), Unit::Seconds);
    bench.record("accepted, p99", accepted.within(0.99), Unit::Seconds).at_most(0.25);
    bench.record("refused, p99", offered.latencies_of(is_refused).within(0.99), Unit::Seconds);
    let recovered = recovery(&after, 2.0 * normal).unwrap_or(f64::INFINITY);
    bench.record("normal again after", recovered, Unit::Seconds).at_most(2.0);
    bench.record("resident before", before, Unit::Bytes);
    bench.record("resident after", server.resident(), Unit::Bytes);
    bench.record("resident at most", server.peak(), Unit::Bytes);
    bench.record("resident at most / budget", server.peak() / budget as f64, Unit::Percent).at_most(1.1);

    let runs = [&first, &calm, &offered, &after, &second];
    let faults: usize = runs.iter().map(|samples| samples.faults()).sum();
    bench.check(faults == 0, || format!("{faults} requests were answered with neither 200 nor 503 and Retry-After"));
    worlds.check(bench, &server, &runs);
}

/// When the first ten probes in a row began that were as fast as this.
fn recovery(probes: &Samples, limit: f64) -> Option<f64> {
    let is_normal = |outcome, latency: f64| matches!(outcome, Outcome::Accepted(_)) && latency <= limit;
    let rows = probes.0.windows(10);
    let first = rows.into_iter().find(|row| row.iter().all(|sample| is_normal(sample.outcome, sample.latency)))?;
    Some(first[0].intended)
}
