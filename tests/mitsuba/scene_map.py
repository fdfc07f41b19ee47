"""Scene files of Tilery as scenes of Mitsuba 3: every convention that differs is translated here.

What differs, and how it is brought over:
  - Winding, transforms and polygons of meshes are resolved by obj_mesh; Mitsuba gets triangles.
  - Row 0 of a picture is at t = 1 here and at v = 0 there: pictures are turned over.
  - The rows of an environment map are spread from pole to pole there, with the first and the last
    on the poles; here a row is a band. The map is resampled, so that both look up the same light.
  - An object without a material is black; there it would be grey.
  - `refraction` has no counterpart: a small BSDF below.
  - A spot's light falls off with the square of the cosine's share here, with the angle there: the
    picture of the fall-off is projected.
What cannot be brought over raises NotMapped with the reason.
"""
import json
import math
import pathlib
import tempfile

import drjit as dr
import mitsuba as mi
import numpy as np

import obj_mesh


class NotMapped(Exception):
    """Mitsuba has nothing that means the same."""


def _rgb(value):
    values = [value] * 3 if isinstance(value, (int, float)) else list(value)
    return {"type": "rgb", "value": values}


def _three(value):
    return np.array([value] * 3 if isinstance(value, (int, float)) else value, dtype=float)


class _Refraction(mi.BSDF):
    """Perfect refraction with weight 1; total reflection goes to the mirror direction."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.eta = props["eta"]
        both = mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
        self.m_components = [mi.BSDFFlags.DeltaTransmission | both | mi.BSDFFlags.NonSymmetric]
        self.m_flags = self.m_components[0]

    def sample(self, ctx, si, sample1, sample2, active):
        r, cos_t, eta_it, eta_ti = mi.fresnel(mi.Frame3f.cos_theta(si.wi), self.eta)
        total = r >= 1
        bs = mi.BSDFSample3f()
        bs.wo = dr.select(total, mi.reflect(si.wi), mi.refract(si.wi, cos_t, eta_ti))
        bs.pdf = 1
        bs.eta = dr.select(total, 1, eta_it)
        bs.sampled_type = mi.UInt32(+mi.BSDFFlags.DeltaTransmission)
        bs.sampled_component = mi.UInt32(0)
        return bs, mi.Color3f(1) & active

    def eval(self, ctx, si, wo, active):
        return mi.Color3f(0)

    def pdf(self, ctx, si, wo, active):
        return mi.Float(0)

    def eval_pdf(self, ctx, si, wo, active):
        return mi.Color3f(0), mi.Float(0)

    def to_string(self):
        return f"Refraction[eta={self.eta}]"


class SceneMap:
    """One scene file. `dict()` is the scene for mi.load_dict; `spp`, `max_depth`, `size` what it
    asks for."""

    def __init__(self, path, size=None):
        self.path = pathlib.Path(path)
        self.folder = self.path.parent
        self.json = json.loads(self.path.read_text(encoding="utf-8"))
        self.size = tuple(size or self.json["film"].get("resolution", [600, 600]))
        self.kind = self.json["integrator"].get("type", "path")
        self.spp = self.json["integrator"].get("spp", 32)
        self._scratch = tempfile.TemporaryDirectory()
        mi.register_bsdf("tilery_refraction", _Refraction)

    # --- Textures ---------------------------------------------------------------------------

    def _image(self, texture):
        """Linear RGB rows of a picture, times the texture's colour."""
        raw = texture.get("encoding") == "linear"
        bitmap = mi.Bitmap(str(self.folder / texture["path"]))
        if raw:
            bitmap.set_srgb_gamma(False)
        plain = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
        return np.array(plain).copy() * _three(texture.get("color", 1)).astype(np.float32)

    @staticmethod
    def _uv_matrix(texture):
        generator = texture.get("tex_coordinate_generator", {})
        if "matrix" in generator:
            m = generator["matrix"]
        else:
            s, d = generator.get("scale", [1, 1]), generator.get("delta", [0, 0])
            m = [s[0], 0, d[0], 0, s[1], d[1]]
        return mi.ScalarTransform3f([m[0:3], m[3:6], [0, 0, 1]])

    def _texture(self, name, factor=1.0):
        texture = self.json["textures"][name]
        kind = texture.get("type", "constant")
        factor = _three(factor)
        if kind == "constant":
            return _rgb((_three(texture["color"]) * factor).tolist())
        if kind == "checkerboard":
            return {"type": "checkerboard", "to_uv": self._uv_matrix(texture),
                    "color0": _rgb((_three(texture.get("color0", 0.4)) * factor).tolist()),
                    "color1": _rgb((_three(texture.get("color1", 0.2)) * factor).tolist())}
        wrap = texture.get("wrap", "repeat")
        if not isinstance(wrap, str):
            if wrap[0] != wrap[1]:
                raise NotMapped("a texture with two wrap modes")
            wrap = wrap[0]
        pixels = np.ascontiguousarray(self._image(texture)[::-1] * factor.astype(np.float32))
        return {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True,
                "to_uv": self._uv_matrix(texture), "format": "variant", "wrap_mode": wrap,
                "filter_type": "nearest" if texture.get("filter") == "nearest" else "bilinear"}

    def _colour(self, material, old_key):
        if "texture_name" in material:
            return self._texture(material["texture_name"], material.get("color", 1))
        return _rgb(material.get(old_key, 1))

    # --- Materials ----------------------------------------------------------------------------

    @staticmethod
    def _facets(material):
        return {"distribution": material.get("distribution", "beckmann"),
                "alpha_u": material.get("alpha_x", 0.1), "alpha_v": material.get("alpha_y", 0.1)}

    def _paper(self, m):
        """Diffuse on both sides, and as opaque as its picture is."""
        made = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": self._colour(m, "color")}}
        mode = m.get("alpha_mode", "opaque")
        if mode == "opaque":
            return made
        texture = self.json["textures"][m["texture_name"]]
        if texture.get("filter") != "nearest":
            raise NotMapped("opacity that is not looked up at texels")
        bitmap = mi.Bitmap(str(self.folder / texture["path"]))
        opacity = np.array(bitmap, dtype=np.float32)[::-1, :, 3] * np.float32(m.get("alpha", 1))
        if mode == "mask":
            opacity = (opacity >= m.get("alpha_cutoff", 0.5)).astype(np.float32)
        bitmap = mi.Bitmap(np.ascontiguousarray(np.repeat(opacity[:, :, None], 3, axis=2)))
        return {"type": "mask", "bsdf": made,
                "opacity": {"type": "bitmap", "bitmap": bitmap, "raw": True, "format": "variant",
                            "to_uv": self._uv_matrix(texture), "filter_type": "nearest"}}

    def _principled(self, m):
        layers = ("transmission", "clearcoat", "sheen_color", "metallic_roughness_texture",
                  "normal_texture", "bump_texture", "vertex_colors", "backface_culling")
        if m.get("metallic", 0) == 0 and m.get("specular") == 0 and not any(k in m for k in layers):
            return self._paper(m)
        if m.get("metallic", 0) != 1 or any(k in m for k in (
                "transmission", "clearcoat", "sheen_color", "metallic_roughness_texture",
                "normal_texture", "alpha", "alpha_mode", "emission")):
            raise NotMapped("a principled material that is not bare metal")
        metal = {"type": "principled", "base_color": self._colour(m, "color"), "metallic": 1.0,
                 "roughness": m.get("roughness", 1), "specular": 0.5}
        return {"type": "twosided", "bsdf": metal}

    def _material(self, name):
        if name is None:
            return {"type": "diffuse", "reflectance": _rgb(0)}
        m = self.json["materials"][name]
        kind = m.get("type", "diffuse")
        if kind == "diffuse":
            made = {"type": "diffuse", "reflectance": self._colour(m, "color")}
            return {"type": "twosided", "bsdf": made} if m.get("twosided") else made
        if kind == "black":
            return {"type": "diffuse", "reflectance": _rgb(0)}
        if kind == "mirror":
            metal = {"type": "conductor", "material": "none",
                     "specular_reflectance": _rgb(m.get("R", 1))}
            return {"type": "twosided", "bsdf": metal}
        if kind == "refraction":
            return {"type": "tilery_refraction", "eta": float(m.get("eta", 1.5))}
        if kind in ("glass", "roughdielectric"):
            made = {"type": "dielectric", "int_ior": float(m.get("eta", 1.5)), "ext_ior": 1.0,
                    "specular_reflectance": _rgb(m.get("R", 1)),
                    "specular_transmittance": _rgb(m.get("T", 1))}
            return made if kind == "glass" else {**made, **self._facets(m),
                                                 "type": "roughdielectric"}
        if kind == "roughconductor":
            outside = _three(m.get("etaI", 1))
            return {"type": "roughconductor", **self._facets(m),
                    "eta": _rgb((_three(m.get("etaT", 1)) / outside).tolist()),
                    "k": _rgb((_three(m.get("k", 1)) / outside).tolist()),
                    "specular_reflectance": self._colour(m, "R")}
        if kind == "principled":
            return self._principled(m)
        raise NotMapped(f"a material of type {kind}")

    # --- Objects and lights -------------------------------------------------------------------

    def _mesh(self, o, name):
        matrix = np.array(o.get("transform", np.eye(4).ravel()), dtype=float).reshape(4, 4)
        matrix[:3, 3] += o.get("translate", [0, 0, 0])
        points, normals, uvs = obj_mesh.read(self.folder / o["path"], matrix)
        mesh = mi.Mesh(name, len(points), len(points) // 3, has_vertex_normals=normals is not None,
                       has_vertex_texcoords=uvs is not None)
        params = mi.traverse(mesh)
        params["vertex_positions"] = points.ravel()
        params["faces"] = np.arange(len(points), dtype=np.uint32)
        if normals is not None:
            params["vertex_normals"] = normals.ravel()
        if uvs is not None:
            params["vertex_texcoords"] = uvs.ravel()
        params.update()
        file = str(pathlib.Path(self._scratch.name) / f"{name}.ply")
        mesh.write_ply(file)
        return {"type": "ply", "filename": file, "face_normals": normals is None}

    def _object(self, o, name):
        if o["type"] == "sphere":
            made = {"type": "sphere", "center": o["center"], "radius": o.get("radius", 1.0)}
        else:
            made = self._mesh(o, name)
        made["bsdf"] = self._material(o.get("material_name"))
        if "light" in o:
            made["emitter"] = {"type": "area", "radiance": _rgb(o["light"].get("radiance", 1))}
        material = self.json.get("materials", {}).get(o.get("material_name"), {})
        if "emission" in material:
            if "light" in o or "emission_twosided" in material:
                raise NotMapped("emission on both sides, or beside a light")
            shines = _rgb(material["emission"])
            if "emission_texture" in material:
                shines = self._texture(material["emission_texture"], material["emission"])
            made["emitter"] = {"type": "area", "radiance": shines}
        return made

    @staticmethod
    def _spot(light):
        position = np.array(light["position"], dtype=float)
        target = light.get("look_at") or (position + light["direction"]).tolist()
        axis = (np.array(target) - position) / np.linalg.norm(np.array(target) - position)
        outer = light.get("outer_angle", 30)
        inner = light.get("inner_angle", 0.75 * outer)
        co, ci = math.cos(math.radians(outer)), math.cos(math.radians(inner))
        # The projected picture spans the cone's square; its pixel centres are looked up.
        side, half = 1024, math.tan(math.radians(outer))
        x = ((np.arange(side) + 0.5) / side * 2 - 1) * half
        cosine = 1 / np.sqrt(1 + x[None, :] ** 2 + x[:, None] ** 2)
        fall = np.clip((cosine - co) / max(ci - co, 1e-9), 0, 1) ** 2
        fall = np.repeat(fall[:, :, None], 3, axis=2).astype(np.float32)
        up = [0, 0, 1] if abs(axis[1]) > 0.9 else [0, 1, 0]
        return {"type": "spot", "intensity": _rgb(light.get("intensity", 1)),
                "cutoff_angle": outer, "beam_width": outer * 0.9999,
                "texture": {"type": "bitmap", "bitmap": mi.Bitmap(fall), "raw": True,
                            "wrap_mode": "clamp", "format": "variant"},
                "to_world": mi.ScalarTransform4f().look_at(position.tolist(), list(target), up)}

    def _light(self, light):
        if light["type"] == "point":
            return {"type": "point", "position": light["position"],
                    "intensity": _rgb(light.get("intensity", 1))}
        if light["type"] == "directional":
            return {"type": "directional", "direction": light["direction"],
                    "irradiance": _rgb(light.get("irradiance", 1))}
        return self._spot(light)

    def _environment(self, env):
        texture = self.json["textures"][env["texture_name"]]
        scale = env.get("scale", 1)
        if texture.get("type", "constant") == "constant":
            return {"type": "constant",
                    "radiance": _rgb((_three(texture["color"]) * scale).tolist())}
        if texture["type"] != "image" or "tex_coordinate_generator" in texture:
            raise NotMapped("an environment that is not a plain picture")
        rows = self._image(texture)
        height, width = rows.shape[:2]
        # Bilinear between the middles of bands, at the rows where Mitsuba looks up.
        fine = 16 * height + 1
        at = np.clip(np.arange(fine) / (fine - 1) * height - 0.5, 0, height - 1)
        low = np.minimum(at.astype(int), height - 2) if height > 1 else np.zeros(fine, int)
        share = (at - low)[:, None, None].astype(np.float32)
        high = np.minimum(low + 1, height - 1)
        rows = rows[low] * (1 - share) + rows[high] * share
        m = np.array(env.get("transform", np.eye(4).ravel()), dtype=float).reshape(4, 4)[:3, :3]
        x = m[:, 0] / np.linalg.norm(m[:, 0])
        y = m[:, 1] - x * np.dot(x, m[:, 1])
        y /= np.linalg.norm(y)
        z = np.cross(x, y) * (-1 if np.linalg.det(m) < 0 else 1)
        to_world = np.eye(4)
        to_world[:3, :3] = np.stack([x, y, z], axis=1)
        return {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(rows)),
                "scale": float(scale), "to_world": mi.ScalarTransform4f(to_world.tolist())}

    # --- Camera and film ------------------------------------------------------------------------

    def _filter(self):
        f = self.json["film"].get("filter", {})
        kind, radius = f.get("type", "box"), f.get("radius", 0.5)
        if kind == "box" and radius == 0.5:
            return {"type": "box"}
        if kind == "tent":
            return {"type": "tent", "radius": float(radius)}
        if kind == "gaussian":
            sigma = math.sqrt(0.5 / f.get("alpha", 2))
            if abs(radius - 4 * sigma) < 1e-6:
                return {"type": "gaussian", "stddev": sigma}
            raise NotMapped("a Gaussian that does not end at four standard deviations")
        if kind == "mitchell" and radius == 2:
            return {"type": "mitchell", "B": f.get("B", 1 / 3), "C": f.get("C", 1 / 3)}
        raise NotMapped(f"a {kind} filter of radius {radius}")

    def _film(self):
        return {"type": "hdrfilm", "width": self.size[0], "height": self.size[1],
                "pixel_format": "rgb", "component_format": "float32", "sample_border": True,
                "rfilter": self._filter()}

    def _camera(self):
        c = self.json["camera"]
        position = c.get("position", [0, 0, 1])
        look = mi.ScalarTransform4f().look_at(position, c.get("look_at", [0, 0, 0]),
                                              c.get("ref_up", [0, 1, 0]))
        kind = c.get("type") or ("thin-lens" if c.get("aperture_radius") else "pinhole")
        clip = {"near_clip": 1e-4, "far_clip": 1e6}
        if kind == "orthographic":
            half = c.get("ortho_height", 2) / 2 * self.size[0] / self.size[1]
            return {"type": "orthographic",
                    "to_world": look @ mi.ScalarTransform4f().scale([half, half, 1]), **clip}
        made = {"type": "perspective", "to_world": look, "fov": c.get("fov", 45),
                "fov_axis": "y", **clip}
        if kind == "thin-lens":
            made.update({"type": "thinlens", "aperture_radius": c["aperture_radius"],
                         "focus_distance": c.get("focal_length", 1.0)})
        elif kind != "pinhole":
            raise NotMapped(f"a {kind} camera")
        return made

    def max_depth(self):
        integrator = self.json["integrator"]
        if self.kind in ("direct", "intersection_test"):
            return 2
        if self.kind in ("path", "bdpt", "photon"):
            return integrator.get("max_depth", 12)
        raise NotMapped(f"the integrator {self.kind}")

    def _seed_light(self):
        """Of intersection_test, where no surface is followed: a point light without 1 / 4 pi."""
        for m in self.json.get("materials", {}).values():
            if m.get("type", "diffuse") != "diffuse" or m.get("twosided"):
                raise NotMapped("intersection_test over specular or two-sided surfaces")
        if any("light" in o for o in self.json["objects"]):
            raise NotMapped("intersection_test with emitters")
        i = self.json["integrator"]
        return {"type": "point", "position": i.get("point_light_position", [0, 5, 0]),
                "intensity": _rgb(i.get("point_light_flux", 1))}

    def dict(self, sampler="independent", rr_depth=100000):
        """The scene for mi.load_dict. `rr_depth`: edges before Mitsuba's roulette."""
        made = {"type": "scene",
                "integrator": {"type": "path", "max_depth": self.max_depth(),
                               "rr_depth": rr_depth},
                "sensor": {**self._camera(), "film": self._film(),
                           "sampler": {"type": sampler}}}
        for n, o in enumerate(self.json.get("objects", [])):
            made[f"object{n}"] = self._object(o, f"object{n}")
        if self.kind == "intersection_test":
            made["seed_light"] = self._seed_light()
            return made
        lights = self.json.get("lights", [])
        for n, light in enumerate(lights if isinstance(lights, list) else []):
            made[f"light{n}"] = self._light(light)
        if "environment_map" in self.json:
            made["environment"] = self._environment(self.json["environment_map"])
        return made
