#!/bin/sh
# format.sh: every C file is as clang-format (the version of Debian 12) leaves it.
# With --fix, makes it so.
set -eu
mode='--dry-run -Werror'
if [ "${1-}" = --fix ]; then
    mode=-i
fi
# shellcheck disable=SC2086 # options
git ls-files '*.c' '*.h' | xargs -r clang-format-14 $mode
