use super::*;
use crate::stored_paths::{PathDefinition, PathEnd, PathType};

/// A path that may interrupt and takes 100 ms up and down.
const QUICK: [u16; 4] = [100, 100, 0, 1];

#[test]
fn definition_words_are_decimal_digits() {
    let path = PathDefinition::decode([1323, 5, 678, 1000, 10, 20, 30, 2051], 4);
    assert_eq!((path.kind, path.next, path.end), (PathType::Auto, Some(32), PathEnd::Coordinate));
    assert_eq!((path.thousandths, path.interrupts), (50_678, true));
    let path = PathDefinition::decode([3, 0xFFFF, 0xFFFF, 0, 0, 0, 0, 2050], 0);
    assert_eq!((path.next, path.end, path.interrupts), (Some(5), PathEnd::Feedback, false));
    assert_eq!(path.thousandths, -10_001);
    assert_eq!(PathDefinition::decode([2, 0, 0, 0, 0, 0, 0, 1000], 0).end, PathEnd::LastCommand);
    assert_eq!(PathDefinition::decode([2, 0, 0, 0, 0, 0, 0, 0], 0).end, PathEnd::LastCommand);
    assert_eq!(PathDefinition::decode([9, 0, 0, 0, 0, 0, 0, 0], 0).kind, PathType::Unknown(9));
}

#[test]
fn what_is_encoded_is_decoded() {
    let ends = [PathEnd::Coordinate, PathEnd::LastCommand, PathEnd::Feedback];
    let kinds = [PathType::Speed, PathType::Single, PathType::Auto, PathType::Unknown(0)];
    for (n, thousandths) in
        [0, 1, -1, 9_999, 10_000, -10_001, 327_679_999, -327_679_999].into_iter().enumerate()
    {
        let path = PathDefinition {
            kind: kinds[n % kinds.len()],
            next: [None, Some(1), Some(32)][n % 3],
            end: ends[n % ends.len()],
            interrupts: n % 2 == 1,
            thousandths,
            rpm: 3000,
            acceleration_ms: 200,
            deceleration_ms: 100,
            delay_ms: 65_535,
            s_ms: 50,
        };
        assert_eq!(PathDefinition::decode(path.encode(), path.s_ms), path);
    }
    assert_eq!(PathDefinition::decode([0; 8], 0), PathDefinition::EMPTY);
    let next = PathDefinition { next: Some(5), kind: PathType::Auto, ..PathDefinition::EMPTY };
    let absolute = PathDefinition { end: PathEnd::Coordinate, ..next };
    assert_eq!((absolute.encode()[0], next.encode()[7]), (1053, 1050));
}

/// TS manual V2 §2.6.2, "path execution", step by step.
#[test]
fn the_path_recipe_moves_and_repeats() {
    let mut fixture = DriveFixture::new();
    fixture.write(0x00, 14);
    fixture.write(0x20A, 1);
    fixture.write(0x20B, 1);
    for (offset, word) in [2, 9, 0, 300, 100, 100, 0, 1001].into_iter().enumerate() {
        fixture.write(0x100 + offset as u16, word);
    }
    fixture.write(0x20C, 0);
    fixture.write(0x38, 1);
    for turn in 1..=2 {
        fixture.write(0x20C, 1);
        assert!(fixture.busy(), "Dn_1C at once");
        fixture.write(0x20C, 0);
        fixture.settle(2000);
        fixture.is_at(2500 * turn);
    }
    fixture.write(0x20C, 0);
    assert!(!fixture.busy(), "only the edge starts");
    assert_eq!(fixture.truth().unrepeatable, 2);
}

#[test]
fn absolute_paths_go_to_the_coordinate_once() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.fill(32, 1002, -720_500, 1000, QUICK);
    for _ in 0..2 {
        fixture.trigger(32);
        fixture.settle(3000);
        fixture.is_at(-20_014);
    }
}

#[test]
fn ends_count_from_the_last_command_or_from_the_feedback() {
    for second in [1001, 2001] {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.fill(1, 1002, 12_960_000, 600, QUICK);
        fixture.fill(2, 2, 360_000, 600, [100, 100, 0, second]);
        fixture.trigger(1);
        fixture.advance(1000);
        let here = fixture.counts();
        fixture.trigger(2);
        fixture.settle(12_000);
        if second == 1001 {
            fixture.is_at(360_000 + 10_000);
        } else {
            let execution = fixture.counts() - here;
            assert!(
                (10_000..10_800).contains(&execution),
                "a turn from where it was, not {execution}"
            );
        }
    }
}

