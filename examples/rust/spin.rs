//! Turns a motor for a while. It is stopped and switched off however this ends.
//!
//! ```text
//! cargo run --example spin -- tmcl+serial:///dev/ttyUSB0:9600#1 "60 rpm" 3
//! ```

use polepair_core::profile::Signal;
use std::time::Duration;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let url = words.first().map_or("sim:tmcl?time=virtual", String::as_str);
    let speed = words.get(1).map_or("60 rpm", String::as_str);
    let seconds: f64 = words.get(2).map_or(Ok(2.0), |word| word.parse())?;

    let link = polepair::connect(url)?;
    let axis = &link.axes()[0];
    println!("{}: {}", axis.facts().title, axis.facts().caution);

    let armed = axis.armed()?; // enabled where it stands
    armed.velocity(speed)?;
    for _ in 0..4 {
        link.sleep(Duration::from_secs_f64(seconds / 4.0));
        let reading = armed.signals(&[Signal::Velocity])?[0];
        println!("{:.1} rpm", reading.value * 60.0 / std::f64::consts::TAU);
    }
    armed.release()?; // stopped, switched off, disarmed; dropping it does the same
    Ok(())
}
