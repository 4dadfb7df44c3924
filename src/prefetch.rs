//! Memory that is fetched before a loop is there.
//!
//! Processors do so by themselves as well, but not all of it: a step of a million particles takes nine tenths of the time so.

use prefetch_index::prefetch_index;

/// Bytes that a processor fetches together.
const LINE: usize = 64;

/// How many bytes ahead of a loop: the best of 256 to 4096 for a million particles and ten.
const AHEAD: usize = 1024;

/// Bytes of a column of vectors from which it pays. Smaller ones stay in the second cache from one advance or read to the
/// next, and would take some percent longer.
const LARGE: usize = 1 << 19;

/// Whether a loop over this column should fetch.
pub(crate) fn is_large<T>(column: &[T]) -> bool {
    size_of_val(column) >= LARGE
}

/// Fetches what comes some way behind the part of a list that a loop is at. Behind the end of the list nothing happens.
#[expect(clippy::inline_always, reason = "in the hottest loops")]
#[inline(always)]
pub(crate) fn fetch_behind<T>(part: &[T]) {
    for line in (0..part.len()).step_by(LINE / size_of::<T>()) {
        prefetch_index(part, line + AHEAD / size_of::<T>());
    }
}
