use super::{Carries, Port, Usb};

pub(super) fn ports() -> Vec<Port> {
    serialport::available_ports().unwrap_or_default().into_iter().map(port).collect()
}

/// Not asked: the system tells it by its registry alone.
pub(super) fn driver(_path: &str) -> Option<String> {
    None
}

fn port(found: serialport::SerialPortInfo) -> Port {
    let usb = match found.port_type {
        serialport::SerialPortType::UsbPort(usb) => Some(Usb {
            vendor_id: usb.vid,
            product_id: usb.pid,
            vendor: usb.manufacturer.unwrap_or_default(),
            product: usb.product.unwrap_or_default(),
            serial: usb.serial_number.unwrap_or_default(),
        }),
        _ => None,
    };
    Port { path: found.port_name, carries: Carries::Bytes, stable: None, usb, trouble: None }
}
