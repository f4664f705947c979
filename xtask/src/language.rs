//! The TML language as a page, made from its table: `docs/protocols/tml-language.md`.

use std::fmt::Write as _;

use polepair_core::proto::tml::instruction::{
    Category, CodingCertainty, Form, FormPiece, forms, registers,
};

const HEAD: &str = "\
# The TML language

<!-- Made from the instruction table by `cargo xtask codegen`. Do not edit. -->

What `polepair encode tml`, `tmlcan` and `technocan` read and `decode` writes. One table in the \
program serves both directions, and this page is made from it.

```sh
polepair encode tml \"CPOS = -1000L\" --axis 5
polepair encode technocan \"[G2]{STOP}\" --axis 3
polepair explain tml \"06 0F F0 20 5E 00 05 88\"
```

## How it is written

- Case and spaces do not matter. `;` may end an instruction, `//` begins a comment.
- Numbers are decimal or hexadecimal (`0x`), may be negative, and may end in `L` (32 bits) or `U`. \
A fixed variable takes a decimal number as units (`CSPD = 16.5`, `CSPD = 16`) and a hexadecimal one \
as its raw 32 bits (16.16). In `PVTP` a hexadecimal velocity of up to four digits counts units as \
well, as the vendor's tool has it.
- Variables stand by the name that the drive's profile gives them, or by address: `@0x025E` for 16 \
bits, `@0x0228L` for 32. `NAME(H)` and `NAME(L)` are the halves of a 32-bit variable.
- `a` in the tables is bits 8 to 0 of a variable's address, plus 200 when it lies in 0800-09FF; \
other short addresses lie in 0200-03FF. A variable elsewhere is assigned as `NAME,dm = …`, which \
`NAME = …` becomes by itself; `SRB` becomes `SRBL`; other instructions do not reach it.
- `[5]` is axis 5, `[G2]` group 2, `[G1+3]` two groups, `[G*]` everybody, `[H5]` the host at axis 5.
- `FROM` says who asks or answers. Left out, it is the host that `--host` gives.
- A negative counter of `PVTP` and `PTP` loses its sign, as in the vendor's tool.
- `GOTO`, `CALL` and `CALLS` take an address (`GOTO 0x4012`), or in a [program](../guides/drive-programs.md) a label.
- What the table does not have stays words, in both directions: `.word 0x7777, 0x0001`.

**Certainty.** *verified*: the vendor says so, or frames of real drives show it. *inferred*: one \
source that may be wrong, or the pattern of neighbours. *unknown*: the instruction exists and no \
source gives its opcode; it is refused. Sources: *manual* is the TML communication manual, \
*TML_LIB_light* the vendor's library, *labelled frames* are frames with their text of drives with \
firmware F514L and FA00G (CanDecoderWeb), *decompiler* is a public decompiler of TML programs.
";

/// The page.
pub fn language_page() -> String {
    let mut out = HEAD.to_owned();
    for category in Category::ALL {
        let name = category.name();
        let heading = name[..1].to_uppercase() + &name[1..];
        let _ = write!(out, "\n## {heading}\n\n");
        out.push_str("| text | opcode | words | what it does | certainty | source |\n");
        out.push_str("|---|---|---|---|---|---|\n");
        forms().filter(|form| form.category == category).for_each(|form| write_row(form, &mut out));
    }
    out.push_str("\n## Registers\n\n");
    out.push_str("`polepair explain tml MER 0x0008` tells a value's bits.\n\n");
    out.push_str("| register | what it is for | bits |\n|---|---|---|\n");
    for register in registers() {
        let bits: Vec<String> = register.bits.iter().map(bit_text).collect();
        let _ = writeln!(out, "| {} | {} | {} |", register.name, register.about, bits.join("; "));
    }
    out
}

