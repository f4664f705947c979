use super::{DataType, Eds, Literal, ObjectAccess, ObjectType, parse};

const SHEET: &str = "\u{FEFF}; a vendor's file\r
[FileInfo]\r
FileName=feeder.eds\r
EDSVersion=4.0\r
[DeviceInfo]\r
VendorName=Some Works\r
BaudRate_500=1\r
[DynamicChannels]\r
NrOfSeg=0\r
[Comments]\r
Lines=1\r
Line1=made by hand = with care\r
[MandatoryObjects]\r
SupportedObjects=2\r
1=0x1000\r
2=0x1018\r
[OptionalObjects]\r
SupportedObjects=1\r
1=0x1400\r
[1000]\r
ParameterName=Device type\r
ObjectType=0x7\r
DataType=0x0007\r
AccessType=ro\r
DefaultValue=0x20192\r
PDOMapping=0\r
[1018]\r
ParameterName=Identity object\r
ObjectType=0x9\r
SubNumber=2\r
[1018sub0]\r
ParameterName=Highest sub-index\r
DataType=0x0005\r
AccessType=const\r
DefaultValue=1\r
[1018SUB1]\r
ParameterName=Vendor-ID\r
ObjectType=0x7\r
DataType=0x0007\r
AccessType=ro\r
LowLimit=\r
Vendor_X=kept\r
[1400]\r
ParameterName=RPDO 1\r
ObjectType=9\r
[1400sub1]\r
ParameterName=COB-ID\r
DataType=7\r
AccessType=RW\r
DefaultValue=0x200+$NODEID\r
[6071]\r
ParameterName=Target torque\r
DataType=0x0003\r
AccessType=rww\r
DefaultValue=0xFFFE\r
LowLimit=-0x3E8\r
HighLimit=1000\r
PDOMapping=1\r
";

fn sheet(text: &str) -> Eds {
    parse("feeder.eds", text).expect(text)
}

fn warnings(eds: &Eds) -> Vec<String> {
    eds.warnings.iter().map(ToString::to_string).collect()
}

#[test]
fn a_vendors_sheet_is_read() {
    let eds = sheet(SHEET);
    assert_eq!(eds.device_info("vendorname"), Some("Some Works"));
    assert_eq!(eds.comments, ["made by hand = with care"]);
    assert_eq!(eds.entry(0x1000, 0).unwrap().default_at(1), Some(0x20192));
    let identity = eds.object(0x1018).unwrap();
    assert_eq!((identity.kind, identity.entries.len()), (ObjectType::Record, 2));
    assert_eq!(identity.entries[1].others, [("Vendor_X".to_owned(), "kept".to_owned())]);
    assert_eq!(eds.entry(0x1400, 1).unwrap().default_at(0x11), Some(0x211));
    assert_eq!(eds.entry(0x1400, 1).unwrap().access, ObjectAccess::Rw);
    let torque = eds.entry(0x6071, 0).unwrap();
    assert_eq!(torque.default_at(1), Some(-2), "the bits of a signed type");
    assert_eq!(torque.low.as_ref().and_then(|low| low.integer(1)), Some(-1000));
    assert_eq!((torque.mappable, torque.data_type), (true, DataType(3)));
    assert_eq!(warnings(&eds), [""; 0]);
}

/// An EDS with the identifiers of one node: python canopen's e35.eds is such a file.
#[test]
fn a_value_of_one_node_belongs_to_no_other() {
    let object = |value: i64| {
        format!(
            "{SHEET}[1014]\r\nParameterName=Emergency\r\nObjectType=7\r\nDataType=7\r\nAccessType=rw\r\n\
             DefaultValue=$NODEID+0x80\r\nParameterValue={value:#X}\r\n"
        )
    };
    let at = |eds: &Eds, node: u8| {
        eds.value_of_any_node(eds.entry(0x1014, 0).unwrap()).unwrap().integer(node)
    };
    let eds = sheet(&object(0xA0));
    assert_eq!((at(&eds, 5), at(&eds, 32)), (Some(0x85), Some(0xA0)));
    assert!(
        warnings(&eds)[0].contains("1014h:0: 0xA0 is one node's value"),
        "{:?}",
        warnings(&eds)
    );
    // A DCF is one node's: what it has otherwise than the factory holds.
    let configured = |value| sheet(&(object(value) + "[DeviceComissioning]\r\nNodeID=0x20\r\n"));
    assert_eq!((at(&configured(0xA0), 5), at(&configured(0x701), 5)), (Some(0x85), Some(0x701)));
    assert_eq!(warnings(&configured(0xA0)), [""; 0]);
}

#[test]
fn what_is_written_is_read_again() {
    let eds = sheet(SHEET);
    let again = sheet(&eds.to_string());
    assert_eq!(again, eds);
    assert_eq!(again.to_string(), eds.to_string());
}

