//! `velocity_verlet`: half a kick with gravitation, the exact flow of everything else, half a kick.
//!
//! The flow is the closed form of constant acceleration and damping, to which the linear part of drag belongs. With
//! quadratic drag it is split once more: half the flow of damping and drag, the kick of the acceleration, the other half.
//! The flow of v' = −(λ + κ₁) v − κ₂ |v| v keeps its direction, so that it has a closed form: with E and φ of the rate
//! λ + κ₁ and q = κ₂ |v| φ,
//!
//! ```text
//! v(t) = v₀ E / (1 + q)        p(t) = p₀ + v₀ φ ln(1 + q) / q
//! ```

use crate::closed_form::{ClosedForm, Decay};
use crate::real::Real;
use crate::system::{Field, Laws, State, add_compensated, norm, stride};

#[derive(Debug)]
pub(super) struct Verlet<R> {
    /// λ + κ₁ of each particle.
    decays: Vec<Decay>,
    /// κ₂ of each; empty when it is 0 for all.
    quadratic: Vec<f64>,
    /// a + w F.
    acceleration: Vec<f64>,
    /// The length of the steps that the forms are for.
    of: Option<f64>,
    forms: Forms,
    /// Those over half a step, where there is quadratic drag.
    halves: Vec<ClosedForm>,
    /// The attraction at the end of the step before, which is that at the start of the next.
    attraction: Vec<R>,
    knows_attraction: bool,
}

/// E, φ, ψ and 1 − E of each particle, as columns.
#[derive(Debug, Default)]
struct Forms {
    kept: Vec<f64>,
    phi: Vec<f64>,
    psi: Vec<f64>,
    lost: Vec<f64>,
}

impl<R: Real> Verlet<R> {
    pub(super) fn new(laws: &Laws<R>) -> Self {
        let mut last: Option<((R, R), Decay)> = None;
        let k1 = |i: usize| laws.drag.get(i).map_or(R::ZERO, |k| k[0]);
        let mut decay = |(i, damping): (usize, &R)| match last {
            Some((of, decay)) if of == (*damping, k1(i)) => decay,
            Some(_) | None => {
                let decay = Decay::of(*damping).faster_by(k1(i).into());
                last = Some(((*damping, k1(i)), decay));
                decay
            }
        };
        let decays = laws.damping.iter().enumerate().map(&mut decay).collect();
        let quadratic: Vec<f64> = laws.drag.iter().map(|k| k[1].into()).collect();
        let stride = stride::<R>(laws.driving.len());
        let mut accelerations = vec![0.0; 3 * stride];
        for (i, a) in laws.driving.iter().enumerate() {
            (0..3).for_each(|axis| accelerations[axis * stride + i] = a[axis]);
        }
        let has_quadratic = quadratic.iter().any(|k| *k > 0.0);
        Self {
            decays,
            acceleration: accelerations,
            quadratic: if has_quadratic { quadratic } else { Vec::new() },
            of: None,
            forms: Forms::default(),
            halves: Vec::new(),
            attraction: Vec::new(),
            knows_attraction: false,
        }
    }

    pub(super) fn forget(&mut self) {
        self.knows_attraction = false;
    }

    pub(super) fn step(&mut self, field: &mut Field<'_, R>, h: f64, state: &mut State<R>) {
        self.prepare(h);
        let half = R::nearest(h) * R::HALF;
        if field.attraction.is_some() {
            if !self.knows_attraction {
                self.attraction.resize(state.p.len(), R::ZERO);
                field.attract(&state.p, &mut self.attraction);
            }
            kick(&self.attraction, half, state);
        }
        self.flow_split(field, h, state);
        if state.compensated() {
            self.flow_compensated(field, state);
        } else {
            self.flow(field, state);
        }
        if field.attraction.is_some() {
            field.attract(&state.p, &mut self.attraction);
            self.knows_attraction = true;
            kick(&self.attraction, half, state);
        }
    }

