//! Reads a filter: `or` of `and` of `not` of tests.

use super::fixed::{self, Within};
use super::token::{Is, Token, tokens};
use super::{Either, FilterError, Glob, Test, Told, Words};
use crate::date;
use crate::decoder::Event;
use crate::rules::nearest;
use crate::session::{Oddity, Outcome};
use polepair_core::explain::Direction;

/// Parentheses and `not` within each other.
const DEPTH_MAX: u32 = 64;

/// What can be asked of every frame.
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

const OUTCOMES: [Outcome; 6] = [
    Outcome::Done,
    Outcome::Refused,
    Outcome::Unknown,
    Outcome::Late,
    Outcome::Unanswered,
    Outcome::Broken,
];

type Result<T> = core::result::Result<T, FilterError>;

/// Reads a filter.
pub(super) fn filter(text: &str) -> Result<Test> {
    let mut parser = Parser { text, tokens: tokens(text)?, at: 0, depth: 0 };
    let test = parser.any()?;
    match parser.peek().is {
        Is::End => Ok(test),
        _ => Err(parser.expected("expected and, or, or the end")),
    }
}

struct Parser<'t> {
    text: &'t str,
    tokens: Vec<Token>,
    at: usize,
    depth: u32,
}

/// How a value is compared.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Compared {
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
    fn any(&mut self) -> Result<Test> {
        let mut tests = vec![self.all()?];
        while self.takes("or", "||") {
            tests.push(self.all()?);
        }
        Ok(if tests.len() == 1 { tests.remove(0) } else { Test::Any(tests) })
    }

    fn all(&mut self) -> Result<Test> {
        let mut tests = vec![self.not()?];
        while self.takes("and", "&&") {
            tests.push(self.not()?);
        }
        Ok(if tests.len() == 1 { tests.remove(0) } else { Test::All(tests) })
    }

    fn not(&mut self) -> Result<Test> {
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return Err(self.expected("this is nested too deeply"));
        }
        let test = if self.takes("not", "!") {
            Test::Not(Box::new(self.not()?))
        } else if self.takes("(", "(") {
            let test = self.any()?;
            if !self.takes(")", ")") {
                return Err(self.expected("expected and, or, or )"));
            }
            test
        } else {
            self.test()?
        };
        self.depth -= 1;
        Ok(test)
    }

    fn test(&mut self) -> Result<Test> {
        const WANTED: &str = "expected a test: axis = 2, not ok, odd, \"text\"";
        let token = self.next();
        match &token.is {
            Is::Quoted(text) => Ok(Test::Text(within(text))),
            Is::Word(word) => match self.notice(word)? {
                Some(told) => Ok(told),
                None => match flag(word) {
                    Some(flag) => Ok(Test::Flag(flag)),
                    None => self.compared(word, &token),
                },
            },
            _ => Err(self.wrong(&token, WANTED)),
        }
    }

    /// A test of what a conversation tells.
    fn notice(&mut self, word: &str) -> Result<Option<Test>> {
        let told = match word {
            "odd" => Told::Odd(self.oddities()?),
            "fault" => match self.operator() {
                None => Told::Fault(None),
                Some(how) => {
                    return self.either(how, |e| Test::Told(Told::Fault(Some(e)))).map(Some);
                }
            },
            "signal" => {
                let glob = self.word("expected a signal's name: Actual/Position, */Setpoint/*")?;
                match self.operator() {
                    None => Told::Signal(Glob::new(&glob), None),
                    Some(how) => {
                        let test = |v| Test::Told(Told::Signal(Glob::new(&glob), Some(v)));
                        return self.numbers(how, false, test).map(Some);
                    }
                }
            }
            "change" => {
                let what = self.plain_word().map(|word| Glob::new(&word));
                match self.operator() {
                    None => Told::Change(what, None),
                    Some(how) => {
                        let test = |w| Test::Told(Told::Change(what.clone(), Some(w)));
                        return self.words(how, test).map(Some);
                    }
                }
            }
            "exchange" => Told::Exchange(self.outcome()?),
            _ => return Ok(None),
        };
        Ok(Some(Test::Told(told)))
    }

    fn oddities(&mut self) -> Result<Vec<Oddity>> {
        let listed = self.takes("in", "in");
        let open = listed && self.takes("(", "(");
        let mut kinds = Vec::new();
        loop {
            let token = self.peek().clone();
            let Some(word) = self.plain_word() else { break };
            let kind = Oddity::ALL.iter().find(|kind| kind.word() == word);
            let known = Oddity::ALL.iter().map(|kind| kind.word());
            kinds.push(*kind.ok_or_else(|| {
                self.unknown(&token, "no such oddity; docs/reference/filter.md lists them", known)
            })?);
            if !(listed && self.takes(",", ",")) {
                break;
            }
        }
        if open && !self.takes(")", ")") {
            return Err(self.expected("expected , or )"));
        }
        Ok(kinds)
    }

    fn outcome(&mut self) -> Result<Option<Words>> {
        let token = self.peek().clone();
        let Some(word) = self.plain_word() else { return Ok(None) };
        let mut known = OUTCOMES.iter().map(|outcome| outcome.word());
        if known.clone().any(|outcome| outcome == word) {
            return Ok(Some(equal(&word)));
        }
        let list = known.by_ref().collect::<Vec<_>>();
        let what = format!("expected {}", list.join(", "));
        Err(self.unknown(&token, &what, list))
    }

    /// A comparison of something that every frame has.
    fn compared(&mut self, word: &str, token: &Token) -> Result<Test> {
        let field =
            word.strip_prefix("field.").or_else(|| FIELDS.iter().find(|f| **f == word).copied());
        let known = SUBJECTS.contains(&word);
        if !known && field.is_none() {
            let words = SUBJECTS.iter().chain(&NOTICES).chain(FIELDS).copied();
            let what = "no such word; field.NAME names a field of any name";
            return Err(self.unknown(token, what, words));
        }
        let how = self
            .operator()
            .ok_or_else(|| self.expected("expected =, !=, <, <=, >, >=, ~ or in"))?;
        match word {
            _ if !known => {
                let name = field.unwrap_or(word).to_owned();
                self.either(how, |either| Test::Field(name.clone(), either))
            }
            "protocol" => self.words(how, |w| Test::Word(|e| e.protocol.unwrap_or(""), w)),
            "direction" => self.direction(how),
            "link" => self.words(how, Test::Link),
            "kind" => self.words(how, Test::Kind),
            "text" => self.words(how, Test::Text),
            "error" => self.words(how, Test::Error),
            "op" => self.words(how, |words| Test::Told(Told::Op(words))),
            "bytes" => self.bytes(how),
            "time" => self.numbers(how, true, Test::Time),
            "clock" => self
                .numbers(how, true, |v| Test::Number(|e| e.time.map(|time| i128::from(time.0)), v)),
            "latency" => self.numbers(how, true, |v| Test::Told(Told::Latency(v))),
            "retries" => self.numbers(how, false, |v| Test::Told(Told::Retries(v))),
            "axis" => self
                .numbers(how, false, |v| Test::Number(|e| e.explained.axis.map(fixed::whole), v)),
            "id" => self.numbers(how, false, |v| Test::Number(|e| e.id.map(fixed::whole), v)),
            "number" => {
                self.numbers(how, false, |v| Test::Number(|e| Some(fixed::whole(e.number)), v))
            }
            _ => self.numbers(how, false, |v| {
                Test::Number(|e| Some(fixed::whole(e.bytes.len() as u64)), v)
            }),
        }
    }

    fn direction(&mut self, how: Compared) -> Result<Test> {
        const KNOWN: [&str; 3] = ["tx", "rx", "none"];
        let token = self.peek().clone();
        let test = self.words(how, |words| Test::Word(direction, words))?;
        match &token.is {
            Is::Word(word) if !KNOWN.contains(&word.as_str()) => {
                Err(self.unknown(&token, "expected tx, rx or none", KNOWN))
            }
            _ => Ok(test),
        }
    }

    fn bytes(&mut self, how: Compared) -> Result<Test> {
        let token = self.next();
        let text = match &token.is {
            Is::Word(text) | Is::Quoted(text) if how == Compared::Contains => text,
            _ => return Err(self.wrong(&token, "expected ~ and bytes: bytes ~ \"40 64 60\"")),
        };
        let digits: Option<Vec<u8>> = text
            .chars()
            .filter(|c| !c.is_whitespace())
            .map(|c| c.to_digit(16).map(|d| d as u8))
            .collect();
        match digits.filter(|digits| digits.len().is_multiple_of(2)) {
            Some(digits) => Ok(Test::Bytes(digits.chunks(2).map(|d| d[0] << 4 | d[1]).collect())),
            None => Err(self.wrong(&token, "expected two hexadecimal digits a byte")),
        }
    }

    fn words(&mut self, how: Compared, test: impl Fn(Words) -> Test) -> Result<Test> {
        let what = "words are compared with =, !=, ~ or in";
        if !matches!(how, Compared::Equal | Compared::Unequal | Compared::Contains | Compared::In) {
            let token = self.tokens[self.at - 1].clone();
            return Err(self.wrong(&token, what));
        }
        let values = self.values(how, |parser, token| match &token.is {
            Is::Word(word) | Is::Quoted(word) => Ok(word.clone()),
            _ => Err(parser.wrong(token, "expected a word, or text in quotes")),
        })?;
        let mut words = Words::default();
        match how {
            Compared::Contains => words.within = values,
            _ => words.equal = values.iter().map(|value| Glob::new(value)).collect(),
        }
        Ok(negated(how, test(words)))
    }

    fn numbers(
        &mut self,
        how: Compared,
        timed: bool,
        test: impl Fn(Within) -> Test,
    ) -> Result<Test> {
        if how == Compared::Contains {
            let token = self.tokens[self.at - 1].clone();
            return Err(self.wrong(&token, "numbers are compared with =, !=, <, <=, >, >= or in"));
        }
        let ranges = self.values(how, |parser, token| parser.range(token, timed))?;
        Ok(negated(how, test(compare(how, ranges))))
    }

    /// Numbers, or words where no number stands.
    fn either(&mut self, how: Compared, test: impl Fn(Either) -> Test) -> Result<Test> {
        let number = |token: &Token| matches!(&token.is, Is::Word(w) if fixed::parse(w).is_some());
        let open = usize::from(self.peek().is == Is::Sign("("));
        let first = &self.tokens[(self.at + open).min(self.tokens.len() - 1)];
        if how != Compared::Contains && (number(first) || first.is == Is::Sign("..")) {
            let words = Words::default();
            self.numbers(how, false, |numbers| test(Either { numbers, words: words.clone() }))
        } else {
            self.words(how, |words| test(Either { words, numbers: Within::default() }))
        }
    }

    /// One value, or with `in` several.
    fn values<T>(
        &mut self,
        how: Compared,
        read: impl Fn(&mut Self, &Token) -> Result<T>,
    ) -> Result<Vec<T>> {
        let open = how == Compared::In && self.takes("(", "(");
        let mut values = Vec::new();
        loop {
            let token = self.next();
            values.push(read(self, &token)?);
            if !(how == Compared::In && self.takes(",", ",")) {
                break;
            }
        }
        if open && !self.takes(")", ")") {
            return Err(self.expected("expected , or )"));
        }
        Ok(values)
    }

    /// `5`, `3..5`, `..5`, `3..`.
    fn range(&mut self, token: &Token, timed: bool) -> Result<(i128, i128)> {
        if token.is == Is::Sign("..") {
            let next = self.next();
            return Ok((i128::MIN, self.number(&next, timed)?));
        }
        let least = self.number(token, timed)?;
        if !self.takes("..", "..") {
            return Ok((least, least));
        }
        let ends = match &self.peek().is {
            Is::Word(word) => fixed::parse(word).is_none() && is_joint(word),
            Is::Quoted(_) => false,
            _ => true,
        };
        if ends {
            return Ok((least, i128::MAX));
        }
        let next = self.next();
        Ok((least, self.number(&next, timed)?))
    }

    fn number(&self, token: &Token, timed: bool) -> Result<i128> {
        let what = match (timed, &token.is) {
            (true, Is::Quoted(text)) => match date::written(text) {
                Some(stamp) => return Ok(i128::from(stamp.0)),
                None => "expected seconds, or a time such as \"2026-11-21 20:15:00.5\" (UTC)",
            },
            (_, Is::Word(word)) => match fixed::parse(word) {
                Some((number, unit)) if timed || !unit => return Ok(number),
                Some(_) => "this number has no unit of time",
                None if timed => "expected a time: 1.5, 20ms, 2min",
                None => "expected a number; hexadecimal ones begin with 0x",
            },
            _ => "expected a number",
        };
        Err(self.wrong(token, what))
    }

    fn operator(&mut self) -> Option<Compared> {
        let how = match &self.peek().is {
            Is::Sign("=" | "==") => Compared::Equal,
            Is::Sign("!=") => Compared::Unequal,
            Is::Sign("<") => Compared::Less,
            Is::Sign("<=") => Compared::AtMost,
            Is::Sign(">") => Compared::More,
            Is::Sign(">=") => Compared::AtLeast,
            Is::Sign("~") => Compared::Contains,
            Is::Word(word) if word.eq_ignore_ascii_case("in") => Compared::In,
            _ => return None,
        };
        self.at += 1;
        Some(how)
    }

    fn word(&mut self, what: &str) -> Result<String> {
        let token = self.next();
        match token.is {
            Is::Word(word) | Is::Quoted(word) => Ok(word),
            _ => Err(self.wrong(&token, what)),
        }
    }

    /// The next word, unless it joins tests.
    fn plain_word(&mut self) -> Option<String> {
        let word = match &self.peek().is {
            Is::Word(word) if !is_joint(word) => word.clone(),
            Is::Quoted(word) => word.clone(),
            _ => return None,
        };
        self.at += 1;
        Some(word)
    }

    fn takes(&mut self, word: &str, sign: &str) -> bool {
        let found = match &self.peek().is {
            Is::Word(found) => found.eq_ignore_ascii_case(word),
            Is::Sign(found) => *found == sign,
            _ => false,
        };
        self.at += usize::from(found);
        found
    }

    fn peek(&self) -> &Token {
        &self.tokens[self.at]
    }

    fn next(&mut self) -> Token {
        let token = self.peek().clone();
        self.at = (self.at + 1).min(self.tokens.len() - 1);
        token
    }

    fn expected(&self, what: &str) -> FilterError {
        self.wrong(self.peek(), what)
    }

    fn wrong(&self, token: &Token, what: &str) -> FilterError {
        let (at, len) = (token.at, token.len);
        FilterError { text: self.text.to_owned(), at, len, what: what.to_owned(), nearest: None }
    }

    fn unknown<'w>(
        &self,
        token: &Token,
        what: &str,
        known: impl IntoIterator<Item = &'w str>,
    ) -> FilterError {
        let near = match &token.is {
            Is::Word(word) | Is::Quoted(word) => nearest(word, known),
            _ => None,
        };
        FilterError { nearest: near.map(str::to_owned), ..self.wrong(token, what) }
    }
}

