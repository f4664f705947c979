//! States, boot-up, heartbeats, guarding, storing.

use super::*;

#[test]
fn orders_lead_from_state_to_state() {
    let mut fixture = NodeFixture::new();
    fixture.write(0x1017, 0, 100, 2).unwrap();
    for (order, state) in [(1, 5), (2, 4), (128, 0x7F), (1, 5), (128, 0x7F), (2, 4), (1, 5)] {
        fixture.receive(frame(0, &[order, 5]));
        assert_eq!(fixture.advance(100), [frame(0x705, &[state])]);
    }
    for other in [frame(0, &[2, 6]), frame(0, &[2]), frame(0, &[99, 5])] {
        fixture.receive(other);
    }
    assert_eq!(fixture.end.state(), nmt::NmtState::Operational);
    fixture.receive(frame(0, &[128, 0]));
    assert_eq!(fixture.end.state(), nmt::NmtState::PreOperational, "0 is everybody");
    assert_eq!(fixture.answers(frame(0, &[129, 5])), [frame(0x705, &[0])]);
    assert_eq!(fixture.toy.resets, 1);
    assert_eq!(fixture.answers(frame(0, &[130, 5])), [frame(0x705, &[0])]);
    assert_eq!(fixture.toy.resets, 1, "communication alone");
    assert_eq!(fixture.read(0x1017, 0), Ok(0), "from the factory again");
}

#[test]
fn a_lost_heartbeat_is_reported_and_obeyed() {
    let mut fixture = NodeFixture::operational();
    fixture.write(0x1016, 1, 127 << 16 | 50, 4).unwrap();
    assert_eq!(fixture.write(0x1016, 2, 127 << 16 | 20, 4), Err(AbortCode::INCOMPATIBLE));
    assert_eq!(fixture.advance(500), [], "it is watched from its first heartbeat on");
    for _ in 0..5 {
        fixture.receive(frame(0x77F, &[5]));
        assert_eq!(fixture.advance(49), []);
    }
    let lost = frame(0x085, &[0x30, 0x81, 0x11, 0, 0, 0, 0, 0]);
    assert_eq!(fixture.advance(2), [lost]);
    assert_eq!((fixture.toy.losses, fixture.end.state()), (1, nmt::NmtState::PreOperational));
    assert_eq!(fixture.read(0x1001, 0), Ok(0x11));
    let well = frame(0x085, &[0; 8]);
    assert_eq!(fixture.answers(frame(0x77F, &[5])), [well]);
    assert_eq!(fixture.read(0x1001, 0), Ok(0));
    // 1029h: 1 changes nothing, 2 stops.
    for (behaviour, state) in [(1, nmt::NmtState::Operational), (2, nmt::NmtState::Stopped)] {
        fixture.write(0x1029, 1, behaviour, 1).unwrap();
        fixture.receive(frame(0, &[1, 5]));
        fixture.receive(frame(0x77F, &[5]));
        fixture.advance(60);
        assert_eq!(fixture.end.state(), state);
    }
}

#[test]
fn guarding_toggles_and_guards_back() {
    let mut fixture = NodeFixture::new();
    fixture.write(0x100C, 0, 20, 2).unwrap();
    fixture.write(0x100D, 0, 3, 1).unwrap();
    for toggle in [0, 0x80, 0, 0x80] {
        assert_eq!(fixture.answers(remote(0x705)), [frame(0x705, &[0x7F | toggle])]);
        assert_eq!(fixture.advance(59), []);
    }
    assert_eq!(fixture.advance(2)[0].data[..2], [0x30, 0x81]);
    assert_eq!(fixture.toy.losses, 1);
    fixture.write(0x1017, 0, 1000, 2).unwrap();
    assert_eq!(fixture.answers(remote(0x705)), [], "a heartbeat goes instead of guarding");
    let mut deaf = NodeFixture::with(Quirks { guarding: false, ..Quirks::STRICT });
    assert_eq!(deaf.answers(remote(0x705)), []);
}

#[test]
fn settings_are_stored_and_restored() {
    let mut fixture = NodeFixture::new();
    let save = u32::from_le_bytes(*b"save");
    fixture.write(0x1017, 0, 70, 2).unwrap();
    assert_eq!(fixture.write(0x1010, 1, 1, 4), Err(AbortCode::NOT_STORED));
    let store =
        SdoRequest::Write(ObjectIndex::new(0x1010, 1), ExpeditedData { bits: save, len: 4 })
            .emit(5);
    assert_eq!(fixture.answers(store), [], "it confirms what is stored");
    // Power goes while flash is written: what was there before stays.
    fixture.end.power_cycle(fixture.now, &mut fixture.toy);
    fixture.sent();
    assert_eq!((fixture.read(0x1017, 0), fixture.toy.stored.len()), (Ok(0), 0));
    fixture.write(0x1017, 0, 70, 2).unwrap();
    fixture.receive(store);
    assert_eq!(fixture.advance(15), []);
    let stored = SdoReply::Written(ObjectIndex::new(0x1010, 1), 0);
    assert_eq!(
        fixture.advance(15).iter().map(|sent| SdoReply::of(sent.data)).next_back(),
        Some(stored)
    );
    assert_eq!(fixture.toy.stored, [SettingsGroup::All]);
    fixture.receive(frame(0, &[129, 0]));
    fixture.sent();
    assert_eq!(fixture.read(0x1017, 0), Ok(70));
    fixture.write(0x1011, 2, u32::from_le_bytes(*b"load"), 4).unwrap();
    assert_eq!(fixture.read(0x1017, 0), Ok(70), "from the next reset on");
    fixture.receive(frame(0, &[130, 0]));
    fixture.sent();
    assert_eq!(fixture.read(0x1017, 0), Ok(0));
}

#[test]
fn the_bus_off_is_a_lost_link() {
    let mut fixture = NodeFixture::operational();
    fixture.end.handle_line(fixture.now, LineEvent::BusOff, &mut fixture.toy);
    assert_eq!(fixture.sent()[0].data[..2], [0x40, 0x81]);
    assert_eq!((fixture.toy.losses, fixture.end.state()), (1, nmt::NmtState::PreOperational));
}
