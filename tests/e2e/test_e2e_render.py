"""`tilery render`: one command, a farm of child processes, one picture whatever the schedule."""
import json
import os
import pathlib
import shutil
import stat
import struct
import subprocess
import time
import zlib

import numpy
import pytest

import exr_pixels
from farm import (BIN, GLASS_SCENE, SEED_SCENE, alive, children_of, clean_env, report_of,
                  start_tilery, tilery, wait_until)

SMALL = ("--size", "48x40", "--spp", "4")


def render(scene, out, *options, env=None, timeout=60):
    report = pathlib.Path(f"{out}.json")
    done = tilery("render", scene, "-o", out, "--report", report, *options, env=env,
                  timeout=timeout)
    assert done.returncode == 0, done.stderr
    return report_of(report), done


@pytest.fixture(autouse=True)
def own_temporary(tmp_path, monkeypatch):
    """Private folders of the renders go where the test can look at them, and must all be gone."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    yield
    left = [p.name for p in folder.iterdir()]
    assert left == [], f"left behind: {left}"


@pytest.mark.parametrize("scene", [SEED_SCENE, GLASS_SCENE], ids=["seed", "glass"])
def test_report_scenes(tmp_path, scene):
    """Both scenes of the source report: picture, PNG, report, hash of the very pixels."""
    out, png = tmp_path / "out.exr", tmp_path / "out.png"
    report, done = render(scene, out, *SMALL, "--png", png)
    assert done.stdout == ""
    pixels = exr_pixels.rgb(out)
    assert pixels.shape == (40, 48, 3)
    assert numpy.isfinite(pixels).all() and pixels.max() > 0.05
    assert report["image_sha256"] == exr_pixels.sha256(out)
    assert report["state"] == "done"
    assert (report["width"], report["height"]) == (48, 40)
    assert report["spp_min"] == report["spp_max"] == 4
    assert report["samples"] == 48 * 40 * 4
    assert report["rays"] >= report["samples"]
    assert report["nonfinite_samples"] == 0
    for key in ("seconds", "units", "bytes", "error"):
        assert isinstance(report[key], dict)
    for key in ("total", "load", "build", "render", "gather"):
        assert key in report["seconds"]
    assert 0 < report["seconds"]["first_result"] <= report["seconds"]["total"]
    start = report["start"]
    for key in ("read", "pack", "ready", "send"):
        assert 0 <= start[key] < start["first_pixel"], start
    assert start["first_pixel"] >= start["ready"] + report["seconds"]["first_result"] - 0.5, start
    for key in ("total", "retried", "speculated", "rejected", "verified"):
        assert key in report["units"]
    for key in ("scene_sent", "results_received"):
        assert key in report["bytes"]
    for key in ("relmse", "relmse_low", "relmse_high", "mean_low", "mean_high"):
        assert key in report["error"]
    assert report["units"]["rejected"] == 0
    assert "core_seconds" in report and report["workers"] >= 1
    assert report["image_sha256"] in done.stderr
    data = png.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", data[16:24]) == (48, 40)


def test_one_hash(tmp_path):
    """The same bits from 1, 2 and 8 workers, 1 and 2 threads, three tile sizes, every builder."""
    hashes = {}
    variants = [(w, t, tile) for w, t, tile in
                [(1, 1, 16), (2, 1, 8), (2, 2, 64), (8, 1, 16), (8, 2, 8), (1, 2, 64)]]
    for number, (workers, threads, tile) in enumerate(variants):
        report, _ = render(GLASS_SCENE, tmp_path / f"{number}.exr", *SMALL, "--workers", workers,
                           "--threads", threads, "--tile", tile, timeout=120)
        hashes[f"{workers} workers, {threads} threads, tile {tile}"] = report["image_sha256"]
    for builder in ("median", "sbvh", "none"):
        report, _ = render(GLASS_SCENE, tmp_path / f"{builder}.exr", *SMALL, "--builder", builder)
        hashes[builder] = report["image_sha256"]
    assert len(set(hashes.values())) == 1, hashes


def test_fast_has_one_hash_too(tmp_path):
    """Float decides with the same bits for any workers, cells and tree."""
    hashes = {}
    for options in (("--workers", "1"), ("--workers", "2", "--threads", "1", "--tile", "7"),
                    ("--workers", "1", "--threads", "3", "--builder", "median"),
                    ("--workers", "1", "--builder", "sbvh")):
        report, _ = render(GLASS_SCENE, tmp_path / "a.exr", *SMALL, "--precision", "fast", *options)
        assert report["spec"]["precision"] == "fast"
        hashes[options] = report["image_sha256"]
    assert len(set(hashes.values())) == 1, hashes


def test_aovs(tmp_path):
    """More channels, the same on any farm; the picture's own bits do not know of them."""
    names = "depth,position,uv,object,material,normal,ng,albedo,samples,error"
    plain, _ = render(GLASS_SCENE, tmp_path / "plain.exr", *SMALL)
    first, _ = render(GLASS_SCENE, tmp_path / "a.exr", *SMALL, "--aov", names)
    render(GLASS_SCENE, tmp_path / "b.exr", *SMALL, "--aov", names, "--workers", "3", "--tile", "7")
    assert first["image_sha256"] == plain["image_sha256"]
    _, a = exr_pixels.read(tmp_path / "a.exr")
    _, b = exr_pixels.read(tmp_path / "b.exr")
    _, few = exr_pixels.read(tmp_path / "plain.exr")
    assert sorted(few) == ["B", "G", "R"]
    assert len(a) == 3 + 19 and {"depth", "normal.X", "uv.V", "albedo.B", "error"} < set(a)
    for name, plane in a.items():
        assert (plane == b[name]).all(), name
    assert (a["samples"] == 4).all() and ((a["depth"] > 0) == (a["object"] > 0)).all()
    assert (a["object"] == numpy.round(a["object"])).all() and len(numpy.unique(a["object"])) > 4
    assert a["error"].max() > 0
    length = a["ng.X"] ** 2 + a["ng.Y"] ** 2 + a["ng.Z"] ** 2
    assert numpy.median(length) == pytest.approx(1, abs=1e-5)


