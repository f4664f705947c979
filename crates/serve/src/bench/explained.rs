//! Frames in the words of their messages, whether they passed just now or lie in a capture.

use std::fmt::Write as _;

use polepair_capture::{Event, ItemValue, meaning};
use polepair_core::explain::Direction;

use crate::message::{ExplainedField, FrameDirection, FrameItem};

/// A frame, explained in a line; its time is the caller's to fill in.
pub(super) fn item(n: u64, link: u16, event: &Event<'_>) -> FrameItem {
    let said = meaning(event);
    let text = match event.wrong {
        Some(wrong) => format!("{said} ! {wrong}"),
        None => said.to_owned(),
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
        protocol: event.protocol.unwrap_or("").to_owned(),
        axis: event.explained.axis,
        ok: event.wrong.is_none() && !event.stray,
    }
}

fn raw(event: &Event<'_>) -> String {
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
pub(super) fn fields(event: &Event<'_>) -> Vec<ExplainedField> {
    let field = |item: polepair_capture::Item<'_>| ExplainedField {
        from: item.start,
        to: item.end,
        name: item.name.to_owned(),
        value: value(item.value),
        meaning: item.meaning.to_owned(),
    };
    event.explained.items().map(field).collect()
}

fn value(value: ItemValue<'_>) -> String {
    match value {
        ItemValue::Int(value) => value.to_string(),
        ItemValue::Hex(value, digits) => format!("{value:0digits$X}", digits = usize::from(digits)),
        ItemValue::Real(value) => value.to_string(),
        ItemValue::Text(text) => text.to_owned(),
        ItemValue::Words(bytes) => {
            let words = bytes.chunks(2).map(|word| {
                word.iter().fold(String::new(), |text, byte| format!("{text}{byte:02X}"))
            });
            words.collect::<Vec<_>>().join(" ")
        }
    }
}
