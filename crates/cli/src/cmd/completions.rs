//! `polepair completions SHELL`, and the dynamic completion itself.
//!
//! The scripts run `polepair` with `POLEPAIR_COMPLETE=SHELL`. It then prints the candidates: verbs and
//! options of the grammar; ports, protocols, drives, names of links and axes, and parameters of this
//! machine. Nothing is sent to a drive.

use polepair::url::without_axes;
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::sync::Arc;

use clap::{Arg, Args, Command, CommandFactory as _};
use clap_complete::Shell;
use clap_complete::engine::{ArgValueCompleter, CompletionCandidate};
use clap_complete::env::{CompleteEnv, Shells};
use polepair::url::{LinkTarget, Url};
use polepair::{Connector, simulate};
use polepair_core::medium::MediumKind;
use polepair_core::profile::{Access, Profile};
use polepair_core::proto::OptionKind;
use polepair_link::PortKind;

use crate::data_output::DataOutput;
use crate::problem::{Exit, Result};

/// The variable that names the shell that asks.
const ASKING_SHELL: &str = "POLEPAIR_COMPLETE";
/// Schemes of CAN buses that are no ports of this computer.
const CAN_SCHEMES: [&str; 5] =
    ["socketcan://", "slcan://", "slcan+tcp://", "socketcand://", "udp://"];
/// Schemes of serial lines that are no ports of this computer.
const SERIAL_SCHEMES: [&str; 2] = ["serial://", "tcp://"];

/// Prints a completion script for a shell.
///
/// The script completes verbs, options, ports, protocols, drives, axes and parameters.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair completions bash > ~/.local/share/bash-completion/completions/polepair
  polepair completions zsh > ~/.zfunc/_polepair
  polepair completions fish > ~/.config/fish/completions/polepair.fish
  polepair completions powershell | Out-String | Invoke-Expression")]
pub struct Completions {
    /// Shell to print the script for
    shell: Shell,
}

impl Completions {
    pub fn run(self) -> Result {
        let mut out = DataOutput::stdout().with_text(false);
        match Shells::builtins().completer(&self.shell.to_string()) {
            // Bash takes `:`, `=` and `@` for the ends of words.
            Some(_) if matches!(self.shell, Shell::Bash) => out.write_line(BASH),
            // Writing into memory cannot fail.
            Some(shell) => drop(shell.write_registration(
                ASKING_SHELL,
                "polepair",
                "polepair",
                "polepair",
                out.buffer(),
            )),
            None => {}
        }
        out.flush()?;
        Ok(Exit::Ok)
    }
}

