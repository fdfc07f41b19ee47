"""Half floats and presets, and `tilery tradeoff`, which writes them."""
import json

import numpy
import pytest

import exr_pixels
from farm import GLASS_SCENE, SEED_SCENE, Farm, tilery

SMALL = ("--size", "32x32", "--spp", "4")


def channel_types(path):
    """Pixel types of the channels by name: 1 half, 2 float."""
    data = path.read_bytes()
    at = data.index(b"channels\0chlist\0") + len(b"channels\0chlist\0") + 4
    types = {}
    while data[at] != 0:
        end = data.index(0, at)
        types[data[at:end].decode()] = int.from_bytes(data[end + 1:end + 5], "little")
        at = end + 17
    return types


def bright_scene(folder):
    """The seed's scene with a light so strong that halves cannot hold it."""
    scene = json.loads(SEED_SCENE.read_text())
    scene["integrator"]["point_light_flux"] = [1e9, 1e9, 1e9]
    for thing in scene["objects"]:
        if "path" in thing:
            thing["path"] = str(SEED_SCENE.parent / thing["path"])
    path = folder / "bright.json"
    path.write_text(json.dumps(scene))
    return path


def test_half(tmp_path):
    """--half: the same values rounded to 11 bits, from render, get and submit alike."""
    full, half = tmp_path / "full.exr", tmp_path / "half.exr"
    assert tilery("render", SEED_SCENE, "-o", full, *SMALL).returncode == 0
    done = tilery("render", SEED_SCENE, "-o", half, *SMALL, "--half")
    assert done.returncode == 0 and "65504" not in done.stderr
    assert set(channel_types(full).values()) == {2}
    assert set(channel_types(half).values()) == {1}
    expected = exr_pixels.rgb(full).astype(numpy.float16)
    got = tilery("compare", half, full, "--json")
    assert json.loads(got.stdout)["max_difference"]["value"] == pytest.approx(
        numpy.abs(expected.astype(numpy.float32) - exr_pixels.rgb(full)).max(), rel=1e-6)
    with Farm(tmp_path) as farm:
        farm.worker(threads=1)
        job = farm.submit(SEED_SCENE, *SMALL)
        farm.cli("watch", job)
        assert farm.cli("get", job, "-o", tmp_path / "got.exr", "--half").returncode == 0
        assert farm.cli("get", job, "-o", tmp_path / "got.png", "--half").returncode == 2
    assert set(channel_types(tmp_path / "got.exr").values()) == {1}
    same = tilery("compare", half, tmp_path / "got.exr", "--identical")
    assert same.returncode == 0, same.stderr


def test_half_clamps(tmp_path):
    """What no half can hold is cut to the largest one, counted, and said even under --quiet."""
    full, half = tmp_path / "full.exr", tmp_path / "half.exr"
    scene = bright_scene(tmp_path)
    assert tilery("render", scene, "-o", full, *SMALL).returncode == 0
    done = tilery("render", scene, "-o", half, *SMALL, "--half", "--quiet")
    assert done.returncode == 0
    count = int((exr_pixels.rgb(full) > 65504).sum())
    assert count > 100
    assert f"{count} values over 65504" in done.stderr
    got = json.loads(tilery("compare", half, half, "--json").stdout)
    assert got["nonfinite_a"] == 0


def test_preset(tmp_path):
    """A preset's options are those of the command line; the command line wins; errors have lines."""
    preset = tmp_path / "mine.preset"
    preset.write_text("# mine\nspp = 6\nmax-depth = 3\nsampler = halton\nhalf = true\n")
    by_file, by_hand = tmp_path / "a.exr", tmp_path / "b.exr"
    done = tilery("render", GLASS_SCENE, "-o", by_file, "--size", "24x24", "--preset", preset)
    assert done.returncode == 0, done.stderr
    done = tilery("render", GLASS_SCENE, "-o", by_hand, "--size", "24x24", "--spp", "6",
                  "--max-depth", "3", "--sampler", "halton", "--half")
    assert done.returncode == 0, done.stderr
    assert tilery("compare", by_file, by_hand, "--identical").returncode == 0
    report = tmp_path / "r.json"
    done = tilery("render", GLASS_SCENE, "-o", by_file, "--size", "24x24", "--preset", preset,
                  "--spp", "2", "--report", report)
    assert done.returncode == 0 and json.loads(report.read_text())["spp_max"] == 2
    preset.write_text("spp = 6\nmax-dept = 3\nspp\n")
    done = tilery("render", GLASS_SCENE, "-o", tmp_path / "c.exr", "--preset", preset)
    assert done.returncode == 3 and not (tmp_path / "c.exr").exists()
    assert f"{preset}:2: no job option \"max-dept\"" in done.stderr
    assert "did you mean max-depth?" in done.stderr and "2 problems" in done.stderr
    done = tilery("render", GLASS_SCENE, "-o", by_file, "--preset", tmp_path / "none")
    assert done.returncode == 3 and "[bad-preset]" in done.stderr
