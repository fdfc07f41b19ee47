"""What a master has promised it keeps, and what it has refused it does not: over kills, restarts,
full disks and clients that ask twice."""
import contextlib
import json
import os
import signal
import sqlite3
import struct
import sys
import threading
import time

import pytest

from farm import Daemon, Farm, ROOT, SEED_SCENE, SLOW, clean_env, wait_until
from scripted import (farm, job, SIDE, SPP, TILE, Scripted, expected_sha, honest, render_all)
from test_master_disk import disk, fill
from test_master_http import Client

sys.path.insert(0, str(ROOT / "tests/campaign"))

from common import metric, shim  # noqa: E402

OPTIONS = ("--spp", SPP, "--size", f"{SIDE}x{SIDE}", "--tile", TILE)


def body_of(farm, job):
    """What submits the same job once more."""
    return {k: farm.job(job)[k] for k in ("package", "spec")}


def give_results(peer, count):
    """Renders so many units, and waits for their acknowledgements."""
    for lease in [peer.lease() for _ in range(count)]:
        fields, body = honest(lease)
        peer.send("Result", body, **fields)
    for _ in range(count):
        peer.expect("ResultAck")


def zeros_frame(megabytes):
    """A zstd frame of so many zeros, of RLE blocks, by hand."""
    blocks = megabytes * 8
    return struct.pack("<IBB", 0xFD2FB528, 0, 0x68) + b"".join(
        (131072 << 3 | 1 << 1 | (i + 1 == blocks)).to_bytes(3, "little") + b"\0"
        for i in range(blocks))


# --- Results ------------------------------------------------------------------------------------


def test_results_after_a_retry_outlive_the_master(farm, job):
    """A job was cancelled, the master started anew, the job retried: what is acknowledged then is
    behind its checkpoint, and is not rendered again after a kill."""
    peer = Scripted(farm).welcome()
    peer.send("JobReady", job=1)
    give_results(peer, 3)
    assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "cancelled"})[0] == 200
    wait_until(lambda: not list((farm.data / "jobs").rglob("seg-*")), "the last checkpoint")
    peer.close()
    farm.master.end()
    farm.start_master()
    assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "queued"})[0] == 200
    peer = Scripted(farm).welcome()
    peer.send("JobReady", job=1)
    give_results(peer, 2)
    before = farm.job(job)
    farm.kill_master()
    farm.start_master()
    after = farm.job(job)
    assert (after["samples"], after["units"]) == (before["samples"], before["units"])
    render_all(farm, Scripted(farm).welcome(), job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha() and report["samples"] == SIDE * SIDE * SPP


def test_no_epoch_comes_twice(tmp_path):
    """A master is killed as soon as it has given a lease, again and again, on a slow disk: the number
    of a lease is never given again, since a worker may come back with it."""
    with Farm(tmp_path) as farm:
        farm.submit(SEED_SCENE, *OPTIONS)
        given = []
        for _ in range(4):
            farm.kill_master()
            farm.start_master(env=shim("slow:disk:1:0"))
            given.append(Scripted(farm).welcome().lease()["epoch"])
        assert len(set(given)) == 4, given


def test_done_is_on_disk(tmp_path):
    """A job that is told done was done for good, however slow the disk: the next master tells the
    same moment and the same numbers."""
    with Farm(tmp_path) as farm:
        farm.master.end()
        farm.start_master(env=shim("slow:disk:1:0"))
        job = farm.submit(SEED_SCENE, *OPTIONS)
        peer = Scripted(farm).welcome()
        peer.send("JobReady", job=1)

        def done():
            peer.drain_messages(0.001)
            for lease in peer.leases:
                fields, body = honest(lease)
                peer.send("Result", body, **fields)
            peer.leases = []
            return farm.job(job)["state"] == "done"
        wait_until(done, "the job to be done", 20, 0)
        before = farm.job(job)
        farm.kill_master()
        farm.start_master()
        after = farm.job(job)
        for name in ("state", "image_sha256", "finished", "seconds", "samples", "error"):
            assert after[name] == before[name], name


def test_late_result_of_a_job_that_is_gone(farm, job):
    """Its worker has done nothing wrong: it is told to forget the result, and no alarm is raised. A
    job that never was is another matter."""
    peer = Scripted(farm).welcome()
    peer.send("JobReady", job=1)
    late = peer.lease()
    assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "cancelled"})[0] == 200
    peer.close()
    farm.master.end()
    farm.start_master()
    peer = Scripted(farm).welcome()
    fields, body = honest(late)
    peer.send("Result", body, **fields)
    assert peer.expect("ResultAck")["epoch"] == late["epoch"]
    assert metric(farm, "results_refused_total") == 0
    assert not [e for e in farm.job(job)["events"] if "refused" in e["text"]]
    peer.send("Result", body, **{**fields, "job": 77})
    peer.expect("ResultAck")
    assert metric(farm, "results_refused_total") == 1


