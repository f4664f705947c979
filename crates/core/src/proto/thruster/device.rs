//! The device end: receives frames, calls the firmware, sends replies and reports.
//!
//! This module implements the protocol: lengths, echoes, refusals, the forms of VM, the reports of ML, MM and SR. The
//! [`Firmware`] is passed to each call.

use super::interpretation::{Interpretation, ReplyFormat};
use super::wire::{
    CommandKind, CommandWord, HeaderlessReport, REFUSED, Reply, ReportFrame, Request, node_of_id,
};
use crate::medium::{CanLine, Frame};
use crate::time::{Instant, earliest};

/// Reply of a drive.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Response {
    /// Done: the reply repeats the request.
    Done,
    /// The requested value, as the four data bytes.
    Value(u32),
    /// Refused (EE EE).
    Refused,
}

/// Values of reports.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct TelemetryValues {
    /// Speed, rpm.
    pub rpm: i16,
    /// Supply, 0.1 V.
    pub decivolt: u16,
    /// Current, 0.1 A.
    pub deciamp: i16,
    /// Fault word.
    pub faults: u16,
    /// Motor, °C.
    pub motor_c: i16,
    /// Driver, °C.
    pub driver_c: i16,
    /// Absolute position, 0.1°.
    pub absolute: i32,
    /// Relative position, 0.1°.
    pub relative: i32,
}

/// The firmware of a simulated drive: settings of the wire, and the execution of requests.
pub trait Firmware {
    /// The id that it now listens to.
    fn id(&self) -> u8;
    /// The bit rate that it now uses, bit/s.
    fn bit_rate(&self) -> u32;
    /// Reports that it sends by itself (SR): frames as a mask, and the interval, ms.
    fn report_settings(&self) -> (u8, u16);
    /// Executes a request of the manual with a valid length. VM, ML, MM and MQ are handled by the wire; of
    /// them, as of all others, [`note_request`](Self::note_request) is called.
    fn execute(&mut self, now: Instant, request: &Request) -> Response;
    /// Notes a valid request: the time without one restarts (ST).
    fn note_request(&mut self, now: Instant, request: &Request);
    /// Present values of reports.
    fn telemetry(&self) -> TelemetryValues;
}

/// Differences between drives, and values that the manual does not state.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Quirks {
    /// Layout of VM's flags and of the third report.
    pub interpretation: Interpretation,
    /// Refusals of TC and VC have a zero value, by a comment in a public driver.
    pub refuses_by_zero: bool,
    /// Signed values go out in 32 bits, not in 16 behind two zero bytes.
    pub wide_values: bool,
    /// The reply to VM has its two last bytes swapped, as the manual prints it once.
    pub swaps_vm: bool,
}

/// Most frames in the queue; a request beyond them is lost.
pub const OUT_MAX: usize = 8;
/// Intervals of ML and MM, ms (section 2.1).
const LOW_MS: u32 = 1000;
const MEDIUM_MS: u32 = 100;
/// The shortest interval of SR, ms. \[I\]
const INTERVAL_MIN_MS: u16 = 10;
/// Frames that one request or one turn of a stream makes at most.
const BURST_MAX: usize = 3;

/// The CAN end of a drive.
#[derive(Debug)]
pub struct CanEndpoint {
    quirks: Quirks,
    reply_format: ReplyFormat,
    /// ML and MM: interval in ms, and time of the next.
    value_stream: Option<(u32, Instant)>,
    /// SR: when the next reports are due.
    report_at: Option<Instant>,
    out: [Frame; OUT_MAX],
    out_len: usize,
    bit_rate: u32,
}

impl CanEndpoint {
    /// The end of a drive that was just powered.
    #[must_use]
    pub fn new(quirks: Quirks, firmware: &impl Firmware) -> Self {
        let mut new = Self {
            quirks,
            reply_format: ReplyFormat::Echo,
            value_stream: None,
            report_at: None,
            out: [Frame::default(); OUT_MAX],
            out_len: 0,
            bit_rate: firmware.bit_rate(),
        };
        new.restart(Instant::ZERO, firmware);
        new
    }

    /// The drive was powered anew: VM is forgotten \[I\], ML and MM too, SR goes on.
    pub fn restart(&mut self, now: Instant, firmware: &impl Firmware) {
        (self.reply_format, self.value_stream, self.out_len) = (ReplyFormat::Echo, None, 0);
        self.bit_rate = firmware.bit_rate();
        self.report_at = next_report_at(now, firmware);
    }

    /// Takes a frame from the bus.
    pub fn handle_input(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let mine = node_of_id(frame.id) == Some(Ok(firmware.id()));
        if !mine || frame.extended || frame.remote || self.out_len + BURST_MAX > OUT_MAX {
            return;
        }
        let Ok(request) = Request::parse(frame.bytes()) else { return };
        firmware.note_request(now, &request);
        let response = self.execute_request(now, &request, firmware);
        let data = match response {
            Response::Done => request.value(),
            Response::Value(data) => self.widen_data(request.command, data),
            Response::Refused => REFUSED,
        };
        if request.command.is_output()
            && self.reply_format != ReplyFormat::Echo
            && request.data.is_some()
        {
            return self.send_output_reply(&request, response, firmware);
        }
        let data = match request.command {
            CommandWord::VM if self.quirks.swaps_vm && data != REFUSED => {
                u32::from((data as u16).swap_bytes())
            }
            CommandWord::TC | CommandWord::VC if data == REFUSED && self.quirks.refuses_by_zero => {
                0
            }
            _ => data,
        };
        let Request { command, sub, .. } = request;
        self.queue_frame(Reply { command, sub, data }.frame(firmware.id()));
    }

