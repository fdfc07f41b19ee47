#!/usr/bin/python3
"""Measures what docs/ERROR.md says of the stated error: renders small pictures on a farm of two
workers and compares what Tilery says with long references.

usage: calibrate_error.py [--part error,target,predict] [--seeds N] [--runs N] [--reference SPP]
                          [--json OUT.json]

error:   N seeds of each of eight scenes: mean of the stated over mean of the true relMSE, and how
         often the 95 % interval of the image mean holds the reference's.
target:  N runs of each scene to a target: how many claims hold, and the work beside that of an
         allocation which knows the variance of every square.
predict: what `tilery explain` says of seconds and error, beside renders of N seeds.
"""
import argparse
import json
import math
import pathlib
import sys
import tempfile

import numpy

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/e2e"))
import exr_pixels  # noqa: E402
from farm import Farm, tilery  # noqa: E402

WIDTH, HEIGHT, SPP = 96, 64, 64
CASES = [("cbox", ()), ("cbox_no_light", ()), ("glass_cbox", ()), ("cbox_no_light_refract", ()),
         ("two_spheres", ()), ("veach", ()), ("veach", ("--integrator", "direct")),
         ("cbox", ("--integrator", "ao"))]


def name_of(case):
    return case[0] + ("" if not case[1] else " " + case[1][1])


class Bench:
    def __init__(self, farm, folder):
        self.farm, self.folder = farm, folder

    def submit(self, case, *options):
        scene = ROOT / "scenes" / f"{case[0]}.json"
        return self.farm.submit(scene, "--size", f"{WIDTH}x{HEIGHT}", *case[1], *options)

    def picture(self, job):
        report = self.farm.wait_job(job, timeout=3000)
        status, data = self.farm.request("GET", f"/api/v1/jobs/{job}/picture.exr", raw=True)
        assert status == 200, data
        path = self.folder / "picture.exr"
        path.write_bytes(data)
        return report, exr_pixels.rgb(path).astype(float)

    def many(self, case, count, *options):
        """Reports and pictures of seeds 1 to count, a few jobs under way at a time."""
        jobs = []
        for seed in range(1, count + 1):
            jobs.append(self.submit(case, "--seed", seed, *options))
            if len(jobs) > 3:
                yield self.picture(jobs.pop(0))
        for job in jobs:
            yield self.picture(job)


class Truth:
    """A reference, and errors against it less its own."""

    def __init__(self, bench, case, spp):
        report, self.rgb = bench.picture(bench.submit(case, "--seed", 987654321, "--spp", spp))
        self.own = report["error"]["relmse"]
        self.below = self.rgb ** 2 + 0.01 * self.rgb.mean() ** 2

    def terms(self, rgb):
        return ((rgb - self.rgb) ** 2 / self.below).mean(axis=2)

    def relmse(self, rgb):
        return self.terms(rgb).mean() - self.own


def part_error(bench, truths, seeds):
    rows = []
    for case in CASES:
        stated, true, held = [], [], 0
        for report, rgb in bench.many(case, seeds, "--spp", SPP):
            error = report["error"]
            stated.append(error["relmse"])
            true.append(truths[case].relmse(rgb))
            held += error["mean_low"] <= truths[case].rgb.mean() <= error["mean_high"]
        row = {"scene": name_of(case), "runs": seeds, "true": float(numpy.mean(true)),
               "ratio": float(numpy.mean(stated) / numpy.mean(true)), "mean_held": held / seeds}
        print("error  {scene:24} {runs} runs, true {true:.2e}, stated/true {ratio:.3f}, "
              "mean held {mean_held:.2f}".format(**row), flush=True)
        rows.append(row)
    return rows


