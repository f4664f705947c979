//! Counts the effects of a capture before anything is sent, and prints them.

use std::collections::BTreeMap;

use polepair_capture::DecodedFrame;
use polepair_core::explain::Impact;

use super::selector::{ReplayFrame, ReplayRoute, SkipReason, effect_word};
use crate::outcome;
use crate::problem::{Problem, Result};
use crate::terminal::{print_note, print_warning};
use crate::value::plural;

/// Frames to send, and skipped ones.
#[derive(Debug, Default)]
pub struct Survey {
    /// Frames by their possible effect.
    counts: BTreeMap<&'static str, u64>,
    pub frames: u64,
    /// The time of the last one since the first, ns.
    pub span: u64,
    skipped: [u64; 6],
    /// The first frame that needs leave to move, and how many do; the same of permanent memory.
    first_moving: Option<(String, u64)>,
    first_keeping: Option<(String, u64)>,
    /// Links of the capture.
    pub links: Vec<String>,
}

impl Survey {
    /// Takes note of a frame and what becomes of it.
    pub fn add_frame(
        &mut self,
        event: &DecodedFrame<'_>,
        chosen: &std::result::Result<ReplayFrame, SkipReason>,
    ) {
        if self.links.iter().all(|link| link != event.link) {
            self.links.push(event.link.to_owned());
        }
        let item = match chosen {
            Ok(item) => item,
            Err(left) => {
                self.skipped[*left as usize] += 1;
                return;
            }
        };
        self.frames += 1;
        self.span = item.at;
        *self.counts.entry(effect_word(item.effect)).or_default() += 1;
        if item.effect.impact >= Impact::Motion {
            self.first_moving.get_or_insert_with(|| (first_frame_text(event), 0)).1 += 1;
        }
        if item.effect.persistent {
            self.first_keeping.get_or_insert_with(|| (first_frame_text(event), 0)).1 += 1;
        }
    }

    fn skipped_count(&self, left: SkipReason) -> u64 {
        self.skipped[left as usize]
    }

    /// Frames that no wire of the kind can carry.
    pub fn unfit_count(&self) -> u64 {
        self.skipped_count(SkipReason::UnfitForWire)
    }

    /// Prints the frames that will be sent.
    pub fn print_summary(&self, file: &str, wires: &[String]) {
        let parts = self
            .count_line("asks", "ask or stop")
            .chain(self.count_line("sets", "set"))
            .chain(self.count_line("moves", "may move motors"))
            .chain(self.count_line("keeps", "reach permanent memory"))
            .chain(self.count_line("?", "are unknown"));
        let (frames, seconds) = (plural(self.frames, "frame"), self.span as f64 / 1e9);
        let parts = parts.collect::<Vec<_>>().join(", ");
        if self.frames > 0 {
            print_note(&format!(
                "{file}: {frames} of {seconds:.1} s for {}: {parts}",
                wires.join(", ")
            ));
        }
        self.warn_skipped(
            SkipReason::UnknownSender,
            "their sender is unknown; --direction both sends them too",
        );
        self.warn_skipped(SkipReason::UnfitForWire, "this link has no such frames");
    }

    fn warn_skipped(&self, left: SkipReason, what: &str) {
        if self.skipped_count(left) > 0 {
            print_warning(&format!(
                "{} skipped: {what}",
                plural(self.skipped_count(left), "frame")
            ));
        }
    }

    fn count_line(&self, word: &str, what: &str) -> std::option::IntoIter<String> {
        self.counts.get(word).map(|count| format!("{count} {what}")).into_iter()
    }

    /// Prints the frames that are not sent, for a dry run.
    pub fn print_left_out(&self) {
        for (reason, what) in [
            (SkipReason::OtherDirection, "from drives, or echoes"),
            (SkipReason::Filtered, "excluded by --filter"),
            (SkipReason::UnroutedLink, "on other links of the capture"),
            (SkipReason::ErrorReport, "error frames"),
        ] {
            let count = self.skipped_count(reason);
            if count > 0 {
                print_note(&format!("{} not sent: {what}", plural(count, "frame")));
            }
        }
    }

    /// Refuses frames that need an option which is not given.
    pub fn check_allowed(&self, routes: &[ReplayRoute], arm: bool, store: bool) -> Result<()> {
        if self.frames == 0 {
            return Err(self.nothing_problem(routes));
        }
        if let Some((first, count)) = self.first_moving.as_ref().filter(|_| !arm) {
            let what = format!("{} may move motors.", plural(*count, "frame"));
            return Err(Problem::usage("E219", what)
                .why(format!("{first}\n{}", outcome::sent_so_far()))
                .hint("--dry-run prints all of them; --filter excludes some")
                .hint("--arm sends them: keep clear of the motors"));
        }
        if let Some((first, count)) = self.first_keeping.as_ref().filter(|_| !store) {
            let what = format!("permanent memory would be written: {}.", plural(*count, "frame"));
            return Err(Problem::usage("E251", what)
                .why(format!("{first}\nFlash wears. {}", outcome::sent_so_far()))
                .hint("--dry-run prints all of them; --filter excludes some")
                .hint("--store sends them"));
        }
        Ok(())
    }

    /// Describes why nothing is left to send.
    fn nothing_problem(&self, routes: &[ReplayRoute]) -> Problem {
        let links = self.links.join(", ");
        let problem = Problem::usage("E242", "the capture has no frame to send.");
        let named = routes.iter().filter_map(|route| route.link.as_deref());
        if let Some(name) = named.clone().find(|name| self.links.iter().all(|link| link != name)) {
            return problem.why(format!("It has no link {name}; it has {links}."));
        }
        let most = [
            SkipReason::Filtered,
            SkipReason::UnknownSender,
            SkipReason::OtherDirection,
            SkipReason::UnfitForWire,
        ];
        match most.into_iter().find(|left| self.skipped_count(*left) > 0) {
            Some(SkipReason::Filtered) => problem.why("The filter excludes all of them."),
            Some(SkipReason::UnknownSender) => problem
                .why("Their sender is unknown.")
                .hint("--as PROTO states the protocol; --direction both sends all of them"),
            Some(SkipReason::OtherDirection) => {
                problem.why("All of them were sent by the other side.").hint(
                    "--direction tx sends the host's frames, rx the drives' frames, both all \
                 frames",
                )
            }
            Some(_) => problem.why("This link has no such frames: a CAN bus is not a serial line."),
            None => problem.why(format!("Its links are: {links}.")),
        }
    }
}

fn first_frame_text(event: &DecodedFrame<'_>) -> String {
    let link = event.link;
    format!("The first is frame {} on {link}: {}", event.number, event.explanation.text)
}
