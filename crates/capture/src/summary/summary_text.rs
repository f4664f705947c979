//! The summary as text: one screen if there is no fault.

use std::fmt::Write as _;

use polepair_core::escape::EscapedText;
use polepair_core::profile::Profile;
use polepair_core::proto;

use super::{
    AnomalyBurst, AxisKey, AxisSummary, FrameKind, LinkSummary, RequestSummary, StateHistory,
    Summary,
};
use crate::date;
use crate::decoder::profile_speaks;
use crate::number_text::plural;
use crate::session::{ExchangeOutcome, InternedName};
use crate::text::DurationText;
use crate::timestamp::Timestamp;

/// Moments that are shown.
pub const BURSTS_SHOWN: usize = 10;
/// Rows of a table that are shown; further ones are counted.
const ROWS_MAX: usize = 12;
/// Changes of a state that are shown one by one.
const CHANGES_SHOWN: usize = 6;

/// State, or value, by which an axis identifies itself.
const PRODUCT: InternedName = "product";

/// Style of a summary.
#[derive(Clone, Debug, Default)]
pub struct SummaryStyle {
    /// With ANSI colours.
    pub colour: bool,
    /// Bit rates that are stated, by link; the empty name is for all others.
    pub rates: Vec<(String, u32)>,
    /// The drive whose names are used.
    pub product: Option<&'static Profile>,
}

impl SummaryStyle {
    /// Product of an axis: a drive of its protocol, unless it identified itself in the capture.
    #[must_use]
    pub fn product(&self, who: AxisKey, axis: &AxisSummary) -> Option<InternedName> {
        let report = axis.states.iter().find(|(what, _)| *what == PRODUCT);
        report
            .is_none()
            .then(|| {
                let dissector = proto::find_dissector(who.protocol)?;
                self.product
                    .filter(|profile| profile_speaks(profile, dissector))
                    .map(|profile| profile.title)
            })
            .flatten()
    }

    /// The bit rate of a link, and true where it is stated.
    #[must_use]
    pub fn rate(&self, name: &str, link: &LinkSummary) -> Option<(u32, bool)> {
        let stated = |wanted: &str| self.rates.iter().find(|(link, _)| link == wanted);
        let stated = stated(name).or_else(|| stated("")).map(|(_, rate)| (*rate, true));
        stated.or_else(|| {
            link.load.estimated_bit_rate().filter(|_| link.can).map(|rate| (rate, false))
        })
    }
}

/// The summary as text.
#[must_use]
pub fn render_text(summary: &Summary, manner: &SummaryStyle) -> String {
    let mut page = SummaryWriter { out: String::new(), colour: manner.colour };
    page.write_header(summary);
    page.write_links(summary, manner);
    page.write_axes(summary, manner);
    page.write_requests(summary);
    page.write_kinds(summary);
    page.write_faults(summary);
    page.write_anomalies(summary);
    page.write_footer(summary);
    page.out
}

struct SummaryWriter {
    out: String,
    colour: bool,
}

impl SummaryWriter {
    fn write_header(&mut self, summary: &Summary) {
        let length = DurationText(summary.length_ns());
        let _ = write!(self.out, "{} in {length}", plural(summary.frames, "frame"));
        if let Some((first, _)) = summary.span.filter(|(first, _)| is_date(*first)) {
            let _ = write!(self.out, " from {}", date::format_utc(first));
        }
        if summary.defective > 0 {
            let _ = write!(self.out, "; {} break their protocol", summary.defective);
        }
        self.out.push('\n');
    }

