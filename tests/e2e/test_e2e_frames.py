"""Shots: one job a frame, tied together; in order, whole or not at all, each frame a job like any."""
import json

import pytest

from farm import SCENES, Farm, report_of, tilery

SIZE = ("--spp", 2, "--size", "48x48")


@pytest.fixture(name="shot")
def make_shot(tmp_path):
    """Five scenes, the light a little further in each."""
    scene = json.loads((SCENES / "cbox_no_light.json").read_text())
    for item in scene["objects"]:
        if "path" in item:
            item["path"] = str((SCENES / item["path"]).resolve())
    for frame in range(1, 6):
        scene["integrator"]["point_light_position"] = [0, 1.5, 0.1 * frame]
        (tmp_path / f"shot.{frame:04}.json").write_text(json.dumps(scene))
    return tmp_path / "shot.####.json"


@pytest.fixture(name="farm")
def make_farm(tmp_path):
    (tmp_path / "farm").mkdir()
    with Farm(tmp_path / "farm") as farm:
        yield farm


def frames(farm, shot):
    status, reply = farm.request("GET", f"/api/v1/jobs/{shot}/frames")
    assert status == 200, reply
    return reply["items"]


def test_every_frame_is_the_picture_of_its_scene(farm, shot, tmp_path):
    farm.worker()
    done = farm.cli("submit", shot, *SIZE, "--frames", "1-5", "--wait", "-o",
                    tmp_path / "out.####.exr", "--report", tmp_path / "r.#.json")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "j1\n"
    rows = farm.cli("jobs").stdout.splitlines()[1:]
    assert [f"#{frame}" in row for frame, row in zip(range(5, 0, -1), rows)] == [True] * 5, rows
    seen = set()
    for frame in range(1, 6):
        alone = tmp_path / "alone.json"
        here = tilery("render", tmp_path / f"shot.{frame:04}.json", *SIZE, "-o",
                      tmp_path / "alone.exr", "--report", alone)
        assert here.returncode == 0, here.stderr
        report = report_of(tmp_path / f"r.{frame}.json")
        assert report["image_sha256"] == report_of(alone)["image_sha256"]
        assert report["shot"] == "j1" and report["frame"] == frame
        same = tilery("compare", tmp_path / f"out.{frame:04}.exr", tmp_path / "alone.exr",
                      "--identical")
        assert same.returncode == 0, same.stdout
        seen.add(report["image_sha256"])
    assert len(seen) == 5
    # Meshes that frames share were sent once.
    assert report_of(tmp_path / "r.5.json")["bytes"]["scene_sent"] < \
        report_of(tmp_path / "r.1.json")["bytes"]["scene_sent"]


def test_order_and_restart(farm, shot):
    """Two at once, first ones first; numbers and ties survive a kill of the master."""
    job = farm.submit(shot, "--spp", 4, "--size", "128x128", "--frames", "1-5", "--name", "walk")
    items = frames(farm, job)
    assert [i["frame"] for i in items] == [1, 2, 3, 4, 5]
    assert {i["shot"] for i in items} == {job}
    assert [i["note"] for i in items[2:]] == ["waits for frames before it"] * 3
    farm.kill_master()
    farm.start_master()
    assert [(i["frame"], i["shot"]) for i in frames(farm, job)] == [(n, job) for n in range(1, 6)]
    farm.worker()
    watched = farm.cli("watch", job, "--progress", "none")
    assert watched.returncode == 0, watched.stderr
    reports = [farm.job(i["id"]) for i in frames(farm, job)]
    assert [r["state"] for r in reports] == ["done"] * 5
    assert [r["started"] for r in reports] == sorted(r["started"] for r in reports)
    assert farm.job(job)["frames"]["done"] == farm.job(job)["frames"]["total"] == 5
    assert "frames   5: 5 done" in farm.cli("status", job).stdout


def test_changes_to_all_and_to_one(farm, shot, tmp_path):
    job = farm.submit(shot, *SIZE, "--frames", "1-5")
    paused = farm.cli("pause", job, "--frame", 2)
    assert paused.returncode == 0 and "frame 2" in paused.stderr
    assert [i["state"] for i in frames(farm, job)].count("paused") == 1
    said = farm.cli("cancel", job)
    assert said.returncode == 0 and "5 of 5 frames" in said.stderr
    assert farm.cli("cancel", job).returncode == 1
    assert farm.cli("resume", job).returncode == 1  # none is paused
    said = farm.cli("retry", job)
    assert said.returncode == 0 and "5 of 5 frames" in said.stderr
    none = farm.cli("get", job, "-o", tmp_path / "x.####.exr")
    assert none.returncode == 1 and "0 of 5" in none.stderr
    farm.worker()
    assert farm.cli("watch", job, "--progress", "none").returncode == 0
    assert farm.cli("get", job, "-o", tmp_path / "one.exr").returncode == 2
    assert farm.cli("get", job, "--frame", 4, "-o", tmp_path / "one.exr").returncode == 0
    got = farm.cli("get", job, "-o", tmp_path / "x.####.exr", "--json")
    assert got.returncode == 0 and got.stderr == ""  # said it for people, and nothing on stdout
    assert [json.loads(line)["file"] for line in got.stdout.splitlines()] == [
        str(tmp_path / f"x.000{n}.exr") for n in range(1, 6)]
    assert (tmp_path / "x.0004.exr").read_bytes() == (tmp_path / "one.exr").read_bytes()
    assert farm.cli("status", job, "--frame", 9).returncode == 4
    assert farm.cli("get", "j99", "--frame", 1, "-o", tmp_path / "n.exr").returncode == 4


def test_a_mistake_in_one_frame_makes_no_job(farm, shot, tmp_path):
    (tmp_path / "shot.0003.json").write_text("{")
    (tmp_path / "shot.0005.json").unlink()
    refused = farm.cli("submit", shot, *SIZE, "--frames", "1-5")
    assert refused.returncode == 3
    assert "shot.0003.json" in refused.stderr and "shot.0005.json" in refused.stderr
    assert refused.stderr.endswith("2 problems, no job made\n")  # was said for each frame
    assert farm.request("GET", "/api/v1/jobs")[1]["items"] == []


def test_shots_are_checked_by_the_master(farm, shot, tmp_path):
    alone = farm.submit(tmp_path / "shot.0001.json", *SIZE)
    job = farm.job(alone)
    body = {"package": job["package"], "spec": job["spec"], "shot": alone, "frame": 2}
    assert farm.request("POST", "/api/v1/jobs", body)[0] == 422  # a picture on its own
    assert farm.request("POST", "/api/v1/jobs", {**body, "shot": "x"})[0] == 422
    del body["frame"]
    assert farm.request("POST", "/api/v1/jobs", body)[0] == 422
    assert job["shot"] is None and "frames" not in job
    assert frames(farm, alone) == []
    assert farm.cli("get", alone, "--frame", 1, "-o", tmp_path / "x.exr").returncode == 4
