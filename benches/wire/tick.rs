//! A whole tick of a game in one request.

use std::time::{Duration, Instant};

use pointmass::{Advance, Column, Command, DVec3, Integrator, ParticleId, Selection, World};

use crate::Case;
use crate::cbor;
use crate::client::{Address, Client, request, request_with};
use crate::load::{Latencies, sleep_until};
use crate::report::{Bench, Unit};
use crate::rounds::{Contender, rounds};
use crate::scene::{self, CBOR, Columns, Scene, json};
use crate::server::Server;

pub(crate) const TICK: Case = Case {
    name: "tick",
    title: "A whole tick in one request",
    note: "Under `exact`, 1,000 particles: a force on each of 100, an advance by a tick of 128 Hz, and the positions of those \
           100. In one request (`POST …/commands`), in three (forces, advance, particles), or with a request for each force. \
           Back to back, a round being the median of a hundred ticks, beside the bare echo that the load is compared with; \
           then by the clock, at 128 Hz.",
    run,
};

const RATE: f64 = 128.0;
const PARTICLES: usize = 1000;
const FORCES: usize = 100;

/// A world of its own that is asked in one way, tick for tick.
struct Game {
    name: &'static str,
    client: Client,
    /// The last one answers with positions.
    requests: Vec<Vec<u8>>,
    is_cbor: bool,
    ticks: usize,
}

impl Game {
    fn new(name: &'static str, address: &Address, scene: &Scene<f64>, requests: Vec<Vec<u8>>, is_cbor: bool) -> Self {
        let mut client = Client::new(address);
        scene.create(&mut client, name);
        let mut game = Self { name, client, requests, is_cbor, ticks: 0 };
        game.tick();
        game
    }

    fn tick(&mut self) {
        for request in &self.requests {
            self.client.expect(request, 200);
        }
        self.ticks += 1;
    }

    /// The median of so many.
    fn turn(&mut self, ticks: usize) -> f64 {
        median((0..ticks).map(|_| {
            let start = Instant::now();
            self.tick();
            start.elapsed().as_secs_f64()
        }))
    }

    fn contender(&mut self, ticks: usize) -> Contender<'_> {
        Box::new(move || self.turn(ticks))
    }

    /// By the clock.
    fn paced(&mut self, ticks: u32) -> Latencies {
        let start = Instant::now();
        let mut times = Vec::new();
        for tick in 0..ticks {
            let begin = start + Duration::from_secs_f64(f64::from(tick) / RATE);
            sleep_until(begin);
            self.tick();
            times.push(begin.elapsed().as_secs_f64());
        }
        times.sort_by(f64::total_cmp);
        Latencies(times)
    }

    /// After one more tick the world has the future that the library says, and told its positions.
    fn check(mut self, bench: &mut Bench, scene: &Scene<f64>) {
        self.tick();
        let mut world = scene.world();
        for _ in 0..self.ticks {
            tick_here(&mut world);
        }
        let answer = self.client.expect(self.requests.last().expect("at least one"), 200);
        let told = if self.is_cbor {
            cbor::Value::of(answer.body).and_then(|answer| {
                let cbor::Value::List(results) = answer.member("results")? else { return None };
                Columns::<f64>::from_value(results.last()?)
            })
        } else if self.requests.len() == 1 {
            let results = &answer.json()["results"];
            results.as_array().and_then(|results| Columns::from_json(results.last()?.to_string().as_bytes()))
        } else {
            Columns::from_rows(answer.body)
        };
        // A request that does it all did it once more.
        if self.requests.len() == 1 {
            tick_here(&mut world);
        }
        let here = Columns::of(&world);
        let position = ids().map(|id| here.position[usize::try_from(id).expect("small")]).collect();
        let here = Columns { time: here.time, id: ids().collect(), position, velocity: Vec::new() };
        let is_right = told.is_some_and(|told| told.bits() == here.bits());
        bench.check(is_right, || format!("{}: the positions after {} ticks are wrong", self.name, self.ticks));
        let is_right = scene::has_future_of(&mut self.client, self.name, &world);
        bench.check(is_right, || format!("{}: the world after {} ticks is another one", self.name, self.ticks));
    }
}

