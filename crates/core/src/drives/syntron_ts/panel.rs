//! The front panel: six characters, four keys, three layers (TS manual V2 §1.4.2).
//!
//! The panel only shows and asks: what it wants done it returns as a [`Wish`]. It has the highest
//! priority for changing parameters, so the drive asks it which register is being edited.

use super::alarm::Alarm;
use crate::time::Instant;

/// Holding SET for so long is a long press (§1.4.2: "one second").
pub const LONG_PRESS_MS: u32 = 1000;
/// Half a period of whatever blinks `[I]`.
const BLINK_MS: u64 = 250;
/// Characters of the display.
pub const DISPLAY_MAX: usize = 6;
/// Decimal digits of a value.
const VALUE_DIGITS: u8 = 5;

/// A key, as the manual lists them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Key {
    /// MODE: between state and codes; out of a value without saving.
    Mode,
    /// ◀/SET: short moves the blinking digit, long enters or saves.
    Set,
    /// ▲: blinking digit up, or jog forward while held.
    Up,
    /// ▼: blinking digit down, or jog in reverse while held.
    Down,
}

impl Key {
    const ALL: [Self; 4] = [Self::Mode, Self::Set, Self::Up, Self::Down];

    /// The key of that number, counted from 0.
    #[must_use]
    pub fn of_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }
}

/// A register as the panel names it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Code {
    /// A parameter.
    Fn(u16),
    /// A reading.
    Dn(u16),
}

/// What the panel wants the drive to do.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Wish {
    /// Save a parameter.
    Save(u16, i32),
    /// Run or stop in jog mode.
    ToggleJog,
    /// Clear the alarm `[I]`: SET held on the blinking alarm.
    ClearAlarm,
}

/// What the panel sees of the drive.
pub trait View {
    /// A register's value.
    fn value(&self, code: Code) -> i32;
    /// What may be saved in a parameter.
    fn limits(&self, number: u16) -> (i32, i32);
    /// Motor speed, rpm.
    fn rpm(&self) -> i32;
    /// The alarm.
    fn alarm(&self) -> Alarm;
    /// The motor is powered.
    fn powered(&self) -> bool;
    /// The drive is in jog mode (Fn_00 = 3).
    fn jog_mode(&self) -> bool;
}

/// Where the panel is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Layer {
    State,
    Codes,
    Value { shown: i32, digit: u8 },
}

/// The panel.
#[derive(Clone, Copy, Debug)]
pub struct Panel {
    layer: Layer,
    code: Code,
    digit: u8,
    held: [bool; 4],
    set_since: Option<Instant>,
}

impl Default for Panel {
    fn default() -> Self {
        Self { layer: Layer::State, code: Code::Fn(0), digit: 0, held: [false; 4], set_since: None }
    }
}

impl Panel {
    /// A key goes down or up.
    pub fn key(&mut self, now: Instant, key: Key, down: bool, view: &impl View) -> Option<Wish> {
        if core::mem::replace(&mut self.held[key as usize], down) == down {
            return None;
        }
        match (key, down) {
            (Key::Mode, true) => self.mode(),
            (Key::Up, true) => self.change(1, view),
            (Key::Down, true) => self.change(-1, view),
            (Key::Set, true) => self.set_since = Some(now),
            (Key::Set, false) => return self.released(now, view),
            (_, false) => {}
        }
        None
    }

    /// To be called at or after [`due`](Self::due): a held SET has become a long press.
    #[inline]
    pub fn tick(&mut self, now: Instant, view: &impl View) -> Option<Wish> {
        self.set_since.take_if(|since| now >= since.plus_ms(LONG_PRESS_MS))?;
        self.long_press(view)
    }

