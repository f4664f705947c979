//! What counts as the same place.

use super::{POSITION_ERROR_MAX, apart};

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
