//! Flags, environment variables and limits.

use std::path::PathBuf;
use std::time::Duration;

use clap::builder::{BoolishValueParser, Resettable};
use clap::{Arg, Args, FromArgMatches, Parser, Subcommand};

use tokio::sync::Semaphore;

use crate::error::Limits;
use crate::server::access::Tokens;

/// The names of the flags that refusals point to.
pub(crate) const PARTICLES_MAX: &str = "particles-max";
pub(crate) const STEPS_MAX: &str = "steps-max";
pub(crate) const PARTICLE_STEPS_MAX: &str = "particle-steps-max";
pub(crate) const INTERACTIONS_MAX: &str = "interactions-max";
pub(crate) const COMMANDS_MAX: &str = "commands-max";
pub(crate) const WORLDS_MAX: &str = "worlds-max";
pub(crate) const BODY_BYTES_MAX: &str = "body-bytes-max";
pub(crate) const SNAPSHOT_BYTES_MAX: &str = "snapshot-bytes-max";
pub(crate) const MEMORY_BYTES_MAX: &str = "memory-bytes-max";
pub(crate) const IN_FLIGHT_BYTES_MAX: &str = "in-flight-bytes-max";
pub(crate) const ANSWER_BYTES_MAX: &str = "--answer-bytes-max";
pub(crate) const DURATION_MAX: &str = "duration-max";
pub(crate) const URI_BYTES_MAX: &str = "uri-bytes-max";
pub(crate) const HEADER_BYTES_MAX: &str = "header-bytes-max";

/// Variables without a flag: every user of a machine can see the arguments of a process.
pub(crate) const TOKEN: &str = "POINTMASS_TOKEN";
pub(crate) const READ_ONLY_TOKEN: &str = "POINTMASS_READ_ONLY_TOKEN";

/// The largest body where it cannot speak of many particles.
pub(crate) const SMALL_BODY_BYTES_MAX: usize = 1 << 20;

/// The most particles or worlds in one answer of a list; the contract's number.
pub(crate) const PAGE_MAX: usize = 100_000;
/// How many come when `limit` is absent.
pub(crate) const PAGE_DEFAULT: usize = 1000;

/// The groups of options in the help, in this order.
const LISTENING: &str = "Listening";
const ACCESS: &str = "Access";
const LOGGING: &str = "Logging";
const THREADS: &str = "Threads";
const WORLDS: &str = "Limits of worlds";
const WORK: &str = "Limits of the work of a request";
const SIZES: &str = "Limits of sizes";
const QUEUES: &str = "Queues";
const RETRIES: &str = "Requests that are sent again";
const CONNECTIONS: &str = "Connections";
const TIMEOUTS: &str = "Timeouts";

/// The groups that `-h` shows: what a newcomer needs.
const SHORT_HELP: [&str; 3] = [LISTENING, ACCESS, LOGGING];

const AFTER_HELP: &str = "\
Without a command it serves. Every option has an environment variable; a flag wins over it.\n\
POINTMASS_TOKEN and POINTMASS_READ_ONLY_TOKEN, each a list with commas, are tokens besides those of --token-file.\n\
Example: pointmass --listen 127.0.0.1:9000 --listen unix:/run/pointmass.sock";

