"""Renders to an error, within a time and by a plan: the same bits whoever renders and whoever is
killed, and what stopped them is said."""
import json
import math
import struct
import time

import numpy
import pytest

import exr_pixels
from farm import SEED_SCENE, SLOW, SCENES, Farm, clean_env, report_of, tilery

SCENE = SCENES / "two_spheres.json"
# A pilot, and some stages behind it.
WORK = ("--size", "80x48", "--target-error", 0.03 if SLOW > 1 else 0.006)


def render(folder, name, *options):
    """The report and the picture of one render."""
    done = tilery("render", SCENE, "-o", folder / f"{name}.exr", "--report",
                  folder / f"{name}.json", "--quiet", *options, timeout=120)
    assert done.returncode == 0, done.stderr
    return report_of(folder / f"{name}.json"), exr_pixels.rgb(folder / f"{name}.exr")


@pytest.fixture(scope="module")
def golden(tmp_path_factory):
    folder = tmp_path_factory.mktemp("golden")
    report, rgb = render(folder, "a", *WORK)
    return folder, report, rgb


def test_target_error_says_what_it_did(golden):
    """The claim, the plan and the numbers of samples agree with each other."""
    _, report, _ = golden
    assert report["stopped_by"] == "error"
    error = report["error"]
    assert 0 < error["relmse"] <= WORK[-1] and error["relmse_low"] <= error["relmse"]
    assert error["effective_size"] >= 32 and error["heavy_tail"] is False
    assert error["worst_cell"]["relmse"] > error["relmse"]
    plan = report["plan"]
    assert (plan["columns"], plan["rows"], plan["square"]) == (5, 3, 16)
    assert len(plan["spp"]) == 15 and len(set(plan["spp"])) > 1, "all squares got the same"
    assert min(plan["spp"]) == report["spp_min"] and max(plan["spp"]) == report["spp_max"]
    assert report["spp_mean"] == pytest.approx(sum(plan["spp"]) / 15)
    pilot = 2 * 80 * 48 if plan["pilot"] == "dropped" else 0
    assert report["samples"] == sum(plan["spp"]) * 256 + pilot


def test_the_same_bits_whoever_renders(golden, tmp_path):
    _, report, _ = golden
    other, _ = render(tmp_path, "b", *WORK, "--workers", 3, "--threads", 1, "--tile", 7)
    assert other["image_sha256"] == report["image_sha256"]
    assert other["plan"] == report["plan"]


def test_a_plan_repeats_the_bits(golden, tmp_path):
    """The report as a plan: the same picture, and the same part of it."""
    folder, report, rgb = golden
    size = ("--size", "80x48")
    again, _ = render(tmp_path, "c", *size, "--plan", folder / "a.json", "--workers", 1)
    assert again["image_sha256"] == report["image_sha256"]
    assert again["stopped_by"] == "plan" and again["plan"] == report["plan"]
    assert again["samples"] == sum(report["plan"]["spp"]) * 256, "the pilot was rendered again"
    _, part = render(tmp_path, "d", *size, "--crop", "37,5,20,30", "--plan", folder / "a.json")
    assert (part == rgb[5:35, 37:57]).all()


def test_a_plan_repeats_a_kept_pilot(tmp_path):
    """A pilot that is good enough is the picture, of 2 samples; its plan has the same bits."""
    size = ("--size", "48x32")
    report, _ = render(tmp_path, "m", *size, "--target-error", 50)
    assert report["stopped_by"] == "error" and report["plan"]["pilot"] == "kept"
    assert report["plan"]["spp"] == [2] * 6 and report["samples"] == 2 * 48 * 32
    again, _ = render(tmp_path, "n", *size, "--plan", tmp_path / "m.json")
    assert again["image_sha256"] == report["image_sha256"] and again["plan"] == report["plan"]


def test_a_plan_spreads_samples_as_well(tmp_path):
    """A plan of 64 samples everywhere is about as good as --spp 64, whose samples lie in sequences
    that were made for 64. They were in pieces of 1, 1, 2, 4, 8, 16 once: 2.2 times the error."""
    size = ("--size", "64x48")
    by_number, _ = render(tmp_path, "k", *size, "--spp", 64)
    plan = {"square": 16, "column": 0, "row": 0, "columns": 4, "rows": 3, "max_spp": 65536,
            "pilot": "dropped", "spp": [64] * 12}
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    by_plan, _ = render(tmp_path, "l", *size, "--plan", tmp_path / "plan.json")
    assert by_plan["error"]["relmse"] < 1.4 * by_number["error"]["relmse"]


def test_max_spp_stops(tmp_path):
    report, _ = render(tmp_path, "e", "--size", "48x32", "--target-error", 1e-9, "--max-spp", 40)
    assert report["stopped_by"] == "max-spp"
    assert report["spp_max"] == 40 and report["spp_min"] == 40
    done = tilery("render", SCENE, "-o", tmp_path / "f.exr", "--size", "48x32", "--target-error",
                  1e-9, "--max-spp", 12, timeout=120)
    assert done.returncode == 0 and "by --max-spp 12" in done.stderr


