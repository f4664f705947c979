//! Remarks on a capture beside its frames.

use crate::decoder::CaptureDecoder;
use crate::read::{CapturePosition, ReadStatistics};

/// Damaged places that are named one by one.
const SHOWN: usize = 5;

/// A remark on a capture beside its frames.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Remark {
    /// A note on the reading.
    Note(String),
    /// A part that was left out, or is doubtful.
    Warning(String),
}

impl Remark {
    /// The text.
    #[must_use]
    pub fn text(&self) -> &str {
        match self {
            Self::Note(text) | Self::Warning(text) => text,
        }
    }

    /// Parts of a decoded capture that were left out, and doubtful ones.
    #[must_use]
    pub fn of_decoder(decoder: &CaptureDecoder) -> Vec<Self> {
        let mut remarks = Vec::new();
        if decoder.untracked_records() > 0 {
            let links = "the capture has too many links; frames of the others are skipped";
            remarks.push(Self::Warning(format!("{} {links}", decoder.untracked_records())));
        }
        if let Some(reversal) = decoder.time_reversal() {
            let (link, before, after) = (&reversal.link, reversal.before, reversal.after);
            remarks.push(Self::Warning(format!(
                "{link}: the time goes back from {before} s to {after} s. Times after that are as in the \
                 capture; --times delta reads differences"
            )));
        }
        if decoder.has_requests_only() {
            let requests =
                "only requests are in this log: it does not show whether they were answered";
            remarks.push(Self::Note(requests.to_owned()));
        }
        remarks.extend(Self::of_reading(decoder.statistics()));
        remarks
    }

    /// Parts that were not read: damaged places, and objects of other kinds.
    #[must_use]
    pub fn of_reading(tally: &ReadStatistics) -> Vec<Self> {
        let mut remarks = Vec::new();
        if tally.unsupported.is_some() {
            return remarks;
        }
        if tally.has_delta_times {
            let times = "the times are differences to the line before; --times absolute reads them as they are";
            remarks.push(Self::Note(times.to_owned()));
        }
        remarks.extend(tally.notes.iter().map(|note| Self::Note((*note).to_owned())));
        let skipped = tally.skipped.iter();
        remarks.extend(skipped.map(|(kind, count)| Self::Note(format!("skipped {kind}: {count}"))));
        for damage in tally.damage.iter().take(SHOWN) {
            let what = match damage.position {
                CapturePosition::Line(_) => "the line",
                CapturePosition::Row(_) => "the row",
                CapturePosition::Byte(_) => "this part",
            };
            remarks.push(Self::Warning(format!("{damage}; {what} is left out")));
        }
        if tally.damaged > SHOWN as u64 {
            remarks.push(Self::Warning(format!(
                "{} places could not be read, {} records were",
                tally.damaged, tally.records
            )));
        }
        remarks
    }
}
