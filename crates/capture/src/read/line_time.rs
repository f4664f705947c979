//! Dates and times at the start of lines that other programs print.

use crate::date;
use crate::timestamp::Timestamp;

/// Date of a time of day without one.
const FIRST_DAY: [u16; 3] = [1970, 1, 1];
/// Names of months in system logs.
const MONTHS: [&str; 12] =
    ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

/// Splits off a date and a time, a time of day, seconds with decimals, or milliseconds, also in brackets. `None`
/// where the text begins with none of them.
///
/// A date with the day and the month in an unknown order (`11/12/2026`) is dropped. The time of day then counts
/// from 1970-01-01, because a wrong date would be worse than none.
pub(super) fn split_time(text: &str) -> Option<(Timestamp, &str)> {
    let inner = text.strip_prefix(['[', '(']);
    let (time, rest) = split_plain_time(inner.unwrap_or(text))?;
    let rest = rest.trim_start();
    match inner {
        Some(_) => Some((time, rest.strip_prefix([']', ')'])?.trim_start())),
        None => Some((time, rest)),
    }
}

fn split_plain_time(text: &str) -> Option<(Timestamp, &str)> {
    if let Some((date, rest)) = split_date(text)
        && let Some(found) = split_clock(date, rest.trim_start_matches([' ', '\t', 'T', ',', '_']))
    {
        return Some(found);
    }
    split_clock(FIRST_DAY, text).or_else(|| split_seconds(text))
}

/// `2026-11-27`, `27.11.2026`, `11/27/2026`, `Nov 27`.
fn split_date(text: &str) -> Option<([u16; 3], &str)> {
    if let Some(month) = MONTHS.iter().position(|name| text.starts_with(name)) {
        let rest = text[3..].trim_start();
        let (day, rest) = split_digits(rest);
        // System logs leave the year out.
        return Some(([1970, month as u16 + 1, day.parse().ok()?], rest));
    }
    let end = text.find(|c: char| !c.is_ascii_digit() && !"-./".contains(c)).unwrap_or(text.len());
    let (word, rest) = text.split_at(end);
    Some((parse_date(word)?, rest))
}

/// A date as a word; the first day where the order of day and month is not certain.
pub(super) fn parse_date(word: &str) -> Option<[u16; 3]> {
    let separator = word.chars().find(|c| !c.is_ascii_digit())?;
    let mut parts = word.split(separator);
    let texts @ [first, _, last] = [parts.next()?, parts.next()?, parts.next()?];
    let [a, b, c] = texts.map(str::parse::<u16>);
    let date = [a.ok()?, b.ok()?, c.ok()?];
    match (first.len(), last.len(), separator) {
        _ if parts.next().is_some() => None,
        (4, 1 | 2, _) => Some(date),
        (1 | 2, 4, '.') => Some([date[2], date[1], date[0]]),
        (1 | 2, 4, _) => Some(FIRST_DAY),
        _ => None,
    }
}

fn split_clock(date: [u16; 3], text: &str) -> Option<(Timestamp, &str)> {
    let end = text.find(|c: char| !c.is_ascii_digit() && !":.,".contains(c)).unwrap_or(text.len());
    let word = text[..end].trim_end_matches([':', '.', ',']);
    let rest = &text[word.len()..];
    let ([hour, minute, second], ns) = parse_clock(word)?;
    let (hour, rest) = match rest.trim_start() {
        late if late.starts_with("PM") => (hour % 12 + 12, &late[2..]),
        early if early.starts_with("AM") => (hour % 12, &early[2..]),
        _ => (hour, rest),
    };
    let time = date::from_calendar(date, [hour, minute, second], ns)?;
    let (zone_ns, rest) = split_zone(rest);
    Some((Timestamp(time.0.checked_add_signed(-zone_ns)?), rest))
}

