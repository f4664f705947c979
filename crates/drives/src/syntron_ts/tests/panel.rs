use super::*;

const MODE: u8 = 0;
const SET: u8 = 1;
const UP: u8 = 2;
const DOWN: u8 = 3;

impl DriveFixture {
    fn press(&mut self, key: u8) {
        self.act(Act::Key(key, true));
        self.advance(100);
        self.act(Act::Key(key, false));
        self.advance(100);
    }

    fn hold(&mut self, key: u8) {
        self.act(Act::Key(key, true));
        self.advance(1100);
        self.act(Act::Key(key, false));
        self.advance(100);
    }

    /// Digits while the blinking part is lit.
    fn lit(&mut self) -> std::string::String {
        while (self.now.0 / 250_000_000) % 2 == 1 {
            self.advance(10);
        }
        self.shown()
    }

    /// Digits while it is dark.
    fn dark(&mut self) -> std::string::String {
        while (self.now.0 / 250_000_000).is_multiple_of(2) {
            self.advance(10);
        }
        self.shown()
    }
}

/// TS manual V2 §1.4.2, key by key: Fn_33 is set to 250.
#[test]
fn a_parameter_is_edited_key_by_key() {
    let mut fixture = DriveFixture::new();
    assert_eq!(fixture.lit(), "rdy");
    fixture.press(MODE);
    assert_eq!((fixture.lit(), fixture.dark()), ("Fn_00".into(), "Fn_0 ".into()));
    for _ in 0..3 {
        fixture.press(UP);
    }
    fixture.press(SET);
    assert_eq!(fixture.dark(), "Fn_ 3");
    for _ in 0..4 {
        fixture.press(UP);
    }
    fixture.press(DOWN);
    assert_eq!(fixture.lit(), "Fn_33");
    fixture.hold(SET);
    assert_eq!((fixture.lit(), fixture.dark()), ("0".into(), " ".into()));
    fixture.press(SET);
    assert_eq!(fixture.lit(), "00");
    for _ in 0..5 {
        fixture.press(UP);
    }
    fixture.press(SET);
    fixture.press(UP);
    fixture.press(UP);
    assert_eq!((fixture.lit(), fixture.dark()), ("250".into(), " 50".into()));
    assert_eq!(fixture.read(0x33), 0, "not before it is saved");
    fixture.hold(SET);
    assert_eq!(fixture.read(0x33), 250);
    assert_eq!(fixture.truth().flash_writes, 1, "the panel saves to flash");
    fixture.press(MODE);
    assert_eq!(fixture.lit(), "Fn_33");
    fixture.press(MODE);
    assert_eq!(fixture.lit(), "rdy");
    fixture.act(Act::PowerCycle);
    assert_eq!(fixture.read(0x33), 250);
}

#[test]
fn mode_leaves_a_value_without_saving() {
    let mut fixture = DriveFixture::new();
    fixture.press(MODE);
    fixture.hold(SET);
    fixture.press(DOWN);
    assert_eq!(fixture.lit(), "1");
    fixture.press(MODE);
    assert_eq!((fixture.lit(), fixture.read(0x00)), ("Fn_00".into(), 2));
}

#[test]
fn values_stay_within_their_limits() {
    let mut fixture = DriveFixture::new();
    fixture.press(MODE);
    fixture.hold(SET);
    for _ in 0..30 {
        fixture.press(UP);
    }
    assert_eq!(fixture.lit(), "20");
    for _ in 0..30 {
        fixture.press(DOWN);
    }
    assert_eq!(fixture.lit(), "0");
}

#[test]
fn readings_can_be_looked_at_and_not_changed() {
    let mut fixture = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, (-120_i16) as u16), (0x38, 1)] {
        fixture.write(number, value);
    }
    fixture.advance(500);
    assert_eq!(fixture.lit(), "-120", "servo on: the speed");
    fixture.press(MODE);
    for _ in 0..3 {
        fixture.press(SET);
    }
    assert_eq!(fixture.dark(), " n_00");
    fixture.press(UP);
    assert_eq!(fixture.lit(), "dn_00");
    fixture.hold(SET);
    assert_eq!((fixture.lit(), fixture.dark()), ("-120".into(), "-120".into()));
    fixture.press(UP);
    fixture.write(0x33, 70);
    fixture.advance(500);
    assert_eq!(fixture.lit(), "70", "it is live");
}

#[test]
fn the_panel_goes_before_the_line() {
    let mut fixture = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, 100), (0x38, 1)] {
        fixture.write(number, value);
    }
    fixture.press(MODE);
    for _ in 0..3 {
        fixture.press(UP);
    }
    fixture.press(SET);
    for _ in 0..3 {
        fixture.press(UP);
    }
    fixture.hold(SET);
    assert_eq!(fixture.try_write(0x33, 200), Err(4), "it is open on the panel");
    fixture.write(0x30, 5);
    fixture.write(0x33, 0);
    fixture.advance(500);
    assert_eq!(fixture.rpm(), 0, "but a stop goes through");
    fixture.press(MODE);
    fixture.write(0x33, 200);
}

#[test]
fn alarms_blink() {
    let mut fixture = DriveFixture::new();
    fixture.act(Act::Fault(0x160C));
    assert_eq!((fixture.lit(), fixture.dark()), ("Err_oc".into(), "      ".into()));
}

#[test]
fn jog_mode_turns_while_a_key_is_held() {
    let mut fixture = DriveFixture::new();
    fixture.write(0x00, 3);
    fixture.write(0x38, 1);
    assert!(!fixture.truth().enabled, "Fn_38 does not power jog mode");
    fixture.press(SET);
    assert!(fixture.truth().enabled, "SET runs");
    for (key, rpm) in [(UP, 200), (DOWN, -200)] {
        fixture.act(Act::Key(key, true));
        fixture.advance(500);
        assert_eq!(fixture.rpm(), rpm);
        fixture.act(Act::Key(key, false));
        fixture.advance(500);
        assert_eq!(fixture.rpm(), 0);
    }
    fixture.press(SET);
    assert!(!fixture.truth().enabled, "SET stops");
}
