//! The front panel: six characters, four keys, three layers (TS manual V2 §1.4.2).
//!
//! The panel changes nothing itself; it returns a [`PanelAction`]. It has the highest priority for changing
//! parameters, so the drive asks it which register is being edited.

use super::alarm::Alarm;
use polepair_core::time::Instant;

/// Duration of a long press of SET (§1.4.2: "one second").
pub const LONG_PRESS_MS: u32 = 1000;
/// Half a period of whatever blinks `[I]`.
const BLINK_MS: u64 = 250;
/// Characters of the display.
pub const DISPLAY_MAX: usize = 6;
/// Decimal digits of a value.
const VALUE_DIGITS: u8 = 5;

/// A key, as the manual lists them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PanelKey {
    /// MODE: between state and codes; out of a value without saving.
    Mode,
    /// ◀/SET: short moves the blinking digit, long enters or saves.
    Set,
    /// ▲: blinking digit up, or jog forward while held.
    Up,
    /// ▼: blinking digit down, or jog in reverse while held.
    Down,
}

impl PanelKey {
    const ALL: [Self; 4] = [Self::Mode, Self::Set, Self::Up, Self::Down];

    /// The key of that number, counted from 0.
    #[must_use]
    pub fn of_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }
}

/// A register as the panel names it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RegisterCode {
    /// A parameter.
    Fn(u16),
    /// A reading.
    Dn(u16),
}

/// Action of the panel on the drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum PanelAction {
    /// Save a parameter.
    Save(u16, i32),
    /// Run or stop in jog mode.
    ToggleJog,
    /// Clear the alarm `[I]`: SET held on the blinking alarm.
    ClearAlarm,
}

/// The drive as seen by its panel.
pub trait DriveView {
    /// A register's value.
    fn value(&self, code: RegisterCode) -> i32;
    /// Limits of a parameter that is saved at the panel.
    fn limits(&self, number: u16) -> (i32, i32);
    /// Motor speed, rpm.
    fn rpm(&self) -> i32;
    /// The alarm.
    fn alarm(&self) -> Alarm;
    /// The motor is powered.
    fn is_powered(&self) -> bool;
    /// The drive is in jog mode (Fn_00 = 3).
    fn is_jog_mode(&self) -> bool;
}

/// Menu level of the panel.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum PanelLayer {
    State,
    Codes,
    Value { shown: i32, digit: u8 },
}

/// The panel.
#[derive(Clone, Copy, Debug)]
pub struct FrontPanel {
    layer: PanelLayer,
    code: RegisterCode,
    digit: u8,
    keys_down: [bool; 4],
    set_pressed_at: Option<Instant>,
}

impl Default for FrontPanel {
    fn default() -> Self {
        Self {
            layer: PanelLayer::State,
            code: RegisterCode::Fn(0),
            digit: 0,
            keys_down: [false; 4],
            set_pressed_at: None,
        }
    }
}

impl FrontPanel {
    /// A key goes down or up.
    pub fn handle_key(
        &mut self,
        now: Instant,
        key: PanelKey,
        down: bool,
        view: &impl DriveView,
    ) -> Option<PanelAction> {
        // A key that bounces is pressed once.
        if core::mem::replace(&mut self.keys_down[key as usize], down) == down {
            return None;
        }
        match (key, down) {
            (PanelKey::Mode, true) => self.handle_mode_key(),
            (PanelKey::Up, true) => self.change_value(1, view),
            (PanelKey::Down, true) => self.change_value(-1, view),
            (PanelKey::Set, true) => self.set_pressed_at = Some(now),
            (PanelKey::Set, false) => return self.handle_set_released(now, view),
            (_, false) => {}
        }
        None
    }

    /// To be called at or after [`next_due`](Self::next_due): a held SET has become a long press.
    #[inline]
    pub fn tick(&mut self, now: Instant, view: &impl DriveView) -> Option<PanelAction> {
        // Taken, so that its release is not a short press as well.
        self.set_pressed_at.take_if(|since| now >= since.plus_ms(LONG_PRESS_MS))?;
        self.handle_long_press(view)
    }

    /// Time at which a held SET becomes a long press.
    #[must_use]
    pub fn next_due(&self) -> Option<Instant> {
        self.set_pressed_at.map(|since| since.plus_ms(LONG_PRESS_MS))
    }

    /// Which way the keys jog: +1 forward while ▲ is held, -1 in reverse while ▼ is, else 0.
    #[must_use]
    pub fn jog_direction(&self) -> f64 {
        if self.layer != PanelLayer::State {
            return 0.0;
        }
        f64::from(i8::from(self.keys_down[PanelKey::Up as usize]))
            - f64::from(i8::from(self.keys_down[PanelKey::Down as usize]))
    }

    /// The parameter that is open for editing.
    #[must_use]
    pub fn edited_parameter(&self) -> Option<u16> {
        match (self.layer, self.code) {
            (PanelLayer::Value { .. }, RegisterCode::Fn(number)) => Some(number),
            _ => None,
        }
    }

    /// Writes the displayed text and returns the number of characters.
    pub fn write_display(&self, now: Instant, view: &impl DriveView, out: &mut [u8]) -> usize {
        let mut text = DisplayText::default();
        let lit = (now.0 / 1_000_000 / BLINK_MS).is_multiple_of(2);
        match self.layer {
            PanelLayer::State => write_state(&mut text, lit, view),
            PanelLayer::Codes => self.write_code(&mut text, lit),
            PanelLayer::Value { shown, digit } => {
                let live = self.edited_parameter().is_none();
                text.push_number(if live { view.value(self.code) } else { shown }, digit + 1);
                if !live && !lit {
                    text.blank_digit(digit);
                }
            }
        }
        let len = text.len.min(out.len());
        out[..len].copy_from_slice(&text.bytes[..len]);
        len
    }

