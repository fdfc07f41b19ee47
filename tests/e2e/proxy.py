"""A TCP proxy that does to connections what networks do, and what liars do.

with Proxy(farm.listen, flip, count=3) as proxy:
    farm.worker(master=proxy.address)

A fault is a function (link, direction, data) that is called for all bytes of one direction as they
come: "up" towards the target, "down" towards whoever connected. It passes them on by link.pass_on,
or not, and may cut the link. After `count` connections had their fault (None: no end), later ones
are clean, so that whoever reconnects gets through. `proxy.injected` counts faults that happened.
"""
import random
import socket
import struct
import threading
import time

from wire_peer import HEADER, NAMES, decode, frame

PIECE = 65536


class Link:
    """One connection through the proxy."""

    def __init__(self, proxy, client, clean):
        self.proxy, self.clean = proxy, clean
        self.rng = random.Random(proxy.rng.random())
        host, port = proxy.target.rsplit(":", 1)
        server = socket.create_connection((host, int(port)), timeout=5)
        self.socks = {"up": server, "down": client}
        self.seen = {"up": 0, "down": 0}
        self.state = {}  # the fault's own
        self.dead = False
        for sock in self.socks.values():
            sock.settimeout(None)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # The fault strikes once so many bytes went that way: in the hello, or later on.
        self.at = self.rng.choice((1, 20, 200, 2000, 8000)) + self.rng.randrange(16)

    def run(self):
        threads = [threading.Thread(target=self._pump, args=(d,), daemon=True)
                   for d in ("up", "down")]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.cut()

    def _pump(self, direction):
        source = self.socks["down" if direction == "up" else "up"]
        try:
            while not self.dead:
                data = source.recv(PIECE)
                if not data:
                    break
                if self.clean:
                    self.pass_on(direction, data)
                else:
                    self.proxy.fault(self, direction, data)
                self.seen[direction] += len(data)
            self.socks[direction].shutdown(socket.SHUT_WR)
        except OSError:
            self.cut()

    def pass_on(self, direction, data):
        self.socks[direction].sendall(data)

    def struck(self):
        self.proxy.injected += 1

    def cut(self, reset=False):
        """Ends both sides, with a reset or in good order."""
        self.dead = True
        for sock in self.socks.values():
            try:
                if reset:
                    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                sock.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
            sock.close()


class Proxy:
    """Listens on loopback until the block ends."""

    def __init__(self, target, fault, count=None, seed=0):
        self.target, self.fault, self.count = target, fault, count
        self.rng = random.Random(seed)
        self.injected = self.connections = 0
        self.links = []
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = "127.0.0.1:%d" % self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        self.listener.close()
        for link in self.links:
            link.cut()

    def _accept(self):
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            clean = self.count is not None and self.connections >= self.count
            self.connections += 1
            try:
                link = Link(self, client, clean)
            except OSError:  # the target is away: so are we
                client.close()
                continue
            self.links.append(link)
            threading.Thread(target=link.run, daemon=True).start()


# --- Faults --------------------------------------------------------------------------------------


def delay(link, direction, data):
    """Every piece comes late, by up to 60 ms."""
    time.sleep(link.rng.random() * 0.06)
    link.struck()
    link.pass_on(direction, data)


def throttle(link, direction, data):
    """40 kB/s each way."""
    for at in range(0, len(data), 400):
        link.pass_on(direction, data[at:at + 400])
        time.sleep(0.01)
    link.struck()


def split(link, direction, data):
    """Every byte is a segment of its own."""
    for at in range(len(data)):
        link.pass_on(direction, data[at:at + 1])
    link.struck()


def _strikes(link, direction, data):
    """The offset in `data` where the fault of this link strikes, or None; up or down by chance."""
    side = link.state.setdefault("side", link.rng.choice(("up", "up", "down")))
    at = link.at - link.seen[direction]
    return at if side == direction and 0 <= at < len(data) else None


def truncate(link, direction, data):
    """The connection is reset in the middle of a frame."""
    at = _strikes(link, direction, data)
    if at is None:
        link.pass_on(direction, data)
        return
    link.pass_on(direction, data[:at])
    link.struck()
    link.cut(reset=link.rng.random() < 0.5)


def flip(link, direction, data):
    """One bit comes over wrong."""
    at = _strikes(link, direction, data)
    if at is not None:
        data = bytearray(data)
        data[at] ^= 1 << link.rng.randrange(8)
        link.struck()
    link.pass_on(direction, bytes(data))


def duplicate(link, direction, data):
    """The same bytes reach the target by a second connection as well."""
    if direction == "up":
        if "second" not in link.state:
            host, port = link.proxy.target.rsplit(":", 1)
            second = link.state["second"] = socket.create_connection((host, int(port)), timeout=5)
            threading.Thread(target=_swallow, args=(second,), daemon=True).start()
            link.struck()
        try:
            link.state["second"].sendall(data)
        except OSError:
            pass  # the target has hung up on the copy
    link.pass_on(direction, data)


def _swallow(sock):
    try:
        while sock.recv(PIECE):
            pass
    except OSError:
        pass


def half_close(link, direction, data):
    """One direction ends in good order; the other goes on."""
    at = _strikes(link, direction, data)
    if link.state.get("ended") == direction:
        return
    if at is None:
        link.pass_on(direction, data)
        return
    link.pass_on(direction, data[:at])
    link.state["ended"] = direction
    link.socks[direction].shutdown(socket.SHUT_WR)
    link.struck()


def black_hole(link, direction, data):
    """From some byte on nothing arrives any more, either way, and no one is told."""
    if link.state.get("hole"):
        return
    at = _strikes(link, direction, data)
    if at is None:
        link.pass_on(direction, data)
        return
    link.state["hole"] = True
    link.struck()


FAULTS = {f.__name__: f for f in (delay, throttle, split, truncate, flip, duplicate, half_close,
                                  black_hole)}


def whole_frames(link, data):
    """The frames that end within `data`, with what came before of the first; the rest is kept."""
    buffer = link.state.get("buffer", b"") + data
    while len(buffer) >= HEADER.size:
        _, _, kind, _, _, meta, body = HEADER.unpack_from(buffer)
        size = HEADER.size + meta + body
        if len(buffer) < size:
            break
        yield NAMES.get(kind), meta, body, buffer[:size]
        buffer = buffer[size:]
    link.state["buffer"] = buffer


def lie(encode, share=1.0):
    """A fault that puts other pixels into a share of the results; `encode` makes a result's body of
    floats. The frames are as good as any."""
    def fault(link, direction, data):
        if direction == "down":
            link.pass_on(direction, data)
            return
        for name, meta, _, whole in whole_frames(link, data):
            if name == "Result" and link.rng.random() < share:
                fields = decode("Result", whole[HEADER.size:HEADER.size + meta])
                values = [0.25] * (fields["raw_bytes"] // 4)
                whole = frame("Result", encode(values), **fields)
                link.struck()
            link.pass_on(direction, whole)
    return fault
