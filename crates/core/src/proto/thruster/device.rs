//! The obeying end: frames in, the firmware asked, replies and reports out.
//!
//! What the protocol itself does is here: lengths, echoes and refusals, the forms of VM, the streams
//! of ML, MM and SR. The [`Firmware`] is lent to each call.

use super::readings::{Form, Readings};
use super::wire::{Bare, Command, REFUSED, Reply, Report, Request, Shape, node};
use crate::medium::{CanLine, Frame};
use crate::time::{Instant, earliest};

/// What a drive makes of a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Response {
    /// Done: the reply repeats what was sent.
    Done,
    /// The value asked for, as the four data bytes.
    Value(u32),
    /// Refused (EE EE).
    Refused,
}

/// What reports tell.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Telemetry {
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

/// What obeys: settings that the wire needs, and what the requests do.
pub trait Firmware {
    /// The id that it now listens to.
    fn id(&self) -> u8;
    /// The bit rate that it now uses, bit/s.
    fn bit_rate(&self) -> u32;
    /// What it sends by itself (SR): frames as a mask, and the interval, ms.
    fn reports(&self) -> (u8, u16);
    /// A request of the manual, of a right length, came for it. VM, ML, MM and MQ are the wire's own;
    /// of them, as of all others, this hears in [`heard`](Self::heard).
    fn execute(&mut self, now: Instant, request: &Request) -> Response;
    /// A valid request came, whatever it is: time without one is counted from here (ST).
    fn heard(&mut self, now: Instant, request: &Request);
    /// What it would report now.
    fn telemetry(&self) -> Telemetry;
}

/// What differs between drives, or is not stated.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Quirks {
    /// How VM's flags and the third report lie.
    pub readings: Readings,
    /// Replies to TC and VC that are refused have a zero value, as a public driver's comment says.
    pub refuses_by_zero: bool,
    /// Signed values go out in 32 bits, not in 16 behind two zero bytes.
    pub wide: bool,
    /// The reply to VM has its two last bytes swapped, as the manual prints it once.
    pub swaps_vm: bool,
}

/// Frames that wait for the bus at most; a request beyond them is not heard.
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
pub struct CanEnd {
    quirks: Quirks,
    form: Form,
    /// ML and MM: every so many ms, from then on.
    stream: Option<(u32, Instant)>,
    /// SR: when the next reports are due.
    report_at: Option<Instant>,
    /// MQ came: SR pauses until the next start. \[I\]
    paused: bool,
    out: [Frame; OUT_MAX],
    len: usize,
    bit_rate: u32,
}

impl CanEnd {
    /// The end of a drive that was just powered.
    #[must_use]
    pub fn new(quirks: Quirks, firmware: &impl Firmware) -> Self {
        let mut new = Self {
            quirks,
            form: Form::Echo,
            stream: None,
            report_at: None,
            paused: false,
            out: [Frame::default(); OUT_MAX],
            len: 0,
            bit_rate: firmware.bit_rate(),
        };
        new.restart(Instant::ZERO, firmware);
        new
    }

    /// The drive was powered anew: VM is forgotten \[I\], ML and MM too, SR goes on.
    pub fn restart(&mut self, now: Instant, firmware: &impl Firmware) {
        (self.form, self.stream, self.paused, self.len) = (Form::Echo, None, false, 0);
        self.bit_rate = firmware.bit_rate();
        self.report_at = next_report(now, firmware);
    }

    /// Takes a frame from the bus.
    pub fn handle_input(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let mine = node(frame.id) == Some(Ok(firmware.id()));
        if !mine || frame.extended || frame.remote || self.len + BURST_MAX > OUT_MAX {
            return;
        }
        let Ok(request) = Request::parse(frame.bytes()) else { return };
        firmware.heard(now, &request);
        let response = self.obey(now, &request, firmware);
        let data = match response {
            Response::Done => request.data.unwrap_or(0),
            Response::Value(data) => self.widened(request.command, data),
            Response::Refused => REFUSED,
        };
        if request.command.is_output() && self.form != Form::Echo && request.data.is_some() {
            return self.report_output(&request, response, firmware);
        }
        let data = match request.command {
            Command::VM if self.quirks.swaps_vm && data != REFUSED => {
                u32::from((data as u16).swap_bytes())
            }
            Command::TC | Command::VC if data == REFUSED && self.quirks.refuses_by_zero => 0,
            _ => data,
        };
        let Request { command, sub, .. } = request;
        self.send(Reply { command, sub, data }.frame(firmware.id()));
    }

