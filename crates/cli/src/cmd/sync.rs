//! `polepair sync URL [--period 20ms] [--master AXIS] [--stop]`

use std::cell::Cell;
use std::time::Duration;

use clap::Args;
use polepair::LocalAxis;
use polepair::url::AxisNumber;
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::Signal;
use polepair_link::clock;

use crate::data_output::DataOutput;
use crate::motion::parse_argument;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::{LocalSession, read_signal, run_verb};
use crate::target::DriveArgs;
use crate::terminal::{print_note, print_warning};
use crate::value::format_number;

/// Time for drives to adopt the master's time, ms.
const SETTLE_MS: u32 = 500;
/// Times each drive is compared with the master; the quickest comparison counts.
const COMPARISONS: usize = 8;
/// Offsets beyond this, and beyond what the line leaves open, are not kept together, s.
const TOGETHER_S: f64 = 1e-3;

/// Synchronises the clocks of several drives, and shows the difference between them.
///
/// One drive is the master and sends its time periodically, without the host, until --stop or power-off.
/// All drives must be on one bus.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair sync tmlcan+socketcan://can0#1,2,3 --period 20ms
  polepair sync tmlcan+socketcan://can0#1,2,3 --stop")]
pub struct Sync {
    #[command(flatten)]
    target: DriveArgs,
    /// Period of the master's time messages
    #[arg(long, value_name = "TIME", default_value = "20ms")]
    period: String,
    /// Axis of the master [default: the first]
    #[arg(long, value_name = "AXIS")]
    master: Option<u32>,
    /// End the synchronisation, and show the difference between the clocks
    #[arg(long)]
    stop: bool,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
}

impl Sync {
    pub fn run(self) -> Result {
        if self.dry_run {
            let first = Cell::new(true);
            return self.target.rehearse(|axis| {
                let is_first = first.replace(false);
                self.time_command(
                    axis,
                    self.master.map_or(is_first, |master| master == axis.number()),
                )
            });
        }
        let session = self.target.open()?;
        session.listen_for_interrupts();
        let master = self.find_master(&session)?;
        if let Some(group) = session.axes().iter().find(|axis| AxisNumber(axis.number()).is_group())
        {
            let what = format!("{} cannot be synchronised as a group.", group.label());
            return Err(Problem::usage("E245", what).why("Name its axes one by one."));
        }
        if session.axes().len() < 2 {
            return Err(Problem::usage("E245", "synchronisation needs several axes.")
                .hint("name several in the connection string: #1,2,3"));
        }
        // The others first: two masters would pull the rest back and forth.
        for axis in session.axes().iter().filter(|axis| axis.number() != master.number()) {
            run_verb(axis, Verb::WithholdTime)?;
        }
        let command = self.time_command(master, true)?;
        master.run(command).map_err(outcome::to_problem)?;
        if self.stop {
            print_note("the synchronisation is ended");
        } else {
            print_note(&format!("{} sends its time every {}", master.label(), self.period));
            print_warning(&format!("to end it: polepair sync {} --stop", session.arguments));
            session.link.sleep(Duration::from_millis(SETTLE_MS.into()));
        }
        let apart = print_offsets(&session, master)?;
        if apart && !self.stop {
            return Err(Problem::new(Exit::Negative, "E101", "the drives are not synchronous.")
                .why("An axis is more than a millisecond off its master.")
                .hint("they must be on one CAN bus, and have been initialised: enable each once"));
        }
        Ok(Exit::Ok)
    }

    fn time_command(&self, axis: &LocalAxis, is_master: bool) -> Result<Command> {
        if !is_master || self.stop {
            return Ok(Command::new(Verb::WithholdTime));
        }
        let period = parse_argument(
            &axis.clone().into(),
            Verb::GiveTime,
            Argument::Period,
            &self.period,
            false,
        )?;
        if period <= 0.0 {
            return Err(Problem::usage("E217", "--period is more than 0; --stop ends it."));
        }
        Ok(Command { period: Some(period), ..Command::new(Verb::GiveTime) })
    }

    fn find_master<'a>(&self, session: &'a LocalSession) -> Result<&'a LocalAxis> {
        let mut axes = session.axes().iter();
        let found = axes.find(|axis| self.master.is_none_or(|master| master == axis.number()));
        found.ok_or_else(|| {
            Problem::usage("E245", "the master is not an axis of the connection string.")
        })
    }
}

/// Prints how far each axis is off the master; true when one is too far.
fn print_offsets(session: &LocalSession, master: &LocalAxis) -> Result<bool> {
    let (mut out, mut apart) = (DataOutput::stdout(), false);
    for axis in session.axes().iter().filter(|axis| axis.number() != master.number()) {
        let (offset, open) = measure_offset(master, axis)?;
        apart |= offset.abs() > TOGETHER_S + open;
        let (offset, open) = (format_number(offset * 1e3), format_number(open * 1e3));
        out.write_line(&format!("#{} offset = {offset} ms (within {open} ms)", axis.number()));
    }
    out.flush()?;
    Ok(apart)
}

/// Offset of an axis from the master, and how exactly the line lets it be known, s: the axis is asked
/// between two questions to the master.
fn measure_offset(master: &LocalAxis, axis: &LocalAxis) -> Result<(f64, f64)> {
    let mut best = (0.0, f64::INFINITY);
    for _ in 0..COMPARISONS {
        let (before, requested_at) = (read_time(master)?, clock::now());
        let between = read_time(axis)?;
        let (after, open) = (read_time(master)?, clock::now().since(requested_at).as_secs_f64());
        if open < best.1 {
            best = (between - f64::midpoint(before, after), open);
        }
    }
    Ok(best)
}

fn read_time(axis: &LocalAxis) -> Result<f64> {
    read_signal(axis, Signal::Time)?.map(|read| read.value).ok_or_else(|| {
        let what = format!("{} does not report its time.", axis.label());
        Problem::usage("E213", what)
    })
}
