//! `polepair lss URL [--node N] [--bit-rate RATE] [--store]`

use polepair::url::without_axes;
use std::io::IsTerminal as _;

use clap::Args;
use polepair::lss::{LssIdentity, LssMaster, bit_rate_index};
use polepair::url::{Url, shell_word};

use crate::data_output::DataOutput;
use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::target::{DriveArgs, OutputFormat};
use crate::terminal::{self, TextTable, colour_out, csv_line, print_note};

/// Shows and sets node-IDs and bit rates of CANopen devices by LSS (CiA 305).
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair lss canopen+socketcan://can0
  polepair lss canopen+socketcan://can0 --node 5 --store
  polepair lss canopen+socketcan://can0 --identity 0x22,0x33,0x1,0x2B67 --node 6
  polepair lss canopen+socketcan://can0#5 --bit-rate 250000 --store

Without #NODE, --identity and --only-device, the command lists the devices without node-ID. If there
is exactly one, it can be set. A device without node-ID uses the new one at once. Other devices use it
after an NMT reset or their next start.")]
pub struct LssCommand {
    #[command(flatten)]
    target: DriveArgs,
    /// Select a device by the four numbers of its object 1018h
    #[arg(long, value_name = "VENDOR,PRODUCT,REVISION,SERIAL")]
    identity: Option<LssIdentity>,
    /// Select the only connected device, without its identity
    #[arg(long, conflicts_with = "identity")]
    only_device: bool,
    /// Set the node-ID: 1 to 127, or none
    #[arg(long, value_name = "NODE", value_parser = parse_node)]
    node: Option<NodeChoice>,
    /// Set the bit rate in bit/s; the device uses it after its next start
    #[arg(long, value_name = "RATE", requires = "store")]
    bit_rate: Option<u32>,
    /// Store node-ID and bit rate in the device's permanent memory
    #[arg(long)]
    store: bool,
    /// Output format
    #[arg(long, value_enum, default_value_t = OutputFormat::Text)]
    format: OutputFormat,
}

/// A node-ID that is to be set; `None` takes it away.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct NodeChoice(Option<u8>);

/// One device.
#[derive(Clone, Copy, Debug)]
struct LssDevice {
    identity: LssIdentity,
    node: CurrentNode,
}

/// The node-ID that a device has.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum CurrentNode {
    None,
    Id(u8),
    /// The state is unknown.
    Unknown,
}

impl LssCommand {
    pub fn run(self) -> Result {
        let connector = self.target.connector()?;
        let url = connector.url(&self.target.url).map_err(outcome::to_problem)?;
        let selected_node = selected_node(&url)?;
        if selected_node.is_some() && (self.identity.is_some() || self.only_device) {
            return Err(Problem::usage("E242", "One device is selected in two ways.")
                .why("Nothing was sent.")
                .hint("remove `#NODE`, or --identity and --only-device"));
        }
        if let Some(rate) = self.bit_rate {
            bit_rate_index(rate).map_err(outcome::to_problem)?;
        }
        let lss = LssMaster::open(&connector, &self.target.url).map_err(outcome::to_problem)?;
        let interrupter = lss.interrupter();
        interrupt::listen(move || interrupter.interrupt());
        let devices = if self.node.is_some() || self.bit_rate.is_some() || self.store {
            vec![self.configure(&lss, selected_node)?]
        } else {
            self.list(&lss, selected_node)?
        };
        drop(lss);
        let mut out = DataOutput::stdout();
        self.format.write(&devices, &mut out);
        out.flush()?;
        Ok(Exit::Ok)
    }

    /// The connection string without its node.
    fn link_url(&self) -> &str {
        without_axes(&self.target.url)
    }

    /// The devices that are asked for.
    fn list(&self, lss: &LssMaster, node: Option<u8>) -> Result<Vec<LssDevice>> {
        let devices = match self.select(lss, node)? {
            Some(device) => vec![device],
            None => self.find_unconfigured(lss, usize::MAX)?,
        };
        lss.leave_configuration().map_err(outcome::to_problem)?;
        Ok(devices)
    }

