//! Finds the reference position, then moves there and back.
//!
//! ```text
//! cargo run --example move_and_home -- modbus-rtu+serial:///dev/ttyUSB0:115200#1
//! ```
//! A drive that cannot home says so, and is moved from where it stands.

use polepair::error::Error;
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use polepair_drives::surroundings::Act;
use std::time::Duration;

const AT_MOST: Duration = Duration::from_secs(60);

fn main() -> Result<(), Error> {
    let url = std::env::args().nth(1).unwrap_or_else(|| "sim:tmcl?time=virtual".into());
    let link = polepair::connect(&url)?;
    let axis = &link.axes()[0];
    if let Some(simulation) = link.simulation() {
        // A switch at half a turn, as a mechanic would fit one.
        simulation.act(0, 0, Act::Switch { which: 0, at: std::f64::consts::PI });
    }

    let armed = axis.armed()?;
    match armed.start(Command::new(Verb::Home)).and_then(|mut homing| homing.wait(AT_MOST)) {
        Ok(Some(_)) => println!("home found"),
        Ok(None) => println!("no home within {AT_MOST:?}"),
        Err(Error::Unsupported { what, .. }) => println!("{what}"),
        Err(error) => return Err(error),
    }

    for target in ["90 deg", "0 deg"] {
        armed.move_to(target)?;
        armed.wait(AT_MOST)?;
        println!("at {target}: {:.4} rad", armed.signals(&[Signal::Position])?[0].value);
    }
    armed.move_by("-45 deg")?; // never sent twice
    armed.wait(AT_MOST)?;
    println!("45 degrees back: {:.4} rad", armed.signals(&[Signal::Position])?[0].value);
    armed.release()
}
