"""Bad input: exit 3, every problem with its place, no job made, nothing written."""
import copy
import json
import os
import re
import shutil
import subprocess

import pytest

from farm import BIN, ROOT, SEED_SCENE, Farm, clean_env, tilery, wait_until

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"

GOOD = {
    "integrator": {"type": "path", "spp": 1, "max_depth": 3},
    "film": {"resolution": [8, 8]},
    "camera": {"position": [0, 0, 3], "look_at": [0, 0, 0], "fov": 40},
    "textures": {"grey": {"type": "constant", "color": [0.5, 0.5, 0.5]}},
    "materials": {"floor": {"type": "diffuse", "texture_name": "grey"}},
    "objects": [
        {"type": "mesh", "path": "triangle.obj", "material_name": "floor"},
        {"type": "sphere", "center": [0, 2, 0], "radius": 0.5,
         "light": {"type": "area", "radiance": [4, 4, 4]}},
    ],
}


@pytest.fixture(scope="module")
def farm(tmp_path_factory):
    """A live master: what is refused must be refused before it hears of a job."""
    with Farm(tmp_path_factory.mktemp("farm")) as farm:
        yield farm
        status, jobs = farm.request("GET", "/api/v1/jobs")
        assert status == 200 and jobs["items"] == [], "a job was made from bad input"


def edited(path, value):
    """GOOD with one place changed; a value of Ellipsis removes it."""
    scene = copy.deepcopy(GOOD)
    at = scene
    for key in path[:-1]:
        at = at[key]
    if value is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return json.dumps(scene)


def run(farm, tmp_path, text, mesh=TRIANGLE):
    (tmp_path / "triangle.obj").write_text(mesh)
    scene = tmp_path / "scene.json"
    scene.write_bytes(text if isinstance(text, bytes) else text.encode())
    return farm.cli("submit", scene, timeout=20)


def refused(done, *parts):
    assert done.returncode == 3, (done.returncode, done.stderr)
    assert done.stdout == ""
    for part in parts:
        assert part in done.stderr, done.stderr
    assert "no job made" in done.stderr


def test_good_scene(farm, tmp_path):
    """The scene that all others are made from is itself good."""
    (tmp_path / "triangle.obj").write_text(TRIANGLE)
    (tmp_path / "scene.json").write_text(json.dumps(GOOD))
    done = tilery("explain", tmp_path / "scene.json", "--json")
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["triangles"] == 1 and facts["spheres"] == 1 and facts["lights"] == 1
    assert "diffuse" in facts["needs"] and "glass" in facts["needs_not"]


def test_ports_taken_for_each_other(farm, tmp_path):
    """Somebody takes the master's port for workers for that of HTTP, or the other way round."""
    done = farm.cli("jobs", env=clean_env(TILERY_MASTER=f"http://{farm.listen}"))
    assert done.returncode == 4 and "is that the master's --http address?" in done.stderr
    worker = farm.worker(master=farm.http, wait=False)
    wait_until(lambda: "is that the master's --listen address?" in worker.log(), "the worker's log")


def test_byte_order_mark(tmp_path):
    """An editor's byte order mark was "expected a value, found byte 0xef"."""
    (tmp_path / "triangle.obj").write_text(TRIANGLE)
    (tmp_path / "scene.json").write_bytes(b"\xef\xbb\xbf" + json.dumps(GOOD).encode())
    done = tilery("explain", tmp_path / "scene.json")
    assert done.returncode == 0, done.stderr


