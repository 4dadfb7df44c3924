//! The process that is measured: how it is started, watched and ended.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use crate::client::{Address, Client, request};
use crate::echo;

/// A running service; killed when it is dropped.
#[derive(Debug)]
pub(crate) struct Server {
    child: Child,
    /// In the order in which it said them.
    addresses: Vec<Address>,
}

impl Server {
    /// Our service, on a free port.
    pub(crate) fn start(arguments: &[&str]) -> Self {
        Self::listening_on(&["127.0.0.1:0"], arguments)
    }

    pub(crate) fn listening_on(listeners: &[&str], arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_pointmass"));
        command.args(listeners.iter().flat_map(|listener| ["--listen", listener])).args(arguments);
        Self::spawn(command, listeners.len())
    }

    /// What it is compared with: an echo with so many threads that answer.
    pub(crate) fn echo(workers: &str) -> Self {
        Self::this_program(&[echo::CHILD, workers])
    }

    /// The benchmark started once more, as something that says where it listens.
    pub(crate) fn this_program(arguments: &[&str]) -> Self {
        let mut command = Command::new(std::env::current_exe().expect("this program"));
        command.args(arguments);
        Self::spawn(command, 1)
    }

    fn spawn(mut command: Command, listeners: usize) -> Self {
        let command = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().expect("the program starts");
        let lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let addresses = lines.take(listeners).map(|line| {
            let line = line.expect("text");
            let url = line.split_once(" listening on ").unwrap_or_else(|| panic!("{line:?}")).1;
            match url.strip_prefix("unix:") {
                Some(path) => Address::Unix(path.into()),
                None => Address::Tcp(url.strip_prefix("http://").expect("a URL").parse().expect("an address")),
            }
        });
        let addresses: Vec<Address> = addresses.collect();
        assert_eq!(addresses.len(), listeners, "the service ended before it listened");
        Self { child, addresses }
    }

    pub(crate) fn address(&self) -> &Address {
        &self.addresses[0]
    }

    pub(crate) fn second_address(&self) -> &Address {
        &self.addresses[1]
    }

    pub(crate) fn client(&self) -> Client {
        Client::new(self.address())
    }

    /// Whether it runs and answers.
    pub(crate) fn is_well(&mut self) -> bool {
        let answers = self.client().ask(&request("GET", "/healthz", "")).is_ok_and(|answer| answer.status == 200);
        answers && self.child.try_wait().is_ok_and(|ended| ended.is_none())
    }

    /// Bytes of it that are in memory.
    pub(crate) fn resident(&self) -> f64 {
        self.memory("VmRSS:")
    }

    /// The most that ever were, or since they were forgotten.
    pub(crate) fn peak(&self) -> f64 {
        self.memory("VmHWM:")
    }

    /// Forgets the most that ever were; whether the system can.
    pub(crate) fn forget_peak(&self) -> bool {
        std::fs::write(format!("/proc/{}/clear_refs", self.child.id()), "5").is_ok()
    }

    fn memory(&self, what: &str) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix(what)?.trim().strip_suffix("kB"));
        line.and_then(|line| line.trim().parse::<f64>().ok()).map_or(f64::NAN, |kib| 1024.0 * kib)
    }

    /// How many seconds its threads have run.
    pub(crate) fn processor_time(&self) -> f64 {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.child.id())).into_iter().flatten().flatten();
        let of = |path: std::path::PathBuf| {
            let text = std::fs::read_to_string(path.join("schedstat")).ok()?;
            text.split(' ').next()?.parse::<u64>().ok()
        };
        1e-9 * threads.filter_map(|thread| of(thread.path())).sum::<u64>() as f64
    }

    /// SIGTERM.
    pub(crate) fn terminate(&self) {
        let kill = Command::new("kill").args(["-s", "TERM", &self.child.id().to_string()]).status();
        assert!(kill.expect("there is a kill").success(), "the service had ended already");
    }

    /// SIGKILL.
    pub(crate) fn kill(&mut self) {
        self.child.kill().expect("it runs");
        self.child.wait().expect("it ends");
    }

    /// Waits until it ends, and tells its exit code.
    pub(crate) fn wait(&mut self) -> Option<i32> {
        self.child.wait().expect("it ends").code()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ended = self.child.kill();
        let _reaped = self.child.wait();
    }
}
