"""Short forms of tests/campaign: each holds a promise on a few cases that the long form holds on many.

Under sanitizers the memory shim cannot come first, so there are no tests with it then.
"""
import pathlib
import socket
import sys
import time

from farm import SEED_SCENE, SLOW, Farm, wait_until

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "campaign"))
# pylint: disable=wrong-import-position
import kills  # noqa: E402
import memory  # noqa: E402
import network  # noqa: E402
import steps  # noqa: E402
from common import TINY, golden_of  # noqa: E402

QUICK = ("--size", "64x64", "--spp", 32, "--tile", 8)


def test_workers_killed_at_random():
    kills.kill_workers(6 if SLOW == 1 else 3, seed=5, options=QUICK)


def test_masters_killed_at_random():
    kills.kill_masters(9 if SLOW == 1 else 3, seed=5, options=QUICK)


def test_master_faulty_at_steps_of_its_disk():
    """From an empty folder to the end by SIGTERM there are some 200 steps."""
    steps.steps(67 if SLOW == 1 else 150, ("kill", "torn", "ENOSPC", "EIO"))


def test_slow_strangers():
    """They keep nobody from rendering: no more memory than is stated, and 5 % of a core at most."""
    network.slow(150, rounds=1, load=("--size", "48x48", "--spp", 64), idle_s=4.0)




def test_no_descriptors_left(tmp_path):
    """`ulimit -n 32` and twice as many connections: what is connected goes on, nothing spins, and
    new ones are taken again when there is room."""
    golden = golden_of(TINY)
    with Farm(tmp_path) as farm:
        farm.master.end()
        farm.start_master(files=32)
        for _ in range(2):
            farm.worker()
        job = farm.submit(SEED_SCENE, *TINY)
        host, port = farm.listen.split(":")
        strangers = [socket.create_connection((host, int(port)), timeout=5) for _ in range(64)]
        try:
            before = network.processor_seconds(farm.master.pid)
            time.sleep(2)
            assert network.processor_seconds(farm.master.pid) - before < 1.5, "it spins"
        finally:
            for sock in strangers:
                sock.close()

        def ended():
            try:
                return farm.job(job)["state"] == "done" and farm.job(job)
            except OSError:
                return None
        report = wait_until(ended, "the job to be done", 60, 0.1)
        assert report["image_sha256"] == golden["image_sha256"]
        late = farm.worker(name="late")
        assert late.id


if SLOW == 1:
    def test_worker_without_memory():
        memory.sweep("worker", "alloc", every=90, first=40)
        memory.sweep("worker", "library", every=400, first=30)

    def test_master_without_memory():
        memory.sweep("master", "alloc", every=300, first=150)
