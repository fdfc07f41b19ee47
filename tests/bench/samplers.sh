#!/bin/bash
# tests/bench/samplers.sh: the samplers' error at equal samples, against a long render.
#
# usage: samplers.sh BUILD_DIR
#
# For each scene and sampler: relMSE of three seeds against a reference that none of them is part of, and the
# ratio of the geometric means to that of sobol. Takes about two minutes of two cores.
set -eu
build=$1
root=$(cd "$(dirname "$0")/../.." && pwd)
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
render() {
    "$build/bin/tilery" render "$root/scenes/$1.json" --size 64x64 --quiet --integrator path --sampler "$2" \
        --spp "$3" --seed "$4" -o "$dir/$5.exr"
}
for scene in cbox glass_cbox veach; do
    render "$scene" sobol 1024 1000 reference
    for sampler in sobol halton independent; do
        for spp in 16 64; do
            for seed in 1 2 3; do
                render "$scene" "$sampler" "$spp" "$seed" picture
                "$build/bin/tilery" compare "$dir/picture.exr" "$dir/reference.exr" --json >"$dir/compare" || true
                echo "$scene $sampler $spp $(grep -o '"relmse":[^,]*' "$dir/compare" | cut -d: -f2)"
            done
        done
    done
done | python3 -c '
import math, sys
found = {}
for line in sys.stdin:
    scene, sampler, spp, error = line.split()
    found.setdefault((scene, int(spp)), {}).setdefault(sampler, []).append(float(error))
for (scene, spp), rows in sorted(found.items()):
    mean = {s: math.exp(sum(map(math.log, e)) / len(e)) for s, e in rows.items()}
    for sampler, errors in rows.items():
        print(f"{scene:10} {spp:3} spp {sampler:11} relMSE {min(errors):.5f} to {max(errors):.5f}, "
              f"{mean[sampler] / mean['"'"'sobol'"'"']:.2f} times that of sobol")
'
