"""Networks that misbehave and workers that lie, by a proxy of our own: the same picture."""
import pytest

import proxy as faulty
from farm import SEED_SCENE, Farm, tilery, wait_until
from scripted import tile_encode

WORK = ("--size", "96x96", "--spp", 32, "--tile", 8)
# Faults that slow a connection last; the others strike so many connections, then let them through.
LASTING = ("delay", "throttle", "split")
STRUCK = 3


@pytest.fixture(scope="module")
def golden(tmp_path_factory):
    """The hash of WORK from an undisturbed farm."""
    with Farm(tmp_path_factory.mktemp("golden")) as farm:
        farm.worker()
        return farm.wait_job(farm.submit(SEED_SCENE, *WORK))["image_sha256"]


@pytest.mark.parametrize("fault", sorted(faulty.FAULTS))
def test_fault(tmp_path, golden, fault):
    """Both workers reach their master through the fault alone."""
    count = None if fault in LASTING else STRUCK
    with Farm(tmp_path) as farm:
        with faulty.Proxy(farm.listen, faulty.FAULTS[fault], count, seed=7) as proxy:
            # A worker that is struck in its handshake registers by a later connection.
            for _ in range(2):
                farm.worker(wait=False, master=proxy.address)
            job = farm.submit(SEED_SCENE, *WORK)
            report = farm.wait_job(job, timeout=120)
            assert proxy.injected > 0, "no fault struck: no test"
        assert report["image_sha256"] == golden
        assert farm.master.process.poll() is None, farm.master.log()
        for worker in farm.workers:
            assert worker.process.poll() is None, worker.log()


def test_liar_is_found_by_verify(tmp_path, golden):
    """--verify: one worker's results are altered on their way. It is named, set aside for good, and
    everything that it touched is rendered again by the honest."""
    with Farm(tmp_path) as farm:
        with faulty.Proxy(farm.listen, faulty.lie(tile_encode, share=0.5)) as proxy:
            liar = farm.worker(name="liar", master=proxy.address)
            for _ in range(2):
                farm.worker()
            job = farm.submit(SEED_SCENE, *WORK, "--verify", "100%")
            report = farm.wait_job(job, timeout=120)
            assert proxy.injected > 0, "the liar told no lie: no test"
        units = report["units"]
        assert units["verified"] > 0 and units["rejected"] > 0, units
        rows = {row["id"]: row for row in farm.request("GET", "/api/v1/workers")[1]["items"]}
        assert any(f"{liar.id} lied" in event["text"] for event in report["events"]), report
        assert rows[liar.id]["state"] in ("set-aside", "lost")
        assert report["image_sha256"] == golden


def test_lies_outlive_no_restart(tmp_path, golden):
    """The master is killed again and again while a liar's results wait for their checks: whose bits
    they are, what is to be checked and who was caught are all kept."""
    with Farm(tmp_path) as farm:
        # Keeps its address, for the proxy.
        with faulty.Proxy(farm.listen, faulty.lie(tile_encode, share=0.5), seed=3) as proxy:
            liar = farm.worker(name="liar", master=proxy.address)
            job = farm.submit(SEED_SCENE, *WORK, "--verify", "100%")
            # Alone it can only lie; every check waits for another worker.
            farm.wait_progress(job, 0.5)
            for _ in range(2):
                farm.kill_master()
                farm.start_master()
            assert proxy.injected > 0, "the liar told no lie: no test"
            for _ in range(2):
                farm.worker()
            report = farm.wait_job(job, timeout=120)
            assert report["image_sha256"] == golden
            assert any(f"{liar.id} lied" in event["text"] for event in report["events"]), report
            farm.kill_master()
            farm.start_master()

            def back():
                rows = farm.request("GET", "/api/v1/workers")[1]["items"]
                return [row["state"] for row in rows if row["id"] == liar.id]
            assert wait_until(back, "the liar to come back") == ["set-aside"]


@pytest.mark.parametrize("share", ["0", "0.2", "100%"])
def test_verify_changes_no_bit(tmp_path, golden, share):
    with Farm(tmp_path) as farm:
        for _ in range(2):
            farm.worker()
        report = farm.wait_job(farm.submit(SEED_SCENE, *WORK, "--verify", share))
        assert report["image_sha256"] == golden
        units = report["units"]
        assert units["rejected"] == 0
        if share == "100%":
            assert units["verified"] > 0
        if share == "0":
            assert units["verified"] == 0


def test_verify_needs_two_workers(tmp_path):
    """One worker cannot check itself: said before anything is rendered."""
    done = tilery("render", SEED_SCENE, "-o", tmp_path / "a.exr", "--verify", "0.5", "--workers", 1)
    assert done.returncode == 2 and "--workers 2" in done.stderr, done.stderr
    for text in ("2", "-1", "101%", "x", "%", ""):
        done = tilery("render", SEED_SCENE, "-o", tmp_path / "a.exr", "--verify", text)
        assert done.returncode == 2 and "0% to 100%" in done.stderr, done.stderr
