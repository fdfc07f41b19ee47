"""The worker wire in Python, from docs/PROTOCOL.md alone: frames, messages, a scripted master.

Used by the tests that drive a real tilery-worker. Nothing here is shared with the C code, so that
a mistake in one is seen by the other.
"""
import os
import select
import socket
import struct
import subprocess
import time

HEADER = struct.Struct("<2sBBHHII")
TYPES = {
    "Hello": 1, "Welcome": 2, "Refuse": 3, "Heartbeat": 4, "JobInfo": 5, "JobReady": 6,
    "JobFailed": 7, "JobEnd": 8, "ChunkRequest": 9, "ChunkData": 10, "ChunkMissing": 11,
    "Lease": 12, "Revoke": 13, "Result": 14, "ResultAck": 15, "UnitFailed": 16, "Drain": 17,
    "Goodbye": 18,
}
NAMES = {number: name for name, number in TYPES.items()}
WAITING, BEGUN, RESULT = range(3)  # state of a Held

# Field number -> (name, kind): u varint, b bytes, s string, d double, r repeated string,
# h repeated Held.
FIELDS = {
    "Hello": {1: ("protocol_min", "u"), 2: ("protocol_max", "u"), 3: ("build_id", "s"),
              4: ("determinism_id", "b"), 5: ("name", "s"), 6: ("host", "s"), 7: ("threads", "u"),
              8: ("tags", "r"), 9: ("token", "s"), 10: ("cpu", "s"), 11: ("instance", "u"),
              12: ("last_id", "s"), 13: ("last_farm", "u"), 14: ("held", "h")},
    "Held": {1: ("job", "u"), 2: ("cell_begin", "u"), 3: ("cell_count", "u"), 4: ("block", "u"),
             5: ("epoch", "u"), 6: ("state", "u")},
    "Welcome": {1: ("protocol", "u"), 2: ("worker_id", "s"), 3: ("heartbeat_ms", "u"),
                4: ("farm", "u")},
    "Refuse": {1: ("reason", "u"), 2: ("text", "s")},
    "Heartbeat": {1: ("sequence", "u"), 2: ("sent_us", "u"), 3: ("rtt_us", "u"),
                  4: ("busy_threads", "u"), 5: ("draining", "u")},
    "JobInfo": {1: ("job", "u"), 2: ("package", "b"), 3: ("spec_json", "b")},
    "JobReady": {1: ("job", "u"), 2: ("load_seconds", "d"), 3: ("build_seconds", "d"),
                 4: ("scene_bytes", "u"), 5: ("received_bytes", "u")},
    "JobFailed": {1: ("job", "u"), 2: ("error", "s"), 3: ("text", "s")},
    "JobEnd": {1: ("job", "u")},
    "ChunkRequest": {1: ("sha256", "b")},
    "ChunkData": {1: ("sha256", "b"), 2: ("raw_bytes", "u")},
    "ChunkMissing": {1: ("sha256", "b")},
    "Lease": {1: ("job", "u"), 2: ("cell_begin", "u"), 3: ("cell_count", "u"), 4: ("block", "u"),
              5: ("epoch", "u")},
    "Revoke": {1: ("job", "u"), 2: ("epoch", "u")},
    "Result": {1: ("job", "u"), 2: ("cell_begin", "u"), 3: ("cell_count", "u"), 4: ("block", "u"),
               5: ("epoch", "u"), 6: ("samples", "u"), 7: ("rays", "u"), 8: ("nonfinite", "u"),
               9: ("nonfinite_pixel", "u"), 10: ("nonfinite_sample", "u"), 11: ("render_us", "u"),
               12: ("raw_bytes", "u")},
    "ResultAck": {1: ("job", "u"), 2: ("epoch", "u")},
    "UnitFailed": {1: ("job", "u"), 2: ("epoch", "u"), 3: ("error", "s"), 4: ("text", "s")},
    "Drain": {1: ("reason", "s")},
    "Goodbye": {1: ("reason", "s")},
}


def varint(n):
    out = bytearray()
    while n > 0x7F:
        out.append(n & 0x7F | 0x80)
        n >>= 7
    out.append(n)
    return bytes(out)


def encode(name, values):
    out = b""
    for number, (field, kind) in FIELDS[name].items():
        for value in values.get(field, []) if kind in "rh" else [values.get(field)]:
            if value is None:
                continue
            if kind == "h" and not isinstance(value, bytes):
                value = encode("Held", value)
            if kind == "u":
                out += varint(number << 3) + varint(value)
            elif kind == "d":
                out += varint(number << 3 | 1) + struct.pack("<d", value)
            else:
                data = value.encode() if isinstance(value, str) else value
                out += varint(number << 3 | 2) + varint(len(data)) + data
    return out


def decode(name, data):
    defaults = {"u": 0, "s": "", "b": b"", "d": 0.0}
    out = {f: [] if k in "rh" else defaults[k] for f, k in FIELDS[name].values()}
    at = 0

    def take_varint():
        nonlocal at
        n = shift = 0
        while True:
            byte = data[at]
            at += 1
            n |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return n

    while at < len(data):
        key = take_varint()
        field, kind = FIELDS[name][key >> 3]
        if key & 7 == 0:
            out[field] = take_varint()
        elif key & 7 == 1:
            out[field] = struct.unpack_from("<d", data, at)[0]
            at += 8
        else:
            size = take_varint()
            value = data[at:at + size]
            at += size
            if kind == "r":
                out[field].append(value.decode())
            elif kind == "h":
                out[field].append(decode("Held", value))
            else:
                out[field] = value.decode() if kind == "s" else value
    return out


