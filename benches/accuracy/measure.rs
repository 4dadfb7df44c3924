//! One run: how long it takes, and how far from the reference it ends; or why it did not end.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use pointmass::{Advance, Advanced, Command, Error, Outcome as Applied, Precision, Real, States, World};

use crate::method::{Method, Setting};
use crate::scenes::{End, Scene, read_all};

/// Runs that would take more seconds are not begun: fixed steps, of which fewer tell enough.
const LONGEST_FIXED: f64 = 3.0;

/// Others.
const LONGEST: f64 = 9.0;

/// A run is given up after this; the machine may have become busy.
const PATIENCE: Duration = Duration::from_secs(20);

/// What share of the time of a scene a pilot run covers.
const PILOT: f64 = 1.0 / 64.0;

/// A scene up to one of the times whose solution is known.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Task<'a> {
    pub(crate) scene: &'a Scene,
    pub(crate) end: &'a End,
    /// Copies of each particle.
    pub(crate) copies: usize,
    pub(crate) method: Method,
    pub(crate) setting: Setting,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Outcome {
    Done(Run),
    /// The engine refused it, after so many seconds.
    Refused {
        reason: &'static str,
        seconds: f64,
    },
    /// It would take so many seconds, or at least so many.
    NotRun {
        seconds: f64,
        at_least: bool,
    },
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Run {
    /// The largest distance of a particle from where it should be, in the unit of the scene.
    pub(crate) error: f64,
    /// Seconds of each run.
    pub(crate) seconds: Vec<f64>,
    pub(crate) steps: u64,
    pub(crate) rejected: u64,
    pub(crate) evaluations: u64,
}

impl Setting {
    /// The most seconds of a run.
    pub(crate) fn longest(self) -> f64 {
        if self.steps().is_some() { LONGEST_FIXED } else { LONGEST }
    }
}

impl Run {
    /// A run that took longer is not repeated as often.
    const ROUNDS: [(f64, usize); 2] = [(0.05, 7), (0.5, 3)];

    pub(crate) fn median(&self) -> f64 {
        let mut seconds = self.seconds.clone();
        seconds.sort_by(f64::total_cmp);
        seconds[seconds.len() / 2]
    }

    pub(crate) fn best(&self) -> f64 {
        self.seconds.iter().copied().fold(f64::INFINITY, f64::min)
    }

    pub(crate) fn worst(&self) -> f64 {
        self.seconds.iter().copied().fold(0.0, f64::max)
    }

    /// Whether one more measurement of its time is wanted.
    pub(crate) fn repeats(&self) -> bool {
        let rounds = Self::ROUNDS.iter().find(|(below, _)| self.best() < *below);
        self.seconds.len() < rounds.map_or(1, |(_, rounds)| *rounds)
    }
}

impl Outcome {
    /// How long it takes at best, or would take.
    pub(crate) fn seconds(&self) -> f64 {
        match self {
            Self::Done(run) => run.best(),
            Self::Refused { seconds, .. } | Self::NotRun { seconds, .. } => *seconds,
        }
    }

    pub(crate) fn run(&self) -> Option<&Run> {
        match self {
            Self::Done(run) => Some(run),
            Self::Refused { .. } | Self::NotRun { .. } => None,
        }
    }
}

impl Task<'_> {
    /// The first run, with its result.
    pub(crate) fn measure(&self) -> Outcome {
        match self.scene.precision {
            Precision::Single => self.measure_in::<f32>(),
            Precision::Double => self.measure_in::<f64>(),
        }
    }

    /// Seconds of one more run.
    pub(crate) fn time(&self) -> f64 {
        match self.scene.precision {
            Precision::Single => self.time_in::<f32>(),
            Precision::Double => self.time_in::<f64>(),
        }
    }

    fn world<R: Real>(&self) -> World<R> {
        self.scene.world(self.method.settings(self.setting), self.copies)
    }

    /// The advances that make up the whole, or its first part.
    fn advances(&self, share: f64) -> (Advance, u64) {
        let duration = self.end.time * share;
        match self.setting {
            Setting::Advances(count) => (Advance::by(duration / whole(count)), count),
            Setting::Steps(steps) => (Advance { steps: Some(part(steps, share)), ..Advance::by(duration) }, 1),
            Setting::Tolerance(_) => (Advance::by(duration), 1),
        }
    }

    fn measure_in<R: Real>(&self) -> Outcome {
        let world = self.world::<R>();
        let mut states = States::default();
        let short = matches!(self.setting, Setting::Steps(0..=10_000) | Setting::Advances(_));
        if !short {
            let start = Instant::now();
            let limit = Duration::from_secs_f64(self.setting.longest());
            let pilot = within(limit, |cancelled| advance(&mut world.clone(), self.advances(PILOT), cancelled));
            let seconds = start.elapsed().as_secs_f64() / PILOT;
            let at_least = pilot == Err(Error::Cancelled);
            if at_least || (pilot.is_ok() && seconds > self.setting.longest()) {
                return Outcome::NotRun { seconds, at_least };
            }
        }
        let mut after = world.clone();
        let start = Instant::now();
        let result = within(PATIENCE, |cancelled| advance(&mut after, self.advances(1.0), cancelled));
        read_all(&after, &mut states);
        let seconds = start.elapsed().as_secs_f64();
        match result {
            Ok(advanced) => Outcome::Done(Run {
                error: self.end.error(&states),
                seconds: vec![seconds],
                steps: advanced.step_count,
                rejected: advanced.rejected_steps,
                evaluations: advanced.evaluations,
            }),
            Err(Error::Cancelled) => Outcome::NotRun { seconds, at_least: true },
            Err(error) => Outcome::Refused { reason: reason(&error), seconds },
        }
    }

    /// Fast ones repeat, and the fastest few tens of microseconds count: others may have had the processor in between.
    fn time_in<R: Real>(&self) -> f64 {
        let world = self.world::<R>();
        let mut states = States::default();
        let mut best = f64::INFINITY;
        let begun = Instant::now();
        while begun.elapsed() < Duration::from_millis(2) {
            let (mut sum, mut runs) = (Duration::ZERO, 0);
            while sum < Duration::from_micros(30) {
                let mut after = world.clone();
                let start = Instant::now();
                advance(&mut after, self.advances(1.0), &AtomicBool::new(false)).expect("it went well before");
                read_all(&after, &mut states);
                sum += start.elapsed();
                runs += 1;
            }
            best = best.min(sum.as_secs_f64() / f64::from(runs));
        }
        best
    }
}

