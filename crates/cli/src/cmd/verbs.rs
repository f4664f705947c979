//! `polepair enable|disable|clear URL`

use std::time::Duration;

use clap::Args;
use polepair::Axis;
use polepair::url::AxisNumber;
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;

use crate::broadcast;
use crate::motion;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, ServerArgs};
use crate::session;
use crate::target::DriveArgs;
use crate::terminal::{print_note, print_warning};
use crate::value;

/// Interval of reading whether a drive is off.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
const POLLS_MAX: u32 = 10;

/// Text for an axis that was enabled.
const POWERED: &str = "is powered";
/// Text for an axis that acknowledged the command to switch its motor off, without a reading.
const SWITCHED_OFF: &str = "acknowledged the command to switch its motor off";
/// Text for an axis that reports its motor as off.
const UNPOWERED: &str = "is not powered now";
const CLEARED: &str = "faults are cleared";

/// Powers the motor. It holds its actual position.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair enable tmcl+serial:///dev/ttyUSB0#1")]
pub struct Enable {
    #[command(flatten)]
    target: DriveArgs,
    /// Longest wait, such as for a commutation search [default: 10 s]
    #[arg(long, value_name = "TIME", value_parser = value::parse_span)]
    timeout: Option<f64>,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
}

/// Removes power from the motor.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair disable tmcl+serial:///dev/ttyUSB0#1")]
pub struct Disable {
    #[command(flatten)]
    target: DriveArgs,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
}

/// Clears faults.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair clear modbus-rtu+serial:///dev/ttyUSB0#1")]
pub struct Clear {
    #[command(flatten)]
    target: DriveArgs,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
}

impl Enable {
    pub fn run(self, server: ServerArgs) -> Result {
        if self.dry_run {
            server.refuse_dry_run()?;
            return self.target.rehearse(|_| Ok(Command::new(Verb::Enable)));
        }
        if self.timeout.is_some() && server.is_given() {
            return Err(remote::unsupported_problem(
                "--timeout",
                "A server waits for power as long as the drive's profile says.",
            ));
        }
        let enable = Command::new(Verb::Enable);
        let enable = match self.timeout.and_then(|s| Duration::try_from_secs_f64(s).ok()) {
            Some(timeout) => enable.limited(timeout),
            None => enable,
        };
        let session = self.target.connect(server)?;
        session.listen_for_interrupts();
        let stops = format!("it stays powered until polepair disable {}", session.arguments);
        motion::print_start_note(session.axes().iter().cloned(), &session.arguments, &stops);
        let mut unconfirmed = None;
        for axis in session.axes() {
            axis.arm().map_err(outcome::to_problem)?;
            let mut unknown = None;
            motion::keep_unconfirmed(switch_power(axis, enable), &mut unknown)?;
            if unknown.is_some() {
                unconfirmed = unconfirmed.or(unknown);
                continue;
            }
            // The drive keeps its power.
            if axis.local().is_none() {
                axis.disarm().map_err(outcome::to_problem)?;
            }
            print_note(&format!("{} {POWERED}", axis.label()));
        }
        unconfirmed.map_or(Ok(Exit::Ok), Err)
    }
}

impl Disable {
    pub fn run(self, server: ServerArgs) -> Result {
        let mut target = self.target.for_stop();
        if !self.dry_run && !server.is_given() {
            target = broadcast::with_stations(target).map_err(|problem| problem.hint(CUT))?;
        }
        run_simple(&target, server, Verb::Disable, self.dry_run, power_off_text)
    }
}

impl Clear {
    pub fn run(self, server: ServerArgs) -> Result {
        run_simple(&self.target, server, Verb::Clear, self.dry_run, |_| Ok(CLEARED.to_owned()))
    }
}

const CUT: &str = "cut the power if a motor turns";

