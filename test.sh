#!/bin/sh
# test.sh: everything a newcomer needs to see the tests pass.
#
#   ./test.sh            install what is missing; build release, asan and clang; run every test
#   ./test.sh LABEL...   run only these ctest labels of the release build (unit prop render
#                        numerics golden fuzz sim e2e web lint)
#
# Real models are found through TILERY_TEST_DATA (default ../shared/data); tests that need them
# skip by name where they are absent. TILERY_NO_SKIP=1 (set by .ci/run) turns every skip into a
# failure.
set -eu
top=$(cd "$(dirname "$0")" && pwd)
cd "$top"
. scripts/packages.sh
: "${TILERY_TEST_DATA:=$top/../shared/data}"
export TILERY_TEST_DATA

# shellcheck disable=SC2086 # lists of words
install_packages $packages_build $packages_test
jobs=$(nproc)

build() { # PRESET: configure with the tests and build
    if [ ! -f "build/$1/build.ninja" ] || ! grep -q 'TILERY_TESTS:BOOL=ON' "build/$1/CMakeCache.txt"; then
        cmake --preset "$1" -DTILERY_TESTS=ON >/dev/null
    fi
    cmake --build --preset "$1" -- -j"$jobs" >"build/$1.log" 2>&1 || {
        tail -n 40 "build/$1.log" >&2
        echo "test.sh: the build '$1' failed: build/$1.log" >&2
        exit 1
    }
    echo "built $1"
}

run() { # PRESET ARGS...: ctest, and no silent skip under TILERY_NO_SKIP
    preset=$1
    shift
    echo "== ctest, build $preset: $*"
    log=build/$preset.ctest.log
    status=0
    ctest --preset "$preset" -j"$jobs" --no-tests=error "$@" >"$log" 2>&1 || status=$?
    cat "$log"
    if [ "${TILERY_NO_SKIP-}" = 1 ] && grep -q '\*\*\*Skipped' "$log"; then
        echo "test.sh: tests were skipped" >&2
        status=1
    fi
    return $status
}

mkdir -p build
build release
if [ $# -gt 0 ]; then
    labels=$(echo "$*" | tr ' ' '|')
    run release -L "^($labels)\$"
    exit
fi
build clang
build asan
failed=
TILERY_BIN_CLANG=$top/build/clang/bin
export TILERY_BIN_CLANG
run release || failed="$failed release"
run clang -L '^(unit|golden)$' || failed="$failed clang"
TILERY_SANITIZED=1 run asan -L '^(unit|fuzz|e2e)$' || failed="$failed asan"

if [ -n "$failed" ]; then
    echo "test.sh: failed in:$failed" >&2
    exit 1
fi
echo "test.sh: all passed"
