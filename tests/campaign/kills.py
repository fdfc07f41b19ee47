#!/usr/bin/env python3
"""kills.py workers|masters COUNT [SEED]: SIGKILL at random moments of jobs that follow each other.

Every job must end as the undisturbed render did, with every sample counted once; after each kill
of the master what was acknowledged must still be there. Exit 0: all held.
"""
import random
import sys
import threading
import time

from common import (GLASS_SCENE, SMALL, Farm, fixed_farm, golden_of, metric, put_figures, scratch,
                    spread)

WORKERS = 3


def check(report, golden):
    assert report["state"] == "done", report
    assert report["image_sha256"] == golden["image_sha256"], report
    assert report["samples"] == golden["samples"], report


def wait_lost(farm, name, since):
    """Seconds from `since` until the farm has given the worker's units to others."""
    while True:
        rows = farm.request("GET", "/api/v1/workers")[1]["items"]
        state = [row["state"] for row in rows if row["name"] == name]
        if state in (["lost"], ["set-aside"]):
            return time.monotonic() - since
        assert time.monotonic() - since < 30, f"{name} is still {state}"
        time.sleep(0.002)


class Jobs:
    """A job is always under way; ended ones are checked."""

    def __init__(self, farm, options, golden):
        self.farm, self.options, self.golden = farm, options, golden
        self.ended, self.retried, self.units, self.failed = 0, 0, 0, 0
        self.id = farm.submit(GLASS_SCENE, *options)

    def poll(self):
        """The report of the job under way; a new one when it has ended."""
        report = self.farm.job(self.id)
        if report["state"] == "failed":
            # By chance the same unit was hit five times in a row: what people do then is retry.
            assert "lost too many workers" in report["note"], report
            self.failed += 1
            assert self.farm.cli("retry", self.id).returncode == 0
        elif report["state"] == "done":
            self.close(report)
            self.id = self.farm.submit(GLASS_SCENE, *self.options)
            report = self.farm.job(self.id)
        return report

    def close(self, report):
        check(report, self.golden)
        self.ended += 1
        self.retried += report["units"]["retried"]
        self.units += report["units"]["total"]

    def finish(self):
        while self.farm.job(self.id)["state"] == "failed":
            self.poll()
        self.close(self.farm.wait_job(self.id, timeout=120))


def kill_workers(count, seed=1, options=SMALL):
    """Recovery: from the kill until its units are with others."""
    rng, recovery = random.Random(seed), []
    golden = golden_of(options, GLASS_SCENE)
    with scratch() as folder, Farm(folder) as farm:
        for _ in range(WORKERS):
            farm.worker()
        jobs = Jobs(farm, options, golden)
        for kill in range(count):
            time.sleep(rng.uniform(0.02, 0.4))
            jobs.poll()
            victim = farm.workers.pop(rng.randrange(len(farm.workers)))
            since = time.monotonic()
            victim.kill()
            if kill % 5 == 0 and f"name={victim.name} " in farm.master.log():
                recovery.append(wait_lost(farm, victim.name, since))
            farm.worker(wait=False)
        jobs.finish()
        assert farm.master.process.poll() is None, farm.master.log()
    put_figures(kind="kill-worker", kills=count, jobs=jobs.ended, units=jobs.units,
                retried=jobs.retried, failed_by_chance=jobs.failed, recovery_s=spread(recovery))


class Watcher(threading.Thread):
    """Somebody looks at the unfinished picture all the time: readers of the film."""

    def __init__(self, jobs):
        super().__init__(daemon=True)
        self.jobs, self.ended, self.seen = jobs, False, 0

    def run(self):
        while not self.ended:
            try:
                path = f"/api/v1/jobs/{self.jobs.id}/picture.png?partial=1"
                self.seen += self.jobs.farm.request("GET", path, raw=True)[0] == 200
            except OSError:
                time.sleep(0.01)  # the master is dead
            time.sleep(0.005)


def recover(farm, job, before, since):
    """Seconds from `since` until the new master has stored a result."""
    farm.master.line()
    after = farm.job(job)
    assert after["samples"] >= before["samples"], (before, after)
    while after["state"] not in ("done", "failed") and after["samples"] <= before["samples"]:
        assert time.monotonic() - since < 60, after
        time.sleep(0.004)
        after = farm.job(job)
    return time.monotonic() - since


def kill_masters(count, seed=1, options=SMALL):
    """Two of three masters are killed again before they are asked anything, perhaps before they
    listen; after the third what was acknowledged must be there."""
    rng, recovery, rendered = random.Random(seed), [], 0.0
    golden = golden_of(options, GLASS_SCENE)
    with scratch() as folder, fixed_farm(folder) as farm:
        for _ in range(2):
            farm.worker()
        jobs = Jobs(farm, options, golden)
        watcher = Watcher(jobs)
        watcher.start()
        for kill in range(0, count, 3):
            time.sleep(rng.uniform(0.0, 0.4))
            before, job = jobs.poll(), jobs.id
            rendered += metric(farm, "samples_total")
            for again in range(min(3, count - kill)):
                time.sleep(rng.uniform(0.0, 0.2) if again else 0)
                since = time.monotonic()
                farm.kill_master()
                farm.start_master(wait=False)
            recovery.append(recover(farm, job, before, since))
        jobs.finish()
        watcher.ended = True
        watcher.join()
        assert watcher.seen > 0, "nobody saw a picture"
        rendered += metric(farm, "samples_total")
        for worker in farm.workers:
            assert worker.process.poll() is None, worker.log()
    put_figures(kind="kill-master", kills=count, jobs=jobs.ended, failed_by_chance=jobs.failed,
                recovery_s=spread(recovery),
                rendered_share=round(rendered / (jobs.ended * golden["samples"]), 5))


def main():
    what, count = sys.argv[1], int(sys.argv[2])
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else random.randrange(1 << 32)
    print(f"kills: {what}, {count} kills, seed {seed}", flush=True)
    {"workers": kill_workers, "masters": kill_masters}[what](count, seed)


if __name__ == "__main__":
    main()
