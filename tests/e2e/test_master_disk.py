"""A master whose disk is full, slow to answer, or damaged: it says so, loses nothing, goes on."""
import os
import subprocess

import pytest

from farm import Daemon, Farm, GLASS_SCENE, SEED_SCENE, SLOW, clean_env, wait_until


@pytest.fixture
def disk(tmp_path):
    """A file system of 24 MB, where we may make one; `disk.resize(mb)`."""
    folder = tmp_path / "master"
    folder.mkdir()
    if os.geteuid() != 0 or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)],
            capture_output=True, check=False).returncode != 0:
        pytest.skip("mounting a small tmpfs needs root")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(folder, leave):
    """Fills the file system until about `leave` bytes are free."""
    status = os.statvfs(folder)
    size = status.f_bavail * status.f_frsize - leave
    with open(folder / "filler", "wb") as filler:
        filler.write(bytes(max(0, size)))


def test_disk_full_in_mid_render(tmp_path, disk):
    """The job pauses and says why; with room again it goes on to the same picture."""
    options = ("--spp", 32, "--size", "160x160")
    (tmp_path / "undisturbed").mkdir()
    with Farm(tmp_path / "undisturbed") as farm:
        farm.worker(threads=2)
        golden = farm.wait_job(farm.submit(GLASS_SCENE, *options))["image_sha256"]
    with Farm(tmp_path) as farm:
        farm.worker(threads=2)
        job = farm.submit(GLASS_SCENE, *options)
        farm.wait_progress(job, 0.1)
        fill(disk, 60_000)
        report = farm.wait_job(job, "paused")
        assert "disk full" in report["note"], report["note"]
        assert any("disk full" in e["text"] for e in report["events"])
        before = report["samples"]
        # The master answers as ever, and refuses what it cannot keep.
        assert farm.request("GET", "/healthz")[0] == 200
        assert farm.request("GET", f"/api/v1/jobs/{job}/picture.png?partial=1", raw=True)[0] == 200
        (disk / "filler").unlink()
        assert farm.cli("resume", job).returncode == 0
        report = farm.wait_job(job)
        assert report["image_sha256"] == golden
        assert report["samples"] == 160 * 160 * 32 and before > 0


def test_disk_full_and_killed(tmp_path, disk):
    """A SIGKILL on a full disk loses nothing that was acknowledged either."""
    with Farm(tmp_path) as farm:
        farm.worker(threads=2)
        job = farm.submit(GLASS_SCENE, "--spp", 32, "--size", "160x160")
        farm.wait_progress(job, 0.1)
        fill(disk, 60_000)
        stored = farm.wait_job(job, "paused")["samples"]
        farm.kill_master()
        (disk / "filler").unlink()
        farm.start_master()
        report = farm.job(job)
        assert report["samples"] == stored and report["state"] in ("paused", "rendering")
        if report["state"] == "paused":
            assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "queued"})[0] == 200
        assert farm.wait_job(job)["samples"] == 160 * 160 * 32


def test_disk_full_at_submission(tmp_path, disk):
    with Farm(tmp_path) as farm:
        first = farm.submit(SEED_SCENE, "--spp", 1, "--size", "16x16")
        body = {k: farm.job(first)[k] for k in ("package", "spec")}
        fill(disk, 0)
        wait_until(lambda: farm.request("POST", "/api/v1/jobs", body)[0] == 507,
                   "the disk to be full")
        assert farm.request("GET", "/healthz")[0] == 200
        (disk / "filler").unlink()
        assert farm.request("POST", "/api/v1/jobs", body)[0] == 201


def test_unwritable_folder(tmp_path):
    """Exit 5, with the folder named."""
    (tmp_path / "file").write_text("")
    for data in (tmp_path / "file", tmp_path / "no/such", "/proc/no"):
        master = Daemon("master", ["tilery-master", "--listen", "127.0.0.1:0", "--http",
                                   "127.0.0.1:0", "--data", data], tmp_path / "log", clean_env())
        try:
            assert master.process.wait(20 * SLOW) == 5
            assert str(data) in master.log()
        finally:
            master.kill()


def test_damaged_database(tmp_path):
    """Not a crash, not an empty farm: exit 5 and the folder named."""
    with Farm(tmp_path) as farm:
        farm.submit(SEED_SCENE, "--spp", 1, "--size", "16x16")
        farm.master.end()
        path = farm.data / "store.db"
        path.write_bytes(b"not a database " * 500)
        master = Daemon("master", ["tilery-master", "--listen", "127.0.0.1:0", "--http",
                                   "127.0.0.1:0", "--data", farm.data], tmp_path / "log2",
                        clean_env())
        try:
            assert master.process.wait(20 * SLOW) == 5
            assert str(farm.data) in master.log()
        finally:
            master.kill()