/// Worlds of point-mass particles over HTTP.
#[derive(Debug, Parser)]
#[command(
    version,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = AFTER_HELP
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
    #[command(after_help = AFTER_HELP)]
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
#[command(mut_args(in_short_help))]
pub struct Config {
    /// Where to listen: host:port (port 0: any free one) or unix:PATH; repeatable.
    #[arg(
        long,
        help_heading = LISTENING,
        value_name = "ADDR",
        env = "POINTMASS_LISTEN",
        value_delimiter = ',',
        default_value = "127.0.0.1:8080"
    )]
    pub listen: Vec<String>,
    /// A file with one token a line, of which every request but health checks must carry one.
    ///
    /// A line may be `read-only` and a token. SIGHUP reads it again.
    #[arg(long, help_heading = ACCESS, value_name = "PATH", env = "POINTMASS_TOKEN_FILE")]
    pub token_file: Option<PathBuf>,
    /// Tokens besides those of the file; those of the environment, for example.
    #[arg(skip)]
    pub tokens: Tokens,
    /// Listen beyond loopback without tokens: whoever reaches the port may do everything.
    #[arg(long, help_heading = ACCESS, env = "POINTMASS_INSECURE_NO_AUTH", value_parser = BoolishValueParser::new())]
    pub insecure_no_auth: bool,
    /// A name that the Host header may have besides loopback names and addresses; repeatable.
    #[arg(long, help_heading = ACCESS, value_name = "NAME", env = "POINTMASS_ALLOW_HOST", value_delimiter = ',', value_parser = host_name)]
    pub allow_host: Vec<String>,
    /// A web origin, like <https://example.org>, whose pages may use the service; repeatable.
    #[arg(long, help_heading = ACCESS, value_name = "ORIGIN", env = "POINTMASS_ALLOW_ORIGIN", value_delimiter = ',', value_parser = origin)]
    pub allow_origin: Vec<String>,
    /// What to log.
    ///
    /// `info` adds a line for every request, which the default leaves out: a client that asks 128 times a second would
    /// write a gigabyte a day.
    #[arg(long, help_heading = LOGGING, value_name = "FILTER", env = "POINTMASS_LOG", default_value = "info,pointmass::access=off")]
    pub log: String,
    /// How to write logs to standard error.
    #[arg(long, help_heading = LOGGING, env = "POINTMASS_LOG_FORMAT", value_enum, default_value_t = LogFormat::Text)]
    pub log_format: LogFormat,
    /// Threads that share a large advance. Twice as many long advances run at once; further ones wait.
    #[arg(long, help_heading = THREADS, value_name = "N", env = "POINTMASS_THREADS", default_value_t = cores(), value_parser = threads)]
    pub threads: usize,
    /// Threads that read requests and write answers.
    #[arg(long, help_heading = THREADS, value_name = "N", env = "POINTMASS_WORKERS", default_value_t = default_workers(), value_parser = positive)]
    pub workers: usize,
    /// The most worlds.
    #[arg(long, help_heading = WORLDS, value_name = "N", env = "POINTMASS_WORLDS_MAX", default_value_t = 10_000)]
    pub worlds_max: usize,
    /// The most particles of a world.
    #[arg(long, help_heading = WORLDS, value_name = "N", env = "POINTMASS_PARTICLES_MAX", default_value_t = 1_000_000)]
    pub particles_max: u64,
    /// The most memory of all worlds together, counted as 256 bytes for each particle.
    #[arg(long, help_heading = WORLDS, value_name = "BYTES", env = "POINTMASS_MEMORY_BYTES_MAX", default_value_t = 2 << 30)]
    pub memory_bytes_max: u64,
    /// The most steps of one advance.
    #[arg(long, help_heading = WORK, value_name = "N", env = "POINTMASS_STEPS_MAX", default_value_t = 1_000_000)]
    pub steps_max: u64,
    /// The most steps x particles of one advance: some seconds of one core.
    #[arg(long, help_heading = WORK, value_name = "N", env = "POINTMASS_PARTICLE_STEPS_MAX", default_value_t = 20_000_000_000)]
    pub particle_steps_max: u64,
    /// The most interactions of one advance, under gravitation: half a minute of one core.
    #[arg(long, help_heading = WORK, value_name = "N", env = "POINTMASS_INTERACTIONS_MAX", default_value_t = 20_000_000_000)]
    pub interactions_max: u64,
    /// The most simulated seconds of one advance; by default what a clock can hold, 2^400.
    #[arg(long, help_heading = WORK, value_name = "SECONDS", env = "POINTMASS_DURATION_MAX")]
    pub duration_max: Option<f64>,
    /// The most commands of one batch.
    #[arg(long, help_heading = WORK, value_name = "N", env = "POINTMASS_COMMANDS_MAX", default_value_t = 10_000)]
    pub commands_max: usize,
    /// The largest request body where it speaks of many particles: two hundred thousand of them; elsewhere 1 MiB.
    #[arg(long, help_heading = SIZES, value_name = "BYTES", env = "POINTMASS_BODY_BYTES_MAX", default_value_t = 64 << 20)]
    pub body_bytes_max: usize,
    /// The largest snapshot that is restored: as large as the largest answer.
    #[arg(long, help_heading = SIZES, value_name = "BYTES", env = "POINTMASS_SNAPSHOT_BYTES_MAX", default_value_t = 256 << 20)]
    pub snapshot_bytes_max: usize,
    /// The largest answer: position and velocity of a million particles, and half as much again.
    #[arg(long, help_heading = SIZES, value_name = "BYTES", env = "POINTMASS_ANSWER_BYTES_MAX", default_value_t = 256 << 20)]
    pub answer_bytes_max: u64,
    /// The longest path with its parameters: a thousand ids, and room.
    #[arg(long, help_heading = SIZES, value_name = "BYTES", env = "POINTMASS_URI_BYTES_MAX", default_value_t = 16 << 10)]
    pub uri_bytes_max: usize,
    /// The most bytes of the headers of a request.
    #[arg(long, help_heading = SIZES, value_name = "BYTES", env = "POINTMASS_HEADER_BYTES_MAX", default_value_t = 16 << 10)]
    pub header_bytes_max: usize,
    /// The most memory for the bodies and answers of all requests at once; above it they are told to come back.
    #[arg(long, help_heading = QUEUES, value_name = "BYTES", env = "POINTMASS_IN_FLIGHT_BYTES_MAX", default_value_t = 2 << 30)]
    pub in_flight_bytes_max: u64,
    /// The most requests that wait for one world; further ones are told to come back.
    #[arg(long, help_heading = QUEUES, value_name = "N", env = "POINTMASS_WORLD_QUEUE_MAX", default_value_t = 256)]
    pub world_queue_max: usize,
    /// The most requests that wait for a processor, and for a place for a long advance; further ones are told to come
    /// back.
    #[arg(long, help_heading = QUEUES, value_name = "N", env = "POINTMASS_QUEUE_MAX", default_value_t = 1024)]
    pub queue_max: usize,
    /// How long a request waits for its world, or for a place for a long advance.
    #[arg(long, help_heading = QUEUES, value_name = "MS", env = "POINTMASS_QUEUE_TIMEOUT_MS", default_value_t = 30_000)]
    pub queue_timeout_ms: u64,
    /// How long a request that is not long waits for a processor: then the service is over its capacity.
    #[arg(long, help_heading = QUEUES, value_name = "MS", env = "POINTMASS_SHED_AFTER_MS", default_value_t = 100)]
    pub shed_after_ms: u64,
    /// The most answers to changes with an Idempotency-Key that a world keeps.
    #[arg(long, help_heading = RETRIES, value_name = "N", env = "POINTMASS_KEYS_MAX", default_value_t = 1024)]
    pub keys_max: usize,
    /// How long it keeps them.
    #[arg(long, help_heading = RETRIES, value_name = "MS", env = "POINTMASS_KEY_LIFETIME_MS", default_value_t = 600_000)]
    pub key_lifetime_ms: u64,
    /// The most connections at once; further ones wait to be accepted.
    #[arg(long, help_heading = CONNECTIONS, value_name = "N", env = "POINTMASS_CONNECTIONS_MAX", default_value_t = 1024, value_parser = positive)]
    pub connections_max: usize,
    /// The same from one address beyond loopback; further ones are closed.
    #[arg(long, help_heading = CONNECTIONS, value_name = "N", env = "POINTMASS_ADDRESS_CONNECTIONS_MAX", default_value_t = 64, value_parser = positive)]
    pub address_connections_max: usize,
    /// The most requests at once on one connection (HTTP/2).
    #[arg(long, help_heading = CONNECTIONS, value_name = "N", env = "POINTMASS_STREAMS_MAX", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..))]
    pub streams_max: u32,
    /// How long the headers of a request may take, from their first byte.
    #[arg(long, help_heading = TIMEOUTS, value_name = "MS", env = "POINTMASS_HEADER_TIMEOUT_MS", default_value_t = 5_000)]
    pub header_timeout_ms: u64,
    /// How long a request's body may take.
    #[arg(long, help_heading = TIMEOUTS, value_name = "MS", env = "POINTMASS_BODY_TIMEOUT_MS", default_value_t = 30_000)]
    pub body_timeout_ms: u64,
    /// How long a client may take over its answer, besides what it takes at --write-rate-min.
    #[arg(long, help_heading = TIMEOUTS, value_name = "MS", env = "POINTMASS_WRITE_TIMEOUT_MS", default_value_t = 30_000)]
    pub write_timeout_ms: u64,
    /// The bytes a second that a client takes of a large answer at least.
    #[arg(long, help_heading = TIMEOUTS, value_name = "BYTES", env = "POINTMASS_WRITE_RATE_MIN", default_value_t = 1 << 20, value_parser = clap::value_parser!(u64).range(1..))]
    pub write_rate_min: u64,
    /// How long a connection may be idle.
    #[arg(long, help_heading = TIMEOUTS, value_name = "MS", env = "POINTMASS_IDLE_TIMEOUT_MS", default_value_t = 30_000)]
    pub idle_timeout_ms: u64,
    /// How long to finish what is in flight after SIGTERM or SIGINT.
    #[arg(long, help_heading = TIMEOUTS, value_name = "MS", env = "POINTMASS_DRAIN_TIMEOUT_MS", default_value_t = 60_000)]
    pub drain_timeout_ms: u64,
}

