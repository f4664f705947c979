//! The step language of profiles: one text a step.
//!
//! ```text
//! write NAME = VALUE            ensure NAME = 1              read NAME        copy NAME -> NAME
//! write together NAME = VALUE, NAME = VALUE    (neighbours, by one request)
//! write NAME & 0x10 = 0x10      (these bits; the others stay as they are)
//! require NAME & 0x10 == 0 else HINT      (also == != and `within N` for magnitudes)
//! require NAME in 1 14 else HINT          (one of these, 0 to 62)
//! require NAME > 9999 else HINT
//! skip COUNT if NAME & 0x6F == 0x27       (steps behind this one)
//! skip COUNT without NAME                 (if the drive refuses a read of it)
//! if TEST … end   unless TEST … end   with NAME … end   use FRAGMENT       (`blocks`)
//! no-fault NAME                 no-fault NAME & 0x1F
//! until NAME & 0x80 == 0x80 within 60 s   until NAME within-magnitude 5 within 5 s
//! standstill within 10 s       homed NAME & 0x1000 == 0x1000 within 60 s    (measured values decide)
//! arrival within 60 s          arrival NAME == 0 within 60 s
//! send FUNCTION INDEX VALUE [like NAME]   keep NAME        wait 50 ms
//! ```
//!
//! VALUE is a number, `{target}`, `{velocity}`, `{acceleration}`, `{deceleration}`, `{torque}`,
//! `{jerk-time}`, `{period}`; `{|velocity|}` is a magnitude. With a question mark, `{velocity?}`, the step is skipped
//! if the caller gives no value. For a drive whose ramps are set as times: `{acceleration? as time to 3000 rpm}`, or
//! `{acceleration? as time to velocity or 300 rpm}` for a ramp to the speed of the command.

use super::draft::{DraftStep, ParameterName};
use crate::spelling;
use crate::toml_file::{FileError, FileLocation, Located, parse_number};
use polepair_core::plan::{Argument, Compare, Operand, ParameterTest, RampSpeed};

/// The longest wait or limit that a step may have: a day, ms.
pub(crate) const WAIT_MS_MAX: u32 = 86_400_000;

const VERBS: [&str; 20] = [
    "write",
    "ensure",
    "read",
    "copy",
    "require",
    "skip",
    "no-fault",
    "until",
    "await",
    "standstill",
    "homed",
    "arrival",
    "send",
    "keep",
    "wait",
    "if",
    "unless",
    "with",
    "end",
    "use",
];

const ARGUMENTS: [(&str, Argument); 8] = [
    ("target", Argument::Target),
    ("velocity", Argument::Velocity),
    ("acceleration", Argument::Acceleration),
    ("deceleration", Argument::Deceleration),
    ("torque", Argument::Torque),
    ("jerk-time", Argument::JerkTime),
    ("period", Argument::Period),
    ("path", Argument::Path),
];

/// Text of an argument in a step.
pub(crate) fn argument_word(argument: Argument) -> &'static str {
    ARGUMENTS.iter().find(|(_, a)| *a == argument).map_or("", |(word, _)| word)
}

