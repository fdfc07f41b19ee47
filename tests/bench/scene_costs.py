#!/usr/bin/env python3
"""Measures what a scene costs: bytes sent, memory, trees, the second job, the start. Prints the tables of docs/SPECIALISE.md.

usage: scene_costs.py BIN_DIR [MODELS_DIR]

BIN_DIR is bin/ of a release build; MODELS_DIR holds models to be explained (obj/, ply/, gltf/). The farm binds
loopback and keeps its data in a temporary folder.
"""
import json
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

MODELS = ["obj/spot/spot_triangulated.obj", "obj/spaceship/red.obj", "obj/c-ray/teapot.obj", "ply/trimesh/fixed_top.ply",
          "gltf/FlightHelmet-small/FlightHelmet.gltf", "gltf/SheenChair/glTF/SheenChair.gltf",
          "gltf/Avocado/glTF/Avocado.gltf", "gltf/AlphaBlendModeTest/glTF-Binary/AlphaBlendModeTest.glb"]
RUNS = 11


def run(*command, **more):
    return subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True, **more)


def explain(bin_dir, path):
    return json.loads(run(bin_dir / "tilery", "explain", path, "--json").stdout)


def models(bin_dir, folder):
    print("| model | triangles | source | plain, all | left out | sent | sent / source | memory a triangle |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name in MODELS:
        path = folder / name
        if not path.exists():
            continue
        e = explain(bin_dir, path)
        b, n = e["bytes"], e["triangles_instanced"]
        print(f"| {path.name} | {n:,} | {b['source']:,} | {b['plain'] + b['left_out']:,} | {b['left_out']:,} | {b['package']:,} "
              f"| {b['package'] / b['source']:.2f} | {(b['tree'] + b['geometry']) / n:.0f} |")


SIDE = 90   # of a sheet of 2 x SIDE^2 triangles, with half as many vertices


def sheet(normals, uvs):
    """A bumpy sheet as an OBJ, coordinates with as many digits as modellers write."""
    lines = []
    for y in range(SIDE + 1):
        for x in range(SIDE + 1):
            lines.append(f"v {x / SIDE:.6f} {y / SIDE:.6f} {0.02 * math.sin(x * 0.7) * math.cos(y * 0.9):.6f}")
    for y in range(SIDE + 1) if normals else ():
        for x in range(SIDE + 1):
            lines.append(f"vn {-0.1 * math.cos(x * 0.7):.4f} {0.1 * math.sin(y * 0.9):.4f} 0.9900")
    for y in range(SIDE + 1) if uvs else ():
        for x in range(SIDE + 1):
            lines.append(f"vt {x / SIDE + 0.01 * math.sin(y * 0.9):.6f} {y / SIDE + 0.01 * math.cos(x * 0.7):.6f}")
    for y in range(SIDE):
        for x in range(SIDE):
            a = y * (SIDE + 1) + x + 1
            corners = [f"{v}/{v if uvs else ''}/{v if normals else ''}".rstrip("/") for v in (a, a + 1, a + SIDE + 2, a + SIDE + 1)]
            lines += ["f " + " ".join(corners[k] for k in (0, 1, 2)), "f " + " ".join(corners[k] for k in (0, 2, 3))]
    return "\n".join(lines) + "\n"


def features(bin_dir, folder):
    """Bytes a triangle of one sheet, by what its file has and what its scene reads."""
    print(f"\nA sheet of {2 * SIDE * SIDE:,} triangles:\n")
    print("| the file has | the scene reads | sent, bytes a triangle | memory, bytes a triangle |")
    print("|---|---|---:|---:|")
    rows = [((False, False), False), ((True, False), False), ((False, True), False), ((False, True), True),
            ((True, True), False), ((True, True), True)]
    for (normals, uvs), textured in rows:
        (folder / "sheet.obj").write_text(sheet(normals, uvs))
        texture = {"type": "checkerboard", "color0": [0.2, 0.2, 0.2], "color1": [0.8, 0.8, 0.8]} if textured \
            else {"type": "constant", "color": [0.5, 0.5, 0.5]}
        scene = folder / "sheet.json"
        scene.write_text(json.dumps({
            "integrator": {"type": "path", "spp": 1}, "film": {"resolution": [64, 64]},
            "camera": {"position": [0.5, 0.5, 2], "look_at": [0.5, 0.5, 0], "ref_up": [0, 1, 0], "fov": 40},
            "textures": {"t": texture}, "materials": {"m": {"type": "diffuse", "texture_name": "t"}},
            "objects": [{"type": "mesh", "path": "sheet.obj", "material_name": "m"},
                        {"type": "sphere", "center": [3, 5, 4], "radius": 1, "light": {"type": "area", "radiance": [20, 20, 20]}}]}))
        e = explain(bin_dir, scene)
        sent = sum(c["sent"] for c in e["chunks"] if c["kind"] == "mesh")
        has = ", ".join(["positions"] + ["normals"] * normals + ["texture coordinates"] * uvs)
        memory = (e["bytes"]["tree"] + e["bytes"]["geometry"]) / e["triangles_instanced"]
        print(f"| {has} | {'a texture' if textured else 'none'} | {sent / e['triangles_instanced']:.1f} | {memory:.0f} |")


def rooms(bin_dir, folder):
    """A scene of 200 rooms of which the camera sees three, with trees built when met and all at once."""
    maker = pathlib.Path(__file__).resolve().parents[2] / "scenes" / "make_rooms.py"
    run(sys.executable, maker, bin_dir / "gen_mesh", folder / "rooms")
    print("\n| trees | built | scene, MB | peak of the worker, MB | load s | build s | first result s | processor time of the worker s |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name, more in (("of what rays meet", ()), ("all (`--eager`)", ("--eager",))):
        data = folder / ("farm" + "".join(more))
        data.mkdir()
        farm = Farm(bin_dir, data)
        log = open(data / "worker.log", "w+")
        worker = subprocess.Popen([str(bin_dir / "tilery-worker"), "--master", farm.listen, "--threads", "1", *more],
                                  stdout=subprocess.PIPE, stderr=log, text=True)
        worker.stdout.readline()
        report = farm.job(folder / "rooms" / "rooms.json", "--size", "160x120", "--spp", "4")
        status = pathlib.Path(f"/proc/{worker.pid}/status").read_text()
        peak = int(status.split("VmHWM:")[1].split()[0])
        cpu = sum(int(x) for x in pathlib.Path(f"/proc/{worker.pid}/stat").read_text().split()[13:15]) / os.sysconf("SC_CLK_TCK")
        for program in (worker, farm.master):
            program.terminate()
            program.wait()
        log.seek(0)
        words = dict(w.split("=", 1) for line in log for w in line.split() if "=" in w and ("trees met" in line or "scene ready" in line))
        s = report["seconds"]
        built = f"{words['built']} of {words['of']}" if "of" in words else "all"
        print(f"| {name} | {built} | {int(words['bytes']) / 1e6:.0f} | {peak / 1e3:.0f} | {s['load']:.2f} | {s['build']:.2f} "
              f"| {s['first_result']:.2f} | {cpu:.2f} |")
        print(f"  picture {report['image_sha256'][:16]}", file=sys.stderr)


def gallery(bin_dir, folder):
    """60 pictures of which the camera sees three, and all of them; and one large one, of which it sees a part, and all. Fetched
    when met and at once; runs interleaved."""
    scenes = pathlib.Path(__file__).resolve().parents[2] / "scenes"
    run(sys.executable, scenes / "make_gallery.py", folder / "gallery")
    run(sys.executable, scenes / "make_floor.py", folder / "large")
    print("\n| scene | pictures | sent, MB | total s | first result s | peak of the worker, MB |")
    print("|---|---|---:|---:|---:|---:|")
    for name in ("gallery/rooms", "gallery/wall", "large/floor", "large/wall"):
        data = folder / f"farm-{name.replace('/', '-')}"
        data.mkdir()
        compare_late(bin_dir, data, folder / f"{name}.json", name)


def compare_late(bin_dir, data, scene, title):
    farm = Farm(bin_dir, data)
    rows = {}
    for turn in range(-1, 5):
        for name, more in (("when met", ()), ("all at once (`--eager`)", ("--eager",))):
            worker = farm.start("tilery-worker", "--master", farm.listen, "--threads", "2", *more)
            worker.stdout.readline()
            report = farm.job(scene, "--spp", "4", "--seed", str(turn + 2))
            status = pathlib.Path(f"/proc/{worker.pid}/status").read_text()
            worker.terminate()
            worker.wait()
            s = report["seconds"]
            if turn >= 0:  # the first sends the package to the master
                rows.setdefault(name, []).append((report["bytes"]["scene_sent"] / 1e6, s["total"], s["first_result"],
                                                  int(status.split("VmHWM:")[1].split()[0]) / 1e3))
    for name, values in rows.items():
        sent, total, first, peak = (statistics.median(column) for column in zip(*values))
        print(f"| {title} | {name} | {sent:.1f} | {total:.2f} | {first:.2f} | {peak:.0f} |")
    farm.master.terminate()
    farm.master.wait()


def ball_scene(bin_dir, folder, side):
    run(bin_dir / "gen_mesh", "ball", side, 0.1, folder / "ball.ply")
    scene = folder / "ball.json"
    scene.write_text(json.dumps({
        "integrator": {"type": "path", "spp": 1}, "film": {"resolution": [64, 64]},
        "camera": {"position": [0, 0, 3], "look_at": [0, 0, 0], "ref_up": [0, 1, 0], "fov": 40},
        "textures": {"grey": {"type": "constant", "color": [0.5, 0.5, 0.5]}},
        "materials": {"m": {"type": "diffuse", "texture_name": "grey"}},
        "objects": [{"type": "mesh", "path": "ball.ply", "material_name": "m"},
                    {"type": "sphere", "center": [3, 5, 4], "radius": 1,
                     "light": {"type": "area", "radiance": [20, 20, 20]}}]}))
    return scene


class Farm:
    """A master, and workers that come and go, sharing one cache folder."""

    def __init__(self, bin_dir, folder):
        self.bin, self.folder = bin_dir, folder
        self.master = self.start("tilery-master", "--listen", "127.0.0.1:0", "--http", "127.0.0.1:0", "--data", folder / "data")
        bound = json.loads(self.master.stdout.readline())
        self.listen = bound["listen"]
        self.environment = {**os.environ, "TILERY_MASTER": f"http://{bound['http']}"}

    def start(self, program, *arguments):
        return subprocess.Popen([str(self.bin / program), *map(str, arguments)], stdout=subprocess.PIPE, text=True,
                                stderr=subprocess.DEVNULL)

    def worker(self):
        worker = self.start("tilery-worker", "--master", self.listen, "--threads", "2", "--cache", self.folder / "cache")
        worker.stdout.readline()
        return worker

    def job(self, scene, *options):
        job = run(self.bin / "tilery", "submit", scene, *options, env=self.environment).stdout.strip()
        run(self.bin / "tilery", "watch", job, env=self.environment)
        return json.loads(run(self.bin / "tilery", "status", job, "--json", env=self.environment).stdout)


def second_job(bin_dir, folder):
    scene = ball_scene(bin_dir, folder, 290)
    farm = Farm(bin_dir, folder)
    print(f"\nA ball of {12 * 290 * 290:,} triangles, one worker of two threads:\n")
    print("| job | scene bytes sent | load s | build s | total s |")
    print("|---|---:|---:|---:|---:|")

    def row(name, report):
        s = report["seconds"]
        print(f"| {name} | {report['bytes']['scene_sent']:,} | {s['load'] or 0:.3f} | {s['build'] or 0:.3f} | {s['total']:.3f} |")

    worker = farm.worker()
    row("first", farm.job(scene))
    row("second, other seed", farm.job(scene, "--seed", "2"))
    row("third, other size", farm.job(scene, "--size", "96x48"))
    restarts = []
    for turn in range(RUNS):
        worker.terminate()
        worker.wait()
        worker = farm.worker()
        report = farm.job(scene, "--seed", str(turn + 3))
        if turn == 0:
            row("after a restart of the worker", report)
        restarts.append(report["seconds"])
    for name, of in (("loaded and built", lambda s: s["load"] + s["build"]), ("first result", lambda s: s["first_result"])):
        times = sorted(1e3 * of(s) for s in restarts)
        print(f"\nOf {RUNS} restarts, {name} after: least {times[0]:.0f} ms, median {statistics.median(times):.0f}, most {times[-1]:.0f}")
    for program in (worker, farm.master):
        program.terminate()
        program.wait()


def start(bin_dir, folder):
    scene = pathlib.Path(__file__).resolve().parents[2] / "scenes" / "cbox.json"
    wall, cpu, first = [], [], []
    for _ in range(RUNS):
        before, began, clock = os.times(), time.perf_counter(), time.time()
        run(bin_dir / "tilery", "render", scene, "-o", folder / "o.exr", "--spp", "1", "--size", "64x64", "--quiet",
            "--report", folder / "r.json")
        wall.append(time.perf_counter() - began)
        after = os.times()
        cpu.append(after.children_user + after.children_system - before.children_user - before.children_system)
        report = json.loads((folder / "r.json").read_text())
        first.append(report["started"] - clock + report["seconds"]["first_result"])
    print(f"\n`tilery render` of the Cornell box at 64x64, 1 spp, of {RUNS} runs: least {1e3 * min(wall):.0f} ms, median "
          f"{1e3 * statistics.median(wall):.0f} ms; first pixel at {1e3 * min(first):.0f} ms, median {1e3 * statistics.median(first):.0f} "
          f"ms; processor time of all four processes, mean {1e3 * statistics.mean(cpu):.0f} ms")


def million(bin_dir, folder):
    """A mesh of a million triangles: the first pixel, and what comes before it."""
    scene = ball_scene(bin_dir, folder, 290)
    print(f"\n`tilery render` of {12 * 290 * 290:,} triangles, medians of {RUNS} runs (least to most), ms:\n")
    print("| workers x threads | ready | of that read | of that pack | send | load | build | first pixel | over read + build | processor time |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
    rows = {}
    for _ in range(RUNS):
        for workers, threads in ((2, 1), (1, 2), (1, 1)):
            before, clock = os.times(), time.time()
            run(bin_dir / "tilery", "render", scene, "-o", folder / "o.exr", "--spp", "1", "--size", "64x64", "--quiet",
                "--report", folder / "r.json", "--workers", workers, "--threads", threads)
            after = os.times()
            report = json.loads((folder / "r.json").read_text())
            start, s = report["start"], report["seconds"]
            first = report["started"] - clock + s["first_result"]
            rows.setdefault(f"{workers} x {threads}", []).append(
                [1e3 * t for t in (start["ready"], start["read"], start["pack"], start["send"], s["load"], s["build"], first)] +
                [first / (start["read"] + s["build"]),
                 1e3 * (after.children_user + after.children_system - before.children_user - before.children_system)])
    for name, values in rows.items():
        cells = [f"{statistics.median(c):.{d}f} ({min(c):.{d}f} to {max(c):.{d}f})"
                 for c, d in zip(zip(*values), (0, 0, 0, 0, 0, 0, 0, 2, 0))]
        print(f"| {name} | {' | '.join(cells)} |")


def main():
    bin_dir = pathlib.Path(sys.argv[1]).resolve()
    if len(sys.argv) > 2:
        models(bin_dir, pathlib.Path(sys.argv[2]))
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        features(bin_dir, folder)
        rooms(bin_dir, folder)
        gallery(bin_dir, folder)
        second_job(bin_dir, folder)
        start(bin_dir, folder)
        million(bin_dir, folder)


if __name__ == "__main__":
    main()
