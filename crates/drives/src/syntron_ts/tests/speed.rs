use super::*;

/// TS manual V2 §2.5, step by step.
#[test]
fn the_speed_recipe_turns_the_motor() {
    let mut fixture = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, 0), (0x38, 0), (0x33, 200), (0x38, 1)] {
        fixture.write(number, value);
    }
    fixture.advance(500);
    assert_eq!(fixture.rpm(), 200);
    fixture.write(0x33, (-150_i16) as u16);
    fixture.advance(500);
    assert_eq!(fixture.rpm(), -150);
    fixture.write(0x33, 0);
    fixture.advance(500);
    assert_eq!(fixture.rpm(), 0);
    assert!(fixture.truth().enabled, "speed zero holds");
    fixture.write(0x38, 0);
    assert!(!fixture.truth().enabled);
}

#[test]
fn enabling_holds_the_position_it_finds() {
    for mode in [1, 14] {
        let mut fixture = DriveFixture::new();
        fixture.write(0x00, mode);
        let before = fixture.truth().position;
        fixture.write(0x38, 1);
        fixture.advance(200);
        fixture.act(Act::Load(0.5));
        fixture.advance(1000);
        let moved = (fixture.truth().position - before).abs();
        assert!(fixture.truth().enabled && moved < 0.02, "mode {mode} gave way by {moved}");
    }
}

#[test]
fn a_factory_drive_obeys_no_modbus_motion() {
    let mut fixture = DriveFixture::new();
    assert_eq!(fixture.read(0x00), 2);
    for (number, value) in [(0x99, 1), (0x33, 500), (0x38, 1), (0x20B, 1), (0x20C, 1), (0x20D, 1)] {
        fixture.write(number, value);
    }
    fixture.advance(1000);
    let truth = fixture.truth();
    assert_eq!((truth.position, truth.enabled), (0.0, false));
}

#[test]
fn other_modes_are_powered_by_their_input_and_rest() {
    for mode in [0, 2, 4, 5, 6, 7, 8, 9, 10] {
        let mut fixture = DriveFixture::new();
        fixture.write(0x00, mode);
        fixture.act(Act::Input(1, true));
        fixture.advance(500);
        let truth = fixture.truth();
        assert!(truth.enabled && truth.velocity == 0.0, "mode {mode}");
        fixture.act(Act::Input(1, false));
        fixture.advance(2);
        assert!(!fixture.truth().enabled);
    }
}

#[test]
fn the_analog_input_gives_the_speed_in_mode_0() {
    let mut fixture = DriveFixture::new();
    fixture.write(0x00, 0);
    fixture.act(Act::Input(1, true));
    fixture.advance(10);
    fixture.act(Act::Analog(0, -2.0));
    fixture.advance(1000);
    assert_eq!(fixture.rpm(), -600);
}

/// §3.6.3: Fn_95 limits the speed while torque is controlled.
#[test]
fn the_analog_input_gives_the_torque_in_mode_4() {
    let mut fixture = DriveFixture::with(&[("closed", "1"), ("analog", "2.0")]);
    fixture.write(0x00, 4);
    fixture.act(Act::Input(1, false));
    fixture.advance(2);
    fixture.act(Act::Jam(true));
    fixture.act(Act::Input(1, true));
    fixture.advance(200);
    let share = fixture.truth().current / crate::syntron_ts::shaft::RATED_CURRENT;
    assert!((share - 0.2).abs() < 0.01, "2 V give {share}");
    fixture.write(0x95, 300);
    fixture.act(Act::Jam(false));
    fixture.advance(3000);
    assert!((280..=302).contains(&fixture.rpm()), "{}", fixture.rpm());
    fixture.act(Act::Analog(0, -2.0));
    fixture.advance(3000);
    assert!((-302..=-280).contains(&fixture.rpm()), "{}", fixture.rpm());
    // More than ±10 V is no more.
    fixture.write(0x95, 0);
    fixture.act(Act::Jam(true));
    fixture.act(Act::Analog(0, 99.0));
    fixture.advance(200);
    assert!(fixture.truth().current < 1.02 * crate::syntron_ts::shaft::RATED_CURRENT);
}

