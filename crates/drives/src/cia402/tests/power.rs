//! The power state machine, bit by bit.

use super::*;

const DISABLED: u16 = 0x0250;
const READY: u16 = 0x0231;
const ON: u16 = 0x0233;
const ENABLED: u16 = 0x0237;

#[test]
fn every_transition_of_the_standard() {
    let mut fixture = DriveFixture::new();
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
        fixture.control(control);
        fixture.advance(2);
        assert_eq!(fixture.status(), status, "step {n}: {control:04X}");
        assert_eq!(fixture.truth().enabled, status == ENABLED);
    }
}

#[test]
fn quick_stops_end_as_their_option_says() {
    // 605Ah: state afterwards, and how long it takes from 10 turns a second, ms.
    let ends = [(0, 0x50, 0), (1, 0x50, 100), (2, 0x50, 20), (5, 0x17, 100), (6, 0x17, 20)];
    for (option, state, ms) in ends {
        let mut fixture = DriveFixture::enabled(3);
        fixture.write(0x605A, 0, option);
        fixture.write(0x60FF, 0, 100_000);
        fixture.advance(200);
        assert!((fixture.turns() - 10.0).abs() < 0.2);
        fixture.control(0x02);
        if ms > 0 {
            assert_eq!(fixture.status() & 0x6F, 0x07, "it is quick-stopping");
            fixture.advance(ms / 2);
            assert!(fixture.turns() > 2.0, "{option}: too fast");
            fixture.advance(ms / 2 + 60);
            assert!(fixture.turns().abs() < 0.1, "{option}: {}", fixture.turns());
        }
        assert_eq!(fixture.status() & 0x7F, state, "{option}");
        fixture.control(0x0F);
        fixture.advance(2);
        let back = if state == 0x17 { 0x37 } else { 0x50 };
        assert_eq!(fixture.status() & 0x7F, back, "{option}: transition 16");
    }
}

#[test]
fn disabling_brakes_first_if_requested() {
    let mut fixture = DriveFixture::enabled(3);
    fixture.write(0x60FF, 0, 50_000);
    fixture.advance(200);
    fixture.control(0x07);
    assert_eq!(fixture.status() & 0x6F, 0x27, "still enabled while it brakes");
    fixture.advance(150);
    assert_eq!(fixture.status() & 0x6F, 0x23);
    assert!(fixture.turns().abs() < 0.1);
    fixture.write(0x605C, 0, 0);
    fixture.control(0x0F);
    fixture.advance(200);
    fixture.control(0x07);
    assert_eq!(fixture.status() & 0x6F, 0x23, "at once");
    assert!(fixture.turns() > 3.0, "it coasts");
}
