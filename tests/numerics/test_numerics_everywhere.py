"""A number that nobody would mean, in every place that takes one: each numeric key of
docs/scene.schema.json and each numeric option of the programs gets NaN, infinities, the ends of
doubles, denormals, -0, 0, -1, 2^33, the neighbours of 2^16 and the ends of its range. Each is refused by name (exit 3 with
the JSON path, exit 2 with the option) or a picture of finite pixels, none negative but by the
Mitchell filter, within seconds. docs/NUMERICS.md says what each means.

TILERY_LONG=1 also fills whole lists with the value, and gives colours as one number. A sanitizer,
under which each of these many processes is slow, gets every third value of a place, in turn.
"""
import concurrent.futures
import json
import os
import pathlib
import re
import subprocess
import sys

import numpy
import pytest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "e2e"))
import exr_pixels  # noqa: E402
from farm import BIN, ROOT, SLOW, clean_env, report_of, tilery  # noqa: E402

LONG = bool(os.environ.get("TILERY_LONG"))
SECONDS = 20  # no case may take longer; times SLOW under a sanitizer
NO_JSON = ["NaN", "Infinity", "-Infinity"]
VALUES = [*NO_JSON, "1e999", "-1e999", "1e308", "-1e308", "1e-320", "-0.0", "0", "-1", "8589934592",
          "65535", "65536", "1e150", "-1e150"]
SCHEMA = json.loads((ROOT / "docs/scene.schema.json").read_text())
IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
TRIANGLE = ("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nvt 0 0\nvt 3 0\nvt 0 2\nvn 0 0 1\n"
            "f 1/1/1 2/2/1 3/3/1\n")

# --- Scenes that have every key between them -----------------------------------------

FLOOR = {"type": "mesh", "path": "triangle.obj", "material_name": "floor",
         "transform": IDENTITY, "translate": [0, 0, 0]}
LAMP = {"type": "sphere", "center": [0, 2, 2], "radius": 0.5,
        "light": {"type": "area", "radiance": [4, 4, 4]}}
MAPPED = {"type": "uvmapping2d", "scale": [1, 1], "delta": [0, 0]}


def scene(integrator, camera, film=None, **more):
    return {"integrator": integrator, "film": {"resolution": [8, 8], "crop": [2, 2, 4, 4],
                                               **(film or {})},
            "camera": {"position": [0, 0, 3], "look_at": [0, 0, 0], "ref_up": [0, 1, 0], **camera},
            **more}


def show(material, textures=None):
    """The keys of one material on a ball and a triangle before a checkered floor."""
    return {"materials": {"floor": {"type": "diffuse", "texture_name": "squares"},
                          "it": material},
            "textures": {"squares": {"type": "checkerboard", "filter": "mipmap"},
                         **(textures or {})},
            "objects": [FLOOR, LAMP, {"type": "sphere", "center": [0.4, 0, 1], "radius": 0.3,
                                      "material_name": "it"},
                        {"type": "mesh", "path": "triangle.obj", "material_name": "it",
                         "translate": [-0.5, 0, 0.5]}]}


PATH = {"type": "path", "spp": 2, "max_depth": 5, "rr_threshold": 0.1, "seed": 3}
GREY = {"type": "diffuse", "color": [0.5, 0.5, 0.5], "twosided": True, "bump_texture": "bumps",
        "bump_scale": 0.01}