fn run_simple(
    target: &DriveArgs,
    server: ServerArgs,
    wanted: Verb,
    dry_run: bool,
    done: impl Fn(&Axis) -> Result<String>,
) -> Result {
    if dry_run {
        server.refuse_dry_run()?;
        return target.rehearse(|_| Ok(Command::new(wanted)));
    }
    // One that does not answer leaves no other with power.
    let (session, absent) = match wanted {
        Verb::Disable => target.connect_present(server).map_err(|problem| problem.hint(CUT))?,
        _ => (target.connect(server)?, Vec::new()),
    };
    session.listen_for_interrupts();
    let mut ended = Ok(());
    // Every axis gets its command, also after an error of another one.
    for axis in broadcast::broadcasts_first(session.axes()) {
        let one = switch_power(axis, Command::new(wanted)).and_then(|()| {
            if broadcast::is_broadcast(axis) { Ok(broadcast::SENT.to_owned()) } else { done(axis) }
        });
        if let Ok(done) = &one {
            print_note(&format!("{} {done}", axis.label()));
        }
        ended = ended.and(one.map(drop));
    }
    absent.iter().for_each(|problem| print_warning(problem.render(false).trim_end()));
    ended?;
    match absent.len() {
        0 => Ok(Exit::Ok),
        count => {
            let of = count + session.axes().len();
            let what = format!("{count} of {of} axes could not be read.");
            Err(Problem::new(Exit::Partial, "E704", what).hint(CUT))
        }
    }
}

/// Observation of a motor that was switched off: its power, and whether it turns.
fn power_off_text(axis: &Axis) -> Result<String> {
    let mut powered = read_signal_value(Signal::Enabled, axis);
    for _ in 0..POLLS_MAX {
        if powered.is_none_or(|powered| powered == 0.0) {
            break;
        }
        axis.sleep(POLL_INTERVAL);
        powered = read_signal_value(Signal::Enabled, axis);
    }
    if powered.is_some_and(|powered| powered != 0.0) {
        return Err(still_powered_problem(axis.label()));
    }
    if powered.is_none() && AxisNumber(axis.number()).is_group() {
        return Err(motion::unconfirmed_problem(axis.label(), "the command"));
    }
    let velocity = session::signal_text(axis, Signal::Velocity).ok().flatten();
    let off = if powered.is_some() { UNPOWERED } else { SWITCHED_OFF };
    Ok(match velocity {
        Some(velocity) if is_turning(axis) => {
            format!(
                "{SWITCHED_OFF}, and it still turns, {velocity}: it coasts, or an external force \
                 drives it"
            )
        }
        _ => off.to_owned(),
    })
}

fn read_signal_value(wanted: Signal, axis: &Axis) -> Option<f64> {
    if axis.has_signal(wanted) {
        axis.signals(&[wanted]).ok().and_then(|read| read.first().map(|one| one.value))
    } else {
        None
    }
}

/// Returns whether the motor turns, by its last readings.
fn is_turning(axis: &Axis) -> bool {
    match axis.local() {
        Some(axis) => axis.is_turning() == Some(true),
        None => axis.state().is_ok_and(|state| state.moving == Some(true)),
    }
}

/// Problem of an axis that acknowledged the command and reports power.
fn still_powered_problem(label: &str) -> Problem {
    let what = format!("{label} acknowledged the command, but its motor is still powered.");
    Problem::new(Exit::Negative, "E111", what)
        .why("The drive reports this.")
        .hint("cut its supply if the motor turns")
}

/// Executes a verb that changes the power of a motor, and reports an unknown state of the power.
fn switch_power(axis: &Axis, wanted: Command) -> Result<()> {
    let ended = axis.run(wanted);
    if let Err(error) = &ended {
        let label = axis.label();
        match (wanted.verb, error.executed()) {
            (Verb::Disable, _) => print_warning(&format!(
                "{label} may still be powered, and may still turn: cut its supply"
            )),
            (Verb::Enable, None) => print_warning(&format!("{label} may be powered")),
            _ => {}
        }
    }
    ended.map_err(outcome::to_problem)
}
