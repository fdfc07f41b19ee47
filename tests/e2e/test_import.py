"""Models made here, imported and rendered: what comes out, and what is said."""
import base64
import json
import os
import pathlib
import struct
import subprocess
import time
import urllib.parse
import zlib

import exr_pixels
import pytest

TILERY = pathlib.Path(os.environ["TILERY_BIN"]) / "tilery"


def tilery(*arguments, cwd):
    done = subprocess.run([TILERY, *map(str, arguments)], cwd=cwd, capture_output=True,
                          timeout=120, check=False)
    return done.returncode, (done.stdout + done.stderr).decode()


def imported(folder, model, status=0):
    """The scene that a model becomes, and what was said."""
    code, said = tilery("import", model, "-o", "scene.json", cwd=folder)
    assert code == status, said
    return (json.loads((folder / "scene.json").read_text()) if status == 0 else None), said


def picture_hash(folder, scene):
    code, said = tilery("render", scene, "-o", "out.exr", "--size", "32x32", "--spp", "4",
                        "--report", "r.json", "--quiet", "--workers", "1", cwd=folder)
    assert code == 0, said
    return json.loads((folder / "r.json").read_text())["image_sha256"]


def triangle_gltf(**extra):
    """One triangle with normals, as a dict."""
    data = struct.pack("<18f", 0, 0, 0, 1, 0, 0, 0, 1, 0, *([0, 0, 1] * 3))
    model = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}}]}],
        "buffers": [{"byteLength": len(data), "uri": "data:application/octet-stream;base64," +
                     base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteLength": 36},
                        {"buffer": 0, "byteOffset": 36, "byteLength": 36}],
        "accessors": [{"bufferView": i, "componentType": 5126, "count": 3, "type": "VEC3",
                       "min": [0, 0, 0], "max": [1, 1, 1]} for i in range(2)],
    }
    model.update(extra)
    return model


def write(folder, name, model):
    (folder / name).write_text(json.dumps(model))
    return name


def test_obj_with_materials(tmp_path):
    (tmp_path / "m.mtl").write_text(
        "newmtl lamp\nKd 0 0 0\nKe 5 4 3\nnewmtl glass\nillum 7\nNi 1.33\nTf 0.9 1 1\n"
        "newmtl mirror\nKd 0 0 0\nKs 0.9 0.9 0.9\nNs 1000\nillum 5\nnewmtl matt\nKd 0.2 0.4 0.6\n"
        "newmtl gloss\nKd 0.5 0 0\nKs 0.5 0.5 0.5\nNs 98\n")
    lines = ["mtllib m.mtl"]
    for i, name in enumerate(("lamp", "glass", "mirror", "matt", "gloss", "missing")):
        lines += [f"v {i} 0 0", f"v {i + 1} 0 0", f"v {i} 1 0", f"usemtl {name}", "f -3 -2 -1"]
    (tmp_path / "m.obj").write_text("\n".join(lines))
    scene, said = imported(tmp_path, "m.obj")
    kinds = {name: m["type"] for name, m in scene["materials"].items()}
    assert kinds == {"lamp": "diffuse", "glass": "glass", "mirror": "mirror", "matt": "diffuse",
                     "gloss": "principled", "missing": "diffuse"}
    assert scene["materials"]["glass"]["eta"] == 1.33
    assert scene["materials"]["matt"]["color"] == [0.2, 0.4, 0.6]
    assert scene["objects"][0]["light"]["radiance"] == [5, 4, 3]
    assert "environment_map" not in scene  # the lamp lights it
    assert 'no material "missing"' in said
    assert picture_hash(tmp_path, "m.obj") == picture_hash(tmp_path, "scene.json")


def write_png(path, rows, bits=8):
    """Grey, or RGB where a pixel is a triple; of 8 or 16 bits."""
    grey = isinstance(rows[0][0], int)
    def chunk(kind, body):
        return (struct.pack(">I", len(body)) + kind + body +
                struct.pack(">I", zlib.crc32(kind + body)))
    samples = [list(r) if grey else [v for pixel in r for v in pixel] for r in rows]
    body = b"".join(b"\0" + struct.pack(f">{len(r)}{'B' if bits == 8 else 'H'}", *r)
                    for r in samples)
    head = struct.pack(">IIBBBBB", len(rows[0]), len(rows), bits, 0 if grey else 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) +
                     chunk(b"IDAT", zlib.compress(body)) + chunk(b"IEND", b""))


