//! Threads that share the particles of a large advance.

#[cfg(feature = "threads")]
use std::sync::{Arc, Mutex, PoisonError};

/// Threads for the large advances of any number of worlds, see [`World::set_threads`](crate::World::set_threads).
///
/// ```
/// use pointmass::{Threads, World};
/// let threads = Threads::new(2)?;
/// let mut world = World::<f64>::default();
/// world.set_threads(&threads);
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Threads {
    /// None: the thread that asks does all of it.
    #[cfg(feature = "threads")]
    pool: Option<Arc<rayon::ThreadPool>>,
}

/// Particle-steps that a thread takes at a time, in whole blocks of particles: long runs through memory, and as short a wait
/// for the last one. Each particle is moved on its own, so that how many threads there are decides nothing about the result.
#[cfg(feature = "threads")]
const CHUNK_WORK: u64 = 8192;
/// The least particles of them.
#[cfg(feature = "threads")]
const CHUNK_MIN: usize = 256;

/// Particle-steps from which a second thread pays: some tens of microseconds, several times what waking it costs.
#[cfg(feature = "threads")]
const WORK_TO_SHARE: u64 = 1 << 17;

/// Rows of columns that one thread takes at a time: whole registers.
const ROWS_TO_SHARE: usize = 128;

/// Interactions between two looks at whether an advance is cancelled: about a tenth of a second.
const ROUND_INTERACTIONS: u64 = 1 << 27;

impl Threads {
    /// `count` threads: whoever asks for an advance is one of those that carry it out, and the others are started here.
    ///
    /// # Errors
    /// What the operating system says when it cannot start them.
    #[cfg(feature = "threads")]
    pub fn new(count: usize) -> std::io::Result<Self> {
        if count <= 1 {
            return Ok(Self::default());
        }
        let name = |index| format!("pointmass-{index}");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count - 1).thread_name(name).build();
        Ok(Self { pool: Some(Arc::new(pool.map_err(std::io::Error::other)?)) })
    }

    /// Moves all rows, `steps` steps each: `advance` gets the number of its first row, and some positions and velocities.
    pub(crate) fn advance<T: Send>(
        &self,
        steps: u64,
        p: &mut [T],
        v: &mut [T],
        advance: impl Fn(usize, &mut [T], &mut [T]) + Sync,
    ) {
        #[cfg(feature = "threads")]
        if let Some(pool) = &self.pool
            && (p.len() as u64).saturating_mul(steps) >= WORK_TO_SHARE
        {
            let rows = usize::try_from(CHUNK_WORK / steps).unwrap_or(0).max(1).next_multiple_of(CHUNK_MIN);
            let chunks = p.chunks_mut(rows).zip(v.chunks_mut(rows)).enumerate();
            return share(pool, chunks, |(chunk, (p, v))| advance(chunk * rows, p, v));
        }
        #[cfg(not(feature = "threads"))]
        let _ = steps;
        advance(0, p, v);
    }

    /// Computes three columns, in rounds between which others have their turn on the threads: `compute` gets the index of
    /// its first row, and some of each. A row costs `work` interactions.
    pub(crate) fn share_columns<T: Send>(
        &self,
        work: u64,
        columns: [&mut [T]; 3],
        compute: impl Fn(usize, [&mut [T]; 3]) + Sync,
    ) {
        let len = columns[0].len();
        let rows = usize::try_from(ROUND_INTERACTIONS / work.max(1)).unwrap_or(len);
        let rows = rows.clamp(1, len.max(1)).next_multiple_of(ROWS_TO_SHARE);
        let [x, y, z] = columns.map(|column| column.chunks_mut(rows));
        for (round, ((x, y), z)) in x.zip(y).zip(z).enumerate() {
            self.share_round(work, round * rows, [x, y, z], &compute);
        }
    }

    fn share_round<T: Send>(
        &self,
        work: u64,
        first: usize,
        columns: [&mut [T]; 3],
        compute: &(impl Fn(usize, [&mut [T]; 3]) + Sync),
    ) {
        #[cfg(feature = "threads")]
        if let Some(pool) = &self.pool
            && (columns[0].len() as u64).saturating_mul(work) >= WORK_TO_SHARE
        {
            let [x, y, z] = columns.map(|column| column.chunks_mut(ROWS_TO_SHARE));
            let chunks = x.zip(y).zip(z).enumerate();
            return share(pool, chunks, |(chunk, ((x, y), z))| compute(first + chunk * ROWS_TO_SHARE, [x, y, z]));
        }
        #[cfg(not(feature = "threads"))]
        let _ = work;
        compute(first, columns);
    }
}

/// Works on all parts: this thread begins with the first one, the others with the last one. That this thread takes part
/// hides how long it takes to wake the others, and that they come from the other end keeps them out of its memory.
#[cfg(feature = "threads")]
fn share<Parts>(pool: &rayon::ThreadPool, parts: Parts, work: impl Fn(Parts::Item) + Sync)
where
    Parts: DoubleEndedIterator<Item: Send> + Send,
{
    let parts = Mutex::new(parts);
    let take =
        |end: fn(&mut Parts) -> Option<Parts::Item>| end(&mut parts.lock().unwrap_or_else(PoisonError::into_inner));
    pool.in_place_scope(|scope| {
        for _ in 0..pool.current_num_threads() {
            scope.spawn(|_| std::iter::from_fn(|| take(Parts::next_back)).for_each(&work));
        }
        std::iter::from_fn(|| take(Parts::next)).for_each(&work);
    });
}

#[cfg(all(test, feature = "threads"))]
mod tests {
    use super::Threads;

    /// Each row gets one more than its number, once.
    fn number(first: usize, columns: &mut [&mut [usize]]) {
        for column in columns {
            column.iter_mut().enumerate().for_each(|(row, value)| *value += first + row + 1);
        }
    }

    #[test]
    fn every_row_is_taken_once_and_knows_where_it_is() {
        for threads in [1, 2, 3].map(|count| Threads::new(count).expect("they start")) {
            for len in [0, 1, 127, 128, 1000, 5000] {
                let expected: Vec<usize> = (1..=len).collect();
                for work in [1, 1 << 10, 1 << 17, 1 << 20, u64::MAX] {
                    let [mut x, mut y, mut z] = [vec![0; len], vec![0; len], vec![0; len]];
                    threads.share_columns(work, [&mut x, &mut y, &mut z], |first, mut to| number(first, &mut to));
                    assert!([&x, &y, &z].into_iter().all(|column| *column == expected), "{len} rows of {work}");
                    let [mut p, mut v] = [vec![0; len], vec![0; len]];
                    threads.advance(work, &mut p, &mut v, |first, p, v| number(first, &mut [p, v]));
                    assert!(p == expected && v == expected, "{len} rows, {work} steps");
                }
            }
        }
    }
}
