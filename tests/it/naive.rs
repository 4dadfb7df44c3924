//! Every world must agree with the formulas to the bit: whatever the engine skips or shares must not show.

use std::collections::HashMap;

use pointmass::{
    Advance, Column, Command, Configure, DampingLaw, Integrator, Mass, Particle, ParticleId, Precision, Real,
    Selection, Settings, World,
};

use crate::formulas::{Naive, advance};
use crate::physics::{REFERENCE, Random, check_bits, scene};

/// dʰ rounded once to double, by the bits of d and h: tests/reference/motion.py has them from 80 digits.
fn powers() -> HashMap<(u64, u64), f64> {
    let bits = |word: &str| u64::from_str_radix(word, 16).expect("the table is hexadecimal");
    let lines = REFERENCE.lines().filter_map(|line| line.strip_prefix("power "));
    let words = lines.map(|line| line.split(' ').map(bits).collect::<Vec<u64>>());
    words.map(|words| ((words[0], words[1]), f64::from_bits(words[2]))).collect()
}

/// tests/reference/motion.py has the same two lists, and the powers of every pair in both precisions.
const DAMPINGS: [f64; 10] = [1e-30, 0.001, 0.1, 0.5, 0.75, 0.9, 0.95, 0.99, 0.999, 1.0 - 1.0 / 8_388_608.0];
const PLANS: [(f64, u32); 7] = [(1.0 / 60.0, 1), (1.0 / 60.0, 3), (0.1, 7), (1.0, 60), (2.5, 64), (2.5, 150), (0.3, 2)];

/// Particles of every kind: damped, undamped and with nothing kept; immovable, at rest and carried along; with an
/// acceleration of their own; with velocities that come to rest within an advance, seen in a position that is also
/// tiny; with zeros of either sign.
fn particle<R: Real>(random: &mut Random) -> Naive<R> {
    let rest = if R::PRECISION == Precision::Single { 2f64.powi(-100) } else { 2f64.powi(-960) };
    let tiny = random.one_of(&[false, false, true]);
    let mut vector = |zeros: &[f64], scale: f64| -> [R; 3] {
        std::array::from_fn(|_| R::nearest(random.one_of(zeros) * scale * (0.1 + random.unit())))
    };
    let (p, v) = if tiny {
        (vector(&[0.0, -0.0], 1.0), vector(&[1.0, -1.0, 1e3, -1e9, 0.0], rest))
    } else {
        (vector(&[1.0, -1.0, 0.0, -0.0], 100.0), vector(&[1.0, -1.0, 0.0, -0.0], 30.0))
    };
    let own = [None, Some([R::ZERO; 3]), Some(vector(&[1.0, -1.0, 0.0], 20.0))];
    let damping = random.one_of(&[&DAMPINGS[..], &[0.0], &[1.0; 4]].concat());
    let inertia = random.one_of(&[0.0, 1.0, 1.0 / 3.0, 7e-3, 40.0]);
    let still = inertia == 0.0 && random.one_of(&[true, false]);
    Naive {
        p,
        v: if still { [R::ZERO, R::nearest(-0.0), R::ZERO] } else { v },
        own: if still { random.one_of(&own[..2]) } else { random.one_of(&own) },
        d: R::nearest(damping),
        w: R::nearest(inertia),
        f: [R::ZERO; 3],
    }
}