def test_long_line_is_cut_between_characters(farm, job):
    peer = Scripted(farm).welcome()
    peer.send("JobReady", job=1)
    lease = peer.lease()
    peer.send("UnitFailed", job=1, epoch=lease["epoch"], error="ERR_IO", text="\u00e9" * 128)
    line = wait_until(lambda: [e["text"] for e in farm.job(job)["events"] if "failed" in e["text"]],
                      "the line")[0]
    assert line.endswith("\u00e9") and "\ufffd" not in line and len(line.encode()) >= 198


def test_chunk_goes_to_the_connection_that_asked(tmp_path):
    """A worker asks for a chunk and is back by another connection before it is read: it has not asked
    on that one, and hangs up on what it has not asked for."""
    with Farm(tmp_path) as farm:
        job = farm.submit(SEED_SCENE, *OPTIONS)
        package = bytes.fromhex(farm.job(job)["package"])
        farm.master.end()
        farm.start_master()  # it has no chunk in memory
        # What is long to unpack keeps the pool from reading.
        makers = [threading.Thread(target=Client(farm), args=(
            "PUT", f"/api/v1/chunks/{i:064x}", zeros_frame(256))) for i in range(8)]
        for maker in makers:
            maker.start()
        time.sleep(0.1)
        first = Scripted(farm, instance=5).welcome()
        first.send("ChunkRequest", sha256=package)
        first.beat()
        first.expect("Heartbeat")
        again = Scripted(farm, instance=5).welcome()
        assert again.id == first.id
        for maker in makers:
            while maker.is_alive():
                again.beat()
                maker.join(0.5)
        with pytest.raises(TimeoutError):
            again.expect("ChunkData", timeout=1)
        again.send("ChunkRequest", sha256=package)
        again.expect("ChunkData")


def test_many_look_and_the_farm_goes_on(tmp_path):
    """However many large pictures are asked for, a chunk that is not in memory is read meanwhile."""
    with Farm(tmp_path) as farm:
        job = farm.submit(SEED_SCENE, *OPTIONS)
        farm.submit(SEED_SCENE, "--spp", 1, "--size", "4096x4096", "--priority", -1)
        package = bytes.fromhex(farm.job(job)["package"])
        farm.master.end()
        farm.start_master()
        replies = []
        lookers = [threading.Thread(target=lambda: replies.append(farm.request(
            "GET", "/api/v1/jobs/j2/picture.png?partial=1", raw=True)[0])) for _ in range(8)]
        for looker in lookers:
            looker.start()
        time.sleep(0.2)
        peer = Scripted(farm).welcome()
        peer.send("ChunkRequest", sha256=package)
        peer.expect("ChunkData")
        assert len(replies) < 3
        for looker in lookers:
            looker.join()
        assert replies == [200] * 8


# --- A full disk --------------------------------------------------------------------------------


def checkpoints_refused(farm):
    return farm.master.log().count("not stored what=checkpoint")


def test_disk_full_at_the_last_checkpoint(tmp_path, disk):
    """The picture is there, its film does not fit: that is tried now and then, not all the time,
    and works once there is room."""
    with Farm(tmp_path) as farm:
        job = farm.submit(SEED_SCENE, *OPTIONS)
        peer = Scripted(farm).welcome()
        peer.send("JobReady", job=1)
        last = peer.lease()
        rest = SIDE * SIDE * SPP - honest(last)[0]["samples"]

        def all_but_one():
            peer.drain_messages(0.05)
            for lease in peer.leases:
                fields, body = honest(lease)
                peer.send("Result", body, **fields)
            peer.leases = []
            return farm.job(job)["samples"] == rest
        wait_until(all_but_one, "all units but one")
        fill(disk, 120_000)
        fields, body = honest(last)
        peer.send("Result", body, **fields)
        assert farm.wait_job(job)["image_sha256"] == expected_sha()
        wait_until(lambda: checkpoints_refused(farm) > 0, "the checkpoint to be refused")
        time.sleep(1.5)
        assert checkpoints_refused(farm) < 10
        (disk / "filler").unlink()
        wait_until((disk / "jobs/1/film").exists, "the checkpoint")
        wait_until(lambda: not list((disk / "jobs").rglob("seg-*")), "the journal to go")


