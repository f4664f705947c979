use super::telemetry::{HEADER_LEN, SAMPLE_LEN, SAMPLES_MAX, Sample, decode, encode};
use super::*;

fn client(text: &str) -> ClientMessage {
    serde_json::from_str(text).unwrap()
}

#[test]
fn a_command_is_read_with_its_time_to_live_by_default() {
    let message = client(
        r#"{"type":"command","axis":2,"id":"a","issued_ms":1,"epoch":3,"verb":"move-to",
            "arguments":{"target":1.5}}"#,
    );
    let ClientMessage::Command { axis: 2, command } = message else { panic!("{message:?}") };
    assert_eq!((command.ttl_ms, command.epoch, &*command.verb), (DEFAULT_TTL_MS, 3, "move-to"));
    assert_eq!(command.arguments.target, Some(1.5));
    assert_eq!(command.arguments.velocity, None);
}

#[test]
fn an_unknown_argument_is_refused() {
    let text = r#"{"type":"command","axis":0,"id":"a","issued_ms":1,"epoch":3,"verb":"velocity",
                   "arguments":{"velocty":1.5}}"#;
    assert!(serde_json::from_str::<ClientMessage>(text).is_err());
}

#[test]
fn optional_parts_may_be_left_out() {
    assert_eq!(client(r#"{"type":"stop"}"#), ClientMessage::Stop(StopRequest::default()));
    assert_eq!(client(r#"{"type":"release"}"#), ClientMessage::Release);
    let lease = ClientMessage::Lease { axis: 1, act: LeaseAction::Take, epoch: 0 };
    assert_eq!(client(r#"{"type":"lease","axis":1,"act":"take"}"#), lease);
}

/// The readable part of a stop is obeyed, and the rest is named.
#[test]
fn the_readable_part_of_a_stop_is_executed() {
    let all: Option<&[u16]> = None;
    for (text, axes, unreadable) in [
        ("{}", all, &[][..]),
        (r#"{"axes":null,"reason":"x"}"#, all, &[]),
        (r#"{"axes":[0,70000]}"#, Some(&[0]), &["axis 70000"]),
        (r#"{"axes":[0.0,2.5,-1]}"#, Some(&[0]), &["axis 2.5", "axis -1"]),
        (r#"{"axes":["1",3]}"#, Some(&[3]), &["axis \"1\""]),
        (r#"{"axes":4}"#, Some(&[4]), &[]),
        (r#"{"axes":"all"}"#, Some(&[]), &["axes \"all\""]),
        (r#"{"axes":[1],"force":true}"#, Some(&[1]), &["\"force\": true"]),
    ] {
        let request: StopRequest = serde_json::from_str(text).unwrap();
        assert_eq!(request.axes.as_deref(), axes, "{text}");
        assert_eq!(request.unreadable, unreadable, "{text}");
        let live = text.replacen('{', r#"{"type":"stop","#, 1).replace(",}", "}");
        assert_eq!(client(&live), ClientMessage::Stop(request), "{text}");
    }
}

#[test]
fn a_servers_message_says_its_type() {
    let text = serde_json::to_value(ServerMessage::Unlocked).unwrap();
    assert_eq!(text, serde_json::json!({ "type": "unlocked" }));
    let stopped =
        AxisStopReport { id: 1, class: StopClass::Standing, ms: 2.5, quick: false, error: None };
    let text = serde_json::to_value(ServerMessage::Stopped(StopReport {
        axes: vec![stopped],
        unreached: Vec::new(),
        refused: Vec::new(),
    }));
    let axis = serde_json::json!({
        "id": 1, "class": "standing", "ms": 2.5, "quick": false, "error": null,
    });
    assert_eq!(text.unwrap(), serde_json::json!({ "type": "stopped", "axes": [axis] }));
}

#[test]
fn every_refusal_has_a_status_of_an_error() {
    for (code, status) in [("gateway.token", 401), ("E401", 504), ("E219", 422), ("E601", 409)] {
        assert_eq!(GatewayError::new(code, "").status(), status, "{code}");
    }
}

#[test]
fn a_token_is_not_shown() {
    assert!(!format!("{:?}", Login { token: "secret".into() }).contains("secret"));
}

#[test]
fn telemetry_lies_as_it_is_written_down() {
    let samples = [Sample { t_us: 10, value: 1.0 }, Sample { t_us: 1_010, value: -2.0 }];
    let (bytes, count) = encode(7, 9, &samples);
    assert_eq!(count, 2);
    let mut expected = vec![1, 1, 7, 0, 2, 0, 0, 0, 10, 0, 0, 0, 0, 0, 0, 0];
    expected.extend([9, 0, 0, 0, 0, 0, 0, 0]);
    expected.extend([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xF0, 0x3F]);
    expected.extend([0xE8, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xC0]);
    assert_eq!(bytes, expected);
    assert_eq!(decode(&bytes), Some((7, 9, samples.to_vec())));
    for end in 0..bytes.len() {
        assert_eq!(decode(&bytes[..end]), None, "{end} bytes of it");
    }
}

#[test]
fn telemetry_leaves_what_does_not_fit_for_the_next_message() {
    let far = [Sample { t_us: 0, value: 0.0 }, Sample { t_us: 1 << 33, value: 0.0 }];
    assert_eq!(encode(0, 0, &far).1, 1);
    let many = vec![Sample { t_us: 5, value: 0.0 }; SAMPLES_MAX + 1];
    let (bytes, count) = encode(0, 0, &many);
    assert_eq!((bytes.len(), count), (HEADER_LEN + SAMPLES_MAX * SAMPLE_LEN, SAMPLES_MAX));
    assert!(bytes.len() <= 65_536);
}

#[test]
fn a_fingerprint_is_the_sha_256_in_pairs_of_digits() {
    // FIPS 180-2, appendix B.1.
    let printed = super::certificate_fingerprint(b"abc");
    assert!(printed.starts_with("BA:78:16:BF:8F:01:CF:EA:"), "{printed}");
    assert_eq!(printed.len(), 32 * 3 - 1);
}
