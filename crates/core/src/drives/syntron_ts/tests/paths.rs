use super::super::paths::{DecodedPath, PathEnd, PathType};
use super::*;

/// A path that may interrupt and takes 100 ms up and down.
const QUICK: [u16; 4] = [100, 100, 0, 1];

#[test]
fn definition_words_are_decimal_digits() {
    let path = DecodedPath::decode([1323, 5, 678, 1000, 10, 20, 30, 2051], 4);
    assert_eq!((path.kind, path.next, path.end), (PathType::Auto, Some(32), PathEnd::Coordinate));
    assert_eq!((path.thousandths, path.interrupts), (50_678, true));
    let path = DecodedPath::decode([3, 0xFFFF, 0xFFFF, 0, 0, 0, 0, 2050], 0);
    assert_eq!((path.next, path.end, path.interrupts), (Some(5), PathEnd::Feedback, false));
    assert_eq!(path.thousandths, -10_001);
    assert_eq!(DecodedPath::decode([2, 0, 0, 0, 0, 0, 0, 1000], 0).end, PathEnd::LastCommand);
    assert_eq!(DecodedPath::decode([2, 0, 0, 0, 0, 0, 0, 0], 0).end, PathEnd::LastCommand);
    assert_eq!(DecodedPath::decode([9, 0, 0, 0, 0, 0, 0, 0], 0).kind, PathType::Unknown(9));
}

/// TS manual V2 §2.6.2, "path execution", step by step.
#[test]
fn the_path_recipe_moves_and_repeats() {
    let mut desk = DriveFixture::new();
    desk.write(0x00, 14);
    desk.write(0x20A, 1);
    desk.write(0x20B, 1);
    for (offset, word) in [2, 9, 0, 300, 100, 100, 0, 1001].into_iter().enumerate() {
        desk.write(0x100 + offset as u16, word);
    }
    desk.write(0x20C, 0);
    desk.write(0x38, 1);
    for turn in 1..=2 {
        desk.write(0x20C, 1);
        assert!(desk.busy(), "Dn_1C at once");
        desk.write(0x20C, 0);
        desk.settle(2000);
        desk.is_at(2500 * turn);
    }
    desk.write(0x20C, 0);
    assert!(!desk.busy(), "only the edge starts");
    assert_eq!(desk.truth().unrepeatable, 2);
}

#[test]
fn absolute_paths_go_to_the_coordinate_once() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.fill(32, 1002, -720_500, 1000, QUICK);
    for _ in 0..2 {
        desk.trigger(32);
        desk.settle(3000);
        desk.is_at(-20_014);
    }
}

#[test]
fn ends_count_from_the_last_command_or_from_the_feedback() {
    for second in [1001, 2001] {
        let mut desk = DriveFixture::positioning(&[]);
        desk.fill(1, 1002, 12_960_000, 600, QUICK);
        desk.fill(2, 2, 360_000, 600, [100, 100, 0, second]);
        desk.trigger(1);
        desk.advance(1000);
        let here = desk.counts();
        desk.trigger(2);
        desk.settle(12_000);
        if second == 1001 {
            desk.is_at(360_000 + 10_000);
        } else {
            let went = desk.counts() - here;
            assert!((10_000..10_800).contains(&went), "a turn from where it was, not {went}");
        }
    }
}

#[test]
fn a_stop_leaves_the_rest_of_the_way_out() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.fill(1, 1002, 3_600_000, 600, [100, 100, 0, 0]);
    desk.trigger(1);
    desk.advance(300);
    desk.write(fn_registers::PATH_STOP, 1);
    desk.settle(500);
    let stopped = desk.counts();
    assert!((10_000..40_000).contains(&stopped), "stopped at {stopped}");
    desk.trigger(1);
    assert!(!desk.busy(), "Fn_20E = 1 blocks");
    desk.write(fn_registers::PATH_STOP, 0);
    desk.fill(2, 2, 360_000, 600, [100, 100, 0, 2000]);
    desk.trigger(2);
    desk.settle(2000);
    desk.is_at(stopped + 10_000);
}

#[test]
fn the_stop_setting_decides_how_far_it_rolls() {
    let mut rolled = [0, 0];
    for setting in [0, 1] {
        let mut desk = DriveFixture::positioning(&[]);
        desk.write(fn_registers::STOP_SETTING, setting);
        desk.fill(1, 1, 1000, 600, [100, 1000, 0, 0]);
        desk.trigger(1);
        desk.advance(500);
        assert_eq!(desk.rpm(), 600);
        let before = desk.counts();
        desk.write(fn_registers::PATH_STOP, 1);
        desk.settle(3000);
        rolled[usize::from(setting)] = desk.counts() - before;
    }
    assert!((49_000..51_500).contains(&rolled[0]), "600 rpm in 1 s: 5 turns, not {rolled:?}");
    assert!(rolled[1] < 2_000, "at once: {rolled:?}");
}

#[test]
fn a_speed_path_holds_its_speed_for_ever() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.fill(3, 1, -1, 450, QUICK);
    desk.trigger(3);
    for _ in 0..5 {
        desk.advance(10_000);
        assert_eq!((desk.rpm(), desk.busy()), (-450, true), "a negative coordinate turns back");
    }
}

/// §2.6.1: the delay of a SPEED path counts from TRIG.
#[test]
fn a_speed_path_with_a_delay_loads_the_next_one() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.fill(1, 21, 1000, 300, [400, 400, 500, 0]);
    desk.fill(2, 1, -1000, 100, [100, 100, 0, 0]);
    desk.trigger(1);
    desk.advance(450);
    assert_eq!(desk.rpm(), 300);
    desk.advance(600);
    assert_eq!(desk.rpm(), -100);
}

