"""A farm as people use it: submit, watch, list, steer, fetch; and how it refuses."""
import json
import re
import signal
import socket
import subprocess

import numpy
import pytest

import exr_pixels
from farm import (BIN, GLASS_SCENE, SEED_SCENE, Daemon, Farm, clean_env, interrupt, report_of,
                  samples, tilery, wait_until)

SMALL = ("--size", "48x40", "--spp", "4")
LONG = ("--size", "200x200", "--spp", "4096")


@pytest.fixture(scope="module")
def farm(tmp_path_factory):
    with Farm(tmp_path_factory.mktemp("farm")) as farm:
        farm.worker(threads=1, name="alpha")
        farm.worker(threads=1, name="beta")
        yield farm


@pytest.fixture
def empty(tmp_path):
    with Farm(tmp_path) as farm:
        yield farm


def test_submit_wait_get_status(farm, tmp_path):
    """The id alone on stdout; the picture by --wait and by get are one and the same."""
    done = farm.cli("submit", GLASS_SCENE, *SMALL, "--name", "spot", "--wait", "-o",
                    tmp_path / "a.exr", "--png", tmp_path / "a.png", "--report",
                    tmp_path / "a.json")
    assert done.returncode == 0, done.stderr
    job = done.stdout.strip()
    assert re.fullmatch(r"j\d+", job) and done.stdout == job + "\n"
    report = report_of(tmp_path / "a.json")
    assert report["job"] == job
    assert report["image_sha256"] == exr_pixels.sha256(tmp_path / "a.exr")
    assert farm.cli("get", job, "-o", tmp_path / "b.exr").returncode == 0
    assert (tmp_path / "b.exr").read_bytes() == (tmp_path / "a.exr").read_bytes()
    assert farm.cli("get", job, "-o", tmp_path / "b.png").returncode == 0
    assert (tmp_path / "b.png").read_bytes() == (tmp_path / "a.png").read_bytes()
    status = farm.cli("status", job, "--json")
    assert json.loads(status.stdout)["image_sha256"] == report["image_sha256"]
    text = farm.cli("status", job).stdout
    assert text.startswith("JOB") and "spot" in text and report["image_sha256"] in text
    assert f"{farm.url}/#{job}" in text


def test_the_farm_and_render_agree(farm, tmp_path):
    """`render` is the same code path: the same bits as the farm's."""
    job = farm.submit(SEED_SCENE, *SMALL)
    report = farm.wait_job(job)
    assert tilery("render", SEED_SCENE, "-o", tmp_path / "a.exr", *SMALL).returncode == 0
    assert exr_pixels.sha256(tmp_path / "a.exr") == report["image_sha256"]


def test_second_submission_sends_nothing(farm):
    """Chunks are named by their contents: what the farm has is not asked for again."""
    farm.wait_job(farm.submit(GLASS_SCENE, *SMALL))
    report = farm.wait_job(farm.submit(GLASS_SCENE, *SMALL, "--seed", 5))
    assert report["bytes"]["scene_sent"] == 0


def test_jobs_table_and_json(farm):
    job = farm.submit(SEED_SCENE, *SMALL, "--name", "table")
    farm.wait_job(job)
    text = farm.cli("jobs").stdout.splitlines()
    assert text[0].split() == ["JOB", "NAME", "STATE", "DONE", "ERROR", "LEFT", "WORKERS", "PRI",
                               "AGE", "NOTE"]
    assert text[1].split()[:4] == [job, "table", "done", "100%"]
    rows = json.loads(farm.cli("jobs", "--json").stdout)
    assert rows[0]["id"] == job and rows[0]["state"] == "done" and rows[0]["done"] == 1


def test_workers_table_and_json(farm):
    text = farm.cli("workers").stdout.splitlines()
    assert text[0].split() == ["WORKER", "NAME", "HOST", "STATE", "JOB", "THREADS", "SPEED", "UNITS",
                               "LOST", "SEEN", "NOTE"]
    rows = json.loads(farm.cli("workers", "--json").stdout)
    assert {row["name"] for row in rows} >= {"alpha", "beta"}
    assert all(row["state"] in ("idle", "busy", "loading") for row in rows)


def test_empty_lists(empty):
    """Nothing there is not an error: stdout empty, a hint on stderr, [] as JSON."""
    for command, hint in (("jobs", "no jobs yet"), ("workers", "no workers yet")):
        done = empty.cli(command)
        assert done.returncode == 0 and done.stdout == "" and hint in done.stderr
        assert empty.cli(command, "--json").stdout.strip() == "[]"


