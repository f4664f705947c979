"""Modbus TCP: pymodbus, libmodbus, mbpoll and tshark against our host, our device and our decoder."""

import asyncio
import json
import socket
import struct
import subprocess
from pathlib import Path

import pytest
from conftest import compiled, end, need, polepair, start
from polepair_test_support import wait_until
from pymodbus import FramerType
from pymodbus.client import AsyncModbusTcpClient, ModbusSerialClient, ModbusTcpClient
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
from test_foreign_devices import Server

SPEED, CONTROL_MODE, RAM, INTERNAL_SPEED, ENABLE = 0x1000, 0x00, 0x99, 0x33, 0x38


@pytest.fixture
def drives():
    """The port of a simulated server with drives at units 1 and 5."""
    process, ready = start("modbus-tcp:1,5", "--tcp", "127.0.0.1:0")
    url = ready.split()[-1]
    assert url.startswith("modbus-tcp://127.0.0.1:") and url.endswith("#1,5"), url
    yield int(url.split(":")[2].split("#")[0])
    end(process)


def registers(number, values):
    return SimDevice(number, [SimData(0, values=values, datatype=DataType.REGISTERS)])


def signed(word):
    return word - 0x10000 if word & 0x8000 else word


def test_pymodbus_turns_our_drive(drives):
    with ModbusTcpClient("127.0.0.1", port=drives, timeout=10, retries=0) as client:
        write = lambda address, value: client.write_register(address, value, device_id=5)
        for address, value in [(CONTROL_MODE, 1), (RAM, 1), (INTERNAL_SPEED, 200), (ENABLE, 1)]:
            assert not write(address, value).isError()
        speed = lambda: signed(client.read_holding_registers(SPEED, count=1, device_id=5).registers[0])
        wait_until("the drive turns", speed, lambda rpm: abs(rpm - 200) <= 3)
        assert not write(ENABLE, 0).isError()
        wait_until("the drive stands", speed, lambda rpm: abs(rpm) <= 2)
        refused = client.read_input_registers(0, count=1, device_id=1)
        assert refused.isError() and refused.exception_code == 1
        # The device itself.
        assert client.read_holding_registers(0x3A, count=1, device_id=255).registers == [1]


def test_pymodbus_asks_many_things_at_once(drives):
    async def ask():
        client = AsyncModbusTcpClient("127.0.0.1", port=drives, timeout=10)
        await client.connect()
        wanted = [(unit, address) for unit in (1, 5) for address in (0x3A, 0x3F, 0x00, 0x33)] * 5
        answers = await asyncio.gather(
            *(client.read_holding_registers(at, count=1, device_id=unit) for unit, at in wanted)
        )
        client.close()
        return wanted, [answer.registers[0] for answer in answers]

    wanted, values = asyncio.run(ask())
    factory = {0x3A: None, 0x3F: 9870, 0x00: 2, 0x33: 0}
    assert values == [unit if at == 0x3A else factory[at] for unit, at in wanted]