    /// E, φ and ψ over a step, unless they are known.
    fn prepare(&mut self, h: f64) {
        if self.of == Some(h) {
            return;
        }
        self.of = Some(h);
        let stride = stride::<R>(self.decays.len());
        let [kept, phi, psi, lost] = [(); 4].map(|()| vec![0.0; stride]);
        self.forms = Forms { kept, phi, psi, lost };
        self.halves.clear();
        let mut last: Option<(Decay, ClosedForm, ClosedForm)> = None;
        for (i, decay) in self.decays.iter().enumerate() {
            let (form, half) = match last {
                Some((of, form, half)) if of == *decay => (form, half),
                Some(_) | None => (decay.over(h), decay.over(0.5 * h)),
            };
            last = Some((*decay, form, half));
            // Those with quadratic drag have a flow of their own, and this one leaves them as they are.
            let is_split = self.quadratic.get(i).is_some_and(|k2| *k2 > 0.0);
            let form = if is_split { ClosedForm::STILL } else { form };
            let rate = if is_split { 0.0 } else { decay.rate() };
            self.forms.kept[i] = form.kept;
            self.forms.phi[i] = form.phi;
            self.forms.psi[i] = form.psi;
            self.forms.lost[i] = if rate.is_finite() { rate * form.phi } else { 1.0 };
            if !self.quadratic.is_empty() {
                self.halves.push(half);
            }
        }
    }

    /// The whole step of particles with quadratic drag: half the flow of damping and drag, the kick, the other half.
    fn flow_split(&self, field: &Field<'_, R>, h: f64, state: &mut State<R>) {
        for (row, k2) in self.quadratic.iter().enumerate().filter(|(_, k2)| **k2 > 0.0) {
            let at = [0, 1, 2].map(|axis| axis * field.stride + row);
            let before = at.map(|i| state.v[i].into());
            let (first, v) = slow_down(self.halves[row], *k2, before);
            let kicked = std::array::from_fn(|axis| v[axis] + self.acceleration[at[axis]] * h);
            let (second, after) = slow_down(self.halves[row], *k2, kicked);
            for (axis, i) in at.into_iter().enumerate() {
                let way = first[axis] + second[axis];
                if state.compensated() {
                    let gain = R::nearest(after[axis] - before[axis]);
                    add_compensated(&mut state.p[i], &mut state.lost_p[i], R::nearest(way));
                    add_compensated(&mut state.v[i], &mut state.lost_v[i], gain);
                } else {
                    state.p[i] = R::nearest(state.p[i].into() + way);
                    state.v[i] = R::nearest(after[axis]);
                }
            }
        }
    }

    /// v ← v E + A φ, p ← p + (v φ + A ψ), rounded once.
    fn flow(&self, field: &Field<'_, R>, state: &mut State<R>) {
        let stride = field.stride.max(1);
        let Forms { kept, phi, psi, .. } = &self.forms;
        let columns = state.p.chunks_exact_mut(stride).zip(state.v.chunks_exact_mut(stride));
        for ((p, v), a) in columns.zip(self.acceleration.chunks_exact(stride)) {
            for (i, ((p, v), a)) in p.iter_mut().zip(v).zip(a).enumerate() {
                let speed: f64 = (*v).into();
                *p = R::nearest((*p).into() + (speed * phi[i] + a * psi[i]));
                *v = R::nearest(speed * kept[i] + a * phi[i]);
            }
        }
    }

    /// The same in compensated sums.
    fn flow_compensated(&self, field: &Field<'_, R>, state: &mut State<R>) {
        let stride = field.stride;
        let Forms { phi, psi, lost, .. } = &self.forms;
        for i in 0..state.p.len() {
            let row = i % stride;
            let (speed, more): (f64, f64) = (state.v[i].into(), state.lost_v[i].into());
            let a = self.acceleration[i];
            let drift = speed * phi[row] + (more * phi[row] + a * psi[row]);
            let gain = (a * phi[row] - speed * lost[row]) - more * lost[row];
            add_compensated(&mut state.p[i], &mut state.lost_p[i], R::nearest(drift));
            add_compensated(&mut state.v[i], &mut state.lost_v[i], R::nearest(gain));
        }
    }
}

/// The way made, and the velocity left, under damping and drag alone.
fn slow_down(form: ClosedForm, k2: f64, v: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let q = k2 * form.phi * norm(v);
    // ln(1 + q) / q is 1 for q = 0.
    let shorter = if q > 0.0 { pxfm::f_log1p(q) / q } else { 1.0 };
    let (way, kept) = (form.phi * shorter, form.kept / (1.0 + q));
    (v.map(|v| v * way), v.map(|v| v * kept))
}

/// v ← v + a h.
fn kick<R: Real>(a: &[R], h: R, state: &mut State<R>) {
    if state.compensated() {
        for ((v, lost), a) in state.v.iter_mut().zip(&mut state.lost_v).zip(a) {
            add_compensated(v, lost, *a * h);
        }
    } else {
        state.v.iter_mut().zip(a).for_each(|(v, a)| *v = *v + *a * h);
    }
}