    fn write_links(&mut self, summary: &Summary, manner: &SummaryStyle) {
        let seconds = summary.length_ns() as f64 / 1e9;
        let mut rows = vec![row(["links", "frames", "per s", "load", "peak", "bit rate", ""])];
        for (name, link) in summary.links.iter() {
            let rate = manner.rate(name, link);
            let mean = link.load.bits() as f64 / seconds.max(1e-9);
            let text = match rate {
                Some((rate, true)) => format!("{} kbit/s", f64::from(rate) / 1e3),
                Some((rate, false)) => format!("~{} kbit/s", f64::from(rate) / 1e3),
                None => "not known".to_owned(),
            };
            let per_s = if seconds == 0.0 { 0.0 } else { link.frames as f64 / seconds };
            let protocols: Vec<&str> = link.protocols.keys().copied().collect();
            rows.push(vec![
                format!("  {name}"),
                link.frames.to_string(),
                format!("{per_s:.1}"),
                share_text(mean, seconds, &rate),
                share_text(link.load.peak_per_s(summary.length_ns()), seconds, &rate),
                text,
                protocols.join(", "),
            ]);
        }
        self.write_table(rows, &[1, 2, 3, 4]);
    }

    /// Each axis; states that changed on lines of their own.
    fn write_axes(&mut self, summary: &Summary, manner: &SummaryStyle) {
        let end = summary.span.map(|(_, last)| last);
        let widest = summary.axes.keys().map(|who| axis_label(*who).chars().count()).max();
        let Some(width) = widest else { return };
        self.write_heading(&format!("{:<1$}  {2:>8}", "who", width + 2, "frames"));
        for (who, axis) in summary.axes.iter() {
            let (steady, changing): (Vec<_>, Vec<_>) =
                axis.states.iter().partition(|(_, states)| states.count <= 1);
            let mut parts = product_text(summary, *who, manner.product(*who, axis));
            let states = steady.iter().filter_map(|(what, states)| Some((what, states.current?.0)));
            parts.extend(states.map(|(what, state)| format!("{what} {state}")));
            let (name, frames, output) = (axis_label(*who), axis.frames, parts.join("; "));
            let line = format!("  {name:<width$}  {frames:>8}  {output}");
            let _ = writeln!(self.out, "{}", line.trim_end());
            for (what, states) in changing {
                let _ = writeln!(self.out, "      {}", timeline(what, states, end));
            }
        }
    }

    fn write_requests(&mut self, summary: &Summary) {
        const HEADS: [&str; 8] =
            ["requests", "count", "done", "refused", "unanswered", "late", "retries", "latency"];
        let mut heads = row(HEADS);
        heads[7] = "median".to_owned();
        heads.extend(["p99".to_owned(), "max".to_owned()]);
        let mut rows = vec![heads];
        let mut all: Vec<(&(AxisKey, InternedName), &RequestSummary)> =
            summary.requests.iter().collect();
        let left = all.len().saturating_sub(ROWS_MAX);
        if left > 0 {
            let trouble =
                |r: &RequestSummary| r.count() - r.count_of(ExchangeOutcome::Done) + r.retries;
            all.sort_by_key(|(_, r)| core::cmp::Reverse((trouble(r), r.count())));
            all.truncate(ROWS_MAX);
            all.sort_by_key(|(key, _)| **key);
        }
        for ((who, op), requests) in all {
            let spread = &requests.latency;
            let span =
                |ns| if spread.count() == 0 { String::new() } else { DurationText(ns).to_string() };
            rows.push(vec![
                format!("  {}  {op}", axis_label(*who)),
                requests.count().to_string(),
                requests.count_of(ExchangeOutcome::Done).to_string(),
                outcome_count_text(ExchangeOutcome::Refused, requests),
                outcome_count_text(ExchangeOutcome::Unanswered, requests),
                outcome_count_text(ExchangeOutcome::Late, requests),
                blank_if_zero(requests.retries),
                span(spread.median()),
                span(spread.quantile(0.99)),
                span(spread.max()),
            ]);
        }
        self.write_table(rows, &[1, 2, 3, 4, 5, 6, 7, 8, 9]);
        self.write_left_out(left, "sort");
    }

