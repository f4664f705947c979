//! The known state of an axis as a message, without a request to the drive.

use polepair::LocalAxis;
use polepair_core::axis::AxisStatus;
use polepair_core::profile::{Signal, SignalSource};
use polepair_core::time::Instant;

use crate::message::{ActiveFault, AxisState, SignalValue};

/// All but lease and panel.
pub(super) fn axis_state(id: u16, axis: &LocalAxis) -> AxisState {
    let (state, now) = (axis.state(), axis.connection().now());
    AxisState {
        id,
        mode: axis.mode(&state),
        enabled: known_flag(Signal::Enabled, &state, axis),
        armed: state.armed,
        moving: axis.moving(&state),
        signals: axis
            .profile()
            .signals
            .iter()
            .filter_map(|source| signal_value(axis, &state, source, now))
            .collect(),
        faults: faults(axis, &state),
        lease: None,
        pending_stop: None,
        panel: None,
    }
}

fn known_flag(signal: Signal, state: &AxisStatus, axis: &LocalAxis) -> Option<bool> {
    let reading = state.reading(signal);
    (axis.profile().signal(signal).is_some() && reading.at.is_some()).then_some(reading.raw != 0)
}

/// A signal's value, if it was ever read.
pub(super) fn signal_value(
    axis: &LocalAxis,
    state: &AxisStatus,
    source: &SignalSource,
    now: Instant,
) -> Option<SignalValue> {
    let reading = state.reading(source.signal);
    let at = reading.at?;
    Some(SignalValue {
        signal: source.signal.name().to_owned(),
        value: Some(reading.value).filter(|value| value.is_finite()),
        unit: axis.signal_unit(source.signal).to_owned(),
        age_ms: now.since(at).as_secs_f64() * 1e3,
    })
}

/// Active faults and warnings; an unknown code is shown as a number.
fn faults(axis: &LocalAxis, state: &AxisStatus) -> Vec<ActiveFault> {
    let reading = state.reading(Signal::Fault);
    if reading.at.is_none() {
        return Vec::new();
    }
    let active = polepair::active_faults(axis.profile(), reading.raw).into_iter();
    active
        .map(|fault| ActiveFault {
            code: fault.code,
            name: if fault.text.is_empty() { &fault.name } else { &fault.text }.to_string(),
            symbol: fault.name.into_owned(),
            cause: fault.cause.into_owned(),
            remedy: fault.remedy.into_owned(),
            warning: fault.is_warning,
        })
        .collect()
}