def test_smoothing_without_normals_is_said_once(tmp_path):
    (tmp_path / "m.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1 2 3\ns 1\nf 1 2 3\nf 1//1 2//1 3//1\ns off\nf 1 2 3\n"
        "s 7\nf 3 2 1\ns 0\nf 1 2 3\n")
    _, said = imported(tmp_path, "m.obj")
    assert said.count("smoothing groups without normals are left out: 2 faces are flat") == 1


def test_bump_maps(tmp_path):
    """Heights become a bump map in a hundredth of the size, normals in disguise a normal map."""
    write_png(tmp_path / "heights.png", [[(x * y) % 256 for x in range(32)] for y in range(32)])
    write_png(tmp_path / "normals.png", [[(128, 120 + x, 250) for x in range(8)]] * 8)
    (tmp_path / "m.mtl").write_text(
        "newmtl a\nKd .5 .5 .5\nmap_Bump -bm 3 heights.png\n"
        "newmtl b\nKd .5 .5 .5\nbump normals.png\n"
        "newmtl c\nillum 7\nNi 1.4\nTf 1 1 1\nbump heights.png\n")
    (tmp_path / "m.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 5 0 0\nv 0 4 0\nvt 0 0\nvt 1 0\nvt 0 1\n" +
        "".join(f"usemtl {m}\nf 1/1 2/2 3/3\n" for m in "abc"))
    scene, said = imported(tmp_path, "m.obj")
    assert said.count("bump-unit") == 1
    a, b, c = (scene["materials"][m] for m in "abc")
    assert a["type"] == "diffuse" and abs(a["bump_scale"] - 3 * 0.01 * 5) < 1e-12
    assert scene["textures"][a["bump_texture"]]["encoding"] == "linear"
    assert b["type"] == "principled" and "normal_texture" in b and "bump_texture" not in b
    assert c["type"] == "glass" and abs(c["bump_scale"] - 0.05) < 1e-12
    assert picture_hash(tmp_path, "scene.json") == picture_hash(tmp_path, "m.obj")
    # So are normals of 16 bits, once taken for heights.
    write_png(tmp_path / "normals.png", [[(32768, 30000 + x, 64000) for x in range(8)]] * 8, bits=16)
    fine = imported(tmp_path, "m.obj")[0]["materials"]["b"]
    assert fine["type"] == "principled" and "normal_texture" in fine and "bump_texture" not in fine
    a["bump_scale"] = 0
    (tmp_path / "flat.json").write_text(json.dumps(scene))
    assert picture_hash(tmp_path, "flat.json") != picture_hash(tmp_path, "m.obj")


