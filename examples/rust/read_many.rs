//! Reads many values and counts what came of it: right, wrong, refused or lost.
//!
//! For lines that misbehave. `read_many URL TEXT FACTOR [N]` sends TEXT, in the protocol's own
//! language with `{}` for a number, N times (60); the right answer to number n is FACTOR × n.
//!
//! ```text
//! read_many "tmcl+serial:///dev/ttyUSB0?timeout=100#1" "GAP {}" 1000
//! ```

use std::process::ExitCode;

const NUMBERS: [i64; 6] = [1, 4, 5, 7, 9, 11];

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [url, text, factor, rest @ ..] = words.as_slice() else {
        eprintln!("usage: read_many URL TEXT FACTOR [N]");
        return ExitCode::from(2);
    };
    let many = rest.first().and_then(|word| word.parse().ok()).unwrap_or(60);
    let factor = factor.parse().unwrap_or(1);
    match count(url, text, factor, many) {
        Ok((right, wrong, failed)) => {
            println!("right {right} wrong {wrong} failed {failed}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn count(
    url: &str,
    text: &str,
    factor: i64,
    many: u32,
) -> Result<(u32, u32, u32), polepair::Error> {
    let link = polepair::connect(url)?;
    let axis = &link.axes()[0];
    // TEXT may be a write, and what a write does to an unknown drive nobody knows.
    axis.arm()?;
    let (mut right, mut wrong, mut failed) = (0, 0, 0);
    let mut seed = 1u32;
    for _ in 0..many {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let number = NUMBERS[(seed >> 16) as usize % NUMBERS.len()];
        match axis.raw(&text.replace("{}", &number.to_string())) {
            Ok(value) if value == factor * number => right += 1,
            Ok(value) => {
                eprintln!("{number}: {value}");
                wrong += 1;
            }
            Err(error) => {
                eprintln!("{number}: {error}");
                failed += 1;
            }
        }
    }
    Ok((right, wrong, failed))
}
