//! Reads the scale of a parameter.

use super::draft::ParameterName;
use super::read::optional_choice;
use super::step;
use crate::toml_file::{FileError, TomlTable};
use polepair_core::plan::ParameterTest;
use polepair_core::profile::ScaleRule;
use polepair_drives::scale_rules;

/// Parts of a scale.
pub(super) struct ScaleParts {
    pub factor: f64,
    pub times: Option<ParameterName>,
    pub over: Option<ParameterName>,
    pub rule: Option<&'static ScaleRule>,
    pub negative: Option<(ParameterName, ParameterTest)>,
}

pub(super) fn read_scale(table: &TomlTable<'_, '_>) -> Result<ScaleParts, FileError> {
    let words = scale_rules().map(|rule| (rule.name, rule));
    let keys = ["factor", "times", "over", "rule", "negative"];
    let node = if table.is_table("scale") { table.table("scale", &keys)? } else { None };
    let factor = match &node {
        Some(node) => node.float("factor")?,
        None => table.float("scale")?,
    };
    let factor = factor.map(|found| {
        found.try_map(|f| if f == 0.0 { Err("a scale cannot be 0".into()) } else { Ok(f) })
    });
    let factor = factor.transpose()?.unwrap_or(1.0);
    let Some(node) = node else {
        return Ok(ScaleParts { factor, times: None, over: None, rule: None, negative: None });
    };
    Ok(ScaleParts {
        factor,
        times: node.text("times")?,
        over: node.text("over")?,
        rule: optional_choice(&node, "rule", &words)?,
        negative: node.text("negative")?.map(|test| step::parse_test(&test)).transpose()?,
    })
}
