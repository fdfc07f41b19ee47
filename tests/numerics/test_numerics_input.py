"""Numbers that people give by mistake: each is an error that says what was expected, or has a
meaning that docs/NUMERICS.md gives. Nothing crashes and no picture has a pixel that is no number."""
import copy
import json
import pathlib
import struct
import sys

import numpy
import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "e2e"))
import exr_pixels  # noqa: E402
from farm import report_of, tilery  # noqa: E402

TRIANGLE = "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n"
GOOD = {
    "integrator": {"type": "path", "spp": 2, "max_depth": 4},
    "film": {"resolution": [8, 8]},
    "camera": {"position": [0, 0, 3], "look_at": [0, 0, 0], "ref_up": [0, 1, 0], "fov": 40},
    "materials": {"floor": {"type": "diffuse", "color": [0.5, 0.5, 0.5], "twosided": True},
                  "glass": {"type": "glass", "eta": 1.5}},
    "objects": [{"type": "mesh", "path": "triangle.obj", "material_name": "floor"},
                {"type": "sphere", "center": [0, 0, 1], "radius": 0.3, "material_name": "glass"},
                {"type": "sphere", "center": [0, 2, 2], "radius": 0.5,
                 "light": {"type": "area", "radiance": [4, 4, 4]}}],
}


def edited(path, value):
    """GOOD's text with one place changed; `value` is JSON text, so that it need not be valid."""
    scene = copy.deepcopy(GOOD)
    at = scene
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = "@@"
    return json.dumps(scene).replace('"@@"', value)


def run(folder, text, *options, mesh=TRIANGLE, name="triangle.obj"):
    (folder / name).write_bytes(mesh if isinstance(mesh, bytes) else mesh.encode())
    (folder / "scene.json").write_text(text)
    return tilery("render", folder / "scene.json", "-o", folder / "out.exr", "--report",
                  folder / "report.json", "--workers", 1, *options)


