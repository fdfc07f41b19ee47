#!/usr/bin/env python3
"""Every id of a problem has its anchor in docs/ERRORS.md, and no anchor is left over.

usage: check_error_ids.py ROOT. An id is a kebab-case literal among the arguments of a call whose
name says that it reports something; the anchors are the third-level headings.
"""
import pathlib
import re
import sys

root = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()
CALL = re.compile(r"\b(diag_add|json_get_problem|\w*(?:_problem|problem|_error|complain|import_fail|import_warn)|"
                  r"fail|warn)\s*\(([^;{}]*)")
ID = re.compile(r'[,?:(]\s*"([a-z]+[0-9]?(?:-[a-z0-9]+)+|unsupported)"\s*[,:)]')

page = (root / "docs/ERRORS.md").read_text()
anchors = set(re.findall(r"^### (\S+)$", page, re.M))
sources = [p for room in ("common", "client", "master", "worker", "proto") for p in sorted((root / room).rglob("*.[ch]"))]
literals, failed, calls = set(), False, 0
for path in sources:
    text = path.read_text()
    literals |= set(re.findall(r'"([a-z0-9-]+)"', text))
    for name, arguments in CALL.findall(text):
        for found in ID.findall(arguments):
            calls += 1
            if found not in anchors:
                print(f"{path.relative_to(root)}: {name}: [{found}] is not in docs/ERRORS.md")
                failed = True
assert calls > 60, calls
for anchor in sorted(anchors - literals):
    print(f"docs/ERRORS.md: {anchor} is reported nowhere")
    failed = True
print(f"error ids: {len(anchors)} anchors, {calls} uses")
sys.exit(failed)