def test_missing_library_is_a_warning(tmp_path):
    (tmp_path / "m.obj").write_text("mtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    scene, said = imported(tmp_path, "m.obj")
    assert "[missing-mtl]" in said and "[sky-added]" in said and "[camera-added]" in said
    assert scene["environment_map"]["texture_name"] == "sky"


def test_hierarchy_instances_camera_and_light(tmp_path):
    model = triangle_gltf(
        scenes=[{"nodes": [0, 3, 4]}],
        nodes=[{"children": [1, 2], "translation": [10, 0, 0]}, {"mesh": 0, "scale": [-2, 1, 1]},
               {"mesh": 0, "translation": [0, 5, 0]}, {"camera": 0, "translation": [0, 0, 20]},
               {"extensions": {"KHR_lights_punctual": {"light": 0}}, "translation": [0, 0, 30]}],
        cameras=[{"type": "perspective", "perspective": {"yfov": 0.5, "aspectRatio": 2, "znear": 1}}],
        extensionsUsed=["KHR_lights_punctual"],
        extensions={"KHR_lights_punctual": {"lights": [
            {"type": "spot", "color": [1, 0.5, 0.25], "intensity": 2000,
             "spot": {"outerConeAngle": 0.5}}]}})
    scene, said = imported(tmp_path, write(tmp_path, "m.gltf", model))
    first, second = scene["objects"]
    assert first["path"] == second["path"]
    assert first["transform"][0] == -2 and first["transform"][3] == 10
    assert second["transform"][3] == 10 and second["transform"][7] == 5
    assert scene["film"]["resolution"] == [1200, 600]
    assert scene["camera"]["fov"] == pytest.approx(28.6478897)
    assert scene["camera"]["position"] == [0, 0, 20]
    (light,) = scene["lights"]
    assert light["type"] == "spot" and light["outer_angle"] == pytest.approx(28.6478897)
    assert light["intensity"][1] / light["intensity"][0] == pytest.approx(0.5)
    assert "[sky-added]" not in said and "[camera-added]" not in said
    assert picture_hash(tmp_path, "m.gltf") == picture_hash(tmp_path, "scene.json")


def test_materials_go_to_their_meshes_whatever_the_order(tmp_path):
    model = triangle_gltf(
        scenes=[{"nodes": [1, 0]}],
        nodes=[{"mesh": 0, "translation": [1, 0, 0]}, {"mesh": 1, "translation": [2, 0, 0]}],
        materials=[{"name": "unused"}, {"pbrMetallicRoughness": {"metallicFactor": 0.25}},
                   {"pbrMetallicRoughness": {"metallicFactor": 0.75}}])
    primitive = model["meshes"][0]["primitives"][0]
    model["meshes"] = [{"primitives": [dict(primitive, material=1)]},
                       {"primitives": [dict(primitive, material=2)]}]
    scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", model))
    metallic = {o["transform"][3]: scene["materials"][o["material_name"]]["metallic"]
                for o in scene["objects"]}
    assert metallic == {1: 0.25, 2: 0.75}


def test_extended_material(tmp_path):
    model = triangle_gltf(materials=[{
        "name": "m", "emissiveFactor": [1, 0.5, 0], "alphaMode": "MASK", "alphaCutoff": 0.25,
        "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.5], "roughnessFactor": 0.5},
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8},
                       "KHR_materials_ior": {"ior": 1.25},
                       "KHR_materials_specular": {"specularFactor": 0.5},
                       "KHR_materials_clearcoat": {"clearcoatFactor": 0.75},
                       "KHR_materials_sheen": {"sheenColorFactor": [0.1, 0.2, 0.3]},
                       "KHR_materials_transmission": {"transmissionFactor": 0.125}}}])
    model["meshes"][0]["primitives"][0]["material"] = 0
    scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", model))
    m = scene["materials"]["m"]
    assert (m["eta"], m["specular"], m["clearcoat"], m["transmission"]) == (1.25, 0.5, 0.75, 0.125)
    assert m["alpha_mode"] == "mask" and m["alpha_cutoff"] == 0.25 and m["alpha"] == 0.5
    assert m["sheen_color"] == [0.1, 0.2, 0.3]
    assert scene["objects"][0]["light"]["radiance"] == [8, 4, 0]


def test_unlit_has_no_other_layer(tmp_path):
    """Coat, sheen and transmission of the fallback showed on surfaces that only emit."""
    model = triangle_gltf(
        extensionsUsed=["KHR_materials_unlit", "KHR_materials_clearcoat", "KHR_materials_sheen",
                        "KHR_materials_transmission"],
        materials=[{
            "name": "m", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1, 1]},
            "extensions": {"KHR_materials_unlit": {},
                           "KHR_materials_clearcoat": {"clearcoatFactor": 1},
                           "KHR_materials_sheen": {"sheenColorFactor": [1, 1, 1]},
                           "KHR_materials_transmission": {"transmissionFactor": 1}}}])
    model["meshes"][0]["primitives"][0]["material"] = 0
    scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", model))
    m = scene["materials"]["m"]
    assert m["emission"] == [0.5, 0.25, 1] and m["color"] == [0, 0, 0]
    assert not any(m.get(k) for k in ("clearcoat", "transmission"))
    assert m.get("sheen_color", [0, 0, 0]) == [0, 0, 0]


