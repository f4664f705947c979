//! `polepair stream URL FILE [--period TIME] [--mode csp|csv|cst] [--pt]`

mod cyclic;

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use polepair::{Error, LocalAxis};
use polepair_core::stream::cyclic::SetpointKind;
use polepair_core::stream::{PathKind, Point};

use crate::motion;
use crate::outcome;
use crate::problem::{Problem, Result};
use crate::session::LocalSession;
use crate::target::DriveArgs;
use crate::terminal::print_note;
use crate::value;

/// Moves axes along the points of a file.
///
/// Drives with a buffer (TML) take one axis. A line is `position, velocity, time` in rad, rad/s (linear
/// axes: m, m/s) and seconds since the line before. The time is 0.001 to 0.511 if the drive's slow loop is
/// 1 ms. The path begins at the actual position, which has no line.
///
/// Drives with cyclic modes take any number of axes on one SYNC. This form is used if the file has a
/// header, or with --period or --mode. A line is the time since the beginning and a set-point for each
/// axis. The header names columns and units: `time s, 2 deg, 3 deg`. Without it, times are in seconds, and
/// set-points are in the order of the axes, in rad, rad/s or Nm. `#` begins a comment.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair stream tml+serial:///dev/ttyUSB0:115200#1 path.csv
  polepair stream canopen+socketcan://can0#2,3 circle.csv --period 2ms")]
pub struct StreamCommand {
    #[command(flatten)]
    target: DriveArgs,
    /// File with the points
    #[arg(value_name = "FILE")]
    path: PathBuf,
    /// Lines are `position, time`; the drive interpolates positions only
    #[arg(long, conflicts_with_all = ["period", "mode"])]
    pt: bool,
    /// SYNC period; points in between are interpolated [default: that of the file]
    #[arg(long, value_name = "TIME", value_parser = value::parse_span)]
    period: Option<f64>,
    /// Type of the set-points [default: from the units of the columns]
    #[arg(long, value_enum)]
    mode: Option<CyclicMode>,
}

/// Cyclic synchronous modes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, ValueEnum)]
enum CyclicMode {
    /// Positions
    Csp,
    /// Velocities
    Csv,
    /// Torques
    Cst,
}

impl CyclicMode {
    const fn setpoint(self) -> SetpointKind {
        match self {
            Self::Csp => SetpointKind::Position,
            Self::Csv => SetpointKind::Velocity,
            Self::Cst => SetpointKind::Torque,
        }
    }
}

impl StreamCommand {
    pub fn run(self) -> Result {
        let lines = self.read_lines()?;
        let headed = lines.first().is_some_and(|(_, line)| cyclic::is_header(line));
        if headed || self.period.is_some() || self.mode.is_some() {
            let name = self.path.display().to_string();
            let mode = self.mode.map(CyclicMode::setpoint);
            return cyclic::run_cyclic(&self.target, &name, &lines, self.period, mode);
        }
        let points = self.parse_points(&lines)?;
        let session = self.target.open()?;
        let numbers: Vec<usize> = lines.iter().map(|(n, _)| *n).collect();
        self.stream_buffered(&session, points, &numbers)
    }

    /// Along a drive's own buffer.
    fn stream_buffered(
        &self,
        session: &LocalSession,
        points: Vec<Point>,
        lines: &[usize],
    ) -> Result {
        let [axis] = session.axes() else {
            return Err(Problem::usage("E210", "A path is for one axis.")
                .why("Name it in the connection string: URL#1.")
                .hint("drives with cyclic modes take several: --period 2ms"));
        };
        motion::print_program_note(session, false);
        session.listen_for_interrupts();
        let kind = if self.pt { PathKind::Pt } else { PathKind::Pvt };
        axis.check_path(kind, &points).map_err(outcome::to_problem)?;
        let late = first_too_long(axis, &points).map(|at| {
            let (name, n, time) = (self.path.display(), lines[at], points[at].time);
            format!(
                "{name}:{n} has {time} s; where the slow loop is 1 ms a time is 0.001 to 0.511 s"
            )
        });
        motion::run_powered(&session.arguments, &axis.clone().into(), || {
            let streamed = axis.stream(kind, points).map_err(|error| match error {
                Error::Interrupted { .. } => Problem::interrupted(),
                other if other.code() == "E222" => outcome::to_problem(other).hint_if(late),
                other => outcome::to_problem(other),
            });
            streamed.map(|count| print_note(&format!("{count} points")))
        })
    }

    /// Lines with content, with their numbers.
    fn read_lines(&self) -> Result<Vec<(usize, String)>> {
        let name = self.path.display();
        let text = std::fs::read_to_string(&self.path).map_err(|error| {
            // As of racks and profiles; the exit code is that of what cannot be carried out.
            let why = match error.kind() {
                std::io::ErrorKind::NotFound => "There is no such file.".to_owned(),
                _ => format!("The system says: {error}."),
            };
            Problem::usage("E230", format!("cannot read {name}."))
                .why(format!("{why} {}", outcome::sent_so_far()))
                .hint("its lines are the points of a path: `polepair stream --help`")
        })?;
        let numbered = text.lines().enumerate().map(|(n, line)| (n + 1, line));
        let bare = numbered
            .map(|(n, line)| (n, line.split_once('#').map_or(line, |(text, _)| text).trim()));
        Ok(bare.filter(|(_, line)| !line.is_empty()).map(|(n, line)| (n, line.into())).collect())
    }

    fn parse_points(&self, lines: &[(usize, String)]) -> Result<Vec<Point>> {
        let points = lines.iter().map(|(n, line)| {
            let name = self.path.display();
            let point = self.parse_point(line).ok_or_else(|| {
                let form = if self.pt { "position, time" } else { "position, velocity, time" };
                Problem::usage("E210", format!("{name}:{n}: `{line}` is not a point."))
                    .why(format!("A line is `{form}`, in rad (or m) and seconds."))
            })?;
            if point.time > 0.0 {
                return Ok(point);
            }
            let what = format!("{name}:{n}: the time {} s is not valid.", point.time);
            Err(Problem::usage("E210", what)
                .why(
                    "A time is the seconds since the line before: more than 0. Time 0 is the \
                     actual position at the start, and has no line.",
                )
                .hint("remove that line; each time counts from the line before"))
        });
        points.collect()
    }

    /// The numbers of a line, if they have that form.
    fn parse_point(&self, line: &str) -> Option<Point> {
        let mut numbers = line.split(',').map(|number| number.trim().parse::<f64>());
        let mut next = || numbers.next()?.ok().filter(|number| number.is_finite());
        let position = next()?;
        let velocity = if self.pt { 0.0 } else { next()? };
        let point = Point { position, velocity, time: next()? };
        numbers.next().is_none().then_some(point)
    }
}

/// The first of the points whose time is none that a TML drive takes where its slow loop is 1 ms.
fn first_too_long(axis: &LocalAxis, points: &[Point]) -> Option<usize> {
    let is_tml = matches!(axis.protocol(), "tml" | "tmlcan" | "technocan");
    is_tml.then(|| points.iter().position(|point| !(1.0..=511.0).contains(&rounded_ms(point))))?
}

fn rounded_ms(point: &Point) -> f64 {
    (point.time * 1e3).round()
}
