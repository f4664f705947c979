//! Messages for a bad profile, and the result of a good one.

use super::{BaseProfiles, load_own_file as load, parse, remove_missing, resolve};
use polepair_core::axis::Verb;
use polepair_core::medium::{Parity, SerialLine};
use polepair_core::plan::{Argument, Compare, Operand, ParameterTest, Step};
use polepair_core::profile::{
    Access, AxisKind, Certainty, Encoding, ParameterId, Persistence, Profile, Scale, Signal,
    Watchdog,
};
use polepair_core::units::Unit;

const GOOD: &str = r#"
name = "pump-9"
protocol = "modbus"
title = "Pump 9"
axis = "ratio"
watchdog = { kind = "fixed", after_ms = 250 }
ram = { parameter = "write to", ram = 1, flash = 0 }

[[parameter]]
name = "speed"
symbol = "R 10"
index = 0x10
encoding = "i16"
unit = "rpm"
scale = { factor = 0.5, times = "gear" }
min = -100
max = 100
moves = true

[[parameter]]
name = "gear"
index = 0x11
default = 2
persistence = "unless-ram"
certainty = "inferred"
values = { 0x1 = "low", 2 = "high" }

[[parameter]]
name = "write to"
index = 0x12
max = 1

[[parameter]]
name = "status"
space = "input"
index = 0x10
access = "r"

[[parameter]]
name = "path {n} position"
symbol = "Fn_{index}"
index = 0x208
repeat = { count = 3, stride = 8 }

[[fault]]
code = 4
name = "DRY"
text = "The pump runs dry"

[signals]
velocity = "speed"
target-velocity = "speed"
moving = { parameter = "status", mask = 0x6, equals = 0x2 }

[plans.velocity]
source = "§4"
steps = [
    "require status & 0x1 == 0 else Close the lid",
    "write Speed = {velocity}",
    "write path 2 position = {acceleration?}",
    "until status within-magnitude 3 within 1.5 s",
]
undo = ["write speed = 0"]

[plans.stop]
steps = ["write speed = 0"]
"#;

fn good() -> &'static Profile {
    parse("good.toml", GOOD).unwrap()
}

fn refused(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "{from}");
    parse("bad.toml", &GOOD.replacen(from, to, 1)).unwrap_err().to_string()
}

#[test]
fn a_parameter_is_read_whole() {
    let profile = good();
    assert_eq!((profile.name, profile.family, profile.axis), ("pump-9", "modbus", AxisKind::Ratio));
    assert_eq!(profile.watchdog, Watchdog::Fixed { after_ms: 250 });
    assert_eq!(profile.ram.unwrap().parameter, ParameterId(2));
    let speed = &profile.parameters[0];
    assert_eq!((speed.space, speed.index, speed.encoding), (0, 0x10, Encoding::I16));
    assert_eq!((speed.unit, speed.min, speed.max, speed.moves), (Unit::Rpm, -100, 100, true));
    assert_eq!(speed.scale, Scale { factor: 0.5, times: Some(ParameterId(1)), ..Scale::ONE });
    let gear = &profile.parameters[1];
    assert_eq!((gear.min, gear.max, gear.default), (0, 65535, Some(2)));
    assert_eq!((gear.persistence, gear.certainty), (Persistence::UnlessRam, Certainty::Inferred));
    assert_eq!(gear.values, [(1, "low"), (2, "high")]);
    assert_eq!((profile.parameters[3].space, profile.parameters[3].access), (3, Access::Read));
}

#[test]
fn a_repeated_parameter_counts_from_one_and_shows_its_index() {
    let third = &good().parameters[6];
    assert_eq!((third.name, third.symbol, third.index), ("path 3 position", "Fn_218", 0x218));
}

#[test]
fn plans_and_signals_point_at_parameters() {
    let profile = good();
    let plan = profile.plan(Verb::Velocity).unwrap();
    let lid = ParameterTest { mask: 1, compare: Compare::Equal, value: 0 };
    assert_eq!(
        plan.steps,
        [
            Step::Require { read: ParameterId(3), test: lid, hint: "Close the lid" },
            Step::Write(ParameterId(0), Operand::Argument(Argument::Velocity)),
            Step::Write(ParameterId(5), Operand::OptionalArgument(Argument::Acceleration)),
            Step::Until {
                read: ParameterId(3),
                test: ParameterTest { mask: -1, compare: Compare::Within, value: 3 },
                within_ms: 1500,
                required: true,
            },
        ]
    );
    assert_eq!(plan.undo, [Step::Write(ParameterId(0), Operand::Constant(0))]);
    let moving = profile.signal(Signal::Moving).unwrap();
    assert_eq!((moving.parameter, moving.mask, moving.equals), (ParameterId(3), 6, Some(2)));
    assert!(profile.signal(Signal::TargetVelocity).is_some());
}

