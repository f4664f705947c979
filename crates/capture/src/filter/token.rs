//! Tokens of a filter: words, numbers and operators, each with its position.

use super::FilterError;

/// Characters of a filter.
const TEXT_MAX: usize = 4096;

/// A piece of a filter.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct FilterToken {
    pub kind: TokenKind,
    /// First character, and how many.
    pub position: usize,
    pub len: usize,
}

/// Kind of the token.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum TokenKind {
    /// A word or a number.
    Word(String),
    Quoted(String),
    Sign(&'static str),
    End,
}

/// Longer ones first.
const SIGNS: [&str; 15] =
    ["==", "!=", "<=", ">=", "&&", "||", "..", "=", "<", ">", "~", "!", "(", ")", ","];

/// Cuts a filter into pieces; the last is [`TokenKind::End`].
pub(super) fn tokenize(text: &str) -> Result<Vec<FilterToken>, FilterError> {
    let chars: Vec<char> = text.chars().collect();
    let mut tokens = Vec::new();
    let mut at = 0;
    if chars.len() > TEXT_MAX {
        return Err(filter_error(TEXT_MAX, 1, "a filter has at most 4096 characters", text));
    }
    while at < chars.len() {
        let rest = &chars[at..];
        let (is, len) = match rest[0] {
            c if c.is_whitespace() => {
                at += 1;
                continue;
            }
            c @ ('"' | '\'') => {
                let len = rest[1..].iter().position(|other| *other == c).map(|end| end + 2);
                let len = len.ok_or_else(|| filter_error(at, 1, "this quote has no end", text))?;
                (TokenKind::Quoted(rest[1..len - 1].iter().collect()), len)
            }
            _ => match SIGNS.into_iter().find(|sign| starts_with_sign(rest, sign)) {
                Some(sign) => (TokenKind::Sign(sign), sign.len()),
                None => {
                    let len =
                        (1..rest.len()).find(|n| ends_word(&rest[*n..])).unwrap_or(rest.len());
                    (TokenKind::Word(rest[..len].iter().collect()), len)
                }
            },
        };
        tokens.push(FilterToken { kind: is, position: at, len });
        at += len;
    }
    tokens.push(FilterToken { kind: TokenKind::End, position: at, len: 1 });
    Ok(tokens)
}

fn filter_error(at: usize, len: usize, what: &str, text: &str) -> FilterError {
    FilterError {
        text: text.to_owned(),
        position: at,
        len,
        message: what.to_owned(),
        nearest: None,
    }
}

fn starts_with_sign(rest: &[char], sign: &str) -> bool {
    rest.len() >= sign.len() && rest.iter().zip(sign.chars()).all(|(a, b)| *a == b)
}

fn ends_word(rest: &[char]) -> bool {
    rest[0].is_whitespace()
        || matches!(rest[0], '"' | '\'')
        || SIGNS.iter().any(|sign| starts_with_sign(rest, sign))
}
