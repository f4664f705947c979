//! Pictures of made signals.

use super::{Plot, Series, scale};
use crate::filter::Glob;
use crate::fixtures::{FixtureCapture, signal};

/// A sine on axis 2 with a spike, and a step on axis 3, with a pause between.
fn plot(wanted: &[&str]) -> Plot {
    let mut made = FixtureCapture::default();
    let mut plot = Plot::new(wanted.iter().map(|glob| Glob::new(glob)).collect());
    for n in (0..400u64).filter(|n| !(200..260).contains(n)) {
        let sine = (n as f64 / 30.0).sin() * 50.0;
        let value = if n == 100 { 400.0 } else { sine };
        let reports = [
            signal(2, "Actual/Position", value),
            signal(3, "Actual/Position", if n < 150 { 0.0 } else { 80.0 }),
            signal(2, "Actual/Velocity", 3.0),
        ];
        made.next_frame(n * 10_000, 2, "TPDO1", &reports, &mut |event| plot.add_frame(event));
    }
    plot
}

#[test]
fn signals_are_chosen_by_pattern() {
    assert_eq!(plot(&["*/Actual/Position"]).series.len(), 2);
    assert_eq!(plot(&["2/Actual/*"]).series.len(), 2);
    assert_eq!(plot(&["Actual/Velocity"]).series.len(), 1);
    let none = plot(&["3/Temp/*"]);
    assert!(none.is_empty());
    let others: Vec<String> = none.other_signals().collect();
    assert_eq!(others, ["2/Actual/Position", "2/Actual/Velocity", "3/Actual/Position"]);
}

#[test]
fn a_spike_among_a_million_values_is_kept() {
    let mut series = Series::new("mm");
    for n in 0..1_000_000u64 {
        let value = if n == 654_321 { 1e3 } else { (n % 10) as f64 };
        series.add(n * 1_000_000, value);
    }
    let lines = series.lines(800);
    assert_eq!(lines.len(), 1);
    assert!(lines[0].len() <= 4 * 800, "{}", lines[0].len());
    let (time, max) =
        lines[0].iter().fold((0, 0.0), |most, one| if one.1 > most.1 { *one } else { most });
    assert_eq!(max, 1e3);
    let off = (time as f64 / 654_321e6 - 1.0).abs();
    assert!(off < 0.003, "{off}");
}

#[test]
fn where_values_stay_away_the_line_is_broken() {
    let plot = plot(&["2/Actual/Position"]);
    let series = plot.series.values().next().expect("a line");
    let lines = series.lines(1000);
    assert_eq!(lines.len(), 2);
    assert_eq!(lines[0].last().expect("a point").0, 1_990_000_000);
    assert_eq!(lines[1][0].0, 2_600_000_000);
}

#[test]
fn a_terminal_shows_values_units_and_time() {
    let shown = plot(&["*/Actual/Position"]).terminal(80, false);
    assert_eq!(shown.matches("Actual/Position [mm]").count(), 2, "a panel each:\n{shown}");
    assert!(shown.contains("400 ┤") && shown.contains("time [s]"), "{shown}");
    assert!(shown.lines().all(|line| line.chars().count() <= 80), "{shown}");
    let coloured = plot(&["*/Actual/Position"]).terminal(80, true);
    assert_eq!(coloured.matches("Actual/Position [mm]").count(), 1, "one for both:\n{coloured}");
}

#[test]
fn svg_is_whole() {
    let svg = plot(&["*/Actual/*"]).svg();
    assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"), "{svg}");
    assert_eq!(svg.matches("stroke-linejoin").count(), 3, "three lines");
    assert!(svg.contains("time [s] since 2023-11-14 22:13:20 UTC"));
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
}

#[test]
fn ticks_are_round() {
    assert_eq!(scale::ticks((-2.2, 11.0), 4), (vec![0.0, 5.0, 10.0], 0));
    assert_eq!(scale::ticks((0.0, 0.01), 5), (vec![0.0, 0.002, 0.004, 0.006, 0.008, 0.01], 3));
    assert_eq!(scale::padded_range([(3.0, 3.0)].into_iter()), (1.5, 4.5));
    assert_eq!(scale::label(-0.0001, 1), "0.0");
}
