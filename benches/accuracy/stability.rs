//! Which steps are stable: a particle that damping or drag slows down, over 200 steps of one length.
//!
//! Only the product of rate and step matters, so that one number stands for both.

#![expect(clippy::disallowed_methods, reason = "steps to try and places to draw; no state of a world comes of them")]

use std::error::Error;

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use pointmass::{Advance, Drag, Forces, Integrator, Particle, Settings, World};

use crate::chart::{draw_origin, power_of_ten};
use crate::colours::{BLUE, RED};

/// What slows the particle down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Brake {
    Damping,
    Linear,
    Quadratic,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Behaviour {
    Decays,
    /// It changes its sign, or grows for a while, but ends smaller.
    Oscillates,
    /// It ends larger, or is refused.
    Grows,
}

/// Rate times step, from the least on, in equal ratios.
#[derive(Debug, Clone)]
pub(crate) struct Row {
    pub(crate) brake: Brake,
    pub(crate) integrator: Integrator,
    /// Where a behaviour begins.
    pub(crate) changes: Vec<(f64, Behaviour)>,
}

const LEAST: f64 = 0.1;
const MOST: f64 = 1000.0;
const STEPS: u64 = 200;
/// The share of the velocity at which the particle has come to rest.
const STOPPED: f64 = 1e-6;

impl Brake {
    pub(crate) const ALL: [Self; 3] = [Self::Damping, Self::Linear, Self::Quadratic];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Damping => "damping",
            Self::Linear => "linear drag",
            Self::Quadratic => "quadratic drag",
        }
    }

    /// The product of rate and step.
    const fn product(self) -> &'static str {
        match self {
            Self::Damping => "damping, λ h with λ = −ln d",
            Self::Linear => "linear drag, k₁ h / m",
            Self::Quadratic => "quadratic drag, k₂ |v₀| h / m",
        }
    }
}

impl Behaviour {
    const ALL: [Self; 3] = [Self::Decays, Self::Oscillates, Self::Grows];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Decays => "decays",
            Self::Oscillates => "decays, but changes sign or overshoots",
            Self::Grows => "grows or is refused",
        }
    }

    const fn colour(self) -> RGBColor {
        match self {
            Self::Decays => RGBColor(190, 220, 240),
            Self::Oscillates => BLUE,
            Self::Grows => RED,
        }
    }
}

/// `small` tries few steps.
pub(crate) fn measure(small: bool) -> Vec<Row> {
    let count = if small { 8 } else { 100 };
    let products = |i: u32| LEAST * (MOST / LEAST).powf(f64::from(i) / f64::from(count));
    let between = |low: f64, high: f64| (low * high).sqrt();
    let mut rows = Vec::new();
    for brake in Brake::ALL {
        let serves = |integrator: &Integrator| brake == Brake::Damping || integrator.serves_forces();
        for integrator in Integrator::ALL.into_iter().filter(serves) {
            let of = |product| behaviour(brake, integrator, product);
            let mut last = of(LEAST);
            let mut changes = vec![(LEAST, last)];
            for (mut low, mut high) in (1..=count).map(|i| (products(i - 1), products(i))) {
                let new = of(high);
                if new == last {
                    continue;
                }
                // To a thousandth.
                while high > 1.001 * low {
                    let middle = between(low, high);
                    if of(middle) == last { low = middle } else { high = middle }
                }
                changes.push((high, new));
                last = new;
            }
            rows.push(Row { brake, integrator, changes });
        }
    }
    rows
}

