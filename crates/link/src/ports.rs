//! Lists the serial and CAN adapters of this machine, with the reason if one is unusable.

use crate::error::LinkError;

#[cfg(target_os = "linux")]
#[path = "ports/linux.rs"]
mod system;
#[cfg(all(unix, not(target_os = "linux")))]
#[path = "ports/bsd.rs"]
mod system;
#[cfg(windows)]
#[path = "ports/windows.rs"]
mod system;

/// Ports that are listed at most.
pub const PORTS_MAX: usize = 256;

/// A serial or CAN adapter.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Port {
    /// Name to open: `/dev/ttyUSB0`, `COM3`, `can0`.
    pub path: String,
    /// Kind of the port.
    pub kind: PortKind,
    /// The name that survives replugging, where the system has one.
    pub stable_name: Option<String>,
    /// USB descriptor of the adapter.
    pub usb: Option<UsbInfo>,
    /// Name of the driver, if the system reports it: `ftdi_sio` (Linux), `usbser` (Windows).
    pub driver: Option<String>,
    /// Why it cannot be used now; nothing was opened to find out.
    pub error: Option<LinkError>,
}

/// Kind of an adapter.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub enum PortKind {
    /// Bytes of a serial line.
    #[default]
    Bytes,
    /// CAN frames in the serial protocol slcan: an adapter known to use it.
    Slcan,
    /// Frames of a CAN bus, as an interface of the kernel's.
    Can {
        /// The driver's word: `can`, `vcan`, `slcan`.
        kind: String,
        /// Bits per second, where it has one and it was set.
        bit_rate: Option<u32>,
    },
}

/// USB descriptor of an adapter.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct UsbInfo {
    /// Vendor id.
    pub vendor_id: u16,
    /// Product id.
    pub product_id: u16,
    /// Vendor's name; empty when there is none.
    pub vendor: String,
    /// Product's name; empty when there is none.
    pub product: String,
    /// Serial number; empty when there is none.
    pub serial: String,
}

/// Lists the adapters, by name.
///
/// ```
/// for port in polepair_link::ports() {
///     match &port.error {
///         None => println!("{}", port.path),
///         Some(trouble) => println!("{trouble}. {}", trouble.hint()),
///     }
/// }
/// ```
#[must_use]
pub fn ports() -> Vec<Port> {
    let mut found = system::ports();
    #[cfg(target_os = "linux")]
    found.extend(crate::socketcan::interfaces().into_iter().map(crate::socketcan::port));
    found.sort_by(|a, b| natural_key(&a.path).cmp(&natural_key(&b.path)));
    found.truncate(PORTS_MAX);
    for port in &mut found {
        if port.usb.as_ref().is_some_and(UsbInfo::speaks_slcan) {
            port.kind = PortKind::Slcan;
        }
    }
    found
}

/// Serial adapters that carry nothing but CAN: CANable, MKS CANable, Lawicel's CANUSB, Babel.
const SLCAN_IDS: [(u16, u16); 4] =
    [(0xAD50, 0x60C4), (0x16D0, 0x117E), (0x0403, 0xFFA8), (0x1D50, 0x60C7)];
/// Words in the names of such adapters.
const SLCAN_NAMES: [&str; 5] = ["slcan", "canable", "cantact", "canusb", "usbtin"];

impl UsbInfo {
    fn speaks_slcan(&self) -> bool {
        let product = self.product.to_ascii_lowercase();
        SLCAN_IDS.contains(&(self.vendor_id, self.product_id))
            || SLCAN_NAMES.iter().any(|name| product.contains(name))
    }
}

/// Drivers of ports behind which no UART may be: USB CDC, as drives with a USB connector have it.
/// Bytes sent there take no time, whatever baud rate is set.
const WITHOUT_BAUD_RATE: [&str; 2] = ["cdc_acm", "usbser"];
/// The name of this program. It stops its motors when it is ended.
#[cfg(unix)]
const PROGRAM: &str = "polepair";