def test_libmodbus_turns_our_drive(drives):
    program = compiled("libmodbus_client.c", "libmodbus")
    done = subprocess.run(
        [program, "127.0.0.1", str(drives)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0 and "all as expected" in done.stdout, done.stdout + done.stderr


def test_mbpoll(drives):
    need("mbpoll")
    common = ["mbpoll", "-m", "tcp", "-a", "5", "-p", str(drives), "-0", "-1"]
    run = lambda *words: subprocess.run(
        [*common, *words], capture_output=True, text=True, timeout=120, check=False
    )
    wrote = run("-r", "51", "127.0.0.1", "200")
    assert wrote.returncode == 0 and "Written 1 references" in wrote.stdout, wrote.stdout
    read = run("-r", "51", "-c", "1", "127.0.0.1")
    assert "[51]: \t200" in read.stdout, read.stdout


def test_our_host_reads_pymodbuss_server():
    devices = [registers(unit, [100 * unit + n for n in range(50)]) for unit in (1, 3, 7)]
    server = Server(lambda _: ModbusTcpServer(devices, address=("127.0.0.1", 0)))
    link = f"modbus-tcp://127.0.0.1:{server.port}"
    read = polepair("send", f"{link}?profile=modbus#3", "read 7 4").stdout
    assert all(f"= {value}" in read for value in (307, 308, 309, 310)), read
    assert "written" in polepair("send", f"{link}?profile=modbus#7", "write 9 4711", "--arm").stdout
    assert "4711" in polepair("get", f"{link}?profile=modbus#7", "R 9").stdout
    found = polepair("scan", link, "--ids", "1-8", silence=True).stdout.splitlines()
    numbers = [line.split()[0] for line in found if line[:1].isdigit()]
    assert numbers == ["1", "3", "7"], found
    refused = polepair("get", f"{link}?profile=modbus#2", "R 0", check=False)
    assert refused.returncode == 6 and "failure" in refused.stderr, refused.stderr
    server.close()


def test_our_host_reads_libmodbuss_server():
    program = compiled("libmodbus_server.c", "libmodbus")
    with subprocess.Popen([program], stdout=subprocess.PIPE, text=True) as server:
        url = f"modbus-tcp://127.0.0.1:{server.stdout.readline().strip()}?profile=modbus#1"
        read = polepair("get", url, "R 7", "R 42", "--raw").stdout
        assert "= 7" in read and "= 42" in read, read
        assert server.wait(60) == 0


def test_a_server_that_answers_at_every_unit_is_found_once():
    device = registers(0, list(range(50)))
    server = Server(lambda _: ModbusTcpServer(device, address=("127.0.0.1", 0)))
    scan = polepair("scan", f"modbus-tcp://127.0.0.1:{server.port}")
    assert "answers at every address" in scan.stdout + scan.stderr, scan.stdout + scan.stderr
    assert scan.stdout.count("modbus ") == 1, scan.stdout
    server.close()


def test_rtu_in_tcp_is_recognized():
    device = registers(1, list(range(50)))
    server = Server(
        lambda _: ModbusTcpServer(device, framer=FramerType.RTU, address=("127.0.0.1", 0))
    )
    wrong = polepair("get", f"modbus-tcp://127.0.0.1:{server.port}#1", "R 0", check=False, silence=True)
    assert wrong.returncode == 4 and "modbus-rtu+tcp://" in wrong.stderr, wrong.stderr
    server.close()


def test_a_server_of_modbus_tcp_is_named_where_a_serial_server_is_asked():
    server = Server(lambda _: ModbusTcpServer(registers(1, list(range(50))), address=("127.0.0.1", 0)))
    url = f"modbus-rtu+tcp://127.0.0.1:{server.port}#1"
    wrong = polepair("get", url, "R 0", check=False, silence=True)
    assert wrong.returncode == 4 and "`modbus-tcp://`" in wrong.stderr, wrong.stderr
    server.close()


def mbap(transaction, unit, pdu):
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def ask_three_things(port):
    """Sends three requests before it reads an answer."""
    asked = [(7, 1, 0x3A), (8, 5, 0x3A), (9, 1, 0x3F)]
    with socket.create_connection(("127.0.0.1", port)) as client:
        client.sendall(b"".join(mbap(n, unit, bytes([3, 0, at, 0, 1])) for n, unit, at in asked))
        got = b""
        while len(got) < 33:
            got += client.recv(100)


def decoded(capture):
    done = polepair("decode", str(capture), "--format", "jsonl", check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    return [line for line in lines if line.get("bytes")]


def test_a_capture_with_several_open_requests(drives, tmp_path):
    """Frames, transactions and units are those of tshark, and each request has its answer."""
    need("tshark")
    capture = tmp_path / "bench.pcapng"
    words = ["tshark", "-Q", "-i", "lo", "-f", f"tcp port {drives}", "-w", str(capture)]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as sniffer:

        def frames():
            if sniffer.poll() is not None:
                pytest.skip("this machine does not let tshark capture")
            ask_three_things(drives)
            return decoded(capture) if capture.exists() else []

        wait_until("the capture has frames", frames, lambda found: len(found) >= 12, interval=0.5)
        polepair("get", f"modbus-tcp://127.0.0.1:{drives}#5", "Fn_3F", "--raw")
        sniffer.terminate()
    ours = decoded(capture)
    assert {line["protocol"] for line in ours} == {"modbus-tcp"}
    theirs = subprocess.run(
        ["tshark", "-r", str(capture), "-d", f"tcp.port=={drives},mbtcp", "-Y", "mbtcp",
         "-T", "fields", "-e", "mbtcp.trans_id", "-e", "mbtcp.unit_id"],
        capture_output=True, text=True, check=True, timeout=60,
    ).stdout.splitlines()
    columns = [line.split("\t") for line in theirs]
    pairs = [
        (int(transaction), int(unit))
        for transactions, units in columns
        for transaction, unit in zip(transactions.split(","), units.split(","))
    ]
    assert sorted((line["fields"]["transaction"], line["axis"]) for line in ours) == sorted(pairs)
    notices = [notice for line in ours for notice in line.get("notices", [])]
    ends = [notice["outcome"] for notice in notices if notice["notice"] == "exchange"]
    assert len(ends) == len(ours) // 2 and set(ends) == {"done"}, ends


def test_one_request_writes_and_reads(tmp_path):
    """Function 23, as host and as device."""
    server = Server(lambda _: ModbusTcpServer(registers(1, list(range(50))), address=("127.0.0.1", 0)))
    url = f"modbus-tcp://127.0.0.1:{server.port}#1"
    sent = polepair("send", url, "--arm", "write 4 70 71 read 3 3")
    # pymodbus reads what was written just before (MAP 6.17).
    assert "register 0x0003 = 3, register 0x0004 = 70, register 0x0005 = 71" in sent.stdout, sent.stdout
    server.close()

    profile = Path(__file__).resolve().parents[1] / "docs" / "examples" / "delta-vfd-el.toml"
    process, _ = start("--profile", str(profile), "--pty", str(tmp_path / "port"))
    with ModbusSerialClient(str(tmp_path / "port"), timeout=10, retries=0) as client:
        both = lambda **words: client.readwrite_registers(device_id=1, **words)
        answer = both(read_address=0x2000, read_count=2, write_address=0x2001, values=[1234])
        assert answer.registers == [0, 1234], answer
        assert both(read_address=0x2200, read_count=1, write_address=0x2001, values=[5]).exception_code == 2
        assert client.read_holding_registers(0x2001, count=1, device_id=1).registers == [1234]
        assert both(read_address=0x2000, read_count=1, write_address=0x2200, values=[5]).exception_code == 2
    end(process)
