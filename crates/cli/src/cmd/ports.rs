//! `polepair ports`

use clap::Args;
use polepair_link::{Port, PortKind, ports};

use crate::data_output::DataOutput;
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{TextTable, colour_out};

/// Lists the serial and CAN adapters of this machine, with the reason if one is unusable.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair ports
  polepair scan tmcl+serial:///dev/ttyUSB0")]
pub struct Ports {}

impl Ports {
    pub fn run(self) -> Result {
        let found = ports();
        if found.is_empty() {
            return Err(Problem::new(Exit::Adapter, "E309", "no serial or CAN adapter was found.")
                .why("The system lists no port that could be one.")
                .hint("plug it in and try again")
                .hint("`polepair scan sim:tmcl` needs no adapter"));
        }
        let mut table = TextTable::with_heads(&["port", "adapter", "driver", "serial", "use"]);
        for port in &found {
            table.add_row([
                port.path.clone(),
                adapter_text(port),
                port.driver.clone().unwrap_or_default(),
                serial_number(port),
                usability_text(port),
            ]);
        }
        let mut out = DataOutput::stdout();
        out.buffer().extend_from_slice(table.render(colour_out()).as_bytes());
        out.flush()?;
        Ok(Exit::Ok)
    }
}

fn adapter_text(port: &Port) -> String {
    match (&port.kind, &port.usb) {
        (PortKind::Can { kind, bit_rate: Some(rate) }, _) => format!("{kind}, {rate} bit/s"),
        (PortKind::Can { kind, bit_rate: None }, _) => kind.clone(),
        (carries, Some(usb)) => {
            let name = format!("{} {}", usb.vendor, usb.product);
            let slcan = if *carries == PortKind::Slcan { ", slcan" } else { "" };
            format!("{} ({:04x}:{:04x}){slcan}", name.trim(), usb.vendor_id, usb.product_id)
        }
        (_, None) => "-".to_owned(),
    }
}

fn serial_number(port: &Port) -> String {
    port.usb.as_ref().map_or("", |usb| usb.serial.as_str()).to_owned()
}

fn usability_text(port: &Port) -> String {
    port.error
        .as_ref()
        .map_or_else(|| "ok".to_owned(), |trouble| format!("{trouble}. {}", trouble.hint()))
}
