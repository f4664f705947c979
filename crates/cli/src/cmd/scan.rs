//! `polepair scan URL [--ids 1-32]`

mod drive_table;
mod remote_scan;
mod search_ports;

use std::ops::{ControlFlow, RangeInclusive};

use clap::Args;
use polepair::no_reply::{ACKNOWLEDGES, NoReplyCause, Wiring};
use polepair::scan::ScanAddresses;
use polepair::search::is_port_name;
use polepair::url::shell_word;

use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::remote::{self, RemoteSession, ServerArgs};
use crate::target::{DriveArgs, OutputFormat};
use crate::terminal::{print_note, print_warning};
use drive_table::DriveColumn::{Axis, Clash, Drive, Known, Link, Name, Product, Reported};
use drive_table::{DriveRow, print_drives};

/// Finds the drives on a link, by reads only.
///
/// Without URL, the command tries all ports of this machine with all protocols and usual baud rates, and with a port
/// instead of a URL that port. It prints connection strings.
#[derive(Args, Debug)]
#[command(mut_arg("url", |url| url
    .value_name("URL|PORT")
    .required(false)
    .default_value("")
    .hide_default_value(true)
    .help("Link, or port to search: tmcl+serial:///dev/ttyUSB0:9600, /dev/ttyUSB0, sim:tmcl, @name \
           [default: all ports]")))]
#[command(after_help = "\
Examples:
  polepair scan                                   all ports, protocols and usual rates
  polepair scan /dev/ttyUSB0                      one port
  polepair scan tmcl+serial:///dev/ttyUSB0:9600
  polepair scan modbus-rtu+serial:///dev/ttyUSB0:115200 --ids 1-32
  polepair scan canopen,technocan,thruster+socketcan://can0
  polepair scan sim:tmcl?axes=3")]
pub struct ScanCommand {
    #[command(flatten)]
    target: DriveArgs,
    /// Addresses to try [default: all of the protocol]
    #[arg(long, value_name = "FIRST-LAST", value_parser = parse_ids)]
    ids: Option<RangeInclusive<u32>>,
    /// Have the server scan its links
    #[arg(long, hide = true)]
    look: bool,
    /// Have the server scan its links, and add the drives without conflicts as axes
    #[arg(long, hide = true)]
    take: bool,
    /// Output format
    #[arg(long, value_enum, default_value_t = OutputFormat::Text)]
    format: OutputFormat,
}

