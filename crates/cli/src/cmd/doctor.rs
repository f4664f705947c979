//! `polepair doctor [URL]`

use std::io::IsTerminal as _;

use clap::Args;
use polepair::doctor::{self, Check, Grade, Options, Unproven, Witness};
use polepair::url::shell_word;
use polepair::{Axis, Connector, Error};
use polepair_capture::jsonl;

use crate::cmd::watchdog::span;
use crate::interrupt;
use crate::motion::Owed;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::Session;
use crate::terminal::{Output, colour_out, draw, say};

/// Looks for what is wrong, from the cable up, and says what to try.
///
/// Without a URL: this machine's adapters and configuration. With one: that link, step by step.
/// Nothing is moved or written, but by --prove-watchdog. Ctrl-C ends that, too: the motor is stopped and
/// its watchdog set as before. The exit code is that of the worst check that is wrong.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair doctor
  polepair doctor tmcl+serial:///dev/ttyUSB0:9600#1
  polepair doctor modbus-rtu+serial:///dev/ttyUSB0 --try-bauds
  polepair doctor sim:tmcl --prove-watchdog=500ms --yes")]
pub struct Doctor {
    /// The link: tmcl+serial:///dev/ttyUSB0:9600#1, sim:tmcl, @name
    #[arg(value_name = "URL")]
    url: Option<String>,
    /// Where nobody answers, ask at other baud rates too, by reads
    #[arg(long, requires = "url")]
    try_bauds: bool,
    /// Turn the motor, which must be free, fall silent, and see whether the drive stops it by itself;
    /// with a time its watchdog is set to that first
    #[arg(long, requires = "url", value_name = "TIME", num_args = 0..=1, require_equals = true)]
    prove_watchdog: Option<Option<String>>,
    /// Do not ask before the motor turns
    #[arg(short, long, requires = "prove_watchdog")]
    yes: bool,
    /// How the checks are printed
    #[arg(long, value_enum, default_value_t = Shape::Text)]
    format: Shape,
    #[command(flatten)]
    profiles: super::ProfileFile,
}

/// How checks are printed.
#[derive(Clone, Copy, PartialEq, Eq, Debug, clap::ValueEnum)]
enum Shape {
    /// For people
    Text,
    /// One JSON object a check
    Jsonl,
}

impl Doctor {
    pub fn run(self) -> Result {
        let connector = self.profiles.connector()?;
        let mut worst = None;
        let mut hear = |check: Check| {
            worst = worst.max((check.grade == Grade::Wrong).then_some(check.exit));
            show(&check, self.format)
        };
        self.look(&connector, &mut hear)?;
        if let (Some(url), Some(time)) = (&self.url, &self.prove_watchdog) {
            self.prove(&connector, url, time.as_deref(), &mut hear)?;
        }
        match worst {
            None => Ok(Exit::Ok),
            // The checks said what there is to say.
            Some(exit) => Err(Problem::new(exit, "", "")),
        }
    }

    /// Turns motors, falls silent, and tells whether their drives stopped them.
    fn prove(
        &self,
        connector: &Connector,
        url: &str,
        time: Option<&str>,
        show: &mut dyn FnMut(Check) -> Result<()>,
    ) -> Result<()> {
        let after = time.map(span).transpose()?.flatten();
        if time.is_some() && after.is_none() {
            return Err(Problem::usage("E217", "a watchdog that is off stops nothing."));
        }
        let link = connector.connect(url).map_err(outcome::error)?;
        let session = Session { link, words: shell_word(url).into_owned() };
        self.consent(&session)?;
        session.listen();
        let words = &session.words;
        // Whoever leaves at once is told what is left behind, the watchdog's value too.
        let _holding = interrupt::hold(&match after {
            None => words.clone(),
            Some(_) => format!(
                "{words}; its watchdog may not be as it was: `polepair watchdog {words}` shows and sets it"
            ),
        });
        let mut watching = Watching { show, shown: Ok(()), owed: None };
        for axis in session.axes() {
            if interrupt::came() {
                break;
            }
            if let Err(unproven) = doctor::prove_watchdog(axis, after, &mut watching) {
                return Err(watching.unproven(axis, &session, unproven));
            }
        }
        if interrupt::came() {
            say("interrupted: no motor turns by this proof any more");
            return Err(Problem::interrupted());
        }
        watching.shown
    }

