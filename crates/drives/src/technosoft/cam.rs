//! Electronic camming: the position follows a table over the master's position.
//!
//! Source: the vendor's help pages on cam tables and on `INITCAM`, which copies a table from the EEPROM to
//! RAM. The layout of a table is [`polepair_core::cam_table`]'s. \[I\] The slave moves by the difference of two
//! points (relative camming) and holds the end points outside. The table is read at (master − CAMOFF) × CAMX,
//! and its positions count times CAMY.

use super::addresses;
use super::drive::Drive;
use super::execute::ExecuteError;
use super::status::srh;
use polepair_core::cam_table::HEAD_WORDS;
use polepair_core::plant::{Setpoint, TICK_S};
use polepair_core::proto::tml::online::MemorySpace as Space;
use polepair_core::proto::tml::wire::Instruction;

/// A cam table in memory.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct CamTable {
    space: Space,
    address: u16,
    points: u16,
    step_power: u32,
    first_master: i32,
}

/// The state of camming.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Cam {
    table: Option<CamTable>,
    /// Cam output when it was last looked at, counts.
    output: f64,
}

impl Cam {
    /// No cam.
    pub const NONE: Self = Self { table: None, output: 0.0 };
}

impl Drive {
    /// D840 and D8C0: copies a cam table from the EEPROM to RAM.
    pub fn init_cam(&mut self, i: &Instruction) -> Result<(), ExecuteError> {
        let [from, to] = [0, 1].map(|n| match i.opcode {
            0xD8C0 => self.memory.word(i.word(n)),
            _ => i.word(n),
        });
        let table = self.cam_table(Space::Spi, from).ok_or(ExecuteError::NotPossible)?;
        let words = table.word_count();
        for n in 0..=words {
            let word = self.memory.read(Space::Spi, from.wrapping_add(n));
            self.memory.write(Space::Data, to.wrapping_add(n), word)?;
        }
        Ok(())
    }

    /// The table that CAMSTART points to is valid.
    pub fn has_cam(&self) -> bool {
        self.cam_table(Space::Data, self.memory.word(addresses::CAMSTART)).is_some()
    }

    /// UPD in mode CS: the slave follows from where it is.
    pub fn begin_cam(&mut self) {
        let start = self.memory.word(addresses::CAMSTART);
        self.cam.table = self.cam_table(Space::Data, start);
        self.cam.output = self.cam_output();
        self.status.srh |= srh::IN_CAM;
    }

    /// Moves the reference by the cam.
    pub fn tick_cam(&mut self) {
        let output = self.cam_output();
        let way = (output - self.cam.output) / self.shaft.scale.per_rad;
        self.cam.output = output;
        let position = self.shaft.servo.setpoint().position + way;
        let velocity = way / TICK_S;
        self.shaft.servo.follow(Setpoint { position, velocity, acceleration: 0.0 });
    }

    /// The slave's position for the master's, counts.
    fn cam_output(&self) -> f64 {
        let Some(table) = self.cam.table else { return 0.0 };
        let master = self.memory.long(addresses::MREF);
        let input = f64::from(master.saturating_sub(self.memory.long(addresses::CAMOFF)))
            * self.memory.fixed(addresses::CAMX);
        let place =
            (input - f64::from(table.first_master)).max(0.0) / f64::from(1_u32 << table.step_power);
        let last = table.points - 1;
        let index = (libm::floor(place) as u32).min(last.into()) as u16;
        let share = if index == last { 0.0 } else { place - f64::from(index) };
        let [from, to] = [index, index.saturating_add(1)].map(|n| self.cam_value(n, &table, last));
        (from + share * (to - from)) * self.memory.fixed(addresses::CAMY)
    }

    fn cam_value(&self, n: u16, table: &CamTable, last: u16) -> f64 {
        f64::from(self.cam_point(table, n.min(last)))
    }

    fn cam_point(&self, table: &CamTable, n: u16) -> i32 {
        let at = table.address.wrapping_add(HEAD_WORDS + 2 * n);
        self.read_memory(table.space, at, true).cast_signed()
    }

    /// The table at an address, if its sum agrees.
    fn cam_table(&self, space: Space, address: u16) -> Option<CamTable> {
        let head = self.memory.read(space, address);
        let table = CamTable {
            space,
            address,
            points: (head & 0x1FFF) + 1,
            step_power: u32::from(head >> 13),
            first_master: self.read_memory(space, address.wrapping_add(1), true).cast_signed(),
        };
        let end = address.checked_add(table.word_count())?;
        let sum = self.memory.checksum(space, address, end - 1);
        (table.points > 1 && sum == self.memory.read(space, end)).then_some(table)
    }
}

impl CamTable {
    /// Words before the sum.
    const fn word_count(&self) -> u16 {
        HEAD_WORDS + 2 * self.points
    }
}
