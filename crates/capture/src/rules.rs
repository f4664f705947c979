//! Rules for the protocol of each link and axis: `tmcl`, `canopen@2,thruster@11`, `modbus-rtu@ttyUSB0`.

use polepair_core::explain::Dissector;
use polepair_core::proto;

/// One protocol, and where it holds.
#[derive(Clone)]
pub struct Rule {
    /// The protocol.
    pub dissector: &'static dyn Dissector,
    /// Scope of the rule.
    pub scope: RuleScope,
}

impl core::fmt::Debug for Rule {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}@{:?}", self.dissector.name(), self.scope)
    }
}

impl PartialEq for Rule {
    fn eq(&self, other: &Self) -> bool {
        self.dissector.name() == other.dissector.name() && self.scope == other.scope
    }
}

/// Scope of a rule.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum RuleScope {
    /// The rule applies to every link.
    Anywhere,
    /// For frames of that axis, node or station.
    Axis(u32),
    /// On the link of that name.
    Link(String),
    /// For frames of that axis on the link of that name.
    AxisOn(String, u32),
}

/// Rules in the order in which they are tried. Without any, every protocol is possible.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Rules(pub Vec<Rule>);

/// Fault in the text of rules.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RuleError {
    /// The word that names no protocol.
    pub word: String,
    /// The known word nearest to it.
    pub nearest: Option<&'static str>,
}

impl Rules {
    /// Reads `PROTO[@ID],…`, where an ID is an axis number or a link's name.
    ///
    /// # Errors
    /// [`RuleError`] when a word names no protocol.
    pub fn parse(text: &str) -> Result<Self, RuleError> {
        text.split(',').map(|rule| Rule::parse(rule.trim())).collect::<Result<_, _>>().map(Self)
    }

    /// Rules for a link with these protocols. Ones that have no frames to decode, such as `sim`, are left out.
    #[must_use]
    pub fn for_protocols<'a>(names: impl IntoIterator<Item = &'a str>) -> Self {
        Self(names.into_iter().filter_map(|name| Rule::parse(name).ok()).collect())
    }

    /// Possible protocols of a link, in the order of trials.
    pub(crate) fn for_link(&self, link: &str) -> Vec<Rule> {
        let mut rules: Vec<Rule> = self
            .0
            .iter()
            .filter(|rule| match &rule.scope {
                RuleScope::Link(name) | RuleScope::AxisOn(name, _) => name == link,
                RuleScope::Axis(_) | RuleScope::Anywhere => true,
            })
            .cloned()
            .collect();
        rules.sort_by_key(|rule| rule.scope == RuleScope::Anywhere);
        rules
    }
}

/// Formats rules as [`Rules::parse`] takes them, except for an axis that was found on one link: that is written as the
/// axis alone.
impl core::fmt::Display for Rules {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        for (at, rule) in self.0.iter().enumerate() {
            f.write_str(if at > 0 { "," } else { "" })?;
            f.write_str(rule.dissector.name())?;
            match &rule.scope {
                RuleScope::Anywhere => {}
                RuleScope::Link(link) => write!(f, "@{link}")?,
                RuleScope::Axis(axis) | RuleScope::AxisOn(_, axis) => write!(f, "@{axis}")?,
            }
        }
        Ok(())
    }
}

impl Rule {
    fn parse(text: &str) -> Result<Self, RuleError> {
        let (name, location) = text.split_once('@').map_or((text, None), |(n, p)| (n, Some(p)));
        let dissector = proto::find_dissector(name).ok_or_else(|| RuleError {
            word: name.to_owned(),
            nearest: nearest_word(name, proto::dissectors().iter().map(|d| d.name())),
        })?;
        let scope = match location {
            None => RuleScope::Anywhere,
            Some(location) => {
                parse_number(location).map_or(RuleScope::Link(location.to_owned()), RuleScope::Axis)
            }
        };
        Ok(Self { dissector, scope })
    }
}

fn parse_number(text: &str) -> Option<u32> {
    match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) => u32::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

/// The word nearest to `word`, if any is near enough to be meant.
pub fn nearest_word<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known
        .into_iter()
        .filter_map(|known| {
            let distance = edit_distance(&word.to_ascii_lowercase(), &known.to_ascii_lowercase());
            let starts = known.starts_with(word) && word.len() > 1;
            (starts || distance <= 1 + known.len() / 4).then_some((distance, known))
        })
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, known)| known)
}

/// Letters to insert, take out, change, or swap with their neighbour.
fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut before = vec![0; b.len() + 1];
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for i in 0..a.len() {
        let mut next = vec![i + 1];
        for j in 0..b.len() {
            let change = row[j] + usize::from(a[i] != b[j]);
            let swapped = i > 0 && j > 0 && a[i] == b[j - 1] && a[i - 1] == b[j];
            let swap = if swapped { before[j - 1] + 1 } else { change };
            next.push(change.min(swap).min(row[j + 1] + 1).min(next[j] + 1));
        }
        before = std::mem::replace(&mut row, next);
    }
    row[b.len()]
}