    fn write_kinds(&mut self, summary: &Summary) {
        let heads = ["regular", "frames", "period", "p1", "p99", "max"];
        let mut rows = vec![row(heads)];
        let kinds = summary.kinds();
        let mut regular: Vec<&FrameKind> =
            kinds.into_iter().filter(|kind| kind.is_regular()).collect();
        let left = regular.len().saturating_sub(ROWS_MAX);
        if left > 0 {
            regular.sort_by_key(|kind| core::cmp::Reverse(kind.count));
            regular.truncate(ROWS_MAX);
            regular.sort_by_key(|kind| (kind.who, kind.id, kind.kind));
        }
        for kind in regular {
            let gaps = &kind.gaps;
            let id = kind.id.map_or_else(String::new, |(id, _)| format!(" {id:03X}h"));
            rows.push(vec![
                format!("  {}  {}{id}", axis_label(kind.who), kind.kind),
                kind.count.to_string(),
                DurationText(gaps.median()).to_string(),
                DurationText(gaps.quantile(0.01)).to_string(),
                DurationText(gaps.quantile(0.99)).to_string(),
                DurationText(gaps.max()).to_string(),
            ]);
        }
        self.write_table(rows, &[1, 2, 3, 4, 5]);
        self.write_left_out(left, "kind");
    }

    fn write_faults(&mut self, summary: &Summary) {
        if summary.faults.is_empty() {
            return;
        }
        self.write_heading("faults");
        for ((who, code), fault) in summary.faults.iter() {
            let (number, time) = fault.first.unwrap_or_default();
            let at = self.position_text(summary, time, number);
            let times =
                if fault.count > 1 { format!(", {} times", fault.count) } else { "".into() };
            let gone = if fault.gone { "; gone at the end" } else { "" };
            let (red, off) = self.red_codes();
            let _ = writeln!(
                self.out,
                "  {at}  {red}{} fault 0x{code:X}: {}{off}{times}{gone}",
                axis_label(*who),
                fault.text
            );
            for (word, text) in [("cause", fault.cause), ("try", fault.remedy)] {
                if !text.is_empty() {
                    let _ = writeln!(self.out, "{:24}{word}: {text}", "");
                }
            }
        }
    }

    fn write_anomalies(&mut self, summary: &Summary) {
        let oddest = summary.anomalies.most_notable(BURSTS_SHOWN);
        if oddest.is_empty() {
            return;
        }
        self.write_heading("oddest moments");
        for moment in oddest {
            let at = self.position_text(summary, moment.time, moment.number);
            let (red, off) = self.red_codes();
            let AnomalyBurst { kind, who, text, .. } = moment;
            let times = burst_text(moment);
            let (kind, who) = (kind.as_str(), axis_label(*who));
            let _ = writeln!(self.out, "  {at}  {red}{kind}{off}  {who}: {text}{times}");
        }
    }

    fn write_footer(&mut self, summary: &Summary) {
        if summary.dropped > 0 {
            let more = "notices were left out: more kinds than are counted";
            let _ = writeln!(self.out, "{} {more}", summary.dropped);
        }
        let counts: Vec<String> = summary
            .anomalies
            .counts()
            .map(|(kind, count)| format!("{count} {}", kind.as_str()))
            .collect();
        let text = if counts.is_empty() {
            "nothing odd".to_owned()
        } else {
            format!("odd: {}", counts.join(", "))
        };
        self.out.push_str(&text);
        self.out.push('\n');
    }

    /// `   12.345678 #1234`.
    fn position_text(&self, summary: &Summary, time: Option<Timestamp>, number: u64) -> String {
        let first = summary.span.map(|(first, _)| first);
        let since = time.zip(first).map(|(time, first)| time.since(first) as f64 / 1e9);
        let time = since.map_or_else(|| format!("{:>11}", ""), |s| format!("{s:>11.6}"));
        let number = if number == 0 { "at the end".to_owned() } else { format!("#{number}") };
        format!("{time} {number:<10}")
    }

    fn write_heading(&mut self, head: &str) {
        let (dim, off) = if self.colour { ("\x1b[2m", "\x1b[0m") } else { ("", "") };
        let _ = writeln!(self.out, "{dim}{head}{off}");
    }

    fn red_codes(&self) -> (&'static str, &'static str) {
        if self.colour { ("\x1b[31m", "\x1b[0m") } else { ("", "") }
    }

    fn write_left_out(&mut self, count: usize, noun: &str) {
        if count > 0 {
            let more = plural(count as u64, &format!("more {noun}"));
            let _ = writeln!(self.out, "  and {more}; --format json has all");
        }
    }

