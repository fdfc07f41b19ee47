"""Late pictures on real farms: the same bits, fewer bytes, whatever happens while they come."""
import json
import subprocess
import sys
import time

import pytest

from farm import ROOT, Farm, tilery, wait_until
from proxy import Proxy, whole_frames

ROOMS, SIDE = 12, 700  # 12 pictures of 1.47 MB: just over what makes them late


@pytest.fixture(scope="module")
def gallery(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gallery")
    subprocess.run([sys.executable, ROOT / "scenes/make_gallery.py", folder, str(ROOMS), str(SIDE)],
                   check=True)
    return folder


@pytest.fixture
def farm(tmp_path):
    with Farm(tmp_path) as f:
        yield f


OPTIONS = ("--spp", 4, "--size", "96x72")


@pytest.fixture(scope="module")
def eager(gallery, tmp_path_factory):
    """Reports of both scenes from a worker that fetches all at once, by the scene's name."""
    reports = {}
    for name in ("rooms", "wall"):
        with Farm(tmp_path_factory.mktemp(name)) as f:
            f.worker(threads=2, arguments=("--eager",))
            reports[name] = f.wait_job(f.submit(gallery / f"{name}.json", *OPTIONS), timeout=120)
            assert "pictures come when they are met" not in f.workers[0].log()
    return reports


@pytest.mark.parametrize("threads", [(1,), (4,), (2, 1, 1)])
def test_rooms_that_nobody_sees_stay_behind(farm, gallery, eager, threads):
    for count in threads:
        farm.worker(threads=count)
    job = farm.submit(gallery / "rooms.json", *OPTIONS)
    report = farm.wait_job(job, timeout=120)
    assert report["image_sha256"] == eager["rooms"]["image_sha256"]
    assert report["units"]["retried"] == 0, report["units"]
    # Three of twelve pictures, for each worker at most.
    sent = report["bytes"]["scene_sent"]
    assert 0 < sent < 0.3 * eager["rooms"]["bytes"]["scene_sent"] * len(threads), sent
    if len(threads) == 1:
        assert sent > 0.2 * eager["rooms"]["bytes"]["scene_sent"], sent
        farm.workers[0].log().index("late=12 of=12")


def test_a_wall_of_pictures_brings_them_all_once(farm, gallery, eager):
    farm.worker(threads=3)
    report = farm.wait_job(farm.submit(gallery / "wall.json", *OPTIONS), timeout=120)
    assert report["image_sha256"] == eager["wall"]["image_sha256"]
    assert report["bytes"]["scene_sent"] == eager["wall"]["bytes"]["scene_sent"]


def test_explain_tells_of_them(gallery, eager):
    facts = json.loads(tilery("explain", gallery / "rooms.json", "--json").stdout)
    assert facts["late"]["pictures"] == ROOMS
    assert 0.9 * facts["bytes"]["package"] < facts["late"]["sent"] < facts["bytes"]["package"]
    said = tilery("explain", gallery / "rooms.json").stdout
    assert f"{ROOMS} pictures, sent as" in said, said
    said = tilery("explain", ROOT / "scenes/cbox.json").stdout
    assert "are fetched when" not in said, said


def test_jobs_on_one_scene_share_what_came(farm, gallery, eager):
    farm.worker(threads=2)
    jobs = [farm.submit(gallery / "rooms.json", *OPTIONS) for _ in range(3)]
    reports = [farm.wait_job(job, timeout=120) for job in jobs]
    assert {r["image_sha256"] for r in reports} == {eager["rooms"]["image_sha256"]}
    sent = sum(r["bytes"]["scene_sent"] for r in reports)
    assert sent < 0.3 * eager["rooms"]["bytes"]["scene_sent"], sent


def test_a_cache_on_disk_is_asked_first(farm, gallery, eager, tmp_path):
    arguments = ("--cache", tmp_path / "cache")
    first = farm.worker(threads=2, arguments=arguments)
    farm.wait_job(farm.submit(gallery / "wall.json", *OPTIONS), timeout=120)
    first.kill()
    farm.worker(threads=2, arguments=arguments)
    report = farm.wait_job(farm.submit(gallery / "wall.json", *OPTIONS, "--seed", 7), timeout=120)
    assert report["bytes"]["scene_sent"] == 0


# --- While pictures come -----------------------------------------------------------------------


def slow(link, direction, data):
    """400 kB/s from the master: a picture takes seconds."""
    if direction == "up":
        link.pass_on(direction, data)
        return
    for at in range(0, len(data), 8000):
        link.pass_on(direction, data[at:at + 8000])
        time.sleep(0.02)
    link.struck()


def begin_slowly(farm, gallery, proxy, **options):
    """A job whose worker waits for pictures."""
    worker = farm.worker(threads=2, master=proxy.address, arguments=("--log", "debug"))
    job = farm.submit(gallery / "rooms.json", *OPTIONS, *options.get("more", ()))
    wait_until(lambda: "lacks pictures" in worker.log(), "a unit that lacks pictures", 60)
    assert farm.job(job)["state"] in ("queued", "rendering")
    return worker, job


def test_two_threads_ask_once(farm, gallery, eager):
    with Proxy(farm.listen, slow) as proxy:
        worker, job = begin_slowly(farm, gallery, proxy)
        report = farm.wait_job(job, timeout=120)
        assert worker.log().count("lacks pictures") >= 2
    assert report["image_sha256"] == eager["rooms"]["image_sha256"]
    assert report["bytes"]["scene_sent"] < 0.3 * eager["rooms"]["bytes"]["scene_sent"]


def test_worker_killed_while_pictures_come(farm, gallery, eager):
    with Proxy(farm.listen, slow) as proxy:
        worker, job = begin_slowly(farm, gallery, proxy)
        worker.kill()
        farm.worker(threads=2)
        report = farm.wait_job(job, timeout=120)
    assert report["image_sha256"] == eager["rooms"]["image_sha256"]


def test_master_killed_while_pictures_come(farm, gallery, eager):
    with Proxy(farm.listen, slow) as proxy:
        worker, job = begin_slowly(farm, gallery, proxy)
        farm.kill_master()
        time.sleep(0.3)
        farm.start_master()
        report = farm.wait_job(job, timeout=120)
        assert worker.process.poll() is None
    assert report["image_sha256"] == eager["rooms"]["image_sha256"]
    assert report["bytes"]["scene_sent"] < 0.6 * eager["rooms"]["bytes"]["scene_sent"]


def test_job_cancelled_while_pictures_come(farm, gallery, eager):
    """Another job on the same scene still gets them."""
    with Proxy(farm.listen, slow) as proxy:
        worker, job = begin_slowly(farm, gallery, proxy)
        other = farm.submit(gallery / "rooms.json", *OPTIONS)
        assert farm.cli("cancel", job).returncode == 0
        report = farm.wait_job(other, timeout=120)
        assert farm.job(job)["state"] == "cancelled"
        assert worker.process.poll() is None
    assert report["image_sha256"] == eager["rooms"]["image_sha256"]


def test_worker_drained_while_pictures_come(farm, gallery, eager):
    with Proxy(farm.listen, slow) as proxy:
        worker, job = begin_slowly(farm, gallery, proxy)
        assert worker.end(30) == 0
        assert "all delivered" in worker.log()
        farm.worker(threads=2)
        report = farm.wait_job(job, timeout=120)
    assert report["image_sha256"] == eager["rooms"]["image_sha256"]


def test_a_picture_that_nobody_has_fails_the_job(farm, gallery):
    job = farm.submit(gallery / "rooms.json", *OPTIONS)
    large = [f for f in farm.data.glob("chunks/*/*") if f.stat().st_size > 500_000]
    assert len(large) == ROOMS
    farm.kill_master()  # which has them in memory
    for file in large:
        file.unlink()
    farm.start_master()
    worker = farm.worker(threads=2)
    report = farm.wait_job(job, state="failed", timeout=120)
    said = "\n".join(event["text"] for event in report["events"])
    assert "cannot render this job: chunk " in said, said
    assert "the master does not have it" in worker.log()
    assert worker.process.poll() is None


def damage(count):
    """The first `count` pictures come with a byte wrong, in frames that are as good as any."""
    left = [count]

    def fault(link, direction, data):
        if direction == "up":
            link.pass_on(direction, data)
            return
        for name, _, body, whole in whole_frames(link, data):
            if name == "ChunkData" and body > 500_000 and left[0] > 0:
                at = len(whole) - body // 2
                whole = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1:]
                left[0] -= 1
                link.struck()
            link.pass_on(direction, whole)
    return fault


