//! Worlds followed live, by the hundred.

use std::io::Read;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use pointmass::{Advance, Integrator, World};

use crate::Case;
use crate::batch;
use crate::client::{Client, request};
use crate::follower::{Follower, Next, Way};
use crate::load::{Latencies, sleep_until};
use crate::report::{Bench, Unit};
use crate::scene::{self, Columns, Scene};
use crate::server::Server;
use crate::worlds::TICK;

pub(crate) const STREAM: Case = Case {
    name: "stream",
    title: "100 clients follow worlds at 60 Hz",
    note: "Worlds of 1,000 particles, advanced at 60 Hz by one more client, and the positions of all particles to 100 clients: \
           at most 60 events a second each, or 1,000, which is as they come. An event is late by the time from the answer to \
           the advance until a client has all of it; the newest state takes the place of one that a client was not ready \
           for. First some advances wait until everybody was told each. Slow readers take 1 kB a second.",
    run,
};

/// Who follows what, and how.
struct Audience {
    name: &'static str,
    way: Way,
    worlds: usize,
    rate: u32,
    has_slow_readers: bool,
}

fn run(bench: &mut Bench) {
    let one = Audience { name: "events", way: Way::ServerSent, worlds: 1, rate: 60, has_slow_readers: true };
    let many = bench.size(100, 4);
    for audience in [
        Audience { name: "events as they come", rate: 1000, has_slow_readers: false, ..one },
        Audience { name: "events of 100 worlds", worlds: many, has_slow_readers: false, ..one },
        Audience { name: "WebSocket, JSON", way: Way::Json, has_slow_readers: false, ..one },
        Audience { name: "WebSocket, CBOR", way: Way::Cbor, has_slow_readers: false, ..one },
        one,
    ] {
        audience.follow(bench);
    }
}

/// What a client was told.
#[derive(Debug, Default)]
struct Heard {
    /// Each event: of which revision, when, and how many bytes.
    events: Vec<(u64, Instant, usize)>,
    /// Those that are looked at, whole.
    kept: Vec<(u64, Vec<u8>)>,
    /// Whether the service said that it was the end.
    was_ended: bool,
}

/// What is known while it runs.
struct Watch {
    /// The last revision that each client was told.
    told: Vec<AtomicU64>,
    /// Events up to this revision are kept.
    keep: u64,
    stop: AtomicBool,
}

/// Ends waiting when a case fails.
struct Ended<'a>(&'a AtomicBool);

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// By the clock: when each advance was answered, and how long they took.
struct Clocked {
    answers: Vec<(u64, Instant)>,
    advances: Latencies,
}

/// How long one event may take that everybody waits for.
const PATIENCE: Duration = Duration::from_secs(20);

impl Watch {
    /// Waits until everybody was told this revision.
    fn all_know(&self, revision: u64) -> bool {
        let start = Instant::now();
        while self.told.iter().any(|told| told.load(Ordering::SeqCst) < revision) {
            if start.elapsed() > PATIENCE {
                return false;
            }
            std::thread::sleep(Duration::from_micros(500));
        }
        true
    }

    fn follow(&self, client: usize, mut follower: Follower) -> Heard {
        let mut heard = Heard::default();
        let mut last = Vec::new();
        while !self.stop.load(Ordering::SeqCst) {
            match follower.next() {
                Ok(Next::Event(revision)) => {
                    heard.events.push((revision, Instant::now(), follower.event().len()));
                    if revision <= self.keep {
                        heard.kept.push((revision, follower.event().to_vec()));
                    } else {
                        last.clear();
                        last.extend_from_slice(follower.event());
                    }
                    self.told[client].store(revision, Ordering::SeqCst);
                }
                Ok(Next::Nothing) => {}
                Ok(Next::End) => {
                    heard.was_ended = true;
                    break;
                }
                Err(_) => break,
            }
        }
        if let Some((revision, ..)) = heard.events.last()
            && !last.is_empty()
        {
            heard.kept.push((*revision, last));
        }
        heard
    }
}

