//! Parameters by their number, in the notation of each protocol.

use polepair::axis::{ParameterValue, summarize_details};
use polepair::scan::scan;
use polepair::{Connector, Error, LocalLink};
use polepair_core::profile::Encoding;
use std::ops::ControlFlow;

fn open(url: &str) -> LocalLink {
    polepair::connect_local(&format!("{url}?time=virtual")).unwrap()
}

fn refusal(link: &LocalLink, address: &str) -> String {
    let axis = &link.axes()[0];
    let id = axis.find(address).unwrap();
    axis.write(id, 1, false).unwrap_err().to_string()
}

#[test]
fn an_address_of_the_profile_is_its_parameter() {
    for (url, address, name) in [
        ("sim:canopen", "0x6041", "statusword"),
        ("sim:canopen", "6041h:0:u16", "statusword"),
        ("sim:modbus-rtu", "R 51", "internal speed"),
        ("sim:tmcl", "ap 6", "max current"),
        ("sim:tml", "@0x0228:i32", "actual position"),
        ("sim:thruster", "qv", "speed"),
    ] {
        let link = open(url);
        let axis = &link.axes()[0];
        let id = axis.find(address).unwrap();
        assert_eq!(axis.profile().parameter(id).unwrap().name, name, "{url} {address}");
    }
}

#[test]
fn a_type_of_ones_own_shows_the_plain_number() {
    let link = open("sim:tml");
    let axis = &link.axes()[0];
    let id = axis.find("@0x0228:i16").unwrap();
    let parameter = axis.parameter(id).unwrap();
    assert_eq!((parameter.name, parameter.symbol), ("@0x0228:i16", "@0x0228"));
    assert_eq!(axis.get("@0x0228:i16").unwrap().to_string(), "0");
    assert_eq!(axis.find("@0x0228:i16").unwrap(), id, "the same one again");
    assert!(axis.profile().parameter(id).is_none());
}

#[test]
fn standard_objects_have_their_standard_names() {
    let link = open("sim:canopen");
    let axis = &link.axes()[0];
    let id = axis.find("0x1008").unwrap();
    assert_eq!(axis.parameter(id).unwrap().name, "device name");
    assert_eq!(axis.get_text("1008h").unwrap(), "Polepair CiA 402 drive");
    assert!(matches!(axis.get("1008h"), Err(Error::Unsupported { .. })));
    // The second axis is like the first.
    let second = axis.parameter(axis.find("0x6864").unwrap()).unwrap();
    assert_eq!((second.encoding, second.name), (Encoding::I32, "6864h"));
}

#[test]
fn an_undocumented_request_needs_an_armed_axis() {
    for (url, address) in [
        ("sim:canopen", "0x2030:1:u16"),
        ("sim:modbus-rtu", "0x3333"),
        ("sim:tmcl", "AP 99"),
        ("sim:tml", "@0x03B0"),
        ("sim:thruster", "SP 99"),
    ] {
        let refused = refusal(&open(url), address);
        assert!(refused.contains("armed"), "{url} {address}: {refused}");
    }
    // The axis need not be armed: it is the drive that refuses, or takes it.
    let link = open("sim:tmcl");
    link.axes()[0].set("GP 0.2", 7).unwrap();
    assert_eq!(link.axes()[0].get_raw("GP 0.2").unwrap(), 7);
    let refused = refusal(&open("sim:canopen"), "0x1FFF:1:u32");
    assert!(refused.contains("refused"), "{refused}");
}

#[test]
fn values_that_the_type_cannot_hold_are_refused() {
    let link = open("sim:canopen");
    let axis = &link.axes()[0];
    axis.arm(true);
    for (address, value) in [
        ("0x2F01:1:u16", "65536"),
        ("0x2F01:1:i8", "-129"),
        ("0x2F01:1:u64", "18446744073709551616"),
        ("0x2F01:1:f32", "1e300"),
    ] {
        let refused = axis.set(address, value).unwrap_err();
        let code = refused.code();
        assert!(matches!(code, "E216" | "E217"), "{address} {value}: {code} {refused}");
    }
    let untyped = axis.set("0x2F77:1", 5).unwrap_err().to_string();
    assert!(untyped.contains("type of `2F77h:1` is not known"), "{untyped}");
}

