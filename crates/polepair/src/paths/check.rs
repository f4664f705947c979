//! Checks of a table of paths: what the drive would refuse, and where chains lead.

use std::fmt;

use polepair_drives::stored_paths::{PATH_MAX, PathDefinition, PathEnd, PathType, s_time_fits};

use super::PathTable;

/// A finding of a check of paths.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PathFinding {
    /// Number of the path; `None` for the mechanics.
    pub path: Option<u8>,
    /// True for what the drive refuses, or cannot do. Others may be intended.
    pub is_error: bool,
    /// Finding, in a sentence without full stop.
    pub text: String,
}

impl fmt::Display for PathFinding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.path {
            Some(number) => write!(f, "path {number}: {}", self.text),
            None => f.write_str(&self.text),
        }
    }
}

/// The paths that run one after the other.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PathChain {
    /// Their numbers, from the first.
    pub numbers: Vec<u8>,
    /// End of the chain.
    pub end: PathChainEnd,
}

/// End of a chain of paths.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PathChainEnd {
    /// The last path stops at its end.
    Stops,
    /// The last path turns at its speed until it is stopped.
    TurnsOn,
    /// The last path leads back to this one.
    Repeats(u8),
    /// The last path leads to this one, which is empty or has an unknown type.
    Empty(u8),
}

impl fmt::Display for PathChain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let numbers: Vec<String> = self.numbers.iter().map(u8::to_string).collect();
        f.write_str(&numbers.join(" -> "))?;
        match self.end {
            PathChainEnd::Stops => Ok(()),
            PathChainEnd::TurnsOn => f.write_str(", which turns until it is stopped"),
            PathChainEnd::Repeats(number) => write!(f, " -> {number}, again and again"),
            PathChainEnd::Empty(number) => write!(f, " -> {number}, which is empty"),
        }
    }
}

impl PathTable {
    /// The paths that run when one of them is triggered.
    #[must_use]
    pub fn chain(&self, start: u8) -> PathChain {
        let mut numbers = Vec::new();
        let mut number = start;
        loop {
            let path = self.path(number);
            if matches!(path.kind, PathType::Unknown(_)) {
                return PathChain { numbers, end: PathChainEnd::Empty(number) };
            }
            numbers.push(number);
            let end = match (path.kind, path.next) {
                (PathType::Speed, _) if path.delay_ms == 0 => PathChainEnd::TurnsOn,
                (PathType::Single, _) | (_, None) => PathChainEnd::Stops,
                (_, Some(next)) if numbers.contains(&next) => PathChainEnd::Repeats(next),
                (_, Some(next)) => {
                    number = next;
                    continue;
                }
            };
            return PathChain { numbers, end };
        }
    }

    /// Paths that no other one leads to, so that something triggers them. Of a circle, the lowest.
    #[must_use]
    pub fn first_paths(&self) -> Vec<u8> {
        let mut reached = [false; PATH_MAX as usize + 1];
        let mut firsts = Vec::new();
        let is_led_to = |number: u8| {
            self.paths.iter().any(|(other, path)| *other != number && path.next == Some(number))
        };
        let (led_to, not): (Vec<u8>, Vec<u8>) =
            self.paths.keys().copied().partition(|number| is_led_to(*number));
        for number in not.into_iter().chain(led_to) {
            if reached[usize::from(number)] {
                continue;
            }
            firsts.push(number);
            for passed in self.chain(number).numbers {
                reached[usize::from(passed)] = true;
            }
        }
        firsts
    }

    /// Everything that is wrong with the paths, or may be.
    #[must_use]
    pub fn check(&self) -> Vec<PathFinding> {
        let mut found = self.defects.clone();
        if self.motor_turns == 0 || self.travel == 0 {
            let text = "motor turns and travel are at least 1: no path runs otherwise";
            found.push(PathFinding { path: None, is_error: true, text: text.to_owned() });
        }
        for (number, path) in &self.paths {
            let mut add = |is_error, text: String| {
                found.push(PathFinding { path: Some(*number), is_error, text });
            };
            self.check_path(path, &mut add);
            check_next(*number, path, self, &mut add);
        }
        for start in self.first_paths() {
            let chain = self.chain(start);
            if let PathChainEnd::Repeats(_) = chain.end {
                found.push(PathFinding {
                    path: Some(start),
                    is_error: false,
                    text: format!("it never ends: {chain}"),
                });
            }
            found.extend(self.check_travel(&chain));
        }
        found
    }

