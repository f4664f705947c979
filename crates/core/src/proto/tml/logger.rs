//! The data logger of TML drives.
//!
//! Sources: TML_LIB's header (`TS_SetupLogger` takes the buffer, the addresses and the period,
//! `TS_StartLogger` the loop, `TS_CheckLoggerStatus` gives the points still to come); labelled frames of
//! STARTLOG and STOPLOG, which set bits 1 and 0 of the variable at 0365h. The head of the buffer is inferred
//! \[I\]: no public text has it.

use crate::data_logger::{DataLogger, LoggerLoop};

/// Address of the pointer to the buffer.
pub const LOG_POINTER: u16 = 0x0365;
/// Bits of the pointer that name the loop.
pub const LOOP_BITS: u16 = 0x0003;
/// Bits of the pointer with the start of the buffer.
pub const BUFFER_BITS: u16 = 0xFFF8;
/// Bits of STARTLOG 1.
pub const SLOW_LOOP: u16 = 1;
/// Bits of STARTLOG 2.
pub const FAST_LOOP: u16 = 2;
/// Fast loops in a slow one, in the usual set-up.
pub const FAST_LOOPS: u16 = 10;

/// The logger.
pub static LOGGER: DataLogger = DataLogger {
    pointer: "LOG_PTR",
    pointer_address: "@0x0365:u16",
    loop_bits: LOOP_BITS,
    loops: &[
        LoggerLoop { name: "slow", period_us: 1000, bits: SLOW_LOOP },
        LoggerLoop { name: "fast", period_us: 100, bits: FAST_LOOP },
    ],
    // The RAM inside the chip; some drives have more behind it (help page on the memory map, FAxx firmware).
    memory: 0x8270..=0x87FF,
    alignment: 8,
    is_layout_inferred: true,
};
