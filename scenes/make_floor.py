#!/usr/bin/env python3
"""Writes two scenes of one large picture: on a floor of which the camera sees a part, and on a wall that it sees whole.

usage: make_floor.py DIR [SIDE]

DIR gets floor.json, wall.json, and the picture, of SIDE x SIDE texels (8192): noise over broad stripes, so that it stays
large when packed.
"""
import json
import pathlib
import sys

from make_gallery import lamp, png


def quad(corners):
    lines = ["v %g %g %g" % c for c in corners] + ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    return "\n".join(lines + ["f 1/1 2/2 3/3 4/4", ""])


def scene(mesh, eye, at, fov, light):
    return {"integrator": {"type": "path", "spp": 16, "max_depth": 4}, "film": {"resolution": [640, 360]},
            "camera": {"position": eye, "look_at": at, "ref_up": [0, 1, 0], "fov": fov},
            "textures": {"picture": {"type": "image", "path": "picture.png"}},
            "materials": {"m": {"type": "diffuse", "texture_name": "picture"}},
            "objects": [{"type": "mesh", "path": mesh, "material_name": "m"}, light]}


def main():
    folder = pathlib.Path(sys.argv[1])
    side = int(sys.argv[2]) if len(sys.argv) > 2 else 8192
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "picture.png").write_bytes(png(side, 1))
    (folder / "floor.obj").write_text(quad([(-10, 0, 10), (10, 0, 10), (10, 0, -10), (-10, 0, -10)]))
    (folder / "wall.obj").write_text(quad([(-1, 0, 0), (1, 0, 0), (1, 2, 0), (-1, 2, 0)]))
    # From the middle of the floor to its edge: what lies behind and beside is not seen.
    floor = scene("floor.obj", [0, 1.7, 0], [1, 0.6, -4], 40, lamp(0, 8, -3))
    wall = scene("wall.obj", [0, 1, 4], [0, 1, 0], 40, lamp(1, 2, 4))
    (folder / "floor.json").write_text(json.dumps(floor))
    (folder / "wall.json").write_text(json.dumps(wall))


if __name__ == "__main__":
    main()
