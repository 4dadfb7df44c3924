//! Many worlds in one request.

use std::time::{Duration, Instant};

use pointmass::Advance;

use crate::Case;
use crate::cbor::{self, Value};
use crate::client::{Client, request, request_with};
use crate::load::{Latencies, Load, Outcome, Sample, Samples, sleep_until};
use crate::report::{Bench, Unit};
use crate::rounds::{Contender, rounds};
use crate::scene::CBOR;
use crate::server::Server;
use crate::worlds::{TICK, Worlds, check_all_accepted, most_that_hold};

pub(crate) const BATCH: Case = Case {
    name: "batch",
    title: "1,000 worlds in one request",
    note: "Worlds of 100 particles, `newton_euler`; one advance of one step in each (`POST /v1/commands`), beside a request for \
           each world, one after the other on each of eight connections. Then the most worlds that hold at 60 Hz with one \
           request in JSON a tick: p99 within the tick and none refused, found by bisection.",
    run,
};

const CONNECTIONS: usize = 8;

fn run(bench: &mut Bench) {
    let count = bench.size(1000, 20);
    let server = Server::start(&[]);
    let worlds = Worlds::create(&server, "many", count, 100, Advance::by(TICK));
    let (json, cbor) = (in_json("many", count), in_cbor("many", count));
    let (mut text, mut binary) = (server.client(), server.client());
    let (mut texts, mut binaries, mut singles) = (Vec::new(), Vec::new(), Vec::new());
    // Once for warm memory.
    ask(&mut text, &json, &mut texts);
    ask(&mut binary, &cbor, &mut binaries);
    let seconds = bench.size(0.2, 0.05);
    let single: Contender<'_> = Box::new(|| {
        let (address, requests) = (server.address(), &worlds.advances);
        let start = Instant::now() + Duration::from_millis(1);
        let samples = Load { address, connections: CONNECTIONS, rate: None, start, seconds, requests }.run();
        let each = 1.0 / samples.throughput();
        singles.push(samples);
        each
    });
    let [in_json, in_cbor, single] = rounds(
        bench.size(25, 1),
        [
            Box::new(|| ask(&mut text, &json, &mut texts) / count as f64),
            Box::new(|| ask(&mut binary, &cbor, &mut binaries) / count as f64),
            single,
        ],
    );
    for (told, times) in [
        ("one request, JSON", &in_json),
        ("one request, CBOR", &in_cbor),
        ("a request for each, 8 connections", &single),
    ] {
        times.record(bench, format!("{told}: a world"), Unit::Seconds);
        bench.record(format!("{told}: worlds"), 1.0 / times.median(), Unit::PerSecond);
    }
    single.over(&in_json).record(bench, "a request for each / one request, JSON", Unit::Ratio);
    single.over(&in_cbor).record(bench, "a request for each / one request, CBOR", Unit::Ratio);

    for samples in &singles {
        check_all_accepted(bench, samples);
    }
    let answers = texts.iter().map(|answer| from_json(answer)).chain(binaries.iter().map(|answer| from_cbor(answer)));
    let batches: Vec<Samples> = answers.collect();
    for samples in &batches {
        check_all_accepted(bench, samples);
    }
    worlds.check(bench, &server, &singles.iter().chain(&batches).collect::<Vec<_>>());

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of worlds")]
    let limit = bench.size((1.5 * TICK / in_json.median()) as usize, 20).min(8000);
    hold(bench, limit);
}

