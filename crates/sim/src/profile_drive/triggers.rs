//! The meaning of the requests that a profile's plans send.

use polepair_core::plan::{Argument, Compare, Operand, ParameterTest, Plan, Step};
use polepair_core::profile::{ParameterId, Profile, Signal};
use polepair_core::verb::Verb;

/// One write that a plan makes.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) enum Written {
    /// This value.
    Constant(i64),
    /// These bits.
    Bits { mask: i64, raw: i64 },
    /// The argument of the command.
    Argument(Argument),
    /// Any value: the motor does not depend on it.
    Anything,
}

impl Written {
    /// Returns whether a plan could have written `raw`.
    pub(super) const fn allows(self, raw: i64) -> bool {
        match self {
            Self::Constant(constant) => raw == constant,
            Self::Bits { mask, raw: bits } => raw & mask == bits & mask,
            Self::Argument(_) | Self::Anything => true,
        }
    }

    const fn is_fixed(self) -> bool {
        matches!(self, Self::Constant(_) | Self::Bits { .. })
    }
}

/// The writes of one request.
type Request = Vec<(ParameterId, Written)>;

/// A way through a plan: its writes, and the sign of the argument for which it is taken.
#[derive(Clone, Debug)]
pub(super) struct Trigger {
    pub verb: Verb,
    /// Writes before the trigger.
    pub before: Request,
    /// Writes that the plan makes only in some states of the drive.
    pub conditional: Request,
    /// The writes of the request that starts it.
    pub request: Request,
    /// True if the argument is negative on this way, where the way depends on it.
    pub is_negative: Option<bool>,
}

impl Trigger {
    /// Returns whether it makes all these writes.
    pub(super) fn includes(&self, request: &Request) -> bool {
        let all = || self.before.iter().chain(&self.conditional).chain(&self.request);
        request.iter().all(|write| all().any(|own| own == write))
    }

    /// The parameter that carries an argument.
    pub(super) fn argument(&self, which: Argument) -> Option<ParameterId> {
        let carries = |(_, written): &&(ParameterId, Written)| *written == Written::Argument(which);
        self.before.iter().chain(&self.request).find(carries).map(|(id, _)| *id)
    }

    /// Number of values that must be right, in the request and before it: the most exact trigger is meant.
    pub(super) fn exactness(&self) -> (usize, usize) {
        let fixed = |request: &Request| request.iter().filter(|(_, it)| it.is_fixed()).count();
        (fixed(&self.request), fixed(&self.before))
    }
}

/// A state that a plan waits for, and the write that the drive answers with it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(super) struct Reaction {
    /// `None` for what is there from the beginning.
    pub after: Option<(ParameterId, Written)>,
    pub shown_by: ParameterId,
    pub test: ParameterTest,
}

/// The triggers of a profile, and what its drive answers.
pub(super) fn read(profile: &Profile) -> (Vec<Trigger>, Vec<Reaction>) {
    let (mut triggers, mut reactions) = (Vec::new(), Vec::new());
    for plan in profile.plans {
        for is_negative in [None, Some(false), Some(true)] {
            let has_ways = plan.steps.iter().any(|step| matches!(step, Step::SkipBySign { .. }));
            if has_ways == is_negative.is_some() {
                walk(profile, plan, is_negative, &mut triggers, &mut reactions);
            }
        }
    }
    (triggers, reactions)
}