#[test]
fn one_of_several_numbers() {
    let text = GOOD.replacen("until status within-magnitude 3", "until status in 1 14", 1);
    let plan = parse("good.toml", &text).unwrap().plan(Verb::Velocity).unwrap();
    let Some(Step::Until { test, .. }) = plan.steps.last() else { panic!("{plan:?}") };
    let passing: Vec<i64> = (-3..70).filter(|raw| test.passes(*raw)).collect();
    assert_eq!(passing, [1, 14]);
    let error = refused("until status within-magnitude 3", "until status in 1 x");
    assert!(error.contains("expected numbers from 0 to 62"), "{error}");
}

#[test]
fn the_same_text_is_kept_once() {
    assert!(std::ptr::eq(good(), good()));
}

#[test]
fn mistakes_name_file_line_column_and_the_nearest_word() {
    for (from, to, output) in [
        ("title", "tilte", "bad.toml:4:1: unknown key `tilte`; did you mean `title`?"),
        (
            "\"modbus\"",
            "\"modbsu\"",
            "bad.toml:3:12: no profile protocol `modbsu`: tmcl or modbus or canopen or tml or \
          thruster; did you mean `modbus`?",
        ),
        ("\"rpm\"", "\"rmp\"", "bad.toml:14:8: `rmp` is none of"),
        (
            "times = \"gear\"",
            "times = \"gaer\"",
            "bad.toml:15:33: no parameter is called `gaer`; \
          did you mean `gear`?",
        ),
        ("{acceleration?}", "{target?}", "`velocity` is never given a `{target}`"),
        ("max = 100", "max = 40000", "`max` is 40000; it must be -32768 to 32767"),
        ("min = -100", "min = 101", "`speed`: min 101 is greater than max 100"),
        ("max = 1\n", "max = 1\ndefault = 7\n", "`write to`: default 7 is not within 0 to 1"),
        ("index = 0x12", "index = 0x11", "`write to` has the space and index of `gear`"),
        ("\"gear\"\nindex", "\"SPEED\"\nindex", "is called as `speed` is"),
        ("\"R 10\"", "\"gear\"", "is called as `speed` is"),
        ("moving = ", "movign = ", "unknown key `movign`; did you mean `moving`?"),
        ("equals = 0x2", "equals = 0x8", "`equals` has bits that `mask` takes away"),
        ("ram = 1", "ram = 2", "2 is not within 0 to 1 of `write to`"),
        ("[plans.velocity]", "[plans.spin]", "unknown key `spin`"),
        ("count = 3", "count = 9999", "`count` is 9999; it must be 1 to 4096"),
        ("stride = 8", "stride = 65000", "repetition 3 is beyond index 65535"),
        ("name = \"DRY\"", "nam = \"DRY\"", "unknown key `nam`; did you mean `name`?"),
        ("axis = \"ratio\"", "axis = 3", "`axis` is an integer; it must be a text"),
        ("name = \"pump-9\"", "", "`name` is missing"),
        ("title = \"Pump 9\"", "title = ", "bad.toml:4:"),
    ] {
        let error = refused(from, to);
        assert!(error.contains(output) || error.ends_with(output), "{from} -> {to}: {error}");
        assert!(error.starts_with("bad.toml:"), "{error}");
    }
}

