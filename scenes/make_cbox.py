#!/usr/bin/env python3
"""Writes the meshes and scenes of this folder anew from their numbers.

usage: make_cbox.py [FOLDER]   (default: where the script lies)

The output is committed; run it after changing a number, and commit both.
"""
import json
import math
import pathlib
import sys

GREY, RED, GREEN = (0.725, 0.71, 0.68), (0.63, 0.065, 0.05), (0.14, 0.45, 0.091)
SHORT_BOX = [(-0.04607, -0.573007), (0.124253, -0.003104), (0.703337, -0.176177), (0.533009, -0.746079)]
TALL_BOX = [(0.0495656, 0.108948), (-0.523986, -0.0906493), (-0.720444, 0.473882), (-0.146892, 0.673479)]
COPPER = {"etaT": [0.200438, 0.924033, 1.10221], "k": [3.91295, 2.45285, 2.14219]}


def sub(a, b):
    return tuple(x - y for x, y in zip(a, b))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def unit(a):
    length = math.sqrt(dot(a, a))
    return tuple(x / length for x in a)


def facing(corners, normal):
    """The polygon, turned so that it runs counter-clockwise around the normal."""
    n = cross(sub(corners[1], corners[0]), sub(corners[2], corners[0]))
    return list(corners) if dot(n, normal) > 0 else list(reversed(corners))


def number(x):
    return repr(round(x, 9) + 0.0)


def write_obj(path, note, polygons):
    """One OBJ file; each polygon has its own vertices, so that edges stay sharp."""
    lines, count = [f"# {note}; written by make_cbox.py"], 0
    for polygon in polygons:
        lines += ["v " + " ".join(number(x) for x in vertex) for vertex in polygon]
        lines.append("f " + " ".join(str(count + i + 1) for i in range(len(polygon))))
        count += len(polygon)
    path.write_text("\n".join(lines) + "\n")


def write_disc(path, radius, z, rim):
    """A fan without a centre vertex, facing +z."""
    lines = ["# flat disc facing +z; written by make_cbox.py"]
    for i in range(rim):
        angle = 2 * math.pi * i / rim
        lines.append(f"v {number(radius * math.cos(angle))} {number(radius * math.sin(angle))} {number(z)}")
    lines += [f"f 1 {i + 2} {i + 3}" for i in range(rim - 2)]
    path.write_text("\n".join(lines) + "\n")


def box(bottom, y0, y1):
    """The six outward faces of an upright box over four (x, z) corners."""
    low, high = [(x, y0, z) for x, z in bottom], [(x, y1, z) for x, z in bottom]
    centre = tuple(sum(axis) / 8 for axis in zip(*(low + high)))
    faces = [low, high] + [[low[i], low[(i + 1) % 4], high[(i + 1) % 4], high[i]] for i in range(4)]
    return [facing(f, sub(tuple(sum(a) / 4 for a in zip(*f)), centre)) for f in faces]


def plate(centre, normal, half_width, half_depth):
    """A rectangle around a centre, its width along x."""
    across = unit(cross((1, 0, 0), normal))
    corners = [tuple(c + u * half_width * (k == 0) + a * half_depth * v for k, (c, a) in
                     enumerate(zip(centre, across))) for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return [facing(corners, normal)]


def write_meshes(folder):
    folder.mkdir(exist_ok=True)
    walls = {
        "floor": ([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)], (0, 1, 0)),
        "ceiling": ([(-1, 2, -1), (1, 2, -1), (1, 2, 1), (-1, 2, 1)], (0, -1, 0)),
        "back": ([(-1, 0, -1), (1, 0, -1), (1, 2, -1), (-1, 2, -1)], (0, 0, 1)),
        "left": ([(-1, 0, -1), (-1, 0, 1), (-1, 2, 1), (-1, 2, -1)], (1, 0, 0)),
        "right": ([(1, 0, -1), (1, 0, 1), (1, 2, 1), (1, 2, -1)], (-1, 0, 0)),
        "light": ([(-0.25, 1.98, -0.25), (0.25, 1.98, -0.25), (0.25, 1.98, 0.25), (-0.25, 1.98, 0.25)], (0, -1, 0)),
    }
    for name, (corners, normal) in walls.items():
        write_obj(folder / f"{name}.obj", f"Cornell box: {name}", [facing(corners, normal)])
    write_obj(folder / "short_box.obj", "Cornell box: short box", box(SHORT_BOX, 1e-4, 0.6))
    write_obj(folder / "tall_box.obj", "Cornell box: tall box", box(TALL_BOX, 1e-4, 1.2))
    write_disc(folder / "disc.obj", 0.5, 1.0, 32)
    write_obj(folder / "ground.obj", "a square of side 20 at y = 0",
              [facing([(-10, 0, -10), (10, 0, -10), (10, 0, 10), (-10, 0, 10)], (0, 1, 0))])


