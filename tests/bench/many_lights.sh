#!/bin/bash
# tests/bench/many_lights.sh: a scene of 1,000 lights, chosen by the tree, by power and evenly.
#
# usage: many_lights.sh BUILD_DIR [LIGHTS]
#
# Renders each choice at the same samples, times core-seconds, and compares with a long render of the
# tree's; three rounds interleaved, seeds of their own. Prints relMSE and core-seconds of each, and the
# ratio of relMSE times core-seconds (the work to equal error) over the tree's.
set -eu
build=$1
lights=${2:-1000}
root=$(cd "$(dirname "$0")/../.." && pwd)
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
python3 "$root/scenes/make_lights.py" "$dir/scene.json" "$lights"
render() {
    "$build/bin/tilery" render "$dir/scene.json" --size 144x96 --quiet --light-choice "$1" --spp "$2" \
        --seed "$3" -o "$dir/$4.exr" --report "$dir/$4.json"
}
render tree 2048 100 reference
for round in 1 2 3; do
    for choice in tree power uniform; do
        render "$choice" 64 "$round" "$choice$round"
        "$build/bin/tilery" compare "$dir/$choice$round.exr" "$dir/reference.exr" --json \
            >"$dir/$choice$round.compare" || true
    done
done
python3 - "$dir" <<'PY'
import json, pathlib, sys
folder = pathlib.Path(sys.argv[1])
rows = {}
for choice in ("tree", "power", "uniform"):
    rows[choice] = [(json.loads((folder / f"{choice}{r}.compare").read_text())["relmse"],
                     json.loads((folder / f"{choice}{r}.json").read_text())["core_seconds"]) for r in (1, 2, 3)]
for choice, runs in rows.items():
    ratios = sorted(e * s / (t * u) for (e, s), (t, u) in zip(runs, rows["tree"]))
    print(f"{choice:8} relMSE {min(e for e, _ in runs):.4f} to {max(e for e, _ in runs):.4f}, "
          f"core-seconds {min(s for _, s in runs):.1f} to {max(s for _, s in runs):.1f}, "
          f"work to equal error {ratios[1]:.1f} times the tree's ({ratios[0]:.1f} to {ratios[2]:.1f})")
PY