CAMERA, FILM, GLASS = ("camera", "position"), ("film", "resolution"), ("materials", "glass", "eta")
RADIANCE = ("objects", 2, "light", "radiance")
REFUSED = {
    "NaN": (CAMERA, "[0, 0, NaN]", ""),
    "infinity": (CAMERA, "[0, 0, Infinity]", ""),
    "1e999": (CAMERA, "[0, 0, 1e999]", "$.camera.position"),
    "1e308 position": (CAMERA, "[0, 0, 1e308]", "$.camera.position"),
    "1e308 radius": (("objects", 1, "radius"), "1e308", "$.objects[1].radius"),
    "1e308 radiance": (RADIANCE, "[1e308, 1, 1]", "$.objects[2].light.radiance"),
    "negative radiance": (RADIANCE, "[4, -1, 4]", "$.objects[2].light.radiance"),
    "zero up": (("camera", "ref_up"), "[0, 0, 0]", "$.camera"),
    "zero view": (("camera", "look_at"), "[0, 0, 3]", "$.camera"),
    "fov 0": (("camera", "fov"), "0", "$.camera.fov"),
    "fov 180": (("camera", "fov"), "180", "$.camera.fov"),
    "fov -40": (("camera", "fov"), "-40", "$.camera.fov"),
    "resolution 0": (FILM, "[0, 8]", "$.film.resolution"),
    "resolution -1": (FILM, "[8, -1]", "$.film.resolution"),
    "resolution 65536": (FILM, "[65536, 8]", "$.film.resolution"),
    "resolution 7.5": (FILM, "[7.5, 8]", "$.film.resolution"),
    "spp 0": (("integrator", "spp"), "0", "$.integrator.spp"),
    "spp 2^41": (("integrator", "spp"), "2199023255552", "$.integrator.spp"),
    "ior 0": (GLASS, "0", "$.materials.glass.eta"),
    "ior -1.5": (GLASS, "-1.5", "$.materials.glass.eta"),
    "ior 1e-300": (GLASS, "1e-300", "$.materials.glass.eta"),
    "radius 0": (("objects", 1, "radius"), "0", "$.objects[1].radius"),
    "radius -1": (("objects", 1, "radius"), "-1", "$.objects[1].radius"),
    "zero matrix": (("objects", 0, "transform"), str([0] * 16), "$.objects[0].transform"),
    "flat matrix": (("objects", 0, "transform"),
                    str([1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]),
                    "$.objects[0].transform"),
    "rank 2 matrix": (("objects", 0, "transform"),
                      str([1, 2, 3, 0, 4, 5, 6, 0, 7, 8, 9, 0, 0, 0, 0, 1]),
                      "$.objects[0].transform"),
    "projective matrix": (("objects", 0, "transform"),
                          str([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1]),
                          "$.objects[0].transform"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(tmp_path, case):
    path, value, place = REFUSED[case]
    done = run(tmp_path, edited(path, value))
    assert done.returncode == 3, (done.returncode, done.stderr)
    assert "scene.json" in done.stderr and place in done.stderr, done.stderr
    assert not (tmp_path / "out.exr").exists()


# What is unusual but means something: (place, JSON).
RENDERED = {
    "denormal position": (CAMERA, "[5e-324, 0, 3]"),
    "denormal radiance": (RADIANCE, "[5e-324, 4, 4]"),
    "1e100 radiance": (RADIANCE, "[1e100, 1, 1]"),
    "view of 1e-200": (("camera", "look_at"), "[1e-200, 0, 2.9999999999999996]"),
    "up of 1e-300": (("camera", "ref_up"), "[0, 1e-300, 0]"),
    "up of 1e150": (("camera", "ref_up"), "[0, 1e150, 0]"),
    "fov 1e-9": (("camera", "fov"), "1e-9"),
    "fov 179.999999": (("camera", "fov"), "179.999999"),
    "ior 1": (GLASS, "1"),
    "ior 1 + 1e-7": (GLASS, "1.0000001"),
    "ior 0.001": (GLASS, "0.001"),
    "ior 1000": (GLASS, "1000"),
    "radius 1e-300": (("objects", 1, "radius"), "1e-300"),
    "radius 1e140": (("objects", 1, "radius"), "1e140"),
    "camera at 1e140": (CAMERA, "[0, 0, 1e140]"),
    "sphere at 1e140": (("objects", 1, "center"), "[0, 0, -1e140]"),
    "mirror matrix": (("objects", 0, "transform"),
                      str([-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])),
    "matrix of 1e-100": (("objects", 0, "transform"),
                         str([1e-100, 0, 0, 0, 0, 1e-100, 0, 0, 0, 0, 1e-100, 0, 0, 0, 0, 1])),
    "albedo 5": (("materials", "floor", "color"), "[5, 5, 5]"),
}


# Too far, too small, too bright for the film (which is reported), or lost beside what is 10^140 times
# larger: a black picture is the right one.
NOTHING_SEEN = {"camera at 1e140", "radius 1e140", "sphere at 1e140", "1e100 radiance",
                "fov 179.999999", "matrix of 1e-100"}


@pytest.mark.parametrize("case", RENDERED)
def test_rendered(tmp_path, case):
    path, value = RENDERED[case]
    done = run(tmp_path, edited(path, value))
    assert done.returncode == 0, done.stderr
    pixels = exr_pixels.rgb(tmp_path / "out.exr")
    assert numpy.isfinite(pixels).all() and (pixels >= 0).all()
    report = report_of(tmp_path / "report.json")
    assert (pixels.max() > 0) == (case not in NOTHING_SEEN), pixels.max()
    if case == "1e100 radiance":
        assert report["nonfinite_samples"] > 0
    else:
        assert report["nonfinite_samples"] == 0, report["nonfinite_samples"]


@pytest.mark.parametrize("options, part", [
    (("--size", "0x8"), "--size"), (("--size", "65536x8"), "--size"), (("--spp", "0"), "--spp"),
    (("--spp", "1e3"), "--spp"), (("--spp", "-4"), "--spp"), (("--spp", "2199023255552"), "--spp"),
    (("--crop", "0,0,0,1"), "--crop"), (("--max-depth", "0"), "--max-depth")])
def test_options_refused(tmp_path, options, part):
    done = run(tmp_path, json.dumps(GOOD), *options)
    assert done.returncode == 2 and part in done.stderr, done.stderr


def test_large_counts_are_accepted(tmp_path):
    """65,535 x 65,535 pixels of 2^33 samples is a job; its count is exact."""
    (tmp_path / "triangle.obj").write_text(TRIANGLE)
    (tmp_path / "scene.json").write_text(json.dumps(GOOD))
    done = tilery("explain", tmp_path / "scene.json", "--json", "--size", "65535x65535", "--spp",
                  2 ** 33)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["spec"]["spp"] == 2 ** 33


MESHES = {
    "nan": ("v 0 nan 0\n" + TRIANGLE, "triangle.obj:1"),
    "infinity": ("v 0 1e999 0\n" + TRIANGLE, "triangle.obj:1"),
    "1e308": (TRIANGLE + "v 0 1e308 0\n", "triangle.obj:5"),
}


@pytest.mark.parametrize("case", MESHES)
def test_t10_bad_vertex_is_named_obj(tmp_path, case):
    mesh, place = MESHES[case]
    done = run(tmp_path, json.dumps(GOOD), mesh=mesh)
    assert done.returncode == 3 and place in done.stderr, done.stderr


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e308])
def test_t10_bad_vertex_is_named_ply(tmp_path, value):
    """The third vertex's y of a binary PLY."""
    head = ("ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty double x\n"
            "property double y\nproperty double z\nelement face 1\n"
            "property list uchar int vertex_indices\nend_header\n")
    mesh = head.encode() + struct.pack("<9d", -1, -1, 0, 1, -1, 0, 0, value, 0) + \
        struct.pack("<B3i", 3, 0, 1, 2)
    scene = copy.deepcopy(GOOD)
    scene["objects"][0]["path"] = "mesh.ply"
    done = run(tmp_path, json.dumps(scene), mesh=mesh, name="mesh.ply")
    assert done.returncode == 3 and "mesh.ply" in done.stderr, done.stderr
    assert "vertex 3 of 3: y" in done.stderr, done.stderr


@pytest.mark.parametrize("shift", ["1e-310", "1e-150", "1e-30", "1e30", "1e140"])
def test_meshes_of_any_size(tmp_path, shift):
    """A mesh, lamp and camera of that size, denormals included: a picture with light in it."""
    size = float(shift)
    scene = copy.deepcopy(GOOD)
    scene["camera"]["position"] = [0, 0, 3 * size]
    scene["objects"][1].update(center=[0, 0, size], radius=0.3 * size)
    scene["objects"][2].update(center=[0, 2 * size, 2 * size], radius=0.5 * size)
    mesh = "v %r %r 0\nv %r %r 0\nv 0 %r 0\nf 1 2 3\n" % (-size, -size, size, -size, size)
    done = run(tmp_path, json.dumps(scene), mesh=mesh)
    assert done.returncode == 0, done.stderr
    pixels = exr_pixels.rgb(tmp_path / "out.exr")
    assert numpy.isfinite(pixels).all() and pixels.max() > 0
    assert report_of(tmp_path / "report.json")["nonfinite_samples"] == 0