fn bit_text(bits: &polepair_core::proto::tml::instruction::RegisterField) -> String {
    let location = if bits.high == bits.low {
        bits.low.to_string()
    } else {
        format!("{}-{}", bits.high, bits.low)
    };
    let meaning = match bits.values {
        ["", set] => (*set).to_owned(),
        [clear, set] => format!("{clear} / {set}"),
        _ => bits.name.to_owned(),
    };
    format!("{location} {meaning}").trim_end().to_owned()
}

fn write_row(form: &Form, out: &mut String) {
    let opcode = match form.certainty {
        CodingCertainty::Unknown => String::new(),
        _ => format!("{:04X}{}", form.opcode, opcode_operands(form)),
    };
    let also = if form.alias { " (read only)" } else { "" };
    let fixed: Vec<String> = form.fixed_words.iter().map(|word| format!("{word:04X}")).collect();
    let words = if fixed.is_empty() {
        form.word_count.to_string()
    } else {
        format!("{}: {}", form.word_count, fixed.join(" "))
    };
    let text = form_text(form);
    let (about, certainty, source) = (form.about, form.certainty.name(), form.source.name());
    let _ =
        writeln!(out, "| `{text}`{also} | {opcode} | {words} | {about} | {certainty} | {source} |");
}

/// Operands in the opcode beside the category.
fn opcode_operands(form: &Form) -> String {
    let mut parts = String::new();
    for piece in form.pieces {
        parts.push_str(match piece {
            FormPiece::Near16 | FormPiece::Near32 => " + a",
            FormPiece::Count(..) | FormPiece::Counter => " + n",
            FormPiece::Memory => " + memory × 4",
            FormPiece::MemoryHigh => " + memory × 20",
            FormPiece::Step => " + 80 without +",
            FormPiece::Condition => " + condition",
            FormPiece::FromAxis | FormPiece::AxisNumber => " + axis",
            FormPiece::Inner(_) => " + its words",
            _ => "",
        });
    }
    parts
}

fn form_text(form: &Form) -> String {
    let mut text = String::new();
    let mut word = false;
    for piece in form.pieces {
        let part = operand_text(*piece);
        let from = matches!(piece, FormPiece::From(_) | FormPiece::FromAxis);
        if from || (word && !matches!(piece, FormPiece::Sign(_) | FormPiece::Lines(_))) {
            text.push(' ');
        }
        text.push_str(part);
        word = matches!(piece, FormPiece::Word(_));
    }
    text.replace("  ", " ")
}

const fn operand_text(piece: FormPiece) -> &'static str {
    match piece {
        FormPiece::Word(text) | FormPiece::Sign(text) => text,
        FormPiece::Near16 | FormPiece::Var16(_) => "V16",
        FormPiece::Near32 | FormPiece::Var32(_) => "V32",
        FormPiece::Far16(_) => "V16 beyond",
        FormPiece::Far32(_) => "V32 beyond",
        FormPiece::Pointer(_) => "P",
        FormPiece::Step => "[+]",
        FormPiece::Memory | FormPiece::MemoryHigh => "pm/dm/spi",
        FormPiece::Number(_) | FormPiece::Narrow(_) => "value16",
        FormPiece::Hex(_) => "word",
        FormPiece::Target(_) => "address",
        FormPiece::Long(_) | FormPiece::Wide(_) => "value32",
        FormPiece::Fixed(_) => "fixed",
        FormPiece::High(_) => "value16",
        FormPiece::Count(..) => "n",
        FormPiece::Counter => "counter",
        FormPiece::Condition => "LT/LEQ/EQ/NEQ/GT/GEQ",
        FormPiece::Point => "position, velocity, time",
        FormPiece::Lines(_) => "(lines)",
        FormPiece::Line(_) => "line",
        FormPiece::Groups(_) => "(groups)",
        FormPiece::Axis(_) => "axis",
        FormPiece::From(_) | FormPiece::FromAxis => "FROM axis",
        FormPiece::AxisNumber => "axis",
        FormPiece::Version(_) => "version",
        FormPiece::Inner(_) => "instruction",
    }
}