PLACES = {
    "missing mesh file": (("objects", 0, "path"), "none.obj", "$.objects[0].path", "none.obj"),
    "other case": (("objects", 0, "path"), "Triangle.obj", "$.objects[0].path", "triangle.obj"),
    "unknown key": (("camera", "fow"), 40, "$.camera.fow", "fov"),
    "unknown top key": (("cameras",), {}, "$.cameras", "camera"),
    "wrong type": (("film", "resolution"), "big", "$.film.resolution", ""),
    "wrong length": (("camera", "position"), [0, 1], "$.camera.position", ""),
    "unknown material": (("objects", 0, "material_name"), "flor", "$.objects[0].material_name",
                         'did you mean "floor"'),
    "unknown texture": (("materials", "floor", "texture_name"), "gray",
                        "$.materials.floor.texture_name", "grey"),
    "unknown material type": (("materials", "floor", "type"), "difuse", "$.materials.floor.type",
                              "diffuse"),
    "negative radius": (("objects", 1, "radius"), -0.5, "$.objects[1].radius", ""),
    "zero radius": (("objects", 1, "radius"), 0, "$.objects[1].radius", ""),
    "camera looks at itself": (("camera", "look_at"), [0, 0, 3], "$.camera", ""),
    "up along the view": (("camera", "ref_up"), [0, 0, 1], "$.camera", ""),
    "fov 0": (("camera", "fov"), 0, "$.camera.fov", ""),
    "fov 180": (("camera", "fov"), 180, "$.camera.fov", ""),
    "side over 65535": (("film", "resolution"), [65536, 8], "$.film.resolution", "65535"),
    "side 0": (("film", "resolution"), [0, 8], "$.film.resolution", ""),
    "spp 0": (("integrator", "spp"), 0, "$.integrator.spp", ""),
    "fractional spp": (("integrator", "spp"), 1.5, "$.integrator.spp", ""),
    "no camera": (("camera",), ..., "camera", ""),
    "no film": (("film",), ..., "film", ""),
    "neither material nor light": (("objects", 0, "material_name"), ..., "$.objects[0]", ""),
    "nothing lights it": (("objects", 1), {"type": "sphere", "center": [0, 2, 0], "radius": 0.5,
                                           "material_name": "floor"}, "light", ""),
    "black light": (("objects", 1, "light", "radiance"), [0, 0, 0], "light", ""),
    "negative radiance": (("objects", 1, "light", "radiance"), [-1, 0, 0], "radiance", ""),
    "singular transform": (("objects", 0, "transform"), [0] * 16, "$.objects[0].transform", ""),
    "objects of the wrong type": (("objects",), {"a": 1}, "$.objects", ""),
}


@pytest.mark.parametrize("case", PLACES, ids=[name.replace(" ", "_") for name in PLACES])
def test_place_is_named(farm, tmp_path, case):
    path, value, place, hint = PLACES[case]
    refused(run(farm, tmp_path, edited(path, value)), "scene.json", place, hint)


TEXTS = {
    "duplicate key": (json.dumps(GOOD)[:-1] + ', "film": {"resolution": [8, 8]}}', "film"),
    "NaN": (edited(("camera", "fov"), 0.5).replace("0.5", "NaN", 1), "scene.json"),
    "Infinity": (json.dumps(GOOD).replace('"fov": 40', '"fov": Infinity'), "scene.json"),
    "1e999": (json.dumps(GOOD).replace('"fov": 40', '"fov": 1e999'), "$.camera.fov"),
    "bytes after the end": (json.dumps(GOOD) + "\n{}", "scene.json"),
    "cut off": (json.dumps(GOOD)[:-5], "scene.json"),
    "100,000 brackets": ("[" * 100000, "scene.json"),
    "100,000 brackets, closed": ('{"objects": ' + "[" * 100000 + "]" * 100000 + "}", "scene.json"),
    "empty": ("", "scene.json"),
    "not UTF-8": (json.dumps(GOOD).encode().replace(b"grey", b"gr\xffy"), "scene.json"),
    "NUL": (json.dumps(GOOD).encode() + b"\0", "scene.json"),
    "an array": ("[]", "scene.json"),
    "binary": (bytes(range(256)) * 10, "scene.json"),
}


@pytest.mark.parametrize("case", TEXTS, ids=[name.replace(" ", "_") for name in TEXTS])
def test_text_is_refused(farm, tmp_path, case):
    text, place = TEXTS[case]
    refused(run(farm, tmp_path, text), "scene.json", place)


