#!/usr/bin/env python3
"""Writes scenes by chance, for claims.py: what the rule of --target-error was tuned on, and others.

usage: claim_scenes.py DIR FIRST COUNT

DIR gets roomN.json for N from FIRST on; the number decides all of it. Every room is the Cornell box or part of it on open
ground, with one to five balls of any material (glass, rough glass, mirrors, metals, coats, textures), and one kind of
lights: the ceiling's, a few small balls, many, points and spots, a sky, or a lamp that shines through the door of a screen.
"""
import json
import pathlib
import random
import sys

MESHES = pathlib.Path(__file__).resolve().parents[2] / "scenes/meshes"


def colour(r, low=0.1, high=0.85):
    return [round(r.uniform(low, high), 3) for _ in range(3)]


def material(r):
    kind = r.choice(("diffuse", "check", "glass", "glass", "roughdielectric", "mirror", "roughconductor",
                     "metal", "plastic", "refraction"))
    if kind == "check":
        return {"type": "diffuse", "texture_name": "check"}
    if kind == "diffuse":
        return {"type": "diffuse", "color": colour(r)}
    if kind == "glass":
        return {"type": "glass", "eta": round(r.uniform(1.2, 1.8), 2), "R": 1, "T": colour(r, 0.6, 1)}
    if kind == "roughdielectric":
        a = round(r.uniform(0.03, 0.4), 3)
        return {"type": kind, "eta": 1.5, "alpha_x": a, "alpha_y": a}
    if kind == "mirror":
        return {"type": kind, "R": colour(r, 0.7, 0.95)}
    if kind == "refraction":
        return {"type": kind, "eta": 1.5}
    if kind == "roughconductor":
        return {"type": kind, "R": 1, "alpha_x": round(r.uniform(0.02, 0.4), 3),
                "alpha_y": round(r.uniform(0.02, 0.4), 3), "etaT": [0.2, 0.924, 1.102], "k": [3.912, 2.4528, 2.1421]}
    if kind == "metal":
        return {"type": "principled", "metallic": 1, "roughness": round(r.uniform(0.05, 0.6), 2), "color": colour(r, 0.5, 0.95)}
    return {"type": "principled", "roughness": round(r.uniform(0.1, 0.6), 2), "color": colour(r), "clearcoat": 1}


def ball(center, radius, **more):
    return {"type": "sphere", "center": [round(v, 3) for v in center], "radius": round(radius, 3), **more}


def small_lights(r, count):
    power = r.uniform(1.5, 6) / count
    objects = []
    for _ in range(count):
        radius = r.uniform(0.02, 0.15)
        radiance = power / (4 * 3.14 * radius ** 2)
        objects.append(ball((r.uniform(-0.9, 0.9), r.uniform(0.9, 1.85), r.uniform(-0.9, 0.9)), radius,
                            light={"type": "area", "radiance": [round(radiance * c, 3) for c in colour(r, 0.5, 1)]}))
    return objects


def light_of(r, scene):
    kind = r.choice(("ceiling", "few", "many", "points", "sky", "up"))
    objects, walls = scene["objects"], ["floor", "back", "left", "right", "ceiling"]
    if kind == "ceiling":
        objects.append({"type": "mesh", "path": str(MESHES / "light.obj"),
                        "light": {"type": "area", "radiance": [17, 12, 5]}})
    elif kind == "few":
        objects += small_lights(r, r.randint(1, 3))
    elif kind == "many":
        objects += small_lights(r, r.randint(8, 40))
    elif kind == "points":
        scene["lights"] = [{"type": "point", "position": [0.5, 1.7, 0.5], "intensity": colour(r, 0.3, 1)},
                           {"type": "spot", "position": [-0.6, 1.8, 0.6], "look_at": [0, 0.3, 0], "outer_angle": 25,
                            "intensity": colour(r, 2, 6)}]
    elif kind == "sky":
        scene["textures"]["sky"] = {"type": "constant", "color": [0.6, 0.7, 0.9]}
        scene["environment_map"] = {"texture_name": "sky", "scale": round(r.uniform(0.3, 1.5), 2)}
        objects += small_lights(r, 1)
        walls = r.choice((["floor"], ["floor", "back"], ["floor", "left", "back"]))
    else:  # a lamp in a bowl: all light comes by the ceiling
        objects.append(ball((0.55, 1.2, -0.4), 0.1, light={"type": "area", "radiance": [90, 80, 60]}))
        objects.append({"type": "mesh", "path": str(MESHES / "light.obj"), "translate": [0.55, -0.95, -0.4],
                        "material_name": "white"})
    return kind, walls


def room(number):
    r = random.Random(number)
    scene = {"integrator": {"type": "path", "max_depth": r.choice((4, 6, 8, 12))},
             "film": {"resolution": [192, 128]},
             "camera": {"position": [round(r.uniform(-0.5, 0.5), 2), round(r.uniform(0.7, 1.4), 2), 5.2],
                        "look_at": [0, round(r.uniform(0.6, 1), 2), 0], "fov": round(r.uniform(18, 27), 1)},
             "textures": {"check": {"type": "checkerboard", "color0": colour(r, 0.4, 0.9), "color1": colour(r, 0.02, 0.3),
                                    "tex_coordinate_generator": {"scale": [6, 6]}}},
             "materials": {"white": {"type": "diffuse", "color": [0.73, 0.71, 0.68], "twosided": True},
                           "left": {"type": "diffuse", "color": colour(r)},
                           "right": {"type": "diffuse", "color": colour(r)}}, "objects": []}
    kind, walls = light_of(r, scene)
    for wall in walls:
        name = wall if wall in ("left", "right") else "white"
        scene["objects"].append({"type": "mesh", "path": str(MESHES / f"{wall}.obj"), "material_name": name})
    for i in range(r.randint(1, 5)):
        scene["materials"][f"m{i}"] = material(r)
        radius = r.uniform(0.15, 0.45)
        height = radius if r.random() < 0.7 else r.uniform(radius, 1.5)
        scene["objects"].append(ball((r.uniform(-0.6, 0.6), height, r.uniform(-0.5, 0.7)), radius, material_name=f"m{i}"))
    return kind, scene


def main():
    folder, first, count = pathlib.Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(first, first + count):
        kind, scene = room(number)
        (folder / f"room{number}.json").write_text(json.dumps(scene, indent=1) + "\n")
        print(number, kind, *(m.get("type") for k, m in scene["materials"].items() if k.startswith("m")))


if __name__ == "__main__":
    main()
