//! Units from the objects of drives, with numbers from their makers' public manuals.

use crate::cia402::units::{ACCELERATION, POSITION, VELOCITY};
use polepair_core::profile::{NoScale, ObjectKey, ScaleRule};

type Drive<'a> = &'a [(ObjectKey, u32)];

fn compute(rule: &ScaleRule, drive: Drive<'_>) -> Result<f64, NoScale> {
    let read = |key| drive.iter().find(|(known, _)| *known == key).map(|(_, raw)| (*raw).into());
    (rule.compute)(&read, true).map(|scale| scale.factor)
}

/// Units of position in a turn, of velocity in 1 rpm, of acceleration in 1 rpm/s; 0 where the drive's
/// objects do not report it.
fn units(drive: Drive<'_>) -> [f64; 3] {
    [&POSITION, &VELOCITY, &ACCELERATION].map(|rule| compute(rule, drive).map_or(0.0, |f| 1.0 / f))
}

fn check(drive: Drive<'_>, expected: [f64; 3]) {
    let found = units(drive);
    for (found, expected) in found.into_iter().zip(expected) {
        assert!(
            (found - expected).abs() <= 1e-9 * expected.abs(),
            "{found} of {expected}: {drive:X?}"
        );
    }
}

const fn encoder(increments: u32) -> [(ObjectKey, u32); 2] {
    [((0x608F, 1), increments), ((0x608F, 2), 1)]
}

#[test]
fn drives_of_five_makers() {
    let [inc, rev] = encoder(2000);
    let one = |index| [((index, 1), 1), ((index, 2), 1)];
    let ([g1, g2], [f1, f2]) = (one(0x6091), one(0x6092));
    // Nanotec PD6-C, online manual, chapters "User-defined units" and 60A9h: 0.1 degree, rpm.
    let nanotec =
        [inc, rev, g1, g2, f1, f2, ((0x60A8, 0), 0xFF41_0000), ((0x60A9, 0), 0x00B4_4700)];
    check(&nanotec, [3600.0, 1.0, 0.0]);
    // Synapticon SOMANET, object 60A9h: thousandths of a revolution per minute.
    let [inc, rev] = encoder(65_536);
    check(&[inc, rev, ((0x60A9, 0), 0xFDB4_4700)], [65_536.0, 1000.0, 0.0]);
    // Kollmorgen AKD2G, object 6096h: 2^16 counts a revolution, 60 and 65536 give rpm.
    let factor = [((0x6096, 1), 60), ((0x6096, 2), 65_536)];
    check(&[inc, rev, factor[0], factor[1]], [65_536.0, 1.0, 0.0]);
    check(
        &[inc, rev, ((0x6096, 1), 1), ((0x6096, 2), 1)],
        [65_536.0, 65_536.0 / 60.0, 65_536.0 / 60.0],
    );
    // Kollmorgen S300 and S700, chapter 5.5.2.6: position factor = resolution * gear / feed constant;
    // here 2^20 increments, a gear of 3 to 1, 10000 units a turn. 6094h reads 0/0 there.
    let [inc, rev] = encoder(1 << 20);
    let (gear, p) =
        ([((0x6091, 1), 3), ((0x6091, 2), 1)], [((0x6093, 1), 3 << 20), ((0x6093, 2), 10_000)]);
    let zero = [((0x6094, 1), 0), ((0x6094, 2), 0)];
    let s300 = [inc, rev, gear[0], gear[1], p[0], p[1], zero[0], zero[1]];
    check(&s300, [10_000.0, 10_000.0 / 60.0, 10_000.0 / 60.0]);
    // TR-Electronic encoTRive MP-200, chapter 9.4.48: increments per second of one unit of velocity;
    // here 4096 increments, so that 4096/60 is 1 rpm.
    let [inc, rev] = encoder(4096);
    check(&[inc, rev, ((0x6094, 1), 4096), ((0x6094, 2), 60)], [4096.0, 1.0, 0.0]);
}

#[test]
fn a_turn_is_one_behind_the_gear() {
    let [inc, rev] = encoder(1000);
    let gear = [((0x6091, 1), 5), ((0x6091, 2), 1)];
    check(&[inc, rev, gear[0], gear[1]], [5000.0, 5000.0 / 60.0, 5000.0 / 60.0]);
    let feed = [((0x6092, 1), 360), ((0x6092, 2), 1)];
    check(&[inc, rev, gear[0], gear[1], feed[0], feed[1]], [360.0, 6.0, 6.0]);
    // Increments are the encoder's (60A8h, B5h), whatever the gear.
    check(
        &[inc, rev, gear[0], gear[1], ((0x60A8, 0), 0x00B5_0000)],
        [5000.0, 5000.0 / 60.0, 5000.0 / 60.0],
    );
}

