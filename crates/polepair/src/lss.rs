//! Node-IDs and bit rates of CANopen devices by layer setting services (LSS, CiA 305).
//!
//! A device is addressed by the four numbers of its object 1018h, whether it has a node-ID or not.
//!
//! ```no_run
//! use polepair::lss::LssMaster;
//! let lss = LssMaster::open(&polepair::Connector::default(), "canopen+socketcan://can0")?;
//! if let Some(device) = lss.find_unconfigured()? {
//!     println!("{device} has no node-ID");
//!     lss.set_node_id(Some(5))?;
//!     lss.store()?;
//! }
//! lss.leave_configuration()?;
//! # Ok::<(), polepair::Error>(())
//! ```

use crate::axis::LocalAxis;
use crate::connect::Connector;
use crate::error::Error;
use crate::identify::is_answer;
use crate::protocol_line::ProtocolLine;
use crate::simulate::Simulation;
use crate::url::{LinkTarget, Url};
use polepair_core::error::{Failure, Outcome};
use polepair_core::station::Counters;
use polepair_link::Interrupter;
use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};

/// The word of the protocol that has these services.
pub(crate) const PROTOCOL: &str = "canopen";
/// Table 0 of bit rates, in bit/s, by index; 0 where none is (CiA 305).
const BIT_RATES: [u32; 9] =
    [1_000_000, 800_000, 500_000, 250_000, 125_000, 0, 50_000, 20_000, 10_000];
/// The node-ID that a device without node-ID reports.
const NO_NODE: i64 = 255;
/// The error of a service that the maker defines; the others are the standard's.
const MAKERS_ERROR: u32 = 255;

/// The four numbers of object 1018h, which together name one device of all.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct LssIdentity {
    /// Vendor-ID, 1018h:1.
    pub vendor: u32,
    /// Product code, 1018h:2.
    pub product: u32,
    /// Revision number, 1018h:3.
    pub revision: u32,
    /// Serial number, 1018h:4.
    pub serial: u32,
}

/// Written as [`LssIdentity::from_str`] reads it: `0x22,0x33,0x1,0x2B67`.
impl fmt::Display for LssIdentity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { vendor, product, revision, serial } = self;
        write!(f, "{vendor:#X},{product:#X},{revision:#X},{serial:#X}")
    }
}

impl FromStr for LssIdentity {
    type Err = String;

    /// Reads four numbers, decimal or hexadecimal, with commas between.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<u32>> = text.split(',').map(parse_number).collect();
        match numbers.as_deref() {
            Some(&[vendor, product, revision, serial]) => {
                Ok(Self { vendor, product, revision, serial })
            }
            _ => Err("write four numbers: VENDOR,PRODUCT,REVISION,SERIAL, such as \
                      0x22,0x33,0x10001,1234"
                .to_owned()),
        }
    }
}

fn parse_number(word: &str) -> Option<u32> {
    let word = word.trim();
    match word.strip_prefix("0x").or_else(|| word.strip_prefix("0X")) {
        Some(hex) => u32::from_str_radix(hex, 16).ok(),
        None => word.parse().ok(),
    }
}

/// The LSS master of a CAN bus, which also reads objects of its nodes. When it is dropped, devices that
/// it brought to LSS configuration leave it.
#[derive(Debug)]
pub struct LssMaster {
    /// Nodes 1 to 127. LSS requests, which address no node, go by the first.
    nodes: Vec<LocalAxis>,
    /// A device may be in LSS configuration.
    configures: AtomicBool,
    _simulation: Option<Simulation>,
}

impl LssMaster {
    /// Opens the bus. Devices that another master left in LSS configuration leave it.
    ///
    /// # Errors
    /// [`Error::Usage`] `E242` for a link without CANopen, [`Error::Link`] if it cannot be opened.
    pub fn open(connector: &Connector, url: &str) -> Result<Self, Error> {
        let url = connector.url(url)?;
        let is_rack = matches!(url.target, LinkTarget::Sim { .. } | LinkTarget::Rack { .. });
        if !is_rack && url.protocol != PROTOCOL {
            return Err(not_canopen(&url));
        }
        let (lines, simulation) = connector.open_lines(&url)?;
        let line = lines.iter().find(|line| line.protocol.name == PROTOCOL);
        let line = line.ok_or_else(|| not_canopen(&url))?;
        let mut master = Self::on_line(line, line.protocol.addresses.clone())?;
        master._simulation = simulation;
        master.leave_configuration()?;
        Ok(master)
    }

