//! A digest of everything that determines the future of a world, and of nothing else.
//!
//! It is the SHA-256 of words of eight bytes, little-endian:
//!
//! ```text
//! "pmworld1"       the name of this form; another form has another name
//! precision        1 single, 2 double
//! integrator       1 exact, 2 newton_euler, 3 newton_euler_quadratic, 4 semi_implicit_euler, 5 velocity_verlet, 6 rk4,
//!                  7 dop853
//! damping law      1 per_second, 2 per_step
//! max_step         seconds; 0 when there is none
//! gravity          x, y, z
//! clock            upper word, lower word
//! next id
//! then of each particle, row by row:
//!   id
//!   position       x, y, z at the base time
//!   velocity       x, y, z at the base time
//!   base time      upper word, lower word
//!   acceleration   1 and x, y, z of its own; 0 and three zeros when it has none
//!   damping
//!   inverse mass
//!   force          x, y, z
//! then what is not as it is by default, each part after its name, which is larger than any id:
//!   "pm drag "     k1, k2 of the world
//!   "pm grav "     constant, softening
//!   "pm toler"     absolute, relative
//!   "pm compe"     of each particle what rounding took from x, y, z of its position and of its velocity
//!   "pm drags"     of each particle 1, k1, k2; or three zeros when it has no drag of its own
//!   "pm gmass"     of each particle 1 and its gravitational mass; or two zeros when it has none
//! ```
//!
//! A number is the bits of a double, which holds a single as well. Only position and velocity tell -0 from 0; wherever
//! else it came to be, nothing depends on it.

use std::fmt::{self, Display};

use sha2::{Digest as _, Sha256};

use crate::command::Tolerance;
use crate::double_double::DoubleDouble;
use crate::forces::{Drag, Gravitation};
use crate::integrator::{DampingLaw, Integrator};
use crate::particles::zero;
use crate::real::{Precision, Real};
use crate::world::World;

/// What [`World::digest`] returns; displayed as 64 hexadecimal digits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Digest([u8; 32]);

impl Digest {
    /// The bytes of the SHA-256.
    #[must_use]
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// Words between two calls of the hasher, which is slow at short pieces; they stay in the first cache.
const WORDS_AT_ONCE: usize = 2048;
const WORDS_OF_A_PARTICLE: usize = 18;

impl<R: Real> World<R> {
    /// Equal for two worlds if and only if everything that determines their future is: the same commands then give the
    /// same bits in both. How they came to be does not matter, nor revision, step count and limits. Needs the feature
    /// `digest`.
    ///
    /// ```
    /// use pointmass::{Particle, World};
    /// let (mut one, mut other) = (World::<f64>::default(), World::<f64>::default());
    /// assert_eq!(one.digest(), other.digest());
    /// one.create(Particle::default())?;
    /// assert_ne!(one.digest(), other.digest());
    /// other.create(Particle::default())?;
    /// assert_eq!(one.digest().to_string(), other.digest().to_string());
    /// # Ok::<(), pointmass::Error>(())
    /// ```
    #[must_use]
    pub fn digest(&self) -> Digest {
        R::world_digest(self)
    }

    pub(super) fn hash(&self) -> Digest {
        let mut hasher = Sha256::new();
        let mut words = Vec::with_capacity(WORDS_AT_ONCE);
        self.push_settings(&mut words);
        for row in 0..self.particles.len() {
            if words.len() + WORDS_OF_A_PARTICLE > WORDS_AT_ONCE {
                hasher.update(words.as_flattened());
                words.clear();
            }
            self.push_particle(row, &mut words);
        }
        self.push_parts(&mut words);
        hasher.update(words.as_flattened());
        Digest(hasher.finalize().into())
    }

    fn push_settings(&self, words: &mut Vec<[u8; 8]>) {
        let settings = &self.settings;
        words.push(*b"pmworld1");
        words.push(match R::PRECISION {
            Precision::Single => whole(1),
            Precision::Double => whole(2),
        });
        words.push(match settings.integrator {
            Integrator::Exact => whole(1),
            Integrator::NewtonEuler => whole(2),
            Integrator::NewtonEulerQuadratic => whole(3),
            Integrator::SemiImplicitEuler => whole(4),
            Integrator::VelocityVerlet => whole(5),
            Integrator::Rk4 => whole(6),
            Integrator::Dop853 => whole(7),
        });
        words.push(match settings.damping_law {
            DampingLaw::PerSecond => whole(1),
            DampingLaw::PerStep => whole(2),
        });
        words.push(number(settings.max_step.unwrap_or_default()));
        words.extend(self.gravity().map(number));
        words.extend(time(self.clock));
        words.push(whole(self.ids.next()));
    }

    /// What is not as it is by default.
    fn push_parts(&self, words: &mut Vec<[u8; 8]>) {
        let (settings, particles) = (&self.settings, &self.particles);
        if let Some(Drag { k1, k2 }) = settings.forces.drag {
            words.extend([*b"pm drag ", number(k1), number(k2)]);
        }
        if let Some(Gravitation { constant, softening }) = settings.forces.gravitation {
            words.extend([*b"pm grav ", number(constant), number(softening)]);
        }
        if settings.tolerance != Tolerance::default() {
            let Tolerance { absolute, relative } = settings.tolerance;
            words.extend([*b"pm toler", number(absolute), number(relative)]);
        }
        if settings.compensated {
            let residual = &particles.residual;
            words.push(*b"pm compe");
            for (position, velocity) in residual.position.iter().zip(&residual.velocity) {
                words.extend(position.map(number).into_iter().chain(velocity.map(number)));
            }
        }
        let rows = 0..particles.len();
        if rows.clone().any(|row| particles.drag.get(row).is_some()) {
            words.push(*b"pm drags");
            words.extend(rows.clone().flat_map(|row| match particles.drag.get(row) {
                Some(Drag { k1, k2 }) => [whole(1), number(k1), number(k2)],
                None => [whole(0); 3],
            }));
        }
        if rows.clone().any(|row| particles.gravitational_mass.get(row).is_some()) {
            words.push(*b"pm gmass");
            words.extend(rows.flat_map(|row| match particles.gravitational_mass.get(row) {
                Some(mass) => [whole(1), number(mass)],
                None => [whole(0); 2],
            }));
        }
    }