#[test]
fn a_stop_leaves_the_rest_of_the_way_out() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.fill(1, 1002, 3_600_000, 600, [100, 100, 0, 0]);
    fixture.trigger(1);
    fixture.advance(300);
    fixture.write(fn_registers::PATH_STOP, 1);
    fixture.settle(500);
    let stopped = fixture.counts();
    assert!((10_000..40_000).contains(&stopped), "stopped at {stopped}");
    fixture.trigger(1);
    assert!(!fixture.busy(), "Fn_20E = 1 blocks");
    fixture.write(fn_registers::PATH_STOP, 0);
    fixture.fill(2, 2, 360_000, 600, [100, 100, 0, 2000]);
    fixture.trigger(2);
    fixture.settle(2000);
    fixture.is_at(stopped + 10_000);
}

#[test]
fn the_stop_setting_decides_how_far_it_rolls() {
    let mut rolled = [0, 0];
    for setting in [0, 1] {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.write(fn_registers::STOP_SETTING, setting);
        fixture.fill(1, 1, 1000, 600, [100, 1000, 0, 0]);
        fixture.trigger(1);
        fixture.advance(500);
        assert_eq!(fixture.rpm(), 600);
        let before = fixture.counts();
        fixture.write(fn_registers::PATH_STOP, 1);
        fixture.settle(3000);
        rolled[usize::from(setting)] = fixture.counts() - before;
    }
    assert!((49_000..51_500).contains(&rolled[0]), "600 rpm in 1 s: 5 turns, not {rolled:?}");
    assert!(rolled[1] < 2_000, "at once: {rolled:?}");
}

#[test]
fn a_speed_path_holds_its_speed_for_ever() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.fill(3, 1, -1, 450, QUICK);
    fixture.trigger(3);
    for _ in 0..5 {
        fixture.advance(10_000);
        assert_eq!(
            (fixture.rpm(), fixture.busy()),
            (-450, true),
            "a negative coordinate turns back"
        );
    }
}

/// §2.6.1: the delay of a SPEED path counts from TRIG.
#[test]
fn a_speed_path_with_a_delay_loads_the_next_one() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.fill(1, 21, 1000, 300, [400, 400, 500, 0]);
    fixture.fill(2, 1, -1000, 100, [100, 100, 0, 0]);
    fixture.trigger(1);
    fixture.advance(450);
    assert_eq!(fixture.rpm(), 300);
    fixture.advance(600);
    assert_eq!(fixture.rpm(), -100);
}

#[test]
fn auto_paths_chain_by_the_first_word_else_by_the_second() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.fill(1, 1023, 90_000, 600, [50, 50, 500, 0]);
    fixture.fill(2, 1003, 180_000, 600, [50, 50, 500, 70]);
    fixture.fill(7, 1002, 270_000, 600, [50, 50, 0, 0]);
    fixture.trigger(1);
    fixture.advance(350);
    fixture.is_at(2500);
    assert!(fixture.busy(), "the delay belongs to the path");
    fixture.advance(800);
    fixture.is_at(5000);
    fixture.settle(2000);
    fixture.is_at(7500);
    assert_eq!(fixture.truth().unrepeatable, 1);
}

#[test]
fn paths_that_load_each_other_run_until_stopped() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.fill(1, 1023, 36_000, 600, [50, 50, 10, 0]);
    fixture.fill(2, 1013, -36_000, 600, [50, 50, 10, 0]);
    fixture.trigger(1);
    let (mut min, mut max) = (0, 0);
    for _ in 0..500 {
        fixture.advance(10);
        let at = fixture.counts();
        (min, max) = (min.min(at), max.max(at));
    }
    assert!(fixture.busy() && (950..1100).contains(&max) && (-1100..-950).contains(&min));
}

#[test]
fn only_a_path_that_may_interrupts_another() {
    for (second, end) in [(0, 360_000), (1, -5_000)] {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.fill(1, 1002, 12_960_000, 600, QUICK);
        fixture.fill(2, 1002, -180_000, 600, [100, 100, 0, second]);
        fixture.trigger(1);
        fixture.advance(700);
        fixture.trigger(2);
        fixture.settle(12_000);
        fixture.is_at(end);
    }
}

