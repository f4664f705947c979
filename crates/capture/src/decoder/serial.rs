//! Decodes bytes of serial lines: cuts them into frames, and finds echoes and requests of other hosts.

use polepair_core::error::WireError;
use polepair_core::explain::{Context, ConversationContext, Direction, Dissector, RawFrame};

use super::answer_cache::AnswerKey;
use super::repeat_cache::serial_key;
use super::route::FrameRoute;
use super::{CaptureDecoder, DIRECTIONS, DecodedFrame, FrameCallback, LinkDecoder};
use crate::defect::FrameDefect;
use crate::explanation::Explanation;
use crate::record::Record;
use crate::session::ObservedFrame;
use crate::stream::{ChunkOrigin, PieceKind, StreamPiece};

/// Place of a piece in the capture.
#[derive(Clone, Copy)]
struct PieceContext {
    origin: ChunkOrigin,
    direction: Option<Direction>,
    /// More bytes follow it in the same chunk.
    more_follows: bool,
    /// Nothing but these bytes decided where the piece ends.
    is_alone: bool,
}

impl CaptureDecoder {
    pub(super) fn decode_serial(
        &mut self,
        at: usize,
        record: &Record<'_>,
        bytes: &[u8],
        out: FrameCallback<'_>,
    ) {
        for other in DIRECTIONS {
            let wire = &self.links[at];
            let flow = &wire.flows[direction_index(other)];
            let ended = other != record.direction
                || flow.interrupts(&wire.rules, other, record.time, bytes);
            if ended && !flow.pending().is_empty() {
                self.drain_flow(at, other, true, out);
            }
        }
        let origin = ChunkOrigin { time: record.time, offset: record.offset };
        self.links[at].flows[direction_index(record.direction)].push(origin, bytes);
        // Data alone on a line is complete: nothing more of it follows.
        self.drain_flow(at, record.direction, record.time.is_none(), out);
    }

    /// Gives out what one direction holds.
    pub(super) fn drain_flow(
        &mut self,
        at: usize,
        direction: Option<Direction>,
        ended: bool,
        out: FrameCallback<'_>,
    ) {
        loop {
            let wire = &mut self.links[at];
            let flow = &mut wire.flows[direction_index(direction)];
            let Some(piece) = flow.next_piece(&wire.rules, direction, ended) else { return };
            let origin = flow.origin();
            // Into the memory of the frame before.
            let mut bytes = core::mem::take(&mut self.piece);
            bytes.clear();
            bytes.extend_from_slice(flow.consume(piece.len));
            let glued = !flow.pending().is_empty();
            self.decode_piece(
                at,
                &bytes,
                &piece,
                PieceContext { origin, direction, more_follows: glued, is_alone: !glued && !ended },
                out,
            );
            self.piece = bytes;
        }
    }

