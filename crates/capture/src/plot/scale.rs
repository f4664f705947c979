//! Ranges, and round numbers for their ticks.

/// A range with a little room around all values.
pub(super) fn padded_range(ranges: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let (mut min, mut max) = (f64::INFINITY, f64::NEG_INFINITY);
    ranges.for_each(|(low, high)| (min, max) = (min.min(low), max.max(high)));
    if !(min.is_finite() && max.is_finite()) {
        return (0.0, 1.0);
    }
    // A constant value is drawn in the middle.
    let capacity = match max - min {
        0.0 => min.abs().max(1.0) * 0.5,
        span => span * 0.05,
    };
    (min - capacity, max + capacity)
}

/// Round numbers on a range, at most `wanted`, and the decimals that they need.
pub(super) fn ticks(range: (f64, f64), wanted: usize) -> (Vec<f64>, usize) {
    let (min, max) = range;

    let rough = (max - min) / wanted.max(1) as f64;
    if !(rough.is_finite() && rough > 0.0) {
        return (vec![min], 0);
    }
    let power = 10f64.powi(rough.log10().floor() as i32);
    let step = [1.0, 2.0, 5.0, 10.0].map(|n| n * power);
    let step = step.into_iter().find(|step| *step >= rough * 0.999).unwrap_or(10.0 * power);
    let decimals = (-step.log10() + 1e-9).ceil().max(0.0) as usize;
    let first = (min / step).ceil();
    let count = ((max / step).floor() - first).max(0.0) as usize;
    let tick = |n: usize| (first + n as f64) * step;
    ((0..=count.min(wanted * 3)).map(tick).filter(|tick| *tick <= max).collect(), decimals)
}

/// A tick as text; never `-0`.
pub(super) fn label(value: f64, decimals: usize) -> String {
    let large = value.abs() >= 1e7;
    let text = if large { format!("{value:.3e}") } else { format!("{value:.decimals$}") };
    let zero = text.strip_prefix('-').filter(|rest| rest.chars().all(|c| c == '0' || c == '.'));
    zero.map_or_else(|| text.clone(), str::to_owned)
}