#[test]
fn a_wrong_address_is_refused_with_the_right_form() {
    let link = open("sim:canopen");
    let axis = &link.axes()[0];
    for (text, part) in [
        ("0x2030:300", "expected a sub-index"),
        ("0x2030:1:u7", "expected a type"),
        ("0x12345", "expected an index"),
        ("no such thing", "has no parameter"),
    ] {
        let refused = axis.find(text).unwrap_err();
        assert!(refused.to_string().contains(part), "{text}: {refused}");
        assert!(refused.hint().contains("0x2030:1:u16"), "{text}: {}", refused.hint());
    }
}

#[test]
fn a_drive_tells_its_name_and_versions() {
    for (url, shown) in [
        ("sim:canopen", "Polepair CiA 402 drive, hardware simulated, software"),
        ("sim:tmcl", "TMCM-171 V1.14"),
        ("sim:tmcl?profile=tmcl", "TMCM-171 V1.14"),
        ("sim:tml", "firmware 514L"),
        ("sim:modbus-rtu", ""),
    ] {
        let joint = if url.contains('?') { '&' } else { '?' };
        let link = polepair::connect_local(&format!("{url}{joint}time=virtual")).unwrap();
        let details = link.axes()[0].device_details().unwrap();
        let text = summarize_details(&details);
        assert!(text.starts_with(shown) && (text.is_empty() == shown.is_empty()), "{url}: {text}");
    }
    let scanned = scan(&Connector::default(), "sim:canopen?time=virtual", 1..=3, &mut |_| {
        ControlFlow::Continue(())
    });
    let found = scanned.unwrap().found;
    assert!(summarize_details(&found[0].details).contains("software"), "{found:?}");
}

#[test]
fn text_and_bytes_are_read_on_a_bus_of_several_protocols() {
    let folder = std::env::temp_dir().join(format!("polepair-addresses-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let rack = folder.join("bus.toml");
    let drive = |name: &str, profile: &str, address: u8| {
        format!("[[link.drive]]\nname = \"{name}\"\nprofile = \"{profile}\"\naddress = {address}\n")
    };
    let drives = drive("node", "cia402", 5) + &drive("screw", "thruster", 9);
    std::fs::write(
        &rack,
        format!("[[link]]\nname = \"bus\"\nkind = \"can\"\nbitrate = 500000\n{drives}"),
    )
    .unwrap();
    let link = polepair::connect_local(&format!("sim:{}?time=virtual", rack.display())).unwrap();
    let node = link.axes().iter().find(|axis| axis.name() == "node").unwrap();
    assert_eq!(node.get_text("1008h").unwrap(), "Polepair CiA 402 drive");
    let id = node.find("0x2F01:2:bytes").unwrap();
    node.arm(true);
    node.write_data(id, &[7; 2_000], &mut |_| {}).unwrap();
    node.set("0x2F01:1:u32", 2_000).unwrap();
    assert_eq!(node.read_data(id, true, &mut |_| {}).unwrap().len(), 2_000);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn bytes_of_any_length_go_both_ways() {
    let link = open("sim:canopen");
    let axis = &link.axes()[0];
    axis.set("0x2F01:1:u32", 40_000).unwrap_err();
    axis.arm(true);
    axis.set("0x2F01:1:u32", 40_000).unwrap();
    let id = axis.find("0x2F01:2:bytes").unwrap();
    let (mut reported, mut first) = (0, Vec::new());
    for block in [true, false] {
        let data = axis.read_data(id, block, &mut |count| reported = count).unwrap();
        assert_eq!((data.len(), reported), (40_000, 40_000), "block: {block}");
        assert!(first.is_empty() || first == data);
        first = data;
    }
    for len in [1, 7, 200, 5_000] {
        axis.write_data(id, &first[..len], &mut |count| reported = count).unwrap();
        assert_eq!(reported, len);
    }
    let long = axis.find("0x2F01:2").unwrap();
    let ParameterValue::Bytes(data) = axis.read_any(long).unwrap() else { panic!("bytes") };
    assert_eq!(data.len(), 40_000);
}