@pytest.mark.parametrize("kind", ["plain", "unlit", "lamp"])
def test_what_has_two_sides_shines_on_both(tmp_path, kind):
    """doubleSided was not looked at: from behind, emission and unlit surfaces were black."""
    material = {"name": "m", "emissiveFactor": [0.5, 0.25, 1]}
    if kind == "unlit":
        material["extensions"] = {"KHR_materials_unlit": {}}
    if kind == "lamp":
        material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 9}}
    model = triangle_gltf(
        extensionsUsed=["KHR_materials_unlit", "KHR_materials_emissive_strength"],
        materials=[material], cameras=[{"type": "perspective",
                                        "perspective": {"yfov": 0.1, "znear": 1}}],
        nodes=[{"mesh": 0}, {"camera": 0, "translation": [0.2, 0.2, -5], "rotation": [0, 1, 0, 0]}],
        scenes=[{"nodes": [0, 1]}])
    model["meshes"][0]["primitives"][0]["material"] = 0
    means = []
    for both in (False, True):
        material["doubleSided"] = both
        scene, said = imported(tmp_path, write(tmp_path, "m.gltf", model))
        assert ("light" in scene["objects"][0]) == (kind != "unlit" and not both)
        assert ("sky-added" in said) == (kind != "lamp")
        assert scene["materials"]["m"].get("backface_culling", False) == (not both)
        picture_hash(tmp_path, "scene.json")
        means.append(exr_pixels.rgb(tmp_path / "out.exr").mean())
    # What has one side is not there from behind: the picture is that of the triangle elsewhere.
    scene["objects"][0]["translate"] = [0, 0, -100]
    write(tmp_path, "scene.json", scene)
    picture_hash(tmp_path, "scene.json")
    assert abs(means[0] - exr_pixels.rgb(tmp_path / "out.exr").mean()) < 1e-3
    assert abs(means[1] - means[0]) > 0.05, means


def test_unlit_shines_in_its_vertices_colors(tmp_path):
    """KHR_materials_unlit shows base colour times COLOR_0; the colours were left out."""
    model = triangle_gltf(
        extensionsUsed=["KHR_materials_unlit"],
        materials=[{"name": "m", "extensions": {"KHR_materials_unlit": {}}}, {"name": "lit"}])
    data = struct.pack("<9f", 1, 0, 0, 1, 0, 0, 1, 0, 0)
    model["buffers"].append({"byteLength": len(data), "uri": "data:application/octet-stream;base64," +
                             base64.b64encode(data).decode()})
    model["bufferViews"].append({"buffer": len(model["buffers"]) - 1, "byteLength": len(data)})
    model["accessors"].append({"bufferView": len(model["bufferViews"]) - 1, "componentType": 5126,
                               "count": 3, "type": "VEC3"})
    primitive = model["meshes"][0]["primitives"][0]
    primitive["attributes"]["COLOR_0"] = len(model["accessors"]) - 1
    primitive["material"] = 0
    scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", model))
    assert scene["materials"]["m"]["emission_vertex_colors"] is True
    red = picture_hash(tmp_path, "m.gltf")
    assert picture_hash(tmp_path, "scene.json") == red
    # As if the base colour had been red.
    del primitive["attributes"]["COLOR_0"]
    model["materials"][0]["pbrMetallicRoughness"] = {"baseColorFactor": [1, 0, 0, 1]}
    scene, _ = imported(tmp_path, write(tmp_path, "n.gltf", model))
    assert "emission_vertex_colors" not in scene["materials"]["m"]
    assert picture_hash(tmp_path, "n.gltf") == red


ROUGH_OBJ = ("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\n"
             "f 1/1 2/2 3/3\n")


@pytest.mark.parametrize("words, roughness, metallic, warned", [
    ("Pr 0.5\nmap_Pr r.png\n", 0.5, 0, False),
    ("map_Pr r.png\n", 1, 0, False),
    ("map_Pr r.png\nmap_Pm r.png\n", 1, 1, False),
    ("Pr 0.5\nPm 1\nmap_Pr r.png\n", None, 1, True),
    ("Pr 0.5\nmap_Pm r.png\n", None, 0, True),
    ("Ks 0.5 0.5 0.5\nmap_Ks r.png\n", None, 0, True)])
