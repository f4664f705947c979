//! Effects of requests on a module.

use polepair_core::explain::{Effect, FrameConversation, Impact, RawFrame};
use polepair_core::proto::tmcl::TmclDissector;
use polepair_core::proto::tmcl::opcode::Opcode;
use polepair_core::proto::tmcl::session::HostRequest;
use polepair_core::proto::tmcl::wire::Request;
use polepair_core::station::RequestClass;
use polepair_drives::assumed_profile;

fn effect(opcode: Opcode, kind: u8, value: i32) -> Effect {
    let request = Request { address: 1, opcode, kind, motor: 0, value };
    let bytes = request.emit();
    TmclDissector
        .effect(&RawFrame { bytes: &bytes, ..RawFrame::default() }, assumed_profile(&TmclDissector))
}

/// A request that a host never repeats is never reported as harmless, and only a query is reported as one.
#[test]
fn effects_agree_with_the_classes_of_requests() {
    for number in 0..=255 {
        for value in [0, 7] {
            let opcode = Opcode::from(number);
            let request = Request { address: 1, opcode, kind: 0, motor: 0, value };
            let effect = effect(opcode, 0, value);
            match HostRequest::of(request).class {
                RequestClass::Idempotent | RequestClass::Stop => {
                    assert_eq!(effect, Effect::NOTHING, "{opcode:?}")
                }
                RequestClass::ReadBack => assert!(effect.impact >= Impact::Settings, "{opcode:?}"),
                RequestClass::NoRetry => {
                    assert!(effect.persistent || effect.impact >= Impact::Motion, "{opcode:?}")
                }
            }
        }
    }
}

#[test]
fn parameters_move_by_the_profile_and_what_it_does_not_have_is_unknown() {
    assert_eq!(effect(Opcode::Sap, 0, 100).impact, Impact::Motion, "target position");
    assert_eq!(effect(Opcode::Sap, 6, 100).impact, Impact::Settings, "max current");
    assert_eq!(effect(Opcode::Sap, 199, 100), Effect::UNKNOWN);
    assert!(effect(Opcode::Stap, 6, 0).persistent && effect(Opcode::Rsap, 6, 0).persistent);
    let broken = RawFrame { bytes: &[1, 2, 3], ..RawFrame::default() };
    assert_eq!(TmclDissector.effect(&broken, None), Effect::UNKNOWN);
}
