//! Threads that share the particles of a large advance.

#[cfg(feature = "threads")]
use std::sync::Arc;

#[cfg(feature = "threads")]
use rayon::prelude::*;

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

/// Particles that one thread takes at a time. Fixed, and each particle is moved on its own: how many threads there are
/// decides nothing about the result.
#[cfg(feature = "threads")]
const CHUNK: usize = 1024;

/// Particle-steps from which a second thread pays: some tens of microseconds, several times what waking it costs.
#[cfg(feature = "threads")]
const WORK_TO_SHARE: u64 = 1 << 17;

/// Rows of columns that one thread takes at a time: whole registers.
const ROWS_TO_SHARE: usize = 128;

/// Interactions between two looks at whether an advance is cancelled: about a tenth of a second.
const ROUND_INTERACTIONS: u64 = 1 << 27;

impl Threads {
    /// Starts `count` threads; one thread is none besides the one that asks.
    ///
    /// # Errors
    /// What the operating system says when it cannot start them.
    #[cfg(feature = "threads")]
    pub fn new(count: usize) -> std::io::Result<Self> {
        if count <= 1 {
            return Ok(Self::default());
        }
        let name = |index| format!("pointmass-{index}");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(count).thread_name(name).build();
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
            let chunk = |(chunk, (p, v)): (usize, (&mut [T], &mut [T]))| advance(chunk * CHUNK, p, v);
            return pool.install(|| p.par_chunks_mut(CHUNK).zip(v.par_chunks_mut(CHUNK)).enumerate().for_each(chunk));
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
            let [x, y, z] = columns.map(|column| column.par_chunks_mut(ROWS_TO_SHARE));
            let rows = x.zip(y).zip(z).enumerate();
            let chunk = |(chunk, ((x, y), z))| compute(first + chunk * ROWS_TO_SHARE, [x, y, z]);
            return pool.install(|| rows.for_each(chunk));
        }
        #[cfg(not(feature = "threads"))]
        let _ = work;
        compute(first, columns);
    }
}
