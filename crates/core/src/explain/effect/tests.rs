//! What requests of every protocol may do.

use super::Effect;
use crate::drives::{assumed, profiles};
use crate::explain::{Addressing, Raw};
use crate::proto::dissector;

/// Of a text in a protocol's own language.
fn of(protocol: &str, text: &str) -> Effect {
    let dissector = dissector(protocol).expect("a protocol");
    let speaks = |p: &&&'static crate::profile::Profile| dissector.language() == p.protocol;
    let profile = assumed(dissector).or_else(|| profiles().iter().find(speaks).copied());
    let mut out = [0; 520];
    let addressing = Addressing { profile, ..Addressing::default() };
    let encoded = dissector.encode(text, &addressing, &mut out).expect(text);
    let raw = Raw { bytes: &out[..encoded.len], id: encoded.id, extended: encoded.extended };
    dissector.effect(&raw, profile)
}

#[test]
fn what_asks_or_stops_does_nothing() {
    for (protocol, text) in [
        ("tmcl", "GAP 1, 0"),
        ("tmcl", "MST 0"),
        ("modbus-rtu", "read 0x33"),
        ("modbus-ascii", "read 0x33"),
        ("tml", "?KPP"),
        ("tmlcan", "STOP"),
        ("tml", "AXISOFF"),
        ("canopen", "read 0x6041:0"),
        ("thruster", "QV"),
        ("thruster", "VC 0"),
    ] {
        assert_eq!(of(protocol, text), Effect::NOTHING, "{protocol} {text}");
    }
}

#[test]
fn what_may_move_a_motor_is_told_from_what_only_sets() {
    for (protocol, text, effect) in [
        ("tmcl", "ROR 0, 350", Effect::MOVES),
        ("tmcl", "SAP 6, 0, 100", Effect::SETS),
        ("tml", "KPP=0x1234", Effect::SETS),
        ("tml", "UPD", Effect::MOVES),
        ("technocan", "AXISON", Effect::MOVES),
        ("canopen", "write 0x6040:0 u16 0x000F", Effect::MOVES),
        ("canopen", "write 0x6081:0 u32 100", Effect::SETS),
        ("canopen", "write 0x2000:0 u32 100", Effect::UNKNOWN),
        ("thruster", "VC 300", Effect::MOVES),
    ] {
        assert_eq!(of(protocol, text), effect, "{protocol} {text}");
    }
}

#[test]
fn what_reaches_permanent_memory_is_told() {
    for (protocol, text) in [
        ("tmcl", "STAP 6, 0"),
        ("modbus-rtu", "write 0x63 1"),
        ("tml", "SAVE"),
        ("canopen", "write 0x1010:1 u32 0x65766173"),
        ("thruster", "CI 12"),
    ] {
        assert!(of(protocol, text).keeps, "{protocol} {text}");
    }
}
