//! How much of a request is the service's own: an advance of an empty world beside axum with nothing behind it.

use std::time::{Duration, Instant};

use crate::Case;
use crate::client::{Address, request};
use crate::load::{Latencies, Load, Samples};
use crate::report::{Bench, Unit};
use crate::server::Server;
use crate::worlds::check_all_accepted;

pub(crate) const THROUGHPUT: Case = Case {
    name: "throughput",
    title: "An advance of an empty world, and a bare axum echo",
    note: "The echo reads `{\"duration\":0.016}` as JSON and answers with it; both have the same number of threads that \
           answer. Each connection asks again as soon as it is answered. Service and echo ran in turns; requests a second \
           are medians of the turns, ratios those of the ratios within each turn. Turns are short, because others on \
           the machine come and go; processor time, that of the service or the echo alone for one request, feels them \
           least.",
    run,
};

const BODY: &str = r#"{"duration":0.016}"#;

/// One turn: requests a second, the median latency, and processor time of the server for one request.
struct Turn {
    rate: f64,
    median: f64,
    processor: f64,
}

fn run(bench: &mut Bench) {
    let workers = (std::thread::available_parallelism().map_or(1, usize::from) / 2).max(1).to_string();
    let socket = std::env::temp_dir().join(format!("pointmass-load-{}.sock", std::process::id()));
    let unix = format!("unix:{}", socket.display());
    let ours = Server::listening_on(&["127.0.0.1:0", &unix], &["--workers", &workers]);
    let echo = Server::echo(&workers);
    let mut client = ours.client();
    client.expect(&request("PUT", "/v1/worlds/empty", ""), 201);
    let advance = request("POST", "/v1/worlds/empty/advance", BODY);
    let echoed = request("POST", "/echo", BODY);
    let answer = echo.client().expect(&echoed, 200).text().into_owned();
    bench.check(answer == BODY, || format!("the echo answers {answer}"));

    let mut accepted = 0;
    for connections in [1, 16] {
        let (mut services, mut echoes) = (Vec::new(), Vec::new());
        for i in 0..bench.size(41, 1) {
            let (a, b) = side_by_side(
                i,
                || turn(bench.size(0.15, 0.05), &ours, ours.address(), connections, &advance),
                || turn(bench.size(0.15, 0.05), &echo, echo.address(), connections, &echoed),
            );
            accepted += a.1.accepted();
            check_all_accepted(bench, &a.1);
            check_all_accepted(bench, &b.1);
            services.push(a.0);
            echoes.push(b.0);
        }
        let told = if connections == 1 { "1 connection".to_owned() } else { format!("{connections} connections") };
        let rate = |turns: &[Turn]| median(turns.iter().map(|turn| turn.rate));
        bench.record(format!("{told}: service"), rate(&services), Unit::PerSecond);
        bench.record(format!("{told}: echo"), rate(&echoes), Unit::PerSecond);
        let ratios = || services.iter().zip(&echoes).map(|(ours, echo)| ours.rate / echo.rate);
        let quartiles = [quantile(0.25, ratios()), quantile(0.75, ratios())];
        let ratio = bench.record(format!("{told}: service / echo"), median(ratios()), Unit::Percent);
        ratio.between(quartiles).at_least(0.9);
        let processor = |turns: &[Turn]| median(turns.iter().map(|turn| turn.processor));
        bench.record(format!("{told}: processor time, service"), processor(&services), Unit::Seconds);
        bench.record(format!("{told}: processor time, echo"), processor(&echoes), Unit::Seconds);
        let ratios = services.iter().zip(&echoes).map(|(ours, echo)| echo.processor / ours.processor);
        bench.record(format!("{told}: processor time, echo / service"), median(ratios), Unit::Percent);
    }

    let (mut tcp, mut local) = (Vec::new(), Vec::new());
    for i in 0..bench.size(31, 1) {
        let seconds = bench.size(0.15, 0.05);
        let (a, b) = side_by_side(
            i,
            || turn(seconds, &ours, ours.address(), 1, &advance),
            || turn(seconds, &ours, ours.second_address(), 1, &advance),
        );
        accepted += a.1.accepted() + b.1.accepted();
        tcp.push(a.0.median);
        local.push(b.0.median);
    }
    bench.record("round trip over TCP, median", median(tcp.iter().copied()), Unit::Seconds);
    bench.record("round trip over a Unix socket, median", median(local.iter().copied()), Unit::Seconds);
    let ratios = local.iter().zip(&tcp).map(|(local, tcp)| local / tcp);
    bench.record("Unix socket / TCP", median(ratios), Unit::Ratio).at_most(0.85);

    let mut client = ours.client();
    let world = client.expect(&request("GET", "/v1/worlds/empty", ""), 200).json();
    let is_right = world["revision"] == accepted && world["step_count"] == accepted;
    bench.check(is_right, || format!("after {accepted} accepted advances the world is {world}"));
}

/// Who begins changes from turn to turn.
fn side_by_side<A, B>(turn: usize, a: impl FnOnce() -> A, b: impl FnOnce() -> B) -> (A, B) {
    if turn.is_multiple_of(2) {
        let a = a();
        (a, b())
    } else {
        let b = b();
        (a(), b)
    }
}

fn turn(seconds: f64, server: &Server, address: &Address, connections: usize, advance: &[u8]) -> (Turn, Samples) {
    let requests = [advance.to_vec()];
    let start = Instant::now() + Duration::from_millis(1);
    let before = server.processor_time();
    let samples = Load { address, connections, rate: None, start, seconds, requests: &requests }.run();
    let processor = (server.processor_time() - before) / samples.accepted() as f64;
    (Turn { rate: samples.throughput(), median: samples.latencies().within(0.5), processor }, samples)
}

pub(crate) fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(0.5, values)
}

fn quantile(share: f64, values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    Latencies(values).within(share)
}
