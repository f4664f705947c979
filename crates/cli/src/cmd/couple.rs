//! `polepair couple URL#2 --to 1 --ratio 1:3`, `polepair uncouple URL#2 --to 1`

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use clap::Args;
use polepair::url::without_axes;
use polepair::{Axis, Cam, CamPlan, CamPoint, GearRatio, LocalAxis};
use polepair_core::axis::Verb;

use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::{self, LocalSession, run_verb};
use crate::target::DriveArgs;
use crate::terminal::{print_note, print_warning};
use crate::value;

/// Couples an axis to another one of its bus: it follows that axis by a ratio or a table.
///
/// The drives do it by themselves, without the host, until `uncouple`, a stop or another motion of the
/// follower. The follower is powered. Nothing moves until the master does, which must be at rest now.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair couple tmlcan+socketcan://can0#2 --to 1 --ratio 1:3
  polepair couple tmlcan+socketcan://can0#2 --to 1 --ratio=-2:1
  polepair couple tmlcan+socketcan://can0#2 --to 1 --cam press.csv --inferred")]
pub struct Couple {
    #[command(flatten)]
    target: DriveArgs,
    /// Axis of the master: its number, or its connection string on the same link
    #[arg(long, value_name = "AXIS")]
    to: String,
    /// Turns of the follower to turns of the master; a negative number turns the other way
    #[arg(long, value_name = "N:M", value_parser = parse_ratio, allow_hyphen_values = true)]
    #[arg(required_unless_present = "cam", conflicts_with = "cam")]
    ratio: Option<GearRatio>,
    /// CSV of positions, with a first line such as `master [deg],follower [deg]`
    #[arg(long, value_name = "FILE", requires = "inferred")]
    cam: Option<PathBuf>,
    /// Memory of the follower for the table, that nothing else uses
    #[arg(long, value_name = "FIRST-LAST", value_parser = value::parse_memory, requires = "cam")]
    buffer: Option<RangeInclusive<u16>>,
    /// Use a layout of the drive's cam tables that no public source states
    #[arg(long)]
    inferred: bool,
}

/// Ends the coupling of an axis: it stops and holds its position, and the master sends no more.
///
/// The master must be at rest.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair uncouple tmlcan+socketcan://can0#2 --to 1")]
pub struct Uncouple {
    #[command(flatten)]
    target: DriveArgs,
    /// Axis of the master: its number, or its connection string on the same link
    #[arg(long, value_name = "AXIS")]
    to: String,
}

/// Ratio or table of a coupling.
enum Coupling {
    Gear(GearRatio),
    Cam(CamPlan),
}

/// Two axes of an open link.
struct Pair {
    session: LocalSession,
    follower: LocalAxis,
    master: LocalAxis,
}

impl Couple {
    pub fn run(self) -> Result {
        let points = self.cam.as_deref().map(read_cam).transpose()?;
        let pair = Pair::open(&self.target, &self.to)?;
        let coupling = match (points, self.ratio) {
            (Some(points), _) => {
                let cam = Cam { points, memory: self.buffer, accept_inferred: self.inferred };
                Coupling::Cam(
                    pair.follower.plan_cam(&pair.master, &cam).map_err(outcome::to_problem)?,
                )
            }
            (None, Some(ratio)) => Coupling::Gear(ratio),
            (None, None) => return Err(Problem::usage("E217", "name --ratio or --cam.")),
        };
        pair.couple(&coupling)?;
        let (follower, master) = (pair.follower.label(), pair.master.label());
        print_note(&format!("{follower} follows {master}: {}", coupling.describe()));
        print_warning(&format!("{follower} is powered, and turns when {master} does"));
        print_warning(&format!("to end it: polepair uncouple {} --to {}", pair.name(), self.to));
        Ok(Exit::Ok)
    }
}

impl Uncouple {
    pub fn run(self) -> Result {
        let pair = Pair::open(&self.target, &self.to)?;
        pair.follower.uncouple(&pair.master).map_err(outcome::to_problem)?;
        let (follower, master) = (pair.follower.label(), pair.master.label());
        let is_enabled = session::is_enabled(&Axis::from(pair.follower.clone()))?;
        let power = if is_enabled { "holds its position, powered" } else { "has no power" };
        print_note(&format!("{follower} is at rest and {power}"));
        print_note(&format!("{master} acknowledged the command to send its position no more"));
        Ok(Exit::Ok)
    }
}