fn is_joint(word: &str) -> bool {
    ["and", "or", "not", "in"].iter().any(|joint| word.eq_ignore_ascii_case(joint))
}

fn flag(word: &str) -> Option<fn(&Event<'_>) -> bool> {
    Some(match word {
        "ok" => |event| event.wrong.is_none(),
        "echo" => |event| event.echo,
        "stray" => |event| event.stray,
        "remote" => |event| event.remote,
        "extended" => |event| event.extended,
        _ => return None,
    })
}

fn direction(event: &Event<'_>) -> &'static str {
    match event.direction {
        Some(Direction::ToDrive) => "tx",
        Some(Direction::ToHost) => "rx",
        None => "none",
    }
}

fn equal(word: &str) -> Words {
    Words { equal: vec![Glob::new(word)], within: Vec::new() }
}

fn within(text: &str) -> Words {
    Words { equal: Vec::new(), within: vec![text.to_owned()] }
}

fn negated(how: Compared, test: Test) -> Test {
    if how == Compared::Unequal { Test::Not(Box::new(test)) } else { test }
}

fn compare(how: Compared, ranges: Vec<(i128, i128)>) -> Within {
    let (least, most) = ranges[0];
    match how {
        Compared::Less => Within::one(i128::MIN, least.saturating_sub(1)),
        Compared::AtMost => Within::one(i128::MIN, most),
        Compared::More => Within::one(most.saturating_add(1), i128::MAX),
        Compared::AtLeast => Within::one(least, i128::MAX),
        _ => Within(ranges),
    }
}