    /// What is due by time.
    pub fn handle_timeout(&mut self, now: Instant, firmware: &impl Firmware) {
        if let Some((ms, at)) = self.stream
            && now >= at
        {
            self.stream = Some((ms, at.plus_ms(ms).max(now)));
            self.stream_values(firmware);
        }
        if self.report_at.is_some_and(|at| now >= at) {
            self.report_at = next_report(now, firmware);
            self.reports(Report::BY_ITSELF, firmware.reports().0, firmware);
        }
    }

    /// When something is due.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.stream.map(|(_, at)| at), self.report_at)
    }

    /// The next frame to send.
    pub fn poll_transmit(&mut self) -> Option<Frame> {
        let first = *self.out[..self.len].first()?;
        self.out.rotate_left(1);
        self.len -= 1;
        Some(first)
    }

    /// How this end now drives the bus.
    #[must_use]
    pub const fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }

    /// Lengths first: a command that sets something needs its value, one without may be padded.
    fn obey(&mut self, now: Instant, request: &Request, firmware: &mut impl Firmware) -> Response {
        let known = request.command.known();
        match (request.command, known) {
            (_, None) => Response::Refused,
            (_, Some((Shape::Set, _))) if request.data.is_none() => Response::Refused,
            (Command::VM, _) => {
                let value = request.data.unwrap_or(0);
                if value > 0xFFFF {
                    return Response::Refused;
                }
                self.form = self.quirks.readings.form(value as u16);
                Response::Done
            }
            (Command::ML, _) => self.start(now, LOW_MS),
            (Command::MM, _) => self.start(now, MEDIUM_MS),
            (Command::MQ, _) => {
                (self.stream, self.report_at, self.paused) = (None, None, true);
                Response::Done
            }
            (Command::SR, _) => {
                let response = firmware.execute(now, request);
                if !self.paused {
                    self.report_at = next_report(now, firmware);
                }
                response
            }
            _ => firmware.execute(now, request),
        }
    }

    fn start(&mut self, now: Instant, ms: u32) -> Response {
        self.stream = Some((ms, now.plus_ms(ms)));
        Response::Done
    }

    /// TC and VC as VM wants them answered. \[I\] A refusal is one in every form but the silent.
    fn report_output(&mut self, request: &Request, response: Response, firmware: &impl Firmware) {
        let Request { command, sub, .. } = *request;
        let [letter, _] = command.0.to_be_bytes();
        match self.form {
            Form::Silent => {}
            _ if response == Response::Refused => {
                self.send(Reply { command, sub, data: REFUSED }.frame(firmware.id()));
            }
            Form::Headerless => self.send(bare(&firmware.telemetry()).frame(firmware.id())),
            Form::Frames(mask) => self.reports(letter, mask, firmware),
            Form::Echo => {}
        }
    }

    fn reports(&mut self, of: u8, mask: u8, firmware: &impl Firmware) {
        let told = firmware.telemetry();
        for part in (1..=3).filter(|part| mask >> (part - 1) & 1 == 1) {
            let words = words(part, &told, self.quirks.readings);
            self.send(Report { of, part, words }.frame(firmware.id()));
        }
    }

    /// ML and MM. \[I\] Two frames, in the form of the replies to QC and QV.
    fn stream_values(&mut self, firmware: &impl Firmware) {
        let told = firmware.telemetry();
        for (command, value) in [(Command::QC, told.deciamp), (Command::QV, told.rpm)] {
            let data = self.widened(command, command.width().write(value.into()));
            self.send(Reply { command, sub: 0, data }.frame(firmware.id()));
        }
    }

    fn widened(&self, command: Command, data: u32) -> u32 {
        match self.quirks.wide {
            true => command.width().read(data) as u32,
            false => data,
        }
    }

    fn send(&mut self, frame: Frame) {
        if let Some(slot) = self.out.get_mut(self.len) {
            *slot = frame;
            self.len += 1;
        }
    }
}

fn bare(told: &Telemetry) -> Bare {
    let Telemetry { rpm, decivolt, deciamp, faults, .. } = *told;
    Bare { rpm, decivolt, deciamp, status: faults }
}

fn words(part: u8, told: &Telemetry, readings: Readings) -> [u16; 3] {
    let word = i16::cast_unsigned;
    match part {
        1 => [word(told.rpm), told.decivolt, word(told.deciamp)],
        2 => [told.faults, word(told.motor_c), word(told.driver_c)],
        _ => readings.position_words(told.absolute, told.relative),
    }
}

fn next_report(now: Instant, firmware: &impl Firmware) -> Option<Instant> {
    let (mask, ms) = firmware.reports();
    (mask & 7 != 0 && ms > 0).then(|| now.plus_ms(ms.max(INTERVAL_MIN_MS).into()))
}