/// §2.2: mode 2 is the factory's.
#[test]
fn pulses_turn_the_motor_in_mode_2() {
    let mut fixture = DriveFixture::new();
    fixture.act(Act::Pulses(5_000));
    fixture.act(Act::Input(1, true));
    fixture.advance(500);
    assert_eq!(fixture.counts(), 0, "what came before power is lost");
    fixture.act(Act::Pulses(5_000));
    fixture.advance(1_000);
    assert!((fixture.counts() - 5_000).abs() < 4, "{}", fixture.counts());
    fixture.act(Act::Pulses(-12_000));
    fixture.advance(1_000);
    assert!((fixture.counts() + 7_000).abs() < 4, "{}", fixture.counts());
    // Toward a closed limit they are lost, away from it they count.
    fixture.act(Act::Input(6, true));
    fixture.advance(2);
    fixture.act(Act::Pulses(-1_000));
    fixture.advance(500);
    fixture.act(Act::Pulses(1_000));
    fixture.advance(1_000);
    assert!((fixture.counts() + 6_000).abs() < 4, "{}", fixture.counts());
}

#[test]
fn a_train_of_pulses_is_a_speed() {
    let mut fixture = DriveFixture::with(&[("closed", "1"), ("pulses", "-20000")]);
    fixture.advance(1_500);
    assert!((fixture.rpm() + 120).abs() <= 1, "{}", fixture.rpm());
    for wrong in [("closed", "9"), ("closed", "0"), ("analog", "nan"), ("pulses", "many")] {
        let options = DeviceOptions { extra: &[wrong], ..OPTIONS };
        let refused = SyntronTs::create_device(SyntronTs::profiles()[0], &options).err();
        assert_eq!(refused, Some(wrong.1));
    }
}

#[test]
fn a_limit_switch_counts_in_mode_0_too() {
    let mut fixture = DriveFixture::with(&[("analog", "0.5")]);
    fixture.write(0x00, 0);
    fixture.act(Act::Input(1, true));
    fixture.act(Act::Switch { which: 1, at: 10.0 });
    fixture.advance(5000);
    let stopped = fixture.truth().position;
    assert!((10.0..10.5).contains(&stopped), "stopped at {stopped}");
    fixture.advance(5000);
    assert!((fixture.truth().position - stopped).abs() < 0.01, "{}", fixture.truth().position);
    fixture.act(Act::Analog(0, -0.5));
    fixture.advance(5000);
    assert!(fixture.truth().position < 0.0, "the way back is free");
}

#[test]
fn a_limit_switch_keeps_the_motor_from_going_on() {
    let mut fixture = DriveFixture::new();
    fixture.act(Act::Switch { which: 1, at: 10.0 });
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, 100), (0x38, 1)] {
        fixture.write(number, value);
    }
    fixture.advance(3000);
    let stopped = fixture.truth().position;
    assert!((10.0..10.5).contains(&stopped), "stopped at {stopped}");
    fixture.write(0x33, (-100_i16) as u16);
    fixture.advance(3000);
    assert!(fixture.truth().position < 0.0, "the way back is free");
}

/// Fn_99 = 1 was kept, so the power-on state is that of flash (§2.5).
#[test]
fn values_in_ram_are_lost_after_power_off() {
    let mut fixture = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x99, 1), (0x33, 200), (0x38, 1)] {
        fixture.write(number, value);
    }
    fixture.act(Act::PowerCycle);
    assert_eq!([0x00, 0x99, 0x33, 0x38].map(|n| fixture.read(n)), [1, 1, 0, 0]);
    assert!(!fixture.truth().enabled);
}

/// Why step 1 of §2.5 wants Fn_38 = 0: with Fn_99 = 0 it would be in flash.
#[test]
fn an_enable_in_flash_starts_the_motor_at_power_on() {
    let mut fixture = DriveFixture::new();
    for (number, value) in [(0x00, 1), (0x33, 100), (0x38, 1)] {
        fixture.write(number, value);
    }
    fixture.act(Act::PowerCycle);
    fixture.advance(1000);
    assert_eq!(fixture.rpm(), 100);
}
