//! Every form of a connection string, and the message for each mistake.

use polepair::url::{LinkTarget, Url};

#[test]
fn every_form_is_read_and_written_back() {
    for text in [
        "tmcl+serial:///dev/ttyUSB0:9600#1",
        "tmcl+serial:///dev/ttyUSB0",
        "tmcl+serial://COM3:9600#1",
        "tmcl+serial:///dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0#1",
        "tmcl+tcp://10.0.0.5:4001#1,2",
        "modbus-rtu+tcp://[::1]:502?timeout=50&gap=0#247",
        "modbus-rtu+serial:///dev/ttyUSB0:115200?parity=even&stop=2#1",
        "modbus-ascii+serial:///tmp/a%23b#1",
        "modbus-ascii+serial:///dev/ttyUSB0?parity=even&bits=7#1",
        "tml+serial:///dev/ttyUSB0:115200?wire=rs485&host=255#1,2,g3",
        "tml+tcp://10.0.0.5:10001#255,1,g1+2+4,g*",
        "tmlcan+socketcan://can0?bitrate=500000&host=3#5,7",
        "technocan+slcan:///dev/ttyACM0?bitrate=500000#5",
        "technocan+slcan:///dev/ttyACM0:115200#5",
        "tmcl+slcan://10.0.0.5:4001#1",
        "tmcl+udp://239.74.163.2:43113#2",
        "tmlcan+udp://[ff15::1]:43113#2",
        "tmcl+socketcand://host:29536/can0#2",
        "sim:tmcl?axes=3&seed=1",
        "sim:tmcl+can:1,3?bitrate=125000",
        "sim:rack.toml",
        "sim:modbus-rtu?time=virtual#1,2,3",
        "sim:syntron-ts?variant=position",
        // What would be read as another part is written so that it is not.
        "sim:////0?///////=",
        "tmcl+serial:///dev/a%3A9600#1",
        "tmcl+serial:///dev/a%3A#1",
        "tmcl+serial:///dev/a:1:9600#1",
        "tmcl+slcan:///dev/a.b%3A12#1",
        "tmcl+slcan://com1%2E:9600#1",
    ] {
        let url: Url = text.parse().unwrap_or_else(|error| panic!("{text}: {error}"));
        assert_eq!(url.to_string(), text);
        assert_eq!(url.to_string().parse::<Url>().unwrap(), url);
    }
}

#[test]
fn short_forms_mean_the_long_ones() {
    let long = |text: &str| text.parse::<Url>().unwrap().to_string();
    assert_eq!(long("tmcl:///dev/ttyUSB0#1-3"), "tmcl+serial:///dev/ttyUSB0#1,2,3");
    assert_eq!(long("tmcl://10.0.0.5:4001"), "tmcl+tcp://10.0.0.5:4001");
    assert_eq!(long("tmcl://COM7:9600#0x10"), "tmcl+serial://COM7:9600#16");
    assert_eq!(long("sim://tmcl"), "sim:tmcl");
    assert_eq!(long("tmlcan://can0#1"), "tmlcan+socketcan://can0#1");
    assert_eq!(long("tmlcan:///dev/ttyACM0#g1+1"), "tmlcan+slcan:///dev/ttyACM0#g1");
    let url: Url = "tmcl+serial:///dev/ttyUSB0?timeout=0.2s&gap=2&echo=yes".parse().unwrap();
    assert_eq!(url.target, LinkTarget::Serial { path: "/dev/ttyUSB0".into(), baud: None });
    assert_eq!(url.milliseconds("timeout").unwrap(), Some(200.0));
    assert_eq!(url.milliseconds("gap").unwrap(), Some(2.0));
    assert!(url.flag("echo").unwrap());
}

