//! A protocol in a folder of its own: nothing outside it knows it but one line in a list
//! (`visit_test_protocols`). What it needs of the core are the public traits.
//!
//! A request has the identifier 300h + address, and its reply 380h + address. Byte 0 is the operation, byte 1
//! the register, bytes 4 to 7 the value, lowest first.

mod device;
mod driver;
mod host;
mod wire;

use polepair_core::axis::Verb;
use polepair_core::plan::{Argument, Operand, Plan, Step};
use polepair_core::profile::{
    Access, AxisKind, Certainty, Encoding, MotionRules, Parameter, ParameterId, Persistence,
    Profile, Scale, Signal, SignalSource, Watchdog,
};
use polepair_core::units::Unit;

pub use device::ToyDevice;
pub use driver::Toy;

/// Register of the commanded speed, and of the actual one.
const COMMANDED: u16 = 0;
const ACTUAL: u16 = 1;

/// The only product.
static PROFILE: Profile = Profile {
    name: "toy",
    family: "toy",
    protocol: "toy",
    title: "Toy drive",
    source: "this file",
    axis: AxisKind::Rotary,
    motors: 1,
    further_motors: &[],
    lists_motors: false,
    parameters: &[
        register("speed", COMMANDED, Access::ReadWrite),
        register("actual speed", ACTUAL, Access::Read),
    ],
    faults: &[],
    signals: &[SignalSource {
        signal: Signal::Velocity,
        parameter: ParameterId(ACTUAL),
        mask: -1,
        equals: None,
        values: &[],
    }],
    plans: &[
        Plan {
            verb: Verb::Velocity,
            source: "this file",
            steps: &[Step::Write(ParameterId(COMMANDED), Operand::Argument(Argument::Velocity))],
            undo: &[],
        },
        Plan {
            verb: Verb::Stop,
            source: "this file",
            steps: &[Step::Send {
                function: 1,
                index: COMMANDED,
                operand: Operand::Constant(0),
                like: None,
            }],
            undo: &[],
        },
    ],
    ram: None,
    link_settings: &[],
    optional: &[],
    motion: MotionRules::NONE,
    watchdog: Watchdog::None,
    reply_timeout_ms: 50,
    multiple_writes: false,
    line: None,
    identity: None,
    caution: "",
};

const fn register(name: &'static str, index: u16, access: Access) -> Parameter {
    Parameter {
        name,
        symbol: name,
        about: "",
        space: 0,
        index,
        encoding: Encoding::I32,
        unit: Unit::Rpm,
        scale: Scale::ONE,
        min: -3000,
        max: 3000,
        default: Some(0),
        access,
        persistence: Persistence::Volatile,
        certainty: Certainty::Documented,
        moves: false,
        section: "",
        values: &[],
        digits: &[],
        bits: &[],
    }
}
