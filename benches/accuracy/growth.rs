//! Error over simulated time: rounding over a million steps, a thousand orbits, and the energy of the planets.

#![expect(clippy::disallowed_methods, reason = "moments to look at; no state of a world comes of them")]

use std::sync::atomic::AtomicBool;

use pointmass::{Advance, Command, Integrator, Precision, Real, States, World};

use crate::measure::whole;
use crate::method::{Method, Setting};
use crate::scenes::{Scene, distance, read_all};

/// One line of a chart.
#[derive(Debug, Clone)]
pub(crate) struct Curve {
    /// Which chart.
    pub(crate) chart: &'static str,
    pub(crate) scene: String,
    pub(crate) precision: Precision,
    pub(crate) name: String,
    /// Along the line.
    pub(crate) points: Vec<(f64, f64)>,
    /// Where the engine refused to go on.
    pub(crate) refused: Option<f64>,
}

/// Rounding over a million steps.
pub(crate) const LONG: &str = "long";
/// A thousand orbits.
pub(crate) const ORBITS: &str = "orbits";
/// The energy of the planets.
pub(crate) const ENERGY: &str = "energy";

/// In an advance of so many steps where steps are fixed.
fn step<R: Real>(world: &mut World<R>, duration: f64, steps: Option<u64>) -> Result<(), pointmass::Error> {
    let command = Command::Advance(Advance { steps, ..Advance::by(duration) });
    world.apply_unless(&command, &AtomicBool::new(false)).map(drop)
}

fn curve(chart: &'static str, scene: &Scene, name: String) -> Curve {
    let (scene, precision) = (scene.name.clone(), scene.precision);
    Curve { chart, scene, precision, name, points: Vec::new(), refused: None }
}

/// `base` and `weak` in steps of 1/60 s under `velocity_verlet`, whose steps are exact there: what is left is rounding.
pub(crate) fn long(scene: &Scene, small: bool) -> Vec<Curve> {
    match scene.precision {
        Precision::Single => long_in::<f32>(scene, small),
        Precision::Double => long_in::<f64>(scene, small),
    }
}

fn long_in<R: Real>(scene: &Scene, small: bool) -> Vec<Curve> {
    let verlet = Integrator::VelocityVerlet;
    let of = |method: Method| {
        let name = format!("{}{}", scene.precision, if method.compensated { ", compensated" } else { "" });
        let mut curve = curve(LONG, scene, name);
        let mut world: World<R> = scene.world(method.settings(Setting::Steps(1)), 1);
        // Within an ulp of the truth, which the checks hold against the references.
        let mut exact: World<f64> = scene.world(Method::plain(Integrator::Exact).settings(Setting::Advances(1)), 1);
        let (mut states, mut truth) = (States::default(), States::default());
        let mut taken = 0;
        for steps in logarithmic(if small { 2 } else { 6 }, 4) {
            let duration = whole(steps - taken) / 60.0;
            step(&mut world, duration, Some(steps - taken)).expect("nothing is large");
            step(&mut exact, duration, None).expect("nothing is large");
            taken = steps;
            read_all(&world, &mut states);
            read_all(&exact, &mut truth);
            let (there, should) = (states.position[0].map(Into::into), truth.position[0]);
            let error = distance(there, should) / distance(should, [0.0; 3]);
            curve.points.push((whole(steps), error));
        }
        curve
    };
    vec![of(Method::plain(verlet)), of(Method::compensated(verlet))]
}

/// Kepler's orbit: where the bodies are after 1, 10, 100 and 1000 periods.
pub(crate) fn orbits(scene: &Scene, small: bool) -> Vec<Curve> {
    match scene.precision {
        Precision::Single => orbits_in::<f32>(scene, small),
        Precision::Double => orbits_in::<f64>(scene, small),
    }
}

