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

    /// What is shown while the blinking part is lit.
    fn lit(&mut self) -> std::string::String {
        while (self.now.0 / 250_000_000) % 2 == 1 {
            self.advance(10);
        }
        self.shown()
    }

    /// What is shown while it is dark.
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
    let mut desk = DriveFixture::new();
    assert_eq!(desk.lit(), "rdy");
    desk.press(MODE);
    assert_eq!((desk.lit(), desk.dark()), ("Fn_00".into(), "Fn_0 ".into()));
    for _ in 0..3 {
        desk.press(UP);
    }
    desk.press(SET);
    assert_eq!(desk.dark(), "Fn_ 3");
    for _ in 0..4 {
        desk.press(UP);
    }
    desk.press(DOWN);
    assert_eq!(desk.lit(), "Fn_33");
    desk.hold(SET);
    assert_eq!((desk.lit(), desk.dark()), ("0".into(), " ".into()));
    desk.press(SET);
    assert_eq!(desk.lit(), "00");
    for _ in 0..5 {
        desk.press(UP);
    }
    desk.press(SET);
    desk.press(UP);
    desk.press(UP);
    assert_eq!((desk.lit(), desk.dark()), ("250".into(), " 50".into()));
    assert_eq!(desk.read(0x33), 0, "not before it is saved");
    desk.hold(SET);
    assert_eq!(desk.read(0x33), 250);
    assert_eq!(desk.truth().flash_writes, 1, "the panel saves to flash");
    desk.press(MODE);
    assert_eq!(desk.lit(), "Fn_33");
    desk.press(MODE);
    assert_eq!(desk.lit(), "rdy");
    desk.act(Act::PowerCycle);
    assert_eq!(desk.read(0x33), 250);
}

#[test]
fn mode_leaves_a_value_without_saving() {
    let mut desk = DriveFixture::new();
    desk.press(MODE);
    desk.hold(SET);
    desk.press(DOWN);
    assert_eq!(desk.lit(), "1");
    desk.press(MODE);
    assert_eq!((desk.lit(), desk.read(0x00)), ("Fn_00".into(), 2));
}

#[test]
fn values_stay_within_their_limits() {
    let mut desk = DriveFixture::new();
    desk.press(MODE);
    desk.hold(SET);
    for _ in 0..30 {
        desk.press(UP);
    }
    assert_eq!(desk.lit(), "20");
    for _ in 0..30 {
        desk.press(DOWN);
    }
    assert_eq!(desk.lit(), "0");
}

#[test]
fn readings_can_be_looked_at_and_not_changed() {
    let mut desk = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, (-120_i16) as u16), (0x38, 1)] {
        desk.write(number, value);
    }
    desk.advance(500);
    assert_eq!(desk.lit(), "-120", "servo on: the speed");
    desk.press(MODE);
    for _ in 0..3 {
        desk.press(SET);
    }
    assert_eq!(desk.dark(), " n_00");
    desk.press(UP);
    assert_eq!(desk.lit(), "dn_00");
    desk.hold(SET);
    assert_eq!((desk.lit(), desk.dark()), ("-120".into(), "-120".into()));
    desk.press(UP);
    desk.write(0x33, 70);
    desk.advance(500);
    assert_eq!(desk.lit(), "70", "it is live");
}

#[test]
fn the_panel_goes_before_the_line() {
    let mut desk = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, 100), (0x38, 1)] {
        desk.write(number, value);
    }
    desk.press(MODE);
    for _ in 0..3 {
        desk.press(UP);
    }
    desk.press(SET);
    for _ in 0..3 {
        desk.press(UP);
    }
    desk.hold(SET);
    assert_eq!(desk.try_write(0x33, 200), Err(4), "it is open on the panel");
    desk.write(0x30, 5);
    desk.write(0x33, 0);
    desk.advance(500);
    assert_eq!(desk.rpm(), 0, "but a stop goes through");
    desk.press(MODE);
    desk.write(0x33, 200);
}

#[test]
fn alarms_blink() {
    let mut desk = DriveFixture::new();
    desk.act(Act::Fault(0x160C));
    assert_eq!((desk.lit(), desk.dark()), ("Err_oc".into(), "      ".into()));
}

#[test]
fn jog_mode_turns_while_a_key_is_held() {
    let mut desk = DriveFixture::new();
    desk.write(0x00, 3);
    desk.write(0x38, 1);
    assert!(!desk.truth().enabled, "Fn_38 does not power jog mode");
    desk.press(SET);
    assert!(desk.truth().enabled, "SET runs");
    for (key, rpm) in [(UP, 200), (DOWN, -200)] {
        desk.act(Act::Key(key, true));
        desk.advance(500);
        assert_eq!(desk.rpm(), rpm);
        desk.act(Act::Key(key, false));
        desk.advance(500);
        assert_eq!(desk.rpm(), 0);
    }
    desk.press(SET);
    assert!(!desk.truth().enabled, "SET stops");
}
