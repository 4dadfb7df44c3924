//! One game that asks at every tick.

use std::time::{Duration, Instant};

use crate::Case;
use crate::client::request;
use crate::load::{Latencies, sleep_until};
use crate::report::{Bench, Unit};
use crate::server::Server;

pub(crate) const TICK: Case = Case {
    name: "tick",
    title: "A tick of 128 Hz, 1,000 particles",
    note: "One connection, paced: at each tick 100 forces in one request, then an advance by the tick under `exact` that \
           returns every position. The time is that of both, from the moment when the tick begins.",
    run,
};

const RATE: f64 = 128.0;
const PARTICLES: usize = 1000;

fn run(bench: &mut Bench) {
    let server = Server::start(&[]);
    let mut client = server.client();
    client.expect(&request("PUT", "/v1/worlds/game", r#"{"gravity":[0,-10,0]}"#), 201);
    let particles = format!(r#"{{"count":{PARTICLES},"velocity":[3,20,0.1],"damping":0.99}}"#);
    client.expect(&request("POST", "/v1/worlds/game/particles", &particles), 201);
    let ids: Vec<usize> = (0..PARTICLES).step_by(10).collect();
    let forces = format!(r#"{{"ids":{ids:?},"force":[0.1,0.2,0.3]}}"#);
    let forces = request("POST", "/v1/worlds/game/forces", &forces);
    let advance = format!(r#"{{"duration":{},"return":["position"]}}"#, 1.0 / RATE);
    let advance = request("POST", "/v1/worlds/game/advance", &advance);

    let ticks = bench.size(20 * 128, 13);
    let mut times = Vec::new();
    let start = Instant::now();
    for tick in 0..ticks {
        let begin = start + Duration::from_secs_f64(f64::from(tick) / RATE);
        sleep_until(begin);
        client.expect(&forces, 200);
        client.expect(&advance, 200);
        times.push(begin.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    let times = Latencies(times);
    bench.record_latencies("tick", &times);
    bench.record("p99 as a share of the tick", times.within(0.99) * RATE, Unit::Percent).at_most(0.2);

    let last = client.expect(&advance, 200).json();
    let positions = last["state"]["position"].as_array().map_or(0, Vec::len);
    let is_right = positions == PARTICLES && last["revision"] == 2 + 2 * ticks && last["step_count"] == 1 + ticks;
    bench.check(is_right, || format!("after {ticks} ticks: {} {positions} positions", last["revision"]));
}