#[test]
fn si_units_are_prefix_length_and_times() {
    let tau = core::f64::consts::TAU;
    for (word, units) in [
        (0x00B4_0000, 1.0),
        (0xFDB4_0000, 1000.0),
        (0x0041_0000, 360.0),
        (0xFE41_0000, 36_000.0),
        (0x0040_0000, 400.0),
        (0x0042_0000, 21_600.0),
        (0x0043_0000, 1_296_000.0),
        (0xFD10_0000, 1000.0 * tau),
    ] {
        check(&[((0x60A8, 0), word)], [units, units / 60.0, units / 60.0]);
    }
    for (word, units) in [
        (0x00B4_0300, 1.0 / 60.0),
        (0x00B4_4700, 1.0),
        (0x00B4_4800, 60.0),
        (0xFF41_0300, 60.0),
        (0x00B4_0304, 0.0),
        (0x00B4_0000, 0.0),
    ] {
        assert!((units - self::units(&[((0x60A9, 0), word)])[1]).abs() < 1e-9, "{word:08X}");
    }
    for (word, units) in [
        (0x00B4_5700, 1.0 / 60.0),
        (0x00B4_0303, 1.0 / 60.0),
        (0x00B4_4703, 1.0),
        (0x00B4_0300, 0.0),
    ] {
        assert!((units - self::units(&[((0x60AA, 0), word)])[2]).abs() < 1e-9, "{word:08X}");
    }
    // Millimetres of a spindle of 5 mm a turn, in thousandths.
    let feed = [((0x6092, 1), 5000), ((0x6092, 2), 1)];
    let spindle = [((0x60A8, 0), 0xFA01_0000), ((0x60A9, 0), 0xFD01_0300), feed[0], feed[1]];
    check(&spindle, [5000.0, 5.0 / 60.0, 0.0]);
}

#[test]
fn contradictions_and_gaps_give_no_unit() {
    let [inc, rev] = encoder(2000);
    let pair = |index, over, under| [((index, 1), over), ((index, 2), under)];
    let [f1, f2] = pair(0x6092, 2000, 1);
    let why = |rule: &ScaleRule, drive: Drive<'_>| compute(rule, drive).expect_err("no unit").0;
    let tenths = ((0x60A8, 0), 0xFF41_0000);
    assert!(why(&POSITION, &[inc, rev, f1, f2, tenths]).contains("60A8h and 6092h"));
    let [p1, p2] = pair(0x6093, 1, 1);
    let [f1, f2] = pair(0x6092, 1, 1);
    assert!(why(&POSITION, &[inc, rev, f1, f2, p1, p2]).contains("6092h and 6093h"));
    assert!(why(&POSITION, &[]).contains("does not say"));
    assert!(why(&POSITION, &[((0x608F, 1), 0), ((0x608F, 2), 1)]).contains("does not say"));
    assert!(why(&POSITION, &[inc, rev, ((0x60A8, 0), 0x00AC_0000)]).contains("not known"));
    assert!(why(&POSITION, &[inc, rev, ((0x60A8, 0), 0xFD01_0000)]).contains("6092h"));
    let [v1, v2] = pair(0x6096, 7, 3);
    assert!(why(&VELOCITY, &[inc, rev, ((0x60A9, 0), 0x00B4_4700), v1, v2]).contains("6096h"));
    assert!(why(&ACCELERATION, &[inc, rev, ((0x60A9, 0), 0x00B4_4700)]).contains("60A9h"));
    let [a1, a2] = pair(0x6097, 7, 3);
    assert!(why(&ACCELERATION, &[inc, rev, a1, a2]).contains("6097h"));
}

#[test]
fn a_zero_counts_as_absent() {
    let [inc, rev] = encoder(500);
    let zero = |index| [((index, 1), 0), ((index, 2), 0)];
    let ([g1, g2], [f1, f2]) = (zero(0x6091), zero(0x6092));
    let si = [((0x60A8, 0), 0), ((0x60A9, 0), 0), ((0x60AA, 0), 0)];
    check(&[inc, rev, g1, g2, f1, f2, si[0], si[1], si[2]], [500.0, 500.0 / 60.0, 500.0 / 60.0]);
    check(&[inc, ((0x608F, 2), 0)], [500.0, 500.0 / 60.0, 500.0 / 60.0]);
}

#[test]
fn a_velocity_that_alone_is_turned_round_is_turned_back() {
    let [inc, rev] = encoder(60);
    for (polarity, sign) in [(0, 1.0), (0x80, -1.0), (0x40, -1.0), (0xC0, 1.0)] {
        check(&[inc, rev, ((0x607E, 0), polarity)], [60.0, sign, 1.0]);
    }
}
