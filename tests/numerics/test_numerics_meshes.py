"""Numbers in meshes, material libraries and glTF that are none, or out of range: what the table of
docs/IMPORT.md says of each, in `tilery import` and `tilery render`."""
import base64
import json
import pathlib
import struct
import sys

import numpy
import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "e2e"))
import exr_pixels  # noqa: E402
from farm import report_of, tilery  # noqa: E402

NAN, INF = float("nan"), float("inf")
PLACES = [(-1, -1, 0), (1, -1, 0), (0, 1, 0)]


def shown(folder, model):
    """(pixels, what was said) of a model rendered as it is; each pixel a number, none negative."""
    done = tilery("render", folder / model, "-o", folder / "out.exr", "--report",
                  folder / "report.json", "--workers", 1, "--size", "16x16", "--spp", 4)
    assert done.returncode == 0, done.stderr
    pixels = exr_pixels.rgb(folder / "out.exr")
    assert numpy.isfinite(pixels).all() and (pixels >= 0).all() and pixels.max() > 0
    assert report_of(folder / "report.json")["nonfinite_samples"] == 0
    return pixels, done.stderr


def imported(folder, model):
    done = tilery("import", folder / model, "-o", folder / "scene.json")
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "scene.json").read_text()), done.stdout + done.stderr


def refused(folder, model, *parts):
    done = tilery("render", folder / model, "-o", folder / "out.exr", "--workers", 1)
    assert done.returncode == 3, (done.returncode, done.stderr)
    assert all(part in done.stderr for part in parts), done.stderr
    assert not (folder / "out.exr").exists()


# --- PLY and OBJ -------------------------------------------------------------------


def ply(folder, *columns, name="m.ply"):
    """A binary PLY of the triangle; each column is (names, their values a vertex)."""
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    rows = [list(p) for p in PLACES]
    names = "xyz"
    for more, values in columns:
        names = [*names, *more]
        rows = [row + list(v) for row, v in zip(rows, values)]
    head += "".join(f"property double {n}\n" for n in names)
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (folder / name).write_bytes(head.encode() + b"".join(
        struct.pack(f"<{len(r)}d", *r) for r in rows) + struct.pack("<B3i", 3, 0, 1, 2))
    return name


NORMALS, COLORS, UVS = ("nx", "ny", "nz"), ("red", "green", "blue"), "uv"


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
def test_ply_normals(tmp_path, bad):
    """A vertex whose normal is none has none: the triangle is as flat as without normals."""
    flat, _ = shown(tmp_path, ply(tmp_path))
    ones = [(0, 0, 1), (0, 0, 1), (0, 0, 1)]
    for place in range(3):
        broken = [list(n) for n in ones]
        broken[1][place] = bad
        pixels, _ = shown(tmp_path, ply(tmp_path, (NORMALS, broken)))
        assert numpy.array_equal(pixels, flat), place


@pytest.mark.parametrize("size", [1e308, 1e-300, -0.0, 5e-324])
def test_ply_normals_of_any_length(tmp_path, size):
    straight, _ = shown(tmp_path, ply(tmp_path, (NORMALS, [(0, 0, 1)] * 3)))
    pixels, _ = shown(tmp_path, ply(tmp_path, (NORMALS, [(0, 0, size)] * 3)))
    assert numpy.array_equal(pixels, straight)


@pytest.mark.parametrize("bad, taken", [(NAN, 0), (INF, 1), (-INF, 0), (1e308, 1), (-3, 0),
                                        (1e-320, 0), (-0.0, 0)])
def test_ply_colours(tmp_path, bad, taken):
    """NaN is black, everything else is clamped."""
    expected, _ = shown(tmp_path, ply(tmp_path, (COLORS, [(taken, 0.5, 0.5)] * 3)))
    pixels, _ = shown(tmp_path, ply(tmp_path, (COLORS, [(bad, 0.5, 0.5)] * 3)))
    assert numpy.allclose(pixels, expected, rtol=1e-6, atol=1e-30)