#[test]
fn mistakes_are_reported_with_the_nearest_word() {
    for (text, code, output) in [
        ("tmlc+serial:///dev/ttyUSB0", "E203", "did you mean `tmcl`?"),
        ("modbus-rtx+tcp://a:1", "E203", "did you mean `modbus-rtu`?"),
        ("tmcl+serail:///dev/ttyUSB0", "E210", "did you mean `serial`?"),
        ("tmcl+serial:///dev/ttyUSB0?timeuot=5", "E210", "did you mean `timeout`?"),
        ("tmcl+serial:///dev/a?host=3&%68ost=4", "E210", "`host` is given twice"),
        ("sim:tmcl?axis=3", "E210", "did you mean `axes`?"),
        ("tmcl+serial:///dev/ttyUSB0?colour=red", "E210", "unknown key `colour`"),
        ("tmcl+serial:///dev/ttyUSB0?gap=1&gap=2", "E210", "`gap` is given twice"),
        ("tmcl+serial:///dev/ttyUSB0:0", "E210", "no valid baud rate"),
        ("tmcl+slkan:///dev/ttyACM0", "E210", "did you mean `slcan`?"),
        ("modbus-rtu+socketcan://can0", "E210", "`modbus-rtu` is not used on CAN"),
        ("tmlcan+serial:///dev/ttyUSB0", "E210", "`tmlcan` is not used on a serial line"),
        ("tmcl+serial:///dev/ttyUSB0?bitrate=5", "E210", "`bitrate` is a key of CAN links, not of"),
        ("tmcl+socketcan://can0?parity=even", "E210", "`parity` is a key of serial links, not of"),
        ("tmcl+socketcan://can0?bitrat=5", "E210", "did you mean `bitrate`?"),
        (
            "sim:modbus-rtu?ack=5",
            "E210",
            "`ack` is a key of tml, tmlcan, technocan, not of modbus-rtu",
        ),
        ("modbus-rtu+tcp://a:1?host=5", "E210", "`host` is a key of tmcl, "),
        ("thruster+udp://239.74.163.2:1?heartbeat=9", "E210", "of canopen, not of thruster"),
        ("canopen+udp://239.74.163.2:1?host=200", "E210", "`host=200` is not 1 to 127"),
        ("tml+serial:///dev/ttyUSB0?through=0", "E210", "`through=0` is not 1 to 255"),
        ("tml+serial:///dev/ttyUSB0?wire=rs422", "E210", "is not `rs232` or `rs485`"),
        ("tmcl+serial:///dev/ttyUSB0?echo=maybe", "E210", "is not `yes` or `no`"),
        ("tmcl+serial:///dev/ttyUSB0?timeout=2h", "E210", "is not between 0 and an hour"),
        ("sim:tmcl?time=slow", "E210", "is not `real` or `virtual`"),
        ("tmcl+socketcand://10.0.0.5:29536", "E210", "names no bus"),
        ("tmcl+udp://239.74.163.2", "E210", "has no port number"),
        ("tml+serial:///dev/ttyUSB0#g0", "E210", "`g0` is not a group"),
        ("tml+serial:///dev/ttyUSB0#g1,g1", "E210", "axis g1 twice"),
        ("tml+serial:///dev/ttyUSB0#2147483649", "E210", "is not an axis number"),
        ("tmcl+serial://", "E210", "names no device to open"),
        ("tmcl+tcp://10.0.0.5", "E210", "has no port number"),
        ("tmcl+tcp://:502", "E210", "has no port number"),
        ("/dev/ttyUSB0", "E210", "is not a connection string"),
        ("sim:", "E210", "names no drive"),
        ("tmcl+serial:///dev/ttyUSB0#x", "E210", "`x` is not an axis number"),
        ("tmcl+serial:///dev/ttyUSB0#1,1", "E210", "axis 1 twice"),
        ("tmcl+serial:///dev/ttyUSB0#3-1", "E210", "upwards"),
        ("tmcl+serial:///dev/ttyUSB0#0-256", "E210", "at most 256 axes"),
        ("tmcl+serial:///dev/tty%2", "E210", "two hex digits"),
    ] {
        let error = text.parse::<Url>().unwrap_err();
        assert_eq!(error.code(), code, "{text}: {error}");
        assert!(error.to_string().contains(output), "{text}: {error}");
    }
}
