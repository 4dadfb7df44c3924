//! A million particles out: as fast as the wire, and in how much memory.

use pointmass::{Advance, Integrator};

use crate::Case;
use crate::client::request_with;
use crate::raw;
use crate::report::{Bench, Unit};
use crate::rounds::{fetch, rounds};
use crate::scene::{Columns, Scene};
use crate::server::Server;

pub(crate) const LARGE: Case = Case {
    name: "large",
    title: "1,000,000 particles out",
    note: "Ids, positions and velocities in CBOR beside a raw socket with as many bytes. Memory is the most that the service \
           had while it sent them, above what it had before.",
    run,
};

fn run(bench: &mut Bench) {
    let (server, raw) = (Server::start(&[]), raw::start());
    let scene = Scene::<f64>::new(bench.size(1_000_000, 20_000), Integrator::NewtonEuler);
    let mut client = server.client();
    let by = Advance::by(0.1);
    let world = scene.advanced(&mut client, "large", by);

    let path = "/v1/worlds/large/state?fields=position,velocity";
    let state = request_with("GET", path, &["accept: application/cbor"], b"");
    let answer = client.expect(&state, 200).body;
    let told = Columns::<f64>::from_cbor(answer);
    let bytes = answer.len();
    bench.check(told.is_some_and(|told| told.bits() == Columns::of(&world).bits()), || {
        "a million particles are not what the library says".to_owned()
    });

    let before = server.resident();
    let can_forget = server.forget_peak();
    let mut other = raw.client();
    let send = raw::send(bytes);
    other.expect(&send, 200);
    let contenders = [fetch(&mut client, &state, bytes), fetch(&mut other, &send, bytes)];
    let [service, sent] = rounds(bench.size(15, 1), contenders);
    service.record(bench, "service", Unit::Seconds);
    sent.record(bench, "raw socket", Unit::Seconds);
    sent.over(&service).record(bench, "speed of the raw socket that is reached", Unit::Percent).at_least(0.85);
    bench.record("size of the answer", bytes as f64, Unit::Bytes);
    bench.record("resident before", before, Unit::Bytes);
    let growth = if can_forget { server.peak() - before } else { f64::NAN };
    bench.record("resident at most, above that", growth, Unit::Bytes).at_most(f64::from(4 << 20));
}
