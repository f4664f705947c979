//! `stream` with cyclic modes: set-points of several axes from a file, on one SYNC.

use std::io::IsTerminal as _;
use std::time::Duration;

use polepair::{CyclicAxes, Error, LocalAxis};
use polepair_core::stream::cyclic::{CycleStatistics, SetpointKind};
use polepair_core::units::Quantity;

use crate::interrupt;
use crate::motion;
use crate::outcome;
use crate::problem::{Problem, Result};
use crate::session::LocalSession;
use crate::target::DriveArgs;
use crate::terminal::{self, print_note, print_warning};

/// Times of a file that are apart by less than this are no other times, s.
const SAME_S: f64 = 1e-6;
/// Cycles of a file at most: an hour at 1 ms.
const CYCLES_MAX: f64 = 3.6e6;

/// A column of the file: whose, and what one of its unit is.
struct SetpointColumn {
    name: String,
    factor: f64,
    quantity: Option<Quantity>,
}

/// A file's set-points, in the order of its columns.
struct SetpointTable {
    columns: Vec<SetpointColumn>,
    times: Vec<f64>,
    rows: Vec<Vec<f64>>,
}

/// Returns whether a line names columns.
pub fn is_header(line: &str) -> bool {
    line.split(',').next().is_some_and(|cell| cell.trim().parse::<f64>().is_err())
}

pub fn run_cyclic(
    target: &DriveArgs,
    file: &str,
    lines: &[(usize, String)],
    period: Option<f64>,
    mode: Option<SetpointKind>,
) -> Result {
    let table = SetpointTable::parse_lines(file, lines)?;
    let setpoint = table.setpoint(mode)?;
    let period = table.period(file, period)?;
    let session = target.open()?;
    let order = table.column_order(session.axes())?;
    let setpoints = table.resample(period, &order)?;
    motion::print_program_note(&session, false);
    session.listen_for_interrupts();
    follow_setpoints(&session, setpoint, Duration::from_secs_f64(period), &setpoints)
}

fn follow_setpoints(
    session: &LocalSession,
    setpoint: SetpointKind,
    period: Duration,
    setpoints: &[f64],
) -> Result {
    let _holding = interrupt::hold_motion(&session.arguments);
    let following = CyclicAxes::begin_with_path(session.axes(), setpoint, period, setpoints);
    let following = following.map_err(outcome::to_problem)?;
    let cycles = setpoints.len() / session.axes().len();
    let live = CycleMeter { shown: std::io::stderr().is_terminal(), cycles };
    let streamed = following.stream(setpoints.iter().copied(), |account| live.show(account));
    let ended = streamed.map_err(|error| match error {
        Error::Interrupted { .. } => Problem::interrupted(),
        other => outcome::to_problem(other),
    });
    let (load, last) = (following.load(), following.cycle_statistics());
    let released = following.release().map_err(outcome::to_problem);
    if let Some(account) = last.filter(|account| account.syncs > 0) {
        let bus = load.map_or(String::new(), |load| format!("; {:.0} % of the bus", load * 100.0));
        let axes = session.axes().len();
        print_note(&format!(
            "{} cycles of {} ms, axes: {axes}{bus}",
            account.cycles,
            to_ms(period)
        ));
        print_statistics(&account, setpoint);
    }
    if released.is_err() {
        let axes: Vec<String> = session.axes().iter().map(LocalAxis::label).collect();
        print_warning(&format!("{} may still turn: cut their supply", axes.join(", ")));
    }
    motion::conclude(ended.map(drop), released, "the motion was stopped")
}

fn to_ms(span: Duration) -> f64 {
    span.as_secs_f64() * 1e3
}

