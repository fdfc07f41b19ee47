"""Killing anything at any moment: the same picture, and nothing acknowledged is rendered again."""
import json
import os
import pathlib
import random
import signal
import subprocess
import time

import pytest

import exr_pixels
from farm import (BIN, GLASS_SCENE, SEED_SCENE, SLOW, Farm, alive, children_of, clean_env, interrupt,
                  name_of, report_of, samples, start_tilery, tilery, wait_until)

# A few seconds on two workers of one thread.
WORK = ("--size", "128x128", "--spp", samples(256))


@pytest.fixture(scope="module")
def golden(tmp_path_factory):
    """The hash of WORK from an undisturbed render."""
    folder = tmp_path_factory.mktemp("golden")
    done = tilery("render", GLASS_SCENE, "-o", folder / "a.exr", "--report", folder / "a.json",
                  *WORK, timeout=120)
    assert done.returncode == 0, done.stderr
    return report_of(folder / "a.json")


def test_one_worker_of_three_killed(tmp_path, golden):
    with Farm(tmp_path) as farm:
        workers = [farm.worker() for _ in range(3)]
        job = farm.submit(GLASS_SCENE, *WORK)
        farm.wait_progress(job, 0.1)
        workers[1].kill()
        report = farm.wait_job(job, timeout=120)
        assert report["image_sha256"] == golden["image_sha256"]
        assert report["units"]["retried"] > 0, "the killed worker held nothing: no test"
        assert any("lost" in event["text"] for event in report["events"])
        # The master keeps what was done: at most the leases of one worker are repeated.
        assert report["samples"] == golden["samples"]


def test_worker_stopped_and_continued(tmp_path, golden):
    """SIGSTOP: silent but connected. Its leases go to others; late results change nothing."""
    with Farm(tmp_path) as farm:
        stopped, _ = farm.worker(), farm.worker()
        job = farm.submit(GLASS_SCENE, *WORK)
        farm.wait_progress(job, 0.1)
        stopped.signal(signal.SIGSTOP)
        try:
            report = farm.wait_job(job, timeout=120)
        finally:
            stopped.signal(signal.SIGCONT)
        assert report["image_sha256"] == golden["image_sha256"]


def test_worker_joins_in_mid_render(tmp_path, golden):
    """A worker that comes late gets work at once."""
    with Farm(tmp_path) as farm:
        farm.worker(name="early")
        job = farm.submit(GLASS_SCENE, *WORK)
        farm.wait_progress(job, 0.05)
        late = farm.worker(name="late")
        def helped():
            rows = farm.request("GET", "/api/v1/workers")[1]["items"]
            return any(row["id"] == late.id and row["units"] > 0 for row in rows)
        wait_until(helped, "the late worker's first unit", 10)
        report = farm.wait_job(job, timeout=120)
        assert report["image_sha256"] == golden["image_sha256"]
        assert report["workers"] == 2


def test_master_killed_and_restarted(tmp_path, golden):
    """Workers return by themselves; work that was acknowledged is not rendered again."""
    with Farm(tmp_path) as farm:
        for _ in range(2):
            farm.worker()
        job = farm.submit(GLASS_SCENE, *WORK)
        before = farm.wait_progress(job, 0.3)
        farm.kill_master()
        time.sleep(0.3)
        farm.start_master()
        after = farm.job(job)
        assert after["state"] in ("queued", "rendering")
        assert after["samples"] >= before["samples"], "acknowledged work was lost"
        report = farm.wait_job(job, timeout=120)
        assert report["image_sha256"] == golden["image_sha256"]
        # Every sample is counted once in the film, whatever was interrupted.
        assert report["samples"] == golden["samples"]


def test_workers_return_within_a_second(tmp_path):
    with Farm(tmp_path) as farm:
        workers = [farm.worker() for _ in range(2)]
        farm.kill_master()
        time.sleep(1.5)
        farm.start_master()
        start = time.monotonic()
        def back():
            return farm.request("GET", "/api/v1/farm")[1]["workers"] == len(workers)
        wait_until(back, "both workers to return", 5)
        # The promise is 1 s; the rest is for a machine that does other things as well.
        assert time.monotonic() - start < 3 * SLOW


