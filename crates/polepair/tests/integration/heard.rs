//! Silence in which other bytes were received: each kind has its own message, with counts.
#![cfg(unix)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use polepair::axis::{StopNotice, StopOptions, stop_axes};
use polepair::no_reply::{NoReplyCause, NoReplyDetails};
use polepair::{Error, connect_local};
use polepair_link::pty::Pty;
use polepair_link::{LinkIo as _, Received, clock};

/// The far end of a line: sends a fixed number of bytes for each request.
struct OddDrive {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    path: String,
}

impl OddDrive {
    fn giving(answer: impl Fn(&[u8]) -> Vec<u8> + Send + 'static) -> Self {
        let pty = Pty::open(None).expect("a pseudo-terminal");
        let (over, path) = (Arc::new(AtomicBool::new(false)), pty.path().to_owned());
        let its = Arc::clone(&over);
        let thread = std::thread::spawn(move || {
            let mut received = [0; 256];
            while !its.load(Ordering::SeqCst) {
                let until = clock::now() + Duration::from_millis(20);
                if let Ok(Received::Bytes { len, .. }) = pty.receive(&mut received, until) {
                    let given = answer(&received[..len]);
                    // The client may have gone.
                    let _ = if given.is_empty() { Ok(()) } else { pty.send(&given) };
                }
            }
        });
        Self { over, thread: Some(thread), path }
    }

    /// Reads a parameter of axis `number`. Returns the details and the message of the error.
    fn query_drive(
        &self,
        protocol: &str,
        profile: &str,
        number: u32,
        name: &str,
    ) -> (NoReplyDetails, String) {
        let others = if number == 1 { "1".to_owned() } else { format!("1,{number}") };
        let url =
            format!("{protocol}+serial://{}?profile={profile}&timeout=100#{others}", self.path);
        let read = connect_local(&url).and_then(|link| {
            let axis = link.axis(number).expect("an axis");
            axis.get_raw(name)
        });
        failed(read.map(drop))
    }
}

impl Drop for OddDrive {
    fn drop(&mut self) {
        self.over.store(true, Ordering::SeqCst);
        self.thread.take().expect("it ends once").join().expect("it ends well");
    }
}

fn failed(result: Result<(), Error>) -> (NoReplyDetails, String) {
    let error = result.expect_err("nobody answers");
    assert_eq!(error.code(), "E401", "{error}");
    let text = format!("{error}; {}", error.hint());
    let Error::Failed { received, .. } = error else { panic!("{error}") };
    assert_eq!(received.is_nothing(), text.contains("no answer; "), "{text}");
    (*received, text)
}

/// A reply of TMCL's binary form, with what its check should be and with how much is added to it.
fn tmcl(module: u8, wrong: u8) -> Vec<u8> {
    let reply = [2, module, 100, 6, 0, 0, 0, 5];
    let sum = reply.iter().fold(wrong, |sum: u8, byte| sum.wrapping_add(*byte));
    [&reply[..], &[sum]].concat()
}

#[test]
fn on_a_line_of_tmcl_each_kind_is_reported() {
    let reported = |answer: fn(&[u8]) -> Vec<u8>| {
        OddDrive::giving(answer).query_drive("tmcl", "tmcm-171", 1, "max current")
    };
    let (details, text) = reported(|_| Vec::new());
    assert_eq!(details, NoReplyDetails::default(), "{text}");
    let (details, text) = reported(|_| tmcl(1, 7));
    assert!(
        details.cause() == NoReplyCause::Corrupt && text.contains("with a wrong check"),
        "{text}"
    );
    assert!(details.corrupt >= 2, "of each repeat: {details:?}");
    let (details, text) = reported(|_| tmcl(9, 0));
    assert!(details.cause() == NoReplyCause::Foreign && details.foreign >= 2, "{text}");
    let (details, text) = reported(|_| vec![0x13, 0x80, 0xFF]);
    assert!(details.cause() == NoReplyCause::Noise && text.contains("baud rate"), "{text}");
    assert_eq!(details.bytes % 3, 0, "those that made no frame count too: {details:?}");
    let (details, text) = reported(|request| request.to_vec());
    assert!(details.cause() == NoReplyCause::Echo && text.contains("echo"), "{text}");
    let (details, text) = reported(|_| b"BA 100 -5000\r".to_vec());
    assert!(details.cause() == NoReplyCause::Text && text.contains("ASCII mode"), "{text}");
}

#[test]
fn an_acknowledgement_is_no_answer_and_a_relays_is_another_drives() {
    let ok = OddDrive::giving(|_| vec![b'O']);
    let (details, text) = ok.query_drive("tml", "technosoft-f514l", 1, "APOS");
    assert!(details.cause() == NoReplyCause::Acknowledged && details.acknowledged > 0, "{text}");
    assert!(text.contains("acknowledgement") && text.contains("receives the requests"), "{text}");
    let (details, text) = ok.query_drive("tml", "technosoft-f514l", 2, "APOS");
    assert!(details.cause() == NoReplyCause::Relayed && details.acknowledged == 0, "{text}");
    assert!(text.contains("the axis behind it does not"), "{text}");
}

/// A drive that replies to its stop and then falls silent got its stop, and its motor may turn.
#[test]
fn a_look_that_is_not_answered_is_no_stop_that_was_not_executed() {
    let odd_drive = OddDrive::giving(|_| vec![b'O']);
    let url = format!("tml+serial://{}?profile=technosoft-f514l&timeout=100#1", odd_drive.path);
    let link = connect_local(&url).expect("a link");
    let mut notices = Vec::new();
    let ended =
        stop_axes(link.axes(), StopOptions::default(), Duration::from_secs(10), |_, notice| {
            let is_news = *notice != StopNotice::Waiting;
            notices.extend(is_news.then(|| notice.clone()));
            notices.len() < 2 || !is_news
        });
    assert!(matches!(notices[..], [StopNotice::Unconfirmed(_), StopNotice::Unconfirmed(_)]));
    let error = ended[0].standstill.as_ref().expect_err("nothing is told");
    let text = error.to_string();
    assert!(text.contains("received a stop, but its standstill is not confirmed: `"), "{text}");
    assert!(!text.contains("not executed") && error.may_turn(), "{text}");
    assert_eq!((error.code(), error.executed()), ("E401", None));
}

#[test]
fn a_wrong_check_on_modbus_is_reported() {
    // One register, with the sum of another value.
    let odd_drive = OddDrive::giving(|_| vec![1, 3, 2, 0, 5, 0x79, 0x84]);
    let (details, text) = odd_drive.query_drive("modbus-rtu", "syntron-ts", 1, "motor speed");
    assert!(details.cause() == NoReplyCause::Corrupt, "{text}");
}

#[test]
fn a_connection_without_a_profile_reports_it_as_well() {
    let odd_drive = OddDrive::giving(|_| tmcl(1, 7));
    let url = format!("tmcl+serial://{}?timeout=100#1", odd_drive.path);
    let (details, text) = failed(connect_local(&url).map(drop));
    assert!(details.corrupt > 0 && text.contains("does not answer on"), "{text}");
}