    /// Handles timers that are due.
    pub fn handle_timeout(&mut self, now: Instant, firmware: &impl Firmware) {
        if let Some((ms, at)) = self.value_stream
            && now >= at
        {
            self.value_stream = Some((ms, at.plus_ms(ms).max(now)));
            self.send_stream_values(firmware);
        }
        if self.report_at.is_some_and(|at| now >= at) {
            self.report_at = next_report_at(now, firmware);
            self.send_reports(ReportFrame::UNSOLICITED, firmware.report_settings().0, firmware);
        }
    }

    /// Time of the next action.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.value_stream.map(|(_, at)| at), self.report_at)
    }

    /// The next frame to send.
    pub fn poll_transmit(&mut self) -> Option<Frame> {
        let first = *self.out[..self.out_len].first()?;
        self.out.rotate_left(1);
        self.out_len -= 1;
        Some(first)
    }

    /// Present bus settings of this end.
    #[must_use]
    pub const fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }

    /// Lengths first: a command that sets something needs its value, one without may be padded.
    fn execute_request(
        &mut self,
        now: Instant,
        request: &Request,
        firmware: &mut impl Firmware,
    ) -> Response {
        let known = request.command.definition();
        match (request.command, known) {
            (_, None) => Response::Refused,
            (_, Some((CommandKind::Set, _))) if request.data.is_none() => Response::Refused,
            (CommandWord::VM, _) => {
                let value = request.value();
                if value > 0xFFFF {
                    return Response::Refused;
                }
                self.reply_format = self.quirks.interpretation.reply_format(value as u16);
                Response::Done
            }
            (CommandWord::ML, _) => self.start_stream(now, LOW_MS),
            (CommandWord::MM, _) => self.start_stream(now, MEDIUM_MS),
            // SR pauses until it is set again (section 2.5: at once), or the next start. \[I\]
            (CommandWord::MQ, _) => {
                (self.value_stream, self.report_at) = (None, None);
                Response::Done
            }
            (CommandWord::SR, _) => {
                let response = firmware.execute(now, request);
                if response == Response::Done {
                    self.report_at = next_report_at(now, firmware);
                }
                response
            }
            _ => firmware.execute(now, request),
        }
    }

    fn start_stream(&mut self, now: Instant, ms: u32) -> Response {
        self.value_stream = Some((ms, now.plus_ms(ms)));
        Response::Done
    }

    /// TC and VC as VM wants them answered. \[I\] A refusal is one in every form but the silent.
    fn send_output_reply(
        &mut self,
        request: &Request,
        response: Response,
        firmware: &impl Firmware,
    ) {
        let Request { command, sub, .. } = *request;
        let [letter, _] = command.0.to_be_bytes();
        match self.reply_format {
            ReplyFormat::Silent => {}
            _ if response == Response::Refused => {
                self.queue_frame(Reply { command, sub, data: REFUSED }.frame(firmware.id()));
            }
            ReplyFormat::Headerless => {
                self.queue_frame(headerless_report(&firmware.telemetry()).frame(firmware.id()))
            }
            ReplyFormat::Frames(mask) => self.send_reports(letter, mask, firmware),
            ReplyFormat::Echo => {}
        }
    }

    fn send_reports(&mut self, of: u8, mask: u8, firmware: &impl Firmware) {
        let values = firmware.telemetry();
        for part in (1..=3).filter(|part| mask >> (part - 1) & 1 == 1) {
            let words = report_words(part, &values, self.quirks.interpretation);
            self.queue_frame(ReportFrame { source: of, part, words }.frame(firmware.id()));
        }
    }

    /// ML and MM. \[I\] Two frames, in the form of the replies to QC and QV.
    fn send_stream_values(&mut self, firmware: &impl Firmware) {
        let values = firmware.telemetry();
        for (command, value) in [(CommandWord::QC, values.deciamp), (CommandWord::QV, values.rpm)] {
            let data = self.widen_data(command, command.width().encode(value.into()));
            self.queue_frame(Reply { command, sub: 0, data }.frame(firmware.id()));
        }
    }

    fn widen_data(&self, command: CommandWord, data: u32) -> u32 {
        if self.quirks.wide_values { command.width().decode(data) as u32 } else { data }
    }

    fn queue_frame(&mut self, frame: Frame) {
        if let Some(slot) = self.out.get_mut(self.out_len) {
            *slot = frame;
            self.out_len += 1;
        }
    }
}

fn headerless_report(values: &TelemetryValues) -> HeaderlessReport {
    let TelemetryValues { rpm, decivolt, deciamp, faults, .. } = *values;
    HeaderlessReport { rpm, decivolt, deciamp, status: faults }
}

fn report_words(part: u8, values: &TelemetryValues, readings: Interpretation) -> [u16; 3] {
    let word = i16::cast_unsigned;
    match part {
        1 => [word(values.rpm), values.decivolt, word(values.deciamp)],
        2 => [values.faults, word(values.motor_c), word(values.driver_c)],
        _ => readings.position_words(values.absolute, values.relative),
    }
}

fn next_report_at(now: Instant, firmware: &impl Firmware) -> Option<Instant> {
    let (mask, ms) = firmware.report_settings();
    (mask & 7 != 0 && ms > 0).then(|| now.plus_ms(ms.max(INTERVAL_MIN_MS).into()))
}
