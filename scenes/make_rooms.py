#!/usr/bin/env python3
"""Writes a scene of many rooms of which the camera sees three, with the meshes that it needs.

usage: make_rooms.py GEN_MESH DIR [ROOMS] [SIDE]

GEN_MESH is the program of that name; DIR gets rooms.json, a mesh of all walls and one of a bumpy ball for each of the
ROOMS (200), of 12 x SIDE^2 triangles (SIDE 41: 20,172). Rooms stand in rows of threes, joined by doors within the
three and closed towards all others; each has a lamp of its own under the ceiling.
"""
import json
import pathlib
import subprocess
import sys

WIDTH, HEIGHT, WALL = 4.0, 3.0, 0.2  # of a room inside, and between two
PITCH = WIDTH + WALL
ROW = 21  # rooms in a row: seven threes


class Quads:
    def __init__(self):
        self.lines = []
        self.count = 0

    def add(self, *corners):
        """Four corners, counted so that the normal looks at who sees them in that order against the clock."""
        self.lines += [f"v {x:g} {y:g} {z:g}" for x, y, z in corners]
        self.lines.append("f " + " ".join(str(self.count + k) for k in (1, 2, 3, 4)))
        self.count += 4

    def text(self):
        return "\n".join(self.lines) + "\n"


def wall_x(q, x, z, door):
    """A wall across x, from z on, with a door of 1 x 2.2 in its middle or none."""
    parts = [(0, WIDTH, 0, HEIGHT)]
    if door:
        left, right, top = WIDTH / 2 - 0.5, WIDTH / 2 + 0.5, 2.2
        parts = [(0, left, 0, HEIGHT), (right, WIDTH, 0, HEIGHT), (left, right, top, HEIGHT)]
    for z0, z1, y0, y1 in parts:
        q.add((x, y0, z + z0), (x, y1, z + z0), (x, y1, z + z1), (x, y0, z + z1))


def room(q, x, z, door_left, door_right):
    x1, z1 = x + WIDTH, z + WIDTH
    q.add((x, 0, z), (x, 0, z1), (x1, 0, z1), (x1, 0, z))
    q.add((x, HEIGHT, z), (x1, HEIGHT, z), (x1, HEIGHT, z1), (x, HEIGHT, z1))
    q.add((x, 0, z), (x1, 0, z), (x1, HEIGHT, z), (x, HEIGHT, z))
    q.add((x, 0, z1), (x, HEIGHT, z1), (x1, HEIGHT, z1), (x1, 0, z1))
    wall_x(q, x, z, door_left)
    wall_x(q, x1, z, door_right)
    if door_right:  # the passage to the next room
        a, b, y = z + WIDTH / 2 - 0.5, z + WIDTH / 2 + 0.5, 2.2
        x2 = x1 + WALL
        q.add((x1, 0, a), (x1, 0, b), (x2, 0, b), (x2, 0, a))
        q.add((x1, y, a), (x2, y, a), (x2, y, b), (x1, y, b))
        q.add((x1, 0, a), (x2, 0, a), (x2, y, a), (x1, y, a))
        q.add((x1, 0, b), (x1, y, b), (x2, y, b), (x2, 0, b))


def main():
    gen_mesh, folder = sys.argv[1], pathlib.Path(sys.argv[2])
    rooms = int(sys.argv[3]) if len(sys.argv) > 3 else 200
    side = int(sys.argv[4]) if len(sys.argv) > 4 else 41
    folder.mkdir(parents=True, exist_ok=True)
    walls, objects = Quads(), []
    for i in range(rooms):
        column, row = i % ROW, i // ROW
        x, z, last = column * PITCH, row * PITCH, min(rooms - 1, i - column + ROW - 1)
        room(walls, x, z, column % 3 > 0, column % 3 < 2 and i < last)
        name = f"ball{i}.ply"
        subprocess.run([gen_mesh, "ball", str(side), "0.2", str(i + 1), str(folder / name)], check=True)
        objects.append({"type": "mesh", "path": name, "material_name": f"ball{i % 3}",
                        "translate": [x + WIDTH / 2, 0.9, z + 1]})
        objects.append({"type": "sphere", "center": [x + WIDTH / 2, HEIGHT - 0.3, z + WIDTH / 2], "radius": 0.15,
                        "light": {"type": "area", "radiance": [40, 36, 30]}})
    (folder / "walls.obj").write_text(walls.text())
    objects.append({"type": "mesh", "path": "walls.obj", "material_name": "wall"})
    eye = [PITCH + WIDTH / 2, 1.6, WIDTH - 0.2] if rooms > 1 else [WIDTH / 2, 1.6, WIDTH - 0.2]
    colors = {"wall": [0.7, 0.68, 0.64], "ball0": [0.7, 0.3, 0.2], "ball1": [0.3, 0.6, 0.3], "ball2": [0.25, 0.35, 0.7]}
    (folder / "rooms.json").write_text(json.dumps({
        "integrator": {"type": "path", "spp": 16, "max_depth": 6}, "film": {"resolution": [320, 240]},
        "camera": {"position": eye, "look_at": [eye[0], 1.1, 0], "ref_up": [0, 1, 0], "fov": 90},
        "textures": {n: {"type": "constant", "color": c} for n, c in colors.items()},
        "materials": {n: {"type": "diffuse", "texture_name": n} for n in colors},
        "objects": objects}))


if __name__ == "__main__":
    main()
