//! Conversions and parts that state what happens at a limit.

/// An integer type with a greatest value.
pub trait Limited {
    /// The greatest value.
    const MAX: Self;
}

macro_rules! limited {
    ($($integer:ident),*) => {
        $(impl Limited for $integer {
            const MAX: Self = $integer::MAX;
        })*
    };
}

limited!(u8, u16, u32, u64, usize, i16, i64);

/// The number in another type; the greatest of that type for one that does not fit, such as a length that is
/// only shown or compared.
///
/// ```
/// use polepair_core::convert::saturating;
/// assert_eq!(saturating::<u8>(300_u32), 255);
/// assert_eq!(saturating::<u8>(30_u32), 30);
/// ```
pub fn saturating<T: Limited>(number: impl TryInto<T>) -> T {
    number.try_into().unwrap_or(T::MAX)
}

/// The elements from `at` on; none beyond the end.
#[must_use]
pub fn tail<T>(items: &[T], at: usize) -> &[T] {
    items.get(at..).unwrap_or(&[])
}

/// The text from byte `at` on; none beyond the end, or within a character.
#[must_use]
pub fn text_from(text: &str, at: usize) -> &str {
    text.get(at..).unwrap_or("")
}

/// Bytes that were written as ASCII, as text; empty for others.
#[must_use]
pub fn ascii_text(bytes: &[u8]) -> &str {
    core::str::from_utf8(bytes).unwrap_or("")
}