MESHES = {
    "empty mesh": ("", "scene.json: $.objects[0].path: "),
    "no face": ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "triangle.obj: no face in it"),
    "index out of range": (TRIANGLE + "f 1 2 4\n", "triangle.obj:5"),
    "index zero": (TRIANGLE + "f 0 1 2\n", "triangle.obj:5"),
    "index too far back": (TRIANGLE + "f -4 -1 -2\n", "triangle.obj:5"),
    "uv out of range": (TRIANGLE + "f 1/2 2 3\n", "triangle.obj:5"),
    "normal out of range": (TRIANGLE + "f 1 2 3//9\n", "triangle.obj:5"),
    "not a number": ("v 0 nan 0\n" + TRIANGLE, "triangle.obj:1"),
    "infinite": ("v 0 1e999 0\n" + TRIANGLE, "triangle.obj:1"),
    "short vertex": ("v 0 0\n" + TRIANGLE, "triangle.obj:1"),
}


@pytest.mark.parametrize("case", MESHES, ids=[name.replace(" ", "_") for name in MESHES])
def test_mesh_is_refused(farm, tmp_path, case):
    mesh, place = MESHES[case]
    refused(run(farm, tmp_path, json.dumps(GOOD), mesh), place)


def test_warning_is_no_refusal(tmp_path):
    """What can be left out without harm is said, with its line, and the rest is taken."""
    (tmp_path / "triangle.obj").write_text(TRIANGLE + "f 1 2\n")
    (tmp_path / "scene.json").write_text(json.dumps(GOOD))
    done = tilery("explain", tmp_path / "scene.json", "--json", "--quiet")
    assert done.returncode == 0 and json.loads(done.stdout)["triangles"] == 1
    assert "triangle.obj:5: warning: " in done.stderr


def test_all_problems_in_one_run(farm, tmp_path):
    scene = copy.deepcopy(GOOD)
    scene["camera"]["fov"] = 0
    scene["camera"]["fow"] = 1
    scene["objects"][0]["material_name"] = "flor"
    scene["objects"][1]["radius"] = -1
    scene["objects"].append({"type": "mesh", "path": "none.obj", "material_name": "floor"})
    done = run(farm, tmp_path, json.dumps(scene))
    refused(done, "$.camera.fov", "$.camera.fow", "$.objects[0].material_name",
            "$.objects[1].radius", "$.objects[2].path", "5 problems, no job made")


def test_render_writes_nothing(tmp_path):
    """`render` refuses the same way, leaves OUT alone and no process behind."""
    (tmp_path / "triangle.obj").write_text(TRIANGLE)
    scene, out = tmp_path / "scene.json", tmp_path / "out.exr"
    scene.write_text(edited(("camera", "fov"), 0))
    out.write_text("precious")
    done = tilery("render", scene, "-o", out)
    refused(done, "$.camera.fov")
    assert out.read_text() == "precious"


def test_missing_scene(tmp_path):
    done = tilery("render", tmp_path / "none.json", "-o", tmp_path / "out.exr")
    refused(done, "none.json")
    assert list(tmp_path.iterdir()) == []


def test_a_misspelt_scene(tmp_path):
    shutil.copy(SEED_SCENE, tmp_path / "kitchen.json")
    done = tilery("render", tmp_path / "kitchn.json", "-o", tmp_path / "out.exr")
    refused(done, "did you mean", "kitchen.json?")


@pytest.mark.parametrize("option", ("--plan", "--preset"))
def test_a_device_is_no_file(tmp_path, option):
    fifo = tmp_path / "pipe"
    os.mkfifo(fifo)
    for path in ("/dev/zero", fifo):
        done = tilery("render", SEED_SCENE, "-o", tmp_path / "out.exr", option, path, timeout=20)
        assert done.returncode == 3 and done.stdout == ""
        assert "cannot be read: a device or a pipe, not a file" in done.stderr, done.stderr


