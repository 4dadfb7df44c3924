//! Snapshots: everything that determines the future of a world, written down and read back to the bit.
//!
//! The form is little-endian. Words have eight bytes: whole numbers, or the bits of a double. A real has four bytes in
//! a world of single precision and eight in one of double, a vector is three of them.
//!
//! ```text
//! "pmsnap\r\n"     8 bytes
//! version          a word: 1; another form has another one
//! precision        a word: 1 single, 2 double
//! particles        a word: how many, called n below
//! next id          a word
//! step count       a word
//! clock            two words: upper, lower
//! integrator       a word: 1 exact, 2 newton_euler, 3 newton_euler_quadratic, 4 semi_implicit_euler,
//!                  5 velocity_verlet, 6 rk4, 7 dop853
//! damping law      a word: 1 per_second, 2 per_step
//! compensated      a word: 1, or 0
//! max_step         a word: seconds; 0 when there is none
//! gravity          three words
//! drag             three words: 1, k1, k2; or three zeros
//! gravitation      three words: 1, constant, softening; or three zeros
//! tolerance        two words: absolute, relative
//! then of the particles, row by row:
//!   ids            n words, where particles were removed: where the next id is not n
//!   position       n vectors, at the base time
//!   velocity       n vectors, at the base time
//!   residuals      n vectors of the positions and n of the velocities, where sums are compensated
//!   base times     a word: how many different ones; each of them as two words, in the order of the first particle
//!                  that has it; and where they are more than one, n times four bytes: which of them
//!   has own acceleration, own acceleration, damping, inverse mass, drag, gravitational mass
//!                  each a word, 0: one value for all of them, 1: n values; and the value, or the values: a byte,
//!                  0 or 1; a vector; a real; a real; a byte, 1 or 0, and two reals; a byte, 1 or 0, and a real
//!   forces         a word, 0: on some; 1: on any. On some: a word, how many, and of each a word, its id, and a
//!                  vector. On any: a column of vectors, as above
//! checksum         four bytes: the CRC-32 (that of zip and PNG) of all before
//! ```
//!
//! Columns are written as they are held, so that a world with one damping for all stays one, and is as small. What is
//! derived is not written: bounds, who rests, factors, where an id is.
//!
//! What is read is not believed: memory is taken for what has arrived, not for what is announced, and each number is
//! checked by the rules of the commands.

use std::io::{self, Write};

use crc32fast::Hasher;

use crate::accumulators::{Accumulators, Acting};
use crate::base_times::BaseTimes;
use crate::column::Column;
use crate::command::Settings;
use crate::error::Error;
use crate::forces::{Drag, Gravitation};
use crate::ids::Ids;
use crate::integrator::{DampingLaw, Integrator};
use crate::real::{Precision, Real};
use crate::world::World;

pub(super) const MAGIC: [u8; 8] = *b"pmsnap\r\n";
pub(super) const VERSION: u64 = 1;

/// Words before the first particle, without the magic bytes.
pub(super) const HEAD: usize = 22;

/// Bytes that are written or read at once; they stay in the second cache.
pub(super) const PIECE: usize = 1 << 16;