fn behaviour(brake: Brake, integrator: Integrator, step: f64) -> Behaviour {
    let drag = match brake {
        Brake::Damping => None,
        Brake::Linear => Some(Drag { k1: 1.0, k2: 0.0 }),
        Brake::Quadratic => Some(Drag { k1: 0.0, k2: 1.0 }),
    };
    let damping = if brake == Brake::Damping { (-1.0_f64).exp() } else { 1.0 };
    let forces = Forces { drag, gravitation: None };
    let mut world = World::<f64>::new(Settings { integrator, forces, ..Settings::default() }).expect("it serves them");
    let id = world
        .create(Particle { velocity: [1.0, 0.0, 0.0].into(), damping, ..Particle::default() })
        .expect("a valid particle");
    let (mut speed, mut smooth) = (1.0_f64, true);
    for _ in 0..STEPS {
        if world.advance(Advance::by(step)).is_err() {
            return Behaviour::Grows;
        }
        let after = world.particle(id).expect("it is there").velocity.x;
        // What is left, and its sign, is within the tolerance of an adaptive integrator.
        if after.abs() < STOPPED {
            return if smooth { Behaviour::Decays } else { Behaviour::Oscillates };
        }
        smooth &= after.abs() <= speed.abs() && after * speed >= 0.0;
        speed = after;
    }
    match (smooth, speed.abs() < 1.0) {
        (true, _) => Behaviour::Decays,
        (false, true) => Behaviour::Oscillates,
        (false, false) => Behaviour::Grows,
    }
}

pub(crate) fn svg(rows: &[Row]) -> Result<String, Box<dyn Error>> {
    const LEFT: i32 = 306;
    const RIGHT: i32 = 774;
    const LETTERS: u32 = 26;
    let ink = RGBColor(60, 60, 60);
    let letters = || ("sans-serif", LETTERS).into_font().color(&ink);
    let height = 200 + 38 * i32::try_from(rows.len())? + 3 * 120 + 70;
    let place = |product: f64| {
        let along = (product / LEAST).log10() / (MOST / LEAST).log10() * f64::from(RIGHT - LEFT);
        #[expect(clippy::cast_possible_truncation, reason = "pixels of a panel")]
        let pixels = along.round() as i32;
        LEFT + pixels
    };
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, (800, u32::try_from(height)?)).into_drawing_area();
        root.fill(&WHITE)?;
        let bold = |size: u32| ("sans-serif", size).into_font().style(FontStyle::Bold).color(&ink);
        root.draw_text("Which steps are stable: 200 steps", &bold(34), (20, 16))?;
        for (i, behaviour) in Behaviour::ALL.into_iter().enumerate() {
            let y = 66 + 38 * i32::try_from(i)?;
            root.draw(&Rectangle::new([(20, y), (64, y + 26)], behaviour.colour().filled()))?;
            root.draw_text(behaviour.name(), &letters(), (76, y))?;
        }
        let mut y = 200;
        for brake in Brake::ALL {
            root.draw_text(brake.product(), &bold(LETTERS + 2), (20, y))?;
            y += 42;
            let top = y;
            for row in rows.iter().filter(|row| row.brake == brake) {
                let right = letters().pos(Pos::new(HPos::Right, VPos::Center));
                root.draw_text(row.integrator.name(), &right, (LEFT - 10, y + 16))?;
                for (i, (from, behaviour)) in row.changes.iter().enumerate() {
                    let end = row.changes.get(i + 1).map_or(MOST, |next| next.0);
                    let (from_x, to_x) = (place(*from), place(end));
                    root.draw(&Rectangle::new([(from_x, y), (to_x, y + 32)], behaviour.colour().filled()))?;
                    // Where it begins, if there is room to say so.
                    if i > 0 && to_x - from_x > 80 {
                        let white =
                            ("sans-serif", LETTERS).into_font().color(&WHITE).pos(Pos::new(HPos::Left, VPos::Center));
                        let dark = letters().pos(Pos::new(HPos::Left, VPos::Center));
                        let style = if *behaviour == Behaviour::Decays { &dark } else { &white };
                        root.draw_text(&threshold(*from), style, (from_x + 6, y + 16))?;
                    }
                }
                y += 38;
            }
            for power in -1..=3 {
                let x = place(10_f64.powi(power));
                root.draw(&PathElement::new([(x, top), (x, y)], WHITE.stroke_width(1)))?;
                root.draw_text(&label(power), &letters().pos(Pos::new(HPos::Center, VPos::Top)), (x, y + 2))?;
            }
            y += 78;
        }
        draw_origin(&root, height - 62)?;
        root.present()?;
    }
    Ok(text)
}

fn label(power: i32) -> String {
    if power == -1 { "0.1".to_owned() } else { power_of_ten(power) }
}

pub(crate) fn threshold(product: f64) -> String {
    crate::table::digits(product)
}
