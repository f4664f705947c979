"""Cost of the Python package, beside the packages that it replaces and beside a floor in C, in one run.

    python crates/python/benches/speed.py [codec] [pty] [capture] [import] [--runs N]

Needs the package as it is released (`maturin develop --release`), gcc, and the peers that are to be
compared: pytrinamic, pymodbus, python-can, cantools. A figure is the best of N runs, which is the
least disturbed; ratios are of runs that stand side by side.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polepair

HERE = Path(__file__).parent
REPLY = bytes.fromhex("010314 0000 0007 000E 0015 001C 0023 002A 0031 0038 003F".replace(" ", ""))


def best(call: Callable[[], object], runs: int, count: int = 20_000) -> float:
    """Nanoseconds of processor time a call, best of the runs."""
    took = []
    for _ in range(runs):
        begin = time.thread_time_ns()
        for _ in range(count):
            call()
        took.append((time.thread_time_ns() - begin) / count)
    return min(took)


def line(what: str, figure: float, unit: str, beside: float | None = None) -> None:
    ratio = "" if beside is None else f"{beside:8.2f} x"
    print(f"  {what:52} {figure:12,.1f} {unit}{ratio}", flush=True)


def optional(module: str) -> Any:
    try:
        return __import__(module, fromlist=["x"])
    except ImportError:
        print(f"  ({module} is not installed)")
        return None


# Codecs -----------------------------------------------------------------------------------------


def crc(frame: bytes) -> bytes:
    total = 0xFFFF
    for byte in frame:
        total ^= byte
        for _ in range(8):
            total = total >> 1 ^ 0xA001 if total & 1 else total >> 1
    return total.to_bytes(2, "little")


def codec(runs: int) -> None:
    print("Modbus RTU: ten registers asked for, the answer decoded, ns")
    reply = REPLY + crc(REPLY)
    ours = polepair.Codec("modbus-rtu", axis=1)

    def mine() -> None:
        request = ours.encode("read registers 0x0100 10")
        assert ours.value(reply, "values", request)[9] == 63

    mine()
    line("polepair.Codec (target 400)", best(mine, runs), "ns")
    if modbus := optional("pymodbus.pdu.register_message"):
        from pymodbus.framer import FramerRTU
        from pymodbus.pdu import DecodePDU

        framer = FramerRTU(DecodePDU(False))

        def theirs() -> None:
            framer.buildFrame(
                modbus.ReadHoldingRegistersRequest(address=0x100, count=10, dev_id=1)
            )
            assert framer.handleFrame(reply, 1, 0)[1].registers[9] == 63

        line("pymodbus", best(theirs, runs, 1000), "ns")
    print("Process data: 16, 32 and 16 bits unpacked, ns")
    layout = polepair.Layout("u16 status, i32 position, u16 error")
    data = layout.pack(0x27, -5, 3)
    assert layout.unpack(data) == (0x27, -5, 3)
    unpack = layout.unpack
    line("polepair.Layout (target 150)", best(lambda: unpack(data), runs, 200_000), "ns")
    line("an empty call", best(lambda: None, runs, 200_000), "ns")
    if cantools := optional("cantools"):
        text = (
            'VERSION ""\nBU_: A\nBO_ 389 TPDO1: 8 A\n SG_ status : 0|16@1+ (1,0) [0|0] "" A\n'
            ' SG_ position : 16|32@1- (1,0) [0|0] "" A\n SG_ error : 48|16@1+ (1,0) [0|0] "" A\n'
        )
        known = cantools.database.load_string(text)
        line("cantools", best(lambda: known.decode_message(389, data), runs, 5000), "ns")


# Round trips ------------------------------------------------------------------------------------


@contextmanager
def responder(floor: Path, kind: str) -> Iterator[str]:
    process = subprocess.Popen([floor, "serve", kind], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
    finally:
        process.kill()
        process.wait()


def median(call: Callable[[], object], count: int) -> float:
    """Median of a call's wall time, ns."""
    for _ in range(50):
        call()
    took = []
    for _ in range(count):
        begin = time.perf_counter_ns()
        call()
        took.append(time.perf_counter_ns() - begin)
    return statistics.median(took)