def test_disk_full_while_somebody_pauses(tmp_path, disk):
    """A result is on its way to a disk that is full when its job is paused: it is rendered again
    when the job goes on."""
    with Farm(tmp_path) as farm:
        job = farm.submit(SEED_SCENE, *OPTIONS)
        peer = Scripted(farm).welcome()
        peer.send("JobReady", job=1)
        give_results(peer, 1)
        lease, call = peer.lease(), Client(farm)
        assert call("GET", "/healthz")[0] == 200  # it is connected
        fill(disk, 0)
        # Both are there before the master looks, and so before its store can answer.
        farm.master.signal(signal.SIGSTOP)
        fields, body = honest(lease)
        peer.send("Result", body, **fields)
        pause = threading.Thread(target=call, args=(
            "PATCH", f"/api/v1/jobs/{job}", {"state": "paused"}))
        pause.start()
        time.sleep(0.3)
        farm.master.signal(signal.SIGCONT)
        pause.join()
        wait_until(lambda: "not stored what=result" in farm.master.log(), "the result to be refused")
        (disk / "filler").unlink()
        wait_until(lambda: farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "queued"})[0] == 200
                   or farm.job(job)["state"] != "paused", "the job to go on")
        render_all(farm, peer, job)
        report = farm.job(job)
        assert report["image_sha256"] == expected_sha() and report["samples"] == SIDE * SIDE * SPP


def test_refused_submission_leaves_no_job(tmp_path, disk):
    """507 means that there is no job: neither at once nor when there is room again."""
    with Farm(tmp_path) as farm:
        made = {farm.submit(SEED_SCENE, *OPTIONS)}
        body = body_of(farm, "j1")
        fill(disk, 0)

        def refused():
            status, report = farm.request("POST", "/api/v1/jobs", body)
            if status == 201:
                made.add(report["id"])
            return status == 507
        wait_until(refused, "the disk to be full")

        def jobs():
            return {item["id"] for item in farm.request("GET", "/api/v1/jobs?limit=1000")[1]["items"]}
        assert jobs() == made
        (disk / "filler").unlink()
        status, report = farm.request("POST", "/api/v1/jobs", body)
        assert status == 201
        made.add(report["id"])
        time.sleep(1.5)  # what could not be stored is tried again every second
        assert jobs() == made
        farm.kill_master()
        farm.start_master()
        assert jobs() == made


def test_folder_that_cannot_be_read(tmp_path):
    """One job's row is damaged: exit 5 and the folder named, no crash over the jobs before it."""
    with Farm(tmp_path) as farm:
        for _ in range(2):
            farm.submit(SEED_SCENE, *OPTIONS)
        farm.master.end()
        with contextlib.closing(sqlite3.connect(farm.data / "store.db")) as db, db:
            db.execute("UPDATE job SET numbers = x'00' WHERE id = 2")
        master = Daemon("master", ["tilery-master", "--listen", "127.0.0.1:0", "--http",
                                   "127.0.0.1:0", "--data", farm.data], tmp_path / "log2",
                        clean_env())
        try:
            assert master.process.wait(20 * SLOW) == 5, master.log()
            assert str(farm.data) in master.log()
        finally:
            master.kill()


# --- Asking twice -------------------------------------------------------------------------------


def test_one_key_at_the_same_time(farm, job):
    """Somebody who asks again before the answer came has one job, not two."""
    body = body_of(farm, job)
    for number in range(10):
        replies = []

        def ask():
            replies.append(Client(farm)("POST", "/api/v1/jobs", body,
                                        {"Idempotency-Key": f"at-once-{number}"}))
        askers = [threading.Thread(target=ask) for _ in range(4)]
        for asker in askers:
            asker.start()
        for asker in askers:
            asker.join()
        assert [reply[0] for reply in replies] == [201] * 4
        assert len({reply[1]["id"] for reply in replies}) == 1


def test_key_of_a_job_that_is_gone(tmp_path):
    """Retention took the job that a key made: the key makes another one, once."""
    with Farm(tmp_path, master_arguments=["--retention", "0.00001"]) as farm:
        first = farm.submit(SEED_SCENE, *OPTIONS)  # keeps the scene
        body, call, key = body_of(farm, first), Client(farm), {"Idempotency-Key": "k"}
        gone = call("POST", "/api/v1/jobs", body, key)[1]["id"]
        assert call("PATCH", f"/api/v1/jobs/{gone}", {"state": "cancelled"})[0] == 200
        wait_until(lambda: call("GET", f"/api/v1/jobs/{gone}")[0] == 404, "the job to go")
        made = [call("POST", "/api/v1/jobs", body, key)[1]["id"] for _ in range(3)]
        assert len(set(made)) == 1 and made[0] != gone


