//! The fuzz targets' bodies on the inputs that are kept in `fuzz/corpus`, then on seeded ones, without
//! cargo-fuzz: what `make soak` does for longer.
//! `POLEPAIR_FUZZ_SECONDS=60 cargo test -p polepair-cli --test commands fuzz::` gives each target a minute.

#[path = "../../../../fuzz/bodies.rs"]
mod bodies;

use std::time::{Duration, Instant};

use polepair_sim::random::Random;

/// Inputs of each target at most; a slow machine tries fewer.
const ROUNDS_MAX: usize = 100_000;
/// The longest input.
const INPUT_MAX: usize = 2_000;
/// Inputs that are kept to go on from.
const KEPT_MAX: usize = 64;

/// Time for each target.
fn budget() -> Duration {
    let seconds = std::env::var("POLEPAIR_FUZZ_SECONDS").ok().and_then(|text| text.parse().ok());
    seconds.map_or(Duration::from_secs(6), Duration::from_secs)
}

/// Prints the input at the end of a body, also after a panic.
struct Tried<'a>(&'a str, &'a [u8]);

impl Drop for Tried<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("{}: {:02X?}\n{:?}", self.0, self.1, String::from_utf8_lossy(self.1));
        }
    }
}

/// Another input out of those there are.
fn mutate(random: &mut Random, stored: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = stored[random.below(stored.len() as u64) as usize].clone();
    for _ in 0..random.between(1, 4) {
        let at = random.below(bytes.len() as u64 + 1) as usize;
        let other = &stored[random.below(stored.len() as u64) as usize];
        match random.below(7) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            1 if at < bytes.len() => bytes[at] = random.next_byte(),
            2 if at < bytes.len() => drop(bytes.remove(at)),
            3 => bytes.insert(at, random.next_byte()),
            4 => bytes.truncate(at),
            5 => {
                bytes.truncate(at);
                bytes.extend(&other[random.below(other.len() as u64 + 1) as usize..]);
            }
            _ => {
                let number =
                    random.pick(&["0", "-1", "65536", "4294967296", "1e99", "\u{e9}", "\n"]);
                bytes.splice(at..at, number.bytes());
            }
        }
    }
    bytes.truncate(INPUT_MAX);
    bytes
}

/// The inputs that cargo-fuzz found and `fuzz/run --keep` stored, by target name.
fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = format!("{}/../../fuzz/corpus/{name}", env!("CARGO_MANIFEST_DIR"));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<_> = entries.map(|entry| entry.path()).collect();
    files.sort();
    files.iter().map(|file| std::fs::read(file).expect("an input")).collect()
}

fn try_target(name: &str) {
    let (name, body, seeds) = bodies::TARGETS.into_iter().find(|t| t.0 == name).expect("a target");
    let mut random = Random::new(1);
    let mut stored: Vec<Vec<u8>> = seeds.iter().map(|seed| seed.to_vec()).collect();
    stored.extend(corpus(name));
    let given = stored.len();
    let end = Instant::now() + budget();
    for round in 0..given + ROUNDS_MAX {
        // Those that are kept are all tried, however slow the machine.
        if round >= given && Instant::now() > end {
            break;
        }
        let input =
            if round < given { stored[round].clone() } else { mutate(&mut random, &stored) };
        let tried = Tried(name, &input);
        body(&input);
        drop(tried);
        // Now and then the seeds are left further behind.
        if stored.len() < given + KEPT_MAX && round % 50 == 0 && !input.is_empty() {
            stored.push(input);
        }
    }
}

macro_rules! targets {
    ($($name:ident),*) => {
        $(#[test]
        fn $name() {
            try_target(stringify!($name));
        })*

        /// A target that is added to the bodies is tried here and has its file for cargo-fuzz.
        #[test]
        fn every_target_is_here() {
            let names = [$(stringify!($name)),*];
            assert_eq!(bodies::TARGETS.map(|target| target.0), names);
            for name in names {
                let file = format!("{}/../../fuzz/fuzz_targets/{name}.rs", env!("CARGO_MANIFEST_DIR"));
                assert!(std::path::Path::new(&file).is_file(), "{file}");
            }
        }
    };
}

targets!(deframe, can, text, host, device, capture, url, profile, setup, session, gateway);