fn advance<R: Real>(
    world: &mut World<R>,
    (advance, times): (Advance, u64),
    cancelled: &AtomicBool,
) -> Result<Advanced, Error> {
    let command = Command::Advance(advance);
    let mut last = Err(Error::Cancelled);
    for _ in 0..times {
        last = match world.apply_unless(&command, cancelled)? {
            Applied::Advanced(advanced) => Ok(advanced),
            Applied::Created { .. } | Applied::Changed { .. } | Applied::Configured => unreachable!("it advances"),
        };
    }
    last
}

/// Lets something run, and tells it to give up after a while.
fn within<T>(limit: Duration, run: impl FnOnce(&AtomicBool) -> T) -> T {
    let cancelled = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let (done, waits) = channel::<()>();
        let flag = &cancelled;
        scope.spawn(move || {
            if waits.recv_timeout(limit) == Err(RecvTimeoutError::Timeout) {
                flag.store(true, Ordering::Relaxed);
            }
        });
        let result = run(&cancelled);
        drop(done);
        result
    })
}

fn reason(error: &Error) -> &'static str {
    if matches!(error, Error::Diverged { .. }) {
        "diverged"
    } else if matches!(error, Error::TooManySteps { .. }) {
        "too many steps"
    } else {
        "refused"
    }
}

/// A share of some steps, at least one.
fn part(steps: u64, share: f64) -> u64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive, below 2⁵³")]
    let part = (whole(steps) * share).round() as u64;
    part.max(1)
}

/// A count as a number.
pub(crate) fn whole(count: u64) -> f64 {
    count as f64
}
