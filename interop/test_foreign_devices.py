"""Our Modbus host against pymodbus's server, on a serial port and over TCP."""

import asyncio
import os
import pty
import select
import subprocess
import threading
import tty

import pytest
from conftest import EXAMPLES
from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

READ_MANY = EXAMPLES / "read_many"


class Cable(threading.Thread):
    """Two ptys, joined."""

    def __init__(self):
        super().__init__(daemon=True)
        self.ends = [pty.openpty() for _ in range(2)]
        for end in self.ends:
            for descriptor in end:
                tty.setraw(descriptor)
        self.paths = [os.ttyname(slave) for _, slave in self.ends]
        self.open = True
        self.start()

    def run(self):
        (a, _), (b, _) = self.ends
        while self.open:
            for ready in select.select([a, b], [], [], 0.05)[0]:
                os.write(b if ready == a else a, os.read(ready, 4096))

    def close(self):
        self.open = False
        self.join()
        for end in self.ends:
            for descriptor in end:
                os.close(descriptor)


class Server(threading.Thread):
    """pymodbus's server with registers that hold their own number."""

    def __init__(self, make):
        super().__init__(daemon=True)
        self.make, self.up = make, threading.Event()
        self.start()
        assert self.up.wait(60)

    def run(self):
        asyncio.run(self.serve())

    async def serve(self):
        self.loop, self.end = asyncio.get_running_loop(), asyncio.Event()
        registers = SimData(0, values=list(range(100)), datatype=DataType.REGISTERS)
        self.server = self.make(SimDevice(1, [registers]))
        await self.server.serve_forever(background=True)
        self.up.set()
        await self.end.wait()
        await self.server.shutdown()

    @property
    def port(self):
        return self.server.transport.sockets[0].getsockname()[1]

    def close(self):
        self.loop.call_soon_threadsafe(self.end.set)
        self.join()


def read_many(url, text="read {}", factor="1", many="100"):
    done = subprocess.run(
        [READ_MANY, url, text, factor, many], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip() + done.stderr


@pytest.mark.parametrize("framing", ["rtu", "ascii"])
def test_pymodbus_over_tcp(framing):
    framer = FramerType.RTU if framing == "rtu" else FramerType.ASCII
    server = Server(lambda device: ModbusTcpServer(device, framer=framer, address=("127.0.0.1", 0)))
    url = f"modbus-{framing}+tcp://127.0.0.1:{server.port}?profile=modbus&timeout=5000#1"
    assert read_many(url) == "right 100 wrong 0 failed 0"
    server.close()


@pytest.mark.parametrize("framing", ["rtu", "ascii"])
def test_pymodbus_on_a_serial_port(framing):
    framer = FramerType.RTU if framing == "rtu" else FramerType.ASCII
    cable = Cable()
    server = Server(
        lambda device: ModbusSerialServer(
            device, framer=framer, port=cable.paths[0], baudrate=115200
        )
    )
    url = f"modbus-{framing}+serial://{cable.paths[1]}?profile=modbus&gap=0&timeout=5000#1"
    assert read_many(url) == "right 100 wrong 0 failed 0"
    server.close()
    cable.close()


def test_a_register_that_the_server_does_not_have():
    server = Server(
        lambda device: ModbusTcpServer(device, framer=FramerType.RTU, address=("127.0.0.1", 0))
    )
    url = f"modbus-rtu+tcp://127.0.0.1:{server.port}?profile=modbus&timeout=5000#1"
    output = read_many(url, "read 60000", many="1")
    assert "failed 1" in output and "2" in output, output
    assert read_many(url, many="10") == "right 10 wrong 0 failed 0"
    server.close()
