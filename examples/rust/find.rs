//! Finds the drives on a link, by reads only.
//!
//! ```text
//! cargo run --example find -- tmcl+serial:///dev/ttyUSB0:9600 32
//! ```
//! The second word is the highest address that is tried (8).

use polepair::scan::scan;
use std::ops::ControlFlow;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let url = words.first().map_or("sim:tmcl:1,3?time=virtual", String::as_str);
    let last: u32 = words.get(1).map_or(Ok(8), |word| word.parse())?;

    let connector = polepair::Connector::discover();
    let found = scan(&connector, url, 1..=last, &mut |at| {
        eprint!("\raddress {} ({} of {}) ", at.number, at.done + 1, at.of);
        ControlFlow::Continue(())
    })?;
    eprintln!();
    for drive in &found.found {
        println!("{}: {}, {}", drive.number, drive.profile.title, drive.identified);
        if let Some(clash) = &drive.clash {
            println!("   {clash}");
        }
    }
    if found.found.is_empty() {
        println!("nobody answered; tried {}", found.tried.join("; "));
    }
    Ok(())
}