#[test]
fn a_magnitude_has_its_sign_from_another_parameter() {
    let flow = r#"
[[parameter]]
name = "flow"
index = 0x40
access = "r"
scale = { factor = 0.1, negative = "status & 0x8 == 0x8" }
"#;
    let unsigned = GOOD.replacen("[[fault]]", &format!("{flow}\n[[fault]]"), 1);
    let parse_text = |text: &str| parse("bad.toml", text);
    let profile = parse_text(&unsigned).unwrap();
    let test = ParameterTest { mask: 8, compare: Compare::Equal, value: 8 };
    let scaled = profile.parameters.iter().filter_map(|p| p.scale.negative).collect::<Vec<_>>();
    assert_eq!(scaled, [(ParameterId(3), test)]);
    // A value that is written, or that has a sign of its own, cannot have another one.
    for (from, to) in [("access = \"r\"\nscale", "scale"), ("0x40", "0x40\nencoding = \"i16\"")] {
        let error = parse_text(&unsigned.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.contains("`negative` is for a magnitude that can only be read"), "{error}");
    }
    let error =
        parse_text(&unsigned.replace("negative = \"status", "negative = \"statsu")).unwrap_err();
    assert!(error.to_string().contains("did you mean `status`?"), "{error}");
}

#[test]
fn mistakes_in_steps_point_into_the_text() {
    for (from, to, text) in [
        (
            "write Speed",
            "wriet Speed",
            "bad.toml:59:6: a step cannot begin with `wriet`; \
          did you mean `write`?",
        ),
        (
            "write Speed",
            "write Sped",
            "bad.toml:59:12: no parameter is called `Sped`; \
          did you mean `speed`?",
        ),
        ("{velocity}", "{speed}", "bad.toml:59:20: no command carries `speed`"),
        ("speed = 0\"", "speed = 101\"", "101 is not within -100 to 100 of `speed`"),
        ("write Speed = {velocity}", "write status = 1", "`status` can only be read"),
        ("0x1 == 0 else", "0x1 == 2 else", "nothing that is masked so can be 0x2"),
        ("within 1.5 s", "within 1.5", "expected a time such as `50 ms`, found `1.5`"),
        ("within 1.5 s", "within 2e9 s", "a step waits 0 to 86400000 ms"),
        (" else Close the lid", "", "expected `require TEST else HINT`"),
        ("write Speed = {velocity}", "send 256 1 2", "256 does not fit 8 bits"),
        ("write Speed = {velocity}", "write Speed", "expected `NAME = VALUE`"),
        ("{acceleration?}", "{velocity? as time to 9 rpm}", "`velocity` has no time in which"),
        ("{acceleration?}", "{acceleration? as time to 0 rpm}", "such as `3000 rpm` or"),
        ("{acceleration?}", "{acceleration? as time to velocity}", "found `velocity`"),
    ] {
        let error = refused(from, to);
        assert!(error.contains(text), "{from} -> {to}: {error}");
    }
    let many = "\"read status\", ".repeat(64);
    let error = refused("\"write Speed = {velocity}\",", &many);
    assert!(error.contains("`velocity` has more than 64 steps"), "{error}");
}

