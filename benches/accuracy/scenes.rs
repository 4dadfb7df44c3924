//! The scenes of `tests/reference/scenes.txt` as worlds, and how far a world is from where they end.

use pointmass::{
    Command, Drag, Forces, Gravitation, Mass, Particle, ParticleId, Precision, Real, Settings, States, World,
};

const TEXT: &str = include_str!("../../tests/reference/scenes.txt");

/// A scene in one precision. Its numbers are exactly representable in that precision.
#[derive(Debug, Clone)]
pub(crate) struct Scene {
    pub(crate) name: String,
    pub(crate) precision: Precision,
    constant: f64,
    acceleration: [f64; 3],
    pub(crate) damping: f64,
    drag: [f64; 2],
    pub(crate) bodies: Vec<Body>,
    /// In ascending order of time.
    pub(crate) ends: Vec<End>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Body {
    pub(crate) mass: f64,
    pub(crate) gravitational_mass: f64,
    position: [f64; 3],
    velocity: [f64; 3],
}

/// Where all bodies are at a time, from a solution to 36 digits.
#[derive(Debug, Clone)]
pub(crate) struct End {
    pub(crate) time: f64,
    /// The nearest doubles.
    pub(crate) position: Vec<[f64; 3]>,
    /// How much more the truth is: without it, no error below an ulp could be told.
    beyond: Vec<[f64; 3]>,
}

/// All scenes in both precisions, in the order of the file.
pub(crate) fn all() -> Vec<Scene> {
    let mut scenes: Vec<Scene> = Vec::new();
    for line in TEXT.lines().filter(|line| !line.starts_with('#')) {
        let mut words = line.split_whitespace();
        let key = words.next().expect("no line is empty");
        let words: Vec<&str> = words.collect();
        if key == "scene" {
            let precision = Precision::ALL.into_iter().find(|precision| precision.name() == words[1]);
            scenes.push(Scene {
                name: words[0].to_owned(),
                precision: precision.expect("single or double"),
                constant: 0.0,
                acceleration: [0.0; 3],
                damping: 1.0,
                drag: [0.0; 2],
                bodies: Vec::new(),
                ends: Vec::new(),
            });
            continue;
        }
        let scene = scenes.last_mut().expect("a scene begins with its name");
        let doubles: Vec<f64> = words.iter().map(|word| word.parse().expect("a number")).collect();
        let numbers: Vec<f64> = match scene.precision {
            Precision::Double => doubles.clone(),
            // Rounding a decimal to double first could give another single.
            Precision::Single => words.iter().map(|word| word.parse::<f32>().expect("a number").into()).collect(),
        };
        let three = |from: &[f64]| [from[0], from[1], from[2]];
        match key {
            "constant" => scene.constant = numbers[0],
            "acceleration" => scene.acceleration = three(&numbers),
            "damping" => scene.damping = numbers[0],
            "drag" => scene.drag = [numbers[0], numbers[1]],
            "particle" => scene.bodies.push(Body {
                mass: numbers[0],
                gravitational_mass: numbers[1],
                position: three(&numbers[2..5]),
                velocity: three(&numbers[5..8]),
            }),
            "at" => scene.ends.push(End { time: doubles[0], position: Vec::new(), beyond: Vec::new() }),
            "end" => {
                let end = scene.ends.last_mut().expect("an end has a time");
                end.position.push(three(&doubles));
                end.beyond.push([0, 1, 2].map(|axis| beyond(words[axis], doubles[axis])));
            }
            _ => panic!("scenes.txt has a line of another kind: {line}"),
        }
    }
    scenes
}

/// A decimal of 36 digits less the double nearest to it.
#[expect(clippy::cast_precision_loss, reason = "a difference, of which three digits are plenty")]
fn beyond(decimal: &str, nearest: f64) -> f64 {
    let digits = |text: &str| -> Option<(i128, i32)> {
        let (mantissa, exponent) = text.split_once('e')?;
        Some((mantissa.replace('.', "").parse().ok()?, exponent.parse().ok()?))
    };
    let (decimal, nearest) = (digits(decimal), digits(&format!("{nearest:.35e}")));
    let (Some((decimal, exponent)), Some((nearest, same))) = (decimal, nearest) else { return 0.0 };
    // Otherwise a power of ten lies between them: then the nearest double is as good.
    if exponent != same {
        return 0.0;
    }
    let unit: f64 = format!("1e{}", exponent - 35).parse().expect("a power of ten");
    (decimal - nearest) as f64 * unit
}

impl Scene {
    /// Whether something depends on position or velocity, beside damping.
    pub(crate) fn has_forces(&self) -> bool {
        self.constant > 0.0 || self.drag != [0.0; 2]
    }

