"""T1 to T4 and T22 end to end: scene files scaled, moved and brightened, rendered by the programs.

TILERY_LONG=1 takes all the steps of the matrix instead of a few.
"""
import copy
import json
import math
import os
import pathlib
import sys

import numpy
import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "e2e"))
import exr_pixels  # noqa: E402
from farm import SCENES, report_of, tilery  # noqa: E402

LONG = bool(os.environ.get("TILERY_LONG"))


def obj(path):
    """(points, faces) of an OBJ of ours."""
    points, faces = [], []
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            points.append([float(w) for w in words[1:4]])
        elif words[:1] == ["f"]:
            faces.append([w.split("/")[0] for w in words[1:]])
    return numpy.array(points), faces


class Scene:
    """A scene in memory: its JSON and its meshes, to be moved, scaled and written anywhere."""

    def __init__(self, name):
        self.json = json.loads((SCENES / f"{name}.json").read_text())
        self.meshes = {o["path"]: obj(SCENES / o["path"]) for o in self.json["objects"]
                       if o["type"] == "mesh"}

    def copy(self):
        return copy.deepcopy(self)

    def points(self):
        """Every place in the scene, as (container, key)."""
        camera, integrator = self.json["camera"], self.json["integrator"]
        yield from ((camera, "position"), (camera, "look_at"))
        if "point_light_position" in integrator:
            yield integrator, "point_light_position"
        yield from ((o, "center") for o in self.json["objects"] if "center" in o)
        yield from ((light, "position") for light in self.json.get("lights", []))

    def shifts(self):
        """Every place relative to another, as (container, key); rotations are not in our scenes."""
        for o in self.json["objects"]:
            assert "transform" not in o
            if "translate" in o:
                yield o, "translate"

    def scaled(self, factor):
        """Everything times `factor`, flux times its square: the same picture."""
        new = self.copy()
        for holder, key in [*new.points(), *new.shifts()]:
            holder[key] = [v * factor for v in holder[key]]
        for o in new.json["objects"]:
            if o["type"] == "sphere":
                o["radius"] = o.get("radius", 1) * factor
        new.meshes = {p: (v * factor, f) for p, (v, f) in new.meshes.items()}
        flux = new.json["integrator"].get("point_light_flux")
        if flux:
            new.json["integrator"]["point_light_flux"] = [v * factor * factor for v in flux]
        for light in new.json.get("lights", []):
            light["intensity"] = [v * factor * factor for v in light["intensity"]]
        return new

    def moved(self, offset):
        """Everything moved, in the files' own doubles."""
        new = self.copy()
        for holder, key in new.points():
            holder[key] = [v + o for v, o in zip(holder[key], offset)]
        new.meshes = {p: (v + numpy.array(offset), f) for p, (v, f) in new.meshes.items()}
        return new

    def brighter(self, factor):
        new = self.copy()
        flux = new.json["integrator"].get("point_light_flux")
        if flux:
            new.json["integrator"]["point_light_flux"] = [v * factor for v in flux]
        for o in new.json["objects"]:
            if "light" in o:
                o["light"]["radiance"] = [v * factor for v in o["light"]["radiance"]]
        return new

    def snapped(self, bits):
        """Coordinates rounded to multiples of 2^-bits, so that moving by a multiple is exact."""
        new = self.copy()
        unit = 2.0 ** -bits
        for holder, key in [*new.points(), *new.shifts()]:
            holder[key] = [round(v / unit) * unit for v in holder[key]]
        new.meshes = {p: (numpy.round(v / unit) * unit, f) for p, (v, f) in new.meshes.items()}
        return new

    def write(self, folder):
        (folder / "meshes").mkdir(parents=True)
        for path, (points, faces) in self.meshes.items():
            text = "".join("v %.17g %.17g %.17g\n" % tuple(p) for p in points)
            text += "".join("f " + " ".join(f) + "\n" for f in faces)
            (folder / path).write_text(text)
        (folder / "scene.json").write_text(json.dumps(self.json))
        return folder / "scene.json"

    def render(self, folder, *options):
        """(pixels, report, what was said on standard error)"""
        scene = self.write(folder)
        out, report = folder / "out.exr", folder / "report.json"
        done = tilery("render", scene, "-o", out, "--report", report, "--workers", 1, *options)
        assert done.returncode == 0, done.stderr
        return exr_pixels.rgb(out), report_of(report), done.stderr


SMALL = ("--size", "20x20", "--spp", "2")
REPORT, LAMP = "cbox_no_light_refract", "cbox"  # the report's integrator; the path integrator


def exponents(limit, long_step, short_step):
    return range(-limit, limit + 1, long_step if LONG else short_step)


@pytest.mark.parametrize("name", [REPORT, LAMP])
def test_t01_scale_by_the_farm(tmp_path, name):
    """Times 2^k: the same hash."""
    scene = Scene(name)
    hashes = {k: scene.scaled(2.0 ** k).render(tmp_path / str(k), *SMALL)[1]["image_sha256"]
              for k in exponents(40, 4, 20)}
    assert len(set(hashes.values())) == 1, hashes


