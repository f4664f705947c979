//! What instructions do that only compute: assignments, arithmetic, memory.

use super::at;
use super::drive::{Drive, TRIGGERS};
use super::memory::Barred;
use super::status::{der, mer};
use crate::proto::tml::instruction;
use crate::proto::tml::online::{Memory as Space, Online, PtPoint, PvtPoint};
use crate::proto::tml::wire::{Instruction, low_first, operand_address};

/// Behind the last position trigger.
const TRIGGERS_END: u16 = at::POSTRIGG1 + 2 * TRIGGERS as u16;

/// Why an instruction was not carried out.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Refused {
    /// This firmware has no such instruction. \[I\] What the drive does then is not documented.
    Unknown,
    /// There is no memory where it wants to write.
    Nowhere,
    /// It cannot be done as things are. \[I\]
    NotNow,
    /// What DER tells.
    Detail(u16),
}

impl From<Barred> for Refused {
    fn from(barred: Barred) -> Self {
        match barred {
            Barred::Nowhere => Self::Nowhere,
            Barred::Locked => Self::Detail(der::EEPROM_LOCKED),
        }
    }
}

type Done = Result<(), Refused>;

impl Drive {
    /// Carries out an instruction and tells MER and DER if it could not.
    pub fn execute(&mut self, instruction: &Instruction) {
        let done = self.obey(instruction);
        self.note(done);
    }

    /// Tells MER and DER of what could not be done.
    pub fn note(&mut self, done: Done) {
        let Err(refused) = done else { return };
        self.status.mer |= mer::COMMAND;
        if let Refused::Detail(bit) = refused {
            self.status.der |= bit;
        }
        self.stale();
    }

    /// Carries out an instruction.
    ///
    /// # Errors
    /// Why it was not.
    pub fn obey(&mut self, i: &Instruction) -> Done {
        if let Some(online) = Online::parse(i) {
            return self.obey_online(&online);
        }
        if instruction::words(i.opcode) != Some(i.data().len()) {
            return Err(Refused::Unknown);
        }
        self.publish();
        match i.opcode & 0xFC00 {
            0x0000 | 0x0400 | 0x6400 => self.control(i),
            0x0800 => self.setting(i),
            0x1800 | 0xC800 => self.point(i),
            0x1C00 => self.administer(i),
            0x2000..=0x5C00 => self.assign(i),
            0x7000 => self.set_event(i),
            0x7400 => self.jump(i),
            0x8000 => self.set_position(self.memory.long(operand_address(i.opcode))),
            0x8400 => self.set_position(i.long(0).cast_signed()),
            0x8800 => self.shift(i),
            0x8C00 => self.multiply(i),
            0x9000 => self.access(i),
            0x9400 if i.opcode & 0x300 == 0 => {
                self.send_instruction(i.data());
                Ok(())
            }
            0x9400 => self.lock(i),
            0x9800 => self.store_remote(i),
            0x9C00 => self.fetch_remote(i),
            0xB800 | 0xBC00 => self.assign_remote(i),
            0xD800 => self.sum_up(i),
            0xDC00 => self.divide(i),
            0xE000 | 0xE400 => self.read_remote(i),
            0xE800 | 0xEC00 => self.ports(i),
            _ => Err(Refused::Unknown),
        }
    }

    /// What drives tell drives, and points of a path.
    fn obey_online(&mut self, online: &Online) -> Done {
        match *online {
            Online::Pvt(point) => return self.take_pvt(&point),
            Online::Pt(point) => return self.take_pt(&point),
            Online::Synchronisation => self.latch_time(self.clock.now()),
            Online::MasterTime(time) => self.follow_master(time),
            Online::SetSync(periods) => self.set_sync(periods),
            Online::TakeData { value, .. } | Online::GotData { value, .. } => {
                self.take_answer(value);
            }
            _ => {}
        }
        Ok(())
    }

    /// DBxx: the sum of memory between two addresses, into a variable.
    fn sum_up(&mut self, i: &Instruction) -> Done {
        let space = match i.opcode {
            0xDB10 => Space::Program,
            0xDB30 => Space::Data,
            0xDB50 => Space::Spi,
            _ => return Err(Refused::Unknown), // INITCAM
        };
        self.set(i.word(0), self.memory.checksum(space, i.word(1), i.word(2)))
    }