def test_many_jobs_are_paged(empty):
    """50 rows unless --all; newest first; pages follow each other without gap or repeat."""
    ids = [empty.submit(SEED_SCENE, *SMALL, "--seed", n) for n in range(53)]
    assert len(empty.cli("jobs").stdout.splitlines()) == 51
    rows = json.loads(empty.cli("jobs", "--all", "--json").stdout)
    assert [row["id"] for row in rows] == ids[::-1]


def test_no_worker_is_said(empty):
    """A queued job says why it does not move, and watch says what would end the wait."""
    job = empty.submit(SEED_SCENE, *SMALL)
    assert empty.job(job)["state"] == "queued"
    process = empty.start_cli("watch", job)
    empty_worker = None
    try:
        with pytest.raises(subprocess.TimeoutExpired):
            process.communicate(timeout=3.5)
        empty_worker = empty.worker()
        _, err = process.communicate(timeout=60)
    finally:
        process.kill()
    assert empty_worker and process.returncode == 0, err
    assert json.loads(empty.cli("status", job, "--json").stdout)["state"] == "done"


def test_watch_follows_to_the_end(farm):
    job = farm.submit(GLASS_SCENE, "--size", "64x64", "--spp", samples(64))
    done = farm.cli("watch", job, "--json", timeout=120)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert lines[-1]["event"] == "end" and lines[-1]["exit"] == 0
    assert lines[-1]["report"]["state"] == "done"
    shares = [line["done"] for line in lines if line["event"] == "progress"]
    assert shares == sorted(shares) and shares[-1] == 1
    again = farm.cli("watch", job)
    assert again.returncode == 0 and "done in" in again.stderr


def test_cancel(farm, tmp_path):
    """Cancelled is 1 for who watches; the job can be tried again, and then is whole."""
    job = farm.submit(GLASS_SCENE, *LONG)
    watcher = farm.start_cli("watch", job)
    farm.wait_progress(job, 0)
    early = farm.cli("get", job, "-o", tmp_path / "early.exr")
    assert early.returncode == 1 and "% done" in early.stderr, early.stderr
    assert f"tilery watch {job}" in early.stderr and "partial" not in early.stderr
    assert not (tmp_path / "early.exr").exists()
    assert farm.cli("cancel", job).returncode == 0
    _, err = watcher.communicate(timeout=30)
    assert watcher.returncode == 1 and "cancelled" in err
    assert farm.job(job)["state"] == "cancelled"
    again = farm.cli("cancel", job)
    assert again.returncode in (0, 1)
    assert farm.cli("resume", job).returncode == 1
    late = farm.cli("get", job, "-o", tmp_path / "a.exr")
    assert late.returncode == 1 and "was cancelled" in late.stderr, late.stderr
    assert f"tilery retry {job}" in late.stderr and "partial" not in late.stderr


def test_retry_gives_the_same_bits(farm):
    job = farm.submit(GLASS_SCENE, "--size", "96x96", "--spp", samples(128))
    farm.wait_progress(job, 0)
    assert farm.cli("cancel", job).returncode == 0
    assert farm.cli("retry", job).returncode == 0
    report = farm.wait_job(job, timeout=120)
    again = farm.submit(GLASS_SCENE, "--size", "96x96", "--spp", samples(128))
    other = farm.wait_job(again, timeout=120)
    assert report["image_sha256"] == other["image_sha256"]
    assert farm.cli("retry", job).returncode == 1 # done: nothing to retry


def test_pause_resume_priority(farm):
    first = farm.submit(GLASS_SCENE, *LONG, "--name", "first")
    farm.wait_progress(first, 0)
    done = farm.cli("pause", first)
    assert done.returncode == 0 and f"tilery resume {first}" in done.stderr, done.stderr
    wait_until(lambda: farm.job(first)["state"] == "paused", "the job to pause")
    second = farm.submit(SEED_SCENE, *SMALL, "--name", "second")
    farm.wait_job(second)
    before = farm.job(first)["done"]
    assert farm.cli("priority", first, "-3").returncode == 0
    assert farm.job(first)["priority"] == -3
    assert farm.cli("resume", first).returncode == 0
    wait_until(lambda: farm.job(first)["done"] > before, "the job to go on", 30)
    assert farm.cli("cancel", first).returncode == 0