impl ScanCommand {
    /// Scans a link or ports of this machine, or lists or scans those of a server.
    pub fn run(self, server: ServerArgs) -> Result {
        if server.is_given() {
            return self.scan_server(&server.open()?);
        }
        if self.look || self.take {
            let what = "--look and --take are for a running server.";
            return Err(Problem::usage("E242", what)
                .why("Without a server, the verb always scans.")
                .hint("polepair --server URL scan all --look"));
        }
        let connector = self.target.connector()?;
        let word = self.target.url.as_str();
        if word.is_empty() || is_port_name(word) {
            if self.ids.is_some() {
                let what = "--ids belongs to a connection string.";
                return Err(Problem::usage("E242", what)
                    .hint("polepair scan tmcl+serial:///dev/ttyUSB0 --ids 1-32"));
            }
            let named = if word.is_empty() { Vec::new() } else { vec![word.to_owned()] };
            return search_ports::run_search(&connector, &named, self.format);
        }
        let numbers = self.ids.clone().map_or(ScanAddresses::ALL, ScanAddresses::from);
        let bar = Progress::of_count(0, "addresses");
        // Ctrl-C ends the scan, not the program: the drives that were found so far are still printed.
        interrupt::listen(|| {});
        let scan = polepair::scan::scan(&connector, &self.target.url, numbers, &mut |at| {
            bar.set_of(at.done, at.of);
            if interrupt::was_interrupted() {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        });
        // Before the table: the bar would be drawn into its first line.
        drop(bar);
        let scan = scan.map_err(outcome::to_problem)?;
        let drives: Vec<DriveRow> = scan.found.iter().map(DriveRow::from).collect();
        print_drives(&drives, &[Axis, Drive, Known, Product, Clash, Reported], self.format)?;
        // To standard error, so that a table in a file stays a table.
        scan.tried.iter().for_each(|tried| print_note(&format!("tried {tried}")));
        if let Some(lost) = &scan.link_error {
            let (found, unasked) = (scan.found.len(), scan.not_queried);
            let why = format!("Drives that replied: {found}; addresses not tried: {unasked}.");
            return Err(outcome::link_problem(lost).why(why));
        }
        if scan.has_unconfigured {
            report_unconfigured(&self.target.url);
        }
        if scan.not_queried > 0 {
            print_warning(&format!("interrupted: {} addresses were not tried", scan.not_queried));
            return Err(Problem::interrupted());
        }
        if scan.found.is_empty() {
            let silent = Problem::new(Exit::NoReply, "E403", "no drive answered.")
                .why(outcome::unanswered_text(&scan.received))
                .hint(match scan.received.cause() {
                    NoReplyCause::NothingReceived => scan.wiring.hint().into(),
                    NoReplyCause::Acknowledged => ACKNOWLEDGES.into(),
                    _ => scan.received.hint(),
                });
            let silent = if scan.wiring != Wiring::SerialLine {
                silent
            } else {
                silent.hint(
                    "`polepair doctor URL --try-bauds` tries other baud rates, and finds a module \
                     in ASCII mode",
                )
            };
            return Err(silent.hint("`polepair ports` lists the adapters"));
        }
        conflicts_result(
            scan.found.iter().filter(|found| found.clash.is_some()).count(),
            scan.found.len(),
        )
    }
}

/// Reports a CANopen device without node-ID on a link.
fn report_unconfigured(url: &str) {
    let (link, _) = url.split_once('#').unwrap_or((url, ""));
    let command = format!("polepair lss {}", shell_word(link));
    print_note(&format!("a CANopen device without node-ID answers: `{command}` shows it"));
}

/// Result of a scan that found `of` drives, of which `count` clash.
fn conflicts_result(count: usize, of: usize) -> Result {
    match count {
        0 => Ok(Exit::Ok),
        _ => Err(Problem::new(Exit::Negative, "E104", "drives on this link conflict.")
            .why(format!("{count} of {of} share an address or an identifier."))
            .hint("unplug one after the other; give each an address of its own")
            .hint("docs/guides/one-bus.md lists the protocols that can share a bus")),
    }
}

impl ScanCommand {
    /// Lists the drives of a server, or has it scan its links.
    fn scan_server(self, server: &RemoteSession) -> Result {
        let axes = server.axes_named(self.target.remote_axes()?)?;
        if self.look || self.take {
            return remote_scan::run_remote_scan(server, &axes, self.ids, self.format, self.take);
        }
        if self.ids.is_some() {
            let why = "Without --look, the server lists its axes.";
            return Err(remote::unsupported_problem("--ids", why));
        }
        let drives: Vec<DriveRow> = axes.iter().map(DriveRow::of_server).collect();
        print_drives(&drives, &[Axis, Link, Name, Drive, Product], self.format)?;
        for link in &server.bench.links {
            let simulated = if link.simulated { " (simulated)" } else { "" };
            print_note(&format!("link {} is {}{simulated}", link.id, link.url));
            remote::link_troubles(link).iter().for_each(|line| print_note(line));
        }
        if let Some(lock) = &server.bench.lock {
            print_note(&format!("motion is locked since {} stopped all axes", lock.by));
        }
        for clash in &server.bench.clashes {
            print_warning(&format!("link {}: {}", clash.link, clash.message));
        }
        Ok(Exit::Ok)
    }
}

fn parse_ids(text: &str) -> std::result::Result<RangeInclusive<u32>, String> {
    let (first, last) = text.split_once('-').unwrap_or((text, text));
    match (parse_number_text(first), parse_number_text(last)) {
        (Some(first), Some(last)) if first <= last => Ok(first..=last),
        _ => Err("write one address, or FIRST-LAST such as 1-32".to_owned()),
    }
}

fn parse_number_text(text: &str) -> Option<u32> {
    text.trim().parse::<u32>().ok()
}
