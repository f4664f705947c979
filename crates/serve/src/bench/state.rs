//! The known state of an axis as a message, without a request to the drive.

use polepair::LocalAxis;
use polepair_core::axis::AxisStatus;
use polepair_core::profile::{Severity, Signal, SignalSource};
use polepair_core::time::Instant;

use crate::message::{ActiveFault, AxisState, SignalValue};

/// All but lease and panel.
pub(super) fn axis_state(id: u16, axis: &LocalAxis) -> AxisState {
    let (state, now) = (axis.state(), axis.connection().now());
    let flag = |signal| {
        let reading = state.reading(signal);
        (axis.profile().signal(signal).is_some() && reading.at.is_some())
            .then_some(reading.raw != 0)
    };
    let known = |source: &SignalSource| signal_value(axis, &state, source, now);
    AxisState {
        id,
        mode: axis.mode(&state),
        enabled: flag(Signal::Enabled),
        armed: state.armed,
        moving: axis.moving(&state),
        signals: axis.profile().signals.iter().filter_map(known).collect(),
        faults: faults(axis, &state),
        lease: None,
        owed: None,
        panel: None,
    }
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

/// Faults and warnings that stand; a code that nobody knows is told as it is.
fn faults(axis: &LocalAxis, state: &AxisStatus) -> Vec<ActiveFault> {
    let reading = state.reading(Signal::Fault);
    let raw = u32::try_from(reading.raw).unwrap_or(0);
    if reading.at.is_none() || raw == 0 {
        return Vec::new();
    }
    let known = polepair::faults(axis.profile(), raw);
    if known.is_empty() {
        let name = format!("fault {raw:#x}");
        let remedy = "look it up in the drive's manual".to_owned();
        let (symbol, cause, warning) = (name.clone(), String::new(), false);
        return vec![ActiveFault { code: raw, name, symbol, cause, remedy, warning }];
    }
    let stands = known.into_iter().filter(|fault| fault.severity != Severity::Note);
    let active_faults = stands.map(|fault| ActiveFault {
        code: fault.code,
        name: if fault.text.is_empty() { fault.name } else { fault.text }.to_owned(),
        symbol: fault.name.to_owned(),
        cause: fault.cause.to_owned(),
        remedy: fault.remedy.to_owned(),
        warning: fault.severity != Severity::Fault,
    });
    active_faults.collect()
}
