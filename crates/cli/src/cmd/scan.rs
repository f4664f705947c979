//! `polepair scan URL [--ids 1-32]`

mod remote_scan;
mod search_ports;

use std::ops::{ControlFlow, RangeInclusive};

use clap::Args;
use polepair::axis::summarize_details;
use polepair::no_reply::{ACKNOWLEDGES, NoReplyCause};
use polepair::scan::{DetectedDrive, ScanAddresses};
use polepair::search::is_port_name;
use polepair::url::{AxisNumber, shell_word};
use polepair_capture::jsonl;
use polepair_client::message::AxisInfo;

use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::progress::Progress;
use crate::remote::{self, RemoteSession};
use crate::target::{DriveArgs, OutputFormat};
use crate::terminal::{DataOutput, TextTable, colour_out, csv_line, print_note, print_warning};

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
    pub fn run(self) -> Result {
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
        let mut out = DataOutput::stdout().with_text(self.format == OutputFormat::Text);
        match self.format {
            OutputFormat::Text if scan.found.is_empty() => {}
            OutputFormat::Text => {
                out.buffer().extend_from_slice(found_table(&scan.found).as_bytes())
            }
            OutputFormat::Jsonl => {
                scan.found.iter().for_each(|found| write_json(found, out.buffer()))
            }
            OutputFormat::Csv => {
                out.write_line("axis,drive,known,product,clash,says");
                scan.found.iter().for_each(|found| out.write_line(&csv_row(found)));
            }
        }
        out.flush()?;
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
            return Err(Problem::new(Exit::NoReply, "E403", "no drive answered.")
                .why(outcome::unanswered_text(&scan.received))
                .hint(match scan.received.cause() {
                    NoReplyCause::NothingReceived => {
                        "power, wiring (A and B may be swapped), and the baud rate in the URL"
                            .into()
                    }
                    NoReplyCause::Acknowledged => ACKNOWLEDGES.into(),
                    _ => scan.received.hint(),
                })
                .hint(
                    "`polepair doctor URL --try-bauds` tries other baud rates, and finds a module \
                     in ASCII mode",
                )
                .hint("`polepair ports` lists the adapters"));
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
    /// Lists the drives of a server, or scans its links.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        if self.look || self.take {
            return remote_scan::run_remote_scan(
                server,
                &server.axes_named(self.target.remote_axes()?)?,
                self.ids,
                self.format,
                self.take,
            );
        }
        if self.ids.is_some() {
            let why = "Without --look, the server lists its axes.";
            return Err(remote::unsupported_problem("--ids", why));
        }
        let mut out = DataOutput::stdout().with_text(self.format == OutputFormat::Text);
        let axes = server.axes_named(self.target.remote_axes()?)?;
        let clashes =
            |axis: &AxisInfo| server.bench.clashes.iter().any(|clash| clash.link == axis.link);
        match self.format {
            OutputFormat::Text => out.buffer().extend_from_slice(remote_table(&axes).as_bytes()),
            OutputFormat::Jsonl => {
                axes.iter().for_each(|axis| write_remote_json(axis, clashes(axis), out.buffer()));
            }
            OutputFormat::Csv => {
                out.write_line("axis,link,name,drive,product");
                for axis in &axes {
                    let (number, link) =
                        (AxisNumber(axis.number).to_string(), axis.link.to_string());
                    let AxisInfo { name, profile, drive, .. } = axis;
                    out.write_line(&csv_line([&*number, &link, name, profile, drive]));
                }
            }
        }
        out.flush()?;
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

fn remote_table(axes: &[AxisInfo]) -> String {
    let mut table = TextTable::with_heads(&["axis", "link", "name", "drive", "product"]);
    for axis in axes {
        let (number, link) = (AxisNumber(axis.number).to_string(), axis.link.to_string());
        table.add_row([number, link, axis.name.clone(), axis.profile.clone(), axis.drive.clone()]);
    }
    table.render(colour_out())
}

fn write_remote_json(axis: &AxisInfo, clash: bool, out: &mut Vec<u8>) {
    let head =
        format!("{{\"axis\":{},\"link\":{},\"name\":", AxisNumber(axis.number).json(), axis.link);
    out.extend_from_slice(head.as_bytes());
    jsonl::write_string(out, &axis.name);
    out.extend_from_slice(b",\"drive\":");
    jsonl::write_string(out, &axis.profile);
    out.extend_from_slice(b",\"product\":");
    jsonl::write_string(out, &axis.drive);
    out.extend_from_slice(format!(",\"clash\":{clash}}}\n").as_bytes());
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

fn found_table(found: &[DetectedDrive]) -> String {
    let mut table = TextTable::with_heads(&["axis", "drive", "known by", "product", "says"]);
    for one in found {
        table.add_row([
            AxisNumber(one.number).to_string(),
            one.profile.name.to_owned(),
            one.identified.to_string(),
            one.profile.title.to_owned(),
            summarize_details(&one.details),
        ]);
    }
    let mut text = table.render(colour_out());
    for one in found {
        if let Some(clash) = &one.clash {
            text.push_str(&format!("axis {}: {clash}\n", AxisNumber(one.number)));
        }
        if one.ignores_address {
            text.push_str(&format!("axis {}: replies to every address\n", one.number));
        }
    }
    text
}

fn csv_row(found: &DetectedDrive) -> String {
    let (number, known) = (AxisNumber(found.number).to_string(), found.identified.to_string());
    let clash = found.clash.as_deref().unwrap_or_default();
    let says = summarize_details(&found.details);
    csv_line([&number, found.profile.name, &known, found.profile.title, clash, &says])
}

fn write_json(found: &DetectedDrive, out: &mut Vec<u8>) {
    out.extend_from_slice(
        format!("{{\"axis\":{},\"drive\":", AxisNumber(found.number).json()).as_bytes(),
    );
    jsonl::write_string(out, found.profile.name);
    out.extend_from_slice(b",\"product\":");
    jsonl::write_string(out, found.profile.title);
    out.extend_from_slice(b",\"known\":");
    jsonl::write_string(out, &found.identified.to_string());
    let (clash, ignores) = (found.clash.is_some(), found.ignores_address);
    let tail = format!(",\"clash\":{clash},\"ignores_address\":{ignores},\"details\":{{");
    out.extend_from_slice(tail.as_bytes());
    for (at, detail) in found.details.iter().enumerate() {
        out.extend_from_slice(if at == 0 { b"" } else { b"," });
        jsonl::write_string(out, &detail.name);
        out.push(b':');
        jsonl::write_string(out, &detail.text);
    }
    out.extend_from_slice(b"}}\n");
}
