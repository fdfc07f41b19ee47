#!/usr/bin/env python3
"""tests_exist.py ROOT BUILD: every test that a header or a document names is one that runs.

A name such as `test_sched` or `e2e_campaign` must be a test of ctest, or a file that such a test runs
or is compiled of; a path below tests/ must exist. So "held by test X" is never stale.
"""
import json
import pathlib
import re
import subprocess
import sys

NAME = re.compile(r"\b(?:test|prop|sim|fuzz|e2e|lint|golden|numerics|web)_[a-z0-9_]*[a-z0-9]"
                  r"(?:\.(?:py|c|sh))?")
PATH = re.compile(r"\btests/[A-Za-z0-9_./*-]*[A-Za-z0-9_*]")
HEADER_ROOMS = ("common", "proto", "worker", "master", "client")


def tests_of(build):
    """Names of ctest, and all that their command lines say."""
    shown = subprocess.run(["ctest", "--show-only=json-v1"], cwd=build, check=True,
                           capture_output=True, text=True).stdout
    tests = json.loads(shown)["tests"]
    names = {test["name"] for test in tests}
    words = {pathlib.Path(word).name for test in tests for word in test.get("command", [])}
    return names, words


def compiled(root):
    """Every file that a CMake list names, by its last part."""
    lists = [*root.glob("tests/**/*.cmake"), *root.rglob("CMakeLists.txt")]
    return {pathlib.PurePath(word).name for path in lists if path.relative_to(root).parts[0] != "build"
            for word in re.findall(r"[\w./${}-]+", path.read_text(encoding="utf-8"))}


def comments(text):
    """The comments of a header, and where each begins."""
    return [(m.start(), m.group()) for m in re.finditer(r"/\*.*?\*/", text, re.S)]


def quoted(text):
    """What a document sets as code: `name`, and blocks of it."""
    return [(m.start(), m.group()) for m in re.finditer(r"`[^`\n]+`|^ {4}.*$", text, re.M)]


def exists(root, word, rest, known):
    """`rest`: what follows the word; test_t01_* stands for every name that begins so."""
    if word.startswith("tests/"):
        return any(root.glob(word)) or any(root.glob(f"{word}.*"))
    if rest.startswith(("*", "_*")):
        return any(name.startswith(word) for name in known)
    return word in known or f"{word}.c" in known


def problems_of(root, path, parts, known):
    lines = path.read_text(encoding="utf-8")
    for start, part in parts:
        for match in [*NAME.finditer(part), *PATH.finditer(part)]:
            # A name within a path is judged with it; test_thing() is a function.
            inside = match.start() > 0 and part[match.start() - 1] in "/.-"
            rest = part[match.end():]
            if inside or rest.startswith("(") or exists(root, match.group(), rest, known):
                continue
            line = lines.count("\n", 0, start + match.start()) + 1
            yield f"{path.relative_to(root)}:{line}: no test is called {match.group()}"


def main():
    root, build = map(pathlib.Path, sys.argv[1:3])
    names, words = tests_of(build)
    known = names | words | compiled(root)
    found = []
    headers = [path for room in HEADER_ROOMS for path in (root / room).rglob("*.h")]
    documents = [*root.glob("*.md"), *root.glob("docs/*.md")]
    for path in headers:
        found += problems_of(root, path, comments(path.read_text(encoding="utf-8")), known)
    for path in documents:
        found += problems_of(root, path, quoted(path.read_text(encoding="utf-8")), known)
    print(*found, sep="\n")
    print(f"tests_exist: {len(found)} of {len(headers)} headers and {len(documents)} documents")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
