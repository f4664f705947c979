//! Counters for Prometheus.

use polepair_core::convert::saturating;
use std::fmt::Write as _;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::message::{BenchView, LinkState};

/// Buckets of the durations of commands and stops, from the client's message to the outcome: 0.1 ms to 6.5 s.
const STEPS: u16 = 17;

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct CodeLabel {
    code: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct LinkLabels {
    link: u16,
    what: String,
}

/// The gateway's counters.
#[derive(Debug)]
pub struct Metrics {
    registry: Registry,
    answers: Family<CodeLabel, Counter>,
    refusals: Family<CodeLabel, Counter>,
    link_counts: Family<LinkLabels, Gauge<i64>>,
    link_loads: Family<LinkLabels, Gauge<f64, AtomicU64>>,
    links_lost: Gauge,
    /// Connections that are open.
    pub connections: Gauge,
    /// Browsers and programs that watch.
    pub viewers: Gauge,
    /// Samples and frames that slow viewers did not get.
    pub dropped: Counter,
    /// Seconds from a command to its outcome.
    pub commands: Histogram,
    /// Seconds from a stop until nothing is left to be seen of it.
    pub stops: Histogram,
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("polepair");
        let metrics = Self {
            answers: Family::default(),
            refusals: Family::default(),
            link_counts: Family::default(),
            link_loads: Family::default(),
            links_lost: Gauge::default(),
            connections: Gauge::default(),
            viewers: Gauge::default(),
            dropped: Counter::default(),
            commands: latency_buckets(),
            stops: latency_buckets(),
            registry: Registry::default(),
        };
        let m = &metrics;
        registry.register("http_answers", "HTTP responses by status", m.answers.clone());
        registry.register("refusals", "Refused requests by code", m.refusals.clone());
        registry.register("link", "Counters of each link", m.link_counts.clone());
        registry.register("link_load_ratio", "Load of each wire, 0 to 1", m.link_loads.clone());
        registry.register("links_lost", "Links that are not open", m.links_lost.clone());
        registry.register("connections", "Open connections", m.connections.clone());
        registry.register("viewers", "Open WebSocket connections", m.viewers.clone());
        registry.register("dropped", "Samples and frames that were dropped", m.dropped.clone());
        let seconds = Unit::Seconds;
        registry.register_with_unit(
            "command",
            "Time from a command to its outcome",
            seconds.clone(),
            m.commands.clone(),
        );
        registry.register_with_unit(
            "stop",
            "Time from a stop request to its end",
            seconds,
            m.stops.clone(),
        );
        Self { registry, ..metrics }
    }
}

fn latency_buckets() -> Histogram {
    Histogram::new(exponential_buckets(0.0001, 2.0, STEPS))
}

impl Metrics {
    /// Counts an answer.
    pub fn count_response(&self, status: u16) {
        self.answers.get_or_create(&CodeLabel { code: status.to_string() }).inc();
    }

    /// Counts a refusal.
    pub fn count_refusal(&self, code: &str) {
        self.refusals.get_or_create(&CodeLabel { code: code.to_owned() }).inc();
    }

    /// Everything, in Prometheus' text format, with what the links have counted.
    #[must_use]
    pub fn to_openmetrics(&self, bench: &BenchView) -> String {
        for link in &bench.links {
            for counter in &link.counters {
                let count = saturating(counter.count);
                self.link_counts.get_or_create(&link_labels(&counter.name, link.id)).set(count);
            }
            if let Some(load) = link.load {
                self.link_loads.get_or_create(&link_labels("load", link.id)).set(load);
            }
        }
        let lost = bench.links.iter().filter(|link| link.state != LinkState::Open).count();
        self.links_lost.set(saturating(lost));
        let mut text = String::new();
        if let Err(error) = prometheus_client::encoding::text::encode(&mut text, &self.registry) {
            // Writing into a String cannot fail; neither can saying so.
            let _ = writeln!(text, "# {error}");
        }
        text
    }
}

fn link_labels(what: &str, link_id: u16) -> LinkLabels {
    LinkLabels { link: link_id, what: what.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counters_are_reported() {
        let metrics = Metrics::default();
        metrics.count_response(200);
        metrics.count_refusal("gateway.host");
        metrics.commands.observe(0.002);
        let bench = BenchView {
            version: String::new(),
            server_ms: 0.0,
            scopes: vec![],
            links: vec![],
            axes: vec![],
            clashes: vec![],
            looks: vec![],
            search: None,
            lock: None,
            time_scale: None,
        };
        let text = metrics.to_openmetrics(&bench);
        for line in [
            "polepair_http_answers_total{code=\"200\"} 1",
            "polepair_refusals_total{code=\"gateway.host\"} 1",
            "polepair_command_seconds_count 1",
            "# EOF",
        ] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
    }
}