@pytest.mark.parametrize("bad", [NAN, INF, 1e39])
def test_ply_uvs(tmp_path, bad):
    refused(tmp_path, ply(tmp_path, (UVS, [(0, 0), (0, bad), (1, 1)])), "m.ply", "vertex 2 of 3: v")


@pytest.mark.parametrize("line, expected", [
    ("v nan 0 0", "m.obj:1"), ("v 0 -1e151 0", "m.obj:1"), ("vn 0 inf 0", "m.obj:1"),
    ("vt 0 1e39", "m.obj:1"), ("vt nan", "m.obj:1")])
def test_obj_numbers(tmp_path, line, expected):
    (tmp_path / "m.obj").write_text(line + "\nv -1 -1 0\nv 1 -1 0\nv 0 1 0\nf -3 -2 -1\n")
    refused(tmp_path, "m.obj", expected, "must be a finite number")


@pytest.mark.parametrize("color", ["nan 0 0", "0 inf 0", "-4 1e300 1e-320"])
def test_obj_colours(tmp_path, color):
    (tmp_path / "m.obj").write_text("v -1 -1 0 1 1 1\nv 1 -1 0 1 1 1\n"
                                    f"v 0 1 0 {color}\nf 1 2 3\n")
    shown(tmp_path, "m.obj")


# --- MTL ---------------------------------------------------------------------------

VALUES = ["1e308", "-1e308", "1e151", "1e150", "1e-320", "-0.0", "0", "-1", "8589934592", "65535",
          "65536"]


def drawn(folder, model):
    """Rendered, whatever it shows: numbers only."""
    done = tilery("render", folder / model, "-o", folder / "out.exr", "--workers", 1, "--size",
                  "16x16", "--spp", 4)
    assert done.returncode == 0, done.stderr
    pixels = exr_pixels.rgb(folder / "out.exr")
    assert numpy.isfinite(pixels).all() and (pixels >= 0).all()


@pytest.mark.parametrize("value", ["nan", "-inf", "1e999", *VALUES])
def test_mtl(tmp_path, value):
    """Numbers over 1e150 and none at all are said with their lines; others are clamped, silently.
    A material for each word."""
    words = ["Kd", "Ke", "Ks", "Ka", "Tf", "Ns", "Ni", "d", "Tr", "illum", "Pr", "Pm", "Ps", "Pc",
             "Pcr"]
    library, mesh = "", "mtllib m.mtl\n"
    for i, word in enumerate(words):
        values = " ".join([value] * (3 if i < 5 else 1))
        library += f"newmtl {word}\nKd 0.5 0.5 0.5\n{word} {values}\n"
        mesh += f"usemtl {word}\nv {i} 0 0\nv {i + 1} 0 0\nv {i} 1 0\nf -3 -2 -1\n"
    (tmp_path / "m.mtl").write_text(library)
    (tmp_path / "m.obj").write_text(mesh)
    scene, said = imported(tmp_path, "m.obj")
    bad = value in ("nan", "-inf", "1e999") or abs(float(value)) > 1e150
    for i, word in enumerate(words):
        assert (f"m.mtl:{3 * i + 3}: " in said) == bad, (word, said)
        material = scene["materials"][word]
        for key in ("roughness", "metallic", "alpha", "clearcoat", "clearcoat_roughness"):
            assert 0 <= material.get(key, 0) <= 1
    drawn(tmp_path, "m.obj")


# --- glTF --------------------------------------------------------------------------


