//! Positions that count as equal.

use polepair_core::axis::Verb;
use polepair_core::error::{Extent, Failure, Outcome};
use polepair_core::time::Instant;

use super::{HomingIdle, POSITION_ERROR_MAX, offset_error};

/// A thruster reports tenths of a degree in 16 bits (swarm seed can:211831: it was past 3276.7 degrees).
#[test]
fn a_position_of_16_bits_begins_again_and_is_held_to_all_others() {
    let step = 0.1_f64.to_radians();
    let turn = Some(65_536.0 * step);
    for turns in [-2.0, -1.0, 0.0, 1.0] {
        let error = offset_error(0.02, 0.02 + turns * 65_536.0 * step, turn);
        assert!(error < 1e-6, "{turns}: {error}");
        let error = offset_error(0.0, turns * 65_536.0 * step + 0.3, turn);
        assert!((error - 0.3).abs() < 1e-6 && error > POSITION_ERROR_MAX, "{turns}: {error}");
    }
    assert!(offset_error(0.0, 65_536.0 * step, None) > 100.0, "what has more bits does not");
}

/// A drive sets its zero at the end of a homing, also if the host's job was cut short
/// (swarm seed can:629487: a position was read between the two).
#[test]
fn a_homing_that_was_cut_short_goes_on_until_a_stop() {
    let at = |ms: u32| Instant::ZERO.plus_ms(ms);
    let cut = Outcome::Partly(Failure::Cancelled, Extent::default());
    let mut homed = HomingIdle::default();
    assert!(homed.is_idle_since(at(0)));
    assert!(homed.record_end(at(10), Verb::Home, cut));
    assert!(!homed.is_idle_since(at(20)), "it may be under way");
    assert!(!homed.record_end(at(30), Verb::Stop, Outcome::Unknown(Failure::Silent)));
    assert!(!homed.record_end(at(30), Verb::MoveTo, Outcome::Done(0)));
    assert!(!homed.is_idle_since(at(30)));
    assert!(homed.record_end(at(40), Verb::Stop, Outcome::Done(0)));
    assert!(
        !homed.is_idle_since(at(35)) && homed.is_idle_since(at(40)),
        "what was asked before is older"
    );
    assert!(!homed.record_end(at(50), Verb::Stop, Outcome::Done(0)), "nothing was under way");
    assert!(homed.record_end(at(60), Verb::Home, Outcome::Done(0)));
    assert!(!homed.is_idle_since(at(59)) && homed.is_idle_since(at(60)));
}
