//! The language in which people ask a node: `read 0x6041:0`, `write 0x6040:0 u16 0x000F`,
//! `upload 0x1008:0`, `nmt start`, `guard`, `sync`, `lss fastscan`.

use super::ask::Ask;
use super::lss;
use super::nmt::{Command, Order};
use super::sdo::Object;
use crate::error::Failure;
use crate::station::Class;

/// Types of values, with their bytes.
const TYPES: [(&str, u8); 8] =
    [("u8", 1), ("i8", 1), ("u16", 2), ("i16", 2), ("u32", 4), ("i32", 4), ("u64", 8), ("i64", 8)];

const COMMANDS: [(&str, Command); 5] = [
    ("start", Command::Start),
    ("stop", Command::Stop),
    ("pre-operational", Command::PreOperational),
    ("reset", Command::ResetNode),
    ("reset-communication", Command::ResetCommunication),
];

/// What a text asks of `node`.
#[must_use]
pub fn request(text: &str, node: u8) -> Option<Ask> {
    let mut words = text.split_whitespace();
    let verb = words.next()?;
    let ask = match verb {
        "read" => Ask::Read { node, object: object(words.next()?)? },
        "upload" => Ask::Upload { node, object: object(words.next()?)?, block: false },
        "upload-block" => Ask::Upload { node, object: object(words.next()?)?, block: true },
        "write" => {
            let object = object(words.next()?)?;
            let word = words.next()?;
            let (_, len) = *TYPES.iter().find(|(name, _)| *name == word)?;
            let bits = value(words.next()?, len, word.starts_with('i'))?;
            Ask::Write { node, object, bits, len, class: Class::Never }
        }
        "nmt" => {
            let word = words.next()?;
            let (_, command) = *COMMANDS.iter().find(|(name, _)| *name == word)?;
            Ask::Order(Order { command, node })
        }
        "guard" => Ask::Guard { node },
        "sync" => Ask::Sync,
        "lss" => lss_request(words.next()?, &mut words)?,
        _ => return None,
    };
    words.next().is_none().then_some(ask)
}

fn lss_request<'a>(word: &str, words: &mut impl Iterator<Item = &'a str>) -> Option<Ask> {
    Some(Ask::Lss(match word {
        "fastscan" => return Some(Ask::FastScan),
        "node" => lss::Request::SetNode(u8::try_from(integer(words.next()?)?).ok()?),
        "configuration" => lss::Request::SwitchGlobal(true),
        "waiting" => lss::Request::SwitchGlobal(false),
        "store" => lss::Request::Store,
        "inquire" => lss::Request::InquireNode,
        _ => return None,
    }))
}

/// What an answer to a layer setting service comes to.
///
/// # Errors
/// [`Failure::Refused`] with the service's own error.
pub fn outcome(reply: lss::Reply) -> Result<i64, Failure> {
    use lss::Reply;
    match reply {
        Reply::SetNode(error @ 1.., _)
        | Reply::SetBitTiming(error @ 1.., _)
        | Reply::Store(error @ 1.., _) => Err(Failure::Refused { code: error.into() }),
        Reply::Number(_, value) => Ok(value.into()),
        Reply::Node(node) => Ok(node.into()),
        _ => Ok(0),
    }
}

/// `0x6040:0`; without a sub-index it is 0.
fn object(text: &str) -> Option<Object> {
    let (index, sub) = text.split_once(':').unwrap_or((text, "0"));
    let index = u16::try_from(integer(index)?).ok()?;
    Some(Object { index, sub: u8::try_from(integer(sub)?).ok()? })
}

fn integer(text: &str) -> Option<i64> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text),
    };
    let number = match digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        Some(hex) => i64::from_str_radix(hex, 16).ok()?,
        None => digits.parse().ok()?,
    };
    Some(if negative { -number } else { number })
}

/// The bytes of a number that fits.
fn value(text: &str, len: u8, signed: bool) -> Option<u64> {
    let number = integer(text)?;
    let bits = 8 * u32::from(len);
    let fits = match (signed, bits) {
        (_, 64) => signed || number >= 0,
        (true, bits) => (-(1 << (bits - 1))..1 << (bits - 1)).contains(&number),
        (false, bits) => (0..1 << bits).contains(&number),
    };
    fits.then_some(number.cast_unsigned() & u64::MAX >> (64 - bits))
}
