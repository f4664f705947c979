//! Executes instructions that only compute: assignments, arithmetic, memory.

use super::addresses;
use super::drive::{Drive, TRIGGERS};
use super::memory::WriteRefusal;
use super::status::{der, mer};
use polepair_core::proto::tml::instruction;
use polepair_core::proto::tml::online::{MemorySpace as Space, OnlineMessage, PtPoint, PvtPoint};
use polepair_core::proto::tml::wire::{Instruction, low_first, operand_address};

/// Behind the last position trigger.
const TRIGGERS_END: u16 = addresses::POSTRIGG1 + 2 * TRIGGERS as u16;

/// Reason why an instruction was not executed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum ExecuteError {
    /// This firmware has no such instruction. \[I\] The reaction of the drive is not documented.
    Unknown,
    /// There is no memory where it wants to write.
    NoMemory,
    /// The instruction is impossible in the present state. \[I\]
    NotPossible,
    /// Bits of DER.
    DerBits(u16),
}

impl From<WriteRefusal> for ExecuteError {
    fn from(barred: WriteRefusal) -> Self {
        match barred {
            WriteRefusal::NoMemory => Self::NoMemory,
            WriteRefusal::Locked => Self::DerBits(der::EEPROM_LOCKED),
        }
    }
}

type ExecuteResult = Result<(), ExecuteError>;

impl Drive {
    /// Executes an instruction, and reports a failure in MER and DER.
    pub fn execute(&mut self, instruction: &Instruction) {
        let done = self.execute_instruction(instruction);
        self.record_error(done);
    }

    /// Reports a failure in MER and DER.
    pub fn record_error(&mut self, done: ExecuteResult) {
        let Err(refused) = done else { return };
        self.status.mer |= mer::COMMAND;
        if let ExecuteError::DerBits(bit) = refused {
            self.status.der |= bit;
        }
        self.mark_stale();
    }

    /// Carries out an instruction.
    ///
    /// # Errors
    /// Why it was not.
    pub fn execute_instruction(&mut self, i: &Instruction) -> ExecuteResult {
        if let Some(online) = OnlineMessage::parse(i) {
            return self.execute_online(&online);
        }
        if instruction::data_word_count(i.opcode) != Some(i.data().len()) {
            return Err(ExecuteError::Unknown);
        }
        // Variables that live outside of memory are brought there first, so that every instruction reads their
        // real values.
        self.publish();
        match i.opcode & 0xFC00 {
            0x0000 | 0x0400 | 0x6400 => self.execute_control(i),
            0x0800 => self.execute_setting(i),
            0x1800 | 0xC800 => self.execute_point(i),
            0x1C00 => self.execute_administration(i),
            0x2000..=0x5C00 => self.execute_assignment(i),
            0x7000 => self.set_event(i),
            0x7400 => self.jump(i),
            0x7800 | 0x7C00 => self.execute_segment(i),
            0x8000 => self.set_position(self.memory.long(operand_address(i.opcode))),
            0x8400 => self.set_position(i.long(0).cast_signed()),
            0x8800 => self.execute_shift(i),
            0x8C00 => self.execute_multiply(i),
            0x9000 => self.execute_memory_access(i),
            0x9400 if i.opcode & 0x300 == 0 => {
                self.send_instruction(i.data());
                Ok(())
            }
            0x9400 => self.execute_lock(i),
            0x9800 => self.store_remote(i),
            0x9C00 => self.fetch_remote(i),
            0xB800 | 0xBC00 => self.assign_remote(i),
            0xC000 | 0xC400 => self.send_variable(i),
            0xD800 if matches!(i.opcode, 0xD840 | 0xD8C0) => self.init_cam(i),
            0xD800 => self.execute_checksum(i),
            0xDC00 => self.execute_divide(i),
            0xE000 | 0xE400 => self.read_remote(i),
            0xE800 | 0xEC00 => self.execute_ports(i),
            _ => Err(ExecuteError::Unknown),
        }
    }

