#!/bin/bash
# identity.sh [--long]: one hash of one small scene over cells, workers, threads, glibc's variants and
# builds. TILERY_BINS lists folders of programs (default: the build trees that are there); --long
# also builds gcc and clang at -O0, -O2 and -O3, and programs that use no AVX-512, or no AVX. Prints
# the count of renders; 1 if two differ.
set -eu
top=$(cd "$(dirname "$0")/../.." && pwd)
cd "$top"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
build() { # NAME COMPILER FLAGS: the programs in build/id-NAME
    cmake -S . -B "build/id-$1" -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_C_COMPILER="$2" \
        -DCMAKE_C_FLAGS_RELEASE="$3" >/dev/null
    cmake --build "build/id-$1" >"$scratch/build.log" 2>&1 || {
        tail -n 30 "$scratch/build.log"
        exit 1
    }
}
if [ "${1-}" = --long ]; then
    for compiler in gcc clang-14; do
        for level in 0 2 3; do
            build "$compiler-O$level" "$compiler" "-O$level"
        done
    done
    # Programs that find no more than SSE2, or AVX2, in any processor.
    build sse2 gcc "-O2 '-D__builtin_cpu_supports(f)=0'"
    build avx2 gcc "-O2 '-D__builtin_cpu_supports(f)=(f[3]!=53)'" # avx512f, avx512vl: f[3] is 5
fi
bins=${TILERY_BINS-$(ls -d build/*/bin)}
no_fma=glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F
count=0
first=
differ=0

render() { # BIN OPTIONS...: compares with the first
    local bin=$1 sha
    shift
    "$bin/tilery" render scenes/glass_cbox.json -o "$scratch/a.exr" --size 48x40 --spp 8 --quiet \
        --report "$scratch/a.json" "$@" 2>/dev/null
    sha=$(sed -n 's/.*"image_sha256":"\([0-9a-f]*\)".*/\1/p' "$scratch/a.json")
    [ -n "$sha" ] || { echo "identity: no report: $bin $*"; differ=1; return; }
    first=${first:-$sha}
    count=$((count + 1))
    [ "$sha" = "$first" ] || { echo "identity: $sha, not $first: $bin $*"; differ=1; }
}

builds=0
for bin in $bins; do
    [ -x "$bin/tilery" ] && [ -x "$bin/tilery-worker" ] || continue
    builds=$((builds + 1))
    for tile in 1 8 16 64 4096; do
        render "$bin" --tile $tile --workers 2 --threads 1
    done
    for workers in 1 2 4 8; do
        for threads in 1 2 3; do
            render "$bin" --tile 8 --workers $workers --threads $threads
        done
    done
    GLIBC_TUNABLES=$no_fma render "$bin" --tile 8
done
echo "identity: $count renders by $builds builds, $([ $differ = 0 ] && echo 'one hash' || echo 'NOT one hash')"
[ -z "${TILERY_FIGURES-}" ] || printf '{"kind": "identity", "renders": %d, "builds": %d, "differ": %d}\n' \
    $count $builds $differ >>"$TILERY_FIGURES"
exit $differ