    fn check_path(&self, path: &PathDefinition, add: &mut impl FnMut(bool, String)) {
        if let PathType::Unknown(digit) = path.kind {
            // The digits of definition words have their own findings.
            if digit != 0 {
                add(true, format!("type {digit} means nothing"));
            }
            return;
        }
        if path.kind.is_positioning() && path.rpm == 0 {
            add(true, "at a speed of 0 it never arrives".to_owned());
        }
        if !s_time_fits(path.acceleration_ms, path.s_ms) {
            let (s_ms, limit) = (path.s_ms, path.acceleration_ms / 2);
            add(
                true,
                format!(
                    "its S-time of {s_ms} ms must be less than half its acceleration, {limit} ms"
                ),
            );
        } else if path.s_ms != 0 && u32::from(path.deceleration_ms) <= 2 * u32::from(path.s_ms) {
            let half = path.deceleration_ms / 2;
            add(
                false,
                format!(
                    "its S-time of {} ms is not less than half its deceleration, {half} ms",
                    path.s_ms
                ),
            );
        }
        if path.acceleration_ms == 0 && path.rpm != 0 {
            add(false, "without an acceleration time its speed is a step".to_owned());
        }
        let Some((low, high)) = self.range.filter(|_| path.kind.is_positioning()) else { return };
        if path.end == PathEnd::Coordinate && !(low..=high).contains(&path.thousandths) {
            let at = self.unit.format(path.thousandths);
            let (low, high) = (self.unit.format(low), self.unit.format(high));
            add(true, format!("it goes to {at}, and the range is {low} to {high}"));
        }
    }

    /// Adds up relative paths behind an absolute one.
    fn check_travel(&self, chain: &PathChain) -> Vec<PathFinding> {
        let Some((low, high)) = self.range else { return Vec::new() };
        let (mut at, mut found) = (None, Vec::new());
        for number in &chain.numbers {
            let path = self.path(*number);
            let is_absolute = path.end == PathEnd::Coordinate;
            at = match path.kind {
                PathType::Speed | PathType::Unknown(_) => None,
                _ if is_absolute => Some(i64::from(path.thousandths)),
                _ => at.map(|at| at + i64::from(path.thousandths)),
            };
            let Some(end) = at.filter(|_| !is_absolute) else { continue };
            if !(i64::from(low)..=i64::from(high)).contains(&end) {
                let text = format!(
                    "behind the paths before it, it goes to {} {}, out of the range",
                    end as f64 / 1000.0,
                    self.unit.symbol()
                );
                found.push(PathFinding { path: Some(*number), is_error: true, text });
            }
        }
        found
    }
}

fn check_next(
    number: u8,
    path: &PathDefinition,
    table: &PathTable,
    add: &mut impl FnMut(bool, String),
) {
    match (path.kind, path.next) {
        (PathType::Auto, None) => add(true, "it is AUTO, and names no next path".to_owned()),
        (PathType::Single, Some(next)) => {
            add(false, format!("it is SINGLE: its next path {next} does not run"));
        }
        (PathType::Speed, Some(next)) if path.delay_ms == 0 => {
            add(
                false,
                format!("without a delay it turns until it is stopped: path {next} does not run"),
            );
        }
        (PathType::Speed | PathType::Auto, Some(next)) => {
            let is_missing = matches!(table.path(next).kind, PathType::Unknown(_));
            if is_missing && next != number {
                add(true, format!("it leads to path {next}, which is empty"));
            }
        }
        _ => {}
    }
}
