//! `polepair doctor [URL]`

use std::io::IsTerminal as _;

use clap::Args;
use polepair::doctor::{self, CheckResult, DoctorOptions, Grade, ProofError, ProofObserver};
use polepair::url::shell_word;
use polepair::{Connector, Error, LocalAxis};
use polepair_capture::jsonl;

use crate::cmd::watchdog::parse_time;
use crate::data_output::DataOutput;
use crate::interrupt;
use crate::motion::StopPrinter;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::LocalSession;
use crate::terminal::{colour_out, draw, print_warning};

/// Checks a link step by step, from the cable to the drive, and suggests what to try.
///
/// Without a URL, the command checks the adapters and the configuration of this machine. It moves and
/// writes nothing, except with --prove-watchdog. On Ctrl-C, --prove-watchdog stops the motor and restores
/// the watchdog setting. The exit code is that of the most serious failed check.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair doctor
  polepair doctor tmcl+serial:///dev/ttyUSB0:9600#1
  polepair doctor modbus-rtu+serial:///dev/ttyUSB0 --try-bauds
  polepair doctor sim:tmcl --prove-watchdog=500ms --yes")]
pub struct Doctor {
    /// Link to check: tmcl+serial:///dev/ttyUSB0:9600#1, sim:tmcl, @name
    #[arg(value_name = "URL")]
    url: Option<String>,
    /// If no drive replies, also try other baud rates, by reads only
    #[arg(long, requires = "url")]
    try_bauds: bool,
    /// Turn the free motor, stop sending, and check that the drive stops it; with TIME, set its watchdog
    /// first
    #[arg(long, requires = "url", value_name = "TIME", num_args = 0..=1, require_equals = true)]
    prove_watchdog: Option<Option<String>>,
    /// Do not ask before the motor turns
    #[arg(short, long, requires = "prove_watchdog")]
    yes: bool,
    /// Output format
    #[arg(long, value_enum, default_value_t = CheckFormat::Text)]
    format: CheckFormat,
    #[command(flatten)]
    profiles: crate::profile_args::ProfileFile,
}

/// Output formats of `doctor`.
#[derive(Clone, Copy, PartialEq, Eq, Debug, clap::ValueEnum)]
enum CheckFormat {
    /// Text
    Text,
    /// One JSON object for each check
    Jsonl,
}

impl Doctor {
    pub fn run(self) -> Result {
        let connector = self.profiles.connector()?;
        let mut worst = None;
        let mut on_event = |check: CheckResult| {
            worst = worst.max((check.grade == Grade::Wrong).then_some(check.exit));
            print_check(&check, self.format)
        };
        self.run_checks(&connector, &mut on_event)?;
        if let (Some(url), Some(time)) = (&self.url, &self.prove_watchdog) {
            self.prove_watchdogs(&connector, url, time.as_deref(), &mut on_event)?;
        }
        match worst {
            None => Ok(Exit::Ok),
            // The checks have printed everything.
            Some(exit) => Err(Problem::new(exit, "", "")),
        }
    }

    /// Turns motors, falls silent, and reports whether their drives stopped them.
    fn prove_watchdogs(
        &self,
        connector: &Connector,
        url: &str,
        time: Option<&str>,
        show: &mut dyn FnMut(CheckResult) -> Result<()>,
    ) -> Result<()> {
        let after = time.map(parse_time).transpose()?.flatten();
        if time.is_some() && after.is_none() {
            return Err(Problem::usage("E217", "a watchdog that is off cannot be tested."));
        }
        let link = connector.connect_local(url).map_err(outcome::to_problem)?;
        let session = LocalSession { link, arguments: shell_word(url).into_owned() };
        self.ask_consent(&session)?;
        session.listen_for_interrupts();
        let words = &session.arguments;
        // A user who leaves at once sees what is left behind, the watchdog's value too.
        let _holding = interrupt::hold_motion(&match after {
            None => words.clone(),
            Some(_) => format!(
                "{words}; its watchdog may have changed: `polepair watchdog {words}` shows and \
                 sets it"
            ),
        });
        let mut watching = ProofPrinter { print: show, print_result: Ok(()), stop_report: None };
        for axis in session.axes() {
            if interrupt::was_interrupted() {
                break;
            }
            if let Err(unproven) = doctor::prove_watchdog(axis, after, &mut watching) {
                return Err(watching.proof_problem(axis, &session, unproven));
            }
        }
        if interrupt::was_interrupted() {
            print_warning("interrupted: the test turns no motor any more");
            return Err(Problem::interrupted());
        }
        watching.print_result
    }

