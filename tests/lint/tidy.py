#!/usr/bin/env python3
"""Checks house style that a compiler does not: lengths, banned functions, left-over marks.

usage: tidy.py [ROOT]; prints every breach as file:line and exits 1 if there is any.
A function may exceed LINES_FUNCTION only by name in LONG_FUNCTIONS, with the reason.
"""
import pathlib
import re
import subprocess
import sys

LINES_FUNCTION = 70
LINES_FILE = 800
COLUMNS = 100
LONG_FUNCTIONS = {}

BANNED = re.compile(
    r"\b(sprintf|vsprintf|strcpy|strcat|strncat|atoi|atol|atof|gets|rand|srand|alloca|strtok|malloc|"
    r"calloc|realloc|free|strdup)\s*\(")
ALLOC_HOME = {"common/mem.c"}
MARKS = re.compile(r"\b(TO" r"DO|FIX" r"ME|XX" r"X|HA" r"CK)\b")
HEAD = re.compile(r"^[A-Za-z_].*\)\s*$")
LITERAL = re.compile(r'"(?:\\.|[^"\\])*"|//.*$|/\*.*?\*/')
ROOMS = ("common", "proto", "master", "worker", "client")


def function_spans(lines):
    """Yields (name, first line, line count) of functions: a head at column 0, then '{' to '}'."""
    start = None
    for number, line in enumerate(lines, 1):
        if line.startswith("{") and start is None:
            head = number - 1
            while head > 1 and not re.match(r"^[A-Za-z_]", lines[head - 1]):
                head -= 1
            name = re.search(r"(\w+)\s*\(", lines[head - 1])
            start = (name.group(1) if name else "?", number)
        elif line.startswith("}") and start is not None:
            yield start[0], start[1], number - start[1] + 1
            start = None


def breaches_of(path, text):
    """Yields (line, text) for each breach in one source file."""
    lines = text.splitlines()
    if len(lines) > LINES_FILE:
        yield len(lines), f"{len(lines)} lines; split before {LINES_FILE}"
    in_comment = False
    for number, line in enumerate(lines, 1):
        if len(line) > COLUMNS and "http" not in line:
            yield number, f"{len(line)} columns; {COLUMNS} at most"
        if MARKS.search(line):
            yield number, "a left-over mark; open an issue instead"
        code = LITERAL.sub("", line)
        if "/*" in code:
            in_comment = True
        banned = None if in_comment else BANNED.search(code)
        if "*/" in line:
            in_comment = False
        if banned and path not in ALLOC_HOME:
            yield number, f"{banned.group(1)}() is banned"
    for name, number, count in function_spans(lines):
        if count > LINES_FUNCTION and name not in LONG_FUNCTIONS:
            yield number, f"{name}() has {count} lines; {LINES_FUNCTION} at most"


def main():
    root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()
    files = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.c", "*.h"],
                           cwd=root, capture_output=True, text=True, check=False).stdout.split()
    if not files:
        files = [p.relative_to(root).as_posix() for p in root.rglob("*.[ch]")]
    failed = False
    names = {}
    for path in sorted(f for f in files if (root / f).exists()):
        text = (root / path).read_text()
        product = path.startswith(ROOMS)
        for number, what in breaches_of(path, text):
            if product or "banned" not in what:
                print(f"{path}:{number}: {what}")
                failed = True
        if product and not path.endswith("/main.c"):
            other = names.setdefault(pathlib.Path(path).name, path)
            if other != path:
                print(f"{path}:1: the file name is that of {other}; names are unique in the tree")
                failed = True
    print(f"tidy: {len(files)} files read")
    sys.exit(failed)


if __name__ == "__main__":
    main()
