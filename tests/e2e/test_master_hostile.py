"""Broken and lying workers, and strangers, against a real tilery-master."""
import json
import os
import random
import socket
import struct
import time

import pytest

from farm import SEED_SCENE, SLOW, wait_until
from scripted import (farm, job, CELLS, SIDE, SPP, Scripted, TILE, block_samples, expected_sha,
                      honest, pixels_of, render_all, states, tile_encode)
from wire_peer import Closed, HEADER, frame


def nan_body(lease, bits):
    values = [1.0] * (pixels_of(lease) * 3)
    values[len(values) // 2] = struct.unpack("<f", struct.pack("<I", bits))[0]
    return tile_encode(values)


BAD_RESULTS = {
    "nan": lambda u: dict(body=nan_body(u, 0x7FC00000)),
    "infinite": lambda u: dict(body=nan_body(u, 0x7F800000)),
    "minus-infinite": lambda u: dict(body=nan_body(u, 0xFF800000)),
    "empty": lambda u: dict(body=b""),
    "garbage": lambda u: dict(body=b"\x28\xb5\x2f\xfd" + b"\x55" * 200),
    "cut": lambda u: dict(body=honest(u)[1][:-5]),
    "flipped": lambda u: dict(body=honest(u)[1][:40] + b"\x01" + honest(u)[1][41:]),
    "too-long": lambda u: dict(body=tile_encode([1.0] * (pixels_of(u) * 3 + 3))),
    "too-short": lambda u: dict(body=tile_encode([1.0] * (pixels_of(u) * 3 - 3))),
    "raw-bytes": lambda u: dict(raw_bytes=pixels_of(u) * 12 + 12),
    "samples": lambda u: dict(samples=1),
    "nonfinite": lambda u: dict(nonfinite=1 << 60),
    "nonfinite-place": lambda u: dict(nonfinite=1, nonfinite_pixel=1 << 40),
    "outside": lambda u: dict(cell_begin=CELLS, cell_count=u["cell_count"]),
    "overflow": lambda u: dict(cell_begin=0xFFFFFFFF, cell_count=0xFFFFFFFF),
    "block": lambda u: dict(block=2),
    "job": lambda u: dict(job=77),
}


def send_refused(farm, bad, job, fields, body):
    """Sends a result that nobody takes, and leaves."""
    bad.send("Result", body, **fields)
    try:
        bad.drain_messages(0.3)
    except (Closed, ConnectionError):
        pass
    bad.close()
    assert farm.job(job)["units"]["total"] == 0


@pytest.mark.parametrize("kind", BAD_RESULTS)
def test_bad_result_is_refused(farm, job, kind):
    """None of it reaches the picture; the unit is rendered by somebody else."""
    bad, good = Scripted(farm, threads=1).welcome(), Scripted(farm).welcome()
    bad.send("JobReady", job=1)
    lease = bad.lease()
    send_refused(farm, bad, job, *honest(lease, **BAD_RESULTS[kind](lease)))
    render_all(farm, good, job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert report["samples"] == SIDE * SIDE * SPP
    # Nonsense in itself ends the connection; a foreign job has no report to tell it in.
    if kind not in ("job", "overflow", "nonfinite"):
        assert report["units"]["rejected"] >= 1


# --- The newer options: planes, plans, frames, checks --------------------------------------------

AOVS = "depth,uv,normal"       # centre planes, then means
PLANES = 3 + 1 + 2 + 3


def with_planes(lease, planes, **changes):
    """A result of so many planes, those behind R, G and B zero."""
    pixels, samples = pixels_of(lease), block_samples(lease["block"])
    fields, _ = honest(lease, body=b"", **{"raw_bytes": pixels * 4 * planes, **changes})
    values = [0.5 * samples] * (pixels * min(planes, 3)) + [0.0] * (pixels * max(planes - 3, 0))
    return fields, tile_encode(values)


@pytest.mark.parametrize("planes, changes", [
    (3, {}), (PLANES - 1, {}), (PLANES + 1, {}), (PLANES, {"raw_bytes": 12}), (0, {}),
    (PLANES, {"samples": 1}), (1, {})])
def test_results_with_other_planes_are_refused(farm, planes, changes):
    """A job with AOVs takes results of just its planes."""
    job = farm.submit(SEED_SCENE, "--spp", SPP, "--size", f"{SIDE}x{SIDE}", "--tile", TILE,
                      "--aov", AOVS)
    bad, good = Scripted(farm, threads=1).welcome(), Scripted(farm).welcome()
    bad.send("JobReady", job=1)
    send_refused(farm, bad, job, *with_planes(bad.lease(), planes, **changes))
    good.send("JobReady", job=1)
    while farm.job(job)["state"] != "done":
        good.drain_messages(0.05)
        for lease in good.leases:
            fields, body = with_planes(lease, PLANES)
            good.send("Result", body, **fields)
        good.leases = []
        good.beat()
    assert farm.job(job)["image_sha256"] == expected_sha()
    status, exr = farm.request("GET", f"/api/v1/jobs/{job}/picture.exr?half=1", raw=True)
    assert status == 200 and exr[:4] == b"\x76\x2f\x31\x01"


def test_nan_in_a_plane_is_refused(farm):
    job = farm.submit(SEED_SCENE, "--spp", SPP, "--size", f"{SIDE}x{SIDE}", "--tile", TILE,
                      "--aov", AOVS)
    peer = Scripted(farm, threads=1).welcome()
    peer.send("JobReady", job=1)
    lease = peer.lease()
    pixels = pixels_of(lease)
    fields, _ = with_planes(lease, PLANES)
    peer.send("Result", tile_encode([1.0] * (pixels * (PLANES - 1)) + [float("nan")] * pixels),
              **fields)
    wait_until(lambda: farm.job(job)["units"]["rejected"] == 1, "the refusal")
    assert farm.job(job)["units"]["total"] == 0


def test_verified_units_of_a_frame(farm):
    """A frame whose every unit is checked: one worker's word is not enough, and a lie is found."""
    folder = farm.folder
    scene = json.loads(open(SEED_SCENE, encoding="utf-8").read())
    for item in scene["objects"]:
        if "path" in item:
            item["path"] = os.path.join(os.path.dirname(str(SEED_SCENE)), item["path"])
    for number in (3, 4):
        with open(f"{folder}/shot.{number}.json", "w", encoding="utf-8") as file:
            json.dump(scene, file)
    done = farm.cli("submit", f"{folder}/shot.#.json", "--frames", "3-4", "--spp", SPP, "--size",
                    f"{SIDE}x{SIDE}", "--tile", TILE, "--verify", "1")
    assert done.returncode == 0, done.stderr
    first = Scripted(farm, threads=1).welcome()
    first.send("JobReady", job=1)
    lease = first.lease()
    fields, body = honest(lease, 0.75)  # lies
    first.send("Result", body, **fields)
    peers = [first] + [Scripted(farm, threads=1).welcome() for _ in range(3)]
    deadline = time.monotonic() + 60 * SLOW
    while any(farm.job(f"j{n}")["state"] != "done" for n in (1, 2)):
        assert time.monotonic() < deadline, farm.job("j1")
        for peer in peers:
            for number in (1, 2):
                peer.send("JobReady", job=number)
            peer.drain_messages(0.03)
            for one in peer.leases:
                fields, body = honest(one, 0.75 if peer is first else 0.5)
                peer.send("Result", body, **fields)
            peer.leases = []
            peer.beat()
    for number in (1, 2):
        report = farm.job(f"j{number}")
        assert report["image_sha256"] == expected_sha(0.5)
        assert report["units"]["verified"] > 0 and report["frame"] == number + 2
    assert states(farm)[first.id] == "set-aside"


def test_liar_is_found(farm, job):
    """A worker whose bits differ from those of two others is set aside; its work starts again."""
    liar = Scripted(farm, threads=1).welcome()
    liar.send("JobReady", job=1)
    lease = liar.lease()
    fields, body = honest(lease, 0.75)
    liar.send("Result", body, **fields)
    liar.expect("ResultAck")
    # Another one has the same unit: a late duplicate is compared.
    peers = [Scripted(farm, threads=1).welcome() for _ in range(3)]
    for peer in peers:
        peer.send("JobReady", job=1)
    fields, body = honest(lease, 0.5)
    peers[0].send("Result", body, **fields)
    deadline = time.monotonic() + 30 * SLOW
    while farm.job(job)["state"] != "done" and time.monotonic() < deadline:
        for peer in [liar] + peers:
            peer.drain_messages(0.03)
            peer.beat()
            for one in peer.leases:
                fields, body = honest(one, 0.75 if peer is liar else 0.5)
                peer.send("Result", body, **fields)
            peer.leases = []
    report = farm.job(job)
    assert report["state"] == "done", report
    assert report["image_sha256"] == expected_sha(0.5)
    assert any("lied" in e["text"] for e in report["events"]), report["events"]
    assert states(farm)[liar.id] == "set-aside"


@pytest.mark.parametrize("seed", range(3))
def test_garbage(farm, seed):
    """Random bytes, cut frames and wrong types: hung up on, and nobody else notices."""
    rng = random.Random(seed)
    good = Scripted(farm).welcome()
    hello = frame("Hello", **{**good.values, "instance": 1234 + seed})
    for i in range(60):
        host, port = farm.listen.split(":")
        with socket.create_connection((host, int(port))) as s:
            kind = i % 6
            if kind == 0:
                s.sendall(rng.randbytes(rng.randrange(1, 300)))
            elif kind == 1:
                s.sendall(hello[:rng.randrange(len(hello))])
            elif kind == 2:
                broken = bytearray(hello)
                broken[rng.randrange(len(broken))] ^= 1 << rng.randrange(8)
                s.sendall(broken)
            elif kind == 3:
                s.sendall(HEADER.pack(b"TL", 1, 14, 0, 0, 10, 0x7FFFFFFF) + rng.randbytes(200))
            elif kind == 4:
                s.sendall(hello + frame("Welcome", worker_id="w9") + rng.randbytes(50))
            else:
                meta = rng.randbytes(rng.randrange(100))
                s.sendall(hello + HEADER.pack(b"TL", 1, rng.randrange(20), 0, 0, len(meta), 0) + meta)
        good.beat()
    good.send("Heartbeat", sequence=5)
    while good.receive(5)["sequence"] != 5:
        pass
    assert farm.request("GET", "/healthz")[0] == 200


def closed_after(sock, send, seconds):
    """Seconds until the master closes a connection on which `send` is called ten times a second."""
    begin = time.monotonic()
    sock.settimeout(0.1)
    while time.monotonic() - begin < seconds:
        try:
            send()
            if sock.recv(1) == b"":
                return time.monotonic() - begin
        except TimeoutError:
            continue
        except ConnectionError:
            return time.monotonic() - begin
    raise AssertionError(f"still open after {seconds} s")


@pytest.mark.parametrize("trickle", [b"", b"a"])
def test_strangers_have_five_seconds(farm, trickle):
    """Whoever has not said a whole Hello by then is hung up on, also one that sends all the time."""
    host, port = farm.listen.split(":")
    rest = iter(frame("Hello", **Scripted(farm, hello=False).values)) if trickle else iter(())
    with socket.create_connection((host, int(port))) as stranger:
        took = closed_after(stranger, lambda: stranger.sendall(bytes([next(rest)]) if trickle
                                                               else b""), 5 + 10 * SLOW)
    assert 4.5 < took < 5 + 3 * SLOW


def test_strangers_have_64_kib(farm):
    """What a connection sends before its Hello is neither read on nor kept beyond 64 KiB."""
    def resident():
        with open(f"/proc/{farm.master.pid}/status", encoding="ascii") as file:
            return next(int(line.split()[1]) << 10 for line in file if line.startswith("VmRSS"))
    host, port = farm.listen.split(":")
    Scripted(farm).welcome()
    before = resident()
    # A Hello as large as frames may be, and more of them.
    meta = b"\x22\xf0\xd4\x03" + b"a" * 59996
    flood = (HEADER.pack(b"TL", 1, 1, 0, 0, len(meta), 0) + meta) * 64
    for _ in range(200):
        with socket.create_connection((host, int(port)), timeout=10 * SLOW) as stranger:
            try:
                stranger.sendall(flood)
                assert stranger.recv(1 << 16)[:2] in (b"", b"TL")  # a Refuse, or nothing
            except ConnectionError:
                pass
    # A sanitizer keeps what was freed for a while.
    assert resident() - before < (8 << 20 if SLOW == 1 else 128 << 20)
    Scripted(farm).welcome()


def test_flood_of_requests_from_one_that_never_reads(farm, job):
    """A worker that asks for chunks and never reads costs a bounded amount of memory."""
    peer = Scripted(farm).welcome()
    info = peer.expect("JobInfo")
    request = frame("ChunkRequest", sha256=info["package"])
    peer.sock.settimeout(3)
    try:
        for _ in range(300):
            peer.sock.sendall(request * 1000)
    except (TimeoutError, OSError):
        pass
    assert farm.request("GET", "/healthz")[0] == 200
    with open(f"/proc/{farm.master.pid}/statm", encoding="ascii") as f:
        pages = int(f.read().split()[1])
    assert pages * os.sysconf("SC_PAGESIZE") < 700 << 20
    peer.close()
