//! Meets a fault, says what it means, takes the cause away, clears it and goes on.
//!
//! ```text
//! cargo run --example fault_and_recover -- tmcl+serial:///dev/ttyUSB0:9600#1
//! ```
//! On a simulated drive it lets the supply sag; on a real one it reports what happens by itself.

use polepair::error::{Error, Exit};
use polepair_core::profile::Signal;
use polepair_drives::surroundings::Act;
use std::time::Duration;

fn main() -> Result<(), Error> {
    let url = std::env::args().nth(1).unwrap_or_else(|| "sim:tmcl?time=virtual".into());
    let link = polepair::connect(&url)?;
    let axis = &link.axes()[0];
    let supply = |volts| link.simulation().map(|world| world.act(0, 0, Act::Supply(volts)));

    let armed = axis.armed()?;
    armed.velocity("300 rpm")?;
    link.sleep(Duration::from_millis(500));
    println!("turning");

    supply(8.0);
    link.sleep(Duration::from_millis(500));
    let fault = armed.signals(&[Signal::Fault])?[0].value;
    println!("fault code {fault}");
    match armed.enable() {
        Err(error) if error.exit() == Exit::DriveFault => {
            println!("{error}");
            println!("what to do: {}", error.hint());
        }
        Err(error) => return Err(error),
        Ok(()) => println!("no fault"),
    }

    supply(24.0); // the cause goes first
    link.sleep(Duration::from_millis(500));
    armed.clear()?;
    armed.enable()?;
    armed.velocity("300 rpm")?;
    link.sleep(Duration::from_millis(500));
    println!("turning again at {:.1} rad/s", armed.signals(&[Signal::Velocity])?[0].value);
    armed.release()
}