BUMPS = {"bumps": {"type": "image", "path": "bumps.exr", "encoding": "linear"}}
SIDES = {"alpha_x": 0.2, "alpha_y": 0.3}
MATERIALS = {
    "diffuse": GREY,
    "mirror": {"type": "mirror", "R": [0.9, 0.9, 0.9], "bump_texture": "bumps", "bump_scale": 0.1},
    "refraction": {"type": "refraction", "eta": 1.5},
    "glass": {"type": "glass", "eta": 1.5, "R": [1, 1, 1], "T": [1, 1, 1],
              "bump_texture": "bumps", "bump_scale": 0.1},
    "roughconductor": {"type": "roughconductor", **SIDES, "R": [1, 1, 1], "etaI": [1, 1, 1],
                       "etaT": [0.2, 0.9, 1.1], "k": [3, 2, 2], "bump_texture": "bumps",
                       "bump_scale": 0.1},
    "roughconductor ggx": {"type": "roughconductor", **SIDES, "R": [1, 1, 1], "etaI": [1, 1, 1],
                           "etaT": [0.2, 0.9, 1.1], "k": [3, 2, 2], "distribution": "ggx"},
    "roughdielectric": {"type": "roughdielectric", "eta": 1.5, **SIDES, "R": [1, 1, 1],
                        "T": [1, 1, 1], "bump_texture": "bumps", "bump_scale": 0.1},
    "roughdielectric ggx": {"type": "roughdielectric", "eta": 1.5, **SIDES, "R": [1, 1, 1],
                            "T": [1, 1, 1], "distribution": "ggx"},
    "principled": {"type": "principled", "color": [0.8, 0.7, 0.6], "metallic": 0.3,
                   "roughness": 0.4, "eta": 1.4, "emission": [0.1, 0, 0], "transmission": 0.2,
                   "clearcoat": 0.5, "clearcoat_roughness": 0.2, "sheen_color": [0.3, 0.3, 0.3],
                   "sheen_roughness": 0.5, "specular": 0.9, "specular_color": [1, 1, 1],
                   "alpha": 0.8, "alpha_mode": "blend", "alpha_cutoff": 0.5, "normal_scale": 0.7,
                   "normal_texture": "bumps", "bump_texture": "bumps", "bump_scale": 0.1},
    "principled mask": {"type": "principled", "color": [0.8, 0.7, 0.6], "roughness": 0.4,
                        "alpha": 0.8, "alpha_mode": "mask", "alpha_cutoff": 0.5},
}
SCENES = {f"material {name}": scene(PATH, {"fov": 40}, **show(m, BUMPS))
          for name, m in MATERIALS.items()}
SCENES |= {
    "thin lens": scene(PATH, {"type": "thin-lens", "fov": 40, "focal_length": 3,
                              "aperture_radius": 0.1, "ortho_height": 2},
                       {"block_side_length": 16, "filter": {"type": "mitchell", "radius": 2,
                                                            "B": 0.3, "C": 0.3}}, **show(GREY, BUMPS)),
    "pinhole": scene(PATH, {"fov": 40, "focal_length": 1, "aperture_radius": 0},
                     {"filter": {"type": "gaussian", "radius": 1.5, "alpha": 2}}, **show(GREY, BUMPS)),
    "orthographic": scene({"type": "intersection_test", "spp": 2, "max_depth": 4,
                           "point_light_position": [0, 3, 3], "point_light_flux": [50, 50, 50]},
                          {"type": "orthographic", "ortho_height": 2},
                          {"filter": {"type": "tent", "radius": 1}}, **show({"type": "glass"})),
    "panorama": scene({**PATH, "sampler": "halton"}, {"type": "panorama", "fov": 45},
                      {"filter": {"type": "blackman-harris", "radius": 1.5}}, **show(GREY, BUMPS)),
    "photon": scene({"type": "photon", "spp": 2, "max_depth": 3, "n_photons": 10,
                     "n_iterations": 1, "n_near_photons": 4}, {}, **show(GREY, BUMPS)),
    "direct": scene({"type": "direct", "spp": 2, "sampler": "independent", "seed": "7"}, {},
                    **show(GREY, BUMPS)),
    "ao": scene({"type": "ao", "spp": 2}, {}, **show(GREY, BUMPS)),
    "textures": scene(PATH, {}, **show(
        {"type": "diffuse", "texture_name": "flat"},
        {"flat": {"type": "constant", "color": [0.5, 0.5, 0.5]},
         "squares": {"type": "checkerboard", "color0": [0.4, 0.4, 0.4], "color1": [0.2, 0.2, 0.2],
                     "filter": "mipmap", "tex_coordinate_generator": MAPPED}})),
    "image": scene(PATH, {}, **show(
        {"type": "diffuse", "texture_name": "image"},
        {"image": {"type": "image", "path": "bumps.exr", "color": [0.5, 0.5, 0.5],
                   "tex_coordinate_generator": MAPPED},
         "squares": {"type": "checkerboard", "tex_coordinate_generator":
                     {"type": "uvmapping2d", "matrix": [4, 0, 0, 0, 4, 0]}}})),
    "turned image": scene(PATH, {}, **show(
        {"type": "diffuse", "texture_name": "turned"},
        {"turned": {"type": "image", "path": "bumps.exr", "tex_coordinate_generator":
                    {"type": "uvmapping2d", "matrix": [1, 0, 0, 0, 1, 0]}}})),
    "mesh lamp": scene(PATH, {}, **{**show(GREY, BUMPS), "objects": [FLOOR, {
        "type": "mesh", "path": "triangle.obj", "translate": [0, 1, 2], "transform": IDENTITY,
        "light": {"type": "area", "radiance": [4, 4, 4]}}]}),
    "lights": scene(PATH, {}, **{**show(GREY, BUMPS), "lights": [
        {"type": "point", "position": [0, 2, 2], "intensity": [5, 5, 5]},
        {"type": "spot", "position": [0, 2, 2], "look_at": [0, 0.1, 0.1], "intensity": [5, 5, 5],
         "outer_angle": 40},
        {"type": "spot", "position": [0, 2, 2], "direction": [0, -1, -1], "intensity": [5, 5, 5],
         "outer_angle": 180, "inner_angle": 20},
        {"type": "directional", "direction": [0, -1, -1], "irradiance": [1, 1, 1]}]}),
    "sky": scene(PATH, {}, **{**show(GREY, {**BUMPS, "sky": {"type": "image", "path": "bumps.exr"}}),
                              "environment_map": {"texture_name": "sky", "scale": 1,
                                                  "transform": IDENTITY}}),
    "sky alone": scene(PATH, {}, **{**show(GREY, {**BUMPS, "sky": {"type": "image",
                                                                   "path": "bumps.exr"}}),
                                    "objects": [FLOOR],
                                    "environment_map": {"texture_name": "sky", "scale": 1}}),
    "flat sky": scene(PATH, {}, **{**show(GREY, {**BUMPS, "sky": {"type": "constant",
                                                                  "color": [1, 1, 1]}}),
                                   "environment_map": {"texture_name": "sky", "scale": 1}}),
}

