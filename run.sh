#!/bin/sh
# run.sh: from a bare Debian 12 to a picture.
#
#   ./run.sh             install what is missing, build, render the two Cornell boxes of the
#                        source report on a farm of local workers, into out/
#   ./run.sh --setup     install and build only
#   ./run.sh ARGS...     tilery render ARGS...
set -eu
top=$(cd "$(dirname "$0")" && pwd)
. "$top/scripts/packages.sh"
build=$top/build/release

# shellcheck disable=SC2086 # lists of words
install_packages $packages_build
if [ ! -f "$build/build.ninja" ]; then
    cmake -S "$top" -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DTILERY_TESTS=OFF >/dev/null
    echo "building into $build (about a minute the first time)" >&2
fi
cmake --build "$build" >"$build/build.log" 2>&1 || {
    tail -n 40 "$build/build.log" >&2
    echo "run.sh: the build failed: $build/build.log" >&2
    exit 5
}

case ${1-} in
--setup)
    echo "built: $build/bin/tilery" >&2
    exit 0
    ;;
"")
    mkdir -p "$top/out"
    for name in cbox_no_light_refract glass_cbox; do
        "$build/bin/tilery" render "$top/scenes/$name.json" -o "$top/out/$name.exr" \
            --png "$top/out/$name.png" --report "$top/out/$name.report.json"
    done
    echo "pictures: $top/out/cbox_no_light_refract.png $top/out/glass_cbox.png" >&2
    ;;
*)
    exec "$build/bin/tilery" render "$@"
    ;;
esac
