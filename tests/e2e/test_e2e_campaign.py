"""Short forms of tests/campaign: each holds a promise on a few cases that the long form holds on many.

Under sanitizers the memory shim cannot come first, so there are no tests with it then.
"""
import pathlib
import socket
import sys
import time

import pytest

from farm import SEED_SCENE, SLOW, Farm, wait_until

from scripted import SIDE, SPP, TILE, Scripted, honest, render_all

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "campaign"))
# pylint: disable=wrong-import-position
import kills  # noqa: E402
import memory  # noqa: E402
import network  # noqa: E402
import orders  # noqa: E402
import steps  # noqa: E402
from common import TINY, golden_of, shim  # noqa: E402

QUICK = ("--size", "64x64", "--spp", 32, "--tile", 8)


def test_workers_killed_at_random():
    kills.kill_workers(6 if SLOW == 1 else 3, seed=5, options=QUICK)


def test_masters_killed_at_random():
    kills.kill_masters(9 if SLOW == 1 else 3, seed=5, options=QUICK)


def test_orders_at_random():
    orders.orders(60 if SLOW == 1 else 20, seed=5, options=QUICK, kill_share=0.05)


def test_master_faulty_at_steps_of_its_disk():
    """From an empty folder to the end by SIGTERM there are some 200 steps."""
    steps.steps(67 if SLOW == 1 else 150, ("kill", "torn", "ENOSPC", "EIO"))


def test_slow_strangers():
    """They keep nobody from rendering: no more memory than is stated, and 5 % of a core at most."""
    network.slow(150, rounds=1, load=("--size", "48x48", "--spp", 64), idle_s=4.0)




def test_cancelled_while_results_are_stored(tmp_path):
    """The disk is slow, so that results are on their way to it when the job is cancelled: they are
    counted, and the next master knows of them, whether the job is tried again or not."""
    with Farm(tmp_path) as farm:
        farm.master.end()
        farm.start_master(env=shim("slow:disk:1:0"))
        job = farm.submit(SEED_SCENE, "--spp", SPP, "--size", f"{SIDE}x{SIDE}", "--tile", TILE)
        peer = Scripted(farm, threads=8).welcome()
        peer.send("JobReady", job=1)
        for lease in [peer.lease() for _ in range(8)]:
            fields, body = honest(lease)
            peer.send("Result", body, **fields)
        time.sleep(0.05)
        assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "cancelled"})[0] == 200
        wait_until(lambda: not list((farm.data / "jobs").rglob("seg-*")), "the last checkpoint")
        before = farm.job(job)
        farm.kill_master()
        farm.start_master()
        after = farm.job(job)
        assert after["samples"] == before["samples"] and after["rays"] == before["rays"]
        assert farm.cli("retry", job).returncode == 0
        render_all(farm, Scripted(farm).welcome(), job)
        assert farm.job(job)["samples"] == SIDE * SIDE * SPP


@pytest.mark.parametrize("step_s", (3600, -3600))
def test_somebody_sets_the_clock(tmp_path, step_s):
    """A job's seconds, and so a time limit, are not of the time of day; a job that was begun in the
    future, when the clock was set back while there was no master, ends in time too."""
    clock = tmp_path / "clock"
    clock.write_text("0")
    env = {**shim("count:disk:0"), "TILERY_SHIM_CLOCK": clock}
    options = ("--size", "96x64", "--time-limit", 4)
    with Farm(tmp_path) as farm:
        farm.master.end()
        farm.start_master(env=env)
        farm.worker()
        job = farm.submit(SEED_SCENE, *options)
        farm.wait_progress(job, 0.2)
        clock.write_text(f"{step_s}")
        report = farm.wait_job(job, timeout=30)
        assert report["stopped_by"] == "time"
        assert 2 < report["seconds"]["total"] < 4 + 8 * SLOW, report["seconds"]
        assert all(0 <= event["t"] < 60 * SLOW for event in report["events"]), report["events"]
        if step_s > 0:
            return
        job = farm.submit(SEED_SCENE, *options)
        farm.wait_progress(job, 0.2)
        farm.kill_master()
        clock.write_text(f"{3 * step_s}")
        farm.start_master(env=env)
        report = farm.wait_job(job, timeout=30)
        assert 0 < report["seconds"]["total"] < 4 + 20 * SLOW, report["seconds"]
        assert all(event["t"] >= 0 for event in report["events"]), report["events"]


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
