//! Which act a simulated drive has: the table of the guide "faults on demand".

use polepair::simulate::{ACTS, act_of_value, rack_of_words};
use polepair_core::time::Instant;

/// The guide's table: a drive, and the acts that it has beside those of every drive.
const DRIVES: [(&str, &[&str]); 9] = [
    ("tmcm-171", &["encoder", "hall", "home", "input-1", "input-7", "analog-3"]),
    ("tmcm-170", &["encoder", "hall", "home", "input-1", "analog-3"]),
    (
        "syntron-ts",
        &[
            "encoder",
            "hall",
            "eeprom",
            "home",
            "limit-high",
            "limit-low",
            "input-1",
            "analog-0",
            "pulses",
            "key-0",
        ],
    ),
    (
        "cia402",
        &[
            "encoder",
            "hall",
            "eeprom",
            "home",
            "home-until",
            "limit-high",
            "limit-low",
            "input-1",
            "input-3",
        ],
    ),
    (
        "technosoft-f514l",
        &[
            "encoder",
            "hall",
            "eeprom",
            "sto",
            "home",
            "limit-high",
            "limit-low",
            "input-1",
            "input-6",
            "analog-5",
        ],
    ),
    (
        "tmcm-6110",
        &["home", "limit-high", "limit-low", "input-1", "input-3", "input-4", "input-6", "input-7"],
    ),
    ("thruster", &["eeprom"]),
    ("thruster-servo", &["encoder", "eeprom", "limit-high", "limit-low"]),
    ("thruster-actuator", &["encoder", "eeprom", "limit-high", "limit-low"]),
];
const OF_EVERY_DRIVE: [&str; 6] =
    ["load", "jam", "supply", "ambient", "temperature", "power-cycle"];
const NUMBERED: [&str; 10] = [
    "input-1", "input-3", "input-4", "input-6", "input-7", "analog-0", "analog-3", "analog-4",
    "analog-5", "key-0",
];

#[test]
fn every_drive_has_the_acts_of_the_guide_and_no_others() {
    let plain = ACTS.iter().map(|kind| kind.word).filter(|word| !word.ends_with('N'));
    let words: Vec<&str> = plain.filter(|word| *word != "fault").chain(NUMBERED).collect();
    for (drive, own) in DRIVES {
        let rack = rack_of_words(&[drive], 1).expect("a rack").rack;
        for word in &words {
            let mut device = rack.links[0].drives[0].device(true).expect("a drive");
            let act = act_of_value(word, Some(1.0)).expect("an act");
            let done = device.surroundings().expect("a bench").act(Instant::ZERO, act);
            // Of numbered ones the guide gives the first and the last.
            let between = NUMBERED.contains(word) && !own.contains(word) && done;
            let expected = OF_EVERY_DRIVE.contains(word) || own.contains(word);
            assert!(done == expected || between, "{drive} {word}: {done}");
        }
    }
}
