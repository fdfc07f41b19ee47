#!/usr/bin/env python3
"""Writes scene files for models that are not part of this repository.

usage: for_data.py DATA_DIR OUT_DIR

DATA_DIR holds obj/spot, obj/c-ray and cornell/mcguire.
OUT_DIR gets spot.json, teapot.json and cornell.json, whose paths are absolute, and the parts of
the Cornell box as one OBJ file for each material, since an object of a scene has one material.
"""
import json
import pathlib
import sys


def constant(color):
    return {"type": "constant", "color": color}


def diffuse(name, **more):
    return {"type": "diffuse", "texture_name": name, **more}


def ground(out, y):
    path = out / "ground.obj"
    path.write_text("v -20 0 -20\nv -20 0 20\nv 20 0 20\nv 20 0 -20\nf 1 2 3 4\n")
    return {"type": "mesh", "path": str(path), "translate": [0, y, 0], "material_name": "ground"}


def studio(out, model, material, camera, floor_y, textures):
    """A model on a ground under a grey sky and a bright ball."""
    return {
        "integrator": {"type": "path", "spp": 64, "max_depth": 8},
        "film": {"resolution": [512, 512]},
        "camera": camera,
        "textures": {"ground": constant([0.4, 0.4, 0.4]), "sky": constant([0.6, 0.7, 0.9]), **textures},
        "materials": {"ground": diffuse("ground"), "model": material},
        "objects": [
            {"type": "mesh", "path": str(model), "material_name": "model"},
            ground(out, floor_y),
            {"type": "sphere", "center": [3, 5, 4], "radius": 0.8, "light": {"type": "area", "radiance": [20, 20, 20]}},
        ],
        "environment_map": {"texture_name": "sky", "scale": 0.5},
    }


def spot(data, out):
    folder = data / "obj/spot"
    skin = {"type": "image", "path": str(folder / "spot_texture.png")}
    camera = {"position": [1.8, 0.8, -2.6], "look_at": [0, 0.1, 0.15], "fov": 38}
    return studio(out, folder / "spot_triangulated.obj", diffuse("skin"), camera, -0.737, {"skin": skin})


def teapot(data, out):
    metal = {"type": "roughconductor", "texture_name": "white", "alpha_x": 0.1, "alpha_y": 0.1,
             "etaT": [0.2, 0.924, 1.102], "k": [3.912, 2.4528, 2.1421]}
    camera = {"position": [0.6, 1.5, 3], "look_at": [0.05, 0.45, 0], "fov": 38}
    return studio(out, data / "obj/c-ray/teapot.obj", metal, camera, 0, {"white": constant([1, 1, 1])})


def read_mtl(path):
    """Material name -> its statements' numbers, those of Kd and Ke at least."""
    materials, current = {}, None
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) == 2 and words[0] == "newmtl":
            current = materials.setdefault(words[1], {"Kd": [0, 0, 0], "Ke": [0, 0, 0]})
        elif current is not None and words and words[0] in ("Kd", "Ke"):
            current[words[0]] = [float(w) for w in words[1:4]]
    return materials


def split_by_material(path, out):
    """One OBJ for each material, with the vertices it uses; yields (material, path)."""
    vertices, faces, current = [], {}, None
    for line in path.read_text().splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append(" ".join(words[1:4]))
        elif words[:1] == ["usemtl"]:
            current = words[1]
        elif words[:1] == ["f"]:
            corners = [int(word.split("/")[0]) for word in words[1:]]
            faces.setdefault(current, []).append([c - 1 if c > 0 else len(vertices) + c for c in corners])
    for material, polygons in faces.items():
        used = sorted({c for polygon in polygons for c in polygon})
        place = {v: i + 1 for i, v in enumerate(used)}
        part = out / f"cornell_{material}.obj"
        lines = ["v " + vertices[v] for v in used]
        lines += ["f " + " ".join(str(place[c]) for c in polygon) for polygon in polygons]
        part.write_text("\n".join(lines) + "\n")
        yield material, part


def cornell(data, out):
    path = data / "cornell/mcguire/CornellBox-Original.obj"
    mtl = read_mtl(path.with_suffix(".mtl"))
    textures, materials, objects = {}, {}, []
    for name, part in split_by_material(path, out):
        textures[name], materials[name] = constant(mtl[name]["Kd"]), diffuse(name, twosided=True)
        entry = {"type": "mesh", "path": str(part), "material_name": name}
        if any(mtl[name]["Ke"]):
            entry["light"] = {"type": "area", "radiance": mtl[name]["Ke"]}
        objects.append(entry)
    return {"integrator": {"type": "path", "spp": 64, "max_depth": 12}, "film": {"resolution": [512, 512]},
            "camera": {"position": [0, 1, 6.8], "look_at": [0, 1, 0], "fov": 19.5},
            "textures": textures, "materials": materials, "objects": objects}


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    data, out = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
    out.mkdir(parents=True, exist_ok=True)
    for make in (spot, teapot, cornell):
        (out / f"{make.__name__}.json").write_text(json.dumps(make(data, out), indent=2) + "\n")


if __name__ == "__main__":
    main()