/// Reads one step.
pub(crate) fn parse(step: &Located<String>) -> Result<DraftStep, FileError> {
    // One further than the opening quote: steps hardly ever hold escapes, which would shift this.
    let whole = StepText { text: &step.value, location: step.location.shifted(1) }.trimmed();
    let (verb, rest) = whole.split_at_mark(" ").unwrap_or((whole.clone(), whole.end()));
    match verb.text {
        "write" if rest.text.starts_with("together ") => {
            parse_joint_write(&rest.split("together ".len(), 0).1)
        }
        "write" => match rest.split_at_mark(" & ") {
            Some((name, bits)) => parse_bits_write(&name, &bits),
            None => parse_assignment(&rest).and_then(|(name, value)| {
                Ok(DraftStep::Write(name, value.operand()?, value.location.clone()))
            }),
        },
        "ensure" => parse_assignment(&rest)
            .and_then(|(name, value)| Ok(DraftStep::Ensure(name, value.number()?, value.location))),
        "read" => Ok(DraftStep::Read(rest.parameter_name()?)),
        "copy" => {
            let (from, to) = rest.require_split(" -> ", "`copy NAME -> NAME`")?;
            Ok(DraftStep::Copy { from: from.parameter_name()?, to: to.parameter_name()? })
        }
        "require" => {
            let (test, hint) = rest.require_split(" else ", "`require TEST else HINT`")?;
            let (read, test) = parse_condition(&test)?;
            Ok(DraftStep::Require { read, test, hint: hint.text.to_owned() })
        }
        "skip" => {
            let fits = "a plan, which has 64 steps at most";
            if let Some((count, name)) = rest.split_at_mark(" without ") {
                return Ok(DraftStep::Without {
                    read: name.parameter_name()?,
                    count: count.number_as(fits)?,
                });
            }
            let form = "`skip COUNT if TEST`, or `skip COUNT without NAME`";
            let (count, test) = rest.require_split(" if ", form)?;
            let (read, test) = parse_condition(&test)?;
            Ok(DraftStep::Skip { read, test, count: count.number_as(fits)? })
        }
        "no-fault" => parse_masked(&rest).map(|(read, mask)| DraftStep::NoFault { read, mask }),
        "until" | "await" => {
            let form = "`until TEST within TIME`, such as `within 5 s`";
            let (read, test, within_ms) = parse_awaited(&rest, form)?;
            let required = verb.text == "until";
            Ok(DraftStep::Until { read, test, within_ms, required })
        }
        "standstill" => {
            Ok(DraftStep::Standstill { within_ms: parse_limit(&rest, "`standstill within 10 s`")? })
        }
        "homed" => {
            let (read, test, within_ms) = parse_awaited(&rest, "`homed TEST within TIME`")?;
            Ok(DraftStep::Homed { read, test, within_ms })
        }
        "arrival" if rest.text.starts_with("within ") => {
            let within_ms = parse_limit(&rest, "`arrival within 60 s`")?;
            Ok(DraftStep::Arrival { flag: None, within_ms })
        }
        "arrival" => {
            let (read, test, within_ms) = parse_awaited(&rest, "`arrival TEST within TIME`")?;
            Ok(DraftStep::Arrival { flag: Some((read, test)), within_ms })
        }
        "send" => parse_send(&rest),
        "keep" => Ok(DraftStep::Keep(rest.parameter_name()?)),
        "wait" => Ok(DraftStep::Wait { ms: rest.milliseconds()? }),
        other => {
            let hint = spelling::suggestion(other, VERBS);
            Err(verb.error(format!("a step cannot begin with `{other}`{hint}")))
        }
    }
}

/// Reads the first line of a block as a skip of no steps yet: `if`, `unless` and `with`.
pub(crate) fn parse_block_start(step: &Located<String>) -> Result<DraftStep, FileError> {
    let whole = StepText { text: &step.value, location: step.location.shifted(1) }.trimmed();
    let (verb, rest) = whole.split_at_mark(" ").unwrap_or((whole.clone(), whole.end()));
    if verb.text == "with" {
        return Ok(DraftStep::Without { read: rest.parameter_name()?, count: 0 });
    }
    if let Some((argument, is_negative)) = parse_sign(&rest)? {
        // The steps are skipped when the opposite holds.
        let if_negative = is_negative != (verb.text == "if");
        return Ok(DraftStep::SkipBySign { argument, if_negative, count: 0 });
    }
    let (read, mut test) = parse_condition(&rest)?;
    if verb.text == "if" {
        // The steps are skipped when the opposite holds.
        test.compare = match test.compare {
            Compare::Equal => Compare::NotEqual,
            Compare::NotEqual => Compare::Equal,
            Compare::Within | Compare::Above | Compare::Among => {
                return Err(verb.error("`if` takes == and !=; write `unless` for the opposite"));
            }
        };
    }
    Ok(DraftStep::Skip { read, test, count: 0 })
}