    /// Messages between drives, and points of a path.
    fn execute_online(&mut self, online: &OnlineMessage) -> ExecuteResult {
        match *online {
            OnlineMessage::Pvt(point) => return self.accept_pvt(&point),
            OnlineMessage::Pt(point) => return self.accept_pt(&point),
            OnlineMessage::Synchronisation => self.latch_time(self.clock.now()),
            OnlineMessage::MasterTime(time) => self.follow_master(time),
            OnlineMessage::SetSync(periods) => self.set_sync(periods),
            OnlineMessage::TakeData { value, .. } | OnlineMessage::GotData { value, .. } => {
                self.accept_answer(value);
            }
            _ => {}
        }
        Ok(())
    }

    /// DBxx: the sum of memory between two addresses, into a variable.
    fn execute_checksum(&mut self, i: &Instruction) -> ExecuteResult {
        let space = match i.opcode {
            0xDB10 => Space::Program,
            0xDB30 => Space::Data,
            0xDB50 => Space::Spi,
            _ => return Err(ExecuteError::Unknown), // SETWS
        };
        self.set_variable(i.word(0), self.memory.checksum(space, i.word(1), i.word(2)))
    }

    /// SETPVT, and points whose numbers are in variables.
    fn execute_point(&mut self, i: &Instruction) -> ExecuteResult {
        let counter = (i.opcode & 0x7F) as u8;
        match i.opcode & 0xFF80 {
            0x1880 => {
                self.configure_points(i.word(0));
                Ok(())
            }
            0x1900 => self.accept_pvt(&PvtPoint {
                position: self.memory.long(i.word(0)),
                velocity: self.memory.long(i.word(1)),
                time: self.memory.word(i.word(2)),
                counter,
            }),
            _ => self.accept_pt(&PtPoint {
                position: self.memory.long(i.word(0)),
                time: self.memory.word(i.word(1)),
                counter,
            }),
        }
    }

    /// 2000 to 5C00: what becomes of a variable.
    fn execute_assignment(&mut self, i: &Instruction) -> ExecuteResult {
        let (target, word) = (operand_address(i.opcode), i.word(0));
        let (v, w) = (self.memory.word(target), self.memory.word(word));
        let (v2, w2) = (self.memory.long(target), self.memory.long(word));
        let now = i.long(0).cast_signed();
        match i.opcode & 0xFC00 {
            0x2000 => self.set_variable(target, word),
            0x2400 => self.set_long_variable(target, now),
            0x2800 => self.set_variable(target, w),
            0x2C00 => self.set_long_variable(target, w2),
            0x3000 => self.set_variable(target, w.wrapping_neg()),
            0x3400 => self.set_long_variable(target, w2.wrapping_neg()),
            0x3800 => self.set_variable(target, v.wrapping_add(word)),
            0x3C00 => self.set_long_variable(target, v2.wrapping_add(now)),
            0x4000 => self.set_variable(target, v.wrapping_add(w)),
            0x4400 => self.set_long_variable(target, v2.wrapping_add(w2)),
            0x4800 => self.set_variable(target, v.wrapping_sub(word)),
            0x4C00 => self.set_long_variable(target, v2.wrapping_sub(now)),
            0x5000 => self.set_variable(target, v.wrapping_sub(w)),
            0x5400 => self.set_long_variable(target, v2.wrapping_sub(w2)),
            0x5800 => self.set_variable(target, v & word | i.word(1)),
            _ => self.set_variable(word, w & i.word(1) | i.word(2)), // SRBL
        }
    }

