"""Scripted workers against a real tilery-master: good, late and lost. (Hostile ones: test_master_hostile.py.)"""
import hashlib
import json
import os
import random
import struct
import threading
import time
import urllib.request

import pytest

from farm import BIN, Farm, SEED_SCENE, SLOW, samples, wait_until
from scripted import (farm, job, CELLS, SIDE, SPP, Scripted, expected_sha, honest, render_all,
                      states, tile_encode)
from wire_peer import BEGUN, WAITING

# --- Good workers -------------------------------------------------------------------------------


def test_whole_job(farm, job):
    peer = Scripted(farm).welcome()
    assert peer.id == "w1"
    info = peer.expect("JobInfo")
    assert info["job"] == 1 and len(info["package"]) == 32 and b'"spp":4' in info["spec_json"]
    render_all(farm, peer, job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert report["samples"] == SIDE * SIDE * SPP and report["rays"] == 3 * report["samples"]
    assert report["workers"] == 1 and report["spp_min"] == report["spp_max"] == SPP
    assert report["error"]["relmse"] == 0
    assert report["seconds"]["load"] == 0.1 and report["seconds"]["build"] == 0.2
    assert report["bytes"]["scene_sent"] == 10


def test_results_out_of_order_and_twice(farm, job):
    """Results in any order, each sent twice: the same picture, each unit counted once."""
    peer = Scripted(farm, threads=8).welcome()
    peer.send("JobReady", job=1)
    rng = random.Random(5)
    while farm.job(job)["state"] != "done":
        peer.drain_messages(0.05)
        rng.shuffle(peer.leases)
        for lease in peer.leases:
            fields, body = honest(lease)
            peer.send("Result", body, **fields)
            peer.send("Result", body, **fields)
        peer.leases = []
        peer.beat()
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert report["samples"] == SIDE * SIDE * SPP


def test_chunks_are_served(farm, job):
    peer = Scripted(farm).welcome()
    info = peer.expect("JobInfo")
    peer.send("ChunkRequest", sha256=info["package"])
    data = peer.expect("ChunkData")
    assert data["sha256"] == info["package"] and data.body[:4] == b"\x28\xb5\x2f\xfd"
    assert data["raw_bytes"] > 0
    peer.send("ChunkRequest", sha256=b"x" * 32)
    assert peer.expect("ChunkMissing")["sha256"] == b"x" * 32
    for _ in range(100):
        peer.send("ChunkRequest", sha256=info["package"])
    for _ in range(100):
        assert peer.expect("ChunkData").body == data.body


def test_heartbeat_is_echoed(farm):
    peer = Scripted(farm).welcome()
    peer.send("Heartbeat", sequence=77, sent_us=123456789, rtt_us=50)
    while True:
        m = peer.receive(5)
        if m.type == "Heartbeat" and m["sequence"] == 77:
            assert m["sent_us"] == 123456789
            break
    wait_until(lambda: farm.request("GET", "/api/v1/workers")[1]["items"][0]["rtt_ms"] == 0.05,
               "the round trip to be shown")


def test_nonfinite_samples_are_told(farm, job):
    peer = Scripted(farm).welcome()
    peer.send("JobReady", job=1)
    lease = peer.lease()
    fields, body = honest(lease, nonfinite=2, nonfinite_pixel=SIDE * 3 + 7, nonfinite_sample=1)
    peer.send("Result", body, **fields)
    render_all(farm, peer, job)
    report = farm.job(job)
    assert report["nonfinite_samples"] == 2
    assert report["nonfinite_first"] == {"x": 7, "y": 3, "sample": 1}


def test_pictures_while_it_renders(farm, job):
    """Looking on from several sides neither stalls the job nor changes it."""
    stop, pictures = threading.Event(), []

    def look():
        while not stop.is_set():
            status, content = farm.request("GET", f"/api/v1/jobs/{job}/picture.png?partial=1",
                                           raw=True)
            assert status == 200 and content.startswith(b"\x89PNG")
            pictures.append(content)

    lookers = [threading.Thread(target=look) for _ in range(4)]
    for looker in lookers:
        looker.start()
    peer = Scripted(farm).welcome()
    try:
        render_all(farm, peer, job)
    finally:
        stop.set()
        for looker in lookers:
            looker.join()
    assert farm.job(job)["image_sha256"] == expected_sha()
    assert len(pictures) > 4


def test_retry_of_a_cancelled_job_goes_on(farm, job):
    """What was stored before the cancel is not rendered again, over a restart too."""
    peer = Scripted(farm, instance=5).welcome()
    peer.send("JobReady", job=1)
    fields, body = honest(peer.lease())
    peer.send("Result", body, **fields)
    peer.expect("ResultAck")
    assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "cancelled"})[0] == 200
    wait_until(lambda: (farm.data / "jobs/1/film").exists(), "the checkpoint")
    peer.close()
    farm.kill_master()
    farm.start_master()
    assert farm.request("GET", f"/api/v1/jobs/{job}/picture.exr?partial=1", raw=True)[0] == 200
    assert farm.request("PATCH", f"/api/v1/jobs/{job}", {"state": "queued"})[0] == 200
    peer = Scripted(farm, instance=5).welcome()
    render_all(farm, peer, job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert report["samples"] == SIDE * SIDE * SPP


@pytest.mark.parametrize("disk", ["fast", "slow"])
def test_disk_use_is_bounded(tmp_path, disk):
    """Twice the film, what waits and 64 MiB, however much goes through: a disk that is slow made
    the queue before it longer, and with it the journal."""
    library = BIN / "libtilery_shim.so"
    if disk == "slow" and not library.exists():
        pytest.skip("the shim is not built")
    with Farm(tmp_path) as farm:
        if disk == "slow":
            farm.master.end()
            # Sanitizers want to be first; the shim passes on to them.
            options = os.environ.get("ASAN_OPTIONS", "") + ":verify_asan_link_order=0"
            farm.start_master(env={"LD_PRELOAD": library, "TILERY_SHIM": "slow:disk:1:0",
                                   "ASAN_OPTIONS": options})
        use_much_disk(farm)


def use_much_disk(farm):
    side, spp, tile, per_block = 256, 2400, 64, 16
    job = farm.submit(SEED_SCENE, "--spp", spp, "--size", f"{side}x{side}", "--tile", tile)
    peer = Scripted(farm, threads=4).welcome()
    peer.send("JobReady", job=1)
    bodies, most = {}, 0
    while farm.job(job)["state"] != "done":
        peer.drain_messages(0.02)
        for lease in peer.leases:
            pixels = lease["cell_count"] * tile * tile
            if pixels not in bodies:
                bodies[pixels] = tile_encode([0.5 * per_block] * (pixels * 3))
            peer.send("Result", bodies[pixels], job=1, cell_begin=lease["cell_begin"],
                      cell_count=lease["cell_count"], block=lease["block"], epoch=lease["epoch"],
                      samples=pixels * per_block, rays=pixels, render_us=500000,
                      raw_bytes=pixels * 12)
        peer.leases = []
        peer.beat()
        used = 0
        for path in (farm.data / "jobs").rglob("*"):
            try:
                used += path.stat().st_size if path.is_file() else 0
            except OSError:
                pass
        most = max(most, used)
    report = farm.job(job)
    film = side * side * 3 * 8 * 2
    assert report["bytes"]["results_received"] > 96 << 20
    assert most <= 2 * film + (64 << 20), (most, film)
    wait_until(lambda: [p.name for p in (farm.data / "jobs/1").iterdir()] == ["film"],
               "the journal to go")
    picture = hashlib.sha256(struct.pack("<f", 0.5) * (side * side * 3)).hexdigest()
    assert report["image_sha256"] == picture


# --- Hello ----------------------------------------------------------------------------------------


def refused(peer):
    m = peer.expect("Refuse")
    peer.expect_closed()
    return m


def test_versions(farm):
    m = refused(Scripted(farm, protocol_min=7, protocol_max=9))
    assert m["reason"] == 1 and "7 to 9" in m["text"]
    Scripted(farm, protocol_min=1, protocol_max=9).welcome()


def test_determinism_id(farm):
    Scripted(farm).welcome()
    m = refused(Scripted(farm, determinism_id=b"e" * 32))
    assert m["reason"] == 2 and "determinism" in m["text"]
    # The id is on disk before anything that is acknowledged later, results above all.
    farm.submit(SEED_SCENE, "--spp", SPP, "--size", "16x16")
    farm.kill_master()
    farm.start_master()
    assert refused(Scripted(farm, determinism_id=b"e" * 32))["reason"] == 2
    Scripted(farm).welcome()


def test_pinned_determinism_id(tmp_path):
    with Farm(tmp_path, master_arguments=["--determinism-id", "65" * 32]) as made:
        assert refused(Scripted(made))["reason"] == 2
        Scripted(made, determinism_id=b"e" * 32).welcome()


def test_token(tmp_path):
    with Farm(tmp_path, token="a long secret") as made:
        for token in ("", "a long secre", "a long secret ", "A long secret"):
            m = refused(Scripted(made, token=token))
            assert m["reason"] == 3 and "secret" not in m["text"]
        Scripted(made, token="a long secret").welcome()
        assert "a long secret" not in made.master.log()


def test_hello_must_come_first_and_soon(farm):
    peer = Scripted(farm, hello=False)
    peer.send("Heartbeat", sequence=1)
    peer.expect_closed()
    peer = Scripted(farm, hello=False)
    begin = time.monotonic()
    peer.sock.sendall(b"TL")
    peer.expect_closed(8 * SLOW)
    assert 4 < time.monotonic() - begin < 7 * SLOW


def test_same_process_keeps_its_id(farm, job):
    first = Scripted(farm, instance=4242).welcome()
    first.send("JobReady", job=1)
    lease = first.lease()
    second = Scripted(farm, instance=4242).welcome()
    assert second.id == first.id
    first.expect_closed()
    other = Scripted(farm, instance=4343).welcome()
    assert other.id != first.id
    # What the old connection had is leased again; the old epoch's result is still good.
    fields, body = honest(lease)
    second.send("Result", body, **fields)
    second.expect("ResultAck")
    other.close()
    render_all(farm, second, job)
    assert farm.job(job)["image_sha256"] == expected_sha()


def test_id_outlives_the_master(farm):
    """A process gets back the id that this farm gave it; nobody else ever gets it."""
    first = Scripted(farm, instance=11)
    number = first.expect("Welcome")["farm"]
    Scripted(farm, instance=12).welcome()
    # What is acknowledged after them finds their numbers on disk.
    farm.submit(SEED_SCENE, "--spp", SPP, "--size", "16x16")
    farm.kill_master()
    farm.start_master()
    new = Scripted(farm, instance=13).welcome()
    assert new.id not in ("w1", "w2")
    assert Scripted(farm, instance=12, last_id="w2", last_farm=number).welcome().id == "w2"
    assert Scripted(farm, instance=11, last_id="w1", last_farm=number).welcome().id == "w1"
    # Neither another process, nor one of another farm, nor a text that is no id gets one.
    taken = {"w1", "w2", new.id}
    for last_id, last_farm in (("w1", number), ("w2", number ^ 1), ("w0", number), ("w01", number),
                               ("w", number), ("", number), ("w1x", number), ("x1", number),
                               ("w4294967296", number), ("w999999999999999", number)):
        other = Scripted(farm, last_id=last_id, last_farm=last_farm).welcome()
        assert other.id not in taken and int(other.id[1:]) < 100
        taken.add(other.id)
    # One that was given shortly before a kill, and whose number was not on disk yet.
    ahead = f"w{int(other.id[1:]) + 5}"
    assert Scripted(farm, last_id=ahead, last_farm=number).welcome().id == ahead
    assert Scripted(farm).welcome().id == f"w{int(ahead[1:]) + 1}"
    listed = [w["id"] for w in farm.request("GET", "/api/v1/workers")[1]["items"]]
    assert sorted(listed) == sorted(taken | {ahead, f"w{int(ahead[1:]) + 1}"})


def test_one_process_counts_once_over_restarts(farm):
    """A real worker keeps its id when the master is killed, and the report counts it once."""
    job = farm.submit(SEED_SCENE, "--spp", samples(1000), "--size", "128x128", "--tile", 16)
    worker = farm.worker()
    for share in (0.1, 0.3):
        farm.wait_progress(job, share)
        farm.kill_master()
        farm.start_master()
        wait_until(lambda: states(farm).get(worker.id, "lost") != "lost", "the worker's return")
    assert list(states(farm)) == [worker.id]
    assert farm.wait_job(job)["workers"] == 1


# --- Losses ----------------------------------------------------------------------------------------


class WorkerEvents(threading.Thread):
    """What the followers of one job are told about workers."""

    def __init__(self, farm, job):
        super().__init__(daemon=True)
        self.reply = urllib.request.urlopen(f"{farm.url}/api/v1/events?job={job}",
                                            timeout=20 * SLOW)
        self.seen = []
        self.start()

    def run(self):
        kind = ""
        for line in self.reply:
            key, _, value = line.decode().strip().partition(": ")
            if key == "event":
                kind = value
            elif key == "data" and kind == "workers":
                self.seen += json.loads(value)

    def wait(self, worker, state):
        def found():
            return next((e for e in self.seen if (e["id"], e["state"]) == (worker, state)), None)
        event = wait_until(found, f"{worker} {state} among {self.seen}")
        assert set(event) == {"id", "name", "state", "units_returned", "threads", "note"}
        return event


def test_followers_of_a_job_hear_of_workers(farm, job):
    events = WorkerEvents(farm, job)
    lost = Scripted(farm, name="to be lost").welcome()
    event = events.wait("w1", "joined")
    assert (event["name"], event["threads"], event["units_returned"]) == ("to be lost", 2, 0)
    lost.send("JobReady", job=1)
    lost.lease()
    lost.drain_messages()
    held = len(lost.leases) + 1
    lost.close()
    event = events.wait("w1", "lost")
    assert event["units_returned"] == held > 1 and event["note"]
    good = Scripted(farm).welcome()
    render_all(farm, good, job)
    good.send("Heartbeat", sequence=2, sent_us=1, draining=True)
    events.wait("w2", "draining")
    good.send("Goodbye", reason="drained")
    event = events.wait("w2", "left")
    assert event["units_returned"] == 0 and event["note"] == "left"
    states_seen = [(e["id"], e["state"]) for e in events.seen]
    assert states_seen == [("w1", "joined"), ("w1", "lost"), ("w2", "joined"), ("w2", "draining"),
                           ("w2", "left")]


def test_scene_bytes_outlive_the_master(farm, job):
    peer = Scripted(farm).welcome()
    peer.send("JobReady", job=1, received_bytes=12345)
    wait_until(lambda: farm.job(job)["bytes"]["scene_sent"] == 12345, "the bytes")
    # What is acknowledged after them finds them on disk.
    farm.submit(SEED_SCENE, "--spp", SPP, "--size", "16x16")
    farm.kill_master()
    farm.start_master()
    assert farm.job(job)["bytes"]["scene_sent"] == 12345


def test_silent_worker_is_lost(farm, job):
    silent = Scripted(farm).welcome()
    silent.send("JobReady", job=1)
    silent.lease()
    begin = time.monotonic()
    good = Scripted(farm)
    wait_until(lambda: good.beat() or states(farm)["w1"] == "lost", "w1 to be lost", 10, 0.2)
    assert 2 < time.monotonic() - begin < 6 * SLOW
    good.welcome()
    render_all(farm, good, job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert any("lost" in e["text"] for e in report["events"])
    said = [line for line in farm.master.log().splitlines() if "lost" in line and "id=w1" in line]
    assert len(said) == 1 and 'why="silent for 3 s"' in said[0], said


def test_goodbye_returns_leases_at_once(farm, job):
    leaving, staying = Scripted(farm).welcome(), Scripted(farm).welcome()
    leaving.send("JobReady", job=1)
    leaving.lease()
    leaving.send("Goodbye", reason="test")
    leaving.expect_closed()
    begin = time.monotonic()
    render_all(farm, staying, job)
    assert time.monotonic() - begin < 3 * SLOW
    assert farm.job(job)["image_sha256"] == expected_sha()


def test_failed_units_and_jobs(farm, job):
    bad, good = Scripted(farm).welcome(), Scripted(farm).welcome()
    bad.send("JobReady", job=1)
    lease = bad.lease()
    bad.send("UnitFailed", job=1, epoch=lease["epoch"], error="ERR_NOMEM", text="no memory for it")
    wait_until(lambda: any("no memory for it" in e["text"] for e in farm.job(job)["events"]),
               "the failure to be told")
    bad.send("JobFailed", job=1, error="ERR_NOMEM", text="scene too large")
    render_all(farm, good, job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert any("scene too large" in e["text"] for e in report["events"])


def test_unacknowledged_result_survives_the_master(farm, job):
    """What was acknowledged is kept over a SIGKILL, what comes after it is taken."""
    peer = Scripted(farm, instance=99).welcome()
    peer.send("JobReady", job=1)
    lease = peer.lease()
    fields, body = honest(lease)
    peer.send("Result", body, **fields)
    peer.expect("ResultAck")
    units = farm.job(job)["units"]["total"]
    farm.kill_master()
    farm.start_master()
    report = farm.job(job)
    assert report["units"]["total"] == units >= 1 and report["samples"] == fields["samples"]
    again = Scripted(farm, instance=99).welcome()
    again.send("Result", body, **fields)
    again.expect("ResultAck")
    render_all(farm, again, job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert report["samples"] == SIDE * SIDE * SPP


def held(lease, state, **changes):
    return {**{k: lease[k] for k in ("job", "cell_begin", "cell_count", "block", "epoch")},
            "state": state, **changes}


def cells_of(lease):
    return {(lease["block"], lease["cell_begin"] + i) for i in range(lease["cell_count"])}


def test_leases_outlive_the_master(farm, job):
    """What workers tell a new master of is not rendered again: no cell is leased twice."""
    first = Scripted(farm, instance=71)
    number = first.expect("Welcome")["farm"]
    first.send("JobReady", job=1)
    one = first.lease()
    fields, body = honest(one)
    first.send("Result", body, **fields)
    first.expect("ResultAck")  # the job is begun, as the disk knows
    first.drain_messages()
    kept = list(first.leases)
    assert len(kept) >= 2
    farm.kill_master()
    farm.start_master()
    # Another one is first, and must wait for those that may come back.
    other = Scripted(farm, threads=4, instance=72).welcome()
    other.send("JobReady", job=1)
    again = Scripted(farm, instance=71, last_id="w1", last_farm=number,
                     held=[held(lease, WAITING if i else BEGUN) for i, lease in enumerate(kept)])
    again.welcome()
    again.send("JobReady", job=1)
    for peer in (again, other):
        peer.drain_messages(0.5)
    for peer in (again, other):
        peer.drain_messages(0.5)
    mine = set().union(*map(cells_of, kept))
    assert other.leases, "nothing was leased after the wait"
    for lease in other.leases + again.leases:
        assert not cells_of(lease) & (mine | cells_of(one)), lease
        assert lease["epoch"] not in {k["epoch"] for k in kept}
    for lease in kept:
        fields, body = honest(lease)
        again.send("Result", body, **fields)
    again.leases += other.leases
    other.close()
    render_all(farm, again, job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert report["samples"] == SIDE * SIDE * SPP


@pytest.mark.parametrize("noticed", (False, True))
def test_a_connection_that_breaks_costs_nothing(farm, job, noticed):
    """The process is back with its leases, before or soon after the old connection is known to be
    dead: it goes on, nothing of it is leased to others, nobody counts it as lost."""
    first = Scripted(farm, instance=91)
    number = first.expect("Welcome")["farm"]
    first.send("JobReady", job=1)
    first.leases.append(first.lease())
    first.drain_messages()
    kept = list(first.leases)
    again = Scripted(farm, instance=91, last_id="w1", last_farm=number, hello=False,
                     held=[held(lease, WAITING if i else BEGUN) for i, lease in enumerate(kept)])
    if noticed:
        first.close()
        wait_until(lambda: farm.request("GET", "/api/v1/workers")[1]["items"][0]["note"] ==
                   "connection closed", "the end", step=0.01)
    again.send("Hello", **again.values)
    again.welcome()
    assert again.id == "w1"
    assert again.expect("JobInfo")["job"] == 1
    if noticed and " lost id=w1 name=scripted units=" in farm.master.log():
        return  # this machine was busy for longer than a worker may be away
    other = Scripted(farm, threads=2, instance=92).welcome()
    other.send("JobReady", job=1)
    for peer in (again, other):
        peer.drain_messages(0.5)
    mine = set().union(*map(cells_of, kept))
    for lease in other.leases + again.leases:
        assert not cells_of(lease) & mine, lease
    assert farm.job(job)["units"]["retried"] == 0
    again.leases += kept + other.leases
    other.send("Goodbye", reason="test")
    render_all(farm, again, job)
    report = farm.job(job)
    assert report["image_sha256"] == expected_sha()
    assert report["samples"] == SIDE * SIDE * SPP
    row = next(row for row in farm.request("GET", "/api/v1/workers")[1]["items"]
               if row["id"] == "w1")
    assert row["lost"] == 0
    assert not any("w1 (scripted) lost" in e["text"] for e in report["events"]), report["events"]


def test_counts_of_units_outlive_the_master(farm, job):
    """units.retried: leases that ended without a result, over all lives of the master."""
    peer = Scripted(farm, instance=61).welcome()
    peer.send("JobReady", job=1)
    lease = peer.lease()
    peer.send("UnitFailed", job=1, epoch=lease["epoch"], error="ERR_NOMEM", text="no memory")
    wait_until(lambda: farm.job(job)["units"]["retried"] == 1, "a failed unit")
    peer.drain_messages()
    held_now = len(peer.leases)
    peer.send("Goodbye", reason="test")
    wait_until(lambda: farm.job(job)["units"]["retried"] == 1 + held_now, "what it left")
    for _ in range(2):
        farm.cli("pause", job)  # its row is stored after the count's
        farm.kill_master()
        farm.start_master()
        assert farm.job(job)["units"]["retried"] == 1 + held_now
    farm.cli("resume", job)
    render_all(farm, Scripted(farm, instance=62).welcome(), job)
    report = farm.job(job)
    assert report["units"]["retried"] == 1 + held_now, report["units"]
    assert report["units"]["speculated"] == report["units"]["verified"] == 0


def test_held_leases_that_never_were(farm, job):
    """Nothing of what a Hello tells is believed; what is not so is revoked."""
    first = Scripted(farm, instance=81)
    number = first.expect("Welcome")["farm"]
    lease = first.lease()
    first.close()
    good = held(lease, BEGUN)
    false = [{**good, **change} for change in (
        {"epoch": 0}, {"epoch": lease["epoch"] + 1000}, {"epoch": 2 ** 64 - 1}, {"job": 9},
        {"job": 0}, {"block": 9}, {"cell_begin": CELLS}, {"cell_count": CELLS + 1})]
    peer = Scripted(farm, instance=81, last_id="w1", last_farm=number, held=false)
    revoked = set()
    while len(revoked) < len(false):
        m = peer.expect("Revoke", "Welcome")
        if m.type == "Revoke":
            revoked.add((m["job"], m["epoch"]) if m["job"] == 9 else len(revoked))
    # Of another farm: not looked at. More than anybody can hold, or no state: hung up on.
    Scripted(farm, last_farm=number ^ 1, held=[good] * 256).welcome()
    Scripted(farm, last_farm=number, held=[good] * 256).welcome()
    for bad in ([good] * 257, [{**good, "state": 3}], [{**good, "cell_count": 0}],
                [{**good, "cell_begin": 2 ** 32 - 1}], [b"\xff\xff"]):
        Scripted(farm, last_farm=number, held=bad).expect_closed()
    render_all(farm, peer, job)
    assert farm.job(job)["image_sha256"] == expected_sha()
