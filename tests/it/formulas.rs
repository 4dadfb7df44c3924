//! The stepped integrators transcribed from their formulas as plainly as they can be said, one particle and one step at
//! a time. The fuzz target `commands` takes this file as it is, so it knows nothing of the tests around it.

use pointmass::{DampingLaw, Integrator, Precision, Real, Settings};

/// A particle and the force on it, in the letters of the formulas.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Naive<R> {
    pub(crate) p: [R; 3],
    pub(crate) v: [R; 3],
    pub(crate) own: Option<[R; 3]>,
    pub(crate) d: R,
    pub(crate) w: R,
    pub(crate) f: [R; 3],
}

/// Some steps of h seconds of one particle, as the specification says it (Millington, chapter 3). `power` is dʰ rounded
/// once to double.
pub(crate) fn advance<R: Real>(
    particle: &mut Naive<R>,
    settings: &Settings<R>,
    power: impl Fn(f64, f64) -> f64,
    h: R,
    steps: u32,
) {
    let Naive { p, v, own, d, w, f } = particle;
    let a = own.unwrap_or(if *w == R::ZERO { [R::ZERO; 3] } else { settings.gravity.into() });
    if *w == R::ZERO && *v == [R::ZERO; 3] && a == [R::ZERO; 3] {
        *f = [R::ZERO; 3];
        return;
    }
    let (d64, h64): (f64, f64) = ((*d).into(), h.into());
    let factor = match settings.damping_law {
        DampingLaw::PerStep => *d,
        DampingLaw::PerSecond if d64 <= 0.0 || d64 >= 1.0 => *d,
        DampingLaw::PerSecond => R::nearest(power(d64, h64)),
    };
    let rest = match R::PRECISION {
        Precision::Single => 2f64.powi(-100),
        Precision::Double => 2f64.powi(-960),
    };
    for step in 1..=steps {
        for k in 0..3 {
            let total = a[k] + *w * f[k];
            match settings.integrator {
                Integrator::NewtonEuler => {
                    p[k] = p[k] + v[k] * h;
                    v[k] = v[k] + total * h;
                    v[k] = v[k] * factor;
                }
                Integrator::NewtonEulerQuadratic => {
                    p[k] = (p[k] + v[k] * h) + total * (h * h * R::HALF);
                    v[k] = v[k] + total * h;
                    v[k] = v[k] * factor;
                }
                Integrator::SemiImplicitEuler => {
                    v[k] = (v[k] + total * h) * factor;
                    p[k] = p[k] + v[k] * h;
                }
                Integrator::Exact | Integrator::VelocityVerlet | Integrator::Rk4 | Integrator::Dop853 => {
                    unreachable!("only Euler's kind is transcribed")
                }
            }
            let magnitude: f64 = v[k].abs().into();
            if d64 < 1.0 && (step % 64 == 0 || step == steps) && magnitude < rest {
                v[k] = v[k] * R::ZERO; // A zero of its own sign.
            }
        }
    }
    *f = [R::ZERO; 3];
}
