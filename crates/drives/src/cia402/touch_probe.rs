//! Touch probes: positions at edges of two inputs, or of the encoder's index pulse (CiA 402-2, 60B8h to 60BDh).

/// Touch probes of a drive.
pub const PROBES: usize = 2;

/// Bits of 60B8h for one touch probe; those of the second lie eight bits higher.
const ENABLE: u16 = 1 << 0;
const CONTINUOUS: u16 = 1 << 1;
const INDEX_PULSE: u16 = 1 << 2;
const RISING: u16 = 1 << 4;
const FALLING: u16 = 1 << 5;
/// Bits of 60B9h for one touch probe.
const ENABLED: u16 = 1 << 0;
const RISING_STORED: u16 = 1 << 1;
const FALLING_STORED: u16 = 1 << 2;

/// State of the touch probes.
#[derive(Clone, Copy, Debug, Default)]
pub struct TouchProbes {
    function: u16,
    status: u16,
    /// At the rising and the falling edge of the first one, then of the second, user units.
    positions: [i32; 2 * PROBES],
    closed: [bool; PROBES],
}

impl TouchProbes {
    /// Takes a value of 60B8h. A probe that is switched on forgets what it stored before.
    pub const fn set_function(&mut self, function: u16) {
        let mut probe = 0;
        while probe < PROBES {
            let (is, was) = (bits_of(function, probe), bits_of(self.function, probe));
            if is & ENABLE == 0 || was & ENABLE == 0 {
                self.status &= !(0xFF << (8 * probe));
            }
            if is & ENABLE != 0 {
                self.status |= ENABLED << (8 * probe);
            }
            probe += 1;
        }
        self.function = function;
    }

    /// Status (60B9h).
    #[must_use]
    pub const fn status(&self) -> u16 {
        self.status
    }

    /// The stored positions, in the order of 60BAh to 60BDh.
    #[must_use]
    pub const fn positions(&self) -> &[i32; 2 * PROBES] {
        &self.positions
    }

    /// Returns whether the input of a probe is closed.
    #[must_use]
    pub const fn is_closed(&self, probe: usize) -> bool {
        self.closed[probe]
    }

    /// Returns whether an enabled probe waits for the index pulse.
    #[inline]
    #[must_use]
    pub const fn waits_for_index(&self) -> bool {
        let waits = ENABLE | INDEX_PULSE;
        bits_of(self.function, 0) & waits == waits || bits_of(self.function, 1) & waits == waits
    }

    /// Takes the state of a probe's input, with the position at that moment.
    pub fn handle_input(&mut self, probe: usize, closed: bool, position: i32) {
        let was = core::mem::replace(&mut self.closed[probe], closed);
        if was != closed && bits_of(self.function, probe) & INDEX_PULSE == 0 {
            self.store(probe, closed, position);
        }
    }

    /// Takes an index pulse, with its position.
    pub fn handle_index(&mut self, position: i32) {
        for probe in 0..PROBES {
            if bits_of(self.function, probe) & INDEX_PULSE != 0 {
                self.store(probe, true, position);
            }
        }
    }

    fn store(&mut self, probe: usize, rises: bool, position: i32) {
        let function = bits_of(self.function, probe);
        let (wanted, stored) =
            if rises { (RISING, RISING_STORED) } else { (FALLING, FALLING_STORED) };
        let is_later = bits_of(self.status, probe) & stored != 0;
        if function & ENABLE == 0 || function & wanted == 0 {
            return;
        }
        // The first event holds until the probe is switched off and on again.
        if is_later && function & CONTINUOUS == 0 {
            return;
        }
        self.positions[2 * probe + usize::from(!rises)] = position;
        self.status |= stored << (8 * probe);
    }
}

/// The eight bits of a probe.
const fn bits_of(word: u16, probe: usize) -> u16 {
    word >> (8 * probe) & 0xFF
}