/// Joins what Bash took apart, and quotes names with spaces.
const BASH: &str = r#"_polepair() {
    local words cword cur reply before
    if declare -F _comp_get_words >/dev/null; then
        _comp_get_words -n '=:@' words cword cur
    elif declare -F _get_comp_words_by_ref >/dev/null; then
        _get_comp_words_by_ref -n '=:@' words cword cur
    else
        words=("${COMP_WORDS[@]}") cword=$COMP_CWORD cur=$2
    fi
    # Bash has the part before a break of words already.
    before=${cur%"$2"}
    COMPREPLY=()
    while IFS= read -r -d $'\013' reply; do
        [[ $reply ]] || continue
        [[ $reply == *[=:/+#] ]] && compopt -o nospace
        [[ $reply == *' '* ]] && compopt -o filenames
        COMPREPLY+=("${reply#"$before"}")
    done < <(
        POLEPAIR_COMPLETE=bash _CLAP_IFS=$'\013' _CLAP_COMPLETE_INDEX=$cword \
            polepair -- "${words[@]//[\"\'\\]/}" 2>/dev/null
        printf '\013'
    )
}
complete -o bashdefault -F _polepair polepair"#;

/// Answers a shell that asks what may follow on its command line; false where no shell asks.
///
/// # Errors
/// What the program's user did wrong in setting it up.
pub fn answer_shell(words: &[OsString]) -> std::result::Result<bool, clap::Error> {
    let here = std::env::current_dir().ok();
    let typed: Arc<[String]> = words.iter().map(|word| word.to_string_lossy().into()).collect();
    CompleteEnv::with_factory(|| with_candidates(&typed))
        .var(ASKING_SHELL)
        .try_complete(words.to_vec(), here.as_deref())
}

/// The command line's description, with what may stand in the place of its values.
fn with_candidates(typed: &Arc<[String]>) -> Command {
    let complete = |arg: Arg| -> Arg {
        let candidates: fn(&str, &[String]) -> Vec<CompletionCandidate> = match arg
            .get_value_names()
            .and_then(|names| names.first())
            .map(clap::builder::Str::as_str)
        {
            Some("URL") if arg.get_id() != "server" => |word, _| urls(word),
            Some("NAME") if arg.get_long().is_none() => parameters,
            Some("NAME=VALUE") => assignments,
            Some("PROTO") => |_, _| protocols(),
            Some("DRIVE" | "FAMILY") => |_, _| drives(),
            Some("RACK.toml|PROTO[:ADDRESS,…]") => |word, _| racks(word),
            _ => return arg,
        };
        let typed = Arc::clone(typed);
        arg.add(ArgValueCompleter::new(move |word: &OsStr| {
            let word = word.to_string_lossy();
            let mut found = candidates(&word, &typed);
            found.retain(|one| one.get_value().to_string_lossy().starts_with(&*word));
            found
        }))
    };
    super::CommandLine::command().mut_subcommands(|verb| each_argument(verb, &complete))
}

fn each_argument(command: Command, complete: &impl Fn(Arg) -> Arg) -> Command {
    command.mut_args(complete).mut_subcommands(|verb| each_argument(verb, complete))
}

fn candidate(text: impl Into<OsString>, help: &str) -> CompletionCandidate {
    CompletionCandidate::new(text).help((!help.is_empty()).then(|| help.to_owned().into()))
}

/// Connection strings that begin so: names of links, simulated drives, ports.
fn urls(word: &str) -> Vec<CompletionCandidate> {
    let connector = Connector::discover();
    if let Some((link, axes)) = word.split_once('#') {
        let before = &word[..word.len() - axes.rsplit(',').next().unwrap_or_default().len()];
        let names = axis_names(&connector, link);
        return names.iter().map(|name| candidate(format!("{before}{name}"), "")).collect();
    }
    if let Some((link, query)) = word.split_once('?') {
        return keys(&connector, link, query);
    }
    let links = &connector.config.links;
    let mut found: Vec<_> =
        links.iter().map(|(name, url)| candidate(format!("@{name}"), url)).collect();
    if word.starts_with("sim:") {
        found.extend(simulated().map(|(name, title)| candidate(format!("sim:{name}"), title)));
    } else if let Some((protocol, _)) = word.split_once('+') {
        found.extend(places(protocol));
    } else {
        found.push(candidate("sim:", "simulated drives"));
        let words = polepair::url::protocols();
        let mut names: Vec<&str> = words.iter().map(|(name, _)| *name).collect();
        names.dedup();
        found.extend(names.iter().map(|name| candidate(format!("{name}+"), "")));
    }
    found
}

/// Keys that a link's connection string may have, and the words of a key that has words.
fn keys(connector: &Connector, link: &str, query: &str) -> Vec<CompletionCandidate> {
    let (before, last) = query
        .rsplit_once('&')
        .map_or(("", query), |(before, last)| (&query[..=before.len()], last));
    let url = connector.config.expand(link).ok().and_then(|url| url.parse::<Url>().ok());
    let known = url.map(|url| url.known_keys()).unwrap_or_default();
    let whole = |text: String, help| candidate(format!("{link}?{before}{text}"), help);
    match last.split_once('=') {
        None => known.iter().map(|key| whole(format!("{}=", key.name), key.help)).collect(),
        Some((name, _)) => {
            let words = known.iter().find(|key| key.name == name).map(|key| key.kind);
            let words = match words {
                Some(OptionKind::Word(words)) => words,
                Some(OptionKind::Flag) => &["yes", "no"],
                _ => &[],
            };
            words.iter().map(|word| whole(format!("{name}={word}"), "")).collect()
        }
    }
}

/// Places of drives of a protocol: the ports of this computer, and other kinds of links.
fn places(protocol: &str) -> Vec<CompletionCandidate> {
    let media = polepair::url::protocols();
    let speaks = |medium| media.contains(&(protocol, medium));
    let (can, serial) = (speaks(MediumKind::Can), speaks(MediumKind::Serial));
    let mut found = Vec::new();
    for port in polepair_link::ports() {
        let scheme = match port.kind {
            PortKind::Bytes if serial => "serial",
            PortKind::Slcan if can => "slcan",
            PortKind::Can { .. } if can => "socketcan",
            _ => continue,
        };
        let what = port.usb.as_ref().map_or("", |usb| &*usb.product);
        found.push(candidate(format!("{protocol}+{scheme}://{}", port.path), what));
    }
    let schemes =
        SERIAL_SCHEMES.iter().filter(|_| serial).chain(CAN_SCHEMES.iter().filter(|_| can));
    found.extend(schemes.map(|scheme| candidate(format!("{protocol}+{scheme}"), "")));
    found
}

/// Simulated drives by their word, with a description.
fn simulated() -> impl Iterator<Item = (String, &'static str)> {
    simulate::words().into_iter().map(|word| {
        let product = polepair::profile::find_shipped(&word);
        let title = product.map_or("", |product| product.title);
        (word, title)
    })
}

/// The drives of `sim`: rack files of this folder, and drives by their word.
fn racks(word: &str) -> Vec<CompletionCandidate> {
    let folder = &word[..word.rfind('/').map_or(0, |slash| slash + 1)];
    let here = if folder.is_empty() { Path::new(".") } else { Path::new(folder) };
    let entries = std::fs::read_dir(here).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let files = names.filter(|name| name.ends_with(".toml"));
    let files = files.map(|name| candidate(format!("{folder}{name}"), "a rack"));
    files.chain(simulated().map(|(name, title)| candidate(name, title))).collect()
}

fn protocols() -> Vec<CompletionCandidate> {
    let dissectors = polepair_core::proto::dissectors();
    dissectors.iter().map(|dissector| candidate(dissector.name(), "")).collect()
}

/// Every drive that is known by name, the user's own among them.
fn drives() -> Vec<CompletionCandidate> {
    let connector = Connector::discover();
    let catalogue = polepair::profile::catalogue().iter().map(|module| module.profile());
    let known = connector.config.all_profiles().chain(catalogue);
    known.map(|profile| candidate(profile.name, profile.title)).collect()
}

/// Names of the axes of a rack, whose link is called so.
fn axis_names(connector: &Connector, link: &str) -> Vec<String> {
    let rack = rack_of(connector, link);
    let names = rack
        .into_iter()
        .flat_map(|rack| rack.wires)
        .flat_map(|wire| wire.axis_names().cloned().collect::<Vec<_>>());
    names.filter(|name| !name.is_empty()).collect()
}

fn rack_of(connector: &Connector, link: &str) -> Option<simulate::RackDescription> {
    let url: Url = connector.config.expand(link).ok()?.parse().ok()?;
    match &url.target {
        LinkTarget::Rack { file } => simulate::rack_of_file(Path::new(file), 1).ok(),
        LinkTarget::Sim { what } if what.ends_with(".toml") => {
            simulate::rack_of_file(Path::new(what), 1).ok()
        }
        LinkTarget::Sim { what } => simulate::rack_of_words(&[what.as_str()], 1).ok(),
        _ => None,
    }
}

/// Drives that the connection string on the command line may mean.
fn drives_of(typed: &[String]) -> Vec<&'static Profile> {
    let connector = Connector::discover();
    let Some(word) = typed.iter().find(|word| word.starts_with('@') || word.contains(':')) else {
        return Vec::new();
    };
    let link = without_axes(word);
    if let Some(rack) = rack_of(&connector, link) {
        let drives = rack.rack.links.iter().flat_map(|link| &link.drives);
        return drives.map(|drive| drive.profile).collect();
    }
    let url = connector.config.expand(link).ok().and_then(|url| url.parse::<Url>().ok());
    let protocol = url.map(|url| url.protocol).unwrap_or_default();
    connector.config.all_profiles().filter(|profile| profile.protocol == protocol).collect()
}

fn named_parameters(
    typed: &[String],
    wanted: impl Fn(Access) -> bool,
    end: &str,
) -> Vec<CompletionCandidate> {
    let mut found: Vec<CompletionCandidate> = Vec::new();
    for profile in drives_of(typed) {
        for parameter in profile.parameters.iter().filter(|parameter| wanted(parameter.access)) {
            let text = format!("{}{end}", parameter.name);
            if !found.iter().any(|one| one.get_value() == OsStr::new(&text)) {
                found.push(candidate(text, parameter.about));
            }
        }
    }
    found
}

fn parameters(_word: &str, typed: &[String]) -> Vec<CompletionCandidate> {
    named_parameters(typed, |access| access != Access::Write, "")
}

fn assignments(_word: &str, typed: &[String]) -> Vec<CompletionCandidate> {
    named_parameters(typed, |access| access != Access::Read, "=")
}