    fn handle_mode_key(&mut self) {
        self.layer = match self.layer {
            PanelLayer::State | PanelLayer::Value { .. } => PanelLayer::Codes,
            PanelLayer::Codes => PanelLayer::State,
        };
    }

    /// ▲ and ▼ change the blinking digit.
    fn change_value(&mut self, step: i32, view: &impl DriveView) {
        match self.layer {
            PanelLayer::State => {}
            PanelLayer::Codes => self.change_code(step),
            PanelLayer::Value { shown, digit } => {
                if let Some(number) = self.edited_parameter() {
                    let (min, max) = view.limits(number);
                    let to = shown + step * 10_i32.pow(u32::from(digit));
                    debug_assert!(min <= max, "limits are in order");
                    self.layer = PanelLayer::Value { shown: to.clamp(min, max), digit };
                }
            }
        }
    }

    /// The leftmost place turns Fn into Dn and back `[I]`; the others are hexadecimal digits.
    fn change_code(&mut self, step: i32) {
        if self.digit == 3 {
            self.code = match self.code {
                RegisterCode::Fn(number) => RegisterCode::Dn(number.min(0x2F)),
                RegisterCode::Dn(number) => RegisterCode::Fn(number),
            };
            return;
        }
        let by = step << (4 * self.digit);
        self.code = match self.code {
            RegisterCode::Fn(number) => RegisterCode::Fn(moved_number(number, 0x2FF, by)),
            RegisterCode::Dn(number) => RegisterCode::Dn(moved_number(number, 0x2F, by)),
        };
    }

    /// SET let go: short unless its long press was already served.
    fn handle_set_released(&mut self, now: Instant, view: &impl DriveView) -> Option<PanelAction> {
        let since = self.set_pressed_at.take()?;
        if now >= since.plus_ms(LONG_PRESS_MS) {
            return self.handle_long_press(view);
        }
        match &mut self.layer {
            PanelLayer::State => return view.is_jog_mode().then_some(PanelAction::ToggleJog),
            PanelLayer::Codes => self.digit = (self.digit + 1) % 4,
            PanelLayer::Value { digit, .. } => *digit = (*digit + 1) % VALUE_DIGITS,
        }
        None
    }

    fn handle_long_press(&mut self, view: &impl DriveView) -> Option<PanelAction> {
        match self.layer {
            PanelLayer::State => view.alarm().is_some().then_some(PanelAction::ClearAlarm),
            PanelLayer::Codes => {
                self.layer = PanelLayer::Value { shown: view.value(self.code), digit: 0 };
                None
            }
            PanelLayer::Value { shown, .. } => {
                self.edited_parameter().map(|number| PanelAction::Save(number, shown))
            }
        }
    }

    fn write_code(&self, text: &mut DisplayText, lit: bool) {
        let (letter, number) = match self.code {
            RegisterCode::Fn(number) => (b'F', number),
            RegisterCode::Dn(number) => (b'd', number),
        };
        text.push(letter);
        text.push(b'n');
        text.push(b'_');
        if number > 0xFF || self.digit == 2 {
            text.push(hex_character(number >> 8));
        }
        text.push(hex_character(number >> 4));
        text.push(hex_character(number));
        match (lit, self.digit) {
            (true, _) => {}
            (false, 3) => text.bytes[0] = b' ',
            (false, digit) => text.blank_digit(digit),
        }
    }
}

fn moved_number(number: u16, max: i32, by: i32) -> u16 {
    (i32::from(number) + by).clamp(0, max) as u16
}

/// Writes the idle display: the alarm, the speed, or ready. The manual shows the display with the servo off
/// as a picture only; `rdy` is `[I]`.
fn write_state(text: &mut DisplayText, lit: bool, view: &impl DriveView) {
    let alarm = view.alarm();
    if alarm.is_some() {
        let [a, b] = alarm.glyphs();
        let shown = if lit { [b'E', b'r', b'r', b'_', a, b] } else { [b' '; DISPLAY_MAX] };
        shown.into_iter().for_each(|c| text.push(c));
    } else if view.is_powered() {
        text.push_number(view.rpm(), 1);
    } else {
        b"rdy".iter().for_each(|c| text.push(*c));
    }
}

fn hex_character(digit: u16) -> u8 {
    b"0123456789AbcdEF"[usize::from(digit & 0xF)]
}

/// Text on the display.
#[derive(Default)]
struct DisplayText {
    bytes: [u8; DISPLAY_MAX],
    len: usize,
}

impl DisplayText {
    fn push(&mut self, c: u8) {
        if let Some(at) = self.bytes.get_mut(self.len) {
            *at = c;
            self.len += 1;
        }
    }

    /// Appends a decimal number with at least `at_least` digits.
    fn push_number(&mut self, value: i32, at_least: u8) {
        if value < 0 {
            self.push(b'-');
        }
        let magnitude = value.unsigned_abs();
        let fits = |index: &u8| *index < at_least || magnitude / 10_u32.pow(u32::from(*index)) > 0;
        for index in (0..VALUE_DIGITS).rev().filter(fits) {
            self.push(b'0' + (magnitude / 10_u32.pow(u32::from(index)) % 10) as u8);
        }
    }

    /// Blanks the digit of that place, counted from the right.
    fn blank_digit(&mut self, index: u8) {
        if let Some(at) = self.len.checked_sub(1 + usize::from(index)) {
            self.bytes[at] = b' ';
        }
    }
}
