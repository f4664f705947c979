//! The status registers of the drive.
//!
//! Source: the vendor's help pages on the TML registers. Bits that only the CANopen manual of the same
//! drives names are marked.

/// SRL: status, low word.
pub(super) mod srl {
    pub const CALL_WARNING: u16 = 1 << 7;
    pub const CALL_ACTIVE: u16 = 1 << 8;
    pub const MOTION_COMPLETE: u16 = 1 << 10;
    pub const EVENT: u16 = 1 << 14;
    pub const AXIS_ON: u16 = 1 << 15;
}

/// SRH: status, high word.
pub(super) mod srh {
    pub const ENDINIT: u16 = 1 << 0;
    /// The first of four position triggers.
    pub const TRIGGER_1: u16 = 1 << 1;
    pub const AUTORUN: u16 = 1 << 5;
    pub const LSP: u16 = 1 << 6;
    pub const LSN: u16 = 1 << 7;
    pub const CAPTURE: u16 = 1 << 8;
    pub const TARGET_REACHED: u16 = 1 << 9;
    pub const I2T_WARNING: u16 = 1 << 10;
    pub const IN_GEAR: u16 = 1 << 12;
    pub const IN_CAM: u16 = 1 << 14;
    pub const FAULT: u16 = 1 << 15;
}

/// MER: errors.
pub(super) mod mer {
    pub const CAN: u16 = 1 << 0;
    pub const SHORT_CIRCUIT: u16 = 1 << 1;
    pub const INVALID_SETUP: u16 = 1 << 2;
    pub const CONTROL: u16 = 1 << 3;
    pub const COMMUNICATION: u16 = 1 << 4;
    pub const FEEDBACK: u16 = 1 << 5;
    pub const LSP: u16 = 1 << 6;
    pub const LSN: u16 = 1 << 7;
    pub const OVER_CURRENT: u16 = 1 << 8;
    pub const I2T: u16 = 1 << 9;
    pub const MOTOR_HOT: u16 = 1 << 10;
    pub const DRIVE_HOT: u16 = 1 << 11;
    pub const OVER_VOLTAGE: u16 = 1 << 12;
    pub const UNDER_VOLTAGE: u16 = 1 << 13;
    pub const COMMAND: u16 = 1 << 14;
    pub const DISABLED: u16 = 1 << 15;
    /// Faults that switch the motor off until FAULTR.
    pub const FAULTS: u16 = SHORT_CIRCUIT
        | CONTROL
        | FEEDBACK
        | OVER_CURRENT
        | I2T
        | MOTOR_HOT
        | DRIVE_HOT
        | OVER_VOLTAGE
        | UNDER_VOLTAGE;
}

/// DER: errors in detail.
pub(super) mod der {
    pub const STACK_OVERFLOW: u16 = 1 << 0;
    pub const STACK_UNDERFLOW: u16 = 1 << 1;
    pub const NO_HOMING: u16 = 1 << 2;
    pub const NO_FUNCTION: u16 = 1 << 3;
    pub const UPDATE_DURING_AXISON: u16 = 1 << 4;
    pub const CALL_IGNORED: u16 = 1 << 5;
    pub const SOFTWARE_LSP: u16 = 1 << 6;
    pub const SOFTWARE_LSN: u16 = 1 << 7;
    pub const INVALID_S_CURVE: u16 = 1 << 8;
    pub const UPDATE_IGNORED: u16 = 1 << 9;
    pub const ENCODER: u16 = 1 << 10;
    pub const EEPROM_LOCKED: u16 = 1 << 15;
}

/// CER: communication errors.
pub(super) mod cer {
    pub const SERIAL_RECEIVE: u16 = 1 << 0;
    pub const SERIAL_TRANSMIT: u16 = 1 << 1;
    pub const CAN_TIMEOUT: u16 = 1 << 3;
    pub const CAN_OVERRUN: u16 = 1 << 5;
    pub const BUS_OFF: u16 = 1 << 6;
}

/// ISR and ICR: interrupt flags and their masks.
pub(super) mod isr {
    pub const ENABLE: u16 = 1 << 0;
    pub const SHORT_CIRCUIT: u16 = 1 << 1;
    pub const PROTECTION: u16 = 1 << 2;
    pub const CONTROL: u16 = 1 << 3;
    pub const LSP: u16 = 1 << 6;
    pub const LSN: u16 = 1 << 7;
    pub const CAPTURE: u16 = 1 << 8;
    pub const MOTION_COMPLETE: u16 = 1 << 9;
    pub const EVENT: u16 = 1 << 11;
    pub const POSITION_TRIGGER: u16 = 1 << 12;
    /// Interrupts that there are.
    pub const COUNT: u32 = 13;
}

/// DER2: more errors in detail.
pub(super) mod der2 {
    pub const HALL_MISSING: u16 = 1 << 5;
}

/// The registers.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Status {
    pub srl: u16,
    pub srh: u16,
    pub mer: u16,
    pub der: u16,
    pub der2: u16,
    pub cer: u16,
    pub isr: u16,
}

impl Status {
    /// Off, at rest, no errors.
    pub const NEW: Self =
        Self { srl: srl::MOTION_COMPLETE, srh: 0, mer: 0, der: 0, der2: 0, cer: 0, isr: 0 };

    /// MSR: repeats bits of other registers at its own places, and whether a contour segment is due.
    pub const fn msr(&self, segment_due: bool) -> u16 {
        const fn moved(word: u16, bit: u16, to: u32) -> u16 {
            if word & bit == 0 { 0 } else { 1 << to }
        }
        moved(self.srl, srl::AXIS_ON, 13)
            | moved(self.srl, srl::EVENT, 11)
            | moved(self.srl, srl::MOTION_COMPLETE, 9)
            | moved(self.srh, srh::CAPTURE, 8)
            | moved(self.srh, srh::LSN, 7)
            | moved(self.srh, srh::LSP, 6)
            | moved(self.mer, mer::CONTROL, 3)
            | moved(self.mer, mer::FAULTS & !mer::CONTROL, 2)
            | moved(self.der, der::UPDATE_IGNORED, 1)
            | moved(self.srh, srh::ENDINIT, 0)
            | (segment_due as u16) << 10
    }
}

/// Sets or clears bits of a register.
pub(super) const fn set_bits(register: &mut u16, bits: u16, on: bool) {
    *register = if on { *register | bits } else { *register & !bits };
}
