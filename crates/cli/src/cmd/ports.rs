//! `polepair ports`

use clap::Args;
use polepair_link::{Carries, Port, ports};

use crate::problem::{Exit, Problem, Result};
use crate::terminal::{Output, Table, colour_out};

/// Lists the serial and CAN adapters of this machine, and why one cannot be used.
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
                .hint("plug it in and look again")
                .hint("polepair scan sim:tmcl needs no adapter"));
        }
        let mut table = Table::with_heads(&["port", "adapter", "serial", "use"]);
        for port in &found {
            table.row([port.path.clone(), adapter(port), serial(port), usable(port)]);
        }
        let mut out = Output::stdout();
        out.buffer().extend_from_slice(table.render(colour_out()).as_bytes());
        out.flush()?;
        Ok(Exit::Ok)
    }
}

fn adapter(port: &Port) -> String {
    match (&port.carries, &port.usb) {
        (Carries::Can { kind, bit_rate: Some(rate) }, _) => format!("{kind}, {rate} bit/s"),
        (Carries::Can { kind, bit_rate: None }, _) => kind.clone(),
        (carries, Some(usb)) => {
            let name = format!("{} {}", usb.vendor, usb.product);
            let slcan = if *carries == Carries::Slcan { ", slcan" } else { "" };
            format!("{} ({:04x}:{:04x}){slcan}", name.trim(), usb.vendor_id, usb.product_id)
        }
        (_, None) => "-".to_owned(),
    }
}

fn serial(port: &Port) -> String {
    port.usb.as_ref().map_or("", |usb| usb.serial.as_str()).to_owned()
}

fn usable(port: &Port) -> String {
    port.trouble
        .as_ref()
        .map_or_else(|| "ok".to_owned(), |trouble| format!("{trouble}. {}", trouble.hint()))
}