    fn push_particle(&self, row: usize, words: &mut Vec<[u8; 8]>) {
        let particles = &self.particles;
        words.push(whole(self.ids.id(row).0));
        words.extend(particles.position[row].map(signed));
        words.extend(particles.velocity[row].map(signed));
        words.extend(time(particles.base_time.get(row)));
        let own = particles.own(row);
        words.push(whole(own.is_some().into()));
        words.extend(own.unwrap_or(zero()).map(number));
        words.extend([number(particles.damping.get(row)), number(particles.inverse_mass.get(row))]);
        words.extend(particles.force.get(row).map(number));
    }
}

fn whole(x: u64) -> [u8; 8] {
    x.to_le_bytes()
}

/// A number with the sign of its zero.
fn signed(x: impl Into<f64>) -> [u8; 8] {
    x.into().to_le_bytes()
}

/// A number whose zero has no sign.
fn number(x: impl Into<f64>) -> [u8; 8] {
    (x.into() + 0.0).to_le_bytes()
}

fn time(t: DoubleDouble) -> [[u8; 8]; 2] {
    [number(t.hi), number(t.lo)]
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use sha2::{Digest as _, Sha256};

    use super::WORDS_AT_ONCE;
    use crate::column::Column;
    use crate::command::{Command, Configure, Mass, NewParticles, Particle, Settings};
    use crate::double_double::DoubleDouble;
    use crate::ids::ParticleId;
    use crate::world::World;

    /// The form that the head of this file tells, written down by hand.
    #[test]
    fn is_the_sha_256_of_the_form_that_is_described() {
        let settings = Settings { gravity: Vec3::new(0.0, -2.0, 0.5), ..Settings::default() };
        let mut world = World::<f32>::new(settings).expect("valid");
        world.advance(3.0).expect("an empty world");
        let plain = Particle { position: Vec3::new(1.0, -0.0, 0.0), ..Particle::default() };
        world.create(plain).expect("valid");
        world.create(plain).expect("valid");
        world.advance(0.25).expect("finite");
        let acceleration = Some(Vec3::new(7.0, 8.0, 9.0));
        let damped = Particle { acceleration, damping: 0.5, mass: Mass::Inverse(4.0), ..plain };
        let id = world.create(Particle { velocity: Vec3::new(-0.0, 5.0, 6.0), ..damped }).expect("valid");
        world.add_force(id, Vec3::new(10.0, 11.0, 12.0)).expect("finite");
        world.remove(ParticleId(0)).expect("it is there");
        let change = Configure { max_step: Some(Some(0.125)), ..Configure::default() };
        world.apply(&Command::Configure(change)).expect("valid");

        let f = f64::to_bits;
        let zero = 0;
        let head = [1, 1, 1, f(0.125), zero, f(-2.0), f(0.5), f(3.25), zero, 3];
        let [one, minus] = [f(1.0), f(-0.0)];
        let p = [one, minus, zero];
        let two = [minus, f(5.0), f(6.0), f(3.25), zero, 1, f(7.0), f(8.0), f(9.0), f(0.5), f(4.0)];
        let ten = [f(10.0), f(11.0), f(12.0)];
        let first = [zero, zero, zero, f(3.0), zero, 0, zero, zero, zero, one, one, zero, zero, zero];
        let rows = [&[2][..], &p, &two, &ten, &[1], &p, &first].concat();
        let words = head.into_iter().chain(rows).flat_map(u64::to_le_bytes);
        let bytes: Vec<u8> = b"pmworld1".iter().copied().chain(words).collect();
        assert_eq!(world.digest().as_bytes()[..], Sha256::digest(bytes)[..]);
    }

    #[test]
    fn zeros_whose_sign_does_not_matter_are_one() {
        let of = |zero: f64| {
            let mut world = World::<f64> { clock: DoubleDouble::new(zero, zero), ..World::default() };
            world.settings.gravity = [zero; 3].into();
            world.create(Particle::default()).expect("valid");
            world.particles.has_own_acceleration = Column::Uniform(true);
            world.particles.own_acceleration = Column::Uniform([zero; 3]);
            world.particles.damping = Column::Uniform(zero);
            world.particles.inverse_mass = Column::Uniform(zero);
            world.digest()
        };
        assert_eq!(of(-0.0), of(0.0));
    }

    /// Also where the hasher is called several times.
    #[test]
    fn tells_every_row_of_a_large_world() {
        let mut world = World::<f64>::default();
        let count = WORDS_AT_ONCE / 8;
        world.apply(&Command::Create(NewParticles { count, ..NewParticles::default() })).expect("valid");
        let before = world.digest();
        for row in 0..count {
            world.particles.velocity[row][2] = -0.0;
            assert_ne!(world.digest(), before, "{row}");
            world.particles.velocity[row][2] = 0.0;
        }
        assert_eq!(world.digest(), before);
    }
}