def test_pictures_of_roughness_in_mtl(tmp_path, words, roughness, metallic, warned):
    """They were left out, and nobody was told."""
    write_png(tmp_path / "r.png", [[0, 255], [128, 64]])
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 0.5 0.5 0.5\n" + words)
    (tmp_path / "m.obj").write_text(ROUGH_OBJ)
    scene, said = imported(tmp_path, "m.obj")
    m = scene["materials"]["a"]
    assert ("metallic_roughness_texture" in m) == (roughness is not None)
    assert m.get("metallic", 0) == metallic
    if roughness is not None:
        assert m.get("roughness", 1) == roughness
        assert scene["textures"][m["metallic_roughness_texture"]]["encoding"] == "linear"
    assert ("[left-out]" in said) == warned


def test_deep_data_stays_data(tmp_path):
    """A 16-bit normal map was written as if it held colours: the scene's bits were others."""
    write_png(tmp_path / "n.png", [[(20000, 32768, 60000)] * 2] * 2, bits=16)
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 0.8 0.8 0.8\nnorm n.png\n")
    (tmp_path / "m.obj").write_text(ROUGH_OBJ)
    scene, _ = imported(tmp_path, "m.obj")
    normal = scene["materials"]["a"]["normal_texture"]
    assert scene["textures"][normal]["encoding"] == "linear"
    assert picture_hash(tmp_path, "m.obj") == picture_hash(tmp_path, "scene.json")


DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>Y_UP</up_axis></asset>
<library_images><image id="i"><init_from>gone.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
<newparam sid="sa"><sampler2D><source>su</source></sampler2D></newparam>
<technique sid="c"><lambert>%s<diffuse><color>0.8 0.8 0.8 1</color></diffuse></lambert>%s
</technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m" name="m"><instance_effect url="#e"/></material>
</library_materials><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>
<accessor source="#pa" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<source id="t"><float_array id="ta" count="6">0 0 1 0 0 1</float_array><technique_common>
<accessor source="#ta" count="3" stride="2"><param name="S" type="float"/>
<param name="T" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1" material="mm"><input semantic="VERTEX" source="#v" offset="0"/>
<input semantic="TEXCOORD" source="#t" offset="1" set="0"/><p>0 0 1 1 2 2</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">
<instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="mm" target="#m"/></technique_common></bind_material>
</instance_geometry></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.mark.parametrize("emission, extra", [
    ("", '<extra><technique profile="FCOLLADA"><bump><texture texture="sa" texcoord="T"/></bump>'
         "</technique></extra>"),
    ('<emission><texture texture="sa" texcoord="T"/></emission>', "")])
def test_a_picture_that_is_gone_tilts_and_glows_nothing(tmp_path, emission, extra):
    """White stood in its place: normals leant by 55 degrees, and what should glow in places glowed
    all over."""
    (tmp_path / "m.dae").write_text(DAE % (emission, extra))
    (tmp_path / "plain.dae").write_text(DAE % ("", ""))
    _, said = imported(tmp_path, "m.dae")
    assert "[missing-image]" in said
    assert picture_hash(tmp_path, "m.dae") == picture_hash(tmp_path, "plain.dae")