    /// Asks for consent before a motor turns.
    fn ask_consent(&self, session: &LocalSession) -> Result<()> {
        if self.yes {
            return Ok(());
        }
        if !std::io::stdin().is_terminal() {
            return Err(nothing_moved(
                "stdin is not a terminal, so the question cannot be \
             answered.",
            )
            .hint("--yes turns it without asking"));
        }
        for axis in session.axes() {
            let speed = doctor::proving_speed(axis.profile().axis);
            draw(&format!("{} will turn at {speed}: is it free? [y/N] ", axis.label()));
            let mut answer = String::new();
            let read = std::io::stdin().read_line(&mut answer).is_ok();
            if !read || !matches!(answer.trim(), "y" | "Y" | "yes") {
                return Err(nothing_moved("not agreed."));
            }
        }
        Ok(())
    }

    fn run_checks(
        &self,
        connector: &Connector,
        show: &mut dyn FnMut(CheckResult) -> Result<()>,
    ) -> Result<()> {
        let mut shown = Ok(());
        let mut on_event = |check| {
            if shown.is_ok() {
                shown = show(check);
            }
        };
        match &self.url {
            None => doctor::check_machine(connector).into_iter().for_each(on_event),
            Some(url) => {
                let options = DoctorOptions { try_bauds: self.try_bauds };
                doctor::check_link(connector, url, options, &mut on_event)
                    .map_err(outcome::to_problem)?;
            }
        }
        shown
    }
}

fn nothing_moved(what: &str) -> Problem {
    Problem::usage("E247", what).why("Nothing was moved.")
}

/// Prints the observations of a proof, and ends it on a request of the user.
struct ProofPrinter<'a> {
    print: &'a mut dyn FnMut(CheckResult) -> Result<()>,
    print_result: Result<()>,
    /// Printer of a stop that was lost.
    stop_report: Option<StopPrinter>,
}

impl ProofObserver for ProofPrinter<'_> {
    fn report_check(&mut self, check: CheckResult) {
        if self.print_result.is_ok() {
            self.print_result = (self.print)(check);
        }
    }

    fn is_cancelled(&self) -> bool {
        interrupt::was_interrupted()
    }

    fn retry_stop(&mut self, axis: &LocalAxis, turns: bool) -> bool {
        let may = if turns { "still turn" } else { "still be powered" };
        self.stop_report.get_or_insert_with(StopPrinter::new).report_retry(&axis.label(), may)
    }
}

impl ProofPrinter<'_> {
    /// Describes why nothing was proven, and the state of the motor.
    fn proof_problem(
        &mut self,
        axis: &LocalAxis,
        session: &LocalSession,
        unproven: ProofError,
    ) -> Problem {
        let ProofError { error, moved, may_turn } = unproven;
        if let (false, Some(report)) = (may_turn, &self.stop_report) {
            report.report_end(&axis.label(), true);
        }
        if !may_turn && matches!(*error, Error::Interrupted { .. }) {
            print_warning(if moved {
                "interrupted: the motor was stopped"
            } else {
                "interrupted: nothing moved"
            });
            return Problem::interrupted();
        }
        let problem = Problem { may_turn, ..outcome::to_problem(*error) };
        let stop = format!("`polepair stop {}`, once its drive answers again", session.arguments);
        problem.hint_if(may_turn.then_some(stop))
    }
}

/// One line, at once: some checks take their time.
fn print_check(check: &CheckResult, format: CheckFormat) -> Result<()> {
    let mut out = DataOutput::stdout().with_text(format == CheckFormat::Text);
    match format {
        CheckFormat::Text => out.write_line(&check_line(check, colour_out())),
        CheckFormat::Jsonl => write_json(check, out.buffer()),
    }
    out.flush()
}

fn check_line(check: &CheckResult, colour: bool) -> String {
    let paint = match check.grade {
        _ if !colour => "",
        Grade::Ok => "\x1b[32m",
        Grade::Suspicious => "\x1b[33m",
        Grade::Wrong => "\x1b[1;31m",
    };
    let off = if colour { "\x1b[0m" } else { "" };
    let CheckResult { about, found, remedy, .. } = check;
    let hint = if remedy.is_empty() { String::new() } else { format!("; try: {remedy}") };
    format!("{paint}{:<5}{off}  {about}: {found}{hint}", check.grade.word())
}

fn write_json(check: &CheckResult, out: &mut Vec<u8>) {
    let fields = [
        ("{\"grade\":", check.grade.word()),
        (",\"about\":", &check.about),
        (",\"found\":", &check.found),
        (",\"remedy\":", &check.remedy),
    ];
    for (key, value) in fields {
        out.extend_from_slice(key.as_bytes());
        jsonl::write_string(out, value);
    }
    out.extend_from_slice(format!(",\"exit\":{}}}\n", check.exit as u8).as_bytes());
}
