//! Alarm codes: two characters of the panel in one number (TS manual V2 §4).

use super::profile::SYNTRON_TS;
use polepair_core::profile::{Fault, Severity};

/// Content of `Dn_12`: the last but one character in the high byte, the last in the low byte; zero for no
/// alarm.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Alarm(pub u16);

/// The panel's characters by their code.
const GLYPHS: &[u8; 29] = b"0123456789AbcdEFGHIJLnoPqrStU";

impl Alarm {
    /// The alarm of a code. `None` for 0, for more than 16 bits, and for what the drive only notes: a limit switch.
    #[must_use]
    pub fn of_code(code: u32) -> Option<Self> {
        let is_note = |it: &Fault| it.code == code && it.severity == Severity::Note;
        if SYNTRON_TS.faults.iter().any(is_note) {
            return None;
        }
        u16::try_from(code).ok().filter(|code| *code != 0).map(Self)
    }

    /// No alarm.
    pub const NONE: Self = Self(0);
    /// Over-current.
    pub const OC: Self = Self(0x160C);
    /// Overload.
    pub const OL: Self = Self(0x1614);
    /// Over-voltage.
    pub const OU: Self = Self(0x161C);
    /// A parameter is wrong.
    pub const PA: Self = Self(0x170A);
    /// Encoder, signals A, B, Z.
    pub const EC: Self = Self(0x0E0C);
    /// Following error.
    pub const PE: Self = Self(0x170E);
    /// Stall.
    pub const ST: Self = Self(0x1A1B);
    /// Voltage below the limit (ERR_LU).
    pub const LU: Self = Self(0x141C);
    /// Encoder, signals U, V, W.
    pub const EH: Self = Self(0x0E11);
    /// Two inputs with one function.
    pub const ID: Self = Self(0x120D);
    /// The power bus is not ready.
    pub const DE: Self = Self(0x0D0E);
    /// Speed command too small.
    pub const SL: Self = Self(0x1A14);
    /// Braking circuit, average power.
    pub const OH: Self = Self(0x1611);
    /// Braking circuit, peak power.
    pub const LH: Self = Self(0x1411);
    /// CAN line break.
    pub const LO: Self = Self(0x1416);
    /// Over-temperature, from the sibling DS102.
    pub const OT: Self = Self(0x161B);

    /// The two characters that the panel shows after `ERR_`; `?` for a code that is no character.
    #[must_use]
    pub fn glyphs(self) -> [u8; 2] {
        self.0.to_be_bytes().map(|code| GLYPHS.get(usize::from(code)).copied().unwrap_or(b'?'))
    }

    /// The alarm of two characters of the panel. Letter case means nothing: the manual prints one
    /// character as `c` in `ERR_oc` and as `C` in `ERR_IC`.
    #[must_use]
    pub fn of_glyphs(text: [u8; 2]) -> Option<Self> {
        Some(Self(u16::from_be_bytes([glyph_code(text[0])?, glyph_code(text[1])?])))
    }

    /// True for an alarm, false for none.
    #[must_use]
    pub const fn is_some(self) -> bool {
        self.0 != 0
    }
}

fn glyph_code(c: u8) -> Option<u8> {
    let at = GLYPHS.iter().position(|g| g.eq_ignore_ascii_case(&c))?;
    u8::try_from(at).ok()
}
