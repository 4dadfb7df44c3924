//! Every instruction set of this machine against plain numbers, bit for bit.

#![expect(clippy::cast_precision_loss, reason = "numbers are made of random bits")]

use fearless_simd::Level;
use proptest::prelude::*;

use super::{Acceleration, Damping, Drive, STEPS_BETWEEN_RESTS, Step, advance, to_components};
use crate::integrator::Integrator;
use crate::real::Real;

/// The instruction sets that this machine has.
pub(crate) fn levels() -> Vec<Level> {
    let best = Level::new();
    let mut levels = vec![Level::baseline(), best];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(best.as_sse4_2().map(Level::Sse4_2));
        levels.extend(best.as_avx2().map(Level::Avx2));
    }
    levels
}

/// One component, transcribed from the equations.
fn plain<R: Real>(step: Step<R>, a: R, d: Option<(R, R)>, steps: u64, mut p: R, mut v: R) -> (R, R) {
    let h = step.h;
    for n in 1..=steps {
        let old = v;
        v = v + a * h;
        if let Some((factor, _)) = d {
            v = v * factor;
        }
        p = match step.integrator {
            Integrator::NewtonEuler => p + old * h,
            Integrator::NewtonEulerQuadratic => (p + old * h) + a * (h * h * R::HALF),
            Integrator::SemiImplicitEuler => p + v * h,
            Integrator::Exact | Integrator::VelocityVerlet | Integrator::Rk4 | Integrator::Dop853 => {
                unreachable!("not of Euler's kind")
            }
        };
        if let Some((_, rest)) = d
            && (n.is_multiple_of(STEPS_BETWEEN_RESTS) || n == steps)
            && v.abs() < rest
        {
            v = v * R::ZERO;
        }
    }
    (p, v)
}

/// Any finite number, a zero, one at which velocities come to rest, or one as scenes have them.
fn number<R: Real>(bits: u64) -> R {
    let any = R::nearest(f64::from_bits(bits));
    let of_a_scene = R::nearest((bits >> 12) as f64 / 1e15 - 2.0);
    match bits % 8 {
        0 | 1 if any.is_finite() => any,
        2 => R::ZERO,
        3 | 4 => of_a_scene * R::REST,
        _ => of_a_scene,
    }
}

/// `shape` is that of the damping; `uniform` that of the acceleration.
fn check<R: Real + PartialEq>(
    seeds: &[[u64; 4]],
    shape: u8,
    uniform: bool,
    steps: u64,
    h: u64,
) -> Result<(), TestCaseError> {
    // A block is whole particles.
    let len = seeds.len() / 3 * 3;
    let of = |k: usize| seeds[..len].iter().map(|seed| number::<R>(seed[k])).collect::<Vec<R>>();
    let (p, v, mut each) = (of(0), of(1), of(2));
    if uniform {
        (3..len).for_each(|i| each[i] = each[i - 3]);
    }
    let share = |seed: u64| R::nearest((seed >> 11) as f64 / (1u64 << 53) as f64);
    let factors: Vec<R> = seeds[..len].iter().map(|seed| share(seed[3])).collect();
    let rests: Vec<R> =
        seeds[..len].iter().map(|seed| if seed[3].is_multiple_of(3) { R::ZERO } else { R::REST }).collect();
    let step_of = |integrator| Step { integrator, h: share(h), fetches: h.is_multiple_of(2) };
    for integrator in Integrator::ALL.into_iter().filter(|integrator| integrator.is_euler()) {
        let step = step_of(integrator);
        let damping = match shape {
            0 => Damping::None,
            1 => Damping::Uniform(share(h)),
            2 => Damping::Each(&factors),
            _ => Damping::Mixed { factor: &factors, rest: &rests },
        };
        for level in levels() {
            let (mut own_p, mut own_v) = (p.clone(), v.clone());
            let acceleration = match each.as_slice() {
                [x, y, z, ..] if uniform => Acceleration::Uniform([*x, *y, *z]),
                each => Acceleration::Each(each),
            };
            advance(level, step, Drive { acceleration, damping }, steps, &mut own_p, &mut own_v);
            for i in 0..len {
                let d = match shape {
                    0 => None,
                    1 => Some((share(h), R::REST)),
                    2 => Some((factors[i], R::REST)),
                    _ => Some((factors[i], rests[i])),
                };
                let expected = plain(step, each[i], d, steps, p[i], v[i]);
                for (name, own, expected) in [("p", own_p[i], expected.0), ("v", own_v[i], expected.1)] {
                    let bits = |x: R| {
                        let x: f64 = x.into();
                        if x.is_nan() { None } else { Some(x.to_bits()) }
                    };
                    prop_assert_eq!(
                        bits(own),
                        bits(expected),
                        "{:?} {} {} of {} by {:?}, damping {}",
                        level,
                        name,
                        i,
                        len,
                        integrator,
                        shape
                    );
                }
            }
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]
    /// Lengths from nothing past two groups of the widest registers, every kind of damping, steps past two rests.
    #[test]
    fn every_instruction_set_gives_the_bits_of_plain_numbers(
        seeds in prop::collection::vec(any::<[u64; 4]>(), 0..220),
        steps in prop_oneof![1u64..4, 60u64..70, 120u64..140],
        h in any::<u64>(),
    ) {
        for shape in 0..4 {
            for uniform in [false, true] {
                check::<f32>(&seeds, shape, uniform, steps, h)?;
                check::<f64>(&seeds, shape, uniform, steps, h)?;
            }
        }
    }
}

#[test]
fn each_number_is_repeated_for_its_three_components() {
    for len in 0..70 {
        let each: Vec<f32> = (0..len).map(|i| i as f32).collect();
        let mut components = vec![0.0; 3 * len];
        for level in levels() {
            to_components(level, &each, &mut components);
            assert!(components.iter().enumerate().all(|(i, c)| *c == (i / 3) as f32), "{level:?} {len}");
        }
    }
}
