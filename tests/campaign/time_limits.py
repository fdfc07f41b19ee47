#!/usr/bin/env python3
"""time_limits.py [--limits S,...] [--beside N,...] [--runs N] [--size WxH]: when jobs with a time limit end.

For each limit and each number of jobs that render beside it on the same farm (a master and one worker, a thread for each
processor), RUNS jobs, one at a time: the seconds from the first lease to the end, at the master's clock, less the limit.
The last run of each limit without others is repeated by its plan, and must have its bits.
"""
import argparse
import json
import os
import pathlib

from common import Farm, scratch, spread
from farm import SCENES

SCENE = SCENES / "glass_cbox.json"


def limited(farm, options, limit, beside):
    """Seconds over the limit, and the report, of one job."""
    others = [farm.submit(SCENES / "cbox.json", "--size", "512x512", "--spp", 65536) for _ in range(beside)]
    for other in others:
        farm.wait_job(other, "rendering", timeout=60)
    job = farm.submit(SCENE, *options, "--time-limit", limit)
    report = farm.wait_job(job, timeout=20 * limit + 60)
    for other in others:
        assert farm.cli("cancel", other).returncode == 0
    return report["seconds"]["total"] - limit, report


def repeated(farm, options, report, folder):
    path = pathlib.Path(folder) / "plan.json"
    path.write_text(json.dumps(report["plan"]))
    again = farm.wait_job(farm.submit(SCENE, *options, "--plan", path), timeout=600)
    return again["image_sha256"] == report["image_sha256"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--limits", default="10,20")
    parser.add_argument("--beside", default="0,1,2")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--size", default="640x480")
    arguments = parser.parse_args()
    options = ("--size", arguments.size)
    with scratch() as folder, Farm(folder) as farm:
        farm.worker(threads=os.cpu_count())
        for limit in map(float, arguments.limits.split(",")):
            for beside in map(int, arguments.beside.split(",")):
                late = []
                for _ in range(arguments.runs):
                    over, report = limited(farm, options, limit, beside)
                    late.append(over)
                found = spread(late)
                bits = "" if beside else ", its plan has its bits: " + str(repeated(farm, options, report, folder))
                print(f"limit {limit:g} s, {beside} beside: {min(late):+.2f} to {found['max']:+.2f} s over, median "
                      f"{found['median']:+.2f}, {sum(abs(x) <= 1 for x in late)} of {len(late)} within 1 s, "
                      f"{report['spp_mean']:.0f} spp{bits}", flush=True)


if __name__ == "__main__":
    main()
