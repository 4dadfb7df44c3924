//! Contenders measured side by side.
//!
//! The machine may be shared and its clock may drift, so a time means little beside one that was taken a minute later.
//! One benchmark of criterion is therefore a whole comparison: it calls for rounds, and in each round every contender
//! runs for some milliseconds, one right after the other. Criterion decides how many rounds there are; the contenders
//! time themselves, because criterion would know only their sum. A time is the median of the rounds. A ratio is the
//! median of the ratios within each round: over several runs on a busy machine it varied by half as much as the ratio of
//! the best rounds, which may have met different clocks.

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, SamplingMode};
use pointmass::Precision;

/// A question, and how it is answered.
pub(crate) struct Group {
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    /// What is measured and how, for the reader of the table.
    pub(crate) note: &'static str,
    /// What a size counts.
    pub(crate) size: &'static str,
    pub(crate) columns: &'static [Column],
    pub(crate) run: fn(&mut Bench),
}

/// A column of the table of a group.
pub(crate) struct Column(pub(crate) &'static str, pub(crate) Cell);

/// What is told about contenders.
pub(crate) enum Cell {
    /// Time of one operation.
    Time(&'static str),
    /// Operations in a nanosecond.
    Rate(&'static str),
    /// How many bytes.
    Bytes(&'static str),
    /// The first divided by the second.
    Ratio(&'static str, &'static str),
    /// The first as a share of the second.
    Percent(&'static str, &'static str),
}

/// What contenders compete at.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Case {
    pub(crate) precision: Precision,
    pub(crate) scene: String,
    pub(crate) size: usize,
}

/// One contender of one case.
#[derive(Debug, Clone)]
pub(crate) struct Measured {
    pub(crate) group: &'static str,
    pub(crate) case: Case,
    pub(crate) contender: &'static str,
    /// Nanoseconds of one operation, or bytes, of every round.
    pub(crate) values: Vec<f64>,
}

impl Measured {
    pub(crate) fn median(&self) -> f64 {
        median(self.values.iter().copied())
    }

    pub(crate) fn best(&self) -> f64 {
        self.values.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// How many times as much as another contender of the same case, which ran in the same rounds.
    pub(crate) fn ratio(&self, other: &Self) -> f64 {
        median(self.values.iter().zip(&other.values).map(|(ours, others)| ours / others))
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// One way to do what the others do too.
pub(crate) struct Contender {
    name: &'static str,
    /// Operations of one iteration.
    operations: f64,
    /// Runs so many iterations, and says how long they took.
    run: Box<dyn FnMut(u64) -> Duration>,
}

impl Contender {
    pub(crate) fn new<O>(name: &'static str, operations: usize, mut run: impl FnMut() -> O + 'static) -> Self {
        Self::timing_itself(name, operations, move |iterations| {
            let start = Instant::now();
            for _ in 0..iterations {
                black_box(run());
            }
            start.elapsed()
        })
    }

    /// What `prepare` makes for each iteration, and what `run` returns, is outside of the timing.
    pub(crate) fn prepared<I, O>(
        name: &'static str,
        operations: usize,
        mut prepare: impl FnMut() -> I + 'static,
        mut run: impl FnMut(I) -> O + 'static,
    ) -> Self {
        Self::timing_itself(name, operations, move |iterations| {
            let mut sum = Duration::ZERO;
            for _ in 0..iterations {
                let input = prepare();
                let start = Instant::now();
                let output = run(input);
                sum += start.elapsed();
                black_box(output);
            }
            sum
        })
    }

    pub(crate) fn timing_itself(
        name: &'static str,
        operations: usize,
        run: impl FnMut(u64) -> Duration + 'static,
    ) -> Self {
        Self { name, operations: operations as f64, run: Box::new(run) }
    }
}

/// A contender with how many of its iterations make a round.
struct Entrant {
    contender: Contender,
    iterations: u64,
    values: Vec<f64>,
}

impl Entrant {
    /// Fast contenders repeat, so that neither the timer nor a cold cache decides.
    const ROUND: Duration = Duration::from_millis(4);

    /// The best of several, so that a pause of the machine does not leave a contender with too few iterations.
    fn calibrated(mut contender: Contender) -> Self {
        let mut iterations = 1;
        loop {
            let time = (0..3).map(|_| (contender.run)(iterations)).min().expect("three");
            if time > Self::ROUND / 4 {
                let wanted = iterations as f64 * Self::ROUND.div_duration_f64(time);
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive, below 2⁵³")]
                let iterations = wanted.ceil().max(1.0) as u64;
                return Self { contender, iterations, values: Vec::new() };
            }
            iterations *= 2;
        }
    }

    fn run(&mut self) -> Duration {
        let time = (self.contender.run)(self.iterations);
        self.values.push(time.as_nanos() as f64 / (self.iterations as f64 * self.contender.operations));
        time
    }
}

/// Runs comparisons and collects what they measure.
pub(crate) struct Bench {
    /// Absent when nothing is measured.
    criterion: Option<Criterion>,
    group: &'static str,
    pub(crate) measured: Vec<Measured>,
}

impl Bench {
    pub(crate) fn measuring() -> Self {
        let criterion = Criterion::default()
            .without_plots()
            .sample_size(10)
            .warm_up_time(Duration::from_millis(50))
            .measurement_time(Duration::from_millis(600))
            // Criterion's own statistics are of the sum of all contenders; few resamples are enough.
            .nresamples(1000)
            .configure_from_args();
        Self { criterion: Some(criterion), group: "", measured: Vec::new() }
    }

    pub(crate) fn checking() -> Self {
        Self { criterion: None, group: "", measured: Vec::new() }
    }

    pub(crate) fn run(&mut self, group: &Group) {
        self.group = group.name;
        (group.run)(self);
    }

    /// Powers of ten; up to a thousand when nothing is measured.
    pub(crate) fn powers_of_ten(&self, from: u32, to: u32) -> impl Iterator<Item = usize> + use<> {
        let to = if self.is_measuring() { to } else { to.min(3) };
        (from.min(to)..=to).map(|power| 10_usize.pow(power))
    }

    pub(crate) fn is_measuring(&self) -> bool {
        self.criterion.is_some()
    }

    /// Nothing is set up for a case that is filtered out.
    pub(crate) fn compare(&mut self, case: &Case, contenders: impl FnOnce() -> Vec<Contender>) {
        let Some(criterion) = &mut self.criterion else {
            for mut contender in contenders() {
                (contender.run)(1);
            }
            return;
        };
        let mut contenders = Some(contenders);
        let mut entrants: Vec<Entrant> = Vec::new();
        let id = BenchmarkId::new(format!("{}, {}", case.precision, case.scene), case.size);
        let mut group = criterion.benchmark_group(self.group);
        group.sampling_mode(SamplingMode::Flat).bench_function(id, |bencher| {
            if let Some(contenders) = contenders.take() {
                entrants = contenders().into_iter().map(Entrant::calibrated).collect();
            }
            bencher.iter_custom(|rounds| {
                (0..rounds).map(|_| entrants.iter_mut().map(Entrant::run).sum::<Duration>()).sum()
            });
        });
        group.finish();
        for entrant in entrants {
            self.record(case.clone(), entrant.contender.name, entrant.values);
        }
    }

    pub(crate) fn record(&mut self, case: Case, contender: &'static str, values: Vec<f64>) {
        self.measured.push(Measured { group: self.group, case, contender, values });
    }
}