# --- The numbers of a schema and of a scene --------------------------------------------


def resolved(node):
    while "$ref" in node:
        node = SCHEMA["$defs"][node["$ref"].rsplit("/", 1)[1]]
    return node


def is_numeric(node):
    return resolved(node).get("type") in ("number", "integer")


def branch_name(node):
    kind = resolved(node).get("properties", {}).get("type", {})
    return kind.get("const", "")


def numbers_of_schema(node, name):
    """The name of each number in the schema: its keys, and the type of what they are in."""
    node = resolved(node)
    if is_numeric(node):
        yield name
    for branch in node.get("oneOf", []):
        tag = branch_name(branch)
        yield from numbers_of_schema(branch, f"{name}({tag})" if tag else name)
    for key, child in node.get("properties", {}).items():
        yield from numbers_of_schema(child, f"{name}.{key}")
    for key in ("items", "additionalProperties"):
        if isinstance(node.get(key), dict):
            yield from numbers_of_schema(node[key], name)


def matches(node, value):
    node = resolved(node)
    kind = {"object": dict, "array": list, "string": str, "number": (int, float),
            "integer": int}.get(node.get("type"), object)
    tag = branch_name(node)
    return isinstance(value, kind) and (not tag or value.get("type") == tag)


def numbers_of_scene(node, value, name="", path=()):
    """(name in the schema, path, schema) of each number; of a list of numbers the list's path."""
    node = resolved(node)
    if "oneOf" in node:
        (branch,) = [b for b in node["oneOf"] if matches(b, value)]
        tag = branch_name(branch)
        yield from numbers_of_scene(branch, value, f"{name}({tag})" if tag else name, path)
    elif isinstance(value, dict):
        for key, child in value.items():
            known = node.get("properties", {}).get(key) or node.get("additionalProperties")
            inner = f"{name}.{key}" if key in node.get("properties", {}) else name
            yield from numbers_of_scene(known, child, inner, (*path, key))
    elif isinstance(value, list) and not is_numeric(node.get("items", {})):
        for i, child in enumerate(value):
            yield from numbers_of_scene(node["items"], child, name, (*path, i))
    elif isinstance(value, list) or is_numeric(node):
        yield name, path, resolved(node.get("items", node))


