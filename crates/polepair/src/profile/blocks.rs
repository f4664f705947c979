//! Blocks and fragments in the steps of a plan: their form in numbered skips.
//!
//! ```text
//! if TEST … end           these steps, if the test passes
//! if velocity < 0 … end   these steps, if the command's argument is negative; also `>= 0`
//! unless TEST … end       these steps, if it does not
//! with NAME … end         these steps, if the drive has the parameter
//! use FRAGMENT            the steps of `[fragments]` with that name
//! ```

use super::draft::DraftStep;
use super::motors::MotorChoice;
use super::step;
use crate::spelling;
use crate::toml_file::{FileError, Located, TomlTable};

/// A list of steps by its name.
pub(crate) type Fragment = (String, Vec<Located<String>>);

/// Fragments that use fragments, at most so deep.
const DEPTH_MAX: usize = 8;

/// Reads the fragments of a profile.
pub(super) fn read_fragments(
    node: &TomlTable<'_, '_>,
    motor: MotorChoice,
) -> Result<Vec<Fragment>, FileError> {
    let Some(table) = node.table("fragments", &[])? else { return Ok(Vec::new()) };
    table
        .keys()
        .into_iter()
        .map(|key| Ok((key.value.to_owned(), motor.choose_all(table.texts(key.value)?)?)))
        .collect()
}

/// Refuses a fragment of the file that no step uses: it would change nothing.
pub(super) fn check_used<'a>(
    fragments: &[Fragment],
    steps: impl Iterator<Item = &'a Located<String>>,
    node: &TomlTable<'_, '_>,
) -> Result<(), FileError> {
    let used: Vec<&str> = steps.filter_map(|step| step.value.trim().strip_prefix("use ")).collect();
    let unused = fragments.iter().find(|(name, _)| !used.iter().any(|used| used.trim() == name));
    let Some((name, steps)) = unused else { return Ok(()) };
    let location = steps.first().map_or_else(|| node.location(), |step| step.location.clone());
    let inherited = if node.has("extends") { ", or of the profile that it extends," } else { "" };
    Err(location.error(format!("no plan of this file{inherited} uses the fragment `{name}`")))
}

/// Reads the steps of a plan.
pub(super) fn read_steps(
    steps: &[Located<String>],
    fragments: &[Fragment],
) -> Result<Vec<DraftStep>, FileError> {
    let mut reader = BlockReader { fragments, steps: Vec::new(), open: Vec::new() };
    reader.read(steps, 0)?;
    Ok(reader.steps)
}

struct BlockReader<'a> {
    fragments: &'a [Fragment],
    steps: Vec<DraftStep>,
    /// Positions of the skips whose blocks are open.
    open: Vec<usize>,
}

impl BlockReader<'_> {
    fn read(&mut self, steps: &[Located<String>], depth: usize) -> Result<(), FileError> {
        let outside = self.open.len();
        for step in steps {
            let (word, rest) = step.value.trim().split_once(' ').unwrap_or((step.value.trim(), ""));
            match word {
                "use" => self.read_fragment(step, rest.trim(), depth)?,
                "end" => self.close(step, outside)?,
                "if" | "unless" | "with" => {
                    self.open.push(self.steps.len());
                    self.steps.push(step::parse_block_start(step)?);
                }
                _ => self.steps.push(step::parse(step)?),
            }
        }
        match (steps.last(), self.open.len() > outside) {
            (Some(last), true) => Err(last.location.error("a block has no `end`")),
            _ => Ok(()),
        }
    }

    fn read_fragment(
        &mut self,
        step: &Located<String>,
        name: &str,
        depth: usize,
    ) -> Result<(), FileError> {
        let fragments = self.fragments;
        let Some((_, steps)) = fragments.iter().find(|(known, _)| known == name) else {
            let known = fragments.iter().map(|(known, _)| known.as_str());
            let near = spelling::suggestion(name, known);
            return Err(step.location.error(format!("there is no fragment `{name}`{near}")));
        };
        if depth == DEPTH_MAX {
            return Err(step.location.error(format!("the fragment `{name}` uses itself")));
        }
        self.read(steps, depth + 1)
    }

    fn close(&mut self, step: &Located<String>, outside: usize) -> Result<(), FileError> {
        let opened = if self.open.len() > outside { self.open.pop() } else { None };
        let Some(at) = opened else {
            return Err(step.location.error("`end` without `if`, `unless` or `with`"));
        };
        let length = self.steps.len() - at - 1;
        let length = u8::try_from(length).ok().filter(|length| *length > 0);
        let length = length.ok_or_else(|| {
            step.location.error("a block has 1 to 63 steps, because a plan has 64 at most")
        })?;
        if let DraftStep::Skip { count, .. }
        | DraftStep::Without { count, .. }
        | DraftStep::SkipBySign { count, .. } = &mut self.steps[at]
        {
            *count = length;
        }
        Ok(())
    }
}
