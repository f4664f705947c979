//! Silence in which something was heard: each kind is told apart, with what was counted.
#![cfg(unix)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use polepair::axis::StopSequence;
use polepair::no_reply::{NoReplyCause, NoReplyDetails};
use polepair::{Error, connect};
use polepair_link::pty::Pty;
use polepair_link::{LinkIo as _, Received, clock};

/// The far end of a line: gives so much for whatever it hears.
struct Odd {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    path: String,
}

impl Odd {
    fn giving(answer: impl Fn(&[u8]) -> Vec<u8> + Send + 'static) -> Self {
        let pty = Pty::open(None).expect("a pseudo-terminal");
        let (over, path) = (Arc::new(AtomicBool::new(false)), pty.path().to_owned());
        let its = Arc::clone(&over);
        let thread = std::thread::spawn(move || {
            let mut heard = [0; 256];
            while !its.load(Ordering::SeqCst) {
                let until = clock::now() + Duration::from_millis(20);
                if let Ok(Received::Bytes { len, .. }) = pty.receive(&mut heard, until) {
                    let given = answer(&heard[..len]);
                    // Whoever asked may have gone.
                    let _ = if given.is_empty() { Ok(()) } else { pty.send(&given) };
                }
            }
        });
        Self { over, thread: Some(thread), path }
    }

    /// What a read of a parameter of axis `number` is told.
    fn told(
        &self,
        protocol: &str,
        profile: &str,
        number: u32,
        name: &str,
    ) -> (NoReplyDetails, String) {
        let others = if number == 1 { "1".to_owned() } else { format!("1,{number}") };
        let url =
            format!("{protocol}+serial://{}?profile={profile}&timeout=300#{others}", self.path);
        let read = connect(&url).and_then(|link| {
            let axis = link.axis(number).expect("an axis");
            axis.get_raw(name)
        });
        failed(read.map(drop))
    }
}

impl Drop for Odd {
    fn drop(&mut self) {
        self.over.store(true, Ordering::SeqCst);
        self.thread.take().expect("it ends once").join().expect("it ends well");
    }
}

fn failed(result: Result<(), Error>) -> (NoReplyDetails, String) {
    let error = result.expect_err("nobody answers");
    assert_eq!(error.code(), "E401", "{error}");
    let said = format!("{error}; {}", error.hint());
    let Error::Failed { received: heard, .. } = error else { panic!("{error}") };
    assert_eq!(heard.is_nothing(), said.contains("no answer; "), "{said}");
    (*heard, said)
}

/// A reply of TMCL's binary form, with what its check should be and with how much is added to it.
fn tmcl(module: u8, wrong: u8) -> Vec<u8> {
    let reply = [2, module, 100, 6, 0, 0, 0, 5];
    let sum = reply.iter().fold(wrong, |sum: u8, byte| sum.wrapping_add(*byte));
    [&reply[..], &[sum]].concat()
}

#[test]
fn on_a_line_of_tmcl_each_kind_is_told() {
    let told = |answer: fn(&[u8]) -> Vec<u8>| {
        Odd::giving(answer).told("tmcl", "tmcm-171", 1, "max current")
    };
    let (heard, said) = told(|_| Vec::new());
    assert_eq!(heard, NoReplyDetails::default(), "{said}");
    let (heard, said) = told(|_| tmcl(1, 7));
    assert!(
        heard.cause() == NoReplyCause::Corrupt && said.contains("with a wrong check"),
        "{said}"
    );
    assert!(heard.corrupt >= 2, "of each repeat: {heard:?}");
    let (heard, said) = told(|_| tmcl(9, 0));
    assert!(heard.cause() == NoReplyCause::Foreign && heard.foreign >= 2, "{said}");
    let (heard, said) = told(|_| vec![0x13, 0x80, 0xFF]);
    assert!(heard.cause() == NoReplyCause::Noise && said.contains("baud rate"), "{said}");
    assert_eq!(heard.bytes % 3, 0, "those that made no frame count too: {heard:?}");
    let (heard, said) = told(|asked| asked.to_vec());
    assert!(heard.cause() == NoReplyCause::Echo && said.contains("echo"), "{said}");
    let (heard, said) = told(|_| b"BA 100 -5000\r".to_vec());
    assert!(heard.cause() == NoReplyCause::Text && said.contains("ASCII mode"), "{said}");
}

#[test]
fn an_acknowledgement_is_no_answer_and_a_relays_is_another_drives() {
    let ok = Odd::giving(|_| vec![b'O']);
    let (heard, said) = ok.told("tml", "technosoft-f514l", 1, "APOS");
    assert!(heard.cause() == NoReplyCause::Acknowledged && heard.acknowledged > 0, "{said}");
    assert!(said.contains("acknowledgement") && said.contains("it hears us"), "{said}");
    let (heard, said) = ok.told("tml", "technosoft-f514l", 2, "APOS");
    assert!(heard.cause() == NoReplyCause::Relayed && heard.acknowledged == 0, "{said}");
    assert!(said.contains("the axis behind it is not"), "{said}");
}

/// A drive that takes its stop and then tells nothing was told to stop, and may turn.
#[test]
fn a_look_that_is_not_answered_is_no_stop_that_was_not_executed() {
    let odd = Odd::giving(|_| vec![b'O']);
    let url = format!("tml+serial://{}?profile=technosoft-f514l&timeout=300#1", odd.path);
    let link = connect(&url).expect("a link");
    let mut stopping = StopSequence::begin(&link.axes()[0]);
    stopping.wait(&link.axes()[0], Duration::from_secs(10));
    let error = stopping.trouble().expect("nothing is told");
    let said = error.to_string();
    assert!(said.contains("was told to stop and not seen to stand: `"), "{said}");
    assert!(!said.contains("not executed") && error.may_turn(), "{said}");
    assert_eq!((error.code(), error.executed()), ("E401", None));
}

#[test]
fn a_wrong_check_on_modbus_is_told() {
    // One register, with the sum of another value.
    let odd = Odd::giving(|_| vec![1, 3, 2, 0, 5, 0x79, 0x84]);
    let (heard, said) = odd.told("modbus-rtu", "syntron-ts", 1, "motor speed");
    assert!(heard.cause() == NoReplyCause::Corrupt, "{said}");
}

#[test]
fn who_connects_without_a_profile_is_told_as_well() {
    let odd = Odd::giving(|_| tmcl(1, 7));
    let url = format!("tmcl+serial://{}?timeout=300#1", odd.path);
    let (heard, said) = failed(connect(&url).map(drop));
    assert!(heard.corrupt > 0 && said.contains("does not answer on"), "{said}");
}
