//! Frames that people labelled with their text: each text gives its frame's words, and the words
//! give a text that gives them again.

use super::{F514L, text};
use polepair_core::medium::Frame;
use polepair_core::proto::tml::instruction::{LanguageScope, assemble};
use polepair_core::proto::tml::online::OnlineMessage;
use polepair_core::proto::tml::wire::{IdCode, Instruction, Message};
use polepair_core::proto::tml::{serial, technocan};
use std::{format, string::String, vec::Vec};

const LABELS: &str =
    include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../vectors/tml_viewer.json"));

/// Labels that are not the text of their frame; the frame's bytes are right.
const SLIPS: [(&str, &str); 7] = [
    ("viewer_serial_313", "the value is hexadecimal without 0x"),
    ("viewer_serial_316", "the value is hexadecimal without 0x"),
    ("viewer_serial_317", "the value is hexadecimal without 0x"),
    ("viewer_technocan_262", "the number of a question, not its text"),
    ("viewer_technocan_265", "the number of a question, not its text"),
    ("viewer_technocan_266", "the number of a question, not its text"),
    ("viewer_technocan_269", "the question, on the answer's frame"),
];

struct Label {
    name: String,
    text: String,
    message: Message,
}

fn hex(text: &str) -> Vec<u8> {
    let digits: Vec<char> = text.chars().filter(|c| *c != ' ').collect();
    let byte = |pair: &[char]| u8::from_str_radix(&pair.iter().collect::<String>(), 16).unwrap();
    digits.chunks(2).map(byte).collect()
}

fn labels() -> Vec<Label> {
    let json: serde_json::Value = serde_json::from_str(LABELS).unwrap();
    let label = |v: &serde_json::Value| {
        let field = |key: &str| String::from(v[key].as_str().unwrap_or(""));
        let message = match field("frame").split_once('#') {
            Some((id, data)) => {
                let mut frame = Frame::standard(0, &hex(data));
                frame.id = u32::from_str_radix(id, 16).unwrap();
                let content = technocan::decode(&frame).unwrap();
                let to = content.to.unwrap_or_default();
                Message { to, instruction: content.instruction }
            }
            None => serial::decode(&hex(&field("bytes"))).unwrap(),
        };
        Label { name: field("name"), text: field("text"), message }
    };
    json["vectors"].as_array().unwrap().iter().map(label).collect()
}

/// Labels leave out sender and receiver: they were in another field.
fn scope(instruction: &Instruction) -> LanguageScope<'static> {
    let online = OnlineMessage::parse(instruction);
    let answered = online.and_then(|it| it.answered_by()).map(IdCode::axis);
    let sender = online.and_then(|it| it.reply_to()).or(answered).unwrap_or_default();
    LanguageScope { sender, ..F514L }
}

#[test]
fn every_label_gives_its_frame() {
    let mut wrong = Vec::new();
    for Label { name, text, message } in labels() {
        let slip = SLIPS.iter().any(|(slip, _)| *slip == name);
        let got = assemble(&text, &scope(&message.instruction));
        if (got == Ok(message.instruction)) == slip {
            wrong.push(format!("{name}: {text}: {got:?}, not {:?}", message.instruction));
        }
    }
    assert!(wrong.is_empty(), "{} labels:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn every_labelled_frame_becomes_a_text_that_gives_it_again() {
    for Label { name, message, .. } in labels() {
        let written = text(&message.instruction, &F514L);
        assert!(!written.starts_with(".word"), "{name}: {written}");
        assert_eq!(assemble(&written, &F514L), Ok(message.instruction), "{name}: {written}");
    }
}
