"""Late pictures on real farms: the same bits, fewer bytes, whatever happens while they come."""
import json
import math
import struct
import subprocess
import sys
import time
import zlib

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


def whole_reports(folder, names, tmp_path_factory):
    """Reports of scenes from a worker that fetches all at once, by the scene's name."""
    reports = {}
    for name in names:
        with Farm(tmp_path_factory.mktemp(name)) as f:
            f.worker(threads=2, arguments=("--eager",))
            reports[name] = f.wait_job(f.submit(folder / f"{name}.json", *OPTIONS), timeout=120)
            assert "pictures come when they are met" not in f.workers[0].log()
    return reports


@pytest.fixture(scope="module")
def eager(gallery, tmp_path_factory):
    return whole_reports(gallery, ("rooms", "wall"), tmp_path_factory)


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


# --- One after the other -----------------------------------------------------------------------

MIRRORS, VAIN_MAX = 14, 8  # RUNS_IN_VAIN_MAX of worker/work.c


def tilts():
    """Bytes of red and blue that tilt a normal by some 20 degrees, and by how many radians."""
    best = min(((r, b) for r in range(150, 190) for b in range(230, 256)),
               key=lambda rb: abs(math.atan2(2 * rb[0] - 255, 2 * rb[1] - 255) - math.radians(20)))
    return best, math.atan2(2 * best[0] - 255, 2 * best[1] - 255)


def write_png(path, pixels):
    rows = b"".join(b"\0" + pixels[3 * SIDE * y:3 * SIDE * (y + 1)] for y in range(SIDE))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", SIDE, SIDE, 8, 2, 0, 0, 0)) +
                     chunk(b"IDAT", zlib.compress(rows, 1)) + chunk(b"IEND", b""))


def mirror(at, facing, along, half, name):
    """A square with texture coordinates that grow along an angle in the plane of x and y."""
    g = (math.cos(facing), math.sin(facing), 0)
    t = (math.cos(along), math.sin(along), 0)
    b = (g[1] * t[2] - g[2] * t[1], g[2] * t[0] - g[0] * t[2], g[0] * t[1] - g[1] * t[0])
    signs = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    corners = [[at[k] + half * (i * t[k] + j * b[k]) for k in range(3)] for i, j in signs]
    name.write_text("\n".join(["v %.9g %.9g %.9g" % tuple(c) for c in corners] +
                              ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "f 1/1 2/2 3/3 4/4", ""]))


