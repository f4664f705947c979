//! Which drives there are on which wires: a rack file for each seed.

use std::fmt::Write as _;

use polepair_sim::random::{Ppm, Random};

/// A kind of drive on a kind of wire.
#[derive(Debug)]
pub struct DriveKind {
    /// For people: family and wire.
    pub name: &'static str,
    /// Lines of its `[[link]]`.
    link: &'static str,
    /// Lines of its `[[link.drive]]`.
    drive: &'static str,
    /// The first address.
    pub first_address: u32,
    /// Axes on one wire at most.
    axes_max: u64,
    /// Speeds that are asked for, rad/s.
    pub speeds: (u32, u32),
    /// Longest time from such a speed to standstill, ms.
    pub ramp_ms: u32,
    /// Drives answer what starts motion: `done` means that they executed it.
    pub confirms_motion: bool,
    /// True if its position is measured: a stepper module without an encoder counts the commanded steps.
    pub measures_position: bool,
}

/// One of each family and wire.
pub const DRIVE_KINDS: [DriveKind; 10] = [
    DriveKind {
        name: "TMCL serial",
        link: "",
        drive: "profile = \"tmcm-171\"\n",
        first_address: 1,
        axes_max: 3,
        speeds: (5, 40),
        ramp_ms: 2000,
        confirms_motion: true,
        measures_position: true,
    },
    DriveKind {
        name: "TMCL CAN",
        link: "kind = \"can\"\n",
        drive: "profile = \"tmcm-171\"\n",
        first_address: 4,
        axes_max: 3,
        speeds: (5, 40),
        ramp_ms: 2000,
        confirms_motion: true,
        measures_position: true,
    },
    DriveKind {
        name: "TMCL stepper",
        link: "",
        drive: "profile = \"tmcm-1140\"\n",
        first_address: 1,
        axes_max: 3,
        speeds: (2, 7),
        ramp_ms: 2000,
        confirms_motion: true,
        measures_position: false,
    },
    DriveKind {
        name: "TML serial",
        link: "protocol = \"tml\"\n",
        drive: "profile = \"technosoft-f514l\"\n",
        first_address: 1,
        axes_max: 1,
        speeds: (5, 40),
        ramp_ms: 2000,
        confirms_motion: true,
        measures_position: true,
    },
    DriveKind {
        name: "TML CAN",
        link: "protocol = \"tmlcan\"\n",
        drive: "profile = \"technosoft-f514l\"\n",
        first_address: 5,
        axes_max: 3,
        speeds: (5, 40),
        ramp_ms: 2000,
        confirms_motion: false,
        measures_position: true,
    },
    DriveKind {
        name: "TS Modbus",
        link: "",
        drive: "profile = \"syntron-ts\"\noptions = { variant = \"all\", fn00 = 1 }\n",
        first_address: 1,
        axes_max: 2,
        speeds: (5, 60),
        ramp_ms: 2000,
        confirms_motion: true,
        measures_position: true,
    },
    DriveKind {
        name: "TS CANopen",
        link: "kind = \"can\"\n",
        drive: "profile = \"syntron-ts-canopen\"\noptions = { variant = \"all\", fn00 = 20, can = \"true\" }\n",
        first_address: 2,
        axes_max: 3,
        speeds: (5, 60),
        ramp_ms: 2000,
        confirms_motion: true,
        measures_position: true,
    },
    DriveKind {
        name: "CiA 402",
        link: "kind = \"can\"\n",
        drive: "profile = \"cia402\"\n",
        first_address: 3,
        axes_max: 3,
        speeds: (5, 40),
        ramp_ms: 2000,
        confirms_motion: true,
        measures_position: true,
    },
    DriveKind {
        name: "thruster",
        link: "kind = \"can\"\n",
        drive: "profile = \"thruster\"\n",
        first_address: 11,
        axes_max: 3,
        speeds: (40, 120),
        ramp_ms: 3000,
        confirms_motion: false,
        measures_position: true,
    },
    DriveKind {
        name: "TechnoCAN",
        link: "kind = \"can\"\nprotocol = \"technocan\"\n",
        drive: "profile = \"technosoft-f514l\"\n",
        first_address: 5,
        axes_max: 2,
        speeds: (5, 40),
        ramp_ms: 2000,
        confirms_motion: false,
        measures_position: true,
    },
];

/// The wires of a world.
#[derive(Debug)]
pub struct RandomRack {
    /// The rack file.
    pub text: String,
    /// Kind and wire of each axis, in the order of the bench.
    pub axes: Vec<(&'static DriveKind, usize)>,
    /// Number of wires there are.
    pub wires: usize,
}

impl RandomRack {
    /// One to three wires with one to three axes each. Most worlds have one wire, which lives faster.
    pub fn random(random: &mut Random) -> Self {
        let wires =
            1 + usize::from(random.chance(Ppm(400_000))) + usize::from(random.chance(Ppm(150_000)));
        let (mut text, mut axes) = (String::new(), Vec::new());
        for wire in 0..wires {
            let kind = &DRIVE_KINDS[random.below(DRIVE_KINDS.len() as u64) as usize];
            let _ = write!(text, "[[link]]\nname = \"w{wire}\"\n{}", kind.link);
            let count =
                if random.chance(Ppm(500_000)) { 1 } else { 1 + random.below(kind.axes_max) };
            for n in 0..count as u32 {
                let address = kind.first_address + n;
                let _ = write!(text, "[[link.drive]]\naddress = {address}\n{}", kind.drive);
                axes.push((kind, wire));
            }
        }
        Self { text, axes, wires }
    }
}

/// Draws a speed for a kind of drive, rad/s: both directions.
pub fn random_speed(kind: &DriveKind, random: &mut Random) -> f64 {
    let (min, max) = kind.speeds;
    let speed = random.between(i64::from(min), i64::from(max)) as f64;
    if random.chance(Ppm(500_000)) { speed } else { -speed }
}
