"""A worker played by a test: it takes leases, and makes results of a picture that is known.

The wire is the Python one of wire_peer.py. A test file imports what it uses, the fixtures `farm`
and `job` too.
"""
import hashlib
import random
import socket
import struct
import time

import pytest

from farm import Farm, SEED_SCENE, SLOW
from wire_peer import Peer

MASK = (1 << 64) - 1
PRIMES = (0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x85EBCA77C2B2AE63,
          0x27D4EB2F165667C5)
SIDE, SPP, TILE = 64, 4, 16
CELLS = (SIDE // TILE) ** 2


def xxh64(data):
    """XXH64 with seed 0, of which a zstd frame carries the low half."""
    def rotate(x, r):
        return (x << r | x >> (64 - r)) & MASK

    def round_(acc, lane):
        return rotate((acc + lane * PRIMES[1]) & MASK, 31) * PRIMES[0] & MASK

    at, size = 0, len(data)
    if size >= 32:
        acc = [(PRIMES[0] + PRIMES[1]) & MASK, PRIMES[1], 0, -PRIMES[0] & MASK]
        while at + 32 <= size:
            lanes = struct.unpack_from("<4Q", data, at)
            acc = [round_(a, lane) for a, lane in zip(acc, lanes)]
            at += 32
        h = sum(rotate(a, r) for a, r in zip(acc, (1, 7, 12, 18))) & MASK
        for a in acc:
            h = ((h ^ round_(0, a)) * PRIMES[0] + PRIMES[3]) & MASK
    else:
        h = PRIMES[4]
    h = (h + size) & MASK
    while at + 8 <= size:
        h ^= round_(0, struct.unpack_from("<Q", data, at)[0])
        h = (rotate(h, 27) * PRIMES[0] + PRIMES[3]) & MASK
        at += 8
    if at + 4 <= size:
        h ^= struct.unpack_from("<I", data, at)[0] * PRIMES[0] & MASK
        h = (rotate(h, 23) * PRIMES[1] + PRIMES[2]) & MASK
        at += 4
    for byte in data[at:]:
        h ^= byte * PRIMES[4] & MASK
        h = rotate(h, 11) * PRIMES[0] & MASK
    h = (h ^ h >> 33) * PRIMES[1] & MASK
    h = (h ^ h >> 29) * PRIMES[2] & MASK
    return h ^ h >> 32


def zstd_raw(data):
    out = struct.pack("<IBQ", 0xFD2FB528, 0xE4, len(data))
    blocks = [data[i:i + 100000] for i in range(0, len(data), 100000)]
    for i, block in enumerate(blocks):
        out += (len(block) << 3 | (i + 1 == len(blocks))).to_bytes(3, "little") + block
    return out + struct.pack("<I", xxh64(data) & 0xFFFFFFFF)


def tile_encode(values):
    """docs/PROTOCOL.md: four byte planes, each as differences, one zstd frame."""
    raw = struct.pack(f"<{len(values)}f", *values)
    planes = b""
    for plane in range(4):
        column = raw[plane::4]
        planes += bytes((b - a) & 255 for a, b in zip(b"\0" + column[:-1], column))
    return zstd_raw(planes)


class Scripted(Peer):
    """A connection that plays the worker."""

    def __init__(self, farm, threads=2, instance=None, hello=True, **changes):
        host, port = farm.listen.split(":")
        super().__init__(socket.create_connection((host, int(port)), timeout=20 * SLOW))
        self.values = {"protocol_min": 1, "protocol_max": 1, "build_id": "test", "host": "here",
                       "determinism_id": b"d" * 32, "name": "scripted", "threads": threads,
                       "cpu": "none", "instance": instance or random.getrandbits(63) | 1,
                       **changes}
        self.leases = []
        if hello:
            self.send("Hello", **self.values)

    def welcome(self):
        welcome = self.expect("Welcome")
        self.id = welcome["worker_id"]
        return self

    def expect(self, *names, timeout=20.0):
        """As a worker: heartbeats go out while waiting, leases are kept."""
        deadline = time.monotonic() + timeout * SLOW
        while True:
            try:
                m = self.receive(0.4)
            except TimeoutError:
                if time.monotonic() > deadline:
                    raise
                self.beat()
                continue
            if m.type == "Lease" and "Lease" not in names:
                self.leases.append(m)
            elif m.type in names:
                return m
            elif m.type not in ("Heartbeat", "Revoke", "JobEnd", "JobInfo", "ResultAck"):
                raise AssertionError(f"expected {names}, got {m.type} {dict(m)}")

    def beat(self):
        self.send("Heartbeat", sequence=1, sent_us=1, rtt_us=100, busy_threads=0)

    def lease(self, timeout=20.0):
        return self.leases.pop(0) if self.leases else self.expect("Lease", timeout=timeout)

    def drain_messages(self, seconds=0.2):
        """Takes what comes for a while."""
        try:
            while True:
                m = self.receive(seconds)
                if m.type == "Lease":
                    self.leases.append(m)
        except TimeoutError:
            pass


def pixels_of(lease):
    return lease["cell_count"] * TILE * TILE


def block_samples(block):
    assert SPP == 4 and block in (0, 1)
    return 2


def honest(lease, value=0.5, **changes):
    """The fields and body of a result whose every sample is `value`."""
    pixels, samples = pixels_of(lease), block_samples(lease["block"])
    fields = dict(job=lease["job"], cell_begin=lease["cell_begin"], cell_count=lease["cell_count"],
                  block=lease["block"], epoch=lease["epoch"], samples=pixels * samples,
                  rays=pixels * samples * 3, render_us=20000, raw_bytes=pixels * 12)
    body = changes.pop("body", None)
    if body is None:
        body = tile_encode([value * samples] * (pixels * 3))
    fields.update(changes)
    return fields, body


def expected_sha(value=0.5):
    return hashlib.sha256(struct.pack("<f", value) * (SIDE * SIDE * 3)).hexdigest()


def render_all(farm, peer, job, value=0.5):
    """Answers leases honestly until the job is done."""
    number = int(job[1:])
    peer.send("JobReady", job=number, load_seconds=0.1, build_seconds=0.2, received_bytes=10)
    deadline = time.monotonic() + 30 * SLOW
    while farm.job(job)["state"] != "done":
        assert time.monotonic() < deadline, farm.job(job)
        peer.drain_messages(0.05)
        for lease in peer.leases:
            fields, body = honest(lease, value)
            peer.send("Result", body, **fields)
        peer.leases = []
        peer.beat()


@pytest.fixture
def farm(tmp_path):
    with Farm(tmp_path) as made:
        yield made
        assert made.master.process.poll() is None, made.master.log()


@pytest.fixture
def job(farm):
    return farm.submit(SEED_SCENE, "--spp", SPP, "--size", f"{SIDE}x{SIDE}", "--tile", TILE)


def states(farm):
    """What the master says of each worker, by its id."""
    return {w["id"]: w["state"] for w in farm.request("GET", "/api/v1/workers")[1]["items"]}
