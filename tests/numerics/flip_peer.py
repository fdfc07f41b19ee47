#!/usr/bin/env python3
"""HDR-FLIP of `tilery compare --flip` against its authors' package flip-evaluator, from PyPI.

usage: flip_peer.py

Makes a virtual environment in build/venv-flip (once, by the network), renders pairs of pictures (few samples against
many), adds some made by rule, and prints mean and 95th percentile of both programs. Exit 1 when a mean or percentile
differs by more than 2e-5; 77 (skipped) where the environment cannot be made: apt is all that a newcomer needs. The
programs are looked for in $TILERY_BIN, or in build/release/bin.
"""
import json
import os
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("TILERY_BIN", ROOT / "build/release/bin"))
VENV = ROOT / "build/venv-flip"
PACKAGES = ("flip-evaluator==1.7", "numpy==2.2.6")
TILERY = BIN / "tilery"
LIMIT = 2e-5


def enter_venv():
    """Starts this file anew by the environment's Python, which is made if it is not there."""
    if not (VENV / "bin/flip").exists():
        try:
            subprocess.run(["/usr/bin/python3", "-m", "venv", VENV], check=True)
            subprocess.run([VENV / "bin/pip", "install", "-q", "--disable-pip-version-check", *PACKAGES], check=True)
        except (OSError, subprocess.CalledProcessError) as problem:
            print(f"no flip-evaluator from PyPI (python3-venv, pip): skipped: {problem}", file=sys.stderr)
            sys.exit(77)
    os.execv(VENV / "bin/python3", [str(VENV / "bin/python3"), *sys.argv])


if pathlib.Path(sys.prefix).resolve() != VENV:
    enter_venv()

import flip_evaluator  # noqa: E402  (in the venv only)
import numpy  # noqa: E402

sys.path.insert(0, str(ROOT / "tests/e2e"))
import exr_pixels  # noqa: E402


def renders(folder):
    """Pairs (name, test, reference) of noisy and cleaner pictures."""
    for scene in ("cbox_no_light_refract", "glass_cbox", "veach"):
        paths = []
        for spp, seed in ((2, 1), (64, 2)):
            paths.append(folder / f"{scene}-{spp}.exr")
            subprocess.run([TILERY, "render", ROOT / f"scenes/{scene}.json", "-o", paths[-1],
                            "--size", "160x120", "--spp", str(spp), "--seed", str(seed), "--quiet"],
                           check=True, stderr=subprocess.DEVNULL)
        yield scene, *paths


def made(folder):
    """Edges, points, offsets and wide ranges."""
    random = numpy.random.default_rng(7)
    y, x = numpy.mgrid[0:90, 0:130].astype(float)
    bases = {"ramp": numpy.stack([2 ** (x / 16 - 4), 2 ** (y / 12 - 4), 0.3 + 0 * x], -1),
             "edges": ((x // 13 + y // 9) % 2)[..., None] * numpy.array([3.0, 0.4, 0.1]) + 0.05,
             "dim": numpy.full((90, 130, 3), 0.02) + 0.01 * numpy.sin(x / 3)[..., None]}
    for name, base in bases.items():
        test = base * random.uniform(0.7, 1.3, base.shape)
        test[20:24, 30:40] = 12
        paths = folder / f"{name}-a.exr", folder / f"{name}-b.exr"
        exr_pixels.write(paths[0], test)
        exr_pixels.write(paths[1], base)
        yield name, *paths


def main():
    worst = 0
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        print(f"{'picture':24} {'mean':>9} {'theirs':>9} {'p95':>9} {'theirs':>9}")
        for name, test, reference in (*renders(folder), *made(folder)):
            ours = json.loads(subprocess.run([TILERY, "compare", test, reference, "--flip", "--json"],
                                             check=True, capture_output=True).stdout)
            pictures = [numpy.maximum(exr_pixels.rgb(p), 0).astype(numpy.float32)
                        for p in (reference, test)]
            errors, mean, _ = flip_evaluator.evaluate(*pictures, "HDR", applyMagma=False)
            p95 = float(numpy.percentile(errors, 95))
            print(f"{name:24} {ours['flip_mean']:9.6f} {mean:9.6f} {ours['flip_p95']:9.6f} {p95:9.6f}")
            worst = max(worst, abs(ours["flip_mean"] - mean), abs(ours["flip_p95"] - p95))
    print(f"largest difference {worst:.2g}, limit {LIMIT:g}")
    sys.exit(worst > LIMIT)


if __name__ == "__main__":
    main()