def ends(node):
    """The ends of a number's range as the schema has them, the exit status of each, and what lies
    just beyond. No end: what every number may be."""
    step = (lambda v, d: v + d) if node["type"] == "integer" else \
        (lambda v, d: float(numpy.nextafter(v, d * numpy.inf)))
    for key, outward in (("minimum", -1), ("maximum", 1)):
        if key in node:
            yield repr(node[key]), 0
            yield repr(step(node[key], outward)), 3
    unbounded = node["type"] == "number"
    if unbounded and not {"maximum", "exclusiveMaximum"} & set(node):
        yield "1e150", 0
        yield "1.00000001e150", 3
    if unbounded and not {"minimum", "exclusiveMinimum"} & set(node):
        yield "-1e150", 0
        yield "-1.00000001e150", 3
    for key, outward in (("exclusiveMinimum", -1), ("exclusiveMaximum", 1)):
        if key in node:
            yield repr(step(node[key], -outward)), 0
            yield repr(node[key]), 3


def at(holder, path):
    for key in path:
        holder = holder[key]
    return holder


# What depends on the rest of the scene is tried in each; the rest in the first that has it.
EVERYWHERE = (".integrator", ".film", ".camera")
LAMPS = (".environment_map.scale", ".textures(constant).color")
CASES, seen = [], set()
for scene_name, made in SCENES.items():
    for number, path, node in numbers_of_scene(SCHEMA, made):
        kind = made["integrator"]["type"], made["camera"].get("type"), \
            made["film"].get("filter", {}).get("type")
        key = (number, scene_name if number.startswith(LAMPS) else
               kind if number.startswith(EVERYWHERE) else scene_name.rpartition(" ggx")[1])
        if key not in seen:
            seen.add(key)
            grey = "minimum" in node  # a colour; places and directions have no least value
            CASES.append((scene_name, number, path, dict.fromkeys(VALUES) | dict(ends(node)), grey))


def test_every_number_of_the_schema_is_tried():
    assert {c[1] for c in CASES} >= set(numbers_of_schema(SCHEMA, "")) and len(CASES) > 100


# --- Scenes -----------------------------------------------------------------------------


def json_path(path):
    return "$" + "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in path)


def fresh(made):
    """A copy in which nothing is shared, as copy.deepcopy leaves one list in two places."""
    return json.loads(json.dumps(made))


