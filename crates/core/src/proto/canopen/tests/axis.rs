//! The generic driver: objects from parameters and back, and what nodes say unasked.

use crate::axis::{Driver, Presence, Told};
use crate::error::Unsupported;
use crate::profile::{Encoding, ParameterId};
use crate::proto::canopen::cia402::{Mode, Order, State};
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::generic::{GENERIC, P};
use crate::proto::canopen::nmt;
use crate::proto::canopen::sdo::Object;
use crate::proto::canopen::{Answer, Ask, Axis};
use crate::station::{Class, Request};

fn axis() -> Axis {
    Axis::new(&GENERIC, 2)
}

#[test]
fn values_have_the_length_and_sign_of_their_objects() {
    let mut axis = axis();
    let mut parameter = crate::profile::Parameter { ..P };
    let cases: [(Encoding, i64, u64, u8); 7] = [
        (Encoding::U8, 200, 200, 1),
        (Encoding::I8, -2, 0xFE, 1),
        (Encoding::U16, 0xFFFE, 0xFFFE, 2),
        (Encoding::I16, -2, 0xFFFE, 2),
        (Encoding::U32, 0xFFFF_FFFE, 0xFFFF_FFFE, 4),
        (Encoding::I32, -2, 0xFFFF_FFFE, 4),
        (Encoding::Bit, 1, 1, 1),
    ];
    for (encoding, raw, wire, bytes) in cases {
        parameter.encoding = encoding;
        let ask = axis.write(&parameter, raw, Class::Confirm).unwrap();
        let Ask::Write { object, bits, len, .. } = ask else { panic!("{ask:?}") };
        assert_eq!((bits, len), (wire, bytes), "{encoding:?}");
        for len in [u32::from(bytes), 0] {
            let read = Answer::Value { object, bits, len };
            assert_eq!(axis.answer(Some(&parameter), &read), Ok(raw), "{encoding:?}");
        }
        let written = Answer::Written { object, bits };
        assert_eq!(axis.answer(Some(&parameter), &written), Ok(raw));
    }
}

#[test]
fn plans_send_what_is_no_object() {
    let axis = axis();
    let start = nmt::Order { command: nmt::Command::Start, node: 2 };
    assert_eq!(axis.send(0, 1, 0), Ok(Ask::Order(start)));
    assert_eq!(axis.send(0, 3, 0), Err(Unsupported::BadArgument));
    assert!(matches!(axis.send(1, 2, 0x0F), Ok(Ask::Process { data: 0x0F, len: 2, .. })));
    assert!(axis.send(1, 9, 0).is_err() && axis.send(11, 0, 0).is_err());
}

#[test]
fn people_ask_in_words() {
    let axis = axis();
    let object = Object::new(0x6040, 0);
    assert_eq!(axis.parse("read 0x6040:0"), Ok(Ask::Read { node: 2, object }));
    assert_eq!(axis.parse("read 24640"), Ok(Ask::Read { node: 2, object }));
    let write = axis.parse("write 0x6040:0 u16 0x000F").unwrap();
    assert!(matches!(write, Ask::Write { bits: 0x0F, len: 2, .. }));
    assert_eq!(write.class(), Class::Never);
    let write = axis.parse("write 0x6098:0 i8 -18").unwrap();
    assert!(matches!(write, Ask::Write { bits: 0xEE, len: 1, .. }));
    assert!(axis.parse("nmt stop").unwrap().is_stop());
    assert_eq!(axis.parse("lss fastscan"), Ok(Ask::FastScan));
    assert_eq!(axis.parse("sync 5"), Ok(Ask::Sync(Some(5))));
    let download = Ask::Download { node: 2, object: Object::new(0x1F50, 1), block: true, size: 64 };
    assert_eq!(axis.parse("download-block 0x1F50:1 64"), Ok(download));
    assert_eq!(axis.parse("time 2026-11-21T16:00:00"), axis.parse("time 2026-11-21 16:00"));
    assert!(matches!(axis.parse("time 2026-11-21T16:00:00.250"), Ok(Ask::Time(_))));
    for wrong in ["", "read", "read 0x10000:0", "write 0x6040:0 u8 256", "nmt go", "sync now"] {
        assert_eq!(axis.parse(wrong), Err(Unsupported::BadText), "{wrong}");
    }
}

#[test]
fn process_data_mean_something_once_their_mapping_is_known() {
    let mut axis = axis();
    let data = Answer::Process(1, 0x0064_0300, 4);
    assert_eq!(axis.unasked(&data), [None; 4]);
    let mut learn = |sub, bits| {
        let object = Object::new(0x1A00, sub);
        axis.answer(None, &Answer::Written { object, bits }).unwrap();
    };
    // A gap of a byte, the error register, the heartbeat time.
    learn(0, 0);
    learn(1, 0x0005_0008);
    learn(2, 0x1001_0008);
    learn(3, 0x1017_0010);
    learn(0, 3);
    let told = [(1, 3), (2, 0x64)].map(|(id, raw)| Some(Told::Parameter(ParameterId(id), raw)));
    assert_eq!(axis.unasked(&data)[..2], told);
    assert_eq!(axis.unasked(&Answer::Process(1, 0x0064_0300, 3)), [None; 4], "too short");
    // After a restart nobody knows.
    let gone = axis.unasked(&Answer::State(nmt::State::BootUp));
    assert_eq!(gone[0], Some(Told::Presence(Presence::Restarted)));
    assert_eq!(axis.unasked(&data), [None; 4]);
}

#[test]
fn emergencies_are_faults_at_once() {
    let mut axis = axis();
    let emergency = Emergency { code: 0x2310, ..Emergency::default() };
    let told = axis.unasked(&Answer::Emergency(emergency));
    assert_eq!(told[0], Some(Told::Signal(crate::profile::Signal::Fault, 0x2310)));
}

#[test]
fn statuswords_and_controlwords_are_read_as_the_manuals_print_them() {
    let words: [(u16, State); 8] = [
        (0x0050, State::SwitchOnDisabled),
        (0x0031, State::Ready),
        (0x0033, State::SwitchedOn),
        (0x0037, State::Enabled),
        (0x0088, State::Fault),
        (0x0017, State::QuickStop),
        (0x000F, State::FaultReaction),
        (0x0000, State::NotReady),
    ];
    for (word, state) in words {
        assert_eq!(State::of(word), state, "{word:04X}");
    }
    let orders: [(u16, Order); 7] = [
        (0x06, Order::Shutdown),
        (0x07, Order::SwitchOn),
        (0x0F, Order::Enable),
        (0x5F, Order::Enable),
        (0x00, Order::DisableVoltage),
        (0x02, Order::QuickStop),
        (0x80, Order::ResetFault),
    ];
    for (word, order) in orders {
        assert_eq!(Order::of(word), order, "{word:04X}");
    }
    for number in i8::MIN..=i8::MAX {
        assert_eq!(i8::from(Mode::from(number)), number);
    }
}
