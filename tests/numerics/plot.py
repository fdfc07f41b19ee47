#!/usr/bin/env python3
"""Draws docs/img/numerics_*.png from the lines of numerics_figures.

usage: plot.py FIGURES.csv [FOLDER]; numerics_figures > FIGURES.csv makes them. Runs itself again in a
virtual environment of its own (build/plot-venv), which it fills with matplotlib the first time.
"""
import csv
import math
import os
import pathlib
import subprocess
import sys
import venv

ROOT = pathlib.Path(__file__).resolve().parents[2]
HOME = ROOT / "build/plot-venv"

if os.environ.get("TILERY_PLOT_VENV") != "1":
    python = HOME / "bin/python"
    if not python.exists():
        venv.create(HOME, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "-q", "matplotlib==3.9.2"], check=True)
    os.environ["TILERY_PLOT_VENV"] = "1"
    os.execv(python, [str(python), *sys.argv])

import matplotlib  # noqa: E402

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

# Fixed per method in every plot: colour, line, mark, its size. Curves that lie on each other are told
# by their marks: ours small and in front, the others' hollow around it.
STYLE = {
    "seed": ("#b2182b", "-", "s", 9), "seed, epsilon 0": ("#ef8a62", "--", "D", 6),
    "Woop, float": ("#7b6fb0", "--", "v", 12), "Embree": ("#4d4d4d", ":", "^", 7),
    "Embree, ROBUST": ("#999999", ":", "x", 9), "Tilery": ("#1b7837", "-", "o", 4),
}


def read(path):
    """{figure: {method: [(x, value)]}}"""
    figures = {}
    for figure, method, x, value in csv.reader(open(path, encoding="utf-8")):
        figures.setdefault(figure, {}).setdefault(method, []).append((float(x), float(value)))
    return figures


def draw(curves, title, across, up, floor, path):
    """Log-log curves; what is 0 lies on the line at the bottom, named so."""
    figure, axes = pyplot.subplots(figsize=(7, 4), dpi=90)
    for method, (color, line, mark, size) in STYLE.items():
        points = sorted(curves[method])
        ours = method == "Tilery"
        axes.plot([x for x, _ in points], [max(v, floor) for _, v in points], line, color=color,
                  marker=mark, markersize=size, markerfacecolor=color if ours else "none",
                  linewidth=1.8 if ours else 1.4, label=method, zorder=3 if ours else 2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(floor * 0.6, 5)
    axes.set_title(title, loc="left", fontsize=11)
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    axes.axhline(floor, color="#cccccc", linewidth=0.8, zorder=1)
    ticks = [t for t in axes.get_yticks() if floor < t <= 1]
    axes.set_yticks([floor, *ticks], ["0", *("1" if t == 1 else f"$10^{{{round(math.log10(t))}}}$"
                                              for t in ticks)])
    axes.minorticks_off()
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=9, loc="center left", bbox_to_anchor=(1, 0.5))
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)
    print(path)


def main():
    figures = read(sys.argv[1])
    folder = pathlib.Path(sys.argv[2] if len(sys.argv) > 2 else ROOT / "docs/img")
    draw(figures["leaks by scale"], "Rays from inside a closed ball that hit nothing",
         "radius of the ball (world units)", "share of rays at vertices and edges", 1e-6,
         folder / "numerics_leaks_scale.png")
    draw(figures["leaks by distance"], "Rays from inside a ball of radius 1, far out, that hit nothing",
         "distance from the origin (world units)", "share of rays at vertices and edges", 1e-6,
         folder / "numerics_leaks_distance.png")
    draw(figures["error by distance"], "Place of the hit against exact arithmetic, radius 1",
         "distance from the origin (world units)", "largest error, in radii (1: missed)", 1e-16,
         folder / "numerics_error.png")


main()
