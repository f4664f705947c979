//! Frames as messages, from a live link or from a capture.

use std::fmt::Write as _;

use polepair_capture::{DecodedFrame, ExplanationValue, meaning_text};
use polepair_core::explain::Direction;

use crate::message::{ExplainedField, FrameDirection, FrameItem};

/// A frame, explained in a line; its time is the caller's to fill in.
pub(super) fn frame_item(n: u64, link: u16, event: &DecodedFrame<'_>) -> FrameItem {
    let output = meaning_text(event);
    let text = match event.defect {
        Some(wrong) => format!("{output} ! {wrong}"),
        None => output.to_owned(),
    };
    FrameItem {
        n,
        t_us: 0.0,
        link,
        dir: event.direction.map(|direction| match direction {
            Direction::ToDrive => FrameDirection::Tx,
            Direction::ToHost => FrameDirection::Rx,
        }),
        raw: raw(event),
        text,
        protocol: event.protocol_name().to_owned(),
        axis: event.explanation.axis,
        ok: event.defect.is_none() && !event.stray,
    }
}

fn raw(event: &DecodedFrame<'_>) -> String {
    let mut raw = match event.id {
        None => String::new(),
        Some(id) if event.extended => format!("{id:08X}#"),
        Some(id) => format!("{id:03X}#"),
    };
    for byte in event.bytes {
        // Writing into a String cannot fail.
        let _ = write!(raw, "{byte:02X}");
    }
    raw
}

/// The fields of a frame, in order.
pub(super) fn explained_fields(event: &DecodedFrame<'_>) -> Vec<ExplainedField> {
    event
        .explanation
        .fields()
        .map(|item| ExplainedField {
            from: item.start,
            to: item.end,
            name: item.name.to_owned(),
            value: value(item.value),
            meaning: item.meaning.to_owned(),
        })
        .collect()
}

fn value(value: ExplanationValue<'_>) -> String {
    match value {
        ExplanationValue::Int(value) => value.to_string(),
        ExplanationValue::Hex(value, digits) => {
            format!("{value:0digits$X}", digits = usize::from(digits))
        }
        ExplanationValue::Real(value) => value.to_string(),
        ExplanationValue::Text(text) => text.to_owned(),
        ExplanationValue::Words(bytes) => {
            let words = bytes.chunks(2).map(|word| {
                word.iter().fold(String::new(), |text, byte| format!("{text}{byte:02X}"))
            });
            words.collect::<Vec<_>>().join(" ")
        }
    }
}
