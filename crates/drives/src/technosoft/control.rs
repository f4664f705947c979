//! Instructions for power, stop, set-up and administration.

use super::addresses;
use super::drive::Drive;
use super::events::EventAction;
use super::execute::ExecuteError;
use super::inputs::line;
use super::status::{der, mer, set_bits, srh};
use polepair_core::proto::tml::wire::Instruction;

type ExecuteResult = Result<(), ExecuteError>;

impl Drive {
    /// 00xx and 04xx.
    pub fn execute_control(&mut self, i: &Instruction) -> ExecuteResult {
        self.mark_stale();
        match i.opcode {
            0x0001 => self.end_program(),
            0x0002 => self.axis_off(),
            0x0102 => return if self.axis_on() { Ok(()) } else { Err(ExecuteError::NotPossible) },
            0x0020 => return self.end_init(),
            0x0008 => return self.set_event_action(EventAction::Update),
            0x0108 => return self.update(),
            0x0004 | 0x0044 | 0x0084 | 0x00C4 => return self.set_event_action(EventAction::Stop),
            0x0010 => self.program.halt(true),
            0x0110 => self.program.halt(false),
            0x0440 => self.disable_stage(),
            0x0540 if !self.enable_stage() => return Err(ExecuteError::NotPossible),
            0x0104 | 0x0144 | 0x0184 | 0x01C4 => return self.stop(),
            0x0402 => self.power_up(self.clock.now()),
            0x0404 | 0x0504 => return self.return_from(i.opcode == 0x0504),
            0x0410 | 0x0510 => self.allow_interrupts(i.opcode == 0x0510),
            0x0408 => self.wait_for_event(None),
            0x0608 => self.wait_for_event(Some(i.long(0))),
            0x0401 | 0x0501 | 0x0481 => self.await_edge(line::HOME, capture_edge(i.opcode)),
            0x0601 | 0x0701 | 0x0681 => self.await_edge(line::LSN, capture_edge(i.opcode)),
            0x0620 | 0x0720 | 0x06A0 => self.await_edge(line::LSP, capture_edge(i.opcode)),
            0x0420 | 0x0520 | 0x04A0 => {
                self.surroundings.index_awaited = capture_edge(i.opcode).is_some()
            }
            0x0000 | 0x0540 | 0x649C => {} // NOP, ENPWM, BEGIN
            _ => return Err(ExecuteError::Unknown),
        }
        Ok(())
    }

    /// 08xx: axis ID, groups, baud and bit rates; 09xx takes the value from a variable.
    pub fn execute_setting(&mut self, i: &Instruction) -> ExecuteResult {
        let value = match i.opcode & 0x100 {
            0 => i.word(0),
            _ => self.memory.word(i.word(0)),
        };
        let byte = u8::try_from(value).map_err(|_| ExecuteError::NotPossible);
        match i.opcode & 0xFEFF {
            0x0801 => {
                self.axis = byte.ok().filter(|axis| *axis != 0).ok_or(ExecuteError::NotPossible)?
            }
            0x0802 => self.groups = byte?,
            0x0840 => self.groups |= byte?,
            0x0880 => self.groups &= !byte?,
            0x0820 => self.baud = rate_of_code(&BAUDS, value)?,
            0x0804 => self.bit_rate = rate_of_code(&BIT_RATES, value)?,
            0x0810 if value <= SPI_RATE_MAX => self.memory.spi_rate = value,
            0x0810 => return Err(ExecuteError::NotPossible),
            _ => return Err(ExecuteError::Unknown), // CANOC
        }
        self.mark_stale();
        Ok(())
    }

    /// 1Cxx: calls, faults, settings.
    pub fn execute_administration(&mut self, i: &Instruction) -> ExecuteResult {
        self.mark_stale();
        match i.opcode {
            0x1C01 => return self.call_cancelable(i.word(0)),
            0x1E01 => return self.call_cancelable(self.memory.word(i.word(0))),
            0x1C02 => self.abort(),
            0x1C04 => self.reset_fault(),
            0x1C08 => self.memory.save_table()?,
            opcode if opcode & 0xFF80 == 0x1C80 => return self.call_function(opcode & 0x7F),
            _ => return Err(ExecuteError::Unknown),
        }
        Ok(())
    }

    /// 95xx and 96xx: ENEEPROM unlocks, LOCKEEPROM n locks the part that n states.
    pub fn execute_lock(&mut self, i: &Instruction) -> ExecuteResult {
        self.memory.locked = if i.opcode == 0x9500 { 0 } else { (i.opcode & 3) as u8 };
        Ok(())
    }

    /// E800 to EF00: inputs and outputs under a mask. Which lines are which is fixed here. A line that
    /// was made an input is driven no more. \[I\] EA00: no homing routine is in this memory.
    pub fn execute_ports(&mut self, i: &Instruction) -> ExecuteResult {
        let mask = i.word(0);
        let value = match i.opcode {
            0xE800 => return self.set_variable(i.word(1), self.input_levels() & mask),
            0xEC00 => i.word(1),
            0xED00 => self.memory.word(i.word(1)),
            0xEE00 => {
                self.surroundings.inputs_only |= mask;
                0
            }
            0xEF00 => {
                self.surroundings.inputs_only &= !mask;
                return Ok(());
            }
            opcode if opcode & 0xFF00 == 0xEA00 => {
                return Err(ExecuteError::DerBits(der::NO_HOMING));
            }
            _ => return Err(ExecuteError::Unknown),
        };
        if value & mask & self.surroundings.inputs_only != 0 {
            return Err(ExecuteError::NotPossible);
        }
        let outputs = self.memory.word(addresses::DIGOUT_STATUS);
        self.memory.set(addresses::DIGOUT_STATUS, outputs & !mask | value & mask);
        Ok(())
    }

    /// ENDINIT: from here on the drive uses its set-up. Without a valid one it refuses. \[I\]
    fn end_init(&mut self) -> ExecuteResult {
        if self.status.mer & mer::INVALID_SETUP != 0 {
            return Err(ExecuteError::NotPossible);
        }
        set_bits(&mut self.status.srh, srh::ENDINIT, true);
        self.mark_stale();
        Ok(())
    }

    /// FAULTR: clears errors whose causes are gone. The motor stays off.
    fn reset_fault(&mut self) {
        self.status.mer &= !(mer::FAULTS | mer::COMMAND | mer::COMMUNICATION | mer::CAN);
        set_bits(&mut self.status.srh, srh::FAULT, false);
        self.status.der &= der::SOFTWARE_LSP | der::SOFTWARE_LSN;
        (self.status.cer, self.status.der2, self.protections.limits_stale) = (0, 0, true);
    }
}

/// SPIBR 0 to 3 \[I\].
const SPI_RATE_MAX: u16 = 3;
/// SCIBR 0 to 4 (field drivers; the manual prints 56600, which serial ports call 57600).
const BAUDS: [u32; 5] = [9600, 19_200, 38_400, 57_600, 115_200];
/// CANBR 0 to 4 \[I\]: the manual's five rates in its order; the data coding is not published.
const BIT_RATES: [u32; 5] = [125_000, 250_000, 500_000, 800_000, 1_000_000];

fn rate_of_code(rates: &[u32], code: u16) -> Result<u32, ExecuteError> {
    rates.get(usize::from(code)).copied().ok_or(ExecuteError::NotPossible)
}

/// ENCAPI0 and its like: bit 7 ends the watch, bit 8 selects the edge.
const fn capture_edge(opcode: u16) -> Option<bool> {
    match opcode & 0x80 {
        0 => Some(opcode & 0x100 != 0),
        _ => None,
    }
}