    /// When a held SET becomes a long press.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        self.set_since.map(|since| since.plus_ms(LONG_PRESS_MS))
    }

    /// Which way the keys jog: +1 forward while ▲ is held, -1 in reverse while ▼ is, else 0.
    #[must_use]
    pub fn jog(&self) -> f64 {
        if self.layer != Layer::State {
            return 0.0;
        }
        f64::from(i8::from(self.held[Key::Up as usize]))
            - f64::from(i8::from(self.held[Key::Down as usize]))
    }

    /// The parameter that is open for editing.
    #[must_use]
    pub fn editing(&self) -> Option<u16> {
        match (self.layer, self.code) {
            (Layer::Value { .. }, Code::Fn(number)) => Some(number),
            _ => None,
        }
    }

    /// Writes what is shown and returns how many characters that are.
    pub fn show(&self, now: Instant, view: &impl View, out: &mut [u8]) -> usize {
        let mut text = Text::default();
        let lit = (now.0 / 1_000_000 / BLINK_MS).is_multiple_of(2);
        match self.layer {
            Layer::State => state_text(&mut text, lit, view),
            Layer::Codes => self.code_text(&mut text, lit),
            Layer::Value { shown, digit } => {
                let live = self.editing().is_none();
                text.number(if live { view.value(self.code) } else { shown }, digit + 1);
                if !live && !lit {
                    text.blank(digit);
                }
            }
        }
        let len = text.len.min(out.len());
        out[..len].copy_from_slice(&text.bytes[..len]);
        len
    }

    fn mode(&mut self) {
        self.layer = match self.layer {
            Layer::State | Layer::Value { .. } => Layer::Codes,
            Layer::Codes => Layer::State,
        };
    }

    /// ▲ and ▼ change the blinking digit.
    fn change(&mut self, step: i32, view: &impl View) {
        match self.layer {
            Layer::State => {}
            Layer::Codes => self.change_code(step),
            Layer::Value { shown, digit } => {
                if let Some(number) = self.editing() {
                    let (min, max) = view.limits(number);
                    let to = shown + step * 10_i32.pow(u32::from(digit));
                    self.layer = Layer::Value { shown: to.clamp(min, max), digit };
                }
            }
        }
    }

    /// The leftmost place turns Fn into Dn and back `[I]`; the others are hexadecimal digits.
    fn change_code(&mut self, step: i32) {
        if self.digit == 3 {
            self.code = match self.code {
                Code::Fn(number) => Code::Dn(number.min(0x2F)),
                Code::Dn(number) => Code::Fn(number),
            };
            return;
        }
        let by = step << (4 * self.digit);
        let moved = |number: u16, max: i32| (i32::from(number) + by).clamp(0, max) as u16;
        self.code = match self.code {
            Code::Fn(number) => Code::Fn(moved(number, 0x2FF)),
            Code::Dn(number) => Code::Dn(moved(number, 0x2F)),
        };
    }

    /// SET let go: short unless its long press was already served.
    fn released(&mut self, now: Instant, view: &impl View) -> Option<Wish> {
        let since = self.set_since.take()?;
        if now >= since.plus_ms(LONG_PRESS_MS) {
            return self.long_press(view);
        }
        match &mut self.layer {
            Layer::State => return view.jog_mode().then_some(Wish::ToggleJog),
            Layer::Codes => self.digit = (self.digit + 1) % 4,
            Layer::Value { digit, .. } => *digit = (*digit + 1) % VALUE_DIGITS,
        }
        None
    }

    fn long_press(&mut self, view: &impl View) -> Option<Wish> {
        match self.layer {
            Layer::State => view.alarm().is_some().then_some(Wish::ClearAlarm),
            Layer::Codes => {
                self.layer = Layer::Value { shown: view.value(self.code), digit: 0 };
                None
            }
            Layer::Value { shown, .. } => self.editing().map(|number| Wish::Save(number, shown)),
        }
    }

    fn code_text(&self, text: &mut Text, lit: bool) {
        let (letter, number) = match self.code {
            Code::Fn(number) => (b'F', number),
            Code::Dn(number) => (b'd', number),
        };
        text.push(letter);
        text.push(b'n');
        text.push(b'_');
        if number > 0xFF || self.digit == 2 {
            text.push(hex(number >> 8));
        }
        text.push(hex(number >> 4));
        text.push(hex(number));
        match (lit, self.digit) {
            (true, _) => {}
            (false, 3) => text.bytes[0] = b' ',
            (false, digit) => text.blank(digit),
        }
    }
}

/// What stands there by itself: the alarm, the speed, or that the drive is ready. What the manual
/// shows while the servo is off was a picture; `rdy` is `[I]`.
fn state_text(text: &mut Text, lit: bool, view: &impl View) {
    let alarm = view.alarm();
    if alarm.is_some() {
        let [a, b] = alarm.glyphs();
        let shown = if lit { [b'E', b'r', b'r', b'_', a, b] } else { [b' '; DISPLAY_MAX] };
        shown.into_iter().for_each(|c| text.push(c));
    } else if view.powered() {
        text.number(view.rpm(), 1);
    } else {
        b"rdy".iter().for_each(|c| text.push(*c));
    }
}

fn hex(digit: u16) -> u8 {
    b"0123456789AbcdEF"[usize::from(digit & 0xF)]
}

/// What stands on the display.
#[derive(Default)]
struct Text {
    bytes: [u8; DISPLAY_MAX],
    len: usize,
}

impl Text {
    fn push(&mut self, c: u8) {
        if let Some(at) = self.bytes.get_mut(self.len) {
            *at = c;
            self.len += 1;
        }
    }

    /// A decimal number with at least so many digits.
    fn number(&mut self, value: i32, at_least: u8) {
        if value < 0 {
            self.push(b'-');
        }
        let magnitude = value.unsigned_abs();
        let fits = |place: &u8| *place < at_least || magnitude / 10_u32.pow(u32::from(*place)) > 0;
        for place in (0..VALUE_DIGITS).rev().filter(fits) {
            self.push(b'0' + (magnitude / 10_u32.pow(u32::from(place)) % 10) as u8);
        }
    }

    /// Blanks the digit of that place, counted from the right.
    fn blank(&mut self, place: u8) {
        if let Some(at) = self.len.checked_sub(1 + usize::from(place)) {
            self.bytes[at] = b' ';
        }
    }
}
