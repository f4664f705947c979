//! Frames and notices for tests.

use polepair_core::explain::ExplainSink as _;

use crate::session::{
    AnomalyKind, AnomalyNotice, ChangeNotice, ExchangeNotice, ExchangeOutcome, FaultNotice,
    Quality, SessionNotice, SignalNotice, intern,
};
use crate::{DecodedFrame, Explanation, Timestamp};

/// Begin of generated captures, nanoseconds since 1970.
pub(crate) const BEGIN_NS: u64 = 1_700_000_000_000_000_000;

/// A capture that is made frame by frame.
#[derive(Default)]
pub(crate) struct FixtureCapture {
    number: u64,
}

impl FixtureCapture {
    /// The next frame: of an axis of `can0` with CANopen, at this time in microseconds.
    pub(crate) fn next_frame(
        &mut self,
        us: u64,
        axis: u32,
        kind: &str,
        notices: &[SessionNotice],
        take: &mut dyn FnMut(&DecodedFrame<'_>),
    ) {
        self.number += 1;
        let mut explained = Explanation::default();
        explained.kind(kind);
        explained.axis(axis);
        take(&DecodedFrame {
            number: self.number,
            time: Some(stamp(us)),
            link: "can0",
            direction: None,
            protocol: Some("canopen"),
            bytes: &[0; 8],
            id: Some(0x180 + axis),
            extended: false,
            remote: false,
            remote_len: 0,
            echo: false,
            stray: false,
            explanation: &explained,
            defect: None,
            notices,
            offset: 0,
        });
    }
}

pub(crate) fn stamp(us: u64) -> Timestamp {
    Timestamp(BEGIN_NS + us * 1000)
}

pub(crate) fn anomaly(kind: AnomalyKind, axis: u32) -> SessionNotice {
    SessionNotice::Anomaly(AnomalyNotice {
        kind,
        axis: Some(axis),
        time: None,
        text: format!("{} here", kind.as_str()),
    })
}

pub(crate) fn signal(axis: u32, called: &str, value: f64) -> SessionNotice {
    let (name, unit, quality) = (intern(called), "mm", Quality::Good);
    SessionNotice::Signal(SignalNotice {
        axis,
        name,
        value,
        exact: None,
        unit,
        quality,
        request: None,
    })
}

pub(crate) fn exchange(axis: u32, wanted: u64, us: u64, outcome: ExchangeOutcome) -> SessionNotice {
    let answered = (outcome != ExchangeOutcome::Unanswered).then(|| (2, Some(stamp(wanted + us))));
    let (request, retries) = ((1, Some(stamp(wanted))), 0);
    SessionNotice::Exchange(ExchangeNotice {
        axis: Some(axis),
        op: "read",
        requested: request,
        answered,
        outcome,
        retries,
    })
}

pub(crate) fn change(axis: u32, to: &str) -> SessionNotice {
    SessionNotice::Change(ChangeNotice { axis: Some(axis), what: "nmt", from: "", to: intern(to) })
}

pub(crate) fn fault(axis: u32, gone: bool) -> SessionNotice {
    let (text, cause, remedy) = ("over-voltage", "braking", "add a brake resistor");
    SessionNotice::Fault(FaultNotice { axis, code: 0x3210, text, cause, remedy, gone })
}
