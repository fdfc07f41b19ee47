#!/usr/bin/env python3
"""The scene schema agrees with the scenes and with the reader.

usage: check_schema.py ROOT. Exit status 77 (skipped) without python3-jsonschema.

1. Every scene of scenes/ satisfies docs/scene.schema.json, and damaged ones do not.
2. Every table of known keys in common/scene_json*.c is the key set of one schema object, and
   docs/SCENE.md names each key.
"""
import copy
import json
import pathlib
import re
import sys

try:
    import jsonschema
except ImportError:
    sys.exit(77)

root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()
schema = json.loads((root / "docs/scene.schema.json").read_text())
validator = jsonschema.Draft202012Validator(schema)
validator.check_schema(schema)
failures = []


def key_sets(node):
    """The property names of every object that the schema describes."""
    if isinstance(node, dict):
        if "properties" in node and node.get("additionalProperties") is False:
            yield frozenset(node["properties"])
        for child in node.values():
            yield from key_sets(child)
    elif isinstance(node, list):
        for child in node:
            yield from key_sets(child)


def check_scenes():
    scenes = sorted((root / "scenes").glob("*.json"))
    assert len(scenes) >= 7, scenes
    for path in scenes:
        scene = json.loads(path.read_text())
        failures.extend(f"{path.name}: {e.json_path}: {e.message}" for e in validator.iter_errors(scene))
        damages = [("no camera", lambda s: s.pop("camera")), ("fov", lambda s: s["camera"].update(fov=180)),
                   ("typo", lambda s: s["film"].update(resolutoin=[1, 1])),
                   ("side", lambda s: s["film"].update(resolution=[65536, 1])),
                   ("bare", lambda s: s["objects"].append({"type": "sphere", "center": [0, 0, 0]}))]
        for what, damage in damages:
            broken = copy.deepcopy(scene)
            damage(broken)
            if validator.is_valid(broken):
                failures.append(f"{path.name}: the schema accepts it with damage: {what}")


def check_keys():
    known = set(key_sets(schema))
    text = (root / "docs/SCENE.md").read_text()
    tables = 0
    for path in sorted((root / "common").glob("scene_json*.c")):
        source = path.read_text()
        for name, body in re.findall(r"const char \*const (\w*keys)\[\] = \{(.*?)\};", source, re.S):
            keys = frozenset(re.findall(r'"(\w+)"', body))
            tables += 1
            if keys not in known:
                failures.append(f"{path.name}: {name} {sorted(keys)} is no object of the schema")
            failures.extend(f"docs/SCENE.md does not name `{key}`" for key in keys if f"`{key}`" not in text)
    assert tables >= 15, tables


check_scenes()
check_keys()
print("\n".join(failures) or "schema: agrees")
sys.exit(bool(failures))
