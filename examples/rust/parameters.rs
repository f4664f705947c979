//! Reads and writes parameters by name, with units.
//!
//! ```text
//! cargo run --example parameters -- tmcl+serial:///dev/ttyUSB0:9600#1 "max current"
//! ```
//! It writes back the value that it read: a drive keeps the settings it had.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let url = words.first().map_or("sim:tmcl?time=virtual", String::as_str);
    let name = words.get(1).map_or("max current", String::as_str);

    let link = polepair::connect(url)?;
    let axis = &link.axes()[0];
    println!("{} is a {}", axis.label(), axis.facts().title);

    let before = axis.get(name)?;
    println!("{name} = {before} (on the wire {})", axis.get_raw(name)?);
    let id = axis.find(name)?;
    let parameter = &axis.parameters()?[usize::from(id.0)];
    println!("{} In the manual: {}, {}", parameter.about, parameter.symbol, parameter.section);

    // In the parameter's own unit; text may carry another one: `axis.set(name, "1200 mA")`.
    axis.set(name, before.value)?;

    // Outside the limits nothing is sent.
    match axis.set_raw(name, parameter.raw_range.1 + 1) {
        Err(error) if error.executed() == Some(false) => println!("{}: {error}", error.code()),
        Err(error) => return Err(error.into()),
        Ok(()) => println!("the limit is not where the profile says"),
    }
    Ok(())
}
