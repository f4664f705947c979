//! Effects of requests of every protocol.

use polepair_core::explain::{Effect, EncodeOptions, RawFrame};
use polepair_core::proto::find_dissector;
use polepair_drives::{assumed_profile, profiles};

/// Returns the effect of a text in a protocol's own language.
fn effect_of(protocol: &str, text: &str) -> Effect {
    let dissector = find_dissector(protocol).expect("a protocol");
    let speaks = |p: &&&'static polepair_core::profile::Profile| dissector.language() == p.protocol;
    let profile = assumed_profile(dissector).or_else(|| profiles().iter().find(speaks).copied());
    let mut out = [0; 520];
    let addressing = EncodeOptions { profile, ..EncodeOptions::default() };
    let encoded = dissector.encode(text, &addressing, &mut out).expect(text);
    let raw = RawFrame { bytes: &out[..encoded.len], id: encoded.id, extended: encoded.extended };
    dissector.effect(&raw, profile)
}

#[test]
fn queries_and_stops_have_no_effect() {
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
        assert_eq!(effect_of(protocol, text), Effect::NOTHING, "{protocol} {text}");
    }
}

#[test]
fn requests_that_may_move_a_motor_are_distinguished_from_settings() {
    for (protocol, text, effect) in [
        ("tmcl", "ROR 0, 350", Effect::MOTION),
        ("tmcl", "SAP 6, 0, 100", Effect::SETTINGS),
        ("tml", "KPP=0x1234", Effect::SETTINGS),
        ("tml", "UPD", Effect::MOTION),
        ("technocan", "AXISON", Effect::MOTION),
        ("canopen", "write 0x6040:0 u16 0x000F", Effect::MOTION),
        ("canopen", "write 0x6081:0 u32 100", Effect::SETTINGS),
        ("canopen", "write 0x2000:0 u32 100", Effect::UNKNOWN),
        ("thruster", "VC 300", Effect::MOTION),
    ] {
        assert_eq!(effect_of(protocol, text), effect, "{protocol} {text}");
    }
}

#[test]
fn writes_to_permanent_memory_are_reported() {
    for (protocol, text) in [
        ("tmcl", "STAP 6, 0"),
        ("modbus-rtu", "write 0x63 1"),
        ("tml", "SAVE"),
        ("canopen", "write 0x1010:1 u32 0x65766173"),
        ("thruster", "CI 12"),
    ] {
        assert!(effect_of(protocol, text).persistent, "{protocol} {text}");
    }
}