/// Leaves what a newcomer does not need to the long help.
fn in_short_help(arg: Arg) -> Arg {
    let is_common = arg.get_help_heading().is_none_or(|heading| SHORT_HELP.contains(&heading));
    arg.hide_short_help(!is_common)
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
    /// Whether requests must carry a token.
    pub(crate) fn has_tokens(&self) -> bool {
        self.token_file.is_some() || !self.tokens.is_empty()
    }

    pub(crate) fn limits(&self) -> Limits {
        Limits {
            particles: self.particles_max,
            steps: self.steps_max,
            particle_steps: self.particle_steps_max,
            interactions: self.interactions_max,
        }
    }

    /// The most objects in a body: particles, and commands, none of which has more than four.
    pub(crate) fn objects_max(&self) -> u64 {
        let commands = (self.commands_max as u64).saturating_mul(4);
        self.particles_max.saturating_add(commands).saturating_add(self.worlds_max as u64)
    }

    /// How many long advances may run at once. More than cores: the operating system shares those among worlds.
    pub(crate) fn long_places(&self) -> usize {
        2 * self.threads
    }

    /// How much other work may run at once in the compute pool.
    pub(crate) fn short_places() -> usize {
        (2 * cores()).max(4)
    }

    /// Threads of the compute pool: one for each place.
    #[must_use]
    pub fn blocking_threads(&self) -> usize {
        self.long_places() + Self::short_places()
    }

    pub(crate) fn header_timeout(&self) -> Duration {
        Duration::from_millis(self.header_timeout_ms)
    }

    pub(crate) fn idle_timeout(&self) -> Duration {
        Duration::from_millis(self.idle_timeout_ms)
    }

    pub(crate) fn body_timeout(&self) -> Duration {
        Duration::from_millis(self.body_timeout_ms)
    }

    pub(crate) fn write_timeout(&self) -> Duration {
        Duration::from_millis(self.write_timeout_ms)
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

/// A name as it is compared with the Host header: the port of that does not matter, and addresses need no permission.
fn host_name(text: &str) -> Result<String, String> {
    if text.is_empty() || text.contains(['/', ':', '*', ' ']) {
        return Err("is not a name like physics.example, without scheme and port".to_owned());
    }
    Ok(text.to_owned())
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
