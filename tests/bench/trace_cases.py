#!/usr/bin/env python3
"""Meshes and rays for bench_trace that none of its own scenes were tuned on, and a table of what it says of them.

usage: trace_cases.py BENCH [--data FOLDER] [--only WORD] [--rays WORD] [--count N] [--runs N] [--keep FOLDER] [-- OPTION...]

BENCH is the bench_trace of a release build, which gets the OPTIONs behind --. Every PLY and OBJ below FOLDER is
taken as well as the generated meshes; --only and --rays keep those whose name has the word in it. Each mesh gets
rays of ten kinds, of which none was aimed with a tree of ours: points of the surface are drawn by area. The exit
status is 1 if bench_trace failed on a case, found single calls and batches apart, or an answer of ours wrong. Needs numpy.
"""
import argparse
import json
import pathlib
import struct
import subprocess
import sys
import tempfile

import numpy as np

# --- Meshes: (vertices float32 n x 3, triangles uint32 m x 3) ------------------------------------


def grid(side, height):
    """A height field over [-1, 1]^2 of 2 (side - 1)^2 triangles."""
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    i = np.arange(side * side).reshape(side, side)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x, height(x, y), y], -1).reshape(-1, 3), faces


def terrain(rng):
    waves = [(2.0 ** k, rng.uniform(0, 6.28, 4)) for k in range(8)]
    return grid(501, lambda x, y: sum(0.2 / f * np.sin(f * 3 * x + p[0] + np.sin(f * y + p[1])) * np.cos(f * 3 * y + p[2])
                                      for f, p in waves))


def soup(rng, count=200000, size=0.02):
    centre = rng.uniform(-1, 1, (count, 1, 3))
    return separate(centre + rng.normal(0, size, (count, 3, 3)))


def separate(corners):
    return corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)


def sphere(rows, columns, radius):
    """A closed ball of latitudes; radius(direction) says how far out."""
    t = np.linspace(0, np.pi, rows + 1)[:, None]
    p = np.linspace(0, 2 * np.pi, columns, endpoint=False)[None, :]
    d = np.stack([np.sin(t) * np.cos(p), np.cos(t) + 0 * p, np.sin(t) * np.sin(p)], -1)
    r, c = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    n = (c + 1) % columns
    a, b, e, f = (r * columns + c).ravel(), ((r + 1) * columns + c).ravel(), ((r + 1) * columns + n).ravel(), (r * columns + n).ravel()
    faces = np.concatenate([np.stack([a, f, e], 1), np.stack([a, e, b], 1)])
    return (d * radius(d)[..., None]).reshape(-1, 3), faces


def scan(rng):
    """A blob as a scanner sees one: noise at every vertex, triangles of all sizes, and holes."""
    points, faces = sphere(400, 500, lambda d: 0.7 + 0.15 * np.sin(5 * d[..., 0]) * np.cos(4 * d[..., 1] + d[..., 2]))
    points = points + rng.normal(0, 0.0006, points.shape)
    return points, faces[rng.random(len(faces)) > 0.03]


BOX = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6],
                [1, 2, 6], [1, 6, 5], [3, 0, 4], [3, 4, 7]])
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [0, 1, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1]], float)


def boxes(low, size):
    points = (low[:, None] + CORNERS * size[:, None]).reshape(-1, 3)
    return points, (BOX + 8 * np.arange(len(low))[:, None, None]).reshape(-1, 3)


def city(rng, side=100):
    """Blocks on a ground of two triangles."""
    at = np.stack(np.meshgrid(np.arange(side), np.arange(side)), -1).reshape(-1, 2) / side * 2 - 1
    size = np.stack([rng.uniform(0.4, 0.9, len(at)) * 2 / side, rng.exponential(0.08, len(at)) + 0.01,
                     rng.uniform(0.4, 0.9, len(at)) * 2 / side], 1)
    points, faces = boxes(np.stack([at[:, 0], 0 * at[:, 0], at[:, 1]], 1), size)
    n = len(points)
    ground = np.array([[-2, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]], float)
    return np.concatenate([points, ground]), np.concatenate([faces, [[n, n + 2, n + 1], [n, n + 3, n + 2]]])


