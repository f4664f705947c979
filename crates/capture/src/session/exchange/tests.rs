//! Planted faults and clean conversations of each protocol, frame by frame.

use core::fmt::Write as _;

use polepair_core::explain::{Dissector as _, EncodeOptions};
use polepair_core::medium::Frame;
use polepair_core::proto::modbus::rtu;
use polepair_core::proto::modbus::wire::{ReplyPdu, RequestPdu, Space};
use polepair_core::proto::thruster::wire::{CommandWord, Reply as Echo, Request as Order};
use polepair_core::proto::tmcl::opcode::{Opcode, Status};
use polepair_core::proto::tmcl::wire::{Reply, Request};
use polepair_core::proto::tml::explain::{SERIAL, TMLCAN};
use polepair_core::proto::tml::online::{Cell, OnlineMessage};
use polepair_core::proto::tml::serial;
use polepair_core::proto::tml::wire::{IdCode, Message};

use crate::session::{ExchangeOutcome, SessionNotice};
use crate::{CaptureDecoder, Rules};

mod turns;

/// A capture that is written line by line.
#[derive(Default)]
struct SerialLog {
    text: String,
    micros: u64,
}

impl SerialLog {
    fn after(&mut self, ms: u64) -> &mut Self {
        self.micros += ms * 1000;
        self
    }

    fn line(&mut self, direction: char, bytes: &[u8]) -> &mut Self {
        self.micros += 2000;
        let (s, us) = (self.micros / 1_000_000, self.micros % 1_000_000);
        let _ = write!(self.text, "({s}.{us:06}) tty {direction}");
        for byte in bytes {
            let _ = write!(self.text, " {byte:02X}");
        }
        self.text.push('\n');
        self
    }

    fn request(&mut self, bytes: &[u8]) -> &mut Self {
        self.line('>', bytes)
    }

    fn reply(&mut self, bytes: &[u8]) -> &mut Self {
        self.line('<', bytes)
    }

    fn can(&mut self, frame: &Frame) -> &mut Self {
        self.micros += 2000;
        let (s, us) = (self.micros / 1_000_000, self.micros % 1_000_000);
        let digits = if frame.extended { 8 } else { 3 };
        let _ = write!(self.text, "({s}.{us:06}) can0 {:0digits$X}#", frame.id);
        for byte in frame.bytes() {
            let _ = write!(self.text, "{byte:02X}");
        }
        self.text.push('\n');
        self
    }

    /// Passes the notices of the conversations on.
    fn decode(&self, protocol: &str, mut take: impl FnMut(&[SessionNotice])) {
        let mut decoder = CaptureDecoder::new(Rules::parse(protocol).expect("a protocol"));
        decoder.feed(self.text.as_bytes(), &mut |event| take(event.notices));
        decoder.finish(&mut |event| take(event.notices));
        decoder.finish_sessions(&mut |event| take(event.notices));
    }

    /// Report of the conversations.
    fn report(&self, protocol: &str) -> ConversationReport {
        let mut received = ConversationReport::default();
        self.decode(protocol, |notices| received.add(notices));
        received
    }
}

/// Lets a tape be, that was written on.
fn discard(_: &mut SerialLog) {}

/// Reported notices, as words.
#[derive(Default, Debug)]
struct ConversationReport {
    anomalies: Vec<String>,
    outcomes: Vec<ExchangeOutcome>,
    retries: u16,
    signals: Vec<String>,
    faults: Vec<String>,
    changes: Vec<String>,
}

