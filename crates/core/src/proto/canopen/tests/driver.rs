//! The generic driver: objects from parameters and back, and messages that nodes send unasked.

use crate::axis::{AnswerDecoder, DriveReport, Driver, Presence, RequestEncoder};
use crate::error::Unsupported;
use crate::profile::Encoding;
use crate::proto::canopen::cia402::{ControlCommand, DriveState, OperationMode};
use crate::proto::canopen::emcy::Emergency;
use crate::proto::canopen::generic::{GENERIC, P};
use crate::proto::canopen::nmt;
use crate::proto::canopen::sdo::ObjectIndex;
use crate::proto::canopen::{Answer, CanopenDriver, HostRequest};
use crate::proto::with_sub_axis;
use crate::station::{Request, RequestClass};

fn axis() -> CanopenDriver {
    CanopenDriver::new(&GENERIC, 2)
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
        let request = axis.write_request(&parameter, raw, RequestClass::ReadBack).unwrap();
        let HostRequest::Write { object, bits, len, .. } = request else { panic!("{request:?}") };
        assert_eq!((bits, len), (wire, bytes), "{encoding:?}");
        for len in [u32::from(bytes), 0] {
            let read = Answer::Value { object, bits, len };
            assert_eq!(axis.decode_answer(Some(&parameter), &read), Ok(raw), "{encoding:?}");
        }
        let written = Answer::Written { object, bits };
        assert_eq!(axis.decode_answer(Some(&parameter), &written), Ok(raw));
    }
}

#[test]
fn plans_send_what_is_no_object() {
    let axis = axis();
    let start = nmt::NmtMessage { command: nmt::NmtCommand::Start, node: 2 };
    assert_eq!(axis.function_request(0, 1, 0), Ok(HostRequest::Nmt(start)));
    assert_eq!(axis.function_request(0, 3, 0), Err(Unsupported::BadArgument));
    assert!(matches!(
        axis.function_request(1, 2, 0x0F),
        Ok(HostRequest::Process { data: 0x0F, len: 2, .. })
    ));
    assert!(axis.function_request(1, 9, 0).is_err() && axis.function_request(11, 0, 0).is_err());
}

#[test]
fn people_ask_in_words() {
    let axis = axis();
    let object = ObjectIndex::new(0x6040, 0);
    assert_eq!(axis.parse_request("read 0x6040:0"), Ok(HostRequest::Read { node: 2, object }));
    assert_eq!(axis.parse_request("read 24640"), Ok(HostRequest::Read { node: 2, object }));
    let write = axis.parse_request("write 0x6040:0 u16 0x000F").unwrap();
    assert!(matches!(write, HostRequest::Write { bits: 0x0F, len: 2, .. }));
    assert_eq!(write.class(), RequestClass::NoRetry);
    let write = axis.parse_request("write 0x6098:0 i8 -18").unwrap();
    assert!(matches!(write, HostRequest::Write { bits: 0xEE, len: 1, .. }));
    assert!(axis.parse_request("nmt stop").unwrap().is_stop());
    assert_eq!(axis.parse_request("lss fastscan"), Ok(HostRequest::FastScan));
    assert_eq!(axis.parse_request("sync 5"), Ok(HostRequest::Sync(Some(5))));
    let download = HostRequest::Download {
        node: 2,
        object: ObjectIndex::new(0x1F50, 1),
        block: true,
        size: 64,
    };
    assert_eq!(axis.parse_request("download-block 0x1F50:1 64"), Ok(download));
    assert_eq!(
        axis.parse_request("time 2026-11-21T16:00:00"),
        axis.parse_request("time 2026-11-21 16:00")
    );
    assert!(matches!(axis.parse_request("time 2026-11-21T16:00:00.250"), Ok(HostRequest::Time(_))));
    for wrong in ["", "read", "read 0x10000:0", "write 0x6040:0 u8 256", "nmt go", "sync now"] {
        assert_eq!(axis.parse_request(wrong), Err(Unsupported::BadText), "{wrong}");
    }
}

