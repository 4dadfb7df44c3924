//! Worlds as bytes, and back.

use pointmass::{Advance, Integrator, World};

use crate::Case;
use crate::client::{request, request_with};
use crate::raw;
use crate::report::{Bench, Unit};
use crate::rounds::{change, fetch, memcpy, rounds};
use crate::scene::{self, Scene, has_future_of};
use crate::server::Server;

pub(crate) const SNAPSHOT: Case = Case {
    name: "snapshot",
    title: "Snapshots of 1,000,000 particles",
    note: "`newton_euler`, with positions and velocities of their own and everything else the same for all. A world is read as \
           bytes, and replaced by them, with their checksum; beside a raw socket that sends or takes as many bytes, and a \
           copy of them in memory.",
    run,
};

fn run(bench: &mut Bench) {
    let (server, raw) = (Server::start(&[]), raw::start());
    let scene = Scene::<f64>::new(bench.size(1_000_000, 2000), Integrator::NewtonEuler);
    let mut client = server.client();
    let by = Advance::by(0.1);
    let world = scene.advanced(&mut client, "large", by);

    let get = request("GET", "/v1/worlds/large/snapshot", "");
    let bytes = client.expect(&get, 200).body.to_vec();
    let restored = World::<f64>::restore(&bytes[..], pointmass::Limits::default());
    let is_right = restored.is_ok_and(|restored| restored.digest() == world.digest());
    bench.check(is_right, || "a snapshot is not the world of the library".to_owned());
    // Goes on, and back.
    client.expect(&scene::advance("large", by), 200);
    let put = request_with("PUT", "/v1/worlds/large/snapshot", &["content-type: application/octet-stream"], &bytes);
    let mut other = server.client();
    other.expect(&put, 200);
    let is_right = has_future_of(&mut client, "large", &world);
    bench.check(is_right, || "a world restored is not that of the library".to_owned());
    client.expect(&get, 200);

    let (send, take) = (raw::send(bytes.len()), raw::take(&bytes));
    let (mut sender, mut taker) = (raw.client(), raw.client());
    sender.expect(&send, 200);
    taker.expect(&take, 200);
    let [read, sent, replaced, taken, copied] = rounds(
        bench.size(9, 1),
        [
            fetch(&mut client, &get, bytes.len()),
            fetch(&mut sender, &send, bytes.len()),
            change(&mut other, &put),
            fetch(&mut taker, &take, 0),
            memcpy(bytes.len()),
        ],
    );
    let count = scene.count();
    bench.record("size of a particle", bytes.len() as f64 / count as f64, Unit::Bytes);
    for (told, service, raw) in [("GET", &read, &sent), ("PUT", &replaced, &taken)] {
        service.record(bench, told, Unit::Seconds);
        service.each(count).record(bench, format!("{told}, a particle"), Unit::Seconds);
        raw.record(bench, format!("{told}, raw socket"), Unit::Seconds);
        service.over(raw).record(bench, format!("{told} / raw socket"), Unit::Ratio);
        service.over(&copied).record(bench, format!("{told} / a copy in memory"), Unit::Ratio);
    }
    copied.record(bench, "a copy in memory", Unit::Seconds);
    let is_right = has_future_of(&mut other, "large", &world);
    bench.check(is_right, || "a world replaced again and again is not that of the library".to_owned());
}