    /// SETPVT, and points whose numbers are in variables.
    fn point(&mut self, i: &Instruction) -> Done {
        let counter = (i.opcode & 0x7F) as u8;
        match i.opcode & 0xFF80 {
            0x1880 => {
                self.set_points(i.word(0));
                Ok(())
            }
            0x1900 => self.take_pvt(&PvtPoint {
                position: self.memory.long(i.word(0)),
                velocity: self.memory.long(i.word(1)),
                time: self.memory.word(i.word(2)),
                counter,
            }),
            _ => self.take_pt(&PtPoint {
                position: self.memory.long(i.word(0)),
                time: self.memory.word(i.word(1)),
                counter,
            }),
        }
    }

    /// 2000 to 5C00: what becomes of a variable.
    fn assign(&mut self, i: &Instruction) -> Done {
        let (target, word) = (operand_address(i.opcode), i.word(0));
        let (v, w) = (self.memory.word(target), self.memory.word(word));
        let (v2, w2) = (self.memory.long(target), self.memory.long(word));
        let now = i.long(0).cast_signed();
        match i.opcode & 0xFC00 {
            0x2000 => self.set(target, word),
            0x2400 => self.set_long(target, now),
            0x2800 => self.set(target, w),
            0x2C00 => self.set_long(target, w2),
            0x3000 => self.set(target, w.wrapping_neg()),
            0x3400 => self.set_long(target, w2.wrapping_neg()),
            0x3800 => self.set(target, v.wrapping_add(word)),
            0x3C00 => self.set_long(target, v2.wrapping_add(now)),
            0x4000 => self.set(target, v.wrapping_add(w)),
            0x4400 => self.set_long(target, v2.wrapping_add(w2)),
            0x4800 => self.set(target, v.wrapping_sub(word)),
            0x4C00 => self.set_long(target, v2.wrapping_sub(now)),
            0x5000 => self.set(target, v.wrapping_sub(w)),
            0x5400 => self.set_long(target, v2.wrapping_sub(w2)),
            0x5800 => self.set(target, v & word | i.word(1)),
            _ => self.set(word, w & i.word(1) | i.word(2)), // SRBL
        }
    }

    /// 88xx and 89xx: shifts of a variable or of PROD by as much as the opcode says. To the right
    /// the sign is kept.
    fn shift(&mut self, i: &Instruction) -> Done {
        let (by, target) = (u32::from(i.opcode & 0x1F), i.word(0));
        let left = i.opcode & 0x20 != 0;
        let long = |value: i32| if left { value << by } else { value >> by };
        match i.opcode & 0x01C0 {
            0x0000 => {
                let value = i32::from(self.memory.int(target));
                self.set(target, (if left { value << by.min(16) } else { value >> by }) as u16)
            }
            0x0080 => self.set_long(at::PROD, long(self.memory.long(at::PROD))),
            0x0100 => self.set_long(target, long(self.memory.long(target))),
            _ => self.set_long(target, i32::from(self.memory.int(i.word(1))) << by),
        }
    }

    /// 8Cxx: a product of two variables, or of one and a number, shifted, into PROD. With 8Dxx the
    /// first variable has 32 bits. \[I\] Of a product longer than PROD the low 32 bits are kept.
    fn multiply(&mut self, i: &Instruction) -> Done {
        let first = match i.opcode & 0x100 {
            0 => i64::from(self.memory.int(i.word(0))),
            _ => i64::from(self.memory.long(i.word(0))),
        };
        let second = match i.opcode & 0x80 {
            0 => i.word(1).cast_signed(),
            _ => self.memory.int(i.word(1)),
        };
        let (product, by) = (first * i64::from(second), i.opcode & 0x1F);
        let shifted = if i.opcode & 0x20 == 0 { product >> by } else { product << by };
        self.set_long(at::PROD, shifted as i32)
    }

    /// DC01: V32 /= V16. \[I\] The quotient is fixed-point-blind: an integer, cut toward zero.
    fn divide(&mut self, i: &Instruction) -> Done {
        let (target, by) = (i.word(0), i32::from(self.memory.int(i.word(1))));
        match self.memory.long(target).checked_div(by) {
            Some(quotient) => self.set_long(target, quotient),
            None => Err(Refused::NotNow),
        }
    }

    /// 90xx writes to memory, 91xx reads from it: directly, or through a pointer variable that
    /// moves on unless bit 7 is set.
    fn access(&mut self, i: &Instruction) -> Done {
        let (opcode, variable, space) = (i.opcode, i.word(0), space_of(i.opcode));
        let space = space.ok_or(Refused::Unknown)?;
        let long = opcode & 1 != 0;
        if opcode & 0x100 != 0 {
            let from = self.pointed(i.word(1), long, opcode & 0x80 == 0)?;
            let value = self.fetch(space, from, long);
            return self.store(Space::Data, variable, value, long);
        }
        let value = match opcode & 0x10 {
            0 if long => i.long(1),
            0 => i.word(1).into(),
            _ => self.fetch(Space::Data, i.word(1), long),
        };
        let to = match opcode & 0x20 {
            0 if opcode & 0x80 == 0 => variable,
            _ => self.pointed(variable, long, opcode & 0x80 == 0)?,
        };
        self.store(space, to, value, long)
    }

