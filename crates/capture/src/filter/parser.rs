//! Parses a filter: `or` of `and` of `not` of tests.

use super::fixed_point::{self, NumberRanges};
use super::token::{FilterToken, TokenKind, tokenize};
use super::{FilterError, FilterTest, Glob, NoticeTest, ValuePattern, WordPattern};
use crate::date;
use crate::decoder::DecodedFrame;
use crate::rules::nearest_word;
use crate::session::{AnomalyKind, ExchangeOutcome};
use polepair_core::explain::Direction;
use polepair_core::proto;

/// Parentheses and `not` within each other.
const DEPTH_MAX: u32 = 64;

/// Subjects of tests of every frame.
const SUBJECTS: [&str; 24] = [
    "protocol",
    "link",
    "axis",
    "kind",
    "id",
    "direction",
    "time",
    "clock",
    "number",
    "length",
    "bytes",
    "text",
    "error",
    "latency",
    "retries",
    "op",
    "ok",
    "echo",
    "stray",
    "remote",
    "extended",
    "odd",
    "fault",
    "signal",
];
/// Further ones that begin a test.
const NOTICES: [&str; 3] = ["change", "exchange", "not"];
/// Fields that dissectors find. Others are named with `field.` before them.
#[rustfmt::skip]
const FIELDS: &[&str] = &[
    "abort", "absolute_deg", "ack", "address", "amp", "arrived", "as_float", "as_integer", "bit",
    "bits", "broadcast", "byte_count", "checksum", "class", "code", "coil", "command",
    "controlword", "count", "counter", "counts", "crc", "data", "days", "deg", "delay_ms",
    "driver_c", "end", "everybody", "exception", "firmware", "flags", "forward_deg", "frame",
    "frames", "function", "group", "groups", "halt", "host", "index", "internal", "interval_ms",
    "last", "lrc", "memory", "mode", "motor", "motor_c", "ms", "next", "node", "object", "opcode",
    "own", "page", "period", "polarity", "position", "refused", "register", "relative_deg",
    "report", "request", "reserved", "reverse_deg", "rpm", "segment", "segments", "sender",
    "size", "speed", "start", "state", "status", "statusword", "store", "sub", "sub_command",
    "sum", "sync", "table", "threshold", "tml", "toggle", "type", "unused", "value", "values",
    "variable", "velocity", "vendor", "version", "volt", "warning", "word",
];

const OUTCOMES: [ExchangeOutcome; 6] = [
    ExchangeOutcome::Done,
    ExchangeOutcome::Refused,
    ExchangeOutcome::Unknown,
    ExchangeOutcome::Late,
    ExchangeOutcome::Unanswered,
    ExchangeOutcome::BadCheck,
];

type FilterResult<T> = core::result::Result<T, FilterError>;

/// Reads a filter.
pub(super) fn parse_filter(text: &str) -> FilterResult<FilterTest> {
    let mut parser = Parser { text, tokens: tokenize(text)?, position: 0, depth: 0 };
    let test = parser.parse_or()?;
    match parser.peek().kind {
        TokenKind::End => Ok(test),
        _ => Err(parser.expected_here("expected and, or, or the end")),
    }
}

struct Parser<'t> {
    text: &'t str,
    tokens: Vec<FilterToken>,
    position: usize,
    depth: u32,
}

/// Operator of a comparison.
#[derive(Clone, Copy, PartialEq, Eq)]
enum CompareOperator {
    Equal,
    Unequal,
    Less,
    AtMost,
    More,
    AtLeast,
    Contains,
    In,
}