def constant(color):
    return {"type": "constant", "color": list(color)}


def diffuse(name):
    return {"type": "diffuse", "texture_name": name}


def mesh(name, material, **more):
    return {"type": "mesh", "path": f"meshes/{name}.obj", "material_name": material, **more}


def cornell(integrator, size, boxes, more_materials=None, more_objects=()):
    objects = [mesh("floor", "grey"), mesh("ceiling", "grey"), mesh("back", "grey"), mesh("left", "red"),
               mesh("right", "green")]
    if boxes:
        objects += [mesh("short_box", "grey", translate=[-0.7, 0, 0.6]),
                    mesh("tall_box", "grey", translate=[0.7, 0, -0.5])]
    return {
        "integrator": integrator,
        "film": {"resolution": [size, size]},
        "camera": {"position": [0, 1, 6.8], "look_at": [0, 1, 0], "ref_up": [0, 1, 0], "fov": 19.5},
        "textures": {"grey": constant(GREY), "red": constant(RED), "green": constant(GREEN)},
        "materials": {"grey": diffuse("grey"), "red": diffuse("red"), "green": diffuse("green"),
                      **(more_materials or {})},
        "objects": objects + list(more_objects),
    }


def cornell_scenes():
    point = {"type": "intersection_test", "spp": 32, "max_depth": 16,
             "point_light_position": [0, 1.5, 0.5], "point_light_flux": [17, 12, 5]}
    paths = {"type": "bdpt", "spp": 64, "max_depth": 12}
    light = {"type": "mesh", "path": "meshes/light.obj", "light": {"type": "area", "radiance": [17, 12, 5]}}
    lens = mesh("disc", "lens", translate=[0, 1, 0])
    ball = {"type": "sphere", "center": [0, 0.6, 0.6], "radius": 0.5, "material_name": "glass"}
    glass = {"type": "glass", "R": [0.8, 0.2, 0.7], "T": [0.2, 0.7, 0.8]}
    return {
        "cbox_no_light": cornell(point, 512, True),
        "cbox_no_light_refract": cornell(point, 512, True, {"lens": {"type": "refraction", "eta": 2.0}}, [lens]),
        "cbox": cornell(paths, 600, True, None, [light]),
        "glass_cbox": cornell(paths, 600, False, {"glass": glass}, [light, ball]),
    }


