#!/usr/bin/env python3
"""Renders every model of the test data at 64x64 through a private farm, and makes a contact sheet.

usage: import_models.py [--sheet FILE.png] [--only TEXT] [--size N] [--spp N]

Looks under $TILERY_TEST_DATA/{gltf,obj,ply,cornell}; without it the test is skipped (77). A
model with a face must render to a picture that shows something; one without must give exit 3
and say what it holds instead. The sheet and a list of its cells land in artefacts/ beside the
programs, or where --sheet says.
"""
import argparse
import os
import pathlib
import struct
import subprocess
import sys
import tempfile
import zlib

FOLDERS = ("gltf", "obj", "ply", "cornell")
SUFFIXES = {".gltf", ".glb", ".obj", ".ply"}
SAYS_NO_FACE = ("[no-face]", "[empty-mesh]")
# Files among the good ones that have no usable face, and the id of the reason.
BROKEN = {
    "box-incomplete-positions.obj": "[index-out-of-range]",
    "sized_dims.ply": "[ply-header]",
}


def read_png(path):
    """(width, height, rows of RGB bytes) of an 8-bit RGB file without interlacing."""
    data = path.read_bytes()
    at, packed, width, height = 8, b"", 0, 0
    while at < len(data):
        (length,), kind = struct.unpack(">I", data[at:at + 4]), data[at + 4:at + 8]
        body = data[at + 8:at + 8 + length]
        if kind == b"IHDR":
            width, height, depth, colour = struct.unpack(">IIBB", body[:10])
            assert (depth, colour) == (8, 2), f"{path}: not 8-bit RGB"
        elif kind == b"IDAT":
            packed += body
        at += length + 12
    raw, rows, before = zlib.decompress(packed), [], bytearray(3 * width)
    for y in range(height):
        start = y * (3 * width + 1)
        before = unfilter(raw[start], bytearray(raw[start + 1:start + 1 + 3 * width]), before)
        rows.append(bytes(before))
    return width, height, rows


def unfilter(kind, row, before):
    """One row of a PNG file without its filter."""
    for i in range(len(row)):
        left = row[i - 3] if i >= 3 else 0
        corner = before[i - 3] if i >= 3 else 0
        if kind == 1:
            guess = left
        elif kind == 2:
            guess = before[i]
        elif kind == 3:
            guess = (left + before[i]) // 2
        elif kind == 4:
            p = left + before[i] - corner
            guess = min(((abs(p - left), 0, left), (abs(p - before[i]), 1, before[i]),
                         (abs(p - corner), 2, corner)))[2]
        else:
            guess = 0
        row[i] = (row[i] + guess) & 255
    return row


def write_png(path, width, rows):
    """Writes rows of RGB bytes."""
    def chunk(kind, body):
        return (struct.pack(">I", len(body)) + kind + body +
                struct.pack(">I", zlib.crc32(kind + body)))
    head = struct.pack(">IIBBBBB", width, len(rows), 8, 2, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + r for r in rows))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) +
                     chunk(b"IEND", b""))


def contact_sheet(path, pictures, size):
    """All pictures in rows of 14, with a gap of two pixels."""
    across, gap = 14, 2
    cell = size + gap
    width = across * cell + gap
    rows = [bytearray(b"\x40" * 3 * width) for _ in range(-(-len(pictures) // across) * cell + gap)]
    for i, (_, picture) in enumerate(pictures):
        x, y = gap + i % across * cell, gap + i // across * cell
        for k, row in enumerate(picture[2][:size]):
            part = row[:3 * size]
            rows[y + k][3 * x:3 * x + len(part)] = part
    write_png(path, width, [bytes(r) for r in rows])


def shows_something(picture):
    """True if the picture is neither black nor of one colour."""
    values = set()
    for row in picture[2]:
        values.update(row)
    return max(values) > 8 and len(values) > 4


def render(tilery, model, out, size, spp):
    """Runs one render; (exit status, what it said)."""
    done = subprocess.run(
        [tilery, "render", str(model), "-o", str(out.with_suffix(".exr")), "--png", str(out),
         "--size", f"{size}x{size}", "--spp", str(spp), "--workers", "1", "--threads", "2",
         "--quiet"], capture_output=True, timeout=120, check=False)
    return done.returncode, (done.stdout + done.stderr).decode(errors="replace")


def judge(model, status, said, out):
    """What is wrong with the outcome, or None; the picture if there is one."""
    expected = BROKEN.get(model.name)
    if status == 3:
        good = expected in said if expected else any(s in said for s in SAYS_NO_FACE)
        return (None if good else f"refused: {said.strip()[:300]}"), None
    if status != 0:
        return f"exit {status}: {said.strip()[-400:]}", None
    picture = read_png(out)
    return (None if shows_something(picture) else "the picture shows nothing"), picture


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--sheet", type=pathlib.Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--spp", type=int, default=8)
    options = parser.parse_args()
    if "TILERY_TEST_DATA" not in os.environ or "TILERY_BIN" not in os.environ:
        print("import_models: needs TILERY_TEST_DATA and TILERY_BIN")
        sys.exit(77)
    data = pathlib.Path(os.environ["TILERY_TEST_DATA"])
    programs = pathlib.Path(os.environ["TILERY_BIN"])
    sheet = options.sheet or programs.parent / "artefacts" / "import_models.png"
    sheet.parent.mkdir(parents=True, exist_ok=True)
    models = sorted(p for f in FOLDERS for p in (data / f).rglob("*")
                    if p.suffix.lower() in SUFFIXES and options.only in str(p))
    pictures, wrong, refused = [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        for model in models:
            out = pathlib.Path(folder) / "picture.png"
            status, said = render(programs / "tilery", model, out, options.size, options.spp)
            fault, picture = judge(model, status, said, out)
            name = str(model.relative_to(data))
            if picture:
                pictures.append((name, picture))
            refused += status == 3 and not fault
            if fault:
                wrong.append(f"{name}: {fault}")
    contact_sheet(sheet, pictures, options.size)
    sheet.with_suffix(".txt").write_text("".join(f"{i // 14},{i % 14} {n}\n"
                                                 for i, (n, _) in enumerate(pictures)))
    print(f"import_models: {len(models)} models, {len(pictures)} rendered, {refused} without a "
          f"face refused, {len(wrong)} wrong; {sheet}")
    print("\n".join(wrong))
    sys.exit(1 if wrong or not pictures else 0)


if __name__ == "__main__":
    main()