/// How many worlds can be advanced by one request at each tick.
fn hold(bench: &mut Bench, limit: usize) {
    let server = Server::start(&[]);
    let worlds = Worlds::create(&server, "game", limit, 100, Advance::by(TICK));
    let mut client = server.client();
    let mut batches = Vec::new();
    let apart = bench.size(limit / 50, limit).max(1);
    let ticks = bench.size(150, 5);
    most_that_hold(bench, limit, apart, |count| {
        let request = in_json("game", count);
        let (mut latencies, mut answers) = (Vec::new(), Vec::new());
        let start = Instant::now();
        for tick in 0..ticks {
            let begin = start + Duration::from_secs_f64(f64::from(tick) * TICK);
            sleep_until(begin);
            ask(&mut client, &request, &mut answers);
            latencies.push(begin.elapsed().as_secs_f64());
        }
        latencies.sort_by(f64::total_cmp);
        let answers: Vec<Samples> = answers.iter().map(|answer| from_json(answer)).collect();
        let is_complete = answers.iter().all(|samples| samples.accepted() == count);
        batches.extend(answers);
        (Latencies(latencies), is_complete)
    });
    let faults: usize = batches.iter().map(Samples::faults).sum();
    bench.check(faults == 0, || format!("{faults} worlds of batches were neither advanced nor refused"));
    worlds.check(bench, &server, &batches.iter().collect::<Vec<_>>());
}

/// Sends a batch and keeps the answer; how many seconds it took.
fn ask(client: &mut Client, request: &[u8], answers: &mut Vec<Vec<u8>>) -> f64 {
    let start = Instant::now();
    client.fetch(request).unwrap_or_else(|error| panic!("no answer: {error}"));
    let time = start.elapsed().as_secs_f64();
    answers.push(client.answer().expect("it was answered").body.to_vec());
    time
}

/// One advance by a tick in each of the first so many worlds.
pub(crate) fn in_json(name: &str, count: usize) -> Vec<u8> {
    let world = |i| format!(r#""{name}{i}":{{"commands":[{{"advance":{{"duration":{TICK}}}}}]}}"#);
    let worlds = (0..count).map(world).collect::<Vec<_>>().join(",");
    request("POST", "/v1/commands", &format!(r#"{{"worlds":{{{worlds}}}}}"#))
}

fn in_cbor(name: &str, count: usize) -> Vec<u8> {
    let advance = cbor::map([("advance", cbor::map([("duration", cbor::float(TICK))]))]);
    let commands = cbor::map([("commands", cbor::list(&[advance]))]);
    let names: Vec<String> = (0..count).map(|i| format!("{name}{i}")).collect();
    let worlds = cbor::map(names.iter().map(|name| (name.as_str(), commands.clone())));
    request_with("POST", "/v1/commands", &CBOR, &cbor::map([("worlds", worlds)]))
}

fn from_json(answer: &[u8]) -> Samples {
    let answer: serde_json::Value = serde_json::from_slice(answer).unwrap_or_default();
    let worlds = answer["worlds"].as_object().into_iter().flatten();
    samples(worlds.map(|(name, told)| (name.as_str(), told["revision"].as_u64(), told["status"].as_u64())))
}

fn from_cbor(answer: &[u8]) -> Samples {
    let answer = Value::of(answer);
    let Some(Value::Map(worlds)) = answer.as_ref().and_then(|answer| answer.member("worlds")) else {
        return Samples::default();
    };
    let number = |told: &Value<'_>, name| told.member(name).and_then(Value::whole);
    samples(worlds.iter().map(|(name, told)| (*name, number(told, "revision"), number(told, "status"))))
}

/// As if each world had answered for itself.
fn samples<'a>(worlds: impl Iterator<Item = (&'a str, Option<u64>, Option<u64>)>) -> Samples {
    let sample = |(name, revision, status): (&str, Option<u64>, Option<u64>)| {
        let outcome = match (revision, status) {
            (Some(revision), _) => Outcome::Accepted(Some(revision)),
            (None, Some(503)) => Outcome::Refused,
            (None, status) => Outcome::Answered(status.map_or(0, |status| u16::try_from(status).unwrap_or(0))),
        };
        let request = name.trim_start_matches(char::is_alphabetic).parse().expect("its number");
        Sample { request, intended: 0.0, sent: 0.0, latency: 0.0, outcome }
    };
    Samples(worlds.map(sample).collect())
}
