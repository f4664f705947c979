//! CAN interfaces of the Linux kernel (SocketCAN): controllers on PCI, SPI and USB, and `vcan`.

use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;
use rustix::io::Errno;
use rustix::net::sockopt;

use crate::clock;
use crate::descriptor::Descriptor;
use crate::error::{Cause, LinkError};
use crate::link::{LinkIo, Losses, Received};
use crate::ports::{Port, PortKind};
use crate::read_mode::ReadMode;
use crate::sys::{self, OverrunCounter};
use crate::waker::LinkWaker;

mod frame;
mod hardware_clock;
mod netlink;
#[cfg(test)]
mod tests;

use frame::{CanErrorReport, FRAME_LEN, UnpackedFrame};
use hardware_clock::HardwareClock;

/// Size of the receive buffer that the kernel is asked for; it gives at most its limit.
const RECEIVE_BUFFER: usize = 1 << 20;
/// Number of attempts at a full transmit queue, with a pause of about one frame's time.
const ATTEMPTS_MAX: u32 = 100;
const ATTEMPT_INTERVAL: Duration = Duration::from_micros(200);
/// Every class of error frame.
const ALL_ERRORS: u32 = 0x1FFF_FFFF;

/// A CAN interface as the kernel describes it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct CanInterface {
    /// `can0`.
    pub name: String,
    /// The kernel's number for it.
    pub index: u32,
    /// True if it is up.
    pub up: bool,
    /// `can`, `vcan`, `slcan`.
    pub kind: String,
    /// Bits per second; `None` when it has none (`vcan`) or none was set.
    pub bit_rate: Option<u32>,
    /// State of its controller, if it has one.
    pub controller: Option<ControllerState>,
    /// Time in milliseconds after which it leaves bus-off by itself; 0 for never.
    pub restart_ms: Option<u32>,
}

/// State of a controller (`enum can_state` of `linux/can/netlink.h`).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ControllerState {
    /// The controller sends and receives.
    Active,
    /// An error counter has reached 96.
    Warning,
    /// 128: it no longer destroys others' frames.
    Passive,
    /// Error count of 256: the controller is disconnected from the bus.
    BusOff,
    /// Switched off.
    Stopped,
    /// Asleep.
    Sleeping,
    /// A state that is not known here.
    Unknown(u32),
}

impl ControllerState {
    const fn from_kernel(state: u32) -> Self {
        match state {
            0 => Self::Active,
            1 => Self::Warning,
            2 => Self::Passive,
            3 => Self::BusOff,
            4 => Self::Stopped,
            5 => Self::Sleeping,
            other => Self::Unknown(other),
        }
    }
}

/// The CAN interfaces of this machine, by name; none where the kernel reports none.
#[must_use]
pub fn interfaces() -> Vec<CanInterface> {
    let mut found = netlink::interfaces().unwrap_or_default();
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

/// The interface as one of the machine's ports.
pub(crate) fn port(interface: CanInterface) -> Port {
    let trouble = match interface.controller {
        _ if !interface.up => {
            let hint = switch_on_hint(&interface, CanLine { bit_rate: 0 });
            Some(LinkError::new(&interface.name, Cause::Down).with_hint(&hint))
        }
        Some(ControllerState::BusOff) => {
            let hint = format!(
                "Its controller is bus-off: check wiring, termination and bit rate, then `sudo ip \
                 link set {} type can restart`.",
                interface.name
            );
            Some(LinkError::new(&interface.name, Cause::Down).with_hint(&hint))
        }
        _ => None,
    };
    Port {
        path: interface.name,
        kind: PortKind::Can { kind: interface.kind, bit_rate: interface.bit_rate },
        stable_name: None,
        usb: None,
        driver: None,
        error: trouble,
    }
}

/// Passes frames whose identifier equals `id` in the bits that are set in `mask`.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct CanFilter {
    /// 11-bit or 29-bit identifier.
    pub id: u32,
    /// Bits that are compared.
    pub mask: u32,
    /// True for 29-bit identifiers.
    pub extended: bool,
}

/// A raw socket on one interface.
#[derive(Debug)]
pub struct SocketcanLink {
    descriptor: Descriptor,
    interface: CanInterface,
    line: CanLine,
    bus_off: AtomicBool,
    hardware_clock: Mutex<HardwareClock>,
    overrun: OverrunCounter,
    overflow: AtomicU64,
    malformed: AtomicU64,
    errors: AtomicU64,
}

