//! Plans as they were written: a profile that extends another one may change their fragments.

use super::blocks::{self, Fragment};
use super::draft::{Draft, DraftPlan};
use super::motors::MotorChoice;
use super::read::optional_text;
use crate::toml_file::{FileError, FileLocation, Located, SourceText, TomlTable};
use polepair_core::axis::Verb;

/// A plan with its steps as text.
#[derive(Clone, Debug)]
pub(crate) struct WrittenPlan {
    location: FileLocation,
    verb: Verb,
    source: String,
    steps: Vec<Located<String>>,
    undo: Vec<Located<String>>,
}

impl WrittenPlan {
    fn parse(&self, fragments: &[Fragment]) -> Result<DraftPlan, FileError> {
        Ok(DraftPlan {
            location: self.location.clone(),
            verb: self.verb,
            source: self.source.clone(),
            steps: blocks::read_steps(&self.steps, fragments)?,
            undo: blocks::read_steps(&self.undo, fragments)?,
        })
    }
}

/// Reads fragments and plans of a file. Its fragments replace those of the profile that it extends, in the plans of
/// that one too.
pub(super) fn read_plans(
    draft: &mut Draft,
    node: &TomlTable<'_, '_>,
    motor: MotorChoice,
) -> Result<(), FileError> {
    let own_fragments = blocks::read_fragments(node, motor)?;
    let own_plans = read_plan_texts(node, motor)?;
    // `replace = ["plans"]` takes them away.
    draft.plan_texts.retain(|text| draft.plans.iter().any(|plan| plan.verb == text.verb));
    for fragment in &own_fragments {
        match draft.fragments.iter_mut().find(|(name, _)| *name == fragment.0) {
            Some(inherited) => *inherited = fragment.clone(),
            None => draft.fragments.push(fragment.clone()),
        }
    }
    for text in own_plans.iter().cloned() {
        match draft.plan_texts.iter_mut().find(|other| other.verb == text.verb) {
            Some(inherited) => *inherited = text,
            None => draft.plan_texts.push(text),
        }
    }
    // Inherited plans stay as they are where no fragment changed.
    let changed = if own_fragments.is_empty() { &own_plans } else { &draft.plan_texts };
    for text in changed {
        let plan = text.parse(&draft.fragments)?;
        match draft.plans.iter_mut().find(|other| other.verb == plan.verb) {
            Some(inherited) => *inherited = plan,
            None => draft.plans.push(plan),
        }
    }
    let in_plans = draft.plan_texts.iter().flat_map(|text| text.steps.iter().chain(&text.undo));
    let in_fragments = draft.fragments.iter().flat_map(|(_, steps)| steps);
    blocks::check_used(&own_fragments, in_plans.chain(in_fragments), node)
}

/// Gives a draft of a profile that is compiled in the texts of its plans.
pub(super) fn add_plan_texts(draft: &mut Draft, motor: usize) -> Result<(), FileError> {
    let Some(text) = polepair_drives::plan_text(&draft.name) else { return Ok(()) };
    let motor = MotorChoice { number: motor, count: draft.motors.max(1).into() };
    let file = format!("profile {}", draft.name);
    SourceText::new(&file, text).parse(&["fragments", "plans"], |node| {
        draft.fragments = blocks::read_fragments(&node, motor)?;
        draft.plan_texts = read_plan_texts(&node, motor)?;
        Ok(())
    })
}

fn read_plan_texts(
    node: &TomlTable<'_, '_>,
    motor: MotorChoice,
) -> Result<Vec<WrittenPlan>, FileError> {
    let names = Verb::ALL.map(Verb::name);
    let Some(table) = node.table("plans", &names)? else { return Ok(Vec::new()) };
    let mut texts = Vec::new();
    for verb in Verb::ALL.into_iter().filter(|verb| table.has(verb.name())) {
        let keys = ["source", "steps", "undo"];
        let Some(node) = table.table(verb.name(), &keys)? else { continue };
        let steps = motor.choose_all(node.texts("steps")?)?;
        if steps.is_empty() {
            return Err(node.location().error("a plan needs `steps`"));
        }
        texts.push(WrittenPlan {
            location: node.location(),
            verb,
            source: optional_text(&node, "source")?,
            steps,
            undo: motor.choose_all(node.texts("undo")?)?,
        });
    }
    Ok(texts)
}

#[cfg(test)]
mod tests {
    use super::super::parse;
    use polepair_core::axis::Verb;
    use polepair_core::plan::Step;
    use polepair_core::profile::Profile;

    /// A fragment replaces the one with its name in the plans of the profile that a file extends, and own plans may use
    /// inherited ones.
    #[test]
    fn a_fragment_replaces_that_of_the_extended_profile() {
        let shipped = polepair_drives::profiles().iter().find(|p| p.name == "cia402").unwrap();
        let own = |text: &str| {
            parse("own.toml", &format!("name = \"own\"\nextends = \"cia402\"\n{text}")).unwrap()
        };
        let unchanged = own("[fragments]\npower-up = [\"use switch-on\"]\n");
        let (enable, velocity) = (Verb::Enable, Verb::Velocity);
        let steps = |profile: &'static Profile, verb| profile.plan(verb).unwrap().steps;
        assert!(steps(unchanged, velocity).len() < steps(shipped, velocity).len());
        // A plan without the fragment is as it was.
        assert_eq!(steps(unchanged, Verb::Store), steps(shipped, Verb::Store));
        let slow = own("[fragments]\nswitch-on = [\"write controlword = 6\", \"wait 500 ms\"]\n");
        let waits = |verb| {
            let waits = |step: &Step| matches!(step, Step::Wait { ms: 500 });
            steps(slow, verb).iter().any(waits)
        };
        assert!(waits(enable) && waits(velocity), "also in the fragment that uses it");
        let used =
            own("[plans.clear]\nsteps = [\"use switch-on\", \"write controlword = 0x80\"]\n");
        assert!(steps(used, Verb::Clear).len() > 4);
        assert_eq!(steps(used, velocity), steps(shipped, velocity));
        // Plans that were taken away do not come back with a fragment.
        let text = "replace = [\"plans\"]\n[fragments]\ngo = [\"write controlword = 0\"]\n\
                    [plans.stop]\nsteps = [\"use go\"]\n";
        assert!(own(text).plan(velocity).is_none());
    }

    /// The texts of shipped plans are those of the compiled plans.
    #[test]
    fn texts_of_shipped_plans_are_those_that_are_compiled() {
        for shipped in polepair_drives::profiles() {
            let Some(text) = polepair_drives::plan_text(shipped.name) else { continue };
            let name = shipped.name;
            let again = format!("name = \"again\"\nextends = \"{name}\"\n{text}");
            let again =
                parse("again.toml", &again).unwrap_or_else(|error| panic!("{name}: {error}"));
            for plan in shipped.plans {
                assert_eq!(
                    again.plan(plan.verb).unwrap().steps,
                    plan.steps,
                    "{name} {:?}",
                    plan.verb
                );
            }
        }
    }
}