def test_drain(empty, tmp_path):
    """A drained worker finishes what it holds and leaves; the others go on."""
    staying, leaving = empty.worker(name="staying"), empty.worker(name="leaving")
    job = empty.submit(GLASS_SCENE, "--size", "96x96", "--spp", samples(256))
    empty.wait_progress(job, 0)
    assert empty.cli("drain", leaving.id).returncode == 0
    empty.wait_job(job, timeout=120)
    assert staying.process.poll() is None
    rows = json.loads(empty.cli("workers", "--json").stdout)
    states = {row["id"]: row["state"] for row in rows}
    assert states.get(leaving.id, "lost") in ("draining", "lost")
    assert empty.cli("drain", "w999").returncode == 4


def test_unknown_job(farm, tmp_path):
    for arguments in (("status", "j99999"), ("watch", "j99999"), ("cancel", "j99999"),
                      ("retry", "j99999"), ("priority", "j99999", "1"), ("status", "../x"),
                      ("get", "j99999", "-o", str(tmp_path / "a.exr"))):
        done = farm.cli(*arguments)
        assert done.returncode == 4, (arguments, done.stderr)
        assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_no_farm(tmp_path):
    """Unset, refused, no host, no HTTP: exit 4 and what to do, never an empty list."""
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    done = tilery("jobs")
    assert done.returncode == 4 and "TILERY_MASTER" in done.stderr and done.stdout == ""
    done = tilery("jobs", env=clean_env(TILERY_MASTER=f"http://127.0.0.1:{port}"))
    assert done.returncode == 4 and "connection refused" in done.stderr
    assert "tilery-master running?" in done.stderr and "[no-master]" in done.stderr
    done = tilery("jobs", "--master", f"127.0.0.1:{port}", "--json")
    assert done.returncode == 4 and "--master" in done.stderr and done.stdout == ""
    done = tilery("jobs", env=clean_env(TILERY_MASTER="ftp://x"))
    assert done.returncode == 2


def test_not_a_master():
    """A server that speaks something else is named as such."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(1)
        url = f"http://127.0.0.1:{server.getsockname()[1]}"
        process = subprocess.Popen([str(BIN / "tilery"), "jobs"], env=clean_env(TILERY_MASTER=url),
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        peer, _ = server.accept()
        peer.recv(4096)
        peer.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nhello")
        _, err = process.communicate(timeout=30)
        peer.close()
    assert process.returncode == 4 and "[bad-reply]" in err


def test_token(tmp_path):
    """A farm with a token lets in who has it, and nobody's token is ever printed."""
    secret = "correct-horse-battery"
    with Farm(tmp_path, token=secret) as farm:
        farm.worker()
        assert farm.cli("jobs").returncode == 0
        for env in (clean_env(TILERY_MASTER=farm.url),
                    clean_env(TILERY_MASTER=farm.url, TILERY_TOKEN="wrong-secret-word")):
            done = farm.cli("jobs", env=env)
            assert done.returncode == 4 and "[bad-token]" in done.stderr and done.stdout == ""
            assert "wrong-secret-word" not in done.stderr
        path = tmp_path / "mine"
        path.write_text(secret + "\n")
        env = clean_env(TILERY_MASTER=farm.url)
        assert farm.cli("jobs", "--token-file", path, env=env).returncode == 0
        assert farm.cli("jobs", "--token-file", tmp_path / "none", env=env).returncode == 2
        settings = farm.cli("help", "settings")
        assert settings.returncode == 0 and secret not in settings.stdout
        lost = farm.worker(wait=False)
        lost.process.terminate()
        assert secret not in farm.master.log()


def test_worker_with_the_wrong_token(tmp_path):
    with Farm(tmp_path, token="the-right-token") as farm:
        wrong = Daemon("wrong", ["tilery-worker", "--master", farm.listen, "--threads", 1],
                       tmp_path / "wrong.log", clean_env(TILERY_TOKEN="another-token"))
        farm.workers.append(wrong)
        assert wrong.process.wait(20) == 4
        assert "token" in wrong.log() and "another-token" not in wrong.log()