def forms(made, path, grey):
    """The scene with the place to fill in, and True if that is refused whatever is filled in: one
    element of a list, and for long runs all of them, and one number in place of three."""
    old = at(made, path)
    new = fresh(made)
    if not isinstance(old, list):
        at(new, path[:-1])[path[-1]] = "@@"
        yield new, False
        return
    at(new, path)[len(old) // 2] = "@@"
    yield new, False
    if LONG:
        new = fresh(made)
        at(new, path[:-1])[path[-1]] = ["@@"] * len(old)
        yield new, False
        if len(old) == 3:
            new = fresh(made)
            at(new, path[:-1])[path[-1]] = "@@"
            yield new, not grey


def run(folder, *arguments):
    try:
        return tilery(*arguments, timeout=SECONDS)
    except subprocess.TimeoutExpired:
        pytest.fail(f"{folder}: no end within {SECONDS * SLOW} s")


# A light or surface so bright that a sample leaves the film's floats is counted and taken as 0.
BRIGHT = (".radiance", ".intensity", ".irradiance", ".point_light_flux", ".emission", ".R", ".T",
          ".color", ".color0", ".color1", ".specular_color", ".sheen_color",
          ".environment_map.scale")


# Ends of a range that the rest of the scene does not leave possible.
NARROWED = (".film.resolution", ".film.crop", ".camera.focal_length", ".camera.position",
            ".camera.look_at", ".objects(mesh).transform", ".environment_map.transform")


def judge(folder, form, number, path, value, status):
    """None, or what is wrong with what this scene becomes. `status`: expected, None: 0 or 3."""
    folder.mkdir()
    (folder / "triangle.obj").write_text(TRIANGLE)
    (folder / "bumps.exr").symlink_to(folder.parents[1] / "bumps.exr")
    form = fresh(form)
    if number.endswith("spp"):
        form["film"]["crop"] = [2, 2, 1, 1]
    text = json.dumps(form).replace('"@@"', value)
    (folder / "scene.json").write_text(text)
    many = number.endswith("spp") and float(value) > 1e9
    command = ("explain",) if many else (
        "render", "-o", folder / "out.exr", "--report", folder / "report.json", "--workers", 1,
        "--threads", 1)
    done = run(folder, command[0], folder / "scene.json", *command[1:])
    said = f"{number} {value}: exit {done.returncode}: {done.stderr}"
    if done.returncode == 3 and "[no-light]" in done.stderr:
        return None if float(value) == 0 and number.endswith(BRIGHT) else said
    if status is not None and done.returncode != status and number not in NARROWED:
        return f"expected {status}: {said}"
    if done.returncode == 3:
        # What no longer fits beside it may be named in its place.
        place = "scene.json:1:" if value in NO_JSON else json_path(path)
        others = {".camera": "$.camera: ", ".film.resolution": "$.film.crop: "}
        named = place in done.stderr or any(
            number.startswith(k) and place in done.stderr for k, place in others.items())
        return None if named and not (folder / "out.exr").exists() else said
    if done.returncode != 0:
        return said
    if run(folder, "doctor", folder / "scene.json").returncode != 0:
        return said + " (doctor)"
    if many:
        return None
    pixels = exr_pixels.rgb(folder / "out.exr")
    mitchell = form["film"].get("filter", {}).get("type") == "mitchell"
    bad = report_of(folder / "report.json")["nonfinite_samples"]
    if not numpy.isfinite(pixels).all() or not (mitchell or (pixels >= 0).all()):
        return f"{number} {value}: pixels from {pixels.min()} to {pixels.max()}"
    if bad and not (number.endswith(BRIGHT) and float(value) > 1e9):
        return f"{number} {value}: {bad} samples are no numbers"
    return None


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c[0]}: {c[1].strip('.')}")
def test_scene(tmp_path, case):
    scene_name, number, path, values, grey = case
    if SLOW > 1 and not LONG:
        values = dict(list(values.items())[CASES.index(case) % 3::3])
    exr_pixels.write(tmp_path / "bumps.exr",
                     numpy.random.default_rng(1).random((8, 8, 3), dtype="f4"))
    (tmp_path / "cases").mkdir()
    tried = [(tmp_path / "cases" / f"{i}{value}", form, number, path, value,
              3 if refused else status)
             for i, (form, refused) in enumerate(forms(SCENES[scene_name], path, grey))
             for value, status in values.items()]
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        wrong = [w for w in pool.map(lambda t: judge(*t), tried) if w]
    assert not wrong, "\n".join(wrong)


# --- Options ----------------------------------------------------------------------------

# Of each option the command and how its argument is written.
RENDER = ("render", "scene.json", "-o", "out.exr", "--report", "report.json", "--quiet")
NEEDS = {"--max-spp": ("--target-error", "0.5")}
OPTIONS = [
    *((RENDER, o, ("{}",)) for o in (
        "--spp", "--target-error", "--max-spp", "--time-limit", "--seed", "--max-depth",
        "--rr-threshold", "--tile", "--verify", "--workers", "--threads")),
    (RENDER, "--verify", ("{}%",)), (RENDER, "--size", ("{}x8", "8x{}")),
    (RENDER, "--crop", ("{},0,1,1", "0,{},1,1", "0,0,{},1", "0,0,1,{}")),
    (("submit", "scene.json"), "--priority", ("{}",)), (("submit", "scene.json"), "--frames",
                                                         ("{}-2", "1-{}")),
    (("get", "j1", "-o", "out.exr"), "--frame", ("{}",)),
    (("compare", "bumps.exr", "bumps.exr"), "--max-relmse", ("{}",)),
    (("tradeoff", "scene.json", "-o", "study"), "--budget", ("{}",)),
]
# A number as an argument in an option's help, and commands that have none of their own.
NUMBER = re.compile(r"^  (--(?!name)[a-z-]+) (?:N|E|S|P|X|WxH|X,Y,W,H|A-B|SECONDS)\b", re.M)
HELP = ("render", "submit", "tradeoff", "compare", "get", "explain", "doctor", "import", "watch")


