//! Keys of connection strings.

use super::technocan;
use crate::proto::SerialStandard;
use crate::proto::options::{GAP, OptionKey, OptionKind, TIMEOUT, host_key};

const STANDARDS: [SerialStandard; 2] = [SerialStandard::Rs232, SerialStandard::Rs485];

const HOST: OptionKey = host_key(1, 255);
const ACK: OptionKey = OptionKey::new(
    "ack",
    OptionKind::Milliseconds,
    "time limit of an acknowledgement",
    |options, ms| options.ack_timeout_ms = Some(ms),
);
const SETUP: OptionKey = OptionKey::for_link(
    "setup",
    OptionKind::Text,
    "set-up archive of the drive (.t.zip) or its folder, with the addresses of its firmware and the user's variables",
);

/// On CAN.
pub(super) const CAN: &[OptionKey] = &[TIMEOUT, HOST, ACK, SETUP];

/// On serial lines.
pub(super) const SERIAL: &[OptionKey] = &[
    TIMEOUT,
    GAP,
    HOST,
    ACK,
    SETUP,
    OptionKey::new(
        "wire",
        OptionKind::Word(&["rs232", "rs485"]),
        "standard of the serial line [default: rs232]",
        |options, index| options.standard = STANDARDS.get(index as usize).copied(),
    ),
    OptionKey::new(
        "pause",
        OptionKind::Milliseconds,
        "time limit of each step of synchronising the line again",
        |options, ms| options.resync_pause_ms = Some(ms),
    ),
    OptionKey::new(
        "through",
        OptionKind::Number(1, 255),
        "axis ID of the drive at the cable, if the named axes are behind it [default: the first axis is \
         that drive]",
        |options, axis| options.relay_axis = Some(axis),
    ),
    OptionKey::new(
        "relay",
        OptionKind::Word(&["tmlcan", "technocan"]),
        "protocol of the CAN bus behind the first axis; from TechnoCAN, replies of groups and unsolicited \
         messages do not come back",
        |options, index| {
            options.relay_axis_max = (index == 1).then_some(technocan::AXIS_MAX.into());
        },
    ),
];
