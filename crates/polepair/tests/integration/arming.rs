//! A request in a protocol's own language needs an armed axis if it may move the motor.

use polepair::{Error, LocalAxis, connect_local};

/// A drive, texts that may move or power its motor, and texts that cannot.
const TEXTS: [(&str, &[&str], &[&str]); 8] = [
    (
        "sim:tmcm-171",
        &["SAP 2, 0, 100", "SAP 0, 0, 51200", "SAP 255, 0, 1", "SGP 77, 0, 1", "ROR 0, 100"],
        &["GAP 2, 0", "SAP 6, 0, 20", "SAP 4, 0, 500", "MST 0", "ROR 0, 0"],
    ),
    ("sim:tmcm-1140", &["SAP 2, 0, 100", "SAP 0, 0, 51200"], &["SAP 4, 0, 100", "SAP 140, 0, 5"]),
    ("sim:tmcm-6110", &["SAP 2, 3, 100", "SAP 0, 5, 51200"], &["SAP 6, 4, 50"]),
    (
        "sim:tmcl+can:1",
        &["SAP 2, 0, 100", "SAP 199, 0, 1"],
        &["SAP 6, 0, 20", "SGP 40, 2, 7", "SGP 99, 0, 1"],
    ),
    (
        "sim:modbus-rtu",
        &["write 0x33 100", "write 0x38 1", "write 0x0F00 1"],
        &["read 0x33", "write 0x0C 1000"],
    ),
    (
        "sim:cia402",
        &["write 0x6040:0 u16 0x000F", "write 0x60FF:0 i32 100", "write 0x2077:0 u32 1"],
        &["read 0x6041:0", "write 0x6081:0 u32 1000", "write 0x6083:0 u32 1000"],
    ),
    ("sim:technosoft-f514l", &["UPD", "AXISON", "EREF=100", "EREFT=0x0100"], &["KPP=7", "STOP"]),
    ("sim:thruster", &["VC 300"], &["QP"]),
];

fn open(url: &str) -> LocalAxis {
    let link = connect_local(&format!("{url}?time=virtual"));
    link.unwrap_or_else(|error| panic!("{url}: {error}")).axes()[0].clone()
}

#[test]
fn the_effect_of_a_text_decides_whether_it_needs_an_armed_axis() {
    for (url, moving, harmless) in TEXTS {
        let axis = open(url);
        for text in moving {
            let rehearsed = axis.rehearse_raw(text).unwrap_or_else(|e| panic!("{url} {text}: {e}"));
            assert!(rehearsed.needs_arming, "{url}: {text}");
            let sent = axis.connection().losses();
            let refused = axis.raw(text).expect_err(text);
            assert_eq!(refused.code(), "E219", "{url} {text}: {refused}");
            assert!(matches!(refused, Error::Unsupported { .. }), "{url} {text}: {refused:?}");
            assert_eq!(axis.connection().losses(), sent, "{url} {text}: nothing is sent");
        }
        for text in harmless {
            let rehearsed = axis.rehearse_raw(text).unwrap_or_else(|e| panic!("{url} {text}: {e}"));
            assert!(!rehearsed.needs_arming, "{url}: {text}");
            if let Err(error) = axis.raw(text) {
                assert_ne!(error.code(), "E219", "{url} {text}: {error}");
            }
        }
        axis.arm(true);
        for text in moving {
            if let Err(error) = axis.raw(text) {
                assert_ne!(error.code(), "E219", "{url} {text}: {error}");
            }
        }
        axis.arm(false);
    }
}