def hair(rng, strands=10000, steps=12):
    """Curved strands as strips of needles, each 1/500 as wide as long."""
    root = rng.normal(size=(strands, 3))
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    bend, side = rng.normal(0, 0.4, (strands, 3)), rng.normal(size=(strands, 3))
    side *= 0.0004 / np.linalg.norm(side, axis=1, keepdims=True)
    s = np.linspace(0, 1, steps + 1)[None, :, None]
    spine = root[:, None] * (0.5 + 0.5 * s) + bend[:, None] * s * s * 0.5
    strip = np.stack([spine - side[:, None], spine + side[:, None]], 2)
    i = np.arange(strands * (steps + 1) * 2).reshape(strands, steps + 1, 2)
    a, b, c, d = i[:, :-1, 0].ravel(), i[:, :-1, 1].ravel(), i[:, 1:, 1].ravel(), i[:, 1:, 0].ravel()
    return strip.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def ball(side):
    return sphere(side, 2 * side, lambda d: 0.8 + 0.05 * np.sin(9 * d[..., 0]) * np.sin(8 * d[..., 1]))


def layers(rng):
    """Every triangle of a sheet three times, shuffled, and squares that overlap in one plane."""
    points, faces = grid(60, lambda x, y: 0.1 * np.sin(4 * x))
    low = np.stack([rng.uniform(-1, 0.5, 400), np.full(400, 0.5), rng.uniform(-1, 0.5, 400)], 1)
    size = np.stack([rng.uniform(0.1, 0.5, 400), np.zeros(400), rng.uniform(0.1, 0.5, 400)], 1)
    more, squares = boxes(low, size)
    faces = np.concatenate([np.tile(faces, (3, 1)), squares + len(points)])
    return np.concatenate([points, more]), rng.permutation(faces)


def rooms(rng):
    """A building: thin walls and floors along the axes, and furniture of small boxes."""
    low, size = [], []
    for k in range(1000):
        low.append(rng.uniform(-1, 1, 3))
        wall = np.array([0.4, 0.4, 0.4])
        wall[k % 3] = 0.004
        size.append(wall)
    points, faces = boxes(np.concatenate([low, rng.uniform(-1, 1, (5000, 3))]), np.concatenate([size, rng.uniform(0.002, 0.03, (5000, 3))]))
    return points, faces


def moved(mesh, by, scale=1.0):
    return mesh[0] * scale + by, mesh[1]


GENERATED = {
    "terrain500k": terrain,
    "soup200k": soup,
    "bigsoup20k": lambda rng: soup(rng, 20000, 0.2),
    "soup2k": lambda rng: soup(rng, 2000, 0.1),
    "scan390k": scan,
    "city120k": city,
    "hair240k": hair,
    "rooms72k": rooms,
    "ball20k": lambda rng: ball(71),
    "ball2k": lambda rng: ball(22),
    "ball200": lambda rng: ball(7),
    "far20k": lambda rng: moved(ball(71), [1000, -2000, 3000]),
    "tiny20k": lambda rng: moved(ball(71), [0, 0, 0], 1e-12),
    "huge20k": lambda rng: moved(ball(71), [0, 0, 0], 1e12),
    "layers": layers,
    "one": lambda rng: separate(np.array([[[-1, 0, -1], [1, 0, -1], [0, 0.5, 1]]], float)),
}


# --- Files ------------------------------------------------------------------------------------

PLY_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
             "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
             "double": "f8", "float64": "f8"}


def ply_numbers(data, order):
    """The numbers of the body, one by one, by type."""
    if order is None:
        words = iter(data.split())
        return lambda kind: float(next(words))
    at = [0]

    def next_number(kind):
        t = np.dtype(order + PLY_TYPES[kind])
        at[0] += t.itemsize
        return float(np.frombuffer(data, t, 1, at[0] - t.itemsize)[0])
    return next_number


def read_ply(path):
    """Vertices and triangles; faces of more corners as fans. Only for what bench_trace reads without complaint."""
    data = path.read_bytes()
    head, _, body = data.partition(b"end_header")
    body = body[2 if body.startswith(b"\r\n") else 1:]
    elements, order = [], None
    for line in head.decode("latin-1").split("\n"):
        words = line.split()
        if words[:1] == ["format"]:
            order = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    number, points, faces = ply_numbers(body, order), [], []
    for name, count, properties in elements:
        for _ in range(count):
            row = {}
            for p in properties:
                if p[0] == "list":
                    row[p[3]] = [number(p[2]) for _ in range(int(number(p[1])))]
                else:
                    row[p[1]] = number(p[0])
            if name == "vertex":
                points.append([row["x"], row["y"], row["z"]])
            elif name == "face":
                corners = [int(c) for c in row.get("vertex_indices", row.get("vertex_index", []))]
                faces += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
    return np.array(points, float).reshape(-1, 3), np.array(faces, int).reshape(-1, 3)


