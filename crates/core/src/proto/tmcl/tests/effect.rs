//! What requests may do to a module.

use crate::drives::assumed;
use crate::explain::{Act, Dissector, Effect, Raw};
use crate::proto::tmcl::TmclDissector;
use crate::proto::tmcl::opcode::Opcode;
use crate::proto::tmcl::session::Ask;
use crate::proto::tmcl::wire::Request;
use crate::station::Class;

fn effect(opcode: Opcode, kind: u8, value: i32) -> Effect {
    let request = Request { address: 1, opcode, kind, motor: 0, value };
    let bytes = request.emit();
    TmclDissector.effect(&Raw { bytes: &bytes, ..Raw::default() }, assumed(&TmclDissector))
}

/// What a host never sends twice is never told as harmless, nor what only reads as anything else.
#[test]
fn effects_agree_with_the_classes_of_requests() {
    for number in 0..=255 {
        for value in [0, 7] {
            let opcode = Opcode::from(number);
            let request = Request { address: 1, opcode, kind: 0, motor: 0, value };
            let effect = effect(opcode, 0, value);
            match Ask::of(request).class {
                Class::Idempotent | Class::Stop => {
                    assert_eq!(effect, Effect::NOTHING, "{opcode:?}")
                }
                Class::Confirm => assert!(effect.act >= Act::Sets, "{opcode:?}"),
                Class::Never => assert!(effect.keeps || effect.act >= Act::Moves, "{opcode:?}"),
            }
        }
    }
}

#[test]
fn parameters_move_by_the_profile_and_what_it_does_not_have_is_unknown() {
    assert_eq!(effect(Opcode::Sap, 0, 100).act, Act::Moves, "target position");
    assert_eq!(effect(Opcode::Sap, 6, 100).act, Act::Sets, "max current");
    assert_eq!(effect(Opcode::Sap, 199, 100), Effect::UNKNOWN);
    assert!(effect(Opcode::Stap, 6, 0).keeps && effect(Opcode::Rsap, 6, 0).keeps);
    let broken = Raw { bytes: &[1, 2, 3], ..Raw::default() };
    assert_eq!(TmclDissector.effect(&broken, None), Effect::UNKNOWN);
}
