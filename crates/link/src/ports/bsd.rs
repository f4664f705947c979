use super::{Port, PortKind};
use crate::error::LinkError;

/// Call-out devices: they open without waiting for a carrier.
const PREFIXES: [&str; 2] = ["cu.", "cuaU"];

pub(super) fn ports() -> Vec<Port> {
    let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten();
    entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| PREFIXES.iter().any(|prefix| name.starts_with(prefix)))
        .map(|name| port(format!("/dev/{name}")))
        .collect()
}

/// macOS names the ports of CDC devices so.
pub(super) fn driver_name(path: &str) -> Option<String> {
    path.starts_with("/dev/cu.usbmodem").then(|| "cdc_acm".to_owned())
}

pub(super) fn stable_name(_path: &str) -> Option<String> {
    None
}

pub(super) fn lock_holder(_path: &str) -> Option<(String, u32)> {
    None
}

pub(super) fn open_holder(_path: &str) -> Option<(String, u32)> {
    None
}

pub(super) fn is_suspended(_pid: u32) -> bool {
    false
}

fn port(path: String) -> Port {
    use rustix::fs::{Access, access};
    let error = access(&*path, Access::READ_OK | Access::WRITE_OK)
        .err()
        .map(|errno| LinkError::from_io(&path, &errno.into()));
    let driver = driver_name(&path);
    Port { path, kind: PortKind::Bytes, stable_name: None, usb: None, driver, error }
}
