//! Run time against error: every integrator over a sweep of steps or tolerances, in every scene.

use pointmass::{Integrator, Precision};

use crate::measure::{Outcome, Task, whole};
use crate::method::{Method, Setting};
use crate::scenes::Scene;

/// How a scene is measured and told of.
#[derive(Debug)]
pub(crate) struct Spec {
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    /// What happens, for the page.
    pub(crate) about: &'static str,
    /// The unit of length: m, AU, or none.
    pub(crate) length: &'static str,
    /// By which errors are divided to be relative; `None`: the distance from the origin at the end.
    size: Option<f64>,
    /// Copies of each particle. One particle fills no vector register, and nobody has one particle.
    copies: usize,
    /// Steps of the whole, and how long one is.
    steps: &'static [(u64, &'static str)],
    /// Compensated methods that change something; the others are left out.
    compensated: &'static [Integrator],
}

const COPIES: usize = 64;

const THROW: [(u64, &str); 9] = [
    (10, "1 s"),
    (40, "1/4 s"),
    (150, "1/15 s"),
    (600, "1/60 s"),
    (2_400, "1/240 s"),
    (10_000, "1/1000 s"),
    (40_000, "1/4000 s"),
    (160_000, "1/16000 s"),
    (640_000, "1/64000 s"),
];

/// In the order of the page.
pub(crate) const SPECS: [Spec; 7] = [
    Spec {
        name: "base",
        title: "Thrown, with strong damping",
        about: "Gravity of 9.81 m/s², damping 0.5 (half of the velocity is lost each second), 10 s.",
        length: "m",
        size: None,
        copies: COPIES,
        steps: &THROW,
        compensated: &[Integrator::VelocityVerlet, Integrator::Dop853],
    },
    Spec {
        name: "weak",
        title: "Thrown, with weak damping, 4.6 hours",
        about: "Gravity of 9.81 m/s², damping 0.999, 16,667 s: a million steps of 1/60 s.",
        length: "m",
        size: None,
        copies: COPIES,
        steps: &[
            (1_000, "50/3 s"),
            (4_000, "25/6 s"),
            (16_000, "25/24 s"),
            (62_500, "4/15 s"),
            (250_000, "1/15 s"),
            (1_000_000, "1/60 s"),
            (4_000_000, "1/240 s"),
        ],
        compensated: &[Integrator::VelocityVerlet, Integrator::Rk4, Integrator::Dop853],
    },
    Spec {
        name: "drag",
        title: "Thrown, with quadratic drag",
        about: "Gravity of 9.81 m/s², drag k₁ = 0.2 kg/s and k₂ = 0.1 kg/m on 1 kg, 10 s.",
        length: "m",
        size: None,
        copies: COPIES,
        steps: &THROW,
        compensated: &[Integrator::Dop853],
    },
    Spec {
        name: "kepler",
        title: "Kepler, eccentricity 0.9, 1000 orbits",
        about: "Two bodies, mass ratio 1000, semi-major axis 1, period 2π; the orbit is tilted against all axes.",
        length: "",
        size: Some(1.0),
        copies: 1,
        steps: &[
            (100_000, "1/100 orbit"),
            (400_000, "1/400 orbit"),
            (1_600_000, "1/1600 orbit"),
            (6_400_000, "1/6400 orbit"),
            (25_600_000, "1/25600 orbit"),
        ],
        compensated: &[Integrator::Dop853],
    },
    Spec {
        name: "outer",
        title: "Outer Solar System, 100,000 years",
        about: "The Sun, Jupiter, Saturn, Uranus and Neptune, and Pluto without mass, 36,525,000 days.",
        length: "AU",
        size: Some(30.0),
        copies: 1,
        steps: &[
            (91_300, "400 d"),
            (182_625, "200 d"),
            (365_250, "100 d"),
            (913_125, "40 d"),
            (3_652_500, "10 d"),
            (14_610_000, "2.5 d"),
            (58_440_000, "0.625 d"),
        ],
        compensated: &[Integrator::VelocityVerlet, Integrator::Dop853],
    },
    Spec {
        name: "pleiades",
        title: "Pleiades: seven stars in a plane",
        about: "Masses 1 to 7 with near encounters, 3 units of time.",
        length: "",
        size: Some(1.0),
        copies: 1,
        steps: &[
            (300, "1/100"),
            (1_200, "1/400"),
            (4_800, "1/1600"),
            (19_200, "1/6400"),
            (76_800, "1/25600"),
            (307_200, "1/102400"),
            (1_228_800, "1/409600"),
        ],
        compensated: &[Integrator::Dop853],
    },
    Spec {
        name: "arenstorf",
        title: "Arenstorf's orbit around Earth and Moon",
        about: "A body without mass passes Earth and Moon closely, one period of 17.07.",
        length: "",
        size: Some(1.0),
        copies: 1,
        steps: &[
            (1_000, "1/1000 orbit"),
            (4_000, "1/4000 orbit"),
            (16_000, "1/16000 orbit"),
            (64_000, "1/64000 orbit"),
            (256_000, "1/256000 orbit"),
            (1_024_000, "1/1024000 orbit"),
            (4_096_000, "1/4096000 orbit"),
        ],
        compensated: &[Integrator::Dop853],
    },
];