/// Opens the interface called `name`. With a bit rate other than 0 in `line` it must run at that.
///
/// # Errors
/// [`LinkError`]: [`Cause::NotFound`] with the interfaces that there are, [`Cause::Down`] and
/// [`Cause::Unsuitable`] (another bit rate) with the command that helps.
pub fn open(name: &str, line: CanLine) -> Result<SocketcanLink, LinkError> {
    let interface = find_interface(name)?;
    if !interface.up {
        return Err(LinkError::new(name, Cause::Down).with_hint(&switch_on_hint(&interface, line)));
    }
    check_bit_rate(&interface, line)?;
    let index = interface.index.cast_signed();
    let fd = sys::can_socket(index).map_err(|error| explain_error(name, &error))?;
    configure(&fd);
    Ok(SocketcanLink {
        descriptor: Descriptor::with_mode(ReadMode::Messages, fd, name)?,
        interface,
        line,
        bus_off: AtomicBool::new(false),
        hardware_clock: Mutex::default(),
        overrun: OverrunCounter::default(),
        overflow: AtomicU64::new(0),
        malformed: AtomicU64::new(0),
        errors: AtomicU64::new(0),
    })
}

fn find_interface(name: &str) -> Result<CanInterface, LinkError> {
    let there = interfaces();
    if let Some(interface) = there.iter().find(|interface| interface.name == name) {
        return Ok(interface.clone());
    }
    // Distinguishes a kernel without CAN from one without this interface.
    sys::can_socket(0).map_err(|error| explain_error(name, &error))?;
    let names: Vec<&str> = there.iter().map(|interface| interface.name.as_str()).collect();
    let hint = match names[..] {
        [] => "There is no CAN interface. A USB adapter shows up as can0 once its driver is \
               loaded (`dmesg | tail`); a serial one is opened with +slcan; for a virtual bus: \
               `sudo ip link add vcan0 type vcan && sudo ip link set vcan0 up`."
            .to_owned(),
        _ => format!("CAN interfaces that exist: {}.", names.join(", ")),
    };
    Err(LinkError::new(name, Cause::NotFound).with_hint(&hint))
}

/// The command that switches it on.
fn switch_on_hint(interface: &CanInterface, line: CanLine) -> String {
    let name = &interface.name;
    if matches!(interface.kind.as_str(), "vcan" | "vxcan") {
        return format!("Type `sudo ip link set {name} up`.");
    }
    let rate = if line.bit_rate == 0 { interface.bit_rate } else { Some(line.bit_rate) };
    let rate = rate.unwrap_or(500_000);
    format!("Type `sudo ip link set {name} up type can bitrate {rate}`.")
}

/// Checks that the interface has the wanted bit rate.
fn check_bit_rate(interface: &CanInterface, line: CanLine) -> Result<(), LinkError> {
    match interface.bit_rate {
        Some(rate) if line.bit_rate != 0 && rate != line.bit_rate => {
            let (name, wanted) = (&interface.name, line.bit_rate);
            let hint = format!(
                "It runs at {rate} bit/s, not at {wanted}. Type `sudo ip link set {name} down && \
                 sudo ip link set {name} up type can bitrate {wanted}`, or ask for {rate}."
            );
            Err(LinkError::new(name, Cause::Unsuitable).with_hint(&hint))
        }
        _ => Ok(()),
    }
}

fn explain_error(name: &str, error: &io::Error) -> LinkError {
    let hint = match error.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::AFNOSUPPORT | Errno::PROTONOSUPPORT | Errno::SOCKTNOSUPPORT) => {
            let hint = "This kernel has no CAN: `sudo modprobe can_raw`. In a container or cloud \
                        kernel without that module use +udp, +slcan or +socketcand.";
            return LinkError::new(name, Cause::Unsuitable).with_hint(hint);
        }
        Some(Errno::PERM | Errno::ACCESS) => {
            "This container or sandbox forbids CAN sockets: give it CAP_NET_RAW and the host's \
             network (`docker run --network host --cap-add NET_RAW`)."
        }
        _ => "",
    };
    LinkError::from_io(name, error).with_hint(hint)
}

/// Sets the options of the socket. An option that the kernel does not have is left out.
fn configure(fd: &OwnedFd) {
    sys::enable_timestamps(fd);
    let hardware = libc::SOF_TIMESTAMPING_RX_HARDWARE | libc::SOF_TIMESTAMPING_RAW_HARDWARE;
    let _ = sys::set_option(fd, libc::SOL_SOCKET, libc::SO_TIMESTAMPING, &hardware);
    let _ = sys::set_option(fd, libc::SOL_CAN_RAW, libc::CAN_RAW_ERR_FILTER, &ALL_ERRORS);
    let _ = sockopt::set_socket_recv_buffer_size(fd, RECEIVE_BUFFER);
}

impl SocketcanLink {
    /// The state of the interface when it was opened.
    #[must_use]
    pub const fn interface(&self) -> &CanInterface {
        &self.interface
    }

    /// Has the kernel let through only frames that one of `filters` matches; all of them after an
    /// empty list would be none, so that is refused. Error frames always come through.
    ///
    /// # Errors
    /// [`Cause::Unsuitable`] for an empty list or more than 512 filters.
    pub fn set_filters(&self, filters: &[CanFilter]) -> Result<(), LinkError> {
        let fail = |error: io::Error| LinkError::from_io(&self.descriptor.name, &error);
        if filters.is_empty() {
            return Err(fail(Errno::INVAL.into()));
        }
        let kinds = libc::CAN_EFF_FLAG;
        let filters: Vec<libc::can_filter> = filters
            .iter()
            .map(|filter| libc::can_filter {
                can_id: filter.id | if filter.extended { kinds } else { 0 },
                can_mask: filter.mask | kinds,
            })
            .collect();
        sys::set_option(&self.descriptor.fd, libc::SOL_CAN_RAW, libc::CAN_RAW_FILTER, &filters[..])
            .map_err(fail)
    }

