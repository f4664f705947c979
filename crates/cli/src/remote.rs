//! `--server URL`: runs verbs on the axes of a running server.
//!
//! Verbs have the same words and output formats. Axes of the server replace the URL: numbers, names,
//! `LINK#NUMBER`, or `all`. Values need a unit, because the default unit of a drive is not known here.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Arg, Args, Command};
use polepair::interface::is_gateway;
use polepair::remote::{RemoteLink, drive_unit};
use polepair::url::AxisNumber;
use polepair::{Axis, Error};
pub use polepair_client::ALL;
use polepair_client::message::{AxisInfo, BenchView, LinkState, LinkView};
use polepair_client::{Gateway, GatewayError, GatewayOptions, select_axes};
use polepair_core::plan::Argument;
use polepair_core::profile::Signal;
use polepair_core::units::Unit;
use polepair_link::clock;

use crate::outcome::{self, to_sentence};
use crate::problem::{Problem, Result};

/// Verbs that a server carries out, and which axes they are about.
const SERVER_VERBS: [(&str, AxesScope); 20] = [
    ("act", AxesScope::Named),
    ("clear", AxesScope::Named),
    ("disable", AxesScope::Named),
    ("dismiss", AxesScope::Named),
    ("enable", AxesScope::Named),
    ("get", AxesScope::Named),
    ("home", AxesScope::Named),
    ("info", AxesScope::AllUnlessNamed),
    ("jog", AxesScope::Named),
    ("monitor", AxesScope::AllUnlessNamed),
    ("move", AxesScope::Named),
    ("release", AxesScope::None),
    ("scan", AxesScope::AllUnlessNamed),
    ("send", AxesScope::Named),
    ("set", AxesScope::Named),
    ("spin", AxesScope::Named),
    ("stop", AxesScope::AllUnlessNamed),
    ("torque", AxesScope::Named),
    ("watch", AxesScope::Named),
    ("watchdog", AxesScope::AllUnlessNamed),
];

/// Axes of a server that a verb applies to.
#[derive(Clone, Copy, PartialEq)]
enum AxesScope {
    /// The named axes.
    Named,
    /// The named axes, or all.
    AllUnlessNamed,
    /// None: the verb concerns the server.
    None,
}

/// Options that help does not show, because they are about links.
const LINK_OPTIONS: [&str; 9] =
    ["arm", "detach", "file", "listen", "quick", "rules", "sync", "trace", "verbose"];

/// Help footer of `stop --server`.
const STOP_HELP: &str = "\
Without AXES, the server stops all axes and locks motion. Release it on the server's page or by
`release`. With AXES, the server stops these axes and locks nothing.";

/// Help footer of `scan --server`.
const SCAN_HELP: &str = "\
Without --look, the command lists the server's axes. With --look, the server scans the links of AXES, by
reads only, if no client controls an axis there. Ctrl-C ends the scan.";

/// Rewrites a gateway's address in the place of URL as `--server`: `spin ws://HOST#1` is
/// `spin --server ws://HOST 1`. A name in `polepair.toml` may stand for such an address.
pub fn rewrite_gateway_url(mut words: Vec<OsString>) -> Vec<OsString> {
    let verb = words.iter().skip(1).filter_map(word_text).find(|word| !word.starts_with('-'));
    if verb.as_deref() == Some("serve")
        || words.iter().any(|word| {
            word_text(word).is_some_and(|word| word == "--server" || word.starts_with("--server="))
        })
    {
        return words;
    }
    // Names of the configuration may mean servers.
    let expanded = |word: &OsString| {
        let word = word_text(word)?;
        let url = if word.starts_with('@') {
            polepair::config::Config::discover().expand(&word).ok()?
        } else {
            word
        };
        is_gateway(&url).then_some(url)
    };
    let found = words.iter().enumerate().skip(1).find_map(|(at, word)| Some((at, expanded(word)?)));
    let Some((at, url)) = found else { return words };
    let (address, axes) = url.split_once('#').unwrap_or((&url, ALL));
    let (address, query) = address.split_once('?').unwrap_or((address, ""));
    debug_assert!(at > 0, "the program's own name is no address");
    words[at] = axes.into();
    let keys = query.split('&').filter(|pair| !pair.is_empty()).map(|pair| format!("--{pair}"));
    let options = ["--server".to_owned(), address.to_owned()].into_iter().chain(keys);
    // Options of the program may stand before the verb.
    words.splice(1..1, options.map(OsString::from));
    words
}

fn word_text(word: &OsString) -> Option<String> {
    word.to_str().map(str::to_owned)
}

