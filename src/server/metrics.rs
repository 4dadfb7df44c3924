//! What `/metrics` tells.

use std::hash::{Hash, Hasher};
use std::sync::Arc;
use std::time::Duration;

use axum::http::Method;
use prometheus_client::encoding::{EncodeLabelSet, EncodeLabelValue, LabelValueEncoder};
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Registry, Unit};

use crate::command::Advanced;
use crate::server::App;
use crate::server::slot::with_slot;

/// Upper ends in seconds: from a request that changes one particle to an advance as long as may be.
const DURATIONS: [f64; 12] = [5e-5, 1e-4, 2.5e-4, 5e-4, 1e-3, 2.5e-3, 5e-3, 16e-3, 0.1, 0.5, 2.5, 10.0];

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Route {
    method: &'static str,
    route: Template,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Answer {
    method: &'static str,
    route: Template,
    status: u16,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct QueueName {
    queue: &'static str,
}

/// Counters.
#[derive(Debug)]
pub(crate) struct Metrics {
    requests: Family<Answer, Counter>,
    durations: Family<Route, Histogram, fn() -> Histogram>,
    advances: Counter,
    particle_steps: Counter,
    particles_deferred: Counter,
    particles_skipped: Counter,
    /// Connections that are open.
    pub(crate) connections: Gauge,
    routes: matchit::Router<Template>,
    no_route: Template,
}

/// The path of a route with names for its parts: `/v1/worlds/{world}`.
#[derive(Debug, Clone)]
pub(crate) struct Template {
    /// By which it is told from the others.
    number: usize,
    text: Arc<str>,
    methods: Arc<str>,
}

impl Template {
    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    /// Those that the route has, separated by commas.
    pub(crate) fn methods(&self) -> &str {
        &self.methods
    }
}

impl PartialEq for Template {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number
    }
}

impl Eq for Template {}

impl Hash for Template {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.number.hash(state);
    }
}

impl EncodeLabelValue for Template {
    fn encode(&self, encoder: &mut LabelValueEncoder<'_>) -> Result<(), std::fmt::Error> {
        self.text.as_ref().encode(encoder)
    }
}

impl Metrics {
    /// With the templates of all routes, and their methods.
    pub(crate) fn new(templates: impl Iterator<Item = (String, String)>) -> Self {
        let mut routes = matchit::Router::new();
        for (number, (template, methods)) in templates.enumerate() {
            let label = Template { number, text: template.as_str().into(), methods: methods.into() };
            routes.insert(template, label).expect("the router of the service takes the same templates");
        }
        Self {
            requests: Family::default(),
            durations: Family::new_with_constructor(|| Histogram::new(DURATIONS)),
            advances: Counter::default(),
            particle_steps: Counter::default(),
            particles_deferred: Counter::default(),
            particles_skipped: Counter::default(),
            connections: Gauge::default(),
            routes,
            no_route: Template { number: usize::MAX, text: "none".into(), methods: "".into() },
        }
    }

    /// That of the route that a path leads to.
    pub(crate) fn template(&self, path: &str) -> Option<&Template> {
        self.routes.at(path).ok().map(|found| found.value)
    }

    /// Routes are few, and so are the methods that have a name here: the number of series is bounded.
    pub(crate) fn answered(&self, method: &Method, route: Option<&Template>, status: u16, duration: Duration) {
        let method = ["GET", "HEAD", "PUT", "POST", "PATCH", "DELETE"].into_iter().find(|known| method == known);
        let method = method.unwrap_or("other");
        let route = route.unwrap_or(&self.no_route).clone();
        self.durations.get_or_create(&Route { method, route: route.clone() }).observe(duration.as_secs_f64());
        self.requests.get_or_create(&Answer { method, route, status }).inc();
    }