#[test]
fn a_dcf_gives_a_node_and_its_values() {
    let text = format!(
        "{SHEET}ParameterValue=250\r\n[DeviceComissioning]\r\nNodeID=0x11\r\nBaudrate=500\r\n"
    );
    let eds = sheet(&text);
    assert_eq!(eds.node_id(), Some(17));
    let value = eds.entry(0x6071, 0).unwrap().value.clone();
    assert_eq!(value, Some(Literal::Integer { value: 250, plus_node: false, hex: false }));
    assert_eq!(sheet(&eds.to_string()), eds);
    assert_eq!(sheet(&text.replace("0x11\r\nB", "128\r\nB")).node_id(), None);
}

#[test]
fn arrays_may_be_compact() {
    let eds = sheet(
        "[1003]\nParameterName=Error\nObjectType=8\nDataType=7\nAccessType=ro\nCompactSubObj=3\n\
         DefaultValue=5\n[1003Name]\nNrOfEntries=1\n2=Second\n[1003Value]\nNrOfEntries=1\n3=0x9\n",
    );
    let entries = &eds.object(0x1003).unwrap().entries;
    let names: Vec<_> = entries.iter().map(|entry| entry.name.as_str()).collect();
    assert_eq!(names, ["NrOfObjects", "Error1", "Second", "Error3"]);
    assert_eq!(entries[0].default_at(1), Some(3));
    assert_eq!(entries[3].value.as_ref().and_then(|value| value.integer(1)), Some(9));
}

#[test]
fn oddities_are_taken_with_a_warning_that_names_the_line() {
    let eds = sheet(
        "stray\n[OptionalObjects]\n1=0x2000\n2=0x2005\n3=many\n\
         [2000]\nParameterName=A\nDataType=5\nAccessType=read\nDefaultValue=010\n\
         [2001]\nParameterName=B\nDataType=5\nDefaultValue=300\n\
         [2002]\nParameterName=C\n\
         [2003]\nParameterName=D\nObjectType=9\nSubNumber=4\n[2003sub1]\nDataType=5\n\
         [2000]\nParameterName=Again\nDataType=5\nAccessType=ro\nDefaultValue=010\n",
    );
    assert_eq!(
        warnings(&eds),
        [
            "feeder.eds:1:1: `stray` is no `key=value` of a section: left out",
            "feeder.eds:4:1: object 0x2005 is listed and has no section",
            "feeder.eds:5:1: `many` is no index",
            "feeder.eds:14:1: DefaultValue: `300` does not fit into u8: left out",
            "feeder.eds:15:1: `C` has no data type: left out",
            "feeder.eds:17:1: 4 sub-indices are announced, 1 are there",
            "feeder.eds:23:1: [2000] is defined twice: the last definition is used",
            "feeder.eds:27:1: `010` begins with 0: read as octal, 8",
        ]
    );
    assert_eq!(eds.entry(0x2000, 0).unwrap().default_at(1), Some(8));
    assert_eq!(eds.entry(0x2003, 1).unwrap().name, "D 1");
    assert_eq!(eds.objects.len(), 3);
}

#[test]
fn a_file_that_is_no_data_sheet_is_refused() {
    for text in ["", "[1000", "PK\u{3}\u{4}", "[FileInfo]\nFileName=x\n"] {
        let error = parse("x.eds", text).expect_err(text);
        assert_eq!(error.to_string(), "x.eds: no object in it: an EDS has sections such as [1000]");
    }
}

#[test]
fn mutated_sheets_never_panic_and_what_is_read_can_be_written() {
    let mut seed: u64 = 0x9E37_79B9;
    let mut random = |below: usize| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize % below
    };
    let bytes: Vec<u8> = SHEET.bytes().collect();
    for _ in 0..3000 {
        let mut bytes = bytes.clone();
        for _ in 0..=random(6) {
            let at = random(bytes.len());
            match random(3) {
                0 => bytes[at] = b"=[]0xs$\n-9fF"[random(12)],
                1 if at > 0 => {
                    bytes.remove(at);
                }
                _ if at > 0 => bytes.truncate(at),
                _ => {}
            }
        }
        let Ok(text) = String::from_utf8(bytes) else { continue };
        if let Ok(eds) = parse("x.eds", &text) {
            let again = sheet(&eds.to_string());
            assert_eq!(again.objects, eds.objects, "{text}");
        }
    }
}

