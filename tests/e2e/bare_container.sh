#!/bin/sh
# bare_container.sh [COMMAND]: runs COMMAND (default ./run.sh) from a clean clone in a container of
# bare Debian 12, as a newcomer would, and shows what it left in out/.
#
# Skips (77) only where no engine answers. TILERY_TEST_DATA is mounted where it exists.
set -eu
top=$(cd "$(dirname "$0")/../.." && pwd)
docker info >/dev/null 2>&1 || {
    echo "bare_container: no Docker engine answers"
    exit 77
}
"$top/docker/make-base.sh"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
git clone -q "$top" "$scratch/tilery"
data=${TILERY_TEST_DATA:-$top/../shared/data}
mount=
if [ -d "$data" ]; then
    mount="-v $(cd "$data" && pwd):/data:ro -e TILERY_TEST_DATA=/data"
fi
# shellcheck disable=SC2086 # words
docker run --rm --init -v "$scratch/tilery:/root/tilery" -w /root/tilery $mount \
    debian:bookworm-slim sh -c "git config --global --add safe.directory /root/tilery 2>/dev/null; ${*:-./run.sh}"
if [ $# = 0 ]; then
    for name in cbox_no_light_refract glass_cbox; do
        [ -s "$scratch/tilery/out/$name.exr" ] && [ -s "$scratch/tilery/out/$name.png" ]
        grep -q '"image_sha256"' "$scratch/tilery/out/$name.report.json"
    done
    echo "bare_container: both pictures are there"
fi
