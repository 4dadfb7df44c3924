//! The `pointmass` binary: reads its configuration, listens, reads its tokens again on SIGHUP, ends on SIGTERM or
//! SIGINT. Decides nothing.

use std::fmt::Debug;
use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::sync::Arc;

use clap::Parser;
use pointmass::server::{App, Cli, Command, Config, Listener, Log, LogFormat, Tokens, healthcheck, serve};
use tokio::signal::unix::{SignalKind, signal};
use tracing::field::Field;
use tracing_subscriber::field::MakeExt;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::fmt::FormatFields;
use tracing_subscriber::fmt::format::{self, Writer};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

fn main() -> ExitCode {
    let result = match Cli::parse().command() {
        Command::Serve(config) => run(*config),
        Command::Healthcheck { url } => healthcheck(&url),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            let _closed = writeln!(std::io::stderr(), "pointmass: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run(mut config: Config) -> Result<(), String> {
    let log = log_to_standard_error(&config)?;
    config.tokens = Tokens::from_environment().map_err(|error| error.to_string())?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(config.workers)
        .max_blocking_threads(config.blocking_threads())
        .enable_all()
        .build()
        .map_err(|error| format!("cannot start threads: {error}"))?;
    let result = runtime.block_on(listen(config, log.clone()));
    // Whatever still runs has outlasted the drain timeout.
    runtime.shutdown_background();
    log.flush();
    result
}

async fn listen(config: Config, log: Log) -> Result<(), String> {
    let app = App::new(config.clone()).map_err(|error| error.to_string())?;
    let mut signals = Signals::new().map_err(|error| format!("cannot wait for signals: {error}"))?;
    let mut hangup = signal(SignalKind::hangup()).map_err(|error| format!("cannot wait for signals: {error}"))?;
    let mut listeners = Vec::new();
    for address in &config.listen {
        listeners.push(Listener::bind(address, &config).await.map_err(|error| error.to_string())?);
    }
    for listener in &listeners {
        let url = listener.url().map_err(|error| format!("cannot tell where it listens: {error}"))?;
        let mut out = std::io::stdout();
        // Nobody may be reading; that is no reason to stop.
        let _closed = writeln!(out, "pointmass listening on {url}").and_then(|()| out.flush());
    }
    let reloading = Arc::clone(&app);
    tokio::spawn(async move {
        while hangup.recv().await.is_some() {
            let app = Arc::clone(&reloading);
            // No request waits for a file system that is slow.
            let _reloaded = tokio::task::spawn_blocking(move || app.reload_tokens()).await;
        }
    });
    let (finish, finished) = tokio::sync::oneshot::channel();
    tokio::spawn(async move {
        signals.next().await;
        let _gone = finish.send(());
        signals.next().await;
        tracing::warn!("second signal: stopping at once");
        log.flush();
        std::process::exit(1);
    });
    serve(listeners, app, async move {
        let _sent = finished.await;
    })
    .await;
    tracing::info!("stopped");
    Ok(())
}

struct Signals {
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
}

impl Signals {
    fn new() -> std::io::Result<Self> {
        Ok(Self { terminate: signal(SignalKind::terminate())?, interrupt: signal(SignalKind::interrupt())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}

fn log_to_standard_error(config: &Config) -> Result<Log, String> {
    let filter: Targets = config.log.parse().map_err(|error| format!("--log {:?}: {error}", config.log))?;
    let log = Log::start().map_err(|error| format!("cannot start threads: {error}"))?;
    let lines = tracing_subscriber::fmt().with_max_level(LevelFilter::TRACE).with_writer(log.clone());
    match config.log_format {
        // Without styles for names and equal signs, which take a third of the time of a line.
        LogFormat::Text => {
            lines.with_ansi(std::io::stderr().is_terminal()).fmt_fields(fields()).finish().with(filter).init();
        }
        LogFormat::Json => lines.json().finish().with(filter).init(),
    }
    Ok(log)
}

fn fields() -> impl for<'w> FormatFields<'w> {
    let field = |writer: &mut Writer<'_>, field: &Field, value: &dyn Debug| match field.name() {
        "message" => write!(writer, "{value:?}"),
        name => write!(writer, "{name}={value:?}"),
    };
    format::debug_fn(field).delimited(" ")
}
