//! Snapshots read back, in the form that the file beside this one tells.

use std::fmt::{self, Debug};
use std::io::{self, Read};

use crc32fast::Hasher;

use crate::accumulators::Accumulators;
use crate::base_times::BaseTimes;
use crate::column::Column;
use crate::command::{Mass, Settings, Tolerance};
use crate::double_double::DoubleDouble;
use crate::error::{Error, Field, Limit, Limits, Place};
use crate::forces::{Drag, Forces, Gravitation};
use crate::ids::{Ids, ParticleId};
use crate::integrator::{DampingLaw, Integrator};
use crate::particles::{Particles, zero};
use crate::real::{Precision, Real};
use crate::world::World;
use crate::world::advance::CLOCK_MAX;
use crate::world::bounds::Bounds;
use crate::world::change::{check_damping, check_drag, check_finite, check_magnitude, check_mass, positive_zero};
use crate::world::snapshot::{HEAD, MAGIC, PIECE, SnapshotError, VERSION};

/// Ids are below this, which no world reaches; the digest relies on it.
const ID_MAX: u64 = 1 << 60;

/// A snapshot whose head is read: what it is of, before it is restored. It reads the source in pieces of up to 64 KiB,
/// and a few bytes now and then.
///
/// ```
/// use pointmass::{Limits, Precision, Snapshot, World};
/// let mut bytes = Vec::new();
/// World::<f32>::default().snapshot(&mut bytes)?;
/// let snapshot = Snapshot::open(bytes.as_slice())?;
/// assert_eq!((snapshot.precision(), snapshot.particle_count()), (Precision::Single, 0));
/// let world: World<f32> = snapshot.restore(Limits::default())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Snapshot<S> {
    reader: Reader<S>,
    precision: Precision,
    head: [u64; HEAD],
}

impl<S> Debug for Snapshot<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Snapshot").field("precision", &self.precision).finish_non_exhaustive()
    }
}

impl<S: Read> Snapshot<S> {
    /// Reads the head.
    ///
    /// # Errors
    /// Not a snapshot, or one of an unknown version.
    pub fn open(source: S) -> Result<Self, SnapshotError> {
        let mut reader = Reader { source, piece: Vec::new(), sum: Hasher::new() };
        if reader.bytes(MAGIC.len())? != MAGIC {
            return Err(SnapshotError::NotASnapshot);
        }
        let mut head = [0; HEAD];
        for (at, word) in head.iter_mut().enumerate() {
            *word = reader.word()?;
            if at == 0 && *word != VERSION {
                return Err(SnapshotError::UnknownVersion(*word));
            }
        }
        let precision = match head[1] {
            1 => Precision::Single,
            2 => Precision::Double,
            _ => return Err(SnapshotError::Inconsistent("its precision is none")),
        };
        Ok(Self { reader, precision, head })
    }

    /// The precision of its world.
    #[must_use]
    pub fn precision(&self) -> Precision {
        self.precision
    }

    /// How many particles it says that its world has.
    #[must_use]
    pub fn particle_count(&self) -> u64 {
        self.head[2]
    }

    /// The world of the snapshot, with limits that hold from then on. Its revision is 0.
    ///
    /// # Errors
    /// [`SnapshotError`].
    pub fn restore<R: Real>(mut self, limits: Limits) -> Result<World<R>, SnapshotError> {
        let Reader { piece, sum, .. } = self.reader;
        let reader = Reader { source: &mut self.reader.source as &mut dyn Read, piece, sum };
        R::world_restore(Snapshot { reader, precision: self.precision, head: self.head }, limits)
    }
}

impl Snapshot<&mut dyn Read> {
    pub(super) fn read<R: Real>(self, limits: Limits) -> Result<World<R>, SnapshotError> {
        if self.precision != R::PRECISION {
            return Err(SnapshotError::OtherPrecision(self.precision));
        }
        let Self { mut reader, head, .. } = self;
        let [_, _, count, next, step_count, upper, lower, ..] = head;
        let mut world = World::with_limits(settings::<R>(&head)?, limits)?;
        let allowed = world.limits.particles;
        if count > allowed {
            return Err(Error::LimitReached { limit: Limit::Particles, allowed, asked: count }.into());
        }
        let len = usize::try_from(count).map_err(|_| SnapshotError::CutShort)?;
        let clock = DoubleDouble::new(f64::from_bits(upper), f64::from_bits(lower));
        if !is_clock(clock) || clock.hi > CLOCK_MAX {
            return Err(SnapshotError::Inconsistent("its clock is none"));
        }
        (world.clock, world.step_count) = (clock, step_count);
        *world.ids = reader.ids(next, count, len)?;
        *world.particles = reader.particles(&world, len)?;
        reader.end()?;
        world.bounds = Bounds::of(&world.particles, world.gravity());
        if !world.bounds.hold_until::<R>(clock) {
            world.check_readable()?;
        }
        Ok(world)
    }
}