/// Returns whether the driver of the port at `path` is known to have no baud rate. False where the system does not
/// report it, and for converters that emulate one.
#[must_use]
pub fn has_no_baud_rate(path: &str) -> bool {
    system::driver_name(path).is_some_and(|driver| WITHOUT_BAUD_RATE.contains(&&*driver))
}

/// The paths of serial ports alone.
pub(crate) fn serial_paths() -> Vec<String> {
    ports()
        .into_iter()
        .filter(|port| !matches!(port.kind, PortKind::Can { .. }))
        .map(|port| port.path)
        .collect()
}

/// The name of `path` that survives replugging.
#[cfg(unix)]
pub(crate) fn stable_name(path: &str) -> Option<String> {
    system::stable_name(path)
}

/// `In use by minicom (process 4711).`, or nothing when this user may not see who; for another run
/// of this program also how it is ended, and of one that is suspended what has it go on.
#[cfg(unix)]
pub(crate) fn holder_sentence(path: &str) -> String {
    let Some((name, pid)) = system::lock_holder(path).or_else(|| system::open_holder(path)) else {
        return String::new();
    };
    match (name == PROGRAM, system::is_suspended(pid)) {
        (true, false) => format!(
            "In use by {name} (process {pid}): Ctrl-C there, or `kill -INT {pid}`, ends it and \
             stops its motion."
        ),
        (true, true) => format!(
            "In use by {name} (process {pid}), which is suspended: \
             `kill -INT {pid}; kill -CONT {pid}` ends it and stops its motion."
        ),
        (false, false) => format!("In use by {name} (process {pid})."),
        (false, true) => format!(
            "In use by {name} (process {pid}), which is suspended: `kill -CONT {pid}` continues it."
        ),
    }
}

/// The program that serves `path`, if it is another run of this program with `named` on its command line. The number of
/// a pseudo-terminal alone may by now belong to a shell.
#[cfg(unix)]
pub(crate) fn serving_instance(path: &std::path::Path, named: &std::path::Path) -> Option<String> {
    let (name, pid) = system::open_holder(path.to_str()?)?;
    let words = std::fs::read(format!("/proc/{pid}/cmdline")).ok()?;
    let wanted = named.file_name()?.to_str()?;
    let reported = String::from_utf8_lossy(&words).split('\0').any(|word| word.ends_with(wanted));
    reported.then(|| format!("In use by {name} (process {pid})."))
}

/// `ttyUSB10` after `ttyUSB9`.
fn natural_key(path: &str) -> (&str, u32) {
    let stem = path.trim_end_matches(|c: char| c.is_ascii_digit());
    (stem, path[stem.len()..].parse().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_comes_after_nine() {
        let mut names = ["/dev/ttyUSB10", "/dev/ttyACM1", "/dev/ttyUSB9", "/dev/rfcomm"];
        names.sort_by_key(|name| natural_key(name));
        assert_eq!(names, ["/dev/rfcomm", "/dev/ttyACM1", "/dev/ttyUSB9", "/dev/ttyUSB10"]);
    }

    #[test]
    fn slcan_adapters_are_known_by_number_or_name() {
        let usb = |vendor_id, product_id, product: &str| UsbInfo {
            vendor_id,
            product_id,
            product: product.into(),
            ..UsbInfo::default()
        };
        assert!(usb(0xAD50, 0x60C4, "").speaks_slcan());
        assert!(usb(0x04D8, 0x000A, "USBtin").speaks_slcan());
        assert!(!usb(0x0403, 0x6001, "FT232R USB UART").speaks_slcan());
    }

    #[test]
    fn listing_never_fails() {
        for port in ports() {
            assert!(!port.path.is_empty());
        }
    }

    #[test]
    fn udev_rules_name_every_adapter_that_is_known() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../packaging/60-polepair.rules");
        let rules = std::fs::read_to_string(file).expect("the rules");
        for (vendor, product) in SLCAN_IDS {
            let rule = format!(
                r#"ATTRS{{idVendor}}=="{vendor:04x}", ATTRS{{idProduct}}=="{product:04x}""#
            );
            assert!(rules.contains(&rule), "{rule}");
        }
    }
}
