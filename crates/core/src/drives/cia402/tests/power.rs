//! The power state machine, bit by bit.

use super::*;

const DISABLED: u16 = 0x0250;
const READY: u16 = 0x0231;
const ON: u16 = 0x0233;
const ENABLED: u16 = 0x0237;

#[test]
fn every_transition_of_the_standard() {
    let mut desk = DriveFixture::new();
    let steps: [(u16, u16); 24] = [
        (0x00, DISABLED), // nothing
        (0x07, DISABLED), // switch on is not yet possible
        (0x06, READY),    // 2
        (0x00, DISABLED), // 7
        (0x06, READY),
        (0x02, DISABLED), // 7, by quick stop
        (0x06, READY),
        (0x07, ON),    // 3
        (0x06, READY), // 6
        (0x07, ON),
        (0x00, DISABLED), // 10
        (0x06, READY),
        (0x07, ON),
        (0x02, DISABLED), // 10, by quick stop
        (0x06, READY),
        (0x07, ON),
        (0x0F, ENABLED), // 4
        (0x06, READY),   // 8
        (0x0F, ENABLED), // 3 and 4
        (0x07, ON),      // 5
        (0x0F, ENABLED),
        (0x00, DISABLED), // 9
        (0x80, DISABLED), // nothing to reset
        (0x86, READY),    // bit 7 means nothing here
    ];
    for (n, (control, status)) in steps.into_iter().enumerate() {
        desk.control(control);
        desk.advance(2);
        assert_eq!(desk.status(), status, "step {n}: {control:04X}");
        assert_eq!(desk.truth().enabled, status == ENABLED);
    }
}

#[test]
fn quick_stops_end_as_their_option_says() {
    // 605Ah: state afterwards, and how long it takes from 10 turns a second, ms.
    let ends = [(0, 0x50, 0), (1, 0x50, 100), (2, 0x50, 20), (5, 0x17, 100), (6, 0x17, 20)];
    for (option, state, ms) in ends {
        let mut desk = DriveFixture::enabled(3);
        desk.write(0x605A, 0, option);
        desk.write(0x60FF, 0, 100_000);
        desk.advance(200);
        assert!((desk.turns() - 10.0).abs() < 0.2);
        desk.control(0x02);
        if ms > 0 {
            assert_eq!(desk.status() & 0x6F, 0x07, "it is quick-stopping");
            desk.advance(ms / 2);
            assert!(desk.turns() > 2.0, "{option}: too fast");
            desk.advance(ms / 2 + 60);
            assert!(desk.turns().abs() < 0.1, "{option}: {}", desk.turns());
        }
        assert_eq!(desk.status() & 0x7F, state, "{option}");
        desk.control(0x0F);
        desk.advance(2);
        let back = if state == 0x17 { 0x37 } else { 0x50 };
        assert_eq!(desk.status() & 0x7F, back, "{option}: transition 16");
    }
}

#[test]
fn disabling_brakes_first_if_told_so() {
    let mut desk = DriveFixture::enabled(3);
    desk.write(0x60FF, 0, 50_000);
    desk.advance(200);
    desk.control(0x07);
    assert_eq!(desk.status() & 0x6F, 0x27, "still enabled while it brakes");
    desk.advance(150);
    assert_eq!(desk.status() & 0x6F, 0x23);
    assert!(desk.turns().abs() < 0.1);
    desk.write(0x605C, 0, 0);
    desk.control(0x0F);
    desk.advance(200);
    desk.control(0x07);
    assert_eq!(desk.status() & 0x6F, 0x23, "at once");
    assert!(desk.turns() > 3.0, "it coasts");
}