#[test]
fn auto_paths_chain_by_the_first_word_else_by_the_second() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.fill(1, 1023, 90_000, 600, [50, 50, 500, 0]);
    desk.fill(2, 1003, 180_000, 600, [50, 50, 500, 70]);
    desk.fill(7, 1002, 270_000, 600, [50, 50, 0, 0]);
    desk.trigger(1);
    desk.advance(350);
    desk.is_at(2500);
    assert!(desk.busy(), "the delay belongs to the path");
    desk.advance(800);
    desk.is_at(5000);
    desk.settle(2000);
    desk.is_at(7500);
    assert_eq!(desk.truth().unrepeatable, 1);
}

#[test]
fn paths_that_load_each_other_run_until_stopped() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.fill(1, 1023, 36_000, 600, [50, 50, 10, 0]);
    desk.fill(2, 1013, -36_000, 600, [50, 50, 10, 0]);
    desk.trigger(1);
    let (mut least, mut most) = (0, 0);
    for _ in 0..500 {
        desk.advance(10);
        let at = desk.counts();
        (least, most) = (least.min(at), most.max(at));
    }
    assert!(desk.busy() && (950..1100).contains(&most) && (-1100..-950).contains(&least));
}

#[test]
fn only_a_path_that_may_interrupts_another() {
    for (second, end) in [(0, 360_000), (1, -5_000)] {
        let mut desk = DriveFixture::positioning(&[]);
        desk.fill(1, 1002, 12_960_000, 600, QUICK);
        desk.fill(2, 1002, -180_000, 600, [100, 100, 0, second]);
        desk.trigger(1);
        desk.advance(700);
        desk.trigger(2);
        desk.settle(12_000);
        desk.is_at(end);
    }
}

/// Ta/2 must be greater than Ts (§2.6.1).
#[test]
fn an_s_time_that_does_not_fit_is_refused() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.write(0x104, 200);
    assert_eq!(desk.try_write(0x210, 100), Err(3));
    desk.write(0x210, 99);
    assert_eq!(desk.try_write(0x104, 198), Err(3));
    desk.write(0x210, 0);
    desk.write(0x104, 0);
}

#[test]
fn an_s_curve_rounds_the_ramp_and_keeps_its_time() {
    let mut speeds = [[0_i16; 5]; 2];
    for (kind, s_time) in [0, 190].into_iter().enumerate() {
        let mut desk = DriveFixture::positioning(&[]);
        desk.fill(1, 1002, 7_200_000, 600, [400, 400, 0, 0]);
        desk.write(0x210, s_time);
        desk.write(fn_registers::PATH_NUMBER, 1);
        desk.write(fn_registers::PATH_TRIGGER, 1);
        for speed in &mut speeds[kind] {
            desk.advance(100);
            *speed = desk.truth().velocity as i16;
        }
        desk.settle(20_000);
        desk.is_at(200_000);
    }
    let [flat, round] = speeds;
    assert!(round[0] + 3 < flat[0], "slower at first: {flat:?} {round:?}");
    assert!((round[1] - flat[1]).abs() <= 2, "equal in the middle: {flat:?} {round:?}");
    assert!(round[2] > flat[2] + 3, "faster at last: {flat:?} {round:?}");
    assert!(round[4] == flat[4]);
}

#[test]
fn the_mechanics_scale_the_coordinate() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.write(fn_registers::MOTOR_TURNS, 3);
    desk.write(fn_registers::TRAVEL, 10);
    desk.fill(1, 1002, 5_000, 600, QUICK);
    desk.trigger(1);
    desk.settle(3000);
    desk.is_at(15_000);
    assert_eq!(desk.try_write(fn_registers::TRAVEL, 0), Err(3));
}

#[test]
fn the_whole_reach_of_a_coordinate_is_understood() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.write(fn_registers::TRAVEL, 60_000);
    for (thousandths, counts) in [(327_679_999, 54_613), (-327_679_999, -54_613)] {
        desk.fill(1, 1002, thousandths, 3000, QUICK);
        desk.trigger(1);
        desk.settle(5000);
        desk.is_at(counts);
    }
}

#[test]
fn an_input_triggers_where_the_source_says_so() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.fill(1, 1002, 90_000, 600, QUICK);
    desk.write(fn_registers::PATH_NUMBER, 1);
    desk.act(Act::Input(3, true));
    desk.advance(5);
    assert!(!desk.busy(), "Fn_20A = 1: registers");
    desk.act(Act::Input(3, false));
    desk.advance(5);
    desk.write(fn_registers::TRIGGER_SOURCE, 0);
    desk.write(fn_registers::PATH_TRIGGER, 1);
    assert!(!desk.busy(), "Fn_20A = 0: inputs");
    desk.act(Act::Input(3, true));
    desk.advance(5);
    assert!(desk.busy());
    desk.settle(2000);
    desk.is_at(2500);
}

#[test]
fn a_limit_switch_ends_a_path() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.act(Act::Switch { which: 2, at: -10.0 });
    desk.fill(1, 1002, -3_600_000, 300, QUICK);
    desk.trigger(1);
    desk.settle(5000);
    let stopped = desk.truth().position;
    assert!((-10.6..=-10.0).contains(&stopped), "stopped at {stopped}");
    desk.fill(1, 1002, 0, 300, QUICK);
    desk.trigger(1);
    desk.settle(5000);
    desk.is_at(0);
}

#[test]
fn without_power_nothing_starts() {
    let mut desk = DriveFixture::positioning(&[]);
    desk.write(fn_registers::ENABLE, 0);
    desk.fill(1, 1002, 90_000, 600, QUICK);
    desk.trigger(1);
    desk.advance(100);
    assert!(!desk.busy());
    assert_eq!((desk.truth().position, desk.truth().unrepeatable), (0.0, 0));
}