def test_key_lives_a_day(tmp_path):
    clock = tmp_path / "clock"
    clock.write_text("0")
    env = {**shim("count:disk:0"), "TILERY_SHIM_CLOCK": clock}
    with Farm(tmp_path) as farm:
        farm.master.end()
        farm.start_master(env=env)
        body = body_of(farm, farm.submit(SEED_SCENE, *OPTIONS))
        key = {"Idempotency-Key": "k"}
        first = Client(farm)("POST", "/api/v1/jobs", body, key)[1]["id"]
        for hours, same in ((23, True), (25, False)):
            farm.master.end()
            clock.write_text(f"{hours * 3600}")
            farm.start_master(env=env)
            again = Client(farm)("POST", "/api/v1/jobs", body, key)
            assert again[0] == 201 and (again[1]["id"] == first) == same, hours


def test_tag_of_an_earlier_master_is_stale(tmp_path):
    """Changes are counted anew by each master: what was read from the one before is not what the same
    count means now."""
    with Farm(tmp_path) as farm:
        path = f"/api/v1/jobs/{farm.submit(SEED_SCENE, *OPTIONS)}"
        status, report, headers = Client(farm)("GET", path)
        assert status == 200 and report["priority"] == 0
        farm.master.end()
        farm.start_master()
        call, old = Client(farm), {"If-Match": headers["ETag"]}
        for priority in range(1, 30):
            assert call("PATCH", path, {"priority": priority})[0] == 200
            assert call("PATCH", path, {"state": "cancelled"}, old)[0] == 412, priority
        now = {"If-Match": call("GET", path)[2]["ETag"]}
        assert call("PATCH", path, {"state": "cancelled"}, now)[0] == 200


# --- Many jobs ----------------------------------------------------------------------------------


def submit_many(farm, count):
    call, body = Client(farm), body_of(farm, farm.submit(SEED_SCENE, *OPTIONS))
    ids = [call("POST", "/api/v1/jobs", body)[1]["id"] for _ in range(count - 1)]
    return call, body, ids


def test_paused_jobs_are_in_nobodys_way(tmp_path):
    """A thousand paused jobs: the next one is rendered all the same, and each of them goes on when
    it is asked to."""
    with Farm(tmp_path, master_arguments=["--no-sync"]) as farm:
        call, body, ids = submit_many(farm, 1000)
        for paused in ["j1", *ids]:
            assert call("PATCH", f"/api/v1/jobs/{paused}", {"state": "paused"})[0] == 200
        last = call("POST", "/api/v1/jobs", body)[1]["id"]
        peer = Scripted(farm).welcome()
        lease = peer.lease()
        assert lease["job"] == int(last[1:])
        peer.leases.insert(0, lease)
        render_all(farm, peer, last)
        assert call("PATCH", "/api/v1/jobs/j1", {"state": "queued"})[0] == 200
        render_all(farm, peer, "j1")


def test_urgent_job_behind_a_thousand(tmp_path):
    """Priority counts among all jobs, not only among the first thousand."""
    with Farm(tmp_path, master_arguments=["--no-sync"]) as farm:
        call, body, _ = submit_many(farm, 1000)
        urgent = call("POST", "/api/v1/jobs", {**body, "priority": 9})[1]["id"]
        peer = Scripted(farm).welcome()
        assert peer.lease()["job"] == int(urgent[1:])


def test_films_of_cancelled_jobs_leave_memory(tmp_path):
    """Also those of jobs that were cancelled before anything was rendered."""
    with Farm(tmp_path, master_arguments=["--no-sync"]) as farm:
        for _ in range(4):
            job = farm.submit(SEED_SCENE, "--target-error", 0.1, "--size", "2048x2048")
            assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "cancelled"})[0] == 200
        assert 2048 * 2048 * 48 * 4 > 512 << 20
        wait_until(lambda: metric(farm, "film_bytes") <= 512 << 20, "films to go", 5)
        assert farm.request("GET", f"/api/v1/jobs/{job}/picture.png?partial=1", raw=True)[0] == 200
        assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "queued"})[0] == 200