/// Prints the following errors of the drives, and the regularity of the beat.
fn print_statistics(account: &CycleStatistics, setpoint: SetpointKind) {
    let unit = match setpoint {
        SetpointKind::Position => "rad (or m)",
        SetpointKind::Velocity => "rad/s (or m/s)",
        SetpointKind::Torque => "Nm",
    };
    let lag = account.max_following_error;
    print_note(&format!(
        "greatest distance from the set-point of the cycle before: {lag:.4} {unit}"
    ));
    print_note(&format!(
        "missed cycles: {}; late replies: {}",
        account.missed_cycles, account.late_reports
    ));
    if let Some((min_value, middle, max_value)) = account.lateness.summary() {
        let (least, middle, most) = (to_ms(min_value), to_ms(middle), to_ms(max_value));
        print_note(&format!(
            "cycles late by {least:.3} / {middle:.3} / {most:.3} ms (min/median/max)"
        ));
    }
    print_note("this computer is not a real-time controller: the cycle depends on its scheduler");
}

/// One line on a terminal, drawn again and again.
struct CycleMeter {
    shown: bool,
    cycles: usize,
}

impl CycleMeter {
    fn show(&self, account: &CycleStatistics) {
        if self.shown {
            let (done, missed) = (account.cycles, account.missed_cycles);
            terminal::draw(&format!("\r\x1b[Kcycle {done} of {}  missed {missed}", self.cycles));
        }
    }
}

impl Drop for CycleMeter {
    fn drop(&mut self) {
        if self.shown {
            terminal::draw("\r\x1b[K");
        }
    }
}

impl SetpointTable {
    fn parse_lines(file: &str, lines: &[(usize, String)]) -> Result<Self> {
        let headed = lines.first().is_some_and(|(_, line)| is_header(line));
        let mut cells = match lines.first() {
            Some((n, line)) if headed => {
                let columns = line.split(',').map(parse_column);
                columns
                    .collect::<std::result::Result<_, _>>()
                    .map_err(|why| line_problem(*n, why, file))?
            }
            _ => Vec::new(),
        };
        let mut table = Self { columns: Vec::new(), times: Vec::new(), rows: Vec::new() };
        for (n, line) in lines.iter().skip(usize::from(headed)) {
            let numbers = parse_numbers(line).ok_or_else(|| {
                line_problem(*n, format!("`{line}` is not a line of numbers"), file)
            })?;
            if cells.is_empty() {
                cells.resize_with(numbers.len(), SetpointColumn::unnamed);
            }
            if numbers.len() != cells.len() || numbers.len() < 2 {
                return Err(line_problem(
                    *n,
                    format!("{} columns, not {}", numbers.len(), cells.len()),
                    file,
                ));
            }
            let mut scaled = numbers.iter().zip(&cells).map(|(number, cell)| number * cell.factor);
            let time = scaled.next().unwrap_or(0.0);
            if table.times.last().is_some_and(|last| time <= *last) {
                return Err(line_problem(*n, "the time does not increase".into(), file));
            }
            table.times.push(time);
            table.rows.push(scaled.collect());
        }
        if table.times.len() < 2 {
            return Err(line_problem(
                lines.len(),
                "at least two lines of numbers are needed".into(),
                file,
            ));
        }
        table.columns = cells.into_iter().skip(1).collect();
        Ok(table)
    }

    /// Kind of the set-points, by their units.
    fn setpoint(&self, mode: Option<SetpointKind>) -> Result<SetpointKind> {
        let mut kind = mode;
        for column in &self.columns {
            let found = match column.quantity {
                None => continue,
                Some(Quantity::Position) => Some(SetpointKind::Position),
                Some(Quantity::Velocity) => Some(SetpointKind::Velocity),
                Some(Quantity::Torque) => Some(SetpointKind::Torque),
                Some(_) => None,
            };
            if found.is_none() || kind.is_some_and(|kind| found != Some(kind)) {
                let what = format!("the unit of column `{}` does not fit.", column.name);
                return Err(Problem::usage("E217", what)
                    .why("All columns are positions (csp), velocities (csv) or torques (cst)."));
            }
            kind = found;
        }
        Ok(kind.unwrap_or(SetpointKind::Position))
    }

