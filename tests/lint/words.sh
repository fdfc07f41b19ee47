#!/bin/sh
# words.sh: nothing over 1 MiB, no build output, no absolute path of anybody's machine is committed.
set -eu
cd "${1:-.}"
status=0
git rev-parse --git-dir >/dev/null 2>&1 || {
    echo "words: not a git checkout" >&2
    exit 77
}
large=$(git ls-files -z | xargs -0 -r du -b 2>/dev/null | awk '$1 > 1048576')
[ -z "$large" ] || { echo "over 1 MiB: $large"; status=1; }
built=$(git ls-files | grep -E '\.(o|a|so|pyc|exe)$|^build/' || true)
[ -z "$built" ] || { echo "build output: $built"; status=1; }
paths=$(git grep -nIE '/(home|Users)/[a-z]+/' -- . ':!tests/lint/words.sh' || true)
[ -z "$paths" ] || { echo "paths of a machine: $paths"; status=1; }
[ "$status" != 0 ] || echo "words: clean"
exit $status
