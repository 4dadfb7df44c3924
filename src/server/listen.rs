//! Sockets: binding, accepting, ending.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::convert::Infallible;
use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::body::Body;
use hyper::body::Incoming;
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto;
use hyper_util::server::graceful::GracefulShutdown;
use prometheus_client::metrics::gauge::Gauge;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpSocket, UnixListener, UnixStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::task::JoinSet;

use crate::server::slot::with_slot;
use crate::server::socket::{Activity, Socket};
use crate::server::{App, Config, Front, service};

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
    /// It is not written as an address is.
    #[error("cannot listen on {address}: {remedy}")]
    NotAnAddress {
        /// As given.
        address: String,
        /// What to write.
        remedy: String,
    },
    /// The system refused.
    #[error("cannot listen on {address}: {source}{remedy}")]
    Refused {
        /// As given.
        address: String,
        /// What the system says.
        source: io::Error,
        /// What to do about it, if that is known.
        remedy: &'static str,
    },
    /// Reachable from elsewhere, and nobody is asked who they are.
    #[error(
        "{address} is reachable from other machines: give --token-file or POINTMASS_TOKEN, or --insecure-no-auth if \
         everyone who can reach it may use it"
    )]
    Open {
        /// As given.
        address: String,
    },
    /// Another process listens there.
    #[error("cannot listen on {address}: a service answers there already; stop it, or choose another path")]
    InUse {
        /// As given.
        address: String,
    },
}

impl Listener {
    /// Binds `host:port` or `unix:PATH`.
    ///
    /// # Errors
    /// When it is none of these, when the system refuses, or when the address is beyond loopback while the configuration
    /// asks nobody for a token.
    pub async fn bind(address: &str, config: &Config) -> Result<Self, ListenError> {
        let refused_with = |remedies: &'static [Remedy]| {
            move |source: io::Error| {
                let known = remedies.iter().find(|(kinds, _)| kinds.is_empty() || kinds.contains(&source.kind()));
                ListenError::Refused { address: address.to_owned(), source, remedy: known.map_or("", |known| known.1) }
            }
        };
        if let Some(path) = address.strip_prefix("unix:") {
            return match bind_unix(Path::new(path)).await {
                Err(error) if error.kind() == io::ErrorKind::AddrInUse => {
                    Err(ListenError::InUse { address: address.to_owned() })
                }
                bound => bound.map_err(refused_with(&OF_PATHS)),
            };
        }
        check_form(address).map_err(|remedy| ListenError::NotAnAddress { address: address.to_owned(), remedy })?;
        let open = !config.has_tokens() && !config.insecure_no_auth;
        let addresses: Vec<_> = tokio::net::lookup_host(address).await.map_err(refused_with(&OF_NAMES))?.collect();
        if open && !addresses.iter().all(|address| address.ip().is_loopback()) {
            return Err(ListenError::Open { address: address.to_owned() });
        }
        let mut failure = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
        for address in addresses {
            match listen_on(address, config) {
                Ok(listener) => return Ok(Self::Tcp(listener)),
                Err(error) => failure = error,
            }
        }
        Err(refused_with(&OF_ADDRESSES)(failure))
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

/// Refuses what is not `host:port`, and says what to write.
fn check_form(address: &str) -> Result<(), String> {
    let scheme = address.strip_prefix("http://").or_else(|| address.strip_prefix("https://"));
    if let Some(rest) = scheme {
        let address = rest.trim_end_matches('/');
        check_form(address)?;
        return Err(format!("an address has no scheme; write --listen {address}"));
    }
    if address.starts_with(['/', '.']) {
        return Err(format!("for a Unix socket write --listen unix:{address}"));
    }
    if address.parse::<Ipv6Addr>().is_ok() {
        return Err(format!("an IPv6 address stands in brackets, before its port; write --listen [{address}]:8080"));
    }
    let is_port = |text: &str| text.parse::<u16>().is_ok();
    let (host, port) = match address.rsplit_once(':') {
        Some((host, port)) if !address.ends_with(']') => (host, port),
        _ if address.is_empty() => ("", "8080"),
        _ if is_port(address) => ("", address),
        _ => {
            let form = "an address has a host and a port, like 127.0.0.1:8080";
            return Err(format!("{form}; write --listen {address}:8080"));
        }
    };
    if !is_port(port) {
        return Err(format!("a port is a number from 0 to 65535; write --listen {host}:8080, for example"));
    }
    if host.is_empty() || host == "*" {
        let own = format!("--listen 127.0.0.1:{port} for clients on this machine");
        return Err(format!("an address has a host; write {own}, --listen 0.0.0.0:{port} for all"));
    }
    Ok(())
}

/// What to do about errors of these kinds, or about any.
type Remedy = (&'static [io::ErrorKind], &'static str);

const OF_NAMES: [Remedy; 1] =
    [(&[], "; a host is an IP address of this machine or a name that has one, like 127.0.0.1 or localhost")];

const OF_ADDRESSES: [Remedy; 3] = [
    (&[io::ErrorKind::AddrInUse], "; stop what listens there, or choose another port: 0 takes any that is free"),
    (
        &[io::ErrorKind::AddrNotAvailable],
        "; no interface of this machine has this address, 0.0.0.0 stands for all of them",
    ),
    (&[io::ErrorKind::PermissionDenied], "; ports below 1024 are for the superuser, choose a higher one"),
];

const OF_PATHS: [Remedy; 3] = [
    (&[io::ErrorKind::NotFound], "; its folder must exist"),
    (&[io::ErrorKind::PermissionDenied], "; the service must be allowed to write in its folder"),
    (&[io::ErrorKind::AlreadyExists], "; choose another path, or remove it"),
];

/// A socket with room for as many clients that wait to be accepted as may be connected: where the system has less, a
/// client whose call is dropped tries again after a second.
fn listen_on(address: SocketAddr, config: &Config) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(u32::try_from(config.connections_max).unwrap_or(u32::MAX).min(BACKLOG_MAX))
}

