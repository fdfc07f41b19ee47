#!/usr/bin/python3
"""Measures what docs/ERROR.md says of the stated error: renders small pictures on a farm of two
workers and compares what Tilery says with long references.

usage: calibrate_error.py [--part rule,error,target,predict] [--size WxH] [--spp N] [--seeds N]
                          [--runs N] [--max-spp N] [--reference SPP] [--cases N]
                          [--first-case N] [--trials N] [--keep FOLDER] [--json OUT.json]

rule:    the rule of --target-error on pictures of known noise, without a renderer: claims that were
         wrong, and work over that of a rule which knows the error.
error:   N seeds of each of eight scenes: mean of the stated over mean of the true relMSE, how often
         the 95 % interval of the image mean holds the reference's, and how often a heavy tail is
         said.
target:  N runs of each scene to a target, which is the error of about --spp samples: how many
         claims hold, and the work beside that of an allocation which knows the variance of every
         square.
predict: what `tilery explain` says of seconds and error, beside renders of other seeds.
"""
import argparse
import json
import math
import pathlib
import re
import resource
import sys
import tempfile

import numpy

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests/e2e"))
import exr_pixels  # noqa: E402
from farm import Farm, tilery  # noqa: E402

CASES = [("cbox", ()), ("cbox_no_light", ()), ("glass_cbox", ()), ("cbox_no_light_refract", ()),
         ("two_spheres", ()), ("veach", ()), ("veach", ("--integrator", "direct")),
         ("cbox", ("--integrator", "ao"))]


def name_of(case):
    return case[0] + ("" if not case[1] else " " + case[1][1])


