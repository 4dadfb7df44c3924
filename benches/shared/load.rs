//! Requests by the clock, whether the service keeps up or not.
//!
//! A load is a schedule of requests and a number of connections that take them in turn. A latency counts from the moment
//! when the schedule has the request, not from when a connection was free to send it: a service that stands still for a
//! second is late for every request of that second, not for one.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::client::{Address, Client};

/// A request that is so late is not sent any more: its client has given up.
const PATIENCE: f64 = 1.0;

#[derive(Debug, Clone)]
pub(crate) struct Load<'a> {
    pub(crate) address: &'a Address,
    pub(crate) connections: usize,
    /// Requests a second; absent: each connection asks again when it is answered.
    pub(crate) rate: Option<f64>,
    pub(crate) start: Instant,
    pub(crate) seconds: f64,
    /// Sent in turn, again and again.
    pub(crate) requests: &'a [Vec<u8>],
}

/// What became of one request.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    /// Which one of the requests of the load.
    pub(crate) request: usize,
    /// Seconds since the start of the load.
    pub(crate) intended: f64,
    pub(crate) sent: f64,
    /// Seconds since it was intended.
    pub(crate) latency: f64,
    pub(crate) outcome: Outcome,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// 200, with the revision of the world after it.
    Accepted(Option<u64>),
    /// 503 with a Retry-After.
    Refused,
    /// Anything else.
    Answered(u16),
    /// No answer: nobody listens, or the connection was closed.
    Closed,
    /// All connections were waiting for too long.
    Unsent,
}

impl Load<'_> {
    pub(crate) fn run(&self) -> Samples {
        let tickets = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            let threads: Vec<_> =
                (0..self.connections).map(|_| scope.spawn(|| self.one_connection(&tickets))).collect();
            Samples(threads.into_iter().flat_map(|thread| thread.join().expect("it does not panic")).collect())
        })
    }

    fn one_connection(&self, tickets: &AtomicUsize) -> Vec<Sample> {
        let mut client = Client::new(self.address);
        let mut samples = Vec::new();
        let now = || Instant::now().duration_since(self.start).as_secs_f64();
        sleep_until(self.start);
        loop {
            let ticket = tickets.fetch_add(1, Ordering::Relaxed);
            let intended = self.rate.map_or_else(now, |rate| ticket as f64 / rate);
            if intended >= self.seconds {
                return samples;
            }
            sleep_until(self.start + Duration::from_secs_f64(intended));
            let request = ticket % self.requests.len();
            let sent = now();
            let outcome = if sent - intended > PATIENCE {
                Outcome::Unsent
            } else {
                Outcome::of(&mut client, &self.requests[request])
            };
            samples.push(Sample { request, intended, sent, latency: now() - intended, outcome });
        }
    }
}

impl Outcome {
    pub(crate) fn of(client: &mut Client, request: &[u8]) -> Self {
        match client.ask(request) {
            Ok(answer) => match answer.status {
                200 => Self::Accepted(answer.revision()),
                503 if answer.header("retry-after").is_some() => Self::Refused,
                status => Self::Answered(status),
            },
            Err(_) => Self::Closed,
        }
    }
}

pub(crate) fn sleep_until(moment: Instant) {
    std::thread::sleep(moment.saturating_duration_since(Instant::now()));
}

#[derive(Debug, Default)]
pub(crate) struct Samples(pub(crate) Vec<Sample>);

impl Samples {
    pub(crate) fn count(&self, is: impl Fn(Outcome) -> bool) -> usize {
        self.0.iter().filter(|sample| is(sample.outcome)).count()
    }

    pub(crate) fn accepted(&self) -> usize {
        self.count(|outcome| matches!(outcome, Outcome::Accepted(_)))
    }

    /// Neither accepted nor refused as the contract says.
    pub(crate) fn faults(&self) -> usize {
        self.count(|outcome| matches!(outcome, Outcome::Answered(_) | Outcome::Closed))
    }

    /// Accepted requests of a second, from the first request until the last answer.
    pub(crate) fn throughput(&self) -> f64 {
        self.accepted() as f64 / self.0.iter().map(|sample| sample.intended + sample.latency).fold(0.0, f64::max)
    }

    /// Of what was accepted, ascending.
    pub(crate) fn latencies(&self) -> Latencies {
        self.latencies_of(|outcome| matches!(outcome, Outcome::Accepted(_)))
    }

    pub(crate) fn latencies_of(&self, is: impl Fn(Outcome) -> bool) -> Latencies {
        let of_interest = self.0.iter().filter(|sample| is(sample.outcome));
        let mut latencies: Vec<f64> = of_interest.map(|sample| sample.latency).collect();
        latencies.sort_by(f64::total_cmp);
        Latencies(latencies)
    }
}

/// In seconds, ascending.
#[derive(Debug, Default)]
pub(crate) struct Latencies(pub(crate) Vec<f64>);

impl Latencies {
    /// The latency that this share of requests stays within.
    pub(crate) fn within(&self, share: f64) -> f64 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index of the list")]
        let at = (share * self.0.len() as f64).ceil() as usize;
        self.0.get(at.saturating_sub(1)).copied().unwrap_or(f64::NAN)
    }
}
