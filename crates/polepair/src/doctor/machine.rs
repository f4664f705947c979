//! What this machine has: adapters, CAN interfaces, configuration.

use super::Check;
use crate::config::FILE;
use crate::connect::Connector;
use crate::error::{Error, Exit};
use polepair_link::{Carries, Port, ports};

/// Looks at the adapters of this machine and at what `polepair.toml` names. Nothing is opened.
#[must_use]
pub fn machine(connector: &Connector) -> Vec<Check> {
    let found = ports();
    let mut checks: Vec<Check> = found.iter().map(port).collect();
    if found.is_empty() {
        let remedy = "plug an adapter in and look again; `sim:tmcl` needs none";
        let said = "no serial or CAN adapter was found";
        checks.push(Check::wrong("adapters", Exit::Adapter, said, remedy));
    }
    let broken = connector.config.broken.iter();
    checks.extend(broken.map(|error| Check::error("configuration", &error.clone().into())));
    checks.push(match &connector.config.file {
        Some(file) if connector.config.is_broken(file) => {
            Check::look("configuration", "links have no names until that is mended", "")
        }
        Some(file) => Check::ok("configuration", format!("{} is read", file.display())),
        None => Check::ok("configuration", format!("no {FILE}: links have no names")),
    });
    checks.extend(connector.config.links.iter().map(|(name, url)| named(connector, name, url)));
    checks
}

fn port(port: &Port) -> Check {
    if let Some(trouble) = &port.trouble {
        return Check::error(&port.path, &Error::Link(trouble.clone()));
    }
    match &port.carries {
        Carries::Can { kind, bit_rate: Some(rate) } => {
            Check::ok(&port.path, format!("{kind} interface, switched on, {rate} bit/s"))
        }
        // A virtual bus has no bit rate.
        Carries::Can { kind, bit_rate: None } if kind != "can" => {
            Check::ok(&port.path, format!("{kind} interface, switched on, without bit timing"))
        }
        Carries::Can { .. } => {
            let remedy = format!(
                "`sudo ip link set {} up type can bitrate 500000`, at the bus' rate",
                port.path
            );
            Check::look(&port.path, "CAN interface without a bit rate", remedy)
        }
        Carries::Slcan => Check::ok(&port.path, adapter(port, "a CAN adapter that speaks slcan")),
        Carries::Bytes => Check::ok(&port.path, adapter(port, "a serial port")),
    }
}

fn adapter(port: &Port, what: &str) -> String {
    let usb = port.usb.as_ref().map(|usb| format!("{} {}", usb.vendor, usb.product));
    let usb = usb.map(|name| name.trim().to_owned()).filter(|name| !name.is_empty());
    let usb = usb.map_or_else(String::new, |name| format!(" ({name})"));
    format!("{what}{usb}; this user may open it")
}

fn named(connector: &Connector, name: &str, url: &str) -> Check {
    let about = format!("@{name}");
    match connector.url(&about) {
        Ok(_) => Check::ok(&about, url),
        Err(error) => Check::error(&about, &error),
    }
}