impl ConversationReport {
    fn add(&mut self, notices: &[SessionNotice]) {
        for notice in notices {
            match notice {
                SessionNotice::Anomaly(anomaly) => {
                    self.anomalies.push(anomaly.kind.as_str().to_owned())
                }
                SessionNotice::Exchange(exchange) => {
                    self.outcomes.push(exchange.outcome);
                    self.retries += exchange.retries;
                }
                SessionNotice::Signal(signal) => self.signals.push(
                    format!("{} {} = {} {}", signal.axis, signal.name, signal.value, signal.unit)
                        .trim_end()
                        .to_owned(),
                ),
                SessionNotice::Fault(fault) => {
                    let sign = if fault.gone { '-' } else { '+' };
                    assert!(!fault.text.is_empty());
                    self.faults.push(format!("{sign}{:04X}", fault.code));
                }
                SessionNotice::Change(change) => {
                    self.changes.push(format!("{} {}>{}", change.what, change.from, change.to));
                }
            }
        }
    }
}

fn gap(address: u8, kind: u8) -> Vec<u8> {
    Request { address, opcode: Opcode::Gap, kind, motor: 0, value: 0 }.emit().to_vec()
}

fn reply(module: u8, opcode: Opcode, status: Status, value: i32) -> Vec<u8> {
    Reply { host: 2, module, status, opcode, value }.emit().to_vec()
}

fn position(module: u8, value: i32) -> Vec<u8> {
    reply(module, Opcode::Gap, Status::Ok, value)
}

/// A host that reads positions of axes 1 and 2 this many times.
fn polls(tape: &mut SerialLog, rounds: i32) {
    for n in 0..rounds {
        for axis in [1, 2] {
            tape.after(10).request(&gap(axis, 1)).reply(&position(axis, 100 * n));
        }
    }
}

#[test]
fn a_clean_conversation_has_no_anomaly() {
    let mut tape = SerialLog::default();
    polls(&mut tape, 20);
    let report = tape.report("tmcl");
    assert_eq!(report.anomalies, [""; 0]);
    assert_eq!(report.outcomes, [ExchangeOutcome::Done; 40]);
    assert_eq!(report.signals.len(), 40);
    assert_eq!(report.signals[3], "2 Actual/Position = 8.7890625 deg");
}

#[test]
fn a_capture_that_was_cut_off_reports_no_anomaly() {
    let mut tape = SerialLog::default();
    tape.reply(&position(7, 1)[4..]).reply(&position(9, 1));
    polls(&mut tape, 3);
    tape.request(&gap(1, 1)).reply(&position(1, 5)[..3]);
    assert_eq!(tape.report("tmcl").anomalies, [""; 0]);
}

#[test]
fn planted_in_tmcl() {
    let planted = |plant: &dyn Fn(&mut SerialLog)| {
        let mut tape = SerialLog::default();
        polls(&mut tape, 8);
        plant(&mut tape);
        polls(&mut tape, 8);
        tape.report("tmcl").anomalies
    };
    let request = gap(1, 1);
    assert_eq!(
        planted(&|t| discard(
            t.request(&request).after(900).request(&gap(1, 3)).reply(&position(1, 0))
        )),
        ["unanswered"]
    );
    assert_eq!(
        planted(&|t| discard(
            t.request(&request).after(900).request(&request).reply(&position(1, 0))
        )),
        ["retry"]
    );
    assert_eq!(
        planted(&|t| discard(t.request(&request).after(400).reply(&position(1, 0)))),
        ["late-reply"]
    );
    let again = |t: &mut SerialLog| {
        t.request(&request)
            .after(400)
            .request(&request)
            .reply(&position(1, 0))
            .reply(&position(1, 1));
    };
    assert_eq!(planted(&again), ["retry", "late-reply"]);
    assert_eq!(planted(&|t| discard(t.reply(&position(5, 0)))), ["foreign-reply"]);
    let twice = |t: &mut SerialLog| {
        discard(t.request(&request).reply(&position(1, 9)).reply(&position(1, 9)))
    };
    assert_eq!(planted(&twice), ["duplicate-reply"]);
    let twins = |t: &mut SerialLog| {
        discard(t.request(&request).reply(&position(1, 9)).reply(&position(1, 7)))
    };
    assert_eq!(planted(&twins), ["duplicate-address"]);
    let refused = reply(1, Opcode::Gap, Status::WrongType, 0);
    assert_eq!(planted(&|t| discard(t.request(&request).reply(&refused))), ["refused"]);
    let mut broken = position(1, 0);
    broken[5] ^= 4;
    assert_eq!(planted(&|t| discard(t.request(&request).reply(&broken))), ["bad-check"]);
    assert_eq!(planted(&|t| discard(t.reply(&[0x55, 0x13]))), ["stray"]);
}

