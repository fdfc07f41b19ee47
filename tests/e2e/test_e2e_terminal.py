"""What a terminal gets: a bar that fits, a cursor that comes back, colours only where wanted."""
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import time

import pytest

from farm import BIN, GLASS_SCENE, SLOW, Farm, clean_env, samples

WORK = ("--size", "96x96", "--spp", samples(128))
CSI = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class Terminal:
    """A program on a pseudo-terminal of a given size."""

    def __init__(self, arguments, env, columns=80, rows=24):
        self.main, side = pty.openpty()
        self.resize(columns, rows)
        self.process = subprocess.Popen([str(BIN / "tilery"), *map(str, arguments)], env=env,
                                        stdin=side, stdout=side, stderr=side,
                                        start_new_session=True)
        os.close(side)
        self.text = ""

    def resize(self, columns, rows):
        fcntl.ioctl(self.main, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def read(self, seconds):
        """Reads for so long, or until the program closes the terminal; True while it is open."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            ready, _, _ = select.select([self.main], [], [], 0.05)
            if ready:
                try:
                    data = os.read(self.main, 65536)
                except OSError:
                    return False
                if not data:
                    return False
                self.text += data.decode(errors="replace")
        return True

    def finish(self, timeout=120):
        end = time.monotonic() + timeout * SLOW
        while self.read(0.2):
            assert time.monotonic() < end, "the program did not end"
        os.close(self.main)
        return self.process.wait(10)


def terminal_env(tmp_path, **extra):
    return clean_env(**{"TERM": "xterm-256color", "TMPDIR": tmp_path, "LANG": "C.UTF-8", **extra})


def paints(text):
    """What stood on the progress line, paint by paint."""
    return [CSI.sub("", part) for part in re.findall(r"\r([^\r\n]*)", text)
            if re.match(r"(\x1b\[[0-9;?]*[A-Za-z])*\s*\d+%", part)]


def test_bar(tmp_path):
    """A bar with percent, time left and rate, painted at most 5 times a second; cursor restored."""
    start = time.monotonic()
    terminal = Terminal(["render", GLASS_SCENE, "-o", tmp_path / "a.exr", *WORK],
                        terminal_env(tmp_path))
    assert terminal.finish() == 0, terminal.text
    seconds = time.monotonic() - start
    lines = paints(terminal.text)
    assert lines and all(len(line) < 80 for line in lines)
    assert any("[=" in line or "[>" in line for line in lines)
    # The time left is known after 2 s and 20 units, which a quick render need not have.
    assert seconds < 5 or any("left" in line or "starting" in line for line in lines)
    assert len(lines) <= 6 * seconds + 3
    shares = [int(line.split("%")[0]) for line in lines]
    assert shares == sorted(shares)
    assert terminal.text.count("\x1b[?25l") >= 1
    assert terminal.text.rindex("\x1b[?25h") > terminal.text.rindex("\x1b[?25l")
    assert "done in" in terminal.text


def test_narrow_and_resized(tmp_path):
    """The width is read at each paint: nothing wraps after the window shrinks."""
    terminal = Terminal(["render", GLASS_SCENE, "-o", tmp_path / "a.exr", "--size", "128x128",
                         "--spp", samples(256)], terminal_env(tmp_path), columns=100)
    terminal.read(1.0)
    terminal.resize(24, 24)
    terminal.read(0.4)
    before = len(terminal.text)
    assert terminal.finish() == 0
    tail = paints(terminal.text[before:])
    assert all(len(line) < 24 for line in tail), tail


def test_cursor_after_ctrl_c(tmp_path):
    terminal = Terminal(["render", GLASS_SCENE, "-o", tmp_path / "a.exr", "--size", "256x256",
                         "--spp", "4096"], terminal_env(tmp_path))
    end = time.monotonic() + 20 * SLOW
    while "\x1b[?25l" not in terminal.text and time.monotonic() < end:
        terminal.read(0.1)
    terminal.process.send_signal(signal.SIGINT)
    assert terminal.finish() == 130
    assert terminal.text.rindex("\x1b[?25h") > terminal.text.rindex("\x1b[?25l")
    assert "stopping 2 workers (again to kill)" in terminal.text


@pytest.mark.parametrize("options, env", [((), {"TERM": "dumb"}), (("--progress", "lines"), {})])
def test_plain_on_request(tmp_path, options, env):
    terminal = Terminal(["render", GLASS_SCENE, "-o", tmp_path / "a.exr", "--size", "48x48",
                         "--spp", "4", *options], terminal_env(tmp_path, **env))
    assert terminal.finish() == 0
    assert "\x1b" not in terminal.text and "100%" in terminal.text


def test_no_progress(tmp_path):
    terminal = Terminal(["render", GLASS_SCENE, "-o", tmp_path / "a.exr", "--size", "48x48",
                         "--spp", "4", "--progress", "none"], terminal_env(tmp_path))
    assert terminal.finish() == 0
    assert "%" not in terminal.text.split("done in")[0] and "\x1b" not in terminal.text


def test_watch_shows_the_picture(tmp_path):
    """Half blocks above the line, refined in place; the last picture stays."""
    with Farm(tmp_path) as farm:
        farm.worker()
        job = farm.submit(GLASS_SCENE, "--size", "128x128", "--spp", samples(256))
        env = terminal_env(tmp_path, TILERY_MASTER=farm.url, COLORTERM="truecolor")
        terminal = Terminal(["watch", job], env)
        assert terminal.finish(180) == 0, terminal.text[-2000:]
    assert terminal.text.count("\u2580") > 100
    assert "\x1b[38;2;" in terminal.text
    assert "\x1b[?1049h" not in terminal.text
    assert "done in" in terminal.text


def test_state_colours(tmp_path):
    """Only on a terminal, unless asked otherwise; NO_COLOR is obeyed."""
    with Farm(tmp_path) as farm:
        farm.worker()
        farm.wait_job(farm.submit(GLASS_SCENE, "--size", "32x32", "--spp", "2"))
        env = {"TILERY_MASTER": farm.url}
        shown = Terminal(["jobs"], terminal_env(tmp_path, **env))
        assert shown.finish() == 0 and "\x1b[32mdone\x1b[0m" in shown.text
        plain = Terminal(["jobs"], terminal_env(tmp_path, NO_COLOR=1, **env))
        assert plain.finish() == 0 and "\x1b" not in plain.text
        assert "\x1b" not in farm.cli("jobs").stdout
        assert "\x1b[32m" in farm.cli("jobs", "--color", "always").stdout
