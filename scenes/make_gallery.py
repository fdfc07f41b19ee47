#!/usr/bin/env python3
"""Writes a scene of many rooms with a large picture in each, and one of a wall of all these pictures.

usage: make_gallery.py DIR [ROOMS] [SIDE]

DIR gets rooms.json, in which the camera sees the pictures of three of the ROOMS (60; as in make_rooms.py), wall.json, in
which it sees all of them, and the pictures, of SIDE x SIDE texels (1024): noise over broad stripes, so that they stay large
when packed.
"""
import json
import pathlib
import random
import struct
import sys
import zlib

from make_rooms import HEIGHT, PITCH, ROW, WIDTH, Quads, room


def png(side, seed):
    """A picture of its own for each seed."""
    numbers = random.Random(seed)
    low = numbers.randrange(20, 120)
    stripes = [bytes((n >> 2) + low + up for n in range(256)) for up in (0, 64)]
    rows = [b"\0" + numbers.randbytes(3 * side).translate(stripes[y // 64 % 2]) for y in range(side)]

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)) +
            chunk(b"IDAT", zlib.compress(b"".join(rows), 1)) + chunk(b"IEND", b""))


def square(x, y, z, side):
    """A square across z that faces the growing z, with texture coordinates."""
    corners = [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]
    lines = [f"v {a:g} {b:g} {z:g}" for a, b in corners] + ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1"]
    return "\n".join(lines + ["f 1/1 2/2 3/3 4/4", ""])


def scene(count, eye, at, fov, objects):
    textures = {f"picture{i}": {"type": "image", "path": f"picture{i}.png"} for i in range(count)}
    textures["wall"] = {"type": "constant", "color": [0.7, 0.68, 0.64]}
    return {"integrator": {"type": "path", "spp": 16, "max_depth": 6}, "film": {"resolution": [320, 240]},
            "camera": {"position": eye, "look_at": at, "ref_up": [0, 1, 0], "fov": fov},
            "textures": textures,
            "materials": {n: {"type": "diffuse", "texture_name": n} for n in textures},
            "objects": objects}


def lamp(x, y, z):
    return {"type": "sphere", "center": [x, y, z], "radius": 0.15,
            "light": {"type": "area", "radiance": [40, 36, 30]}}


def main():
    folder = pathlib.Path(sys.argv[1])
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 60
    side = int(sys.argv[3]) if len(sys.argv) > 3 else 1024
    folder.mkdir(parents=True, exist_ok=True)
    walls, rooms, wall = Quads(), [], []
    across = 10
    for i in range(count):
        (folder / f"picture{i}.png").write_bytes(png(side, i + 1))
        column, row = i % ROW, i // ROW
        x, z, last = column * PITCH, row * PITCH, min(count - 1, i - column + ROW - 1)
        room(walls, x, z, column % 3 > 0, column % 3 < 2 and i < last)
        (folder / f"square{i}.obj").write_text(square(x + 1, 0.6, z + 0.02, 2))
        (folder / f"tile{i}.obj").write_text(square(i % across, i // across, 0, 0.95))
        rooms += [{"type": "mesh", "path": f"square{i}.obj", "material_name": f"picture{i}"},
                  lamp(x + WIDTH / 2, HEIGHT - 0.3, z + WIDTH / 2)]
        wall.append({"type": "mesh", "path": f"tile{i}.obj", "material_name": f"picture{i}"})
    (folder / "walls.obj").write_text(walls.text())
    rooms.append({"type": "mesh", "path": "walls.obj", "material_name": "wall"})
    # From the back of the second room one looks through both doors at an angle.
    eye = [PITCH + WIDTH / 2, 1.6, WIDTH - 0.2]
    (folder / "rooms.json").write_text(json.dumps(scene(count, eye, [eye[0], 1.3, 0], 90, rooms)))
    high = (count + across - 1) // across
    middle = [across / 2, high / 2]
    wall.append(lamp(middle[0], middle[1], 6))
    (folder / "wall.json").write_text(
        json.dumps(scene(count, [*middle, 8], [*middle, 0], 60, wall)))


if __name__ == "__main__":
    main()