@pytest.mark.parametrize("name", [REPORT, LAMP])
def test_t02_radiance_by_the_farm(tmp_path, name):
    """Light times 2^k: every pixel times 2^k, to the bit."""
    scene = Scene(name)
    first, report, _ = scene.render(tmp_path / "first", *SMALL)
    for k in exponents(100, 10, 50):
        pixels, report, _ = scene.brighter(2.0 ** k).render(tmp_path / str(k), *SMALL)
        assert report["nonfinite_samples"] == 0
        assert numpy.array_equal(pixels, numpy.ldexp(first, k)), k


def test_t02_half_is_clamped_and_said(tmp_path):
    """Beyond a half float's 65504 values are clamped, counted and said."""
    scene = Scene(LAMP).brighter(2.0 ** 16).write(tmp_path / "bright")
    out, half = tmp_path / "out.exr", tmp_path / "half.exr"
    for path, options in ((out, ()), (half, ("--half",))):
        done = tilery("render", scene, "-o", path, "--workers", 1, *SMALL, *options)
        assert done.returncode == 0, done.stderr
    over = int((exr_pixels.rgb(out) > 65504).sum())
    assert over > 0 and f"{over} values over 65504" in done.stderr, done.stderr


def floating_ball():
    """A ball of triangles over nothing, lit from the camera: its outline is the picture."""
    scene = Scene(REPORT)
    side = 16
    points = numpy.array([(math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a))
                          for a in (math.pi * i / side for i in range(side + 1))
                          for b in (2 * math.pi * j / side for j in range(side))])
    faces = [tuple(str(n + 1) for n in f) for i in range(side) for j in range(side)
             for f in ((i * side + j, i * side + side + j, i * side + (j + 1) % side),
                       (i * side + (j + 1) % side, i * side + side + j,
                        i * side + side + (j + 1) % side))]
    scene.json["objects"] = [{"type": "mesh", "path": "meshes/ball.obj", "material_name": "grey"}]
    scene.json["integrator"]["point_light_position"] = [0.3, 0.7, 6]
    scene.json["camera"] = {"position": [0, 0, 6], "look_at": [0, 0, 0], "fov": 25}
    scene.meshes = {"meshes/ball.obj": (points, faces)}
    return scene


def edge_band(mask):
    """Pixels with a neighbour on the other side of the outline."""
    band = numpy.zeros_like(mask)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            band |= numpy.roll(mask, (dy, dx), (0, 1)) != mask
    return band


def test_t03_powers_of_ten(tmp_path):
    """Times 10^k, k = -12 to 12: no pixel lost or won but on the outline; the mean stays."""
    scene, options = floating_ball(), ("--size", "48x48", "--spp", "4")
    first, report, _ = scene.render(tmp_path / "first", *options)
    mask, band = first[:, :, 0] > 0, edge_band(first[:, :, 0] > 0)
    error = report["error"]
    sigma = (error["mean_high"] - error["mean_low"]) / 4
    for k in exponents(12, 1, 6):
        pixels, _, _ = scene.scaled(10.0 ** k).render(tmp_path / str(k), *options)
        lost = ((pixels[:, :, 0] > 0) != mask) & ~band
        assert lost.sum() == 0, (k, int(lost.sum()))
        assert abs(float(pixels.mean()) - float(first.mean())) <= 4 * max(sigma, 1e-9), k


def relmse(x, r):
    x, r = x.astype(float), r.astype(float)
    return float(((x - r) ** 2 / (r ** 2 + 0.01 * r.mean() ** 2)).mean())


def test_t04_translated_by_the_farm(tmp_path):
    """Moved by 10^k in the files' doubles: as near the truth as where it was."""
    scene, options = Scene(LAMP), ("--size", "20x20", "--spp", "8")
    truth, _, _ = scene.render(tmp_path / "truth", "--size", "20x20", "--spp", "1024", "--seed", "9")
    here, _, _ = scene.render(tmp_path / "here", *options)
    floor = relmse(here, truth)
    for k in range(0, 9, 1 if LONG else 4):
        offset = [10.0 ** k, -(10.0 ** k), 10.0 ** k]
        pixels, _, said = scene.moved(offset).render(tmp_path / str(k), *options)
        ratio = relmse(pixels, truth) / floor
        print(f"T4 10^{k}: {ratio:.6f} of the noise floor")
        assert ratio <= 1.05, (k, ratio)


@pytest.mark.parametrize("name", [REPORT, LAMP])
def test_t04_dyadic_by_the_farm(tmp_path, name):
    """Coordinates in multiples of 2^-20 moved by powers of two lose nothing: the same hash."""
    scene = Scene(name).snapped(20)
    hashes = {k: scene.moved([2.0 ** k, 2.0 ** k, -(2.0 ** k)])
              .render(tmp_path / str(k), *SMALL)[1]["image_sha256"] for k in (0, 10, 27)}
    hashes["here"] = scene.render(tmp_path / "here", *SMALL)[1]["image_sha256"]
    assert len(set(hashes.values())) == 1, hashes


def test_t22_last_pixels_by_the_farm(tmp_path):
    """A corner of 65,535 x 65,535 pixels: pixel numbers beyond 2^32."""
    scene = Scene(LAMP)
    corner = ("--size", "65535x65535", "--spp", "2", "--crop")
    pixels, report, _ = scene.render(tmp_path / "all", *corner, "65519,65519,16,16")
    assert report["samples"] == 16 * 16 * 2 and report["nonfinite_samples"] == 0
    part, _, _ = scene.render(tmp_path / "part", *corner, "65530,65525,5,10")
    assert numpy.array_equal(part, pixels[6:16, 11:16])
