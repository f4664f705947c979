use super::{Port, PortKind, UsbInfo};

pub(super) fn ports() -> Vec<Port> {
    serialport::available_ports().unwrap_or_default().into_iter().map(port).collect()
}

/// Not asked: the system tells it by its registry alone.
pub(super) fn driver_name(_path: &str) -> Option<String> {
    None
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
    Port { path: found.port_name, kind: PortKind::Bytes, stable_name: None, usb, error: None }
}