    /// Sets the requested properties on one device, which then leaves LSS configuration.
    fn configure(&self, lss: &LssMaster, selected_node: Option<u8>) -> Result<LssDevice> {
        if let Some(NodeChoice(Some(node))) = self.node
            && selected_node != Some(node)
        {
            self.check_free(lss, node)?;
        }
        let device = match self.select(lss, selected_node)? {
            Some(device) => device,
            None => self.only_unconfigured(lss)?,
        };
        let mut done = Vec::new();
        let mut steps = || -> std::result::Result<(), polepair::Error> {
            if let Some(NodeChoice(node)) = self.node {
                lss.set_node_id(node)?;
                done.push("the node-ID was set");
            }
            if let Some(rate) = self.bit_rate {
                lss.set_bit_rate(rate)?;
                done.push("the bit rate was set");
            }
            if self.store {
                lss.store()?;
            }
            lss.leave_configuration()
        };
        if let Err(error) = steps() {
            let problem = outcome::to_problem(error);
            return Err(match done[..] {
                [] => problem,
                _ => problem.why(format!("Before it {}.", done.join(" and "))),
            });
        }
        self.note_effect(lss, &device)?;
        Ok(match self.node {
            Some(NodeChoice(Some(node))) => LssDevice { node: CurrentNode::Id(node), ..device },
            Some(NodeChoice(None)) => LssDevice { node: CurrentNode::None, ..device },
            None => device,
        })
    }

    /// The device that the command line names; `None` for one without node-ID.
    fn select(&self, lss: &LssMaster, node: Option<u8>) -> Result<Option<LssDevice>> {
        let identity = match (node, self.identity) {
            (Some(node), _) => lss.identity_of(node).map_err(outcome::to_problem)?,
            (None, Some(identity)) => identity,
            (None, None) if self.only_device => {
                let identity = lss.select_only_device().map_err(outcome::to_problem)?;
                let node = current_node(lss)?;
                return Ok(Some(LssDevice { identity, node }));
            }
            (None, None) => return Ok(None),
        };
        if !lss.select(identity).map_err(outcome::to_problem)? {
            let what = format!("no device with identity {identity} answers LSS requests.");
            return Err(Problem::new(Exit::NoReply, "E401", what)
                .why("A device without LSS does not reply to LSS requests.")
                .hint("check the identity: all four numbers have to match")
                .hint("set its node-ID by switches, or by the object that its manual names"));
        }
        let node = match node {
            Some(node) => CurrentNode::Id(node),
            None => current_node(lss)?,
        };
        Ok(Some(LssDevice { identity, node }))
    }

    /// Devices without node-ID, at most `max`.
    fn find_unconfigured(&self, lss: &LssMaster, max: usize) -> Result<Vec<LssDevice>> {
        let live = std::io::stderr().is_terminal();
        let mut devices: Vec<LssDevice> = Vec::new();
        while devices.len() < max {
            if live {
                let count = devices.len();
                terminal::draw(&format!("\r\x1b[Kfast scan for devices without node-ID: {count}"));
            }
            let found = lss.find_unconfigured();
            if live {
                terminal::draw("\r\x1b[K");
            }
            let Some(identity) = found.map_err(outcome::to_problem)? else { break };
            if devices.iter().any(|device| device.identity == identity) {
                // Some devices answer fast scans though they are in LSS configuration.
                break;
            }
            devices.push(LssDevice { identity, node: CurrentNode::None });
        }
        if !devices.is_empty() {
            return Ok(devices);
        }
        let url = shell_word(self.link_url());
        if lss.has_unconfigured().map_err(outcome::to_problem)? {
            let what = "a device without node-ID replies, but not to a fast scan.";
            return Err(Problem::new(Exit::NoReply, "E403", what)
                .why("So its identity is unknown.")
                .hint(format!("`polepair lss {url} --only-device`, with no other device connected"))
                .hint("--identity with the numbers on its label or in its data sheet"));
        }
        Err(Problem::new(Exit::NoReply, "E403", "no device without node-ID answered.")
            .why("Devices with a node-ID, and devices without LSS, do not reply.")
            .hint(format!("polepair scan {url}"))
            .hint("check wiring, termination and bit rate: all devices of a bus have the same"))
    }

    /// The device without node-ID, where there is only one.
    fn only_unconfigured(&self, lss: &LssMaster) -> Result<LssDevice> {
        match self.find_unconfigured(lss, 2)?[..] {
            [device] => Ok(device),
            ref several => {
                let list: Vec<String> = several.iter().map(|d| d.identity.to_string()).collect();
                lss.leave_configuration().map_err(outcome::to_problem)?;
                let what = "several devices have no node-ID.";
                Err(Problem::usage("E220", what)
                    .why(format!("Nothing was set. The first are {}.", list.join(" and ")))
                    .hint(format!("--identity {} selects one of them", list[0])))
            }
        }
    }

