//! State in: what a new particle costs in each encoding.

use std::time::Instant;

use pointmass::Integrator;

use crate::Case;
use crate::client::{request, request_with};
use crate::raw;
use crate::report::{Bench, Unit};
use crate::rounds::{Contender, fetch, rounds};
use crate::scene::{CBOR, Scene, has_future_of};
use crate::server::Server;

pub(crate) const CREATE: Case = Case {
    name: "create",
    title: "Particles in",
    note: "All particles of a new world in one request, with positions and velocities; from its first byte to the answer. The \
           raw socket takes the same bytes, and does not look at them.",
    run,
};

const WAYS: [&str; 4] = ["JSON rows", "JSON columns", "CBOR lists", "CBOR typed arrays"];

fn run(bench: &mut Bench) {
    let (server, raw) = (Server::start(&[]), raw::start());
    for (told, count, turns) in [
        ("10,000", bench.size(10_000, 500), bench.size(31, 1)),
        ("100,000", bench.size(100_000, 2000), bench.size(11, 1)),
    ] {
        some(bench, [&server, &raw], told, count, turns);
    }
}

fn some(bench: &mut Bench, [server, raw]: [&Server; 2], told: &str, count: usize, turns: usize) {
    let scene = Scene::<f64>::new(count, Integrator::NewtonEuler);
    let json = ["content-type: application/json"];
    let (rows, columns) = (scene.rows(), scene.columns());
    let bodies: [(&[&str], Vec<u8>); 4] =
        [(&json, rows.into_bytes()), (&json, columns.into_bytes()), (&CBOR, scene.plain()), (&CBOR, scene.typed())];
    let (put, delete) = (scene.put("new"), request("DELETE", "/v1/worlds/new", ""));
    let posts =
        bodies.each_ref().map(|(headers, body)| request_with("POST", "/v1/worlds/new/particles", headers, body));
    let takes = bodies.each_ref().map(|(_, body)| raw::take(body));

    let world = scene.world();
    let mut client = server.client();
    for (post, way) in posts.iter().zip(WAYS) {
        client.expect(&put, 201);
        client.expect(post, 201);
        let is_right = has_future_of(&mut client, "new", &world);
        bench.check(is_right, || format!("{told} particles by {way} are not those of the library"));
        client.expect(&delete, 204);
    }

    let mut clients = WAYS.map(|_| server.client());
    let mut raws = WAYS.map(|_| raw.client());
    raws.iter_mut().zip(&takes).for_each(|(client, take)| _ = client.expect(take, 200));
    let (put, delete) = (&put, &delete);
    let mut creations = clients.iter_mut().zip(&posts).map(|(client, post)| {
        Box::new(move || {
            client.expect(put, 201);
            let start = Instant::now();
            client.expect(post, 201);
            let time = start.elapsed().as_secs_f64();
            client.expect(delete, 204);
            time
        }) as Contender<'_>
    });
    let mut sendings = raws.iter_mut().zip(&takes).map(|(client, take)| fetch(client, take, 0));
    let times = rounds(
        turns,
        [(); 2 * WAYS.len()].map(|()| creations.next().or_else(|| sendings.next()).expect("as many of each")),
    );
    let (services, sent) = times.split_at(WAYS.len());
    for (i, way) in WAYS.into_iter().enumerate() {
        let told = format!("{told}: {way}");
        bench.record(format!("{told}, size of a particle"), bodies[i].1.len() as f64 / count as f64, Unit::Bytes);
        services[i].each(count).record(bench, format!("{told}, a particle"), Unit::Seconds);
        services[i].over(&sent[i]).record(bench, format!("{told} / raw socket"), Unit::Ratio);
    }
    let ratio = services[0].over(&services[3]);
    ratio.record(bench, format!("{told}: JSON rows / CBOR typed arrays"), Unit::Ratio).at_least(20.0);
}
