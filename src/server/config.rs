//! Flags, environment variables and limits.

use std::path::PathBuf;
use std::time::Duration;

use clap::builder::BoolishValueParser;
use clap::{Args, Parser, Subcommand};

use crate::error::Limits;

/// The names of the flags that refusals point to.
pub(crate) const PARTICLES_MAX: &str = "particles-max";
pub(crate) const STEPS_MAX: &str = "steps-max";
pub(crate) const PARTICLE_STEPS_MAX: &str = "particle-steps-max";
pub(crate) const WORLDS_MAX: &str = "worlds-max";
pub(crate) const BODY_BYTES_MAX: &str = "body-bytes-max";

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
    Serve(Config),
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
        self.command.unwrap_or(Command::Serve(self.serve))
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
    /// Threads of the compute pool: long advances and large bodies wait for one of them; the processor is shared.
    #[arg(long, value_name = "N", env = "POINTMASS_THREADS", default_value_t = default_threads(), value_parser = positive)]
    pub threads: usize,
    /// Threads that read requests and write answers.
    #[arg(long, value_name = "N", env = "POINTMASS_WORKERS", default_value_t = default_workers(), value_parser = positive)]
    pub workers: usize,
    /// A name that the Host header may have besides loopback names and addresses; repeatable.
    #[arg(long, value_name = "NAME", env = "POINTMASS_ALLOW_HOST", value_delimiter = ',')]
    pub allow_host: Vec<String>,
    /// A web origin, like <https://example.org>, whose pages may use the service; repeatable.
    #[arg(long, value_name = "ORIGIN", env = "POINTMASS_ALLOW_ORIGIN", value_delimiter = ',')]
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
    /// The most particles of a world: about 150 MB when every property differs.
    #[arg(long, value_name = "N", env = "POINTMASS_PARTICLES_MAX", default_value_t = 1_000_000)]
    pub particles_max: u64,
    /// The most steps of one advance.
    #[arg(long, value_name = "N", env = "POINTMASS_STEPS_MAX", default_value_t = 1_000_000)]
    pub steps_max: u64,
    /// The most steps x particles of one advance: about a minute of one core.
    #[arg(long, value_name = "N", env = "POINTMASS_PARTICLE_STEPS_MAX", default_value_t = 20_000_000_000)]
    pub particle_steps_max: u64,
    /// The largest request body: two hundred thousand particles in JSON.
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
    fn default() -> Self {
        #[derive(Parser)]
        struct Defaults {
            #[command(flatten)]
            config: Config,
        }
        Defaults::parse_from(["pointmass"]).config
    }
}

impl Config {
    pub(crate) fn limits(&self) -> Limits {
        Limits { particles: self.particles_max, steps: self.steps_max, particle_steps: self.particle_steps_max }
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

/// More threads than cores: the operating system shares the cores among long advances of different worlds.
fn default_threads() -> usize {
    (2 * cores()).max(4)
}

/// Requests are short and the client is often on the same machine: half of the cores answer as fast as all of them.
fn default_workers() -> usize {
    (cores() / 2).max(1)
}

fn positive(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("must be at least 1".to_owned()),
        Ok(n) => Ok(n),
        Err(error) => Err(format!("{error}")),
    }
}
