//! Worlds that are advanced again and again, and how it is known afterwards that every accepted advance was applied once.

use pointmass::{Advance, Command, DVec3, Integrator, NewParticles, Particle, Settings, World};

use crate::client::request;
use crate::load::{Latencies, Outcome, Samples};
use crate::report::{Bench, Unit};
use crate::server::Server;

/// A tick of a game, in seconds.
pub(crate) const TICK: f64 = 1.0 / 60.0;

/// The most worlds, up to a limit, that hold: p99 within a tick and none refused. By bisection, to within `apart`; `run` says
/// how long their ticks took, and whether all went well.
pub(crate) fn most_that_hold(
    bench: &mut Bench,
    limit: usize,
    apart: usize,
    mut run: impl FnMut(usize) -> (Latencies, bool),
) {
    let (mut most, mut least, mut held) = (0, limit + 1, Latencies::default());
    while least - most > apart {
        let worlds = usize::midpoint(most, least);
        let (latencies, is_well) = run(worlds);
        if is_well && latencies.within(0.99) <= TICK {
            (most, held) = (worlds, latencies);
        } else {
            least = worlds;
        }
    }
    bench.record("worlds that hold", most as f64, Unit::Count).at_least(1000.0);
    bench.record("worlds that hold: advances", most as f64 / TICK, Unit::PerSecond);
    bench.record_latencies("worlds that hold", &held);
}

/// Equal worlds, and the same advance for each.
#[derive(Debug)]
pub(crate) struct Worlds {
    names: Vec<String>,
    /// The request that advances each.
    pub(crate) advances: Vec<Vec<u8>>,
    /// The same world, stepped here.
    twin: World<f64>,
    advance: Advance,
}

impl Worlds {
    /// Each of so many particles, which `newton_euler` has to move at every step.
    pub(crate) fn create(server: &Server, name: &str, count: usize, particles: usize, advance: Advance) -> Self {
        let mut client = server.client();
        let gravity = DVec3::new(0.0, -10.0, 0.0);
        let settings = Settings { integrator: Integrator::NewtonEuler, gravity, ..Settings::default() };
        let mut twin = World::new(settings).expect("valid settings");
        let particle = Particle { velocity: DVec3::new(3.0, 20.0, 0.1), damping: 0.99, ..Particle::default() };
        if particles > 0 {
            let all = NewParticles { count: particles, ..particle.into() };
            twin.apply(&Command::Create(all)).expect("valid particles");
        }
        let names: Vec<String> = (0..count).map(|i| format!("{name}{i}")).collect();
        for name in &names {
            let settings = r#"{"integrator":"newton_euler","gravity":[0,-10,0]}"#;
            client.expect(&request("PUT", &format!("/v1/worlds/{name}"), settings), 201);
            if particles > 0 {
                let columns = format!(r#"{{"count":{particles},"velocity":[3,20,0.1],"damping":0.99}}"#);
                client.expect(&request("POST", &format!("/v1/worlds/{name}/particles"), &columns), 201);
            }
        }
        let steps = advance.steps.map_or_else(String::new, |steps| format!(r#","steps":{steps}"#));
        let body = format!(r#"{{"duration":{}{steps}}}"#, advance.duration);
        let advances = names.iter().map(|name| request("POST", &format!("/v1/worlds/{name}/advance"), &body)).collect();
        Self { names, advances, twin, advance }
    }

    /// Each world went through as many revisions as advances were accepted, each of which was told one of them; and its
    /// state is, to the bit, that of a world that is advanced so often here.
    pub(crate) fn check(&self, bench: &mut Bench, server: &Server, samples: &[&Samples]) {
        let mut client = server.client();
        let first = self.twin.revision();
        let mut worlds: Vec<(usize, &String)> =
            self.check_answers(bench, samples).into_iter().zip(&self.names).collect();
        worlds.sort_unstable();
        let (mut twin, mut advanced) = (self.twin.clone(), 0);
        for (accepted, name) in worlds {
            for _ in advanced..accepted {
                twin.advance(self.advance).expect("the service accepted it");
            }
            advanced = accepted;
            let told = client.expect(&request("GET", &format!("/v1/worlds/{name}/digest"), ""), 200).json();
            let is_right = told["revision"] == first + accepted as u64
                && told["step_count"] == twin.step_count()
                && told["digest"] == twin.digest().to_string();
            bench.check(is_right, || format!("{name} is {told} after {accepted} accepted advances"));
        }
    }

    /// How many advances of each world were accepted. Their revisions follow each other without a gap.
    pub(crate) fn check_answers(&self, bench: &mut Bench, samples: &[&Samples]) -> Vec<usize> {
        let mut revisions = vec![Vec::new(); self.names.len()];
        for sample in samples.iter().flat_map(|samples| &samples.0) {
            if let Outcome::Accepted(revision) = sample.outcome {
                revisions[sample.request].push(revision);
            }
        }
        for (revisions, name) in revisions.iter_mut().zip(&self.names) {
            revisions.sort_unstable();
            let expected = (self.twin.revision() + 1..).map(Some);
            let is_dense = revisions.iter().copied().zip(expected).all(|(told, expected)| told == expected);
            bench.check(is_dense, || {
                format!("{name} told {} revisions that are not one after the other", revisions.len())
            });
        }
        revisions.iter().map(Vec::len).collect()
    }
}

/// Nothing but acceptances.
pub(crate) fn check_all_accepted(bench: &mut Bench, samples: &Samples) {
    let other = samples.0.iter().find(|sample| !matches!(sample.outcome, Outcome::Accepted(_)));
    bench.check(!samples.0.is_empty() && other.is_none(), || format!("a light load was answered with {other:?}"));
}