def mesh_vertices(path):
    """(properties, rows of numbers) of the vertices of a written mesh."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    words = [line.split() for line in head.decode().splitlines()]
    count = next(int(w[2]) for w in words if w[:2] == ["element", "vertex"])
    names = [w[2] for w in words if w[0] == "property" and len(w) == 3]
    form = "<" + "".join("d" if w[1] == "double" else "f"
                         for w in words if w[0] == "property" and len(w) == 3)
    size = struct.calcsize(form)
    return names, [struct.unpack(form, body[i * size:(i + 1) * size]) for i in range(count)]


@pytest.mark.parametrize("binary", [False, True])
def test_vertices_in_integers(tmp_path, binary):
    places = struct.pack("<12h", 0, 0, 0, 0, 100, 0, 0, 0, 0, -100, 0, 0)
    uvs = bytes([0, 0, 0, 0, 255, 0, 0, 0, 0, 51, 0, 0])
    model = triangle_gltf(
        extensionsRequired=["KHR_mesh_quantization"], extensionsUsed=["KHR_mesh_quantization"],
        buffers=[{"byteLength": 36, "uri": "vertices%201.bin"}],
        bufferViews=[{"buffer": 0, "byteLength": 24, "byteStride": 8},
                     {"buffer": 0, "byteOffset": 24, "byteLength": 12, "byteStride": 4}],
        accessors=[{"bufferView": 0, "componentType": 5122, "count": 3, "type": "VEC3",
                    "min": [0, -100, 0], "max": [100, 0, 0]},
                   {"bufferView": 1, "componentType": 5121, "normalized": True, "count": 3,
                    "type": "VEC2"}])
    model["meshes"][0]["primitives"][0]["attributes"] = {"POSITION": 0, "TEXCOORD_0": 1}
    if binary:
        del model["buffers"][0]["uri"]
        text = json.dumps(model).encode()
        text += b" " * (-len(text) % 4)
        (tmp_path / "m.glb").write_bytes(
            struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + 8 + 36, len(text), 0x4E4F534A) +
            text + struct.pack("<II", 36, 0x004E4942) + places + uvs)
        scene, _ = imported(tmp_path, "m.glb")
    else:
        (tmp_path / "vertices 1.bin").write_bytes(places + uvs)
        scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", model))
    names, rows = mesh_vertices(tmp_path / scene["objects"][0]["path"])
    assert names == ["x", "y", "z", "u", "v"]
    flat = [pytest.approx(r) for r in ((0, 0, 0, 0, 1), (100, 0, 0, 1, 1), (0, -100, 0, 0, 0.8))]
    assert rows == flat


@pytest.mark.parametrize("change, expected", [
    ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "KHR_draco_mesh_compression"),
    ({"nodes": [{"mesh": 0, "children": [0]}]}, "[bad-hierarchy]"),
    ({"scenes": [], "scene": 0}, "no scene in it"),
    ({"buffers": [{"byteLength": 72, "uri": "gone.bin"}]}, 'no file "gone.bin"'),
    ({"bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 7, "byteLength": 36}]},
     "$.bufferViews[1].buffer"),
    ({"asset": {"version": "3.0"}}, "[gltf-version]"),
    ({"nodes": [{"mesh": 4}]}, "$.nodes[0].mesh"),
    ({"materials": [{"normalTexture": {"index": 3}}]}, "$.materials[0].normalTexture.index"),
    ({"nodes": [{"mesh": 0, "translation": [0, 2e30, 0]}]}, "$.nodes[0].translation[1]"),
    ({"nodes": [{"mesh": 0, "scale": [1, 1, -1e38]}]}, "$.nodes[0].scale[2]"),
    ({"nodes": [{"mesh": 0, "matrix": [1e35, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}]},
     "$.nodes[0].matrix[0]"),
    ({"nodes": [{"mesh": 0, "matrix": [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}]},
     "$.nodes[0].matrix: a last row of 0.5 0 0 1, expected 0 0 0 1"),
    ({"nodes": [{"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2]}]},
     "$.nodes[0].matrix: a last row of 0 0 0 2, expected 0 0 0 1"),
    ({"nodes": [{"mesh": 0}, {"rotation": [0, 0, 0, 0]}]}, "$.nodes[1].rotation"),
    ({"nodes": [{"mesh": 0, "rotation": [1, 1, 1, 1]}]}, "$.nodes[0].rotation"),
    ({"nodes": [{"mesh": 0, "rotation": [0, 0, 0, 1e200]}]}, "$.nodes[0].rotation[3]"),
    ({"nodes": [{"mesh": 0, "rotation": [0, 0, 0]}]}, "$.nodes[0].rotation"),
])
def test_damage_is_named(tmp_path, change, expected):
    _, said = imported(tmp_path, write(tmp_path, "m.gltf", triangle_gltf(**change)), status=3)
    assert expected in said and "nothing written" in said
    assert not (tmp_path / "scene.json").exists()


def test_transforms_beyond_floats(tmp_path):
    """Entries that floats hold, whose product down the hierarchy they do not: exact or refused."""
    steps = [{"scale": [1e30, 1e30, 1e30], "children": [i + 1]} for i in range(4)]
    scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", triangle_gltf(
        nodes=[*steps, {"mesh": 0}])))
    assert scene["objects"][0]["transform"][0] == pytest.approx(1e120)
    steps = [{"scale": [1e30, 1e30, 1e30], "children": [i + 1]} for i in range(9)]
    _, said = imported(tmp_path, write(tmp_path, "m.gltf", triangle_gltf(
        nodes=[*steps, {"mesh": 0}])), status=3)
    assert "m.gltf" in said and "range of numbers" in said


@pytest.mark.parametrize("key, values, expected", [
    ("ROTATION", [0, 0, 0, 1, 0, 0, 0, 0], "of instance 2 of 2 a quaternion of length 0"),
    ("ROTATION", [0, 0, 0, 1, 0, 0, 2, 2], "of instance 2 of 2 a quaternion of length 2.82"),
    ("TRANSLATION", [0, 0, 0, 0, float("nan"), 0], "nan of instance 2 of 2"),
    ("SCALE", [1, 1, float("inf"), 1, 1, 1], "inf of instance 1 of 2"),
    ("SCALE", [1, 1, 1, 1, 1, -3e30], "-3e+30 of instance 2 of 2"),
])
def test_bad_instances(tmp_path, key, values, expected):
    """Numbers of instances are in buffers, so NaN and infinity can be there."""
    data = struct.pack(f"<{len(values)}f", *values)
    model = triangle_gltf(nodes=[{"mesh": 0, "extensions": {
        "EXT_mesh_gpu_instancing": {"attributes": {key: 2}}}}])
    model["buffers"].append({"byteLength": len(data), "uri": "data:application/octet-stream;base64,"
                             + base64.b64encode(data).decode()})
    model["bufferViews"].append({"buffer": 1, "byteLength": len(data)})
    model["accessors"].append({"bufferView": 2, "componentType": 5126, "count": 2,
                               "type": "VEC4" if key == "ROTATION" else "VEC3"})
    _, said = imported(tmp_path, write(tmp_path, "m.gltf", model), status=3)
    assert expected in said and f"attributes.{key}" in said


def instanced(model, accessor_values):
    """The model with one more accessor, of three floats each; its number."""
    data = struct.pack(f"<{len(accessor_values)}f", *accessor_values)
    model["buffers"].append({"byteLength": len(data), "uri": "data:application/octet-stream;base64,"
                             + base64.b64encode(data).decode()})
    model["bufferViews"].append({"buffer": len(model["buffers"]) - 1, "byteLength": len(data)})
    model["accessors"].append({"bufferView": len(model["bufferViews"]) - 1, "componentType": 5126,
                               "count": len(accessor_values) // 3, "type": "VEC3"})
    return len(model["accessors"]) - 1


@pytest.mark.parametrize("size", [1.0, 2.0**-20, 2.0**40])
@pytest.mark.parametrize("same_place", [False, True])
@pytest.mark.parametrize("roots", [1, 2])
def test_instances_of_their_node_alone(tmp_path, size, same_place, roots):
    """Objects went to the nodes whose place was theirs to 1e-5: where a model is small, or two
    nodes are at one place, the instances of one were the other's too."""
    model = triangle_gltf()
    which = instanced(model, [0, 0, 0, size, 0, 0, 2 * size, 0, 0])
    place = [0 if same_place else size, 0, 0]
    model["nodes"] = [{"children": [2, 3]}, {"mesh": 0, "translation": [0, size, 0]},
                      {"mesh": 0, "translation": place, "extensions": {"EXT_mesh_gpu_instancing": {
                          "attributes": {"TRANSLATION": which}}}},
                      {"mesh": 0}]
    model["scenes"] = [{"nodes": [0, 1][:roots]}]
    scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", model))
    places = sorted((o["transform"][3], o["transform"][7]) if "transform" in o else (0, 0)
                    for o in scene["objects"])
    assert places == sorted([(place[0] + i * size, 0) for i in range(3)] + [(0, 0)] +
                            [(0, size)] * (roots - 1))