/// Options for a running server.
#[derive(Args, Debug, Default)]
#[command(next_help_heading = "Options for a running server")]
pub struct ServerArgs {
    /// Run the command on this `polepair serve`: http://127.0.0.1:7365; URL is then its axes: numbers,
    /// names, LINK#NUMBER, or all
    #[arg(long, value_name = "URL", global = true)]
    server: Option<String>,
    /// File with a token of the server [default: POLEPAIR_TOKEN, else that of your own server on this
    /// machine]
    #[arg(long, value_name = "FILE", global = true, hide_short_help = true)]
    token_file: Option<PathBuf>,
    /// Certificate of an https server, or its SHA-256 [default: that of your own server]
    #[arg(long, value_name = "FILE|SHA256", global = true)]
    #[arg(hide_short_help = true)]
    certificate: Option<String>,
    /// Client certificate for a server with --client-ca, in PEM
    #[arg(long, value_name = "FILE", global = true, hide_short_help = true)]
    client_cert: Option<PathBuf>,
    /// Key of the client certificate [default: contained in --client-cert]
    #[arg(long, value_name = "FILE", global = true)]
    #[arg(hide_short_help = true)]
    client_key: Option<PathBuf>,
}

impl ServerArgs {
    /// The command line's grammar where a server is named: URLs are axes.
    pub fn reword_help(command: Command) -> Command {
        SERVER_VERBS.iter().fold(command, |command, (verb, all)| {
            let dry = *verb != "set";
            let note = match *verb {
                "scan" => SCAN_HELP,
                "stop" => STOP_HELP,
                _ => "",
            };
            command.mut_subcommand(verb, |verb| {
                verb.mut_args(|arg| match arg.get_id().as_str() {
                    "url" => axes_argument(arg, all),
                    "dry_run" => arg.hide(dry),
                    "look" | "take" => arg.hide(false),
                    id if LINK_OPTIONS.contains(&id) => arg.hide(true),
                    _ => arg,
                })
                .after_help(note)
            })
        })
    }

    /// Hides the server's options from the help of verbs that do not use a server; the grammar stays.
    pub fn hide_server_options(command: Command) -> Command {
        let own = Self::augment_args(Command::new(""));
        command.mut_subcommands(|verb| {
            if SERVER_VERBS.iter().any(|(word, _)| *word == verb.get_name()) {
                verb
            } else {
                verb.args(own.get_arguments().cloned().map(|arg| arg.hide(true)))
            }
        })
    }

    /// Returns whether a server is named.
    pub fn is_given(&self) -> bool {
        self.server.is_some()
    }

    /// Checks that the server's options are complete: they may come before the verb and behind it, so the grammar
    /// cannot check it.
    ///
    /// # Errors
    /// A usage error for options of a server without its name.
    pub fn check(&self) -> Result<()> {
        let Self { server, token_file, certificate, client_cert, client_key } = self;
        let needs = [
            ("--token-file", token_file.is_some(), "--server URL", server.is_some()),
            ("--certificate", certificate.is_some(), "--server URL", server.is_some()),
            ("--client-cert", client_cert.is_some(), "--server URL", server.is_some()),
            ("--client-key", client_key.is_some(), "--server URL", server.is_some()),
            ("--client-key", client_key.is_some(), "--client-cert FILE", client_cert.is_some()),
        ];
        match needs.iter().find(|(_, given, _, beside)| *given && !beside) {
            Some((option, _, needed, _)) => {
                Err(Problem::usage("E242", format!("{option} needs {needed} beside it.")))
            }
            None => Ok(()),
        }
    }

    /// Refuses to show the frames of a server.
    pub fn refuse_dry_run(&self) -> Result<()> {
        if self.is_given() {
            Err(unsupported_problem(
                "--dry-run",
                "Only the program that opened the link can show frames.",
            ))
        } else {
            Ok(())
        }
    }

    /// Connects to the server, and receives its bench.
    pub fn open(self) -> Result<RemoteSession> {
        RemoteSession::new(self.gateway()?)
    }

    /// Joins it, and selects axes of it.
    pub fn link(self, words: &str) -> Result<RemoteLink> {
        let gateway = self.gateway()?;
        RemoteLink::open(gateway, Some(words)).map_err(|error| match error {
            Error::Gateway { .. } => refusal_problem(hint_unresponsive(error.into())),
            other => outcome::to_problem(other),
        })
    }

    /// Joins it without asking anything.
    pub fn gateway(self) -> Result<Gateway> {
        let Self { server, token_file, certificate, client_cert, client_key } = self;
        let url = server.unwrap_or_default();
        let options = GatewayOptions { url, token_file, certificate, client_cert, client_key };
        Gateway::new(&options).map_err(refusal_problem)
    }
}

fn axes_argument(url: Arg, all: &AxesScope) -> Arg {
    let url = url.value_name("AXES").help("Axes of the server: 1,3, a name, LINK#1, all");
    if *all == AxesScope::AllUnlessNamed { url.required(false).default_value(ALL) } else { url }
}

/// A server, and its links.
pub struct RemoteSession {
    pub gateway: Gateway,
    pub bench: BenchView,
}

impl RemoteSession {
    pub fn new(gateway: Gateway) -> Result<Self> {
        let mut bench =
            gateway.bench().map_err(|error| refusal_problem(hint_unresponsive(error)))?;
        if bench.links.len() > 1 {
            bench.axes.iter_mut().for_each(label_with_link);
        }
        Ok(Self { gateway, bench })
    }