    /// A table whose first row is its head; columns of `right` are aligned there.
    fn write_table(&mut self, rows: Vec<Vec<String>>, right: &[usize]) {
        if rows.len() < 2 {
            return;
        }
        let columns = rows[0].len();
        let widths: Vec<usize> = (0..columns)
            .map(|at| rows.iter().map(|row| cell_width(row, at)).fold(0, usize::max))
            .collect();
        for (n, row) in rows.iter().enumerate() {
            let mut line = String::new();
            for (at, (text, width)) in row.iter().zip(&widths).enumerate() {
                let gap = if at + 1 < columns { "  " } else { "" };
                let _ = if right.contains(&at) {
                    write!(line, "{text:>width$}{gap}")
                } else {
                    write!(line, "{text:<width$}{gap}")
                };
            }
            match n {
                0 => self.write_heading(line.trim_end()),
                _ => {
                    self.out.push_str(line.trim_end());
                    self.out.push('\n');
                }
            }
        }
    }
}

fn cell_width(row: &[String], at: usize) -> usize {
    row.get(at).map_or(0, |cell| cell.chars().count())
}

fn outcome_count_text(outcome: ExchangeOutcome, requests: &RequestSummary) -> String {
    blank_if_zero(requests.count_of(outcome))
}

fn share_text(bits: f64, seconds: f64, rate: &Option<(u32, bool)>) -> String {
    match *rate {
        _ if seconds == 0.0 => "-".to_owned(),
        Some((rate, _)) => format!("{:.1} %", bits / f64::from(rate) * 100.0),
        None => format!("{:.1} kbit/s", bits / 1e3),
    }
}

/// The product that answered or is stated.
fn product_text(summary: &Summary, who: AxisKey, stated: Option<InternedName>) -> Vec<String> {
    let reported = summary.values.get(&(who, PRODUCT)).and_then(|values| values.exact);
    let output = reported.map(|exact| format!("product {exact}"));
    output.or(stated.map(str::to_owned)).into_iter().collect()
}

/// `can0 canopen 2`.
#[must_use]
pub fn axis_label(who: AxisKey) -> String {
    let axis = who.axis.map_or_else(String::new, |axis| format!(" {axis}"));
    let gap = if who.protocol.is_empty() { "" } else { " " };
    format!("{}{gap}{}{axis}", EscapedText(who.link), who.protocol)
}

/// `power off 0.5 s > on 12.0 s`, or how long each state took where there were many.
fn timeline(what: &str, states: &StateHistory, end: Option<Timestamp>) -> String {
    let mut text = format!("{what} ");
    if states.count as usize <= CHANGES_SHOWN && states.changes.len() == states.count as usize {
        for (n, (time, to)) in states.changes.iter().enumerate() {
            let until = states.changes.get(n + 1).map_or(end, |(time, _)| *time);
            let _ = write!(text, "{}{to}", if n == 0 { "" } else { " > " });
            if let (Some(time), Some(until)) = (time, until) {
                let _ = write!(text, " {}", DurationText(until.since(*time)));
            }
        }
        return text;
    }
    let spent = states.durations_until(end);
    let spent: Vec<String> =
        spent.iter().map(|(to, ns)| format!("{to} {}", DurationText(*ns))).collect();
    let _ = write!(text, "{} changes ({})", states.count, spent.join(", "));
    text
}

fn burst_text(moment: &AnomalyBurst) -> String {
    let span = moment.last.zip(moment.time).map_or(0, |(last, first)| last.since(first));
    match moment.count {
        1 => String::new(),
        count if span == 0 => format!(" ({count} times)"),
        count => format!(" ({count} times in {})", DurationText(span)),
    }
}

fn row<const N: usize>(cells: [&str; N]) -> Vec<String> {
    cells.map(str::to_owned).to_vec()
}

fn blank_if_zero(count: u64) -> String {
    if count == 0 { String::new() } else { count.to_string() }
}

/// Stamps that count from a start of the program are no dates.
fn is_date(stamp: Timestamp) -> bool {
    const YEAR_1990: u64 = 631_152_000_000_000_000;
    stamp.0 >= YEAR_1990
}