def test_determinism_refusal(tmp_path):
    """A worker whose pictures would differ is refused by name, and says so with exit 4."""
    with Farm(tmp_path, master_arguments=("--determinism-id", "0" * 64)) as farm:
        worker = farm.worker(wait=False)
        assert worker.process.wait(20) == 4
        assert "determinism" in worker.log()
        assert json.loads(farm.cli("workers", "--json").stdout) == [] or all(
            row["state"] == "lost" for row in json.loads(farm.cli("workers", "--json").stdout))


def test_gone_workers_are_forgotten(tmp_path):
    """A worker that left, and one that was lost, go from the list after a while; those at work
    stay, and one that returns has its id."""
    with Farm(tmp_path, master_arguments=("--keep-lost", "2")) as farm:
        def states():
            rows = json.loads(farm.cli("workers", "--json").stdout)
            return {row["id"]: row["state"] for row in rows}

        stays, leaves, dies = farm.worker(), farm.worker(), farm.worker()
        leaves.signal(signal.SIGTERM)
        dies.signal(signal.SIGKILL)
        wait_until(lambda: states().get(dies.id) == "lost", "the loss to be seen")
        assert leaves.id in states()
        wait_until(lambda: list(states()) == [stays.id], "those that are gone to be forgotten")
        stays.signal(signal.SIGSTOP)
        wait_until(lambda: not states(), "the silent one to be forgotten")
        stays.signal(signal.SIGCONT)
        wait_until(lambda: states() == {stays.id: "idle"}, "its return")


def test_ctrl_c_leaves_the_job_alone(farm):
    """watch and submit --wait: 130, the job goes on, and how to stop it is said."""
    job = farm.submit(GLASS_SCENE, *LONG)
    process = farm.start_cli("watch", job)
    farm.wait_progress(job, 0)
    interrupt(process)
    _, err = process.communicate(timeout=10)
    assert process.returncode == 130
    assert f"{job} goes on; stop it: tilery cancel {job}" in err
    assert farm.job(job)["state"] == "rendering"
    assert farm.cli("cancel", job).returncode == 0


def test_master_address_in_use(tmp_path, farm):
    """A master that cannot bind: exit 5, the address named."""
    other = Daemon("second", ["tilery-master", "--listen", farm.listen, "--http", "127.0.0.1:0",
                              "--data", tmp_path / "data"], tmp_path / "log", clean_env())
    try:
        assert other.process.wait(20) == 5
        assert farm.listen in other.log()
    finally:
        other.kill()


def test_data_folder_in_use(tmp_path, farm):
    """Two masters on one data folder would ruin it: the second is refused."""
    other = Daemon("second", ["tilery-master", "--listen", "127.0.0.1:0", "--http", "127.0.0.1:0",
                              "--data", farm.data], tmp_path / "log", clean_env())
    try:
        assert other.process.wait(20) != 0
    finally:
        other.kill()


