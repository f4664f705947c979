//! Which axes of a server are meant.

use polepair_client::message::{AxisInfo, BenchView};

use crate::problem::{Problem, Result};

/// The word for every axis.
pub const ALL: &str = "all";

/// `all`, or names and numbers with commas between them, or numbers of a link: `LINK#1,2`, where the
/// link goes by its number or by its URL. A number alone has to be one axis' alone, and no axis is named
/// twice: it would be told twice.
pub fn pick(bench: &BenchView, words: &str) -> Result<Vec<AxisInfo>> {
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
            let what = format!("{words:?} names axis {} twice.", full(&axis));
            return Err(Problem::usage("E210", what).why("Nothing was sent."));
        }
        axes.push(axis);
    }
    Ok(axes)
}

/// A link by its number or its URL.
fn linked(bench: &BenchView, word: &str) -> Result<u16> {
    let plain = |url: &str| url.split('#').next().unwrap_or_default().to_owned();
    let is = |link: &&polepair_client::message::LinkView| {
        word.parse() == Ok(link.id) || plain(&link.url) == word
    };
    let found = bench.links.iter().find(is).map(|link| link.id);
    found.ok_or_else(|| {
        let known: Vec<_> =
            bench.links.iter().map(|link| format!("{} ({})", link.id, link.url)).collect();
        Problem::usage("E212", format!("the server has no link {word:?}."))
            .why(format!("It has {}.", crate::problem::list(&refs(&known))))
    })
}

fn one(bench: &BenchView, link: Option<u16>, word: &str) -> Result<AxisInfo> {
    let on_link = |axis: &&AxisInfo| link.is_none_or(|link| axis.link == link);
    let named = |axis: &&AxisInfo| {
        (!axis.name.is_empty() && axis.name == word) || word.parse() == Ok(axis.number)
    };
    let found: Vec<_> = bench.axes.iter().filter(on_link).filter(named).collect();
    match found[..] {
        [one] => Ok(one.clone()),
        [] => Err(no_such(bench, word)),
        _ => {
            let all: Vec<_> = found.iter().map(|axis| full(axis)).collect();
            let what = format!("the server has several axes {word:?}.");
            Err(Problem::usage("E212", what)
                .why("Each link has its own numbers; nothing was sent.")
                .hint(crate::problem::list(&refs(&all))))
        }
    }
}

fn no_such(bench: &BenchView, word: &str) -> Problem {
    let all: Vec<_> = bench.axes.iter().map(full).collect();
    Problem::usage("E212", format!("the server has no axis {word:?}."))
        .why(format!("It has {}.", crate::problem::list(&refs(&all))))
}

/// What means this axis and no other.
fn full(axis: &AxisInfo) -> String {
    match &*axis.name {
        "" => format!("{}#{}", axis.link, axis.number),
        name => name.to_owned(),
    }
}

fn refs(all: &[String]) -> Vec<&str> {
    all.iter().map(String::as_str).collect()
}