/// The advances of the closed form: one jump, and one for each 1/60 s of ten seconds.
const ADVANCES: [u64; 2] = [1, 600];

const TOLERANCES: [f64; 9] = [1e-3, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13, 1e-15, 1e-16, 1e-17];

/// As many as any run is measured.
const ROUNDS_MAX: usize = 7;

/// Below this the engine takes a tolerance of a single world for a sixteenth of its rounding.
const LEAST_TOLERANCE_SINGLE: f64 = 1e-9;

/// What came of one method with one setting.
#[derive(Debug, Clone)]
pub(crate) struct Point {
    pub(crate) spec: &'static Spec,
    pub(crate) precision: Precision,
    pub(crate) method: Method,
    pub(crate) setting: Setting,
    /// The setting for people.
    pub(crate) label: String,
    pub(crate) outcome: Outcome,
    /// Simulated time, in the unit of the scene.
    pub(crate) duration: f64,
    particles: usize,
    /// By which the error is divided to be relative.
    pub(crate) size: f64,
}

impl Point {
    /// Nanoseconds for a simulated unit of time and a particle.
    pub(crate) fn cost(&self, seconds: f64) -> f64 {
        seconds * 1e9 / (self.duration * self.particles as f64)
    }

    pub(crate) fn relative_error(&self) -> Option<f64> {
        self.outcome.run().map(|run| run.error / self.size)
    }
}

impl Spec {
    /// The methods that serve the scene and of which something is to be seen.
    fn methods(&self, scene: &Scene) -> impl Iterator<Item = Method> {
        let has_forces = scene.has_forces();
        Method::ALL.into_iter().filter(move |method| {
            (!has_forces || method.integrator.serves_forces())
                && (!method.compensated || self.compensated.contains(&method.integrator))
        })
    }

    fn settings(&self, method: Method, precision: Precision) -> Vec<(Setting, String)> {
        match method.integrator {
            Integrator::Exact => {
                let label = |count| if count == 1 { "1 advance".to_owned() } else { format!("{count} advances") };
                ADVANCES.into_iter().map(|count| (Setting::Advances(count), label(count))).collect()
            }
            Integrator::Dop853 => {
                let least = if precision == Precision::Single { LEAST_TOLERANCE_SINGLE } else { 0.0 };
                let tolerances = TOLERANCES.into_iter().filter(|tolerance| *tolerance >= least);
                tolerances.map(|tolerance| (Setting::Tolerance(tolerance), format!("{tolerance:.0e}"))).collect()
            }
            Integrator::NewtonEuler
            | Integrator::NewtonEulerQuadratic
            | Integrator::SemiImplicitEuler
            | Integrator::VelocityVerlet
            | Integrator::Rk4 => {
                self.steps.iter().map(|(steps, label)| (Setting::Steps(*steps), (*label).to_owned())).collect()
            }
        }
    }
}