def test_master_killed_again_and_again(tmp_path, golden):
    """Random moments from a printed seed; the job always ends with the same picture."""
    seed = random.randrange(1 << 32)
    print(f"seed {seed}")
    moments = random.Random(seed)
    with Farm(tmp_path) as farm:
        for _ in range(2):
            farm.worker()
        job = farm.submit(GLASS_SCENE, *WORK)
        for _ in range(4):
            time.sleep(moments.uniform(0.05, 0.8))
            farm.kill_master()
            farm.start_master()
        report = farm.wait_job(job, timeout=180)
        assert report["image_sha256"] == golden["image_sha256"], f"seed {seed}"
        assert report["samples"] == golden["samples"]


def test_everything_killed(tmp_path, golden):
    """Master and workers at once, as by a power cut; all are started anew."""
    with Farm(tmp_path) as farm:
        old = [farm.worker() for _ in range(2)]
        job = farm.submit(GLASS_SCENE, *WORK)
        before = farm.wait_progress(job, 0.3)
        for process in (*old, farm.master):
            process.signal(signal.SIGKILL)
        for process in (*old, farm.master):
            process.kill()
        farm.start_master()
        assert farm.job(job)["samples"] >= before["samples"]
        farm.worker()
        farm.worker()
        report = farm.wait_job(job, timeout=120)
        assert report["image_sha256"] == golden["image_sha256"]


def test_finished_job_survives_a_kill(tmp_path):
    with Farm(tmp_path) as farm:
        farm.worker()
        job = farm.submit(SEED_SCENE, "--size", "32x32", "--spp", "2")
        report = farm.wait_job(job)
        farm.kill_master()
        farm.start_master()
        assert farm.job(job)["image_sha256"] == report["image_sha256"]
        assert farm.cli("get", job, "-o", tmp_path / "a.exr").returncode == 0
        assert exr_pixels.sha256(tmp_path / "a.exr") == report["image_sha256"]


def test_watch_outlives_the_master(tmp_path):
    """A watcher says that the master is silent, and goes on when it is back."""
    with Farm(tmp_path) as farm:
        farm.worker()
        farm.worker()
        job = farm.submit(GLASS_SCENE, *WORK)
        watcher = farm.start_cli("watch", job)
        farm.wait_progress(job, 0.1)
        farm.kill_master()
        time.sleep(2.5)
        farm.start_master()
        _, err = watcher.communicate(timeout=180)
        assert watcher.returncode == 0, err
        assert "no answer from the master" in err and "done in" in err


# --- The private farm of `render` -----------------------------------------


def start_render(tmp_path, *options):
    process = start_tilery("render", GLASS_SCENE, "-o", tmp_path / "a.exr", "--report",
                           tmp_path / "a.json", *WORK, *options,
                           env=clean_env(TMPDIR=tmp_path))
    def ready():
        assert process.poll() is None, process.stderr.read()
        return [pid for pid in children_of(process.pid) if name_of(pid) == "tilery-worker"]
    workers = wait_until(ready, "the workers to start")
    return process, workers


def wait_first_tenth(process):
    """Reads progress lines until the render is well under way."""
    for line in process.stderr:
        if "%" in line[:5]:
            return
    raise AssertionError("the render ended before it began")


def child_named(process, name):
    return [pid for pid in children_of(process.pid) if name_of(pid) == name]


def test_render_survives_a_killed_worker(tmp_path, golden):
    process, _ = start_render(tmp_path, "--workers", 3, "--threads", 1)
    wait_first_tenth(process)
    os.kill(child_named(process, "tilery-worker")[0], signal.SIGKILL)
    _, err = process.communicate(timeout=180)
    assert process.returncode == 0, err
    assert "was killed by signal 9" in err and "started again" in err
    assert report_of(tmp_path / "a.json")["image_sha256"] == golden["image_sha256"]


