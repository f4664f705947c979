use super::*;
use polepair_core::axis::Verb;
use polepair_core::plan::{Argument, Operand, Plan, Step};
use polepair_core::profile::Profile;

/// A plan as the registers it writes, in order, arguments by name.
fn writes(profile: &Profile, plan: &Plan) -> Vec<(&'static str, i64)> {
    let symbol = |id| profile.parameter(id).unwrap().symbol;
    let write = |step: &Step| match *step {
        Step::Write(to, Operand::Constant(raw)) => Some((symbol(to), raw)),
        Step::Write(to, Operand::Argument(Argument::Velocity)) => Some((symbol(to), VELOCITY)),
        Step::Write(to, Operand::Argument(Argument::Target)) => Some((symbol(to), TARGET)),
        Step::Ensure(to, raw) => Some((symbol(to), raw)),
        _ => None,
    };
    plan.steps.iter().filter_map(write).collect()
}

const VELOCITY: i64 = i64::MIN;
const TARGET: i64 = i64::MIN + 1;

fn plan(verb: Verb) -> (&'static Profile, &'static Plan) {
    let profile = SyntronTs::profiles()[0];
    (profile, profile.plan(verb).unwrap())
}

/// Returns whether `some` come in `all` in that order.
fn in_order(all: &[(&str, i64)], some: &[(&str, i64)]) -> bool {
    let mut all = all.iter();
    some.iter().all(|one| all.any(|other| other == one))
}

/// Fn_00 is required rather than written, and a power-on brings Fn_33 and Fn_38 as 0.
#[test]
fn the_speed_plan_is_that_of_the_manual() {
    let (profile, plan) = plan(Verb::Velocity);
    // The second time is for a drive whose motor was off.
    let expected = [("Fn_99", 1), ("Fn_33", VELOCITY), ("Fn_38", 1), ("Fn_33", VELOCITY)];
    assert_eq!(writes(profile, plan), expected, "§2.5");
    assert!(matches!(plan.steps[0], Step::Require { .. }));
}

#[test]
fn the_move_plans_are_those_of_the_manual() {
    for verb in [Verb::MoveTo, Verb::MoveBy] {
        let (profile, plan) = plan(verb);
        let found = writes(profile, plan);
        let recipe = [
            ("Fn_20A", 1),
            ("Fn_20B", 32),
            ("Fn_1F9", TARGET),
            ("Fn_20C", 0),
            ("Fn_38", 1),
            ("Fn_20C", 1),
            ("Fn_20C", 0),
        ];
        assert!(in_order(&found, &recipe), "§2.6.2: {found:?}");
        assert_eq!(found.first(), Some(&("Fn_99", 1)), "flash is left alone before all else");
        assert!(matches!(plan.steps[0], Step::Require { test, .. } if test.value == 14));
    }
}

#[test]
fn the_homing_plan_is_that_of_the_manual() {
    let (profile, plan) = plan(Verb::Home);
    let found = writes(profile, plan);
    let recipe = [("Fn_20A", 1), ("Fn_20D", 0), ("Fn_38", 1), ("Fn_20D", 1), ("Fn_20D", 0)];
    assert!(in_order(&found, &recipe), "§2.6.2: {found:?}");
}

#[test]
fn no_plan_sets_going_without_leaving_flash_alone_first() {
    // On CANopen the plans write objects that no flash keeps.
    for profile in SyntronTs::profiles().iter().filter(|profile| profile.protocol == "modbus") {
        for plan in profile.plans.iter().filter(|plan| !plan.verb.is_stop()) {
            let found = writes(profile, plan);
            let first = found.first().map(|(symbol, _)| *symbol);
            assert!(first.is_none_or(|symbol| symbol == "Fn_99"), "{:?}: {found:?}", plan.verb);
        }
    }
}

#[test]
fn a_verb_that_the_drive_lacks_has_no_plan() {
    let profile = SyntronTs::profiles()[0];
    assert!(profile.plan(Verb::Torque).is_none(), "torque follows the analog input");
    assert!(profile.plan(Verb::Store).is_none(), "flash is written register by register");
}

/// Every register has one name, and every name a register.
#[test]
fn the_map_is_whole() {
    let profile = SyntronTs::profiles()[0];
    for address in (0x0000..0x0300).chain(0x1000..0x1030) {
        let covers = |p: &&polepair_core::profile::Parameter| {
            let words = match p.encoding {
                polepair_core::profile::Encoding::U16 | polepair_core::profile::Encoding::I16 => 1,
                _ => 2,
            };
            p.space == 0 && (p.index..p.index + words).contains(&address)
        };
        let count = profile.parameters.iter().filter(covers).count();
        assert_eq!(count, 1, "{address:04X}");
    }
    assert_eq!(profile.parameters.iter().filter(|p| p.space == 1).count(), 4);
    assert_eq!(profile.parameters.iter().filter(|p| p.space == 2).count(), 8);
}
