//! Differences between generated captures.

use super::{Difference, diff};
use crate::fixtures::{FixtureCapture, anomaly, change, exchange, fault, signal};
use crate::session::{AnomalyKind, ExchangeOutcome};
use crate::summary::Summary;

/// Contents of a capture.
#[derive(Clone, Copy)]
struct Recipe {
    period_us: u64,
    latency_us: u64,
    /// A setting that is read again and again.
    setting: f64,
    kinds: [&'static str; 2],
    /// Axes that speak, from 2.
    axes: u32,
    trouble: bool,
}

const USUAL: Recipe = Recipe {
    period_us: 1000,
    latency_us: 800,
    setting: 7.0,
    kinds: ["TPDO1", "SDO read"],
    axes: 1,
    trouble: false,
};

fn summary_of(recipe: Recipe) -> Summary {
    let (mut made, mut summary) = (FixtureCapture::default(), Summary::default());
    for n in 0..200u64 {
        for axis in 2..2 + recipe.axes {
            let us = n * recipe.period_us;
            let mut reports = vec![
                signal(axis, "max current", recipe.setting),
                signal(axis, "Actual/Position", (n as f64 / 20.0).sin() * 100.0),
                exchange(axis, us, recipe.latency_us + n % 7 * 10, ExchangeOutcome::Done),
            ];
            if n == 0 {
                reports.push(change(axis, "operational"));
            }
            if n == 150 && recipe.trouble {
                reports.extend([
                    fault(axis, false),
                    anomaly(AnomalyKind::Silent, axis),
                    change(axis, "stopped"),
                ]);
            }
            for kind in recipe.kinds {
                made.next_frame(us, axis, kind, &reports, &mut |event| summary.add_frame(event));
                reports.clear();
            }
        }
    }
    summary
}

fn diff_with_usual(other: Recipe) -> Vec<Difference> {
    let (one, other) = (summary_of(USUAL), summary_of(other));
    let there = diff(&one, &other, 0.2);
    let back = diff(&other, &one, 0.2);
    assert_eq!(there.len(), back.len(), "the order of the two does not matter");
    there
}

fn words(found: &[Difference]) -> Vec<(&str, &str, &str)> {
    found.iter().map(|one| (one.kind, one.a.as_str(), one.b.as_str())).collect()
}

#[test]
fn alike_is_alike() {
    assert_eq!(diff_with_usual(USUAL), []);
    assert_eq!(diff_with_usual(Recipe { period_us: 1100, latency_us: 900, ..USUAL }), []);
}

#[test]
fn each_sort_of_difference_is_reported() {
    let slower = diff_with_usual(Recipe { period_us: 2000, ..USUAL });
    assert_eq!(words(&slower)[0].0, "rate");
    assert!(slower.iter().all(|one| one.kind == "rate"), "{slower:?}");
    let later = diff_with_usual(Recipe { latency_us: 4000, ..USUAL });
    assert_eq!(later.len(), 2, "{later:?}");
    assert!(later[0].subject.ends_with("read median"), "{later:?}");
    let other = diff_with_usual(Recipe { setting: 8.0, ..USUAL });
    assert_eq!(words(&other), [("value", "7 mm", "8 mm")]);
    let kinds = diff_with_usual(Recipe { kinds: ["TPDO1", "EMCY"], ..USUAL });
    assert_eq!(words(&kinds), [("frames", "none", "200 frames"), ("frames", "200 frames", "none")]);
    let axes = diff_with_usual(Recipe { axes: 2, ..USUAL });
    assert_eq!(words(&axes)[0], ("axis", "none", "400 frames"));
    let trouble = diff_with_usual(Recipe { trouble: true, ..USUAL });
    let reports = words(&trouble);
    assert!(reports.contains(&("state", "none besides", "stopped")), "{reports:?}");
    assert!(reports.contains(&("fault", "none", "once")), "{reports:?}");
    assert_eq!(reports.iter().filter(|(what, ..)| *what == "odd").count(), 2, "{reports:?}");
}
