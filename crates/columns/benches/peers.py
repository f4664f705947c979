"""Cost of a frame of the bench's logs in `polepair` and in the programs that people use instead, in one run.

    python crates/columns/benches/peers.py [--polepair PATH] [--logs NAME,...] [--frames N] [--rounds N]

Needs `polepair` as it is released, and the peers that are to be compared: can-utils, tshark, and in this Python
python-can and cantools. One that is missing is left out. Each round runs all of them one after the other. A
figure is the least processor time of all rounds, less that of the same command for a log of one line. tshark has
Modbus RTU in a pcap, which `polepair convert` makes of the log, and no dissector for TMCL.
"""

from __future__ import annotations

import argparse
import importlib.util
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[3]
DRIVES = range(1, 17)
READ = "import can, sys\nfor message in can.io.canutils.CanutilsLogReader(sys.argv[1]): pass"
DECODE = """\
import can, cantools, sys
database = cantools.database.load_file(sys.argv[2])
known = {message.frame_id for message in database.messages}
for message in can.io.canutils.CanutilsLogReader(sys.argv[1]):
    if message.arbitration_id in known:
        database.decode_message(message.arbitration_id, message.data)
"""


@dataclass
class Program:
    """A command, in which `{log}` is the log, which is its input as well; and the frames of the log that it gets."""

    name: str
    command: list[str]
    frames: int
    best: float = field(default=float("inf"))

    @property
    def is_there(self) -> bool:
        """Whether it can be run here."""
        return shutil.which(self.command[0]) is not None

    def nanoseconds(self, log: Path, one_line: Path) -> float:
        """Processor time a frame, in nanoseconds."""
        spent = cpu_seconds(self.command, log) - cpu_seconds(self.command, one_line)
        return spent * 1e9 / self.frames


def cpu_seconds(command: list[str], log: Path) -> float:
    """Processor time of a command and all that it starts."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    filled = [part.replace("{log}", str(log)) for part in command]
    with log.open("rb") as lines:
        subprocess.run(filled, stdin=lines, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def dbc() -> str:
    """The mappings of the log for cantools."""
    messages = []
    for node in DRIVES:
        for base, name, signals in (
            (0x180, "TPDO1", ("sw : 0|16@1+", "pos : 16|32@1-", "err : 48|16@1-")),
            (0x280, "TPDO2", ("vel : 0|32@1-", "tq : 32|16@1-")),
            (0x200, "RPDO1", ("cw : 0|16@1+", "tpos : 16|32@1-")),
        ):
            length = 8 if name == "TPDO1" else 6
            messages.append(f"BO_ {base + node} {name}_{node}: {length} M")
            messages += [f' SG_ {signal} (1,0) [0|0] "" M' for signal in signals]
    return 'VERSION ""\nBU_: M\n' + "\n".join(messages) + "\n"


# The protocols of the logs, as `polepair` is told.
LOGS = {
    "mapped": "canopen",
    "unmapped": "canopen",
    "sdo": "canopen",
    "thruster": "thruster",
    "tmcl": "tmcl",
    "modbus": "modbus-rtu",
}
SERIAL = ("tmcl", "modbus")
# The link type of `polepair convert`: a byte of direction before the frame.
RTU = 'uat:user_dlts:"User 0 (DLT=147)","mbrtu","1","","0",""'


def programs(polepair: str, log: str, frames: int, folder: Path) -> list[Program]:
    """All that are compared on a log. The slow ones get a part of it."""
    part = frames // 20
    ours = f"{shlex.quote(polepair)} {{}} --as {LOGS[log]} {{log}}"
    fast = {
        "wc -l": "wc -l {log}",
        "polepair decode": ours.replace("{}", "decode --jobs 1"),
        "polepair decode, protocol detected": f"{shlex.quote(polepair)} decode --jobs 1 {{log}}",
        "polepair summary": ours.replace("{}", "summary"),
    }
    if log not in SERIAL:
        fast |= {"can-utils log2long": "log2long", "can-utils log2asc": "log2asc -I {log} can0"}
    all_programs = [Program(name, shlex.split(line), frames) for name, line in fast.items()]
    if log == "modbus":
        all_programs.append(Program("tshark", ["tshark", "-o", RTU, "-r", "{log}.pcap"], part))
    elif log not in SERIAL:
        canopen = "-d can.subdissector,canopen " if LOGS[log] == "canopen" else ""
        all_programs.append(Program("tshark", shlex.split(f"tshark {canopen}-r {{log}}"), part))
        if importlib.util.find_spec("can"):
            all_programs.append(Program("python-can, read", [sys.executable, "-c", READ, "{log}"], part))
    if log == "mapped" and importlib.util.find_spec("can") and importlib.util.find_spec("cantools"):
        (folder / "drives.dbc").write_text(dbc())
        command = [sys.executable, "-c", DECODE, "{log}", str(folder / "drives.dbc")]
        all_programs.append(Program("python-can and cantools", command, part))
    return [program for program in all_programs if program.is_there]


def write_log(log: str, frames: int, to: Path) -> None:
    """Writes a log of the bench."""
    example = ["cargo", "run", "-q", "--release", "-p", "polepair-columns", "--example", "captures"]
    with to.open("wb") as out:
        subprocess.run([*example, log, str(frames)], cwd=ROOT, stdout=out, check=True)


def compare(polepair: str, log: str, frames: int, rounds: int) -> None:
    """Measures all programs on a log and prints a line for each."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole, part, one_line = folder / "whole.log", folder / "part.log", folder / "line.log"
        write_log(log, frames, whole)
        lines = whole.read_text().splitlines(keepends=True)
        frames = len(lines)
        part.write_text("".join(lines[: frames // 20]))
        one_line.write_text(lines[0])
        if log == "modbus":
            for text in (part, one_line):
                subprocess.run([polepair, "convert", text, f"{text}.pcap"], check=True, capture_output=True)
        compared = programs(polepair, log, frames, folder)
        for _ in range(rounds):
            for program in compared:
                text = whole if program.frames == frames else part
                program.best = min(program.best, program.nanoseconds(text, one_line))
    ours = next(program.best for program in compared if program.name == "polepair decode")
    print(f"{log}, {frames} frames")
    for program in compared:
        print(f"  {program.name:36} {program.best:9.1f} ns a frame {program.best / ours:8.2f} of polepair decode")


def main() -> None:
    """Measures each log that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--polepair", default="polepair", help="the program to measure")
    parser.add_argument("--logs", default=",".join(LOGS), help=f"some of {','.join(LOGS)}")
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    if shutil.which(options.polepair) is None:
        parser.error(f"there is no program {options.polepair}: build it with `cargo build --profile dist -p polepair-cli`")
    logs = options.logs.split(",")
    if unknown := set(logs) - set(LOGS):
        parser.error(f"no log is called {', '.join(sorted(unknown))}")
    for log in logs:
        compare(options.polepair, log, options.frames, options.rounds)


if __name__ == "__main__":
    main()
