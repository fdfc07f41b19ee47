"""Half floats and presets, and `tilery tradeoff`, which writes them."""
import csv
import html.parser
import json
import struct
import xml.etree.ElementTree

import numpy
import pytest

import exr_pixels
from farm import (GLASS_SCENE, SEED_SCENE, SLOW, Farm, alive, children_of, interrupt,
                  start_tilery, tilery)

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
    preset.write_bytes(b"spp = 6\n\0max-depth = 3\n")
    done = tilery("render", GLASS_SCENE, "-o", by_file, "--preset", preset)
    assert done.returncode == 3 and "zero byte" in done.stderr
    done = tilery("render", GLASS_SCENE, "-o", by_file, "--preset", tmp_path / "none")
    assert done.returncode == 3 and "[bad-preset]" in done.stderr


# --- the study --------------------------------------------------------------

def study_of(folder):
    return json.loads((folder / "tradeoff.json").read_text())


class Page(html.parser.HTMLParser):
    """Checks that tags close in order; collects what the page refers to."""
    VOID = {"meta", "img", "rect", "line", "circle", "path", "br", "link", "input"}

    def __init__(self):
        super().__init__()
        self.open, self.sources, self.images, self.text = [], [], 0, ""

    def handle_starttag(self, tag, attributes):
        if tag not in self.VOID:
            self.open.append(tag)
        for key, value in attributes:
            if key in ("src", "href", "data", "srcset"):
                self.sources.append(value)
        if tag == "img":
            self.images += 1
            assert dict(attributes)["alt"]

    def handle_startendtag(self, tag, attributes):
        assert tag in self.VOID, tag

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, tag

    def handle_data(self, data):
        self.text += data


def study_with_time_enough(out):
    """A busy machine measures fewer points in a budget, so it gets a larger one: until the knobs
    that test_study looks at have been measured twice. What they say is asserted there."""
    for budget in (6, 12, 24, 48):
        done = tilery("tradeoff", GLASS_SCENE, "-o", out, "--budget", budget * SLOW,
                      "--max-depth", 8, timeout=120 + 2 * budget)
        assert done.returncode == 0, done.stderr
        got = study_of(out)
        measured = [p for p in got["points"] if p["repeats"] >= 2]
        if (any(p["base"] for p in measured) and sum(p["knob"] == "spp" for p in measured) >= 2 and
                any(p["knob"] == "max-depth" and p["value"] == "1" for p in measured)):
            break
    return done, got


def test_study(tmp_path):
    """A small budget: every file is there and they agree; the page needs nothing from elsewhere."""
    out = tmp_path / "study"
    done, got = study_with_time_enough(out)
    assert got["tilery_tradeoff"] == 1 and got["reduced"] and not got["interrupted"]
    assert "smaller than the scene's" in done.stderr
    base = [p for p in got["points"] if p["base"]]
    assert len(base) == 1 and base[0]["repeats"] >= 2
    measured = [p for p in got["points"] if p["repeats"] >= 2]
    assert {"spp", "max-depth"} <= {p["knob"] for p in measured}
    for p in measured:
        assert p["relmse"]["low"] is None or p["relmse"]["low"] <= p["relmse"]["value"]
        assert p["core_seconds"]["value"] > 0 and len(p["runs"]) == p["repeats"]
    # More samples, less error: over a ladder of 16 times no machine hides that.
    ladder = sorted((p["spp"], p["relmse"]["value"]) for p in measured if p["knob"] == "spp")
    assert len(ladder) >= 2 and ladder[0][1] > 1.5 * ladder[-1][1] > 0
    # Direct light alone is far from the truth, and is said to be biased.
    one = [p for p in measured if p["knob"] == "max-depth" and p["value"] == "1"]
    assert one and one[0]["bias2"] > 2 * one[0]["bias2_se"] and one[0]["bias2"] > 0.01
    # Cells change no bit.
    for p in measured:
        if p["knob"] in ("tile", "builder"):
            assert p["same_bits"], p
    rows = list(csv.DictReader((out / "tradeoff.csv").open()))
    assert len(rows) == len([p for p in got["points"] if p["repeats"]])
    assert {r["knob"] for r in rows} == {p["knob"] for p in got["points"] if p["repeats"]}
    page = Page()
    page.feed((out / "index.html").read_text())
    assert page.open == [] and page.images > 4
    assert all(s.startswith("data:image/png;base64,") for s in page.sources), page.sources[:3]
    assert "Recommended settings" in page.text and "@import" not in page.text
    svg = xml.etree.ElementTree.parse(out / "tradeoff.svg").getroot()
    assert svg.tag.endswith("svg")
    png = (out / "tradeoff.png").read_bytes()
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and struct.unpack(">II", png[16:24]) == (1100, 700)
    check_presets(tmp_path, out, got)


