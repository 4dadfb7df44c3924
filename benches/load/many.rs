//! Many small worlds at the pace of games.

use std::time::{Duration, Instant};

use pointmass::Advance;

use crate::Case;
use crate::load::{Load, Samples};
use crate::report::{Bench, Unit};
use crate::server::Server;
use crate::worlds::{TICK, Worlds, most_that_hold};

pub(crate) const MANY: Case = Case {
    name: "many",
    title: "1,000 worlds of 100 particles at 60 Hz",
    note: "One request for each world and tick, spread over the tick, on eight connections; `newton_euler`, one step. \
           First all of them, then the most worlds that hold: p99 within a tick and no request given up (one is after \
           a second), found by bisection.",
    run,
};

/// One request for each world and tick is what there is. A request that speaks of many worlds belongs here, as another way.
struct PerWorld<'a> {
    server: &'a Server,
    worlds: &'a Worlds,
}

impl PerWorld<'_> {
    const CONNECTIONS: usize = 8;

    /// The first so many worlds, each once in every tick.
    fn run(&self, worlds: usize, seconds: f64) -> Samples {
        let requests = &self.worlds.advances[..worlds];
        let (start, rate) = (Instant::now() + Duration::from_millis(20), Some(worlds as f64 / TICK));
        let address = self.server.address();
        Load { address, connections: Self::CONNECTIONS, rate, start, seconds, requests }.run()
    }
}

fn run(bench: &mut Bench) {
    let all = bench.size(1000, 20);
    let server = Server::start(&[]);
    let worlds = Worlds::create(&server, "small", all, 100, Advance::by(TICK));
    let way = PerWorld { server: &server, worlds: &worlds };

    let mut runs = vec![way.run(all, bench.size(6.0, 0.2))];
    let lost = lost(&runs[0]);
    bench.record("all worlds: advances offered", all as f64 / TICK, Unit::PerSecond);
    bench.record("all worlds: advances accepted", runs[0].throughput(), Unit::PerSecond);
    bench.record("all worlds: given up", lost as f64 / runs[0].0.len() as f64, Unit::Percent).at_most(0.0);
    bench.record("all worlds: p99", runs[0].latencies().within(0.99), Unit::Seconds).at_most(TICK);

    let apart = bench.size(25, all);
    let seconds = bench.size(3.0, 0.1);
    most_that_hold(bench, all, apart, |worlds| {
        let samples = way.run(worlds, seconds);
        let held = (samples.latencies(), self::lost(&samples) == 0);
        runs.push(samples);
        held
    });
    let faults: usize = runs.iter().map(Samples::faults).sum();
    bench.check(faults == 0, || format!("{faults} requests were answered with neither 200 nor 503"));
    worlds.check(bench, &server, &runs.iter().collect::<Vec<_>>());
}

fn lost(samples: &Samples) -> usize {
    samples.0.len() - samples.accepted()
}
