#!/bin/sh
# What --precision fast gives and what it costs: rays a second over exact's, interleaved, and how
# far its pictures are from exact's, beside the noise that both have.
#
# usage: tests/bench/precision.sh [BUILD/bin]    run in the top folder; about a minute
set -eu
bin=${1:-build/release/bin}
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT

for scene in cornell ball70k; do
    "$bin/bench_trace" --quick --runs 15 --side 96 --scene "$scene" --fast | grep 'fast over exact'
done
for scene in cbox veach glass_cbox cbox_no_light; do
    for seed in 1 2 3; do
        for precision in exact fast; do
            "$bin/tilery" render "scenes/$scene.json" -o "$out/$precision.exr" --spp 64 \
                --size 96x96 --seed "$seed" --precision "$precision" --quiet \
                --report "$out/$precision.json" >/dev/null
        done
        noise=$(grep -o '"relmse": *[0-9.e+-]*' "$out/exact.json" | head -n 1)
        difference=$("$bin/tilery" compare "$out/fast.exr" "$out/exact.exr" | grep -E 'relMSE|mean ')
        echo "$scene, seed $seed, noise $noise, difference:"
        echo "$difference"
    done
done
