//! How values spread, in bounded memory: counts by size, each class 3 % wide.

/// Classes for each doubling.
const FINE_BITS: u32 = 5;
const FINE: u64 = 1 << FINE_BITS;

/// Counts of values by their size. Quantiles are right to 3 %, least, most and mean are exact.
#[derive(Clone, Debug, Default)]
pub struct Spread {
    classes: Vec<u32>,
    count: u64,
    sum: u128,
    least: u64,
    most: u64,
}

impl Spread {
    /// Takes a value.
    pub fn take(&mut self, value: u64) {
        let class = class(value);
        if class >= self.classes.len() {
            self.classes.resize(class + 1, 0);
        }
        self.classes[class] = self.classes[class].saturating_add(1);
        self.least = if self.count == 0 { value } else { self.least.min(value) };
        self.most = self.most.max(value);
        self.count += 1;
        self.sum += u128::from(value);
    }

    /// How many there were.
    #[must_use]
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// The smallest.
    #[must_use]
    pub const fn least(&self) -> u64 {
        self.least
    }

    /// The greatest.
    #[must_use]
    pub const fn most(&self) -> u64 {
        self.most
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
        for (class, count) in self.classes.iter().enumerate() {
            seen += u64::from(*count);
            if seen >= wanted {
                return middle(class).clamp(self.least, self.most);
            }
        }
        self.most
    }

    /// The median.
    #[must_use]
    pub fn median(&self) -> u64 {
        self.quantile(0.5)
    }
}

fn class(value: u64) -> usize {
    if value < FINE {
        return value as usize;
    }
    let shift = value.ilog2() - FINE_BITS;
    (u64::from(shift + 1) * FINE + (value >> shift) - FINE) as usize
}

fn middle(class: usize) -> u64 {
    let class = class as u64;
    if class < FINE {
        return class;
    }
    let shift = class / FINE - 1;
    let least = (class % FINE + FINE) << shift;
    least + (1 << shift) / 2
}

#[cfg(test)]
mod tests {
    use super::{Spread, class, middle};

    #[test]
    fn classes_are_narrow_and_in_order() {
        let mut before = 0;
        for value in (0..200_000u64).chain((40..63).map(|bit| (1 << bit) + 12_345)) {
            let found = class(value);
            assert!(found >= before);
            before = found;
            let off = middle(found).abs_diff(value) as f64;
            assert!(off <= value as f64 * 0.032, "{value}: {}", middle(found));
        }
    }

    #[test]
    fn quantiles() {
        let mut spread = Spread::default();
        (1..=1000u64).for_each(|n| spread.take(n * 1000));
        assert_eq!((spread.count(), spread.least(), spread.most()), (1000, 1000, 1_000_000));
        assert!(spread.median().abs_diff(500_000) < 16_000);
        assert!(spread.quantile(0.99).abs_diff(990_000) < 31_000);
        assert!((spread.mean() - 500_500.0).abs() < 0.01);
        assert_eq!(Spread::default().median(), 0);
    }
}
