//! The plans of a profile as Rust.

use polepair_core::plan::{Operand, Plan, Step};
use polepair_core::profile::ParameterId;

use super::{condition_expr, mask_literal, parameter_id, test_expr};

pub(super) fn plan_row(p: &Plan) -> String {
    format!(
        "Plan {{ verb: Verb::{:?}, source: {:?}, steps: &[{}], undo: &[{}] }}",
        p.verb,
        p.source,
        steps_text(p.steps),
        steps_text(p.undo)
    )
}

fn steps_text(steps: &[Step]) -> String {
    match steps {
        [] => String::new(),
        steps => {
            steps.iter().map(|step| format!("\n        {},", step_expr(step))).collect::<String>()
                + "\n    "
        }
    }
}

fn step_expr(step: &Step) -> String {
    match *step {
        Step::Write(to, what) => {
            format!("Step::Write({}, {})", parameter_id(to), operand_expr(what))
        }
        Step::Ensure(to, raw) => format!("Step::Ensure({}, {raw})", parameter_id(to)),
        Step::WriteTogether(writes) => {
            let one = |(id, operand): &(ParameterId, Operand)| {
                format!("({}, {})", parameter_id(*id), operand_expr(*operand))
            };
            let writes: Vec<String> = writes.iter().map(one).collect();
            format!("Step::WriteTogether(&[{}])", writes.join(", "))
        }
        Step::WriteBits { id, mask, raw } => {
            format!(
                "Step::WriteBits {{ id: {}, mask: {mask:#x}, raw: {raw:#x} }}",
                parameter_id(id)
            )
        }
        Step::SkipBySign { argument, if_negative, count } => format!(
            "Step::SkipBySign {{ argument: Argument::{argument:?}, if_negative: {if_negative}, count: {count} }}"
        ),
        Step::Read(from) => format!("Step::Read({})", parameter_id(from)),
        Step::Copy { from, to } => {
            format!("Step::Copy {{ from: {}, to: {} }}", parameter_id(from), parameter_id(to))
        }
        Step::Require { read, test: t, hint } => {
            let (read, t) = (parameter_id(read), test_expr(t));
            format!("Step::Require {{ read: {read}, test: {t}, hint: {hint:?} }}")
        }
        Step::Skip { read, test: t, count } => {
            let (read, t) = (parameter_id(read), test_expr(t));
            format!("Step::Skip {{ read: {read}, test: {t}, count: {count} }}")
        }
        Step::SkipIfMissing { read, count } => {
            format!("Step::SkipIfMissing {{ read: {}, count: {count} }}", parameter_id(read))
        }
        Step::NoFault { read, mask: m } => {
            format!("Step::NoFault {{ read: {}, mask: {} }}", parameter_id(read), mask_literal(m))
        }
        Step::Until { read, test: t, within_ms, required } => {
            let (read, t) = (parameter_id(read), test_expr(t));
            format!(
                "Step::Until {{ read: {read}, test: {t}, within_ms: {within_ms}, required: {required} }}"
            )
        }
        Step::Send { function, index, operand: what, like } => {
            let (what, like) = (operand_expr(what), like.map(parameter_id));
            let like = like.map_or("None".to_owned(), |it| format!("Some({it})"));
            format!(
                "Step::Send {{ function: {function:#x}, index: {index:#x}, operand: {what}, \
                 like: {like} }}"
            )
        }
        Step::Store(what) => format!("Step::Store({})", parameter_id(what)),
        Step::Wait { ms } => format!("Step::Wait {{ ms: {ms} }}"),
        Step::Standstill { within_ms } => {
            format!("Step::Standstill {{ within_ms: {within_ms} }}")
        }
        Step::Homed { read, test: t, within_ms } => {
            let (read, t) = (parameter_id(read), test_expr(t));
            format!("Step::Homed {{ read: {read}, test: {t}, within_ms: {within_ms} }}")
        }
        Step::Arrival { flag, within_ms } => {
            format!("Step::Arrival {{ flag: {}, within_ms: {within_ms} }}", condition_expr(flag))
        }
    }
}

fn operand_expr(operand: Operand) -> String {
    match operand {
        Operand::Constant(raw) => format!("Operand::Constant({raw})"),
        Operand::Argument(what) => format!("Operand::Argument(Argument::{what:?})"),
        Operand::Magnitude(what) => format!("Operand::Magnitude(Argument::{what:?})"),
        Operand::OptionalArgument(what) => format!("Operand::OptionalArgument(Argument::{what:?})"),
        Operand::OptionalRampTime { argument, speed } => format!(
            "Operand::OptionalRampTime {{ argument: Argument::{argument:?}, speed: RampSpeed::{speed:?} }}"
        ),
    }
}