@pytest.mark.parametrize("kind", ("mesh", "texture", "compare"))
def test_why_a_file_cannot_be_read(tmp_path, kind):
    """Also where a scene names it; once all of them were "a folder, or no permission"."""
    os.mkfifo(tmp_path / "pipe.obj")
    (tmp_path / "dir.obj").mkdir()
    for path, why in (("pipe.obj", "a device or a pipe, not a file"), ("dir.obj", "a folder")):
        if kind == "compare":
            done = tilery("compare", tmp_path / path, tmp_path / path, timeout=20)
        else:
            scene = copy.deepcopy(GOOD)
            scene["objects"][0] = {"type": "mesh", "path": path, "material_name": "floor"}
            if kind == "texture":
                del scene["objects"][0]
                scene["textures"]["t"] = {"type": "image", "path": path}
                scene["environment_map"] = {"texture_name": "t"}
            (tmp_path / "scene.json").write_text(json.dumps(scene))
            done = tilery("explain", tmp_path / "scene.json", timeout=20)
        assert done.returncode == 3, done
        assert f"cannot be read: {why}\n" in done.stderr, done.stderr
        assert "[unreadable-file]" in done.stderr  # `compare` called a folder a missing file


def test_a_link_to_itself(tmp_path):
    """That was an "input/output error"."""
    (tmp_path / "loop.json").symlink_to("loop.json")
    refused(tilery("render", tmp_path / "loop.json", "-o", tmp_path / "a.exr"),
            "cannot be read: a link that leads back to itself")


@pytest.mark.parametrize("content", (b"", b"root:x:0:0:root:/root:/bin/sh\n", b"\x7fELF\2\1\1" * 99))
def test_what_is_no_scene(tmp_path, content):
    """In words of ours; once it was the model library's sentence."""
    path = tmp_path / "passwd"
    path.write_bytes(content)
    done = tilery("render", path, "-o", tmp_path / "out.exr")
    assert done.returncode == 3
    words = "neither a scene nor a model that can be read" if content else "the file is empty"
    assert f"{path}: {words}" in done.stderr, done.stderr


def test_a_model_without_a_light(tmp_path):
    model = tmp_path / "t.obj"
    model.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for command in (("doctor",), ("explain", "--numerics")):
        done = tilery(command[0], model, *command[1:])
        assert done.returncode == 0 and "no light in it" in done.stdout, done
        assert "[sky-added]" in done.stdout


def test_a_folder_as_scene(tmp_path):
    refused(tilery("render", tmp_path, "-o", tmp_path / "out.exr"), str(tmp_path))


USAGE = {
    "no command": ((), "tilery render"),
    "unknown command": (("rendr",), "render"),
    "unknown option": (("render", "a.json", "-o", "b.exr", "--ssp", "4"), "--spp"),
    "no output": (("render", "a.json"), "-o"),
    "wrong ending": (("render", "a.json", "-o", "b.png"), ".exr"),
    "bad number": (("render", "a.json", "-o", "b.exr", "--spp", "many"), "whole number"),
    "number and what for": (("render", "a.json", "-o", "b.exr", "--spp", "0"), "samples per pixel"),
    "aov of nothing": (("render", "a.json", "-o", "b.exr", "--aov", ""), "names no channel"),
    "too many": (("jobs", "j1"), "tilery jobs --help"),
    "bad choice": (("render", "a.json", "-o", "b.exr", "--sampler", "sobl"), "sobol"),
    "same file twice": (("render", "a.json", "-o", "b.exr", "--report", "b.exr"), "twice"),
    "aov": (("render", "a.json", "-o", "b.exr", "--aov", "norml"), "known: depth,position"),
    "frames-mark": (("submit", "a.json", "--frames", "1-3"), "####"),
    "frames-range": (("submit", "a.#.json", "--frames", "3-1"), "A-B"),
    "frames-out": (("submit", "a.#.json", "--frames", "1-3", "--wait", "-o", "o.exr"), "-o"),
    "tradeoff": (("tradeoff", "a.json"), "-o"),
    "output without wait": (("submit", "a.json", "-o", "b.exr"), "-o needs --wait"),
    "output in full without wait": (("submit", "a.json", "--output", "b.exr"), "--output needs"),
    "png by another name": (("render", "a.json", "-o", "b.exr", "--png", "b.jpg"), ".png"),
    "submit into a png": (("submit", "a.json", "--wait", "-o", "b.png"), "must end in .exr"),
    "long name": (("submit", "a.json", "--name", "n" * 201), "201 bytes, must be at most 200"),
    "empty scene": (("render", "", "-o", "b.exr"), "must not be empty"),
    "empty job": (("status", ""), "must not be empty"),
    "bad priority": (("priority", "j1", "high"), ": priority high: must be a whole number"),
    "help of nothing": (("help", "rendr"), "render"),
    "get without output": (("get", "j1"), "-o"),
    "get into a jpeg": (("get", "j1", "-o", "a.jpg"), ".png"),
}