fn orbits_in<R: Real>(scene: &Scene, small: bool) -> Vec<Curve> {
    let per_orbit = |method, steps: u64| (method, Setting::Steps(steps), format!("{method}, 1/{steps} orbit"));
    let tolerance = |method: Method, tolerance: f64| {
        let compensated = if method.compensated { ", comp." } else { "" };
        (method, Setting::Tolerance(tolerance), format!("{} {tolerance:.0e}{compensated}", method.integrator))
    };
    let dop853 = Integrator::Dop853;
    let ways = [
        per_orbit(Method::plain(Integrator::NewtonEuler), 6_400),
        per_orbit(Method::plain(Integrator::VelocityVerlet), 6_400),
        per_orbit(Method::plain(Integrator::Rk4), 6_400),
        tolerance(Method::plain(dop853), 1e-7),
        tolerance(Method::compensated(dop853), 1e-17),
    ];
    let ends = if small { &scene.ends[..1] } else { &scene.ends[..] };
    let of = |(method, setting, name): (Method, Setting, String)| {
        let mut curve = curve(ORBITS, scene, name);
        let mut world: World<R> = scene.world(method.settings(setting), 1);
        let mut states = States::default();
        let (mut since, mut orbits) = (0.0, 0);
        for (end, periods) in ends.iter().zip([1, 10, 100, 1000]) {
            let steps = match setting {
                Setting::Steps(steps) => Some(steps * (periods - orbits)),
                Setting::Advances(_) | Setting::Tolerance(_) => None,
            };
            if step(&mut world, end.time - since, steps).is_err() {
                curve.refused = Some(whole(periods));
                break;
            }
            (since, orbits) = (end.time, periods);
            read_all(&world, &mut states);
            curve.points.push((whole(periods), end.error(&states)));
        }
        curve
    };
    ways.into_iter().map(of).collect()
}

/// The outer planets in double: the largest relative error of the energy so far.
pub(crate) fn energy(scene: &Scene, small: bool) -> Vec<Curve> {
    const STEP: f64 = 40.0;
    let fixed = |integrator: Integrator| (Method::plain(integrator), Setting::Steps(1), format!("{integrator}, 40 d"));
    let tolerance = |method: Method, tolerance: f64| {
        let compensated = if method.compensated { ", comp." } else { "" };
        (method, Setting::Tolerance(tolerance), format!("{} {tolerance:.0e}{compensated}", method.integrator))
    };
    let ways = [
        fixed(Integrator::NewtonEuler),
        fixed(Integrator::SemiImplicitEuler),
        fixed(Integrator::VelocityVerlet),
        fixed(Integrator::Rk4),
        tolerance(Method::plain(Integrator::Dop853), 1e-9),
        tolerance(Method::compensated(Integrator::Dop853), 1e-17),
    ];
    let last = if small { 90 } else { 913_125 };
    let of = |(method, setting, name): (Method, Setting, String)| {
        let mut curve = curve(ENERGY, scene, name);
        let mut world: World<f64> = scene.world(method.settings(setting), 1);
        let mut states = States::default();
        read_all(&world, &mut states);
        let start = scene.energy(&states);
        let (mut taken, mut most) = (0, 0.0_f64);
        for (i, steps) in logarithmic(6, 20).take_while(|steps| *steps <= last).chain([last]).enumerate() {
            let some = (steps - taken).max(1);
            let asked = matches!(setting, Setting::Steps(_)).then_some(some);
            let years = STEP * whole(steps) / 365.25;
            if steps > taken && step(&mut world, STEP * whole(some), asked).is_err() {
                curve.refused = Some(years);
                break;
            }
            taken = steps;
            read_all(&world, &mut states);
            most = most.max((scene.energy(&states) / start - 1.0).abs());
            if i % 8 == 0 || steps == last {
                curve.points.push((years, most));
            }
        }
        curve
    };
    ways.into_iter().map(of).collect()
}

/// Whole numbers from 1 to a power of ten, so many to each power, each once.
fn logarithmic(powers: u32, each: u32) -> impl Iterator<Item = u64> {
    let mut last = 0;
    (0..=powers * each).filter_map(move |i| {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive, at most a million")]
        let number = 10_f64.powf(f64::from(i) / f64::from(each)).round() as u64;
        (number > last).then(|| {
            last = number;
            number
        })
    })
}
