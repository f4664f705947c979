//! Node-IDs by layer setting services.

use polepair::Connector;
use polepair::lss::{LssIdentity, LssMaster};
use polepair::scan::{DriveScanner, ScanAddresses};

const BUS: &str = "sim:canopen?axes=2&time=virtual";

fn open() -> LssMaster {
    LssMaster::open(&Connector::default(), BUS).expect("a bus")
}

#[test]
fn devices_without_node_id_are_found_and_get_one() {
    let lss = open();
    let identity = lss.identity_of(2).expect("1018h");
    assert_eq!(
        identity,
        LssIdentity { vendor: 0xFFFF, product: 0x402, revision: 0x10000, serial: 2 }
    );
    assert!(!lss.has_unconfigured().expect("asked"));
    assert_eq!(lss.find_unconfigured().expect("scanned"), None);
    for node in [1, 2] {
        assert!(lss.select(lss.identity_of(node).expect("1018h")).expect("asked"));
        assert_eq!(lss.node_id().expect("asked"), Some(node));
        lss.set_node_id(None).expect("taken away");
        lss.set_bit_rate(250_000).expect("set");
        lss.store().expect("stored");
        lss.leave_configuration().expect("left");
        assert!(lss.node_answers(node).expect("asked"), "until it starts again");
        lss.node(node).expect("a node").raw("nmt reset-communication").expect("sent");
        assert!(!lss.node_answers(node).expect("asked"));
    }
    assert!(lss.has_unconfigured().expect("asked"));
    let mut serials = Vec::new();
    while let Some(found) = lss.find_unconfigured().expect("scanned") {
        serials.push(found.serial);
    }
    serials.sort_unstable();
    assert_eq!(serials, [1, 2], "those in LSS configuration are not found again");
    lss.leave_configuration().expect("left");
    assert!(lss.select(identity).expect("asked"));
    lss.set_node_id(Some(9)).expect("set");
    lss.leave_configuration().expect("left");
    assert!(lss.node_answers(9).expect("asked"));
    assert_eq!(lss.identity_of(9).expect("1018h"), identity);
}

#[test]
fn a_missing_or_ambiguous_name_is_refused() {
    let lss = open();
    let unknown = LssIdentity { vendor: 1, product: 2, revision: 3, serial: 4 };
    assert!(!lss.select(unknown).expect("asked"));
    assert_eq!(lss.select_only_device().expect_err("two").code(), "E220");
    assert_eq!(lss.set_node_id(Some(9)).expect_err("nobody is selected").code(), "E401");
    assert_eq!(lss.set_bit_rate(123_456).expect_err("no rate").code(), "E216");
    assert_eq!(lss.node(128).expect_err("no node-ID").code(), "E212");
    assert!(lss.node_answers(2).expect("asked"));
    for text in ["1,2,3", "1,2,3,x", "1,2,3,4,5", ""] {
        assert!(text.parse::<LssIdentity>().is_err(), "{text}");
    }
    assert_eq!("1, 0x2,3,0X4".parse(), Ok(unknown));
    assert_eq!(unknown.to_string().parse(), Ok(unknown));
    let other = LssMaster::open(&Connector::default(), "sim:tmcl").expect_err("another protocol");
    assert_eq!(other.code(), "E242");
}

#[test]
fn one_device_alone_needs_no_identity() {
    let lss = LssMaster::open(&Connector::default(), "sim:canopen?time=virtual").expect("a bus");
    let identity = lss.select_only_device().expect("one");
    assert_eq!((identity.serial, lss.node_id().expect("asked")), (1, Some(1)));
    assert_eq!(lss.set_node_id(Some(128)).expect_err("refused").code(), "E601");
}

#[test]
fn a_scan_tells_of_a_device_without_node_id() {
    let connector = Connector::default();
    let link = connector.connect_local("sim:canopen?time=virtual").expect("a node");
    let scan = || {
        let mut scanner =
            DriveScanner::on_link(&connector, &link, 0, ScanAddresses::ALL).expect("idle");
        while scanner.next_address(&|| false).expect("asked").is_some() {
            scanner.query_next(&|| false).expect("asked");
        }
        scanner.finish()
    };
    assert!(!scan().has_unconfigured);
    let axis = &link.axes()[0];
    for text in ["lss configuration", "lss node 255", "lss waiting", "nmt reset-communication"] {
        axis.raw(text).expect(text);
    }
    let report = scan();
    assert!(report.has_unconfigured && !report.axes[0].answers, "{report:?}");
}
