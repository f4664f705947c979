//! Dates of capture files. They contain no time zone, so they are read and written as UTC.

use crate::timestamp::Timestamp;

const DAY_S: i64 = 86_400;
/// Days from 1899-12-30, where PEAK's days begin, to 1970-01-01.
const OLE_EPOCH_DAYS: f64 = 25_569.0;
/// English names of months and, where they differ, German ones, as Vector's tools write them.
const MONTHS: [(&str, u8); 17] = [
    ("jan", 1),
    ("feb", 2),
    ("mar", 3),
    ("mär", 3),
    ("mrz", 3),
    ("apr", 4),
    ("may", 5),
    ("mai", 5),
    ("jun", 6),
    ("jul", 7),
    ("aug", 8),
    ("sep", 9),
    ("oct", 10),
    ("okt", 10),
    ("nov", 11),
    ("dec", 12),
    ("dez", 12),
];

/// Days from 1970-01-01 to a day of the Gregorian calendar. Months count from March, so that the
/// day that a leap year adds is a year's last.
fn days_since_epoch(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let month = (month + 9) % 12;
    let before = year * 365 + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400);
    before + (month * 306 + 5) / 10 + day - 1 - 719_468
}

/// A moment; `None` before 1970, or where a number is out of its range.
pub(crate) fn from_calendar(date: [u16; 3], time: [u16; 3], ns: u32) -> Option<Timestamp> {
    let ([year, month, day], [hour, minute, second]) = (date.map(i64::from), time.map(i64::from));
    let ranges = [(month, 1..=12), (day, 1..=31), (hour, 0..=23), (minute, 0..=59)];
    if ranges.iter().any(|(value, range)| !range.contains(value)) || second > 60 {
        return None;
    }
    let seconds = days_since_epoch(year, month, day) * DAY_S + hour * 3600 + minute * 60 + second;
    let seconds = u64::try_from(seconds).ok()?;
    Some(Timestamp(seconds.checked_mul(1_000_000_000)? + u64::from(ns)))
}

/// A moment as people write it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct CalendarTime {
    /// Year, month, day.
    pub(crate) date: [u16; 3],
    /// Hour, minute, second.
    pub(crate) time: [u16; 3],
    pub(crate) ms: u16,
    /// From Sunday, 0.
    pub(crate) weekday: u16,
}

/// The moment of a time stamp, in UTC.
pub(crate) fn to_calendar(stamp: Timestamp) -> CalendarTime {
    let (seconds, ns) = (stamp.0 / 1_000_000_000, stamp.0 % 1_000_000_000);
    let (since, second) = ((seconds / DAY_S as u64) as i64, seconds % DAY_S as u64);
    // The year's first guess is late by no more than one.
    let mut year = 1970 + since / 365;
    while days_since_epoch(year, 1, 1) > since {
        year -= 1;
    }
    let month =
        (1..=12).rev().find(|month| days_since_epoch(year, *month, 1) <= since).unwrap_or(1);
    let day = since - days_since_epoch(year, month, 1) + 1;
    CalendarTime {
        date: [year, month, day].map(|n| n as u16),
        time: [second / 3600, second / 60 % 60, second % 60].map(|n| n as u16),
        ms: (ns / 1_000_000) as u16,
        weekday: ((since + 4) % 7) as u16,
    }
}

/// Days since 1899-12-30 as PEAK's files have them.
pub(crate) fn to_ole_days(stamp: Timestamp) -> f64 {
    stamp.0 as f64 / 1e9 / DAY_S as f64 + OLE_EPOCH_DAYS
}

/// Days since 1899-12-30, as PEAK's files have them.
pub(crate) fn from_ole_days(days: f64) -> Option<Timestamp> {
    let since = (days - OLE_EPOCH_DAYS) * DAY_S as f64;
    // A double holds such a day to about a microsecond.
    let micros = (since * 1e6).round();
    (0.0..9.2e15).contains(&micros).then(|| Timestamp(micros as u64 * 1000))
}