#[test]
fn process_data_mean_something_once_their_mapping_is_known() {
    let mut axis = axis();
    let data = Answer::Process(1, 0x0064_0300, 4);
    assert_eq!(axis.decode_unsolicited(&data), [None; 4]);
    let mut learn = |sub, bits| {
        let object = ObjectIndex::new(0x1A00, sub);
        axis.decode_answer(None, &Answer::Written { object, bits }).unwrap();
    };
    // A gap of a byte, the error register, the heartbeat time.
    learn(0, 0);
    learn(1, 0x0005_0008);
    learn(2, 0x1001_0008);
    learn(3, 0x1017_0010);
    learn(0, 3);
    let reports = [("error register", 3), ("heartbeat time", 0x64)].map(|(name, raw)| {
        let id = axis.profile().find_parameter(name)?;
        Some(DriveReport::Parameter(id, raw))
    });
    assert_eq!(axis.decode_unsolicited(&data)[..2], reports);
    assert_eq!(
        axis.decode_unsolicited(&Answer::Process(1, 0x0064_0300, 3)),
        [None; 4],
        "too short"
    );
    // After a restart it is unknown.
    let gone = axis.decode_unsolicited(&Answer::State(nmt::NmtState::BootUp));
    assert_eq!(gone[0], Some(DriveReport::Presence(Presence::Restarted)));
    assert_eq!(axis.decode_unsolicited(&data), [None; 4]);
}

#[test]
fn emergencies_are_faults_at_once() {
    let mut axis = axis();
    let emergency = Emergency { code: 0x2310, ..Emergency::default() };
    let reports = axis.decode_unsolicited(&Answer::Emergency(emergency));
    assert_eq!(reports[0], Some(DriveReport::Signal(crate::profile::Signal::Fault, 0x2310)));
    assert_eq!(reports[1], Some(DriveReport::Emergency(0x2310)));
}

#[test]
fn statuswords_and_controlwords_are_read_as_the_manuals_print_them() {
    let words: [(u16, DriveState); 8] = [
        (0x0050, DriveState::SwitchOnDisabled),
        (0x0031, DriveState::Ready),
        (0x0033, DriveState::SwitchedOn),
        (0x0037, DriveState::Enabled),
        (0x0088, DriveState::Fault),
        (0x0017, DriveState::QuickStop),
        (0x000F, DriveState::FaultReaction),
        (0x0000, DriveState::NotReady),
    ];
    for (word, state) in words {
        assert_eq!(DriveState::of(word), state, "{word:04X}");
    }
    let motions: [(u16, ControlCommand); 7] = [
        (0x06, ControlCommand::Shutdown),
        (0x07, ControlCommand::SwitchOn),
        (0x0F, ControlCommand::Enable),
        (0x5F, ControlCommand::Enable),
        (0x00, ControlCommand::DisableVoltage),
        (0x02, ControlCommand::QuickStop),
        (0x80, ControlCommand::ResetFault),
    ];
    for (word, control_command) in motions {
        assert_eq!(ControlCommand::of(word), control_command, "{word:04X}");
    }
    for number in i8::MIN..=i8::MAX {
        assert_eq!(i8::from(OperationMode::from(number)), number);
    }
}

#[test]
fn the_second_axis_of_a_node_has_objects_of_its_own() {
    let mut second = CanopenDriver::new(&GENERIC, with_sub_axis(5, 2));
    assert_eq!(second.address(), with_sub_axis(5, 2));
    for (index, own) in [(0x6041, 0x6841), (0x67FF, 0x6FFF), (0x1018, 0x1018), (0x6841, 0x6841)] {
        let parameter = crate::profile::Parameter { index, ..P };
        let request = second.read_request(&parameter).unwrap();
        let HostRequest::Read { node: 5, object } = request else { panic!("{request:?}") };
        assert_eq!(object.index, own);
    }
    // Process data are the first axis'; the state of the node is everybody's.
    assert!(
        second.function_request(1, 2, 0x0F).is_err() && second.function_request(6, 1, 1).is_err()
    );
    assert!(second.function_request(0, 1, 0).is_ok());
    let emergency = Answer::Emergency(Emergency { code: 0x2310, ..Emergency::default() });
    assert_eq!(second.decode_unsolicited(&emergency)[0], None);
    let booted = Answer::State(nmt::NmtState::BootUp);
    let presence = Some(DriveReport::Presence(Presence::Restarted));
    assert_eq!(second.decode_unsolicited(&booted)[0], presence);
    assert_eq!(second.address(), with_sub_axis(5, 2), "after a boot-up, too");
}

#[test]
fn a_stop_of_one_axis_waits_for_short_requests_of_another() {
    let read = |index| HostRequest::Read { node: 5, object: ObjectIndex::new(index, 0) };
    assert!(read(0x6041).is_of_other_axis(&read(0x6840)));
    assert!(!read(0x6041).is_of_other_axis(&read(0x6040)));
    assert!(!read(0x1018).is_of_other_axis(&read(0x6840)));
    let object = ObjectIndex::new(0x6041, 0);
    let long = HostRequest::Upload { node: 5, object, block: true, max: 0 };
    assert!(!long.is_of_other_axis(&read(0x6840)));
}
