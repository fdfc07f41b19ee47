#!/bin/sh
# readme_figures.sh: measures what README.md quotes, in one run, with the release build.
#
#   report     seconds of `tilery render` for the source report's scene, 512x512, 8 spp
#   spot       seconds for a mesh of 5,856 triangles at 96x96, 4 spp, with the tree and without
#   overhead   bench_farm: farm against a bare loop, and milliseconds a job
#
# usage: tests/bench/readme_figures.sh [RUNS]     (default 5; medians and ranges are printed)
set -eu
cd "$(dirname "$0")/../.."
bin=build/release/bin
runs=${1:-5}
data=${TILERY_TEST_DATA:-../shared/data}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

series() { # LABEL ARGS...: RUNS renders, seconds sorted
    label=$1
    shift
    i=0
    : >"$scratch/times"
    while [ $i -lt "$runs" ]; do
        begin=$(date +%s.%N)
        "$bin/tilery" render "$@" -o "$scratch/out.exr" --quiet
        end=$(date +%s.%N)
        echo "$end $begin" | awk '{ printf "%.3f\n", $1 - $2 }' >>"$scratch/times"
        i=$((i + 1))
    done
    sort -n "$scratch/times" | awk -v label="$label" '{ t[NR] = $1 }
        END { printf "%-34s median %.3f s (%.3f to %.3f), %d runs\n", label, t[int((NR + 1) / 2)], t[1], t[NR], NR }'
}

grep -m1 'model name' /proc/cpuinfo | sed 's/.*: //'
echo "$(nproc) cores, commit $(git rev-parse --short HEAD)"
series "report's scene, 512x512, 8 spp" scenes/cbox_no_light_refract.json --spp 8
python3 scenes/for_data.py "$data" "$scratch"
series "spot, 96x96, 4 spp" "$scratch/spot.json" --size 96x96 --spp 4
if [ "$runs" -gt 3 ]; then
    runs=3
fi
series "spot, the same without a tree" "$scratch/spot.json" --size 96x96 --spp 4 --builder none
"$bin/bench_farm" --quick