/// `TEST within TIME`.
fn parse_awaited(
    rest: &StepText<'_>,
    form: &str,
) -> Result<(ParameterName, ParameterTest, u32), FileError> {
    let (test, time) = rest.require_last_split(" within ", form)?;
    let (read, test) = parse_condition(&test)?;
    Ok((read, test, time.milliseconds()?))
}

/// `within TIME`.
fn parse_limit(rest: &StepText<'_>, form: &str) -> Result<u32, FileError> {
    match rest.split_at_mark("within ") {
        Some((before, time)) if before.text.is_empty() => time.milliseconds(),
        _ => Err(rest.error(format!("expected {form}"))),
    }
}

/// A test that a table of a profile gives: `NAME & MASK == N`.
pub(crate) fn parse_test(
    text: &Located<String>,
) -> Result<(ParameterName, ParameterTest), FileError> {
    let whole = StepText { text: &text.value, location: text.location.shifted(1) }.trimmed();
    parse_condition(&whole)
}

/// A part of a step with its position.
#[derive(Clone, Debug)]
struct StepText<'a> {
    text: &'a str,
    location: FileLocation,
}

impl<'a> StepText<'a> {
    fn error(&self, reason: impl Into<String>) -> FileError {
        self.location.error(reason)
    }

    fn slice(&self, at: usize, to: usize) -> Self {
        let position = self.location.shifted(self.text[..at].chars().count());
        Self { text: &self.text[at..to], location: position }
    }

    fn trimmed(&self) -> Self {
        let start = self.text.len() - self.text.trim_start().len();
        self.slice(start, start + self.text.trim().len())
    }

    fn end(&self) -> Self {
        self.slice(self.text.len(), self.text.len())
    }

    fn split(&self, at: usize, len: usize) -> (Self, Self) {
        let after = self.slice(at + len, self.text.len());
        (self.slice(0, at).trimmed(), after.trimmed())
    }

    fn split_at_mark(&self, mark: &str) -> Option<(Self, Self)> {
        self.text.find(mark).map(|at| self.split(at, mark.len()))
    }

    fn require_split(&self, mark: &str, form: &str) -> Result<(Self, Self), FileError> {
        self.split_at_mark(mark).ok_or_else(|| self.error(format!("expected {form}")))
    }

    fn require_last_split(&self, mark: &str, form: &str) -> Result<(Self, Self), FileError> {
        // The last one, because a parameter's name may hold the same word.
        let at = self.text.rfind(mark).ok_or_else(|| self.error(format!("expected {form}")))?;
        Ok(self.split(at, mark.len()))
    }

    fn parameter_name(&self) -> Result<ParameterName, FileError> {
        if self.text.is_empty() {
            return Err(self.error("a parameter's name is missing"));
        }
        Ok(Located { value: self.text.to_owned(), location: self.location.clone() })
    }

    fn number(&self) -> Result<i64, FileError> {
        let found = self.text;
        parse_number(found).ok_or_else(|| {
            self.error(format!("expected a whole number, decimal or 0x, found `{found}`"))
        })
    }

    fn number_as<T: TryFrom<i64>>(&self, what: &str) -> Result<T, FileError> {
        let number = self.number()?;
        T::try_from(number).map_err(|_| self.error(format!("{number} does not fit {what}")))
    }

