#!/usr/bin/env python3
"""Writes a scene of many lights, a night town: panels, balls, points and spots over a floor of blocks.

usage: make_lights.py OUT.json [LIGHTS]   (default: 1000; meshes go beside OUT.json)

The same bytes each time. Not committed: `tests/bench/many_lights.sh` makes it when it measures.
"""
import json
import math
import pathlib
import random
import sys

SIDE = 20.0   # half the floor's side
BLOCKS = 150

CUBE = """v -.5 0 -.5
v .5 0 -.5
v .5 0 .5
v -.5 0 .5
v -.5 1 -.5
v .5 1 -.5
v .5 1 .5
v -.5 1 .5
f 1 4 8 5
f 2 6 7 3
f 1 5 6 2
f 4 3 7 8
f 5 8 7 6
"""
FLOOR = "v -1 0 -1\nv -1 0 1\nv 1 0 1\nv 1 0 -1\nf 1 2 3 4\n"
PANEL = "v -.5 0 -.5\nv .5 0 -.5\nv .5 0 .5\nv -.5 0 .5\nf 1 2 3 4\n"   # faces down


def rounded(values):
    return [round(v, 4) for v in values]


def scaled(x, y, z):
    return [x, 0, 0, 0, 0, y, 0, 0, 0, 0, z, 0, 0, 0, 0, 1]


def colour(rng, strength):
    warm = rng.random()
    return rounded(strength * c for c in (1, 0.55 + 0.4 * warm, 0.2 + 0.9 * warm * warm))


def light(rng, kind):
    """An object or an entry of `lights`. Strengths span a factor of 30."""
    place = [rng.uniform(-SIDE, SIDE), rng.uniform(0.3, 2.5), rng.uniform(-SIDE, SIDE)]
    strength = 0.06 * math.exp(rng.uniform(0, math.log(30)))
    if kind == 0:
        side = rng.uniform(0.1, 0.4)
        return "objects", {"type": "mesh", "path": "panel.obj", "translate": rounded(place),
                           "transform": rounded(scaled(side, 1, side)),
                           "light": {"type": "area", "radiance": colour(rng, strength / side ** 2)}}
    if kind == 1:
        radius = rng.uniform(0.03, 0.1)
        return "objects", {"type": "sphere", "center": rounded(place), "radius": round(radius, 4),
                           "light": {"type": "area",
                                     "radiance": colour(rng, strength / (math.pi * radius ** 2))}}
    entry = {"type": "point" if kind == 2 else "spot", "position": rounded(place),
             "intensity": colour(rng, strength)}
    if kind == 3:
        entry["direction"] = rounded([rng.uniform(-1, 1), -1, rng.uniform(-1, 1)])
        entry["outer_angle"] = 40
    return "lights", entry


def scene(count):
    rng = random.Random(1)
    made = {
        "integrator": {"type": "path", "spp": 64, "max_depth": 4},
        "film": {"resolution": [480, 320]},
        "camera": {"position": [0, 9, 24], "look_at": [0, 0, 4], "ref_up": [0, 1, 0], "fov": 45},
        "materials": {"stone": {"type": "diffuse", "color": [0.5, 0.5, 0.5], "twosided": True},
                      "brick": {"type": "diffuse", "color": [0.6, 0.4, 0.3], "twosided": True}},
        "objects": [{"type": "mesh", "path": "floor_unit.obj", "material_name": "stone",
                     "transform": scaled(2 * SIDE, 1, 2 * SIDE)}],
        "lights": [],
    }
    for _ in range(BLOCKS):
        x, z = rng.uniform(-SIDE, SIDE), rng.uniform(-SIDE, SIDE)
        size = scaled(rng.uniform(0.4, 1.5), rng.uniform(0.3, 2.5), rng.uniform(0.4, 1.5))
        made["objects"].append({"type": "mesh", "path": "cube.obj", "material_name": "brick",
                                "transform": rounded(size), "translate": rounded([x, 0, z])})
    for i in range(count):
        where, entry = light(rng, i % 4)
        made[where].append(entry)
    return made


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    out = pathlib.Path(sys.argv[1])
    count = int(sys.argv[2]) if len(sys.argv) == 3 else 1000
    for name, text in (("cube", CUBE), ("floor_unit", FLOOR), ("panel", PANEL)):
        (out.parent / f"{name}.obj").write_text(f"# written by make_lights.py\n{text}")
    out.write_text(json.dumps(scene(count), indent=1) + "\n")


if __name__ == "__main__":
    main()
