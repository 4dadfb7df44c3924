//! Where a particle reaches a plane: solved, not stepped over.

use crate::closed_form::Decay;
use crate::command::{Plane, Until};
use crate::error::{Error, Field};
use crate::real::Real;
use crate::system::State;
use crate::world::World;

impl<R: Real> World<R> {
    pub(super) fn check_until(&self, until: &Until) -> Result<(), Error> {
        let Until { particle, plane } = until;
        self.ids.row(*particle).ok_or(Error::UnknownParticle { id: *particle, index: 0 })?;
        if !plane.normal.iter().all(|x| x.is_finite()) {
            return Err(Error::NotFinite(Field::Normal.whole()));
        }
        if !plane.offset.is_finite() {
            return Err(Error::NotFinite(Field::Offset.whole()));
        }
        if plane.normal == [0.0; 3] {
            return Err(Error::PlaneWithoutNormal);
        }
        Ok(())
    }

    /// Under the closed form, the seconds after which the particle reaches the plane, if it does within the duration.
    ///
    /// Its distance is f₀ + u φ + a ψ with u = n · v and a = n · A. The rate u E + a φ changes sign at most once, so that the
    /// distance has at most one extremum, and only one zero that is approached.
    pub(super) fn time_to_plane(&self, until: &Until, duration: f64) -> Option<f64> {
        let row = self.ids.row(until.particle).expect("checked by the plan");
        let particles = &self.particles;
        let normal = until.plane.normal;
        // A force acts from now on; without one, the motion is that from the base.
        let forced = particles.is_forced(row);
        let (p, v) = if forced { self.now(row) } else { (particles.position[row], particles.velocity[row]) };
        let elapsed = if forced { 0.0 } else { (self.clock - particles.base_time.get(row)).hi };
        let a = dot(normal, if forced { self.driving(row) } else { self.acceleration(row) });
        let (f, u) = (until.plane.distance(p), dot(normal, v.map(Into::into)));
        let decay = Decay::of(particles.damping.get(row));
        let form = |t: f64| decay.over(elapsed + t);
        let distance = |t: f64| f + (u * form(t).phi + a * form(t).psi);
        let rate = |t: f64| u * form(t).kept + a * form(t).phi;
        let side = side(distance(0.0), rate(0.0), a)?;
        let away = side * if rate(0.0) == 0.0 { a } else { rate(0.0) } > 0.0;
        let turned = |t: f64| (side * rate(t) > 0.0) != away && rate(t) != 0.0;
        let turn = turned(duration).then(|| first(0.0, duration, turned));
        let (from, to) = if away { (turn?, duration) } else { (0.0, turn.unwrap_or(duration)) };
        let reached = |t: f64| side * distance(t) <= 0.0;
        reached(to).then(|| first(from, to, reached))
    }
}

/// A plane that a particle of a system may reach.
#[derive(Debug)]
pub(super) struct Watch {
    plane: Plane,
    index: usize,
    len: usize,
    /// On which side it is, 1 or -1; none when it lies in the plane and nothing moves it off.
    side: Option<f64>,
}

impl Watch {
    pub(super) fn new<R: Real>(world: &World<R>, until: &Until) -> Self {
        let Until { particle, plane } = *until;
        let index = world.ids.row(particle).expect("checked by the plan");
        let (p, v) = world.now(index);
        let side =
            side(plane.distance(p), dot(plane.normal, v.map(Into::into)), dot(plane.normal, world.driving(index)));
        Self { plane, index, len: world.particle_count(), side }
    }

    /// How far it is from the plane, and how fast it goes away, on its side.
    fn look<R: Real>(&self, side: f64, state: &State<R>) -> (f64, f64) {
        let (p, v) = state.row(self.index, self.len);
        (side * self.plane.distance(p), side * dot(self.plane.normal, v.map(Into::into)))
    }

    /// The length of the step that ends in the plane, if the one of h seconds passes it. `part` takes a step of another
    /// length from the state before.
    pub(super) fn crossing<R: Real>(
        &self,
        h: f64,
        before: &State<R>,
        after: &State<R>,
        mut part: impl FnMut(f64) -> State<R>,
    ) -> Option<f64> {
        let side = self.side?;
        let (start, start_rate) = self.look(side, before);
        let (end, end_rate) = self.look(side, after);
        let mut distance = |h: f64| self.look(side, &part(h)).0;
        let mut to = (h, end);
        if end > 0.0 {
            // It may have touched the plane on the way, where the cubic through both ends turns.
            let turns = start_rate < 0.0 && end_rate > 0.0;
            let turn = h * turns.then(|| turn_of_cubic(start, end, h * start_rate, h * end_rate))?;
            to = (turn, distance(turn));
            if to.1 > 0.0 {
                return None;
            }
        }
        let mut from = (0.0, start);
        // Regula falsi (the Illinois variant), with a bisection whenever it is slow.
        loop {
            let width = to.0 - from.0;
            for bisect in [false, false, true] {
                let secant = from.0 + (to.0 - from.0) * (from.1 / (from.1 - to.1));
                let middle = 0.5 * (from.0 + to.0);
                let next = if bisect || !(secant > from.0 && secant < to.0) { middle } else { secant };
                if next <= from.0 || next >= to.0 || to.1 == 0.0 {
                    return Some(to.0);
                }
                let there = distance(next);
                if there > 0.0 {
                    from = (next, there);
                    to.1 *= 0.5;
                } else {
                    to = (next, there);
                    from.1 *= 0.5;
                }
            }
            if to.0 - from.0 >= width {
                return Some(to.0);
            }
        }
    }
}

impl Plane {
    /// n · x − c.
    fn distance<R: Real>(&self, x: [R; 3]) -> f64 {
        dot(self.normal, x.map(Into::into)) - self.offset
    }
}

/// On which side of the plane something is, or will be: 1 or -1, from its distance, else its rate, else its acceleration.
fn side(distance: f64, rate: f64, acceleration: f64) -> Option<f64> {
    [distance, rate, acceleration].into_iter().find(|x| *x != 0.0 && !x.is_nan()).map(f64::signum)
}

/// The first number between two from which on something holds.
fn first(mut from: f64, mut to: f64, holds: impl Fn(f64) -> bool) -> f64 {
    loop {
        let middle = from + 0.5 * (to - from);
        if middle <= from || middle >= to {
            return to;
        }
        if holds(middle) { to = middle } else { from = middle }
    }
}

/// Where, between 0 and 1, the cubic with these values and slopes at both ends turns from falling to rising.
fn turn_of_cubic(start: f64, end: f64, start_slope: f64, end_slope: f64) -> f64 {
    let slope = |x: f64| {
        let cubic = 3.0 * (2.0 * (start - end) + start_slope + end_slope);
        let square = 2.0 * (3.0 * (end - start) - 2.0 * start_slope - end_slope);
        (cubic * x + square) * x + start_slope
    };
    first(0.0, 1.0, |x| slope(x) > 0.0)
}

fn dot(x: [f64; 3], y: [f64; 3]) -> f64 {
    x[0] * y[0] + x[1] * y[1] + x[2] * y[2]
}