def squares(terms):
    return terms.reshape(HEIGHT // 16, 16, WIDTH // 16, 16).sum(axis=(1, 3))


def part_target(bench, truths, runs):
    rows = []
    for case in CASES:
        first, rgb = bench.picture(bench.submit(case, "--seed", 55, "--spp", SPP))
        target = float(f"{0.7 * max(truths[case].relmse(rgb), 1e-9):.1g}")
        claimed = held = samples = 0
        variance, ratios = numpy.zeros((HEIGHT // 16, WIDTH // 16)), []
        for report, rgb in bench.many(case, runs, "--target-error", target, "--max-spp", 4096):
            spp = numpy.array(report["plan"]["spp"]).reshape(HEIGHT // 16, WIDTH // 16)
            variance += squares(truths[case].terms(rgb)) * spp / runs
            samples += report["samples"] / runs
            if report["stopped_by"] == "error":
                claimed += 1
                true = truths[case].relmse(rgb)
                held += true <= target
                ratios.append(true / target)
        # Least work for the target: samples by square in proportion to sqrt(variance).
        perfect = numpy.sqrt(variance * 256).sum() ** 2 / (WIDTH * HEIGHT * target)
        row = {"scene": name_of(case), "target": target, "runs": runs, "claimed": claimed,
               "held": held, "work": samples / perfect,
               "true_over_target": float(numpy.median(ratios)) if ratios else None}
        print("target {scene:24} E {target:g}: {held} of {claimed} claims held ({runs} runs), "
              "work {work:.2f} of perfect, true/E {true_over_target}".format(**row), flush=True)
        rows.append(row)
    claims, good = sum(r["claimed"] for r in rows), sum(r["held"] for r in rows)
    work = math.exp(sum(math.log(r["work"]) for r in rows) / len(rows))
    print(f"target all: {good} of {claims} claims held ({good / max(claims, 1):.3f}), "
          f"work {work:.2f} of perfect (geometric mean)", flush=True)
    return rows


def part_predict(folder, seeds):
    """Renders after their predictions; the logarithms to base 2 of true over predicted."""
    rows = []
    options = [("--spp", 32), ("--spp", 128), ("--target-error", None), ("--time-limit", 4)]
    for case in CASES:
        scene = ROOT / "scenes" / f"{case[0]}.json"
        base = [scene, "--size", f"{WIDTH}x{HEIGHT}", *case[1]]
        for seed in range(1, seeds + 1):
            target = None
            for option, value in options:
                given = [*base, "--seed", seed, option, value or f"{target:.1g}"]
                said = json.loads(tilery("explain", *given, "--json", timeout=600).stdout)["predicted"]
                done = tilery("render", *base, "--seed", seed + 1000, *given[-2:], "--workers", 1,
                              "--quiet", "-o", folder / "x.exr", "--report", folder / "x.json",
                              timeout=600)
                assert done.returncode == 0, done.stderr
                report = json.loads((folder / "x.json").read_text())
                true_s, true_e = report["seconds"]["total"], report["error"]["relmse"]
                target = 0.5 * true_e if option == "--spp" else target
                if said["heavy_tail"] or true_e == 0:
                    continue
                rows.append({
                    "scene": name_of(case), "option": option,
                    "seconds_log2": math.log2(true_s / said["seconds"]),
                    "seconds_in": said["seconds_low"] <= true_s <= said["seconds_high"],
                    "relmse_log2": math.log2(true_e / said["relmse"]),
                    "relmse_in": said["relmse_low"] <= true_e <= said["relmse_high"]})
    for what in ("seconds", "relmse"):
        off = [abs(r[what + "_log2"]) for r in rows]
        inside = sum(r[what + "_in"] for r in rows)
        print(f"predict {what}: {inside} of {len(rows)} inside 80 % intervals, median "
              f"|log2(true/predicted)| {numpy.median(off):.3f}", flush=True)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", default="error,target")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--runs", type=int, default=26)
    parser.add_argument("--reference", type=int, default=8192)
    parser.add_argument("--json")
    arguments = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as folder, Farm(folder) as farm:
        for _ in range(2):
            farm.worker()
        bench = Bench(farm, pathlib.Path(folder))
        parts = arguments.part.split(",")
        if "predict" in parts:
            found["predict"] = part_predict(pathlib.Path(folder), arguments.runs)
        truths = {case: Truth(bench, case, arguments.reference) for case in CASES
                  if parts != ["predict"]}
        if "target" in parts:
            found["target"] = part_target(bench, truths, arguments.runs)
        if "error" in parts:
            found["error"] = part_error(bench, truths, arguments.seeds)
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
