"""TMCL modules as they are in the field: a program of their own, a twin with the same address, USB modules that
answer whatever address is asked.

They know nothing of polepair. `requests` has every request that came: address, opcode, type, motor, value.
"""

import socket
import struct
import threading
import time

OK, WRONG_TYPE, INVALID_VALUE, INVALID_COMMAND = 100, 3, 4, 2
HOST = 2


class Module:
    """A TMCL module with configurable replies, and its motors."""

    def __init__(self, address=1, version=0x270F0130, position=0, motors=1, mirrors=False):
        self.address, self.version, self.motors, self.mirrors = address, version, motors, mirrors
        self.axes = [
            {0: position, 1: position, 2: 0, 3: 0, 4: 1000 + position, 5: 500, 6: 128, 8: 1} for _ in range(motors)
        ]
        self.program, self.stays_running, self.ended = False, False, False
        self.requests = []

    def run_program(self, period=0.3, speed=1000):
        """A program that turns motor 0 again and again."""
        self.program = True

        def run():
            while not self.ended:
                if self.program:
                    self.axes[0][2] = self.axes[0][3] = speed
                time.sleep(period)

        threading.Thread(target=run, daemon=True).start()

    def answer(self, opcode, kind, motor, value):
        """Status and value."""
        if opcode == 136:
            return OK, self.version if kind == 1 else 0
        if opcode == 135:
            return OK, int(self.program or self.stays_running)
        if opcode == 128:
            self.program = False
            return OK, 0
        if self.mirrors:
            motor = 0
        if opcode in (1, 2, 3, 5, 6) and motor >= self.motors:
            return INVALID_VALUE, value
        if opcode == 6:
            axis = self.axes[motor]
            return (OK, axis[kind]) if kind in axis else (WRONG_TYPE, 0)
        if opcode == 5:
            self.axes[motor][kind] = value
            return OK, value
        if opcode in (1, 2, 3):
            speed = {1: value, 2: -value, 3: 0}[opcode]
            self.axes[motor][2] = self.axes[motor][3] = speed
            return OK, value
        if opcode == 10:
            return OK, {66: self.address, 70: HOST, 71: self.address, 76: HOST}.get(kind, 0)
        if opcode in (15, 31):
            return OK, 0
        return INVALID_COMMAND, 0

    def take(self, address, body):
        opcode, kind, motor = body[:3]
        value = struct.unpack(">i", body[3:7])[0]
        self.requests.append((address, opcode, kind, motor, value))
        status, answered = self.answer(opcode, kind, motor, value)
        return bytes([status, opcode]) + struct.pack(">I", answered & 0xFFFFFFFF)


class Server:
    """Listens on a free port; one thread a client."""

    def __init__(self):
        self.socket = socket.create_server(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.closed = False
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self):
        self.closed = True
        self.socket.close()
        for module in self.modules:
            module.ended = True

    def _accept(self):
        while not self.closed:
            try:
                client, _ = self.socket.accept()
            except OSError:
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client):
        try:
            self.serve(client)
        except OSError:
            pass


class SerialLine(Server):
    """One module on a line; `ignores_address` answers in its own name whatever address is asked."""

    def __init__(self, module, ignores_address=False):
        self.modules, self.ignores_address = [module], ignores_address
        super().__init__()
        self.url = f"tmcl+tcp://127.0.0.1:{self.port}"

    def serve(self, client):
        (module,), buffer = self.modules, b""
        while data := client.recv(256):
            buffer += data
            while len(buffer) >= 9:
                frame, buffer = buffer[:9], buffer[9:]
                whole = sum(frame[:8]) & 255 == frame[8]
                if not whole and not self.ignores_address:
                    continue
                if frame[0] != module.address and not self.ignores_address:
                    continue
                body = module.take(frame[0], frame[1:8]) if whole else bytes([1, frame[1], 0, 0, 0, 0])
                reply = bytes([HOST, module.address]) + body
                client.sendall(reply + bytes([sum(reply) & 255]))


class SlcanBus(Server):
    """Modules behind an slcan adapter; each answers so many seconds after the one before."""

    def __init__(self, *modules, delay=0.0):
        self.modules, self.delay = modules, delay
        super().__init__()
        self.url = f"tmcl+slcan://127.0.0.1:{self.port}"

    def serve(self, client):
        lock, buffer = threading.Lock(), b""

        def send(data):
            with lock:
                try:
                    client.sendall(data)
                except OSError:
                    pass

        while data := client.recv(256):
            buffer += data
            while b"\r" in buffer:
                line, buffer = buffer.split(b"\r", 1)
                if not line.startswith(b"t"):
                    send(b"\r")
                    continue
                send(b"z\r")
                identifier, length = int(line[1:4], 16), int(line[4:5], 16)
                body = bytes.fromhex(line[5 : 5 + 2 * length].decode())
                asked = [module for module in self.modules if module.address == identifier]
                for n, module in enumerate(asked):
                    reply = bytes([module.address]) + module.take(identifier, body)
                    said = b"t%03X%d" % (HOST, len(reply)) + reply.hex().upper().encode() + b"\r"
                    if n and self.delay:
                        threading.Timer(n * self.delay, send, [said]).start()
                    else:
                        send(said)