def test_killed_worker_is_told_to_programs(tmp_path):
    """render --json: who joined, and what the one that was lost gave back."""
    process = start_tilery("render", GLASS_SCENE, "-o", tmp_path / "a.exr", *WORK, "--json",
                           "--workers", 2, "--threads", 1)
    workers = wait_until(lambda: [pid for pid in children_of(process.pid)
                                  if name_of(pid) == "tilery-worker"], "the workers")
    time.sleep(0.7)
    os.kill(workers[0], signal.SIGKILL)
    out, err = process.communicate(timeout=120 * SLOW)
    assert process.returncode == 0, err
    events = [event for event in map(json.loads, out.splitlines()) if event["event"] == "worker"]
    lost = [event for event in events if event["state"] == "lost"]
    assert len(lost) == 1 and set(lost[0]) == {"event", "t", "id", "state", "units_returned"}
    assert lost[0]["id"][0] == "w" and lost[0]["units_returned"] >= 0


def test_render_survives_a_killed_master(tmp_path, golden):
    process, _ = start_render(tmp_path)
    wait_first_tenth(process)
    os.kill(child_named(process, "tilery-master")[0], signal.SIGKILL)
    _, err = process.communicate(timeout=180)
    assert process.returncode == 0, err
    assert report_of(tmp_path / "a.json")["image_sha256"] == golden["image_sha256"]


def test_render_gives_up_on_workers_that_always_die(tmp_path):
    """Restarts are bounded: then exit 5, the cause named, nothing at OUT."""
    process, _ = start_render(tmp_path, "--workers", 1)
    end = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < end:
        for pid in child_named(process, "tilery-worker"):
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        time.sleep(0.05)
    _, err = process.communicate(timeout=10)
    assert process.returncode == 5, err
    assert "killed by signal 9" in err and not (tmp_path / "a.exr").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_render_interrupted(tmp_path, number):
    """Once is enough: 130 within 2 s, nothing at OUT, no process and no folder left."""
    process, _ = start_render(tmp_path)
    time.sleep(0.5)
    children = children_of(process.pid)
    start = time.monotonic()
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    took = time.monotonic() - start
    assert process.returncode == 130, err
    assert "stopping 2 workers (again to kill)" in err
    assert took < 2.5 * SLOW, took
    assert not any(alive(pid) for pid in children)
    assert sorted(p.name for p in tmp_path.iterdir()) == []


def test_render_interrupted_twice(tmp_path):
    """The second Ctrl-C kills even children that do not listen."""
    process, workers = start_render(tmp_path)
    time.sleep(0.3)
    for pid in workers:
        os.kill(pid, signal.SIGSTOP)
    start = time.monotonic()
    interrupt(process)
    time.sleep(0.1)
    interrupt(process)
    process.communicate(timeout=30)
    assert process.returncode == 130
    assert time.monotonic() - start < 1.5 * SLOW
    assert not any(alive(pid) for pid in workers)
    assert list(tmp_path.iterdir()) == []


def test_interrupt_at_any_moment(tmp_path):
    """Also while everything starts: never half a picture, never a process left."""
    seed = random.randrange(1 << 32)
    print(f"seed {seed}")
    moments = random.Random(seed)
    for _ in range(12):
        process = start_tilery("render", GLASS_SCENE, "-o", tmp_path / "a.exr", *WORK,
                               env=clean_env(TMPDIR=tmp_path))
        time.sleep(moments.uniform(0.01, 0.4))
        children = children_of(process.pid)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
        # Before the handlers stand, the signal ends the program itself.
        assert process.returncode in (130, -signal.SIGINT), (seed, err)
        wait_until(lambda c=children: not any(alive(pid) for pid in c), "the children to end", 3)
        assert not (tmp_path / "a.exr").exists(), seed


# --- Standard files ---------------------------------------------------------


def run_shell(line, **kwargs):
    """A line of bash with the programs in its path."""
    env = clean_env(PATH=f"{BIN}:{os.environ['PATH']}")
    return subprocess.run(["bash", "-c", line], env=env, capture_output=True, text=True,
                          timeout=60 * SLOW, check=False, **kwargs)


