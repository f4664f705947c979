//! The explanation of a request encodes to that request again.

extern crate std;

use super::codec::RecordingSink;
use crate::explain::{Context, Direction, Dissector, EncodeOptions};
use crate::proto::modbus::wire::{PDU_MAX, RequestPdu, Space};
use crate::proto::modbus::{ASCII, ModbusDissector, RTU, ascii, rtu};
use std::vec::Vec;

/// Coils that a text can set at most.
const COILS_MAX: u16 = 125;

fn round_trip(dissector: ModbusDissector, frame: &[u8]) {
    let mut sink = RecordingSink::default();
    let context = Context { direction: Some(Direction::ToDrive), ..Context::default() };
    dissector.explain(frame, &context, &mut sink);
    assert_eq!(sink.error, None, "{frame:X?}");
    let (mut out, addressing) =
        ([0; 600], EncodeOptions { axis: sink.axis, ..EncodeOptions::default() });
    let encoded = dissector
        .encode(&sink.text, &addressing, &mut out)
        .unwrap_or_else(|error| panic!("{}: {error:?}", sink.text));
    assert_eq!(&out[..encoded.len], frame, "{}", sink.text);
}

fn both(unit: u8, request: &RequestPdu<'_>) {
    let mut frame = [0; ascii::FRAME_MAX];
    let len = rtu::emit(unit, &mut frame, |out| request.emit(out));
    round_trip(RTU, &frame[..len]);
    let len = ascii::emit(unit, &mut frame, |out| request.emit(out));
    round_trip(ASCII, &frame[..len]);
}

#[test]
fn every_request_encodes_from_its_explanation() {
    // Marsaglia's xorshift.
    let mut state = 7_u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let mut data = [0_u8; PDU_MAX];
    for round in 0..2_000_u16 {
        data.iter_mut().for_each(|byte| *byte = random() as u8);
        let (unit, start) = (1 + (random() % 247) as u8, random() as u16 & 0x7FFF);
        let count = |max: u16| 1 + round % max;
        for space in [Space::Holding, Space::Input, Space::Coil, Space::Discrete] {
            both(unit, &RequestPdu::Read { space, start, count: count(space.read_max()) });
        }
        let (value, on) = (random() as u16, round % 2 == 0);
        both(unit, &RequestPdu::WriteRegister { address: start, value });
        both(unit, &RequestPdu::WriteCoil { address: start, on });
        let words = 2 * usize::from(count(123));
        both(unit, &RequestPdu::WriteRegisters { start, words: &data[..words] });
        let written = &data[..2 * usize::from(count(121))];
        let (read_start, read_count) = (random() as u16 & 0x7FFF, count(125));
        both(
            unit,
            &RequestPdu::ReadWriteRegisters { read_start, read_count, start, words: written },
        );
        let lines = count(COILS_MAX);
        let mut bits: Vec<u8> = data[..usize::from(lines.div_ceil(8))].to_vec();
        if lines % 8 > 0 {
            *bits.last_mut().unwrap() &= (1 << (lines % 8)) - 1;
        }
        both(unit, &RequestPdu::WriteCoils { start, count: lines, bits: &bits });
    }
}
