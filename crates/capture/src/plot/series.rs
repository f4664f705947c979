//! The values of one line, in bounded memory.

use crate::session::Name;
use crate::summary::Spread;

/// Stretches of time that a line has at most. When they are full, each two become one.
const STRETCHES_MAX: usize = 4096;
/// How long a stretch is at first, ns.
const FINEST_NS: u64 = 1000;
/// A gap is this many times as long as the pause that 90 % of all pauses do not exceed.
const GAP_TIMES: u64 = 3;
/// Pauses from which on a gap can be told.
const PAUSES_MIN: u64 = 8;

/// A line.
#[derive(Clone, Debug)]
pub struct Series {
    /// The unit of its values.
    pub unit: Name,
    stretches: Vec<Stretch>,
    /// How long each stretch is, ns.
    each: u64,
    begin: u64,
    pauses: Spread,
    last: u64,
}

/// What happened in a stretch of time; without values its count is 0.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
struct Stretch {
    count: u32,
    begin: u64,
    end: u64,
    first: f64,
    least: f64,
    most: f64,
    last: f64,
}

impl Stretch {
    fn with(self, later: Self) -> Self {
        match (self.count, later.count) {
            (_, 0) => self,
            (0, _) => later,
            _ => Self {
                count: self.count.saturating_add(later.count),
                begin: self.begin.min(later.begin),
                end: self.end.max(later.end),
                first: self.first,
                least: self.least.min(later.least),
                most: self.most.max(later.most),
                last: later.last,
            },
        }
    }
}

impl Series {
    pub(super) fn new(unit: Name) -> Self {
        let (stretches, pauses) = (Vec::new(), Spread::default());
        Self { unit, stretches, each: FINEST_NS, begin: 0, pauses, last: 0 }
    }

    /// Takes a value at a time in ns.
    pub(super) fn take(&mut self, time: u64, value: f64) {
        if self.stretches.is_empty() {
            self.begin = time;
        } else {
            self.pauses.take(time.saturating_sub(self.last));
        }
        self.last = self.last.max(time);
        let mut at = (time.saturating_sub(self.begin) / self.each) as usize;
        while at >= STRETCHES_MAX {
            self.stretches = merged(&self.stretches);
            self.each *= 2;
            at /= 2;
        }
        if at >= self.stretches.len() {
            self.stretches.resize(at + 1, Stretch::default());
        }
        let (first, least, most, last) = (value, value, value, value);
        let one = Stretch { count: 1, begin: time, end: time, first, least, most, last };
        self.stretches[at] = self.stretches[at].with(one);
    }

    /// When the first value came, and the last.
    #[must_use]
    pub fn span(&self) -> Option<(u64, u64)> {
        (!self.stretches.is_empty()).then_some((self.begin, self.last))
    }

    /// The least and the greatest value.
    #[must_use]
    pub fn range(&self) -> (f64, f64) {
        let whole = self.stretches.iter().fold(Stretch::default(), |sum, one| sum.with(*one));
        (whole.least, whole.most)
    }

    /// The lines to draw, each without a gap: times in ns and values. They have at most four points
    /// for each of so many stretches.
    #[must_use]
    pub fn lines(&self, stretches: usize) -> Vec<Vec<(u64, f64)>> {
        let mut drawn = self.stretches.clone();
        while drawn.len() > stretches.max(1) {
            drawn = merged(&drawn);
        }
        let gap = match self.pauses.count() {
            ..PAUSES_MIN => u64::MAX,
            _ => self.pauses.quantile(0.9).saturating_mul(GAP_TIMES),
        };
        let (mut lines, mut end) = (Vec::<Vec<(u64, f64)>>::new(), None);
        for stretch in drawn.iter().filter(|stretch| stretch.count > 0) {
            if end.is_none_or(|end| stretch.begin.saturating_sub(end) > gap) {
                lines.push(Vec::new());
            }
            end = Some(stretch.end);
            if let Some(line) = lines.last_mut() {
                let middle = stretch.begin / 2 + stretch.end / 2;
                line.push((stretch.begin, stretch.first));
                if stretch.count > 2 {
                    line.push((middle, stretch.least));
                    line.push((middle, stretch.most));
                }
                if stretch.count > 1 {
                    line.push((stretch.end, stretch.last));
                }
            }
        }
        lines
    }
}

fn merged(stretches: &[Stretch]) -> Vec<Stretch> {
    stretches
        .chunks(2)
        .map(|pair| pair.iter().fold(Stretch::default(), |a, b| a.with(*b)))
        .collect()
}
