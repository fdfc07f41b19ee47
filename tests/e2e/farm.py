"""Real farms for end-to-end tests: masters and workers on ports of the system's choice.

Programs come from TILERY_BIN. Everything binds loopback; every process that a test starts is
ended by its own id when the Farm closes, whatever the test did.
"""
import json
import os
import pathlib
import resource
import signal
import subprocess
import time
import urllib.error
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("TILERY_BIN", ROOT / "build/release/bin"))
SCENES = ROOT / "scenes"
SEED_SCENE = SCENES / "cbox_no_light_refract.json"
GLASS_SCENE = SCENES / "glass_cbox.json"
# Sanitizers make everything slower; waits, not results, depend on it.
SLOW = 6 if os.environ.get("TILERY_SANITIZED") else 1


def samples(spp):
    """Samples per pixel of a render that must last some seconds: fewer where each costs more."""
    return max(8, spp // 8) if SLOW > 1 else spp


def clean_env(**extra):
    """The environment without what would change the programs' behaviour."""
    env = {k: v for k, v in os.environ.items()
           if not k.startswith("TILERY_") and k not in ("NO_COLOR", "COLUMNS", "XDG_CONFIG_HOME")}
    env["XDG_CONFIG_HOME"] = "/nonexistent"
    env["TERM"] = "dumb"
    env.update({k: str(v) for k, v in extra.items()})
    return env


def tilery(*args, env=None, timeout=60, **kwargs):
    """Runs the CLI to its end; the CompletedProcess with texts."""
    return subprocess.run([str(BIN / "tilery"), *map(str, args)], env=env or clean_env(),
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          timeout=timeout * SLOW, check=False, **kwargs)


def start_tilery(*args, env=None, **kwargs):
    """Starts the CLI; the Popen."""
    return subprocess.Popen([str(BIN / "tilery"), *map(str, args)], env=env or clean_env(),
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **kwargs)


def wait_until(condition, what, timeout=20.0, step=0.02):
    """Waits for a condition; its value once it is true. Fails by name after the time."""
    end = time.monotonic() + timeout * SLOW
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < end, f"waited {timeout * SLOW:.0f} s for {what}"
        time.sleep(step)


class Daemon:
    """One child process with a line of JSON on its standard output and a log file."""

    def __init__(self, name, arguments, log, env, files=None):
        """`files`: its limit of open files."""
        self.name, self.log_path = name, log

        def limit():
            resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
        with open(log, "ab") as log_file:
            self.process = subprocess.Popen([str(BIN / arguments[0]), *map(str, arguments[1:])],
                                            stdout=subprocess.PIPE, stderr=log_file, env=env,
                                            preexec_fn=limit if files else None)
        self.pid = self.process.pid
        os.set_blocking(self.process.stdout.fileno(), False)
        self.buffer = b""

    def line(self, timeout=20):
        """The first line it prints, as JSON."""
        def read():
            self.buffer += self.process.stdout.read() or b""
            assert self.process.poll() is None, f"{self.name} ended: {self.log()}"
            return b"\n" in self.buffer
        wait_until(read, f"the line of {self.name}", timeout)
        return json.loads(self.buffer.split(b"\n")[0])

    def log(self):
        return pathlib.Path(self.log_path).read_text(errors="replace")

    def signal(self, number):
        self.process.send_signal(number)

    def kill(self):
        """SIGKILL, and collected."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def end(self, timeout=10):
        """SIGTERM; the exit status."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            status = self.process.wait(timeout * SLOW)
        finally:
            if self.process.poll() is None:
                self.process.kill()
                self.process.wait()
            self.process.stdout.close()
        return status


class Farm:
    """A master and its workers in a folder of their own.

    with Farm(tmp_path) as farm:
        farm.worker(threads=1)
        job = farm.submit(SCENE, "--spp", 4)
    """

    def __init__(self, folder, token=None, master_arguments=()):
        self.folder = pathlib.Path(folder)
        self.data = self.folder / "master"
        self.token = token
        self.master_arguments = list(master_arguments)
        self.listen = self.http = "127.0.0.1:0"
        self.workers, self.count = [], 0
        self.master = None

    def __enter__(self):
        try:
            self.start_master()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *unused):
        self.close()

    def close(self):
        for worker in self.workers:
            worker.kill()
        if self.master:
            self.master.kill()
        self.workers, self.master = [], None

    def start_master(self, env=None, wait=True, files=None):
        """Starts the master; again on the ports it had. `env`: more of the environment."""
        arguments = ["tilery-master", "--listen", self.listen, "--http", self.http,
                     "--data", self.data, *self.master_arguments]
        if self.token:
            path = self.folder / "token"
            path.write_text(self.token + "\n")
            path.chmod(0o600)
            arguments += ["--token-file", path]
        self.master = Daemon("master", arguments, self.folder / "master.log",
                             clean_env(**(env or {})), files)
        if wait:
            said = self.master.line()
            self.listen, self.http = said["listen"], said["http"]
        return self.master

    def kill_master(self):
        self.master.kill()

    def worker(self, threads=1, name=None, wait=True, arguments=(), master=None, env=None):
        """Starts a worker; waits until it is registered unless told otherwise. `master`: the
        address where it finds one, in place of the farm's. `env`: more of the environment."""
        self.count += 1
        name = name or f"worker{self.count}"
        more = {"TILERY_TOKEN": self.token} if self.token else {}
        worker = Daemon(name, ["tilery-worker", "--master", master or self.listen, "--threads",
                               threads,
                               "--name", name, *arguments],
                        self.folder / f"{name}.log", clean_env(**more, **(env or {})))
        self.workers.append(worker)
        if wait:
            worker.id = worker.line()["worker"]
        return worker

    @property
    def url(self):
        return f"http://{self.http}"

    def env(self, **extra):
        """The environment in which the CLI finds this farm."""
        if self.token:
            extra.setdefault("TILERY_TOKEN", self.token)
        return clean_env(TILERY_MASTER=self.url, **extra)

    def cli(self, *args, **kwargs):
        return tilery(*args, env=kwargs.pop("env", None) or self.env(), **kwargs)

    def start_cli(self, *args, **kwargs):
        return start_tilery(*args, env=kwargs.pop("env", None) or self.env(), **kwargs)

    def submit(self, scene, *options):
        """Submits by the CLI; the job's id."""
        done = self.cli("submit", scene, *options)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    def request(self, method, path, body=None, raw=False):
        """One call of the API: (status, JSON or bytes)."""
        data = json.dumps(body).encode() if body is not None else None
        request = urllib.request.Request(self.url + path, data=data, method=method)
        if data is not None:
            request.add_header("Content-Type", "application/json")
        if self.token:
            request.add_header("Authorization", f"Bearer {self.token}")
        try:
            with urllib.request.urlopen(request, timeout=30 * SLOW) as reply:
                content = reply.read()
                return reply.status, content if raw or not content else json.loads(content)
        except urllib.error.HTTPError as error:
            content = error.read()
            try:
                return error.code, json.loads(content)
            except ValueError:
                return error.code, content

    def job(self, job):
        status, report = self.request("GET", f"/api/v1/jobs/{job}")
        assert status == 200, report
        return report

    def wait_job(self, job, state="done", timeout=60):
        """Waits for a state; the report. An end in another state fails at once."""
        def reached():
            report = self.job(job)
            if report["state"] == state:
                return report
            assert report["state"] not in ("done", "failed", "cancelled"), report
            return None
        return wait_until(reached, f"job {job} to be {state}", timeout, 0.05)

    def wait_progress(self, job, share, timeout=60):
        """Waits until more than that share is done; it must not have ended before."""
        def reached():
            report = self.job(job)
            assert report["state"] in ("queued", "rendering"), report["state"]
            return report if (report.get("done") or 0) > share else None
        return wait_until(reached, f"job {job} to pass {share:.0%}", timeout, 0.01)


def report_of(path):
    return json.loads(pathlib.Path(path).read_text())


def alive(pid):
    """True while a process exists and is no zombie."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def children_of(pid):
    """Process ids of the direct children."""
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat", encoding="ascii", errors="replace") as stat:
                    fields = stat.read().rsplit(")", 1)[1].split()
                if int(fields[1]) == pid and fields[0] != "Z":
                    found.append(int(entry))
            except OSError:
                continue
    return found


def name_of(pid):
    try:
        return pathlib.Path(f"/proc/{pid}/comm").read_text().strip()
    except OSError:
        return ""


def interrupt(process):
    """Ctrl-C, once the program listens to it."""
    def listens():
        text = pathlib.Path(f"/proc/{process.pid}/status").read_text()
        caught = int(text.split("SigCgt:")[1].split()[0], 16)
        return caught >> (signal.SIGINT - 1) & 1
    wait_until(listens, "the handler of Ctrl-C")
    process.send_signal(signal.SIGINT)
