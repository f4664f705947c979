//! The driver by itself: which request a parameter, a plan's step or a text becomes, and which
//! number an answer.

use crate::axis::Driver as _;
use crate::axis::{AnswerDecoder, RequestEncoder};
use crate::error::{Failure, Unsupported};
use crate::profile::{Access, Certainty, Encoding, Parameter, Persistence, Scale};
use crate::proto::modbus::driver::{GENERIC, ModbusDriver};
use crate::proto::modbus::host_request::{Answer, HostRequest, RequestBody, WORDS_MAX};
use crate::proto::modbus::wire::{Function, Space};
use crate::station::RequestClass::{self, Idempotent, NoRetry, ReadBack, Stop};
use crate::units::Unit;

/// Numbers of the spaces in profiles.
const HOLDING: u8 = 0;
const COIL: u8 = 1;
const DISCRETE: u8 = 2;
const INPUT: u8 = 3;

const fn parameter(space: u8, index: u16, encoding: Encoding) -> Parameter {
    Parameter {
        name: "",
        symbol: "",
        about: "",
        space,
        index,
        encoding,
        unit: Unit::None,
        scale: Scale::ONE,
        min: i64::MIN,
        max: i64::MAX,
        default: None,
        access: Access::ReadWrite,
        persistence: Persistence::Volatile,
        certainty: Certainty::Documented,
        moves: false,
        section: "",
        values: &[],
        digits: &[],
        bits: &[],
    }
}

const SPEED: Parameter = parameter(HOLDING, 7, Encoding::I16);
const PLACE: Parameter = parameter(HOLDING, 0x20, Encoding::I32LowFirst);
const OUTPUT: Parameter = parameter(COIL, 3, Encoding::Bit);
const LINE: Parameter = parameter(DISCRETE, 4, Encoding::Bit);
const HEAT: Parameter = parameter(INPUT, 5, Encoding::U16);
const NOWHERE: Parameter = parameter(9, 0, Encoding::U16);

fn axis() -> ModbusDriver {
    ModbusDriver::new(&GENERIC, 17)
}

fn all() -> ModbusDriver {
    ModbusDriver::new(&GENERIC, 0)
}

fn asks(request: RequestBody, class: RequestClass) -> Result<HostRequest, Unsupported> {
    Ok(HostRequest { unit: 17, body: request, class })
}

fn reads(space: Space, start: u16, count: u16) -> Result<HostRequest, Unsupported> {
    asks(RequestBody::Read { space, start, count }, Idempotent)
}

fn words<const N: usize>(values: [u16; N]) -> [u16; WORDS_MAX] {
    let mut words = [0; WORDS_MAX];
    words[..N].copy_from_slice(&values);
    words
}

fn answer<const N: usize>(function: Function, count: u16, values: [u16; N]) -> Answer {
    Answer { unit: 17, function, start: 0, count, words: words(values) }
}

#[test]
fn the_low_byte_of_an_address_is_the_station() {
    assert_eq!(axis().address(), 17);
    assert_eq!(ModbusDriver::new(&GENERIC, 0x0111).address(), 17);
}

#[test]
fn a_parameter_is_read_where_it_lies_and_whole() {
    assert_eq!(axis().read_request(&SPEED), reads(Space::Holding, 7, 1));
    assert_eq!(axis().read_request(&PLACE), reads(Space::Holding, 0x20, 2));
    assert_eq!(axis().read_request(&OUTPUT), reads(Space::Coil, 3, 1));
    assert_eq!(axis().read_request(&LINE), reads(Space::Discrete, 4, 1));
    assert_eq!(axis().read_request(&HEAT), reads(Space::Input, 5, 1));
    assert_eq!(axis().read_request(&NOWHERE), Err(Unsupported::NoSuchParameter));
    assert!(matches!(all().read_request(&SPEED), Err(Unsupported::Forbidden(_))));
}

#[test]
fn a_write_has_the_class_it_is_given() {
    for class in [ReadBack, NoRetry, Stop] {
        let one = RequestBody::WriteRegister { address: 7, value: 0xFFFE };
        assert_eq!(axis().write_request(&SPEED, -2, class), asks(one, class));
        let two =
            RequestBody::WriteRegisters { start: 0x20, count: 2, words: words([0xFFFE, 0xFFFF]) };
        assert_eq!(axis().write_request(&PLACE, -2, class), asks(two, class));
        let coil = RequestBody::WriteCoil { address: 3, on: true };
        assert_eq!(axis().write_request(&OUTPUT, 5, class), asks(coil, class));
    }
    assert!(all().write_request(&SPEED, 1, NoRetry).is_ok(), "a broadcast may write");
}

#[test]
fn an_unwritable_message_is_refused() {
    assert_eq!(axis().write_request(&SPEED, 40_000, NoRetry), Err(Unsupported::BadArgument));
    assert_eq!(axis().write_request(&PLACE, 1 << 31, NoRetry), Err(Unsupported::BadArgument));
    assert!(matches!(axis().write_request(&LINE, 1, NoRetry), Err(Unsupported::Forbidden(_))));
    assert!(matches!(axis().write_request(&HEAT, 1, NoRetry), Err(Unsupported::Forbidden(_))));
    assert_eq!(axis().write_request(&NOWHERE, 1, NoRetry), Err(Unsupported::NoSuchParameter));
}