/// The sheet as a file, while a test lasts.
fn profile_of(name: &str, text: &str) -> &'static polepair_core::profile::Profile {
    let folder = std::env::temp_dir().join(format!("polepair-eds-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(name);
    std::fs::write(&path, text).unwrap();
    let profile = crate::profile_file::load_profile(&path).unwrap();
    std::fs::remove_file(path).unwrap();
    profile
}

#[test]
fn a_sheet_of_a_drive_has_the_verbs_that_its_objects_allow() {
    use polepair_core::axis::Verb;
    use polepair_core::profile::{Encoding, Persistence};
    let objects = [(0x6040, 6, "Controlword", 1), (0x6041, 6, "Statusword", 0)];
    let objects = objects.iter().chain(&[(0x2001, 7, "Gain", 0), (0x2002, 3, "Kick", 1)]);
    let object = |&(index, kind, name, mapped): &(u16, u8, &str, u8)| {
        format!(
            "[{index:04X}]\nParameterName={name}\nDataType={kind}\nAccessType=rw\nPDOMapping={mapped}\n"
        )
    };
    let text = SHEET.to_owned() + &objects.map(object).collect::<String>();
    let profile = profile_of("Feeder 7.eds", &text);
    assert_eq!(
        (profile.name, profile.protocol, profile.title),
        ("feeder-7", "canopen", "Some Works")
    );
    assert!(profile.plan(Verb::Disable).is_some() && profile.plan(Verb::Home).is_none());
    let find = |name| profile.parameter(profile.find_parameter(name).expect(name)).unwrap();
    assert_eq!(find("statusword").index, 0x6041);
    let torque = find("target torque");
    assert_eq!((torque.min, torque.max, torque.default), (-1000, 1000, Some(-2)));
    let gain = find("2001h");
    assert_eq!((gain.name, gain.encoding, gain.moves), ("Gain", Encoding::U32, false));
    assert_eq!((gain.min, gain.max), (0, i64::from(u32::MAX)));
    assert_eq!(gain.persistence, Persistence::Storable);
    assert!(find("Kick").moves, "a PDO may carry it to the drive");
    assert_eq!(find("1400h:1").name, "rpdo 1 identifier");
}

#[test]
fn a_sheet_of_another_device_has_its_objects_alone() {
    let text = SHEET.replace("0x20192", "0x191").replace("Identity object", "Identity");
    let profile = profile_of("io.DCF", &format!("{text}[3000]\nDataType=0x10\n"));
    assert_eq!((profile.name, profile.plans.len()), ("io", 0));
    assert!(profile.find_parameter("3000h").is_none(), "24 bits");
    assert!(profile.find_parameter("vendor id").is_some());
}

/// Each type with limits and a default, as vendors write them.
const TYPED: &str = "[2010]\nParameterName=Gain\nDataType=0x0008 ; REAL32\nAccessType=rw ; both\n\
    LowLimit=-1.5\nHighLimit=2.5\nDefaultValue=0.5\n\
    [2011]\nParameterName=Ratio\nDataType=0x0011\nAccessType=ro\n\
    [2012]\nParameterName=Counter\nDataType=0x001B\nAccessType=ro\n\
    [2013]\nParameterName=Offset\nDataType=0x0015\nAccessType=rw\nDefaultValue=-7 ; counts\n\
    [2014]\nParameterName=Label\nDataType=0x0009\nAccessType=rw\nDefaultValue=a ; b\n\
    [2015]\nParameterName=Log\nDataType=0x000F\nAccessType=ro\n\
    [2016]\nParameterName=Odd\nDataType=0x0010\nAccessType=ro\n";

#[test]
fn objects_of_every_type_are_parameters() {
    use polepair_core::profile::{Access, Encoding};
    let profile = profile_of("typed.eds", &format!("{SHEET}{TYPED}"));
    let find = |name| profile.parameter(profile.find_parameter(name).expect(name)).unwrap();
    let gain = find("Gain");
    assert_eq!((gain.encoding, gain.access), (Encoding::F32, Access::ReadWrite));
    let limits = [gain.min, gain.max, gain.default.unwrap()].map(|raw| gain.encoding.number(raw));
    assert_eq!(limits, [-1.5, 2.5, 0.5]);
    assert_eq!(find("Ratio").encoding, Encoding::F64);
    assert_eq!(find("Counter").encoding, Encoding::U64);
    assert_eq!((find("Offset").encoding, find("Offset").default), (Encoding::I64, Some(-7)));
    assert_eq!(find("Label").encoding, Encoding::Text);
    assert_eq!(find("Log").encoding, Encoding::Bytes);
    assert!(profile.find_parameter("Odd").is_none());
}

#[test]
fn omissions_from_a_data_sheet_are_reported() {
    let folder = std::env::temp_dir().join(format!("polepair-eds-left-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("wide.eds");
    let text = format!("{}{TYPED}", SHEET.trim_start_matches('\u{FEFF}'));
    let mut bytes = vec![0xFF, 0xFE];
    bytes.extend(text.encode_utf16().flat_map(u16::to_le_bytes));
    std::fs::write(&path, bytes).unwrap();
    let eds = super::load(&path).unwrap();
    assert_eq!(eds.objects, sheet(&text).objects, "in UTF-16");
    let warnings = super::sheet_warnings(&path);
    let told: Vec<String> = warnings.iter().map(ToString::to_string).collect();
    assert!(told.iter().any(|told| told.contains("2016h (Odd) has the type i24")), "{told:?}");
    std::fs::remove_dir_all(folder).unwrap();
}
