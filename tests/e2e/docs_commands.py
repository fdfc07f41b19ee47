"""The commands that README.md and docs/TUTORIAL.md print, run as they stand.

  docs_commands.py FILE [HEADING]           runs them; a status or a printed line that differs fails
  docs_commands.py --renew FILE [HEADING]   and puts today's lines in the place of those

Indented blocks are read, below HEADING alone where one is given. Where lines begin with "$ ", those
are commands ("> " goes on), and the others what they print, shortened: each must be among what
is printed now, but for lines of times, speeds and counts of units, which differ from run to run.
Ports are exchanged for free ones, and what takes long is given a bound.
"""
import pathlib
import re
import socket
import subprocess
import sys
import tempfile

from farm import BIN, ROOT, clean_env

# Set-up, and what only a person can do.
SKIPPED = re.compile(r"\./run\.sh|\./test\.sh|export PATH=")
VOLATILE = re.compile(r"\d s\b|core-s|ray/s|Mr/s|units|^ *\d+%|^WORKER|^\.\.\.|^w\d| lost | lost:")
BOUNDS = ((r"(tilery tradeoff .*?)( *#.*)?$", r"\1 --budget 30 --size 48x32"),)
FAILS = re.compile(r"--aov dept$")  # the tutorial's mistake


class Command:
    """A command, and the lines that are said to follow: (number in the file, text)."""

    def __init__(self, text):
        self.text, self.printed = text, []


def commands_of(lines, heading):
    """The commands of a document."""
    found, below, prompted = [], heading is None, False
    for number, line in enumerate(lines):
        if heading and line.startswith("## "):
            below = line == "## " + heading
        if not line.startswith("    ") or not below:
            prompted = False if line and not line.startswith("    ") else prompted
            continue
        text = line[4:]
        if text.startswith("$ "):
            found.append(Command(text[2:]))
            prompted = True
        elif text.startswith("> ") and prompted:
            found[-1].text += "\n" + text[2:]
        elif prompted:
            found[-1].printed.append((number, text))
        else:
            found.append(Command(text))
    return [c for c in found if not SKIPPED.match(c.text)]


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def script_of(commands):
    """One shell runs them all, and marks where each begins and ends."""
    workers, people = free_port(), free_port()
    text = ["exec 2>&1"]
    for i, c in enumerate(commands):
        command = c.text
        for pattern, replacement in BOUNDS:
            command = re.sub(pattern, replacement, command)
        command = command.replace("tilery-master ", f"tilery-master --listen 127.0.0.1:{workers} "
                                                    f"--http 127.0.0.1:{people} ")
        command = command.replace("127.0.0.1:7000", f"127.0.0.1:{workers}")
        command = command.replace("127.0.0.1:8080", f"127.0.0.1:{people}")
        # A daemon's log is not what the document shows.
        command = re.sub(r" &( |$)", r" >daemons.log 2>\&1 &\1", command)
        text += [f"echo '@@ {i}'", command, f"status=$?; echo; echo \"@@ {i} $status\""]
        if command.startswith("tilery-master"):
            text.append(f"until tilery jobs --master http://127.0.0.1:{people} >/dev/null 2>&1; "
                        "do sleep 0.1; done")
    text.append("kill $(jobs -p) 2>/dev/null; wait; exit 0")
    return "\n".join(text)


def run(commands, folder):
    """What each command printed, and its status."""
    (folder / "scenes").symlink_to(ROOT / "scenes")
    env = clean_env()
    env["PATH"] = f"{BIN}:{env['PATH']}"
    done = subprocess.run(["bash", "-c", script_of(commands)], cwd=folder, env=env, text=True,
                          stdout=subprocess.PIPE, timeout=600, check=True)
    results = []
    for i in range(len(commands)):
        match = re.search(rf"^@@ {i}\n(.*)^@@ {i} (\d+)$", done.stdout, re.S | re.M)
        assert match, f"no end of: {commands[i].text}\n{done.stdout}"
        results.append((match.group(1).splitlines(), int(match.group(2))))
    return results


def differences(command, printed, status):
    """Texts of what is not as the document says, and (line number, today's line or None)."""
    fails = bool(FAILS.search(command.text))
    if (status != 0) != fails:
        yield f"status {status}: {command.text}\n" + "\n".join(printed), None, None
    now = [line.rstrip() for line in printed]
    for number, line in command.printed:
        if VOLATILE.search(line.strip()) or line.rstrip() in now:
            continue
        word = line.split()[:1]
        other = next((n for n in now if n.split()[:1] == word), None)
        yield (f"line {number + 1} is not printed: {line}\n  {command.text}\n  today: {other}",
               number, other)


def check(path, heading=None, renew=False):
    """Runs a document; the differences, as texts."""
    path = pathlib.Path(path)
    lines = path.read_text().split("\n")
    commands = commands_of(lines, heading)
    assert commands, f"no commands in {path}"
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for command, result in zip(commands, run(commands, pathlib.Path(folder))):
            for text, number, other in differences(command, *result):
                if renew and other is not None:
                    lines[number] = "    " + other
                else:
                    found.append(text)
    if renew:
        path.write_text("\n".join(lines))
    return found


if __name__ == "__main__":
    arguments = [a for a in sys.argv[1:] if a != "--renew"]
    wrong = check(*arguments, renew="--renew" in sys.argv)
    print("\n".join(wrong) or "as it says")
    sys.exit(1 if wrong else 0)