/// The system takes no more anyway.
const BACKLOG_MAX: u32 = 4096;

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

/// Once every answer is taken: how long a client with half a request may take to send the rest.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// Answers on all listeners until `shutdown` resolves; then finishes what is in flight, within the drain timeout.
///
/// While it finishes, it goes on listening: new requests are told to come back, and `/readyz` says why.
pub async fn serve(listeners: Vec<Listener>, app: Arc<App>, shutdown: impl Future<Output = ()>) {
    let connections = Arc::new(Connections::new(&app));
    let (stop, stopped) = watch::channel(());
    let mut accepting = JoinSet::new();
    for listener in listeners {
        accepting.spawn(accept(listener, Arc::clone(&connections), stopped.clone()));
    }
    let forgetting = tokio::spawn(forget_old_answers(Arc::clone(&app)));
    shutdown.await;
    forgetting.abort();
    app.draining.store(true, Ordering::SeqCst);
    app.drain.notify_waiters();
    tracing::info!("finishing what is in flight");
    let drained = async {
        app.in_flight.none().await;
        app.underway.none().await;
        stop.send_replace(());
        while accepting.join_next().await.is_some() {}
        // The accept loops, which had the other handles, have ended.
        if let Some(connections) = Arc::into_inner(connections)
            && tokio::time::timeout(CLOSE_TIMEOUT, connections.graceful.shutdown()).await.is_err()
        {
            tracing::info!("closed connections with half a request");
        }
    };
    if tokio::time::timeout(Duration::from_millis(app.config.drain_timeout_ms), drained).await.is_err() {
        tracing::warn!("gave up on requests that outlasted --drain-timeout-ms");
    }
}

/// Kept answers of worlds that nobody changes any more are given back too.
async fn forget_old_answers(app: Arc<App>) {
    loop {
        tokio::time::sleep(FORGET_EVERY).await;
        for (_, any) in app.worlds.list(None, usize::MAX) {
            with_slot!(any, slot => slot.forget());
        }
    }
}

/// A small part of the time for which answers are kept.
const FORGET_EVERY: Duration = Duration::from_secs(20);

/// What every connection gets.
struct Connections {
    app: Arc<App>,
    front: Front,
    protocol: auto::Builder<TokioExecutor>,
    places: Arc<Semaphore>,
    by_address: Arc<ByAddress>,
    graceful: GracefulShutdown,
}

/// Both protocols on every socket: the first bytes tell.
fn protocol(config: &Config) -> auto::Builder<TokioExecutor> {
    let mut builder = auto::Builder::new(TokioExecutor::new());
    builder.http1().max_buf_size(HTTP1_BUFFER_BYTES);
    let header_bytes = u32::try_from(config.header_bytes_max).unwrap_or(u32::MAX);
    builder
        .http2()
        .max_concurrent_streams(config.streams_max)
        .max_header_list_size(header_bytes)
        .initial_connection_window_size(HTTP2_WINDOW_BYTES)
        .initial_stream_window_size(HTTP2_WINDOW_BYTES)
        .max_send_buf_size(HTTP2_WINDOW_BYTES as usize);
    builder
}

