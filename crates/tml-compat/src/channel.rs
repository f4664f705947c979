//! Channels, the set-ups that were loaded, and what each thread has selected.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use polepair::scan::DetectedDrive;
use polepair::{Connector, Identification, LocalAxis, LocalLink};
use polepair_core::profile::Profile;
use polepair_core::proto::{AxisNumber, GROUP};

use crate::call::{CallResult, TmlError};
use crate::execute::Target;
use crate::message_queue::{MessageListener, MessageQueue, MessageTap};

/// Channel types as programs number them.
pub mod channel_type {
    /// RS-232.
    pub const RS232: u8 = 0;
    /// RS-485.
    pub const RS485: u8 = 1;
    /// The first of the CAN adapters.
    pub const CAN_FIRST: u8 = 2;
    /// An adapter with slcan firmware, the last of them.
    pub const LAWICEL: u8 = 9;
    /// A serial server.
    pub const XPORT_IP: u8 = 16;
    /// On CAN: TechnoCAN instead of TMLCAN.
    pub const TECHNOCAN: u8 = 0x80;
}

/// End of a connection string on RS-232 if the host ID is 0: the first axis is the drive at the cable.
const UNKNOWN_DRIVE: &str = "?through=0";
/// The key of a connection string on RS-485.
const RS485: &str = "wire=rs485";
/// Port of a serial server that is named without one.
const XPORT_PORT: u16 = 10001;
/// Channels that a process opens at most.
const CHANNELS_MAX: usize = 256;
/// Everybody on a channel.
pub const BROADCAST: u32 = GROUP;

/// An open channel.
pub struct Channel {
    /// The arguments of the open call. A program that opens the same again gets a second descriptor of this channel.
    text: String,
    link: LocalLink,
    protocol: &'static str,
    /// The set-up of each axis, group and broadcast that was set up.
    setups: BTreeMap<u32, &'static Profile>,
    /// Labels of the program that was last downloaded to each address.
    labels: BTreeMap<u32, Vec<(String, u16)>>,
    /// Points, and words of each, of the log that was set up in a buffer of an address.
    logs: BTreeMap<(u32, u16), (u16, u16)>,
    messages: MessageQueue,
    listener: Option<MessageListener>,
    /// Connector and connection string to reopen the channel for its first axis, if the program did not name the drive
    /// at the cable.
    reopen: Option<(Connector, String)>,
}

static CHANNELS: Mutex<Vec<Option<Arc<Mutex<Channel>>>>> = Mutex::new(Vec::new());
/// Held while a channel is opened.
static OPENING: Mutex<()> = Mutex::new(());
static SETUPS: Mutex<Vec<&'static Profile>> = Mutex::new(Vec::new());

/// A channel, and what commands on it are for.
#[derive(Clone, Copy)]
struct Selection {
    channel: Option<i32>,
    /// The axis or group, by the channel's number.
    address: Option<u32>,
}

const NOTHING: Selection = Selection { channel: None, address: None };

thread_local! {
    static SELECTED: Cell<Selection> = const { Cell::new(NOTHING) };
}

/// Last selection of any thread, for threads without one.
static LAST_SELECTED: Mutex<Selection> = Mutex::new(NOTHING);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn selection() -> Selection {
    let (own, last) = (SELECTED.get(), *lock(&LAST_SELECTED));
    match (own.channel, own.address) {
        (None, _) => last,
        (Some(_), None) if last.channel == own.channel => last,
        _ => own,
    }
}

fn select(selected: Selection) {
    SELECTED.set(selected);
    *lock(&LAST_SELECTED) = selected;
}

/// Opens a channel and selects it.
pub fn open(device: &str, channel_type: u8, host: u8, baud: u32) -> CallResult<i32> {
    let text = connection_string(device, channel_type, host, baud)?;
    // Others go on with their channels meanwhile.
    let _one_at_a_time = lock(&OPENING);
    let all: Vec<_> = lock(&CHANNELS).iter().flatten().cloned().collect();
    let channel = match all.into_iter().find(|channel| lock(channel).text == text) {
        Some(channel) => channel,
        None => Arc::new(Mutex::new(Channel::open(device, text)?)),
    };
    let mut channels = lock(&CHANNELS);
    let free = channels.iter().position(Option::is_none).unwrap_or(channels.len());
    if free == CHANNELS_MAX {
        return Err(TmlError::new("too many channels are open: close one with TS_CloseChannel"));
    }
    let length = channels.len().max(free + 1);
    channels.resize_with(length, || None);
    channels[free] = Some(channel);
    let descriptor = free as i32;
    select(Selection { channel: Some(descriptor), address: None });
    Ok(descriptor)
}

