#!/usr/bin/env python3
"""Writes a scene of a dense mesh under a sky: sky.json, sky.hdr and ball.ply.

usage: make_sky.py GEN_MESH OUT_DIR [SIDE]

GEN_MESH is the program gen_mesh of the build. The ball has 12 * SIDE^2 triangles (SIDE 128: 196,608).
The sky is a gradient with a sun of 500 times its brightness, in the format of Radiance.
"""
import json
import math
import pathlib
import subprocess
import sys

WIDTH, HEIGHT = 256, 128


def rgbe(color):
    largest = max(color)
    if largest < 1e-32:
        return bytes(4)
    exponent = math.frexp(largest)[1]
    scale = 256 * 2.0 ** -exponent
    return bytes([min(255, int(c * scale)) for c in color] + [exponent + 128])


def sky_pixel(x, y):
    """The sky's light from above (y 0) to below: blue, pale at the horizon, then the ground's grey."""
    up = 1 - 2 * (y + 0.5) / HEIGHT
    if math.hypot(x - 88, y - 30) < 2.2:
        return (400, 370, 300)
    if up < 0:
        return (0.12, 0.11, 0.1)
    pale = (1 - up) ** 3
    return (0.25 + 0.5 * pale, 0.4 + 0.45 * pale, 0.8 + 0.1 * pale)


def scene(folder):
    return {
        "integrator": {"type": "path", "spp": 64, "max_depth": 12},
        "film": {"resolution": [512, 512]},
        "camera": {"position": [0, 1.6, 4.2], "look_at": [0, 0.75, 0], "fov": 34},
        "textures": {"clay": {"type": "constant", "color": [0.7, 0.45, 0.3]},
                     "ground": {"type": "constant", "color": [0.5, 0.5, 0.5]},
                     "sky": {"type": "image", "path": str(folder / "sky.hdr")}},
        "materials": {"clay": {"type": "diffuse", "texture_name": "clay"},
                      "ground": {"type": "diffuse", "texture_name": "ground"}},
        "objects": [
            {"type": "mesh", "path": str(folder / "ball.ply"), "material_name": "clay",
             "translate": [0, 1, 0]},
            {"type": "mesh", "path": str(folder / "ground.obj"), "material_name": "ground"},
        ],
        "environment_map": {"texture_name": "sky"},
    }


def main():
    program, folder = sys.argv[1], pathlib.Path(sys.argv[2]).resolve()
    side = sys.argv[3] if len(sys.argv) > 3 else "128"
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run([program, "ball", side, "0.15", str(folder / "ball.ply")], check=True)
    (folder / "ground.obj").write_text("v -20 0 -20\nv -20 0 20\nv 20 0 20\nv 20 0 -20\nf 1 2 3 4\n")
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {HEIGHT} +X {WIDTH}\n".encode()
    pixels = b"".join(rgbe(sky_pixel(x, y)) for y in range(HEIGHT) for x in range(WIDTH))
    (folder / "sky.hdr").write_bytes(head + pixels)
    (folder / "sky.json").write_text(json.dumps(scene(folder), indent=1) + "\n")


if __name__ == "__main__":
    main()
