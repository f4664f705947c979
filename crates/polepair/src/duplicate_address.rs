//! Texts about drives with the same address, for `get`, `scan`, `doctor` and `info`.

/// Remedy for a shared address.
pub(crate) const DUPLICATE_ADDRESS_HINT: &str = "connect one at a time and give each its own \
 address; if only one is connected, the adapter or a gateway repeats its replies";

/// An address answers each question twice.
pub(crate) fn duplicate_address_text(protocol: &str, number: impl std::fmt::Display) -> String {
    let noun = match protocol {
        "tmcl" => "module",
        "canopen" => "node",
        _ => "drive",
    };
    format!("{noun} {number} answers twice: two {noun}s have this address")
}

/// Answers came that nothing waited for, or damaged ones.
pub(crate) fn stray_answers_text(stray: u64) -> Option<String> {
    (stray > 0)
        .then(|| format!("{stray} replies too many or damaged: two drives with this address?"))
}
