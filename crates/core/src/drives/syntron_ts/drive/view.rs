//! What the panel sees of the drive, and which modes a variant has.

use super::*;

impl View for Core {
    fn value(&self, code: Code) -> i32 {
        let (word, signed) = match code {
            Code::Fn(number) => (self.registers.value(number), limits(self.profile, number).2),
            Code::Dn(number) => {
                let signed = matches!(number, dns::SPEED | dns::LOAD | dns::TEMPERATURE);
                (self.reading(number), signed)
            }
        };
        if signed { i32::from(word as i16) } else { i32::from(word) }
    }

    fn limits(&self, number: u16) -> (i32, i32) {
        let (min, max, _) = limits(self.profile, number);
        (min as i32, max as i32)
    }

    fn rpm(&self) -> i32 {
        libm::round(self.shaft.rpm()) as i32
    }

    fn alarm(&self) -> Alarm {
        self.alarm
    }

    fn powered(&self) -> bool {
        self.shaft.powered()
    }

    fn jog_mode(&self) -> bool {
        self.mode() == MODE_JOG
    }
}

impl Variant {
    /// Whether Fn_00 may be set to that mode: a drive without the option refuses it `[I]`.
    #[must_use]
    pub const fn has_mode(self, mode: u16) -> bool {
        match mode {
            MODE_POSITION => matches!(self, Self::Position | Self::All),
            MODE_CANOPEN => matches!(self, Self::Canopen | Self::All),
            _ => true,
        }
    }
}