/// The connection string of a device, without its axes.
fn connection_string(device: &str, channel_kind: u8, host: u8, baud: u32) -> CallResult<String> {
    use self::channel_type as kind;
    let device = device.trim();
    if device.contains("://") || device.starts_with("sim:") || device.starts_with('@') {
        if device.contains('#') {
            return Err(TmlError::new(format!(
                "{device}: a channel names no axes: leave out `#` and what follows"
            )));
        }
        return Ok(device.to_owned());
    }
    let technocan = channel_kind & kind::TECHNOCAN != 0;
    let protocol = if technocan { "technocan" } else { "tmlcan" };
    match channel_kind & !kind::TECHNOCAN {
        kind::RS232 | kind::RS485 | kind::XPORT_IP if technocan => {
            Err(TmlError::new("PROTOCOL_TECHNOCAN is for channels on CAN"))
        }
        kind::RS232 if is_network_name(device) => Ok(network_string(device, host)),
        kind::RS232 => Ok(format!("tml+serial://{}:{baud}?through={host}", port_path(device))),
        kind::RS485 => Ok(format!("tml+serial://{}:{baud}?{RS485}&host={host}", port_path(device))),
        kind::XPORT_IP => Ok(network_string(device, host)),
        kind::LAWICEL if device.is_empty() => {
            Err(TmlError::new("name the adapter's port, for instance /dev/ttyACM0 or COM3"))
        }
        kind::LAWICEL => {
            Ok(format!("{protocol}+slcan://{}?bitrate={baud}&host={host}", port_path(device)))
        }
        kind::CAN_FIRST..kind::LAWICEL => Ok(format!(
            "{protocol}+socketcan://{}?bitrate={baud}&host={host}",
            can_interface(device, channel_kind & !kind::TECHNOCAN)
        )),
        other => Err(TmlError::new(format!(
            "channel type {other} is not supported: use CHANNEL_RS232 (0), CHANNEL_RS485 (1), a CAN adapter \
             (2 to 9), CHANNEL_XPORT_IP (16), or a connection string as device"
        ))),
    }
}

/// `10.0.0.5:4001`: a serial server where a port's name is expected.
fn is_network_name(device: &str) -> bool {
    let Some((host, port)) = device.rsplit_once(':') else { return false };
    !host.is_empty() && !host.contains('/') && port.parse::<u16>().is_ok()
}

fn network_string(device: &str, host: u8) -> String {
    if is_network_name(device) {
        format!("tml+tcp://{device}?through={host}")
    } else {
        format!("tml+tcp://{device}:{XPORT_PORT}?through={host}")
    }
}

/// The name of a port by its number: `1` and `COM1` are the first.
fn port_path(device: &str) -> String {
    let upper = device.to_ascii_uppercase();
    let number = upper.strip_prefix("COM").unwrap_or(&upper).parse::<u32>().ok();
    match number {
        Some(number) if cfg!(windows) => format!("COM{number}"),
        Some(number @ 1..) => format!("/dev/ttyS{}", number - 1),
        _ => device.to_owned(),
    }
}

/// The name of a CAN interface by the number that the vendor's driver gives it.
fn can_interface(device: &str, channel_type: u8) -> String {
    // SYS TEC and ESD count from 0, the others from 1.
    let first = u32::from(!matches!(channel_type, 3 | 5));
    let number = device.parse::<u32>().ok().and_then(|number| number.checked_sub(first));
    number.map_or_else(|| device.to_owned(), |number| format!("can{number}"))
}

/// Selects an open channel.
pub fn select_channel(descriptor: i32) -> CallResult<()> {
    find(descriptor)?;
    let descriptor = descriptor_or_selected(descriptor)?;
    if selection().channel != Some(descriptor) {
        select(Selection { channel: Some(descriptor), address: None });
    }
    Ok(())
}

/// Closes a channel. Drives stay as they are.
pub fn close(descriptor: i32) -> CallResult<()> {
    let descriptor = descriptor_or_selected(descriptor)?;
    let place = usize::try_from(descriptor).ok();
    let closed = place.and_then(|place| lock(&CHANNELS).get_mut(place)?.take());
    let Some(channel) = closed else { return Err(no_channel(descriptor)) };
    if SELECTED.get().channel == Some(descriptor) {
        SELECTED.set(NOTHING);
    }
    let mut last = lock(&LAST_SELECTED);
    if last.channel == Some(descriptor) {
        *last = NOTHING;
    }
    drop(last);
    // Another descriptor may be for the same link.
    if let Some(channel) = Arc::into_inner(channel) {
        let mut channel = channel.into_inner().unwrap_or_else(PoisonError::into_inner);
        channel.listener = None;
        channel.link.close();
    }
    Ok(())
}

