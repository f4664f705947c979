//! What every CANopen device has, for one that no profile describes. Nothing here moves a motor.

use super::host::REPLY_TIMEOUT_MS;
use crate::profile::{
    Access, AxisKind, Certainty, Encoding, Parameter, Persistence, Profile, Scale, Watchdog,
};
use crate::units::Unit;

/// Any CANopen device.
pub static GENERIC: Profile = Profile {
    name: "canopen",
    family: "canopen",
    protocol: "canopen",
    title: "CANopen device",
    source: "CiA 301",
    axis: AxisKind::Rotary,
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
    ],
    faults: &[],
    signals: &[],
    plans: &[],
    ram: None,
    link_settings: &[],
    optional: &[],
    watchdog: Watchdog::None,
    reply_timeout_ms: REPLY_TIMEOUT_MS,
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
};
