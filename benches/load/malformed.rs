//! Requests that are none.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Mutex;
use std::time::Duration;

use crate::Case;
use crate::client::{Address, request};
use crate::fairness::Light;
use crate::report::{Bench, Unit};
use crate::server::Server;

pub(crate) const MALFORMED: Case = Case {
    name: "malformed",
    title: "Malformed requests by the thousand",
    note: "Random bytes, requests cut short, requests with changed bytes, and good requests with bad JSON, each on a \
           connection of its own, from four clients at once, while the light worlds go on. No answer may be a 500.",
    run,
};

/// Numbers that look random (`SplitMix64`), the same in every run.
struct Random(u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        usize::try_from(self.bits() % n as u64).expect("below a usize")
    }

    fn byte(&mut self) -> u8 {
        self.bits().to_le_bytes()[0]
    }
}

fn run(bench: &mut Bench) {
    let mut server = Server::start(&["--header-timeout-ms", "2000", "--body-timeout-ms", "2000"]);
    let mut client = server.client();
    let mut light = Light::create(&server);
    client.expect(&request("PUT", "/v1/worlds/victim", r#"{"integrator":"newton_euler"}"#), 201);
    client.expect(&request("POST", "/v1/worlds/victim/particles", r#"{"count":10}"#), 201);
    let alone = light.run(bench, &server, "before malformed requests", bench.size(4.0, 0.2));

    let count = bench.size(8000, 200);
    let answers = Mutex::new([0_usize; 6]);
    let p99 = std::thread::scope(|scope| {
        for seed in 0..4 {
            let (answers, address) = (&answers, server.address());
            scope.spawn(move || {
                let mut random = Random(seed);
                for _ in 0..count / 4 {
                    let status = send(address, &malformed(&mut random));
                    // The first digit; 0 where the connection was closed without an answer.
                    answers.lock().expect("nobody panics")[usize::from(status / 100).min(5)] += 1;
                }
            });
        }
        light.run(bench, &server, "beside malformed requests", bench.size(6.0, 0.3))
    });
    let [closed, _, taken, _, refused, defects] = answers.into_inner().expect("nobody panicked");
    bench.record("malformed requests", (closed + taken + refused + defects) as f64, Unit::Count);
    bench.record("refused with 4xx", refused as f64, Unit::Count);
    bench.record("still a good request: 2xx", taken as f64, Unit::Count);
    bench.record("closed without an answer", closed as f64, Unit::Count);
    bench.record("5xx", defects as f64, Unit::Count).at_most(0.0);
    bench.record("p99 beside malformed requests / before", p99 / alone, Unit::Ratio).at_most(3.0);
    bench.check(defects == 0, || format!("{defects} answers were 5xx"));
    bench.check(refused > count / 2, || format!("only {refused} of {count} were refused"));
    bench.check(server.is_well(), || "the service does not answer any more".to_owned());
    light.check(bench, &server);
}

fn malformed(random: &mut Random) -> Vec<u8> {
    const BAD: [&str; 8] = [
        r#"{"duration":}"#,
        r#"{"duration":1e999}"#,
        r#"{"duration":-1}"#,
        r#"{"duration":0.1,"duration":0.1}"#,
        r#"[{"duration":0.1}]"#,
        r#"{"duration":"0.1"}"#,
        r#"{"duration":0.1,"steps":18446744073709551616}"#,
        "{\"duration\":0.1}\u{0}",
    ];
    let bodies = [r#"{"duration":0.016}"#, r#"{"ids":[0],"force":[1,2,3]}"#, r#"{"count":1,"position":[[1,2,3]]}"#];
    let paths = ["advance", "forces", "particles"];
    let which = random.below(3);
    let good = request("POST", &format!("/v1/worlds/victim/{}", paths[which]), bodies[which]);
    match random.below(4) {
        0 => (0..=random.below(2000)).map(|_| random.byte()).collect(),
        1 => good[..random.below(good.len())].to_vec(),
        2 => {
            let mut bytes = good;
            for _ in 0..=random.below(8) {
                let at = random.below(bytes.len());
                bytes[at] = random.byte();
            }
            bytes
        }
        _ => request("POST", "/v1/worlds/victim/advance", BAD[random.below(BAD.len())]),
    }
}

/// The status of the first answer, 0 without one.
fn send(address: &Address, bytes: &[u8]) -> u16 {
    let Address::Tcp(address) = address else { panic!("a TCP listener") };
    let mut stream = TcpStream::connect(address).expect("the service listens");
    stream.set_read_timeout(Some(Duration::from_secs(10))).expect("a socket");
    // The service may close it in the middle.
    let _sent = stream.write_all(bytes).and_then(|()| stream.shutdown(Shutdown::Write));
    let mut answer = Vec::new();
    let _closed = stream.read_to_end(&mut answer);
    let status = answer.get(9..12).and_then(|status| std::str::from_utf8(status).ok()?.parse().ok());
    status.unwrap_or(0)
}