fn walk(
    profile: &Profile,
    plan: &Plan,
    is_negative: Option<bool>,
    triggers: &mut Vec<Trigger>,
    reactions: &mut Vec<Reaction>,
) {
    let mut requests: Vec<(bool, Request)> = Vec::new();
    // Steps of the open block, which is passed in some states only.
    let (mut at, mut block_end) = (0, 0);
    while let Some(step) = plan.steps.get(at) {
        at += 1;
        match *step {
            Step::SkipBySign { if_negative, count, .. } if is_negative == Some(if_negative) => {
                at += usize::from(count);
                continue;
            }
            Step::Skip { count, .. } | Step::SkipIfMissing { count, .. } => {
                block_end = block_end.max(at + usize::from(count));
                continue;
            }
            Step::Require { read, test, .. } | Step::Until { read, test, .. } => {
                let after = requests.last().and_then(|(_, request)| request.last()).copied();
                let is_wait = matches!(step, Step::Until { .. });
                reactions.push(Reaction { after: after.filter(|_| is_wait), shown_by: read, test });
                continue;
            }
            _ => {}
        }
        let request = request_of(step);
        if !request.is_empty() {
            requests.push((at <= block_end, request));
        }
    }
    // A command that is taken back at the end of a pulse was given at its beginning.
    while let Some((_, last)) = requests.last()
        && requests[..requests.len() - 1].iter().any(|(_, request)| takes_back(last, request))
    {
        requests.pop();
    }
    let always = requests.iter().rposition(|(is_conditional, _)| !is_conditional);
    let Some(trigger) = always.or(requests.len().checked_sub(1)) else { return };
    let (_, request) = requests.remove(trigger);
    let (mut before, mut conditional) = (Request::new(), Request::new());
    for (is_conditional, writes) in requests {
        // A register that is written again has another value by then.
        before.retain(|(id, _)| !writes.iter().any(|(other, _)| other == id));
        if is_conditional { &mut conditional } else { &mut before }.extend(writes);
    }
    before.retain(|(id, _)| !request.iter().any(|(other, _)| other == id));
    triggers.push(Trigger { verb: plan.verb, before, conditional, request, is_negative });
    // Without an own flag nothing is read that the signals do not show.
    let signals =
        |id| profile.signals.iter().any(|s| s.parameter == id && s.signal != Signal::Mode);
    reactions.retain(|reaction| !(signals(reaction.shown_by) && reaction.test.mask == -1));
}

/// Returns whether a write only clears what an earlier one set.
fn takes_back(last: &Request, earlier: &Request) -> bool {
    let ([(id, last)], [(other, earlier)]) = (&last[..], &earlier[..]) else { return false };
    let is_cleared = match (last, earlier) {
        (Written::Constant(0), Written::Constant(set)) => *set != 0,
        (Written::Bits { mask, raw: 0 }, Written::Bits { mask: other, raw }) => {
            mask == other && *raw != 0
        }
        _ => false,
    };
    id == other && is_cleared
}

/// The writes of a step; none for one that writes no parameter.
fn request_of(step: &Step) -> Request {
    match *step {
        Step::Write(id, operand) => vec![(id, written(operand))],
        Step::Ensure(id, raw) => vec![(id, Written::Constant(raw))],
        Step::WriteBits { id, mask, raw } => vec![(id, Written::Bits { mask, raw })],
        Step::WriteTogether(writes) => {
            writes.iter().map(|(id, operand)| (*id, written(*operand))).collect()
        }
        _ => Request::new(),
    }
}

const fn written(operand: Operand) -> Written {
    match operand {
        Operand::Constant(raw) => Written::Constant(raw),
        Operand::Argument(which) | Operand::Magnitude(which) | Operand::OptionalArgument(which) => {
            Written::Argument(which)
        }
        Operand::OptionalRampTime { .. } => Written::Anything,
    }
}

/// A value that passes a test, as near to `raw` as that goes.
pub(super) const fn passing(test: ParameterTest, raw: i64) -> i64 {
    if test.passes(raw) {
        return raw;
    }
    match test.compare {
        Compare::Equal => raw & !test.mask | test.value,
        Compare::NotEqual => raw ^ lowest_bit(test.mask),
        Compare::Within => raw & !test.mask,
        Compare::Above => test.value + 1,
        Compare::Among => raw & !test.mask | test.value.trailing_zeros() as i64,
    }
}

pub(super) const fn lowest_bit(mask: i64) -> i64 {
    mask & mask.wrapping_neg()
}