    /// The axes that words mean.
    pub fn axes_named(&self, words: &str) -> Result<Vec<AxisInfo>> {
        select_axes(&self.bench, words).map_err(refusal_problem)
    }
}

/// Distinguishes an axis from those of other links.
pub fn label_with_link(axis: &mut AxisInfo) {
    axis.label += &format!(" of link {}", axis.link);
}

/// Troubles of a link, a line each: why it is not open, and its absent axes.
pub fn link_troubles(link: &LinkView) -> Vec<String> {
    let LinkView { id, url, state, error, since_ms, absent, pending_stops, .. } = link;
    let now_ms = clock::wall_ns(clock::now()) as f64 / 1e6;
    // The server's clock may be ahead of this one.
    let seconds = since_ms.map_or(0.0, |since_ms| ((now_ms - since_ms) / 1e3).max(0.0));
    let word = match state {
        LinkState::Open => None,
        LinkState::Lost => Some("LOST"),
        LinkState::NotOpen => Some("NOT OPEN"),
    };
    let mut lines = Vec::new();
    if let Some(word) = word {
        let why = error.as_ref().map_or_else(String::new, |error| {
            format!(": {} ({})", message_with_hint(error), error.code)
        });
        lines.push(format!("LINK {id} IS {word} for {seconds:.0} s, {url}{why}"));
    }
    if *state == LinkState::NotOpen {
        lines.push(format!(
            "motors of link {id} cannot be stopped; the server tries to open it again"
        ));
    }
    for axis in absent {
        let why = message_with_hint(&axis.error);
        lines.push(format!("axis {} of link {id} is missing: {why}", AxisNumber(axis.number)));
    }
    for number in pending_stops {
        lines.push(format!(
            "AXIS {number} OF LINK {id} MAY BE TURNING, CUT ITS SUPPLY: its stop is pending since \
             the previous server, and the drive is missing"
        ));
    }
    lines
}

fn message_with_hint(error: &GatewayError) -> String {
    match &*error.hint {
        "" => error.message.clone(),
        hint => format!("{}; {hint}", error.message),
    }
}

/// Adds a hint for a server that does not reply: it holds its ports, and stops nothing.
fn hint_unresponsive(error: GatewayError) -> GatewayError {
    match &*error.code {
        "E313" => error.hint(
            "restart the server; until then `polepair stop URL` stops motors on its links, else \
             cut their supply",
        ),
        _ => error,
    }
}

/// Problem for a refusal by the server, or for its loss.
pub fn refusal_problem(refused: GatewayError) -> Problem {
    let (exit, what) = (refused.exit(), to_sentence(&refused.sentence()));
    let GatewayError { code, hint, .. } = refused;
    Problem::new(exit, code, what).hint_if(Some(hint).filter(|hint| !hint.is_empty()))
}

/// A verb or an option that a server does not have.
pub fn unsupported_problem(what: &str, why: &str) -> Problem {
    Problem::usage("E257", format!("{what} is not supported on a server.")).why(why)
}

/// A verb that is for links, or for files.
pub fn no_such_verb(verb: &str) -> Problem {
    let known: Vec<&str> = SERVER_VERBS.iter().map(|(verb, _)| *verb).collect();
    unsupported_problem(
        &format!("`{verb}`"),
        &format!("A server does {}.", crate::problem::join_list(&known)),
    )
    .hint("remove --server, and end the server first, because it uses the link")
}

/// The unit in which people read what an argument sets.
pub fn argument_unit(axis: &Axis, which: Argument, unit: Unit) -> Unit {
    let signal = match which {
        Argument::Target => Signal::Position,
        Argument::Velocity => Signal::Velocity,
        Argument::Torque => Signal::Torque,
        _ => return unit,
    };
    let si = unit.si_symbol();
    let known = axis.remote().and_then(|axis| drive_unit(axis.info(), signal.name(), si));
    known.unwrap_or(unit)
}

#[cfg(test)]
mod tests {
    use super::{OsString, rewrite_gateway_url};

    #[test]
    fn a_gateways_address_is_a_server_and_its_axes() {
        let rewritten = |line: &str| {
            let words = rewrite_gateway_url(line.split(' ').map(OsString::from).collect());
            words.iter().map(|word| word.to_str().unwrap()).collect::<Vec<_>>().join(" ")
        };
        for (line, expected) in [
            ("p spin ws://h:7365#1,x 60rpm", "p --server ws://h:7365 spin 1,x 60rpm"),
            ("p -q stop https://h:1", "p --server https://h:1 -q stop all"),
            (
                "p get ws://h?token-file=/t&certificate=ab#2 all",
                "p --server ws://h --token-file=/t --certificate=ab get 2 all",
            ),
            ("p spin --server ws://h 1 60rpm", "p spin --server ws://h 1 60rpm"),
            ("p serve sim:tmcl --origin https://h", "p serve sim:tmcl --origin https://h"),
            ("p get sim:tmcl all", "p get sim:tmcl all"),
        ] {
            assert_eq!(rewritten(line), expected);
        }
    }
}
