//! The functions of requests.

use super::wire::Space;

/// A function code.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Function {
    /// 01.
    ReadCoils,
    /// 02.
    ReadDiscreteInputs,
    /// 03.
    ReadHoldingRegisters,
    /// 04.
    ReadInputRegisters,
    /// 05.
    WriteCoil,
    /// 06.
    WriteRegister,
    /// 0F.
    WriteCoils,
    /// 10.
    WriteRegisters,
    /// 17.
    ReadWriteRegisters,
    /// Any other, exceptions' bit included.
    Unknown(u8),
}

impl Function {
    /// The function of a code.
    #[must_use]
    pub const fn of_code(code: u8) -> Self {
        match code {
            0x01 => Self::ReadCoils,
            0x02 => Self::ReadDiscreteInputs,
            0x03 => Self::ReadHoldingRegisters,
            0x04 => Self::ReadInputRegisters,
            0x05 => Self::WriteCoil,
            0x06 => Self::WriteRegister,
            0x0F => Self::WriteCoils,
            0x10 => Self::WriteRegisters,
            0x17 => Self::ReadWriteRegisters,
            code => Self::Unknown(code),
        }
    }

    /// The code on the wire.
    #[must_use]
    #[inline(always)]
    pub const fn code(self) -> u8 {
        match self {
            Self::ReadCoils => 0x01,
            Self::ReadDiscreteInputs => 0x02,
            Self::ReadHoldingRegisters => 0x03,
            Self::ReadInputRegisters => 0x04,
            Self::WriteCoil => 0x05,
            Self::WriteRegister => 0x06,
            Self::WriteCoils => 0x0F,
            Self::WriteRegisters => 0x10,
            Self::ReadWriteRegisters => 0x17,
            Self::Unknown(code) => code,
        }
    }

    /// The space that it only reads; `None` for what does not read, or writes too.
    #[must_use]
    pub const fn read_space(self) -> Option<Space> {
        match self {
            Self::ReadCoils => Some(Space::Coil),
            Self::ReadDiscreteInputs => Some(Space::Discrete),
            Self::ReadHoldingRegisters => Some(Space::Holding),
            Self::ReadInputRegisters => Some(Space::Input),
            _ => None,
        }
    }

    /// The standard's words for it (MAP 5 and 6, those without a variant here included).
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self.code() {
            0x01 => "read coils",
            0x02 => "read discrete inputs",
            0x03 => "read holding registers",
            0x04 => "read input registers",
            0x05 => "write single coil",
            0x06 => "write single register",
            0x07 => "read exception status",
            0x08 => "diagnostics",
            0x0B => "get comm event counter",
            0x0C => "get comm event log",
            0x0F => "write multiple coils",
            0x10 => "write multiple registers",
            0x11 => "report server id",
            0x14 => "read file record",
            0x15 => "write file record",
            0x16 => "mask write register",
            0x17 => "read/write multiple registers",
            0x18 => "read fifo queue",
            0x2B => "encapsulated interface transport",
            _ => "unknown function",
        }
    }
}