def test_daemons_without_standard_files(tmp_path):
    """`tilery-master <&- 2>&-` aborted at its end: an event loop had the number of standard error,
    which libuv does not close; what was logged went into a pipe between its threads."""
    script = """
        cd "$1"
        tilery-master --listen 127.0.0.1:0 --http 127.0.0.1:0 --data data <&- 2>&- >said &
        master=$!
        until [ -s said ]; do sleep 0.02; done
        listen=$(sed 's/.*"listen": "\\([^"]*\\).*/\\1/' said)
        export TILERY_MASTER=http://$(sed 's/.*"http": "\\([^"]*\\).*/\\1/' said)
        tilery-worker --master "$listen" --threads 1 <&- >&- 2>&- &
        worker=$!
        tilery submit "$2" --spp 2 --size 32x32 --wait -o out.exr <&- 2>&- >job
        echo "submit $?"
        for fd in 0 1 2; do readlink /proc/$master/fd/$fd /proc/$worker/fd/$fd; done
        kill $worker; wait $worker; echo "worker $?"
        kill $master; wait $master; echo "master $?"
    """
    done = subprocess.run(["bash", "-c", script, "-", str(tmp_path), str(SEED_SCENE)],
                          env=clean_env(PATH=f"{BIN}:{os.environ['PATH']}"), capture_output=True,
                          text=True, timeout=60 * SLOW, check=False)
    null = "/dev/null\n"
    assert done.stdout == (f"submit 0\n{null * 2}{tmp_path}/said\n{null * 3}"
                           "worker 0\nmaster 0\n"), done.stderr
    assert (tmp_path / "out.exr").exists()


@pytest.mark.parametrize("words", ["--help", "help render", "explain two.json",
                                   "render two.json -o a.exr --json --size 8x8 --spp 1"])
def test_standard_output_full(tmp_path, words):
    """What was asked for could not be written: 5. --help and the last line of --json said 0."""
    write_small_scene(tmp_path / "two.json")
    done = run_shell(f"tilery {words} >/dev/full", cwd=tmp_path)
    assert done.returncode == 5, done.stderr
    assert "cannot write to standard output: No space left on device" in done.stderr


def write_small_scene(path):
    """Balls alone, so that no other file is read."""
    path.write_text(json.dumps({
        "integrator": {}, "film": {}, "camera": {"position": [0, 0, 5]},
        "materials": {"m": {"type": "diffuse", "color": 0.5}},
        "objects": [{"type": "sphere", "center": [0, 0, 0], "material_name": "m"},
                    {"type": "sphere", "center": [0, 5, 0], "light": {"type": "area"}}]}))


def test_file_size_limit(tmp_path):
    """A limit of the size of files ended the program by a signal (SIGXFSZ), without a word."""
    write_small_scene(tmp_path / "two.json")
    done = run_shell("ulimit -f 0; tilery render two.json -o a.exr --size 8x8 --spp 1",
                     cwd=tmp_path)
    assert done.returncode == 5, (done.returncode, done.stderr)
    assert "ile too large" in done.stderr or "disk full" in done.stderr
    assert not (tmp_path / "a.exr").exists()


# --- Disks -----------------------------------------------------------------


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 256 kB, where we may make one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0 or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)],
            capture_output=True, check=False).returncode != 0:
        pytest.skip("mounting a small tmpfs needs root")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_disk_full_is_known_before(tmp_path, small_disk):
    """A picture that cannot fit is refused before the render, with the numbers."""
    out = small_disk / "out.exr"
    out.write_text("precious")
    start = time.monotonic()
    done = tilery("render", GLASS_SCENE, "-o", out, "--size", "512x512", "--spp", "4096",
                  env=clean_env(TMPDIR=tmp_path))
    assert done.returncode == 5, done.stderr
    assert "disk full" in done.stderr and "MB free" in done.stderr
    assert time.monotonic() - start < 10 * SLOW
    assert out.read_text() == "precious"