def test_time_limit(tmp_path):
    """Ends when it was asked to (the bound is wide: machines are busy), and can be repeated."""
    began = time.monotonic()
    report, _ = render(tmp_path, "g", "--size", "160x96", "--time-limit", 4)
    assert report["stopped_by"] == "time"
    assert 2 < report["seconds"]["total"] < 4 + 6 * SLOW
    assert time.monotonic() - began < 20 + 20 * SLOW
    again, _ = render(tmp_path, "h", "--size", "160x96", "--plan", tmp_path / "g.json")
    assert again["image_sha256"] == report["image_sha256"]


def test_killed_worker_and_master(golden, tmp_path):
    """Killed in the pilot, between stages and later: the plan and the picture are the same."""
    _, report, _ = golden
    with Farm(tmp_path) as farm:
        for _ in range(2):
            farm.worker()
        job = farm.submit(SCENE, *WORK)
        for share in (0.0, 0.1, 0.3, 0.6):
            try:
                farm.wait_progress(job, share)
            except AssertionError:
                assert farm.job(job)["state"] == "done"
                break
            farm.kill_master()
            farm.start_master()
            farm.workers[0].kill()
            farm.workers.pop(0)
            farm.worker()
        after = farm.wait_job(job, timeout=120)
        assert after["image_sha256"] == report["image_sha256"]
        assert after["plan"] == report["plan"]
        # What is finished is told after a restart too.
        farm.kill_master()
        farm.start_master()
        later = farm.job(job)
        assert later["plan"] == report["plan"] and later["stopped_by"] == "error"
        assert later["error"] == after["error"]


def test_master_killed_under_a_time_limit(tmp_path):
    with Farm(tmp_path) as farm:
        farm.worker()
        job = farm.submit(SCENE, "--size", "96x64", "--time-limit", 4)
        farm.wait_progress(job, 0.4)
        farm.kill_master()
        farm.start_master()
        report = farm.wait_job(job, timeout=60)
        assert report["stopped_by"] == "time"
        (tmp_path / "plan.json").write_text(json.dumps(report["plan"]))
        again, _ = render(tmp_path, "i", "--size", "96x64", "--plan", tmp_path / "plan.json")
        assert again["image_sha256"] == report["image_sha256"]


def test_an_ordinary_picture_has_no_heavy_tail(tmp_path):
    """Glossy plates under lights: noise sits at the rims of the highlights, and there is enough of
    it. (The rims' darkest pixels once made the effective size 0.)"""
    done = tilery("render", SCENES / "veach.json", "-o", tmp_path / "v.exr", "--size", "192x128",
                  "--spp", 16, "--report", tmp_path / "v.json", timeout=120)
    assert done.returncode == 0 and "heavy tail" not in done.stderr
    error = report_of(tmp_path / "v.json")["error"]
    assert error["heavy_tail"] is False and error["effective_size"] > 40
    assert error["relmse_high"] < 1.4 * error["relmse"]


def test_heavy_tail_is_said(tmp_path):
    """A picture of a few pixels cannot vouch for its error, and says so."""
    done = tilery("render", SEED_SCENE, "-o", tmp_path / "j.exr", "--size", "8x8", "--spp", 8)
    assert done.returncode == 0
    assert "heavy tail: not to be trusted" in done.stderr
    attributes, _ = exr_pixels.read(tmp_path / "j.exr")
    assert attributes["tilery.relmse"][0] == "float"
    assert attributes["tilery.heavyTail"] == ("int", b"\x01\0\0\0")