impl<R: Real> World<R> {
    /// The world of a snapshot, with limits that hold from then on. Its revision is 0. Needs the feature `snapshot`.
    ///
    /// # Errors
    /// [`SnapshotError`].
    pub fn restore(source: impl Read, limits: Limits) -> Result<Self, SnapshotError> {
        Snapshot::open(source)?.restore(limits)
    }

    /// Another world in the place of this one, as one change of it.
    #[cfg(feature = "server")]
    pub(crate) fn replace_by(&mut self, other: Self) {
        let threads = self.threads.clone();
        *self = Self { revision: self.revision + 1, threads, ..other };
    }

    /// Refuses particles that are not finite at the clock, to which the closed form takes them.
    fn check_readable(&self) -> Result<(), Error> {
        let mut refused = Ok(());
        self.for_each_block(|block| {
            for (states, field) in [(&block.position, Field::Position), (&block.velocity, Field::Velocity)] {
                if !is_finite(states.as_flattened()) {
                    refused = Err(Error::NotFinite(field.whole()));
                }
            }
        });
        refused
    }
}

fn settings<R: Real>(head: &[u64; HEAD]) -> Result<Settings<R>, SnapshotError> {
    let [
        ..,
        integrator,
        law,
        compensated,
        max_step,
        x,
        y,
        z,
        has_drag,
        k1,
        k2,
        has_g,
        g,
        softening,
        absolute,
        relative,
    ] = *head;
    let number = f64::from_bits;
    let real = |bits| R::nearest(number(bits));
    let max_step = number(max_step);
    Ok(Settings {
        integrator: match integrator {
            1 => Integrator::Exact,
            2 => Integrator::NewtonEuler,
            3 => Integrator::NewtonEulerQuadratic,
            4 => Integrator::SemiImplicitEuler,
            5 => Integrator::VelocityVerlet,
            6 => Integrator::Rk4,
            7 => Integrator::Dop853,
            _ => return Err(SnapshotError::Inconsistent("its integrator is none")),
        },
        damping_law: match law {
            1 => DampingLaw::PerSecond,
            2 => DampingLaw::PerStep,
            _ => return Err(SnapshotError::Inconsistent("its damping law is none")),
        },
        compensated: flag(compensated)?,
        max_step: (max_step != 0.0).then_some(max_step),
        gravity: [x, y, z].map(real).into(),
        forces: Forces {
            drag: flag(has_drag)?.then(|| Drag { k1: real(k1), k2: real(k2) }),
            gravitation: flag(has_g)?.then(|| Gravitation { constant: real(g), softening: real(softening) }),
        },
        tolerance: Tolerance { absolute: number(absolute), relative: number(relative) },
    })
}

fn flag(word: u64) -> Result<bool, SnapshotError> {
    match word {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(SnapshotError::Inconsistent("it has a number where only 0 and 1 are known")),
    }
}

/// Whether it is a sum of durations.
fn is_clock(time: DoubleDouble) -> bool {
    time.hi >= 0.0 && time.hi.is_finite() && time.hi + time.lo == time.hi
}

fn is_finite<R: Real>(values: &[R]) -> bool {
    values.iter().all(|value| value.is_finite())
}

/// Takes pieces from a source and sums them up.
struct Reader<S> {
    source: S,
    piece: Vec<u8>,
    sum: Hasher,
}

impl<S: Read> Reader<S> {
    /// So many bytes: at most a piece.
    fn bytes(&mut self, len: usize) -> Result<&[u8], SnapshotError> {
        if self.piece.len() < len {
            self.piece.resize(len, 0);
        }
        let bytes = &mut self.piece[..len];
        self.source.read_exact(bytes)?;
        self.sum.update(bytes);
        Ok(bytes)
    }

    fn word(&mut self) -> Result<u64, SnapshotError> {
        let (words, _) = self.bytes(8)?.as_chunks();
        Ok(u64::from_le_bytes(words[0]))
    }