    /// On a line that is open; nothing is sent.
    pub(crate) fn on_line(
        line: &ProtocolLine,
        nodes: impl Iterator<Item = u32>,
    ) -> Result<Self, Error> {
        let nodes: Vec<_> = nodes.map(|node| (line.protocol.generic, node)).collect();
        let nodes = line.probe_axes(&nodes, true)?;
        Ok(Self { nodes, configures: AtomicBool::new(false), _simulation: None })
    }

    /// Handle that ends a waiting request from another thread.
    #[must_use]
    pub fn interrupter(&self) -> Interrupter {
        self.axis().connection().interrupter()
    }

    /// One node of the bus, with the objects that every CANopen device has.
    ///
    /// # Errors
    /// [`Error::Usage`] `E212` for a number that is no node-ID.
    pub fn node(&self, node_id: u8) -> Result<&LocalAxis, Error> {
        let found = self.nodes.iter().find(|axis| axis.number() == u32::from(node_id));
        found.ok_or_else(|| {
            Error::usage("E212", format!("{node_id} is no node-ID"), "node-IDs are 1 to 127")
        })
    }

    /// The identity of a node, read from its object 1018h.
    ///
    /// # Errors
    /// [`Error`] by blame: `E401` where no node has that number, `E601` where the node leaves the
    /// object out.
    pub fn identity_of(&self, node_id: u8) -> Result<LssIdentity, Error> {
        let axis = self.node(node_id)?;
        let read = |name| {
            let number = axis.read(axis.find(name)?)?;
            Ok::<_, Error>(number.cast_unsigned() as u32)
        };
        Ok(LssIdentity {
            vendor: read("0x1018:1:u32")?,
            product: read("0x1018:2:u32")?,
            revision: read("0x1018:3:u32")?,
            serial: read("0x1018:4:u32")?,
        })
    }

    /// Returns whether a node answers a read of its device type (1000h).
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn node_answers(&self, node_id: u8) -> Result<bool, Error> {
        let axis = self.node(node_id)?;
        match axis.read(axis.find("0x1000:0:u32")?) {
            Ok(_) => Ok(true),
            Err(Error::Failed { outcome, .. }) if is_silence(outcome) => Ok(false),
            Err(Error::Failed { outcome, .. }) if is_answer(outcome) => Ok(true),
            Err(error) => Err(error),
        }
    }

    /// The name of the link.
    #[must_use]
    pub fn link_name(&self) -> String {
        self.axis().connection().describe()
    }

    /// Returns whether at least one device without node-ID is on the bus (service 4Ch).
    ///
    /// # Errors
    /// [`Error::Link`].
    pub fn has_unconfigured(&self) -> Result<bool, Error> {
        self.is_answered("lss unconfigured")
    }

