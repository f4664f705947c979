//! The data that the panel shows, and the modes of a variant.

use super::*;

impl DriveView for DriveCore {
    fn value(&self, code: RegisterCode) -> i32 {
        let (word, signed) = match code {
            RegisterCode::Fn(number) => {
                (self.registers.value(number), write_limits(self.profile, number).2)
            }
            RegisterCode::Dn(number) => {
                let signed = matches!(
                    number,
                    dn_registers::SPEED | dn_registers::LOAD | dn_registers::TEMPERATURE
                );
                (self.dn_reading(number), signed)
            }
        };
        if signed { i32::from(word as i16) } else { i32::from(word) }
    }

    fn limits(&self, number: u16) -> (i32, i32) {
        let (min, max, _) = write_limits(self.profile, number);
        (min as i32, max as i32)
    }

    fn rpm(&self) -> i32 {
        libm::round(shaft::rpm(&self.shaft)) as i32
    }

    fn alarm(&self) -> Alarm {
        self.alarm
    }

    fn is_powered(&self) -> bool {
        self.shaft.is_powered()
    }

    fn is_jog_mode(&self) -> bool {
        self.mode() == MODE_JOG
    }
}

impl Variant {
    /// Returns whether Fn_00 accepts that mode: a drive without the option refuses it `[I]`.
    #[must_use]
    pub const fn has_mode(self, mode: u16) -> bool {
        match mode {
            MODE_POSITION => matches!(self, Self::Position | Self::All),
            MODE_CANOPEN => matches!(self, Self::Canopen | Self::All),
            _ => true,
        }
    }

    /// Returns whether this Fn register exists: a standard TS lacks those of the position option `[I]`.
    #[must_use]
    pub const fn has_register(self, number: u16) -> bool {
        !matches!(self, Self::Standard) || number < fn_registers::HOMING_WAY
    }
}
