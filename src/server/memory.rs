//! Budgets of memory, charged before it is allocated: what all worlds may hold, and what requests may take meanwhile.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::server::config::{IN_FLIGHT_BYTES_MAX, MEMORY_BYTES_MAX};
use crate::server::problem::{Code, Problem};

/// The most that a particle takes: every column per-particle, room to grow, and the copy of a long advance.
pub(crate) const PARTICLE_BYTES: u64 = 256;

/// The most that an advance takes for each particle where it works on copies: columns, laws, the stages of a step, and
/// the states around a plane.
pub(crate) const SYSTEM_BYTES: u64 = 704;

/// The same under `dop853`, which has more stages, and estimates of its error.
pub(crate) const ADAPTIVE_BYTES: u64 = 1024;

/// What comparing with the closed form takes for each particle: where it was, and how fast.
pub(crate) const COMPARED_BYTES: u64 = 48;

/// The longest number in JSON, with what separates it from the next.
pub(crate) const NUMBER_BYTES: u64 = 26;

/// What reading a byte of a body in JSON takes at most, the byte itself included: `1,` becomes eight bytes of a column,
/// and while that grows there are two of it, one of twice its size (thirteen were seen).
pub(crate) const PARSED_BYTES: u64 = 16;

/// What restoring a byte of a snapshot takes at most, the byte itself included: particles of single precision whose ids
/// are far apart take four.
pub(crate) const RESTORED_BYTES: u64 = 5;

/// What a piece of a body takes besides its bytes.
pub(crate) const PIECE_BYTES: u64 = 64;

/// What a byte of a body in CBOR takes: itself, and once more while its parts are joined.
pub(crate) const CBOR_BYTES: u64 = 2;

/// What a number in CBOR takes at most where it is not in a typed array: 16 bytes of a column, three times while that
/// grows.
pub(crate) const NUMBER_ITEM_BYTES: u64 = 48;

/// What a list, a null or a text in CBOR takes at most: a vector that may be absent, the same way.
pub(crate) const ITEM_BYTES: u64 = 96;

/// What an object in a body becomes: a particle with all of its properties.
pub(crate) const OBJECT_BYTES: u64 = 256;

/// At least as many as there are objects in JSON.
pub(crate) fn objects(body: &[u8]) -> u64 {
    // Counts that fit a byte, and additions that are not looked at: on vector registers, many bytes at once.
    let count = |part: &[u8]| part.iter().fold(0_u8, |count, byte| count.wrapping_add(u8::from(*byte == b'{')));
    body.chunks(u8::MAX.into()).map(|part| u64::from(count(part))).sum()
}

/// A budget of bytes.
#[derive(Debug)]
pub(crate) struct Memory {
    limit: u64,
    used: AtomicU64,
    /// Says that so much would be more than the limit.
    refusal: fn(u64, u64) -> Problem,
}

/// A part of a budget; given back when it is dropped.
#[derive(Debug)]
pub(crate) struct Charge {
    memory: Arc<Memory>,
    bytes: u64,
}

impl Memory {
    /// What all worlds may hold.
    pub(crate) fn of_worlds(limit: u64) -> Arc<Self> {
        Arc::new(Self {
            limit,
            used: AtomicU64::new(0),
            refusal: |used, limit| {
                let detail = format!(
                    "all worlds together would take {used} bytes, more than {limit} (--{MEMORY_BYTES_MAX}); remove particles or worlds"
                );
                Problem::new(Code::LimitReached, detail)
            },
        })
    }

    /// What the bodies and answers of all requests may take while they are in flight.
    pub(crate) fn of_requests(limit: u64) -> Arc<Self> {
        Arc::new(Self {
            limit,
            used: AtomicU64::new(0),
            refusal: |used, limit| {
                let detail = format!(
                    "the requests and answers in flight would take {used} bytes, more than {limit} (--{IN_FLIGHT_BYTES_MAX}); try again later"
                );
                Problem::new(Code::Overloaded, detail)
            },
        })
    }

    pub(crate) fn used(&self) -> u64 {
        self.used.load(Ordering::Relaxed)
    }

    /// The share of the budget that is used, from 0 to 1.
    pub(crate) fn load(&self) -> f64 {
        #![expect(clippy::cast_precision_loss, reason = "a share")]
        self.used() as f64 / self.limit.max(1) as f64
    }
}

impl Charge {
    pub(crate) fn none(memory: &Arc<Memory>) -> Self {
        Self { memory: Arc::clone(memory), bytes: 0 }
    }

    /// Takes more, or nothing when that would be too much.
    pub(crate) fn grow(&mut self, bytes: u64) -> Result<(), Problem> {
        let limit = self.memory.limit;
        let grown = |used: u64| used.checked_add(bytes).filter(|used| *used <= limit);
        match self.memory.used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, grown) {
            Ok(_) => {
                self.bytes += bytes;
                Ok(())
            }
            Err(used) => Err((self.memory.refusal)(used.saturating_add(bytes), limit)),
        }
    }

    /// Gives back what is more than this.
    pub(crate) fn shrink_to(&mut self, bytes: u64) {
        let back = self.bytes.saturating_sub(bytes);
        self.memory.used.fetch_sub(back, Ordering::Relaxed);
        self.bytes -= back;
    }
}

impl Drop for Charge {
    fn drop(&mut self) {
        self.shrink_to(0);
    }
}

#[cfg(test)]
mod tests {
    use super::{Charge, Memory, objects};

    #[test]
    fn objects_are_counted_beyond_a_byte() {
        for count in [0, 1, 254, 255, 256, 1000] {
            assert_eq!(objects("{".repeat(count).as_bytes()), count as u64);
        }
        assert_eq!(objects("[{},{ \"a\":[{}] }]".repeat(100).as_bytes()), 300);
    }

    #[test]
    fn what_is_given_back_can_be_taken_again() {
        let memory = Memory::of_worlds(100);
        let (mut a, mut b) = (Charge::none(&memory), Charge::none(&memory));
        a.grow(60).expect("within");
        assert!(b.grow(41).is_err() && b.grow(u64::MAX).is_err());
        b.grow(40).expect("just within");
        a.shrink_to(10);
        b.grow(50).expect("given back");
        drop(b);
        a.grow(90).expect("all but ten");
    }
}
