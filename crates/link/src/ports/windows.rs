use super::{Port, PortKind, UsbInfo};

pub(super) fn ports() -> Vec<Port> {
    serialport::available_ports().unwrap_or_default().into_iter().map(port).collect()
}

/// Registry key in which drivers list their ports: `\\Device\\USBSER000` is COM5.
const PORT_MAP: &str = r"HARDWARE\DEVICEMAP\SERIALCOMM";

/// The driver's name in the map of ports, without its number: `usbser`, `vcp` (FTDI), `serial`.
pub(super) fn driver_name(path: &str) -> Option<String> {
    let map = windows_registry::LOCAL_MACHINE.open(PORT_MAP).ok()?;
    let named = |value: &windows_registry::Value| {
        String::try_from(value.clone()).is_ok_and(|port| port.eq_ignore_ascii_case(path))
    };
    let (device, _) = map.values().ok()?.find(|(_, value)| named(value))?;
    let name = device.rsplit('\\').next()?.trim_end_matches(|c: char| c.is_ascii_digit());
    Some(name.to_ascii_lowercase())
}

fn port(found: serialport::SerialPortInfo) -> Port {
    let usb = match found.port_type {
        serialport::SerialPortType::UsbPort(usb) => Some(UsbInfo {
            vendor_id: usb.vid,
            product_id: usb.pid,
            vendor: usb.manufacturer.unwrap_or_default(),
            product: usb.product.unwrap_or_default(),
            serial: usb.serial_number.unwrap_or_default(),
        }),
        _ => None,
    };
    let driver = driver_name(&found.port_name);
    let path = found.port_name;
    Port { path, kind: PortKind::Bytes, stable_name: None, usb, driver, error: None }
}