def test_public_address_needs_a_token(tmp_path):
    done = subprocess.run([str(BIN / "tilery-master"), "--listen", "0.0.0.0:0", "--http",
                           "127.0.0.1:0", "--data", str(tmp_path / "d")], env=clean_env(),
                          capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2 and "--token-file" in done.stderr


def test_sigterm_ends_daemons_with_0(tmp_path):
    with Farm(tmp_path) as farm:
        worker = farm.worker()
        assert worker.end() == 0
        assert farm.master.end() == 0


def test_compare(farm, tmp_path):
    """The metrics, against the same formulas in numpy; exit statuses; heat map."""
    for seed in (1, 2):
        done = tilery("render", GLASS_SCENE, "-o", tmp_path / f"{seed}.exr", "--size", "64x48",
                      "--spp", "8", "--seed", seed)
        assert done.returncode == 0, done.stderr
    a, b = tmp_path / "1.exr", tmp_path / "2.exr"
    done = tilery("compare", a, b, "--json", "--heatmap", tmp_path / "heat.png")
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)
    x, r = exr_pixels.rgb(a).astype(float), exr_pixels.rgb(b).astype(float)
    relative = (x - r) ** 2 / (r ** 2 + 0.01 * r.mean() ** 2)
    per_pixel = numpy.sort(relative.mean(axis=2).ravel())
    expected = {
        "rmse": numpy.sqrt(((x - r) ** 2).mean()),
        "relmse": relative.mean(),
        "relmse_trimmed": per_pixel[:per_pixel.size - per_pixel.size // 1000].mean(),
        "mape": (abs(x - r) / (abs(r) + 0.01 * r.mean())).mean(),
        "psnr": 10 * numpy.log10(1 / ((display(x) - display(r)) ** 2).mean()),
        "ssim": ssim(display(x), display(r)),
        "mean_a": x.mean(), "mean_b": r.mean(),
    }
    for key, value in expected.items():
        assert got[key] == pytest.approx(value, rel=1e-4), key
    at = numpy.unravel_index(abs(x - r).argmax(), x.shape)
    assert got["max_difference"]["value"] == pytest.approx(abs(x - r).max(), rel=1e-6)
    assert (got["max_difference"]["y"], got["max_difference"]["x"]) == at[:2]
    assert got["identical"] is False
    assert (tmp_path / "heat.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert tilery("compare", a, b, "--identical").returncode == 1
    assert tilery("compare", a, a, "--identical").returncode == 0
    assert tilery("compare", a, b, "--max-relmse", got["relmse"] * 1.01).returncode == 0
    done = tilery("compare", a, b, "--max-relmse", got["relmse"] * 0.99)
    assert done.returncode == 1 and "did not hold" in done.stderr
    (tmp_path / "bad.exr").write_bytes(a.read_bytes()[:200])
    done = tilery("compare", tmp_path / "bad.exr", tmp_path / "none.exr")
    assert done.returncode == 3 and "bad.exr" in done.stderr and "none.exr" in done.stderr


def test_compare_with_holes(tmp_path):
    """A value that is not finite is why a limit does not hold, and is said to be."""
    pixels = numpy.full((4, 6, 3), 0.5, dtype=numpy.float32)
    exr_pixels.write(tmp_path / "whole.exr", pixels)
    pixels[1, 2, 0] = numpy.nan
    exr_pixels.write(tmp_path / "hole.exr", pixels)
    done = tilery("compare", tmp_path / "hole.exr", tmp_path / "whole.exr", "--max-relmse", "1000")
    assert done.returncode == 1
    assert "did not hold: values that are not finite" in done.stderr, done.stderr


def test_flip(tmp_path):
    """HDR-FLIP against the figures of its authors' program (flip-evaluator 1.x, 67 ppd, ACES)."""
    y, x = numpy.mgrid[0:48, 0:72].astype(float)
    reference = numpy.stack([4 ** (x / 24) * (0.6 + 0.4 * numpy.sin(y / 3)),
                             1.5 + numpy.cos(x / 2 + y / 5), 0.02 * x + (y > 24)], axis=-1)
    test = reference * (1 + 0.2 * numpy.sin(x * 1.7 + y * 0.9))[..., None]
    test[10:14, 30:34] = 20
    test[30, 5] = 0
    exr_pixels.write(tmp_path / "test.exr", test)
    exr_pixels.write(tmp_path / "reference.exr", reference)
    done = tilery("compare", tmp_path / "test.exr", tmp_path / "reference.exr", "--flip", "--json")
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)
    assert got["flip_mean"] == pytest.approx(0.0738340, abs=2e-6)
    assert got["flip_p95"] == pytest.approx(0.1453189, abs=2e-5)
    done = tilery("compare", tmp_path / "test.exr", tmp_path / "test.exr", "--flip", "--json")
    assert json.loads(done.stdout)["flip_mean"] == 0


def display(linear):
    linear = numpy.clip(linear, 0, 1)
    return numpy.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def ssim(x, r):
    """Wang et al. 2004 on luma, 11 x 11 Gaussian, borders repeated."""
    weights = numpy.array([0.2126, 0.7152, 0.0722])
    taps = numpy.exp(-numpy.arange(-5, 6) ** 2 / (2 * 1.5 ** 2))
    taps /= taps.sum()

    def blur(plane):
        for axis in (0, 1):
            padded = numpy.pad(plane, [(5, 5) if k == axis else (0, 0) for k in (0, 1)], "edge")
            plane = sum(t * numpy.take(padded, range(i, i + plane.shape[axis]), axis)
                        for i, t in enumerate(taps))
        return plane

    x, r = x @ weights, r @ weights
    mx, mr = blur(x), blur(r)
    vx, vr, cov = blur(x * x) - mx ** 2, blur(r * r) - mr ** 2, blur(x * r) - mx * mr
    c1, c2 = 0.01 ** 2, 0.03 ** 2
    return ((2 * mx * mr + c1) * (2 * cov + c2) /
            ((mx ** 2 + mr ** 2 + c1) * (vx + vr + c2))).mean()