impl Audience {
    fn follow(&self, bench: &mut Bench) {
        let Self { name, way, worlds, rate, has_slow_readers } = *self;
        let server = Server::start(&[]);
        let mut client = server.client();
        let scene = Scene::<f64>::new(bench.size(1000, 50), Integrator::NewtonEuler);
        let names: Vec<String> = (0..worlds).map(|i| format!("world{i}")).collect();
        for name in &names {
            scene.create(&mut client, name);
        }
        let by = Advance::by(TICK);
        let advance = if worlds == 1 { scene::advance("world0", by) } else { batch::in_json("world", worlds) };

        let first = scene.world().revision();
        let (in_step, ticks) = (bench.size(5, 4), bench.size(240, 6));
        let clients = bench.size(100, 4);
        let told = (0..clients).map(|_| AtomicU64::new(0)).collect();
        let watch = Watch { told, keep: first + in_step, stop: AtomicBool::new(false) };
        let mut revision = first;
        let mut phases = Vec::new();
        let heard: Vec<Heard> = std::thread::scope(|scope| {
            let _ended = Ended(&watch.stop);
            let followers = (0..clients).map(|i| {
                let follower = Follower::connect(server.address(), way, &names[i % worlds], rate);
                let follower = follower.unwrap_or_else(|error| panic!("not followed: {error}"));
                let watch = &watch;
                scope.spawn(move || watch.follow(i, follower))
            });
            let followers: Vec<_> = followers.collect();
            let mut knows = watch.all_know(first);
            for _ in 0..in_step {
                client.expect(&advance, 200);
                revision += 1;
                knows &= watch.all_know(revision);
            }
            bench.check(knows, || format!("{name}: not everybody was told what everybody waited for"));
            phases.push((name.to_owned(), clocked(&mut client, &advance, ticks, &mut revision)));
            knows = watch.all_know(revision);
            if has_slow_readers {
                let readers = bench.size(10, 2);
                phases.push(("events beside slow readers".to_owned(), {
                    let before = server.resident();
                    let _can = server.forget_peak();
                    let slow =
                        slow_readers(&server, readers, rate, || clocked(&mut client, &advance, ticks, &mut revision));
                    knows &= watch.all_know(revision);
                    let growth = server.peak() - before;
                    bench
                        .record("events beside slow readers: memory above that before", growth, Unit::Bytes)
                        .at_most(f64::from(8 << 20));
                    slow
                }));
            }
            bench.check(knows, || format!("{name}: not everybody was told the last state"));
            for name in &names {
                client.expect(&request("DELETE", &format!("/v1/worlds/{name}"), ""), 204);
            }
            followers.into_iter().map(|follower| follower.join().expect("it does not panic")).collect()
        });
        let mut p99s = Vec::new();
        for (told, clocked) in phases {
            p99s.push(record(bench, &told, &clocked, &heard));
        }
        if let [alone, beside] = p99s[..] {
            bench.record("events beside slow readers: p99 / alone", beside / alone, Unit::Ratio).at_most(3.0);
        }
        self.check(bench, &scene.world(), by, &heard, first..=first + in_step, revision);
    }