    /// 88xx and 89xx: shifts a variable or PROD by the number in the opcode. To the right the sign is kept.
    fn execute_shift(&mut self, i: &Instruction) -> ExecuteResult {
        let (by, target) = (u32::from(i.opcode & 0x1F), i.word(0));
        let left = i.opcode & 0x20 != 0;
        let long = |value: i32| if left { value << by } else { value >> by };
        match i.opcode & 0x01C0 {
            0x0000 => {
                let value = i32::from(self.memory.int(target));
                self.set_variable(
                    target,
                    // A shift by more than the width empties the variable, and is no error.
                    (if left { value << by.min(16) } else { value >> by }) as u16,
                )
            }
            0x0080 => {
                self.set_long_variable(addresses::PROD, long(self.memory.long(addresses::PROD)))
            }
            0x0100 => self.set_long_variable(target, long(self.memory.long(target))),
            _ => self.set_long_variable(target, i32::from(self.memory.int(i.word(1))) << by),
        }
    }

    /// 8Cxx: a product of two variables, or of one and a number, shifted, into PROD. With 8Dxx the
    /// first variable has 32 bits. \[I\] Of a product longer than PROD the low 32 bits are kept.
    fn execute_multiply(&mut self, i: &Instruction) -> ExecuteResult {
        let first = match i.opcode & 0x100 {
            0 => i64::from(self.memory.int(i.word(0))),
            _ => i64::from(self.memory.long(i.word(0))),
        };
        let second = match i.opcode & 0x80 {
            0 => i.word(1).cast_signed(),
            _ => self.memory.int(i.word(1)),
        };
        let (product, by) = (first * i64::from(second), i.opcode & 0x1F);
        // In 64 bits: the shift comes before PROD cuts the product.
        let shifted = if i.opcode & 0x20 == 0 { product >> by } else { product << by };
        self.set_long_variable(addresses::PROD, shifted as i32)
    }

    /// DC01: V32 /= V16. \[I\] The quotient is fixed-point-blind: an integer, cut toward zero.
    fn execute_divide(&mut self, i: &Instruction) -> ExecuteResult {
        let (target, by) = (i.word(0), i32::from(self.memory.int(i.word(1))));
        match self.memory.long(target).checked_div(by) {
            Some(quotient) => self.set_long_variable(target, quotient),
            None => Err(ExecuteError::NotPossible),
        }
    }

    /// 90xx writes to memory, 91xx reads from it: directly, or through a pointer variable that
    /// moves on unless bit 7 is set.
    fn execute_memory_access(&mut self, i: &Instruction) -> ExecuteResult {
        let (opcode, variable, space) = (i.opcode, i.word(0), space_of_opcode(i.opcode));
        let space = space.ok_or(ExecuteError::Unknown)?;
        let long = opcode & 1 != 0;
        if opcode & 0x100 != 0 {
            let from = self.pointer_target(i.word(1), long, opcode & 0x80 == 0)?;
            let value = self.read_memory(space, from, long);
            return self.write_memory(Space::Data, variable, value, long);
        }
        let value = match opcode & 0x10 {
            0 if long => i.long(1),
            0 => i.word(1).into(),
            _ => self.read_memory(Space::Data, i.word(1), long),
        };
        let to = match opcode & 0x20 {
            0 if opcode & 0x80 == 0 => variable,
            _ => self.pointer_target(variable, long, opcode & 0x80 == 0)?,
        };
        self.write_memory(space, to, value, long)
    }

    /// Address in a pointer variable, which is then advanced if the instruction states it.
    fn pointer_target(
        &mut self,
        pointer: u16,
        long: bool,
        onward: bool,
    ) -> Result<u16, ExecuteError> {
        // The old address is the one that is used; the pointer moves behind it.
        let address = self.memory.word(pointer);
        if onward {
            self.set_variable(pointer, address.wrapping_add(1 + u16::from(long)))?;
        }
        Ok(address)
    }

    /// One or two words of memory.
    pub fn read_memory(&self, space: Space, address: u16, long: bool) -> u32 {
        let low = u32::from(self.memory.read(space, address));
        if long { low | self.high_word(space, address) << 16 } else { low }
    }

    fn high_word(&self, space: Space, address: u16) -> u32 {
        u32::from(self.memory.read(space, address.wrapping_add(1)))
    }