    pub(crate) fn advanced(&self, advanced: &Advanced) {
        self.advances.inc();
        self.particle_steps.inc_by(advanced.steps * advanced.integrated as u64);
        self.particles_deferred.inc_by(advanced.deferred as u64);
        self.particles_skipped.inc_by(advanced.skipped as u64);
    }
}

/// `OpenMetrics` text: what was counted, and what is now.
pub(crate) fn text(app: &App) -> String {
    let metrics = &app.metrics;
    let mut registry = Registry::with_prefix("pointmass");
    registry.register("requests", "Requests answered, by route and status", metrics.requests.clone());
    registry.register_with_unit(
        "request_duration",
        "From the headers of a request to those of its answer",
        Unit::Seconds,
        metrics.durations.clone(),
    );
    registry.register("advances", "Advances of worlds", metrics.advances.clone());
    registry.register("particle_steps", "Particles integrated x steps", metrics.particle_steps.clone());
    registry.register(
        "particles_deferred",
        "Particles of advances that are evaluated when they are read",
        metrics.particles_deferred.clone(),
    );
    registry.register(
        "particles_skipped",
        "Particles of advances that nothing can move",
        metrics.particles_skipped.clone(),
    );
    registry.register("connections", "Connections that are open", metrics.connections.clone());
    let mut now = |name: &str, help: &str, unit: Option<Unit>, value: u64| {
        let gauge: Gauge = Gauge::default();
        gauge.set(i64::try_from(value).unwrap_or(i64::MAX));
        match unit {
            Some(unit) => registry.register_with_unit(name, help, unit, gauge),
            None => registry.register(name, help, gauge),
        }
    };
    let worlds = app.worlds.list(None, usize::MAX);
    let particles = worlds.iter().map(|(_, any)| with_slot!(any, slot => slot.particle_count()) as u64).sum();
    now("worlds", "Worlds held in memory", None, worlds.len() as u64);
    now("particles", "Particles of all worlds", None, particles);
    now("followers", "Clients that follow a world", None, app.followers.count());
    now("in_flight", "Requests that have begun and not ended, this one included", None, app.in_flight.count());
    now("worlds_charged", "What worlds take of --memory-bytes-max", Some(Unit::Bytes), app.shared.memory.used());
    now(
        "in_flight_charged",
        "What requests and answers take of --in-flight-bytes-max",
        Some(Unit::Bytes),
        app.shared.in_flight.used(),
    );
    if let Some(bytes) = resident_bytes() {
        now("resident_memory", "Memory of the process that is resident", Some(Unit::Bytes), bytes);
    }
    let depths = Family::<QueueName, Gauge>::default();
    let ages = Family::<QueueName, Gauge<f64, std::sync::atomic::AtomicU64>>::default();
    let of_worlds = worlds.iter().map(|(_, any)| with_slot!(any, slot => slot.queue.depth_and_age()));
    let of_worlds = of_worlds.fold((0, Duration::ZERO), |(depth, age), (more, older)| (depth + more, age.max(older)));
    for (queue, (depth, age)) in [
        ("world", of_worlds),
        ("processor", app.shared.short_places.queue.depth_and_age()),
        ("long_advance", app.shared.long_places.queue.depth_and_age()),
    ] {
        depths.get_or_create(&QueueName { queue }).set(i64::try_from(depth).unwrap_or(i64::MAX));
        ages.get_or_create(&QueueName { queue }).set(age.as_secs_f64());
    }
    registry.register("queue_depth", "Requests that wait for a world, a processor, a place for a long advance", depths);
    registry.register_with_unit("queue_age", "How long the first of them has waited", Unit::Seconds, ages);
    registry.register("build", "The build", Info::new([("version", env!("CARGO_PKG_VERSION"))]));
    let mut text = String::new();
    prometheus_client::encoding::text::encode(&mut text, &registry).expect("a String takes all of it");
    text
}

/// Where the system tells.
fn resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kibibytes: u64 = line.trim().strip_suffix(" kB")?.parse().ok()?;
    Some(kibibytes << 10)
}
