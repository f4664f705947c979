//! Shows position, speed and current of every axis on a link, without moving any.
//!
//! ```text
//! cargo run --example watch -- "tmcl+serial:///dev/ttyUSB0:9600#1,3" 10
//! ```
//! The second word is how many readings are shown (5).

use polepair_core::profile::Signal;
use std::ops::ControlFlow;
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(100);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let url = words.first().map_or("sim:tmcl:1,3?time=virtual", String::as_str);
    let readings: u32 = words.get(1).map_or(Ok(5), |word| word.parse())?;

    let link = polepair::connect(url)?;
    for axis in link.axes() {
        println!("{} ({})", axis.label(), axis.facts().title);
        // Only what this drive can tell.
        let wanted = [Signal::Position, Signal::Velocity, Signal::Current];
        let signals: Vec<Signal> =
            wanted.into_iter().filter(|signal| axis.has_signal(*signal)).collect();
        let mut left = readings;
        axis.watch(&signals, PERIOD, |values| {
            let line: Vec<String> = values
                .iter()
                .map(|reading| format!("{} {:.4}", reading.signal.name(), reading.value))
                .collect();
            println!("  {}", line.join("  "));
            left -= 1;
            if left == 0 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })?;
    }
    Ok(())
}
