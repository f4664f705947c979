//! Checks of this machine: adapters, CAN interfaces, configuration.

use super::CheckResult;
use crate::config::FILE;
use crate::connect::Connector;
use crate::error::{Error, Exit};
use polepair_link::{Port, PortKind, ports};

/// Looks at the adapters of this machine and at what `polepair.toml` names. Nothing is opened.
#[must_use]
pub fn check_machine(connector: &Connector) -> Vec<CheckResult> {
    let found = ports();
    let mut checks: Vec<CheckResult> = found.iter().map(check_port).collect();
    if found.is_empty() {
        let remedy = "plug in an adapter and try again; `sim:tmcl` needs none";
        let text = "no serial or CAN adapter was found";
        checks.push(CheckResult::wrong("adapters", Exit::Adapter, text, remedy));
    }
    let broken = connector.config.broken.iter();
    checks.extend(broken.map(|error| CheckResult::error("configuration", &error.clone().into())));
    checks.push(match &connector.config.file {
        Some(file) if connector.config.is_broken(file) => CheckResult::suspicious(
            "configuration",
            "links have no names until the file is \
             corrected",
            "",
        ),
        Some(file) => CheckResult::ok("configuration", format!("{} is read", file.display())),
        None => CheckResult::ok("configuration", format!("no {FILE}: links have no names")),
    });
    checks.extend(
        connector.config.links.iter().map(|(name, url)| check_named_link(connector, name, url)),
    );
    checks
}

fn check_port(port: &Port) -> CheckResult {
    if let Some(trouble) = &port.error {
        return CheckResult::error(&port.path, &Error::Link(trouble.clone()));
    }
    match &port.kind {
        PortKind::Can { kind, bit_rate: Some(rate) } => {
            CheckResult::ok(&port.path, format!("{kind} interface, switched on, {rate} bit/s"))
        }
        // A virtual bus has no bit rate.
        PortKind::Can { kind, bit_rate: None } if kind != "can" => CheckResult::ok(
            &port.path,
            format!("{kind} interface, switched on, without bit timing"),
        ),
        PortKind::Can { .. } => {
            let remedy = format!(
                "`sudo ip link set {} up type can bitrate 500000`, at the bus' rate",
                port.path
            );
            CheckResult::suspicious(&port.path, "CAN interface without a bit rate", remedy)
        }
        PortKind::Slcan => {
            CheckResult::ok(&port.path, describe_adapter(port, "a CAN adapter with slcan"))
        }
        PortKind::Bytes => CheckResult::ok(&port.path, describe_adapter(port, "a serial port")),
    }
}

fn describe_adapter(port: &Port, what: &str) -> String {
    let usb = port.usb.as_ref().map(|usb| format!("{} {}", usb.vendor, usb.product));
    let usb = usb.map(|name| name.trim().to_owned()).filter(|name| !name.is_empty());
    let usb = usb.map_or_else(String::new, |name| format!(" ({name})"));
    format!("{what}{usb}; this user has permission to open it")
}

fn check_named_link(connector: &Connector, name: &str, url: &str) -> CheckResult {
    let about = format!("@{name}");
    match connector.url(&about) {
        Ok(_) => CheckResult::ok(&about, url),
        Err(error) => CheckResult::error(&about, &error),
    }
}
