//! The stability suite: scenes that break the textbook's methods, and what ours make of them.
//!
//! docs/stability.md has a section for each scene, and in its tables the numbers: what the method beside ours is off by
//! at least, and what ours is off by at most. Tests read them there, so that the page cannot say anything else than
//! what is tested, and a tolerance that the worse method meets as well is an error of the page.

/// What must not change a bit.
mod bits;
/// Scenes under a constant acceleration: clocks, steps and sums.
mod constant;
/// Drag, and damping as strong as drag can be.
mod drag;
/// Gravitation of many bodies: what one evaluation is worth.
mod gravity;
/// Gravitation of a few bodies: orbits, encounters and collisions.
mod orbits;
/// Where a particle reaches a plane.
mod until;

use std::cell::RefCell;
use std::collections::BTreeSet;

use pointmass::{
    Advance, Command, Drag, Error, Field, Forces, Gravitation, Integrator, Limits, Mass, Particle, ParticleId,
    ParticleState, Place, Plane, Precision, Real, Settings, Threads, Tolerance, Until, World,
};

const PAGE: &str = include_str!("../../../docs/stability.md");

/// One row of a table of the page.
#[derive(Debug)]
struct Claim {
    case: &'static str,
    what: &'static str,
    at_least: f64,
    at_most: f64,
}

fn claims() -> Vec<Claim> {
    let mut case = "";
    let mut claims = Vec::new();
    for line in PAGE.lines() {
        if let Some(name) = line.strip_prefix("## ") {
            case = name;
        }
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let &["", what, _, at_least, _, at_most, ""] = cells.as_slice() else { continue };
        if let (Ok(at_least), Ok(at_most)) = (at_least.parse(), at_most.parse()) {
            claims.push(Claim { case, what, at_least, at_most });
        }
    }
    claims
}

thread_local! {
    /// Cases and rows that this test has held against something.
    static SEEN: RefCell<BTreeSet<(String, String)>> = const { RefCell::new(BTreeSet::new()) };
}

/// Holds a row of the page against what is measured: the worse method is off by at least what it says there, ours by at
/// most.
#[track_caller]
fn check_claim(case: &str, what: &str, worse: f64, ours: f64) {
    let claims = claims();
    let claim = claims.iter().find(|claim| claim.case == case && claim.what == what);
    SEEN.with_borrow_mut(|seen| seen.insert((case.to_owned(), what.to_owned())));
    let Some(claim) = claim else { panic!("docs/stability.md has no row {what:?} in {case}") };
    assert!(ours <= claim.at_most, "{case}, {what}: ours is off by {ours:e}, not at most {:e}", claim.at_most);
    // What is not a number is as far off as can be.
    assert!(
        worse >= claim.at_least || worse.is_nan(),
        "{case}, {what}: the other method is off by {worse:e}, not at least {:e}: a tolerance that cannot fail",
        claim.at_least
    );
}

/// Every row that the page has on a case was held against something in this test.
#[track_caller]
fn check_every_row(case: &str) {
    SEEN.with_borrow(|seen| {
        for Claim { what, .. } in claims().iter().filter(|claim| claim.case == case) {
            assert!(seen.contains(&(case.to_owned(), (*what).to_owned())), "no test reads the row {what:?} of {case}");
        }
    });
}

/// The sources of this suite.
const SOURCES: [&str; 6] = [
    include_str!("bits.rs"),
    include_str!("constant.rs"),
    include_str!("drag.rs"),
    include_str!("gravity.rs"),
    include_str!("orbits.rs"),
    include_str!("until.rs"),
];

#[test]
fn every_case_of_the_page_is_tested() {
    let claims = claims();
    for Claim { case, what, at_least, at_most } in &claims {
        assert!(at_least > at_most, "{case}, {what}: the worse method meets the tolerance of ours");
        let end = format!("check_every_row({case:?})");
        assert!(SOURCES.iter().any(|source| source.contains(&end)), "{case}: no test reads all of its rows");
    }
    for case in PAGE.lines().filter_map(|line| line.strip_prefix("## ")).filter(|case| *case != "coefficient_ulp") {
        let test = format!("fn {case}()");
        assert!(SOURCES.iter().any(|source| source.contains(&test)), "there is no test {case}");
    }
    let rows: BTreeSet<_> = claims.iter().map(|claim| (claim.case, claim.what)).collect();
    assert_eq!(rows.len(), claims.len(), "two rows have one name");
}

fn number<R: Real>(x: f64) -> R {
    R::nearest(x)
}

fn vector<R: Real>(x: [f64; 3]) -> R::Vec3 {
    x.map(R::nearest).into()
}

fn wide<R: Real>(x: impl Into<[R; 3]>) -> [f64; 3] {
    x.into().map(Into::into)
}

fn minus(x: [f64; 3], y: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| x[k] - y[k])
}

fn norm(x: [f64; 3]) -> f64 {
    x[0].hypot(x[1]).hypot(x[2])
}

fn dot(x: [f64; 3], y: [f64; 3]) -> f64 {
    x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
}

/// From a number of a precision to the next one away from 0.
fn ulp<R: Real>(x: f64) -> f64 {
    match R::PRECISION {
        Precision::Single => {
            let x = f32::nearest(x).abs();
            f64::from(x.next_up()) - f64::from(x)
        }
        Precision::Double => x.abs().next_up() - x.abs(),
    }
}

fn in_steps(duration: f64, steps: u64) -> Advance {
    Advance { steps: Some(steps), ..Advance::by(duration) }
}

/// In so many steps of one length, also under an adaptive integrator as far as it accepts them.
fn in_equal_steps(integrator: Integrator, duration: f64, steps: u64) -> Advance {
    if integrator == Integrator::Dop853 {
        Advance { max_step: Some(duration / steps as f64), ..Advance::by(duration) }
    } else {
        in_steps(duration, steps)
    }
}

/// How many steps of at most h seconds a duration has.
fn steps_of(duration: f64, h: f64) -> u64 {
    let steps = (duration / h).ceil().max(1.0);
    #[expect(clippy::cast_sign_loss, reason = "at least 1")]
    let steps = steps as u64;
    steps
}

fn with<R: Real>(integrator: Integrator) -> Settings<R> {
    Settings { integrator, ..Settings::default() }
}

#[track_caller]
fn world<R: Real>(settings: Settings<R>, particles: &[Particle<R>]) -> World<R> {
    let mut world = World::new(settings).expect("valid settings");
    for particle in particles {
        world.create(*particle).expect("a valid particle");
    }
    world
}

#[track_caller]
fn state<R: Real>(world: &World<R>, id: u64) -> ParticleState<R> {
    world.particle(ParticleId(id)).expect("it was created")
}

#[track_caller]
fn position<R: Real>(world: &World<R>, id: u64) -> [f64; 3] {
    wide::<R>(state(world, id).position)
}

#[track_caller]
fn velocity<R: Real>(world: &World<R>, id: u64) -> [f64; 3] {
    wide::<R>(state(world, id).velocity)
}

/// The particle of the base scene: thrown at 50 m/s under textbook gravity, of which half is kept each second.
fn thrown<R: Real>() -> Particle<R> {
    Particle {
        velocity: vector::<R>([30.0, 40.0, 5.0]),
        acceleration: Some(vector::<R>([0.0, -9.81, 0.0])),
        damping: R::HALF,
        ..Particle::default()
    }
}