def test_disk_full_at_the_end(tmp_path, small_disk):
    """The disk fills up meanwhile: exit 5, OUT as it was, the picture kept elsewhere."""
    out = small_disk / "out.exr"
    out.write_text("precious")
    process = start_tilery("render", GLASS_SCENE, "-o", out, "--size", "100x100", "--spp", "64",
                           env=clean_env(TMPDIR=tmp_path))
    wait_until(lambda: children_of(process.pid), "the farm")
    time.sleep(0.3)
    with open(small_disk / "filler", "wb") as filler:
        try:
            filler.write(bytes(1 << 20))
        except OSError:
            pass
    _, err = process.communicate(timeout=120)
    assert process.returncode == 5, err
    assert "disk full" in err and "nothing lost" in err
    assert out.read_text() == "precious"
    assert [p.name for p in small_disk.iterdir() if ".part" in p.name] == []
    saved = next(tmp_path.glob("tilery-saved-*.exr"))
    assert exr_pixels.rgb(saved).shape == (100, 100, 3)


@pytest.mark.parametrize("options", [(), ("--quiet",)], ids=["talking", "quiet"])
def test_private_disk_full(tmp_path, small_disk, options):
    """The farm's own folder fills up: the end, not a wait for someone who makes room."""
    out = tmp_path / "out.exr"
    out.write_text("precious")
    process = start_tilery("render", GLASS_SCENE, "-o", out, "--size", "512x512", "--spp", "1",
                           *options, env=clean_env(TMPDIR=small_disk))
    children = wait_until(lambda: children_of(process.pid), "the farm")
    try:
        _, err = process.communicate(timeout=30 * SLOW)
    finally:
        process.kill()
    assert process.returncode == 5, err
    assert "disk full" in err, err
    assert not any(alive(pid) for pid in children)
    assert out.read_text() == "precious"
    assert list(small_disk.iterdir()) == []


@pytest.mark.parametrize("free_kb", [12, 48])
def test_private_disk_full_at_the_start(tmp_path, small_disk, free_kb):
    """A master that cannot begin: what it said of it, not its good-bye; or the disk itself."""
    (small_disk / "filler").write_bytes(bytes((256 - free_kb) << 10))
    done = tilery("render", GLASS_SCENE, "-o", tmp_path / "out.exr", "--spp", "1",
                  env=clean_env(TMPDIR=small_disk))
    assert done.returncode == 5, done.stderr
    assert "disk full" in done.stderr and "stopping" not in done.stderr, done.stderr
    assert [p.name for p in small_disk.iterdir()] == ["filler"]


def test_picture_larger_than_memory(tmp_path):
    done = tilery("render", GLASS_SCENE, "-o", tmp_path / "a.exr", "--size", "65535x65535",
                  "--spp", "1", timeout=30)
    assert done.returncode == 5, done.stderr
    assert "out of memory" in done.stderr and "206.2 GB" in done.stderr
    assert list(tmp_path.glob("a.exr*")) == []


def test_get_to_a_full_disk(tmp_path, small_disk):
    with Farm(tmp_path) as farm:
        farm.worker()
        job = farm.submit(GLASS_SCENE, "--size", "200x200", "--spp", "2")
        farm.wait_job(job)
        (small_disk / "filler").write_bytes(bytes(128 << 10))
        done = farm.cli("get", job, "-o", small_disk / "a.exr")
        assert done.returncode == 5 and "disk full" in done.stderr, done.stderr
        assert [p.name for p in small_disk.iterdir()] == ["filler"]
        assert farm.cli("get", job, "-o", tmp_path / "a.exr").returncode == 0


def test_unwritable_places(tmp_path):
    """No folder, a folder itself, a device: known before anything is started."""
    for out, words in ((tmp_path / "none" / "a.exr", "no such folder"),
                       (pathlib.Path("/proc/a.exr"), "cannot write")):
        done = tilery("render", GLASS_SCENE, "-o", out)
        assert done.returncode == 5 and words in done.stderr, done.stderr
    (tmp_path / "folder.exr").mkdir()
    done = tilery("render", GLASS_SCENE, "-o", tmp_path / "folder.exr")
    assert done.returncode == 5 and "directory" in done.stderr