#[test]
fn an_axis_that_spoke_and_answers_no_more_is_silent() {
    let mut tape = SerialLog::default();
    polls(&mut tape, 8);
    for _ in 0..12 {
        tape.after(200).request(&gap(1, 1)).after(200).request(&gap(2, 1)).reply(&position(2, 1));
    }
    let anomalies = tape.report("tmcl").anomalies;
    assert_eq!(anomalies.iter().filter(|kind| *kind == "silent").count(), 1, "{anomalies:?}");
    assert!(anomalies.iter().any(|kind| kind == "unanswered"), "{anomalies:?}");
}

#[test]
fn set_points_flags_and_faults_of_tmcl() {
    let mut tape = SerialLog::default();
    let ror = Request { address: 1, opcode: Opcode::Ror, kind: 0, motor: 0, value: 350 };
    tape.request(&ror.emit()).reply(&reply(1, Opcode::Ror, Status::Ok, 350));
    for flags in [0x00, 0x21, 0x20, 0x50] {
        tape.request(&gap(1, 156)).reply(&reply(1, Opcode::Gap, Status::Ok, flags));
    }
    let report = tape.report("tmcl");
    assert_eq!(report.signals[0], "1 Setpoint/Velocity = 350 rpm");
    assert_eq!(report.faults, ["+0001", "+0020", "-0001", "-0020"]);
    assert_eq!(
        report.changes,
        ["power >on", "mode >velocity", "power on>off", "mode velocity>positioning"]
    );
    assert_eq!(report.anomalies, [""; 0]);
}

#[test]
fn planted_in_tmcl_on_can() {
    let request = |address: u8| {
        Request { address, opcode: Opcode::Gap, kind: 1, motor: 0, value: 0 }
            .emit_can(address.into(), false)
    };
    let answer = |module: u8, value: i32| {
        let (opcode, status) = (Opcode::Gap, Status::Ok);
        Reply { host: 2, module, status, opcode, value }.emit_can(2, false)
    };
    let polls = |tape: &mut SerialLog| {
        // Both are asked before either answers.
        for n in 0..8 {
            tape.after(10).can(&request(1)).can(&request(3)).can(&answer(3, n)).can(&answer(1, n));
        }
    };
    let planted = |plant: &dyn Fn(&mut SerialLog)| {
        let mut tape = SerialLog::default();
        polls(&mut tape);
        plant(&mut tape);
        tape.after(4000);
        polls(&mut tape);
        tape.report("tmcl").anomalies
    };
    assert_eq!(planted(&|_| ()), [""; 0]);
    assert_eq!(planted(&|t| discard(t.can(&request(3)))), ["unanswered"]);
    assert_eq!(planted(&|t| discard(t.can(&answer(5, 0)))), ["foreign-reply"]);
    let twins =
        |t: &mut SerialLog| discard(t.can(&request(1)).can(&answer(1, 1)).can(&answer(1, 8)));
    assert_eq!(planted(&twins), ["duplicate-address"]);
}

