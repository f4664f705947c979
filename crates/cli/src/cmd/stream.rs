//! `polepair stream URL FILE`

use std::path::PathBuf;

use clap::Args;
use polepair_core::stream::{PathKind, Point};

use crate::motion::caution;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::target::Target;
use crate::terminal::say;

/// Moves an axis along the points of a file.
///
/// A line is `position, velocity, time`: rad, rad/s (m, m/s on linear axes), and the seconds since
/// the point before; `#` begins a comment. The path begins where the axis stands.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair stream tml+serial:///dev/ttyUSB0:115200#1 path.csv")]
pub struct Stream {
    #[command(flatten)]
    target: Target,
    /// The points
    #[arg(value_name = "FILE")]
    path: PathBuf,
    /// Lines are `position, time`: the drive interpolates positions alone
    #[arg(long)]
    pt: bool,
}

impl Stream {
    pub fn run(self) -> Result {
        let points = self.points()?;
        let session = self.target.open()?;
        let [axis] = session.axes() else {
            return Err(Problem::usage("E210", "A path is for one axis.")
                .why("Name it in the connection string: URL#1."));
        };
        caution(&session);
        session.listen();
        let armed = axis.armed().map_err(outcome::error)?;
        let kind = if self.pt { PathKind::Pt } else { PathKind::Pvt };
        let count = armed.stream(kind, points).map_err(outcome::error)?;
        armed.release().map_err(outcome::error)?;
        say(&format!("{count} points"));
        Ok(Exit::Ok)
    }

    fn points(&self) -> Result<Vec<Point>> {
        let name = self.path.display();
        let text = std::fs::read_to_string(&self.path).map_err(|error| {
            Problem::usage("E210", format!("{name} cannot be read.")).why(error.to_string())
        })?;
        let numbered = text.lines().enumerate().map(|(n, line)| (n + 1, line));
        let lines = numbered.map(|(n, line)| (n, line.split('#').next().unwrap_or("").trim()));
        lines
            .filter(|(_, line)| !line.is_empty())
            .map(|(n, line)| {
                self.point(line).ok_or_else(|| {
                    let form = if self.pt { "position, time" } else { "position, velocity, time" };
                    Problem::usage("E210", format!("{name}:{n}: `{line}` is no point."))
                        .why(format!("A line is `{form}`, in rad (or m) and seconds."))
                })
            })
            .collect()
    }

    fn point(&self, line: &str) -> Option<Point> {
        let mut numbers = line.split(',').map(|number| number.trim().parse::<f64>());
        let mut next = || numbers.next()?.ok().filter(|number| number.is_finite());
        let position = next()?;
        let velocity = if self.pt { 0.0 } else { next()? };
        let point = Point { position, velocity, time: next()? };
        (numbers.next().is_none() && point.time > 0.0).then_some(point)
    }
}