    fn operand(&self) -> Result<Operand, FileError> {
        let Some(inner) = self.text.strip_prefix('{').and_then(|t| t.strip_suffix('}')) else {
            return self.number().map(Operand::Constant);
        };
        if let Some((word, speed)) = inner.split_once("? as time to ") {
            let argument = self.find_argument(word)?;
            // TS drives count a ramp as the time to a speed.
            if !matches!(argument, Argument::Acceleration | Argument::Deceleration) {
                return Err(self.error(format!("`{word}` has no time in which it reaches a speed")));
            }
            return Ok(Operand::OptionalRampTime { argument, speed: self.ramp_speed(speed)? });
        }
        if let Some(word) = inner.strip_prefix('|').and_then(|inner| inner.strip_suffix('|')) {
            return self.find_argument(word).map(Operand::Magnitude);
        }
        match inner.strip_suffix('?') {
            Some(word) => self.find_argument(word).map(Operand::OptionalArgument),
            None => self.find_argument(inner).map(Operand::Argument),
        }
    }

    fn find_argument(&self, word: &str) -> Result<Argument, FileError> {
        let known = ARGUMENTS.iter().find(|(name, _)| *name == word);
        known.map(|(_, argument)| *argument).ok_or_else(|| {
            let hint = spelling::suggestion(word, ARGUMENTS.map(|(name, _)| name));
            self.error(format!("no command carries `{word}`{hint}"))
        })
    }

    /// The speed that a ramp's time leads to: `3000 rpm` or `velocity or 300 rpm`.
    fn ramp_speed(&self, text: &str) -> Result<RampSpeed, FileError> {
        let (make, speed): (fn(u16) -> RampSpeed, &str) = match text.strip_prefix("velocity or ") {
            Some(speed) => (RampSpeed::VelocityOr, speed),
            None => (RampSpeed::Fixed, text),
        };
        let rpm = speed.strip_suffix(" rpm").and_then(|rpm| rpm.parse().ok());
        rpm.filter(|rpm| *rpm > 0).map(make).ok_or_else(|| {
            let form = "`3000 rpm` or `velocity or 300 rpm`";
            self.error(format!("expected a speed such as {form}, found `{text}`"))
        })
    }

    fn milliseconds(&self) -> Result<u32, FileError> {
        let wrong =
            || self.error(format!("expected a time such as `50 ms`, found `{}`", self.text));
        let (digits, factor) = match self.text.strip_suffix("ms") {
            Some(digits) => (digits, 1.0),
            None => (self.text.strip_suffix('s').ok_or_else(wrong)?, 1000.0),
        };
        let ms = digits.trim().parse::<f64>().map_err(|_| wrong())? * factor;
        if !(0.0..=f64::from(WAIT_MS_MAX)).contains(&ms) {
            return Err(self.error(format!("a step waits 0 to {WAIT_MS_MAX} ms")));
        }
        debug_assert!(ms.is_finite());
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked")]
        Ok(ms.round() as u32)
    }
}

fn parse_assignment<'a>(rest: &StepText<'a>) -> Result<(ParameterName, StepText<'a>), FileError> {
    let (name, value) = rest.require_split(" = ", "`NAME = VALUE`")?;
    Ok((name.parameter_name()?, value))
}

/// `NAME = VALUE, NAME = VALUE, …`: neighbours that one request writes.
fn parse_joint_write(list: &StepText<'_>) -> Result<DraftStep, FileError> {
    let (mut writes, mut rest) = (Vec::new(), Some(list.clone()));
    while let Some(list) = rest.take() {
        let (one, others) = match list.split_at_mark(", ") {
            Some((one, others)) => (one, Some(others)),
            None => (list, None),
        };
        let (name, value) = parse_assignment(&one)?;
        let operand = value.operand()?;
        if operand.is_optional() {
            return Err(value.error("what is written together has a value in each command"));
        }
        writes.push((name, operand, value.location.clone()));
        rest = others;
    }
    if writes.len() < 2 {
        return Err(list.error("expected `write together NAME = VALUE, NAME = VALUE`"));
    }
    Ok(DraftStep::WriteTogether(writes))
}