/// Both variables are asked for in turn: an answer that is lost is missed once, and those behind it
/// belong to their own requests.
#[test]
fn a_lost_answer_on_can_does_not_shift_the_others() {
    let (address, opcode, motor, value) = (1, Opcode::Gap, 0, 0);
    let mut tape = SerialLog::default();
    for n in 0..40 {
        let request = Request { address, opcode, kind: 1 + n % 2 * 2, motor, value };
        let reply = Reply { host: 2, module: 1, status: Status::Ok, opcode, value: n.into() };
        tape.after(100).can(&request.emit_can(1, false));
        if n != 21 {
            tape.can(&reply.emit_can(2, false));
        }
    }
    let report = tape.report("tmcl");
    assert_eq!(report.anomalies, ["unanswered"]);
    let done = report.outcomes.iter().filter(|ended| **ended == ExchangeOutcome::Done).count();
    assert_eq!((done, report.outcomes.len()), (39, 40), "{:?}", report.outcomes);
}

#[test]
fn an_answer_that_is_cut_is_reported_once() {
    let mut tape = SerialLog::default();
    polls(&mut tape, 4);
    tape.after(200).request(&gap(1, 1)).reply(&position(1, 7)[..4]);
    tape.after(200);
    polls(&mut tape, 4);
    let report = tape.report("tmcl");
    assert_eq!(report.anomalies, ["malformed"]);
    assert_eq!(
        report.outcomes.iter().filter(|ended| **ended == ExchangeOutcome::BadCheck).count(),
        1
    );
    // Noise before a good answer spoils nothing.
    let mut tape = SerialLog::default();
    polls(&mut tape, 4);
    tape.after(200).request(&gap(1, 1)).reply(&[0xFF]).after(30).reply(&position(1, 7));
    tape.after(200);
    polls(&mut tape, 4);
    let report = tape.report("tmcl");
    assert_eq!(
        (report.anomalies.len(), report.anomalies[0].as_str()),
        (1, "stray"),
        "{:?}",
        report.anomalies
    );
    assert!(
        report.outcomes.iter().all(|ended| *ended == ExchangeOutcome::Done),
        "{:?}",
        report.outcomes
    );
}

fn modbus(unit: u8, pdu: impl FnOnce(&mut [u8]) -> usize) -> Vec<u8> {
    let mut out = [0; rtu::ADU_MAX];
    let len = rtu::emit(unit, &mut out, pdu);
    out[..len].to_vec()
}

fn read(unit: u8, start: u16) -> Vec<u8> {
    modbus(unit, |out| RequestPdu::Read { space: Space::Holding, start, count: 1 }.emit(out))
}

fn word(unit: u8, value: u16) -> Vec<u8> {
    let data = value.to_be_bytes();
    modbus(unit, |out| ReplyPdu::Read { space: Space::Holding, data: &data }.emit(out))
}

#[test]
fn planted_in_modbus() {
    let polls = |tape: &mut SerialLog| {
        for n in 0..8 {
            tape.after(10).request(&read(1, 0x1000)).reply(&word(1, n));
            tape.after(10).request(&read(2, 0x1000)).reply(&word(2, n));
        }
    };
    let planted = |plant: &dyn Fn(&mut SerialLog)| {
        let mut tape = SerialLog::default();
        polls(&mut tape);
        plant(&mut tape);
        tape.after(50);
        polls(&mut tape);
        tape.report("modbus-rtu").anomalies
    };
    let request = read(1, 0x1000);
    let write =
        |unit| modbus(unit, |out| RequestPdu::WriteRegister { address: 0x33, value: 9 }.emit(out));
    assert_eq!(planted(&|_| ()), [""; 0]);
    assert_eq!(planted(&|t| discard(t.request(&write(0)).after(500))), [""; 0], "to everybody");
    assert_eq!(planted(&|t| discard(t.request(&write(1)).reply(&write(1)))), [""; 0]);
    assert_eq!(planted(&|t| discard(t.request(&write(1)).after(500))), ["unanswered"]);
    assert_eq!(
        planted(&|t| discard(t.request(&write(1)).after(500).request(&write(1)).reply(&write(1)))),
        ["retry"]
    );
    assert_eq!(
        planted(&|t| discard(t.request(&request).after(300).reply(&word(1, 0)))),
        ["late-reply"]
    );
    assert_eq!(
        planted(&|t| discard(t.request(&request).reply(&word(2, 0)).reply(&word(1, 0)))),
        ["foreign-reply"]
    );
    let refused = modbus(1, |out| {
        let exception = polepair_core::proto::modbus::wire::Exception::IllegalAddress;
        ReplyPdu::Exception { function: 3, exception }.emit(out)
    });
    assert_eq!(planted(&|t| discard(t.request(&request).reply(&refused))), ["refused"]);
    let mut broken = word(1, 0);
    broken[3] ^= 1;
    assert_eq!(planted(&|t| discard(t.request(&request).reply(&broken))), ["bad-check"]);
    let twins = |t: &mut SerialLog| {
        discard(t.request(&request).reply(&word(1, 1)).after(30).reply(&word(1, 2)))
    };
    assert_eq!(planted(&twins), ["duplicate-address"]);
}