@pytest.fixture(scope="module")
def stairs(tmp_path_factory):
    """Light that goes up a flight of mirrors, each of which sends it to the next only with its own normal map: without,
    it misses all others. So a path meets one picture more with each that has come."""
    folder = tmp_path_factory.mktemp("stairs")
    (red, blue), tilt = tilts()
    textures, materials, objects, x, y = {}, {}, [], 0, 0
    for i in range(MIRRORS):
        # The mirror that turns +x into +y looks to 135 degrees, the other one to -45; the squares are off by the tilt.
        up = i % 2 == 0
        looks = math.radians(135) + tilt if up else math.radians(-45) - tilt
        along = looks - math.pi / 2 if up else looks + math.pi / 2
        mirror((x, y, 0), looks, along, 0.35, folder / f"m{i}.obj")
        pixels = bytes((red, 127 + i // 2 % 2, blue)) * (SIDE * SIDE - 1) + bytes((red, 128, i))  # each one of a kind
        write_png(folder / f"m{i}.png", pixels)
        textures[f"m{i}"] = {"type": "image", "path": f"m{i}.png", "encoding": "linear"}
        materials[f"m{i}"] = {"type": "principled", "metallic": 1, "roughness": 0, "normal_texture": f"m{i}"}
        objects.append({"type": "mesh", "path": f"m{i}.obj", "material_name": f"m{i}"})
        x, y = (x, y + 1) if up else (x + 1, y)
    objects.append({"type": "sphere", "center": [x + 2, y, 0], "radius": 1.5,
                    "light": {"type": "area", "radiance": [5, 4, 3]}})
    scene = folder / "stairs.json"
    scene.write_text(json.dumps({
        "integrator": {"type": "path", "spp": 4, "max_depth": MIRRORS + 4}, "film": {"resolution": [32, 24]},
        "camera": {"position": [-2, 0, 0], "look_at": [0, 0, 0], "ref_up": [0, 0, 1], "fov": 0.5},
        "textures": textures, "materials": materials, "objects": objects}))
    return scene


def render_stairs(folder, scene, *arguments):
    with Farm(folder) as f:
        worker = f.worker(threads=1, arguments=("--log", "debug", *arguments))
        return f.wait_job(f.submit(scene), timeout=120), worker.log()


def test_units_that_run_in_vain_too_often_fetch_all(stairs, tmp_path_factory):
    """One picture a run would be fourteen runs."""
    whole, _ = render_stairs(tmp_path_factory.mktemp("eager"), stairs, "--eager")
    report, log = render_stairs(tmp_path_factory.mktemp("late"), stairs)
    runs = [int(word.split("=")[1]) for word in log.split() if word.startswith("runs=")]
    assert f"late={MIRRORS} of={MIRRORS}" in log
    assert max(runs) == VAIN_MAX and set(runs) == set(range(1, VAIN_MAX + 1)), runs
    assert report["image_sha256"] == whole["image_sha256"]
    assert report["bytes"]["scene_sent"] == whole["bytes"]["scene_sent"]
    assert report["units"]["retried"] == 0


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


# --- Pictures in pieces ------------------------------------------------------------------------

LARGE = 2048  # sixteen pieces of 512 x 512 texels


@pytest.fixture(scope="module")
def floor(tmp_path_factory):
    folder = tmp_path_factory.mktemp("floor")
    subprocess.run([sys.executable, ROOT / "scenes/make_floor.py", folder, str(LARGE)], check=True)
    return folder


@pytest.fixture(scope="module")
def floor_whole(floor, tmp_path_factory):
    return whole_reports(floor, ("floor", "wall"), tmp_path_factory)


def test_pieces_that_nobody_sees_stay_behind(farm, floor, floor_whole):
    worker = farm.worker(threads=3)
    for name, most in (("wall", 0.05), ("floor", 0.8)):
        report = farm.wait_job(farm.submit(floor / f"{name}.json", *OPTIONS), timeout=120)
        assert report["image_sha256"] == floor_whole[name]["image_sha256"]
        whole = floor_whole[name]["bytes"]["scene_sent"]
        assert 0 < report["bytes"]["scene_sent"] < most * whole, (name, report["bytes"], whole)
        assert report["units"]["retried"] == 0
    assert "late=1 of=1" in worker.log()
    report = farm.wait_job(farm.submit(floor / "floor.json", *OPTIONS, "--seed", 9), timeout=120)
    assert report["bytes"]["scene_sent"] < 0.1 * floor_whole["floor"]["bytes"]["scene_sent"]


def test_explain_lists_pieces(floor):
    facts = json.loads(tilery("explain", floor / "floor.json", "--json").stdout)
    kinds = [chunk["kind"] for chunk in facts["chunks"]]
    assert kinds.count("piece") == (LARGE // 512) ** 2 and kinds.count("base") == 1
    pictures = sum(chunk["sent"] for chunk in facts["chunks"] if chunk["kind"] in ("piece", "base"))
    assert facts["late"] == {"pictures": 1, "sent": pictures}


def test_damaged_pieces_are_asked_for_again(farm, floor, floor_whole):
    with Proxy(farm.listen, damage(2)) as proxy:
        farm.worker(threads=2, master=proxy.address)
        report = farm.wait_job(farm.submit(floor / "floor.json", *OPTIONS), timeout=120)
        assert proxy.injected == 2
    assert report["image_sha256"] == floor_whole["floor"]["image_sha256"]


def test_master_killed_while_pieces_come(farm, floor, floor_whole):
    with Proxy(farm.listen, slow) as proxy:
        worker = farm.worker(threads=2, master=proxy.address, arguments=("--log", "debug"))
        job = farm.submit(floor / "floor.json", *OPTIONS)
        wait_until(lambda: "lacks pictures" in worker.log(), "a unit that lacks pieces", 60)
        farm.kill_master()
        time.sleep(0.3)
        farm.start_master()
        report = farm.wait_job(job, timeout=120)
        assert worker.process.poll() is None
    assert report["image_sha256"] == floor_whole["floor"]["image_sha256"]
