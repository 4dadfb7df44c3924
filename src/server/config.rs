//! Flags, environment variables and limits.

use std::path::PathBuf;
use std::time::Duration;

use clap::builder::{BoolishValueParser, Resettable};
use clap::{Args, FromArgMatches, Parser, Subcommand};

use tokio::sync::Semaphore;

use crate::error::Limits;

/// The names of the flags that refusals point to.
pub(crate) const PARTICLES_MAX: &str = "particles-max";
pub(crate) const STEPS_MAX: &str = "steps-max";
pub(crate) const PARTICLE_STEPS_MAX: &str = "particle-steps-max";
pub(crate) const INTERACTIONS_MAX: &str = "interactions-max";
pub(crate) const WORLDS_MAX: &str = "worlds-max";
pub(crate) const BODY_BYTES_MAX: &str = "body-bytes-max";
pub(crate) const MEMORY_BYTES_MAX: &str = "memory-bytes-max";

/// The largest body where it cannot speak of many particles.
pub(crate) const SMALL_BODY_BYTES_MAX: usize = 1 << 20;

/// The most particles or worlds in one answer of a list; the contract's number.
pub(crate) const PAGE_MAX: usize = 100_000;
/// How many come when `limit` is absent.
pub(crate) const PAGE_DEFAULT: usize = 1000;

/// Worlds of point-mass particles over HTTP.
#[derive(Debug, Parser)]
#[command(
    version,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "\
Without a command it serves. Every option has an environment variable; a flag wins over it.\n\
Example: pointmass --listen 127.0.0.1:9000 --listen unix:/run/pointmass.sock"
)]
pub struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    serve: Config,
}

/// What the binary does.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Listen and answer until SIGTERM or SIGINT, then finish what is in flight and exit with 0.
    Serve(Box<Config>),
    /// Exit with 0 when a service answers, with 1 when not.
    Healthcheck {
        /// Where it should answer.
        #[arg(long, env = "POINTMASS_URL", default_value = "http://127.0.0.1:8080/healthz")]
        url: String,
    },
}

impl Cli {
    /// The command, `serve` when none is named.
    #[must_use]
    pub fn command(self) -> Command {
        self.command.unwrap_or(Command::Serve(Box::new(self.serve)))
    }
}

/// How to serve. Every limit has a flag, and the refusal names it.
#[derive(Debug, Clone, Args)]
pub struct Config {
    /// Where to listen: host:port (port 0: any free one) or unix:PATH; repeatable.
    #[arg(
        long,
        value_name = "ADDR",
        env = "POINTMASS_LISTEN",
        value_delimiter = ',',
        default_value = "127.0.0.1:8080"
    )]
    pub listen: Vec<String>,
    /// Threads that share large advances. Twice as many long advances run at once; further ones wait.
    #[arg(long, value_name = "N", env = "POINTMASS_THREADS", default_value_t = cores(), value_parser = threads)]
    pub threads: usize,
    /// Threads that read requests and write answers.
    #[arg(long, value_name = "N", env = "POINTMASS_WORKERS", default_value_t = default_workers(), value_parser = positive)]
    pub workers: usize,
    /// A name that the Host header may have besides loopback names and addresses; repeatable.
    #[arg(long, value_name = "NAME", env = "POINTMASS_ALLOW_HOST", value_delimiter = ',')]
    pub allow_host: Vec<String>,
    /// A web origin, like <https://example.org>, whose pages may use the service; repeatable.
    #[arg(long, value_name = "ORIGIN", env = "POINTMASS_ALLOW_ORIGIN", value_delimiter = ',', value_parser = origin)]
    pub allow_origin: Vec<String>,
    /// A file with one token a line; every request but health checks must carry one of them.
    #[arg(long, value_name = "PATH", env = "POINTMASS_TOKEN_FILE")]
    pub token_file: Option<PathBuf>,
    /// Listen beyond loopback without tokens: whoever reaches the port may do everything.
    #[arg(long, env = "POINTMASS_INSECURE_NO_AUTH", value_parser = BoolishValueParser::new())]
    pub insecure_no_auth: bool,
    /// How to write logs to standard error.
    #[arg(long, env = "POINTMASS_LOG_FORMAT", value_enum, default_value_t = LogFormat::Text)]
    pub log_format: LogFormat,
    /// What to log, for example info or pointmass=debug (which has a line for every request).
    #[arg(long, value_name = "FILTER", env = "POINTMASS_LOG", default_value = "info")]
    pub log: String,
    /// The most worlds.
    #[arg(long, value_name = "N", env = "POINTMASS_WORLDS_MAX", default_value_t = 10_000)]
    pub worlds_max: usize,
    /// The most particles of a world.
    #[arg(long, value_name = "N", env = "POINTMASS_PARTICLES_MAX", default_value_t = 1_000_000)]
    pub particles_max: u64,
    /// The most memory of all worlds together, counted as 256 bytes for each particle.
    #[arg(long, value_name = "BYTES", env = "POINTMASS_MEMORY_BYTES_MAX", default_value_t = 2 << 30)]
    pub memory_bytes_max: u64,
    /// The most steps of one advance.
    #[arg(long, value_name = "N", env = "POINTMASS_STEPS_MAX", default_value_t = 1_000_000)]
    pub steps_max: u64,
    /// The most steps x particles of one advance: some seconds of one core.
    #[arg(long, value_name = "N", env = "POINTMASS_PARTICLE_STEPS_MAX", default_value_t = 20_000_000_000)]
    pub particle_steps_max: u64,
    /// The most interactions of one advance, under gravitation: half a minute of one core.
    #[arg(long, value_name = "N", env = "POINTMASS_INTERACTIONS_MAX", default_value_t = 20_000_000_000)]
    pub interactions_max: u64,
    /// The largest request body where it speaks of many particles: two hundred thousand of them; elsewhere 1 MiB.
    #[arg(long, value_name = "BYTES", env = "POINTMASS_BODY_BYTES_MAX", default_value_t = 64 << 20)]
    pub body_bytes_max: usize,
    /// The most connections at once; further ones wait to be accepted.
    #[arg(long, value_name = "N", env = "POINTMASS_CONNECTIONS_MAX", default_value_t = 1024, value_parser = positive)]
    pub connections_max: usize,
    /// How long a request's headers may take, and how long a connection may be idle.
    #[arg(long, value_name = "MS", env = "POINTMASS_HEADER_TIMEOUT_MS", default_value_t = 30_000)]
    pub header_timeout_ms: u64,
    /// How long a request's body may take.
    #[arg(long, value_name = "MS", env = "POINTMASS_BODY_TIMEOUT_MS", default_value_t = 30_000)]
    pub body_timeout_ms: u64,
    /// How long to finish what is in flight after SIGTERM or SIGINT.
    #[arg(long, value_name = "MS", env = "POINTMASS_DRAIN_TIMEOUT_MS", default_value_t = 60_000)]
    pub drain_timeout_ms: u64,
}