def veach(folder):
    """Four rough plates, each tilted so that it mirrors the row of lights into the camera."""
    eye, lamps = (0.0, 2.0, 15.0), (0.0, 1.0, 0.0)
    centres = [(0, -2.2, 0.8), (0, -2.7, 2.3), (0, -3.15, 4.0), (0, -3.55, 6.0)]
    alphas = [0.01, 0.05, 0.1, 0.25]
    materials = {"wall": diffuse("wall")}
    objects = [{"type": "mesh", "path": "meshes/ground.obj", "translate": [0, -4.4, 0], "material_name": "wall"},
               {"type": "mesh", "path": "meshes/ground.obj", "material_name": "wall",
                "transform": [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, -4, 0, 0, 0, 1]}]
    for i, (centre, alpha) in enumerate(zip(centres, alphas), 1):
        normal = unit(tuple(a + b for a, b in zip(unit(sub(eye, centre)), unit(sub(lamps, centre)))))
        write_obj(folder / "meshes" / f"plate{i}.obj", f"Veach's plates: plate {i}", plate(centre, normal, 4, 0.6))
        materials[f"copper{i}"] = {"type": "roughconductor", "texture_name": "white", "alpha_x": alpha,
                                   "alpha_y": alpha, **COPPER}
        objects.append(mesh(f"plate{i}", f"copper{i}"))
    # The same power from each: radiance falls with the square of the radius.
    for x, radius in ((-3.75, 0.05), (-1.25, 0.15), (1.25, 0.4), (3.75, 0.9)):
        radiance = round(2.0 / radius ** 2, 6)
        objects.append({"type": "sphere", "center": [x, lamps[1], lamps[2]], "radius": radius,
                        "light": {"type": "area", "radiance": [radiance] * 3}})
    return {"integrator": {"type": "path", "spp": 64, "max_depth": 6}, "film": {"resolution": [768, 512]},
            "camera": {"position": list(eye), "look_at": [0, -1.6, 2.5], "ref_up": [0, 1, 0], "fov": 37},
            "textures": {"wall": constant((0.4, 0.4, 0.4)), "white": constant((1, 1, 1))},
            "materials": materials, "objects": objects}


def sphere_scenes():
    white_sky = {"texture_name": "white"}
    furnace = {
        "integrator": {"type": "path", "spp": 64, "max_depth": 64, "rr_threshold": 0},
        "film": {"resolution": [256, 256]}, "camera": {"position": [0, 0, 4], "fov": 45},
        "textures": {"white": constant((1, 1, 1))}, "materials": {"white": diffuse("white")},
        "objects": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material_name": "white"}],
        "environment_map": white_sky,
    }
    checks = {"type": "checkerboard", "color0": [0.6, 0.6, 0.6], "color1": [0.15, 0.15, 0.2],
              "tex_coordinate_generator": {"type": "uvmapping2d", "scale": [8, 4], "delta": [0, 0]}}
    two = {
        "integrator": {"type": "path", "spp": 64, "max_depth": 8}, "film": {"resolution": [600, 400]},
        "camera": {"position": [0, 1.6, 6], "look_at": [0, 0.8, 0], "fov": 40},
        "textures": {"ground": constant((0.5, 0.5, 0.5)), "checks": checks, "orange": constant((0.8, 0.4, 0.1)),
                     "sky": constant((0.5, 0.6, 0.8))},
        "materials": {"ground": diffuse("ground"), "checks": diffuse("checks"), "orange": diffuse("orange")},
        "objects": [mesh("ground", "ground"),
                    {"type": "sphere", "center": [-1.1, 1, 0], "radius": 1, "material_name": "checks"},
                    {"type": "sphere", "center": [1.1, 1, 0], "radius": 1, "material_name": "orange"},
                    {"type": "sphere", "center": [0, 5, 2], "radius": 0.5,
                     "light": {"type": "area", "radiance": [12, 12, 12]}}],
        "environment_map": {"texture_name": "sky", "scale": 0.4},
    }
    return {"sphere": furnace, "two_spheres": two}


def write_scene(path, scene):
    """JSON with short arrays and objects on one line each."""
    text = json.dumps(scene, indent=2)
    out, depth = [], 0
    for line in text.splitlines():
        stripped = line.strip()
        opens = stripped.endswith(("[", "{"))
        if depth or (stripped.endswith("[") and len(line) - len(stripped) > 0 and not stripped.startswith('"objects"')):
            if not depth:
                out.append(line.rstrip())
            else:
                out[-1] += ("" if out[-1].endswith("[") or stripped.startswith("]") else " ") + stripped
            depth += opens - stripped.startswith(("]", "}"))
            continue
        out.append(line)
    path.write_text("\n".join(out) + "\n")


def main():
    folder = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else __file__).resolve()
    folder = folder if folder.is_dir() else folder.parent
    write_meshes(folder / "meshes")
    scenes = {**cornell_scenes(), **sphere_scenes(), "veach": veach(folder)}
    for name, scene in scenes.items():
        write_scene(folder / f"{name}.json", scene)


if __name__ == "__main__":
    main()