def relmse_by_hand(value, error, samples):
    """docs/ERROR.md's formula for a grey picture whose halves have the same number of samples: they
    are value +- error, and there are so many samples."""
    height, width = value.shape
    variance, product = error ** 2, value ** 2 - error ** 2
    floor = 0.01 * value.mean() ** 2
    darker = numpy.abs(value) - error
    level = value ** 2 + 0.15 * variance
    for y, x in numpy.argwhere(variance > 0.1 * value ** 2):
        window = numpy.s_[max(y - 2, 0):y + 3, max(x - 2, 0):x + 3]
        own = level[y, x] + floor
        high = min(own, max(product[window].mean(), 0) + floor)
        values = numpy.sort(value[window], axis=None)
        median = values[len(values) // 2]
        low = max(value[y, x] - error[y, x], median) ** 2
        low = min(max(low, product[y, x]) + floor, high)
        chance = min(max((median ** 2 + floor) / own, 1), 2) ** 0.6
        hit, brightest = error[y, x] * samples, max(darker[window].max(), 0)
        slope = 0.8 if hit < 16 * brightest else 1.6
        unseen = 1 + slope * math.log(high / low) if high > 3 * low else 1
        rare = 1.2 if hit < 2 * brightest else 1.65 if hit < 16 * brightest else 1.4
        brighter = value + error
        if (brighter[window] >= brighter[y, x] / 2).mean() >= 0.5:
            rare = 1.05
        level[y, x] = high * chance / unseen / rare - floor
    return (variance / (level + floor)).sum() / (height * width)


def test_the_error_is_one_wherever_it_is_told(tmp_path):
    """The picture with its AOV, the file's attributes, the status, a report that is asked for and
    one that a render writes: the same numbers of one job. (The page: tests/web/test_web.py.)"""
    options = ("--size", "72x40", "--spp", 16, "--integrator", "ao", "--aov", "error")
    path = tmp_path / "r.exr"
    done = tilery("render", SCENES / "cbox.json", "-o", path, "--report", tmp_path / "r.json",
                  "--quiet", *options, timeout=120)
    assert done.returncode == 0, done.stderr
    report = report_of(tmp_path / "r.json")
    with Farm(tmp_path) as farm:
        farm.worker()
        job = farm.submit(SCENES / "cbox.json", *options)
        assert farm.wait_job(job)["image_sha256"] == report["image_sha256"]
        status = farm.job(job)["error"]
        assert farm.cli("get", job, "-o", tmp_path / "got.exr").returncode == 0
        said = json.loads(farm.cli("status", job, "--json").stdout)
    assert status == report["error"] and said["error"] == status
    for file in (path, tmp_path / "got.exr"):
        attributes, planes = exr_pixels.read(file)
        for name, value in (("relmse", status["relmse"]), ("relmseLow", status["relmse_low"]),
                            ("relmseHigh", status["relmse_high"]), ("meanLow", status["mean_low"]),
                            ("meanHigh", status["mean_high"]),
                            ("effectiveSize", status["effective_size"])):
            told = struct.unpack("<f", attributes[f"tilery.{name}"][1])[0]
            assert told == pytest.approx(value, rel=1e-6), name
        assert attributes["tilery.heavyTail"][1] == struct.pack("<i", status["heavy_tail"])
        assert (planes["R"] == planes["G"]).all() and (planes["R"] == planes["B"]).all()
        by_hand = relmse_by_hand(planes["R"].astype(float), planes["error"].astype(float), 16)
        assert by_hand == pytest.approx(status["relmse"], rel=1e-3)


@pytest.mark.parametrize("option", [("--spp", 64), ("--target-error", 0.01), ("--time-limit", 20)])
def test_explain_predicts(option):
    """A pilot says how long and how good, within its interval and sanely."""
    done = tilery("explain", SCENE, "--size", "48x32", *option, "--json", timeout=120)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)["predicted"]
    assert 0 < said["seconds_low"] < said["seconds"] < said["seconds_high"]
    assert 0 < said["relmse_low"] < said["relmse"] < said["relmse_high"]
    assert 0 < said["core_seconds_low"] < said["core_seconds"] < said["core_seconds_high"]
    assert set(said) == {"heavy_tail", "spp_mean", *(
        f"{what}{which}" for what in ("seconds", "core_seconds", "relmse")
        for which in ("", "_low", "_high"))}
    if option[0] == "--spp":
        assert said["spp_mean"] == 64
    elif option[0] == "--time-limit":
        assert 19 < said["seconds"] <= 20
    else:
        assert said["relmse"] <= 0.01
    text = tilery("explain", SCENE, "--size", "48x32", *option, timeout=120)
    assert text.returncode == 0 and "cost " in text.stdout and "80 %" in text.stdout


BAD = {
    "zero": (("--target-error", "0"), "over 0"),
    "word": (("--target-error", "small"), "number"),
    "negative": (("--time-limit", "-1"), "number"),
    "both": (("--target-error", "1", "--time-limit", "3"), "do not go together"),
    "spp": (("--spp", "8", "--time-limit", "3"), "do not go together"),
    "max alone": (("--max-spp", "64"), "--target-error"),
    "max small": (("--target-error", "1", "--max-spp", "3"), "from 4"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_values(tmp_path, name):
    options, said = BAD[name]
    done = tilery("render", SCENE, "-o", tmp_path / "x.exr", *options)
    assert done.returncode == 2 and said in done.stderr, done.stderr


def test_bad_plans(golden, tmp_path):
    """A plan that is none is bad input; one of another picture is wrong usage."""
    folder, report, _ = golden
    plan = tmp_path / "plan.json"
    for text, status, said in (("{", 3, "json-syntax"), ("{}", 3, "missing"),
                               (json.dumps({"job": "j1", "plan": None}), 3, "plan"),
                               (json.dumps({**report["plan"], "pilot": "lost"}), 3, "pilot"),
                               (json.dumps({**report["plan"], "spp": [7] * 15}), 2, "bad-plan")):
        plan.write_text(text)
        done = tilery("render", SCENE, "-o", tmp_path / "x.exr", "--size", "80x48", "--plan", plan)
        assert done.returncode == status and said in done.stderr, (text[:80], done.stderr)
    done = tilery("render", SCENE, "-o", tmp_path / "x.exr", "--size", "200x48", "--plan",
                  folder / "a.json", env=clean_env())
    assert done.returncode == 2 and "square at pixel" in done.stderr
    done = tilery("render", SCENE, "-o", tmp_path / "x.exr", "--plan", tmp_path / "none.json")
    assert done.returncode == 3 and "none.json" in done.stderr