def test_seed_changes_the_picture(tmp_path):
    """The identity above would be worth nothing if every picture were the same."""
    a, _ = render(GLASS_SCENE, tmp_path / "a.exr", *SMALL, "--seed", 1)
    b, _ = render(GLASS_SCENE, tmp_path / "b.exr", *SMALL, "--seed", 2)
    assert a["image_sha256"] != b["image_sha256"]


def test_crop_has_the_same_bits(tmp_path):
    render(SEED_SCENE, tmp_path / "full.exr", *SMALL)
    report, done = render(SEED_SCENE, tmp_path / "crop.exr", *SMALL, "--crop", "7,9,21,13")
    assert "21x13 of 48x40" in done.stderr
    full, crop = exr_pixels.rgb(tmp_path / "full.exr"), exr_pixels.rgb(tmp_path / "crop.exr")
    assert crop.shape == (13, 21, 3)
    assert crop.tobytes() == full[9:22, 7:28].tobytes()
    assert report["image_sha256"] == exr_pixels.sha256(tmp_path / "crop.exr")


def test_png_is_the_same_picture(tmp_path):
    """8-bit sRGB of the very pixels, within half a step of rounding."""
    render(SEED_SCENE, tmp_path / "a.exr", *SMALL, "--png", tmp_path / "a.png")
    data, at, packed = (tmp_path / "a.png").read_bytes(), 8, b""
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        if kind == b"IDAT":
            packed += data[at + 8:at + 8 + size]
        at += 12 + size
    rows = numpy.frombuffer(zlib.decompress(packed), dtype=numpy.uint8).reshape(40, 1 + 48 * 3)
    shown = numpy.zeros((40, 48 * 3), dtype=numpy.int64)
    for y in range(40):
        shown[y] = unfilter(int(rows[y, 0]), rows[y, 1:].astype(numpy.int64),
                            shown[y - 1] if y else numpy.zeros(48 * 3, dtype=numpy.int64))
    linear = numpy.clip(exr_pixels.rgb(tmp_path / "a.exr").astype(float), 0, 1)
    srgb = numpy.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert numpy.abs(shown.reshape(40, 48, 3) - 255 * srgb).max() <= 0.51


