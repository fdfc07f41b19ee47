"""`tilery doctor`: each kind of trouble made on purpose is found, counted and placed; good scenes
have none."""
import copy
import json
import math
import pathlib
import struct
import sys

import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "e2e"))
from farm import SCENES, tilery  # noqa: E402

SPP = {"integrator": {"type": "path", "spp": 1}, "film": {"resolution": [8, 8]},
       "camera": {"position": [0, 0, 9], "look_at": [0, 0, 0]}}


def cube(size=1.0, at=(0, 0, 0), flip=False, leave_out=0):
    """OBJ text of a closed cube of 12 triangles, normals outward."""
    lines, form = [], "v %.17g %.17g %.17g"
    for i in range(8):
        lines.append(form % tuple(at[k] + size * ((i >> k & 1) * 2 - 1) for k in range(3)))
    quads = [(1, 3, 4, 2), (5, 6, 8, 7), (1, 2, 6, 5), (3, 7, 8, 4), (1, 5, 7, 3), (2, 4, 8, 6)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    for a, b, c in faces[leave_out:]:
        lines.append(f"f {a} {c} {b}" if flip else f"f {a} {b} {c}")
    return "\n".join(lines) + "\n"


def float_ply(points, faces):
    """Binary PLY with float coordinates."""
    head = ("ply\nformat binary_little_endian 1.0\n"
            f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
            f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n")
    return head.encode() + b"".join(struct.pack("<3f", *p) for p in points) + \
        b"".join(struct.pack("<B3i", 3, *f) for f in faces)


def ball(at=(0.0, 0.0, 0.0), side=24):
    """Points and faces of a sphere."""
    points = [tuple(at[k] + v for k, v in enumerate(
        (math.sin(a) * math.cos(b), math.sin(a) * math.sin(b), math.cos(a))))
        for a in (math.pi * i / side for i in range(side + 1))
        for b in (2 * math.pi * j / side for j in range(side))]
    faces = [f for i in range(side) for j in range(side)
             for f in ((i * side + j, i * side + side + j, i * side + (j + 1) % side),
                       (i * side + (j + 1) % side, i * side + side + j,
                        i * side + side + (j + 1) % side))]
    return points, faces


def examine(folder, mesh=None, name="mesh.obj", material=None, light=None, **more):
    """The findings for one mesh and a lamp, by id."""
    scene = copy.deepcopy(SPP)
    scene["materials"] = {"it": material or {"type": "diffuse", "color": 0.5, "twosided": True}}
    scene["objects"] = [{"type": "sphere", "center": [0, 4, 0], "radius": 0.5,
                         "light": {"type": "area", "radiance": light or [4, 4, 4]}}]
    if mesh is not None:
        (folder / name).write_bytes(mesh if isinstance(mesh, bytes) else mesh.encode())
        scene["objects"].append({"type": "mesh", "path": name, "material_name": "it"})
    else:
        scene["objects"].append({"type": "sphere", "center": [0, 0, 0], "material_name": "it"})
    scene["objects"] += more.pop("objects", [])
    for key, value in more.items():
        scene[key] = value
    (folder / "scene.json").write_text(json.dumps(scene))
    done = tilery("doctor", folder / "scene.json", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    text = tilery("doctor", folder / "scene.json")
    assert text.returncode == 0
    found = {}
    for finding in said["findings"]:
        assert finding["id"] in text.stdout and finding["text"] and finding["count"] > 0
        found.setdefault(finding["id"], finding)
    return found


def test_good_scenes_are_good(tmp_path):
    assert examine(tmp_path, cube()) == {}
    assert examine(tmp_path, cube(1e-310)).keys() <= {"coarse-beside-scene"}
    assert examine(tmp_path, cube(1e140)).keys() <= {"coarse-beside-scene"}
    points, faces = ball()
    assert examine(tmp_path, float_ply(points, faces), "ball.ply").keys() <= {"flat-triangles"}
    for scene in ("veach", "two_spheres", "cbox_no_light", "sphere"):
        done = tilery("doctor", SCENES / f"{scene}.json", "--json")
        assert json.loads(done.stdout)["findings"] == [], scene


def test_t04_lost_precision_is_said(tmp_path):
    """Floats at 10^6 come in steps of 1/16; the warning has the numbers, everywhere."""
    points, faces = ball((1e6, 0, 0))
    found = examine(tmp_path, float_ply(points, faces), "far.ply")["far-from-origin"]
    assert found["object"] == 1 and "0.062" in found["text"] and "1e+06" in found["text"]
    assert "translate" in found["advice"]
    done = tilery("explain", tmp_path / "scene.json")
    assert done.returncode == 0 and "[far-from-origin]" in done.stderr and "0.062" in done.stderr


def test_far_decimals(tmp_path):
    """Six digits of decimals at 10^6 say whole steps."""
    text = "".join("v %.6g %.6g %.6g\n" % p for p in ball((1234567, 0, 0))[0])
    text += "".join("f %d %d %d\n" % tuple(i + 1 for i in f) for f in ball()[1])
    assert "steps of 10," in examine(tmp_path, text)["far-from-origin"]["text"]


def test_far_but_precise(tmp_path):
    """Doubles at 10^6 lose nothing, nor do round numbers."""
    points, faces = ball((1e6 / 3, 0, 0))
    text = "".join("v %.17g %.17g %.17g\n" % p for p in points)
    text += "".join("f %d %d %d\n" % tuple(i + 1 for i in f) for f in faces)
    assert "far-from-origin" not in examine(tmp_path, text)
    assert "far-from-origin" not in examine(tmp_path, cube(0.1, (5, 0, 0)))


def test_far_in_world(tmp_path):
    found = examine(tmp_path, cube(), objects=[
        {"type": "mesh", "path": "mesh.obj", "translate": [1e13, 0, 0], "material_name": "it"}])
    assert found["far-in-world"]["object"] == 2
    assert found["coarse-beside-scene"]["object"] in (0, 1, 2)


PLANET = {"type": "sphere", "center": [0, -1e6, 0], "radius": 1e6 - 2, "material_name": "it"}


def test_small_beside_scene(tmp_path):
    """What is small enough has floats of its own (numerics test_beyond); doubles end later."""
    assert "coarse-beside-scene" not in examine(tmp_path, cube(0.001), objects=[PLANET])
    found = examine(tmp_path, cube(1e-8), objects=[PLANET])
    assert found["coarse-beside-scene"]["object"] == 1
    assert "1.1e-10" in found["coarse-beside-scene"]["text"]
    # Lamps have not, nor has what is large and finely divided.
    lamp = {"type": "mesh", "path": "mesh.obj", "light": {"type": "area", "radiance": 1}}
    assert examine(tmp_path, cube(0.001), objects=[PLANET, lamp])[
        "coarse-beside-scene"]["object"] == 3
    points, faces = ball(side=60)
    fine = "".join("v %.17g %.17g %.17g\n" % tuple(100 * v for v in p) for p in points)
    fine += "".join("f %d %d %d\n" % tuple(i + 1 for i in f) for f in faces)
    assert examine(tmp_path, fine, objects=[PLANET])["coarse-beside-scene"]["object"] == 1
    # In the middle of the same ground floats are fine.
    found = examine(tmp_path, cube(0.001), objects=[
        {"type": "sphere", "center": [0, 0, 0], "radius": 1e6, "material_name": "it"}])
    assert "coarse-beside-scene" not in found


def test_tiny_sphere(tmp_path):
    """Spheres of 1e-9 and 1e9 that touch: the small one's place is lost in double, too."""
    small = {"type": "sphere", "center": [0, 1e-9, 0], "radius": 1e-9, "material_name": "it"}
    huge = {"type": "sphere", "center": [0, -1e9, 0], "radius": 1e9, "material_name": "it"}
    found = examine(tmp_path, objects=[huge, small])
    assert found["coarse-beside-scene"]["object"] == 3
    assert examine(tmp_path, objects=[small]) == {}


def test_many_alike(tmp_path):
    """A thousand objects with one trouble: some are listed, the others counted."""
    glass = [{"type": "mesh", "path": "mesh.obj", "translate": [3 * i, 0, 0],
              "material_name": "it"} for i in range(1, 1000)]
    examine(tmp_path, cube(leave_out=2), material={"type": "glass"}, objects=glass)
    done = tilery("doctor", tmp_path / "scene.json", "--json")
    found = [f for f in json.loads(done.stdout)["findings"] if f["id"] == "open-glass"]
    assert len(found) == 16 and sum(f["more"] for f in found) == 1000 - 16
    assert "and 984 more of this kind" in tilery("doctor", tmp_path / "scene.json").stdout


def test_shapes(tmp_path):
    mesh = cube() + "v 0 0 5\nv 1 0 5\nv 2 0 5\nf 9 10 11\nv 1 1e-6 7\nv 0 0 7\nv 2 0 7\n" \
        "f 12 13 14\n" + "f 1 3 4\n" * 2
    found = examine(tmp_path, mesh)
    assert found["flat-triangles"]["count"] == 1 and found["flat-triangles"]["triangle"] == 12
    assert found["needle-triangles"]["count"] == 1 and found["needle-triangles"]["triangle"] == 13
    assert found["needle-triangles"]["at"] == pytest.approx([1, 1e-6 / 3, 7])
    assert found["duplicate-triangles"]["count"] == 2


def test_sides(tmp_path):
    glass = {"type": "glass"}
    assert examine(tmp_path, cube(), material=glass) == {}
    found = examine(tmp_path, cube(leave_out=2), material=glass)
    assert found.keys() == {"open-glass"} and found["open-glass"]["count"] == 4
    assert examine(tmp_path, cube(flip=True), material=glass).keys() == {"inside-out"}
    one_sided = {"type": "diffuse", "color": 0.5}
    assert examine(tmp_path, cube(flip=True), material=one_sided).keys() == {"inside-out"}
    # A room is seen from inside: its normals are right.
    room = {**SPP["camera"], "position": [0, 0, 0], "look_at": [0, 0, -1]}
    assert examine(tmp_path, cube(flip=True), material=one_sided, camera=room) == {}
    lines = cube().splitlines()
    a, b, c = lines[-1].split()[1:]
    lines[-1] = f"f {a} {c} {b}"
    mixed = "\n".join(lines) + "\n"
    found = examine(tmp_path, mixed, material=one_sided)
    assert found.keys() == {"mixed-winding"} and found["mixed-winding"]["count"] == 3
    assert "twosided" in found["mixed-winding"]["advice"]
    found = examine(tmp_path, mixed, material=glass)
    assert found.keys() == {"mixed-winding"} and "leaves" in found["mixed-winding"]["advice"]
    metal = {"type": "roughconductor", "R": 1}
    assert examine(tmp_path, mixed, material=metal).keys() == {"mixed-winding"}
    assert examine(tmp_path, cube(flip=True), material=metal).keys() == {"inside-out"}
    # A material whose sides are alike does not mind.
    assert examine(tmp_path, mixed) == {} and examine(tmp_path, cube(flip=True)) == {}


def test_mirrored_copy(tmp_path):
    """A mirroring transform turns a mesh without normals inside out."""
    mirror = [-1, 0, 0, 3, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    found = examine(tmp_path, cube(), material={"type": "glass"}, objects=[
        {"type": "mesh", "path": "mesh.obj", "transform": mirror, "material_name": "it"}])
    assert found["inside-out"]["object"] == 2


def test_normals(tmp_path):
    mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvn 0 0 -1\nf 1//1 2//1 3//2\n"
    assert examine(tmp_path, mesh)["normals-disagree"]["triangle"] == 0


def test_coincident_objects(tmp_path):
    again = {"type": "mesh", "path": "mesh.obj", "material_name": "it"}
    found = examine(tmp_path, cube(), objects=[again, again])
    assert found["coincident-objects"]["count"] == 2
    assert found["coincident-objects"]["object"] == 2


LIGHT = {"radiance-over-float": [1e37, 1, 1], "radiance-over-half": [7e4, 7e4, 7e4],
         "radiance-tiny": [1e-35, 1e-35, 1e-35], "radiance-spread": [1e6, 0.5, 1]}


@pytest.mark.parametrize("case", LIGHT)
def test_light(tmp_path, case):
    assert examine(tmp_path, light=LIGHT[case])[case]["object"] == 0


def test_materials(tmp_path):
    assert "albedo-over-one" in examine(tmp_path, material={"type": "diffuse", "color": [1.2, 0, 0]})
    assert "ior-below-one" in examine(tmp_path, material={"type": "glass", "eta": 0.75})


def test_textures(tmp_path):
    """Samples that are no numbers: how many, in which file."""
    from exr_pixels import write
    import numpy
    pixels = numpy.ones((4, 4, 3), dtype="f4")
    pixels[1, 2] = numpy.nan
    pixels[3, 3, 0] = numpy.inf
    write(tmp_path / "bad.exr", pixels)
    found = examine(tmp_path, cube(), textures={"t": {"type": "image", "path": "bad.exr"}},
                    environment_map={"texture_name": "t"})
    assert found["not-finite"]["count"] == 4 and "bad.exr" in found["not-finite"]["where"] + \
        found["not-finite"]["text"]


def test_models(tmp_path):
    """Models of other programs: all that is said of a good one is that it has no light; what reading
    left out is placed by file and line; one of a kind is not called many."""
    (tmp_path / "good.obj").write_text(cube())
    done = tilery("doctor", tmp_path / "good.obj")
    assert done.returncode == 0 and "1 finding in 1 mesh, 12 triangles" in done.stdout, done.stdout
    assert "[sky-added]" in done.stdout
    (tmp_path / "odd.obj").write_text(cube(leave_out=11) + "f 1 2\nf 1 1 2\n")
    done = tilery("doctor", tmp_path / "odd.obj")
    assert "odd.obj:10: " in done.stdout and "[degenerate-face]" in done.stdout
    assert "1 of 2 triangles has no area" in done.stdout
    (tmp_path / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert "in 1 mesh, 1 triangle\n" in tilery("doctor", tmp_path / "one.obj").stdout


def test_bad_scene(tmp_path):
    (tmp_path / "scene.json").write_text("{}")
    done = tilery("doctor", tmp_path / "scene.json")
    assert done.returncode == 3 and done.stdout == ""