def gltf(folder, materials=({},), places=PLACES, normals=((0, 0, 1),) * 3, value="0", **extra):
    """A triangle of each material; "@@" in them becomes `value`, which need not be JSON."""
    data = b"".join(struct.pack("<3f", *p) for p in [*places, *normals])
    model = {
        "asset": {"version": "2.0"}, "scene": 0,
        "scenes": [{"nodes": list(range(len(materials)))}],
        "nodes": [{"mesh": i, "translation": [i, 0, 0]} for i in range(len(materials))],
        "materials": [{"name": f"m{i}", **m} for i, m in enumerate(materials)],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "material": i}]}
                   for i in range(len(materials))],
        "buffers": [{"byteLength": len(data), "uri": "data:application/octet-stream;base64," +
                     base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": 36},
                        {"buffer": 0, "byteOffset": 36, "byteLength": 36}],
        "accessors": [{"bufferView": i, "componentType": 5126, "count": 3, "type": "VEC3"}
                      for i in range(2)], **extra}
    (folder / "m.gltf").write_text(json.dumps(model).replace('"@@"', value))
    return "m.gltf"


# Of each factor the material, the path, the key that it becomes, and within what.
FACTORS = [
    ({"pbrMetallicRoughness": {"metallicFactor": "@@"}}, "metallicFactor", "metallic", 0, 1),
    ({"pbrMetallicRoughness": {"roughnessFactor": "@@"}}, "roughnessFactor", "roughness", 0, 1),
    ({"pbrMetallicRoughness": {"baseColorFactor": ["@@", 0.5, 0.5, 1]}}, "baseColorFactor[0]",
     "color", 0, 1),
    ({"alphaMode": "MASK", "alphaCutoff": "@@"}, "alphaCutoff", "alpha_cutoff", 0, 1),
    ({"emissiveFactor": ["@@", 0, 0]}, "emissiveFactor[0]", "emission", 0, 1e6),
    ({"extensions": {"KHR_materials_transmission": {"transmissionFactor": "@@"}}},
     "transmissionFactor", "transmission", 0, 1),
    ({"extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": "@@"}}}, "clearcoatFactor",
     "clearcoat", 0, 1),
    ({"extensions": {"KHR_materials_sheen": {"sheenColorFactor": ["@@", 0, 0]}}},
     "sheenColorFactor[0]", "sheen_color", 0, 1),
    ({"extensions": {"KHR_materials_specular": {"specularFactor": "@@"}}}, "specularFactor",
     "specular", 0, 1),
    ({"extensions": {"KHR_materials_specular": {"specularColorFactor": ["@@", 1, 1]}}},
     "specularColorFactor[0]", "specular_color", 0, 1e3),
    ({"extensions": {"KHR_materials_ior": {"ior": "@@"}}}, "ior", "eta", 1, 100),
]


@pytest.mark.parametrize("value", ["NaN", "Infinity", "1e999", *VALUES])
def test_gltf_factors(tmp_path, value):
    """Over 1e150, or none: errors, all in one run, with their paths. Others are clamped."""
    model = gltf(tmp_path, [f[0] for f in FACTORS], value=value)
    if value in ("NaN", "Infinity"):
        refused(tmp_path, model, "m.gltf", "[json-syntax]")
        return
    if abs(float(value)) > 1e150:
        refused(tmp_path, model, *(f"{place}: " for _, place, _, _, _ in FACTORS),
                *(f"$.materials[{i}]." for i in range(len(FACTORS))))
        return
    scene, _ = imported(tmp_path, model)
    for i, (_, _, key, low, high) in enumerate(FACTORS):
        got = scene["materials"][f"m{i}"].get(key, low)
        assert low <= (got if isinstance(got, (int, float)) else max(got)) <= high, key
    drawn(tmp_path, model)


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
def test_gltf_positions(tmp_path, bad):
    """A face at such a vertex is left out, and that is said; without another there is nothing."""
    model = gltf(tmp_path, places=[(-1, -1, 0), (1, bad, 0), (0, 1, 0)])
    refused(tmp_path, model, "m.gltf", "not finite")


@pytest.mark.parametrize("bad", [NAN, INF])
def test_gltf_normals(tmp_path, bad):
    """As in a PLY: no normal there."""
    shown(tmp_path, gltf(tmp_path, normals=[(0, 0, 1), (bad, 0, 1), (0, 0, 1)]))
