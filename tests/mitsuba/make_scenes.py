"""Writes the scenes, meshes and pictures of this folder from their numbers.

The output is committed; run it after changing a number (`run scenes`), then `run references` for
the scenes that changed, and commit all.

Each scene is 48 x 48 pixels and asks one question of the two renderers, or a few that do not hide
each other. Lights are large and glossy surfaces not too smooth, so that blocks of pixels are near
normal after a few hundred samples and a test of them means what it says.
"""
import json
import math
import pathlib

import mitsuba as mi
import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
FOLDER = HERE / "scenes"
BOX = "../../../scenes/meshes/"
GREY, RED, GREEN = [0.725, 0.71, 0.68], [0.63, 0.065, 0.05], [0.14, 0.45, 0.091]
COPPER = {"R": 1, "etaT": [0.200438, 0.924033, 1.10221], "k": [3.91295, 2.45285, 2.14219]}
BOX_CAMERA = {"position": [0, 1, 6.8], "look_at": [0, 1, 0], "fov": 19.5}


def diffuse(color, **more):
    return {"type": "diffuse", "color": color, **more}


def mesh(path, material=None, **more):
    o = {"type": "mesh", "path": path, **more}
    if material:
        o["material_name"] = material
    return o


def sphere(center, radius, material=None, light=None):
    o = {"type": "sphere", "center": center, "radius": radius}
    if material:
        o["material_name"] = material
    if light:
        o["light"] = {"type": "area", "radiance": light}
    return o