@pytest.mark.parametrize("case", USAGE, ids=[name.replace(" ", "_") for name in USAGE])
def test_usage(case):
    arguments, part = USAGE[case]
    done = tilery(*arguments, cwd="/")
    assert done.returncode == 2, (done.returncode, done.stderr)
    assert part in done.stderr and done.stdout == ""


@pytest.mark.parametrize("name", ["bdpt", "photon"])
def test_integrator_that_means_path(tmp_path, name):
    """As the scene's own key: the path integrator's very bits, and a warning."""
    (tmp_path / "triangle.obj").write_text(TRIANGLE)
    (tmp_path / "scene.json").write_text(json.dumps(GOOD))
    for integrator, out in ((name, "a.exr"), ("path", "b.exr")):
        done = tilery("render", tmp_path / "scene.json", "-o", tmp_path / out, "--quiet",
                      "--integrator", integrator)
        assert done.returncode == 0, done.stderr
        assert ("path integrator" in done.stderr) == (integrator == name), done.stderr
    same = tilery("compare", tmp_path / "a.exr", tmp_path / "b.exr", "--identical")
    assert same.returncode == 0, same.stderr


def test_crop_outside(farm, tmp_path):
    (tmp_path / "triangle.obj").write_text(TRIANGLE)
    (tmp_path / "scene.json").write_text(json.dumps(GOOD))
    done = farm.cli("submit", tmp_path / "scene.json", "--crop", "4,4,5,5")
    assert done.returncode == 2 and "8x8" in done.stderr
    assert done.stderr.startswith("tilery: --crop 4,4,5,5 reaches over"), done.stderr


@pytest.mark.parametrize("arguments", [("--help",), ("help",), ("render", "--help"),
                                       ("help", "render"), ("help", "settings"),
                                       ("help", "completion"), ("help", "man"), ("--version",)])
def test_help(arguments):
    done = tilery(*arguments)
    assert done.returncode == 0 and done.stderr == "" and len(done.stdout) > 8


def test_completion_is_bash():
    done = tilery("help", "completion")
    check = subprocess.run(["bash", "-n"], input=done.stdout, text=True, capture_output=True,
                           check=False)
    assert check.returncode == 0, check.stderr
    script = done.stdout + """
COMP_WORDS=(tilery render --sa) COMP_CWORD=2; _tilery; echo "${COMPREPLY[@]}"
COMP_WORDS=(tilery ren) COMP_CWORD=1; _tilery; echo "${COMPREPLY[@]}"
COMP_WORDS=(tilery render --sampler s) COMP_CWORD=3; _tilery; echo "${COMPREPLY[@]}"
"""
    done = subprocess.run(["bash", "-c", script], text=True, capture_output=True, check=False,
                          env=clean_env(PATH=f"{BIN}:/usr/bin:/bin"))
    assert done.stdout.splitlines() == ["--sampler", "render", "sobol"], done.stderr