/// Why a snapshot was not restored.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SnapshotError {
    /// The source failed.
    #[error("the snapshot could not be read: {0}")]
    Source(#[source] io::Error),
    /// Something else.
    #[error("this is no snapshot of a world")]
    NotASnapshot,
    /// A form that is not known here.
    #[error("the snapshot has version {0}; version {VERSION} is known here")]
    UnknownVersion(u64),
    /// A world of another precision than the one asked for.
    #[error("the snapshot is of a world in {0} precision")]
    OtherPrecision(Precision),
    /// It ends before its end.
    #[error("the snapshot is cut short")]
    CutShort,
    /// It goes on after its end.
    #[error("the snapshot goes on after its end")]
    TrailingBytes,
    /// It is not as it was written.
    #[error("the snapshot is damaged: its checksum is not that of its bytes")]
    ChecksumMismatch,
    /// Its parts do not fit together.
    #[error("the snapshot contradicts itself: {0}")]
    Inconsistent(&'static str),
    /// A value that no world can have, or more than the limits allow.
    #[error("the snapshot is of no valid world: {0}")]
    Refused(#[from] Error),
}

impl From<io::Error> for SnapshotError {
    fn from(error: io::Error) -> Self {
        if error.kind() == io::ErrorKind::UnexpectedEof { Self::CutShort } else { Self::Source(error) }
    }
}

impl<R: Real> World<R> {
    /// Writes everything that determines the future, in pieces of at most 64 KiB: [`World::restore`] makes of it a
    /// world that gives the same bits from then on. Step count and settings are in it, revision, limits and threads are
    /// not. It changes nothing: two snapshots of one world are equal. Needs the feature `snapshot`.
    ///
    /// ```
    /// use pointmass::{Limits, Particle, World};
    /// let mut world = World::<f64>::default();
    /// world.create(Particle::default())?;
    /// let mut bytes = Vec::new();
    /// world.snapshot(&mut bytes)?;
    /// let mut again = World::<f64>::restore(bytes.as_slice(), Limits::default())?;
    /// assert_eq!(again.advance(1.0)?, world.advance(1.0)?);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Those of the sink.
    pub fn snapshot(&self, mut sink: impl Write) -> io::Result<()> {
        R::world_snapshot(self, &mut sink)
    }

    pub(super) fn write_snapshot(&self, sink: &mut dyn Write) -> io::Result<()> {
        let mut writer = Writer { sink, piece: Vec::with_capacity(PIECE), sum: Hasher::new() };
        writer.put(&MAGIC)?;
        self.head().into_iter().try_for_each(|word| writer.word(word))?;
        let particles = &self.particles;
        if self.ids.next() != particles.len() as u64 {
            (0..particles.len()).try_for_each(|row| writer.word(self.ids.id(row).0))?;
        }
        writer.vectors(&particles.position)?;
        writer.vectors(&particles.velocity)?;
        writer.vectors(&particles.residual.position)?;
        writer.vectors(&particles.residual.velocity)?;
        writer.base_times(&particles.base_time, particles.len())?;
        writer.column(&particles.has_own_acceleration, Writer::flags)?;
        writer.column(&particles.own_acceleration, Writer::vectors)?;
        writer.column(&particles.damping, Writer::reals)?;
        writer.column(&particles.inverse_mass, Writer::reals)?;
        writer.column(&particles.drag, |writer, values| {
            let drag = |drag: &Option<Drag<R>>| drag.map(|Drag { k1, k2 }| [k1, k2]);
            writer.options(values, drag)
        })?;
        writer.column(&particles.gravitational_mass, |writer, values| {
            writer.options(values, |mass| mass.map(|mass| [mass]))
        })?;
        writer.forces(&particles.force, &self.ids)?;
        writer.end()
    }

    fn head(&self) -> [u64; HEAD] {
        let Settings { integrator, gravity: _, damping_law, max_step, forces, tolerance, compensated } = self.settings;
        let [x, y, z] = self.gravity().map(number);
        let drag = forces.drag.map_or([0; 3], |Drag { k1, k2 }| [1, number(k1), number(k2)]);
        let [has_drag, k1, k2] = drag;
        let gravitation = forces
            .gravitation
            .map_or([0; 3], |Gravitation { constant, softening }| [1, number(constant), number(softening)]);
        let [has_gravitation, constant, softening] = gravitation;
        [
            VERSION,
            match R::PRECISION {
                Precision::Single => 1,
                Precision::Double => 2,
            },
            self.particles.len() as u64,
            self.ids.next(),
            self.step_count,
            number(self.clock.hi),
            number(self.clock.lo),
            match integrator {
                Integrator::Exact => 1,
                Integrator::NewtonEuler => 2,
                Integrator::NewtonEulerQuadratic => 3,
                Integrator::SemiImplicitEuler => 4,
                Integrator::VelocityVerlet => 5,
                Integrator::Rk4 => 6,
                Integrator::Dop853 => 7,
            },
            match damping_law {
                DampingLaw::PerSecond => 1,
                DampingLaw::PerStep => 2,
            },
            compensated.into(),
            number(max_step.unwrap_or_default()),
            x,
            y,
            z,
            has_drag,
            k1,
            k2,
            has_gravitation,
            constant,
            softening,
            number(tolerance.absolute),
            number(tolerance.relative),
        ]
    }
}

/// The bits of a number whose zero has no sign.
fn number(x: impl Into<f64>) -> u64 {
    (x.into() + 0.0).to_bits()
}

/// Hands pieces to a sink and sums them up.
struct Writer<'a> {
    sink: &'a mut dyn Write,
    piece: Vec<u8>,
    sum: Hasher,
}

impl Writer<'_> {
    fn flush(&mut self) -> io::Result<()> {
        self.sum.update(&self.piece);
        self.sink.write_all(&self.piece)?;
        self.piece.clear();
        Ok(())
    }

    /// Makes room for so many bytes in the piece.
    fn room(&mut self, bytes: usize) -> io::Result<()> {
        if self.piece.len() + bytes > PIECE { self.flush() } else { Ok(()) }
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.room(bytes.len())?;
        self.piece.extend_from_slice(bytes);
        Ok(())
    }

    fn word(&mut self, word: u64) -> io::Result<()> {
        self.put(&word.to_le_bytes())
    }

    fn reals<R: Real>(&mut self, values: &[R]) -> io::Result<()> {
        for values in values.chunks(PIECE / R::BYTES) {
            self.room(values.len() * R::BYTES)?;
            R::to_bytes(values, &mut self.piece);
        }
        Ok(())
    }

    fn vectors<R: Real>(&mut self, values: &[[R; 3]]) -> io::Result<()> {
        self.reals(values.as_flattened())
    }

    fn flags(&mut self, values: &[bool]) -> io::Result<()> {
        values.iter().try_for_each(|flag| self.put(&[u8::from(*flag)]))
    }

    fn options<T, R: Real, const N: usize>(
        &mut self,
        values: &[T],
        parts: impl Fn(&T) -> Option<[R; N]>,
    ) -> io::Result<()> {
        values.iter().map(parts).try_for_each(|parts| {
            self.put(&[u8::from(parts.is_some())])?;
            self.reals(&parts.unwrap_or([R::ZERO; N]))
        })
    }

    fn column<T>(&mut self, column: &Column<T>, put: impl Fn(&mut Self, &[T]) -> io::Result<()>) -> io::Result<()> {
        let (shape, values) = match column {
            Column::Uniform(value) => (0, std::slice::from_ref(value)),
            Column::PerParticle(values) => (1, values.as_slice()),
        };
        self.word(shape)?;
        put(self, values)
    }

    fn base_times(&mut self, base_times: &BaseTimes, len: usize) -> io::Result<()> {
        let (times, places) = base_times.in_order(len);
        self.word(times.len() as u64)?;
        times.iter().flat_map(|time| [time.hi, time.lo]).try_for_each(|word| self.word(number(word)))?;
        let rows = if times.len() > 1 { 0..len } else { 0..0 };
        rows.map(|row| places[base_times.index(row)]).try_for_each(|place| self.put(&place.to_le_bytes()))
    }

    fn forces<R: Real>(&mut self, forces: &Accumulators<R>, ids: &Ids) -> io::Result<()> {
        match forces.acting() {
            Acting::Few(few) => {
                self.word(0)?;
                self.word(few.len() as u64)?;
                let mut few: Vec<_> = few.within(0..ids.len()).map(|(row, sum)| (ids.id(row), sum)).collect();
                few.sort_unstable_by_key(|(id, _)| *id);
                few.into_iter().try_for_each(|(id, sum)| {
                    self.word(id.0)?;
                    self.reals(&sum)
                })
            }
            Acting::Many(column) => {
                self.word(1)?;
                self.column(column, Self::vectors)
            }
        }
    }

    fn end(mut self) -> io::Result<()> {
        self.flush()?;
        self.sink.write_all(&self.sum.finalize().to_le_bytes())
    }
}
