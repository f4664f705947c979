//! `polepair act URL|SOCKET ACT[=VALUE]…`

use clap::Args;
use polepair::simulate::{ACTS, ActValue, parse_act, parse_act_value};
use polepair_client::Gateway;

use crate::control::{self, ActReply};
use crate::data_output::DataOutput;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, ServerArgs};
use crate::terminal::{TextTable, colour_out, print_note};

/// Changes a simulated drive from outside: load, fault, input, supply.
///
/// Without ACT, the command lists all acts. The drive belongs to a `polepair sim` on this machine (URL as
/// `sim` printed it) or to a server (--server). In a rack file, [[link.drive.act]] runs acts at given
/// times.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair act tmcl+serial:///dev/pts/3#1 jam
  polepair act tmcl+serial:///dev/pts/3#1 jam=0 \"load=0.2 Nm\"
  polepair act thruster+udp://239.74.163.2:43113#11 \"supply=30 V\"
  polepair act /tmp/bench.sock#x input-3=1          a simulation with --control
  polepair act 1 encoder --server http://127.0.0.1:7365")]
pub struct ActCommand {
    /// Link and drive as `sim` printed them, or the path of the simulation's control socket
    #[arg(value_name = "URL|SOCKET")]
    url: Option<String>,
    /// Acts to run: jam, "supply=30 V", input-3=1
    #[arg(value_name = "ACT[=VALUE]")]
    acts: Vec<String>,
}

/// A simulated drive.
enum ActTarget {
    /// A drive of a `polepair sim` on this machine.
    Simulation { url: String },
    /// A drive of a server.
    Server { gateway: Gateway, link: u16, place: usize, label: String },
}

impl ActTarget {
    /// The drives that `url` names: on this machine, or on a server.
    fn find(server: ServerArgs, url: String) -> Result<Vec<Self>> {
        if !server.is_given() {
            return Ok(vec![Self::Simulation { url }]);
        }
        let server = server.open()?;
        let axes = server.axes_named(&url)?.into_iter();
        let targets = axes.map(|axis| {
            let same_link = server.bench.axes.iter().filter(|other| other.link == axis.link);
            let place = same_link.take_while(|other| other.id != axis.id).count();
            let gateway = server.gateway.clone();
            Self::Server { gateway, link: axis.link, place, label: axis.label }
        });
        Ok(targets.collect())
    }

    /// Has the drive act, and prints that it was done.
    fn act(&self, act: &str) -> Result<()> {
        match self {
            Self::Simulation { url } => {
                let reply = control::request_act(url, act).map_err(|error| {
                    let what = format!("{url} cannot be reached: {error}.");
                    Problem::new(Exit::Adapter, "E301", what)
                })?;
                match reply {
                    ActReply::Done => print_note(&format!("done: {act}")),
                    ActReply::Refused(why) => {
                        let what = format!("`{act}` was not executed: {why}.");
                        return Err(Problem::usage("E217", what));
                    }
                    ActReply::NoSimulation => return Err(no_simulation(url)),
                }
            }
            Self::Server { gateway, link, place, label } => {
                let (word, value) = parse_act_value(act).map_err(outcome::to_problem)?;
                let value = Some(value).filter(|value| value.is_finite());
                let done = gateway.act(*link, *place, &word, value);
                done.map_err(remote::refusal_problem)?;
                print_note(&format!("{label}: done: {act}"));
            }
        }
        Ok(())
    }
}

impl ActCommand {
    /// Runs the acts on drives of this machine, or of a server.
    pub fn run(self, server: ServerArgs) -> Result {
        let Some(url) = self.checked()? else { return list_acts() };
        for target in ActTarget::find(server, url)? {
            self.acts.iter().try_for_each(|act| target.act(act))?;
        }
        Ok(Exit::Ok)
    }

    /// The drive that is meant, once every act is one; `None` where nothing is to be done.
    fn checked(&self) -> Result<Option<String>> {
        for act in &self.acts {
            parse_act(act).map_err(outcome::to_problem)?;
        }
        match &self.url {
            Some(url) if !self.acts.is_empty() => Ok(Some(url.clone())),
            _ => Ok(None),
        }
    }
}

fn no_simulation(url: &str) -> Problem {
    let problem =
        Problem::usage("E212", format!("no simulation on this machine has the link of {url}."));
    if url.starts_with("sim:") {
        problem.hint(
            "a sim: link belongs to the program that opened it: run `polepair sim` and use the \
             URL that it \
             prints, or a rack's [[link.drive.act]]",
        )
    } else {
        problem.hint(
            "`polepair sim` prints the URLs of its links; real drives have no \
         acts",
        )
    }
}

fn list_acts() -> Result {
    let mut table = TextTable::with_heads(&["act", "value", "what it does"]);
    for kind in ACTS {
        let value = match kind.value {
            ActValue::None => "",
            ActValue::Flag => "1 or 0",
            ActValue::Number => "number",
            ActValue::Quantity(unit) => unit,
            ActValue::Place => "rad, deg, turn; or none",
        };
        table.add_row(vec![kind.word.to_owned(), value.to_owned(), kind.about.to_owned()]);
    }
    let mut out = DataOutput::stdout();
    out.write_line(table.render(colour_out()).trim_end());
    out.flush()?;
    Ok(Exit::Ok)
}
