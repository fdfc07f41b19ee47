#!/usr/bin/env python3
"""orders.py COUNT [SEED]: people who change their minds, at random moments of several jobs.

Cancels, pauses, resumes, retries and priorities strike jobs in any state, while they are submitted,
rendered, looked at, finished and read back, and now and then the master is killed. In the end every
job is asked to go on, and must end as the undisturbed render did. Exit 0: all held.
"""
import random
import sys
import time

from common import GLASS_SCENE, SLOW, SMALL, fixed_farm, golden_of, put_figures, scratch
from kills import check

JOBS = 6
ORDERS = ({"state": "cancelled"}, {"state": "paused"}, {"state": "queued"}, {"state": "queued"})


def order(farm, rng, jobs):
    """One order to one job, or a look at it; what cannot be is refused, and no more."""
    job, what = rng.choice(jobs), rng.randrange(8)
    if what < 5:
        change = rng.choice(ORDERS)
    elif what == 5:
        change = {"priority": rng.randrange(-3, 4)}
    else:
        path = ("picture.png?partial=1", "picture.exr", "")[rng.randrange(3)]
        status = farm.request("GET", f"/api/v1/jobs/{job}/{path}".rstrip("/"), raw=True)[0]
        assert status in (200, 404, 409, 503), (path, status)
        return
    status, answer = farm.request("PATCH", f"/api/v1/jobs/{job}", change)
    assert status in (200, 409), (job, change, status, answer)


def go_on(farm, job):
    """Asks until the job is done; its report."""
    end = time.monotonic() + 120 * SLOW
    while (state := farm.job(job)["state"]) != "done":
        if state != "rendering":
            farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "queued"})
        assert time.monotonic() < end, farm.job(job)
        time.sleep(0.02)
    return farm.job(job)


def orders(count, seed=1, options=SMALL, kill_share=0.02):
    rng, ended, killed = random.Random(seed), 0, 0
    golden = golden_of(options, GLASS_SCENE)
    with scratch() as folder, fixed_farm(folder) as farm:
        for _ in range(2):
            farm.worker()
        given = 0
        while given < count:
            jobs = [farm.submit(GLASS_SCENE, *options) for _ in range(JOBS)]
            for _ in range(min(100, count - given)):
                time.sleep(rng.uniform(0, 0.03))
                order(farm, rng, jobs)
                given += 1
                if rng.random() < kill_share:
                    farm.kill_master()
                    farm.start_master()
                    killed += 1
            for job in jobs:
                check(go_on(farm, job), golden)
                ended += 1
        assert farm.master.process.poll() is None, farm.master.log()
        for worker in farm.workers:
            assert worker.process.poll() is None, worker.log()
    put_figures(kind="orders", orders=given, jobs=ended, kills=killed)


def main():
    count = int(sys.argv[1])
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else random.randrange(1 << 32)
    print(f"orders: {count}, seed {seed}", flush=True)
    orders(count, seed)


if __name__ == "__main__":
    main()