/// `MASK = VALUE` of a parameter: bits that are written, while the others stay.
fn parse_bits_write(name: &StepText<'_>, bits: &StepText<'_>) -> Result<DraftStep, FileError> {
    let (mask, value) = bits.require_split(" = ", "`NAME & MASK = VALUE`")?;
    let (bits, raw) = (mask.number()?, value.number()?);
    if bits == 0 || raw & !bits != 0 {
        return Err(value.error(format!("{raw:#x} has bits that are not in the mask {bits:#x}")));
    }
    Ok(DraftStep::WriteBits { name: name.parameter_name()?, mask: bits, raw })
}

/// `ARGUMENT < 0` or `ARGUMENT >= 0`, with or without braces: the argument, and whether the steps are for a negative
/// one. `None` for a test of a parameter.
fn parse_sign(piece: &StepText<'_>) -> Result<Option<(Argument, bool)>, FileError> {
    let found = [(" < 0", true), (" >= 0", false)]
        .into_iter()
        .find_map(|(sign, is_negative)| Some((piece.text.strip_suffix(sign)?, is_negative)));
    let Some((word, is_negative)) = found else { return Ok(None) };
    let plain = word.strip_prefix('{').and_then(|word| word.strip_suffix('}')).unwrap_or(word);
    piece.find_argument(plain).map(|argument| Some((argument, is_negative)))
}

/// `NAME` or `NAME & MASK`.
fn parse_masked(piece: &StepText<'_>) -> Result<(ParameterName, i64), FileError> {
    match piece.split_at_mark(" & ") {
        Some((name, mask)) => Ok((name.parameter_name()?, mask.number()?)),
        None => Ok((piece.trimmed().parameter_name()?, -1)),
    }
}

/// `NAME [& MASK] == N`, `!= N`, `within N`, `within-magnitude N` or `in N N…`.
fn parse_condition(piece: &StepText<'_>) -> Result<(ParameterName, ParameterTest), FileError> {
    let forms = [
        (" == ", Compare::Equal),
        (" != ", Compare::NotEqual),
        (" within-magnitude ", Compare::Within),
        (" within ", Compare::Within),
        (" > ", Compare::Above),
    ];
    for (mark, compare) in forms {
        if let Some((left, value)) = piece.split_at_mark(mark) {
            let (name, mask) = parse_masked(&left)?;
            let value = value.number()?;
            return Ok((name, ParameterTest { mask, compare, value }));
        }
    }
    if let Some((left, numbers)) = piece.split_at_mark(" in ") {
        let (name, mask) = parse_masked(&left)?;
        return Ok((
            name,
            ParameterTest { mask, compare: Compare::Among, value: parse_bit_set(&numbers)? },
        ));
    }
    Err(piece.error(
        "expected `NAME == N`, `NAME & MASK != N`, `NAME in N N…`, `NAME > N` or `NAME within N`",
    ))
}

/// Numbers from 0 to 62, one bit each.
fn parse_bit_set(piece: &StepText<'_>) -> Result<i64, FileError> {
    piece.text.split_whitespace().try_fold(0, |bits, word| match parse_number(word) {
        Some(n @ 0..=62) => Ok(bits | 1 << n),
        _ => Err(piece.error(format!("expected numbers from 0 to 62, found `{word}`"))),
    })
}

fn parse_send(rest: &StepText<'_>) -> Result<DraftStep, FileError> {
    let (numbers, like) = match rest.split_at_mark(" like ") {
        Some((numbers, like)) => (numbers, Some(like.parameter_name()?)),
        None => (rest.clone(), None),
    };
    let form = "`send FUNCTION INDEX VALUE`";
    let (function, rest) = numbers.require_split(" ", form)?;
    let (index, value) = rest.require_split(" ", form)?;
    let operand = value.operand()?;
    let (function, index) = (function.number_as("8 bits")?, index.number_as("16 bits")?);
    Ok(DraftStep::Send { function, index, operand, like })
}
