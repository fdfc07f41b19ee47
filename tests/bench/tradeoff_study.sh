#!/bin/sh
# tradeoff_study.sh: the studies that docs/TRADEOFF.md quotes: four scenes, their plots and tables.
#
#   refract    scenes/cbox_no_light_refract.json, a point light and a disc that refracts
#   cbox       scenes/cbox.json, an area light
#   veach      scenes/veach.json, glossy plates
#   sky        49,152 triangles under a sky with a sun (scenes/make_sky.py)
#
# usage: tests/bench/tradeoff_study.sh OUT_DIR [SECONDS [PICTURES]]    (150 for each; the release build)
# Plots go to OUT_DIR/NAME/tradeoff.svg, and as tradeoff-NAME.svg to the folder PICTURES, which for the
# page is docs/img; the tables, in Markdown, to standard output.
set -eu
cd "$(dirname "$0")/../.."
out=$1
seconds=${2:-150}
pictures=${3-}
bin=build/release/bin
mkdir -p "$out"
python3 scenes/make_sky.py "$bin/gen_mesh" "$out/scene" 64 >/dev/null

study() { # NAME SCENE
    nice -n 5 "$bin/tilery" tradeoff "$2" -o "$out/$1" --budget "$seconds" --quiet
    [ -z "$pictures" ] || cp "$out/$1/tradeoff.svg" "$pictures/tradeoff-$1.svg"
}

study refract scenes/cbox_no_light_refract.json
study cbox scenes/cbox.json
study veach scenes/veach.json
study sky "$out/scene/sky.json"
grep -m1 'model name' /proc/cpuinfo | sed 's/.*: //'
echo "$(nproc) cores, commit $(git rev-parse --short HEAD), $seconds s a scene"
python3 tests/bench/tradeoff_table.py "$out/refract" "$out/cbox" "$out/veach" "$out/sky"