impl Parser<'_> {
    fn parse_or(&mut self) -> FilterResult<FilterTest> {
        let mut tests = vec![self.parse_and()?];
        while self.accept("or", "||") {
            tests.push(self.parse_and()?);
        }
        Ok(if tests.len() == 1 { tests.remove(0) } else { FilterTest::Any(tests) })
    }

    fn parse_and(&mut self) -> FilterResult<FilterTest> {
        let mut tests = vec![self.parse_not()?];
        while self.accept("and", "&&") {
            tests.push(self.parse_not()?);
        }
        Ok(if tests.len() == 1 { tests.remove(0) } else { FilterTest::All(tests) })
    }

    fn parse_not(&mut self) -> FilterResult<FilterTest> {
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return Err(self.expected_here("this is nested too deeply"));
        }
        let test = if self.accept("not", "!") {
            FilterTest::Not(Box::new(self.parse_not()?))
        } else if self.accept("(", "(") {
            let test = self.parse_or()?;
            if !self.accept(")", ")") {
                return Err(self.expected_here("expected and, or, or )"));
            }
            test
        } else {
            self.parse_test()?
        };
        self.depth -= 1;
        Ok(test)
    }

    fn parse_test(&mut self) -> FilterResult<FilterTest> {
        const WANTED: &str = "expected a test: axis = 2, not ok, odd, \"text\"";
        let token = self.next_token();
        match &token.kind {
            TokenKind::Quoted(text) => Ok(FilterTest::Text(containing(text))),
            TokenKind::Word(word) if word.eq_ignore_ascii_case("object") => self.parse_object(),
            TokenKind::Word(word) => match self.parse_notice_test(word)? {
                Some(test) => Ok(test),
                None => match flag_test(word) {
                    Some(flag) => Ok(FilterTest::Flag(flag)),
                    None => self.parse_comparison(word, &token),
                },
            },
            _ => Err(self.error_at(&token, WANTED)),
        }
    }

    /// `object 0x6041:0`, and what its raw value is compared with.
    fn parse_object(&mut self) -> FilterResult<FilterTest> {
        const WANTED: &str =
            "expected an address: 0x6041:0, \"R 51\", \"AP 6\", @0x0228, \"SP 12\"";
        let token = self.peek().clone();
        let text = self.parse_word(WANTED)?;
        let all = proto::dissectors().iter();
        let known = all.filter_map(|one| Some((one.name(), one.parse_address(&text)?.ok()?)));
        let addresses: Vec<_> = known.collect();
        if addresses.is_empty() {
            return Err(self.error_at(&token, WANTED));
        }
        match self.accept_operator() {
            None => Ok(FilterTest::Object(addresses, None)),
            Some(how) => self.parse_numbers(how, false, |values| {
                FilterTest::Object(addresses.clone(), Some(values))
            }),
        }
    }

    /// A test of a notice.
    fn parse_notice_test(&mut self, word: &str) -> FilterResult<Option<FilterTest>> {
        let notice_test = match word {
            "odd" => NoticeTest::Anomaly(self.parse_anomaly_kinds()?),
            "fault" => match self.accept_operator() {
                None => NoticeTest::Fault(None),
                Some(how) => {
                    return self
                        .parse_value(how, |e| FilterTest::Notice(NoticeTest::Fault(Some(e))))
                        .map(Some);
                }
            },
            "signal" => {
                let glob =
                    self.parse_word("expected a signal's name: Actual/Position, */Setpoint/*")?;
                match self.accept_operator() {
                    None => NoticeTest::Signal(Glob::new(&glob), None),
                    Some(how) => {
                        let test =
                            |v| FilterTest::Notice(NoticeTest::Signal(Glob::new(&glob), Some(v)));
                        return self.parse_numbers(how, false, test).map(Some);
                    }
                }
            }
            "change" => {
                let what = self.accept_word().map(|word| Glob::new(&word));
                match self.accept_operator() {
                    None => NoticeTest::Change(what, None),
                    Some(how) => {
                        let test =
                            |w| FilterTest::Notice(NoticeTest::Change(what.clone(), Some(w)));
                        return self.parse_words(how, test).map(Some);
                    }
                }
            }
            "exchange" => NoticeTest::Exchange(self.parse_outcome()?),
            _ => return Ok(None),
        };
        Ok(Some(FilterTest::Notice(notice_test)))
    }

    fn parse_anomaly_kinds(&mut self) -> FilterResult<Vec<AnomalyKind>> {
        let listed = self.accept("in", "in");
        let open = listed && self.accept("(", "(");
        let mut kinds = Vec::new();
        loop {
            let token = self.peek().clone();
            let Some(word) = self.accept_word() else { break };
            let kind = AnomalyKind::ALL.iter().find(|kind| kind.as_str() == word);
            let known = AnomalyKind::ALL.iter().map(|kind| kind.as_str());
            kinds.push(*kind.ok_or_else(|| {
                self.unknown_word(
                    &token,
                    "no such oddity; docs/reference/filter.md lists them",
                    known,
                )
            })?);
            if !(listed && self.accept(",", ",")) {
                break;
            }
        }
        if open && !self.accept(")", ")") {
            return Err(self.expected_here("expected , or )"));
        }
        Ok(kinds)
    }

    fn parse_outcome(&mut self) -> FilterResult<Option<WordPattern>> {
        let token = self.peek().clone();
        let Some(word) = self.accept_word() else { return Ok(None) };
        let mut known = OUTCOMES.iter().map(|outcome| outcome.as_str());
        if known.clone().any(|outcome| outcome == word) {
            return Ok(Some(equal_to(&word)));
        }
        let list = known.by_ref().collect::<Vec<_>>();
        let what = format!("expected {}", list.join(", "));
        Err(self.unknown_word(&token, &what, list))
    }

    /// A comparison of something that every frame has.
    fn parse_comparison(&mut self, word: &str, token: &FilterToken) -> FilterResult<FilterTest> {
        let field =
            word.strip_prefix("field.").or_else(|| FIELDS.iter().find(|f| **f == word).copied());
        let known = SUBJECTS.contains(&word);
        if !known && field.is_none() {
            let words = SUBJECTS.iter().chain(&NOTICES).chain(FIELDS).copied();
            let what = "no such word; field.NAME names a field of any name";
            return Err(self.unknown_word(token, what, words));
        }
        let how = self
            .accept_operator()
            .ok_or_else(|| self.expected_here("expected =, !=, <, <=, >, >=, ~ or in"))?;
        match word {
            _ if !known => {
                let name = field.unwrap_or(word).to_owned();
                self.parse_value(how, |either| FilterTest::Field(name.clone(), either))
            }
            "protocol" => self.parse_words(how, |w| FilterTest::Word(|e| e.protocol_name(), w)),
            "direction" => self.parse_direction(how),
            "link" => self.parse_words(how, FilterTest::Link),
            "kind" => self.parse_words(how, FilterTest::Kind),
            "text" => self.parse_words(how, FilterTest::Text),
            "error" => self.parse_words(how, FilterTest::Error),
            "op" => self.parse_words(how, |words| FilterTest::Notice(NoticeTest::Op(words))),
            "bytes" => self.parse_bytes(how),
            "time" => self.parse_numbers(how, true, FilterTest::Time),
            "clock" => self.parse_numbers(how, true, |v| {
                FilterTest::Number(|e| e.time.map(|time| i128::from(time.0)), v)
            }),
            "latency" => {
                self.parse_numbers(how, true, |v| FilterTest::Notice(NoticeTest::Latency(v)))
            }
            "retries" => {
                self.parse_numbers(how, false, |v| FilterTest::Notice(NoticeTest::Retries(v)))
            }
            "axis" => self.parse_numbers(how, false, |v| {
                FilterTest::Number(|e| e.explanation.axis.map(fixed_point::from_integer), v)
            }),
            "id" => self.parse_numbers(how, false, |v| {
                FilterTest::Number(|e| e.id.map(fixed_point::from_integer), v)
            }),
            "number" => self.parse_numbers(how, false, |v| {
                FilterTest::Number(|e| Some(fixed_point::from_integer(e.number)), v)
            }),
            _ => self.parse_numbers(how, false, |v| {
                FilterTest::Number(|e| Some(fixed_point::from_integer(e.bytes.len() as u64)), v)
            }),
        }
    }

    fn parse_direction(&mut self, how: CompareOperator) -> FilterResult<FilterTest> {
        const KNOWN: [&str; 3] = ["tx", "rx", "none"];
        let token = self.peek().clone();
        let test = self.parse_words(how, |words| FilterTest::Word(direction_word, words))?;
        match &token.kind {
            TokenKind::Word(word) if !KNOWN.contains(&word.as_str()) => {
                Err(self.unknown_word(&token, "expected tx, rx or none", KNOWN))
            }
            _ => Ok(test),
        }
    }

    fn parse_bytes(&mut self, how: CompareOperator) -> FilterResult<FilterTest> {
        let token = self.next_token();
        let text = match &token.kind {
            TokenKind::Word(text) | TokenKind::Quoted(text) if how == CompareOperator::Contains => {
                text
            }
            _ => return Err(self.error_at(&token, "expected ~ and bytes: bytes ~ \"40 64 60\"")),
        };
        let digits: Option<Vec<u8>> = text
            .chars()
            .filter(|c| !c.is_whitespace())
            .map(|c| c.to_digit(16).map(|d| d as u8))
            .collect();
        match digits.filter(|digits| digits.len().is_multiple_of(2)) {
            Some(digits) => {
                Ok(FilterTest::Bytes(digits.chunks(2).map(|d| d[0] << 4 | d[1]).collect()))
            }
            None => Err(self.error_at(&token, "expected two hexadecimal digits a byte")),
        }
    }

    fn parse_words(
        &mut self,
        how: CompareOperator,
        test: impl Fn(WordPattern) -> FilterTest,
    ) -> FilterResult<FilterTest> {
        let what = "words are compared with =, !=, ~ or in";
        if !matches!(
            how,
            CompareOperator::Equal
                | CompareOperator::Unequal
                | CompareOperator::Contains
                | CompareOperator::In
        ) {
            let token = self.tokens[self.position - 1].clone();
            return Err(self.error_at(&token, what));
        }
        let values = self.parse_values(how, |parser, token| match &token.kind {
            TokenKind::Word(word) | TokenKind::Quoted(word) => Ok(word.clone()),
            _ => Err(parser.error_at(token, "expected a word, or text in quotes")),
        })?;
        let mut words = WordPattern::default();
        match how {
            CompareOperator::Contains => words.substrings = values,
            _ => words.globs = values.iter().map(|value| Glob::new(value)).collect(),
        }
        Ok(negate_unequal(how, test(words)))
    }

    fn parse_numbers(
        &mut self,
        how: CompareOperator,
        timed: bool,
        test: impl Fn(NumberRanges) -> FilterTest,
    ) -> FilterResult<FilterTest> {
        if how == CompareOperator::Contains {
            let token = self.tokens[self.position - 1].clone();
            return Err(
                self.error_at(&token, "numbers are compared with =, !=, <, <=, >, >= or in")
            );
        }
        let ranges = self.parse_values(how, |parser, token| parser.parse_range(token, timed))?;
        Ok(negate_unequal(how, test(to_ranges(how, ranges))))
    }

    /// Numbers, or words in the place of a number.
    fn parse_value(
        &mut self,
        how: CompareOperator,
        test: impl Fn(ValuePattern) -> FilterTest,
    ) -> FilterResult<FilterTest> {
        let open = usize::from(self.peek().kind == TokenKind::Sign("("));
        let first = &self.tokens[(self.position + open).min(self.tokens.len() - 1)];
        if how != CompareOperator::Contains
            && (is_number_token(first) || first.kind == TokenKind::Sign(".."))
        {
            let words = WordPattern::default();
            self.parse_numbers(how, false, |numbers| {
                test(ValuePattern { numbers, words: words.clone() })
            })
        } else {
            self.parse_words(how, |words| {
                test(ValuePattern { words, numbers: NumberRanges::default() })
            })
        }
    }

    /// One value, or with `in` several.
    fn parse_values<T>(
        &mut self,
        how: CompareOperator,
        read: impl Fn(&mut Self, &FilterToken) -> FilterResult<T>,
    ) -> FilterResult<Vec<T>> {
        let open = how == CompareOperator::In && self.accept("(", "(");
        let mut values = Vec::new();
        loop {
            let token = self.next_token();
            values.push(read(self, &token)?);
            if !(how == CompareOperator::In && self.accept(",", ",")) {
                break;
            }
        }
        if open && !self.accept(")", ")") {
            return Err(self.expected_here("expected , or )"));
        }
        Ok(values)
    }

    /// `5`, `3..5`, `..5`, `3..`.
    fn parse_range(&mut self, token: &FilterToken, timed: bool) -> FilterResult<(i128, i128)> {
        if token.kind == TokenKind::Sign("..") {
            let next = self.next_token();
            return Ok((i128::MIN, self.parse_number(&next, timed)?));
        }
        let least = self.parse_number(token, timed)?;
        if !self.accept("..", "..") {
            return Ok((least, least));
        }
        let ends = match &self.peek().kind {
            TokenKind::Word(word) => fixed_point::parse(word).is_none() && is_connective(word),
            TokenKind::Quoted(_) => false,
            _ => true,
        };
        if ends {
            return Ok((least, i128::MAX));
        }
        let next = self.next_token();
        Ok((least, self.parse_number(&next, timed)?))
    }

    fn parse_number(&self, token: &FilterToken, timed: bool) -> FilterResult<i128> {
        let what = match (timed, &token.kind) {
            (true, TokenKind::Quoted(text)) => match date::parse_iso(text) {
                Some(stamp) => return Ok(i128::from(stamp.0)),
                None => "expected seconds, or a time such as \"2026-11-21 20:15:00.5\" (UTC)",
            },
            (_, TokenKind::Word(word)) => match fixed_point::parse(word) {
                Some((number, unit)) if timed || !unit => return Ok(number),
                Some(_) => "this number has no unit of time",
                None if timed => "expected a time: 1.5, 20ms, 2min",
                None => "expected a number; hexadecimal ones begin with 0x",
            },
            _ => "expected a number",
        };
        Err(self.error_at(token, what))
    }

    fn accept_operator(&mut self) -> Option<CompareOperator> {
        let how = match &self.peek().kind {
            TokenKind::Sign("=" | "==") => CompareOperator::Equal,
            TokenKind::Sign("!=") => CompareOperator::Unequal,
            TokenKind::Sign("<") => CompareOperator::Less,
            TokenKind::Sign("<=") => CompareOperator::AtMost,
            TokenKind::Sign(">") => CompareOperator::More,
            TokenKind::Sign(">=") => CompareOperator::AtLeast,
            TokenKind::Sign("~") => CompareOperator::Contains,
            TokenKind::Word(word) if word.eq_ignore_ascii_case("in") => CompareOperator::In,
            _ => return None,
        };
        self.position += 1;
        Some(how)
    }

    fn parse_word(&mut self, what: &str) -> FilterResult<String> {
        let token = self.next_token();
        match token.kind {
            TokenKind::Word(word) | TokenKind::Quoted(word) => Ok(word),
            _ => Err(self.error_at(&token, what)),
        }
    }

    /// The next word, unless it joins tests.
    fn accept_word(&mut self) -> Option<String> {
        let word = match &self.peek().kind {
            TokenKind::Word(word) if !is_connective(word) => word.clone(),
            TokenKind::Quoted(word) => word.clone(),
            _ => return None,
        };
        self.position += 1;
        Some(word)
    }

    fn accept(&mut self, word: &str, sign: &str) -> bool {
        let found = match &self.peek().kind {
            TokenKind::Word(found) => found.eq_ignore_ascii_case(word),
            TokenKind::Sign(found) => *found == sign,
            _ => false,
        };
        self.position += usize::from(found);
        found
    }

    fn peek(&self) -> &FilterToken {
        &self.tokens[self.position]
    }

    fn next_token(&mut self) -> FilterToken {
        let token = self.peek().clone();
        self.position = (self.position + 1).min(self.tokens.len() - 1);
        token
    }

    fn expected_here(&self, what: &str) -> FilterError {
        self.error_at(self.peek(), what)
    }

    fn error_at(&self, token: &FilterToken, what: &str) -> FilterError {
        let (at, len) = (token.position, token.len);
        FilterError {
            text: self.text.to_owned(),
            position: at,
            len,
            message: what.to_owned(),
            nearest: None,
        }
    }

    fn unknown_word<'w>(
        &self,
        token: &FilterToken,
        what: &str,
        known: impl IntoIterator<Item = &'w str>,
    ) -> FilterError {
        let near = match &token.kind {
            TokenKind::Word(word) | TokenKind::Quoted(word) => nearest_word(word, known),
            _ => None,
        };
        FilterError { nearest: near.map(str::to_owned), ..self.error_at(token, what) }
    }
}