    /// `count` values of so many bytes each, which `read` appends from a piece of them.
    fn values<T>(
        &mut self,
        count: usize,
        bytes: usize,
        mut read: impl FnMut(&[u8], &mut Vec<T>) -> Result<(), SnapshotError>,
    ) -> Result<Vec<T>, SnapshotError> {
        let mut values = Vec::new();
        while values.len() < count {
            let some = (count - values.len()).min(PIECE / bytes);
            let piece = self.bytes(some * bytes)?;
            // Room for as many again as have arrived.
            if values.capacity() < values.len() + some {
                values.reserve_exact((values.len() + some).min(count - values.len()));
            }
            read(piece, &mut values)?;
        }
        Ok(values)
    }

    fn words(&mut self, count: usize) -> Result<Vec<u64>, SnapshotError> {
        self.values(count, 8, |piece, values| {
            let (words, _) = piece.as_chunks();
            values.extend(words.iter().map(|word| u64::from_le_bytes(*word)));
            Ok(())
        })
    }

    /// Values of N reals each, every one of which passes a check.
    fn checked<R: Real, T, const N: usize>(
        &mut self,
        count: usize,
        value: impl Fn([R; N], usize) -> Result<T, Error>,
    ) -> Result<Vec<T>, SnapshotError> {
        let mut reals = Vec::new();
        self.values(count, N * R::BYTES, |piece, values: &mut Vec<T>| {
            reals.clear();
            R::from_bytes(piece, &mut reals);
            let (parts, _) = reals.as_chunks();
            for parts in parts {
                values.push(value(*parts, values.len())?);
            }
            Ok(())
        })
    }

    /// Vectors that are finite; their zeros keep their sign.
    fn vectors<R: Real>(&mut self, count: usize, field: Field) -> Result<Vec<[R; 3]>, SnapshotError> {
        self.checked(count, |vector, index| {
            check_finite(vector, Place { field, index: Some(index) })?;
            Ok(vector)
        })
    }

    /// A flag and N reals each.
    fn options<R: Real, T, const N: usize>(
        &mut self,
        count: usize,
        value: impl Fn([R; N], usize) -> Result<T, Error>,
    ) -> Result<Vec<Option<T>>, SnapshotError> {
        let mut reals = Vec::new();
        let size = 1 + N * R::BYTES;
        self.values(count, size, |piece, values: &mut Vec<Option<T>>| {
            for entry in piece.chunks_exact(size) {
                reals.clear();
                R::from_bytes(&entry[1..], &mut reals);
                let (parts, _) = reals.as_chunks();
                let there = flag(entry[0].into())?;
                let read = there.then(|| value(parts[0].map(positive_zero), values.len()));
                values.push(read.transpose()?);
            }
            Ok(())
        })
    }

    fn column<T: Copy + PartialEq>(
        &mut self,
        len: usize,
        read: impl Fn(&mut Self, usize) -> Result<Vec<T>, SnapshotError>,
    ) -> Result<Column<T>, SnapshotError> {
        if flag(self.word()?)? {
            return Ok(Column::PerParticle(read(self, len)?));
        }
        Ok(Column::Uniform(read(self, 1)?[0]))
    }

    fn ids(&mut self, next: u64, count: u64, len: usize) -> Result<Ids, SnapshotError> {
        if next < count || next > ID_MAX {
            return Err(SnapshotError::Inconsistent("its next id is none"));
        }
        if next == count {
            return Ok(Ids::first(next));
        }
        let ids = Ids::some(next, self.words(len)?);
        ids.ok_or(SnapshotError::Inconsistent("an id is there twice, or was never given"))
    }

