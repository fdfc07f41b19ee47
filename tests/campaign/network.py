#!/usr/bin/env python3
"""network.py faults [ROUNDS] | slow [CONNECTIONS]: what networks do to a farm.

faults: every fault of tests/e2e/proxy.py, ROUNDS times from other seeds, each with two workers behind
it; the picture must be that of an undisturbed farm. slow: CONNECTIONS to the worker port send one
byte a second and never a hello, coming back when they are closed; rounds with and without them
alternate. What they take from two good workers is the processor time that the master spends on them,
which must stay below 5 % of a core; wall times are told, but the strangers of this script run on
the same cores. The master's memory must stay below its cap.
"""
import os
import socket
import statistics
import sys
import tempfile
import threading
import time

from common import GLASS_SCENE, SEED_SCENE, Farm, golden_of, put_figures, scratch
import proxy as faulty

WORK = ("--size", "96x96", "--spp", 32, "--tile", 8)
LASTING = ("delay", "throttle", "split")
# A few seconds on two workers of one thread.
LOAD = ("--size", "96x96", "--spp", 192)
# What 1,000 strangers may cost a master before they have said who they are: 64 KiB each.
STRANGER_BYTES = 64 << 10


def faults(rounds):
    golden = golden_of(WORK)["image_sha256"]
    for name in sorted(faulty.FAULTS):
        struck = 0
        for seed in range(rounds):
            count = None if name in LASTING else 3
            with scratch() as folder, Farm(folder) as farm, \
                    faulty.Proxy(farm.listen, faulty.FAULTS[name], count, seed) as proxy:
                for _ in range(2):
                    farm.worker(wait=False, master=proxy.address)
                report = farm.wait_job(farm.submit(SEED_SCENE, *WORK), timeout=120)
                assert report["image_sha256"] == golden, (name, seed)
                assert farm.master.process.poll() is None, farm.master.log()
                struck += proxy.injected > 0
        put_figures(kind="network", fault=name, runs=rounds, struck=struck)


class Strangers:
    """Connections that send a byte a second and are opened again when they are closed."""

    def __init__(self, address, count):
        host, port = address.split(":")
        self.target, self.count = (host, int(port)), count
        self.ended, self.opened, self.socks = False, 0, []
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _open(self):
        sock = socket.socket()
        sock.setblocking(False)
        sock.connect_ex(self.target)
        self.opened += 1
        return sock

    def _run(self):
        self.socks = [self._open() for _ in range(self.count)]
        while not self.ended:
            begin = time.monotonic()
            for i, sock in enumerate(self.socks):
                try:
                    sock.send(b"T")
                except BlockingIOError:
                    continue
                except OSError:
                    sock.close()
                    self.socks[i] = self._open()
            time.sleep(max(0.0, 1.0 - (time.monotonic() - begin)))

    def end(self):
        self.ended = True
        self.thread.join()
        for sock in self.socks:
            sock.close()


def memory_bytes(pid):
    with open(f"/proc/{pid}/status", encoding="ascii") as file:
        return next(int(line.split()[1]) * 1024 for line in file if line.startswith("VmRSS"))


def processor_seconds(pid):
    """User and system time of a process so far."""
    with open(f"/proc/{pid}/stat", encoding="ascii") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def seconds_of(farm, load):
    """Wall time of a job, the master's processor time for it, and its hash."""
    begin, before = time.monotonic(), processor_seconds(farm.master.pid)
    report = farm.wait_job(farm.submit(GLASS_SCENE, *load), timeout=120)
    return (time.monotonic() - begin, processor_seconds(farm.master.pid) - before,
            report["image_sha256"])


def idle_share(farm, seconds):
    """The share of a core that the master takes while no job runs."""
    before = processor_seconds(farm.master.pid)
    time.sleep(seconds)
    return (processor_seconds(farm.master.pid) - before) / seconds


def slow(count, rounds=5, load=LOAD, idle_s=10.0):
    ratios, shas, memory, opened, alone_cpu, crowded_cpu, idle = [], set(), [], 0, [], [], []
    with tempfile.TemporaryDirectory() as folder, Farm(folder) as farm:
        for _ in range(2):
            farm.worker()
        seconds_of(farm, load)  # scene sent, speeds known
        quiet_bytes = memory_bytes(farm.master.pid)
        for _ in range(rounds):
            alone, cpu, sha = seconds_of(farm, load)
            alone_cpu.append(cpu)
            strangers = Strangers(farm.listen, count)
            try:
                time.sleep(0.5)
                crowded, cpu, sha2 = seconds_of(farm, load)
                crowded_cpu.append(cpu)
                idle.append(idle_share(farm, idle_s))
                memory.append(memory_bytes(farm.master.pid))
            finally:
                strangers.end()
            opened += strangers.opened
            ratios.append(alone / crowded)
            shas |= {sha, sha2}
            time.sleep(0.5)
        assert len(shas) == 1
        assert farm.master.process.poll() is None, farm.master.log()
    cap = quiet_bytes + count * STRANGER_BYTES + (32 << 20)
    assert max(memory) <= cap, (max(memory), cap)
    assert statistics.median(idle) <= 0.05, idle
    put_figures(kind="slow-connections", connections=count, opened=opened, rounds=rounds,
                throughput_median=round(statistics.median(ratios), 3),
                throughput_min=round(min(ratios), 3), throughput_max=round(max(ratios), 3),
                master_core_share=round(statistics.median(idle), 4),
                master_cpu_s=round(statistics.median(crowded_cpu), 3),
                master_cpu_s_alone=round(statistics.median(alone_cpu), 3),
                master_quiet_mb=round(quiet_bytes / 1e6, 1), master_mb=round(max(memory) / 1e6, 1))


def main():
    what = sys.argv[1]
    number = int(sys.argv[2]) if len(sys.argv) > 2 else {"faults": 20, "slow": 1000}[what]
    print(f"network: {what} {number}", flush=True)
    {"faults": faults, "slow": slow}[what](number)


if __name__ == "__main__":
    main()
