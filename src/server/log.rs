//! Log lines on their way to standard error.

use std::io::{self, Write};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tracing_subscriber::fmt::MakeWriter;

/// Lines are gathered for so long, and written together.
const GATHER: Duration = Duration::from_millis(20);
/// The most that waits for a reader who does not read: some thousand lines. Further ones are counted and dropped.
const WAITING_BYTES_MAX: usize = 1 << 20;
/// How long the end of the process waits for the last lines to be taken.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(1);

/// Standard error behind a thread: no request waits for a terminal, a pipe or a disk. Clones are the same log.
#[derive(Debug, Clone, Default)]
pub struct Log(Arc<Lines>);

#[derive(Debug, Default)]
struct Lines {
    waiting: Mutex<Waiting>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Waiting {
    lines: Vec<u8>,
    dropped: u64,
    is_writing: bool,
}

impl Log {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system has no thread left.
    pub fn start() -> io::Result<Self> {
        let log = Self::default();
        let lines = Arc::clone(&log.0);
        std::thread::Builder::new().name("log".to_owned()).spawn(move || lines.write_for_ever(&mut io::stderr()))?;
        Ok(log)
    }

    /// Waits until what was logged is written, unless nobody reads it.
    pub fn flush(&self) {
        let waiting = self.0.lock();
        let is_pending = |waiting: &mut Waiting| waiting.is_writing || !waiting.lines.is_empty();
        let _in_vain = self.0.changed.wait_timeout_while(waiting, FLUSH_TIMEOUT, is_pending);
    }
}

impl Lines {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write_for_ever(&self, out: &mut impl Write) {
        loop {
            let waiting = self.changed.wait_while(self.lock(), |waiting| waiting.lines.is_empty());
            drop(waiting);
            std::thread::sleep(GATHER);
            self.write_once(out);
        }
    }

    fn write_once(&self, out: &mut impl Write) {
        let mut waiting = self.lock();
        let lines = std::mem::take(&mut waiting.lines);
        let dropped = std::mem::take(&mut waiting.dropped);
        waiting.is_writing = true;
        drop(waiting);
        // There is nobody to tell that nobody reads.
        let _closed = out.write_all(&lines);
        if dropped > 0 {
            let _closed = writeln!(out, "{dropped} log lines were dropped, because nobody read them in time");
        }
        self.lock().is_writing = false;
        self.changed.notify_all();
    }
}

impl<'a> MakeWriter<'a> for Log {
    type Writer = Writer<'a>;

    fn make_writer(&'a self) -> Writer<'a> {
        Writer(&self.0)
    }
}

/// Writes lines of a [`Log`].
#[derive(Debug)]
pub struct Writer<'a>(&'a Lines);

impl Write for Writer<'_> {
    /// Takes a line as a whole or not at all.
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        let mut waiting = self.0.lock();
        if waiting.lines.len() + line.len() > WAITING_BYTES_MAX {
            waiting.dropped += 1;
            return Ok(line.len());
        }
        let is_first = waiting.lines.is_empty();
        waiting.lines.extend_from_slice(line);
        if is_first {
            self.0.changed.notify_all();
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::{Lines, WAITING_BYTES_MAX, Writer};
    use std::io::Write;

    #[test]
    fn what_nobody_reads_is_counted_and_not_kept() {
        let lines = Lines::default();
        let line = [b'x'; 1000];
        for _ in 0..2000 {
            Writer(&lines).write_all(&line).expect("always");
        }
        assert!(lines.lock().lines.len() <= WAITING_BYTES_MAX);
        let mut out = Vec::new();
        lines.write_once(&mut out);
        let kept = WAITING_BYTES_MAX / line.len();
        let dropped = format!("{} log lines were dropped", 2000 - kept);
        assert!(String::from_utf8_lossy(&out[kept * line.len()..]).starts_with(&dropped));
        Writer(&lines).write_all(b"and on").expect("always");
        let mut out = Vec::new();
        lines.write_once(&mut out);
        assert_eq!(out, b"and on");
    }
}