def test_every_numeric_option_is_tried():
    found = {o for c in HELP for o in NUMBER.findall(tilery("help", c).stdout)}
    assert found and found <= {o for _, o, _ in OPTIONS}, found


def option_case(folder, command, option, text):
    """None, or what is wrong with what the option does."""
    scene_text = json.dumps(scene({**PATH, "spp": 1}, {}, **show(GREY)))
    folder.mkdir()
    (folder / "scene.json").write_text(scene_text.replace(', "bump_texture": "bumps"', ""))
    (folder / "triangle.obj").write_text(TRIANGLE)
    (folder / "bumps.exr").symlink_to(folder.parents[1] / "bumps.exr")
    size = () if command is not RENDER or option == "--size" else ("--size", "2x2")
    # The crop of the scene is beyond the smaller picture.
    crop = () if command is not RENDER or option == "--crop" else ("--crop", "0,0,1,1")
    one = () if command is not RENDER or option == "--workers" else ("--workers", 1)
    try:
        done = subprocess.run(
            [str(BIN / "tilery"), *map(str, command), *map(str, (*size, *crop, *one)),
             *NEEDS.get(option, ()), f"{option}={text}"], cwd=folder, capture_output=True,
            text=True, timeout=SECONDS * SLOW, check=False,
            env=clean_env(TILERY_MASTER="http://127.0.0.1:1"))
    except subprocess.TimeoutExpired:
        return f"{option} {text}: no end within {SECONDS * SLOW} s"
    said = f"{option} {text}: exit {done.returncode}: {done.stderr[-400:]}"
    if done.returncode == 2:
        return None if option in done.stderr else said
    if done.returncode == 3:  # a crop that is not in the picture
        return None if "crop" in done.stderr else said
    if command[0] in ("submit", "get"):  # past the options: there is no farm
        return None if done.returncode == 4 else said
    if done.returncode != 0:
        return said
    if command is RENDER:
        pixels = exr_pixels.rgb(folder / "out.exr")
        if not (numpy.isfinite(pixels).all() and (pixels >= 0).all()):
            return said + f": pixels from {pixels.min()} to {pixels.max()}"
    return None


# A job that these ask for is right, and does not end in a test's time.
ENDLESS = {("--spp", "8589934592"), ("--budget", "65535"), ("--budget", "65536")}


@pytest.mark.parametrize("case", OPTIONS, ids=lambda c: c[1].strip("-") + c[2][0])
def test_option(tmp_path, case):
    command, option, texts = case
    exr_pixels.write(tmp_path / "bumps.exr", numpy.ones((8, 8, 3), dtype="f4"))
    (tmp_path / "cases").mkdir()
    wrong = [option_case(tmp_path / "cases" / f"{i}{value}", command, option, text.format(value))
             for i, text in enumerate(texts) for value in VALUES if (option, value) not in ENDLESS]
    assert not any(wrong), "\n".join(w for w in wrong if w)


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("option", ["--threads", "--build-threads", "--cache-size", "--memory"])
def test_worker_option(option, value):
    done = subprocess.run([str(BIN / "tilery-worker"), "--master", "127.0.0.1:1",
                           f"{option}={value}", "--determinism-id"], capture_output=True,
                          text=True, timeout=SECONDS * SLOW, check=False, env=clean_env())
    assert done.returncode == 0 or done.returncode == 2 and option in done.stderr, done.stderr


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("option", ["--retention", "--listen=127.0.0.1:", "--http=127.0.0.1:"])
def test_master_option(tmp_path, option, value):
    """A port or a time that is possible: the master runs, and ends in order."""
    words = {"--listen": "127.0.0.1:0", "--http": "127.0.0.1:0", "--data": str(tmp_path / "data")}
    name, _, head = option.partition("=")
    words[name] = head + value
    process = subprocess.Popen([str(BIN / "tilery-master"), *(f"{k}={v}" for k, v in words.items())],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                               env=clean_env())
    line = process.stdout.readline()
    process.terminate()
    _, said = process.communicate(timeout=SECONDS * SLOW)
    if line:
        assert process.returncode == 0 and json.loads(line)["http"], said
    elif process.returncode == 2:
        assert name in said, said
    else:  # a port that is taken
        assert process.returncode == 5 and "65535" in said, said