def quad(name, corners, uvs=None, normals=None):
    """Writes an OBJ of one quadrilateral; its normal is counter-clockwise."""
    lines = [f"# {name}; written by make_scenes.py"]
    lines += ["v " + " ".join(f"{x:.9g}" for x in c) for c in corners]
    lines += ["vt " + " ".join(f"{x:.9g}" for x in c) for c in uvs or []]
    lines += ["vn " + " ".join(f"{x:.9g}" for x in c) for c in normals or []]
    corner = [f"{i}" + (f"/{i}" if uvs else "") for i in range(1, 5)]
    lines.append("f " + " ".join(corner))
    (FOLDER / f"{name}.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return f"{name}.obj"


UNIT_UVS = [(0, 0), (1, 0), (1, 1), (0, 1)]


def floor(name, y, half, uvs=UNIT_UVS):
    return quad(name, [(-half, y, half), (half, y, half), (half, y, -half), (-half, y, -half)], uvs)


def bumpy(name, rings=24, sectors=48):
    """A closed surface like a knobbly apple with smooth normals and uvs, some faces wound against
    their normals."""
    def point(u, v):
        phi, theta = 2 * math.pi * u, math.pi * v
        r = 0.8 + 0.1 * math.sin(3 * phi) * math.sin(theta) ** 3
        return np.array([r * math.sin(theta) * math.cos(phi), r * math.cos(theta),
                         r * math.sin(theta) * math.sin(phi)])

    lines = [f"# {name}; written by make_scenes.py"]
    for j in range(rings + 1):
        for i in range(sectors + 1):
            u, v = i / sectors, min(max(j / rings, 1e-4), 1 - 1e-4)
            p, h = point(u, v), 1e-5
            n = np.cross(point(u, v + h) - point(u, v - h), point(u + h, v) - point(u - h, v))
            n /= np.linalg.norm(n) * (1 if np.dot(n, p) > 0 else -1)
            lines += ["v %.6f %.6f %.6f" % tuple(p), "vt %.6f %.6f" % (u, 1 - v),
                      "vn %.6f %.6f %.6f" % tuple(n)]
    for j in range(rings):
        for i in range(sectors):
            a = j * (sectors + 1) + i + 1
            b = a + sectors + 1
            for face in ((a, a + 1, b + 1), (a, b + 1, b) if (i + j) % 5 else (b, b + 1, a)):
                lines.append("f " + " ".join(f"{k}/{k}/{k}" for k in face))
    (FOLDER / f"{name}.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return f"{name}.obj"


def pictures():
    """A tile with no symmetry, a leaf with a hole and a thin rim, and a sky with a soft sun, written
    as OpenEXR."""
    y, x = np.mgrid[0:16, 0:24] + 0.5
    tile = np.stack([x / 24, y / 16, 0.2 + 0.6 * ((x // 4 + y // 4) % 2)], axis=2) * 0.8
    mi.Bitmap(tile.astype(np.float32)).write(str(FOLDER / "tile.exr"))
    y, x = np.mgrid[0:16, 0:16] + 0.5
    far = np.hypot(x - 8, (y - 7) * 0.8)
    opacity = np.where(far < 6, np.where(np.hypot(x - 10, y - 5) < 1.6, 0, 1), np.where(far < 7, 0.4, 0))
    leaf = np.stack([0.2 + x / 30, 0.8 - y / 40, 0.1 + 0.3 * ((x // 2) % 2), opacity], axis=2)
    mi.Bitmap(leaf.astype(np.float32), mi.Bitmap.PixelFormat.RGBA).write(str(FOLDER / "leaf.exr"))
    y, x = np.mgrid[0:32, 0:64] + 0.5
    theta, phi = y / 32 * math.pi, x / 64 * 2 * math.pi
    ground = (theta > math.pi / 2)[:, :, None]
    sky = np.where(ground, [0.1, 0.08, 0.06], [0.25, 0.35, 0.6]) + 0.0 * theta[:, :, None]
    near = np.sin(theta) * math.sin(0.9) * np.cos(phi - 1.2) + np.cos(theta) * math.cos(0.9)
    sky = sky + 12 * np.exp(12 * (near - 1))[:, :, None] * np.array([1, 0.85, 0.6])
    mi.Bitmap(sky.astype(np.float32)).write(str(FOLDER / "sky.exr"))


def write(name, scene, **integrator):
    integrator = {"type": "path", **({} if "type" in integrator else {"max_depth": 6}), **integrator}
    scene = {"integrator": integrator,
             "film": {"resolution": [48, 48], **scene.pop("film", {})}, **scene}
    text = json.dumps(scene, indent=1)
    (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def room(extra, materials=None, light=True, **scene):
    """The Cornell box with things in it."""
    walls = {"grey": diffuse(GREY), "red": diffuse(RED), "green": diffuse(GREEN)}
    objects = [mesh(BOX + "floor.obj", "grey"), mesh(BOX + "ceiling.obj", "grey"),
               mesh(BOX + "back.obj", "grey"), mesh(BOX + "left.obj", "red"),
               mesh(BOX + "right.obj", "green")]
    if light:
        objects.append(mesh(BOX + "light.obj", light={"type": "area", "radiance": [17, 12, 5]}))
    return {"camera": BOX_CAMERA, "materials": {**walls, **(materials or {})},
            "objects": objects + extra, **scene}


# Lifted off the floor: in single precision the gap of 1e-4 that the meshes leave is less than the
# step by which Mitsuba's rays leave a surface, and light would go through the floor.
SHORT = {"translate": [-0.7, 0.01, 0.6]}
TALL = {"translate": [0.7, 0, -0.5]}


def boxes():
    both = [mesh(BOX + "short_box.obj", "grey", **SHORT), mesh(BOX + "tall_box.obj", "grey", **TALL)]
    write("cornell_area", room(both), max_depth=12)
    write("cornell_point", room(both, light=False, lights=[
        {"type": "point", "position": [0.2, 1.5, 0.5], "intensity": [4, 3, 2]}]))
    write("cornell_direct", room(both), type="direct")
    write("seed_light", room(both, light=False), type="intersection_test", max_depth=16,
          point_light_position=[0, 1.5, 0.5], point_light_flux=[17, 12, 5])
    glass = {"glass": {"type": "glass", "eta": 1.5}}
    write("glass_block", room([mesh(BOX + "short_box.obj", "glass", **SHORT), both[1]], glass),
          max_depth=8)
    tinted = {"glass": {"type": "glass", "R": [0.8, 0.2, 0.7], "T": [0.2, 0.7, 0.8]}}
    write("glass_sphere", room([sphere([0, 0.6, 0.6], 0.5, "glass")], tinted), max_depth=8)


def dielectrics():
    # Water in glass: the inner surface's index is water's over glass's. An air bubble beside it.
    nested = {"glass": {"type": "glass", "eta": 1.5}, "water": {"type": "glass", "eta": 1.33 / 1.5},
              "air": {"type": "glass", "eta": 1 / 1.5}}
    sky = {"textures": {"sky": {"type": "image", "path": "sky.exr"},
                        "check": {"type": "checkerboard", "color0": [0.7, 0.6, 0.3],
                                  "color1": 0.1, "tex_coordinate_generator": {"scale": [4, 4]}}},
           "environment_map": {"texture_name": "sky"}}
    ground = mesh(floor("floor", -1, 4), "ground")
    nested["ground"] = {"type": "diffuse", "texture_name": "check"}
    write("nested_glass", {
        "camera": {"position": [0, 0.6, 4.5], "look_at": [0, -0.1, 0], "fov": 40},
        "materials": nested, **sky,
        "objects": [ground, sphere([0, 0, 0], 1, "glass"), sphere([-0.3, 0, 0.1], 0.45, "water"),
                    sphere([0.5, 0.1, 0], 0.3, "air")]}, max_depth=10)
    rough = {"ground": nested["ground"],
             "ggx": {"type": "roughdielectric", "distribution": "ggx", "alpha_x": 0.3,
                     "alpha_y": 0.3, "T": [0.9, 0.95, 0.8]},
             "beckmann": {"type": "roughdielectric", "alpha_x": 0.2, "alpha_y": 0.2, "eta": 1.33}}
    write("rough_glass", {
        "camera": {"position": [0, 0.6, 4.5], "look_at": [0, -0.1, 0], "fov": 40},
        "materials": rough, **sky,
        "objects": [ground, sphere([-0.8, -0.1, 0], 0.75, "ggx"),
                    sphere([0.8, -0.1, 0], 0.75, "beckmann")]}, max_depth=8)
    # Open sheets: the one sees light compressed by eta^2, the other stretched.
    sheets = {"ground": nested["ground"], "glass": {"type": "glass", "eta": 1.4},
              "bend": {"type": "refraction", "eta": 1.4},
              "rough": {"type": "roughdielectric", "distribution": "ggx", "eta": 1.4,
                        "alpha_x": 0.3, "alpha_y": 0.3}}

    def sheet(name, x, turned):
        corners = [(x - 0.45, -0.8, 0), (x + 0.45, -0.8, 0.2), (x + 0.45, 0.8, 0), (x - 0.45, 0.8, 0)]
        return quad(name, list(reversed(corners)) if turned else corners)

    write("glass_sheets", {
        "camera": {"position": [0, 0.5, 5], "look_at": [0, -0.1, 0], "fov": 40},
        "materials": sheets, **sky,
        "objects": [ground, mesh(sheet("sheet1", -1.5, False), "glass"),
                    mesh(sheet("sheet2", -0.5, True), "glass"),
                    mesh(sheet("sheet3", 0.5, False), "bend"),
                    mesh(sheet("sheet4", 1.5, True), "rough")]}, max_depth=8)


def metals():
    wall = {"wall": diffuse(0.4)}
    plates = {"flat": {"type": "roughconductor", "alpha_x": 0.1, "alpha_y": 0.1, **COPPER},
              "brushed": {"type": "roughconductor", "alpha_x": 0.05, "alpha_y": 0.4, **COPPER},
              "ggx": {"type": "roughconductor", "alpha_x": 0.4, "alpha_y": 0.1,
                      "distribution": "ggx", **COPPER},
              "dense": {"type": "roughconductor", "alpha_x": 0.25, "alpha_y": 0.25, "R": [1, .9, .8],
                        "distribution": "ggx",
                        "etaI": 1.33, "etaT": [1.5, 0.9, 0.6], "k": [7, 5, 3]}}
    names = list(plates)
    objects = [mesh("../../../scenes/meshes/ground.obj", "wall", translate=[0, -4.4, 0]),
               mesh("../../../scenes/meshes/ground.obj", "wall",
                    transform=[1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, -4, 0, 0, 0, 1])]
    for k in range(4):
        text = (HERE.parent.parent / f"scenes/meshes/plate{k + 1}.obj").read_text(encoding="utf-8")
        corners = [tuple(map(float, l.split()[1:])) for l in text.splitlines() if l[0] == "v"]
        # The grain runs askew, so that the two axes cannot be swapped unseen.
        uvs = [(0, 0), (1, 0.3), (0.8, 1.3), (-0.2, 1)]
        objects.append(mesh(quad(f"plate{k + 1}", corners, uvs), names[k]))
    for x, r in ((-3.75, 0.2), (-1.25, 0.3), (1.25, 0.5), (3.75, 0.9)):
        objects.append(sphere([x, 1, 0], r, None, [2 / r / r] * 3))
    write("veach_plates", {"camera": {"position": [0, 2, 15], "look_at": [0, -1.6, 2.5], "fov": 37},
                           "materials": {**wall, **plates}, "objects": objects}, max_depth=5)
    metal = {"gold": {"type": "principled", "metallic": 1, "roughness": 0.5,
                      "color": [0.9, 0.6, 0.2]},
             "steel": {"type": "principled", "metallic": 1, "roughness": 0.3, "color": 0.6},
             "mirror": {"type": "mirror", "R": [0.9, 0.8, 0.95]}}
    write("metal_spheres", room([sphere([-0.5, 0.4, 0.3], 0.4, "gold"),
                                 sphere([0.5, 0.4, 0.4], 0.4, "steel"),
                                 sphere([0, 1.2, -0.2], 0.45, "mirror")], metal))


def textured():
    sky = {"type": "image", "path": "sky.exr"}
    tile = {"type": "image", "path": "tile.exr",
            "tex_coordinate_generator": {"scale": [3, 2], "delta": [0.1, -0.3]}}
    check = {"type": "checkerboard", "color0": [0.8, 0.3, 0.1], "color1": [0.1, 0.3, 0.6],
             "tex_coordinate_generator": {"scale": [3, 1.5], "delta": [0.25, 0.1]}}
    turned = [0.36, 0.48, -0.8, 0, -0.8, 0.6, 0, 0, 0.48, 0.64, 0.6, 0, 0, 0, 0, 1]
    write("textured_mesh", {
        "camera": {"position": [1, 1.2, 3], "look_at": [0, -0.1, 0], "fov": 40},
        "textures": {"sky": sky, "tile": tile, "check": check},
        "materials": {"tile": {"type": "diffuse", "texture_name": "tile"},
                      "check": {"type": "diffuse", "texture_name": "check"}},
        "environment_map": {"texture_name": "sky", "scale": 0.8, "transform": turned},
        "objects": [mesh(floor("floor", -1, 4), "check"), mesh(bumpy("bumpy"), "tile")]})
    write("sky_alone", {
        "camera": {"position": [0, 0, 0], "look_at": [0.3, 0.2, -1], "fov": 100},
        "textures": {"sky": sky}, "materials": {"grey": diffuse(0.5)},
        "environment_map": {"texture_name": "sky", "transform": turned},
        "objects": [sphere([0.3, -0.4, -2], 0.5, "grey")]})
    tiny = {"type": "checkerboard", "color0": 0.9, "color1": [0.1, 0.2, 0.3],
            "tex_coordinate_generator": {"scale": [4, 3]}}
    mirrored = [-0.8, 0.3, 0, 0.9, 0, 0.6, 0.2, 0.3, 0.1, 0, 0.9, 0, 0, 0, 0, 1]
    write("spheres_uv", {
        "camera": {"position": [0.5, 1.5, 4.5], "look_at": [0, 0, 0], "fov": 36},
        "textures": {"check": tiny, "tile": tile, "sky": {"type": "constant", "color": [.5, .6, 1]}},
        "materials": {"check": {"type": "diffuse", "texture_name": "check"},
                      "tile": {"type": "diffuse", "texture_name": "tile"},
                      "both": {"type": "diffuse", "texture_name": "check", "twosided": True}},
        "environment_map": {"texture_name": "sky", "scale": 0.7},
        "objects": [mesh(floor("floor", -1, 4), "both"), sphere([-0.9, -0.2, 0.5], 0.8, "check"),
                    sphere([0.3, -0.4, -1], 0.6, "tile"),
                    mesh("bumpy.obj", "tile", transform=mirrored, translate=[0.3, -0.3, 0.4])]})


def cut_out():
    """Leaves that are cut out and leaves that are thin, and pictures that shine."""
    leaf = {"type": "image", "path": "leaf.exr", "filter": "nearest",
            "tex_coordinate_generator": {"scale": [2, 2]}}
    glow = {"type": "image", "path": "tile.exr", "filter": "bilinear",
            "tex_coordinate_generator": {"scale": [2, 1], "delta": [0.2, 0.1]}}
    card = quad("card", [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], UNIT_UVS)

    def paper(**more):
        return {"type": "principled", "specular": 0, **more}

    def leaning(angle, *place):
        s, c = math.sin(angle), math.cos(angle)
        rows = [(0.7 * c, 0, -0.7 * s), (0, 0.7, 0), (0.7 * s, 0, 0.7 * c)]
        return {"transform": [x for r, at in zip(rows, place) for x in (*r, at)] + [0, 0, 0, 1]}

    view = {"position": [0.4, 0.9, 4.5], "look_at": [0, -0.2, 0], "fov": 40}
    write("leaves", {
        "camera": view, "textures": {"sky": {"type": "image", "path": "sky.exr"}, "leaf": leaf},
        "materials": {"ground": diffuse([0.6, 0.5, 0.4]),
                      "cut": paper(texture_name="leaf", alpha_mode="mask"),
                      "thin": paper(texture_name="leaf", alpha_mode="blend", alpha=0.8)},
        "environment_map": {"texture_name": "sky"},
        "objects": [mesh(floor("floor", -1, 4), "ground"), mesh(card, "cut", **leaning(0.4, -0.6, -0.2, 0)),
                    mesh(card, "thin", **leaning(-0.5, 0.7, -0.1, 0.3)),
                    sphere([0, -0.4, -1.2], 0.6, "cut")]},
          max_depth=32)  # of which Mitsuba takes one for each surface that lets a ray through
    write("glow", {
        "camera": view, "textures": {"glow": glow},
        "materials": {"ground": diffuse([0.6, 0.5, 0.4]),
                      "glow": paper(color=0.3, emission=[3, 3, 3], emission_texture="glow")},
        "objects": [mesh(floor("floor", -1, 4), "ground"), mesh(card, "glow", **leaning(-0.4, -0.9, -0.1, -0.4)),
                    sphere([0.7, -0.4, 0], 0.5, "glow")]})


def lights():
    grey = {"grey": diffuse(0.6), "two": diffuse([0.3, 0.6, 0.5], twosided=True),
            "one": diffuse([0.6, 0.5, 0.3])}
    write("punctual", {
        "camera": {"position": [0, 3, 4], "look_at": [0, -0.8, 0], "type": "orthographic",
                   "ortho_height": 4},
        "materials": grey, "objects": [mesh(floor("floor", -1, 4), "grey"),
                                       sphere([0, -0.4, 0], 0.6, "grey")],
        "lights": [{"type": "spot", "position": [1.5, 2, 0.5], "look_at": [0.8, -1, 0.2],
                    "outer_angle": 25, "intensity": [20, 16, 10]},
                   {"type": "spot", "position": [-2, 1, 1], "direction": [0.7, -1, -0.4],
                    "outer_angle": 40, "inner_angle": 5, "intensity": [4, 8, 12]},
                   {"type": "directional", "direction": [0.5, -1, -0.7], "irradiance": [0.5, 0.4, 0.6]},
                   {"type": "point", "position": [0, 1, 2], "intensity": [1, 1, 0.3]}]}, max_depth=4)
    # Sheets that are lit, seen and shining from either side.
    def stand(name, x, turned):
        c = [(x - 0.4, -0.9, 0.3), (x + 0.4, -0.9, -0.2), (x + 0.4, 0.7, -0.2), (x - 0.4, 0.7, 0.3)]
        return quad(name, list(reversed(c)) if turned else c)

    lamp = quad("lamp", [(-0.6, 1.2, -1.5), (0.6, 1.2, -1.5), (0.6, 0.4, -1.9), (-0.6, 0.4, -1.9)])
    write("sides", {
        "camera": {"position": [0.3, 0.6, 5], "look_at": [0, -0.2, 0], "fov": 40},
        "materials": grey,
        "objects": [mesh(floor("floor", -1, 4), "grey"),
                    mesh(stand("stand1", -1.3, False), "one"), mesh(stand("stand2", -0.4, True), "one"),
                    mesh(stand("stand3", 0.5, False), "two"), mesh(stand("stand4", 1.3, True), "two"),
                    mesh(lamp, light={"type": "area", "radiance": [8, 7, 6]}),
                    mesh(lamp, "one", translate=[0, 0.6, 3],
                         light={"type": "area", "radiance": [2, 3, 6]}),
                    sphere([-1.5, 1.2, 0.5], 0.3, "grey", [3, 2, 1])]})


def cameras():
    grey = {"grey": diffuse(0.6), "red": diffuse(RED), "check": {"type": "diffuse",
                                                                "texture_name": "check"}}
    check = {"type": "checkerboard", "color0": 0.8, "color1": 0.1,
             "tex_coordinate_generator": {"scale": [5, 5]}}
    scene = {
        "textures": {"check": check, "sky": {"type": "constant", "color": 1}}, "materials": grey,
        "environment_map": {"texture_name": "sky"},
        "objects": [mesh(floor("floor", -1, 4), "check"), sphere([-0.9, -0.5, 1.2], 0.5, "red"),
                    sphere([0.8, -0.4, -1], 0.6, "grey")]}
    write("thin_lens", {**scene, "film": {"filter": {"type": "gaussian", "radius": 2, "alpha": 2}},
                        "camera": {"position": [0, 0.5, 4.5], "look_at": [0, -0.4, 0], "fov": 36,
                                   "ref_up": [0.3, 1, 0], "aperture_radius": 0.25,
                                   "focal_length": 3.3}}, max_depth=4)
    for name, f in (("filter_tent", {"type": "tent", "radius": 1}),
                    ("filter_mitchell", {"type": "mitchell", "radius": 2})):
        write(name, {**scene, "film": {"resolution": [64, 40], "filter": f},
                     "camera": {"position": [0, 0.5, 4.5], "look_at": [0, -0.4, 0], "fov": 36}},
              max_depth=3)


def main():
    mi.set_variant("scalar_rgb")
    FOLDER.mkdir(exist_ok=True)
    pictures()
    boxes()
    dielectrics()
    metals()
    textured()
    cut_out()
    lights()
    cameras()
    return 0
