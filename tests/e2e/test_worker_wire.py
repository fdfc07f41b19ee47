#!/usr/bin/env python3
"""Plays the master to a real tilery-worker: good, absent, rude, and broken in each way we know.

c-ray, the nearest peer, is hung by sixteen random bytes and crashed by a missing field; a worker
of Tilery hangs up and comes back.
"""
import json
import os
import random
import signal
import struct
import sys
import tempfile
import time
import unittest

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from wire_peer import (BEGUN, HEADER, RESULT, WAITING, Closed, Master, Package,  # noqa: E402
                       Worker, encode, frame, sanitized)


def serve(peer, package, names=("JobReady",), changed=None):
    """Answers chunk requests until a message of `names` comes: (message, names of chunks sent)."""
    sent = []
    while True:
        m = peer.expect("ChunkRequest", *names)
        if m.type != "ChunkRequest":
            return m, sent
        name = m["sha256"]
        body = package.chunk(name)
        if changed:
            body = changed(name, body)
        sent.append(name)
        peer.send("ChunkData", body, sha256=name, raw_bytes=package.sizes[name])


def give(peer, package, units, job=1, first_epoch=100):
    for i, (begin, count, block) in enumerate(units):
        peer.send("Lease", job=job, cell_begin=begin, cell_count=count, block=block,
                  epoch=first_epoch + i)


def begin_job(peer, package, job=1):
    peer.send("JobInfo", job=job, package=package.root, spec_json=package.spec)