    /// Refuses a node-ID at which a node answers.
    fn check_free(&self, lss: &LssMaster, node: u8) -> Result<()> {
        if !lss.node_answers(node).map_err(outcome::to_problem)? {
            return Ok(());
        }
        Err(Problem::usage("E222", format!("a node with node-ID {node} already exists."))
            .why("Two nodes with one node-ID disturb each other; nothing was set.")
            .hint(format!("polepair scan {}", shell_word(self.link_url()))))
    }

    /// Prints from when on the device uses the new settings.
    fn note_effect(&self, lss: &LssMaster, device: &LssDevice) -> Result<()> {
        let start = "until its next start, or until an NMT reset";
        match (device.node, self.node) {
            (CurrentNode::None, Some(NodeChoice(Some(node)))) => {
                if lss.node_answers(node).map_err(outcome::to_problem)? {
                    print_note(&format!("node {node} answers"))
                } else {
                    print_note(&format!("node {node} does not answer yet"))
                }
            }
            (CurrentNode::Id(old), Some(NodeChoice(new))) if new != Some(old) => {
                let url = format!("{}#{old}", self.link_url());
                let url = shell_word(&url);
                print_note(&format!(
                    "the device keeps node-ID {old} {start}: \
                     `polepair send {url} \"nmt reset-communication\"`"
                ));
            }
            (CurrentNode::Unknown, Some(_)) => {
                print_note(&format!("where it had a node-ID, the device keeps it {start}"));
            }
            _ => {}
        }
        if let Some(rate) = self.bit_rate {
            print_note(&format!("the device uses {rate} bit/s from its next start on"));
        }
        if self.node.is_some() && !self.store {
            print_note("not stored: the node-ID is lost at power-off (--store keeps it)");
        }
        Ok(())
    }
}

impl OutputFormat {
    fn write(self, devices: &[LssDevice], out: &mut DataOutput) {
        match self {
            Self::Text => {
                let mut table =
                    TextTable::with_heads(&["node-ID", "vendor", "product", "revision", "serial"]);
                for device in devices {
                    table.add_row(device.cells());
                }
                out.buffer().extend_from_slice(table.render(colour_out()).as_bytes());
            }
            Self::Jsonl => {
                for LssDevice { identity, node } in devices {
                    let LssIdentity { vendor, product, revision, serial } = identity;
                    let node = match node {
                        CurrentNode::Id(node) => node.to_string(),
                        CurrentNode::None => "\"none\"".to_owned(),
                        CurrentNode::Unknown => "null".to_owned(),
                    };
                    out.write_line(&format!(
                        "{{\"node\":{node},\"vendor\":{vendor},\"product\":{product},\
                         \"revision\":{revision},\"serial\":{serial}}}"
                    ));
                }
            }
            Self::Csv => {
                out.write_line("node,vendor,product,revision,serial");
                for device in devices {
                    let cells = device.cells();
                    out.write_line(&csv_line(cells.each_ref().map(String::as_str)));
                }
            }
        }
    }
}

impl LssDevice {
    fn cells(&self) -> [String; 5] {
        let LssIdentity { vendor, product, revision, serial } = self.identity;
        let node = match self.node {
            CurrentNode::Id(node) => node.to_string(),
            CurrentNode::None => "none".to_owned(),
            CurrentNode::Unknown => "unknown".to_owned(),
        };
        let [a, b, c, d] = [vendor, product, revision, serial].map(|n| format!("{n:#X}"));
        [node, a, b, c, d]
    }
}

/// The node-ID of the selected device.
fn current_node(lss: &LssMaster) -> Result<CurrentNode> {
    match lss.node_id() {
        Ok(node) => Ok(node.map_or(CurrentNode::None, CurrentNode::Id)),
        Err(error) if error.exit() == Exit::NoReply => Ok(CurrentNode::Unknown),
        Err(error) => Err(outcome::to_problem(error)),
    }
}

/// The node that the connection string names.
fn selected_node(url: &Url) -> Result<Option<u8>> {
    match url.axes[..] {
        [] => Ok(None),
        [node] => Ok(u8::try_from(node).ok()),
        _ => Err(Problem::usage("E242", "LSS configures one device at a time.")
            .why("Nothing was sent.")
            .hint("name one node: URL#5")),
    }
}

fn parse_node(text: &str) -> std::result::Result<NodeChoice, String> {
    if text == "none" {
        return Ok(NodeChoice(None));
    }
    let node = text.parse().ok().filter(|node| (1..=127).contains(node));
    node.map(|node| NodeChoice(Some(node))).ok_or_else(|| "write 1 to 127, or none".to_owned())
}