fn is_number_token(token: &FilterToken) -> bool {
    matches!(&token.kind, TokenKind::Word(w) if fixed_point::parse(w).is_some())
}

fn is_connective(word: &str) -> bool {
    ["and", "or", "not", "in"].iter().any(|joint| word.eq_ignore_ascii_case(joint))
}

fn flag_test(word: &str) -> Option<fn(&DecodedFrame<'_>) -> bool> {
    Some(match word {
        "ok" => |event| event.defect.is_none(),
        "echo" => |event| event.echo,
        "stray" => |event| event.stray,
        "remote" => |event| event.remote,
        "extended" => |event| event.extended,
        _ => return None,
    })
}

fn direction_word(event: &DecodedFrame<'_>) -> &'static str {
    match event.direction {
        Some(Direction::ToDrive) => "tx",
        Some(Direction::ToHost) => "rx",
        None => "none",
    }
}

fn equal_to(word: &str) -> WordPattern {
    WordPattern { globs: vec![Glob::new(word)], substrings: Vec::new() }
}

fn containing(text: &str) -> WordPattern {
    WordPattern { globs: Vec::new(), substrings: vec![text.to_owned()] }
}

fn negate_unequal(how: CompareOperator, test: FilterTest) -> FilterTest {
    if how == CompareOperator::Unequal { FilterTest::Not(Box::new(test)) } else { test }
}

fn to_ranges(how: CompareOperator, ranges: Vec<(i128, i128)>) -> NumberRanges {
    let (least, most) = ranges[0];
    match how {
        CompareOperator::Less => NumberRanges::single(i128::MIN, least.saturating_sub(1)),
        CompareOperator::AtMost => NumberRanges::single(i128::MIN, most),
        CompareOperator::More => NumberRanges::single(most.saturating_add(1), i128::MAX),
        CompareOperator::AtLeast => NumberRanges::single(least, i128::MAX),
        _ => NumberRanges(ranges),
    }
}