#[test]
fn a_line_without_directions_is_paired_too() {
    let mut tape = SerialLog::default();
    let write = modbus(1, |out| RequestPdu::WriteRegister { address: 0x33, value: 9 }.emit(out));
    for n in 0..8 {
        tape.after(10)
            .request(&write)
            .reply(&write)
            .after(10)
            .request(&read(1, 0x1000))
            .reply(&word(1, n));
    }
    tape.text = tape.text.replace("tty >", "tty -").replace("tty <", "tty -");
    tape.text = tape
        .text
        .lines()
        .filter_map(|line| line.split_once("tty -"))
        .fold(String::new(), |all, (_, bytes)| all + bytes.trim() + "\n");
    let report = tape.report("modbus-rtu");
    assert_eq!(
        (report.anomalies.len(), report.outcomes),
        (0, vec![ExchangeOutcome::Done; 16]),
        "{:?}",
        report.anomalies
    );
}

fn tml(online: &OnlineMessage, to: IdCode) -> Vec<u8> {
    let mut out = [0; serial::FRAME_MAX];
    let len = serial::encode(&Message { to, instruction: online.emit() }, &mut out);
    out[..len].to_vec()
}

fn encode_text(text: &str, axis: u32) -> Vec<u8> {
    let mut out = [0; 20];
    let profile = polepair_drives::usual_profile(&SERIAL);
    let addressing = EncodeOptions { axis: Some(axis), profile, ..EncodeOptions::default() };
    let encoded = SERIAL.encode(text, &addressing, &mut out).expect("TML");
    out[..encoded.len].to_vec()
}

fn take_data(axis: u8, address: u16, value: u32) -> Vec<u8> {
    let cell = Cell::long(address);
    tml(&OnlineMessage::TakeData { sender: IdCode::axis(axis), cell, value }, IdCode::host_at(1))
}

fn give_me_data(axis: u8, address: u16) -> Vec<u8> {
    let cell = Cell::long(address);
    tml(&OnlineMessage::GiveMeData { sender: IdCode::host_at(1), cell }, IdCode::axis(axis))
}

const APOS: u16 = 0x0228;

