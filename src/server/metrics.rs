//! What `/metrics` counts.

use axum::http::{Method, StatusCode};
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use crate::command::Advanced;

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct Answer {
    method: String,
    route: String,
    status: u16,
}

/// Counters; clones share them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Metrics {
    answers: Family<Answer, Counter>,
    advances: Counter,
    particle_steps: Counter,
}

impl Metrics {
    /// Routes are few, and so are the methods that have a name here: the number of series is bounded.
    pub(crate) fn answered(&self, method: &Method, route: &str, status: StatusCode) {
        let known =
            [Method::GET, Method::HEAD, Method::PUT, Method::POST, Method::PATCH, Method::DELETE].contains(method);
        let method = if known { method.as_str() } else { "other" };
        let answer = Answer { method: method.to_owned(), route: route.to_owned(), status: status.as_u16() };
        self.answers.get_or_create(&answer).inc();
    }

    pub(crate) fn advanced(&self, advanced: &Advanced) {
        self.advances.inc();
        self.particle_steps.inc_by(advanced.steps * advanced.integrated as u64);
    }

    /// `OpenMetrics` text.
    pub(crate) fn text(&self, worlds: usize, in_flight: u64) -> String {
        let mut registry = Registry::with_prefix("pointmass");
        registry.register("answers", "Requests answered, by route and status", self.answers.clone());
        registry.register("advances", "Advances of worlds", self.advances.clone());
        registry.register("particle_steps", "Particles integrated x steps", self.particle_steps.clone());
        let gauge = |value: u64| {
            let gauge: Gauge = Gauge::default();
            gauge.set(i64::try_from(value).unwrap_or(i64::MAX));
            gauge
        };
        registry.register("worlds", "Worlds held in memory", gauge(worlds as u64));
        registry.register("in_flight", "Requests that have begun and not ended, this one included", gauge(in_flight));
        let mut text = String::new();
        prometheus_client::encoding::text::encode(&mut text, &registry).expect("a String takes all of it");
        text
    }
}