    fn write_memory(
        &mut self,
        space: Space,
        address: u16,
        value: u32,
        long: bool,
    ) -> ExecuteResult {
        match (space, long) {
            (Space::Data, false) => self.set_variable(address, value as u16),
            (Space::Data, true) => self.set_long_variable(address, value.cast_signed()),
            (_, false) => self.write_program_memory(space, address, &[value as u16]),
            (_, true) => self.write_program_memory(space, address, &low_first(value)),
        }
    }

    /// Writes to program memory. The EEPROM takes its time for each write \[I\]: later messages are
    /// executed, and answered when it is ready (TML_LIB_light polls until then).
    fn write_program_memory(&mut self, space: Space, address: u16, words: &[u16]) -> ExecuteResult {
        let before = self.memory.writes;
        let mut at = (address..=u16::MAX).zip(words);
        at.try_for_each(|(at, word)| self.memory.write(space, at, *word))?;
        if self.memory.writes != before {
            // Writes queue up: each takes its time after the one before.
            let free = self.busy_until.max(self.clock.now());
            self.busy_until = free.plus_ms(self.options.eeprom_ms);
        }
        Ok(())
    }

    /// Writes a 16-bit variable.
    pub fn set_variable(&mut self, address: u16, value: u16) -> ExecuteResult {
        self.memory.write(Space::Data, address, value)?;
        self.handle_written(address);
        Ok(())
    }

    /// Writes a 32-bit variable.
    pub fn set_long_variable(&mut self, address: u16, value: i32) -> ExecuteResult {
        // Low word first, as the firmware stores it (TML communication manual, chapter 2).
        self.memory.write(Space::Data, address, value as u16)?;
        self.memory.write(Space::Data, address.wrapping_add(1), (value >> 16) as u16)?;
        self.handle_written(address);
        Ok(())
    }

    /// Reacts to a write to an address with a function. Status and measurements ignore writes: the next read
    /// returns the real value.
    fn handle_written(&mut self, address: u16) {
        let now = self.clock.now();
        match address {
            addresses::APOS | 0x0229 => self.shaft.set_count(self.memory.long(addresses::APOS)),
            addresses::ATIME => {
                self.clock.set_absolute(now, self.memory.long(addresses::ATIME).cast_unsigned())
            }
            addresses::RTIME => {
                self.clock.set_relative(now, self.memory.long(addresses::RTIME).cast_unsigned())
            }
            addresses::ISR => self.status.isr &= self.memory.word(addresses::ISR),
            addresses::AAR => {
                let [groups, axis] = self.memory.word(addresses::AAR).to_be_bytes();
                // Axis 0 is the broadcast, so no drive has it.
                (self.axis, self.groups) = (axis.max(1), groups);
            }
            addresses::KPP | 0x025F => {
                // The gain is a mantissa and a shift, in two words behind each other.
                let shift = i32::from(self.memory.int(addresses::KPP + 1)).clamp(0, 15);
                let gain = f64::from(self.memory.word(addresses::KPP)) * f64::from(1 << shift);
                self.shaft.set_gain(gain);
            }
            addresses::TPOS | 0x02B3 => self.move_reference(),
            addresses::POSTRIGG1..TRIGGERS_END => self.set_trigger(address),
            addresses::SRH_MASK
            | addresses::MER_MASK
            | addresses::PVTSENDOFF
            | addresses::MASTERID => self.read_masks(),
            _ if address == self.options.srl_mask => self.read_masks(),
            _ => {}
        }
        // Any variable may be a limit. They are worked out anew at the next tick, once for all writes of a
        // message.
        self.protections.limits_stale = true;
        self.mark_stale();
    }

    fn set_position(&mut self, count: i32) -> ExecuteResult {
        self.shaft.set_count(count);
        self.mark_stale();
        Ok(())
    }
}

/// The memory that an opcode names in bits 3 and 2.
pub(super) const fn space_of_opcode(opcode: u16) -> Option<Space> {
    match opcode >> 2 & 3 {
        0 => Some(Space::Program),
        1 => Some(Space::Data),
        2 => Some(Space::Spi),
        _ => None,
    }
}
