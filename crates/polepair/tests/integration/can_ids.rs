//! Modules with CAN identifiers above FFh, and hosts that a module does not answer.

use polepair::connect_local;

#[test]
fn a_module_with_an_identifier_of_eleven_bits_is_commanded() {
    let link = connect_local("sim:tmcm-1140+can:0x301,0x702?time=virtual#0x301,0x702").unwrap();
    for number in [0x301, 0x702] {
        let axis = link.axis(number).unwrap();
        assert_eq!(axis.get_raw("GP 71").unwrap(), i64::from(number));
        let armed = axis.armed().unwrap();
        armed.move_to("0.1 turn").unwrap();
        armed.wait(std::time::Duration::from_secs(20)).unwrap();
    }
    let frames = link.axis(0x702).unwrap().rehearse_raw("GAP 1").unwrap().frames;
    assert_eq!(frames[0].frame.unwrap().id, 0x702);
    // Their replies could not be distinguished.
    let link =
        connect_local("sim:tmcm-1140+can:0x101,0x201?time=virtual&profile=tmcm-1140#0x101,0x201")
            .unwrap();
    link.axis(0x101).unwrap().get_raw("actual position").unwrap();
    let refused = link.axis(0x201).unwrap().get_raw("actual position").unwrap_err();
    assert!(refused.code() == "E222" && refused.to_string().contains("low byte"), "{refused}");
}

#[test]
fn a_reply_to_another_host_is_reported() {
    for (url, setting) in [
        ("sim:tmcm-1140?time=virtual", "host address"),
        ("sim:tmcm-1140+can?time=virtual", "can reply id"),
    ] {
        let link = connect_local(url).unwrap();
        let axis = link.axis(1).unwrap();
        axis.set(setting, "5").unwrap();
        let silent = axis.get_raw("actual position").unwrap_err();
        let text = silent.to_string();
        assert!(silent.code() == "E401" && text.contains("it replies to host 5"), "{url}: {text}");
        assert!(silent.hint().contains("`?host=5`"), "{}", silent.hint());
    }
}