    /// Reads one frame; `None` when there is none, or none of interest.
    fn read_frame(&self, frame: &mut Frame) -> Result<Option<Received>, LinkError> {
        let mut buffer = [0; FRAME_LEN];
        let Some(message) = sys::receive(&self.descriptor.fd, &mut buffer)
            .map_err(|error| self.explain_error(&error))?
        else {
            return Ok(None);
        };
        self.overrun.update(message.overrun);
        let at = self.arrival_time(message.stamp_ns, message.hardware_ns);
        match frame::unpack(&buffer[..message.len]) {
            Some(UnpackedFrame::Frame(arrived)) => {
                *frame = arrived;
                return Ok(Some(Received::Bytes { len: 1, at }));
            }
            Some(UnpackedFrame::Error(error)) => return Ok(self.handle_error_frame(error, at)),
            None => self.malformed.fetch_add(1, Ordering::Relaxed),
        };
        Ok(None)
    }

    fn arrival_time(&self, kernel_ns: Option<u64>, hardware_ns: Option<u64>) -> Instant {
        kernel_ns
            .map(|kernel_ns| match hardware_ns {
                Some(hardware_ns) => {
                    let mut clock =
                        self.hardware_clock.lock().unwrap_or_else(PoisonError::into_inner);
                    clock.kernel_time(hardware_ns, kernel_ns)
                }
                None => kernel_ns,
            })
            .map_or_else(clock::now, clock::instant_of_stamp)
    }

    /// Counts a controller's reports, and returns the ones that change the wire's state.
    fn handle_error_frame(&self, error: CanErrorReport, at: Instant) -> Option<Received> {
        self.overflow.fetch_add(error.overflow.into(), Ordering::Relaxed);
        self.errors.fetch_add(error.wire_error.into(), Ordering::Relaxed);
        let was_off = self.bus_off.load(Ordering::Relaxed);
        let event = match (error.bus_off, error.active) {
            (true, _) if !was_off => LineEvent::BusOff,
            (false, true) if was_off => LineEvent::Up,
            _ => return None,
        };
        self.bus_off.store(error.bus_off, Ordering::Relaxed);
        Some(Received::Line { event, at })
    }

    fn explain_error(&self, error: &io::Error) -> LinkError {
        let error = LinkError::from_io(&self.descriptor.name, error);
        match error.cause() {
            Cause::Down => error.with_hint(&switch_on_hint(&self.interface, self.line)),
            Cause::Stalled => error.with_hint(&self.stalled_hint()),
            _ => error,
        }
    }

    /// Hint for a full queue: no node acknowledges, or the queue is too short.
    fn stalled_hint(&self) -> String {
        let name = &self.descriptor.name;
        format!(
            "The transmit queue stays full: is another node on the bus, terminated and at the \
             same bit rate? `ip -details -statistics link show {name}` shows errors; `sudo ip link \
             set {name} txqueuelen 1000` makes room for bursts."
        )
    }
}

impl LinkIo<Can> for SocketcanLink {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        let packed = frame::pack(frame);
        for _ in 0..ATTEMPTS_MAX {
            match rustix::io::write(&self.descriptor.fd, &packed) {
                Ok(_) => return Ok(()),
                Err(Errno::INTR) => {}
                // The interface's queue is full, and poll(2) gives no notice when it has room.
                Err(Errno::NOBUFS | Errno::AGAIN) => std::thread::sleep(ATTEMPT_INTERVAL),
                Err(errno) => return Err(self.explain_error(&errno.into())),
            }
        }
        Err(LinkError::new(&self.descriptor.name, Cause::Stalled).with_hint(&self.stalled_hint()))
    }

    fn receive(&self, frame: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        self.descriptor.receive_with(until, || self.read_frame(frame))
    }

    /// The bit rate is the administrator's: it is compared, not set.
    fn set_line(&self, line: CanLine) -> Result<(), LinkError> {
        check_bit_rate(&self.interface, line)
    }

    fn waker(&self) -> LinkWaker {
        self.descriptor.waker.clone()
    }

    fn describe(&self) -> String {
        self.descriptor.name.clone()
    }

    fn losses(&self) -> Losses {
        Losses {
            overrun: self.overrun.total() + self.overflow.load(Ordering::Relaxed),
            malformed: self.malformed.load(Ordering::Relaxed),
            errors: self.errors.load(Ordering::Relaxed),
            refused: 0,
        }
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<Can>>, LinkError> {
        Ok(Box::new(open(&self.descriptor.name, self.line)?))
    }
}
