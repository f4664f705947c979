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

/// A way through a plan: its writes, and the sign of the argument for which it is taken.
#[derive(Clone, Debug)]
pub(super) struct Trigger {
    pub verb: Verb,
    /// Writes before the trigger, in order.
    pub before: Vec<(ParameterId, Written)>,
    /// The writes of the request that starts it.
    pub request: Vec<(ParameterId, Written)>,
    /// True if the argument is negative on this way, where the way depends on it.
    pub is_negative: Option<bool>,
}

impl Trigger {
    /// Every write of it.
    pub(super) fn writes(&self) -> impl Iterator<Item = &(ParameterId, Written)> {
        self.before.iter().chain(&self.request)
    }

    /// The parameter that carries an argument.
    pub(super) fn argument(&self, which: Argument) -> Option<ParameterId> {
        let carries = |(_, written): &&(ParameterId, Written)| *written == Written::Argument(which);
        self.writes().find(carries).map(|(id, _)| *id)
    }

    /// Number of values that must be right: the most exact trigger is meant.
    pub(super) fn exactness(&self) -> usize {
        self.writes().filter(|(_, written)| written.is_fixed()).count()
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
    let mut requests: Vec<Vec<(ParameterId, Written)>> = Vec::new();
    let mut steps = plan.steps.iter();
    while let Some(step) = steps.next() {
        match *step {
            Step::SkipBySign { if_negative, count, .. } if is_negative == Some(if_negative) => {
                let _ = steps.by_ref().take(usize::from(count)).count();
            }
            Step::Write(id, operand) => requests.push(vec![(id, written(operand))]),
            Step::Ensure(id, raw) => requests.push(vec![(id, Written::Constant(raw))]),
            Step::WriteBits { id, mask, raw } => {
                requests.push(vec![(id, Written::Bits { mask, raw })]);
            }
            Step::WriteTogether(writes) => {
                requests.push(writes.iter().map(|(id, operand)| (*id, written(*operand))).collect())
            }
            Step::Require { read, test, .. } | Step::Until { read, test, .. } => {
                let after = requests.last().and_then(|request| request.last()).copied();
                let is_wait = matches!(step, Step::Until { .. });
                reactions.push(Reaction { after: after.filter(|_| is_wait), shown_by: read, test });
            }
            _ => {}
        }
    }
    // The end of a stop only takes a bit back.
    let at = match plan.verb {
        Verb::Stop | Verb::QuickStop => plan.before_wait(),
        _ => plan.steps,
    };
    let sent = at.iter().filter(|step| step.may_change_drive()).count();
    let skipped = plan.steps.iter().filter(|step| step.may_change_drive()).count() - requests.len();
    requests.truncate(sent.saturating_sub(skipped).max(1));
    let Some(request) = requests.pop() else { return };
    let before = requests.into_iter().flatten().collect();
    triggers.push(Trigger { verb: plan.verb, before, request, is_negative });
    // Without an own flag nothing is read that the signals do not show.
    let signals =
        |id| profile.signals.iter().any(|s| s.parameter == id && s.signal != Signal::Mode);
    reactions.retain(|reaction| !(signals(reaction.shown_by) && reaction.test.mask == -1));
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
