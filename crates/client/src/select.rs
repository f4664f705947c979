//! Selects axes of a server by number, name or link, and knows their units.

use polepair_core::proto::AxisNumber;
use polepair_core::units::Unit;
use polepair_messages::{AxisInfo, BenchView, LinkView};

use crate::GatewayError;

/// The word for every axis.
pub const ALL: &str = "all";

/// Parses a selection of axes: `all`, or names and numbers with commas between them. After `LINK#` come
/// axes of one link, by its number or its URL: `1,3`, `0#1,2`, `0#1,1#2`. A number without a link must
/// belong to one axis only, and no axis may be named twice: it would receive the command twice.
///
/// # Errors
/// `E212` for an axis that the server does not have or has several of, `E210` for an axis that is named
/// twice; the error of its link for one that is not connected.
pub fn select_axes(bench: &BenchView, words: &str) -> Result<Vec<AxisInfo>, GatewayError> {
    let axes = select_each(bench, words)?.into_iter().collect::<Result<Vec<_>, _>>()?;
    let is_twice =
        |(at, axis): &(usize, &AxisInfo)| axes[..*at].iter().any(|its| its.id == axis.id);
    match axes.iter().enumerate().find(is_twice) {
        None => Ok(axes),
        Some((_, axis)) => {
            let what = format!("{words:?} names axis {} twice", full_name(axis));
            Err(GatewayError::new("E210", what).hint("name each axis once"))
        }
    }
}

/// [`select_axes`] with one result for each axis, for callers that go on without the missing ones.
///
/// # Errors
/// `E212` for a link that the server has not, and for `all` where it has no axis.
pub fn select_each(
    bench: &BenchView,
    words: &str,
) -> Result<Vec<Result<AxisInfo, GatewayError>>, GatewayError> {
    if words == ALL {
        return if bench.axes.is_empty() {
            Err(unknown_axis_error(bench, words))
        } else {
            Ok(bench.axes.iter().cloned().map(Ok).collect())
        };
    }
    let mut axes = Vec::new();
    let (mut link, mut segments) = (None, words.split('#').peekable());
    while let Some(segment) = segments.next() {
        let (numbers, next) = match segments.peek() {
            Some(_) => before_link(bench, segment)?,
            None => (Some(segment), None),
        };
        let numbers = numbers.iter().flat_map(|numbers| numbers.split(','));
        axes.extend(numbers.map(|word| find_axis(bench, link, word.trim())));
        link = next.or(link);
    }
    Ok(axes)
}

/// The text before a `#`: axes of the previous link, and a link, whose URL may contain commas.
fn before_link<'a>(
    bench: &'a BenchView,
    segment: &'a str,
) -> Result<(Option<&'a str>, Option<&'a LinkView>), GatewayError> {
    if segment.is_empty() {
        return Ok((None, None));
    }
    let commas =
        segment.match_indices(',').map(|(at, _)| (Some(&segment[..at]), &segment[at + 1..]));
    let mut ways = std::iter::once((None, segment)).chain(commas);
    let found = ways.find_map(|(axes, word)| Some((axes, Some(find_link(bench, word.trim())?))));
    found.ok_or_else(|| {
        let known = bench.links.iter().map(|link| format!("{} ({})", link.id, link.url));
        let word = segment.rsplit(',').next().unwrap_or(segment).trim();
        GatewayError::new("E212", format!("the server has no link {word:?}")).hint(list_hint(known))
    })
}

/// A link by its number, its URL, or its URL without axes.
#[must_use]
pub fn find_link<'a>(bench: &'a BenchView, word: &str) -> Option<&'a LinkView> {
    bench
        .links
        .iter()
        .find(|link| word.parse() == Ok(link.id) || link.url == word || is_url_of(&link.url, word))
}

fn is_url_of(url: &str, word: &str) -> bool {
    url.split('#').next() == Some(word)
}

fn find_axis(
    bench: &BenchView,
    link: Option<&LinkView>,
    word: &str,
) -> Result<AxisInfo, GatewayError> {
    let found: Vec<_> = bench
        .axes
        .iter()
        .filter(|axis| link.is_none_or(|link| axis.link == link.id))
        .filter(|axis| {
            let number = AxisNumber::parse(word).map(|number| number.0);
            // A group's number is written otherwise than an axis': g1.
            let is_group = || AxisNumber(axis.number).to_string() == word;
            (!axis.name.is_empty() && axis.name == word)
                || number == Some(axis.number)
                || is_group()
        })
        .collect();
    match found[..] {
        [one] => Ok(one.clone()),
        [] => {
            let links = bench.links.iter().filter(|its| link.is_none_or(|link| its.id == link.id));
            let mut absent = links.filter_map(|link| absent_error(link, AxisNumber::parse(word)?));
            Err(absent.next().unwrap_or_else(|| unknown_axis_error(bench, word)))
        }
        _ => {
            let all: Vec<_> = found.into_iter().map(full_name).collect();
            let what = format!("the server has several axes {word:?}: {}", all.join(", "));
            Err(GatewayError::new("E212", what).hint("name the link as well"))
        }
    }
}

/// Why an axis that the server's link should have is not there.
fn absent_error(link: &LinkView, number: AxisNumber) -> Option<GatewayError> {
    let LinkView { id, absent, pending_stops, error, .. } = link;
    let absent = absent.iter().find(|axis| axis.number == number.0).map(|axis| &axis.error);
    let is_pending = pending_stops.contains(&number.0);
    let why = absent.or(error.as_ref().filter(|_| is_pending))?;
    let what = format!(
        "axis {number} of link {id} is missing, and no stop was sent to it: {}",
        why.message
    );
    let hint = if is_pending {
        "cut its supply: its stop is pending since the previous server, and is sent as soon \
             as the drive replies"
    } else {
        "cut its supply if it turns; the server adds it as soon as it replies"
    };
    Some(GatewayError {
        executed: Some(false),
        message: what,
        hint: hint.to_owned(),
        ..why.clone()
    })
}

fn unknown_axis_error(bench: &BenchView, word: &str) -> GatewayError {
    let what = format!("the server has no axis {word:?}");
    GatewayError::new("E212", what).hint(list_hint(bench.axes.iter().map(full_name)))
}

/// Hint with the existing names.
fn list_hint(all: impl Iterator<Item = String>) -> String {
    let all: Vec<_> = all.collect();
    if all.is_empty() { "it has none".to_owned() } else { format!("it has {}", all.join(", ")) }
}

/// A name that is unique on the server.
fn full_name(axis: &AxisInfo) -> String {
    match &*axis.name {
        "" => format!("{}#{}", axis.link, AxisNumber(axis.number)),
        name => name.to_owned(),
    }
}

/// The display unit for an SI unit of the server.
#[must_use]
pub fn display_unit(si: &str) -> Unit {
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