    /// The columns of a world whose settings, clock and ids are read.
    fn particles<R: Real>(&mut self, world: &World<R>, len: usize) -> Result<Particles<R>, SnapshotError> {
        let place = |field| move |index| Place { field, index: Some(index) };
        let mut particles = Particles::new();
        particles.position = self.vectors(len, Field::Position)?;
        particles.velocity = self.vectors(len, Field::Velocity)?;
        let residuals = if world.settings.compensated { len } else { 0 };
        particles.residual.position = self.vectors(residuals, Field::Position)?;
        particles.residual.velocity = self.vectors(residuals, Field::Velocity)?;
        particles.base_time = self.base_times(world, len)?;
        particles.has_own_acceleration = self.column(len, |reader, count| {
            reader.values(count, 1, |piece, values| {
                for byte in piece {
                    values.push(flag((*byte).into())?);
                }
                Ok(())
            })
        })?;
        particles.own_acceleration = self.column(len, |reader, count| {
            reader.checked(count, |vector, index| {
                check_finite(vector, place(Field::Acceleration)(index))?;
                Ok(vector.map(positive_zero))
            })
        })?;
        let has_none = |row: &usize| !particles.has_own_acceleration.get(*row);
        if (0..len).filter(has_none).any(|row| particles.own_acceleration.get(row) != zero()) {
            return Err(SnapshotError::Inconsistent("a particle has and has not an acceleration of its own"));
        }
        particles.damping = self.column(len, |reader, count| {
            reader.checked(count, |[damping], index| {
                check_damping(damping, place(Field::Damping)(index))?;
                Ok(positive_zero(damping))
            })
        })?;
        world.serve_dampings(&particles.damping, len)?;
        particles.inverse_mass = self.column(len, |reader, count| {
            reader.checked(count, |[w], index| {
                check_mass(Mass::Inverse(w), place(Field::InverseMass)(index))?;
                Ok(positive_zero(w))
            })
        })?;
        particles.drag = self.column(len, |reader, count| {
            reader.options(count, |[k1, k2], index| {
                let drag = Drag { k1, k2 };
                check_drag(drag, place(Field::Drag)(index)).map(|()| drag)
            })
        })?;
        particles.gravitational_mass = self.column(len, |reader, count| {
            reader.options(count, |[mass], index| {
                check_magnitude(mass, place(Field::GravitationalMass)(index)).map(|()| mass)
            })
        })?;
        particles.force = self.forces(&world.ids, len)?;
        particles.note_all();
        Ok(particles)
    }

    fn base_times<R: Real>(&mut self, world: &World<R>, len: usize) -> Result<BaseTimes, SnapshotError> {
        const NONE: SnapshotError = SnapshotError::Inconsistent("its base times are none");
        let distinct = usize::try_from(self.word()?).ok().filter(|distinct| *distinct <= len).ok_or(NONE)?;
        let words = self.words(2 * distinct)?;
        let (words, _) = words.as_chunks();
        let times: Vec<DoubleDouble> =
            words.iter().map(|[hi, lo]| DoubleDouble::new(f64::from_bits(*hi), f64::from_bits(*lo))).collect();
        // Only the closed form knows a past.
        let is_exact = world.settings.integrator == Integrator::Exact;
        let is_base = |time: &DoubleDouble| {
            is_clock(*time) && (world.clock - *time).hi >= 0.0 && (is_exact || *time == world.clock)
        };
        if !times.iter().all(is_base) {
            return Err(NONE);
        }
        if len == 0 {
            return Ok(BaseTimes::all_at(world.clock));
        }
        if let [time] = *times.as_slice() {
            return Ok(BaseTimes::all_at(time));
        }
        let of = self.values(len, 4, |piece, values| {
            let (indices, _) = piece.as_chunks();
            values.extend(indices.iter().map(|index| u32::from_le_bytes(*index)));
            Ok(())
        })?;
        BaseTimes::restored(&times, of).ok_or(NONE)
    }

    fn forces<R: Real>(&mut self, ids: &Ids, len: usize) -> Result<Accumulators<R>, SnapshotError> {
        let force = |vector: [R; 3], index| {
            check_finite(vector, Place { field: Field::Force, index: Some(index) })?;
            Ok(vector.map(positive_zero))
        };
        if flag(self.word()?)? {
            return Ok(Accumulators::many(self.column(len, |reader, count| reader.checked(count, force))?));
        }
        let count = usize::try_from(self.word()?).map_err(|_| SnapshotError::CutShort)?;
        let mut reals = Vec::new();
        let few = self.values(count, 8 + 3 * R::BYTES, |piece, few: &mut Vec<(ParticleId, [R; 3])>| {
            for entry in piece.chunks_exact(8 + 3 * R::BYTES) {
                let (ids, sums) = (entry[..8].as_chunks().0, &entry[8..]);
                reals.clear();
                R::from_bytes(sums, &mut reals);
                few.push((ParticleId(u64::from_le_bytes(ids[0])), force(reals.as_chunks().0[0], few.len())?));
            }
            Ok(())
        })?;
        Ok(Accumulators::few(few.into_iter().filter_map(|(id, sum)| Some((ids.row(id)?, sum)))))
    }

    /// The checksum, and nothing after it.
    fn end(mut self) -> Result<(), SnapshotError> {
        let sum = self.sum.clone().finalize();
        let (sums, _) = self.bytes(4)?.as_chunks();
        if u32::from_le_bytes(sums[0]) != sum {
            return Err(SnapshotError::ChecksumMismatch);
        }
        match self.source.read_exact(&mut [0]) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(()),
            Err(error) => Err(SnapshotError::Source(error)),
            Ok(()) => Err(SnapshotError::TrailingBytes),
        }
    }
}
