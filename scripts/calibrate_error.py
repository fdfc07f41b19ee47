#!/usr/bin/python3
"""Measures what docs/ERROR.md says of the stated error: renders small pictures on a farm of two
workers and compares what Tilery says with long references.

usage: calibrate_error.py [--part error,target,predict] [--seeds N] [--runs N] [--cases N]
                          [--first-case N] [--reference SPP] [--json OUT.json]

error:   N seeds of each of eight scenes: mean of the stated over mean of the true relMSE, and how
         often the 95 % interval of the image mean holds the reference's.
target:  N runs of each scene to a target: how many claims hold, and the work beside that of an
         allocation which knows the variance of every square.
predict: what `tilery explain --spp` says of seconds and error, beside renders of other seeds.
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


PREDICTED = ((8, "96x64"), (32, "64x48"), (64, "48x32"), (128, "48x32"))


def predicted_case(folder, number):
    """One prediction and one render of another seed; None where no error is predicted."""
    case = CASES[number % len(CASES)]
    spp, size = PREDICTED[number // len(CASES) % len(PREDICTED)]
    base = [ROOT / "scenes" / f"{case[0]}.json", "--size", size, *case[1], "--spp", spp]
    said = tilery("explain", *base, "--seed", number, "--json", timeout=600)
    assert said.returncode == 0, said.stderr
    said = json.loads(said.stdout)["predicted"]
    picture, path = folder / f"{number}.exr", folder / f"{number}.json"
    done = tilery("render", *base, "--seed", number + 1000, "--quiet", "-o", picture,
                  "--report", path, timeout=600)
    assert done.returncode == 0, done.stderr
    report = json.loads(path.read_text())
    true = {"seconds": report["seconds"]["total"], "relmse": report["error"]["relmse"]}
    row = {"scene": name_of(case), "spp": spp, "heavy_tail": said["heavy_tail"]}
    for what, value in true.items():
        row[what + "_log2"] = math.log2(value / said[what]) if value and said[what] else None
        row[what + "_in"] = said[what + "_low"] <= value <= said[what + "_high"]
    return row


def part_predict(folder, count, first):
    """As many cases as asked for, one at a time; logarithms to base 2 of true over predicted."""
    rows = []
    for number in range(first, first + count):
        rows.append(predicted_case(folder, number))
        print(json.dumps(rows[-1]), flush=True)
    for name, chosen in (("all", rows), ("no heavy tail", [r for r in rows if not r["heavy_tail"]])):
        for what in ("seconds", "relmse"):
            off = [r[what + "_log2"] for r in chosen if r[what + "_log2"] is not None]
            inside = sum(r[what + "_in"] for r in chosen if r[what + "_log2"] is not None)
            if off:
                print(f"predict {what}, {name}: {inside} of {len(off)} inside 80 % intervals, median "
                      f"|log2(true/predicted)| {numpy.median(numpy.abs(off)):.3f}, median "
                      f"{numpy.median(off):+.3f}", flush=True)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", default="error,target")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--runs", type=int, default=26)
    parser.add_argument("--cases", type=int, default=96, help="predictions")
    parser.add_argument("--first-case", type=int, default=0, help="others have other seeds")
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
            found["predict"] = part_predict(pathlib.Path(folder), arguments.cases, arguments.first_case)
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
