//! A terminal's output as a picture: text with colour codes in, SVG out.
//!
//! ```console
//! script -qec "polepair demo --headless" /dev/null | cargo xtask picture > docs/images/demo.svg
//! ```

use std::fmt::Write as _;
use std::io::Read as _;

/// Lines shown from the beginning, and from the end; a note replaces the lines between.
const HEAD: usize = 40;
const TAIL: usize = 12;
/// Characters of a line.
const COLUMNS: usize = 104;

const LEFT: f64 = 18.0;
const TOP: f64 = 54.0;
const LINE: f64 = 17.5;
const CHARACTER: f64 = 7.83;

const FAMILY: &str = "ui-monospace, SFMono-Regular, Menlo, Consolas, 'DejaVu Sans Mono', monospace";
const PLAIN: &str = "#c9d1d9";

/// Draws standard input on standard output.
pub fn run() -> Result<(), String> {
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text).map_err(|e| e.to_string())?;
    print!("{}", draw(&text));
    Ok(())
}

fn draw(text: &str) -> String {
    let lines = visible_lines(text);
    let width = LEFT * 2.0 + COLUMNS as f64 * CHARACTER;
    let height = TOP + lines.len() as f64 * LINE;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" \
         width=\"{width:.0}\" height=\"{height:.0}\" role=\"img\">\n\
         <rect width=\"100%\" height=\"100%\" rx=\"8\" fill=\"#0d1117\"/>\n"
    );
    for (n, colour) in ["#ff5f57", "#febc2e", "#28c840"].into_iter().enumerate() {
        let x = LEFT + 18.0 * n as f64;
        let _ = writeln!(svg, "<circle cx=\"{x}\" cy=\"18\" r=\"5\" fill=\"{colour}\"/>");
    }
    let _ = writeln!(svg, "<g font-family=\"{FAMILY}\" font-size=\"13\">");
    for (n, line) in lines.iter().enumerate() {
        let y = TOP + n as f64 * LINE;
        let _ =
            writeln!(svg, "<text x=\"{LEFT}\" y=\"{y}\" fill=\"{PLAIN}\">{}</text>", spans(line));
    }
    svg.push_str("</g>\n</svg>\n");
    svg
}

fn visible_lines(text: &str) -> Vec<String> {
    let all: Vec<String> = text.lines().map(|line| line.trim_end_matches('\r').into()).collect();
    if all.len() <= HEAD + TAIL + 1 {
        return all;
    }
    let left_out = all.len() - HEAD - TAIL;
    let mark = format!("\x1b[2m      … {left_out} lines …\x1b[0m");
    [&all[..HEAD], &[mark], &all[all.len() - TAIL..]].concat()
}

/// One line, its colour codes made into spans.
fn spans(line: &str) -> String {
    let mut out = String::new();
    let mut column = 0;
    for (n, piece) in line.split('\x1b').enumerate() {
        let (code, text) = match piece.strip_prefix('[').filter(|_| n > 0) {
            Some(rest) => {
                rest.split_at(rest.find(|c: char| c.is_alphabetic()).map_or(0, |at| at + 1))
            }
            None => ("", piece),
        };
        let capacity = COLUMNS.saturating_sub(column);
        let cut: String = text.chars().take(capacity).collect();
        column += cut.chars().count();
        // Browsers collapse plain spaces, and columns with them.
        let text = cut.replace('&', "&amp;").replace('<', "&lt;").replace(' ', "\u{a0}");
        match colour(code) {
            Some(colour) if !text.is_empty() => {
                let _ = write!(out, "<tspan fill=\"{colour}\">{text}</tspan>");
            }
            _ => out.push_str(&text),
        }
    }
    out
}

/// The colour that a code such as `[1;32m` asks for.
fn colour(code: &str) -> Option<&'static str> {
    let codes = code.trim_start_matches('[').strip_suffix('m')?;
    codes.split(';').find_map(|code| match code {
        "2" => Some("#8b949e"),
        "31" => Some("#ff7b72"),
        "32" => Some("#56d364"),
        "33" => Some("#e3b341"),
        "34" => Some("#79c0ff"),
        "35" => Some("#d2a8ff"),
        "36" => Some("#39c5cf"),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::{COLUMNS, HEAD, TAIL, draw, spans, visible_lines};

    #[test]
    fn colours_become_spans_and_markup_is_escaped() {
        assert_eq!(
            spans("a \x1b[32m<ok>\x1b[0m b"),
            "a\u{a0}<tspan fill=\"#56d364\">&lt;ok></tspan>\u{a0}b"
        );
        assert_eq!(spans("\x1b[2K\x1b[1mbold"), "bold");
    }

    #[test]
    fn long_output_keeps_its_ends() {
        let text: String = (0..200).map(|n| format!("line {n}\r\n")).collect();
        let lines = visible_lines(&text);
        assert_eq!(lines.len(), HEAD + 1 + TAIL);
        assert_eq!((lines[0].as_str(), lines[HEAD + TAIL].as_str()), ("line 0", "line 199"));
        assert!(lines[HEAD].contains("148 lines"));
    }

    #[test]
    fn long_lines_are_cut_and_the_picture_is_whole() {
        let svg = draw(&"x".repeat(500));
        assert!(svg.contains(&"x".repeat(COLUMNS)) && !svg.contains(&"x".repeat(COLUMNS + 1)));
        assert!(svg.ends_with("</svg>\n"));
    }
}