    /// Where a pointer variable points, which then moves on if it is told to.
    fn pointed(&mut self, pointer: u16, long: bool, onward: bool) -> Result<u16, Refused> {
        let address = self.memory.word(pointer);
        if onward {
            self.set(pointer, address.wrapping_add(1 + u16::from(long)))?;
        }
        Ok(address)
    }

    /// One or two words of memory.
    pub fn fetch(&self, space: Space, address: u16, long: bool) -> u32 {
        let low = u32::from(self.memory.read(space, address));
        let high = || u32::from(self.memory.read(space, address.wrapping_add(1)));
        if long { low | high() << 16 } else { low }
    }

    fn store(&mut self, space: Space, address: u16, value: u32, long: bool) -> Done {
        match (space, long) {
            (Space::Data, false) => self.set(address, value as u16),
            (Space::Data, true) => self.set_long(address, value.cast_signed()),
            (_, false) => self.burn(space, address, &[value as u16]),
            (_, true) => self.burn(space, address, &low_first(value)),
        }
    }

    /// Writes to program memory. The EEPROM takes its time for each write \[I\]: what comes meanwhile
    /// is done, and answered when it is ready (TML_LIB_light polls until then).
    fn burn(&mut self, space: Space, address: u16, words: &[u16]) -> Done {
        let before = self.memory.writes;
        let mut at = (address..=u16::MAX).zip(words);
        at.try_for_each(|(at, word)| self.memory.write(space, at, *word))?;
        if self.memory.writes != before {
            let free = self.busy_until.max(self.clock.now());
            self.busy_until = free.plus_ms(self.options.eeprom_ms);
        }
        Ok(())
    }

    /// Writes a 16-bit variable.
    pub fn set(&mut self, address: u16, value: u16) -> Done {
        self.memory.write(Space::Data, address, value)?;
        self.written(address);
        Ok(())
    }

    /// Writes a 32-bit variable.
    pub fn set_long(&mut self, address: u16, value: i32) -> Done {
        self.memory.write(Space::Data, address, value as u16)?;
        self.memory.write(Space::Data, address.wrapping_add(1), (value >> 16) as u16)?;
        self.written(address);
        Ok(())
    }

    /// What is more than memory takes what was written. Status and measurements take nothing: the
    /// next reader finds them as they are.
    fn written(&mut self, address: u16) {
        let now = self.clock.now();
        match address {
            at::APOS | 0x0229 => self.shaft.set_count(self.memory.long(at::APOS)),
            at::ATIME => self.clock.set_absolute(now, self.memory.long(at::ATIME).cast_unsigned()),
            at::RTIME => self.clock.set_relative(now, self.memory.long(at::RTIME).cast_unsigned()),
            at::ISR => self.status.isr &= self.memory.word(at::ISR),
            at::AAR => {
                let [groups, axis] = self.memory.word(at::AAR).to_be_bytes();
                (self.axis, self.groups) = (axis.max(1), groups);
            }
            at::KPP | 0x025F => {
                let shift = i32::from(self.memory.int(at::KPP + 1)).clamp(0, 15);
                let gain = f64::from(self.memory.word(at::KPP)) * f64::from(1 << shift);
                self.shaft.set_gain(gain);
            }
            at::TPOS | 0x02B3 => self.move_reference(),
            at::POSTRIGG1..TRIGGERS_END => self.set_trigger(address),
            at::SRH_MASK | at::MER_MASK | at::PVTSENDOFF | at::MASTERID => self.read_masks(),
            _ if address == self.options.srl_mask => self.read_masks(),
            _ => {}
        }
        self.guard.old = true;
        self.stale();
    }

    fn set_position(&mut self, count: i32) -> Done {
        self.shaft.set_count(count);
        self.stale();
        Ok(())
    }
}

/// The memory that an opcode names in bits 3 and 2.
pub(super) const fn space_of(opcode: u16) -> Option<Space> {
    match opcode >> 2 & 3 {
        0 => Some(Space::Program),
        1 => Some(Space::Data),
        2 => Some(Space::Spi),
        _ => None,
    }
}