/// Ta/2 must be greater than Ts (§2.6.1).
#[test]
fn an_s_time_that_does_not_fit_is_refused() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(0x104, 200);
    assert_eq!(fixture.try_write(0x210, 100), Err(3));
    fixture.write(0x210, 99);
    assert_eq!(fixture.try_write(0x104, 198), Err(3));
    fixture.write(0x210, 0);
    fixture.write(0x104, 0);
}

#[test]
fn an_s_curve_rounds_the_ramp_and_keeps_its_time() {
    let mut speeds = [[0_i16; 5]; 2];
    for (kind, s_time) in [0, 190].into_iter().enumerate() {
        let mut fixture = DriveFixture::positioning(&[]);
        fixture.fill(1, 1002, 7_200_000, 600, [400, 400, 0, 0]);
        fixture.write(0x210, s_time);
        fixture.write(fn_registers::PATH_NUMBER, 1);
        fixture.write(fn_registers::PATH_TRIGGER, 1);
        for speed in &mut speeds[kind] {
            fixture.advance(100);
            *speed = fixture.truth().velocity as i16;
        }
        fixture.settle(20_000);
        fixture.is_at(200_000);
    }
    let [flat, round] = speeds;
    assert!(round[0] + 3 < flat[0], "slower at first: {flat:?} {round:?}");
    assert!((round[1] - flat[1]).abs() <= 2, "equal in the middle: {flat:?} {round:?}");
    assert!(round[2] > flat[2] + 3, "faster at last: {flat:?} {round:?}");
    assert!(round[4] == flat[4]);
}

#[test]
fn the_mechanics_scale_the_coordinate() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(fn_registers::MOTOR_TURNS, 3);
    fixture.write(fn_registers::TRAVEL, 10);
    fixture.fill(1, 1002, 5_000, 600, QUICK);
    fixture.trigger(1);
    fixture.settle(3000);
    fixture.is_at(15_000);
    assert_eq!(fixture.try_write(fn_registers::TRAVEL, 0), Err(3));
}

#[test]
fn the_whole_reach_of_a_coordinate_is_understood() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(fn_registers::TRAVEL, 60_000);
    for (thousandths, counts) in [(327_679_999, 54_613), (-327_679_999, -54_613)] {
        fixture.fill(1, 1002, thousandths, 3000, QUICK);
        fixture.trigger(1);
        fixture.settle(5000);
        fixture.is_at(counts);
    }
}

#[test]
fn an_input_triggers_where_the_source_says_so() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.fill(1, 1002, 90_000, 600, QUICK);
    fixture.write(fn_registers::PATH_NUMBER, 1);
    fixture.act(Act::Input(3, true));
    fixture.advance(5);
    assert!(!fixture.busy(), "Fn_20A = 1: registers");
    fixture.act(Act::Input(3, false));
    fixture.advance(5);
    fixture.write(fn_registers::TRIGGER_SOURCE, 0);
    fixture.write(fn_registers::PATH_TRIGGER, 1);
    assert!(!fixture.busy(), "Fn_20A = 0: inputs");
    fixture.act(Act::Input(3, true));
    fixture.advance(5);
    assert!(fixture.busy());
    fixture.settle(2000);
    fixture.is_at(2500);
}

#[test]
fn a_limit_switch_ends_a_path() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.act(Act::Switch { which: 2, at: -10.0 });
    fixture.fill(1, 1002, -3_600_000, 300, QUICK);
    fixture.trigger(1);
    fixture.settle(5000);
    let stopped = fixture.truth().position;
    assert!((-10.6..=-10.0).contains(&stopped), "stopped at {stopped}");
    fixture.fill(1, 1002, 0, 300, QUICK);
    fixture.trigger(1);
    fixture.settle(5000);
    fixture.is_at(0);
}

#[test]
fn without_power_nothing_starts() {
    let mut fixture = DriveFixture::positioning(&[]);
    fixture.write(fn_registers::ENABLE, 0);
    fixture.fill(1, 1002, 90_000, 600, QUICK);
    fixture.trigger(1);
    fixture.advance(100);
    assert!(!fixture.busy());
    assert_eq!((fixture.truth().position, fixture.truth().unrepeatable), (0.0, 0));
}
