//! Sockets: binding, accepting, ending.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;

use crate::server::early::Early;
use crate::server::{App, Config, router};

/// A socket that accepts connections.
#[derive(Debug)]
pub enum Listener {
    /// `host:port`.
    Tcp(TcpListener),
    /// `unix:PATH`; the file is removed at the end.
    Unix(UnixListener, PathBuf),
}

/// Why the service does not listen.
#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    /// The system refused.
    #[error("cannot listen on {address}: {source}")]
    Refused {
        /// As given.
        address: String,
        /// What the system says.
        source: io::Error,
    },
    /// Reachable from elsewhere, and nobody is asked who they are.
    #[error(
        "{address} is reachable from other machines: give --token-file, or --insecure-no-auth if everyone who can \
         reach it may use it"
    )]
    Open {
        /// As given.
        address: String,
    },
    /// Another process listens there.
    #[error("cannot listen on {address}: a service answers there already")]
    InUse {
        /// As given.
        address: String,
    },
}

impl Listener {
    /// Binds `host:port` or `unix:PATH`.
    ///
    /// # Errors
    /// When the system refuses, or the address is beyond loopback while the configuration asks nobody for a token.
    pub async fn bind(address: &str, config: &Config) -> Result<Self, ListenError> {
        let refused = |source| ListenError::Refused { address: address.to_owned(), source };
        if let Some(path) = address.strip_prefix("unix:") {
            return match bind_unix(Path::new(path)).await {
                Err(error) if error.kind() == io::ErrorKind::AddrInUse => {
                    Err(ListenError::InUse { address: address.to_owned() })
                }
                bound => bound.map_err(refused),
            };
        }
        let open = config.token_file.is_none() && !config.insecure_no_auth;
        let addresses: Vec<_> = tokio::net::lookup_host(address).await.map_err(refused)?.collect();
        if open && !addresses.iter().all(|address| address.ip().is_loopback()) {
            return Err(ListenError::Open { address: address.to_owned() });
        }
        Ok(Self::Tcp(TcpListener::bind(addresses.as_slice()).await.map_err(refused)?))
    }

    /// Where it listens: `http://host:port` with the port that the system chose for port 0, or `unix:PATH`.
    ///
    /// # Errors
    /// When the system does not tell.
    pub fn url(&self) -> io::Result<String> {
        match self {
            Self::Tcp(listener) => Ok(format!("http://{}", listener.local_addr()?)),
            Self::Unix(_, path) => Ok(format!("unix:{}", path.display())),
        }
    }
}

/// A socket that only its owner can use. One that a dead process left behind is taken over.
async fn bind_unix(path: &Path) -> io::Result<Listener> {
    use std::os::unix::fs::{FileTypeExt, PermissionsExt};
    if std::fs::symlink_metadata(path).is_ok_and(|file| file.file_type().is_socket()) {
        if UnixStream::connect(path).await.is_ok() {
            return Err(io::ErrorKind::AddrInUse.into());
        }
        std::fs::remove_file(path)?;
    } else if path.exists() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "there is a file that is not a socket"));
    }
    let listener = UnixListener::bind(path)?;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))?;
    Ok(Listener::Unix(listener, path.to_owned()))
}

/// Once every request is answered: how long its client may take to read the answer, and one with half a request to
/// send the rest.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// Answers on all listeners until `shutdown` resolves; then finishes what is in flight, within the drain timeout.
///
/// While it finishes, it goes on listening: new requests are told to come back, and `/readyz` says why.
pub async fn serve(listeners: Vec<Listener>, app: Arc<App>, shutdown: impl Future<Output = ()>) {
    let connections = Arc::new(Connections {
        app: Arc::clone(&app),
        router: router(&app),
        header_timeout: Duration::from_millis(app.config.header_timeout_ms),
        permits: Arc::new(Semaphore::new(app.config.connections_max)),
        graceful: GracefulShutdown::new(),
    });
    let (stop, stopped) = watch::channel(());
    let mut accepting = JoinSet::new();
    for listener in listeners {
        accepting.spawn(accept(listener, Arc::clone(&connections), stopped.clone()));
    }
    shutdown.await;
    app.draining.store(true, Ordering::SeqCst);
    tracing::info!("finishing what is in flight");
    let drained = async {
        app.in_flight.none().await;
        stop.send_replace(());
        while accepting.join_next().await.is_some() {}
        // The accept loops, which had the other handles, have ended.
        if let Some(connections) = Arc::into_inner(connections)
            && tokio::time::timeout(CLOSE_TIMEOUT, connections.graceful.shutdown()).await.is_err()
        {
            tracing::info!("closed connections with half a request, or with an answer that nobody took");
        }
    };
    if tokio::time::timeout(Duration::from_millis(app.config.drain_timeout_ms), drained).await.is_err() {
        tracing::warn!("gave up on requests that outlasted --drain-timeout-ms");
    }
}

/// What every connection gets.
struct Connections {
    app: Arc<App>,
    router: Router,
    header_timeout: Duration,
    permits: Arc<Semaphore>,
    graceful: GracefulShutdown,
}

async fn accept(listener: Listener, connections: Arc<Connections>, mut stopped: watch::Receiver<()>) {
    loop {
        tokio::select! {
            biased;
            _ = stopped.changed() => break,
            accepted = connections.accept(&listener) => if let Err(error) = accepted {
                // Out of file descriptors, most likely: they come back as connections end.
                tracing::warn!(%error, "cannot accept");
                tokio::time::sleep(Duration::from_millis(100)).await;
            },
        }
    }
    if let Listener::Unix(_, path) = &listener
        && let Err(error) = std::fs::remove_file(path)
    {
        tracing::warn!(%error, path = %path.display(), "cannot remove the socket");
    }
}

impl Connections {
    /// Waits for a client, and for a place for it.
    async fn accept(&self, listener: &Listener) -> io::Result<()> {
        match listener {
            Listener::Tcp(listener) => {
                let (stream, _) = listener.accept().await?;
                // Answers are small; without this one could wait for the acknowledgement of the one before.
                stream.set_nodelay(true)?;
                self.answer(stream, self.place().await);
            }
            Listener::Unix(listener, _) => {
                let (stream, _) = listener.accept().await?;
                self.answer(stream, self.place().await);
            }
        }
        Ok(())
    }

    async fn place(&self) -> OwnedSemaphorePermit {
        Arc::clone(&self.permits).acquire_owned().await.expect("the semaphore is never closed")
    }

    fn answer(&self, stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, permit: OwnedSemaphorePermit) {
        let stream = Early::new(stream, Arc::clone(&self.app));
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(self.header_timeout)
            .serve_connection(TokioIo::new(stream), TowerToHyperService::new(self.router.clone()));
        let connection = self.graceful.watch(connection);
        tokio::spawn(async move {
            if let Err(error) = connection.await {
                tracing::debug!(%error, "connection ended");
            }
            drop(permit);
        });
    }
}