    /// Everybody was told each revision that was waited for, and the last one, to the bit; each at most once, in order; and
    /// that it was the end.
    fn check(
        &self,
        bench: &mut Bench,
        world: &World<f64>,
        by: Advance,
        heard: &[Heard],
        in_step: std::ops::RangeInclusive<u64>,
        last: u64,
    ) {
        let mut world = world.clone();
        let mut here = Vec::new();
        for revision in *in_step.start()..=last {
            if in_step.contains(&revision) || revision == last {
                let columns = Columns { velocity: Vec::new(), ..Columns::of(&world) };
                here.push((revision, columns.bits()));
            }
            world.advance(by).expect("the service accepted it");
        }
        let is_known = |event: &(u64, Vec<u8>), here: &(u64, Vec<u8>)| {
            let told = Follower::columns(self.way, &event.1).map(|columns| columns.bits());
            event.0 == here.0 && told.as_ref() == Some(&here.1)
        };
        for (i, heard) in heard.iter().enumerate() {
            let Heard { events, kept, was_ended } = heard;
            let is_right =
                kept.len() == here.len() && kept.iter().zip(&here).all(|(event, here)| is_known(event, here));
            bench.check(is_right, || {
                let told: Vec<u64> = kept.iter().map(|(revision, _)| *revision).collect();
                format!("{}: client {i} was not told what the library says, but something of {told:?}", self.name)
            });
            let is_ordered = events.is_sorted_by(|a, b| a.0 < b.0);
            bench.check(is_ordered, || format!("{}: client {i} was told a state twice, or an older one", self.name));
            bench.check(*was_ended, || format!("{}: client {i} was not told that it was the end", self.name));
        }
    }
}

/// Advances at 60 Hz.
fn clocked(client: &mut Client, advance: &[u8], ticks: u32, revision: &mut u64) -> Clocked {
    let (mut answers, mut advances) = (Vec::new(), Vec::new());
    let start = Instant::now();
    for tick in 0..ticks {
        let begin = start + Duration::from_secs_f64(f64::from(tick) * TICK);
        sleep_until(begin);
        client.expect(advance, 200);
        *revision += 1;
        answers.push((*revision, Instant::now()));
        advances.push(begin.elapsed().as_secs_f64());
    }
    advances.sort_by(f64::total_cmp);
    Clocked { answers, advances: Latencies(advances) }
}

/// While so many others take 1 kB a second of the same events.
fn slow_readers<T>(server: &Server, count: usize, rate: u32, run: impl FnOnce() -> T) -> T {
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _ended = Ended(&stop);
        for _ in 0..count {
            let follower = Follower::connect(server.address(), Way::ServerSent, "world0", rate);
            let mut stream = follower.expect("the service listens").into_stream();
            let stop = &stop;
            scope.spawn(move || {
                while !stop.load(Ordering::SeqCst) && stream.read(&mut [0; 100]).is_ok_and(|read| read > 0) {
                    std::thread::sleep(Duration::from_millis(100));
                }
            });
        }
        run()
    })
}

/// The p99 of how late events were.
fn record(bench: &mut Bench, told: &str, clocked: &Clocked, heard: &[Heard]) -> f64 {
    let Clocked { answers, advances } = clocked;
    let first = answers.first().map_or(0, |(revision, _)| *revision);
    let of = |revision: u64| {
        let index = usize::try_from(revision.checked_sub(first)?).ok()?;
        answers.get(index).map(|(_, answered)| *answered)
    };
    let events = heard.iter().flat_map(|heard| &heard.events);
    let late = events
        .filter_map(|(revision, at, bytes)| Some((at.saturating_duration_since(of(*revision)?).as_secs_f64(), *bytes)));
    let (mut late, bytes): (Vec<f64>, Vec<usize>) = late.unzip();
    late.sort_by(f64::total_cmp);
    let late = Latencies(late);
    let span = answers.first().zip(answers.last()).map(|((_, first), (_, last))| *last - *first);
    let seconds = span.unwrap_or_default().as_secs_f64() + TICK;
    let rate = late.0.len() as f64 / seconds / heard.len() as f64;
    bench.record(format!("{told}: events a second and client"), rate, Unit::PerSecond).at_least(57.0);
    bench.record(format!("{told}: sent a second"), bytes.iter().sum::<usize>() as f64 / seconds, Unit::Bytes);
    bench.record(format!("{told}: late, median"), late.within(0.5), Unit::Seconds);
    bench.record(format!("{told}: late, p99"), late.within(0.99), Unit::Seconds).at_most(TICK);
    bench.record(format!("{told}: advances, p99"), advances.within(0.99), Unit::Seconds).at_most(TICK);
    late.within(0.99)
}
