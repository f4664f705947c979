//! The monitor, independent of its display: axes and links of its source, and the log of frames.

use std::time::Duration;

use polepair_core::time::Instant;
use polepair_link::clock;

use super::source::{AxisRow, FrameSink, MonitorSource, SourceStatus};
use super::traffic::TrafficLog;
use crate::problem::Result;

/// A monitor of a source: a link of this program, or a server.
pub struct Monitor<S: MonitorSource + ?Sized = dyn MonitorSource> {
    /// Connection string or name that the user gave.
    pub url: String,
    /// Log of the frames.
    pub traffic: TrafficLog,
    /// Index of the chosen axis, of which more signals are read.
    pub chosen: usize,
    started_at: Instant,
    pub source: S,
}

impl<S: MonitorSource> Monitor<S> {
    /// Starts to monitor a source.
    pub fn new(source: S, url: &str, traffic: TrafficLog) -> Self {
        let started_at = source.now();
        Self { url: url.to_owned(), traffic, chosen: 0, started_at, source }
    }
}

impl<S: MonitorSource + ?Sized> Monitor<S> {
    /// Time since the monitor started.
    pub fn age(&self) -> Duration {
        self.source.now().since(self.started_at)
    }

    /// Start of the monitor, in nanoseconds since 1970, as frames have it.
    pub fn started_ns(&self) -> u64 {
        clock::wall_ns(self.started_at)
    }

    /// Every axis.
    pub fn axes(&self) -> Vec<AxisRow> {
        self.source.axes()
    }

    /// Condition of the links.
    pub fn status(&self) -> SourceStatus {
        self.source.status()
    }

    /// Counts of flaws of the links and their frames, with their words.
    pub fn flaws(&self) -> Vec<(u64, &'static str)> {
        let status = self.status();
        let wrong = self.traffic.counts().1;
        let lost = self.traffic.lost + status.lost;
        status.flaws.into_iter().chain([(wrong, "wrong"), (lost, "lost")]).collect()
    }

    /// Takes received frames and values. Returns whether a round of values is to be printed.
    ///
    /// # Errors
    /// The link or the server is lost and does not come back.
    pub fn poll(&mut self, show: &mut FrameSink<'_>) -> Result<bool> {
        let round = self.source.poll(self.chosen, &mut self.traffic, show)?;
        self.traffic.update_rates(self.source.now());
        Ok(round)
    }
}