/// What hyper reads ahead, and the most that it takes for a request line and headers before the service sees them: more
/// than the limits of the service, which tell what is wrong.
const HTTP1_BUFFER_BYTES: usize = 128 << 10;

/// What a connection may send ahead of being read, and what an answer on it may be ahead of the socket.
const HTTP2_WINDOW_BYTES: u32 = 256 << 10;

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
    fn new(app: &Arc<App>) -> Self {
        Self {
            app: Arc::clone(app),
            front: service(app),
            protocol: protocol(&app.config),
            places: Arc::new(Semaphore::new(app.config.connections_max)),
            by_address: Arc::default(),
            graceful: GracefulShutdown::new(),
        }
    }

    /// Waits for a client, and for a place for it.
    async fn accept(&self, listener: &Listener) -> io::Result<()> {
        match listener {
            Listener::Tcp(listener) => {
                let (stream, peer) = listener.accept().await?;
                let Some(share) = self.by_address.take(peer.ip(), self.app.config.address_connections_max) else {
                    tracing::debug!(client = %peer.ip(), "more connections than --address-connections-max");
                    return Ok(());
                };
                // Answers are small; without this one could wait for the acknowledgement of the one before.
                stream.set_nodelay(true)?;
                self.answer(stream, (share, self.place().await));
            }
            Listener::Unix(listener, _) => {
                let (stream, _) = listener.accept().await?;
                self.answer(stream, self.place().await);
            }
        }
        Ok(())
    }

    async fn place(&self) -> OwnedSemaphorePermit {
        Arc::clone(&self.places).acquire_owned().await.expect("the semaphore is never closed")
    }

    /// Answers requests until the connection ends; then its places are free again.
    fn answer(
        &self,
        stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
        places: impl Send + Unpin + 'static,
    ) {
        let activity = Arc::<Activity>::default();
        self.app.metrics.connections.inc();
        let places = (places, Open(self.app.metrics.connections.clone()));
        let socket = Socket::new(stream, places, Arc::clone(&self.app), Arc::clone(&activity));
        let (front, app) = (self.front.clone(), Arc::clone(&self.app));
        let service = service_fn(move |request: hyper::Request<Incoming>| {
            let active = activity.begin();
            let app = Arc::clone(&app);
            let answer = front.clone().answer(request.map(Body::new));
            async move { Ok::<_, Infallible>(active.deliver(answer.await, &app)) }
        });
        let connection = self.protocol.serve_connection_with_upgrades(TokioIo::new(socket), service).into_owned();
        let connection = self.graceful.watch(connection);
        tokio::spawn(async move {
            if let Err(error) = connection.await {
                tracing::debug!(error, "connection ended");
            }
        });
    }
}

/// One of the connections that are open.
struct Open(Gauge);

impl Drop for Open {
    fn drop(&mut self) {
        self.0.dec();
    }
}

/// How many connections each address beyond loopback has.
#[derive(Debug, Default)]
struct ByAddress(Mutex<HashMap<IpAddr, usize>>);

/// One of them; `None` for those that are not counted.
struct Share(Option<(Arc<ByAddress>, IpAddr)>);

impl ByAddress {
    /// `None` when there are as many as may be.
    fn take(self: &Arc<Self>, address: IpAddr, max: usize) -> Option<Share> {
        let address = address.to_canonical();
        if address.is_loopback() {
            return Some(Share(None));
        }
        let mut counts = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(address).or_default();
        if *count >= max {
            return None;
        }
        *count += 1;
        Some(Share(Some((Arc::clone(self), address))))
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let Some((counts, address)) = &self.0 else { return };
        let mut counts = counts.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Entry::Occupied(mut count) = counts.entry(*address) {
            *count.get_mut() -= 1;
            if *count.get() == 0 {
                count.remove();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Arc, ByAddress, IpAddr};

    #[test]
    fn an_address_has_so_many_connections_and_loopback_any() {
        let by_address = Arc::<ByAddress>::default();
        let take = |address: &str| by_address.take(address.parse::<IpAddr>().expect("an address"), 2);
        let (first, second) = (take("10.0.0.1"), take("::ffff:10.0.0.1"));
        assert!(first.is_some() && second.is_some() && take("10.0.0.1").is_none());
        assert!(take("10.0.0.2").is_some());
        drop(first);
        let third = take("10.0.0.1");
        assert!(third.is_some() && take("10.0.0.1").is_none());
        let loopback: Vec<_> = (0..10).map(|_| take("127.0.0.1").or_else(|| take("::1"))).collect();
        assert!(loopback.iter().all(Option::is_some));
        drop((second, third));
        assert!(by_address.0.lock().expect("alone").is_empty(), "nothing is kept of those that went");
    }
}