fn descriptor_or_selected(descriptor: i32) -> CallResult<i32> {
    if descriptor >= 0 {
        return Ok(descriptor);
    }
    selection()
        .channel
        .ok_or_else(|| TmlError::new("no channel is open: call TS_OpenChannel first"))
}

fn no_channel(descriptor: i32) -> TmlError {
    TmlError::new(format!("channel {descriptor} is not open"))
}

fn find(descriptor: i32) -> CallResult<Arc<Mutex<Channel>>> {
    let descriptor = descriptor_or_selected(descriptor)?;
    let place = usize::try_from(descriptor).ok();
    let found = place.and_then(|place| lock(&CHANNELS).get(place)?.clone());
    found.ok_or_else(|| no_channel(descriptor))
}

/// Loads a set-up and returns its index.
pub fn load_setup(path: &str) -> CallResult<i32> {
    let loaded = polepair::load_profile(std::path::Path::new(path));
    let profile = loaded.map_err(|error| TmlError::from(&polepair::Error::from(error)))?;
    let mut setups = lock(&SETUPS);
    let known = setups.iter().position(|other| std::ptr::eq(*other, profile));
    let index = known.unwrap_or_else(|| {
        setups.push(profile);
        setups.len() - 1
    });
    Ok(index as i32)
}

/// Sets up an axis, group or broadcast of the selected channel.
pub fn set_up(address: u32, setup: i32) -> CallResult<()> {
    let found = usize::try_from(setup).ok().and_then(|index| lock(&SETUPS).get(index).copied());
    let profile = found.ok_or_else(|| {
        TmlError::new(format!("set-up {setup} is not loaded: TS_LoadSetup returns the index"))
    })?;
    let channel = find(-1)?;
    let mut channel = lock(&channel);
    channel.add_axis(address)?;
    channel.setups.insert(address, profile);
    Ok(())
}

/// Has commands go to an axis, group or everybody that is set up.
pub fn select_address(address: u32) -> CallResult<()> {
    let channel = find(-1)?;
    if !lock(&channel).setups.contains_key(&address) {
        let name = AxisNumber(address);
        return Err(TmlError::new(format!(
            "{name} is not set up on this channel: call TS_SetupAxis, TS_SetupGroup or TS_SetupBroadcast first"
        )));
    }
    select(Selection { address: Some(address), ..selection() });
    Ok(())
}

/// The number of a group as a channel has it.
pub fn group_address(group: u8) -> CallResult<u32> {
    match group {
        1..=8 => Ok(GROUP | 1 << (group - 1)),
        _ => Err(TmlError::new(format!("{group} is not the number of a group: groups are 1 to 8"))),
    }
}

/// The axis or group that the thread has selected.
pub fn target() -> CallResult<Target> {
    let channel = find(-1)?;
    let channel = lock(&channel);
    let address = selection()
        .address
        .ok_or_else(|| TmlError::new("no axis is selected: call TS_SelectAxis first"))?;
    let setup = channel.setups.get(&address);
    let setup = setup.ok_or_else(|| TmlError::new("the selected axis is not set up"))?;
    let may_send_unasked = !channel.text.contains(RS485);
    Ok(Target { axis: channel.axis(address)?, setup, may_send_unasked })
}

/// Runs `work` with the selected channel and the selected address.
fn with_selected<T>(work: impl FnOnce(&mut Channel, u32) -> T) -> CallResult<T> {
    let channel = find(-1)?;
    let address = selection()
        .address
        .ok_or_else(|| TmlError::new("no axis is selected: call TS_SelectAxis first"))?;
    Ok(work(&mut lock(&channel), address))
}

/// Keeps the labels of a program that was downloaded to the selected axis.
pub fn keep_labels(labels: Vec<(String, u16)>) -> CallResult<()> {
    with_selected(|channel, address| drop(channel.labels.insert(address, labels)))
}

/// The address of a label of the program that was last downloaded to the selected axis.
pub fn label(name: &str) -> CallResult<u16> {
    let found = with_selected(|channel, address| {
        let labels = channel.labels.get(&address)?;
        let found = labels.iter().find(|(known, _)| known.eq_ignore_ascii_case(name.trim()));
        found.map(|(_, address)| *address)
    })?;
    found.ok_or_else(|| {
        TmlError::new(format!(
            "there is no label {name:?}: labels are those of the program in TML's text that \
             TS_DownloadProgram has downloaded to this axis; for another program use the function \
             with an address"
        ))
    })
}

/// Keeps the number of points, and of words of each, of a log that was set up in the selected axis.
pub fn keep_log(buffer: u16, points: u16, width: u16) -> CallResult<()> {
    with_selected(|channel, address| {
        channel.logs.insert((address, buffer), (points, width));
    })
}