def test_error_ids_are_documented():
    """Each id that the client prints is an anchor of docs/ERRORS.md."""
    anchors = set(re.findall(r"^### (\S+)$", (ROOT / "docs/ERRORS.md").read_text(), re.M))
    ids = set()
    for path in (ROOT / "client").glob("*.c"):
        ids |= set(re.findall(r'(?:cli_error\(|complain\(problems, )"([a-z-]+)"',
                              path.read_text()))
    assert len(ids) > 20
    assert ids - anchors == set()


def test_settings(tmp_path):
    """Option over environment over file, each with its origin; a bad file is named by line."""
    folder = tmp_path / "tilery"
    folder.mkdir()
    (folder / "config").write_text("workers = 3\nthreads = 5\nmaster = http://farm:1\n")
    env = clean_env(XDG_CONFIG_HOME=tmp_path, TILERY_THREADS=7)
    lines = tilery("help", "settings", env=env).stdout.splitlines()
    rows = {line.split()[0]: line for line in lines if line and line[0] != " "}
    assert "3" in rows["workers"] and "your settings file" in rows["workers"]
    assert "7" in rows["threads"] and "environment" in rows["threads"]
    assert "http://farm:1" in rows["master"]
    assert rows["SETTING"].split() == ["SETTING", "VALUE", "VARIABLE", "FROM"]
    assert rows["progress"].split() == ["progress", "auto", "TILERY_PROGRESS", "default"]
    assert rows["quiet"].split() == ["quiet", "no", "TILERY_QUIET", "default"]
    (folder / "config").write_text("# mine\nworker = 3\n")
    done = tilery("jobs", env=env)
    assert done.returncode == 2
    assert f"{folder}/config:2" in done.stderr and "workers" in done.stderr


@pytest.mark.parametrize("words, kept", [
    (["render", "scene.json", "-o", "out.exr", "--report", "./scene.json"], "scene.json"),
    (["render", "scene.json", "-o", "./out.exr", "--png", "out.exr"], "out.exr"),
    (["render", "scene.json", "-o", "out.exr", "--png", "link.json"], "scene.json"),
    (["submit", "scene.json", "--wait", "-o", "a.exr", "--report", "../{}/scene.json"], "scene.json"),
    (["import", "model.obj", "-o", "model.obj"], "model.obj"),
    (["compare", "a.exr", "out.exr", "--heatmap", "./a.exr"], "a.exr")])
def test_no_output_replaces_what_is_read(tmp_path, words, kept):
    """Each of these wrote over its own input, or one output over another, and exited 0."""
    (tmp_path / "scene.json").write_text(json.dumps(GOOD))
    (tmp_path / "link.json").symlink_to("scene.json")
    for name in ("triangle.obj", "model.obj"):
        (tmp_path / name).write_text(TRIANGLE)
    for name in ("a.exr", "out.exr"):
        (tmp_path / name).write_bytes(b"\x76\x2f\x31\x01")
    before = (tmp_path / kept).read_bytes()
    done = tilery(*[w.format(tmp_path.name) for w in words], cwd=tmp_path)
    assert done.returncode == 2, (done.returncode, done.stderr)
    assert "[bad-value]" in done.stderr
    assert (tmp_path / kept).read_bytes() == before
    assert not list(tmp_path.glob("*_meshes"))


@pytest.mark.parametrize("to", ("/dev/stdout", "-"))
def test_a_report_may_go_to_a_pipe(tmp_path, to):
    """/dev/stdout was refused as an invalid argument, and "-" made a file of that name."""
    (tmp_path / "scene.json").write_text(json.dumps(GOOD))
    (tmp_path / "triangle.obj").write_text(TRIANGLE)
    done = tilery("render", "scene.json", "-o", "out.exr", "--report", to, "--quiet",
                  cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["state"] == "done"
    assert not (tmp_path / "-").exists()
