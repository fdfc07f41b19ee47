"""Scenes nobody chose: drawn from a seed, within what scene_map can bring over.

Each mixes meshes under turning, stretching and mirroring transforms, spheres, all materials that
both renderers have, lights of every kind, pictures as textures and skies, and cameras. What would
only be noisy is left out: lights are large where glass or polished metal may focus them, and the
filter is the box, since a black block that a light reaches through the tail of a filter has no
normal mean.
"""
import json
import math
import os
import pathlib
import random

HERE = pathlib.Path(__file__).resolve().parent


class Drawn:
    """One scene. `number` seeds it; `folder` is where it will lie, for the paths of its files."""

    def __init__(self, number, folder):
        self.r = random.Random(number)
        self.folder = folder
        self.textures, self.materials = {}, {}
        # Sharp interfaces and small lights do not go together: nobody would finish those caustics.
        self.sharp = self.r.random() < 0.5

    def path(self, file):
        return os.path.relpath(HERE / file, self.folder)

    def between(self, low, high):
        return round(self.r.uniform(low, high), 4)

    def colour(self, low=0.05, high=0.9):
        return [self.between(low, high) for _ in range(3)]

    def direction(self):
        while True:
            v = [self.r.gauss(0, 1) for _ in range(3)]
            length = math.sqrt(sum(x * x for x in v))
            if length > 1e-3:
                return [round(x / length, 4) for x in v]

    # --- Materials ----------------------------------------------------------------------------

    def mapping(self):
        if self.r.random() < 0.3:
            return {"matrix": [self.between(-3, 3) for _ in range(6)]}
        return {"scale": [self.between(0.5, 4), self.between(0.5, 4)],
                "delta": [self.between(-1, 1), self.between(-1, 1)]}

    def texture(self):
        name = f"texture{len(self.textures)}"
        kind = self.r.choice(["check", "image", "constant"])
        if kind == "check":
            made = {"type": "checkerboard", "color0": self.colour(), "color1": self.colour(),
                    "tex_coordinate_generator": self.mapping()}
        elif kind == "image":
            # Bilinear: the other side has no mip maps.
            made = {"type": "image", "path": self.path("scenes/tile.exr"), "filter": "bilinear",
                    "wrap": self.r.choice(["repeat", "mirror", "clamp"]),
                    "tex_coordinate_generator": self.mapping(), "color": self.colour(0.4, 1)}
        else:
            made = {"type": "constant", "color": self.colour()}
        self.textures[name] = made
        return name

    def facets(self, uvs):
        """Where there are no uvs the axes of the grain are each renderer's own choice."""
        low = 0.15 if self.sharp else 0.08
        alpha = self.between(low, 0.6)
        return {"distribution": self.r.choice(["ggx", "beckmann"]),
                "alpha_x": alpha, "alpha_y": self.between(low, 0.6) if uvs else alpha}

    def diffuse(self, uvs):
        made = {"type": "diffuse", "twosided": self.r.random() < 0.5}
        if uvs and self.r.random() < 0.6:
            return {**made, "texture_name": self.texture()}
        return {**made, "color": self.colour()}

    def metal(self, uvs):
        made = {"type": "roughconductor", **self.facets(uvs), "R": self.colour(0.5, 1),
                "etaT": self.colour(0.15, 2.5), "k": self.colour(1.5, 6)}
        if self.r.random() < 0.3:
            made["etaI"] = self.between(1, 1.5)
        return made

    def material(self, uvs):
        """Name of a new one, for a surface with or without uvs. Glass and mirrors only among large
        lights."""
        kinds = ["diffuse"] * 4 + ["metal"] * 2 + ["principled", "roughdielectric"]
        if self.sharp:
            kinds += ["glass"] * 2 + ["mirror", "refraction"]
        kind = self.r.choice(kinds)
        eta = self.r.choice([1.1, 1.33, 1.5, 1.8, 1 / 1.33, 1 / 1.5])
        made = {
            "diffuse": lambda: self.diffuse(uvs),
            "metal": lambda: self.metal(uvs),
            "principled": lambda: {"type": "principled", "metallic": 1, "color": self.colour(),
                                   "roughness": self.between(0.4, 1)},
            "roughdielectric": lambda: {"type": "roughdielectric", **self.facets(uvs), "eta": eta,
                                        "R": self.colour(0.5, 1), "T": self.colour(0.5, 1)},
            "glass": lambda: {"type": "glass", "eta": eta, "R": self.colour(0.5, 1),
                              "T": self.colour(0.5, 1)},
            "mirror": lambda: {"type": "mirror", "R": self.colour(0.5, 1)},
            "refraction": lambda: {"type": "refraction", "eta": eta}}[kind]()
        name = f"material{len(self.materials)}"
        self.materials[name] = made
        return name

    # --- Objects ------------------------------------------------------------------------------

    def transform(self, size):
        """A turn, a stretch along each axis, at times mirrored, with a shift."""
        a, b = self.direction(), self.direction()
        dot = sum(x * y for x, y in zip(a, b))
        b = [y - dot * x for x, y in zip(a, b)]
        length = math.sqrt(sum(x * x for x in b)) or 1
        b = [x / length for x in b]
        c = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        scales = [size * self.r.uniform(0.6, 1.4) for _ in range(3)]
        if self.r.random() < 0.3:
            scales[0] = -scales[0]
        place = [self.between(-1.3, 1.3), self.between(-0.6, 1), self.between(-1.3, 1.3)]
        matrix = []
        for row in range(3):
            matrix += [round(axis[row] * s, 6) for axis, s in zip((a, b, c), scales)]
            matrix.append(place[row])
        return matrix + [0, 0, 0, 1]

    def thing(self):
        if self.r.random() < 0.4:
            made = {"type": "sphere", "radius": self.between(0.2, 0.6),
                    "center": [self.between(-1.3, 1.3), self.between(-0.6, 1), self.between(-1.3, 1.3)]}
        else:
            file = self.r.choice(["scenes/bumpy.obj", "../../scenes/meshes/short_box.obj",
                                  "../../scenes/meshes/tall_box.obj", "scenes/lamp.obj"])
            size = 0.6 if file.endswith("bumpy.obj") else 0.8
            made = {"type": "mesh", "path": self.path(file), "transform": self.transform(size)}
        uvs = made["type"] == "sphere" or made["path"].endswith("bumpy.obj")
        return {**made, "material_name": self.material(uvs)}

    def emitters(self):
        """Lamps above and beside, and at times things that shine in the middle."""
        made = []
        for _ in range(self.r.randint(1, 3)):
            radiance = self.colour(1, 6)
            at = self.direction()
            place = [round(3 * at[0], 4), round(1.5 + 1.2 * abs(at[1]), 4), round(3 * at[2], 4)]
            if self.r.random() < 0.5:
                lamp = {"type": "sphere", "center": place, "radius": self.between(0.4, 0.9)}
            else:
                lamp = {"type": "mesh", "path": self.path("scenes/lamp.obj"),
                        "transform": self.transform(1.5)}
                lamp["transform"][3:12:4] = place
            if self.r.random() < 0.3:
                lamp["material_name"] = self.material(lamp["type"] == "sphere")
            made.append({**lamp, "light": {"type": "area", "radiance": radiance}})
        return made

    def punctual(self):
        position = [self.between(-2, 2), self.between(1.2, 3), self.between(-2, 2)]
        kind = self.r.choice(["point", "spot", "directional"])
        if kind == "point":
            return {"type": kind, "position": position, "intensity": self.colour(1, 6)}
        if kind == "directional":
            return {"type": kind, "direction": [self.between(-1, 1), -1, self.between(-1, 1)],
                    "irradiance": self.colour(0.2, 2)}
        outer = self.between(10, 60)
        return {"type": kind, "position": position, "intensity": self.colour(3, 20),
                "look_at": [self.between(-1, 1), -0.5, self.between(-1, 1)],
                "outer_angle": outer, "inner_angle": round(outer * self.r.uniform(0.1, 0.9), 3)}

    def environment(self):
        if self.r.random() < 0.5:
            self.textures["sky"] = {"type": "constant", "color": self.colour(0.1, 1)}
            return {"texture_name": "sky", "scale": self.between(0.3, 1.5)}
        self.textures["sky"] = {"type": "image", "path": self.path("scenes/sky.exr")}
        turn = self.transform(1)
        turn[3:12:4] = [0, 0, 0]
        return {"texture_name": "sky", "scale": self.between(0.3, 1.2), "transform": turn}

    # --- Camera and film ----------------------------------------------------------------------

    def camera(self):
        angle = self.r.uniform(0, 2 * math.pi)
        made = {"position": [round(4.5 * math.cos(angle), 4), self.between(0, 2.5),
                             round(4.5 * math.sin(angle), 4)],
                "look_at": [self.between(-0.3, 0.3), self.between(-0.3, 0.3), self.between(-0.3, 0.3)],
                "ref_up": [self.between(-0.4, 0.4), 1, self.between(-0.4, 0.4)]}
        kind = self.r.random()
        if kind < 0.15:
            return {**made, "type": "orthographic", "ortho_height": self.between(2.5, 5)}
        made["fov"] = self.between(25, 75)
        if kind < 0.3:
            made.update({"aperture_radius": self.between(0.02, 0.3), "focal_length": self.between(2.5, 6)})
        return made

    def scene(self):
        ground = {"type": "mesh", "path": self.path("scenes/floor.obj"), "material_name": "ground"}
        self.materials["ground"] = {**self.diffuse(True), "twosided": True}
        objects = [ground] + [self.thing() for _ in range(self.r.randint(2, 6))]
        lit_by = self.r.choice(["lamps", "sky", "both"] if self.sharp else
                               ["lamps", "sky", "punctual", "both", "all"])
        made = {"integrator": {"type": "path" if self.r.random() < 0.9 else "direct"},
                "film": {"resolution": [64, 64]}, "camera": self.camera()}
        if made["integrator"]["type"] == "path":
            made["integrator"]["max_depth"] = self.r.choice([2, 3, 5, 8, 12])
        if lit_by in ("lamps", "both", "all"):
            objects += self.emitters()
        if lit_by in ("sky", "both", "all"):
            made["environment_map"] = self.environment()
        if lit_by in ("punctual", "all"):
            made["lights"] = [self.punctual() for _ in range(self.r.randint(1, 4))]
        return {**made, "textures": self.textures, "materials": self.materials, "objects": objects}


def write(folder, first, count):
    """Paths of `count` scene files in `folder`, drawn from the seeds from `first` on."""
    folder = pathlib.Path(folder).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number in range(first, first + count):
        path = folder / f"random{number}.json"
        path.write_text(json.dumps(Drawn(number, folder).scene(), indent=1) + "\n", encoding="utf-8")
        paths.append(path)
    return paths