def ours(path: str, url: str, text: str) -> float:
    with polepair.connect(url.format(path)) as link:
        axis = link.axes[0]
        return median(lambda: axis.raw(text), 3000)


def ours_by_name(path: str, url: str, name: str) -> float:
    with polepair.connect(url.format(path)) as link:
        raw = link.axes[0].params.raw
        return median(lambda: raw[name], 3000)


def pytrinamic(path: str) -> float:
    from pytrinamic.connections.serial_tmcl_interface import SerialTmclInterface

    port = SerialTmclInterface(path)
    took = median(lambda: port.get_axis_parameter(1, 0), 500)
    port.close()
    return took


def pymodbus(path: str) -> float:
    from pymodbus.client import AsyncModbusSerialClient

    async def main() -> float:
        client = AsyncModbusSerialClient(path, baudrate=115200, timeout=1)
        assert await client.connect()
        took = []
        for _ in range(1000):
            begin = time.perf_counter_ns()
            await client.read_holding_registers(0x100, count=1, device_id=1)
            took.append(time.perf_counter_ns() - begin)
        client.close()
        return statistics.median(took)

    return asyncio.run(main())


def pty(runs: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        floor = Path(folder) / "floor"
        subprocess.run(["gcc", "-O2", HERE / "floor.c", "-o", floor, "-lutil"], check=True)
        # A busy machine lets a pseudo-terminal stand still for longer than a drive may take.
        tmcl = "tmcl+serial://{}?gap=0&timeout=5s&profile=tmcm-171#1"
        modbus = "modbus-rtu+serial://{}:115200?gap=0&timeout=5s&profile=syntron-ts#1"
        cases: list[tuple[str, str, int, int, list[tuple[str, Callable[[str], float]]]]] = [
            ("TMCL", "tmcl", 9, 9, [
                ("polepair, params.raw (target 1.3)",
                 lambda path: ours_by_name(path, tmcl, "actual position")),
                ("polepair, raw text", lambda path: ours(path, tmcl, "GAP 1, 0")),
                ("PyTrinamic", pytrinamic),
            ]),
            ("Modbus RTU, one register", "modbus", 8, 7, [
                ("polepair, params.raw (target 1.3)",
                 lambda path: ours_by_name(path, modbus, "Dn_00")),
                ("polepair, raw text", lambda path: ours(path, modbus, "read 0x1000")),
                ("pymodbus, asyncio", pymodbus),
            ]),
        ]
        for title, kind, tx, rx, peers in cases:
            print(f"Round trip over a pseudo-terminal, {title}: median, beside a floor in C")
            for name, measure in peers:
                pairs = []
                for _ in range(runs):
                    with responder(floor, kind) as path:
                        words = [floor, "ask", path, str(tx), str(rx), "3000"]
                        least = float(subprocess.check_output(words))
                    with responder(floor, kind) as path:
                        pairs.append((measure(path), least))
                # The floor swings with the processor's idle states, so ratios of neighbours count.
                pairs.sort(key=lambda pair: pair[0] / pair[1])
                took, least = pairs[len(pairs) // 2]
                line(name, took / 1e3, "us", took / least)
                low, high = (f"{took / least:.2f}" for took, least in (pairs[0], pairs[-1]))
                print(f"  {'':52} floor beside it {least / 1e3:.1f} us, ratios {low} to {high}")


# Captures ---------------------------------------------------------------------------------------


def mappings() -> Iterator[str]:
    """Writes of a master that map three values into each PDO: 16, 32 and 16 bits."""
    for node in range(1, 17):
        for index, objects in [
            (0x1600, (0x6040_0010, 0x607A_0020, 0x6071_0010)),
            (0x1A00, (0x6041_0010, 0x6064_0020, 0x60F4_0010)),
            (0x1A01, (0x6041_0010, 0x606C_0020, 0x6077_0010)),
        ]:
            entries = [(0x2F, 0, 0), *((0x23, sub, it) for sub, it in enumerate(objects, 1)),
                       (0x2F, 0, len(objects))]
            for command, sub, value in entries:
                where = (index.to_bytes(2, "little") + bytes([sub])).hex().upper()
                yield f"{0x600 + node:03X}#{command:02X}{where}{value.to_bytes(4, 'little').hex()}"
                yield f"{0x580 + node:03X}#60{where}00000000"


def log(file: Path, frames: int, mapped: bool) -> None:
    """Sixteen drives at 1 kHz: SYNC, and two PDOs from and one to each. Where they are `mapped`, the
    log begins with how."""
    with file.open("w") as out:
        for frame in mappings() if mapped else ():
            out.write(f"(1699999999.000000) can0 {frame}\n")
        at = 0
        while at < frames:
            for id in [0x80, *(base + node for node in range(1, 17) for base in (0x180, 0x280, 0x200))]:
                data = "" if id == 0x80 else f"3716{at * 2654435761 % 2**32:08X}0000"
                out.write(f"({1_700_000_000 + at * 20e-6:.6f}) can0 {id:03X}#{data}\n")
                at += 1


def capture(runs: int) -> None:
    frames = 1_000_000
    print("A candump log of 1,000,000 frames, ns a frame, wall time and processor time")
    with tempfile.TemporaryDirectory() as folder:
        file, mapped = Path(folder) / "drives.log", Path(folder) / "mapped.log"
        log(file, frames, mapped=False)
        log(mapped, frames, mapped=True)
        count = sum(1 for _ in file.open())

        def frames_only() -> None:
            arrays = polepair.decode(file, protocols="canopen").to_numpy()
            assert len(arrays["t_ns"]) == len(arrays["can_id"]) == len(arrays["seq"]) == count

        def everything() -> None:
            arrays = polepair.decode(file, protocols="canopen").to_numpy()
            assert all(len(arrays[name]) == count for name in arrays)

        def stream() -> None:
            assert len(polepair.decode(file, protocols="canopen").to_arrow()) == count

        def signals() -> None:
            arrays = polepair.decode(mapped, protocols="canopen").to_numpy("signals")
            assert len(arrays["t_ns"]) == len(arrays["axis"]) == len(arrays["value"]) > 3 * count

        for name, call in [
            ("all columns of frames decoded, three to NumPy (target 40)", frames_only),
            ("frames to NumPy: every column, words as str", everything),
            ("frames to pyarrow", stream),
            ("3.6 signals a frame decoded, three columns to NumPy", signals),
        ]:
            took, busy = [], []
            for _ in range(runs):
                begin, worked = time.perf_counter_ns(), time.process_time_ns()
                call()
                took.append((time.perf_counter_ns() - begin) / count)
                busy.append((time.process_time_ns() - worked) / count)
            line(name, min(took), "ns")
            print(f"  {'':52} processor time {min(busy):.1f} ns")
        if can := optional("can"):
            part = file.with_name("part.log")
            part.write_text("".join(file.open().readlines()[:50_000]))
            begin = time.perf_counter_ns()
            read = sum(1 for _ in can.CanutilsLogReader(str(part)))
            line("python-can, read only", (time.perf_counter_ns() - begin) / read, "ns")


def imports(runs: int) -> None:
    print("import polepair, beside an interpreter that imports nothing, ms")
    program = (
        "import time; begin = time.perf_counter(); import polepair; "
        "print(time.perf_counter() - begin)"
    )
    took = [float(subprocess.check_output([sys.executable, "-c", program])) for _ in range(runs * 3)]
    line("import polepair (target 30)", min(took) * 1e3, "ms")


def main() -> None:
    parts = {"codec": codec, "pty": pty, "capture": capture, "import": imports}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*parts, []], help="all if none is named")
    parser.add_argument("--runs", type=int, default=7)
    asked = parser.parse_args()
    for name in asked.parts or parts:
        parts[name](asked.runs)


if __name__ == "__main__":
    main()