#[test]
fn planted_in_tml() {
    let polls = |tape: &mut SerialLog| {
        for n in 0..8 {
            // Through the relay both are asked before either answers.
            tape.after(10)
                .request(&give_me_data(1, APOS))
                .reply(&[0x4F])
                .request(&give_me_data(2, APOS))
                .reply(&[0x4F]);
            tape.reply(&take_data(2, APOS, n)).reply(&take_data(1, APOS, n));
            tape.after(10).request(&encode_text("CPOS=1000L", 1)).reply(&[0x4F]);
        }
    };
    let planted = |plant: &dyn Fn(&mut SerialLog)| {
        let mut tape = SerialLog::default();
        polls(&mut tape);
        plant(&mut tape);
        tape.after(5000);
        polls(&mut tape);
        tape.report("tml").anomalies
    };
    assert_eq!(planted(&|_| ()), [""; 0]);
    let update = encode_text("UPD", 1);
    assert_eq!(planted(&|t| discard(t.request(&update))), ["missing-ack"]);
    assert_eq!(
        planted(&|t| discard(t.request(&give_me_data(1, APOS)).reply(&[0x4F]))),
        ["unanswered"]
    );
    let unacked = |t: &mut SerialLog| {
        discard(t.request(&give_me_data(1, APOS)).reply(&take_data(1, APOS, 0)))
    };
    assert_eq!(planted(&unacked), ["missing-ack"]);
    assert_eq!(planted(&|t| discard(t.reply(&take_data(9, APOS, 0)))), ["foreign-reply"]);
    assert_eq!(planted(&|t| discard(t.reply(&[0x4F]))), ["duplicate-reply"]);
    assert_eq!(planted(&|t| discard(t.after(2000).reply(&[0x4F]))), ["foreign-reply"]);
    // The answer for one variable does not answer the other, and the host asks on.
    let lost = |t: &mut SerialLog| {
        t.request(&give_me_data(1, APOS)).reply(&[0x4F]);
        t.request(&give_me_data(1, 0x022C)).reply(&[0x4F]).reply(&take_data(1, 0x022C, 0));
        t.request(&give_me_data(1, APOS)).reply(&[0x4F]).reply(&take_data(1, APOS, 0));
    };
    assert_eq!(planted(&lost), ["unanswered"]);
    let flipped = |t: &mut SerialLog| {
        let mut answer = take_data(1, APOS, 0);
        answer[8] ^= 1;
        t.request(&give_me_data(1, APOS)).reply(&[0x4F]).reply(&answer);
    };
    assert_eq!(planted(&flipped), ["bad-check"]);
    let point = |counter: u8| {
        use polepair_core::proto::tml::online::PvtPoint;
        let point = PvtPoint { position: 10, velocity: 0, time: 20, counter };
        tml(&OnlineMessage::Pvt(point), IdCode::axis(1))
    };
    let path = |numbers: &[u8]| {
        planted(&|t| numbers.iter().for_each(|n| discard(t.request(&point(*n)).reply(&[0x4F]))))
    };
    assert_eq!(path(&[1, 2, 3]), [""; 0]);
    assert_eq!(path(&[126, 127, 0, 1]), [""; 0]);
    assert_eq!(path(&[1, 2, 4, 5]), ["sequence"]);
}

#[test]
fn variables_of_tml_have_names_and_faults_words() {
    let profile = polepair_drives::usual_profile(&SERIAL).expect("a profile");
    let mer = profile.parameters.iter().find(|p| p.symbol == "MER").expect("MER").index;
    let short = |value| {
        let cell = Cell::short(mer);
        tml(&OnlineMessage::TakeData { sender: IdCode::axis(1), cell, value }, IdCode::host_at(1))
    };
    let request = tml(
        &OnlineMessage::GiveMeData { sender: IdCode::host_at(1), cell: Cell::short(mer) },
        IdCode::axis(1),
    );
    let mut tape = SerialLog::default();
    tape.request(&give_me_data(1, APOS)).reply(&[0x4F]).reply(&take_data(1, APOS, 1000));
    tape.request(&encode_text("CPOS=2000L", 1)).reply(&[0x4F]);
    for word in [2, 0] {
        tape.request(&request).reply(&[0x4F]).reply(&short(word));
    }
    let report = tape.report("tml");
    assert!(report.signals[0].starts_with("1 Actual/Position ="), "{:?}", report.signals);
    assert!(report.signals[1].starts_with("1 position command = 2000"), "{:?}", report.signals);
    assert_eq!(report.faults, ["+0002", "-0002"]);
    assert_eq!(report.anomalies, [""; 0]);
}

