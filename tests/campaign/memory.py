#!/usr/bin/env python3
"""memory.py master|worker alloc|library [EVERY [FIRST]]: the n-th allocation of a program fails, once.

alloc: of our own allocator; library: inside the shared libraries. For every n (or each EVERY-th from
FIRST on) of a tiny render: nobody may die by a signal, and the job must end with the picture of an
undisturbed render, retried by hand where it was told to have failed for want of memory.
"""
import sys
import time

from common import SEED_SCENE, SLOW, TINY, Farm, golden_of, put_figures, scratch, shim
from steps import count_steps, run_one


def master(kind, every, first, golden):
    total = count_steps(golden, kind)
    runs = felt = 0
    for n in range(first, total + 1, every):
        try:
            run = run_one(f"ENOMEM:{kind}:{n}", golden, memory=True)
        except AssertionError as problem:
            raise AssertionError(f"allocation {n} of {total}: {problem}") from problem
        runs += 1
        felt += run.restarts > 0 or run.pauses > 0 or run.refusals > 0
    return total, runs, felt


def survives(worker):
    """It runs, or has ended by itself."""
    status = worker.process.poll()
    assert status is None or status >= 0, f"died of signal {-status}: {worker.log()[-2000:]}"
    return status is None


def render_with(farm, worker, golden):
    """One job by a worker that may give up; then a sound one helps. True: it was needed."""
    job = farm.submit(SEED_SCENE, *TINY)
    helped, end = False, time.monotonic() + 60 * SLOW
    patience = time.monotonic() + 3 * SLOW
    while True:
        report = farm.job(job)
        if report["state"] == "done":
            break
        if report["state"] == "failed":
            assert farm.cli("retry", job).returncode == 0
        assert time.monotonic() < end, report
        if not helped and (not survives(worker) or time.monotonic() > patience):
            farm.worker(wait=False)
            helped = True
        time.sleep(0.005)
    assert report["image_sha256"] == golden["image_sha256"], report
    assert report["samples"] == golden["samples"], report
    survives(worker)
    return helped


def worker_once(farm, what, golden, count=None):
    worker = farm.worker(wait=False, env=shim(what, memory=True, count=count))
    try:
        helped = render_with(farm, worker, golden)
        if survives(worker):
            assert worker.end() in (0, 5), worker.log()
        return helped
    finally:
        for each in farm.workers:
            each.kill()
        farm.workers = []


def worker(kind, every, first, golden):
    runs = felt = 0
    with scratch() as folder, Farm(folder) as farm:
        worker_once(farm, f"count:{kind}:1", golden, f"{folder}/count")
        with open(f"{folder}/count", encoding="ascii") as file:
            total = int(file.read())
        for n in range(first, total + 1, every):
            try:
                felt += worker_once(farm, f"ENOMEM:{kind}:{n}", golden)
            except AssertionError as problem:
                raise AssertionError(f"allocation {n} of {total}: {problem}") from problem
            runs += 1
        assert farm.master.process.poll() is None, farm.master.log()
    return total, runs, felt


def sweep(who, kind, every=1, first=1, golden=None):
    golden = golden or golden_of(TINY)
    total, runs, felt = {"master": master, "worker": worker}[who](kind, every, first, golden)
    put_figures(kind="allocation", program=who, allocations=kind, total=total, runs=runs, felt=felt)


def main():
    who, kind = sys.argv[1:3]
    every = int(sys.argv[3]) if len(sys.argv) > 3 else 1
    first = int(sys.argv[4]) if len(sys.argv) > 4 else 1
    print(f"memory: {who}, {kind}, each {every}. allocation from {first} on", flush=True)
    sweep(who, kind, every, first)


if __name__ == "__main__":
    main()
