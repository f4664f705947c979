//! Charts of signals over time, in a terminal or as SVG.
//!
//! A chart has as many points as it can show. Each is an interval with its first, minimum, maximum and last
//! value, so no spike is lost. The line is interrupted where values are missing.
//!
//! Why: CAP-7.

mod scale;
mod series;
mod svg;
mod terminal;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use polepair_core::convert::saturating;

use crate::decoder::DecodedFrame;
use crate::filter::Glob;
use crate::session::{InternedName, SessionNotice, intern};
use crate::timestamp::Timestamp;

pub use series::Series;

/// Lines of a picture.
pub const SERIES_MAX: usize = 64;
/// Limit of names of other signals that are kept for an error.
const OTHERS_MAX: usize = 256;

/// Signals that are being gathered.
#[derive(Clone, Debug, Default)]
pub struct Plot {
    patterns: Vec<Glob>,
    first: Option<Timestamp>,
    last: Option<Timestamp>,
    series: BTreeMap<(InternedName, u32, InternedName), Series>,
    other_signals: BTreeSet<(u32, InternedName)>,
    current_link: InternedName,
    /// Values of further lines than a picture has.
    pub dropped_values: u64,
}

/// Lines, and whose they are.
type PanelLines<'p> = Vec<(String, &'p Series)>;

/// Lines with a scale in common.
struct PlotPanel<'p> {
    title: String,
    lines: PanelLines<'p>,
    /// Least and greatest value, with room around them.
    range: (f64, f64),
}

impl Plot {
    /// For signals such as `*/Actual/Position`, `2/Setpoint/*`, `Actual/Torque`.
    #[must_use]
    pub fn new(patterns: Vec<Glob>) -> Self {
        Self { patterns, ..Self::default() }
    }

    /// Takes a frame. Its time counts, its signals if they are wanted.
    pub fn add_frame(&mut self, event: &DecodedFrame<'_>) {
        self.note_time(event);
        for notice in event.notices {
            let SessionNotice::Signal(signal) = notice else { continue };
            if !self.patterns.iter().any(|glob| glob.matches_signal(signal.axis, signal.name)) {
                if self.other_signals.len() < OTHERS_MAX {
                    self.other_signals.insert((signal.axis, signal.name));
                }
                continue;
            }
            let Some((time, first)) = event.time.zip(self.first) else { continue };
            if !signal.value.is_finite() {
                continue;
            }
            if self.current_link != event.link {
                self.current_link = intern(event.link);
            }
            let key = (self.current_link, signal.axis, signal.name);
            if self.series.len() == SERIES_MAX && !self.series.contains_key(&key) {
                self.dropped_values += 1;
                continue;
            }
            let series = self.series.entry(key).or_insert_with(|| Series::new(signal.unit));
            series.add(time.since(first), signal.value);
        }
    }

    /// Adds a value of an axis that is not from a capture; times count from zero.
    pub fn add_value(&mut self, axis: u32, name: &str, unit: &str, time: Duration, value: f64) {
        let key = (self.current_link, axis, intern(name));
        let series = self.series.entry(key).or_insert_with(|| Series::new(intern(unit)));
        series.add(saturating(time.as_nanos()), value);
    }

    /// A frame whose signals are not wanted: its time counts alone.
    pub fn note_time(&mut self, event: &DecodedFrame<'_>) {
        self.first = self.first.or(event.time);
        self.last = self.last.max(event.time);
    }

    /// True without a single value.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.series.is_empty()
    }

    /// Signals that were there and not asked for, as `AXIS/NAME`.
    pub fn other_signals(&self) -> impl Iterator<Item = String> {
        self.other_signals.iter().map(|(axis, name)| format!("{axis}/{name}"))
    }

    /// The plot in characters, `width` columns wide: braille dots, each line in a colour, or without colours in a panel
    /// of its own.
    #[must_use]
    pub fn terminal(&self, width: usize, colour: bool) -> String {
        terminal::draw(&self.panels(colour), self.span(), width, colour)
    }

    /// The picture as SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        svg::draw(&self.panels(true), self.span(), self.first)
    }

    /// From the first value to the last, ns since the capture began.
    fn span(&self) -> (u64, u64) {
        let ends = self.series.values().filter_map(Series::span);
        let (mut begin, mut end) = (u64::MAX, 0);
        ends.for_each(|(first, last)| (begin, end) = (begin.min(first), end.max(last)));
        if begin < end { (begin, end) } else { (begin.min(end), end.max(begin.min(end) + 1)) }
    }

    /// One for each name of a signal, with its axes; or one for each line.
    fn panels(&self, shared: bool) -> Vec<PlotPanel<'_>> {
        let links: BTreeSet<InternedName> = self.series.keys().map(|(link, ..)| *link).collect();
        let mut panels = BTreeMap::<_, PanelLines<'_>>::new();
        for ((link, axis, name), series) in &self.series {
            let own = (!shared).then_some((*link, *axis));
            let location = if links.len() > 1 { format!("{link} ") } else { String::new() };
            let line = (format!("{location}axis {axis}"), series);
            panels.entry((name, series.unit, own)).or_default().push(line);
        }
        panels
            .into_iter()
            .map(|((name, unit, _), lines)| PlotPanel::new(name, unit, lines))
            .collect()
    }
}

impl<'p> PlotPanel<'p> {
    fn new(name: InternedName, unit: InternedName, lines: PanelLines<'p>) -> Self {
        let unit = if unit.is_empty() { String::new() } else { format!(" [{unit}]") };
        let range = scale::padded_range(lines.iter().map(|(_, series)| series.range()));
        Self { title: format!("{name}{unit}"), lines, range }
    }
}

#[cfg(test)]
mod tests;