def read_obj(path):
    points, faces = [], []
    for line in path.read_text(encoding="latin-1").split("\n"):
        words = line.split()
        if words[:1] == ["v"]:
            points.append([float(w) for w in words[1:4]])
        elif words[:1] == ["f"]:
            corners = [int(w.split("/")[0]) for w in words[1:]]
            corners = [c - 1 if c > 0 else len(points) + c for c in corners]
            faces += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
    return np.array(points, float).reshape(-1, 3), np.array(faces, int).reshape(-1, 3)


def write_ply(path, mesh):
    points, faces = mesh
    rows = np.zeros(len(faces), dtype=[("n", "u1"), ("v", "<u4", 3)])
    rows["n"], rows["v"] = 3, faces
    with open(path, "wb") as f:
        f.write(f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
                f"property float z\nelement face {len(faces)}\nproperty list uchar uint vertex_indices\nend_header\n".encode())
        f.write(points.astype("<f4").tobytes())
        f.write(rows.tobytes())


def write_rays(path, rays):
    org, dirs, near, far = rays
    out = np.zeros((len(org), 8), "<f4")
    out[:, :3], out[:, 4:7], out[:, 3], out[:, 7] = org, dirs, near, far
    with open(path, "wb") as f:
        f.write(struct.pack("<I", len(out)))
        f.write(out.tobytes())


# --- Rays: (origins, directions, tnear, tfar) ---------------------------------------------------


def unit(v):
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return v / np.where(length > 0, length, 1)


class Shape:
    """A mesh as its rays see it."""

    def __init__(self, mesh, rng, count):
        self.points, self.faces = mesh[0].astype(np.float32).astype(float), mesh[1]
        self.corners = self.points[self.faces]
        self.low, self.high = self.corners.min((0, 1)), self.corners.max((0, 1))
        self.centre, self.size = (self.low + self.high) / 2, np.linalg.norm(self.high - self.low) / 2 or 1.0
        self.rng, self.count = rng, count

    def on_surface(self):
        """Points drawn by area, and normals of either side."""
        e1, e2 = self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        n = np.cross(e1, e2)
        area = np.linalg.norm(n, axis=1)
        area = area if area.sum() > 0 else area + 1
        i = np.sort(self.rng.choice(len(area), self.count, p=area / area.sum()))
        u, v = self.rng.random((2, self.count, 1))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        sign = self.rng.choice([-1.0, 1.0], (self.count, 1))
        return self.corners[i, 0] + u * e1[i] + v * e2[i], sign * unit(n[i])

    def directions(self):
        return unit(self.rng.normal(size=(self.count, 3)))

    def cosine(self, n):
        return unit(n + 0.999999 * self.directions())


def camera(s):
    side = int(s.count ** 0.5)
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    away = unit(np.array([0.5, 0.4, 1.0]))
    right = unit(np.cross([0, 1, 0], away))
    up = np.cross(away, right)
    d = unit(0.42 * (x[..., None] * right + y[..., None] * up) - away).reshape(-1, 3)
    return np.broadcast_to(s.centre + 2.6 * s.size * away, d.shape), d, 0, np.inf


def bounce(s):
    p, n = s.on_surface()
    return p + 1e-5 * s.size * n, s.cosine(n), 0, np.inf


def on_surface(s):
    p, n = s.on_surface()
    return p, s.cosine(n), 0, np.inf


def shadow(s):
    p, n = s.on_surface()
    p = p + 1e-5 * s.size * n
    lamp = s.centre + s.size * (np.array([0.3, 1.2, 0.2]) + 0.2 * s.rng.uniform(-1, 1, (s.count, 3)))
    return p, lamp - p, 0, 0.9999


def segments(s):
    a, b = s.rng.uniform(s.low, s.high, (2, s.count, 3))
    return a, b - a, 0, 1


def span(s):
    """Camera rays that begin and end within the mesh."""
    org, d, _, _ = camera(s)
    near = s.size * s.rng.uniform(1.6, 2.6, len(d))
    return org, d, near, near + s.size * s.rng.uniform(0.01, 1.0, len(d))


def aimed(s):
    """At vertices and points of edges, from all sides: where a hit is a matter of the last bit."""
    i = s.rng.integers(0, len(s.faces), s.count)
    w = np.where(s.rng.random((s.count, 1)) < 0.5, 0, s.rng.random((s.count, 1)))
    at = s.corners[i, 0] * (1 - w) + s.corners[i, 1] * w
    org = s.centre + 2 * s.size * s.directions()
    return org, at - org, 0, np.inf


