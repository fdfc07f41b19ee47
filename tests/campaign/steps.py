#!/usr/bin/env python3
"""steps.py [EVERY [ACTION...]]: a fault at every step of the master's disk in a tiny job.

A step is a write, sync, rename, truncation, new folder or removal of a file, from the start of an
empty master to its end by SIGTERM. Actions: kill (SIGKILL before the step), killed (after it), torn
(half of the write, then SIGKILL), ENOSPC and EIO (the step fails once). EVERY: only each n-th step.

The job must end with the picture of an undisturbed render, whatever happened to its master; a job
that was acknowledged is never gone; nothing acknowledged is rendered again. Exit 0: all held.
"""
import json
import subprocess
import sys
import time

from common import SEED_SCENE, SLOW, TINY, fixed_farm, golden_of, put_figures, scratch, shim

KILLS, ERRORS = ("kill", "killed", "torn"), ("ENOSPC", "EIO")


class Run:
    """One life of a job under a master that has one fault."""

    def __init__(self, farm, golden):
        self.farm, self.golden = farm, golden
        self.restarts, self.pauses, self.refusals = 0, 0, 0

    def master(self):
        """The master, started again without a fault if it is dead."""
        process = self.farm.master.process
        if process.poll() is not None:
            assert process.returncode in (-9, 5), f"{process.returncode}: {self.farm.master.log()}"
            self.restarts += 1
            self.farm.start_master()
        return self.farm

    def started(self):
        """Waits for the first master's line; it may die before."""
        try:
            said = self.farm.master.line()
            self.farm.listen, self.farm.http = said["listen"], said["http"]
        except AssertionError:
            assert self.farm.master.process.poll() is not None, self.farm.master.log()

    def submit(self):
        for _ in range(10):
            done = self.master().cli("submit", SEED_SCENE, *TINY)
            if done.returncode == 0:
                return done.stdout.strip()
            assert done.returncode in (1, 4, 5), done.stderr
            self.refusals += 1
        raise AssertionError(f"ten submissions failed: {done.stderr}")

    def report(self, job):
        for _ in range(100):
            try:
                return self.master().job(job)
            except (OSError, ValueError, AssertionError) as problem:
                why = problem  # it dies just now, or has no memory for an answer
                time.sleep(0.02)
        raise AssertionError(f"the master does not answer: {why}")

    def wait(self, job):
        samples = 0
        end = time.monotonic() + 60 * SLOW
        while time.monotonic() < end:
            report = self.report(job)
            assert report["samples"] >= samples, "what was acknowledged is gone"
            samples = report["samples"]
            if report["state"] == "done":
                return report
            if report["state"] == "paused":
                self.pauses += 1
                assert self.pauses < 20, report
                self.master().cli("resume", job)
            if report["state"] == "failed":
                assert "out of memory" in report["note"], report
                self.pauses += 1
                assert self.pauses < 20
                self.master().cli("retry", job)
            assert report["state"] in ("queued", "rendering", "paused", "failed"), report
            time.sleep(0.005)
        raise AssertionError(f"not done: {report}")

    def live(self):
        """Submit, render, stop, start again, look."""
        self.started()
        self.farm.worker(wait=False)
        job = self.submit()
        self.check(self.wait(job))
        status = self.farm.master.end()
        assert status in (0, -9), f"{status}: {self.farm.master.log()}"
        self.farm.start_master()
        self.check(self.farm.wait_job(job))
        return job

    def check(self, report):
        assert report["image_sha256"] == self.golden["image_sha256"], report
        assert report["samples"] == self.golden["samples"], report


def run_one(what, golden, count=None, memory=False):
    with scratch() as folder:
        farm = fixed_farm(folder)
        try:
            farm.start_master(env=shim(what, memory, count), wait=False)
            run = Run(farm, golden)
            run.live()
            return run
        finally:
            farm.close()


def count_steps(golden, kind="disk"):
    with scratch() as folder:
        run_one(f"count:{kind}:1", golden, f"{folder}/count", memory=kind != "disk")
        with open(f"{folder}/count", encoding="ascii") as file:
            return int(file.read())


def steps(every, actions, golden=None):
    golden = golden or golden_of(TINY)
    total = count_steps(golden)
    for action in actions:
        runs = struck = 0
        for n in range(1, total + 1, every):
            try:
                run = run_one(f"{action}:disk:{n}", golden)
            except (AssertionError, json.JSONDecodeError, subprocess.TimeoutExpired) as problem:
                raise AssertionError(f"{action} at step {n} of {total}: {problem}") from problem
            runs += 1
            struck += run.restarts > 0 or run.pauses > 0 or run.refusals > 0
        put_figures(kind="disk-step", action=action, steps=total, runs=runs, felt=struck)


def main():
    every = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    actions = sys.argv[2:] or KILLS + ERRORS
    print(f"steps: {', '.join(actions)} at each {every}. step of the master's disk", flush=True)
    steps(every, actions)


if __name__ == "__main__":
    main()
