//! Instructions that switch, stop, set up and administer.

use super::drive::Drive;
use super::execute::Refused;
use super::status::{der, mer, put, srh};
use crate::proto::tml::wire::Instruction;

type Done = Result<(), Refused>;

impl Drive {
    /// 00xx and 04xx.
    pub fn control(&mut self, i: &Instruction) -> Done {
        match i.opcode {
            0x0000 | 0x649C => Ok(()), // NOP, BEGIN
            0x0002 => self.switch_off(),
            0x0102 => self.switch_on(),
            0x0020 => self.end_init(),
            0x0402 => {
                let now = self.clock.now();
                self.power_up(now);
                Ok(())
            }
            _ => Err(Refused::Unknown),
        }
    }

    /// 08xx: axis ID, groups, baud and bit rates; 09xx takes the value from a variable.
    pub fn setting(&mut self, i: &Instruction) -> Done {
        let value = match i.opcode & 0x100 {
            0 => i.word(0),
            _ => self.memory.word(i.word(0)),
        };
        let byte = u8::try_from(value).map_err(|_| Refused::NotNow);
        match i.opcode & 0xFEFF {
            0x0801 => self.axis = byte.ok().filter(|axis| *axis != 0).ok_or(Refused::NotNow)?,
            0x0840 => self.groups |= byte?,
            0x0880 => self.groups &= !byte?,
            0x0820 => self.baud = rate(&BAUDS, value)?,
            0x0804 => self.bit_rate = rate(&BIT_RATES, value)?,
            _ => {} // SPIBR: nobody can tell
        }
        self.stale();
        Ok(())
    }

    /// 1Cxx: what administers faults, settings and calls.
    pub fn administer(&mut self, i: &Instruction) -> Done {
        match i.opcode {
            0x1C04 => self.reset_fault(),
            0x1C08 => self.memory.save_table()?,
            _ => return Err(Refused::Unknown),
        }
        self.stale();
        Ok(())
    }

    /// ENDINIT: from here on the drive uses its set-up. Without a valid one it refuses. \[I\]
    fn end_init(&mut self) -> Done {
        if self.status.mer & mer::INVALID_SETUP != 0 {
            return Err(Refused::NotNow);
        }
        put(&mut self.status.srh, srh::ENDINIT, true);
        self.stale();
        Ok(())
    }

    fn switch_on(&mut self) -> Done {
        self.stale();
        if self.axis_on() { Ok(()) } else { Err(Refused::NotNow) }
    }

    fn switch_off(&mut self) -> Done {
        self.axis_off();
        self.stale();
        Ok(())
    }

    /// FAULTR: errors go whose causes are gone. The motor stays off.
    fn reset_fault(&mut self) {
        self.status.mer &= !(mer::FAULTS | mer::COMMAND | mer::COMMUNICATION | mer::CAN);
        put(&mut self.status.srh, srh::FAULT, false);
        self.status.der &= der::SOFTWARE_LSP | der::SOFTWARE_LSN;
        (self.status.cer, self.status.der2) = (0, 0);
    }
}

/// SCIBR 0 to 4 (field drivers; the manual prints 56600, which serial ports call 57600).
const BAUDS: [u32; 5] = [9600, 19_200, 38_400, 57_600, 115_200];
/// CANBR 0 to 4 \[I\]: the manual's five rates in its order; the data coding is not published.
const BIT_RATES: [u32; 5] = [125_000, 250_000, 500_000, 800_000, 1_000_000];

fn rate(rates: &[u32], code: u16) -> Result<u32, Refused> {
    rates.get(usize::from(code)).copied().ok_or(Refused::NotNow)
}