def unfilter(kind, row, above):
    """One PNG row of 8-bit RGB."""
    out = numpy.zeros_like(row)
    for i, value in enumerate(row):
        a = out[i - 3] if i >= 3 else 0
        b, c = above[i], above[i - 3] if i >= 3 else 0
        p = a + b - c
        near = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
        out[i] = (value + (0, a, b, (a + b) // 2, near)[kind]) & 255
    return out


def test_piped_progress(tmp_path):
    """Piped: plain lines, no escape, each tenth at most once, rising; the hash at the end."""
    _, done = render(GLASS_SCENE, tmp_path / "a.exr", "--size", "64x64", "--spp", "16")
    assert "\x1b" not in done.stderr and "\r" not in done.stderr
    shares = [int(line[:line.index("%")]) for line in done.stderr.splitlines()
              if line.strip()[:1].isdigit() and "%" in line[:5]]
    assert shares == sorted(shares) and shares[-1] == 100 and len(shares) <= 10
    assert "64x64, 16 spp, done in" in done.stderr
    assert "joined" not in done.stderr # our own workers are no news


def test_quiet(tmp_path):
    _, done = render(SEED_SCENE, tmp_path / "a.exr", *SMALL, "--quiet")
    assert done.stderr == "" and done.stdout == ""


def test_json_lines(tmp_path):
    """--json: lines of JSON on standard output, the last one the end with the report."""
    done = tilery("render", SEED_SCENE, "-o", tmp_path / "a.exr", *SMALL, "--json")
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert lines[-1]["event"] == "end" and lines[-1]["exit"] == 0
    assert lines[-1]["report"]["image_sha256"] == exr_pixels.sha256(tmp_path / "a.exr")
    progress = [line for line in lines if line["event"] == "progress"]
    assert progress and progress[-1]["done"] == 1
    for line in progress:
        assert {"t", "job", "done", "left_s", "relmse", "workers"} <= set(line)
    assert done.stderr == ""


def test_ignores_the_farm_of_the_environment(tmp_path):
    render(SEED_SCENE, tmp_path / "a.exr", *SMALL,
           env=clean_env(TILERY_MASTER="http://127.0.0.1:1", TMPDIR=os.environ["TMPDIR"]))


def test_replaces_the_old_picture_whole(tmp_path):
    """A reader at OUT sees the old file or the new one, never a part."""
    out = tmp_path / "a.exr"
    render(SEED_SCENE, out, *SMALL)
    first = out.read_bytes()
    process = start_tilery("render", GLASS_SCENE, "-o", out, *SMALL)
    seen = set()
    while process.poll() is None:
        seen.add(out.read_bytes())
    process.communicate()
    seen.add(out.read_bytes())
    assert process.returncode == 0
    assert len(seen) == 2 and first in seen
    assert [p.name for p in tmp_path.iterdir() if ".part" in p.name] == []


def test_private_folder_is_private(tmp_path):
    """Mode 0700, and the token in it readable by the owner alone."""
    process = start_tilery("render", GLASS_SCENE, "-o", tmp_path / "a.exr", "--size", "64x64",
                           "--spp", "64")
    folder = pathlib.Path(os.environ["TMPDIR"])
    token = wait_until(lambda: next(iter(folder.glob("tilery-render-*/token")), None), "the token")
    assert stat.S_IMODE(token.parent.stat().st_mode) == 0o700
    assert stat.S_IMODE(token.stat().st_mode) == 0o600
    secret = token.read_text().strip()
    assert len(secret) == 64
    for pid in children_of(process.pid):
        assert secret.encode() not in pathlib.Path(f"/proc/{pid}/cmdline").read_bytes()
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert secret not in err


def test_children_die_with_a_killed_parent(tmp_path):
    """SIGKILL leaves no process behind, and the next render sweeps the folder."""
    process = start_tilery("render", GLASS_SCENE, "-o", tmp_path / "a.exr", "--size", "256x256",
                           "--spp", "4096", "--workers", "3")
    wait_until(lambda: len(children_of(process.pid)) >= 4, "master and three workers")
    time.sleep(0.2)
    children = children_of(process.pid)
    process.kill()
    process.communicate()
    wait_until(lambda: not any(alive(pid) for pid in children), "the children to die", 5)
    assert not (tmp_path / "a.exr").exists()
    left = list(pathlib.Path(os.environ["TMPDIR"]).iterdir())
    assert len(left) == 1
    render(SEED_SCENE, tmp_path / "b.exr", *SMALL)
    assert not left[0].exists()


def test_missing_daemon(tmp_path):
    """A tilery without its daemons beside it says so and exits 5."""
    lonely = tmp_path / "bin"
    lonely.mkdir()
    shutil.copy2(BIN / "tilery", lonely / "tilery")
    done = subprocess.run(
        [str(lonely / "tilery"), "render", str(SEED_SCENE), "-o", str(tmp_path / "a.exr")],
        env=clean_env(TMPDIR=os.environ["TMPDIR"]), capture_output=True, text=True, timeout=60,
        check=False)
    assert done.returncode == 5
    assert "tilery-master" in done.stderr and "No such file" in done.stderr
