//! Rule 14: the text of a message decides nothing. Types, fields and codes do.

use syn::{BinOp, Expr};

/// Fields and methods that hold what people read.
const PROSE: [&str; 7] = ["message", "what", "why", "hint", "sentence", "brief", "execution"];
/// Names of values whose text is an error's.
const ERRORS: [&str; 7] = ["error", "err", "e", "refused", "problem", "failure", "trouble"];
/// Methods that pass a text on as it is.
const PASSING: [&str; 9] = [
    "as_str",
    "as_ref",
    "clone",
    "trim",
    "to_lowercase",
    "to_ascii_lowercase",
    "to_owned",
    "lines",
    "deref",
];
/// Methods that look for words in a text.
const LOOKING: [&str; 12] = [
    "contains",
    "starts_with",
    "ends_with",
    "find",
    "rfind",
    "split",
    "split_once",
    "rsplit",
    "rsplit_once",
    "strip_prefix",
    "strip_suffix",
    "matches",
];

/// Returns whether an expression looks for words in a message, or compares one with words.
pub fn depends_on_prose(expression: &Expr) -> bool {
    match expression {
        Expr::MethodCall(call) => {
            let is_scanning = LOOKING.iter().any(|name| call.method == name);
            is_scanning && is_prose(&call.receiver)
        }
        Expr::Binary(binary) => {
            let compares = matches!(binary.op, BinOp::Eq(_) | BinOp::Ne(_));
            compares
                && (joins_prose(&binary.left, &binary.right)
                    || joins_prose(&binary.right, &binary.left))
        }
        _ => false,
    }
}

fn joins_prose(one: &Expr, other: &Expr) -> bool {
    is_text_literal(one) && is_prose(other)
}

/// Returns whether an expression is what people read.
fn is_prose(expression: &Expr) -> bool {
    match expression {
        Expr::Reference(inner) => is_prose(&inner.expr),
        Expr::Paren(inner) => is_prose(&inner.expr),
        Expr::Unary(inner) => is_prose(&inner.expr),
        Expr::Field(field) => {
            matches!(&field.member, syn::Member::Named(name) if is_prose_name(name))
        }
        Expr::MethodCall(call) if PASSING.iter().any(|name| call.method == name) => {
            is_prose(&call.receiver)
        }
        Expr::MethodCall(call) if call.method == "to_string" => is_error(&call.receiver),
        Expr::MethodCall(call) => is_prose_name(&call.method),
        _ => false,
    }
}

fn is_prose_name(name: &syn::Ident) -> bool {
    PROSE.iter().any(|word| name == word)
}

fn is_error(expression: &Expr) -> bool {
    match expression {
        Expr::Reference(inner) => is_error(&inner.expr),
        Expr::Path(path) => {
            path.path.get_ident().is_some_and(|name| ERRORS.iter().any(|word| name == word))
        }
        other => is_prose(other),
    }
}

/// A text literal with content: a test for an empty message reads no prose.
fn is_text_literal(expression: &Expr) -> bool {
    matches!(expression, Expr::Lit(literal)
        if matches!(&literal.lit, syn::Lit::Str(text) if !text.value().is_empty()))
}