def axis(s):
    """Along the axes, with zeros of both signs."""
    d = np.zeros((s.count, 3)) * s.rng.choice([-1.0, 1.0], (s.count, 3))
    k = s.rng.integers(0, 3, s.count)
    d[np.arange(s.count), k] = s.rng.choice([-1.0, 1.0], s.count)
    return s.rng.uniform(s.low, s.high, (s.count, 3)) - 2 * s.size * d, d, 0, np.inf


def far_off(scales):
    def rays(s):
        d = s.directions()
        return s.rng.uniform(s.low, s.high, (s.count, 3)) - scales * s.size * d, d, 0, np.inf
    return rays


RAYS = {"camera": camera, "bounce": bounce, "surface": on_surface, "shadow": shadow, "random": segments, "span": span,
        "aimed": aimed, "axis": axis, "far1e3": far_off(1e3), "far1e6": far_off(1e6)}


# --- The table --------------------------------------------------------------------------------


def bench(options, ply, rays, extra, folder):
    out = folder / "out.json"
    command = [options.bench, "--quick", "--runs", str(options.runs), "--json", out, "--mesh", ply, "--rays", rays] + extra + options.more
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    sys.stderr.write(done.stderr)
    if done.returncode:
        print(f"{ply.name} {rays.name}: exit status {done.returncode}\n{done.stdout}")
    return json.loads(out.read_text())["cases"] if done.returncode in (0, 1) else None


def ratio(cases, what, peer="embree3"):
    return next((c["ratio"]["median"] for c in cases if c["peer"] == peer and what in (c.get("rays"), c.get("work"))), 0.0)


def one_mesh(options, name, mesh, folder):
    """Prints a line a kind of rays; True if all is well."""
    ply, rays, well = folder / "mesh.ply", folder / "rays.bin", True
    if options.keep:
        ply = pathlib.Path(options.keep) / f"{name}.ply"
    write_ply(ply, mesh)
    for kind, make in RAYS.items():
        if options.rays not in kind:
            continue
        if options.keep:
            rays = pathlib.Path(options.keep) / f"{name}-{kind}.rays"
        with np.errstate(over="ignore", invalid="ignore"):
            write_rays(rays, make(Shape(mesh, np.random.default_rng(7), options.count)))
        what = "shadow" if kind == "shadow" else "closest"
        cases = bench(options, ply, rays, ["--shadow"] if kind == "shadow" else [], folder)
        if cases is None:
            well = False
            continue
        checks = {c["check"]: c for c in cases if "check" in c}
        apart = [f"{checks[peer]['differ']} ({checks[peer]['judged']} judged, wrong {checks[peer]['wrong']}, {checks[peer]['theirs_wrong']})"
                 for peer in ("embree3", "embree3-robust") if peer in checks]
        single, batch = ratio(cases, what), ratio(cases, what + "-batch")
        print(f"{name:16} {len(mesh[1]):8} {kind:8} single {single:5.2f} batch {batch:5.2f} build {ratio(cases, 'build-medium'):5.2f}"
              f"  apart {', '.join(apart)}", flush=True)
        well = well and all(c["wrong"] == 0 and (c["check"] != "batch" or c["differ"] == 0) for c in checks.values())
    return well


def meshes(options):
    for name, make in GENERATED.items():
        if options.only in name:
            yield name, make(np.random.default_rng(1))
    for path in sorted(pathlib.Path(options.data).rglob("*")) if options.data else ():
        if path.suffix in (".ply", ".obj") and options.only in path.name and "bad" not in path.parts:
            yield path.name[:16], read_ply(path) if path.suffix == ".ply" else read_obj(path)


def main():
    p = argparse.ArgumentParser()
    p.add_argument("bench")
    p.add_argument("--data")
    p.add_argument("--only", default="")
    p.add_argument("--rays", default="")
    p.add_argument("--count", type=int, default=40000)
    p.add_argument("--runs", type=int, default=5)
    p.add_argument("--keep")
    p.add_argument("more", nargs="*")
    options = p.parse_args()
    well = True
    with tempfile.TemporaryDirectory() as folder:
        for name, mesh in meshes(options):
            if len(mesh[1]):
                well = one_mesh(options, name, mesh, pathlib.Path(folder)) and well
    sys.exit(0 if well else 1)


if __name__ == "__main__":
    main()
