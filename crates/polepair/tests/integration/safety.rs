//! docs/concepts/safety.md: each line of its tables of drives, carried out on the simulated drive that it
//! names.

use polepair::LocalLink;
use std::time::Duration;

const DOC: &str = include_str!("../../../../docs/concepts/safety.md");
const AFTER: Duration = Duration::from_millis(500);
const SILENCE: Duration = Duration::from_secs(20);

/// A line of the table: the drive, its connection string, what it does in silence, and what it does
/// then with its own watchdog.
struct Line {
    drive: &'static str,
    url: &'static str,
    alone: &'static str,
    watched: &'static str,
}

fn lines() -> Vec<Line> {
    let rows = DOC.lines().filter(|line| line.starts_with('|') && line.contains("`sim:"));
    let line = |row: &'static str| {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let [drive, url, alone, watched] = cells[..] else { panic!("{row}") };
        Line { drive, url: url.trim_matches('`'), alone, watched }
    };
    rows.map(line).collect()
}

fn open(line: &Line) -> LocalLink {
    let more = if line.url.contains('?') { '&' } else { '?' };
    let url = format!("{}{more}time=virtual", line.url);
    polepair::connect_local(&url).unwrap_or_else(|error| panic!("{}: {error}", line.drive))
}

fn speed(link: &LocalLink) -> f64 {
    link.simulation().unwrap().truth(0, 0).unwrap().velocity.abs()
}

/// Turns the motor, with a watchdog or without, falls silent, and returns whether the motor came to standstill.
fn stands_in_silence(line: &Line, watched: bool) -> bool {
    let (link, about) = (open(line), line.drive);
    let axis = &link.axes()[0];
    if watched {
        axis.set_watchdog(Some(AFTER)).unwrap_or_else(|error| panic!("{about}: {error}"));
    }
    let armed = axis.armed().unwrap_or_else(|error| panic!("{about}: {error}"));
    axis.velocity("60 rpm").unwrap_or_else(|error| panic!("{about}: {error}"));
    // The watchdog gets messages meanwhile.
    for _ in 0..20 {
        link.sleep(AFTER / 5);
        let _ = axis.moving(&axis.state());
        axis.read(axis.profile().signals[0].parameter).unwrap_or_else(|e| panic!("{about}: {e}"));
    }
    assert!(speed(&link) > 1.0, "{about} turns before its host falls silent: {}", speed(&link));
    armed.detach().unwrap();
    link.sleep(SILENCE);
    speed(&link) < 0.1
}

#[test]
fn each_drive_does_in_silence_what_the_table_says() {
    let lines = lines();
    assert!(lines.len() >= 12, "{} lines", lines.len());
    for line in &lines {
        let stands = stands_in_silence(line, false);
        let matches = match line.alone {
            "turns on" => false,
            "stops" => true,
            other => panic!("{}: `{other}`", line.drive),
        };
        assert_eq!(stands, matches, "{} in silence", line.drive);
        match line.watched {
            "none" => {
                let link = open(line);
                let error = link.axes()[0].set_watchdog(Some(AFTER)).unwrap_err();
                assert_eq!(error.code(), "E218", "{}: {error}", line.drive);
            }
            watched => {
                assert!(watched.starts_with("stops"), "{}: `{watched}`", line.drive);
                assert!(stands_in_silence(line, true), "{} with its watchdog", line.drive);
            }
        }
    }
}

#[test]
fn every_family_on_every_medium_has_a_line() {
    let lines = lines();
    let mut left: Vec<&str> = Vec::new();
    for profile in polepair_drives::profiles() {
        let moves = profile.plans.iter().any(|plan| plan.verb.needs_arming());
        let reported =
            lines.iter().any(|line| open(line).axes()[0].profile().family == profile.family);
        if moves && !reported {
            left.push(profile.name);
        }
    }
    assert!(left.is_empty(), "no line for {left:?}");
}
