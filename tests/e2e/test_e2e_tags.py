"""Jobs that ask for workers with tags, on a running farm."""
import subprocess

from farm import BIN, SEED_SCENE, Farm, clean_env, wait_until

SMALL = ("--size", "48x32", "--spp", 4)


def contributors(farm):
    """Units of each worker, by name."""
    _, workers = farm.request("GET", "/api/v1/workers")
    return {w["name"]: w["units"] for w in workers["items"]}


def test_only_workers_with_the_tags(tmp_path):
    with Farm(tmp_path) as farm:
        farm.worker(name="plain")
        farm.worker(name="small", arguments=("--tag", "site-b"))
        job = farm.submit(SEED_SCENE, *SMALL, "--tags", "big,site-b")
        wait_until(lambda: farm.job(job)["note"] == "no worker has the tags big,site-b",
                   "the note to say why")
        # Others are not held up by it.
        other = farm.submit(SEED_SCENE, *SMALL)
        picture = farm.wait_job(other)["image_sha256"]
        before = contributors(farm)
        assert farm.job(job)["state"] == "queued"
        farm.worker(name="large", arguments=("--tag", "big", "--tag", "site-b", "--tag", "x"))
        report = farm.wait_job(job)
        assert report["image_sha256"] == picture and report["spec"]["tags"] == "big,site-b"
        after = contributors(farm)
        assert after["large"] > 0
        assert {n: after[n] for n in before} == before, "a worker without the tags rendered it"
        table = farm.cli("workers").stdout
        assert "tags big, site-b, x" in table and "tags site-b" in table


def test_tags_outlive_the_master(tmp_path):
    with Farm(tmp_path) as farm:
        farm.worker(name="plain")
        job = farm.submit(SEED_SCENE, *SMALL, "--tags", "big")
        farm.kill_master()
        farm.start_master()
        wait_until(lambda: contributors(farm).get("plain") is not None, "the worker to return")
        # A second word moves in beside the first.
        second = farm.submit(SEED_SCENE, *SMALL, "--tags", "fast")
        farm.worker(name="fast", arguments=("--tag", "fast"))
        farm.wait_job(second)
        assert farm.job(job)["state"] == "queued"
        farm.worker(name="big", arguments=("--tag", "big"))
        farm.wait_job(job)
        assert contributors(farm)["plain"] == 0


def test_bad_tags_of_a_worker(tmp_path):
    for tag in ("", "two words", "x" * 33, "a,b"):
        done = subprocess.run([BIN / "tilery-worker", "--master", "127.0.0.1:1", "--tag", tag],
                              capture_output=True, text=True, timeout=30, env=clean_env(),
                              check=False)
        assert done.returncode == 2 and "letters, digits" in done.stderr
