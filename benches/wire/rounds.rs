//! Contenders in turn, and what their times say.

use std::hint::black_box;
use std::time::Instant;

use crate::client::Client;
use crate::load::Latencies;
use crate::report::{Bench, Figure, Unit};

/// Something that tells how many seconds it took.
pub(crate) type Contender<'a> = Box<dyn FnMut() -> f64 + 'a>;

/// One figure of each round.
#[derive(Debug)]
pub(crate) struct Times(Vec<f64>);

/// Runs each contender once in every round, another one first each time.
pub(crate) fn rounds<const N: usize>(count: usize, mut contenders: [Contender<'_>; N]) -> [Times; N] {
    let mut times = [(); N].map(|()| Times(Vec::with_capacity(count)));
    for round in 0..count {
        for i in (0..N).map(|i| (round + i) % N) {
            times[i].0.push(contenders[i]());
        }
    }
    times
}

/// How long an answer of so many bytes takes.
pub(crate) fn fetch<'a>(client: &'a mut Client, request: &'a [u8], bytes: usize) -> Contender<'a> {
    Box::new(move || {
        let start = Instant::now();
        let fetched = client.fetch(request).unwrap_or_else(|error| panic!("no answer: {error}"));
        let time = start.elapsed().as_secs_f64();
        assert_eq!(fetched, bytes, "as long as the answer that was checked");
        time
    })
}

/// How long a change takes; its answer is as long as its revision.
pub(crate) fn change<'a>(client: &'a mut Client, request: &'a [u8]) -> Contender<'a> {
    Box::new(move || {
        let start = Instant::now();
        let fetched = client.fetch(request).unwrap_or_else(|error| panic!("no answer: {error}"));
        assert!(fetched > 0, "it is described");
        start.elapsed().as_secs_f64()
    })
}

/// How long it takes to copy so many bytes in memory.
pub(crate) fn memcpy(bytes: usize) -> Contender<'static> {
    let (from, mut to) = (vec![1_u8; bytes], vec![0_u8; bytes]);
    Box::new(move || {
        let start = Instant::now();
        to.copy_from_slice(black_box(&from));
        black_box(&mut to);
        start.elapsed().as_secs_f64()
    })
}

impl Times {
    /// The same by the particle, or by whatever there are so many of.
    pub(crate) fn each(&self, count: usize) -> Self {
        Self(self.0.iter().map(|time| time / count as f64).collect())
    }

    /// Round by round.
    pub(crate) fn over(&self, other: &Self) -> Self {
        Self(self.0.iter().zip(&other.0).map(|(a, b)| a / b).collect())
    }

    pub(crate) fn median(&self) -> f64 {
        self.quantile(0.5)
    }

    fn quantile(&self, share: f64) -> f64 {
        let mut times = self.0.clone();
        times.sort_by(f64::total_cmp);
        Latencies(times).within(share)
    }

    pub(crate) fn record<'a>(&self, bench: &'a mut Bench, what: impl Into<String>, unit: Unit) -> &'a mut Figure {
        bench.record(what, self.median(), unit).between([self.quantile(0.25), self.quantile(0.75)])
    }
}