def check_presets(tmp_path, out, got):
    """A recommendation is a preset that render takes, and says what the JSON says."""
    assert [p["name"] for p in got["presets"]] == ["draft", "standard", "final"]
    for preset in got["presets"]:
        lines = dict(line.split(" = ") for line in (out / preset["file"]).read_text().splitlines()
                     if not line.startswith("#"))
        assert lines.pop("half", "false") == str(preset["half"]).lower()
        assert lines == preset["options"]
    spp = [int(p["options"]["spp"]) for p in got["presets"]]
    assert spp == sorted(spp)
    report = tmp_path / "r.json"
    done = tilery("render", GLASS_SCENE, "-o", tmp_path / "draft.exr", "--size", "32x32",
                  "--preset", out / "draft.preset", "--report", report)
    assert done.returncode == 0, done.stderr
    assert json.loads(report.read_text())["spp_max"] == spp[0]


def test_study_interrupted(tmp_path):
    """Ctrl-C: 130, no process left, and what was measured is written."""
    out = tmp_path / "study"
    process = start_tilery("tradeoff", GLASS_SCENE, "-o", out, "--size", "24x24", "--budget", 12 * SLOW,
                           "--progress", "lines")
    seen = ""
    while "references are there" not in seen:
        line = process.stderr.readline()
        assert line, f"it ended: {seen}"
        seen += line
    children = children_of(process.pid)
    assert len(children) == 2
    interrupt(process)
    rest = process.communicate(timeout=30 * SLOW)[1]
    assert process.returncode == 130, rest
    assert not any(alive(pid) for pid in children)
    if (out / "tradeoff.json").exists():
        got = study_of(out)
        assert got["interrupted"] and got["points"]
        assert "interrupted" in (out / "index.html").read_text()


def test_study_refusals(tmp_path):
    """What cannot be studied is refused at once, by name."""
    done = tilery("tradeoff", GLASS_SCENE)
    assert done.returncode == 2 and "-o DIR" in done.stderr
    done = tilery("tradeoff", GLASS_SCENE, "-o", tmp_path / "s", "--size", "4000x4000")
    assert done.returncode == 2 and "262144" in done.stderr
    done = tilery("tradeoff", tmp_path / "none.json", "-o", tmp_path / "s")
    assert done.returncode == 3
    (tmp_path / "file").write_text("x")
    done = tilery("tradeoff", GLASS_SCENE, "-o", tmp_path / "file")
    assert done.returncode == 5 and "file" in done.stderr
    done = tilery("tradeoff", GLASS_SCENE, "-o", tmp_path / "s", "--spp", "4")
    assert done.returncode == 2 and "--spp" in done.stderr


def test_study_on_a_farm(tmp_path):
    """--master measures on that farm, and leaves nothing running there."""
    with Farm(tmp_path) as farm:
        farm.worker(threads=1)
        done = farm.cli("tradeoff", SEED_SCENE, "-o", tmp_path / "study", "--size", "16x16",
                        "--budget", 4 * SLOW, "--master", farm.url, timeout=120)
        assert done.returncode == 0, done.stderr
        assert study_of(tmp_path / "study")["cost"] == "reported"
        status, jobs = farm.request("GET", "/api/v1/jobs?limit=1000")
        assert status == 200 and jobs["items"]
        assert {j["state"] for j in jobs["items"]} <= {"done", "cancelled"}


# --- compare ----------------------------------------------------------------

def test_flip_of_two_tones(tmp_path):
    """Half the pixels dark, half bright: which of them is the median decides the exposures.

    Figures of flip-evaluator 1.7; tests/numerics/flip_peer.py runs the package itself.
    """
    y, x = numpy.mgrid[0:48, 0:72]
    reference = ((x // 9 + y // 8) % 2)[..., None] * numpy.array([3.0, 0.4, 0.1]) + 0.05
    test = reference * 1.2
    test[20:24, 30:40] = 12
    exr_pixels.write(tmp_path / "test.exr", test)
    exr_pixels.write(tmp_path / "reference.exr", reference)
    done = tilery("compare", tmp_path / "test.exr", tmp_path / "reference.exr", "--flip", "--json")
    got = json.loads(done.stdout)
    assert got["flip_mean"] == pytest.approx(0.2265870, abs=2e-5)
    assert got["flip_p95"] == pytest.approx(0.3092576, abs=1e-4)


def test_compare_refusals(tmp_path):
    """Pictures that cannot be held against each other: which, and why."""
    grey = numpy.full((4, 6, 3), 0.5, dtype=numpy.float32)
    exr_pixels.write(tmp_path / "a.exr", grey)
    exr_pixels.write(tmp_path / "wide.exr", grey[:, :5])
    data = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "other.exr").write_bytes(data.replace(b"B\0\2\0\0\0", b"X\0\2\0\0\0", 1))
    done = tilery("compare", tmp_path / "a.exr", tmp_path / "wide.exr")
    assert done.returncode == 3 and "6x4" in done.stderr and "5x4" in done.stderr
    assert "same --size and --crop" in done.stderr
    done = tilery("compare", tmp_path / "other.exr", tmp_path / "a.exr")
    assert done.returncode == 3 and 'no channel "B"' in done.stderr
