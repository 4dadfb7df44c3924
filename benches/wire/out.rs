//! State out: what a particle costs in each encoding.

use std::io::Read;

use pointmass::{Advance, Integrator};

use crate::Case;
use crate::cbor::Number;
use crate::client::request_with;
use crate::raw;
use crate::report::{Bench, Unit};
use crate::rounds::{fetch, memcpy, rounds};
use crate::scene::{Columns, Scene};
use crate::server::Server;

pub(crate) const OUT: Case = Case {
    name: "out",
    title: "100,000 particles out",
    note: "One connection over TCP reads ids, positions and velocities of all particles, from the request to the last byte. \
           `newton_euler` was stepped; `exact` has been advanced with a damping of each particle's own, so that every read \
           works out where they are. Beside it a raw socket with as many bytes, and a copy of the columns in memory.",
    run,
};

/// How to ask: name, path and header.
const WAYS: [[&str; 3]; 5] = [
    ["JSON rows", "particles?fields=position,velocity&limit=100000", "accept: application/json"],
    ["JSON columns", STATE, "accept: application/json"],
    ["JSON columns, gzip", STATE, "accept-encoding: gzip"],
    ["JSON columns, zstd", STATE, "accept-encoding: zstd"],
    ["CBOR columns", STATE, "accept: application/cbor"],
];

const STATE: &str = "state?fields=position,velocity";

fn run(bench: &mut Bench) {
    let (server, raw) = (Server::start(&[]), raw::start());
    let count = bench.size(100_000, 1500);
    let stepped = Advance { steps: Some(10), ..Advance::by(0.1) };
    let far = Advance::by(10.0);
    one(bench, [&server, &raw], "newton_euler", &Scene::<f64>::new(count, Integrator::NewtonEuler), stepped);
    let exact = Scene::<f64>::new(count, Integrator::Exact).with_own_damping();
    one(bench, [&server, &raw], "exact", &exact, far);
    one(bench, [&server, &raw], "single", &Scene::<f32>::new(count, Integrator::NewtonEuler), stepped);
}

fn one<R: Number>(bench: &mut Bench, [server, raw]: [&Server; 2], name: &str, scene: &Scene<R>, by: Advance) {
    let mut client = server.client();
    let world = scene.advanced(&mut client, name, by);

    let requests =
        WAYS.map(|[_, path, header]| request_with("GET", &format!("/v1/worlds/{name}/{path}"), &[header], b""));
    // Also to have warm memory on both ends.
    let mut clients = WAYS.map(|_| server.client());
    let mut answers =
        clients.iter_mut().zip(&requests).map(|(client, request)| client.expect(request, 200).body.to_vec());
    let answers = [(); WAYS.len()].map(|()| answers.next().expect("one each"));
    check(bench, name, &answers, &Columns::of(&world));

    let bytes = answers.each_ref().map(Vec::len);
    let sends = bytes.map(raw::send);
    let mut raws = WAYS.map(|_| raw.client());
    raws.iter_mut().zip(&sends).for_each(|(client, send)| _ = client.expect(send, 200));
    let [of_rows, of_columns, of_gzip, of_zstd, of_cbor] = &mut clients;
    let [raw_rows, raw_columns, raw_gzip, raw_zstd, raw_cbor] = &mut raws;
    let ask = |client, i: usize| fetch(client, &requests[i], bytes[i]);
    let send = |client, i: usize| fetch(client, &sends[i], bytes[i]);
    let [rows, columns, gzip, zstd, sent_rows, sent_columns, sent_gzip, sent_zstd] = rounds(
        bench.size(15, 1),
        [
            ask(of_rows, 0),
            ask(of_columns, 1),
            ask(of_gzip, 2),
            ask(of_zstd, 3),
            send(raw_rows, 0),
            send(raw_columns, 1),
            send(raw_gzip, 2),
            send(raw_zstd, 3),
        ],
    );
    let count = scene.count();
    let memory = memcpy(count * size_of::<(u64, [R; 6])>());
    let [cbor, sent_cbor, copied] = rounds(bench.size(101, 1), [ask(of_cbor, 4), send(raw_cbor, 4), memory]);

    let services = [rows, columns, gzip, zstd, cbor];
    let sent = [sent_rows, sent_columns, sent_gzip, sent_zstd, sent_cbor];
    let is_double = size_of::<R>() == size_of::<f64>();
    for (i, [way, ..]) in WAYS.into_iter().enumerate() {
        let told = format!("{name}: {way}");
        bench.record(format!("{told}, size of a particle"), bytes[i] as f64 / count as f64, Unit::Bytes);
        let each = services[i].each(count);
        let figure = each.record(bench, format!("{told}, a particle"), Unit::Seconds);
        if i == 1 && is_double {
            figure.at_most(260e-9);
        }
        let figure = services[i].over(&sent[i]).record(bench, format!("{told} / raw socket"), Unit::Ratio);
        if i == 4 && is_double {
            figure.at_most(1.5);
        }
    }
    sent[4].each(count).record(bench, format!("{name}: raw socket with the bytes of CBOR, a particle"), Unit::Seconds);
    let copies = services[4].over(&copied);
    copies.record(bench, format!("{name}: CBOR columns / a copy of the columns"), Unit::Ratio);
    copied.each(count).record(bench, format!("{name}: a copy of the columns, a particle"), Unit::Seconds);
}

/// Each answer says what the library does.
fn check<R: Number>(bench: &mut Bench, name: &str, answers: &[Vec<u8>; 5], here: &Columns<R>) {
    let [rows, columns, gzip, zstd, cbor] = answers;
    let mut unpacked = Vec::new();
    let gzip = flate2::read::GzDecoder::new(&gzip[..]).read_to_end(&mut unpacked).ok().map(|_| unpacked);
    let zstd = zstd::stream::decode_all(&zstd[..]).ok();
    let json = |text: Option<Vec<u8>>| Columns::<R>::from_json(&text?);
    let told =
        [Columns::from_rows(rows), Columns::from_json(columns), json(gzip), json(zstd), Columns::from_cbor(cbor)];
    for (told, [way, ..]) in told.into_iter().zip(WAYS) {
        bench.check(told.is_some_and(|told| told.bits() == here.bits()), || {
            format!("{name}: {way} are not what the library says")
        });
    }
}