#[test]
fn commands_on_tmlcan_get_no_reply() {
    let mut out = [0; 20];
    let addressing = EncodeOptions { axis: Some(3), ..EncodeOptions::default() };
    let mut tape = SerialLog::default();
    for text in ["UPD", "AXISON", "UPD"] {
        let encoded = TMLCAN.encode(text, &addressing, &mut out).expect("TML");
        let mut frame = Frame::standard(0, &out[..encoded.len]);
        (frame.id, frame.extended) = (encoded.id.expect("CAN"), true);
        tape.after(900).can(&frame);
    }
    let report = tape.report("tmlcan");
    assert_eq!((report.anomalies, report.outcomes.len()), (vec![], 0));
}

fn order(command: CommandWord, value: u16) -> Frame {
    Order::with_value(command, value).frame(11)
}

fn echo(command: CommandWord, data: u32) -> Frame {
    Echo { command, sub: 0, data }.frame(11)
}

#[test]
fn planted_in_a_thruster() {
    let polls = |tape: &mut SerialLog| {
        for n in 0..8 {
            tape.after(10)
                .can(&Order::without_value(CommandWord::QP).frame(11))
                .can(&echo(CommandWord::QP, 480));
            tape.after(10).can(&order(CommandWord::TC, n)).can(&echo(CommandWord::TC, n.into()));
        }
    };
    let planted = |plant: &dyn Fn(&mut SerialLog)| {
        let mut tape = SerialLog::default();
        polls(&mut tape);
        plant(&mut tape);
        tape.after(5000)
            .can(&Order::without_value(CommandWord::QP).frame(11))
            .can(&echo(CommandWord::QP, 480));
        tape.report("thruster").anomalies
    };
    let vm = |value: u16| (order(CommandWord::VM, value), echo(CommandWord::VM, value.into()));
    let set = |t: &mut SerialLog, value| {
        let (frame, answer) = vm(value);
        t.can(&frame).can(&answer);
    };
    let tc = order(CommandWord::TC, 5);
    assert_eq!(planted(&|_| ()), [""; 0]);
    assert_eq!(planted(&|t| discard(t.can(&order(CommandWord::ST, 500)))), ["unanswered"]);
    assert_eq!(planted(&|t| discard(t.can(&tc).can(&echo(CommandWord::TC, 0xEEEE)))), ["refused"]);
    // Silent: no reply is outstanding, and an echo shows that the request was forgotten.
    assert_eq!(
        planted(&|t| {
            set(t, 0x0200);
            t.can(&tc);
        }),
        [""; 0]
    );
    assert_eq!(
        planted(&|t| {
            set(t, 0x0200);
            t.can(&tc).can(&echo(CommandWord::TC, 5));
        }),
        ["restart"]
    );
    // Echoes were asked for: one is missing.
    assert_eq!(
        planted(&|t| {
            set(t, 0);
            t.can(&tc);
        }),
        ["unanswered"]
    );
    let report = |part| {
        use polepair_core::proto::thruster::wire::ReportFrame;
        ReportFrame { source: b'T', part, words: [0; 3] }.frame(11)
    };
    assert_eq!(
        planted(&|t| {
            set(t, 7);
            t.can(&tc).can(&report(1)).can(&report(2)).can(&report(3));
        }),
        [""; 0]
    );
    assert_eq!(
        planted(&|t| {
            set(t, 7);
            t.can(&tc).can(&report(1)).can(&report(2));
        }),
        ["incomplete"]
    );
}

#[test]
fn readings_and_faults_of_a_thruster() {
    let mut tape = SerialLog::default();
    tape.can(&Order::without_value(CommandWord::QP).frame(11)).can(&echo(CommandWord::QP, 480));
    for word in [0x0004, 0] {
        tape.can(&Order::without_value(CommandWord::EF).frame(11))
            .can(&echo(CommandWord::EF, word));
    }
    let report = tape.report("thruster");
    assert_eq!(report.signals[0], "11 Actual/Voltage = 48 V");
    assert_eq!(report.faults, ["+0004", "-0004"]);
}