/// Measures all of a scene. `small` is for checks: the first time of the reference, and few settings.
pub(crate) fn measure(spec: &'static Spec, scene: &Scene, small: bool) -> Vec<Point> {
    let end = if small { &scene.ends[0] } else { scene.ends.last().expect("every scene has one") };
    let copies = if small { spec.copies.min(2) } else { spec.copies };
    let mut tasks = Vec::new();
    let mut points = Vec::new();
    for method in spec.methods(scene) {
        let settings = spec.settings(method, scene.precision);
        let mut before = None;
        // The second and the fourth do for a check.
        let some = settings.into_iter().enumerate().filter(|(i, _)| !small || [1, 3].contains(i));
        for (_, (setting, label)) in some {
            let setting = if small { shortened(setting) } else { setting };
            let task = Task { scene, end, copies, method, setting };
            // From how long the fewer steps before took.
            let expected = before.zip(setting.steps()).map(|((seconds, steps), more)| seconds / steps * more);
            let outcome = match expected.filter(|seconds| *seconds > 2.0 * setting.longest()) {
                Some(seconds) => Outcome::NotRun { seconds, at_least: false },
                None => task.measure(),
            };
            before = setting.steps().map(|steps| (outcome.seconds(), steps));
            tasks.push(task);
            points.push(Point {
                spec,
                precision: scene.precision,
                method,
                setting,
                label,
                outcome,
                duration: end.time,
                particles: copies * scene.bodies.len(),
                size: spec.size.unwrap_or_else(|| end.extent()),
            });
        }
    }
    // Round by round, so that what slows the machine down for a while does not hit one method alone.
    for _ in 0..if small { 0 } else { ROUNDS_MAX } {
        for (task, point) in tasks.iter().zip(&mut points) {
            if let Outcome::Done(run) = &mut point.outcome
                && run.repeats()
            {
                run.seconds.push(task.time());
            }
        }
    }
    points
}

/// So that all of it takes some seconds without optimisation.
fn shortened(setting: Setting) -> Setting {
    match setting {
        Setting::Steps(steps) => Setting::Steps(steps.min(500)),
        Setting::Advances(_) | Setting::Tolerance(_) => setting,
    }
}

/// Every integrator must have done something that can be told from nothing.
pub(crate) fn check(points: &[Point]) {
    for point in points {
        let Point { spec, precision, method, label, .. } = point;
        let what = format!("{}, {precision}, {method}, {label}", spec.name);
        let Outcome::Done(run) = &point.outcome else { panic!("{what}: {:?}", point.outcome) };
        assert!(run.error.is_finite(), "{what}: {}", run.error);
        let most = match (method.integrator, precision) {
            (Integrator::Exact, Precision::Double) => 1e-14,
            (Integrator::Dop853, Precision::Double) if point.setting == Setting::Tolerance(1e-9) => 1e-6,
            (Integrator::Exact, Precision::Single) => 1e-6,
            _ => f64::INFINITY,
        };
        assert!(run.error / point.size <= most, "{what}: an error of {:e}", run.error / point.size);
    }
}

/// The cheapest point of a method whose relative error is at most this.
pub(crate) fn cheapest<'a>(points: &[&'a Point], method: Method, error: f64) -> Option<&'a Point> {
    let good = points.iter().filter(|p| p.method == method && p.relative_error().is_some_and(|e| e <= error));
    good.copied().min_by(|a, b| a.outcome.seconds().total_cmp(&b.outcome.seconds()))
}

/// The most accurate point of a method.
pub(crate) fn best<'a>(points: &[&'a Point], method: Method) -> Option<&'a Point> {
    let done = points.iter().filter(|p| p.method == method && p.outcome.run().is_some());
    done.copied().min_by(|a, b| a.relative_error().partial_cmp(&b.relative_error()).expect("errors are numbers"))
}

/// Steps of a setting as a number, for the CSV.
pub(crate) fn value(setting: Setting, duration: f64) -> (&'static str, f64) {
    match setting {
        Setting::Advances(count) => ("advances", whole(count)),
        Setting::Steps(steps) => ("step", duration / whole(steps)),
        Setting::Tolerance(tolerance) => ("tolerance", tolerance),
    }
}