/// `Z`, `+01:00`, `-0500`: the zone's distance from UTC in nanoseconds.
fn split_zone(text: &str) -> (i64, &str) {
    if let Some(rest) = text.strip_prefix('Z') {
        return (0, rest);
    }
    let zone = || {
        let sign = match text.chars().next()? {
            '+' => 1,
            '-' => -1,
            _ => return None,
        };
        let (hours, minutes) = (text.get(1..3)?, text.get(3..)?);
        let colon = usize::from(minutes.starts_with(':'));
        let (minutes, rest) = (minutes.get(colon..colon + 2)?, minutes.get(colon + 2..)?);
        let minutes = hours.parse::<i64>().ok()? * 60 + minutes.parse::<i64>().ok()?;
        Some((sign * minutes * 60_000_000_000, rest))
    };
    zone().unwrap_or((0, text))
}

/// `12:34:56.789`, also with a comma or a colon before the decimals, or without them.
pub(super) fn parse_clock(word: &str) -> Option<([u16; 3], u32)> {
    let (clock, decimals) = match word.split_once(['.', ',']) {
        Some(parts) => parts,
        // QModMaster: `12:34:56:789`.
        None => match word.rsplit_once(':') {
            Some((clock, ms)) if ms.len() == 3 => (clock, ms),
            _ => (word, ""),
        },
    };
    let mut parts = clock.split(':');
    let clock =
        [parts.next()?.parse().ok()?, parts.next()?.parse().ok()?, parts.next()?.parse().ok()?];
    if parts.next().is_some() || !decimals.bytes().all(|c| c.is_ascii_digit()) {
        return None;
    }
    Some((clock, parse_decimals(decimals)))
}

/// Decimals of a second as nanoseconds.
fn parse_decimals(decimals: &str) -> u32 {
    let digits = decimals.bytes().chain(core::iter::repeat(b'0')).take(9);
    digits.fold(0, |ns, digit| ns * 10 + u32::from(digit - b'0'))
}

/// `12.345`, `12.345 s`, `12.3 ms`, `12345 ms`. Seconds without decimals are no time: they could be anything.
fn split_seconds(text: &str) -> Option<(Timestamp, &str)> {
    let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (word, rest) = text.split_at(end);
    let unit = rest.trim_start();
    let time = Timestamp::parse(word.as_bytes())?;
    if let Some(after) = unit.strip_prefix("ms").filter(|after| !begins_with_word(after)) {
        return Some((Timestamp(time.0 / 1000), after));
    }
    let after = unit.strip_prefix('s').filter(|after| !begins_with_word(after)).unwrap_or(rest);
    (word.contains('.') && !begins_with_word(after)).then_some((time, after))
}

fn begins_with_word(text: &str) -> bool {
    text.starts_with(|c: char| c.is_alphanumeric() || c == '_')
}

fn split_digits(text: &str) -> (&str, &str) {
    text.split_at(text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len()))
}

#[cfg(test)]
mod tests {
    use super::split_time;

    #[test]
    fn times_of_many_programs() {
        for (text, expected) in [
            ("2026-11-27 12:34:56,500 DEBUG", "1795782896.5|DEBUG"),
            ("2026-11-27T12:34:56.5Z x", "1795782896.5|x"),
            ("2026-11-27T13:34:56+0100 x", "1795782896.0|x"),
            ("2026-11-27T07:04:56-05:30 x", "1795782896.0|x"),
            ("27.11.2026 12:34:56 x", "1795782896.0|x"),
            ("2026/11/27 12:34:56.000123456  length=8", "1795782896.000123456|length=8"),
            ("11/12/2026 02:34:56.5 PM [TX]", "52496.5|[TX]"),
            ("12:48:40:433 - 1E", "46120.433|- 1E"),
            ("[12:00:01][D]", "43201.0|[D]"),
            ("(12.5) x", "12.5|x"),
            ("0.000 TX", "0.0|TX"),
            ("12.5 ms TX", "0.0125|TX"),
            ("1234ms TX", "1.234|TX"),
            ("Nov 27 00:00:01 host", "28512001.0|host"),
        ] {
            let (time, rest) = split_time(text).unwrap_or_else(|| panic!("{text}"));
            assert_eq!(format!("{time}|{rest}"), expected, "{text}");
        }
        let none = ["01:03:00:00:01", "12 TX", "[8] 01", "25:00:00", "1.2.3 x", "01.03.00", "0.5x"];
        none.iter().for_each(|text| assert_eq!(split_time(text), None, "{text}"));
    }
}