def test_transforms_as_the_file_has_them(tmp_path):
    """Not in float: nodes at 10^7 were up to half a unit off."""
    scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", triangle_gltf(nodes=[
        {"translation": [10000000.1, 0, 0], "children": [1]},
        {"mesh": 0, "matrix": [0.1, 0, 0, 0, 0, 3, 0, 0, 0, 0, 1, 0, 0.3, 0.2, 0, 1]}])))
    transform = scene["objects"][0]["transform"]
    assert transform[0] == 0.1 and transform[7] == 0.2 and transform[3] == 10000000.1 + 0.3


def test_last_rows_with_rounding(tmp_path):
    """A matrix that was multiplied in floats: taken as affine."""
    for row in ((1e-8, 0, 0, 1), (0, 0, 0, 0.9999999)):
        scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", triangle_gltf(nodes=[
            {"mesh": 0, "matrix": [2, 0, 0, row[0], 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, row[3]]}])))
        transform = scene["objects"][0]["transform"]
        assert transform[0] == 2 and transform[3] == 5 and transform[12:] == [0, 0, 0, 1]


def test_rotations_of_three_decimals(tmp_path):
    """Hand-written quaternions are a little off unit length: taken."""
    scene, _ = imported(tmp_path, write(tmp_path, "m.gltf", triangle_gltf(
        nodes=[{"mesh": 0, "rotation": [0, 0, 0.707, 0.707]}])))
    assert scene["objects"][0]["transform"][1] == pytest.approx(-1, abs=1e-3)


