//! Stored paths of a drive: read from it, and planned without it.

use std::collections::BTreeMap;
use std::time::Duration;

use polepair::Axis;
use polepair::paths::{
    PathDefinition, PathPreview, PathTable, PathUnit, end_word, find_end, find_kind, kind_word,
};

use super::Bench;
use super::reply::PendingReply;
use crate::message::{
    GatewayError, PathChangeMessage, PathFindingMessage, PathPlan, PathRow, PathTableMessage,
    PlanPaths, PreviewPointMessage,
};

/// Longest run that is shown, and its points at most.
const PREVIEW_MAX: Duration = Duration::from_secs(60);
const POINTS_MAX: usize = 1000;

impl Bench {
    /// Reads the stored paths of a drive.
    pub fn read_paths(&self, axis: u16) -> PendingReply<PathTableMessage> {
        self.query_axis(axis, |axis| {
            let table = PathTable::read(&Axis::from(axis.clone()), None, |_| {})?;
            Ok(table_message(&table))
        })
    }
}

/// Plans to load a table. It takes some milliseconds of computing, and sends nothing.
pub(crate) fn plan_paths(request: &PlanPaths) -> Result<PathPlan, GatewayError> {
    let (drive, wanted) = (parse_table(&request.drive)?, parse_table(&request.wanted)?);
    let after = wanted.written_over(&drive);
    let findings = after.check();
    let has_error = findings.iter().any(|finding| finding.is_error);
    let preview = if has_error || after.path(request.path).is_empty() {
        Vec::new()
    } else {
        preview_points(&after.preview(request.path, 0, PREVIEW_MAX)?)
    };
    let writes = if has_error { Vec::new() } else { wanted.write_steps(&drive, true) };
    let raw_values = |step: Vec<(String, i64)>| step.into_iter().collect::<BTreeMap<_, _>>();
    Ok(PathPlan {
        chains: after.first_paths().iter().map(|start| after.chain(*start).to_string()).collect(),
        changes: drive
            .changes(&after)
            .into_iter()
            .map(|it| PathChangeMessage {
                path: it.path.unwrap_or(0),
                field: it.field.to_owned(),
                from: it.from,
                to: it.to,
            })
            .collect(),
        findings: findings
            .into_iter()
            .map(|it| PathFindingMessage {
                path: it.path.unwrap_or(0),
                is_error: it.is_error,
                text: it.text,
            })
            .collect(),
        writes: writes.into_iter().map(raw_values).collect(),
        preview,
    })
}

fn preview_points(preview: &PathPreview) -> Vec<PreviewPointMessage> {
    let every = preview.points.len().div_ceil(POINTS_MAX).max(1);
    let points = preview.points.iter().step_by(every).chain(preview.points.last());
    points
        .map(|point| PreviewPointMessage {
            time: point.time.as_secs_f64(),
            position: point.position,
            speed: point.speed,
        })
        .collect()
}

fn table_message(table: &PathTable) -> PathTableMessage {
    let rows = table.paths.iter().map(|(number, path)| PathRow {
        number: *number,
        kind: kind_word(path.kind),
        end: end_word(path.end).to_owned(),
        position: f64::from(path.thousandths) / 1000.0,
        speed: path.rpm,
        acceleration_ms: path.acceleration_ms,
        deceleration_ms: path.deceleration_ms,
        s_ms: path.s_ms,
        delay_ms: path.delay_ms,
        next: path.next.unwrap_or(0),
        interrupts: path.interrupts,
    });
    PathTableMessage {
        motor_turns: table.motor_turns,
        travel: table.travel,
        unit: table.unit.symbol().to_owned(),
        paths: rows.collect(),
    }
}

fn parse_table(message: &PathTableMessage) -> Result<PathTable, GatewayError> {
    let refused = |what: String| GatewayError::new("E217", what);
    let mut table = PathTable::new();
    table.motor_turns = message.motor_turns;
    table.travel = message.travel;
    table.unit = match &*message.unit {
        "deg" => PathUnit::Degree,
        "mm" => PathUnit::Millimetre,
        other => return Err(refused(format!("`{other}` is no unit of paths: deg or mm"))),
    };
    for row in &message.paths {
        let number = row.number;
        if !(1..=32).contains(&number) {
            return Err(refused(format!("path {number}: paths are numbered 1 to 32")));
        }
        let path =
            parse_row(row, &table).map_err(|what| refused(format!("path {number}: {what}")))?;
        if table.paths.insert(number, path).is_some() {
            return Err(refused(format!("path {number} is there twice")));
        }
    }
    Ok(table)
}

fn parse_row(row: &PathRow, table: &PathTable) -> Result<PathDefinition, String> {
    let kind = find_kind(&row.kind).ok_or_else(|| format!("`{}` is no kind", row.kind))?;
    let end = find_end(&row.end).ok_or_else(|| format!("`{}` is no end", row.end))?;
    if row.next > 32 {
        return Err(format!("its next path is {}, of 32", row.next));
    }
    Ok(PathDefinition {
        kind,
        end,
        next: Some(row.next).filter(|next| *next != 0),
        interrupts: row.interrupts,
        thousandths: table.thousandths(row.position)?,
        rpm: row.speed,
        acceleration_ms: row.acceleration_ms,
        deceleration_ms: row.deceleration_ms,
        delay_ms: row.delay_ms,
        s_ms: row.s_ms,
    })
}
