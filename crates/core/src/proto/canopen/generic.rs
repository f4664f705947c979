//! Objects of every CANopen device, for devices without a profile. None of them moves a motor but the controlword of
//! CiA 402, which also stops a drive of unknown identity: 2 enables no drive, whatever its state, and a device without
//! that object refuses it.

use super::host::REPLY_TIMEOUT_MS;
use crate::axis::Verb;
use crate::plan::{Operand, Plan, Step};
use crate::profile::{
    Access, AxisKind, Certainty, Encoding, MotionRules, Parameter, ParameterId, Persistence,
    Profile, Scale, Watchdog,
};
use crate::units::Unit;

const QUICK_STOP: &[Step] = &[Step::Write(ParameterId(29), Operand::Constant(2))];

/// Any CANopen device.
pub static GENERIC: Profile = Profile {
    name: "canopen",
    family: "canopen",
    protocol: "canopen",
    title: "CANopen device",
    source: "CiA 301",
    axis: AxisKind::Rotary,
    motors: 0,
    further_motors: &[],
    lists_motors: false,
    parameters: &[
        Parameter {
            name: "device type",
            symbol: "1000h",
            about: "Lower half: number of the device profile, 402 for drives.",
            section: "7.5.2.1",
            ..P
        },
        Parameter {
            name: "error register",
            symbol: "1001h",
            index: 0x1001,
            encoding: Encoding::U8,
            max: 0xFF,
            about: "Bit 0 any, 1 current, 2 voltage, 3 temperature, 4 communication, 5 profile, \
                    7 maker's.",
            section: "7.5.2.2",
            ..P
        },
        Parameter {
            name: "status register",
            symbol: "1002h",
            index: 0x1002,
            about: "The maker's own bits.",
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "errors kept",
            symbol: "1003h",
            index: 0x1003,
            encoding: Encoding::U8,
            max: 0xFF,
            about: "Number of errors that the device keeps; 0 written forgets them.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "last error",
            symbol: "1003h:1",
            index: 0x1003,
            space: 1,
            about: "Emergency code in the lower half, the maker's own in the upper.",
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "sync identifier",
            symbol: "1005h",
            index: 0x1005,
            about: "Bit 30: the device sends SYNC itself.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "sync period",
            symbol: "1006h",
            index: 0x1006,
            about: "In microseconds; 0 is none.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "sync window",
            symbol: "1007h",
            index: 0x1007,
            about: "In microseconds; 0 is none.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "device name",
            symbol: "1008h",
            index: 0x1008,
            encoding: Encoding::Text,
            max: -1,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "hardware version",
            symbol: "1009h",
            index: 0x1009,
            encoding: Encoding::Text,
            max: -1,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "software version",
            symbol: "100Ah",
            index: 0x100A,
            encoding: Encoding::Text,
            max: -1,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "guard time",
            symbol: "100Ch",
            index: 0x100C,
            encoding: Encoding::U16,
            max: 0xFFFF,
            about: "Times the life time factor: how long the device waits for its host.",
            access: Access::ReadWrite,
            unit: Unit::Millisecond,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "life time factor",
            symbol: "100Dh",
            index: 0x100D,
            encoding: Encoding::U8,
            max: 0xFF,
            about: "0 switches guarding off.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "store all",
            symbol: "1010h:1",
            index: 0x1010,
            space: 1,
            about: "0x65766173 stores all objects that can be stored.",
            access: Access::ReadWrite,
            persistence: Persistence::Always,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "restore all",
            symbol: "1011h:1",
            index: 0x1011,
            space: 1,
            about: "0x64616F6C brings back the factory's values at the next start.",
            access: Access::ReadWrite,
            persistence: Persistence::Always,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "emergency identifier",
            symbol: "1014h",
            index: 0x1014,
            about: "Bit 31: the device sends no emergency messages.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "emergency inhibit time",
            symbol: "1015h",
            index: 0x1015,
            encoding: Encoding::U16,
            max: 0xFFFF,
            about: "In units of 100 microseconds.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "heartbeat consumer",
            symbol: "1016h:1",
            index: 0x1016,
            space: 1,
            about: "Node in bits 16 to 22, time in ms in bits 0 to 15.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "heartbeat time",
            symbol: "1017h",
            index: 0x1017,
            encoding: Encoding::U16,
            max: 0xFFFF,
            unit: Unit::Millisecond,
            about: "Period of the device's heartbeat; 0 is none.",
            access: Access::ReadWrite,
            section: "7.5.2.19",
            ..P
        },
        Parameter {
            name: "vendor id",
            symbol: "1018h:1",
            index: 0x1018,
            space: 1,
            section: "7.5.2.20",
            ..P
        },
        Parameter {
            name: "product code",
            symbol: "1018h:2",
            index: 0x1018,
            space: 2,
            section: "7.5.2.20",
            ..P
        },
        Parameter {
            name: "revision number",
            symbol: "1018h:3",
            index: 0x1018,
            space: 3,
            section: "7.5.2.20",
            ..P
        },
        Parameter {
            name: "serial number",
            symbol: "1018h:4",
            index: 0x1018,
            space: 4,
            section: "7.5.2.20",
            ..P
        },
        Parameter {
            name: "sync counter overflow",
            symbol: "1019h",
            index: 0x1019,
            encoding: Encoding::U8,
            max: 0xFF,
            about: "0: SYNC has no counter.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "error behaviour",
            symbol: "1029h:1",
            index: 0x1029,
            space: 1,
            encoding: Encoding::U8,
            max: 0xFF,
            about: "State after a communication error: 0 pre-operational, 1 no change, 2 stopped.",
            access: Access::ReadWrite,
            section: "CiA 301",
            ..P
        },
        Parameter {
            name: "program data",
            symbol: "1F50h:1",
            index: 0x1F50,
            space: 1,
            encoding: Encoding::Bytes,
            max: -1,
            about: "Firmware: written in one transfer. See also 1F51h and 1F57h.",
            access: Access::ReadWrite,
            persistence: Persistence::Always,
            section: "CiA 302-3",
            ..P
        },
        Parameter {
            name: "program control",
            symbol: "1F51h:1",
            index: 0x1F51,
            space: 1,
            encoding: Encoding::U8,
            max: 0xFF,
            about: "0 stop, 1 start, 2 reset, 3 clear the program.",
            access: Access::ReadWrite,
            moves: true,
            section: "CiA 302-3",
            ..P
        },
        Parameter {
            name: "program identification",
            symbol: "1F56h:1",
            index: 0x1F56,
            space: 1,
            about: "A number that tells programs apart; 0 is no valid one.",
            section: "CiA 302-3",
            ..P
        },
        Parameter {
            name: "flash status",
            symbol: "1F57h:1",
            index: 0x1F57,
            space: 1,
            about: "Bit 0: busy. Bits 1 to 7: error, 0 none, 1 no valid program, 5 flash failed.",
            section: "CiA 302-3",
            ..P
        },
        Parameter {
            name: "controlword",
            symbol: "6040h",
            index: 0x6040,
            encoding: Encoding::U16,
            max: 0xFFFF,
            about: "Of a drive; 2 is quick stop.",
            access: Access::Write,
            moves: true,
            section: "CiA 402-2",
            ..P
        },
    ],
    faults: &[],
    signals: &[],
    plans: &[
        Plan { verb: Verb::Stop, source: "CiA 402-2, quick stop", steps: QUICK_STOP, undo: &[] },
        Plan { verb: Verb::QuickStop, source: "CiA 402-2", steps: QUICK_STOP, undo: &[] },
    ],
    ram: None,
    link_settings: &[],
    optional: &[],
    motion: MotionRules::NONE,
    watchdog: Watchdog::None,
    reply_timeout_ms: REPLY_TIMEOUT_MS,
    multiple_writes: false,
    line: None,
    identity: None,
    caution: "Nothing is known of this device but that it speaks CANopen: objects can be read and \
              written by number. Give its data sheet or a profile with profile=NAME.",
};

pub(super) const P: Parameter = Parameter {
    name: "",
    symbol: "",
    about: "",
    space: 0,
    index: 0x1000,
    encoding: Encoding::U32,
    unit: Unit::None,
    scale: Scale::ONE,
    min: 0,
    max: u32::MAX as i64,
    default: None,
    access: Access::Read,
    persistence: Persistence::Volatile,
    certainty: Certainty::Documented,
    moves: false,
    section: "",
    values: &[],
    digits: &[],
    bits: &[],
};