@pytest.mark.parametrize("data", [b"", b"junk in here", b"\0\1\2\3", b" [1]"])
def test_junk_under_a_gltf_name(tmp_path, data):
    (tmp_path / "m.glb").write_bytes(data)
    _, said = imported(tmp_path, "m.glb", status=3)
    assert "m.glb: neither GLB" in said and "[unknown-format]" in said and "column" not in said


@pytest.mark.parametrize("name", ["a b.bin", "\u00fcn\u00ef \u2764 (1)+%.bin", "%20.bin"])
def test_names_with_escapes(tmp_path, name):
    model = triangle_gltf()
    data = base64.b64decode(model["buffers"][0]["uri"].split(",")[1])
    (tmp_path / name).write_bytes(data)
    model["buffers"][0]["uri"] = urllib.parse.quote(name)
    scene, _ = imported(tmp_path, write(tmp_path, "\u2764 m.gltf", model))
    assert len(scene["objects"]) == 1


@pytest.mark.parametrize("change", [
    {"materials": [{"name": f"m{i}"} for i in range(60000)]},
    {"images": [{"uri": f"{i}.png"} for i in range(20000)],
     "textures": [{"source": i} for i in range(20000)],
     "materials": [{"normalTexture": {"index": i}} for i in range(20000)]},
    {"meshes": [{"primitives": [{"attributes": {"POSITION": 0} | {f"_{i}": 1 for i in range(100000)}}]}]},
])
def test_many_of_everything_take_no_square_of_time(tmp_path, change):
    name = write(tmp_path, "m.gltf", triangle_gltf(**change))
    start = time.monotonic()
    imported(tmp_path, name)
    assert time.monotonic() - start < 15  # 1 s alone; the square of it was minutes


def test_points_alone_are_refused(tmp_path):
    model = triangle_gltf()
    model["meshes"][0]["primitives"][0]["mode"] = 0
    _, said = imported(tmp_path, write(tmp_path, "m.gltf", model), status=3)
    assert "no face" in said and "3 points" in said


def test_other_formats_and_names(tmp_path):
    (tmp_path / "m.stl").write_text(
        "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        "endloop\nendfacet\nendsolid s\n")
    scene, _ = imported(tmp_path, "m.stl")
    assert len(scene["objects"]) == 1
    scene, _ = imported(tmp_path, write(tmp_path, "odd.json", triangle_gltf()))
    assert len(scene["objects"]) == 1
    (tmp_path / "noise.xyz").write_bytes(bytes(range(256)))
    imported(tmp_path, "noise.xyz", status=3)
    assert "missing-file" in imported(tmp_path, "none.glb", status=3)[1]


def test_output_that_cannot_be_written(tmp_path):
    name = write(tmp_path, "m.gltf", triangle_gltf())
    code, said = tilery("import", name, "-o", "no/such/scene.json", cwd=tmp_path)
    assert code == 5, said
    assert tilery("import", name, cwd=tmp_path)[0] == 2