    /// A world with so many copies of every body, in their order. The integrator and what belongs to it are given.
    pub(crate) fn world<R: Real>(&self, settings: Settings<R>, copies: usize) -> World<R> {
        let [k1, k2] = self.drag.map(R::nearest);
        let drag = (self.drag != [0.0; 2]).then_some(Drag { k1, k2 });
        let constant = R::nearest(self.constant);
        let gravitation = (self.constant > 0.0).then_some(Gravitation { constant, softening: R::ZERO });
        let vector = |x: [f64; 3]| R::Vec3::from(x.map(R::nearest));
        let forces = Forces { drag, gravitation };
        let settings = Settings { gravity: vector(self.acceleration), forces, ..settings };
        let mut world = World::new(settings).expect("only integrators that serve the scene are asked for");
        let particle = |body: &Body| Particle {
            position: vector(body.position),
            velocity: vector(body.velocity),
            damping: R::nearest(self.damping),
            mass: Mass::Mass(R::nearest(body.mass)),
            gravitational_mass: Some(R::nearest(body.gravitational_mass)),
            ..Particle::default()
        };
        let particles = self.bodies.iter().flat_map(|body| std::iter::repeat_n(particle(body), copies));
        world.apply(&Command::Create(particles.collect())).expect("the scenes are valid");
        world
    }

    /// Energy as the scene has it: in units of its own, of the bodies that attract.
    pub(crate) fn energy(&self, states: &States<f64>) -> f64 {
        // Every term is kept with what rounding takes from the sum, so that drifts of 1e-15 are seen.
        let mut sum = Sum::default();
        let attracting = |i: &usize| self.bodies[*i].gravitational_mass > 0.0;
        for i in (0..self.bodies.len()).filter(attracting) {
            let mass = self.bodies[i].mass;
            states.velocity[i].iter().for_each(|v| sum.add(0.5 * mass * v * v));
            for j in (0..i).filter(attracting) {
                let distance = distance(states.position[i], states.position[j]);
                sum.add(-self.constant * mass * self.bodies[j].mass / distance);
            }
        }
        sum.value + sum.lost
    }
}

#[derive(Debug, Default)]
struct Sum {
    value: f64,
    lost: f64,
}

impl Sum {
    fn add(&mut self, x: f64) {
        let new = self.value + x;
        let rounded = new - self.value;
        self.lost += (self.value - (new - rounded)) + (x - rounded);
        self.value = new;
    }
}

impl End {
    /// The largest distance of a particle from where it should be. There may be several copies of each.
    pub(crate) fn error<R: Real>(&self, states: &States<R>) -> f64 {
        let copies = states.position.len() / self.position.len();
        let error = |(i, place): (usize, &[R; 3])| {
            let (nearest, beyond) = (self.position[i / copies], self.beyond[i / copies]);
            length(std::array::from_fn(|k| (place[k].into() - nearest[k]) - beyond[k]))
        };
        let errors = states.position.iter().enumerate().map(error);
        // A maximum that keeps what is not a number.
        errors.fold(0.0, |most, error| if error > most || error.is_nan() { error } else { most })
    }

    /// The largest distance of a body from the origin.
    pub(crate) fn extent(&self) -> f64 {
        self.position.iter().map(|p| distance(*p, [0.0; 3])).fold(0.0, f64::max)
    }
}

/// Everything about the particles of a world, into buffers that are kept.
pub(crate) fn read_all<R: Real>(world: &World<R>, into: &mut States<R>) {
    world.read(ParticleId(0), usize::MAX, into);
}

pub(crate) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    length(std::array::from_fn(|k| a[k] - b[k]))
}

/// Also of a vector so short that its square vanishes.
fn length([x, y, z]: [f64; 3]) -> f64 {
    let most = x.abs().max(y.abs()).max(z.abs());
    if most == 0.0 {
        return x + y + z;
    }
    most * ((x / most) * (x / most) + (y / most) * (y / most) + (z / most) * (z / most)).sqrt()
}
