//! `polepair doctor [URL]`

use std::io::IsTerminal as _;

use clap::Args;
use polepair::Connector;
use polepair::doctor::{self, Check, Grade, Options};
use polepair_capture::jsonl;

use crate::cmd::watchdog::span;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::Session;
use crate::terminal::{Output, colour_out, draw};

/// Looks for what is wrong, from the cable up, and says what to try.
///
/// Without a URL: this machine's adapters and configuration. With one: that link, step by step.
/// Nothing is moved or written, but by --prove-watchdog. The exit code is that of the worst check that
/// is wrong.
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
        let session = Session { link, words: url.to_owned() };
        self.consent(&session)?;
        session.listen();
        let mut shown = Ok(());
        for axis in session.axes() {
            let mut hear = |check| {
                if shown.is_ok() {
                    shown = show(check);
                }
            };
            doctor::prove_watchdog(axis, after, &mut hear).map_err(outcome::error)?;
        }
        shown
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