    /// The period asked for, or the one that the file has throughout, s.
    fn period(&self, file: &str, requested: Option<f64>) -> Result<f64> {
        if let Some(period) = requested.filter(|period| *period > 0.0) {
            return Ok(period);
        }
        let steps = (self.times.len() - 1) as f64;
        let begin = self.times[0];
        let period = (self.times[self.times.len() - 1] - begin) / steps;
        // Decimal times leave a rest that no drive counts.
        let whole = (period / SAME_S).round() * SAME_S;
        if self
            .times
            .iter()
            .enumerate()
            .all(|(k, time)| (time - begin - k as f64 * period).abs() < SAME_S)
            && (whole - period).abs() * steps < SAME_S
        {
            return Ok(whole);
        }
        Err(Problem::usage("E217", format!("the times of {file} are not evenly spaced."))
            .hint("give the period of the set-points: --period 2ms"))
    }

    /// For each axis its column.
    fn column_order(&self, axes: &[LocalAxis]) -> Result<Vec<usize>> {
        if self.columns.len() != axes.len() {
            let what = format!("{} columns for {} axes.", self.columns.len(), axes.len());
            return Err(Problem::usage("E245", what)
                .why("The file has a column for each axis in the connection string."));
        }
        if self.columns.iter().all(|column| column.name.is_empty()) {
            return Ok((0..axes.len()).collect());
        }
        axes.iter()
            .map(|axis| {
                let number = axis.number().to_string();
                self.columns
                    .iter()
                    .position(|column| column.name == number || column.name == axis.name())
                    .ok_or_else(|| {
                        Problem::usage("E245", format!("no column is named `{number}`.")).why(
                            "The header names each axis by its number, or its name in the rack.",
                        )
                    })
            })
            .collect()
    }

    /// Set-points every `period`, those of a cycle side by side in the order of the axes: on the
    /// straight line between two of the file.
    fn resample(&self, period: f64, order: &[usize]) -> Result<Vec<f64>> {
        let (first, last) = (self.times[0], self.times[self.times.len() - 1]);
        let cycles = ((last - first - SAME_S) / period).ceil();
        if cycles > CYCLES_MAX {
            return Err(Problem::usage("E217", "the path has too many cycles.")
                .hint("cut the file into parts, or choose a longer period"));
        }
        let (mut at, mut all) = (0, Vec::new());
        for k in 0..=cycles as usize {
            let time = (first + k as f64 * period).min(last);
            while at + 2 < self.times.len() && self.times[at + 1] <= time {
                at += 1;
            }
            let part = (time - self.times[at]) / (self.times[at + 1] - self.times[at]);
            all.extend(order.iter().map(|n| {
                let (from, to) = (self.rows[at][*n], self.rows[at + 1][*n]);
                from + (to - from) * part.clamp(0.0, 1.0)
            }));
        }
        Ok(all)
    }
}

fn line_problem(n: usize, why: String, file: &str) -> Problem {
    Problem::usage("E210", format!("{file}:{n}: {why}.")).why(
        "A line is a time and a set-point for each axis; the header names them with \
                 their units: `time s, 2 deg, 3 deg`.",
    )
}

impl SetpointColumn {
    fn unnamed() -> Self {
        Self { name: String::new(), factor: 1.0, quantity: None }
    }
}

fn parse_numbers(line: &str) -> Option<Vec<f64>> {
    line.split(',')
        .map(|cell| cell.trim().parse::<f64>().ok().filter(|number| number.is_finite()))
        .collect()
}

/// `2 deg`, `2 [deg]`, `time s`.
fn parse_column(cell: &str) -> std::result::Result<SetpointColumn, String> {
    let cell = cell.trim();
    let (name, unit) = cell.split_once([' ', '[', '(']).unwrap_or((cell, ""));
    let unit = unit.trim_matches([' ', '[', ']', '(', ')']);
    let name = name.trim().to_owned();
    if unit.is_empty() {
        return Ok(SetpointColumn { name, ..SetpointColumn::unnamed() });
    }
    let measure = polepair::quantity::parse(&format!("1 {unit}")).map_err(|e| e.to_string())?;
    Ok(SetpointColumn { name, factor: measure.si, quantity: measure.quantity })
}
