"""What the campaigns share: figures, a tiny job with a known picture, the shim, free ports.

Each campaign prints what it found and appends lines of JSON to the file that TILERY_FIGURES names;
tests/campaign/figures.py makes docs/RELIABILITY.md of them.
"""
import json
import os
import pathlib
import socket
import statistics
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "e2e"))

# pylint: disable=wrong-import-position
from farm import BIN, GLASS_SCENE, SEED_SCENE, SLOW, Farm, report_of, tilery  # noqa: E402

TINY = ("--size", "48x48", "--spp", 32, "--tile", 8)     # some 40 ms of one core, 72 spots
SMALL = ("--size", "96x96", "--spp", 64, "--tile", 8)  # a second of one core


def scratch():
    return tempfile.TemporaryDirectory(prefix="tilery-campaign-")


def golden_of(options, scene=SEED_SCENE):
    """The report of an undisturbed render."""
    with scratch() as folder:
        done = tilery("render", scene, "-o", f"{folder}/a.exr", "--report", f"{folder}/a.json",
                      "--quiet", *options, timeout=300)
        assert done.returncode == 0, done.stderr
        return report_of(f"{folder}/a.json")


def free_ports(count):
    """Addresses that nobody uses now, so that a master that dies before it speaks can be found."""
    socks = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    found = [f"127.0.0.1:{sock.getsockname()[1]}" for sock in socks]
    for sock in socks:
        sock.close()
    return found


def fixed_farm(folder):
    """A farm on ports that are known before its master runs; the master is not started."""
    farm = Farm(folder)
    farm.listen, farm.http = free_ports(2)
    return farm


def shim(what, memory=False, count=None):
    """The environment under which a program has a fault; see shim.c."""
    library = BIN / ("libtilery_shim_memory.so" if memory else "libtilery_shim.so")
    assert library.exists(), f"{library} is not built"
    env = {"LD_PRELOAD": library, "TILERY_SHIM": what,
           # Sanitizers want to be first; the shim passes on to them.
           "ASAN_OPTIONS": os.environ.get("ASAN_OPTIONS", "") + ":verify_asan_link_order=0"}
    if count:
        env["TILERY_SHIM_COUNT"] = count
    return env


def put_figures(**figures):
    """One line for people, one for figures.py."""
    print("  " + ", ".join(f"{key} {value}" for key, value in figures.items()), flush=True)
    path = os.environ.get("TILERY_FIGURES")
    if path:
        with open(path, "a", encoding="ascii") as file:
            file.write(json.dumps(figures) + "\n")


def spread(values):
    """Median, 95th percentile and maximum, in the values' unit."""
    if not values:
        return {"median": None, "p95": None, "max": None}
    ordered = sorted(values)
    return {"median": round(statistics.median(ordered), 4),
            "p95": round(ordered[min(len(ordered) - 1, int(0.95 * len(ordered)))], 4),
            "max": round(ordered[-1], 4)}


def metric(farm, name):
    status, text = farm.request("GET", "/metrics", raw=True)
    assert status == 200
    for line in text.decode().splitlines():
        if line.startswith(f"tilery_{name} "):
            return float(line.split()[1])
    raise AssertionError(f"no metric {name}")