/// Number of points, and of words of each, of the log that was set up in that buffer of the selected axis.
pub fn log(buffer: u16) -> CallResult<(u16, u16)> {
    let found = with_selected(|channel, address| channel.logs.get(&(address, buffer)).copied())?;
    found.ok_or_else(|| {
        TmlError::new(format!("no log was set up at 0x{buffer:04X}: call TS_SetupLogger first"))
    })
}

/// Messages of the selected channel that no request asked for. Begins to listen.
pub fn messages() -> CallResult<MessageQueue> {
    let channel = find(-1)?;
    let mut channel = lock(&channel);
    if channel.listener.is_none() {
        channel.listener = channel.link.axes().first().map(MessageListener::start);
    }
    Ok(channel.messages.clone())
}

impl Channel {
    fn open(device: &str, text: String) -> CallResult<Self> {
        let messages = MessageQueue::default();
        let connector = Connector::discover().with_tap(MessageTap::new(messages.clone()));
        // A group is asked nothing, so that a silent drive does not keep the program from opening the channel.
        let known = text.trim_end_matches(UNKNOWN_DRIVE);
        let link = connector.connect_local(&format!("{known}#g*"))?;
        let axis = link.axes().first().ok_or_else(|| TmlError::new("the link has no wire"))?;
        let protocol = axis.protocol();
        if !matches!(protocol, "tml" | "tmlcan" | "technocan") {
            return Err(TmlError::new(format!("{device} does not speak TML")));
        }
        let reopen = text.ends_with(UNKNOWN_DRIVE).then(|| (connector, text.clone()));
        Ok(Self {
            text,
            link,
            protocol,
            setups: BTreeMap::new(),
            labels: BTreeMap::new(),
            logs: BTreeMap::new(),
            messages,
            listener: None,
            reopen,
        })
    }

    fn axis(&self, address: u32) -> CallResult<LocalAxis> {
        Ok(self.link.axis(address)?)
    }

    /// Makes an address an axis of the link, unless it is one.
    fn add_axis(&mut self, number: u32) -> CallResult<()> {
        if self.axis(number).is_ok() {
            return Ok(());
        }
        if let Some((connector, text)) = self.reopen.take_if(|_| !AxisNumber(number).is_group()) {
            self.link.clone().close();
            let text = text.replace(UNKNOWN_DRIVE, &format!("?through={number}#g*"));
            self.link = connector.connect_local(&text)?;
        }
        let profile = polepair::profile::generic_profile(self.protocol);
        let drive = DetectedDrive {
            number,
            protocol: self.protocol,
            profile: profile.ok_or_else(|| TmlError::new("the protocol has no profile"))?,
            identified: Identification::Named,
            clash: None,
            ignores_address: false,
            details: Vec::new(),
        };
        self.link = self.link.add_drives(0, &[drive])?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::{can_interface, connection_string, is_network_name, port_path};

    #[test]
    fn devices_are_links() {
        let string = |device, kind| connection_string(device, kind, 255, 115_200).expect("a link");
        assert_eq!(string("/dev/ttyUSB0", 0), "tml+serial:///dev/ttyUSB0:115200?through=255");
        assert_eq!(
            string("/dev/ttyUSB0", 1),
            "tml+serial:///dev/ttyUSB0:115200?wire=rs485&host=255"
        );
        assert_eq!(string("10.0.0.5", 16), "tml+tcp://10.0.0.5:10001?through=255");
        assert_eq!(string("moxa:4001", 0), "tml+tcp://moxa:4001?through=255");
        assert_eq!(
            connection_string("1", 4 | 0x80, 3, 500_000).expect("a link"),
            "technocan+socketcan://can0?bitrate=500000&host=3"
        );
        assert_eq!(string("sim:tml", 0), "sim:tml");
        for (device, kind) in [("", 9), ("COM1", 15), ("COM1", 0x80), ("sim:tml#1", 0)] {
            assert!(connection_string(device, kind, 1, 9600).is_err(), "{device} {kind}");
        }
    }

    #[test]
    fn ports_and_interfaces_have_numbers() {
        let first = if cfg!(windows) { "COM1" } else { "/dev/ttyS0" };
        assert_eq!((port_path("1"), port_path("COM1")), (first.to_owned(), first.to_owned()));
        assert_eq!(port_path("/dev/ttyUSB0"), "/dev/ttyUSB0");
        assert_eq!(can_interface("0", 3), "can0");
        assert_eq!(
            (can_interface("2", 7), can_interface("vcan0", 2)),
            ("can1".into(), "vcan0".into())
        );
        assert!(is_network_name("10.0.0.5:4001") && !is_network_name("/dev/serial/by-path/a:1"));
    }
}