fn run(bench: &mut Bench) {
    let socket = std::env::temp_dir().join(format!("pointmass-wire-{}.sock", std::process::id()));
    let unix = format!("unix:{}", socket.display());
    let server = Server::listening_on(&["127.0.0.1:0", &unix], &[]);
    let workers = (std::thread::available_parallelism().map_or(1, usize::from) / 2).max(1).to_string();
    let echo = Server::echo(&workers);
    let scene = Scene::<f64>::new(PARTICLES, Integrator::Exact);
    let (tcp, unix) = (server.address(), server.second_address());
    let mut json_tcp = Game::new("json-tcp", tcp, &scene, vec![in_json("json-tcp")], false);
    let mut cbor_tcp = Game::new("cbor-tcp", tcp, &scene, vec![in_cbor("cbor-tcp")], true);
    let mut json_unix = Game::new("json-unix", unix, &scene, vec![in_json("json-unix")], false);
    let mut cbor_unix = Game::new("cbor-unix", unix, &scene, vec![in_cbor("cbor-unix")], true);
    let mut three = Game::new("three", tcp, &scene, in_three("three"), false);
    let mut many = Game::new("many", tcp, &scene, by_force("many"), false);

    let mut echoing = echo.client();
    let body = r#"{"duration":0.016}"#;
    let asked = request("POST", "/echo", body);
    let answer = echoing.expect(&asked, 200).text().into_owned();
    bench.check(answer == body, || format!("the echo answers {answer}"));
    let ticks = bench.size(100, 2);
    let echoes = Box::new(|| {
        median((0..2 * ticks).map(|_| {
            let start = Instant::now();
            echoing.expect(&asked, 200);
            start.elapsed().as_secs_f64()
        }))
    });
    let [echoed, in_json, in_cbor, local_json, local_cbor, in_three, by_force] = rounds(
        bench.size(31, 1),
        [
            echoes,
            json_tcp.contender(ticks),
            cbor_tcp.contender(ticks),
            json_unix.contender(ticks),
            cbor_unix.contender(ticks),
            three.contender(ticks),
            many.contender(bench.size(5, 1)),
        ],
    );
    echoed.record(bench, "bare echo over TCP", Unit::Seconds);
    for (told, times) in [("JSON over TCP", &in_json), ("CBOR over TCP", &in_cbor)] {
        times.record(bench, told, Unit::Seconds);
        times.over(&echoed).record(bench, format!("{told} / bare echo"), Unit::Ratio).at_most(2.5);
    }
    for (told, times) in [("JSON over a Unix socket", &local_json), ("CBOR over a Unix socket", &local_cbor)] {
        times.record(bench, told, Unit::Seconds);
        times.over(&echoed).record(bench, format!("{told} / bare echo"), Unit::Ratio);
    }
    for (told, times) in [("three requests, JSON over TCP", &in_three), ("102 requests, JSON over TCP", &by_force)] {
        times.record(bench, told, Unit::Seconds);
        times.over(&in_json).record(bench, format!("{told} / one request"), Unit::Ratio);
    }

    for (told, game) in [("JSON over TCP", &mut json_tcp), ("CBOR over a Unix socket", &mut cbor_unix)] {
        let times = game.paced(bench.size(8 * 128, 13));
        bench.record(format!("at 128 Hz, {told}, median"), times.within(0.5), Unit::Seconds);
        bench.record(format!("at 128 Hz, {told}, p99"), times.within(0.99), Unit::Seconds);
        let share = times.within(0.99) * RATE;
        bench.record(format!("at 128 Hz, {told}, p99 as a share of the tick"), share, Unit::Percent).at_most(0.2);
    }
    for game in [json_tcp, cbor_tcp, json_unix, cbor_unix, three, many] {
        game.check(bench, &scene);
    }
}

/// Every tenth.
fn ids() -> impl Iterator<Item = u64> {
    (0..FORCES as u64).map(|i| i * (PARTICLES / FORCES) as u64)
}

fn forces() -> Vec<[f64; 3]> {
    ids().map(|id| [0.1, 0.2, 0.001 * id as f64]).collect()
}

fn tick_here(world: &mut World<f64>) {
    let force = Column::PerParticle(forces().into_iter().map(DVec3::from).collect());
    let ids = Selection::Ids(ids().map(ParticleId).collect());
    world.apply(&Command::AddForce { ids, force }).expect("they are there");
    world.advance(Advance::by(1.0 / RATE)).expect("the service accepted it");
}

fn in_json(name: &str) -> Vec<u8> {
    let (ids, forces, duration) = (ids_in_json(), forces_in_json(), 1.0 / RATE);
    let add = format!(r#"{{"add_force":{{"ids":[{ids}],"force":{forces}}}}}"#);
    let rest = format!(r#"{{"advance":{{"duration":{duration}}}}},{{"read":{{"fields":["position"],"ids":[{ids}]}}}}"#);
    request("POST", &format!("/v1/worlds/{name}/commands"), &format!(r#"{{"commands":[{add},{rest}]}}"#))
}

fn in_cbor(name: &str) -> Vec<u8> {
    let ids = cbor::ids(&ids().collect::<Vec<_>>());
    let add = cbor::map([("ids", ids.clone()), ("force", cbor::vectors(&forces()))]);
    let advance = cbor::map([("duration", cbor::float(1.0 / RATE))]);
    let read = cbor::map([("fields", cbor::list(&[cbor::text("position")])), ("ids", ids)]);
    let commands = [("add_force", add), ("advance", advance), ("read", read)].map(|command| cbor::map([command]));
    let body = cbor::map([("commands", cbor::list(&commands))]);
    request_with("POST", &format!("/v1/worlds/{name}/commands"), &CBOR, &body)
}

fn in_three(name: &str) -> Vec<Vec<u8>> {
    let body = format!(r#"{{"ids":[{}],"force":{}}}"#, ids_in_json(), forces_in_json());
    vec![request("POST", &format!("/v1/worlds/{name}/forces"), &body), advance(name), read(name)]
}

fn by_force(name: &str) -> Vec<Vec<u8>> {
    let force = |(id, force): (u64, [f64; 3])| {
        request("POST", &format!("/v1/worlds/{name}/particles/{id}/force"), &format!(r#"{{"force":{}}}"#, json(&force)))
    };
    ids().zip(forces()).map(force).chain([advance(name), read(name)]).collect()
}

fn advance(name: &str) -> Vec<u8> {
    scene::advance(name, Advance::by(1.0 / RATE))
}

fn read(name: &str) -> Vec<u8> {
    request("GET", &format!("/v1/worlds/{name}/particles?fields=position&ids={}", ids_in_json()), "")
}

fn ids_in_json() -> String {
    ids().map(|id| id.to_string()).collect::<Vec<_>>().join(",")
}

fn forces_in_json() -> String {
    format!("[{}]", forces().iter().map(json).collect::<Vec<_>>().join(","))
}

fn median(times: impl Iterator<Item = f64>) -> f64 {
    let mut times: Vec<f64> = times.collect();
    times.sort_by(f64::total_cmp);
    Latencies(times).within(0.5)
}
