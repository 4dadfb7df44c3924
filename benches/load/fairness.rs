//! Light worlds beside heavy ones.

use std::net::Shutdown;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use pointmass::Advance;

use crate::Case;
use crate::client::request;
use crate::load::{Load, Outcome, Samples};
use crate::report::{Bench, Unit};
use crate::server::Server;
use crate::worlds::{TICK, Worlds, check_all_accepted};

pub(crate) const FAIRNESS: Case = Case {
    name: "fairness",
    title: "20 light worlds at 60 Hz beside long advances",
    note: "Light: 100 particles, one step, a connection for each world. Heavy: 20,000 particles and a million steps in one \
           request, several seconds of all cores, from as many clients as there are heavy worlds; at the end they go \
           away, and what they had asked for is taken back.",
    run,
};

/// Light worlds at 60 Hz, as a measure of what others notice of whatever else happens.
pub(crate) struct Light {
    pub(crate) worlds: Worlds,
    runs: Vec<Samples>,
}

impl Light {
    const WORLDS: usize = 20;

    pub(crate) fn create(server: &Server) -> Self {
        Self { worlds: Worlds::create(server, "light", Self::WORLDS, 100, Advance::by(TICK)), runs: Vec::new() }
    }

    /// The p99 of their latency.
    pub(crate) fn run(&mut self, bench: &mut Bench, server: &Server, beside: &'static str, seconds: f64) -> f64 {
        let (start, rate) = (Instant::now() + Duration::from_millis(20), Some(Self::WORLDS as f64 / TICK));
        let (address, requests) = (server.address(), &self.worlds.advances);
        let samples = Load { address, connections: Self::WORLDS, rate, start, seconds, requests }.run();
        check_all_accepted(bench, &samples);
        let latencies = samples.latencies();
        bench.record_latencies(&format!("light worlds {beside}"), &latencies);
        self.runs.push(samples);
        latencies.within(0.99)
    }

    pub(crate) fn check(&self, bench: &mut Bench, server: &Server) {
        self.worlds.check(bench, server, &self.runs.iter().collect::<Vec<_>>());
    }
}

fn run(bench: &mut Bench) {
    let server = Server::start(&[]);
    let mut light = Light::create(&server);
    let particles = bench.size(20_000, 2000);
    let long = Advance { steps: Some(1_000_000), ..Advance::by(10.0) };
    let heavy = Worlds::create(&server, "heavy", 4, particles, long);
    let seconds = bench.size(8.0, 0.2);
    let alone = light.run(bench, &server, "alone", seconds);
    for (count, beside) in [(1, "beside one long advance"), (4, "beside four long advances")] {
        let p99 = beside_heavy(bench, &server, &heavy, count, |bench| light.run(bench, &server, beside, seconds));
        bench.record(format!("p99 {beside} / alone"), p99 / alone, Unit::Ratio).at_most(3.0);
    }
    light.check(bench, &server);
}

/// While the first so many heavy worlds advance, again and again.
fn beside_heavy<T>(
    bench: &mut Bench,
    server: &Server,
    heavy: &Worlds,
    count: usize,
    run: impl FnOnce(&mut Bench) -> T,
) -> T {
    let (stop, finished) = (AtomicBool::new(false), AtomicUsize::new(0));
    let revision = |world: usize| {
        let path = format!("/v1/worlds/heavy{world}");
        server.client().expect(&request("GET", &path, ""), 200).revision().expect("a description has one")
    };
    let before: u64 = (0..count).map(revision).sum();
    let result = std::thread::scope(|scope| {
        let (stop, finished) = (&stop, &finished);
        let clients = heavy.advances[..count].iter().map(|advance| {
            let mut client = server.client();
            let closer = client.closer().expect("the service listens");
            scope.spawn(move || {
                while !stop.load(Ordering::SeqCst) {
                    if let Outcome::Accepted(_) = Outcome::of(&mut client, advance) {
                        finished.fetch_add(1, Ordering::SeqCst);
                    } else {
                        std::thread::sleep(Duration::from_millis(10));
                    }
                }
            });
            closer
        });
        let clients: Vec<_> = clients.collect();
        std::thread::sleep(Duration::from_millis(100));
        let result = run(bench);
        stop.store(true, Ordering::SeqCst);
        for client in &clients {
            let _gone = client.shutdown(Shutdown::Both);
        }
        result
    });
    // A description is told in turn, after what was taken back.
    let (after, finished): (u64, _) = ((0..count).map(revision).sum(), finished.into_inner());
    bench.check(after == before + finished as u64, || {
        format!("{finished} long advances were accepted, and the worlds went from revision {before} to {after}")
    });
    result
}