    fn decode_piece(
        &mut self,
        at: usize,
        bytes: &[u8],
        piece: &StreamPiece,
        piece_context: PieceContext,
        out: FrameCallback<'_>,
    ) {
        self.frame_count += 1;
        let LinkDecoder { name, rules, serial_repeats, answers, conversation, session, .. } =
            &mut self.links[at];
        let PieceContext { origin: ChunkOrigin { time, offset }, direction, more_follows, .. } =
            piece_context;
        let rule = rules.get(piece.rule);
        let whole = piece.kind == PieceKind::Frame;
        let raw = RawFrame { bytes, ..RawFrame::default() };
        // If the capture does not name the sender, the frame may.
        let direction = direction.or_else(|| {
            let talk = ConversationContext {
                open_request: conversation.open_request(),
                ..ConversationContext::default()
            };
            rule.filter(|_| whole)?.dissector.role(&raw, &talk).direction()
        });
        let reply = direction == Some(Direction::ToHost);
        let echo = rule
            .filter(|_| whole && reply)
            .is_some_and(|rule| conversation.detect_echo(rule.dissector, &raw, more_follows));
        let speaker = if echo { Some(Direction::ToDrive) } else { direction };
        let answered = rule.filter(|_| reply && !echo);
        let request = answered.and_then(|rule| {
            let awaited = session.awaited_request(rule.dissector, &raw, time);
            awaited.or_else(|| conversation.find_request(rule.dissector, &raw))
        });
        let answer_key =
            request.and_then(|request| AnswerKey::new(&request, &raw, piece_context.direction));
        let stated = rule.and_then(|rule| self.profiles.for_frame(rule.dissector, &raw, speaker));
        let profile = stated.or_else(|| polepair_drives::assumed_profile(rule?.dissector));
        let context = Context {
            direction: speaker,
            request: request.map(|request| request.bytes),
            profile,
            profile_assumed: stated.is_none(),
            ..Context::default()
        };
        self.explanation.clear();
        let (mut direction, mut foreign) = (direction, false);
        if let Some(rule) = rule {
            rule.dissector.explain(bytes, &context, &mut self.explanation);
            // A frame that is valid only as a request is one, though it was received: another host
            // sent it.
            let invalid = whole && reply && !echo && self.explanation.error.is_some();
            if invalid && is_valid_request(rule.dissector, bytes) {
                direction = Some(Direction::ToDrive);
                foreign = true;
                self.explanation.clear();
                let context = Context { direction, request: None, ..context };
                rule.dissector.explain(bytes, &context, &mut self.explanation);
            }
        }
        let wrong = rule.and_then(|_| frame_defect(self.explanation.error, piece));
        let asks = rule.is_none_or(|rule| rule.dissector.is_request(&raw));
        if whole && direction == Some(Direction::ToDrive) && asks {
            conversation.push_request(&raw);
        }
        self.notices.clear();
        if let Some(rule) = rule.filter(|_| self.tracks_sessions) {
            let route = FrameRoute {
                dissector: rule.dissector,
                profile,
                profile_stated: stated.is_some(),
                deferred_axis: None,
                template: 0,
            };
            let is_request = piece_context.direction == Some(Direction::ToDrive) && asks;
            if whole && piece_context.is_alone && wrong.is_none() {
                if let Some(key) = serial_key(bytes).filter(|_| is_request) {
                    serial_repeats.record(key, &raw, route, &self.explanation);
                }
                if let Some(key) = answer_key.filter(|_| direction == piece_context.direction)
                    && session.keeps_explanation(rule.dissector, &raw)
                {
                    answers.record(key, &raw, route, &self.explanation);
                }
            }
            let observed = ObservedFrame {
                number: self.frame_count,
                time,
                direction,
                raw,
                remote: false,
                echo,
                defect: wrong,
                stray: piece.kind == PieceKind::Junk,
                deferred: false,
                dissector: rule.dissector,
                profile,
                profile_stated: stated.is_some(),
            };
            session.handle_frame(&observed, &mut self.explanation, &mut self.notices);
        }
        out(&DecodedFrame {
            number: self.frame_count,
            time,
            link: name,
            direction: if foreign { direction } else { piece_context.direction },
            protocol: rule.map(|rule| rule.dissector.name()),
            bytes,
            id: None,
            extended: false,
            remote: false,
            remote_len: 0,
            echo,
            stray: piece.kind == PieceKind::Junk,
            explanation: &self.explanation,
            defect: wrong,
            notices: &self.notices,
            offset,
        });
    }
}

/// Returns whether a frame is valid as a request.
fn is_valid_request(dissector: &dyn Dissector, bytes: &[u8]) -> bool {
    let mut explanation = Explanation::values_only();
    let context = Context { direction: Some(Direction::ToDrive), ..Context::default() };
    dissector.explain(bytes, &context, &mut explanation);
    explanation.error.is_none()
}

const fn direction_index(direction: Option<Direction>) -> usize {
    match direction {
        Some(Direction::ToDrive) => 0,
        Some(Direction::ToHost) => 1,
        None => 2,
    }
}

fn frame_defect(error: Option<WireError>, piece: &StreamPiece) -> Option<FrameDefect> {
    error.map(FrameDefect::Wire).or(match piece.kind {
        PieceKind::Frame => None,
        PieceKind::BadCheck => Some(FrameDefect::BadCheck),
        PieceKind::Junk => Some(FrameDefect::Stray(piece.len)),
    })
}