impl Coupling {
    fn describe(&self) -> String {
        match self {
            Self::Gear(ratio) => {
                format!("turns of their motors {}:{}", ratio.follower, ratio.master)
            }
            Self::Cam(plan) => {
                let (memory, points, step) = (plan.memory(), plan.points(), plan.step());
                let (first, last) = (memory.start(), memory.end());
                format!(
                    "cam of {points} points, one every {step} counts of the master; table at \
                     0x{first:04X} to 0x{last:04X}"
                )
            }
        }
    }
}

impl Pair {
    /// Opens both axes of a link.
    fn open(target: &DriveArgs, to: &str) -> Result<Self> {
        let master = match to.split_once('#') {
            Some((link, axis)) if link.is_empty() || link == without_axes(&target.url) => axis,
            Some((link, _)) => {
                let what = format!("{link} is another link than {}.", without_axes(&target.url));
                return Err(Problem::usage("E245", what)
                    .why("Axes that follow each other are on one bus.")
                    .hint("name the master by its number: --to 1"));
            }
            None => to,
        };
        let session = match target.url.split_once('#') {
            Some((_, axes)) if !axes.split(',').any(|axis| axis == master) => {
                target.open_with(&target.connector()?, &format!("{},{master}", target.url))?
            }
            _ => target.open()?,
        };
        session.listen_for_interrupts();
        let master = session.link.axis_named(master).map_err(outcome::to_problem)?;
        let mut others = session.axes().iter().filter(|axis| axis.number() != master.number());
        let (Some(follower), None) = (others.next().cloned(), others.next()) else {
            return Err(Problem::usage("E245", "a coupling has one follower.").hint(
                "name the follower in the connection string, and the master by --to: URL#2 --to 1",
            ));
        };
        Ok(Self { session, follower, master })
    }

    /// The connection string of the follower.
    fn name(&self) -> &str {
        &self.session.arguments
    }

    /// Powers the follower and couples it. What was powered here is off again after an error.
    fn couple(&self, coupling: &Coupling) -> Result<()> {
        let Self { follower, master, .. } = self;
        let axis = Axis::from(follower.clone());
        let was_enabled = session::is_enabled(&axis)?;
        axis.arm().map_err(outcome::to_problem)?;
        if !was_enabled {
            run_verb(follower, Verb::Enable)?;
        }
        let coupled = match coupling {
            Coupling::Gear(ratio) => follower.follow_gear(master, *ratio),
            Coupling::Cam(plan) => follower.follow_cam(master, plan),
        };
        if coupled.is_err() && !was_enabled && run_verb(follower, Verb::Disable).is_err() {
            print_warning(&format!("{} may be powered", follower.label()));
        }
        coupled.map_err(outcome::to_problem)
    }
}

fn read_cam(path: &Path) -> Result<Vec<CamPoint>> {
    let name = path.display();
    let text = std::fs::read_to_string(path).map_err(|error| {
        Problem::usage("E230", format!("cannot read {name}."))
            .why(format!("The system says: {error}. {}", outcome::sent_so_far()))
            .hint("a cam is a CSV with the positions of the master and of the follower")
    })?;
    CamPoint::parse_table(&text).map_err(|error| {
        let problem = outcome::to_problem(error);
        Problem { what: format!("{name}: {}", problem.what), ..problem }
    })
}

/// Reads a ratio: `1:3`, `-2:1`.
fn parse_ratio(text: &str) -> std::result::Result<GearRatio, String> {
    let part = |text: &str| text.trim().parse::<i32>().ok();
    let parts = text.split_once([':', '/']);
    let ratio = parts.and_then(|(follower, master)| {
        Some(GearRatio { follower: part(follower)?, master: part(master)? })
    });
    ratio.ok_or_else(|| "turns of the follower to turns of the master: 1:3".to_owned())
}

#[cfg(test)]
mod tests {
    use super::parse_ratio;
    use polepair::GearRatio;

    #[test]
    fn ratios_are_whole_turns() {
        assert_eq!(parse_ratio("1:3"), Ok(GearRatio { follower: 1, master: 3 }));
        assert_eq!(parse_ratio("-2/1"), Ok(GearRatio { follower: -2, master: 1 }));
        assert!(parse_ratio("0.5").is_err() && parse_ratio("1:x").is_err());
    }
}