impl Default for Config {
    /// The defaults of the command line; the environment has no say.
    fn default() -> Self {
        let mut command = Self::augment_args(clap::Command::new("pointmass"));
        command = command.mut_args(|arg| arg.env(Resettable::Reset));
        let matches = command.get_matches_from(["pointmass"]);
        Self::from_arg_matches(&matches).expect("every option has a default")
    }
}

impl Config {
    pub(crate) fn limits(&self) -> Limits {
        Limits {
            particles: self.particles_max,
            steps: self.steps_max,
            particle_steps: self.particle_steps_max,
            interactions: self.interactions_max,
        }
    }

    /// How many long advances may run at once. More than cores: the operating system shares those among worlds.
    pub(crate) fn long_places(&self) -> usize {
        2 * self.threads
    }

    /// Threads that work is moved to from those that answer requests: one for each long advance, and some that those
    /// never take.
    #[must_use]
    pub fn blocking_threads(&self) -> usize {
        self.long_places() + (2 * cores()).max(4)
    }

    pub(crate) fn body_timeout(&self) -> Duration {
        Duration::from_millis(self.body_timeout_ms)
    }
}

/// How a log line looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Requests are short and the client is often on the same machine: half of the cores answer as fast as all of them.
fn default_workers() -> usize {
    (cores() / 2).max(1)
}

/// As many as a computer may have cores.
fn threads(text: &str) -> Result<usize, String> {
    const THREADS_MAX: usize = 1024;
    match positive(text)? {
        threads if threads > THREADS_MAX => Err(format!("must be at most {THREADS_MAX}")),
        threads => Ok(threads),
    }
}

fn positive(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("must be at least 1".to_owned()),
        Ok(n) if n > Semaphore::MAX_PERMITS => Err(format!("must be at most {}", Semaphore::MAX_PERMITS)),
        Ok(n) => Ok(n),
        Err(error) => Err(format!("{error}")),
    }
}

/// An origin as browsers send it: scheme, host, port, and nothing behind.
fn origin(text: &str) -> Result<String, String> {
    let origin = text.strip_suffix('/').unwrap_or(text);
    let rest = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
    match rest {
        Some(host) if !host.is_empty() && !host.contains(['/', '*', ' ']) => Ok(origin.to_ascii_lowercase()),
        Some(_) | None => Err("is not an origin like https://example.org".to_owned()),
    }
}
