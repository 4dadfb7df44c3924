//! The picture at the top of README.md: the same throws in two worlds, without air and with it.

use pointmass::{
    Advance, DVec3, Drag, Forces, Gravitation, Integrator, Particle, ParticleId, Settings, States, World, gravity,
};

use crate::svg::{Anchor, Colour, Picture, Stroke};

const BALLS: u32 = 31;
const SPEED: f64 = 25.0;
/// Between two moments that are looked at.
const STEP: f64 = 1.0 / 32.0;
const STEPS: u32 = 160;
/// How many of them make half a second.
const RING: usize = 16;
/// Pixels of a metre.
const SCALE: f64 = 6.8;

/// What a throw leaves behind: places of all balls, one list for each moment.
fn fly(drag: Option<Drag<f64>>) -> Result<Vec<Vec<[f64; 3]>>, pointmass::Error> {
    let integrator = if drag.is_some() { Integrator::Dop853 } else { Integrator::Exact };
    let gravity = gravity::preset::<f64>("textbook").expect("it has a name");
    let forces = Forces { drag, gravitation: None::<Gravitation<f64>> };
    let mut world = World::<f64>::new(Settings { gravity, integrator, forces, ..Settings::default() })?;
    for i in 0..BALLS {
        // Half of the angle by its tangent: sine and cosine are quotients then, the same on every machine.
        let t = f64::from(i + 1) / f64::from(BALLS + 1);
        let velocity = DVec3::new(1.0 - t * t, 2.0 * t, 0.0) * (SPEED / (1.0 + t * t));
        world.create(Particle { velocity, ..Particle::default() })?;
    }
    let mut moments = Vec::new();
    for _ in 0..=STEPS {
        let mut states = States::default();
        world.read(ParticleId(0), usize::MAX, &mut states);
        moments.push(states.position);
        world.advance(Advance::by(STEP))?;
    }
    Ok(moments)
}

pub(crate) fn draw() -> Result<String, pointmass::Error> {
    let mut picture = Picture::new(
        "The same throw, without air and with it",
        "Two worlds of pointmass, 31 balls each, thrown at 25 m/s: left under gravity alone, right with quadratic drag as well. A ring is where they are, every half second.",
    );
    let ground = picture.head() + 33.0 * SCALE;
    let origin = 24.0 + 63.0 * SCALE;
    let sides = [(fly(None)?, -1.0, Colour::Blue), (fly(Some(Drag { k1: 0.0, k2: 0.02 }))?, 1.0, Colour::Orange)];
    for (moments, side, colour) in sides {
        let place = |[x, y, _]: [f64; 3]| (origin + side * x * SCALE, ground - y * SCALE);
        for ball in 0..BALLS as usize {
            let flight = moments.iter().map(|moment| moment[ball]).take_while(|at| at[1] >= 0.0);
            picture.path(&flight.map(place).collect::<Vec<_>>(), colour, Stroke::Thin);
        }
        for moment in moments.iter().step_by(RING).skip(1) {
            let flying: Vec<(f64, f64)> = moment.iter().filter(|at| at[1] >= 0.0).map(|at| place(*at)).collect();
            if flying.is_empty() {
                break;
            }
            picture.path(&flying, colour, Stroke::Medium);
            for at in flying {
                picture.dot(at, 2.4, colour);
            }
        }
    }
    picture.path(&[(16.0, ground), (784.0, ground)], Colour::Ink, Stroke::Full);
    for metres in [-60, -40, -20, 0, 20, 40] {
        let x = origin + f64::from(metres) * SCALE;
        picture.text((x, ground + 28.0), Anchor::Middle, &format!("{} m", i32::abs(metres)));
    }
    Ok(picture.finish(ground + 44.0))
}