def frame(name, body=b"", /, **values):
    meta = encode(name, values)
    return HEADER.pack(b"TL", 1, TYPES[name], 0, 0, len(meta), len(body)) + meta + body


class Message(dict):
    """A decoded message: its fields as items, its type as .type, its body as .body."""

    def __init__(self, type_name, values, body):
        super().__init__(values)
        self.type = type_name
        self.body = body


class Closed(Exception):
    """The worker has closed the connection."""


class Peer:
    """One connection with a worker, as the master sees it."""

    def __init__(self, sock):
        self.sock = sock
        self.buffer = b""
        self.hello = None
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, name, body=b"", /, **values):
        self.sock.sendall(frame(name, body, **values))

    def _fill(self, deadline):
        left = deadline - time.monotonic()
        if left <= 0 or not select.select([self.sock], [], [], left)[0]:
            raise TimeoutError("nothing came from the worker")
        data = self.sock.recv(1 << 20)
        if not data:
            raise Closed()
        self.buffer += data

    def receive(self, timeout=10.0):
        deadline = time.monotonic() + timeout
        while True:
            if len(self.buffer) >= HEADER.size:
                magic, version, kind, flags, reserved, meta, body = HEADER.unpack_from(self.buffer)
                assert (magic, version, flags, reserved) == (b"TL", 1, 0, 0), self.buffer[:16]
                size = HEADER.size + meta + body
                if len(self.buffer) >= size:
                    data = self.buffer[HEADER.size:size]
                    self.buffer = self.buffer[size:]
                    name = NAMES[kind]
                    return Message(name, decode(name, data[:meta]), data[meta:])
            self._fill(deadline)

    def expect(self, *names, timeout=20.0):
        """The next message of one of these types; heartbeats are echoed on the way."""
        deadline = time.monotonic() + timeout
        while True:
            m = self.receive(max(0.01, deadline - time.monotonic()))
            if m.type == "Heartbeat":
                self.send("Heartbeat", sequence=m["sequence"], sent_us=m["sent_us"])
                if "Heartbeat" not in names:
                    continue
            if m.type not in names:
                raise AssertionError(f"expected {names}, got {m.type} {dict(m)}")
            return m

    def expect_closed(self, timeout=10.0):
        deadline = time.monotonic() + timeout
        try:
            while True:
                self.receive(max(0.01, deadline - time.monotonic()))
        except (Closed, ConnectionError):
            self.sock.close()

    def shake(self, farm=7, worker_id="w1", heartbeat_ms=1000, protocol=1):
        self.hello = self.expect("Hello")
        self.send("Welcome", protocol=protocol, worker_id=worker_id, heartbeat_ms=heartbeat_ms,
                  farm=farm)
        return self.hello

    def close(self):
        self.sock.close()


class Master:
    """Listens where a worker can find it."""

    def __init__(self, port=0):
        self.sock = socket.socket()
        self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.sock.bind(("127.0.0.1", port))
        self.sock.listen(16)
        self.port = self.sock.getsockname()[1]

    def accept(self, timeout=10.0):
        self.sock.settimeout(timeout)
        sock, _ = self.sock.accept()
        sock.settimeout(timeout)
        return Peer(sock)

    def close(self):
        self.sock.close()


def sanitized():
    """True for a program under AddressSanitizer, whose memory use says nothing."""
    with open(os.path.join(os.environ["TILERY_BIN"], "tilery-worker"), "rb") as f:
        return b"__asan_init" in f.read()


class Worker:
    """A real tilery-worker; killed when the block ends."""

    def __init__(self, port, *args, env=None):
        program = os.path.join(os.environ["TILERY_BIN"], "tilery-worker")
        seen = "TILERY_TEST_LOG" in os.environ  # a level: the worker's log on standard error
        if seen:
            args += ("--log", os.environ["TILERY_TEST_LOG"])
        self.process = subprocess.Popen(
            [program, "--master", f"127.0.0.1:{port}", *args], stdout=subprocess.PIPE,
            stderr=None if seen else subprocess.PIPE, text=True,
            env={**os.environ, **(env or {})})

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def signal(self, number):
        self.process.send_signal(number)

    def wait(self, timeout=20.0):
        """Exit status, standard output, standard error."""
        out, err = self.process.communicate(timeout=timeout)
        return self.process.returncode, out, err

    def alive(self):
        return self.process.poll() is None

    def memory_bytes(self):
        with open(f"/proc/{self.process.pid}/statm", encoding="ascii") as f:
            return int(f.read().split()[1]) * os.sysconf("SC_PAGESIZE")

    def fd_count(self):
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))


class Package:
    """What wire_fixture has written."""

    def __init__(self, folder, side, spp, cells_per_unit):
        program = os.path.join(os.environ["TILERY_BIN"], "wire_fixture")
        subprocess.run([program, folder, str(side), str(spp), str(cells_per_unit)], check=True)
        self.folder = folder
        with open(os.path.join(folder, "index"), encoding="ascii") as f:
            rows = [line.split() for line in f]
        self.sizes = {bytes.fromhex(name): int(size) for name, size in rows}
        self.root = bytes.fromhex(rows[0][0])
        with open(os.path.join(folder, "spec.json"), "rb") as f:
            self.spec = f.read()
        self.units = {}
        for name in sorted(os.listdir(folder)):
            if name.startswith("unit_"):
                with open(os.path.join(folder, name), "rb") as f:
                    self.units[tuple(map(int, name.split("_")[1:]))] = f.read()

    def chunk(self, name):
        with open(os.path.join(self.folder, name.hex() + ".zst"), "rb") as f:
            return f.read()