class WorkerWire(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.package = Package(cls.folder.name, side=64, spp=4, cells_per_unit=4)
        cls.slow_folder = tempfile.TemporaryDirectory()
        # Half a second a unit; some seconds with sanitizers, where a sample costs ten times as much.
        cls.slow = Package(cls.slow_folder.name, side=256, spp=8 if sanitized() else 32,
                           cells_per_unit=128)

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()
        cls.slow_folder.cleanup()

    def setUp(self):
        self.master = Master()
        self.addCleanup(self.master.close)

    def worker(self, *args, **kwargs):
        w = Worker(self.master.port, "--threads", "2", *args, **kwargs)
        w.__enter__()
        self.addCleanup(w.__exit__, None, None, None)
        return w

    def check_result(self, peer, package, results):
        m = peer.expect("Result")
        key = (m["cell_begin"], m["cell_count"], m["block"])
        self.assertEqual(m.body, package.units[key], "the bits of the unit")
        self.assertGreater(m["samples"], 0)
        self.assertGreater(m["rays"], m["samples"])
        results[m["epoch"]] = m
        return m

    # --- The straight way ------------------------------------------------------------

    def test_renders_units_bit_for_bit(self):
        self.worker("--name", "anna", "--tag", "big", "--tag", "fast", env={"TILERY_TOKEN": "s3"})
        peer = self.master.accept()
        hello = peer.shake()
        self.assertEqual((hello["name"], hello["tags"], hello["threads"], hello["token"]),
                         ("anna", ["big", "fast"], 2, "s3"))
        self.assertEqual(len(hello["determinism_id"]), 32)
        begin_job(peer, self.package)
        units = list(self.package.units)
        give(peer, self.package, units[:4])  # leases may come before the scene is ready
        ready, sent = serve(peer, self.package)
        self.assertEqual(sorted(sent), sorted(self.package.sizes))
        self.assertEqual(ready["received_bytes"], sum(len(self.package.chunk(n)) for n in sent))
        self.assertGreater(ready["scene_bytes"], 0)
        results, given = {}, 4
        while len(results) < len(units):
            m = self.check_result(peer, self.package, results)
            peer.send("ResultAck", job=1, epoch=m["epoch"])
            if given < len(units):
                give(peer, self.package, [units[given]], first_epoch=100 + given)
                given += 1
        self.assertEqual(sorted(results), list(range(100, 100 + len(units))))

    def test_prints_its_id_once_and_drains_on_sigterm(self):
        w = self.worker()
        peer = self.master.accept()
        peer.shake(worker_id="w42", heartbeat_ms=50)
        begin_job(peer, self.slow)
        serve(peer, self.slow)
        units = list(self.slow.units)[:4]
        give(peer, self.slow, units)
        # It has read all four leases once it tells a round trip that was sent behind them.
        results, said, trip_us = {}, False, 0
        while trip_us < 60_000_000:
            m = peer.expect("Heartbeat", "Result")
            if m.type == "Result":
                results[m["epoch"]] = m
                continue
            trip_us = m["rtt_us"]
            peer.send("Heartbeat", sequence=m["sequence"], sent_us=m["sent_us"] - 60_000_000)
        self.assertLess(len(results), 4)
        w.signal(signal.SIGTERM)
        deadline = time.monotonic() + 20
        while len(results) < 4:
            self.assertLess(time.monotonic(), deadline)
            m = peer.expect("Heartbeat", "Result")
            said = said or (m.type == "Heartbeat" and m["draining"] == 1)
            if m.type == "Result":
                results[m["epoch"]] = m
                give(peer, self.slow, [units[0]], first_epoch=500 + len(results))  # too late
        for epoch in results:
            peer.send("ResultAck", job=1, epoch=epoch)
        self.assertTrue(said, "a draining worker says so")
        self.assertEqual(sorted(results), [100, 101, 102, 103])
        peer.expect("Goodbye")
        peer.close()
        status, out, _ = w.wait()
        self.assertEqual((status, out), (0, '{"worker": "w42"}\n'))

    def test_drain_message_and_idle_sigterm(self):
        for by_message in (True, False):
            w = self.worker()
            peer = self.master.accept()
            peer.shake()
            peer.expect("Heartbeat")
            if by_message:
                peer.send("Drain", reason="maintenance")
            else:
                w.signal(signal.SIGTERM)
            peer.expect("Goodbye")
            peer.close()
            self.assertEqual(w.wait()[0], 0)

    def test_sigterm_without_a_master(self):
        self.master.close()
        w = self.worker()
        time.sleep(0.3)
        w.signal(signal.SIGTERM)
        self.assertEqual(w.wait(5)[0], 0)

    def test_heartbeats_measure_the_round_trip(self):
        self.worker()
        peer = self.master.accept()
        peer.shake(heartbeat_ms=100)
        beats = [peer.expect("Heartbeat") for _ in range(4)]
        self.assertEqual([b["sequence"] for b in beats], [1, 2, 3, 4])
        self.assertEqual(beats[0]["rtt_us"], 0)
        self.assertTrue(0 < beats[3]["rtt_us"] < 1_000_000)

    def test_failed_unit_and_job(self):
        self.worker()
        peer = self.master.accept()
        peer.shake()
        peer.send("JobInfo", job=8, package=self.package.root, spec_json=b'{"width": -1}')
        m = peer.expect("JobFailed")
        self.assertEqual((m["job"], m["error"]), (8, "ERR_INPUT"))
        peer.send("Lease", job=99, cell_begin=0, cell_count=1, block=0, epoch=5)
        m = peer.expect("UnitFailed")
        self.assertEqual((m["epoch"], m["error"]), (5, "ERR_NOT_FOUND"))
        begin_job(peer, self.package)
        serve(peer, self.package)
        peer.send("Lease", job=1, cell_begin=10 ** 6, cell_count=1, block=0, epoch=6)
        self.assertEqual(peer.expect("UnitFailed")["error"], "ERR_INPUT")
        give(peer, self.package, list(self.package.units)[:1])
        peer.expect("Result")

    def test_planes_plans_and_nonsense_in_a_spec(self):
        """A worker renders the planes that a job has, and refuses a spec that no master makes."""
        self.worker()
        peer = self.master.accept()
        peer.shake()
        spec = json.loads(self.package.spec)
        for number, change in enumerate((
                {"aov": "depht"}, {"aov": "depth,depth"}, {"aov": 7}, {"stop": "never"},
                {"stop": "plan", "plan": [4]}, {"verify": 2}, {"precision": "half"},
                {"max_depth": -1}, {"tile": 0}, {"spp": 2 ** 60}, {"width": 0},
                {"preset": "a.preset"}, {"frame": 1}), 2):
            peer.send("JobInfo", job=number, package=self.package.root,
                      spec_json=json.dumps({**spec, **change}))
            m = peer.expect("JobFailed")
            self.assertEqual((m["job"], m["error"]), (number, "ERR_INPUT"), change)
            peer.send("Lease", job=number, cell_begin=0, cell_count=1, block=0, epoch=number)
            self.assertEqual(peer.expect("UnitFailed")["epoch"], number)
        planes = json.dumps({**spec, "aov": "depth,uv,normal"}).encode()
        peer.send("JobInfo", job=50, package=self.package.root, spec_json=planes)
        self.assertEqual(serve(peer, self.package)[0]["job"], 50)
        give(peer, self.package, list(self.package.units)[:1], job=50)
        m = peer.expect("Result")
        (_, count, _), = list(self.package.units)[:1]
        pixels = m["raw_bytes"] // (4 * (3 + 1 + 2 + 3))
        self.assertEqual(m["raw_bytes"], pixels * 4 * 9)
        self.assertEqual(pixels % count, 0)

    def test_missing_chunk_fails_the_job(self):
        self.worker()
        peer = self.master.accept()
        peer.shake()
        begin_job(peer, self.package)
        m = peer.expect("ChunkRequest")
        peer.send("ChunkMissing", sha256=m["sha256"])
        m = peer.expect("JobFailed")
        self.assertEqual(m["error"], "ERR_NOT_FOUND")
        begin_job(peer, self.package)  # the master has it now
        serve(peer, self.package)

    def test_an_answer_that_nobody_asked_for_ends_the_connection(self):
        """A bit of the request came over wrong: the answer that it waits for will not come."""
        self.worker()
        peer = self.master.accept()
        peer.shake()
        begin_job(peer, self.package)
        name = bytearray(peer.expect("ChunkRequest")["sha256"])
        name[7] ^= 32
        peer.send("ChunkMissing", sha256=bytes(name))
        with self.assertRaises((Closed, ConnectionError)):  # though the master's heart beats
            peer.expect("nothing else", timeout=6)
        peer = self.master.accept()
        peer.shake()
        begin_job(peer, self.package)
        serve(peer, self.package)

    # --- Chunks ------------------------------------------------------------------------

    def test_a_chunk_is_sent_once_while_the_cache_lives(self):
        with tempfile.TemporaryDirectory() as cache:
            for round_ in range(3):
                w = self.worker("--cache", cache)
                peer = self.master.accept()
                peer.shake()
                for job in (1, 2):
                    begin_job(peer, self.package, job)
                    _, sent = serve(peer, self.package)
                    expected = sorted(self.package.sizes) if round_ == 0 and job == 1 else []
                    self.assertEqual(sorted(sent), expected)
                w.signal(signal.SIGKILL)
                w.wait()
                peer.close()

    def test_a_chunk_that_the_disk_changed_is_fetched_again(self):
        with tempfile.TemporaryDirectory() as cache:
            for _ in range(2):
                w = self.worker("--cache", cache)
                peer = self.master.accept()
                peer.shake()
                begin_job(peer, self.package)
                _, sent = serve(peer, self.package)
                w.signal(signal.SIGKILL)
                w.wait()
                peer.close()
                files = sorted(os.path.join(d, f) for d, _, fs in os.walk(cache) for f in fs)
                self.assertEqual(len(files), len(self.package.sizes))
                victim = next(f for f in files if self.package.root.hex() not in f)
                with open(victim, "r+b") as f:
                    f.seek(os.path.getsize(victim) // 2)
                    byte = f.read(1)
                    f.seek(-1, os.SEEK_CUR)
                    f.write(bytes([byte[0] ^ 1]))
            self.assertEqual([n.hex() for n in sent], [os.path.basename(victim)[:64]])

    def test_a_chunk_damaged_on_the_way_is_asked_for_again(self):
        self.worker()
        peer = self.master.accept()
        peer.shake()
        broken = set()

        def change_once(name, body):
            if name in broken:
                return body
            broken.add(name)
            return body[:-1] + bytes([body[-1] ^ 0x40])

        begin_job(peer, self.package)
        _, sent = serve(peer, self.package, changed=change_once)
        self.assertEqual(len(sent), 2 * len(self.package.sizes))
        begin_job(peer, self.slow, job=2)
        m, sent = serve(peer, self.slow, names=("JobReady", "JobFailed"))
        self.assertEqual(m.type, "JobReady")

    def test_a_chunk_always_damaged_fails_the_job(self):
        self.worker()
        peer = self.master.accept()
        peer.shake()
        begin_job(peer, self.package)
        m, sent = serve(peer, self.package, names=("JobFailed",),
                        changed=lambda name, body: b"x" * len(body))
        self.assertEqual((m["error"], len(sent)), ("ERR_CORRUPT", 3))

    # --- Revoke and end ------------------------------------------------------------------

    def test_revoked_units_are_not_delivered(self):
        self.worker()
        peer = self.master.accept()
        peer.shake()
        begin_job(peer, self.slow)
        serve(peer, self.slow)
        units = list(self.slow.units)[:4]
        give(peer, self.slow, units)
        for epoch in (100, 103):  # one that runs, one that waits
            peer.send("Revoke", job=1, epoch=epoch)
        epochs = set()
        while len(epochs) < 2:
            epochs.add(peer.expect("Result")["epoch"])
        self.assertEqual(epochs, {101, 102})
        give(peer, self.slow, units[:1], first_epoch=200)
        peer.send("JobEnd", job=1)
        give(peer, self.slow, units[:1], first_epoch=300)
        self.assertEqual(peer.expect("UnitFailed")["epoch"], 300)
        begin_job(peer, self.slow)  # revived: the scene is still there
        self.assertEqual(serve(peer, self.slow)[1], [])

    # --- Losing the master ------------------------------------------------------------------

    def test_comes_back_within_a_second(self):
        self.worker()
        peer = self.master.accept()
        peer.shake()
        peer.expect("Heartbeat")
        for away in (0.0, 0.3, 1.1, 2.3):
            self.master.close()
            peer.close()
            time.sleep(away)
            self.master = Master(self.master.port)
            began = time.monotonic()
            peer = self.master.accept()
            peer.shake()
            self.assertLess(time.monotonic() - began, 1.0, f"after {away} s")
            peer.expect("Heartbeat")

    def test_offers_again_what_was_not_acknowledged(self):
        self.worker()
        peer = self.master.accept()
        peer.shake(farm=11)
        begin_job(peer, self.package)
        serve(peer, self.package)
        units = list(self.package.units)[:3]
        give(peer, self.package, units)
        first = {}
        while len(first) < 3:
            self.check_result(peer, self.package, first)
        peer.send("ResultAck", job=1, epoch=101)
        peer.expect("Heartbeat")
        peer.close()
        peer = self.master.accept()
        peer.shake(farm=11)
        again = {}
        while len(again) < 2:
            self.check_result(peer, self.package, again)
        self.assertEqual(sorted(again), [100, 102])
        peer.close()
        peer = self.master.accept()
        peer.shake(farm=12)  # another farm: none of its business
        with self.assertRaises(TimeoutError):
            peer.expect("Result", timeout=1.0)

    def test_leases_outlive_their_connection(self):
        """The next Hello tells what is held; what is not revoked is rendered, with the old epochs."""
        self.worker()
        peer = self.master.accept()
        self.assertEqual(peer.shake()["held"], [])
        begin_job(peer, self.slow)
        serve(peer, self.slow)
        units = list(self.slow.units)[:4]
        give(peer, self.slow, units)
        time.sleep(0.2)  # both threads have begun
        peer.close()
        peer = self.master.accept()
        held = {h["epoch"]: h for h in peer.shake()["held"]}
        self.assertEqual(set(held), {100, 101, 102, 103})
        for epoch, unit in zip(sorted(held), units):
            told = held[epoch]
            self.assertEqual((told["cell_begin"], told["cell_count"], told["block"]), unit)
            self.assertEqual(told["job"], 1)
            begun = (BEGUN, RESULT) if epoch < 102 else (WAITING,)  # nothing begins alone
            self.assertIn(told["state"], begun)
        peer.send("Revoke", job=1, epoch=103)
        results = {peer.expect("Result", timeout=60)["epoch"] for _ in range(3)}
        self.assertEqual(results, {100, 101, 102})
        with self.assertRaises(TimeoutError):
            peer.expect("Result", timeout=1.0)

    def test_leases_are_void_for_another_farm(self):
        self.worker()
        peer = self.master.accept()
        peer.shake(farm=7)
        begin_job(peer, self.slow)
        serve(peer, self.slow)
        give(peer, self.slow, list(self.slow.units)[:4])
        time.sleep(0.2)
        peer.close()
        peer = self.master.accept()
        self.assertEqual(len(peer.shake(farm=8)["held"]), 4)
        with self.assertRaises(TimeoutError):
            peer.expect("Result", "UnitFailed", timeout=1.0)
        peer.close()
        peer = self.master.accept()
        self.assertEqual(peer.shake(farm=8)["held"], [])

    def test_a_silent_master_is_left(self):
        self.worker()
        peer = self.master.accept()
        peer.shake(heartbeat_ms=200)
        began = time.monotonic()
        second = self.master.accept(timeout=5)  # nothing was said or echoed
        self.assertLess(time.monotonic() - began, 3)
        second.shake()
        second.expect("Heartbeat")
        peer.close()

    def test_nothing_leaks_over_reconnects(self):
        w = self.worker()
        peer = self.master.accept()
        peer.shake()
        begin_job(peer, self.package)
        serve(peer, self.package)
        before = None
        for i in range(60):
            give(peer, self.package, list(self.package.units)[:4], first_epoch=1000 + 4 * i)
            peer.close()
            peer = self.master.accept()
            peer.shake(farm=i)
            begin_job(peer, self.package)
            serve(peer, self.package)
            if i == 20:
                before = w.fd_count(), w.memory_bytes()
        self.assertEqual(w.fd_count(), before[0])
        if not sanitized():
            self.assertLess(w.memory_bytes(), before[1] + 8 * 2 ** 20)

    # --- Refusals ------------------------------------------------------------------------

    def test_refusals_that_end_it(self):
        for reason, word in ((1, "version-mismatch"), (2, "determinism-mismatch"),
                             (3, "bad-token")):
            w = self.worker(env={"TILERY_TOKEN": "very-secret"})
            peer = self.master.accept()
            peer.expect("Hello")
            peer.send("Refuse", reason=reason, text="this farm speaks protocol 5 to 6")
            status, out, err = w.wait()
            self.assertEqual((status, out), (4, ""))
            self.assertIn(f"[{word}]", err)
            self.assertIn("protocol 5 to 6", err)
            self.assertNotIn("very-secret", err)
            peer.close()

    def test_refusals_that_pass(self):
        w = self.worker()
        for reason in (6, 5, 0, 4):
            peer = self.master.accept()
            peer.expect("Hello")
            peer.send("Refuse", reason=reason, text="later")
            peer.close()
        peer = self.master.accept()
        peer.shake()
        peer.expect("Heartbeat")
        self.assertTrue(w.alive())

    # --- Rudeness ------------------------------------------------------------------------

    def survives(self, w, rude, before_hello):
        """The worker hangs up on these bytes and comes back."""
        peer = self.master.accept()
        peer.expect("Hello")
        if not before_hello:
            peer.send("Welcome", protocol=1, worker_id="w1", heartbeat_ms=1000, farm=7)
        try:
            peer.sock.sendall(rude)
        except ConnectionError:
            pass
        peer.expect_closed()
        self.assertTrue(w.alive())

    def test_garbage(self):
        w = self.worker()
        rng = random.Random(1)
        huge = HEADER.pack(b"TL", 1, 12, 0, 0, 0xFFFFFFFF, 0)
        inputs = [
            rng.randbytes(16), b"GET / HTTP/1.0\r\n\r\n", struct.pack("<Q", 5000) + b"x" * 10,
            huge, HEADER.pack(b"TL", 1, 10, 0, 0, 3, 0xFFFFFFFF) + b"abc",
            HEADER.pack(b"TL", 1, 2, 0, 0, 0, 1 << 30), HEADER.pack(b"TL", 1, 99, 0, 0, 0, 0),
            HEADER.pack(b"TL", 9, 2, 0, 0, 0, 0), HEADER.pack(b"TL", 1, 2, 1, 0, 0, 0),
            HEADER.pack(b"TL", 1, 2, 0, 0, 4, 0) + b"\xff\xff\xff\xff",
            frame("Hello", protocol_min=1, protocol_max=1, name="x", threads=1),
            frame("Welcome", protocol=1, worker_id="w1", heartbeat_ms=0, farm=1),
            frame("Welcome", protocol=7, worker_id="w1", heartbeat_ms=1000, farm=1),
            frame("Welcome", protocol=1, worker_id=b"\xff\xfe", heartbeat_ms=1000, farm=1),
            frame("Welcome", protocol=1, worker_id="w" * 40, heartbeat_ms=1000, farm=1),
            frame("Lease", job=1, cell_begin=0, cell_count=1, block=0, epoch=1),
        ]
        for rude in inputs:
            self.survives(w, rude, before_hello=True)
        chunk = self.package.chunk(self.package.root)
        for rude in inputs[:11] + [
                frame("Welcome", protocol=1, worker_id="w1", heartbeat_ms=1000, farm=7),
                frame("Lease", job=1, cell_begin=0, cell_count=0, block=0, epoch=1),
                frame("Lease", job=1, cell_begin=2 ** 32 - 1, cell_count=2, block=0, epoch=1),
                frame("Result", job=1, cell_begin=0, cell_count=1, block=0, epoch=1, raw_bytes=12),
                frame("ChunkData", chunk, sha256=self.package.root, raw_bytes=len(chunk)),
                HEADER.pack(b"TL", 1, 12, 0, 0, 2, 0) + b"\x08"[:1] + b"\x80",
                frame("JobInfo", job=1, package=b"short", spec_json=b"{}"),
                HEADER.pack(b"TL", 1, 5, 0, 0, 8000, 0) + encode(
                    "JobInfo", {"job": 1, "package": b"\0" * 32, "spec_json": b"x" * 7950}).ljust(
                        8000, b"\0")]:
            self.survives(w, rude, before_hello=False)
        peer = self.master.accept()
        peer.shake()
        begin_job(peer, self.package)
        serve(peer, self.package)
        if not sanitized():
            self.assertLess(w.memory_bytes(), 200 * 2 ** 20)

    def test_half_frames(self):
        w = self.worker()
        whole = frame("Welcome", protocol=1, worker_id="w1", heartbeat_ms=1000, farm=7)
        for cut in (1, 7, 15, 16, 17, len(whole) - 1):
            peer = self.master.accept()
            peer.expect("Hello")
            peer.sock.sendall(whole[:cut])
            peer.close()
        peer = self.master.accept()
        peer.expect("Hello")
        for i in range(len(whole)):  # and byte by byte it is as good as at once
            peer.sock.sendall(whole[i:i + 1])
            time.sleep(0.002)
        peer.expect("Heartbeat")
        self.assertTrue(w.alive())

    def test_a_master_that_never_answers_is_left(self):
        self.worker()
        peer = self.master.accept()
        peer.expect("Hello")
        began = time.monotonic()
        second = self.master.accept(timeout=10)
        self.assertTrue(3 < time.monotonic() - began < 8)
        second.shake()
        with self.assertRaises(Closed):
            peer.receive(2)
        peer.close()

    def test_early_flood_is_cut_off(self):
        w = self.worker()
        peer = self.master.accept()
        peer.expect("Hello")
        before = w.memory_bytes()
        flood = HEADER.pack(b"TL", 1, 2, 0, 0, 60000, 0) + b"\x22\xf0\xd4\x03" + b"a" * 59996
        self.survives_flood(peer, flood * 4)
        self.assertLess(w.memory_bytes() - before, 16 * 2 ** 20)
        self.assertTrue(w.alive())

    def survives_flood(self, peer, data):
        try:
            peer.sock.sendall(data)
        except ConnectionError:
            pass
        peer.expect_closed()

    # --- No memory ---------------------------------------------------------------------

    def test_allocation_fails_once_anywhere(self):
        """The n-th allocation fails: an error and exit 5, a failed unit or job, or a new
        connection; never a crash, a hang or wrong bits."""
        rng = random.Random(2)
        outcomes = set()
        for n in list(range(0, 44, 5)) + rng.sample(range(44, 250), 25):
            w = self.worker(env={"TILERY_MEM_FAIL": str(n)})
            outcomes.add(self.render_with_failure(w))
            if w.alive():
                w.signal(signal.SIGKILL)
            w.wait()
        self.assertIn("done", outcomes)
        self.assertGreater(len(outcomes), 1, outcomes)

    def accept_unless_ended(self, w):
        """A connection, or None when the worker has ended."""
        for _ in range(100):
            try:
                return self.master.accept(timeout=0.1)
            except TimeoutError:
                if not w.alive():
                    return None
        raise AssertionError("the worker neither connects nor ends")

    def render_with_failure(self, w):
        """Serves the worker until four units are done or it gives up; says how it went."""
        outcome, results, wanted = "done", set(), list(self.package.units)[:4]
        for _ in range(4):  # connections
            peer = self.accept_unless_ended(w)
            if peer is None:
                self.assertEqual(w.process.returncode, 5)
                return "exit 5"
            try:
                peer.shake()
                begin_job(peer, self.package)
                give(peer, self.package, wanted)
                while len(results) < 4:
                    m = peer.expect("ChunkRequest", "JobReady", "JobFailed", "Result", "UnitFailed")
                    if m.type == "ChunkRequest":
                        name = m["sha256"]
                        peer.send("ChunkData", self.package.chunk(name), sha256=name,
                                  raw_bytes=self.package.sizes[name])
                    elif m.type == "JobFailed":
                        outcome = "job failed"
                        begin_job(peer, self.package)
                        give(peer, self.package, wanted)
                    elif m.type == "UnitFailed":
                        outcome = "unit failed"
                        give(peer, self.package, [wanted[m["epoch"] - 100]],
                             first_epoch=m["epoch"])
                    elif m.type == "Result":
                        key = (m["cell_begin"], m["cell_count"], m["block"])
                        self.assertEqual(m.body, self.package.units[key])
                        results.add(key)
                return outcome
            except (Closed, ConnectionError):
                outcome = "new connection"
            finally:
                peer.close()
        self.fail("the worker does not get anywhere")

    # --- Wrong usage ------------------------------------------------------------------------

    def test_usage(self):
        program = os.path.join(os.environ["TILERY_BIN"], "tilery-worker")
        import subprocess  # noqa: PLC0415
        for args, status in ((["--help"], 0), ([], 2), (["--master", "nowhere"], 2),
                             (["--master", "a:99999"], 2), (["--threads", "0"], 2),
                             (["--master", "a:1", "--log", "loud"], 2), (["--colour"], 2),
                             (["--master", "127.0.0.1:1", "--cache", "/dev/null/x"], 5)):
            run = subprocess.run([program, *args], capture_output=True, text=True, timeout=20,
                                 check=False)
            self.assertEqual(run.returncode, status, (args, run.stderr))
        ids = {subprocess.run([program, "--determinism-id"], capture_output=True, text=True,
                              check=True).stdout for _ in range(2)}
        self.assertEqual(len(ids), 1)
        self.assertRegex(ids.pop(), "^[0-9a-f]{64}\n$")


if __name__ == "__main__":
    unittest.main()