/// Several advances of 300 particles, planned in each of the three ways, with forces on some before every second one.
#[track_caller]
fn check_agrees<R: Real>(integrator: Integrator, damping_law: DampingLaw, seed: u64) {
    let random = &mut Random(seed);
    let powers = powers();
    let power = |d: f64, h: f64| powers[&(d.to_bits(), h.to_bits())];
    let gravity = [R::ZERO, R::nearest(-9.80665), R::nearest(0.1)];
    let settings = Settings { integrator, damping_law, gravity: gravity.into(), ..Settings::default() };
    let mut model: Vec<Naive<R>> = (0..300).map(|_| particle(random)).collect();
    let mut world = World::new(settings).expect("an Euler integrator serves both laws");
    let new = model.iter().map(|n| Particle {
        position: n.p.into(),
        velocity: n.v.into(),
        acceleration: n.own.map(Into::into),
        damping: n.d,
        mass: Mass::Inverse(n.w),
        ..Particle::default()
    });
    world.apply(&Command::Create(new.collect())).expect("every value is in range");
    for round in 0..2 * PLANS.len() {
        let (duration, steps) = PLANS[(round * 3) % PLANS.len()];
        let at = scene::<R>(&format!("{duration} s in {steps} steps, round {round}, {damping_law}"), integrator);
        if round % 2 == 1 {
            let ids: Vec<ParticleId> = (0..model.len() as u64).step_by(round).map(ParticleId).collect();
            let forces: Vec<[R; 3]> =
                ids.iter().map(|_| std::array::from_fn(|_| R::nearest(100.0 * random.unit() - 50.0))).collect();
            for (id, force) in ids.iter().zip(&forces) {
                model[usize::try_from(id.0).expect("few particles")].f = *force;
            }
            let force = Column::PerParticle(forces.into_iter().map(Into::into).collect());
            world.apply(&Command::AddForce { ids: Selection::Ids(ids), force }).expect("the forces are finite");
        }
        let step = duration / f64::from(steps);
        let by = Advance::by(duration);
        let how = match round % 3 {
            0 => Advance { steps: Some(u64::from(steps)), ..by },
            1 => Advance { max_step: Some(step), ..by },
            _ => {
                let max_step = Some(Some(step));
                world.apply(&Command::Configure(Configure { max_step, ..Default::default() })).expect("a valid step");
                by
            }
        };
        let report = world.advance(how).expect("nothing is large enough to overflow");
        assert_eq!(report.steps, u64::from(steps), "{at}");
        for (naive, state) in model.iter_mut().zip(world.particles()) {
            advance(naive, &settings, power, R::nearest(duration / f64::from(steps)), steps);
            check_bits(&at, state.id, "position", naive.p, state.position);
            check_bits(&at, state.id, "velocity", naive.v, state.velocity);
            check_bits(&at, state.id, "force", naive.f, state.force);
        }
    }
}

#[test]
fn stepped_worlds_agree_with_the_formulas_to_the_bit() {
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.is_euler()) {
        for damping_law in DampingLaw::ALL {
            for seed in 1..=3 {
                check_agrees::<f32>(integrator, damping_law, seed);
                check_agrees::<f64>(integrator, damping_law, seed);
            }
        }
    }
}

/// A long advance is cut into slices, after each of which the engine looks whether it is cancelled: velocities come to
/// rest after the same steps as without.
#[test]
fn a_long_advance_rests_where_the_formulas_do() {
    fn each_precision<R: Real>(integrator: Integrator) {
        let rest = if R::PRECISION == Precision::Single { 2f64.powi(-100) } else { 2f64.powi(-960) };
        let settings = Settings { integrator, damping_law: DampingLaw::PerStep, ..Settings::default() };
        for n in 0..20 {
            // At rest after some thousand steps, in a position so small that the last of them show.
            let v = [R::nearest((4.0 + f64::from(n) / 7.0) * rest); 3];
            let d = R::nearest(1.0 - f64::from(n + 1) / 8192.0);
            let mut naive = Naive { p: [R::ZERO; 3], v, own: None, d, w: R::ONE, f: [R::ZERO; 3] };
            let mut world = World::<R>::new(settings).expect("valid settings");
            let id = world.create(Particle { velocity: v.into(), damping: d, ..Particle::default() }).expect("valid");
            world.advance(Advance { steps: Some(50_000), ..Advance::by(50_000.0) }).expect("finite");
            advance(&mut naive, &settings, |_, _| unreachable!("the law is per step"), R::ONE, 50_000);
            let state = world.particle(id).expect("created above");
            let scene = scene::<R>(&format!("a long way to rest, {n}"), integrator);
            check_bits(&scene, id, "position", naive.p, state.position);
            check_bits(&scene, id, "velocity", naive.v, state.velocity);
        }
    }
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.serves(DampingLaw::PerStep)) {
        each_precision::<f32>(integrator);
        each_precision::<f64>(integrator);
    }
}
