#!/bin/sh
# symbols.sh LIBRARY PATTERN: fails when the static library needs a symbol that its room must not
# touch. PATTERN is an extended regular expression of whole symbol names.
set -eu
library=$1
pattern=$2
symbols=$(nm -u "$library" | awk '$1 == "U" { print $2 }' | sort -u)
[ -n "$symbols" ] || {
    echo "symbols: $library has no undefined symbol at all: wrong file?" >&2
    exit 1
}
if echo "$symbols" | grep -Ex "$pattern"; then
    echo "symbols: $library needs the symbols above; its room is pure" >&2
    exit 1
fi
echo "symbols: $library is clean ($(echo "$symbols" | wc -l) symbols)"
