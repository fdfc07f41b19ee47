#!/bin/sh
# run.sh: the page in a real browser: Debian's Chromium, driven by Playwright from a venv of its own.
#
#   tests/web/run.sh [FOLDER]     pictures of each state go to FOLDER (default: none are kept)
#
# Told by TILERY_BIN where the programs are. Ends with 77 (skipped) without Chromium, or where the
# venv cannot be made: apt is all that a newcomer needs.
set -eu
top=$(cd "$(dirname "$0")/../.." && pwd)
command -v chromium >/dev/null || { echo "no chromium: skipped" >&2; exit 77; }
venv=$top/build/venv-web
if [ ! -x "$venv/bin/pytest" ]; then
    if ! { /usr/bin/python3 -m venv "$venv" &&
        "$venv/bin/pip" install -q --disable-pip-version-check pytest==8.3.4 playwright==1.49.1; }; then
        echo "no Playwright from PyPI (python3-venv, pip): skipped" >&2
        exit 77
    fi
fi
TILERY_WEB_PICTURES=${1-} exec "$venv/bin/pytest" -q -p no:cacheprovider "$top/tests/web"
