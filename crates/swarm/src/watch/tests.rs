//! The judge itself: what it takes, and what it does not.

use super::*;
use crate::drives::KINDS;

/// An axis that turned when the server ended was told of, and its wire was not well in time; nothing else is
/// taken.
#[test]
fn only_an_axis_that_was_told_of_may_turn_when_the_server_has_ended() {
    let kind = &KINDS[0];
    let mut watch = Watch::new(kind, 0);
    let now = Instant::ZERO.plus_ms(100_000);
    let long = (ARRIVES.as_millis() as u32) + kind.ramp_ms;
    let well = |ms: u32| Some(Instant::ZERO.plus_ms(100_000 - ms));
    assert_eq!(watch.is_left(now, false, well(60_000)), None, "it stands");
    let truth = Truth { velocity: 20.0, enabled: true, ..Truth::default() };
    watch.look(now, truth, None, None, false);
    for late in [None, well(0), well(long)] {
        assert_eq!(watch.is_left(now, true, late), None);
        assert!(watch.is_left(now, false, late).is_some(), "nobody was told of it");
    }
    assert!(watch.is_left(now, true, well(long + 1)).is_some(), "there was time enough");
}