#[test]
fn a_file_extends_another_file_of_its_folder() {
    let folder = std::env::temp_dir().join(format!("polepair-extends-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    write("pump-9.toml", GOOD);
    let path = write(
        "pump-10.toml",
        "name = \"pump-10\"\nextends = \"pump-9\"\nremove = [\"path 3 position\"]\n\
         [[parameter]]\nname = \"gear\"\nindex = 0x11\nmax = 9\n\
         [[parameter]]\nname = \"lamp\"\nspace = \"coil\"\nencoding = \"bit\"\nindex = 0\n",
    );
    let profile = load(&path).unwrap();
    assert_eq!((profile.name, profile.title), ("pump-10", "Pump 9"));
    assert_eq!(profile.parameters[1].max, 9);
    assert!(
        profile.find_parameter("lamp").is_some()
            && profile.find_parameter("path 3 position").is_none()
    );
    assert_eq!(profile.parameters[0].scale.times, Some(ParameterId(1)));
    assert!(profile.plan(Verb::Velocity).is_some());

    let path = write("pump-11.toml", "name = \"pump-11\"\nextends = \"pump-8\"\n");
    let error = load(&path).unwrap_err();
    assert_eq!((error.line, error.column), (2, 11));
    assert!(error.reason.starts_with("no profile `pump-8` to extend"), "{error}");

    let path = write("ouroboros.toml", "name = \"ouroboros\"\nextends = \"ouroboros\"\n");
    assert!(load(&path).unwrap_err().reason.contains("extend one another"));
    let shift = "[[shift]]\nfrom = 0\nto = 0x2000\n";
    let path = write("pump-12.toml", &format!("name = \"pump-12\"\nextends = \"pump-9\"\n{shift}"));
    assert!(load(&path).unwrap_err().reason.contains("`shift` needs `count`"));
    let error = load(&folder.join("absent.toml")).unwrap_err();
    assert_eq!(error.line, 0);
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn a_shipped_profile_can_be_extended() {
    for profile in polepair_drives::profiles() {
        let text = format!("name = \"mine\"\nextends = \"{}\"\n", profile.name);
        let mine = parse("mine.toml", &text).unwrap();
        assert_eq!(mine.parameters.len(), profile.parameters.len());
        for (ours, theirs) in mine.plans.iter().zip(profile.plans) {
            assert_eq!(
                (ours.verb, ours.steps, ours.undo),
                (theirs.verb, theirs.steps, theirs.undo)
            );
        }
    }
}

#[test]
fn a_memory_map_gives_addresses_and_types() {
    let base = crate::profile::parse("base.toml", MEMORY).unwrap();
    let names: Vec<_> = base.parameters.iter().map(|p| (p.name, p.index)).collect();
    assert_eq!(
        names,
        [("actual position", 0x228), ("APOS_LD", 0x228), ("gain", 0x25E), ("CSPD", 0x2A0)],
        "in the order of addresses, the described one first"
    );
    let speed = base.parameter(base.find_parameter("cspd").unwrap()).unwrap();
    assert_eq!((speed.encoding, speed.scale.factor), (Encoding::Fixed, 1.0 / 65536.0));
}

const MEMORY: &str = r#"
name = "memory"
protocol = "tml"
map = """
# what a set-up archive holds
FIXED CSPD    @0x02A0
LONG  APOS_LD @0x0228 [rot] # of the load
INT   KPP     @0x025E
LONG  APOS    @0x0228 [rot]
FLOAT ADC     @0xA1C3
UINT  HOME1   @0x3F0029
LONG  ENCRESLONG @0x84C
"""
remove = ["ENCRESLONG", "APOS_LD"]
[[parameter]]
name = "APOS_LD"
index = 0x228
encoding = "i32"
[[parameter]]
name = "actual position"
symbol = "APOS"
about = "Where it is."
index = 0x0228
encoding = "i32"
[[parameter]]
name = "gain"
symbol = "KPP"
index = 0x025E
"#;

#[test]
fn a_map_moves_known_parameters_and_drops_the_others() {
    let text = "name = \"moved\"\nextends = \"technosoft-f514l\"\nmap = \"\"\"\n\
                LONG APOS @0x0A28\nFIXED ASPD @0x022C\nINT IQ @0x230\nLONG TPOS @0x2B2\n\
                FIXED TSPD @0x2B4\nUINT MER @0x8FC\nUINT SRL @0x90E\nUINT MCR @0x309\n\
                ULONG ENCRESLONG @0x84C\nINT MINE @0x366\nLONG CPOS @0x29E\nFIXED CSPD @0x2A0\n\
                FIXED CACC @0x2A2\nFIXED HOMESPD @0x994\nULONG SR32 @0x90E\n\"\"\"\n";
    let moved = crate::profile::parse("moved.toml", text).unwrap();
    let position = moved.parameter(moved.find_parameter("actual position").unwrap()).unwrap();
    assert_eq!((position.symbol, position.index), ("APOS", 0x0A28));
    assert_eq!(moved.find_parameter("KPP"), None);
    assert!(moved.find_parameter("mine").is_some());
}

#[test]
fn a_bad_map_names_its_line() {
    for (line, reason) in [
        ("INT", "a name is missing behind the type"),
        ("WORD KPP @0x025E", "`WORD` is no type"),
        ("INT KPP 0x025E", "`KPP` needs an address: @0x0228"),
        ("INT 9KPP @0x025E", "`9KPP` is no name"),
    ] {
        let text =
            format!("name = \"m\"\nprotocol = \"tml\"\nmap = \"\"\"\n# one\n{line}\n\"\"\"\n");
        let error = crate::profile::parse("m.toml", &text).unwrap_err();
        assert_eq!(error.to_string(), format!("m.toml:3:7: map, line 2: {reason}"));
    }
}

#[test]
fn each_firmware_of_technosoft_has_every_verb_and_reading() {
    let shipped = polepair_drives::profiles().iter().filter(|p| p.family == "technosoft");
    let counts: Vec<_> =
        shipped.map(|p| (p.plans.len(), p.signals.len(), p.faults.len())).collect();
    assert_eq!(counts.len(), 3);
    assert!(counts.iter().all(|count| *count == counts[0]), "{counts:?}");
}

/// A TMCL module with a profile of one verb.
const BARE: &str = r#"
name = "bare"
family = "tmcm17x"
protocol = "tmcl"
[[parameter]]
name = "wanted speed"
index = 2
moves = true
[[parameter]]
name = "true speed"
index = 3
access = "r"
[plans.velocity]
steps = ["send 1 0 {velocity} like wanted speed"]
"#;

#[test]
fn a_familys_own_stop_is_inherited() {
    let profile = parse("bare.toml", BARE).unwrap();
    let stop = profile.plan(Verb::Stop).expect("of the family");
    assert_eq!(
        stop.steps,
        [
            Step::Send { function: 3, index: 0, operand: Operand::Constant(0), like: None },
            Step::Standstill { within_ms: 10_000 },
        ]
    );
    let speed = profile.signal(Signal::Velocity).map(|signal| signal.parameter);
    assert_eq!(speed, Some(ParameterId(1)), "by the names that lie at the same places");
    let blind = BARE.replace("index = 3", "index = 99");
    let profile = parse("blind.toml", &blind).unwrap();
    assert!(profile.plan(Verb::Stop).is_some(), "it is told, though nobody can be asked");
    assert!(profile.signal(Signal::Velocity).is_none());
    let foreign = BARE.replace("family = \"tmcm17x\"", "family = \"nobodys\"");
    let stop = parse("foreign.toml", &foreign).unwrap().plan(Verb::Stop).unwrap();
    assert_eq!(stop.source, "TMCL reference, MST", "that of every module");
}

#[test]
fn no_motion_is_offered_where_there_is_no_stop() {
    let text = GOOD.split("[plans.stop]").next().unwrap();
    let profile = parse("good.toml", text).unwrap();
    assert!(profile.plan(Verb::Velocity).is_none() && profile.plan(Verb::Stop).is_none());
    for profile in polepair_drives::profiles() {
        let moves = profile.plans.iter().any(|plan| plan.verb.needs_arming());
        assert!(!moves || profile.plan(Verb::Stop).is_some(), "{}", profile.name);
    }
}

#[test]
fn blocks_and_fragments_are_skips() {
    let profile = |plans: &str| {
        let text = format!(
            "name = \"drive\"\nprotocol = \"canopen\"\n\
             [[parameter]]\nname = \"speed\"\nindex = 0x60FF\nmoves = true\n\
             [[parameter]]\nname = \"state\"\nindex = 0x6041\naccess = \"r\"\n{plans}"
        );
        parse("drive.toml", &text)
    };
    let steps = |plans: &str| profile(plans).unwrap().plan(Verb::Stop).unwrap().steps;
    let numbered = steps(
        "[plans.stop]\nsteps = [\"skip 4 if state & 1 == 1\", \"skip 1 if state & 2 == 0\", \
         \"write speed = 1\", \"skip 1 without speed\", \"write speed = 2\", \
         \"write speed = 0\", \"until state & 4 == 4 within 1 s\"]",
    );
    let blocks = steps(
        "[fragments]\nslow = [\"if state & 2 != 0\", \"write speed = 1\", \"end\", \
         \"use slower\"]\nslower = [\"with speed\", \"write speed = 2\", \"end\"]\n\
         [plans.stop]\nsteps = [\"unless state & 1 == 1\", \"use slow\", \"end\", \
         \"write speed = 0\", \"until state & 4 == 4 within 1 s\"]",
    );
    assert_eq!(numbered, blocks);
    for (plan, reason) in [
        ("\"if state & 1 == 1\", \"write speed = 0\"", "a block has no `end`"),
        ("\"write speed = 0\", \"end\"", "`end` without `if`"),
        ("\"if state & 1 == 1\", \"end\", \"write speed = 0\"", "a block has 1 to 63 steps"),
        ("\"use slwo\"", "there is no fragment `slwo`; did you mean `slow`?"),
        ("\"use round\"", "the fragment `round` uses itself"),
        ("\"if state within-magnitude 3\", \"end\"", "write `unless` for the opposite"),
        ("\"unlike state & 1 == 1\"", "a step cannot begin with `unlike`"),
    ] {
        let text = format!(
            "[fragments]\nslow = [\"write speed = 1\"]\nround = [\"use round\"]\n\
             [plans.stop]\nsteps = [{plan}]"
        );
        let error = profile(&text).unwrap_err().to_string();
        assert!(error.contains(reason), "{plan}: {error}");
        assert!(error.starts_with("drive.toml:1"), "{plan}: {error}");
    }
}

/// A key that changes nothing is not ignored: its author took it for a change.
#[test]
fn useless_keys_are_refused_with_their_place() {
    for (text, reason) in [
        (
            "name = \"own\"\nextends = \"cia402\"\nprotocol = \"canopen\"\n[fragments]\n\
             powerup = [\"write controlword = 15\"]\n",
            "5:12: no plan of this file, or of the profile that it extends, uses the fragment",
        ),
        (
            "name = \"two\"\nprotocol = \"modbus\"\nmotors = 2\n",
            "1:1: `motors` needs a list: `index = [0x2088, 0x2089]` is one for each",
        ),
        (
            "name = \"two\"\nprotocol = \"thruster\"\nmotors = 3\n",
            "3:10: `motors` is 3: on thruster an address has one",
        ),
    ] {
        let error = parse("drive.toml", text).unwrap_err().to_string();
        assert!(error.contains(&format!("drive.toml:{reason}")), "{error}");
    }
    for protocol in ["tmcl", "canopen"] {
        let text = format!("name = \"two\"\nprotocol = \"{protocol}\"\nmotors = 2\n");
        assert_eq!(parse("drive.toml", &text).unwrap().motors, 2, "{protocol}");
    }
}

#[test]
fn a_plan_loses_the_steps_that_need_what_is_missing() {
    let text = r#"
name = "drive"
protocol = "canopen"
optional = ["torque", "counter"]
[[parameter]]
name = "speed"
index = 0x60FF
moves = true
[[parameter]]
name = "torque"
index = 0x6071
moves = true
[[parameter]]
name = "counter"
index = 0x1019
[[parameter]]
name = "state"
index = 0x6041
access = "r"
[plans.stop]
steps = [
  "skip 3 if state & 1 == 0",
  "write torque = 0",
  "skip 1 without counter",
  "ensure counter = 0",
  "write speed = 0",
  "until state & 2 == 2 within 1 s",
]
[plans.velocity]
steps = ["require state & 4 == 0 else Wait", "write speed = {velocity}"]
[plans.torque]
steps = ["write torque = {torque}"]
"#;
    let without = |names: &[&str]| {
        let mut draft =
            BaseProfiles { folder: None, motor: 0 }.read_draft("drive.toml", text, 0).unwrap();
        draft.parameters.retain(|p| !names.contains(&p.name.as_str()));
        remove_missing(&mut draft);
        resolve::resolve_profile(&draft).unwrap()
    };
    let whole = without(&[]);
    assert_eq!(whole.plan(Verb::Stop).unwrap().steps.len(), 6);
    let poor = without(&["torque", "counter"]);
    let [Step::Write(speed, _), Step::Until { .. }] = *poor.plan(Verb::Stop).unwrap().steps else {
        panic!("{:?}", poor.plan(Verb::Stop));
    };
    assert_eq!(poor.parameter(speed).unwrap().name, "speed");
    assert!(poor.plan(Verb::Velocity).is_some() && poor.plan(Verb::Torque).is_none());
    let some = without(&["counter"]);
    let [Step::Skip { count: 1, .. }, Step::Write(..), Step::Write(..), Step::Until { .. }] =
        *some.plan(Verb::Stop).unwrap().steps
    else {
        panic!("{:?}", some.plan(Verb::Stop));
    };
    let none = without(&["speed"]);
    assert!(none.plan(Verb::Stop).is_none(), "it is not optional: {:?}", none.plan(Verb::Stop));
    assert!(none.plan(Verb::Torque).is_none(), "no motion without a stop");
}

/// A drive whose direction is a bit, whose motions are words of one request, and that counts in 48 bits.
const WORDS: &str = r#"
name = "words"
protocol = "modbus"

[[parameter]]
name = "command"
index = 0x10

[[parameter]]
name = "ramp"
index = 0x20
access = "w"

[[parameter]]
name = "speed"
index = 0x21
access = "w"
unit = "rpm"

[[parameter]]
name = "way"
index = 0x20
encoding = "i48"
access = "w"

[[parameter]]
name = "status"
index = 0x30
access = "r"

[plans.velocity]
steps = [
  "if velocity < 0",
    "write command & 0x30 = 0x20",
  "end",
  "if velocity >= 0",
    "write command & 0x30 = 0x10",
  "end",
  "write together ramp = 100, speed = {|velocity|}",
]

[plans.stop]
steps = ["write command & 3 = 1", "standstill within 10 s"]
"#;

#[test]
fn signs_bits_and_joint_writes_are_steps() {
    let profile = parse("words.toml", WORDS).unwrap();
    let sign =
        |if_negative| Step::SkipBySign { argument: Argument::Velocity, if_negative, count: 1 };
    let bits = |raw| Step::WriteBits { id: ParameterId(0), mask: 0x30, raw };
    static JOINT: [(ParameterId, Operand); 2] = [
        (ParameterId(1), Operand::Constant(100)),
        (ParameterId(2), Operand::Magnitude(Argument::Velocity)),
    ];
    assert_eq!(
        profile.plan(Verb::Velocity).unwrap().steps,
        [sign(false), bits(0x20), sign(true), bits(0x10), Step::WriteTogether(&JOINT),]
    );
    assert_eq!(profile.parameters[3].encoding, Encoding::I48);
    assert_eq!(profile.parameters[3].min, -(1 << 47));
}

#[test]
fn impossible_signs_bits_and_joint_writes_are_refused_with_the_place() {
    for (from, to, reason) in [
        ("velocity < 0", "velocty < 0", "words.toml:33:7: no command carries `velocty`"),
        ("velocity < 0", "target < 0", "`velocity` is never given a `{target}`"),
        ("& 0x30 = 0x20", "& 0x10 = 0x20", "0x20 has bits that are not in the mask 0x10"),
        ("& 0x30 = 0x20", "& 0 = 0", "0x0 has bits that are not in the mask 0x0"),
        (", speed = {|velocity|}", "", "expected `write together NAME = VALUE, NAME = VALUE`"),
        ("{|velocity|}", "{velocity?}", "what is written together has a value in each command"),
        ("ramp = 100, speed", "ramp = 100, way", "`way` is not the next holding register"),
        ("index = 0x21", "index = 0x22", "`speed` is not the next holding register"),
        ("index = 0x21", "index = 0x21\nspace = \"coil\"", "`speed` is not the next holding"),
        (
            "access = \"r\"\n",
            "access = \"r\"\n[[parameter]]\nname = \"twin\"\nindex = 0x30\n",
            "has the space and index of",
        ),
        ("ramp = 100", "ramp = 70000", "70000 is not within 0 to 65535 of `ramp`"),
    ] {
        let text = WORDS.replacen(from, to, 1);
        assert_ne!(text, WORDS, "{from}");
        let error = parse("words.toml", &text).unwrap_err().to_string();
        assert!(error.contains(reason), "{from} -> {to}: {error}");
    }
}

#[test]
fn a_line_from_the_factory_is_read() {
    let with = |line: &str| {
        let text = WORDS.replacen(
            "protocol = \"modbus\"",
            &format!("protocol = \"modbus\"\nline = {line}"),
            1,
        );
        parse("words.toml", &text).map(|profile| profile.line.expect("a line"))
    };
    let full = with("{ baud = 19200, parity = \"even\", stop = 2, bits = 7 }").unwrap();
    assert_eq!(
        (full.baud, full.parity, full.stop_bits, full.data_bits),
        (19_200, Parity::Even, 2, 7)
    );
    assert_eq!(with("{ baud = 38400 }").unwrap(), SerialLine::new_8n1(38_400));
    for (line, reason) in [
        ("{ parity = \"even\" }", "words.toml:4:8: `line` needs a `baud` rate"),
        ("{ baud = 0 }", "`baud`"),
        ("{ baud = 9600, parity = \"evn\" }", "did you mean `even`?"),
        ("{ baud = 9600, stop = 3 }", "`stop`"),
        ("{ baud = 9600, rate = 3 }", "unknown key `rate`"),
    ] {
        let error = with(line).unwrap_err().to_string();
        assert!(error.contains(reason), "{line}: {error}");
    }
}
