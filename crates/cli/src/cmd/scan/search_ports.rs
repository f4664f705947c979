//! `polepair scan` without a connection string: searches ports for drives.

use std::io::IsTerminal as _;
use std::ops::ControlFlow;

use polepair::Connector;
use polepair::scan::DetectedDrive;
use polepair::search::{FoundLink, SearchReport, SearchStep, SilentPort, search};
use polepair::url::{AxisNumber, shell_word};

use super::drive_table::DriveColumn::{self, Axis, Clash, Drive, Known, Product, Reported, Url};
use super::drive_table::{DriveRow, print_drives};
use crate::problem::{Exit, Problem, Result};
use crate::target::OutputFormat;
use crate::terminal::{self, print_note, print_warning};
use crate::{interrupt, outcome};

/// Searches these ports, or all of this machine.
pub fn run_search(connector: &Connector, named: &[String], format: OutputFormat) -> Result {
    let live = LiveStep::new();
    interrupt::listen(|| {});
    let report = search(connector, named, &mut |step| {
        live.show(step);
        if interrupt::was_interrupted() {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    });
    drop(live);
    let report = report.map_err(outcome::to_problem)?;
    print_found(&report, format)?;
    report.silent.iter().for_each(print_silent);
    if report.is_interrupted {
        return Err(Problem::interrupted());
    }
    if !report.links.is_empty() {
        return Ok(Exit::Ok);
    }
    if report.silent.is_empty() {
        return Err(Problem::new(Exit::Adapter, "E309", "no serial or CAN adapter was found.")
            .why("The system lists no port that could be one.")
            .hint("plug it in and try again")
            .hint("`polepair scan sim:tmcl` needs no adapter"));
    }
    Err(Problem::new(Exit::NoReply, "E403", "no drive was found.")
        .why("No port gave a valid reply.")
        .hint("power, wiring (A and B may be swapped), and a switch or jumper for the address")
        .hint("a drive with an address above 32 or an unusual baud rate: polepair scan URL"))
}

/// A line on a terminal with the present attempt.
struct LiveStep {
    is_shown: bool,
}

impl LiveStep {
    fn new() -> Self {
        Self { is_shown: std::io::stderr().is_terminal() && !terminal::is_quiet() }
    }

    fn show(&self, step: &SearchStep<'_>) {
        if self.is_shown {
            terminal::draw(&format!(
                "\r\x1b[K{}: {} ({} of {})",
                terminal::escape_lines(step.port),
                step.attempt,
                step.done + 1,
                step.of.max(step.done + 1)
            ));
        }
    }
}

impl Drop for LiveStep {
    fn drop(&mut self) {
        if self.is_shown {
            terminal::draw("\r\x1b[K");
        }
    }
}

fn print_found(report: &SearchReport, format: OutputFormat) -> Result<()> {
    let found =
        report.links.iter().flat_map(|link| link.drives.iter().map(move |drive| (link, drive)));
    let drives: Vec<DriveRow> = found
        .map(|(link, drive)| {
            let url = axis_url(link, drive);
            let url =
                if format == OutputFormat::Text { shell_word(&url).into_owned() } else { url };
            DriveRow { url, ..DriveRow::from(drive) }
        })
        .collect();
    let columns: &[DriveColumn] = match format {
        OutputFormat::Text => &[Url, Drive, Product, Reported],
        _ => &[Url, Axis, Drive, Known, Product, Clash, Reported],
    };
    print_drives(&drives, columns, format)
}

/// The connection string of one drive, to be pasted.
fn axis_url(link: &FoundLink, drive: &DetectedDrive) -> String {
    format!("{}#{}", link.url, AxisNumber(drive.number))
}

fn print_silent(silent: &SilentPort) {
    let SilentPort { port, error, tried, damaged } = silent;
    match error {
        Some(error) => print_warning(&format!("{port}: not searched: {error}")),
        None if tried.is_empty() => print_note(&format!("{port}: not searched")),
        None => print_note(&format!("{port}: no drive replied to {tried}")),
    }
    if !damaged.is_empty() {
        print_warning(&format!(
            "{port}: something damaged came back to {}; noise, or a drive at another rate",
            damaged.join(", ")
        ));
    }
}