    /// Finds one device without node-ID and brings it to LSS configuration (fast scan, service 51h).
    /// The next call finds another one. `None` where no such device is left. Takes 25 ms for each bit of
    /// the identity: about 3.5 s.
    ///
    /// # Errors
    /// [`Error::Link`]; [`Error::Failed`] `E501` where answers contradict each other.
    pub fn find_unconfigured(&self) -> Result<Option<LssIdentity>, Error> {
        self.configures.store(true, Ordering::Relaxed);
        match self.request("lss fastscan", "fast scan") {
            // A device that was found before would answer an inquiry, too.
            Ok(_) => self.read_identity("lss scanned").map(Some),
            Err(Error::Failed { outcome, .. }) if is_silence(outcome) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Brings one device to LSS configuration by its identity (services 40h to 43h); false where no
    /// device answers to it.
    ///
    /// # Errors
    /// [`Error::Link`].
    pub fn select(&self, identity: LssIdentity) -> Result<bool, Error> {
        let LssIdentity { vendor, product, revision, serial } = identity;
        // These three have no reply (CiA 305).
        for (name, number) in [("vendor", vendor), ("product", product), ("revision", revision)] {
            self.request(&format!("lss select {name} {number}"), "LSS selection")?;
        }
        self.configures.store(true, Ordering::Relaxed);
        // The fourth number selects (CiA 305, switch mode selective): only then a device replies.
        if self.is_answered(&format!("lss select serial {serial}"))? {
            return Ok(true);
        }
        // Some devices are selected and do not confirm it.
        match self.selected_identity() {
            Ok(selected) => Ok(selected == identity),
            Err(Error::Failed { outcome, .. }) if is_silence(outcome) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Brings the only device of the bus to LSS configuration without its identity (service 04h).
    ///
    /// # Errors
    /// [`Error::Failed`] `E401` where no device answers, [`Error::Usage`] `E220` where several do:
    /// they leave LSS configuration at once.
    pub fn select_only_device(&self) -> Result<LssIdentity, Error> {
        // Two devices of one product send the same reply at once, which on CAN is one frame; a late one
        // betrays the second.
        let before = self.session_counters();
        self.configures.store(true, Ordering::Relaxed);
        self.request("lss configuration", "LSS configuration")?;
        self.request("lss inquire vendor", "LSS: vendor")?;
        // Devices of one product answer as one, until their serial numbers collide.
        let identity = match self.selected_identity() {
            Err(Error::Failed { outcome, .. }) if is_silence(outcome) => None,
            identity => Some(identity?),
        };
        match identity {
            Some(identity) if self.session_counters().since(before).late == 0 => Ok(identity),
            _ => {
                self.leave_configuration()?;
                let what = format!("several devices answer LSS requests on {}", self.link_name());
                let hint = "disconnect all but one, or select one device by its identity";
                Err(Error::usage("E220", what, hint))
            }
        }
    }

    fn session_counters(&self) -> Counters {
        self.axis().connection().with_axes(|axes, _| axes.counters())
    }

    /// The identity of the device in LSS configuration (services 5Ah to 5Dh).
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn selected_identity(&self) -> Result<LssIdentity, Error> {
        self.read_identity("lss inquire")
    }

    fn read_identity(&self, service: &str) -> Result<LssIdentity, Error> {
        Ok(LssIdentity {
            vendor: self.read_identity_number("vendor", service)?,
            product: self.read_identity_number("product", service)?,
            revision: self.read_identity_number("revision", service)?,
            serial: self.read_identity_number("serial", service)?,
        })
    }

    fn read_identity_number(&self, name: &str, service: &str) -> Result<u32, Error> {
        let number = self.request(&format!("{service} {name}"), &format!("LSS: {name}"))?;
        Ok(number.cast_unsigned() as u32)
    }

    /// The node-ID of the device in LSS configuration (service 5Eh); `None` where it has none.
    ///
    /// # Errors
    /// [`Error`] by blame.
    pub fn node_id(&self) -> Result<Option<u8>, Error> {
        let node = self.request("lss inquire node", "LSS: node-ID")?;
        Ok(u8::try_from(node).ok().filter(|_| node != NO_NODE))
    }

    /// Gives the device in LSS configuration a node-ID, 1 to 127, or takes it away (service 11h). A device
    /// that had none uses it when it leaves LSS configuration, another one after the NMT command reset
    /// communication.
    ///
    /// # Errors
    /// [`Error`] by blame; `E601` where the device refuses it.
    pub fn set_node_id(&self, node: Option<u8>) -> Result<(), Error> {
        let number = node.map_or(NO_NODE, i64::from);
        self.request(&format!("lss node {number}"), "LSS: set node-ID").map(drop)
    }

    /// Gives the device in LSS configuration a bit rate of table 0, in bit/s (service 13h). It is used
    /// from the next start on, if it is [stored](Self::store).
    ///
    /// # Errors
    /// [`Error::Usage`] `E216` for a rate that is not in the table; nothing is sent.
    /// [`Error::Failed`] `E601` where the device refuses it.
    pub fn set_bit_rate(&self, bit_per_s: u32) -> Result<(), Error> {
        let index = bit_rate_index(bit_per_s)?;
        self.request(&format!("lss bit-timing 0 {index}"), "LSS: set bit rate").map(drop)
    }

    /// Has the device in LSS configuration keep node-ID and bit rate over power-off (service 17h).
    ///
    /// # Errors
    /// [`Error`] by blame; `E601` where the device cannot store them.
    pub fn store(&self) -> Result<(), Error> {
        self.request("lss store", "LSS: store").map(drop)
    }

    /// Ends LSS configuration on all devices (service 04h). A device that got its first node-ID starts
    /// to use it.
    ///
    /// # Errors
    /// [`Error::Link`].
    pub fn leave_configuration(&self) -> Result<(), Error> {
        self.request("lss waiting", "end of LSS configuration")?;
        self.configures.store(false, Ordering::Relaxed);
        Ok(())
    }

    fn axis(&self) -> &LocalAxis {
        &self.nodes[0]
    }

    fn is_answered(&self, text: &str) -> Result<bool, Error> {
        match self.request(text, "LSS") {
            Ok(_) => Ok(true),
            Err(Error::Failed { outcome, .. }) if is_silence(outcome) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Sends a request. Errors name the service, for no axis is addressed.
    fn request(&self, text: &str, service: &str) -> Result<i64, Error> {
        self.axis().raw(text).map_err(|error| match error {
            Error::Failed { outcome, received, may_turn, .. } => {
                let (reason, hint) = failure_text(outcome);
                let execution = match outcome {
                    Outcome::Unknown(_) if !text.contains("inquire") => "it may have been executed",
                    _ => "",
                };
                Error::Failed {
                    what: format!("{service}: {reason} on {}", self.link_name()),
                    execution: execution.to_owned(),
                    outcome,
                    received,
                    may_turn,
                    hint: hint.to_owned(),
                }
            }
            other => other,
        })
    }
}

impl Drop for LssMaster {
    fn drop(&mut self) {
        if self.configures.load(Ordering::Relaxed) {
            // A lost link has no reader left.
            let _ = self.leave_configuration();
        }
    }
}

/// The place of a bit rate in table 0 of CiA 305.
///
/// # Errors
/// [`Error::Usage`] `E216`, with the rates of the table.
pub fn bit_rate_index(bit_per_s: u32) -> Result<u8, Error> {
    let index = BIT_RATES.iter().position(|rate| *rate == bit_per_s && bit_per_s > 0);
    index.and_then(|index| u8::try_from(index).ok()).ok_or_else(|| {
        let rates = BIT_RATES.iter().filter(|rate| **rate > 0);
        let known: Vec<String> = rates.map(u32::to_string).collect();
        Error::usage(
            "E216",
            format!("{bit_per_s} bit/s is not a bit rate of CiA 305"),
            format!("the bit rates are {}", known.join(", ")),
        )
    })
}

fn failure_text(outcome: Outcome) -> (String, &'static str) {
    match outcome.failure() {
        Some(Failure::Silent) => (
            "no device answered".to_owned(),
            "check wiring, termination and bit rate; a device without LSS answers none of this",
        ),
        Some(Failure::Refused { code: MAKERS_ERROR }) => {
            ("the device refused with an error of its maker's own (255)".to_owned(), "")
        }
        Some(Failure::Refused { code }) => (
            format!("the device refused with error {code}"),
            "1: the value is out of its range, or it cannot store; 2: its memory failed",
        ),
        _ => ("the replies contradict each other".to_owned(), "look for a second LSS master"),
    }
}

fn is_silence(outcome: Outcome) -> bool {
    outcome.failure() == Some(Failure::Silent)
}

fn not_canopen(url: &Url) -> Error {
    let what = format!("LSS is a service of CANopen, and no CANopen is configured on {url}");
    Error::usage("E242", what, "a connection string of a CANopen bus begins with `canopen+`")
}