    /// A motor turns only if somebody agrees.
    fn consent(&self, session: &Session) -> Result<()> {
        if self.yes {
            return Ok(());
        }
        let refused = |what: &str| Problem::usage("E247", what).why("Nothing was moved.");
        if !std::io::stdin().is_terminal() {
            return Err(refused("nobody is there to agree.").hint("--yes turns it without asking"));
        }
        for axis in session.axes() {
            let speed = doctor::proving_speed(axis.profile().axis);
            draw(&format!("{} will turn at {speed}: is it free? [y/N] ", axis.label()));
            let mut answer = String::new();
            let read = std::io::stdin().read_line(&mut answer).is_ok();
            if !read || !matches!(answer.trim(), "y" | "Y" | "yes") {
                return Err(refused("not agreed."));
            }
        }
        Ok(())
    }

    fn look(&self, connector: &Connector, show: &mut dyn FnMut(Check) -> Result<()>) -> Result<()> {
        let mut shown = Ok(());
        let mut hear = |check| {
            if shown.is_ok() {
                shown = show(check);
            }
        };
        match &self.url {
            None => doctor::machine(connector).into_iter().for_each(hear),
            Some(url) => {
                let options = Options { try_bauds: self.try_bauds };
                doctor::link(connector, url, options, &mut hear).map_err(outcome::error)?;
            }
        }
        shown
    }
}

/// Shows what a proof finds, and ends it when somebody wants that.
struct Watching<'a> {
    show: &'a mut dyn FnMut(Check) -> Result<()>,
    shown: Result<()>,
    /// What is said of a stop that was lost.
    owed: Option<Owed>,
}

impl Witness for Watching<'_> {
    fn hear(&mut self, check: Check) {
        if self.shown.is_ok() {
            self.shown = (self.show)(check);
        }
    }

    fn ends(&self) -> bool {
        interrupt::came()
    }

    fn again(&mut self, axis: &Axis, turns: bool) -> bool {
        let may = if turns { "still turn" } else { "still be powered" };
        self.owed.get_or_insert_with(Owed::new).again(axis, may)
    }
}

impl Watching<'_> {
    /// Why nothing was proven, and what became of the motor.
    fn unproven(&mut self, axis: &Axis, session: &Session, unproven: Unproven) -> Problem {
        let Unproven { error, moved, may_turn } = unproven;
        if let (false, Some(owed)) = (may_turn, &mut self.owed) {
            let _ = owed.told(axis, Ok(()));
        }
        if !may_turn && matches!(*error, Error::Interrupted { .. }) {
            say(match moved {
                true => "interrupted: the motor was stopped",
                false => "interrupted: nothing moved",
            });
            return Problem::interrupted();
        }
        let problem = Problem { may_turn, ..outcome::error(*error) };
        let stop = format!("polepair stop {}, once its drive answers again", session.words);
        problem.hint_if(may_turn.then_some(stop))
    }
}

/// One line, at once: some checks take their time.
fn show(check: &Check, format: Shape) -> Result<()> {
    let mut out = Output::stdout();
    match format {
        Shape::Text => out.line(&line(check, colour_out())),
        Shape::Jsonl => object(check, out.buffer()),
    }
    out.flush()
}

fn line(check: &Check, colour: bool) -> String {
    let paint = match check.grade {
        _ if !colour => "",
        Grade::Ok => "\x1b[32m",
        Grade::Look => "\x1b[33m",
        Grade::Wrong => "\x1b[1;31m",
    };
    let off = if colour { "\x1b[0m" } else { "" };
    let Check { about, found, remedy, .. } = check;
    let hint = if remedy.is_empty() { String::new() } else { format!("; try: {remedy}") };
    format!("{paint}{:<5}{off}  {about}: {found}{hint}", check.grade.word())
}

fn object(check: &Check, out: &mut Vec<u8>) {
    let fields = [
        ("{\"grade\":", check.grade.word()),
        (",\"about\":", &check.about),
        (",\"found\":", &check.found),
        (",\"remedy\":", &check.remedy),
    ];
    for (key, value) in fields {
        out.extend_from_slice(key.as_bytes());
        jsonl::string(out, value);
    }
    out.extend_from_slice(format!(",\"exit\":{}}}\n", check.exit as u8).as_bytes());
}
