#!/bin/sh
# compilers.sh: gcc's and clang's programs give one hash, apart and mixed in one farm, with glibc's
# FMA variants on and off.
#
# TILERY_BIN names one build's programs, TILERY_BIN_CLANG the other's; skips (77) without the other.
set -eu
other=${TILERY_BIN_CLANG-}
[ -x "$other/tilery" ] || {
    echo "compilers: no second build (TILERY_BIN_CLANG)"
    exit 77
}
scratch=$(mktemp -d)
pids=
finish() {
    for pid in $pids; do
        kill "$pid" 2>/dev/null || true
    done
    wait
    rm -rf "$scratch"
}
trap finish EXIT
no_fma=glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F

hash_of() { # REPORT
    python3 -c 'import json, sys; print(json.load(open(sys.argv[1]))["image_sha256"])' "$1"
}
line_of() { # FILE: its first line, waited for
    tries=0
    until [ -s "$1" ]; do
        tries=$((tries + 1))
        [ $tries -le 200 ] || return 1
        sleep 0.1
    done
    head -n 1 "$1"
}
value_of() { # KEY, JSON on standard input
    python3 -c 'import json, sys; print(json.load(sys.stdin)[sys.argv[1]])' "$1"
}

for scene in cbox_no_light_refract glass_cbox veach; do
    options="--size 96x96 --spp 8 --quiet"
    # shellcheck disable=SC2086 # words
    {
        "$TILERY_BIN/tilery" render scenes/$scene.json -o "$scratch/a.exr" $options --report "$scratch/a.json"
        "$other/tilery" render scenes/$scene.json -o "$scratch/b.exr" $options --report "$scratch/b.json"
        GLIBC_TUNABLES=$no_fma "$TILERY_BIN/tilery" render scenes/$scene.json -o "$scratch/c.exr" $options \
            --report "$scratch/c.json"
    }
    a=$(hash_of "$scratch/a.json")
    b=$(hash_of "$scratch/b.json")
    c=$(hash_of "$scratch/c.json")
    echo "compilers: $scene: $a $b $c"
    [ "$a" = "$b" ] && [ "$a" = "$c" ]
done

# One farm of workers from both builds.
"$TILERY_BIN/tilery-master" --listen 127.0.0.1:0 --http 127.0.0.1:0 --data "$scratch/data" \
    >"$scratch/master.out" &
pids="$pids $!"
listen=$(line_of "$scratch/master.out" | value_of listen)
TILERY_MASTER=http://$(line_of "$scratch/master.out" | value_of http)
export TILERY_MASTER
for bin in "$TILERY_BIN" "$other"; do
    "$bin/tilery-worker" --master "$listen" --threads 1 >"$scratch/worker.out" &
    pids="$pids $!"
    line_of "$scratch/worker.out" >/dev/null
    : >"$scratch/worker.out"
done
job=$("$TILERY_BIN/tilery" submit scenes/veach.json --size 96x96 --spp 8 --wait -o "$scratch/m.exr" --quiet)
mixed=$("$TILERY_BIN/tilery" status "$job" --json | value_of image_sha256)
echo "compilers: mixed farm: $mixed"
[ "$mixed" = "$a" ]
