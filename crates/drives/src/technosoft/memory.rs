//! The memory of a drive: data pages, RAM, EEPROM.
//!
//! Source: the vendor's help pages on the memory map (FAxx firmware): EEPROM 4000h to 7FFFh in program and
//! SPI space, RAM from 8000h on in program and data space, TML data 0200h to 03AFh and 0800h to 09FFh, user
//! variables 03B0h to 03FFh. \[I\] RAM ends at BFFFh, where both firmware families have their highest
//! variables; addresses above read as zero.

use core::ops::Range;

use polepair_core::proto::tml::online::MemorySpace as Space;

/// A write that memory does not take.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum WriteRefusal {
    /// There is no memory.
    NoMemory,
    /// This part of the EEPROM is locked (LOCKEEPROM).
    Locked,
}

const PAGES: Range<u16> = 0x0200..0x0A00;
const EEPROM: Range<u16> = 0x4000..0x8000;
const RAM: Range<u16> = 0x8000..0xC000;

/// Address of the set-up table: an image of both data pages behind a sum. \[I\] Its true place and format are the
/// set-up tool's secret.
const SETUP_TABLE: u16 = 0x7C00;
const SETUP_TABLE_PARTS: [Range<u16>; 2] = [0x0200..0x03B0, 0x0800..0x0A00];
/// The last axis ID that came from a valid table.
const LAST_AXIS: u16 = 0x7FFF;

/// The memories of a drive.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    pages: [u16; 0x800],
    ram: [u16; 0x4000],
    eeprom: [u16; 0x4000],
    /// Words written to the EEPROM since it was made.
    pub writes: u64,
    /// Part that LOCKEEPROM locks: 0 nothing, 1 the last quarter, 2 the last half, 3 all. \[I\]
    pub locked: u8,
    /// Value of SPIBR.
    pub spi_rate: u16,
}

impl Memory {
    /// Erased.
    pub const fn new() -> Self {
        Self {
            pages: [0; 0x800],
            ram: [0; 0x4000],
            eeprom: [0xFFFF; 0x4000],
            writes: 0,
            locked: 0,
            spi_rate: 0,
        }
    }

    /// A word; zero where there is none.
    #[inline]
    pub fn read(&self, space: Space, address: u16) -> u16 {
        let (words, at) = match space {
            Space::Data if PAGES.contains(&address) => (&self.pages[..], address - PAGES.start),
            Space::Data | Space::Program if RAM.contains(&address) => {
                (&self.ram[..], address - RAM.start)
            }
            Space::Program | Space::Spi if EEPROM.contains(&address) => {
                (&self.eeprom[..], address - EEPROM.start)
            }
            _ => return 0,
        };
        words[usize::from(at)]
    }

    /// Writes a word.
    ///
    /// # Errors
    /// [`WriteRefusal`].
    pub fn write(&mut self, space: Space, address: u16, value: u16) -> Result<(), WriteRefusal> {
        match space {
            Space::Data if PAGES.contains(&address) => {
                self.pages[usize::from(address - PAGES.start)] = value;
            }
            Space::Data | Space::Program if RAM.contains(&address) => {
                self.ram[usize::from(address - RAM.start)] = value;
            }
            Space::Program | Space::Spi if EEPROM.contains(&address) => {
                if address >= self.first_locked() {
                    return Err(WriteRefusal::Locked);
                }
                self.eeprom[usize::from(address - EEPROM.start)] = value;
                self.writes += 1;
            }
            _ => return Err(WriteRefusal::NoMemory),
        }
        Ok(())
    }

    /// A 16-bit variable.
    #[inline]
    pub fn word(&self, address: u16) -> u16 {
        self.read(Space::Data, address)
    }

    /// A 16-bit variable with sign.
    pub fn int(&self, address: u16) -> i16 {
        self.word(address).cast_signed()
    }

    /// A 32-bit variable: the low word comes first.
    pub fn long(&self, address: u16) -> i32 {
        let high = self.word(address.wrapping_add(1));
        (u32::from(self.word(address)) | u32::from(high) << 16).cast_signed()
    }

    /// A fixed-point variable, 16 bits before the point and 16 behind.
    pub fn fixed(&self, address: u16) -> f64 {
        f64::from(self.long(address)) / 65536.0
    }

    /// Sets a variable of the firmware's own.
    pub fn set(&mut self, address: u16, value: u16) {
        let recorded = self.write(Space::Data, address, value);
        debug_assert!(recorded.is_ok(), "{address:04X}");
    }

    /// Sets a 32-bit variable of the firmware's own.
    pub fn set_long(&mut self, address: u16, value: i32) {
        self.set(address, value as u16);
        self.set(address + 1, (value >> 16) as u16);
    }

    /// Sets a fixed-point variable of the firmware's own.
    pub fn set_fixed(&mut self, address: u16, value: f64) {
        self.set_long(address, libm::round(value * 65536.0) as i32);
    }

    /// Everything but the EEPROM is lost.
    pub fn clear_volatile(&mut self) {
        self.pages.fill(0);
        self.ram.fill(0);
    }

    /// SAVE: the data pages go into the set-up table.
    ///
    /// # Errors
    /// [`WriteRefusal::Locked`].
    pub fn save_table(&mut self) -> Result<(), WriteRefusal> {
        let mut sum = 0_u16;
        for (at, address) in (SETUP_TABLE + 1..).zip(SETUP_TABLE_PARTS.into_iter().flatten()) {
            let word = self.word(address);
            self.write(Space::Spi, at, word)?;
            sum = sum.wrapping_add(word);
        }
        self.write(Space::Spi, SETUP_TABLE, !sum)
    }

    /// Returns whether the check sum of the set-up table is valid.
    pub fn is_table_valid(&self) -> bool {
        let words = SETUP_TABLE_PARTS.into_iter().flatten().count() as u16;
        let stored = (SETUP_TABLE + 1..=SETUP_TABLE + words).map(|at| self.read(Space::Spi, at));
        self.read(Space::Spi, SETUP_TABLE) == !stored.fold(0_u16, u16::wrapping_add)
    }

    /// Spoils the set-up table's sum.
    pub fn corrupt_table(&mut self) {
        self.eeprom[usize::from(SETUP_TABLE - EEPROM.start)] ^= 1;
    }

    /// The data pages come from the set-up table.
    pub fn load_table(&mut self) {
        for (at, address) in (SETUP_TABLE + 1..).zip(SETUP_TABLE_PARTS.into_iter().flatten()) {
            self.set(address, self.read(Space::Spi, at));
        }
    }

    /// The last axis ID that came from a valid table, if there was one.
    pub fn last_axis(&self) -> Option<u8> {
        u8::try_from(self.read(Space::Spi, LAST_AXIS)).ok()
    }

    /// Stores an axis ID that came from a valid table.
    pub fn store_last_axis(&mut self, axis: u8) {
        if self.last_axis() != Some(axis) {
            self.eeprom[usize::from(LAST_AXIS - EEPROM.start)] = axis.into();
            self.writes += 1;
        }
    }

    /// CHECKSUM: the sum of the words from `start` to `end`, both counted.
    pub fn checksum(&self, space: Space, start: u16, end: u16) -> u16 {
        (start..=end).fold(0, |sum, at| sum.wrapping_add(self.read(space, at)))
    }

    const fn first_locked(&self) -> u16 {
        match self.locked {
            0 => 0xFFFF,
            1 => 0x7000,
            2 => 0x6000,
            _ => 0x4000,
        }
    }
}
