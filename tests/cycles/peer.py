"""Blender's Cycles renders a scene file of Tilery's: run by `run`, inside Blender.

Matched are meshes of diffuse surfaces and smooth glass, with textures, area lights on meshes of one
rectangle, a sky that is a picture, and the perspective camera. Whatever else a scene has is an error,
since a time to an error in another picture would say nothing: metals by their index, spheres.
"""
import argparse
import json
import math
import os
import sys
import tempfile
import time

import bpy
import mathutils
import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, "..", "mitsuba"))
import obj_mesh  # noqa: E402  (no more than numpy)


class Unmatched(Exception):
    """The scene has what this file does not know how to say to Cycles."""


def known(table, keys, where):
    rest = set(table) - set(keys)
    if rest:
        raise Unmatched(f"{where}: {', '.join(sorted(rest))}")


def rgba(color):
    """Of a number or of three."""
    return (*(color if isinstance(color, list) else [color] * 3), 1)


class Scene:
    """One scene file as Blender's data."""

    def __init__(self, path, size, threads):
        with open(path, encoding="utf-8") as f:
            self.text = json.load(f)
        self.folder = os.path.dirname(path)
        known(self.text, ("integrator", "film", "camera", "textures", "materials", "objects",
                          "environment_map"), "$")
        self.size = size or self.text["film"]["resolution"]
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.settings(threads)
        self.camera()
        self.made = {}
        for number, thing in enumerate(self.text["objects"]):
            self.thing(thing, f"$.objects[{number}]")

    def settings(self, threads):
        scene = bpy.context.scene
        scene.render.engine = "CYCLES"
        scene.render.resolution_x, scene.render.resolution_y = self.size
        scene.render.resolution_percentage = 100
        scene.render.threads_mode = "FIXED"
        scene.render.threads = threads
        scene.render.use_persistent_data = True
        scene.render.image_settings.file_format = "OPEN_EXR"
        scene.render.image_settings.color_depth = "32"
        scene.world = bpy.data.worlds.new("around")
        scene.world.use_nodes = True
        self.sky(scene.world.node_tree)
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.use_adaptive_sampling = False
        cycles.use_denoising = False
        cycles.light_sampling_threshold = 0
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
        cycles.blur_glossy = 0
        cycles.caustics_reflective = cycles.caustics_refractive = True
        cycles.pixel_filter_type = "BOX"
        cycles.filter_width = 1
        # Edges here, there the surfaces that are left again; the last one is still lit.
        bounces = self.text["integrator"].get("max_depth", 12) - 2
        cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
        cycles.transmission_bounces = cycles.transparent_max_bounces = bounces

    def camera(self):
        c = self.text["camera"]
        known(c, ("position", "look_at", "ref_up", "fov"), "$.camera")
        position, target = (mathutils.Vector(c[k]) for k in ("position", "look_at"))
        backward = (position - target).normalized()
        right = mathutils.Vector(c.get("ref_up", (0, 1, 0))).cross(backward).normalized()
        up = backward.cross(right)
        data = bpy.data.cameras.new("camera")
        data.sensor_fit = "VERTICAL"
        data.angle = math.radians(c.get("fov", 45))
        data.clip_start, data.clip_end = 1e-3, 1e4
        camera = bpy.data.objects.new("camera", data)
        camera.matrix_world = mathutils.Matrix(
            [[right[i], up[i], backward[i], position[i]] for i in range(3)] + [[0, 0, 0, 1]])
        bpy.context.collection.objects.link(camera)
        bpy.context.scene.camera = camera

    # --- Textures ---------------------------------------------------------------------------

    def picture(self, texture, where):
        known(texture, ("type", "path", "tex_coordinate_generator"), where)
        if not texture["path"].endswith(".exr"):
            raise Unmatched(f"{where}: a picture that is not linear")
        image = bpy.data.images.load(os.path.abspath(os.path.join(self.folder, texture["path"])))
        image.colorspace_settings.name = "Non-Color"
        return image

    def sky(self, tree):
        """Light from all around, or none."""
        nodes, links = tree.nodes, tree.links
        background = nodes["Background"]
        sky = self.text.get("environment_map")
        background.inputs["Strength"].default_value = sky.get("scale", 1) if sky else 0
        if not sky:
            return
        known(sky, ("texture_name", "scale", "transform"), "$.environment_map")
        name = sky["texture_name"]
        picture = nodes.new("ShaderNodeTexEnvironment")
        picture.image = self.picture(self.text["textures"][name], f"$.textures.{name}")
        # Blender's angles are about its z, from its x: what it is given is our (z, x, y).
        to_world = np.array(sky.get("transform", np.eye(4).ravel()), dtype=float).reshape(4, 4)
        around = nodes.new("ShaderNodeTexCoord").outputs["Generated"]
        turned = nodes.new("ShaderNodeCombineXYZ")
        for i, axis in enumerate((2, 0, 1)):
            dot = nodes.new("ShaderNodeVectorMath")
            dot.operation = "DOT_PRODUCT"
            links.new(around, dot.inputs[0])
            dot.inputs[1].default_value = to_world[:3, axis]
            links.new(dot.outputs["Value"], turned.inputs[i])
        links.new(turned.outputs[0], picture.inputs["Vector"])
        links.new(picture.outputs["Color"], background.inputs["Color"])

    def texture(self, tree, name, socket):
        """The texture's colour goes into the socket."""
        texture, where = self.text["textures"][name], f"$.textures.{name}"
        if texture["type"] == "constant":
            socket.default_value = rgba(texture["color"])
            return
        place = texture.get("tex_coordinate_generator", {})
        known(place, ("scale", "delta"), f"{where}.tex_coordinate_generator")
        nodes, links = tree.nodes, tree.links
        mapping = nodes.new("ShaderNodeMapping")
        mapping.inputs["Scale"].default_value = (*place.get("scale", (1, 1)), 1)
        # Cells lie about the plane 0 of Blender's checkerboard, which is of three dimensions.
        mapping.inputs["Location"].default_value = (*place.get("delta", (0, 0)), 0.1)
        links.new(nodes.new("ShaderNodeTexCoord").outputs["UV"], mapping.inputs["Vector"])
        if texture["type"] == "image":
            made = nodes.new("ShaderNodeTexImage")
            made.image = self.picture(texture, where)
        elif texture["type"] == "checkerboard":
            known(texture, ("type", "color0", "color1", "tex_coordinate_generator"), where)
            made = nodes.new("ShaderNodeTexChecker")
            made.inputs["Scale"].default_value = 2
            made.inputs["Color2"].default_value = rgba(texture["color0"])
            made.inputs["Color1"].default_value = rgba(texture["color1"])
        else:
            raise Unmatched(f"{where}: a texture of type {texture['type']}")
        links.new(mapping.outputs["Vector"], made.inputs["Vector"])
        links.new(made.outputs["Color"], socket)

    # --- Materials --------------------------------------------------------------------------

    @staticmethod
    def surface(name, kind, output):
        """A material of one node, and the node."""
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        nodes = material.node_tree.nodes
        nodes.clear()
        node, out = nodes.new(kind), nodes.new("ShaderNodeOutputMaterial")
        material.node_tree.links.new(node.outputs[output], out.inputs["Surface"])
        return material, node

    def material(self, name, where):
        if name in self.made:
            return self.made[name]
        m = self.text["materials"][name]
        if m["type"] == "diffuse":
            known(m, ("type", "color", "texture_name"), where)
            material, surface = self.surface(name, "ShaderNodeBsdfDiffuse", "BSDF")
            color = surface.inputs["Color"]
            if "texture_name" in m:
                self.texture(material.node_tree, m["texture_name"], color)
            else:
                color.default_value = rgba(m["color"])
        elif m["type"] == "glass":
            known(m, ("type", "eta"), where)
            material, surface = self.surface(name, "ShaderNodeBsdfGlass", "BSDF")
            surface.distribution = "SHARP"
            surface.inputs["IOR"].default_value = m["eta"]
            surface.inputs["Color"].default_value = (1, 1, 1, 1)
        else:
            raise Unmatched(f"{where}: a material of type {m['type']}")
        self.made[name] = material
        return material

    # --- Objects ----------------------------------------------------------------------------

    def thing(self, thing, where):
        known(thing, ("type", "path", "material_name", "light", "translate"), where)
        if thing["type"] != "mesh":
            raise Unmatched(f"{where}: an object of type {thing['type']}")
        moved = np.eye(4)
        moved[:3, 3] = thing.get("translate", (0, 0, 0))
        points, normals, uvs = obj_mesh.read(os.path.join(self.folder, thing["path"]), moved)
        if "light" in thing:
            self.light(points, thing["light"], where)
        else:
            self.mesh(points, self.material(thing["material_name"], where), normals, uvs)

    def mesh(self, points, material, normals=None, uvs=None):
        data = bpy.data.meshes.new("mesh")
        data.from_pydata(points.tolist(), [],
                         [(i, i + 1, i + 2) for i in range(0, len(points), 3)])
        if uvs is not None:
            data.uv_layers.new().data.foreach_set("uv", uvs.ravel())
        if normals is not None:
            data.polygons.foreach_set("use_smooth", [True] * len(data.polygons))
            data.use_auto_smooth = True
            data.normals_split_custom_set(normals.tolist())
        data.materials.append(material)
        made = bpy.data.objects.new("mesh", data)
        bpy.context.collection.objects.link(made)
        return made

    def light(self, points, light, where):
        """A rectangle: Cycles samples its lamps by solid angle, which it does not with meshes."""
        known(light, ("type", "radiance"), f"{where}.light")
        corners = points[[0, 1, 2, 5]]
        u, v = corners[1] - corners[0], corners[3] - corners[0]
        if len(points) != 6 or np.abs(corners[0] + u + v - corners[2]).max() > 1e-6 or \
                abs(np.dot(u, v)) > 1e-6:
            raise Unmatched(f"{where}: a light that is no rectangle")
        width, height = np.linalg.norm(u), np.linalg.norm(v)
        data = bpy.data.lights.new("light", "AREA")
        data.shape = "RECTANGLE"
        data.size, data.size_y = width, height
        radiance = np.array(light["radiance"], dtype=float)
        # By measurement: a lamp of P watts has the radiance P / (4 area), not P / (pi area).
        data.energy = 4 * width * height * radiance.max()
        data.color = (radiance / radiance.max()).tolist()
        data.cycles.use_multiple_importance_sampling = True
        lamp = bpy.data.objects.new("light", data)
        # It shines along its -z.
        x, y = u / width, v / height
        z, middle = np.cross(x, y), corners.mean(axis=0)
        if np.dot(z, np.cross(points[1] - points[0], points[2] - points[0])) > 0:
            x, z = -x, -z
        lamp.matrix_world = mathutils.Matrix(
            [[x[i], y[i], z[i], middle[i]] for i in range(3)] + [[0, 0, 0, 1]])
        bpy.context.collection.objects.link(lamp)
        self.shown(points, radiance)
        self.back(points + 1e-4 * z)

    def shown(self, points, radiance):
        """What the camera alone sees of a lamp, which Cycles hides from it."""
        material, surface = self.surface("glow", "ShaderNodeEmission", "Emission")
        surface.inputs["Color"].default_value = (*(radiance / radiance.max()), 1)
        surface.inputs["Strength"].default_value = radiance.max()
        material.cycles.sample_as_light = False
        quad = self.mesh(points, material)
        quad.visible_diffuse = quad.visible_glossy = quad.visible_transmission = False
        quad.visible_volume_scatter = quad.visible_shadow = False

    def back(self, points):
        """A lamp of Cycles lets light through; ours is black where it does not shine."""
        material, surface = self.surface("black", "ShaderNodeBsdfDiffuse", "BSDF")
        surface.inputs["Color"].default_value = (0, 0, 0, 1)
        self.mesh(points, material).visible_camera = False

    def render(self, spp, seed):
        """The picture, rows from above, and the seconds it took: on the wall, of processor."""
        scene = bpy.context.scene
        scene.cycles.samples = spp
        scene.cycles.seed = seed % 2**31
        begin, begin_cpu = time.monotonic(), time.process_time()
        bpy.ops.render.render()
        took = time.monotonic() - begin, time.process_time() - begin_cpu
        return self.pixels(), took

    def pixels(self):
        """Blender shows its render result to nobody but through a file."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "picture.exr")
            bpy.data.images["Render Result"].save_render(path)
            image = bpy.data.images.load(path)
            image.colorspace_settings.name = "Non-Color"
            values = np.empty(len(image.pixels), dtype=np.float32)
            image.pixels.foreach_get(values)
            bpy.data.images.remove(image)
        width, height = self.size
        return np.ascontiguousarray(values.reshape(height, width, 4)[::-1, :, :3])


def serve(scene, reply):
    scene.render(1, 0)  # loads what is loaded once
    reply.write(b"ready\n")
    reply.flush()
    for line in sys.stdin:
        spp, seed = (int(word) for word in line.split())
        picture, took = scene.render(spp, seed)
        reply.write(f"{took[0]} {took[1]}\n".encode())
        reply.write(picture.tobytes())
        reply.flush()


def main():
    parser = argparse.ArgumentParser(prog="run")
    parser.add_argument("scene")
    parser.add_argument("--size", type=lambda text: [int(n) for n in text.split("x")])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--picture", help="write one picture there")
    parser.add_argument("--spp", type=int, default=16)
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1:])
    try:
        scene = Scene(options.scene, options.size, options.threads)
    except (Unmatched, OSError, ValueError, KeyError) as what:
        # Blender ends at once: what it has not written by then is lost.
        print(f"run: {options.scene}: cannot be matched: {what}", file=sys.stderr, flush=True)
        sys.exit(2)
    if options.picture:
        scene.render(options.spp, 1)
        bpy.data.images["Render Result"].save_render(options.picture)
    else:
        serve(scene, os.fdopen(3, "wb"))


main()
