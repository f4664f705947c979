//! What counts as the same place.

use polepair_core::axis::Verb;
use polepair_core::error::{Extent, Failure, Outcome};
use polepair_core::time::Instant;

use super::{Homed, POSITION_ERROR_MAX, apart};

/// A thruster tells tenths of a degree in 16 bits (swarm seed can:211831: it was past 3276.7 degrees).
#[test]
fn a_position_of_16_bits_begins_again_and_is_held_to_all_others() {
    let step = 0.1_f64.to_radians();
    let turn = Some(65_536.0 * step);
    for turns in [-2.0, -1.0, 0.0, 1.0] {
        let error = apart(0.02, 0.02 + turns * 65_536.0 * step, turn);
        assert!(error < 1e-6, "{turns}: {error}");
        let error = apart(0.0, turns * 65_536.0 * step + 0.3, turn);
        assert!((error - 0.3).abs() < 1e-6 && error > POSITION_ERROR_MAX, "{turns}: {error}");
    }
    assert!(apart(0.0, 65_536.0 * step, None) > 100.0, "what has more bits does not");
}

/// A drive that was told to home sets its zero when it has, also where the host's job was cut short
/// (swarm seed can:629487: a position was read between the two).
#[test]
fn a_homing_that_was_cut_short_goes_on_until_a_stop() {
    let at = |ms: u32| Instant::ZERO.plus_ms(ms);
    let cut = Outcome::Partly(Failure::Cancelled, Extent::default());
    let mut homed = Homed::default();
    assert!(homed.before(at(0)));
    assert!(homed.ended(at(10), Verb::Home, cut));
    assert!(!homed.before(at(20)), "it may be under way");
    assert!(!homed.ended(at(30), Verb::Stop, Outcome::Unknown(Failure::Silent)));
    assert!(!homed.ended(at(30), Verb::MoveTo, Outcome::Done(0)));
    assert!(!homed.before(at(30)));
    assert!(homed.ended(at(40), Verb::Stop, Outcome::Done(0)));
    assert!(!homed.before(at(35)) && homed.before(at(40)), "what was asked before is older");
    assert!(!homed.ended(at(50), Verb::Stop, Outcome::Done(0)), "nothing was under way");
    assert!(homed.ended(at(60), Verb::Home, Outcome::Done(0)));
    assert!(!homed.before(at(59)) && homed.before(at(60)));
}