#[test]
fn a_step_of_a_plan_is_never_sent_twice_unless_it_reads() {
    assert_eq!(axis().function_request(3, 0x102E, 2), reads(Space::Holding, 0x102E, 2));
    assert_eq!(axis().function_request(1, 0, 256), reads(Space::Coil, 0, 256));
    let coil = RequestBody::WriteCoil { address: 9, on: false };
    assert_eq!(axis().function_request(5, 9, 0), asks(coil, NoRetry));
    for (value, word) in [(-32_768, 0x8000), (-1, 0xFFFF), (65_535, 0xFFFF)] {
        let one = RequestBody::WriteRegister { address: 9, value: word };
        assert_eq!(axis().function_request(6, 9, value), asks(one, NoRetry));
        let list = RequestBody::WriteRegisters { start: 9, count: 1, words: words([word]) };
        assert_eq!(axis().function_request(0x10, 9, value), asks(list, NoRetry));
    }
}

#[test]
fn a_step_that_says_nothing_sensible_is_refused() {
    for (function, value) in [(6, -32_769), (6, 65_536), (0x10, 65_536), (3, 0), (3, 126), (1, 257)]
    {
        let sent = axis().function_request(function, 9, value);
        assert_eq!(sent, Err(Unsupported::BadArgument), "{function} {value}");
    }
    for function in [0, 0x0F, 0x17, 0x2B] {
        assert!(matches!(axis().function_request(function, 9, 1), Err(Unsupported::Forbidden(_))));
    }
    assert!(matches!(all().function_request(3, 0, 1), Err(Unsupported::Forbidden(_))));
}

#[test]
fn no_request_keeps_a_value_over_power_off() {
    assert_eq!(axis().store_request(&SPEED), Err(Unsupported::NoPlan));
}

#[test]
fn a_text_becomes_what_it_says() {
    assert_eq!(axis().parse_request("read 0x102E 2"), reads(Space::Holding, 0x102E, 2));
    assert_eq!(axis().parse_request("inputs 0 4"), reads(Space::Discrete, 0, 4));
    let one = RequestBody::WriteRegister { address: 0x33, value: 200 };
    assert_eq!(axis().parse_request("write Fn_33 200"), asks(one, NoRetry));
    let two = RequestBody::WriteRegisters { start: 0x30, count: 2, words: words([5, 6]) };
    assert_eq!(axis().parse_request("write 0x30 5 6"), asks(two, NoRetry));
    let words = words([5]);
    let (read_start, read_count, start, count) = (0x40, 2, 0x30, 1);
    let both = RequestBody::ReadWriteRegisters { read_start, read_count, start, count, words };
    assert_eq!(axis().parse_request("write 0x30 5 read 0x40 2"), asks(both, NoRetry));
    assert_eq!(
        axis().parse_request("coil 3 on"),
        asks(RequestBody::WriteCoil { address: 3, on: true }, NoRetry)
    );
    let mut bits = [0; 32];
    bits[..2].copy_from_slice(&[0b0000_0101, 0b10]);
    let coils = RequestBody::WriteCoils { start: 4, count: 10, bits };
    assert_eq!(axis().parse_request("write coils 4 1 0 1 0 0 0 0 0 0 1"), asks(coils, NoRetry));
}

#[test]
fn a_text_that_means_nothing_is_refused() {
    let seventeen = "write registers 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17";
    for text in ["", "jump 3", "read", "write 3", "read 70000", seventeen] {
        assert_eq!(axis().parse_request(text), Err(Unsupported::BadText), "{text}");
    }
    assert!(matches!(all().parse_request("read 3"), Err(Unsupported::Forbidden(_))));
}

#[test]
fn an_answer_is_the_number_it_holds() {
    let (bits, holding) = (Function::ReadCoils, Function::ReadHoldingRegisters);
    // A drive may bring its other lines too.
    assert_eq!(axis().decode_answer(Some(&OUTPUT), &answer(bits, 1, [0b0110])), Ok(0));
    assert_eq!(axis().decode_answer(Some(&OUTPUT), &answer(bits, 1, [0b0111])), Ok(1));
    assert_eq!(axis().decode_answer(Some(&SPEED), &answer(holding, 1, [0xFFFE])), Ok(-2));
    let position = answer(holding, 2, [0xF32D, 0x000B]);
    assert_eq!(axis().decode_answer(Some(&PLACE), &position), Ok(783_149));
    assert_eq!(axis().decode_answer(None, &position), Ok(0xF32D_000B));
    let written = answer(Function::WriteRegister, 1, [0xFFFE]);
    assert_eq!(axis().decode_answer(Some(&SPEED), &written), Ok(-2));
    let list = answer(Function::WriteRegisters, 2, [0]);
    assert_eq!(axis().decode_answer(Some(&PLACE), &list), Ok(2), "how many: no value is repeated");
}

#[test]
fn an_answer_of_another_length_is_no_value() {
    for (parameter, count) in [(&SPEED, 2), (&PLACE, 1), (&PLACE, 3)] {
        let brought = answer(Function::ReadHoldingRegisters, count, [1, 2]);
        assert_eq!(axis().decode_answer(Some(parameter), &brought), Err(Failure::Misbehaved));
    }
}
