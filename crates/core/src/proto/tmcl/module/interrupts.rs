//! Interrupts of stand-alone programs: EI, DI, VECT, RETI, and the settings in bank 3 (TMCL reference).

/// The greatest number of an interrupt.
const NUMBER_MAX: u8 = 46;
const NUMBERS: usize = NUMBER_MAX as usize + 1;
/// Number for all interrupts (EI 255).
const ALL: u8 = 255;
/// Timers: interrupts 0 to 2, whose settings are their periods in ms.
const TIMERS: usize = 3;
/// A motor has arrived: interrupt 3 is motor 0.
pub const REACHED: u8 = 3;
/// A motor was stopped by a stall: interrupt 15 is motor 0.
pub const STALLED: u8 = 15;
/// Stop switches: interrupt 27 is the left one of motor 0, 28 its right one.
pub const STOP_SWITCHES: u8 = 27;
/// Inputs: interrupt 39 is input 0.
pub const INPUTS: u8 = 39;
/// Which edges of a switch or an input count, by its setting in bank 3.
const RISING: i32 = 1;
const FALLING: i32 = 2;
const BOTH: i32 = 3;

/// Interrupt vectors and enable flags.
#[derive(Clone, Copy, Debug)]
pub struct Interrupts {
    vectors: [i32; NUMBERS],
    enabled: u64,
    all_enabled: bool,
    pending: u64,
    /// Levels of the last tick, a bit for each number.
    levels: u64,
    timers: [u32; TIMERS],
}

impl Interrupts {
    /// None is enabled.
    pub const NONE: Self = Self {
        vectors: [0; NUMBERS],
        enabled: 0,
        all_enabled: false,
        pending: 0,
        levels: 0,
        timers: [0; TIMERS],
    };

    /// EI or DI. Nothing happens for a number that is none.
    pub const fn enable(&mut self, number: u8, on: bool) {
        match (number, on) {
            (ALL, _) => self.all_enabled = on,
            _ if number > NUMBER_MAX => {}
            (_, true) => self.enabled |= 1 << number,
            (_, false) => {
                self.enabled &= !(1 << number);
                self.pending &= !(1 << number);
            }
        }
    }

    /// VECT. Nothing happens for a number that is none.
    pub fn set_vector(&mut self, number: u8, address: i32) {
        if let Some(vector) = self.vectors.get_mut(usize::from(number)) {
            *vector = address;
        }
    }

    /// One tick of 1 ms: `levels` has a bit for each number whose cause is present, `settings` are those of
    /// bank 3.
    pub fn tick(&mut self, levels: u64, settings: &[i32; 256]) {
        for (number, passed) in self.timers.iter_mut().enumerate() {
            let period = settings[number].max(0).cast_unsigned();
            *passed = if period == 0 { 0 } else { *passed + 1 };
            if period > 0 && *passed >= period {
                *passed = 0;
                self.pending |= self.enabled & 1 << number;
            }
        }
        debug_assert!(levels >> NUMBERS == 0, "a level for each interrupt");
        let (rose, fell) = (levels & !self.levels, !levels & self.levels);
        self.levels = levels;
        for number in REACHED..=NUMBER_MAX {
            let bit = 1 << number;
            let counts = match settings[usize::from(number)] {
                _ if number < STOP_SWITCHES => rose & bit != 0,
                RISING => rose & bit != 0,
                FALLING => fell & bit != 0,
                BOTH => (rose | fell) & bit != 0,
                _ => false,
            };
            if counts {
                self.pending |= self.enabled & bit;
            }
        }
    }

    /// Returns whether an interrupt is due.
    #[must_use]
    pub const fn is_pending(&self) -> bool {
        self.all_enabled && self.pending != 0
    }

    /// The address of the interrupt that is due, of several the one with the least number.
    pub fn take_pending(&mut self) -> Option<i32> {
        if !self.is_pending() {
            return None;
        }
        // The lowest number first; the firmware manual states no other priority.
        let number = self.pending.trailing_zeros();
        self.pending &= !(1 << number);
        self.vectors.get(number as usize).copied()
    }
}