def test_a_damaged_picture_is_asked_for_again(farm, gallery, eager):
    with Proxy(farm.listen, damage(2)) as proxy:
        worker = farm.worker(threads=2, master=proxy.address)
        report = farm.wait_job(farm.submit(gallery / "rooms.json", *OPTIONS), timeout=120)
        assert proxy.injected == 2
        assert worker.process.poll() is None
    assert report["image_sha256"] == eager["rooms"]["image_sha256"]


def test_one_that_always_comes_damaged_fails_the_job(farm, gallery):
    with Proxy(farm.listen, damage(1000)) as proxy:
        worker = farm.worker(threads=2, master=proxy.address)
        job = farm.submit(gallery / "rooms.json", *OPTIONS)
        report = farm.wait_job(job, state="failed", timeout=120)
        assert proxy.injected >= 3
        assert worker.process.poll() is None
    said = "\n".join(event["text"] for event in report["events"])
    assert "came damaged each time" in said, said


def test_memory_for_less_than_the_pictures(farm, gallery, eager):
    """They stay while a unit needs them; scenes that none needs go."""
    worker = farm.worker(threads=2, arguments=("--memory", 4))
    job = farm.submit(gallery / "wall.json", *OPTIONS)
    report = farm.wait_job(job, timeout=120)
    assert report["image_sha256"] == eager["wall"]["image_sha256"]
    report = farm.wait_job(farm.submit(gallery / "rooms.json", *OPTIONS), timeout=120)
    assert report["image_sha256"] == eager["rooms"]["image_sha256"]
    assert "memory is wanted" in worker.log()