/// `Sat Sep 30 10:06:13.191 pm 2017`, the weekday, the decimals and am or pm may be missing.
pub(crate) fn parse_verbose(text: &str) -> Option<Timestamp> {
    let lower = text.to_lowercase();
    let (mut month, mut day, mut year, mut clock, mut pm) = (None, None, None, None, None);
    for word in lower.split_ascii_whitespace() {
        let named = MONTHS.iter().find(|(name, _)| word.starts_with(name)).map(|(_, n)| *n);
        match word {
            "am" => pm = Some(false),
            "pm" => pm = Some(true),
            _ if word.contains(':') => clock = Some(word),
            _ if month.is_none() && named.is_some() => month = named,
            _ => match word.trim_end_matches(['.', ',']).parse::<u16>() {
                Ok(number) if number > 31 => year = Some(number),
                Ok(number) => day = Some(number),
                Err(_) => {}
            },
        }
    }
    let mut parts = clock?.split([':', '.', ',']);
    let mut next = || parts.next()?.parse::<u16>().ok();
    let (hour, minute, second) = (next()?, next()?, next().unwrap_or(0));
    let fraction = clock?.split_once(['.', ',']).map_or("", |(_, digits)| digits);
    let ns = fraction.bytes().chain(std::iter::repeat(b'0')).take(9);
    let ns = ns.fold(0, |sum, digit| sum * 10 + u32::from(digit.wrapping_sub(b'0').min(9)));
    let hour = match pm {
        Some(true) if hour < 12 => hour + 12,
        Some(false) if hour == 12 => 0,
        _ => hour,
    };
    from_calendar([year?, u16::from(month?), day?], [hour, minute, second], ns)
}

/// `2026-11-21 20:15:00 UTC`.
pub(crate) fn format_utc(stamp: Timestamp) -> String {
    let CalendarTime { date: [year, month, day], time: [hour, minute, second], .. } =
        to_calendar(stamp);
    format!("{year}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC")
}

/// `2026-11-21 20:15:00.5`, also with a T between, a Z behind, or without the clock.
pub(crate) fn parse_iso(text: &str) -> Option<Timestamp> {
    let text = text.trim().trim_end_matches('Z');
    let (day, clock) = text.split_once([' ', 'T']).unwrap_or((text, "0:0"));
    let (clock, fraction) = clock.split_once('.').unwrap_or((clock, ""));
    let ns = format!("{fraction:0<9}").get(..9)?.parse().ok()?;
    from_calendar(parse_three(day, '-')?, parse_three(clock, ':')?, ns)
}

fn parse_three(text: &str, sign: char) -> Option<[u16; 3]> {
    let mut parts = text.split(sign).map(str::parse::<u16>);
    let parts = [parts.next()?.ok()?, parts.next()?.ok()?, parts.next().unwrap_or(Ok(0)).ok()?];
    Some(parts)
}

#[cfg(test)]
mod tests {
    use super::{from_calendar, from_ole_days, parse_iso, parse_verbose, to_calendar, to_ole_days};
    use crate::timestamp::Timestamp;

    #[test]
    fn dates() {
        let at = |seconds: u64, ms: u64| Some(Timestamp(seconds * 1_000_000_000 + ms * 1_000_000));
        assert_eq!(parse_verbose("Sat Sep 30 15:06:13.191 2017"), at(1_506_783_973, 191));
        assert_eq!(parse_verbose("Sam Sep 30 03:06:13.191 pm 2017"), at(1_506_783_973, 191));
        assert_eq!(parse_verbose("Don Okt 26 12:00:00 am 2023"), at(1_698_278_400, 0));
        assert_eq!(parse_verbose("Thu Feb 29 00:00:00.000 2024"), at(1_709_164_800, 0));
        assert_eq!(parse_verbose("whenever"), None);
        assert_eq!(parse_iso("2017-09-30 15:06:13.191"), at(1_506_783_973, 191));
        assert_eq!(parse_iso("2017-09-30T15:06:13.191Z"), at(1_506_783_973, 191));
        assert_eq!(parse_iso("2024-02-29"), at(1_709_164_800, 0));
        assert_eq!(parse_iso("2017-13-30 15:06:13"), None);
        assert_eq!(from_ole_days(25_569.5), at(43_200, 0));
        assert_eq!(from_ole_days(-1.0), None);
        assert_eq!(
            from_ole_days(to_ole_days(Timestamp(1_506_783_973_191_000_000))),
            at(1_506_783_973, 191)
        );
    }

    #[test]
    fn moments_there_and_back() {
        for seconds in (0..4_102_444_800).step_by(86_400 * 13 + 4_321) {
            let stamp = Timestamp(seconds * 1_000_000_000 + 7_000_000);
            let there = to_calendar(stamp);
            assert_eq!(
                from_calendar(there.date, there.time, u32::from(there.ms) * 1_000_000),
                Some(stamp)
            );
        }
        assert_eq!(to_calendar(Timestamp(1_506_783_973_000_000_000)).weekday, 6, "a Saturday");
    }
}
