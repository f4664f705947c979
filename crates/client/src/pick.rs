//! Which axes of a server are meant, and in what they are measured.

use polepair_core::units::Unit;
use polepair_messages::{AxisInfo, BenchView, LinkView};

use crate::Refused;

/// The word for every axis.
pub const ALL: &str = "all";

/// `all`, or names and numbers with commas between them, or numbers of a link: `LINK#1,2`, where the
/// link goes by its number or by its URL. A number alone has to be one axis' alone, and no axis is named
/// twice: it would be told twice.
///
/// # Errors
/// `E212` for what is not there or may be several, `E210` for an axis that is named twice.
pub fn pick(bench: &BenchView, words: &str) -> Result<Vec<AxisInfo>, Refused> {
    if words == ALL {
        return match bench.axes.is_empty() {
            true => Err(no_such(bench, words)),
            false => Ok(bench.axes.clone()),
        };
    }
    let (link, numbers) = match words.rsplit_once('#') {
        Some(("", numbers)) => (None, numbers),
        Some((link, numbers)) => (Some(linked(bench, link)?), numbers),
        None => (None, words),
    };
    let mut axes: Vec<AxisInfo> = Vec::new();
    for word in numbers.split(',') {
        let axis = one(bench, link, word.trim())?;
        if axes.iter().any(|its| its.id == axis.id) {
            let what = format!("{words:?} names axis {} twice", full(&axis));
            return Err(Refused::new("E210", what).hint("name each axis once"));
        }
        axes.push(axis);
    }
    Ok(axes)
}

/// A link by its number or its URL.
fn linked(bench: &BenchView, word: &str) -> Result<u16, Refused> {
    let plain = |url: &str| url.split('#').next().unwrap_or_default().to_owned();
    let is = |link: &&LinkView| word.parse() == Ok(link.id) || plain(&link.url) == word;
    let found = bench.links.iter().find(is).map(|link| link.id);
    found.ok_or_else(|| {
        let known = bench.links.iter().map(|link| format!("{} ({})", link.id, link.url));
        Refused::new("E212", format!("the server has no link {word:?}")).hint(has(known))
    })
}

fn one(bench: &BenchView, link: Option<u16>, word: &str) -> Result<AxisInfo, Refused> {
    let on_link = |axis: &&AxisInfo| link.is_none_or(|link| axis.link == link);
    let named = |axis: &&AxisInfo| {
        (!axis.name.is_empty() && axis.name == word) || word.parse() == Ok(axis.number)
    };
    let found: Vec<_> = bench.axes.iter().filter(on_link).filter(named).collect();
    match found[..] {
        [one] => Ok(one.clone()),
        [] => Err(no_such(bench, word)),
        _ => {
            let all: Vec<_> = found.into_iter().map(full).collect();
            let what = format!("the server has several axes {word:?}: {}", all.join(", "));
            Err(Refused::new("E212", what).hint("name the link as well"))
        }
    }
}

fn no_such(bench: &BenchView, word: &str) -> Refused {
    let what = format!("the server has no axis {word:?}");
    Refused::new("E212", what).hint(has(bench.axes.iter().map(full)))
}

/// What there is instead.
fn has(all: impl Iterator<Item = String>) -> String {
    let all: Vec<_> = all.collect();
    if all.is_empty() { "it has none".to_owned() } else { format!("it has {}", all.join(", ")) }
}

/// What means this axis and no other.
fn full(axis: &AxisInfo) -> String {
    match &*axis.name {
        "" => format!("{}#{}", axis.link, axis.number),
        name => name.to_owned(),
    }
}

/// What is measured in an SI unit of the server's.
#[must_use]
pub fn unit(si: &str) -> Unit {
    match si {
        "rad" => Unit::Radian,
        "rad/s" => Unit::Rpm,
        "rad/s²" => Unit::RpmPerSecond,
        "m" => Unit::Millimetre,
        "m/s" => Unit::MillimetrePerSecond,
        "m/s²" => Unit::MillimetrePerSecondSquared,
        "N·m" => Unit::NewtonMetre,
        "A" => Unit::Ampere,
        "V" => Unit::Volt,
        "s" => Unit::Second,
        _ => Unit::Percent,
    }
}