class Bench:
    def __init__(self, farm, folder, width, height):
        self.farm, self.folder, self.width, self.height = farm, folder, width, height

    def submit(self, case, *options):
        scene = ROOT / "scenes" / f"{case[0]}.json"
        return self.farm.submit(scene, "--size", f"{self.width}x{self.height}", *case[1], *options)

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

    def squares(self, terms):
        """Sums over squares of 16 x 16 pixels."""
        return terms.reshape(self.height // 16, 16, self.width // 16, 16).sum(axis=(1, 3))


class Truth:
    """Two references: the product of the differences to both has no part of their own noise."""

    def __init__(self, bench, case, spp, kept):
        path = kept and kept / f"{name_of(case).replace(' ', '-')}-{bench.width}x{bench.height}-{spp}.npz"
        if path and path.exists():
            found = numpy.load(path)
            self.a, self.b, self.mean_doubt = found["a"], found["b"], float(found["doubt"])
        else:
            jobs = [bench.submit(case, "--seed", seed, "--spp", spp) for seed in (987654321, 987654322)]
            (first, self.a), (second, self.b) = [bench.picture(job) for job in jobs]
            self.mean_doubt = math.hypot(*(r["error"]["mean_high"] - r["error"]["mean_low"]
                                           for r in (first, second))) / 4
            if path:
                numpy.savez(path, a=self.a, b=self.b, doubt=self.mean_doubt)
        both = (self.a + self.b) / 2
        self.below = both ** 2 + 0.01 * both.mean() ** 2
        self.mean = both.mean()

    def terms(self, rgb):
        return ((rgb - self.a) * (rgb - self.b) / self.below).mean(axis=2)

    def relmse(self, rgb):
        return self.terms(rgb).mean()

    def holds(self, error):
        """The interval of the mean, its half widened by the reference's, holds the reference's."""
        half = math.hypot((error["mean_high"] - error["mean_low"]) / 2, self.mean_doubt)
        return abs((error["mean_high"] + error["mean_low"]) / 2 - self.mean) <= half


def ratio_of(stated, true):
    """Ratio of the means, and its standard error."""
    stated, true = numpy.array(stated), numpy.array(true)
    ratio = stated.mean() / true.mean()
    return float(ratio), float((stated - ratio * true).std(ddof=1) / true.mean() / len(true) ** 0.5)


def part_error(bench, truths, seeds, spp):
    rows = []
    for case in CASES:
        stated, true, held, heavy = [], [], 0, 0
        for report, rgb in bench.many(case, seeds, "--spp", spp):
            stated.append(report["error"]["relmse"])
            true.append(truths[case].relmse(rgb))
            held += truths[case].holds(report["error"])
            heavy += report["error"]["heavy_tail"]
        ratio, doubt = ratio_of(stated, true)
        row = {"scene": name_of(case), "runs": seeds, "spp": spp, "true": float(numpy.mean(true)),
               "ratio": ratio, "doubt": doubt, "mean_held": held, "heavy_tail": heavy}
        print("error  | `{scene}` | {true:.2e} | {ratio:.3f} +- {doubt:.3f} | {mean_held} of {runs} | "
              "{heavy_tail} of {runs} |".format(**row), flush=True)
        rows.append(row)
    return rows


def part_target(bench, truths, runs, spp, max_spp):
    rows = []
    for case in CASES:
        _, rgb = bench.picture(bench.submit(case, "--seed", 55, "--spp", spp))
        target = float(f"{max(truths[case].relmse(rgb), 1e-9):.2g}")
        claimed = held = samples = 0
        variance, ratios = 0, []
        for report, rgb in bench.many(case, runs, "--target-error", target, "--max-spp", max_spp):
            given = numpy.array(report["plan"]["spp"]).reshape(bench.height // 16, -1)
            variance = variance + bench.squares(truths[case].terms(rgb)) * given / runs
            samples += report["samples"] / runs
            if report["stopped_by"] == "error":
                claimed += 1
                true = truths[case].relmse(rgb)
                held += true <= target
                ratios.append(true / target)
        # Least work for the target: samples by square in proportion to sqrt(variance).
        pixels = bench.width * bench.height
        perfect = numpy.sqrt(numpy.maximum(variance, 0) * 256).sum() ** 2 / (pixels * target)
        row = {"scene": name_of(case), "target": target, "runs": runs, "claimed": claimed,
               "held": held, "work": samples / perfect, "spp": samples / pixels,
               "true_over_target": float(numpy.median(ratios)) if ratios else math.nan}
        print("target | `{scene}` | {target:g} | {runs} | {held} of {claimed} | "
              "{true_over_target:.2f} | {spp:.0f} | {work:.2f} |".format(**row), flush=True)
        rows.append(row)
    claims, good = sum(r["claimed"] for r in rows), sum(r["held"] for r in rows)
    for what, chosen in (("all", rows), ("where most claim", [r for r in rows if 2 * r["claimed"] > runs])):
        if chosen:
            work = math.exp(sum(math.log(r["work"]) for r in chosen) / len(chosen))
            print(f"target {what}: {good} of {claims} claims held, work {work:.2f} of the perfect "
                  "allocation's (geometric mean)", flush=True)
    return rows


RULE = (ROOT / "master/claim.c").read_text()


def constant(name):
    """Of the rule, as the master has it."""
    return float(re.search(rf"\b{name} = ([0-9.]+)", RULE).group(1))


QUANTILE, DOUBT, EFFECTIVE_MIN = constant("QUANTILE"), constant("DOUBT"), constant("CLAIM_EFFECTIVE_MIN")
FIRST_POWER, NEXT_POWER = constant("FIRST_POWER"), constant("NEXT_POWER")
FIRST_SPP_MAX = constant("FIRST_SPP_MAX")
GROWTH_MIN, GROWTH_MAX = constant("GROWTH_MIN"), constant("GROWTH_MAX")
GROWTH_MARGIN, HEAVY_GROWTH = constant("GROWTH_MARGIN"), constant("HEAVY_GROWTH")


def simulated_claim(random, groups, freedom, unevenness, aim=0.01):
    """Samples and true error of a picture of so many groups, each of so many noisy pixels alike,
    that stopped by the rule; None: it made no claim within 20 times the samples. The relMSE is
    1 / samples on average."""
    variance = numpy.exp(unevenness * random.standard_normal(groups))
    deviation = numpy.sqrt(variance / variance.mean())[:, None]

    def halves(spp):
        return random.standard_normal((2, groups, freedom)) * deviation * math.sqrt(spp / 2)

    a, b = halves(2)
    spp = min(2 * (((a - b) ** 2).mean() / 4 / aim) ** (1 / FIRST_POWER), FIRST_SPP_MAX)
    sums = halves(spp)
    while spp < 20 / aim:
        a, b = sums / (spp / 2)
        terms = (a - b) ** 2 / 4
        effective = terms.sum() ** 2 / (terms ** 2).sum()
        upper = terms.mean() * math.exp(math.hypot(QUANTILE / math.sqrt(effective), DOUBT))
        heavy = effective < EFFECTIVE_MIN
        if upper <= aim and not heavy:
            return spp, (((a + b) / 2) ** 2).mean()
        growth = (GROWTH_MARGIN * upper / aim) ** (1 / NEXT_POWER)
        growth = max(growth, HEAVY_GROWTH if heavy else GROWTH_MIN)
        growth = min(growth, GROWTH_MAX)
        sums = sums + halves((growth - 1) * spp)
        spp *= growth
    return None


def part_rule(trials):
    random, rows = numpy.random.default_rng(1), []
    for groups, freedom, unevenness in ((96, 4, 0.7), (96, 12, 0.7), (96, 4, 2), (384, 4, 1),
                                        (384, 4, 2), (1536, 4, 1), (1536, 4, 1.6)):
        made = [c for c in (simulated_claim(random, groups, freedom, unevenness)
                            for _ in range(trials)) if c]
        row = {"groups": groups, "freedom": freedom, "unevenness": unevenness, "trials": trials,
               "claims": len(made), "wrong": sum(true > 0.01 for _, true in made),
               "work": float(numpy.median([spp for spp, _ in made])) * 0.01}
        print("rule   | {groups} | {freedom} | {unevenness} | {wrong} of {claims} | {work:.2f} |".format(
            **row), flush=True)
        rows.append(row)
    return rows


# Errors that 30 to 100 samples reach, in pictures of 96 x 64.
TARGETS = dict(zip(map(name_of, CASES), (1.5e-3, 2e-4, 8e-3, 3e-4, 3e-3, 1e-2, 1e-2, 2e-2)))
PREDICTED = (("--size", "192x128", "--spp", 8), ("--size", "128x96", "--spp", 32),
             ("--size", "96x64", "--spp", 96), ("--size", "96x64", "--max-spp", 256, "--target-error"),
             ("--size", "96x64", "--time-limit", 2))


def processor_s(folder, *options):
    """Processor time of all processes of a render, and its report."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    path = folder / "report.json"
    done = tilery("render", *options, "--quiet", "-o", folder / "render.exr", "--report", path,
                  timeout=600)
    assert done.returncode == 0, done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, json.loads(path.read_text())


def predicted_case(folder, number, idle):
    """One prediction and one render of another seed; `idle` is the processor time of client and
    master."""
    case = CASES[number % len(CASES)]
    options = PREDICTED[number // len(CASES) % len(PREDICTED)]
    if options[-1] == "--target-error":
        options = (*options, TARGETS[name_of(case)])
    base = [ROOT / "scenes" / f"{case[0]}.json", *case[1], *options]
    said = tilery("explain", *base, "--seed", number, "--json", timeout=600)
    assert said.returncode == 0, said.stderr
    said = json.loads(said.stdout)["predicted"]
    core, report = processor_s(folder, *base, "--seed", number + 1000)
    core = max(core - idle, 1e-3)
    true = {"seconds": report["seconds"]["total"], "core_seconds": core,
            "relmse": report["error"]["relmse"]}
    row = {"scene": name_of(case), "options": " ".join(map(str, options)),
           "heavy_tail": said["heavy_tail"], "stretch": report["core_seconds"] / core}
    for what, value in true.items():
        row[what + "_log2"] = math.log2(value / said[what]) if value and said[what] else None
        row[what + "_in"] = said[what + "_low"] <= value <= said[what + "_high"]
        row[what + "_width"] = math.log2(said[what + "_high"] / said[what + "_low"])
    return row


def part_predict(folder, count, first):
    """As many cases as asked for, one at a time; logarithms to base 2 of true over predicted."""
    rows = []
    nothing = (ROOT / "scenes/sphere.json", "--size", "1x1", "--spp", 1)
    idle = float(numpy.median([processor_s(folder, *nothing)[0] for _ in range(9)]))
    for number in range(first, first + count):
        rows.append(predicted_case(folder, number, idle))
        print(json.dumps(rows[-1]), flush=True)
    limited = [r for r in rows if "--time-limit" in r["options"]]
    groups = {"all": rows, "no heavy tail": [r for r in rows if not r["heavy_tail"]],
              "--spp": [r for r in rows if " --spp" in r["options"]],
              "--target-error": [r for r in rows if "--target-error" in r["options"]],
              "--time-limit": limited}
    for name, chosen in groups.items():
        for what in ("seconds", "core_seconds", "relmse"):
            off = [r[what + "_log2"] for r in chosen if r[what + "_log2"] is not None]
            inside = sum(r[what + "_in"] for r in chosen if r[what + "_log2"] is not None)
            if off:
                print(f"predict | {name} | {what} | {inside} of {len(off)} | "
                      f"{numpy.median(numpy.abs(off)):.3f} | {numpy.median(off):+.3f} | "
                      f"{numpy.median([r[what + '_width'] for r in chosen]):.2f} |", flush=True)
    stretch = [r["stretch"] for r in rows]
    print(f"predict: threads took {numpy.median(stretch):.2f} times their processor time (median)")
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", default="error,target")
    parser.add_argument("--size", default="96x64", help="sides are multiples of 16")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--runs", type=int, default=26)
    parser.add_argument("--trials", type=int, default=1000, help="of the rule")
    parser.add_argument("--max-spp", type=int, default=1024, help="of a render to a target")
    parser.add_argument("--cases", type=int, default=96, help="predictions")
    parser.add_argument("--first-case", type=int, default=0, help="others have other seeds")
    parser.add_argument("--reference", type=int, default=2048, help="samples of each of the two")
    parser.add_argument("--keep", help="folder where references are kept for the next time")
    parser.add_argument("--json")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    found = {}
    with tempfile.TemporaryDirectory() as folder, Farm(folder) as farm:
        for _ in range(2):
            farm.worker()
        bench = Bench(farm, pathlib.Path(folder), width, height)
        parts = arguments.part.split(",")
        if "rule" in parts:
            found["rule"] = part_rule(arguments.trials)
        if "predict" in parts:
            found["predict"] = part_predict(pathlib.Path(folder), arguments.cases, arguments.first_case)
        kept = arguments.keep and pathlib.Path(arguments.keep)
        truths = {case: Truth(bench, case, arguments.reference, kept) for case in CASES
                  if {"error", "target"} & set(parts)}
        if "error" in parts:
            found["error"] = part_error(bench, truths, arguments.seeds, arguments.spp)
        if "target" in parts:
            found["target"] = part_target(bench, truths, arguments.runs, arguments.spp,
                                          arguments.max_spp)
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps(found, indent=1, default=int) + "\n")


if __name__ == "__main__":
    main()
