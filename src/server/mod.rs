//! The HTTP service: worlds behind names, JSON or CBOR in, JSON out. The only part of the crate that knows the network.
//!
//! [`Config`] says how, [`App`] holds the worlds, [`service`] is it as a function of requests, [`serve`] puts
//! it behind [`Listener`]s.

mod access;
mod body;
mod cbor;
mod coding;
mod columns;
mod config;
mod content;
mod encoding;
mod extract;
mod follow;
mod front;
mod healthcheck;
mod idempotency;
mod json;
mod listen;
mod log;
mod memory;
mod metrics;
mod openapi;
mod problem;
mod queue;
mod reply;
mod routes;
mod settings;
mod slot;
mod socket;
mod wire;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, RwLock};

use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{Method, Uri};
use tokio::sync::Notify;
use utoipa::openapi::PathItem;
use utoipa_axum::router::OpenApiRouter;

pub use access::{AccessError, Tokens};
pub use config::{Cli, Command, Config, LogFormat};
pub use front::Front;
pub use healthcheck::healthcheck;
pub use listen::{ListenError, Listener, serve};
pub use log::{Log, Writer};

use crate::registry::Registry;
use extract::Target;
use metrics::Metrics;
use problem::{Code, Problem};
use slot::AnySlot;

/// The worlds of a service and what its routes need besides.
#[derive(Debug)]
pub struct App {
    pub(crate) config: Config,
    /// `None`: nobody is asked for one.
    pub(crate) tokens: Option<RwLock<Tokens>>,
    pub(crate) worlds: Registry<AnySlot>,
    pub(crate) shared: Arc<slot::Shared>,
    pub(crate) metrics: Metrics,
    /// Set once the service is to end: not ready for new work.
    pub(crate) draining: AtomicBool,
    /// Told then.
    pub(crate) drain: Notify,
    pub(crate) in_flight: front::InFlight,
    /// Answers that are not yet with the system.
    pub(crate) underway: front::InFlight,
    /// Clients that follow a world.
    pub(crate) followers: front::InFlight,
    pub(crate) request_ids: front::RequestIds,
    /// Makes names that cannot be guessed.
    pub(crate) secret: u64,
    pub(crate) openapi: Bytes,
}

/// Why a service cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Its tokens.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// Its threads.
    #[error("cannot start the threads that --threads asks for: {0}")]
    Threads(std::io::Error),
}

impl App {
    /// A service without worlds.
    ///
    /// # Errors
    /// When the token file cannot be read or has no token, or when the threads cannot be started.
    pub fn new(config: Config) -> Result<Arc<Self>, StartError> {
        let description = documented_routes().to_openapi();
        Ok(Arc::new(Self {
            tokens: config.has_tokens().then(|| Tokens::of(&config)).transpose()?.map(RwLock::new),
            worlds: Registry::new(config.worlds_max),
            shared: Arc::new(slot::Shared::new(&config).map_err(StartError::Threads)?),
            metrics: Metrics::new(description.paths.paths.iter().map(|(path, item)| (path.clone(), methods(item)))),
            draining: AtomicBool::new(false),
            drain: Notify::new(),
            in_flight: front::InFlight::default(),
            underway: front::InFlight::default(),
            followers: front::InFlight::default(),
            request_ids: front::RequestIds::default(),
            secret: front::random(),
            openapi: openapi::document(description).into(),
            config,
        }))
    }

    /// Ends when the service is to end.
    pub(crate) async fn drained(&self) {
        let mut told = std::pin::pin!(self.drain.notified());
        told.as_mut().enable();
        if !self.draining.load(Ordering::SeqCst) {
            told.await;
        }
    }

    /// The world of the path.
    pub(crate) fn slot(&self, target: &Target) -> Result<AnySlot, Problem> {
        self.worlds.get(&target.world).ok_or_else(|| slot::unknown_world(&target.world))
    }
}

fn documented_routes() -> OpenApiRouter<Arc<App>> {
    OpenApiRouter::new()
        .merge(routes::worlds::routes())
        .merge(routes::particles::routes())
        .merge(routes::forces::routes())
        .merge(routes::advance::routes())
        .merge(routes::commands::routes())
        .merge(routes::trajectory::routes())
        .merge(routes::stream::routes())
        .merge(routes::snapshot::routes())
        .merge(routes::service::routes())
        .merge(routes::docs::routes())
}

/// The methods that a path has.
fn methods(item: &PathItem) -> String {
    let described = [
        ("GET, HEAD", &item.get),
        ("PUT", &item.put),
        ("POST", &item.post),
        ("PATCH", &item.patch),
        ("DELETE", &item.delete),
    ];
    let names: Vec<&str> =
        described.into_iter().filter(|(_, operation)| operation.is_some()).map(|(name, _)| name).collect();
    names.join(", ")
}

async fn method_not_allowed(State(app): State<Arc<App>>, method: Method, uri: Uri) -> Problem {
    match app.metrics.template(uri.path()) {
        Some(route) => {
            let detail = format!("{method} is not a method of this path; it has {}", route.methods());
            Problem::new(Code::MethodNotAllowed, detail)
        }
        None => Problem::plain(Code::MethodNotAllowed),
    }
}

/// The service as a function of requests, without a network.
pub fn service(app: &Arc<App>) -> Front {
    let (routes, _) = documented_routes().split_for_parts();
    in_front_of(routes, app)
}

fn in_front_of(routes: Router<Arc<App>>, app: &Arc<App>) -> Front {
    let routes = routes
        .fallback(|| async { Problem::plain(Code::UnknownRoute) })
        .method_not_allowed_fallback(method_not_allowed);
    let routes = match access::cors(&app.config) {
        Some(cors) => routes.layer(cors),
        None => routes,
    };
    Front::new(app, routes.with_state(Arc::clone(app)))
}

#[cfg(test)]
mod tests {
    use super::{App, Config, in_front_of};
    use axum::Router;
    use axum::body::Body;
    use axum::http::Request;
    use axum::routing::get;
    use http_body_util::BodyExt;
    use std::sync::Arc;
    use tower::ServiceExt;

    #[tokio::test]
    async fn a_panic_costs_one_request_and_is_told_like_any_problem() {
        async fn defect() -> &'static str {
            panic!("a defect")
        }
        let app = App::new(Config::default()).expect("no token file");
        let routes: Router<Arc<App>> = Router::new().route("/panic", get(defect));
        let service = in_front_of(routes, &app);
        for _ in 0..2 {
            let request = Request::get("/panic").header("host", "localhost").body(Body::empty()).expect("a request");
            let response = service.clone().oneshot(request).await.expect("infallible");
            assert_eq!(response.status(), 500);
            assert!(response.headers().contains_key("x-request-id"));
            let body = response.into_body().collect().await.expect("in memory").to_bytes();
            let problem: serde_json::Value = serde_json::from_slice(&body).expect("JSON");
            assert_eq!(problem["code"], "internal_error");
        }
    }
}
