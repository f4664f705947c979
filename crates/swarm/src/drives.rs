//! Which drives there are on which wires: a rack file for each seed.

use std::fmt::Write as _;

use polepair_sim::random::{Ppm, Random};

/// A kind of drive on a kind of wire.
#[derive(Debug)]
pub struct Kind {
    /// For people: family and wire.
    pub name: &'static str,
    /// Lines of its `[[link]]`.
    link: &'static str,
    /// Lines of its `[[link.drive]]`.
    drive: &'static str,
    /// The first address.
    first: u32,
    /// Axes on one wire at most.
    axes_max: u64,
    /// Speeds that are asked for, rad/s.
    pub speeds: (u32, u32),
    /// How long it may take from such a speed to stand, ms.
    pub ramp_ms: u32,
    /// Drives answer what starts motion: `done` means that they executed it.
    pub answers: bool,
}

/// One of each family and wire.
pub const KINDS: [Kind; 9] = [
    Kind {
        name: "TMCL serial",
        link: "",
        drive: "profile = \"tmcm-171\"\n",
        first: 1,
        axes_max: 3,
        speeds: (5, 40),
        ramp_ms: 2000,
        answers: true,
    },
    Kind {
        name: "TMCL CAN",
        link: "kind = \"can\"\n",
        drive: "profile = \"tmcm-171\"\n",
        first: 4,
        axes_max: 3,
        speeds: (5, 40),
        ramp_ms: 2000,
        answers: true,
    },
    Kind {
        name: "TML serial",
        link: "protocol = \"tml\"\n",
        drive: "profile = \"technosoft-f514l\"\n",
        first: 1,
        axes_max: 1,
        speeds: (5, 40),
        ramp_ms: 2000,
        answers: true,
    },
    Kind {
        name: "TML CAN",
        link: "protocol = \"tmlcan\"\n",
        drive: "profile = \"technosoft-f514l\"\n",
        first: 5,
        axes_max: 3,
        speeds: (5, 40),
        ramp_ms: 2000,
        answers: false,
    },
    Kind {
        name: "TS Modbus",
        link: "",
        drive: "profile = \"syntron-ts\"\noptions = { variant = \"all\", fn00 = 1 }\n",
        first: 1,
        axes_max: 2,
        speeds: (5, 60),
        ramp_ms: 2000,
        answers: true,
    },
    Kind {
        name: "TS CANopen",
        link: "kind = \"can\"\n",
        drive: "profile = \"syntron-ts-canopen\"\noptions = { variant = \"all\", fn00 = 20, can = \"true\" }\n",
        first: 2,
        axes_max: 3,
        speeds: (5, 60),
        ramp_ms: 2000,
        answers: true,
    },
    Kind {
        name: "CiA 402",
        link: "kind = \"can\"\n",
        drive: "profile = \"cia402\"\n",
        first: 3,
        axes_max: 3,
        speeds: (5, 40),
        ramp_ms: 2000,
        answers: true,
    },
    Kind {
        name: "thruster",
        link: "kind = \"can\"\n",
        drive: "profile = \"thruster\"\n",
        first: 11,
        axes_max: 3,
        speeds: (40, 120),
        ramp_ms: 3000,
        answers: false,
    },
    Kind {
        name: "TechnoCAN",
        link: "kind = \"can\"\nprotocol = \"technocan\"\n",
        drive: "profile = \"technosoft-f514l\"\n",
        first: 5,
        axes_max: 2,
        speeds: (5, 40),
        ramp_ms: 2000,
        answers: false,
    },
];

/// The wires of a world.
#[derive(Debug)]
pub struct Rack {
    /// The rack file.
    pub text: String,
    /// What each axis is, in the order of the bench, and the wire that it is on.
    pub axes: Vec<(&'static Kind, usize)>,
    /// How many wires there are.
    pub wires: usize,
}

impl Rack {
    /// One to three wires with one to three axes each. Most worlds have one wire, which lives faster.
    pub fn random(random: &mut Random) -> Self {
        let wires =
            1 + usize::from(random.chance(Ppm(400_000))) + usize::from(random.chance(Ppm(150_000)));
        let (mut text, mut axes) = (String::new(), Vec::new());
        for wire in 0..wires {
            let kind = &KINDS[random.below(KINDS.len() as u64) as usize];
            let _ = write!(text, "[[link]]\nname = \"w{wire}\"\n{}", kind.link);
            let count =
                if random.chance(Ppm(500_000)) { 1 } else { 1 + random.below(kind.axes_max) };
            for n in 0..count as u32 {
                let address = kind.first + n;
                let _ = write!(text, "[[link.drive]]\naddress = {address}\n{}", kind.drive);
                axes.push((kind, wire));
            }
        }
        Self { text, axes, wires }
    }
}
