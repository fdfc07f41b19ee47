#!/usr/bin/env python3
"""Checks the #include graph: who may include whom, and that each library has one door.

usage: layers.py [ROOT]; prints every breach as file:line and exits 1 if there is any.
The rules are those of ARCHITECTURE.md, "Rooms".
"""
import pathlib
import re
import sys

# room -> rooms whose headers it may include. A longer prefix wins.
ROOMS = {
    "common": {"common"},
    "proto": {"common", "proto"},
    "master/sched": {"common", "master/sched"},
    "master": {"common", "proto", "master", "master/sched"},
    "worker/render": {"common", "worker/render"},
    "worker/scene": {"common", "worker/render", "worker/scene"},
    "worker": {"common", "proto", "worker", "worker/render", "worker/scene"},
    "client": {"common", "client"},
}

# What of common the pure rooms may know: nothing that logs or does I/O.
PURE_COMMON = {
    "worker/render": {"err.h", "mem.h", "grid.h", "job_spec.h", "scene.h", "scene_lazy.h", "dmath.h", "vec.h",
                      "digest.h", "diag.h", "determinism.h", "pyramid.h", "texel.h"},
    "master/sched": {"err.h", "mem.h", "grid.h", "job_spec.h", "diag.h"},
}

# library header -> files that may include it.
DOORS = {
    r"uv\.h": r"proto/transport.*|master/.*|worker/.*",
    r"openexr.*|OpenEXR/.*|half\.h": r"common/exr_file\.c",
    r"png\.h": r"common/png_file\.c",
    r"turbojpeg\.h": r"common/(jpeg_file|image_file)\.c",
    r"zstd\.h": r"proto/tile_codec\.c|common/(package|chunk_zstd)\.c",
    r"sqlite3\.h": r"master/store.*",
    r"gnutls/.*": r"common/digest\.c|proto/transport.*",
    r"microhttpd\.h": r"master/http.*",
    r"curl/.*": r"client/http_client\.c",
    r"assimp/.*": r"client/import_assimp.*",
    r"sleef\.h": r"common/dmath\.c",
    r"pb.*\.h": r"proto/.*",
    r"math\.h": r"(?!master/sched).*",  # libm calls in worker/render: symbols.sh
    r"(sys/socket|pthread|unistd|time|stdio|locale|fcntl|signal|threads)\.h":
        r"(?!worker/render|master/sched).*",
}
UV_FREE = ("worker/render/", "worker/scene/", "master/sched/")

INCLUDE = re.compile(r'^\s*#\s*include\s+(["<])([^">]+)[">]')


def room_of(path):
    """The room a path lies in, by the longest matching prefix; None outside the rooms."""
    fits = [r for r in ROOMS if path == r or path.startswith(r + "/")]
    return max(fits, key=len) if fits else None


def breaches_of(root, path):
    """Yields (line, text) for each forbidden include of one file."""
    room = room_of(path)
    for number, line in enumerate((root / path).read_text().splitlines(), 1):
        found = INCLUDE.match(line)
        if not found:
            continue
        name = found.group(2)
        other = room_of(name)
        if found.group(1) == '"' and other and other not in ROOMS[room]:
            yield number, f'{room} may not include "{name}"'
        if room in PURE_COMMON and name.startswith("common/"):
            if name.split("/")[1] not in PURE_COMMON[room]:
                yield number, f'{room} is pure and may not include "{name}"'
        for library, door in DOORS.items():
            if re.fullmatch(library, name) and not re.fullmatch(door, path):
                yield number, f"<{name}> may only be included by {door}"
        if name == "uv.h" and path.startswith(UV_FREE):
            yield number, f"{room} is pure and may not use libuv"


def main():
    root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()
    files = [p.relative_to(root).as_posix() for room in ("common", "proto", "master", "worker", "client")
             for p in sorted((root / room).rglob("*.[ch]"))]
    if len(files) < 10:
        sys.exit(f"layers: only {len(files)} files under {root}: wrong folder?")
    failed = False
    for path in files:
        for number, text in breaches_of(root, path):
            print(f"{path}:{number}: {text}")
            failed = True
    print(f"layers: {len(files)} files read")
    sys.exit(failed)


if __name__ == "__main__":
    main()
