//! The values of one line, in bounded memory.

use crate::session::InternedName;
use crate::summary::Histogram;

/// Stretches of time that a line has at most. When they are full, each two become one.
const BUCKETS_MAX: usize = 4096;
/// First length of a stretch, ns.
const BUCKET_MIN_NS: u64 = 1000;
/// A gap is this many times as long as the pause that 90 % of all pauses do not exceed.
const GAP_FACTOR: u64 = 3;
/// Number of pauses from which a gap can be detected.
const PAUSES_MIN: u64 = 8;

/// A line.
#[derive(Clone, Debug)]
pub struct Series {
    /// The unit of its values.
    pub unit: InternedName,
    buckets: Vec<TimeBucket>,
    /// Length of each stretch, ns.
    bucket_ns: u64,
    begin: u64,
    pauses: Histogram,
    last_time: u64,
}

/// Values in a stretch of time; without values its count is 0.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
struct TimeBucket {
    count: u32,
    begin: u64,
    end: u64,
    first: f64,
    min: f64,
    max: f64,
    last: f64,
}

impl TimeBucket {
    fn merge(self, later: Self) -> Self {
        match (self.count, later.count) {
            (_, 0) => self,
            (0, _) => later,
            _ => Self {
                count: self.count.saturating_add(later.count),
                begin: self.begin.min(later.begin),
                end: self.end.max(later.end),
                first: self.first,
                min: self.min.min(later.min),
                max: self.max.max(later.max),
                last: later.last,
            },
        }
    }
}

impl Series {
    pub(super) fn new(unit: InternedName) -> Self {
        let (buckets, pauses) = (Vec::new(), Histogram::default());
        Self { unit, buckets, bucket_ns: BUCKET_MIN_NS, begin: 0, pauses, last_time: 0 }
    }

    /// Takes a value at a time in ns.
    pub(super) fn add(&mut self, time: u64, value: f64) {
        if self.buckets.is_empty() {
            self.begin = time;
        } else {
            self.pauses.add(time.saturating_sub(self.last_time));
        }
        self.last_time = self.last_time.max(time);
        let mut at = (time.saturating_sub(self.begin) / self.bucket_ns) as usize;
        while at >= BUCKETS_MAX {
            self.buckets = merge_pairs(&self.buckets);
            self.bucket_ns *= 2;
            at /= 2;
        }
        if at >= self.buckets.len() {
            self.buckets.resize(at + 1, TimeBucket::default());
        }
        let (first, min_value, max_value, last) = (value, value, value, value);
        let one = TimeBucket {
            count: 1,
            begin: time,
            end: time,
            first,
            min: min_value,
            max: max_value,
            last,
        };
        self.buckets[at] = self.buckets[at].merge(one);
    }

    /// Times of the first value and of the last, ns.
    #[must_use]
    pub fn span(&self) -> Option<(u64, u64)> {
        (!self.buckets.is_empty()).then_some((self.begin, self.last_time))
    }

    /// The least and the greatest value.
    #[must_use]
    pub fn range(&self) -> (f64, f64) {
        let whole = self.buckets.iter().fold(TimeBucket::default(), |sum, one| sum.merge(*one));
        (whole.min, whole.max)
    }

    /// Lines to draw, each without a gap: times in ns and values. They have at most four points for each of `stretches`
    /// stretches.
    #[must_use]
    pub fn lines(&self, stretches: usize) -> Vec<Vec<(u64, f64)>> {
        let mut drawn = self.buckets.clone();
        while drawn.len() > stretches.max(1) {
            drawn = merge_pairs(&drawn);
        }
        let gap = match self.pauses.count() {
            ..PAUSES_MIN => u64::MAX,
            _ => self.pauses.quantile(0.9).saturating_mul(GAP_FACTOR),
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
                    line.push((middle, stretch.min));
                    line.push((middle, stretch.max));
                }
                if stretch.count > 1 {
                    line.push((stretch.end, stretch.last));
                }
            }
        }
        lines
    }
}

fn merge_pairs(stretches: &[TimeBucket]) -> Vec<TimeBucket> {
    stretches
        .chunks(2)
        .map(|pair| pair.iter().fold(TimeBucket::default(), |a, b| a.merge(*b)))
        .collect()
}
