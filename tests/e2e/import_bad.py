#!/usr/bin/env python3
"""Imports every damaged model of the test data, and damaged copies of good ones.

usage: import_bad.py [--seed N] [--mutants N]

Each must be a scene (exit 0) or a refusal that names the file (exit 3), within 5 s, with no
report of a sanitizer. Files whose required extensions we lack are refused by name. Skipped
without $TILERY_TEST_DATA (77). Mutants depend on the seed alone; a failing one is kept.
"""
import argparse
import os
import pathlib
import random
import subprocess
import sys
import tempfile
import time

SUFFIXES = {".gltf", ".glb", ".obj", ".ply"}
SECONDS_MAX = 5
REPORTS = ("Sanitizer", "runtime error:", "assertion")
REQUIRED = {"BoxDraco.gltf": "KHR_draco_mesh_compression", "BoxMeshopt.glb": "EXT_meshopt_compression"}


def run_import(tilery, model, folder):
    """(what is wrong or None, exit status, output) of one import."""
    start = time.monotonic()
    done = subprocess.run([tilery, "import", str(model), "-o", str(folder / "scene.json")],
                          capture_output=True, timeout=60, check=False)
    seconds = time.monotonic() - start
    said = (done.stdout + done.stderr).decode(errors="replace")
    wrong = None
    if any(r in said for r in REPORTS):
        wrong = "a report: " + said[:2000]
    elif done.returncode not in (0, 3):
        wrong = f"exit {done.returncode}: {said[:300]}"
    elif done.returncode == 3 and model.name not in said:
        wrong = f"refused without naming the file: {said[:300]}"
    elif seconds > SECONDS_MAX:
        wrong = f"took {seconds:.1f} s"
    return wrong, done.returncode, said


def mutate(data, chance):
    """Some bytes changed, a number replaced, or the end cut off."""
    data = bytearray(data)
    kind = chance.randrange(4)
    if kind == 0:
        return bytes(data[:chance.randrange(len(data))])
    digits = [i for i, b in enumerate(data[:60000]) if 48 <= b < 58]
    for _ in range(chance.randint(1, 6)):
        if kind == 1 and digits:
            data[chance.choice(digits)] = chance.choice(b"0123456789")
        else:
            data[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(data)


def try_mutants(tilery, data, folder, seed, count):
    """Yields (name, fault) for mutants of small good models, beside the files they name."""
    chance = random.Random(seed)
    sources = sorted(p for p in data.rglob("*") if p.suffix in SUFFIXES
                     and "bad" not in p.relative_to(data).parts and p.stat().st_size < 60000)
    for i in range(count):
        source = chance.choice(sources)
        copy = folder / f"mutant{seed}-{i}{source.suffix}"
        for beside in source.parent.iterdir():
            link = folder / beside.name
            if beside.is_file() and not link.exists():
                link.symlink_to(beside)
        copy.write_bytes(mutate(source.read_bytes(), chance))
        wrong, _, _ = run_import(tilery, copy, folder)
        if wrong:
            kept = pathlib.Path(tempfile.gettempdir()) / copy.name
            kept.write_bytes(copy.read_bytes())
            yield f"{kept} (of {source.name})", wrong
        copy.unlink()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mutants", type=int, default=60)
    options = parser.parse_args()
    if "TILERY_TEST_DATA" not in os.environ or "TILERY_BIN" not in os.environ:
        print("import_bad: needs TILERY_TEST_DATA and TILERY_BIN")
        sys.exit(77)
    data = pathlib.Path(os.environ["TILERY_TEST_DATA"])
    tilery = pathlib.Path(os.environ["TILERY_BIN"]) / "tilery"
    models = sorted(p for p in (data / "bad").rglob("*") if p.suffix in SUFFIXES)
    faults, counts = [], {0: 0, 3: 0}
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        for model in models:
            wrong, status, said = run_import(tilery, model, folder)
            counts[status] = counts.get(status, 0) + 1
            extension = REQUIRED.get(model.name)
            if not wrong and extension and not (status == 3 and extension in said):
                wrong = f"{extension} is not refused by name"
            if wrong:
                faults.append((str(model.relative_to(data)), wrong))
        faults += try_mutants(tilery, data, folder, options.seed, options.mutants)
    print(f"import_bad: {len(models)} files, {counts[0]} imported, {counts[3]} refused; "
          f"{options.mutants} mutants of seed {options.seed}; {len(faults)} wrong")
    for model, wrong in faults:
        print(f"{model}: {wrong}")
    sys.exit(1 if faults or len(models) < 10 else 0)


if __name__ == "__main__":
    main()
