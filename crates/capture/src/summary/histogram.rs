//! A histogram in bounded memory: each class is 3 % wide.

/// Classes for each doubling.
const SUB_BUCKET_BITS: u32 = 5;
const SUB_BUCKETS: u64 = 1 << SUB_BUCKET_BITS;

/// Counts of values by their size. Quantiles are right to 3 %, least, most and mean are exact.
#[derive(Clone, Debug, Default)]
pub struct Histogram {
    buckets: Vec<u32>,
    count: u64,
    sum: u128,
    min: u64,
    max: u64,
}

impl Histogram {
    /// Takes a value.
    pub fn add(&mut self, value: u64) {
        let class = bucket_index(value);
        if class >= self.buckets.len() {
            self.buckets.resize(class + 1, 0);
        }
        self.buckets[class] = self.buckets[class].saturating_add(1);
        self.min = if self.count == 0 { value } else { self.min.min(value) };
        self.max = self.max.max(value);
        self.count += 1;
        self.sum += u128::from(value);
    }

    /// Number of recorded values.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// The smallest.
    #[must_use]
    pub const fn min(&self) -> u64 {
        self.min
    }

    /// The greatest.
    #[must_use]
    pub const fn max(&self) -> u64 {
        self.max
    }

    /// Their mean; 0 without any.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.sum as f64 / self.count.max(1) as f64
    }

    /// The value that this share of them does not exceed, to 3 %.
    #[must_use]
    pub fn quantile(&self, share: f64) -> u64 {
        let wanted = (self.count as f64 * share).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (class, count) in self.buckets.iter().enumerate() {
            seen += u64::from(*count);
            if seen >= wanted {
                return bucket_middle(class).clamp(self.min, self.max);
            }
        }
        self.max
    }

    /// The median.
    #[must_use]
    pub fn median(&self) -> u64 {
        self.quantile(0.5)
    }
}

fn bucket_index(value: u64) -> usize {
    if value < SUB_BUCKETS {
        return value as usize;
    }
    let shift = value.ilog2() - SUB_BUCKET_BITS;
    (u64::from(shift + 1) * SUB_BUCKETS + (value >> shift) - SUB_BUCKETS) as usize
}

fn bucket_middle(class: usize) -> u64 {
    let class = class as u64;
    if class < SUB_BUCKETS {
        return class;
    }
    let shift = class / SUB_BUCKETS - 1;
    let min = (class % SUB_BUCKETS + SUB_BUCKETS) << shift;
    min + (1 << shift) / 2
}

#[cfg(test)]
mod tests {
    use super::{Histogram, bucket_index, bucket_middle};

    #[test]
    fn classes_are_narrow_and_in_order() {
        let mut before = 0;
        for value in (0..200_000u64).chain((40..63).map(|bit| (1 << bit) + 12_345)) {
            let found = bucket_index(value);
            assert!(found >= before);
            before = found;
            let off = bucket_middle(found).abs_diff(value) as f64;
            assert!(off <= value as f64 * 0.032, "{value}: {}", bucket_middle(found));
        }
    }

    #[test]
    fn quantiles() {
        let mut spread = Histogram::default();
        (1..=1000u64).for_each(|n| spread.add(n * 1000));
        assert_eq!((spread.count(), spread.min(), spread.max()), (1000, 1000, 1_000_000));
        assert!(spread.median().abs_diff(500_000) < 16_000);
        assert!(spread.quantile(0.99).abs_diff(990_000) < 31_000);
        assert!((spread.mean() - 500_500.0).abs() < 0.01);
        assert_eq!(Histogram::default().median(), 0);
    }
}
